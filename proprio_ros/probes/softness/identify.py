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

import numpy as np

from proprio_ros.errors import SimulationError
from proprio_ros.identification import solvers
from proprio_ros.identification.estimate import Estimate, Value, no_answer
from proprio_ros.identification.fit import (
    FitResult,
    SearchOptions,
    other_suspects,
    source_label,
    summary,
)
from proprio_ros.identification.gates import (
    MIN_USED,
    MISFIT_LIMIT,
    UNMOVED_RAD,
    Contradiction,
    Findings,
    contradicting,
    contradiction,
    screen_run,
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
from proprio_ros.identification.prepared_runs import KnownLoad, PreparedRun, joints_of, prepare_run
from proprio_ros.identification.unknowns import Role
from proprio_ros.probes.softness.detail import BlockShape, JointInterval, SoftnessDetail, SqueezeCurve
from proprio_ros.probes.softness.problem import HIGHEST_RATIO, BlockFacts, SqueezeProblem, block_unknowns
from proprio_ros.quantity import Z95
from proprio_ros.records import Run
from proprio_ros.robot import DriveTrain, Robot
from proprio_ros.sim.energies import lame, lame_by_poissons_ratio, lame_of_small_strain
from proprio_ros.sim.mesh import box
from proprio_ros.sim.quasistatic import QuasiStatic

ALIKE_SHARE = 0.15
"""Moduli that differ by less, or by less than they are known to, do not contradict each other: friction is not the same in each
run, and it is as large as a soft block's force."""
UNTOUCHED = 3e-3
"""Relative squeeze below which a block was hardly pressed."""
CRUSHED = 0.45
"""Relative squeeze beyond which no law of elasticity here is to be trusted."""
SHOWN_SHAPES, SHOWN_CELLS, MOST_SHOWN_TETS = 6, 4, 2000
"""How many states of the block a report shows, of how many cells along its longest edge; a finer mesh is not shown."""
CHI2_95_OF_TWO = 5.991464547107979
"""What the square of a standard normal vector of two components stays below in 95 %."""
RATIO_SPREAD = 1.3
"""Poisson's ratio shows in a curve only, and a linear interval of it held in 80 to 92 % of simulated squeezes: where it is
stated, its interval is so much wider."""
GUESSED_SHARE = 0.1
"""How far off each side of a block may be that was not stated: standard deviation."""
PRIOR_DOMINATED = 0.7
"""Posterior over prior standard deviation above which a value is the prior's."""


@dataclass(frozen=True)
class SqueezeOptions:
    """How to solve, and when to refuse.

    Attributes:
        integrator, step_s: see ``SqueezeSimulator``.
        starts_Pa: first guesses of Young's modulus, two orders of magnitude apart or more.
        widest_relative: half width of the 95 % interval of Young's modulus over its value beyond which none is given.
        wide_share: an answer whose half width exceeds this share of the value is ``too_wide``.
    """

    integrator: str = "rk4"
    step_s: float = 1.0 / 480.0
    starts_Pa: tuple[float, ...] = (3e3, 1e4, 4e4, 1.6e5, 6e5)
    widest_relative: float = 1.0
    wide_share: float = 0.5


@dataclass(frozen=True)
class _Recorded:
    """The runs of a fit, those with the block first."""

    runs: tuple[PreparedRun, ...]
    squeezing: tuple[bool, ...]


def find_softness(
    robot: Robot,
    runs: Sequence[Run],
    facts: BlockFacts,
    options: SqueezeOptions | None = None,
    baseline: Sequence[Run] = (),
) -> Estimate:
    """Identify the elastic moduli of the block that all ``runs`` squeeze.

    Args:
        robot: model, drive trains and their uncertainty.
        runs: at least one, each a closing of the gripper on the block.
        facts: what is stated about it.
        options: solver and limits.
        baseline: closings of the empty gripper.

    Raises:
        RecordingError: a run cannot be related to the robot at all, or does not squeeze.
    """
    options = options or SqueezeOptions()
    found = Findings()
    usable: list[tuple[PreparedRun, bool]] = []
    unmoved: list[str] = []
    for run, squeezes in [*((run, True) for run in runs), *((run, False) for run in baseline)]:
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
            usable.append((prepared, squeezes))
        screen_run(robot, prepared, found)
    data = _Recorded(tuple(run for run, _ in usable), tuple(squeezes for _, squeezes in usable))
    # a probe raises a current that moved too little: those that did not move are no flaw of the others
    (found.notes if any(data.squeezing) else found.reasons).extend(unmoved)
    if not any(data.squeezing):
        return no_answer("softness", "youngs_modulus", "Pa", robot.name, len(runs), found.reasons, found.notes)
    nominal = _solve(robot, data, facts, options, Role.FROZEN)
    fit = _solve(robot, data, facts, options, Role.FREE, nominal)
    if not fit.explains:
        again = _solve(robot, data, facts, options, Role.FREE)
        fit = again if again.chi2 < fit.chi2 else fit
    return _conclude(robot, data, facts, options, nominal, fit, found, len(runs))


def _solve(
    robot: Robot,
    data: _Recorded,
    facts: BlockFacts,
    options: SqueezeOptions,
    role: Role,
    start: FitResult | None = None,
) -> FitResult:
    """Fit the runs from every guess, or from the values of another fit."""
    unknowns = block_unknowns(robot, data.runs, data.squeezing, facts, role)
    problem = SqueezeProblem(robot, data.runs, facts, data.squeezing, unknowns, options.integrator, options.step_s)
    coordinates = problem.coordinates
    if start is None:
        starts = np.tile(coordinates.prior_mean, (len(options.starts_Pa), 1))
        starts[:, list(problem.free).index(problem.index["youngs_modulus"])] = options.starts_Pa
        windows, tolerance = problem.simulator.windows, 1e-3
    else:
        starts = start.values[problem.free][None]
        windows, tolerance = None, 1e-4
    solution = solvers.levenberg_marquardt(
        problem, coordinates.internal(starts), windows, iterations=40, tolerance=tolerance
    )
    return FitResult.of(problem, solution)


def fit_squeezes(
    robot: Robot,
    runs: Sequence[PreparedRun],
    facts: BlockFacts,
    options: SqueezeOptions,
    before: FitResult | None = None,
) -> FitResult:
    """Fit squeezes, gripper and block together, without a verdict.

    Args:
        robot: model, drive trains and their uncertainty.
        runs: at least one, each prepared as an empty hand's.
        facts: what is stated about the block.
        options: how to solve.
        before: what some of the same runs said: the fit starts there.
    """
    data = _Recorded(tuple(runs), (True,) * len(runs))
    if before is not None:
        unknowns = block_unknowns(robot, data.runs, data.squeezing, facts, Role.FREE)
        fit = _solve(robot, data, facts, options, Role.FREE, replace(before, values=before.values_of(unknowns)))
        if fit.explains:
            return fit
    return _solve(robot, data, facts, options, Role.FREE, _solve(robot, data, facts, options, Role.FROZEN))


def _apart(
    robot: Robot, data: _Recorded, facts: BlockFacts, options: SqueezeOptions, outlier: int, std_Pa: float
) -> Contradiction:
    """What a run says that the others predict badly; ``std_Pa`` is what all runs together leave open of the modulus."""
    name = data.runs[outlier].run.name
    moduli = []
    for rows in ([outlier], [row for row in range(len(data.runs)) if row != outlier]):
        part = _Recorded(tuple(data.runs[row] for row in rows), tuple(data.squeezing[row] for row in rows))
        if not any(part.squeezing):
            return Contradiction(f"{name} contradicts the other runs: was the gripper empty where it should be?")
        nominal = _solve(robot, part, facts, options, Role.FROZEN)
        moduli.append(float(_solve(robot, part, facts, options, Role.FREE, nominal).physical("youngs_modulus")[0]))
    one, others = moduli
    question = "was the same block held in the same way?"
    return contradiction(name, "Pa", one, others, max(ALIKE_SHARE * others, std_Pa), 0.0, question)


def _conclude(
    robot: Robot,
    data: _Recorded,
    facts: BlockFacts,
    options: SqueezeOptions,
    nominal: FitResult,
    fit: FitResult,
    found: Findings,
    run_count: int,
) -> Estimate:
    problem = fit.problem
    assert isinstance(problem, SqueezeProblem)
    known = robot.is_calibrated(joints_of(data.runs))
    assessed = Assessment(fit, "youngs_modulus", data.runs, known)
    outlier = contradicting(Posterior(problem, fit.values)) if len(data.runs) > 1 and not fit.explains else None
    apart = None if outlier is None else _apart(robot, data, facts, options, outlier, assessed.std)
    if apart is not None and apart.half is not None:
        assessed.widen(apart.half)
    measured_std, budget = assessed.std, assessed.budget()
    guesses = _guesses(facts, assessed.value)
    for guess in guesses:
        assessed.widen(guess.std)
        budget = sorted([*budget, (f"{guess.key}, guessed", guess.std)], key=lambda entry: -entry[1])
    modulus, std, covariance = assessed.value, assessed.std, assessed.covariance
    curves = _curves(problem, fit.values, facts)
    largest = max(float(curve.squeeze.max()) for curve in curves)
    unknown = problem.unknowns[assessed.row]

    def refusals() -> Iterator[Refusal]:
        if not np.isfinite(fit.chi2):
            unsimulated = "no guess of the modulus could be simulated"
            yield rejected("unsimulated", unsimulated, unsimulated + ": check block.size and the robot file")
        yield from contradicted(apart)
        if fit.reduced_chi2 > MISFIT_LIMIT:
            misfit = _misfit(assessed.rms, assessed.expected, modulus, fit.reduced_chi2)
            yield rejected("misfit", "the model does not explain the recording", misfit, *other_suspects(robot))
        if largest < UNTOUCHED or modulus <= unknown.lower * 1.01:
            yield not_identifiable(
                "hardly_pressed",
                "the block was hardly pressed",
                f"the block was squeezed by {100.0 * max(largest, 0.0):.1f} % at most: is it between the fingers, and block.size "
                "right?",
            )
        if modulus >= unknown.upper * 0.99 or Z95 * std > options.widest_relative * modulus:
            yield not_identifiable(
                "one_sided",
                "the recording bounds the modulus on one side at most",
                f"Young's modulus can only be determined to +-{100.0 * Z95 * std / modulus:.0f} %, mostly because of "
                f"{source_label(budget[0][0])}: "
                + (
                    "squeeze with other currents, too"
                    if known
                    else "calibrate the gripper on closings without the block"
                ),
            )

    def remarks() -> list[str]:
        crushed = f"the block was squeezed by {100.0 * largest:.0f} %, where what is known about elasticity ends: use less current"
        pressed = [run for run, squeezes in zip(data.runs, data.squeezing, strict=True) if squeezes]
        return [*([crushed] * (largest > CRUSHED)), *_beyond_measured(pressed)]

    def values(withheld: str) -> tuple[Value, ...]:
        return _values(fit, covariance, facts, withheld, curves, measured_std)

    best = float(nominal.physical("youngs_modulus")[nominal.solution.best])
    return judge(
        robot,
        assessed,
        refusals(),
        found,
        probe="softness",
        run_count=run_count,
        values=values,
        solver=summary(
            nominal, "youngs_modulus", options.starts_Pa, max(0.02 * best, 0.1 * std),
            nominal.solution.iterations + fit.solution.iterations,
            SearchOptions(integrator=options.integrator, step_s=options.step_s),
            final=fit,
        ),
        budget=budget,
        assumptions=_assumptions(robot, data.runs[0].drive, facts, options, largest),
        apart=apart,
        remarks=remarks,
        useful=Useful(options.wide_share),
        guesses=guesses,
        detail=lambda withheld: SoftnessDetail(curves, None if withheld else _joint(fit, covariance, facts)),
    )  # fmt: skip


def _guesses(facts: BlockFacts, modulus: float) -> list[Guess]:
    """The size where it was not stated: of a given stiffness E A / L, the modulus goes with the length over both other sides."""
    if "block.size" not in facts.guessed:
        return []
    taken = " x ".join(f"{1e3 * edge:g}" for edge in facts.size) + " mm"
    return [Guess("block.size", taken, f"{100.0 * GUESSED_SHARE:g} % per side", np.sqrt(3.0) * GUESSED_SHARE * modulus)]


def _values(
    fit: FitResult,
    covariance: np.ndarray,
    facts: BlockFacts,
    withheld: str,
    curves: Sequence[SqueezeCurve],
    measured_std: float,
) -> tuple[Value, ...]:
    names = {"youngs_modulus": "Pa", "poissons_ratio": "1", "lame_mu": "Pa", "lame_lambda": "Pa"}
    if withheld:
        return tuple(Value(name, unit, None, reason=withheld) for name, unit in names.items())
    modulus, ratio, both, undetermined = _moduli(fit, covariance, facts)
    std_e, std_nu = np.sqrt(np.diag(both)).tolist()
    mu, lam = lame(modulus, ratio)
    std_mu, std_lambda = np.sqrt(np.diag(_lame_covariance(modulus, ratio, both))).tolist()
    force, strain, length = max(
        ((c.force_N.max(), c.squeeze.max(), c.length) for c in curves), key=lambda each: each[1]
    )
    secant = float(force / (strain * length))
    return (
        positive("youngs_modulus", "Pa", modulus, std_e),
        Value("poissons_ratio", "1", None, std_nu, reason=undetermined)
        if undetermined
        else positive("poissons_ratio", "1", ratio, std_nu, highest=HIGHEST_RATIO),
        positive("lame_mu", "Pa", float(mu), std_mu),
        Value("lame_lambda", "Pa", None, reason=undetermined)
        if undetermined
        else positive("lame_lambda", "Pa", float(lam), std_lambda),
        # force over travel: whatever the block's size is
        positive("secant_stiffness", "N/m", secant, secant * measured_std / modulus),
        Value("largest_squeeze", "1", float(strain)),
    )


def _moduli(fit: FitResult, covariance: np.ndarray, facts: BlockFacts) -> tuple[float, float, np.ndarray, str]:
    """Young's modulus and Poisson's ratio as they are stated.

    Returns:
        both, their covariance, shape (2, 2), and why the ratio, with what goes with it, is not the recording's: empty where it is.
    """
    rows = [fit.problem.index["youngs_modulus"], fit.problem.index["poissons_ratio"]]
    modulus, ratio = fit.values[rows].tolist()
    both, prior = covariance[np.ix_(rows, rows)], facts.poissons_ratio
    std = float(np.sqrt(both[1, 1]))
    if prior.std == 0.0:
        return modulus, ratio, both, ""
    better = "squeeze further, with several currents, or state block.poissons_ratio"
    if not 1e-3 < ratio < HIGHEST_RATIO - 1e-3:
        # the fit could go no further, so it gives no interval either: what is known is the prior
        known = np.diag([both[0, 0], prior.std**2])
        undetermined = (
            f"the fit went to {ratio:.2f}, the end of what is searched: the squeeze does not determine it; {better}"
        )
        return modulus, prior.value, known, undetermined
    if RATIO_SPREAD * std > PRIOR_DOMINATED * prior.std:
        undetermined = (
            f"prior_dominated: the squeeze determines Poisson's ratio to +-{std:.2f}, the prior to +-{prior.std:.2f}; "
            f"{better}"
        )
        return modulus, ratio, both, undetermined
    spread = np.array([1.0, RATIO_SPREAD])
    return modulus, ratio, both * np.outer(spread, spread), ""


def _lame_covariance(modulus: float, ratio: float, both: np.ndarray) -> np.ndarray:
    """Of mu and lambda, from that of Young's modulus and Poisson's ratio; shapes (2, 2)."""
    by = np.column_stack([lame(1.0, ratio), modulus * np.array(lame_by_poissons_ratio(ratio))])
    covariance: np.ndarray = by @ both @ by.T
    return covariance


def _joint(fit: FitResult, covariance: np.ndarray, facts: BlockFacts) -> JointInterval:
    """Mu and lambda together: the ellipse of Young's modulus and Poisson's ratio, as it bends on the way to them."""
    modulus, ratio, both, undetermined = _moduli(fit, covariance, facts)
    turn = np.linspace(0.0, 2.0 * np.pi, 121)
    # in standard deviations: pascals and a ratio differ by orders of magnitude, and a ratio that is stated exactly has none
    std = np.sqrt(np.diag(both))
    sizes = np.where(std > 0.0, std, 1.0)
    scale, axes = np.linalg.eigh(both / np.outer(sizes, sizes))
    circle = np.stack([np.cos(turn), np.sin(turn)])
    ellipse = sizes[:, None] * (axes * np.sqrt(CHI2_95_OF_TWO * np.maximum(scale, 0.0)) @ circle)
    around = np.maximum(modulus + ellipse[0], 0.0), np.clip(ratio + ellipse[1], 0.0, HIGHEST_RATIO)
    return JointInterval(
        ("lame_mu", "lame_lambda"), "Pa", np.array(lame(modulus, ratio)), _lame_covariance(modulus, ratio, both),
        np.stack(lame(*around), axis=1), not undetermined,
    )  # fmt: skip


def _curves(problem: SqueezeProblem, values: np.ndarray, facts: BlockFacts) -> tuple[SqueezeCurve, ...]:
    """Force on a finger over squeeze, as simulated, with the quasi-static law alone."""
    at = problem.index
    modulus, ratio = float(values[at["youngs_modulus"]]), float(values[at["poissons_ratio"]])
    table = problem.simulator.special.squeeze_runs[0].response
    curves: list[SqueezeCurve] = []
    for row, squeeze in zip(np.flatnonzero(problem.squeezing), problem.squeezes(values), strict=True):
        pressed = np.maximum(squeeze, 0.0)
        force = modulus * facts.area * table(pressed, np.full(len(pressed), ratio))[0]
        run = problem.runs[row]
        shapes = () if curves else _shapes(facts, ratio, run.times_s, squeeze)
        curves.append(SqueezeCurve(run.run.name, facts.length, run.times_s, squeeze, force, shapes))
    return tuple(curves)


def _shapes(facts: BlockFacts, ratio: float, times_s: np.ndarray, squeeze: np.ndarray) -> tuple[BlockShape, ...]:
    """The block at some instants on the way to the largest squeeze, for a picture; none where that would take long or far."""
    mesh = facts.mesh
    if mesh is None:
        counts = np.clip(np.round(SHOWN_CELLS * facts.size / facts.size.max()), 1, None).astype(int)
        mesh = box(facts.size, (int(counts[0]), int(counts[1]), int(counts[2])))
    at = np.linspace(0, int(np.argmax(squeeze)), SHOWN_SHAPES).round().astype(int)
    if len(mesh.tets) > MOST_SHOWN_TETS:
        return ()
    solver = QuasiStatic(mesh, facts.law, facts.contact)
    try:
        places = solver.curve(
            mesh.length * np.maximum(squeeze[at], 0.0), *lame_of_small_strain(facts.law, *lame(1.0, ratio))
        )
    except SimulationError:
        return ()
    middle = places.points.mean(axis=1, keepdims=True)
    middle[..., 0] = 0.5 * (places.points[..., 0].min(axis=1) + places.points[..., 0].max(axis=1))[:, None]
    scaled = (places.points - middle) / mesh.length
    return tuple(
        BlockShape(float(times_s[row]), float(squeeze[row]), points, mesh.outside)
        for row, points in zip(at, scaled, strict=True)
    )


def _misfit(rms: float, expected: float, modulus: float, reduced_chi2: float) -> str:
    if rms <= expected:
        return (
            f"misfit: the simulation ({modulus:.3g} Pa) only follows the recording with a gripper or a block further from what is "
            f"known about them than chance allows (reduced chi-square {reduced_chi2:.1f})"
        )
    return (
        f"misfit: the best simulation ({modulus:.3g} Pa) misses the recording by {1e3 * rms:.2f} mrad rms where the encoder "
        f"explains {1e3 * expected:.2f} mrad"
    )


def _assumptions(
    robot: Robot, drive: DriveTrain, facts: BlockFacts, options: SqueezeOptions, largest: float
) -> tuple[str, ...]:
    size = " x ".join(f"{1e3 * edge:.4g}" for edge in facts.size)
    shape = "" if facts.mesh is None else f", a mesh of {len(facts.mesh.tets)} tetrahedra"
    measured = drive.finger_travel
    ratio = f"{1e3 * drive.transmission:g} mm per rad"
    if measured is not None:
        span = ", ".join(f"{1e3 * each:.2f}" for each in measured.ratio_at([measured.at_rad[0], measured.at_rad[-1]]))
        ratio = f"{span} mm per rad at both ends of what was measured ({len(measured.at_rad)} openings)"
    return (
        f"a homogeneous block of {size} mm (the first along the squeeze){shape}, faces {facts.contact}, law of elasticity "
        f"{facts.law}; squeezed by up to {100.0 * largest:.0f} %",
        f"{facts.fingers} fingers that move {ratio} each: the modulus goes with one over the square of that",
        f"Poisson's ratio {facts.poissons_ratio.value:g} +- {facts.poissons_ratio.std:g} before the squeeze",
        f"integrator {options.integrator}, steps of at most {1e3 * options.step_s:.3g} ms",
        f"robot file {robot.source.name}, " + ("calibrated" if robot.is_calibrated() else "not calibrated"),
    )


def _beyond_measured(runs: Sequence[PreparedRun]) -> list[str]:
    """What is to be said where the motor turned farther than the finger's travel was measured."""
    measured = runs[0].drive.finger_travel
    if measured is None:
        return []
    low, high = (end(float(end(run.position)) for run in runs) for end in (min, max))
    spare = 0.1 * (measured.at_rad[-1] - measured.at_rad[0])
    if measured.at_rad[0] - spare <= low and high <= measured.at_rad[-1] + spare:
        return []
    return [
        f"the motor was between {low:.2f} and {high:.2f} rad, finger_travel was measured from {measured.at_rad[0]:g} to "
        f"{measured.at_rad[-1]:g} rad: measure there, too"
    ]
