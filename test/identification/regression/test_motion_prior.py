"""Arms learnt from motions with an empty hand, and what they then weigh: arms drawn at random, in MuJoCo, and algebra by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.arm_in_motion import FOUR, SIX, Build, Twin, write_robot

from proprio_ros.errors import RecordingError
from proprio_ros.identification.estimate import Verdict
from proprio_ros.identification.regression.motion_estimate import calibrate_motions
from proprio_ros.identification.regression.motion_fit import fit_empty, fit_payload
from proprio_ros.identification.regression.solve import Prior, correlated_windows, posterior
from proprio_ros.probes.payload.moving import identify_in_motion
from proprio_ros.recordings.motions import Motion
from proprio_ros.robot import Robot, load_robot
from proprio_ros.sim.payload import PayloadFacts


def test_the_posterior_is_that_of_the_normal_equations() -> None:
    rng = np.random.default_rng(1)
    rows = rng.normal(size=(30, 4)) * [1.0, 1e-3, 10.0, 1.0]
    right = rng.normal(size=30)
    factor = rng.normal(size=(4, 4)) * [1e-2, 1.0, 1e-3, 1.0]
    mean = rng.normal(size=4)
    prior = factor.T @ factor
    values, covariance = posterior(
        rows.T @ rows,
        rows.T @ right,
        Prior(mean, prior),
    )
    precision = rows.T @ rows + np.linalg.inv(prior)
    np.testing.assert_allclose(
        covariance,
        np.linalg.inv(precision),
        rtol=1e-6,
        atol=1e-12,
    )
    expected = np.linalg.solve(
        precision,
        rows.T @ right + np.linalg.solve(prior, mean),
    )
    np.testing.assert_allclose(values, expected, rtol=1e-6)


def test_a_prior_that_leaves_a_direction_closed_needs_no_inverse() -> None:
    values, covariance = posterior(
        np.eye(2),
        np.array([3.0, 0.0]),
        Prior(
            np.zeros(2),
            np.ones((2, 2)),
        ),
    )
    # one number, seen twice: 3 and 0
    np.testing.assert_allclose(values, [1.0, 1.0])
    np.testing.assert_allclose(
        covariance,
        np.full((2, 2), 1.0 / 3.0),
    )


def test_windows_that_share_an_error_count_less() -> None:
    rng = np.random.default_rng(2)
    block = np.repeat(np.arange(2000), 20)
    alone = rng.normal(size=len(block))
    assert correlated_windows(alone, block) < 1.2
    drifting = alone.copy()
    for n in range(1, len(drifting)):
        drifting[n] = 0.6 * drifting[n - 1] + 0.8 * alone[n]
    # 1 + 2 (0.6 + 0.6^2 + ..) = 4
    assert 3.2 < correlated_windows(drifting, block) < 4.2


@pytest.fixture(scope="module")
def robots(tmp_path_factory: pytest.TempPathFactory) -> dict[int, Robot]:
    return {
        len(build.axes): load_robot(write_robot(tmp_path_factory.mktemp("twin"), build=build))
        for build in (SIX, FOUR)
    }


@pytest.fixture(scope="module")
def recorded() -> tuple[Motion, Motion]:
    """Of an arm of six joints with something in its hand, and empty."""
    arm = Twin(11, SIX)
    loaded = arm.record(
        "loaded",
        15.0,
        arm.payload(np.random.default_rng(11)),
    )
    return loaded, arm.record("empty", 20.0)


@pytest.mark.long
@pytest.mark.parametrize("calibrated", [True, False])
@pytest.mark.parametrize(
    ("torque", "codes"),
    [
        ("as it is", []),
        ("8 tenths", ["other_torque", "misfit"]),
        ("12 tenths", ["other_torque", "misfit"]),
        ("one joint", ["other_torque", "misfit"]),
    ],
)
def test_torques_in_another_unit_than_the_empty_ones_are_no_payload(
    robots: dict[int, Robot],
    recorded: tuple[Motion, Motion],
    calibrated: bool,
    torque: str,
    codes: list[str],
) -> None:
    robot, (loaded, empty) = robots[6], recorded
    factor = np.full(
        6,
        {"8 tenths": 0.8, "12 tenths": 1.2}.get(torque, 1.0),
    )
    factor[1] *= 0.7 if torque == "one joint" else 1.0
    loaded = replace(loaded, current_A=loaded.current_A * factor)
    if calibrated:
        estimate = identify_in_motion(
            replace(
                robot,
                motion_calibration=fit_empty(robot, [empty]),
            ),
            [loaded],
            [],
            PayloadFacts(),
        )
    else:
        estimate = identify_in_motion(
            robot,
            [loaded],
            [empty],
            PayloadFacts(),
        )
    if not codes:
        assert estimate.verdict is Verdict.ACCEPTED
    else:
        assert estimate.verdict is Verdict.REJECTED and estimate.values[0].value is None
        assert estimate.reasons[0].code in codes, estimate.reasons


@pytest.mark.long
@pytest.mark.parametrize(
    ("build", "seed", "within_kg"), [(FOUR, 3, 0.006), (FOUR, 7, 0.006), (SIX, 3, 0.03)]
)
def test_an_arm_drawn_at_random_weighs_with_what_an_empty_motion_said(
    robots: dict[int, Robot],
    build: Build,
    seed: int,
    within_kg: float,
) -> None:
    robot = robots[len(build.axes)]
    arm = Twin(seed, build)
    mass, centre = arm.payload(np.random.default_rng(seed))
    known = fit_empty(
        robot,
        [arm.record("empty", 20.0)],
    )
    fit = fit_payload(
        robot,
        [arm.record("loaded", 15.0, (mass, centre))],
        known,
    )
    half_kg = fit.quantile * float(fit.std[0])
    # an interval of 95 % may miss: how often is for the benchmark
    assert abs(fit.values[0] - mass) < min(1.5 * half_kg, within_kg)
    # one empty recording does not show by how much recordings differ
    assert half_kg < 4.6 * within_kg
    nothing = fit_payload(
        robot,
        [arm.record("empty again", 15.0)],
        known,
    )
    half_kg = nothing.quantile * float(nothing.std[0])
    assert abs(nothing.values[0]) < 1.5 * half_kg and half_kg < 1.5 * within_kg


@pytest.mark.long
def test_torque_constants_apart_show_where_two_joints_carry_the_same(
    robots: dict[int, Robot],
) -> None:
    """One motor gives 4 % more than its file says, the next one 4 % less; and friction goes with the angle."""
    robot = robots[4]
    arm = Twin(5, FOUR)
    arm.torque = arm.torque * np.array([1.0, 1.04, 0.96, 1.0])
    arm.place[:] = 0.3
    mass = 0.1
    centre = np.array([0.01, 0.0, 0.0])
    known = fit_empty(
        robot,
        [arm.record("empty", 20.0)],
    )
    values = dict(zip(known.keys, known.values, strict=True))
    # the prior is 1 %, so 20 s do not show all of it
    assert 0.04 < values["torque_share", "j2"] - values["torque_share", "j3"] < 0.09
    loaded = arm.record("loaded", 15.0, (mass, centre))
    baseline = arm.record("baseline", 15.0)
    alone, with_baseline = (
        fit_payload(robot, [loaded], known, empty=empty) for empty in ([], [baseline])
    )
    for fit in (alone, with_baseline):
        half_kg = fit.quantile * float(fit.std[0])
        assert abs(fit.values[0] - mass) < min(half_kg, 0.004)
        assert half_kg < 0.03
    nothing = fit_payload(robot, [baseline], known)
    assert abs(nothing.values[0]) < 0.003


@pytest.mark.long
def test_a_reference_tells_torque_constants_that_are_off(robots: dict[int, Robot]) -> None:
    """All constants are 12 % less than stated, and stated to 10 %."""
    stated = robots[4]
    drives = {
        name: replace(
            drive,
            torque_constant=replace(
                drive.torque_constant,
                std=0.1 * drive.torque_constant.value,
            ),
        )
        for name, drive in stated.drive_trains.items()
    }
    robot = replace(stated, drive_trains=drives)
    arm = Twin(5, FOUR)
    arm.torque = arm.torque * 0.88
    centre = np.array([0.01, 0.0, 0.0])
    empty = arm.record("empty", 20.0)
    reference = arm.record("reference", 20.0, (0.2, centre))
    loaded = arm.record("loaded", 20.0, (0.15, centre))
    without = calibrate_motions(robot, [empty])
    with_it = calibrate_motions(
        robot,
        [empty],
        [(reference, 0.2)],
    )
    assert without.verdict is with_it.verdict is Verdict.ACCEPTED
    assert without.motion is not None and with_it.motion is not None
    assert abs(with_it.motion.torque_scale - 0.88) < 0.05
    assert with_it.motion.torque_scale_std < 0.052
    rough = fit_payload(robot, [loaded], without.motion)
    fine = fit_payload(robot, [loaded], with_it.motion)
    assert rough.values[0] > 1.08 * 0.15
    for fit in (rough, fine):
        assert abs(fit.values[0] - 0.15) < fit.quantile * float(fit.std[0])
    assert abs(fine.values[0] - 0.15) < 0.006
    assert fine.std[0] < 0.72 * rough.std[0]
    assert without.weighable is not None and "--reference" in without.weighable.sentence()
    assert (
        with_it.weighable is not None and with_it.weighable.std_kg < 0.6 * without.weighable.std_kg
    )
    # what is stated to weigh half of what it does is no reference
    assert calibrate_motions(robot, [empty], [(reference, 0.1)]).verdict is Verdict.REJECTED


@pytest.mark.long
def test_several_empty_motions_say_more_and_show_what_differs(robots: dict[int, Robot]) -> None:
    robot = robots[4]
    arm = Twin(9, FOUR)
    first, second, third = (arm.record(f"empty {n}", 15.0) for n in range(3))
    one = fit_empty(robot, [first])
    three = fit_empty(robot, [first, second, third])
    assert len(three.runs) == 3 and three.stretches == 3 * one.stretches
    bodies = slice(0, 40)
    of_three = np.diag(three.covariance)[bodies]
    of_one = np.diag(one.covariance)[bodies]
    assert np.all(of_three <= 1.05 * of_one)
    weighed = calibrate_motions(robot, [first, second, third]).weighed_empty
    assert [each.name for each in weighed] == ["empty 0", "empty 1", "empty 2"]
    assert all(abs(each.mass_kg) < each.half_width < 0.01 for each in weighed)


@pytest.mark.long
def test_what_is_too_short_or_of_another_arm_is_refused(robots: dict[int, Robot]) -> None:
    robot = robots[4]
    arm = Twin(11, FOUR)
    motion = arm.record("empty", 11.0)
    known = fit_empty(robot, [motion])
    rows = motion.times_s < 6.0
    short = replace(
        motion,
        times_s=motion.times_s[rows],
        position=motion.position[rows],
        current_A=motion.current_A[rows],
    )
    with pytest.raises(RecordingError, match="record 10 s"):
        fit_empty(robot, [short])
    with pytest.raises(RecordingError, match="record 10 s"):
        fit_payload(robot, [short], known)
    with pytest.raises(RecordingError, match="the calibration is of j1, j2, j3, j4"):
        fit_payload(
            robot,
            [
                replace(
                    motion,
                    joints=("j1", "j2", "j3", "j5"),
                )
            ],
            known,
        )


@pytest.mark.long
def test_what_is_stated_of_torque_counts_beside_a_reference_that_does_not_contradict_it(
    robots: dict[int, Robot],
) -> None:
    robot = robots[4]
    centre = np.array([0.01, 0.0, 0.0])
    scales = []
    for off in (1.0, 0.8):
        arm = Twin(5, FOUR)
        arm.torque = arm.torque * off
        empty = arm.record("empty", 20.0)
        reference = arm.record("reference", 20.0, (0.2, centre))
        learnt = calibrate_motions(
            robot,
            [empty],
            [(reference, 0.2)],
        ).motion
        assert learnt is not None and learnt.referenced
        scales.append((learnt.torque_scale, learnt.torque_scale_std))
    (right, right_std), (wrong, wrong_std) = scales
    # the file has it to 1 %, and a small arm's reference no better than to 5
    assert abs(right - 1.0) < 0.01 and right_std < 0.0101
    # one that is 20 % off is what the reference says it is
    assert abs(wrong - 0.8) < 2.0 * wrong_std and 0.02 < wrong_std < 0.08
