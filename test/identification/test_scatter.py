"""What data say of how far terms scatter: against the same by sampling, and on robots that repeat and that do not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from proprio_ros.calibration_files.torque_spread import TorqueSpread
from proprio_ros.identification.scatter import (
    BELIEVED,
    Terms,
    covering,
    expected,
    given,
    median_of,
)
from proprio_ros.quantity import Z95

RUNS, SHARED = 12, 4
DRAWS = 200_000


def fitted(spread: float, seed: int, prior: float = 1.0, noise: float = 0.3) -> Terms:
    """Terms of runs with so much spread, after a fit with shared unknowns that take part of them up."""
    rng = np.random.default_rng(seed)
    terms = spread * rng.standard_normal(RUNS)
    shared = rng.standard_normal((RUNS, SHARED))
    design = np.hstack([np.eye(RUNS), shared])
    data = terms + shared @ rng.normal(0.0, 10.0, SHARED) + noise * rng.standard_normal(RUNS)
    precision = design.T @ design / noise**2
    precision += np.diag([prior**-2.0] * RUNS + [1e-4] * SHARED)
    covariance = np.linalg.inv(precision)
    found = covariance @ design.T @ data / noise**2
    return Terms(np.zeros(RUNS), found[:RUNS], covariance[:RUNS, :RUNS], np.full(RUNS, prior**2))


def spread_found(spread: float, seed: int, prior: float = 1.0) -> float:
    return median_of(given(expected(1.0), fitted(spread, seed, prior)))


def both(one: Terms, other: Terms) -> Terms:
    """Of two fits that share nothing."""
    count = len(one.found)
    covariance = np.zeros((2 * count, 2 * count))
    covariance[:count, :count] = one.covariance
    covariance[count:, count:] = other.covariance
    vectors = [
        np.concatenate([getattr(one, name), getattr(other, name)])
        for name in ("known", "found", "prior")
    ]
    known, found, prior = vectors
    return Terms(known, found, covariance, prior)


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
    terms = fitted(1.0, 5)
    known = replace(terms, known=np.full(RUNS, 1.0))
    assert median_of(given(expected(1.0), known)) < spread_found(1.0, 5)


def test_without_data_it_is_the_stated_one() -> None:
    nothing = Terms(np.zeros(2), np.zeros(2), np.eye(2), np.ones(2))
    assert median_of(given(expected(2.0), nothing)) == pytest.approx(2.0, rel=0.15)


@pytest.mark.parametrize("spread", [0.3, 1.0, 4.0])
def test_one_fit_after_the_other_says_what_both_say_together(spread: float) -> None:
    one = fitted(spread, 1)
    other = fitted(spread, 2)
    in_turn = given(given(expected(1.0), one), other)
    np.testing.assert_allclose(
        in_turn.weights, given(expected(1.0), both(one, other)).weights, atol=1e-12
    )


@pytest.mark.parametrize("spread", [1.0, 2.0, 4.0])
def test_the_interval_holds_what_all_that_may_be_would_draw(spread: float) -> None:
    believed = given(expected(1.0), fitted(spread, 7))
    rng = np.random.default_rng(11)
    deviations = rng.choice(believed.deviations, DRAWS, p=believed.weights)
    drawn = deviations * rng.standard_normal(DRAWS)
    held = np.mean(np.abs(drawn) < Z95 * covering(believed))
    # of so many draws 95 % are known to 0.05 %
    assert held == pytest.approx(0.95, abs=0.003)
    assert covering(believed) > median_of(believed)


def test_what_is_known_exactly_covers_itself() -> None:
    weights = np.zeros(len(expected(1.0).weights))
    weights[20] = 1.0
    sure = TorqueSpread(0.001, weights)
    assert covering(sure) == pytest.approx(sure.deviations[20], rel=1e-6)
