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

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from proprio_ros.identification.estimate import Estimate, Value, Verdict, no_answer
from proprio_ros.identification.fit import (
    FitResult,
    SearchOptions,
    known_exactly,
    misfit_reason,
    other_suspects,
    rivals,
    solve_load,
    summary,
)
from proprio_ros.identification.gates import (
    LITTLE_TRAVEL,
    MIN_USED,
    MISFIT_LIMIT,
    MOVING_START,
    Contradiction,
    Findings,
    contradicting,
    contradiction,
    never_reversed,
    screen_run,
    stood_still,
    unusable,
)
from proprio_ros.identification.judge import (
    Assessment,
    Guess,
    Refusal,
    Useful,
    contradicted,
    judge,
    not_identifiable,
    positive,
    rejected,
)
from proprio_ros.identification.posterior import Posterior, run_fits
from proprio_ros.identification.prepared_runs import KnownLoad, PreparedRun, joints_of, prepare_run
from proprio_ros.identification.problem import Problem
from proprio_ros.identification.reasons import Reason, of_run
from proprio_ros.identification.swings import (
    FRICTION_LAW,
    FRICTION_LAW_SHARE,
    MISSED_SHARE,
    MUCH_WORSE,
    are_swings,
    missed_share,
    said_missed,
    swing_error,
)
from proprio_ros.identification.unknowns import Role
from proprio_ros.quantity import Z95
from proprio_ros.records import Run
from proprio_ros.robot import Robot
from proprio_ros.sim.payload import PayloadFacts

ALIKE_KG, ALIKE_SHARE = 5e-4, 0.05
"""Masses that differ by less, or by this share, do not contradict each other: what a model misses of torque and friction goes with
the mass, by 1 to 2 % in each run. Half of the difference then counts as uncertainty."""
GUESSED_PLACE_M = 5e-3
"""How far off the centre of mass may be, per axis, where nobody stated it: standard deviation."""
DECIDES = 0.1
"""A guess that is worth less than this share of the standard deviation is not worth a sentence."""
DRIFT_SIGMAS = 3.0
"""How far from nothing an empty hand may weigh before the calibration is called out of date."""

SWING_STARTS = (0.03, 0.1, 0.3, 0.8, 2.0)
SWING_ROUNDS = 4
"""How often the error of a simulated swing is looked at again."""


@dataclass(frozen=True)
class WeighingOptions(SearchOptions):
    """How to solve, and when to refuse.

    Attributes:
        wide_share, wide_floor_kg: an answer whose half width exceeds this share of the value, and this mass, is ``too_wide``.
    """

    wide_share: float = 0.5
    wide_floor_kg: float = 0.005


def weigh(
    robot: Robot,
    runs: Sequence[Run],
    facts: PayloadFacts | None = None,
    options: WeighingOptions | None = None,
    baseline: Sequence[Run] = (),
) -> Estimate:
    """Identify the payload that all ``runs`` share.

    Args:
        robot: model, drive trains and their uncertainty.
        runs: at least one, of any of the robot's joints.
        facts: shape and place of the payload; default a ball of unknown size at the payload frame.
        options: solver and limits.
        baseline: runs with nothing in the hand, fitted together with the others; they show whether the robot has changed since
            its calibration.

    Raises:
        RecordingError: a run cannot be related to the robot at all (unknown joint, missing held joint).
    """
    facts = facts or PayloadFacts()
    options = options or WeighingOptions()
    found = Findings()
    usable: list[PreparedRun] = []
    still: list[PreparedRun] = []
    weighing = 0
    for run, load in [*((run, None) for run in runs), *((run, KnownLoad()) for run in baseline)]:
        prepared = prepare_run(robot, run, load, facts)
        problem = unusable(prepared)
        if problem:
            found.reasons.append(of_run(run.name, problem))
            if prepared.used >= MIN_USED:
                still.append(prepared)
        else:
            usable.append(prepared)
            weighing += load is None
        screen_run(robot, prepared, found)
    if not weighing:
        return no_answer("payload", "payload_mass", "kg", robot.name, len(runs), found.reasons, found.notes)
    if are_swings(usable):
        return _weigh_swings(robot, usable, facts, options, found, len(runs))
    drift = _drift(robot, usable[weighing:], facts, options)

    nominal = solve_load(robot, usable, facts, options, Role.FROZEN, rough=robot.is_calibrated(joints_of(usable)))
    opened = solve_load(robot, usable, facts, options, Role.FREE, start=nominal)
    if not (opened if robot.is_calibrated(joints_of(usable)) else nominal).explains:
        again = solve_load(robot, usable, facts, options, Role.FREE)
        opened = again if again.chi2 < opened.chi2 else opened
        if opened.chi2 < 0.5 * nominal.chi2 and not robot.is_calibrated() and not known_exactly(robot, usable):
            found.notes.append(
                "the robot file's own values do not explain the recording, so what the file leaves open was fitted too, "
                "under its priors"
            )
    return _conclude(robot, usable, facts, options, nominal, opened, found, len(runs), drift, still=still)


def _weigh_swings(
    robot: Robot,
    runs: Sequence[PreparedRun],
    facts: PayloadFacts,
    options: WeighingOptions,
    found: Findings,
    run_count: int,
) -> Estimate:
    """From free swings; those that are followed worse than the calibration's count for less."""
    known = robot.swing_error
    options = replace(options, starts_kg=_swing_starts(robot, runs[0], facts))
    opened = searched = solve_load(robot, runs, facts, options, Role.FREE)
    for _ in range(SWING_ROUNDS):
        posterior = Posterior(opened.problem, opened.values)
        error = max(swing_error(posterior), known)
        if error <= 1.05 * robot.swing_error:
            break
        robot = replace(robot, swing_error=error)
        runs = [prepare_run(robot, run.run, run.load, facts) for run in runs]
        opened = solve_load(robot, runs, facts, options, Role.FREE, start=opened)
    share = missed_share(posterior)
    misfit = said_missed(share) if share > MISSED_SHARE else ""
    if not misfit and known and error > MUCH_WORSE * known:
        misfit = Reason(
            "misfit",
            f"misfit: the swing is followed {error / known:.1f} times worse than those of the calibration: is the joint free, was "
            "torque off all the time, and is the object's place and shape as stated?",
        )
    return _conclude(robot, runs, facts, options, searched, opened, found, run_count, "", misfit)


def _swing_starts(robot: Robot, run: PreparedRun, facts: PayloadFacts) -> tuple[float, ...]:
    """First guesses about the mass that doubles the inertia [kg]: far from it a swing hardly depends on the mass."""
    own = float(run.coefficients.arm[0]) + robot.drive_trains[run.run.joint].armature.value
    doubling = own / max(float(run.coefficients.per_kg(facts)[0]), 1e-9)
    return tuple(doubling * share for share in SWING_STARTS)


def _drift(robot: Robot, baseline: Sequence[PreparedRun], facts: PayloadFacts, options: WeighingOptions) -> str:
    """What an empty hand that does not weigh nothing says about the calibration; empty where all is well."""
    if not baseline:
        return ""
    runs = [replace(run, load=None) for run in baseline]
    nominal = solve_load(robot, runs, facts, options, Role.FROZEN)
    fit = solve_load(robot, runs, facts, options, Role.FREE, start=nominal)
    row = fit.problem.index["payload_mass"]
    mass = float(fit.values[row])
    std = float(np.sqrt(Posterior(fit.problem, fit.values).whole_covariance()[row, row]))
    since = "its calibration" if robot.is_calibrated() else "its robot file was written"
    if not fit.explains:
        return (
            f"drift: the empty-hand run is no longer explained by the robot as it was at {since} (reduced chi-square "
            f"{fit.reduced_chi2:.1f}): calibrate again"
        )
    if abs(mass) > DRIFT_SIGMAS * std:
        return (
            f"drift: the empty hand now weighs {1e3 * mass:+.1f} g, where {1e3 * std:.1f} g is the standard deviation: the robot "
            f"has changed since {since}; calibrate again"
        )
    return ""


def on_bound(fit: FitResult) -> bool:
    """Whether the mass went as far as the search allows."""
    row = fit.problem.index["payload_mass"]
    unknown, mass = fit.problem.unknowns[row], float(fit.values[row])
    return mass <= unknown.lower * (1.0 - 1e-6) or mass >= unknown.upper * (1.0 - 1e-6)


def _contradiction(
    robot: Robot, runs: Sequence[PreparedRun], facts: PayloadFacts, options: WeighingOptions, outlier: int, mass: float
) -> Contradiction:
    name = runs[outlier].run.name
    if runs[outlier].load is not None:
        return Contradiction(
            f"{name}: the empty hand contradicts the other runs: was it empty, and has the robot changed meanwhile?"
        )
    masses: list[float] = []
    for group in ([runs[outlier]], [run for row, run in enumerate(runs) if row != outlier]):
        if any(run.load is None for run in group):
            nominal = solve_load(robot, group, facts, options, Role.FROZEN)
            fit = solve_load(robot, group, facts, options, Role.FREE, start=nominal)
            masses.append(float(fit.values[fit.problem.index["payload_mass"]]))
    if len(masses) < 2:
        return Contradiction(
            f"{name} contradicts the empty-hand runs ({1e3 * mass:.1f} g together): has the robot changed meanwhile?"
        )
    # where they say the same, the run is coarser than the others, and the fit's residuals show by how much
    question = "was the same object held in the same place?"
    one, others = masses
    return contradiction(name, "kg", one, others, ALIKE_SHARE * abs(mass), ALIKE_KG, question)


def _conclude(
    robot: Robot,
    runs: Sequence[PreparedRun],
    facts: PayloadFacts,
    options: WeighingOptions,
    nominal: FitResult,
    opened: FitResult,
    found: Findings,
    run_count: int,
    drift: str,
    misfit_of_swing: str = "",
    still: Sequence[PreparedRun] = (),
) -> Estimate:
    known = robot.is_calibrated(joints_of(runs))
    swings = runs[0].run.free
    fit = nominal if nominal.explains and not known and not swings else opened
    assessed = Assessment(fit, "payload_mass", runs, known, opened)
    budget = assessed.budget()
    mass = assessed.value
    if swings:
        law = FRICTION_LAW_SHARE * abs(mass)
        assessed.widen(law)
        budget = sorted([*budget, (FRICTION_LAW, law)], key=lambda entry: -entry[1])
    if not known and not swings:
        # the nominal mass may sit anywhere inside the open fit's interval: count how far
        assessed.widen(mass - float(opened.values[assessed.row]))
        # where the joint hardly moves, the balance of torques is all that was seen, and no linearisation about a creep holds
        assessed.widen(_static_std(fit.problem, runs))
    outlier = (
        contradicting(Posterior(opened.problem, opened.values)) if len(runs) > 1 and np.isfinite(fit.chi2) else None
    )
    apart = None if outlier is None else _contradiction(robot, runs, facts, options, outlier, mass)
    if apart is not None and apart.half is not None:
        assessed.widen(apart.half)
    guesses = _guesses(facts, assessed)
    for guess in guesses:
        assessed.widen(guess.std)
    sources = sorted([*budget, *((f"{g.key}, guessed", g.std) for g in guesses)], key=lambda entry: -entry[1])
    std = assessed.std
    moving = [] if fit.explains or swings else _moving_starts(robot, runs, facts, options, fit)

    def refusals() -> Iterator[Refusal]:
        if not np.isfinite(fit.chi2):
            unsimulated = "no guess of the mass could be simulated"
            yield rejected("unsimulated", unsimulated, unsimulated + ": check the robot file's inertias")
        if drift:
            yield rejected("drift", "the robot has changed since its calibration", drift)
        if misfit_of_swing:
            yield rejected("misfit", "the model does not explain the recording", misfit_of_swing)
        if swings and not known and not known_exactly(robot, runs):
            # all that moves may be lighter or heavier together: a ridge along which no interval around the best fit holds
            yield not_identifiable(
                "not_calibrated",
                "a free swing alone does not tell a mass",
                "a free swing tells gravity moment over inertia, and nothing says what the rotor's inertia is: calibrate with "
                "swings of two known loads (calibrate --reference BAG=KG --reference BAG=KG)",
            )
        yield from contradicted(apart)
        if sticks := stood_still(robot, fit.problem, fit.values, still, mass):
            yield rejected("stood_still", "a joint stood still that should have moved", sticks)
        if on_bound(fit):
            yield rejected(
                "on_bound",
                "the mass ended on a bound of the search",
                f"the mass ended on a bound of the search ({mass:.3g} kg): is this the right robot, joint and unit of current?",
            )
        if fit.reduced_chi2 > MISFIT_LIMIT or moving:
            misfit = misfit_reason(assessed.rms, assessed.expected, mass, fit.reduced_chi2)
            yield rejected(
                "misfit", "the model does not explain the recording", misfit, *(moving or other_suspects(robot))
            )
        if mass + Z95 * std < 0.0:
            yield rejected(
                "lighter_than_empty",
                "the hand seems lighter than empty",
                f"the hand with its load seems {-1e3 * mass:.1f} g lighter than it was empty: "
                + ("has the robot changed since? calibrate it again" if known else "calibrate the robot"),
            )
        slow = [run for run in runs if abs(run.travel) < LITTLE_TRAVEL]
        if fit is opened and not known and len(slow) == len(runs):
            yield not_identifiable(
                "short_travel",
                "too little travel to separate friction from weight",
                f"{slow[0].run.joint} moved only {abs(slow[0].travel):.2f} rad, too little to separate friction from weight: "
                "calibrate the robot on empty-hand runs, or probe with more current",
            )
        if others := rivals(fit, "payload_mass", mass, std, 0.02):
            yield not_identifiable(
                "several_values",
                "more than one mass explains the recording",
                "more than one mass explains the recording: " + ", ".join(f"{1e3 * m:.1f} g" for m in (mass, *others)),
            )

    searched = nominal if (nominal.explains and not swings) or len(opened.solution.cost) == 1 else opened
    best = float(searched.physical("payload_mass")[searched.solution.best])
    estimate = judge(
        robot,
        assessed,
        refusals(),
        found,
        probe="payload",
        run_count=run_count,
        values=lambda withheld: _values(assessed, withheld),
        # starts agree when they explain the recording alike, at masses that the interval cannot separate
        solver=summary(
            searched, "payload_mass", options.starts_kg, max(1e-4, 0.01 * abs(best), 0.1 * std),
            searched.solution.iterations, options, margin=0.5, final=fit,
        ),
        budget=sources,
        assumptions=_assumptions(robot, facts, options, fit is nominal and not swings, swings),
        apart=apart,
        open_drive_train=budget,
        useful=Useful(options.wide_share, options.wide_floor_kg),
        guesses=guesses,
    )  # fmt: skip
    open_still = not known and not swings and not known_exactly(robot, runs)
    if estimate.verdict in (Verdict.ACCEPTED, Verdict.TOO_WIDE) and open_still:
        return replace(estimate, reasons=(*estimate.reasons, *never_reversed(runs)))
    return estimate


def _guesses(facts: PayloadFacts, assessed: Assessment) -> list[Guess]:
    """Where the centre of mass is, unless that was stated: on a wrist joint 5 mm are 4 % of the mass."""
    if not facts.com_guessed or not np.isfinite(assessed.fit.chi2):
        return []
    shifts = assessed.posterior.follows("payload_mass", [f"payload_com_{axis}" for axis in "xyz"]) * GUESSED_PLACE_M
    off = float(np.linalg.norm(shifts))
    if off < DECIDES * assessed.std:
        return []
    taken = f"[{', '.join(f'{1e3 * place:g}' for place in facts.com)}] mm"
    return [Guess("payload.com", taken, f"{1e3 * GUESSED_PLACE_M:g} mm per axis", off)]


def _values(assessed: Assessment, withheld: str) -> tuple[Value, ...]:
    fit, covariance = assessed.fit, assessed.covariance
    values = [positive("payload_mass", "kg", assessed.value, assessed.std, withheld)]
    rows = [fit.problem.index[f"payload_com_{axis}"] for axis in "xyz"]
    if any(fit.problem.unknowns[r].std > 0.0 for r in rows):
        values.append(_centre_of_mass(fit, covariance, rows, withheld))
    return tuple(values)


def _centre_of_mass(fit: FitResult, covariance: np.ndarray, rows: list[int], withheld: str) -> Value:
    """Each coordinate on its own: what the probe did not excite stays at its prior, and is not called an estimate."""
    numbers: list[float | None] = []
    stds: list[float | None] = []
    intervals: list[list[float] | None] = []
    unexcited = []
    for axis, r in zip("xyz", rows, strict=True):
        std, prior = float(np.sqrt(covariance[r, r])), fit.problem.unknowns[r].std
        if withheld or (prior > 0.0 and std > 0.7 * prior):
            unexcited.append(axis)
            numbers.append(None)
            stds.append(None)
            intervals.append(None)
        else:
            value = float(fit.values[r])
            numbers.append(value)
            stds.append(std)
            intervals.append([value - Z95 * std, value + Z95 * std])
    reason = withheld or (
        f"{', '.join(unexcited)} not excited: the probe adds nothing to the prior" if unexcited else ""
    )
    return Value("payload_com", "m", numbers, stds, intervals, reason)


def _static_std(problem: Problem, runs: Sequence[PreparedRun]) -> float:
    """What the open friction and torque constant are worth as a weight at rest [kg]; 0 if any run moved far enough."""
    if any(abs(run.travel) >= LITTLE_TRAVEL for run in runs):
        return 0.0
    per_kg = [abs(run.weight_at_rest(run.coefficients.per_kg(problem.facts))) for run in runs]
    return min(float(np.hypot.reduce(run.torque_stds)) / max(w, 1e-9) for run, w in zip(runs, per_kg, strict=True))


def _moving_starts(
    robot: Robot, runs: Sequence[PreparedRun], facts: PayloadFacts, options: WeighingOptions, fit: FitResult
) -> list[str]:
    """A sentence for each run that fits far better if it did not start from rest."""
    # with the robot as its file states it: free friction can imitate a start velocity, and the other way round
    moving = solve_load(robot, runs, facts, replace(options, solver="lm"), Role.FROZEN, start_velocity_std=10.0)
    if not moving.chi2 < 0.5 * fit.chi2:
        return []
    mass = float(moving.values[moving.problem.index["payload_mass"]])
    rms = run_fits(moving.problem, moving.values, runs)[1]
    reasons = []
    for row, run in enumerate(runs):
        velocity = float(moving.values[moving.problem.index["v0", row]])
        if abs(velocity) > MOVING_START:
            reasons.append(
                f"start velocity: {run.run.name} fits better if {run.run.joint} already moves at {velocity:+.2f} rad/s when the "
                f"current comes on (then {1e3 * mass:.0f} g, rms {1e3 * rms:.2f} mrad): a probe must start from rest"
            )
    return reasons


def scan_masses(mass: float) -> np.ndarray:
    """Masses worth looking at around a value: three orders of magnitude, and a fine stretch about it [kg], shape (M,)."""
    return np.unique(np.concatenate([np.geomspace(1e-3, 0.5, 60), max(mass, 1e-3) * np.linspace(0.5, 1.5, 41)]))


def _assumptions(
    robot: Robot, facts: PayloadFacts, options: WeighingOptions, nominal: bool, swings: bool
) -> tuple[str, ...]:
    place = ", ".join(f"{1e3 * c:g}" for c in facts.com)
    return (
        f"the payload is rigid, {facts.shape.description}"
        + (" (size guessed, its uncertainty counted)" if facts.shape_std_relative > 0.0 else "")
        + f", its centre at [{place}] mm in {robot.payload_frame}",
        ("friction differs from swing to swing, by one factor each" if swings else "each probe starts from rest")
        + "; the held joints stand at their recorded mean",
        f"robot file {robot.source.name}, "
        + ("calibrated" if robot.is_calibrated() else "not calibrated")
        + (
            "; its values stay where the file puts them"
            if nominal
            else "; what it leaves open was fitted under its priors"
        ),
        f"integrator {options.integrator}, steps of at most {1e3 * options.step_s:.3g} ms, "
        f"Coulomb's law smoothed over {robot.friction_velocity:g} rad/s",
    )
