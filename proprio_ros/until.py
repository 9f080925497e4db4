"""Weigh until sure: which push a sequence with `until` makes next, and when it has an end. No ROS here.

After each push the runs so far are fitted, robot and object together; `Catalogue` ranks what could be pushed next from where the
arm stands, and the first of them that the excitation's guards let through is made. It ends when half the 95 % interval is as small
as asked, when no push promises more than a tenth of what is missing, when time is over, or when nothing can be pushed; and says
which.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from proprio_ros.errors import ConfigurationError, ExcitationError
from proprio_ros.excitation.machine import ExcitationMachine, approach_s
from proprio_ros.excitation.plans import ProbeRun, ProbeSequence, check_sequence
from proprio_ros.identification.gates import MISFIT_LIMIT
from proprio_ros.identification.sequential import (
    MAX_TRAVEL,
    SHAKE_PERIOD_S,
    UNKNOWN_KG,
    UNKNOWN_STD_KG,
    WORTH,
    Catalogue,
    Known,
    Push,
    half_of,
)
from proprio_ros.quantity import Z95, shown
from proprio_ros.records import Run
from proprio_ros.robot import Robot
from proprio_ros.robot.kinematics import bent_pose
from proprio_ros.sim.payload import PayloadFacts

MOVES = 0.12
"""rad: a push that moves less is repeated with more current."""
STANDS_RAD = 0.1
"""What moves less stands still, and says nothing."""
RAISE_BY, EASE_BY = 1.2, 0.6
STILL_TRIES = 3
"""So many pushes in a row that move nothing: then the joint sticks, or what it holds is too heavy."""
HEAVIER = 2.5
"""What may be in the hand is taken to be so many times more after a push that moved nothing."""
NEAR_RAD = 0.4
"""No further push begins so near where one has ended at a limit."""
SHOWN_AT_MOST = 5
MISFIT_RUNS = 3
"""From so many runs on, a fit that does not explain them ends it."""
WEIGHED_KG, LIGHT_KG, WEIGHED_PUSHES = 0.03, 0.01, 6
"""For the sake of which a reference is pushed, and an empty hand: an object, and the pushes with it. What is light is told by an
empty hand better than by a reference: by 24 pushes of either, the half interval of 10 g falls from 0.91 to 0.55 and to 0.77 g."""


@dataclass(frozen=True)
class Decision:
    """What to do after the runs so far.

    Attributes:
        run: The next push; None: there is none, and `reason` says why.
        reason: Why this push, or why no further.
        ended_by: "target", "worth", "time", "stuck", "misfit" or "nothing"; empty while there is a push.
        mass, half: Of the object, as it is known [kg].
        promised: Half interval that the push promises [kg].
        push: The chosen one; others: those after it, best first, one of each joint and direction.
        decided_s: What deciding took.
    """

    run: ProbeRun | None
    reason: str
    ended_by: str
    mass: float
    half: float
    promised: float
    push: Push | None
    others: tuple[Push, ...]
    decided_s: float

    def as_entries(self) -> dict[str, object]:
        """Keys and values, flat."""
        entries: dict[str, object] = {
            "mass": self.mass, "half_interval": self.half, "promised": self.promised, "decided_s": round(self.decided_s, 3),
        }  # fmt: skip
        if self.ended_by:
            entries["ended_by"] = self.ended_by
        for name, push in (("push", self.push), *((f"other.{n}", each) for n, each in enumerate(self.others, 1))):
            if push is not None:
                entries[name] = f"{push.words}, {push.time_s:.1f} s, +-{half_of(push.std):.2e} kg"
        return entries


def words_of(decision: Decision) -> str:
    """What is known, and what comes next, in two short lines."""
    known = f"{shown('kg', decision.mass, spec='.1f')} +- {shown('kg', decision.half, spec='.2f')}"
    if decision.half > 0.99 * half_of(UNKNOWN_STD_KG):
        known = "not weighed yet"
    if decision.push is None:
        return f"{known}\nended by: {decision.ended_by}"
    push = f"{decision.push.joint} {shown('A', decision.push.current_A, spec='+.0f')}"
    return f"{known}\nnext: {push}, then +-{shown('kg', decision.promised, spec='.2f')}"


class UntilSure:
    """One weighing whose pushes are chosen one by one.

    Args:
        robot: With its calibration where there is one.
        facts: Of the object.
        sequence: With `until`; its settings of ways, rest and brake count for every push.
        whole: Half of the 95 % interval that the answer from these runs will have, with all that widens it; None where there is no
            answer. It is asked before the target counts as met.

    Attributes:
        catalogue: Of all pushes.

    Raises:
        ConfigurationError: The sequence has no `until`.
    """

    def __init__(
        self,
        robot: Robot,
        facts: PayloadFacts,
        sequence: ProbeSequence,
        whole: Callable[[Sequence[Run]], float | None] | None = None,
    ) -> None:
        if sequence.until is None:
            raise ConfigurationError(f"{sequence.name}: has no `until`; all its runs are made as they stand")
        self._robot, self._sequence, self._until = robot, sequence, sequence.until
        self._machine, self._whole = ExcitationMachine(robot), whole
        self.catalogue = Catalogue(robot, facts)
        self._known = self.catalogue.nothing_known()
        self._unknown_kg = UNKNOWN_KG
        self._runs = self._still = 0
        self._stuck: dict[str, int] = {}
        self._ended_at: list[tuple[str, float]] = []
        self._widening = 0.0
        self._last: Push | None = None

    @property
    def first_runs(self) -> int:
        """How many runs the sequence has of its own, before any is chosen."""
        return len(self._sequence.runs)

    @property
    def half(self) -> float:
        """Of the 95 % interval so far [kg]."""
        return self._half(self._known.std)

    @property
    def known(self) -> Known:
        """What the runs so far say."""
        return self._known

    def next(self, runs: Sequence[Run], pose: Mapping[str, float], elapsed_s: float) -> Decision:
        """What to do now.

        Args:
            runs: All so far, the newest last.
            pose: Where the arm stands [rad or m].
            elapsed_s: Since the sequence began.
        """
        began = time.perf_counter()
        self._take_in(runs)
        target = self._until.half_interval
        half = self._half(self._known.std)

        def end(by: str, reason: str, others: Sequence[Push] = ()) -> Decision:
            took = time.perf_counter() - began
            return Decision(None, reason, by, self._known.mass, half, half, None, tuple(others), took)

        if self._known.runs and half <= target and self._whole is not None:
            whole = self._whole(runs)
            if whole is None:
                return end(
                    "misfit",
                    f"the interval would be {self._said(half)} after {self._count(len(runs))}, but they give no answer",
                )
            if whole > target:  # guesses and runs that differ widen it: from now on that counts
                self._widening = float(np.sqrt(max(whole**2 - half_of(self._known.std) ** 2, 0.0)))
                half = self._half(self._known.std)
        if self._known.runs and half <= target:
            return end("target", f"sure: {self._said(half)} after {self._count(len(runs))} and {elapsed_s:.0f} s")
        fit = self._known.fit
        if fit is not None and self._known.runs >= MISFIT_RUNS and fit.reduced_chi2 > MISFIT_LIMIT:
            return end(
                "misfit",
                f"misfit: no mass explains {self._count(self._known.runs)} together (reduced chi-square "
                f"{fit.reduced_chi2:.1f}), further ones would not help: did anything touch the arm, and is this its calibration?",
            )
        if self._still >= STILL_TRIES:
            joints = " and ".join(self._stuck)
            return end(
                "stuck",
                f"{STILL_TRIES} pushes of {joints} moved nothing: the joint sticks, or what the hand holds is too heavy for "
                "the currents that its limits allow",
            )
        inner = max(target**2 - self._widening**2, 0.0) ** 0.5 / Z95
        time_of = _time_of(self._robot, self._sequence, pose)
        ranked = self.catalogue.rank(self._known, time_of, inner, self._unknown_kg)
        ranked = [push for push in ranked if self._stuck.get(push.joint, 0) < 2 and not self._left_out(push)]
        if not ranked:
            return end("nothing", "no push of any joint stays inside the limits with what the hand may hold")
        in_time = [push for push in ranked if elapsed_s + push.time_s <= self._until.at_most_s]
        if not in_time:
            return end(
                "time",
                f"the {self._until.at_most_s:g} s are over: {self._said(half)} after {self._count(len(runs))}, "
                f"{self._said(target)} was asked for",
                _varied(ranked),
            )
        best = min(in_time, key=lambda push: push.std)
        if self._known.runs and half - self._half(best.std) < WORTH * (half - target):
            return end(
                "worth",
                f"no push promises more than a tenth of what is missing: {self._said(half)} after {self._count(len(runs))} and "
                f"{elapsed_s:.0f} s, {self._said(self._half(best.std))} after the best, {self._said(target)} was asked for",
                _varied(ranked),
            )
        for number, push in enumerate(in_time[:200]):
            run = run_of(push, self._robot)
            if not _passes(self._machine, self._sequence, run, pose):
                continue
            self._last, promised = push, self._half(push.std)
            reason = f"{push.words} promises {self._said(promised)} after {push.time_s:.1f} s"
            others = _varied(in_time[number + 1 :], push)
            took = time.perf_counter() - began
            return Decision(run, reason, "", self._known.mass, half, promised, push, others, took)
        return end("nothing", "no way to any start keeps the clearance: move the arm to a higher pose")

    def leave_out(self, decision: Decision) -> None:
        """No push from near where this one's joint was to start: it ended at a limit, or too low."""
        if decision.push is not None:
            self._ended_at.append((decision.push.joint, decision.push.start[decision.push.joint]))

    def _left_out(self, push: Push) -> bool:
        return any(push.joint == joint and abs(push.start[joint] - place) < NEAR_RAD for joint, place in self._ended_at)

    def sequence_of(self, run: ProbeRun) -> ProbeSequence:
        """A sequence of one push, which stays where it ends."""
        return replace(self._sequence, name="chosen", runs=(run,), until=None, home={})

    def _take_in(self, runs: Sequence[Run]) -> None:
        if len(runs) == self._runs:
            return
        joint = runs[-1].joint
        # of one push and its repetitions with more current
        moved = max(float(np.abs(run.position - run.position[0]).max()) for run in runs[self._runs :])
        if moved < STANDS_RAD:
            self._still += 1
            self._stuck[joint] = self._stuck.get(joint, 0) + 1
            if not self._known.runs:
                _, high = self._unknown_kg
                supported = self._last is not None and self._last.current_A * self._last.travel < 0.0
                # what did not sink is lighter than was thought, what did not rise is heavier, or the joint sticks
                self._unknown_kg = (0.0, high / HEAVIER) if supported else (0.5 * high, HEAVIER * high)
        else:
            self._still = 0
            self._stuck.pop(joint, None)
        self._runs = len(runs)
        self._known = self.catalogue.known(runs, self._known)

    def _half(self, std: float) -> float:
        return float(np.hypot(half_of(std), self._widening))

    @staticmethod
    def _said(half: float) -> str:
        return f"+-{shown('kg', half, spec='.2f')}"

    @staticmethod
    def _count(runs: int) -> str:
        return f"{runs} run" + "s" * (runs != 1)


def _time_of(robot: Robot, sequence: ProbeSequence, pose: Mapping[str, float]) -> Callable[[np.ndarray], np.ndarray]:
    """How long a push takes beside itself, by its start, shape (S, N) to (S,) [s]: the way there from a pose, rest and brake."""
    here = np.array([pose.get(name, 0.0) for name in robot.model.independent_joints])
    beside_s = sequence.settle_s + sequence.brake_s
    return lambda starts: beside_s + approach_s(np.abs(starts - here).max(axis=1), sequence.approach_velocity)


def _passes(machine: ExcitationMachine, sequence: ProbeSequence, run: ProbeRun, pose: Mapping[str, float]) -> bool:
    """Whether the excitation's guards would let a push through, and the way to it."""
    one = replace(sequence, runs=(run,), until=None, home={})
    driven = {name: pose[name] for name in machine.joints}
    try:
        check_sequence(one, machine.robot)
        machine.check_way(driven, {**driven, **run.start}, one)
    except (ConfigurationError, ExcitationError):
        return False
    return True


def run_of(push: Push, robot: Robot) -> ProbeRun:
    """A push as a run of a sequence."""
    # the fingers hold what they hold
    start = {
        n: q for n, q in push.start.items() if n in robot.drive_trains and robot.model.joint(n).kind != "prismatic"
    }
    limit = robot.motors[push.joint].current_limit_A - abs(push.shake_A)
    steady = push.shake_A == 0.0
    eased = push.current_A * push.travel < 0.0  # the current only supports what gravity pulls
    return ProbeRun(
        push.joint,
        push.current_A,
        push.duration_s,
        start,
        max_travel=MAX_TRAVEL,
        min_travel=MOVES if steady else 0.0,
        raise_by=EASE_BY if eased else RAISE_BY,
        max_current_A=min(limit, abs(push.current_A) * RAISE_BY**2) if steady and not eased else None,
        shake_A=push.shake_A,
        shake_period_s=SHAKE_PERIOD_S,
    )


def chosen_known(
    robot: Robot, reference_kg: float, half_interval: float, at_most_s: float, sequence: ProbeSequence
) -> list[ProbeRun]:
    """Pushes with a known load in the hand after which a weighing is to be as sure as asked; all chosen beforehand.

    What they would tell follows from where the arm is pushed, so that nothing of them need be recorded before the next is chosen.

    Args:
        robot: With the calibration so far.
        reference_kg: In the hand; 0: nothing.
        half_interval: Of weighings of `WEIGHED_KG` afterwards, of `LIGHT_KG` where the hand is empty, by `WEIGHED_PUSHES` pushes
            of their own [kg].
        at_most_s: For all of them.
        sequence: Whose ways, rest and brake count.
    """
    weighed_kg = WEIGHED_KG if reference_kg > 0.0 else LIGHT_KG
    catalogue = Catalogue(robot)
    known, _ = _foreseen_weighing(catalogue, weighed_kg, sequence)
    return _chosen(catalogue, known, half_interval, at_most_s, sequence, reference_kg)


def chosen_refresh(
    fresh: Robot, aged: Robot, at_most_s: float, sequence: ProbeSequence
) -> tuple[list[ProbeRun], float, float]:
    """Pushes with an empty hand after which a weighing is nearly as sure as with the calibration when it was made.

    Args:
        fresh: With the calibration as it was made.
        aged: With what is left of it (see `drift`).
        at_most_s: For all of them.
        sequence: Whose ways, rest and brake count.

    Returns:
        The pushes, none where a tenth at most is missing; half the 95 % interval of a foreseen weighing of `WEIGHED_KG` when the
        calibration was made, and by now [kg].
    """
    catalogue = Catalogue(fresh)
    then, pushes = _foreseen_weighing(catalogue, WEIGHED_KG, sequence)
    # of the same weighing: where it is pushed does not depend on how well the robot is known
    catalogue = Catalogue(aged)
    known = replace(catalogue.nothing_known(), mass=WEIGHED_KG)
    for push in pushes:
        known = replace(catalogue.foreseen(known, push), mass=WEIGHED_KG)
    half, now = half_of(then.std), half_of(known.std)
    return _chosen(catalogue, known, (1.0 + WORTH) * half, at_most_s, sequence, 0.0), half, now


def _foreseen_weighing(catalogue: Catalogue, weighed_kg: float, sequence: ProbeSequence) -> tuple[Known, list[Push]]:
    """What will be known after a weighing, and its pushes: without its own noise nothing would be worth learning."""
    robot = catalogue.robot
    known, pushes = replace(catalogue.nothing_known(), mass=weighed_kg), []
    for _ in range(WEIGHED_PUSHES):
        push = max(catalogue.rank(known, _time_of(robot, sequence, bent_pose(robot))), key=lambda p: p.gain)
        known = replace(catalogue.foreseen(known, push), mass=weighed_kg)
        pushes.append(push)
    return known, pushes


def _chosen(
    catalogue: Catalogue,
    known: Known,
    half_interval: float,
    at_most_s: float,
    sequence: ProbeSequence,
    load_kg: float,
) -> list[ProbeRun]:
    """Pushes with a known load, one after the other, for the sake of a foreseen weighing."""
    robot, weighed_kg = catalogue.robot, known.mass
    machine = ExcitationMachine(robot)
    here, elapsed_s = bent_pose(robot), 0.0
    for run in sequence.runs:
        here |= run.start
    chosen: list[ProbeRun] = []
    while half_of(known.std) > half_interval:
        ranked = catalogue.rank(known, _time_of(robot, sequence, here), half_interval / Z95, load_kg=load_kg)
        for push in ranked:
            run = run_of(push, robot)
            if elapsed_s + push.time_s <= at_most_s and _passes(machine, sequence, run, here):
                break
        else:
            break
        elapsed_s += push.time_s
        known = replace(catalogue.foreseen(known, push, load_kg), mass=weighed_kg)
        # where it ends
        here = {**push.start, push.joint: push.start[push.joint] + push.travel}
        chosen.append(run)
    return chosen


def _varied(pushes: Sequence[Push], chosen: Push | None = None) -> tuple[Push, ...]:
    """The best of each joint and direction."""
    seen = set() if chosen is None else {(chosen.joint, chosen.current_A > 0.0)}
    found = []
    for push in pushes:
        kind = (push.joint, push.current_A > 0.0)
        if kind not in seen:
            seen.add(kind)
            found.append(push)
    return tuple(found[:SHOWN_AT_MOST])
