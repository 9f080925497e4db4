"""What a mass errs by: covariances of the payload's parameters by their cause, and the interval that follows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import stdtr

from proprio_ros.calibration_files.motions import MotionCalibration
from proprio_ros.identification.regression.arm_terms import ArmTerms
from proprio_ros.identification.regression.known_load import (
    covariance_with_scale,
    deviations_with_scale,
    scale_variance_alone,
)
from proprio_ros.identification.regression.motion_equations import Problem
from proprio_ros.identification.regression.motion_prior import (
    LEAST_TORQUE_STD,
    LOAD_FRICTION_SPREAD,
    calibrated_terms,
)
from proprio_ros.identification.regression.recording_variability import (
    DIFFERS,
    WORDS,
    effective_freedom,
)
from proprio_ros.identification.regression.solve import Followed, Solution, larger
from proprio_ros.records import FloatArray
from proprio_ros.robot.regressor import PARAMETERS

STRETCHES = "what differs from stretch to stretch"
UNDETERMINED = "what the motion does not determine"
CALIBRATION = "what the calibration leaves open"
CONSTANTS = "torque constants"
"""Of what a mass errs by, beside what recordings differ by (`recording_variability.WORDS`)."""


@dataclass(frozen=True)
class Mixture:
    """What a mass errs by, as a mixture over F spreads of what recordings differ by."""

    weights: FloatArray  # how likely each is, shape (F,), sum 1
    mass: FloatArray  # by how much the mass by each differs from the estimate [kg], shape (F,)
    variances: FloatArray  # of the mass by each [kg^2], shape (F,)
    # variance [kg^2] and degrees of freedom of the parts of it that a few stretches or recordings say
    freedom: Sequence[tuple[float, float]]

    def half_width(self) -> float:
        """Of the 95 % interval about the estimate [kg]."""
        # variances by no spread are a difference of two that are nearly the same
        variances = np.maximum(self.variances, 1e-9 * self.variances.max())
        effective = effective_freedom(variances, self.freedom)
        stds = np.sqrt(variances)

        def outside(half: float) -> float:
            above = stdtr(effective, (self.mass - half) / stds)
            below = stdtr(effective, (-self.mass - half) / stds)
            return float(self.weights @ (above + below)) - 0.05

        highest = float(stds.max() + np.abs(self.mass).max())
        while outside(highest) > 0.0:
            highest *= 2.0
        return float(brentq(outside, 0.0, highest))


@dataclass(frozen=True)
class ErrorBudget:
    """What puts how much on a payload's parameters."""

    covariances: Mapping[str, FloatArray]  # by cause, each of shape (10, 10)
    quantile: float  # half width of a 95 % interval of the mass in standard deviations
    mixture: Mixture  # that it is of

    @classmethod
    def of(
        cls,
        problem: Problem,
        followed: Followed,
        calibration: MotionCalibration,
        misfit: float,
        stretches: int,
    ) -> ErrorBudget:
        """The budget of a weighing.

        Args:
            problem: Its equations.
            followed: Their solution.
            calibration: Of the arm.
            misfit: How much worse the motions are explained than the empty ones, as a ratio of squares.
            stretches: Of the motions with the payload.
        """
        solution = followed.estimate
        by_prior = solution.by_prior()  # (10, U)
        covariances = {
            STRETCHES: solution.noise(),
            UNDETERMINED: _of_own_size(solution, by_prior, calibration),
            **_of_calibration(problem, solution, by_prior, calibration),
            **_of_recordings(problem, followed, by_prior),
        }
        # what is explained worse than the empty motions is not only noise: the arm is not where it was calibrated
        covariances[CALIBRATION] *= max(1.0, misfit)
        variances = {name: float(part[0, 0]) for name, part in covariances.items()}
        # what few stretches or recordings say of their own scatter is uncertain
        freedom = [
            (variances[STRETCHES], stretches - 1.0),
            (variances[CALIBRATION], calibration.stretches - 1.0),
        ]
        for word, number in solution.variability.by_word.items():
            if word != DIFFERS:
                freedom.append((variances[word], number))
        total = sum(variances.values())
        mixture = Mixture(
            followed.weights,
            followed.mass,
            total - float(followed.scatter[0, 0]) + followed.more_variance,
            freedom,
        )
        return cls(covariances, mixture.half_width() / float(np.sqrt(total)), mixture)

    @property
    def covariance(self) -> FloatArray:
        """Of the payload's parameters by all causes together, shape (10, 10)."""
        result: FloatArray = np.sum(
            list(self.covariances.values()),
            axis=0,
        )
        return result

    def mass_stds(self, scale: float) -> dict[str, float]:
        """What each cause puts on the mass [kg], where true torque is so many times that of the robot file's constants."""
        return {
            name: scale * float(np.sqrt(float(part[0, 0])))
            for name, part in self.covariances.items()
        }


def _of_own_size(
    solution: Solution, by_prior: FloatArray, calibration: MotionCalibration
) -> FloatArray:
    """How the payload follows the prior of its own size, and of what gears lose under another load, covariance, (10, 10)."""
    terms = ArmTerms(len(calibration.joints), PARAMETERS)
    opened = by_prior[:, :PARAMETERS] * solution.payload_prior
    geared = by_prior[:, terms.load_friction] * LOAD_FRICTION_SPREAD
    result: FloatArray = opened @ opened.T + geared @ geared.T
    return result


def _of_calibration(
    problem: Problem, solution: Solution, by_prior: FloatArray, calibration: MotionCalibration
) -> dict[str, FloatArray]:
    """How the payload follows the calibration's values, its torque constants apart, covariances, shape (10, 10) each."""
    count = problem.count
    follows = by_prior[:, PARAMETERS:] @ calibrated_terms(count, problem.motions)  # (10, 20 n)
    if calibration.scale_of_load is not None:
        return _of_known_load(follows, solution.values[:PARAMETERS], calibration)
    # how the payload follows each torque constant's share: the calibration's other terms lean on it, too
    shares = calibration.covariance[:, ArmTerms(count).torque_shares]
    by_share = follows @ shares / LEAST_TORQUE_STD  # (10, n)
    apart = by_share @ by_share.T
    by_calibration = larger(
        follows @ calibration.deviations.T @ calibration.deviations @ follows.T,
        follows @ calibration.covariance @ follows.T - apart,
    )
    # nobody knows whether all torque constants are off together or each on its own: the larger covers every mixture
    together = calibration.torque_scale_std * solution.values[:PARAMETERS]
    return {
        CALIBRATION: by_calibration,
        CONSTANTS: larger(np.outer(together, together), apart),
    }


def _of_known_load(
    follows: FloatArray, payload: FloatArray, calibration: MotionCalibration
) -> dict[str, FloatArray]:
    """The same where a known load has told the arm's terms and their scale together.

    Args:
        follows: How the payload follows the calibration's values, shape (10, P).
        payload: Its parameters, which go with the scale, shape (10,).
        calibration: Of the arm.
    """
    both = np.column_stack([follows, payload])  # (10, P + 1)
    pulls = both @ deviations_with_scale(calibration).T
    whole = larger(pulls @ pulls.T, both @ covariance_with_scale(calibration) @ both.T)
    of_scale = scale_variance_alone(calibration) * np.outer(payload, payload)
    return {CALIBRATION: whole - of_scale, CONSTANTS: of_scale}


def _of_recordings(
    problem: Problem, followed: Followed, by_prior: FloatArray
) -> dict[str, FloatArray]:
    """How the payload follows what recordings differ by, covariances by word, shape (10, 10) each."""
    variability = followed.estimate.variability
    words = np.tile(
        [WORDS[kind] for kind in variability.kinds],
        problem.motions,
    )
    own = slice(problem.own(0).start, None)
    follows = by_prior[:, own] * np.tile(variability.std, problem.motions)
    covariances = {}
    for word in dict.fromkeys(WORDS.values()):
        mine = follows[:, words == word]
        covariances[word] = mine @ mine.T
        covariances[word] += followed.scatter[:PARAMETERS, :PARAMETERS] if word == DIFFERS else 0.0
    return covariances
