"""A cable to emulated servos in memory, in simulated time: in place of `proprio_ros.virtual.port.PtyPort` and a serial port."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from proprio_ros import clock as time_source
from proprio_ros.virtual import robot as virtual_robot
from proprio_ros.virtual.bus import VirtualBus
from support.memory_port import MemoryPort
from support.simulated_time import Ended, SimulatedClock

WORLD_STEP_S = 0.025
"""The arm moves on at least so often, though nobody talks to it."""
LONGEST_WAIT_S = 0.001
PORTS: dict[str, SimulatedPort] = {}


class SimulatedPort:
    """The servos' end of the cable."""

    def __init__(self, bus: VirtualBus, link: Path | None = None, **_: Any) -> None:
        self.lock = time_source.lock()
        self.bus, self.path, self.plugged = bus, link, True
        self._running = True
        PORTS[str(link)] = self
        time_source.thread(self._run, "arm").start()

    def _run(self) -> None:
        while self._running:
            with self.lock:
                self.bus.advance(time_source.now())
            time_source.sleep(WORLD_STEP_S)

    def unplug(self) -> None:
        self.plugged = False

    def plug(self) -> None:
        self.plugged = True

    def close(self) -> None:
        self._running = False
        PORTS.pop(str(self.path), None)


class Wire(MemoryPort):
    """The computer's end of the cable.

    Args:
        clock: Of the world.
        name: Of the port.
    """

    def __init__(self, clock: SimulatedClock, name: str) -> None:
        port = PORTS.get(name)
        if port is None or not port.plugged:
            raise OSError(2, f"could not open port {name}")
        self._world, self._port = clock, port
        super().__init__(port.bus, time_source.now)

    def _check(self) -> None:
        if self._world.actor.killed:
            raise Ended  # who was killed says nothing any more
        if not self._port.plugged:
            raise OSError(5, "Input/output error")

    def write(self, data: bytes) -> int:
        self._check()
        with self._port.lock:
            return super().write(data)

    def read(self, size: int) -> bytes:
        """What has arrived; waits for it as a descriptor does, so that nobody has to look again and again."""
        self._check()
        with self._port.lock:
            data = super().read(size)
        if data or size <= 0:
            return data
        now_s = time_source.now()
        time_source.sleep(max(self._outbox.wait_s(now_s, LONGEST_WAIT_S), 1e-5))
        self._check()
        with self._port.lock:
            return super().read(size)

    def close(self) -> None:
        pass


@contextmanager
def simulated(seed: int = 0) -> Iterator[SimulatedClock]:
    """All that takes its time from `proprio_ros.clock` is in simulated time, and virtual robots are on simulated ports."""
    made = SimulatedClock(seed)
    before, virtual_robot.PtyPort = (
        (
            time_source.use(made),
            virtual_robot.PtyPort,
        ),
        SimulatedPort,
    )  # type: ignore[assignment,misc]
    try:
        yield made
        made.end()
    finally:
        time_source.use(before[0])
        virtual_robot.PtyPort = before[1]  # type: ignore[misc]
