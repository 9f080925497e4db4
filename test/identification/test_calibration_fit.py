"""The noise that a calibration learns from its runs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from proprio_ros.identification.calibration_fit import (
    EVIDENCE_ROUNDS,
    PSEUDO_RUNS,
    Noise,
    _Approach,
    spread_of_runs,
)


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


def test_a_spread_whose_evidence_swings_is_approached() -> None:
    approach = _Approach()
    noise = Noise(1.0, 0.0, 1e-3, 0.0, 0.0, 0.0)
    for _ in range(EVIDENCE_ROUNDS):
        found = 9e-3 if noise.torque_disturbance < 1e-3 else 0.4e-3
        noise = approach.towards(replace(noise, torque_disturbance=found), noise)
    assert noise.torque_disturbance == pytest.approx(1e-3, rel=0.5)


def test_a_spread_that_is_stated_to_be_none_stays_none() -> None:
    noise = Noise(1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert _Approach().towards(noise, noise) == noise
