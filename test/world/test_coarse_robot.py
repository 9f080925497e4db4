"""The robot of the schedules, whose servos and arm move on by 2 ms, beside the one that moves on as finely as it should."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

from support.simulated_port import simulated
from support.simulated_world import CoarseRobot

from proprio_ros.bus.control_table import OperatingMode
from proprio_ros.robot import load_robot
from proprio_ros.virtual.objects import Payload
from proprio_ros.virtual.robot import VirtualRobot
from proprio_ros.virtual.servo import VirtualServo
from proprio_ros.virtual.truth import Truth

PUSH_A = -0.46
PUSHED_S = 0.4


def pushed_rad(kind: type[VirtualRobot], seed: int) -> float:
    """How far an elbow is pushed while the other joints are held [rad]."""
    robot = load_robot("open_manipulator_x")
    with simulated():
        held = kind(
            robot,
            Truth.draw(robot, seed),
            seed=seed,
        )
        held.hold(Payload(0.05))
        held.advance(0.0)

        def write(
            servo: VirtualServo,
            register: str,
            value: int,
            now_s: float,
        ) -> None:
            place = servo.model.registers[register]
            servo.heard(now_s)
            assert not servo.write(place.address, place.encode(value), now_s)

        for servo in held.servos.values():
            write(servo, "operating_mode", int(OperatingMode.CURRENT_BASED_POSITION), 0.0)
            write(servo, "torque_enable", 1, 0.0)
            write(
                servo,
                "goal_current",
                round(1.6 / servo.model.current_unit_A),
                0.0,
            )
            write(servo, "goal_position", servo["present_position"], 0.0)
        for quarter in range(1, 5):  # all at once would be taken for a process that was not run
            held.advance(0.25 * quarter)
        elbow = held.servos["joint3"]
        before = held.arm.position()["joint3"]
        write(elbow, "torque_enable", 0, 1.0)
        write(elbow, "operating_mode", int(OperatingMode.CURRENT), 1.0)
        write(elbow, "torque_enable", 1, 1.0)
        write(
            elbow,
            "goal_current",
            round(PUSH_A / elbow.model.current_unit_A),
            1.0,
        )
        held.advance(1.0 + PUSHED_S)
        return held.arm.position()["joint3"] - before


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_push_goes_as_far(seed: int) -> None:
    fine = pushed_rad(VirtualRobot, seed)
    coarse = pushed_rad(CoarseRobot, seed)
    assert fine < -0.2
    assert coarse == pytest.approx(fine, rel=0.1)
