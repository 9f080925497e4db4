"""Currents of motors that a voltage drives: joint state by joint state as those that a replay makes of the whole bag."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from proprio_ros.live.stall_current import FAR_RAD, WORKS_S, StallCurrents
from proprio_ros.robot import load_robot
from proprio_ros.robot.drives import Goal, PositionServo

NAME = "elbow_flex"


def test_they_are_those_of_a_replay() -> None:
    """The same law over all goals at once, with a firmware that moves its goal slowly, sent unevenly and some of it late."""
    robot = load_robot("so101")
    random = np.random.default_rng(4)
    drive = robot.drive_trains[NAME]
    times_s = 0.5 + np.cumsum(random.uniform(0.01, 0.06, 300))
    sent_s = np.sort(random.uniform(0.0, times_s[-1], 60))
    goals = Goal(sent_s, random.uniform(-1.0, 1.0, 60))
    position = np.interp(times_s, sent_s, goals.position) + 0.05 * random.standard_normal(300)
    stall = StallCurrents(robot)
    found = heard_one_by_one(stall, goals, times_s, position)
    law = drive.driven_by
    assert isinstance(law, PositionServo)
    duty = law.duty(times_s, position, None, goals, robot.delay.value)
    told = np.isfinite(found)
    assert told.sum() > 250
    assert np.all(times_s[~told] - robot.delay.value < sent_s[0])
    # a replay takes steps of 2 ms from the first joint state on, and here each goal begins where the last had come to
    stall_A = drive.supply_voltage_V / drive.resistance_ohm
    most = law.gain_per_rad * law.goal_speed_rad_s * 0.004 * stall_A
    assert np.abs(found[told] - duty[told] * stall_A).max() < most
    check_voltage(stall, times_s[-1], drive.supply_voltage_V)


def heard_one_by_one(
    stall: StallCurrents,
    goals: Goal,
    times_s: np.ndarray,
    position: np.ndarray,
) -> np.ndarray:
    """The current at each of those times and angles [A], (n,), by the goals that were sent before it."""
    waiting = list(zip(goals.times_s.tolist(), goals.position.tolist(), strict=True))
    found = []
    for time_s, at in zip(times_s.tolist(), position.tolist(), strict=True):
        while waiting and waiting[0][0] <= time_s:
            sent, goal = waiting.pop(0)
            stall.hear_goals(sent, ["wheel", NAME], [3.0, goal])
        found.append(stall.current_A(NAME, time_s, at, math.nan))
    return np.array(found)


def check_voltage(stall: StallCurrents, end_s: float, usual_V: float) -> None:
    """Half the voltage is half the current; where nobody measures one, it is the usual one."""
    stall.hear_voltage(0.0)
    assert stall.current_A(NAME, end_s + 1.0, 0.0, 0.0) != 0.0
    before = stall.current_A(NAME, end_s + 2.0, 0.0, 0.0)
    stall.hear_voltage(0.5 * usual_V)
    assert stall.current_A(NAME, end_s + 3.0, 0.0, 0.0) == pytest.approx(0.5 * before)


def test_what_is_not_known_is_not_guessed() -> None:
    robot = load_robot("so101")
    stall = StallCurrents(robot)
    assert math.isnan(stall.current_A(NAME, 1.0, 0.0, 0.0)), "nobody said where it is sent"
    stall.hear_goals(2.0, [NAME], [math.nan])
    assert math.isnan(stall.current_A(NAME, 3.0, 0.0, 0.0))
    stall.hear_goals(5.0, [NAME], [0.3])
    assert math.isnan(stall.current_A(NAME, 5.0, 0.0, 0.0)), "it takes a while until it works"
    assert stall.current_A(NAME, 6.0, 0.0, 0.0) > 0.0
    stall.hear_goals(1.0, [NAME], [-0.3])  # a clock was set back
    assert stall.current_A(NAME, 2.0, 0.0, 0.0) < 0.0


def test_who_only_holds_does_not_work() -> None:
    stall = StallCurrents(load_robot("so101"))
    for step in range(300):  # makes up for a load, by 0.06 rad in a second
        stall.hear_goals(
            0.02 * step,
            [NAME],
            [0.0012 * step],
        )
    assert not stall.works(6.0)
    stall.hear_goals(
        6.0,
        [NAME],
        [0.36 + 1.1 * FAR_RAD],
    )
    assert stall.works(6.0)
    assert stall.works(5.9 + WORKS_S)
    assert not stall.works(6.1 + WORKS_S)
    other = load_robot("open_manipulator_x")
    assert StallCurrents(other).works(0.0), "of an arm that sends no goals nobody knows"
    assert not StallCurrents(replace(other, drive_trains={})).joints
