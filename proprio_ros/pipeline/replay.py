"""From bags on disk to an estimate: the one function that the command line, a script and the identifier node share."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from proprio_ros.calibration_files.drift import aged, ageing_note
from proprio_ros.calibration_files.pushes import Moment
from proprio_ros.errors import ConfigurationError, RecordingError
from proprio_ros.identification.estimate import Estimate, HeldView
from proprio_ros.identification.recorded import held_views, recorded_run
from proprio_ros.identification.solvable import solvable
from proprio_ros.inputs.resources import paths_of
from proprio_ros.pipeline.distinct import Distinct
from proprio_ros.pipeline.loading import (
    Loaded,
    bag_motion,
    bag_runs,
    followed,
    load,
)
from proprio_ros.pipeline.request import Options, Request, request_of
from proprio_ros.probes import probe_named
from proprio_ros.probes.base import Carries, Recorded, TakesMotions
from proprio_ros.recordings.for_robot import Read
from proprio_ros.recordings.motions import Motion
from proprio_ros.recordings.text import TextRecording, is_text_recording
from proprio_ros.records import Run
from proprio_ros.robot import Robot, is_description
from proprio_ros.schema import calibration_used
from proprio_ros.threads import one_blas_thread


@one_blas_thread
def replay(
    paths: str | Path | Sequence[str | Path],
    options: Options | None = None,
) -> Estimate:
    """Identify what the probe names from one or more bags or text recordings of the same object.

    All runs in all of them give one estimate. One path may stand alone.

    Raises:
        ConfigurationError, RobotError, RecordingError: With one line that says what is wrong and what to do.
    """
    paths = paths_of(paths)
    started = time.perf_counter()
    if not paths:
        raise ConfigurationError("no recording given: name at least one bag")
    request = request_of((options or Options()).for_recordings(paths))
    loaded = time.perf_counter()
    robot, recorded = read_for(request, paths)
    read = time.perf_counter()
    estimate = identify(request, robot, recorded, paths)
    timing = {
        "load": loaded - started,
        "read": read - loaded,
        "solve": time.perf_counter() - read,
    }
    return replace(estimate, timing_s=timing)


def read_for(
    request: Request,
    paths: Sequence[str | Path],
) -> tuple[Robot, Recorded]:
    """Read recordings of one object, and the baseline of the options.

    Returns: The robot, which a text recording may change, with as much of its calibration as was left by then; and what was read.

    Raises:
        RecordingError, ConfigurationError: One cannot be read, or they do not fit together or the probe.
    """
    options = request.options
    baseline_paths = paths_of(request.options.baseline)
    texts = [path for path in paths if is_text_recording(path)]
    if texts and options.span is not None:
        raise ConfigurationError(
            f"--span: {Path(texts[0])} is a text recording, which is read whole; leave it out"
        )
    distinct = Distinct([*paths, *baseline_paths])
    runs: list[Run] = []
    sources: list[Path] = []  # of each run
    motions: list[Motion] = []
    text: TextRecording | None = None
    loaded: list[Loaded] = []
    for path in paths:
        each = load(Path(path), request)
        loaded.append(each)
        request = replace(request, robot=each.robot)
        text = each.text or text
        motions.extend(distinct.motion(path, motion) for motion in each.found.motions)
        runs.extend(distinct.runs(path, each.found.runs))
        sources.extend([each.path] * len(each.found.runs))
    _refuse_unsuited(request, runs, motions)
    learnt = request.robot.calibration
    if learnt is not None and learnt.made is not None and runs:
        request = replace(
            request,
            robot=aged_robot(request.robot, moment_of(runs, loaded)),
        )
    whole = replace(request, options=replace(options, span=None))
    baseline: list[Run] = []
    baseline_motions: list[Motion] = []
    for path in baseline_paths:
        if motions:
            baseline_motions.append(distinct.motion(path, bag_motion(Path(path), whole)))
        else:
            baseline.extend(distinct.runs(path, bag_runs(Path(path), whole)))
    count = len(motions)
    robot, read = followed(request.robot, [*motions, *baseline_motions])
    return robot, Recorded(runs, baseline, sources, text, read[:count], read[count:])


def _refuse_unsuited(
    request: Request,
    runs: Sequence[Run],
    motions: Sequence[Motion],
) -> None:
    """Raises: RecordingError: runs and motions do not go together, or do not suit calibration or probe."""
    if motions and runs:
        raise RecordingError(
            f"{motions[0].name}: is a motion (several joints at once, or one under a controller), but {runs[0].name} holds probes: "
            "replay them apart"
        )
    refuse_uncalibrated(request.robot, runs)
    if isinstance(request.probe, TakesMotions):
        return
    wants = f"--probe {request.probe.name} wants"
    for motion in motions:
        several = "several joints were driven at once, or one under a controller"
        raise RecordingError(
            f"{motion.name}: {several}; {wants} one at a time, from rest with a constant current"
        )
    for run in runs:
        if run.is_free_response:
            raise RecordingError(f"{run.name}: a free swing; {wants} a joint that a current drives")


def refuse_uncalibrated(robot: Robot, runs: Sequence[Run]) -> None:
    """Raises: RecordingError: only motions were calibrated, and these are runs."""
    if runs and robot.calibration is None and robot.motion_calibration is not None:
        raise RecordingError(
            f"{runs[0].name}: one joint was driven; --calibration {robot.source.name} was made from motions of several and says "
            "nothing about such runs: calibrate with empty-hand runs, or leave it out"
        )


@solvable
def identify(
    request: Request, robot: Robot, read: Recorded, paths: Sequence[str | Path]
) -> Estimate:
    """Identify what the probe names.

    Args:
        request: What is asked.
        robot: As `read_for` gave it.
        read: Recordings, as `read_for` gave them.
        paths: Where they come from.

    Returns:
        The answer, with its origin.

    Raises:
        RecordingError: A recording is of no use.
    """
    estimate = request.probe.identify(robot, read, request.facts)
    learnt = (
        (robot.motion_calibration or robot.joint_calibration) if read.motions else robot.calibration
    )
    origin = {
        "bags": [str(path) for path in paths],
        "baseline": [str(path) for path in paths_of(request.options.baseline)],
        "calibration": None if learnt is None else calibration_used(robot.source),
    }
    recorded = [recorded_run(robot, run) for run in read.runs]
    recorded += [recorded_run(robot, run, True) for run in read.baseline]
    taken = [f"URDF: {note}" for note in robot.model.notes]
    notes = (*estimate.notes, *taken, *_guessed_frame(robot, request.options.settings))
    fresh = request.robot.calibration
    if fresh is not None and robot.calibration is not None:
        drifted = ageing_note(fresh, robot.drift, robot.calibration.made)
        if drifted:
            notes += (drifted,)
    views = _held_views(request, robot, read.motions[0], estimate) if read.motions else ()
    return replace(
        estimate,
        notes=notes,
        origin=origin,
        recorded=tuple(recorded),
        held_views=views,
    )


def _held_views(
    request: Request, robot: Robot, motion: Motion, estimate: Estimate
) -> tuple[HeldView, ...]:
    """The arm in the first motion with the load that the answer stands for."""
    probe = request.probe
    load = probe.carried(request.facts, estimate) if isinstance(probe, Carries) else None
    if load is None:
        return held_views(robot, motion, None)
    place = next(
        (value for value in estimate.values if value.name == "payload_com"),
        None,
    )
    ends = place.ci95 if place is not None and None not in place.ci95 else None
    within = None if ends is None else [0.5 * (high - low) for low, high in ends]
    about = (load.mass_kg, load.com_m, np.asarray(load.inertia_kg_m2))
    return held_views(robot, motion, about, load.inertia_is, within)


def aged_robot(robot: Robot, now: Moment) -> Robot:
    """The robot, of whose calibration as much is known as is left by now (see `drift`)."""
    if robot.calibration is None:
        return robot
    calibration = aged(robot.calibration, robot.drift, now)
    return robot if calibration is robot.calibration else robot.with_calibration(calibration)


def moment_of(
    runs: Sequence[Run],
    recordings: Iterable[Loaded | Read],
) -> Moment:
    """When runs were recorded, and how warm the motors were in the recordings that say it.

    Raises `RecordingError`: It cannot be read how warm they were.
    """
    heard: dict[str, list[float]] = {}
    for recording in recordings:
        for joint, degrees in recording.temperatures.get().items():
            heard.setdefault(joint, []).append(degrees)
    warmth = {joint: float(np.mean(values)) for joint, values in heard.items()}
    return Moment(
        1e-9 * float(np.mean([run.onset_ns for run in runs])),
        warmth,
    )


def _guessed_frame(
    robot: Robot,
    settings: Mapping[str, Any],
) -> tuple[str, ...]:
    """A note where nobody said which link holds the objects."""
    if not is_description(str(robot.source)) or not {
        "payload.frame",
        "robot.payload_frame",
    }.isdisjoint(settings):
        return ()
    frame = f"{robot.payload_frame} is taken as the link that holds the object, a guess"
    return (f"{frame}: --set payload.frame=LINK states it",)


def compile_for(options: Options) -> None:
    """Compile ahead what an identification with these options needs on this computer; again it costs nothing.

    Raises `ConfigurationError`, `RobotError`: A setting is wrong, or compiled kernels cannot be kept.
    """
    request = request_of(options)
    request.probe.compile(request.robot, request.facts)


def write_report(
    estimate: Estimate,
    path: Path,
    *,
    command: str = "",
    sources: Sequence[str] = (),
    force: bool = False,
) -> None:
    """Write the page for one result, with what its probe has to show.

    Args:
        estimate: The result.
        path: Of the page.
        command: With which the result was made.
        sources: Recordings it was made from.
        force: Whether a file that is no page may be replaced.

    Raises:
        ConfigurationError: The page cannot be written.
    """
    from proprio_ros.report import write_page

    own = probe_named(estimate.probe).sections(estimate)
    write_page(estimate, path, own, command=command, sources=sources, force=force)
