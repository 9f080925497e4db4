"""From bags on disk to an estimate: the one function that the command line, a script and the identifier node share."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from proprio_ros.calibration_files.drift import aged, said
from proprio_ros.calibration_files.motors import other_arm, other_firmware
from proprio_ros.calibration_files.pushes import Moment
from proprio_ros.errors import ConfigurationError, RecordingError, RobotError
from proprio_ros.identification.estimate import Estimate
from proprio_ros.identification.recorded import recorded_run
from proprio_ros.inputs.reading import path_problem
from proprio_ros.inputs.resources import paths_of
from proprio_ros.inputs.settings import Settings, number
from proprio_ros.probes import all_probes, probe_named
from proprio_ros.probes.base import Probe, Recorded, TakesMotions
from proprio_ros.recordings.contents import read_motors, read_temperatures
from proprio_ros.recordings.datasets import episode_of, read_episode
from proprio_ros.recordings.description import robot_named
from proprio_ros.recordings.drivers import Driver, load_driver
from proprio_ros.recordings.effort import CURRENT_PER_COUNT_A
from proprio_ros.recordings.motions import Motion, motion_of
from proprio_ros.recordings.plausibility import effort_per_torque, effort_units
from proprio_ros.recordings.published import published_robot, published_run
from proprio_ros.recordings.runs import DrivenAtOnce, cut_runs
from proprio_ros.recordings.signals import read_drive_signals, read_recording, without_jumps
from proprio_ros.recordings.text import TextRecording, is_text_recording, read_text_recording
from proprio_ros.recordings.topics import OUR_DRIVER, Conventions
from proprio_ros.recordings.voltage import refuse_unit, voltage_driven, with_stall_currents
from proprio_ros.records import InputRecord, Recording, Run, Span
from proprio_ros.report import write_page
from proprio_ros.robot import Robot, is_description, with_recorded_torque
from proprio_ros.schema import calibration_used
from proprio_ros.threads import one_blas_thread

DEFAULT_ROBOT = "open_manipulator_x"
TEXT_ROBOT = "open_manipulator_x_as_published"
"""Robot of a text recording that names none: the description that the paper's public example simulates."""


@dataclass(frozen=True)
class ReplayOptions:
    """All options of ``proprio replay``; see its ``--help``.

    Attributes:
        settings: dotted keys of the probe file, ``held.JOINT``, and ``robot.`` keys of the robot file, with plain values.
        calibration: what ``proprio calibrate`` wrote.
        baseline: recordings of the same robot made with the others: with nothing in the hand, or for the probe `container` with the
            empty container.
        driver: profile of the driver that published; topics and unit that are stated beside it win.
        span: the part of each recording that is read; of a baseline all is.
    """

    probe: str = "payload"
    robot: str | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)
    solver: str = "lm"
    profile: str = "default"
    calibration: str | Path | None = None
    baseline: Sequence[str | Path] = ()
    state_topic: str | None = None
    command_topic: str | None = None
    effort_unit: str | None = None
    driver: str | Path | None = None
    span: Span | None = None

    @property
    def publisher(self) -> Driver | None:
        """The driver's, read anew.

        Raises:
            ConfigurationError: there is none of that name, or it is wrong.
        """
        return None if self.driver is None else load_driver(self.driver)

    @property
    def conventions(self) -> Conventions:
        """Of the driver that published; Raises as `publisher` does."""
        profile = self.publisher
        return OUR_DRIVER if profile is None else profile.conventions

    @property
    def stated_unit(self) -> str | None:
        """What effort is, as the user says or else the profile; Raises as `publisher` does."""
        profile = self.publisher
        return self.effort_unit or (None if profile is None else profile.effort_unit)

    def check_driver(self) -> None:
        """Raises: ConfigurationError: nothing can be weighed with what this driver publishes."""
        profile = self.publisher
        if profile is not None and profile.refused:
            raise ConfigurationError(f"--driver {profile.name}: {profile.refused}")


@one_blas_thread
def replay(paths: str | Path | Sequence[str | Path], options: ReplayOptions | None = None) -> Estimate:
    """Identify what the probe names from one or more recordings of the same object.

    Args:
        paths: bags (folders or files, either storage) or text recordings; all runs in all of them give one estimate. One path
            may stand alone.
        options: probe, robot and settings.

    Raises:
        ConfigurationError, RobotError, RecordingError: with one line that says what is wrong and what to do.
    """
    options = options or ReplayOptions()
    paths = paths_of(paths)
    started = time.perf_counter()
    if not paths:
        raise ConfigurationError("no recording given: name at least one bag")
    prepared = prepare(options, text=all(map(is_text_recording, paths)))
    loaded = time.perf_counter()
    robot, recorded = read_for(prepared, paths)
    read = time.perf_counter()
    estimate = identify(prepared, robot, recorded, paths)
    timing = {"load": loaded - started, "read": read - loaded, "solve": time.perf_counter() - read}
    return replace(estimate, timing_s=timing)


@dataclass(frozen=True)
class Prepared:
    """What a replay needs before it reads anything; many can share it.

    Attributes:
        options: As given.
        probe, facts: What is to be identified, and what is stated about it.
        robot: As the settings have it.
        held: Positions that are stated [rad or m].
    """

    options: ReplayOptions
    probe: Probe[Any]
    robot: Robot
    held: Mapping[str, float]
    facts: Any


def prepare(options: ReplayOptions, *, text: bool = False) -> Prepared:
    """Read what the options name.

    Args:
        options: Of the replay.
        text: Whether all its recordings are texts.

    Raises:
        ConfigurationError, RobotError: One of them is wrong.
    """
    probe = probe_asked_for(options)
    options.check_driver()
    settings = Settings(options.settings)
    robot_name = options.robot or (TEXT_ROBOT if text else None)
    robot = configured_robot(robot_name, options.calibration, settings, options.stated_unit)
    held = held_positions(robot, settings)
    facts = probe.facts(settings, options.solver, options.profile)
    settings.refuse_rest()
    return Prepared(options, probe, robot, held, facts)


def read_for(prepared: Prepared, paths: Sequence[str | Path]) -> tuple[Robot, Recorded]:
    """Read recordings of one object, and the baseline of the options.

    Returns:
        The robot, which a text recording may change, and what was read.

    Raises:
        RecordingError, ConfigurationError: One cannot be read, or they do not fit together or the probe.
    """
    options, probe, robot, held = prepared.options, prepared.probe, prepared.robot, prepared.held
    whole = replace(options, span=None)
    baseline_paths = paths_of(options.baseline)
    texts = [Path(path) for path in paths if is_text_recording(path)]
    if texts and options.span is not None:
        raise ConfigurationError(f"--span: {texts[0]} is a text recording, which is read whole; leave it out")
    once = Recordings([*paths, *baseline_paths])
    runs: list[Run] = []
    sources: list[Path] = []  # of each run
    motions: list[Motion] = []
    text: TextRecording | None = None
    for path in paths:
        if Path(path) in texts:
            text = read_text_recording(path)
            robot = published_robot(robot, text)
            runs.extend(once.checked(path, (published_run(robot, text, held),)))
        else:
            found = bag_runs_or_motion(Path(path), robot, options, held)
            if isinstance(found, Motion):
                motions.append(once.checked_motion(path, found))
            else:
                runs.extend(once.checked(path, found))
        sources.extend([Path(path)] * (len(runs) - len(sources)))
    if motions and runs:
        raise RecordingError(
            f"{motions[0].name}: is a motion (several joints at once, or one under a controller), but {runs[0].name} holds probes: "
            "replay them apart"
        )
    if runs and robot.calibration is None and robot.motion_calibration is not None:
        raise RecordingError(
            f"{runs[0].name}: one joint was driven; --calibration {robot.source.name} was made from motions of several and says "
            "nothing about such runs: calibrate with empty-hand runs, or leave it out"
        )
    if motions and not isinstance(probe, TakesMotions):
        raise RecordingError(
            f"{motions[0].name}: several joints were driven at once, or one under a controller; --probe {probe.name} wants one at "
            "a time, from rest with a constant current"
        )
    if (swings := [run.name for run in runs if run.free]) and not isinstance(probe, TakesMotions):
        raise RecordingError(f"{swings[0]}: a free swing; --probe {probe.name} wants a joint that a current drives")
    robot = aged_for(robot, runs, paths, options.state_topic)
    baseline: list[Run] = []
    baseline_motions: list[Motion] = []
    for path in baseline_paths:
        if motions:
            baseline_motions.append(once.checked_motion(path, bag_motion(Path(path), robot, whole, held)))
        else:
            baseline.extend(once.checked(path, bag_runs(Path(path), robot, whole, held)))
    return robot, Recorded(runs, baseline, sources, text, motions, baseline_motions)


def identify(prepared: Prepared, robot: Robot, read: Recorded, paths: Sequence[str | Path]) -> Estimate:
    """Identify what the probe names from what was read.

    Args:
        prepared: What the options name.
        robot: As `read_for` gave it.
        read: The recordings.
        paths: Where they come from.

    Raises:
        RecordingError: A recording is of no use.
    """
    options, runs, baseline = prepared.options, read.runs, read.baseline
    probe = prepared.probe
    of = probe.identify_motions if read.motions and isinstance(probe, TakesMotions) else probe.identify
    estimate = of(robot, read, prepared.facts)
    learnt = (robot.motion_calibration or robot.joint_calibration) if read.motions else robot.calibration
    origin = {
        "bags": [str(path) for path in paths],
        "baseline": [str(path) for path in paths_of(options.baseline)],
        "calibration": None if learnt is None else calibration_used(robot.source),
    }
    recorded = [*(recorded_run(robot, run) for run in runs), *(recorded_run(robot, run, True) for run in baseline)]
    notes = (*estimate.notes, *_guessed_frame(robot, options.settings))
    fresh = prepared.robot.calibration
    if fresh is not None and robot.calibration is not None:
        notes += tuple(filter(None, (said(fresh, robot.drift, robot.calibration.made),)))
    return replace(estimate, notes=notes, origin=origin, recorded=tuple(recorded))


def aged_for(robot: Robot, runs: Sequence[Run], paths: Sequence[str | Path], state_topic: str | None = None) -> Robot:
    """The robot, of whose calibration as much is known as was left when some runs were recorded (see `drift`)."""
    if robot.calibration is None or robot.calibration.made is None or not runs:
        return robot
    return aged_robot(robot, moment_of(runs, paths, state_topic))


def aged_robot(robot: Robot, now: Moment) -> Robot:
    """The robot, of whose calibration as much is known as is left by now."""
    if robot.calibration is None:
        return robot
    calibration = aged(robot.calibration, robot.drift, now)
    return robot if calibration is robot.calibration else robot.with_calibration(calibration)


def moment_of(runs: Sequence[Run], paths: Sequence[str | Path], state_topic: str | None = None) -> Moment:
    """When runs were recorded, and how warm the motors were in the bags that say it."""
    heard: dict[str, list[float]] = {}
    for path in paths:
        if is_text_recording(path) or episode_of(Path(path)) is not None:
            continue
        for joint, degrees in read_temperatures(path, state_topic).items():
            heard.setdefault(joint, []).append(degrees)
    warmth = {joint: float(np.mean(values)) for joint, values in heard.items()}
    return Moment(1e-9 * float(np.mean([run.onset_ns for run in runs])), warmth)


def _guessed_frame(robot: Robot, settings: Mapping[str, Any]) -> tuple[str, ...]:
    """A note where nobody said which link holds the objects."""
    if not is_description(str(robot.source)) or not {"payload.frame", "robot.payload_frame"}.isdisjoint(settings):
        return ()
    return (
        f"{robot.payload_frame} is taken as the link that holds the object, a guess: --set payload.frame=LINK states it",
    )


def compile_for(options: ReplayOptions) -> None:
    """Compile ahead what an identification with these options needs on this computer; again it costs nothing.

    Raises:
        ConfigurationError, RobotError: a setting is wrong, or compiled kernels cannot be kept.
    """
    probe = probe_asked_for(options)
    settings = Settings(options.settings)
    robot = configured_robot(options.robot, options.calibration, settings, options.stated_unit)
    facts = probe.facts(settings, options.solver, options.profile)
    settings.refuse_rest()
    probe.compile(robot, facts)


def probe_asked_for(options: ReplayOptions) -> Probe[Any]:
    """The probe that the options name, with a solver and a profile that it has.

    Raises:
        ConfigurationError: there is none, or it lacks them.
    """
    probe = probe_named(options.probe)
    for flag, given, default in (("solver", options.solver, "lm"), ("profile", options.profile, "default")):
        there = {each.name: getattr(each, f"{flag}s", (default,)) for each in all_probes()}
        having = [name for name, choices in there.items() if given in choices]
        if not having:
            choices = dict.fromkeys(choice for each in there.values() for choice in each)
            raise ConfigurationError(f"{flag} {given!r} is unknown; choose one of: {', '.join(choices)}")
        if probe.name not in having:
            raise ConfigurationError(f"--{flag} {given} is only there for --probe {', '.join(having)}; leave it out")
    return probe


def write_report(estimate: Estimate, path: Path, *, command: str = "", sources: Sequence[str] = ()) -> None:
    """Write the page for one result, with what its probe has to show; an older page of that name is replaced in one step.

    Args:
        estimate: what to show.
        path: the HTML file.
        command: the command line that gives the same result again.
        sources: the recordings it came from.

    Raises:
        ConfigurationError: the file cannot be written.
    """
    write_page(estimate, path, probe_named(estimate.probe).sections(estimate), command=command, sources=sources)


def robot_of(name: str | None, calibration: str | Path | None, overrides: Mapping[str, Any] | None = None) -> Robot:
    """The robot of a name or file, with its calibration where there is one, and with dotted settings that replace some of its own.

    Raises:
        RobotError: either cannot be read, or the calibration is of another robot.
    """
    if calibration is None:
        return robot_named(name or DEFAULT_ROBOT, overrides)
    if Path(calibration).suffix not in (".yaml", ".yml"):
        raise RobotError(
            f"--calibration {calibration}: expected the .yaml file that `proprio calibrate --output` wrote"
        )
    robot = robot_named(calibration, overrides)
    if robot.calibration is None and robot.motion_calibration is None and robot.joint_calibration is None:
        raise RobotError(
            f"--calibration {calibration}: holds no calibration; write it with `proprio calibrate --output`"
        )
    if name is not None:
        asked = robot_named(name, with_recorded_torque(name, {}))
        if asked.model.fingerprint() != robot.model.fingerprint():
            raise RobotError(
                f"--calibration {calibration} is of {robot.name}, whose URDF is not that of --robot {name}: calibrate that robot"
            )
    return robot


def configured_robot(
    name: str | None, calibration: str | Path | None, settings: Settings, effort_unit: str | None = None
) -> Robot:
    """The robot as the user's ``robot.`` settings and ``payload.frame`` have it.

    Args:
        name: as for `robot_named`.
        calibration: what ``proprio calibrate`` wrote.
        settings: the two are taken out of them.
        effort_unit: a URDF alone is enough where torque was recorded.

    Raises:
        ConfigurationError, RobotError: a setting does not fit it, or as for `robot_of`.
    """
    overrides = settings.take_prefix("robot.")
    if calibration is None and effort_unit == "N.m":
        overrides = with_recorded_torque(name or DEFAULT_ROBOT, overrides)
    robot = robot_of(name, calibration, overrides)
    frame = settings.take("payload.frame", None)
    if frame is not None:
        links = [link.name for link in robot.model.links]
        if frame not in links:
            raise ConfigurationError(f"payload.frame={frame!r} is no link of {robot.name}; it has: {', '.join(links)}")
        robot = replace(robot, payload_frame=str(frame))
    return robot


def held_positions(robot: Robot, settings: Settings) -> dict[str, float]:
    """The user's ``held.JOINT`` settings."""
    held = {name: number(f"held.{name}", value) for name, value in settings.take_prefix("held.").items()}
    for name in held:
        robot.model.joint(name)
    return held


class Recordings:
    """What was given, each recording once: a run that counts twice would narrow the interval without a reason.

    Args:
        paths: All that were given, whatever for.

    Raises:
        ConfigurationError: Two of them lead to the same place.
    """

    def __init__(self, paths: Sequence[str | Path]) -> None:
        places: dict[Path, str | Path] = {}
        for path in paths:
            if problem := path_problem(path):
                raise ConfigurationError(f"{path}: {problem}")
            place = Path(path).resolve()
            if place in places:
                raise ConfigurationError(_twice(places[place], path))
            places[place] = path
        self._paths: dict[tuple[object, ...], str | Path] = {}

    def checked(self, path: str | Path, runs: Sequence[Run]) -> Sequence[Run]:
        """The runs of one path.

        Raises:
            ConfigurationError: Another path held one of them: the same samples at the same times, and the same current.
        """
        for run in runs:
            self._check(path, run.joint, run.times_s, run.position, run.input_current_A)
        return runs

    def checked_motion(self, path: str | Path, motion: Motion) -> Motion:
        """The motion of one path; Raises as `checked` does."""
        self._check(path, " ".join(motion.joints), motion.times_s, motion.position, motion.current_A)
        return motion

    def _check(self, path: str | Path, joint: str, *arrays: np.ndarray) -> None:
        key: tuple[object, ...] = (joint, *(array.tobytes() for array in arrays))
        if self._paths.setdefault(key, path) != path:
            raise ConfigurationError(_twice(self._paths[key], path))


def _twice(one: str | Path, other: str | Path) -> str:
    if str(one) == str(other):
        return f"{one} was given twice: name each recording once"
    return f"{one} and {other} are the same recording: name it once"


def bag_runs(path: Path, robot: Robot, options: ReplayOptions, held: Mapping[str, float]) -> tuple[Run, ...]:
    """The runs of one bag, named after it.

    Raises:
        RecordingError: it cannot be read, or holds no runs.
    """
    recording = bag_recording(path, robot, options)
    return _noted(cut_runs(recording, held=held, joints=list(robot.drive_trains)), recording, options)


def bag_motion(path: Path, robot: Robot, options: ReplayOptions, held: Mapping[str, float]) -> Motion:
    """One bag as a motion of all joints that have a motor and turn, named after it.

    Raises:
        RecordingError: it cannot be read, or nothing moves in it.
    """
    return _motion(bag_recording(path, robot, options), robot, held)


def bag_runs_or_motion(
    path: Path, robot: Robot, options: ReplayOptions, held: Mapping[str, float]
) -> tuple[Run, ...] | Motion:
    """The runs of one bag, or its motion where several joints were driven at once, or one under a controller.

    Raises:
        RecordingError: it cannot be read, or holds neither.
    """
    recording = bag_recording(path, robot, options)
    found = runs_or_motion(recording, robot, held)
    return found if isinstance(found, Motion) else _noted(found, recording, options)


def runs_or_motion(recording: Recording, robot: Robot, held: Mapping[str, float]) -> tuple[Run, ...] | Motion:
    """The runs of a recording, or its motion where several joints were driven at once, or one under a controller.

    Raises:
        RecordingError: it holds neither.
    """
    if _under_a_controller(recording, robot):
        return _motion(recording, robot, held)
    try:
        return cut_runs(recording, held=held, joints=list(robot.drive_trains))
    except DrivenAtOnce:
        return _motion(recording, robot, held)


def _motion(recording: Recording, robot: Robot, held: Mapping[str, float]) -> Motion:
    """The recording as a motion; fingers that were not recorded stand where their range allows nearest to zero, which is noted."""
    known = {*recording.joints.names, *held}
    slides = [robot.model.joint(name) for name in robot.model.independent_joints if name not in known]
    taken = {each.name: float(np.clip(0.0, each.lower, each.upper)) for each in slides if each.kind == "prismatic"}
    motion = motion_of(recording, joints=turning_joints(robot), held={**taken, **held})
    notes = tuple(
        f"{recording.name}: {name} was not recorded and is taken to stand at {value:g} m; --set held.{name}=VALUE states it"
        for name, value in taken.items()
    )
    return replace(motion, notes=motion.notes + notes)


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


def bag_recording(path: Path, robot: Robot, options: ReplayOptions) -> Recording:
    """What one bag holds for a robot, named after it.

    Raises:
        RecordingError: it cannot be read.
    """
    profile = options.publisher
    if profile is not None and profile.refused:
        raise RecordingError(f"{path}: {profile.refused}")
    refuse_unit(robot, options.stated_unit)
    by_voltage = voltage_driven(robot)
    episode = episode_of(path)
    if episode is not None:
        return _episode_recording(path, *episode, robot, options)
    recording = read_recording(
        path,
        state_topic=options.state_topic,
        command_topic=options.command_topic,
        effort_unit=options.stated_unit,
        conventions=options.conventions,
        nominal_torque_constants={n: drive.nominal_effort_per_current for n, drive in robot.drive_trains.items()},
        joint_order=list(robot.drive_trains),
        states_only=len(by_voltage) == len(robot.drive_trains),
        span=options.span,
    )
    recording = without_jumps(recording, list(robot.drive_trains))
    if by_voltage:
        recording = replace(
            recording, signals=read_drive_signals(path, options.state_topic, options.conventions, options.span)
        )
        recording = with_stall_currents(recording, robot)
    notes = recording.notes + check_motors(path, robot, options.state_topic)
    if profile is not None:
        notes += _implausible_unit(recording, robot, profile, options.stated_unit)
    if (
        options.stated_unit == "N.m"
        and is_description(str(robot.source))
        and recording.inputs is not None
        and not recording.inputs.measured
        and recording.inputs.unit != "N.m"
    ):
        raise RecordingError(
            f"{path}: {recording.inputs.source} are currents, and {robot.source.name} states no torque constants: write a file "
            "with `proprio robot new`, or state each with --set robot.joints.JOINT.motor.nominal_torque_constant_N_m_per_A=VALUE"
        )
    # a bag's folder is often called after its storage, so the folder above says which one it is
    return replace(recording, notes=notes, name="/".join(path.resolve().parts[-2:]))


def _episode_recording(path: Path, folder: Path, index: int, robot: Robot, options: ReplayOptions) -> Recording:
    """One episode of a data set; Raises as `bag_recording` does."""
    profile = options.publisher
    if profile is None or profile.columns is None:
        raise ConfigurationError(
            f"{path}: an episode of a data set, whose units nobody states: give --driver lerobot, another profile with columns, or "
            "your own file"
        )
    joints = {name: robot.model.joint(name) for name in robot.model.independent_joints}
    recording = read_episode(
        folder,
        index,
        profile.columns,
        names=profile.conventions.names,
        prefix=profile.conventions.prefix,
        effort_unit=options.stated_unit,
        nominal_torque_constants={n: drive.nominal_effort_per_current for n, drive in robot.drive_trains.items()},
        limits={name: (joint.lower, joint.upper) for name, joint in joints.items()},
        span=options.span,
    )
    recording = without_jumps(recording, list(robot.drive_trains))
    if voltage_driven(robot):
        recording = with_stall_currents(recording, robot)
    notes = recording.notes + _implausible_unit(recording, robot, profile, options.stated_unit)
    return replace(recording, notes=notes)


def _implausible_unit(recording: Recording, robot: Robot, profile: Driver, unit: str | None) -> tuple[str, ...]:
    """A note where the effort is far from what gravity needs in the unit that holds."""
    try:
        per_torque = effort_per_torque(recording, robot)
    except RobotError:  # a body without mass
        return ()
    stated = {} if is_description(str(robot.source)) else robot.drive_trains
    constants = {name: drive.torque_constant.value for name, drive in stated.items()}
    for each in effort_units(per_torque, constants, CURRENT_PER_COUNT_A):
        if each.unit == unit and not each.plausible:
            ratio = f"{float(np.median(list(each.ratio.values()))):.2g}"
            return (
                f"effort in {unit} (--driver {profile.name}) is {ratio} times the torque that gravity needs by the URDF, and an "
                "empty hand gives 1: is it this driver, and are the torque constants right?",
            )
    return ()


def check_motors(path: Path, robot: Robot, state_topic: str | None) -> tuple[str, ...]:
    """Whether a bag is of the arm that was calibrated, as far as both say whose it is.

    Returns:
        A note where the same motors have other firmware now.

    Raises:
        RecordingError: It is of another arm, or cannot be read.
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
    return (f"other firmware than when {robot.source.name} was made: {updated}: calibrate again",) if updated else ()


def turning_joints(robot: Robot) -> list[str]:
    """The joints that have a motor and turn: those of a motion."""
    return [name for name in robot.drive_trains if robot.model.joint(name).kind != "prismatic"]


def _noted(runs: Sequence[Run], recording: Recording, options: ReplayOptions) -> tuple[Run, ...]:
    """Each run with what was noted of the whole recording."""
    notes = recording.notes + unit_not_used(recording.inputs, options.effort_unit)
    return tuple(replace(run, notes=(*notes, *run.notes)) for run in runs)


def unit_not_used(inputs: InputRecord | None, effort_unit: str | None) -> tuple[str, ...]:
    """A note where the user said what effort means, and nothing was made of it."""
    if inputs is None or inputs.measured or effort_unit is None:
        return ()
    return (f"--effort-unit {effort_unit} was not used: the current is that of {inputs.source}, not measured effort",)
