"""What a test's client of the nodes remembers and asks, over DDS (`live`) or in the simulated world (`simulated_live`)."""

from __future__ import annotations

import json
import math
import shlex
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import InertiaStamped
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import MarkerArray

from proprio_ros.nodes.messages import labelled, values_of
from support.waiting import SOON_S

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
HEARD = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""What is latched, and all that comes after it: a client that is not run for a while must not miss what stood meanwhile."""


class Listener:
    """Remembers what it hears.

    Args:
        node: That listens and calls.
    """

    def __init__(self, node: Any) -> None:
        self.node = node
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
        listen = node.create_subscription
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
        self.currents = node.create_publisher(Float64MultiArray, "/current_command", 10)
        self.positions = node.create_publisher(Float64MultiArray, "/position_command", 10)

    def wait_for(
        self,
        ready: Callable[[], object],
        seconds: float = SOON_S,
    ) -> bool:
        """Whether it became true within the time."""
        raise NotImplementedError

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

    def begin(
        self,
        service: str,
        kind: Any = Trigger,
        request: Any = None,
    ) -> Any:
        """Call a service without waiting for its answer; returns the future."""
        client = self.node.create_client(kind, service)
        assert client.wait_for_service(SOON_S), f"{service} is not there"
        return client.call_async(kind.Request() if request is None else request)

    def answer(self, future: Any, seconds: float = SOON_S) -> Any:
        assert self.wait_for(future.done, seconds), "no answer"
        return future.result()

    def call(self, service: str, seconds: float = 3600.0) -> Any:
        """The answer, however long it takes."""
        return self.answer(self.begin(service), seconds)

    def asked(self, service: str) -> Any:
        """The answer of a probe; what was heard of those before is forgotten."""
        self.estimates.clear()
        self.masses.clear()
        return self.call(service)

    def hear_less(self) -> None:
        """Hundreds of joint states a second are much for who looks at none of them."""
        for subscription in list(self.node.subscriptions):
            if subscription.topic_name in ("/joint_states", "/applied_effort"):
                self.node.destroy_subscription(subscription)

    def final(self) -> bool:
        """Whether the newest estimate is one that stays; a service's answer may come before it."""
        return bool(self.estimates) and self.estimates[-1]["final"] == "true"

    def torque(self, on: bool) -> Any:
        return self.answer(self.begin("/driver/torque", SetBool, SetBool.Request(data=on)))

    def set(
        self,
        node: str,
        name: str,
        value: Any,
    ) -> Any:
        """Set a parameter; returns the result with `successful` and `reason`."""
        request = SetParameters.Request(
            parameters=[Parameter(name, value=value).to_parameter_msg()]
        )
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
        assert self.wait_for(lambda: self.excitation.get("phase") == phase, seconds), (
            phase,
            self.excitation,
        )


def replayed_alike(result: Path) -> dict[str, Any]:
    """What an `estimate.json` says, after its own command gave the same numbers again, bit for bit."""
    live: dict[str, Any] = json.loads(result.read_text())
    words = shlex.split(live["command"])
    assert words[0] == "proprio"
    run = subprocess.run(
        [
            sys.executable,
            "-m",
            "proprio_ros.cli",
            *words[1:],
            "--json",
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    again = json.loads(run.stdout)
    for key in ("estimates", "fit", "verdict", "reasons", "runs", "uncertainty_budget"):
        assert again[key] == live[key], key
    return live
