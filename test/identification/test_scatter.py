"""What data say of how far terms scatter: against the same by sampling, and on robots that repeat and that do not."""

from __future__ import annotations

import numpy as np
import pytest

from proprio_ros.identification.scatter import BELIEVED, median_spread

RUNS, SHARED = 12, 4


def fitted(
    spread: float, seed: int, prior: float = 1.0, noise: float = 0.3
) -> tuple[np.ndarray, np.ndarray]:
    """Terms of runs with so much spread, and their covariance, after a fit with shared unknowns that take part of them up."""
    rng = np.random.default_rng(seed)
    terms = spread * rng.standard_normal(RUNS)
    shared = rng.standard_normal((RUNS, SHARED))
    design = np.hstack([np.eye(RUNS), shared])
    data = terms + shared @ rng.normal(0.0, 10.0, SHARED) + noise * rng.standard_normal(RUNS)
    precision = design.T @ design / noise**2
    precision += np.diag([prior**-2.0] * RUNS + [1e-4] * SHARED)
    covariance = np.linalg.inv(precision)
    found = covariance @ design.T @ data / noise**2
    return found[:RUNS], covariance[:RUNS, :RUNS]


def spread_found(spread: float, seed: int, prior: float = 1.0) -> float:
    found, covariance = fitted(spread, seed, prior)
    return median_spread(1.0, np.zeros(RUNS), found, covariance, np.full(RUNS, prior**2))


def test_it_is_the_same_whatever_prior_the_fit_had() -> None:
    assert spread_found(0.5, 3, prior=0.7) == pytest.approx(spread_found(0.5, 3, prior=2.0), 1e-6)


@pytest.mark.parametrize("spread", [1.0, 3.0])
def test_terms_that_scatter_show_by_how_much(spread: float) -> None:
    found = [spread_found(spread, seed) for seed in range(60)]
    assert np.median(found) == pytest.approx(spread, rel=0.25)


def test_terms_that_do_not_are_told_from_those_that_are_stated() -> None:
    found = [spread_found(0.0, seed) for seed in range(60)]
    assert np.median(found) == BELIEVED


def test_what_is_known_of_each_term_is_no_scatter() -> None:
    found, covariance = fitted(1.0, 5)
    stated = median_spread(1.0, np.full(RUNS, 1.0), found, covariance, np.ones(RUNS))
    assert stated < spread_found(1.0, 5)


def test_without_data_it_is_the_stated_one() -> None:
    nothing = median_spread(2.0, np.zeros(2), np.zeros(2), np.eye(2), np.ones(2))
    assert nothing == pytest.approx(2.0, rel=0.15)
