"""A driver that is not the package's, as far as it can be told from its topics: what a replay accepts is accepted live."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")
sys.path.insert(0, str(Path(__file__).parent))

from domains import free_domain
from live import UP_S, Client, wait_for
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from proprio_ros.bags import read_recording
from proprio_ros.nodes.graph import Graph
from proprio_ros.nodes.messages import joint_state
from proprio_ros.robot import load_robot

pytestmark = pytest.mark.long

BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)


class Bridge:
    """Between the package's driver, in a namespace of its own, and the topics of a driver that knows little.

    Positions best effort, velocities NaN, no applied effort, and wheels on the same topic.
    """

    def __init__(self, client: Client) -> None:
        node = client.node
        self.wheels = 0
        self._states = node.create_publisher(JointState, "/joint_states", BEST_EFFORT)
        self._other = node.create_publisher(JointState, "/joint_states", 10)
        node.create_subscription(JointState, "/hardware/joint_states", self._on_state, 100)
        self._node = node

    def obey(self) -> None:
        """Pass commands on to the driver."""
        for topic in ("current_command", "position_command"):
            onward = self._node.create_publisher(Float64MultiArray, f"/hardware/{topic}", 10)
            self._node.create_subscription(Float64MultiArray, f"/{topic}", onward.publish, 10)

    def _on_state(self, message: JointState) -> None:
        stamp_ns = 10**9 * message.header.stamp.sec + message.header.stamp.nanosec
        self._states.publish(joint_state(stamp_ns, message.name, message.position, [math.nan] * len(message.name)))
        self.wheels += 1
        self._other.publish(joint_state(stamp_ns + 3_000_000, ["wheel"], [0.1 * self.wheels], [math.nan]))


def test_an_arm_with_another_driver_is_probed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", free_domain())
    parameters: dict[str, Any] = {"data_directory": tmp_path / "data", "payload_sequence": "payload_elbow"}
    with Graph(tmp_path / "logs") as graph:
        graph.start("virtual", {"link": tmp_path / "bus", "seed": 1, "object": 0.15})
        graph.start("driver", {"port": tmp_path / "bus"}, namespace="hardware")
        graph.start("excitation", {})
        graph.start("identifier", parameters | {"calibration": "none", "report": False})
        client = Client()
        try:
            bridge = Bridge(client)

            def ready() -> bool:
                graph.check()
                return client.excitation.get("joint_states") == "true" and bool(client.statuses)

            assert wait_for(ready, UP_S), {name: graph.log(name) for name in graph.processes}
            answer = client.call("/identifier/calibrate_payload", 30.0)
            assert not answer.success and "nothing says what drives the joints" in answer.message, answer.message
            assert client.excitation["sequence"] == "0", "nothing was moved"
            bridge.obey()
            answer = client.call("/identifier/calibrate_payload", 120.0)
            assert "recording: " in answer.message and "aborted" not in answer.message, answer.message
            assert "published best effort" in graph.log("identifier") and "published best effort" in graph.log(
                "excitation"
            )
            live = [told for told in client.estimates if "samples" in told]
            assert live, "the estimate while the probe was under way takes the current command, too"
        finally:
            client.close()
    drives = load_robot("open_manipulator_x").drive_trains
    constants = {name: drive.nominal_effort_per_current for name, drive in drives.items()}
    bag = Path(answer.message.split("recording: ")[1])
    recording = read_recording(bag, nominal_torque_constants=constants, joint_order=list(constants))
    assert recording.inputs is not None and recording.inputs.source == "/current_command"
    assert abs(recording.inputs.current_A).max() > 0.05
    assert recording.joints.velocity is None
