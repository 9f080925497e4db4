"""From runs with a container to the mass of the sphere that rolls in it, with an interval and a verdict.

Runs with the empty container (the baseline) are fitted together with the others: whatever is wrong with the shell's mass or with
the drive train is wrong in both, and falls out. Where there is no baseline the shell's mass must be stated.

The mass is searched for from several guesses of it and of where the sphere lay, on windows that grow with time, first with the
robot as its file or calibration states it. Then everything that is open moves under its prior, from every end that the first search
found. A bounce can make the last part of a run depend on its beginning so strongly that nothing can be identified from it: it is
left out as soon as the fit's own covariance no longer knows where the sphere is.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from proprio_ros.errors import ConfigurationError
from proprio_ros.identification import solvers
from proprio_ros.identification.calibration_fit import FRICTION_STARTS
from proprio_ros.identification.coefficients import reduced_model
from proprio_ros.identification.estimate import Estimate, Verdict, no_answer
from proprio_ros.identification.fit import (
    FitResult,
    SearchOptions,
    misfit_reason,
    other_suspects,
    rivals,
    solve_load,
    summary,
    unknown_rows,
)
from proprio_ros.identification.gates import (
    CONTRADICTION,
    MIN_USED,
    MISFIT_LIMIT,
    Contradiction,
    Findings,
    contradicting,
    contradiction,
    screen_run,
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
from proprio_ros.identification.posterior import Posterior
from proprio_ros.identification.prepared_runs import PreparedRun, joints_of, prepare_run
from proprio_ros.identification.reasons import Reason, of_run
from proprio_ros.identification.unknowns import Role
from proprio_ros.probes.container.detail import ContainerDetail, SpherePath
from proprio_ros.probes.container.problem import (
    LIGHTEST_KG,
    SIGNALS,
    ContainerFacts,
    ContainerProblem,
    SphereTrack,
    container_unknowns,
    sphere_run,
    start_prior,
)
from proprio_ros.quantity import Z95
from proprio_ros.records import Run
from proprio_ros.robot import Robot, motion
from proprio_ros.sim.joint import JointRun

STILL_M = 1e-3
"""A sphere that moves less was weighed like any load that does not move."""
LOST_SHARE = 0.25
"""Where the sphere is, is no longer known when its standard deviation passes this share of the room it has, .."""
LOST_GROWTH = 2.0
""".. and so many times what it was when the current came on: not to know where it lay is not chaos."""
UNPREDICTABLE = "the sphere's bounces made its place unpredictable"
EMPTY_SIGMAS = 3.0
"""How far from what was stated about it a baseline may be before it is not believed."""
DISTINCT = 0.03
"""Ends of the first search whose masses differ by less than this share, or by 0.1 g, are one."""
MOST_ENDS = 5
ALIKE_KG, ALIKE_SHARE = 1e-3, 0.1
"""Masses that differ by less, or by this share, do not contradict each other: where a sphere bounces and how it slips is not quite
what the law of contact says, which is worth so much in a single run. Half of the difference then counts as uncertainty."""
SAME_KG = 5e-4
"""A difference that is not worth a sentence."""
GUESSED_SHARE, GUESSED_PLACE_M = 0.1, 5e-3
"""How far off a size and a place may be that were not stated: standard deviations."""
STIFFER = 2.0
"""The contact's frequency is not known: the fit is repeated with so many times as much."""


@dataclass(frozen=True)
class ContainerOptions:
    """How to solve, and when to refuse.

    Attributes:
        integrator, step_s: see ``SphereSimulator``; with a sphere the step is what the contact needs, if that is shorter.
        starts_kg: first guesses of the sphere's mass.
        wide_share, wide_floor_kg: an answer whose half width exceeds this share of the value, and this mass, is ``too_wide``.
        signals: what runs that a camera saw are fitted to: ``"both"``, ``"joint"`` or ``"camera"``.
    """

    integrator: str = "rk4"
    step_s: float = 1.0 / 240.0
    starts_kg: tuple[float, ...] = (0.002, 0.006, 0.015, 0.04, 0.1)
    wide_share: float = 0.5
    wide_floor_kg: float = 0.005
    signals: str = "both"

    def __post_init__(self) -> None:
        if self.signals not in SIGNALS:
            raise ConfigurationError(f"solver.signals={self.signals!r}: choose one of {', '.join(SIGNALS)}")


@dataclass(frozen=True)
class ContainerRuns:
    """The runs of a fit.

    Attributes:
        runs: all of them, in any order.
        rolling: which have a sphere; tracks: what a camera saw of it, or None.
    """

    runs: tuple[PreparedRun, ...]
    rolling: tuple[bool, ...]
    tracks: tuple[SphereTrack | None, ...]

    def without(self, rows: Sequence[int]) -> ContainerRuns:
        """All but some."""
        kept = [row for row in range(len(self.runs)) if row not in rows]
        return ContainerRuns(
            tuple(self.runs[row] for row in kept),
            tuple(self.rolling[row] for row in kept),
            tuple(self.tracks[row] for row in kept),
        )


def find_sphere(
    robot: Robot,
    runs: Sequence[Run],
    facts: ContainerFacts,
    options: ContainerOptions | None = None,
    baseline: Sequence[Run] = (),
    tracks: Sequence[SphereTrack | None] = (),
) -> Estimate:
    """Identify the mass of the sphere that all ``runs`` share.

    Args:
        robot: model, drive trains and their uncertainty.
        runs: at least one, with the container and the sphere.
        facts: what is stated about both.
        options: solver and limits.
        baseline: runs with the empty container.
        tracks: what a camera saw in each of ``runs``, or nothing at all.

    Raises:
        ConfigurationError: neither a baseline nor the shell's mass.
        RecordingError: a run cannot be related to the robot at all.
    """
    options = options or ContainerOptions()
    check_shell(facts, baseline)
    found = Findings()
    usable: list[tuple[PreparedRun, bool, SphereTrack | None]] = []
    seen = tracks or [None] * len(runs)
    with_sphere = [(run, True, track) for run, track in zip(runs, seen, strict=True)]
    for run, rolls, track in [*with_sphere, *((run, False, None) for run in baseline)]:
        prepared = prepare_run(robot, run, None, facts.shell)
        problem = unusable(prepared)
        if problem:
            found.reasons.append(of_run(run.name, problem))
        else:
            usable.append((prepared, rolls, track))
        screen_run(robot, prepared, found)
    data = ContainerRuns(
        tuple(run for run, _, _ in usable),
        tuple(rolls for _, rolls, _ in usable),
        tuple(track for _, _, track in usable),
    )
    if not any(data.rolling):
        return no_answer("container", "sphere_mass", "kg", robot.name, len(runs), found.reasons, found.notes)
    if options.signals == "camera" and not any(data.tracks):
        raise ConfigurationError("solver.signals=camera needs what a camera saw: state sphere.camera")
    not_empty = ""
    if not all(data.rolling):
        empty, not_empty = _screen_baseline(robot, data, facts, options)
        facts = replace(facts, mass=empty)

    nominal, opened = fit_sphere(robot, data, facts, options)
    cut = lost_at(opened)
    if cut:
        cut_runs = list(data.runs)
        for row, used in cut.items():
            whole = cut_runs[row]
            found.reasons.append(
                f"{whole.run.name}: after {whole.times_s[used]:.2f} s the sphere's bounces make its place unpredictable; "
                f"{whole.used - used} later samples were left out"
            )
            cut_runs[row] = shortened(whole, used, UNPREDICTABLE)
        lost = [row for row in cut if cut_runs[row].used < MIN_USED]
        data = replace(data, runs=tuple(cut_runs)).without(lost)
        if not any(data.rolling):
            found.reasons.insert(
                0,
                "the sphere bounces too chaotically to determine its mass: tilt instead of shaking, or use less current",
            )
            return no_answer("container", "sphere_mass", "kg", robot.name, len(runs), found.reasons, found.notes)
        nominal = solve(robot, data, facts, options, Role.FROZEN)
        opened = solve(robot, data, facts, options, Role.FREE, nominal)
    return _conclude(robot, data, facts, options, nominal, opened, found, len(runs), not_empty)


def half_of(estimate: Estimate) -> float | None:
    """Half of the 95 % interval of an accepted sphere [kg]; None where it is not accepted."""
    std = estimate.value("sphere_mass").std
    return Z95 * std if estimate.verdict is Verdict.ACCEPTED and isinstance(std, float) else None


def check_shell(facts: ContainerFacts, baseline: Sequence[Run]) -> None:
    """Whether the shell is known at all.

    Raises:
        ConfigurationError: neither a baseline nor the shell's mass.
    """
    if not baseline and not np.isfinite(facts.mass_std):
        raise ConfigurationError(
            "a sphere cannot be separated from the container that holds it: give recordings of the empty container with "
            "--baseline, or its mass with --set container.mass=KG"
        )


def fit_sphere(
    robot: Robot, data: ContainerRuns, facts: ContainerFacts, options: ContainerOptions
) -> tuple[FitResult, FitResult]:
    """The fit with the robot as it is stated, and the one in which all that is open moves."""
    nominal = solve(robot, data, facts, options, Role.FROZEN)
    opened = solve(robot, data, facts, options, Role.FREE, nominal)
    if not opened.explains and not robot.is_calibrated(joints_of(data.runs)):
        again = solve(robot, data, facts, options, Role.FREE)
        opened = again if again.chi2 < opened.chi2 else opened
    return nominal, opened


def problem_of(
    robot: Robot,
    data: ContainerRuns,
    facts: ContainerFacts,
    options: ContainerOptions,
    role: Role,
) -> tuple[ContainerProblem, list[np.ndarray]]:
    """The problem, and the guesses of where the sphere lies in each run that has one."""
    priors = []
    for run, rolls in zip(data.runs, data.rolling, strict=True):
        if rolls:
            nothing = JointRun(run.times_s, run.run.input_times_s, run.run.input_current_A)
            priors.append(start_prior(sphere_run(robot, run, facts, nothing), facts, run.rest.value))
    unknowns = container_unknowns(robot, data.runs, data.rolling, facts, priors, role)
    problem = ContainerProblem(
        robot,
        data.runs,
        facts,
        data.rolling,
        unknowns,
        options.integrator,
        options.step_s,
        data.tracks,
        options.signals,
    )
    return problem, [prior.guesses for prior in priors]


def solve(
    robot: Robot,
    data: ContainerRuns,
    facts: ContainerFacts,
    options: ContainerOptions,
    role: Role,
    start: FitResult | None = None,
    rough: bool = False,
) -> FitResult:
    """Fit the runs from every guess, or from every end of another fit, which may have had fewer runs.

    ``rough`` is enough to choose the next run by, or to start another fit from.
    """
    problem, guesses = problem_of(robot, data, facts, options, role)
    free = list(problem.free)
    if start is not None:
        starts = _carried_over(start, problem)[:, free]
        if robot.calibration is None:
            starts = np.concatenate([starts, *_with_friction(problem, starts)])
        iterations, tolerance = (10, 0.03) if rough else (30, 1e-3)
        solution = solvers.levenberg_marquardt(
            problem,
            problem.coordinates.internal(starts),
            None,
            iterations=iterations,
            tolerance=tolerance,
            persistent=not rough,
        )
        return FitResult.of(problem, solution)
    # every guess of the place goes with every guess of the mass; runs take their n-th guess together
    places = max(len(guess) for guess in guesses)
    starts = np.tile(problem.base, (places * len(options.starts_kg), 1))
    starts[:, problem.index["sphere_mass"]] = np.tile(options.starts_kg, places)
    for row, guess in zip(np.flatnonzero(data.rolling).tolist(), guesses, strict=True):
        columns = [problem.index[f"sphere_{axis}", row] for axis in "xyz"]
        starts[:, columns] = np.repeat(guess[np.arange(places) % len(guess)], len(options.starts_kg), axis=0)
    internal = problem.coordinates.internal(starts[:, free])
    solution = solvers.levenberg_marquardt(
        problem, internal, problem.simulator.windows, window_iterations=3, iterations=12, tolerance=0.03
    )
    return FitResult.of(problem, solution)


def _carried_over(fit: FitResult, problem: ContainerProblem) -> np.ndarray:
    """The distinct ends of a fit as values of another problem's unknowns, shape (S, N); what the fit had not is at its prior."""
    ends = fit.problem.all_values(fit.problem.coordinates.physical(fit.solution.internal))[_distinct(fit)]
    values = np.tile(problem.base, (len(ends), 1))
    to = [row for row, unknown in enumerate(problem.unknowns) if unknown.key in fit.problem.index]
    values[:, to] = ends[:, [fit.problem.index[problem.unknowns[row].key] for row in to]]
    return values


def _with_friction(problem: ContainerProblem, starts: np.ndarray) -> list[np.ndarray]:
    """The same starts, shape (S, F), at other levels of a friction that nobody knows.

    From the file's zero the fit may end where torques that differ from run to run stand for friction, at another mass.
    """
    levels = []
    for level_N_m in FRICTION_STARTS:
        other = starts.copy()
        for column, row in enumerate(problem.free):
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
        if all(abs(masses[end] - masses[other]) > max(DISTINCT * abs(masses[other]), 1e-4) for other in kept):
            kept.append(int(end))
    return kept or [fit.solution.best]


def fit_empty(
    robot: Robot, empty: Sequence[PreparedRun], facts: ContainerFacts, options: ContainerOptions
) -> FitResult:
    """Weigh the empty container."""
    weighing = SearchOptions(integrator=options.integrator, step_s=options.step_s)
    nominal = solve_load(robot, empty, facts.shell, weighing, Role.FROZEN)
    still = solve_load(robot, empty, facts.shell, weighing, Role.FREE, start=nominal)
    if not still.explains:  # far from the file's values, as a robot that was never calibrated may be
        again = solve_load(robot, empty, facts.shell, weighing, Role.FREE)
        still = again if again.chi2 < still.chi2 else still
    return still


def _screen_baseline(
    robot: Robot,
    data: ContainerRuns,
    facts: ContainerFacts,
    options: ContainerOptions,
) -> tuple[float, str]:
    """What the empty container weighs, and why it may not have been empty (an empty string where all is well)."""
    baseline = data.without(np.flatnonzero(data.rolling).tolist())
    empty = baseline.runs
    still = fit_empty(robot, empty, facts, options)
    row = still.problem.index["payload_mass"]
    mass = float(still.values[row])
    std = float(np.sqrt(Posterior(still.problem, still.values).whole_covariance()[row, row]))
    names = ", ".join(run.run.name for run in empty)
    if not still.explains:
        unknown_mass = replace(facts, mass=mass, mass_std=np.inf)
        rolled = replace(baseline, rolling=(True,) * len(empty))
        moving = solve(robot, rolled, unknown_mass, options, Role.FROZEN)
        moving = solve(robot, rolled, unknown_mass, options, Role.FREE, moving)
        if moving.explains:
            inside = float(moving.values[moving.problem.index["sphere_mass"]])
            return mass, (
                f"the baseline was not empty: {names} is explained with {1e3 * inside:.1f} g rolling in the container, and not "
                "without; take it out and record the baseline again"
            )
        # a little coarser than the encoder is no sphere, and the fit of all runs is widened for it
        if still.reduced_chi2 > CONTRADICTION:
            return mass, (
                f"the baseline is not explained by an empty container (reduced chi-square {still.reduced_chi2:.1f}): was it empty, "
                "held as it is now, and has the robot changed since its calibration?"
            )
    if np.isfinite(facts.mass_std) and abs(mass - facts.mass) > EMPTY_SIGMAS * np.hypot(std, facts.mass_std):
        return mass, (
            f"the baseline was not empty, or container.mass is wrong: {names} says that the empty container weighs "
            f"{1e3 * mass:.1f} g, container.mass {1e3 * facts.mass:.1f} g"
        )
    return mass, ""


def lost_at(fit: FitResult) -> dict[int, int]:
    """Runs in which the sphere's place gets lost, and how many samples come before that."""
    problem = fit.problem
    assert isinstance(problem, ContainerProblem)
    covariance = Posterior(problem, fit.values).covariance
    cut: dict[int, int] = {}
    for row, (_, dx), run in zip(
        np.flatnonzero(problem.rolling), problem.path(fit.values, problem.free), problem.simulator.special.sphere_runs,
        strict=True,
    ):  # fmt: skip
        off = np.einsum("ij,kjf->kif", run.across, dx)
        std = np.sqrt(np.einsum("kif,fg,kig->ki", off, covariance, off).max(axis=1))
        used = known_until(std, problem.container)
        if used < len(std):
            cut[int(row)] = used
    return cut


def known_until(std: np.ndarray, facts: ContainerFacts) -> int:
    """How many samples come before the sphere's place is lost; std of it, shape (K,) [m]."""
    known = max(LOST_SHARE * 2.0 * facts.enclosure.room.min(), LOST_GROWTH * float(std[0]))
    lost = np.flatnonzero(~(std < known))
    return int(lost[0]) if len(lost) else len(std)


def shortened(run: PreparedRun, used: int, reason: str) -> PreparedRun:
    """The first samples of a run, and why no more."""
    return replace(run, used=used, sigma=run.sigma[:used], cut_reason=reason, hit_limit=False)


def _bounces(robot: Robot, data: ContainerRuns, facts: ContainerFacts, options: ContainerOptions) -> list[str]:
    """A sentence if the first halves of the runs are explained, and only what comes after is not."""
    halves = tuple(
        shortened(run, (run.used + 1) // 2, run.cut_reason) if rolls else run
        for run, rolls in zip(data.runs, data.rolling, strict=True)
    )
    if min(run.used for run, rolls in zip(halves, data.rolling, strict=True) if rolls) < MIN_USED:
        return []
    early = replace(data, runs=halves)
    fit = solve(robot, early, facts, options, Role.FREE, solve(robot, early, facts, options, Role.FROZEN))
    if not fit.explains:
        return []
    mass = float(fit.values[fit.problem.index["sphere_mass"]])
    return [
        f"the first half of the runs is explained, with {1e3 * mass:.1f} g, and what comes after is not: the sphere bounces "
        "otherwise than the law of contact says; tilt instead of shaking, use less current, or make the probe shorter"
    ]


def _stiffness_shift(
    robot: Robot,
    data: ContainerRuns,
    facts: ContainerFacts,
    options: ContainerOptions,
    fit: FitResult,
    posterior: Posterior,
) -> float:
    """By how much the mass would follow if a touch were ``STIFFER`` times as quick [kg]."""
    harder = replace(facts, contact_frequency=STIFFER * facts.contact_frequency, k_e=STIFFER**2 * facts.k_e)
    other, _ = problem_of(robot, data, harder, options, Role.FREE)
    return _shift(data, other, fit.values.copy(), fit, posterior)


def _guesses(
    robot: Robot,
    data: ContainerRuns,
    facts: ContainerFacts,
    options: ContainerOptions,
    fit: FitResult,
    posterior: Posterior,
) -> list[Guess]:
    """The facts that were not stated, and what being off by their spread would do to the mass."""
    if not facts.guessed or not np.isfinite(fit.chi2):
        return []
    enclosure = facts.enclosure
    listed: dict[str, tuple[str, str, list[ContainerFacts]]] = {
        "container.inner_size": (
            " x ".join(f"{1e3 * edge:g}" for edge in enclosure.inner_size) + " mm",
            f"{100.0 * GUESSED_SHARE:g} % per side",
            [
                replace(
                    facts, enclosure=replace(enclosure, inner_size=enclosure.inner_size * (1.0 + GUESSED_SHARE * axis))
                )
                for axis in _sides(enclosure.shape)
            ],
        ),
        "container.centre": (
            f"[{', '.join(f'{1e3 * place:g}' for place in facts.centre)}] mm",
            f"{1e3 * GUESSED_PLACE_M:g} mm per axis",
            [replace(facts, centre=facts.centre + GUESSED_PLACE_M * axis) for axis in np.eye(3)],
        ),
        "sphere.radius": (
            f"{1e3 * enclosure.radius:g} mm",
            f"{100.0 * GUESSED_SHARE:g} %",
            # the smaller one: a larger one may not fit
            [replace(facts, enclosure=replace(enclosure, radius=enclosure.radius * (1.0 - GUESSED_SHARE)))],
        ),
    }
    own = fit.problem.unknowns
    guesses = []
    for key in facts.guessed:
        taken, spread, others = listed[key]
        shifts = []
        for changed in others:
            other, _ = problem_of(robot, data, changed, options, Role.FREE)
            values = other.base.copy()
            values[fit.problem.free] = fit.values[fit.problem.free]
            for row in np.flatnonzero(data.rolling).tolist():  # where it lay moves with the walls
                for at in (other.index[f"sphere_{axis}", row] for axis in "xyz"):
                    values[at] = fit.values[at] + other.unknowns[at].value - own[at].value
            shifts.append(_shift(data, other, values, fit, posterior))
        guesses.append(Guess(key, taken, spread, float(np.linalg.norm(shifts))))
    return guesses


def _sides(shape: str) -> np.ndarray:
    """Which edges of a container's inside change together, shape (S, 3)."""
    sides = {"sphere": [[1, 1, 1]], "cylinder": [[1, 1, 0], [0, 0, 1]]}
    return np.array(sides.get(shape, np.eye(3)), dtype=float)


def _shift(
    data: ContainerRuns, other: ContainerProblem, values: np.ndarray, fit: FitResult, posterior: Posterior
) -> float:
    """By how much the mass would follow another problem that gets these values of all unknowns, to first order [kg]."""
    for row in np.flatnonzero(data.rolling).tolist():  # rest is less deep in a harder wall
        for axis in "xyz":
            unknown = other.unknowns[other.index[f"sphere_{axis}", row]]
            values[other.index[unknown.key]] = np.clip(values[other.index[unknown.key]], unknown.lower, unknown.upper)
    soft, _, _ = fit.problem.simulate(fit.values[None], fit.problem.free[:1])
    hard, _, _ = other.simulate(values[None], other.free[:1])
    seen = fit.problem.weight > 0.0
    off = ((soft - hard)[0] * fit.problem.weight)[seen]
    return float((posterior.covariance @ posterior.sensitivity.T @ off)[fit.column("sphere_mass")])


def _apart(
    robot: Robot, data: ContainerRuns, facts: ContainerFacts, options: ContainerOptions, outlier: int, mass: float
) -> Contradiction:
    """What a run says that the others predict badly; ``mass`` is what all of them say together [kg]."""
    name = data.runs[outlier].run.name
    rolling = np.flatnonzero(data.rolling).tolist()
    others = [row for row in rolling if row != outlier]
    if not data.rolling[outlier] or not others:
        return Contradiction(
            Reason(
                "runs_contradict",
                f"{name} contradicts the other runs ({1e3 * mass:.1f} g together): was the same sphere in the same container, held "
                "in the same place, and the baseline empty?",
            )
        )
    masses = []
    for left_out in (others, [outlier]):  # each with the empty container's runs
        part = data.without(left_out)
        fit = solve(robot, part, facts, options, Role.FREE, solve(robot, part, facts, options, Role.FROZEN))
        masses.append(float(fit.values[fit.problem.index["sphere_mass"]]))
    question = "was the same sphere in the same container, held in the same place?"
    return contradiction(name, "kg", masses[0], masses[1], max(ALIKE_SHARE * abs(mass), ALIKE_KG), SAME_KG, question)


def _conclude(
    robot: Robot,
    data: ContainerRuns,
    facts: ContainerFacts,
    options: ContainerOptions,
    nominal: FitResult,
    fit: FitResult,
    found: Findings,
    run_count: int,
    not_empty: str,
) -> Estimate:
    problem = fit.problem
    assert isinstance(problem, ContainerProblem)
    runs = data.runs
    known = robot.is_calibrated(joints_of(runs))
    shell = problem.index["payload_mass"]
    assessed = Assessment(fit, "sphere_mass", runs, known)
    mass = assessed.value
    budget = assessed.budget()
    shift = _stiffness_shift(robot, data, facts, options, fit, assessed.posterior)
    assessed.widen(shift)
    guesses = _guesses(robot, data, facts, options, fit, assessed.posterior)
    for guess in guesses:
        assessed.widen(guess.std)
    # two more fits, which a fit that is refused for a worse reason is spared
    judged = len(runs) > 1 and not fit.explains and np.isfinite(fit.chi2) and not not_empty
    outlier = contradicting(Posterior(problem, fit.values)) if judged else None
    apart = None if outlier is None else _apart(robot, data, facts, options, outlier, mass)
    if apart is not None and apart.half is not None:
        assessed.widen(apart.half)
    budget += [("contact stiffness", abs(shift)), *((f"{guess.key}, guessed", guess.std) for guess in guesses)]
    budget = sorted(budget, key=lambda entry: -entry[1])
    std = assessed.std
    paths = _paths(robot, fit, assessed.covariance)

    def refusals() -> Iterator[Refusal]:
        if not np.isfinite(fit.chi2):
            unsimulated = "no guess of the mass could be simulated"
            sizes = ": check container.inner_size, sphere.radius and the robot file's inertias"
            yield rejected("unsimulated", unsimulated, unsimulated + sizes)
        if not_empty:
            yield rejected("baseline_not_empty", "the baseline contradicts what was stated", not_empty)
        yield from contradicted(apart)
        if fit.reduced_chi2 > MISFIT_LIMIT:
            suspects = _bounces(robot, data, facts, options) or other_suspects(robot)
            misfit = misfit_reason(assessed.rms, assessed.expected, mass, fit.reduced_chi2)
            yield rejected("misfit", "the model does not explain the recording", misfit, *suspects)
        if mass + Z95 * std < 0.0:
            yield rejected(
                "lighter_than_empty",
                "the container seems lighter than empty",
                f"the container seems {-1e3 * mass:.1f} g lighter than it was empty: was the baseline empty, and held in the same "
                "place?",
            )
        if others := rivals(fit, "sphere_mass", mass, std, DISTINCT):
            yield not_identifiable(
                "several_values",
                "more than one mass explains the recording",
                "more than one mass explains the recording: "
                + ", ".join(f"{1e3 * m:.1f} g" for m in sorted((mass, *others)))
                + "; record a run with another tilt, or state sphere.start",
            )

    def remarks() -> Iterator[str]:
        if mass - Z95 * std <= 0.0:
            yield (
                f"the container may as well be empty: a sphere of up to {1e3 * max(mass + Z95 * std, 0.0):.1f} g would not show"
            )
        elif all(path.moved < STILL_M for path in paths):
            yield (
                f"the sphere did not move by more than {1e3 * max(path.moved for path in paths):.1f} mm in any run, so it was "
                "weighed like a fixed load: that it rolls is not confirmed; tilt further to see it roll"
            )

    if np.isfinite(seen := problem.camera_rms(fit.values)):
        found.notes.append(
            f"the simulated sphere is {1e3 * seen:.1f} mm rms from where the camera saw it"
            + (", which alone was fitted" if options.signals == "camera" else "")
        )
    shown = {"payload_mass": "container_mass"}
    shell_mass, shell_std = float(fit.values[shell]), float(np.sqrt(assessed.covariance[shell, shell]))
    best = float(nominal.physical("sphere_mass")[nominal.solution.best])
    return judge(
        robot,
        assessed,
        refusals(),
        found,
        probe="container",
        run_count=run_count,
        values=lambda withheld: (
            positive("sphere_mass", "kg", mass, std, withheld),
            positive("container_mass", "kg", shell_mass, shell_std, withheld),
        ),
        solver=summary(
            nominal, "sphere_mass", options.starts_kg, max(1e-4, DISTINCT * abs(best), std),
            nominal.solution.iterations + fit.solution.iterations,
            SearchOptions(integrator=options.integrator, step_s=problem.contact_step_s),
            final=fit,
        ),
        budget=[(shown.get(name, name), share) for name, share in budget],
        assumptions=_assumptions(robot, facts, options, fit, not all(data.rolling)),
        apart=apart,
        remarks=lambda: tuple(remarks()),
        open_drive_train=budget,
        useful=Useful(options.wide_share, options.wide_floor_kg),
        guesses=guesses,
        unknowns=tuple(
            replace(u, kind=shown.get(u.kind, u.kind)) for u in unknown_rows(fit, assessed.covariance)
        ),
        detail=lambda withheld: ContainerDetail(paths),
    )  # fmt: skip


def _paths(robot: Robot, fit: FitResult, covariance: np.ndarray) -> tuple[SpherePath, ...]:
    problem = fit.problem
    assert isinstance(problem, ContainerProblem)
    free = problem.free
    own = covariance[np.ix_(free, free)]
    rows = np.flatnonzero(problem.rolling)
    enclosure = problem.container.enclosure
    shown, _, _ = problem.simulate(fit.values[None], free[:1])
    paths = []
    for row, (x, dx), run in zip(
        rows, problem.path(fit.values, free), problem.simulator.special.sphere_runs, strict=True
    ):
        prepared = problem.runs[row]
        model = reduced_model(robot, prepared.run, {})
        body_from_container = model.frames[robot.payload_frame][1][:3, :3] @ problem.container.rotation
        turns = [
            model.placement[0][:3, :3] @ motion(model.kinds[0], model.axes[0], float(q))[:3, :3] @ body_from_container
            for q in shown[0, row, : prepared.used]
        ]
        paths.append(
            SpherePath(
                prepared.run.name,
                enclosure.shape,
                enclosure.inner_size,
                enclosure.radius,
                prepared.times_s,
                x,
                np.sqrt(np.einsum("kif,fg,kig->ki", dx, own, dx)),
                np.array(turns),
                run.axis,
            )
        )
    return tuple(paths)


def _assumptions(
    robot: Robot, facts: ContainerFacts, options: ContainerOptions, fit: FitResult, baseline: bool
) -> tuple[str, ...]:
    place = ", ".join(f"{1e3 * c:g}" for c in facts.centre)
    problem = fit.problem
    assert isinstance(problem, ContainerProblem)
    where = "lay still in the lowest place" if facts.settled else "may have been anywhere in it"
    if facts.start is not None:
        where = f"lay at [{', '.join(f'{1e3 * c:g}' for c in facts.start)}] +- {1e3 * facts.start_std:g} mm"
    constants = (
        f"{facts.contact_frequency:g} rad/s, damping ratio {facts.damping_ratio.value:g} +- {facts.damping_ratio.std:g}"
        if facts.law == "ramped"
        else f"k_e {facts.k_e:g} N/m, k_d {facts.k_d:g} N s/m, k_f {facts.k_f:g} N s/m, for {1e3 * LIGHTEST_KG:g} g or more"
    )
    return (
        f"the container is {facts.shell.shape.description}, its centre at [{place}] mm in {robot.payload_frame}; its mass was "
        + ("taken from the empty-container runs" if baseline else "stated"),
        f"a {'solid' if facts.enclosure.inertia_factor == 0.4 else 'hollow'} sphere of radius {1e3 * facts.enclosure.radius:g} mm "
        f"that {where} when the current came on",
        f"law of contact {facts.law}: {constants}, friction {facts.friction.value:g} +- {facts.friction.std:g}",
        f"integrator {options.integrator}, steps of at most {1e3 * problem.contact_step_s:.3g} ms, as the contact needs them",
        f"robot file {robot.source.name}, " + ("calibrated" if robot.is_calibrated() else "not calibrated"),
    )
