"""Three commands from the URDF of a robot with two arms, wheels and a head, 25 joints in a message, to an answer that holds."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from support.two_arms import ARM, MIDDLE, SIDES, TORSO, TwoArms, write_urdf

from proprio_ros.cli import main
from proprio_ros.errors import RecordingError, RobotError
from proprio_ros.identification.regression.at_rest import check_carriers
from proprio_ros.identification.regression.online import OnlineEstimator
from proprio_ros.pipeline.loading import followed
from proprio_ros.pipeline.replay import replay
from proprio_ros.pipeline.request import Options
from proprio_ros.recordings.motions import Motion
from proprio_ros.robot import load_robot

pytest.importorskip("mujoco")
HELD_KG = {"left": 0.7, "right": 0.35}
CONSTANTS = {f"joints.left_{name}.motor.nominal_torque_constant_N_m_per_A": 1.0 for name in ARM}
STOOD = {"torso_lift_joint": 0.1, "torso_pitch_joint": 0.2, "torso_yaw_joint": -0.3}
SWINGS = {"torso_lift_joint": 0.05, "torso_pitch_joint": 0.1, "torso_yaw_joint": 0.2}
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
    capsys.readouterr()
    assert main(["check", loaded, "--robot", file, *torque, "--json"]) == 0
    seen = json.loads(capsys.readouterr().out)["bags"][0]
    compared = seen["effort_per_N_m"]
    assert compared and all(name.startswith(side) for name in compared), "a torso holds both arms"
    empty = str(recorded / f"{side}_empty")
    words = ["replay", loaded, "--baseline", empty, "--probe", "payload", "--robot", file]
    assert main([*words, *torque, "--json"]) == 0
    mass = json.loads(capsys.readouterr().out)["estimates"][0]
    low, high = mass["ci95"]
    assert low < HELD_KG[side] < high and high - low < 0.5 * HELD_KG[side], mass


def test_a_torso_that_moves_meanwhile_carries_the_arm(recorded: Path) -> None:
    """It was taken to stand in its middle, and what it did to the arm was explained by nothing."""
    TwoArms(2).record(recorded / "carried", "left", HELD_KG["left"], STANDS, SWINGS)
    TwoArms(2).record(recorded / "stood", "left", 0.0, STOOD)
    asked = Options(
        robot=str(recorded / "two_arms.urdf"),
        settings={"robot.tip": "left_tool0"},
        effort_unit="N.m",
        baseline=[recorded / "stood"],
    )
    answer = replay([recorded / "carried"], asked)
    mass = answer.values[0]
    assert answer.verdict.value == "accepted", answer.reasons
    assert mass.ci95[0] < HELD_KG["left"] < mass.ci95[1]
    assert any(
        "carried about by torso_lift_joint, torso_pitch_joint" in note for note in answer.notes
    )


def still(name: str, **beside: np.ndarray) -> Motion:
    """An arm that stands, and what moved beside it."""
    count = len(next(iter(beside.values())))
    table = np.tile(MIDDLE, (count, 1))
    held = {joint: float(at.mean()) for joint, at in beside.items()}
    joints = tuple(f"left_{joint}" for joint in ARM)
    times_s = np.linspace(0.0, 4.0, count)
    return Motion(name, joints, times_s, table, table, held, "measured current", beside=beside)


def test_an_arm_that_stands_is_not_weighed_on_a_torso_that_bends(recorded: Path) -> None:
    """Gravity pulls from elsewhere then; a torso that turns about the vertical, or is lifted, changes nothing."""
    robot = load_robot(recorded / "two_arms.urdf", {"tip": "left_tool0", **CONSTANTS})
    joints = [f"left_{joint}" for joint in ARM]
    rest = np.zeros(50)
    sweep = np.linspace(0.0, 0.3, 50)

    def torso(lift: np.ndarray, pitch: np.ndarray, yaw: np.ndarray) -> dict[str, np.ndarray]:
        return dict(zip(TORSO, (lift, pitch, yaw), strict=True))

    check_carriers(robot, [still("a", **torso(sweep, rest, sweep))], joints)
    with pytest.raises(RecordingError, match=r"leant over by 0\.3 rad"):
        check_carriers(robot, [still("a", **torso(rest, sweep, rest))], joints)
    bent = [still("a", **torso(rest, rest, rest)), still("b", **torso(rest, rest + 0.1, rest))]
    with pytest.raises(RecordingError, match="between which they moved apart"):
        check_carriers(robot, bent, joints)


def partly_stated(folder: Path, unstated: Sequence[str]) -> str:
    """A robot file that lacks the motors of some joints."""
    path = folder / f"without_{'_'.join(unstated)}.yaml"
    stated = "\n".join(
        f"  left_{joint}: {{motor: {{nominal_torque_constant_N_m_per_A: 1}}}}" for joint in ARM if joint not in unstated
    )  # fmt: skip
    path.write_text(
        f"name: without\nurdf: two_arms.urdf\ntip: left_tool0\npayload_frame: left_tool0\njoints:\n{stated}\n"
    )
    return str(path)


@pytest.mark.parametrize("unstated", [ARM[6:], ARM[3:4], (ARM[2], ARM[5])])
def test_joints_of_the_arm_without_a_motor_are_followed(
    recorded: Path, unstated: tuple[str, ...]
) -> None:
    """They were taken to stand in the middle of their way, then refused; the last one, one in mid-arm, and two."""
    asked = Options(
        robot=partly_stated(recorded, unstated),
        effort_unit="N.m",
        baseline=[recorded / "left_empty"],
    )
    answer = replay([recorded / "left_loaded"], asked)
    mass = answer.values[0]
    assert answer.verdict.value == "accepted", answer.reasons
    assert mass.ci95[0] < HELD_KG["left"] < mass.ci95[1]
    assert abs(mass.value - HELD_KG["left"]) < 0.02 * HELD_KG["left"], "all of it is explained"
    names = ", ".join(f"left_{joint}" for joint in unstated)
    assert any(f"of {names} between the motors and the hand" in note for note in answer.notes)


def test_a_calibration_knows_the_joints_that_were_followed(
    recorded: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its file is read again, weighs, and is refused where an effort of each joint is needed; check looks without a refusal."""
    robot = partly_stated(recorded, ARM[6:])
    output = recorded / "followed.yaml"
    unit = ["--effort-unit", "N.m"]
    words = ["calibrate", str(recorded / "left_empty"), "--robot", robot, *unit]
    assert main([*words, "--output", str(output)]) == 0
    assert main(["check", str(recorded / "left_loaded"), "--robot", robot, *unit]) == 0
    capsys.readouterr()
    asked = Options(calibration=str(output), effort_unit="N.m")
    mass = replay([recorded / "left_loaded"], asked).values[0]
    assert mass.ci95[0] < HELD_KG["left"] < mass.ci95[1]
    learnt = load_robot(output)
    assert learnt.only_read == (f"left_{ARM[6]}",) and learnt.motion_calibration is not None
    with pytest.raises(RobotError, match="left_arm_7_joint is only read"):
        OnlineEstimator(learnt, learnt.motion_calibration)


def test_a_joint_that_is_only_read_stands_elsewhere_in_another_recording(recorded: Path) -> None:
    """What it carries is then elsewhere, too: the same links were taken for one body."""
    robot = load_robot(partly_stated(recorded, ARM[3:4]))
    joints = tuple(f"left_{joint}" for joint in ARM if joint != ARM[3])
    rest = np.zeros((50, len(joints)))
    times_s = np.linspace(0.0, 4.0, 50)

    def stood(at: float | None) -> Motion:
        beside = {} if at is None else {f"left_{ARM[3]}": np.full(50, at)}
        return Motion("m", joints, times_s, rest, rest, {}, "measured current", beside=beside)

    assert followed(robot, [stood(0.5), stood(0.5)])[0] is robot
    learnt, motions = followed(robot, [stood(0.5), stood(0.8)])
    assert learnt.only_read == (f"left_{ARM[3]}",)
    assert all(f"left_{ARM[3]}" in motion.joints for motion in motions)
    with pytest.raises(
        RecordingError, match="the position of left_arm_4_joint, which moves the hand"
    ):
        followed(robot, [stood(0.5), stood(0.8), stood(None)])
