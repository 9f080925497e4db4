"""Gravity and inertia of an arm at rest, against derivatives of its potential energy and a second way to its kinetic energy."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from support import small_urdf
from support.small_urdf import chain, joint

from proprio_ros.identification.locked_joints import joint_torque
from proprio_ros.robot import Robot, load_robot, with_recorded_torque
from proprio_ros.robot.loads import Loads

POSE = {"joint1": 0.4, "joint2": -0.9, "joint3": 0.7, "joint4": 0.3, "gripper_left_joint": 0.005}
STEP = 1e-5


def potential_J(
    robot: Robot,
    pose: dict[str, float],
) -> float:
    """Of all links, from their heights."""
    total = 0.0
    for link in robot.model.links:
        place = robot.model.frame_transform(link.name, pose)
        total -= float(robot.gravity @ (place @ link.pseudo_inertia[:, 3])[:3])
    return total


def kinetic_J(
    robot: Robot,
    pose: dict[str, float],
    joint: str,
) -> float:
    """Of all links, with one joint at 1 rad/s or 1 m/s: ``tr(Tdot P Tdot^T) / 2``, derivative by differences."""
    total = 0.0
    for link in robot.model.links:
        ahead, behind = (
            robot.model.frame_transform(link.name, {**pose, joint: pose[joint] + s})
            for s in (STEP, -STEP)
        )
        rate = (ahead - behind) / (2.0 * STEP)
        total += 0.5 * float(np.trace(rate @ link.pseudo_inertia @ rate.T))
    return total


def test_gravity_is_the_slope_of_the_potential_energy_and_inertia_twice_the_kinetic() -> None:
    robot = load_robot("open_manipulator_x")
    effort, inertia, *_ = Loads(robot).at(POSE)
    assert set(effort) == set(robot.model.independent_joints)
    for name in effort:
        ahead, behind = (potential_J(robot, {**POSE, name: POSE[name] + s}) for s in (STEP, -STEP))
        assert effort[name] == pytest.approx((ahead - behind) / (2.0 * STEP), abs=1e-7)
        assert inertia[name] == pytest.approx(
            2.0 * kinetic_J(robot, POSE, name), rel=1e-6, abs=1e-9
        )
    assert min(abs(effort[name]) for name in ("joint2", "joint3", "joint4")) > 0.05


def test_a_joint_whose_followers_it_carries_moves_them_with_what_is_common(tmp_path: Path) -> None:
    """As fingers of several links do: each link bends by a part of the one before."""
    links = [small_urdf.link(name) for name in ("base", "one", "two", "three")]
    away = '<origin xyz="0.3 0.1 0"/><parent'
    joints = (
        joint("a", axis="0 1 0"),
        joint("b", "one", "two", axis="0 1 0", mimic='<mimic joint="a" multiplier="0.7"/>'),
        joint("c", "two", "three", mimic='<mimic joint="b" multiplier="-2" offset="0.3"/>'),
    )
    placed = [text.replace("<parent", away, 1) for text in joints]
    path = tmp_path / "arm.urdf"
    path.write_text(chain(*placed, links="".join(links)))
    robot = load_robot(path, with_recorded_torque(path, {}))
    pose = {"a": 0.4}
    load = Loads(robot).at(pose)
    ahead = potential_J(robot, {"a": pose["a"] + STEP})
    behind = potential_J(robot, {"a": pose["a"] - STEP})
    slope = (ahead - behind) / (2.0 * STEP)
    twice = 2.0 * kinetic_J(robot, pose, "a")
    assert load.gravity["a"] == pytest.approx(slope, abs=1e-6)
    assert load.inertia["a"] == pytest.approx(twice, rel=1e-6)


def test_what_the_hand_holds_pulls_where_the_hand_is() -> None:
    robot = load_robot("open_manipulator_x")
    held_kg = 0.3
    empty = Loads(robot).at(POSE)
    loaded = Loads(robot).at(POSE, held_kg)
    for name, effort in empty.gravity.items():
        heights = [
            robot.model.frame_transform(robot.payload_frame, {**POSE, name: POSE[name] + s})[2, 3]
            for s in (STEP, -STEP)
        ]
        lever_m = (heights[0] - heights[1]) / (2.0 * STEP)
        assert loaded.per_kg[name] == pytest.approx(9.81 * lever_m, rel=1e-3, abs=1e-6)
        assert loaded.gravity[name] == pytest.approx(
            effort + held_kg * loaded.per_kg[name], abs=1e-9
        )
    reach_m = np.linalg.norm(robot.model.frame_transform(robot.payload_frame, POSE)[:2, 3])
    assert loaded.inertia["joint1"] - empty.inertia["joint1"] == pytest.approx(
        held_kg * reach_m**2, rel=0.2
    )


def test_all_masses_scale_together() -> None:
    heavy = load_robot("open_manipulator_x", {"arm_scale": 1.1})
    effort, inertia, *_ = Loads(load_robot("open_manipulator_x")).at(POSE)
    scaled, moved, *_ = Loads(heavy).at(POSE)
    assert scaled["joint3"] == pytest.approx(1.1 * effort["joint3"])
    assert math.isclose(moved["joint3"], 1.1 * inertia["joint3"])


def test_a_joint_that_moves_pulls_at_the_others_as_the_equations_of_motion_say() -> None:
    robot = load_robot("open_manipulator_x")
    gravity, _, reactions, _ = Loads(robot).at(POSE)
    names = ("joint1", "joint2", "joint3", "joint4")
    held = {name: value for name, value in POSE.items() if name not in names}
    model = robot.model.lock(names, held, robot.gravity)
    speed = 2.3
    acceleration = -7.0
    for moved in names:
        motions = [
            tuple(
                np.array([value])
                for value in (POSE[name], speed * (name == moved), acceleration * (name == moved))
            )
            for name in model.joint_names
        ]
        for name in names:
            if name == moved:
                continue
            row = model.joint_names.index(name)
            torque = float(
                joint_torque(model, motions, row, np.array([model.pseudo_inertia]))[0, 0]
            )  # type: ignore[arg-type]
            by_acceleration, by_speed = reactions[moved][name]
            expected = by_acceleration * acceleration + by_speed * speed**2
            assert gravity[name] + expected == pytest.approx(torque, abs=1e-9), (moved, name)
    assert abs(reactions["joint3"]["joint2"][0]) > 1e-3
