"""Joints held by efforts alone, on a simulated arm behind an effort controller; MuJoCo shares no line with the law."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("mujoco")

from proprio_ros.excitation.hold import LOST_RAD, Hold, HoldGains
from proprio_ros.records import FloatArray
from proprio_ros.robot import load_robot
from proprio_ros.virtual.effort_driver import EffortDriver
from proprio_ros.virtual.objects import Payload
from proprio_ros.virtual.truth import Truth

ROBOT = load_robot("open_manipulator_x")
JOINTS = tuple(ROBOT.drive_trains)
SCALE = np.array([ROBOT.drive_trains[name].transmission for name in JOINTS])


class HeldArm:
    """A virtual arm and what holds it, with one sample of delay between them."""

    def __init__(
        self,
        rate_hz: float,
        *,
        seed: int = 0,
        coulomb: float = 0.01,
        sign: float = 1.0,
    ) -> None:
        truth = Truth.draw(ROBOT, seed, links=True)
        # hardly any friction: it would hide a law that swings
        joints = {
            n: replace(j, coulomb=coulomb, viscous=0.0, load_friction=0.0)
            for n, j in truth.joints.items()
        }
        self.driver = EffortDriver(
            ROBOT,
            replace(truth, joints=joints),
            seed=seed,
        )
        self.hold = Hold(ROBOT, JOINTS)
        self.rate_hz = rate_hz
        self.sign = sign
        self.time_s = 10.0
        self.waiting: deque[dict[str, float]] = deque()
        self.goal: dict[str, float] = {}
        self.efforts: list[list[float]] = []

    def reading(self) -> dict[str, float]:
        position, _, _ = self.driver.states()
        return dict(zip(self.driver.broadcast, position, strict=True))

    def run(
        self,
        seconds: float,
        velocity: dict[str, float] | None = None,
        pushed: dict[str, float] | None = None,
    ) -> FloatArray:
        """Departures from the goals, all of them as angles of the motors [rad], shape (T, J)."""
        rows = []
        for _ in range(round(seconds * self.rate_hz)):
            self.time_s += 1.0 / self.rate_hz
            self.driver.advance(self.time_s)
            self.hold.observe(self.time_s, self.reading())
            if not self.goal:
                self.hold.begin()
                self.goal = {name: q for name, q in self.reading().items() if name in JOINTS}
            for name, speed in (velocity or {}).items():
                self.goal[name] += speed / self.rate_hz
            self.hold.aim(self.goal)
            self.waiting.append(self.hold.efforts(pushed or {}))
            if len(self.waiting) > 1:
                efforts = self.waiting.popleft()
                self.efforts.append([efforts[name] for name in JOINTS])
                assert self.driver.command(
                    self.time_s, [self.sign * effort for effort in self.efforts[-1]]
                )
            true = self.driver.arm.position()
            rows.append([true[name] - self.goal[name] for name in JOINTS])
        return np.array(rows) / SCALE


@pytest.mark.parametrize(("rate_hz", "sag_rad"), [(500.0, 0.08), (100.0, 0.15)])
def test_a_load_that_nobody_announced_is_taken_up_without_swinging(
    rate_hz: float, sag_rad: float
) -> None:
    arm = HeldArm(rate_hz)
    free = arm.run(0.6)
    assert np.abs(free).max() < 0.03
    arm.driver.hold(Payload(0.1))
    loaded = arm.run(2.0)
    assert np.abs(loaded).max() < sag_rad
    last = loaded[-round(0.5 * rate_hz) :]
    assert np.abs(last).max() < 0.035
    assert np.ptp(last, axis=0).max() < 0.008
    assert not arm.hold.lost


@pytest.mark.parametrize("rate_hz", [500.0, 100.0])
def test_goals_that_move_are_followed(rate_hz: float) -> None:
    arm = HeldArm(rate_hz, seed=1, coulomb=0.05)
    arm.run(1.0)  # it asks for its delay first
    moving = arm.run(
        0.6,
        {"joint3": -0.8, "joint4": 0.5},
    )
    assert np.abs(moving).max() < 0.12
    assert np.abs(arm.run(1.0)[-20:]).max() < 0.03


def test_efforts_of_the_wrong_sign_end_in_zeros() -> None:
    arm = HeldArm(500.0, sign=-1.0)
    arm.run(1.0)
    assert "where it should be held" in arm.hold.lost or "though it should be held" in arm.hold.lost
    assert arm.efforts[-1] == [0.0] * len(JOINTS)
    assert arm.hold.steady() == dict.fromkeys(JOINTS, 0.0)


def rest(
    hold: Hold,
    position: dict[str, float],
    seconds: float = 0.2,
    time_s: float = 1.0,
) -> float:
    for _ in range(round(seconds * 500)):
        time_s += 0.002
        hold.observe(time_s, position)
    return time_s


def test_nothing_exceeds_the_motors_limits() -> None:
    hold = Hold(ROBOT, JOINTS, HoldGains(frequency_rad_s=1000.0))
    here = dict.fromkeys(JOINTS, 0.0)
    rest(hold, here)
    hold.begin()
    hold.aim({name: 0.3 * abs(scale) for name, scale in zip(JOINTS, SCALE, strict=True)})
    efforts = hold.efforts({"joint1": 99.0})
    assert set(efforts) == {*JOINTS}
    for name, effort in efforts.items():
        motor = ROBOT.motors[name]
        drive = ROBOT.drive_trains[name]
        assert abs(effort) <= motor.current_limit_A * abs(drive.nominal_effort_per_current) + 1e-12
    assert efforts["joint1"] == hold.largest["joint1"]


def test_a_goal_that_nobody_moves_any_more_has_no_velocity() -> None:
    """As when a guard ends a push: what was held is held where it has given way to, and nobody aims again."""
    hold = Hold(ROBOT, JOINTS)
    here = dict.fromkeys(JOINTS, 0.0)
    time_s = rest(hold, here)
    hold.begin()
    standing = hold.efforts({})
    for goal in (0.01, 0.02, 0.03, 0.0):  # it moves for a moment, and is put back
        time_s += 0.002
        hold.observe(time_s, here)
        hold.aim({**here, "joint2": goal})
    rest(hold, here, 0.3, time_s)
    assert hold.efforts({}) == pytest.approx(standing)


def test_a_slipped_encoder_does_not_move_the_arm() -> None:
    hold = Hold(ROBOT, JOINTS)
    here = dict.fromkeys(JOINTS, 0.0)
    time_s = rest(hold, here)
    hold.begin()
    before = hold.efforts({})
    hold.observe(time_s + 0.002, {**here, "joint1": 0.6})
    assert hold.efforts({})["joint1"] == pytest.approx(before["joint1"], abs=1e-6)
    assert not hold.lost


def test_what_is_no_number_is_passed_over_and_a_far_joint_is_lost() -> None:
    hold = Hold(ROBOT, JOINTS)
    here = dict.fromkeys(JOINTS, 0.0)
    time_s = rest(hold, here)
    hold.begin()
    hold.observe(
        time_s + 0.002,
        {**here, "joint1": math.nan},
    )
    assert all(math.isfinite(effort) for effort in hold.efforts({}).values())
    for step in range(1, 60):
        hold.observe(
            time_s + 0.1 * step,
            {**here, "joint1": 0.01 * step},
        )
    assert hold._position["joint1"] > LOST_RAD
    assert hold.efforts({}) == dict.fromkeys(JOINTS, 0.0)
    assert "joint1" in hold.lost


@pytest.mark.parametrize(
    ("delay_s", "after_s", "lost"),
    [(0.004, 0.8, False), (0.004, 1.3, True), (0.075, 3.0, False), (0.075, 6.0, True)],
)
def test_a_joint_that_was_pushed_has_as_long_to_come_back_as_its_hold_is_soft(
    delay_s: float, after_s: float, lost: bool
) -> None:
    hold = Hold(ROBOT, JOINTS)
    hold.delay.delay_s = delay_s
    here = dict.fromkeys(JOINTS, 0.0)
    time_s = rest(hold, here)
    hold.begin()
    hold.efforts({"joint2": 0.1})
    away = {**here, "joint2": 0.7}
    for step in range(1, 51):  # within a tenth of a second
        hold.observe(
            time_s + 0.002 * step,
            {**here, "joint2": 0.014 * step},
        )
        hold.efforts({"joint2": 0.1})
    rest(hold, away, after_s, time_s + 0.1)
    hold.efforts({})
    assert ("joint2 is 0.70 rad" in hold.lost) is lost
    assert bool(hold.lost) is lost


def test_blind_efforts_are_gravity_and_what_was_summed_up() -> None:
    hold = Hold(ROBOT, JOINTS)
    here = {**dict.fromkeys(JOINTS, 0.0), "joint2": -0.4}
    time_s = rest(hold, here)
    hold.begin()
    gravity = hold.steady()
    assert gravity["joint2"] < -0.3
    hold.aim({**here, "joint2": -0.45})  # far: it is soft until the arm has shown its delay
    for step in range(100):
        hold.observe(time_s + 0.002 * (step + 1), here)
        hold.efforts({})
    assert hold.steady()["joint2"] < gravity["joint2"] - 0.01
    summed = hold.steady()
    for _ in range(50):
        hold.efforts({"joint1": 0.1})
    last = hold.steady()
    assert {**last, "joint1": summed["joint1"]} == summed, "nothing is summed up during a push"
    assert -0.02 * hold.largest["joint1"] < last["joint1"] < 0.0, "a little against the push"


def test_pauses_make_it_softer_and_it_stays_stable() -> None:
    """Efforts stay until the next command: with every 35th joint state only, what is stiff at 500 Hz would throw the arm."""
    arm = HeldArm(500.0)
    arm.run(1.0)
    arm.rate_hz = 14.0
    paused = arm.run(3.0)
    assert not arm.hold.lost
    assert np.abs(paused).max() < 0.2
    assert np.ptp(paused[-14:], axis=0).max() < 0.1


def test_a_fast_joint_is_braked_and_comes_back_without_passing_its_goal_far() -> None:
    """A shoulder that a push has brought to 4 rad/s: what is summed up meanwhile would throw it back."""
    arm = HeldArm(500.0, seed=1, coulomb=0.05)
    arm.run(0.3)
    arm.goal |= {"joint2": arm.reading()["joint2"]}
    arm.run(0.35, pushed={"joint2": 0.55})
    arm.goal["joint2"] = arm.reading()["joint2"]
    column = JOINTS.index("joint2")
    speed = abs(arm.driver.arm.velocity_rad_s()[column])
    assert speed > 3.0
    braked = arm.run(1.5)[:, column]
    assert np.abs(braked).max() < 0.35
    assert braked.min() > -0.02, "it comes back from where it ran on to"
    assert abs(braked[-1]) < 0.04
    assert not arm.hold.lost


def test_blind_efforts_hold_a_load_that_a_joint_leans_on() -> None:
    """Beyond its settling time the sum stands, and a spring carries what came later: the last word must carry it, too."""
    arm = HeldArm(500.0, coulomb=0.03)
    arm.run(1.5)
    arm.driver.hold(Payload(0.05))
    loaded = arm.run(1.0)[-1]
    last = arm.hold.steady()
    for _ in range(250):
        arm.time_s += 0.002
        assert arm.driver.command(arm.time_s, [last[name] for name in JOINTS])
        arm.driver.advance(arm.time_s)
    true = arm.driver.arm.position()
    after = np.array([true[name] - arm.goal[name] for name in JOINTS]) / SCALE
    assert np.abs(after - loaded).max() < 0.03


def test_a_push_moves_the_other_joints_little() -> None:
    """Unless the reaction is countered the elbow gives way by 20 mrad."""
    arm = HeldArm(500.0, seed=1, coulomb=0.02)
    arm.driver.arm.set_position({"joint2": 0.0, "joint3": -1.0, "joint4": 0.0})
    arm.run(1.0)
    before = arm.run(0.1)[-1]
    pushed = arm.run(0.3, pushed={"joint2": -0.57})
    others = [column for column, name in enumerate(JOINTS) if name != "joint2"]
    assert np.abs(pushed[-1, JOINTS.index("joint2")] - before[JOINTS.index("joint2")]) > 0.2
    assert np.abs(pushed[:, others] - before[others]).max() < 0.008


def test_a_heavy_hand_is_braked_after_a_push() -> None:
    arm = HeldArm(500.0, seed=1, coulomb=0.05)
    arm.driver.arm.set_position({"joint2": 0.0, "joint3": -1.0, "joint4": 0.0})
    arm.run(1.0)
    arm.driver.hold(Payload(0.15))
    arm.run(1.5)
    start = arm.reading()["joint2"]
    column = JOINTS.index("joint2")
    while abs(arm.reading()["joint2"] - start) < 0.6:
        arm.run(0.02, pushed={"joint2": -0.7})
    assert abs(arm.driver.arm.velocity_rad_s()[column]) > 3.0
    arm.goal["joint2"] = arm.reading()["joint2"]
    braked = arm.run(1.2)[:, column]
    assert not arm.hold.lost
    assert np.abs(braked).max() < 0.35
    assert abs(braked[-1]) < 0.04


def test_a_joint_that_has_settled_stands_still() -> None:
    """The sum or the encoder's noise would have it creep, and a probe begins at rest."""
    arm = HeldArm(500.0, seed=2, coulomb=0.05)
    arm.run(0.5)
    arm.run(0.3, {"joint2": -0.5, "joint3": 0.5})
    arm.run(1.0)
    assert np.ptp(arm.run(0.8), axis=0).max() < 0.002


@pytest.mark.parametrize(("pause_s", "said"), [(0.09, "paused for 90 ms"), (0.002, "")])
def test_a_joint_that_is_lost_after_a_pause_says_how_long_it_was(pause_s: float, said: str) -> None:
    hold = Hold(ROBOT, JOINTS)
    here = dict.fromkeys(JOINTS, 0.0)
    time_s = rest(hold, here) + pause_s
    hold.begin()
    hold.observe(time_s, here)
    for number in range(1, 6):  # 20 rad/s
        hold.observe(
            time_s + 0.002 * number,
            {**here, "joint2": 0.04 * number},
        )
    assert not any(hold.efforts({}).values())
    assert "joint2 moves at" in hold.lost
    assert said in hold.lost
    assert ("paused" in hold.lost) == bool(said)
    # a second later it is not the pause
    late = Hold(ROBOT, JOINTS)
    time_s = rest(late, here) + 0.09
    late.begin()
    time_s = rest(late, here, 1.2, time_s)
    late.observe(time_s + 0.002, {**here, "joint2": 0.2})
    late.observe(time_s + 0.004, {**here, "joint2": 0.4})
    late.efforts({})
    assert "joint2" in late.lost
    assert "paused" not in late.lost
