"""Simulated time: one thread runs at a time, time passes while all wait, and a seed says the order."""

from __future__ import annotations

import pytest
from support.simulated_time import SimulatedClock


def played(seed: int) -> list[tuple[str, int, float]]:
    """Two threads that share a lock; what they did, and when."""
    clock = SimulatedClock(seed)
    said = []
    lock = clock.lock()
    ended = clock.event()

    def work(name: str, count: int) -> None:
        for number in range(count):
            clock.sleep(0.1)
            with lock:
                said.append((name, number, round(clock.now(), 3)))
                clock.sleep(0.05)
        ended.set()

    threads = [clock.thread(work, name, (name, count)) for name, count in (("a", 5), ("b", 7))]
    for thread in threads:
        thread.start()
    assert ended.wait(10.0)
    for thread in threads:
        thread.join()
    clock.end()
    return said


def test_a_seed_says_the_order() -> None:
    assert played(1) == played(1)
    assert any(played(1) != played(seed) for seed in range(2, 10))


def test_an_hour_takes_no_time() -> None:
    clock = SimulatedClock()
    begun_s = clock.now()
    assert not clock.event().wait(3600.0)
    assert clock.now() - begun_s == pytest.approx(3600.0, abs=1e-3)


def test_who_is_killed_does_nothing_any_more() -> None:
    clock = SimulatedClock()
    said = []

    def work() -> None:
        for number in range(10):
            clock.sleep(1.0)
            said.append(number)

    thread = clock.thread(work, "work", group="killed")
    thread.start()
    clock.sleep(3.5)
    clock.kill("killed")
    clock.sleep(10.0)
    assert said == [0, 1, 2]
    assert not thread.is_alive()


def test_who_is_stalled_goes_on_later() -> None:
    clock = SimulatedClock()
    when_s = []
    begun_s = clock.now()

    def work() -> None:
        clock.sleep(1.0)
        when_s.append(clock.now() - begun_s)

    clock.thread(work, "work", group="stalled").start()
    clock.sleep(0.5)
    clock.stall("stalled", 5.0)
    clock.sleep(10.0)
    assert when_s == pytest.approx([5.5], abs=1e-3)


def test_a_thread_that_fails_is_told_of() -> None:
    clock = SimulatedClock()

    def work() -> None:
        raise ZeroDivisionError("wrong")

    clock.thread(work, "work").start()
    with pytest.raises(RuntimeError, match="wrong"):
        clock.sleep(1.0)


def test_waiting_for_nothing_is_a_defect() -> None:
    with pytest.raises(RuntimeError, match="everybody waits for ever"):
        SimulatedClock().event().wait()
