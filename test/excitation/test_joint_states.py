"""Joint states as other drivers publish them, made into samples."""

from __future__ import annotations

import math

import pytest

from proprio_ros.excitation.commands import JointStates

ARM = ("joint1", "joint2", "gripper")


def test_what_the_driver_states_is_what_the_machine_gets() -> None:
    sample = JointStates(ARM, 0.1).add(
        5.0,
        ARM,
        [0.1, 0.2, 0.3],
        [1.0, 2.0, 3.0],
    )
    assert sample is not None
    assert sample.time_s == 5.0
    assert sample.position == {"joint1": 0.1, "joint2": 0.2, "gripper": 0.3}
    assert sample.velocity == {"joint1": 1.0, "joint2": 2.0, "gripper": 3.0}


@pytest.mark.parametrize(
    "velocity",
    [[math.nan] * 3, []],
    ids=["nan", "none"],
)
def test_velocities_that_are_not_stated_follow_from_the_positions(velocity: list[float]) -> None:
    states = JointStates(ARM, 0.1)
    for row in range(11):  # 2 rad/s, and every second message comes right after the one before
        now_s = 0.01 * (row - row % 2) + 0.001 * (row % 2)
        sample = states.add(
            now_s,
            ARM,
            [2.0 * now_s, 0.5, 0.0],
            velocity,
        )
    assert sample is not None
    assert sample.velocity == pytest.approx({"joint1": 2.0, "joint2": 0.0, "gripper": 0.0})


def test_a_position_that_is_no_number_is_passed_on() -> None:
    states = JointStates(ARM, 0.1)
    states.add(0.0, ARM, [0.0, 0.0, 0.0])
    sample = states.add(
        0.05,
        ARM,
        [math.nan, 0.0, 0.0],
    )
    assert sample is not None
    assert math.isnan(sample.position["joint1"])
    assert sample.velocity["joint1"] == 0.0


def test_other_joints_on_the_topic_change_nothing() -> None:
    states = JointStates(ARM, 0.1)
    assert states.add(0.0, ["wheel_left", "wheel_right"], [100.0, -100.0]) is None
    first = states.add(
        0.01,
        ["wheel_left", *ARM],
        [100.0, 0.1, 0.2, 0.3],
        [9.0, 1.0, 2.0, 3.0],
    )
    assert first is not None
    assert set(first.position) == set(ARM) == set(first.velocity)
    assert states.add(0.02, ["wheel_left"], [math.nan]) is None


def test_arm_and_gripper_from_two_publishers() -> None:
    states = JointStates(ARM, 0.1)
    alone = states.add(
        0.0,
        ["joint1", "joint2"],
        [0.1, 0.2],
        [0.0, 0.0],
    )
    assert alone is not None and "gripper" not in alone.position, (
        "the machine says which joint is missing"
    )
    states.add(
        0.05,
        ["gripper"],
        [0.01],
        [0.0],
    )
    both = states.add(
        0.06,
        ["joint1", "joint2"],
        [0.3, 0.4],
        [0.0, 0.0],
    )
    assert both is not None
    assert both.time_s == 0.06
    assert both.position == {"joint1": 0.3, "joint2": 0.4, "gripper": 0.01}


def test_a_publisher_that_falls_silent_is_noticed_beside_one_that_goes_on() -> None:
    states = JointStates(ARM, 0.1)
    states.add(
        0.0,
        ["joint1", "joint2"],
        [0.1, 0.2],
    )
    for row in range(1, 31):
        sample = states.add(
            0.01 * row,
            ["gripper"],
            [0.01],
        )
    assert sample is None
