"""The vendor's library and emulated servos on one wire in memory, in simulated time: no thread, and nothing waits for a clock."""

from __future__ import annotations

import dynamixel_sdk as sdk

from proprio_ros.virtual.bus import VirtualBus
from support.memory_port import MemoryPort

POLL_S = 20e-6
"""The library asks for the time whenever it looks for bytes that are not there yet; that much passes meanwhile."""


class SimulatedPort(sdk.PortHandler):
    """The library's port, whose bytes go to emulated servos and whose time the test moves.

    Attributes:
        now_s: Time of library and servos.
    """

    def __init__(self, bus: VirtualBus) -> None:
        super().__init__("memory")
        self.now_s = 0.0
        self._bus = bus

    def setupPort(self, cflag_baud: int) -> bool:
        self.ser = MemoryPort(self._bus, lambda: self.now_s)
        self.is_open = True
        self.tx_time_per_byte = 1e4 / self.baudrate  # [ms]
        return True

    def closePort(self) -> None:
        self.is_open = False

    def getCurrentTime(self) -> float:
        """In milliseconds."""
        self.now_s += POLL_S
        return 1e3 * self.now_s

    def wait(self, duration_s: float) -> None:
        """Time passes while nobody talks."""
        self.now_s += duration_s
        self._bus.advance(self.now_s)
