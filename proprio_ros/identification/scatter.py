"""How far terms of recordings or runs scatter that nobody stated: a prior of their spread, and what data say of it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from proprio_ros.calibration_files.torque_spread import LEAST, MOST, STEPS, TorqueSpread
from proprio_ros.quantity import Z95
from proprio_ros.records import FloatArray

BELIEVED = 0.5
"""No spread is taken to be less than this part of what is stated. What a model lacks looks like terms that scatter, and runs that
are alike do not show it: without this bound 120 random robots had an answer 3.8 standard deviations off, and 3.4 with it."""
HALVINGS = 40


def half_cauchy(factors: FloatArray) -> FloatArray:
    """Prior density of spreads in parts of what is stated of them (Gelman 2006, Bayesian Analysis 1), of the factors' shape."""
    density: FloatArray = 1.0 / (1.0 + np.square(factors))
    return density


def under(
    variances: FloatArray, information: FloatArray, side: FloatArray
) -> tuple[float, FloatArray]:
    """The terms under a prior about nothing, and how likely it makes the data (see how_it_works, log p of lambda).

    Args:
        variances: Of the prior, shape (T,).
        information: Of the data, shape (T, T).
        side: What the data say, weighted alike, shape (T,).

    Returns: Logarithm of the data's likelihood over that without the terms, and the terms, shape (T,).
    """
    widened = np.eye(len(side)) + variances[:, None] * information
    values = np.asarray(
        np.linalg.solve(widened, variances * side),
        np.float64,
    )
    return 0.5 * float(side @ values - np.linalg.slogdet(widened)[1]), values


@dataclass(frozen=True, eq=False)
class Terms:
    """Torques of T runs that differ from what the robot delivers otherwise, as a fit found them.

    Attributes:
        known: Variance that each has beside the spread [N^2 m^2], shape (T,).
        found: The terms after the fit [N m], shape (T,).
        covariance: Of these, after it, shape (T, T).
        prior: Variances under which they were fitted, shape (T,).
    """

    known: FloatArray
    found: FloatArray
    covariance: FloatArray
    prior: FloatArray

    @property
    def data(self) -> tuple[FloatArray, FloatArray]:
        """What the data say without that prior: information, shape (T, T), and what they say weighted alike, shape (T,)."""
        precision = np.asarray(np.linalg.inv(self.covariance), np.float64)
        information = precision - np.diag(1.0 / self.prior).astype(np.float64)
        return information, precision @ self.found

    def log_likelihoods(self, spread: TorqueSpread) -> FloatArray:
        """Logarithms of how likely each standard deviation makes the data, over that without the terms, shape (STEPS,)."""
        variances: FloatArray = self.known + np.square(spread.deviations)[:, None]
        information, side = self.data
        return np.array([under(each, information, side)[0] for each in variances])


def expected(stated: float) -> TorqueSpread:
    """What is believed before there are any runs; ``stated`` is the robot file's standard deviation [N m]."""
    factors: FloatArray = np.geomspace(LEAST, MOST, STEPS)
    # equal steps of the logarithm
    weights = half_cauchy(factors) * factors
    return TorqueSpread(stated, weights / weights.sum())


def given(spread: TorqueSpread, terms: Terms) -> TorqueSpread:
    """What is believed after runs, each standard deviation as probable as it makes them.

    What was fitted beside the terms takes part of them up, so their estimates are no sample of them: a machine that repeats is not
    told by small estimates, but by data that need no such terms.
    """
    logs = terms.log_likelihoods(spread)
    weights = spread.weights * np.exp(logs - logs.max())
    return TorqueSpread(spread.stated, weights / weights.sum())


def log_evidence(spread: TorqueSpread, terms: Terms) -> float:
    """Logarithm of how probable the data are under all that is believed, over that under the prior of their fit, at its best."""
    logs = terms.log_likelihoods(spread)
    highest = float(logs.max())
    information, side = terms.data
    best = 0.5 * float(side @ under(terms.prior, information, side)[1])
    return highest + float(np.log(spread.weights @ np.exp(logs - highest))) - best


def median_of(spread: TorqueSpread) -> float:
    """The standard deviation that is as often exceeded as not [N m]."""
    below = np.cumsum(spread.weights)
    median = np.exp(np.interp(0.5, below, np.log(spread.deviations)))
    return float(max(median, BELIEVED * spread.stated))


def covering(spread: TorqueSpread) -> float:
    """Standard deviation of the normal distribution whose 95 % interval holds as often as that of all that may be [N m]."""
    scales = math.sqrt(2.0) * spread.deviations
    low = 0.0
    high = float(spread.deviations[-1])
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        holds = np.array([math.erf(Z95 * middle / scale) for scale in scales])
        if float(spread.weights @ holds) < math.erf(Z95 / math.sqrt(2.0)):
            low = middle
        else:
            high = middle
    return max(high, BELIEVED * spread.stated)
