"""Protocol 2.0 from the servo's side: the manual's vectors, stuffing, and streams that are cut, noisy or damaged."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from proprio_ros.virtual.protocol import (
    BROADCAST_ID,
    Code,
    CrcError,
    Instruction,
    Parser,
    crc16,
    encode_fast_status,
    encode_instruction,
    encode_status,
    stuff,
    unstuff,
)

# ROBOTIS e-manual, "DYNAMIXEL Protocol 2.0", examples
PING = bytes.fromhex("FF FF FD 00 01 03 00 01 19 4E")
PING_STATUS = bytes.fromhex("FF FF FD 00 01 07 00 55 00 06 04 26 65 5D")
READ = bytes.fromhex("FF FF FD 00 01 07 00 02 84 00 04 00 1D 15")
READ_STATUS = bytes.fromhex("FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0")
WRITE = bytes.fromhex("FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89")
FAST = bytes.fromhex("FF FF FD 00 FE 0A 00 8A 84 00 04 00 03 07 04 20 F2")
FAST_STATUS = bytes.fromhex(
    "FF FF FD 00 FE 19 00 55 00 03 A6 00 00 00 84 08 00 07 1F 08 00 00 16 CA 00 04 FF 03 00 00 D1 9E"
)

# bytes from which headers and stuffing are made come often
awkward = st.lists(st.sampled_from([0xFF, 0xFD, 0x00, 0x55, 0x07]), max_size=40).map(
    bytes
) | st.binary(max_size=40)


@pytest.mark.parametrize(
    ("made", "expected"),
    [
        (encode_instruction(1, Code.PING), PING),
        (encode_status(1, 0, bytes.fromhex("06 04 26")), PING_STATUS),
        (
            encode_instruction(
                1,
                Code.READ,
                bytes([132, 0, 4, 0]),
            ),
            READ,
        ),
        (encode_status(1, 0, bytes.fromhex("A6 00 00 00")), READ_STATUS),
        (
            encode_instruction(
                1,
                Code.WRITE,
                bytes([116, 0, 0, 2, 0, 0]),
            ),
            WRITE,
        ),
        (
            encode_instruction(
                BROADCAST_ID,
                Code.FAST_SYNC_READ,
                bytes([132, 0, 4, 0, 3, 7, 4]),
            ),
            FAST,
        ),
        (
            encode_fast_status(
                [
                    (0, 3, bytes.fromhex("A6 00 00 00")),
                    (0, 7, bytes.fromhex("1F 08 00 00")),
                    (0, 4, bytes.fromhex("FF 03 00 00")),
                ],
                3,
            ),
            FAST_STATUS,
        ),
    ],
)
def test_the_manuals_packets(made: bytes, expected: bytes) -> None:
    assert made == expected


def test_crc_of_the_manuals_packets() -> None:
    for packet in (PING, PING_STATUS, READ, WRITE, FAST, FAST_STATUS):
        assert crc16(packet[:-2]).to_bytes(2, "little") == packet[-2:]


def test_a_header_in_the_data_is_stuffed() -> None:
    assert stuff(bytes.fromhex("03 FF FF FD 00 FF FF FD FD")) == bytes.fromhex(
        "03 FF FF FD FD 00 FF FF FD FD FD"
    )
    packet = encode_instruction(
        1,
        Code.WRITE,
        bytes.fromhex("14 00 FF FF FD 00"),
    )
    assert packet[5:7] == bytes([10, 0]), "the length counts the stuffed byte"
    assert Parser().feed(packet) == [
        Instruction(1, Code.WRITE, bytes.fromhex("14 00 FF FF FD 00"), len(packet))
    ]


@settings(deadline=None)
@given(awkward)
def test_stuffing_is_undone(body: bytes) -> None:
    assert unstuff(stuff(body)) == body
    assert b"\xff\xff\xfd\x00" not in stuff(body)


@settings(deadline=None)
@given(
    st.integers(0, 252),
    awkward,
    st.lists(st.integers(0, 60), max_size=5),
)
def test_packets_survive_any_split(
    servo_id: int,
    params: bytes,
    cuts: list[int],
) -> None:
    stream = encode_instruction(servo_id, Code.WRITE, params) + PING
    edges = [
        0,
        *sorted(min(cut, len(stream)) for cut in cuts),
        len(stream),
    ]
    parser = Parser()
    packets = [packet for a, b in pairwise(edges) for packet in parser.feed(stream[a:b])]
    assert packets == [
        Instruction(servo_id, Code.WRITE, params, len(stream) - len(PING)),
        Instruction(1, Code.PING, b"", len(PING)),
    ]


@settings(deadline=None)
@given(st.binary(max_size=30).filter(lambda data: b"\xff\xff\xfd" not in data))
def test_garbage_before_a_header_is_skipped(garbage: bytes) -> None:
    # FF at the end of the garbage, and FF FF FD FD, are no headers
    for noise in (garbage, garbage + b"\xff", garbage + b"\xff\xff\xfd\xfd"):
        assert Parser().feed(noise + PING) == [
            Instruction(
                1,
                Code.PING,
                b"",
                len(PING),
            )
        ]


def test_a_damaged_packet_is_reported_and_the_next_one_is_read() -> None:
    damaged = WRITE[:-3] + b"\x55" + WRITE[-2:]
    assert Parser().feed(damaged + PING) == [
        CrcError(1, len(WRITE)),
        Instruction(1, Code.PING, b"", len(PING)),
    ]


def test_a_damaged_length_costs_no_later_packet() -> None:
    longer = PING[:5] + bytes([PING[5] + 12]) + PING[6:]
    assert Parser().feed(longer + READ)[-1] == Instruction(
        1, Code.READ, bytes([132, 0, 4, 0]), len(READ)
    )
    for length in (b"\x02\x00", b"\xff\xff"):
        assert Parser().feed(PING[:5] + length + PING[7:] + READ)[-1].id == 1


def test_an_unfinished_packet_can_be_forgotten() -> None:
    parser = Parser()
    assert parser.feed(WRITE[:9]) == []
    parser.reset()
    assert parser.feed(PING) == [Instruction(1, Code.PING, b"", len(PING))]
