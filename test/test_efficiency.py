"""The table of what intervals cost says what it is meant to say."""

from __future__ import annotations

import efficiency
import figures
import numpy as np
import pytest

from proprio_ros.quantity import Z95


@pytest.mark.parametrize("width", [0.5, 1.0, 3.0])
def test_intervals_that_are_so_much_too_wide_cost_so_much(width: float) -> None:
    rng = np.random.default_rng(1)
    std = rng.uniform(1.0, 100.0, 4000)
    errors = std * rng.standard_normal(4000)
    found = efficiency.of_answers(errors, width * Z95 * std)
    assert found == pytest.approx(width, rel=0.05)


def test_what_holds_nothing_costs_the_root_of_two_where_it_fits() -> None:
    errors = np.maximum(np.random.default_rng(2).standard_normal(4000), 0.0)
    assert efficiency.of_answers(errors, np.full(4000, Z95)) == pytest.approx(2.0**0.5, rel=0.05)


def test_lies_and_waste_come_first_and_what_is_not_known_last() -> None:
    factors = [fit.worse_than_needed for fit in efficiency.every_fit()]
    assert factors == sorted(factors, reverse=True)
    assert factors[-1] == 0.0 or min(factors) >= 1.0


def test_every_table_that_says_how_many_hold_is_in_it_or_is_of_recordings_that_are_bent() -> None:
    left_out = {
        "distorted.distorted",
        "distorted.bends",
        "foreign_stiff.stiffnesses",  # the answers of the row above it, by stiffness
        "mutated_pushes.mutated pushes",
        "simulated.paper",
        "soak.soak",  # how often nodes answer; `live.live` has how well
        "soak_simulated.soak",
        "time_axis.factors",
        "time_axis.machines",
    }
    for path in figures.RESULTS.glob("*.json"):
        for table, content in figures.kept(path.stem)["tables"].items():
            name = f"{path.stem}.{table}"
            if any("hold" in row for row in content["rows"]):
                assert name in efficiency.LABELS or name in left_out, name


def test_the_file_of_all_rows_is_current() -> None:
    kept = (figures.RESULTS / "efficiency.md").read_text(encoding="utf-8")
    assert kept == efficiency.page(), "run python docs/generate.py figures"
