"""Calls services of the nodes and says meanwhile how far they are: for `proprio call` and `proprio demo`."""

from __future__ import annotations

from collections.abc import Callable

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from proprio_ros.nodes import messages
from proprio_ros.nodes.graph import Patience
from proprio_ros.nodes.qos import LATCHED

SILENCE_S = 600.0
"""Nothing waits for a clock: on a new or a busy computer every step may take minutes. Nodes that say nothing for so long hang."""
TURN_S = 0.05

Values = dict[str, str]


class Caller:
    """A node of this process that calls services and hears what the identifier says, until it is closed.

    Args:
        name: Of the node.
        tell: Called with what is going on, a sentence at a time.
        each_turn: Called again and again while it waits; raises to end that.
        said: How much others have said elsewhere, so that waiting goes on.
        namespace: Of the nodes that are called, without slashes at its ends; empty: none.

    Attributes:
        node: The node.
        final: By probe, the keys and values of the newest final estimate that was heard.
        heard: How many messages of the identifier were heard.
        base: Namespace of the nodes, as names begin with it.
    """

    def __init__(
        self,
        name: str,
        tell: Callable[[str], None],
        each_turn: Callable[[], None] = lambda: None,
        said: Callable[[], object] = lambda: None,
        namespace: str = "",
    ) -> None:
        self._tell = tell
        self._each_turn = each_turn
        self._said = said
        self._last_words = ""
        self.heard = 0
        self.final: dict[str, Values] = {}
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self.base = f"/{namespace}" if namespace else ""
        self.node = Node(name)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self.node.create_subscription(
            DiagnosticStatus, f"{self.base}/identifier/status", self._on_status, LATCHED
        )
        self.node.create_subscription(
            DiagnosticArray, f"{self.base}/identifier/estimate", self._on_estimate, LATCHED
        )

    def close(self) -> None:
        """End the node."""
        self._executor.shutdown(timeout_sec=1.0)
        self.node.destroy_node()
        rclpy.try_shutdown()

    def _on_status(self, message: DiagnosticStatus) -> None:
        doing = messages.values_of(message).get("doing", "idle")
        words = f"{doing}: {message.message}"
        self.heard += 1
        if words != self._last_words and doing != "idle":
            self._last_words = words
            self._tell(words)

    def _on_estimate(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = messages.values_of(status)
            self.heard += 1
            if values.get("final") == "true":
                self.final[status.name] = values
            elif values.get("final") == "false":
                self._tell(status.message)

    def spin_until(
        self,
        ready: Callable[[], bool],
        silence_s: float = SILENCE_S,
    ) -> bool:
        """Whether it became so, before nobody said anything for so long [s]."""
        patience = Patience(silence_s)
        while not ready():
            self._each_turn()
            if patience.is_over((self.heard, self._said())):
                return False
            self._executor.spin_once(timeout_sec=TURN_S)
        return True
