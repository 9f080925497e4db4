"""Emulated servos with a rotor each, on a port: what the tests of the bus talk to."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

from proprio_ros.bus.control_table import XM430_W350
from proprio_ros.bus.dynamixel import BusServo, DynamixelBus
from proprio_ros.bus.port import SerialLike
from proprio_ros.virtual.bus import VirtualBus
from proprio_ros.virtual.port import PtyPort
from proprio_ros.virtual.servo import VirtualServo
from support.memory_port import MemoryPort
from support.rotors import Rotors

MEGABAUD = 3  # of the register Baud Rate
PATIENCE_S = 0.1
"""Servos and bus are one process here, which may not be run for longer than a servo takes; who tests that time says otherwise."""


class Wire(MemoryPort):
    """A port in memory that a bus can also close."""

    def close(self) -> None:
        self.reset_input_buffer()


class Desk:
    """Servos of an open arm, as they come from the factory but for the baud rate.

    Args:
        ids: Of the servos; the joints are called joint11 and so on.
        link: Path of the pseudo-terminal; None has the servos in memory.

    Attributes:
        lead_s: By how much the servos' clock is ahead; see `skip`.
    """

    def __init__(self, ids: Sequence[int], link: Path | None) -> None:
        self.servos = {servo_id: VirtualServo(XM430_W350, servo_id) for servo_id in ids}
        for servo in self.servos.values():
            servo["baud_rate"] = MEGABAUD
        self.lead_s = 0.0
        self.rotors = Rotors(list(self.servos.values()), self.clock())
        self.wire = VirtualBus(tuple(self.servos.values()), self.rotors.advance)
        self.port = None if link is None else PtyPort(self.wire, link, self.clock)

    def __enter__(self) -> Desk:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.port is not None:
            self.port.close()

    def clock(self) -> float:
        return time.monotonic() + self.lead_s

    def skip(self, duration_s: float) -> None:
        """Let time pass for the servos without waiting for it."""
        self.lead_s += duration_s
        if self.port is None:
            self.rotors.advance(self.clock())
        else:
            with self.port.lock:
                self.rotors.advance(self.clock())

    def connect(self) -> SerialLike:
        return Wire(self.wire, self.clock)

    def bus(
        self,
        *,
        fast: bool = True,
        baud_rate: int = 1_000_000,
        servos: Sequence[BusServo] | None = None,
        reply_timeout_s: float = PATIENCE_S,
    ) -> DynamixelBus:
        """A bus to these servos, not yet open."""
        expected = servos_named(self.servos) if servos is None else servos
        if self.port is None:
            return DynamixelBus("memory", expected, baud_rate, reply_timeout_s, fast, connect=self.connect)
        return DynamixelBus(str(self.port.path), expected, baud_rate, reply_timeout_s, fast)


def servos_named(ids: Sequence[int] | dict[int, VirtualServo]) -> tuple[BusServo, ...]:
    """What a robot file would say of them."""
    return tuple(BusServo(f"joint{servo_id}", servo_id, XM430_W350) for servo_id in ids)
