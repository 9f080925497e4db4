"""The state machine that makes a sequence of excitations: it takes samples and the time, and gives commands.

It has no clock, no bus, no ROS. Each run is: move to its start, rest, push with a constant current, a square wave or a step of the
goal, hold. What the joints do is watched at every tick, and whatever goes wrong while the push is on ends it at that very tick: the
command then holds all joints where they are.

A run without current is the free response of one joint. Before anything moves it is computed (``guards.py``) that it would swing
back inside its limits. When its time is over, or when a speed, a limit or the table is near, the joint is caught: a current that
carries its weight and brakes it comes on within `CATCH_RISE_S`, and where it has stopped it is held. What makes positions unknown,
or an abort, holds it at once.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np

from proprio_ros.errors import ExcitationError
from proprio_ros.excitation import plans
from proprio_ros.excitation.commands import Command, JointSample
from proprio_ros.excitation.guards import (
    FreeResponse,
    Guards,
    check_free_response,
    check_start,
    free_swing,
    unfit,
)
from proprio_ros.excitation.pushes import push_of
from proprio_ros.excitation.ways import Way, Ways
from proprio_ros.robot import Robot

STANDSTILL_RAD_S = 0.02
STANDSTILL_WINDOW_S = 0.2
# a joint that still moves so long after its time to settle will not come to rest
LONGEST_UNREST_S = 2.0
# so many may be lost to pauses of driver or computer and are repeated; one more ends the sequence
MOST_LOST_RUNS = 3
LONGEST_STEP_S = 0.05  # goals move on by no more than this from sample to sample
SLOWEST = 0.2  # share of their speed at which goals go on however far a joint is behind them
LEAST_SWING_RAD = 0.1  # at the shaft: a recording tells which joint swung freely by that
LET_GO_S = 0.05
"""A swing begins with a current that is hardly one, against gravity: a driver lets go of a joint only where one was driven."""
CATCH_RISE_S = 0.04
CATCH_TIME_S = 0.1  # in which the speed falls to 1/e
CAUGHT_RAD_S = 0.1
LONGEST_CATCH_S = 0.8  # a heavy hand is still lowered then, slowly, and held on the way
# a joint that is being caught and would be at its limit within this time is held at once
CATCH_LOOKAHEAD_S = 0.03
# of the largest velocity: a joint that gets so fast while it is caught is held at once
CATCH_OVERSPEED = 1.15
_ROUNDING_S = 1e-6


@dataclass(frozen=True)
class Problem:
    """What ends a run or a sequence."""

    ended_by: str  # as in `RunOutcome.ended_by`
    reason: str  # why, as one sentence


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


_STEPS = {
    Phase.APPROACH: 0,
    Phase.SETTLE: 1,
    Phase.PROBE: 2,
    Phase.CATCH: 3,
    Phase.BRAKE: 3,
}
"""Of each run, in the order of `_Outline.expected_s`."""
DRIVEN = (Phase.PROBE, Phase.CATCH)
"""In which no servo holds the run's joint: a current, a goal's step or nothing drives it."""
AT_AN_END = (Phase.IDLE, Phase.DONE, Phase.ABORTED)
CAUGHT_AFTER = ("velocity", "limit", "clearance")  # a joint that swings freely is caught for these


@dataclass(frozen=True)
class RunOutcome:
    """What became of one push."""

    # run_number, attempt: from 1; further attempts are repetitions with another current
    run_number: int
    attempt: int
    joint: str  # the joint pushed
    current_A: float  # its current; of a square wave the mean
    # largest distance from where it was when the current came on, either way [rad or m]
    travel: float
    duration_s: float  # for how long the current was on
    # "time" or "travel" when all was well; else the guard: "limit", "velocity", "clearance", "held joint", "stale",
    # "clock", "jump", "sample", "follow", "unrest", or "abort". Of a free response: what ended it; that it was caught comes after
    ended_by: str
    used: bool  # whether the run is good: it ended well and moved far enough


@dataclass(frozen=True)
class _Outline:
    """What is known of a sequence before anything moves."""

    way: Way  # to the start of the first run
    # of each run: its way, its rest, its push and its braking; of the way home: that alone [s]
    expected_s: tuple[tuple[float, ...], ...]


class ExcitationMachine:
    """Makes sequences of excitations, one at a time. All joints with a drive train are commanded, and must be in every sample.

    The same samples and times give the same commands. `start` begins a sequence; `tick` is to be called 40 times a second or
    more often until `busy` is false, and what it returns is to be sent to the servos at once.

    Attributes:
        ways: Of the arm, from pose to pose.
        sequence: The present one or the last one; None before the first.
        command: The last one; right after `abort` already the one that holds.
        outcomes: What became of each push of the present or last sequence.
        attempt: How many times the present run was begun.
        fraction: How much of the sequence is behind us by expected time, 0 to 1; it never falls.
        pace: How fast joints follow, 1 or less: ways take so much longer, and joints have so much longer to come to rest.
        message: One sentence on what is going on, or how it ended.
        abort_reason, aborted_by: Why the last sequence was ended, and what ended it, as in `RunOutcome.ended_by`; else empty.
    """

    def __init__(self, robot: Robot, guards: Guards | None = None) -> None:
        self.robot = robot
        self.guards = guards or Guards()
        self.ways = Ways(robot)
        self.joints = self.ways.joints
        self._per_rad = self.ways.per_rad
        self.phase = Phase.IDLE
        self.sequence: plans.ExcitationSequence | None = None
        self.command = Command()
        self.outcomes: list[RunOutcome] = []
        self.attempt = 1
        self.pace = 1.0
        self.fraction = 0.0
        self.message = "waiting for a sequence"
        self.abort_reason = ""
        self.aborted_by = ""
        self._run_index = 0
        self._lost_runs = 0
        self._current_A = 0.0
        self._onset_position = 0.0
        self._travel = 0.0
        self._goals: dict[str, float] = {}
        self._run_pose: dict[str, float] = {}  # goals when the current came on
        self._way = Way()
        self._sample = JointSample(math.nan, {}, {})
        self._now_s = math.nan
        self._phase_start_s = math.nan  # where the phase begins with the next tick
        self._tick_s = 0.0
        self._way_s = 0.0  # how far along the way the goals are
        self._seen_s = 0.0  # how much of the time since the last tick was seen
        # times and positions of the run's joint at rest
        self._recent: deque[tuple[float, float]] = deque()
        self._off_since_s: dict[str, float] = {}
        self._expected_s: tuple[tuple[float, ...], ...] = ()
        self._swing: FreeResponse | None = None  # of the run, where it is one
        # what ends the sequence as soon as the joint is caught
        self._caught_for: Problem | None = None

    @property
    def busy(self) -> bool:
        """Whether a sequence is under way."""
        return self.phase not in AT_AN_END

    @property
    def run_number(self) -> int:
        """Number of the present run, from 1; 0 before the first sequence."""
        return 0 if self.sequence is None else self._run_index + 1

    @property
    def runs(self) -> int:
        """Number of runs in the sequence."""
        return 0 if self.sequence is None else len(self.sequence.runs)

    def start(self, sequence: plans.ExcitationSequence, sample: JointSample) -> None:
        """Begin a sequence at the pose of a sample; the first command holds that pose.

        Raises:
            ExcitationError: A sequence is under way, the sample is not fit to start from, or no way to a start pose keeps
                the clearance.
            ConfigurationError, RobotError: The robot cannot make these runs.
        """
        if self.sequence is not None and self.busy:
            where = f"{self.sequence.name} is under way (run {self.run_number} of {self.runs})"
            raise ExcitationError(f"{where}: wait for its end, or abort it")
        plans.check_sequence(sequence, self.robot)
        if not sequence.runs:
            words = "its pushes are chosen while it goes on, by the identifier: call its service, not this one"
            raise ExcitationError(f"{sequence.name}: {words}")
        check_start(sample, self.ways, self.guards)
        pose = self.ways.pose(sample)
        if sequence.from_here:
            sequence = sequence.begun_at(pose)
            plans.check_sequence(sequence, self.robot)
        outline = self._outlined(sequence, pose)
        self.sequence = sequence
        self.outcomes = []
        self.abort_reason = ""
        self.aborted_by = ""
        self._caught_for = None
        self._run_index = 0
        self.attempt = 1
        self.fraction = 0.0
        self._lost_runs = 0
        self._current_A = sequence.runs[0].current_A
        self._sample = sample
        self._now_s = math.nan
        self._tick_s = 0.0
        self._expected_s = outline.expected_s
        self._goals = dict(pose)
        self._way = outline.way
        self._enter(Phase.APPROACH)
        self.command = Command(dict(pose))

    def _outlined(self, sequence: plans.ExcitationSequence, pose: Mapping[str, float]) -> _Outline:
        """Look at every way and every run of a sequence that begins at a pose [rad or m].

        Raises:
            ExcitationError: No way keeps the clearance, or a guard would end a run.
        """
        ways: list[Way] = []
        expected_s: list[tuple[float, ...]] = []
        before = dict(pose)
        for number, run in enumerate(sequence.runs, 1):
            after = {**before, **run.start}
            words = f"run {number} ({run.joint})"
            way = self.ways.find(before, after, sequence, f"the start of {words}")
            ways.append(way)
            expected_s.append((way.duration_s, sequence.settle_s, run.duration_s, sequence.brake_s))
            before = after
            words = f"{sequence.name}: {words}"
            push = push_of(run)
            if push is not None:
                push.check(after, sequence, self.ways, self.guards, words)
            if run.is_free_response:
                words = f"{words} cannot swing freely"
                check_free_response(
                    run,
                    after,
                    sequence,
                    self.ways,
                    self.guards,
                    words,
                )
        if sequence.home:
            home = self.ways.find(
                before,
                {**before, **sequence.home},
                sequence,
                "home",
            )
            expected_s.append((home.duration_s,))
        return _Outline(ways[0], tuple(expected_s))

    def tick(self, now_s: float, sample: JointSample | None) -> Command:
        """What the servos are to do now.

        Args:
            now_s: The time, on the clock of the samples; it never runs backwards [s].
            sample: The newest reading, also when it is the one of the last tick; None: none since then.
        """
        if not self.busy:
            return self.command
        problem = self._observe(now_s, sample)
        if problem is None:
            problem = self._advance()
        if problem is None and self.busy:
            problem = self._watch()
        if problem is not None and not self._ended_run_only(problem):
            self._stop(problem)
        else:
            self.command = self._commanded()
            self.fraction = max(self.fraction, self._progress())
        return self.command

    def _ended_run_only(self, problem: Problem) -> bool:
        """End the run instead of the sequence where that is enough, or catch a swinging joint before; returns whether it was.

        Joint states that pause end a push, which is repeated, and nothing of a swing that was caught. A free swing that comes
        near a limit or the table, or whose joint gets too fast, is caught. All else ends the sequence.
        """
        if problem.ended_by == "stale":
            return self._paused_run_only(problem)
        run = self._run
        swings = self.phase is Phase.PROBE and run.is_free_response
        if not swings or problem.ended_by not in CAUGHT_AFTER:
            return False
        slow = self._speed(run.joint) <= self.guards.max_velocity_rad_s
        if problem.ended_by == "velocity" and slow:
            return False  # it is another joint that is so fast
        self._catch(problem.ended_by)
        self._caught_for = problem
        return True

    def _paused_run_only(self, problem: Problem) -> bool:
        """A pause costs a push, which is repeated; and where a swing was over, nothing."""
        if self.phase is Phase.PROBE and self._lost_runs < MOST_LOST_RUNS:
            self._lost_runs += 1
            self._brake("stale")
            self.message = f"run {self.run_number} of {self.runs} is lost: {problem.reason}"
            return True
        if self.phase is Phase.CATCH and self._caught_for is None:
            self._hold_driven()
            return True
        return False

    def abort(self, reason: str) -> None:
        """End the sequence: `command` and the next tick hold all joints where they are. Without a sequence, nothing."""
        if self.busy:
            self._stop(Problem("abort", reason))

    def _observe(self, now_s: float, sample: JointSample | None) -> Problem | None:
        """Take in the time and a sample, unless something is wrong with them."""
        longest_s = self.guards.stale_after_s
        if self.phase not in DRIVEN:
            longest_s = max(self.guards.patience_s, longest_s)
        problem = self._take_time(now_s, longest_s)
        if problem:
            return problem
        self._seen_s = 0.0
        gap_s = 0.0
        if sample is not None:
            gap_s = sample.time_s - self._sample.time_s
            problem = self._take_sample(sample, gap_s)
            if problem:
                return problem
        age_s = now_s - self._sample.time_s
        if age_s > longest_s:
            return Problem(
                "stale", f"no new joint positions for {age_s:.2f} s: is the driver alive?"
            )
        if age_s < -longest_s:
            ahead = f"a sample is stamped {-age_s:.2f} s ahead of the time"
            return Problem("clock", f"{ahead}: both need the same clock")
        if gap_s > longest_s:
            apart = f"two samples are {gap_s:.2f} s apart"
            return Problem("stale", f"{apart}: is the computer overloaded?")
        return None

    def _take_time(self, now_s: float, longest_s: float) -> Problem | None:
        if not math.isfinite(now_s):
            return Problem("clock", f"the time is {now_s}: check the clock")
        if not math.isnan(self._now_s):
            self._tick_s = now_s - self._now_s
            if self._tick_s < 0.0:
                back = f"the clock ran back by {-self._tick_s:.3f} s"
                return Problem("clock", f"{back}: use a clock that is never set")
            if self._tick_s > longest_s:
                self._now_s = now_s
                paused = f"the control loop paused for {self._tick_s:.2f} s"
                return Problem("stale", f"{paused}: is the computer overloaded?")
        self._now_s = now_s
        return None

    def _take_sample(self, sample: JointSample, gap_s: float) -> Problem | None:
        words = unfit(sample, self.joints)
        if words:
            return Problem("sample", words)
        if gap_s < 0.0:
            return Problem("clock", f"a sample is {-gap_s:.3f} s older than the one before it")
        # goals wait for joints that were not seen for a while: the servos may have missed the command, too
        self._seen_s = min(gap_s, LONGEST_STEP_S)
        if gap_s > 0.0:
            problem = self._jumped(sample, max(gap_s, self._stamps_apart_s(sample)))
            if problem:
                return problem
            self._sample = sample
            self._recent.append((sample.time_s, sample.position[self._run.joint]))
        return None

    def _stamps_apart_s(self, sample: JointSample) -> float:
        """How far apart positions were read: on a busy computer those of one place come in a burst [s]."""
        apart_s = sample.stamp_s - self._sample.stamp_s
        return min(apart_s, self.guards.patience_s) if apart_s > 0.0 else 0.0

    def _jumped(self, sample: JointSample, gap_s: float) -> Problem | None:
        """A position that no motion explains; between samples that are far apart a joint may have gone on as fast as it may."""
        far_apart_rad = self.guards.max_velocity_rad_s * gap_s
        allowed_rad = max(self.guards.max_jump_rad, far_apart_rad)
        for name in self.joints:
            moved = abs(sample.position[name] - self._sample.position[name])
            jump_rad = moved / self._per_rad[name]
            if jump_rad > allowed_rad:
                words = (
                    f"jumped by {jump_rad:.2f} rad between two samples: check its encoder and cable"
                )
                if allowed_rad > self.guards.max_jump_rad:
                    words = f"moved by {jump_rad:.2f} rad in {gap_s:.2f} s without a sample: is the computer overloaded?"
                return Problem("jump", f"{name} {words}")
        return None

    def _watch(self) -> Problem | None:
        """What the joints do that they should not, in the phase of this tick."""
        problem = self._too_fast()
        if problem:
            return problem
        if self.phase not in DRIVEN:
            return self._not_following()
        problem = self._gave_way()
        if problem:
            return problem
        return self._about_to_leave()

    def _too_fast(self) -> Problem | None:
        most = self.guards.max_velocity_rad_s
        factor = CATCH_OVERSPEED if self.phase is Phase.CATCH else 1.0
        for name in self.joints:
            speed = self._speed(name)
            if speed > most * factor:
                moves = f"{name} moves at {speed:.1f} rad/s"
                return Problem("velocity", f"{moves}, faster than {most:g} rad/s")
        return None

    def _gave_way(self) -> Problem | None:
        """A joint that is held during a run is off its goal."""
        for name in self.joints:
            off = self._off(name)
            if name != self._run.joint and off > self.guards.held_joint_error_rad:
                words = f"{name} gave way by {off:.2f} rad during the run: is its torque on, or was it pushed?"
                return Problem("held joint", words)
        return None

    def _not_following(self) -> Problem | None:
        """A joint has been off its goal for too long while no current is on."""
        patience_s = self.guards.follow_time_s / self.pace
        for name in self.joints:
            if self._off(name) <= self.guards.follow_error_rad:
                self._off_since_s.pop(name, None)
            elif self._now_s - self._off_since_s.setdefault(name, self._now_s) >= patience_s:
                words = f"{name} does not follow: is something in its way, its load too heavy, or torque off?"
                return Problem("follow", words)
        return None

    def _off(self, name: str) -> float:
        """How far a joint is from its goal, at the motor's shaft [rad]."""
        return abs(self._sample.position[name] - self._goals[name]) / self._per_rad[name]

    def _speed(self, name: str) -> float:
        """Of a joint, at the motor's shaft [rad/s]."""
        return abs(self._sample.velocity[name]) / self._per_rad[name]

    def _about_to_leave(self) -> Problem | None:
        """The run's joint would soon be beyond a limit, or too near to the table, at its present speed."""
        assert self.sequence is not None
        name = self._run.joint
        joint = self.robot.model.joint(name)
        position = self._sample.position[name]
        velocity = self._sample.velocity[name]
        if self.phase is Phase.CATCH:
            ahead = position + velocity * CATCH_LOOKAHEAD_S
            spare = 0.0
            least_m = self.sequence.min_clearance_m * 0.5
        else:
            ahead = position + velocity * self.guards.lookahead_s
            spare = self.guards.limit_margin_rad * self._per_rad[name]
            least_m = self.sequence.min_clearance_m
        below = position < joint.lower or (velocity < 0.0 and ahead < joint.lower + spare)
        above = position > joint.upper or (velocity > 0.0 and ahead > joint.upper - spare)
        if below or above:
            limit = joint.lower if below else joint.upper
            words = f"{name} was about to reach its limit {limit:.3g}"
            return Problem("limit", f"{words}: {self._remedy(velocity)}")
        pose = self.ways.pose(self._sample)
        lowest_m = min(self.ways.height({**pose, name: place}) for place in (position, ahead))
        if lowest_m < least_m:
            low = f"{100 * lowest_m:.1f} cm above the base's plane"
            words = f"{name} was about to bring the arm {low}"
            return Problem("clearance", f"{words}: {self._remedy(velocity)}")
        return None

    def _remedy(self, velocity: float) -> str:
        if self._run.is_free_response:
            return (
                "is the hand empty, and the base level? let it swing from nearer to where it hangs"
            )
        push = push_of(self._run)
        if push is not None:
            return push.less
        if velocity * self._current_A < 0.0:
            return "its load pulls it there against the current; use more current, or another start"
        return "use less current, less time, or a smaller max_travel"

    def _stop(self, problem: Problem) -> None:
        """Hold every joint where it was last seen, at once."""
        self._caught_for = None
        if self.phase is Phase.PROBE:
            self._note_outcome(problem.ended_by, used=False)
        self._goals = self.ways.pose(self._sample)
        self.phase = Phase.ABORTED
        self.aborted_by = problem.ended_by
        self.abort_reason = problem.reason
        self.message = f"stopped in run {self.run_number} of {self.runs}: {problem.reason}"
        self.command = self._commanded()

    @property
    def _run(self) -> plans.ExcitationRun:
        assert self.sequence is not None
        return self.sequence.runs[self._run_index]

    @property
    def _elapsed_s(self) -> float:
        """Of the phase [s]."""
        return self._now_s - self._phase_start_s

    def _enter(self, phase: Phase) -> None:
        self.phase = phase
        self._phase_start_s = self._now_s
        self._way_s = 0.0
        self._off_since_s.clear()
        if phase is Phase.SETTLE:
            self._recent.clear()
        self.message = self._doing()

    def _doing(self) -> str:
        """What goes on in this phase, as one sentence."""
        if self.phase is Phase.DONE:
            return self._summary()
        if self.phase is Phase.RETURN:
            return "moving home"
        joint = self._run.joint
        travel = f"{self._travel:.3g} {self._unit}"
        words = {
            Phase.APPROACH: "moving to the start pose",
            Phase.SETTLE: f"waiting until {joint} is at rest",
            Phase.PROBE: f"{joint} {self._pushed_how()}",
            Phase.CATCH: f"{joint} swung by {travel} and is caught",
            Phase.BRAKE: f"{joint} moved {travel} and is held",
        }[self.phase]
        again = f", attempt {self.attempt}" if self.attempt > 1 else ""
        return f"run {self.run_number} of {self.runs}{again}: {words}"

    def _pushed_how(self) -> str:
        run = self._run
        if run.is_free_response:
            return "swings freely"
        push = push_of(run)
        if push is not None:
            return push.named(self._unit)
        shake = f" +-{abs(run.shake_A):.3g}" if run.shake_A != 0.0 else ""
        unit = plans.push_unit(self.robot, run.joint)
        return f"is pushed with {self._current_A:+.3g}{shake} {unit}"

    def _advance(self) -> Problem | None:
        """Goals and phase of this tick."""
        if math.isnan(self._phase_start_s):
            self._phase_start_s = self._now_s
        if self.phase in (Phase.APPROACH, Phase.RETURN):
            self._go_on()
        elif self.phase is Phase.SETTLE:
            return self._settle()
        elif self.phase is Phase.PROBE:
            self._push()
        elif self.phase is Phase.CATCH:
            return self._slow_down()
        else:
            return self._brake_off()
        return None

    def _go_on(self) -> None:
        """Goals move along the way; who follows late is waited for, but not for ever: what is stuck must show."""
        behind = max(self._off(name) for name in self.joints) / self.guards.follow_error_rad
        self._way_s += self.pace * self._seen_s * max(SLOWEST, min(1.0, 2.0 - 2.0 * behind))
        self._goals = self._way.at(self._way_s)
        if self._way_s + _ROUNDING_S >= self._way.duration_s:
            self._enter(Phase.SETTLE if self.phase is Phase.APPROACH else Phase.DONE)

    def _settle(self) -> Problem | None:
        """The push begins when the run's joint has come to rest."""
        assert self.sequence is not None
        elapsed_s = self._elapsed_s + _ROUNDING_S
        run = self._run
        if elapsed_s >= self.sequence.settle_s and self._still():
            self._run_pose = dict(self._goals)
            self._onset_position = self._sample.position[run.joint]
            self._travel = 0.0
            if run.is_free_response:
                whole = self.ways.whole(self.ways.pose(self._sample))
                self._swing = free_swing(self.robot, run.joint, whole)
            self._enter(Phase.PROBE)
        elif elapsed_s > self.sequence.settle_s + LONGEST_UNREST_S / self.pace:
            words = (
                f"{run.joint} does not come to rest: hold the arm's table still, or check the servo"
            )
            return Problem("unrest", words)
        return None

    def _push(self) -> None:
        """The run is over when its joint has moved far enough, or its time is."""
        run = self._run
        travel = abs(self._sample.position[run.joint] - self._onset_position)
        self._travel = max(self._travel, travel)
        # the nearest tick
        elapsed_s = self._elapsed_s + _ROUNDING_S + 0.5 * self._tick_s
        end = self._catch if run.is_free_response else self._brake
        if self._travel >= run.max_travel:
            end("travel")
        elif elapsed_s >= run.duration_s:
            end("time")

    def _slow_down(self) -> Problem | None:
        """A joint that was caught is held where it has stopped; what it was caught for ends the sequence then."""
        elapsed_s = self._elapsed_s + _ROUNDING_S
        caught = elapsed_s >= CATCH_RISE_S and self._speed(self._run.joint) <= CAUGHT_RAD_S
        if not caught and elapsed_s < LONGEST_CATCH_S:
            return None
        if self._caught_for is None:
            self._hold_driven()
        return self._caught_for

    def _brake_off(self) -> Problem | None:
        """What comes after a run begins when its joint was held long enough."""
        assert self.sequence is not None
        if self._elapsed_s + _ROUNDING_S < self.sequence.brake_s / self.pace:
            return None
        return self._after_run()

    def _still(self) -> bool:
        """Whether the run's joint stands, by its positions: single velocities are too coarse."""
        window_s = STANDSTILL_WINDOW_S / self.pace
        since_s = self._now_s - window_s
        while self._recent and self._recent[0][0] < since_s - self.guards.stale_after_s:
            self._recent.popleft()
        recent = np.array([entry for entry in self._recent if entry[0] >= since_s - _ROUNDING_S])
        if len(recent) < 3 or recent[-1, 0] - recent[0, 0] < 0.5 * window_s:
            return False
        times_s, positions = (recent - recent.mean(axis=0)).T
        slope = float(times_s @ positions) / float(times_s @ times_s)
        slowest = STANDSTILL_RAD_S * self._per_rad[self._run.joint]
        # to and fro has no slope; noise of an encoder at rest spans half of this at most
        return (
            abs(slope) < slowest and float(np.ptp(positions)) < 2.0 * slowest * STANDSTILL_WINDOW_S
        )

    def _brake(self, ended_by: str) -> None:
        far = self._travel >= self._run.min_travel
        self._note_outcome(ended_by, used=ended_by != "stale" and far)
        self._hold_driven()

    def _hold_driven(self) -> None:
        """The run's joint stays where it was last seen."""
        joint = self._run.joint
        self._goals = {**self._goals, joint: self._sample.position[joint]}
        self._enter(Phase.BRAKE)

    def _catch(self, ended_by: str) -> None:
        """A swing is over."""
        run = self._run
        shows = plans.margin(self.robot, run.joint, LEAST_SWING_RAD)
        far = self._travel >= max(run.min_travel, shows)
        self._note_outcome(ended_by, used=ended_by in ("time", "travel") and far)
        self._enter(Phase.CATCH)

    def _note_outcome(self, ended_by: str, used: bool) -> None:
        self.outcomes.append(
            RunOutcome(
                run_number=self.run_number,
                attempt=self.attempt,
                joint=self._run.joint,
                current_A=self._current_A,
                travel=self._travel,
                duration_s=self._elapsed_s,
                ended_by=ended_by,
                used=used,
            )
        )

    def _after_run(self) -> Problem | None:
        """Once more with another current, or the next run, or home, or the end."""
        assert self.sequence is not None
        phase = Phase.APPROACH
        again_A = self._current_again_A()
        if again_A is not None:
            self.attempt += 1
            self._current_A = again_A
            target = self._run_pose
            where = "the start of the run"
        elif self._run_index + 1 < self.runs:
            self._run_index += 1
            self.attempt = 1
            self._current_A = self._run.current_A
            target = {**self._goals, **self._run.start}
            where = "the start of the next run"
        elif self.sequence.home:
            phase = Phase.RETURN
            target = {**self._goals, **self.sequence.home}
            where = "home"
        else:
            self._enter(Phase.DONE)
            return None
        try:
            self._way = self.ways.find(
                self._goals,
                target,
                self.sequence,
                where,
            )
        except ExcitationError as error:
            return Problem("clearance", str(error))
        self._enter(phase)
        return None

    def _current_again_A(self) -> float | None:
        """With which current the run is repeated [A]; None: it is not."""
        last = self.outcomes[-1]
        if last.ended_by == "stale":
            return self._current_A  # nothing was wrong with the push
        return None if last.used else self._run.other_current(self._current_A)

    def _commanded(self) -> Command:
        if self.phase not in DRIVEN:
            return Command(dict(self._goals))
        run = self._run
        joint = run.joint
        held = {name: goal for name, goal in self._goals.items() if name != joint}
        push = push_of(run)
        if push is not None:
            return push.command(held, self._goals[joint])
        if run.is_free_response:
            swinging = self.phase is Phase.PROBE
            return Command(held, {joint: self._let_go_A() if swinging else self._catching_A()})
        # the wave changes, like the run ends, at the nearest tick; a pause before the onset is none of it
        nearest_s = self._elapsed_s + 0.5 * min(self._tick_s, self._elapsed_s)
        return Command(held, {joint: run.current_at(nearest_s, self._current_A)})

    def _weight_N_m(self) -> float:
        """Gravity's moment on the joint that swings, at the motor's shaft [N m]."""
        assert self._swing is not None
        joint = self._run.joint
        drive = self.robot.drive_trains[joint]
        return self._swing.moment_at(self._sample.position[joint]) * drive.transmission

    def _let_go_A(self) -> float:
        """Next to nothing against gravity, then nothing [A]."""
        if self._elapsed_s + 0.5 * self._tick_s >= LET_GO_S:
            return 0.0
        return -math.copysign(plans.LEAST_CURRENT_A, self._weight_N_m())

    def _catching_A(self) -> float:
        """What carries the weight of the joint that swings, and brakes it [A]."""
        assert self._swing is not None
        joint = self._run.joint
        drive = self.robot.drive_trains[joint]
        # at the shaft
        inertia = self._swing.inertia_kg_m2 * drive.transmission**2 + drive.armature.value
        braking_N_m = inertia / CATCH_TIME_S * self._sample.velocity[joint] / drive.transmission
        torque_N_m = -(self._weight_N_m() + braking_N_m)
        risen = min(self._elapsed_s / CATCH_RISE_S, 1.0)
        current_A = torque_N_m / drive.torque_constant.value * risen
        limit_A = self.robot.motors[joint].current_limit_A
        return min(max(current_A, -limit_A), limit_A)

    @property
    def _unit(self) -> str:
        return "m" if self.robot.model.joint(self._run.joint).kind == "prismatic" else "rad"

    def _summary(self) -> str:
        assert self.sequence is not None
        good = {outcome.run_number for outcome in self.outcomes if outcome.used}
        poor = [str(number) for number in range(1, self.runs + 1) if number not in good]
        if not poor:
            return f"{self.sequence.name} is done: all {self.runs} runs are good"
        push = push_of(self._run)
        more = "more current" if push is None else push.more
        words = (
            f"run {', '.join(poor)} moved too little: allow {more}, or start where gravity helps"
        )
        return f"{self.sequence.name} is done: {len(good)} of {self.runs} runs are good; {words}"

    def _progress(self) -> float:
        """How much of the sequence is behind us by expected time, 0 to 1."""
        if self.phase is Phase.DONE:
            return 1.0
        if self.phase is Phase.RETURN:
            place = len(self._expected_s) - 1
            step = 0
        else:
            place = self._run_index
            step = _STEPS[self.phase]
        parts = self._expected_s[place]
        spent_s = (
            sum(map(sum, self._expected_s[:place]))
            + sum(parts[:step])
            + min(self._elapsed_s, parts[step])
        )
        return spent_s / sum(map(sum, self._expected_s))
