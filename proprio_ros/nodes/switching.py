"""Switching controllers for a sequence: controller_manager activates the one that takes commands, and the user's own afterwards.

A joint is one controller's in `ros2_control`, so whoever holds the arm must let go in the very cycle in which the other takes over;
`switch_controller` does both. The node says what holds the arm from before the switch on, since a controller that becomes active
has no command yet. However a sequence ends, it is switched back: by the node, which only has to send the request, and by the
process that speaks for it once it is gone.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from proprio_ros.errors import ConfigurationError
from proprio_ros.nodes.managed_node import ManagedNode
from proprio_ros.nodes.services import Answer, call, when_there

if TYPE_CHECKING:
    from proprio_ros.nodes.command_watchdog import CommandWatchdog
    from proprio_ros.nodes.excitation import ExcitationNode
    from proprio_ros.nodes.outputs import Output

PACKAGE = "controller_manager_msgs"
STRICT = 2  # all of it, or nothing
SWITCH_S = 1  # controller manager gives up after that
ANSWER_S = 3.0  # whoever asked for a sequence waits for five seconds


@dataclass(frozen=True)
class Controllers:
    """What is switched by a controller manager: ours takes the commands, the others have the joints else."""

    manager: str
    ours: str
    others: tuple[str, ...]

    @property
    def service(self) -> str:
        return f"{self.manager}/switch_controller"

    def request(self, kind: Any, engage: bool) -> Any:
        """Whether to take over, or to hand back; ``kind`` is the service's class."""
        request = kind.Request()
        ours = [self.ours]
        others = list(self.others)
        request.activate_controllers, request.deactivate_controllers = (
            (ours, others) if engage else (others, ours)
        )
        request.strictness = STRICT
        request.timeout.sec = SWITCH_S
        return request


def switch_kind() -> Any:
    """The service's class; raises ImportError where its package is not there."""
    return importlib.import_module(f"{PACKAGE}.srv").SwitchController


def own_controller(topic: str) -> str:
    """The controller that listens to a topic, by its usual name."""
    return topic.rstrip("/").split("/")[-2] if topic.count("/") > 1 else ""


class Switching:
    """Asks a controller manager, without waiting.

    Attributes:
        engaged: Whether ours is active, or may be.
        pending: Whether an answer is waited for.

    Raises `ImportError`: The messages are not there.
    """

    def __init__(self, node: Any, controllers: Controllers) -> None:
        self._node = node
        self.controllers = controllers
        self._kind = switch_kind()
        self._client = node.create_client(self._kind, controllers.service)
        self.engaged = self.pending = False

    def ask(
        self,
        engage: bool,
        then: Callable[[str], None],
    ) -> None:
        """Take over, or hand back; ``then`` is called later with why it was not switched, or an empty string."""
        self.pending = True

        def found(there: bool) -> None:
            if not there:
                self.pending = False
                return then(
                    f"{self.controllers.service} is not there: is controller_manager running?"
                )
            self.engaged = True  # from now on ours may be active, whatever the answer
            request = self.controllers.request(self._kind, engage)
            return call(
                self._node, self._client, request, ANSWER_S, answered, self.controllers.service
            )

        def answered(response: Any, why: str) -> None:
            self.pending = False
            if response is not None:
                reason = getattr(response, "message", "") or "its log says why"
                why = "" if response.ok else f"{self.controllers.service} refused: {reason}"
                self.engaged = engage != bool(why)
            then(why)

        when_there(self._node, self._client, found)


def switching_of(node: ManagedNode, topic: str) -> Switching | None:
    """As the node's parameters state it; None where nobody is to switch, or the messages for it are not there.

    Raises `ConfigurationError`: Nobody says which controller takes the commands on this topic.
    """
    values = node.values
    if not values["controller_manager"]:
        return None
    ours = values["activate_controller"] or own_controller(topic)
    if not ours:
        words = f"activate_controller is empty, and {topic} names no controller"
        raise ConfigurationError(f"{words}: state which one takes the commands")
    manager = values["controller_manager"].rstrip("/")
    others = tuple(values["deactivate_controllers"])
    try:
        return Switching(node, Controllers(manager, ours, others))
    except ImportError as error:
        lacks = (
            f"controllers are not switched, for the messages of {PACKAGE} are not there ({error})"
        )
        install = f"activate {ours} yourself before a sequence, or install ros-jazzy-{PACKAGE.replace('_', '-')}"
        node.say("warning", f"{lacks}: {install}")
        return None


class SwitchedRuns:
    """A node's sequences between two switches; the output holds the arm, and the watchdog stands in for a node that is gone."""

    def __init__(
        self, node: ExcitationNode, switching: Switching, watchdog: CommandWatchdog, output: Output
    ) -> None:
        self._node = node
        self._switching = switching
        self._watchdog = watchdog
        self._output = output
        self._waiting: list[Answer] = []  # for the end of a switch
        others = switching.controllers.others
        self._others = ", ".join(others) if others else "nobody (deactivate_controllers is empty)"

    @property
    def engaged(self) -> bool:
        """Whether our controller is active, or may be."""
        return self._switching.engaged

    def run(self, answer: Answer) -> None:
        """Serves ~/run: what holds the arm is said before the switch, and the sequence begins after it."""
        if self._switching.pending:
            self._waiting.append(answer)
        elif self._switching.engaged:
            answer(*self._node.begin_run())
        elif why := self._node.refused():
            answer(False, why)
        else:
            self._output.begin()
            self._watchdog.engaged = True
            self._switching.ask(True, partial(self._engaged, answer))

    def _engaged(self, answer: Answer, why: str) -> None:
        if why:
            answer(False, f"the controllers were not switched: {why}")
        else:
            answer(*self._node.begin_run())
        if not self._switching.engaged:
            self._handed_back()
        elif not self._node.busy:
            self.back()
        self._go_on()

    def back(self) -> None:
        """Switch back, if it is switched; until that is known, our output holds the arm."""
        if self._switching.engaged and not self._switching.pending:
            self._switching.ask(False, self._back)

    def _back(self, why: str) -> None:
        if why:
            self._node.say(
                "error", f"not switched back: {why}; the arm is held, and ~/release tries again"
            )
        else:
            self._node.say("info", f"the arm is handed back to {self._others}")
            self._handed_back()
        self._go_on()

    def _handed_back(self) -> None:
        self._watchdog.engaged = False
        self._output.hand_over()

    def _go_on(self) -> None:
        waiting = self._waiting
        self._waiting = []
        for answer in waiting:
            self.run(answer)

    def release(self) -> str:
        """Give the arm back now, or try again; says so."""
        self.back()
        return f"giving the arm back to {self._others}"
