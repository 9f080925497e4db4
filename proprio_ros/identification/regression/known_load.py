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

LEAST_EIGENVALUE = 1e-9
"""Of correlations, in parts of the largest: below it there is only rounding."""


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
    read = _Explained(calibration, load).read()
    before = 1.0 / calibration.torque_scale
    # the scale as it was known before, given the terms, is one more observation
    follows = -before * scale_by_terms(calibration)  # of the inverse of the scale, (P,)
    along = np.append(-follows, 1.0)
    variance = before**2 * scale_variance_alone(calibration)
    expected = before - follows @ calibration.values
    spread = read.covariance @ along
    gain = spread / float(along @ spread + variance)
    values = read.values + gain * (expected - along @ read.values)
    kept = np.eye(terms + 1) - np.outer(gain, along)
    covariance = kept @ read.covariance @ kept.T
    covariance += variance * np.outer(gain, gain)
    deviations = read.deviations @ kept.T
    earlier = deviations_with_scale(calibration)
    of_inverse = -before * earlier[:, terms] - earlier[:, :terms] @ follows
    deviations[: len(earlier)] += of_inverse[:, None] * gain
    scale = float(1.0 / values[terms])
    return replace(
        calibration,
        values=values[:terms],
        covariance=covariance[:terms, :terms],
        deviations=deviations[:, :terms],
        torque_scale=scale,
        torque_scale_std=scale * float(np.sqrt(covariance[terms, terms])),
        scale_of_load=LoadScale(
            -scale * covariance[:terms, terms],
            -scale * deviations[:, terms],
        ),
    )


@dataclass(frozen=True)
class _Read:
    """An arm's P terms and the inverse of the scale of its torques, by a known load."""

    values: FloatArray  # shape (P + 1,)
    covariance: FloatArray  # shape (P + 1, P + 1)
    # of the calibration's stretches, and of the load's, shape (stretches, P + 1)
    deviations: FloatArray


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
        followed = np.where(
            np.isin(kinds, CLOCK),
            FIXED * of_recording,
            of_recording,
        )
        first = np.append(
            solution.payload_prior,
            np.full(problem.count, LOAD_FRICTION_SPREAD),
        )
        averaged = len(first) + np.flatnonzero(np.isin(kinds, CONSIDERED))
        return cls(
            np.r_[0:PARAMETERS, geared, problem.own(0).start : size],
            np.append(first, of_recording),
            np.append(first, followed),
            averaged,
        )


class _Explained:
    """A known load's motion by the arm's P terms and by what the motion has of its own, which are one vector.

    Of the scale of the torques nothing is known here: the load's mass is one of what is its own.
    """

    def __init__(
        self,
        calibration: MotionCalibration,
        load: ReferenceMotion,
    ) -> None:
        solution = load.solution
        terms = len(calibration.values)
        own = _Own.of(load)
        before = Prior(
            np.append(
                calibration.values,
                np.zeros(len(own.at)),
            ),
            _beside(
                calibration.covariance,
                own.followed,
            ),
        )
        self._calibration = calibration
        self._load = load
        self._own = own
        self._rows = solution.scaled @ _by_terms_and_own(load, terms, own)  # (E, P + O)
        self._information = self._rows.T @ self._rows
        torque = load.problem.torque * solution.weight
        values, covariance = posterior(
            self._information,
            self._rows.T @ torque,
            before,
        )
        # what is averaged over its spreads is as the solution has it; all else follows it
        averaged = terms + own.averaged
        self._among = own.at[own.averaged]
        precision = np.linalg.inv(covariance[np.ix_(averaged, averaged)])
        self._leads = covariance[:, averaged] @ precision  # (P + O, K)
        off = solution.values[self._among] - values[averaged]
        self._values = values + self._leads @ off
        self._covariance = covariance
        # the terms, and the load's own mass behind them
        self._kept = slice(0, terms + 1)

    def read(self) -> _Read:
        """Terms and inverse scale: a load of a known mass says the latter."""
        terms = self._kept.stop - 1
        to_scale = np.append(
            np.ones(terms),
            1.0 / self._load.mass_kg,
        )
        by_prior = self._by_prior()
        return _Read(
            self._values[self._kept] * to_scale,
            self._errors(by_prior) * np.outer(to_scale, to_scale),
            self._deviations(by_prior) * to_scale,
        )

    def _by_prior(self) -> FloatArray:
        """How terms and mass follow what was known before, shape (P + 1, P + O)."""
        size = len(self._values)
        by_data = self._covariance @ self._information
        result: FloatArray = (np.eye(size) - by_data)[self._kept]
        return result

    def _errors(self, by_prior: FloatArray) -> FloatArray:
        """Of terms and mass, by all they err by: covariance, shape (P + 1, P + 1)."""
        known = _beside(
            self._calibration.covariance,
            self._own.std,
        )
        of_known = by_prior @ known @ by_prior.T
        mine = self._covariance[self._kept]
        noise = mine @ self._information @ mine.T
        leads = self._leads[self._kept]
        scatter = self._load.scatter[np.ix_(self._among, self._among)]
        result: FloatArray = of_known + self._load.noisier * noise + leads @ scatter @ leads.T
        return result

    def _deviations(self, by_prior: FloatArray) -> FloatArray:
        """Which way stretches of the calibration and of the load pull terms and mass, shape (stretches, P + 1)."""
        solution = self._load.solution
        terms = self._kept.stop - 1
        earlier = self._calibration.deviations @ by_prior[:, :terms].T
        pulls = scores(
            self._rows,
            solution.residual * solution.weight,
            self._load.problem,
        )
        return np.vstack(
            [
                earlier,
                pulls @ self._covariance[:, self._kept],
            ]
        )


def _beside(
    covariance: FloatArray,
    stds: FloatArray,
) -> FloatArray:
    """Covariance of some unknowns, and of others of so large standard deviations that are independent."""
    count = len(covariance)
    result = np.diag(np.append(np.zeros(count), np.square(stds)))
    result[:count, :count] = covariance
    return result


def _by_terms_and_own(
    load: ReferenceMotion,
    terms: int,
    own: _Own,
) -> FloatArray:
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
    inverse = np.linalg.pinv(
        correlation,
        rcond=LEAST_EIGENVALUE,
        hermitian=True,
    )
    result: FloatArray = inverse @ (calibration.scale_of_load.covariance / std) / std
    return result


def scale_variance_alone(calibration: MotionCalibration) -> float:
    """Variance of the relative scale were the arm's terms known."""
    variance = calibration.torque_scale_std**2
    if calibration.scale_of_load is None:
        return variance
    explained = float(scale_by_terms(calibration) @ calibration.scale_of_load.covariance)
    return max(variance - explained, 0.0)
