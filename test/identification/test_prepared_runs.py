"""Runs made ready: where the joint rests, which samples count, and what cannot be related to the robot."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import spearmanr

from proprio_ros.errors import RecordingError
from proprio_ros.experiment_design.candidates import still_run
from proprio_ros.identification.prepared_runs import (
    KnownLoad,
    joints_of,
    prepare_run,
    rank_correlation,
)
from proprio_ros.recordings.runs import cut_runs
from proprio_ros.recordings.signals import read_recording
from proprio_ros.records import Run
from proprio_ros.robot import Robot, load_robot

POSE = {"joint1": 0.0, "joint2": -1.0, "joint3": 0.6, "joint4": 0.4, "gripper_left_joint": 0.0}


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("open_manipulator_x")


def moving(speed: float, joint: str = "joint3") -> Run:
    """A joint that goes at one speed [rad/s] for 0.6 s."""
    run = still_run(joint, POSE, 0.1, 0.6)
    return replace(run, position=run.position + speed * run.times_s)


@pytest.mark.parametrize(
    "name", ["quantised_s00_fixed_heavy_ball_50g_joint3", "realistic_s00_squeeze_heavy"]
)
def test_the_rest_is_where_the_joint_had_come_to_rest(name: str) -> None:
    """The way to the start, where it was recorded, too, is left out; a joint that never rested keeps all of it."""
    robot = load_robot("open_manipulator_x")
    bag = Path(__file__).resolve().parents[2] / "bags" / name / "bag_mcap"
    constants = {
        joint: drive.nominal_effort_per_current for joint, drive in robot.drive_trains.items()
    }
    recording = read_recording(
        bag, nominal_torque_constants=constants, joint_order=list(robot.drive_trains)
    )
    (run,) = cut_runs(recording, joints=list(robot.drive_trains))
    per_rad = robot.drive_trains[run.joint].transmission

    def rest_of(before_s: np.ndarray, before_rad: np.ndarray) -> float:
        told = replace(
            run, before_times_s=before_s, before_position=per_rad * before_rad, held_position={}
        )
        return prepare_run(robot, told, KnownLoad(), past_fast=True).rest.value

    still_s = run.before_times_s
    still = run.before_position / per_rad
    alone = rest_of(still_s, still)
    assert alone == pytest.approx(float(np.mean(still)), abs=1e-12)
    way_s = still_s[0] + 0.025 * np.arange(-12, 0)
    way = still[0] + np.linspace(0.4, 0.02, 12)
    assert rest_of(np.concatenate([way_s, still_s]), np.concatenate([way, still])) == alone
    moving = still - 0.5 * still_s
    assert rest_of(still_s, moving) == pytest.approx(float(np.mean(moving)), abs=1e-12)


def test_samples_past_the_limit_do_not_count(robot: Robot) -> None:
    room = robot.model.joint("joint3").upper - POSE["joint3"]
    run = prepare_run(robot, moving(2.0), KnownLoad())
    assert "reached its limit" in run.cut_reason
    assert run.times_s[-1] == pytest.approx(room / 2.0, abs=0.05) and np.all(
        run.position < POSE["joint3"] + room
    )
    assert prepare_run(robot, moving(0.5), KnownLoad()).cut_reason == ""


def test_a_fast_sample_counts_where_the_motor_reports_the_commanded_current(robot: Robot) -> None:
    joint = "joint1"
    fast = 1.2 * robot.drive_trains[joint].usable_velocity
    run = moving(1.0, joint)
    run = replace(
        run,
        position=np.where(
            run.times_s < 0.3, run.position, run.position + (fast - 1.0) * (run.times_s - 0.3)
        ),
    )
    cut = prepare_run(robot, run, KnownLoad())
    assert (
        "reached its limit" not in cut.cut_reason and "supply may no longer drive" in cut.cut_reason
    )
    assert 0.2 < cut.times_s[-1] < 0.35
    told = prepare_run(
        robot,
        replace(
            run,
            reported_effort=np.full(len(run.times_s), 0.1),
        ),
        KnownLoad(),
    )
    assert told.cut_reason == ""
    assert told.used > cut.used
    assert not told.limited
    anyway = prepare_run(robot, run, KnownLoad(), past_fast=True)
    assert anyway.used == told.used and anyway.limited


def test_what_cannot_be_related_to_the_robot_is_said(robot: Robot) -> None:
    run = moving(0.5)
    with pytest.raises(RecordingError, match="no drive train for it"):
        prepare_run(robot, replace(run, joint="elbow"))
    with pytest.raises(RecordingError, match=r"--set held\.joint2=VALUE"):
        prepare_run(
            robot,
            replace(
                run,
                held={name: q for name, q in run.held.items() if name != "joint2"},
            ),
        )
    with pytest.raises(RecordingError, match="does not move"):
        prepare_run(robot, still_run("gripper_left_joint", POSE, 0.1, 0.6))


def test_a_slide_is_seen_at_the_motors_shaft(robot: Robot) -> None:
    per_rad = robot.drive_trains["gripper_left_joint"].transmission
    run = replace(
        moving(0.0, "gripper_left_joint"),
        position=per_rad * 0.1 * np.arange(24),
    )
    run = replace(run, before_position=np.zeros_like(run.before_position))
    prepared = prepare_run(robot, run, KnownLoad())
    np.testing.assert_allclose(
        prepared.position,
        0.1 * np.arange(prepared.used),
        atol=1e-12,
    )
    assert joints_of([prepared, prepared]) == ("gripper_left_joint",)


def test_what_the_hand_weighs_at_rest(robot: Robot) -> None:
    """One kilogram in the hand: its weight times the horizontal distance to the elbow's axis."""
    run = prepare_run(robot, moving(0.5), KnownLoad())
    there, axis = (
        robot.model.frame_transform(link, POSE)[:3, 3]
        for link in (robot.payload_frame, robot.model.joint("joint3").child)
    )
    gravity = float(np.linalg.norm(robot.gravity))
    away = float(np.linalg.norm((there - axis)[:2]))
    assert abs(run.weight_at_rest(run.coefficients.per_kg(KnownLoad().facts))) == pytest.approx(
        gravity * away, rel=1e-6
    )
    assert run.torque_stds.shape == (3,)
    assert np.all(run.torque_stds >= 0.0)


@pytest.mark.parametrize("few", [4, 60])
def test_ranks_are_correlated_as_scipy_says(few: int) -> None:
    rng = np.random.default_rng(few)
    one = rng.integers(0, few, 30).astype(float)
    other = one + rng.integers(0, few, 30)
    assert rank_correlation(one, other) == pytest.approx(spearmanr(one, other).statistic)
    assert rank_correlation(one, np.ones(30)) == 0.0


def alternating(effort_A: np.ndarray) -> Run:
    """A joint that hardly moves, driven one way and the other, 0.1 s each; its effort [A] at each sample."""
    run = moving(0.01)
    steps = 6
    return replace(
        run,
        input_times_s=0.1 * np.arange(steps),
        input_current_A=np.resize([0.011, -0.027], steps),
        reported_effort=np.resize(effort_A, len(run.times_s)),
    )


def test_an_excitation_that_alternates_is_no_noise(robot: Robot) -> None:
    at = np.minimum((moving(0.01).times_s / 0.1).astype(int), 5)
    follows = np.resize([0.011, -0.027], 6)[at]
    driven = prepare_run(robot, alternating(follows), KnownLoad())
    assert len(driven.run.input_current_A) == 6
    steady = prepare_run(robot, alternating(np.array([-0.008])), KnownLoad())
    assert len(steady.run.input_current_A) == 1, "the motor never followed: its mean is taken"
