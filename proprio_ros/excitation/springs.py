"""Position servos as springs: how stiff one is, and how far its goal may stand from the joint, as the robot file states its law."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from proprio_ros.robot import Robot
from proprio_ros.robot.drives import PositionServo

STEP_SHARE = 0.5
"""Of what a servo has left beside gravity: a step that asks for more saturates a servo that is a little stiffer than stated."""

TIMED_S = 1e-3
"""When a goal came into effect is known no better, on a computer that is busy elsewhere."""
MISTIMED_SHARE = 0.005
"""Of a servo's largest torque: so much error of the torque that uncertainty may cause on the way between poses."""


@dataclass(frozen=True)
class Spring:
    """A servo that follows its goal by a proportional law."""

    stiffness: float  # [N m/rad or N/m]
    farthest: float  # from the joint, the goal at which the duty is largest [rad or m]

    @property
    def fastest(self) -> float:
        """Speed of a goal at which `TIMED_S` is worth `MISTIMED_SHARE` of the servo's largest torque [rad/s or m/s]."""
        return MISTIMED_SHARE * self.farthest / TIMED_S

    def largest_step(self, gravity: float) -> float:
        """Of a goal, so that the servo does not saturate where it carries an effort [N m or N] already [rad or m]."""
        left = self.farthest - abs(gravity) / self.stiffness
        return STEP_SHARE * max(left, 0.0)


def springs_of(robot: Robot, joints: Sequence[str]) -> dict[str, Spring]:
    """Of joints whose servo's law the robot file states."""
    springs = {}
    for name in joints:
        drive = robot.drive_trains[name]
        servo = drive.driven_by
        if not isinstance(servo, PositionServo):
            continue
        if drive.supply_voltage_V <= 0.0 or drive.resistance_ohm <= 0.0:
            continue
        at_stall = drive.nominal_effort_per_current * drive.supply_voltage_V
        springs[name] = Spring(
            stiffness=servo.gain_per_rad * (at_stall / drive.resistance_ohm),
            farthest=servo.limit / servo.gain_per_rad,
        )
    return springs
