"""Whose message it is: rclpy 7.1 gives no publisher's identity with a message, only its number."""

from __future__ import annotations

from collections.abc import Hashable

LARGEST_GAP = 100
"""So many messages of one publisher may be lost between two that come."""
MOST = 16
"""So many publishers of one topic are remembered."""


class Senders:
    """Tells the publishers of one topic apart by the numbers of their messages, which each of them counts for itself.

    A message belongs to the publisher whose last number is the nearest one below its own; to a new one where none is near.
    Publishers that happen to count alike at one moment are kept apart by what their messages look like.
    """

    def __init__(self) -> None:
        self._last: dict[int, tuple[int, Hashable]] = {}
        self._known = 0

    def of(self, number: int | None, looks: Hashable) -> int:
        """Who sent a message: the same number for all messages of a sender; 0 where it cannot be known.

        Args:
            number: Of the message, by its publisher; None where the middleware does not give it: then all are one.
            looks: Whatever differs between publishers, and not between messages of one.
        """
        if number is None:
            return 0
        heard = [(last, known == looks, sender) for sender, (last, known) in self._last.items()]
        near = [one for one in heard if 0 < number - one[0] <= LARGEST_GAP]
        self._known += not near
        sender = max(near)[2] if near else self._known
        self._last.pop(sender, None)  # those heard last stand last
        self._last[sender] = (number, looks)
        if len(self._last) > MOST:
            del self._last[next(iter(self._last))]
        return sender
