"""Ways between poses: how long they take, where they lead, and what is too low."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from proprio_ros.errors import ExcitationError
from proprio_ros.excitation.plans import load_sequence
from proprio_ros.excitation.ways import MIN_APPROACH_S, PEAK_OVER_MEAN, Way, Ways, approach_s
from proprio_ros.robot import load_robot

ROBOT = load_robot("open_manipulator_x")
WAYS = Ways(ROBOT)
GRIPPER = "gripper_left_joint"
HIGH = {
    "joint1": 0.0,
    "joint2": -0.8,
    "joint3": 0.4,
    "joint4": 0.3,
    GRIPPER: 0.004,
}
SEQUENCE = load_sequence("payload_elbow", ROBOT)


def test_a_way_begins_and_ends_at_rest_and_its_peak_speed_is_the_one_that_was_asked_for() -> None:
    after = {**HIGH, "joint1": 1.2}
    way = WAYS.find(
        HIGH,
        after,
        replace(SEQUENCE, approach_velocity=0.8),
        "there",
    )
    assert way.duration_s == pytest.approx(PEAK_OVER_MEAN * 1.2 / 0.8)
    assert way.at(0.0) == HIGH
    assert way.at(way.duration_s) == after
    assert way.at(99.0) == after
    times = np.linspace(0.0, way.duration_s, 2001)
    speeds = np.gradient(
        [way.at(time)["joint1"] for time in times],
        times,
    )
    assert speeds.max() == pytest.approx(0.8, rel=1e-4)
    assert abs(speeds[[0, -1]]).max() < 1e-5


def test_a_short_way_takes_its_time_and_a_way_of_one_pose_none() -> None:
    assert approach_s(1e-4, 0.8) == MIN_APPROACH_S
    still = Way((HIGH,))
    assert still.duration_s == 0.0
    assert still.at(0.3) == HIGH


def test_a_slide_counts_at_the_shaft_of_its_motor() -> None:
    per_rad = abs(ROBOT.drive_trains[GRIPPER].transmission)
    assert WAYS.per_rad[GRIPPER] == per_rad
    assert WAYS.per_rad["joint2"] == 1.0
    joint = ROBOT.model.joint(GRIPPER)
    assert WAYS.limits(GRIPPER, 0.1) == (joint.lower + 0.1 * per_rad, joint.upper - 0.1 * per_rad)


def test_a_way_that_comes_too_low_goes_over_a_higher_pose_and_none_may_keep_the_clearance() -> None:
    low = {
        **HIGH,
        "joint2": 1.4,
        "joint3": -0.2,
        "joint4": 0.6,
    }
    assert WAYS.height(low) < 0.05 < WAYS.height(HIGH)
    assert not WAYS.clear((HIGH, low), 0.05)
    with pytest.raises(
        ExcitationError, match="no way to there keeps the arm 5 cm above the base's plane"
    ):
        WAYS.find(
            HIGH,
            low,
            replace(SEQUENCE, min_clearance_m=0.05),
            "there",
        )
    # an arm that begins too low may rise, and only rise
    assert WAYS.clear((low, HIGH), 0.05)
    crossing = {
        **HIGH,
        "joint2": 0.9,
        "joint3": -1.2,
        "joint4": 1.5,
    }
    way = WAYS.find(
        crossing, {**crossing, "joint1": 1.0}, replace(SEQUENCE, min_clearance_m=0.0), "there"
    )
    assert all(WAYS.height(pose) >= 0.0 for pose in way.poses)
