"""`proprio call`: a service of the nodes, what they say meanwhile, and the answer; `ros2 service call` without `ros2`."""

from __future__ import annotations

import contextlib
import difflib
import json
import math
import os
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from lifecycle_msgs.srv import GetState
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter as RosParameter
from std_srvs.srv import SetBool, Trigger

from proprio_ros.errors import ConfigurationError, some
from proprio_ros.nodes import messages, middleware
from proprio_ros.nodes.calling import SILENCE_S, Caller
from proprio_ros.nodes.interface import about, interface_of, jobs, services
from proprio_ros.nodes.qos import LATCHED

SEEN_S = 12.0
"""Who uses DDS announces itself every 3 s, and on a busy computer the first words are lost."""
COMING_S = 120.0
"""Where others of these nodes are there, the one that is missing may be starting: the identifier loads most."""
SAY_S = 3.0
"""Who waits hears after so long what for."""
QUIET_S = 30.0
"""Somebody who says nothing for so long is still waited for, and that is said."""
GONE_S = 5.0
"""A service that is not listed for so long has gone, and its answer with it."""
CANCEL_S = 20.0
SWITCHES = ("torque",)
"""Services that take true or false."""
NODES = ("driver", "excitation", "identifier")
"""Those with services."""


class Interrupted(Exception):
    """SIGINT or SIGTERM, while something was waited for."""


@dataclass(frozen=True)
class Asked:
    """What is called; `to_call` makes it."""

    node: str
    service: str  # its own name
    value: bool | None = None  # of services that switch
    settings: Sequence[str] = ()  # facts about the object, as with --set
    namespace: str = ""

    @property
    def path(self) -> str:
        """Full name of the service."""
        return full_name(self.namespace, self.node, self.service)


@dataclass(frozen=True)
class Answered:
    """What a service answered."""

    service: str  # full name
    success: bool
    message: str  # a sentence
    estimate: (
        dict[str, Any] | None
    )  # what the identifier published as its result; None: nothing of this call


@dataclass(frozen=True)
class Listed:
    """A service that answers now."""

    name: str
    service: str  # full name
    node_state: str  # of its node's lifecycle
    about: str


def full_name(namespace: str, *names: str) -> str:
    """Of a node or a service in a namespace; empty: none."""
    return "/".join(["", *filter(None, (namespace, *names))])


def to_call(
    name: str,
    value: str | None = None,
    settings: Sequence[str] = (),
    namespace: str = "",
) -> Asked:
    """What a user types to call a service.

    Args:
        name: Its own, or with its node and namespace before it.
        value: ``true`` or ``false`` for a service that switches; None: nothing.
        settings: Facts about the object, ``KEY=VALUE``; empty: none.
        namespace: Of the nodes, without slashes at its ends; empty: none.

    Raises:
        ConfigurationError: There is no such service, or it takes something else.
    """
    known = services()
    *before, service = name.strip("/").split("/")
    node = known.get(service, "")
    if before[-1:] == [node]:
        before = before[:-1]
        stated = "/".join(before)
        if namespace and stated not in ("", namespace):
            raise ConfigurationError(
                f"{name}: is in namespace {stated}, and --namespace says {namespace}: leave one out"
            )
        namespace = namespace or stated
        before = []
    if not node or before:
        near = difflib.get_close_matches(service, known, 3)
        near = [full_name(namespace, known[each], each) for each in near] if before else near
        hint = f"is {' or '.join(near)} meant? " if near else ""
        raise ConfigurationError(
            f"{name}: no service of these nodes; {hint}`proprio call --list` has those that answer"
        )
    if service in SWITCHES and value not in ("true", "false"):
        raise ConfigurationError(f"{service}: write {service} true, or {service} false")
    if service not in SWITCHES and value is not None:
        raise ConfigurationError(f"{service} {value}: {service} takes no word; leave {value} out")
    if settings and node != "identifier":
        raise ConfigurationError(f"--set says nothing about {service}; leave it out")
    switch = None if value is None else value == "true"
    return Asked(node, service, switch, settings, namespace)


def call(asked: Asked, tell: Callable[[str], None]) -> Answered:
    """Call a service and wait for its answer, however long it works, as long as it says something.

    Args:
        asked: The service.
        tell: Called with what goes on, a sentence at a time.

    Returns:
        Its answer.

    Raises:
        ConfigurationError: The service is not there, or has gone; or the settings are refused.
        KeyboardInterrupt: SIGINT or SIGTERM; a job that this call began is cancelled before.
    """
    with _opened(asked.namespace, tell) as caller:
        kind = SetBool if asked.service in SWITCHES else Trigger
        client = caller.node.create_client(kind, asked.path)
        _find(caller, client, asked, tell)
        if asked.settings:
            _state(caller, asked)
        request = kind.Request() if asked.value is None else kind.Request(data=asked.value)
        future = client.call_async(request)
        is_job = asked.service in jobs().values()
        try:
            _follow(caller, client, future, asked, tell)
        except Interrupted:
            if is_job:
                tell(_cancelled(caller, asked))
            raise
        answer = future.result()
        message = str(answer.message)
        estimate = _estimate(caller, message) if is_job else None
        return Answered(asked.path, bool(answer.success), message, estimate)


def listed(namespace: str, tell: Callable[[str], None]) -> list[Listed]:
    """The services of these nodes that answer now.

    Args:
        namespace: Of the nodes; empty: none.
        tell: Called with what goes on, a sentence at a time.

    Returns:
        The services, node by node.

    Raises:
        ConfigurationError: None of the nodes answers.
        KeyboardInterrupt: SIGINT or SIGTERM.
    """
    with _opened(namespace, tell) as caller:
        clients = {}
        for node in NODES:
            name = full_name(namespace, node, "get_state")
            clients[node] = caller.node.create_client(GetState, name)

        def ready() -> list[str]:
            return [node for node, client in clients.items() if client.service_is_ready()]

        def there() -> set[str]:
            return {name for name, _ in caller.node.get_service_names_and_types()}

        def complete(node: str) -> bool:
            return {each.service for each in _services_of(node, namespace, "")} <= there()

        if not _until(caller, lambda: len(ready()) == len(NODES), SAY_S):
            tell(f"looking for nodes in {_where(namespace)}")
            _until(caller, lambda: len(ready()) == len(NODES), SEEN_S)
        states = {node: clients[node].call_async(GetState.Request()) for node in ready()}
        _until(caller, lambda: all(state.done() for state in states.values()), SEEN_S)
        # a node's services are heard of one after another
        _until(caller, lambda: all(map(complete, states)), SEEN_S)
        offered = there()
        found = []
        for node, state in states.items():
            if state.done():
                label = str(state.result().current_state.label)
                found += [
                    each for each in _services_of(node, namespace, label) if each.service in offered
                ]
        if not found:
            raise ConfigurationError(
                f"no node answers in {_where(namespace)}{_others(caller)}; {START}"
            )
        return found


START = "start them: proprio live, or proprio live --virtual"


def _services_of(node: str, namespace: str, state: str) -> list[Listed]:
    names = interface_of(node).services
    return [
        Listed(name.rpartition("/")[2], full_name(namespace, name[1:]), state, about(name))
        for name in names
    ]


@contextlib.contextmanager
def _opened(namespace: str, tell: Callable[[str], None]) -> Iterator[Caller]:
    """A caller; while it is open, SIGINT and SIGTERM end what is waited for, each of them once."""
    asked: list[int] = []

    def look() -> None:
        if asked:
            asked.clear()
            raise Interrupted

    before = {}
    for number in (signal.SIGINT, signal.SIGTERM):
        before[number] = signal.signal(number, lambda number, _: asked.append(number))
    caller: Caller | None = None
    try:
        middleware.prepare()
        caller = _caller(tell, look, namespace)
        yield caller
    except Interrupted:
        raise KeyboardInterrupt from None
    finally:
        if caller is not None:
            caller.close()
        for number, handler in before.items():
            signal.signal(number, handler)


def _caller(tell: Callable[[str], None], look: Callable[[], None], namespace: str) -> Caller:
    """A node that calls. Raises `ConfigurationError`: The middleware refuses one."""
    try:
        return Caller(f"proprio_call_{os.getpid()}", tell, look, namespace=namespace)
    except RuntimeError as error:
        rclpy.try_shutdown()
        raise ConfigurationError(f"no call: {middleware.said_by_rcl(error)}") from error


def _until(caller: Caller, ready: Callable[[], bool], seconds: float) -> bool:
    """Whether it became true in that time."""
    end_s = time.monotonic() + seconds
    caller.spin_until(lambda: ready() or time.monotonic() > end_s)
    return ready()


def _find(caller: Caller, client: Any, asked: Asked, tell: Callable[[str], None]) -> None:
    """Wait for a service, which the identifier offers when its kernels are compiled.

    Raises:
        ConfigurationError: Its node is not there, or ends.
    """
    if _until(caller, client.service_is_ready, SAY_S):
        return
    tell(f"waiting for {asked.path} in {_where(asked.namespace)}")
    node = full_name(asked.namespace, asked.node)

    def is_there() -> bool:
        return node in _nodes(caller)

    def comes() -> bool:
        return client.service_is_ready() or is_there()

    beside = {full_name(asked.namespace, each) for each in NODES}
    if not _until(caller, comes, SEEN_S) and beside & set(_nodes(caller)):
        tell(f"other nodes are there; the {asked.node} node may still be starting")
        _until(caller, lambda: comes() or not beside & set(_nodes(caller)), COMING_S)
    if not comes():
        raise ConfigurationError(
            f"there is no {asked.node} node in {_where(asked.namespace)}{_others(caller)}: start it with proprio live, or "
            f"proprio_{asked.node}; nodes elsewhere: --domain, --namespace"
        )
    if not client.service_is_ready():
        tell(f"{node} is there and still starting; on a new computer it compiles kernels")
    caller.spin_until(lambda: client.service_is_ready() or not is_there())
    if not client.service_is_ready():
        ended = (
            "says nothing"
            if is_there()
            else "has ended while it was starting: its last line says why"
        )
        raise ConfigurationError(f"{asked.path} does not come: {node} {ended}")


def _state(caller: Caller, asked: Asked) -> None:
    """State the facts about the object, as `ros2 param set` would: they stay until others are stated.

    Raises:
        ConfigurationError: The node refuses them.
    """
    named = RosParameter("settings", RosParameter.Type.STRING_ARRAY, list(asked.settings))
    node = full_name(asked.namespace, asked.node)
    client = caller.node.create_client(SetParameters, f"{node}/set_parameters")
    _until(caller, client.service_is_ready, SEEN_S)
    future = client.call_async(SetParameters.Request(parameters=[named.to_parameter_msg()]))
    if not _until(caller, future.done, SEEN_S):
        raise ConfigurationError(f"--set: {node} does not answer")
    (result,) = future.result().results
    if not result.successful:
        raise ConfigurationError(f"--set: {result.reason}")


def _follow(
    caller: Caller,
    client: Any,
    future: Any,
    asked: Asked,
    tell: Callable[[str], None],
) -> None:
    """Wait for an answer as long as the service is there.

    Args:
        caller: Of the service.
        client: Its client.
        future: Of the answer.
        asked: The service.
        tell: Called with what goes on, a sentence at a time.

    Raises:
        ConfigurationError: The service has gone, or has been silent for very long.
    """
    here_s = time.monotonic()

    def is_over() -> bool:
        nonlocal here_s
        if client.service_is_ready():
            here_s = time.monotonic()
        return bool(future.done()) or time.monotonic() - here_s > GONE_S

    quiet_s = 0.0
    heard = caller.heard
    while not caller.spin_until(is_over, QUIET_S):
        quiet_s = quiet_s + QUIET_S if caller.heard == heard else QUIET_S
        heard = caller.heard
        if quiet_s >= SILENCE_S:
            raise ConfigurationError(f"{asked.path}: no answer, and not a word for {quiet_s:g} s")
        tell(f"{asked.path} is still at work, without a word for {quiet_s:g} s")
    if not future.done():
        raise ConfigurationError(
            f"{asked.path}: the {asked.node} node has gone, and its answer with it"
        )


def _cancelled(caller: Caller, asked: Asked) -> str:
    """End the job that was begun; what came of that."""
    name = full_name(asked.namespace, asked.node, "cancel")
    client = caller.node.create_client(Trigger, name)
    future = client.call_async(Trigger.Request())
    if _until(caller, future.done, CANCEL_S):
        return str(future.result().message)
    return f"{name} does not answer: nobody knows whether the arm still moves"


def _estimate(caller: Caller, message: str) -> dict[str, Any] | None:
    """What the identifier published as the result of a job.

    Whoever comes now hears the newest status and estimate alone, which were sent before the answer was. They are this job's
    where that status has the words of the answer.

    Args:
        caller: Of the service.
        message: What was answered.

    Returns:
        Keys and values; None where others have been published since, or the job was refused.
    """
    statuses: list[DiagnosticStatus] = []
    estimates: list[DiagnosticArray] = []
    base = f"{caller.base}/identifier"
    caller.node.create_subscription(DiagnosticStatus, f"{base}/status", statuses.append, LATCHED)
    caller.node.create_subscription(DiagnosticArray, f"{base}/estimate", estimates.append, LATCHED)
    if not _until(caller, lambda: bool(statuses and estimates), GONE_S):
        return None
    of_job = statuses[0].message == message and messages.values_of(statuses[0])["doing"] == "idle"
    values = messages.values_of(estimates[0].status[0])
    if not of_job or values.get("final") != "true":
        return None
    return {key: _value(text) for key, text in values.items()}


def _value(text: str) -> Any:
    """A number, a list of numbers, true or false, or a text; None: a number that is not known."""
    try:
        value = json.loads(text)
    except ValueError:
        return None if text == "nan" else text
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _nodes(caller: Caller) -> list[str]:
    """Full names of the nodes that are heard of, without this one."""
    names = caller.node.get_node_names_and_namespaces()
    found = {full_name(namespace.strip("/"), name) for name, namespace in names}
    return sorted(found - {caller.node.get_fully_qualified_name()})


def _others(caller: Caller) -> str:
    nodes = _nodes(caller)
    return f" (nodes there: {some(nodes)})" if nodes else ""


def _where(namespace: str) -> str:
    domain = f"ROS domain {os.environ.get('ROS_DOMAIN_ID') or 0}"
    return f"{domain}, namespace {namespace}" if namespace else domain
