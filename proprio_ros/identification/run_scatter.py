"""How far torque differs from run to run in a weighing, as its own runs and those of the calibration say together.

A calibration learns it from runs in which the robot's friction and torque constants are unknown, too: of nine runs there remain
about three that tell it, and so it is known within a factor of two. What is weighed then shows it again, with a robot that is
known. Both count, and the interval is of all standard deviations that may be, each as probable as it is. It is one spread of all
runs: no run is weighted by itself, and which is left out is decided in `probes.payload.identify`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from proprio_ros.calibration_files.torque_spread import TorqueSpread
from proprio_ros.identification.fit import FitResult
from proprio_ros.identification.posterior import Posterior
from proprio_ros.identification.prepared_runs import PreparedRun, joints_of
from proprio_ros.identification.problem import Problem
from proprio_ros.identification.scatter import Terms, covering, given, log_evidence, median_of
from proprio_ros.quantity import shown
from proprio_ros.robot import Robot

MUCH_MORE = 2.0
"""So many times what its calibration can mean, and the user is told that the robot has become less steady."""
RULED_OUT = 3.0
"""Logarithm of how many times less probable than another an end is that does not count: 1 in 20."""
ROUNDS, SAME = 6, 0.05
"""A weighing is fitted so often at most until its spread stays the same, within this share."""


def of_runs(
    kind: str, problem: Problem, posterior: Posterior
) -> tuple[list[int], np.ndarray, np.ndarray]:
    """An unknown of each run, of onsets where nothing else makes them uncertain.

    Args:
        kind: Of the unknown.
        problem: That was fitted.
        posterior: Of the fit.

    Returns: The runs; its values; how much of it each determines rather than its prior (0 to 1); shapes (R,).
    """
    stds = {}
    for row in range(len(problem.runs)):
        stds[row] = problem.unknowns[problem.index[kind, row]].std
    rows = [
        row
        for row, std in stds.items()
        if std > 0.0 and (kind != "onset" or std == problem.robot.onset_jitter_s)
    ]
    columns = [problem.column_of((kind, row)) for row in rows]
    priors = np.square([stds[row] for row in rows])
    learnt = 1.0 - np.diag(posterior.covariance)[columns] / priors
    return rows, posterior.values[problem.estimated[columns]], learnt


def terms_of(problem: Problem, posterior: Posterior) -> Terms | None:
    """Those of the runs that a problem was fitted to; None where torque is taken to be the same in all of them."""
    rows, found, _ = of_runs("disturbance", problem, posterior)
    if not rows:
        return None
    columns = [problem.column_of(("disturbance", row)) for row in rows]
    stds = np.array([problem.unknowns[problem.estimated[column]].std for column in columns])
    return Terms(
        np.square([problem.runs[row].current_torque_std for row in rows]),
        found,
        posterior.covariance[np.ix_(columns, columns)],
        np.square(stds),
    )


def known_spread(robot: Robot, runs: Sequence[PreparedRun]) -> TorqueSpread | None:
    """How well a robot's calibration knows how far torque differs in such runs; None: it says nothing of that."""
    calibration = robot.calibration
    if calibration is None or not robot.is_calibrated(joints_of(runs)):
        return None
    return calibration.torque_spread


def followed(
    fit: FitResult, spread: TorqueSpread, solve: Callable[[Robot], FitResult]
) -> FitResult:
    """The fit in which torque differs from run to run as the calibration and the runs say together.

    Under a small spread runs may be fitted by something else that differs, so the fit is made anew until both agree.

    Args:
        fit: With the robot as its calibration states it.
        spread: What that knows of the spread.
        solve: Fits the same runs with another robot.
    """
    for _ in range(ROUNDS):
        terms = _terms_after(fit)
        if terms is None:
            break
        robot = fit.problem.robot
        now = covering(given(spread, terms))
        if abs(now - robot.torque_disturbance) < SAME * robot.torque_disturbance:
            break
        fit = solve(replace(robot, torque_disturbance=now))
    return fit


def least_steady(fits: Sequence[FitResult], spread: TorqueSpread) -> FitResult:
    """Of all ends that the runs do not rule out, the one in which torque differs most: its interval is the widest.

    Args:
        fits: Where the search may have ended, each under its own spread.
        spread: What the calibration knows of it.
    """
    if len(fits) == 1:
        return fits[0]
    logs = [_log_evidence(fit, spread) for fit in fits]
    likely = [fit for fit, log in zip(fits, logs, strict=True) if log > max(logs) - RULED_OUT]
    return max(likely, key=lambda fit: fit.problem.robot.torque_disturbance)


def _log_evidence(fit: FitResult, spread: TorqueSpread) -> float:
    """Logarithm of how probable runs are where a fit ended, whatever the spread."""
    terms = _terms_after(fit)
    return -0.5 * fit.chi2 + (0.0 if terms is None else log_evidence(spread, terms))


def _terms_after(fit: FitResult) -> Terms | None:
    inflation = 1.0 if fit.explains else max(1.0, fit.reduced_chi2)
    return terms_of(fit.problem, Posterior(fit.problem, fit.values, inflation))


def differs_more(robot: Robot, spread: TorqueSpread) -> list[str]:
    """A sentence where torque differs much more from run to run than the calibration can mean.

    Args:
        robot: Of the fit that `followed` ends with.
        spread: What its calibration knows of the spread.
    """
    if robot.torque_disturbance < MUCH_MORE * covering(spread):
        return []
    differs = shown(
        "N m",
        robot.torque_disturbance,
        spec=".2g",
    )
    before = shown(
        "N m",
        median_of(spread),
        spec=".2g",
    )
    return [
        f"torque differs by {differs} from run to run, and by {before} in the calibration, which the interval counts: more runs "
        "narrow it, and a calibration anew says whether the robot has changed"
    ]
