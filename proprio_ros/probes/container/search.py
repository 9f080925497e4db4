"""The search for a sphere in a container: guesses of its mass and of where it lay, and from where on a run tells nothing."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from proprio_ros.errors import ConfigurationError
from proprio_ros.identification import solvers
from proprio_ros.identification.calibration_fit import FRICTION_STARTS
from proprio_ros.identification.estimate import WIDEST_FLOOR_KG, WIDEST_SHARE
from proprio_ros.identification.fit import (
    FitResult,
    SearchOptions,
    fit_both,
    solve_load,
    unexplained,
)
from proprio_ros.identification.gates import MIN_USED
from proprio_ros.identification.posterior import Posterior
from proprio_ros.identification.prepared_runs import PreparedRun
from proprio_ros.identification.unknowns import Role
from proprio_ros.probes.container.problem import (
    SIGNALS,
    ContainerFacts,
    ContainerProblem,
    SphereTrack,
    container_unknowns,
    sphere_run,
    start_prior,
)
from proprio_ros.records import Run
from proprio_ros.robot import Robot
from proprio_ros.sim.joint import JointRun

LOST_SHARE = 0.25
"""Where the sphere is, is no longer known when its standard deviation passes this share of the room it has, .."""
# .. and so many times what it was when the current came on: not to know where it lay is not chaos.
LOST_GROWTH = 2.0
UNPREDICTABLE = "the sphere's bounces made its place unpredictable"
# ends of the first search whose masses differ by less than this share, or by 0.1 g, are one
DISTINCT = 0.03
MOST_ENDS = 5


@dataclass(frozen=True)
class ContainerOptions:
    """How to solve, and when to refuse."""

    # integrator, step_s: see ``SphereSimulator``; with a sphere the step is what the contact needs, if that is shorter
    integrator: str = "rk4"
    step_s: float = 1.0 / 240.0
    # first guesses of the sphere's mass
    starts_kg: tuple[float, ...] = (0.002, 0.006, 0.015, 0.04, 0.1)
    # wide_share, wide_floor_kg: an answer whose half width exceeds this share of the value, and this mass, is ``too_wide``
    wide_share: float = WIDEST_SHARE
    wide_floor_kg: float = WIDEST_FLOOR_KG
    signals: str = "both"  # what runs that a camera saw are fitted to, one of ``SIGNALS``

    def __post_init__(self) -> None:
        if self.signals not in SIGNALS:
            raise ConfigurationError(
                f"solver.signals={self.signals!r}: choose one of {', '.join(SIGNALS)}"
            )


@dataclass(frozen=True)
class SphereSearch:
    """Runs that are fitted together, and how; ``rolling`` is which have a sphere, ``tracks`` what a camera saw of it."""

    robot: Robot
    facts: ContainerFacts
    options: ContainerOptions
    runs: tuple[PreparedRun, ...] = ()
    rolling: tuple[bool, ...] = ()
    tracks: tuple[SphereTrack | None, ...] = ()

    def added(
        self, run: PreparedRun, rolls: bool, track: SphereTrack | None = None
    ) -> SphereSearch:
        """With another run.

        Args:
            run: Prepared.
            rolls: Whether it has a sphere.
            track: What a camera saw of it.
        """
        return replace(
            self,
            runs=(*self.runs, run),
            rolling=(*self.rolling, rolls),
            tracks=(*self.tracks, track),
        )

    def without(self, rows: Sequence[int]) -> SphereSearch:
        """All runs but some."""
        search = replace(self, runs=(), rolling=(), tracks=())
        for row, made in enumerate(zip(self.runs, self.rolling, self.tracks, strict=True)):
            search = search if row in rows else search.added(*made)
        return search

    def before_lost(
        self,
        cut: Mapping[int, int],
    ) -> tuple[SphereSearch, list[int]]:
        """The runs up to where `lost_at` says that the sphere's place gets lost, and which are too short then and left out."""
        runs = [
            shortened(run, cut[row], UNPREDICTABLE) if row in cut else run
            for row, run in enumerate(self.runs)
        ]
        lost = [row for row in cut if runs[row].used < MIN_USED]
        return replace(self, runs=tuple(runs)).without(lost), lost

    def problem(self, role: Role) -> tuple[ContainerProblem, list[np.ndarray]]:
        """The problem, and the guesses of where the sphere lies in each run that has one."""
        robot = self.robot
        runs = self.runs
        facts = self.facts
        rolling = self.rolling
        options = self.options
        priors = []
        for run in itertools.compress(runs, rolling):
            nothing = JointRun(run.times_s, run.run.input_times_s, run.run.input_current_A)
            priors.append(
                start_prior(sphere_run(robot, run, facts, nothing), facts, run.rest.value)
            )
        unknowns = container_unknowns(
            robot,
            runs,
            rolling,
            facts,
            priors,
            role,
        )
        steps = (options.integrator, options.step_s)
        seen = (self.tracks, options.signals)
        problem = ContainerProblem(robot, runs, facts, rolling, unknowns, *steps, *seen)
        return problem, [prior.guesses for prior in priors]

    def solve(
        self,
        role: Role,
        start: FitResult | None = None,
        rough: bool = False,
    ) -> FitResult:
        """Fit the runs from every guess, or from every end of another fit, which may have had fewer runs.

        Args:
            role: What the recording may move of the robot and of the contact.
            start: Another fit.
            rough: Enough to choose the next run by, or to start another fit from.
        """
        problem, guesses = self.problem(role)
        estimated = list(problem.estimated)
        if start is not None:
            starts = _carried_over(start, problem)[:, estimated]
            if self.robot.calibration is None:
                starts = np.concatenate([starts, *_with_friction(problem, starts)])
            solution = solvers.levenberg_marquardt(
                problem,
                problem.coordinates.internal(starts),
                None,
                iterations=10 if rough else 30,
                tolerance=0.03 if rough else 1e-3,
                persistent=not rough,
            )
            return FitResult.of(problem, solution)
        # every guess of the place goes with every guess of the mass; runs take their n-th guess together
        masses = self.options.starts_kg
        places = max(len(guess) for guess in guesses)
        starts = np.tile(problem.base, (places * len(masses), 1))
        starts[:, problem.index["sphere_mass"]] = np.tile(masses, places)
        for row, guess in zip(np.flatnonzero(self.rolling).tolist(), guesses, strict=True):
            columns = [problem.index[f"sphere_{axis}", row] for axis in "xyz"]
            starts[:, columns] = np.repeat(
                guess[np.arange(places) % len(guess)], len(masses), axis=0
            )
        internal = problem.coordinates.internal(starts[:, estimated])
        solution = solvers.levenberg_marquardt(
            problem,
            internal,
            problem.simulator.windows,
            window_iterations=3,
            iterations=12,
            tolerance=0.03,
        )
        return FitResult.of(problem, solution)

    def fits(self) -> tuple[FitResult, FitResult]:
        """The fit with the robot as it is stated, and the one in which all that is open moves."""
        return fit_both(self.solve, unexplained)


def _carried_over(fit: FitResult, problem: ContainerProblem) -> np.ndarray:
    """The distinct ends of a fit as values of another problem's unknowns, shape (S, N); what the fit had not is at its prior."""
    ends = fit.problem.all_values(fit.problem.coordinates.physical(fit.solution.internal))[
        _distinct(fit)
    ]
    values = np.tile(problem.base, (len(ends), 1))
    there = fit.problem.index
    for row, unknown in enumerate(problem.unknowns):
        if unknown.key in there:
            values[:, row] = ends[:, there[unknown.key]]
    return values


def _with_friction(problem: ContainerProblem, starts: np.ndarray) -> list[np.ndarray]:
    """The same starts, shape (S, F), at other levels of a friction that nobody knows.

    From the file's zero the fit may end where torques that differ from run to run stand for friction, at another mass.
    """
    levels = []
    for level_N_m in FRICTION_STARTS:
        other = starts.copy()
        for column, row in enumerate(problem.estimated):
            unknown = problem.unknowns[row]
            if unknown.kind == "coulomb" and unknown.value < level_N_m:
                other[:, column] = min(level_N_m, unknown.value + 2.0 * unknown.std)
        levels.append(other)
    return levels


def _distinct(fit: FitResult) -> list[int]:
    """The best ends of a search, each mass once."""
    masses = fit.physical("sphere_mass")
    kept: list[int] = []
    for end in np.argsort(fit.solution.cost):
        if not np.isfinite(fit.solution.cost[end]) or len(kept) == MOST_ENDS:
            break
        others = masses[kept]
        least = np.maximum(DISTINCT * np.abs(others), 1e-4)
        if np.all(np.abs(masses[end] - others) > least):
            kept.append(int(end))
    return kept or [fit.solution.best]


def fit_empty(
    robot: Robot, empty: Sequence[PreparedRun], facts: ContainerFacts, options: ContainerOptions
) -> FitResult:
    """Weigh the empty container.

    Args:
        robot: As its file or its calibration states it.
        empty: Runs with it, prepared.
        facts: Of its shell.
        options: Of which integrator and step count.
    """
    weighing = SearchOptions(integrator=options.integrator, step_s=options.step_s)
    return fit_both(partial(solve_load, robot, empty, facts.shell, weighing), unexplained)[1]


def check_shell(facts: ContainerFacts, baseline: Sequence[Run]) -> None:
    """Refuse a container of which neither a baseline nor the shell's mass is known.

    Raises:
        ConfigurationError: That is so.
    """
    if not baseline and not np.isfinite(facts.mass_std):
        raise ConfigurationError(
            "a sphere cannot be separated from the container that holds it: give recordings of the empty container with "
            "--baseline, or its mass with --set container.mass=KG"
        )


def lost_at(fit: FitResult) -> dict[int, int]:
    """Runs in which the sphere's place gets lost, and how many samples come before that."""
    problem = fit.problem
    assert isinstance(problem, ContainerProblem)
    covariance = Posterior(problem, fit.values).covariance
    cut: dict[int, int] = {}
    rows = np.flatnonzero(problem.rolling)
    paths = problem.path(fit.values, problem.estimated)
    for row, (_, dx), run in zip(rows, paths, problem.simulator.special.sphere_runs, strict=True):
        off = np.einsum("ij,kjf->kif", run.across, dx)
        std = np.sqrt(np.einsum("kif,fg,kig->ki", off, covariance, off).max(axis=1))
        used = known_until(std, problem.container)
        if used < len(std):
            cut[int(row)] = used
    return cut


def known_until(std: np.ndarray, facts: ContainerFacts) -> int:
    """How many samples come before the sphere's place is lost, whose standard deviation is `std` [m], (K,)."""
    widest = max(
        LOST_SHARE * 2.0 * facts.enclosure.room.min(),
        LOST_GROWTH * float(std[0]),
    )
    lost = np.flatnonzero(~(std < widest))  # NaN is lost, too
    return int(lost[0]) if len(lost) else len(std)


def shortened(run: PreparedRun, used: int, reason: str) -> PreparedRun:
    """The first samples of a run.

    Args:
        run: Prepared.
        used: How many are kept.
        reason: Why no more.
    """
    return replace(
        run,
        used=used,
        sigma=run.sigma[:used],
        cut_reason=reason,
    )
