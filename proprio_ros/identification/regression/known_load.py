"""What a known load says of an arm's terms and of the scale of its torques: both at once, since they err together.

A calibration of empty motions has the arm's P terms z in torques as the robot file's constants make them: the true ones over a
scale s. A load of mass m then looks like m u, with u = 1 / s. So the motion of a known load is linear in z, in u and in what the
recording has of its own (where the load lies, friction and zeros that differ): one Gaussian posterior of all of them. It keeps the
covariance of u with z. A later weighing follows both, and much of what it errs by is in both and cancels.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from proprio_ros.calibration_files.motions import LoadScale, MotionCalibration
from proprio_ros.identification.regression.arm_terms import ArmTerms
from proprio_ros.identification.regression.motion_equations import Problem
from proprio_ros.identification.regression.motion_prior import (
    LOAD_FRICTION_SPREAD,
    calibrated_terms,
)
from proprio_ros.identification.regression.recording_variability import CLOCK, CONSIDERED
from proprio_ros.identification.regression.solve import (
    FIXED,
    Prior,
    Solution,
    posterior,
    scores,
)
from proprio_ros.records import FloatArray
from proprio_ros.robot.regressor import PARAMETERS

LEAST_EIGENVALUE = (
    1e-9  # Of correlations, in parts of the largest: below it there is only rounding.
)


@dataclass(frozen=True)
class ReferenceMotion:
    """A motion with a known load, as it is explained with its mass open by a calibration."""

    mass_kg: float
    problem: Problem
    solution: Solution
    scatter: FloatArray  # of the solution over spreads of what recordings differ by, covariance, shape (U, U)
    # by how much larger the variance of its residuals is than their weights say
    noisier: float = 1.0


def learnt_with(calibration: MotionCalibration, load: ReferenceMotion) -> MotionCalibration:
    """The calibration with what a known load says of the arm and of the scale of its torques.

    Args:
        calibration: By which the load's motion is explained. Its ``torque_scale_std`` is what the robot file leaves open of the
            scale, or what known loads before this one have left of that.
        load: Its motion.
    """
    terms = len(calibration.values)
    read = _read(calibration, load)
    # the scale as it was known before, given the terms, is one more observation
    follows = (
        scale_by_terms(calibration) / -calibration.torque_scale
    )  # of the inverse of the scale, (P,)
    along = np.append(-follows, 1.0)
    variance = scale_variance_alone(calibration) / calibration.torque_scale**2
    expected = 1.0 / calibration.torque_scale - follows @ calibration.values
    gain = read.covariance @ along / float(along @ read.covariance @ along + variance)
    values = read.values + gain * (expected - along @ read.values)
    kept = np.eye(terms + 1) - np.outer(gain, along)
    covariance = kept @ read.covariance @ kept.T + variance * np.outer(gain, gain)
    deviations = read.deviations @ kept.T
    before = deviations_with_scale(calibration)
    of_inverse = before[:, terms] / -calibration.torque_scale - before[:, :terms] @ follows
    deviations[: len(before)] += of_inverse[:, None] * gain
    scale = float(1.0 / values[terms])
    return replace(
        calibration,
        values=values[:terms],
        covariance=covariance[:terms, :terms],
        deviations=deviations[:, :terms],
        torque_scale=scale,
        torque_scale_std=scale * float(np.sqrt(covariance[terms, terms])),
        scale_of_load=LoadScale(-scale * covariance[:terms, terms], -scale * deviations[:, terms]),
    )


@dataclass(frozen=True)
class _Read:
    """An arm's P terms and the inverse of the scale of its torques, by a known load."""

    values: FloatArray  # shape (P + 1,)
    covariance: FloatArray  # shape (P + 1, P + 1)
    deviations: (
        FloatArray  # of the calibration's stretches, and of the load's, shape (stretches, P + 1)
    )


@dataclass(frozen=True)
class _Own:
    """What the U unknowns of a motion have of their own beside the arm's terms: O of them."""

    at: NDArray[np.int64]  # where they stand among the unknowns, shape (O,)
    std: FloatArray  # shape (O,)
    followed: FloatArray  # the same, as far as a fit follows them, shape (O,)
    averaged: NDArray[np.int64]  # those that are averaged over their spreads, shape (K,)

    @classmethod
    def of(cls, load: ReferenceMotion) -> _Own:
        """Those of a known load's: the payload's parameters, what gears lose under it, and what the recording differs by."""
        problem = load.problem
        solution = load.solution
        size = len(solution.values)
        geared = ArmTerms(problem.count, PARAMETERS).load_friction
        kinds = np.tile(solution.variability.kinds, problem.motions)
        of_recording = np.tile(solution.variability.std, problem.motions)
        followed = np.where(np.isin(kinds, CLOCK), FIXED * of_recording, of_recording)
        first = np.append(solution.payload_prior, np.full(problem.count, LOAD_FRICTION_SPREAD))
        averaged = len(first) + np.flatnonzero(np.isin(kinds, CONSIDERED))
        return cls(
            np.r_[0:PARAMETERS, geared, problem.own(0).start : size],
            np.append(first, of_recording),
            np.append(first, followed),
            averaged,
        )


def _read(calibration: MotionCalibration, load: ReferenceMotion) -> _Read:
    """By the calibration's terms, and a scale of which nothing is known: terms and what is the motion's own are one vector."""
    solution = load.solution
    terms = len(calibration.values)
    own = _Own.of(load)
    rows = solution.scaled @ _by_terms_and_own(load, terms, own)  # (E, P + O)
    information = rows.T @ rows
    torque = load.problem.torque * solution.weight
    before = Prior(
        np.append(calibration.values, np.zeros(len(own.at))),
        _beside(calibration.covariance, own.followed),
    )
    values, covariance = posterior(information, rows.T @ torque, before)
    # what is averaged over its spreads is as the solution has it; all else follows it
    averaged = terms + own.averaged
    among = own.at[own.averaged]
    precision = np.linalg.inv(covariance[np.ix_(averaged, averaged)])
    leads = covariance[:, averaged] @ precision  # (P + O, K)
    values = values + leads @ (solution.values[among] - values[averaged])
    # of the terms, and of the load's own mass behind them
    kept = slice(0, terms + 1)
    by_prior = (np.eye(len(values)) - covariance @ information)[kept]
    known = _beside(calibration.covariance, own.std)
    noise = covariance[kept] @ information @ covariance[:, kept]
    scatter = leads[kept] @ load.scatter[np.ix_(among, among)] @ leads[kept].T
    pulls = scores(rows, solution.residual * solution.weight, load.problem) @ covariance[:, kept]
    deviations = np.vstack([calibration.deviations @ by_prior[:, :terms].T, pulls])
    # a load of a known mass says its inverse scale
    to_scale = np.append(np.ones(terms), 1.0 / load.mass_kg)
    whole = by_prior @ known @ by_prior.T + load.noisier * noise + scatter
    return _Read(
        values[kept] * to_scale,
        whole * np.outer(to_scale, to_scale),
        deviations * to_scale,
    )


def _beside(covariance: FloatArray, stds: FloatArray) -> FloatArray:
    """Covariance of some unknowns, and of others of so large standard deviations that are independent."""
    count = len(covariance)
    result = np.diag(np.append(np.zeros(count), np.square(stds)))
    result[:count, :count] = covariance
    return result


def _by_terms_and_own(load: ReferenceMotion, terms: int, own: _Own) -> FloatArray:
    """How a motion's unknowns follow an arm's so many terms, P, and what they have of their own, shape (U, P + O)."""
    problem = load.problem
    count = len(own.at)
    follows = np.zeros((len(load.solution.values), terms + count))
    follows[PARAMETERS:, :terms] = calibrated_terms(problem.count, problem.motions)
    follows[own.at, range(terms, terms + count)] = 1.0
    return follows


def covariance_with_scale(calibration: MotionCalibration) -> FloatArray:
    """Of an arm's P terms and the relative scale of its torques, shape (P + 1, P + 1)."""
    terms = len(calibration.values)
    covariance = np.zeros((terms + 1, terms + 1))
    covariance[:terms, :terms] = calibration.covariance
    covariance[terms, terms] = calibration.torque_scale_std**2
    if calibration.scale_of_load is not None:
        covariance[:terms, terms] = calibration.scale_of_load.covariance
        covariance[terms, :terms] = calibration.scale_of_load.covariance
    return covariance


def deviations_with_scale(calibration: MotionCalibration) -> FloatArray:
    """Which way each stretch pulls an arm's P terms and the relative scale of its torques, shape (stretches, P + 1)."""
    scale = calibration.scale_of_load
    pulls = np.zeros(calibration.stretches) if scale is None else scale.deviations
    return np.column_stack([calibration.deviations, pulls])


def scale_by_terms(calibration: MotionCalibration) -> FloatArray:
    """By how much the relative scale is larger where a term is known to be, shape (P,)."""
    if calibration.scale_of_load is None:
        return np.zeros(len(calibration.values))
    std = np.sqrt(np.diag(calibration.covariance))
    correlation = calibration.covariance / std[:, None] / std
    inverse = np.linalg.pinv(correlation, rcond=LEAST_EIGENVALUE, hermitian=True)
    result: FloatArray = inverse @ (calibration.scale_of_load.covariance / std) / std
    return result


def scale_variance_alone(calibration: MotionCalibration) -> float:
    """Variance of the relative scale were the arm's terms known."""
    variance = calibration.torque_scale_std**2
    if calibration.scale_of_load is None:
        return variance
    explained = float(scale_by_terms(calibration) @ calibration.scale_of_load.covariance)
    return max(variance - explained, 0.0)
