"""From one recording to what a request makes of it: its runs, or its motion."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from proprio_ros.calibration_files.motors import Motors, other_arm, other_firmware
from proprio_ros.errors import RecordingError
from proprio_ros.pipeline.request import Request
from proprio_ros.recordings.contradictions import refuse_other_current
from proprio_ros.recordings.effort import Effort
from proprio_ros.recordings.jumps import without_jumps
from proprio_ros.recordings.motions import Motion, motion_of
from proprio_ros.recordings.pace import refuse_pace_of_joint, refuse_pace_of_runs
from proprio_ros.recordings.plausibility import plausible_units
from proprio_ros.recordings.published import published_robot, published_run
from proprio_ros.recordings.read_options import ReadOptions
from proprio_ros.recordings.runs import DrivenAtOnce, cut_runs
from proprio_ros.recordings.signals import refuse_prefix
from proprio_ros.recordings.sources import (
    Attempt,
    BagSource,
    EpisodeSource,
    TextSource,
    open_recording,
    open_source,
)
from proprio_ros.recordings.text import TextRecording
from proprio_ros.recordings.voltage import refuse_unit, voltage_driven, with_stall_currents
from proprio_ros.records import InputRecord, Recording, Run
from proprio_ros.robot import Robot, is_description


@dataclass(frozen=True)
class Loaded:
    """What one recording gave."""

    path: Path
    robot: Robot  # as the request has it, or as a text says of its own
    found: tuple[Run, ...] | Motion
    # how warm the motors were on average, by joint [deg C], as far as the recording says it
    temperatures: Attempt[Mapping[str, float]]
    text: TextRecording | None = None  # where it is one


@dataclass(frozen=True)
class Read:
    """One bag or episode as it was read for a robot, before runs or a motion are made of it."""

    path: Path
    recording: Attempt[Recording]
    motors: Attempt[Motors]  # as far as the recording says whose arm it is of
    temperatures: Attempt[Mapping[str, float]]  # as of `Loaded`


def load(path: Path, request: Request) -> Loaded:
    """The runs or the motion of one bag, episode or text.

    Raises `RecordingError`: It cannot be read, or holds neither.
    """
    with open_source(path) as source:
        if isinstance(source, TextSource):
            text = source.text()
            robot = published_robot(request.robot, text)
            run = published_run(robot, text, request.locked)
            return Loaded(path, robot, (run,), Attempt({}), text)
        read = read_source(source, request)
    found = found_in(read.recording.get(), request)
    return Loaded(path, request.robot, found, read.temperatures)


def read_bag(path: Path, request: Request) -> Read:
    """What one bag or episode holds. Raises `RecordingError`: It cannot be opened."""
    with open_recording(path) as source:
        return read_source(source, request)


def read_source(source: BagSource | EpisodeSource, request: Request) -> Read:
    """What an open bag or episode holds, as far as it can be read."""
    topic = request.options.state_topic
    motors = Attempt.to(lambda: source.motors(topic))
    return Read(
        source.path,
        Attempt.to(lambda: recording_in(source, request, motors)),
        motors,
        Attempt.to(lambda: source.temperatures(topic)),
    )


def bag_recording(path: Path, request: Request) -> Recording:
    """What one bag, or one episode of a data set, holds for a robot, named after it. Raises `RecordingError`: It cannot be read."""
    return read_bag(path, request).recording.get()


def bag_runs(path: Path, request: Request) -> tuple[Run, ...]:
    """The runs of one bag, named after it. Raises `RecordingError`: It cannot be read, or holds no runs."""
    return runs_in(bag_recording(path, request), request)


def bag_motion(path: Path, request: Request) -> Motion:
    """One bag as a motion of all joints that have a motor and turn, named after it.

    Raises `RecordingError`: It cannot be read, or nothing moves in it.
    """
    return _motion(bag_recording(path, request), request)


def bag_runs_or_motion(path: Path, request: Request) -> tuple[Run, ...] | Motion:
    """The runs of one bag, or its motion where several joints were driven at once, or one under a controller.

    Raises `RecordingError`: It cannot be read, or holds neither.
    """
    return found_in(bag_recording(path, request), request)


def runs_in(recording: Recording, request: Request) -> tuple[Run, ...]:
    """Runs, with what was noted of the recording. Raises `RecordingError`: It holds none."""
    return _noted(_runs(recording, request), recording, request)


def found_in(recording: Recording, request: Request) -> tuple[Run, ...] | Motion:
    """Runs, with what was noted of the recording, or the motion that it holds."""
    found = runs_or_motion(recording, request)
    return found if isinstance(found, Motion) else _noted(found, recording, request)


def runs_or_motion(recording: Recording, request: Request) -> tuple[Run, ...] | Motion:
    """The same of a recording that was read."""
    if _under_a_controller(recording, request.robot):
        return _motion(recording, request)
    try:
        return _runs(recording, request)
    except DrivenAtOnce:
        return _motion(recording, request)


def _runs(recording: Recording, request: Request) -> tuple[Run, ...]:
    """Raises: RecordingError: It holds no runs, or what was commanded is not what flowed."""
    held = standing(request, recording.joints.names)
    runs = cut_runs(recording, held=held, joints=list(request.robot.drive_trains))
    usable = {run.joint: request.robot.drive_trains[run.joint].usable_velocity for run in runs}
    refuse_pace_of_runs(recording, runs)
    refuse_other_current(recording, Effort(request.unit, request.effort_per_current), usable)
    return runs


def _motion(recording: Recording, request: Request) -> Motion:
    """The recording as a motion; fingers that were not recorded stand where their range allows nearest to zero, which is noted."""
    robot = request.robot
    _refuse_unmeasured(recording, request.options.effort_unit)
    locked = standing(request, recording.joints.names)
    known = {*recording.joints.names, *locked}
    slides = [
        robot.model.joint(name) for name in robot.model.independent_joints if name not in known
    ]
    taken = {
        each.name: float(np.clip(0.0, each.lower, each.upper))
        for each in slides
        if each.kind == "prismatic"
    }
    still = robot.motion_calibration is not None
    turning = turning_joints(robot)
    motion = motion_of(
        recording,
        joints=turning,
        held={**taken, **locked},
        standing=still,
    )
    if len(turning) == 1:  # of several the regression asks the clock
        refuse_pace_of_joint(recording, turning[0])
    notes = tuple(
        f"{recording.name}: {name} was not recorded and is taken to stand at {value:g} m; --set held.{name}=VALUE states it"
        for name, value in taken.items()
    )
    return replace(motion, notes=motion.notes + notes)


def _refuse_unmeasured(recording: Recording, unit: str | None) -> None:
    """Raises: RecordingError: A unit of measured efforts was stated, there are none, and a command would stand in for them.

    What a controller commands by its own model knows nothing of a load.
    """
    record = recording.joints
    inputs = recording.inputs
    if unit is None or inputs is None or inputs.measured or inputs.computed:
        return
    if record.reported_effort is None or not np.isfinite(record.reported_effort).any():
        raise RecordingError(
            f"{recording.name}: --effort-unit {unit} says that efforts were measured, and the joint states hold none (no numbers, "
            f"or NaN only): record them, or leave it out to take what {inputs.source} commanded for what flowed"
        )


def standing(request: Request, recorded: Collection[str]) -> dict[str, float]:
    """Where joints stand [rad or m]: as is stated now, else as the robot's file says of those that were not recorded."""
    kept = {name: at for name, at in request.robot.held.items() if name not in recorded}
    return kept | dict(request.locked)


def _under_a_controller(recording: Recording, robot: Robot) -> bool:
    """Whether a recording can only be a motion: currents were measured and none was commanded, or only motions were calibrated."""
    inputs = recording.inputs
    if recording.joints.current is None or inputs is None:
        return False
    if inputs.computed:
        return True
    if inputs.measured:
        learnt = robot.motion_calibration is not None or robot.joint_calibration is not None
        return learnt and robot.calibration is None
    return not inputs.current_A.any()


def recording_in(
    source: BagSource | EpisodeSource, request: Request, motors: Attempt[Motors]
) -> Recording:
    """What an open bag or episode holds for a robot, named after it.

    Args:
        source: The bag or episode.
        request: What is asked, with the robot.
        motors: Of the arm, as the source has them.

    Returns:
        The recording, with a note on each repair.

    Raises:
        RecordingError: It cannot be read, or is of another arm.
        ConfigurationError: What is stated of it cannot be.
    """
    robot = request.robot
    path = source.path
    if request.driver is not None and request.driver.refused:
        raise RecordingError(f"{path}: {request.driver.refused}")
    refuse_unit(robot, request.unit)
    options = read_options(request)
    recording = source.recording(options)
    refuse_prefix(path, recording.joints.names, options.joint_order)
    recording = without_jumps(recording, options.joint_order)
    if voltage_driven(robot):
        signals = source.drive_signals(options)
        if signals is not None:
            recording = replace(recording, signals=signals)
        recording = with_stall_currents(recording, robot)
    recording = replace(
        recording,
        name=source.name or recording.name,
        notes=(
            *recording.notes,
            *motors_notes(path, robot, motors),
            *_implausible_unit(recording, request),
        ),
    )
    _refuse_currents(path, recording.inputs, request)
    return recording


def read_options(request: Request) -> ReadOptions:
    """How a recording is read for a request; raises ConfigurationError: its unit of the effort is unknown."""
    options = request.options
    driver = request.driver
    robot = request.robot
    model = robot.model
    joints = {name: model.joint(name) for name in model.independent_joints}
    return ReadOptions(
        Effort(request.unit, request.effort_per_current),
        list(robot.drive_trains),
        request.conventions,
        options.state_topic,
        options.command_topic,
        options.span,
        states_only=len(voltage_driven(robot)) == len(robot.drive_trains),
        columns=None if driver is None else driver.columns,
        limits={name: (joint.lower, joint.upper) for name, joint in joints.items()},
    )


def _refuse_currents(path: Path, inputs: InputRecord | None, request: Request) -> None:
    """Raise RecordingError: currents were commanded, and a URDF alone states no torque constants."""
    source = request.robot.source
    if request.unit != "N.m" or not is_description(str(source)) or inputs is None:
        return
    if not inputs.measured and inputs.unit != "N.m":
        raise RecordingError(
            f"{path}: {inputs.source} are currents, and {source.name} states no torque constants: write a file with "
            "`proprio robot new`, or state each with --set robot.joints.JOINT.motor.nominal_torque_constant_N_m_per_A=VALUE"
        )


def _implausible_unit(recording: Recording, request: Request) -> tuple[str, ...]:
    """A note where the effort is far from what gravity needs in the unit of the driver's profile."""
    driver = request.driver
    if driver is None:
        return ()
    return tuple(
        f"effort in {each.unit} (--driver {driver.name}) is {np.median(list(each.ratio.values())):.2g} times the torque "
        "that gravity needs by the URDF, and an empty hand gives 1: is it this driver, and are the torque constants right?"
        for each in plausible_units(recording, request.robot)[1]
        if each.unit == request.unit and not each.plausible
    )


def motors_notes(path: Path, robot: Robot, motors: Attempt[Motors]) -> tuple[str, ...]:
    """A note where a recording is of the motors that were calibrated, but these have other firmware now.

    Args:
        path: Of the recording, for a refusal.
        robot: With its calibration; one that names no motors is of any arm.
        motors: As the recording names them.

    Returns:
        A sentence, or none.

    Raises:
        RecordingError: It is of another arm, as far as both say whose it is, or cannot be read.
    """
    if robot.calibration is None or not robot.calibration.motors:
        return ()
    recorded = motors.get()
    if differences := other_arm(robot.calibration.motors, recorded):
        raise RecordingError(
            f"{path}: another arm than that of {robot.source.name}, or its motors were set anew: {differences}: calibrate this "
            "arm, or name its own calibration"
        )
    updated = other_firmware(robot.calibration.motors, recorded)
    if not updated:
        return ()
    return (f"other firmware than when {robot.source.name} was made: {updated}: calibrate again",)


def refuse_uncalibrated(robot: Robot, runs: Sequence[Run]) -> None:
    """Raises: RecordingError: only motions were calibrated, and these are runs."""
    if runs and robot.calibration is None and robot.motion_calibration is not None:
        raise RecordingError(
            f"{runs[0].name}: one joint was driven; --calibration {robot.source.name} was made from motions of several and says "
            "nothing about such runs: calibrate with empty-hand runs, or leave it out"
        )


def turning_joints(robot: Robot) -> list[str]:
    """The joints that have a motor and turn: those of a motion."""
    return [name for name in robot.drive_trains if robot.model.joint(name).kind != "prismatic"]


def _noted(
    runs: Sequence[Run],
    recording: Recording,
    request: Request,
) -> tuple[Run, ...]:
    """Each run with what was noted of the whole recording."""
    notes = recording.notes + unit_not_used(recording.inputs, request.options.effort_unit)
    return tuple(replace(run, notes=(*notes, *run.notes)) for run in runs)


def unit_not_used(
    inputs: InputRecord | None,
    effort_unit: str | None,
) -> tuple[str, ...]:
    """A note where the user said what effort means, and nothing was made of it."""
    if inputs is None or inputs.measured or effort_unit is None:
        return ()
    return (
        f"--effort-unit {effort_unit} was not used: the current is that of {inputs.source}, not measured effort",
    )
