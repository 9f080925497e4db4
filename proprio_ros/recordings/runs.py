"""Runs cut out of a recording: where a current drove one joint, and what the joint did meanwhile."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from proprio_ros.errors import RecordingError
from proprio_ros.quantity import MAD_TO_STD
from proprio_ros.recordings.medians import running_median
from proprio_ros.recordings.repeats import repeated as repeated_rows
from proprio_ros.records import (
    INSTANT_S,
    LOST_AFTER_PERIODS,
    TORQUE_OFF,
    ZERO_CURRENT_A,
    BoolArray,
    FloatArray,
    InputRecord,
    JointRecord,
    Recording,
    Run,
    TimeArray,
)

MEASURED_CURRENT_FLOOR_A = 0.015
"""Measured currents scatter by 8-15 mA around the command on a real OpenManipulator-X; less is rest [A]."""
REST_S = 0.2  # a measured rest level is taken over the opening of the recording [s]
SETTLING_S = 0.3  # after a run ends the joint is braked; what it does meanwhile is no rest [s]
BEFORE_S = 1.0  # rest before the onset that a run carries along [s]
AFTER_S = 0.3
"""Of what the joint does after its run, so much is carried along: it shows when the current truly ended [s]."""
# a joint that a position controller holds gives way by less than this [rad or m]
MOVING_SPAN = 0.02
STEADY_SHARE, STEADY_WITHIN = 0.8, 0.25
"""The current of an excitation is constant: so much of it lies so close to its median, once single samples are smoothed. Of 194
simulated ones 0.82 to 1 of it does even unsmoothed; under the controllers of real servos mostly 0 to 0.75."""
AT_REST_S = 0.3  # an excitation begins at rest: for so long before it the joint has not moved
MIN_SAMPLES = 5  # fewer samples than this say nothing about a motion that starts at rest
RELEASE_S = 0.05
"""A servo that was told to let go may take so long; what it does meanwhile is no free response. Torque that comes back may come so
long before it is said [s]."""
LET_GO_S, CAUGHT_S = 0.2, 0.2
"""A current that ends so shortly before a free response lets go of the joint, and one that begins so shortly after it catches it:
neither is an excitation [s]."""
FELL_SPAN = 0.1
"""Where torque is off, a joint that moves more than this swings, and one that moves less is held by its friction [rad]."""
LONGEST_SWING_S = 5.0
"""Of a free response: what comes later is told by friction more than by weight, and costs computing time [s]."""
STANDS_STILL = 0.005  # a joint that stays this close to where it ends has come to rest [rad]


class DrivenAtOnce(RecordingError):
    """Several joints were driven at once: a motion, and no run."""


class UnderController(DrivenAtOnce):
    """One joint was, by a current that answers to its motion: a motion, too."""


class _Interval(NamedTuple):
    """Rows first..last of the input drive the joint; the current ends at end_ns."""

    joint: str
    first: int
    last: int
    onset_ns: int
    end_ns: int
    notes: tuple[str, ...]


def cut_runs(
    recording: Recording,
    *,
    held: Mapping[str, float] | None = None,
    joints: Sequence[str],
) -> tuple[Run, ...]:
    """Cut the runs out of a recording, in the order in which they happened, of joints that have a motor.

    A run lasts from the first non-zero current on a joint to the end of it. A zero shorter than three command periods (at most 0.3
    s) belongs to the run, a longer one ends it. Where the recording says that torque was off, a joint that then falls gives a free
    response. Of a recording that has both, the excitations that a command drove are taken, except those that only held the joint,
    let go of it or caught it; a zero current alone never makes a free response, since a driver may hold the joint at rest then.
    ``held`` are positions of joints that are not recorded, or that replace recorded ones [rad or m].

    Raises:
        DrivenAtOnce: Several joints were, or one under a controller.
        RecordingError: No joint was driven, an unknown or unrecorded one was, or every run has fewer than five samples.
    """
    inputs = recording.inputs
    if recording.torque_off_ns and (inputs is None or not _driven_by_command(recording, inputs)):
        return _free_responses(recording, dict(held or {}), tuple(joints))
    if inputs is None:
        raise RecordingError(
            "the recording holds no input current; record /applied_effort or /current_command,"
            " or name the topic with --command-topic (of a joint that swings freely, record /torque_enabled)",
            recording.name,
        )
    record = recording.joints
    intervals = _intervals(recording.name, record, inputs, tuple(joints))
    runs = []
    too_short = []
    before = [None, *(interval.end_ns for interval in intervals)]
    after = [
        *(interval.onset_ns for interval in intervals[1:]),
        None,
    ]
    for number, (interval, end_ns, next_ns) in enumerate(
        zip(intervals, before, after, strict=False), start=1
    ):
        name = recording.name if len(intervals) == 1 else f"{recording.name}#{number}"
        if _is_cut(recording, interval):
            too_short.append(
                f"{name}: the clock steps while {interval.joint} is driven: nobody knows for how long it was"
            )
            continue
        end_ns, next_ns = _between_cuts(recording, interval, end_ns, next_ns)
        try:
            runs.append(
                _run(
                    name,
                    record,
                    inputs,
                    interval,
                    end_ns,
                    next_ns,
                    dict(held or {}),
                )
            )
        except RecordingError as error:
            too_short.append(str(error))
    return _without(too_short, runs)


def _is_cut(recording: Recording, interval: _Interval) -> bool:
    """Whether nothing is known of a part of an interval."""
    return any(
        begin_ns < interval.end_ns and end_ns > interval.onset_ns
        for begin_ns, end_ns in recording.cuts_ns
    )


def _between_cuts(
    recording: Recording, interval: _Interval, end_ns: int | None, next_ns: int | None
) -> tuple[int | None, int | None]:
    """Of the interval before, its end; of the one behind, its onset; where something is cut in between, this."""
    ends = [end for _, end in recording.cuts_ns if end <= interval.onset_ns]
    begins = [begin for begin, _ in recording.cuts_ns if begin >= interval.end_ns]
    latest = [end for end in (end_ns, *ends) if end is not None]
    soonest = [begin for begin in (next_ns, *begins) if begin is not None]
    return max(latest, default=None), min(soonest, default=None)


def _without(
    left_out: Sequence[str],
    runs: Sequence[Run],
) -> tuple[Run, ...]:
    """An excitation that was broken off at once says nothing, and must not cost the others; raises where there are none."""
    if not runs:
        raise RecordingError(left_out[0])
    return tuple(
        replace(
            run,
            notes=(
                *run.notes,
                *(f"left out: {why}" for why in left_out),
            ),
        )
        for run in runs
    )


def _driven_by_command(recording: Recording, inputs: InputRecord) -> bool:
    """Whether a command moved a joint while torque was on; a controller's measured current is no excitation."""
    record = recording.joints
    if inputs.measured:
        return False
    off_ns = [
        (begin - int(LET_GO_S * 1e9), end + int(CAUGHT_S * 1e9))
        for begin, end in recording.torque_off_ns
    ]
    for column, joint in enumerate(inputs.names):
        active = np.abs(inputs.current_A[:, column]) > ZERO_CURRENT_A
        if joint not in record.names or not active.any():
            continue
        for interval in _intervals_of_joint(record, inputs, joint, active):
            begins = [
                begin
                for begin, end in off_ns
                if begin < interval.end_ns and end > interval.onset_ns
            ]
            end_ns = min([interval.end_ns, *begins])
            if _spans(record, interval._replace(end_ns=end_ns))[record.column(joint)] > MOVING_SPAN:
                return True
    return False


def _free_responses(
    recording: Recording, held: dict[str, float], joints: tuple[str, ...]
) -> tuple[Run, ...]:
    """A free response for each stretch without torque in which one joint falls."""
    record = recording.joints
    problems = []
    runs = []
    columns = [record.column(joint) for joint in joints if joint in record.names]
    if not columns:
        raise RecordingError(
            f"torque goes off, but no position of {', '.join(joints)} was recorded; "
            f"recorded: {', '.join(record.names)}",
            recording.name,
        )
    for number, (off_ns, on_ns) in enumerate(recording.torque_off_ns, start=1):
        name = recording.name if len(recording.torque_off_ns) == 1 else f"{recording.name}#{number}"
        off_s = 1e-9 * (off_ns - int(record.times_ns[0]))
        if any(begin < on_ns and end > off_ns for begin, end in recording.cuts_ns):
            problems.append(f"{name}: the clock steps while torque is off")
            continue
        said = f"{name}: torque goes off {off_s:.2f} s after the first joint state, but"
        end_ns = on_ns - int(RELEASE_S * 1e9) if on_ns < record.times_ns[-1] else on_ns
        inside = (record.times_ns >= off_ns + int(RELEASE_S * 1e9)) & (record.times_ns < end_ns)
        inside &= record.times_ns <= off_ns + int(LONGEST_SWING_S * 1e9)
        count = int(inside.sum())
        if count < MIN_SAMPLES:
            problems.append(
                f"{said} only {count} joint states come while it is off: record on until it hangs still"
            )
            continue
        spans = np.ptp(record.position[inside], axis=0)
        fell = [record.names[column] for column in columns if spans[column] > FELL_SPAN]
        if not fell:
            problems.append(
                f"{said} no joint falls by {FELL_SPAN:g} rad: let go of it where gravity pulls at it"
            )
        elif len(fell) > 1:
            problems.append(f"{said} {', '.join(fell)} fall at once: hold all joints but one")
        else:
            runs.append(
                _free_response(
                    name,
                    record,
                    fell[0],
                    inside,
                    held,
                )
            )
    return _without(problems, runs)


def _free_response(
    name: str,
    record: JointRecord,
    joint: str,
    inside: BoolArray,
    held: dict[str, float],
) -> Run:
    """One free response, until the joint hangs still: then friction alone decides where."""
    column = record.column(joint)
    notes = []
    repeated = repeated_rows(record, inside, [column])
    if repeated.any():
        inside = inside & ~repeated
        notes.append(
            f"{int(repeated.sum())} joint states repeat the one before although {joint} moves; they were left out"
        )
    rows = np.flatnonzero(inside)
    position = record.position[rows, column]
    end = np.median(
        position[record.times_ns[rows] >= record.times_ns[rows[-1]] - int(REST_S * 1e9)]
    )
    away = np.flatnonzero(np.abs(position - end) > STANDS_STILL)
    rows = rows[: min(int(away[-1]) + 3, len(rows))] if len(away) else rows
    times_s = (record.times_ns[rows] - record.times_ns[rows[0]]) / 1e9
    others = _others(record, rows, joint, held)
    others["held_span"] |= {other: 0.0 for other in held if other != joint}
    return Run(
        name=name,
        joint=joint,
        onset_ns=int(record.times_ns[rows[0]]),
        times_s=times_s,
        position=record.position[rows, column],
        before_times_s=np.zeros(0),
        before_position=np.zeros(0),
        input_times_s=np.zeros(1),
        input_current_A=np.zeros(1),
        duration_s=float(times_s[-1]),
        source=TORQUE_OFF,
        notes=tuple(notes),
        **others,
    )


def _others(
    record: JointRecord,
    rows: NDArray[Any],
    joint: str,
    held: Mapping[str, float],
) -> dict[str, Any]:
    """What a `Run` says of all joints but that which moves, by name."""
    positions = {
        other: record.position[rows, record.column(other)]
        for other in record.names
        if other != joint
    }
    stated = {other: float(value) for other, value in held.items() if other != joint}
    return {
        "held": {other: float(values.mean()) for other, values in positions.items()} | stated,
        "held_span": dict.fromkeys(stated, 0.0)
        | {other: float(np.ptp(v)) for other, v in positions.items()},
        "held_position": {
            other: values for other, values in positions.items() if other not in held
        },
    }


def _intervals(
    name: str, record: JointRecord, inputs: InputRecord, joints: tuple[str, ...]
) -> list[_Interval]:
    active = _active(inputs)
    intervals = []
    for column, joint in enumerate(inputs.names):
        if not active[:, column].any() or (inputs.measured and joint not in joints):
            continue
        if joint not in joints:
            raise RecordingError(
                f"joint {joint!r} was driven, but the robot drives {', '.join(joints)}", name
            )
        if joint not in record.names:
            recorded = ", ".join(record.names)
            raise RecordingError(
                f"joint {joint!r} was driven but its position was not recorded; recorded: {recorded}",
                name,
            )
        intervals += _intervals_of_joint(record, inputs, joint, active[:, column])
    if inputs.measured:
        # a few samples above the rest level are noise, not an excitation
        intervals = [
            interval for interval in intervals if interval.last - interval.first + 1 >= MIN_SAMPLES
        ]
        intervals = _without_holding_joints(record, intervals)
    intervals.sort(key=lambda interval: interval.onset_ns)
    for earlier, later in pairwise(intervals):
        if later.onset_ns < earlier.end_ns:
            raise DrivenAtOnce(
                f"joints {earlier.joint!r} and {later.joint!r} were driven at once; drive one joint at a time, or give this"
                " motion, and one with an empty hand as --baseline, to `replay --probe payload`",
                name,
            )
    if not intervals:
        if inputs.measured:
            _refuse_controlled(name, record, inputs, joints)
        stays = "never leaves its rest level for long" if inputs.measured else "is zero throughout"
        unit = " is it in another unit (--effort-unit)? Else" if inputs.measured else ""
        raise RecordingError(
            f"no joint was driven: {inputs.source} {stays} ({len(inputs.times_ns)} rows);{unit}"
            " record the probe itself, or name another input with --command-topic",
            name,
        )
    if inputs.measured and not _is_excitation(record, inputs, intervals[0]):
        raise _under_controller(name, intervals[0].joint)
    return intervals


def _under_controller(name: str, joint: str) -> UnderController:
    return UnderController(
        f"{joint} moves under a controller: its measured current answers to its motion. A probe drives a joint from rest "
        "with a constant current; `replay --probe payload` takes such a motion, too",
        name,
    )


def _refuse_controlled(
    name: str, record: JointRecord, inputs: InputRecord, joints: tuple[str, ...]
) -> None:
    """Raises: UnderController: A current that alternates from the first sample on has no rest level, but moves a joint."""
    for joint in joints:
        if joint in inputs.names and joint in record.names:
            smooth = running_median(inputs.current_A[:, inputs.column(joint)], MIN_SAMPLES)
            loud = float(np.mean(np.abs(smooth - np.median(smooth)) > MEASURED_CURRENT_FLOOR_A))
            if loud > 0.5 and np.ptp(record.position[:, record.column(joint)]) > MOVING_SPAN:
                raise _under_controller(name, joint)


def _is_excitation(record: JointRecord, inputs: InputRecord, interval: _Interval) -> bool:
    """Whether a measured current began at rest and stayed the same."""
    since_s = 1e-9 * (record.times_ns - interval.onset_ns)
    before = record.position[
        (since_s >= -AT_REST_S) & (since_s <= 0.0), record.column(interval.joint)
    ]
    if len(before) and np.ptp(before) > MOVING_SPAN:
        return False
    column = inputs.column(interval.joint)
    smooth = running_median(inputs.current_A[:, column], MIN_SAMPLES)
    # the first and the last sample may lie on the edge
    current = inputs.current_A[interval.first + 1 : interval.last, column]
    if len(current) < MIN_SAMPLES:
        return True
    level = float(np.median(current))
    within = max(STEADY_WITHIN * abs(level), 2.0 * MEASURED_CURRENT_FLOOR_A)
    rest = smooth[: max(interval.first - MIN_SAMPLES, 0)]
    if len(rest) and np.ptp(rest) > 2.0 * within:
        return False
    steady = np.abs(smooth[interval.first + 1 : interval.last] - level) <= within
    return bool(np.mean(steady) >= STEADY_SHARE)


def _active(inputs: InputRecord) -> BoolArray:
    """Where each joint is driven, shape (C, J)."""
    if not inputs.measured:
        return np.abs(inputs.current_A) > ZERO_CURRENT_A
    opening = inputs.times_ns <= inputs.times_ns[0] + int(REST_S * 1e9)
    opening[: min(MIN_SAMPLES, len(opening))] = True
    rest = np.median(inputs.current_A[opening], axis=0)
    sigma = MAD_TO_STD * float(np.median(np.abs(inputs.current_A[opening] - rest)))
    return np.abs(inputs.current_A - rest) > max(MEASURED_CURRENT_FLOOR_A, 6.0 * sigma)


def _intervals_of_joint(
    record: JointRecord, inputs: InputRecord, joint: str, active: BoolArray
) -> list[_Interval]:
    times = inputs.times_ns
    period_ns = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    # Commands that are sent only when they change have a long median period and would join runs far apart.
    bridge_ns = 3.0 * min(period_ns, 0.1e9)
    rows = np.flatnonzero(active)
    stretches = [[rows[0], rows[0]]]
    for row in rows[1:]:
        zero_begins = times[stretches[-1][1] + 1]
        if row == stretches[-1][1] + 1 or times[row] - zero_begins < bridge_ns:
            stretches[-1][1] = row
        else:
            stretches.append([row, row])
    intervals = []
    for first, last in stretches:
        notes = []
        onset_ns = int(times[first])
        end_ns = (
            int(times[last + 1])
            if last + 1 < len(times)
            else max(int(record.times_ns[-1]), onset_ns)
        )
        if last + 1 == len(times):
            notes.append(
                f"the input ends while {joint} is still driven: its last current is held until the last joint state"
            )
        longest_ns = int(np.diff(times[first : last + 2]).max(initial=0))
        if longest_ns > LOST_AFTER_PERIODS * period_ns:
            notes.append(
                f"no input came for {longest_ns / 1e6:.0f} ms while {joint} was driven; the last was held"
            )
        if inputs.measured:
            onset_ns, end_ns, note = _between_samples(
                times,
                int(first),
                int(last),
                end_ns,
            )
            notes.append(note)
        intervals.append(
            _Interval(
                joint,
                int(first),
                int(last),
                onset_ns,
                end_ns,
                tuple(notes),
            )
        )
    return intervals


def _between_samples(
    times: TimeArray,
    first: int,
    last: int,
    end_ns: int,
) -> tuple[int, int, str]:
    """A measured current began after the last quiet sample and before the first loud one.

    Drivers read the joint states and then write the current, so it began right after the quiet sample and ended right after
    the last loud one. (Over 384 recordings with a command beside, the middle was 13 ms late, half a period.)
    """
    quiet_ns = int(times[max(first - 1, 0)])
    uncertainty_ms = (int(times[first]) - quiet_ns) / 1e6
    if last + 1 < len(times):
        end_ns = int(times[last])
    return (
        quiet_ns,
        end_ns,
        f"no command was recorded: the onset may be up to {uncertainty_ms:.1f} ms later than taken",
    )


def _without_holding_joints(
    record: JointRecord,
    intervals: list[_Interval],
) -> list[_Interval]:
    """Drop the joints whose motors answer a moving neighbour: their current changes, but they stay where they are."""
    columns = np.array([record.column(each.joint) for each in intervals], dtype=np.intp)
    onsets_ns = np.array([each.onset_ns for each in intervals])
    ends_ns = np.array([each.end_ns for each in intervals])

    def holds(interval: _Interval) -> bool:
        spans = _spans(record, interval)
        least = max(MOVING_SPAN, 5.0 * spans[record.column(interval.joint)])
        beside = (onsets_ns < interval.end_ns) & (interval.onset_ns < ends_ns)
        return bool(np.any(spans[columns[beside]] > least))

    return [interval for interval in intervals if not holds(interval)]


def _spans(record: JointRecord, interval: _Interval) -> FloatArray:
    """How far each joint moves meanwhile, shape (J,)."""
    first = np.searchsorted(record.times_ns, interval.onset_ns, "left")
    behind = np.searchsorted(record.times_ns, interval.end_ns, "right")
    position = record.position[first:behind]
    spans: FloatArray = np.ptp(position, axis=0) if len(position) else np.zeros(position.shape[1])
    return spans


def _run(
    name: str,
    record: JointRecord,
    inputs: InputRecord,
    interval: _Interval,
    previous_end_ns: int | None,
    next_onset_ns: int | None,
    held: dict[str, float],
) -> Run:
    times_s = (record.times_ns - interval.onset_ns) / 1e9
    duration_s = (interval.end_ns - interval.onset_ns) / 1e9
    inside = (times_s >= 0.0) & (times_s <= duration_s + INSTANT_S)
    if int(inside.sum()) < MIN_SAMPLES:
        raise RecordingError(
            f"only {int(inside.sum())} joint states lie in the {duration_s:.3f} s in which {interval.joint} was"
            f" driven; at least {MIN_SAMPLES} are needed: probe longer or publish faster",
            name,
        )
    notes = list(interval.notes)
    repeated = repeated_rows(record, inside, [record.column(interval.joint)])
    if repeated.any():
        notes.append(
            f"{int(repeated.sum())} of {int(inside.sum())} joint states repeat the one before although {interval.joint} moves:"
            " they are published faster than they are measured; the repeats were left out"
        )
        inside &= ~repeated
    begin_s = -BEFORE_S
    if previous_end_ns is not None:
        begin_s = max(begin_s, (previous_end_ns - interval.onset_ns) / 1e9 + SETTLING_S)
    before = (times_s >= begin_s) & (times_s < 0.0)
    after = (times_s > duration_s + INSTANT_S) & (times_s <= duration_s + AFTER_S)
    if next_onset_ns is not None:
        after &= record.times_ns < next_onset_ns
    column = record.column(interval.joint)
    before_position = record.position[before, column]
    if not before.any():
        notes.append(f"no joint state at rest was recorded before {interval.joint} was driven")
    elif (moved := np.ptp(before_position)) > MOVING_SPAN:
        notes.append(
            f"{interval.joint} moved by {moved:.3g} before it was driven: it was not at rest"
        )
    input_times_s, input_current_A = _piecewise(inputs, interval)
    return Run(
        name=name,
        joint=interval.joint,
        onset_ns=interval.onset_ns,
        times_s=np.minimum(times_s[inside], duration_s),
        position=record.position[inside, column],
        before_times_s=times_s[before],
        before_position=before_position,
        input_times_s=input_times_s,
        input_current_A=input_current_A,
        duration_s=duration_s,
        source=inputs.source,
        notes=tuple(notes),
        reported_effort=None
        if record.reported_effort is None
        else record.reported_effort[inside, column],
        after_times_s=times_s[after],
        after_position=record.position[after, column],
        **_others(record, before | inside, interval.joint, held),
    )


def _piecewise(inputs: InputRecord, interval: _Interval) -> tuple[FloatArray, FloatArray]:
    """Currents of the driven joint with equal neighbours merged; the first holds from the onset.

    A command holds from its stamp on; a measured current is what flowed since the sample before.
    """
    current = inputs.current_A[interval.first : interval.last + 1, inputs.column(interval.joint)]
    begin = max(interval.first - 1, 0) if inputs.measured else interval.first
    times_s = (inputs.times_ns[begin : begin + len(current)] - interval.onset_ns) / 1e9
    times_s[0] = 0.0
    changes = np.concatenate(
        (
            [True],
            np.diff(current) != 0.0,
        )
    )
    return times_s[changes], current[changes]
