"""What is in a bag and what could be identified from it, before any fit: ``proprio check``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from proprio_ros.errors import ConfigurationError, RecordingError, RobotError
from proprio_ros.experiment_design.predicted_mass import mass_from_motion, mass_from_run
from proprio_ros.identification.estimate import plain
from proprio_ros.identification.gates import MIN_USED, UNMOVED_RAD, Findings, screen_run, unusable
from proprio_ros.identification.prepared_runs import KnownLoad, PreparedRun, prepare_run
from proprio_ros.identification.reasons import Reason
from proprio_ros.inputs.resources import paths_of
from proprio_ros.inputs.settings import Settings
from proprio_ros.pipeline.replay import (
    DEFAULT_ROBOT,
    TEXT_ROBOT,
    ReplayOptions,
    bag_recording,
    configured_robot,
    held_positions,
    runs_or_motion,
    turning_joints,
    unit_not_used,
)
from proprio_ros.probes import all_probes
from proprio_ros.quantity import shown
from proprio_ros.recordings.contents import look_into
from proprio_ros.recordings.drivers import Driver, drivers_of
from proprio_ros.recordings.effort import CURRENT_PER_COUNT_A, EFFORT_UNITS
from proprio_ros.recordings.motions import SLOWEST_HZ, Motion, motion_of
from proprio_ros.recordings.plausibility import EffortUnit, Finding, effort_per_torque, effort_units, findings, moving
from proprio_ros.recordings.signals import read_recording
from proprio_ros.recordings.text import is_text_recording, read_text_recording
from proprio_ros.recordings.topics import JOINT_STATE
from proprio_ros.recordings.voltage import voltage_driven
from proprio_ros.records import LOST_AFTER_PERIODS, MEASURED_EFFORT, STALL_CURRENT, InputRecord, Recording, Run
from proprio_ros.robot import Robot, is_description
from proprio_ros.schema import header, reason_codes
from proprio_ros.threads import one_blas_thread

UNUSABLE_EFFORT = ("unsigned_register", "effort_stale", "constant_effort")
"""Findings after which no torque can be made of a measured effort."""
DOUBTFUL_EFFORT = (*UNUSABLE_EFFORT, "effort_without_sign")
"""Findings after which an effort is not compared with gravity: a joint that only ever lifts has one sign, too."""
FREE_SWING = (
    "it tells gravity moment over inertia, without any torque constant: a mass with a calibration from swings with two known loads "
    "(calibrate --reference BAG=KG --reference BAG=KG)"
)
"""What a free swing is good for."""


@dataclass(frozen=True)
class RunCheck:
    """One run as it was found.

    Attributes:
        duration_s: How long the joint was driven [s].
        travel: From the first to the last sample [rad or m, as ``unit`` says]; of a free swing its whole span.
        current_A: The largest of its currents, with its sign [A]; 0 in a free swing.
        samples: Joint states while it was driven.
        problem: Why it is not usable, or an empty string.
        notes: What else a reader should know.
        mass_half_width_kg: About half the 95 % interval of a light object's mass from this run alone; None where it lifts nothing.
        free: Whether it is a free swing: torque was off.
    """

    name: str
    joint: str
    duration_s: float
    travel: float
    unit: str
    current_A: float
    samples: int
    problem: str = ""
    notes: tuple[str, ...] = ()
    mass_half_width_kg: float | None = None
    free: bool = False

    def as_json(self) -> dict[str, Any]:
        return {
            "name": self.name,
            "joint": self.joint,
            "duration_s": self.duration_s,
            "travel": self.travel,
            "unit": self.unit,
            "current_A": self.current_A,
            "samples": self.samples,
            "free_swing": self.free,
            "usable": not self.problem,
            "problem": self.problem or None,
            "problem_code": reason_codes([self.problem])[0] if self.problem else None,
            "notes": list(self.notes),
            "mass_half_width_kg": self.mass_half_width_kg,
        }


@dataclass(frozen=True)
class MotionCheck:
    """What a motion of several joints determines, were it made once more with an empty hand.

    Attributes:
        joints: That moved.
        mass_half_width_kg: About half the 95 % interval of a light object's mass.
        mass_half_width_per_kg: What every kg of the object adds to it, since torque constants are not known better; None where
            nobody stated them.
    """

    joints: tuple[str, ...]
    duration_s: float
    mass_half_width_kg: float
    mass_half_width_per_kg: float | None

    def sentence(self) -> str:
        """For the terminal."""
        if self.mass_half_width_per_kg is None:
            more = "as much of the mass as the torque constants are uncertain"
        else:
            more = f"{100.0 * self.mass_half_width_per_kg:.0f} % of the mass, which is how well the torque constants are known"
        return (
            "beside the same motion with an empty hand it tells a light object's mass to about "
            f"+-{_grams(self.mass_half_width_kg)} (95 %), and {more}"
        )

    def as_json(self) -> dict[str, Any]:
        return {
            "joints": self.joints,
            "duration_s": self.duration_s,
            "mass_half_width_kg": self.mass_half_width_kg,
            "mass_half_width_per_kg": self.mass_half_width_per_kg,
        }


@dataclass(frozen=True)
class BagCheck:
    """One bag as it was found.

    Attributes:
        joints: Joints whose positions were recorded.
        duration_s: From the first to the last joint state [s].
        rate_Hz: Of the joint states, by their median interval [1/s]; NaN where none could be read.
        gaps: Intervals of more than 2.5 periods; longest_gap_s: the longest interval [s].
        topics: Name, type and number of messages of each.
        state_topic: Topic of the joint states.
        input: Where the current that drove the joints would be taken from: a topic, or ``measured effort``.
        input_unit: What its numbers are.
        problem: Why no run could be looked for, or an empty string.
        notes: Every repair made while reading.
        motion: What was recorded where several joints were driven at once; then there are no runs.
        moves, still: The joints that move, and those that do not.
        findings: What the recording shows of itself.
        effort_units: How the effort would compare with what gravity needs if it were in one unit or another.
        effort_per_N_m: The effort over what gravity needs, by joint, in the publisher's unit.
        tells: What a motion determines.
        record: What to record instead, or beside it.
        driver: Profile by which it was read; None where nobody stated one.
        fitting: Names of the profiles that its topics identify; none of them is used before it is stated.
    """

    bag: str
    joints: tuple[str, ...] = ()
    duration_s: float = 0.0
    rate_Hz: float = float("nan")
    gaps: int = 0
    longest_gap_s: float = float("nan")
    topics: tuple[tuple[str, str, int], ...] = ()
    state_topic: str | None = None
    input: str | None = None
    input_unit: str | None = None
    runs: tuple[RunCheck, ...] = ()
    problem: str = ""
    notes: tuple[str, ...] = ()
    motion: Motion | None = None
    moves: tuple[str, ...] = ()
    still: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()
    effort_units: tuple[EffortUnit, ...] = ()
    effort_per_N_m: Mapping[str, float] = field(default_factory=dict)
    tells: MotionCheck | None = None
    record: tuple[str, ...] = ()
    driver: Driver | None = None
    fitting: tuple[str, ...] = ()

    @property
    def usable(self) -> int:
        """Number of runs that a fit could use; a motion counts as one."""
        return sum(not run.problem for run in self.runs) + (self.motion is not None)

    def as_json(self) -> dict[str, Any]:
        record = plain(
            {
                "bag": self.bag,
                "joints": self.joints,
                "duration_s": self.duration_s,
                "rate_Hz": self.rate_Hz,
                "gaps": self.gaps,
                "longest_gap_s": self.longest_gap_s,
                "topics": [{"name": name, "type": kind, "messages": count} for name, kind, count in self.topics],
                "state_topic": self.state_topic,
                "input": self.input,
                "input_unit": self.input_unit,
                "runs": [run.as_json() for run in self.runs],
                "motion": None
                if self.motion is None
                else {"joints": self.motion.moved, "duration_s": float(self.motion.times_s[-1])},
                "usable_runs": self.usable,
                "problem": self.problem or None,
                "notes": self.notes,
                "moves": self.moves,
                "still": self.still,
                "findings": [finding.as_json() for finding in self.findings],
                "effort_units": [unit.as_json() for unit in self.effort_units],
                "effort_per_N_m": dict(self.effort_per_N_m),
                "tells": None if self.tells is None else self.tells.as_json(),
                "record": self.record,
                "driver": None if self.driver is None else self.driver.name,
                "fitting_drivers": self.fitting,
            }
        )
        return dict(record)

    def as_text(self) -> str:
        """For the terminal."""
        found = len(self.runs) + (self.motion is not None)
        lines = [f"{self.bag}: {self.usable} of {found} run{'s' * (found != 1)} usable"]
        if self.joints:
            lost = (
                f"{self.gaps} gap{'s' * (self.gaps != 1)}, the longest {1e3 * self.longest_gap_s:.0f} ms"
                if self.gaps
                else "no gaps"
            )
            states = f"{self.state_topic or 'in a text file'}, {', '.join(self.joints)}"
            lines.append(f"  joint states: {states}; {self.duration_s:.2f} s at {self.rate_Hz:.1f} Hz, {lost}")
        if self.input:
            lines.append(f"  input: {self.input}" + (f" ({self.input_unit})" if self.input_unit else ""))
        lines += [f"  topic: {name} ({kind}), {count} messages" for name, kind, count in self.topics]
        lines += self._driver_lines()
        for run in self.runs:
            moved = f"{1e3 * run.current_A:+.0f} mA for {run.duration_s:.2f} s, travel {run.travel:+.3f} {run.unit}"
            judged = f"not usable, {run.problem}" if run.problem else "usable"
            if not run.problem and run.mass_half_width_kg is not None:
                judged += f"; alone it tells a light object's mass to about +-{_grams(run.mass_half_width_kg)}"
            if run.free:
                lines.append(
                    f"  a free swing of {run.joint}: torque off, {run.duration_s:.2f} s until it hangs still, "
                    f"over {run.travel:.2f} {run.unit}, {run.samples} samples: {judged}"
                )
                if not run.problem:
                    lines.append(f"    {FREE_SWING}")
            else:
                lines.append(f"  run of {run.joint}: {moved}, {run.samples} samples: {judged}")
            lines += [f"    note: {note}" for note in run.notes]
        if self.motion is not None and self.input is not None and self.input.startswith(STALL_CURRENT):
            lines.append(f"  a motion under a controller, {self.motion.times_s[-1]:.1f} s, driven by a voltage")
        elif self.motion is not None and len(self.motion.joints) == 1:
            lines.append(
                f"  a motion of one joint under a controller, {self.motion.times_s[-1]:.1f} s: tells how it swings (`replay "
                "--probe payload`), and the mass where the torque is known and one with an empty hand is beside it "
                "(`--baseline EMPTY`)"
            )
        elif self.motion is not None:
            lines.append(
                f"  a motion of {len(self.motion.moved)} joints at once, {self.motion.times_s[-1]:.1f} s: tells the payload's mass "
                "and centre beside one with an empty hand (`replay --probe payload --baseline EMPTY`, or `calibrate EMPTY`)"
            )
        if self.tells is not None:
            lines.append(f"  {self.tells.sentence()}")
        if self.moves or self.still:
            still = f"; still: {', '.join(self.still)}" if self.still else ""
            lines.append(f"  moves: {', '.join(self.moves) or 'nothing'}{still}")
        lines += [f"  seen: {finding.sentence}" for finding in self.findings]
        lines += self._effort_lines()
        lines += [f"  problem: {self.problem}"] * bool(self.problem)
        lines += [f"  record: {advice}" for advice in self.record]
        return "\n".join([*lines, *(f"  note: {note}" for note in self.notes)])

    def _driver_lines(self) -> list[str]:
        stated = self.driver
        lines = []
        if stated is not None:
            lines = [f"  driver: {stated.name}, {stated.title}", *(f"    {note}" for note in stated.notes)]
        if not self.fitting or (stated is not None and {stated.name, *stated.extends} & set(self.fitting)):
            return lines
        words = f"its topics are those of {' or '.join(self.fitting)}"
        if stated is not None:
            return [*lines, f"  problem: {words}, not of {stated.name}"]
        which = "one" if len(self.fitting) > 1 else "it"
        return [*lines, f"  driver: {words}; state {which} with --driver, none is used before"]

    def _effort_lines(self) -> list[str]:
        if not self.effort_per_N_m:
            return []
        joints = ", ".join(self.effort_per_N_m)
        parts = []
        for unit in self.effort_units:
            ends = [_short(edge) for edge in (min(unit.ratio.values()), max(unit.ratio.values()))]
            parts.append(
                f"{' to '.join(dict.fromkeys(ends))} in {unit.unit}" + (" (plausible)" if unit.plausible else "")
            )
        lines = [
            f"  effort over the torque that gravity needs by the URDF, of {joints}: {'; '.join(parts)}; an empty hand gives 1, a "
            "load more; nothing is chosen by it"
        ]
        if len(self.effort_units) == 1:
            constants = ", ".join(_short(1.0 / abs(value)) for value in self.effort_per_N_m.values())
            lines.append(
                f"  were it a current and the hand empty, the torque constants would be {constants} N m per unit of it"
            )
        if all(value < 0.0 for value in self.effort_per_N_m.values()):
            lines.append("  the effort has the sign of the torque that gravity makes, not of what holds against it")
        return lines


def _short(value: float) -> str:
    """Two digits, without an exponent where people would write none."""
    return f"{float(f'{value:.2g}'):g}"


def _grams(mass_kg: float) -> str:
    return shown("kg", float(f"{mass_kg:.2g}"), spec="g")


def as_json(robot: str, checks: Sequence[BagCheck]) -> dict[str, Any]:
    """What ``proprio check --json`` prints."""
    return {
        **header("check"),
        "robot": robot,
        "usable_runs": sum(check.usable for check in checks),
        "bags": [check.as_json() for check in checks],
    }


@one_blas_thread
def check_bags(
    paths: str | Path | Sequence[str | Path],
    robot: str | Path | None = None,
    *,
    state_topic: str | None = None,
    command_topic: str | None = None,
    effort_unit: str | None = None,
    settings: Mapping[str, Any] | None = None,
    driver: str | Path | None = None,
) -> tuple[str, list[BagCheck]]:
    """Look into bags without fitting anything.

    Args:
        paths: Bags or text recordings.
        robot: Name or file; default as for ``proprio replay``.
        state_topic: As for ``proprio replay``.
        command_topic: As for ``proprio replay``.
        effort_unit: As for ``proprio replay``; what is left open here is said in the answer.
        settings: As for ``proprio replay``: ``robot.``, ``held.JOINT`` and ``payload.frame`` count, and what is stated about an
            object is not looked at.
        driver: As for ``proprio replay``.

    Returns:
        The robot's name, and one entry per bag.

    Raises:
        ConfigurationError, RobotError, RecordingError: No path is given, the robot cannot be read, a path is no bag, or a setting
            is unknown.
    """
    given = [Path(path) for path in paths_of(paths)]
    if not given:
        raise ConfigurationError("no recording given: name at least one bag")
    only_text = all(is_text_recording(path) for path in given)
    name = str(robot) if robot is not None else TEXT_ROBOT if only_text else DEFAULT_ROBOT
    stated = Settings(settings or {})
    # a URDF alone is enough to look, as where torque was recorded: what needs torque constants is then not said
    described = configured_robot(name, None, stated, "N.m")
    held = held_positions(described, stated)
    for start in ("solver.", *(start for probe in all_probes() for start in probe.keys)):
        stated.take_prefix(start)
    stated.refuse_rest()
    options = ReplayOptions(
        state_topic=state_topic, command_topic=command_topic, effort_unit=effort_unit, driver=driver
    )
    profile = options.publisher
    return described.name, [
        _text_check(described, path)
        if is_text_recording(path)
        else _of_driver(_bag_check(described, path, held, options), profile)
        for path in given
    ]


def _of_driver(check: BagCheck, profile: Driver | None) -> BagCheck:
    """The same with the profile that was stated, and those that would fit."""
    fitting = drivers_of((name, kind) for name, kind, _ in check.topics)
    return replace(check, driver=profile, fitting=tuple(driver.name for driver in fitting))


def _bag_check(robot: Robot, path: Path, held: Mapping[str, float], options: ReplayOptions) -> BagCheck:
    effort_unit, conventions = options.stated_unit, options.conventions
    contents = look_into(path, options.state_topic, options.command_topic, conventions)
    if contents.problem:
        return BagCheck(str(path), topics=contents.topics, state_topic=contents.states, problem=contents.problem)
    problem = ""
    try:
        recording = bag_recording(path, robot, options)
    except RecordingError as error:
        problem = str(error)
        try:  # only to look at: no run is cut from a current of an unstated unit
            recording = read_recording(
                path,
                state_topic=options.state_topic,
                nominal_torque_constants={},
                joint_order=list(robot.drive_trains),
                states_only=True,
                conventions=conventions,
            )
        except RecordingError as worse:
            return BagCheck(str(path), topics=contents.topics, state_topic=contents.states, problem=str(worse))
    runs: tuple[RunCheck, ...] = ()
    motion: Motion | None = None
    if not problem:
        try:
            found = runs_or_motion(recording, robot, held)
            if isinstance(found, Motion):
                motion = found
            else:
                runs = tuple(_run_check(robot, run) for run in found)
        except RecordingError as error:
            problem = str(error)
    slides = [joint.name for joint in robot.model.joints if joint.kind == "prismatic"]
    moved = moving(recording.joints, slides)
    seen = (*findings(recording, slides), *_of_robot(robot, recording, effort_unit))
    by_voltage = voltage_driven(robot)
    # what the law of a position servo makes of goal and position needs no effort
    drives = {name: drive.driven_by for name, drive in robot.drive_trains.items()}
    without = {name for name, drive in drives.items() if drive is not None and drive.follows_goal}
    seen = tuple(each for each in seen if each.code not in DOUBTFUL_EFFORT or not without.issuperset(each.joints))
    if recording.inputs is None or recording.inputs.measured or recording.inputs.computed:
        runs = tuple(_with_effort(run, seen) for run in runs)
        for finding in seen:
            if motion is not None and finding.code in UNUSABLE_EFFORT and set(finding.joints) & set(motion.moved):
                motion, problem = None, f"of no use as a motion: {finding.sentence}"
    per_torque, units = ({}, ()) if by_voltage else _effort(recording, robot, seen)
    # a joint alone whose torque's scale is open is weighed with known loads, not with an empty hand
    tells = None if by_voltage and len(robot.drive_trains) == 1 else _motion_check(robot, recording, motion)
    times_s = 1e-9 * (recording.joints.times_ns - recording.joints.times_ns[0])
    intervals = np.diff(times_s)
    period = float(np.median(intervals))
    driven_by, driven_in = _input_of(recording, runs, {name: kind for name, kind, _ in contents.topics}, effort_unit)
    return BagCheck(
        str(path),
        recording.joints.names,
        float(times_s[-1]),
        1.0 / period,
        int(np.sum(intervals > LOST_AFTER_PERIODS * period)),
        float(intervals.max()),
        contents.topics,
        contents.states,
        driven_by or None,
        driven_in or None,
        runs,
        problem,
        recording.notes + (() if motion is not None else unit_not_used(recording.inputs, options.effort_unit)),
        motion,
        moved,
        tuple(name for name in recording.joints.names if name not in moved),
        seen,
        units,
        per_torque,
        tells,
        _advice(robot, recording, moved, seen, runs, tells, 1.0 / period),
    )


def _of_robot(robot: Robot, recording: Recording, effort_unit: str | None) -> tuple[Finding, ...]:
    """What the robot that was named leaves open."""
    if not set(recording.joints.names) & set(robot.model.independent_joints):
        return (
            Finding(
                "other_robot",
                f"none of these joints is one of {robot.name}: name the robot with --robot NAME, FILE or URDF",
                recording.joints.names,
            ),
        )
    if is_description(str(robot.source)) and effort_unit != "N.m":
        return (
            Finding(
                "no_torque_constants",
                f"{robot.source.name} states no torque constants: write a file with `proprio robot new` and state them there, or "
                "--effort-unit N.m where effort is torque",
            ),
        )
    driven_by = {name: drive.driven_by for name, drive in robot.drive_trains.items() if drive.driven_by is not None}
    return tuple(
        Finding(
            "voltage_driven",
            f"a voltage drives {name} ({kind.kind} in {robot.source.name}): its torque is made from {kind.takes}, and its scale is "
            "open: a joint alone is weighed with motions of known loads (`calibrate --reference BAG=KG ..`, three or more)",
            (name,),
        )
        for name, kind in driven_by.items()
        if name in recording.joints.names
    )


def _with_effort(run: RunCheck, seen: Sequence[Finding]) -> RunCheck:
    """A run driven by a measured effort, of which no torque can be made, is of no use."""
    for finding in seen:
        if finding.code in UNUSABLE_EFFORT and run.joint in finding.joints and not run.problem and not run.free:
            return replace(run, problem=finding.sentence, mass_half_width_kg=None)
    return run


def _effort(
    recording: Recording, robot: Robot, seen: Sequence[Finding]
) -> tuple[dict[str, float], tuple[EffortUnit, ...]]:
    """Effort over what gravity needs, by joint, and how plausible units are by it."""
    try:
        per_torque = effort_per_torque(recording, robot)
    except RobotError:  # a body without mass, as of a robot whose file leaves that joint out
        per_torque = {}
    for finding in seen:
        if finding.code in DOUBTFUL_EFFORT:
            per_torque = {name: value for name, value in per_torque.items() if name not in finding.joints}
    if not per_torque:
        return {}, ()
    stated = {} if is_description(str(robot.source)) else robot.drive_trains
    constants = {name: drive.torque_constant.value for name, drive in stated.items()}
    return per_torque, effort_units(per_torque, constants, CURRENT_PER_COUNT_A)


def _motion_check(robot: Robot, recording: Recording, motion: Motion | None) -> MotionCheck | None:
    """What a motion determines; also of one whose currents are not known, since none is looked at."""
    turning = turning_joints(robot)
    if motion is None:
        if recording.inputs is not None or set(turning) - set(recording.joints.names):
            return None
        nothing = InputRecord(recording.joints.times_ns[:1], tuple(turning), np.zeros((1, len(turning))), "nothing")
        try:
            motion = motion_of(replace(recording, inputs=nothing), joints=turning)
        except RecordingError:
            return None
        if len(motion.moved) < 2:
            return None
    # a joint that was not recorded stands somewhere, which matters little
    held = {**dict.fromkeys(robot.model.independent_joints, 0.0), **motion.held}
    try:
        width_kg, per_kg = mass_from_motion(robot, replace(motion, held=held))
    except (RecordingError, RobotError):
        return None
    stated = not is_description(str(robot.source))
    return MotionCheck(motion.moved, float(motion.times_s[-1]), width_kg, per_kg if stated else None)


def _advice(
    robot: Robot,
    recording: Recording,
    moved: Sequence[str],
    seen: Sequence[Finding],
    runs: Sequence[RunCheck],
    tells: MotionCheck | None,
    rate_Hz: float,
) -> tuple[str, ...]:
    """What to record instead, or beside it."""
    advice = []
    record = recording.joints
    free = any(run.free for run in runs)
    if recording.inputs is None and record.reported_effort is None and not free:
        advice.append(
            "what the motors gave, too: their torque or current as effort in /joint_states, or commands in /applied_effort or "
            "/current_command"
        )
    if not free and any(finding.code in DOUBTFUL_EFFORT for finding in seen):
        advice.append("effort as it was measured, with its sign, read anew for each joint state")
    if rate_Hz < SLOWEST_HZ:
        advice.append(f"at 50 Hz or more: {rate_Hz:.0f} Hz is too slow for a motion")
    if not moved:
        advice.append("a motion: nothing moves here")
    elif tells is not None:
        short = tells.duration_s < 15.0
        advice.append(
            "the same motion with the object and with an empty hand, on the same day: the latter is the `--baseline`"
            + (" and both for 15 s or longer" if short else "")
        )
    elif any(not run.problem for run in runs) and not free and not robot.is_calibrated():
        advice.append("runs with an empty hand, for `proprio calibrate`: it narrows what a run tells severalfold")
    return tuple(advice)


def _input_of(
    recording: Recording, runs: Sequence[RunCheck], types: dict[str, str], unit: str | None
) -> tuple[str, str]:
    """Where the current would come from, and what its numbers are; empty where there is none."""
    inputs = recording.inputs
    if any(run.free for run in runs):
        return "none, torque is off", ""
    if inputs is None and recording.joints.reported_effort is None:
        return "", ""
    if inputs is not None and inputs.computed:
        return inputs.source, "A"
    if inputs is None or inputs.measured:
        return MEASURED_EFFORT, unit or f"not stated: --effort-unit {'|'.join(EFFORT_UNITS)}"
    if inputs.unit != "N.m":
        return inputs.source, inputs.unit
    published = types[inputs.source] == JOINT_STATE
    return inputs.source, "N m or N, current x nominal torque constant" if published else "N m or N"


def _run_check(robot: Robot, run: Run) -> RunCheck:
    joint = robot.model.joint(run.joint)
    travel = float(np.ptp(run.position)) if run.free else float(run.position[-1] - run.position[0])
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
    unit = "m" if slides else "rad"
    notes = (*run.notes, *(reason.removeprefix(f"{run.name}: ") for reason in found.reasons))
    try:
        width_kg = None if problem or slides or run.free else mass_from_run(robot, run)
    except RobotError:
        width_kg = None
    return RunCheck(
        run.name, run.joint, run.duration_s, travel, unit, largest, len(run.times_s), problem, notes, width_kg, run.free
    )


def _unusable_closing(run: PreparedRun) -> str:
    """Why a closing of the gripper is of no use: fingers on a stiff block need not get far."""
    if run.used >= MIN_USED and abs(run.travel) < UNMOVED_RAD:
        moved = 1e3 * abs(run.travel * run.drive.transmission)
        return Reason("stuck", f"the fingers moved only {moved:.2f} mm, so friction decides where they are")
    return unusable(run) if run.used < MIN_USED else ""


def _text_check(robot: Robot, path: Path) -> BagCheck:
    """A text recording is one run, driven by the torque that its setting states."""
    text = read_text_recording(path)
    intervals = np.diff(text.times_s)
    drive = robot.drive_trains.get(text.joint)
    known = "" if drive is not None else f"{robot.name} has no drive train for {text.joint}"
    nominal = float("nan") if drive is None else drive.nominal_effort_per_current
    run = RunCheck(
        text.name,
        text.joint,
        float(text.times_s[-1]),
        float(text.relative_position[-1]),
        "rad",
        float(text.setting["torque_N_m"]) / nominal,
        len(text.times_s),
        known,
    )
    return BagCheck(
        str(path),
        (text.joint,),
        float(text.times_s[-1]),
        1.0 / float(np.median(intervals)),
        int(np.sum(intervals > LOST_AFTER_PERIODS * np.median(intervals))),
        float(intervals.max()),
        input="the torque in setting.json",
        input_unit="N m",
        runs=(run,),
    )
