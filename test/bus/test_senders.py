"""Publishers of one topic are told apart by what they count."""

from __future__ import annotations

import random

import pytest

from proprio_ros.bus.state import LATE, MOST, OUTDATED, Senders


def test_publishers_are_told_apart_by_their_numbers() -> None:
    senders = Senders()
    first = [senders.of(number, "five") for number in (1, 2, 3)]
    assert first == [1, 1, 1]
    assert senders.of(1, "one") == 2, "a new one begins to count"
    assert senders.of(4, "five") == 1
    assert [senders.of(2, "one"), senders.of(8, "five"), senders.of(400, "flood")] == [2, 1, 3], (
        "some are lost"
    )
    # one that counts faster overtakes: they look different
    assert [senders.of(number, "one") for number in range(3, 9)] == [2] * 6
    assert senders.of(9, "five") == 1
    assert senders.of(9, "one") == 2
    assert senders.of(10, "one") == 2
    assert senders.of(10, "five") == 1


def test_without_numbers_all_are_one() -> None:
    senders = Senders()
    assert senders.of(None, "a") == senders.of(None, "b") == 0


MS = 1_000_000


def test_what_is_doubled_or_overtaken_is_nobody_elses() -> None:
    senders = Senders()
    assert [senders.of(number, "five", number * MS) for number in (1, 2, 3)] == [1, 1, 1]
    assert (
        senders.of(
            3,
            "five",
            3 * MS,
        )
        == senders.of(1, "five", MS)
        == OUTDATED
    ), "doubled"
    assert senders.of(5, "five", 5 * MS) == 1 and senders.of(4, "five", 4 * MS) == OUTDATED, (
        "overtaken"
    )
    assert senders.of(6, "five", 6 * MS) == 1, "and it goes on"
    # another that looks alike and begins to count, whatever it says: it sends later
    assert [
        senders.of(
            number,
            "five",
            (10 + number) * MS,
        )
        for number in (1, 2, 3, 4)
    ] == [
        2,
        2,
        2,
        2,
    ]
    assert senders.of(7, "five", 20 * MS) == 1
    assert [
        senders.of(
            number,
            "five",
            (30 + number) * MS,
        )
        for number in (900, 901)
    ] == [3, 3]
    assert senders.of(901 - LATE, "five", 30 * MS) == 4, "too far back to be late"


def test_one_command_by_each_of_many_who_say_the_same_is_obeyed() -> None:
    """As by ``ros2 topic pub --once``, time and again: each is its publisher's first."""
    senders = Senders()
    assert OUTDATED not in [
        senders.of(
            1,
            "five",
            sent * 1000 * MS,
        )
        for sent in range(40)
    ]


def test_by_a_clock_that_is_behind_nothing_is_outdated() -> None:
    senders = Senders()
    assert [
        senders.of(
            number,
            "five",
            60_000 * MS + number,
        )
        for number in (1, 2, 3)
    ] == [1, 1, 1]
    assert senders.of(1, "five", 10_000 * MS) == 2
    assert senders.of(2, "five") == 2, "nobody says when it was sent"


def test_all_of_one_publisher_in_any_order_is_of_one() -> None:
    """Shuffled within its places and doubled: what is obeyed only grows."""
    draw = random.Random(1)
    numbers = sorted(
        [
            *range(1, 300),
            *draw.sample(range(1, 300), 60),
        ],
        key=lambda number: number + draw.uniform(0, LATE - 1),
    )
    senders = Senders()
    obeyed = list[int]()
    for number in numbers:
        if (sender := senders.of(number, "five", number * MS)) != OUTDATED:
            assert sender == 1
            obeyed.append(number)
    assert obeyed == sorted(set(obeyed))
    assert len(obeyed) > 100


def test_how_late_a_message_came() -> None:
    senders = Senders()
    assert [senders.late_s(1, lag) for lag in (400 * MS, MS, 2000 * MS)] == [0.4, 0.001, 2.0], (
        "by the same clock"
    )
    # by one that is 5 s behind, or ahead, nobody knows of the first message; of the others it is known
    assert [round(senders.late_s(2, lag * MS), 3) for lag in (5001, 5000, 5400)] == [0.0, 0.0, 0.4]
    assert [round(senders.late_s(3, lag * MS), 3) for lag in (-4999, -5000, -4600)] == [
        0.0,
        0.0,
        0.4,
    ]
    assert senders.late_s(4, 2700 * MS, waited_ns=3500 * MS) == 2.7, "nobody took it meanwhile"
    assert senders.late_s(5, 5000 * MS, waited_ns=3500 * MS) == 0.0


@pytest.mark.parametrize("set_ms", [-5000, -200, 200, 5000])
def test_a_clock_that_is_set_while_a_message_is_on_its_way(set_ms: int) -> None:
    senders = Senders()
    senders.late_s(1, MS)
    for late_ms in (3, 400):  # sent before
        assert senders.late_s(
            1,
            (late_ms + set_ms) * MS,
            set_ms * MS,
        ) >= 0.99e-3 * (late_ms - 1)
    # sent since; where it was set by little, nobody knows whether it was sent before
    assert senders.late_s(1, MS, set_ms * MS) <= (0.201 if set_ms == -200 else 0.001)
    senders.clock_was_set(set_ms * MS)
    assert [senders.late_s(1, lag * MS) for lag in (1, 401)] == pytest.approx([0.001, 0.401])


@pytest.mark.parametrize("set_ms", [-5000, -200, 200, 5000])
def test_what_waited_for_more_than_a_second_beside_a_clock_that_is_set_is_late(set_ms: int) -> None:
    """A driver that was not run: what waits for it is no message of a clock that nobody knows."""
    senders = Senders()
    senders.late_s(1, MS)
    senders.late_s(2, (7000 + 1) * MS)  # by another clock
    assert senders.late_s(1, (1200 + set_ms) * MS, set_ms * MS) >= 1.0, "sent before"
    assert senders.late_s(1, 1200 * MS, set_ms * MS) >= 0.999, "sent since"
    senders.clock_was_set(set_ms * MS)
    assert [senders.late_s(1, lag * MS) for lag in (1200, 1100, 1)] == pytest.approx(
        [1.2, 1.1, 0.001], abs=0.201
    )
    assert [senders.late_s(2, (7000 + set_ms + lag) * MS) for lag in (1, 400)] == pytest.approx(
        [0.0, 0.4], abs=0.002
    )


def test_only_so_many_publishers_are_remembered() -> None:
    senders = Senders()
    for sent in range(100):
        senders.late_s(
            senders.of(1, "five", sent * 1000 * MS),
            MS,
        )
    assert len(senders._last) == len(senders._error_ns) == MOST
