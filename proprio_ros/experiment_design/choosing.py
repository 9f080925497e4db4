"""Until sure: what a sequence with `until` does after each of its runs, whatever is identified. No ROS here.

A probe says what the runs so far tell, which runs could be made next, and what each of them would tell. The first of them that the
excitation's guards let through is made. It ends when half the 95 % interval is as small as asked, when no run promises more than a
tenth of what is missing, when time is over, or when nothing can be pushed; and says which.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from proprio_ros.errors import ConfigurationError, ExcitationError
from proprio_ros.excitation.machine import ExcitationMachine
from proprio_ros.excitation.plans import (
    ExcitationRun,
    ExcitationSequence,
    check_sequence,
)
from proprio_ros.excitation.ways import approach_s
from proprio_ros.experiment_design.candidates import Push, TimeOf
from proprio_ros.experiment_design.sequential import WORTH
from proprio_ros.identification.gates import MISFIT_LIMIT
from proprio_ros.quantity import Sought, shown
from proprio_ros.records import Run
from proprio_ros.robot import Robot

STANDS_RAD = 0.1  # what moves less at the motor's shaft stands still, and says nothing
# so many pushes in a row that move nothing: then the joint sticks, or what it holds is too heavy
STILL_TRIES = 3
NEAR_RAD = 0.4  # no further push begins so near where one has ended at a limit
SHOWN_AT_MOST = 5
MISFIT_RUNS = 3  # from so many runs on, a fit that does not explain them ends it
TRIED_AT_MOST = 200  # pushes that the excitation's guards are asked about


Whole = Callable[[Sequence[Run]], float | None]
"""Half of the 95 % interval, as it is sought, that the answer from these runs will have, with all that widens it; None where there
is no answer."""


@dataclass(frozen=True)
class Found:
    """What the runs so far say."""

    value: float  # of what is sought, in its unit
    std: float
    runs: int = 0  # that could be used; 0: nothing is known yet
    reduced_chi2: float = 0.0  # of their fit


@dataclass(frozen=True)
class Decision:
    """What to do after the runs so far."""

    run: ExcitationRun | None  # the next push; None: there is none, and `reason` says why
    reason: str  # why this push, or why no further
    # "target", "worth", "time", "stuck", "misfit" or "nothing"; empty while there is a push
    ended_by: str
    value: float  # of what is sought, as it is known; before any run what may be
    half: float  # of its 95 % interval
    promised: float  # half interval that the push promises
    push: Push | None
    others: tuple[Push, ...]  # those after it, best first, one of each joint and direction
    decided_s: float  # what deciding took
    sought: Sought
    is_known: bool = True  # whether any run has said anything of what is sought

    def as_entries(self) -> dict[str, object]:
        """Keys and values, flat."""
        entries: dict[str, object] = {
            self.sought.name: self.value,
            "half_interval": self.half,
        }
        entries |= {
            "promised": self.promised,
            "decided_s": round(self.decided_s, 3),
        }
        if self.ended_by:
            entries["ended_by"] = self.ended_by
        for name, push in (
            ("push", self.push),
            *((f"other.{n}", each) for n, each in enumerate(self.others, 1)),
        ):
            if push is not None:
                entries[name] = f"{push.words}, {push.time_s:.1f} s, {self.said_of(push)}"
        return entries

    def said_of(self, push: Push) -> str:
        """The interval that a push promises, in words."""
        return self.sought.said(self.sought.half_of(push.std, self.value))


def words_of(decision: Decision) -> str:
    """What is known, and what comes next, in two short lines."""
    sought = decision.sought
    known = f"{shown(sought.unit, decision.value, spec='.1f')} {sought.said(decision.half, ' ')}"
    if not decision.is_known:
        known = "not weighed yet" if sought.unit == "kg" else "not known yet"
    if decision.push is None:
        return f"{known}\nended by: {decision.ended_by}"
    push = f"{decision.push.joint} {shown('A', decision.push.current_A, spec='+.0f')}"
    return f"{known}\nnext: {push}, then {sought.said(decision.promised)}"


class Chooser(ABC):
    """One identification whose pushes are chosen one by one; ``whole`` is asked before the target counts as met.

    The sequence's settings of ways, rest and brake count for every push. Raises `ConfigurationError`: It has no `until`.
    """

    # a push that narrows the interval by less than this share of it is not made, however little is missing
    least_share = 0.0
    # where `ranked` has none
    no_push = "no push of any joint stays inside the limits with what the hand may hold"

    def __init__(
        self,
        robot: Robot,
        sequence: ExcitationSequence,
        sought: Sought,
        whole: Whole | None = None,
    ) -> None:
        if sequence.until is None:
            raise ConfigurationError(
                f"{sequence.name}: has no `until`; all its runs are made as they stand"
            )
        self.robot = robot
        self.sought = sought
        self._sequence = sequence
        self._until = sequence.until
        self._machine = ExcitationMachine(robot)
        self._whole = whole
        self._found = Found(float("nan"), float("inf"))
        self._runs = 0  # how many were taken in
        self._still = 0  # pushes in a row that moved nothing
        self._stuck: dict[str, int] = {}
        self._ended_at: list[tuple[str, float]] = []
        self._widening = 0.0
        self._last: Push | None = None

    @abstractmethod
    def learn(self, runs: Sequence[Run]) -> Found:
        """What all runs so far say; there are more than before."""

    @abstractmethod
    def ranked(
        self,
        pose: Mapping[str, float],
        target_std: float,
    ) -> list[Push]:
        """Pushes inside all limits, best first, from where the arm stands [rad or m].

        ``target_std`` is asked for, before all that widens an answer, in the unit of what is sought.
        """

    @abstractmethod
    def run_of(self, push: Push) -> ExcitationRun:
        """A push as a run of a sequence."""

    def stood_still(self) -> None:
        """Told when the last push moved nothing."""
        return

    @property
    def first_runs(self) -> int:
        """How many runs the sequence has of its own, before any is chosen."""
        return len(self._sequence.runs)

    @property
    def found(self) -> Found:
        """What the runs so far say."""
        return self._found

    @property
    def half(self) -> float:
        """Of the 95 % interval so far, as it is sought."""
        return self._half(self._found.std)

    def next(
        self,
        runs: Sequence[Run],
        pose: Mapping[str, float],
        elapsed_s: float,
    ) -> Decision:
        """What to do now.

        Args:
            runs: All so far, the newest last.
            pose: Where the arm stands [rad or m].
            elapsed_s: Since it began [s].
        """
        began = time.perf_counter()
        self._take_in(runs)
        decision = self._ended(runs, elapsed_s)
        if decision is None:
            decision = self._next_push(pose, _count(len(runs)), elapsed_s)
        return replace(decision, decided_s=time.perf_counter() - began)

    def _ended(self, runs: Sequence[Run], elapsed_s: float) -> Decision | None:
        """Why no further push is needed, or would help; None: one may."""
        target = self._until.half_interval
        said = self.sought.said
        count = _count(len(runs))
        known = self._found.runs > 0
        if known and self.half <= target and self._whole is not None:
            whole = self._whole(runs)
            if whole is None:
                would = f"the interval would be {said(self.half)} after {count}"
                return self._end("misfit", f"{would}, but they give no answer")
            if whole > target:  # guesses and runs that differ widen it: from now on that counts
                inner = self.sought.half_of(self._found.std, self._found.value)
                self._widening = float(np.sqrt(max(whole**2 - inner**2, 0.0)))
        if known and self.half <= target:
            return self._end(
                "target",
                f"sure: {said(self.half)} after {count} and {elapsed_s:.0f} s",
            )
        if self._found.runs >= MISFIT_RUNS and self._found.reduced_chi2 > MISFIT_LIMIT:
            chi2 = f"together (reduced chi-square {self._found.reduced_chi2:.1f}), further ones would not help"
            question = "did anything touch the arm, and is this its calibration?"
            together = f"no {self.sought.label} explains {_count(self._found.runs)} {chi2}"
            return self._end("misfit", f"misfit: {together}: {question}")
        if self._still >= STILL_TRIES:
            nothing = f"{STILL_TRIES} pushes of {' and '.join(self._stuck)} moved nothing"
            heavy = "what the hand holds is too heavy for the currents that its limits allow"
            return self._end(
                "stuck",
                f"{nothing}: the joint sticks, or {heavy}",
            )
        return None

    def _next_push(
        self,
        pose: Mapping[str, float],
        count: str,
        elapsed_s: float,
    ) -> Decision:
        """The best push that there is time for, that is worth it, and that the excitation's guards let through."""
        target = self._until.half_interval
        said = self.sought.said
        inner = max(target**2 - self._widening**2, 0.0) ** 0.5
        ranked = self.ranked(pose, self.sought.std_of(inner, self._found.value))
        ranked = [push for push in ranked if self._may_begin(push)]
        if not ranked:
            return self._end("nothing", self.no_push)
        in_time = [push for push in ranked if elapsed_s + push.time_s <= self._until.at_most_s]
        asked = f"{said(target)} was asked for"
        if not in_time:
            over = f"the {self._until.at_most_s:g} s are over"
            reason = f"{over}: {said(self.half)} after {count}, {asked}"
            return self._end("time", reason, _varied(ranked))
        best = self._half(min(push.std for push in in_time))
        narrows = self.half - best
        missing = self.half - target
        if self._found.runs > 0 and narrows < max(WORTH * missing, self.least_share * self.half):
            little = "no push promises more than a tenth of what is missing"
            if narrows >= WORTH * missing:
                little = f"no push narrows it by {100.0 * self.least_share:g} %"
            so_far = f"{said(self.half)} after {count} and {elapsed_s:.0f} s"
            reason = f"{little}: {so_far}, {said(best)} after the best, {asked}"
            return self._end("worth", reason, _varied(ranked))
        for number, push in enumerate(in_time[:TRIED_AT_MOST]):
            run = self.run_of(push)
            if not passes(self._machine, self.sequence_of(run), pose):
                continue
            promised = self._half(push.std)
            reason = f"{push.words} promises {said(promised)} after {push.time_s:.1f} s"
            others = _varied(in_time[number + 1 :], push)
            self._last = push
            return replace(
                self._end("", reason, others),
                run=run,
                promised=promised,
                push=push,
            )
        return self._end(
            "nothing",
            "no way to any start keeps the clearance: move the arm to a higher pose",
        )

    def _end(self, by: str, reason: str, others: tuple[Push, ...] = ()) -> Decision:
        """A decision without a push."""
        return Decision(
            run=None,
            reason=reason,
            ended_by=by,
            value=self._found.value,
            half=self.half,
            promised=self.half,
            push=None,
            others=others,
            decided_s=0.0,
            sought=self.sought,
            is_known=self._found.runs > 0,
        )

    def leave_out(self, decision: Decision) -> None:
        """No push from near where this one's joint was to start: it ended at a limit, or too low."""
        if decision.push is not None:
            self._ended_at.append(
                (
                    decision.push.joint,
                    decision.push.start[decision.push.joint],
                )
            )

    def sequence_of(self, run: ExcitationRun) -> ExcitationSequence:
        """A sequence of one push, which stays where it ends."""
        return alone(self._sequence, run)

    def _may_begin(self, push: Push) -> bool:
        """Whether its joint does not stick, and none of its pushes ended at a limit near there."""
        if self._stuck.get(push.joint, 0) >= 2:
            return False
        return not any(
            push.joint == joint and abs(push.start[joint] - place) < NEAR_RAD
            for joint, place in self._ended_at
        )

    def _take_in(self, runs: Sequence[Run]) -> None:
        if len(runs) == self._runs:
            return
        joint = runs[-1].joint
        # of one push and its repetitions with more current
        moved = max(
            float(np.abs(run.position - run.position[0]).max()) for run in runs[self._runs :]
        )
        if moved < STANDS_RAD * abs(self.robot.drive_trains[joint].transmission):
            self._still += 1
            self._stuck[joint] = self._stuck.get(joint, 0) + 1
            self.stood_still()
        else:
            self._still = 0
            self._stuck.pop(joint, None)
        self._runs = len(runs)
        self._found = self.learn(runs)

    def _half(self, std: float) -> float:
        return float(
            np.hypot(
                self.sought.half_of(std, self._found.value),
                self._widening,
            )
        )


def alone(sequence: ExcitationSequence, run: ExcitationRun) -> ExcitationSequence:
    """A push made as a sequence makes its own, after which the arm stays where it ends."""
    return replace(
        sequence,
        name="chosen",
        runs=(run,),
        until=None,
        home={},
    )


def time_of(
    robot: Robot,
    sequence: ExcitationSequence,
    pose: Mapping[str, float],
) -> TimeOf:
    """How long pushes take beside themselves, by their starts [s]: the way there from a pose, rest and brake.

    Args:
        robot: Whose joints.
        sequence: Its speed on the way, rest and brake count.
        pose: Where the arm stands [rad or m].
    """
    names = robot.model.independent_joints
    beside_s = sequence.settle_s + sequence.brake_s
    here = np.array([pose.get(name, 0.0) for name in names])

    def seconds(
        starts: Sequence[Mapping[str, float]],
    ) -> np.ndarray:
        there = np.array([[start[name] for name in names] for start in starts])
        away = np.abs(there - here)
        return beside_s + approach_s(away.max(axis=1), sequence.approach_velocity)

    return seconds


def passes(
    machine: ExcitationMachine,
    sequence: ExcitationSequence,
    pose: Mapping[str, float],
) -> bool:
    """Whether the excitation's guards would let a sequence of one push through, and the way to it.

    Args:
        machine: The excitation's, with its guards.
        sequence: Of one push.
        pose: Where the arm stands [rad or m].
    """
    driven = {name: pose[name] for name in machine.joints}
    try:
        check_sequence(sequence, machine.robot)
        machine.ways.find(
            driven,
            {**driven, **sequence.runs[0].start},
            sequence,
            "the start of the push",
        )
    except (ConfigurationError, ExcitationError):
        return False
    return True


def _count(runs: int) -> str:
    return f"{runs} run" + "s" * (runs != 1)


def _varied(
    pushes: Sequence[Push],
    chosen: Push | None = None,
) -> tuple[Push, ...]:
    """The best of each joint and direction."""
    best: dict[tuple[str, bool], Push] = {}
    for push in pushes if chosen is None else (chosen, *pushes):
        best.setdefault((push.joint, push.current_A > 0.0), push)
    return tuple([push for push in best.values() if push is not chosen][:SHOWN_AT_MOST])
