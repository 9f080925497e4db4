"""Joint states of which more than one node publishes: what the arm's own driver says is kept, and the rest is left out with a note.

A `joint_state_publisher` sends zeros, a bridge repeats what it heard, a gripper's driver names the arm's joints, too. They are told
from the driver by what only they do: they carry no effort where the driver does, jump to one and the same position between samples
that follow each other smoothly, or go back to what was published before. Where two publishers both move, and differ, nobody
knows which one is right.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from proprio_ros.recordings.columns import JointColumns
from proprio_ros.recordings.noted import Noted
from proprio_ros.records import BoolArray, FloatArray

FEWEST = 10
"""Fewer messages than this are a fault of one publisher, not another one."""
EFFORT_SHARE = 0.3
"""Where this share of a joint's messages has efforts, those without are of somebody else."""
JUMP_RAD, JUMP_TIMES = 0.01, 3.0
"""Between two samples, one that is further off than this and so many times what they are apart does not belong to them."""
MOST = 0.9
"""Of the messages with a position that comes again and again, those that do not belong between their neighbours."""
BACK = 0.8
"""Of the messages that repeat an earlier one while the arm moves, those that go back on its way."""
TWO_SHARE = 0.1
"""Of the messages, those that jump there and back, above which two publishers contradict each other."""
MOVES_RAD = 1e-4
CLEAR_STEPS, CLEAR_ROWS = 1.5, 4
"""An arm that goes so many steps of its reading within so many messages moves, and does not flicker between two of them."""
LARGEST = 50.0
"""Positions beyond are in no unit of an angle, and refused for that [rad]."""


@dataclass(frozen=True)
class _Track:
    """Positions of one joint in the order in which they were recorded."""

    rows: np.ndarray  # messages that have it, shape (N,)
    position: FloatArray  # shape (N,)


def of_one_publisher(noted: Noted, columns: JointColumns) -> JointColumns:
    """The same without what other publishers than the arm's driver say.

    Args:
        noted: Bag and topic.
        columns: Of all messages, in the order of recording.

    Raises:
        RecordingError: Two publishers move a joint, and differ.
    """
    position = columns.values["position"].copy()
    left_out = np.zeros(position.shape, dtype=bool)
    notes = list(columns.notes)

    def leave_out(found: BoolArray, what: str) -> None:
        """Leave out numbers of joints, shape (M, J)."""
        if not found.any():
            return
        position[found] = np.nan
        left_out[found] = True
        messages = int(found.any(axis=1).sum())
        notes.append(
            f"{noted.topic}: {messages} of {len(found)} messages are of a second publisher: {what}; they were left out"
        )

    leave_out(_without_effort(columns.values), "they carry no effort, where the others do")
    leave_out(_at_one_place(position), "positions jump to one and the same place and back")
    leave_out(_twice(columns, position), "they repeat another one, stamp and all")
    leave_out(_repeated(position), "they are copies of what was published before")
    _refuse_contradiction(noted, columns.names, position)
    if len(notes) == len(columns.notes):
        return columns
    was_given = np.isfinite(columns.values["position"]).any(axis=1)
    kept = np.isfinite(position).any(axis=1) | ~was_given
    return JointColumns(
        columns.bag_ns[kept],
        columns.stamp_ns[kept],
        columns.names,
        {name: np.where(left_out, np.nan, table)[kept] for name, table in columns.values.items()},
        notes,
    )


def _without_effort(values: dict[str, FloatArray]) -> BoolArray:
    """Positions without an effort, of joints that mostly have one, shape (M, J)."""
    given = np.isfinite(values["position"])
    effort = values.get(
        "effort",
        np.full(given.shape, np.nan),
    )
    # NaN: not in the message; inf: in it, but not a number
    missing = given & np.isnan(effort)
    with_effort = (given & ~missing).sum(axis=0)
    mostly = with_effort >= np.maximum(EFFORT_SHARE * given.sum(axis=0), 1.0)
    often = missing.sum(axis=0) >= FEWEST
    return missing & mostly & often


def _tracks(position: FloatArray) -> list[_Track]:
    rows = [np.flatnonzero(np.isfinite(column)) for column in position.T]
    return [_Track(each, column[each]) for each, column in zip(rows, position.T, strict=True)]


def _at_one_place(position: FloatArray) -> BoolArray:
    """Positions of a publisher that says one and the same all the time, between others that move, shape (M, J)."""
    usual = np.full(position.shape[1], np.nan)
    foreign = np.zeros(position.shape, dtype=bool)
    for column, track in enumerate(_tracks(position)):
        places, counts = np.unique(track.position, return_counts=True)
        if not len(places) or counts.max() < FEWEST:
            continue
        usual[column] = places[counts.argmax()]
        there = track.position == usual[column]
        others = np.flatnonzero(~there)
        if len(others) < FEWEST:
            continue
        # the others before and after each of them
        after = np.searchsorted(others, np.flatnonzero(there))
        inner = (after > 0) & (after < len(others))
        before = track.position[others[after[inner] - 1]]
        behind = track.position[others[after[inner]]]
        allowed = JUMP_TIMES * np.abs(behind - before) + JUMP_RAD
        off = np.abs(usual[column] - before) > allowed
        visits = len(np.unique(after[inner]))
        if visits >= FEWEST and off.mean() > MOST:
            foreign[track.rows[there], column] = True
    # joints that hardly move say nothing; their messages do
    rows = np.asarray(foreign.any(axis=1))
    return foreign | (rows[:, None] & (position == usual))


def _twice(columns: JointColumns, position: FloatArray) -> BoolArray:
    """Messages that have stamp and positions of an earlier one, shape (M, J)."""
    stamped = columns.stamp_ns != 0
    rows = np.column_stack(
        [
            columns.stamp_ns.astype(np.float64),
            position,
        ]
    )
    # NaN differs from itself
    _, first = np.unique(
        np.nan_to_num(rows, nan=np.inf),
        axis=0,
        return_index=True,
    )
    again = np.ones(len(rows), dtype=bool)
    again[first] = False
    again &= stamped
    # messages that are stamped as they arrive share stamps, and where the arm stands positions, too
    _, shared = np.unique(columns.stamp_ns[stamped], return_counts=True)
    others = int(np.sum(shared - 1)) - int(again.sum())
    if again.sum() < max(FEWEST, others):
        again[:] = False
    found: BoolArray = again[:, None] & np.isfinite(position)
    return found


def _repeated(position: FloatArray) -> BoolArray:
    """Messages that repeat an earlier one while the arm has moved on, shape (M, J)."""
    given = np.isfinite(position)
    found = np.zeros(position.shape, dtype=bool)
    for pattern in np.unique(given, axis=0):
        shared = np.flatnonzero(pattern)
        rows = np.flatnonzero(given[:, shared].all(axis=1))
        if len(shared) and len(rows) >= FEWEST:
            copies = rows[_copies(position[np.ix_(rows, shared)])]
            found[np.ix_(copies, shared)] = True
    return found & given


def _copies(position: FloatArray) -> np.ndarray:
    """Numbers of those messages, of some with the same joints, shape (M, K)."""
    none = np.empty(0, dtype=np.int64)
    _, first, which = np.unique(
        position,
        axis=0,
        return_index=True,
        return_inverse=True,
    )
    first = first[which.ravel()]
    again = np.asarray(first < np.arange(len(position)))
    own = np.flatnonzero(~again)
    repeated = np.flatnonzero(again)
    after = np.searchsorted(own, repeated)
    inner = after < len(own)
    repeated = repeated[inner]
    # the first message repeats none, so that one of its own stands before each
    before = position[own[after[inner] - 1]]
    step_of_others = position[own[after[inner]]] - before
    moved = np.abs(step_of_others).max(axis=1, initial=0.0)
    # of a motion that repeats itself to the last digit a sample lies between its neighbours, a copy lies behind both
    back = ((position[repeated] - before) * step_of_others).sum(axis=1) < 0.0
    # where the arm stands, a coarse reading comes again by chance
    next_to_each_other = own[after[inner]] - own[after[inner] - 1] <= CLEAR_ROWS
    clearly = next_to_each_other & (moved > CLEAR_STEPS * _step_rad(position))
    moves = moved > MOVES_RAD
    if not (_mostly(back[moves]) or _mostly(back[moves & clearly])):
        return none
    # where the arm stands, too: the next one is no worse
    elsewhere = np.asarray((position[repeated] != before).any(axis=1))
    return repeated[elsewhere]


def _mostly(back: BoolArray) -> bool:
    """Whether messages that repeat earlier ones go back on the arm's way, shape (K,), and are enough to say so."""
    return len(back) >= FEWEST and float(back.mean()) >= BACK


def _step_rad(position: FloatArray) -> float:
    """The smallest difference between two readings of a joint, shape (M, K)."""
    steps = [np.diff(np.unique(column)).min(initial=np.inf) for column in position.T]
    return float(min(steps, default=np.inf))


def _refuse_contradiction(
    noted: Noted,
    names: Sequence[str],
    position: FloatArray,
) -> None:
    """Raises: RecordingError: one joint is at two places at once."""
    for name, track in zip(names, _tracks(position), strict=True):
        place = track.position
        if len(place) < FEWEST or np.abs(place).max() > LARGEST:
            continue
        off = np.minimum(
            np.abs(place[1:-1] - place[:-2]),
            np.abs(place[1:-1] - place[2:]),
        )
        apart = np.abs(place[2:] - place[:-2])
        jumps = off > JUMP_TIMES * apart + JUMP_RAD
        if jumps.sum() >= FEWEST and jumps.mean() > TWO_SHARE:
            share = f"{100.0 * jumps.mean():.0f} % of the messages"
            raise noted.error(
                f": {name} is at two places at once, {np.median(off[jumps]):.2g} rad or m apart, in {share}: two publishers "
                "share the topic: end the one that is not the arm's driver, or rename its topic"
            )
