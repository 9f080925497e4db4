"""A clock that runs at another pace, and torques that come late, in motions of an arm in MuJoCo and of a real one."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from support.arm_in_motion import Twin, write_robot
from support.known.bases import so101
from support.machines import REAL

from proprio_ros.calibration_files.motions import MotionCalibration
from proprio_ros.identification.estimate import Estimate, Verdict
from proprio_ros.identification.regression.motion_equations import Problem, equations, own_terms
from proprio_ros.identification.regression.motion_estimate import calibrate_motions
from proprio_ros.identification.regression.motion_fit import fit_empty
from proprio_ros.identification.regression.recording_variability import CLOCK
from proprio_ros.identification.regression.time_axis import (
    LAG_OF_GOALS_S,
    OFF_BEFORE,
    PACE_SPREAD,
    TimeAxis,
    likeliest,
    time_axis_of,
    with_time_axes,
)
from proprio_ros.inputs.forms import FormError
from proprio_ros.pipeline.loading import bag_motion
from proprio_ros.pipeline.request import Options, request_of
from proprio_ros.probes.payload.moving import identify_in_motion
from proprio_ros.recordings.motions import Motion
from proprio_ros.robot import Robot, load_robot
from proprio_ros.sim.payload import PayloadFacts

UR10E_KG = 2.805


class Pair(NamedTuple):
    """Motions of one arm with and without a payload."""

    robot: Robot
    empty: Motion
    loaded: Motion
    payload_kg: float


@pytest.fixture(scope="module")
def twin(tmp_path_factory: pytest.TempPathFactory) -> Pair:
    """An arm in MuJoCo that differs from its file; nothing was chosen on its seed."""
    arm = Twin(9202)
    mass_kg, centre_m = arm.payload(np.random.default_rng(9202))
    empty = arm.record("empty", 20.0)
    loaded = arm.record("loaded", 15.0, (mass_kg, centre_m))
    robot = load_robot(write_robot(tmp_path_factory.mktemp("twin")))
    return Pair(robot, empty, loaded, mass_kg)


def at_pace(motion: Motion, pace: float) -> Motion:
    """Stamped as if time ran so much slower than it did."""
    return replace(motion, times_s=motion.times_s / pace)


def later(motion: Motion, lag_s: float) -> Motion:
    """Currents that are recorded later than positions."""
    columns = [
        np.interp(motion.times_s - lag_s, motion.times_s, column) for column in motion.current_A.T
    ]
    return replace(motion, current_A=np.column_stack(columns))


def holds(answer: Estimate, mass_kg: float) -> bool:
    low, high = answer.values[0].ci95
    return answer.verdict is Verdict.ACCEPTED and low <= mass_kg <= high


class Solved(NamedTuple):
    """Equations of a motion with a payload, which window and joint each is of, and values of the unknowns."""

    problem: Problem
    windows: np.ndarray  # number of the first sample, and of the joint, shape (E, 2)
    values: np.ndarray


def solved(pair: Pair, motion: Motion) -> Solved:
    rows = equations(pair.robot, motion, motion.joints)
    problem = Problem.of([rows], 1)
    values = np.random.default_rng(1).uniform(
        0.5,
        1.5,
        problem.matrix.shape[1],
    )
    # dry friction goes with the direction alone, which a slow joint's pace blurs
    count = problem.count
    waves = slice(
        10 + 13 * count,
        10 + 17 * count,
    )
    coulomb = slice(
        problem.own(0).start + count,
        problem.own(0).start + 2 * count,
    )
    values[waves] = 0.0
    values[coulomb] = 0.0
    period_s = float(np.median(np.diff(motion.times_s)))
    windows = np.column_stack([np.rint(rows.start_s / period_s), rows.joint])
    return Solved(problem, windows, values)


def torque_of(found: Solved, windows: np.ndarray) -> np.ndarray:
    """What a solution says of some windows and joints, NaN where a joint was too slow to count."""
    torque = found.problem.matrix @ found.values
    known = dict(zip(map(tuple, found.windows), torque, strict=True))
    return np.array([known.get(tuple(window), np.nan) for window in windows])


@pytest.mark.parametrize("pace", [0.75, 1.0, 1.6])
def test_torque_follows_the_pace_as_a_difference_quotient_says(twin: Pair, pace: float) -> None:
    # at these paces the step does not change how many samples a window has
    motion = at_pace(twin.loaded, 1.0 / pace)
    step = 1e-3
    found = solved(twin, motion)
    # accelerations that are larger by the step
    larger, smaller = (
        solved(twin, at_pace(motion, (1.0 + change) ** 0.5)) for change in (step, -step)
    )
    rise = torque_of(larger, found.windows) - torque_of(smaller, found.windows)
    quotient = rise / (2.0 * step)
    column = own_column(found, "pace")
    compared = np.isfinite(quotient)
    assert compared.mean() > 0.95
    # smoothing of positions goes with the sampling period, too
    tolerance = 0.02 * np.abs(column).max()
    assert tolerance > 0.1
    assert column[compared] == pytest.approx(quotient[compared], abs=tolerance)


def own_column(found: Solved, kind: str) -> np.ndarray:
    """Of what the recording has of its own, one column as the solution fills it."""
    problem = found.problem
    matrix = problem.matrix.copy()
    problem.fill_own(matrix, found.values)
    number = own_terms(problem.count) - len(CLOCK) + CLOCK.index(kind)
    return matrix[:, problem.own(0).start + number]


@pytest.mark.parametrize("lag_s", [-0.03, 0.0, 0.05])
def test_torque_follows_the_lag_as_a_difference_quotient_says(twin: Pair, lag_s: float) -> None:
    step_s = 1e-3
    # without noise, which the interpolation of a shift smooths
    phases = np.arange(len(twin.loaded.joints))
    angle = 3.0 * twin.loaded.times_s[:, None] + phases
    smooth = replace(
        twin.loaded,
        current_A=np.sin(angle),
    )
    found = solved(twin, later(smooth, lag_s))
    after, before = (
        solved(twin, later(smooth, lag_s + step)).problem.torque for step in (step_s, -step_s)
    )
    quotient = (after - before) / (2.0 * step_s)
    column = own_column(found, "lag")
    stretch = found.problem.stretch
    inner = (stretch > 0) & (stretch < stretch.max())
    # what is later raises the left side, and the column stands on the right
    assert column[inner] == pytest.approx(
        quotient[inner],
        abs=0.02 * np.abs(column).max(),
    )


def test_a_clock_that_keeps_time_is_left_alone(twin: Pair) -> None:
    (empty,) = with_time_axes(twin.robot, [twin.empty])
    calibration = fit_empty(twin.robot, [empty])
    (loaded,) = with_time_axes(
        twin.robot,
        [twin.loaded],
        calibration,
        loaded=True,
    )
    for before, after in ((twin.empty, empty), (twin.loaded, loaded)):
        assert after.times_s is before.times_s
        assert after.current_A is before.current_A
        assert after.notes == before.notes
        # what stays open is less than a per cent
        assert after.pace_std < 0.01


@pytest.mark.parametrize("pace", [0.5, 0.75, 1.37, 2.0])
def test_the_pace_of_a_clock_is_found_and_followed(twin: Pair, pace: float) -> None:
    wrong = at_pace(twin.empty, pace)
    clock = time_axis_of(twin.robot, wrong)
    assert abs(np.log(clock.pace / pace)) < 3.0 * np.hypot(clock.pace_std, 0.03)
    loaded = at_pace(twin.loaded, pace)
    both = identify_in_motion(
        twin.robot,
        [loaded],
        [wrong],
        PayloadFacts(),
    )
    alone = identify_in_motion(
        twin.robot,
        [loaded],
        [twin.empty],
        PayloadFacts(),
    )
    assert holds(both, twin.payload_kg)
    assert holds(alone, twin.payload_kg)
    assert sum("the loop ran at" in note for note in both.notes) == 2
    assert sum("the loop ran at" in note for note in alone.notes) == 1


@pytest.mark.parametrize("lag_s", [0.1, 0.15, -0.06])
def test_torques_that_come_late_are_moved_back(twin: Pair, lag_s: float) -> None:
    answer = identify_in_motion(
        twin.robot, [later(twin.loaded, lag_s)], [twin.empty], PayloadFacts()
    )
    assert holds(answer, twin.payload_kg)
    (note,) = [note for note in answer.notes if "efforts were recorded" in note]
    assert ("later" if lag_s > 0.0 else "earlier") in note


def test_a_calibration_and_its_reference_follow_their_clocks(twin: Pair) -> None:
    learnt = calibrate_motions(
        twin.robot,
        [at_pace(twin.empty, 0.73)],
        [(at_pace(twin.loaded, 0.73), twin.payload_kg)],
    )
    assert learnt.verdict is Verdict.ACCEPTED
    assert learnt.motion is not None
    assert abs(learnt.motion.torque_scale - 1.0) < 3.0 * learnt.motion.torque_scale_std
    assert sum("the loop ran at" in note for note in learnt.notes) == 2


def test_a_clock_that_leaves_too_little_is_uncertain_and_not_followed(twin: Pair) -> None:
    six_s = int(np.searchsorted(twin.loaded.times_s, 6.0))
    motion = at_pace(twin.loaded.part(slice(0, six_s)), 0.45)
    calibration = fit_empty(twin.robot, [twin.empty])
    assert time_axis_of(twin.robot, motion, calibration, loaded=True).runs_off
    (found,) = with_time_axes(twin.robot, [motion], calibration, loaded=True)
    np.testing.assert_array_equal(found.times_s, motion.times_s)
    assert not found.clock_off
    assert found.pace_std > 0.3
    answer = identify_in_motion(twin.robot, [motion], [twin.empty], PayloadFacts())
    assert answer.verdict is not Verdict.ACCEPTED or holds(answer, twin.payload_kg)


def test_what_is_far_from_its_misfit_runs_off() -> None:
    assert TimeAxis(0.73, 0.01, 0.0, 1e-3).runs_off
    assert not TimeAxis(0.97, 0.01, 0.0, 1e-3).runs_off
    assert not TimeAxis(0.73, 0.2, 0.0, 1e-3).runs_off
    assert TimeAxis(1.0, 0.01, 0.1, 1e-3).is_late
    assert not TimeAxis(1.0, 0.01, 0.013, 1e-3).is_late


class ByVoltage(NamedTuple):
    """A calibrated SO-101 in MuJoCo, of which goals and positions are recorded, and what it holds."""

    robot: Robot
    loaded: Motion
    payload_kg: float


@pytest.fixture(scope="module")
def by_voltage(tmp_path_factory: pytest.TempPathFactory) -> ByVoltage:
    """Nothing was chosen on its seed."""
    base = so101(9205)
    files = base.files(tmp_path_factory.mktemp("so101"))
    request = request_of(Options(robot=str(files["calibration"])))
    return ByVoltage(request.robot, bag_motion(files["loaded"], request), base.truth)


def test_goals_that_act_late_are_no_clock_that_runs_off(by_voltage: ByVoltage) -> None:
    calibration = by_voltage.robot.motion_calibration
    assert calibration is not None and calibration.read_time_axis is not None
    (followed,) = with_time_axes(by_voltage.robot, [by_voltage.loaded], calibration, loaded=True)
    assert followed.times_s is by_voltage.loaded.times_s
    assert followed.notes == by_voltage.loaded.notes
    assert followed.pace_std < 0.005
    assert followed.lag_std_s < 0.002


@pytest.mark.parametrize("pace", [0.7, 0.95, 1.05, 1.4])
def test_a_clock_of_goals_is_followed_beside_those_of_the_calibration(
    by_voltage: ByVoltage, pace: float
) -> None:
    wrong = at_pace(by_voltage.loaded, pace)
    answer = identify_in_motion(by_voltage.robot, [wrong], [], PayloadFacts())
    assert any("the loop ran at" in note for note in answer.notes)
    low, high = answer.values[0].ci95
    assert low <= by_voltage.payload_kg <= high
    # by so much that nothing else would explain it
    if abs(np.log(pace)) > 0.1:
        assert high - low < by_voltage.payload_kg


@pytest.mark.parametrize("lag_s", [0.006, -0.006])
def test_goals_that_act_later_than_they_did_are_followed(
    by_voltage: ByVoltage, lag_s: float
) -> None:
    """Of a slower computer, say."""
    late = later(by_voltage.loaded, lag_s)
    answer = identify_in_motion(by_voltage.robot, [late], [], PayloadFacts())
    (note,) = [note for note in answer.notes if "its goals acted" in note]
    assert ("later" if lag_s > 0.0 else "earlier") in note
    low, high = answer.values[0].ci95
    assert low <= by_voltage.payload_kg <= high
    assert high - low < by_voltage.payload_kg


@pytest.mark.parametrize("lag_s", [0.04, -0.04])
def test_goals_that_act_much_later_are_other_goals(by_voltage: ByVoltage, lag_s: float) -> None:
    answer = identify_in_motion(
        by_voltage.robot, [later(by_voltage.loaded, lag_s)], [], PayloadFacts()
    )
    assert answer.verdict is Verdict.REJECTED
    assert not [note for note in answer.notes if "its goals acted" in note]


@pytest.mark.parametrize("share", [0.88, 1.12])
def test_torque_that_differs_is_not_mistaken_for_a_clock(
    by_voltage: ByVoltage, share: float
) -> None:
    """Of a battery that is nearly empty: what would be a clock as well is left open."""
    weak = replace(by_voltage.loaded, current_A=share * by_voltage.loaded.current_A)
    answer = identify_in_motion(by_voltage.robot, [weak], [], PayloadFacts())
    assert answer.verdict is not Verdict.ACCEPTED or holds(answer, by_voltage.payload_kg)


def test_what_is_off_errs_as_far_as_it_says() -> None:
    """Over clocks that are drawn as its priors have them."""
    random = np.random.default_rng(5)
    covariance = np.array([[1.2e-4, -6e-6], [-6e-6, 1.2e-6]])
    squares = np.zeros(2)
    said = np.zeros(2)
    for _ in range(4000):
        truth = np.zeros(2)
        kind = random.random()
        if kind < OFF_BEFORE:
            truth[0] = random.normal(0.0, PACE_SPREAD)
        elif kind < 2.0 * OFF_BEFORE:
            truth[1] = random.normal(0.0, LAG_OF_GOALS_S)
        off = truth + random.multivariate_normal(np.zeros(2), covariance)
        found, left = likeliest(off, covariance)
        squares += (found - truth) ** 2
        said += np.diag(left)
    np.testing.assert_allclose(squares, said, rtol=0.2)


def test_a_calibration_of_goals_without_a_clock_leaves_stamps_alone(by_voltage: ByVoltage) -> None:
    """As files of an earlier release."""
    known = by_voltage.robot.motion_calibration
    assert known is not None
    section = replace(known, read_time_axis=None).as_settings()
    assert "read_time_axis" not in section
    before = MotionCalibration.from_settings(section)
    wrong = at_pace(by_voltage.loaded, 1.4)
    (followed,) = with_time_axes(by_voltage.robot, [wrong], before, loaded=True)
    assert followed is wrong


def test_a_clock_that_was_read_is_read_again(by_voltage: ByVoltage) -> None:
    known = by_voltage.robot.motion_calibration
    assert known is not None
    assert known.read_time_axis is not None
    section = known.as_settings()
    read = MotionCalibration.from_settings(section).read_time_axis
    assert read is not None
    np.testing.assert_allclose(read.values, known.read_time_axis.values, rtol=1e-8)
    np.testing.assert_allclose(read.covariance, known.read_time_axis.covariance, rtol=1e-8)
    for rows, words in (("1.0", "three rows"), ("0.1 0.0\n1.0 2.0\n2.0 1.0", "no covariance")):
        with pytest.raises(FormError, match=words):
            MotionCalibration.from_settings({**section, "read_time_axis": rows})


@pytest.mark.skipif(not REAL.is_dir(), reason="needs recordings of real machines")
@pytest.mark.parametrize("pace", [0.7, 0.75, 1.4])
def test_a_real_arm_is_weighed_by_a_clock_that_runs_off(pace: float) -> None:
    request = request_of(Options(robot="ur10e", driver="ur_current"))
    loaded, empty = (
        bag_motion(REAL / name, request) for name in ("ur10e_loaded_14", "ur10e_empty_14")
    )
    for baseline in (empty, at_pace(empty, pace)):
        answer = identify_in_motion(
            request.robot, [at_pace(loaded, pace)], [baseline], PayloadFacts()
        )
        assert holds(answer, UR10E_KG)
