"""What is in a bag and what could be identified from it, before any fit: ``proprio check``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from proprio_ros.errors import ConfigurationError, ProprioError, RecordingError, RobotError
from proprio_ros.experiment_design.predicted_mass import (
    OneMore,
    mass_from_motion,
    mass_from_run,
    more_of_motion,
    more_of_run,
)
from proprio_ros.identification.gates import MIN_USED, UNMOVED_RAD, Findings, screen_run, unusable
from proprio_ros.identification.prepared_runs import KnownLoad, PreparedRun, prepare_run
from proprio_ros.identification.reasons import Reason, about
from proprio_ros.identification.regression.at_rest import refuse_useless
from proprio_ros.identification.regression.causes import torque_cause
from proprio_ros.identification.regression.one_joint_fit import fit_one_joint
from proprio_ros.identification.regression.one_joint_known import tables_of
from proprio_ros.identification.solvable import solvable
from proprio_ros.inputs.resources import paths_of
from proprio_ros.inputs.settings import Settings
from proprio_ros.pipeline.loading import (
    Found,
    followed,
    runs_or_motion,
    turning_joints,
    unit_not_used,
)
from proprio_ros.pipeline.looked_into import BagCheck, MotionCheck, RunCheck
from proprio_ros.pipeline.replay import refuse_uncalibrated
from proprio_ros.pipeline.request import Options, Request, read_request
from proprio_ros.probes import all_probes
from proprio_ros.recordings.contents import Contents
from proprio_ros.recordings.drivers import drivers_of
from proprio_ros.recordings.effort import EFFORT_UNITS, Effort, effort_sign_option
from proprio_ros.recordings.effort_units import EffortUnit, plausible_units
from proprio_ros.recordings.motions import SLOWEST_HZ, Motion, motion_of
from proprio_ros.recordings.plausibility import Finding, findings, moving
from proprio_ros.recordings.sources import RecordingSource, TextSource, open_recording
from proprio_ros.recordings.text import is_text_recording
from proprio_ros.recordings.topics import JOINT_STATE
from proprio_ros.recordings.voltage import voltage_driven
from proprio_ros.records import (
    LOST_AFTER_PERIODS,
    MEASURED_EFFORT,
    FloatArray,
    InputRecord,
    Recording,
    Run,
)
from proprio_ros.robot import Robot, is_description
from proprio_ros.threads import one_blas_thread

UNUSABLE_EFFORT = ("unsigned_register", "effort_stale", "constant_effort")
"""Findings after which no torque can be made of a measured effort."""
UNUSABLE_MOTION = ("unsigned_register", "constant_effort")
"""The same of a motion, where all joints that move have it: one of several is passed over, and an old effort is only coarse."""
DOUBTFUL_EFFORT = (*UNUSABLE_EFFORT, "effort_without_sign")
"""Findings after which an effort is not compared with gravity: a joint that only ever lifts has one sign, too."""


@one_blas_thread
def check_bags(
    paths: str | Path | Sequence[str | Path],
    options: Options | None = None,
) -> tuple[str, list[BagCheck]]:
    """Look into bags or text recordings without fitting anything: the robot's name, and one entry per bag.

    What the options leave open is said in the answer. Of the settings ``robot.``, ``held.JOINT`` and ``payload.frame``
    count, and what is stated about an object is not looked at.

    Raises:
        ConfigurationError, RobotError, RecordingError: No path is given, the robot cannot be read, a path is no bag, or a setting
            is unknown.
    """
    given = [Path(path) for path in paths_of(paths)]
    if not given:
        raise ConfigurationError("no recording given: name at least one bag")
    options = (options or Options()).for_recordings(given)
    # a URDF alone is enough to look, as where torque was recorded: what needs torque constants is then not said
    described = read_request(replace(options, effort_unit="N.m", driver=None), _any_object)
    request = replace(described, options=options)
    return request.robot.name, [
        (_text_check if is_text_recording(path) else _bag_check)(request, path) for path in given
    ]


def _lacking(options: Options) -> str:
    """What a robot file lacks that everything but a look needs; nothing where it is whole."""
    try:
        read_request(options, _any_object)
    except RobotError as error:
        return str(error)
    except ConfigurationError:
        pass  # a driver whose effort weighs nothing is said beside
    return ""


def _any_object(settings: Settings) -> None:
    """Whatever is stated about an object."""
    for start in ("solver.", *(start for probe in all_probes() for start in probe.keys)):
        settings.take_prefix(start)


@dataclass(frozen=True)
class _Looked:
    """What a fit would have to go by."""

    robot: Robot  # with the joints of a motion that are only read
    recording: Recording | None = None  # None: not even its joint states can be read
    runs: tuple[RunCheck, ...] = ()
    motion: Motion | None = None
    problem: ProprioError | None = None  # why neither runs nor a motion could be looked for


def _bag_check(request: Request, path: Path) -> BagCheck:
    """A bag, an episode or a table."""
    options = request.reading.options
    with open_recording(path) as source:
        contents = source.contents(options)
        looked = _Looked(request.robot, problem=contents.problem)
        if contents.problem is None:
            looked = _looked_into(source, request, contents)
    types = {name: kind for name, kind, _ in contents.topics}
    columns = {f"/{name}": "" for name, _ in contents.columns}
    check = BagCheck(
        str(path),
        topics=contents.topics,
        columns=contents.columns,
        state_topic=contents.states,
        driver=request.driver,
        fitting=tuple(driver.name for driver in drivers_of({**types, **columns}.items())),
    )
    if looked.recording is None:
        return replace(check, refusal=looked.problem)
    return _shown(request, looked, looked.recording, types, check)


def _looked_into(
    source: RecordingSource,
    request: Request,
    contents: Contents,
) -> _Looked:
    """What an open source holds, as far as it can be read."""
    looked = _Looked(request.robot)
    try:
        recording = request.reading.recording(source)
        looked = replace(looked, recording=recording)
        return _with_found(looked, runs_or_motion(recording, request))
    except (RecordingError, RobotError) as error:
        looked = replace(looked, problem=error)
    if looked.recording is not None or not contents.topics:
        return looked
    # only to look at: no run is cut from a current of an unstated unit
    states = replace(
        request.reading.options,
        effort=Effort(None, {}),
        command_topic=None,
        span=None,
        fits_names=False,
        states_only=True,
    )
    try:
        return replace(looked, recording=source.recording(states))
    except RecordingError as worse:
        return replace(looked, problem=worse)


def _with_found(looked: _Looked, found: Found) -> _Looked:
    """The same with the runs or the motion that were found; raises what `replay` raises of them."""
    robot = looked.robot
    if found.motions:
        robot, [motion] = followed(robot, found.motions)
        _refuse_motion(robot, motion)
        return replace(looked, robot=robot, motion=motion)
    refuse_uncalibrated(robot, found.runs)
    return replace(looked, runs=tuple(_run_check(robot, run) for run in found.runs))


def _shown(
    request: Request,
    looked: _Looked,
    recording: Recording,
    types: Mapping[str, str],
    check: BagCheck,
) -> BagCheck:
    """A check with what the recording shows of itself."""
    robot = looked.robot
    request = replace(request, robot=robot)
    slides = [joint.name for joint in robot.model.joints if joint.kind == "prismatic"]
    moved = moving(recording.joints, slides)
    seen = _findings(request, recording, slides)
    looked = _without_unusable(looked, recording.inputs, seen)
    doubtful = {
        name for finding in seen if finding.code in DOUBTFUL_EFFORT for name in finding.joints
    }
    by_voltage = voltage_driven(robot)
    per_torque: Mapping[str, float] = {}
    units: tuple[EffortUnit, ...] = ()
    if not by_voltage:
        per_torque, units = plausible_units(recording, robot, doubtful)
    tells = None
    # a joint alone whose torque's scale is open is weighed with known loads, not with an empty hand
    if not by_voltage or len(robot.drive_trains) > 1:
        tells = _motion_check(robot, recording, looked.motion)
    notes = (*recording.notes, *(f"URDF: {note}" for note in robot.model.notes))
    if looked.motion is None:
        notes += unit_not_used(recording.inputs, request.options.effort_unit)
    driven_by, driven_in = _input_of(recording, looked.runs, types, request.unit)
    names = recording.joints.names
    check = replace(
        check,
        joints=names,
        **_spacing(1e-9 * (recording.joints.times_ns - recording.joints.times_ns[0])),
        input=driven_by or None,
        input_unit=driven_in or None,
        runs=looked.runs,
        refusal=looked.problem,
        notes=notes,
        motion=looked.motion,
        moves=moved,
        still=tuple(name for name in names if name not in moved),
        findings=(*seen, *_contradicted(request, looked.motion, units)),
        effort_units=units,
        sign_option=effort_sign_option(names, names, recording.joints.turned),
        effort_per_N_m=per_torque,
        tells=tells,
    )
    return replace(check, record=_advice(robot, recording, check))


def _findings(
    request: Request,
    recording: Recording,
    slides: Sequence[str],
) -> tuple[Finding, ...]:
    """What the recording shows of itself, and what the robot leaves open."""
    robot = request.robot
    seen = (
        *findings(recording, slides),
        *_of_robot(request, recording),
    )
    # what the law of a position servo makes of goal and position needs no effort
    drives = {name: drive.driven_by for name, drive in robot.drive_trains.items()}
    without = {name for name, drive in drives.items() if drive is not None and drive.follows_goal}
    return tuple(
        each
        for each in seen
        if each.code not in DOUBTFUL_EFFORT or not without.issuperset(each.joints)
    )


def _without_unusable(
    looked: _Looked,
    inputs: InputRecord | None,
    seen: Sequence[Finding],
) -> _Looked:
    """The same without a motion of whose measured effort no torque can be made; runs of such an effort have a problem."""
    if inputs is not None and not inputs.measured and not inputs.computed:
        return looked
    looked = replace(
        looked,
        runs=tuple(_with_effort(run, seen) for run in looked.runs),
    )
    for finding in seen:
        if (
            looked.motion is not None
            and finding.code in UNUSABLE_MOTION
            and set(looked.motion.moved) <= set(finding.joints)
        ):
            problem = RecordingError(f"of no use as a motion: {finding.sentence}")
            looked = replace(looked, motion=None, problem=problem)
    return looked


@solvable
def _refuse_motion(robot: Robot, motion: Motion) -> None:
    """Raise what `replay` raises of this motion by itself."""
    if len(motion.joints) > 1:
        refuse_useless(robot, motion)
    elif robot.joint_calibration is not None or voltage_driven(robot):
        tables_of(robot, motion, motion.joints[0])
    else:
        fit_one_joint(robot, [motion], motion.joints[0])


def _contradicted(
    request: Request,
    motion: Motion | None,
    units: Sequence[EffortUnit],
) -> tuple[Finding, ...]:
    """The one mistake that explains the torques of a motion which are not those that gravity needs by the URDF."""
    if motion is None or len(motion.joints) < 2 or request.unit is None:
        return ()
    if any(each.plausible and each.unit == request.unit for each in units):
        return ()
    cause = torque_cause(request.robot, motion)
    if cause is None:
        return ()
    return (Finding("unlike_urdf", cause.sentence(()), motion.joints),)


def _spacing(times_s: FloatArray) -> dict[str, Any]:
    """How long joint states were recorded and how densely, as `BagCheck` has it."""
    intervals = np.diff(times_s)
    period = float(np.median(intervals))
    return {
        "duration_s": float(times_s[-1]),
        "rate_Hz": 1.0 / period,
        "gaps": int(np.sum(intervals > LOST_AFTER_PERIODS * period)),
        "longest_gap_s": float(intervals.max()),
    }


def _of_robot(request: Request, recording: Recording) -> tuple[Finding, ...]:
    """What the robot that was named leaves open."""
    robot = request.robot
    recorded = recording.joints.names
    file = robot.source.name
    if not set(recorded) & set(robot.model.independent_joints):
        why = f"none of these joints is one of {robot.name}: name the robot with --robot NAME, FILE or URDF"
        return (Finding("other_robot", why, recorded),)
    if is_description(str(robot.source)) and request.unit != "N.m":
        why = (
            f"{file} states no torque constants: write a file with `proprio robot new` and state them there, or "
            "--effort-unit N.m where effort is torque"
        )
        return (Finding("no_torque_constants", why),)
    lacking = _lacking(request.options)
    if lacking:
        why = f"{lacking}; until then `replay` and `calibrate` refuse it"
        return (Finding("no_torque_constants", why),)
    found = []
    for name, drive in robot.drive_trains.items():
        kind = drive.driven_by
        if kind is not None and name in recorded:
            why = (
                f"a voltage drives {name} ({kind.kind} in {file}): its torque is made from {kind.takes}, and its scale is open: a "
                "joint alone is weighed with motions of known loads (`calibrate --reference BAG=KG ..`, three or more)"
            )
            found.append(Finding("voltage_driven", why, (name,)))
    return tuple(found)


def _with_effort(run: RunCheck, seen: Sequence[Finding]) -> RunCheck:
    """A run driven by a measured effort, of which no torque can be made, is of no use."""
    for finding in seen:
        if (
            finding.code in UNUSABLE_EFFORT
            and run.joint in finding.joints
            and not run.problem
            and not run.is_free_response
        ):
            return replace(run, problem=finding.sentence, mass_half_width_kg=None)
    return run


def _motion_check(
    robot: Robot,
    recording: Recording,
    motion: Motion | None,
) -> MotionCheck | None:
    """What a motion determines; also of one whose currents are not known, since none is looked at."""
    turning = turning_joints(robot)
    if motion is None:
        if recording.inputs is not None or set(turning) - set(recording.joints.names):
            return None
        nothing = InputRecord(
            recording.joints.times_ns[:1], tuple(turning), np.zeros((1, len(turning))), "nothing"
        )
        try:
            motion = motion_of(replace(recording, inputs=nothing), joints=turning)
        except RecordingError:
            return None
        if len(motion.moved) < 2:
            return None
    # a joint that was not recorded stands somewhere, which matters little
    held = {
        **dict.fromkeys(robot.model.independent_joints, 0.0),
        **motion.held,
    }
    standing = replace(motion, held=held)
    try:
        width_kg, per_kg = solvable(mass_from_motion)(robot, standing)
        more = more_of_motion(robot, standing, width_kg, per_kg)
    except (RecordingError, RobotError):
        return None
    stated = not is_description(str(robot.source))
    if not stated:
        more = tuple(each for each in more if each.load_kg is None)
    moved_s = float(motion.times_s[-1])
    return MotionCheck(motion.moved, moved_s, width_kg, per_kg if stated else None, more)


def _advice(
    robot: Robot,
    recording: Recording,
    check: BagCheck,
) -> tuple[str, ...]:
    """What to record instead, or beside it."""
    advice = []
    swinging = any(run.is_free_response for run in check.runs)
    if recording.inputs is None and recording.joints.reported_effort is None and not swinging:
        advice.append(
            "what the motors gave, too: their torque or current as effort in /joint_states, or commands in /applied_effort or "
            "/current_command"
        )
    if not swinging and any(finding.code in DOUBTFUL_EFFORT for finding in check.findings):
        advice.append("effort as it was measured, with its sign, read anew for each joint state")
    if check.rate_Hz < SLOWEST_HZ:
        advice.append(f"at 50 Hz or more: {check.rate_Hz:.0f} Hz is too slow for a motion")
    if not check.moves:
        advice.append("a motion: nothing moves here")
    elif check.tells is not None:
        longer = " and both for 15 s or longer" if check.tells.duration_s < 15.0 else ""
        same = "the same motion with the object and with an empty hand, on the same day: the latter is the `--baseline`"
        advice.append(same + longer)
    elif any(not run.problem for run in check.runs) and not swinging and not robot.is_calibrated():
        advice.append(
            "runs with an empty hand, for `proprio calibrate`: it narrows what a run tells severalfold"
        )
    return tuple(advice)


def _input_of(
    recording: Recording,
    runs: Sequence[RunCheck],
    types: Mapping[str, str],
    unit: str | None,
) -> tuple[str, str]:
    """Where the current would come from, and what its numbers are; empty where there is none."""
    inputs = recording.inputs
    if any(run.is_free_response for run in runs):
        return "none, torque is off", ""
    if inputs is None and recording.joints.reported_effort is None:
        return "", ""
    if inputs is not None and inputs.computed:
        return inputs.source, "A"
    if inputs is None or inputs.measured:
        return MEASURED_EFFORT, unit or f"not stated: --effort-unit {'|'.join(EFFORT_UNITS)}"
    if inputs.unit != "N.m":
        return inputs.source, inputs.unit
    published = types.get(inputs.source, JOINT_STATE) == JOINT_STATE  # a table has no topics
    return inputs.source, "N m or N, current x nominal torque constant" if published else "N m or N"


@solvable
def _run_check(robot: Robot, run: Run) -> RunCheck:
    joint = robot.model.joint(run.joint)
    travel = (
        float(np.ptp(run.position))
        if run.is_free_response
        else float(run.position[-1] - run.position[0])
    )
    largest = float(run.input_current_A[np.argmax(np.abs(run.input_current_A))])
    slides = joint.kind == "prismatic"
    found = Findings()
    try:
        # as with an empty hand: that suits the gripper, too, and the gates are the same
        prepared = prepare_run(robot, run, KnownLoad(), past_fast=slides)
        problem = _unusable_closing(prepared) if slides else unusable(prepared)
        screen_run(robot, prepared, found)
    except RecordingError as error:
        problem = str(error)
    notes = (*run.notes, *about(found.reasons, run.name))
    width_kg = None
    more: tuple[OneMore, ...] = ()
    if not problem and not slides and not run.is_free_response:
        with suppress(RobotError):
            width_kg = mass_from_run(robot, run)
            more = more_of_run(robot, run)
    driven = (
        run.duration_s,
        travel,
        "m" if slides else "rad",
        largest,
        len(run.times_s),
    )
    return RunCheck(
        run.name,
        run.joint,
        *driven,
        problem,
        notes,
        width_kg,
        run.is_free_response,
        more,
    )


def _unusable_closing(run: PreparedRun) -> str:
    """Why a closing of the gripper is of no use: fingers on a stiff block need not get far."""
    if run.used >= MIN_USED and abs(run.travel) < UNMOVED_RAD:
        moved = 1e3 * abs(run.travel * run.drive.transmission)
        return Reason(
            "stuck", f"the fingers moved only {moved:.2f} mm, so friction decides where they are"
        )
    return unusable(run) if run.used < MIN_USED else ""


def _text_check(request: Request, path: Path) -> BagCheck:
    """A text recording is one run, driven by the torque that its setting states."""
    with TextSource(path) as source:
        text = source.text()
    drive = request.robot.drive_trains.get(text.joint)
    current_A = float(text.setting["torque_N_m"]) / (
        np.nan if drive is None else drive.nominal_effort_per_current
    )
    driven = (
        float(text.times_s[-1]),
        float(text.relative_position[-1]),
        "rad",
        current_A,
        len(text.times_s),
    )
    problem = (
        "" if drive is not None else f"{request.robot.name} has no drive train for {text.joint}"
    )
    run = RunCheck(text.name, text.joint, *driven, problem)
    check = BagCheck(
        str(path),
        (text.joint,),
        **_spacing(text.times_s),
        runs=(run,),
    )
    return replace(check, input="the torque in setting.json", input_unit="N m")
