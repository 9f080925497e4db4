"""What the nodes answer in words."""

from __future__ import annotations

from dataclasses import replace

from proprio_ros.identification.estimate import no_answer
from proprio_ros.live.answers import limited_by


def test_what_leaves_an_interval_wide_is_named_until_it_is_more_than_half_of_the_variance() -> None:
    estimate = no_answer("softness", "youngs_modulus", "Pa", "arm", 4, [], [])
    assert limited_by(estimate) == ""
    one = replace(estimate, budget=(("encoder", 3.0), ("block.size, guessed", 4.0)))
    assert limited_by(one) == "what is left is mostly block.size, guessed"
    # 9 of 22, then 18
    three = replace(
        estimate, budget=(("encoder", 2.0), ("calibration: friction", 3.0), ("poissons_ratio", 3.0))
    )
    assert limited_by(three).startswith("what is left is mostly calibration: friction and ")
