"""The loop that drives an arm: read, check, command; every cycle, whatever happens. No ROS.

Every joint is either *held* (its servo keeps a position) or *driven* (a constant current). A joint is driven only while fresh
commands come; without one (``command_timeout_s``), or when a limit or the table is reached, it is held where it is, or its current
is zero where ``on_timeout`` says so.

Goals are written anew in every cycle, since a sync write that is lost on the wire is lost without a word. When this process dies,
the servos' own watchdogs end the current: that of a driven joint soon, those of held joints later, so that a pause of this process
drops nothing.

A cycle waits for no other thread: what one is about to ask for while it is not run counts in a later cycle.

Whoever drives holds a *lease*: it begins with a current that is not zero and lasts while the same sender's commands are fresh;
others are refused meanwhile. A current of zero lets go of a joint only where the lease has driven it before.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from proprio_ros.bus.control_table import BUS_WATCHDOG_UNIT_S
from proprio_ros.bus.dynamixel import DynamixelBus, Reading, ServoHealth
from proprio_ros.bus.state import (
    ArmSample,
    BusState,
    CurrentCommand,
    DrivenJoint,
    DriverStatistics,
    JointMode,
)
from proprio_ros.clock import RoundTrips, event, lock, now
from proprio_ros.errors import BusError, PortLostError
from proprio_ros.robot import Robot
from proprio_ros.robot.kinematics import clearance, zero_pose

SAG_RAD = 0.06
"""A held joint under load is no further from its goal than this: 0.03 rad at 0.3 A with the servo's own gain."""
LOST_AFTER_S = 0.2  # no servo answered for so long: the bus is lost
LOOKAHEAD_S = 0.05
"""A driven joint is braked when it would be at its limit so soon: a cycle, the servo's latency and the way it takes to stop."""
# an arm that is too low may be moved, but not lower by more than this: encoders are not exact
SINK_M = 1e-3
# and its goals by no more than this below the highest place that they have reached: under load joints are below their goals
DIP_M = 5e-3
SAME_S = 0.02  # when a command was sent is known about so well
WARN_AGAIN_S = 2.0  # the same warning is said no more often
# one servo's temperature and voltage are read so often, while nothing is driven
HEALTH_PERIOD_S = 0.2


@dataclass(frozen=True)
class DriverSettings:
    """What a driver may do and for how long."""

    # without a fresh current command for so long, a driven joint is no longer driven
    command_timeout_s: float = 0.1
    # ``hold`` keeps it where it is then, ``zero`` leaves it without current
    on_timeout: str = "hold"
    # the servo of a driven joint stops by itself after so much silence; 0 turns that off
    watchdog_s: float = 0.3
    # the servo of a held joint: longer, since what it holds would fall; 0 turns that off
    hold_watchdog_s: float = 2.0
    limit_margin_rad: float = 0.05  # a joint is not driven nearer to its limit than this
    # nothing is brought nearer to the base's plane, the table, than this
    min_clearance_m: float = 0.0
    max_velocity_rad_s: float = 7.0  # a driven joint that is faster is braked
    max_goal_velocity_rad_s: float = 2.5  # a goal position is followed no faster than this
    max_temperature_C: float = 70.0  # no current above; the servos shut down by themselves at 80
    # a position further from the last one than speed explains is an encoder fault
    max_jump_rad: float = 0.3
    position_d_gain: int = 2000  # register value that damps locked joints
    reconnect_s: float = 0.5  # a lost bus is tried again so often


class ArmDriver:
    """Drives the servos of one robot.

    `cycle` belongs to one thread; `command_currents`, `command_positions`, `hold`, `stop` and `set_torque` may be
    called from any. ``log`` is called with a severity, ``info``, ``warning`` or ``error``, and a sentence for the
    operator; the clock gives monotonic seconds.
    """

    def __init__(
        self,
        robot: Robot,
        bus: DynamixelBus,
        settings: DriverSettings | None = None,
        log: Callable[[str, str], None] = lambda severity, message: None,
        clock: Callable[[], float] = now,
    ) -> None:
        self.robot = robot
        self.bus = bus
        self.settings = settings or DriverSettings()
        self.statistics = DriverStatistics()
        self.state = BusState.DISCONNECTED
        self.reason = "not connected yet"
        self.health: dict[str, ServoHealth] = {}
        self._tell = log
        self._warned_at_s: dict[str, float] = {}
        self._clock = clock
        self._joints = {servo.joint: DrivenJoint.of(robot, servo) for servo in bus.servos}
        self._lock = lock()
        self._command: CurrentCommand | None = None
        self._targets: dict[str, float] = {}
        self._mover: tuple[int, float] = (0, -np.inf)  # who sent the last positions, and when
        # what was sent before counts no more: torque came on since, or a push has ended
        self._since_s = -np.inf
        self._hold_wanted = False
        self._stop_wanted = False
        self._driving = False
        # by joint, what its servo's watchdog is set to, and those that are about to be driven
        self._patience_s: dict[str, float] = {}
        self._to_drive: set[str] = set()
        self._written_at_s = -np.inf
        self.slipped = False
        self._torque_wanted: bool | None = None
        self._torque_set = event()
        self._last_answer_s = -np.inf
        self._next_connect_s = -np.inf
        self._next_health_s = -np.inf
        self._goals_at_s = -np.inf
        self._reached_m = -np.inf  # how high the goals have come since the arm was lowered
        self._sampled_at_s = -np.inf
        self._health_turn = 0
        self._round_trips = RoundTrips()
        self._alerts: set[str] = set()
        self._limp = False  # there was to be no current when the bus was lost
        # joints without a motor are taken to stand at zero, or at the limit nearest to it
        self._rest = zero_pose(robot)

    def _log(self, severity: str, sentence: str) -> None:
        """Say it; a warning that differs by its numbers alone only once in a while."""
        now = self._clock()
        words = re.sub(r"[0-9.]+", "", sentence)
        if severity == "warning":
            if now - self._warned_at_s.get(words, -np.inf) < WARN_AGAIN_S:
                return
            self._warned_at_s[words] = now
        self._tell(severity, sentence)

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints in the order of an unlabelled command."""
        return tuple(self._joints)

    @property
    def modes(self) -> dict[str, str]:
        """What each joint is doing, in words."""
        return {name: joint.mode.value for name, joint in self._joints.items()}

    @property
    def limp(self) -> bool:
        """Whether any joint is without torque: all of them, or one that a lease drives with a current of zero."""
        return any(joint.limp for joint in self._joints.values())

    def command_currents(
        self, current_A: Mapping[str, float], sender: int = 0, late_s: float = 0.0
    ) -> str:
        """Drive these joints, and hold the others, until the next command or the deadline.

        A current of zero for a joint that is not driven leaves it held. No joint at all ends the lease. Another sender is
        refused while a lease lasts, and so is what was sent before the last one ended.

        Args:
            current_A: By joint [A].
            sender: Who commands.
            late_s: How long the command was on its way [s].

        Returns:
            Why the whole command was refused, or an empty string.
        """
        reason = self._why_refused(current_A) or self._why_late(late_s)
        with self._lock:  # only the newest counts, so a flood of commands costs nothing
            now = self._clock()
            lasting = self._lasting_lease(now)
            if not reason and lasting is not None and lasting.sender != sender:
                joints = ", ".join(lasting.current_A)
                reason = f"{joints}: driven by another publisher; one at a time"
            if not reason:
                goes_on = lasting is not None and bool(current_A)
                leased = self._push_any(current_A) or goes_on
                self._command = CurrentCommand(now, dict(current_A), sender, leased)
                if not current_A:
                    self._since_s = max(self._since_s, now - late_s)
        if reason:
            self.statistics.refused_commands += 1
        return reason

    def _lasting_lease(self, now: float) -> CurrentCommand | None:
        """The last command, where its sender still has the arm."""
        last = self._command
        if last is None or not last.leased:
            return None
        return last if now - last.arrived_s <= self.settings.command_timeout_s else None

    def _push_any(self, current_A: Mapping[str, float]) -> bool:
        return any(self._joints[name].pushed_by(value) for name, value in current_A.items())

    def _why_unfit(self, values: Mapping[str, float], what: str) -> str:
        """Why these values cannot be commanded at all, or an empty string."""
        if self.state is not BusState.RUNNING or self.slipped:
            return f"the arm is {self.state.value}: {self.reason}"
        for name, value in values.items():
            if name not in self._joints:
                return f"there is no joint {name!r}; joints: {', '.join(self._joints)}"
            if not np.isfinite(value):
                return f"{name}: the {what} is {value}; every {what} must be a number"
        return ""

    def _why_late(self, late_s: float) -> str:
        """Why a command that was on its way for so long is not obeyed any more, or an empty string."""
        if self._clock() - late_s >= self._since_s - SAME_S:
            return ""
        return f"it came {late_s:.2f} s late, and the arm has been held anew, or a push has ended, since it was sent"

    def _why_refused(self, current_A: Mapping[str, float]) -> str:
        reason = self._why_unfit(current_A, "current")
        if reason:
            return reason
        for name, current in current_A.items():
            joint = self._joints[name]
            if abs(current) > joint.current_limit_A + 1e-9:
                return f"{name}: {current:g} A is more than its limit of {joint.current_limit_A:g} A (currents are in A, not mA)"
            health = self.health.get(name)
            if current and health and health.temperature_C >= self.settings.max_temperature_C:
                return (
                    f"{name}: too hot to be driven ({health.temperature_C:.0f} C): let it cool down"
                )
        # a servo that has switched itself off holds nothing: what hangs at it falls, or leans on a stop
        if self._alerts and any(current_A.values()):
            name = min(self._alerts, key=lambda name: not current_A.get(name))
            health = self.health.get(name)
            faults = "; ".join(health.faults) if health else "see diagnostics"
            return f"{name}: its servo reports a fault ({faults}); no joint is driven until ~/torque true reboots it"
        return ""

    def command_positions(
        self, position: Mapping[str, float], sender: int = 0, late_s: float = 0.0
    ) -> str:
        """Move held joints, no faster than allowed.

        Another sender is refused while the first one's commands come in a row, and so is what was sent before torque came on.

        Args:
            position: By joint [rad or m].
            sender: Who commands.
            late_s: How long the command was on its way [s].

        Returns:
            Why the whole command was refused, or an empty string.
        """
        reason = self._why_unfit(position, "position") or self._why_late(late_s)
        if reason:
            return reason
        targets = {}
        for name, value in position.items():
            joint = self._joints[name]
            angle = value / joint.transmission
            # an arm that leans on its stop reads a little beyond it: that is its limit, and no mistake
            spare = self.settings.limit_margin_rad
            if not joint.lower_rad - spare <= angle <= joint.upper_rad + spare:
                low = joint.lower_rad * joint.transmission
                high = joint.upper_rad * joint.transmission
                return f"{name}: {value:g} is outside its range {low:g} to {high:g}"
            targets[name] = min(max(angle, joint.lower_rad), joint.upper_rad)
        before = {name: joint.target_rad for name, joint in self._joints.items()}
        if self._sinks(self._here(), before | targets):
            least_cm = 100 * self.settings.min_clearance_m
            return f"the arm would be less than {least_cm:g} cm above the base's plane (min_clearance): command a higher pose"
        with self._lock:
            mover, moved_s = self._mover
            now = self._clock()
            if sender != mover and now - moved_s <= self.settings.command_timeout_s:
                return "another publisher is moving the arm; one at a time"
            self._mover = (sender, now)
            if not self.slipped:  # meanwhile
                self._targets.update(targets)
        return ""

    def _sinks(self, before_rad: Mapping[str, float], after_rad: Mapping[str, float]) -> bool:
        """Whether the arm comes too low on the way from one pose to another; an arm that is too low may rise."""
        after_m = self._height(after_rad)
        if after_m >= self.settings.min_clearance_m:
            return False
        return after_m < self._height(before_rad) - SINK_M

    def _here(self) -> dict[str, float]:
        return {name: joint.angle_rad for name, joint in self._joints.items()}

    def _height(self, angle_rad: Mapping[str, float]) -> float:
        pose = {name: angle * self._joints[name].transmission for name, angle in angle_rad.items()}
        return clearance(self.robot, {**self._rest, **pose})

    def hold(self) -> None:
        """End every current, and hold all joints where they are from the next cycle on; an arm without torque stays so."""
        with self._lock:
            self._hold_wanted = True
            self._drop_commands()

    def stop(self) -> None:
        """Current zero on every joint from the next cycle on, until torque is switched on again."""
        with self._lock:
            self._stop_wanted = True
            if self._torque_wanted:  # the later request counts
                self._torque_wanted = None
                self._torque_set.set()
            self._drop_commands()

    def set_torque(self, on: bool) -> None:
        """Off: the arm is limp. On: servos with a fault are rebooted, and the arm is held where it is."""
        with self._lock:
            self._torque_set.clear()
            self._torque_wanted = on
            self._stop_wanted = False
            self._drop_commands()

    def _drop_commands(self) -> None:
        self._command = None
        self._since_s = self._clock()
        self._targets.clear()

    def await_torque(self, seconds: float) -> bool:
        """Wait until the last `set_torque` was obeyed, or failed; returns whether that was in time."""
        return self._torque_set.wait(seconds)

    def cycle(self) -> ArmSample | None:
        """One round: read, check, command; never raises for what happens on the bus.

        Returns: What was read; None when the round was not intact, or its instant is not known.
        """
        self.statistics.cycles += 1
        if self.state is BusState.DISCONNECTED and not self._connected():
            return None
        try:
            self._obey_requests()
            self._look_after_silence()
            reading, timely = self._read()
            now = self._clock()
            sample = None
            if reading is not None:
                self._last_answer_s = now
                self._take(reading)
            elif now - self._last_answer_s > LOST_AFTER_S:
                words = f"no intact answer for {LOST_AFTER_S} s: check power and cable"
                raise PortLostError(f"{self.bus.port_name}: {words}")
            else:
                self.statistics.incomplete += 1
            # the deadline of a command counts, whether an answer came or not
            self._decide(now, reading is not None, timely)
            self._write_goals()
            if reading is not None and timely:
                sample = self._sample(reading)
            self.statistics.untimely += reading is not None and not timely
            self._set_watchdogs()
            self._look_after_health(now)
            return sample
        except BusError as error:
            self._lost(error)
            return None

    def _connected(self) -> bool:
        now = self._clock()
        if now < self._next_connect_s:
            return False
        self._next_connect_s = now + self.settings.reconnect_s
        try:
            self.bus.open()
            self.bus.handshake()
            if self._limp:
                self._release()
            else:
                self._hold_here()
        except BusError as error:
            self.bus.close()
            if str(error) != self.reason:
                self._log("error", f"{error}; trying again every {self.settings.reconnect_s:g} s")
            self.reason = str(error)
            return False
        for warning in self.bus.warnings:
            self._log("warning", warning)
        done = "torque is off, as before" if self._limp else "held where they are"
        self._log("info", f"{self.bus.port_name}: {len(self._joints)} servos, {done}")
        return True

    def _release(self) -> None:
        """Torque off."""
        self._let_go()
        for problem in self.bus.release():
            self._log("error", problem)
        self._last_answer_s = self._clock()
        self.state = BusState.RELEASED
        self.reason = "torque is off; ~/torque true holds the arm"

    def _let_go(self) -> None:
        """Report that nothing is driven or held."""
        self._driving = False
        for joint in self._joints.values():
            joint.let_go()

    def _hold_here(self) -> None:
        """Torque on, every joint held at its present position."""
        held_s = self.settings.hold_watchdog_s
        self.bus.prepare(watchdog_s=held_s, position_d_gain=self.settings.position_d_gain)
        self._patience_s = dict.fromkeys(self._joints, held_s)
        for _ in range(5):
            reading = self.bus.read_states()
            if len(reading.states) == len(self._joints):
                break
        else:
            raise BusError(
                f"{self.bus.port_name}: the servos answer one by one but not together: check the cable"
            )
        # what a servo already holds stays its goal: its present position sags under load, and once more with every new hold
        goals = {}
        for servo in self.bus.servos:
            counts = self.bus.read(servo.id, "goal_position")
            goals[servo.joint] = servo.model.angle_rad(counts)
        # a hot servo must not be driven before its turn comes
        self.health = {servo.joint: self.bus.health(servo.id) for servo in self.bus.servos}
        self._drop_commands()  # but not a stop that came meanwhile
        self._alerts.clear()
        self._driving = False
        self._limp = False
        self.slipped = False
        for name, joint in self._joints.items():
            here = reading.states[name].angle_rad
            goal = goals[name]
            joint.angle_rad = here
            joint.goal_rad = goal if abs(goal - here) < SAG_RAD else here
            joint.target_rad = joint.goal_rad
            joint.mode = JointMode.HELD
            joint.blocked = ""
            joint.commanded_A = 0.0
        self._last_answer_s = self._clock()
        self._sampled_at_s = reading.sampled_at_s
        self.state = BusState.RUNNING
        self.reason = "held"
        self._write_goals()

    def _obey_requests(self) -> None:
        if not self._lock.acquire(blocking=False):
            return  # somebody is just asking, and may not be run for a while
        try:
            stop = self._stop_wanted
            self._stop_wanted = False
            torque = self._torque_wanted
            self._torque_wanted = None
        finally:
            self._lock.release()
        if stop and self.state is BusState.RUNNING:
            self.state = BusState.STOPPED
            self.reason = "the current is zero; ~/torque true holds the arm again"
            self._let_go()
            self._write_goals()
            self._log("warning", f"stopped: {self.reason}")
        if torque is None:
            return
        try:
            if torque:
                self._hold_here()
            else:
                self._release()
        finally:
            if self._torque_wanted is None:  # not asked for once more meanwhile
                self._torque_set.set()

    def _read(self) -> tuple[Reading | None, bool]:
        """All servos' answers, asked for twice if need be, and whether the instant of their stamp can be trusted."""
        last = None
        for attempt in range(2):
            reading = self.bus.read_states()
            if len(reading.states) == len(self._joints):
                if not self._round_trips.unusual(reading.round_trip_s):
                    return reading, True
                last = reading
            self.statistics.retries += attempt == 0
        return last, False

    def _take(self, reading: Reading) -> None:
        since_s = max(reading.sampled_at_s - self._sampled_at_s, 0.0)
        self._sampled_at_s = reading.sampled_at_s
        # a position that no speed explains: the encoder, not the arm
        explained_rad = self.settings.max_jump_rad + self.settings.max_velocity_rad_s * since_s
        problems = []
        for name, state in reading.states.items():
            joint = self._joints[name]
            before_rad = joint.angle_rad
            joint.angle_rad = state.angle_rad
            joint.velocity_rad_s = state.velocity_rad_s
            if abs(joint.angle_rad - before_rad) > explained_rad:
                jump = f"from {before_rad:.3f} to {joint.angle_rad:.3f} rad"
                problems.append(f"{name}: its encoder jumped {jump}")
                if joint.mode is not JointMode.FREE:
                    joint.hold()  # the old goal, seen by the new encoder, would swing the arm
                # and whatever is commanded from now on means another pose than its sender knows
                self.slipped = True
            if state.alert and name not in self._alerts:
                self._alerts.add(name)
                problems.append(f"{name}: its servo reports a fault and has switched itself off")
                self._next_health_s = -np.inf
                self._health_turn = list(self._joints).index(name)
        # ends every current, until the commands have paused; after a slip, until torque comes on anew
        for problem in problems:
            self._log("error", f"{problem}; all joints are held")
            for joint in self._joints.values():
                if joint.mode is JointMode.DRIVEN:
                    joint.hold()
                joint.blocked = problem
            self.reason = f"{problem}; ~/torque true goes on" if self.slipped else problem
            self._targets.clear()

    def _decide(self, now: float, seen: bool, timely: bool) -> None:
        """What every joint does until the next cycle."""
        if self.state is not BusState.RUNNING:
            return
        command, targets, hold = self._requests(now)
        currents = {} if command is None else command.current_A
        timed_out = command is None and self._driving
        self._to_drive = set()
        for joint in self._joints.values():
            current_A = currents.get(joint.name)
            driven = joint.mode is JointMode.DRIVEN
            # a zero from nobody must not drop a joint that is held
            if current_A is not None and (driven or joint.pushed_by(current_A)):
                # a push begins in a cycle whose stamp is right, since everything is measured from that instant
                if timely or driven:
                    self._drive(joint, current_A)
                continue
            if hold and joint.mode is not JointMode.HELD:
                joint.hold()
            if joint.mode is JointMode.DRIVEN:
                self._end_push(joint, timed_out)
            if current_A is None:
                joint.blocked = ""  # the commands have paused
            if joint.name in targets:
                if joint.mode is JointMode.FREE:
                    joint.hold()
                joint.target_rad = targets[joint.name]
        self._driving = any(joint.mode is JointMode.DRIVEN for joint in self._joints.values())
        if seen:
            self._advance_goals()

    def _requests(self, now: float) -> tuple[CurrentCommand | None, dict[str, float], bool]:
        """The current command, new targets, and whether to hold.

        While another thread has the lock the last command counts, to its deadline, and all else waits.
        """
        command = self._command
        if command is not None and command.arrived_s < self._since_s:
            command = None  # it was about to come when all commands were dropped
        late = command is not None and now - command.arrived_s > self.settings.command_timeout_s
        if not self._lock.acquire(blocking=False):
            return None if late else command, {}, False
        try:
            targets = {} if self.slipped else self._targets
            self._targets = {}
            hold = self._hold_wanted
            self._hold_wanted = False
            if late and command is self._command:
                self._command = None
                self._since_s = now
        finally:
            self._lock.release()
        return None if late else command, targets, hold

    def _end_push(self, joint: DrivenJoint, timed_out: bool) -> None:
        """No current is commanded for a joint any more."""
        if timed_out and self.settings.on_timeout == "zero":
            joint.let_go()
        else:
            joint.hold()
        if timed_out:
            pause_ms = 1e3 * self.settings.command_timeout_s
            self._log("warning", f"{joint.name}: no current command for {pause_ms:.0f} ms")

    def _drive(self, joint: DrivenJoint, current_A: float) -> None:
        reason = joint.blocked or self._why_not_driven(joint, current_A)
        if reason:
            if not joint.blocked:
                self._log("warning", f"{reason}; held")
            joint.blocked = reason
            if joint.mode is JointMode.DRIVEN:
                joint.hold()
            return
        if joint.mode is not JointMode.DRIVEN:
            self._to_drive.add(joint.name)
            if self._patience_s.get(joint.name) != self.settings.watchdog_s:
                return  # in the next cycle, when its servo would stop soon without us
        joint.mode = JointMode.DRIVEN
        joint.commanded_A = joint.model.current_A(joint.model.counts_of_current(current_A))

    def _why_not_driven(self, joint: DrivenJoint, current_A: float) -> str:
        margin = self.settings.limit_margin_rad
        ahead_rad = joint.angle_rad + joint.velocity_rad_s * LOOKAHEAD_S
        if ahead_rad > joint.upper_rad - margin and (joint.velocity_rad_s > 0.0 or current_A > 0.0):
            return f"{joint.name} is at its upper limit"
        if ahead_rad < joint.lower_rad + margin and (joint.velocity_rad_s < 0.0 or current_A < 0.0):
            return f"{joint.name} is at its lower limit"
        if abs(joint.velocity_rad_s) > self.settings.max_velocity_rad_s:
            return f"{joint.name} turns at {joint.velocity_rad_s:.1f} rad/s, faster than {self.settings.max_velocity_rad_s:g}"
        if self._sinks(self._here(), {**self._here(), joint.name: ahead_rad}):
            return f"{joint.name} was about to bring the arm too near to the base's plane (min_clearance)"
        return ""

    def _advance_goals(self) -> None:
        """Goals of held joints follow their targets, no faster than allowed."""
        now = self._clock()
        step = self.settings.max_goal_velocity_rad_s * min(now - self._goals_at_s, 0.1)
        self._goals_at_s = now
        held = [joint for joint in self._joints.values() if joint.mode is JointMode.HELD]
        ways = {joint.name: joint.target_rad - joint.goal_rad for joint in held}
        if not any(ways.values()):
            return
        before = self._here() | {joint.name: joint.goal_rad for joint in held}
        reach = step + self.settings.max_goal_velocity_rad_s * LOOKAHEAD_S
        ahead = {
            name: angle + min(max(ways.get(name, 0.0), -reach), reach)
            for name, angle in before.items()
        }
        # joints arrive one after the other: between two poses that are high enough the arm may come too low
        height_m = self._height(before)
        self._note_height(height_m)
        if self._height(ahead) < self._least_height_m(height_m):
            words = "the arm was about to come too near to the base's plane (min_clearance); it stays where it is"
            self._log("warning", words)
            for joint in held:
                joint.target_rad = joint.goal_rad
            return
        for joint in held:
            joint.goal_rad += min(max(ways[joint.name], -step), step)

    def _note_height(self, height_m: float) -> None:
        """How high the goals have come; anew where a fall or a push has lowered the arm: no goal leads there."""
        lowered = height_m < self._reached_m - DIP_M
        self._reached_m = height_m if lowered else max(height_m, self._reached_m)

    def _least_height_m(self, height_m: float) -> float:
        """Of the next goals [m], by that of the present ones; an arm that is too low may dip a little on its way up."""
        least_m = self.settings.min_clearance_m
        if height_m >= least_m:
            return least_m
        return min(least_m, self._reached_m) - DIP_M

    def _write_goals(self) -> None:
        if self.state is BusState.RELEASED:
            return
        stopped = self.state is BusState.STOPPED
        self.bus.write_goals({name: joint.goal(stopped) for name, joint in self._joints.items()})
        self._written_at_s = self._clock()

    def _look_after_silence(self) -> None:
        """This process was not run for so long that servos may have stopped by themselves: hold the arm at once."""
        silent_s = self._clock() - self._written_at_s
        set_s = [patience for patience in self._patience_s.values() if patience > 0.0]
        soonest_s = min(set_s, default=np.inf) - BUS_WATCHDOG_UNIT_S
        if self.state is not BusState.RUNNING or silent_s < soonest_s:
            return
        tripped = [servo.joint for servo in self.bus.servos if self.bus.has_stopped(servo.id)]
        if tripped:
            words = f"{', '.join(tripped)}: stopped by the watchdog, since the driver was not run for {silent_s:.2f} s"
            self._log("warning", f"{words}; held again")
            self._hold_here()

    def _set_watchdogs(self) -> None:
        """Before a joint is driven its servo is told to stop soon without us; while none is, held ones may wait longer."""
        if self.state is not BusState.RUNNING:
            return
        soon_s = self.settings.watchdog_s
        later_s = self.settings.hold_watchdog_s
        wanted_s = dict.fromkeys(self._to_drive, soon_s)
        if not self._driving and not wanted_s:
            wanted_s = dict.fromkeys(self._joints, later_s)
        for servo in self.bus.servos:
            patience_s = wanted_s.get(servo.joint, self._patience_s[servo.joint])
            if patience_s == self._patience_s[servo.joint]:
                continue
            try:
                self.bus.set_watchdog(servo.id, patience_s)
            except PortLostError:
                raise
            except BusError as error:  # a joint that is to be driven waits for it
                self._log("warning", str(error))
                return
            self._patience_s[servo.joint] = patience_s

    def _sample(self, reading: Reading) -> ArmSample:
        joints = self._joints.items()
        position = {}
        velocity = {}
        measured_A = {}
        commanded_A = {}
        for name, joint in joints:
            position[name] = joint.angle_rad * joint.transmission
            velocity[name] = joint.velocity_rad_s * joint.transmission
            measured_A[name] = reading.states[name].current_A
            commanded_A[name] = joint.commanded_A if joint.mode is JointMode.DRIVEN else 0.0
        return ArmSample(reading.sampled_at_s, position, velocity, measured_A, commanded_A)

    def _look_after_health(self, now: float) -> None:
        """Temperatures and errors, a servo at a time; not while a joint is driven, when every cycle counts."""
        if now < self._next_health_s or (self._driving and not self._alerts):
            return
        self._next_health_s = now + HEALTH_PERIOD_S
        servo = self.bus.servos[self._health_turn % len(self.bus.servos)]
        self._health_turn += 1
        try:
            health = self.bus.health(servo.id)
        except PortLostError:
            raise
        except BusError as error:
            self._log("warning", str(error))
            return
        before = self.health.get(servo.joint)
        self.health[servo.joint] = health
        if health.faults and (before is None or before.faults != health.faults):
            self._log(
                "error", f"{servo.joint}: {'; '.join(health.faults)}; ~/torque true reboots it"
            )
        if health.watchdog_tripped and self.state is BusState.RUNNING:
            self._log("warning", f"{servo.joint}: its watchdog had stopped it; held again")
            self._hold_here()

    def _lost(self, error: BusError) -> None:
        """The bus is gone: the servos' own watchdog ends every current; try again from the start."""
        self.statistics.reconnects += 1
        self._end_pushes()
        self.bus.close()
        self._limp = self.state in (BusState.STOPPED, BusState.RELEASED)
        self.state = BusState.DISCONNECTED
        self.reason = str(error)
        self._next_connect_s = self._clock() + self.settings.reconnect_s
        for joint in self._joints.values():
            joint.mode = JointMode.HELD
            joint.commanded_A = 0.0
        self._log("error", f"{error}; trying again every {self.settings.reconnect_s:g} s")

    def _end_pushes(self) -> None:
        """Nothing is driven any more; where one servo alone is silent the others still hear it, and no answer is waited for."""
        for joint in self._joints.values():
            if joint.mode is JointMode.DRIVEN:
                joint.hold()
        if self.bus.is_open and self.state is not BusState.DISCONNECTED:
            with contextlib.suppress(BusError):
                self._write_goals()

    def close(self, hold: bool = False) -> None:
        """End: current zero and torque off, or with ``hold`` the arm held by its servos alone, their watchdog off."""
        if self.bus.is_open:
            try:
                if hold and self.state is BusState.RUNNING:
                    for joint in self._joints.values():
                        joint.hold()
                    self._write_goals()
                    for servo in self.bus.servos:
                        self.bus.write(servo.id, "bus_watchdog", 0)
                else:
                    for problem in self.bus.release():
                        self._log("error", problem)
            except BusError as error:
                self._log("error", f"{error}; the servos' watchdog ends their current")
            self.bus.close()
        self.state = BusState.DISCONNECTED
        self.reason = "closed"
