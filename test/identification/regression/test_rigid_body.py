"""Inertial parameters that a body can have, against bodies made of point masses."""

from __future__ import annotations

import numpy as np
import pytest

from proprio_ros.identification.regression.rigid_body import (
    inertia_about_centre,
    nearest_body,
    pseudo_inertia,
)
from proprio_ros.robot.regressor import body_parameters

STDS = np.array([0.01, *[0.005] * 3, *[0.02] * 6])


def points(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Masses [kg], places [m] and the ten parameters of a few points: a body by definition."""
    rng = np.random.default_rng(seed)
    masses = rng.uniform(0.1, 0.5, 6)
    places = rng.normal(0.1, 0.1, (6, 3))
    inertia = sum(
        m * (p @ p * np.eye(3) - np.outer(p, p)) for m, p in zip(masses, places, strict=True)
    )
    upper = inertia[np.triu_indices(3)]
    return masses, places, np.concatenate([[masses.sum()], masses @ places, upper])


@pytest.mark.parametrize("seed", range(3))
def test_a_body_stays_what_it_is(seed: int) -> None:
    _, _, parameters = points(seed)
    assert body_parameters(pseudo_inertia(parameters)) == pytest.approx(parameters, abs=1e-14)
    assert nearest_body(parameters, np.diag(STDS**2)) == pytest.approx(parameters, abs=1e-14)


@pytest.mark.parametrize("seed", range(5))
def test_an_impossible_estimate_becomes_a_body_that_is_as_near_as_the_truth(seed: int) -> None:
    """Noise makes a small body's inertia negative; the true body is one of those that were looked among."""
    rng = np.random.default_rng(seed)
    _, _, truth = points(seed)
    mixing = np.eye(10) + 0.3 * rng.normal(size=(10, 10))
    covariance = (mixing @ mixing.T) * np.outer(10.0 * STDS, 10.0 * STDS)
    estimate = truth + np.linalg.cholesky(covariance) @ rng.normal(size=10) * 2.0
    estimate[0] = truth[0]
    estimate[4] = -0.05
    assert np.linalg.eigvalsh(pseudo_inertia(estimate)).min() < 0.0
    body = nearest_body(estimate, covariance)
    assert body[0] == pytest.approx(estimate[0])
    smallest = np.linalg.eigvalsh(pseudo_inertia(body)).min()
    assert smallest > 0.0

    by_mass = np.outer(covariance[1:, 0], covariance[0, 1:]) / covariance[0, 0]
    rest = covariance[1:, 1:] - by_mass

    def distance(other: np.ndarray) -> float:
        off = (other - estimate)[1:]
        return float(off @ np.linalg.solve(rest, off))

    assert distance(body) <= distance(truth) * (1.0 + 1e-6)
    # and no neighbour among bodies is nearer
    factor = np.linalg.cholesky(pseudo_inertia(body))
    for _ in range(200):
        other = factor + 1e-3 * rng.normal(size=(4, 4)) * np.abs(factor).max()
        near = other @ other.T
        near *= estimate[0] / near[3, 3]
        assert distance(body_parameters(near)) > distance(body) * (1.0 - 1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_inertia_about_the_centre_and_its_gradient(seed: int) -> None:
    masses, places, parameters = points(seed)
    value, gradient = inertia_about_centre(parameters)
    away = places - masses @ places / masses.sum()
    expected = sum(
        m * (p @ p * np.eye(3) - np.outer(p, p)) for m, p in zip(masses, away, strict=True)
    )
    assert value == pytest.approx(
        expected[np.triu_indices(3)],
        abs=1e-14,
    )
    for column in range(10):
        step = np.zeros(10)
        step[column] = 1e-6
        ahead = inertia_about_centre(parameters + step)[0]
        behind = inertia_about_centre(parameters - step)[0]
        assert gradient[:, column] == pytest.approx((ahead - behind) / 2e-6, abs=1e-8)
