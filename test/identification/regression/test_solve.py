"""The mean under a prior, and how far it lies from the prior's: against plain inverses, and where these have no digits left."""

from __future__ import annotations

import numpy as np
import pytest

from proprio_ros.identification.regression.solve import Prior, distance_from_prior, posterior

UNKNOWNS = 6


def drawn_prior(generator: np.random.Generator, spread: np.ndarray) -> Prior:
    """Correlated unknowns of so different standard deviations, shape (U,)."""
    mixed = np.eye(UNKNOWNS) + 0.4 * generator.standard_normal((UNKNOWNS, UNKNOWNS))
    correlated = spread[:, None] * mixed
    return Prior(spread * generator.standard_normal(UNKNOWNS), correlated @ correlated.T)


@pytest.mark.parametrize("seed", range(4))
def test_mean_and_distance_are_those_of_the_textbook(seed: int) -> None:
    generator = np.random.default_rng(seed)
    prior = drawn_prior(generator, np.array([1.0, 0.3, 2.0, 0.1, 5.0, 1.0]))
    design = generator.standard_normal((20, UNKNOWNS))
    measured = generator.standard_normal(20)
    information = design.T @ design
    side = design.T @ measured
    of_prior = np.linalg.inv(prior.covariance)
    mean = np.linalg.solve(information + of_prior, side + of_prior @ prior.values)
    assert np.allclose(posterior(information, side, prior)[0], mean, rtol=1e-9)
    moved = mean - prior.values
    assert distance_from_prior(information, side, prior) == pytest.approx(
        moved @ of_prior @ moved, rel=1e-9
    )


@pytest.mark.parametrize("known", [1e6, 1e12, 1e18])
def test_the_distance_keeps_its_digits_where_data_know_everything(known: float) -> None:
    # the difference between what data say and what they know of the mean has none: it was as large as a likelihood's, either sign
    generator = np.random.default_rng(7)
    prior = drawn_prior(generator, np.ones(UNKNOWNS))
    true = generator.standard_normal(UNKNOWNS)
    design = generator.standard_normal((20, UNKNOWNS))
    information = known * design.T @ design
    moved = true - prior.values
    expected = moved @ np.linalg.solve(prior.covariance, moved)
    found = distance_from_prior(information, information @ true, prior)
    assert found == pytest.approx(expected, rel=1e-4)
