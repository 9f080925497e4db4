"""An old calibration brought up to date by a few runs whose load is known: the old one, aged, is the prior of the new.

Nothing is learnt from scratch: the noise stays as it was calibrated, and what the runs do not touch follows by its correlations.
That is one step of a Kalman filter, linearised where the fit ends.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from proprio_ros.calibration_files.pushes import (
    RANGES,
    Calibration,
)
from proprio_ros.errors import ConfigurationError
from proprio_ros.identification import robot_calibration, sentences, solvers
from proprio_ros.identification.calibration_estimate import (
    NOT_EMPTY,
    CalibrationEstimate,
)
from proprio_ros.identification.estimate import (
    Fit,
    UnknownRow,
    Verdict,
)
from proprio_ros.identification.fit import FitResult
from proprio_ros.identification.gates import (
    MISFIT_LIMIT,
    Findings,
)
from proprio_ros.identification.posterior import (
    Posterior,
    run_fits,
)
from proprio_ros.identification.prepared_runs import PreparedRun
from proprio_ros.identification.problem import Problem
from proprio_ros.identification.robot_unknowns import (
    robot_unknowns,
)
from proprio_ros.identification.unknowns import (
    Role,
    scaled_inverse,
)
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

    Args:
        robot: With the calibration.
        runs: What was recorded now.
        progress: Called with what is being done, in words.

    Returns: the new calibration, or why it is none.

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
    usable = _new_runs(robot, old, runs, found)
    if not usable:
        return robot_calibration.nothing_usable(robot, "a calibrated", len(runs), found)
    progress(f"fitting {len(usable)} runs")
    # where the zeros are now is what the new runs are to say
    robot = replace(robot, zero_repeat=0.0)
    unknowns = robot_unknowns(robot, usable, Role.ESTIMATED)
    problem = Problem(robot, usable, PayloadFacts(), unknowns)
    start = problem.coordinates.internal(problem.coordinates.prior_mean[None])
    ended = FitResult.of(
        problem,
        solvers.levenberg_marquardt(problem, start, None, iterations=ITERATIONS),
    )
    chi2 = ended.reduced_chi2
    # as in a weighing: runs that are not quite explained count for less
    posterior = Posterior(
        problem,
        ended.values,
        1.0 if ended.explains else max(1.0, chi2),
    )
    rows = robot_calibration.shared_rows(problem, ended.values, posterior.covariance)
    hand = robot_calibration.empty_hand(problem, ended.values, posterior)
    reasons = [
        *robot_calibration.not_empty(hand, NOT_EMPTY),
        *_drifted(chi2, rows),
    ]
    fits, rms, expected = run_fits(problem, ended.values, usable)
    return CalibrationEstimate(
        robot.name,
        Verdict.REJECTED if reasons else Verdict.ACCEPTED,
        tuple(reasons),
        len(runs),
        _updated(old, problem, ended.values, posterior),
        Fit(rms, expected, chi2, condition=posterior.condition),
        fits,
        unknowns=rows,
        notes=tuple(found.notes),
        empty_hand=hand,
        timing_s={"solve": time.perf_counter() - started},
    )


def _new_runs(
    robot: Robot,
    old: Calibration,
    runs: Sequence[robot_calibration.LoadedRun],
    found: Findings,
) -> list[PreparedRun]:
    """The runs that can be used; ConfigurationError where one of them is in the old calibration already."""

    def refused(run: PreparedRun) -> str:
        if "torque_constant" not in run.kind.unneeded and run.run.joint in old.driven:
            return ""
        return f"{run.run.joint} was not driven when the robot was calibrated"

    usable = robot_calibration.usable_runs(robot, runs, found, refused)
    for run in usable:
        if robot_calibration.entry_of(run) in old.runs:
            twice = "is one of the runs that the calibration was made of: it would count twice"
            raise ConfigurationError(f"{run.run.name} {twice}")
    return usable


def _drifted(chi2: float, rows: Sequence[UnknownRow]) -> list[str]:
    """That the robot changed by more than its file states, where residuals or unknowns say so."""
    moved = []
    for row in rows:
        off = abs(row.value - row.prior)
        if off > TOO_FAR * row.prior_std:
            moved.append(f"{row.label} ({off / row.prior_std:.1f})")
    if chi2 <= MISFIT_LIMIT and not moved:
        return []
    what = f"reduced chi-square {chi2:.1f}"
    if moved:
        what = f"{', '.join(moved[:3])} standard deviations off"
    return [sentences.drifted(what)]


def _updated(
    old: Calibration,
    problem: Problem,
    values: np.ndarray,
    posterior: Posterior,
) -> Calibration:
    """The calibration after the fit; what the runs do not touch moves along as it is correlated with what they do."""
    place = {key: row for row, key in enumerate(old.keys)}
    estimated = [
        (f, row) for f, row in enumerate(problem.estimated) if problem.unknowns[row].key in place
    ]
    of_fit = [f for f, _ in estimated]
    rows = [row for _, row in estimated]
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
    runs = (
        *old.runs,
        *map(robot_calibration.entry_of, problem.runs),
    )
    return replace(
        old,
        values=new,
        covariance=0.5 * (covariance + covariance.T),
        runs=runs,
    )
