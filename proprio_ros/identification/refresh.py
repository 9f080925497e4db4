"""An old calibration brought up to date by a few runs whose load is known: the old one, aged, is the prior of the new.

Nothing is learnt from scratch: the noise stays as it was calibrated, and what the runs do not touch follows by its correlations.
That is one step of a Kalman filter, linearised where the fit ends.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from proprio_ros.calibration_files.pushes import RANGES, Calibration
from proprio_ros.errors import ConfigurationError
from proprio_ros.identification import robot_calibration, solvers
from proprio_ros.identification.calibration_estimate import NOT_EMPTY, CalibrationEstimate
from proprio_ros.identification.estimate import Fit, Verdict
from proprio_ros.identification.fit import FitResult
from proprio_ros.identification.gates import MISFIT_LIMIT, Findings
from proprio_ros.identification.posterior import Posterior, run_fits
from proprio_ros.identification.prepared_runs import PreparedRun
from proprio_ros.identification.problem import Problem
from proprio_ros.identification.reasons import Reason
from proprio_ros.identification.robot_unknowns import robot_unknowns
from proprio_ros.identification.unknowns import Role, scaled_inverse
from proprio_ros.robot import Robot
from proprio_ros.sim.payload import PayloadFacts

TOO_FAR = 5.0
"""Standard deviations of its aged prior by which a number may have moved: beyond that it is not the stated drift."""
LEARNT = 0.85
"""Share of the variance that the runs take away in theory that is taken away: two or three pushes see friction in few places, and
it is not the same in others."""
ITERATIONS = 40


def refresh(
    robot: Robot,
    runs: Sequence[robot_calibration.LoadedRun],
    progress: Callable[[str], None] = lambda _: None,
) -> CalibrationEstimate:
    """Bring a robot's calibration, aged to when the runs were made, up to date; most of the runs are with an empty hand.

    Raises:
        ConfigurationError: The robot has no calibration of driven runs, or a run is one of those that it was made of.
        RecordingError: A run cannot be related to the robot at all.
    """
    old = robot.calibration
    if old is None or not old.driven:
        none = "holds no calibration of driven runs that could be brought up to date"
        raise ConfigurationError(f"{robot.source.name} {none}: calibrate from the start")
    started = time.perf_counter()
    found = Findings()

    def refused(run: PreparedRun) -> str:
        if not run.run.free and run.run.joint in old.driven:
            return ""
        return f"{run.run.joint} was not driven when the robot was calibrated"

    usable = robot_calibration.usable_runs(robot, runs, found, refused)
    for run in usable:
        if robot_calibration.entry_of(run) in old.runs:
            twice = "is one of the runs that the calibration was made of: it would count twice"
            raise ConfigurationError(f"{run.run.name} {twice}")
    if not usable:
        return robot_calibration.nothing_usable(robot, "a calibrated", len(runs), found)
    progress(f"fitting {len(usable)} runs")
    # where the zeros are now is what the new runs are to say
    robot = replace(robot, zero_repeat=0.0)
    problem = Problem(
        robot,
        usable,
        PayloadFacts(),
        robot_unknowns(robot, usable, Role.FREE),
    )
    start = problem.coordinates.internal(problem.coordinates.prior_mean[None])
    solution = solvers.levenberg_marquardt(problem, start, None, iterations=ITERATIONS)
    ended = FitResult.of(problem, solution)
    values = ended.values
    chi2 = ended.reduced_chi2
    # as in a weighing: runs that are not quite explained count for less
    posterior = Posterior(problem, values, 1.0 if ended.explains else max(1.0, chi2))
    rows = robot_calibration.shared_rows(problem, values, posterior.covariance)
    pulls = [(row.label, abs(row.value - row.prior), row.prior_std) for row in rows]
    moved = [f"{label} ({off / std:.1f})" for label, off, std in pulls if off > TOO_FAR * std]
    hand = robot_calibration.empty_hand(problem, values, posterior)
    reasons = robot_calibration.not_empty(hand, NOT_EMPTY)
    if chi2 > MISFIT_LIMIT or moved:
        what = (
            f"{', '.join(moved[:3])} standard deviations off"
            if moved
            else f"reduced chi-square {chi2:.1f}"
        )
        said = f"the calibration no longer fits, not even with the drift that the robot file states ({what})"
        cure = "was the hand empty, and did anything touch the arm? If not, calibrate anew"
        reasons.append(Reason("drift", f"{said}: {cure}"))
    fits, rms, expected = run_fits(problem, values, usable)
    return CalibrationEstimate(
        robot.name,
        Verdict.REJECTED if reasons else Verdict.ACCEPTED,
        tuple(reasons),
        len(runs),
        _updated(old, problem, values, posterior),
        Fit(rms, expected, chi2, condition=posterior.condition),
        fits,
        unknowns=rows,
        notes=tuple(found.notes),
        empty_hand=hand,
        timing_s={"solve": time.perf_counter() - started},
    )


def _updated(
    old: Calibration, problem: Problem, values: np.ndarray, posterior: Posterior
) -> Calibration:
    """The calibration after the fit; what the runs do not touch moves along as it is correlated with what they do."""
    place = {key: row for row, key in enumerate(old.keys)}
    free = [(f, row) for f, row in enumerate(problem.free) if problem.unknowns[row].key in place]
    of_fit = [f for f, _ in free]
    rows = [row for _, row in free]
    own = [place[problem.unknowns[row].key] for row in rows]
    prior = old.covariance[np.ix_(own, own)]
    follows = old.covariance[:, own] @ scaled_inverse(prior)
    after = posterior.covariance[np.ix_(of_fit, of_fit)]
    new = old.values + follows @ (values[rows] - old.values[own])
    # a rise of friction that was zero may not fall below that
    forms = [RANGES[key if isinstance(key, str) else key[0]] for key in old.keys]
    new = np.clip(
        new,
        [form.lowest for form in forms],
        [form.highest for form in forms],
    )
    covariance = old.covariance - LEARNT * (follows @ (prior - after) @ follows.T)
    runs = (*old.runs, *map(robot_calibration.entry_of, problem.runs))
    return replace(
        old,
        values=new,
        covariance=0.5 * (covariance + covariance.T),
        runs=runs,
    )
