"""Whether something is in the hand, by estimates of its mass with errors as they say."""

from __future__ import annotations

import math

import numpy as np
import pytest

from proprio_ros.live.holding import LEFT, TAKEN, Holding, probability_of_load


def said(
    true_kg: float,
    std_kg: float,
    count: int = 4000,
    least_kg: float = 0.05,
) -> dict[bool | None, float]:
    """Share of what is said of so many hands, each after one estimate that is as sure as it says."""
    estimates = true_kg + std_kg * np.random.default_rng(3).standard_normal(count)
    found: list[bool | None] = []
    for mass_kg in estimates.tolist():
        holding = Holding(least_kg)
        holding.hear(0, mass_kg, std_kg)
        found.append(holding.state)
    return {state: found.count(state) / count for state in (True, False, None)}


@pytest.mark.parametrize("std_kg", [0.002, 0.008, 0.02, 0.05])
def test_it_is_wrong_no_more_often_than_it_says(std_kg: float) -> None:
    empty = said(0.0, std_kg)
    lightest = said(0.05, std_kg)
    assert empty[True] <= 1.2 * (1.0 - TAKEN)
    assert lightest[False] <= 1.2 * LEFT
    if std_kg < 0.01:
        assert empty[False] > 0.95
        assert lightest[True] > 0.95


def test_an_estimate_that_cannot_tell_says_nothing() -> None:
    assert said(0.0, 0.5)[None] > 0.95
    assert probability_of_load(0.0, 0.5, 0.05) == pytest.approx(0.5, abs=0.01)
    assert (
        probability_of_load(math.nan, 0.01, 0.05) == probability_of_load(0.1, math.inf, 0.05) == 0.5
    )


def test_a_lighter_estimate_never_makes_a_load_likelier() -> None:
    likely = [
        probability_of_load(mass_kg, 0.01, 0.05)
        for mass_kg in np.linspace(-30.0, 30.0, 601).tolist()
    ]
    assert likely == sorted(likely)
    assert likely[0] == 0.0
    assert likely[-1] == 1.0


def test_what_was_said_stays_until_the_other_is_as_sure() -> None:
    holding = Holding(0.05)
    told = []
    for second, mass_kg in enumerate((0.025, 0.05, 0.025, 0.0, 0.025)):
        holding.hear(second * 10**9, mass_kg, 0.01)
        told.append((holding.state, holding.since_ns // 10**9))
    assert told == [(None, 0), (True, 1), (True, 1), (False, 3), (False, 3)]
    assert holding.entries(7 * 10**9)["holding_for"] == 4.0
    holding.forget()
    assert holding.state is None
    assert math.isnan(holding.probability)
    assert "holding_for" not in holding.entries(0)
