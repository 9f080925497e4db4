"""Emulated servos on one wire: who answers an instruction packet, with what, and when.

What it does not model: collisions (two servos with one ID), noise between packets, the time from the computer to the adapter,
and the instructions that the driver never sends (bulk and registered ones, factory reset). ROBOTIS e-manual, "DYNAMIXEL
Protocol 2.0", "Instruction Details".
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from proprio_ros.errors import ConfigurationError
from proprio_ros.virtual import protocol
from proprio_ros.virtual.servo import VirtualServo

_BITS_PER_BYTE = 10  # start, eight, stop
_PATIENCE_S = 0.010  # assumed: a packet that pauses longer is given up


class Reply(NamedTuple):
    """A whole status packet for the computer, and the time from the request's arrival to the packet's last byte."""

    data: bytes
    delay_s: float


@dataclass
class Faults:
    """What goes wrong on the wire; every attribute may be changed while the bus runs."""

    drop: float = 0.0  # probability that a status packet vanishes
    corrupt: float = 0.0  # probability that one byte of a status packet is wrong
    corrupt_requests: float = 0.0  # probability that one byte of what the computer sends is wrong
    delay_s: float = 0.0  # added to every reply
    # ids that neither hear nor answer, as with a loose plug
    hang: set[int] = field(default_factory=set)
    seed: int = 0  # of the chance

    def __post_init__(self) -> None:
        self._chance = np.random.default_rng(self.seed)

    def happens(self, probability: float) -> bool:
        return probability > 0.0 and self._chance.random() < probability

    def damaged(self, data: bytes) -> bytes:
        """The same bytes with one of them changed."""
        damaged = bytearray(data)
        damaged[self._chance.integers(len(damaged))] ^= int(self._chance.integers(1, 256))
        return bytes(damaged)


class _Part(NamedTuple):
    """Answer of one or more servos in one packet."""

    speakers: tuple[VirtualServo, ...]
    data: bytes


class VirtualBus:
    """The half-duplex wire with its servos, whose IDs are distinct (else ConfigurationError).

    ``advance`` moves the world on to a time [s] before every packet is handled; ``faults`` may be changed at any time;
    with ``wire_time`` replies take the time of their bits and of the servos' return delay.

    Attributes:
        port_baud: Bits per second of the computer's port; servos with another rate hear only noise. None: all
            understand, since a pseudo-terminal has no rate.
    """

    def __init__(
        self,
        servos: Sequence[VirtualServo],
        advance: Callable[[float], None],
        *,
        faults: Faults | None = None,
        wire_time: bool = True,
    ) -> None:
        ids = [servo.id for servo in servos]
        if len(set(ids)) < len(ids):
            raise ConfigurationError(
                f"servo IDs {ids}: every servo on a bus needs its own ID: change the repeated one"
            )
        self.servos = tuple(servos)
        self.advance = advance
        self.faults = faults if faults is not None else Faults()
        self.wire_time = wire_time
        self.port_baud: int | None = None
        self._parser = protocol.Parser()
        self._received_s = 0.0

    def receive(self, data: bytes, now_s: float) -> list[Reply]:
        """Take bytes, any part of a packet or several; returns what the computer gets back, in order of time.

        The world is moved on to their arrival, ``now_s``.
        """
        if now_s - self._received_s > _PATIENCE_S:
            self._parser.reset()
        self._received_s = now_s
        if data and self.faults.happens(self.faults.corrupt_requests):
            data = self.faults.damaged(data)
        replies = []
        elapsed_s = 0.0
        for packet in self._parser.feed(data):
            self.advance(now_s)
            listeners = [servo for servo in self.servos if self._hears(servo, now_s)]
            parts = list(
                self._handle(
                    packet,
                    {servo.id: servo for servo in listeners},
                    now_s,
                )
            )
            elapsed_s += self._bits_s(
                packet.size,
                parts[0].speakers[0] if parts else None,
            )
            for part in parts:
                if self.wire_time:
                    elapsed_s += sum(servo.return_delay_s for servo in part.speakers)
                elapsed_s += self._bits_s(len(part.data), part.speakers[0])
                if not self.faults.happens(self.faults.drop):
                    answer = (
                        self.faults.damaged(part.data)
                        if self.faults.happens(self.faults.corrupt)
                        else part.data
                    )
                    replies.append(Reply(answer, elapsed_s + self.faults.delay_s))
        return replies

    def _bits_s(self, size: int, speaker: VirtualServo | None) -> float:
        if not self.wire_time or not self.servos:
            return 0.0
        return size * _BITS_PER_BYTE / (speaker or self.servos[0]).baud

    def _hears(self, servo: VirtualServo, now_s: float) -> bool:
        right_baud = self.port_baud is None or servo.baud == self.port_baud
        return right_baud and servo.id not in self.faults.hang and servo.awake(now_s)

    def _handle(
        self,
        packet: protocol.Instruction | protocol.CrcError,
        listeners: dict[int, VirtualServo],
        now_s: float,
    ) -> Iterator[_Part]:
        """Do what a packet says; the answers in the order of the wire."""
        if isinstance(packet, protocol.CrcError):
            if packet.id in listeners:
                yield from _answer(listeners[packet.id], protocol.Error.CRC, level=2)
            return
        if packet.code == protocol.Code.STATUS:
            return
        for servo in listeners.values():
            servo.heard(now_s)
        if packet.id != protocol.BROADCAST_ID:
            if packet.id in listeners:
                yield from _addressed(packet, listeners[packet.id], now_s)
            return
        if packet.code == protocol.Code.PING:
            for _, servo in sorted(listeners.items()):
                yield from _ping(servo)
        elif packet.code == protocol.Code.SYNC_READ:
            address, length, ids = _sync_read(packet.params)
            yield from _chain(ids, address, length, listeners)
        elif packet.code == protocol.Code.FAST_SYNC_READ:
            yield from _fast_sync_read(packet.params, listeners)
        elif packet.code == protocol.Code.SYNC_WRITE:
            for servo_id, address, data in _sync_write(packet.params):
                if servo_id in listeners:
                    listeners[servo_id].write(address, data, now_s)
        elif packet.code in (protocol.Code.WRITE, protocol.Code.REBOOT):
            # all obey, nobody answers
            for servo in listeners.values():
                list(_addressed(packet, servo, now_s))


def _answer(
    servo: VirtualServo,
    error: int,
    data: bytes = b"",
    *,
    level: int,
) -> Iterator[_Part]:
    """Status packet, if the servo's Status Return Level is at least this."""
    if servo["status_return_level"] >= level:
        yield _Part(
            (servo,),
            protocol.encode_status(servo.id, servo.status_error(error), data),
        )


def _ping(servo: VirtualServo) -> Iterator[_Part]:
    return _answer(
        servo,
        protocol.Error.NONE,
        servo.read(0, 2)[1] + bytes([servo["firmware_version"]]),
        level=0,
    )


def _addressed(
    packet: protocol.Instruction,
    servo: VirtualServo,
    now_s: float,
) -> Iterator[_Part]:
    """A packet for one servo."""
    params = packet.params
    if packet.code == protocol.Code.PING:
        yield from _ping(servo)
    elif packet.code == protocol.Code.READ:
        whole = len(params) == 4
        error, data = (
            servo.read(_word(params, 0), _word(params, 2))
            if whole
            else (protocol.Error.DATA_LENGTH, b"")
        )
        yield from _answer(servo, error, data, level=1)
    elif packet.code == protocol.Code.WRITE:
        # the level that was valid before the write decides; assumed
        level = servo["status_return_level"]
        servo_id = servo.id
        error = (
            servo.write(_word(params, 0), params[2:], now_s)
            if len(params) > 2
            else protocol.Error.DATA_LENGTH
        )
        if level >= 2:
            yield _Part((servo,), protocol.encode_status(servo_id, servo.status_error(error)))
    elif packet.code == protocol.Code.REBOOT:
        yield from _answer(servo, protocol.Error.NONE, level=2)
        servo.reboot(now_s)
    else:
        yield from _answer(servo, protocol.Error.INSTRUCTION, level=2)


def _chain(
    ids: bytes, address: int, length: int, listeners: dict[int, VirtualServo]
) -> Iterator[_Part]:
    """Each servo speaks after the status packet of the one before; after a silent one nobody does."""
    for servo in map(listeners.get, ids):
        if servo is None or servo["status_return_level"] < 1:
            return
        error, data = servo.read(address, length)
        yield from _answer(servo, error, data, level=1)


def _fast_sync_read(params: bytes, listeners: dict[int, VirtualServo]) -> Iterator[_Part]:
    """One packet to which every servo adds its part; it breaks off at one that is silent or too old."""
    address, length, ids = _sync_read(params)
    speakers: list[VirtualServo] = []
    parts: list[tuple[int, int, bytes]] = []
    for servo_id in ids:
        servo = listeners.get(servo_id)
        if servo is None or servo["status_return_level"] < 1:
            break
        if servo["firmware_version"] < servo.model.fast_sync_read_firmware:
            break
        error, data = servo.read(address, length)
        if error:
            break  # assumed: without data there is no part
        speakers.append(servo)
        parts.append((servo.status_error(error), servo_id, data))
    if parts:
        yield _Part(tuple(speakers), protocol.encode_fast_status(parts, len(ids)))


def _word(data: bytes, index: int) -> int:
    return int.from_bytes(data[index : index + 2], "little")


def _sync_read(params: bytes) -> tuple[int, int, bytes]:
    return _word(params, 0), _word(params, 2), params[4:]


def _sync_write(params: bytes) -> Iterator[tuple[int, int, bytes]]:
    address = _word(params, 0)
    length = _word(params, 2)
    for index in range(4, len(params) - length, length + 1):
        yield params[index], address, params[index + 1 : index + 1 + length]
