"""Messages to a new ROS 2 bag, as they came over the wire."""

from __future__ import annotations

import shutil
import zlib
from collections.abc import Sequence
from pathlib import Path

from rosbags.rosbag2 import StoragePlugin, Writer, WriterError

from proprio_ros.errors import ConfigurationError, RecordingError
from proprio_ros.recordings.messages import RawMessage, message_types

_MCAP_MAGIC = b"\x89MCAP0\r\n"
_MCAP_CHUNK = 6


def write_messages(
    path: str | Path,
    messages: Sequence[RawMessage],
    storage: str = "mcap",
) -> None:
    """Write messages to a new bag as they came, byte by byte, in the order of time.

    Args:
        path: Folder that does not exist; nothing is left of it when writing fails.
        messages: In any order.
        storage: 'mcap' or 'sqlite3'.

    Raises:
        RecordingError: The folder exists or cannot be written, as on a full disk.
        ConfigurationError: Unknown storage.
    """
    path = Path(path)
    plugins = {"mcap": StoragePlugin.MCAP, "sqlite3": StoragePlugin.SQLITE3}
    if storage not in plugins:
        raise ConfigurationError(
            f"bag storage {storage!r} is not known; choose from {', '.join(plugins)}"
        )
    existed = path.exists()
    try:
        with Writer(path, version=9, storage_plugin=plugins[storage]) as writer:
            kinds = sorted({(message.topic, message.msgtype) for message in messages})
            connections = {
                kind: writer.add_connection(*kind, typestore=message_types()) for kind in kinds
            }
            for message in sorted(messages, key=lambda message: message.time_ns):
                writer.write(
                    connections[message.topic, message.msgtype], message.time_ns, message.data
                )
        _add_checksums(path)
    except (WriterError, OSError) as error:
        if not existed:
            shutil.rmtree(path, ignore_errors=True)
        raise RecordingError(
            f"cannot be written ({error}); give a new folder on a disk with room", path
        ) from error


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
