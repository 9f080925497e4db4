"""Small bags of one push of the elbow, as any driver may publish it, and what is read of them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from proprio_ros.errors import ProprioError, RecordingError
from proprio_ros.recordings.signals import read_recording
from proprio_ros.records import Recording

TYPES = get_typestore(Stores.ROS2_JAZZY)
JOINT_STATE = "sensor_msgs/msg/JointState"
FLOATS = "std_msgs/msg/Float64MultiArray"
JOINTS = ("joint1", "joint2", "joint3", "joint4", "gripper_left_joint")
CONSTANTS = dict.fromkeys(JOINTS, 1.783)
ONSET_NS = 1_760_000_010_000_000_000
CYCLE_NS = 25_000_000
STORAGES = ("mcap", "sqlite3")


class Message(NamedTuple):
    time_ns: int
    topic: str
    msgtype: str
    content: Any


def state(
    time_ns: int,
    position: Sequence[float],
    names: Sequence[str] = JOINTS,
    velocity: Sequence[float] = (),
    effort: Sequence[float] = (),
    topic: str = "/joint_states",
    stamp_ns: int | None = None,
) -> Message:
    time, header, joint_state = (
        TYPES.types[name]
        for name in ("builtin_interfaces/msg/Time", "std_msgs/msg/Header", JOINT_STATE)
    )
    seconds, nanoseconds = divmod(time_ns if stamp_ns is None else stamp_ns, 10**9)
    content = joint_state(
        header=header(
            stamp=time(sec=seconds, nanosec=nanoseconds),
            frame_id="",
        ),
        name=list(names),
        position=np.array(position, dtype=np.float64),
        velocity=np.array(velocity, dtype=np.float64),
        effort=np.array(effort, dtype=np.float64),
    )
    return Message(time_ns, topic, JOINT_STATE, content)


def command(
    time_ns: int,
    current: Sequence[float],
    labels: Sequence[str] = (),
    topic: str = "/current_command",
    msgtype: str = FLOATS,
) -> Message:
    dimension, layout = (
        TYPES.types[f"std_msgs/msg/{name}"] for name in ("MultiArrayDimension", "MultiArrayLayout")
    )
    dtype = np.float32 if "32" in msgtype else np.float64
    content = TYPES.types[msgtype](
        layout=layout(
            dim=[
                dimension(
                    label=label,
                    size=1,
                    stride=1,
                )
                for label in labels
            ],
            data_offset=0,
        ),
        data=np.array(current, dtype=dtype),
    )
    return Message(time_ns, topic, msgtype, content)


def write_bag(
    path: Path,
    messages: Sequence[Message],
    storage: str = "mcap",
) -> Path:
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        connections: dict[tuple[str, str], Any] = {}
        for message in messages:
            key = (message.topic, message.msgtype)
            if key not in connections:
                connections[key] = writer.add_connection(*key, typestore=TYPES)
            raw = TYPES.serialize_cdr(message.content, message.msgtype)
            writer.write(connections[key], message.time_ns, raw)
    return path


def times(count: int = 41) -> list[int]:
    return [ONSET_NS + (row - 10) * CYCLE_NS for row in range(count)]


def elbow(time_ns: int) -> float:
    """A smooth motion in which no two samples are alike."""
    return 0.6 - max(time_ns - ONSET_NS, 0) * 1e-9


def positions(time_ns: int) -> list[float]:
    return [0.0, -1.4, elbow(time_ns), 0.1, 0.01]


def currents(
    time_ns: int,
    value: float = -0.3,
) -> list[float]:
    return [
        0.0,
        0.0,
        value if 0 <= time_ns - ONSET_NS < 600_000_000 else 0.0,
        0.0,
        0.0,
    ]


def states(**changes: Any) -> list[Message]:
    return [state(time_ns, positions(time_ns), **changes) for time_ns in times()]


def commands(**changes: Any) -> list[Message]:
    return [command(time_ns, currents(time_ns), **changes) for time_ns in times()]


def read(path: Path, **options: Any) -> Recording:
    return read_recording(
        path, **({"nominal_torque_constants": CONSTANTS, "joint_order": JOINTS} | options)
    )


@contextmanager
def refused(
    pattern: str,
    error: type[ProprioError] = RecordingError,
) -> Iterator[None]:
    """One line that matches."""
    with pytest.raises(error) as caught:
        yield
    assert "\n" not in str(caught.value)
    assert re.search(pattern, str(caught.value)), str(caught.value)


def notes(recording: Recording) -> str:
    return " ".join(recording.notes)
