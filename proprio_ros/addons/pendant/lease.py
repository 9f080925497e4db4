"""Who may move the arm: one page at a time, as long as it is heard of."""

from __future__ import annotations

from collections.abc import Callable
from time import monotonic

SILENCE_S = 10.0
"""A page that is not heard of for so long has given up the arm: a tab that was closed, a network that is lost."""


class Lease:
    """Held by one page, by its name, until it gives it up or falls silent; by a clock [s]."""

    def __init__(self, now: Callable[[], float] = monotonic) -> None:
        self._now = now
        self._holder = ""
        self._heard_s = 0.0

    @property
    def holder(self) -> str:
        """The page that holds it; empty: none does."""
        return "" if self._now() - self._heard_s > SILENCE_S else self._holder

    def take(self, page: str) -> bool:
        """Whether the page holds it now."""
        if self.holder in ("", page):
            self._holder = page
            self._heard_s = self._now()
        return self.holder == page

    def hear(self, page: str) -> None:
        """The page is there. One that fell silent has lost what it held, and does not get it back by talking."""
        if page and page == self.holder:
            self._heard_s = self._now()

    def give_up(self, page: str) -> None:
        """The page wants it no more."""
        if page == self._holder:
            self._holder = ""
