"""What was recorded, in SI units, as values that cannot be changed behind one's back.

Live and offline data meet here: the driver's messages and a bag both become a `JointRecord`, and from there on they take the same
way. Every class checks itself when it is made, so that the code that uses it need not: RecordingError says which shape, order or
value is wrong.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from proprio_ros.errors import RecordingError, one_line, printable
from proprio_ros.quantity import Quantity

FloatArray = NDArray[np.float64]
TimeArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
Span = tuple[int, int | None]
"""From when until before when a recording is read [ns], since its first joint state was recorded; None: to its end."""

MEASURED_EFFORT = "measured effort"
"""`InputRecord.source` when no command was recorded and the input is the current that the motors reported."""
STALL_CURRENT = "stall current"
"""How `InputRecord.source` begins where a voltage drives the motors and the input was made of it."""
ZERO_CURRENT_A = 1e-6  # A commanded current up to this is a command of zero [A].
TORQUE_OFF = "torque off"
"""`Run.source` of a free response: the current is zero because torque was off, whatever else was recorded."""
LOST_AFTER_PERIODS = 2.5
"""A gap longer than this many median periods means that messages were lost, not that one came late."""
MIN_SAMPLES = 5  # Joint states that a recording has at least.
IMPLAUSIBLE_POSITION = 50.0
"""No joint of an arm turns 50 rad or slides 50 m: such positions are degrees, millimetres or encoder counts."""
LONGEST_NAME = 255  # Characters of a joint's name.
INSTANT_S = 1e-6
"""Two stamps closer than this are the same instant: cycles are milliseconds apart, and stamps carry rounding [s]."""


def _is_frozen(values: Any, dtype: type) -> bool:
    """Whether it is an array as `_frozen` makes them, which nobody can change; of an hour a copy is 17 MB."""
    if not isinstance(values, np.ndarray) or values.dtype != dtype:
        return False
    flags = values.flags
    return bool(flags.owndata and flags.c_contiguous and not flags.writeable)


def _frozen(
    values: Any,
    dtype: type,
    what: str,
    shape: tuple[int, ...],
) -> NDArray[Any]:
    """Copy to a read-only array of the given shape (-1: any length)."""
    array: NDArray[Any]
    try:
        array = values if _is_frozen(values, dtype) else np.array(values, dtype=dtype, order="C")
    except (TypeError, ValueError) as error:
        raise RecordingError(
            f"{what}: expected numbers, got {type(values).__name__} ({error})"
        ) from error
    if array.ndim != len(shape) or any(
        want not in (-1, have) for have, want in zip(array.shape, shape, strict=True)
    ):
        raise RecordingError(
            f"{what}: expected shape {shape} (-1 is any length), got {array.shape}"
        )
    array.setflags(write=False)
    return array


def _keep(
    record: Any,
    field_name: str,
    what: str,
    shape: tuple[int, ...],
    dtype: type = np.float64,
) -> NDArray[Any]:
    """Put the frozen array in the place of what was given."""
    array = _frozen(getattr(record, field_name), dtype, what, shape)
    object.__setattr__(record, field_name, array)
    return array


def _names(names: Sequence[str], what: str) -> tuple[str, ...]:
    result = tuple(str(name) for name in names)
    repeated = [name for name, count in Counter(result).items() if count > 1]
    if repeated:
        raise RecordingError(
            f"{what}: joint {min(repeated)!r} is named twice; each joint needs one column"
        )
    for name in result:
        # they end up on terminals, in logs and in pages
        if not name.isprintable() or len(name) > LONGEST_NAME:
            raise RecordingError(
                f"{what}: '{one_line(name, 60)}' is no name of a joint: at most {LONGEST_NAME} printable characters"
            )
    return result


def _increasing(times: NDArray[Any], what: str) -> None:
    if times.size > 1 and not bool(np.all(np.diff(times) > 0)):
        raise RecordingError(
            f"{what}: times must increase strictly; sort them and drop repeated ones first"
        )


def _finite(values: NDArray[Any], what: str) -> None:
    if not bool(np.all(np.isfinite(values))):
        raise RecordingError(
            f"{what}: every value must be finite; drop the samples with NaN or infinity first"
        )


def _column(names: tuple[str, ...], name: str) -> int:
    if name not in names:
        raise RecordingError(
            f"joint {name!r} is not in the recording; recorded: {', '.join(names) or 'none'}"
        )
    return names.index(name)


def _show(record: Recording | Run) -> None:
    """Make what readers will see of it printable: folders and topics are named by others."""
    object.__setattr__(record, "name", printable(record.name))
    object.__setattr__(record, "notes", tuple(one_line(note) for note in record.notes))


@dataclass(frozen=True)
class JointRecord:
    """Joint states over time."""

    times_ns: TimeArray  # sampling instants [ns], strictly increasing, shape (T,)
    names: tuple[str, ...]  # joint names, one per column, unique
    position: FloatArray  # joint positions [rad or m], finite, shape (T, J)
    # joint velocities [rad/s or m/s], shape (T, J); NaN where a message gave none; None if none did
    velocity: FloatArray | None = None
    # joint efforts [N m or N], shape (T, J); NaN where a message gave none; None if unknown
    effort: FloatArray | None = None
    # measured motor currents [A], shape (T, J); NaN where unknown; None if unknown everywhere
    current: FloatArray | None = None
    # the effort field as it was recorded, with its stated sign, in whatever unit its driver used, shape (T, J); NaN where
    # a message gave none; None if none did. Good for "did the motor do as commanded", never for a torque.
    reported_effort: FloatArray | None = None
    turned: tuple[str, ...] = ()  # joints whose effort was multiplied by -1, as was stated

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", _names(self.names, "joint states"))
        times = _keep(self, "times_ns", "joint states: times_ns", (-1,), np.int64)
        _increasing(times, "joint states")
        for quantity in ("position", "velocity", "effort", "current", "reported_effort"):
            if getattr(self, quantity) is not None:
                _keep(self, quantity, f"joint states: {quantity}", (len(times), len(self.names)))
        _finite(self.position, "joint states: position")

    def kept(self, rows: BoolArray) -> JointRecord:
        """The samples of some rows, shape (T,)."""
        tables: Any = {
            name: values[rows]
            for name, values in vars(self).items()
            if isinstance(values, np.ndarray)
        }
        return replace(self, **tables)

    def column(self, name: str) -> int:
        """Column of a joint; RecordingError: it was not recorded."""
        return _column(self.names, name)


@dataclass(frozen=True)
class InputRecord:
    """Motor currents that drove the joints; each row holds until the next."""

    times_ns: TimeArray  # when each row begins to hold [ns], strictly increasing, shape (C,)
    names: tuple[str, ...]  # joint names, one per column, unique
    current_A: FloatArray  # motor current [A], finite, shape (C, J)
    source: str  # where it comes from: the topic's name, or `MEASURED_EFFORT`
    # what the source gives its numbers in, as for ``--effort-unit``; nominal torque constants made currents of torques
    unit: str = "A"

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", _names(self.names, "input"))
        times = _keep(self, "times_ns", "input: times_ns", (-1,), np.int64)
        _increasing(times, "input")
        _finite(
            _keep(
                self,
                "current_A",
                "input: current_A",
                (len(times), len(self.names)),
            ),
            "input: current_A",
        )

    @property
    def measured(self) -> bool:
        """Whether the input is what the motors reported, not what they were commanded."""
        return self.source == MEASURED_EFFORT

    @property
    def computed(self) -> bool:
        """Whether the input is the stall current of motors that a voltage drives."""
        return self.source.startswith(STALL_CURRENT)

    def column(self, name: str) -> int:
        """Column of a joint; RecordingError: it has none."""
        return _column(self.names, name)


@dataclass(frozen=True)
class DriveSignals:
    """What a bag holds of what drives servos that know no current, on the clock of the joint states."""

    # when each row of goals was sent [ns], shape (G,); empty where none was recorded
    goal_ns: TimeArray
    names: tuple[str, ...]  # of the joints, one per column
    goals: FloatArray  # [rad], NaN where a message gave none, shape (G, J)
    # voltage_ns, voltage_V: of the supply, shape (B,); empty where it was not recorded
    voltage_ns: TimeArray
    voltage_V: FloatArray

    def goal(self, joint: str) -> tuple[TimeArray, FloatArray]:
        """When one joint was sent [ns] and where [rad]; both empty where that was not recorded."""
        if joint not in self.names:
            return np.empty(0, dtype=np.int64), np.empty(0)
        column = self.goals[:, self.names.index(joint)]
        known = np.isfinite(column)
        return self.goal_ns[known], column[known]


@dataclass(frozen=True)
class Recording:
    """One recording: what the joints did, what drove them, and what had to be repaired."""

    name: str  # name of the bag, for messages and reports
    joints: JointRecord  # joint states
    inputs: InputRecord | None  # input currents; None when the recording has nothing about them
    notes: tuple[str, ...] = ()  # every repair made while reading, one sentence each
    # from when to when torque was off [ns], one pair per stretch, on the clock of the joint states
    torque_off_ns: tuple[tuple[int, int], ...] = ()
    # what stall currents are made of, where voltages drive motors; else None
    signals: DriveSignals | None = None
    # commands of this package's own topics, where measured efforts are the input; to compare the two, else None
    commanded: InputRecord | None = None
    # from when to when nothing is known, as where a clock steps [ns], on the clock of the joint states
    cuts_ns: tuple[tuple[int, int], ...] = ()

    def __post_init__(self) -> None:
        _show(self)


@dataclass(frozen=True)
class PointTrack:
    """Where something was seen over time, as by a camera."""

    # when, on the clock of the joint states [ns], strictly increasing, shape (N,)
    stamp_ns: TimeArray
    position: FloatArray  # where [m], shape (N, 3)

    def __post_init__(self) -> None:
        times = _keep(self, "stamp_ns", "stamps of points", (-1,), np.int64)
        _increasing(times, "stamps of points")
        _finite(_keep(self, "position", "points", (len(times), 3)), "points")

    @classmethod
    def of_seen(cls, stamp_ns: TimeArray, position: FloatArray) -> PointTrack:
        """Of points in any order; what was seen twice at one instant counts once."""
        order = np.argsort(stamp_ns, kind="stable")
        stamp_ns = stamp_ns[order]
        first = np.diff(stamp_ns, prepend=stamp_ns[:1] - 1) > 0
        return cls(stamp_ns[first], position[order][first])

    def of_run(self, run: Run) -> tuple[FloatArray, FloatArray]:
        """Times since a run's onset [s], shape (C,), and points, shape (C, 3), of those within the run."""
        times_s = 1e-9 * (self.stamp_ns - run.onset_ns).astype(np.float64)
        within = (times_s >= 0.0) & (times_s <= run.duration_s)
        return times_s[within], self.position[within]


@dataclass(frozen=True)
class Run:
    """One excitation: a joint starts at rest, a current drives it alone, the others are locked. Times count from its onset.

    Or one free response: torque went off, and gravity moves the joint from where and however fast it was. Its times count from
    the first sample used, its current is zero, and nothing is said of what was before.
    """

    name: str  # name of the recording, with the run's number behind it when there are several
    joint: str  # the driven joint
    onset_ns: int  # instant of the command's onset [ns]
    # sampling instants, 0 <= t <= duration_s [s], strictly increasing, shape (K,)
    times_s: FloatArray
    position: FloatArray  # positions of the driven joint [rad or m], shape (K,)
    # instants of the samples at rest before the onset, t < 0 [s], strictly increasing, shape (P,)
    before_times_s: FloatArray
    # positions of the driven joint at those instants [rad or m], shape (P,)
    before_position: FloatArray
    # mean position of every other joint from the first sample before the onset to the end [rad or m]
    held: dict[str, float]
    held_span: dict[str, float]  # largest minus smallest position of the same [rad or m]
    # when each current begins to hold [s], strictly increasing, starting at 0, shape (S,)
    input_times_s: FloatArray
    input_current_A: FloatArray  # current of the driven joint [A], neighbours differ, shape (S,)
    duration_s: float  # end of the non-zero current [s]
    source: str  # where the input comes from, as in `InputRecord.source`
    # what a reader of the result should know about this run, one sentence each
    notes: tuple[str, ...] = ()
    # the driven joint's effort field at ``times_s``, in its driver's unit, shape (K,); None if not recorded
    reported_effort: FloatArray | None = None
    # positions of the other joints at ``before_times_s`` and then ``times_s`` [rad or m], shape (P + K,) each; those
    # that were not recorded are missing
    held_position: Mapping[str, FloatArray] = field(default_factory=dict)
    # instants of the samples after the end, t > duration_s [s], strictly increasing, shape (A,)
    after_times_s: FloatArray = field(default_factory=lambda: np.zeros(0))
    # positions of the driven joint at those instants [rad or m], shape (A,). No fit follows them.
    after_position: FloatArray = field(default_factory=lambda: np.zeros(0))
    # current by the driven joint's measured effort over what was commanded; None where nothing says it
    delivered: Quantity | None = None

    @property
    def is_free_response(self) -> bool:
        """Whether it is a free response: nothing but gravity and friction moves the joint."""
        return self.source == TORQUE_OFF

    def __post_init__(self) -> None:
        _show(self)
        run = f"run {self.name}"
        for name, of in (
            ("times_s", "position"),
            ("before_times_s", "before_position"),
            ("after_times_s", "after_position"),
            ("input_times_s", "input_current_A"),
        ):
            times = _keep(self, name, f"{run}: {name}", (-1,))
            values = _keep(self, of, f"{run}: {of}", (len(times),))
            _finite(times, f"{run}: {name}")
            _finite(values, f"{run}: {of}")
            _increasing(times, f"{run}: {name}")
        held = {}
        count = len(self.before_times_s) + len(self.times_s)
        for joint, values in self.held_position.items():
            held[joint] = _frozen(values, np.float64, f"{run}: held_position of {joint}", (count,))
            _finite(held[joint], f"{run}: held_position of {joint}")
        object.__setattr__(self, "held_position", held)
        if not np.isfinite(self.duration_s) or self.duration_s <= 0.0:
            raise RecordingError(f"{run}: duration must be positive, got {self.duration_s} s")
        if self.times_s.size and (self.times_s[0] < 0.0 or self.times_s[-1] > self.duration_s):
            raise RecordingError(f"{run}: samples must lie between 0 and {self.duration_s} s")
        if self.before_times_s.size and self.before_times_s[-1] >= 0.0:
            raise RecordingError(f"{run}: samples before the onset must have negative times")
        if self.after_times_s.size and self.after_times_s[0] <= self.duration_s:
            raise RecordingError(
                f"{run}: samples after the end must come after {self.duration_s} s"
            )
        if self.input_times_s.size == 0 or self.input_times_s[0] != 0.0:
            raise RecordingError(f"{run}: the input must start at time 0")
