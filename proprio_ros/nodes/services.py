"""Services without threads that wait: calls whose answer comes later, and services that answer later."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from std_srvs.srv import Trigger

from proprio_ros import clock

if TYPE_CHECKING:
    from proprio_ros.nodes.managed_node import ManagedNode

HEARD_OF_S = 1.5
"""For so long a service is looked for before it is said not to be there: who asks waits for five seconds."""
LOOK_S = 0.02  # between two looks for a service

Answer = Callable[[bool, str], None]
"""Answers a service call, once, from any thread: success and a sentence."""


def call(
    node: ManagedNode,
    client: Any,
    request: Any,
    patience_s: float,
    then: Callable[[Any, str], None],
    name: str = "",
) -> None:
    """Call a service without waiting for its answer.

    Args:
        node: The node that calls.
        client: Its client of the service.
        request: What is asked.
        patience_s: After so long without an answer the call has failed [s].
        then: Is called later, once: with the response and an empty string, or with None and what went wrong.
        name: Of the service in messages; empty: as the client has it.
    """
    future = client.call_async(request)
    named = name or client.srv_name

    def end(response: Any, why: str) -> None:
        if not timer.is_canceled():
            timer.cancel()
            node.destroy_timer(timer)
            then(response, why)

    def responded(_: Any) -> None:
        error = future.exception()
        if error:
            end(None, f"{named} failed: {error}")
        else:
            end(future.result(), "")

    def too_late() -> None:
        client.remove_pending_request(future)
        end(None, f"{named} does not answer within {patience_s:g} s")

    timer = node.every(patience_s, too_late)
    future.add_done_callback(responded)


def when_there(node: ManagedNode, client: Any, then: Callable[[bool], None]) -> None:
    """Look for a service without waiting: on a busy computer it is heard of late.

    Args:
        node: The node that looks.
        client: Its client of the service.
        then: Is called once with whether the service is there; at once where it is.
    """
    if client.service_is_ready():
        then(True)
        return
    end_s = clock.now() + HEARD_OF_S

    def look() -> None:
        there = client.service_is_ready()
        if (there or clock.now() > end_s) and not timer.is_canceled():
            timer.cancel()
            node.destroy_timer(timer)
            then(there)

    timer = node.every(LOOK_S, look)


def once(answer: Answer) -> Answer:
    """Answers with what is said first, from whichever thread, and drops the rest."""
    lock = clock.lock()
    answered = False

    def first(success: bool, message: str) -> None:
        nonlocal answered
        with lock:
            again = answered
            answered = True
        if not again:
            answer(success, message)

    return first


def within(
    node: ManagedNode, seconds: float, answer: Answer, too_late: Callable[[], str]
) -> Answer:
    """Answers with what is said first, or after so long that it has failed.

    Args:
        node: The node that serves; in its thread.
        seconds: From now on.
        answer: Of the call.
        too_late: Gives the sentence that is answered then.

    Returns:
        What is to be said, once or more, from any thread.
    """
    first = once(answer)

    def end() -> None:
        timer.cancel()
        node.destroy_timer(timer)
        first(False, too_late())

    timer = node.every(seconds, end)
    return first


class LongService:
    """A `std_srvs/Trigger` service that is answered later, without a thread that waits.

    rclpy answers when the callback returns; a coroutine that waits, or `MultiThreadedExecutor`, keeps a processor busy until
    then (rclpy 7.1: the identifier stood at 95 % of a core). So the answer is held back at the service's own `send_response`.

    Args:
        node: The node that serves.
        name: Of the service.
        serve: Is called with what answers the call; it returns at once.
    """

    def __init__(self, node: ManagedNode, name: str, serve: Callable[[Answer], None]) -> None:
        self._serve = serve
        self._service = node.create_service(Trigger, name, lambda request, response: response)
        self._send = self._service.send_response
        self._service.send_response = self._begin

    def _begin(self, response: Trigger.Response, header: Any) -> None:
        def answer(success: bool, message: str) -> None:
            response.success = success
            response.message = message
            # the caller, or this node, may be gone by now
            with contextlib.suppress(RuntimeError):
                self._send(response, header)

        self._serve(answer)
