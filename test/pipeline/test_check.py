"""``proprio check``: what it says of a bag before any fit, against what an identification then makes of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.recording_bag import write_recording
from support.simulated import stated, truth_of

from proprio_ros.errors import ConfigurationError, ProprioError
from proprio_ros.identification.estimate import Verdict
from proprio_ros.pipeline.check import check_bags
from proprio_ros.pipeline.loading import bag_recording
from proprio_ros.pipeline.looked_into import BagCheck
from proprio_ros.pipeline.replay import replay
from proprio_ros.pipeline.request import Options, Request
from proprio_ros.records import InputRecord, JointRecord, Recording
from proprio_ros.robot import load_robot

BAGS = Path(__file__).resolve().parents[2] / "bags"
PUSHES = sorted(BAGS.glob("*_fixed_*_joint3*"))
ARM = load_robot("open_manipulator_x")
PUSH = BAGS / "quantised_s00_fixed_heavy_ball_50g_joint3"


def looked_into(path: Path, options: Options | None = None) -> BagCheck:
    robot, (check,) = check_bags(path, options)
    assert robot == "open_manipulator_x"
    return check


def pushed() -> Recording:
    return bag_recording(PUSH / "bag_mcap", Request(ARM))


def written(
    folder: Path,
    record: JointRecord,
    inputs: InputRecord | None,
) -> Path:
    # as joint states say it: what a bag's effort is
    effort = record.reported_effort
    write_recording(
        folder / "bag",
        replace(
            pushed(),
            joints=replace(record, effort=effort),
            inputs=inputs,
        ),
    )
    return folder / "bag"


def of_joint_states(
    record: JointRecord,
    rows: slice,
    columns: list[int],
) -> JointRecord:
    tables = {
        name: None if (values := getattr(record, name)) is None else values[rows][:, columns]
        for name in ("position", "velocity", "effort", "current", "reported_effort")
    }
    names = tuple(record.names[column] for column in columns)
    return JointRecord(record.times_ns[rows], names, **tables)


@pytest.mark.parametrize("folder", PUSHES, ids=lambda folder: folder.name)
def test_a_run_is_weighed_about_as_well_as_was_said_and_refused_for_the_same_reason(
    folder: Path,
) -> None:
    bag = next(folder.glob("bag_*"))
    check = looked_into(bag)
    (run,) = check.runs
    truth = truth_of(folder)
    assert not check.problem and run.joint == "joint3" and check.input == "/current_command"
    assert run.duration_s == pytest.approx(truth["duration"], abs=0.03)
    assert run.current_A == pytest.approx(truth["current"], abs=0.01)
    estimate = replay(bag, Options(settings=stated(truth)))
    if run.problem:
        assert estimate.verdict is Verdict.NOT_IDENTIFIABLE and run.mass_half_width_kg is None
        assert {reason.code for reason in estimate.reasons} == {run.problem.code}
        return
    # what the file leaves open decides: friction 20 mN m, torque 5 %, masses 2 %
    assert check.usable == 1 and run.mass_half_width_kg is not None
    value = estimate.values[0]
    if value.std is not None:
        assert 1.0 / 2.5 < run.mass_half_width_kg / (1.96 * value.std) < 2.5


def test_spacing_and_gaps_are_those_of_the_joint_states(tmp_path: Path) -> None:
    recording = pushed()
    rows = np.r_[0:20, 26 : len(recording.joints.times_ns)]
    record = of_joint_states(
        recording.joints,
        rows,
        list(range(len(recording.joints.names))),
    )  # type: ignore[arg-type]
    check = looked_into(written(tmp_path, record, recording.inputs))
    times_s = 1e-9 * record.times_ns
    assert check.gaps == 1 and check.longest_gap_s == pytest.approx(np.diff(times_s).max())
    assert check.rate_Hz == pytest.approx(1.0 / np.median(np.diff(times_s)))
    assert check.duration_s == pytest.approx(times_s[-1] - times_s[0])


@pytest.mark.parametrize("without", ["joint3", "joint4"])
def test_a_joint_that_is_missing_is_a_problem_in_the_words_of_replay(
    tmp_path: Path, without: str
) -> None:
    recording = pushed()
    columns = [column for column, name in enumerate(recording.joints.names) if name != without]
    bag = written(
        tmp_path,
        of_joint_states(
            recording.joints,
            slice(None),
            columns,
        ),
        recording.inputs,
    )
    check = looked_into(bag)
    with pytest.raises(ProprioError) as refused:
        replay(bag)
    said = check.problem or check.runs[0].problem
    assert without in said and without in str(refused.value)
    assert check.usable == 0


def test_a_push_too_short_for_a_run_is_said(tmp_path: Path) -> None:
    recording = pushed()
    inputs = recording.inputs
    assert inputs is not None
    onset = int(np.flatnonzero(inputs.current_A.any(axis=1))[0])
    current = inputs.current_A.copy()
    current[onset + 2 :] = 0.0
    check = looked_into(written(tmp_path, recording.joints, replace(inputs, current_A=current)))
    assert check.usable == 0 and "joint states" in check.problem


def test_what_nobody_recorded_is_asked_for(tmp_path: Path) -> None:
    recording = pushed()
    record = replace(
        recording.joints,
        effort=None,
        current=None,
        reported_effort=None,
    )
    check = looked_into(written(tmp_path, record, None))
    assert check.usable == 0 and check.input is None
    assert any("what the motors gave, too" in advice for advice in check.record)


def test_nothing_given_and_no_bag_are_refused_in_a_line(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="name at least one bag"):
        check_bags([])
    with pytest.raises(ProprioError) as refused:
        check_bags(tmp_path / "nothing")
    assert "\n" not in str(refused.value) and "nothing" in str(refused.value)
    with pytest.raises(ConfigurationError, match="colour"):
        check_bags(PUSH / "bag_mcap", Options(settings={"colour": "red"}))


@pytest.mark.parametrize(("seconds", "moves_s"), [(2.0, 2.0), (3.4, 3.4), (9.0, 3.0), (12.0, 12.0)])
def test_a_motion_is_usable_where_replay_takes_it(
    tmp_path: Path, seconds: float, moves_s: float
) -> None:
    """As check says it: what is too short for a fit, or stands still for most of the time, is refused in the words of replay."""
    joints = ("joint1", "joint2", "joint3", "joint4")  # the gripper was not recorded
    times_s = np.arange(0.0, seconds, 0.01)
    phase = 2.0 * np.minimum(times_s, moves_s)[:, None] + np.arange(4)
    record = JointRecord(
        (1e9 * (1.0 + times_s)).astype(np.int64),
        joints,
        0.4 * np.sin(phase),
        effort=0.3 * np.cos(phase),
    )
    write_recording(tmp_path / "bag", Recording("motion", record, None))
    times_s = np.arange(0.0, 15.0, 0.01)
    phase = 1.7 * times_s[:, None] + np.arange(4)
    empty = JointRecord(
        (1e9 * (1.0 + times_s)).astype(np.int64),
        joints,
        0.4 * np.sin(phase),
        effort=0.3 * np.cos(phase),
    )
    write_recording(tmp_path / "empty", Recording("empty", empty, None))
    options = Options(effort_unit="N.m", baseline=(tmp_path / "empty",))
    check = looked_into(tmp_path / "bag", options)
    try:
        replay(tmp_path / "bag", options)
        refusal = ""
    except ProprioError as error:
        refusal = str(error)
    assert check.problem.rpartition("/")[2] == refusal.rpartition("/")[2]
    assert check.usable == (refusal == "") == (moves_s > 9.0)
