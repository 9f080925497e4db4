"""How evenly joint states come: a hold must be softer where they come slowly, or in bursts."""

from __future__ import annotations

import math

PAUSE_S = 0.03
"""Between joint states: what loses a joint within a second after such a pause is attributed to it."""
GAP_S = 0.1  # after a longer pause the last velocity says nothing, of a joint or of a goal
REMEMBERED_S = 1.0
"""Pauses between joint states make the hold softer for so long: an effort stays until the next, and a stiff one would overshoot."""
PERIOD_SHARE = 0.01  # of a new step in the mean period


class Arrivals:
    """When joint states came.

    Attributes:
        period_s: Mean time between the readings of a joint; 0 before there are two [s].
    """

    def __init__(self) -> None:
        self.period_s = 0.0
        self._heard_s: float | None = None
        # over the time remembered: sums of pauses, and of their squares
        self._pauses_s = 0.0
        self._squares_s2 = 0.0
        # the longest pause of late, and when it ended
        self._longest_s = 0.0
        self._longest_at_s = -math.inf

    def heard(self, now_s: float) -> None:
        """Joint states have come [s]."""
        gap_s = 0.0
        if self._heard_s is not None:
            gap_s = max(now_s - self._heard_s, 0.0)
        forgotten = now_s - self._longest_at_s > REMEMBERED_S
        if gap_s > PAUSE_S and (gap_s > self._longest_s or forgotten):
            self._longest_s = gap_s
            self._longest_at_s = now_s
        # in a longer one nothing but steady efforts are commanded, and after it a firm hold is needed at once
        pause_s = min(gap_s, GAP_S)
        self._heard_s = now_s
        kept = math.exp(-pause_s / REMEMBERED_S)
        self._pauses_s = kept * self._pauses_s + pause_s
        self._squares_s2 = kept * self._squares_s2 + pause_s**2

    def stepped(self, step_s: float) -> None:
        """A joint was read so long after its last reading [s]."""
        share = PERIOD_SHARE if self.period_s > 0.0 else 1.0
        self.period_s += (step_s - self.period_s) * share

    @property
    def wait_s(self) -> float:
        """Between joint states of late as they were heard, as an instant sees it: long pauses count as much as they last [s]."""
        return self._squares_s2 / self._pauses_s if self._pauses_s > 0.0 else 0.0

    @property
    def paused_s(self) -> float:
        """The longest pause of late; 0 where there was none [s]."""
        recent = (self._heard_s or 0.0) - self._longest_at_s < REMEMBERED_S
        return self._longest_s if recent else 0.0
