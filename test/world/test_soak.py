"""Many weighings one after the other by the same nodes: each is right, no arm is dropped, and nothing is kept of those before."""

from __future__ import annotations

import gc
import os
from collections import Counter
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

from support.schedules import Side, standing

WEIGHINGS = int(os.environ.get("PROPRIO_SOAK_WEIGHINGS", "30"))
MASSES_KG = (0.02, 0.05, 0.08, 0.035)
SETTLED = 14
"""After so many all is there that is kept once, and a cache of a dozen robots is full."""
REST_S = 20.0
"""Between two weighings, of simulated time."""
OURS = "proprio_ros"


def kept() -> Counter[str]:
    """How many objects of this package there are, by class."""
    gc.collect()
    names = (f"{type(each).__module__}.{type(each).__qualname__}" for each in gc.get_objects())
    return Counter(name for name in names if name.startswith(OURS))


@pytest.mark.long
def test_many_weighings(tmp_path: Path) -> None:
    broken: list[str] = []
    answers: list[str] = []
    settled = Counter[str]()
    with standing("weigh", tmp_path) as made:
        side = Side(made, "", broken)
        began_s = made.clock.now()
        for number in range(WEIGHINGS):
            side.mass_kg = MASSES_KG[number % len(MASSES_KG)]
            assert side.set("virtual", "object", f"{side.mass_kg}")
            answers.append(side.weigh(f"weighing {number}"))
            dropped = [
                name for name, servo in side.robot.servos.items() if servo["bus_watchdog"] < 0
            ]
            assert not dropped, f"weighing {number}"
            made.clock.sleep(REST_S)
            side.still(f"after weighing {number}")
            if number == SETTLED:
                settled = kept()
        assert made.clock.now() - began_s > WEIGHINGS * REST_S
        more = kept() - settled
    assert not broken
    accepted = sum(answer.startswith("accepted") for answer in answers)
    assert accepted >= 0.9 * WEIGHINGS, answers
    weighings = WEIGHINGS - 1 - SETTLED
    assert not {name: count for name, count in more.items() if count >= weighings}
