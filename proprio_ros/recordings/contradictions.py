"""What a recording says twice, and where the two differ: looked for before any fit, which would take either for the truth.

A current that was commanded may also have been measured, and a time that a driver stamped was also taken by the recorder. Where the
two cannot both be right nothing is identified, since a mass goes with the current and with the square of the time.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from proprio_ros.errors import RecordingError
from proprio_ros.recordings.columns import JointColumns
from proprio_ros.recordings.effort import EFFORT_UNITS, Effort, ampere
from proprio_ros.recordings.topics import OUR_DRIVER
from proprio_ros.records import ZERO_CURRENT_A, FloatArray, JointRecord, Recording

# of the pace of header stamps, against that of the recorder's clock: quartz keeps 0.0001
RATE_OFF = 0.004
CLEARLY = 5.0
"""Times the scatter of what comes late that two clocks must drift apart; a recorder that falls behind does so in jumps."""
OTHER_UNIT = 100.0
"""Stamps that run so many times faster or slower are of no simulated clock either, but in another unit."""
FEWEST_STAMPS = 20
OTHER_CLOCK_S = 0.5
"""A clock further off than this is not the recorder's (simulated time), and may run at a pace of its own."""

# of the measured current, against the commanded: real XM430 deliver 0.98 to 0.99 of it
CURRENT_OFF = 0.05
TORQUE_OFF = 0.3
"""The same where others command: an arm may measure torque behind its gears, which lacks what friction and rotor take."""
# what the two must differ by, on average, whatever is commanded; two counts of an XM430
LEAST_CURRENT_A = 0.005
SAME_UNIT = {"N.m": 4.0, "A": 4.0, "mA": 1.5, "raw": 1.5}
"""Effort in no unit that is known is compared with no command: the nearest one must fit to this factor. Per mille of a motor's
rating lie near mA and raw counts."""
SETTLED_S = 0.1  # a motor follows a command within this time, delay of bus and driver included
FEWEST_READINGS = 8
# of the readings that are far from the command, above which they follow another one
ELSEWHERE_SHARE = 0.3


def pace_of_stamps(columns: JointColumns) -> tuple[float, bool] | None:
    """How much faster header stamps run than the recorder's clock, as a share, where that is sure.

    Returns: The share (negative: slower), and whether both may be one clock; None where they keep the same pace or nothing is sure.
    """
    stamped = columns.stamp_ns != 0
    stamp_s = 1e-9 * (columns.stamp_ns[stamped] - columns.stamp_ns[stamped][:1]).astype(np.float64)
    late_s = 1e-9 * (columns.bag_ns - columns.stamp_ns)[stamped].astype(np.float64)
    if len(stamp_s) < FEWEST_STAMPS or np.ptp(stamp_s) == 0.0:
        return None
    # the median of slopes between samples half a recording apart: what comes late in between does not bend it
    order = np.argsort(stamp_s, kind="stable")
    stamp_s = stamp_s[order]
    late_s = late_s[order]
    half = len(stamp_s) // 2
    apart_s = stamp_s[half:] - stamp_s[:-half]
    slope = float(np.median((late_s[half:] - late_s[:-half]) / np.maximum(apart_s, 1e-9)))
    line = slope * stamp_s
    scatter_s = 1.4826 * float(np.median(np.abs(late_s - line - np.median(late_s - line))))
    if abs(slope) < RATE_OFF or abs(slope) * float(np.ptp(stamp_s)) < CLEARLY * max(
        scatter_s, 1e-4
    ):
        return None
    return -slope / (1.0 + slope), abs(float(np.median(late_s))) < OTHER_CLOCK_S


def refuse_pace(where: str, columns: JointColumns) -> tuple[str, ...]:
    """Look at header stamps beside the times of their recording; bag and topic are for the sentence.

    Returns: A note where the stamps are of another clock, which runs at another pace.

    Raises `RecordingError`: They are of the same clock, and one of the two does not keep time.
    """
    found = pace_of_stamps(columns)
    if found is None:
        return ()
    share, same = found
    factor = 1.0 + share
    if not 1.0 / OTHER_UNIT < factor < OTHER_UNIT:
        many = f"{factor:.0f} times faster" if factor > 1.0 else f"{1.0 / factor:.0f} times slower"
        raise RecordingError(
            f"{where}: header stamps run {many} than the times of recording: they are not in s and ns"
        )
    much = f"run {abs(100.0 * share):.1f} % {'faster' if share > 0.0 else 'slower'} than the times of recording"
    if same:
        raise RecordingError(
            f"{where}: header stamps {much}: one of the two does not keep time, and a mass goes with its square; let the driver "
            "stamp by the clock, not by counting periods"
        )
    return (f"{where}: header stamps {much}; they are of another clock, and are taken as they are",)


def refuse_other_current(
    recording: Recording, effort: Effort, usable_velocity: Mapping[str, float]
) -> None:
    """Look at commanded currents beside measured efforts, joint by joint, where the joint is slow and the command does not change.

    Where the command is the input the unit of the effort does not matter: that which fits best is taken. Up to its usable velocity
    [rad/s] the supply drives what a joint is commanded. Raises `RecordingError`: What flowed is not that.
    """
    record = recording.joints
    inputs = recording.commanded or recording.inputs
    if inputs is None or inputs.measured or inputs.computed or record.reported_effort is None:
        return
    if recording.commanded is None:
        effort = replace(effort, unit=None)
    for name, usable in usable_velocity.items():
        if name not in record.names or name not in inputs.names:
            continue
        seen = _readings(
            record, name, inputs.times_ns, inputs.current_A[:, inputs.column(name)], usable
        )
        if seen is None:
            continue
        commanded, reading = seen
        unit, measured = _as_current(name, reading, commanded, effort)
        if unit is None:
            continue
        _compare(recording.name, inputs.source, name, unit, commanded, measured, effort)


def _readings(
    record: JointRecord, name: str, times_ns: np.ndarray, command: FloatArray, usable: float
) -> tuple[FloatArray, FloatArray] | None:
    """Commanded currents that had settled, and the efforts beside them; None where there are few."""
    column = record.column(name)
    assert record.reported_effort is not None
    reading = record.reported_effort[:, column]
    position = record.position[:, column]
    at = np.searchsorted(times_ns, record.times_ns, side="right") - 1
    given = np.where(at >= 0, command[at.clip(0)], 0.0)
    changed_ns = times_ns[np.flatnonzero(np.diff(command, prepend=0.0) != 0.0)]
    last = np.searchsorted(changed_ns, record.times_ns, side="right") - 1
    since_s = (
        1e-9 * (record.times_ns - changed_ns[last.clip(0)])
        if len(changed_ns)
        else np.zeros(len(given))
    )
    speed = np.abs(np.gradient(position, 1e-9 * (record.times_ns - record.times_ns[0])))
    used = (
        (np.abs(given) > ZERO_CURRENT_A)
        & (since_s >= SETTLED_S)
        & (speed < 0.5 * usable)
        & np.isfinite(reading)
    )
    if int(used.sum()) < FEWEST_READINGS or not np.any(reading[used]):
        return None
    return given[used], reading[used]


def _as_current(
    name: str, reading: FloatArray, commanded: FloatArray, effort: Effort
) -> tuple[str | None, FloatArray]:
    """Efforts as currents [A], in the unit that is stated or else fits best; no unit where none does."""
    per_A = {unit: 1.0 / ampere(unit, effort.per_count_A) for unit in EFFORT_UNITS if unit != "N.m"}
    if effort.nominal.get(name, 0.0) > 0.0:
        per_A["N.m"] = effort.nominal[name]
    if effort.unit is not None:
        per_A = {unit: value for unit, value in per_A.items() if unit == effort.unit}
    ratio = abs(float(np.median(reading / commanded)))
    if not per_A or ratio == 0.0:
        return None, reading
    unit = min(per_A, key=lambda each: abs(np.log(ratio / per_A[each])))
    if effort.unit is None and abs(np.log(ratio / per_A[unit])) > np.log(SAME_UNIT[unit]):
        return None, reading
    return unit, reading / per_A[unit] * np.sign(np.median(reading / commanded))


def _compare(
    where: str,
    source: str,
    name: str,
    unit: str,
    commanded: FloatArray,
    measured: FloatArray,
    effort: Effort,
) -> None:
    """Raises RecordingError: the two contradict each other."""
    off = measured - commanded
    scatter = 1.4826 * float(np.median(np.abs(off - np.median(off))))
    least = max(LEAST_CURRENT_A, 4.0 * scatter / np.sqrt(len(off)))
    ratio = float(np.median(measured / commanded))
    far = np.abs(off) > np.maximum(
        0.25 * np.abs(commanded), LEAST_CURRENT_A + 4.0 * min(scatter, LEAST_CURRENT_A)
    )
    own = source.rpartition("/")[2] in {each.topic for each in OUR_DRIVER.inputs}
    if (
        abs(ratio - 1.0) > (CURRENT_OFF if own else TORQUE_OFF)
        and abs(float(np.median(off))) > least
    ):
        made = f" (at {effort.nominal[name]:.3g} N m/A)" if unit == "N.m" else ""
        raise RecordingError(
            f"{where}: by its effort{made}, {name} had {ratio:.2f} times the current of {source}: that is another recording's or "
            "in another unit, or the effort is: see --command-topic, --effort-unit and its nominal_torque_constant_N_m_per_A"
        )
    if own and float(np.mean(far)) > ELSEWHERE_SHARE:
        raise RecordingError(
            f"{where}: the effort of {name} does not follow {source}: {100.0 * float(np.mean(far)):.0f} % of its readings are off "
            "by more than a quarter; is it the command of this recording, on the same clock?"
        )
