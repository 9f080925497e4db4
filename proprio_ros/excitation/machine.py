"""The state machine that makes a probe sequence: it takes samples and the time, and gives commands. No clock, no bus, no ROS.

Each run is: move to its start, rest, push with a constant current, a square wave or a step of the goal, hold. What the joints do
is watched at every tick, and whatever goes wrong while the push is on ends it at that very tick: the command then holds all joints
where they are.

A run without current lets one joint swing freely. Before anything moves it is computed that it would swing back inside its
limits, without friction and with an empty hand. When its time is over, or when a speed, a limit or the table is near, the joint is
caught: a current that carries its weight and brakes it comes on within `CATCH_RISE_S`, and where it has stopped it is held. What
makes positions unknown, or an abort, holds it at once.

Limits of motion that are given in rad count at the motor's shaft; for a joint that slides they are scaled by its transmission.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from proprio_ros.errors import ExcitationError
from proprio_ros.excitation.free_swing import FreeSwing, free_swing
from proprio_ros.excitation.plans import (
    LEAST_CURRENT_A,
    LEAST_SWING_RAD,
    ProbeRun,
    ProbeSequence,
    check_sequence,
    margin,
)
from proprio_ros.records import FloatArray
from proprio_ros.robot import Robot
from proprio_ros.robot.kinematics import clearance, zero_pose

MIN_APPROACH_S = 0.3
PEAK_OVER_MEAN = 1.875
"""Of a minimum-jerk motion (Flash & Hogan 1985): peak speed over mean speed."""
STANDSTILL_RAD_S = 0.02
STANDSTILL_WINDOW_S = 0.2
LONGEST_UNREST_S = 2.0
"""A joint that still moves so long after its time to settle will not come to rest."""
MOST_LOST_RUNS = 3
"""So many runs of a sequence may be lost to pauses of driver or computer and are repeated; one more ends it."""
LONGEST_STEP_S = 0.05  # goals move on by no more than this from sample to sample
PATH_STEP_RAD = 0.03  # of the joint that moves most, between two poses whose height is looked at
PATH_SLACK_M = 1e-3  # a way up from a low pose may dip by so much: encoders are not exact
LET_GO_S = 0.05
"""A swing begins with a current that is hardly one, against gravity: a driver lets go of a joint only where one was driven."""
CATCH_RISE_S = 0.04
CATCH_TIME_S = 0.1  # in which the speed falls to 1/e
CAUGHT_RAD_S = 0.1
LONGEST_CATCH_S = 0.8
"""A heavy hand is still lowered then, slowly, and held on the way."""
CATCH_LOOKAHEAD_S = 0.03
"""A joint that is being caught and would be at its limit within this time is held at once."""
CATCH_OVERSPEED = 1.15  # of the largest velocity: a joint that gets so fast while it is caught is held at once
_ROUNDING_S = 1e-6

_Problem = tuple[str, str]  # what ended it, as in `RunOutcome.ended_by`; and why, as one sentence


class Phase(Enum):
    """Where the machine is."""

    IDLE = "idle"
    APPROACH = "approach"
    SETTLE = "settle"
    PROBE = "probe"
    CATCH = "catch"
    BRAKE = "brake"
    RETURN = "return"
    DONE = "done"
    ABORTED = "aborted"


@dataclass(frozen=True)
class JointSample:
    """One reading of all driven joints.

    Attributes:
        time_s: When it was taken, on the clock of `ExcitationMachine.tick` [s].
        position: By joint [rad or m].
        velocity: By joint [rad/s or m/s].
    """

    time_s: float
    position: Mapping[str, float]
    velocity: Mapping[str, float]


@dataclass(frozen=True)
class Command:
    """What the servos are to do; no joint is in two of these.

    Attributes:
        position: Goals of joints that are held or moved [rad or m].
        current_A: Currents of joints that are pushed [A].
        stepped: Goals of joints that are pushed by a step of it [rad or m].
    """

    position: dict[str, float] = field(default_factory=dict)
    current_A: dict[str, float] = field(default_factory=dict)
    stepped: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Guards:
    """When to stop. Angles and speeds count at the motor's shaft.

    Attributes:
        limit_margin_rad: Room left before a joint's limit during a run.
        max_velocity_rad_s: No joint may be faster.
        stale_after_s: Neither samples nor ticks may be further apart while a current is on; such a run is repeated.
        patience_s: The same while all joints are held, which the servos do without us.
        follow_error_rad, follow_time_s: A joint may be off its goal by so much, for so long, while no current is on.
        lookahead_s: A run ends when its joint would reach a limit or the table within this time at its present speed.
        held_joint_error_rad: A joint that is held during a run may be off its goal by so much.
        max_jump_rad: A position may change by so much from one sample to the next, or as far as the largest velocity takes it.
    """

    limit_margin_rad: float = 0.05
    max_velocity_rad_s: float = 6.0
    stale_after_s: float = 0.1
    patience_s: float = 1.0
    follow_error_rad: float = 0.15
    follow_time_s: float = 0.5
    lookahead_s: float = 0.08
    held_joint_error_rad: float = 0.12
    max_jump_rad: float = 0.3


@dataclass(frozen=True)
class RunOutcome:
    """What became of one push.

    Attributes:
        run_number: From 1.
        attempt: From 1; further ones are repetitions with another current.
        joint: The joint pushed.
        current_A: Its current; of a square wave the mean.
        travel: Largest distance from where it was when the current came on, either way [rad or m].
        duration_s: For how long the current was on.
        ended_by: "time" or "travel" when all was well; else the guard: "limit", "velocity", "clearance", "held joint",
            "stale", "clock", "jump", "sample", or "abort". Of a free swing: what ended it; that it was caught comes after.
        used: Whether the run is good: it ended well and moved far enough.
    """

    run_number: int
    attempt: int
    joint: str
    current_A: float
    travel: float
    duration_s: float
    ended_by: str
    used: bool


@dataclass(frozen=True)
class _Way:
    """Minimum-jerk motions from pose to pose, with a stop at each.

    Attributes:
        poses: The first is where it begins.
        durations_s: Of the motions between them, one less.
    """

    poses: tuple[dict[str, float], ...]
    durations_s: tuple[float, ...]

    @property
    def duration_s(self) -> float:
        return sum(self.durations_s)

    def at(self, elapsed_s: float) -> dict[str, float]:
        for (before, after), duration_s in zip(itertools.pairwise(self.poses), self.durations_s, strict=True):
            if elapsed_s < duration_s:
                s = max(elapsed_s, 0.0) / duration_s
                part = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
                return {name: start + part * (after[name] - start) for name, start in before.items()}
            elapsed_s -= duration_s
        return dict(self.poses[-1])


def approach_s(widest_rad: FloatArray | float, velocity_rad_s: float) -> FloatArray:
    """How long a minimum-jerk way takes.

    Args:
        widest_rad: Of the joint that moves farthest, at the motor's shaft.
        velocity_rad_s: Peak speed there.
    """
    return np.maximum(MIN_APPROACH_S, PEAK_OVER_MEAN * widest_rad / velocity_rad_s)


class ExcitationMachine:
    """Makes probe sequences, one at a time.

    The same samples and times give the same commands. `start` begins a sequence; `tick` is to be called 40 times a second or
    more often until `busy` is false, and what it returns is to be sent to the servos at once.

    Args:
        robot: The arm. All joints with a drive train are commanded, and must be in every sample.
        guards: When to stop.
    """

    def __init__(self, robot: Robot, guards: Guards | None = None) -> None:
        self.robot = robot
        self.guards = guards or Guards()
        self.joints = tuple(robot.drive_trains)
        # what angles at the motor's shaft are in the joint's own unit
        self._per_rad = {name: margin(robot, name, 1.0) for name in self.joints}
        # joints without a motor are taken to stand at zero, or at the limit nearest to it
        self._rest = zero_pose(robot)
        self._phase = Phase.IDLE
        self._command = Command()
        self._message = "waiting for a sequence"
        self._abort_reason = self._aborted_by = ""
        self._sequence: ProbeSequence | None = None
        self._outcomes: list[RunOutcome] = []
        self._run_index = 0
        self._attempt = 1
        self._lost_runs = 0
        self._current_A = 0.0
        self._goals: dict[str, float] = {}
        self._run_pose: dict[str, float] = {}  # goals when the current came on
        self._way = _Way(({},), ())
        self._sample: JointSample | None = None
        self._now_s: float | None = None
        self._tick_s = 0.0
        self._phase_start_s: float | None = None
        self._way_s = 0.0  # how far along the way the goals are
        self._seen_s = 0.0  # how much of the time since the last tick was seen
        self._recent: deque[tuple[float, float]] = deque()  # times and positions of the run's joint at rest
        self._onset_position = 0.0
        self._travel = 0.0
        self._off_since_s: dict[str, float] = {}
        self._expected_s: list[tuple[float, ...]] = []
        self._fraction = 0.0
        self._swing: FreeSwing | None = None  # of the run, where it is one
        self._caught_for: _Problem | None = None  # what ends the sequence as soon as the joint is caught

    # ---------------------------------------------------------------------------------------------------------- status

    @property
    def phase(self) -> Phase:
        """What is going on."""
        return self._phase

    @property
    def busy(self) -> bool:
        """Whether a sequence is under way."""
        return self._phase not in (Phase.IDLE, Phase.DONE, Phase.ABORTED)

    @property
    def sequence(self) -> ProbeSequence | None:
        """The present sequence or the last one; None before the first."""
        return self._sequence

    @property
    def command(self) -> Command:
        """The last command; right after `abort` already the one that holds."""
        return self._command

    @property
    def run_number(self) -> int:
        """Number of the present run, from 1; 0 before the first sequence."""
        return 0 if self._sequence is None else self._run_index + 1

    @property
    def runs(self) -> int:
        """Number of runs in the sequence."""
        return 0 if self._sequence is None else len(self._sequence.runs)

    @property
    def attempt(self) -> int:
        """How many times the present run was begun."""
        return self._attempt

    @property
    def fraction(self) -> float:
        """How much of the sequence is behind us by expected time, 0 to 1; it never falls."""
        return self._fraction

    @property
    def message(self) -> str:
        """One sentence on what is going on, or how it ended."""
        return self._message

    @property
    def abort_reason(self) -> str:
        """Why the last sequence was ended; empty when it was not."""
        return self._abort_reason

    @property
    def aborted_by(self) -> str:
        """What ended the last sequence, as in `RunOutcome.ended_by`; empty when it was not."""
        return self._aborted_by

    @property
    def outcomes(self) -> list[RunOutcome]:
        """What became of each push of the present or last sequence."""
        return list(self._outcomes)

    # ------------------------------------------------------------------------------------------------------- interface

    def start(self, sequence: ProbeSequence, sample: JointSample) -> None:
        """Begin a sequence at the pose of a sample; the first command holds that pose.

        Raises:
            ExcitationError: A sequence is under way, the sample is not fit to start from, or no way to a start pose keeps
                the clearance.
            ConfigurationError, RobotError: The robot cannot make these runs.
        """
        if self._sequence is not None and self.busy:
            raise ExcitationError(
                f"{self._sequence.name} is under way (run {self.run_number} of {self.runs}): wait for its end, or abort it"
            )
        check_sequence(sequence, self.robot)
        if not sequence.runs:
            raise ExcitationError(
                f"{sequence.name}: its pushes are chosen while it goes on, by the identifier: call its service, not this one"
            )
        self._check_start(sample)
        pose = self._pose(sample)
        if sequence.from_here:
            sequence = sequence.begun_at(pose)
            check_sequence(sequence, self.robot)
        ways: list[_Way] = []
        expected_s: list[tuple[float, ...]] = []
        before = pose
        for number, run in enumerate(sequence.runs, 1):
            after = {**before, **run.start}
            ways.append(self._checked_way(before, after, sequence, f"the start of run {number} ({run.joint})"))
            expected_s.append((ways[-1].duration_s, sequence.settle_s, run.duration_s, sequence.brake_s))
            before = after
            if run.goal_step:
                self._check_step(run, after, sequence, f"{sequence.name}: run {number} ({run.joint})")
            if run.free:
                self._check_swing(
                    run, after, sequence, f"{sequence.name}: run {number} ({run.joint}) cannot swing freely"
                )
        if sequence.home:
            home = self._checked_way(before, {**before, **sequence.home}, sequence, "home")
            expected_s.append((home.duration_s,))
        self._sequence = sequence
        self._outcomes, self._abort_reason, self._aborted_by, self._caught_for = [], "", "", None
        self._run_index, self._attempt, self._fraction, self._lost_runs = 0, 1, 0.0, 0
        self._current_A = sequence.runs[0].current_A
        self._sample, self._now_s, self._tick_s = sample, None, 0.0
        self._expected_s = expected_s
        self._goals, self._way = dict(pose), ways[0]
        self._enter(Phase.APPROACH, None)
        self._command = Command(dict(pose))

    def tick(self, now_s: float, sample: JointSample | None) -> Command:
        """What the servos are to do now.

        Args:
            now_s: The time, on the clock of the samples; it never runs backwards [s].
            sample: The newest reading, also when it is the one of the last tick; None: none since then.
        """
        if not self.busy:
            return self._command
        problem = self._observe(now_s, sample)
        if problem is None:
            problem = self._advance(now_s)
        if problem is None and self.busy:
            problem = self._watch(now_s)
        if problem is not None:
            problem = self._left_of(problem, now_s)
        if problem is not None:
            self._stop(*problem)
        else:
            self._command = self._commanded()
            self._fraction = max(self._fraction, self._progress(now_s))
        return self._command

    def _left_of(self, problem: _Problem, now_s: float) -> _Problem | None:
        """The problem; None where it costs a run at most, or where a swinging joint is caught before it ends the sequence."""
        assert self._sample is not None
        kind, reason = problem
        if kind == "stale" and self._phase is Phase.PROBE and self._lost_runs < MOST_LOST_RUNS:
            self._lost_runs += 1
            self._brake(now_s, "stale")
            self._message = f"run {self.run_number} of {self.runs} is lost: {reason}"
            return None
        if kind == "stale" and self._phase is Phase.CATCH and self._caught_for is None:
            self._hold_driven(now_s)  # the swing was over
            return None
        if kind in ("velocity", "limit", "clearance") and self._phase is Phase.PROBE and self._run.free:
            speed = abs(self._sample.velocity[self._run.joint]) / self._per_rad[self._run.joint]
            if kind == "velocity" and speed <= self.guards.max_velocity_rad_s:
                return problem  # it is another joint that is so fast
            self._catch(now_s, kind)
            self._caught_for = problem
            return None
        return problem

    def abort(self, reason: str) -> None:
        """End the sequence: `command` and the next tick hold all joints where they are. Without a sequence, nothing."""
        if self.busy:
            self._stop("abort", reason)

    # --------------------------------------------------------------------------------------------------- what comes in

    def _check_start(self, sample: JointSample) -> None:
        problem = self._unfit(sample)
        if problem:
            raise ExcitationError(f"cannot start: {problem}")
        for name in self.joints:
            joint = self.robot.model.joint(name)
            position, spare = sample.position[name], self.guards.limit_margin_rad * self._per_rad[name]
            if not joint.lower - spare <= position <= joint.upper + spare:
                raise ExcitationError(
                    f"cannot start: {name} reads {position:.4g}, outside its limits {joint.lower:.4g} .. {joint.upper:.4g}; "
                    "check its zero and its unit, or move it back by hand with torque off"
                )

    def _unfit(self, sample: JointSample) -> str:
        """What is wrong with a sample in itself; empty when nothing is."""
        if not math.isfinite(sample.time_s):
            return f"a sample has the time stamp {sample.time_s}: check the driver"
        for what, values in (("position", sample.position), ("velocity", sample.velocity)):
            missing = [name for name in self.joints if name not in values]
            if missing:
                return f"a sample lacks the {what} of {', '.join(missing)}: check that all servos answer"
            for name in self.joints:
                if not math.isfinite(values[name]):
                    return f"the {what} of {name} is {values[name]}: check the driver and the cable"
        return ""

    def _observe(self, now_s: float, sample: JointSample | None) -> _Problem | None:
        """Take in the time and a sample, unless something is wrong with them."""
        assert self._sample is not None
        driven = self._phase in (Phase.PROBE, Phase.CATCH)
        longest_s = self.guards.stale_after_s if driven else self.guards.patience_s
        if not math.isfinite(now_s):
            return "clock", f"the time is {now_s}: check the clock"
        if self._now_s is not None:
            self._tick_s = now_s - self._now_s
            if self._tick_s < 0.0:
                return "clock", f"the clock ran back by {-self._tick_s:.3f} s: use a clock that is never set"
            if self._tick_s > longest_s:
                self._now_s = now_s
                return "stale", f"the control loop paused for {self._tick_s:.2f} s: is the computer overloaded?"
        self._now_s = now_s
        self._seen_s = gap_s = 0.0
        if sample is not None:
            problem = self._unfit(sample)
            if problem:
                return "sample", problem
            if sample.time_s < self._sample.time_s:
                return "clock", f"a sample is {self._sample.time_s - sample.time_s:.3f} s older than the one before it"
            gap_s = sample.time_s - self._sample.time_s
            # goals wait for joints that were not seen for a while: the servos may have missed the command, too
            self._seen_s = min(gap_s, LONGEST_STEP_S)
            if gap_s > 0.0:
                # between samples that are far apart a joint may have gone on as fast as it may
                allowed = max(self.guards.max_jump_rad, self.guards.max_velocity_rad_s * gap_s)
                for name in self.joints:
                    jump = abs(sample.position[name] - self._sample.position[name]) / self._per_rad[name]
                    if jump > allowed:
                        return (
                            "jump",
                            f"{name} jumped by {jump:.2f} rad between two samples: check its encoder and cable",
                        )
                self._sample = sample
                self._recent.append((sample.time_s, sample.position[self._run.joint]))
        age_s = now_s - self._sample.time_s
        if age_s > longest_s:
            return "stale", f"no new joint positions for {age_s:.2f} s: is the driver alive?"
        if age_s < -longest_s:
            return "clock", f"a sample is stamped {-age_s:.2f} s ahead of the time: both need the same clock"
        if gap_s > longest_s:
            return "stale", f"two samples are {gap_s:.2f} s apart: is the computer overloaded?"
        return None

    # -------------------------------------------------------------------------------------------------- what goes wrong

    def _watch(self, now_s: float) -> _Problem | None:
        """What the joints do that they should not, in the phase of this tick."""
        assert self._sample is not None
        guards, sample = self.guards, self._sample
        caught = self._phase is Phase.CATCH
        for name in self.joints:
            speed = abs(sample.velocity[name]) / self._per_rad[name]
            if speed > guards.max_velocity_rad_s * (CATCH_OVERSPEED if caught else 1.0):
                return "velocity", f"{name} moves at {speed:.1f} rad/s, faster than {guards.max_velocity_rad_s:g} rad/s"
        if self._phase is Phase.PROBE or caught:
            return self._watch_held() or self._watch_pushed(CATCH_LOOKAHEAD_S if caught else guards.lookahead_s)
        for name in self.joints:
            off = abs(sample.position[name] - self._goals[name]) / self._per_rad[name]
            if off <= guards.follow_error_rad:
                self._off_since_s.pop(name, None)
            elif now_s - self._off_since_s.setdefault(name, now_s) >= guards.follow_time_s:
                return "follow", f"{name} does not follow: is something in its way, its load too heavy, or torque off?"
        return None

    def _watch_held(self) -> _Problem | None:
        assert self._sample is not None
        for name in self.joints:
            if name != self._run.joint:
                off = abs(self._sample.position[name] - self._goals[name]) / self._per_rad[name]
                if off > self.guards.held_joint_error_rad:
                    return (
                        "held joint",
                        f"{name} gave way by {off:.2f} rad during the run: is its torque on, or was it pushed?",
                    )
        return None

    def _watch_pushed(self, lookahead_s: float) -> _Problem | None:
        assert self._sample is not None and self._sequence is not None
        name = self._run.joint
        joint = self.robot.model.joint(name)
        position, velocity = self._sample.position[name], self._sample.velocity[name]
        ahead = position + velocity * lookahead_s
        spare = 0.0 if self._phase is Phase.CATCH else self.guards.limit_margin_rad * self._per_rad[name]
        below = position < joint.lower or (velocity < 0.0 and ahead < joint.lower + spare)
        above = position > joint.upper or (velocity > 0.0 and ahead > joint.upper - spare)
        if below or above:
            limit = joint.lower if below else joint.upper
            return "limit", f"{name} was about to reach its limit {limit:.3g}: {self._remedy(velocity)}"
        pose = self._pose(self._sample)
        least_m = self._sequence.min_clearance_m * (0.5 if self._phase is Phase.CATCH else 1.0)
        for place in (position, ahead):
            height = self._height({**pose, name: place})
            if height < least_m:
                return "clearance", (
                    f"{name} was about to bring the arm {100 * height:.1f} cm above the base's plane: {self._remedy(velocity)}"
                )
        return None

    def _remedy(self, velocity: float) -> str:
        if self._run.free:
            return "is the hand empty, and the base level? let it swing from nearer to where it hangs"
        if self._run.goal_step:
            return "use a smaller goal_step, less time, or another start"
        if velocity * self._current_A < 0.0:
            return "its load pulls it there against the current; use more current, or another start"
        return "use less current, less time, or a smaller max_travel"

    def _stop(self, ended_by: str, reason: str) -> None:
        """Hold every joint where it was last seen, at once."""
        assert self._sample is not None
        self._caught_for = None
        if self._phase is Phase.PROBE:
            self._note_outcome(ended_by, used=False)
        self._goals = self._pose(self._sample)
        self._phase, self._aborted_by = Phase.ABORTED, ended_by
        self._abort_reason = reason
        self._message = f"stopped in run {self.run_number} of {self.runs}: {reason}"
        self._command = self._commanded()

    # --------------------------------------------------------------------------------------------------- what comes next

    @property
    def _run(self) -> ProbeRun:
        assert self._sequence is not None
        return self._sequence.runs[self._run_index]

    def _enter(self, phase: Phase, now_s: float | None) -> None:
        """Begin a phase; None: with the next tick."""
        self._phase, self._phase_start_s, self._way_s = phase, now_s, 0.0
        self._off_since_s.clear()
        if phase is Phase.SETTLE:
            self._recent.clear()
        run = f"run {self.run_number} of {self.runs}" + f", attempt {self._attempt}" * (self._attempt > 1)
        shake = f" +-{abs(self._run.shake_A):.3g}" * (self._run.shake_A != 0.0)
        pushed = "swings freely" if self._run.free else f"is pushed with {self._current_A:+.3g}{shake} A"
        if self._run.goal_step:
            pushed = f"is pushed by a goal {self._run.goal_step:+.3g} {self._unit} away"
        self._message = {
            Phase.APPROACH: f"{run}: moving to the start pose",
            Phase.SETTLE: f"{run}: waiting until {self._run.joint} is at rest",
            Phase.PROBE: f"{run}: {self._run.joint} {pushed}",
            Phase.CATCH: f"{run}: {self._run.joint} swung by {self._travel:.3g} {self._unit} and is caught",
            Phase.BRAKE: f"{run}: {self._run.joint} moved {self._travel:.3g} {self._unit} and is held",
            Phase.RETURN: "moving home",
            Phase.DONE: self._summary(),
        }[phase]

    def _advance(self, now_s: float) -> _Problem | None:
        """Goals and phase of this tick."""
        assert self._sequence is not None and self._sample is not None
        if self._phase_start_s is None:
            self._phase_start_s = now_s
        elapsed_s = now_s - self._phase_start_s + _ROUNDING_S
        if self._phase in (Phase.APPROACH, Phase.RETURN):
            self._way_s += self._seen_s
            self._goals = self._way.at(self._way_s)
            if self._way_s + _ROUNDING_S >= self._way.duration_s:
                self._enter(Phase.SETTLE if self._phase is Phase.APPROACH else Phase.DONE, now_s)
        elif self._phase is Phase.SETTLE:
            if elapsed_s >= self._sequence.settle_s and self._still(now_s):
                self._run_pose = dict(self._goals)
                self._onset_position, self._travel = self._sample.position[self._run.joint], 0.0
                if self._run.free:
                    pose = {**self._rest, **self._pose(self._sample)}
                    self._swing = free_swing(self.robot, self._run.joint, pose)
                self._enter(Phase.PROBE, now_s)
            elif elapsed_s > self._sequence.settle_s + LONGEST_UNREST_S:
                return (
                    "unrest",
                    f"{self._run.joint} does not come to rest: hold the arm's table still, or check the servo",
                )
        elif self._phase is Phase.PROBE:
            self._travel = max(self._travel, abs(self._sample.position[self._run.joint] - self._onset_position))
            end = self._catch if self._run.free else self._brake
            if self._travel >= self._run.max_travel:
                end(now_s, "travel")
            elif elapsed_s + 0.5 * self._tick_s >= self._run.duration_s:  # the nearest tick
                end(now_s, "time")
        elif self._phase is Phase.CATCH:
            speed = abs(self._sample.velocity[self._run.joint]) / self._per_rad[self._run.joint]
            if elapsed_s >= LONGEST_CATCH_S or (elapsed_s >= CATCH_RISE_S and speed <= CAUGHT_RAD_S):
                if self._caught_for is not None:
                    return self._caught_for
                self._hold_driven(now_s)
        elif elapsed_s >= self._sequence.brake_s:
            return self._after_run(now_s)
        return None

    def _still(self, now_s: float) -> bool:
        """Whether the run's joint stands, by its positions: single velocities are too coarse."""
        while self._recent and self._recent[0][0] < now_s - STANDSTILL_WINDOW_S - self.guards.stale_after_s:
            self._recent.popleft()
        recent = np.array([entry for entry in self._recent if entry[0] >= now_s - STANDSTILL_WINDOW_S - _ROUNDING_S])
        if len(recent) < 3 or recent[-1, 0] - recent[0, 0] < 0.5 * STANDSTILL_WINDOW_S:
            return False
        times_s, positions = (recent - recent.mean(axis=0)).T
        slope = float(times_s @ positions) / float(times_s @ times_s)
        slowest = STANDSTILL_RAD_S * self._per_rad[self._run.joint]
        # to and fro has no slope; noise of an encoder at rest spans half of this at most
        return abs(slope) < slowest and float(np.ptp(positions)) < 2.0 * slowest * STANDSTILL_WINDOW_S

    def _brake(self, now_s: float, ended_by: str) -> None:
        assert self._sample is not None
        self._note_outcome(ended_by, used=ended_by != "stale" and self._travel >= self._run.min_travel)
        self._hold_driven(now_s)

    def _hold_driven(self, now_s: float) -> None:
        """The run's joint stays where it was last seen."""
        assert self._sample is not None
        self._goals = {**self._goals, self._run.joint: self._sample.position[self._run.joint]}
        self._enter(Phase.BRAKE, now_s)

    def _catch(self, now_s: float, ended_by: str) -> None:
        """A swing is over."""
        far = self._travel >= max(self._run.min_travel, margin(self.robot, self._run.joint, LEAST_SWING_RAD))
        self._note_outcome(ended_by, used=ended_by in ("time", "travel") and far)
        self._enter(Phase.CATCH, now_s)

    def _note_outcome(self, ended_by: str, used: bool) -> None:
        assert self._now_s is not None and self._phase_start_s is not None
        self._outcomes.append(
            RunOutcome(
                run_number=self.run_number,
                attempt=self._attempt,
                joint=self._run.joint,
                current_A=self._current_A,
                travel=self._travel,
                duration_s=self._now_s - self._phase_start_s,
                ended_by=ended_by,
                used=used,
            )
        )

    def _after_run(self, now_s: float) -> _Problem | None:
        """Once more with another current, or the next run, or home, or the end."""
        assert self._sequence is not None
        last = self._outcomes[-1]
        again_A = None if last.used else self._run.other_current(self._current_A)
        if last.ended_by == "stale":
            again_A = self._current_A  # nothing was wrong with the push
        phase = Phase.APPROACH
        if again_A is not None:
            self._attempt += 1
            self._current_A = again_A
            target, where = self._run_pose, "the start of the run"
        elif self._run_index + 1 < self.runs:
            self._run_index += 1
            self._attempt = 1
            self._current_A = self._run.current_A
            target, where = {**self._goals, **self._run.start}, "the start of the next run"
        elif self._sequence.home:
            phase = Phase.RETURN
            target, where = {**self._goals, **self._sequence.home}, "home"
        else:
            self._enter(Phase.DONE, now_s)
            return None
        try:
            self._way = self._checked_way(self._goals, target, self._sequence, where)
        except ExcitationError as error:
            return "clearance", str(error)
        self._enter(phase, now_s)
        return None

    def _commanded(self) -> Command:
        if self._phase not in (Phase.PROBE, Phase.CATCH):
            return Command(dict(self._goals))
        joint = self._run.joint
        held = {name: goal for name, goal in self._goals.items() if name != joint}
        if self._run.goal_step:
            return Command(held, stepped={joint: self._goals[joint] + self._run.goal_step})
        assert self._now_s is not None and self._phase_start_s is not None
        elapsed_s = self._now_s - self._phase_start_s
        # the wave changes, like the run ends, at the nearest tick; a pause before the onset is none of it
        nearest_s = elapsed_s + 0.5 * min(self._tick_s, elapsed_s)
        current_A = self._run.current_at(nearest_s, self._current_A)
        if self._run.free:
            current_A = self._current_of_swing(elapsed_s)
        return Command(held, {joint: current_A})

    def _current_of_swing(self, elapsed_s: float) -> float:
        """Next to nothing, then nothing; and what carries the joint's weight and brakes it when it is caught [A]."""
        assert self._swing is not None and self._sample is not None
        joint, swing = self._run.joint, self._swing
        drive = self.robot.drive_trains[joint]
        weight_N_m = swing.moment_at(self._sample.position[joint]) * drive.transmission  # at the shaft
        if self._phase is Phase.PROBE:
            return 0.0 if elapsed_s + 0.5 * self._tick_s >= LET_GO_S else -math.copysign(LEAST_CURRENT_A, weight_N_m)
        inertia = swing.inertia_kg_m2 * drive.transmission**2 + drive.armature.value
        braking_N_m = inertia / CATCH_TIME_S * self._sample.velocity[joint] / drive.transmission
        limit_A = self.robot.motors[joint].current_limit_A
        current_A = -(weight_N_m + braking_N_m) / drive.torque_constant.value * min(elapsed_s / CATCH_RISE_S, 1.0)
        return min(max(current_A, -limit_A), limit_A)

    # ----------------------------------------------------------------------------------------------------------- words

    @property
    def _unit(self) -> str:
        return "m" if self.robot.model.joint(self._run.joint).kind == "prismatic" else "rad"

    def _summary(self) -> str:
        assert self._sequence is not None
        good = {outcome.run_number for outcome in self._outcomes if outcome.used}
        poor = [str(number) for number in range(1, self.runs + 1) if number not in good]
        if not poor:
            return f"{self._sequence.name} is done: all {self.runs} runs are good"
        return (
            f"{self._sequence.name} is done: {len(good)} of {self.runs} runs are good; run {', '.join(poor)} moved too little: "
            f"allow {'a larger goal_step' if self._run.goal_step else 'more current'}, or start where gravity helps"
        )

    def _progress(self, now_s: float) -> float:
        if self._phase is Phase.DONE:
            return 1.0
        order = [Phase.APPROACH, Phase.SETTLE, Phase.PROBE, Phase.CATCH if self._phase is Phase.CATCH else Phase.BRAKE]
        place = len(self._expected_s) - 1 if self._phase is Phase.RETURN else self._run_index
        parts = self._expected_s[place]
        step = 0 if self._phase is Phase.RETURN else order.index(self._phase)
        elapsed_s = now_s - (now_s if self._phase_start_s is None else self._phase_start_s)
        spent_s = sum(map(sum, self._expected_s[:place])) + sum(parts[:step]) + min(elapsed_s, parts[step])
        return spent_s / sum(map(sum, self._expected_s))

    def _check_step(self, run: ProbeRun, start: Mapping[str, float], sequence: ProbeSequence, words: str) -> None:
        """Whether a servo that goes all the way to its goal stays within limits and clear of the table.

        Raises:
            ExcitationError: It would not.
        """
        joint, spare = self.robot.model.joint(run.joint), self.guards.limit_margin_rad * self._per_rad[run.joint]
        goal = start[run.joint] + run.goal_step
        if not joint.lower + spare <= goal <= joint.upper - spare:
            raise ExcitationError(
                f"{words}: its goal would be {goal:.3g}, outside {joint.lower + spare:.3g} .. {joint.upper - spare:.3g} (limits "
                "less a margin); use a smaller goal_step, or another start"
            )
        if not self._free(({**start}, {**start, run.joint: goal}), sequence.min_clearance_m):
            raise ExcitationError(
                f"{words}: on the way to its goal the arm would come too near to the base's plane; choose a higher pose"
            )

    def _check_swing(self, run: ProbeRun, start: Mapping[str, float], sequence: ProbeSequence, words: str) -> None:
        """Whether the joint would swing back without a guard ending it, with the lightest rotor that the robot file allows.

        Raises:
            ExcitationError: It would not.
        """
        name, guards, joint = run.joint, self.guards, self.robot.model.joint(run.joint)
        pose = {**self._rest, **start}
        swing = free_swing(self.robot, name, pose)
        drive = self.robot.drive_trains[name]
        weight_N_m = abs(swing.moment_at(pose[name]) * drive.transmission)
        # what is to be expected of a number that cannot be negative and is only known to be small: a half-normal's mean
        friction_N_m = max(drive.coulomb.value, math.sqrt(2.0 / math.pi) * drive.coulomb.std)
        hangs = f"it would hang at {swing.rest:.3g} rad"
        spare = guards.limit_margin_rad * self._per_rad[name]
        low, high = joint.lower + spare, joint.upper - spare
        if not low <= swing.rest <= high:
            raise ExcitationError(
                f"{words}: {hangs}, outside {low:.3g} .. {high:.3g} (limits less a margin); move the other joints, so that it "
                "hangs inside, or choose another joint"
            )
        if weight_N_m <= friction_N_m:
            raise ExcitationError(
                f"{words}: from {pose[name]:.3g} rad gravity pulls with {weight_N_m:.2g} N m, and its friction is probably "
                f"{friction_N_m:.2g} N m; start farther from where {hangs}, or take a calibration that knows the friction"
            )
        rotor = max(drive.armature.value - drive.armature.std, 0.0) / drive.transmission**2
        for place in swing.way(pose[name]).tolist():
            speed = swing.speed_at(place, pose[name], rotor)
            if speed > guards.max_velocity_rad_s * self._per_rad[name]:
                raise ExcitationError(f"{words}: it may reach {speed:.1f} rad/s; start nearer to where {hangs}")
            for ahead in (place - speed * guards.lookahead_s, place + speed * guards.lookahead_s):
                if not low <= ahead <= high:
                    raise ExcitationError(
                        f"{words}: {hangs}, and may swing past {ahead:.3g} rad without friction, outside {low:.3g} .. {high:.3g} "
                        "(limits less a margin); start nearer to where it hangs, or move the other joints"
                    )
                height = self._height({**pose, name: ahead})
                if height < sequence.min_clearance_m:
                    raise ExcitationError(
                        f"{words}: it would come {100 * height:.1f} cm above the base's plane at {ahead:.3g} rad without friction; "
                        "choose a higher pose, or start nearer to where it hangs"
                    )

    # ------------------------------------------------------------------------------------------------------------ ways

    def _pose(self, sample: JointSample) -> dict[str, float]:
        return {name: float(sample.position[name]) for name in self.joints}

    def _height(self, pose: Mapping[str, float]) -> float:
        return clearance(self.robot, {**self._rest, **pose})

    def _checked_way(
        self, before: Mapping[str, float], after: Mapping[str, float], sequence: ProbeSequence, where: str
    ) -> _Way:
        """The straight way in joint space, or one over a higher pose when that comes too low.

        Raises:
            ExcitationError: Neither keeps the clearance.
        """
        for via in itertools.chain([()], ((pose,) for pose in self._high_poses(before, after))):
            poses = (dict(before), *via, dict(after))
            if self._free(poses, sequence.min_clearance_m):
                pairs = itertools.pairwise(poses)
                return _Way(poses, tuple(self._duration_s(a, b, sequence.approach_velocity) for a, b in pairs))
        raise ExcitationError(
            f"no way to {where} keeps the arm {100 * sequence.min_clearance_m:.0f} cm above the base's plane: move it to a "
            "higher pose by hand, with torque off, and start again"
        )

    def check_way(self, before: Mapping[str, float], after: Mapping[str, float], sequence: ProbeSequence) -> None:
        """Whether there is a way from pose to pose, over a higher one where it must.

        Raises:
            ExcitationError: None keeps the clearance.
        """
        self._checked_way(before, after, sequence, "the start of the push")

    def _high_poses(self, before: Mapping[str, float], after: Mapping[str, float]) -> list[dict[str, float]]:
        """Poses to go over, highest first: some joints moved before the others, or the arm at its zero pose."""
        turning = [name for name in self.joints if self.robot.model.joint(name).kind != "prismatic"]
        moved = [name for name in turning if before[name] != after[name]]
        poses = [
            {**before, **{name: after[name] for name in first}}
            for count in range(1, len(moved))
            for first in itertools.combinations(moved, count)
        ]
        # the base joint does not lift anything: leave it where it is
        poses.append({**before, **{name: self._rest[name] for name in turning[1:]}})
        return sorted(poses, key=lambda pose: -self._height(pose))

    def _free(self, poses: Sequence[Mapping[str, float]], min_clearance_m: float) -> bool:
        """Whether the arm stays high enough; where it begins too low, whether it only rises until it is."""
        reached = self._height(poses[0])
        for before, after in itertools.pairwise(poses):
            widest = max(abs(after[name] - before[name]) / self._per_rad[name] for name in self.joints)
            for part in np.linspace(0.0, 1.0, max(2, 1 + math.ceil(widest / PATH_STEP_RAD))).tolist():
                height = self._height({name: q + part * (after[name] - q) for name, q in before.items()})
                if height < min(min_clearance_m, reached) - PATH_SLACK_M:
                    return False
                reached = max(reached, height)
        return reached >= min_clearance_m - PATH_SLACK_M

    def _duration_s(self, before: Mapping[str, float], after: Mapping[str, float], velocity_rad_s: float) -> float:
        widest = max(abs(after[name] - before[name]) / self._per_rad[name] for name in self.joints)
        return float(approach_s(widest, velocity_rad_s))
