"""Weighings in the simulated world while nodes are killed, stalled and restarted, and the bus is lost; see `support.schedules`."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

SCHEDULES = Path(__file__).resolve().parents[1] / "support" / "schedules.py"


def play(first: int, count: int) -> None:
    """In a process of its own: stand-ins take the place of rclpy's nodes."""
    done = subprocess.run([sys.executable, str(SCHEDULES), str(first), str(count)], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-6000:] + done.stderr[-2000:]


@pytest.mark.long
@pytest.mark.parametrize("first", [0, 100])
def test_schedules(first: int) -> None:
    play(first, 10)
