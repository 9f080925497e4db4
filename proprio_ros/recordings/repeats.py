"""Joint states that only repeat the one before, as a broadcaster publishes them that is faster than the hardware is read."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from proprio_ros.records import MIN_SAMPLES, BoolArray, FloatArray, JointRecord

REPEATED_SHARE = 0.2
"""Of the joint states may repeat the one before while a joint moves, before it is taken for a publisher's doing."""


def repeated(
    record: JointRecord,
    inside: BoolArray,
    columns: Sequence[int],
) -> BoolArray:
    """Rows that only repeat the row before.

    A joint that moves slowly repeats its position, too, from one count of its encoder to the next. So repeats count only where a
    joint goes in larger steps than that, and where there are many: else none is marked.

    Args:
        record: Joint states, T of them.
        inside: Which are asked, shape (T,).
        columns: Of the joints that move.

    Returns: Which repeat, shape (T,).
    """
    tables = [
        record.position,
        *(table for table in (record.velocity, record.reported_effort) if table is not None),
    ]
    alike = _alike(np.concatenate(tables, axis=1)) & inside
    fresh = np.flatnonzero(inside & ~alike)
    none = np.zeros(len(alike), dtype=bool)
    if len(fresh) < MIN_SAMPLES or not alike.any():
        return none
    large = np.zeros(len(fresh) - 1, dtype=bool)
    for column in columns:
        position = record.position[:, column]
        steps = np.abs(np.diff(position))
        if steps.any():
            count = float(steps[steps > 0.0].min())
            large |= np.abs(np.diff(position[fresh])) > 2.0 * count
    # between two fresh rows that are a large step apart nothing should be alike
    between = np.diff(fresh) - 1
    passed = int(between[large].sum())
    return alike if passed > REPEATED_SHARE * (passed + int(large.sum())) else none


def _alike(rows: FloatArray) -> BoolArray:
    """Which rows of numbers, shape (T, N), are those of the row before, shape (T,)."""
    alike = np.zeros(len(rows), dtype=bool)
    unknown = np.isnan(rows)
    same = (rows[1:] == rows[:-1]) | (unknown[1:] & unknown[:-1])
    alike[1:] = np.all(same, axis=1)
    return alike
