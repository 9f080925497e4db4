"""What a bag holds beside joint states and input: motors, temperatures, the robot's description, points that a camera saw.

Every function raises a `RecordingError` where the bag cannot be read.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from proprio_ros.calibration_files.motors import MotorIdentity, Motors
from proprio_ros.errors import RecordingError, one_line
from proprio_ros.inputs.reading import LONGEST_TEXT
from proprio_ros.recordings.messages import labels_of, stamp_ns
from proprio_ros.recordings.reader import Bag, open_bag
from proprio_ros.recordings.topics import (
    FLOAT_ARRAYS,
    OUR_DRIVER,
    POINT,
    STATUS,
    STRING,
    TEMPERATURES,
    Conventions,
    Topic,
    listed,
)
from proprio_ros.records import PointTrack, Span


@dataclass(frozen=True)
class Contents:
    """What a bag holds, before a message of it is read."""

    topics: tuple[tuple[str, str, int], ...]  # name, type and number of messages of each
    # topic of the joint states; None where `problem` says why none was chosen
    states: str | None = None
    # topic of the input; None where there is none but the measured effort
    inputs: str | None = None
    problem: str = ""  # why a topic cannot be chosen, in one line, or an empty string


def look_into(
    path: str | Path,
    state_topic: str | None,
    command_topic: str | None,
    conventions: Conventions = OUR_DRIVER,
) -> Contents:
    """List a bag's topics, and say which ones `read_recording` takes."""
    with open_bag(path) as bag:
        found = Contents(
            tuple(
                (one_line(each.name), one_line(each.msgtype), each.size) for each in bag.topics.all
            )
        )
        try:
            state = bag.topics.states(state_topic, command_topic, conventions)
            found = replace(found, states=one_line(state.name))
            inputs = bag.topics.input(command_topic, state, conventions)
        except RecordingError as error:
            return replace(found, problem=str(error))
    return (
        found
        if inputs is None or inputs[0] == state
        else replace(found, inputs=one_line(inputs[0].name))
    )


def parts_of(
    path: str | Path,
    most: int,
    *,
    state_topic: str | None = None,
    conventions: Conventions = OUR_DRIVER,
) -> list[Span]:
    """Parts of a bag with about as many joint states each, of which none has more than ``most``; they leave no gap."""
    with open_bag(path) as bag:
        return bag.parts(bag.topics.states(state_topic, None, conventions), most)


def read_motors(path: str | Path, state_topic: str | None = None) -> Motors:
    """The motors of the arm whose joint states a bag holds, as its driver named them on ``motors``; empty where it did not."""
    with open_bag(path) as bag:
        topics = _beside_states(bag, state_topic, "motors", STATUS)
        entries = [
            entry
            for topic in topics
            for _, message in bag.messages(topic)
            for entry in message.values
        ]
    motors = {
        one_line(str(entry.key)): MotorIdentity.from_text(str(entry.value)) for entry in entries
    }
    return {joint: motor for joint, motor in motors.items() if motor is not None}


def read_temperatures(
    path: str | Path,
    state_topic: str | None = None,
) -> dict[str, float]:
    """How warm the motors were on average, as the driver of the joint states said on ``motor_temperatures``, by joint [deg C]."""
    heard: dict[str, list[float]] = {}
    with open_bag(path) as bag:
        for topic in _beside_states(bag, state_topic, TEMPERATURES, FLOAT_ARRAYS[0]):
            for _, message in bag.messages(topic):
                for joint, value in zip(labels_of(message), message.data, strict=False):
                    if joint and -273.0 < value < 1000.0:
                        heard.setdefault(one_line(joint), []).append(float(value))
    return {joint: float(np.mean(values)) for joint, values in heard.items()}


def _beside_states(
    bag: Bag,
    state_topic: str | None,
    name: str,
    msgtype: str,
) -> list[Topic]:
    """A topic in the namespace of the joint states; none where it is not there, or where these cannot be chosen."""
    try:
        namespace = bag.topics.states(state_topic).namespace
    except RecordingError:
        return []
    return [topic for topic in bag.topics.filled(msgtype) if topic.name == f"{namespace}/{name}"]


def read_description(path: str | Path) -> str:
    """The URDF that a robot's driver published on ``/robot_description``; refuses a bag with none, or several that differ."""
    with open_bag(path) as bag:
        topics = bag.topics.called("robot_description", [STRING])
        if not topics:
            raise RecordingError(
                f"{path}: no /robot_description (std_msgs/String) in the bag; it holds: {listed(bag.topics.all)}; give a URDF file"
            )
        texts = {
            str(message.data)
            for topic in topics
            for _, message in bag.messages(topic, LONGEST_TEXT)
        }
    if len(texts) > 1:
        raise RecordingError(
            f"{path}: {len(texts)} descriptions that differ on {listed(topics)}; give a URDF file"
        )
    return texts.pop()


def read_points(path: str | Path, topic: str, option: str) -> PointTrack:
    """Where something was seen, by a topic of geometry_msgs/PointStamped that an option names; refuses points without stamps."""
    with open_bag(path) as bag:
        messages = [
            message for _, message in bag.messages(bag.topics.chosen(topic, [POINT], option))
        ]
    stamps = np.array(
        [stamp_ns(message) for message in messages],
        dtype=np.int64,
    )
    if not stamps.all():
        raise RecordingError(
            f"{path}: {topic} holds points without a stamp: they cannot be laid beside the joint states"
        )
    return PointTrack.of_seen(
        stamps, np.array([[m.point.x, m.point.y, m.point.z] for m in messages])
    )
