"""What an open bag or episode holds for one robot, in steps, each from a recording to a recording with its notes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from proprio_ros.calibration_files.motors import Motors, other_arm, other_firmware
from proprio_ros.errors import RecordingError, some
from proprio_ros.recordings.drivers import Driver
from proprio_ros.recordings.effort import effort_sign_option
from proprio_ros.recordings.effort_units import plausible_units
from proprio_ros.recordings.jumps import without_jumps
from proprio_ros.recordings.read_options import ReadOptions
from proprio_ros.recordings.signals import refuse_prefix
from proprio_ros.recordings.sources import Attempt, RecordingSource
from proprio_ros.recordings.voltage import refuse_unit, voltage_driven, with_stall_currents
from proprio_ros.records import Recording
from proprio_ros.robot import Robot, is_description


@dataclass(frozen=True)
class Read:
    """One bag or episode as it was read for a robot, before runs or a motion are made of it."""

    path: Path
    recording: Attempt[Recording]
    motors: Attempt[Motors]  # as far as it says whose arm it is of
    # how warm the motors were on average, by joint [deg C], as far as it says it
    temperatures: Attempt[Mapping[str, float]]


@dataclass(frozen=True)
class RobotReading:
    """How bags and episodes are read for a robot."""

    robot: Robot
    driver: Driver | None  # profile of the driver that published, where one is stated
    options: ReadOptions

    def of(self, source: RecordingSource) -> Read:
        """All that is in an open source, as far as it can be read."""
        topic = self.options.state_topic
        return Read(
            source.path,
            Attempt.to(lambda: self.recording(source)),
            Attempt.to(lambda: source.motors(topic)),
            Attempt.to(lambda: source.temperatures(topic)),
        )

    def recording(self, source: RecordingSource) -> Recording:
        """What an open source holds for the robot, named after it, with a note on each repair.

        Raises:
            RecordingError: It cannot be read, or is of another arm.
            ConfigurationError: What is stated of it cannot be.
        """
        if self.driver is not None and self.driver.refused:
            raise RecordingError(f"{self.driver.refused}", source.path)
        refuse_unit(self.robot, self.options.effort.unit)
        recording = source.recording(self.options)
        for step in STEPS:
            recording = step(recording, source, self)
        return recording


Step = Callable[[Recording, RecordingSource, RobotReading], Recording]


def _of_this_robot(
    recording: Recording,
    source: RecordingSource,
    reading: RobotReading,
) -> Recording:
    refuse_prefix(source.path, recording.joints.names, reading.options.joint_order)
    return without_jumps(recording, reading.options.joint_order)


def _with_stall_currents(
    recording: Recording,
    source: RecordingSource,
    reading: RobotReading,
) -> Recording:
    if not voltage_driven(reading.robot):
        return recording
    signals = source.drive_signals(reading.options)
    if signals is not None:
        recording = replace(recording, signals=signals)
    return with_stall_currents(recording, reading.robot)


def _named(
    recording: Recording,
    source: RecordingSource,
    reading: RobotReading,
) -> Recording:
    return replace(recording, name=source.name or recording.name)


def _of_these_motors(
    recording: Recording,
    source: RecordingSource,
    reading: RobotReading,
) -> Recording:
    notes = motors_notes(source, reading.robot, reading.options.state_topic)
    return replace(recording, notes=recording.notes + notes)


def motors_notes(
    source: RecordingSource,
    robot: Robot,
    state_topic: str | None,
) -> tuple[str, ...]:
    """A note where a recording is of the motors that were calibrated, but these have other firmware now.

    Args:
        source: An open bag or episode.
        robot: With its calibration; one that names no motors is of any arm.
        state_topic: Of the joint states, where the user names it.

    Returns:
        A sentence, or none.

    Raises:
        RecordingError: It is of another arm, as far as both say whose it is, or cannot be read.
    """
    if robot.calibration is None or not robot.calibration.motors:
        return ()
    motors = source.motors(state_topic)
    differences = other_arm(robot.calibration.motors, motors)
    if differences:
        raise RecordingError(
            f"another arm than that of {robot.source.name}, or its motors were set anew: {differences}: calibrate "
            "this arm, or name its own calibration",
            source.path,
        )
    updated = other_firmware(robot.calibration.motors, motors)
    if not updated:
        return ()
    return (f"other firmware than when {robot.source.name} was made: {updated}: calibrate again",)


def _with_turned_efforts_noted(
    recording: Recording,
    source: RecordingSource,
    reading: RobotReading,
) -> Recording:
    """A note where efforts count the other way round than they were recorded."""
    record = recording.joints
    if not record.turned or record.reported_effort is None:
        return recording
    which = (
        "all joints"
        if set(record.turned) >= set(reading.robot.drive_trains)
        else some(record.turned)
    )
    note = f"the effort of {which} was multiplied by -1, as effort_sign states"
    return replace(recording, notes=(*recording.notes, note))


def _in_a_plausible_unit(
    recording: Recording,
    source: RecordingSource,
    reading: RobotReading,
) -> Recording:
    """A note where the effort is far from what gravity needs in the unit of the driver's profile."""
    driver = reading.driver
    if driver is None:
        return recording
    _, units = plausible_units(recording, reading.robot)
    notes = []
    for each in units:
        if each.unit != reading.options.effort.unit or each.plausible:
            continue
        ratio = float(np.median(list(each.ratio.values())))
        remedy = "is it this driver, and are the torque constants right?"
        if ratio < 0.0:
            joints = list(reading.robot.drive_trains)
            option = effort_sign_option(joints, joints, recording.joints.turned)
            remedy = (
                f"is it counted the other way round ({option} states it), or does the arm hang?"
            )
        notes.append(
            f"effort in {each.unit} (--driver {driver.name}) is {ratio:.2g} times the torque that gravity needs by the URDF, and "
            f"an empty hand gives 1: {remedy}"
        )
    return replace(recording, notes=(*recording.notes, *notes))


def _of_known_torque(
    recording: Recording,
    source: RecordingSource,
    reading: RobotReading,
) -> Recording:
    """Raises `RecordingError`: Currents were commanded, and a URDF alone states no torque constants."""
    file = reading.robot.source
    inputs = recording.inputs
    if reading.options.effort.unit != "N.m" or not is_description(str(file)) or inputs is None:
        return recording
    if not inputs.measured and inputs.unit != "N.m":
        raise RecordingError(
            f"{inputs.source} are currents, and {file.name} states no torque constants: write a file with "
            "`proprio robot new`, or state each with --set "
            "robot.joints.JOINT.motor.nominal_torque_constant_N_m_per_A=VALUE",
            source.path,
        )
    return recording


STEPS: tuple[Step, ...] = (
    _of_this_robot,
    _with_stall_currents,
    _named,
    _of_these_motors,
    _with_turned_efforts_noted,
    _in_a_plausible_unit,
    _of_known_torque,
)
"""What is done about a recording once it is read, one step after the other."""
