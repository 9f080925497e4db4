"""Switching controllers for a sequence: controller_manager activates the one that takes commands, and the user's own afterwards.

A joint is one controller's in `ros2_control`, so whoever holds the arm must let go in the very cycle in which the other takes over;
`switch_controller` does both. The node says what holds the arm from before the switch on, since a controller that becomes active
has no command yet. However a sequence ends, it is switched back: by the node, which only has to send the request, and by the
process that speaks for it once it is gone.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from rclpy.clock import Clock, ClockType

PACKAGE = "controller_manager_msgs"
STRICT = 2
"""All of it, or nothing."""
SWITCH_S = 1
"""Controller manager gives up after that."""
ANSWER_S = 3.0
"""Whoever asked for a sequence waits for five seconds."""


@dataclass(frozen=True)
class Controllers:
    """What is switched.

    Attributes:
        manager: Name of the controller manager.
        ours: Controller that takes the commands.
        others: Those that have the joints else.
    """

    manager: str
    ours: str
    others: tuple[str, ...]

    @property
    def service(self) -> str:
        """Of the switch."""
        return f"{self.manager}/switch_controller"

    def request(self, kind: Any, engage: bool) -> Any:
        """Whether to take over, or to hand back; ``kind`` is the service's class."""
        request = kind.Request()
        ours, others = [self.ours], list(self.others)
        request.activate_controllers, request.deactivate_controllers = (ours, others) if engage else (others, ours)
        request.strictness = STRICT
        request.timeout.sec = SWITCH_S
        return request


def switch_kind() -> Any:
    """The service's class.

    Raises:
        ImportError: Its package is not there.
    """
    return importlib.import_module(f"{PACKAGE}.srv").SwitchController


def own_controller(topic: str) -> str:
    """The controller that listens to a topic, by its usual name."""
    return topic.rstrip("/").split("/")[-2] if topic.count("/") > 1 else ""


class Switching:
    """Asks a controller manager, without waiting.

    Args:
        node: That asks.
        controllers: What is switched.

    Attributes:
        engaged: Whether ours is active, or may be.
        pending: Whether an answer is waited for.

    Raises:
        ImportError: The messages are not there.
    """

    def __init__(self, node: Any, controllers: Controllers) -> None:
        self._node, self.controllers = node, controllers
        self._kind = switch_kind()
        self._client = node.create_client(self._kind, controllers.service)
        self.engaged = self.pending = False

    def ask(self, engage: bool, then: Callable[[str], None]) -> None:
        """Have it switched.

        Args:
            engage: Whether to take over, or to hand back.
            then: Called later with why it was not switched; empty: it was.
        """
        if not self._client.service_is_ready():
            return then(f"{self.controllers.service} is not there: is controller_manager running?")
        # from now on ours may be active, whatever the answer
        self.pending, self.engaged = True, True
        future = self._client.call_async(self.controllers.request(self._kind, engage))

        def end(why: str, known: bool = True) -> None:
            if timer.is_canceled():
                return
            timer.cancel()
            self._node.destroy_timer(timer)
            self.pending = False
            if known:
                self.engaged = engage != bool(why)
            then(why)

        def responded(_: Any) -> None:
            if future.exception() is not None:
                return end(f"{self.controllers.service} failed: {future.exception()}", known=False)
            response = future.result()
            said = getattr(response, "message", "") or "its log says why"
            return end("" if response.ok else f"{self.controllers.service} refused: {said}")

        def too_late() -> None:
            self._client.remove_pending_request(future)
            end(f"{self.controllers.service} does not answer within {ANSWER_S:g} s", known=False)

        timer = self._node.create_timer(ANSWER_S, too_late, clock=Clock(clock_type=ClockType.STEADY_TIME))
        future.add_done_callback(responded)
        return None


def words(names: Sequence[str]) -> str:
    """Controllers, as a sentence has them."""
    return ", ".join(names) if names else "nobody (deactivate_controllers is empty)"
