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
from functools import cached_property
from types import MappingProxyType

import numpy as np

from proprio_ros.errors import ConfigurationError
from proprio_ros.identification.coefficients import reduced_model
from proprio_ros.identification.conclude import Conclusion, stated_in
from proprio_ros.identification.estimate import (
    Estimate,
    SolverSummary,
    Value,
    Verdict,
    WidthLimit,
    no_answer,
    not_negative,
)
from proprio_ros.identification.fit import FitResult, SearchOptions, fit_opened, summary
from proprio_ros.identification.gates import (
    CONTRADICTION,
    MIN_USED,
    Findings,
    RunComparison,
    admitted,
    compare_run,
)
from proprio_ros.identification.judge import (
    Guess,
    Refusal,
    positive,
    rejected,
)
from proprio_ros.identification.prepared_runs import PreparedRun, prepare_run
from proprio_ros.identification.reasons import Reason
from proprio_ros.identification.unknowns import Role
from proprio_ros.probes.container.detail import ContainerDetail, SpherePath
from proprio_ros.probes.container.problem import (
    LIGHTEST_KG,
    ContainerFacts,
    ContainerProblem,
    SphereTrack,
)
from proprio_ros.probes.container.search import (
    DISTINCT,
    ContainerOptions,
    SphereSearch,
    check_shell,
    fit_empty,
    lost_at,
    shortened,
)
from proprio_ros.quantity import Z95
from proprio_ros.records import Run
from proprio_ros.robot import Robot, motion

STILL_M = 1e-3  # a sphere that moves less was weighed like any load that does not move
# how far from what was stated about it a baseline may be before it is not believed
EMPTY_SIGMAS = 3.0
ALIKE_KG, ALIKE_SHARE = 1e-3, 0.1
"""Masses that differ by less, or by this share, do not contradict each other: where a sphere bounces and how it slips is not quite
what the law of contact says, which is worth so much in a single run. Half of the difference then counts as uncertainty."""
SAME_KG = 5e-4  # a difference that is not worth a sentence
GUESSED_SHARE, GUESSED_PLACE_M = 0.1, 5e-3
"""How far off a size and a place may be that were not stated: standard deviations."""
# the contact's frequency is not known: the fit is repeated with so many times as much
STIFFER = 2.0


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
        robot: As its file or its calibration states it.
        runs: With the sphere.
        facts: Of the container and the sphere.
        options: Of the solver.
        baseline: Runs with the empty container.
        tracks: What a camera saw in each of the ``runs``, or nothing at all.

    Raises:
        ConfigurationError: Neither a baseline nor the shell's mass.
        RecordingError: A run cannot be related to the robot at all.
    """
    options = options or ContainerOptions()
    check_shell(facts, baseline)
    found = Findings()
    search = SphereSearch(robot, facts, options)
    rolling = [True] * len(runs) + [False] * len(baseline)
    seen = list(tracks or [None] * len(runs)) + [None] * len(baseline)
    every = [*runs, *baseline]
    for run, rolls, track in zip(every, rolling, seen, strict=True):
        prepared = prepare_run(robot, run, None, facts.shell)
        if admitted(robot, prepared, found):
            search = search.added(prepared, rolls, track)
    if not any(search.rolling):
        return _no_answer(robot, len(runs), found)
    if options.signals == "camera" and not any(search.tracks):
        raise ConfigurationError(
            "solver.signals=camera needs what a camera saw: state sphere.camera"
        )
    against: list[Refusal] = []
    if not all(search.rolling):
        empty, against = _screen_baseline(search)
        search = replace(search, facts=replace(facts, mass=empty))

    nominal, opened = search.fits()
    cut = lost_at(opened)
    if cut:
        for row, used in cut.items():
            whole = search.runs[row]
            found.reasons.append(
                f"{whole.run.name}: after {whole.times_s[used]:.2f} s the sphere's bounces make its place unpredictable; "
                f"{whole.used - used} later samples were left out"
            )
        search, _ = search.before_lost(cut)
        if not any(search.rolling):
            better = "tilt instead of shaking, or use less current"
            found.reasons.insert(
                0, f"the sphere bounces too chaotically to determine its mass: {better}"
            )
            return _no_answer(robot, len(runs), found)
        nominal, opened = search.fits()
    return (
        WeighedSphere(
            nominal,
            opened,
            found,
            len(runs),
            search,
            against=against,
        )
        .with_own_scatter()
        .estimate()
    )


def _no_answer(robot: Robot, run_count: int, found: Findings) -> Estimate:
    return no_answer(
        "container", "sphere_mass", "kg", robot.name, run_count, found.reasons, found.notes
    )


def half_of(estimate: Estimate) -> float | None:
    """Half of the 95 % interval of an accepted sphere [kg]; None where it is not accepted."""
    std = estimate.value("sphere_mass").std
    return Z95 * std if estimate.verdict is Verdict.ACCEPTED and isinstance(std, float) else None


def _screen_baseline(search: SphereSearch) -> tuple[float, list[Refusal]]:
    """What the empty container weighs [kg], and why it may not have been empty."""
    facts = search.facts
    baseline = search.without(np.flatnonzero(search.rolling).tolist())
    empty = baseline.runs
    still = fit_empty(search.robot, empty, facts, search.options)
    mass, std = still.determined("payload_mass")
    names = ", ".join(run.run.name for run in empty)
    not_empty = ""
    moving = None
    if not still.explains:
        unknown_mass = replace(facts, mass=mass, mass_std=np.inf)
        moving = fit_opened(
            replace(baseline, facts=unknown_mass, rolling=(True,) * len(empty)).solve
        )
    if moving is not None and moving.explains:
        not_empty = (
            f"the baseline was not empty: {names} is explained with {1e3 * moving.value_of('sphere_mass'):.1f} g rolling in the "
            "container, and not without; take it out and record the baseline again"
        )
    # a little coarser than the encoder is no sphere, and the fit of all runs is widened for it
    elif moving is not None and still.reduced_chi2 > CONTRADICTION:
        not_empty = (
            f"the baseline is not explained by an empty container (reduced chi-square {still.reduced_chi2:.1f}): was it empty, "
            "held as it is now, and has the robot changed since its calibration?"
        )
    elif np.isfinite(facts.mass_std) and abs(mass - facts.mass) > EMPTY_SIGMAS * np.hypot(
        std, facts.mass_std
    ):
        not_empty = (
            f"the baseline was not empty, or container.mass is wrong: {names} says that the empty container weighs "
            f"{1e3 * mass:.1f} g, container.mass {1e3 * facts.mass:.1f} g"
        )
    withheld = "the baseline contradicts what was stated"
    return mass, [rejected("baseline_not_empty", withheld, not_empty)] if not_empty else []


def compared(name: str, one: float, others: float, together: float) -> RunComparison:
    """What a run says of the mass against what the others say.

    Args:
        name: Of the run.
        one: What it says [kg].
        others: What the others say [kg].
        together: What all of them say [kg].
    """
    question = "was the same sphere in the same container, held in the same place?"
    alike = max(ALIKE_SHARE * abs(together), ALIKE_KG)
    return compare_run(name, "kg", one, others, alike, SAME_KG, question)


@dataclass(eq=False)
class WeighedSphere(Conclusion):
    """What a fit says about the mass of a sphere; ``search`` has the runs that were fitted, and how."""

    search: SphereSearch

    probe = "container"
    name = "sphere_mass"
    check = "check container.inner_size, sphere.radius and the robot file's inertias"
    called = MappingProxyType({"payload_mass": "container_mass"})

    def __post_init__(self) -> None:
        super().__post_init__()
        assert isinstance(self.opened.problem, ContainerProblem)
        self.problem = self.opened.problem
        self.search = replace(self.search, robot=self.robot)
        self.facts = self.search.facts
        self.rolling = np.flatnonzero(self.search.rolling).tolist()

    def fitted_with(self, robot: Robot, start: FitResult) -> FitResult:
        return replace(self.search, robot=robot).solve(Role.ESTIMATED, start)

    def starts(self) -> Sequence[FitResult]:
        # another end of the search may be the best with another spread
        return self.opened, self.nominal

    def widen(self) -> None:
        seen_m = self.problem.camera_rms(self.fit.values)
        if np.isfinite(seen_m):
            alone = ", which alone was fitted" if self.search.options.signals == "camera" else ""
            self.found.notes.append(
                f"the simulated sphere is {1e3 * seen_m:.1f} mm rms from where the camera saw it{alone}"
            )
        # by how much the mass would follow if a touch were quicker
        facts = self.facts
        harder = replace(
            facts, contact_frequency=STIFFER * facts.contact_frequency, k_e=STIFFER**2 * facts.k_e
        )
        self.count(
            self._shift(self._with(harder), self.fit.values.copy()),
            "contact stiffness",
        )

    def guess(self) -> list[Guess]:
        """The facts that were not stated, and what being off by their spread would do to the mass."""
        enclosure = self.facts.enclosure
        share = f"{100.0 * GUESSED_SHARE:g} %"
        edges = " x ".join(f"{1e3 * edge:g}" for edge in enclosure.inner_size)
        centre = ", ".join(f"{1e3 * place:g}" for place in self.facts.centre)
        words = {
            "container.inner_size": (f"{edges} mm", f"{share} per side"),
            "container.centre": (f"[{centre}] mm", f"{1e3 * GUESSED_PLACE_M:g} mm per axis"),
            "sphere.radius": (f"{1e3 * enclosure.radius:g} mm", share),
        }
        guesses = []
        for key in self.facts.guessed:
            shifts = []
            for changed in _off_by_its_spread(self.facts, key):
                other = self._with(changed)
                values = other.base.copy()
                values[self.problem.estimated] = self.fit.values[self.problem.estimated]
                for at in self._start_rows(other):
                    # where it lay moves with the walls
                    values[at] = (
                        self.fit.values[at]
                        + other.unknowns[at].value
                        - self.problem.unknowns[at].value
                    )
                shifts.append(self._shift(other, values))
            guesses.append(
                Guess(
                    key,
                    *words[key],
                    float(np.linalg.norm(shifts)),
                )
            )
        return guesses

    def _start_rows(self, problem: ContainerProblem) -> list[int]:
        """The unknowns of a problem that say where the sphere lay."""
        rows = []
        for row in self.rolling:
            rows += [problem.index[f"sphere_{axis}", row] for axis in "xyz"]
        return rows

    def _with(self, facts: ContainerFacts) -> ContainerProblem:
        """The problem under other facts."""
        return replace(self.search, facts=facts).problem(Role.ESTIMATED)[0]

    @cached_property
    def _shown(self) -> np.ndarray:
        """What the encoders show as the fit has it, shape (1, R, T)."""
        return self.problem.simulate(self.fit.values[None], self.problem.estimated[:1])[0]

    def _shift(self, other: ContainerProblem, values: np.ndarray) -> float:
        """By how much the mass would follow another problem with these values of all unknowns (changed), to first order [kg]."""
        fit = self.fit
        posterior = self.assessed.posterior
        # less deep in a harder wall
        for at in self._start_rows(other):
            values[at] = np.clip(
                values[at],
                other.unknowns[at].lower,
                other.unknowns[at].upper,
            )
        hard, _, _ = other.simulate(
            values[None],
            other.estimated[:1],
        )
        seen = self.problem.weight > 0.0
        off = ((self._shown - hard)[0] * self.problem.weight)[seen]
        follows = posterior.covariance @ posterior.sensitivity.T @ off
        return float(follows[fit.column(self.name)])

    def comparable(self) -> bool:
        # two more fits, which a fit that is refused for a worse reason is spared
        return super().comparable() and not self.against

    def compared_with_others(self, outlier: int) -> RunComparison:
        mass = self.assessed.value
        name = self.runs[outlier].run.name
        others = [row for row in self.rolling if row != outlier]
        if outlier not in self.rolling or not others:
            sentence = (
                f"{name} contradicts the other runs ({1e3 * mass:.1f} g together): was the same sphere in the same container, "
                "held in the same place, and the baseline empty?"
            )
            return RunComparison(Reason("runs_contradict", sentence))
        # each with the empty container's runs
        one, rest = (
            fit_opened(self.search.without(rows).solve).value_of(self.name)
            for rows in (others, [outlier])
        )
        return compared(name, one, rest, mass)

    def refusals(self) -> Iterator[Refusal]:
        yield from self.misfit(self._bounces)
        yield from self.lighter(
            "the container", "was the baseline empty, and held in the same place?"
        )
        yield from self.several(DISTINCT, "; record a run with another tilt, or state sphere.start")

    def _bounces(self) -> list[str]:
        """A sentence if the first halves of the runs are explained, and only what comes after is not."""
        halves = list(self.runs)
        for row in self.rolling:
            halves[row] = shortened(
                halves[row], (halves[row].used + 1) // 2, halves[row].cut_reason
            )
        if min(halves[row].used for row in self.rolling) < MIN_USED:
            return []
        fit = fit_opened(replace(self.search, runs=tuple(halves)).solve)
        if not fit.explains:
            return []
        return [
            f"the first half of the runs is explained, with {1e3 * fit.value_of(self.name):.1f} g, and what comes after is not: "
            "the sphere bounces otherwise than the law of contact says; tilt instead of shaking, use less current, or make the "
            "probe shorter"
        ]

    def width_limit(self) -> WidthLimit:
        return WidthLimit(self.search.options.wide_share, self.search.options.wide_floor_kg)

    def remarks(self) -> Iterator[str]:
        mass = self.assessed.value
        std = self.assessed.std
        moved = max(path.moved for path in self.paths)
        if mass - Z95 * std <= 0.0:
            yield (
                f"the container may as well be empty: a sphere of up to {1e3 * not_negative(mass, std)[1]:.1f} g would not show"
            )
        elif moved < STILL_M:
            by = f" by more than {1e3 * moved:.1f} mm" if moved >= 5e-5 else ""
            fixed = "it was weighed like a fixed load: that it rolls is not confirmed; tilt further to see it roll"
            yield f"the sphere did not move{by} in any run, so {fixed}"

    def solver(self) -> SolverSummary:
        nominal = self.nominal
        options = self.search.options
        best = float(nominal.physical(self.name)[nominal.solution.best])
        return summary(
            nominal,
            self.name,
            options.starts_kg,
            max(1e-4, DISTINCT * abs(best), self.assessed.std),
            nominal.solution.iterations + self.fit.solution.iterations,
            SearchOptions(integrator=options.integrator, step_s=self.problem.contact_step_s),
            final=self.fit,
        )

    def values(self, withheld: str) -> tuple[Value, ...]:
        shell = self.problem.index["payload_mass"]
        shell_std = float(np.sqrt(self.assessed.covariance[shell, shell]))
        return (
            positive(
                self.name,
                "kg",
                self.assessed.value,
                self.assessed.std,
                withheld,
            ),
            positive(
                "container_mass",
                "kg",
                float(self.fit.values[shell]),
                shell_std,
                withheld,
            ),
        )

    def detail(self, withheld: str) -> ContainerDetail:
        return ContainerDetail(self.paths)

    @cached_property
    def paths(self) -> tuple[SpherePath, ...]:
        """Where the sphere is believed to have been, in each run that has one."""
        problem = self.problem
        estimated = problem.estimated
        own = self.assessed.covariance[np.ix_(estimated, estimated)]
        enclosure = problem.container.enclosure
        q, _, _ = problem.simulate(self.fit.values[None], estimated[:1])
        found = problem.path(self.fit.values, estimated)
        geometries = problem.simulator.special.sphere_runs
        paths = []
        for row, (x, dx), geometry in zip(self.rolling, found, geometries, strict=True):
            run = problem.runs[row]
            paths.append(
                SpherePath(
                    run.run.name,
                    enclosure.shape,
                    enclosure.inner_size,
                    enclosure.radius,
                    run.times_s,
                    x,
                    np.sqrt(np.einsum("kif,fg,kig->ki", dx, own, dx)),
                    self._turned(run, q[0, row, : run.used]),
                    geometry.axis,
                )
            )
        return tuple(paths)

    def _turned(self, run: PreparedRun, position: np.ndarray) -> np.ndarray:
        """world_R_container at positions of the driven joint, (K, 3, 3)."""
        model = reduced_model(self.robot, run.run, {})
        world_from_base = model.placement[0][:3, :3]
        _, body_from_payload = model.frames[self.robot.payload_frame]
        body_from_container = body_from_payload[:3, :3] @ self.problem.container.rotation
        turns = []
        for q in position:
            turn = motion(model.kinds[0], model.axes[0], float(q))
            turns.append(world_from_base @ turn[:3, :3] @ body_from_container)
        return np.array(turns)

    def assumptions(self) -> tuple[str, ...]:
        facts = self.facts
        place = ", ".join(f"{1e3 * c:g}" for c in facts.centre)
        where = "lay still in the lowest place" if facts.settled else "may have been anywhere in it"
        if facts.start is not None:
            where = f"lay at [{', '.join(f'{1e3 * c:g}' for c in facts.start)}] +- {1e3 * facts.start_std:g} mm"
        constants = (
            f"{facts.contact_frequency:g} rad/s, damping ratio {facts.damping_ratio.value:g} +- {facts.damping_ratio.std:g}"
            if facts.law == "ramped"
            else f"k_e {facts.k_e:g} N/m, k_d {facts.k_d:g} N s/m, k_f {facts.k_f:g} N s/m, for {1e3 * LIGHTEST_KG:g} g or more"
        )
        enclosure = facts.enclosure
        options = self.search.options
        step_s = self.problem.contact_step_s
        mass = (
            "taken from the empty-container runs"
            if len(self.rolling) < len(self.runs)
            else "stated"
        )
        filled = "solid" if enclosure.inertia_factor == 0.4 else "hollow"
        return (
            f"the container is {facts.shell.shape.description}, its centre at [{place}] mm in {self.robot.payload_frame}; its mass "
            f"was {mass}",
            f"a {filled} sphere of radius {1e3 * enclosure.radius:g} mm that {where} when the current came on",
            f"law of contact {facts.law}: {constants}, friction {facts.friction.value:g} +- {facts.friction.std:g}",
            f"integrator {options.integrator}, steps of at most {1e3 * step_s:.3g} ms, as the contact needs them",
            stated_in(self.robot),
        )


def _off_by_its_spread(facts: ContainerFacts, key: str) -> list[ContainerFacts]:
    """The facts with one of them off by a standard deviation, in each of its independent directions."""
    enclosure = facts.enclosure
    if key == "container.centre":
        return [replace(facts, centre=facts.centre + GUESSED_PLACE_M * axis) for axis in np.eye(3)]
    if key == "sphere.radius":  # the smaller one: a larger one may not fit
        return [
            replace(
                facts, enclosure=replace(enclosure, radius=enclosure.radius * (1.0 - GUESSED_SHARE))
            )
        ]
    # edges of the inside that change together
    sides = np.eye(3)
    if enclosure.shape == "sphere":
        sides = np.ones((1, 3))
    elif enclosure.shape == "cylinder":
        sides = np.array([[1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    sizes = enclosure.inner_size * (1.0 + GUESSED_SHARE * sides)
    return [replace(facts, enclosure=replace(enclosure, inner_size=size)) for size in sizes]
