"""Publishers of one topic are told apart by what they count."""

from __future__ import annotations

import random

from proprio_ros.bus.state import LATE, OUTDATED, Senders


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


def test_what_is_doubled_or_overtaken_is_nobody_elses() -> None:
    senders = Senders()
    assert [senders.of(number, "five", f"push {number}") for number in (1, 2, 3)] == [1, 1, 1]
    assert senders.of(3, "five", "push 3") == senders.of(1, "five", "push 1") == OUTDATED, "doubled"
    assert senders.of(5, "five", "zero") == 1 and senders.of(4, "five", "push 4") == OUTDATED, "overtaken by a zero"
    assert senders.of(6, "five", "push 6") == 1, "and it goes on"
    # another that looks alike and begins to count: it says something else, or counts where nobody has
    assert senders.of(2, "five", "other") == 2 and senders.of(3, "five", "other 3") == 2
    assert senders.of(4, "five", "other 4") == 2, "the place that the first has left empty"
    assert senders.of(7, "five", "push 7") == 1
    assert [senders.of(number, "five", f"far {number}") for number in (900, 901)] == [3, 3]
    assert senders.of(901 - LATE, "five", "far") == 4, "too far back to be late"


def test_all_of_one_publisher_in_any_order_is_of_one() -> None:
    """Shuffled within its places and doubled: what is obeyed only grows."""
    draw = random.Random(1)
    numbers = sorted(
        [*range(1, 300), *draw.sample(range(1, 300), 60)], key=lambda number: number + draw.uniform(0, LATE - 1)
    )
    senders, obeyed = Senders(), list[int]()
    for number in numbers:
        if (sender := senders.of(number, "five", number)) != OUTDATED:
            assert sender == 1
            obeyed.append(number)
    assert obeyed == sorted(set(obeyed)) and len(obeyed) > 100
