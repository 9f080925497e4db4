"""Simulated time for programs of several threads: one runs at a time, and time passes only while all of them wait.

Whoever waits (`sleep`, an event, a lock, the end of a thread) hands on to whoever is due next; of those who are due together a
seed says which. So a run is the same each time, however busy the machine is, and takes as long as its arithmetic.

The threads are greenlets of the one that made the clock: to hand on costs no system call, and a forked process has them all.
"""

from __future__ import annotations

import contextlib
import heapq
import math
import random
from collections.abc import Callable, Collection
from functools import partial
from typing import Any

import greenlet

LOOK_S = 1e-6
"""Who asks for the time has spent some: a loop that waits for an instant without sleeping arrives there."""


class Ended(BaseException):
    """The world has ended, or this actor was killed: unwinds its thread."""


class Actor:
    """One thread of the program; `killed` ends it where it waits next."""

    def __init__(self, name: str, group: str) -> None:
        self.name, self.group = name, group
        self.task = greenlet.getcurrent()
        self.due_s = math.inf
        self.killed = False
        self.stalled_until_s = -math.inf
        self.done = False
        self.forgotten = False


class SimulatedClock:
    """A clock, and all that waits for it; the thread that makes it is its first actor.

    Args:
        seed: Says who runs first of those that are due together.
        start_s: Time at the beginning.
    """

    def __init__(
        self,
        seed: int = 0,
        start_s: float = 1000.0,
    ) -> None:
        self._random = random.Random(seed)
        self._now_s = start_s
        self._count = 0
        self._waiting: list[tuple[float, float, int, Actor]] = []
        self.actors: list[Actor] = []
        self.failure: BaseException | None = None
        self._ended = False
        self.actor = self._enter("main", "main")
        """Who is run."""

    # --- what a program asks of a clock

    def now(self) -> float:
        self._now_s += LOOK_S
        return self._now_s

    def sleep(self, duration_s: float) -> None:
        self._wait(self._now_s + max(duration_s, 0.0))

    def event(self) -> SimulatedEvent:
        return SimulatedEvent(self)

    def lock(self) -> SimulatedLock:
        return SimulatedLock(self)

    def thread(
        self,
        target: Callable[..., None],
        name: str,
        args: tuple[Any, ...] = (),
        group: str | None = None,
    ) -> SimulatedThread:
        """A thread of the group of whoever makes it, unless another is named; killing a group ends all its threads."""
        return SimulatedThread(
            self, partial(target, *args), name, self.actor.group if group is None else group
        )

    # --- what a world does with it

    def kill(self, group: str) -> None:
        """End all threads of a group where they wait, as a process that is killed ends."""
        for actor in self.actors:
            if actor.group == group and not actor.done:
                actor.killed = True
                self.wake(actor)

    def stall(self, group: str, duration_s: float, but: str = "") -> None:
        """No thread of a group, but one of this name, is run for so long, as where others have the processor."""
        for actor in self.actors:
            if actor.group == group and actor.name != but:
                actor.stalled_until_s = self._now_s + duration_s

    def stalled(self, group: str) -> bool:
        """Whether a group waits for that."""
        return any(
            each.group == group and each.stalled_until_s > self._now_s
            for each in self.actors
            if not each.done
        )

    def come_after_others(self) -> None:
        """Here nobody is kept from a processor."""

    def come_before_others(self, which: Collection[int] = ()) -> bool:
        return False

    def urgently(self) -> contextlib.AbstractContextManager[None]:
        return contextlib.nullcontext()

    def end(self) -> None:
        """All other actors end where they wait."""
        self._ended = True
        for actor in self.actors:
            actor.killed = actor is not self.actor
            if actor.killed and not actor.done:
                self.wake(actor)
        while any(not actor.done for actor in self.actors if actor is not self.actor):
            self._wait(self._now_s)

    def draw_anew(self, seed: int) -> None:
        """From now on another seed says who runs first."""
        self._random = random.Random(seed)

    def wake(self, actor: Actor) -> None:
        """Whoever waits is due now."""
        self._push(actor, self._now_s)

    # --- the baton

    def _enter(self, name: str, group: str) -> Actor:
        actor = Actor(name, group)
        self.actors.append(actor)
        return actor

    def _push(self, actor: Actor, due_s: float) -> None:
        actor.due_s = due_s
        self._count += 1
        heapq.heappush(
            self._waiting,
            (due_s, self._random.random(), self._count, actor),
        )

    def _next(self) -> Actor:
        while True:
            if not self._waiting:
                raise RuntimeError(
                    f"everybody waits for ever: {[a.name for a in self.actors if not a.done]}"
                )
            due_s, _, _, actor = heapq.heappop(self._waiting)
            if actor.done or due_s != actor.due_s:
                continue  # was woken before
            if actor.stalled_until_s > due_s and not actor.killed:
                self._push(actor, actor.stalled_until_s)
                continue
            actor.due_s = math.inf
            self._now_s = max(self._now_s, due_s)
            return actor

    def _wait(self, until_s: float) -> None:
        """Hand on until an instant, or until somebody wakes this actor."""
        me = self.actor
        if me.killed:
            raise Ended
        if until_s < math.inf:
            self._push(me, until_s)
        else:
            me.due_s = math.inf
        following = self._next()
        if following is not me:
            self.actor = following
            try:
                following.task.switch()
            except greenlet.GreenletExit:  # nobody can reach this world any more
                me.killed = me.forgotten = True
        if me.killed:
            raise Ended
        if me is self.actors[0] and self.failure is not None and not self._ended:
            raise RuntimeError(f"a thread has failed: {self.failure!r}") from self.failure

    def _leave(self) -> None:
        """The end of a thread: hand on for good."""
        me = self.actor
        me.done = True
        self.actor = self._next()
        me.task.parent = self.actor.task  # where a greenlet goes when it ends


class SimulatedEvent:
    """As `threading.Event`."""

    def __init__(self, clock: SimulatedClock) -> None:
        self._clock = clock
        self._set = False
        self._waiters: list[Actor] = []

    def is_set(self) -> bool:
        return self._set

    def set(self) -> None:
        self._set = True
        for actor in self._waiters:
            self._clock.wake(actor)
        self._waiters.clear()

    def clear(self) -> None:
        self._set = False

    def wait(self, timeout: float | None = None) -> bool:
        clock = self._clock
        until_s = math.inf if timeout is None else clock._now_s + timeout
        while not self._set and clock._now_s < until_s:
            self._waiters.append(clock.actor)
            try:
                clock._wait(until_s)
            finally:
                if clock.actor in self._waiters:
                    self._waiters.remove(clock.actor)
        return self._set


class SimulatedLock:
    """As `threading.RLock`."""

    def __init__(self, clock: SimulatedClock) -> None:
        self._clock = clock
        self._owner: Actor | None = None
        self._depth = 0
        self._free = SimulatedEvent(clock)

    def acquire(self, blocking: bool = True) -> bool:
        me = self._clock.actor
        while self._owner not in (None, me):
            if not blocking:
                return False
            self._free.clear()
            self._free.wait()
        self._owner, self._depth = me, self._depth + 1
        return True

    def release(self) -> None:
        self._depth -= 1
        if not self._depth:
            self._owner = None
            self._free.set()

    def __enter__(self) -> bool:
        return self.acquire()

    def __exit__(self, *_: Any) -> None:
        self.release()


class SimulatedThread:
    """As `threading.Thread`."""

    def __init__(
        self,
        clock: SimulatedClock,
        target: Callable[[], None],
        name: str,
        group: str,
    ) -> None:
        self._clock, self._target, self.name = clock, target, name
        self.actor = clock._enter(name, group)
        self.actor.done = True
        self.actor.task = greenlet.greenlet(
            self._run,
            clock.actors[0].task,
        )
        self._ended = SimulatedEvent(clock)

    def start(self) -> None:
        self.actor.done = False
        self._clock.wake(self.actor)

    def is_alive(self) -> bool:
        return not self.actor.done

    def join(self, timeout: float | None = None) -> None:
        if not self.actor.done:
            self._ended.wait(timeout)

    def _run(self, *_: Any) -> None:
        try:
            if not self.actor.killed:
                self._target()
        except Ended:
            pass
        except BaseException as error:
            self._clock.failure = self._clock.failure or error
            self._clock.wake(self._clock.actors[0])
        if not self.actor.forgotten:
            self.actor.done = True
            self._ended.set()
            self._clock._leave()
