"""Bags as they are but for one mistake, made of every message; see `tape.py` for what is faster."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from rosbags.rosbag2 import Reader

from proprio_ros.recordings.messages import RawMessage, message_types
from proprio_ros.recordings.writer import write_messages

TYPES: Any = message_types()
Bend = Callable[[str, int, Any], tuple[int, Any]]
"""Of topic, time [ns] and content: the time and the content that are written instead."""


def messages_of(bag: Path) -> list[tuple[str, str, int, Any]]:
    """Topic, type, time [ns] and content of all messages."""
    with Reader(bag) as reader:
        return [
            (
                connection.topic,
                connection.msgtype,
                time_ns,
                TYPES.deserialize_cdr(data, connection.msgtype),
            )
            for connection, time_ns, data in reader.messages()
        ]


def bent(path: Path, bend: Bend, source: Path) -> Path:
    """A bag with every message as ``bend`` makes it."""
    made = []
    for topic, msgtype, time_ns, message in messages_of(source):
        time_ns, message = bend(topic, time_ns, message)
        made.append(
            RawMessage(
                topic,
                msgtype,
                time_ns,
                bytes(TYPES.serialize_cdr(message, msgtype)),
            )
        )
    write_messages(path, made, "mcap")
    return path


def of_joint_states(change: Callable[[Any], None]) -> Bend:
    """Joint states that ``change`` has altered in place."""

    def bend(
        topic: str,
        time_ns: int,
        message: Any,
    ) -> tuple[int, Any]:
        if topic == "/joint_states":
            change(message)
        return time_ns, message

    return bend


def commands_times(factor: float) -> Bend:
    """Commands that the motor was never given."""

    def bend(
        topic: str,
        time_ns: int,
        message: Any,
    ) -> tuple[int, Any]:
        if topic == "/current_command":
            message.data = message.data * factor
        return time_ns, message

    return bend


def stamps_times(factor: float) -> Bend:
    """A clock of joint states that runs fast or slow."""
    first: list[int] = []

    def bend(
        topic: str,
        time_ns: int,
        message: Any,
    ) -> tuple[int, Any]:
        if topic == "/joint_states":
            stamp = message.header.stamp
            whole = stamp.sec * 10**9 + stamp.nanosec
            first.append(whole)
            stamp.sec, stamp.nanosec = divmod(
                first[0] + round((whole - first[0]) * factor),
                10**9,
            )
        return time_ns, message

    return bend
