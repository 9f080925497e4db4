"""Every reason not to trust a recording has its sentence: real runs, altered as the fault would alter them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from proprio_ros.identification.estimate import Verdict
from proprio_ros.identification.prepared_runs import prepare_run
from proprio_ros.identification.problem import Problem
from proprio_ros.identification.robot_calibration import LoadedRun, calibrate
from proprio_ros.identification.robot_unknowns import load_unknowns
from proprio_ros.identification.unknowns import Role
from proprio_ros.pipeline.loading import bag_runs
from proprio_ros.pipeline.request import Request
from proprio_ros.probes.payload.identify import weigh
from proprio_ros.records import Run
from proprio_ros.robot import Robot, load_robot
from proprio_ros.sim.payload import PayloadFacts


def run_of(bags: Path, name: str, robot: Robot) -> Run:
    (run,) = bag_runs(bags / name / "bag_mcap", Request(robot))
    return run


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("open_manipulator_x")


@pytest.fixture(scope="module")
def calibrated(bags: Path, robot: Robot) -> Robot:
    known = [
        LoadedRun(run_of(bags, folder.name, robot))
        for folder in sorted(bags.glob("realistic_s00_empty_*"))
    ]
    estimate = calibrate(robot, known)
    assert estimate.calibration is not None
    return robot.with_calibration(estimate.calibration)


@pytest.fixture(scope="module")
def lift(bags: Path, robot: Robot) -> Run:
    """20 g lifted by 0.8 rad."""
    return run_of(bags, "realistic_s00_fixed_light_ball_20g_joint3", robot)


def shrunk(run: Run, factor: float) -> Run:
    """The same run with less travel."""
    rest = float(np.mean(run.before_position))
    return replace(
        run,
        position=rest + factor * (run.position - rest),
    )


def test_a_good_run_gives_no_reason(calibrated: Robot, lift: Run) -> None:
    estimate = weigh(calibrated, [lift])
    assert estimate.verdict is Verdict.ACCEPTED
    # that one pose leans on zeros is always so
    assert {reason.code for reason in estimate.reasons} <= {"leans_on_zero"}


def test_stuck(calibrated: Robot, lift: Run) -> None:
    estimate = weigh(calibrated, [shrunk(lift, 0.05)])
    assert (
        estimate.verdict is Verdict.NOT_IDENTIFIABLE
        and estimate.value("payload_mass").value is None
    )
    assert "so friction and not the weight decides where it is" in estimate.reasons[0]


@pytest.mark.parametrize(("share", "moves"), [(1.0, True), (0.7, False), (0.0, True)])
def test_a_joint_that_stands_still_where_the_others_say_it_moves(
    calibrated: Robot, lift: Run, share: float, moves: bool
) -> None:
    """Beside the current that lifts and none at all, 0.7 of it is within friction of what holds 20 g."""
    still = replace(
        shrunk(lift, 1e-3),
        name="still",
        input_current_A=share * lift.input_current_A,
    )
    estimate = weigh(calibrated, [lift, still])
    said = [reason for reason in estimate.reasons if "still: joint3 stood still with" in reason]
    assert (estimate.verdict is Verdict.REJECTED, bool(said)) == (moves, moves)
    assert not said or "it sticks, or leans on something" in said[0]


def test_little_travel(bags: Path, calibrated: Robot, robot: Robot) -> None:
    slow = run_of(bags, "realistic_s00_fixed_heavy_ball_50g_joint3", robot)  # 0.22 rad
    estimate = weigh(calibrated, [slow])
    assert estimate.verdict is Verdict.ACCEPTED
    assert any(
        "moved only 0.22 rad" in reason and "at least 0.3 rad" in reason
        for reason in estimate.reasons
    )


def test_joint_limit(calibrated: Robot, lift: Run) -> None:
    """The joint runs into its stop: the last samples stand still there."""
    stop = calibrated.model.joint("joint3").upper
    rest = float(np.mean(lift.before_position))
    up = 2.0 * rest - lift.position  # lifted the other way, so that it meets the upper stop
    moved = replace(
        lift,
        position=np.minimum(
            up + (stop - up[-4]),
            stop,
        ),
        before_position=2.0 * rest - lift.before_position + (stop - up[-4]),
    )
    estimate = weigh(calibrated, [moved])
    assert any(
        "joint3 reached its limit" in reason and "were left out" in reason
        for reason in estimate.reasons
    )


def test_start_at_a_limit(calibrated: Robot, lift: Run) -> None:
    lower = calibrated.model.joint("joint3").lower
    away = lower - float(np.mean(lift.before_position))
    resting = replace(
        lift, position=lift.position + away, before_position=lift.before_position + away
    )
    estimate = weigh(calibrated, [resting])
    assert any(
        "starts at its limit" in reason and "stop may carry" in reason
        for reason in estimate.reasons
    )


def test_current_limit(calibrated: Robot, lift: Run) -> None:
    strong = replace(lift, input_current_A=lift.input_current_A * 4.0)
    estimate = weigh(calibrated, [strong])
    assert any(
        "1205 mA were commanded, but joint3 is limited to 1000 mA" in reason
        for reason in estimate.reasons
    )


def test_supply_limit(bags: Path, calibrated: Robot, robot: Robot) -> None:
    fast = run_of(bags, "realistic_s00_fixed_reference_100g_joint3_x1", robot)
    estimate = weigh(calibrated, [fast])
    assert any(
        "passed 3.5 rad/s" in reason and "did not report the commanded current" in reason
        for reason in estimate.reasons
    )


def test_a_held_joint_that_moves(calibrated: Robot, lift: Run) -> None:
    span = {**lift.held_span, "joint2": 0.05}
    estimate = weigh(calibrated, [replace(lift, held_span=span)])
    assert any(
        "joint2 should be held but moved by 0.050 rad" in reason for reason in estimate.reasons
    )


@pytest.mark.long
def test_friction_never_reversed(bags: Path, robot: Robot, lift: Run) -> None:
    """Without a calibration, runs that all lift cannot separate friction from weight; one that lowers settles it."""
    again = run_of(bags, "realistic_s00_fixed_heavy_cube_23g_joint3", robot)
    lower = run_of(bags, "quantised_s00_fixed_heavy_cube_23g_joint3_x1", robot)
    sentence = (
        "joint3 only ever moved in the negative direction, so its friction was never seen reversed"
    )
    one_way = weigh(robot, [lift, again])
    assert any(sentence in reason for reason in one_way.reasons)
    wide = replace(
        robot,
        drive_trains={
            name: replace(d, coulomb=replace(d.coulomb, value=0.04, std=0.01))
            for name, d in robot.drive_trains.items()
        },
    )
    assert any(sentence in reason for reason in weigh(wide, [lift]).reasons)
    assert not any("only ever moved" in reason for reason in weigh(wide, [lift, lower]).reasons)


def test_friction_needs_no_reversal_where_it_was_calibrated(calibrated: Robot, lift: Run) -> None:
    assert not any("only ever moved" in reason for reason in weigh(calibrated, [lift]).reasons)


@pytest.mark.long
def test_contradicting_runs_are_named_with_both_masses(
    bags: Path, calibrated: Robot, robot: Robot, lift: Run
) -> None:
    runs = [
        run_of(bags, f"realistic_s00_fixed_{name}", robot)
        for name in ("heavy_cube_23g_joint3", "heavy_cube_23g_joint3_x0", "heavy_ball_50g_joint3")
    ]
    estimate = weigh(calibrated, [lift, *runs])
    assert estimate.verdict is Verdict.REJECTED and estimate.value("payload_mass").value is None
    sentence = estimate.reasons[0]
    assert "fixed_heavy_ball_50g_joint3/bag_mcap contradicts the other runs" in sentence
    said, others = (
        float(word.split(" g")[0]) for word in sentence.split("it says ")[1].split("they say ")
    )
    assert said == pytest.approx(50.0, abs=2.5) and others == pytest.approx(22.0, abs=2.0)


@pytest.mark.long
def test_runs_that_say_nearly_the_same_do_not_contradict_each_other(
    bags: Path, calibrated: Robot, robot: Robot
) -> None:
    """Torque that is 1 or 3 % off in one of three runs, on a robot that allows for none: the interval carries it, or not."""
    sure = replace(
        calibrated,
        residual_scale=0.5,
        torque_disturbance=1e-4,
        onset_jitter_s=0.0,
        stamp_jitter_s=1e-5,
    )
    runs = [
        run_of(bags, f"realistic_s00_fixed_reference_100g_{name}", robot)
        for name in ("joint2_x2", "joint2_x3", "joint3_x1")
    ]
    weaker = [
        *runs[:2],
        replace(
            runs[2],
            input_current_A=1.01 * runs[2].input_current_A,
        ),
    ]
    nearly = weigh(sure, weaker)
    (sentence,) = (reason for reason in nearly.reasons if "differs from the other runs" in reason)
    one, others = (
        float(word.split(" g")[0]) for word in sentence.split("it says ")[1].split("they say ")
    )
    mass = nearly.value("payload_mass")
    assert nearly.verdict is Verdict.ACCEPTED and 2.0 < abs(one - others) < 5.0
    assert mass.std > 0.5e-3 * abs(one - others) and mass.ci95[0] < 0.1 < mass.ci95[1]
    stronger = [
        replace(
            runs[0],
            input_current_A=1.03 * runs[0].input_current_A,
        ),
        *runs[1:],
    ]
    other = weigh(sure, stronger)
    assert other.verdict is Verdict.REJECTED and "contradicts the other runs" in other.reasons[0]


def test_an_empty_run_that_was_not_empty_is_named(
    bags: Path, calibrated: Robot, robot: Robot, lift: Run
) -> None:
    intruder = run_of(bags, "realistic_s00_fixed_light_cube_10g_joint3", robot)
    estimate = weigh(calibrated, [lift], baseline=[intruder])
    assert estimate.verdict is Verdict.REJECTED and estimate.reasons[0].startswith("drift")


def bumped(run: Run) -> Run:
    """Something hits the arm on its way."""
    rest = float(np.mean(run.before_position))
    away = run.position - rest
    away[10:] *= 0.4
    return replace(run, position=rest + away)


def test_misfit(calibrated: Robot, lift: Run) -> None:
    estimate = weigh(calibrated, [bumped(lift)])
    assert estimate.verdict is Verdict.REJECTED and estimate.value("payload_mass").value is None
    assert any(reason.startswith("misfit") for reason in estimate.reasons)
    assert not any(reason.code == "paused" for reason in estimate.reasons)


def test_a_pause_is_named_where_the_recording_is_rejected(calibrated: Robot, lift: Run) -> None:
    first, second = np.array_split(lift.times_s, 2)
    apart = np.concatenate([0.8 * first, lift.duration_s - 0.8 * (lift.duration_s - second)])
    estimate = weigh(
        calibrated,
        [replace(bumped(lift), name="paused", times_s=apart)],
    )
    last = estimate.reasons[-1]
    assert estimate.verdict is Verdict.REJECTED and last.code == "paused"
    assert last.startswith("paused: the joint states pause for ")


def test_uneven_stamps_are_named_where_the_recording_is_rejected(
    calibrated: Robot, lift: Run
) -> None:
    rng = np.random.default_rng(3)
    inner = lift.times_s[1:-1]
    shaken = inner + rng.uniform(
        -0.4,
        0.4,
        len(inner),
    ) * float(np.median(np.diff(inner)))
    times_s = np.concatenate([lift.times_s[:1], shaken, lift.times_s[-1:]])
    estimate = weigh(
        calibrated,
        [replace(lift, name="uneven", times_s=times_s)],
    )
    last = estimate.reasons[-1]
    assert estimate.verdict is Verdict.REJECTED and last.code == "uneven", estimate.reasons
    assert last.startswith("uneven: the joint states come every ") and " ms and scatter by " in last
    assert not any(reason.code == "uneven" for reason in weigh(calibrated, [bumped(lift)]).reasons)


def test_a_mass_on_the_bound_of_the_search() -> None:
    """A pendulum that swings down as with 50 kg at its tip, where at most 20 kg are searched."""
    pendulum = load_robot("pendulum")
    times = np.arange(1, 25) / 40.0
    still = Run(
        "heavy", "pivot", 0, times, np.full(24, 1.2), np.array([-0.1, -0.05]), np.full(2, 1.2), {}, {}, np.zeros(1),
        np.array([150.0]), 0.6, "test",
    )  # fmt: skip
    prepared = prepare_run(pendulum, still)
    facts = PayloadFacts()
    problem = Problem(
        pendulum,
        [prepared],
        facts,
        load_unknowns(
            pendulum,
            [prepared],
            facts,
            Role.ESTIMATED,
            1.0,
        ),
    )
    values = problem.base.copy()
    values[problem.index["payload_mass"]] = 50.0
    swung = replace(
        still,
        position=problem.simulate(values[None], problem.estimated)[0][0, 0],
    )
    estimate = weigh(pendulum, [swung])
    assert estimate.verdict is Verdict.REJECTED and estimate.value("payload_mass").value is None
    assert estimate.reasons[0].startswith("the mass ended on a bound of the search (20 kg)")
    assert "unit of current" in estimate.reasons[0]


def test_lighter_than_empty(calibrated: Robot, bags: Path, robot: Robot) -> None:
    """An empty hand that lifts a sixth faster than it did when the robot was calibrated."""
    empty = run_of(bags, "realistic_s00_empty_02_joint3", robot)
    estimate = weigh(
        calibrated,
        [replace(shrunk(empty, 1.15), reported_effort=None)],
    )
    assert estimate.verdict is Verdict.REJECTED and estimate.value("payload_mass").value is None
    assert (
        " g lighter than it was empty" in estimate.reasons[0]
        and "calibrate it again" in estimate.reasons[0]
    )


def test_not_calibrated(bags: Path, robot: Robot, calibrated: Robot) -> None:
    fast = run_of(bags, "realistic_s00_fixed_light_cube_10g_joint3", robot)
    sentence = "the robot has not been calibrated"
    assert any(sentence in reason for reason in weigh(robot, [fast]).reasons)
    assert not any(sentence in reason for reason in weigh(calibrated, [fast]).reasons)


def test_a_joint_that_was_not_calibrated(bags: Path, robot: Robot, lift: Run) -> None:
    known = [
        LoadedRun(run_of(bags, f"realistic_s00_empty_{n:02d}_joint2", robot)) for n in range(6, 12)
    ]
    shoulder = calibrate(robot, known).calibration
    assert shoulder is not None
    estimate = weigh(robot.with_calibration(shoulder), [lift])
    assert any("joint3 was not calibrated" in reason for reason in estimate.reasons)
    assert estimate.value("payload_mass").std > 5e-3
