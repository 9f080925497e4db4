"""The robot weighs itself: one maximum-a-posteriori fit over runs whose load is known, mostly nothing.

Shared unknowns (torque constant, friction and armature of every probed joint, the encoder's zero and once-per-turn error, how
the links differ from the URDF, the delay) and unknowns of each run (start, onset, a torque that differs from run to run) move
together under the priors of the robot file. Two things that no data sheet gives are learnt from the same runs by empirical
Bayes (MacKay 1992): how coarse the residuals are, and how much torque differs from run to run. The result is the posterior of
the shared unknowns, which later weighings take as their prior, correlations included.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass, field, replace

import numpy as np

from proprio_ros.calibration_files.pushes import Calibration
from proprio_ros.errors import ConfigurationError
from proprio_ros.identification import solvers
from proprio_ros.identification.calibration_estimate import (
    NOT_EMPTY,
    CalibrationEstimate,
    EmptyHand,
    HeldOutRun,
)
from proprio_ros.identification.estimate import Fit, UnknownRow, Verdict
from proprio_ros.identification.gates import Findings, contradicting, never_reversed, screen_run, unusable
from proprio_ros.identification.posterior import Posterior, run_fits
from proprio_ros.identification.prepared_runs import FIRST_SWING_ERROR, KnownLoad, PreparedRun, joints_of, prepare_run
from proprio_ros.identification.problem import Problem
from proprio_ros.identification.reasons import Reason
from proprio_ros.identification.robot_unknowns import DRIVE_TERMS, RISE, robot_unknowns
from proprio_ros.identification.swings import (
    CHANGING,
    MISSED_SHARE,
    are_swings,
    missed_share,
    said_missed,
    stamp_jitter,
    swing_error,
)
from proprio_ros.identification.unknowns import Role
from proprio_ros.kinds import label_of
from proprio_ros.quantity import shown
from proprio_ros.records import Run
from proprio_ros.robot import Robot
from proprio_ros.sim.joint import INDEX
from proprio_ros.sim.payload import PayloadFacts

FRICTION_STARTS = (0.005, 0.02, 0.06)
"""Coulomb friction [N m] from which the fit starts: low, for a model that sticks has no gradient."""
SWING_FRICTION_STARTS = (0.03, 0.1, 0.25)
"""The same for free swings, as shares of the largest gravity moment: the gears are driven from behind."""
EVIDENCE_ROUNDS = 15
SWING_ITERATIONS = 60
"""Of the solver on free swings at most. Where a joint comes to a stop the cost has kinks, at which a step overshoots: the search
must go on with shorter ones, or it ends where it has not arrived, and takes what it misses for the swings' noise."""
PSEUDO_RUNS = 2.0
"""Weight of the robot file's word on run-to-run torque, in runs."""
PSEUDO_SAMPLES = 10.0
"""Weight of the robot file's word on encoder noise and stamp jitter, in samples."""


LEFT_OUT_AT_MOST = 0.25
"""Part of the runs that may contradict the others before the whole calibration is refused."""
STRANGE_TORQUE = 4.0
"""Torque of one run over the standard deviation that the other runs show, beyond which it contradicts them."""
COARSE = 3.0
"""Residuals so many times coarser than encoder and stamps explain: the model does not describe this robot."""
UNSTEADY = 6.0
"""Torque from run to run over what the robot file expects, beyond which the model does not describe this robot either."""
FAR_FROM_FILE = 4.0
"""Standard deviations of its prior by which an unknown may differ from the robot file unremarked."""
UNLEARNT = 0.7
"""Posterior over prior standard deviation above which the runs have not determined an unknown."""
INSEPARABLE = 0.95
"""Correlation above which two unknowns are determined only together."""
MAYBE_NOT_EMPTY = 3.0
"""Standard deviations of a mass in the empty hand beyond which that is said."""
SAID_AT_MOST = 6
HIDDEN_STEP_KG = 1e-4
"""With which the sensitivity to a mass in the empty hand is taken by difference."""


RISE_STEPS = (0.1, 0.3, 1.0)
"""Of the standard deviation of a term of the rise of friction, one after the other: a joint that sticks has no gradient."""


@dataclass(frozen=True)
class LoadedRun:
    """A recorded run and what the hand held in it."""

    run: Run
    load: KnownLoad = field(default_factory=KnownLoad)


@dataclass(frozen=True)
class _Noise:
    """Standard deviations that the evidence decides.

    Attributes:
        residual_scale: of readings, over the file's; stamp_jitter_s: of stamps.
        torque_disturbance: of torque from run to run [N m]; start_velocity: with which runs begin [rad/s].
        friction_spread, swing_error: of free swings, see `Robot`.
    """

    residual_scale: float
    stamp_jitter_s: float
    torque_disturbance: float
    start_velocity: float
    friction_spread: float = 0.0
    swing_error: float = 0.0

    def near(self, other: _Noise) -> bool:
        """Whether nothing differs by more than 2 %."""
        return np.allclose(astuple(self), astuple(other), rtol=0.02)


@dataclass(frozen=True)
class _Fitted:
    """A fit; ``covariance`` is that of its posterior, or counts also what was taken as known, shape (F, F)."""

    problem: Problem
    values: np.ndarray
    posterior: Posterior
    solution: solvers.Solution
    noise: _Noise
    covariance: np.ndarray


def calibrate(
    robot: Robot, runs: Sequence[LoadedRun], progress: Callable[[str], None] = lambda _: None
) -> CalibrationEstimate:
    """Learn the robot from runs whose load is known.

    Args:
        robot: as its file states it; its standard deviations are the priors.
        runs: empty-hand runs, and runs with a weighed reference.
        progress: called with what is going on.

    Raises:
        ConfigurationError: the robot is calibrated already.
        RecordingError: a run cannot be related to the robot at all.
    """
    if robot.calibration is not None:
        raise ConfigurationError(
            f"{robot.source.name} is a calibration already; start from the robot it extends, with all runs together"
        )
    started = time.perf_counter()
    found = Findings()
    usable: list[PreparedRun] = []
    if not runs:
        raise ConfigurationError("no run given: a calibration needs empty-hand runs")
    for loaded in runs:
        prepared = prepare_run(robot, loaded.run, loaded.load)
        problem = unusable(prepared)
        if problem:
            found.notes.append(f"{loaded.run.name} was left out: {problem}")
        else:
            usable.append(prepared)
            alone = Findings()
            screen_run(robot, prepared, alone)
            found.notes.extend([*alone.reasons, *alone.notes])  # of one run among many
    if not usable:
        found.reasons.insert(
            0, "no run can be used: every probed joint must move by at least 0.1 rad inside its limits"
        )
        return CalibrationEstimate(
            robot.name, Verdict.NOT_IDENTIFIABLE, tuple(found.reasons), len(runs), None, notes=tuple(found.notes)
        )
    swings = are_swings(usable)
    if not any(u.shared and u.std > 0.0 for u in robot_unknowns(robot, usable, Role.FREE)):
        raise ConfigurationError(
            f"{robot.source.name} states every number of {', '.join(joints_of(usable))} as exactly known, "
            "so there is nothing to learn: give the numbers standard deviations"
        )
    progress(f"fitting {len(usable)} runs")
    fitted, contradicting_names = _fit_what_agrees(robot, usable, progress)
    if swings:
        fitted = _with_another_rise(fitted)
    used = list(fitted.problem.runs)
    verdict = Verdict.ACCEPTED
    if contradicting_names:
        found.reasons.insert(0, _said_contradiction(contradicting_names, len(usable)))
    if len(contradicting_names) > LEFT_OUT_AT_MOST * len(usable):
        verdict = Verdict.REJECTED
        found.reasons.insert(
            0, "the runs contradict each other: was the hand empty in all of them, and is this the right robot?"
        )
    elif fitted.noise.residual_scale > COARSE:
        verdict = Verdict.REJECTED
        found.reasons.insert(
            0,
            f"misfit: the residuals are {fitted.noise.residual_scale:.1f} times what encoder and stamps explain: this robot file "
            "does not describe the robot in the recordings (URDF, unit of the current, gears?)",
        )
    elif fitted.noise.torque_disturbance > UNSTEADY * robot.torque_disturbance:
        verdict = Verdict.REJECTED
        found.reasons.insert(
            0,
            f"misfit: the runs only agree if {shown('N m', fitted.noise.torque_disturbance, spec='.0f')} come and go from "
            f"run to run; the robot file expects {1e3 * robot.torque_disturbance:.1f}. It does not describe the robot "
            "in the recordings (weights, unit of the current, gears?), or something pulls at it",
        )
    elif swings and (share := missed_share(fitted.posterior)) > MISSED_SHARE:
        verdict = Verdict.REJECTED
        found.reasons.insert(0, said_missed(share))
    elif swings and fitted.noise.friction_spread > CHANGING:
        verdict = Verdict.REJECTED
        found.reasons.insert(
            0,
            Reason(
                "misfit",
                f"misfit: the swings only agree if friction differs by {100 * fitted.noise.friction_spread:.0f} % from one to the "
                "next: are the loads as stated, and is their inertia?",
            ),
        )
    if bound := _delay_on_bound(fitted):
        verdict = Verdict.REJECTED
        found.reasons.insert(0, bound)
    hand = empty_hand(fitted.problem, fitted.values, fitted.posterior)
    if hand is not None and abs(hand.pull) > NOT_EMPTY:
        verdict = Verdict.REJECTED
        found.reasons.insert(0, Reason("hand_not_empty", hand.contradiction()))
    elif hand is not None and abs(hand.pull) > MAYBE_NOT_EMPTY:
        found.reasons.append(Reason("hand_not_empty", hand.contradiction()))
    ends = fitted.solution.cost
    apart = int(np.sum(~(ends <= ends.min() + 2.0)))
    if apart:
        found.notes.append(f"{apart} of {len(ends)} starts ended in a worse place; the best was taken")
    found.reasons.extend(_far_from_file(fitted))
    if swings:
        found.notes.append(
            f"free swings tell nothing of the torque constant of {', '.join(joints_of(used))}: weigh from free swings with this "
            "calibration; what a current drives would carry the robot file's torque constant"
        )
    else:
        found.reasons.extend(never_reversed(used))
    calibration = whole = _as_calibration(fitted)
    one_way = _driven_one_way(robot, used)
    if verdict is Verdict.ACCEPTED and len(used) == 1:
        verdict = Verdict.NOT_IDENTIFIABLE
        found.reasons.insert(
            0, Reason("one_run", f"{used[0].run.name} is the only run, and nothing confirms it: add others, both ways")
        )
    elif verdict is Verdict.ACCEPTED and one_way and set(one_way) == set(calibration.joints):
        verdict = Verdict.NOT_IDENTIFIABLE
        found.reasons.insert(
            0, Reason("not_separated", "no joint was driven both ways, so torque and friction were not told apart")
        )
    elif verdict is Verdict.ACCEPTED and one_way:
        found.reasons.insert(0, _said_left_out(tuple(one_way)))
        calibration = calibration.without({(term, joint) for term in DRIVE_TERMS for joint in one_way})
    fits, rms, expected = run_fits(fitted.problem, fitted.values, used)
    posterior = fitted.posterior
    chi2 = float(posterior.residual @ posterior.residual)
    return CalibrationEstimate(
        robot=robot.name,
        verdict=verdict,
        reasons=tuple(found.reasons),
        runs=len(runs),
        calibration=calibration,
        fit=Fit(rms, expected, chi2 / len(posterior.residual), condition=posterior.condition),
        run_fits=fits,
        unknowns=_rows(fitted),
        held_out=_held_out(fitted),
        not_separated=_not_separated(robot, fitted, calibration),
        notes=tuple(found.notes),
        empty_hand=hand,
        timing_s={"solve": time.perf_counter() - started},
        whole=whole,
        driven_one_way=one_way,
    )


def _driven_one_way(robot: Robot, runs: Sequence[PreparedRun]) -> dict[str, bool]:
    """Joints whose torque and friction are open and whose friction was never seen reversed, and whether they were driven upwards.

    A gripper's friction need not be: squeezes go the same way as its empty closings.
    """
    ways: dict[str, set[bool]] = {}
    for run in runs:
        drive = run.drive
        is_open = drive.torque_constant.std > 0.0 and drive.coulomb.std > 0.0
        if run.run.free:  # goes both ways by itself
            continue
        if is_open and robot.model.joint(run.run.joint).kind != "prismatic":
            ways.setdefault(run.run.joint, set()).add(run.travel > 0.0)
    return {joint: seen.pop() for joint, seen in ways.items() if len(seen) == 1}


def _said_left_out(joints: Sequence[str]) -> Reason:
    stays, its = ("stays", "it was") if len(joints) == 1 else ("stay", "they were")
    return Reason("not_separated", f"{', '.join(joints)} {stays} uncalibrated, because {its} driven one way only")


def empty_hand(problem: Problem, at: np.ndarray, posterior: Posterior) -> EmptyHand | None:
    """The mass with which the hand of all empty runs would fit best: one step from the fit, everything else moving with it.

    A score test (Rao 1948): the fit's gradient by a mass that it does not have, over the information that no other unknown takes.
    """
    empty = [
        (run.load is None or run.load.mass == 0.0) and bool(run.coefficients.payload.any()) for run in problem.runs
    ]
    if not any(empty):
        return None
    runs = [
        replace(run, load=KnownLoad(HIDDEN_STEP_KG)) if unloaded else run
        for run, unloaded in zip(problem.runs, empty, strict=True)
    ]
    loaded = Problem(problem.robot, runs, problem.facts, problem.unknowns)
    some = problem.free[:1]
    change = loaded.simulate(at[None], some)[0] - problem.simulate(at[None], some)[0]
    seen = problem.weight > 0.0
    slope = change[0][seen] / HIDDEN_STEP_KG * problem.weight[seen]
    across = posterior.sensitivity.T @ slope
    information = float(slope @ slope - across @ posterior.covariance @ across)
    if information <= 0.0:
        return None
    return EmptyHand(float(slope @ posterior.residual) / information, information**-0.5)


def _fit_what_agrees(
    robot: Robot, runs: list[PreparedRun], progress: Callable[[str], None]
) -> tuple[_Fitted, list[str]]:
    """Fit all runs; while one of them contradicts the rest, leave it out and fit again."""
    left_out: list[str] = []
    kept = list(runs)
    fitted = fit(robot, kept)
    while len(left_out) <= LEFT_OUT_AT_MOST * len(runs) and len(kept) > 2:
        outlier = _outlier(robot, fitted)
        if outlier is None:
            break
        left_out.append(kept.pop(outlier).run.name)
        progress(f"{left_out[-1]} contradicts the others; fitting without it")
        fitted = fit(robot, kept)
    return fitted, left_out


def _outlier(robot: Robot, fitted: _Fitted) -> int | None:
    """The run that contradicts the others: predicted badly, or explained only by a torque that no other run needs."""
    outlier = contradicting(fitted.posterior)
    if outlier is not None or fitted.noise.torque_disturbance == 0.0 or fitted.problem.runs[0].run.free:
        return outlier
    found, learnt = _of_runs("disturbance", fitted.problem, fitted.posterior, fitted.noise.torque_disturbance)
    if len(found) < 3:
        return None
    largest = int(np.argmax(np.abs(found)))
    others = np.arange(len(found)) != largest
    usual = _spread(robot.torque_disturbance, found[others], learnt[others])
    return largest if abs(found[largest]) > STRANGE_TORQUE * usual else None


def _said_contradiction(names: Sequence[str], count: int) -> str:
    listed = ", ".join(names)
    return (
        f"{listed} contradict{'s' if len(names) == 1 else ''} the other runs and {'was' if len(names) == 1 else 'were'} left out "
        f"({len(names)} of {count}): was the hand as stated, and nothing in the way?"
    )


def _rows(fitted: _Fitted) -> tuple[UnknownRow, ...]:
    stds = np.sqrt(np.diag(fitted.covariance))
    rows = []
    for f, row in enumerate(fitted.problem.free):
        u = fitted.problem.unknowns[row]
        if u.shared:
            value, std = float(fitted.values[row]), float(stds[f])
            rows.append(UnknownRow(u.kind, u.role.value, u.value, u.std, value, std, scope=u.scope))
    return tuple(rows)


def _far_from_file(fitted: _Fitted) -> list[str]:
    """A sentence for each number that lies further from the robot file than its standard deviation allows."""
    return [
        f"{row.label} came out as {row.value:.4g} {row.unit}, {abs(row.value - row.prior) / row.prior_std:.1f} standard deviations "
        f"from the robot file's {row.prior:.4g}: correct the file, or look for what else is wrong"
        for row in _rows(fitted)
        if abs(row.value - row.prior) > FAR_FROM_FILE * row.prior_std
    ]


def _delay_on_bound(fitted: _Fitted) -> str:
    """A sentence where commands were stamped further from what they did than a delay can be; empty where they were not.

    Such a delay is not the true one, and what is left of it goes into torque and friction.
    """
    row = fitted.problem.index["delay"]
    unknown, delay = fitted.problem.unknowns[row], float(fitted.values[row])
    spare = 0.01 * (unknown.upper - unknown.lower)
    if unknown.std == 0.0 or unknown.lower + spare < delay < unknown.upper - spare:
        return ""
    return Reason(
        "on_bound",
        f"the delay from a command's stamp to what the joint does ended on its bound, {shown('s', delay, spec='+.0f')}: have "
        "commands and joint states stamped by one clock",
    )


def _held_out(fitted: _Fitted) -> tuple[HeldOutRun, ...]:
    entries = []
    for row, run in enumerate(fitted.problem.runs):
        held = fitted.posterior.held_out(row)
        rms = float(np.sqrt(np.mean(held.residual**2)))
        entries.append(HeldOutRun(run.run.name, run.run.joint, rms, held.chi2 / held.samples, held.samples))
    return tuple(entries)


def _not_separated(robot: Robot, fitted: _Fitted, calibration: Calibration) -> tuple[str, ...]:
    """What these runs leave open, in sentences: drive-train terms at their prior, and pairs that only occur together."""
    sentences = []
    for row in _rows(fitted):
        if row.kind in DRIVE_TERMS and row.kind != "stribeck_velocity" and row.std > UNLEARNT * row.prior_std:
            unit = "" if row.unit == "1" else " " + row.unit
            sentences.append(f"{row.label} was not learnt: still {row.value:.3g} +- {row.std:.2g}{unit}")
    correlation = np.abs(calibration.correlation - np.eye(len(calibration.names)))
    pairs = np.argwhere(np.triu(correlation) > INSEPARABLE)
    for a, b in sorted(pairs.tolist(), key=lambda pair: -correlation[pair[0], pair[1]]):
        sentences.append(
            f"{label_of(calibration.keys[a])} and {label_of(calibration.keys[b])} were only determined together (correlation "
            f"{calibration.correlation[a, b]:+.3f})"
        )
    if (
        not any(run.load is not None and run.load.mass > 0.0 for run in fitted.problem.runs)
        and robot.arm_scale.std > 0.0
    ):
        scale = calibration.quantities.get("arm_scale", robot.arm_scale)
        sentences.insert(
            0,
            f"torque constants and the arm's weight were only determined as a ratio: every mass is uncertain by "
            f"{100 * scale.std:.1f} % until a run holds a weighed reference (--reference BAG=KG)",
        )
    if len(sentences) > SAID_AT_MOST:
        more = len(sentences) - SAID_AT_MOST
        sentences = [*sentences[:SAID_AT_MOST], f"and {more} more: see the correlations"]
    return tuple(sentences)


def _problem(robot: Robot, runs: Sequence[PreparedRun], noise: _Noise) -> Problem:
    robot = replace(
        robot,
        torque_disturbance=noise.torque_disturbance,
        start_velocity=noise.start_velocity,
        friction_spread=noise.friction_spread,
    )
    unknowns = robot_unknowns(robot, runs, Role.FREE)
    return Problem(robot, [_with_noise(run, noise) for run in runs], PayloadFacts(), unknowns)


def _with_noise(run: PreparedRun, noise: _Noise) -> PreparedRun:
    reading, jitter = _noise_parts(run, noise)
    sigma = np.hypot(reading, jitter)
    return replace(run, sigma=np.hypot(sigma, noise.swing_error) if run.run.free else sigma)


def _noise_parts(run: PreparedRun, noise: _Noise) -> tuple[float, np.ndarray]:
    velocity = np.gradient(run.run.position, run.run.times_s)[: run.used]
    reading = float(np.hypot(run.drive.encoder_resolution / np.sqrt(12.0), run.drive.encoder_noise))
    return noise.residual_scale * reading, np.abs(velocity) * noise.stamp_jitter_s


def _starts(problem: Problem) -> np.ndarray:
    """Solver coordinates to start from: the file's values at a few levels of friction, shape (S, F)."""
    coordinates = problem.coordinates
    levels: Sequence[float] = FRICTION_STARTS
    if problem.runs[0].run.free:
        p, _ = problem.parameters(problem.base[None], problem.free[:1])
        largest = float(np.hypot(p[..., INDEX["gravity_cos"]], p[..., INDEX["gravity_sin"]]).max())
        levels = [share * largest for share in SWING_FRICTION_STARTS]
    starts = np.tile(coordinates.prior_mean, (len(levels), 1))
    for column, row in enumerate(problem.free):
        unknown = problem.unknowns[row]
        if unknown.kind == "coulomb" and unknown.value < min(levels):
            starts[:, column] = np.minimum(levels, unknown.value + 2.0 * unknown.std)
    return coordinates.internal(starts)


def fit(robot: Robot, runs: Sequence[PreparedRun]) -> _Fitted:
    """Maximum a posteriori of all unknowns, the noise by its evidence."""
    noise = _Noise(1.0, robot.stamp_jitter_s, robot.torque_disturbance, robot.start_velocity, robot.friction_spread)
    swings = runs[0].run.free
    if swings:
        noise = replace(noise, swing_error=FIRST_SWING_ERROR)
    problem = _problem(robot, runs, noise)
    most, again_most = (SWING_ITERATIONS, SWING_ITERATIONS) if swings else (40, 10)
    solution = solvers.levenberg_marquardt(
        problem, _starts(problem), problem.simulator.windows, iterations=most, persistent=swings
    )
    values = problem.all_values(problem.coordinates.physical(solution.internal[solution.best][None]))[0]
    for _ in range(EVIDENCE_ROUNDS):
        posterior = Posterior(problem, values)
        better = (_swing_evidence if swings else _evidence)(robot, problem, posterior, noise)
        settled = better.near(noise)
        noise = better
        problem = _problem(robot, runs, noise)
        start = problem.coordinates.internal(values[problem.free][None])
        again = solvers.levenberg_marquardt(problem, start, None, iterations=again_most, persistent=swings)
        values = problem.all_values(problem.coordinates.physical(again.internal))[0]
        if settled:
            break
    posterior = Posterior(problem, values)
    return _Fitted(problem, values, posterior, solution, noise, posterior.covariance)


def _with_another_rise(fitted: _Fitted) -> _Fitted:
    """Count what the swings would say if friction rose towards standstill in another way than the robot file has it.

    The rise is kept in the fit (see ``KEPT_IN_A_SWING``), and known no better after it: the fit is made again with each of its
    terms up to one standard deviation higher, and by what the others change they are uncertain, together with that term.
    """
    covariance = fitted.covariance.copy()
    for column, row in enumerate(fitted.problem.free):
        if fitted.problem.unknowns[row].kind in RISE:
            follows = _follows(fitted, column)
            covariance += np.outer(follows, follows)
            covariance[column, column] -= follows[column] ** 2  # its own was there before
    return replace(fitted, covariance=covariance)


def _follows(fitted: _Fitted, column: int) -> np.ndarray:
    """By how much each free unknown changes with one standard deviation of a term of the rise, shape (F,)."""
    problem = fitted.problem
    row = problem.free[column]
    kept, first = problem.unknowns[row], fitted.values[problem.free]
    follows = np.zeros_like(first)
    follows[column] = kept.std
    now = first
    for share in RISE_STEPS:
        unknowns = list(problem.unknowns)
        unknowns[row] = replace(kept, value=kept.value + share * kept.std)
        other = Problem(problem.robot, problem.runs, problem.facts, unknowns)
        start = now.copy()
        start[column] = unknowns[row].value
        found = solvers.levenberg_marquardt(
            other, other.coordinates.internal(start[None]), None, iterations=SWING_ITERATIONS, persistent=True
        )
        now = other.coordinates.physical(found.internal)[0]
        if missed_share(Posterior(other, other.all_values(now[None])[0])) > MISSED_SHARE:
            break  # with so much of it the joint would not have swung like that
        follows = (now - first) / share
    return follows


def _evidence(robot: Robot, problem: Problem, posterior: Posterior, noise: _Noise) -> _Noise:
    """One step towards the noise under which the runs are most probable, the robot file's word counting as pseudo-data."""
    # residual squared plus what the fit has swallowed, in rad^2, is what noise of the assumed kind leaves on average
    parts = [_noise_parts(run, noise) for run in problem.runs]
    reading = np.concatenate([np.full(len(jitter), base) for base, jitter in parts])
    jitter = np.concatenate([part for _, part in parts])
    variance = reading**2 + jitter**2
    left = (posterior.residual**2 + posterior.leverage()) * variance
    velocity = np.concatenate([np.abs(part) for _, part in parts]) / max(noise.stamp_jitter_s, 1e-12)
    scale2, jitter2 = noise.residual_scale**2, noise.stamp_jitter_s**2
    unit = (reading / noise.residual_scale) ** 2
    for _ in range(30):
        a, b = scale2 * unit, jitter2 * velocity**2
        total = a + b
        # expected square of each part, given their sum's
        scale_each = ((a / total) ** 2 * left + a * b / total) / unit
        scale2 = float((scale_each.sum() + PSEUDO_SAMPLES) / (len(left) + PSEUDO_SAMPLES))
        if jitter2 > 0.0:
            moving = velocity**2 > 1e-6
            jitter_each = ((b / total) ** 2 * left + a * b / total)[moving] / velocity[moving] ** 2
            prior = PSEUDO_SAMPLES * robot.stamp_jitter_s**2
            jitter2 = float((jitter_each.sum() + prior) / (moving.sum() + PSEUDO_SAMPLES))
    disturbance = noise.torque_disturbance
    if disturbance > 0.0:
        found, learnt = _of_runs("disturbance", problem, posterior, disturbance)
        disturbance = _spread(robot.torque_disturbance, found, learnt)
    found, learnt = _of_runs("v0", problem, posterior, noise.start_velocity)
    start_velocity = _spread(robot.start_velocity, found, learnt)
    return _Noise(float(np.sqrt(scale2)), float(np.sqrt(jitter2)), disturbance, start_velocity)


def _swing_evidence(robot: Robot, problem: Problem, posterior: Posterior, noise: _Noise) -> _Noise:
    """The same of free swings, whose residuals are not independent."""
    found, learnt = _of_runs("friction_change", problem, posterior, noise.friction_spread)
    spread = _spread(robot.friction_spread, found, learnt)
    return replace(
        noise,
        stamp_jitter_s=max(stamp_jitter(posterior), robot.stamp_jitter_s),
        friction_spread=spread,
        swing_error=swing_error(posterior),
    )


def _of_runs(kind: str, problem: Problem, posterior: Posterior, std: float) -> tuple[np.ndarray, np.ndarray]:
    """An unknown of every run, and how much of it the recording determines rather than its prior (0 to 1); shapes (R,)."""
    place = problem.free.tolist()
    columns = [place.index(problem.index[kind, r]) for r in range(len(problem.runs))]
    spread = np.diag(posterior.covariance)[columns]
    return posterior.values[problem.free[columns]], 1.0 - spread / std**2


def _spread(file_std: float, found: np.ndarray, learnt: np.ndarray) -> float:
    """Standard deviation of what differs from run to run, the robot file's word counting as ``PSEUDO_RUNS``."""
    prior = PSEUDO_RUNS * file_std**2
    return float(np.sqrt((np.sum(found**2) + prior) / (max(float(learnt.sum()), 0.0) + PSEUDO_RUNS)))


def _as_calibration(fitted: _Fitted) -> Calibration:
    problem = fitted.problem
    shared = [f for f, row in enumerate(problem.free) if problem.unknowns[row].shared]
    rows = problem.free[shared]
    return Calibration(
        tuple(problem.unknowns[row].key for row in rows),
        fitted.values[rows],
        fitted.covariance[np.ix_(shared, shared)],
        fitted.noise.residual_scale,
        fitted.noise.stamp_jitter_s,
        fitted.noise.torque_disturbance,
        fitted.noise.start_velocity,
        tuple(map(entry_of, problem.runs)),
        friction_spread=fitted.noise.friction_spread if fitted.noise.swing_error > 0.0 else 0.0,
        swing_error=fitted.noise.swing_error,
    )


def entry_of(run: PreparedRun) -> dict[str, object]:
    """A run, as a calibration lists it."""
    return {
        "name": run.run.name,
        "joint": run.run.joint,
        "current_A": float(run.run.input_current_A[0]),
        "load_kg": run.load.mass if run.load else 0.0,
        "samples": run.used,
    }
