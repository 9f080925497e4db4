"""From runs to the mass of what the hand holds, with an interval and a verdict.

A calibrated robot is fitted once, from every start: everything about it moves under the calibration's correlated prior.

Without a calibration, every recording is fitted twice. In the *nominal* fit the robot is taken as its file states it, and only
the payload and each run's start move. In the *open* fit everything that the file leaves open (torque constant, friction, armature,
delay, joint zeros, the arm's masses) moves too, under its prior, so its covariance says what one recording can and cannot
separate. If the nominal fit explains the recording, its mass is the value: the recording gives no reason to leave the file's
numbers, and a single run would trade torque against friction at random. The interval is the open fit's, widened by the distance
of the two values. If the nominal fit does not explain the recording, value and interval are the open fit's. What neither explains
is rejected.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from proprio_ros.identification import gates, sentences
from proprio_ros.identification.estimate import (
    Estimate,
    Verdict,
    no_answer,
)
from proprio_ros.identification.fit import (
    FitResult,
    fit_both,
    fit_opened,
    known_exactly,
    solve_load,
)
from proprio_ros.identification.judge import (
    FAR,
    Refusal,
    rejected,
)
from proprio_ros.identification.prepared_runs import KnownLoad, PreparedRun, joints_of, prepare_run
from proprio_ros.identification.reasons import Reason
from proprio_ros.identification.robot_unknowns import ZEROS_BESIDE
from proprio_ros.identification.run_kinds import FREE_SWING, one_kind
from proprio_ros.identification.unknowns import Role
from proprio_ros.probes.payload.narrowing import what_would_narrow
from proprio_ros.probes.payload.swings import weigh_swings
from proprio_ros.probes.payload.weighed import Weighed, WeighingOptions
from proprio_ros.records import Run
from proprio_ros.robot import Robot
from proprio_ros.sim.payload import PayloadFacts

# How far from nothing an empty hand may weigh before the calibration is called out of date.
DRIFT_SIGMAS = 3.0


def weigh(
    robot: Robot,
    runs: Sequence[Run],
    facts: PayloadFacts | None = None,
    options: WeighingOptions | None = None,
    baseline: Sequence[Run] = (),
) -> Estimate:
    """Identify the payload that all ``runs`` share.

    Of four runs or more of one recording, one in four at most is left out that contradicts the others, is not stamped as its joint
    moved, or begins otherwise than is known: a computer that is busy elsewhere pushes late now and then. What is left must agree.
    Another recording may be of another object.

    Args:
        robot: As its file or its calibration states it.
        runs: With the payload.
        facts: Of the payload; default a ball of unknown size at the payload frame.
        options: Of the solver.
        baseline: Runs with nothing in the hand, fitted together with the others; they show whether the robot has changed since its
            calibration.

    Raises:
        RecordingError: A run cannot be related to the robot at all (unknown joint, missing held joint).
    """
    return _weighed(robot, runs, facts, options, baseline).estimate


def weigh_with_advice(
    robot: Robot,
    runs: Sequence[Run],
    facts: PayloadFacts,
    options: WeighingOptions,
    baseline: Sequence[Run] = (),
) -> Estimate:
    """As `weigh`, with a note on what would narrow the interval, and to what.

    Args:
        robot: As its file or its calibration states it.
        runs: With the payload.
        facts: Of the payload.
        options: Of the solver.
        baseline: Runs with nothing in the hand.

    Raises:
        RecordingError: As `weigh` does.
    """
    answer = _weighed(robot, runs, facts, options, baseline)
    estimate = answer.estimate
    if answer.weighed is None:
        return estimate
    advice = what_would_narrow(answer.weighed, estimate.verdict)
    return replace(estimate, notes=(*estimate.notes, *advice))


def _weighed(
    robot: Robot,
    runs: Sequence[Run],
    facts: PayloadFacts | None,
    options: WeighingOptions | None,
    baseline: Sequence[Run],
) -> _Attempt:
    """What `weigh` answers, and from what."""
    facts = facts or PayloadFacts()
    options = options or WeighingOptions()
    kept = list(runs)
    left_out = list[str]()
    first = _weigh(robot, kept, facts, options, baseline)
    last = first
    recordings = {run.name.rpartition("#")[0] or run.name for run in runs}
    while len(recordings) == 1 and last.blocking_run is not None:
        if len(left_out) + 1 > gates.LEFT_OUT_AT_MOST * len(runs):
            break
        left_out.append(last.blocking_run.name)
        kept = [run for run in kept if run is not last.blocking_run]
        last = _weigh(robot, kept, facts, options, baseline)
    if last.estimate.verdict is Verdict.REJECTED:
        cause = () if first.weighed is None else first.weighed.cause
        said = replace(first.estimate, reasons=(*cause, *first.estimate.reasons))
        return replace(first, estimate=said)
    if not left_out:
        return last
    question = "was the object held as in the others, and nothing in the way?"
    reason = Reason("runs_differ", sentences.left_out(left_out, len(runs), question))
    estimate = replace(
        last.estimate,
        reasons=(*last.estimate.reasons, reason),
        runs=len(runs),
    )
    return replace(last, estimate=estimate)


@dataclass(frozen=True)
class _Attempt:
    """The answer from some runs."""

    estimate: Estimate
    weighed: Weighed | None = None  # what may tell the cause of a refusal
    blocking_run: Run | None = None  # the run that stands in its way, where there is one


@dataclass(frozen=True)
class _Usable:
    """Runs that a fit can use, those of the weighing before the empty hand's."""

    runs: list[PreparedRun]
    recorded: list[Run]  # what these were made from
    weighing: int  # how many of them are of the weighing
    still: list[PreparedRun]  # of no use, because their joint hardly moved


def _usable(
    robot: Robot,
    runs: Sequence[Run],
    baseline: Sequence[Run],
    facts: PayloadFacts,
    found: gates.Findings,
) -> _Usable:
    """The usable ones of all runs; ``found`` gets why others are not."""
    usable: list[PreparedRun] = []
    recorded: list[Run] = []
    still: list[PreparedRun] = []
    weighing = 0
    for number, run in enumerate((*runs, *baseline)):
        load = None if number < len(runs) else KnownLoad()
        prepared = prepare_run(robot, run, load, facts)
        if gates.admitted(robot, prepared, found):
            usable.append(prepared)
            recorded.append(run)
            weighing += load is None
        elif prepared.used >= gates.MIN_USED:
            still.append(prepared)
    return _Usable(_off_alike(usable), recorded, weighing, still)


def _off_alike(runs: Sequence[PreparedRun]) -> list[PreparedRun]:
    """Runs whose commands are as far off together as each of them is alone.

    What a motor delivers otherwise than its command says, it does in all pushes of a joint alike: more of them make it no smaller.
    """
    pushes = Counter(run.run.joint for run in runs)
    return [
        replace(run, current_torque_std=run.current_torque_std * np.sqrt(pushes[run.run.joint]))
        for run in runs
    ]


def _weigh(
    robot: Robot,
    runs: Sequence[Run],
    facts: PayloadFacts,
    options: WeighingOptions,
    baseline: Sequence[Run],
) -> _Attempt:
    found = gates.Findings()
    usable = _usable(robot, runs, baseline, facts, found)
    if not usable.weighing:
        return _Attempt(
            no_answer(
                "payload", "payload_mass", "kg", robot.name, len(runs), found.reasons, found.notes
            )
        )
    if one_kind(usable.runs) is FREE_SWING:
        return _Attempt(weigh_swings(robot, usable.runs, facts, options, found, len(runs)))
    drift = _drift(robot, usable.runs[usable.weighing :], facts, options)
    nominal, opened = _nominal_and_open(robot, usable.runs, facts, options)
    open_file = not robot.is_calibrated() and not known_exactly(robot, usable.runs)
    if open_file and not nominal.explains and opened.chi2 < 0.5 * nominal.chi2:
        found.notes.append(
            "the robot file's own values do not explain the recording, so what the file leaves open was fitted too, under its "
            "priors"
        )
    weighed = Weighed(
        nominal,
        opened,
        found,
        len(runs),
        facts,
        options,
        usable.still,
        against=drift,
    )
    estimate = weighed.estimate()
    if estimate.verdict is not Verdict.REJECTED:
        return _Attempt(estimate, weighed)
    return _Attempt(estimate, weighed, _blocking_run(weighed, estimate, usable))


def _nominal_and_open(
    robot: Robot, runs: Sequence[PreparedRun], facts: PayloadFacts, options: WeighingOptions
) -> tuple[FitResult, FitResult]:
    """The fit with the robot as it is stated, and the one in which all that is open moves."""
    known = robot.is_calibrated(joints_of(runs))

    def solve(role: Role, start: FitResult | None = None) -> FitResult:
        rough = known and role is Role.FIXED
        return solve_load(robot, runs, facts, options, role, start, rough=rough)

    def again(nominal: FitResult, opened: FitResult) -> bool:
        return not (opened if known else nominal).explains

    return fit_both(solve, again)


def _blocking_run(weighed: Weighed, estimate: Estimate, usable: _Usable) -> Run | None:
    """The run of the weighing that stands in the way of an answer, where there is one."""
    off = {
        reason.subject
        for reason in estimate.reasons
        if isinstance(reason, Reason) and reason.code == "stamps_off"
    }
    rows = [row for row, run in enumerate(usable.runs) if run.run.name in off]
    if weighed.outlier is not None and weighed.contradiction is not None:
        rows.append(weighed.outlier)
    # a push that came late for a stall: only with another onset of its own is it followed
    own = [
        (abs(unknown.pull or 0.0), unknown.scope)
        for unknown in estimate.unknowns
        if isinstance(unknown.scope, int)
    ]
    rows += [row for pull, row in sorted(own, reverse=True) if pull > FAR]
    weighing = [row for row in rows if usable.runs[row].load is None]
    return usable.recorded[weighing[0]] if weighing else None


def _drift(
    robot: Robot, baseline: Sequence[PreparedRun], facts: PayloadFacts, options: WeighingOptions
) -> list[Refusal]:
    """What an empty hand that does not weigh nothing says against the calibration."""
    if not baseline:
        return []
    runs = [replace(run, load=None) for run in baseline]
    # zeros that are elsewhere today are followed in what is weighed, too
    robot = replace(robot, zero_repeat=ZEROS_BESIDE * robot.zero_repeat)
    fit = fit_opened(partial(solve_load, robot, runs, facts, options))
    mass, std = fit.determined("payload_mass")
    since = "its calibration" if robot.is_calibrated() else "its robot file was written"
    if not fit.explains:
        drift = (
            f"drift: the empty-hand run is no longer explained by the robot as it was at {since} (reduced chi-square "
            f"{fit.reduced_chi2:.1f}): calibrate again"
        )
    elif abs(mass) > DRIFT_SIGMAS * std:
        drift = (
            f"drift: the empty hand now weighs {1e3 * mass:+.1f} g, where {1e3 * std:.1f} g is the standard deviation: the robot "
            f"has changed since {since}; calibrate again"
        )
    else:
        return []
    return [rejected("drift", "the robot has changed since its calibration", drift)]


def scan_masses(mass: float) -> np.ndarray:
    """Masses worth looking at around a value: three orders of magnitude, and a fine stretch about it [kg], shape (M,)."""
    everywhere = np.geomspace(1e-3, 0.5, 60)
    about = max(mass, 1e-3) * np.linspace(0.5, 1.5, 41)
    return np.unique(np.concatenate([everywhere, about]))
