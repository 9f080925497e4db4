"""A bag in memory, column by column: fast to read once, to bend often, and to write."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from proprio_ros.recordings.messages import RawMessage, message_types
from proprio_ros.recordings.topics import FLOAT_ARRAYS, JOINT_STATE
from proprio_ros.recordings.writer import write_messages
from proprio_ros.records import BoolArray, FloatArray, TimeArray
from support.bends.messages import messages_of

FLOAT_ARRAY = FLOAT_ARRAYS[0]
STATES = "/joint_states"
FIELDS = ("position", "velocity", "effort")
_ENCAPSULATION = 4  # bytes before a message, from behind which alignment counts
_COUNT = 4  # bytes of the length of a sequence


@dataclass(frozen=True)
class Stream:
    """Messages of one topic that hold the same columns."""

    topic: str
    msgtype: str
    names: tuple[str, ...]  # joints, or labels of an array's dimensions
    bag_ns: TimeArray  # the recorder's times [ns], shape (T,)
    stamp_ns: TimeArray  # of the headers [ns], shape (T,); no matter where the type has none
    # of each field that is not empty its numbers, shape (T, J)
    values: Mapping[str, FloatArray]
    first: Any  # message that the others are like, but for stamp and numbers

    def column(self, joint: str) -> int:
        """Of a joint."""
        return self.names.index(joint)

    def with_values(self, **values: FloatArray) -> Stream:
        """The same with other numbers of some fields, shape (T, J) each."""
        return replace(self, values={**self.values, **values})

    def kept(self, rows: BoolArray) -> Stream:
        """The messages of some rows, shape (T,)."""
        values = {name: table[rows] for name, table in self.values.items()}
        return replace(
            self,
            bag_ns=self.bag_ns[rows],
            stamp_ns=self.stamp_ns[rows],
            values=values,
        )

    def raw(self) -> list[RawMessage]:
        """As they go over a wire."""
        rows = _joint_rows(self) if self.msgtype == JOINT_STATE else _array_rows(self)
        return [
            RawMessage(self.topic, self.msgtype, int(time_ns), row.tobytes())
            for time_ns, row in zip(self.bag_ns, rows, strict=True)
        ]


@dataclass(frozen=True)
class Tape:
    """All messages of a bag; those that are neither joint states nor arrays of numbers as they came."""

    streams: tuple[Stream, ...]
    others: tuple[RawMessage, ...] = ()

    @property
    def states(self) -> Stream:
        """The first stream of joint states."""
        return next(each for each in self.streams if each.topic == STATES)

    @property
    def begin_ns(self) -> int:
        """The recorder's time of the first joint state [ns]."""
        return int(self.states.bag_ns[0])

    @property
    def end_ns(self) -> int:
        """The recorder's time of the last joint state [ns]."""
        return int(self.states.bag_ns[-1])

    @property
    def moving(self) -> tuple[str, ...]:
        """The joints that turn by more than 0.1 rad."""
        spans = np.ptp(
            self.states.values["position"],
            axis=0,
        )
        return tuple(
            name for name, span in zip(self.states.names, spans, strict=True) if span > 0.1
        )

    def with_states(
        self,
        change: Callable[[Stream], Stream],
    ) -> Tape:
        """The same with every stream of joint states changed."""
        return self.with_topic(STATES, change)

    def with_topic(
        self,
        topic: str,
        change: Callable[[Stream], Stream],
    ) -> Tape:
        """The same with every stream of a topic changed."""
        streams = tuple(change(each) if each.topic == topic else each for each in self.streams)
        return replace(self, streams=streams)

    def and_stream(self, stream: Stream) -> Tape:
        """One stream more, as of a second publisher."""
        return replace(self, streams=(*self.streams, stream))

    def retimed(
        self,
        change: Callable[[TimeArray], TimeArray],
        *,
        stamps: bool = True,
        recorder: bool = True,
    ) -> Tape:
        """The same at other times.

        Args:
            change: Of times [ns], shape (T,), the others.
            stamps: Whether those of headers change.
            recorder: Whether those of the recorder change.
        """
        streams = []
        for each in self.streams:
            stamp_ns = change(each.stamp_ns) if stamps else each.stamp_ns
            bag_ns = change(each.bag_ns) if recorder else each.bag_ns
            streams.append(replace(each, stamp_ns=stamp_ns, bag_ns=bag_ns))
        others = self.others
        if recorder and others:
            times = change(np.array([each.time_ns for each in others], dtype=np.int64))
            moved = zip(others, times, strict=True)
            others = tuple(each._replace(time_ns=int(time_ns)) for each, time_ns in moved)
        return Tape(tuple(streams), others)

    def between(self, begin: float, end: float) -> Tape:
        """The part of it between two shares of its length."""
        length_ns = self.end_ns - self.begin_ns
        first_ns = self.begin_ns + int(begin * length_ns)
        last_ns = self.begin_ns + int(end * length_ns)

        def within(stream: Stream) -> Stream:
            late = stream.bag_ns >= first_ns
            early = stream.bag_ns <= last_ns
            return stream.kept(late & early)

        streams = tuple(within(each) for each in self.streams)
        others = tuple(each for each in self.others if first_ns <= each.time_ns <= last_ns)
        return Tape(streams, others)

    def write(self, path: Path, storage: str = "mcap") -> Path:
        """To a new bag, in the order of the recorder's times; where they are the same, in that of the streams."""
        messages = [message for each in self.streams for message in each.raw()]
        write_messages(path, [*messages, *self.others], storage)
        return path


@lru_cache(maxsize=64)
def tape_of(bag: Path) -> Tape:
    """A bag as it is."""
    groups: dict[tuple[Any, ...], list[tuple[int, Any]]] = {}
    others = []
    types: Any = message_types()
    for topic, msgtype, time_ns, message in messages_of(bag):
        if msgtype in (JOINT_STATE, FLOAT_ARRAY):
            key = (topic, msgtype, *_columns(message))
            groups.setdefault(key, []).append((time_ns, message))
        else:
            raw = bytes(types.serialize_cdr(message, msgtype))
            others.append(RawMessage(topic, msgtype, time_ns, raw))
    streams = [
        _stream(
            key[0],
            key[1],
            found,
        )
        for key, found in groups.items()
    ]
    return Tape(tuple(streams), tuple(others))


def _columns(message: Any) -> tuple[Any, ...]:
    """What two messages of one stream have in common."""
    if hasattr(message, "data"):
        return (
            tuple(each.label for each in message.layout.dim),
            len(message.data),
        )
    return (
        tuple(message.name),
        *(len(getattr(message, name)) for name in FIELDS),
    )


def _stream(
    topic: str,
    msgtype: str,
    found: list[tuple[int, Any]],
) -> Stream:
    bag_ns = np.array(
        [time_ns for time_ns, _ in found],
        dtype=np.int64,
    )
    messages = [message for _, message in found]
    first = messages[0]
    if msgtype == FLOAT_ARRAY:
        names = tuple(each.label for each in first.layout.dim)
        values = {"data": np.array([each.data for each in messages])}
        return Stream(topic, msgtype, names, bag_ns, bag_ns, values, first)
    stamps = [each.header.stamp for each in messages]
    values = {
        name: np.array([getattr(each, name) for each in messages])
        for name in FIELDS
        if len(getattr(first, name))
    }
    stamp_ns = np.array([each.sec * 10**9 + each.nanosec for each in stamps], dtype=np.int64)
    return Stream(
        topic,
        msgtype,
        tuple(first.name),
        bag_ns,
        stamp_ns,
        values,
        first,
    )


def _joint_rows(stream: Stream) -> np.ndarray:
    """Bytes of all messages, shape (T, L)."""
    empty = np.empty(0)
    header = stream.first.header
    names = list(stream.names)
    bare = type(stream.first)(
        header,
        names,
        empty,
        empty,
        empty,
    )
    raw = bytes(message_types().serialize_cdr(bare, JOINT_STATE))
    # three sequences without elements end it
    head = np.frombuffer(
        raw[: len(raw) - len(FIELDS) * _COUNT],
        np.uint8,
    )
    rows = np.tile(
        head,
        (len(stream.bag_ns), 1),
    )
    seconds, nanoseconds = np.divmod(stream.stamp_ns, 10**9)
    rows[:, 4:8] = _bytes(seconds.astype("<i4")[:, None])
    rows[:, 8:12] = _bytes(nanoseconds.astype("<u4")[:, None])
    for name in FIELDS:
        rows = _with_numbers(rows, stream.values.get(name))
    return rows


def _array_rows(stream: Stream) -> np.ndarray:
    """Bytes of all messages, shape (T, L)."""
    bare = type(stream.first)(
        stream.first.layout,
        np.empty(0),
    )
    raw = bytes(message_types().serialize_cdr(bare, FLOAT_ARRAY))
    head = np.frombuffer(
        raw[: len(raw) - _COUNT],
        np.uint8,
    )
    rows = np.tile(
        head,
        (len(stream.bag_ns), 1),
    )
    return _with_numbers(rows, stream.values["data"])


def _with_numbers(
    rows: np.ndarray,
    numbers: FloatArray | None,
) -> np.ndarray:
    """Rows with a sequence of float64 behind them: count, padding to 8 bytes, numbers."""
    messages = len(rows)
    columns = 0 if numbers is None else numbers.shape[1]
    count = np.full((messages, 1), columns, "<u4")
    rows = np.hstack([rows, _bytes(count)])
    if numbers is None or columns == 0:
        return rows
    padding = (_ENCAPSULATION - rows.shape[1]) % 8
    filled = np.zeros((messages, padding), np.uint8)
    return np.hstack([rows, filled, _bytes(numbers.astype("<f8"))])


def _bytes(numbers: np.ndarray) -> np.ndarray:
    """Of numbers, shape (T, N), their bytes, shape (T, N times the size of one)."""
    return (
        np.ascontiguousarray(numbers)
        .view(np.uint8)
        .reshape(
            len(numbers),
            -1,
        )
    )
