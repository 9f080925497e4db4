"""Emulated servos with a rotor each, on a port: what the tests of the bus talk to, in simulated time but on a pseudo-terminal."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, cast

from proprio_ros import clock as time_source
from proprio_ros.bus.control_table import XM430_W350
from proprio_ros.bus.dynamixel import BusServo, DynamixelBus
from proprio_ros.bus.port import REPLY_TIMEOUT_S, SerialLike
from proprio_ros.virtual.bus import VirtualBus
from proprio_ros.virtual.port import PtyPort
from proprio_ros.virtual.servo import VirtualServo
from support.rotors import Rotors
from support.simulated_port import SimulatedPort, Wire
from support.simulated_time import SimulatedClock

MEGABAUD = 3  # of the register Baud Rate
LINK = "/simulated/desk"


class Desk:
    """Servos of an open arm, as they come from the factory but for the baud rate.

    Args:
        ids: Of the servos; the joints are called joint11 and so on.
        clock: Simulated time; None: the machine's.
        link: Path of a pseudo-terminal, where the time is the machine's.
    """

    def __init__(
        self,
        ids: Sequence[int],
        clock: SimulatedClock | None,
        link: Path | None = None,
    ) -> None:
        self.servos = {servo_id: VirtualServo(XM430_W350, servo_id) for servo_id in ids}
        for servo in self.servos.values():
            servo["baud_rate"] = MEGABAUD
        self.clock = clock
        self.rotors = Rotors(
            list(self.servos.values()),
            time_source.now(),
        )
        self.wire = VirtualBus(
            tuple(self.servos.values()),
            self.rotors.advance,
        )
        self.port: Any = (
            PtyPort(self.wire, link) if clock is None else SimulatedPort(self.wire, Path(LINK))
        )

    def __enter__(self) -> Desk:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.port.close()

    def bus(
        self,
        *,
        fast: bool = True,
        baud_rate: int = 1_000_000,
        servos: Sequence[BusServo] | None = None,
        reply_timeout_s: float = REPLY_TIMEOUT_S,
    ) -> DynamixelBus:
        """A bus to these servos, not yet open."""
        expected = servos_named(self.servos) if servos is None else servos
        name = str(self.port.path)
        connect = (
            None
            if self.clock is None
            else cast("Callable[[], SerialLike]", partial(Wire, self.clock, name))
        )
        return DynamixelBus(name, expected, baud_rate, reply_timeout_s, fast, connect=connect)


def servos_named(ids: Sequence[int] | dict[int, VirtualServo]) -> tuple[BusServo, ...]:
    """What a robot file would say of them."""
    return tuple(BusServo(f"joint{servo_id}", servo_id, XM430_W350) for servo_id in ids)
