"""Gravity and inertia of an arm at rest, against derivatives of its potential energy and a second way to its kinetic energy."""

from __future__ import annotations

import math

import numpy as np
import pytest

from proprio_ros.robot import Robot, load_robot
from proprio_ros.robot.loads import Loads

POSE = {"joint1": 0.4, "joint2": -0.9, "joint3": 0.7, "joint4": 0.3, "gripper_left_joint": 0.005}
STEP = 1e-5


def potential_J(robot: Robot, pose: dict[str, float]) -> float:
    """Of all links, from their heights."""
    total = 0.0
    for link in robot.model.links:
        place = robot.model.frame_transform(link.name, pose)
        total -= float(robot.gravity @ (place @ link.pseudo_inertia[:, 3])[:3])
    return total


def kinetic_J(robot: Robot, pose: dict[str, float], joint: str) -> float:
    """Of all links, with one joint at 1 rad/s or 1 m/s: ``tr(Tdot P Tdot^T) / 2``, derivative by differences."""
    total = 0.0
    for link in robot.model.links:
        ahead, behind = (
            robot.model.frame_transform(link.name, {**pose, joint: pose[joint] + s}) for s in (STEP, -STEP)
        )
        rate = (ahead - behind) / (2.0 * STEP)
        total += 0.5 * float(np.trace(rate @ link.pseudo_inertia @ rate.T))
    return total


def test_gravity_is_the_slope_of_the_potential_energy_and_inertia_twice_the_kinetic() -> None:
    robot = load_robot("open_manipulator_x")
    effort, inertia = Loads(robot).at(POSE)
    assert set(effort) == set(robot.model.independent_joints)
    for name in effort:
        ahead, behind = (potential_J(robot, {**POSE, name: POSE[name] + s}) for s in (STEP, -STEP))
        assert effort[name] == pytest.approx((ahead - behind) / (2.0 * STEP), abs=1e-7)
        # fingers that follow move the other way: their cross term vanishes
        assert inertia[name] == pytest.approx(2.0 * kinetic_J(robot, POSE, name), rel=1e-6, abs=1e-9)
    assert min(abs(effort[name]) for name in ("joint2", "joint3", "joint4")) > 0.05


def test_all_masses_scale_together() -> None:
    heavy = load_robot("open_manipulator_x", {"arm_scale": 1.1})
    effort, inertia = Loads(load_robot("open_manipulator_x")).at(POSE)
    scaled, moved = Loads(heavy).at(POSE)
    assert scaled["joint3"] == pytest.approx(1.1 * effort["joint3"])
    assert math.isclose(moved["joint3"], 1.1 * inertia["joint3"])
