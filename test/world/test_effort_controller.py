"""An arm behind what looks like `ros2_control`, calibrated and asked for a mass by services alone, without this package's driver.

How well it weighs five masses is for test/benchmarks/live.py; what becomes of the arm, for test_effort_output.py.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

from std_msgs.msg import Float64MultiArray
from support.simulated_live import running

from proprio_ros.recordings.signals import read_recording
from proprio_ros.robot import load_robot
from proprio_ros.virtual.effort_driver import FOREIGN_JOINTS

pytestmark = pytest.mark.long

TOPIC = "/forward_effort_controller/commands"
ORDER = ["joint3", "gripper_left_joint", "joint1", "joint4", "joint2"]
MASS_KG = 0.12
CONTROLLER: dict[str, Any] = {"controller_joints": ORDER, "effort_unit": "A"}


def test_an_arm_behind_an_effort_controller_weighs(tmp_path: Path) -> None:
    virtual = {
        "interface": "effort_controller",
        "object": str(MASS_KG),
        "state_rate": 250.0,
        **CONTROLLER,
    }
    stated = ["payload.com=[0,0,0]", "payload.shape=point"]
    facts = {
        "robot_sequence": "empty_hand_elbow", "payload_sequence": "payload_elbow",
        "reference_sequence": "reference_elbow", "reference_mass": 0.1, "reference_wait": 0.5, "settings": stated,
        "reference_settings": stated,
    }  # fmt: skip
    output = {"command_interface": "effort", **CONTROLLER}
    nodes = ("virtual", "excitation", "identifier")
    with running(
        tmp_path,
        *nodes,
        virtual=virtual,
        excitation=output,
        identifier=facts,
    ) as client:
        assert client.wait_for(lambda: bool(client.states))
        state = client.states[-1]
        assert list(state.name) == sorted(state.name)
        assert {*FOREIGN_JOINTS} < {*state.name}
        assert all(math.isnan(speed) for speed in state.velocity)
        client.hear_less()
        # somebody else at the controller
        other = client.node.create_publisher(Float64MultiArray, TOPIC, 10)
        assert "somebody else publishes" in client.call("/excitation/run").message
        client.node.destroy_publisher(other)

        answer = client.asked("/identifier/calibrate_robot")
        assert answer.success, (answer.message, client.log("excitation"))
        answer = client.asked("/identifier/calibrate_payload")
        assert answer.success, (answer.message, client.log("excitation"))
        assert client.wait_for(lambda: bool(client.masses) and client.final())
        low, high = json.loads(client.estimates[-1]["payload_mass.ci95"])
        assert abs(client.masses[-1] - MASS_KG) < min(0.003, high - low), answer.message
    bag = Path(answer.message.split("recording: ")[1])
    constants = {
        name: drive.nominal_effort_per_current
        for name, drive in load_robot("open_manipulator_x").drive_trains.items()
    }
    recording = read_recording(
        bag,
        nominal_torque_constants=constants,
        joint_order=list(constants),
    )
    assert recording.inputs is not None
    assert recording.inputs.source == "/applied_effort"
