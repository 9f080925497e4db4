"""The whole robot in one process and in simulated time: servos, driver, excitation, identifier, and whoever calls them.

The nodes are those that run on the robot, the bytes on the bus are those of the vendor's library; clock and transport are stand-ins
(`simulated_time`, `simulated_ros`). The nodes' modules are loaded a second time for that, on the stand-ins, so that real nodes may
live in the same process.
"""

from __future__ import annotations

import contextlib
import importlib
import math
import random
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

import proprio_ros
from proprio_ros import clock as time_source
from proprio_ros.bus.dynamixel import DynamixelBus
from proprio_ros.sim import runtime as kernels
from proprio_ros.virtual import robot as virtual_robot
from proprio_ros.virtual.objects import HandObject
from proprio_ros.virtual.servo import CONTROL_PERIOD_S
from support import simulated_ros
from support.simulated_port import SimulatedPort, Wire
from support.simulated_ros import GRAPH, Graph, Network
from support.simulated_time import Ended, SimulatedClock, SimulatedThread


def _on_stand_ins() -> dict[str, ModuleType]:
    """The nodes' modules, made anew on the stand-ins; those that others import are left as they were."""
    room = "proprio_ros.nodes"

    def taken() -> dict[str, ModuleType]:
        names = [name for name in sys.modules if name == room or name.startswith(f"{room}.")]
        return {name: sys.modules.pop(name) for name in names}

    before = taken()
    attribute = getattr(proprio_ros, "nodes", None)
    try:
        with simulated_ros.installed():
            return {
                name: importlib.import_module(f"{room}.{name}")
                for name in (*NODES, "managed_node", "process", "demo")
            }
    finally:
        taken()
        sys.modules.update(before)
        if attribute is not None:
            proprio_ros.nodes = attribute


NODES = {
    "virtual": "VirtualNode", "driver": "DriverNode", "excitation": "ExcitationNode", "identifier": "IdentifierNode",
}  # fmt: skip
ROOM = _on_stand_ins()
ROOM["managed_node"].run_in_real_time = lambda: True  # nothing here is bound to any time
ROOM["managed_node"].come_before_others = lambda *_: True
LINK = "/simulated/arm"


class Process:
    """A node as a process: it may be asked to end, killed and started again."""

    def __init__(
        self,
        world: World,
        name: str,
        make: Callable[[], Any],
    ) -> None:
        self._world, self.name, self._make = world, name, make
        self.node: Any = None
        self.code: int | None = None
        self.start()

    def start(self) -> None:
        self._ended = self._world.clock.event()
        self._thread: SimulatedThread = self._world.clock.thread(
            self._run, self.name, group=self.name
        )
        self._thread.start()

    def _run(self) -> None:
        def make() -> Any:
            self.node = self._make()
            return self.node

        self.code = ROOM["process"].live(make, self._ended)

    @property
    def alive(self) -> bool:
        return self._thread.is_alive()

    def ask(
        self,
        do: Callable[[Any], None],
    ) -> None:
        """Have the node do something in its own thread, as a callback would."""
        timer: list[Any] = []

        def once() -> None:
            self.node.destroy_timer(timer[0])
            do(self.node)

        timer.append(self.node.create_timer(1e-3, once))

    def end(self) -> None:
        """As Ctrl-C."""
        self._ended.set()
        self._thread.join(20.0)

    def kill(self) -> None:
        """As ``kill -9``."""
        self._world.clock.kill(self.name)
        self._world.graph.remove(self.name)


class CoarseRobot(virtual_robot.VirtualRobot):
    """Of which what it does matters, and not how exactly.

    Its servos and its arm move on by 2 ms, in one step of first order: within 25 mrad of the finer ones in a push of 0.5 rad, as
    with steps of 1 ms, at a fifth of the cost.
    """

    control_period_s = 2.0 * CONTROL_PERIOD_S

    def __init__(self, *rest: Any, **more: Any) -> None:
        super().__init__(*rest, **more)
        self._coarsen()

    def hold(self, thing: HandObject | None) -> None:
        super().hold(thing)
        with self.port.lock:
            self._coarsen()

    def _coarsen(self) -> None:
        arm = self.arm
        arm._substeps, arm._substep_s = 1, self.control_period_s
        arm.model.opt.timestep = self.control_period_s
        arm.model.opt.integrator = arm.mujoco.mjtIntegrator.mjINT_IMPLICITFAST


class NoWatchdog:
    """In the place of the process that stands in for a node that was killed; see test/nodes/test_position_controller.py."""

    alive = due = heard = True
    engaged = False

    def __init__(self, *_: Any) -> None:
        pass

    def is_publisher(self, info: Any) -> bool:
        return False

    def update(self, efforts: Any) -> None:
        pass

    def clear(self) -> None:
        pass

    def close(self) -> None:
        pass


class World:
    """An arm with its servos, and the nodes around it.

    Args:
        data: Folder of the identifier.
        seed: Of who runs first, and of the network.
        network: How messages come.
        nodes: Parameters by node, beside those that are needed.
        only: The nodes that are started.
        coarse: Whether the robot is a `CoarseRobot`.
    """

    def __init__(
        self,
        data: Path,
        seed: int = 0,
        network: Network | None = None,
        nodes: dict[str, dict[str, Any]] | None = None,
        only: tuple[str, ...] = tuple(NODES),
        coarse: bool = False,
    ) -> None:
        given = nodes or {}
        self.clock = SimulatedClock(seed)
        self.graph = Graph(self.clock, seed, network or Network())
        GRAPH.append(self.graph)
        self._before = time_source.use(self.clock), virtual_robot.PtyPort, kernels.progress
        # what has to be compiled is said, so that a world would go another way on a computer that has no kernels yet
        kernels.progress = SimpleNamespace(say=lambda _words: None)  # type: ignore[assignment]
        virtual_robot.PtyPort = SimulatedPort  # type: ignore[assignment,misc]
        ROOM["driver"].DynamixelBus = lambda port, *rest: DynamixelBus(
            port, *rest, connect=partial(Wire, self.clock, port)
        )
        ROOM["virtual"].VirtualRobot = CoarseRobot if coarse else virtual_robot.VirtualRobot
        ROOM["excitation"].CommandWatchdog = NoWatchdog
        self._needed: dict[str, dict[str, Any]] = {
            "virtual": {"link": LINK},
            "driver": {"port": LINK},
            "excitation": {},
            "identifier": {"data_directory": data, "report": False},
        }
        self.processes: dict[str, Process] = {}
        for name in only:
            self.start(name, given.get(name, {}))
        self.user = self.somebody("user")

    def start(
        self,
        name: str,
        values: dict[str, Any],
        namespace: str = "",
        called: str = "",
    ) -> Process:
        """Start a node; what is not a word, a number or a list becomes a word. ``called``: its process, where names would clash."""
        plain = {
            key: str(value) if isinstance(value, Path) else value
            for key, value in {**self._needed[name], **values}.items()
        }
        overrides = [Parameter(key, value=value) for key, value in plain.items()]
        kind = getattr(ROOM[name], NODES[name])
        make = partial(
            kind, parameter_overrides=overrides, **({"namespace": namespace} if namespace else {})
        )
        called = called or name
        self.processes[called] = Process(self, called, make)
        return self.processes[called]

    def draw_anew(self, seed: int) -> None:
        """From now on another seed says who runs first, and how messages come."""
        self.clock.draw_anew(seed)
        self.graph.random = random.Random(seed)

    def somebody(self, name: str) -> Any:
        """A node that listens and calls, of a process of its own."""
        node = simulated_ros.SimulatedNode(name)

        def spin() -> None:
            while True:
                node.spin_once(math.inf)

        self.clock.thread(spin, name, group=name).start()
        return node

    def call(
        self,
        service: str,
        kind: Any = Trigger,
        request: Any = None,
        within_s: float = 600.0,
    ) -> Any:
        """The answer of a service; None where it never comes."""
        client = self.user.create_client(kind, service)
        client.wait_for_service(60.0)
        future, answered = client.call_async(request or kind.Request()), self.clock.event()
        future.add_done_callback(lambda _: answered.set())
        answered.wait(within_s)
        self.user.destroy_client(client)
        return future.result()

    @property
    def arm(self) -> Any:
        return self.processes["virtual"].node._robot

    def close(self) -> None:
        with contextlib.suppress(Ended):
            self.clock.end()
        before, virtual_robot.PtyPort, kernels.progress = self._before  # type: ignore[misc]
        time_source.use(before)
        GRAPH.remove(self.graph)


@contextlib.contextmanager
def world(data: Path, **options: Any) -> Iterator[World]:
    made = World(data, **options)
    try:
        yield made
    finally:
        made.close()
