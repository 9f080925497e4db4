"""A virtual arm behind a position controller: servos that make a voltage of the distance to their goal."""

from __future__ import annotations

import math

import numpy as np
import pytest

pytest.importorskip("mujoco")

from proprio_ros.errors import ConfigurationError
from proprio_ros.robot import load_robot
from proprio_ros.virtual.effort_driver import FOREIGN_JOINTS, PositionDriver
from proprio_ros.virtual.truth import ALIKE, Truth

ROBOT = load_robot("so101")
ORDER = ("wrist_flex", "elbow_flex", "shoulder_pan", "wrist_roll", "gripper", "shoulder_lift")


def test_it_stays_until_the_first_goals_and_ignores_what_is_not_whole() -> None:
    driver = PositionDriver(
        ROBOT,
        Truth.nominal(ROBOT),
        joints=ORDER,
    )
    driver.advance(1.0)
    driver.advance(1.2)
    assert set(driver.arm.position().values()) == {0.0}, "somebody holds it"
    for wrong in ([0.1], [0.1] * 7, [math.nan, *[0.0] * 5]):
        assert not driver.command(1.2, wrong)
    positions, velocities, efforts = driver.states()
    assert len(positions) == len(ORDER) + len(FOREIGN_JOINTS)
    assert np.isnan(velocities).all() and np.isnan(efforts).all(), "such servos state neither"


def test_goals_are_in_the_controllers_order_and_the_arm_hangs_below_them_by_the_servos_law() -> (
    None
):
    driver = PositionDriver(
        ROBOT,
        Truth.nominal(ROBOT),
        joints=ORDER,
    )
    driver.advance(1.0)
    assert driver.command(1.0, [0.0, 0.0, 0.5, 0.0, 0.0, 0.0])
    fastest = 0.0
    for step in range(1, 100):
        driver.advance(1.0 + 0.02 * step)
        fastest = max(
            fastest,
            float(np.abs(driver.arm.velocity_rad_s()).max()),
        )
    position = driver.arm.position()
    assert position["shoulder_pan"] == pytest.approx(0.5, abs=0.02)
    assert fastest < 5.4, "as fast as a servo of 7.4 V"
    # 0.45 N m by the URDF, 8.9 N m/rad, and friction of 0.05 N m
    assert position["elbow_flex"] == pytest.approx(0.45 / 8.9, abs=0.012)
    _, currents = driver.truth()
    assert currents["elbow_flex"] == pytest.approx(
        2.656 * -position["elbow_flex"] * 7.4 / 2.68, rel=0.05
    )


def test_a_joint_of_somebody_elses_stays_where_it_was() -> None:
    driver = PositionDriver(
        ROBOT, Truth.nominal(ROBOT), joints=["shoulder_pan"], position={"wrist_roll": 0.4}
    )
    driver.advance(1.0)
    assert driver.command(1.0, [0.3])
    driver.advance(1.4)
    assert driver.arm.position()["wrist_roll"] == pytest.approx(0.4, abs=0.02)


def test_what_is_no_position_servo_is_refused() -> None:
    robot = load_robot("open_manipulator_x")
    with pytest.raises(ConfigurationError, match="choose interface:=effort_controller"):
        PositionDriver(robot, Truth.nominal(robot))


def test_servos_of_one_arm_are_alike() -> None:
    constants = np.array(
        [
            [joint.torque_constant for joint in Truth.draw(ROBOT, seed).joints.values()]
            for seed in range(40)
        ]
    )
    means = constants.mean(axis=1)
    assert 0.06 < means.std() / 1.21 < 0.14, "off together: 0.3 of 33 %"
    assert (constants / means[:, None]).std() == pytest.approx(ALIKE, rel=0.2)
