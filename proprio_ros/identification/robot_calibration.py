"""The robot weighs itself: one maximum-a-posteriori fit over runs whose load is known, mostly nothing.

The result is the posterior of the unknowns that all runs share, which later weighings take as their prior, correlations included.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import NamedTuple

import numpy as np

from proprio_ros.calibration_files.pushes import Calibration
from proprio_ros.errors import ConfigurationError
from proprio_ros.identification import gates, sentences, solvers
from proprio_ros.identification.calibration_estimate import (
    NOT_EMPTY,
    CalibrationEstimate,
    EmptyHand,
    HeldOutRun,
)
from proprio_ros.identification.calibration_fit import (
    Fitted,
    fit,
    foretold,
    spread_of_runs,
    with_another_rise,
)
from proprio_ros.identification.estimate import (
    Fit,
    UnknownRow,
    Verdict,
)
from proprio_ros.identification.posterior import (
    Posterior,
    run_fits,
)
from proprio_ros.identification.prepared_runs import (
    KnownLoad,
    PreparedRun,
    joints_of,
    prepare_run,
)
from proprio_ros.identification.problem import Problem
from proprio_ros.identification.reasons import Reason
from proprio_ros.identification.robot_unknowns import (
    DRIVE_TERMS,
    robot_unknowns,
)
from proprio_ros.identification.run_kinds import one_kind
from proprio_ros.identification.run_scatter import of_runs
from proprio_ros.identification.swing_friction import (
    friction_of_swings,
)
from proprio_ros.identification.swings import (
    CHANGING,
    missed_share,
)
from proprio_ros.identification.unknowns import Role
from proprio_ros.kinds import label_of
from proprio_ros.quantity import Quantity, shown
from proprio_ros.records import Run
from proprio_ros.robot import Robot
from proprio_ros.sim.payload import PayloadFacts

STRANGE = 4.0
"""Torque or onset of one run over the standard deviation that the other runs show, beyond which it contradicts them."""
# residuals so many times coarser than encoder and stamps explain: the model does not describe this robot
COARSE = 3.0
UNSTEADY = 6.0
"""Torque from run to run over what the robot file expects, beyond which the model does not describe this robot either."""
BEGINNING = (0.03, 0.3)
"""Of the way of a push, the part that is its beginning."""
# standard deviations of its prior by which an unknown may differ from the robot file unremarked
FAR_FROM_FILE = 4.0
# posterior over prior standard deviation above which the runs have not determined an unknown
UNLEARNT = 0.7
INSEPARABLE = 0.95  # correlation above which two unknowns are determined only together
MAYBE_NOT_EMPTY = 3.0  # standard deviations of a mass in the empty hand beyond which that is said
SAID_AT_MOST = 6
LEAST_SHARE_STD = 1e-4  # of its commands that a motor delivered
HIDDEN_STARTS = 3
HIDDEN_ITERATIONS = 20
# with which the sensitivity to a mass in the empty hand is taken by difference
HIDDEN_STEP_KG = 1e-4


class LoadedRun(NamedTuple):
    """A recorded run and what the hand held in it."""

    run: Run
    load: KnownLoad = KnownLoad()


def calibrate(
    robot: Robot,
    runs: Sequence[LoadedRun],
    progress: Callable[[str], None] = lambda _: None,
) -> CalibrationEstimate:
    """Learn the robot from empty-hand runs, and runs with a weighed reference; what its file states is the prior.

    Args:
        robot: As its file states it.
        runs: What was recorded, and what the hand held.
        progress: Called with what is being done, in words.

    Returns: the calibration, or why it is none.

    Raises:
        ConfigurationError: The robot is calibrated already, or nothing of it is open, or there is no run.
        RecordingError: A run cannot be related to the robot at all.
    """
    if robot.calibration is not None:
        cure = "start from the robot it extends, with all runs together"
        raise ConfigurationError(f"{robot.source.name} is a calibration already; {cure}")
    started = time.perf_counter()
    if not runs:
        raise ConfigurationError("no run given: a calibration needs empty-hand runs")
    found = gates.Findings()
    usable = usable_runs(robot, runs, found)
    if not usable:
        return nothing_usable(robot, "every probed", len(runs), found)
    one_kind(usable)
    if not any(u.shared and u.std > 0.0 for u in robot_unknowns(robot, usable, Role.ESTIMATED)):
        exactly = f"{robot.source.name} states every number of {', '.join(joints_of(usable))} as exactly known"
        raise ConfigurationError(
            f"{exactly}, so there is nothing to learn: give the numbers standard deviations"
        )
    progress(f"fitting {len(usable)} runs")
    fitted, left_out = _fit_what_agrees(robot, usable, progress)
    fitted = with_another_rise(fitted)
    learnt = _Learnt.of(robot, fitted)
    verdict, reasons, calibration = _verdict(
        robot,
        learnt,
        left_out,
        len(usable),
    )
    if verdict is Verdict.ACCEPTED:
        calibration = _with_own_friction(robot, fitted.problem.runs, calibration)
    reasons += _remarks(learnt, left_out, len(usable))
    found.notes += _notes(fitted, usable)
    fits, rms, expected = run_fits(
        fitted.problem,
        fitted.values,
        fitted.problem.runs,
    )
    residual = fitted.posterior.residual
    chi2 = float(residual @ residual) / len(residual)
    return CalibrationEstimate(
        robot.name,
        verdict,
        tuple(reasons),
        len(runs),
        calibration,
        Fit(
            rms,
            expected,
            chi2,
            condition=fitted.posterior.condition,
        ),
        fits,
        unknowns=learnt.rows,
        held_out=_held_out(fitted),
        not_separated=_not_separated(robot, fitted.problem, learnt.rows, calibration),
        notes=tuple(found.notes),
        empty_hand=learnt.hand,
        timing_s={"solve": time.perf_counter() - started},
        whole=learnt.whole,
        driven_one_way=learnt.one_way,
    )


@dataclass(frozen=True)
class _Learnt:
    """What the fit of a calibration says, before it is judged."""

    fitted: Fitted
    whole: Calibration  # with joints driven one way only
    one_way: dict[str, bool]  # those joints, and whether upwards
    hand: EmptyHand | None  # how empty it was by the runs themselves
    rows: tuple[UnknownRow, ...]  # every shared unknown

    @classmethod
    def of(cls, robot: Robot, fitted: Fitted) -> _Learnt:
        problem = fitted.problem
        return cls(
            fitted,
            _as_calibration(fitted),
            _driven_one_way(robot, problem.runs),
            empty_hand(problem, fitted.values, fitted.posterior),
            shared_rows(problem, fitted.values, fitted.covariance),
        )


def _verdict(
    robot: Robot,
    learnt: _Learnt,
    left_out: Sequence[str],
    count: int,
) -> tuple[Verdict, list[str], Calibration]:
    """The verdict on a fit of so many usable runs, why, and what is known now."""
    refusals = [
        *not_empty(learnt.hand, NOT_EMPTY),
        *_delay_on_bound(learnt.fitted),
        *_misfits(robot, learnt.fitted, left_out, count),
    ]
    if refusals:
        return Verdict.REJECTED, refusals, learnt.whole
    return _separated(
        learnt.whole,
        learnt.fitted.problem.runs,
        learnt.one_way,
    )


def _remarks(learnt: _Learnt, left_out: Sequence[str], count: int) -> list[str]:
    """Reasons to look closer, whatever the verdict."""
    fitted = learnt.fitted
    problem = fitted.problem
    reasons = []
    if left_out:
        question = "was the hand as stated, and nothing in the way?"
        reasons.append(sentences.left_out(left_out, count, question))
    off = empty_hand(
        problem,
        fitted.values,
        fitted.posterior,
        references=True,
    )
    reasons += _not_as_stated(off, problem.runs[0].kind.most_pull)
    reasons += not_empty(learnt.hand, MAYBE_NOT_EMPTY, NOT_EMPTY)
    reasons += _far_from_file(learnt.rows)
    reasons += gates.never_reversed(problem.runs)
    return reasons


def _notes(fitted: Fitted, usable: Sequence[PreparedRun]) -> list[str]:
    """What is to be known of the fit beside the reasons."""
    notes = []
    near = fitted.cost <= fitted.cost.min() + 2.0
    apart = int(np.sum(~near))
    if apart:
        notes.append(
            f"{apart} of {len(fitted.cost)} starts ended in a worse place; the best was taken"
        )
    if "torque_constant" in usable[0].kind.unneeded:
        nothing = (
            f"free swings tell nothing of the torque constant of {', '.join(joints_of(usable))}"
        )
        instead = "weigh from free swings with this calibration"
        notes.append(
            f"{nothing}: {instead}; what a current drives would carry the robot file's torque constant"
        )
    return notes


def usable_runs(
    robot: Robot,
    runs: Sequence[LoadedRun],
    found: gates.Findings,
    refused: Callable[[PreparedRun], str] = lambda _: "",
) -> list[PreparedRun]:
    """The runs that a calibration can use; what is wrong with the others, and unusual about these, goes to the notes of ``found``.

    ``refused`` says why a run is not used beyond what is wrong with it by itself; an empty string where it is.

    Raises `RecordingError`: A run cannot be related to the robot at all.
    """
    usable = []
    for loaded in runs:
        prepared = prepare_run(robot, loaded.run, loaded.load)
        why = gates.unusable(prepared) or refused(prepared)
        if why:
            found.notes.append(f"{loaded.run.name} was left out: {why}")
            continue
        usable.append(prepared)
        alone = gates.Findings()
        gates.screen_run(robot, prepared, alone)
        found.notes += [
            *alone.reasons,
            *alone.notes,
        ]  # of one run among many
    return usable


def nothing_usable(
    robot: Robot, which: str, given: int, found: gates.Findings
) -> CalibrationEstimate:
    """The answer where no run can be used.

    Args:
        robot: That was to be calibrated.
        which: Joint must move, in words.
        given: How many runs were given.
        found: With the notes on them.
    """
    reason = f"no run can be used: {which} joint must move by at least 0.1 rad inside its limits"
    return CalibrationEstimate(
        robot.name,
        Verdict.NOT_IDENTIFIABLE,
        (reason,),
        given,
        None,
        notes=tuple(found.notes),
    )


def _misfits(
    robot: Robot,
    fitted: Fitted,
    left_out: Sequence[str],
    count: int,
) -> list[str]:
    """Why these runs are no calibration of this robot, in a sentence; empty where they are one."""
    noise = fitted.noise
    if len(left_out) > gates.LEFT_OUT_AT_MOST * count:
        return [
            "the runs contradict each other: was the hand empty in all of them, and is this the right robot?"
        ]
    unlike = "does not describe the robot in the recordings"
    if noise.residual_scale > COARSE:
        coarse = (
            f"the residuals are {noise.residual_scale:.1f} times what encoder and stamps explain"
        )
        return [f"misfit: {coarse}: this robot file {unlike} (URDF, unit of the current, gears?)"]
    if noise.torque_disturbance > UNSTEADY * robot.torque_disturbance:
        come = f"{shown('N m', noise.torque_disturbance, spec='.0f')} come and go from run to run"
        file = f"the robot file expects {1e3 * robot.torque_disturbance:.1f}. It {unlike}"
        cause = "(weights, unit and sign of the current, gears?), or something pulls at it or was in the hand"
        return [f"misfit: the runs only agree if {come}; {file} {cause}"]
    share = missed_share(fitted.posterior)
    if share > fitted.problem.runs[0].kind.most_missed:
        return [sentences.swing_missed(share)]
    if noise.friction_spread > CHANGING:
        return [sentences.frictions_differ(noise.friction_spread)]
    return []


def _separated(
    whole: Calibration,
    runs: Sequence[PreparedRun],
    one_way: Mapping[str, bool],
) -> tuple[Verdict, list[str], Calibration]:
    """What the runs tell apart: the verdict, why, and the calibration without the joints whose torque and friction they do not."""
    if len(runs) == 1:
        return Verdict.NOT_IDENTIFIABLE, [sentences.one_run(runs[0].run.name)], whole
    if not one_way:
        return Verdict.ACCEPTED, [], whole
    if set(one_way) == set(whole.joints):
        return Verdict.NOT_IDENTIFIABLE, [sentences.none_separated()], whole
    rest = whole.without({(term, joint) for term in DRIVE_TERMS for joint in one_way})
    return Verdict.ACCEPTED, [sentences.not_separated(list(one_way))], rest


def _driven_one_way(robot: Robot, runs: Sequence[PreparedRun]) -> dict[str, bool]:
    """Joints whose torque and friction are open and whose friction was never seen reversed, and whether they were driven upwards.

    A gripper's friction need not be: squeezes go the same way as its empty closings. A free swing goes both ways by itself.
    """
    ways: dict[str, set[bool]] = {}
    for run in runs:
        is_open = run.drive.torque_constant.std > 0.0 and run.drive.coulomb.std > 0.0
        both_ways = run.kind.both_ways or robot.model.joint(run.run.joint).kind == "prismatic"
        if is_open and not both_ways:
            ways.setdefault(run.run.joint, set()).add(run.travel > 0.0)
    return {joint: seen.pop() for joint, seen in ways.items() if len(seen) == 1}


def empty_hand(
    problem: Problem,
    at: np.ndarray,
    posterior: Posterior,
    references: bool = False,
) -> EmptyHand | None:
    """The mass with which the hand of all empty runs would fit best: one step from the fit, everything else moving with it.

    A score test (Rao 1948): the fit's gradient by a mass that it does not have, over the information that no other unknown takes.
    A joint that sticks has a gradient of its own at every step; so the mass counts for as many standard deviations as the runs are
    explained better with it, and no more.

    Args:
        problem: That was fitted.
        at: Where the fit ended, shape (N,).
        posterior: Of the fit.
        references: The same of the runs with a reference: by how much they are heavier than stated.
    """

    def hiding(run: PreparedRun, more_kg: float) -> PreparedRun:
        load = run.load or KnownLoad()
        if (load.mass > 0.0) is not references or not run.coefficients.payload.any():
            return run
        return replace(run, load=replace(load, mass=load.mass + more_kg))

    def hiding_all(more_kg: float) -> Problem:
        runs = [hiding(run, more_kg) for run in problem.runs]
        return Problem(problem.robot, runs, problem.facts, problem.unknowns)

    if all(hiding(run, 1.0) is run for run in problem.runs):
        return None
    some = problem.estimated[:1]
    seen = problem.weight > 0.0
    change = (
        hiding_all(HIDDEN_STEP_KG).simulate(at[None], some)[0] - problem.simulate(at[None], some)[0]
    )
    slope = change[0][seen] / HIDDEN_STEP_KG * problem.weight[seen]
    across = posterior.sensitivity.T @ slope
    information = float(slope @ slope - across @ posterior.covariance @ across)
    if information <= 0.0:
        return None
    mass = float(slope @ posterior.residual - across @ posterior.step) / information
    std = information**-0.5
    if abs(mass) > MAYBE_NOT_EMPTY * std:
        follows = posterior.covariance @ across * mass
        gained = _gained_with(problem, hiding_all(mass), at, follows)
        std = max(std, abs(mass) / max(gained, 1e-6) ** 0.5)
    return EmptyHand(mass, std)


def _gained_with(
    problem: Problem,
    other: Problem,
    at: np.ndarray,
    follows: np.ndarray,
) -> float:
    """By how much less chi-square another problem explains the runs, fitted again.

    Args:
        problem: The one that was fitted.
        other: The same runs with another load.
        at: Where the fit ended, shape (N,).
        follows: By how much the estimated unknowns are less with the other load, to first order, shape (F,).
    """
    open_to = problem.estimated_unknowns()
    shares = np.linspace(0.0, 1.0, HIDDEN_STARTS)[:, None]
    places = at[problem.estimated] - shares * follows
    starts = problem.coordinates.internal(
        np.clip(
            places,
            [u.lower for u in open_to],
            [u.upper for u in open_to],
        )
    )
    before = problem.linearise(starts[:1])[0]
    after = solvers.levenberg_marquardt(other, starts, None, iterations=HIDDEN_ITERATIONS).cost
    return 2.0 * float(before[0] - after.min())


def not_empty(
    hand: EmptyHand | None,
    beyond: float,
    up_to: float = np.inf,
) -> list[str]:
    """That the hand was not empty, where the runs say so by more than ``beyond`` standard deviations, and by at most ``up_to``."""
    return (
        [Reason("hand_not_empty", hand.contradiction())]
        if hand and beyond < abs(hand.pull) <= up_to
        else []
    )


def _not_as_stated(off: EmptyHand | None, beyond: float) -> list[str]:
    """That the references are not what was stated, where the runs say so by more than ``beyond`` standard deviations."""
    if off is None or abs(off.pull) <= beyond:
        return []
    return [sentences.other_reference(off.mass_kg, off.std_kg)]


def _fit_what_agrees(
    robot: Robot,
    runs: list[PreparedRun],
    progress: Callable[[str], None],
) -> tuple[Fitted, list[str]]:
    """Fit all runs; while one of them contradicts the rest, leave it out and fit again.

    A run that was not as stated bends the fit, and an honest one may look worse by that: each that was left out comes back where
    none contradicts the others then. Those that begin late wait until the others have said how they should: a fit of all together
    would have friction explain it.
    """
    late = _late_runs(robot, runs, progress)
    fitted, left_out = _leave_out_outliers(robot, runs, late, progress)
    # with the last one some run contradicted the others: that need not be asked again
    others = _without(late, left_out[:-1])
    for run in others:
        fewer = _without([run], left_out)
        with_it = fit(robot, _without(fewer, runs))
        if _outlier(robot, with_it) is None:
            fitted = with_it
            left_out = fewer
    return fitted, [run.run.name for run in left_out]


def _late_runs(
    robot: Robot,
    runs: list[PreparedRun],
    progress: Callable[[str], None],
) -> list[PreparedRun]:
    """Runs that begin late, and are not what the others foretell."""
    late = _that_begin_late(runs)
    if not late:
        return []
    progress(f"{', '.join(run.run.name for run in late)} began late; fitting without")
    others = fit(robot, _without(late, runs))
    return [run for run in late if gates.surprising(*foretold(robot, others, run)) > 1.0]


def _leave_out_outliers(
    robot: Robot,
    runs: list[PreparedRun],
    late: list[PreparedRun],
    progress: Callable[[str], None],
) -> tuple[Fitted, list[PreparedRun]]:
    """Fit all runs but ``late`` ones; while one of them contradicts the rest, leave it out and fit again.

    Returns:
        The fit, and what was left out, in that order.
    """
    left_out = late[:]
    kept = _without(left_out, runs)
    fitted = fit(robot, kept)
    while len(left_out) <= gates.LEFT_OUT_AT_MOST * len(runs) and len(kept) > 2:
        outlier = _outlier(robot, fitted)
        if outlier is None:
            break
        left_out.append(kept.pop(outlier))
        progress(f"{left_out[-1].run.name} contradicts the others; fitting without it")
        fitted = fit(robot, kept)
    return fitted, left_out


def _without(
    some: Sequence[PreparedRun],
    runs: Sequence[PreparedRun],
) -> list[PreparedRun]:
    return [run for run in runs if all(run is not other for other in some)]


def _that_begin_late(runs: Sequence[PreparedRun]) -> list[PreparedRun]:
    """Runs whose joint leaves its rest much later than in its others, the latest first, and not too many to be exceptions."""
    begins_s = np.array([_begins_s(run) for run in runs])
    joints = np.array([run.run.joint for run in runs])
    off_s = begins_s - [np.median(begins_s[joints == joint]) for joint in joints]
    most = int(gates.LEFT_OUT_AT_MOST * len(runs))
    latest = np.argsort(-off_s, kind="stable")[:most]
    return [runs[row] for row in latest if off_s[row] > runs[0].kind.late_s]


def _begins_s(run: PreparedRun) -> float:
    """When a push sets its joint in motion [s]: under a constant torque the root of the way grows evenly from then on."""
    way = np.abs(run.position - run.rest.value)
    end = int(np.argmax(way > BEGINNING[1] * way.max()))
    seen = np.flatnonzero(way[:end] > BEGINNING[0] * way.max())
    if len(seen) < 3:
        return 0.0
    slope, offset = np.polyfit(
        run.times_s[seen],
        np.sqrt(way[seen]),
        1,
    )
    return float(-offset / slope) if slope > 0.0 else 0.0


def _outlier(robot: Robot, fitted: Fitted) -> int | None:
    """The run that contradicts the others: predicted badly, or explained only by a torque or an onset that no other run needs."""
    outlier = gates.contradicting(fitted.posterior)
    if outlier is not None:
        return outlier
    strange = [(STRANGE, -1)]
    for kind, usual in (
        ("disturbance", robot.torque_disturbance),
        ("onset", robot.onset_jitter_s),
    ):
        rows, found, learnt = of_runs(kind, fitted.problem, fitted.posterior)
        for place, row in enumerate(rows) if len(rows) >= 3 else ():
            others = np.arange(len(rows)) != place
            strange.append(
                (
                    abs(float(found[place])) / spread_of_runs(usual, found[others], learnt[others]),
                    row,
                )
            )
    worst = max(strange)[1]
    return None if worst < 0 else worst


def shared_rows(
    problem: Problem, values: np.ndarray, covariance: np.ndarray
) -> tuple[UnknownRow, ...]:
    """Every shared unknown, prior against posterior.

    Args:
        problem: That was fitted.
        values: Of all unknowns, shape (N,).
        covariance: Of the estimated ones, shape (F, F).
    """
    stds = np.sqrt(np.diag(covariance))
    return tuple(
        UnknownRow(
            u.kind,
            u.role.value,
            u.value,
            u.std,
            float(values[row]),
            float(stds[f]),
            scope=u.scope,
        )
        for f, row in enumerate(problem.estimated)
        if (u := problem.unknowns[row]).shared
    )


def _far_from_file(rows: Sequence[UnknownRow]) -> list[str]:
    """A sentence for each number that lies further from the robot file than its standard deviation allows."""
    return [
        f"{row.label} came out as {row.value:.4g} {row.unit}, {abs(row.value - row.prior) / row.prior_std:.1f} standard deviations "
        f"from the robot file's {row.prior:.4g}: correct the file, or look for what else is wrong"
        + ": is the current in another unit?"
        * (row.kind == "torque_constant")
        for row in rows
        if abs(row.value - row.prior) > FAR_FROM_FILE * row.prior_std
    ]


def _delay_on_bound(fitted: Fitted) -> list[str]:
    """A sentence where commands were stamped further from what they did than a delay can be: the rest bends torque and friction."""
    row = fitted.problem.index["delay"]
    unknown = fitted.problem.unknowns[row]
    delay = float(fitted.values[row])
    spare = 0.01 * (unknown.upper - unknown.lower)
    if unknown.std == 0.0 or unknown.lower + spare < delay < unknown.upper - spare:
        return []
    return [sentences.delay_on_bound(delay)]


def _held_out(fitted: Fitted) -> tuple[HeldOutRun, ...]:
    entries = []
    for row, run in enumerate(fitted.problem.runs):
        off, chi2 = fitted.posterior.held_out(row)
        rms = float(np.sqrt(np.mean(off**2)))
        entries.append(
            HeldOutRun(
                run.run.name,
                run.run.joint,
                rms,
                chi2 / len(off),
            )
        )
    return tuple(entries)


def _not_separated(
    robot: Robot,
    problem: Problem,
    rows: Sequence[UnknownRow],
    calibration: Calibration,
) -> tuple[str, ...]:
    """What these runs leave open, in sentences: drive-train terms at their prior, and pairs that only occur together."""
    lines = []
    for row in rows:
        if (
            row.kind in DRIVE_TERMS
            and row.kind != "stribeck_velocity"
            and row.std > UNLEARNT * row.prior_std
        ):
            unit = "" if row.unit == "1" else " " + row.unit
            lines.append(
                f"{row.label} was not learnt: still {row.value:.3g} +- {row.std:.2g}{unit}"
            )
    correlation = np.abs(calibration.correlation - np.eye(len(calibration.names)))
    pairs = np.argwhere(np.triu(correlation) > INSEPARABLE)
    for a, b in sorted(
        pairs.tolist(),
        key=lambda pair: -correlation[pair[0], pair[1]],
    ):
        both = f"{label_of(calibration.keys[a])} and {label_of(calibration.keys[b])}"
        signed = f"(correlation {calibration.correlation[a, b]:+.3f})"
        lines.append(f"{both} were only determined together {signed}")
    if (
        not any(run.load is not None and run.load.mass > 0.0 for run in problem.runs)
        and robot.arm_scale.std > 0.0
    ):
        scale = calibration.quantities.get("arm_scale", robot.arm_scale)
        ratio = "torque constants and the arm's weight were only determined as a ratio"
        until = "until a run holds a weighed reference (--reference BAG=KG)"
        lines.insert(
            0,
            f"{ratio}: every mass is uncertain by {100 * scale.std:.1f} % {until}",
        )
    more = len(lines) - SAID_AT_MOST
    if more > 0:
        lines[SAID_AT_MOST:] = [f"and {more} more: see the correlations"]
    return tuple(lines)


def _as_calibration(fitted: Fitted) -> Calibration:
    problem = fitted.problem
    noise = fitted.noise
    shared = [f for f, row in enumerate(problem.estimated) if problem.unknowns[row].shared]
    rows = problem.estimated[shared]
    return Calibration(
        tuple(problem.unknowns[row].key for row in rows),
        fitted.values[rows],
        fitted.covariance[np.ix_(shared, shared)],
        runs=tuple(map(entry_of, problem.runs)),
        delivered=_delivered(problem.runs),
        torque_spread=fitted.torque_spread,
        **asdict(noise),
    )


def _delivered(runs: Sequence[PreparedRun]) -> dict[str, Quantity]:
    """By joint which share of its commands a motor delivered in all runs that say it."""
    shares: dict[str, dict[str, Quantity]] = {}
    for run in runs:
        if run.run.delivered is not None:
            # all runs of a joint in one recording have its one share
            recording = run.run.name.partition("#")[0]
            shares.setdefault(run.run.joint, {})[recording] = run.run.delivered
    return {joint: _weighted_mean(list(values.values())) for joint, values in shares.items()}


def _weighted_mean(values: Sequence[Quantity]) -> Quantity:
    """By inverse variances; where values differ by more than their standard deviations, that counts."""
    weights = np.array([1.0 / max(each.std, LEAST_SHARE_STD) ** 2 for each in values])
    numbers = np.array([each.value for each in values])
    mean = float(weights @ numbers / weights.sum())
    chi2 = float(weights @ (numbers - mean) ** 2)
    apart = max(chi2 / max(len(values) - 1, 1), 1.0)
    return Quantity(mean, float(np.sqrt(apart / weights.sum())))


def _with_own_friction(
    robot: Robot,
    runs: Sequence[PreparedRun],
    calibration: Calibration,
) -> Calibration:
    """What each run that goes both ways shows of friction by itself beside it: by that another joint is told from this one."""
    swung = []
    for run in runs:
        if run.kind.both_ways:
            swung.append((run.run, PayloadFacts() if run.load is None else run.load.facts))
    own_terms = friction_of_swings(robot.with_calibration(calibration), swung)
    return replace(calibration, own_terms=own_terms)


def entry_of(run: PreparedRun) -> dict[str, object]:
    """A run, as a calibration lists it."""
    return {
        "name": run.run.name,
        "joint": run.run.joint,
        "current_A": float(run.run.input_current_A[0]),
        "load_kg": run.load.mass if run.load else 0.0,
        "samples": run.used,
    }
