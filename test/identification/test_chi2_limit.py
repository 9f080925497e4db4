"""Rules of the verdict that stand on formulas."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2, norm

from proprio_ros.identification.gates import chi2_limit


@pytest.mark.parametrize("dof", [1, 4, 9, 24, 100, 1000])
def test_limit_of_the_misfit(dof: int) -> None:
    assert chi2_limit(dof) == pytest.approx(chi2.ppf(0.999, dof), rel=1e-4)
    assert chi2_limit(dof, 5.0) == pytest.approx(chi2.isf(norm.sf(5.0), dof))
    rng = np.random.default_rng(dof)
    worse = np.mean(rng.chisquare(dof, 200_000) > chi2_limit(dof))
    assert 0.5e-3 < worse < 1.6e-3
