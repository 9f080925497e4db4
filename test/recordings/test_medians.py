"""Medians of neighbours are those of SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import median_filter

from proprio_ros.recordings.medians import running_median


@pytest.mark.parametrize("width", [5, 7, 11])
@pytest.mark.parametrize("count", [12, 101])
@pytest.mark.parametrize(("beyond", "mode"), [("edge", "nearest"), ("reflect", "mirror")])
def test_as_scipy_has_it(width: int, count: int, beyond: str, mode: str) -> None:
    rng = np.random.default_rng(count)
    for values in (rng.normal(size=count), rng.integers(-(10**17), 10**17, size=count)):
        found = running_median(values, width, beyond)
        assert found.dtype == values.dtype
        np.testing.assert_array_equal(found, median_filter(values, width, mode=mode))


def test_of_fewer_than_the_width() -> None:
    values = np.array([3.0, 1.0, 2.0])
    np.testing.assert_array_equal(
        running_median(values, 11), median_filter(values, 11, mode="nearest")
    )
