"""An emulated bus that is reached without a pseudo-terminal."""

from __future__ import annotations

from collections.abc import Callable

from proprio_ros.virtual.bus import VirtualBus
from proprio_ros.virtual.port import Outbox


class MemoryPort:
    """An emulated bus in memory, without a pseudo-terminal and without a thread, for a clock that a test sets.

    Args:
        bus: Moved on whenever the port is used.
        clock: Time of the world [s].
    """

    def __init__(
        self,
        bus: VirtualBus,
        clock: Callable[[], float],
    ) -> None:
        self._bus = bus
        self._clock = clock
        self._outbox = Outbox()
        self._buffer = b""

    def write(self, data: bytes) -> int:
        """Send bytes to the servos; all of them are taken."""
        now_s = self._clock()
        self._outbox.put(
            self._bus.receive(bytes(data), now_s),
            now_s,
        )
        return len(data)

    @property
    def in_waiting(self) -> int:
        """Bytes that have arrived by now."""
        now_s = self._clock()
        self._bus.advance(now_s)
        self._buffer += self._outbox.take(now_s)
        return len(self._buffer)

    def read(self, size: int) -> bytes:
        """At most ``size`` bytes of those that have arrived; never waits."""
        size = min(size, self.in_waiting)
        data, self._buffer = self._buffer[:size], self._buffer[size:]
        return data

    def reset_input_buffer(self) -> None:
        """Drop what has arrived."""
        self.read(self.in_waiting)
