"""A bag made of another one's messages: a part of them, other values, the same again."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore

TYPES = get_typestore(Stores.ROS2_JAZZY)
Write = Callable[[Connection, int, bytes], None]
"""Takes the connection of the bag that is read, the time [ns] and the message as it goes over a wire."""


@contextmanager
def copying(bag: Path, folder: Path) -> Iterator[tuple[AnyReader, Write]]:
    """A bag that is read, and what writes its messages to another one, with the same topics."""
    with AnyReader([bag], default_typestore=TYPES) as reader, Writer(folder, version=9) as writer:
        topics = {
            each.id: writer.add_connection(each.topic, each.msgtype, typestore=TYPES)
            for each in reader.connections
        }

        def write(connection: Connection, time_ns: int, raw: bytes) -> None:
            writer.write(topics[connection.id], time_ns, raw)

        yield reader, write
