"""Dynamixel Protocol 2.0 as a servo sees it: packets in, packets out.

Written from the ROBOTIS e-manual ("DYNAMIXEL Protocol 2.0") and independent of `dynamixel_sdk`, so that a mistake in one
of them shows up when they talk. A packet is ``FF FF FD 00 ID LEN_L LEN_H INST params CRC_L CRC_H``; LEN counts what
follows it; a status packet has INST 0x55 and its error as the first parameter.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple

BROADCAST_ID = 0xFE
ALERT = 0x80  # bit of the error byte: look at Hardware Error Status
_HEADER = b"\xff\xff\xfd\x00"
_BEFORE_BODY = 7  # header, ID, LEN
_LONGEST = 4096  # a longer LEN is a damaged one; the longest request of 252 servos is below this


class Code(IntEnum):
    """Values of the instruction byte that are obeyed, and that of an answer."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REBOOT = 0x08
    STATUS = 0x55
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83
    FAST_SYNC_READ = 0x8A


class Error(IntEnum):
    """Values of a status packet's error byte, below the alert bit."""

    NONE = 0
    RESULT_FAIL = 1
    INSTRUCTION = 2
    CRC = 3
    DATA_RANGE = 4
    DATA_LENGTH = 5
    DATA_LIMIT = 6
    ACCESS = 7


class Instruction(NamedTuple):
    """A packet with a correct CRC."""

    id: int  # addressed servo, or `BROADCAST_ID`
    code: int  # its instruction byte, a `Code` or something unknown
    params: bytes  # without stuffing
    size: int  # bytes on the wire, for its time


class CrcError(NamedTuple):
    """A complete packet whose CRC is wrong."""

    id: int
    size: int


def _crc_of(byte: int) -> int:
    value = byte << 8
    for _ in range(8):
        value = (value << 1 ^ 0x8005 if value & 0x8000 else value << 1) & 0xFFFF
    return value


_CRC_TABLE = tuple(map(_crc_of, range(256)))


def crc16(data: bytes, crc: int = 0) -> int:
    """CRC-16 with polynomial 0x8005, first value 0 (or that of the bytes before), no reflection, no final xor."""
    for byte in data:
        crc = (crc << 8 & 0xFFFF) ^ _CRC_TABLE[crc >> 8 ^ byte]
    return crc


def stuff(body: bytes) -> bytes:
    """Instruction byte and parameters such that no header can occur in them."""
    return body.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")


def unstuff(body: bytes) -> bytes:
    """Inverse of `stuff`."""
    return body.replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")


def encode_instruction(servo_id: int, code: int, params: bytes = b"") -> bytes:
    """Packet that a computer sends.

    Args:
        servo_id: Whom it is for.
        code: The instruction.
        params: What comes behind it.
    """
    body = stuff(bytes([code]) + params)
    data = _HEADER + bytes([servo_id]) + (len(body) + 2).to_bytes(2, "little") + body
    return data + crc16(data).to_bytes(2, "little")


def encode_status(servo_id: int, error: int, params: bytes = b"") -> bytes:
    """Packet that a servo answers with.

    Args:
        servo_id: Who answers.
        error: The error byte, with the alert bit.
        params: What comes behind it.
    """
    return encode_instruction(
        servo_id,
        Code.STATUS,
        bytes([error]) + params,
    )


def encode_fast_status(
    parts: Sequence[tuple[int, int, bytes]],
    servos: int,
) -> bytes:
    """Joint answer to a Fast Sync Read.

    Args:
        parts: Of every servo that answered: its error, ID and data. Each closes with the CRC of all bytes so far.
        servos: How many were asked: the first one announces the length of all. With fewer parts the packet breaks off.
    """
    length = 1 + servos * (len(parts[0][2]) + 4)
    packet = b""
    crc = 0
    part = _HEADER + bytes([BROADCAST_ID]) + length.to_bytes(2, "little") + bytes([Code.STATUS])
    for error, servo_id, data in parts:
        part += bytes([error, servo_id]) + data
        crc = crc16(part, crc)
        packet += part
        part = crc.to_bytes(2, "little")
    return packet + part


class Parser:
    """Packets out of a stream of bytes, whatever lies between them."""

    def __init__(self) -> None:
        self._buffer = b""

    def reset(self) -> None:
        """Forget an unfinished packet."""
        self._buffer = b""

    def feed(self, data: bytes) -> list[Instruction | CrcError]:
        """Packets that these bytes complete, in their order."""
        self._buffer += data
        packets: list[Instruction | CrcError] = []
        while True:
            start = self._buffer.find(_HEADER)
            if start < 0:
                # the end may be the first bytes of a header
                self._buffer = self._buffer[-(len(_HEADER) - 1) :]
                return packets
            self._buffer = self._buffer[start:]
            if len(self._buffer) < _BEFORE_BODY:
                return packets
            length = int.from_bytes(self._buffer[5:7], "little")
            if not 3 <= length <= _LONGEST:
                self._buffer = self._buffer[1:]
                continue
            size = _BEFORE_BODY + length
            if len(self._buffer) < size:
                return packets
            packet = self._buffer[:size]
            if crc16(packet[:-2]) != int.from_bytes(packet[-2:], "little"):
                packets.append(CrcError(packet[4], size))
                # a damaged length may have swallowed the next packet: look for headers inside
                self._buffer = self._buffer[1:]
                continue
            self._buffer = self._buffer[size:]
            body = unstuff(packet[_BEFORE_BODY:-2])
            packets.append(
                Instruction(
                    packet[4],
                    body[0],
                    body[1:],
                    size,
                )
            )
