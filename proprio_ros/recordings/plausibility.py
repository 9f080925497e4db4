"""What a recording shows of itself, before any fit: what moves, what is held, and what its publisher did to velocities and efforts.

Only what was recorded is looked at; where the robot's URDF says what torque holds the arm, the effort is compared with that.
Nothing here is fitted on: every finding is a sentence with its numbers, and what to do about it is left to the user.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field

import numpy as np

from proprio_ros.errors import some
from proprio_ros.recordings.motions import MOVED_RAD
from proprio_ros.recordings.pace import Pace, pace_by_velocities
from proprio_ros.records import ZERO_CURRENT_A, FloatArray, JointRecord, Recording

MOVED_M = 0.002  # a slide that moves less stands still [m]
LONGEST_LAG_S = 0.15  # of a velocity behind its position; filters of servos take less [s]
LAG_S = 0.015
"""What a lag must reach to be said [s]; a velocity computed from the last two positions lags by half a period."""
SURE_CORRELATION = 0.9
FEW_LEVELS = 5
"""An effort that takes fewer values than this between zeros is a sequence of excitations, and no old reading."""
STALE_SAMPLES = 4  # equal efforts in a row, typically, while the joint moves


@dataclass(frozen=True)
class Finding:
    """One thing that a reader should know."""

    code: str  # what it is, for programs
    sentence: str  # the same for people
    joints: tuple[str, ...] = ()  # that it is about
    # its numbers by joint, in the unit that the sentence names
    values: Mapping[str, float] = field(default_factory=dict)
    as_json = asdict


def moving(
    record: JointRecord,
    slides: Sequence[str] = (),
) -> tuple[str, ...]:
    """The joints that do not stand still."""
    spans = np.ptp(record.position, axis=0)
    least = [MOVED_M if name in slides else MOVED_RAD for name in record.names]
    return tuple(
        name for name, span, limit in zip(record.names, spans, least, strict=True) if span > limit
    )


def findings(
    recording: Recording,
    slides: Sequence[str] = (),
) -> tuple[Finding, ...]:
    """All that a recording shows of itself without a robot, efforts in whatever unit the publisher used."""
    record = recording.joints
    moved = moving(record, slides)
    pace = pace_by_velocities(recording)
    stretched = pace is not None and pace.is_off
    by_column = (
        *_still_columns(record, moved),
        *_velocity(record, moved, stretched),
        *_registers(record, moved),
        *_stale(record, moved),
    )
    time_scale = [] if pace is None or not stretched else [_time_scale(pace, moved)]
    return (
        *_held(recording, moved),
        *time_scale,
        *by_column,
        *_command_as_effort(recording),
    )


def _time_scale(pace: Pace, moved: Sequence[str]) -> Finding:
    """A time axis that is stretched, by joints that moved."""
    return Finding(
        "time_scale",
        pace.sentence,
        tuple(moved),
        dict.fromkeys(moved, pace.scale),
    )


def _held(
    recording: Recording,
    moved: Sequence[str],
) -> Iterator[Finding]:
    """Joints that a current holds."""
    inputs = recording.inputs
    if inputs is None or not moved:
        return
    largest = dict(
        zip(
            inputs.names,
            np.abs(inputs.current_A).max(axis=0),
            strict=True,
        )
    )
    still = [name for name in recording.joints.names if name not in moved]
    held = tuple(name for name in still if largest.get(name, 0.0) > ZERO_CURRENT_A)
    if held:
        whose = "its motor gave held it" if len(held) == 1 else "their motors gave held them"
        yield Finding("held", f"{some(held)} stood still: what {whose} and drove nothing", held)


def _still_columns(
    record: JointRecord,
    moved: Sequence[str],
) -> Iterator[Finding]:
    """Columns of a driver that has no such reading."""
    for quantity in ("velocity", "reported_effort"):
        values = getattr(record, quantity)
        if values is None:
            continue
        constant = {
            name: float(column[np.isfinite(column)][0])
            for name, column in zip(record.names, values.T, strict=True)
            if name in moved
            and np.isfinite(column).any()
            and np.ptp(column[np.isfinite(column)]) == 0.0
        }
        if constant:
            word = quantity.removeprefix("reported_")
            same = (
                f"{next(iter(constant.values())):g}"
                if len(set(constant.values())) == 1
                else "the same"
            )
            sentence = f"the {word} of {some(constant)} is {same} in every message although it moves: it is no reading"
            yield Finding(f"constant_{word}", sentence, tuple(constant), constant)


def evenly(
    times_s: FloatArray,
    values: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Times, shape (T,), and values, shape (T, ...), at equal distances, by interpolation; between gaps the longest stretch."""
    period_s = float(np.median(np.diff(times_s)))
    cuts = [
        0,
        *(np.flatnonzero(np.diff(times_s) > max(0.1, 5.0 * period_s)) + 1),
        len(times_s),
    ]
    start, end = max(
        itertools.pairwise(cuts),
        key=lambda part: part[1] - part[0],
    )
    own = times_s[start:end]
    inside = values[start:end].reshape(end - start, -1)
    even = np.arange(
        own[0],
        own[-1] + 0.5 * period_s,
        period_s,
    )
    columns = np.column_stack([np.interp(even, own, column) for column in inside.T])
    return even, columns.reshape(len(even), *values.shape[1:])


def velocity_lag_s(
    times_s: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
) -> tuple[float, float] | None:
    """How far a recorded velocity is behind the derivative of its position, and how many times as large it is.

    Args:
        times_s: Increasing [s], shape (T,).
        position: Of a joint [rad], shape (T,).
        velocity: As it was recorded, shape (T,).

    Returns:
        Lag [s] (ahead is negative) and ratio; None where the two hardly agree at any lag.
    """
    even, both = evenly(times_s, np.column_stack([position, velocity]))
    period_s = float(even[1] - even[0])
    most = round(LONGEST_LAG_S / period_s)
    # both are smoothed alike, so that counts of the encoder do not decide
    width = max(3, round(0.05 / period_s) | 1)
    smooth = np.ones(width) / width
    derivative = np.convolve(
        np.gradient(both[:, 0], period_s),
        smooth,
        "same",
    )
    reported = np.convolve(both[:, 1], smooth, "same")
    if most < 1 or len(even) < 8 * most + 2 * width or not derivative.any() or not reported.any():
        return None
    agreement = _agreement(derivative, reported, most)
    best = int(np.argmax(agreement))
    if agreement[best] < SURE_CORRELATION:
        return None
    shift = _peak_shift(agreement, best)
    lag = best - most
    start = 2 * most
    stop = len(even) - 2 * most
    early = derivative[start - lag : stop - lag]
    ratio = (early @ reported[start:stop]) / (early @ early)
    return float((lag + shift) * period_s), float(ratio)


def _agreement(
    derivative: FloatArray,
    reported: FloatArray,
    most: int,
) -> FloatArray:
    """Correlation of two series, shape (T,) each, where the second is so many samples late, from -most to most."""
    start = 2 * most
    stop = len(derivative) - 2 * most
    late = reported[start:stop] - reported[start:stop].mean()
    agreement = np.zeros(2 * most + 1)
    for row, lag in enumerate(range(-most, most + 1)):
        early = derivative[start - lag : stop - lag]
        early = early - early.mean()
        scale = np.sqrt((early @ early) * (late @ late))
        agreement[row] = early @ late / scale if scale > 0.0 else 0.0
    return agreement


def _peak_shift(values: FloatArray, best: int) -> float:
    """How far the peak of a parabola through the largest value and its neighbours is from it, in samples."""
    if not 0 < best < len(values) - 1:
        return 0.0
    below, at, above = values[best - 1 : best + 2]
    bend = below - 2.0 * at + above
    return float(0.5 * (below - above) / bend) if bend < 0.0 else 0.0


def times_of(record: JointRecord) -> FloatArray:
    """Of the joint states since the first [s], shape (T,)."""
    return 1e-9 * (record.times_ns - record.times_ns[0]).astype(np.float64)


def _velocity(
    record: JointRecord,
    moved: Sequence[str],
    stretched: bool,
) -> Iterator[Finding]:
    """Velocities that lag, or of another unit; of a stretched time axis they have none of their own to be blamed for."""
    if record.velocity is None:
        return
    times_s = times_of(record)
    lags = {}
    ratios = {}
    for name in moved:
        column = record.column(name)
        known = np.isfinite(record.velocity[:, column])
        if known.sum() < 50 or np.ptp(record.velocity[known, column]) == 0.0:
            continue
        seen = velocity_lag_s(
            times_s[known], record.position[known, column], record.velocity[known, column]
        )
        if seen is not None:
            lags[name], ratios[name] = seen
    period_s = float(np.median(np.diff(times_s)))
    late = {name: 1e3 * lag for name, lag in lags.items() if lag > max(LAG_S, 1.2 * period_s)}
    if late:
        sentence = (
            f"the velocity of {some(late)} lags its position by {_span(late, '.0f')} ms: a filter of the driver or the servo; "
            "positions alone are used"
        )
        yield Finding("velocity_lags", sentence, tuple(late), late)
    other = {name: ratio for name, ratio in ratios.items() if not 0.8 < ratio < 1.25}
    if other and not stretched:
        sentence = (
            f"the velocity of {some(other)} is {_span(other, '.3g')} times the derivative of its position: "
            "another unit (rpm are 9.55 times rad/s, degrees/s 57.3 times), or another joint's; positions alone are used"
        )
        yield Finding("velocity_scale", sentence, tuple(other), other)


def _span(values: Mapping[str, float], spec: str) -> str:
    """Smallest and largest, or the one where they print alike."""
    least = format(min(values.values()), spec)
    most = format(max(values.values()), spec)
    return least if least == most else f"{least} to {most}"


def _registers(
    record: JointRecord,
    moved: Sequence[str],
) -> Iterator[Finding]:
    """Efforts that a driver took for unsigned: a register of 16 bits below zero, or a magnitude without its sign."""
    if record.reported_effort is None:
        return
    wrapped = {}
    unsigned = []
    highest = 0.0
    for name, effort, position in zip(
        record.names, record.reported_effort.T, record.position.T, strict=True
    ):
        known = effort[np.isfinite(effort)]
        if not len(known) or known.min() < 0.0 or np.ptp(known) == 0.0:
            continue
        whole = bool(np.all(known == np.round(known)))
        high = known[known > 32767.0]
        if (
            whole
            and len(high)
            and known.max() < 65536.0
            and np.all((known < 20000.0) | (known > 45000.0))
        ):
            wrapped[name] = float(high.min())
            highest = max(highest, float(known.max()))
        elif name in moved:
            step = np.diff(position)
            way = np.sign(step[step != 0.0])
            # a magnitude comes down to zero where the sign would change; what only ever lifts need not
            both_ways = len(way) > 20 and 0.2 < np.mean(way > 0) < 0.8
            if both_ways and known.min() < 0.05 * known.max():
                unsigned.append(name)
    if wrapped:
        value = min(wrapped.values())
        sentence = (
            f"the effort of {some(wrapped)} holds numbers from {value:.0f} to {highest:.0f}, as an unsigned register "
            f"of 16 bits does below zero ({value:.0f} is {value - 65536.0:.0f}): let the driver read it as signed"
        )
        yield Finding("unsigned_register", sentence, tuple(wrapped), wrapped)
    if unsigned:
        sentence = (
            f"the effort of {some(unsigned)} is never negative although it moves both ways: it may be a magnitude without "
            "its sign, of which no torque can be made"
        )
        yield Finding("effort_without_sign", sentence, tuple(unsigned))


def _stale(
    record: JointRecord,
    moved: Sequence[str],
) -> Iterator[Finding]:
    """Efforts that are read more seldom than they are published."""
    if record.reported_effort is None or not moved:
        return
    step_s = float(np.median(np.diff(times_of(record))))
    slow = {}
    for name in moved:
        column = record.column(name)
        repeated = _repeated_samples(record.reported_effort[:, column], record.position[:, column])
        if repeated:
            slow[name] = repeated * step_s
    if slow:
        sentence = (
            f"the effort of {some(slow)} stays the same for {_span(slow, '.2g')} s at a time while it moves, at "
            f"{1.0 / step_s:.0f} joint states a second: old readings are repeated"
        )
        yield Finding("effort_stale", sentence, tuple(slow), slow)


def _repeated_samples(effort: FloatArray, position: FloatArray) -> int:
    """How many samples in a row an effort usually has the same value in while its joint moves on; 0 where that is no matter.

    Args:
        effort: Of one joint, shape (T,).
        position: Of the same, shape (T,) [rad or m].
    """
    if not np.isfinite(effort).all() or np.ptp(effort) == 0.0:
        return 0
    starts = np.flatnonzero(np.concatenate([[True], np.diff(effort) != 0.0]))
    ends = np.append(starts[1:], len(effort))
    level = effort[starts]
    # zero is a motor that is off; a controller at its limit repeats that, among many other values
    read = level != 0.0
    if len(np.unique(effort)) > 20:
        read &= (level != effort.min()) & (level != effort.max())
    # fewer are of an excitation's constant current, read without noise
    if np.count_nonzero(read) < FEW_LEVELS:
        return 0
    lengths = (ends - starts)[read]
    stretches = zip(starts[read], ends[read], strict=True)
    places = np.array([len(np.unique(position[start:end])) for start, end in stretches])
    by_sample = np.sort(np.repeat(lengths, lengths))
    typical = int(by_sample[lengths.sum() // 2])
    moves_on = places[lengths >= typical].mean() > 0.5 * STALE_SAMPLES
    return typical if typical >= STALE_SAMPLES and moves_on else 0


def _command_as_effort(recording: Recording) -> Iterator[Finding]:
    """An effort that is the command again, up to a factor and a delay of a cycle, says nothing of what flowed."""
    record = recording.joints
    inputs = recording.inputs
    if inputs is None or inputs.measured or record.reported_effort is None:
        return
    row = np.clip(
        np.searchsorted(inputs.times_ns, record.times_ns, side="right") - 1,
        0,
        None,
    )
    same = []
    for name in record.names:
        if name not in inputs.names:
            continue
        effort = record.reported_effort[:, record.column(name)]
        command = inputs.current_A[:, inputs.column(name)]
        # a command of few values stands still, too, or only steps
        if not np.isfinite(effort).all() or len(np.unique(command)) < 10:
            continue
        for given in (command[row], command[np.clip(row - 1, 0, None)]):
            factor = float(given @ effort) / max(float(given @ given), 1e-300)
            if np.abs(effort - factor * given).max() < 1e-5 * np.abs(effort).max():
                same.append(name)
                break
    if same:
        sentence = (
            f"the effort of {some(same)} is the command again: it was not measured, and a motor follows its "
            "command late and not quite"
        )
        yield Finding("effort_is_command", sentence, tuple(same))
