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

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from proprio_ros.errors import ConfigurationError
from proprio_ros.identification import solvers
from proprio_ros.identification.estimate import (
    Estimate,
    Fit,
    Scan,
    SolverSummary,
    StartPath,
    UnknownRow,
    Value,
    Verdict,
    no_answer,
)
from proprio_ros.identification.gates import (
    LITTLE_TRAVEL,
    MISFIT_LIMIT,
    Contradiction,
    Findings,
    chi2_limit,
    contradicting,
    contradiction,
    look_at_run,
    never_reversed,
    unusable,
)
from proprio_ros.identification.posterior import Posterior, run_fits
from proprio_ros.identification.problem import (
    DRIVE_TERMS,
    KnownLoad,
    PayloadProblem,
    PreparedRun,
    joints_of,
    payload_unknowns,
    prepare_run,
)
from proprio_ros.identification.unknowns import Role
from proprio_ros.quantity import Z95
from proprio_ros.records import Run
from proprio_ros.robot import Robot
from proprio_ros.sim.payload import PayloadFacts

MOVING_START = 0.1
"""rad/s: a probe that starts faster has not started from rest."""
ALIKE_KG, ALIKE_SHARE = 5e-4, 0.05
"""Masses that differ by less, or by this share, do not contradict each other: what a model misses of torque and friction goes with
the mass, by 1 to 2 % in each run. Half of the difference then counts as uncertainty."""
DRIFT_SIGMAS = 3.0
"""How far from nothing an empty hand may weigh before the calibration is called out of date."""


@dataclass(frozen=True)
class WeighingOptions:
    """How to solve, and when to refuse.

    Attributes:
        solver: one of ``solvers.SOLVERS``.
        integrator, step_s: see ``JointSimulator``.
        starts_kg: first guesses, two orders of magnitude apart.
        widest_interval_kg: half width of the 95 % interval beyond which no number is given.
    """

    solver: str = "lm"
    integrator: str = "rk4"
    step_s: float = 1.0 / 240.0
    starts_kg: tuple[float, ...] = (0.005, 0.016, 0.05, 0.16, 0.5)
    widest_interval_kg: float = 0.1

    def __post_init__(self) -> None:
        if self.solver not in solvers.SOLVERS:
            raise ConfigurationError(f"--solver {self.solver}: choose one of {', '.join(solvers.SOLVERS)}")


@dataclass(frozen=True)
class FitResult:
    """Where a search ended.

    Attributes:
        values: all unknowns at the best start, shape (N,).
        chi2: of the samples and the priors together; dof: samples less unknowns without a prior.
    """

    problem: PayloadProblem
    solution: solvers.Solution
    values: np.ndarray
    chi2: float
    dof: int

    @classmethod
    def of(cls, problem: PayloadProblem, solution: solvers.Solution) -> FitResult:
        """The best of a solution's starts."""
        best = solution.internal[solution.best]
        values = problem.all_values(problem.coordinates.physical(best[None]))[0]
        without_prior = sum(1 for row in problem.free if not np.isfinite(problem.unknowns[row].std))
        return cls(
            problem,
            solution,
            values,
            2.0 * float(solution.cost[solution.best]),
            max(problem.samples - without_prior, 1),
        )

    @property
    def reduced_chi2(self) -> float:
        return self.chi2 / self.dof

    def column(self, name: str) -> int:
        """Place of an unknown among the free ones."""
        return list(self.problem.free).index(self.problem.index[name])

    def physical(self, name: str, internal: np.ndarray | None = None) -> np.ndarray:
        """A free unknown at every start's end, shape (S,), or at other solver coordinates of shape (..., F)."""
        given = self.solution.internal if internal is None else internal
        return self.problem.coordinates.physical(given)[..., self.column(name)]

    @property
    def explains(self) -> bool:
        return self.chi2 <= chi2_limit(self.dof)


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
        baseline: runs with nothing in the hand, fitted together with the others; they tell whether the robot has changed since
            its calibration.

    Raises:
        RecordingError: a run cannot be related to the robot at all (unknown joint, missing held joint).
    """
    facts = facts or PayloadFacts()
    options = options or WeighingOptions()
    found = Findings()
    usable: list[PreparedRun] = []
    weighing = 0
    for run, load in [*((run, None) for run in runs), *((run, KnownLoad()) for run in baseline)]:
        prepared = prepare_run(robot, run, load, facts)
        problem = unusable(prepared)
        if problem:
            found.reasons.append(f"{run.name}: {problem}")
        else:
            usable.append(prepared)
            weighing += load is None
        look_at_run(robot, prepared, found)
    if not weighing:
        return no_answer("payload", "payload_mass", "kg", robot.name, len(runs), found.reasons, found.notes)
    drift = _drift(robot, usable[weighing:], facts, options)

    nominal = solve_payload(robot, usable, facts, options, Role.FROZEN, rough=robot.is_calibrated(joints_of(usable)))
    opened = solve_payload(robot, usable, facts, options, Role.FREE, start=nominal)
    if not (opened if robot.is_calibrated(joints_of(usable)) else nominal).explains:
        again = solve_payload(robot, usable, facts, options, Role.FREE)
        opened = again if again.chi2 < opened.chi2 else opened
        if opened.chi2 < 0.5 * nominal.chi2 and not robot.is_calibrated() and not _known_exactly(robot, usable):
            found.notes.append(
                "the robot file's own values do not explain the recording, so what the file leaves open was fitted too, "
                "under its priors"
            )
    return _conclude(robot, usable, facts, options, nominal, opened, found, len(runs), drift)


def _drift(robot: Robot, baseline: Sequence[PreparedRun], facts: PayloadFacts, options: WeighingOptions) -> str:
    """What an empty hand that does not weigh nothing says about the calibration; empty where all is well."""
    if not baseline:
        return ""
    runs = [replace(run, load=None) for run in baseline]
    nominal = solve_payload(robot, runs, facts, options, Role.FROZEN)
    fit = solve_payload(robot, runs, facts, options, Role.FREE, start=nominal)
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
    robot: Robot, runs: Sequence[PreparedRun], facts: PayloadFacts, options: WeighingOptions, odd: int, mass: float
) -> Contradiction:
    name = runs[odd].run.name
    if runs[odd].load is not None:
        return Contradiction(
            f"{name}: the empty hand contradicts the other runs: was it empty, and has the robot changed meanwhile?"
        )
    masses: list[float] = []
    for group in ([runs[odd]], [run for row, run in enumerate(runs) if row != odd]):
        if any(run.load is None for run in group):
            nominal = solve_payload(robot, group, facts, options, Role.FROZEN)
            fit = solve_payload(robot, group, facts, options, Role.FREE, start=nominal)
            masses.append(float(fit.values[fit.problem.index["payload_mass"]]))
    if len(masses) < 2:
        return Contradiction(
            f"{name} contradicts the empty-hand runs ({1e3 * mass:.1f} g together): has the robot changed meanwhile?"
        )
    # where they say the same, the run is coarser than the others, and the fit's residuals tell by how much
    doubt = "was the same object held in the same place?"
    one, others = masses
    return contradiction(name, "kg", one, others, ALIKE_SHARE * abs(mass), ALIKE_KG, doubt)


def _known_exactly(robot: Robot, runs: Sequence[PreparedRun]) -> bool:
    """Whether the file leaves no drive-train term of the probed joints open."""
    return not any(getattr(robot.drive_trains[run.run.joint], term).std > 0.0 for run in runs for term in DRIVE_TERMS)


def solve_payload(
    robot: Robot,
    runs: Sequence[PreparedRun],
    facts: PayloadFacts,
    options: WeighingOptions,
    role: Role,
    start: FitResult | None = None,
    start_velocity_std: float | None = None,
    rough: bool = False,
) -> FitResult:
    """Fit the runs from every start, or from another fit's values; ``rough`` is enough to start another fit from."""
    unknowns = payload_unknowns(robot, runs, facts, role, options.starts_kg[len(options.starts_kg) // 2])
    if start_velocity_std is not None:
        unknowns = [replace(u, std=start_velocity_std) if u.kind == "v0" else u for u in unknowns]
    problem = PayloadProblem(robot, runs, facts, unknowns, options.integrator, options.step_s)
    coordinates = problem.coordinates
    if start is None:
        starts = np.tile(coordinates.prior_mean, (len(options.starts_kg), 1))
        starts[:, 0] = options.starts_kg
    else:
        starts = start.values[problem.free][None]
    starts = coordinates.internal(starts)
    if options.solver == "lm" or start is not None:
        windows = problem.simulator.windows if start is None else None
        iterations, tolerance = (10, 0.03) if rough else (30, 1e-4)
        solution = solvers.levenberg_marquardt(problem, starts, windows, iterations=iterations, tolerance=tolerance)
    elif options.solver == "adam":
        solution = solvers.adam(problem, starts)
    else:
        solution = solvers.cma(problem, starts)
    return FitResult.of(problem, solution)


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
) -> Estimate:
    known = robot.is_calibrated(joints_of(runs))
    fit = nominal if nominal.explains and not known else opened
    row = fit.problem.index["payload_mass"]
    fits, rms, expected = run_fits(fit.problem, fit.values, runs)
    # where the robot was calibrated its residuals are known, and only more than chance makes the interval wider
    inflation = 1.0 if known and fit.explains else max(1.0, fit.reduced_chi2)
    posterior = Posterior(opened.problem, opened.values, inflation)
    covariance, condition = posterior.whole_covariance(), posterior.condition
    budget = error_budget(opened, covariance)
    mass = float(fit.values[row])
    if not known:
        # the nominal mass may sit anywhere inside the open fit's interval: count how far
        covariance[row, row] += (mass - float(opened.values[row])) ** 2
        # where the joint hardly moves, the balance of torques is all that was seen, and no linearisation about a creep holds
        covariance[row, row] += _static_std(fit.problem, runs) ** 2
    odd = contradicting(Posterior(opened.problem, opened.values)) if len(runs) > 1 and np.isfinite(fit.chi2) else None
    apart = None if odd is None else _contradiction(robot, runs, facts, options, odd, mass)
    if apart is not None and apart.half is not None:
        covariance[row, row] += apart.half**2
    std = float(np.sqrt(covariance[row, row]))
    quality = Fit(rms, expected, fit.reduced_chi2, condition=condition)
    moving = [] if fit.explains else _moving_starts(robot, runs, facts, options, fit)
    verdict = Verdict.ACCEPTED
    withheld = ""
    if not np.isfinite(fit.chi2):
        verdict, withheld = Verdict.REJECTED, "no guess of the mass could be simulated"
        found.reasons.insert(0, withheld + ": check the robot file's inertias")
    elif drift:
        verdict, withheld = Verdict.REJECTED, "the robot has changed since its calibration"
        found.reasons.insert(0, drift)
    elif apart is not None and apart.half is None:
        verdict, withheld = Verdict.REJECTED, "the runs contradict each other"
        found.reasons.insert(0, apart.sentence)
    elif on_bound(fit):
        verdict, withheld = Verdict.REJECTED, "the mass ended on a bound of the search"
        found.reasons.insert(
            0,
            f"the mass ended on a bound of the search ({mass:.3g} kg): is this the right robot, joint and unit of current?",
        )
    elif fit.reduced_chi2 > MISFIT_LIMIT or moving:
        verdict = Verdict.REJECTED
        withheld = "the model does not explain the recording"
        found.reasons[:0] = [misfit_reason(rms, expected, mass, fit.reduced_chi2), *(moving or other_suspects(robot))]
    elif mass + Z95 * std < 0.0:
        verdict, withheld = Verdict.REJECTED, "the hand seems lighter than empty"
        found.reasons.insert(
            0,
            f"the hand with its load seems {-1e3 * mass:.1f} g lighter than it was empty: "
            + ("has the robot changed since? calibrate it again" if known else "calibrate the robot"),
        )
    elif (
        fit is opened
        and not known
        and (slow := [r for r in runs if abs(r.travel) < LITTLE_TRAVEL])
        and len(slow) == len(runs)
    ):
        verdict, withheld = Verdict.NOT_IDENTIFIABLE, "too little travel to tell friction from weight"
        found.reasons.insert(
            0,
            f"{slow[0].run.joint} moved only {abs(slow[0].travel):.2f} rad, too little to tell friction from weight: "
            "calibrate the robot on empty-hand runs, or probe with more current",
        )
    elif fit is opened and Z95 * std > options.widest_interval_kg:
        verdict, withheld = Verdict.NOT_IDENTIFIABLE, "the interval is too wide to tell a mass"
        largest = budget[0][0] if budget else "encoder noise"
        found.reasons.insert(
            0,
            f"the mass can only be told to +-{1e3 * Z95 * std:.0f} g, mostly because of {largest}: calibrate the robot on "
            "empty-hand runs, or probe with more travel",
        )
    elif rivals := _rivals(fit, mass, std):
        verdict, withheld = Verdict.NOT_IDENTIFIABLE, "more than one mass explains the recording"
        found.reasons.insert(
            0, "more than one mass explains the recording: " + ", ".join(f"{1e3 * m:.1f} g" for m in (mass, *rivals))
        )
    if verdict is Verdict.ACCEPTED:
        if apart is not None and apart.sentence:
            found.reasons.append(apart.sentence)
        if inflation > 1.0 and not fit.explains:
            found.reasons.append(
                f"the fit is {np.sqrt(inflation):.1f} times coarser than the encoder (rms {1e3 * rms:.2f} mrad): "
                "the interval was widened by that factor"
            )
        say_if_uncalibrated(robot, runs, budget, found)
        if not known:
            found.reasons.extend([] if _known_exactly(robot, runs) else never_reversed(runs))
    return Estimate(
        probe="payload",
        robot=robot.name,
        verdict=verdict,
        reasons=tuple(found.reasons),
        values=_values(fit, covariance, withheld),
        fit=quality,
        solver=_summary(nominal if nominal.explains or len(opened.solution.cost) == 1 else opened, options, std),
        runs=run_count,
        run_fits=fits,
        unknowns=unknown_rows(opened, covariance),
        budget=tuple(budget),
        scan=misfit_over(fit, "payload_mass", scan_masses(float(fit.values[fit.problem.index["payload_mass"]]))),
        assumptions=_assumptions(robot, facts, options, fit is nominal),
        notes=tuple(found.notes),
    )


def _values(fit: FitResult, covariance: np.ndarray, withheld: str) -> tuple[Value, ...]:
    at = fit.problem.index
    row = at["payload_mass"]
    if withheld:
        values = [Value("payload_mass", "kg", None, reason=withheld)]
    else:
        mass, std = float(fit.values[row]), float(np.sqrt(covariance[row, row]))
        # a mass is not negative: an empty hand reads 0 with an interval that starts there
        interval = [max(mass - Z95 * std, 0.0), max(mass + Z95 * std, 0.0)]
        values = [Value("payload_mass", "kg", max(mass, 0.0), std, interval)]
    rows = [at[f"payload_com_{axis}"] for axis in "xyz"]
    if any(fit.problem.unknowns[r].std > 0.0 for r in rows):
        values.append(_centre_of_mass(fit, covariance, rows, withheld))
    return tuple(values)


def _centre_of_mass(fit: FitResult, covariance: np.ndarray, rows: list[int], withheld: str) -> Value:
    """Each coordinate on its own: what the probe did not excite stays at its prior, and is not called an estimate."""
    numbers: list[float | None] = []
    stds: list[float | None] = []
    intervals: list[list[float] | None] = []
    untold = []
    for axis, r in zip("xyz", rows, strict=True):
        std, prior = float(np.sqrt(covariance[r, r])), fit.problem.unknowns[r].std
        if withheld or (prior > 0.0 and std > 0.7 * prior):
            untold.append(axis)
            numbers.append(None)
            stds.append(None)
            intervals.append(None)
        else:
            value = float(fit.values[r])
            numbers.append(value)
            stds.append(std)
            intervals.append([value - Z95 * std, value + Z95 * std])
    reason = withheld or (f"{', '.join(untold)} not excited: the probe tells no more than the prior" if untold else "")
    return Value("payload_com", "m", numbers, stds, intervals, reason)


def say_if_uncalibrated(
    robot: Robot, runs: Sequence[PreparedRun], budget: list[tuple[str, float]], found: Findings
) -> None:
    if robot.is_calibrated():
        joints = [joint for joint in joints_of(runs) if not robot.is_calibrated([joint])]
        if joints and robot.calibration is not None:  # a file that only says so leaves nothing to be said
            found.reasons.append(
                f"{', '.join(joints)} was not calibrated, so the interval carries what the robot file leaves open of it"
            )
        return
    if _known_exactly(robot, runs):
        return
    largest = [f"{source} {1e3 * std:.1f} g" for source, std in budget if source != ENCODER][:3]
    found.reasons.append(
        "the robot has not been calibrated: the interval carries what its file leaves open"
        + (f" (standard deviations: {', '.join(largest)})" if largest else "")
    )


ENCODER, CALIBRATION = "encoder", "calibration"


def _static_std(problem: PayloadProblem, runs: Sequence[PreparedRun]) -> float:
    """What the open friction and torque constant are worth as a weight at rest [kg]; 0 if any run moved far enough."""
    if any(abs(run.travel) >= LITTLE_TRAVEL for run in runs):
        return 0.0
    return min(
        float(np.hypot.reduce(problem.torque_stds(run))) / max(abs(problem.load_per_mass(run)), 1e-9) for run in runs
    )


def error_budget(fit: FitResult, covariance: np.ndarray, name: str = "payload_mass") -> list[tuple[str, float]]:
    """Which source puts how much standard deviation on the mass called ``name`` [kg], largest first.

    With normal matrix ``J^T J + P`` and its inverse C, the variance of the mass is ``C J^T J C + C P C``: the first part is the
    samples', and the second falls into the priors that are independent of each other. What a calibration left correlated is one.
    """
    problem = fit.problem
    at = problem.index[name]
    calibration = problem.robot.calibration
    correlated = set() if calibration is None else set(calibration.names)
    row = covariance[at, problem.free]
    pulled = problem.coordinates.prior_precision @ row
    names = [problem.unknowns[column].name for column in problem.free]
    parts: dict[str, float] = {}
    for name, share in zip(names, row * pulled, strict=True):
        source = CALIBRATION if name in correlated else name
        parts[source] = parts.get(source, 0.0) + float(share)
    parts[ENCODER] = float(covariance[at, at]) - sum(parts.values())
    budget = [(source, float(np.sqrt(max(variance, 0.0)))) for source, variance in parts.items()]
    return sorted((entry for entry in budget if entry[1] > 1e-7), key=lambda entry: -entry[1])


def _rivals(fit: FitResult, mass: float, std: float) -> list[float]:
    """Masses of other starts that explain the recording as well but lie elsewhere."""
    solution = fit.solution
    ends = fit.problem.coordinates.physical(solution.internal)[:, 0]
    near = solution.cost < solution.cost[solution.best] + 2.0
    apart = np.abs(ends - mass) > max(3.0 * std, 0.02 * abs(mass), 5e-4)
    rivals: list[float] = []
    for end in ends[near & apart]:
        if all(abs(end - other) > 0.02 * abs(other) for other in rivals):
            rivals.append(float(end))
    return rivals


def misfit_reason(rms: float, expected: float, mass: float, reduced_chi2: float) -> str:
    if rms <= expected:
        return (
            f"misfit: the simulation ({1e3 * mass:.1f} g) only follows the recording with a robot or a start further from what is "
            f"known about them than chance allows (reduced chi-square {reduced_chi2:.1f})"
        )
    return (
        f"misfit: the best simulation ({1e3 * mass:.1f} g) misses the recording by {1e3 * rms:.2f} mrad rms where the encoder "
        f"explains {1e3 * expected:.2f} mrad, so its mass is no weighing"
    )


def other_suspects(robot: Robot) -> list[str]:
    if robot.is_calibrated():
        return []
    return [
        "the robot has not been calibrated: friction, torque constant or armature outside what its file allows would do this"
    ]


def _moving_starts(
    robot: Robot, runs: Sequence[PreparedRun], facts: PayloadFacts, options: WeighingOptions, fit: FitResult
) -> list[str]:
    """A sentence for each run that fits far better if it did not start from rest."""
    # with the robot as its file states it: free friction can imitate a start velocity, and the other way round
    moving = solve_payload(robot, runs, facts, replace(options, solver="lm"), Role.FROZEN, start_velocity_std=10.0)
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


def _summary(fit: FitResult, options: WeighingOptions, std: float) -> SolverSummary:
    """What every start did. Starts agree when they explain the recording alike, at masses that the interval cannot tell apart."""
    solution = fit.solution
    physical = fit.problem.coordinates.physical
    ends = physical(solution.internal)[:, 0]
    best = ends[solution.best]
    paths = []
    for s, start in enumerate(options.starts_kg):
        agrees = bool(
            solution.cost[s] < solution.cost[solution.best] + 0.5
            and abs(ends[s] - best) <= max(1e-4, 0.01 * abs(best), 0.1 * std)
        )
        paths.append(
            StartPath(
                start,
                float(ends[s]),
                float(solution.cost[s]),
                agrees,
                physical(solution.path[:, s])[:, 0],
                solution.path_cost[:, s],
            )
        )
    return SolverSummary(
        options.solver, "default", solution.iterations, tuple(paths), options.integrator, options.step_s
    )


def unknown_rows(fit: FitResult, covariance: np.ndarray) -> tuple[UnknownRow, ...]:
    return tuple(
        UnknownRow(
            u.kind,
            u.role.value,
            u.value,
            u.std,
            float(fit.values[row]),
            float(np.sqrt(covariance[row, row])),
            scope=u.scope,
        )
        for row, u in enumerate(fit.problem.unknowns)
    )


def scan_masses(mass: float) -> np.ndarray:
    """Masses worth looking at around a value: three orders of magnitude, and a fine stretch about it [kg], shape (M,)."""
    return np.unique(np.concatenate([np.geomspace(1e-3, 0.5, 60), max(mass, 1e-3) * np.linspace(0.5, 1.5, 41)]))


def misfit_over(fit: FitResult, name: str, grid: np.ndarray) -> Scan:
    """The data's misfit over the unknown called ``name``, at the values of ``grid`` (shape (M,)), all others as fitted."""
    problem = fit.problem
    values = np.tile(fit.values, (len(grid), 1))
    values[:, problem.index[name]] = grid
    q, _, _ = problem.simulate(values, problem.free[:3])
    residual = np.where(problem.weight > 0.0, (q - problem.measured) * problem.weight, 0.0)
    with np.errstate(over="ignore", invalid="ignore"):
        cost = np.einsum("srt,srt->s", residual, residual)
    good = np.isfinite(cost)
    return Scan(grid[good], cost[good] / fit.dof)


def _assumptions(robot: Robot, facts: PayloadFacts, options: WeighingOptions, nominal: bool) -> tuple[str, ...]:
    place = ", ".join(f"{1e3 * c:g}" for c in facts.com)
    return (
        f"the payload is rigid, {facts.shape.description}"
        + (" (size guessed, its uncertainty counted)" if facts.shape_std_relative > 0.0 else "")
        + f", its centre at [{place}] mm in {robot.payload_frame}",
        "each probe starts from rest; the held joints stand at their recorded mean",
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
