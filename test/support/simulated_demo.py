"""`proprio demo` in the simulated world: its processes are actors of one clock."""

from __future__ import annotations

import signal
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

from support.simulated_world import LINK, ROOM, World


class SimulatedGraph:
    """In place of `proprio_ros.nodes.graph.Graph`."""

    def __init__(
        self,
        logs: Path,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        self.logs = logs
        self.world = World(logs.parent, only=())

    def __enter__(self) -> SimulatedGraph:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.world.close()

    def start(
        self,
        node: str,
        parameters: Mapping[str, Any],
        namespace: str = "",
        files: Sequence[str] = (),
    ) -> None:
        """Files are those of the package, which state the defaults."""
        place = {name: LINK for name in ("link", "port") if name in parameters}
        self.world.start(
            node,
            {"report": True, **parameters, **place}
            if node == "identifier"
            else {**parameters, **place},
        )

    def check(self) -> None:
        assert all(process.alive for process in self.world.processes.values())

    def said(self) -> int:
        return len(self.world.graph.log)


@contextmanager
def demonstrated() -> Iterator[Any]:
    """The function `demo`, in simulated time."""
    module = ROOM["demo"]
    before, module.Graph = module.Graph, SimulatedGraph
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield module.demo
    finally:
        module.Graph = before
        for number, handler in handlers.items():
            signal.signal(number, handler)
