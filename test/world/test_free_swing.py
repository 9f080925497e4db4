"""A wrist that the excitation node lets go of, on servos that obey the real protocol, and the calibration that comes of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

from std_msgs.msg import Bool
from support.listening import HEARD
from support.simulated_live import running

from proprio_ros.calibration_files.pushes import Calibration
from proprio_ros.robot import load_robot
from proprio_ros.virtual.truth import Truth

WRIST = "joint4"
ROBOT = load_robot("open_manipulator_x")


@pytest.mark.long
def test_a_virtual_arm_is_calibrated_by_its_own_free_swings(tmp_path: Path) -> None:
    drawn = Truth.draw(ROBOT, 3)
    wrist = replace(drawn.joints[WRIST], coulomb=0.03)
    file = tmp_path / "truth.json"
    file.write_text(replace(drawn, joints={**drawn.joints, WRIST: wrist}).as_json())
    with running(
        tmp_path, virtual={"truth": str(file)}, identifier={"robot_sequence": "free_swing"}
    ) as client:
        said: list[bool] = []
        client.node.create_subscription(
            Bool, "/torque_enabled", lambda message: said.append(message.data), HEARD
        )
        answer = client.asked("/identifier/calibrate_robot")
        assert answer.success, answer.message
        assert "robot calibrated on 4 of 4 runs" in answer.message
        assert said[-8:] == [False, True] * 4
        # held when all is over, though a wrist that was let go of would hang at 1.2 rad
        assert client.wait_for(
            lambda: any(client.motors[-1].effort) and client.excitation["phase"] == "done"
        )
    (path,) = (tmp_path / "data").glob("*_robot/calibration.yaml")
    calibration = load_robot(path).calibration
    assert isinstance(calibration, Calibration)
    assert calibration.swing_error > 0.0
    for kind in ("coulomb", "armature"):
        found = calibration.quantities[kind, WRIST]
        assert (
            abs(found.value - getattr(wrist, kind))
            < 3.0 * found.std
            < 0.75 * getattr(ROBOT.drive_trains[WRIST], kind).std
        ), kind
