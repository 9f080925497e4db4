"""What the topics of a driver are called and mean, and which topic of a bag is what.

Where a choice would be a guess (what `effort` means, which of two topics to take) the user is asked.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple, NoReturn

from proprio_ros.errors import RecordingError, some

JOINT_STATE = "sensor_msgs/msg/JointState"
STATUS = "diagnostic_msgs/msg/DiagnosticStatus"
BOOL = "std_msgs/msg/Bool"
STRING = "std_msgs/msg/String"
BATTERY = "sensor_msgs/msg/BatteryState"
POINT = "geometry_msgs/msg/PointStamped"
FLOAT_ARRAYS = ("std_msgs/msg/Float64MultiArray", "std_msgs/msg/Float32MultiArray")
APPLIED_EFFORT = "applied_effort"  # topic of what is commanded of the joints, as an effort
CURRENT_COMMAND = "current_command"  # topic of the currents that the driver takes
TORQUE_ENABLED = "torque_enabled"  # topic that says whether the motors' torque is on
TEMPERATURES = "motor_temperatures"  # topic of how warm each motor is
JOINT_COMMAND, BATTERY_STATE = "joint_command", "battery_state"
"""Topics of the goals of position servos, and of their supply."""


@dataclass(frozen=True)
class InputTopic:
    """A topic that says what drove the joints."""

    topic: str  # its name without a namespace
    msgtype: str  # `JOINT_STATE`, whose effort counts, or the first of `FLOAT_ARRAYS`
    unit: str  # of its numbers, one of `EFFORT_UNITS`
    # order of numbers that come without names, in the driver's names; empty: the robot's
    joints: tuple[str, ...] = ()

    @property
    def msgtypes(self) -> tuple[str, ...]:
        """Types that can be read alike."""
        return (JOINT_STATE,) if self.msgtype == JOINT_STATE else FLOAT_ARRAYS


@dataclass(frozen=True)
class Conventions:
    """Which topics a driver has, and what they mean; the defaults are those of this package's own driver."""

    # what the user called it; empty where nobody said, and the only joint states of any other name are taken, too
    driver: str = ""
    states: str = "joint_states"  # topic of the joint states, without a namespace
    # topics of what drives the joints, without a namespace; the first that a bag has is taken
    inputs: tuple[InputTopic, ...] = (
        InputTopic(APPLIED_EFFORT, JOINT_STATE, "N.m"),
        InputTopic(CURRENT_COMMAND, FLOAT_ARRAYS[0], "A"),
    )
    prefix: str = ""  # before the names of this robot's joints; it is taken off
    # the robot's names by those that the driver uses, once the prefix is off
    names: Mapping[str, str] = field(default_factory=dict)
    # what a unit of its positions is [rad]; those of sliding joints, too, are multiplied with it
    radians: float = 1.0

    def renamed(
        self,
        names: Sequence[str],
    ) -> tuple[str, ...]:
        """The robot's names of joints that a driver names."""
        if not self.prefix and not self.names:
            return tuple(str(name) for name in names)
        bare = [str(name).removeprefix(self.prefix) for name in names]
        return tuple(self.names.get(name, name) for name in bare)

    def also(self, names: Mapping[str, str]) -> Conventions:
        """The same with further names, by those that these conventions give."""
        known = {theirs: names.get(ours, ours) for theirs, ours in self.names.items()}
        new = {theirs: ours for theirs, ours in names.items() if theirs not in self.names.values()}
        return replace(self, names={**new, **known})

    def published(self, name: str) -> str:
        """The driver's name of one of the robot's joints."""
        return self.prefix + next(
            (theirs for theirs, ours in self.names.items() if ours == name), name
        )


OUR_DRIVER = Conventions()


class Topic(NamedTuple):
    """A topic of a bag, and how many messages it holds by the bag's index."""

    name: str
    msgtype: str
    size: int

    @property
    def namespace(self) -> str:
        return self.name.rpartition("/")[0]

    @property
    def base_name(self) -> str:
        """Its name without the namespace."""
        return self.name.rpartition("/")[2]


def listed(topics: Sequence[Topic]) -> str:
    """Topics as a message names them."""
    return (
        some([f"{topic.name} ({topic.msgtype.replace('/msg/', '/')})" for topic in topics], 8)
        or "none"
    )


@dataclass(frozen=True)
class Topics:
    """The topics of one bag; its path is for messages."""

    path: Path
    all: tuple[Topic, ...]

    def filled(self, *msgtypes: str) -> list[Topic]:
        """Those of some types that hold messages."""
        return [topic for topic in self.all if topic.size and topic.msgtype in msgtypes]

    def called(
        self,
        name: str,
        msgtypes: Sequence[str],
        namespace: str = "",
    ) -> list[Topic]:
        """Topics of a name that hold messages: that in the namespace, else that at the root, else those of any namespace.

        Args:
            name: Without a namespace.
            msgtypes: Types that can be read.
            namespace: Where it is looked for first.

        Returns:
            The topics.
        """
        filled = self.filled(*msgtypes)
        for full_name in (f"{namespace}/{name}", f"/{name}"):
            exact = [topic for topic in filled if topic.name == full_name]
            if exact:
                return exact
        return [topic for topic in filled if topic.name.endswith(f"/{name}")]

    def chosen(
        self,
        name: str,
        msgtypes: Sequence[str],
        option: str,
    ) -> Topic:
        """The topic that the user named.

        Args:
            name: With a namespace, or without one.
            msgtypes: Types that can be read.
            option: With which it was named.

        Returns:
            The topic.

        Raises:
            RecordingError: It is not there, of another type, or empty.
        """
        found = [topic for topic in self.all if topic.name in (name, f"/{name}")]
        fitting = [topic for topic in found if topic.msgtype in msgtypes]
        if not fitting:
            choices = [topic for topic in self.all if topic.msgtype in msgtypes]
            what = f"is {found[0].msgtype}" if found else "is not in the bag"
            self._refuse(f"{option} {name} {what}; choose from: {listed(choices)}")
        if fitting[0].size == 0:
            self._refuse(f"{option} {name} holds no messages")
        return fitting[0]

    def _refuse(self, why: str) -> NoReturn:
        raise RecordingError(why, self.path)

    def states(
        self,
        name: str | None,
        command_name: str | None = None,
        conventions: Conventions = OUR_DRIVER,
    ) -> Topic:
        """The joint states: as the user calls them, else those that the driver's conventions name, else the only ones.

        Args:
            name: What the user calls them; None: nothing.
            command_name: What the user calls the input, which is not taken for them.
            conventions: Of the driver that published.

        Returns:
            The topic.

        Raises:
            RecordingError: The bag has none, or several that may be meant.
        """
        if name is not None:
            return self.chosen(name, [JOINT_STATE], "--state-topic")
        if not any(topic.size for topic in self.all):
            self._refuse("the bag holds no messages; record it again with `ros2 bag record`")
        typed = [topic for topic in self.all if topic.msgtype == JOINT_STATE]
        if not typed:
            self._refuse(
                f"no JointState topic in the bag; it holds: {listed(self.all)}; record /joint_states"
            )
        filled = self.filled(JOINT_STATE)
        if not filled:
            self._refuse(f"no joint states: {listed(typed)} holds no messages")
        candidates = self.called(conventions.states, [JOINT_STATE])
        if not candidates and conventions.driver:
            self._refuse(
                f"no joint states on {conventions.states}, where --driver {conventions.driver} has them; choose with "
                f"--state-topic from: {listed(filled)}"
            )
        inputs = [each.topic for each in conventions.inputs if each.msgtype == JOINT_STATE]
        commands = (command_name, f"/{command_name}")
        others = [
            each for each in filled if each.base_name not in inputs and each.name not in commands
        ]
        candidates = candidates or others
        if len(candidates) != 1:
            self._refuse(f"which joint states? choose with --state-topic from: {listed(filled)}")
        return candidates[0]

    def input(
        self, name: str | None, states: Topic, conventions: Conventions = OUR_DRIVER
    ) -> tuple[Topic, InputTopic] | None:
        """What drove the joints, and what it means: as the user calls it, else the first that the driver's conventions name.

        It has the namespace of the joint states. None where there is none, several are refused.
        """
        if name is not None:
            topic = self.chosen(name, [JOINT_STATE, *FLOAT_ARRAYS], "--command-topic")
            inputs = (
                *conventions.inputs,
                InputTopic("", JOINT_STATE, "N.m"),
                InputTopic("", FLOAT_ARRAYS[0], "A"),
            )
            return topic, next(each for each in inputs if topic.msgtype in each.msgtypes)
        namespace = states.name.removesuffix(f"/{conventions.states}")
        if namespace == states.name:  # the user named another topic
            namespace = states.namespace
        for usual in conventions.inputs:
            found = [
                topic
                for topic in self.called(usual.topic, usual.msgtypes, namespace)
                if topic != states
            ]
            if len(found) > 1:
                self._refuse(f"which input? choose with --command-topic from: {listed(found)}")
            if found:
                return found[0], usual
        return None
