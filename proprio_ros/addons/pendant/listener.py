"""Hears what the nodes say, in a thread of its own.

It looks for news twenty times a second: however fast joint states come, an idle pendant has to cost next to nothing.
"""

from __future__ import annotations

import contextlib
import queue
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import InertiaStamped
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from proprio_ros.addons.pendant.news import Held, News, Said
from proprio_ros.errors import ConfigurationError
from proprio_ros.nodes import messages, middleware
from proprio_ros.nodes.qos import LATCHED

LOOK_S = 0.05
PUSHED_S = 0.01
"""So often while a joint is pushed, whose way is drawn."""
NODES_S = 1.0
ANSWER_S = 5.0
"""So long a node may take to be found, and for a small question."""
AGAIN_S = 1.0
"""Then it is asked again: an answer is lost where the node has not found this one yet."""
NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
STOPS = ("excitation/abort", "identifier/cancel")
"""Both leave the arm held: the push ends, and the job with it."""


class Listener:
    """A node that listens, asks small questions, and stops the arm.

    Args:
        news: What is heard goes there.
        namespace: Of the nodes, without slashes at its ends; empty: none.

    Raises:
        ConfigurationError: The middleware refuses a node.
    """

    def __init__(self, news: News, namespace: str) -> None:
        self._news = news
        self._base = f"/{namespace}" if namespace else ""
        middleware.prepare()
        try:
            rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
            self._node = Node("proprio_pendant")
        except RuntimeError as error:
            raise ConfigurationError(f"no pendant: {middleware.said_by_rcl(error)}") from error
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._takes: list[tuple[Any, Callable[[Any], None]]] = []
        self._subscribe()
        name = f"{self._base}/identifier"
        self._stops = [self._client(Trigger, f"{self._base}/{stop}") for stop in STOPS]
        self._gets = self._client(GetParameters, f"{name}/get_parameters")
        self._sets = self._client(SetParameters, f"{name}/set_parameters")
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._spin, name="listener", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the node."""
        self._ended.set()
        self._thread.join()
        self._executor.shutdown(timeout_sec=1.0)
        self._node.destroy_node()
        rclpy.try_shutdown()

    def stop(self) -> list[str]:
        """End whatever moves the arm; what was asked to do that. Empty: nobody is there who could."""
        asked = [client for client in self._stops if client.service_is_ready()]
        for client in asked:
            client.call_async(Trigger.Request())
        return [str(client.srv_name) for client in asked]

    def parameters(self, *names: str) -> dict[str, Any] | None:
        """Those of the identifier; blocks for so long as it may take. None: it does not answer."""
        answer = self._asked(self._gets, GetParameters.Request(names=list(names)))
        if answer is None or len(answer.values) != len(names):
            return None
        values = map(parameter_value_to_python, answer.values)
        return dict(zip(names, values, strict=True))

    def state(self, values: Mapping[str, Any]) -> str:
        """Set parameters of the identifier; why it refuses, empty where it does not. Blocks as `parameters` does."""
        stated = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        answer = self._asked(self._sets, SetParameters.Request(parameters=stated))
        if answer is None:
            return "the identifier does not answer; start the nodes: proprio live"
        refused = [str(result.reason) for result in answer.results if not result.successful]
        return "; ".join(refused)

    def _client(self, kind: type, name: str) -> Any:
        return self._node.create_client(kind, name)

    def _asked(self, client: Any, request: Any) -> Any:
        """An answer of a node that may have to be found first, for which another thread waits; None: there is none."""
        if not client.wait_for_service(ANSWER_S):
            return None
        answers: queue.SimpleQueue[Any] = queue.SimpleQueue()
        ends_s = time.monotonic() + ANSWER_S
        while time.monotonic() < ends_s:
            client.call_async(request).add_done_callback(lambda it: answers.put(it.result()))
            with contextlib.suppress(queue.Empty):
                return answers.get(timeout=AGAIN_S)
        return None

    def _subscribe(self) -> None:
        hear = self._news.hear
        identifier = f"{self._base}/identifier"
        for kind, topic, take, quality in (
            (JointState, f"{self._base}/joint_states", self._on_states, NEWEST),
            # one topic for all arms
            (DiagnosticArray, "/diagnostics", self._on_diagnostics, NEWEST),
            (DiagnosticStatus, f"{self._base}/driver/status", self._on("driver"), LATCHED),
            (DiagnosticStatus, f"{self._base}/excitation/status", self._on("excitation"), LATCHED),
            (DiagnosticStatus, f"{identifier}/status", self._on("identifier"), LATCHED),
            (DiagnosticStatus, f"{identifier}/capability", self._on("capability"), LATCHED),
            (DiagnosticArray, f"{identifier}/estimate", self._on_estimate, LATCHED),
            (Bool, f"{identifier}/holding", lambda said: hear("holding", bool(said.data)), LATCHED),
            (InertiaStamped, f"{identifier}/payload", self._on_payload, LATCHED),
        ):
            subscription = self._node.create_subscription(kind, topic, take, quality)
            self._takes.append((subscription, take))

    def _spin(self) -> None:
        looked_s = 0.0
        while not self._ended.wait(PUSHED_S if self._news.pushing else LOOK_S):
            now_s = time.monotonic()
            for subscription, take in self._takes:
                _take_newest(subscription, take)
            self._executor.spin_once(timeout_sec=0.0)  # answers of services
            if now_s - looked_s > NODES_S:
                looked_s = now_s
                self._look_for_nodes()

    def _look_for_nodes(self) -> None:
        there = self._node.get_node_names_and_namespaces()
        beside = [name for name, namespace in there if namespace.rstrip("/") == self._base]
        self._news.nodes = frozenset(beside)

    def _on_states(self, message: JointState) -> None:
        self._news.hear_states(list(message.name), list(message.position), list(message.effort))

    def _on(self, about: str) -> Any:
        return lambda message: self._news.hear(about, _said(message))

    def _on_estimate(self, message: DiagnosticArray) -> None:
        now_ns = int(self._node.get_clock().now().nanoseconds)
        late_s = 1e-9 * (now_ns - messages.time_ns(message.header.stamp))
        for status in message.status:
            said = _said(status)
            final = said.values.get("final") == "true"
            self._news.hear_estimate(said, max(late_s, 0.0) if final else 0.0)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        driver = f"{self._base}/driver: ".lstrip("/")
        found = [_said(status) for status in message.status if status.name.startswith(driver)]
        # whose arm it is comes in a message of its own
        if len(found) > 1:
            self._news.hear("diagnostics", found)

    def _on_payload(self, message: InertiaStamped) -> None:
        centre = message.inertia.com
        self._news.hear("payload", Held(message.inertia.m, (centre.x, centre.y, centre.z)))


def _take_newest(subscription: Any, take: Callable[[Any], None]) -> None:
    """Without waiting for it, which costs an executor many times as much."""
    with subscription.handle:
        taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
    if taken is not None:
        take(taken[0])


def _said(message: DiagnosticStatus) -> Said:
    return Said(
        message.level[0], str(message.name), str(message.message), messages.values_of(message)
    )
