"""From empty-hand bags to a calibration file, and from a calibration to the next run: what the command line and the nodes call."""

from __future__ import annotations

import io
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap
from ruamel.yaml.scalarstring import LiteralScalarString

from proprio_ros.calibration_files.motions import MotionCalibration
from proprio_ros.calibration_files.motors import MotorIdentity, other_arm
from proprio_ros.calibration_files.one_joint import FEWEST_RUNS, JointCalibration
from proprio_ros.calibration_files.pushes import Calibration
from proprio_ros.calibration_files.section import DIGEST, digest_of
from proprio_ros.errors import ConfigurationError, RecordingError, RobotError
from proprio_ros.experiment_design.planning import SECONDS, plan, with_advice
from proprio_ros.identification.calibration_estimate import CalibrationEstimate, ExcitationPlan
from proprio_ros.identification.estimate import RecordedRun, Verdict
from proprio_ros.identification.judge import FAR
from proprio_ros.identification.prepared_runs import KnownLoad
from proprio_ros.identification.reasons import Reason
from proprio_ros.identification.recorded import recorded_run
from proprio_ros.identification.refresh import refresh
from proprio_ros.identification.regression.motion_estimate import calibrate_motions
from proprio_ros.identification.regression.motion_prior import relative_torque_std
from proprio_ros.identification.regression.one_joint_estimate import (
    best_delay,
    calibrate_joint,
    torque_left_over,
)
from proprio_ros.identification.robot_calibration import UNLEARNT, LoadedRun, calibrate
from proprio_ros.identification.solvable import solvable
from proprio_ros.inputs.reading import text_of, yaml_of
from proprio_ros.inputs.resources import (
    check_new_yaml,
    paths_of,
    resource,
    resource_names,
    write_in_one_step,
)
from proprio_ros.inputs.settings import Settings
from proprio_ros.pipeline.distinct import Distinct
from proprio_ros.pipeline.loading import followed, found_in, read_bag, runs_in, runs_or_motion
from proprio_ros.pipeline.replay import aged_robot, moment_of
from proprio_ros.pipeline.request import Options, Request, read_request
from proprio_ros.probes import probe_that
from proprio_ros.probes.base import Carries
from proprio_ros.quantity import Z95, Quantity, shown
from proprio_ros.recordings.for_robot import Read
from proprio_ros.recordings.motions import Motion
from proprio_ros.recordings.voltage import with_stall_currents
from proprio_ros.records import Recording, Run
from proprio_ros.robot import Robot, is_description, nested_settings
from proprio_ros.schema import calibration_used
from proprio_ros.sim.payload import PayloadFacts
from proprio_ros.threads import one_blas_thread
from proprio_ros.version import __version__
from proprio_ros.whole_files import real_path

HEAVIEST_REFERENCE_KG = 5.0
BEYOND_PRIOR = 2.0
"""Standard deviations from nothing of an error that the reference's mass would have, from which it is told."""
LEAST_ARM_STD = 0.02  # no URDF is taken to know an arm's weight better, relative


@one_blas_thread
def calibrate_from_bags(
    paths: str | Path | Sequence[str | Path],
    references: Mapping[str | Path, float],
    options: Options | None = None,
    output: str | Path | None = None,
    progress: Callable[[str], None] = lambda _: None,
    force: bool = False,
) -> CalibrationEstimate:
    """Calibrate a robot and write the file that ``proprio replay --calibration`` takes.

    Args:
        paths: Bags with nothing in the hand.
        references: Bags with a weighed reference in the hand, and its mass [kg]; the payload settings say where it sits.
        options: Robot, settings and topics; what concerns the probe is not used.
        output: The file; it is only written when the calibration is accepted.
        progress: Called with what is going on.
        force: Whether an older file of that name may be replaced.

    Raises:
        ConfigurationError, RobotError, RecordingError: With one line that says what is wrong and what to do.
    """
    paths = paths_of(paths)
    started = time.perf_counter()
    request = _calibration_request(paths, references, options, output, force)
    loads = [KnownLoad() for _ in paths]
    loads += [KnownLoad(mass, request.facts) for mass in references.values()]
    given = [Path(path) for path in (*paths, *references)]
    recorded = _read(given, request, progress)
    masses = [load.mass for load in loads]
    request = _with_learnt_delay(request, recorded.recordings, masses, progress)
    request, runs, motions = _found(request, recorded, loads)
    read = time.perf_counter()
    if motions:
        estimate = _from_motions(request, motions, progress)
    else:
        estimate = with_advice(
            request.robot, solvable(calibrate)(request.robot, runs, progress), progress=progress
        )
    if estimate.calibration is not None:
        made = moment_of([each.run for each in runs], recorded.reads)
        known = replace(estimate.calibration, motors=recorded.motors, made=made)
        estimate = replace(estimate, calibration=known)
    if references:
        swings = bool(runs) and runs[0].run.is_free_response
        estimate = _with_implied_scale(estimate, request.robot, swings)
    estimate = replace(estimate, unused=_unused(estimate, request.robot, runs))
    origin = {
        "bags": [str(path) for path in paths],
        "references": [{"bag": str(path), "mass_kg": mass} for path, mass in references.items()],
    }
    return _written(estimate, output, request, origin, read - started)


def _unused(
    estimate: CalibrationEstimate, robot: Robot, runs: Sequence[LoadedRun]
) -> tuple[RecordedRun, ...]:
    """The runs that the fit left out, as they were recorded."""
    used = {fit.name for fit in estimate.run_fits}
    return tuple(recorded_run(robot, each.run) for each in runs if each.run.name not in used)


def _calibration_request(
    paths: Sequence[str | Path],
    references: Mapping[str | Path, float],
    options: Options | None,
    output: str | Path | None,
    force: bool,
) -> Request:
    """What is asked of a calibration from the start; raises as `calibrate_from_bags` does where that cannot be."""
    _check_given([*paths, *references], output, force)
    for path, mass in references.items():
        if not 0.0 < mass <= HEAVIEST_REFERENCE_KG:
            raise ConfigurationError(
                f"--reference {path}={mass:g}: masses are in kg, so 100 g is 0.1"
            )
    stated = replace(options or Options(), calibration=None)
    request = read_request(stated.for_recordings([*paths, *references]), _reference)
    if output is not None and real_path(output) == real_path(request.robot.source):
        raise ConfigurationError(
            f"--output {output}: is the robot file, and the calibration extends it: name another"
        )
    return request


@dataclass(frozen=True)
class _Recorded:
    """All recordings that a calibration is made from, each opened once."""

    distinct: Distinct
    reads: tuple[Read, ...]
    recordings: tuple[Recording, ...]  # what each holds
    motors: dict[str, MotorIdentity]  # of the one arm that they are of, as far as they say it


def _read(
    paths: Sequence[Path],
    request: Request,
    progress: Callable[[str], None],
) -> _Recorded:
    """Read recordings of one arm. Raises `RecordingError`: One cannot be read, or they are of several."""
    distinct = Distinct(paths)
    motors: dict[str, MotorIdentity] = {}
    reads = []
    for number, path in enumerate(paths, start=1):
        progress(f"reading {path} ({number} of {len(paths)})")
        read = read_bag(path, request)
        found = read.motors.get()
        differences = other_arm(motors, found)
        if differences:
            raise RecordingError(
                f"another arm than that of the recordings before it: {differences}", path
            )
        motors |= found
        reads.append(read)
    recordings = tuple(each.recording.get() for each in reads)
    return _Recorded(distinct, tuple(reads), recordings, motors)


def _found(
    request: Request, recorded: _Recorded, loads: Sequence[KnownLoad]
) -> tuple[Request, list[LoadedRun], list[tuple[Motion, float]]]:
    """Runs, or motions with the mass of what was held [kg], and never both; and the request with joints that are only read."""
    runs: list[LoadedRun] = []
    motions: list[tuple[Motion, float]] = []
    for read, recording, load in zip(recorded.reads, recorded.recordings, loads, strict=True):
        found = found_in(with_stall_currents(recording, request.robot), request)
        for motion in found.motions:
            motions.append((recorded.distinct.motion(read.path, motion), load.mass))
        runs += [LoadedRun(run, load) for run in recorded.distinct.runs(read.path, found.runs)]
    if motions and runs:
        raise RecordingError(
            f"{motions[0][0].name}: is a motion (several joints at once, or one under a controller), but {runs[0].run.name} holds "
            "probes: calibrate with one or the other, each makes a file of its own"
        )
    robot, moved = followed(request.robot, [motion for motion, _ in motions])
    masses_kg = [mass_kg for _, mass_kg in motions]
    return replace(request, robot=robot), runs, list(zip(moved, masses_kg, strict=True))


@one_blas_thread
def refresh_from_bags(
    paths: str | Path | Sequence[str | Path],
    options: Options,
    output: str | Path | None = None,
    progress: Callable[[str], None] = lambda _: None,
    force: bool = False,
) -> CalibrationEstimate:
    """Bring the calibration of the options up to date by a few runs with nothing in the hand, and write it as another file.

    Args:
        paths: Bags with nothing in the hand.
        options: With the old calibration, and topics.
        output: The new file; it is only written when the calibration is accepted.
        progress: Called with what is going on.
        force: Whether an older file of that name may be replaced.

    Returns:
        What is known about the robot now.

    Raises:
        ConfigurationError, RobotError, RecordingError: With one line that says what is wrong and what to do.
    """
    paths = paths_of(paths)
    old = options.calibration
    started = time.perf_counter()
    if old is None:
        raise ConfigurationError("nothing to bring up to date: name the old calibration")
    _check_given(paths, output, force)
    stated = [key for key in options.settings if key.startswith("robot.")]
    if stated:
        raise ConfigurationError(
            f"--set {stated[0]}: {old} says what the robot is; leave it out, or calibrate from the start"
        )
    request = read_request(options.for_recordings(paths))
    fresh = request.robot.calibration
    if fresh is None:
        raise ConfigurationError(
            f"{old} was made from motions; only a calibration of runs can be brought up to date"
        )
    recorded = _read(
        [Path(path) for path in paths],
        request,
        lambda _: None,
    )
    runs: list[Run] = []
    for each, recording in zip(recorded.reads, recorded.recordings, strict=True):
        runs += recorded.distinct.runs(each.path, runs_in(recording, request))
    now = moment_of(runs, recorded.reads)
    robot = aged_robot(request.robot, now)
    read = time.perf_counter()
    estimate = with_advice(
        robot,
        solvable(refresh)(robot, [LoadedRun(run) for run in runs], progress),
        progress=progress,
    )
    learnt = estimate.calibration
    if learnt is not None:
        learnt = replace(
            learnt,
            motors={**fresh.motors, **recorded.motors},
            made=now,
        )
        estimate = replace(estimate, calibration=learnt)
    origin = {
        "bags": [str(path) for path in paths],
        "references": [],
        "refreshed": str(old),
    }
    return _written(
        estimate, output, replace(request, robot=robot), origin, read - started, Path(old)
    )


def _check_given(
    paths: Sequence[str | Path],
    output: str | Path | None,
    force: bool,
) -> None:
    """Raises: ConfigurationError: no recording is given, or the new file must not be written."""
    if output is not None:
        check_new_yaml(Path(output), force)
    if not paths:
        raise ConfigurationError("no recording given: name at least one bag with an empty hand")


def _written(
    estimate: CalibrationEstimate,
    output: str | Path | None,
    request: Request,
    origin: Mapping[str, Any],
    read_s: float,
    like: Path | None = None,
) -> CalibrationEstimate:
    """The estimate with its origin and timing; where it is accepted, it is written first."""
    learnt = estimate.calibration or estimate.motion or estimate.joint
    written = None
    if output is not None and learnt is not None and estimate.verdict.value == "accepted":
        said = "" if estimate.weighable is None else estimate.weighable.sentence()
        # a calibration carries what was stated of the arm, so that nobody has to say it again
        stated: dict[str, Any] = (
            {"held": {**request.robot.held, **request.locked}} if request.locked else {}
        )
        if "payload.frame" in request.options.settings:
            stated["payload_frame"] = request.robot.payload_frame
        write_calibration(
            Path(output), request.robot, learnt, {**request.overrides, **stated}, said, like
        )
        written = calibration_used(Path(output))
    timing = {"read": read_s, **estimate.timing_s}
    return replace(estimate, timing_s=timing, origin={**origin, "calibration": written})


def _reference(settings: Settings) -> PayloadFacts:
    """What is stated of a weighed reference."""
    probe: Carries = probe_that(Carries)
    return probe.reference(settings)


def _with_implied_scale(
    estimate: CalibrationEstimate, robot: Robot, swings: bool = False
) -> CalibrationEstimate:
    """With what the references say of all motors at once: a reason where that, or what the arm then weighs, is beyond its prior.

    A reference whose mass is mistyped scales the motors' torque and the arm's weight alike, and every mass that is weighed later.
    """
    implied = _implied_scale(estimate, robot, swings)
    if implied is None or estimate.verdict.value != "accepted":
        return estimate
    what, scale, arm = implied
    said = f"your reference says that {what}"
    weight = f"the arm then weighs {arm.value:.2f} times what its URDF says, which is known to {100.0 * arm.std:.0f} %"
    # a score test: a mistyped mass moves both alike, torque constants that are off only the first
    weights = 1.0 / np.square([scale.std, arm.std])
    mistyped = float(weights @ [scale.value - 1.0, arm.value - 1.0]) / np.sqrt(weights.sum())
    if abs(mistyped) <= BEYOND_PRIOR:
        return replace(estimate, notes=(f"{said}; {weight}", *estimate.notes))
    cure = "every mass follows it: weigh the reference again, and check the torque constants"
    reasons = (*estimate.reasons, Reason("far_from_prior", f"{said}, and {weight}; {cure}"))
    if abs(mistyped) > FAR:
        return replace(estimate, verdict=Verdict.REJECTED, reasons=reasons)
    motion = estimate.motion
    if motion is not None and (weighable := estimate.weighable) is not None:
        # until it has been weighed again, the intervals of masses reach what the robot file says
        std = max(motion.torque_scale_std, abs(1.0 - 1.0 / scale.value) / Z95)
        until = (
            f"any mass to +-{100.0 * Z95 * std:.0f} % until the reference has been weighed again"
        )
        wide = replace(
            weighable,
            std_kg=float(np.hypot(weighable.std_kg, std * weighable.mass_kg)),
            in_motion=until,
        )
        estimate = replace(estimate, motion=replace(motion, torque_scale_std=std), weighable=wide)
    return replace(estimate, reasons=reasons)


def _implied_scale(
    estimate: CalibrationEstimate, robot: Robot, swings: bool
) -> tuple[str, Quantity, Quantity] | None:
    """True torque over the robot file's, and the arm's weight over its URDF's, by references: value, and the prior's deviation.

    Free responses tell no torque but the rotor's inertia, which follows the references as torque does. In words first.
    """
    motion = estimate.motion
    if motion is not None:
        if not motion.referenced:
            return None
        std = max(relative_torque_std(robot, joint) for joint in motion.joints)
        value = motion.torque_scale
        arm = motion.torque_scale * motion.arm_over_urdf
    else:
        kind = "armature" if swings else "torque_constant"
        rows = [
            row
            for row in estimate.unknowns
            if row.kind == kind and row.std < UNLEARNT * row.prior_std
        ]
        if not rows:
            return None
        row, (values, priors, stds) = (
            rows[0],
            np.array([(row.value, row.prior, row.prior_std) for row in rows]).T,
        )
        by = values if swings else priors  # a rotor may be stated as nothing
        if not np.all(by):
            return None
        value = 1.0 + float(np.mean((values - priors) / by))
        std = float(np.mean(stds / by))
        arm = next(
            (row.value for row in estimate.unknowns if row.kind == "arm_scale"),
            robot.arm_scale.value,
        )
    known = (
        Quantity(value, std),
        Quantity(arm / robot.arm_scale.value, max(robot.arm_scale.std, LEAST_ARM_STD)),
    )
    if swings:
        inertia = f"{shown('kg m^2', row.value, spec='.3g')}, which is known as {row.prior:.3g} +- {row.prior_std:.2g}"
        return f"the rotor of {row.scope} has {inertia}", *known
    more = (
        f"{100.0 * abs(value - 1.0):.0f} % {'stronger' if value >= 1.0 else 'weaker'} than stated"
    )
    if abs(value - 1.0) < 0.005:
        more = "as strong as stated"
    return f"all motors are {more}, which is known to {100.0 * std:.0f} %", *known


@one_blas_thread
@solvable
def plan_excitations(
    masses_kg: Sequence[float],
    options: Options | None = None,
    count: int = 10,
    progress: Callable[[str], None] = lambda _: None,
    seconds: float = SECONDS,
) -> tuple[Robot, list[ExcitationPlan]]:
    """The weighings that would determine most about an object.

    Args:
        masses_kg: That the hand may hold [kg].
        options: Robot, calibration and settings.
        count: Of plans, at most.
        progress: Called with what is going on.
        seconds: After which the search ends.

    Returns:
        The robot, and the plans, best first.

    Raises:
        ConfigurationError, RobotError: With one line that says what is wrong and what to do.
    """
    request = read_request(options or Options(), _reference)
    for name in request.locked:
        raise ConfigurationError(
            f"--set held.{name}: a plan says where every joint is; leave it out"
        )
    return request.robot, plan(
        request.robot,
        masses_kg,
        request.facts,
        count,
        progress,
        seconds,
    )


@solvable
def _from_motions(
    request: Request,
    motions: Sequence[tuple[Motion, float]],
    progress: Callable[[str], None],
) -> CalibrationEstimate:
    """Of motions and the mass of the reference in each [kg]; 0: the hand was empty."""
    robot = request.robot
    facts = request.facts
    empty = [motion for motion, mass_kg in motions if mass_kg == 0.0]
    references = [(motion, mass_kg) for motion, mass_kg in motions if mass_kg > 0.0]
    if references and len(motions[0][0].joints) == 1:
        progress(f"fitting {len(motions)} motions of one joint")
        return calibrate_joint(
            robot, [motion for motion, _ in motions], [kg for _, kg in motions], facts
        )
    if not empty:
        raise RecordingError(
            f"{motions[0][0].name}: a motion with a reference needs one with an empty hand beside it: name that bag, too"
        )
    stated = "payload.com" in request.options.settings
    centre = (np.asarray(facts.com), np.asarray(facts.com_std)) if stated else None
    return calibrate_motions(robot, empty, references, centre, progress)


def write_calibration(
    path: Path,
    robot: Robot,
    calibration: Calibration | MotionCalibration | JointCalibration,
    overrides: Mapping[str, Any] | None = None,
    said: str = "",
    like: Path | None = None,
) -> None:
    """Write a robot file that extends the robot by its calibration; an older file of that name is replaced in one step.

    Args:
        path: Of the file.
        robot: That was calibrated.
        calibration: What was learnt.
        overrides: Dotted settings that were in force; they come back with the file.
        said: What can be weighed with it, for the comment at its head.
        like: A calibration whose place it takes: all else stands as it does there.

    Raises:
        ConfigurationError: The file cannot be written.
    """
    learnt = calibration.as_settings()
    section = CommentedMap({key: _laid_out(key, value) for key, value in learnt.items()})
    section[DIGEST] = digest_of(learnt)
    settings = nested_settings(robot.model.independent_joints, overrides or {})
    if like is None:
        content = CommentedMap(settings)
        content.insert(0, "extends", _reference_to(robot.source, path))
    else:
        content = CommentedMap({**yaml_of(text_of(like, RobotError)), **settings})
        below = like.resolve().parent / str(content.get("extends", ""))
        if below.is_file():
            content["extends"] = _reference_to(below, path)
    content.update(calibration.beside)
    content["model_fingerprint"] = robot.model.fingerprint()
    content[calibration.section] = section
    now = datetime.now(timezone.utc).strftime("%Y-%m-%d %H:%M UTC")
    made_of = f"{len(calibration.runs)} {calibration.made_of}"
    content.yaml_set_start_comment(
        f"What one {robot.name} says about itself: {made_of}, {now}, proprio_ros {__version__}.\n"
        + (f"It {said}.\n" if said else "")
        + f"Use it with: proprio replay BAG --probe payload --calibration {path.name}\n"
    )
    stream = io.StringIO()
    writer = YAML()
    writer.width = 1000
    writer.dump(content, stream)
    write_in_one_step(path, stream.getvalue(), "--output")


def _with_learnt_delay(
    request: Request,
    recordings: Sequence[Recording],
    masses_kg: Sequence[float],
    progress: Callable[[str], None],
) -> Request:
    """The same with the delay from a goal to its torque that motions with known loads show, and the setting that says so.

    Only where a single joint follows its goal by a law, so that all of its torque hangs on that delay.
    """
    robot = request.robot
    if not _hangs_on_delay(robot) or len(recordings) < FEWEST_RUNS:
        return request
    if any(recording.torque_off_ns for recording in recordings):
        return request
    progress("looking for the delay from a goal to its torque")

    def left_over(delay_s: float) -> float:
        late = replace(robot, delay=Quantity(delay_s))
        asked = replace(request, robot=late)
        found = [runs_or_motion(with_stall_currents(each, late), asked) for each in recordings]
        motions = [motion for each in found for motion in each.motions]
        return torque_left_over(late, motions, masses_kg, request.facts)

    delay = best_delay(left_over, robot.delay)
    learnt = {"delay_s": {"value": delay.value, "std": delay.std}}
    return replace(
        request,
        robot=replace(robot, delay=delay),
        overrides={**request.overrides, **learnt},
    )


def _hangs_on_delay(robot: Robot) -> bool:
    """Whether the robot is a single joint whose torque follows from its goal after a delay that is not known."""
    drives = list(robot.drive_trains.values())
    driven_by = drives[0].driven_by
    alone = len(drives) == 1 and driven_by is not None and driven_by.follows_goal
    return alone and robot.delay.std != 0.0


def _laid_out(key: str, value: Any) -> Any:
    """A value of the section as it stands in the file: an entry of a table is one line, a matrix is text."""
    if key in ("runs", "joints"):
        return [_on_one_line(entry) for entry in value]
    if key == "unknowns":
        return CommentedMap({name: _on_one_line(entry) for name, entry in value.items()})
    if key in ("correlation", "deviations", "without", "own_terms"):
        return LiteralScalarString(value)
    return _on_one_line(value) if key in ("made", "torque_scale", "driven_by") else value


def _on_one_line(entry: Mapping[str, Any]) -> CommentedMap:
    line = CommentedMap(entry)
    line.fa.set_flow_style()
    return line


def _reference_to(source: Path, output: Path) -> str:
    """How the file names the robot it extends: by name where the package has it, else by the way from one to the other."""
    name = source.stem
    if name in resource_names("robots") and resource("robots", name).resolve() == source.resolve():
        return name
    if is_description(str(source)) and not source.is_file():
        return str(source)  # robot_descriptions:NAME
    return os.path.relpath(source.resolve(), output.resolve().parent)
