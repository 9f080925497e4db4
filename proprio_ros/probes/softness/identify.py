"""From closings of the gripper on a soft block to its elastic moduli, with intervals and a verdict.

What one squeeze fixes is Young's modulus. Poisson's ratio shows only in how the force bends away from a straight line at large
strain; where the posterior is hardly narrower than the prior it is called prior-dominated and not stated. Lamé parameters follow
from the two, with what is known of both. Runs with the empty gripper (the baseline, and the calibration) give friction and
armature; torque constant and armature share one scale that no gripper can separate, so the modulus is known no better than the
torque constant is.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import compress

import numpy as np

from proprio_ros.errors import SimulationError
from proprio_ros.identification import solvers
from proprio_ros.identification.conclude import Conclusion, stated_in
from proprio_ros.identification.estimate import (
    WIDEST_SHARE,
    Estimate,
    SolverSummary,
    Value,
    WidthLimit,
    no_answer,
)
from proprio_ros.identification.fit import (
    FitResult,
    SearchOptions,
    fit_both,
    fit_opened,
    source_label,
    summary,
    unexplained,
)
from proprio_ros.identification.gates import (
    MIN_USED,
    UNMOVED_RAD,
    Findings,
    RunComparison,
    compare_run,
    screen_run,
)
from proprio_ros.identification.judge import Guess, Refusal, not_identifiable, positive
from proprio_ros.identification.prepared_runs import KnownLoad, PreparedRun, prepare_run
from proprio_ros.identification.unknowns import Role
from proprio_ros.probes.softness.detail import (
    BlockShape,
    JointInterval,
    SoftnessDetail,
    SqueezeCurve,
)
from proprio_ros.probes.softness.problem import (
    HIGHEST_RATIO,
    BlockFacts,
    SqueezeProblem,
    block_unknowns,
)
from proprio_ros.quantity import Z95
from proprio_ros.records import Run
from proprio_ros.robot import Robot
from proprio_ros.sim.energies import lame, lame_by_poissons_ratio, lame_of_small_strain
from proprio_ros.sim.mesh import box
from proprio_ros.sim.quasistatic import QuasiStatic

ALIKE_SHARE = 0.15
"""Moduli that differ by less, or by less than they are known to, do not contradict each other: friction is not the same in each
run, and it is as large as a soft block's force."""
# reduced chi-square up to which one more squeeze moves a fit, and no search begins
ALMOST_EXPLAINED = 2.0
UNTOUCHED = 3e-3  # relative squeeze below which a block was hardly pressed
CRUSHED = 0.45  # relative squeeze beyond which no law of elasticity here is to be trusted
SHOWN_SHAPES, SHOWN_CELLS, MOST_SHOWN_TETS = 6, 4, 2000
"""How many states of the block a report shows, of how many cells along its longest edge; a finer mesh is not shown."""
# what the square of a standard normal vector of two components stays below in 95 %
CHI2_95_OF_TWO = 5.991464547107979
RATIO_SPREAD = 1.3
"""Poisson's ratio shows in a curve only, and a linear interval of it held in 80 to 92 % of simulated squeezes: where it is
stated, its interval is so much wider."""
# how far off each side of a block may be that was not stated: standard deviation
GUESSED_SHARE = 0.1
PRIOR_DOMINATED = 0.7  # posterior over prior standard deviation above which a value is the prior's


@dataclass(frozen=True)
class SqueezeOptions:
    """How to solve, and when to refuse."""

    # integrator, step_s: see ``SqueezeSimulator``
    integrator: str = "rk4"
    step_s: float = 1.0 / 480.0
    # first guesses of Young's modulus, two orders of magnitude apart or more
    starts_Pa: tuple[float, ...] = (3e3, 1e4, 4e4, 1.6e5, 6e5)
    # half width of the 95 % interval of Young's modulus over its value beyond which none is given
    widest_relative: float = 1.0
    # an answer whose half width exceeds this share of the value is ``too_wide``
    wide_share: float = WIDEST_SHARE


@dataclass(frozen=True)
class SqueezeSearch:
    """Runs that are fitted together, those with the block first, and how; ``squeezing`` is which have it."""

    robot: Robot
    runs: tuple[PreparedRun, ...]
    squeezing: tuple[bool, ...]
    facts: BlockFacts
    options: SqueezeOptions

    def part(self, rows: Sequence[int]) -> SqueezeSearch:
        """Some of the runs."""
        runs = tuple(self.runs[row] for row in rows)
        squeezing = tuple(self.squeezing[row] for row in rows)
        return replace(self, runs=runs, squeezing=squeezing)

    def problem(self, role: Role) -> SqueezeProblem:
        """The problem, in which the recording may move of the robot what the role says."""
        robot = self.robot
        runs = self.runs
        squeezing = self.squeezing
        facts = self.facts
        options = self.options
        unknowns = block_unknowns(robot, runs, squeezing, facts, role)
        return SqueezeProblem(
            robot, runs, facts, squeezing, unknowns, options.integrator, options.step_s
        )

    def solve(self, role: Role, start: FitResult | None = None) -> FitResult:
        """Fit the runs from every guess, or from the values of another fit, which may have had fewer runs."""
        problem = self.problem(role)
        guesses = self.options.starts_Pa
        if start is None:
            starts = np.tile(problem.coordinates.prior_mean, (len(guesses), 1))
            starts[:, problem.column_of("youngs_modulus")] = guesses
            windows = problem.simulator.windows
            tolerance = 1e-3
        else:
            starts = start.values_of(problem.unknowns)[problem.estimated][None]
            windows = None
            tolerance = 1e-4
        internal = problem.coordinates.internal(starts)
        solution = solvers.levenberg_marquardt(
            problem, internal, windows, iterations=40, tolerance=tolerance
        )
        return FitResult.of(problem, solution)


def find_softness(
    robot: Robot,
    runs: Sequence[Run],
    facts: BlockFacts,
    options: SqueezeOptions | None = None,
    baseline: Sequence[Run] = (),
) -> Estimate:
    """Identify the elastic moduli of the block that all ``runs`` squeeze.

    Args:
        robot: As its file or its calibration states it.
        runs: Closings of the gripper on the block.
        facts: Of the block.
        options: Of the solver.
        baseline: Closings of the empty gripper.

    Raises:
        RecordingError: A run cannot be related to the robot at all, or does not squeeze.
    """
    options = options or SqueezeOptions()
    found = Findings()
    usable: list[PreparedRun] = []
    squeezing: list[bool] = []
    unmoved: list[str] = []
    for number, run in enumerate((*runs, *baseline)):
        prepared = prepare_run(robot, run, KnownLoad(), past_fast=True)
        if prepared.used < MIN_USED:
            why = prepared.cut_reason or "the probe was too short"
            found.reasons.append(f"{run.name}: only {prepared.used} usable samples, because {why}")
        elif abs(prepared.travel) < UNMOVED_RAD:
            unmoved.append(
                f"{run.name}: the fingers moved only {1e3 * abs(prepared.travel * prepared.drive.transmission):.2f} mm, so "
                "friction and not the block decides where they are: squeeze with more current, or from further away"
            )
        else:
            usable.append(prepared)
            squeezing.append(number < len(runs))
        screen_run(robot, prepared, found)
    if not any(squeezing):
        found.reasons.extend(unmoved)
        return no_answer(
            "softness", "youngs_modulus", "Pa", robot.name, len(runs), found.reasons, found.notes
        )
    # a probe raises a current that moved too little: those that did not move are no flaw of the others
    found.notes.extend(unmoved)
    search = SqueezeSearch(robot, tuple(usable), tuple(squeezing), facts, options)
    nominal, opened = fit_both(search.solve, unexplained)
    return Squeezed(nominal, opened, found, len(runs), search).estimate()


def fit_squeezes(
    robot: Robot,
    runs: Sequence[PreparedRun],
    facts: BlockFacts,
    options: SqueezeOptions,
    before: FitResult | None = None,
) -> FitResult:
    """Fit squeezes, gripper and block together, without a verdict.

    Args:
        robot: As its file or its calibration states it.
        runs: All with the block, prepared.
        facts: Of the block.
        options: Of the solver.
        before: What some of the same runs said.
    """
    search = SqueezeSearch(
        robot,
        tuple(runs),
        (True,) * len(runs),
        facts,
        options,
    )
    if before is not None:
        fit = search.solve(Role.ESTIMATED, before)
        # a search from every guess takes seconds
        if fit.reduced_chi2 <= ALMOST_EXPLAINED:
            return fit
    return fit_opened(search.solve)


@dataclass(eq=False)
class Squeezed(Conclusion):
    """What a fit says about the moduli of a block; ``search`` has the runs that were fitted, and how."""

    search: SqueezeSearch

    probe = "softness"
    name = "youngs_modulus"
    searched_for = "modulus"
    check = "check block.size and the robot file"
    beside = "a gripper or a block"

    def widen_by_comparison(self) -> None:
        super().widen_by_comparison()
        # friction is not the same in each run: what that makes of the modulus counts as noise of the readings
        self.budget = self.assessed.budget()
        self.measured_std = self.assessed.std

    def compared_with_others(self, outlier: int) -> RunComparison:
        name = self.runs[outlier].run.name
        others = [row for row in range(len(self.runs)) if row != outlier]
        parts = [self.search.part(rows) for rows in ([outlier], others)]
        if not all(any(part.squeezing) for part in parts):
            return RunComparison(
                f"{name} contradicts the other runs: was the gripper empty where it should be?"
            )
        one, rest = [float(fit_opened(part.solve).physical(self.name)[0]) for part in parts]
        alike = max(ALIKE_SHARE * rest, self.assessed.std)  # what all runs together leave open
        return compare_run(
            name, "Pa", one, rest, alike, 0.0, "was the same block held in the same way?"
        )

    def guess(self) -> list[Guess]:
        """The size, unless stated: of a given stiffness E A / L, the modulus goes with the length over both other sides."""
        facts = self.search.facts
        if "block.size" not in facts.guessed:
            return []
        taken = " x ".join(f"{1e3 * edge:g}" for edge in facts.size) + " mm"
        std = np.sqrt(3.0) * GUESSED_SHARE * self.assessed.value
        return [Guess("block.size", taken, f"{100.0 * GUESSED_SHARE:g} % per side", std)]

    @cached_property
    def curves(self) -> tuple[SqueezeCurve, ...]:
        """Force on a finger over squeeze, as simulated, with the quasi-static law alone."""
        problem = self.fit.problem
        facts = self.search.facts
        values = self.fit.values
        assert isinstance(problem, SqueezeProblem)
        at = problem.index
        modulus = float(values[at["youngs_modulus"]])
        ratio = float(values[at["poissons_ratio"]])
        table = problem.simulator.special.squeeze_runs[0].response
        curves: list[SqueezeCurve] = []
        rows = np.flatnonzero(problem.squeezing)
        for row, squeeze in zip(rows, problem.squeezes(values), strict=True):
            run = problem.runs[row]
            pressed = np.maximum(squeeze, 0.0)
            per_modulus, *_ = table(pressed, np.full(len(pressed), ratio))
            force = modulus * facts.area * per_modulus
            shapes = () if curves else _shapes(facts, ratio, run.times_s, squeeze)
            curves.append(
                SqueezeCurve(run.run.name, facts.length, run.times_s, squeeze, force, shapes)
            )
        return tuple(curves)

    @property
    def largest(self) -> float:
        """Squeeze, relative to the block's length."""
        return max(float(curve.squeeze.max()) for curve in self.curves)

    def refusals(self) -> Iterator[Refusal]:
        yield from self.misfit()
        modulus = self.assessed.value
        std = self.assessed.std
        largest = self.largest
        unknown = self.fit.problem.unknowns[self.assessed.row]
        if largest < UNTOUCHED or modulus <= unknown.lower * 1.01:
            yield not_identifiable(
                "hardly_pressed",
                "the block was hardly pressed",
                f"the block was squeezed by {100.0 * max(largest, 0.0):.1f} % at most: is it between the fingers, and block.size "
                "right?",
            )
        if (
            modulus >= unknown.upper * 0.99
            or Z95 * std > self.search.options.widest_relative * modulus
        ):
            better = "calibrate the gripper on closings without the block"
            yield not_identifiable(
                "one_sided",
                "the recording bounds the modulus on one side at most",
                f"Young's modulus can only be determined to +-{100.0 * Z95 * std / modulus:.0f} %, mostly because of "
                f"{source_label(self.budget[0][0])}: {'squeeze with other currents, too' if self.known else better}",
            )

    def remarks(self) -> Iterator[str]:
        if self.largest > CRUSHED:
            squeezed = f"the block was squeezed by {100.0 * self.largest:.0f} %"
            yield f"{squeezed}, where what is known about elasticity ends: use less current"
        yield from _beyond_measured(list(compress(self.runs, self.search.squeezing)))

    def width_limit(self) -> WidthLimit:
        return WidthLimit(self.search.options.wide_share)

    def solver(self) -> SolverSummary:
        nominal = self.nominal
        options = self.search.options
        alike = max(
            0.02 * float(nominal.physical(self.name)[nominal.solution.best]),
            0.1 * self.assessed.std,
        )
        iterations = nominal.solution.iterations + self.fit.solution.iterations
        steps = SearchOptions(integrator=options.integrator, step_s=options.step_s)
        return summary(
            nominal, self.name, options.starts_Pa, alike, iterations, steps, final=self.fit
        )

    def values(self, withheld: str) -> tuple[Value, ...]:
        names = {
            "youngs_modulus": "Pa",
            "poissons_ratio": "1",
            "lame_mu": "Pa",
            "lame_lambda": "Pa",
        }
        if withheld:
            return tuple(Value(name, unit, None, reason=withheld) for name, unit in names.items())
        modulus, ratio, both, undetermined = self.moduli
        std_e, std_nu = np.sqrt(np.diag(both)).tolist()
        mu, lam = lame(modulus, ratio)
        of_lame = _lame_covariance(modulus, ratio, both)
        std_mu, std_lambda = np.sqrt(np.diag(of_lame)).tolist()
        if undetermined:
            nu = Value("poissons_ratio", "1", None, std_nu, reason=undetermined)
            lame_lambda = Value("lame_lambda", "Pa", None, reason=undetermined)
        else:
            nu = positive("poissons_ratio", "1", ratio, std_nu, highest=HIGHEST_RATIO)
            lame_lambda = positive("lame_lambda", "Pa", float(lam), std_lambda)
        widest = max(self.curves, key=lambda curve: curve.squeeze.max())
        strain = widest.squeeze.max()
        # force over travel: whatever the block's size is
        secant = float(widest.force_N.max() / (strain * widest.length))
        return (
            positive("youngs_modulus", "Pa", modulus, std_e),
            nu,
            positive("lame_mu", "Pa", float(mu), std_mu),
            lame_lambda,
            positive("secant_stiffness", "N/m", secant, secant * self.measured_std / modulus),
            Value("largest_squeeze", "1", float(strain)),
        )

    @cached_property
    def moduli(self) -> tuple[float, float, np.ndarray, str]:
        """Young's modulus and Poisson's ratio as they are stated.

        With their covariance, shape (2, 2), and why the ratio, with what goes with it, is not the recording's: empty where it is.
        """
        rows = [
            self.fit.problem.index["youngs_modulus"],
            self.fit.problem.index["poissons_ratio"],
        ]
        modulus, ratio = self.fit.values[rows].tolist()
        both = self.assessed.covariance[np.ix_(rows, rows)]
        prior = self.search.facts.poissons_ratio
        std = float(np.sqrt(both[1, 1]))
        if prior.std == 0.0:
            return modulus, ratio, both, ""
        better = "squeeze further, with several currents, or state block.poissons_ratio"
        if not 1e-3 < ratio < HIGHEST_RATIO - 1e-3:
            # the fit could go no further, so it gives no interval either: what is known is the prior
            known = np.diag([both[0, 0], prior.std**2])
            undetermined = f"the fit went to {ratio:.2f}, the end of what is searched: the squeeze does not determine it; {better}"
            return modulus, prior.value, known, undetermined
        if RATIO_SPREAD * std > PRIOR_DOMINATED * prior.std:
            undetermined = (
                f"prior_dominated: the squeeze determines Poisson's ratio to +-{std:.2f}, "
                f"the prior to +-{prior.std:.2f}; {better}"
            )
            return modulus, ratio, both, undetermined
        spread = np.array([1.0, RATIO_SPREAD])
        return modulus, ratio, both * np.outer(spread, spread), ""

    def detail(self, withheld: str) -> SoftnessDetail:
        return SoftnessDetail(self.curves, None if withheld else self._joint())

    def _joint(self) -> JointInterval:
        """Mu and lambda together: the ellipse of Young's modulus and Poisson's ratio, as it bends on the way to them."""
        modulus, ratio, both, undetermined = self.moduli
        turn = np.linspace(0.0, 2.0 * np.pi, 121)
        # in standard deviations: pascals and a ratio differ by orders of magnitude, and a ratio that is stated exactly has none
        std = np.sqrt(np.diag(both))
        sizes = np.where(std > 0.0, std, 1.0)
        scale, axes = np.linalg.eigh(both / np.outer(sizes, sizes))
        circle = np.stack([np.cos(turn), np.sin(turn)])
        ellipse = sizes[:, None] * (
            axes * np.sqrt(CHI2_95_OF_TWO * np.maximum(scale, 0.0)) @ circle
        )
        around = (
            np.maximum(modulus + ellipse[0], 0.0),
            np.clip(ratio + ellipse[1], 0.0, HIGHEST_RATIO),
        )
        covariance = _lame_covariance(modulus, ratio, both)
        outline = np.stack(lame(*around), axis=1)
        value = np.array(lame(modulus, ratio))
        return JointInterval(
            ("lame_mu", "lame_lambda"), "Pa", value, covariance, outline, not undetermined
        )

    def assumptions(self) -> tuple[str, ...]:
        facts = self.search.facts
        options = self.search.options
        size = " x ".join(f"{1e3 * edge:.4g}" for edge in facts.size)
        shape = "" if facts.mesh is None else f", a mesh of {len(facts.mesh.tets)} tetrahedra"
        drive = self.runs[0].drive
        measured = drive.finger_travel
        ratio = f"{1e3 * drive.transmission:g} mm per rad"
        if measured is not None:
            ends = measured.ratio_at([measured.at_rad[0], measured.at_rad[-1]])
            span = ", ".join(f"{1e3 * each:.2f}" for each in ends)
            ratio = f"{span} mm per rad at both ends of what was measured ({len(measured.at_rad)} openings)"
        return (
            f"a homogeneous block of {size} mm (the first along the squeeze){shape}, faces {facts.contact}, law of elasticity "
            f"{facts.law}; squeezed by up to {100.0 * self.largest:.0f} %",
            f"{facts.fingers} fingers that move {ratio} each: the modulus goes with one over the square of that",
            f"Poisson's ratio {facts.poissons_ratio.value:g} +- {facts.poissons_ratio.std:g} before the squeeze",
            f"integrator {options.integrator}, steps of at most {1e3 * options.step_s:.3g} ms",
            stated_in(self.robot),
        )


def _lame_covariance(modulus: float, ratio: float, both: np.ndarray) -> np.ndarray:
    """Of mu and lambda, from that of Young's modulus and Poisson's ratio; shapes (2, 2)."""
    by_ratio = modulus * np.array(lame_by_poissons_ratio(ratio))
    by = np.column_stack([lame(1.0, ratio), by_ratio])
    covariance: np.ndarray = by @ both @ by.T
    return covariance


def _shapes(
    facts: BlockFacts, ratio: float, times_s: np.ndarray, squeeze: np.ndarray
) -> tuple[BlockShape, ...]:
    """The block at some instants on the way to the largest squeeze, for a picture; none where that would take long or far."""
    mesh = facts.mesh
    if mesh is None:
        cells = np.round(SHOWN_CELLS * facts.size / facts.size.max())
        counts = np.maximum(cells, 1).astype(int)
        mesh = box(facts.size, tuple(counts.tolist()))
    last = int(np.argmax(squeeze))
    at = np.linspace(0, last, SHOWN_SHAPES).round().astype(int)
    if len(mesh.tets) > MOST_SHOWN_TETS:
        return ()
    moduli = lame_of_small_strain(facts.law, *lame(1.0, ratio))
    try:
        squeezed = QuasiStatic(mesh, facts.law, facts.contact).curve(
            mesh.length * np.maximum(squeeze[at], 0.0), *moduli
        )
    except SimulationError:
        return ()
    places = squeezed.points
    middle = places.mean(axis=1, keepdims=True)
    along = places[..., 0]
    middle[..., 0] = 0.5 * (along.min(axis=1) + along.max(axis=1))[:, None]
    scaled = (places - middle) / mesh.length
    return tuple(
        BlockShape(float(times_s[row]), float(squeeze[row]), points, mesh.surface)
        for row, points in zip(at, scaled, strict=True)
    )


def _beyond_measured(runs: Sequence[PreparedRun]) -> list[str]:
    """What is to be said where the motor turned farther than the finger's travel was measured."""
    measured = runs[0].drive.finger_travel
    if measured is None:
        return []
    low = min(float(run.position.min()) for run in runs)
    high = max(float(run.position.max()) for run in runs)
    first = measured.at_rad[0]
    last = measured.at_rad[-1]
    spare = 0.1 * (last - first)
    if first - spare <= low and high <= last + spare:
        return []
    return [
        f"the motor was between {low:.2f} and {high:.2f} rad, finger_travel was measured from {first:g} to {last:g} rad: measure "
        "there, too"
    ]
