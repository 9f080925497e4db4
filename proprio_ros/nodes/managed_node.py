"""The node that all others are: lifecycle, messages of its log, subscriptions, timers and services."""

from __future__ import annotations

import gc
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from typing import Any

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.qos import QoSProfile

from proprio_ros import clock
from proprio_ros.clock import come_before_others, run_in_real_time
from proprio_ros.errors import ProprioError
from proprio_ros.nodes.listening import Listener, never
from proprio_ros.nodes.parameters import declare
from proprio_ros.nodes.qos import CALLS
from proprio_ros.nodes.tables import AUTOSTART, Parameter
from proprio_ros.nodes.turns import Turns

NOT_GRANTED = (
    "no priority: beside other work messages come late (allow rtprio and nice in limits.conf)"
)
IDLE_PAUSE_S = 0.02
"""Between two callbacks of a node that has nothing to do. Every wake-up costs 0.3 ms, whatever it is for: without this a driver at
250 Hz had its idle listeners take a quarter of a core each. A service call still waits for three or four of them only.
With 8 ms they took 7 and 8 % of a core, with 20 ms 4."""
NAMESAKE_S = 25.0
"""After so long a node looks for another of its name: one that was killed is listed until its lease of 20 s ends."""


class ManagedNode(LifecycleNode):
    """A lifecycle node whose transitions fail with one line instead of a traceback.

    Subclasses give `parameters` and override `configure`, `activate`, `deactivate` and `cleanup`, which may raise `ProprioError`.
    """

    parameters: Sequence[Parameter] = ()
    urgent = False
    """Whether an arm moves, or falls, by what it says: once active it comes before other programs; until then it starts like
    any other."""
    hearing: Collection[int] = ()
    """Threads that take part in the middleware, where the node has a process to itself."""

    def __init__(self, name: str, **kwargs: Any) -> None:
        self.hears_first = False  # whether it hears before it, or anybody, computes
        self.called_s = 0.0  # when a service was called last
        self.turns = Turns()
        self.begun_s = self.turns.begun_s
        super().__init__(name, **kwargs)
        self.values = declare(self, [AUTOSTART, *self.parameters])
        self.active = False
        self._alone = True
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

    @property
    def real_time(self) -> bool:
        """Whether an arm falls when this process is not run for a moment: then it takes a real-time class."""
        return False

    def hear_before_others(self) -> None:
        """From now on what others say waits neither for other programs nor for what this one computes."""
        self.hears_first = bool(self.hearing) and come_before_others(self.hearing)
        if self.hearing and not self.hears_first:
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

    def every(self, period_s: float, do: Callable[[], None]) -> Any:
        """Call again and again, on a clock that nobody sets: a timer on the system's pauses for as long as that is set back.

        Returns:
            The timer, which can be cancelled.
        """
        return self.create_timer(
            period_s,
            do,
            clock=Clock(clock_type=ClockType.STEADY_TIME),
        )

    def _look_for_namesake(self) -> None:
        """Services of two nodes of one name are answered by either; said once."""
        mine = self.get_name(), self.get_namespace()
        if self._alone and self.get_node_names_and_namespaces().count(mine) > 1:
            self._alone = False
            another = f"another node is called {self.get_fully_qualified_name()}"
            advice = "end one of them, or start it with --ros-args -r __node:=NAME, or -r __ns:=/NAME for another arm"
            self.say("warning", f"{another}: calls reach either of them; {advice}")

    def create_service(
        self, kind: Any, name: str, callback: Any, *, qos_profile: QoSProfile = CALLS, **more: Any
    ) -> Any:
        """As rclpy's, for more callers at once.

        Args:
            kind: Class of the service.
            name: Of the service.
            callback: Is called with request and response, and returns the response.
            qos_profile: Quality of service.
            more: What else rclpy takes.
        """

        def serve(request: Any, response: Any) -> Any:
            self.called_s = clock.now()
            return callback(request, response)

        return super().create_service(
            kind,
            name,
            serve,
            qos_profile=qos_profile,
            **more,
        )

    def listen(
        self,
        kind: type,
        topic: str,
        callback: Callable[..., None],
        quality: QoSProfile,
        *,
        raw: bool = False,
        dated: bool = False,
        only_newest: Callable[[], bool] = never,
        together: Callable[[], bool] = never,
    ) -> None:
        """Subscribe, also to best-effort publishers (`Listener`).

        Args:
            kind: Class of the messages.
            topic: Name of the topic.
            callback: Is called with each message.
            quality: Quality of service that is asked for.
            raw: Whether messages are handed on as bytes.
            dated: Whether the callback is also given what the middleware knows: when a message was sent, and when it came.
            only_newest: Whether, at present, all waiting messages but the newest may be left out.
            together: Whether, at present, all waiting messages are handed on at one wake-up, so that a node that pauses between
                wake-ups keeps up.
        """

        def take_message(message: Any, _info: Mapping[str, Any]) -> None:
            callback(message)

        take = callback if dated else take_message
        Listener(
            self, kind, topic, take, quality, raw=raw, only_newest=only_newest, together=together
        )

    def _change_state(self, change: Callable[[Any, Any], Any], request: Any, response: Any) -> Any:
        """Refuse a transition that is not due: rclpy 7.1 raises then, which would end the node that holds the arm."""
        try:
            return change(request, response)
        except Exception as error:
            asked = request.transition.label or request.transition.id
            why = " ".join(str(error).split())
            self.say("warning", f"lifecycle transition {asked} is refused: {why}")
            response.success = False
            return response

    def _transition(self, what: str, action: Callable[[], None]) -> TransitionCallbackReturn:
        try:
            action()
        except ProprioError as error:
            self.say("error", f"cannot {what}: {error}")
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS

    def check_values(self) -> None:
        """Look at the values of all parameters.

        Raises:
            ConfigurationError: One is none of its choices.
        """
        for parameter in self.parameters:
            parameter.check(self.values[parameter.name])

    def _configure(self) -> None:
        self.check_values()
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
        if self.urgent:
            # a full collection takes longer than a servo's answer: what is here now stays for good
            gc.collect()
            gc.freeze()
            # all threads, not the bus's alone: it would wait for whichever holds the interpreter's lock and is not run
            if not (run_in_real_time() if self.real_time else come_before_others(clock.threads())):
                self.say("info", NOT_GRANTED)
        result = self._transition("activate", self.activate)
        self.active = result == TransitionCallbackReturn.SUCCESS
        return super().on_activate(state) if self.active else result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.active = False
        result = self._transition("deactivate", self.deactivate)
        if result != TransitionCallbackReturn.SUCCESS:
            return result
        return super().on_deactivate(state)

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
