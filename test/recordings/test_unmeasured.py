"""Efforts that nobody measured are left out for the joint and the time they concern; those that were measured stay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.arm_in_motion import SIX, Twin, write_robot

from proprio_ros.errors import RecordingError, TooLittleMotion
from proprio_ros.identification.estimate import Estimate, Verdict
from proprio_ros.pipeline.loading import runs_or_motion
from proprio_ros.pipeline.request import Options, Request
from proprio_ros.probes.payload.moving import identify_in_motion
from proprio_ros.recordings.motions import Motion, motion_of
from proprio_ros.recordings.unmeasured import measured_only
from proprio_ros.records import FloatArray, InputRecord, JointRecord, Recording
from proprio_ros.robot import Robot, load_robot
from proprio_ros.sim.payload import PayloadFacts

LOAD_KG = 1.5
NOTHING = (0.0, -0.0, np.nan, 5e-324, 1e-310)
TIMES_S = np.arange(0.0, 20.0, 0.01)
JOINTS = ("a", "b")


def waves() -> tuple[FloatArray, FloatArray]:
    """Positions [rad] and efforts of two joints, shape (T, 2) each."""
    rng = np.random.default_rng(3)
    position = np.column_stack([np.sin(0.7 * TIMES_S), 0.6 * np.cos(1.1 * TIMES_S)])
    noise = 0.05 * rng.standard_normal(position.shape)
    return position, np.array([6.0, 2.0]) * np.cos(position) + noise


@pytest.mark.parametrize("value", [*NOTHING, None])
@pytest.mark.parametrize(("first", "end"), [(1200, 2000), (0, 400), (700, 900)])
@pytest.mark.parametrize("columns", [[0, 1], [1]])
def test_what_stands_still_is_left_out(
    value: float | None,
    first: int,
    end: int,
    columns: list[int],
) -> None:
    position, effort = waves()
    effort[first:end, columns] = effort[first, columns] if value is None else value
    found = measured_only(JOINTS, TIMES_S, position, effort)
    stood = np.zeros(effort.shape, dtype=bool)
    stood[first:end, columns] = True
    assert np.array_equal(np.isnan(found.current_A), stood)
    np.testing.assert_array_equal(
        found.current_A[~stood],
        effort[~stood],
    )
    when = f"from {TIMES_S[first]:.1f} " + ("s on" if end == 2000 else f"to {TIMES_S[end - 1]:.1f}")
    which = "all joints" if len(columns) == 2 else "b"
    assert len(found.notes) == 1
    assert f"effort of {which} stands still or is missing {when}" in found.notes[0]


@pytest.mark.parametrize(
    ("value", "every"),
    [
        *((value, every) for value in (0.0, -0.0, 1e-310) for every in (7, 50)),
        *((value, every) for value in (np.nan, 1e300, -1e300, 80.0, np.inf) for every in (7, 500)),
    ],
)
def test_single_samples_are_left_out(value: float, every: int) -> None:
    position, effort = waves()
    effort[::every, 0] = value
    found = measured_only(JOINTS, TIMES_S, position, effort)
    assert np.isnan(found.current_A[::every, 0]).mean() > 0.95
    assert np.isfinite(np.delete(found.current_A[:, 0], np.s_[::every])).all()
    assert np.isfinite(found.current_A[:, 1]).all()


@pytest.mark.parametrize(
    "coarse",
    [
        lambda effort: np.round(effort),  # in steps that are a sixth of what the first joint needs
        lambda effort: effort[np.arange(len(effort)) // 10 * 10],  # read ten times a second
        lambda effort: np.round(effort[np.arange(len(effort)) // 50 * 50], 1),  # and twice
        lambda effort: effort,
        lambda effort: np.where(np.abs(effort) < 0.1, 0.0, effort),  # a dead band
    ],
)
def test_coarse_efforts_were_measured(coarse: object) -> None:
    position, effort = waves()
    effort -= 4.0 * np.array([1.0, 0.3])
    found = measured_only(JOINTS, TIMES_S, position, coarse(effort))  # type: ignore[operator]
    assert np.isfinite(found.current_A).all() and not found.notes


def test_a_joint_that_stands_may_need_the_same_effort_all_the_time() -> None:
    position, effort = waves()
    position[:, 1] = 0.3
    effort[:, 1] = 2.0
    assert np.isfinite(measured_only(JOINTS, TIMES_S, position, effort).current_A).all()


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return load_robot(write_robot(tmp_path_factory.mktemp("arm")))


@pytest.fixture(scope="module")
def motions() -> tuple[Motion, Motion]:
    """Of an arm in MuJoCo with 1.5 kg, and with nothing."""
    twin = Twin(5, SIX)
    payload = (LOAD_KG, np.array([0.03, 0.0, 0.05]))
    return twin.record(
        "loaded",
        24.0,
        payload,
    ), twin.record("empty", 24.0)


def as_read(motion: Motion, current_A: FloatArray) -> Motion:
    """The motion that is taken from a recording of it with other efforts."""
    times_ns = np.round(1e9 * motion.times_s).astype(np.int64)
    joints = JointRecord(times_ns, motion.joints, motion.position, current=current_A)
    return motion_of(
        Recording(motion.name, joints, None),
        joints=motion.joints,
    )


def gone(
    motion: Motion,
    since: float,
    value: float,
    joint: str = "",
) -> Motion:
    current = motion.current_A.copy()
    columns = np.array([joint in ("", name) for name in motion.joints])
    current[int(since * len(current)) :, columns] = value
    return as_read(motion, current)


def mass_in_sds(answer: Estimate) -> float:
    mass = answer.values[0]
    assert isinstance(mass.value, float) and isinstance(mass.std, float)
    return abs(mass.value - LOAD_KG) / mass.std


@pytest.mark.parametrize("value", [0.0, np.nan])
@pytest.mark.parametrize("joint", ["", "j2", "j5"])
@pytest.mark.parametrize("both", [False, True])
def test_the_part_before_is_weighed(
    robot: Robot,
    motions: tuple[Motion, Motion],
    value: float,
    joint: str,
    both: bool,
) -> None:
    loaded, empty = motions
    lost = gone(loaded, 0.6, value, joint)
    answer = identify_in_motion(
        robot, [lost], [gone(empty, 0.7, value, joint) if both else empty], PayloadFacts()
    )
    assert answer.verdict is Verdict.ACCEPTED, answer.reasons
    assert mass_in_sds(answer) < 3.0
    assert any("stands still or is missing from 14.4 s on" in note for note in answer.notes)


@pytest.mark.parametrize("value", [0.0, np.nan])
def test_too_little_is_refused_with_the_cause(
    robot: Robot, motions: tuple[Motion, Motion], value: float
) -> None:
    loaded, empty = motions
    cause = "stands still or is missing from 4.8 s on.*can be used"
    with pytest.raises(TooLittleMotion, match=cause):
        identify_in_motion(
            robot,
            [gone(loaded, 0.2, value)],
            [empty],
            PayloadFacts(),
        )


def test_efforts_that_were_never_measured_are_refused(motions: tuple[Motion, Motion]) -> None:
    with pytest.raises(RecordingError, match="in the whole recording while joints move"):
        gone(motions[0], 0.0, 0.0)


@pytest.mark.parametrize("value", [0.0, np.nan])
@pytest.mark.parametrize("lost", [0, 1])
def test_a_joint_that_was_never_measured_counts_for_nothing(
    robot: Robot,
    motions: tuple[Motion, Motion],
    value: float,
    lost: int,
) -> None:
    """In the loaded or in the empty motion alone: else its torque would be explained by nothing, and that perfectly."""
    both = list(motions)
    both[lost] = gone(both[lost], 0.0, value, "j5")
    answer = identify_in_motion(
        robot,
        [both[0]],
        [both[1]],
        PayloadFacts(),
    )
    assert answer.verdict is Verdict.ACCEPTED, answer.reasons
    assert mass_in_sds(answer) < 3.0
    assert any("effort of j5 stands still" in note for note in answer.notes)


def test_a_motion_without_gaps_is_complete(motions: tuple[Motion, Motion]) -> None:
    loaded = motions[0]
    assert loaded.complete() is loaded
    current = loaded.current_A.copy()
    current[:100, 2] = np.nan
    part = replace(loaded, current_A=current).complete()
    assert len(part.times_s) == len(loaded.times_s) - 100 and part.times_s[0] == 0.0


@pytest.mark.parametrize("published", [None, np.nan])
def test_a_command_does_not_stand_in_for_efforts_that_were_said_to_be_measured(
    published: float | None,
) -> None:
    """A controller's model commands what the empty arm needs: with NaN efforts a UR10e with 2.8 kg read 2 g."""
    position, effort = waves()
    record = JointRecord(
        np.round(1e9 * TIMES_S).astype(np.int64),
        ("joint2", "joint3"),
        position,
        reported_effort=None if published is None else np.full_like(effort, published),
    )
    commanded = InputRecord(record.times_ns, record.names, effort, "/current_command")
    options = Options(robot="open_manipulator_x", effort_unit="A")
    request = Request(load_robot("open_manipulator_x"), options)
    with pytest.raises(RecordingError, match="--effort-unit A says that efforts were measured"):
        runs_or_motion(Recording("bag", record, commanded), request)
