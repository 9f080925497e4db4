"""Servos do not wait: what is tested here is in simulated time, but for what needs a pseudo-terminal or real servos."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from support.simulated_port import simulated
from support.simulated_time import SimulatedClock


@pytest.fixture
def clock() -> Iterator[SimulatedClock]:
    """Simulated time, until the test ends."""
    with simulated() as made:
        yield made
