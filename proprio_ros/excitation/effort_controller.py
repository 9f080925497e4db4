"""The commands of an excitation as efforts for an effort controller of somebody else's driver: `ros2_control`'s.

Such a controller takes numbers without names for all its joints in a fixed order, ignores a list of another length, and keeps the
last one for ever. So every command here is whole. What is pushed has the effort of its current; everything else is held.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from proprio_ros.errors import ConfigurationError, ExcitationError
from proprio_ros.excitation.commands import Command
from proprio_ros.excitation.controller import Controller
from proprio_ros.excitation.hold import LONGEST_WAIT_S, SLOWEST_HZ, Hold, HoldGains
from proprio_ros.excitation.plans import ExcitationSequence
from proprio_ros.robot import Robot

UNITS = ("N.m", "A")  # what the drive takes an effort for: torque (N of a slide), or the motor's current


DRIFT = 1e-4  # two clocks may run apart by so much
CLOCK_SET_S = 0.5  # a clock that is off by more has been set


class StampClock:
    """Another clock's time, from stamps that come late, each by something else: those that come earliest say it."""

    def __init__(self) -> None:
        self._ahead_ns: int | None = None
        self._heard_ns = 0

    def hear(self, stamp_ns: int, now_ns: int) -> None:
        """A stamp of the other clock has come at an instant of ours."""
        ahead_ns = stamp_ns - now_ns
        if self._ahead_ns is None or abs(ahead_ns - self._ahead_ns) > CLOCK_SET_S * 1e9:
            self._ahead_ns = ahead_ns
        else:
            self._ahead_ns = max(ahead_ns, self._ahead_ns - round(DRIFT * (now_ns - self._heard_ns)))
        self._heard_ns = now_ns

    def at(self, now_ns: int) -> int:
        """What the other clock says at an instant of ours [ns]."""
        return now_ns + (self._ahead_ns or 0)


class EffortController(Controller):
    """One controller's efforts.

    Args:
        robot: The arm.
        joints: The controller's joints, in its order. Joints of the robot that are not among them are held by others.
        unit: Of its efforts, one of `UNITS`. A torque is current x nominal torque constant of the robot file.
        gains: How joints are held.

    Raises:
        ConfigurationError: No joint, a joint that the robot does not drive or that is named twice, or another unit.
    """

    kind, without = "effort", ", and nobody could hold it"
    recorded_as = "effort"
    """Field in which whoever records hears what pushes."""
    can_let_go = True
    """Whether a last command lets go of the arm."""
    let_go = "the efforts are zero: nobody holds the arm until a controller does"

    def __init__(self, robot: Robot, joints: Sequence[str], unit: str, gains: HoldGains | None = None) -> None:
        super().__init__(robot, joints)
        if unit not in UNITS:
            raise ConfigurationError(f"effort_unit={unit!r}: choose one of {', '.join(UNITS)}")
        self.pushed_A: dict[str, float] = {}
        """Currents of the joints that are pushed now."""
        self._hold = Hold(robot, self.joints, gains)
        self._effort_per_A = {n: robot.drive_trains[n].nominal_effort_per_current for n in robot.drive_trains}
        self._per_unit = {n: self._effort_per_A[n] if unit == "A" else 1.0 for n in self.joints}

    @property
    def lost(self) -> str:
        """Why the joints are not held any more; empty while they are."""
        return self._hold.lost

    @property
    def record(self) -> dict[str, float]:
        """What a recording says of it, as this package's driver would: the efforts of currents that push, zero for what is held."""
        return {name: self.pushed_A.get(name, 0.0) * scale for name, scale in self._effort_per_A.items()}

    def check(self, sequence: ExcitationSequence) -> None:
        """Whether this controller can make a sequence now.

        Raises:
            ExcitationError: It pushes or moves a joint of somebody else's, or joint states come too slowly.
        """
        self.check_joints(sequence)
        if any(run.goal_step for run in sequence.runs):
            raise ExcitationError(
                f"{sequence.name} pushes by steps of goals, which an effort controller does not take: choose a sequence with "
                "currents"
            )
        if not self._hold.knows or self._hold.rate_hz < SLOWEST_HZ:
            raise ExcitationError(
                f"joint states come {self._hold.rate_hz:.0f} times a second: efforts hold an arm with {SLOWEST_HZ:g} or more; "
                "raise the update rate of controller_manager and of its joint_state_broadcaster"
            )

        if self._hold.wait_s > LONGEST_WAIT_S:
            raise ExcitationError(
                f"joint states come in bursts ({1e3 * self._hold.wait_s:.0f} ms apart as an instant sees it; efforts hold an arm "
                f"with {1e3 * LONGEST_WAIT_S:.0f} ms at most): keep this computer free, or run this node beside controller_manager"
            )

    def begin(self) -> None:
        """A sequence begins: hold all joints where they are, if they are not held yet."""
        if not self.holding or self.lost:
            self._hold.begin()
        self.pushed_A = {}
        self.holding = True

    def take(self, command: Command) -> None:
        """What the state machine wants; the next `commands` say it."""
        if self.holding:
            self.pushed_A = {name: current for name, current in command.current_A.items() if name in self.joints}
            self._hold.aim(command.position)

    def take_here(self) -> None:
        """Hold all joints where they read now: after an encoder slipped, older positions are other places."""
        self.pushed_A = {}
        self._hold.here()

    def observe(self, time_s: float, position: Mapping[str, float], heard_s: float | None = None) -> None:
        """Take a reading, as `Hold.observe` does."""
        self._hold.observe(time_s, position, heard_s)

    def commands(self) -> list[float]:
        """An effort for each joint, in the controller's order and unit; zeros once the joints are lost."""
        pushed = {name: current * self._effort_per_A[name] for name, current in self.pushed_A.items()}
        efforts = self._hold.efforts(pushed)
        if self.lost:
            self.pushed_A = {}
        return self._listed(efforts)

    def last_words(self) -> list[float]:
        """What holds the arm without anybody who looks, for as long as nothing changes."""
        return self._listed(self._hold.steady())

    def steady(self) -> list[float]:
        """The same; nothing is pushed any more."""
        self.pushed_A = {}
        return self.last_words()

    def release(self) -> list[float]:
        """Let go: zeros."""
        self.holding, self.pushed_A = False, {}
        return [0.0] * len(self.joints)

    def _listed(self, efforts: Mapping[str, float]) -> list[float]:
        return [efforts[name] / self._per_unit[name] for name in self.joints]
