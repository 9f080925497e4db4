"""How old a running estimate is, and what it leaves out so that it stays news. No ROS here.

On a computer that is busy elsewhere an estimate is computed more slowly than joint states come. One that takes them all the same
says what was, later and later. So the queue of what has not been taken leaves samples out by its age: some of each tenth of a
second first, then whole stretches. Windows of the estimate are complete or are not made, and nothing is computed across a gap.

Whoever is late still has to say so. How old an estimate is counts from when the newest sample that it rests on was sent, on one
clock that nobody sets: a joint state's own stamp may be of another computer, of a simulation, or of a recording that is played.
"""

from __future__ import annotations

import sys
from collections import deque
from dataclasses import dataclass

from proprio_ros.identification.regression.online import OnlineEstimate, Stretch
from proprio_ros.recordings.messages import RawMessage

WARNED_S = 1.0
"""From so old on an estimate carries a warning, and whether something is held is unknown: a hand closes and opens in a second."""
WITHDRAWN_S = 3.0
"""From so old on nothing is said of what the hand holds now."""
SLACK_S = 0.1
"""Of what waits no longer, all is taken: the computer is in step, and one thread is run after another."""
ROOM_S = 0.25
"""A queue that holds so much more than the stretch that an estimate needs is cut down to it."""
MOST_WAITING = 5000
"""So many messages are kept at most; what an estimate has not taken by then it would leave out anyway."""
STEP_NS = 200_000_000
"""A clock that moves by more beside another was set."""
DRIFT = 1e-4
"""Clocks of two computers drift apart by less; crystals are good to 20 to 50 parts in a million."""


@dataclass(frozen=True)
class Arrival:
    """A message that came in."""

    role: str  # as `Inputs` has it
    raw: RawMessage
    stamp_ns: int  # of its header; when it came, where it has none
    sent_s: float  # when it was sent, on this computer's clock that nobody sets

    @property
    def kind(self) -> tuple[str, int]:
        """Of whom it may be: messages of one publisher have the same joints, and so the same length."""
        return self.role, len(self.raw.data)


@dataclass(frozen=True)
class News:
    """An estimate, and what it is news of."""

    estimate: OnlineEstimate
    stamp_ns: int  # of the newest sample that it rests on
    sent_s: float  # when that was sent, on this computer's clock that nobody sets

    def behind_s(self, now_s: float) -> float:
        """How old it is [s]."""
        return max(now_s - self.sent_s, 0.0)


class Lag:
    """How much later than ever messages come, by stamps of whatever clock.

    The least that a message ever took counts as none, since nobody knows how two clocks differ. It counts anew where a clock was
    set, and grows by what clocks drift.

    Attributes:
        stamp_ns: The newest.
        late_ns: How much later than ever the newest message came.
    """

    def __init__(self) -> None:
        self.stamp_ns = self.late_ns = 0
        self._least_ns = sys.maxsize
        # when the newest came, by the clock that `stamp_ns` is compared with and by one that nobody sets
        self._noted_ns = (0, 0)

    def note(self, now_ns: int, stamp_ns: int, steady_ns: int) -> None:
        """Take in a message.

        Args:
            now_ns: When it is heard, on the computer's clock or a simulation's.
            stamp_ns: Its stamp.
            steady_ns: When it is heard, on a clock that nobody sets.
        """
        passed_ns = now_ns - self._noted_ns[0]
        steadily_ns = steady_ns - self._noted_ns[1]
        was_set = abs(passed_ns - steadily_ns) > STEP_NS or stamp_ns < self.stamp_ns - STEP_NS
        lag_ns = now_ns - stamp_ns
        drifted_ns = self._least_ns + round(DRIFT * steadily_ns)
        self._least_ns = lag_ns if was_set else min(lag_ns, drifted_ns)
        self._noted_ns = (now_ns, steady_ns)
        self.stamp_ns = stamp_ns
        self.late_ns = lag_ns - self._least_ns

    @property
    def least_ns(self) -> int:
        """The least that a message took, as far as clocks show it."""
        return self._least_ns

    def accept(self) -> None:
        """What the newest message took counts as none."""
        self._least_ns += self.late_ns
        self.late_ns = 0


class Backlog:
    """What came in and was not taken yet; `put` may be called from another thread than `take`.

    Attributes:
        left_out: How many messages were.
        newest_s: When the newest was sent.
    """

    def __init__(self) -> None:
        self._waiting: deque[Arrival] = deque(maxlen=MOST_WAITING)
        self._from_s = -float("inf")
        self._taken_ns: dict[tuple[str, int], int] = {}
        self.left_out = 0
        self.newest_s = -float("inf")

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, arrival: Arrival) -> None:
        """The newest."""
        self._waiting.append(arrival)
        self.newest_s = arrival.sent_s

    def take(self, needed: Stretch) -> Arrival | None:
        """The next message that counts; None: nothing waits.

        Args:
            needed: What the estimate needs, so that it can say anything.
        """
        while self._waiting:
            arrival = self._waiting.popleft()
            if arrival.role == "battery_state" or self._counts(arrival, needed):
                self._taken_ns[arrival.kind] = arrival.stamp_ns
                return arrival
            self.left_out += 1
        return None

    def _counts(self, arrival: Arrival, needed: Stretch) -> bool:
        waited_s = self.newest_s - arrival.sent_s
        if waited_s > needed.length_s + ROOM_S:
            self._from_s = self.newest_s - needed.length_s
        if arrival.sent_s < self._from_s:
            return False
        since_s = 1e-9 * (arrival.stamp_ns - self._taken_ns.get(arrival.kind, 0))
        return waited_s <= SLACK_S or not 0.0 <= since_s < needed.spacing_s
