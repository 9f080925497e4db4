"""The driver of an arm on an emulated bus, in simulated time: what the servos really do, not only what the driver says.

Currents are those that flow in the simulated arm, noted in every millisecond of its world.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.simulated_port import Wire
from support.simulated_time import SimulatedClock

from proprio_ros.bus.control_table import XM430_W350, HardwareError
from proprio_ros.bus.driver import LOST_AFTER_S, ArmDriver, DriverSettings
from proprio_ros.bus.dynamixel import DynamixelBus, servos_of
from proprio_ros.bus.state import ArmSample, BusState
from proprio_ros.clock import Pacer
from proprio_ros.robot import load_robot
from proprio_ros.robot.kinematics import clearance
from proprio_ros.virtual.robot import VirtualRobot
from proprio_ros.virtual.truth import Truth

CYCLE_S = 0.01
UNIT_A = XM430_W350.current_unit_A
PUSH_A = -0.29  # joint3, lifts the forearm
# no multiple of the position gain, so holding at rest never needs just that
QUANTISED_A = -108 * UNIT_A
SETTINGS = DriverSettings(reconnect_s=0.05)


class Rig:
    """A virtual robot with a driver, and a note of the currents that flow."""

    def __init__(
        self,
        clock: SimulatedClock,
        folder: Path,
        settings: DriverSettings,
    ) -> None:
        self.clock = clock
        self.robot = load_robot("open_manipulator_x")
        self.virtual = VirtualRobot(
            self.robot, Truth.draw(self.robot, 1), link=folder / "arm", seed=1
        )
        self.flow: list[tuple[float, np.ndarray]] = []  # time, current of each servo [A]
        step = self.virtual.arm.step

        def noted(current: np.ndarray) -> None:
            self.flow.append((float(self.virtual._time_s or 0.0), np.array(current)))
            step(current)

        self.virtual.arm.step = noted  # type: ignore[method-assign]
        self.log: list[tuple[str, str]] = []
        self.driver = self.new_driver(settings)
        self.pacer = Pacer(CYCLE_S)

    def new_driver(self, settings: DriverSettings) -> ArmDriver:
        name = str(self.virtual.port.path)
        bus = DynamixelBus(
            name,
            servos_of(self.robot),
            connect=partial(Wire, self.clock, name),
        )
        return ArmDriver(
            self.robot,
            bus,
            settings,
            lambda severity, message: self.log.append((severity, message)),
        )

    def close(self) -> None:
        self.driver.close()
        self.virtual.close()

    def cycle(self) -> ArmSample | None:
        self.pacer.wait()
        return self.driver.cycle()

    def run(
        self,
        duration_s: float,
        currents: dict[str, float] | None = None,
    ) -> list[ArmSample]:
        """Cycles, with this command before each of them."""
        samples = []
        end_s = self.clock.now() + duration_s
        while self.clock.now() < end_s:
            if currents is not None:
                self.driver.command_currents(currents)
            sample = self.cycle()
            if sample is not None:
                samples.append(sample)
        return samples

    def until(
        self,
        done: Callable[[], bool],
        limit_s: float = 30.0,
    ) -> None:
        """Cycles until something is true."""
        end_s = self.clock.now() + limit_s
        while not done():
            assert self.clock.now() < end_s, (
                f"did not come true in {limit_s} s; {self.driver.state}, {self.log[-3:]}"
            )
            self.cycle()

    def currents(
        self,
        joint: str,
        start_s: float,
        end_s: float = math.inf,
    ) -> np.ndarray:
        """What flowed through a joint's motor, per millisecond [A]."""
        row = list(self.virtual.servos).index(joint)
        with self.virtual.port.lock:
            return np.array(
                [current[row] for at_s, current in self.flow if start_s <= at_s <= end_s]
            )

    def pushed(self, start_s: float) -> float:
        """Part of the time with exactly the current of the push; a holding servo passes through it for a millisecond."""
        return float(
            np.mean(
                np.isclose(
                    self.currents("joint3", start_s),
                    QUANTISED_A,
                    atol=1e-9,
                )
            )
        )

    def all_zero(self, start_s: float, duration_s: float = 0.1) -> bool:
        """Not for long: a limp arm soon falls faster than 4.8 rad/s, where back-EMF beats the supply and current flows again."""
        with self.virtual.port.lock:
            seen = [
                current for at_s, current in self.flow if start_s <= at_s <= start_s + duration_s
            ]
        assert len(seen) > 10
        return not np.any(seen)

    def zero(self, joint: str, start_s: float) -> bool:
        """Whether no current flows in one motor, for a tenth of a second."""
        seen = self.currents(joint, start_s, start_s + 0.1)
        assert len(seen) > 10
        return not np.any(seen)

    def position(self) -> dict[str, float]:
        with self.virtual.port.lock:
            return dict(self.virtual.arm.position())

    def said(self, words: str) -> bool:
        return any(words in message for _, message in self.log)


@pytest.fixture
def settings() -> DriverSettings:
    return SETTINGS


@pytest.fixture
def rig(
    clock: SimulatedClock,
    tmp_path: Path,
    settings: DriverSettings,
) -> Iterator[Rig]:
    """Connected, held and settled."""
    rig = Rig(clock, tmp_path, settings)
    try:
        rig.until(lambda: rig.driver.state is BusState.RUNNING)
        rig.run(0.1)
        yield rig
    finally:
        rig.close()


def with_settings(**changes: Any) -> pytest.MarkDecorator:
    return pytest.mark.parametrize(
        "settings", [DriverSettings(**{"reconnect_s": 0.05, **changes})], ids=[""]
    )


# --- holding and driving


def test_it_holds_where_it_is(clock: SimulatedClock, tmp_path: Path) -> None:
    rig = Rig(clock, tmp_path, SETTINGS)
    try:
        assert rig.driver.state is BusState.DISCONNECTED
        assert rig.driver.command_currents({"joint3": 0.1}).startswith("the arm is disconnected")
        start = rig.position()
        samples = rig.run(0.5)
        assert rig.driver.state is BusState.RUNNING
        assert set(rig.driver.modes.values()) == {"held"}
        for name, position in rig.position().items():
            assert abs(position - start[name]) < 0.05
            assert samples[-1].position[name] == pytest.approx(position, abs=0.03)
        assert set(samples[-1].commanded_A.values()) == {0.0}
        assert {servo["bus_watchdog"] for servo in rig.virtual.servos.values()} == {100}, "2 s"
        assert set(rig.driver.health) == set(rig.driver.joints), (
            "temperatures are known before the first push"
        )
        assert rig.driver.statistics.incomplete == 0
    finally:
        rig.close()


def test_a_command_drives_with_the_quantised_current_until_its_deadline(rig: Rig) -> None:
    held = rig.position()
    start_s = rig.clock.now()
    samples = rig.run(0.25, {"joint3": PUSH_A})
    last_s = rig.clock.now() - CYCLE_S
    assert samples[-1].commanded_A["joint3"] == pytest.approx(QUANTISED_A)
    assert samples[-1].commanded_A["joint2"] == 0.0
    assert rig.driver.modes["joint3"] == "driven"
    assert rig.driver.modes["joint2"] == "held"
    rig.run(0.3)
    driven = rig.currents("joint3", start_s + 0.04, last_s)
    assert len(driven) > 150 and np.allclose(driven, QUANTISED_A, atol=1e-9), "every millisecond"
    deadline_s = last_s + rig.driver.settings.command_timeout_s
    after = rig.currents(
        "joint3", deadline_s + 2 * CYCLE_S + 0.015, deadline_s + 2 * CYCLE_S + 0.065
    )
    assert np.mean(np.isclose(after, QUANTISED_A, atol=1e-9)) < 0.3, (
        "it had ended by the deadline and two cycles"
    )
    assert rig.driver.modes["joint3"] == "held"
    assert rig.said("joint3: no current command for 100 ms")
    here = rig.position()
    rig.run(0.1)
    assert abs(rig.position()["joint3"] - here["joint3"]) < 0.02, "held again"
    assert abs(here["joint2"] - held["joint2"]) < 0.05


@with_settings(on_timeout="zero")
def test_zero_after_the_deadline(rig: Rig) -> None:
    rig.run(0.1, {"joint4": 0.1})
    rig.run(0.2)
    assert rig.driver.modes["joint4"] == "free"
    start_s = rig.clock.now()
    rig.run(0.1)
    assert not np.any(rig.currents("joint4", start_s))
    assert np.any(rig.currents("joint2", start_s)), "the others are held"
    assert rig.driver.command_positions({"joint4": 0.4}) == ""
    rig.run(0.05)
    assert rig.driver.modes["joint4"] == "held"


def test_a_joint_that_is_no_longer_commanded_is_held_at_once(rig: Rig) -> None:
    rig.run(0.05, {"joint3": PUSH_A, "joint4": -0.05})
    rig.run(0.03, {"joint4": -0.05})
    assert rig.driver.modes["joint3"] == "held"
    assert rig.driver.modes["joint4"] == "driven"
    assert not rig.said("no current command")


def test_refused_currents(rig: Rig) -> None:
    refused: list[tuple[dict[str, float], str]] = [
        ({"elbow": 0.1}, "there is no joint 'elbow'; joints: joint1, joint2"),
        ({"joint3": math.nan}, "joint3: the current is nan"),
        ({"joint3": math.inf}, "joint3: the current is inf"),
        (
            {"joint3": -300.0},
            "joint3: -300 A is more than its limit of 1 A (currents are in A, not mA)",
        ),
        (
            {"joint3": 0.1, "gripper_left_joint": 0.7},
            "gripper_left_joint: 0.7 A is more than its limit of 0.6 A",
        ),
    ]
    for count, (currents, reason) in enumerate(refused, start=1):
        assert rig.driver.command_currents(currents).startswith(reason)
        assert rig.driver.statistics.refused_commands == count
        rig.run(0.03)
        assert set(rig.driver.modes.values()) == {"held"}, "the whole command is refused"


def test_a_position_is_followed_no_faster_than_allowed(rig: Rig) -> None:
    start = rig.position()["joint1"]
    assert rig.driver.command_positions({"joint1": start + 0.75}) == ""
    # 0.75 rad at 2.5 rad/s are 0.3 s
    samples = rig.run(0.8)
    velocity = [sample.velocity["joint1"] for sample in samples]
    assert max(velocity) < 2.5 * 1.5, "the servo lags and catches up a little"
    path = np.array([(sample.sampled_at_s, sample.position["joint1"]) for sample in samples])
    halfway = (
        np.interp(
            path[0, 0] + 0.15,
            path[:, 0],
            path[:, 1],
        )
        - start
    )
    assert halfway < 0.15 * 2.5 + 0.03
    assert path[-1, 1] - start == pytest.approx(0.75, abs=0.03)


def test_refused_positions(rig: Rig) -> None:
    refused: list[tuple[dict[str, float], str]] = [
        ({"joint3": 1.5}, "joint3: 1.5 is outside its range -1.5 to 1.4"),
        ({"joint3": math.nan}, "joint3: the position is nan"),
        ({"gripper_left_joint": 0.5}, "gripper_left_joint: 0.5 is outside its range"),
        ({"elbow": 0.0}, "there is no joint 'elbow'"),
    ]
    before = rig.position()["joint1"]
    for positions, reason in refused:
        assert rig.driver.command_positions({"joint1": 0.5, **positions}).startswith(reason)
        rig.run(0.03)
    assert rig.position()["joint1"] == pytest.approx(before, abs=0.01), (
        "the whole command is refused"
    )


# --- one at a time, and no zero from nobody


def test_a_zero_from_nobody_drops_nothing(rig: Rig) -> None:
    """Five zeros by mistake used to mean: drive all joints with 0 A, and the arm fell."""
    start = rig.position()
    rig.run(
        0.7,
        dict.fromkeys(rig.driver.joints, 0.0),
    )
    assert set(rig.driver.modes.values()) == {"held"}
    for name, position in rig.position().items():
        assert position == pytest.approx(start[name], abs=0.02)
    # nor does it keep the arm from moving
    assert rig.driver.command_positions({"joint1": start["joint1"] + 0.2}) == ""
    rig.run(
        0.4,
        dict.fromkeys(rig.driver.joints, 0.0),
    )
    assert rig.position()["joint1"] == pytest.approx(start["joint1"] + 0.2, abs=0.03)


def test_a_zero_after_a_push_is_driven(rig: Rig) -> None:
    rig.run(0.05, {"joint4": -0.05})
    zero_s = rig.clock.now()
    samples = rig.run(0.08, {"joint4": 0.0, "joint3": 0.0})
    assert rig.driver.modes["joint4"] == "driven"
    assert samples[-1].commanded_A["joint4"] == 0.0
    assert rig.driver.modes["joint3"] == "held"
    assert not np.any(rig.currents("joint4", zero_s + 2 * CYCLE_S + 0.015))
    assert rig.driver.limp
    rig.driver.command_currents({})
    rig.cycle()
    assert not rig.driver.limp
    assert rig.driver.modes["joint4"] == "held"


def test_a_joint_is_without_torque_while_it_swings_and_all_are_when_torque_is_off(rig: Rig) -> None:
    rig.cycle()
    assert not rig.driver.limp
    rig.run(0.05, {"joint4": -0.01})
    assert rig.driver.modes["joint4"] == "driven"
    assert not rig.driver.limp
    rig.run(0.05, {"joint4": 0.0})
    assert rig.driver.limp
    rig.run(rig.driver.settings.command_timeout_s + 0.05)
    assert not rig.driver.limp, "held, since no command comes"
    rig.driver.stop()
    rig.cycle()
    assert rig.driver.limp
    rig.driver.set_torque(True)
    rig.until(lambda: not rig.driver.limp)
    rig.driver.set_torque(False)
    rig.until(lambda: rig.driver.limp)


def test_one_sender_drives_until_it_ends(rig: Rig) -> None:
    driver = rig.driver
    assert driver.command_currents({"joint3": PUSH_A}, sender=1) == ""
    rig.cycle()
    for stranger in ({"joint3": 0.0}, {"joint4": -0.05}, dict.fromkeys(driver.joints, 0.0), {}):
        assert driver.command_currents(stranger, sender=2).startswith(
            "joint3: driven by another publisher"
        )
    rig.cycle()
    assert driver.modes["joint3"] == "driven"
    assert driver.modes["joint4"] == "held"
    # zero by the one who drives keeps the lease, nothing at all ends it
    assert driver.command_currents({"joint3": 0.0}, sender=1) == ""
    assert "another publisher" in driver.command_currents({"joint4": -0.05}, sender=2)
    assert driver.command_currents({}, sender=1) == ""
    assert driver.command_currents({"joint4": -0.05}, sender=2) == ""
    rig.run(0.03)
    assert driver.modes["joint3"] == "held"
    assert driver.modes["joint4"] == "driven"


def test_what_was_sent_before_torque_came_on_is_refused(rig: Rig) -> None:
    here = rig.position()["joint1"]
    rig.driver.set_torque(False)
    rig.run(0.2)
    rig.driver.set_torque(True)
    rig.run(0.1)
    late = "it came 0.30 s late, and the arm has been held anew"
    assert rig.driver.command_positions({"joint1": here + 0.5}, late_s=0.3).startswith(late)
    assert rig.driver.command_currents({"joint3": PUSH_A}, late_s=0.3).startswith(late)
    rig.run(0.3)
    assert set(rig.driver.modes.values()) == {"held"}
    assert rig.position()["joint1"] == pytest.approx(here, abs=0.05)
    assert rig.driver.command_positions({"joint1": here + 0.5}, late_s=0.3) == "", "sent since"


def test_what_was_sent_before_a_push_ended_is_refused(rig: Rig) -> None:
    assert rig.driver.command_currents({"joint3": PUSH_A}, sender=1) == ""
    rig.run(0.05)
    assert rig.driver.command_currents({}, sender=1) == ""
    assert rig.driver.command_positions({"joint1": rig.position()["joint1"]}, sender=1) == "", (
        "sent together"
    )
    rig.run(0.05)
    for sender in (1, 2):
        assert rig.driver.command_currents({"joint3": PUSH_A}, sender, late_s=0.1).endswith(
            "since it was sent"
        )
    # and so it is where nobody ended it, but nothing came any more
    assert rig.driver.command_currents({"joint3": PUSH_A}, sender=1) == ""
    rig.run(rig.driver.settings.command_timeout_s + 0.05)
    assert rig.driver.command_currents({"joint3": PUSH_A}, sender=1, late_s=0.2).endswith(
        "since it was sent"
    )
    assert rig.driver.modes["joint3"] == "held"


def test_a_sender_that_falls_silent_drives_no_longer(rig: Rig) -> None:
    assert rig.driver.command_currents({"joint3": PUSH_A}, sender=1) == ""
    rig.run(rig.driver.settings.command_timeout_s + 0.05)
    assert rig.driver.modes["joint3"] == "held"
    assert rig.driver.command_currents({"joint4": -0.05}, sender=2) == ""


def test_one_sender_moves_the_arm(rig: Rig) -> None:
    here = rig.position()["joint1"]
    assert rig.driver.command_positions({"joint1": here}, sender=1) == ""
    assert rig.driver.command_positions({"joint1": here + 0.1}, sender=2).startswith(
        "another publisher is moving"
    )
    assert rig.driver.command_positions({"joint1": here}, sender=1) == ""
    rig.run(rig.driver.settings.command_timeout_s + 0.02)
    assert rig.driver.command_positions({"joint1": here}, sender=2) == ""


def test_told_to_hold_in_mid_push(rig: Rig) -> None:
    rig.run(0.05, {"joint3": PUSH_A})
    rig.driver.hold()
    told_s = rig.clock.now()
    rig.run(0.1)
    assert set(rig.driver.modes.values()) == {"held"}
    assert rig.driver.state is BusState.RUNNING
    assert rig.pushed(told_s + 2 * CYCLE_S + 0.015) < 0.3
    assert not rig.said("no current command")


# --- the table

LOW = {"joint2": 1.2, "joint3": 0.0, "joint4": 0.3}
"""The forearm points down through the table [rad]."""


def test_a_position_below_the_table_is_refused(rig: Rig) -> None:
    assert (
        clearance(rig.robot, {**dict.fromkeys(rig.robot.model.independent_joints, 0.0), **LOW})
        < -0.05
    )
    reason = rig.driver.command_positions(LOW)
    assert reason.startswith(
        "the arm would be less than 0 cm above the base's plane (min_clearance)"
    )
    rig.run(0.1)
    assert set(rig.driver.modes.values()) == {"held"}


def test_the_way_does_not_lead_through_the_table(rig: Rig) -> None:
    """Both ends are high enough, but one joint arrives before the other."""
    before = {
        "joint2": -0.23,
        "joint3": 1.09,
        "joint4": -1.09,
    }
    after = {"joint2": 1.22, "joint3": -1.17, "joint4": 0.13}
    assert rig.driver.command_positions(before) == ""
    rig.run(1.2)
    assert rig.driver.command_positions(after) == ""
    lowest = math.inf
    for _ in range(150):
        rig.cycle()
        lowest = min(
            lowest,
            clearance(rig.robot, rig.position()),
        )
    assert lowest > -0.01
    assert sum("too near to the base's plane" in message for _, message in rig.log) == 1


CAUGHT = {"joint2": 1.26, "joint3": 0.94, "joint4": 0.0}
"""An arm that fell and was caught too low, with the forearm leaning back: leaning less lowers the hand by a millimetre at first."""


def caught(rig: Rig) -> None:
    """Put the arm there, and hold it."""
    rig.driver.set_torque(False)
    rig.run(0.05)
    with rig.virtual.port.lock:
        here = rig.virtual.arm.position()
        rig.virtual.arm.set_position({**here, **CAUGHT})
    rig.driver.set_torque(True)
    rig.run(0.5)
    assert set(rig.driver.modes.values()) == {"held"}
    assert clearance(rig.robot, rig.position()) < -0.1


def test_an_arm_that_was_caught_too_low_gets_up(rig: Rig) -> None:
    """It was refused the first millimetre of its way, and stayed where it was for good."""
    caught(rig)
    way = np.arange(rig.position()["joint2"], -0.2, -0.015)
    for place in way:
        assert rig.driver.command_positions({"joint2": place}) == ""
        rig.cycle()
    rig.run(0.5)
    assert rig.position()["joint2"] == pytest.approx(-0.2, abs=0.05)
    assert clearance(rig.robot, rig.position()) > 0.02


def test_an_arm_that_is_too_low_is_lowered_no_further_however_often_it_is_asked(rig: Rig) -> None:
    caught(rig)
    before = clearance(rig.robot, rig.position())
    for _ in range(400):
        here = rig.position()["joint3"]
        rig.driver.command_positions({"joint3": here - 0.004})
        rig.cycle()
    assert clearance(rig.robot, rig.position()) > before - 0.01


@with_settings(min_clearance_m=0.15)
def test_a_push_ends_above_the_table(rig: Rig) -> None:
    start_s = rig.clock.now()
    samples = rig.run(0.6, {"joint3": 0.15})
    assert rig.said("joint3 was about to bring the arm too near to the base's plane")
    assert rig.driver.modes["joint3"] == "held"
    assert np.any(
        np.isclose(
            rig.currents("joint3", start_s),
            56 * UNIT_A,
            atol=1e-9,
        )
    ), "it did push"
    assert min(clearance(rig.robot, sample.position) for sample in samples) > 0.13
    rig.run(0.15)
    rig.run(0.03, {"joint3": PUSH_A})
    assert rig.driver.modes["joint3"] == "driven", "up again"


# --- limits and faults


@with_settings(limit_margin_rad=1.0)
def test_a_joint_at_its_limit_is_not_driven_further(rig: Rig) -> None:
    """The margin is so wide that joint3, parked at 0.6 of 1.4, is in it."""
    start_s = rig.clock.now()
    rig.run(0.1, {"joint3": 0.2})
    assert rig.driver.modes["joint3"] == "held"
    assert rig.said("joint3 is at its upper limit; held")
    assert sum("upper limit" in message for _, message in rig.log) == 1, (
        "said once, not in every cycle"
    )
    assert not np.any(
        np.isclose(
            rig.currents("joint3", start_s),
            74 * UNIT_A,
            atol=1e-9,
        )
    )
    rig.run(0.15)
    rig.run(0.05, {"joint3": PUSH_A})
    assert rig.driver.modes["joint3"] == "driven", "away from it"


@with_settings(max_velocity_rad_s=0.5)
def test_a_joint_that_is_too_fast_is_braked(rig: Rig) -> None:
    samples = rig.run(0.3, {"joint4": -0.3})
    assert rig.said("joint4 turns at")
    assert rig.said("faster than 0.5; held")
    assert rig.driver.modes["joint4"] == "held", "and stays so while the commands go on"
    assert abs(samples[-1].velocity["joint4"]) < 0.2
    rig.run(0.15)
    rig.run(0.03, {"joint4": 0.05})
    assert rig.driver.modes["joint4"] == "driven", "after a pause it may again"


def test_an_encoder_jump_holds_everything(rig: Rig) -> None:
    rig.run(0.1, {"joint3": PUSH_A})
    before = rig.position()
    rig.virtual.set_fault("jump=joint2")
    rig.run(0.1, {"joint3": PUSH_A})
    assert rig.said("joint2: its encoder jumped from")
    assert set(rig.driver.modes.values()) == {"held"}, "although the commands go on"
    rig.run(0.3)
    assert abs(rig.position()["joint2"] - before["joint2"]) < 0.2, (
        "it does not swing back by the 0.6 rad of the jump"
    )
    rig.driver.set_torque(True)
    rig.run(0.05, {"joint3": PUSH_A})
    assert rig.driver.modes["joint3"] == "driven"


def test_an_encoder_that_jumped_ends_the_way_until_a_person_has_looked(rig: Rig) -> None:
    """Whatever is commanded afterwards means another pose than its sender knows, and what is weighed there would be wrong."""
    goal = {"joint2": rig.position()["joint2"] - 0.1}
    assert rig.driver.command_positions(goal) == ""
    rig.virtual.set_fault("jump=joint2")
    rig.cycle()
    there = rig.position()["joint2"]
    for refused in (
        rig.driver.command_positions(goal),
        rig.driver.command_currents({"joint3": PUSH_A}),
    ):
        assert "joint2: its encoder jumped from" in refused
        assert "~/torque true" in refused
    rig.run(0.5)
    assert abs(rig.position()["joint2"] - there) < 0.02
    rig.driver.set_torque(True)
    rig.cycle()
    assert rig.driver.command_positions({"joint2": there}) == ""


def test_a_servo_that_overheats(rig: Rig) -> None:
    rig.run(0.05, {"joint3": PUSH_A})
    rig.virtual.set_fault("overheat=joint3")
    rig.run(0.1, {"joint3": PUSH_A})
    assert rig.said("joint3: its servo reports a fault and has switched itself off")
    assert rig.driver.modes["joint3"] == "held"
    assert rig.virtual.servos["joint3"]["torque_enable"] == 0
    rig.run(0.05)
    assert rig.driver.health["joint3"].faults == ("overheated: let it cool down",)
    assert "joint3: too hot to be driven" in rig.driver.command_currents({"joint3": 0.1})
    assert rig.driver.command_currents({"joint4": 0.0}) == ""
    rig.virtual.set_fault("")
    rig.driver.set_torque(True)
    rig.until(lambda: rig.driver.health["joint3"].temperature_C < 50.0)
    assert rig.virtual.servos["joint3"]["torque_enable"] == 1
    assert rig.driver.health["joint3"].faults == ()
    assert rig.driver.command_currents({"joint3": 0.1}) == ""


def test_a_hot_servo_is_not_driven(rig: Rig) -> None:
    with rig.virtual.port.lock:
        rig.virtual.servos["joint3"].temperature_C = 75.0  # its own limit is 80
    rig.driver.set_torque(True)
    rig.cycle()
    assert (
        rig.driver.command_currents({"joint3": 0.1})
        == "joint3: too hot to be driven (75 C): let it cool down"
    )


def test_another_fault_than_heat(rig: Rig) -> None:
    with rig.virtual.port.lock:
        rig.virtual.servos["joint4"].fail(HardwareError.OVERLOAD)
    rig.run(0.1)
    assert "joint4: its servo reports a fault (overload" in rig.driver.command_currents(
        {"joint4": 0.05}
    )
    assert "joint4: its servo reports a fault (overload" in rig.driver.command_currents(
        {"joint3": 0.05}
    ), "it holds nothing"
    assert rig.driver.command_currents({"joint3": 0.0}) == ""
    rig.driver.set_torque(True)
    rig.cycle()
    assert rig.driver.command_currents({"joint3": 0.05}) == "", "it has been rebooted"


# --- stop and torque


def test_stop_ends_every_current(rig: Rig) -> None:
    rig.run(0.1, {"joint3": PUSH_A})
    rig.driver.stop()
    stopped_s = rig.clock.now()
    rig.run(0.3, {"joint3": PUSH_A})
    assert rig.driver.state is BusState.STOPPED
    assert rig.all_zero(stopped_s + 2 * CYCLE_S + 0.01)
    assert rig.driver.command_currents({"joint3": 0.1}).startswith("the arm is stopped")
    assert rig.driver.command_positions({"joint3": 0.1}).startswith("the arm is stopped")
    rig.driver.set_torque(True)
    rig.run(0.1)
    assert rig.driver.state.value == "running"
    assert set(rig.driver.modes.values()) == {"held"}
    assert rig.driver.command_currents({"joint3": PUSH_A}) == ""


def test_a_stop_wins_over_an_earlier_torque_on(rig: Rig) -> None:
    rig.driver.set_torque(False)
    rig.run(0.05)
    rig.driver.set_torque(True)
    rig.driver.stop()
    rig.run(0.05)
    assert rig.driver.state is BusState.RELEASED


def test_a_stop_while_torque_is_being_switched_on(rig: Rig) -> None:
    """Switching on takes many exchanges; what is asked for meanwhile must not be forgotten."""
    prepare = rig.driver.bus.prepare

    def interrupted(**arguments: Any) -> None:
        prepare(**arguments)
        rig.driver.stop()

    rig.driver.bus.prepare = interrupted  # type: ignore[method-assign]
    rig.driver.set_torque(True)
    rig.until(lambda: rig.driver.state is BusState.STOPPED)
    rig.run(0.05)
    assert rig.driver.state is BusState.STOPPED


def test_torque_off(rig: Rig) -> None:
    rig.driver.set_torque(False)
    rig.cycle()
    off_s = rig.clock.now()
    samples = rig.run(0.15)
    assert rig.driver.state is BusState.RELEASED
    assert {servo["torque_enable"] for servo in rig.virtual.servos.values()} == {0}
    assert rig.all_zero(off_s)
    assert len(samples) > 5, "it is read on"


def test_holding_anew_does_not_sag(rig: Rig) -> None:
    """A held joint hangs a little below its goal; taking that for the new goal, time after time, would lower the arm."""
    rig.run(0.1)
    before = rig.position()
    for _ in range(4):
        rig.driver.set_torque(True)
        rig.run(0.08)
    for name, position in rig.position().items():
        assert position == pytest.approx(before[name], abs=0.02)


# --- a bus that fails


def test_unplugged_while_it_pushes(rig: Rig) -> None:
    rig.run(0.1, {"joint3": PUSH_A})
    rig.virtual.set_fault("unplug")
    unplugged_s = rig.clock.now()
    rig.run(0.5, {"joint3": PUSH_A})
    assert rig.driver.state is BusState.DISCONNECTED
    assert set(rig.driver.modes.values()) == {"held"}
    assert rig.zero("joint3", unplugged_s + rig.driver.settings.watchdog_s + 0.02), (
        "its servo's own watchdog"
    )
    assert np.any(rig.currents("joint2", unplugged_s + 0.4)), "what is held waits longer"
    assert np.any(rig.currents("joint3", unplugged_s, unplugged_s + 0.1))
    assert sum("trying again" in message for _, message in rig.log) <= 2, "not in every attempt"
    rig.virtual.set_fault("")
    rig.until(lambda: rig.driver.state.value == "running")
    plugged_s = rig.clock.now()
    rig.run(0.3)
    assert set(rig.driver.modes.values()) == {"held"}
    assert rig.pushed(plugged_s) < 0.3, "no push goes on"
    assert rig.driver.statistics.reconnects == 1


@pytest.mark.parametrize("limp", ["stop", "release"])
def test_what_was_limp_stays_limp_after_a_lost_bus(rig: Rig, limp: str) -> None:
    if limp == "stop":
        rig.driver.stop()
    else:
        rig.driver.set_torque(False)
    rig.run(0.05)
    limp_s = rig.clock.now()
    rig.virtual.set_fault("unplug")
    rig.until(lambda: rig.driver.state is BusState.DISCONNECTED)
    rig.virtual.set_fault("")
    rig.until(lambda: rig.driver.state is not BusState.DISCONNECTED)
    back_s = rig.clock.now()
    rig.run(0.1)
    assert rig.driver.state is BusState.RELEASED
    assert rig.all_zero(back_s)
    if limp == "release":
        assert rig.all_zero(limp_s, back_s - limp_s), "not even while the bus is found again"
    rig.driver.set_torque(True)
    rig.run(0.05)
    assert rig.driver.state.value == "running"


def test_a_dead_bus_is_lost_after_a_while(rig: Rig) -> None:
    rig.virtual.set_fault("hang=joint1")
    started = rig.clock.now()
    rig.until(lambda: rig.driver.state is BusState.DISCONNECTED)
    assert rig.clock.now() - started > 0.9 * LOST_AFTER_S
    rig.run(0.3)
    assert "no servo 11 (joint1)" in rig.driver.reason
    rig.virtual.set_fault("")
    rig.until(lambda: rig.driver.state.value == "running")


def test_the_process_dies_while_it_pushes(rig: Rig) -> None:
    rig.run(0.1, {"joint3": PUSH_A})
    died_s = rig.clock.now()
    rig.clock.sleep(0.45)
    assert np.allclose(rig.currents("joint3", died_s, died_s + 0.15), QUANTISED_A, atol=1e-9)
    assert rig.zero("joint3", died_s + rig.driver.settings.watchdog_s + 0.02)
    rig.run(0.1)
    assert rig.driver.state is BusState.RUNNING
    assert set(rig.driver.modes.values()) == {"held"}
    assert rig.said("joint3: stopped by the watchdog, since the driver was not run for 0.4")
    assert {servo["bus_watchdog"] for servo in rig.virtual.servos.values()} == {100}, (
        "the servos are awake again"
    )


def test_a_process_that_dies_drops_the_arm_in_the_end(rig: Rig) -> None:
    died_s = rig.clock.now()
    rig.clock.sleep(2.3)
    assert rig.all_zero(died_s + rig.driver.settings.hold_watchdog_s + 0.02)


def test_a_cycle_that_stands_still_drops_nothing_that_is_held(rig: Rig) -> None:
    before = rig.position()
    for stall_s in (0.3, 0.5, 1.5):
        rig.clock.sleep(stall_s)
        begun_s = rig.clock.now()
        rig.run(0.1)
        assert np.any(rig.currents("joint2", begun_s - stall_s)), "it is held meanwhile"
        for name, position in rig.position().items():
            assert position == pytest.approx(before[name], abs=0.02)
    assert not rig.said("watchdog")


def test_an_arm_that_was_dropped_is_held_at_once(rig: Rig) -> None:
    rig.clock.sleep(rig.driver.settings.hold_watchdog_s + 0.05)
    begun_s = rig.clock.now()
    rig.run(0.15)
    assert rig.said("stopped by the watchdog, since the driver was not run for 2.0")
    assert np.any(rig.currents("joint2", begun_s + 0.1)), "not only when its turn comes"
    assert rig.driver.state is BusState.RUNNING


@pytest.mark.parametrize("pushes", [False, True], ids=["held", "pushed"])
def test_a_thread_that_is_not_run_while_it_asks_drops_nothing(rig: Rig, pushes: bool) -> None:
    """The worst moment: it has the lock that requests are made under."""
    if pushes:
        rig.run(0.1, {"joint3": PUSH_A})
    before = rig.position()
    begun_s = rig.clock.now()

    def ask() -> None:
        with rig.driver._lock:
            rig.clock.sleep(0.35)

    thread = rig.clock.thread(ask, "asks")
    thread.start()
    cycles = rig.driver.statistics.cycles
    rig.run(0.3)
    assert rig.driver.statistics.cycles - cycles >= 29, "no cycle waits for it"
    assert {servo["bus_watchdog"] for servo in rig.virtual.servos.values()} == {100}
    assert set(rig.driver.modes.values()) == {"held"}, "the deadline of a push counts all the same"
    assert np.any(rig.currents("joint2", begun_s))
    for name in ("joint1", "joint2", "joint4"):
        assert rig.position()[name] == pytest.approx(before[name], abs=0.05)
    rig.run(0.1)
    assert not thread.is_alive()
    assert rig.driver.command_positions({"joint4": 0.4}) == "", "and it is asked again"
    assert not rig.said("watchdog")


def test_a_push_begins_only_where_its_servo_would_soon_stop_without_us(rig: Rig) -> None:
    seen = []
    for _ in range(12):
        rig.run(CYCLE_S, {"joint3": PUSH_A})
        mode = rig.driver.modes["joint3"]
        seen.append((mode, rig.virtual.servos["joint3"]["bus_watchdog"]))
    assert seen[0] == ("held", 15)
    assert set(seen[2:]) == {("driven", 15)}
    assert rig.virtual.servos["joint2"]["bus_watchdog"] == 100
    rig.run(0.2)
    assert rig.virtual.servos["joint3"]["bus_watchdog"] == 100


@with_settings(reconnect_s=0.1)
def test_one_dead_servo_does_not_leave_another_pushing(rig: Rig) -> None:
    """Whoever looks for the dead one keeps the watchdogs of the others from ending a push."""
    rig.run(0.1, {"joint3": PUSH_A})
    rig.virtual.set_fault("hang=joint4")
    rig.until(lambda: rig.driver.state is BusState.DISCONNECTED)
    lost_s = rig.clock.now()
    rig.run(0.3, {"joint3": PUSH_A})
    assert rig.pushed(lost_s + 0.02) < 0.3
    assert np.any(rig.currents("joint2", lost_s))


def test_incomplete_rounds_are_asked_for_again(rig: Rig) -> None:
    rig.virtual.set_fault("corrupt=0.3")
    before = rig.driver.statistics.cycles
    untimely = rig.driver.statistics.untimely
    samples = rig.run(0.8, {"joint4": 0.0})
    statistics = rig.driver.statistics
    assert statistics.retries > 3
    assert 0 < statistics.incomplete < statistics.retries
    assert len(samples) == statistics.cycles - before - statistics.incomplete - (
        statistics.untimely - untimely
    )
    stamps = np.diff([sample.sampled_at_s for sample in samples])
    assert np.all(stamps > 0.0)
    position = np.array([sample.position["joint2"] for sample in samples])
    assert np.all(np.abs(position - position[0]) < 0.05), "no sample of a corrupted answer"


def test_lost_answers_are_no_pause_of_the_commands(rig: Rig) -> None:
    rig.virtual.set_fault("jump=joint2")
    rig.run(0.05, {"joint3": PUSH_A})
    rig.virtual.set_fault("jump=joint2,corrupt=0.6")
    blocked_s = rig.clock.now()
    rig.run(0.3, {"joint3": PUSH_A})
    assert rig.driver.statistics.incomplete > 0
    assert rig.pushed(blocked_s) < 0.3, "still blocked"


def test_a_sample_of_unknown_time_is_left_out_and_starts_no_push(rig: Rig) -> None:
    rig.run(0.3)
    before = rig.driver.statistics.untimely
    rig.virtual.set_fault("delay=0.008")
    assert rig.run(0.05, {"joint3": PUSH_A}) == []
    assert rig.driver.statistics.untimely > before
    assert rig.driver.modes["joint3"] == "held"
    rig.virtual.set_fault("")
    rig.run(0.05, {"joint3": PUSH_A})
    assert rig.driver.modes["joint3"] == "driven"
    rig.virtual.set_fault("delay=0.008")
    rig.run(0.05, {"joint3": PUSH_A})
    assert rig.driver.modes["joint3"] == "driven", "but a push goes on"


def test_a_warning_that_is_repeated_is_said_once_in_a_while(rig: Rig) -> None:
    for turn in range(300):
        rig.driver._log("warning", f"joint3 turns at {turn / 10:.1f} rad/s")
        rig.driver._log("error", f"{turn}: lost")
        rig.clock.sleep(0.01)
    warned = [words for severity, words in rig.log if severity == "warning"]
    assert warned == ["joint3 turns at 0.0 rad/s", "joint3 turns at 20.0 rad/s"]
    assert sum(words.endswith("lost") for _, words in rig.log) == 300


def test_a_missing_servo_is_said_once(clock: SimulatedClock, tmp_path: Path) -> None:
    rig = Rig(clock, tmp_path, SETTINGS)
    try:
        rig.virtual.set_fault("hang=joint4")
        rig.run(0.6)
        assert rig.driver.state is BusState.DISCONNECTED
        assert [message for _, message in rig.log if "no servo 14 (joint4)" in message] == [
            rig.log[0][1]
        ]
        assert rig.log[0][1].endswith("trying again every 0.05 s")
    finally:
        rig.close()


# --- the end


def test_close_releases(rig: Rig) -> None:
    rig.run(0.05, {"joint3": PUSH_A})
    rig.driver.close()
    closed_s = rig.clock.now()
    rig.clock.sleep(0.1)
    assert {servo["torque_enable"] for servo in rig.virtual.servos.values()} == {0}
    assert rig.all_zero(closed_s + 0.005)
    assert not rig.driver.bus.is_open
    assert rig.driver.state is BusState.DISCONNECTED


def test_close_that_holds(rig: Rig) -> None:
    rig.run(0.05, {"joint3": PUSH_A})
    rig.driver.close(hold=True)
    rig.clock.sleep(0.2)
    there = rig.position()
    rig.clock.sleep(0.3)  # longer than the watchdog
    for servo in rig.virtual.servos.values():
        assert (servo["torque_enable"], servo["bus_watchdog"]) == (1, 0)
    for name, position in rig.position().items():
        assert position == pytest.approx(there[name], abs=0.02)
