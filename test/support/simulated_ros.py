"""ROS in one process and in simulated time: the part of rclpy that the nodes use, without DDS.

`installed` puts stand-ins where rclpy has its nodes and executors; messages, parameters and qualities of service are rclpy's own.
Messages take a while, and a `Network` may lose, double or reorder them as its seed says.
"""

from __future__ import annotations

import contextlib
import functools
import heapq
import inspect
import itertools
import math
import random
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock

from support.simulated_time import Ended, SimulatedClock

SYSTEM_AHEAD_NS = 1_700_000_000_000_000_000
"""System time where the clock of the world says zero."""

SENT_AGAIN_S = 0.2
"""After which a reliable middleware has sent again what was lost."""


@dataclass
class Network:
    """How messages come: after `delay_s` to `delay_s + jitter_s`, in order unless `reorder`."""

    delay_s: float = 3e-4
    jitter_s: float = 2e-4
    lose: float = 0.0
    double: float = 0.0
    reorder: float = 0.0
    late: float = 0.0
    late_s: float = 0.2


@dataclass
class Graph:
    """All nodes, and who talks to whom."""

    clock: SimulatedClock
    seed: int = 0
    network: Network = field(default_factory=Network)
    nodes: list[SimulatedNode] = field(default_factory=list)
    log: list[tuple[float, str, str, str]] = field(default_factory=list)
    set_by_s: float = 0.0
    """By how much somebody has set the system's clock."""
    by_topic: dict[str, list[Subscription]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.random = random.Random(self.seed)

    def all(self, kind: str) -> Iterator[Any]:
        for node in self.nodes:
            yield from getattr(node, f"_ros_{kind}")

    def subscribers(self, topic: str) -> list[Subscription]:
        """Who listens to a topic, in the order of `all`; looked up once until somebody begins or ends to."""
        if topic not in self.by_topic:
            self.by_topic[topic] = [
                each for each in self.all("subscriptions") if each.topic_name == topic
            ]
        return self.by_topic[topic]

    def arrival(self, last_s: float) -> list[float]:
        """When a message comes, after whichever came last from the same publisher; not at all where it is lost."""
        network = self.network
        draw = self.random.random
        if draw() < network.lose:
            return []
        at_s = self.clock._now_s + network.delay_s + network.jitter_s * draw()
        if draw() < network.late:
            at_s += network.late_s * draw()
        if not draw() < network.reorder:
            at_s = max(at_s, last_s)
        return [at_s, at_s + network.jitter_s] if draw() < network.double else [at_s]

    def call_arrival(self) -> float:
        """When a service's request or answer comes: calls are reliable, what is lost is sent again."""
        arrivals = self.arrival(-math.inf)
        return arrivals[0] if arrivals else self.clock._now_s + SENT_AGAIN_S

    def remove(self, group: str) -> None:
        """A process is gone, and all it offered."""
        self.nodes = [node for node in self.nodes if node.group != group]
        self.by_topic.clear()


GRAPH: list[Graph] = []


class Publisher:
    def __init__(
        self,
        node: SimulatedNode,
        kind: type,
        topic: str,
        qos: Any,
    ) -> None:
        self._node, self.msg_type, self.topic_name, self.topic = node, kind, topic, topic
        self.latched = (
            isinstance(qos, QoSProfile) and qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
        )
        self.last: bytes | None = None
        self._number = 0

    def publish(self, message: Any) -> None:
        graph = self._node.graph
        if graph.clock.actor.killed:
            raise Ended  # who was killed says nothing any more
        self._number += 1
        if isinstance(message, bytes):
            data = message
        else:
            assert isinstance(message, self.msg_type), (
                f"{self.topic_name}: {type(message)} is no {self.msg_type}"
            )
            if not self.latched and not graph.subscribers(self.topic_name):
                return
            data = serialize_message(message)
        if self.latched:
            self.last = data
        for subscription in graph.subscribers(self.topic_name):
            if subscription.msg_type is self.msg_type:
                subscription.deliver(self, data, self._number)

    def wait_for_all_acked(self, timeout: Any = None) -> bool:
        self._node.graph.clock.sleep(1e-3)
        return True

    def get_subscription_count(self) -> int:
        return self._node.count_subscribers(self.topic_name)


def _takes_one(callback: Any) -> bool:
    """Whether it is called with a message alone; rclpy tries that first, too."""
    try:
        inspect.signature(callback).bind(object())
    except TypeError:
        return False
    except ValueError:  # built in, such as a list's append
        pass
    return True


@functools.lru_cache(maxsize=8)
def _read(data: bytes, kind: type) -> Any:
    """A message, made once for all who hear it within moments; no node changes what it hears."""
    return deserialize_message(data, kind)


class Subscription:
    def __init__(
        self,
        node: SimulatedNode,
        kind: type,
        topic: str,
        callback: Any,
        qos: Any,
        raw: bool,
        polled: bool,
    ) -> None:
        self._node, self.msg_type, self.topic_name, self.topic = node, kind, topic, topic
        self.callback, self.raw, self.polled = callback, raw, polled
        self.depth = qos.depth if isinstance(qos, QoSProfile) else int(qos)
        self.latched = (
            isinstance(qos, QoSProfile) and qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
        )
        self.queue: deque[tuple[float, bytes, int]] = deque()
        self.handle = self
        self._wants_info = not _takes_one(callback)
        self._last_s: dict[int, float] = {}
        if self.latched:
            for publisher in node.graph.all("publishers"):
                if (
                    publisher.topic_name == topic
                    and publisher.latched
                    and publisher.last is not None
                ):
                    self.deliver(publisher, publisher.last, publisher._number)

    def __enter__(self) -> Subscription:
        return self

    def __exit__(self, *_: Any) -> None:
        pass

    def deliver(
        self,
        publisher: Publisher,
        data: bytes,
        number: int,
    ) -> None:
        for at_s in self._node.graph.arrival(self._last_s.get(id(publisher), -math.inf)):
            self._last_s[id(publisher)] = max(
                at_s,
                self._last_s.get(id(publisher), -math.inf),
            )
            place = len(self.queue)
            while place and self.queue[place - 1][0] > at_s:
                place -= 1
            now_s = self._node.graph.clock._now_s
            sent_ns = SYSTEM_AHEAD_NS + int(1e9 * (now_s + self._node.graph.set_by_s))
            self.queue.insert(place, (at_s, data, number, sent_ns))
            while len(self.queue) > self.depth < sum(each[0] <= now_s for each in self.queue):
                self.queue.popleft()
            if not self.polled:
                self._node.due(at_s)

    def take_message(
        self,
        kind: type,
        raw: bool,
    ) -> tuple[Any, dict[str, Any]] | None:
        if not self.queue or self.queue[0][0] > self._node.graph.clock._now_s:
            return None
        now_s = self._node.graph.clock._now_s
        while len(self.queue) > self.depth and self.queue[self.depth][0] <= now_s:
            self.queue.popleft()  # more came than are kept
        at_s, data, number, sent_ns = self.queue.popleft()
        stamp_ns = SYSTEM_AHEAD_NS + int(1e9 * (at_s + self._node.graph.set_by_s))
        info = {
            "source_timestamp": sent_ns, "received_timestamp": stamp_ns, "publication_sequence_number": number,
            "reception_sequence_number": None,
        }  # fmt: skip
        return (data if raw else _read(data, kind)), info

    def ready(self) -> bool:
        return (
            not self.polled
            and bool(self.queue)
            and self.queue[0][0] <= self._node.graph.clock._now_s
        )

    def serve(self) -> bool:
        told = None if self.polled else self.take_message(self.msg_type, self.raw)
        if told is None:
            return False
        message, info = told
        self.callback(message, info) if self._wants_info else self.callback(message)
        return True


class Service:
    def __init__(
        self,
        node: SimulatedNode,
        kind: Any,
        name: str,
        callback: Any,
    ) -> None:
        self._node, self.srv_type, self.srv_name, self.service_name, self.callback = (
            node,
            kind,
            name,
            name,
            callback,
        )
        self.queue: deque[tuple[float, Any, Any]] = deque()

    def send_response(self, response: Any, header: Any) -> None:
        header.answer(response)

    def ready(self) -> bool:
        return bool(self.queue) and self.queue[0][0] <= self._node.graph.clock._now_s

    def serve(self) -> bool:
        if not self.ready():
            return False
        _, request, header = self.queue.popleft()
        response = self.callback(request, self.srv_type.Response())
        self.send_response(response, header)
        return True


class Future:
    def __init__(self) -> None:
        self._result: Any = None
        self._done = False
        self._callbacks: list[Callable[[Any], None]] = []

    def done(self) -> bool:
        return self._done

    def result(self) -> Any:
        return self._result

    def cancelled(self) -> bool:
        return False

    def exception(self) -> None:
        return None

    def cancel(self) -> None:
        self._callbacks.clear()

    def add_done_callback(
        self,
        callback: Callable[[Any], None],
    ) -> None:
        self._callbacks.append(callback)

    def set_result(self, result: Any) -> None:
        self._result, self._done = result, True
        for callback in self._callbacks:
            callback(self)


class Client:
    def __init__(
        self,
        node: SimulatedNode,
        kind: Any,
        name: str,
    ) -> None:
        self._node, self.srv_type, self.srv_name = node, kind, name
        self._pending: list[Future] = []

    def _service(self) -> Service | None:
        return next(
            (each for each in self._node.graph.all("services") if each.srv_name == self.srv_name),
            None,
        )

    def service_is_ready(self) -> bool:
        return self._service() is not None

    def wait_for_service(self, timeout_sec: float | None = None) -> bool:
        clock = self._node.graph.clock
        end_s = clock._now_s + (timeout_sec if timeout_sec is not None else math.inf)
        while not self.service_is_ready() and clock._now_s < end_s:
            clock.sleep(0.05)
        return self.service_is_ready()

    def call_async(self, request: Any) -> Future:
        future, service, node = Future(), self._service(), self._node
        self._pending.append(future)
        if service is None:
            return future

        def answer(response: Any) -> None:
            at_s = node.graph.call_arrival()
            node._ros_answers.append((at_s, future, response, self))
            node.due(at_s)

        at_s = node.graph.call_arrival()
        service.queue.append((at_s, request, SimpleNamespace(answer=answer)))
        service._node.due(at_s)
        return future

    def remove_pending_request(self, future: Future) -> None:
        if future in self._pending:
            self._pending.remove(future)


class Timer:
    def __init__(
        self,
        node: SimulatedNode,
        period_s: float,
        callback: Any,
    ) -> None:
        self._node, self.period_s, self.callback = node, period_s, callback
        self.next_s = node.graph.clock._now_s + period_s
        self.cancelled = False
        node.due(self.next_s)

    def cancel(self) -> None:
        self.cancelled = True

    def is_canceled(self) -> bool:
        return self.cancelled

    def reset(self) -> None:
        self.cancelled = False
        self.next_s = self._node.graph.clock._now_s + self.period_s
        self._node.due(self.next_s)

    def ready(self) -> bool:
        return not self.cancelled and self.next_s <= self._node.graph.clock._now_s

    def serve(self) -> bool:
        now_s = self._node.graph.clock._now_s
        if self.cancelled or self.next_s > now_s:
            return False
        self.next_s += self.period_s * max(
            1, math.ceil((now_s - self.next_s) / self.period_s + 1e-9)
        )
        self._node.due(self.next_s)
        self.callback()
        return True


class _Time:
    def __init__(self, nanoseconds: int) -> None:
        self.nanoseconds = nanoseconds

    def to_msg(self) -> Any:
        from builtin_interfaces.msg import Time

        return Time(
            sec=self.nanoseconds // 10**9,
            nanosec=self.nanoseconds % 10**9,
        )


class _NodeClock:
    """The system's time; or, where a node wants it, what was heard last on /clock."""

    def __init__(
        self,
        graph: Graph,
        heard: list[Any] | None,
    ) -> None:
        self._graph, self._heard = graph, heard

    @property
    def ros_time_is_active(self) -> bool:
        return self._heard is not None

    def now(self) -> _Time:
        if self._heard is None:
            return _Time(
                SYSTEM_AHEAD_NS + int(1e9 * (self._graph.clock.now() + self._graph.set_by_s))
            )
        stamp = self._heard[-1].clock if self._heard else None
        return _Time(0 if stamp is None else 10**9 * stamp.sec + stamp.nanosec)


class _Logger:
    def __init__(self, node: SimulatedNode) -> None:
        self._node = node

    def _say(self, severity: str, text: str) -> None:
        graph = self._node.graph
        graph.log.append((graph.clock._now_s, self._node.get_name(), severity, text))

    def info(self, text: str, **_: Any) -> None:
        self._say("info", text)

    def warning(self, text: str, **_: Any) -> None:
        self._say("warning", text)

    def error(self, text: str, **_: Any) -> None:
        self._say("error", text)

    debug = info
    warn = warning
    fatal = error


class SimulatedNode:
    """What a lifecycle node of rclpy offers, as far as the nodes use it; also in place of `rclpy.node.Node`."""

    _STATES = {  # noqa: RUF012
        "configure": ("unconfigured", "inactive"), "activate": ("inactive", "active"),
        "deactivate": ("active", "inactive"), "cleanup": ("inactive", "unconfigured"),
    }  # fmt: skip

    def __init__(
        self, name: str, *, namespace: str = "", parameter_overrides: Any = (), **_: Any
    ) -> None:
        self.graph = GRAPH[-1]
        self._ros_name, self._ros_namespace = name, "/" + namespace.strip("/") if namespace else "/"
        self._ros_overrides = {each.name: each.value for each in parameter_overrides or ()}
        self._ros_parameters: dict[str, tuple[Any, Any]] = {}
        self._ros_on_set: list[Any] = []
        self._ros_publishers: list[Publisher] = []
        self._ros_subscriptions: list[Subscription] = []
        self._ros_services: list[Service] = []
        self._ros_clients: list[Client] = []
        self._ros_timers: list[Timer] = []
        self._ros_answers: deque[tuple[float, Future, Any, Client]] = deque()
        self._ros_wake = self.graph.clock.event()
        self._ros_due_s = math.inf
        self._ros_dues: list[float] = []
        self._ros_ready: deque[Any] = deque()
        self._ros_state = "unconfigured"
        self.executor: Any = None
        self.group = self.graph.clock.actor.group
        self.graph.nodes.append(self)
        self._ros_heard: list[Any] | None = None
        if self._ros_overrides.get("use_sim_time"):
            self._ros_heard = []
            self.create_subscription(Clock, "/clock", self._ros_heard.append, 1)
        self.create_service(SetParameters, "~/set_parameters", self._set_from_far)
        self.create_service(GetParameters, "~/get_parameters", self._get_from_far)

    # --- names

    def get_name(self) -> str:
        return self._ros_name

    def get_namespace(self) -> str:
        return self._ros_namespace

    def get_fully_qualified_name(self) -> str:
        return f"{self._ros_namespace.rstrip('/')}/{self._ros_name}"

    def resolve_topic_name(self, topic: str) -> str:
        if topic.startswith("~/"):
            return f"{self.get_fully_qualified_name()}/{topic[2:]}"
        return topic if topic.startswith("/") else f"{self._ros_namespace.rstrip('/')}/{topic}"

    # --- parameters

    def declare_parameter(
        self,
        name: str,
        default: Any,
        descriptor: Any = None,
    ) -> Any:
        value = self._ros_overrides.get(name, default)
        if isinstance(default, float) and isinstance(value, int):
            value = float(value)
        self._ros_parameters[name] = (value, descriptor)
        return self.get_parameter(name)

    def get_parameter(self, name: str) -> Any:
        return SimpleNamespace(
            name=name,
            value=self._ros_parameters[name][0],
        )

    def add_on_set_parameters_callback(self, callback: Any) -> None:
        self._ros_on_set.append(callback)

    def remove_on_set_parameters_callback(self, callback: Any) -> None:
        if callback in self._ros_on_set:
            self._ros_on_set.remove(callback)

    def set_parameters(self, parameters: list[Parameter]) -> list[Any]:
        results = []
        for parameter in parameters:
            result = SetParametersResult(successful=True)
            known = self._ros_parameters.get(parameter.name)
            if known is None:
                result = SetParametersResult(successful=False, reason="not declared")
            elif known[1] is not None and known[1].read_only:
                result = SetParametersResult(successful=False, reason="read-only")
            for callback in self._ros_on_set if result.successful else ():
                result = callback([parameter])
                if not result.successful:
                    break
            if result.successful:
                self._ros_parameters[parameter.name] = (
                    parameter.value,
                    known[1] if known else None,
                )
            results.append(result)
        return results

    def _set_from_far(self, request: Any, response: Any) -> Any:
        response.results = self.set_parameters(
            [Parameter.from_parameter_msg(each) for each in request.parameters]
        )
        return response

    def _get_from_far(self, request: Any, response: Any) -> Any:
        for name in request.names:
            response.values.append(
                Parameter(name, value=self._ros_parameters[name][0]).get_parameter_value()
            )
        return response

    # --- what it has

    def create_publisher(self, kind: type, topic: str, qos: Any, **_: Any) -> Publisher:
        publisher = Publisher(self, kind, self.resolve_topic_name(topic), qos)
        self._ros_publishers.append(publisher)
        return publisher

    create_lifecycle_publisher = create_publisher

    def create_subscription(
        self,
        kind: type,
        topic: str,
        callback: Any,
        qos: Any,
        *,
        raw: bool = False,
        callback_group: Any = None,
        **_: Any,
    ) -> Subscription:
        polled = callback_group is not None
        subscription = Subscription(
            self, kind, self.resolve_topic_name(topic), callback, qos, raw, polled
        )
        self._ros_subscriptions.append(subscription)
        self.graph.by_topic.clear()
        return subscription

    def create_service(self, kind: Any, name: str, callback: Any, **_: Any) -> Service:
        service = Service(self, kind, self.resolve_topic_name(name), callback)
        self._ros_services.append(service)
        return service

    def create_client(self, kind: Any, name: str, **_: Any) -> Client:
        client = Client(self, kind, self.resolve_topic_name(name))
        self._ros_clients.append(client)
        return client

    def create_timer(self, period_s: float, callback: Any, clock: Any = None, **_: Any) -> Timer:
        timer = Timer(self, period_s, callback)
        self._ros_timers.append(timer)
        return timer

    publishers = property(lambda self: iter(list(self._ros_publishers)))
    subscriptions = property(lambda self: iter(list(self._ros_subscriptions)))
    services = property(lambda self: iter(list(self._ros_services)))
    clients = property(lambda self: iter(list(self._ros_clients)))
    timers = property(lambda self: iter(list(self._ros_timers)))

    def destroy_publisher(self, each: Publisher) -> None:
        with contextlib.suppress(ValueError):
            self._ros_publishers.remove(each)

    def destroy_subscription(self, each: Subscription) -> None:
        with contextlib.suppress(ValueError):
            self._ros_subscriptions.remove(each)
        self.graph.by_topic.clear()

    def destroy_service(self, each: Service) -> None:
        with contextlib.suppress(ValueError):
            self._ros_services.remove(each)

    def destroy_client(self, each: Client) -> None:
        with contextlib.suppress(ValueError):
            self._ros_clients.remove(each)

    def destroy_timer(self, each: Timer) -> None:
        with contextlib.suppress(ValueError):
            self._ros_timers.remove(each)

    def destroy_node(self) -> None:
        with contextlib.suppress(ValueError):
            self.graph.nodes.remove(self)
        self.graph.by_topic.clear()

    def count_publishers(self, topic: str) -> int:
        return sum(
            each.topic_name == self.resolve_topic_name(topic)
            for each in self.graph.all("publishers")
        )

    def count_subscribers(self, topic: str) -> int:
        return sum(
            each.topic_name == self.resolve_topic_name(topic)
            for each in self.graph.all("subscriptions")
        )

    def _infos(
        self,
        kind: str,
        topic: str,
    ) -> list[Any]:
        return [
            SimpleNamespace(node_name=node._ros_name, node_namespace=node._ros_namespace)
            for node in self.graph.nodes
            for each in getattr(node, f"_ros_{kind}")
            if each.topic_name == self.resolve_topic_name(topic)
        ]

    def get_publishers_info_by_topic(self, topic: str) -> list[Any]:
        return self._infos("publishers", topic)

    def get_subscriptions_info_by_topic(self, topic: str) -> list[Any]:
        return self._infos("subscriptions", topic)

    def get_node_names_and_namespaces(self) -> list[tuple[str, str]]:
        return [(node._ros_name, node._ros_namespace) for node in self.graph.nodes]

    def get_topic_names_and_types(self) -> list[tuple[str, list[str]]]:
        found: dict[str, set[str]] = {}
        for each in itertools.chain(self.graph.all("publishers"), self.graph.all("subscriptions")):
            module = each.msg_type.__module__.split(".")
            found.setdefault(each.topic_name, set()).add(
                f"{module[0]}/{module[1]}/{each.msg_type.__name__}"
            )
        return [(topic, sorted(kinds)) for topic, kinds in found.items()]

    def get_clock(self) -> _NodeClock:
        return _NodeClock(self.graph, self._ros_heard)

    def get_logger(self) -> _Logger:
        return _Logger(self)

    # --- the lifecycle

    def _trigger(self, what: str) -> TransitionCallbackReturn:
        before, after = self._STATES[what]
        if self._ros_state != before:
            return TransitionCallbackReturn.FAILURE
        result = getattr(self, f"on_{what}")(SimpleNamespace(label=before))
        if result == TransitionCallbackReturn.SUCCESS:
            self._ros_state = after
        return result

    def trigger_configure(self) -> TransitionCallbackReturn:
        return self._trigger("configure")

    def trigger_activate(self) -> TransitionCallbackReturn:
        return self._trigger("activate")

    def trigger_deactivate(self) -> TransitionCallbackReturn:
        return self._trigger("deactivate")

    def trigger_cleanup(self) -> TransitionCallbackReturn:
        return self._trigger("cleanup")

    def on_activate(self, _state: Any) -> TransitionCallbackReturn:
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, _state: Any) -> TransitionCallbackReturn:
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, _state: Any) -> TransitionCallbackReturn:
        return TransitionCallbackReturn.SUCCESS

    # --- its executor

    def due(self, at_s: float) -> None:
        """Something comes at an instant."""
        heapq.heappush(self._ros_dues, at_s)
        if at_s < self._ros_due_s:
            self._ros_wake.set()

    def _serve_answer(self) -> bool:
        now_s = self.graph.clock._now_s
        for entry in self._ros_answers:
            if entry[0] <= now_s:
                self._ros_answers.remove(entry)
                _, future, response, client = entry
                if future in client._pending:
                    client._pending.remove(future)
                    future.set_result(response)
                return True
        return False

    def spin_once(self, timeout_s: float) -> None:
        """One callback that is due, or a wait."""
        clock = self.graph.clock
        dues = self._ros_dues
        end_s = clock._now_s + timeout_s
        while True:
            # all that was found ready has its turn before anything is looked at again
            while self._ros_ready:
                if self._ros_ready.popleft().serve():
                    return
            now_s = clock._now_s
            if dues and dues[0] <= now_s:
                self._ros_ready.extend(
                    [each for each in self._ros_timers if each.next_s <= now_s and each.ready()]
                )
                queues = (*self._ros_subscriptions, *self._ros_services)
                self._ros_ready.extend([each for each in queues if each.queue and each.ready()])
                if self._serve_answer():
                    return
                if self._ros_ready:
                    continue
                while dues and dues[0] <= now_s:  # all of them have been served
                    heapq.heappop(dues)
            if now_s >= end_s:
                return
            self._ros_wake.clear()
            self._ros_due_s = min(
                dues[0] if dues else math.inf,
                end_s,
            )
            self._ros_wake.wait(max(self._ros_due_s - now_s, 0.0))


class SimulatedExecutor:
    """In place of `rclpy.executors.SingleThreadedExecutor`, of one node."""

    def __init__(self, **_: Any) -> None:
        self._nodes: list[SimulatedNode] = []

    def add_node(self, node: SimulatedNode) -> None:
        node.executor = self
        self._nodes.append(node)

    def spin_once(self, timeout_sec: float | None = None) -> None:
        self._nodes[0].spin_once(math.inf if timeout_sec is None else timeout_sec)

    def shutdown(self, timeout_sec: float | None = None) -> bool:
        return True


@contextlib.contextmanager
def installed() -> Iterator[None]:
    """Everything that is imported in the block takes the stand-ins."""
    import rclpy.executors
    import rclpy.lifecycle
    import rclpy.node

    places = (
        (rclpy.lifecycle, "LifecycleNode", SimulatedNode),
        (rclpy.node, "Node", SimulatedNode),
        (rclpy.executors, "SingleThreadedExecutor", SimulatedExecutor),
    )
    before = [getattr(module, name) for module, name, _ in places]
    for module, name, stand_in in places:
        setattr(module, name, stand_in)
    try:
        yield
    finally:
        for (module, name, _), real in zip(places, before, strict=True):
            setattr(module, name, real)
