"""Recordings and messages to new ROS 2 bags."""

from __future__ import annotations

import shutil
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer, WriterError

from proprio_ros.errors import ConfigurationError, RecordingError
from proprio_ros.recordings.messages import RawMessage, message_types
from proprio_ros.recordings.topics import FLOAT_ARRAYS, JOINT_STATE
from proprio_ros.records import FloatArray, JointRecord, Recording

_MCAP_MAGIC = b"\x89MCAP0\r\n"
_MCAP_CHUNK = 6


def write_recording(path: str | Path, recording: Recording, storage: str = "mcap") -> None:
    """Write /joint_states (position, velocity, effort) and, if there is an input, /current_command with labels.

    Reading it back with effort_unit 'N.m' gives the same arrays, bit by bit.

    Args:
        path: Folder to make; it must not exist. Nothing is left of it when writing fails.
        recording: What to write.
        storage: 'mcap' or 'sqlite3'.

    Raises:
        RecordingError: The folder exists or cannot be written.
        ConfigurationError: Unknown storage.
    """
    types, record, inputs = message_types(), recording.joints, recording.inputs
    messages = [] if inputs is None else [
        ("/current_command", FLOAT_ARRAYS[0], time_ns, _float_array(types, inputs.names, current))
        for time_ns, current in zip(inputs.times_ns, inputs.current_A, strict=True)
    ]  # fmt: skip
    messages += [
        ("/joint_states", JOINT_STATE, time_ns, _joint_state(types, record, row))
        for row, time_ns in enumerate(record.times_ns)
    ]
    write_messages(
        path,
        [
            RawMessage(topic, msgtype, int(time_ns), bytes(types.serialize_cdr(message, msgtype)))
            for topic, msgtype, time_ns, message in messages
        ],
        storage,
    )


def write_messages(path: str | Path, messages: Sequence[RawMessage], storage: str = "mcap") -> None:
    """Write messages to a new bag as they came, byte by byte, in the order of time.

    Args:
        path: Folder to make; it must not exist. Nothing is left of it when writing fails.
        messages: Of the types in which recordings come: JointState, Float64MultiArray and DiagnosticStatus.
        storage: 'mcap' or 'sqlite3'.

    Raises:
        RecordingError: The folder exists or cannot be written, as on a full disk.
        ConfigurationError: Unknown storage.
    """
    path = Path(path)
    plugins = {"mcap": StoragePlugin.MCAP, "sqlite3": StoragePlugin.SQLITE3}
    if storage not in plugins:
        raise ConfigurationError(f"bag storage {storage!r} is not known; choose from {', '.join(plugins)}")
    existed = path.exists()
    try:
        with Writer(path, version=9, storage_plugin=plugins[storage]) as writer:
            kinds = sorted({(message.topic, message.msgtype) for message in messages})
            connections = {kind: writer.add_connection(*kind, typestore=message_types()) for kind in kinds}
            for message in sorted(messages, key=lambda message: message.time_ns):
                writer.write(connections[message.topic, message.msgtype], message.time_ns, message.data)
        _add_checksums(path)
    except (WriterError, OSError) as error:
        if not existed:
            shutil.rmtree(path, ignore_errors=True)
        raise RecordingError(f"{path}: cannot be written ({error}); give a new folder on a disk with room") from error


def _add_checksums(path: Path) -> None:
    """Give each chunk of a new MCAP bag its CRC-32, which rosbags leaves out but checks when it reads.

    Records: an opcode, a length of 8 bytes, the content; that of a chunk (opcode 6): two times and a size of 8 bytes each, the CRC,
    the compression's name (none here) and the records with a length before each (mcap.dev/spec, Chunk).
    """
    for file in path.glob("*.mcap"):
        with file.open("r+b") as stream:
            content = stream.read()
            at = len(_MCAP_MAGIC)
            while at < len(content) - len(_MCAP_MAGIC):
                length = int.from_bytes(content[at + 1 : at + 9], "little")
                if content[at] == _MCAP_CHUNK:
                    records = content[at + 9 + 40 : at + 9 + length]
                    stream.seek(at + 9 + 24)
                    stream.write(zlib.crc32(records).to_bytes(4, "little"))
                at += 9 + length


def _joint_state(types: Any, record: JointRecord, row: int) -> Any:
    time, header, state = (
        types.types[name] for name in ("builtin_interfaces/msg/Time", "std_msgs/msg/Header", JOINT_STATE)
    )
    seconds, nanoseconds = divmod(int(record.times_ns[row]), 1_000_000_000)
    empty = np.zeros(0)
    return state(
        header=header(stamp=time(sec=seconds, nanosec=nanoseconds), frame_id=""),
        name=list(record.names),
        position=record.position[row],
        velocity=empty if record.velocity is None else record.velocity[row],
        effort=empty if record.effort is None else record.effort[row],
    )


def _float_array(types: Any, names: Sequence[str], values: FloatArray) -> Any:
    dimension, layout, array = (
        types.types[f"std_msgs/msg/{name}"] for name in ("MultiArrayDimension", "MultiArrayLayout", "Float64MultiArray")
    )
    return array(
        layout=layout(dim=[dimension(label=",".join(names), size=len(names), stride=len(names))], data_offset=0),
        data=values,
    )
