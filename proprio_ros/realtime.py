"""Cycles that begin on time, and stamps that run smoothly."""

from __future__ import annotations

import math
import os
import statistics
import time
from collections import deque
from dataclasses import dataclass, field


@dataclass
class Pacer:
    """Cycles at a fixed rate, against absolute deadlines, so that lateness does not add up.

    Attributes:
        period_s: Of a cycle.
        lateness_s: How late each cycle began, the newest `keep`.
    """

    period_s: float
    keep: int = 10_000
    lateness_s: list[float] = field(default_factory=list)
    _next_s: float = field(default=float("nan"))

    def wait(self) -> float:
        """Sleep until the next cycle is due; returns how late it begins [s]. Cycles that were missed are left out."""
        now = time.monotonic()
        if not math.isfinite(self._next_s):
            self._next_s = now
        if now < self._next_s:
            time.sleep(self._next_s - now)
            now = time.monotonic()
        late = now - self._next_s
        self._next_s += self.period_s * max(1, int(late / self.period_s) + 1)
        self.lateness_s.append(late)
        if len(self.lateness_s) > self.keep:
            del self.lateness_s[: self.keep // 2]
        return late


def run_in_real_time() -> bool:
    """Ask the system to run the calling thread as soon as it can, before others; returns whether that was granted.

    Linux grants it to root and within the limit `rtprio`; without it, work on the same cores makes stamps less exact.
    """
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))
    except (OSError, AttributeError):
        return False
    return True


@dataclass
class StampClock:
    """Turns instants of the monotonic clock into stamps that run smoothly, whatever is done to the system's clock.

    The system's clock is looked at only between probes: a jump in the middle of one would tear it apart.

    Attributes:
        offset_ns: System time minus monotonic time.
    """

    offset_ns: int | None = None

    def look(self, system_ns: int, monotonic_s: float) -> float:
        """Follow the system's clock; returns by how much it had moved away [s]."""
        offset_ns = system_ns - round(1e9 * monotonic_s)
        moved_s = 0.0 if self.offset_ns is None else 1e-9 * (offset_ns - self.offset_ns)
        self.offset_ns = offset_ns
        return moved_s

    def stamp_ns(self, monotonic_s: float) -> int:
        """Stamp of an instant; `look` must have been called before."""
        assert self.offset_ns is not None
        return self.offset_ns + round(1e9 * monotonic_s)


@dataclass
class RoundTrips:
    """Tells a round trip that took longer than usual from the usual ones, whatever those are.

    Attributes:
        slack_s: So much above the median is always usual; more where they scatter more.
    """

    slack_s: float = 0.001
    _recent: deque[float] = field(default_factory=lambda: deque(maxlen=200))
    _limit_s: float = math.inf
    _count: int = 0

    def unusual(self, round_trip_s: float) -> bool:
        """Take one in; whether it was much longer than most of the newest 200."""
        self._recent.append(round_trip_s)
        self._count += 1
        if self._count % 20 == 0:
            middle = statistics.median(self._recent)
            scatter = statistics.median(abs(value - middle) for value in self._recent)
            self._limit_s = middle + max(self.slack_s, 6.0 * scatter)
        return round_trip_s > self._limit_s
