"""What a recording shows by itself is compared with what a calibration's own recordings show."""

from __future__ import annotations

import numpy as np
import pytest

from proprio_ros.calibration_files.own_terms import COULOMB, VISCOUS, OwnTerms
from proprio_ros.identification.same_joint import (
    LIKELY_ANOTHER,
    TOGETHER,
    OtherJoint,
    another_joint,
    compared,
    determined,
    mean_of,
    outside,
)

NAMES = (COULOMB, VISCOUS)
USUAL = np.array([0.03, 0.01])
FRICTION = np.array([0.15, 0.02])


def shown(values: np.ndarray, std: float = 1e-3) -> OwnTerms:
    return OwnTerms(values, np.full(2, std), USUAL)


def drawn(
    rng: np.random.Generator,
    count: int,
) -> list[OwnTerms]:
    return [shown(FRICTION + USUAL * rng.standard_normal(2)) for _ in range(count)]


@pytest.mark.parametrize("count", [2, 3, 6])
def test_a_joint_s_own_recordings_are_seldom_taken_for_another_s(count: int) -> None:
    """They differ as is usual, and of two or three recordings that is all that is known of it."""
    rng = np.random.default_rng(4)
    draws = [
        list(
            another_joint(
                "elbow",
                NAMES,
                drawn(rng, count),
                drawn(rng, 1)[0],
            )
        )
        for _ in range(400)
    ]
    assert sum(map(bool, draws)) <= 24


def test_friction_of_another_proportion_is_another_joint_s() -> None:
    rng = np.random.default_rng(5)
    known = drawn(rng, 3)
    (refusal,) = another_joint(
        "elbow",
        NAMES,
        known,
        shown(np.array([0.14, 0.08])),
    )
    assert refusal.reasons[0].code == "another_joint"  # type: ignore[attr-defined]
    assert "elbow shows a viscous friction of" in refusal.reasons[0]
    # a term that the recording does not determine says nothing
    assert not list(
        another_joint(
            "elbow",
            NAMES,
            known,
            shown(np.array([0.14, 0.08]), std=0.1),
        )
    )


def test_recordings_that_differ_more_bear_a_larger_difference() -> None:
    now = shown(np.array([0.3, 0.02]))
    alike = [shown(FRICTION), shown(FRICTION), shown(FRICTION)]
    apart = [shown(FRICTION * [factor, 1.0]) for factor in (0.4, 1.0, 1.6)]
    assert compared(alike, now).distances[0] > 1.5 * compared(apart, now).distances[0] > 0.0


def test_recordings_that_are_asked_together_know_their_mean_better() -> None:
    together = mean_of([shown(FRICTION), shown(3.0 * FRICTION)])
    assert together.values == pytest.approx(2.0 * FRICTION)
    assert together.std == pytest.approx(np.full(2, 1e-3 / np.sqrt(2.0)))


def test_older_calibrations_and_what_is_not_finite_say_nothing() -> None:
    assert not list(another_joint("elbow", NAMES, (), shown(9.0 * FRICTION)))
    unknown = OwnTerms(
        9.0 * FRICTION,
        np.full(2, np.inf),
        USUAL,
    )
    assert not list(another_joint("elbow", NAMES, [shown(FRICTION)] * 2, unknown))


@pytest.mark.parametrize(
    ("mass_kg", "loads_kg", "word"),
    [
        (0.24, [0.5, 1.0], "light"),
        (0.26, [0.5, 1.0], ""),
        (1.9, [0.5, 1.0], ""),
        (2.1, [0.5, 1.0], "heavy"),
        (0.0, [0.0, 1.0], ""),
        (2.1, [0.0, 1.0], "heavy"),
        (0.1, [0.0, 0.0], ""),
    ],
)
def test_loads_far_outside_of_those_known_are_not_covered(
    mass_kg: float, loads_kg: list[float], word: str
) -> None:
    found = list(outside("elbow", mass_kg, loads_kg))
    assert bool(found) == bool(word)
    for refusal in found:
        assert refusal.reasons[0].code == "not_covered" and word in refusal.withheld  # type: ignore[attr-defined]


# --- how probable it is that a swing is another joint's ----------------------------------------------------------------

LOADS_KG = [0.5, 0.8]


def probability(
    now: np.ndarray,
    known: list[OwnTerms],
    mass_kg: float = 0.65,
) -> float:
    return OtherJoint.of(compared(known, shown(now), TOGETHER), mass_kg, LOADS_KG).probability


def test_terms_that_differ_together_are_nearer_than_those_that_differ_apart() -> None:
    """A warm gear has less of both; by the same shares, one up and one down, it is another gear."""
    friction = np.array([0.15, 0.05])
    known = [shown(friction)] * 3
    together = friction * 1.3
    warm = compared(known, shown(together), TOGETHER)
    other = compared(known, shown(friction * [1.3, 0.7]), TOGETHER)
    assert warm.square < 0.5 * other.square
    # one alone is as far as each term is by itself
    plain = compared(known, shown(together))
    assert plain.square == pytest.approx(float(plain.distances @ plain.distances))


def test_axes_of_one_joint_s_terms_have_the_covariance_of_what_was_drawn() -> None:
    """Of many recordings: a factor of all friction, and each term's own."""
    rng = np.random.default_rng(8)
    count = 4000
    factors = 1.0 + TOGETHER * rng.standard_normal((count, 1))
    values = FRICTION * factors + USUAL * rng.standard_normal((count, 2))
    comparison = compared([shown(each) for each in values], shown(FRICTION), TOGETHER)
    np.testing.assert_allclose(
        comparison.covariance,
        np.cov(values.T),
        rtol=0.1,
        atol=2e-6,
    )


def test_evidence_is_the_ratio_of_two_densities() -> None:
    """Over all terms that another joint may have, what is likelier here is as much as what is likelier there."""
    comparison = compared([shown(FRICTION)] * 3, shown(FRICTION), TOGETHER)
    size = float(np.sum(FRICTION / USUAL)) / 2.0
    rng = np.random.default_rng(9)
    anybody = rng.exponential(size, (400_000, 2)) * USUAL
    inverse = np.linalg.inv(comparison.covariance)
    apart = anybody - comparison.known
    squares = np.einsum("ni,ij,nj->n", apart, inverse, apart)
    peak = comparison.evidence * np.exp(0.5 * comparison.square)
    # the density of one joint, integrated by draws from that of any
    drawn = comparison.evidence * np.exp(-0.5 * (squares - comparison.square))
    weights = np.exp(np.sum((anybody - FRICTION) / USUAL, axis=1) / size)
    assert np.mean(drawn * weights) == pytest.approx(1.0, rel=0.05) and peak > 1.0


def test_the_better_friction_repeats_the_less_probable_is_another_joint() -> None:
    alike = [shown(FRICTION)] * 3
    apart = [shown(FRICTION * factor) for factor in (0.4, 1.0, 1.6)]
    assert probability(FRICTION, alike) < 0.5 * probability(FRICTION, apart) < 0.05
    assert probability(FRICTION * [1.0, 6.0], alike) > LIKELY_ANOTHER
    # half of a mass is as far from what was known as twice of it
    far = [probability(FRICTION, alike, kg) for kg in (0.2, 0.6325, 2.0)]
    assert far[0] == pytest.approx(far[2], rel=0.05) and far[1] < 0.2 * far[0]


def test_what_a_recording_does_not_determine_is_no_other_joint() -> None:
    assert determined(shown(FRICTION))
    assert not determined(shown(FRICTION, std=np.inf))
