"""Waiting for what the wall clock alone brings: other processes and threads of the system. Only tests of wiring do."""

from __future__ import annotations

import time
from collections.abc import Callable

SOON_S = 60.0
"""What happens within a second on an idle computer. It costs time only where a test fails."""


def comes_true(
    ready: Callable[[], object],
    seconds: float,
    now: Callable[[], float],
    sleep: Callable[[float], None],
) -> bool:
    """Whether it became true within the time of a clock."""
    end_s = now() + seconds
    while not ready():
        if now() > end_s:
            return False
        sleep(0.005)
    return True


def wait_for(
    ready: Callable[[], object],
    seconds: float = SOON_S,
) -> bool:
    """Whether it became true before something hangs."""
    return comes_true(ready, seconds, time.monotonic, time.sleep)
