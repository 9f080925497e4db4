"""From bags on disk to an estimate: the one function that the command line, a script and the identifier node share."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from proprio_ros.bags import TextRecording, is_text_recording, read_recording, read_text_recording
from proprio_ros.errors import ConfigurationError, RobotError
from proprio_ros.identification.estimate import Estimate
from proprio_ros.probes import all_probes, probe_named
from proprio_ros.probes.base import Probe, Recorded
from proprio_ros.published import published_robot, published_run
from proprio_ros.records import Run
from proprio_ros.report import write_page
from proprio_ros.resources import paths_of
from proprio_ros.robot import Robot, load_robot
from proprio_ros.runs import cut_runs
from proprio_ros.schema import calibration_used
from proprio_ros.settings import Settings, number
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
    paths, baseline_paths = paths_of(paths), paths_of(options.baseline)
    started = time.perf_counter()
    probe = probe_asked_for(options)
    if not paths:
        raise ConfigurationError("no recording given: name at least one bag")
    settings = Settings(options.settings)
    texts = [Path(path) for path in paths if is_text_recording(path)]
    robot_name = options.robot or (TEXT_ROBOT if len(texts) == len(paths) else None)
    robot = configured_robot(robot_name, options.calibration, settings)
    held = held_positions(robot, settings)
    facts = probe.facts(settings, options.solver, options.profile)
    settings.refuse_rest()

    loaded = time.perf_counter()
    runs: list[Run] = []
    sources: list[Path] = []  # of each run
    baseline = [run for path in baseline_paths for run in bag_runs(Path(path), robot, options, held)]
    text: TextRecording | None = None
    for path in paths:
        if Path(path) in texts:
            text = read_text_recording(path)
            robot = published_robot(robot, text)
            runs.append(published_run(robot, text, held))
        else:
            runs.extend(bag_runs(Path(path), robot, options, held))
        sources.extend([Path(path)] * (len(runs) - len(sources)))
    read = time.perf_counter()
    estimate = probe.identify(robot, Recorded(runs, baseline, sources, text), facts)
    solved = time.perf_counter()
    timing = {"load": loaded - started, "read": read - loaded, "solve": solved - read}
    origin = {
        "bags": [str(path) for path in paths],
        "baseline": [str(path) for path in baseline_paths],
        "calibration": None if robot.calibration is None else calibration_used(robot.source),
    }
    return replace(estimate, timing_s=timing, origin=origin)


def compile_for(options: ReplayOptions) -> None:
    """Compile ahead what an identification with these options needs on this computer; again it costs nothing.

    Raises:
        ConfigurationError, RobotError: a setting is wrong, or compiled kernels cannot be kept.
    """
    probe = probe_asked_for(options)
    settings = Settings(options.settings)
    robot = configured_robot(options.robot, options.calibration, settings)
    facts = probe.facts(settings, options.solver, options.profile)
    settings.refuse_rest()
    probe.compile(robot, facts)


def probe_asked_for(options: ReplayOptions) -> Probe[Any]:
    """The probe that the options name, with a solver and a profile that it has.

    Raises:
        ConfigurationError: there is none, or it lacks them.
    """
    probe = probe_named(options.probe)
    for flag, given in (("solver", options.solver), ("profile", options.profile)):
        there = {each.name: getattr(each, f"{flag}s") for each in all_probes()}
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


def robot_of(name: str | None, calibration: str | Path | None) -> Robot:
    """The robot of a name or file, with its calibration where there is one.

    Raises:
        RobotError: either cannot be read, or the calibration is of another robot.
    """
    if calibration is None:
        return load_robot(name or DEFAULT_ROBOT)
    if Path(calibration).suffix not in (".yaml", ".yml"):
        raise RobotError(
            f"--calibration {calibration}: expected the .yaml file that `proprio calibrate --output` wrote"
        )
    robot = load_robot(calibration)
    if robot.calibration is None:
        raise RobotError(
            f"--calibration {calibration}: holds no calibration; write it with `proprio calibrate --output`"
        )
    if name is not None:
        asked = load_robot(name)
        if asked.model.fingerprint() != robot.model.fingerprint():
            raise RobotError(
                f"--calibration {calibration} is of {robot.name}, whose URDF is not that of --robot {name}: calibrate that robot"
            )
    return robot


def configured_robot(name: str | None, calibration: str | Path | None, settings: Settings) -> Robot:
    """The robot as the user's ``robot.`` settings and ``payload.frame`` have it.

    Raises:
        ConfigurationError, RobotError: a setting does not fit it, or as for `robot_of`.
    """
    overrides = settings.take_prefix("robot.")
    robot = robot_of(name, calibration)
    if overrides:
        robot = robot.with_overrides(overrides)
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


def bag_runs(path: Path, robot: Robot, options: ReplayOptions, held: Mapping[str, float]) -> tuple[Run, ...]:
    """The runs of one bag, named after it."""
    joints = list(robot.drive_trains)
    recording = read_recording(
        path,
        state_topic=options.state_topic,
        command_topic=options.command_topic,
        effort_unit=options.effort_unit,
        nominal_torque_constants={n: drive.nominal_effort_per_current for n, drive in robot.drive_trains.items()},
        joint_order=joints,
    )
    # a bag's folder is often called after its storage, so the folder above says which one it is
    name = "/".join(path.resolve().parts[-2:])
    runs = cut_runs(replace(recording, name=name), held=held, joints=joints)
    return tuple(replace(run, notes=(*recording.notes, *run.notes)) for run in runs)
