"""Real nodes in real processes over DDS, and a client that calls and listens; every wait has a deadline, for nodes that hang."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from proprio_ros.nodes.graph import Graph, Patience
from proprio_ros.nodes.messages import values_of
from support.listening import HEARD, LATCHED, Listener, replayed_alike
from support.waiting import SOON_S, wait_for

__all__ = [
    "HEARD", "LATCHED", "SOON_S", "UP_S", "Client", "comes_up", "replayed_alike", "running", "wait_for", "warm_up",
]  # fmt: skip

UP_S = 300.0
"""A new machine compiles kernels first, and others may use it: nodes that say nothing for so long hang. One that has ended is
noticed at once."""


class Client(Listener):
    """A node in the test's process that spins in a thread."""

    def __init__(self) -> None:
        self.context = rclpy.Context()
        rclpy.init(
            args=[],
            context=self.context,
            signal_handler_options=SignalHandlerOptions.NO,
        )
        super().__init__(Node("test_client", context=self.context))
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        while not self._ended.is_set():
            self._executor.spin_once(timeout_sec=0.05)

    def hear_less(self) -> None:
        """In the thread that spins: a subscription taken from under a wait ends it by an exception."""
        self._executor.create_task(super().hear_less)

    def close(self) -> None:
        self._ended.set()
        self._thread.join(timeout=5.0)
        self._executor.shutdown(timeout_sec=1.0)
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)

    def wait_for(
        self,
        ready: Callable[[], object],
        seconds: float = SOON_S,
    ) -> bool:
        return wait_for(ready, seconds)


def comes_up(
    graph: Graph,
    ready: Callable[[], object],
) -> bool:
    """Whether it became true before the nodes fell silent: how long kernels are compiled is the computer's affair."""
    patience = Patience(UP_S)
    while not ready():
        graph.check()
        if patience.is_over(graph.said()):
            return False
        time.sleep(0.01)
    return True


def warm_up(probe: str, *settings: str) -> None:
    """Compile first, as the docs advise: the identifier does it itself, while whoever waits for it waits longer."""
    values = [word for setting in settings for word in ("--set", setting)]
    subprocess.run(
        [
            sys.executable,
            "-m",
            "proprio_ros.cli",
            "warmup",
            "--probe",
            probe,
            *values,
        ],
        check=True,
    )


@contextmanager
def running(
    folder: Path,
    *nodes: str,
    environment: dict[str, str] | None = None,
    **parameters: dict[str, Any],
) -> Iterator[tuple[Graph, Client]]:
    """The nodes (default all four), up and talking; parameters by node."""
    names = nodes or ("virtual", "driver", "excitation", "identifier")
    # servos wait for none of the programs that run beside a test: an arm whose bus is silent for 0.2 s drops
    defaults: dict[str, dict[str, Any]] = {
        "virtual": {"link": folder / "bus", "seed": 1, "real_time": True},
        "driver": {"port": folder / "bus"},
        "excitation": {},
        "identifier": {"data_directory": folder / "data", "calibration": "none"},
    }
    with Graph(folder / "logs", environment) as graph:
        for name in names:
            graph.start(
                name,
                defaults[name] | parameters.get(name, {}),
            )
        client = Client()
        try:
            signs = {
                "virtual": lambda: client.motors,
                "driver": lambda: client.states,
                "excitation": lambda: client.excitation.get("phase") == "idle",
                "identifier": lambda: (
                    client.statuses and values_of(client.statuses[-1])["doing"] != "starting"
                ),
            }

            for name in names:
                assert comes_up(graph, signs[name]), graph.log(name)
            yield graph, client
        finally:
            client.close()
