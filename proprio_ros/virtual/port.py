"""How an emulated bus is reached: a pseudo-terminal that any serial library opens.

It stands for a USB adapter: replies come after their time on the wire, and `PtyPort.unplug` pulls the
cable. It has no baud rate, and no latency timer.
"""

from __future__ import annotations

import contextlib
import heapq
import os
import select
import threading
import time
import tty
from collections.abc import Callable, Iterable
from pathlib import Path
from queue import SimpleQueue

from proprio_ros.errors import ConfigurationError
from proprio_ros.virtual.bus import Reply, VirtualBus

_LONGEST_WAIT_S = 0.002  # the world lags behind the clock by no more
_CHUNK = 4096


class Outbox:
    """Replies on their way to the computer."""

    def __init__(self) -> None:
        self._waiting: list[tuple[float, int, bytes]] = []
        self._count = 0

    def put(self, replies: Iterable[Reply], now_s: float) -> None:
        """Send replies, each to arrive after its delay."""
        for reply in replies:
            self._count += 1  # keeps the order of replies that are due together
            heapq.heappush(
                self._waiting,
                (now_s + reply.delay_s, self._count, reply.data),
            )

    def take(self, now_s: float) -> bytes:
        """Everything that has arrived by now."""
        arrived = b""
        while self._waiting and self._waiting[0][0] <= now_s:
            arrived += heapq.heappop(self._waiting)[2]
        return arrived

    def wait_s(self, now_s: float, longest_s: float) -> float:
        """Time to the next arrival, at most ``longest_s``."""
        return min(longest_s, max(0.0, self._waiting[0][0] - now_s)) if self._waiting else longest_s

    def clear(self) -> None:
        """Lose what is on its way."""
        self._waiting.clear()


class PtyPort:
    """A pseudo-terminal with the emulated bus behind it, in a thread that keeps the world in the pace of real time.

    The bus's ``advance`` is called at least every 2 ms, from that thread only. ``link`` points to it, as a udev rule would make it.

    Attributes:
        lock: Held while bus and world are touched; hold it to change faults, servos or the world from outside.

    Raises `ConfigurationError`: ``link`` exists and is no link.
    """

    def __init__(
        self,
        bus: VirtualBus,
        link: Path | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        if link is not None and link.exists() and not link.is_symlink():
            raise ConfigurationError(
                f"port link {link}: a file of that name exists: choose another name or remove it"
            )
        self.lock = threading.Lock()
        self._bus = bus
        self._link = link
        self._clock = clock
        self._outbox = Outbox()
        self._fds: tuple[int, int] | None = None  # master and slave
        self._slave_path: Path | None = None
        self._orders: SimpleQueue[tuple[Callable[[], None], threading.Event]] = SimpleQueue()
        self._wake_read, self._wake_write = os.pipe()
        self._running = True
        self._failure: BaseException | None = None
        self._open()
        self._thread = threading.Thread(
            target=self._run,
            name="virtual bus",
            daemon=True,
        )
        self._thread.start()

    @property
    def path(self) -> Path:
        """What a client opens: the link if there is one. Raises `ConfigurationError`: It is unplugged and has no link."""
        if self._link is not None:
            return self._link
        if self._slave_path is None:
            raise ConfigurationError("virtual port: it is unplugged: plug it in first")
        return self._slave_path

    def unplug(self) -> None:
        """Pull the USB cable: the client's next access fails, the servos stay powered."""
        self._in_thread(self._hang_up)

    def plug(self) -> None:
        """Plug it in again; a new pseudo-terminal under the same link."""
        self._in_thread(self._open)

    def close(self) -> None:
        """Stop the thread and remove the link. Raises `Exception`: What stopped the thread before, from the world or the bus."""
        if self._thread.is_alive():
            self._in_thread(self._stop)
            self._thread.join()
        if self._wake_read >= 0:
            os.close(self._wake_read)
            os.close(self._wake_write)
            self._wake_read = self._wake_write = -1
        failure = self._failure
        self._failure = None
        if failure is not None:
            raise failure

    def _in_thread(self, order: Callable[[], None]) -> None:
        """Descriptors are opened and closed by the thread that waits for them, so that none is reused under it."""
        done = threading.Event()
        self._orders.put((order, done))
        if self._wake_write >= 0:
            os.write(self._wake_write, b"!")
        while not done.wait(0.05):
            if not self._thread.is_alive():
                return

    def _open(self) -> None:
        if self._fds is not None:
            return
        master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(master, False)
        # the slave stays open here: else the first client that closes it would hang up the master
        self._fds = (master, slave)
        self._slave_path = Path(os.ttyname(slave))
        if self._link is not None:
            beside = self._link.with_name(f".{self._link.name}.{os.getpid()}")
            beside.unlink(missing_ok=True)
            beside.symlink_to(self._slave_path)
            os.replace(beside, self._link)

    def _hang_up(self) -> None:
        if self._fds is None:
            return
        for descriptor in self._fds:
            os.close(descriptor)
        if (
            self._link is not None
            and self._link.is_symlink()
            and self._link.readlink() == self._slave_path
        ):
            self._link.unlink()
        self._fds = self._slave_path = None
        self._outbox.clear()

    def _stop(self) -> None:
        self._running = False

    def _run(self) -> None:
        try:
            while self._running:
                self._turn()
        except BaseException as error:
            self._failure = error
        finally:
            self._hang_up()

    def _turn(self) -> None:
        """Wait for bytes, a reply's time or 2 ms; then do what is due."""
        watched = [self._wake_read] if self._fds is None else [self._wake_read, self._fds[0]]
        ready, _, _ = select.select(
            watched, [], [], self._outbox.wait_s(self._clock(), _LONGEST_WAIT_S)
        )
        if self._wake_read in ready:
            os.read(self._wake_read, _CHUNK)
        while not self._orders.empty():
            order, done = self._orders.get()
            try:
                order()
            finally:
                done.set()
        if self._fds is not None and self._fds[0] in ready:
            with contextlib.suppress(BlockingIOError):
                data = os.read(self._fds[0], _CHUNK)
                with self.lock:
                    now_s = self._clock()
                    self._outbox.put(self._bus.receive(data, now_s), now_s)
        arrived = self._outbox.take(self._clock())
        if arrived and self._fds is not None:
            # nobody reads and the buffer is full: what does not fit is lost, as in an adapter
            with contextlib.suppress(BlockingIOError):
                os.write(self._fds[0], arrived)
        if not arrived:
            with self.lock:
                self._bus.advance(self._clock())
