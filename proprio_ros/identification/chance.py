"""What chance does: densities and limits without `scipy.stats`, which takes longer to import than a push takes to weigh."""

from __future__ import annotations

import math

import numpy as np

MISFIT_SIGMAS = 3.0902
"""A fit worse than chance makes one in a thousand (so many standard deviations of a normal) contradicts the model."""


def normal_density(off: float, std: float) -> float:
    """Density of a normal distribution so far from its mean."""
    away = off / std
    return float(np.exp(-(away**2) / 2.0) / np.sqrt(2.0 * np.pi) / std)


def chi2_tail(square: float, dof: float) -> float:
    """Probability of a larger chi-square."""
    from scipy.special import chdtrc

    return float(chdtrc(dof, square))


def chi2_limit(dof: float, sigmas: float = MISFIT_SIGMAS) -> float:
    """Chi-square that chance exceeds as rarely as a normal exceeds ``sigmas`` standard deviations on one side."""
    from scipy.special import chdtri, ndtr

    return float(chdtri(dof, ndtr(-sigmas)))


def beyond_chance(
    chi2: float,
    dof: float,
    sigmas: float = MISFIT_SIGMAS,
) -> bool:
    """Whether chi-square exceeds `chi2_limit`.

    Args:
        chi2: Sum of squares, each in its variance.
        dof: Degrees of freedom.
        sigmas: Two or more.
    """
    # the distribution leans to the right: its limit is beyond that of a normal of its mean and variance
    if chi2 <= dof + sigmas * math.sqrt(2.0 * dof):
        return False
    # nor does chance reach the bound of Laurent and Massart (Ann. Stat. 28, 2000, lemma 1) as often
    rare = -math.log(0.5 * math.erfc(sigmas / math.sqrt(2.0)))
    if chi2 > dof + 2.0 * math.sqrt(dof * rare) + 2.0 * rare:
        return True
    return chi2 > chi2_limit(dof, sigmas)
