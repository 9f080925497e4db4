"""How every node lives: lifecycle, signals, one line for every error, and an orderly end."""

from __future__ import annotations

import contextlib
import gc
import logging
import os
import signal
import sys
import threading
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import rclpy
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException, ShutdownException, SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import Trigger

from proprio_ros import clock
from proprio_ros.clock import run_in_real_time
from proprio_ros.errors import ProprioError
from proprio_ros.inputs.resources import share_directory
from proprio_ros.nodes.parameters import AUTOSTART, Parameter, declare

LATCHED = QoSProfile(
    depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL, reliability=ReliabilityPolicy.RELIABLE
)
"""The last message reaches those who come later, too."""
STREAM = QoSProfile(depth=5000, reliability=ReliabilityPolicy.RELIABLE)
"""Joint states that are being recorded: none may be lost while a thread is busy."""
# only the newest command counts
COMMANDS = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
CALLS = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
"""Of services: the default keeps ten requests, and whoever calls beside ten others is never answered."""
NOT_GRANTED = (
    "no real-time priority: beside other work messages come late (allow rtprio in limits.conf)"
)
CALLED_S, CALLED_PAUSE_S = 0.1, 0.005
"""For so long after a call a node at rest pauses less: where many call at once, each would wait for its pauses. Without any, a
caller that keeps ten answers, as rclpy's do, would lose some."""
FROM_MANY = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
"""Commands, of whoever sends some: those of one publisher must not push out another's before they are seen."""
IDLE_PAUSE_S = 0.02
"""Between two callbacks of a node that has nothing to do. Every wake-up costs 0.3 ms, whatever it is for: without this a driver at
250 Hz had its idle listeners take a quarter of a core each. A service call still waits for three or four of them only.
With 8 ms they took 7 and 8 % of a core, with 20 ms 4."""
LONGEST_TURN_S = 0.02
"""For so long messages are handed on at one wake-up: where they come faster than they are taken, timers must have their turn."""
LONG_TURN_S, TAKEN_S = 0.3, 1.0
"""A turn, a callback or none in 0.1 s, takes longer where this program stood still, or a callback waited; so long after it all that
came meanwhile has been taken."""
NAMESAKE_S = 25.0
"""After so long a node looks for another of its name: one that was killed is listed until its lease of 20 s ends."""
HEARD_OF_S, LOOK_S = 1.5, 0.02
"""For so long, and so often, a service is looked for before it is said not to be there: who asks waits for five seconds."""


def waiting(
    subscription: Any, data: Any, info: Mapping[str, Any]
) -> Iterator[tuple[Any, Mapping[str, Any]]]:
    """All that came on a subscription, beside what its callback was given, without a wake-up for each message.

    Returns: Each message with what the middleware knows of it.
    """
    yield data, info
    with subscription.handle:
        while (
            more := subscription.handle.take_message(subscription.msg_type, subscription.raw)
        ) is not None:
            yield more


class ManagedNode(LifecycleNode):
    """A lifecycle node whose transitions fail with one line instead of a traceback.

    Subclasses give `parameters` and override `configure`, `activate`, `deactivate` and `cleanup`, which may raise `ProprioError`.
    """

    parameters: Sequence[Parameter] = ()
    real_time = False
    """Runs before everything else once it is active; until then it starts like any other program, beside others that do."""
    hearing: Collection[int] = ()
    """Threads that take part in the middleware, where the node has a process to itself."""

    def __init__(self, name: str, **kwargs: Any) -> None:
        self.called_s = 0.0  # when a service was called last
        self.more_waits = False  # whether the last turn left messages behind
        self.begun_s = self._turned_s = clock.now()
        self._deaf_s = self._turned_s, self._turned_s  # from when to when no message was taken
        super().__init__(name, **kwargs)
        self.values = declare(self, [AUTOSTART, *self.parameters])
        self.active, self._alone = False, True
        for service in self.services:
            if service.srv_name.endswith("/change_state"):
                service.callback = partial(self._change_state, service.callback)
        self.every(NAMESAKE_S, self._look_for_namesake)
        self._own = [
            *self.publishers,
            *self.subscriptions,
            *self.services,
            *self.clients,
            *self.timers,
        ]

    def hear_in_real_time(self) -> None:
        """From now on what others say does not wait for other programs, nor for what this one computes in threads made later."""
        if self.hearing and not run_in_real_time(self.hearing):
            self.say("info", NOT_GRANTED)

    def configure(self) -> None:
        """Read files, make publishers."""

    def activate(self) -> None:
        """Begin."""

    def deactivate(self) -> None:
        """Leave everything safe."""

    def cleanup(self) -> None:
        """Undo `configure`."""

    @property
    def pause_s(self) -> float:
        """Between two callbacks [s]: a flood of messages leaves room for the node's other threads, and for other programs."""
        return 0.0

    def waited_s(self) -> float:
        """For how long a message that is taken now may have waited; asked at every turn, it sees those that take long [s]."""
        now_s, (begun_s, ended_s) = clock.now(), self._deaf_s
        if now_s - self._turned_s > LONG_TURN_S:
            self._deaf_s = begun_s if self._turned_s - ended_s < TAKEN_S else self._turned_s, now_s
        self._turned_s = now_s
        return now_s - self._deaf_s[0] if now_s - self._deaf_s[1] < TAKEN_S else 0.0

    @property
    def turned_s(self) -> float:
        """When it last began to look for messages."""
        return self._turned_s

    def now_s(self) -> float:
        """Time that never runs back; with `use_sim_time` the simulation's, whose pauses and pace count [s]."""
        ros = self.get_clock()
        return 1e-9 * ros.now().nanoseconds if ros.ros_time_is_active else clock.now()

    def say(self, severity: str, message: str) -> None:
        """Log; severity is ``info``, ``warning`` or ``error``. rclpy wants one place in the code for each severity."""
        if severity == "error":
            self.get_logger().error(message)
        elif severity == "warning":
            self.get_logger().warning(message)
        else:
            self.get_logger().info(message)

    def every(self, period_s: float, do: Callable[[], None]) -> None:
        """Call again and again, on a clock that nobody sets: a timer on the system's pauses for as long as that is set back."""
        self.create_timer(period_s, do, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _look_for_namesake(self) -> None:
        """Services of two nodes of one name are answered by either; said once."""
        mine = self.get_name(), self.get_namespace()
        if self._alone and self.get_node_names_and_namespaces().count(mine) > 1:
            self._alone = False
            advice = "end one of them, or start it with --ros-args -r __node:=NAME, or -r __ns:=/NAME for another arm"
            self.say(
                "warning",
                f"another node is called {self.get_fully_qualified_name()}: calls reach either of them; {advice}",
            )

    def create_service(
        self, kind: Any, name: str, callback: Any, *, qos_profile: QoSProfile = CALLS, **more: Any
    ) -> Any:
        """As rclpy's, for more callers at once."""

        def serve(request: Any, response: Any) -> Any:
            self.called_s = clock.now()
            return callback(request, response)

        return super().create_service(kind, name, serve, qos_profile=qos_profile, **more)

    def listen(
        self,
        kind: type,
        topic: str,
        callback: Callable[..., None],
        quality: QoSProfile,
        *,
        raw: bool = False,
        dated: bool = False,
        only_newest: Callable[[], bool] = lambda: False,
        together: Callable[[], bool] = lambda: False,
    ) -> None:
        """Subscribe, also to best-effort publishers, which a reliable subscription does not hear.

        A reliable publisher repeats what was lost, so it is asked to until one is found that does not. At present, may all that
        waits but the newest be left out (``only_newest``)? Is all that waits handed on at one wake-up (``together``), so that a
        node that pauses between them keeps up? With ``dated`` the callback is also given when a message was sent and when
        it came, as the middleware says it.
        """

        def hear(message: Any, info: Mapping[str, Any]) -> None:
            if only_newest():
                *_, last = waiting(subscriptions[-1], message, info)
                take(*last)
            elif together():
                end_s = clock.now() + LONGEST_TURN_S
                for each in waiting(subscriptions[-1], message, info):
                    take(*each)
                    if clock.now() > end_s:
                        self.more_waits = True
                        break
            else:
                take(message, info)

        def take(message: Any, info: Mapping[str, Any]) -> None:
            if dated:
                callback(message, info)
            else:
                callback(message)

        def relax(_event: Any) -> None:
            if len(subscriptions) > 1:
                return  # every further publisher of the kind says so again
            # muted, not destroyed: the executor may have it in hand just now
            subscriptions[0].callback = lambda *_: None
            self.say(
                "warning",
                f"{subscriptions[0].topic_name} is published best effort: messages may be lost",
            )
            relaxed = QoSProfile(depth=quality.depth, reliability=ReliabilityPolicy.BEST_EFFORT)
            subscriptions.append(self.create_subscription(kind, topic, hear, relaxed, raw=raw))

        events = SubscriptionEventCallbacks(incompatible_qos=relax)
        subscriptions = [
            self.create_subscription(kind, topic, hear, quality, event_callbacks=events, raw=raw)
        ]

    def call(
        self,
        client: Any,
        request: Any,
        patience_s: float,
        then: Callable[[Any, str], None],
        name: str = "",
    ) -> None:
        """Call a service without waiting for it; ``name`` is its own in words, where the client's is not meant.

        ``then`` is called later, once, with the response and an empty string, or with None and what went wrong.
        """
        future = client.call_async(request)
        named = name or client.srv_name

        def end(response: Any, why: str) -> None:
            if not timer.is_canceled():
                timer.cancel()
                self.destroy_timer(timer)
                then(response, why)

        def responded(_: Any) -> None:
            error = future.exception()
            end(None if error else future.result(), f"{named} failed: {error}" if error else "")

        def too_late() -> None:
            client.remove_pending_request(future)
            end(None, f"{named} does not answer within {patience_s:g} s")

        timer = self.create_timer(
            patience_s, too_late, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )
        future.add_done_callback(responded)

    def when_there(
        self,
        client: Any,
        then: Callable[[bool], None],
    ) -> None:
        """Call ``then`` with whether a service is there: at once where it is; on a busy computer it is heard of late."""
        if client.service_is_ready():
            return then(True)
        end_s = clock.now() + HEARD_OF_S

        def look() -> None:
            there = client.service_is_ready()
            if (there or clock.now() > end_s) and not timer.is_canceled():
                timer.cancel()
                self.destroy_timer(timer)
                then(there)

        timer = self.create_timer(LOOK_S, look, clock=Clock(clock_type=ClockType.STEADY_TIME))
        return None

    def _change_state(
        self,
        change: Callable[[Any, Any], Any],
        request: Any,
        response: Any,
    ) -> Any:
        """Refuse a transition that is not due: rclpy 7.1 raises then, which would end the node that holds the arm."""
        try:
            return change(request, response)
        except Exception as error:
            asked = request.transition.label or request.transition.id
            self.say(
                "warning",
                f"lifecycle transition {asked} is refused: {' '.join(str(error).split())}",
            )
            response.success = False
            return response

    def _transition(self, what: str, action: Callable[[], None]) -> TransitionCallbackReturn:
        try:
            action()
        except ProprioError as error:
            self.say("error", f"cannot {what}: {error}")
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS

    def _configure(self) -> None:
        for parameter in self.parameters:
            parameter.check(self.values[parameter.name])
        self.configure()

    def _destroy_configured(self) -> None:
        """What `configure` made; a node that is configured again would otherwise publish and answer twice."""
        for entities, destroy in (
            (self.publishers, self.destroy_publisher),
            (self.subscriptions, self.destroy_subscription),
            (self.services, self.destroy_service),
            (self.clients, self.destroy_client),
            (self.timers, self.destroy_timer),
        ):
            for entity in [*entities]:
                if entity not in self._own:
                    destroy(entity)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        result = self._transition("configure", self._configure)
        if result != TransitionCallbackReturn.SUCCESS:
            self._destroy_configured()
        return result

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        if self.real_time:
            # a full collection takes longer than a servo's answer: what is here now stays for good
            gc.collect()
            gc.freeze()
            # all threads, not the bus's alone: it would wait for whichever holds the interpreter's lock and is not run
            if not run_in_real_time():
                self.say("info", NOT_GRANTED)
        result = self._transition("activate", self.activate)
        self.active = result == TransitionCallbackReturn.SUCCESS
        return result if not self.active else super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.active = False
        result = self._transition("deactivate", self.deactivate)
        return (
            result if result != TransitionCallbackReturn.SUCCESS else super().on_deactivate(state)
        )

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        result = self._transition("clean up", self.cleanup)
        self._destroy_configured()
        return result

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.finish()
        return TransitionCallbackReturn.SUCCESS

    def finish(self) -> None:
        """The end, from whatever state; also called when the process is asked to end."""
        if self.active:
            self.active = False
            self._transition("deactivate", self.deactivate)


# what answers a service call, once, from any thread: success and a sentence
Answer = Callable[[bool, str], None]


class LongService:
    """A `std_srvs/Trigger` service that is answered later, without a thread that waits: ``serve`` returns at once.

    rclpy answers when the callback returns; a coroutine that waits, or `MultiThreadedExecutor`, keeps a processor busy until
    then (rclpy 7.1: the identifier stood at 95 % of a core). So the answer is held back at the service's own `send_response`.
    """

    def __init__(
        self,
        node: ManagedNode,
        name: str,
        serve: Callable[[Answer], None],
    ) -> None:
        self._serve = serve
        self._service = node.create_service(Trigger, name, lambda request, response: response)
        self._send = self._service.send_response
        self._service.send_response = self._begin

    def _begin(self, response: Trigger.Response, header: Any) -> None:
        def answer(success: bool, message: str) -> None:
            response.success, response.message = success, message
            # the caller, or this node, may be gone by now
            with contextlib.suppress(RuntimeError):
                self._send(response, header)

        self._serve(answer)


_RANGE_SET_BY = (
    "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY", "ROS_STATIC_PEERS", "ROS_DISCOVERY_SERVER", "CYCLONEDDS_URI",
    "FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE",
)  # fmt: skip


def _stay_on_this_machine() -> None:
    """Be found by programs on this computer only, unless the user has said who else may find us.

    ROS 2 lets everybody on the network command every node, and these move an arm.
    """
    if not any(name in os.environ for name in _RANGE_SET_BY):
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"


def _leave_shared_memory() -> None:
    """Have Fast DDS send through sockets only.

    Processes on one computer talk through shared memory by default, behind locks that know no priority: one in real time stood
    still for up to 0.7 s in `publish`, with Python's own lock, because an ordinary one was not run while it held them (Fast DDS
    2.14, three busy programs on two cores). Those that keep shared memory still hear us. What the user has set counts.
    """
    if (
        "FASTRTPS_DEFAULT_PROFILES_FILE" in os.environ
        or "FASTDDS_DEFAULT_PROFILES_FILE" in os.environ
    ):
        return
    localhost = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE") == "LOCALHOST"
    if localhost and "ROS_STATIC_PEERS" in os.environ:
        return  # the peers count with this range only
    # here rmw_fastrtps insists on shared memory
    if localhost or os.environ.get("ROS_LOCALHOST_ONLY") == "1":
        os.environ["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(
            share_directory() / "config/dds/localhost_udp.xml"
        )
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "SYSTEM_DEFAULT"
        os.environ.pop("ROS_LOCALHOST_ONLY", None)
    else:
        os.environ.setdefault("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")


def run_node(
    make: Callable[[], ManagedNode],
    arguments: Sequence[str] | None = None,
) -> int:
    """Run one node until it is asked to end (SIGINT, SIGTERM), and end it in order; returns the exit code as `live` does.

    rclpy's own handlers shut the context down first, after which nothing can be published any more; ours let the node
    leave everything safe before.
    """
    _warn_about_mixed_installations()
    # no thread may keep the others from the interpreter for long: at the default of 5 ms a flood of commands has the bus miss
    # cycles, and 300 messages in a second do not come through beside a solver, whose many short calls hand the lock over
    sys.setswitchinterval(0.0005)
    ended = clock.event()
    _stay_on_this_machine()
    middleware = os.environ.get("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp")
    if middleware == "rmw_fastrtps_cpp":
        _leave_shared_memory()
    rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())
    try:
        return live(make, ended)
    finally:
        rclpy.try_shutdown()


def live(make: Callable[[], ManagedNode], ended: clock.Event) -> int:
    """A node's life: made, configured, activated, spun, and ended in order; returns 0, or 2 when it could not be configured."""
    node: ManagedNode | None = None
    spinner = SingleThreadedExecutor()
    code = 0
    done = TransitionCallbackReturn.SUCCESS
    try:
        before = clock.threads()
        node = make()
        node.hearing = clock.threads() - before | {threading.get_native_id()}
        spinner.add_node(node)
        if node.values["autostart"] and (
            node.trigger_configure() != done or node.trigger_activate() != done
        ):
            code = 2
            ended.set()
        while not ended.is_set():
            _turn(node, spinner)
            if node.pause_s > 0.0 and not node.more_waits:
                called = clock.now() - node.called_s < CALLED_S
                clock.sleep(min(node.pause_s, CALLED_PAUSE_S) if called else node.pause_s)
    except (ProprioError, ParameterException) as error:
        logging.getLogger("proprio_ros").error(
            "%s",
            " ".join(str(error).split()),
        )
        code = 2
    finally:
        if node is not None:
            node.finish()
        spinner.shutdown(timeout_sec=1.0)
        if node is not None:
            node.destroy_node()
    return code


def _turn(node: ManagedNode, spinner: SingleThreadedExecutor) -> None:
    """One callback. A defect in it costs its answer, not the node: whoever holds the arm goes on holding it."""
    node.waited_s()
    node.more_waits = False
    try:
        spinner.spin_once(timeout_sec=0.1)
    except (ExternalShutdownException, ShutdownException):
        raise
    except Exception as error:
        said = " ".join(f"{type(error).__name__}: {error}".split())
        node.get_logger().error(
            f"a defect in a callback ({said[:200]}); the node goes on", throttle_duration_sec=1.0
        )


def _warn_about_mixed_installations() -> None:
    """Wheels of ROS beside an installed ROS load each other's libraries."""
    here = getattr(rclpy, "__file__", "") or ""
    prefixes = [
        p
        for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
        if p.startswith("/opt/ros")
    ]
    if prefixes and here.startswith(sys.prefix) and not here.startswith("/opt/ros"):
        words = "rclpy comes from %s although %s is sourced: use one of the two, not both (README)"
        logging.getLogger("proprio_ros").warning(words, sys.prefix, prefixes[0])
