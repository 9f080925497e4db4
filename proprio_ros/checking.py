"""What is in a bag and what could be identified from it, before any fit: ``proprio check``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from proprio_ros.bags import (
    EFFORT_UNITS,
    is_text_recording,
    look_into,
    read_text_recording,
)
from proprio_ros.errors import ConfigurationError, RecordingError
from proprio_ros.identification.estimate import plain
from proprio_ros.identification.gates import MIN_USED, Findings, screen_run, unusable
from proprio_ros.identification.problem import KnownLoad, PreparedRun, prepare_run
from proprio_ros.identification.reasons import Reason
from proprio_ros.motions import Motion
from proprio_ros.records import LOST_AFTER_PERIODS, InputRecord, Recording, Run
from proprio_ros.replay import (
    DEFAULT_ROBOT,
    TEXT_ROBOT,
    ReplayOptions,
    bag_recording,
    runs_or_motion,
    unit_not_used,
)
from proprio_ros.resources import paths_of
from proprio_ros.robot import Robot, load_robot
from proprio_ros.schema import header, reason_codes
from proprio_ros.threads import one_blas_thread


@dataclass(frozen=True)
class RunCheck:
    """One run as it was found.

    Attributes:
        duration_s: How long the joint was driven [s].
        travel: From the first to the last sample [rad or m, as ``unit`` says].
        current_A: The largest of its currents, with its sign [A].
        samples: Joint states while it was driven.
        problem: Why it is not usable, or an empty string.
        notes: What else a reader should know.
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

    def as_json(self) -> dict[str, Any]:
        return {
            "name": self.name,
            "joint": self.joint,
            "duration_s": self.duration_s,
            "travel": self.travel,
            "unit": self.unit,
            "current_A": self.current_A,
            "samples": self.samples,
            "usable": not self.problem,
            "problem": self.problem or None,
            "problem_code": reason_codes([self.problem])[0] if self.problem else None,
            "notes": list(self.notes),
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
            }
        )
        return dict(record)

    def as_text(self) -> str:
        """For the terminal."""
        found = len(self.runs) + (self.motion is not None)
        lines = [f"{self.bag}: {self.usable} of {found} run{'s' * (found != 1)} usable"]
        if self.joints:
            lost = f"{self.gaps} gaps, the longest {1e3 * self.longest_gap_s:.0f} ms" if self.gaps else "no gaps"
            states = f"{self.state_topic or 'in a text file'}, {', '.join(self.joints)}"
            lines.append(f"  joint states: {states}; {self.duration_s:.2f} s at {self.rate_Hz:.1f} Hz, {lost}")
        if self.input:
            lines.append(f"  input: {self.input}" + (f" ({self.input_unit})" if self.input_unit else ""))
        lines += [f"  topic: {name} ({kind}), {count} messages" for name, kind, count in self.topics]
        for run in self.runs:
            moved = f"{1e3 * run.current_A:+.0f} mA for {run.duration_s:.2f} s, travel {run.travel:+.3f} {run.unit}"
            judged = f"not usable, {run.problem}" if run.problem else "usable"
            lines.append(f"  run of {run.joint}: {moved}, {run.samples} samples: {judged}")
            lines += [f"    note: {note}" for note in run.notes]
        if self.motion is not None:
            lines.append(
                f"  a motion of {len(self.motion.moved)} joints at once, {self.motion.times_s[-1]:.1f} s: tells the payload's mass "
                "and centre beside one with an empty hand (`replay --probe payload --baseline EMPTY`, or `calibrate EMPTY`)"
            )
        lines += [f"  problem: {self.problem}"] * bool(self.problem)
        return "\n".join([*lines, *(f"  note: {note}" for note in self.notes)])


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
) -> tuple[str, list[BagCheck]]:
    """Look into bags without fitting anything.

    Args:
        paths: Bags or text recordings.
        robot: Name or file; default as for ``proprio replay``.
        state_topic: As for ``proprio replay``.
        command_topic: As for ``proprio replay``.
        effort_unit: As for ``proprio replay``; what is left open here is said in the answer.

    Returns:
        The robot's name, and one entry per bag.

    Raises:
        ConfigurationError, RobotError, RecordingError: No path is given, the robot cannot be read, or a path is no bag.
    """
    given = [Path(path) for path in paths_of(paths)]
    if not given:
        raise ConfigurationError("no recording given: name at least one bag")
    only_text = all(is_text_recording(path) for path in given)
    described = load_robot(str(robot) if robot is not None else TEXT_ROBOT if only_text else DEFAULT_ROBOT)
    topics = (state_topic, command_topic, effort_unit)
    return described.name, [
        _text_check(described, path) if is_text_recording(path) else _bag_check(described, path, *topics)
        for path in given
    ]


def _bag_check(
    robot: Robot, path: Path, state_topic: str | None, command_topic: str | None, effort_unit: str | None
) -> BagCheck:
    contents = look_into(path, state_topic, command_topic)
    if contents.problem:
        return BagCheck(str(path), topics=contents.topics, state_topic=contents.states, problem=contents.problem)

    def read(unit: str | None) -> Recording:
        options = ReplayOptions(state_topic=state_topic, command_topic=command_topic, effort_unit=unit)
        return bag_recording(path, robot, options)

    problem = ""
    try:
        recording = read(effort_unit)
    except RecordingError as error:
        problem = str(error)
        if contents.inputs is not None or effort_unit is not None:
            return BagCheck(str(path), topics=contents.topics, state_topic=contents.states, problem=problem)
        try:
            recording = read("raw")  # only for the positions: no run is cut from a current of an unstated unit
        except RecordingError as worse:
            return BagCheck(str(path), topics=contents.topics, state_topic=contents.states, problem=str(worse))
    runs: tuple[RunCheck, ...] = ()
    motion: Motion | None = None
    if not problem:
        try:
            found = runs_or_motion(recording, robot, {})
            if isinstance(found, Motion):
                motion = found
            else:
                runs = tuple(_run_check(robot, run) for run in found)
        except RecordingError as error:
            problem = str(error)
    times_s = 1e-9 * (recording.joints.times_ns - recording.joints.times_ns[0])
    intervals = np.diff(times_s)
    period = float(np.median(intervals))
    return BagCheck(
        str(path),
        recording.joints.names,
        float(times_s[-1]),
        1.0 / period,
        int(np.sum(intervals > LOST_AFTER_PERIODS * period)),
        float(intervals.max()),
        contents.topics,
        contents.states,
        None if recording.inputs is None else recording.inputs.source,
        _unit_of(recording.inputs, {name: kind for name, kind, _ in contents.topics}, effort_unit),
        runs,
        problem,
        recording.notes + (() if motion is not None else unit_not_used(recording.inputs, effort_unit)),
        motion,
    )


def _unit_of(inputs: InputRecord | None, types: dict[str, str], effort_unit: str | None) -> str | None:
    if inputs is None:
        return None
    if inputs.measured:
        return effort_unit or f"not stated: --effort-unit {'|'.join(EFFORT_UNITS)}"
    return "N m or N, current x nominal torque constant" if "JointState" in types[inputs.source] else "A"


def _run_check(robot: Robot, run: Run) -> RunCheck:
    joint = robot.model.joint(run.joint)
    travel = float(run.position[-1] - run.position[0])
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
    return RunCheck(run.name, run.joint, run.duration_s, travel, unit, largest, len(run.times_s), problem, notes)


def _unusable_closing(run: PreparedRun) -> str:
    """Why a closing of the gripper is of no use: fingers on a stiff block need not get far."""
    from proprio_ros.probes.softness.identify import UNMOVED_RAD  # brings finite elements along

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
