"""What a driver knows and wants of an arm's joints, what it says of them, and whose command it is."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from proprio_ros.bus.control_table import ServoModel
from proprio_ros.bus.dynamixel import BusServo, Goal
from proprio_ros.robot import Robot

FAR_COUNTS = 1_000_000
"""Goal position, from the present one, at which current-based position mode pushes with its whole current."""
LARGEST_GAP = 100  # so many messages of one publisher may be lost between two that come
LATE = 8
LATE_NS = 1_000_000_000
OUTDATED = -1
"""A message may come so many places late, and so long; who sent one that came before, or after newer ones of its publisher."""
# by so much less than is known of its publisher's clock a message may seem to be on its way
SLACK_NS = 50_000_000
MOST = 16  # so many publishers of one topic are remembered


class JointMode(Enum):
    """What a joint is doing."""

    HELD = "held"
    DRIVEN = "driven"
    FREE = "free"  # torque on, current zero


class BusState(Enum):
    """What the whole arm is doing."""

    DISCONNECTED = "disconnected"
    RUNNING = "running"
    STOPPED = "stopped"  # ~/stop: current zero until torque is switched on again
    RELEASED = "released"  # torque off


class ArmSample(NamedTuple):
    """One intact round of the bus, at the joints."""

    sampled_at_s: float  # on the monotonic clock
    position: Mapping[str, float]  # rad or m
    velocity: Mapping[str, float]  # rad/s or m/s
    current_A: Mapping[str, float]  # as the servos report it
    # that a joint is driven with from here on, in whole counts; 0 where held
    commanded_A: Mapping[str, float]


@dataclass
class DriverStatistics:
    """Counts since the start."""

    cycles: int = 0  # begun
    incomplete: int = 0  # without an intact answer of every servo
    # took so much longer than usual that the instant they were taken at is not known
    untimely: int = 0
    retries: int = 0  # rounds that were asked for again, for either reason
    reconnects: int = 0
    refused_commands: int = 0


@dataclass(frozen=True)
class CurrentCommand:
    """What a sender wants joints to be driven with; ``leased``: whether it, or one before it in an unbroken row, drove a joint."""

    arrived_s: float
    current_A: Mapping[str, float]
    sender: int = 0
    leased: bool = False


@dataclass
class DrivenJoint:
    """What is known and wanted of one joint; angles at the motor's shaft."""

    name: str
    model: ServoModel
    lower_rad: float
    upper_rad: float
    transmission: float
    current_limit_A: float
    mode: JointMode = JointMode.HELD
    angle_rad: float = 0.0
    velocity_rad_s: float = 0.0
    goal_rad: float = 0.0  # position commanded to the servo
    target_rad: float = 0.0  # where the goal is going
    commanded_A: float = 0.0
    blocked: str = ""  # why it must not be driven until the commands have paused

    @classmethod
    def of(cls, robot: Robot, servo: BusServo) -> DrivenJoint:
        """As the robot file states it."""
        joint = robot.model.joint(servo.joint)
        scale = robot.drive_trains[servo.joint].transmission
        limit_A = robot.motors[servo.joint].current_limit_A
        return cls(
            joint.name, servo.model, joint.lower / scale, joint.upper / scale, scale, limit_A
        )

    @property
    def limp(self) -> bool:
        """Whether it is without torque."""
        return self.mode is JointMode.FREE or (
            self.mode is JointMode.DRIVEN and self.commanded_A == 0.0
        )

    def pushed_by(self, current_A: float) -> bool:
        """Whether a current is one for the servo, which counts in steps."""
        return self.model.counts_of_current(current_A) != 0

    def hold(self) -> None:
        """Stay where it was last seen, within its limits."""
        self.mode = JointMode.HELD
        self.commanded_A = 0.0
        self.goal_rad = self.target_rad = min(
            max(self.angle_rad, self.lower_rad),
            self.upper_rad,
        )

    def let_go(self) -> None:
        """No current, until it is held or driven again."""
        self.mode = JointMode.FREE
        self.commanded_A = 0.0

    def goal(self, stopped: bool) -> Goal:
        """What its servo is to be told; ``stopped``: no current, whatever it is doing."""
        here = self.model.counts_of_position(self.angle_rad)
        if stopped or self.mode is JointMode.FREE:
            return Goal(0, here)
        if self.mode is JointMode.DRIVEN:
            counts = self.model.counts_of_current(self.commanded_A)
            # the sign is in the direction of the goal, the size in the limit
            return Goal(
                abs(counts), here + (FAR_COUNTS if counts > 0 else -FAR_COUNTS if counts < 0 else 0)
            )
        return Goal(
            self.model.counts_of_current(self.current_limit_A),
            self.model.counts_of_position(self.goal_rad),
        )


class Senders:
    """Tells the publishers of one topic apart by the numbers of their messages, which each of them counts for itself.

    rclpy 7.1 gives no publisher's identity with a message, only its number. A message belongs to the publisher whose last number is
    the nearest one below its own; to a new one where none is near. Publishers that happen to count alike at one moment are kept
    apart by what their messages look like. What was doubled on its way, or overtaken, is none of a new publisher: it is `OUTDATED`.
    It was sent when the newest one was, or before; another publisher that begins to count sends later, whatever it says.
    """

    def __init__(self) -> None:
        self._last: dict[int, tuple[int, Hashable, int | None]] = {}
        self._error_ns: dict[int, int] = {}  # of a publisher's clock, as far as that is known
        self._moved_ns: dict[int, int] = {}  # by how much ours was set since a publisher was heard
        self._known = 0

    def of(
        self,
        number: int | None,
        looks: Hashable,
        sent_ns: int | None = None,
    ) -> int:
        """Who sent a message: the same number for all messages of a sender; 0 where it cannot be known; or `OUTDATED`.

        Args:
            number: Of the message, by its publisher; None where the middleware does not give it: then all are one.
            looks: Whatever differs between publishers, and not between messages of one.
            sent_ns: When it was sent, by its publisher's clock [ns]; None where nobody says: then nothing is outdated.
        """
        if number is None:
            return 0
        heard = [
            (last, known == looks, sender, then)
            for sender, (last, known, then) in self._last.items()
        ]
        near = [one for one in heard if 0 < number - one[0] <= LARGEST_GAP]
        if sent_ns is not None and not any(
            last == number - 1 and alike for last, alike, *_ in near
        ):
            for last, alike, _, then in heard:
                late = then is not None and 0 <= then - sent_ns < LATE_NS
                if alike and late and 0 <= last - number < LATE:
                    return OUTDATED
        self._known += not near
        sender = max(near, key=lambda one: one[:3])[2] if near else self._known
        self._last.pop(sender, None)  # those heard last stand last
        self._last[sender] = (number, looks, sent_ns)
        if len(self._last) > MOST:
            self._error_ns.pop(gone := next(iter(self._last)), None)
            del self._last[gone]
        return sender

    def late_s(
        self,
        sender: int,
        lag_ns: int,
        set_ns: int = 0,
        waited_ns: int = 0,
    ) -> float:
        """How late a message came; the error of its publisher's clock is the least lag that was seen.

        Args:
            sender: Who sent it.
            lag_ns: From when it was sent, by its publisher's clock, to now, by ours [ns].
            set_ns: By how much our clock was set just now; what was sent before seems late by that, and teaches nothing [ns].
            waited_ns: For so long it may have been here before anybody took it [ns].

        Returns:
            How late it came [s].
        """
        lags_ns = {lag_ns, lag_ns - set_ns}
        longest_ns = LATE_NS + waited_ns
        # of one that was not heard before: no message waits longer, so its clock is another one
        error_ns = self._error_ns.get(
            sender, 0 if any(0 <= lag < longest_ns for lag in lags_ns) else lag_ns
        )
        if set_ns:
            late_ns = sorted(lag - error_ns for lag in lags_ns if lag >= error_ns)
            return 1e-9 * max(
                (one for one in late_ns if one < longest_ns), default=late_ns[0] if late_ns else 0
            )
        # since ours was set, another's errs by as much, and the same one's by nothing; no message comes before it was sent
        errors_ns = error_ns, error_ns + self._moved_ns.pop(sender, 0)
        error_ns = max((one for one in errors_ns if one <= lag_ns + SLACK_NS), default=lag_ns)
        self._error_ns[sender] = min(error_ns, lag_ns)
        return max(1e-9 * (lag_ns - error_ns), 0.0)

    def clock_was_set(self, set_ns: int) -> None:
        """Ours was, by so much: a publisher's is the same one, or errs by that as well."""
        self._moved_ns = {
            sender: self._moved_ns.get(sender, 0) + set_ns for sender in self._error_ns
        }
