"""In which unit the times of a table are: as is stated, or as only one of them can be."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from proprio_ros.errors import RecordingError
from proprio_ros.recordings.pace import rate_by_velocities
from proprio_ros.recordings.state_rows import LONGEST_PERIOD_S, SHORTEST_PERIOD_S
from proprio_ros.recordings.tables import PER_UNIT
from proprio_ros.records import FloatArray

IN_SECONDS = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}
"""How many of a unit make a second."""
EARLIEST_S, LATEST_S = 10**9, 4 * 10**9
"""Seconds since 1970 of 2001 and of 2096: a clock that shows the date stands between, and none stands later."""
NEAR = 2.0  # a rate by velocities is that of a unit within this factor; units are 1000 apart
LONGEST_S = 8e9  # no time is past that, whose nanoseconds are counted in 64 bits


def unit_shown(
    ticks: Sequence[int], position: FloatArray, velocity: FloatArray, called: str, path: Path
) -> tuple[str, str]:
    """The unit that times must be in, where nobody says it.

    Args:
        ticks: Times in billionths of their unit, at least two, shape (T,).
        position: Of the joints at these times [rad], shape (T, J).
        velocity: The same [rad/s], NaN where there is none.
        called: Header of the times.
        path: Of the table.

    Returns:
        The unit, and a sentence on why.

    Raises:
        RecordingError: They are row numbers, or several units are possible, or none.
    """
    steps = [after - before for before, after in pairwise(ticks)]
    period = float(np.median([float(step) for step in steps])) / PER_UNIT
    ask = f"state it: {called} [s] or {called} [ms] in the header, or time_unit in columns.yaml"
    if all(step == PER_UNIT for step in steps):
        raise RecordingError(_counted(called), path)
    first = abs(ticks[0]) / PER_UNIT
    possible = [
        unit
        for unit, parts in IN_SECONDS.items()
        if SHORTEST_PERIOD_S < period / parts < LONGEST_PERIOD_S and first / parts < LATEST_S
    ]
    if len(possible) == 1:
        unit = possible[0]
        every_s = period / IN_SECONDS[unit]
        why = f"its rows are {period:.4g} apart, so that there are {1.0 / every_s:.4g} in a second"
        return (
            unit,
            f"{called} was read in {unit}: {why}, and no other unit gives a rate that a robot is logged at.",
        )
    rate_Hz = rate_by_velocities(position, velocity)
    near = [
        unit
        for unit in possible
        if rate_Hz and 1.0 / NEAR < period * rate_Hz / IN_SECONDS[unit] < NEAR
    ]
    if len(near) == 1:
        return near[
            0
        ], f"{called} was read in {near[0]}, as velocities show: {rate_Hz:.4g} rows in a second."
    what = f"in {' or '.join(possible)}?" if possible else "which no unit of time explains:"
    raise RecordingError(f"rows of {called} are {period:.4g} apart, {what} {ask}", path)


def in_ns(ticks: Sequence[int], unit: str, called: str, path: Path) -> list[int]:
    """Times [ns], since 1970 where they are dates, and else so that the first is at 1 s: 0 stands for a time that is not known.

    Args:
        ticks: In billionths of their unit.
        unit: One of `IN_SECONDS`.
        called: Header of the times.
        path: Of the table.

    Raises:
        RecordingError: They are longer than any clock counts, or too far apart.
    """
    parts = IN_SECONDS[unit]
    times_ns = [(2 * tick + parts) // (2 * parts) for tick in ticks]
    largest_s = max(map(abs, times_ns)) / PER_UNIT
    if largest_s > LONGEST_S:
        raise RecordingError(
            f"{called} reaches {largest_s:.3g} s, if it is in {unit}: is it?", path
        )
    _refuse_slow(times_ns, unit, called, path)
    first_ns = min(times_ns)
    if first_ns > EARLIEST_S * PER_UNIT:
        return times_ns
    return [time_ns - first_ns + PER_UNIT for time_ns in times_ns]


def _refuse_slow(times_ns: Sequence[int], unit: str, called: str, path: Path) -> None:
    """Raises `RecordingError`: They are row numbers, or no robot is logged so seldom."""
    steps = [after - before for before, after in pairwise(times_ns)]
    if unit == "s" and steps and all(step == PER_UNIT for step in steps):
        raise RecordingError(_counted(called), path)
    if steps and float(np.median(steps)) > LONGEST_PERIOD_S * PER_UNIT:
        apart = f"{float(np.median(steps)) / PER_UNIT:.4g} s apart, if it is in {unit}"
        raise RecordingError(f"rows of {called} are {apart}: state its unit, as t [ms]", path)


def _counted(called: str) -> str:
    return f"{called} holds row numbers (0, 1, 2 ..), and no times; if these are ms, call it t [ms]"
