"""A bag of one servo with goals, positions and a supply voltage."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from proprio_ros.recordings.messages import RawMessage, message_types
from proprio_ros.recordings.topics import BATTERY, JOINT_STATE
from proprio_ros.recordings.writer import write_messages


def write(
    folder: Path,
    rows: dict[str, np.ndarray],
    effort: np.ndarray | None = None,
    topics: Sequence[str] = ("goal", "voltage"),
) -> Path:
    types: Any = message_types()
    time, header, state, battery = (
        types.types[name]
        for name in ("builtin_interfaces/msg/Time", "std_msgs/msg/Header", JOINT_STATE, BATTERY)
    )
    messages = []
    nothing = np.zeros(0)
    for row, t in enumerate(rows["t"]):
        time_ns = 10**9 + round(1e9 * t)
        stamp = header(
            stamp=time(
                sec=time_ns // 10**9,
                nanosec=time_ns % 10**9,
            ),
            frame_id="",
        )
        given = nothing if effort is None else effort[row : row + 1]
        said = [
            (
                "/joint_states",
                state(
                    stamp,
                    ["pendulum"],
                    rows["position"][row : row + 1],
                    nothing,
                    given,
                ),
            )
        ]
        if "goal" in topics:
            said.append(
                (
                    "/joint_command",
                    state(
                        stamp,
                        ["pendulum"],
                        rows["goal"][row : row + 1],
                        nothing,
                        nothing,
                    ),
                )
            )
        if "voltage" in topics:
            volts = float(rows["voltage"][row])
            numbers = np.zeros(0, dtype=np.float32)
            said.append(
                (
                    "/battery_state",
                    battery(
                        stamp, volts, 30.0, *[0.0] * 5, 0, 0, 0, True, numbers, numbers, "", ""
                    ),
                )
            )
        for topic, message in said:
            kind = BATTERY if topic == "/battery_state" else JOINT_STATE
            messages.append(
                RawMessage(
                    topic,
                    kind,
                    time_ns,
                    bytes(types.serialize_cdr(message, kind)),
                )
            )
    write_messages(folder, messages)
    return folder
