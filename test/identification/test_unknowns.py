"""Priors that belong together."""

from __future__ import annotations

import numpy as np
import pytest

from proprio_ros.errors import ConfigurationError
from proprio_ros.identification.unknowns import Coordinates, Unknown
from proprio_ros.kinds import KINDS, Key, key_of, label_of, name_of


def unknowns(*names: str) -> list[Unknown]:
    return [
        Unknown(
            "zero",
            0.1 * n,
            0.5 + n,
            scope=name,
        )
        for n, name in enumerate(names)
    ]


def keys(*names: str) -> list[Key]:
    return [("zero", name) for name in names]


def test_a_correlated_prior_is_the_inverse_of_its_covariance_whatever_the_order() -> None:
    rng = np.random.default_rng(1)
    factor = rng.normal(size=(3, 3)) * np.array([1e-4, 1.0, 1e3])[:, None]
    covariance = factor @ factor.T
    coordinates = Coordinates(
        unknowns("c", "x", "a", "b"),
        (keys("a", "b", "c"), covariance),
    )
    order = [2, 0, 1]  # c, a, b
    own = np.ix_([0, 2, 3], [0, 2, 3])
    product = coordinates.prior_precision[own] @ covariance[np.ix_(order, order)]
    np.testing.assert_allclose(
        product,
        np.eye(3),
        atol=1e-7,
    )
    assert coordinates.prior_precision[1, 1] == pytest.approx(1.0 / 1.5**2)
    assert not coordinates.prior_precision[1, [0, 2, 3]].any()


def test_what_is_not_asked_for_is_marginalised_out() -> None:
    """The prior of some of the unknowns is that part of the covariance, not of its inverse."""
    covariance = np.array([[4.0, 1.8, 0.0], [1.8, 1.0, 0.3], [0.0, 0.3, 2.0]])
    coordinates = Coordinates(
        unknowns("a", "c"),
        (keys("a", "b", "c"), covariance),
    )
    np.testing.assert_allclose(
        coordinates.prior_precision,
        np.diag([0.25, 0.5]),
        atol=1e-12,
    )


def test_without_correlations_every_prior_stands_alone() -> None:
    flat = Unknown("payload_mass", 0.0, np.inf)
    coordinates = Coordinates([*unknowns("a", "b"), flat])
    np.testing.assert_allclose(
        coordinates.prior_precision,
        np.diag([4.0, 1.0 / 2.25, 0.0]),
    )


def test_a_name_and_its_key_are_the_same_thing_for_every_kind() -> None:
    scopes = {"joint": "joint3", "link": "link5", "run": 12}
    for kind, about in KINDS.items():
        unknown = Unknown(
            kind,
            0.0,
            1.0,
            scope=scopes.get(about.of),
        )
        assert key_of(unknown.name) == unknown.key and name_of(unknown.key) == unknown.name
        assert (
            unknown.unit == about.unit
            and unknown.label == label_of(unknown.key)
            and about.label in unknown.label
        )
        assert unknown.shared == (about.of != "run")
    assert Unknown("coulomb", 0.0, 1.0, scope="joint3").name == "coulomb[joint3]"
    # a joint may be called by a number, and a run is counted from 1 where people read
    assert key_of("coulomb[0]") == ("coulomb", "0") and key_of("q0[0]") == ("q0", 0)
    assert label_of(("q0", 0)) == "start position, run 1" and label_of("encoder") == "encoder"


def test_a_kind_that_nobody_described_is_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"weight\[joint3\]: no such kind"):
        Unknown("weight", 0.0, 1.0, scope="joint3")
