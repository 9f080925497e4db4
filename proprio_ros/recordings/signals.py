"""Joint states and input of a ROS 2 bag as a `Recording`, without ROS.

A foreign bag is repaired where the repair is certain, and every repair is noted in `Recording.notes`; where it would be
a guess the user is asked.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import groupby, pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from proprio_ros import records
from proprio_ros.errors import RecordingError, printable
from proprio_ros.recordings.arrivals import of_bursts
from proprio_ros.recordings.clocks import Clock, clock_of, is_counted
from proprio_ros.recordings.columns import JointColumns, array_columns, joint_state_columns
from proprio_ros.recordings.contradictions import refuse_pace
from proprio_ros.recordings.effort import (
    CURRENT_PER_COUNT_A,
    EFFORT_UNITS,
    Effort,
    ampere,
    held,
    known_or_none,
)
from proprio_ros.recordings.messages import stamp_ns
from proprio_ros.recordings.pace import rate_by_velocities
from proprio_ros.recordings.publishers import of_one_publisher
from proprio_ros.recordings.reader import Bag, open_bag
from proprio_ros.recordings.sign_bits import hint_of, without_sign_bits
from proprio_ros.recordings.topics import (
    BATTERY,
    BATTERY_STATE,
    BOOL,
    JOINT_COMMAND,
    JOINT_STATE,
    OUR_DRIVER,
    TORQUE_ENABLED,
    Conventions,
    InputTopic,
    Topic,
    listed,
)

REGISTER, LARGEST_COUNT = 65536, 4096
"""Values of a register of 16 bits, and what no motor's current, duty or load in counts exceeds."""
IMPLAUSIBLE_SPEED = 10.0
"""rad/s or m/s: no joint of an arm gets that fast there and back between a few samples; a damaged number does."""
# samples in a row that may be damaged: more that agree with each other are a slipped encoder
LONGEST_JUMP = 3
MOST_JUMPS = 0.2  # of the joint states may jump there and back: more are another motion's
# fewer messages than this with impossible numbers are left out; more have another unit
GARBAGE_SHARE = 0.05
FOREIGN_CLOCK_NS = 500_000_000
"""Header stamps further than this from the recorder's time come from another clock (simulated time, another host)."""

# joint states that come faster or slower have stamps in another unit
SHORTEST_PERIOD_S = 1e-4
LONGEST_PERIOD_S = 5.0

CLOCK_STEPS = "the clock steps; set clocks before the drivers start, and record again"
_NO_TIMES: records.TimeArray = np.empty(0, dtype=np.int64)


class _Asked(NamedTuple):
    """How a bag is read; as for `read_recording`."""

    conventions: Conventions
    effort: Effort
    joint_order: Sequence[str]
    clock: Clock = Clock()


def read_recording(
    path: str | Path,
    *,
    state_topic: str | None = None,
    command_topic: str | None = None,
    effort_unit: str | None = None,
    nominal_torque_constants: Mapping[str, float],
    joint_order: Sequence[str],
    current_per_count_A: float = CURRENT_PER_COUNT_A,
    states_only: bool = False,
    conventions: Conventions = OUR_DRIVER,
    span: records.Span | None = None,
) -> records.Recording:
    """Read joint states and input currents from a ROS 2 bag.

    The input comes from the topics that the driver's conventions name (ours: /applied_effort, else /current_command), else from
    measured effort.

    Args:
        path: As for `open_bag`.
        state_topic: Topic of the joint states; None takes /joint_states, also under a namespace, else the only one.
        command_topic: Topic of the input: sensor_msgs/JointState with effort = commanded current x nominal torque
            constant [N m or N], or std_msgs/Float64MultiArray of currents [A]; None looks for the usual ones. Where the conventions
            have an input of that type, its unit and its order of joints hold.
        effort_unit: What effort of the joint states means: 'N.m', 'A', 'mA' or 'raw'; None: not stated, never guessed.
        nominal_torque_constants: By joint; the ones with which effort was published [N m/A or N/A].
        joint_order: Of an unlabelled current command.
        current_per_count_A: Of a raw count [A].
        states_only: Whether to leave the input out, whatever there is of it.
        conventions: Of the driver that published.
        span: The part that is read, by the recorder's times; None: all. A command that was given before it is not known.

    Returns:
        The recording, on the clock of the joint states' header stamps. `joints.effort` is set only for effort_unit
        'N.m' and `joints.current` only where effort_unit says which; `inputs` is None when nothing about the input was
        recorded, or only an effort of an unstated unit beside a known stretch without torque (see `torque_off_ns`).

    Raises:
        RecordingError: The bag cannot be read, or does not hold what is needed.
        ConfigurationError: Unknown effort_unit.
    """
    effort = Effort(effort_unit, nominal_torque_constants, current_per_count_A)
    path = Path(path)
    asked = _Asked(conventions, effort, joint_order)
    inputs = beside = None
    with open_bag(path) as bag:
        state = bag.topics.states(state_topic, command_topic, conventions)
        bag.cut(state, span)
        command = None if states_only else bag.topics.input(command_topic, state, conventions)
        quantities = ["position", "velocity", "effort"]
        columns = joint_state_columns(bag, state, quantities, conventions)
        # parts whose times come twice look like two publishers, and two publishers may hide a step
        before = clock_of(state.name, columns)
        columns = of_one_publisher(f"{path}: {state.name}", before.mended(columns))
        if not states_only:
            refuse_prefix(path, columns.names, joint_order)
        behind = clock_of(state.name, columns)
        columns = behind.mended(columns)
        clock = before.then(behind)
        asked = asked._replace(clock=clock)
        pace = refuse_pace(f"{path}: {state.name}", columns)
        notes = [*columns.notes, *clock.notes, *pace]
        if command is not None and command[0] != state:
            inputs = _commands(bag, *command, columns, asked, notes)
        elif not states_only and (own := bag.topics.input(None, state)) is not None:
            beside = _commands(bag, *own, columns, asked, [])
        torque_off = _torque_off(bag, state, columns, clock, notes)
        notes = bag.notes + notes
    record = _joint_record(path, state, columns, inputs, asked, notes)
    # zero current needs no unit
    needed = not states_only and not (torque_off and effort_unit is None)
    if inputs is None and needed and record.reported_effort is not None:
        inputs = _measured(path, state, record, asked)
    return records.Recording(
        path.resolve().name,
        record,
        inputs,
        tuple(notes),
        torque_off,
        commanded=beside,
        cuts_ns=_cuts(clock, columns, inputs, bool(torque_off)),
    )


def _cuts(
    clock: Clock, columns: JointColumns, inputs: records.InputRecord | None, torque_off: bool
) -> tuple[tuple[int, int], ...]:
    """Where the recording is cut, on the clock of the joint states [ns]."""
    commanded = inputs is not None and not inputs.measured
    ahead_ns = columns.clock_ns()
    cuts = clock.cuts_ns(unstamped=commanded or torque_off)
    return tuple((begin_ns + ahead_ns, end_ns + ahead_ns) for begin_ns, end_ns in cuts)


def refuse_prefix(
    path: Path,
    recorded: Sequence[str],
    joints: Sequence[str],
) -> None:
    """Raise RecordingError: the recorded names are those of the robot's joints with one prefix before all of them."""
    if set(recorded) & set(joints):
        return
    before = {
        name.removesuffix(joint) for joint in joints for name in recorded if name.endswith(joint)
    }
    for prefix in sorted(before, key=len):
        alike = [joint for joint in joints if prefix + joint in recorded]
        if 2 * len(alike) > len(joints):
            called = f"its joints are called {prefix}{alike[0]} and so on, where the robot has {alike[0]}"
            cure = f"state joint_prefix: {prefix} in a driver's profile (--driver FILE), or name the robot with --robot"
            raise RecordingError(f"{path}: {called}: {cure}")


def _joint_record(
    path: Path,
    topic: Topic,
    columns: JointColumns,
    inputs: records.InputRecord | None,
    asked: _Asked,
    notes: list[str],
) -> records.JointRecord:
    driven: list[str] = []
    if inputs is not None:
        used = np.any(
            np.abs(inputs.current_A) > records.ZERO_CURRENT_A,
            axis=0,
        )
        driven = [name for name, column in zip(inputs.names, used, strict=True) if column]
    expected = [*asked.joint_order, *driven]
    times, names, values = _state_rows(path, topic, columns, driven, expected, notes)
    _refuse_period(path, topic, times, values)
    _check_positions(path, names, values["position"], expected)
    effort = _signed(names, values["effort"], notes)
    return asked.effort.record(
        times, names, values["position"], known_or_none(values["velocity"]), effort
    )


def _refuse_period(
    path: Path,
    topic: Topic,
    times: records.TimeArray,
    values: Mapping[str, records.FloatArray],
) -> None:
    """Raise RecordingError: No joint states come so often, or so seldom."""
    intervals = np.diff(times)
    period_s = 1e-9 * float(np.median(intervals))
    if SHORTEST_PERIOD_S < period_s < LONGEST_PERIOD_S and not is_counted(intervals):
        return
    if period_s <= SHORTEST_PERIOD_S < 1e-9 * float(np.mean(intervals)):
        raise RecordingError(
            f"{path}: {topic.name} comes in bursts, stamped when they arrived, of which there are too few to know when each "
            "message was sent: let the driver stamp each as it is read"
        )
    rate_Hz = rate_by_velocities(values["position"], values["velocity"])
    likely = f"; by its velocities {rate_Hz:.3g} messages came in a second" if rate_Hz else ""
    what = f"comes every {period_s:.2g} s: its time stamps are not in s and ns"
    if is_counted(intervals):
        what = "has row numbers (0, 1, 2 ..) for time stamps, not seconds"
    raise RecordingError(f"{path}: {topic.name} {what}{likely}: stamp messages by a clock")


def _torque_off(
    bag: Bag, state: Topic, columns: JointColumns, clock: Clock, notes: list[str]
) -> tuple[tuple[int, int], ...]:
    """When torque was off, on the clock of the joint states, until the last of these."""
    candidates = bag.topics.called(TORQUE_ENABLED, [BOOL], state.namespace)
    if len(candidates) != 1:
        if candidates:
            notes.append(
                f"{listed(candidates)} may all say when torque is off; none of them was used."
            )
        return ()
    messages = _at_times(bag.messages(candidates[0]), clock)
    last_ns = int(_times(columns, state, []).max())
    # the state heard soonest: on a busy computer most of them may come seconds late, and no clock differs for that
    ahead_ns = columns.ahead_ns()
    clock_ns = int(ahead_ns.max()) if ahead_ns.size else 0
    shift_ns = clock_ns if abs(clock_ns) > FOREIGN_CLOCK_NS else 0
    changes = [
        (next(alike)[0] + shift_ns, on)
        for on, alike in groupby(messages, lambda timed: bool(timed[1].data))
    ]
    if changes and changes[-1][0] < last_ns:
        changes.append((last_ns, True))
    return tuple((off_ns, on_ns) for (off_ns, on), (on_ns, _) in pairwise(changes) if not on)


def _at_times(
    messages: Sequence[tuple[int, Any]],
    clock: Clock,
) -> list[tuple[int, Any]]:
    """Messages without a stamp at when they were recorded, as far as that is known."""
    recorded_ns = np.array([time_ns for time_ns, _ in messages], dtype=np.int64)
    times = clock.times(recorded_ns, np.zeros_like(recorded_ns))
    return [
        (int(time_ns), message)
        for time_ns, known, (_, message) in zip(times.bag_ns, times.known, messages, strict=True)
        if known
    ]


def _of(mask: records.BoolArray) -> str:
    return f"{int(mask.sum())} of {mask.size}"


def _note(
    notes: list[str],
    topic: Topic,
    mask: records.BoolArray,
    what: str,
) -> None:
    """Say how many of a topic's rows were repaired or left out, where there are any."""
    if mask.any():
        notes.append(f"{topic.name}: {_of(mask)} {what}.")


def _times(
    columns: JointColumns,
    topic: Topic,
    notes: list[str],
) -> records.TimeArray:
    """Header stamps; where there are none, the recorder's time on the same clock."""
    missing = columns.stamp_ns == 0
    _note(notes, topic, missing, "messages have no header stamp; their time of recording was used")
    return np.where(missing, columns.bag_ns + columns.clock_ns(), columns.stamp_ns)


def _spread(
    path: Path, topic: Topic, times: records.TimeArray, notes: list[str]
) -> records.TimeArray:
    """Times of messages in their order, shape (T,); those that came in bursts when they were sent.

    Raises:
        RecordingError: When that was nobody knows.
    """
    arrivals = of_bursts(times)
    if arrivals is None:
        return times
    many = f"{arrivals.moved} of {len(times)} messages come in bursts, stamped when they arrived"
    rate = f"{1.0 / arrivals.period_s:.0f} Hz"
    if not arrivals.steady:
        raise RecordingError(
            f"{path}: {topic.name}: {many}, at no steady rate (about {rate}): when each was sent nobody knows; let the driver "
            "stamp each as it is read"
        )
    notes.append(f"{topic.name}: {many}; they were taken to be sent evenly, at {rate}.")
    return arrivals.times_ns


def _sorted(
    times: records.TimeArray,
    topic: Topic,
    notes: list[str],
) -> records.TimeArray:
    """Order of the rows in time."""
    late = np.diff(times, prepend=times[:1]) < 0
    _note(notes, topic, late, "stamps go back in time; the messages were sorted")
    return np.argsort(times, kind="stable")


def _state_rows(
    path: Path,
    topic: Topic,
    columns: JointColumns,
    driven: Sequence[str],
    expected: Sequence[str],
    notes: list[str],
) -> tuple[records.TimeArray, tuple[str, ...], dict[str, records.FloatArray]]:
    """One row per usable message in the order of time, one column per joint that has a position.

    Joints may be spread over several messages (arm and gripper from two publishers). The rows are then the messages
    that have the driven joint; what others report in between is interpolated, since a locked joint hardly moves, while
    an interpolated sample of a driven joint would pretend to be a measurement.
    """
    times = _times(columns, topic, notes)
    order = _sorted(times, topic, notes)
    times = times[order]
    usable = np.any(np.isfinite(columns.values["position"]), axis=0)
    names = tuple(name for name, column in zip(columns.names, usable, strict=True) if column)
    if never := [name for name in columns.names if name not in names]:
        notes.append(
            f"{topic.name}: {', '.join(never)} never has a finite position and was left out."
        )
    values = {quantity: table[np.ix_(order, usable)] for quantity, table in columns.values.items()}
    position = values["position"]
    times_s = 1e-9 * (times - times[0]).astype(np.float64)
    without_sign_bits(times_s, position, names, expected, notes)
    garbage = _garbage(values, np.isin(names, expected))
    position[garbage] = np.nan
    _note(notes, topic, garbage, "messages hold numbers that no joint can have and were left out")
    given = np.isfinite(position)
    if not names:
        raise RecordingError(
            f"{path}: {topic.name} has no finite position in {len(times)} messages; check the driver"
        )

    needed = np.isin(names, driven)
    if not needed.any():
        needed[int(np.argmax(given.sum(axis=0)))] = True
    base = given[:, needed].all(axis=1)
    if base.any():
        needed |= given[base].mean(axis=0) > 0.5
    rows = given[:, needed].all(axis=1)
    broken = ~rows & np.isinf(position[:, needed]).any(axis=1)
    _note(notes, topic, broken, "messages have NaN or infinite positions and were left out")
    partial = ~rows & ~broken & given[:, needed].any(axis=1)
    _note(notes, topic, partial, "messages lack some of the joints and were left out")
    for column in np.flatnonzero(~given[rows].all(axis=0)):
        known = given[:, column]
        known_times, first = np.unique(times[known] - times[0], return_index=True)
        position[rows, column] = np.interp(
            times[rows] - times[0], known_times, position[known, column][first]
        )
        notes.append(
            f"{topic.name}: {names[column]} is in {_of(known)} messages; between them it was interpolated."
        )
    times[rows] = _spread(path, topic, times[rows], notes)
    repeated = np.diff(times[rows], prepend=times[rows][:1] - 1) == 0
    _note(notes, topic, repeated, "stamps are repeated; the first message of each was kept")
    rows[rows] = ~repeated
    if int(rows.sum()) < records.MIN_SAMPLES:
        raise RecordingError(
            f"{path}: only {_of(rows)} messages of {topic.name} are usable, at least {records.MIN_SAMPLES} are needed"
            f" ({' '.join(notes) or 'the recording is too short'})"
        )
    gaps = np.diff(times[rows])
    if lost := int(np.sum(gaps > records.LOST_AFTER_PERIODS * np.median(gaps))):
        notes.append(
            f"{topic.name}: messages were lost: {lost} gaps of more than {records.LOST_AFTER_PERIODS:g} periods"
            f" ({np.median(gaps) / 1e6:.1f} ms), the longest {gaps.max() / 1e6:.0f} ms."
        )
    return times[rows], names, {quantity: table[rows] for quantity, table in values.items()}


def _garbage(
    values: Mapping[str, records.FloatArray], joints: records.BoolArray
) -> records.BoolArray:
    """Messages with numbers from unwritten memory in one of the joints' columns, shape (T,); where many are, the unit is wrong."""
    bad = np.zeros(len(values["position"]), dtype=bool)
    for quantity, limit in (
        ("position", records.IMPLAUSIBLE_POSITION),
        ("velocity", 1e6),
        ("effort", 1e9),
    ):
        bad |= (np.abs(values[quantity][:, joints]) > limit).any(axis=1)
    return bad if bad.mean() < GARBAGE_SHARE else np.zeros_like(bad)


def _check_positions(
    path: Path,
    names: Sequence[str],
    position: records.FloatArray,
    expected: Sequence[str],
) -> None:
    for name, values in zip(names, position.T, strict=True):
        # joints that are not the robot's may be wheels, which do turn that far
        if name in expected and np.abs(values).max() > records.IMPLAUSIBLE_POSITION:
            worst = values[np.argmax(np.abs(values))]
            raise RecordingError(
                f"{path}: {name} stands at {worst:.6g}, which is no angle in rad nor a length in m; the publisher seems"
                f" to use degrees, millimetres or encoder counts: convert the positions to rad and m{hint_of(np.abs(values).min())}"
            )


def _commands(
    bag: Bag,
    topic: Topic,
    means: InputTopic,
    states: JointColumns,
    asked: _Asked,
    notes: list[str],
) -> records.InputRecord:
    """Input from a command topic, on the clock of the joint states."""
    if topic.msgtype == JOINT_STATE:
        columns = joint_state_columns(bag, topic, ["effort"], asked.conventions)
        columns = asked.clock.mended(columns)
        times = _times(columns, topic, notes)
    else:
        columns = array_columns(
            bag, topic, means, asked.joint_order, states.names, asked.conventions
        )
        columns = asked.clock.mended(columns)
        times = columns.bag_ns
    if not len(times):
        raise RecordingError(
            f"{bag.path}: of no message of {topic.name} it is known when it was: {CLOCK_STEPS}"
        )
    effort = columns.values["effort"]
    clock_ns = states.clock_ns()
    if means.unit == "N.m":
        constants = asked.effort.constants(columns.names)
        unknown = np.flatnonzero(np.isnan(constants) & (np.nan_to_num(effort) != 0.0).any(axis=0))
        if unknown.size:
            raise RecordingError(
                f"{bag.path}: {topic.name} has effort on {columns.names[unknown[0]]}, whose nominal torque constant is"
                f" not known; the robot has one for {', '.join(asked.effort.nominal) or 'no joint'}: add it to the robot's file"
            )
        current = effort / np.where(np.isnan(constants), 1.0, constants)
    else:
        current = effort * ampere(means.unit, asked.effort.per_count_A)
    if not columns.stamp_ns.any() and abs(clock_ns) > FOREIGN_CLOCK_NS:
        times = times + clock_ns
        notes.append(
            f"{topic.name}: its times were moved by {clock_ns * 1e-9:.3f} s, since the stamps of the joint states come"
            " from another clock than the recorder's."
        )
    notes += columns.notes
    broken = np.any(np.isinf(current), axis=1)
    _note(
        notes, topic, broken, "messages have NaN or infinite values; the last finite one was held"
    )
    order = _sorted(times, topic, notes)
    times = _spread(bag.path, topic, times[order], notes)
    current = held(current[order])
    latest = np.diff(times, append=times[-1] + 1) > 0
    _note(notes, topic, ~latest, "stamps are repeated; the last message of each was kept")
    return records.InputRecord(
        times[latest], columns.names, current[latest], printable(topic.name), means.unit
    )


def _signed(
    names: Sequence[str], effort: records.FloatArray, notes: list[str]
) -> records.FloatArray:
    """The same with negative counts of a 16-bit register that were read as unsigned, and lie far above all others."""
    negative = (effort >= REGISTER - LARGEST_COUNT) & (effort < REGISTER)
    with np.errstate(invalid="ignore"):
        others = np.abs(np.where(negative, 0.0, effort))
        whole = np.isnan(effort) | (effort == np.round(effort))
    columns = negative.any(axis=0) & (whole & (np.isnan(others) | (others <= LARGEST_COUNT))).all(
        axis=0
    )
    if not columns.any():
        return effort
    which = ", ".join(name for name, column in zip(names, columns, strict=True) if column)
    notes.append(
        f"effort of {which}: {_of(negative & columns)} values of {REGISTER - LARGEST_COUNT} and more beside small ones are "
        f"negative numbers of a 16-bit register that was read as unsigned; {REGISTER} was subtracted from them."
    )
    return np.where(negative & columns, effort - REGISTER, effort)


def _measured(
    path: Path, topic: Topic, record: records.JointRecord, asked: _Asked
) -> records.InputRecord:
    """Input from what the motors reported."""
    inputs = asked.effort.measured(record)
    if asked.effort.unit is None:
        usual = " or ".join(f"/{each.topic}" for each in asked.conventions.inputs) or "input"
        raise RecordingError(
            f"{path}: no {usual} in the bag, and what the effort of {topic.name} means is"
            f" not stated; state it with --effort-unit {'|'.join(EFFORT_UNITS)}, or name the input with --command-topic"
        )
    if inputs is None:
        raise RecordingError(
            f"{path}: the effort of {topic.name} cannot be turned into current: the robot has a nominal torque constant"
            f" for none of {', '.join(record.names)}; choose the robot with --robot"
        )
    return inputs


def read_drive_signals(
    path: str | Path,
    state_topic: str | None = None,
    conventions: Conventions = OUR_DRIVER,
    span: records.Span | None = None,
) -> records.DriveSignals:
    """Read goals (positions of /joint_command, named as joint states are) and supply voltage (/battery_state), as far as there.

    The arguments are those of `read_recording`.

    Raises `RecordingError`: The bag cannot be read, or several topics may be meant.
    """
    with open_bag(path) as bag:
        state = bag.topics.states(state_topic, None, conventions)
        bag.cut(state, span)

        def found(name: str, msgtype: str) -> Topic | None:
            topics = [
                topic
                for topic in bag.topics.called(name, [msgtype], state.namespace)
                if topic != state
            ]
            if len(topics) > 1:
                raise RecordingError(f"{path}: which {name}? {listed(topics)}: record one of them")
            return topics[0] if topics else None

        goal = found(JOINT_COMMAND, JOINT_STATE)
        battery = found(BATTERY_STATE, BATTERY)
        if goal is None and battery is None:
            return records.DriveSignals(
                _NO_TIMES,
                (),
                np.empty((0, 0)),
                _NO_TIMES,
                np.empty(0),
            )
        states = joint_state_columns(bag, state, ["position"], conventions)
        clock = clock_of(state.name, states)
        ahead_ns = clock.mended(states).clock_ns()
        goal_ns = _NO_TIMES
        names = tuple[str, ...]()
        goals = np.empty((0, 0))
        if goal is not None:
            columns = clock.mended(joint_state_columns(bag, goal, ["position"], conventions))
            goal_ns = np.where(columns.stamp_ns == 0, columns.bag_ns + ahead_ns, columns.stamp_ns)
            order = np.argsort(goal_ns, kind="stable")
            goals = np.where(
                np.isfinite(columns.values["position"]), columns.values["position"], np.nan
            )[order]
            goal_ns = goal_ns[order]
            names = columns.names
        volts = [
            (stamp_ns(message) or time_ns + ahead_ns, float(message.voltage))
            for time_ns, message in (
                [] if battery is None else _at_times(bag.messages(battery), clock)
            )
            if 0.0 < message.voltage < np.inf
        ]
    volts.sort(key=lambda sample: sample[0])
    voltage_ns = np.array([time_ns for time_ns, _ in volts], dtype=np.int64)
    return records.DriveSignals(
        goal_ns,
        names,
        goals,
        voltage_ns,
        np.array(
            [volt for _, volt in volts],
            dtype=np.float64,
        ),
    )


def without_jumps(recording: records.Recording, joints: Sequence[str]) -> records.Recording:
    """Leave out, with a note, joint states in which one of the robot's joints jumps away and back, as damaged numbers would.

    That is all that can be seen of damage in a file without checksums (sqlite3): smaller errors, and those at the ends, cannot.
    """
    record = recording.joints
    position = record.position[:, np.isin(record.names, joints)]
    if len(position) <= records.MIN_SAMPLES:
        return recording
    intervals = 1e-9 * np.diff(record.times_ns)
    # two messages may be stamped at nearly the same time
    allowed = IMPLAUSIBLE_SPEED * np.maximum(intervals, np.median(intervals))[:, None]
    far = np.abs(np.diff(position, axis=0)) > allowed
    jumped = np.zeros(position.shape, dtype=bool)
    for count in range(1, LONGEST_JUMP + 1):
        # it leaves, and after that many samples it is where it was, as far as it can have moved meanwhile
        back = (count + 1) * allowed[: len(allowed) - count]
        gone = (
            far[:-count]
            & far[count:]
            & (np.abs(position[count + 1 :] - position[: -count - 1]) <= back)
        )
        for number in range(1, count + 1):
            jumped[number : number + len(gone)] |= gone
    kept = ~np.any(jumped, axis=1)
    if kept.all():
        return recording
    jumps = f"in {_of(~kept)} joint states a joint jumps there and back faster than {IMPLAUSIBLE_SPEED:g} rad/s"
    if np.mean(~kept) > MOST_JUMPS:
        raise RecordingError(
            f"{recording.name}: {jumps}: two motions are mixed, as where a clock was set back while it was recorded, or where two "
            "publish joint states"
        )
    note = f"{jumps}; they were left out: is the file damaged?"
    return replace(
        recording,
        joints=record.kept(kept),
        notes=(*recording.notes, note),
    )
