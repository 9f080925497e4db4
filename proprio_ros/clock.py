"""The clock that everything takes its time from; cycles that begin on time, and stamps that run smoothly."""

from __future__ import annotations

import contextlib
import logging
import math
import os
import resource
import signal
import statistics
import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from typing import Any, Protocol


class Event(Protocol):
    """As `threading.Event`."""

    def is_set(self) -> bool: ...
    def set(self) -> None: ...
    def clear(self) -> None: ...
    def wait(self, timeout: float | None = None) -> bool: ...


class Thread(Protocol):
    """As `threading.Thread`."""

    def start(self) -> None: ...
    def join(self, timeout: float | None = None) -> None: ...
    def is_alive(self) -> bool: ...


class Lock(Protocol):
    """As `threading.Lock`."""

    def acquire(self, blocking: bool = True) -> bool: ...
    def release(self) -> None: ...
    def __enter__(self) -> bool: ...
    def __exit__(self, *_: Any) -> None: ...


class Clock:
    """The machine's time, and all that waits for it. A simulation brings its own (`use`), and plays hours in seconds."""

    def now(self) -> float:
        """Time that never runs back [s]."""
        return time.monotonic()

    def sleep(self, duration_s: float) -> None:
        time.sleep(duration_s)

    def event(self) -> Event:
        return threading.Event()

    def lock(self) -> Lock:
        return threading.Lock()

    def thread(
        self,
        target: Callable[..., None],
        name: str,
        args: tuple[Any, ...] = (),
    ) -> Thread:
        """A thread that does not keep the process from ending.

        Args:
            target: What it runs.
            name: Of the thread.
            args: What the target is called with.

        Returns:
            The thread, not started yet.
        """
        return threading.Thread(target=target, name=name, args=args, daemon=True)

    def come_after_others(self) -> None:
        """This thread computes: what measures, and what hears, comes first."""
        with contextlib.suppress(OSError, AttributeError):
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), 5)

    def come_before_others(self, which: Collection[int] = ()) -> bool:
        """This thread, or these (`threads`), come before other programs, which have their share; returns whether it was granted.

        Linux grants it to root and within the limit `nice`. Whoever calls it takes a small part of the time (`Share`).
        """
        numbers = which or [threading.get_native_id()]
        granted = [_raised(number) for number in numbers]
        return all(granted)

    @contextlib.contextmanager
    def urgently(self) -> Iterator[None]:
        """While this lasts, seconds at most, an arm waits for what this thread computes: it comes before other programs."""
        number = threading.get_native_id()
        usual = os.getpriority(os.PRIO_PROCESS, number)
        granted = _raised(number)
        try:
            yield
        finally:
            if granted:
                os.setpriority(os.PRIO_PROCESS, number, usual)


_clock = Clock()


def use(clock: Clock) -> Clock:
    """Have the whole process take its time from this clock from now on; returns the one before."""
    global _clock
    before = _clock
    _clock = clock
    return before


def now() -> float:
    """Time that never runs back [s]."""
    return _clock.now()


def now_ns() -> int:
    """The same in whole nanoseconds."""
    return round(1e9 * _clock.now())


def sleep(duration_s: float) -> None:
    """Wait; others run meanwhile."""
    _clock.sleep(duration_s)


def event() -> Event:
    """As `threading.Event`, on this clock."""
    return _clock.event()


def lock() -> Lock:
    """As `threading.Lock`, on this clock."""
    return _clock.lock()


def thread(
    target: Callable[..., None],
    name: str,
    args: tuple[Any, ...] = (),
) -> Thread:
    """A thread that waits on this clock, and does not keep the process from ending.

    Args:
        target: What it runs.
        name: Of the thread.
        args: What the target is called with.

    Returns:
        The thread, not started yet.
    """
    return _clock.thread(target, name, args)


def come_after_others() -> None:
    """Of a thread that computes, see `Clock.come_after_others`."""
    _clock.come_after_others()


def come_before_others(which: Collection[int] = ()) -> bool:
    """Of threads that must not be late, see `Clock.come_before_others`."""
    return _clock.come_before_others(which)


def urgently() -> contextlib.AbstractContextManager[None]:
    """Of a thread for which an arm waits, see `Clock.urgently`."""
    return _clock.urgently()


def _raised(number: int) -> bool:
    try:
        os.setpriority(os.PRIO_PROCESS, number, BEFORE_OTHERS)
    except ProcessLookupError:
        return True  # it has just ended
    except (OSError, AttributeError):
        return False
    return True


@dataclass
class Share:
    """Keeps what a thread computes to a part of one core, by pauses."""

    part: float  # of the time
    _owed_s: float = 0.0

    def computed(self, took_s: float) -> None:
        """Pause, where that is due after so much computing."""
        self._owed_s += took_s * (1.0 / self.part - 1.0)
        if self._owed_s > LEAST_PAUSE_S:
            sleep(self._owed_s)
            self._owed_s = 0.0

    def rested(self) -> None:
        """There was nothing to compute."""
        self._owed_s = 0.0


@dataclass
class Pacer:
    """Cycles at a fixed rate, against absolute deadlines, so that lateness does not add up."""

    period_s: float  # of a cycle
    keep: int = 10_000
    # how late each cycle began, the newest `keep`
    lateness_s: list[float] = field(default_factory=list)
    _next_s: float = field(default=float("nan"))

    def wait(self) -> float:
        """Sleep until the next cycle is due; returns how late it begins [s]. Cycles that were missed are left out."""
        began_s = now()
        if not math.isfinite(self._next_s):
            self._next_s = began_s
        if began_s < self._next_s:
            sleep(self._next_s - began_s)
            began_s = now()
        late = began_s - self._next_s
        self._next_s += self.period_s * max(1, int(late / self.period_s) + 1)
        self.lateness_s.append(late)
        if len(self.lateness_s) > self.keep:
            del self.lateness_s[: self.keep // 2]
        return late


REAL_TIME = 10  # priority in that class
BEFORE_OTHERS = -10
"""Of a scale that goes to -20: of a core that others want, too, it has nine tenths where it needs them."""
LEAST_PAUSE_S = 0.005  # shorter ones cost more than they give
LONGEST_SPIN_S = 0.5
"""A thread in real time that computes for so long without a pause has gone wrong, and would starve everything else."""


def threads() -> set[int]:
    """Those of this process, as the system numbers them."""
    return (
        set(map(int, os.listdir("/proc/self/task"))) if os.path.isdir("/proc/self/task") else set()
    )


def run_in_real_time() -> bool:
    """Ask the system to run this process as soon as it can, before all others; returns whether that was granted.

    It is for whoever keeps an arm up, since ten programs that have it leave nothing to anybody else; others `come_before_others`.
    Linux grants it to root and within the limit `rtprio`; without it, work on the same cores makes stamps less exact (with three
    busy programs on two cores a cycle in a hundred begins 5 ms late, instead of 0.1 ms). Call it when everything is imported and
    read: whoever still starts would keep the others from a core. Threads made later inherit it. Called in the main thread, it
    takes the other threads of the process along, and has the kernel watch (RLIMIT_RTTIME): a thread that spins takes the whole
    process back to where all others are. Threads of one priority take turns (SCHED_RR): with SCHED_FIFO threads of a DDS library
    that spin until another has gone on kept that one from every core, for good.
    """
    try:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(REAL_TIME))
    except (OSError, AttributeError):
        return False
    if threading.current_thread() is threading.main_thread():
        _schedule(threads(), os.SCHED_RR, REAL_TIME)
        signal.signal(signal.SIGXCPU, lambda *_: _end_spinning())
        hard = resource.getrlimit(resource.RLIMIT_RTTIME)[1]
        microseconds = round(1e6 * LONGEST_SPIN_S)
        if hard == resource.RLIM_INFINITY or hard > microseconds:
            resource.setrlimit(resource.RLIMIT_RTTIME, (microseconds, hard))
    return True


def _schedule(which: Collection[int], policy: int, priority: int) -> None:
    for number in which:
        with contextlib.suppress(OSError):  # it may just have ended
            os.sched_setscheduler(number, policy, os.sched_param(priority))


def run_like_others() -> None:
    """All threads of this process back to ordinary scheduling."""
    _schedule(threads(), os.SCHED_OTHER, 0)


def _end_spinning() -> None:
    run_like_others()
    logging.getLogger("proprio_ros").warning(
        "a thread span for %g s: no longer in real time", LONGEST_SPIN_S
    )


@dataclass
class StampClock:
    """Turns instants of the monotonic clock into stamps that run smoothly, whatever is done to the system's clock.

    That is looked at only between excitations, since a jump in the middle of one would tear it apart; `offset_ns` is its time minus
    the monotonic one.
    """

    offset_ns: int | None = None

    def look(self, system_ns: int, monotonic_s: float) -> float:
        """Follow the system's clock; returns by how much it had moved away [s]."""
        offset_ns = system_ns - round(1e9 * monotonic_s)
        moved_s = 0.0 if self.offset_ns is None else 1e-9 * (offset_ns - self.offset_ns)
        self.offset_ns = offset_ns
        return moved_s

    def stamp_ns(self, monotonic_s: float) -> int:
        """Stamp of an instant; `look` must have been called before."""
        assert self.offset_ns is not None
        return self.offset_ns + round(1e9 * monotonic_s)


@dataclass
class RoundTrips:
    """Tells round trips that took longer than usual; up to `slack_s` above the median is usual, more where they scatter more."""

    slack_s: float = 0.001
    _recent: deque[float] = field(default_factory=lambda: deque(maxlen=200))
    _limit_s: float = math.inf
    _count: int = 0

    def unusual(self, round_trip_s: float) -> bool:
        """Take one in; whether it was much longer than most of the newest 200."""
        self._recent.append(round_trip_s)
        self._count += 1
        if self._count % 20 == 0:
            middle = statistics.median(self._recent)
            scatter = statistics.median(abs(value - middle) for value in self._recent)
            self._limit_s = middle + max(self.slack_s, 6.0 * scatter)
        return round_trip_s > self._limit_s
