"""Messages of a bag as columns by joint, under the robot's names."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from proprio_ros.errors import RecordingError
from proprio_ros.recordings.messages import labels_of
from proprio_ros.recordings.noted import Noted
from proprio_ros.recordings.reader import Bag, Rows
from proprio_ros.recordings.topics import OUR_DRIVER, Conventions, InputTopic, Topic
from proprio_ros.records import FloatArray, TimeArray


class JointColumns(NamedTuple):
    """Messages as columns by joint, rows in the order of recording."""

    bag_ns: TimeArray  # (M,)
    stamp_ns: TimeArray  # (M,), 0 where the header has no stamp
    names: tuple[str, ...]
    # quantity -> (M, J); NaN: not in the message, inf: in it, but NaN or infinite
    values: dict[str, FloatArray]
    notes: list[str]

    def ahead_ns(self) -> TimeArray:
        """How far each header stamp is ahead of the recorder's time [ns], of those messages that have one."""
        return (self.stamp_ns - self.bag_ns)[self.stamp_ns != 0]

    def clock_ns(self) -> int:
        """How far the header stamps are ahead of the recorder's time [ns], 0 without any stamp."""
        ahead = np.sort(self.ahead_ns())
        # np.median would round it to 256 ns
        return int(ahead[ahead.size // 2]) if ahead.size else 0


def joint_state_columns(
    bag: Bag, topic: Topic, quantities: Sequence[str], conventions: Conventions = OUR_DRIVER
) -> JointColumns:
    """Columns of a JointState topic.

    Args:
        bag: Open.
        topic: Of the joint states.
        quantities: Fields of the message; the first of them must be there in every message.
        conventions: Of the driver that published.

    Returns:
        A column for each joint that any message names, in SI units.

    Raises:
        RecordingError: Names and values do not fit each other, or two joints would have one name.
    """
    noted = Noted(bag.path, topic.name)
    rows = bag.rows(topic)
    named = [conventions.renamed(part.message.name) for part in rows]
    _refuse_two_of_a_name(noted, rows, named, conventions)
    names = tuple(dict.fromkeys(name for part in named for name in part))
    keys, orders = _keys(named)
    values = _filled(noted, rows, orders, len(keys), quantities)
    distinct = {tuple(order) for order in orders}
    if len({frozenset(order) for order in distinct}) < len(distinct):
        noted.note("the order of the joints changes between messages; they were matched by name.")
    if len(keys) > len(names):
        values = _named_once(noted, keys, names, values, quantities[0])
        noted.note(
            "messages name joints twice; the numbers that change along the recording were kept."
        )
    for quantity in {"position", "velocity"} & values.keys():
        values[quantity] *= conventions.radians
    bag_ns = np.concatenate([part.bag_ns for part in rows])
    stamp_ns = np.concatenate([part.stamp_ns for part in rows])
    return JointColumns(bag_ns, stamp_ns, names, values, noted.notes)


def _refuse_two_of_a_name(
    noted: Noted,
    rows: Sequence[Rows],
    named: Sequence[Sequence[str]],
    conventions: Conventions,
) -> None:
    """Raise RecordingError: two of the driver's joints would have one of the robot's names."""
    theirs: dict[str, str] = {}
    for part, own in zip(rows, named, strict=True):
        for name, other in zip(own, part.message.name, strict=True):
            if theirs.setdefault(name, other) != other:
                raise noted.error(
                    f": {theirs[name]} and {other} would both be {name}; state joint_names of --driver {conventions.driver} "
                    "otherwise"
                )


def _filled(
    noted: Noted,
    rows: Sequence[Rows],
    orders: Sequence[Sequence[int]],
    count: int,
    quantities: Sequence[str],
) -> dict[str, FloatArray]:
    """Numbers of messages by quantity, shape (M, count).

    Args:
        noted: Bag and topic.
        rows: Messages; those of one entry name the same joints.
        orders: Column of each joint that the messages of an entry name.
        count: Of the columns.
        quantities: Of which the first must be there in every message.

    Raises:
        RecordingError: A message has more or fewer numbers than names.
    """
    messages = sum(len(part.bag_ns) for part in rows)
    values = {quantity: np.full((messages, count), np.nan) for quantity in quantities}
    row = 0
    for part, columns in zip(rows, orders, strict=True):
        for quantity in quantities:
            data = part.values[quantity]
            length = data.shape[1]
            if length != len(columns) and (length or quantity == quantities[0]):
                raise noted.error(
                    f" has {len(columns)} names but {length} values of {quantity} in message {row + 1}; every joint needs "
                    "one"
                )
            if length:
                values[quantity][row : row + len(data), columns] = _marked(data)
        row += len(part.bag_ns)
        part.values.clear()  # of an hour they are as much again
    return values


_Key = tuple[str, int]
"""A joint, and how often the message named it before."""


def _keys(named: Sequence[Sequence[str]]) -> tuple[list[_Key], list[list[int]]]:
    """Keys of all columns, and those of each message in its order; a joint that it names twice has a column for each time."""
    numbered = [
        [(name, names[:place].count(name)) for place, name in enumerate(names)] for names in named
    ]
    keys = list(dict.fromkeys(key for own in numbered for key in own))
    index = {key: column for column, key in enumerate(keys)}
    return keys, [[index[key] for key in own] for own in numbered]


def _named_once(
    noted: Noted,
    keys: Sequence[_Key],
    names: Sequence[str],
    values: dict[str, FloatArray],
    decides: str,
) -> dict[str, FloatArray]:
    """One column a joint, of those that messages name twice.

    Args:
        noted: Bag and topic.
        keys: Of the columns that there are.
        names: Of the joints, whose columns are wanted.
        values: By quantity, shape (M, number of keys).
        decides: The quantity by which of two columns that differ one is taken: that which changes.

    Raises:
        RecordingError: Both change, and differ.
    """
    changing = [_changes(values[decides][:, column]) for column in range(len(keys))]
    # the node whose list moves most of its joints has those, too, that stand
    moving = Counter(key[1] for key, changes in zip(keys, changing, strict=True) if changes)
    liveliest = max(moving, key=lambda nth: moving[nth]) if moving else 0
    taken = []
    for name in names:
        columns = [column for column, key in enumerate(keys) if key[0] == name]
        alive = [column for column in columns if changing[column]]
        standing = [column for column in columns if keys[column][1] == liveliest]
        chosen = alive or standing or columns
        if not _alike(values[decides][:, chosen]):
            raise noted.error(
                f" names {name} twice in a message, with different numbers: two publishers were put into one list, and "
                "nobody knows which one is the driver's"
            )
        taken.append(_fullest(chosen, values))
    return {quantity: table[:, taken] for quantity, table in values.items()}


def _alike(columns: FloatArray) -> bool:
    """Whether all columns, shape (M, C), have the first one's numbers wherever both have one."""
    first = columns[:, 0]
    for other in columns.T[1:]:
        both = np.isfinite(first) & np.isfinite(other)
        if np.any(first[both] != other[both]):
            return False
    return True


def _changes(values: FloatArray) -> bool:
    known = values[np.isfinite(values)]
    return bool(len(known)) and float(np.ptp(known)) > 0.0


def _fullest(
    columns: Sequence[int],
    values: dict[str, FloatArray],
) -> int:
    """The column that has most numbers; the first of several."""

    def numbers(column: int) -> int:
        return sum(int(np.isfinite(table[:, column]).sum()) for table in values.values())

    return max(columns, key=numbers)


def _marked(values: FloatArray) -> FloatArray:
    return np.where(np.isfinite(values), values, np.inf)


def array_columns(
    bag: Bag,
    topic: Topic,
    means: InputTopic,
    joint_order: Sequence[str],
    recorded: Sequence[str],
    conventions: Conventions,
) -> JointColumns:
    """Columns of an array of what drives the joints, as the quantity ``effort``.

    A message means what it means to the driver: it drives the joints it names and holds the others; one without numbers
    ends the excitation. Numbers without labels are in the order of the robot's joints.

    Args:
        bag: Open.
        topic: Of the arrays.
        means: What its numbers are, and in which order.
        joint_order: The robot's joints that have a motor.
        recorded: Joints whose states were recorded.
        conventions: Of the driver that published.

    Returns:
        A column for each joint that any message drives, zero where it does not.

    Raises:
        RecordingError: Labels or lengths do not fit.
    """
    parts = bag.rows(topic)
    array = _Array(bag.path, topic, means, joint_order, recorded, conventions)
    notes = dict[str, None]()
    labelled = [array.joints_of(part.message, notes) for part in parts]
    names = tuple(dict.fromkeys(name for labels in labelled for name in labels))
    times_ns = np.concatenate([part.bag_ns for part in parts])
    values = np.zeros((len(times_ns), len(names)))
    row = 0
    for part, named in zip(parts, labelled, strict=True):
        if named:
            columns = [names.index(label) for label in named]
            values[row : row + len(part.bag_ns), columns] = _marked(part.values["data"])
        row += len(part.bag_ns)
    return JointColumns(
        times_ns,
        np.zeros_like(times_ns),
        names,
        {"effort": values},
        list(notes),
    )


@dataclass(frozen=True)
class _Array:
    """Arrays of a topic, and what may name their columns; as of `array_columns`."""

    path: Path
    topic: Topic
    means: InputTopic
    joint_order: Sequence[str]
    recorded: Sequence[str]
    conventions: Conventions

    def joints_of(
        self,
        message: Any,
        notes: dict[str, None],
    ) -> Sequence[str]:
        """The joints that a message drives, by its labels, its driver's profile, or else the robot's order, which is noted."""
        count = len(message.data)
        if not count:
            return ()
        return self._labels(message) or self._stated(count) or self._in_order(count, notes)

    def _labels(self, message: Any) -> tuple[str, ...]:
        """The robot's names of the columns; empty where nothing names them."""
        labels = self.conventions.renamed(labels_of(message))
        known = {*self.joint_order, *self.recorded}
        fitting = len(labels) == len(message.data)
        if not any(labels) or (not fitting and known.isdisjoint(labels)):
            # no labels, or some that describe the dimensions ("currents") and not the columns
            return ()
        if not fitting or len(set(labels)) != len(labels) or not all(labels):
            raise RecordingError(
                f"{self.topic.name} has {len(message.data)} values but is labelled {', '.join(labels)};"
                " layout.dim must name every joint once",
                self.path,
            )
        return labels

    def _stated(self, count: int) -> tuple[str, ...]:
        """The joints of the driver's controller, as its profile says; empty where it does not."""
        stated = self.conventions.renamed(self.means.joints)
        if stated and count != len(stated):
            raise RecordingError(
                f"{self.topic.name} has {count} values but --driver {self.conventions.driver} names "
                f"{len(stated)} joints ({', '.join(stated)}); state its controller's joints in a file of your own",
                self.path,
            )
        return stated

    def _in_order(
        self,
        count: int,
        notes: dict[str, None],
    ) -> tuple[str, ...]:
        """The robot's joints, or those of them that were recorded, whichever are as many as there are columns."""
        there = tuple(joint for joint in self.joint_order if joint in self.recorded)
        for joints in (tuple(self.joint_order), there):
            if count != len(joints):
                continue
            if len(joints) < len(self.joint_order) or self.means not in OUR_DRIVER.inputs:
                words = f"{self.topic.name} is unlabelled; it was read as the recorded joints {', '.join(joints)}."
                notes[words] = None
            return joints
        advice = "label the columns in layout.dim, or choose another input with --command-topic"
        driver = self.conventions.driver
        if driver:
            advice = f"state the joints of its controller in a --driver file of your own (extends: {driver})"
        raise RecordingError(
            f"{self.topic.name} has {count} values but the robot has {len(self.joint_order)} joints"
            f" ({', '.join(self.joint_order)}); {advice}",
            self.path,
        )
