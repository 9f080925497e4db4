"""When a node looked for messages, and how long those that it takes now may have waited."""

from __future__ import annotations

from proprio_ros import clock

LONG_TURN_S = 0.3
"""A turn (one callback, or none in 0.1 s) takes longer only where the program stood still or a callback waited."""
TAKEN_S = 1.0
"""So long after a long turn, all messages that came during it have been taken."""


class Turns:
    """The turns of one node: in each it takes what has come, and runs at most one callback.

    Attributes:
        begun_s: When the latest turn began [s].
        more_waits: Whether the latest turn left messages behind.
    """

    def __init__(self) -> None:
        self.begun_s = clock.now()
        self.more_waits = False
        # the latest time in which no message was taken
        self._deaf_from_s = self.begun_s
        self._deaf_to_s = self.begun_s

    def begin(self) -> None:
        """Another turn begins."""
        self.more_waits = False
        self.waited_s()

    def waited_s(self) -> float:
        """For how long a message that is taken now may have waited [s]."""
        now_s = clock.now()
        if now_s - self.begun_s > LONG_TURN_S:
            goes_on = self.begun_s - self._deaf_to_s < TAKEN_S
            if not goes_on:
                self._deaf_from_s = self.begun_s
            self._deaf_to_s = now_s
        self.begun_s = now_s
        if now_s - self._deaf_to_s >= TAKEN_S:
            return 0.0
        return now_s - self._deaf_from_s
