"""A search and where it ended: the fit of a rigid load, what limits it, and what every probe says about it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from proprio_ros.errors import ConfigurationError
from proprio_ros.identification import solvers
from proprio_ros.identification.estimate import Scan, SolverSummary, StartPath, UnknownRow
from proprio_ros.identification.gates import Findings, chi2_limit
from proprio_ros.identification.problem import (
    DRIVE_TERMS,
    PreparedRun,
    Problem,
    joints_of,
    load_unknowns,
)
from proprio_ros.identification.reasons import Reason
from proprio_ros.identification.unknowns import Role
from proprio_ros.robot import Robot
from proprio_ros.sim.payload import PayloadFacts

ENCODER, CALIBRATION = "encoder", "calibration"
"""Sources of uncertainty that are no unknown: noise of the readings, and all that a calibration left correlated."""


@dataclass(frozen=True)
class SearchOptions:
    """How a rigid load is searched for.

    Attributes:
        solver: one of ``solvers.SOLVERS``.
        integrator, step_s: see ``JointSimulator``.
        starts_kg: first guesses, two orders of magnitude apart.
    """

    solver: str = "lm"
    integrator: str = "rk4"
    step_s: float = 1.0 / 240.0
    starts_kg: tuple[float, ...] = (0.005, 0.016, 0.05, 0.16, 0.5)

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

    problem: Problem
    solution: solvers.Solution
    values: np.ndarray
    chi2: float
    dof: int

    @classmethod
    def of(cls, problem: Problem, solution: solvers.Solution) -> FitResult:
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


def known_exactly(robot: Robot, runs: Sequence[PreparedRun]) -> bool:
    """Whether the file leaves no drive-train term of the probed joints open."""
    return not any(getattr(robot.drive_trains[run.run.joint], term).std > 0.0 for run in runs for term in DRIVE_TERMS)


def solve_load(
    robot: Robot,
    runs: Sequence[PreparedRun],
    facts: PayloadFacts,
    options: SearchOptions,
    role: Role,
    start: FitResult | None = None,
    start_velocity_std: float | None = None,
    rough: bool = False,
) -> FitResult:
    """Fit the runs from every start, or from another fit's values; ``rough`` is enough to start another fit from."""
    unknowns = load_unknowns(robot, runs, facts, role, options.starts_kg[len(options.starts_kg) // 2])
    if start_velocity_std is not None:
        unknowns = [replace(u, std=start_velocity_std) if u.kind == "v0" else u for u in unknowns]
    problem = Problem(robot, runs, facts, unknowns, options.integrator, options.step_s)
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


def warn_if_uncalibrated(
    robot: Robot, runs: Sequence[PreparedRun], budget: Sequence[tuple[str, float]], found: Findings
) -> None:
    """Add a warning to ``found`` where the interval carries the file's priors instead of a calibration."""
    if robot.is_calibrated():
        joints = [joint for joint in joints_of(runs) if not robot.is_calibrated([joint])]
        if joints and robot.calibration is not None:  # a file that only says so leaves nothing to be said
            open_of_it = "was not calibrated, so the interval carries what the robot file leaves open of it"
            found.reasons.append(Reason("not_calibrated", f"{', '.join(joints)} {open_of_it}"))
        return
    if known_exactly(robot, runs):
        return
    largest = [f"{source} {1e3 * std:.1f} g" for source, std in budget if source != ENCODER][:3]
    sentence = "the robot has not been calibrated: the interval carries what its file leaves open"
    sentence += f" (standard deviations: {', '.join(largest)})" if largest else ""
    found.reasons.append(Reason("not_calibrated", sentence))


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


def rivals(fit: FitResult, name: str, value: float, std: float, share: float) -> list[float]:
    """Masses of other starts that explain the recording as well but lie elsewhere.

    Args:
        fit: the best start, with the others.
        name: of the unknown [kg].
        value: of the estimate [kg].
        std: of the estimate [kg].
        share: masses that differ by less than this share of them are one.
    """
    ends, cost = fit.physical(name), fit.solution.cost
    near = cost < cost[fit.solution.best] + 2.0
    apart = np.abs(ends - value) > max(3.0 * std, share * abs(value), 5e-4)
    found: list[float] = []
    for end in ends[near & apart]:
        if all(abs(end - other) > share * abs(other) for other in found):
            found.append(float(end))
    return found


def summary(
    fit: FitResult,
    name: str,
    starts: Sequence[float],
    tolerance: float,
    iterations: int,
    options: SearchOptions,
    margin: float = np.inf,
) -> SolverSummary:
    """What every start did.

    Args:
        fit: of the search from all starts.
        name: of the unknown that is searched for.
        starts: first guesses of it; where there are more starts they are taken in turn.
        tolerance: ends agree that are no farther from the best, in the unknown's unit, ..
        iterations: of all searches together.
        options: what was asked for.
        margin: .. and whose cost is above the best by less.
    """
    solution = fit.solution
    ends, history = fit.physical(name), fit.physical(name, solution.path)
    near = np.abs(ends - ends[solution.best]) <= tolerance
    near &= solution.cost < solution.cost[solution.best] + margin
    paths = tuple(
        StartPath(
            starts[s % len(starts)], float(end), float(solution.cost[s]), bool(near[s]), history[:, s],
            solution.path_cost[:, s],
        )
        for s, end in enumerate(ends)
    )  # fmt: skip
    return SolverSummary(options.solver, "default", iterations, paths, options.integrator, options.step_s)


def misfit_reason(rms: float, expected: float, mass: float, reduced_chi2: float) -> str:
    """Why a fit is no weighing: residuals (rms [rad]) larger than expected, or unknowns too far from their priors."""
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
    """What else than the object may be the cause of a misfit."""
    if robot.is_calibrated():
        return []
    return [
        "the robot has not been calibrated: friction, torque constant or armature outside what its file allows would do this"
    ]


def unknown_rows(fit: FitResult, covariance: np.ndarray) -> tuple[UnknownRow, ...]:
    """All unknowns with prior and posterior, as a report shows them."""
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
