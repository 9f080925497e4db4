"""The benchmark of the driver's cycle runs; how fast it is, is for ``python test/benchmarks/bus.py``."""

from __future__ import annotations

import pytest


@pytest.mark.long
def test_the_driver_s_cycle_is_timed() -> None:
    pytest.importorskip("mujoco")
    from bus import rows

    found = rows(duration_s=1.0)
    assert [row.timing is not None for row in found] == [True] * 4 + [False]
    assert all("goal" in row.ratio for row in found[:4])
