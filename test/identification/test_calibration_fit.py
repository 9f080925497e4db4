"""The noise that a calibration learns from its runs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from proprio_ros.identification.calibration_fit import PSEUDO_RUNS, Noise, spread_of_runs


def test_few_runs_leave_the_files_word_and_many_replace_it() -> None:
    rng = np.random.default_rng(4)
    found = rng.normal(0.0, 0.3, 4000)
    assert spread_of_runs(0.1, found, np.ones(4000)) == pytest.approx(0.3, rel=0.03)
    assert spread_of_runs(
        0.1,
        np.zeros(0),
        np.zeros(0),
    ) == pytest.approx(0.1)
    assert spread_of_runs(0.1, np.zeros(2), np.ones(2)) == pytest.approx(
        0.1 * np.sqrt(PSEUDO_RUNS / (PSEUDO_RUNS + 2.0))
    )


def test_two_per_cent_is_near() -> None:
    noise = Noise(1.0, 3e-4, 1e-3, 0.01)
    assert noise.near(replace(noise, residual_scale=1.01)) and not noise.near(
        replace(noise, stamp_jitter_s=4e-4)
    )
