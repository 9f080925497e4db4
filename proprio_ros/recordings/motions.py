"""Motions taken from a recording: joints move under whatever controller, and the motors' currents are known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from proprio_ros.errors import RecordingError, TooLittleMotion
from proprio_ros.recordings.repeats import repeated
from proprio_ros.recordings.sign_bits import hint_of
from proprio_ros.recordings.unmeasured import Measured, measured_only
from proprio_ros.records import STALL_CURRENT, BoolArray, FloatArray, Recording
from proprio_ros.robot.drives import COMPUTED

MOVED_RAD = 0.05
"""A joint that moves less than this in a whole recording stands still: its friction may carry any part of the load [rad]."""
SHORTEST_S = 3.0  # a shorter motion says nothing about how well it is explained [s]
SLOWEST_HZ = 20.0  # below this rate a motion of half a second has no shape
RATE_ROUNDING = 0.005  # stamps are rounded, and no quartz is off by more
LARGEST_STEP_RAD = 1.0
"""No arm turns that far between two samples; angles whose steps are smaller once they are unwrapped did wrap around."""
MEASURED = "measured current"
"""`Motion.source` where the motors reported what flowed."""
LONGEST_GAP_S = 0.1  # across a longer gap nobody knows how the arm moved [s]


@dataclass(frozen=True)
class Motion:
    """Joints that moved, and the currents that drove them."""

    name: str  # of the recording
    joints: tuple[str, ...]  # that have a motor, one per column
    times_s: FloatArray  # from the first sample on [s], strictly increasing, shape (T,)
    position: FloatArray  # [rad], shape (T, J)
    current_A: FloatArray  # of the motors, shape (T, J); NaN where nobody measured it
    held: Mapping[str, float]  # mean position of every other joint [rad or m]
    source: str  # where the currents come from
    notes: tuple[str, ...] = ()  # what a reader of the result should know, one sentence each
    left_out: tuple[str, ...] = ()  # of these, what is said of efforts that nobody measured
    begin_ns: int = 0  # stamp of the first sample [ns]; 0: not known
    # position of every other joint that was recorded, at the same times [rad or m], shape (T,) each
    beside: Mapping[str, FloatArray] = field(default_factory=dict)
    clock_off: tuple[str, ...] = ()  # of its notes, what is said of a clock that was followed
    # how well its clock is known: of the logarithm of its pace, and of how late currents are [s]; one standard deviation
    pace_std: float = 0.0
    lag_std_s: float = 0.0
    turned: tuple[str, ...] = ()  # joints whose effort was multiplied by -1, as was stated

    @property
    def made_of_goals(self) -> bool:
        """Whether the currents were not measured, but made of goals or duty cycles, and of the supply."""
        return self.source.startswith(STALL_CURRENT)

    @property
    def made_by_law(self) -> bool:
        """Whether they were made of goals, by the servo's law: then they are wrong while a goal is late."""
        return self.made_of_goals and COMPUTED in self.source

    @property
    def moved(self) -> tuple[str, ...]:
        """The joints that did not stand still, and whose current was measured."""
        moved = (np.ptp(self.position, axis=0) > MOVED_RAD) & np.isfinite(self.current_A).any(
            axis=0
        )
        return tuple(name for name, each in zip(self.joints, moved, strict=True) if each)

    def part(self, rows: BoolArray | slice) -> Motion:
        """Some of its samples; times count from the first of them."""
        times_s = self.times_s[rows]
        return replace(
            self,
            times_s=times_s - times_s[0],
            position=self.position[rows],
            current_A=self.current_A[rows],
            beside={joint: values[rows] for joint, values in self.beside.items()},
        )

    def complete(self) -> Motion:
        """Those samples in which all currents were measured.

        Raises `RecordingError`: There are none.
        """
        known = np.asarray(np.isfinite(self.current_A).all(axis=1))
        if known.all():
            return self
        if not known.any():
            absent = np.asarray(np.isnan(self.current_A).all(axis=0))
            names = [name for name, each in zip(self.joints, absent, strict=True) if each]
            raise RecordingError(
                f"the effort of {', '.join(names) or 'some joint'} was never measured together with that of the "
                "others: does its driver publish it?",
                self.name,
            )
        return self.part(known)


def motion_of(
    recording: Recording,
    *,
    joints: Sequence[str],
    held: Mapping[str, float] | None = None,
    standing: bool = False,
) -> Motion:
    """The whole recording as one motion, with measured currents where there are any: a command is reached late, and not quite.

    Of the joints that have a motor and turn; ``held`` are positions of others that are not recorded, or that replace
    recorded ones [rad or m]; ``standing``: it is of use where none of them moves, too.

    Raises:
        RecordingError: A joint, its current or enough samples are missing.
        TooLittleMotion: Nothing moves.
    """
    record = recording.joints
    name = recording.name
    missing = [joint for joint in joints if joint not in record.names]
    if missing:
        raise RecordingError(
            f"the position of {missing[0]} was not recorded; recorded: {', '.join(record.names)}: is it another arm's?",
            name,
        )
    notes = list(recording.notes)
    recording = _without_repeats(recording, joints, notes)
    record = recording.joints
    times_s = 1e-9 * (record.times_ns - record.times_ns[0]).astype(np.float64)
    _check_times(times_s, name)
    position = _unwrapped(
        times_s,
        record.position[:, [record.column(joint) for joint in joints]],
        joints,
        name,
        notes,
    )
    current, source = _current(recording, joints, notes)
    left_out: tuple[str, ...] = ()
    if source == MEASURED:
        measured = _measured(name, joints, times_s, position, current)
        current = measured.current_A
        left_out = measured.notes
    others = [joint for joint in record.names if joint not in joints]
    motion = Motion(
        name=name,
        joints=tuple(joints),
        times_s=times_s - times_s[0],
        position=position,
        current_A=current,
        held={joint: float(record.position[:, record.column(joint)].mean()) for joint in others}
        | dict(held or {}),
        source=source,
        notes=(
            *notes,
            *left_out,
            *_repeats_command(recording, joints, source),
        ),
        left_out=left_out,
        begin_ns=int(record.times_ns[0]),
        beside={joint: record.position[:, record.column(joint)] for joint in others},
        turned=record.turned,
    )
    if not (standing or motion.moved):
        raise TooLittleMotion(
            f"no joint moved by more than {MOVED_RAD} rad: record the arm while it moves; a hand that stands still is "
            "weighed roughly, with the --calibration of an arm that was calibrated by motions (docs: payload, at rest)",
            name,
        )
    return motion


def _without_repeats(
    recording: Recording,
    joints: Sequence[str],
    notes: list[str],
) -> Recording:
    """The same without joint states that only repeat the one before."""
    record = recording.joints
    everywhere = np.ones(len(record.times_ns), dtype=bool)
    repeats = repeated(
        record,
        everywhere,
        [record.column(joint) for joint in joints],
    )
    if not repeats.any():
        return recording
    kept = record.kept(~repeats)
    rate_Hz = 1e9 / float(np.median(np.diff(kept.times_ns)))
    many = (
        f"{recording.name}: {int(repeats.sum())} of {len(repeats)} joint states repeat the one before although joints move: they "
        f"are published faster than they are measured, at {rate_Hz:.3g} Hz"
    )
    if rate_Hz < SLOWEST_HZ:
        notes.append(f"{many}; what lies between readings is not known so well")
        return recording
    notes.append(f"{many}; the repeats were left out")
    return replace(recording, joints=kept)


def _current(
    recording: Recording, joints: Sequence[str], notes: list[str]
) -> tuple[FloatArray, str]:
    """Currents of the motors [A], shape (T, J), NaN where they are not known; and where they come from."""
    record = recording.joints
    inputs = recording.inputs
    name = recording.name
    columns = [record.column(joint) for joint in joints]
    if record.current is not None and np.isfinite(record.current[:, columns]).any():
        source = inputs.source if inputs is not None and inputs.computed else MEASURED
        return record.current[:, columns], source
    if inputs is None:
        raise RecordingError(
            "the recording holds no current; state the unit of its effort with --effort-unit", name
        )
    absent = [joint for joint in joints if joint not in inputs.names]
    if absent:
        raise RecordingError(
            f"{inputs.source} has no current of {absent[0]}; it has: {', '.join(inputs.names)}",
            name,
        )
    row = np.clip(
        np.searchsorted(inputs.times_ns, record.times_ns, side="right") - 1,
        0,
        None,
    )
    notes.append(
        f"{name}: no measured current was recorded, so the commanded one counts as what flowed; what a controller commands "
        "and what flows differ by some percent (state --effort-unit if the effort is a measured one)"
    )
    return inputs.current_A[row][:, [inputs.column(joint) for joint in joints]], inputs.source


def _measured(
    name: str,
    joints: Sequence[str],
    times_s: FloatArray,
    position: FloatArray,
    current_A: FloatArray,
) -> Measured:
    """The currents that were measured, shape (T, J), with notes that name the recording.

    Raises `RecordingError`: None was, or too few for a motion.
    """
    found = measured_only(joints, times_s, position, current_A)
    notes = [f"{name}: {note}" for note in found.notes]
    missing = int(np.isnan(current_A).any(axis=1).sum())
    if missing:
        notes.append(f"{name}: {missing} samples without a measured current were left out")
    known = np.isfinite(found.current_A).any(axis=1)
    seconds = float(known.mean() * times_s[-1])
    if seconds < SHORTEST_S and notes:
        raise RecordingError(
            f"{notes[0]}; {seconds:.1f} s are left, record at least {SHORTEST_S:g} s: does the driver publish what its motors "
            "measure, also after controllers were switched?"
        )
    return Measured(found.current_A, tuple(notes))


def _check_times(times_s: FloatArray, name: str) -> None:
    """Raises: RecordingError: The samples are too few, too seldom, or lie too far apart."""
    lasted = 0.0 if len(times_s) < 2 else times_s[-1] - times_s[0]
    if lasted < SHORTEST_S:
        raise RecordingError(
            f"the motion lasts {lasted:.1f} s; record at least {SHORTEST_S:g} s, better 15", name
        )
    intervals = np.diff(times_s)
    rate_hz = 1.0 / float(np.median(intervals))
    # a period that is written in whole ms or ns is not one of 20 Hz to the last digit
    if rate_hz < SLOWEST_HZ * (1.0 - RATE_ROUNDING):
        raise RecordingError(
            f"joint states come at {rate_hz:.3g} Hz; a motion needs {SLOWEST_HZ:g} Hz at least",
            name,
        )
    lost_s = float(intervals[intervals > LONGEST_GAP_S].sum())
    if lost_s > 0.5 * times_s[-1]:
        raise RecordingError(
            f"{lost_s:.0f} of {lasted:.0f} s lie in gaps between joint states", name
        )


def _unwrapped(
    times_s: FloatArray,
    position: FloatArray,
    joints: Sequence[str],
    name: str,
    notes: list[str],
) -> FloatArray:
    """The same without jumps by full turns [rad], shape (T, J); a joint that jumps otherwise is refused.

    How far a joint turned in a gap nobody knows, and nothing is made of it.
    """
    gaps = np.diff(times_s) > LONGEST_GAP_S
    turned = np.unwrap(position, axis=0)
    jumps = np.abs(np.diff(position, axis=0))[~gaps] > np.pi
    wrapped = np.asarray(jumps.any(axis=0))
    steps = np.abs(np.diff(turned, axis=0))
    if wrapped.any() and steps[~gaps].max() < LARGEST_STEP_RAD:
        whole = [joint for joint, column in zip(joints, wrapped, strict=True) if column]
        notes.append(f"{name}: the angle of {', '.join(whole)} wraps around; it was unwrapped")
        position = np.where(wrapped, turned, position)
    if gaps.any() and (steps[gaps] * wrapped).max() > LARGEST_STEP_RAD:
        row = int(np.flatnonzero(gaps)[(steps[gaps] * wrapped).max(axis=1).argmax()])
        far = steps[row] * wrapped > LARGEST_STEP_RAD
        unknown = [joint for joint, each in zip(joints, far, strict=True) if each]
        took_s = float(times_s[row + 1] - times_s[row])
        since_s = float(times_s[row] - times_s[0])
        raise RecordingError(
            f"no joint states came for {took_s:.2f} s after {since_s:.1f} s, and of joints whose angle wraps around "
            f"{', '.join(unknown)} turned meanwhile by nobody knows how much: give the part before that gap or behind it, "
            "--span FROM:TO",
            name,
        )
    largest = np.abs(np.diff(position, axis=0)[~gaps]).max(axis=0)
    if largest.max() > LARGEST_STEP_RAD:
        raise RecordingError(
            f"{joints[int(largest.argmax())]} jumps by {largest.max():.2f} rad between two samples, which no joint does: angles "
            "that wrap around otherwise than by a turn must be unwrapped first, and degrees converted to rad"
            f"{hint_of(largest.max())}",
            name,
        )
    return position


def _repeats_command(
    recording: Recording,
    joints: Sequence[str],
    source: str,
) -> tuple[str, ...]:
    """A note on joints whose measured current is the command, as simulators and some drivers publish it."""
    record = recording.joints
    inputs = recording.inputs
    if source != MEASURED or inputs is None or inputs.measured or record.current is None:
        return ()
    row = np.searchsorted(inputs.times_ns, record.times_ns, side="right") - 1
    alike = []
    for joint in set(joints) & set(inputs.names):
        measured = record.current[row >= 0, record.column(joint)]
        commanded = inputs.current_A[row[row >= 0], inputs.column(joint)]
        same = np.isclose(measured, commanded, rtol=1e-6, atol=1e-9)
        if len(np.unique(commanded)) > 20 and np.mean(same) > 0.99:
            alike.append(joint)
    if not alike:
        return ()
    return (
        f"{recording.name}: the measured effort of {', '.join(sorted(alike))} is the command to the last digit: nobody measured "
        "it, and what the motor did instead is not known",
    )
