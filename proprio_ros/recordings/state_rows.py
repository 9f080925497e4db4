"""From messages of joint states to one row a message and one column a joint, in steps; every repair is noted.

Joints may be spread over several messages (arm and gripper from two publishers). The rows are then the messages that have the
driven joint, or most of the arm where none is driven by itself; what others report in between is interpolated, since a locked joint
hardly moves, while an interpolated sample of a driven joint would pretend to be a measurement.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from proprio_ros.errors import RecordingError
from proprio_ros.recordings.clock_faults import is_counted
from proprio_ros.recordings.columns import JointColumns
from proprio_ros.recordings.noted import Noted, count_of
from proprio_ros.recordings.pace import rate_by_velocities
from proprio_ros.recordings.sign_bits import hint_of, without_sign_bits
from proprio_ros.recordings.stamps import order_of, sent_at, times_of
from proprio_ros.records import (
    IMPLAUSIBLE_POSITION,
    LOST_AFTER_PERIODS,
    MIN_SAMPLES,
    BoolArray,
    FloatArray,
    TimeArray,
)

REGISTER, LARGEST_COUNT = 65536, 4096
"""Values of a register of 16 bits, and what no motor's current, duty or load in counts exceeds."""
# fewer messages than this with impossible numbers are left out; more have another unit
GARBAGE_SHARE = 0.05
LARGEST = {"position": IMPLAUSIBLE_POSITION, "velocity": 1e6, "effort": 1e9}
"""Numbers beyond are of unwritten memory, by quantity, in SI units."""
SHORTEST_PERIOD_S, LONGEST_PERIOD_S = 1e-4, 5.0
"""Joint states that come faster or slower have stamps in another unit."""
MOSTLY = 0.5  # a joint that more of the rows have than this must be in each of them


@dataclass(frozen=True)
class StateRows:
    """Joint states, a row each."""

    noted: Noted  # where they were recorded, and what was repaired so far
    times_ns: TimeArray  # (T,)
    names: tuple[str, ...]  # of the joints, (J,)
    values: Mapping[str, FloatArray]  # by quantity: position, velocity, effort; (T, J)
    driven: Sequence[str]  # joints that the input drives
    expected: Sequence[str]  # joints of the robot, and those that are driven
    heard: int  # messages that there were

    @property
    def position(self) -> FloatArray:
        """Of the joints [rad or m], not finite where unknown, shape (T, J)."""
        return self.values["position"]

    def kept(self, rows: BoolArray) -> StateRows:
        """Some of the rows."""
        if rows.all():
            return self
        values = {quantity: table[rows] for quantity, table in self.values.items()}
        return replace(self, times_ns=self.times_ns[rows], values=values)


def state_rows(
    columns: JointColumns, noted: Noted, driven: Sequence[str], joints: Sequence[str]
) -> StateRows:
    """One row per usable message in the order of time, one column per joint that has a position.

    Args:
        columns: Messages as they were recorded, their clocks mended.
        noted: Where they were recorded; a sentence is added for each repair.
        driven: Joints that the input drives.
        joints: Joints of the robot that have a motor.

    Returns:
        The rows, at least `MIN_SAMPLES`.

    Raises:
        RecordingError: Too few messages are usable, or their times or positions are in another unit.
    """
    expected = [*joints, *driven]
    times_ns = times_of(columns, noted)
    rows = StateRows(
        noted, times_ns, columns.names, columns.values, driven, expected, len(times_ns)
    )
    for step in STEPS:
        rows = step(rows)
    return rows


def in_order(rows: StateRows) -> StateRows:
    """The rows in the order of time, with the joints that ever have a position."""
    order = order_of(rows.times_ns, rows.noted)
    usable = np.any(np.isfinite(rows.position), axis=0)  # (J,)
    names = tuple(name for name, column in zip(rows.names, usable, strict=True) if column)
    never = [name for name in rows.names if name not in names]
    if never:
        rows.noted.note(f"{', '.join(never)} never has a finite position and was left out.")
    if usable.all() and (np.diff(order) == 1).all():
        return rows
    values = {quantity: table[np.ix_(order, usable)] for quantity, table in rows.values.items()}
    return replace(
        rows,
        times_ns=rows.times_ns[order],
        names=names,
        values=values,
    )


def without_sign_bits_of_counts(rows: StateRows) -> StateRows:
    """The same with positions whose sign is in a bit of their count decoded."""
    times_s = 1e-9 * (rows.times_ns - rows.times_ns[0]).astype(np.float64)
    position = rows.position.copy()
    without_sign_bits(
        times_s,
        position,
        rows.names,
        rows.expected,
        rows.noted.notes,
    )
    return replace(rows, values={**rows.values, "position": position})


def without_garbage(rows: StateRows) -> StateRows:
    """The same without positions of messages with numbers from unwritten memory; where many are, the unit is wrong."""
    joints = np.isin(rows.names, rows.expected)  # (J,)
    garbage = np.zeros(len(rows.position), dtype=bool)  # (T,)
    for quantity, limit in LARGEST.items():
        garbage |= (np.abs(rows.values[quantity][:, joints]) > limit).any(axis=1)
    if garbage.mean() >= GARBAGE_SHARE:
        garbage = np.zeros_like(garbage)
    rows.noted.count(garbage, "messages hold numbers that no joint can have and were left out")
    if not rows.names:
        raise RecordingError(
            f"{rows.noted.topic} has no finite position in {rows.heard} messages; check the driver",
            rows.noted.path,
        )
    position = rows.position.copy()
    position[garbage] = np.nan
    return replace(rows, values={**rows.values, "position": position})


def complete(rows: StateRows) -> StateRows:
    """The rows that have all joints which move; what others report in between is interpolated."""
    position = rows.position.copy()
    given = np.isfinite(position)  # (T, J)
    needed = _needed(rows, given)  # (J,)
    whole = given[:, needed].all(axis=1)  # (T,)
    broken = ~whole & np.isinf(position[:, needed]).any(axis=1)
    rows.noted.count(broken, "messages have NaN or infinite positions and were left out")
    partial = ~whole & ~broken & given[:, needed].any(axis=1)
    rows.noted.count(partial, "messages lack some of the joints and were left out")
    since_ns = rows.times_ns - rows.times_ns[0]
    for column in np.flatnonzero(~given[whole].all(axis=0)):
        known = given[:, column]
        known_ns, first = np.unique(since_ns[known], return_index=True)
        position[whole, column] = np.interp(
            since_ns[whole], known_ns, position[known, column][first]
        )
        rows.noted.note(
            f"{rows.names[column]} is in {count_of(known)} messages; between them it was interpolated."
        )
    return replace(
        rows,
        values={
            **rows.values,
            "position": position,
        },
    ).kept(whole)


def _needed(rows: StateRows, given: BoolArray) -> BoolArray:
    """The joints that a row must have, by whether each row has it, shape (T, J): those driven, and those mostly beside them."""
    needed = np.isin(rows.names, rows.driven)
    if not needed.any():
        needed[_of_most_of_the_arm(rows, given)] = True
    base = given[:, needed].all(axis=1)
    if base.any():
        needed |= given[base].mean(axis=0) > MOSTLY
    return np.asarray(needed)


def _of_most_of_the_arm(rows: StateRows, given: BoolArray) -> int:
    """The joint whose messages tell most of the robot, by whether each row has it, shape (T, J).

    A gripper's driver may publish more messages than the arm's.
    """
    of_robot = np.isin(rows.names, rows.expected)
    if not of_robot.any():
        of_robot[:] = True
    together = given[:, of_robot].sum(axis=1)
    told = np.square(together) @ given
    return int(np.argmax(np.where(of_robot, told, -1)))


def evenly_sent(rows: StateRows) -> StateRows:
    """The same at the times at which messages that came in bursts were sent."""
    return replace(rows, times_ns=sent_at(rows.times_ns, rows.noted))


def without_repeats(rows: StateRows) -> StateRows:
    """The first row of each time. Raises `RecordingError`: Too few are left."""
    times_ns = rows.times_ns
    repeated = np.diff(times_ns, prepend=times_ns[:1] - 1) == 0
    rows.noted.count(repeated, "stamps are repeated; the first message of each was kept")
    count = int((~repeated).sum())
    if count < MIN_SAMPLES:
        raise RecordingError(
            f"only {count} of {rows.heard} messages of {rows.noted.topic} are usable, at least {MIN_SAMPLES} "
            f"are needed ({' '.join(rows.noted.notes) or 'the recording is too short'})",
            rows.noted.path,
        )
    return rows.kept(~repeated)


def with_gaps_noted(rows: StateRows) -> StateRows:
    """The same; a note says where messages were lost."""
    gaps_ns = np.diff(rows.times_ns)
    period_ns = np.median(gaps_ns)
    lost = int(np.sum(gaps_ns > LOST_AFTER_PERIODS * period_ns))
    if lost:
        rows.noted.note(
            f"messages were lost: {lost} gaps of more than {LOST_AFTER_PERIODS:g} periods ({period_ns / 1e6:.1f} ms), the longest "
            f"{gaps_ns.max() / 1e6:.0f} ms."
        )
    return rows


def in_seconds(rows: StateRows) -> StateRows:
    """The same. Raises `RecordingError`: No joint states come so often, or so seldom."""
    intervals_ns = np.diff(rows.times_ns)
    period_s = 1e-9 * float(np.median(intervals_ns))
    counted = is_counted(intervals_ns)
    if SHORTEST_PERIOD_S < period_s < LONGEST_PERIOD_S and not counted:
        return rows
    where = f"{rows.noted.path}: {rows.noted.topic}"
    if period_s <= SHORTEST_PERIOD_S < 1e-9 * float(np.mean(intervals_ns)):
        raise RecordingError(
            f"{where} comes in bursts, stamped when they arrived, of which there are too few to know when each message was sent: "
            "let the driver stamp each as it is read"
        )
    rate_Hz = rate_by_velocities(rows.position, rows.values["velocity"])
    likely = f"; by its velocities {rate_Hz:.3g} messages came in a second" if rate_Hz else ""
    what = f"comes every {period_s:.2g} s: its time stamps are not in s and ns"
    if counted:
        what = "has row numbers (0, 1, 2 ..) for time stamps, not seconds"
    raise RecordingError(f"{where} {what}{likely}: stamp messages by a clock")


def in_radians(rows: StateRows) -> StateRows:
    """The same. Raises `RecordingError`: One of the robot's joints stands where none can; others may be wheels."""
    for name, values in zip(rows.names, rows.position.T, strict=True):
        size = np.abs(values)
        if name in rows.expected and size.max() > IMPLAUSIBLE_POSITION:
            raise RecordingError(
                f"{name} stands at {values[np.argmax(size)]:.6g}, which is no angle in rad nor a length in m; "
                "the publisher seems to use degrees, millimetres or encoder counts: convert the positions to rad and m"
                f"{hint_of(size.min())}",
                rows.noted.path,
            )
    return rows


def with_signed_efforts(rows: StateRows) -> StateRows:
    """The same with negative counts of a 16-bit register that were read as unsigned, and lie far above all others."""
    effort = rows.values["effort"]
    negative = (effort >= REGISTER - LARGEST_COUNT) & (effort < REGISTER)
    with np.errstate(invalid="ignore"):
        others = np.abs(np.where(negative, 0.0, effort))
        whole = np.isnan(effort) | (effort == np.round(effort))
    small = whole & (np.isnan(others) | (others <= LARGEST_COUNT))
    columns = negative.any(axis=0) & small.all(axis=0)  # (J,)
    if not columns.any():
        return rows
    which = ", ".join(name for name, column in zip(rows.names, columns, strict=True) if column)
    rows.noted.notes.append(
        f"effort of {which}: {count_of(negative & columns)} values of {REGISTER - LARGEST_COUNT} and more beside small ones are "
        f"negative numbers of a 16-bit register that was read as unsigned; {REGISTER} was subtracted from them."
    )
    signed = np.where(negative & columns, effort - REGISTER, effort)
    return replace(rows, values={**rows.values, "effort": signed})


STEPS: tuple[Callable[[StateRows], StateRows], ...] = (
    in_order,
    without_sign_bits_of_counts,
    without_garbage,
    complete,
    evenly_sent,
    without_repeats,
    with_gaps_noted,
    in_seconds,
    in_radians,
    with_signed_efforts,
)
"""What is done about joint states, one step after the other."""
