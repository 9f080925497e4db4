"""Names of joints that are the robot's but for a prefix or a suffix: taken where they fit in one way, else asked for."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.bends.messages import Bend, bent, of_joint_states

from proprio_ros.errors import RecordingError
from proprio_ros.pipeline.check import check_bags
from proprio_ros.pipeline.loading import bag_runs
from proprio_ros.pipeline.request import Options, Request
from proprio_ros.recordings.effort import Effort
from proprio_ros.recordings.joint_names import fitted_names, ways_of
from proprio_ros.recordings.read_options import ReadOptions
from proprio_ros.recordings.topics import Conventions
from proprio_ros.robot import load_robot

BAG = Path("bag")
PUSH = (
    Path(__file__).resolve().parents[2]
    / "bags"
    / "quantised_s00_fixed_heavy_ball_50g_joint3"
    / "bag_mcap"
)
PANDA = tuple(f"panda_joint{number}" for number in range(1, 8))
PLAIN = tuple(f"joint{number}" for number in range(1, 8))


def named(before: str, beside: str = "") -> Bend:
    """Messages with other names, and with a second arm that stands beside the first one."""

    def rename(message: Any) -> None:
        names = list(message.name)
        message.name = [before + name for name in names]
        if beside:
            message.name += [beside + name for name in names]
            for key in ("position", "velocity", "effort"):
                values = getattr(message, key)
                setattr(message, key, np.concatenate([values, values]))

    return of_joint_states(rename)


def options(
    joints: tuple[str, ...],
    conventions: Conventions | None = None,
) -> ReadOptions:
    return ReadOptions(Effort("N.m", {}), joints, conventions or Conventions())


@pytest.mark.parametrize(
    ("before", "behind"),
    [
        ("fer_", ""),
        ("fr3_", ""),
        ("left/arm_", ""),
        ("", ".pos"),
        ("a_", ":x"),
    ],
)
@pytest.mark.parametrize("joints", [PANDA, PLAIN])
def test_one_prefix_or_suffix_is_taken_for_the_robots(
    joints: tuple[str, ...], before: str, behind: str
) -> None:
    """Beside fingers, wheels and a head that the robot does not have."""
    recorded = (*(f"{before}{name}{behind}" for name in PLAIN), "fer_finger_joint", "wheel_left")
    fitted = fitted_names(BAG, recorded, options(joints))
    assert fitted.renamed(recorded)[:7] == joints
    assert fitted.renamed(recorded)[7:] == recorded[7:]
    assert fitted.options.conventions.renamed(recorded)[:7] == joints
    (note,) = fitted.notes
    assert f"{recorded[0]} as {joints[0]}" in note


def test_the_robots_own_names_are_left_alone() -> None:
    both = (*PLAIN, *(f"left_{name}" for name in PLAIN))
    for recorded in (PLAIN, both):
        fitted = fitted_names(BAG, recorded, options(PLAIN))
        assert not fitted.names and not fitted.notes


def test_two_arms_are_refused_with_both_ways() -> None:
    recorded = tuple(f"{side}_{name}" for side in ("left", "right") for name in PLAIN)
    with pytest.raises(
        RecordingError, match=r"left_joint1 as joint1, or right_joint1 as joint1.*joint_prefix"
    ):
        fitted_names(BAG, recorded, options(PLAIN))


def test_what_has_only_numbers_in_common_does_not_fit() -> None:
    """Any arm has a first joint."""
    ours = [f"joint_{number}" for number in range(1, 8)]
    assert ways_of(ours, PANDA) == []
    axes = [f"axis_{number}" for number in range(1, 8)]
    assert ways_of(axes, ours) == []
    assert ways_of(["shoulder_pan_joint", "elbow_joint"], PANDA) == []


def test_a_part_of_the_joints_does_not_fit() -> None:
    assert ways_of(["fer_joint1", "fer_joint2", "fer_joint3"], PANDA) == []


def test_what_a_profile_renames_fits_too() -> None:
    """The profile takes ``robot_`` off; the rest is found."""
    theirs = Conventions(driver="mine", prefix="robot_", names={"first": "fer_joint1"})
    recorded = ("robot_first", *(f"robot_fer_joint{number}" for number in range(2, 8)))
    fitted = fitted_names(BAG, theirs.renamed(recorded), options(PANDA, theirs))
    assert fitted.options.conventions.renamed(recorded) == PANDA
    assert fitted.options.conventions.published("panda_joint1") == "robot_first"


def test_a_bag_is_read_by_either_name(tmp_path: Path) -> None:
    """The same runs come out, with a note; with another arm beside it the names are asked for."""
    robot = load_robot("open_manipulator_x")
    plain = bag_runs(PUSH, Request(robot))
    bag = bent(tmp_path / "one", named("arm/left_"), PUSH)
    runs = bag_runs(bag, Request(robot))
    for one, other in zip(plain, runs, strict=True):
        assert one.joint == other.joint and np.array_equal(one.position, other.position)
        assert np.array_equal(one.input_current_A, other.input_current_A)
    assert any("arm/left_joint1 as joint1" in note for note in runs[0].notes)

    bag = bent(tmp_path / "both", named("left_", "right_"), PUSH)
    with pytest.raises(RecordingError, match="left_joint1 as joint1, or right_joint1 as joint1"):
        bag_runs(bag, Request(robot))
    _, (check,) = check_bags([bag])
    assert "joint_prefix" in check.problem and "right_joint1" in check.joints
    profile = tmp_path / "mine.yaml"
    profile.write_text("extends: proprio\njoint_prefix: left_\n")
    assert check_bags([bag], Options(driver=profile))[1][0].usable == 1
