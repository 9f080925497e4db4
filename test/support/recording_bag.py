"""A recording as a bag, so that tests can change one and read it again."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from proprio_ros.recordings.messages import RawMessage, message_types
from proprio_ros.recordings.topics import FLOAT_ARRAYS, JOINT_STATE
from proprio_ros.recordings.writer import write_messages
from proprio_ros.records import FloatArray, JointRecord, Recording


def write_recording(
    path: str | Path,
    recording: Recording,
    storage: str = "mcap",
    effort_per_A: float | None = None,
) -> None:
    """Write /joint_states (position, velocity, effort) and, if there is an input, /current_command with labels.

    With ``effort_per_A`` [N m/A] the input is written as a driver does, to /applied_effort.

    Reading it back with effort_unit 'N.m' gives the same arrays, bit by bit.

    Args:
        path: Folder to make; it must not exist. Nothing is left of it when writing fails.
        recording: What to write.
        storage: 'mcap' or 'sqlite3'.

    Raises:
        RecordingError: The folder exists or cannot be written.
        ConfigurationError: Unknown storage.
    """
    types = message_types()
    record = recording.joints
    inputs = recording.inputs
    if inputs is not None and effort_per_A is not None:
        applied = JointRecord(
            inputs.times_ns,
            inputs.names,
            np.zeros_like(inputs.current_A),
            effort=effort_per_A * inputs.current_A,
        )
        messages = [
            ("/applied_effort", JOINT_STATE, time_ns, _joint_state(types, applied, row))
            for row, time_ns in enumerate(applied.times_ns)
        ]
    else:
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


def _joint_state(types: Any, record: JointRecord, row: int) -> Any:
    time, header, state = (
        types.types[name]
        for name in ("builtin_interfaces/msg/Time", "std_msgs/msg/Header", JOINT_STATE)
    )
    seconds, nanoseconds = divmod(int(record.times_ns[row]), 1_000_000_000)
    empty = np.zeros(0)
    return state(
        header=header(
            stamp=time(sec=seconds, nanosec=nanoseconds),
            frame_id="",
        ),
        name=list(record.names),
        position=record.position[row],
        velocity=empty if record.velocity is None else record.velocity[row],
        effort=empty if record.effort is None else record.effort[row],
    )


def _float_array(
    types: Any,
    names: Sequence[str],
    values: FloatArray,
) -> Any:
    dimension, layout, array = (
        types.types[f"std_msgs/msg/{name}"]
        for name in ("MultiArrayDimension", "MultiArrayLayout", "Float64MultiArray")
    )
    return array(
        layout=layout(
            dim=[
                dimension(
                    label=",".join(names),
                    size=len(names),
                    stride=len(names),
                )
            ],
            data_offset=0,
        ),
        data=values,
    )
