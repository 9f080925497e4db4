"""From duty cycle, goal and supply voltage to the stall current of each motor that a voltage drives (see `robot.drives`)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from proprio_ros.errors import ConfigurationError, RecordingError
from proprio_ros.records import STALL_CURRENT, DriveSignals, FloatArray, InputRecord, Recording
from proprio_ros.robot import Robot
from proprio_ros.robot.drives import Goal

SMOOTHED_S = 0.5
"""A servo's voltmeter samples between the pulses that it makes itself: a volt of ripple that its motor does not see."""


def voltage_driven(robot: Robot) -> tuple[str, ...]:
    """The joints whose motors a voltage drives, as the robot file states."""
    return tuple(name for name, drive in robot.drive_trains.items() if drive.driven_by is not None)


def refuse_unit(robot: Robot, effort_unit: str | None) -> None:
    """Raises: ConfigurationError: A unit of the effort is stated, where by the robot file a voltage drives every joint."""
    joints = voltage_driven(robot)
    if effort_unit is not None and joints and set(joints) == set(robot.drive_trains):
        raise ConfigurationError(
            f"--effort-unit {effort_unit}: by {robot.source.name} a voltage drives {', '.join(joints)} (driven_by), and its "
            "effort is no torque and no current: leave the unit out, or driven_by"
        )


def with_stall_currents(recording: Recording, robot: Robot) -> Recording:
    """The recording with stall currents as the measured currents of all motors that a voltage drives, unless torque is off.

    Raises `RecordingError`: The effort, the goal or the voltage that a drive needs was not recorded.
    """
    joints = [name for name in voltage_driven(robot) if name in recording.joints.names]
    if not joints or recording.torque_off_ns or recording.signals is None:
        return recording
    record = recording.joints
    current = (
        np.full(record.position.shape, np.nan) if record.current is None else record.current.copy()
    )
    takes = []
    for joint in joints:
        current[:, record.column(joint)], words = _stall_current(
            recording, robot, joint, recording.signals
        )
        takes.append(words)
    known = np.isfinite(current).all(axis=0)
    names = tuple(name for name, column in zip(record.names, known, strict=True) if column)
    source = f"{STALL_CURRENT}, from {' and from '.join(dict.fromkeys(takes))}"
    inputs = InputRecord(record.times_ns, names, current[:, known], source)
    return replace(
        recording,
        joints=replace(record, current=current),
        inputs=inputs,
    )


def _stall_current(
    recording: Recording, robot: Robot, joint: str, signals: DriveSignals
) -> tuple[FloatArray, str]:
    """Of one joint [A], and what it was made of."""
    record = recording.joints
    drive = robot.drive_trains[joint]
    driven_by = drive.driven_by
    assert driven_by is not None
    column = record.column(joint)
    zero_ns = int(record.times_ns[0])
    times_s = 1e-9 * (record.times_ns - zero_ns).astype(np.float64)
    effort = None if record.reported_effort is None else record.reported_effort[:, column]
    goal_ns, goals = signals.goal(joint)
    if driven_by.follows_goal and not len(goals):
        raise RecordingError(
            f"{joint} is a {driven_by.kind} by {robot.source.name}, and where it was sent was not recorded: "
            "record its goal as position in /joint_command (sensor_msgs/JointState)",
            recording.name,
        )
    if not driven_by.follows_goal and (effort is None or not np.isfinite(effort).any()):
        raise RecordingError(
            f"by {robot.source.name} the effort of {joint} is its duty cycle, and none was recorded",
            recording.name,
        )
    if len(signals.voltage_V):
        voltage_V = np.interp(
            times_s, 1e-9 * (signals.voltage_ns - zero_ns).astype(np.float64), _smoothed(signals)
        )
        words = driven_by.takes
    elif drive.supply_voltage_V > 0.0:
        voltage_V = np.full(len(times_s), drive.supply_voltage_V)
        words = f"{driven_by.takes} ({drive.supply_voltage_V:g} V as stated)"
    else:
        raise RecordingError(
            f"a voltage drives {joint}, and none was recorded in /battery_state: state supply_voltage_V of its "
            f"motor in {robot.source.name}",
            recording.name,
        )
    goal = Goal(1e-9 * (goal_ns - zero_ns).astype(np.float64), goals) if len(goals) else None
    duty = driven_by.duty(
        times_s,
        record.position[:, column],
        effort,
        goal,
        robot.delay.value,
    )
    return duty * voltage_V / drive.resistance_ohm, words


def _smoothed(signals: DriveSignals) -> FloatArray:
    """Running mean of the voltage [V]."""
    times_s = 1e-9 * (signals.voltage_ns - signals.voltage_ns[0]).astype(np.float64)
    first = np.searchsorted(times_s, times_s - 0.5 * SMOOTHED_S)
    last = np.searchsorted(times_s, times_s + 0.5 * SMOOTHED_S, side="right")
    total = np.concatenate(
        [
            [0.0],
            np.cumsum(signals.voltage_V),
        ]
    )
    return (total[last] - total[first]) / (last - first)
