"""When a push began and ended, by its motion alone: what the stamps of its input are held against."""

from __future__ import annotations

import numpy as np
import pytest

from proprio_ros.identification.prepared_runs import PreparedRun, prepare_run
from proprio_ros.identification.stamps import driven_beyond, moves_before
from proprio_ros.records import Run
from proprio_ros.robot import load_robot

PERIOD_S = 0.025
DURATION_S = 0.6
COUNT_RAD = 2.0 * np.pi / 4096.0
JITTER_S = 3e-4
PUSHED, CHANGE = 4.0, -10.0
"""Acceleration while the current drives the joint, and what its end changes about that [rad/s^2]."""
ALLOWED_S = 0.024


def push(
    off_s: float,
    after: str = "coasts",
    ends: bool = True,
) -> PreparedRun:
    """A joint that a current drives for 0.6 s and whose input is stamped so much later than that; read in whole counts."""
    t = PERIOD_S * np.arange(-20, 40)
    driven = np.clip(t, 0.0, DURATION_S)
    beyond = np.maximum(t - DURATION_S, 0.0)
    position = 0.5 * PUSHED * driven**2
    if after == "coasts":
        position += PUSHED * DURATION_S * beyond + 0.5 * (PUSHED + CHANGE) * beyond**2
    return recorded(t, position, off_s, ends)


def recorded(
    t: np.ndarray,
    position: np.ndarray,
    off_s: float = 0.0,
    ends: bool = True,
) -> PreparedRun:
    """A run of these positions, whose push begins at zero."""
    position = COUNT_RAD * np.round(position / COUNT_RAD)
    t = t - off_s
    inside = (t >= 0.0) & (t <= DURATION_S)
    later = (t > DURATION_S) & (t < DURATION_S + 0.3) & ends
    robot = load_robot("open_manipulator_x")
    held = {name: 0.0 for name in robot.model.independent_joints if name != "joint3"}
    run = Run(
        name="push",
        joint="joint3",
        onset_ns=0,
        times_s=t[inside],
        position=position[inside],
        before_times_s=t[t < 0.0],
        before_position=position[t < 0.0],
        held=held,
        held_span=dict.fromkeys(held, 0.0),
        input_times_s=np.zeros(1),
        input_current_A=np.array([0.3]),
        duration_s=DURATION_S,
        source="/current_command",
        after_times_s=t[later],
        after_position=position[later],
    )
    return prepare_run(robot, run)


def marks(run: PreparedRun) -> tuple[float | None, float | None]:
    return moves_before(run, -ALLOWED_S, JITTER_S), driven_beyond(run, ALLOWED_S, CHANGE, JITTER_S)


@pytest.mark.parametrize("after", ["coasts", "is braked"])
@pytest.mark.parametrize("off_s", [-0.02, 0.0, 0.02])
def test_stamps_within_what_the_delay_may_be_are_believed(off_s: float, after: str) -> None:
    assert marks(push(off_s, after)) == (None, None)


@pytest.mark.parametrize("after", ["coasts", "is braked"])
def test_a_joint_that_moves_before_its_push(after: str) -> None:
    begun_s, _ = marks(push(0.06, after))
    assert begun_s is not None and -0.06 <= begun_s <= -0.03


@pytest.mark.parametrize("after", ["coasts", "is braked"])
def test_a_joint_that_is_driven_beyond_the_end(after: str) -> None:
    begun_s, driven_s = marks(push(-0.1, after))
    assert begun_s is None and driven_s is not None and ALLOWED_S < driven_s <= 0.1 + PERIOD_S


def test_a_joint_that_slipped_and_came_to_rest_before_its_push() -> None:
    t = 0.002 * np.arange(-250, 300)
    slipped = (
        np.where(
            t < -0.4,
            0.03,
            0.0,
        )
        + 2.0 * np.clip(t, 0.0, None) ** 2
    )
    assert moves_before(recorded(t, slipped), -ALLOWED_S, JITTER_S) is None
    begins = (
        np.where(
            t < -0.4,
            0.03,
            0.0,
        )
        + 2.0 * np.clip(t + 0.06, 0.0, None) ** 2
    )
    begun_s = moves_before(recorded(t, begins), -ALLOWED_S, JITTER_S)
    assert begun_s is not None and -0.1 < begun_s < -ALLOWED_S


def test_a_recording_that_stops_with_the_push_says_nothing_of_its_end() -> None:
    assert marks(push(-0.1, ends=False)) == (None, None)


def test_a_load_that_is_hardly_moved_is_no_sign_of_wrong_stamps() -> None:
    """It falls the faster the farther it has, which is no cubic: from 0.1 rad of it, at 500 Hz, its onset surely seemed early."""
    t = 0.002 * np.arange(-250, 300)
    position = 0.02 * (np.cosh(5.0 * np.clip(t, 0.0, None)) - 1.0)
    assert position[t < 0.45].max() < 0.1
    assert moves_before(recorded(t, position), -0.001, JITTER_S) is None


def test_a_joint_that_creeps_the_other_way_before_a_push_that_hardly_moves_it() -> None:
    """One count up in the last half second, and then slowly down: taken together they seemed to begin with the creep."""
    t = PERIOD_S * np.arange(-20, 24)
    away = -0.02 * (np.cosh(5.0 * np.clip(t, 0.0, None)) - 1.0)
    for creeps_rad in (0.6, 1.1, 2.1):
        crept = creeps_rad * COUNT_RAD * np.clip((t + 0.5) / 0.3, 0.0, 1.0)
        assert moves_before(recorded(t, crept + away), -0.0056, 2e-4) is None
    begins = -0.02 * (
        np.cosh(
            5.0
            * np.clip(
                t + 0.15,
                0.0,
                None,
            )
        )
        - 1.0
    )
    begun_s = moves_before(recorded(t, crept + begins), -0.0056, 2e-4)
    assert begun_s is not None and -0.2 < begun_s < -0.02


def test_the_earliest_onset_that_is_allowed_is_tried_itself() -> None:
    """Onsets are searched for 4 ms apart, at 0 and 4 ms here; that this one began 1.5 ms early cannot be seen."""
    t = 0.002 * np.arange(-250, 300)
    run = recorded(
        t,
        4.0 * np.clip(t, 0.0, None) ** 2,
    )
    assert moves_before(run, 0.0015, JITTER_S) is None
    assert moves_before(run, 0.005, JITTER_S) is not None
