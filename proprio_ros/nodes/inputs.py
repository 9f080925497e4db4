"""What comes in at the identifier: when it last did, on whose clock, and to whom it goes."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import BatteryState, JointState
from std_msgs.msg import Bool, Float64MultiArray

from proprio_ros import clock
from proprio_ros.calibration_files.pushes import Moment
from proprio_ros.errors import ConfigurationError
from proprio_ros.live.news import Arrival, Backlog, Lag
from proprio_ros.live.session import LiveEstimate, Session, as_parameters
from proprio_ros.nodes import messages
from proprio_ros.nodes.managed_node import ManagedNode
from proprio_ros.nodes.qos import LATCHED, STREAM
from proprio_ros.pipeline.request import usable_driver
from proprio_ros.recordings.messages import RawMessage
from proprio_ros.recordings.topics import (
    APPLIED_EFFORT,
    BATTERY_STATE,
    CURRENT_COMMAND,
    JOINT_COMMAND,
    JOINT_STATE,
    OUR_DRIVER,
    TEMPERATURES,
)
from proprio_ros.robot import DriveTrain

STALE_S = 0.5
SILENT_S = 3.0  # whoever says something ten times a second and has not for so long is gone
TAIL_S = 0.3  # joint states after the last run that belong to the recording
BEHIND_S = 0.2
NO_INFO: Mapping[str, Any] = {}
# roles of what says what an arm at work holds
WORKING = ("joint_states", "joint_command", "battery_state")
LATEST_S = 30.0
"""On a busy computer joint states may lie in the queue for so long, while a word of the excitation node comes past them."""


class Inputs:
    """Subscriptions, as bytes: that is what goes into a bag. While ``busy`` says that a job is under way, every message counts.

    Attributes:
        joints: The robot's joints as its driver calls them, serialized.
        session: Takes all messages of a recording that is under way.
        heard: Takes those that are looked at before one.
        kept: Messages of `WORKING` of the last seconds; None where nobody wants them.
        arrived: Those that the running estimate has not seen; None while there is none.
        live: The estimate that goes along with a recording.
        driven: Whether a joint is driven just now; known while there is `live`.
        by_goals: Topic of the goals of servos that know no current; empty where there are none.
        swings: Whether a joint was let go of during the recording.
        conventions: Of the driver that publishes.

    Raises `ConfigurationError`: There is no such driver, or its efforts are of no use.
    """

    def __init__(self, node: ManagedNode, busy: Callable[[], bool]) -> None:
        self._node = node
        self._busy = busy
        self.session: Session | None = None
        self.heard: list[RawMessage] | None = None
        self.kept: deque[RawMessage] | None = None
        self.arrived: Backlog | None = None
        self.live: LiveEstimate | None = None
        self.driven = False
        self.swings = False
        self.by_goals = ""
        self.newest_state = b""
        self.joints: list[bytes] = []
        self._motors = b""
        self._temperatures = b""
        self._state_at_s = -1e9
        self._effort_at_s = -1e9
        self._lag = Lag()  # from a joint state's stamp, of whatever clock, to here
        # from when a message was sent, by the clock of the computer that sent it, by the length of messages
        self._on_the_way: dict[int, Lag] = {}
        try:
            driver = usable_driver(node.values["driver"] or None)
        except ConfigurationError as error:
            raise ConfigurationError(as_parameters(str(error))) from error
        self.conventions = OUR_DRIVER if driver is None else driver.conventions
        usual = None if driver is None else driver.effort_unit
        self._unit: str = node.values["effort_unit"] or usual or ""
        if self.conventions.radians != 1.0:
            raise ConfigurationError(
                f"driver {self.conventions.driver}: live, positions must come in rad"
            )

    def stated_topics(self) -> dict[str, Any]:
        """What a replay must be told to take the same topics; nothing where they have their usual names."""
        values = self._node.values
        topics: dict[str, Any] = {
            "effort_unit": values["effort_unit"] or None,
            "effort_sign": values["effort_sign"] or None,
            "driver": values["driver"] or None,
        }
        for option, usual in (
            ("state_topic", self.conventions.states),
            ("command_topic", APPLIED_EFFORT),
        ):
            full = self._node.resolve_topic_name(values[option] or usual)
            topics[option] = full if values[option] or not full.endswith(f"/{usual}") else None
        return topics

    def open(self, drives: Mapping[str, DriveTrain]) -> None:
        """Subscribe; whoever publishes joint states of others than these may have another clock."""
        self.joints = [self.conventions.published(name).encode() for name in drives]
        self._listen_to_arm()
        self._listen_to_voltage_driven(drives)
        self._listen_to_driver()
        self._listen_to_inputs_of_others()
        self._command_topic = self.stated_topics()["command_topic"]
        if self._command_topic:
            self._node.every(0.5, self._listen_to_command)

    def _listen_to_arm(self) -> None:
        """What our own driver says of states and commands, or somebody else's in its place."""
        states = self._node.values["state_topic"] or self.conventions.states
        for role, topic, kind in (
            ("joint_states", states, JointState),
            ("applied_effort", APPLIED_EFFORT, JointState),
            ("applied_current", "applied_current", Float64MultiArray),
            ("current_command", CURRENT_COMMAND, Float64MultiArray),
        ):
            self._node.listen(
                kind,
                topic,
                self.listener(self._node.resolve_topic_name(topic), role, kind),
                STREAM,
                raw=True,
                dated=True,
                only_newest=partial(self.may_skip, role),
                together=partial(self._takes_all, role),
            )

    def _listen_to_voltage_driven(self, drives: Mapping[str, DriveTrain]) -> None:
        """The supply and the goals of servos that know no current."""
        node = self._node
        laws = [drive.driven_by for drive in drives.values() if drive.driven_by is not None]
        self.by_goals = ""
        if not laws:
            return
        full = node.resolve_topic_name(BATTERY_STATE)
        listener = self.listener(full, "battery_state", BatteryState)
        node.listen(BatteryState, BATTERY_STATE, listener, STREAM, raw=True)
        if any(law.follows_goal for law in laws):
            self.by_goals = node.resolve_topic_name(JOINT_COMMAND)
            listener = self.listener(self.by_goals, "joint_command", JointState)
            node.listen(
                JointState, JOINT_COMMAND, listener, STREAM, raw=True, together=lambda: True
            )

    def _listen_to_driver(self) -> None:
        """What our driver says once, or when it changes."""
        node = self._node
        self._motors_topic = node.resolve_topic_name("motors")
        node.create_subscription(DiagnosticStatus, "motors", self.on_motors, LATCHED, raw=True)
        self._temperatures_topic = node.resolve_topic_name(TEMPERATURES)
        node.create_subscription(
            Float64MultiArray, TEMPERATURES, self.on_temperatures, LATCHED, raw=True
        )
        # latched, but only what changes while a recording is under way belongs to it
        torque = partial(self._on_torque_enabled, node.resolve_topic_name("torque_enabled"))
        node.create_subscription(Bool, "torque_enabled", torque, LATCHED, raw=True)

    def _listen_to_inputs_of_others(self) -> None:
        """What another driver takes is only recorded: it may be in another unit and order than the estimate of a run takes."""
        node = self._node
        if not node.values["driver"] or node.values["command_topic"]:
            return
        for each in self.conventions.inputs:
            full = node.resolve_topic_name(each.topic)
            if any(subscription.topic_name == full for subscription in node.subscriptions):
                continue
            kind = JointState if each.msgtype == JOINT_STATE else Float64MultiArray
            listener = self.listener(full, "applied_current", kind)
            node.listen(kind, each.topic, listener, STREAM, raw=True)

    def _takes_all(self, role: str) -> bool:
        """Whether all that waits of a topic is taken at one wake-up; not where the time of hearing it counts."""
        # both are stamped; at 500 Hz each would have its own wake-up, and a node on a busy computer would hear them seconds late
        return not self._busy() or role in ("joint_states", "applied_effort")

    def may_skip(self, role: str) -> bool:
        """Whether only the newest message of a topic matters now."""
        return not self._busy() and (self.kept is None or role != "joint_states")

    def _listen_to_command(self) -> None:
        """The topic that the user named; its type shows when somebody publishes it."""
        name = self._command_topic
        node = self._node
        if any(subscription.topic_name == name for subscription in node.subscriptions):
            return
        for role, kind in (("applied_effort", JointState), ("current_command", Float64MultiArray)):
            if _type_of(kind) in dict(node.get_topic_names_and_types()).get(name, []):
                listener = self.listener(str(name), role, kind)
                node.listen(kind, str(name), listener, STREAM, raw=True)

    def listener(self, full_name: str, role: str, kind: type) -> Callable[..., None]:
        """What takes the messages of a topic.

        Args:
            full_name: Of the topic.
            role: What its messages say, as ``joint_states``.
            kind: Class of the messages.

        Returns:
            A callback for serialized messages, and what the middleware knows of them.
        """
        msgtype = _type_of(kind)

        def listen(data: bytes, info: Mapping[str, Any] = NO_INFO) -> None:
            now_ns = self._node.get_clock().now().nanoseconds
            if role == "joint_states":
                self._state_at_s = clock.now()
                self.newest_state = data
                # others on the topic may have another clock
                if any(name in data for name in self.joints):
                    stamp_ns = messages.first_stamp_ns(data) or now_ns
                    self._lag.note(now_ns, stamp_ns, clock.now_ns())
            elif role == "applied_effort":
                self._effort_at_s = clock.now()
            session = self.session
            heard = self.heard
            kept = self.kept
            arrived = self.arrived
            raw = RawMessage(full_name, msgtype, now_ns, bytes(data))
            if kept is not None and role in WORKING:
                kept.append(raw)
                while now_ns - kept[0].time_ns > 1e9 * self._node.values["weigh_seconds"]:
                    kept.popleft()
            if arrived is not None and role in WORKING:
                arrived.put(self._arrival(role, raw, info))
            if heard is not None:
                heard.append(raw)
            if session is None:
                return
            session.add(*raw)
            live = self.live
            if live is not None and role in ("joint_states", "applied_effort", "current_command"):
                self._add_live(live, role, now_ns, deserialize_message(data, kind))

        return listen

    def _arrival(
        self,
        role: str,
        raw: RawMessage,
        info: Mapping[str, Any],
    ) -> Arrival:
        """A message with when it was sent, as far as the middleware says it."""
        late_ns = 0
        # a simulation's time is heard as late as what happens in it
        simulated = self._node.get_clock().ros_time_is_active
        if role == "joint_states" and not simulated:
            late_ns = self.late_ns(len(raw.data), raw.time_ns, info)
        stamp_ns = messages.first_stamp_ns(raw.data) or raw.time_ns
        return Arrival(role, raw, stamp_ns, clock.now() - 1e-9 * late_ns)

    def late_ns(
        self,
        size: int,
        now_ns: int,
        info: Mapping[str, Any],
    ) -> int:
        """How long a message waited here until it is heard, and how much later than ever it came here.

        Args:
            size: Of the message [bytes]: those of one publisher have one.
            now_ns: When it is heard, on this computer's clock.
            info: When it came, on the same clock, and when it was sent, on that of whoever sent it.
        """
        came_ns = info.get("received_timestamp", 0)
        waited_ns = now_ns - came_ns
        if not 0 <= waited_ns < 1e9 * LATEST_S:  # not known, or a clock was set meanwhile
            came_ns = now_ns
            waited_ns = 0
        sent_ns = info.get("source_timestamp", 0)
        if not sent_ns:
            return waited_ns
        lag = self._on_the_way.setdefault(size, Lag())
        lag.note(came_ns, sent_ns, clock.now_ns() - waited_ns)
        return waited_ns + lag.late_ns

    def _add_live(
        self,
        live: LiveEstimate,
        role: str,
        now_ns: int,
        message: Any,
    ) -> None:
        if role == "joint_states":
            names = self.conventions.renamed(message.name)
            live.add_state(
                messages.time_ns(message.header.stamp),
                names,
                message.position,
            )
        elif role == "applied_effort":
            live.add_input(
                messages.time_ns(message.header.stamp),
                message.name,
                message.effort,
            )
            self.driven = any(message.effort)
        else:
            current_A = messages.by_joint(message, live.joints)
            if not isinstance(current_A, str):
                live.add_command(now_ns, current_A)
                if not self.has_effort:
                    self.driven = any(current_A.values())

    def on_motors(self, data: bytes) -> None:
        """Said once, when the driver finds them."""
        self._motors = bytes(data)

    def on_temperatures(self, data: bytes) -> None:
        """Said once a second."""
        self._temperatures = bytes(data)
        session = self.session
        if session is not None:
            now_ns = self._node.get_clock().now().nanoseconds
            session.add(
                self._temperatures_topic, _type_of(Float64MultiArray), now_ns, self._temperatures
            )

    def moment(self) -> Moment:
        """Now, as a recording will have it."""
        return Moment(1e-9 * self.stamp_ns, self.temperatures_C())

    def temperatures_C(self) -> dict[str, float]:
        """How warm the motors are, as far as their driver says it, by joint.

        Nothing of a driver that is gone: what it said last is still here, and may be of hours ago.
        """
        if not self._temperatures or not self._node.count_publishers(self._temperatures_topic):
            return {}
        found = messages.by_joint(deserialize_message(self._temperatures, Float64MultiArray), ())
        return {} if isinstance(found, str) else found

    def _on_torque_enabled(
        self,
        topic: str,
        data: bytes,
        info: dict[str, Any],
    ) -> None:
        """It has no stamp: when it was sent counts, since a busy computer may have us hear it after the joint was caught."""
        session = self.session
        if session is not None:
            now_ns = self._node.get_clock().now().nanoseconds
            sent_ns = info.get("source_timestamp", 0)
            same_clock = 0 <= now_ns - sent_ns < 1e9 * LATEST_S
            session.add(
                topic,
                _type_of(Bool),
                sent_ns if same_clock else now_ns,
                bytes(data),
            )
            self.swings |= not deserialize_message(data, Bool).data

    def published_motors(self) -> list[RawMessage]:
        """What the driver said of its motors; nothing where none of ours runs any more."""
        if not self._motors or not self._node.count_publishers(self._motors_topic):
            return []
        now_ns = self._node.get_clock().now().nanoseconds
        published = [
            RawMessage(self._motors_topic, _type_of(DiagnosticStatus), now_ns, self._motors)
        ]
        if self._temperatures and self._node.count_publishers(self._temperatures_topic):
            kind = _type_of(Float64MultiArray)
            published.append(RawMessage(self._temperatures_topic, kind, now_ns, self._temperatures))
        return published

    @property
    def has_states(self) -> bool:
        """Whether joint states are coming."""
        return clock.now() - self._state_at_s <= STALE_S

    @property
    def has_effort(self) -> bool:
        """Whether applied efforts are coming, as our driver publishes them."""
        return clock.now() - self._effort_at_s <= STALE_S

    def measured_unit(self) -> str:
        """What the effort of the joint states is: as stated, or N m where our driver publishes it; empty: nobody says."""
        if self._unit or not self.has_effort:
            return self._unit
        # an effort that the excitation node gives an effort controller of somebody else's says nothing of what that driver measures
        return (
            "N.m"
            if self._node.count_publishers(self._node.resolve_topic_name("applied_current"))
            else ""
        )

    def missing(self) -> str:
        """Why a recording would not say what drove the joints, or an empty string."""
        node = self._node
        effort = node.resolve_topic_name(APPLIED_EFFORT)
        command = node.resolve_topic_name(CURRENT_COMMAND)
        if self.by_goals:
            if node.count_publishers(self.by_goals):
                return ""
            start = "start the excitation node with command_interface:=position"
            return f"nobody publishes where the servos are sent, {self.by_goals}: {start}"
        if self.has_effort:
            return ""
        if node.count_publishers(effort):
            return f"nothing comes on {effort}, although it has a publisher"
        named = self._command_topic
        if named is not None:
            return (
                ""
                if node.count_publishers(named)
                else f"nobody publishes the parameter command_topic, {named}"
            )
        # what the excitation node commands says it as well, where somebody obeys
        others = [
            info
            for info in node.get_subscriptions_info_by_topic(command)
            if info.node_name != node.get_name()
        ]
        if others or self._unit:
            return ""
        return (
            f"nothing says what drives the joints: nobody publishes {effort} or listens to {command}; start the driver, or "
            "give the parameter driver, command_topic or effort_unit"
        )

    @property
    def stamp_ns(self) -> int:
        """Of the newest joint state."""
        return self._lag.stamp_ns

    def catch_up(self) -> None:
        """Until joint states are heard as soon as ever, so that none from before becomes part of a recording."""
        deadline = clock.now() + LATEST_S
        while self._lag.late_ns > 1e9 * BEHIND_S:
            if clock.now() > deadline:  # a clock was set
                self._lag.accept()
            clock.sleep(0.02)

    def await_tail(self) -> None:
        """Until everything has been heard that was measured up to now, and a little more."""
        now_ns = self._node.get_clock().now().nanoseconds - self._lag.least_ns
        clock.sleep(TAIL_S)
        deadline = clock.now() + LATEST_S
        while self.stamp_ns < now_ns and clock.now() < min(deadline, self._state_at_s + SILENT_S):
            clock.sleep(0.02)


def _type_of(kind: type) -> str:
    """Such as ``sensor_msgs/msg/JointState``."""
    return f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}"
