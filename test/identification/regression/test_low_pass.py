"""The low-pass filter of motions is SciPy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, filtfilt

from proprio_ros.identification.regression.low_pass import EXTENDED, low_passed


@pytest.mark.parametrize("share", [0.01, 0.12, 0.5, 0.9])
@pytest.mark.parametrize("samples", [EXTENDED + 1, 40, 3000])
def test_it_is_scipys(share: float, samples: int) -> None:
    rng = np.random.default_rng(samples)
    signal = 3.0 + np.cumsum(rng.standard_normal((samples, 3)), axis=0)
    theirs = filtfilt(*butter(2, share), signal, axis=0)
    assert np.abs(low_passed(signal, share) - theirs).max() < 1e-9 * np.abs(theirs).max()
    assert np.ptp(theirs) > 0.0
