"""Motions that no fit can take: they are recognised before it, or it ends in one sentence."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("mujoco")

from support.arm_in_motion import SIX, Twin, write_robot
from support.machines import REAL

from proprio_ros.errors import LONGEST_SENTENCE, ConfigurationError, RecordingError
from proprio_ros.identification.regression.motion_equations import (
    LEAST_WINDOWS,
    equations,
    weighable,
)
from proprio_ros.identification.regression.motion_estimate import calibrate_motions
from proprio_ros.identification.regression.motion_fit import fit_empty
from proprio_ros.identification.solvable import solvable
from proprio_ros.pipeline.replay import replay
from proprio_ros.pipeline.request import Options
from proprio_ros.probes.payload.moving import identify_in_motion
from proprio_ros.recordings.motions import Motion
from proprio_ros.robot import Robot, load_robot
from proprio_ros.sim.payload import PayloadFacts

needs_real = pytest.mark.skipif(
    not REAL.is_dir(),
    reason=f"needs {REAL}",
)
HELD = (1.0, np.array([0.05, 0.02, 0.0]))


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return load_robot(write_robot(tmp_path_factory.mktemp("arm")))


def moving(*joints: int) -> Twin:
    """An arm of which only these joints swing; the others stand in the middle of theirs."""
    twin = Twin(1)
    size = np.array(SIX.size) * 1.0
    twin.build = replace(SIX, size=tuple(size))
    twin.rng = Only(twin.rng, joints)
    return twin


class Only:
    """Random numbers whose sines have no size for joints that stand."""

    def __init__(
        self,
        rng: np.random.Generator,
        joints: tuple[int, ...],
    ) -> None:
        self._rng = rng
        self._joints = list(joints)

    def uniform(
        self,
        low: float,
        high: float,
        shape: tuple[int, int],
    ) -> np.ndarray:
        drawn = self._rng.uniform(low, high, shape)
        if (low, high) == SIX.size:
            stand = np.setdiff1d(
                np.arange(len(drawn)),
                self._joints,
            )
            drawn[stand] = 0.0
        return drawn

    def __getattr__(self, name: str) -> object:
        return getattr(self._rng, name)


@pytest.mark.parametrize(
    ("with_load", "empty"),
    [
        ((0, 1), (2, 3)),
        ((1,), (2,)),
        ((3, 4, 5), (0, 1, 2)),
    ],
)
def test_motions_of_different_joints_are_named(
    robot: Robot,
    with_load: tuple[int, ...],
    empty: tuple[int, ...],
) -> None:
    loaded = moving(*with_load).record("loaded", 20.0, HELD)
    baseline = moving(*empty).record("empty", 20.0)
    with pytest.raises(RecordingError, match="the two motions move different joints") as caught:
        identify_in_motion(
            robot,
            [loaded],
            [baseline],
            PayloadFacts(),
        )
    for joint in (*with_load, *empty):
        assert SIX.joints[joint] in str(caught.value)
    assert "..." not in str(caught.value)


def test_a_joint_that_moves_with_the_load_only_is_named_and_counts_for_little(robot: Robot) -> None:
    loaded = moving(0, 1, 2, 3).record(
        "loaded",
        30.0,
        HELD,
    )
    baseline = moving(0, 1, 2).record("empty", 30.0)
    estimate = identify_in_motion(
        robot,
        [loaded],
        [baseline],
        PayloadFacts(),
    )
    assert any(note.startswith("j4 moved with the load only") for note in estimate.notes)
    (mass, *_) = estimate.values
    assert estimate.verdict.value == "accepted"
    assert mass.ci95[0] < HELD[0] < mass.ci95[1]
    both = identify_in_motion(
        robot,
        [loaded],
        [loaded],
        PayloadFacts(),
    )
    assert not any("with the load only" in note for note in both.notes)


def briefly(
    motion: Motion,
    joint: int,
    share: float,
) -> Motion:
    """The same, in which a joint moves for a share of the time and stands for the rest."""
    position = motion.position.copy()
    last = int(share * len(position))
    position[last:, joint] = position[last, joint]
    return replace(motion, position=position)


@pytest.mark.parametrize("share", [0.04, 0.06, 0.08])
def test_a_joint_that_moves_in_a_few_windows_outweighs_nothing(robot: Robot, share: float) -> None:
    """With as many unknowns as rows nothing is left over, and its weight would be without end."""
    motion = briefly(
        moving(1, 2).record("empty", 30.0),
        2,
        share,
    )
    rows = equations(robot, motion, motion.joints)
    assert 0 < np.sum(rows.joint == 2) < LEAST_WINDOWS
    (kept,) = weighable([rows])
    assert set(kept.joint) == {1}
    assert len(kept.joint) == np.sum(rows.joint == 1)
    calibration = fit_empty(robot, [motion])
    assert np.flatnonzero(calibration.residual).tolist() == [1]
    assert 0.7 < calibration.arm_over_urdf < 1.3
    # two recordings that have few windows each have enough together
    assert {1, 2} <= set(weighable([rows] * LEAST_WINDOWS)[0].joint)


def test_what_no_fit_foresaw_is_one_sentence() -> None:
    def singular() -> None:
        np.linalg.inv(np.zeros((2, 2)))

    def overflows() -> None:
        10.0**400  # noqa: B018

    def no_number() -> None:
        float("none")

    def refused() -> None:
        raise ConfigurationError("--set: wrong")

    for function in (singular, overflows, no_number):
        with pytest.raises(RecordingError, match="have no solution") as caught:
            solvable(function)()
        assert len(str(caught.value)) < LONGEST_SENTENCE and "proprio check" in str(caught.value)
    with pytest.raises(ConfigurationError, match="--set: wrong"):
        solvable(refused)()


@pytest.mark.parametrize("kg", [0.5, 1.0, 2.5])
def test_a_tool_in_the_recording_of_an_empty_hand_is_named(robot: Robot, kg: float) -> None:
    tool = (kg, np.array([0.2, 0.0, 0.1]))
    twin = Twin(1)
    estimate = calibrate_motions(
        robot,
        [twin.record("tool", 60.0, tool)],
    )
    (reason, *_) = estimate.reasons
    assert reason.code == "hand_not_empty" and " holds " in reason and "URDF" in reason
    assert len(reason) < 250


@pytest.mark.parametrize(
    "factor",
    [0.5, 1.6, 2.0, -1.0],
)
def test_another_unit_is_no_tool(robot: Robot, factor: float) -> None:
    motion = Twin(1).record("empty", 60.0)
    scaled = replace(motion, current_A=factor * motion.current_A)
    estimate = calibrate_motions(robot, [scaled])
    assert "hand_not_empty" not in {reason.code for reason in estimate.reasons}
    assert estimate.verdict.value == "rejected"


def test_an_empty_hand_as_it_is_stated_is_no_tool(robot: Robot) -> None:
    for seed in (1, 2):
        estimate = calibrate_motions(
            robot,
            [Twin(seed).record("empty", 60.0)],
        )
        assert "hand_not_empty" not in {reason.code for reason in estimate.reasons}


@needs_real
@pytest.mark.parametrize(
    ("loaded", "empty"),
    [("amd02_joint1_alone", "amd02_joint3_alone"), ("amd02_joint3_alone", "amd02_joint1_alone")],
)
def test_real_motions_of_different_joints(loaded: str, empty: str) -> None:
    options = Options(
        probe="payload",
        robot=str(REAL / "models" / "am_d02.urdf"),
        effort_unit="N.m",
        baseline=[REAL / empty],
    )
    with pytest.raises(RecordingError, match="the two motions move different joints"):
        replay(REAL / loaded, options)


@needs_real
@pytest.mark.parametrize(
    ("loaded", "empty"),
    [("ur10e_loaded_14", "ur10e_loaded_15"), ("ur10e_loaded_15", "ur10e_loaded_14")],
)
def test_a_real_tool_in_both_recordings(loaded: str, empty: str) -> None:
    options = Options(
        probe="payload",
        robot="ur10e",
        driver="ur_current",
        baseline=[REAL / empty],
    )
    estimate = replay(REAL / loaded, options)
    assert estimate.verdict.value == "rejected"
    assert [reason.code for reason in estimate.reasons] == ["hand_not_empty"]
