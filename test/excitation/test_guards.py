"""What is checked before an excitation begins."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from proprio_ros.errors import ExcitationError
from proprio_ros.excitation.commands import JointSample
from proprio_ros.excitation.guards import Guards, check_start, unfit
from proprio_ros.excitation.plans import ExcitationRun, load_sequence
from proprio_ros.excitation.pushes import GoalStep
from proprio_ros.excitation.ways import Ways
from proprio_ros.robot import load_robot

ROBOT = load_robot("open_manipulator_x")
WAYS = Ways(ROBOT)
POSE = {
    "joint1": 0.0,
    "joint2": -0.8,
    "joint3": 0.4,
    "joint4": 0.3,
    "gripper_left_joint": 0.004,
}
SEQUENCE = load_sequence("payload_elbow", ROBOT)


def sample(**position: float) -> JointSample:
    return JointSample(
        1.0,
        {**POSE, **position},
        dict.fromkeys(POSE, 0.0),
    )


def test_a_good_sample_may_be_started_from() -> None:
    assert unfit(sample(), WAYS.joints) == ""
    check_start(sample(), WAYS, Guards())


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        (replace(sample(), time_s=math.nan), "time stamp nan"),
        (replace(sample(), position={"joint1": 0.0}), "lacks the position of joint2, joint3"),
        (sample(joint3=math.inf), "the position of joint3 is inf"),
        (
            replace(sample(), velocity={**dict.fromkeys(POSE, 0.0), "joint4": math.nan}),
            "the velocity of joint4 is nan",
        ),
    ],
)
def test_a_bad_sample_is_refused_with_what_is_wrong_with_it(bad: JointSample, words: str) -> None:
    assert words in unfit(bad, WAYS.joints)
    with pytest.raises(ExcitationError, match="cannot start: .*" + words):
        check_start(bad, WAYS, Guards())


def test_an_arm_may_lean_on_its_stop_and_not_be_beyond_it() -> None:
    upper = ROBOT.model.joint("joint3").upper
    check_start(
        sample(joint3=upper + 0.04),
        WAYS,
        Guards(limit_margin_rad=0.05),
    )
    with pytest.raises(ExcitationError, match=r"joint3 reads .* outside its limits"):
        check_start(
            sample(joint3=upper + 0.06),
            WAYS,
            Guards(limit_margin_rad=0.05),
        )


def test_a_step_of_the_goal_stays_inside_the_limits() -> None:
    run = ExcitationRun("joint3", 0.0, 0.6, goal_step=-0.2)
    GoalStep(run).check(POSE, SEQUENCE, WAYS, Guards(), "run 1")
    low = {
        **POSE,
        "joint3": ROBOT.model.joint("joint3").lower + 0.1,
    }
    with pytest.raises(
        ExcitationError, match=r"run 1: its goal would be .*; use a smaller goal_step"
    ):
        GoalStep(run).check(low, SEQUENCE, WAYS, Guards(), "run 1")
