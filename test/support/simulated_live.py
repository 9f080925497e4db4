"""A client in the simulated world: calls and listens as one over DDS does, and waits in simulated time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from proprio_ros.nodes.messages import values_of
from support.listening import Listener
from support.simulated_ros import Network
from support.simulated_world import World, world
from support.waiting import SOON_S, comes_true


class Client(Listener):
    """Of a world; see `Listener` for what it remembers."""

    def __init__(self, made: World, name: str = "client") -> None:
        self.world, self.clock = made, made.clock
        super().__init__(made.somebody(name))

    def wait_for(
        self,
        ready: Callable[[], object],
        seconds: float = SOON_S,
    ) -> bool:
        """Whether it became true within that simulated time."""
        return comes_true(
            ready,
            seconds,
            self.clock.now,
            self.clock.sleep,
        )

    def log(self, node: str) -> str:
        """What a node has logged, a line each."""
        return "\n".join(text for _, name, _, text in self.world.graph.log if name == node)

    def assert_well(self) -> None:
        """No node has ended by itself, and none has had a defect."""
        assert all(process.alive for process in self.world.processes.values())
        assert not [text for *_, text in self.world.graph.log if "a defect in" in text]


@contextmanager
def running(
    folder: Path,
    *nodes: str,
    seed: int = 0,
    network: Network | None = None,
    **parameters: dict[str, Any],
) -> Iterator[Client]:
    """The nodes (default all four), up and talking; parameters by node."""
    names = nodes or ("virtual", "driver", "excitation", "identifier")
    given = {
        "virtual": {
            "seed": 1,
            **parameters.get("virtual", {}),
        },
        "driver": parameters.get("driver", {}),
        "excitation": parameters.get("excitation", {}),
        "identifier": {
            "calibration": "none",
            "report": True,
            **parameters.get("identifier", {}),
        },
    }
    with world(
        folder / "data",
        seed=seed,
        network=network,
        nodes=given,
        only=names,
    ) as made:
        client = Client(made)
        signs = {
            "virtual": lambda: client.motors,
            "driver": lambda: client.states,
            "excitation": lambda: client.excitation.get("phase") == "idle",
            "identifier": lambda: (
                client.statuses and values_of(client.statuses[-1])["doing"] != "starting"
            ),
        }
        for name in names:
            assert client.wait_for(signs[name]), client.log(name)
        yield client
        client.assert_well()
