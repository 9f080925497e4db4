"""Times at which samples arrived, where these come in bursts: when each was taken follows from the steady rate of all.

A network, a bus or an adapter that hands on several messages at once makes those that are stamped as they arrive come in bursts:
nearly equal times, then a gap. A sample never arrives before it is taken, and the last of a burst waits least.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from proprio_ros.quantity import MAD_TO_STD
from proprio_ros.records import BoolArray, FloatArray, TimeArray

SHORT = 0.25
"""Of the mean interval: shorter ones are within a burst. Of samples that come by chance 0.22 of the intervals are as short."""
BURSTS_SHARE = 0.4  # of the intervals that are as short, above which samples come in bursts
NEAR = 101  # intervals over which that is looked at
PAUSE_S = 1.5  # between two bursts lies less
STEADY = 0.25
"""By this share the rates of bursts may scatter about that of all (standard deviation), or nobody knows when samples were."""
FEWEST = 20


@dataclass(frozen=True)
class Arrivals:
    """Times of samples that came in bursts."""

    times_ns: TimeArray  # when each was taken, strictly increasing, shape (T,)
    moved: int  # how many of them came in bursts
    period_s: float  # between two of these
    steady: bool  # whether their rate is certain


def of_bursts(times_ns: TimeArray) -> Arrivals | None:
    """When samples were taken that arrived in bursts.

    Args:
        times_ns: When they arrived, in their order [ns], shape (T,); several may be the same.

    Returns: None where they do not come in bursts.
    """
    if len(times_ns) < FEWEST:
        return None
    intervals = 1e-9 * np.diff(times_ns).astype(np.float64)
    pauses = intervals > PAUSE_S
    lasted_s = float(intervals[~pauses].sum())
    mean_s = lasted_s / max(int((~pauses).sum()), 1)
    short = intervals < SHORT * mean_s
    if not _in_bursts(short).any():
        return None
    taken = times_ns.astype(np.int64).copy()
    rates: list[FloatArray] = []
    moved = 0
    bounds = [
        0,
        *(np.flatnonzero(pauses) + 1),
        len(times_ns),
    ]
    for begin, end in pairwise(bounds):
        part = _of_part(
            times_ns[begin:end],
            short[begin : end - 1],
        )
        if part is not None:
            taken[begin:end] = part[0]
            rates.append(part[1])
            moved += part[2]
    if not moved:
        return None
    each_s = np.concatenate(rates)
    middle_s = float(np.median(each_s))
    scatter = MAD_TO_STD * float(np.median(np.abs(each_s - middle_s))) / middle_s
    increasing = bool(np.all(np.diff(taken) > 0))
    return Arrivals(taken, moved, middle_s, scatter < STEADY and increasing)


def _in_bursts(short: BoolArray) -> BoolArray:
    """Near which of the intervals many are short, shape (T - 1,)."""
    width = min(NEAR, len(short))
    share = np.convolve(short, np.ones(width) / width, "same")
    edge = width // 2
    # at the ends fewer are looked at
    if len(short) > 2 * edge > 0:
        share[:edge] = share[edge]
        share[-edge:] = share[-edge - 1]
    within = (share > BURSTS_SHARE).astype(np.float64)
    # bursts at the edges have others on one side alone
    return np.asarray(np.convolve(within, np.ones(width), "same") > 0.5)


def _of_part(
    times_ns: TimeArray,
    short: BoolArray,
) -> tuple[TimeArray, FloatArray, int] | None:
    """Of samples without a pause: when they were taken; the mean interval of each burst [s]; and how many came in bursts."""
    if len(times_ns) < FEWEST:
        return None
    lasts = np.append(
        np.flatnonzero(~short),
        len(times_ns) - 1,
    )
    counts = np.diff(lasts, prepend=-1)
    since = times_ns - times_ns[0]
    ends_s = 1e-9 * since[lasts].astype(np.float64)
    in_bursts = np.append(_in_bursts(short), False)
    of_burst = in_bursts[np.maximum(lasts - 1, 0)] & (counts > 0)
    of_burst[0] = False  # when the first burst began nobody knows
    if of_burst.sum() < 3:
        return None
    sizes = counts[of_burst]
    each_s = np.diff(ends_s, prepend=0.0)[of_burst] / sizes
    period_s = float(np.sum(each_s * sizes) / np.sum(sizes))
    if of_burst[1:].all():
        line = _on_a_line(lasts, ends_s, period_s, len(times_ns))
        if line is not None:
            return times_ns[0] + line, each_s, len(times_ns)
    taken = since.copy()
    moved = 0
    for number in np.flatnonzero(of_burst):
        rows = np.arange(
            lasts[number] - counts[number] + 1,
            lasts[number] + 1,
        )
        begin_s = ends_s[number - 1]
        each = (ends_s[number] - begin_s) / counts[number]
        if number == len(lasts) - 1:  # that one ends with the recording, before its time
            each = min(each, period_s)
        at_s = begin_s + each * (rows - rows[0] + 1)
        taken[rows] = np.rint(1e9 * at_s).astype(np.int64)
        moved += len(rows)
    first = np.arange(lasts[0] + 1)
    if counts[0] > 1:
        at_s = ends_s[0] - period_s * (lasts[0] - first)
        taken[first] = np.rint(1e9 * at_s).astype(np.int64)
    return times_ns[0] + taken, each_s, moved


def _on_a_line(
    lasts: TimeArray, ends_s: FloatArray, period_s: float, count: int
) -> TimeArray | None:
    """Times [ns] of samples that were taken at one rate, shape (T,), by the last of each burst; None where it changes."""
    if len(lasts) <= 4:
        return None
    slope, offset = np.polyfit(
        lasts[:-1],
        ends_s[:-1],
        1,
    )
    late_s = ends_s[:-1] - offset - slope * lasts[:-1]
    if np.ptp(late_s) > 3.0 * period_s:
        return None
    # none arrives before it is taken
    taken_s = offset + float(late_s.min()) + slope * np.arange(count)
    return np.asarray(
        np.rint(1e9 * taken_s),
        dtype=np.int64,
    )
