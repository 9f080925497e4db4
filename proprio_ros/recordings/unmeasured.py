"""Efforts that were published but not measured: they stand still while their joint moves, drop out, or are no torque at all.

A driver goes on publishing after its controller was switched, after a bus was lost, or between two readings: the last value, zeros,
or NaN, which are treated alike. What was not measured becomes NaN, for the joint and the time that it concerns.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from proprio_ros.quantity import MAD_TO_STD
from proprio_ros.recordings.medians import running_median
from proprio_ros.records import BoolArray, FloatArray, TimeArray

DENORMAL = 1e-30
"""No current is smaller than this and not zero: such numbers are memory that nobody wrote."""
IMPOSSIBLE = 1e6
"""No arm's motor has more ampere, in no unit that a driver uses: such numbers are damaged."""
STANDS_S = 0.5
"""An effort that is the same number for longer, while its joint moves, was not measured [s]."""
USUAL_TIMES = 5.0
"""And for so many times longer than it usually is: a coarse reading, or one that is read seldom, repeats itself."""
FEWEST_VALUES = 8
"""An effort that takes fewer values may well stay at one of them."""
TURNED_RAD = 0.05
"""A joint that turns by less may need the same torque all the time [rad]."""
TURNS_RAD, TURNS_WITHIN_S = 0.01, 0.5
"""A joint turns at a sample if it turns by so much within so long around it [rad, s]."""
NEIGHBOURS = 7
"""Samples whose median an outlier is compared with: up to three in a row are outliers, more are a step."""
OUTLIER_SIGMAS, OUTLIER_SHARE = 20.0, 0.3
"""An outlier is further from that median than so many times what samples usually are, and this share of what the effort spans.
Smaller ones hardly change the mean of half a second."""
ZERO_TIMES = 5
"""Zeros that are so many times more frequent than any other value are no readings, where those around them are far from zero."""
ZERO_SHARE = 0.25
"""Far from zero: by this share of the effort's root mean square. A dead band that is smaller changes little."""


@dataclass(frozen=True)
class Measured:
    """Efforts of joints as far as they were measured."""

    current_A: FloatArray  # NaN where not measured, shape (T, J)
    notes: tuple[str, ...]  # what was left out, one sentence each


@dataclass(frozen=True)
class _Stretch:
    """From one row to before another, and the joints whose effort was not measured there."""

    first: int
    end: int
    joints: tuple[str, ...]


def measured_only(
    joints: Sequence[str], times_s: FloatArray, position: FloatArray, current_A: FloatArray
) -> Measured:
    """What of the efforts was measured.

    Args:
        joints: Names, J.
        times_s: Of the samples [s], strictly increasing, shape (T,).
        position: Of the joints [rad], shape (T, J).
        current_A: As published, in whatever unit, shape (T, J); NaN where a message gave none.
    """
    size = np.abs(current_A)
    current = np.where(size < DENORMAL, 0.0, current_A)
    current = np.where(size < IMPOSSIBLE, current, np.nan)
    period_s = float(np.median(np.diff(times_s)))
    alone = size >= IMPOSSIBLE
    for column in range(len(joints)):
        alone[:, column] |= _outliers(current[:, column])
    current[alone] = np.nan
    stretches = _stretches(joints, times_s, position, current)
    for stretch in stretches:
        columns = [joints.index(name) for name in stretch.joints]
        current[stretch.first : stretch.end, columns] = np.nan
        alone[stretch.first : stretch.end, columns] = False
    for column in range(len(joints)):
        missed = _drop_outs(current[:, column]) & _turning(position[:, column], period_s)
        alone[missed, column] = True
    current[alone] = np.nan
    return Measured(
        current, (*_of_stretches(joints, times_s, stretches), *_of_samples(joints, alone))
    )


def _stretches(
    joints: Sequence[str], times_s: FloatArray, position: FloatArray, current: FloatArray
) -> list[_Stretch]:
    """All in which an effort stands still or is missing while a joint turns, in the order of time."""
    found = dict[tuple[int, int], list[str]]()
    for rows in _standing(times_s, position, current):
        found[rows] = list(joints)
    for column, name in enumerate(joints):
        alone = [column]
        for rows in _standing(times_s, position[:, alone], current[:, alone]):
            names = found.setdefault(rows, [])
            if name not in names:
                names.append(name)
    return [_Stretch(*rows, tuple(found[rows])) for rows in sorted(found)]


def _turning(position: FloatArray, period_s: float) -> BoolArray:
    """Whether a joint turns, shape (T,)."""
    from scipy.ndimage import maximum_filter1d, minimum_filter1d

    width = max(3, round(TURNS_WITHIN_S / period_s))
    span = maximum_filter1d(position, width) - minimum_filter1d(position, width)
    turning: BoolArray = span > TURNS_RAD
    return turning


def _outliers(effort: FloatArray) -> BoolArray:
    """Samples far from those around them, shape (T,)."""
    found = np.zeros(len(effort), dtype=bool)
    known = np.flatnonzero(np.isfinite(effort))
    if len(known) < NEIGHBOURS:
        return found
    values = effort[known]
    away = np.abs(values - running_median(values, NEIGHBOURS, "reflect"))
    low, high = np.percentile(values, [5.0, 95.0])
    usual = MAD_TO_STD * float(np.median(away))
    steps = np.abs(np.diff(values))
    # a count, where it is coarse
    step = float(np.median(steps[steps > 0.0])) if steps.any() else 0.0
    found[known] = away > OUTLIER_SIGMAS * usual + OUTLIER_SHARE * (high - low) + 2.0 * step
    return found


def _drop_outs(effort: FloatArray) -> BoolArray:
    """Zeros among readings that are not near zero, shape (T,)."""
    zero = effort == 0.0
    other = np.isfinite(effort) & ~zero
    if not zero.any() or not other.any():
        return np.zeros(len(effort), dtype=bool)
    _, counts = np.unique(effort[other], return_counts=True)
    if zero.sum() <= ZERO_TIMES * counts.max():
        return np.zeros(len(effort), dtype=bool)
    # the reading before each stretch of zeros
    rows = np.flatnonzero(other)
    begins = np.flatnonzero(zero & ~np.concatenate([[True], zero[:-1]]))
    before = rows[np.searchsorted(rows, begins) - 1]
    typical = float(np.sqrt(np.mean(np.square(effort[other]))))
    near = np.abs(effort[before])
    if not len(begins) or float(np.median(near)) < ZERO_SHARE * typical:
        return np.zeros(len(effort), dtype=bool)
    return zero


def _standing(
    times_s: FloatArray, position: FloatArray, effort: FloatArray
) -> Iterator[tuple[int, int]]:
    """First row and end of stretches in which efforts are one number each, or none, while a joint turns.

    ``times_s``: of the samples [s], shape (T,); ``position``: of some joints [rad], ``effort``: of the same, shape (T, K) each.
    """
    known = np.isfinite(effort)
    both = known[1:] & known[:-1]
    same = effort[1:] == effort[:-1]
    alike = np.where(both, same, known[1:] == known[:-1]).all(axis=1)
    starts = np.flatnonzero(np.concatenate([[True], ~alike]))
    ends = np.append(starts[1:], len(effort))
    lasts = ends - starts  # [samples]
    distinct = max(len(np.unique(column[np.isfinite(column)])) for column in effort.T)
    for stretch in np.argsort(-lasts, kind="stable"):
        first = int(starts[stretch])
        end = int(ends[stretch])
        if times_s[end - 1] - times_s[first] < STANDS_S:
            return
        if len(lasts) > 1 and distinct < FEWEST_VALUES:
            return
        # those as long as this one are looked at for themselves
        usual = _usual_length(lasts[lasts < lasts[stretch]])
        long_enough = lasts[stretch] >= USUAL_TIMES * usual
        if long_enough and np.ptp(position[first:end], axis=0).max() > TURNED_RAD:
            yield first, end


def _usual_length(lengths: TimeArray) -> float:
    """Of the stretch that a sample usually lies in, by the lengths of all of them [samples]; 1 where there is none."""
    if not len(lengths):
        return 1.0
    by_sample = np.repeat(lengths, lengths)
    return float(np.median(by_sample))


def _of_stretches(
    joints: Sequence[str], times_s: FloatArray, stretches: Sequence[_Stretch]
) -> Iterator[str]:
    by_time = dict[str, list[str]]()
    for stretch in stretches:
        since_s = times_s[stretch.first] - times_s[0]
        until_s = times_s[stretch.end - 1] - times_s[0]
        if stretch.end < len(times_s):
            when = f"from {since_s:.1f} to {until_s:.1f} s"
        elif stretch.first > 0:
            when = f"from {since_s:.1f} s on"
        else:
            when = "in the whole recording"
        by_time.setdefault(when, []).extend(stretch.joints)
    for when, names in by_time.items():
        which = _named(joints, list(dict.fromkeys(names)))
        yield (
            f"effort of {which} stands still or is missing {when} while joints move: nobody measured it, and it was left out"
        )


def _of_samples(
    joints: Sequence[str],
    alone: BoolArray,
) -> Iterator[str]:
    counts = alone.sum(axis=0)
    if counts.any():
        names = [name for name, count in zip(joints, counts, strict=True) if count]
        yield (
            f"effort of {_named(joints, names)}: {int(counts.sum())} single samples are 0 or far from those around them; they "
            "were left out"
        )


def _named(
    joints: Sequence[str],
    names: Sequence[str],
) -> str:
    return "all joints" if len(names) == len(joints) > 1 else ", ".join(names)
