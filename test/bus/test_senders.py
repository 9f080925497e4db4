"""Publishers of one topic are told apart by what they count."""

from __future__ import annotations

from proprio_ros.bus.state import Senders


def test_publishers_are_told_apart_by_their_numbers() -> None:
    senders = Senders()
    first = [senders.of(number, "five") for number in (1, 2, 3)]
    assert first == [1, 1, 1]
    assert senders.of(1, "one") == 2, "a new one begins to count"
    assert senders.of(4, "five") == 1
    assert [senders.of(2, "one"), senders.of(8, "five"), senders.of(400, "flood")] == [2, 1, 3], "some are lost"
    # one that counts faster overtakes: they look different
    assert [senders.of(number, "one") for number in range(3, 9)] == [2] * 6
    assert senders.of(9, "five") == 1 and senders.of(9, "one") == 2
    assert senders.of(10, "one") == 2 and senders.of(10, "five") == 1


def test_without_numbers_all_are_one() -> None:
    senders = Senders()
    assert senders.of(None, "a") == senders.of(None, "b") == 0
