"""Rules of the verdict that stand on formulas."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from proprio_ros.identification.gates import chi2_limit


@pytest.mark.parametrize("dof", [4, 9, 24, 100, 1000])
def test_limit_of_the_misfit(dof: int) -> None:
    assert chi2_limit(dof) == pytest.approx(chi2.ppf(0.999, dof), rel=0.02)
    rng = np.random.default_rng(dof)
    worse = np.mean(rng.chisquare(dof, 200_000) > chi2_limit(dof))
    assert 0.5e-3 < worse < 1.6e-3
