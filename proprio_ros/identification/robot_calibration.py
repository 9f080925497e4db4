"""The robot weighs itself: one maximum-a-posteriori fit over runs whose load is known, mostly nothing.

Shared unknowns (torque constant, friction and armature of every probed joint, the encoder's zero and once-per-turn error, how
the links differ from the URDF, the delay) and unknowns of each run (start, onset, a torque that differs from run to run) move
together under the priors of the robot file. Two things that no data sheet gives are learnt from the same runs by empirical
Bayes (MacKay 1992): how coarse the residuals are, and how much torque differs from run to run. The result is the posterior of
the shared unknowns, which later weighings take as their prior, correlations included.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from proprio_ros.calibration import Calibration
from proprio_ros.identification import solvers
from proprio_ros.identification.posterior import Posterior
from proprio_ros.identification.problem import KnownLoad, PayloadProblem, PreparedRun, robot_unknowns
from proprio_ros.identification.unknowns import Role
from proprio_ros.records import Run
from proprio_ros.robot import Robot
from proprio_ros.sim.payload import PayloadFacts

FRICTION_STARTS = (0.005, 0.02, 0.06)
"""Coulomb friction [N m] from which the fit starts: low, for a model that sticks has no gradient (HARDWARE.md, section 5)."""
EVIDENCE_ROUNDS = 15
PSEUDO_RUNS = 3.0
"""Weight of the robot file's word on run-to-run torque, in runs."""
PSEUDO_SAMPLES = 10.0
"""Weight of the robot file's word on encoder noise and stamp jitter, in samples."""


@dataclass(frozen=True)
class LoadedRun:
    """A recorded run and what the hand held in it."""

    run: Run
    load: KnownLoad = field(default_factory=KnownLoad)


@dataclass(frozen=True)
class _Noise:
    """Standard deviations that the evidence decides: reading [of the file's], stamps [s], torque from run to run [N m]."""

    residual_scale: float
    stamp_jitter_s: float
    torque_disturbance: float


@dataclass(frozen=True)
class _Fitted:
    problem: PayloadProblem
    values: np.ndarray
    posterior: Posterior
    solution: solvers.Solution
    noise: _Noise


def _problem(robot: Robot, runs: Sequence[PreparedRun], noise: _Noise) -> PayloadProblem:
    robot = replace(robot, torque_disturbance=noise.torque_disturbance)
    unknowns = robot_unknowns(robot, runs, Role.FREE)
    return PayloadProblem(robot, [_with_noise(run, noise) for run in runs], PayloadFacts(), unknowns)


def _with_noise(run: PreparedRun, noise: _Noise) -> PreparedRun:
    reading, jitter = _noise_parts(run, noise)
    return replace(run, sigma=np.hypot(reading, jitter))


def _noise_parts(run: PreparedRun, noise: _Noise) -> tuple[float, np.ndarray]:
    velocity = np.gradient(run.run.position, run.run.times_s)[: run.used]
    reading = float(np.hypot(run.drive.encoder_resolution / np.sqrt(12.0), run.drive.encoder_noise))
    return noise.residual_scale * reading, np.abs(velocity) * noise.stamp_jitter_s


def _starts(problem: PayloadProblem) -> np.ndarray:
    """Solver coordinates to start from: the file's values at a few levels of friction, shape (S, F)."""
    coordinates = problem.coordinates
    starts = np.tile(coordinates.prior_mean, (len(FRICTION_STARTS), 1))
    for column, row in enumerate(problem.free):
        unknown = problem.unknowns[row]
        if unknown.name.startswith("coulomb[") and unknown.value < min(FRICTION_STARTS):
            starts[:, column] = np.minimum(FRICTION_STARTS, unknown.value + 2.0 * unknown.std)
    return coordinates.internal(starts)


def fit(robot: Robot, runs: Sequence[PreparedRun]) -> _Fitted:
    noise = _Noise(1.0, robot.stamp_jitter_s, robot.torque_disturbance)
    problem = _problem(robot, runs, noise)
    solution = solvers.levenberg_marquardt(problem, _starts(problem), problem.simulator.windows, iterations=40)
    values = problem.all_values(problem.coordinates.physical(solution.internal[solution.best][None]))[0]
    again = solution
    for _ in range(EVIDENCE_ROUNDS):
        posterior = Posterior(problem, values)
        better = _evidence(robot, problem, posterior, noise)
        settled = np.allclose(
            [better.residual_scale, better.stamp_jitter_s, better.torque_disturbance],
            [noise.residual_scale, noise.stamp_jitter_s, noise.torque_disturbance],
            rtol=0.02,
        )
        noise = better
        problem = _problem(robot, runs, noise)
        start = problem.coordinates.internal(values[problem.free][None])
        again = solvers.levenberg_marquardt(problem, start, None, iterations=10)
        values = problem.all_values(problem.coordinates.physical(again.internal))[0]
        if settled:
            break
    return _Fitted(problem, values, Posterior(problem, values), solution, noise)


def _evidence(robot: Robot, problem: PayloadProblem, posterior: Posterior, noise: _Noise) -> _Noise:
    """One step towards the noise under which the runs are most probable, the robot file's word counting as pseudo-data."""
    # residual squared plus what the fit has swallowed, in rad^2, is what noise of the assumed kind leaves on average
    parts = [_noise_parts(run, noise) for run in problem.runs]
    reading = np.concatenate([np.full(len(jitter), base) for base, jitter in parts])
    jitter = np.concatenate([part for _, part in parts])
    variance = reading**2 + jitter**2
    left = (posterior.residual**2 + posterior.leverage()) * variance
    velocity = np.concatenate([np.abs(part) for _, part in parts]) / max(noise.stamp_jitter_s, 1e-12)
    scale2, jitter2 = noise.residual_scale**2, noise.stamp_jitter_s**2
    unit = (reading / noise.residual_scale) ** 2
    for _ in range(30):
        a, b = scale2 * unit, jitter2 * velocity**2
        total = a + b
        # expected square of each part, given their sum's
        scale_each = ((a / total) ** 2 * left + a * b / total) / unit
        scale2 = float((scale_each.sum() + PSEUDO_SAMPLES) / (len(left) + PSEUDO_SAMPLES))
        if jitter2 > 0.0:
            moving = velocity**2 > 1e-6
            jitter_each = ((b / total) ** 2 * left + a * b / total)[moving] / velocity[moving] ** 2
            prior = PSEUDO_SAMPLES * robot.stamp_jitter_s**2
            jitter2 = float((jitter_each.sum() + prior) / (moving.sum() + PSEUDO_SAMPLES))
    disturbance = noise.torque_disturbance
    place = {problem.unknowns[row].name: f for f, row in enumerate(problem.free)}
    rows = [f"disturbance[{r}]" for r in range(len(problem.runs))]
    if rows[0] in place:
        columns = [place[name] for name in rows]
        found = posterior.values[problem.free[columns]]
        spread = np.diag(posterior.covariance)[columns]
        told = len(columns) - float(spread.sum()) / disturbance**2
        prior = PSEUDO_RUNS * robot.torque_disturbance**2
        disturbance = float(np.sqrt((np.sum(found**2) + prior) / (max(told, 0.0) + PSEUDO_RUNS)))
    return _Noise(float(np.sqrt(scale2)), float(np.sqrt(jitter2)), disturbance)


def is_shared(name: str) -> bool:
    """Whether an unknown is the robot's, not a run's."""
    return not name.startswith(("q0[", "v0[", "onset[", "disturbance["))


def as_calibration(fitted: _Fitted, runs: Sequence[PreparedRun]) -> Calibration:
    problem = fitted.problem
    shared = [f for f, row in enumerate(problem.free) if is_shared(problem.unknowns[row].name)]
    rows = problem.free[shared]
    return Calibration(
        tuple(problem.unknowns[row].name for row in rows),
        tuple(problem.unknowns[row].unit for row in rows),
        fitted.values[rows],
        fitted.posterior.covariance[np.ix_(shared, shared)],
        fitted.noise.residual_scale,
        fitted.noise.stamp_jitter_s,
        fitted.noise.torque_disturbance,
        tuple(
            {
                "name": run.run.name,
                "joint": run.run.joint,
                "current_A": float(run.run.input_current_A[0]),
                "load_kg": run.load.mass if run.load else 0.0,
                "samples": run.used,
            }
            for run in runs
        ),
    )
