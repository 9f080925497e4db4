"""Storage files of bags as recorders leave them: compressed, cut where a recorder was killed, without an index.

rosbags reads both storages; what it takes for granted of a file (an end, an index, a size that is so) is made good here.
"""

from __future__ import annotations

import shutil
import sys
from collections.abc import Collection, Generator
from contextlib import suppress
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

from lz4.frame import LZ4FrameDecompressor
from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader, metadata, storage_mcap
from rosbags.rosbag2 import reader as rosbag2_reader
from rosbags.rosbag2.errors import ReaderError
from rosbags.rosbag2.metadata import ReaderMetadata
from rosbags.rosbag2.storage_mcap import McapReader, Statistics
from ruamel.yaml import YAML

from proprio_ros.errors import RecordingError
from proprio_ros.inputs.reading import yaml_of

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

MOST_BYTES_OF_ONE = 200_000  # bytes of one message: that of a thousand joints
# bytes of a compressed bag's files, or of one chunk of it, once they are unpacked
MOST_UNPACKED = 2_000_000_000
STORAGE = (".mcap", ".db3")
COMPRESSED = (".mcap.zstd", ".db3.zstd", ".mcap.zst", ".db3.zst")
"""How names of storage files end, and those of files that were compressed whole."""
_AT_ONCE = 1 << 20
_MAGIC = b"\x89MCAP0\r\n"
_OP, _LENGTH, _CHUNK, _DATA_END, _LAST_OP = 1, 8, 0x06, 0x0F, 0x0F


class Unpacking:
    """What a compressed stream holds; where it was cut it ends early, and what came before is read."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self._frame = zstd.ZstdDecompressor()

    def __enter__(self) -> Unpacking:
        return self

    def __exit__(self, *_: object) -> None:
        return None

    def read(self, size: int = _AT_ONCE) -> bytes:
        """At most so many bytes; none at the end, or where the stream breaks off."""
        while True:
            given = b""
            if self._frame.eof:
                given = self._frame.unused_data
                self._frame = zstd.ZstdDecompressor()
            if not given and self._frame.needs_input:
                given = self._stream.read(_AT_ONCE)
                if not given:
                    return b""
            data = self._frame.decompress(given, max_length=size)
            if data:
                return bytes(data)


def refuse_large(file: Path) -> None:
    """Raises `RecordingError`: A compressed file would fill the disk once it is unpacked."""
    size = 0
    # what else is wrong with it, whoever reads it says
    with suppress(OSError, zstd.ZstdError), file.open("rb") as stream:
        unpacking = Unpacking(stream)
        while size <= MOST_UNPACKED and (data := unpacking.read()):
            size += len(data)
    if size > MOST_UNPACKED:
        raise RecordingError(
            f"unpacks to over {MOST_UNPACKED / 1e9:g} GB, the most that is read", file
        )


def unpacked(file: Path, folder: Path) -> Path:
    """A storage file as it was before it was compressed, in a folder; what a cut file still holds.

    Raises `RecordingError`: That is nothing.
    """
    place = folder / file.stem
    with file.open("rb") as packed, place.open("wb") as stream:
        shutil.copyfileobj(Unpacking(packed), stream)
    if not place.stat().st_size:
        raise RecordingError(
            "compressed with zstd, and its end is missing, without which nothing of it can be unpacked",
            file,
        )
    return place


class AnyMcap(McapReader):
    """An MCAP file that may lack its end, where its recorder was killed, or its index.

    Attributes:
        lost: Bytes behind the last whole record; 0 where the file is whole.
    """

    connections: list[Connection]

    def __init__(self, path: Any) -> None:
        super().__init__(path)
        self.lost = 0
        self._tail: McapReader | None = None  # whole records of a chunk that breaks off

    def _open(self) -> None:
        assert self.bio
        size = self.bio.seek(0, 2)
        self.bio.seek(max(0, size - len(_MAGIC)))
        is_whole = self.bio.read() == _MAGIC
        self.bio.seek(0)
        if is_whole:
            super()._open()
            if not all(chunk.message_index_offsets for chunk in self.chunks):
                self._count()
            return
        try:
            super()._open()
        except Exception:  # of what lacks its end; what has no beginning, either, is no MCAP file
            if not self.data_start:
                raise
        self.data_end = _whole_until(self.bio, self.data_start, size)
        self.lost = size - self.data_end
        self._tail = self._broken_chunk(size)
        self._count()

    def _count(self) -> None:
        """Take stock by reading all records, since no index says what there is."""
        self.chunks.clear()
        self.meta_scan()
        found = self.statistics
        assert found is not None
        if self._tail is not None:
            self._tail.meta_scan()
            found = _together(found, self._tail.statistics)
        if not found.message_count:
            raise ReaderError("No whole message is left")
        counts = found.channel_message_counts
        connections = self.connections
        self.connections = [
            each._replace(
                msgcount=counts.get(
                    each.id,
                    0,
                )
            )
            for each in connections
        ]
        self.metadata = ReaderMetadata(0, 0, 0, 0, None, None, None, None)._replace(
            duration=found.end_time - found.start_time + 1,
            start_time=found.start_time,
            end_time=found.end_time + 1,
            message_count=found.message_count,
        )

    def _broken_chunk(self, size: int) -> McapReader | None:
        """The whole records in a chunk at the end of which only the beginning is there; None where there is no such chunk."""
        assert self.bio
        self.bio.seek(self.data_end)
        rest = self.bio.read(min(size - self.data_end, MOST_UNPACKED))
        if rest[:_OP] != bytes([_CHUNK]):
            return None
        record = BytesIO(rest[_OP + _LENGTH :])
        try:
            record.seek(8 + 8 + 8 + 4)  # times, size, checksum
            compression = storage_mcap.read_string(record)
            record.seek(8, 1)
            unpack = storage_mcap.DECOMPRESSORS[compression]
            data = unpack(record.read(), MOST_UNPACKED)
        except Exception:  # not even its head is there, or none of it can be unpacked
            return None
        tail = McapReader(self.path)
        tail.bio = BytesIO(data)
        tail.data_end = _whole_until(tail.bio, 0, len(data))
        # what the whole chunks know of topics and types holds here, too, and the other way round
        tail.schemas = self.schemas
        tail.channels = self.channels
        tail.connections = self.connections
        return tail

    def messages(
        self,
        connections: Collection[Connection],
        start: int | None = None,
        stop: int | None = None,
    ) -> Generator[tuple[Connection, int, bytes], None, None]:
        """As of rosbags; without an index in the order of the file, which need not be that of time.

        Args:
            connections: Whose messages are read.
            start: Only messages at or after this time [ns]; None: from the first on.
            stop: Only messages before this time [ns]; None: to the last.

        Yields:
            Connection, time [ns] and bytes of each message.
        """
        if self.chunks:
            yield from super().messages(connections, start, stop)
            return
        yield from self.messages_scan(connections, start, stop)
        if self._tail is not None:
            yield from self._tail.messages_scan(connections, start, stop)

    @property
    def note(self) -> str:
        """What is missing; empty where nothing is."""
        if not self.lost:
            return ""
        lasted_s = 1e-9 * self.metadata.duration
        return (
            f"{self.path.name} breaks off, as of a recorder that was killed: what came after {lasted_s:.1f} s is lost, and the "
            "rest was read."
        )


def _whole_until(stream: BinaryIO, start: int, size: int) -> int:
    """Where the last whole record of the data ends, from a place on, in a stream of so many bytes."""
    at = start
    while at + _OP + _LENGTH <= size:
        stream.seek(at)
        operation = stream.read(_OP)[0]
        length = int.from_bytes(stream.read(_LENGTH), "little")
        end = at + _OP + _LENGTH + length
        if not 0 < operation < _LAST_OP or end > size:
            break
        at = end
    return at


def _together(one: Statistics, other: Statistics | None) -> Statistics:
    assert other is not None
    counts = dict(one.channel_message_counts)
    for channel, count in other.channel_message_counts.items():
        counts[channel] = counts.get(channel, 0) + count
    return one._replace(
        message_count=one.message_count + other.message_count,
        start_time=min(one.start_time, other.start_time),
        end_time=max(one.end_time, other.end_time),
        channel_message_counts=counts,
    )


def notes_of(reader: Reader) -> list[str]:
    """What is missing of the files of an open bag, a sentence each."""
    storages = getattr(reader.storage, "storages", [reader.storage])
    return [each.note for each in storages if isinstance(each, AnyMcap) and each.note]


def _unpacked(
    kind: Any,
    data: bytes,
    size: int = MOST_BYTES_OF_ONE,
) -> bytes:
    """By a kind of decompressor, at most the given number of bytes, and one more."""
    return bytes(
        kind().decompress(
            data,
            max_length=min(size, MOST_UNPACKED) + 1,
        )
    )


def _read_exact(stream: BinaryIO, size: int) -> bytes:
    """What rosbags reads of a file, of which it believes whatever size is written there."""
    if size > MOST_UNPACKED:
        raise ReaderError(f"A record of {size:.3g} bytes is announced, which no file has")
    data = stream.read(size)
    if len(data) != size:
        raise ReaderError(f"A record breaks off: {len(data)} of {size} bytes are there")
    return data


class _Zstd:
    """What rosbags uses of zstd for whole files and single messages, with a limit on the latter."""

    @staticmethod
    def open(stream: BinaryIO, _mode: str) -> Unpacking:
        return Unpacking(stream)

    decompress = partial(_unpacked, zstd.ZstdDecompressor)
    ZstdError = zstd.ZstdError


class _Yaml(YAML):
    """What rosbags reads metadata with: a text that comes again (of each topic, at each opening) is not parsed again."""

    def load(self, stream: str) -> Any:
        return yaml_of(stream)


# a kilobyte of zstd or YAML can stand for gigabytes, and rosbags has no option that limits what it unpacks
storage_mcap.DECOMPRESSORS.update(
    {
        "": lambda data, _size: data,
        "zstd": partial(_unpacked, zstd.ZstdDecompressor),
        "lz4": partial(_unpacked, LZ4FrameDecompressor),
    }
)
storage_mcap.read_exact = _read_exact
rosbag2_reader.zstd = _Zstd
rosbag2_reader.YAML = _Yaml
metadata.YAML = _Yaml
Reader.STORAGE_PLUGINS[".mcap"] = rosbag2_reader.DirectoryReader.STORAGE_PLUGINS["mcap"] = AnyMcap
