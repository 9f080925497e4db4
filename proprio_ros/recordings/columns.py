"""Messages of a bag as columns by joint, under the robot's names."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from proprio_ros.errors import RecordingError
from proprio_ros.recordings.messages import labels_of
from proprio_ros.recordings.reader import Bag
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
    """Columns of a JointState topic; the first of the quantities (fields of the message) must be there in every message.

    Raises `RecordingError`: Names and values do not fit each other, or two joints would have one name.
    """
    rows = bag.rows(topic)
    named = [conventions.renamed(part.message.name) for part in rows]
    names = tuple(dict.fromkeys(name for part in named for name in part))
    theirs: dict[str, str] = {}
    for part, own in zip(rows, named, strict=True):
        for name, other in zip(own, part.message.name, strict=True):
            if theirs.setdefault(name, other) != other:
                raise RecordingError(
                    f"{bag.path}: {topic.name}: {theirs[name]} and {other} would both be {name}; state joint_names of --driver "
                    f"{conventions.driver} otherwise"
                )
    # a joint that a message names twice has a column for each time
    numbered = [_numbered(own) for own in named]
    keys = list(dict.fromkeys(key for own in numbered for key in own))
    index = {key: column for column, key in enumerate(keys)}
    bag_ns = np.concatenate([part.bag_ns for part in rows])
    values = {quantity: np.full((len(bag_ns), len(keys)), np.nan) for quantity in quantities}
    orders = set()
    row = 0
    for part, own_keys in zip(rows, numbered, strict=True):
        columns = [index[key] for key in own_keys]
        orders.add(tuple(columns))
        for quantity in quantities:
            length = (data := part.values[quantity]).shape[1]
            if length != len(columns) and (length or quantity == quantities[0]):
                raise RecordingError(
                    f"{bag.path}: {topic.name} has {len(columns)} names but {length} values of {quantity} in message"
                    f" {row + 1}; every joint needs one"
                )
            if length:
                values[quantity][row : row + len(data), columns] = _marked(data)
        row += len(part.bag_ns)
    notes = []
    if len({frozenset(order) for order in orders}) < len(orders):
        notes.append(
            f"{topic.name}: the order of the joints changes between messages; they were matched by name."
        )
    if len(keys) > len(names):
        values = _named_once(f"{bag.path}: {topic.name}", keys, names, values, quantities[0])
        notes.append(
            f"{topic.name}: messages name joints twice; the numbers that change along the recording were kept."
        )
    for quantity in {"position", "velocity"} & values.keys():
        values[quantity] *= conventions.radians
    return JointColumns(
        bag_ns, np.concatenate([part.stamp_ns for part in rows]), names, values, notes
    )


_Key = tuple[str, int]
"""A joint, and how often the message named it before."""


def _numbered(names: Sequence[str]) -> list[_Key]:
    return [(name, names[:place].count(name)) for place, name in enumerate(names)]


def _named_once(
    where: str,
    keys: Sequence[_Key],
    names: Sequence[str],
    values: dict[str, FloatArray],
    decides: str,
) -> dict[str, FloatArray]:
    """One column a joint, of those that messages name twice.

    Args:
        where: Bag and topic.
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
        first = values[decides][:, chosen[0]]
        for other in chosen[1:]:
            both = np.isfinite(first) & np.isfinite(values[decides][:, other])
            if np.any(first[both] != values[decides][both, other]):
                raise RecordingError(
                    f"{where} names {name} twice in a message, with different numbers: two publishers were put into one list, and "
                    "nobody knows which one is the driver's"
                )
        taken.append(_fullest(chosen, values))
    return {quantity: table[:, taken] for quantity, table in values.items()}


def _changes(values: FloatArray) -> bool:
    known = values[np.isfinite(values)]
    return bool(len(known)) and float(np.ptp(known)) > 0.0


def _fullest(columns: Sequence[int], values: dict[str, FloatArray]) -> int:
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
    ends the excitation. Numbers without labels are in the order of the robot's joints. Raises `RecordingError`: Labels
    or lengths do not fit.
    """
    parts = bag.rows(topic)
    notes = dict[str, None]()
    stated = conventions.renamed(means.joints)
    labelled = list[Sequence[str]]()
    for part in parts:
        count = len(part.message.data)
        if not count:
            labelled.append(())
            continue
        labels = _labels(bag, topic, part.message, {*joint_order, *recorded}, conventions)
        if labels is None and stated:
            if count != len(stated):
                raise RecordingError(
                    f"{bag.path}: {topic.name} has {count} values but --driver {conventions.driver} names "
                    f"{len(stated)} joints ({', '.join(stated)}); state its controller's joints in a file of your own"
                )
            labels = stated
        if labels is None:
            there = tuple(joint for joint in joint_order if joint in recorded)
            labels = next(
                (order for order in (tuple(joint_order), there) if count == len(order)), None
            )
            if labels is None:
                advice = (
                    "label the columns in layout.dim, or choose another input with --command-topic"
                )
                if conventions.driver:
                    advice = f"state the joints of its controller in a --driver file of your own (extends: {conventions.driver})"
                raise RecordingError(
                    f"{bag.path}: {topic.name} has {count} values but the robot has {len(joint_order)} joints"
                    f" ({', '.join(joint_order)}); {advice}"
                )
            if len(labels) < len(joint_order) or means not in OUR_DRIVER.inputs:
                notes[
                    f"{topic.name} is unlabelled; it was read as the recorded joints {', '.join(labels)}."
                ] = None
        labelled.append(labels)
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


def _labels(
    bag: Bag, topic: Topic, message: Any, known: set[str], conventions: Conventions
) -> tuple[str, ...] | None:
    """The robot's names of an array's columns; None where nothing names them."""
    labels = conventions.renamed(labels_of(message))
    if not any(labels) or (len(labels) != len(message.data) and known.isdisjoint(labels)):
        # no labels, or some that describe the dimensions ("currents") and not the columns
        return None
    if len(labels) != len(message.data) or len(set(labels)) != len(labels) or not all(labels):
        raise RecordingError(
            f"{bag.path}: {topic.name} has {len(message.data)} values but is labelled {', '.join(labels)};"
            " layout.dim must name every joint once"
        )
    return labels
