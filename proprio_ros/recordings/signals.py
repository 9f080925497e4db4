"""Joint states and input of a ROS 2 bag as a `Recording`, without ROS.

A foreign bag is repaired where the repair is certain, and every repair is noted in `Recording.notes`; where it would be
a guess the user is asked.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise
from pathlib import Path

import numpy as np

from proprio_ros.errors import RecordingError
from proprio_ros.recordings.clock_faults import ClockFaults, clock_faults_of, messages_at
from proprio_ros.recordings.columns import JointColumns, joint_state_columns
from proprio_ros.recordings.contradictions import refuse_pace
from proprio_ros.recordings.effort import CURRENT_PER_COUNT_A, Effort, known_or_none
from proprio_ros.recordings.input_topics import FOREIGN_CLOCK_NS, commanded, measured
from proprio_ros.recordings.joint_names import fitted_names
from proprio_ros.recordings.noted import Noted
from proprio_ros.recordings.publishers import of_one_publisher
from proprio_ros.recordings.read_options import ReadOptions
from proprio_ros.recordings.reader import Bag, open_bag
from proprio_ros.recordings.stamps import times_of
from proprio_ros.recordings.state_rows import state_rows
from proprio_ros.recordings.topics import (
    BOOL,
    OUR_DRIVER,
    TORQUE_ENABLED,
    Conventions,
    Topic,
    listed,
)
from proprio_ros.records import ZERO_CURRENT_A, InputRecord, JointRecord, Recording, Span

QUANTITIES = ("position", "velocity", "effort")
Spans = tuple[tuple[int, int], ...]
"""From when to when, on the clock of the joint states [ns]."""


@dataclass(frozen=True)
class Heard:
    """What a bag says of one arm, before rows are made of its messages."""

    path: Path  # of the bag
    state: Topic  # of the joint states
    columns: JointColumns  # joint states of one publisher, their clocks mended
    clock: ClockFaults  # what was wrong with the clocks of the bag
    inputs: InputRecord | None  # commands, where they are the input
    beside: InputRecord | None  # commands, where measured efforts are the input
    torque_off_ns: Spans
    notes: list[str]  # a sentence on each repair


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
    span: Span | None = None,
) -> Recording:
    """Read joint states and input currents from a ROS 2 bag, and nothing else of it.

    The input comes from the topics that the driver's conventions name (ours: /applied_effort, else /current_command), else from
    measured effort.

    Args:
        path: As for `open_bag`.
        state_topic: See `ReadOptions`, as of the other options.
        command_topic: Topic of the input.
        effort_unit: What effort of the joint states means: 'N.m', 'A', 'mA' or 'raw'; None: not stated, never guessed.
        nominal_torque_constants: By joint; the ones with which effort was published [N m/A or N/A].
        joint_order: Of an unlabelled current command.
        current_per_count_A: Of a raw count [A].
        states_only: Whether to leave the input out, whatever there is of it.
        conventions: Of the driver that published.
        span: The part that is read.

    Returns:
        The recording, as of `recording_of`.

    Raises:
        RecordingError: The bag cannot be read, or does not hold what is needed.
        ConfigurationError: Unknown effort_unit.
    """
    options = ReadOptions(
        Effort(effort_unit, nominal_torque_constants, current_per_count_A),
        joint_order,
        conventions,
        state_topic=state_topic,
        command_topic=command_topic,
        span=span,
        states_only=states_only,
    )
    with open_bag(path) as bag:
        heard = hear(bag, options)
    return recording_of(heard, options)


def hear(bag: Bag, options: ReadOptions) -> Heard:
    """Read the messages of joint states, input and torque.

    Raises `RecordingError`: They cannot be read, are of two publishers, or of clocks that contradict each other.
    """
    conventions = options.conventions
    state = bag.topics.states(options.state_topic, options.command_topic, conventions)
    bag = bag.cut(state, options.span)
    command = None
    if not options.states_only:
        command = bag.topics.input(options.command_topic, state, conventions)
    columns = joint_state_columns(bag, state, QUANTITIES, conventions)
    fitted = fitted_names(bag.path, columns.names, options)
    options = fitted.options
    columns = columns._replace(names=fitted.renamed(columns.names))
    columns, clock = _of_one_clock(bag, state, columns, options)
    pace = refuse_pace(Noted(bag.path, state.name), columns)
    notes = [*fitted.notes, *columns.notes, *clock.notes, *pace]
    inputs = beside = None
    if command is not None and command[0] != state:
        inputs, repairs = commanded(bag, *command, columns, clock, options)
        notes += repairs
    elif not options.states_only and (own := bag.topics.input(None, state)) is not None:
        beside, _ = commanded(bag, *own, columns, clock, options)
    torque_off_ns = _torque_off(bag, state, columns, clock, notes)
    return Heard(
        bag.path, state, columns, clock, inputs, beside, torque_off_ns, [*bag.notes, *notes]
    )


def _of_one_clock(
    bag: Bag,
    state: Topic,
    columns: JointColumns,
    options: ReadOptions,
) -> tuple[JointColumns, ClockFaults]:
    """Joint states of the arm's own driver in the order of a clock that goes on evenly, and what was wrong with the clocks.

    Args:
        bag: Open.
        state: Topic of the joint states.
        columns: All of them, as they were recorded.
        options: How they are read.
    """
    # parts whose times come twice look like two publishers, and two publishers may hide a step
    before = clock_faults_of(state.name, columns)
    columns = of_one_publisher(
        Noted(bag.path, state.name),
        before.mended(columns),
    )
    if not options.states_only:
        refuse_prefix(bag.path, columns.names, options.joint_order)
    behind = clock_faults_of(state.name, columns)
    return behind.mended(columns), before.then(behind)


def recording_of(heard: Heard, options: ReadOptions) -> Recording:
    """The recording, on the clock of the joint states' header stamps.

    `joints.effort` is set only for the effort unit 'N.m', and `joints.current` only where a unit is stated; `inputs` is None when
    nothing about the input was recorded, or only an effort of an unstated unit beside a known stretch without torque (see
    `torque_off_ns`).

    Raises `RecordingError`: It does not hold what is needed.
    """
    inputs = heard.inputs
    torque_off_ns = heard.torque_off_ns
    noted = Noted(
        heard.path,
        heard.state.name,
        list(heard.notes),
    )
    record = _joint_record(heard, noted, options)
    # zero current needs no unit
    needed = not options.states_only and not (torque_off_ns and options.effort.unit is None)
    if inputs is None and needed and record.reported_effort is not None:
        inputs = measured(record, noted, options)
    return Recording(
        heard.path.resolve().name,
        record,
        inputs,
        tuple(noted.notes),
        torque_off_ns,
        commanded=heard.beside,
        cuts_ns=_cuts(heard, inputs),
    )


def _cuts(heard: Heard, inputs: InputRecord | None) -> Spans:
    """Where the recording is cut, on the clock of the joint states [ns]."""
    by_command = inputs is not None and not inputs.measured
    ahead_ns = heard.columns.clock_ns()
    cuts = heard.clock.cuts_ns(unstamped=by_command or bool(heard.torque_off_ns))
    return tuple((begin_ns + ahead_ns, end_ns + ahead_ns) for begin_ns, end_ns in cuts)


def refuse_prefix(
    path: Path,
    recorded: Sequence[str],
    joints: Sequence[str],
) -> None:
    """Refuse names that are those of the robot's joints with one prefix before all of them.

    Args:
        path: Of the recording.
        recorded: Names in it.
        joints: Names of the robot's.

    Raises:
        RecordingError: So they are.
    """
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
            raise RecordingError(f"{called}: {cure}", path)


def _joint_record(heard: Heard, noted: Noted, options: ReadOptions) -> JointRecord:
    """Joint states, a row each."""
    driven: list[str] = []
    inputs = heard.inputs
    if inputs is not None:
        used = np.any(
            np.abs(inputs.current_A) > ZERO_CURRENT_A,
            axis=0,
        )
        driven = [name for name, column in zip(inputs.names, used, strict=True) if column]
    rows = state_rows(heard.columns, noted, driven, options.joint_order)
    velocity = known_or_none(rows.values["velocity"])
    return options.effort.record(
        rows.times_ns, rows.names, rows.position, velocity, rows.values["effort"]
    )


def _torque_off(
    bag: Bag, state: Topic, columns: JointColumns, clock: ClockFaults, notes: list[str]
) -> Spans:
    """When torque was off, on the clock of the joint states, until the last of these."""
    candidates = bag.topics.called(TORQUE_ENABLED, [BOOL], state.namespace)
    if not candidates:
        return ()
    if len(candidates) > 1:
        notes.append(f"{listed(candidates)} may all say when torque is off; none of them was used.")
        return ()
    messages = messages_at(bag.messages(candidates[0]), clock)
    last_ns = int(times_of(columns, Noted(bag.path, state.name)).max())
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
