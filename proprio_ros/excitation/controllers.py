"""The commands of an excitation for a controller of somebody else's driver, as `ros2_control` has them: efforts, or goals.

Such a controller takes numbers without names for all its joints in a fixed order, ignores a list of another length, and keeps the
last one for ever. So every command here is whole. An effort controller's pushed joint has the effort of its current; everything
else is held by `Hold`. A position controller is for servos that know no current: a step of the goal is the push, and a goal where a
joint is holds it there. The servo's law is a soft spring, so an arm hangs below its goals. The goals sent are therefore ahead of
those wanted: by what gravity takes, where the robot file states the law, and by a slow sum of what is missing where joints stand.
What was sent is what is recorded. No clock, no ROS.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from proprio_ros.errors import ConfigurationError, ExcitationError
from proprio_ros.excitation.commands import Command
from proprio_ros.excitation.hold import LONGEST_WAIT_S, SLOWEST_HZ, Hold, HoldGains
from proprio_ros.excitation.plans import ExcitationSequence
from proprio_ros.robot import Robot
from proprio_ros.robot.drives import PositionServo
from proprio_ros.robot.kinematics import zero_pose
from proprio_ros.robot.loads import Loads

BRISK_RAD_S = 15.0  # a hold as stiff as this follows as fast as a sequence says
NUDGING_PACE = 0.1  # while the arm is asked for its delay
# what the drive takes an effort for: torque (N of a slide), or the motor's current
UNITS = ("N.m", "A")
DRIFT = 1e-4  # two clocks may run apart by so much
_Moves = dict[str, tuple[float, float]]  # by joint: how far [rad or m], and in which time [s]
FASTEST_RAD_S = 6.0  # an arm that others move, too
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
            self._ahead_ns = max(
                ahead_ns, self._ahead_ns - round(DRIFT * (now_ns - self._heard_ns))
            )
        self._heard_ns = now_ns

    def at(self, now_ns: int) -> int:
        """What the other clock says at an instant of ours [ns]."""
        return now_ns + (self._ahead_ns or 0)


class Controller:
    """What both have: their joints, and which sequences they can make.

    Args:
        robot: The arm.
        joints: The controller's joints, in its order. Joints of the robot that are not among them are held by others.
        jump_rad: A position that changes by more from sample to sample, unless speed explains it, is an encoder that slipped.

    Attributes:
        holding: Whether this commands the joints; from the first sequence on, until it is released or has lost them.
        slipped: By how much encoders have, until somebody has looked at them: positions since are of other places [rad or m].
        kind: What it takes, in words.
        without: What is wrong with a joint that the robot does not drive.
        recorded_as: Field in which whoever records hears what pushes, or is sent.
        can_let_go: Whether a last command lets go of the arm.
        let_go: What is said where it does, or sends no more.

    Raises `ConfigurationError`: No joint, or a joint that the robot does not drive or that is named twice.
    """

    kind = without = recorded_as = let_go = ""
    can_let_go = False

    def __init__(
        self,
        robot: Robot,
        joints: Sequence[str],
        jump_rad: float = 0.3,
    ) -> None:
        driven = ", ".join(robot.drive_trains)
        if not joints:
            words = f"state the {self.kind} controller's `joints` in its order; {robot.name} drives {driven}"
            raise ConfigurationError(f"controller_joints is empty: {words}")
        if unknown := [name for name in joints if name not in robot.drive_trains]:
            words = f"{robot.name} does not drive {', '.join(unknown)}{self.without}; it drives {driven}"
            raise ConfigurationError(f"controller_joints: {words}")
        if len(set(joints)) != len(joints):
            raise ConfigurationError(f"controller_joints names a joint twice: {', '.join(joints)}")
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
        named = {name for run in sequence.runs for name in (run.joint, *run.start)}
        if others := sorted({*named, *sequence.home, *sequence.from_here} - {*self.joints}):
            lacks = f"{', '.join(others)}, which the {self.kind} controller does not have"
            remedy = "add to controller_joints, or choose a sequence without it"
            raise ExcitationError(f"{sequence.name} moves {lacks}: {remedy}")

    def observe(
        self, time_s: float, position: Mapping[str, float], heard_s: float | None = None
    ) -> _Moves:
        """Take a reading; returns how far joints that were read have moved since the last one, and in which time."""
        moves = {}
        for name in self.joints:
            if math.isfinite(value := position.get(name, math.nan)):
                moved = value - self._position.get(name, value)
                step_s = time_s - self._time_s.get(name, time_s)
                elsewhere = math.remainder(moved, self._turn[name])  # some drivers count turns anew
                if (
                    abs(elsewhere)
                    > self._per_rad[name] * max(self._jump_rad, FASTEST_RAD_S * step_s)
                    and step_s >= 0.0
                ):
                    self.slipped[name] = self.slipped.get(name, 0.0) + elsewhere
                self._position[name], self._time_s[name] = value, time_s
                moves[name] = moved, step_s
        return moves


class EffortController(Controller):
    """One controller's efforts.

    Args:
        robot, joints: As of every controller.
        unit: Of its efforts, one of `UNITS`. A torque is current x nominal torque constant of the robot file.
        gains: How joints are held.

    Attributes:
        pushed_A: Currents of the joints that are pushed now.
    """

    kind = "effort"
    without = ", and nobody could hold it"
    recorded_as = "effort"
    can_let_go = True
    let_go = "the efforts are zero: nobody holds the arm until a controller does"

    def __init__(
        self,
        robot: Robot,
        joints: Sequence[str],
        unit: str,
        gains: HoldGains | None = None,
    ) -> None:
        super().__init__(robot, joints, (gains or HoldGains()).jump_rad)
        if unit not in UNITS:
            raise ConfigurationError(f"effort_unit={unit!r}: choose one of {', '.join(UNITS)}")
        self.pushed_A: dict[str, float] = {}
        self._hold = Hold(robot, self.joints, gains)
        self._effort_per_A = {
            name: drive.nominal_effort_per_current for name, drive in robot.drive_trains.items()
        }
        self._per_unit = {n: self._effort_per_A[n] if unit == "A" else 1.0 for n in self.joints}

    @property
    def lost(self) -> str:
        """Why the joints are not held any more; empty while they are."""
        return self._hold.lost

    @property
    def pace(self) -> float:
        if self._hold.nudging:
            return NUDGING_PACE
        return min(1.0, self._hold.frequency_rad_s / BRISK_RAD_S) or 1.0

    @property
    def late_s(self) -> float:
        period_s = 1.0 / self._hold.rate_hz if self._hold.rate_hz else 0.0
        return max((self._hold.delay.delay_s or 0.0) - period_s, 0.0)

    @property
    def held_kg(self) -> float:
        return self._hold.held_kg if self.holding else 0.0

    @property
    def record(self) -> dict[str, float]:
        """What a recording says of it, as this package's driver would: the efforts of currents that push, zero for what is held."""
        return {
            name: self.pushed_A.get(name, 0.0) * scale for name, scale in self._effort_per_A.items()
        }

    def check(self, sequence: ExcitationSequence) -> None:
        super().check(sequence)
        if any(run.goal_step for run in sequence.runs):
            words = "pushes by steps of goals, which an effort controller does not take"
            raise ExcitationError(f"{sequence.name} {words}: choose a sequence with currents")
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
            self.pushed_A = {
                name: current for name, current in command.current_A.items() if name in self.joints
            }
            self._hold.aim(command.position)

    def take_here(self) -> None:
        """Hold all joints where they read now: after an encoder slipped, older positions are other places."""
        self.pushed_A = {}
        self._hold.here()

    def observe(
        self, time_s: float, position: Mapping[str, float], heard_s: float | None = None
    ) -> _Moves:
        self._hold.observe(time_s, position, heard_s)
        return super().observe(time_s, position, heard_s)

    def commands(self) -> list[float]:
        """An effort for each joint, in the controller's order and unit; zeros once the joints are lost."""
        pushed = {
            name: current * self._effort_per_A[name] for name, current in self.pushed_A.items()
        }
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
        efforts = self._hold.steady()
        if not self.lost:
            self._hold.sent(efforts)
        return self._listed(efforts)

    def release(self) -> list[float]:
        """Let go: zeros."""
        self.holding, self.pushed_A = False, {}
        return [0.0] * len(self.joints)

    def _listed(self, efforts: Mapping[str, float]) -> list[float]:
        return [efforts[name] / self._per_unit[name] for name in self.joints]


SUM_S = 0.4  # time in which the slow sum gives as much as is missing
SLACK_RAD = 0.02
"""Nothing is summed up so near to where a joint should be: friction would have it hunt, and it must be still before a push."""
LARGEST_SUM_RAD = 0.5
REST_S = 0.1  # goals that have rested for so long are those of a joint that should stand
STILL_RAD_S = 0.1  # nothing is summed up beyond this speed: the joint is on its way
GAP_S = 0.1  # after a longer pause nothing is summed up over it


class GoalController(Controller):
    """One controller's goals; methods that say nothing of their own do what those of an `EffortController` do.

    ``robot``, ``joints``, ``jump_rad``: as of every controller.
    """

    kind = recorded_as = "position"
    let_go = "no more goals are sent: the servos hold the arm at the last ones until their driver turns torque off"

    def __init__(
        self,
        robot: Robot,
        joints: Sequence[str],
        jump_rad: float = 0.3,
    ) -> None:
        super().__init__(robot, joints, jump_rad)
        self.lost = ""  # servos hold by themselves: nobody can lose them here
        self._limits = {
            name: (robot.model.joint(name).lower, robot.model.joint(name).upper) for name in joints
        }
        self._stiffness, self._farthest = _springs(robot, self.joints)
        self._loads = Loads(robot)
        self._pose = zero_pose(robot)
        self._wanted: dict[str, float] = {}
        self._stepped: dict[str, float] = {}
        self._sum = dict.fromkeys(self.joints, 0.0)
        self._lean = dict.fromkeys(self.joints, 0.0)
        self._rests_since_s = math.inf
        self._sent: dict[str, float] = {}

    @property
    def record(self) -> dict[str, float]:
        """What a recording says of it: the goals that were sent last; nothing where somebody else may send others."""
        return dict(self._sent) if self.holding else {}

    def check(self, sequence: ExcitationSequence) -> None:
        if not all(run.goal_step for run in sequence.runs):
            words = "pushes with currents, which a position controller does not take"
            raise ExcitationError(
                f"{sequence.name} {words}: choose a sequence whose runs state goal_step"
            )
        super().check(sequence)

    def begin(self) -> None:
        self._stepped = {}
        if not self.holding:
            self._sum = dict.fromkeys(self.joints, 0.0)
            self.take_here()
        self.holding = True

    def take(self, command: Command) -> None:
        if self.holding:
            self._stepped = {
                name: goal for name, goal in command.stepped.items() if name in self.joints
            }
            self._want(command.position)

    def take_here(self) -> None:
        self._stepped = {}
        self._want(self._position)

    def observe(
        self, time_s: float, position: Mapping[str, float], heard_s: float | None = None
    ) -> _Moves:
        moves = super().observe(time_s, position, heard_s)
        self._pose.update(
            {name: q for name, q in position.items() if name in self._pose and math.isfinite(q)}
        )
        for name, (moved, step_s) in moves.items():
            if abs(moved) > self._jump_rad * self._per_rad[name] and name in self._wanted:
                # the arm is where it was: only what it reads has changed
                self._wanted[name] += moved
            if 0.0 < step_s <= GAP_S and abs(moved) <= STILL_RAD_S * self._per_rad[name] * step_s:
                self._sum_up(name, time_s, step_s)
        return moves

    def commands(self) -> list[float]:
        """A goal for each joint, in the controller's order [rad or m]."""
        self._sent = {name: self._goal(name) for name in self.joints}
        return list(self._sent.values())

    def last_words(self) -> list[float]:
        """What holds the arm without anybody who looks: a joint that is pushed, where it was seen last."""
        return [self._goal(name, pushed=False) for name in self.joints]

    def steady(self) -> list[float]:
        self._want({name: self._position[name] for name in self._stepped})
        self._stepped = {}
        return self.commands()

    def release(self) -> list[float]:
        """Send no more; the last goals hold."""
        last = self.steady()
        self.holding = False
        return last

    def _want(self, goals: Mapping[str, float]) -> None:
        wanted = {
            **self._wanted,
            **{name: q for name, q in goals.items() if name in self.joints and math.isfinite(q)},
        }
        if wanted == self._wanted:
            return
        self._wanted = wanted
        self._rests_since_s = max(self._time_s.values(), default=math.inf)
        gravity = self._loads.at({**self._pose, **wanted}).gravity
        for name, stiffness in self._stiffness.items():
            lean = gravity[name] / stiffness
            self._lean[name] = math.copysign(
                min(abs(lean), self._farthest[name]),
                lean,
            )

    def _sum_up(self, name: str, time_s: float, step_s: float) -> None:
        """Where all should stand and this joint does, but elsewhere, something hangs at it."""
        if (
            not self.holding
            or self._stepped
            or time_s - self._rests_since_s < REST_S
            or name not in self._wanted
        ):
            return
        off = self._wanted[name] - self._position[name]
        if abs(off) > SLACK_RAD * self._per_rad[name]:
            most = LARGEST_SUM_RAD * self._per_rad[name]
            self._sum[name] = max(
                -most,
                min(most, self._sum[name] + off * step_s / SUM_S),
            )

    def _goal(self, name: str, pushed: bool = True) -> float:
        """Of a joint, ahead of where it is wanted; within its limits, which some controllers refuse to leave."""
        wanted = self._wanted[name]
        if name in self._stepped:
            wanted = self._stepped[name] if pushed else self._position[name]
        low, high = self._limits[name]
        return max(
            low,
            min(high, wanted + self._lean[name] + self._sum[name]),
        )


def _springs(
    robot: Robot,
    joints: Sequence[str],
) -> tuple[dict[str, float], dict[str, float]]:
    """Of joints whose servo's law the robot file states: stiffness [N m/rad], and how far its goal is at the largest duty."""
    stiffness = {}
    farthest = {}
    for name in joints:
        drive = robot.drive_trains[name]
        if (
            isinstance(drive.driven_by, PositionServo)
            and drive.supply_voltage_V > 0.0
            and drive.resistance_ohm > 0.0
        ):
            per_duty = (
                drive.nominal_effort_per_current * drive.supply_voltage_V / drive.resistance_ohm
            )
            stiffness[name] = drive.driven_by.gain_per_rad * per_duty
            farthest[name] = drive.driven_by.limit / drive.driven_by.gain_per_rad
    return stiffness, farthest
