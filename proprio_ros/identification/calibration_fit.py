"""The fit of a calibration: all unknowns by their posterior's maximum, the noise by its evidence.

Shared unknowns (torque constant, friction and armature of every driven joint, the encoder's zero and once-per-turn error, how
the links differ from the URDF, the delay) and unknowns of each run (start, onset, a torque that differs from run to run) move
together under the priors of the robot file. Two things that no data sheet gives are learnt from the same runs by empirical
Bayes (MacKay 1992): how coarse the residuals are, and how much torque differs from run to run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace

import numpy as np

from proprio_ros.calibration_files.torque_spread import TorqueSpread
from proprio_ros.identification import scatter, solvers
from proprio_ros.identification.fit import FitResult
from proprio_ros.identification.posterior import Posterior
from proprio_ros.identification.prepared_runs import PreparedRun
from proprio_ros.identification.problem import Problem
from proprio_ros.identification.robot_unknowns import robot_unknowns
from proprio_ros.identification.run_kinds import FREE_SWING, PUSH
from proprio_ros.identification.run_scatter import of_runs, terms_of
from proprio_ros.identification.swings import (
    missed_share,
    stamp_jitter,
    swing_error,
)
from proprio_ros.identification.unknowns import Role
from proprio_ros.robot import Robot
from proprio_ros.sim.joint import INDEX
from proprio_ros.sim.payload import PayloadFacts

FRICTION_STARTS = (0.005, 0.02, 0.06)
"""Coulomb friction [N m] from which the fit starts: low, for a model that sticks has no gradient."""
SWING_FRICTION_STARTS = (0.03, 0.1, 0.25)
"""The same for free swings, as shares of the largest gravity moment: the gears are driven from behind."""
EVIDENCE_ROUNDS = 15
PSEUDO_RUNS = 2.0  # weight of the robot file's word on what else differs from run to run, in runs
# weight of the robot file's word on encoder noise and stamp jitter, in samples
PSEUDO_SAMPLES = 10.0
ALIKE_S, FEWEST_ALIKE = 0.05, 4
"""Samples share an error for about so long, where that is at least so many of them: what friction and held joints do otherwise
than their models changes no faster. An arm of 500 Hz and 15 bits was believed to 0.08 mrad a sample, and what it learnt was 7
standard deviations off."""
RISE_STEPS = (0.1, 0.3, 1.0)
"""Of the standard deviation of a term of the rise of friction, one after the other: a joint that sticks has no gradient."""


@dataclass(frozen=True)
class Noise:
    """Standard deviations that the evidence decides."""

    residual_scale: float  # of readings, over the file's
    stamp_jitter_s: float
    torque_disturbance: float  # of torque from run to run [N m]
    start_velocity: float  # with which runs begin [rad/s]
    onset_jitter_s: float = 0.0  # of the delay from run to run
    friction_spread: float = 0.0  # of free swings, see `Robot`
    swing_error: float = 0.0

    def near(self, other: Noise) -> bool:
        """Whether nothing differs by more than 2 %."""
        return np.allclose(
            astuple(self),
            astuple(other),
            rtol=0.02,
        )


class _Approach:
    """Rounds towards the torque that differs from run to run, with smaller steps each time they turn round.

    A fit under a small spread finds evidence of a large one, and the other way round, where runs are far from linear in it.
    """

    def __init__(self) -> None:
        self._turns = 0
        self._way = 0.0  # of the last step, in logarithms

    def towards(self, found: Noise, before: Noise) -> Noise:
        """What the next fit takes.

        ``found``: by the evidence under ``before``.
        """
        if not found.torque_disturbance or not before.torque_disturbance:
            return found
        way = float(np.log(found.torque_disturbance / before.torque_disturbance))
        if way * self._way < 0.0:
            self._turns += 1
        self._way = way
        step = np.exp(way / (1.0 + self._turns))
        return replace(found, torque_disturbance=float(before.torque_disturbance * step))


@dataclass(frozen=True)
class Fitted:
    """Where the fit of runs with known loads ended."""

    problem: Problem
    values: np.ndarray  # of all unknowns, shape (N,)
    posterior: Posterior
    # of the posterior, or counting also what was taken as known, shape (F, F)
    covariance: np.ndarray
    cost: np.ndarray  # of the end of each start, shape (S,)
    noise: Noise  # as the evidence has it
    torque_spread: TorqueSpread | None  # how well that of torque is known; None: it does not differ


def fit(robot: Robot, runs: Sequence[PreparedRun]) -> Fitted:
    """Maximum a posteriori of all unknowns, the noise by its evidence."""
    kind = runs[0].kind
    noise = Noise(
        1.0,
        robot.stamp_jitter_s,
        robot.torque_disturbance,
        robot.start_velocity,
        robot.onset_jitter_s,
        robot.friction_spread,
        kind.model_error(robot),
    )
    problem = _problem(robot, runs, noise)
    solution = solvers.levenberg_marquardt(
        problem,
        _starts(problem),
        problem.simulator.windows,
        iterations=kind.iterations,
    )
    values = FitResult.of(problem, solution).values
    approach = _Approach()
    for _ in range(EVIDENCE_ROUNDS):
        posterior = Posterior(problem, values)
        before = noise
        noise = _EVIDENCE[kind](robot, problem, posterior, noise)
        noise = approach.towards(noise, before)
        problem = _problem(robot, runs, noise)
        start = problem.coordinates.internal(values[problem.estimated][None])
        values = FitResult.of(
            problem,
            solvers.levenberg_marquardt(problem, start, None, iterations=kind.iterations_again),
        ).values
        if noise.near(before):
            break
    posterior = Posterior(problem, values)
    return Fitted(
        problem,
        values,
        posterior,
        posterior.covariance,
        solution.cost,
        noise,
        _torque_spread(robot, problem, posterior),
    )


def foretold(
    robot: Robot,
    fitted: Fitted,
    run: PreparedRun,
) -> tuple[int, float]:
    """How a fit of others predicts a run whose start, onset and torque of its own are as open as those of any.

    Not as `Posterior.held_out`, for which the run is in the fit: one that came late has bent it by then.

    Args:
        robot: As its file states it.
        fitted: The fit of the others.
        run: That is predicted.

    Returns:
        The number of samples K, and their chi-square under the covariance of the prediction, near K where the run fits the others.
    """
    before = fitted.problem
    problem = _problem(
        robot,
        [*fitted.problem.runs, run],
        fitted.noise,
    )
    values = np.array(
        [
            fitted.values[before.index[u.key]] if u.key in before.index else u.value
            for u in problem.unknowns
        ]
    )
    estimated = problem.estimated_unknowns()
    learnt = [before.unknowns[row].key for row in before.estimated]
    known = np.diag([u.std**2 for u in estimated])
    places = [column for column, u in enumerate(estimated) if u.key in learnt]
    known[np.ix_(places, places)] = fitted.covariance[
        np.ix_(*2 * [[learnt.index(estimated[column].key) for column in places]])
    ]
    posterior = Posterior(problem, values)
    own = posterior.run == len(before.runs)
    off = posterior.residual[own]
    slope = posterior.sensitivity[own]
    within = np.eye(len(off)) + slope @ known @ slope.T
    return len(off), float(off @ np.linalg.solve(within, off))


def _problem(robot: Robot, runs: Sequence[PreparedRun], noise: Noise) -> Problem:
    expected = (
        "torque_disturbance",
        "start_velocity",
        "onset_jitter_s",
        "friction_spread",
    )
    robot = replace(robot, **{name: getattr(noise, name) for name in expected})
    noisy = []
    for run in runs:
        sigma = np.hypot(*_noise_parts(run, noise))
        noisy.append(replace(run, sigma=np.hypot(sigma, noise.swing_error)))
    return Problem(
        robot,
        noisy,
        PayloadFacts(),
        robot_unknowns(robot, runs, Role.ESTIMATED),
    )


def _noise_parts(run: PreparedRun, noise: Noise) -> tuple[float, np.ndarray]:
    velocity = np.gradient(run.run.position, run.run.times_s)[: run.used]
    return noise.residual_scale * run.drive.reading_std, np.abs(velocity) * noise.stamp_jitter_s


def _starts(problem: Problem) -> np.ndarray:
    """Solver coordinates to start from: the file's values at a few levels of friction, shape (S, F)."""
    coordinates = problem.coordinates
    levels = _LEVELS[problem.runs[0].kind](problem)
    starts = np.tile(coordinates.prior_mean, (len(levels), 1))
    for column, row in enumerate(problem.estimated):
        unknown = problem.unknowns[row]
        if unknown.kind == "coulomb" and unknown.value < min(levels):
            starts[:, column] = np.minimum(
                levels,
                unknown.value + 2.0 * unknown.std,
            )
    return coordinates.internal(starts)


def _stated_levels(problem: Problem) -> Sequence[float]:
    """Coulomb friction to start from [N m]."""
    return FRICTION_STARTS


def _levels_by_weight(problem: Problem) -> Sequence[float]:
    """The same of free swings."""
    p, _ = problem.parameters(
        problem.base[None],
        problem.estimated[:1],
    )
    largest = float(
        np.hypot(
            p[..., INDEX["gravity_cos"]],
            p[..., INDEX["gravity_sin"]],
        ).max()
    )
    return [share * largest for share in SWING_FRICTION_STARTS]


_LEVELS = {PUSH: _stated_levels, FREE_SWING: _levels_by_weight}


def with_another_rise(fitted: Fitted) -> Fitted:
    """Count what runs would say if friction rose towards standstill in another way than the robot file has it, where they keep it.

    The rise is kept in the fit (see ``FreeSwing.kept``), and known no better after it: the fit is made again with each of its
    terms up to one standard deviation higher, and by what the others change they are uncertain, together with that term.
    """
    covariance = fitted.covariance.copy()
    kept = fitted.problem.runs[0].kind.kept_rise
    for column, row in enumerate(fitted.problem.estimated):
        if fitted.problem.unknowns[row].kind in kept:
            follows = _follows(fitted, column)
            covariance += np.outer(follows, follows)
            covariance[column, column] -= follows[column] ** 2  # its own was there before
    return replace(fitted, covariance=covariance)


def _follows(fitted: Fitted, column: int) -> np.ndarray:
    """By how much each estimated unknown changes with one standard deviation of a term of the rise, shape (F,)."""
    problem = fitted.problem
    row = problem.estimated[column]
    kept = problem.unknowns[row]
    first = fitted.values[problem.estimated]
    follows = np.zeros_like(first)
    follows[column] = kept.std
    now = first.copy()
    for share in RISE_STEPS:
        unknowns = list(problem.unknowns)
        unknowns[row] = replace(kept, value=kept.value + share * kept.std)
        other = Problem(problem.robot, problem.runs, problem.facts, unknowns)
        now[column] = unknowns[row].value
        start = other.coordinates.internal(now[None])
        iterations = problem.runs[0].kind.iterations_again
        found = solvers.levenberg_marquardt(other, start, None, iterations=iterations)
        now = other.coordinates.physical(found.internal)[0]
        missed = missed_share(Posterior(other, other.all_values(now[None])[0]))
        if missed > problem.runs[0].kind.most_missed:
            break  # with so much of it the joint would not have swung like that
        follows = (now - first) / share
    return follows


def _evidence(
    robot: Robot,
    problem: Problem,
    posterior: Posterior,
    noise: Noise,
) -> Noise:
    """One step towards the noise under which the runs are most probable, the robot file's word counting as pseudo-data."""
    # residual squared plus what the fit has swallowed, in rad^2, is what noise of the assumed kind leaves on average
    parts = [_noise_parts(run, noise) for run in problem.runs]
    readings = [np.full(len(jitter), base) for base, jitter in parts]
    reading = np.concatenate(readings)
    jitter = np.concatenate([part for _, part in parts])
    left = (posterior.residual**2 + posterior.leverage()) * (reading**2 + jitter**2)
    velocity = jitter / max(noise.stamp_jitter_s, 1e-12)
    unit = (reading / noise.residual_scale) ** 2
    scale2, jitter2 = _parts_of_noise(robot, noise, left, unit, velocity)
    spreads = {
        kind: spread_of_runs(usual, *of_runs(kind, problem, posterior)[1:])
        for kind, usual in (
            ("v0", robot.start_velocity),
            ("onset", robot.onset_jitter_s),
        )
    }
    alike = np.sqrt(_alike(problem, posterior, left))
    spread = _torque_spread(robot, problem, posterior)
    return Noise(
        float(np.sqrt(scale2)) * alike,
        float(np.sqrt(jitter2)) * alike,
        robot.torque_disturbance if spread is None else scatter.median_of(spread),
        spreads["v0"],
        max(spreads["onset"], robot.onset_jitter_s),
    )


def _torque_spread(robot: Robot, problem: Problem, posterior: Posterior) -> TorqueSpread | None:
    """By how much torque differs from run to run, the robot file's word being the scale of its prior; None: by nothing."""
    terms = terms_of(problem, posterior)
    if robot.torque_disturbance == 0.0 or terms is None:
        return None
    return scatter.given(scatter.expected(robot.torque_disturbance), terms)


def _parts_of_noise(
    robot: Robot,
    noise: Noise,
    left: np.ndarray,
    unit: np.ndarray,
    velocity: np.ndarray,
) -> tuple[float, float]:
    """Which part of the errors is the encoder's and which the stamps', by expectation maximisation (Dempster et al. 1977).

    Args:
        robot: What its file says counts as pseudo-data.
        noise: Where it begins.
        left: Expected square of each sample's error [rad^2], shape (M,).
        unit: Variance of each reading for a scale of 1 [rad^2], shape (M,).
        velocity: Of the joint at each sample [rad/s], shape (M,).

    Returns: squares of the scale of readings, and of the stamps' jitter [s^2].
    """
    scale2 = noise.residual_scale**2
    jitter2 = noise.stamp_jitter_s**2
    prior = PSEUDO_SAMPLES * robot.stamp_jitter_s**2
    moving = velocity**2 > 1e-6
    for _ in range(30):
        a = scale2 * unit
        b = jitter2 * velocity**2
        total = a + b
        # expected square of each part, given their sum's
        scale_each = ((a / total) ** 2 * left + a * b / total) / unit
        scale2 = float((scale_each.sum() + PSEUDO_SAMPLES) / (len(left) + PSEUDO_SAMPLES))
        if jitter2 > 0.0:
            square_each = (b / total) ** 2 * left + a * b / total
            jitter_each = square_each[moving] / velocity[moving] ** 2
            jitter2 = float((jitter_each.sum() + prior) / (moving.sum() + PSEUDO_SAMPLES))
    return scale2, jitter2


def _alike(problem: Problem, posterior: Posterior, left: np.ndarray) -> float:
    """How many samples say as much as one whose error is its own; 1 where errors are independent.

    The variance of sums of neighbours over that of independent ones (batch means, Glynn & Whitt 1991), with what the fit has
    swallowed of them. ``left`` is the expected square of each sample's error [rad^2], shape (M,).
    """
    together = apart = 0.0
    sigma = 1.0 / problem.weight[problem.weight > 0.0]
    for row, run in enumerate(problem.runs):
        count = round(ALIKE_S / float(np.median(np.diff(run.run.times_s))))
        if count < FEWEST_ALIKE:
            continue
        samples = np.flatnonzero(posterior.run == row)
        of_run = samples[: len(samples) // count * count].reshape(-1, count)
        off = (posterior.residual * sigma)[of_run].sum(axis=1)
        slopes = (posterior.sensitivity * sigma[:, None])[of_run].sum(axis=1)
        together += float(
            np.sum(off**2) + np.einsum("bf,fg,bg->", slopes, posterior.covariance, slopes)
        )
        apart += float(left[of_run].sum())
    return max(together / apart, 1.0) if apart > 0.0 else 1.0


def _swing_evidence(
    robot: Robot,
    problem: Problem,
    posterior: Posterior,
    noise: Noise,
) -> Noise:
    """The same of free swings, whose residuals are not independent."""
    _, found, learnt = of_runs("friction_change", problem, posterior)
    spread = spread_of_runs(robot.friction_spread, found, learnt)
    jitter_s = max(stamp_jitter(posterior), robot.stamp_jitter_s)
    return replace(
        noise,
        stamp_jitter_s=jitter_s,
        friction_spread=spread,
        swing_error=swing_error(posterior),
    )


_EVIDENCE = {PUSH: _evidence, FREE_SWING: _swing_evidence}


def spread_of_runs(file_std: float, found: np.ndarray, learnt: np.ndarray) -> float:
    """Standard deviation of what differs from run to run, the robot file's word counting as ``PSEUDO_RUNS``.

    Args:
        file_std: What the robot file says.
        found: Values of the runs, shape (R,).
        learnt: How much of it each determines rather than its prior (0 to 1), shape (R,).
    """
    prior = PSEUDO_RUNS * file_std**2
    runs = max(float(learnt.sum()), 0.0) + PSEUDO_RUNS
    return float(np.sqrt((np.sum(found**2) + prior) / runs))
