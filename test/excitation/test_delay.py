"""When efforts come into effect, read off joints that move by the law of Newton; and a hold by efforts that come late."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
import pytest

from proprio_ros.excitation.delay import LONGEST_S, NUDGE_RAD_S2, NUDGE_RAISED, NUDGES, Delay, Nudge
from proprio_ros.excitation.effort_controller import EffortController
from proprio_ros.excitation.first import first_sequence
from proprio_ros.robot import load_robot

INERTIA = np.array([[0.4, 0.1], [0.1, 0.05]])
PERIOD_S = 0.002


class Joints:
    """Two coupled joints on which efforts act late, integrated in steps of 0.1 ms; a constant load pulls at both."""

    def __init__(
        self,
        delay_s: float,
        count_rad: float = 0.0,
        load: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        self.delay = Delay(2)
        self.time_s = 1.795e9
        self._late_s = delay_s
        self._count_rad = count_rad
        self._load = np.array(load)
        self._coming: deque[tuple[float, np.ndarray]] = deque()
        self._effort = np.zeros(2)
        self._velocity = np.zeros(2)
        self.position = np.zeros(2)
        self.told: list[tuple[np.ndarray, np.ndarray]] = []

    def run(self, seconds: float, effort: np.ndarray) -> None:
        for _ in range(round(seconds / PERIOD_S)):
            read = (
                self.position
                if not self._count_rad
                else np.rint(self.position / self._count_rad) * self._count_rad
            )
            told = self.delay.observe(
                self.time_s,
                read.tolist(),
                INERTIA,
            )
            if told is not None:
                self.told.append(told)
            self.delay.sent(self.time_s, effort.tolist())
            self._coming.append((self.time_s + self._late_s, effort))
            for _ in range(20):
                self.time_s += PERIOD_S / 20
                while self._coming and self._coming[0][0] <= self.time_s:
                    self._effort = self._coming.popleft()[1]
                self._velocity = (
                    self._velocity
                    + np.linalg.solve(INERTIA, self._effort + self._load) * PERIOD_S / 20
                )
                self.position = self.position + self._velocity * PERIOD_S / 20

    def nudge(self, effort: np.ndarray) -> None:
        for sign in (0.0, 1.0, -1.0, 0.0):
            self.run(0.06, sign * effort)


@pytest.mark.parametrize("count_rad", [0.0, 2.0 * math.pi / 4096])
@pytest.mark.parametrize("delay_s", [0.003, 0.017, 0.049, 0.073])
def test_a_nudge_shows_the_delay(delay_s: float, count_rad: float) -> None:
    joints = Joints(delay_s, count_rad)
    assert joints.delay.delay_s is None
    assert joints.delay.assumed_s == LONGEST_S
    for sign in (1.0, -1.0):
        joints.nudge(np.array([4.0 * sign, 0.0]))
    assert joints.delay.delay_s == pytest.approx(delay_s, abs=0.003)


def test_joints_that_were_not_asked_show_nothing() -> None:
    joints = Joints(
        0.03,
        2.0 * math.pi / 4096,
        load=(0.1, -0.02),
    )
    joints.run(1.0, np.zeros(2))
    assert joints.delay.delay_s is None


def test_what_efforts_leave_unexplained_is_what_pulls() -> None:
    load = (0.3, -0.1)
    joints = Joints(0.049, load=load)
    joints.nudge(np.array([4.0, 0.5]))
    for _ in range(3):
        joints.nudge(np.array([-3.0, 0.4]))
    inertial, effort = (np.array(each) for each in zip(*joints.told[-60:], strict=True))
    assert (inertial - effort).mean(axis=0) == pytest.approx(load, abs=0.03)


def test_positions_are_carried_on_to_where_an_effort_that_is_sent_now_works() -> None:
    joints = Joints(0.049)
    joints.nudge(np.array([4.0, 0.0]))
    joints.run(0.3, np.array([0.0, 0.0]))
    joints.run(0.03, np.array([2.0, -0.4]))
    before = joints.position.copy()
    velocity = joints._velocity.copy()
    ahead_s = joints.delay.assumed_s
    momentum, integral = joints.delay.coming()
    expected = before + velocity * ahead_s + np.linalg.solve(INERTIA, integral)
    faster = velocity + np.linalg.solve(INERTIA, momentum)
    joints.run(ahead_s, np.zeros(2))
    # the last command counts until the next one, a period later
    assert joints.position == pytest.approx(expected, abs=3e-3)
    assert joints._velocity == pytest.approx(faster, abs=0.06)


def test_nudges_go_to_and_fro_begin_with_little_and_end() -> None:
    nudge = Nudge()
    step_s = 1e-3
    asked = [nudge.at(100.0 + step_s * step, 0.2) for step in range(4000)]
    assert sum(asked) * step_s == pytest.approx(0.0, abs=0.03 * NUDGE_RAISED**NUDGES)
    assert max(map(abs, asked[:200])) == NUDGE_RAD_S2
    assert nudge.over
    assert asked[-1] == 0.0


def test_a_joint_that_moves_is_nudged_no_harder() -> None:
    nudge = Nudge()
    hardest = 0.0
    position = 0.2
    velocity = 0.0
    step_s = 1e-3
    for step in range(4000):
        acceleration = nudge.at(100.0 + step_s * step, position)
        hardest = max(hardest, abs(acceleration))
        velocity += acceleration * step_s
        position += velocity * step_s
    assert nudge.over
    assert hardest == NUDGE_RAD_S2


def test_an_encoder_that_slips_and_a_clock_that_is_set_back_pull_at_nothing() -> None:
    joints = Joints(0.01)
    joints.nudge(np.array([4.0, 0.0]))
    joints.run(0.2, np.zeros(2))
    joints.told.clear()
    joints.position = joints.position + 1.0
    joints.delay.slipped()
    joints.run(0.3, np.zeros(2))
    joints.time_s -= 1000.0
    joints._coming.clear()
    joints.run(0.3, np.zeros(2))
    assert len(joints.told) > 150
    assert max(np.abs(inertial - effort).max() for inertial, effort in joints.told) < 0.05
    assert joints.delay.delay_s == pytest.approx(0.01, abs=0.003)


def test_what_hangs_in_the_hand_is_pushed_against_with_as_much_more() -> None:
    robot = load_robot("ur10e")
    empty, loaded = (first_sequence(robot, "payload", held_kg) for held_kg in (0.0, 5.0))
    assert len(empty.runs) == len(loaded.runs)
    more = [
        abs(other.current_A) - abs(run.current_A)
        for run, other in zip(empty.runs, loaded.runs, strict=True)
    ]
    assert max(more) > 0.1 * max(abs(run.current_A) for run in empty.runs)


def test_whoever_commands_says_how_late_and_how_fast() -> None:
    robot = load_robot("open_manipulator_x")
    controller = EffortController(robot, tuple(robot.drive_trains), "N.m")
    assert controller.late_s == 0.0
    assert controller.held_kg == 0.0
    assert 0.0 < controller.pace < 0.5, "until the arm has shown its delay it is slow"
