"""What is open about the robot: from its file, from its calibration, and of each run on its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from proprio_ros.calibration_files.pushes import Calibration
from proprio_ros.experiment_design.candidates import still_run
from proprio_ros.identification.prepared_runs import KnownLoad, PreparedRun, prepare_run
from proprio_ros.identification.problem import Problem
from proprio_ros.identification.robot_unknowns import load_unknowns, robot_unknowns
from proprio_ros.identification.run_kinds import PUSH
from proprio_ros.identification.unknowns import Role
from proprio_ros.records import MEASURED_EFFORT
from proprio_ros.robot import Robot, load_robot
from proprio_ros.sim.payload import PayloadFacts

POSE = {"joint1": 0.0, "joint2": -1.0, "joint3": 0.6, "joint4": 0.4, "gripper_left_joint": 0.0}


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("open_manipulator_x")


@pytest.fixture(scope="module")
def runs(robot: Robot) -> list[PreparedRun]:
    return [
        prepare_run(robot, still_run(joint, POSE, 0.1, 0.6), KnownLoad())
        for joint in ("joint2", "joint3")
    ]


def test_a_calibration_says_more_than_the_file(robot: Robot, runs: list[PreparedRun]) -> None:
    key = ("coulomb", "joint3")
    known = robot.with_calibration(
        Calibration(
            (key,),
            np.array([0.05]),
            np.array([[1e-6]]),
        )
    )
    (before,), (after,) = (
        [u for u in robot_unknowns(r, runs, Role.ESTIMATED) if u.key == key] for r in (robot, known)
    )
    assert (after.value, after.std) == (0.05, pytest.approx(1e-3)) and before.std > after.std


def test_a_frozen_robot_still_starts_where_it_starts(robot: Robot, runs: list[PreparedRun]) -> None:
    unknowns = load_unknowns(robot, runs, PayloadFacts(), Role.FIXED, 0.05)
    free = {u.key for u in unknowns if u.role is Role.ESTIMATED}
    assert free == {"payload_mass", *((kind, row) for kind in ("q0", "v0") for row in range(2))}


def test_an_onset_that_is_only_measured_is_known_to_a_period(
    robot: Robot, runs: list[PreparedRun]
) -> None:
    measured = replace(
        runs[0],
        run=replace(runs[0].run, source=MEASURED_EFFORT),
    )
    period = float(np.median(np.diff(measured.run.times_s)))
    assert PUSH.repeats(robot, measured)["onset"] == pytest.approx(
        float(np.hypot(PUSH.repeats(robot, runs[0])["onset"], 0.5 * period))
    )


def test_motors_of_one_kind_err_together_before_anything_is_learnt(
    robot: Robot, runs: list[PreparedRun]
) -> None:
    problem = Problem(
        robot,
        runs,
        PayloadFacts(),
        robot_unknowns(robot, runs, Role.ESTIMATED),
    )
    free = problem.estimated_unknowns()
    own = [f for f, unknown in enumerate(free) if unknown.kind == "torque_constant"]
    prior = np.linalg.inv(problem.coordinates.prior_precision[np.ix_(own, own)])
    std = np.array([free[f].std for f in own])
    np.testing.assert_allclose(
        prior / np.outer(std, std),
        [[1.0, 0.5], [0.5, 1.0]],
        atol=1e-9,
    )
