"""The identifier node in the simulated world, with nobody beside it."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

from sensor_msgs.msg import JointState
from support.simulated_live import running

from proprio_ros.live.job import Job
from proprio_ros.nodes import messages
from proprio_ros.nodes.managed_node import IDLE_PAUSE_S


def test_an_idle_identifier_takes_what_waits_at_once(tmp_path: Path) -> None:
    """A wake-up for each of 250 joint states in a second costs a quarter of a core."""
    with running(tmp_path, "identifier") as client:
        node = client.world.processes["identifier"].node
        assert node.pause_s == IDLE_PAUSE_S
        publisher = client.node.create_publisher(JointState, "/joint_states", 100)
        stamps = set()
        for row in range(1, 51):
            publisher.publish(
                messages.joint_state(
                    10**9 * row,
                    ["joint1"],
                    [0.0],
                )
            )
            client.clock.sleep(0.001)
            stamps.add(node.inputs.stamp_ns)
        assert client.wait_for(lambda: node.inputs.stamp_ns == 50 * 10**9, 0.1)
        assert len(stamps) < 10
        node._job = Job("payload", "calibrate_payload")
        assert node.pause_s == 0.0
        node._job = None


def test_a_second_node_of_the_same_name_is_said_once(tmp_path: Path) -> None:
    with running(tmp_path, "identifier") as client:
        client.clock.sleep(60.0)
        assert "another node is called" not in client.log("identifier")
        client.world.start(
            "identifier",
            {"data_directory": tmp_path / "other"},
            called="second",
        )
        client.clock.sleep(60.0)
        said = [
            text for _, _, _, text in client.world.graph.log if "another node is called" in text
        ]
        assert len(said) == 2 and all(
            text.startswith("another node is called /identifier: ") for text in said
        ), "a line of each"
