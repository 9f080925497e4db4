"""Three commands from the URDF of a robot with two arms, wheels and a head, 25 joints in a message, to an answer that holds."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from support.two_arms import SIDES, TwoArms, write_urdf

from proprio_ros.cli import main

pytest.importorskip("mujoco")
HELD_KG = {"left": 0.7, "right": 0.35}
STOOD = {"torso_lift_joint": 0.1, "torso_pitch_joint": 0.2, "torso_yaw_joint": -0.3}
STANDS = {"torso_lift_joint": 0.3, "torso_pitch_joint": 0.35, "torso_yaw_joint": 0.3}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """URDF and recordings of either arm, empty and loaded; the torso was bent meanwhile."""
    folder = tmp_path_factory.mktemp("two_arms")
    write_urdf(folder)
    robot = TwoArms(1)
    for side in SIDES:
        robot.record(folder / f"{side}_empty", side, 0.0, STOOD)
        robot.record(folder / f"{side}_loaded", side, HELD_KG[side], STANDS)
    return folder


@pytest.mark.parametrize("side", SIDES)
def test_three_commands_weigh_what_either_hand_holds(
    recorded: Path, side: str, capsys: pytest.CaptureFixture[str]
) -> None:
    file = str(recorded / f"{side}.yaml")
    loaded = str(recorded / f"{side}_loaded")
    torque = ["--effort-unit", "N.m"]
    urdf = str(recorded / "two_arms.urdf")
    assert main(["robot", "new", urdf, "--tip", f"{side}_tool0", *torque, "--output", file]) == 0
    assert main(["check", loaded, "--robot", file, *torque]) == 0
    capsys.readouterr()
    empty = str(recorded / f"{side}_empty")
    words = ["replay", loaded, "--baseline", empty, "--probe", "payload", "--robot", file]
    assert main([*words, *torque, "--json"]) == 0
    mass = json.loads(capsys.readouterr().out)["estimates"][0]
    low, high = mass["ci95"]
    assert low < HELD_KG[side] < high and high - low < 0.5 * HELD_KG[side], mass
