"""What `~/apply` does: the load that was weighed is handed on to the arm's own controller, where somebody asks for it.

A controller that believes in another load than it has lets the arm sink or jump. So nothing is ever handed on by itself, and only
what stands: an accepted answer that nothing newer has replaced.
"""

from __future__ import annotations

import importlib
from typing import Any

from proprio_ros.errors import ConfigurationError, ProprioError
from proprio_ros.live.payload_export import CONTROLLERS, check_tool, load_at, together
from proprio_ros.nodes.managed_node import ManagedNode
from proprio_ros.nodes.results import Results
from proprio_ros.nodes.services import Answer, call, when_there

ANSWER_S = 5.0  # a controller that takes longer has not heard
NOT_KNOWN = "it is not known whether it took it: look at the controller before the arm moves"


def stated_tool(text: str) -> list[float]:
    """Four numbers between blanks or commas; none in an empty text. Raises `ConfigurationError`: A word is no number."""
    try:
        return [float(word) for word in text.replace(",", " ").strip(" []").split()]
    except ValueError as error:
        raise ConfigurationError(
            f"hand_on_tool={text!r}: state numbers: 0.9, 0.0, 0.0, 0.06"
        ) from error


class HandingOn:
    """Calls the service of the controller that the parameter `hand_on` names, with the load that stands in the results.

    Raises `ConfigurationError`: The controller is unknown, its messages are not there, or the tool is not stated.
    """

    def __init__(self, node: ManagedNode, results: Results) -> None:
        self._node = node
        self._results = results
        self._name = name = node.values["hand_on"]
        if name == "none":
            return
        if name not in CONTROLLERS:
            raise ConfigurationError(
                f"hand_on={name!r}: choose one of none, {', '.join(CONTROLLERS)}"
            )
        self._controller = controller = CONTROLLERS[name]
        self._tool = check_tool(name, stated_tool(node.values["hand_on_tool"]))
        try:
            kinds = importlib.import_module(f"{controller.package}.srv")
        except ImportError as error:
            raise ConfigurationError(
                f"hand_on={name}: the messages of {controller.package} are not there ({error}); install "
                f"ros-jazzy-{controller.package.replace('_', '-')}, or source the workspace of the arm's driver"
            ) from error
        self._kind = getattr(kinds, controller.kind)
        self._client = node.create_client(
            self._kind, node.values["hand_on_service"] or controller.service
        )

    def _link(self, links: set[str]) -> str:
        """Whose frame is the controller's."""
        stated = self._node.values["hand_on_link"]
        if stated:
            return str(stated)
        for usual in self._controller.links:
            if usual in links:
                return usual
        usual = ", ".join(self._controller.links)
        words = f"the URDF has none of {self._name}'s usual links ({usual}): state the link of the flange"
        raise ConfigurationError(f"hand_on_link: {words}")

    def apply(self, answer: Answer) -> None:
        """Hand on what stands, or answer why not."""
        try:
            self._hand_on(answer)
        except ProprioError as error:
            answer(False, f"nothing was handed on: {error}")

    def _hand_on(self, answer: Answer) -> None:
        if self._name == "none":
            names = ", ".join(CONTROLLERS)
            raise ConfigurationError(
                f"the parameter hand_on names no controller; choose one of {names}"
            )
        standing = self._results.load
        if standing is None:
            raise ConfigurationError(
                "no accepted answer stands; weigh the object first (calibrate_payload)"
            )
        link = self._link({each.name for each in standing.robot.model.links})
        load = together(load_at(standing.robot, standing.carried, link), self._tool)
        service = self._client.srv_name
        request = self._kind.Request()
        self._controller.fill(request, load)
        tool = f", with the tool {load.mass_kg:.4g} kg" if self._tool[0] else ""
        centre = ", ".join(f"{axis:.4f}" for axis in load.com_m)
        guess = ", a guess: state payload.com" if load.com_guessed else ""
        about = f"{standing.words}{tool}, centre of mass ({centre}) m in {link}{guess}"

        def answered(response: Any, why: str) -> None:
            if why:
                answer(False, f"{why}; {NOT_KNOWN}")
            elif refusal := self._controller.refusal(response):
                answer(False, f"{service} refused {about}: {refusal}")
            else:
                self._node.say("info", f"handed on to {service}: {about}")
                answer(True, f"handed on to {service}: {about}")

        def found(there: bool) -> None:
            if there:
                call(self._node, self._client, request, ANSWER_S, answered)
            else:
                answer(
                    False, f"nothing was handed on: {service} is not there; start the arm's driver"
                )

        when_there(self._node, self._client, found)
