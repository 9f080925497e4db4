"""A search and where it ended: the fit of a rigid load, what limits it, and what every probe says about it."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from proprio_ros.errors import ConfigurationError
from proprio_ros.identification import sentences, solvers
from proprio_ros.identification.chance import beyond_chance
from proprio_ros.identification.estimate import (
    Scan,
    SolverSummary,
    StartPath,
    UnknownRow,
)
from proprio_ros.identification.posterior import Posterior
from proprio_ros.identification.prepared_runs import (
    PreparedRun,
    joints_of,
)
from proprio_ros.identification.problem import Problem
from proprio_ros.identification.reasons import Reason
from proprio_ros.identification.robot_unknowns import (
    DRIVE_TERMS,
    load_unknowns,
)
from proprio_ros.identification.unknowns import (
    Role,
    Unknown,
    scaled_inverse,
)
from proprio_ros.kinds import Key, key_of, label_of
from proprio_ros.quantity import Z95
from proprio_ros.robot import Robot
from proprio_ros.sim.payload import PayloadFacts
from proprio_ros.sim.runtime import device_named

ENCODER, CALIBRATION = "encoder", "calibration"
"""Sources of uncertainty that are no unknown: noise of the readings, and what a calibration left correlated."""
CALIBRATED = {
    "torque_constant": "torque constants",
    "armature": "armatures",
    "delay": "delay",
    **dict.fromkeys(
        (
            "coulomb",
            "viscous",
            "load_friction",
            "stribeck",
            "stribeck_velocity",
        ),
        "friction",
    ),
    **dict.fromkeys(
        ("zero", "ripple_cos", "ripple_sin"),
        "zeros and encoder errors",
    ),
}
"""What a calibration's unknowns are called together, by kind; all others are the arm's masses."""
CHI2_95 = Z95**2  # chi-square above its least at the ends of a 95 % interval of one unknown
PROFILE = "chi-square above the least"
PROFILE_STEPS, PROFILE_STDS, PROFILE_ITERATIONS = 6, 3.0, 15
"""At how many values to each side a profile is fitted again, how far it reaches, and iterations of each fit at most."""
# a profile ends where it rises above this: what comes then is no continuation of the fit
PROFILE_HIGHEST = 100.0


@dataclass(frozen=True)
class SearchOptions:
    """How a rigid load is searched for; integrator and step as in ``JointSimulator``."""

    solver: str = "lm"  # one of `solvers.SOLVERS`
    integrator: str = "rk4"
    step_s: float = 1.0 / 240.0
    # first guesses, two orders of magnitude apart
    starts_kg: tuple[float, ...] = (0.005, 0.016, 0.05, 0.16, 0.5)
    device: str = "cpu"  # where fits from every start are computed

    def __post_init__(self) -> None:
        if self.solver not in solvers.SOLVERS:
            raise ConfigurationError(
                f"--solver {self.solver}: choose one of {', '.join(solvers.SOLVERS)}"
            )
        if self.device != "cpu" and self.solver != "lm":
            raise ConfigurationError(
                f"--device {self.device} goes with --solver lm: leave one of them out"
            )
        device_named(self.device)


@dataclass(frozen=True)
class FitResult:
    """Where a search ended."""

    problem: Problem
    solution: solvers.Solution
    values: np.ndarray  # all unknowns at the best start, shape (N,)
    chi2: float  # of the samples and the priors together
    dof: int  # samples less unknowns without a prior

    @classmethod
    def of(cls, problem: Problem, solution: solvers.Solution) -> FitResult:
        """The best of a solution's starts."""
        best = solution.internal[solution.best]
        values = problem.all_values(problem.coordinates.physical(best[None]))[0]
        without_prior = sum(not np.isfinite(problem.unknowns[row].std) for row in problem.estimated)
        dof = max(problem.samples - without_prior, 1)
        return cls(
            problem,
            solution,
            values,
            2.0 * float(solution.cost[solution.best]),
            dof,
        )

    @property
    def reduced_chi2(self) -> float:
        return self.chi2 / self.dof

    def value_of(self, key: Key) -> float:
        """Of an unknown, in its unit."""
        return float(self.values[self.problem.index[key]])

    def determined(self, key: Key) -> tuple[float, float]:
        """Of an unknown: its value and standard deviation, as the recording and its prior determine it."""
        row = self.problem.index[key]
        return self.value_of(key), float(
            np.sqrt(Posterior(self.problem, self.values).whole_covariance()[row, row])
        )

    def values_of(self, unknowns: Sequence[Unknown]) -> np.ndarray:
        """Its values of another problem's unknowns, theirs where it has none, shape (N,)."""
        index = self.problem.index
        return np.array(
            [float(self.values[index[u.key]]) if u.key in index else u.value for u in unknowns]
        )

    def column(self, name: str) -> int:
        """Place of an unknown among the estimated ones."""
        return self.problem.column_of(name)

    def physical(
        self,
        name: str,
        internal: np.ndarray | None = None,
    ) -> np.ndarray:
        """An estimated unknown at every start's end, shape (S,), or at other solver coordinates of shape (..., F)."""
        given = self.solution.internal if internal is None else internal
        return self.problem.coordinates.physical(given)[..., self.column(name)]

    @property
    def explains(self) -> bool:
        return not beyond_chance(self.chi2, self.dof)


def known_exactly(robot: Robot, runs: Sequence[PreparedRun]) -> bool:
    """Whether the file leaves no drive-train term of the driven joints open."""
    return not any(
        getattr(robot.drive_trains[run.run.joint], term).std > 0.0
        for run in runs
        for term in DRIVE_TERMS
    )


def first_problem(
    robot: Robot,
    runs: Sequence[PreparedRun],
    facts: PayloadFacts,
    options: SearchOptions,
    role: Role,
    start_velocity_std: float | None = None,
) -> tuple[Problem, np.ndarray]:
    """What is to be fitted, and every start of the options in solver coordinates, shape (S, F).

    Arguments are those of `solve_load`: robot, runs, facts, options, role, start_velocity_std.
    """
    unknowns = load_unknowns(
        robot,
        runs,
        facts,
        role,
        options.starts_kg[len(options.starts_kg) // 2],
    )
    if start_velocity_std is not None:
        unknowns = [replace(u, std=start_velocity_std) if u.kind == "v0" else u for u in unknowns]
    problem = Problem(
        robot,
        runs,
        facts,
        unknowns,
        options.integrator,
        options.step_s,
    )
    starts = np.tile(problem.coordinates.prior_mean, (len(options.starts_kg), 1))
    starts[:, 0] = options.starts_kg
    return problem, problem.coordinates.internal(starts)


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
    """Fit the runs from every start, or from another fit's values.

    Args:
        robot: As its file or calibration states it.
        runs: Prepared.
        facts: About the payload.
        options: How to search.
        role: Of what is open about the robot.
        start: A fit whose values are the only start; None is every start of the options.
        start_velocity_std: Of every run's start velocity [rad/s]; None is the usual one.
        rough: Enough to start another fit from.
    """
    problem, starts = first_problem(
        robot,
        runs,
        facts,
        options,
        role,
        start_velocity_std,
    )
    if start is not None:
        starts = problem.coordinates.internal(start.values[problem.estimated][None])
    if options.solver == "lm" or start is not None:
        windows = problem.simulator.windows if start is None else None
        iterations, tolerance = (10, 0.03) if rough else (30, 1e-4)
        if windows is not None and _on_a_device(problem, options.device):
            from proprio_ros.identification.together import descend, rules

            solution = descend(
                problem, starts, options.device, rules(iterations, tolerance, not rough)
            )
        else:
            solution = solvers.levenberg_marquardt(
                problem,
                starts,
                windows,
                iterations=iterations,
                tolerance=tolerance,
                persistent=not rough,
            )
    elif options.solver == "adam":
        solution = solvers.adam(problem, starts)
    else:
        solution = solvers.cma(problem, starts)
    return FitResult.of(problem, solution)


def _on_a_device(problem: Problem, device: str) -> bool:
    """Whether a graphics card solves it, beside others; kernels of that are loaded where there is one."""
    if device == "cpu":
        return False
    from proprio_ros.identification.together import can_go_together

    return can_go_together(problem)


def fit_both(
    solve: Callable[..., FitResult],
    again: Callable[[FitResult, FitResult], bool],
) -> tuple[FitResult, FitResult]:
    """A fit with the robot as it is stated, and from there the one in which all that is open moves under its prior.

    ``solve`` takes a role for what is open, and a fit to start from (``start``), default every start; ``again`` says of both fits
    whether the second is to be tried from every start, too: then the better one counts.
    """
    nominal = solve(Role.FIXED)
    opened = solve(Role.ESTIMATED, start=nominal)
    if again(nominal, opened):
        other = solve(Role.ESTIMATED)
        opened = other if other.chi2 < opened.chi2 else opened
    return nominal, opened


def unexplained(_: FitResult, opened: FitResult) -> bool:
    """For `fit_both`: whether the second fit does not explain the recording, as far from the file's values."""
    return not opened.explains


def fit_opened(solve: Callable[..., FitResult]) -> FitResult:
    """The second fit of `fit_both`, from the first one alone."""
    return solve(Role.ESTIMATED, start=solve(Role.FIXED))


def uncalibrated(
    robot: Robot,
    runs: Sequence[PreparedRun],
    budget: Sequence[tuple[str, float]],
) -> list[Reason]:
    """A sentence where the interval carries the file's priors instead of a calibration.

    Args:
        robot: As its file or calibration states it.
        runs: Whose joints count.
        budget: Sources of uncertainty and their standard deviations [kg].
    """
    if robot.is_calibrated():
        joints = [joint for joint in joints_of(runs) if not robot.is_calibrated([joint])]
        # a file that only says so leaves nothing to be said
        if joints and robot.calibration is not None:
            return [sentences.joints_not_calibrated(joints)]
        return []
    if known_exactly(robot, runs):
        return []
    stds_g = [(source_label(source), 1e3 * std) for source, std in budget if source != ENCODER]
    return [sentences.not_calibrated(stds_g[:3])]


def error_budget(
    fit: FitResult,
    covariance: np.ndarray,
    name: str = "payload_mass",
) -> list[tuple[str, float]]:
    """Which source puts how much standard deviation on a mass [kg], largest first.

    With normal matrix ``J^T J + P`` and its inverse C, the variance of the mass is ``C J^T J C + C P C``: the first part is the
    samples', and the second falls into the priors. What a calibration left correlated is split by what it is of, see ``_split``.

    Args:
        fit: Where it ended.
        covariance: Of all unknowns, shape (N, N).
        name: Of the mass.
    """
    problem = fit.problem
    at = problem.index[name]
    calibration = problem.robot.calibration
    correlated = set() if calibration is None else set(calibration.names)
    row = covariance[at, problem.estimated]
    pulled = problem.coordinates.prior_precision @ row
    parts: dict[str, float] = {}
    groups: dict[str, list[int]] = {}
    for place, column in enumerate(problem.estimated):
        unknown = problem.unknowns[column]
        if unknown.name in correlated:
            part = f"{CALIBRATION}: {CALIBRATED.get(unknown.kind, 'arm masses')}"
            groups.setdefault(part, []).append(place)
        else:
            parts[unknown.name] = float(row[place] * pulled[place])
    parts |= _split(row, problem.coordinates.prior_precision, groups)
    parts[ENCODER] = float(covariance[at, at]) - sum(parts.values())
    budget = []
    for source, variance in parts.items():
        budget.append((source, float(np.sqrt(max(variance, 0.0)))))
    return sorted(
        (entry for entry in budget if entry[1] > 1e-7),
        key=lambda entry: -entry[1],
    )


def _split(
    row: np.ndarray,
    precision: np.ndarray,
    groups: Mapping[str, Sequence[int]],
) -> dict[str, float]:
    """A variance that correlated unknowns cause together, split among groups of them, which are places of unknowns by name.

    A group's share is what knowing it would take from the variance, on average over all orders in which the groups become known
    (Shapley effects, Owen 2014, SIAM/ASA J. Uncertainty Quantification 2(1)): no share is negative, and they add up. ``row`` (F,)
    is the covariance of the result with each estimated unknown, ``precision`` (F, F) that of their prior.
    """
    names = list(groups)
    every = [place for places in groups.values() for place in places]
    prior = scaled_inverse(precision[np.ix_(every, every)])
    within = [[every.index(place) for place in groups[name]] for name in names]

    @functools.cache
    def known(subset: frozenset[int]) -> float:
        """What knowing these groups takes from the variance: the prior's pull on the result is precision @ row."""
        rows = [place for group in sorted(subset) for place in within[group]]
        if not rows:
            return 0.0
        seen = row[every][rows]
        sizes = np.sqrt(np.diag(prior)[rows])
        block = prior[np.ix_(rows, rows)] / sizes[:, None] / sizes
        return float(seen / sizes @ np.linalg.solve(block, seen / sizes))

    shares = {}
    for group, name in enumerate(names):
        others = [other for other in range(len(names)) if other != group]
        shares[name] = 0.0
        for size in range(len(names)):
            weight = 1.0 / (len(names) * math.comb(len(names) - 1, size))
            for before in itertools.combinations(others, size):
                gain = known(frozenset((*before, group))) - known(frozenset(before))
                shares[name] += weight * max(gain, 0.0)
    return shares


def source_label(source: str) -> str:
    """For people: a source of ``error_budget`` that is an unknown by its label, any other as it is."""
    return source if source.startswith(CALIBRATION) else label_of(key_of(source))


def rivals(
    fit: FitResult,
    name: str,
    value: float,
    std: float,
    share: float,
) -> list[float]:
    """Masses of other starts that explain the recording as well but lie elsewhere than the estimate [kg].

    Args:
        fit: From all starts.
        name: Of the mass.
        value: The estimate [kg].
        std: Its standard deviation [kg].
        share: Masses that differ by less than this part of them are one.
    """
    ends = fit.physical(name)
    cost = fit.solution.cost
    near = cost < cost[fit.solution.best] + 2.0
    least = max(3.0 * std, share * abs(value), 5e-4)
    apart = np.abs(ends - value) > least
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
    final: FitResult | None = None,
) -> SolverSummary:
    """What every start did, of a search from all of them.

    Args:
        fit: From all starts.
        name: Of the unknown.
        starts: First guesses of it, taken in turn where there are more starts.
        tolerance: Ends agree that are no farther from the best, in the unknown's unit.
        iterations: Of all searches together.
        options: How it was searched.
        margin: And whose cost is above the best by less.
        final: The fit that gave the answer, where that is another one, started from the ends of this.
    """
    refined = () if final is None or final is fit else _paths(final, name, tolerance, margin)
    paths = _paths(fit, name, tolerance, margin, starts)
    return SolverSummary(
        options.solver,
        "default",
        iterations,
        paths,
        options.integrator,
        options.step_s,
        refined,
    )


def _paths(
    fit: FitResult,
    name: str,
    tolerance: float,
    margin: float,
    starts: Sequence[float] | None = None,
) -> tuple[StartPath, ...]:
    """See ``summary``; without ``starts`` each path starts where its first iteration does."""
    solution = fit.solution
    ends = fit.physical(name)
    history = fit.physical(name, solution.path)
    near = np.abs(ends - ends[solution.best]) <= tolerance
    near &= solution.cost < solution.cost[solution.best] + margin
    firsts = history[0].tolist() if starts is None else itertools.cycle(starts)
    numbers = zip(
        firsts,
        ends.tolist(),
        solution.cost.tolist(),
        near.tolist(),
        strict=False,
    )
    return tuple(
        StartPath(*row, history[:, s], solution.path_cost[:, s]) for s, row in enumerate(numbers)
    )


def other_suspects(robot: Robot) -> list[str]:
    """What else than the object may be the cause of a misfit."""
    if robot.is_calibrated():
        return []
    may_be = "friction, torque constant or armature outside what its file allows would do this"
    return [f"the robot has not been calibrated: {may_be}"]


def unknown_rows(fit: FitResult, covariance: np.ndarray) -> tuple[UnknownRow, ...]:
    """All unknowns with prior and posterior, as a report shows them."""
    rows = zip(
        fit.problem.unknowns,
        fit.values.tolist(),
        np.sqrt(np.diag(covariance)).tolist(),
        strict=True,
    )
    return tuple(
        UnknownRow(
            u.kind,
            u.role.value,
            u.value,
            u.std,
            value,
            std,
            scope=u.scope,
        )
        for u, value, std in rows
    )


class _Held:
    """A problem whose estimated unknown in one column stays where each guess has it.

    ``inflation`` is a factor on the variance of the samples, while the priors stay as narrow as they are; whatever it is, ``best``
    (F,) stay the best values.
    """

    def __init__(
        self,
        problem: Problem,
        column: int,
        inflation: float,
        best: np.ndarray,
    ) -> None:
        self.coordinates = problem.coordinates
        self._problem = problem
        self.column = column
        self._inflation = inflation
        self._best = best

    def linearise(
        self,
        internal: np.ndarray,
        counts: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See ``LeastSquares``."""
        cost, gradient, matrix = self._problem.linearise(internal, counts)
        if self._inflation > 1.0:
            precision = self.coordinates.prior_precision
            slope = self.coordinates.slope(internal)
            off = self.coordinates.physical(internal) - self._best
            pull = off @ precision
            share = 1.0 - 1.0 / self._inflation
            cost = cost / self._inflation + share * 0.5 * np.einsum("sf,sf->s", off, pull)
            gradient = gradient / self._inflation + share * pull * slope
            matrix = (
                matrix / self._inflation + share * precision * slope[:, :, None] * slope[:, None, :]
            )
        gradient[:, self.column] = 0.0
        matrix[:, self.column, :] = 0.0
        matrix[:, :, self.column] = 0.0
        matrix[:, self.column, self.column] = 1.0
        return cost, gradient, matrix


def misfit_profile(
    fit: FitResult,
    name: str,
    posterior: Posterior,
    inflation: float,
    value: float,
    std: float,
) -> Scan:
    """Chi-square above its least over the unknown called ``name``, everything else fitted again at each of its values.

    Upwards and downwards from the fit at once, each of these fits starts from its neighbour's end, where the posterior
    expects its own, so that a few iterations reach it (Raue et al. 2009, Bioinformatics 25(15), call it the profile
    likelihood). It reaches as far about the stated value as about that of the fit.

    Args:
        fit: Where it ended.
        name: Of the unknown.
        posterior: Of the fit, with the inflation.
        inflation: Factor on the variance of the samples.
        value: As it is stated, in the unknown's unit.
        std: Of the stated value.
    """
    problem = fit.problem
    column = fit.column(name)
    best = fit.value_of(name)
    own = float(posterior.covariance[column, column])
    if not np.isfinite([fit.chi2, best, value, std, own]).all() or own <= 0.0:
        return Scan(
            np.zeros(0),
            np.zeros(0),
            PROFILE,
            CHI2_95,
        )
    at = fit.values[problem.estimated]
    held = _Held(problem, column, inflation, at)
    unknown = problem.unknowns[problem.index[name]]
    step = (_profile_ends(unknown, best, value, std) - best) / PROFILE_STEPS
    ahead = np.outer(step, posterior.covariance[:, column] / own)
    ahead[:, column] = step
    grid, costs = _both_ways(held, at, ahead)
    values, first = np.unique(grid, return_index=True)
    chi2 = 2.0 * np.array(costs)[first]
    return Scan(values, chi2 - chi2.min(), PROFILE, CHI2_95)


def _both_ways(held: _Held, at: np.ndarray, ahead: np.ndarray) -> tuple[list[float], list[float]]:
    """Values of the unknown that is held, and the least cost at each, from the fit on.

    Args:
        held: The problem.
        at: Free unknowns at the fit, shape (F,).
        ahead: By how much they change with a step down and up, shape (2, F).
    """
    coordinates = held.coordinates
    at_best = coordinates.internal(at)
    least = float(held.linearise(at_best[None])[0][0])
    grid = [float(at[held.column])]
    costs = [least]
    end = np.tile(at_best, (2, 1))
    follows = np.full(2, True)
    for _ in range(PROFILE_STEPS):
        guess = coordinates.internal(coordinates.physical(end) + ahead)
        solution = solvers.levenberg_marquardt(
            held,
            guess,
            None,
            iterations=PROFILE_ITERATIONS,
            tolerance=0.1,
        )
        end = solution.internal
        follows &= 2.0 * (solution.cost - least) < PROFILE_HIGHEST
        grid += coordinates.physical(end)[follows, held.column].tolist()
        costs += solution.cost[follows].tolist()
    return grid, costs


def _profile_ends(unknown: Unknown, best: float, value: float, std: float) -> np.ndarray:
    """How far down and up a profile goes, shape (2,): some standard deviations about both values, inside the unknown's bounds."""
    # what spans orders of magnitude is less than nothing only where an empty hand reads so
    lowest = 0.0 if unknown.asinh_scale > 0.0 and best > 0.0 else unknown.lower
    low = min(best, value) - PROFILE_STDS * std
    high = max(best, value) + PROFILE_STDS * std
    return np.array([max(low, lowest), min(high, unknown.upper)])
