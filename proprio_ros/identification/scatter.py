"""How far terms of recordings or runs scatter that nobody stated: a prior of their spread, and what data say of it."""

from __future__ import annotations

import numpy as np

from proprio_ros.records import FloatArray

LEAST, MOST, STEPS = 0.03, 10.0, 36
"""The grid of a spread, in parts of what is stated of it: a robot beyond six times that is refused."""
BELIEVED = 0.5
"""No spread is taken to be less than this part of what is stated. What a model lacks looks like terms that scatter, and runs that
are alike do not show it: without this bound 120 random robots had an answer 3.8 standard deviations off, and 3.4 with it."""


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


def median_spread(
    stated: float,
    known: FloatArray,
    found: FloatArray,
    covariance: FloatArray,
    prior: FloatArray,
) -> float:
    """Median of the standard deviations that T terms may have in common, each as likely as it makes the data.

    Without data it is the one that is expected.

    What was fitted beside the terms takes part of them up, so their estimates are no sample of them: a machine that repeats is not
    told by small estimates, but by data that need no such terms.

    Args:
        stated: Standard deviation that is expected.
        known: Variance that each term has beside that, shape (T,).
        found: The terms after a fit, shape (T,).
        covariance: Of these, after it, shape (T, T).
        prior: Variances under which they were fitted, shape (T,).
    """
    precision = np.asarray(np.linalg.inv(covariance), np.float64)
    information = precision - np.diag(1.0 / prior).astype(np.float64)
    side = precision @ found
    factors: FloatArray = np.geomspace(LEAST, MOST, STEPS)
    variances: FloatArray = known + np.square(factors * stated)[:, None]
    logs = np.array([under(each, information, side)[0] for each in variances])
    # equal steps of the logarithm
    weights = half_cauchy(factors) * factors * np.exp(logs - logs.max())
    below = np.cumsum(weights) / weights.sum()
    median = np.exp(np.interp(0.5, below, np.log(factors)))
    return float(stated * max(median, BELIEVED))
