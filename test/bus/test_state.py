"""One joint of the driver: what its servo is told, and what is said of it."""

from __future__ import annotations

import pytest

from proprio_ros.bus.control_table import XM430_W350
from proprio_ros.bus.dynamixel import BusServo, Goal
from proprio_ros.bus.state import FAR_COUNTS, DrivenJoint, JointMode
from proprio_ros.robot import load_robot

ROBOT = load_robot("open_manipulator_x")


def joint(name: str = "joint3") -> DrivenJoint:
    return DrivenJoint.of(ROBOT, BusServo(name, 13, XM430_W350))


def test_limits_count_at_the_shaft() -> None:
    slide = joint("gripper_left_joint")
    model = ROBOT.model.joint("gripper_left_joint")
    assert slide.lower_rad * slide.transmission == pytest.approx(model.lower)
    assert slide.upper_rad * slide.transmission == pytest.approx(model.upper)


@pytest.mark.parametrize(("current_A", "side"), [(0.3, 1), (-0.3, -1), (0.0, 0)])
def test_a_current_is_a_limit_with_a_goal_far_away_in_its_direction(
    current_A: float, side: int
) -> None:
    one = joint()
    one.mode = JointMode.DRIVEN
    one.commanded_A = current_A
    one.angle_rad = 0.5
    here = XM430_W350.counts_of_position(0.5)
    assert one.goal(stopped=False) == Goal(
        abs(XM430_W350.counts_of_current(current_A)), here + side * FAR_COUNTS
    )
    assert one.limp == (side == 0)
    # whatever it was doing, a stopped arm has no current
    assert one.goal(stopped=True) == Goal(0, here)


def test_a_joint_is_held_where_it_was_seen_within_its_limits() -> None:
    one = joint()
    one.mode = JointMode.DRIVEN
    one.commanded_A = 0.3
    one.angle_rad = one.upper_rad + 0.1
    one.hold()
    assert (one.mode, one.commanded_A, one.goal_rad, one.target_rad) == (
        JointMode.HELD,
        0.0,
        one.upper_rad,
        one.upper_rad,
    )
    most = XM430_W350.counts_of_current(one.current_limit_A)
    assert one.goal(stopped=False) == Goal(most, XM430_W350.counts_of_position(one.upper_rad))
    assert not one.limp


def test_a_joint_that_is_let_go_has_no_current() -> None:
    one = joint()
    one.angle_rad = 0.2
    one.let_go()
    assert one.limp
    assert one.goal(stopped=False) == Goal(0, XM430_W350.counts_of_position(0.2))


def test_a_current_below_half_a_count_pushes_nothing() -> None:
    one = joint()
    assert not one.pushed_by(0.4 * XM430_W350.current_unit_A)
    assert one.pushed_by(-0.6 * XM430_W350.current_unit_A)
