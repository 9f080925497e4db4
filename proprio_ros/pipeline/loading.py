"""From one recording to what a request makes of it: its runs, or its motion."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from proprio_ros.errors import RecordingError, some
from proprio_ros.identification.regression.motion_equations import moving_carriers
from proprio_ros.pipeline.request import Request
from proprio_ros.recordings.contradictions import refuse_other_current
from proprio_ros.recordings.for_robot import Read
from proprio_ros.recordings.motions import MOVED_RAD, Motion, motion_of
from proprio_ros.recordings.pace import refuse_pace_of_joint, refuse_pace_of_runs
from proprio_ros.recordings.published import published_robot, published_run
from proprio_ros.recordings.runs import DrivenAtOnce, cut_runs
from proprio_ros.recordings.sources import Attempt, TextSource, open_recording, open_source
from proprio_ros.recordings.text import TextRecording
from proprio_ros.records import InputRecord, Recording, Run
from proprio_ros.robot import Robot
from proprio_ros.robot.hands import path_to

MOVED_SLIDE_M = 0.02  # a slide that moves less stands still [m]


@dataclass(frozen=True)
class Found:
    """What a recording holds for a robot: runs, or one motion."""

    runs: tuple[Run, ...] = ()
    motions: tuple[Motion, ...] = ()


@dataclass(frozen=True)
class Loaded:
    """What one recording gave."""

    path: Path
    robot: Robot  # as the request has it, or as a text says of its own
    found: Found
    # how warm the motors were on average, by joint [deg C], as far as the recording says it
    temperatures: Attempt[Mapping[str, float]]
    text: TextRecording | None = None  # where it is one


def load(path: Path, request: Request) -> Loaded:
    """The runs or the motion of one bag, episode or text.

    Raises `RecordingError`: It cannot be read, or holds neither.
    """
    with open_source(path) as source:
        if isinstance(source, TextSource):
            text = source.text()
            robot = published_robot(request.robot, text)
            run = published_run(robot, text, request.locked)
            return Loaded(path, robot, Found((run,)), Attempt({}), text)
        read = request.reading.of(source)
    found = found_in(read.recording.get(), request)
    return Loaded(path, request.robot, found, read.temperatures)


def read_bag(path: Path, request: Request) -> Read:
    """What one bag or episode holds. Raises `RecordingError`: It cannot be opened."""
    with open_recording(path) as source:
        return request.reading.of(source)


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


def runs_in(recording: Recording, request: Request) -> tuple[Run, ...]:
    """Runs, with what was noted of the recording. Raises `RecordingError`: It holds none."""
    return _noted(_runs(recording, request), recording, request)


def found_in(recording: Recording, request: Request) -> Found:
    """Runs, with what was noted of the recording, or the motion that it holds."""
    found = runs_or_motion(recording, request)
    return replace(found, runs=_noted(found.runs, recording, request))


def runs_or_motion(recording: Recording, request: Request) -> Found:
    """Runs or the motion, without what was noted of the recording."""
    if not _under_a_controller(recording, request.robot):
        with suppress(DrivenAtOnce):
            return Found(_runs(recording, request))
    return Found(motions=(_motion(recording, request),))


def _runs(recording: Recording, request: Request) -> tuple[Run, ...]:
    """Raises: RecordingError: It holds no runs, or what was commanded is not what flowed."""
    held = standing(request, recording.joints.names)
    runs = cut_runs(recording, held=held, joints=list(request.robot.drive_trains))
    usable = {run.joint: request.robot.drive_trains[run.joint].usable_velocity for run in runs}
    refuse_pace_of_runs(recording, runs)
    delivered = refuse_other_current(recording, request.reading.options.effort, usable)
    return tuple(replace(run, delivered=delivered.get(run.joint)) for run in runs)


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
    carried = moving_carriers(robot, motion, turning)
    if carried:
        notes += (
            f"{recording.name}: the arm was carried about by {some(carried)}: how they moved is taken into account, and their "
            "efforts are not used",
        )
    return replace(motion, notes=motion.notes + notes)


def followed(robot: Robot, motions: Sequence[Motion]) -> tuple[Robot, list[Motion]]:
    """A robot and its motions, with joints between motors and hand that are only read: where they were counts, no effort of them.

    Args:
        robot: As its file states it.
        motions: Of it, which are fitted together.

    Returns:
        Both, as they were where no such joint moved, within a motion or between two.

    Raises:
        RecordingError: One moved, and in some motion its position was not recorded, or it cannot be followed.
    """
    among = {name for motion in motions for name in motion.joints}
    robot = robot.with_only_read(sorted(among - {*robot.drive_trains}))
    for name in _moved_unstated(robot, motions):
        followers = [
            joint.name for joint in robot.model.joints if robot.model.driving(joint)[0] == name
        ]
        driven = [joint for joint in motions[0].joints if joint not in robot.only_read]
        if len(followers) > 1 or len(driven) == 1:
            raise RecordingError(
                f"{name} moved and moves the hand, and {robot.source.name} does not say what force drives it: state it under "
                "joints, or hold it while the others move",
                motions[0].name,
            )
        robot = robot.with_only_read([name])
    return robot, [_with_read(motion, robot.only_read) for motion in motions]


def _moved_unstated(robot: Robot, motions: Sequence[Motion]) -> list[str]:
    """Joints between the arm's joints and the hand that moved, and of whose drives nothing is known."""
    moved = []
    for name in path_to(robot.model, robot.payload_frame):
        places = [motion.beside[name] for motion in motions if name in motion.beside]
        carries = any(name in robot.model.carriers(motion.joints) for motion in motions)
        if carries or not places:
            continue
        slides = robot.model.joint(name).kind == "prismatic"
        if np.ptp(np.concatenate(places)) > (MOVED_SLIDE_M if slides else MOVED_RAD):
            moved.append(name)
    return moved


def _with_read(motion: Motion, names: Sequence[str]) -> Motion:
    """The same with joints that are only read among its joints; nobody measured their efforts."""
    further = [name for name in names if name not in motion.joints]
    if not further:
        return motion
    unknown = [name for name in further if name not in motion.beside]
    if unknown:
        raise RecordingError(
            f"the position of {unknown[0]}, which moves the hand, was not recorded, and it is elsewhere in another recording: "
            "record it",
            motion.name,
        )
    places = [motion.beside[name] for name in further]
    note = (
        f"{motion.name}: of {some(further)} between the motors and the hand only positions are read: how they moved is taken into "
        "account, and their efforts are not used"
    )
    return replace(
        motion,
        joints=(*motion.joints, *further),
        position=np.column_stack([motion.position, *places]),
        current_A=np.column_stack([motion.current_A, *(np.full_like(at, np.nan) for at in places)]),
        held={name: at for name, at in motion.held.items() if name not in further},
        beside={name: at for name, at in motion.beside.items() if name not in further},
        notes=(*motion.notes, note),
    )


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
            f"--effort-unit {unit} says that efforts were measured, and the joint states hold none (no numbers, "
            f"or NaN only): record them, or leave it out to take what {inputs.source} commanded for what flowed",
            recording.name,
        )


def standing(
    request: Request,
    recorded: Collection[str],
) -> dict[str, float]:
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


def turning_joints(robot: Robot) -> list[str]:
    """The joints of a motion: those that have a motor and turn, and slides that move the hand and whose efforts are forces.

    Those that are only read come in by `followed`.
    """
    slides = path_to(robot.model, robot.payload_frame)
    return [
        name
        for name, drive in robot.drive_trains.items()
        if name not in robot.only_read
        and (
            robot.model.joint(name).kind != "prismatic"
            or (name in slides and drive.transmission == 1.0)
        )
    ]


def _noted(
    runs: Sequence[Run],
    recording: Recording,
    request: Request,
) -> tuple[Run, ...]:
    """Each run with what was noted of the whole recording."""
    notes = recording.notes + unit_not_used(recording.inputs, request.options.effort_unit)
    return tuple(
        replace(
            run,
            notes=(
                *notes,
                *run.notes,
            ),
        )
        for run in runs
    )


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
