"""What drove the joints: commands of a topic on the clock of the joint states, or what the motors reported."""

from __future__ import annotations

import numpy as np

from proprio_ros.errors import RecordingError, printable
from proprio_ros.recordings.clock_faults import ClockFaults
from proprio_ros.recordings.columns import JointColumns, array_columns, joint_state_columns
from proprio_ros.recordings.effort import EFFORT_UNITS, ampere, held
from proprio_ros.recordings.noted import Noted
from proprio_ros.recordings.read_options import ReadOptions
from proprio_ros.recordings.reader import Bag
from proprio_ros.recordings.stamps import order_of, sent_at, times_of
from proprio_ros.recordings.topics import JOINT_STATE, InputTopic, Topic
from proprio_ros.records import FloatArray, InputRecord, JointRecord

FOREIGN_CLOCK_NS = 500_000_000
"""Header stamps further than this from the recorder's time come from another clock (simulated time, another host)."""
CLOCK_STEPS = "the clock steps; set clocks before the drivers start, and record again"


def commanded(
    bag: Bag,
    topic: Topic,
    means: InputTopic,
    states: JointColumns,
    clock: ClockFaults,
    options: ReadOptions,
) -> tuple[InputRecord, list[str]]:
    """Input from a command topic, on the clock of the joint states.

    Args:
        bag: Open.
        topic: Of the commands.
        means: What its numbers are.
        states: Joint states, their clocks mended.
        clock: What was wrong with the clocks of the bag.
        options: How the bag is read.

    Returns:
        Currents [A], and a sentence on each repair.

    Raises:
        RecordingError: The commands cannot be read, or are efforts of a joint whose torque constant is not known.
    """
    noted = Noted(bag.path, topic.name)
    conventions = options.conventions
    if topic.msgtype == JOINT_STATE:
        columns = clock.mended(joint_state_columns(bag, topic, ["effort"], conventions))
        times_ns = times_of(columns, noted)
    else:
        arrays = array_columns(bag, topic, means, options.joint_order, states.names, conventions)
        columns = clock.mended(arrays)
        times_ns = columns.bag_ns
    if not len(times_ns):
        raise RecordingError(
            f"of no message of {topic.name} it is known when it was: {CLOCK_STEPS}", bag.path
        )
    current_A = _currents(columns, noted, means, options)
    ahead_ns = states.clock_ns()
    if not columns.stamp_ns.any() and abs(ahead_ns) > FOREIGN_CLOCK_NS:
        times_ns = times_ns + ahead_ns
        noted.note(
            f"its times were moved by {ahead_ns * 1e-9:.3f} s, since the stamps of the joint states come from another clock than "
            "the recorder's."
        )
    noted.notes.extend(columns.notes)
    broken = np.any(np.isinf(current_A), axis=1)
    noted.count(broken, "messages have NaN or infinite values; the last finite one was held")
    order = order_of(times_ns, noted)
    times_ns = sent_at(times_ns[order], noted)
    current_A = held(current_A[order])
    latest = np.diff(times_ns, append=times_ns[-1] + 1) > 0
    noted.count(~latest, "stamps are repeated; the last message of each was kept")
    record = InputRecord(
        times_ns[latest], columns.names, current_A[latest], printable(topic.name), means.unit
    )
    return record, noted.notes


def _currents(
    columns: JointColumns, noted: Noted, means: InputTopic, options: ReadOptions
) -> FloatArray:
    """What the numbers of a command are as currents, shape (M, J) [A]."""
    effort = columns.values["effort"]
    if means.unit != "N.m":
        return effort * ampere(means.unit, options.effort.per_count_A)
    constants = options.effort.constants(columns.names)  # (J,)
    used = (np.nan_to_num(effort) != 0.0).any(axis=0)
    unknown = np.flatnonzero(np.isnan(constants) & used)
    if unknown.size:
        raise RecordingError(
            f"{noted.topic} has effort on {columns.names[unknown[0]]}, whose nominal torque constant is not known; "
            f"the robot has one for {', '.join(options.effort.nominal) or 'no joint'}: add it to the robot's file",
            noted.path,
        )
    return effort / np.where(np.isnan(constants), 1.0, constants)


def measured(record: JointRecord, noted: Noted, options: ReadOptions) -> InputRecord:
    """Input from what the motors reported.

    Args:
        record: Joint states with efforts.
        noted: Where they were recorded.
        options: How the bag is read.

    Returns:
        Currents of the joints whose torque constant is known [A].

    Raises:
        RecordingError: Nobody stated what effort is, or no torque constant is known.
    """
    inputs = options.effort.measured(record)
    if options.effort.unit is None:
        usual = " or ".join(f"/{each.topic}" for each in options.conventions.inputs) or "input"
        raise RecordingError(
            f"no {usual} in the bag, and what the effort of {noted.topic} means is not stated; state it with "
            f"--effort-unit {'|'.join(EFFORT_UNITS)}, or name the input with --command-topic",
            noted.path,
        )
    if inputs is None:
        raise RecordingError(
            f"the effort of {noted.topic} cannot be turned into current: the robot has a nominal torque constant for "
            f"none of {', '.join(record.names)}; choose the robot with --robot",
            noted.path,
        )
    return inputs
