"""Real nodes in real processes over DDS, and a client that calls and listens; every wait has a deadline."""

from __future__ import annotations

import json
import math
import shlex
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import InertiaStamped
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import MarkerArray

from proprio_ros.nodes.graph import Graph, Patience
from proprio_ros.nodes.messages import labelled, values_of

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
HEARD = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""What is latched, and all that comes after it: a client that is not run for a while must not miss what stood meanwhile."""
UP_S = 300.0
"""A new machine compiles kernels first, and others may use it: nodes that say nothing for so long hang. One that has ended is
noticed at once."""
SOON_S = 60.0
"""What happens within a second on an idle computer. It costs time only where a test fails."""
INTERRUPTED = ("aborted", "refuses", "not ready", "fallen silent", "the joint states pause for", " scatter by ")
"""What a busy computer does to a probe, and is said. A rejected one without that is another matter."""


class Client:
    """A node in the test's process that spins in a thread and remembers what it hears."""

    def __init__(self) -> None:
        self.context = rclpy.Context()
        rclpy.init(args=[], context=self.context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node("test_client", context=self.context)
        self.states: list[JointState] = []
        self.applied: list[JointState] = []
        self.motors: list[JointState] = []
        self.estimates: list[dict[str, str]] = []
        self.statuses: list[DiagnosticStatus] = []
        self.excitation: dict[str, str] = {}
        self.excitation_message = ""
        self.diagnostics: list[DiagnosticArray] = []
        self.masses: list[float] = []
        self.withdrawn = 0
        self.markers: list[MarkerArray] = []
        self.payloads: list[InertiaStamped] = []
        listen = self.node.create_subscription
        listen(JointState, "/joint_states", self.states.append, 1000)
        listen(JointState, "/applied_effort", self.applied.append, 1000)
        listen(JointState, "/virtual/motors", self.motors.append, 1000)
        listen(DiagnosticStatus, "/identifier/status", self.statuses.append, HEARD)
        listen(DiagnosticStatus, "/excitation/status", self._on_excitation, HEARD)
        listen(DiagnosticArray, "/identifier/estimate", self._on_estimate, HEARD)
        listen(DiagnosticArray, "/diagnostics", self.diagnostics.append, 100)
        listen(Float64, "/identifier/mass", self._on_mass, HEARD)
        listen(MarkerArray, "/identifier/markers", self.markers.append, HEARD)
        listen(InertiaStamped, "/identifier/payload", self.payloads.append, HEARD)
        self.currents = self.node.create_publisher(Float64MultiArray, "/current_command", 10)
        self.positions = self.node.create_publisher(Float64MultiArray, "/position_command", 10)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        while not self._ended.is_set():
            self._executor.spin_once(timeout_sec=0.05)

    def _on_excitation(self, message: DiagnosticStatus) -> None:
        self.excitation, self.excitation_message = values_of(message), message.message

    def _on_estimate(self, message: DiagnosticArray) -> None:
        self.estimates.append(values_of(message.status[0]))

    def _on_mass(self, message: Float64) -> None:
        """Before a job a mass that stands is withdrawn: NaN."""
        if math.isfinite(message.data):
            self.masses.append(message.data)
        else:
            self.withdrawn += 1

    def close(self) -> None:
        self._ended.set()
        self._thread.join(timeout=5.0)
        self._executor.shutdown(timeout_sec=1.0)
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)

    def begin(self, service: str, kind: type = Trigger, request: Any = None) -> Any:
        """Call a service without waiting for its answer; returns the future."""
        client = self.node.create_client(kind, service)
        assert client.wait_for_service(SOON_S), f"{service} is not there"
        return client.call_async(kind.Request() if request is None else request)

    def answer(self, future: Any, seconds: float = SOON_S) -> Any:
        assert wait_for(future.done, seconds), "no answer"
        return future.result()

    def call(self, service: str, seconds: float = SOON_S) -> Any:
        return self.answer(self.begin(service), seconds)

    def asked(self, service: str) -> Any:
        """The answer of a probe; asked for again where a busy computer interrupted it, and what was heard of that forgotten."""
        for _ in range(5):
            self.estimates.clear()
            self.masses.clear()
            answer = self.call(service, 3600.0)
            if answer.success or not any(words in answer.message for words in INTERRUPTED):
                break
        return answer

    def torque(self, on: bool) -> Any:
        return self.answer(self.begin("/driver/torque", SetBool, SetBool.Request(data=on)))

    def set(self, node: str, name: str, value: Any) -> Any:
        """Set a parameter; returns the result with `successful` and `reason`."""
        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        return self.answer(self.begin(f"{node}/set_parameters", SetParameters, request)).results[0]

    def get(self, node: str, name: str) -> Any:
        request = GetParameters.Request(names=[name])
        return self.answer(self.begin(f"{node}/get_parameters", GetParameters, request)).values[0]

    def push(self, current_A: dict[str, float]) -> None:
        self.currents.publish(labelled(current_A))

    def motor(self, joint: str) -> float:
        """Current that really flows in a motor [A], by the newest word of the virtual robot."""
        message = self.motors[-1]
        return float(message.effort[list(message.name).index(joint)])

    def position(self, joint: str) -> float:
        """True position of a joint."""
        message = self.motors[-1]
        return float(message.position[list(message.name).index(joint)])

    def wait_for_phase(self, phase: str, seconds: float = SOON_S) -> None:
        assert wait_for(lambda: self.excitation.get("phase") == phase, seconds), (phase, self.excitation)


def replayed_alike(result: Path) -> dict[str, Any]:
    """What an `estimate.json` says, after its own command gave the same numbers again, bit for bit."""
    live: dict[str, Any] = json.loads(result.read_text())
    words = shlex.split(live["command"])
    assert words[0] == "proprio"
    run = subprocess.run(
        [sys.executable, "-m", "proprio_ros.cli", *words[1:], "--json"], capture_output=True, text=True, timeout=3600
    )
    assert run.returncode == 0, run.stderr
    again = json.loads(run.stdout)
    for key in ("estimates", "fit", "verdict", "reasons", "runs", "uncertainty_budget"):
        assert again[key] == live[key], key
    return live


def wait_for(ready: Callable[[], bool], seconds: float = SOON_S) -> bool:
    """Whether it became true within the time."""
    deadline = time.monotonic() + seconds
    while not ready():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.005)
    return True


def comes_up(graph: Graph, ready: Callable[[], object]) -> bool:
    """Whether it became true before the nodes fell silent: how long kernels are compiled is the computer's affair."""
    patience = Patience(UP_S)
    while not ready():
        graph.check()
        if patience.is_over(graph.said()):
            return False
        time.sleep(0.01)
    return True


def warm_up(probe: str, *settings: str) -> None:
    """Compile first, as the docs advise: the identifier does it itself, but at low priority, behind all else on a busy machine."""
    values = [word for setting in settings for word in ("--set", setting)]
    subprocess.run([sys.executable, "-m", "proprio_ros.cli", "warmup", "--probe", probe, *values], check=True)


@contextmanager
def running(
    folder: Path, *nodes: str, environment: dict[str, str] | None = None, **parameters: dict[str, Any]
) -> Iterator[tuple[Graph, Client]]:
    """The nodes (default all four), up and talking; parameters by node."""
    names = nodes or ("virtual", "driver", "excitation", "identifier")
    defaults: dict[str, dict[str, Any]] = {
        "virtual": {"link": folder / "bus", "seed": 1},
        "driver": {"port": folder / "bus"},
        "excitation": {},
        "identifier": {"data_directory": folder / "data", "calibration": "none"},
    }
    with Graph(folder / "logs", environment) as graph:
        for name in names:
            graph.start(name, defaults[name] | parameters.get(name, {}))
        client = Client()
        try:
            signs = {
                "virtual": lambda: client.motors,
                "driver": lambda: client.states,
                "excitation": lambda: client.excitation.get("phase") == "idle",
                "identifier": lambda: client.statuses and values_of(client.statuses[-1])["doing"] != "starting",
            }

            for name in names:
                assert comes_up(graph, signs[name]), graph.log(name)
            yield graph, client
        finally:
            client.close()
