"""Bytes of ROS 2 bags, whole, cut or broken: rosbags reads both storages (sqlite3, mcap), and what it raises becomes one line.

Only the topics that are needed are deserialised, so a bag may hold messages of types that nobody here knows.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from copy import copy
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Connection, ConnectionExtRosbag2
from rosbags.rosbag2 import Reader

from proprio_ros.errors import ProprioError, RecordingError, one_line, some
from proprio_ros.inputs.reading import path_problem, text_of, yaml_of
from proprio_ros.recordings.messages import deserialised, stamp_ns
from proprio_ros.recordings.storage import (
    COMPRESSED,
    MOST_BYTES_OF_ONE,
    STORAGE,
    notes_of,
    refuse_large,
    unpacked,
)
from proprio_ros.recordings.topics import Topic, Topics
from proprio_ros.records import FloatArray, Span, TimeArray

MOST_MESSAGES = 1_000_000  # messages of one topic of a bag: nearly three hours at 100 Hz
MOST_BYTES = 500_000_000  # bytes of the messages of one topic, together
_TOGETHER = 8192  # messages that are decoded at once
_Opened = TypeVar("_Opened", bound="Bag")


@contextmanager
def open_bag(path: str | Path) -> Iterator[RosBag]:
    """Open a bag: a folder (with or without metadata.yaml), or one .mcap or .db3 file.

    Raises `RecordingError`: It is none, or breaks then or while it is read, whatever rosbags raises over it.
    """
    path = Path(path)
    files = _files(path)
    with readable(path), ExitStack() as stack:
        if any(file.name.endswith(COMPRESSED) for file in files):
            folder = Path(stack.enter_context(TemporaryDirectory(prefix="proprio-")))
            files = [
                unpacked(file, folder) if file.name.endswith(COMPRESSED) else file for file in files
            ]
        readers = [stack.enter_context(Reader(file)) for file in files]
        yield RosBag(path, files, readers)


@contextmanager
def readable(path: Path) -> Iterator[None]:
    """Whatever rosbags raises over a bag becomes a `RecordingError` in one line."""
    try:
        yield
    except (ProprioError, MemoryError):
        raise
    # rosbags lets sqlite, zstd, struct, YAML, KeyError and AssertionError through, depending on which byte is wrong
    except Exception as error:
        reason = " ".join(str(error).split()).rstrip(".")[:200] or type(error).__name__
        if "erialization format" in reason:
            advice = "only 'cdr' can be read"
        elif "checksum" in reason:
            advice = "the file has changed since it was written: copy it again, or record it again"
        else:
            advice = "if the recorder was killed, try `ros2 bag reindex` or `mcap recover` on it"
        raise RecordingError(f"not readable as a ROS 2 bag ({reason}); {advice}", path) from error


class Bag(ABC):
    """What was recorded, topic by topic.

    Attributes:
        path: Of the bag.
        notes: What was repaired or is missing, a sentence each; grows while messages are read.
        topics: What it holds.
    """

    def __init__(self, path: Path, notes: Sequence[str], topics: Topics) -> None:
        self.path = path
        self.notes = list(notes)
        self.topics = topics

    def anew(self: _Opened) -> _Opened:
        """The same with notes of its own, so that one reading says nothing of another."""
        bag = copy(self)
        bag.notes = list(self.notes)
        return bag

    @abstractmethod
    def cut(self, states: Topic, span: Span | None) -> Bag:
        """A part of it, of every topic. Raises `RecordingError`: The part is behind the last joint state."""

    @abstractmethod
    def parts(self, states: Topic, most: int) -> list[Span]:
        """Where to cut so that no part has more than so many joint states, and all about as many; one part where none has more."""

    @abstractmethod
    def messages(
        self,
        topic: Topic,
        most: int | None = None,
    ) -> list[tuple[int, Any]]:
        """Recorder's time [ns] and message, of at most so many bytes each, in the order of time."""

    @abstractmethod
    def rows(self, topic: Topic) -> list[Rows]:
        """Joint states or arrays in the order of time; neighbours that differ only in their numbers come together."""


class RosBag(Bag):
    """The open files of one bag."""

    def __init__(
        self,
        path: Path,
        files: Sequence[Path],
        readers: list[Reader],
    ) -> None:
        notes = [
            *_notes_of_storage(path, files),
            *(note for reader in readers for note in notes_of(reader)),
            *_notes_of_logs(path),
        ]
        super().__init__(path, notes, _topics(path, readers))
        self._readers = readers
        # recorder's times that are read [ns]
        self._between: tuple[int | None, int | None] = None, None

    def cut(self, states: Topic, span: Span | None) -> RosBag:
        bag = self.anew()
        if span is None:
            return bag
        files = self._wanted(states)
        first_ns = min(
            ns
            for reader, wanted in files
            for _, ns, _ in islice(reader.messages(connections=wanted), 1)
        )
        bag._between = (
            first_ns + span[0] if span[0] else None,
            None if span[1] is None else first_ns + span[1],
        )
        if next(bag._read(states), None) is None:
            until = "its end" if span[1] is None else f"{1e-9 * span[1]:g} s"
            raise RecordingError(
                f"no joint states between {1e-9 * span[0]:g} s and {until}", self.path
            )
        return bag

    def parts(self, states: Topic, most: int) -> list[Span]:
        count = -(-states.size // most)
        if count < 2:
            return [(0, None)]
        size = -(-states.size // count)
        begins = list[int]()
        last_ns = 0
        try:
            for number, message in enumerate(_in_order(self._read(states))):
                last_ns = message[0]
                if number % size == 0:
                    begins.append(last_ns)
        except _OutOfOrder:  # files of one bag that overlap
            times = sorted(time_ns for time_ns, _ in self._read(states))
            begins = times[::size]
            last_ns = times[-1]
        ends = sorted({begin_ns - begins[0] for begin_ns in begins})
        return list(
            zip(
                ends,
                [*ends[1:], last_ns - begins[0] + 1],
                strict=True,
            )
        )

    def messages(
        self,
        topic: Topic,
        most: int | None = None,
    ) -> list[tuple[int, Any]]:
        return [
            (time_ns, deserialised(raw, topic.msgtype)) for time_ns, raw in self._raw(topic, most)
        ]

    def rows(self, topic: Topic) -> list[Rows]:
        try:
            found = list(
                _in_rows(
                    _in_order(self._limited(topic)),
                    topic.msgtype,
                )
            )
        except _OutOfOrder:  # files of one bag that overlap
            found = list(_in_rows(self._raw(topic), topic.msgtype))
        if not found:
            raise RecordingError(
                f"{topic.name} holds no messages in this part of the recording", self.path
            )
        return found

    def _wanted(
        self,
        topic: Topic,
    ) -> Iterator[tuple[Reader, list[Connection]]]:
        """The files that have a topic, with its connections."""
        for reader in self._readers:
            wanted = [
                c for c in reader.connections if (c.topic, c.msgtype) == (topic.name, topic.msgtype)
            ]
            if not wanted:
                continue  # rosbags reads every topic when it is given none
            for each in wanted:
                encoding = (
                    each.ext.serialization_format
                    if isinstance(each.ext, ConnectionExtRosbag2)
                    else "ros1"
                )
                if encoding != "cdr":
                    raise RecordingError(
                        f"topic {each.topic} is serialised as {encoding!r}; only 'cdr' can be read: record it with a"
                        " DDS middleware or convert it with `ros2 bag convert`",
                        self.path,
                    )
            yield reader, wanted

    def _read(
        self,
        topic: Topic,
    ) -> Iterator[tuple[int, bytes]]:
        """Recorder's time [ns] and message as it was recorded, file by file."""
        start_ns, stop_ns = self._between
        for reader, wanted in self._wanted(topic):
            for _, time_ns, raw in reader.messages(
                connections=wanted, start=start_ns, stop=stop_ns
            ):
                yield time_ns, bytes(raw)

    def _limited(
        self,
        topic: Topic,
        most: int | None = None,
    ) -> Iterator[tuple[int, bytes]]:
        """The same, of at most so many bytes each; refuses more than is read, and none, unless the bag was cut."""
        most = most or MOST_BYTES_OF_ONE
        size = 0
        count = 0
        for time_ns, raw in self._read(topic):
            size += len(raw)
            if len(raw) > most or size > MOST_BYTES or count == MOST_MESSAGES:
                raise RecordingError(
                    f"{one_line(topic.name, 60)} holds more than is read: {MOST_MESSAGES} messages, "
                    f"{MOST_BYTES / 1e6:g} MB together and {most / 1e3:g} kB each; cut the bag with `ros2 bag convert`, or give a "
                    "part of it, --span FROM:TO",
                    self.path,
                )
            count += 1
            yield time_ns, raw
        if self._between != (None, None):
            return
        if not count:
            raise RecordingError(
                f"{topic.name} should hold {topic.size} messages but holds none", self.path
            )
        if count < topic.size:
            self.notes.append(
                f"{topic.name}: the bag promises {topic.size} messages but holds {count}."
            )

    def _raw(
        self,
        topic: Topic,
        most: int | None = None,
    ) -> list[tuple[int, bytes]]:
        """All of them in the order of time."""
        return sorted(
            self._limited(topic, most),
            key=lambda message: message[0],
        )


def _notes_of_storage(
    path: Path,
    files: Sequence[Path],
) -> list[str]:
    """What is said of a bag whose storage files were read without its metadata."""
    if (path / "metadata.yaml").exists() and files != [path]:
        return [
            "metadata.yaml is damaged, or lists thousands of topics; the storage files were read without it."
        ]
    if len(files) > 1:
        return [f"There is no metadata.yaml; {len(files)} storage files were read as one bag."]
    return []


def _notes_of_logs(path: Path) -> list[str]:
    """What is said of write-ahead logs of sqlite that a recorder left beside its storage files."""
    logs = [path.with_name(f"{path.name}-wal")]
    if path.is_dir():
        logs = sorted(path.glob("*.db3-wal"))
    return [
        f"{log.name} may hold messages that were not read; merge it with"
        f" `sqlite3 {log.name[:-4]} 'PRAGMA wal_checkpoint'`."
        for log in logs
        if log.exists() and log.stat().st_size
    ]


def _topics(path: Path, readers: Sequence[Reader]) -> Topics:
    """What the files of one bag hold together, sorted by name."""
    counts: Counter[tuple[str, str]] = Counter()
    for reader in readers:
        for connection in reader.connections:
            counts[connection.topic, connection.msgtype] += connection.msgcount
    return Topics(
        path,
        tuple(Topic(*key, count) for key, count in sorted(counts.items())),
    )


class _OutOfOrder(Exception):
    """Messages do not come in the order of time."""


def _in_order(messages: Iterable[tuple[int, bytes]]) -> Iterator[tuple[int, bytes]]:
    """The same messages; raises `_OutOfOrder` where one is earlier than that before it."""
    last_ns: int | None = None
    for message in messages:
        if last_ns is not None and message[0] < last_ns:
            raise _OutOfOrder
        last_ns = message[0]
        yield message


class Rows(NamedTuple):
    """Messages that differ only in their numbers."""

    bag_ns: TimeArray  # (M,)
    stamp_ns: TimeArray  # (M,), 0 where there is none
    message: Any  # the first of them
    values: dict[str, FloatArray]  # (M, length of the field)


def _in_rows(
    messages: Iterable[tuple[int, bytes]],
    msgtype: str,
) -> Iterator[Rows]:
    """Numbers of messages in the order of time; no more than `_TOGETHER` messages are held as they were recorded."""
    coming = iter(messages)
    waiting = list[tuple[int, bytes]]()
    while True:
        waiting += islice(coming, _TOGETHER - len(waiting))
        if not waiting:
            return
        first = deserialised(waiting[0][1], msgtype)
        names = ("position", "velocity", "effort") if hasattr(first, "header") else ("data",)
        numbers = {name: getattr(first, name) for name in names}
        layout = _layout(waiting[0][1], first, numbers)
        count = 1
        stamps = None
        values = {key: np.asarray(data, np.float64)[None] for key, data in numbers.items()}
        if layout is not None:
            count, stamps, values = layout.read([raw for _, raw in waiting])
        elif hasattr(first, "header"):
            stamps = np.array([stamp_ns(first)])
        times = np.array(
            [time_ns for time_ns, _ in waiting[:count]],
            dtype=np.int64,
        )
        yield Rows(times, np.zeros_like(times) if stamps is None else stamps, first, values)
        del waiting[:count]


class _Layout(NamedTuple):
    """Where the numbers lie in the bytes of a message (CDR, little-endian)."""

    stamp: int | None
    numbers: dict[str, tuple[int, int, str]]  # offset, length in bytes, type

    def read(
        self,
        raws: Sequence[bytes],
    ) -> tuple[int, TimeArray | None, dict[str, FloatArray]]:
        """How many of the messages from the first on differ only in their numbers; their stamps and their numbers."""
        length = len(raws[0])
        count = next(
            (n for n, raw in enumerate(raws) if len(raw) != length),
            len(raws),
        )
        table = np.frombuffer(b"".join(raws[:count]), np.uint8).reshape(
            count,
            length,
        )
        same = np.ones(length, dtype=bool)
        for offset, size, _ in self.numbers.values():
            same[offset : offset + size] = False
        if self.stamp is not None:
            same[self.stamp : self.stamp + 8] = False
        unlike = np.flatnonzero((table[:, same] != table[0, same]).any(axis=1))
        table = table[: int(unlike[0]) if len(unlike) else count]

        def column(
            at: int,
            size: int,
            kind: str,
        ) -> NDArray[Any]:
            """The same bytes of every message, as numbers.

            Args:
                at: Offset of the first byte.
                size: How many bytes.
                kind: NumPy's name of the numbers' type, such as ``<f8``.

            Returns:
                A copy, shape (messages, numbers).
            """
            return table[:, at : at + size].copy().view(kind)

        stamps = None
        if self.stamp is not None:
            seconds = column(self.stamp, 4, "<i4")
            nanoseconds = column(self.stamp + 4, 4, "<u4")
            stamps = (seconds.astype(np.int64) * 1_000_000_000 + nanoseconds)[:, 0]
        numbers = self.numbers.items()
        values = {
            name: column(*where).astype(np.float64).reshape(len(table), -1)
            for name, where in numbers
        }
        return len(table), stamps, values


def _layout(
    raw: bytes,
    message: Any,
    numbers: Mapping[str, Any],
) -> _Layout | None:
    """Where the numbers of a message lie; None where that is not what the deserialiser says."""
    if raw[:2] != b"\0\1":
        return None
    at = 4  # behind the header, from where alignment counts

    def skip(size: int, align: int = 4) -> int:
        nonlocal at
        start = at + (4 - at) % align
        at = start + size
        return start

    def skip_text(text: str) -> None:
        skip(4)
        skip(len(text.encode()) + 1, 1)

    stamp = None
    if hasattr(message, "header"):
        stamp = skip(8)
        skip_text(message.header.frame_id)
        skip(4)
        for name in message.name:
            skip_text(name)
    else:
        skip(4)
        for dimension in message.layout.dim:
            skip_text(dimension.label)
            skip(8)
        skip(4)
    places = {}
    for key, values in numbers.items():
        skip(4)
        kind = np.dtype(np.asarray(values).dtype).newbyteorder("<")
        start = skip(values.nbytes, kind.itemsize) if len(values) else at
        places[key] = (start, values.nbytes, kind.str)
    layout = _Layout(stamp, places)
    if at > len(raw):
        return None
    _, stamps, found = layout.read([raw])
    fits = all(
        np.array_equal(found[key][0], np.asarray(values), equal_nan=True)
        for key, values in numbers.items()
    )
    return layout if fits and (stamps is None or int(stamps[0]) == stamp_ns(message)) else None


def _files(path: Path) -> list[Path]:
    """What to read: the folder when it has metadata, else its storage files; all of them are files and can be unpacked."""
    problem = path_problem(path)
    if problem:
        raise RecordingError(f"{one_line(str(path), 100)}: {problem}")
    if not path.exists():
        raise RecordingError("no such bag; give a bag folder, or a .mcap or .db3 file", path)
    if path.is_dir():
        found = _files_in(path)
    else:
        _refuse_no_file(path)
        found = [path]
        if path.suffix == ".bag":
            raise RecordingError(
                "a ROS 1 bag; convert it with `rosbags-convert` and give the ROS 2 bag", path
            )
        if not path.name.endswith((*STORAGE, *COMPRESSED)):
            raise RecordingError(
                "not a bag; give a bag folder, a .mcap or .db3 file, or a table (.csv, .parquet)",
                path,
            )
    for file in found:
        for inner in file.iterdir() if file.is_dir() else [file]:
            if inner.name.endswith((*STORAGE, *COMPRESSED)):
                _refuse_no_file(inner)
            if inner.name.endswith(COMPRESSED):
                refuse_large(inner)
    return found


def _files_in(folder: Path) -> list[Path]:
    """The same of a folder."""
    metadata = folder / "metadata.yaml"
    if metadata.exists() and _is_parsed(metadata):
        return [folder]
    for suffix in STORAGE:
        # a recorder compresses each file once it is full: the last one need not be, and one may be there as both
        found = {file.stem: file for file in folder.glob(f"*{suffix}.zst*")}
        found |= {file.name: file for file in folder.glob(f"*{suffix}")}
        if found:
            return [found[name] for name in sorted(found)]
    if metadata.exists():
        return [folder]
    inner = sorted(metadata.parent.name for metadata in folder.glob("*/metadata.yaml"))
    hint = (
        f"; did you mean one of the bags in it: {some(inner, 8)}?"
        if inner
        else "; give a bag folder or file"
    )
    if (folder / "meta" / "info.json").is_file():
        hint = f"; a LeRobot data set? Name an episode, '{one_line(folder.name, 60)}#0', or ask all with `proprio batch`"
    raise RecordingError(
        f"not a bag: no metadata.yaml and no .mcap or .db3 file in it{hint}", folder
    )


def _is_parsed(metadata: Path) -> bool:
    """Whether it is read as YAML within our limits; the storage files know what it says of thousands of topics, too."""
    try:
        yaml_of(text_of(metadata, RecordingError))
    except (RecordingError, ValueError):
        return False
    return True


def _refuse_no_file(path: Path) -> None:
    """Raises `RecordingError`: Whoever opened it would wait for what never comes."""
    if path.exists() and not path.is_file():
        raise RecordingError("a pipe, a socket or a device, and no file; copy it into one", path)
