"""A virtual arm that has fallen is no dead end: its service does what a person beside a real one does."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

from std_srvs.srv import SetBool
from support.pushes import AWAY, one_push
from support.simulated_live import running
from support.simulated_world import World, world

from proprio_ros.virtual.robot import PARKED


@pytest.fixture
def made(tmp_path: Path) -> Iterator[World]:
    with world(tmp_path / "data", only=("virtual", "driver"), coarse=True) as made:
        made.clock.sleep(1.0)
        yield made


def off_rad(made: World) -> float:
    """How far the arm is from its first pose."""
    position, _ = made.arm.truth()
    return max(abs(position[name] - place) for name, place in PARKED.items())


def test_an_arm_that_has_fallen_is_held_in_its_first_pose(made: World) -> None:
    assert off_rad(made) < 0.05
    assert made.call("/driver/torque", SetBool, SetBool.Request(data=False)).success
    made.clock.sleep(2.0)
    assert off_rad(made) > 0.5, "it has fallen"
    answer = made.call("/virtual/recover")
    assert answer.success, answer.message
    assert answer.message == "the arm is held in its first pose"
    made.clock.sleep(2.0)
    assert off_rad(made) < 0.05
    assert made.processes["driver"].node._driver.state.value == "running"


def test_an_arm_that_stands_is_recovered_too(made: World) -> None:
    assert made.call("/virtual/recover").success
    made.clock.sleep(1.0)
    assert off_rad(made) < 0.05


def test_nobody_would_hold_it_without_a_driver(made: World) -> None:
    made.processes["driver"].kill()
    made.clock.sleep(1.0)
    answer = made.call("/virtual/recover")
    assert not answer.success
    assert "there is no driver" in answer.message


def test_an_arm_that_is_caught_in_mid_fall_moves_on(tmp_path: Path) -> None:
    """It did not follow: its driver refused the first millimetre of the way up."""
    push = tmp_path / "push.yaml"
    push.write_text(one_push(-0.28, 0.6, AWAY))
    with running(tmp_path, "virtual", "driver", "excitation", virtual={"object": 0.05}) as client:
        assert client.set("/excitation", "probe", str(push)).successful
        for falls_s in (0.3, 1.0, 0.0):
            client.excitation.clear()
            assert client.call("/excitation/run").success
            client.wait_for_phase("done")
            assert client.torque(False).success
            client.clock.sleep(falls_s)
            assert client.torque(True).success
            client.clock.sleep(1.0)
