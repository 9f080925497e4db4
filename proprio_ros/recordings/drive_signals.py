"""What drives position servos: goals (positions of /joint_command, named as joint states are) and supply (/battery_state)."""

from __future__ import annotations

import numpy as np

from proprio_ros.errors import RecordingError
from proprio_ros.recordings.clock_faults import ClockFaults, clock_faults_of, messages_at
from proprio_ros.recordings.columns import joint_state_columns
from proprio_ros.recordings.joint_names import fitted_names
from proprio_ros.recordings.messages import stamp_ns
from proprio_ros.recordings.read_options import ReadOptions
from proprio_ros.recordings.reader import Bag
from proprio_ros.recordings.topics import (
    BATTERY,
    BATTERY_STATE,
    JOINT_COMMAND,
    JOINT_STATE,
    Topic,
    listed,
)
from proprio_ros.records import DriveSignals, FloatArray, TimeArray

NO_TIMES: TimeArray = np.empty(0, dtype=np.int64)
NOTHING = DriveSignals(
    NO_TIMES,
    (),
    np.empty((0, 0)),
    NO_TIMES,
    np.empty(0),
)


def drive_signals_in(bag: Bag, options: ReadOptions) -> DriveSignals:
    """Goals and supply voltage of a bag, as far as they are there.

    Raises `RecordingError`: They cannot be read, or several topics may be meant.
    """
    state = bag.topics.states(options.state_topic, None, options.conventions)
    bag = bag.cut(state, options.span)
    goal = _beside(bag, state, JOINT_COMMAND, JOINT_STATE)
    battery = _beside(bag, state, BATTERY_STATE, BATTERY)
    if goal is None and battery is None:
        return NOTHING
    states = joint_state_columns(bag, state, ["position"], options.conventions)
    options = fitted_names(bag.path, states.names, options).options
    clock = clock_faults_of(state.name, states)
    ahead_ns = clock.mended(states).clock_ns()
    goal_ns, names, goals = NOTHING.goal_ns, NOTHING.names, NOTHING.goals
    if goal is not None:
        goal_ns, names, goals = _goals(bag, goal, clock, ahead_ns, options)
    voltage_ns, voltage_V = NOTHING.voltage_ns, NOTHING.voltage_V
    if battery is not None:
        voltage_ns, voltage_V = _voltages(bag, battery, clock, ahead_ns)
    return DriveSignals(goal_ns, names, goals, voltage_ns, voltage_V)


def _beside(
    bag: Bag,
    state: Topic,
    name: str,
    msgtype: str,
) -> Topic | None:
    """A topic beside the joint states; None where there is none."""
    called = bag.topics.called(name, [msgtype], state.namespace)
    topics = [topic for topic in called if topic != state]
    if len(topics) > 1:
        raise RecordingError(f"which {name}? {listed(topics)}: record one of them", bag.path)
    return topics[0] if topics else None


def _goals(
    bag: Bag, topic: Topic, clock: ClockFaults, ahead_ns: int, options: ReadOptions
) -> tuple[TimeArray, tuple[str, ...], FloatArray]:
    """Where joints were sent: times [ns], shape (G,), names, and positions [rad or m], shape (G, J)."""
    columns = clock.mended(
        joint_state_columns(
            bag,
            topic,
            ["position"],
            options.conventions,
        )
    )
    goal_ns = np.where(
        columns.stamp_ns == 0,
        columns.bag_ns + ahead_ns,
        columns.stamp_ns,
    )
    order = np.argsort(goal_ns, kind="stable")
    position = columns.values["position"]
    goals = np.where(np.isfinite(position), position, np.nan)
    return goal_ns[order], columns.names, goals[order]


def _voltages(
    bag: Bag,
    topic: Topic,
    clock: ClockFaults,
    ahead_ns: int,
) -> tuple[TimeArray, FloatArray]:
    """The supply: times [ns] and voltages [V], shape (V,) each."""
    volts = [
        (stamp_ns(message) or time_ns + ahead_ns, float(message.voltage))
        for time_ns, message in messages_at(bag.messages(topic), clock)
        if 0.0 < message.voltage < np.inf
    ]
    volts.sort(key=lambda sample: sample[0])
    voltage_ns = np.array(
        [time_ns for time_ns, _ in volts],
        dtype=np.int64,
    )
    return voltage_ns, np.array([volt for _, volt in volts], dtype=np.float64)
