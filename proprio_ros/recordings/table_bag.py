"""A table as if its rows were messages of a bag: joint states, what drove the joints, goals; so all checks are the same."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from proprio_ros.errors import RecordingError
from proprio_ros.recordings.headers import Kind
from proprio_ros.recordings.reader import Bag, Rows
from proprio_ros.recordings.table_columns import Layout
from proprio_ros.recordings.table_times import in_ns, unit_shown
from proprio_ros.recordings.tables import Table
from proprio_ros.recordings.topics import JOINT_COMMAND, JOINT_STATE, Topic, Topics
from proprio_ros.records import BoolArray, FloatArray, Span, TimeArray

STATES, COMMANDS, GOALS = "/joint_states", "/commands", f"/{JOINT_COMMAND}"
"""What the topics are called that a table is read as."""


class _Named(NamedTuple):
    """A message, of which only the names are asked."""

    name: tuple[str, ...]


@dataclass(frozen=True)
class Stream:
    """Rows that are read as messages of one topic, in the order of time."""

    name: str
    times_ns: TimeArray  # (T,)
    joints: tuple[str, ...]
    # by field of a joint state, NaN where a cell is empty, (T, J); the first says which joints a message has
    values: Mapping[str, FloatArray]

    def within(self, begin_ns: int | None, end_ns: int | None) -> Stream:
        """The part between two times."""
        kept = np.ones(len(self.times_ns), dtype=bool)
        if begin_ns is not None:
            kept &= self.times_ns >= begin_ns
        if end_ns is not None:
            kept &= self.times_ns < end_ns
        values = {field: table[kept] for field, table in self.values.items()}
        return Stream(self.name, self.times_ns[kept], self.joints, values)

    def rows(self) -> Iterator[Rows]:
        """Neighbours that have the same joints, together."""
        there = ~np.isnan(next(iter(self.values.values())))  # (T, J)
        changes = np.flatnonzero((there[1:] != there[:-1]).any(axis=1)) + 1
        for part in np.split(np.arange(len(self.times_ns)), changes):
            joints = np.flatnonzero(there[part[0]])
            names = tuple(self.joints[joint] for joint in joints)
            values = {field: table[np.ix_(part, joints)] for field, table in self.values.items()}
            for field in {"position", "velocity", "effort"} - values.keys():
                values[field] = np.empty((len(part), 0))
            times_ns = self.times_ns[part]
            yield Rows(times_ns, times_ns, _Named(names), values)


class TableBag(Bag):
    """A table, topic by topic."""

    def __init__(self, path: Path, notes: Sequence[str], streams: Sequence[Stream]) -> None:
        topics = (Topic(each.name, JOINT_STATE, len(each.times_ns)) for each in streams)
        super().__init__(path, notes, Topics(path, tuple(topics)))
        self._streams = {each.name: each for each in streams}

    def cut(self, states: Topic, span: Span | None) -> TableBag:
        if span is None:
            return TableBag(self.path, self.notes, list(self._streams.values()))
        first_ns = int(self._streams[states.name].times_ns[0])
        begin_ns = first_ns + span[0] if span[0] else None
        end_ns = None if span[1] is None else first_ns + span[1]
        streams = [each.within(begin_ns, end_ns) for each in self._streams.values()]
        cut = TableBag(self.path, self.notes, streams)
        if not len(cut._streams[states.name].times_ns):
            until = "its end" if span[1] is None else f"{1e-9 * span[1]:g} s"
            raise RecordingError(
                f"no joint states between {1e-9 * span[0]:g} s and {until}", self.path
            )
        return cut

    def parts(self, states: Topic, most: int) -> list[Span]:
        stamps_ns = self._streams[states.name].times_ns
        times_ns = stamps_ns - stamps_ns[0]
        count = math.ceil(len(times_ns) / most)
        length = math.ceil(len(times_ns) / count)
        begins = sorted(set(times_ns[::length].tolist()))
        ends = [*begins[1:], int(times_ns[-1]) + 1]
        return list(zip(begins, ends, strict=True))

    def messages(self, topic: Topic, most: int | None = None) -> list[tuple[int, Any]]:
        return []

    def rows(self, topic: Topic) -> list[Rows]:
        found = list(self._streams[topic.name].rows())
        if not found:
            raise RecordingError(
                f"{topic.name} holds no messages in this part of the recording", self.path
            )
        return found


def table_bag(table: Table, layout: Layout) -> TableBag:
    """Read a table. Raises `RecordingError`: Its numbers or times cannot be read, or nobody says what times are in."""
    called = layout.time.header.text
    cells = table.read(layout.time.place, layout.places)
    rows = np.array([tick is not None for tick in cells.ticks])
    ticks = [tick for tick in cells.ticks if tick is not None]
    if not ticks:
        raise RecordingError(f"{called} holds no time in any row: record it again", table.path)
    notes = [*layout.notes, *cells.notes]
    if not all(rows):
        notes.append(f"{int((~rows).sum())} of {len(rows)} rows have no time; they were left out.")
    numbers = {
        column.place: column.factor * cells.numbers[column.place][rows]
        for columns in layout.joints.values()
        for column in columns
    }
    tables = {kind: _of_joints(layout, kind, numbers) for kind in layout.joints}
    unit = "ns" if cells.dated else layout.time_unit
    if unit is None:
        unit, why = _shown_unit(ticks, tables, layout, table.path)
        notes.append(why)
    times_ns = np.array(in_ns(ticks, unit, called, table.path), dtype=np.int64)
    if np.isnan(tables[Kind.POSITION]).all():
        first = layout.of(Kind.POSITION)[0].header.text
        raise RecordingError(f"no row has a position ({first} ..): record it again", table.path)
    _refuse_appended(times_ns, tables[Kind.POSITION], called, table.path)
    order = np.argsort(times_ns, kind="stable")
    streams = _streams(
        layout, times_ns[order], {kind: each[order] for kind, each in tables.items()}
    )
    return TableBag(table.path, notes, streams)


def _refuse_appended(times_ns: TimeArray, position: FloatArray, called: str, path: Path) -> None:
    """Raises `RecordingError`: Times begin anew, as where a recorder went on in the file of another recording."""
    whole_ns = times_ns[~np.isnan(position).all(axis=1)]
    back = np.flatnonzero(whole_ns[1:] < whole_ns[0] + np.ptp(whole_ns) // 10)
    back = back[whole_ns[back] - whole_ns[back + 1] > np.ptp(whole_ns) // 2]
    if len(back):
        raise RecordingError(
            f"{called} begins anew behind its row {back[0] + 1}: two recordings in one file; cut it there",
            path,
        )


def _shown_unit(
    ticks: Sequence[int], tables: Mapping[Kind, FloatArray], layout: Layout, path: Path
) -> tuple[str, str]:
    """The unit that the times of rows with positions must be in, and why."""
    position = tables[Kind.POSITION]
    whole: BoolArray = np.asarray(np.isfinite(position).all(axis=1))
    if whole.sum() < 2:
        raise RecordingError(
            "has not two rows with a time and all positions: record it again", path
        )
    taken = [tick for tick, is_whole in zip(ticks, whole, strict=True) if is_whole]
    velocity = tables[Kind.VELOCITY][whole]
    return unit_shown(taken, position[whole], velocity, layout.time.header.text, path)


def _of_joints(layout: Layout, kind: Kind, numbers: Mapping[int, FloatArray]) -> FloatArray:
    """Columns of a kind; of velocities and efforts for the joints that have positions, shape (R, J)."""
    by_joint = {column.joint: numbers[column.place] for column in layout.of(kind)}
    joints = _joints(layout, kind)
    rows = len(next(iter(numbers.values())))
    nothing = np.full(rows, np.nan)
    if not joints:
        return np.empty((rows, 0))
    return np.column_stack([by_joint.get(joint, nothing) for joint in joints])


def _joints(layout: Layout, kind: Kind) -> tuple[str, ...]:
    of_states = (Kind.POSITION, Kind.VELOCITY, Kind.EFFORT)
    columns = layout.of(Kind.POSITION if kind in of_states else kind)
    return tuple(column.joint for column in columns)


def _streams(
    layout: Layout, times_ns: TimeArray, tables: Mapping[Kind, FloatArray]
) -> list[Stream]:
    """What the rows are read as; a row without a number of a topic is no message of it."""
    fields = {"position": tables[Kind.POSITION]}
    for field, kind in (("velocity", Kind.VELOCITY), ("effort", Kind.EFFORT)):
        if layout.of(kind):
            fields[field] = tables[kind]
    streams = [_stream(STATES, times_ns, _joints(layout, Kind.POSITION), fields)]
    for name, kind, field in ((COMMANDS, Kind.COMMAND, "effort"), (GOALS, Kind.GOAL, "position")):
        if layout.of(kind):
            streams.append(_stream(name, times_ns, _joints(layout, kind), {field: tables[kind]}))
    return streams


def _stream(
    name: str, times_ns: TimeArray, joints: tuple[str, ...], fields: Mapping[str, FloatArray]
) -> Stream:
    filled: BoolArray = np.asarray(~np.isnan(next(iter(fields.values()))).all(axis=1))
    values = {field: table[filled] for field, table in fields.items()}
    return Stream(name, times_ns[filled], joints, values)
