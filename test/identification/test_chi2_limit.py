"""Rules of the verdict that stand on formulas."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2, norm

from proprio_ros.identification.chance import (
    MISFIT_SIGMAS,
    beyond_chance,
    chi2_limit,
    chi2_tail,
    normal_density,
)


@pytest.mark.parametrize("dof", [1, 4, 9, 24, 100, 1000])
def test_limit_of_the_misfit(dof: int) -> None:
    assert chi2_limit(dof) == pytest.approx(chi2.ppf(0.999, dof), rel=1e-4)
    assert chi2_limit(dof, 5.0) == pytest.approx(chi2.isf(norm.sf(5.0), dof))
    rng = np.random.default_rng(dof)
    worse = np.mean(rng.chisquare(dof, 200_000) > chi2_limit(dof))
    assert 0.5e-3 < worse < 1.6e-3


@pytest.mark.parametrize("dof", [0.3, 1.0, 2.5, 9.0, 24.0, 100.0, 1000.0, 1e6])
@pytest.mark.parametrize("sigmas", [2.0, MISFIT_SIGMAS, 5.0])
def test_beyond_chance_is_beyond_the_limit(dof: float, sigmas: float) -> None:
    limit = chi2_limit(dof, sigmas)
    for share in (0.0, 0.5, 0.9, 0.999, 1.001, 1.1, 2.0):
        assert beyond_chance(share * limit, dof, sigmas) is (share > 1.0)


def test_as_scipy_says() -> None:
    for off in (-7.0, -0.3, 0.0, 0.1, 2.5, 50.0):
        for std in (0.02, 1.0, 3.7):
            assert normal_density(off, std) == norm.pdf(off, scale=std)
    for square in (0.0, 0.5, 3.0, 80.0):
        assert chi2_tail(square, 4) == chi2.sf(square, 4)
