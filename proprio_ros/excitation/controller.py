"""What controllers of somebody else's driver have alike: their joints in a fixed order, and which sequences they can make."""

from __future__ import annotations

from collections.abc import Sequence

from proprio_ros.errors import ConfigurationError, ExcitationError
from proprio_ros.excitation.plans import ExcitationSequence
from proprio_ros.robot import Robot


class Controller:
    """A controller's joints.

    Args:
        robot: The arm.
        joints: The controller's joints, in its order. Joints of the robot that are not among them are held by others.

    Raises:
        ConfigurationError: No joint, or a joint that the robot does not drive or that is named twice.
    """

    kind = ""
    """What it takes, in words."""
    without = ""
    """What is wrong with a joint that the robot does not drive."""

    def __init__(self, robot: Robot, joints: Sequence[str]) -> None:
        driven = ", ".join(robot.drive_trains)
        if not joints:
            raise ConfigurationError(
                f"controller_joints is empty: state the {self.kind} controller's `joints` in its order; {robot.name} drives "
                f"{driven}"
            )
        if unknown := [name for name in joints if name not in robot.drive_trains]:
            raise ConfigurationError(
                f"controller_joints: {robot.name} does not drive {', '.join(unknown)}{self.without}; it drives {driven}"
            )
        if len(set(joints)) != len(joints):
            raise ConfigurationError(f"controller_joints names a joint twice: {', '.join(joints)}")
        self.joints = tuple(joints)
        self.holding = False
        """Whether this commands the joints; from the first sequence on, until it is released or has lost them."""

    def check_joints(self, sequence: ExcitationSequence) -> None:
        """Whether a sequence moves only joints of this controller.

        Raises:
            ExcitationError: It pushes or moves a joint of somebody else's.
        """
        named = {name for run in sequence.runs for name in (run.joint, *run.start)}
        if others := sorted({*named, *sequence.home, *sequence.from_here} - {*self.joints}):
            raise ExcitationError(
                f"{sequence.name} moves {', '.join(others)}, which the {self.kind} controller does not have: add to "
                "controller_joints, or choose a sequence without it"
            )
