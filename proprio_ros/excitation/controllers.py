"""What takes the commands of an excitation at somebody else's driver, as `ros2_control` has it: efforts, or goals.

Such a controller takes numbers without names for all its joints in a fixed order, ignores a list of another length, and keeps the
last one for ever. So every command here is whole. `Controller` says what each of them must have; those that there are stand in
`controller_kinds`. No clock, no ROS.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from proprio_ros.errors import ConfigurationError, ExcitationError
from proprio_ros.excitation.commands import Command
from proprio_ros.excitation.plans import ExcitationSequence
from proprio_ros.robot import Robot

if TYPE_CHECKING:
    from typing_extensions import Self

FASTEST_RAD_S = 6.0  # an arm that others move, too


@dataclass(frozen=True)
class Move:
    """How far a joint has moved between two of its readings."""

    by: float  # [rad or m]
    step_s: float  # between the readings [s]


class Controller(ABC):
    """One controller of somebody else's driver, and how its joints are pushed and held.

    `begin` holds the arm, from then on `take` says what the state machine wants, `observe` takes readings, and `commands` is sent
    after each. Where readings stop, `steady` is sent; when the process ends, `steady` or zeros; `release` gives the joints up.

    Args:
        robot: The arm.
        joints: The controller's joints, in its order. Joints of the robot that are not among them are held by others.
        jump_rad: A position that changes by more from sample to sample, unless speed explains it, is an encoder that slipped.

    Attributes:
        joints: The controller's joints, in its order.
        holding: Whether this commands the joints; from the first sequence on, until it is released or has lost them.
        slipped: By how much encoders have, until somebody has looked at them: positions since are of other places [rad or m].

    Raises:
        ConfigurationError: No joint, or a joint that the robot does not drive or that is named twice.
    """

    kind: ClassVar[str]  # what it takes in a word, which is its name in `command_interface`
    about: ClassVar[str]  # what it is, as that parameter is described
    commanded: ClassVar[str]  # what is sent, with its unit
    usual_topic: ClassVar[str]  # where such controllers listen
    announced: ClassVar[str]  # what goes to the topic in braces, and what that means for the arm
    beside: ClassVar[str]  # what whoever stands beside the arm should do
    falls_unheard: ClassVar[bool] = False  # whether an arm comes down that hears no more
    without: ClassVar[str] = ""  # what is wrong with a joint that the robot does not drive
    # field of a JointState in which a recording has what pushes, or what is sent, and the topic of that
    recorded_as: ClassVar[str]
    recorded_on: ClassVar[str]
    can_let_go: ClassVar[bool] = False  # whether a last command lets go of the arm
    let_go: ClassVar[str]  # what is said where it does, or sends no more

    def __init__(self, robot: Robot, joints: Sequence[str], jump_rad: float = 0.3) -> None:
        self._check_joints(robot, joints)
        self.joints = tuple(joints)
        self.holding = False
        self.slipped: dict[str, float] = {}
        self._jump_rad = jump_rad
        self._per_rad = {name: abs(robot.drive_trains[name].transmission) for name in joints}
        self._turn = {
            name: math.inf if robot.model.joint(name).kind == "prismatic" else math.tau
            for name in joints
        }
        self._position: dict[str, float] = {}
        self._time_s: dict[str, float] = {}

    @classmethod
    @abstractmethod
    def of_parameters(cls, robot: Robot, values: Mapping[str, Any]) -> Self:
        """As the excitation node's parameters state it.

        Args:
            robot: The arm.
            values: Of the parameters, by name.

        Raises:
            ConfigurationError: They do not fit the robot.
        """

    def _check_joints(self, robot: Robot, joints: Sequence[str]) -> None:
        driven = ", ".join(robot.drive_trains)
        if not joints:
            words = f"state the {self.kind} controller's `joints` in its order; {robot.name} drives {driven}"
            raise ConfigurationError(f"controller_joints is empty: {words}")
        unknown = [name for name in joints if name not in robot.drive_trains]
        if unknown:
            words = f"{robot.name} does not drive {', '.join(unknown)}{self.without}; it drives {driven}"
            raise ConfigurationError(f"controller_joints: {words}")
        if len(set(joints)) != len(joints):
            raise ConfigurationError(f"controller_joints names a joint twice: {', '.join(joints)}")

    @property
    @abstractmethod
    def lost(self) -> str:
        """Why the joints are not held any more; empty while they are."""

    @property
    @abstractmethod
    def record(self) -> dict[str, float]:
        """What a recording has of it under `recorded_as`, by joint; empty where there is nothing to record."""

    @property
    def pace(self) -> float:
        """How fast joints follow, 1 or less, as `ExcitationMachine` takes it."""
        return 1.0

    @property
    def late_s(self) -> float:
        """How long after the next reading what is sent comes into effect [s]."""
        return 0.0

    @property
    def held_kg(self) -> float:
        """What hangs in the hand, as far as holding it says."""
        return 0.0

    def check(self, sequence: ExcitationSequence) -> None:
        """Whether this controller can make a sequence now.

        Raises:
            ExcitationError: It moves a joint of somebody else's, pushes by what the controller does not take, an encoder has
                slipped, or joint states come too slowly.
        """
        for name, by in self.slipped.items():
            # else it has come back: a reading was wrong
            if abs(by) > 0.5 * self._jump_rad * self._per_rad[name]:
                words = "check it and its cable, support the arm and call ~/release; calibrate again where its zero is another now"
                raise ExcitationError(f"the encoder of {name} jumped by {by:+.2f}: {words}")
        named = {*sequence.home, *sequence.from_here}
        for run in sequence.runs:
            named |= {run.joint, *run.start}
        others = sorted(named - {*self.joints})
        if others:
            lacks = f"{', '.join(others)}, which the {self.kind} controller does not have"
            remedy = "add to controller_joints, or choose a sequence without it"
            raise ExcitationError(f"{sequence.name} moves {lacks}: {remedy}")

    @abstractmethod
    def begin(self) -> None:
        """A sequence begins: hold all joints where they are, if they are not held yet."""

    @abstractmethod
    def take(self, command: Command) -> None:
        """What the state machine wants; the next `commands` say it. Nothing while the joints are not held."""

    @abstractmethod
    def take_here(self) -> None:
        """Hold all joints where they read now: after an encoder slipped, older positions are other places."""

    def observe(
        self, time_s: float, position: Mapping[str, float], heard_s: float | None = None
    ) -> Mapping[str, Move]:
        """Take a reading.

        Args:
            time_s: When it was taken, on a clock of its own [s].
            position: By joint; what is no number is passed over [rad or m].
            heard_s: When it came; None: when it was taken [s].

        Returns:
            How far joints that were read have moved since their last reading.
        """
        moves: dict[str, Move] = {}
        for name in self.joints:
            value = position.get(name, math.nan)
            if not math.isfinite(value):
                continue
            move = Move(
                by=value - self._position.get(name, value),
                step_s=time_s - self._time_s.get(name, time_s),
            )
            self._look_for_slip(name, move)
            self._position[name] = value
            self._time_s[name] = time_s
            moves[name] = move
        return moves

    def _look_for_slip(self, name: str, move: Move) -> None:
        elsewhere = math.remainder(move.by, self._turn[name])  # some drivers count turns anew
        farthest_rad = max(self._jump_rad, FASTEST_RAD_S * move.step_s)
        if move.step_s >= 0.0 and abs(elsewhere) > self._per_rad[name] * farthest_rad:
            self.slipped[name] = self.slipped.get(name, 0.0) + elsewhere

    @abstractmethod
    def commands(self) -> list[float]:
        """What to send now: a number for each joint, in the controller's order and unit."""

    @abstractmethod
    def holding_command(self) -> list[float]:
        """What holds the arm without anybody who looks, for as long as nothing changes; changes nothing here."""

    @abstractmethod
    def steady(self) -> list[float]:
        """The same, to be sent now; nothing is pushed any more."""

    @abstractmethod
    def release(self) -> list[float]:
        """The last command before the joints are given up."""
