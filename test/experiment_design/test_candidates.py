"""Pushes that could be made stay inside the limits, and their currents move what they are to move."""

from __future__ import annotations

import numpy as np
import pytest

from proprio_ros.experiment_design.candidates import (
    CLEARANCE_M,
    LIMIT_MARGIN,
    MOST_POSES,
    PUSHES,
    Push,
    best_first,
    candidate_joints,
    currents_beyond,
    expected_coulomb,
    shuffled,
    start_poses,
    still_run,
)
from proprio_ros.identification.prepared_runs import KnownLoad, prepare_run
from proprio_ros.identification.problem import Problem
from proprio_ros.identification.robot_unknowns import robot_unknowns
from proprio_ros.identification.unknowns import Role
from proprio_ros.robot import Robot, load_robot
from proprio_ros.robot.kinematics import clearance
from proprio_ros.sim.payload import PayloadFacts

POSE = {"joint1": 0.0, "joint2": -1.0, "joint3": 0.6, "joint4": 0.4, "gripper_left_joint": 0.0}


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("open_manipulator_x")


def test_joints_that_feel_the_hand() -> None:
    """The base turns about the vertical, and the gripper's fingers slide: neither weighs."""
    assert candidate_joints(load_robot("open_manipulator_x")) == ["joint2", "joint3", "joint4"]
    assert candidate_joints(load_robot("pendulum")) == ["pivot"]


def test_start_poses_keep_off_the_limits_and_the_plane(robot: Robot) -> None:
    poses = start_poses(robot, "joint3", 5, 2)
    limits = robot.model.joint("joint3")
    assert len({pose["joint3"] for pose in poses}) >= 3
    for pose in poses:
        assert clearance(robot, pose) >= CLEARANCE_M
        assert limits.lower + LIMIT_MARGIN <= pose["joint3"] <= limits.upper - LIMIT_MARGIN


def test_every_current_moves_whatever_of_the_masses_it_carries(robot: Robot) -> None:
    run = prepare_run(
        robot,
        still_run("joint3", POSE, 0.01, 0.6),
        KnownLoad(),
    )
    facts = PayloadFacts()
    masses = (0.0, 0.1)
    found = list(currents_beyond(run, facts, masses))
    assert [push for push, _, _ in found] == [*PUSHES, *PUSHES]
    loads = [
        run.weight_at_rest(run.coefficients.arm + mass * run.coefficients.per_kg(facts))
        for mass in masses
    ]
    constant = run.drive.torque_constant.value
    dry = run.drive.coulomb.value
    for number, (_, current, largest) in enumerate(found):
        over = np.array([constant * current - load for load in loads])
        assert np.all(over > dry) if number < len(PUSHES) else np.all(over < -dry)
        assert largest >= np.abs(loads).max() - 1e-12


def test_open_friction_is_half_as_large_as_it_may_be(robot: Robot) -> None:
    run = prepare_run(
        robot,
        still_run("joint3", POSE, 0.01, 0.6),
        KnownLoad(),
    )
    problem = Problem(
        robot,
        [run],
        PayloadFacts(),
        robot_unknowns(robot, [run], Role.ESTIMATED),
    )
    coulomb = robot.drive_trains["joint3"].coulomb
    assert coulomb.value < coulomb.std
    assert expected_coulomb(problem, "joint3") == pytest.approx(coulomb.value + 0.5 * coulomb.std)


def test_the_quickest_that_is_enough_comes_first() -> None:
    slow, quick, vague = (
        Push("joint3", POSE, 0.1, 0.0, 0.5, time_s, std, 1.0, 0.4)
        for time_s, std in ((5.0, 1e-3), (3.0, 1.5e-3), (1.0, 9e-3))
    )
    assert best_first([vague, slow, quick], 2e-3) == [quick, slow, vague]


def test_a_grid_is_gone_through_once_and_a_large_one_in_part() -> None:
    places = [tuple(place.values()) for place in shuffled({"a": [1.0, 2.0], "b": [3.0, 4.0, 5.0]})]
    assert len(places) == len(set(places)) == 6 and places != sorted(places)
    assert sum(1 for _ in shuffled({str(axis): [0.0, 1.0] for axis in range(40)})) == MOST_POSES
