"""Weighings in the simulated world while nodes are killed, stalled and restarted, and the bus is lost; see `support.schedules`."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

from support.schedules import KINDS, drawn

SCHEDULES = Path(__file__).resolve().parents[1] / "support" / "schedules.py"
CHOSEN = (7, 32, 36, 41, 48, 56, 60, 79, 80, 103)
"""Of each kind one at least."""


def test_every_kind_is_among_them() -> None:
    faults = [fault for seed in CHOSEN for fault in drawn(seed)[2]]
    assert {fault.kind for fault in faults} == set(KINDS)
    assert any(fault.kind == "kill" and fault.whom == "driver" for fault in faults)
    assert any(fault.kind == "unplug" and fault.lasts_s > 1.0 for fault in faults), "longer than a servo waits"


@pytest.mark.long
def test_schedules() -> None:
    """In a process of its own: a hang of one is no hang of the others."""
    words = [sys.executable, str(SCHEDULES), ",".join(map(str, CHOSEN))]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-6000:] + done.stderr[-2000:]
