"""What a recording says twice, and where the two differ: looked for before any fit, which would take either for the truth.

A current that was commanded may also have been measured, and a time that a driver stamped was also taken by the recorder. Where the
two cannot both be right nothing is identified, since a mass goes with the current and with the square of the time.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from proprio_ros.errors import RecordingError
from proprio_ros.quantity import EFFORTS, MAD_TO_STD, Quantity
from proprio_ros.recordings.columns import JointColumns
from proprio_ros.recordings.effort import CURRENT_PER_COUNT_A, EFFORT_UNITS, Effort, ampere
from proprio_ros.recordings.medians import running_median
from proprio_ros.recordings.noted import Noted
from proprio_ros.recordings.topics import OUR_DRIVER
from proprio_ros.records import (
    ZERO_CURRENT_A,
    BoolArray,
    FloatArray,
    InputRecord,
    JointRecord,
    Recording,
    TimeArray,
)

IndexArray = NDArray[Any]

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
CURRENT_OFF = 0.03
TORQUE_OFF = 0.3
"""The same where others command: an arm may measure torque behind its gears, which lacks what friction and rotor take."""
SURE_STDS = 3.0
"""Beside that, so many standard deviations of the ratio itself: readings are whole counts, have noise and come late."""
# a reading so close to its command is not far from it; two counts of an XM430
LEAST_CURRENT_A = 0.005
SETTLED_S = 0.1  # a motor follows a command within this time, delay of bus and driver included
LATE_S = 0.05
"""A reading may be so much older than its stamp: what the mean of the command would be by then counts as uncertainty."""
SIGN_READINGS = 5  # of so many readings the median says which way a joint is driven
FEWEST_OF_STRETCH = 3  # readings without which a stretch says nothing
FEWEST_READINGS = 8
# of the readings that are far from the command, above which they follow another one
ELSEWHERE_SHARE = 0.3


def pace_of_stamps(columns: JointColumns) -> tuple[float, bool] | None:
    """How much faster header stamps run than the recorder's clock, as a share, where that is sure.

    Returns: The share (negative: slower), and whether both may be one clock; None where they keep the same pace or nothing is sure.
    """
    stamped = columns.stamp_ns != 0
    stamp_ns = columns.stamp_ns[stamped]
    late_ns = columns.bag_ns[stamped] - stamp_ns
    stamp_s = 1e-9 * (stamp_ns - stamp_ns[:1]).astype(np.float64)
    late_s = 1e-9 * late_ns.astype(np.float64)
    if len(stamp_s) < FEWEST_STAMPS or np.ptp(stamp_s) == 0.0:
        return None
    # the median of slopes between samples half a recording apart: what comes late in between does not bend it
    order = np.argsort(stamp_s, kind="stable")
    stamp_s = stamp_s[order]
    late_s = late_s[order]
    half = len(stamp_s) // 2
    apart_s = stamp_s[half:] - stamp_s[:-half]
    later_s = late_s[half:] - late_s[:-half]
    slope = float(np.median(later_s / np.maximum(apart_s, 1e-9)))
    off_s = late_s - slope * stamp_s
    scatter_s = MAD_TO_STD * float(np.median(np.abs(off_s - np.median(off_s))))
    drift_s = abs(slope) * float(np.ptp(stamp_s))
    if abs(slope) < RATE_OFF or drift_s < CLEARLY * max(scatter_s, 1e-4):
        return None
    return -slope / (1.0 + slope), abs(float(np.median(late_s))) < OTHER_CLOCK_S


def refuse_pace(
    noted: Noted,
    columns: JointColumns,
) -> tuple[str, ...]:
    """Look at header stamps of a topic beside the times of their recording.

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
        raise noted.error(
            f": header stamps run {many} than the times of recording: they are not in s and ns"
        )
    faster = "faster" if share > 0.0 else "slower"
    much = f"run {abs(100.0 * share):.1f} % {faster} than the times of recording"
    if same:
        raise noted.error(
            f": header stamps {much}: one of the two does not keep time, and a mass goes with its square; let the driver stamp by "
            "the clock, not by counting periods"
        )
    return (f"{noted}: header stamps {much}; they are of another clock, and are taken as they are",)


@dataclass(frozen=True)
class Stretch:
    """Means over the readings of a joint while it is driven one way."""

    commanded_A: float
    commanded_std_A: float  # by what readings may be late
    reading: float  # in the unit of the effort
    reading_std: float  # by noise, and by rounding to whole counts


@dataclass(frozen=True)
class Gain:
    """Effort per commanded current, over all stretches of a joint."""

    value: float  # in the unit of the effort, per A; negative where the two count in opposite directions
    std: float

    @classmethod
    def of(cls, stretches: Sequence[Stretch]) -> Gain:
        """By weighted least squares through the origin; where stretches differ by more than they say, that counts."""
        commanded = np.array([each.commanded_A for each in stretches])
        reading = np.array([each.reading for each in stretches])
        rough = float(reading @ commanded / (commanded @ commanded))
        variance = np.array(
            [
                each.reading_std**2 + (rough * each.commanded_std_A) ** 2 + 1e-24
                for each in stretches
            ]
        )
        information = float(np.sum(commanded**2 / variance))
        value = float(np.sum(reading * commanded / variance)) / information
        chi2 = float(np.sum((reading - value * commanded) ** 2 / variance))
        apart = max(chi2 / (len(stretches) - 1), 1.0) if len(stretches) > 1 else 1.0
        return cls(value, float(np.sqrt(apart / information)))


def refuse_other_current(
    recording: Recording,
    effort: Effort,
    usable_velocity: Mapping[str, float],
) -> dict[str, Quantity]:
    """Look at commanded currents beside measured efforts, joint by joint, by their means over each push.

    A mean needs no command that stands still: noise of it averages out, and what is left of it is stated. Where the command is the
    input the unit of the effort does not matter: that which fits best is taken.

    Args:
        recording: With commands and efforts; without one of them nothing is compared.
        effort: What the effort means.
        usable_velocity: Up to which the supply drives what a joint is commanded, by joint [rad/s].

    Returns: the measured current over the commanded, by joint whose motor measures what our driver commanded.

    Raises:
        RecordingError: What flowed is not what was commanded.
    """
    record = recording.joints
    delivered: dict[str, Quantity] = {}
    inputs = recording.commanded or recording.inputs
    if inputs is None or inputs.measured or inputs.computed or record.reported_effort is None:
        return delivered
    own = inputs.source.rpartition("/")[2] in {each.topic for each in OUR_DRIVER.inputs}
    for name, usable in usable_velocity.items():
        if name not in record.names or name not in inputs.names:
            continue
        readings = Readings.of(record, inputs, name, usable, effort.per_count_A)
        stretches = readings.stretches()
        if not stretches:
            continue
        gain = Gain.of(stretches)
        per_A = _effort_per_ampere(name, gain, effort, _units(effort, recording))
        if per_A is None:
            continue
        where = f"{recording.name}: by its effort"
        _refuse_gain(where, inputs.source, name, gain, per_A, effort, own)
        if own:
            _refuse_elsewhere(recording.name, inputs.source, readings, per_A.value)
            size = abs(per_A.value)
            delivered[name] = Quantity(abs(gain.value) / size, gain.std / size)
    return delivered


def _units(effort: Effort, recording: Recording) -> set[str]:
    """In which an effort may be, beside what was commanded.

    Only our driver takes currents as commands, and it publishes torque. An effort in A, which is 1.8 times as much, is taken beside
    such commands only where it is stated: else a command that is half of what flowed would look like one. An applied effort may
    stand beside another driver's joint states.
    """
    if recording.commanded is not None and effort.unit is not None:
        return {effort.unit}
    units = set(EFFORT_UNITS)
    currents = {each.topic for each in OUR_DRIVER.inputs if each.unit == "A"}
    inputs = recording.commanded or recording.inputs
    commanded = inputs is not None and inputs.source.rpartition("/")[2] in currents
    if commanded and effort.unit != "A":
        units.discard("A")
    return units


@dataclass(frozen=True)
class Readings:
    """Efforts of a joint, and the command that held at each."""

    joint: str
    times_s: FloatArray  # since the first reading [s], shape (T,)
    reading: FloatArray  # in the unit of the effort, NaN where there is none, shape (T,)
    given_A: FloatArray  # shape (T,)
    earlier_A: FloatArray  # the command that held `LATE_S` before, shape (T,)
    slow: BoolArray  # where the supply drives what is commanded, shape (T,)
    settled: BoolArray  # where the command has not changed for `SETTLED_S`, shape (T,)
    count_A: float  # to which currents are rounded at most [A]

    @classmethod
    def of(
        cls,
        record: JointRecord,
        inputs: InputRecord,
        name: str,
        usable: float,
        count_A: float = CURRENT_PER_COUNT_A,
    ) -> Readings:
        """Of one joint.

        Args:
            record: Joint states with efforts.
            inputs: What was commanded.
            name: The joint.
            usable: Velocity up to which the supply drives what is commanded [rad/s].
            count_A: To which currents are rounded at most [A].
        """
        column = record.column(name)
        assert record.reported_effort is not None
        command = inputs.current_A[:, inputs.column(name)]

        def held_at(times_ns: TimeArray) -> FloatArray:
            at = np.searchsorted(inputs.times_ns, times_ns, side="right") - 1
            held: FloatArray = np.where(
                at >= 0,
                command[at.clip(0)],
                0.0,
            )
            return held

        changed_ns = inputs.times_ns[np.flatnonzero(np.diff(command, prepend=0.0) != 0.0)]
        last = np.searchsorted(changed_ns, record.times_ns, side="right") - 1
        since_s = np.full(len(record.times_ns), np.inf)
        if len(changed_ns):
            since_s[last >= 0] = 1e-9 * (record.times_ns - changed_ns[last.clip(0)])[last >= 0]
        times_s = 1e-9 * (record.times_ns - record.times_ns[0])
        speed = np.abs(
            np.gradient(
                record.position[:, column],
                times_s,
            )
        )
        return cls(
            name,
            times_s,
            record.reported_effort[:, column],
            held_at(record.times_ns),
            held_at(record.times_ns - int(LATE_S * 1e9)),
            speed < usable,
            since_s >= SETTLED_S,
            count_A,
        )

    def stretches(self) -> list[Stretch]:
        """Where the joint is driven one way for long enough; none where it reads nothing but zero."""
        driven = np.abs(self.given_A) > ZERO_CURRENT_A
        way = np.sign(running_median(self.given_A, SIGN_READINGS)) * driven
        ends = np.flatnonzero(np.diff(way)) + 1
        found = []
        for rows in np.split(np.arange(len(way)), ends):
            # the first readings of a push may be older than it
            since_s = self.times_s[rows] - self.times_s[rows[0]]
            used = rows[(since_s >= SETTLED_S) & self.slow[rows] & np.isfinite(self.reading[rows])]
            if way[rows[0]] != 0.0 and len(used) >= FEWEST_OF_STRETCH:
                found.append(self._stretch(used))
        return found if any(each.reading for each in found) else []

    def _stretch(self, used: IndexArray) -> Stretch:
        commanded = float(self.given_A[used].mean())
        reading = self.reading[used]
        mean = float(reading.mean())
        # a motor follows a command that is not constant, or it does not: the smaller scatter is its own
        along = mean / commanded * self.given_A[used]
        scatter = min(
            float(reading.std()),
            float((reading - along).std()),
        )
        late = commanded - float(self.earlier_A[used].mean())
        # readings that are all alike are whole counts, however many their unit has
        count = self.count_A * abs(mean / commanded)
        steps = np.diff(np.unique(reading))
        rounded = min([count, *steps.tolist()]) / np.sqrt(12.0)
        return Stretch(
            commanded, late, mean, float(np.hypot(scatter / np.sqrt(len(used)), rounded))
        )


@dataclass(frozen=True)
class PerAmpere:
    """What effort a current of 1 A is."""

    unit: str
    value: float  # in that unit; negative where effort counts in the other direction


def _effort_per_ampere(
    name: str,
    gain: Gain,
    effort: Effort,
    units: Collection[str],
) -> PerAmpere | None:
    """In that of the units that fits best; None where none does.

    Args:
        name: Of the joint.
        gain: Effort per commanded current.
        effort: What it was made with.
        units: In which it may be. One alone is taken whether it fits or not.
    """
    per_A = {unit: 1.0 / ampere(unit, effort.per_count_A) for unit in EFFORT_UNITS if unit != "N.m"}
    if effort.nominal.get(name, 0.0) > 0.0:
        per_A["N.m"] = effort.nominal[name]
    per_A = {unit: value for unit, value in per_A.items() if unit in units}
    if not per_A or gain.value == 0.0:
        return None

    def away(unit: str) -> float:
        return abs(float(np.log(abs(gain.value) / per_A[unit])))

    unit = min(per_A, key=away)
    # effort in no unit that is known is compared with no command
    if len(units) > 1 and away(unit) > np.log(EFFORTS[unit].within):
        return None
    return PerAmpere(
        unit,
        float(np.copysign(per_A[unit], gain.value)),
    )


def _refuse_gain(
    where: str,
    source: str,
    name: str,
    gain: Gain,
    per_A: PerAmpere,
    effort: Effort,
    own: bool,
) -> None:
    """Raises RecordingError: effort and command differ by more than they may, and by more than chance."""
    ratio = gain.value / per_A.value
    unsure = gain.std / abs(per_A.value)
    if abs(ratio - 1.0) <= (CURRENT_OFF if own else TORQUE_OFF) + SURE_STDS * unsure:
        return
    made = f" (at {effort.nominal[name]:.3g} N m/A)" if per_A.unit == "N.m" else ""
    raise RecordingError(
        f"{where}{made}, {name} had {ratio:.2f} times the current of {source}, +- {unsure:.2f}: that is another recording's or in "
        "another unit, or the effort is: see --command-topic, --effort-unit and its nominal_torque_constant_N_m_per_A"
    )


def _refuse_elsewhere(
    where: str,
    source: str,
    readings: Readings,
    per_A: float,
) -> None:
    """Raises RecordingError: what is measured beside a command that stands still is mostly something else."""
    driven = np.abs(readings.given_A) > ZERO_CURRENT_A
    used = driven & readings.settled & readings.slow & np.isfinite(readings.reading)
    if int(used.sum()) < FEWEST_READINGS:
        return
    commanded = readings.given_A[used]
    off = readings.reading[used] / per_A - commanded
    scatter = MAD_TO_STD * float(np.median(np.abs(off - np.median(off))))
    spread = LEAST_CURRENT_A + 4.0 * min(scatter, LEAST_CURRENT_A)
    allowed = np.maximum(0.25 * np.abs(commanded), spread)
    far = float(np.mean(np.abs(off) > allowed))
    if far > ELSEWHERE_SHARE:
        raise RecordingError(
            f"the effort of {readings.joint} does not follow {source}: {100.0 * far:.0f} % of its readings are off by "
            "more than a quarter; is it the command of this recording, on the same clock?",
            where,
        )
