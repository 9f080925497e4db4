"""From one recording to what a request makes of it: its runs, or its motion."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from proprio_ros.calibration_files.motors import other_arm, other_firmware
from proprio_ros.errors import ConfigurationError, RecordingError, RobotError
from proprio_ros.inputs.reading import path_problem
from proprio_ros.pipeline.request import Request
from proprio_ros.recordings.contents import read_motors
from proprio_ros.recordings.contradictions import refuse_other_current
from proprio_ros.recordings.datasets import episode_of, read_episode
from proprio_ros.recordings.effort import CURRENT_PER_COUNT_A, Effort
from proprio_ros.recordings.motions import Motion, motion_of
from proprio_ros.recordings.pace import refuse_pace_of_joint, refuse_pace_of_runs
from proprio_ros.recordings.plausibility import EffortUnit, effort_per_torque, effort_units
from proprio_ros.recordings.runs import DrivenAtOnce, cut_runs
from proprio_ros.recordings.signals import (
    read_drive_signals,
    read_recording,
    refuse_prefix,
    without_jumps,
)
from proprio_ros.recordings.voltage import refuse_unit, voltage_driven, with_stall_currents
from proprio_ros.records import InputRecord, Recording, Run
from proprio_ros.robot import Robot, is_description
from proprio_ros.whole_files import real_path

_Found = TypeVar("_Found", Motion, Sequence[Run])


class Recordings:
    """All that was given, each recording once: a run that counts twice would narrow the interval without a reason.

    Raises `ConfigurationError`: Two of the paths lead to the same place.
    """

    def __init__(self, paths: Sequence[str | Path]) -> None:
        places: dict[Path, str | Path] = {}
        for path in paths:
            if problem := path_problem(path):
                raise ConfigurationError(f"{path}: {problem}")
            place = real_path(path)
            if place in places:
                raise ConfigurationError(_twice(places[place], path))
            places[place] = path
        self._paths: dict[tuple[object, ...], str | Path] = {}

    def checked(self, path: str | Path, found: _Found) -> _Found:
        """The runs or the motion of one path.

        Raises `ConfigurationError`: Another path held one of them: the same samples at the same times, and the same current.
        """
        if isinstance(found, Motion):
            self._check(
                path, " ".join(found.joints), found.times_s, found.position, found.current_A
            )
        else:
            for run in found:
                self._check(path, run.joint, run.times_s, run.position, run.input_current_A)
        return found

    def _check(self, path: str | Path, joint: str, *arrays: np.ndarray) -> None:
        key: tuple[object, ...] = (joint, *(array.tobytes() for array in arrays))
        if self._paths.setdefault(key, path) != path:
            raise ConfigurationError(_twice(self._paths[key], path))


def _twice(one: str | Path, other: str | Path) -> str:
    if str(one) == str(other):
        return f"{one} was given twice: name each recording once"
    return f"{one} and {other} are the same recording: name it once"


def bag_runs(path: Path, request: Request) -> tuple[Run, ...]:
    """The runs of one bag, named after it. Raises `RecordingError`: It cannot be read, or holds no runs."""
    recording = bag_recording(path, request)
    return _noted(_runs(recording, request), recording, request)


def bag_motion(path: Path, request: Request) -> Motion:
    """One bag as a motion of all joints that have a motor and turn, named after it.

    Raises `RecordingError`: It cannot be read, or nothing moves in it.
    """
    return _motion(bag_recording(path, request), request)


def bag_runs_or_motion(path: Path, request: Request) -> tuple[Run, ...] | Motion:
    """The runs of one bag, or its motion where several joints were driven at once, or one under a controller.

    Raises `RecordingError`: It cannot be read, or holds neither.
    """
    recording = bag_recording(path, request)
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


def bag_recording(path: Path, request: Request) -> Recording:
    """What one bag, or one episode of a data set, holds for a robot, named after it. Raises `RecordingError`: It cannot be read."""
    robot = request.robot
    options = request.options
    unit = request.unit
    episode = episode_of(path)
    if request.driver is not None and request.driver.refused:
        raise RecordingError(f"{path}: {request.driver.refused}")
    refuse_unit(robot, unit)
    by_voltage = voltage_driven(robot)
    if episode is not None:
        recording = _episode_recording(path, *episode, request)
    else:
        recording = read_recording(
            path,
            state_topic=options.state_topic,
            command_topic=options.command_topic,
            effort_unit=unit,
            conventions=request.conventions,
            nominal_torque_constants=request.effort_per_current,
            joint_order=list(robot.drive_trains),
            states_only=len(by_voltage) == len(robot.drive_trains),
            span=options.span,
        )
    refuse_prefix(path, recording.joints.names, list(robot.drive_trains))
    recording = without_jumps(recording, list(robot.drive_trains))
    if by_voltage:
        if episode is None:
            signals = read_drive_signals(
                path, options.state_topic, request.conventions, options.span
            )
            recording = replace(recording, signals=signals)
        recording = with_stall_currents(recording, robot)
    notes = recording.notes
    if episode is None:
        # a bag's folder is often called after its storage, so the folder above says which one it is
        recording = replace(
            recording,
            name="/".join(path.resolve().parts[-2:]),
        )
        notes += check_motors(path, robot, options.state_topic)
    if request.driver is not None:
        notes += _implausible_unit(recording, request)
    if (
        unit == "N.m"
        and is_description(str(robot.source))
        and (inputs := recording.inputs) is not None
    ):
        if not inputs.measured and inputs.unit != "N.m":
            raise RecordingError(
                f"{path}: {inputs.source} are currents, and {robot.source.name} states no torque constants: write a file with "
                "`proprio robot new`, or state each with --set robot.joints.JOINT.motor.nominal_torque_constant_N_m_per_A=VALUE"
            )
    return replace(recording, notes=notes)


def _episode_recording(path: Path, folder: Path, index: int, request: Request) -> Recording:
    """One episode of a data set; Raises as `bag_recording` does."""
    driver = request.driver
    model = request.robot.model
    if driver is None or driver.columns is None:
        raise ConfigurationError(
            f"{path}: an episode of a data set, whose units nobody states: give --driver lerobot, another profile with columns, or "
            "your own file"
        )
    joints = {name: model.joint(name) for name in model.independent_joints}
    return read_episode(
        folder,
        index,
        driver.columns,
        names=driver.conventions.names,
        prefix=driver.conventions.prefix,
        effort_unit=request.unit,
        nominal_torque_constants=request.effort_per_current,
        limits={name: (joint.lower, joint.upper) for name, joint in joints.items()},
        span=request.options.span,
    )


def _implausible_unit(recording: Recording, request: Request) -> tuple[str, ...]:
    """A note where the effort is far from what gravity needs in the unit of the driver's profile."""
    assert request.driver is not None
    return tuple(
        f"effort in {each.unit} (--driver {request.driver.name}) is {np.median(list(each.ratio.values())):.2g} times the torque "
        "that gravity needs by the URDF, and an empty hand gives 1: is it this driver, and are the torque constants right?"
        for each in plausible_units(recording, request.robot)[1]
        if each.unit == request.unit and not each.plausible
    )


def plausible_units(
    recording: Recording, robot: Robot, without: Collection[str] = ()
) -> tuple[dict[str, float], tuple[EffortUnit, ...]]:
    """Effort over what gravity needs by the robot's URDF, by joint, and how plausible units are by it.

    ``without`` are joints whose effort is of no use.
    """
    try:
        per_torque = effort_per_torque(recording, robot)
    except RobotError:  # a body without mass, as of a robot whose file leaves that joint out
        return {}, ()
    per_torque = {name: value for name, value in per_torque.items() if name not in without}
    stated = {} if is_description(str(robot.source)) else robot.drive_trains
    constants = {name: drive.torque_constant.value for name, drive in stated.items()}
    return per_torque, effort_units(
        per_torque, constants, CURRENT_PER_COUNT_A
    ) if per_torque else ()


def check_motors(
    path: Path,
    robot: Robot,
    state_topic: str | None,
) -> tuple[str, ...]:
    """A note where a bag is of the motors that were calibrated, but these have other firmware now.

    Raises `RecordingError`: It is of another arm, as far as both say whose it is, or cannot be read.
    """
    if robot.calibration is None or not robot.calibration.motors:
        return ()
    motors = read_motors(path, state_topic)
    if differences := other_arm(robot.calibration.motors, motors):
        raise RecordingError(
            f"{path}: another arm than that of {robot.source.name}, or its motors were set anew: {differences}: calibrate this "
            "arm, or name its own calibration"
        )
    updated = other_firmware(robot.calibration.motors, motors)
    return (
        (f"other firmware than when {robot.source.name} was made: {updated}: calibrate again",)
        if updated
        else ()
    )


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
