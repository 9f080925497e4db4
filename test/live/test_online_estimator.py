"""Joint states of an arm at work: what a running estimate cannot use, and what it takes to stand, is said."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from proprio_ros.identification.regression.scale_in_motion import TorqueScale
from proprio_ros.live.online_estimator import OnlineFeed, any_moved
from proprio_ros.robot import load_robot

JOINTS = ("joint1", "joint2")
AT_REST = [0.1, 0.2]


class Estimator:
    """In the place of a running estimate: keeps what it is given."""

    def __init__(self, held: dict[str, float]) -> None:
        self.held = held
        self.rows = []
        self.frozen = False
        self.scale = TorqueScale()

    def add(
        self,
        time_s: float,
        positions: Sequence[float],
        currents: Sequence[float],
        works: bool,
    ) -> bool:
        self.rows.append((list(positions), list(currents)))
        return True

    def estimate(self) -> Any:
        return self


def new_feed(
    kept: dict[str, float] | None = None,
    stated: dict[str, float] | None = None,
) -> OnlineFeed:
    """``kept`` is where the calibration says that joints stand, ``stated`` what is stated now."""
    arm = load_robot("open_manipulator_x")
    calibration: Any = SimpleNamespace(joints=JOINTS)
    robot = replace(
        arm,
        motion_calibration=calibration,
        held=kept or {},
    )
    probe: Any = SimpleNamespace(running=lambda robot, facts, held: Estimator(dict(held)))
    return OnlineFeed(probe, robot, None, stated)


@pytest.fixture
def feed() -> OnlineFeed:
    return new_feed()


def test_it_says_what_it_rests_on(feed: OnlineFeed) -> None:
    assert "measured effort" in feed.about
    assert "joint3, joint4, gripper_left_joint counts as standing" in feed.about


def test_a_joint_state_without_measured_effort_is_named(feed: OnlineFeed) -> None:
    assert feed.add(0.0, JOINTS, AT_REST, [1.0, 2.0], "A") is not None
    assert not feed.waits_for
    assert feed.samples == 1
    for effort in ([], [1.0], [1.0, math.nan]):
        feed = new_feed()
        feed.add(0.0, JOINTS, AT_REST, effort, "A")
        assert "no measured effort of " in feed.waits_for
        assert "joint2" in feed.waits_for
        assert feed.samples == 0
        # whoever else publishes joint states changes nothing about that
        feed.add(
            0.1,
            ["wheel"],
            [3.0],
            [1.0],
            "A",
        )
        assert "no measured effort of " in feed.waits_for
    assert feed.add(0.2, JOINTS, AT_REST, [1.0, 2.0], "A") is not None
    assert not feed.waits_for


def test_an_effort_of_which_nobody_says_the_unit_is_named(feed: OnlineFeed) -> None:
    assert feed.add(0.0, JOINTS, AT_REST, [1.0, 2.0], "") is None
    assert feed.waits_for.endswith("give the parameter driver or effort_unit")
    feed = new_feed()
    feed.add(
        0.0,
        ["joint1"],
        [0.1],
        [1.0],
        "A",
    )
    assert feed.waits_for == "no joint states of joint2 are coming"


def test_a_joint_outside_the_calibration_that_moves_is_named(feed: OnlineFeed) -> None:
    feed.add(
        0.0,
        ["joint3"],
        [0.4],
        [0.0],
        "A",
    )  # from a publisher of its own, before the others
    estimate: Any = feed.add(
        0.1,
        JOINTS,
        AT_REST,
        [1.0, 2.0],
        "A",
    )
    assert estimate.held["joint3"] == 0.4
    assert estimate.held["joint4"] == 0.0
    feed.add(
        0.2,
        ["joint3", "joint4"],
        [0.42, 0.0],
        [0.0, 0.0],
        "A",
    )
    assert not feed.warning
    feed.add(
        0.3,
        ["joint3", "joint4"],
        [0.5, 0.0],
        [0.0, 0.0],
        "A",
    )
    assert feed.warning.startswith(
        "joint3 is not in the calibration and not where it counts as standing"
    )
    feed.add(
        0.4,
        ["joint4"],
        [0.3],
        [0.0],
        "A",
    )  # heard for the first time, and not at zero
    assert feed.warning.startswith("joint3, joint4 ")


def test_joint_states_that_say_the_same_again_and_again_do_not_count(feed: OnlineFeed) -> None:
    estimator: Any = feed.add(
        0.0,
        JOINTS,
        AT_REST,
        [1.0, 2.0],
        "A",
    )
    estimator.frozen = True
    feed.add(
        0.1,
        JOINTS,
        AT_REST,
        [1.0, 2.0],
        "A",
    )
    assert feed.samples == 1
    assert "their publisher stalls" in feed.waits_for
    estimator.frozen = False
    feed.add(
        0.2,
        JOINTS,
        AT_REST,
        [1.0, 2.0],
        "A",
    )
    assert feed.samples == 2
    assert not feed.waits_for


def test_only_the_arm_that_moves_is_weighed() -> None:
    states = [(["joint1", "wheel"], [0.001 * number, float(number)]) for number in range(20)]
    assert not any_moved(states, JOINTS)
    assert any_moved(states, ["wheel"])


def test_a_calibration_says_where_joints_stand_that_nobody_reports() -> None:
    """As `replay` has it: what is heard wins over the calibration, and what is stated now over both."""
    finger = "gripper_left_joint"
    feed = new_feed(
        {finger: 0.01, "joint3": 0.2, "joint1": 1.0},
        {"joint4": 0.3},
    )
    feed.add(
        0.0,
        ["joint3", "joint4"],
        [0.4, 0.1],
        [0.0, 0.0],
        "A",
    )
    estimate: Any = feed.add(
        0.1,
        JOINTS,
        AT_REST,
        [1.0, 2.0],
        "A",
    )
    assert estimate.held == {"joint3": 0.4, "joint4": 0.3, finger: 0.01}
    assert not feed.warning
