"""What the driven joint moves: as a sum of links, and as locked joints move."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from proprio_ros.experiment_design.candidates import still_run
from proprio_ros.identification.coefficients import (
    LINK_TERMS,
    arm_coefficients,
    link_stds,
    slide_coefficients,
)
from proprio_ros.robot import Robot, load_robot

POSE = {"joint1": 0.0, "joint2": -0.8, "joint3": 0.6, "joint4": 0.4, "gripper_left_joint": 0.0}
LOCKED = ["joint1", "joint2", "joint4", "gripper_left_joint"]


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("open_manipulator_x")


def test_the_arm_is_the_sum_of_its_links(robot: Robot) -> None:
    found = arm_coefficients(
        robot,
        still_run("joint3", POSE, 0.1, 0.6),
        LOCKED,
    )
    by_mass = [
        row
        for key, row in zip(found.links, found.arm_by_link, strict=True)
        if key[0] == "link_mass"
    ]
    np.testing.assert_allclose(
        np.sum(by_mass, axis=0),
        found.arm,
        rtol=1e-3,
        atol=1e-6,
    )
    assert set(link_stds(robot, robot.model.links[0])) == set(LINK_TERMS)


def test_a_locked_joint_that_stands_elsewhere(robot: Robot) -> None:
    run = still_run("joint3", POSE, 0.1, 0.6)
    off = 1e-3
    found = arm_coefficients(robot, run, LOCKED)
    assert "joint4" in found.pose and "joint1" not in found.pose
    moved = arm_coefficients(
        robot,
        replace(
            run,
            held={**run.held, "joint4": POSE["joint4"] + off},
        ),
        LOCKED,
    )
    at = found.pose.index("joint4")
    np.testing.assert_allclose(
        (moved.arm - found.arm) / off, found.arm_by_pose[at], rtol=1e-2, atol=1e-5
    )
    np.testing.assert_allclose(
        (moved.payload - found.payload) / off, found.payload_by_pose[at], rtol=1e-2, atol=1e-3
    )


def test_fingers_weigh_what_they_move_per_turn_of_the_shaft(robot: Robot) -> None:
    found = slide_coefficients(robot, still_run("gripper_left_joint", POSE, 0.1, 0.6))
    per_rad = robot.drive_trains["gripper_left_joint"].transmission
    fingers = sum(
        float(link.pseudo_inertia[3, 3])
        for link in robot.model.links
        if link.name.startswith("gripper_")
    )
    assert found.arm[0] == pytest.approx(fingers * per_rad**2, rel=1e-6)
    assert not found.payload.any() and not found.pose and not found.links
