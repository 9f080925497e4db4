"""Cycles that begin on time, and stamps that run smoothly."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from proprio_ros.clock import Pacer, RoundTrips, StampClock, run_in_real_time


class Clock:
    """A clock on which sleeping takes exactly as long as asked, plus what a test adds."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s = 100.0
        self.oversleep_s = 0.0
        monkeypatch.setattr(time, "monotonic", lambda: self.now_s)
        monkeypatch.setattr(time, "sleep", self.sleep)

    def sleep(self, duration_s: float) -> None:
        assert duration_s > 0.0
        self.now_s += duration_s + self.oversleep_s


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    return Clock(monkeypatch)


def test_the_first_cycle_begins_at_once(clock: Clock) -> None:
    assert Pacer(0.025).wait() == 0.0
    assert clock.now_s == 100.0


def test_the_period_is_kept_whatever_a_cycle_takes(clock: Clock) -> None:
    pacer = Pacer(0.025)
    begun = []
    for work_s in (0.0, 0.001, 0.02, 0.024, 0.003):
        pacer.wait()
        begun.append(clock.now_s)
        clock.now_s += work_s
    assert begun == pytest.approx(100.0 + 0.025 * np.arange(5))


def test_lateness_does_not_add_up(clock: Clock) -> None:
    pacer = Pacer(0.025)
    pacer.wait()
    clock.oversleep_s = 0.002
    late = [pacer.wait() for _ in range(100)]
    assert late == pytest.approx([0.002] * 100)
    assert clock.now_s == pytest.approx(100.0 + 100 * 0.025 + 0.002)
    assert pacer.lateness_s == [0.0, *late]


def test_missed_cycles_are_left_out(clock: Clock) -> None:
    pacer = Pacer(0.025)
    pacer.wait()
    clock.now_s += 0.090  # the cycles at 25, 50 and 75 ms are gone
    assert pacer.wait() == pytest.approx(0.065)
    assert clock.now_s == pytest.approx(100.090)
    assert pacer.wait() == pytest.approx(0.0)
    assert clock.now_s == pytest.approx(100.100), "in step with the first"
    assert pacer.wait() == pytest.approx(0.0)
    assert clock.now_s == pytest.approx(100.125), "one at a time, none in a rush"


def test_old_latenesses_are_forgotten(clock: Clock) -> None:
    pacer = Pacer(0.025, keep=10)
    for _ in range(100):
        pacer.wait()
    assert 5 <= len(pacer.lateness_s) <= 10


def test_with_the_real_clock() -> None:
    pacer = Pacer(0.01)
    started = time.monotonic()
    for _ in range(21):
        pacer.wait()
    assert time.monotonic() - started >= 0.2
    assert all(late >= 0.0 for late in pacer.lateness_s)


def test_real_time_says_whether_it_was_granted() -> None:
    seen = []

    def ask() -> None:  # in a thread of its own: the tests shall not run before everything else
        granted = run_in_real_time()
        seen.append((granted, os.sched_getscheduler(0)))

    thread = threading.Thread(target=ask)
    thread.start()
    thread.join()
    ((granted, policy),) = seen
    assert granted is (policy == os.SCHED_RR)


SPIN = """
import os, time
from proprio_ros.clock import run_in_real_time
if not run_in_real_time():
    raise SystemExit(77)
started = time.monotonic()
while os.sched_getscheduler(0) == os.SCHED_RR:
    assert time.monotonic() - started < 10.0
"""


def test_a_thread_that_spins_does_not_starve_the_computer() -> None:
    run = subprocess.run(
        [sys.executable, "-c", SPIN],
        capture_output=True,
        text=True,
        timeout=30,
    )
    if run.returncode == 77:
        pytest.skip("real-time scheduling is not granted here")
    assert run.returncode == 0, run.stderr
    assert "no longer in real time" in run.stderr


SOME = """
import os, threading
from proprio_ros.clock import come_before_others

def computes(go, seen):
    go.wait()
    seen.append(os.getpriority(os.PRIO_PROCESS, threading.get_native_id()))

go, seen = threading.Event(), []
usual = os.getpriority(os.PRIO_PROCESS, 0)
before = threading.Thread(target=computes, args=(go, seen))
before.start()
granted = come_before_others({threading.get_native_id()})
go.set()
before.join()
if not granted:
    raise SystemExit(77)
assert os.sched_getscheduler(0) == os.SCHED_OTHER, "others have their share"
assert os.getpriority(os.PRIO_PROCESS, threading.get_native_id()) < usual
assert seen == [usual], seen
"""


def test_what_hears_comes_before_others_and_what_computes_does_not() -> None:
    run = subprocess.run(
        [sys.executable, "-c", SOME],
        capture_output=True,
        text=True,
        timeout=30,
    )
    if run.returncode == 77:
        pytest.skip("no priority is granted here")
    assert run.returncode == 0, run.stderr


URGENT = """
import os
from proprio_ros import clock

def priority():
    return os.getpriority(os.PRIO_PROCESS, 0)

usual = priority()
with clock.urgently():
    within = priority()
if within == usual:
    raise SystemExit(77)
assert within < usual and priority() == usual
try:
    with clock.urgently():
        raise ValueError
except ValueError:
    pass
assert priority() == usual
"""


def test_what_an_arm_waits_for_is_urgent_while_it_lasts() -> None:
    run = subprocess.run(
        [sys.executable, "-c", URGENT],
        capture_output=True,
        text=True,
        timeout=30,
    )
    if run.returncode == 77:
        pytest.skip("no priority is granted here")
    assert run.returncode == 0, run.stderr


# --- round trips


def test_a_round_trip_is_unusual_against_the_usual_ones() -> None:
    trips = RoundTrips()
    usual = np.random.default_rng(0).normal(0.002, 0.0001, 400)
    assert not any(trips.unusual(float(value)) for value in usual)
    assert trips.unusual(0.0035) and not trips.unusual(0.0025)
    assert trips.unusual(0.010)


def test_what_is_usual_may_change() -> None:
    trips = RoundTrips()
    for _ in range(200):
        trips.unusual(0.002)
    assert trips.unusual(0.016)
    for _ in range(200):
        trips.unusual(0.016)
    assert not trips.unusual(0.016), "an adapter that is slow all the time is no news"


def test_a_scatter_that_is_usual() -> None:
    trips = RoundTrips()
    usual = np.random.default_rng(0).uniform(0.002, 0.008, 400)
    assert not any(trips.unusual(float(value)) for value in usual)
    assert trips.unusual(0.030)


# --- stamps


EPOCH_NS = 1_700_000_000_000_000_000


def test_stamps_run_with_the_monotonic_clock() -> None:
    clock = StampClock()
    assert clock.look(EPOCH_NS, 50.0) == 0.0
    stamps = [clock.stamp_ns(50.0 + 0.025 * k) for k in range(5)]
    assert stamps == [EPOCH_NS + 25_000_000 * k for k in range(5)]


@pytest.mark.parametrize("jump_s", [3600.0, -3600.0, 0.003])
def test_a_jump_of_the_system_clock_waits_for_the_next_look(jump_s: float) -> None:
    clock = StampClock()
    clock.look(EPOCH_NS, 50.0)
    # during a probe nobody looks: the stamps go on as if nothing had happened
    assert clock.stamp_ns(51.0) - clock.stamp_ns(50.5) == 500_000_000
    jumped_ns = EPOCH_NS + 2_000_000_000 + round(1e9 * jump_s)
    assert clock.look(jumped_ns, 52.0) == pytest.approx(jump_s, abs=1e-6)
    assert clock.stamp_ns(52.0) == jumped_ns, "between probes they follow it"
    assert clock.look(jumped_ns + 1_000_000_000, 53.0) == pytest.approx(0.0, abs=1e-6), (
        "and it is told once"
    )


def test_stamps_are_exact_to_a_microsecond_after_a_year_of_uptime() -> None:
    clock = StampClock()
    up_s = 3.2e7
    clock.look(EPOCH_NS, up_s)
    assert abs(clock.stamp_ns(up_s + 0.025) - EPOCH_NS - 25_000_000) < 1000
