"""What an open bag holds beside joint states and input: motors, temperatures, the robot's description, points that a camera saw.

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
from proprio_ros.recordings.read_options import ReadOptions
from proprio_ros.recordings.reader import Bag, open_bag
from proprio_ros.recordings.storage import COMPRESSED, STORAGE
from proprio_ros.recordings.tables import is_recorded_table, is_table
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
    """What a source holds, before a message of it is read."""

    topics: tuple[tuple[str, str, int], ...]  # name, type and number of messages of each
    # topic of the joint states, or column of the positions; None where `problem` says why none was chosen
    states: str | None = None
    # topic of the input; None where there is none but the measured effort
    inputs: str | None = None
    problem: RecordingError | None = None  # why a topic cannot be chosen
    # of a table: each header, and what it was read as; empty where it was not
    columns: tuple[tuple[str, str], ...] = ()


def contents_of(bag: Bag, options: ReadOptions) -> Contents:
    """A bag's topics, and which ones are read as joint states and as input."""
    topics = bag.topics
    found = Contents(
        tuple((one_line(each.name), one_line(each.msgtype), each.size) for each in topics.all)
    )
    try:
        state = topics.states(options.state_topic, options.command_topic, options.conventions)
        found = replace(found, states=one_line(state.name))
        inputs = topics.input(options.command_topic, state, options.conventions)
    except RecordingError as error:
        return replace(found, problem=error)
    if inputs is None or inputs[0] == state:
        return found
    return replace(found, inputs=one_line(inputs[0].name))


def is_recorded_file(path: Path) -> bool:
    """Whether a file is a recording by itself: storage of a bag, or a table with times and positions."""
    return path.name.endswith((*STORAGE, *COMPRESSED)) or is_recorded_table(path)


def parts_of(
    path: str | Path,
    most: int,
    *,
    state_topic: str | None = None,
    conventions: Conventions = OUR_DRIVER,
) -> list[Span]:
    """Parts of a bag with about as many joint states each, which leave no gap; a table is one part.

    Args:
        path: Of the bag.
        most: Joint states of a part.
        state_topic: Of the joint states, where the user names it.
        conventions: Of the driver that published.

    Returns:
        From when to when each part is, by the recorder's time since its first message [ns].

    Raises:
        RecordingError: The bag cannot be read.
    """
    if is_table(path):
        return [(0, None)]
    with open_bag(path) as bag:
        return bag.parts(
            bag.topics.states(state_topic, None, conventions),
            most,
        )


def motors_in(bag: Bag, state_topic: str | None) -> Motors:
    """The motors of the arm whose joint states a bag holds, as its driver named them on ``motors``; empty where it did not."""
    motors = {}
    for topic in _beside_states(bag, state_topic, "motors", STATUS):
        for _, message in bag.messages(topic):
            for entry in message.values:
                joint = one_line(str(entry.key))
                motors[joint] = MotorIdentity.from_text(str(entry.value))
    return {joint: motor for joint, motor in motors.items() if motor is not None}


def temperatures_in(
    bag: Bag,
    state_topic: str | None,
) -> dict[str, float]:
    """How warm the motors were on average, as the driver of the joint states said on ``motor_temperatures``, by joint [deg C]."""
    heard: dict[str, list[float]] = {}
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


def description_in(bag: Bag) -> str:
    """The URDF that a robot's driver published on ``/robot_description``; refuses a bag with none, or several that differ."""
    topics = bag.topics.called("robot_description", [STRING])
    if not topics:
        raise RecordingError(
            f"no /robot_description (std_msgs/String) in the bag; it holds: {listed(bag.topics.all)}; give a URDF file",
            bag.path,
        )
    texts = set()
    for topic in topics:
        texts |= {str(message.data) for _, message in bag.messages(topic, LONGEST_TEXT)}
    if len(texts) > 1:
        raise RecordingError(
            f"{len(texts)} descriptions that differ on {listed(topics)}; give a URDF file", bag.path
        )
    return texts.pop()


def points_in(bag: Bag, topic: str, option: str) -> PointTrack:
    """Where something was seen, by a topic of geometry_msgs/PointStamped; refuses points without stamps.

    Args:
        bag: Open.
        topic: The topic.
        option: That names it, for a refusal.

    Returns:
        Places [m] on the clock of the joint states.

    Raises:
        RecordingError: There is no such topic, or points have no stamps.
    """
    chosen = bag.topics.chosen(topic, [POINT], option)
    messages = [message for _, message in bag.messages(chosen)]
    stamps = np.array(
        [stamp_ns(message) for message in messages],
        dtype=np.int64,
    )
    if not stamps.all():
        raise RecordingError(
            f"{topic} holds points without a stamp: they cannot be laid beside the joint states",
            bag.path,
        )
    seen = [message.point for message in messages]
    points = np.array([[at.x, at.y, at.z] for at in seen])
    return PointTrack.of_seen(stamps, points)


def read_points(
    path: str | Path,
    topic: str,
    option: str,
) -> PointTrack:
    """The same of a bag that is not open yet.

    Args:
        path: Of the bag.
        topic: The topic.
        option: That names it, for a refusal.

    Returns:
        Places [m] on the clock of the joint states.

    Raises:
        RecordingError: The bag cannot be read, there is no such topic, or points have no stamps.
    """
    with open_bag(path) as bag:
        return points_in(bag, topic, option)
