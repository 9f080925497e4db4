"""A driver that is not the package's, as far as it can be told from its topics: what a replay accepts is accepted live."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

from support.domains import free_domain
from support.live import Client, comes_up, wait_for
from support.pushes import AWAY, one_push

from proprio_ros.nodes.graph import Graph
from proprio_ros.nodes.messages import values_of
from proprio_ros.recordings.signals import read_recording
from proprio_ros.robot import load_robot

pytestmark = pytest.mark.long


@contextmanager
def bridge(*more: str) -> Iterator[None]:
    """The topics of another driver, by a process of their own."""
    script = Path(__file__).parents[1] / "support" / "bridge.py"
    process = subprocess.Popen([sys.executable, str(script), *more])
    try:
        yield
        assert process.poll() is None, "the bridge has ended"
    finally:
        process.kill()
        process.wait()


def test_an_arm_with_another_driver_is_probed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", free_domain())
    push = tmp_path / "push.yaml"
    push.write_text(one_push(-0.28, 0.6, AWAY))
    parameters: dict[str, Any] = {
        "data_directory": tmp_path / "data",
        "payload_sequence": str(push),
    }
    with Graph(tmp_path / "logs") as graph:
        graph.start(
            "virtual",
            {"link": tmp_path / "bus", "seed": 1, "object": 0.05},
        )
        graph.start(
            "driver",
            {"port": tmp_path / "bus", "reply_timeout": 0.1, "command_timeout": 0.5},
            namespace="hardware",
        )
        # nobody here may take a late message for silence
        graph.start("excitation", {"stale_after": 4.0})
        graph.start("identifier", parameters | {"calibration": "none", "report": False})
        client = Client()
        try:

            def listening() -> bool:
                graph.check()
                return client.excitation.get("joint_states") == "true"

            def ready() -> bool:
                return (
                    bool(client.statuses)
                    and values_of(client.statuses[-1])["doing"] == "idle"
                    and listening()
                )

            def deaf() -> bool:
                return client.excitation.get("joint_states") != "true"

            with bridge():
                assert comes_up(graph, ready), {name: graph.log(name) for name in graph.processes}
                answer = client.call("/identifier/calibrate_payload")
            assert not answer.success and "nothing says what drives the joints" in answer.message, (
                answer.message
            )
            assert client.excitation["sequence"] == "0", "nothing was moved"
            assert wait_for(deaf)
            with bridge("--obey"):
                assert wait_for(listening)
                answer = client.call("/identifier/calibrate_payload", 3600.0)
            assert "recording: " in answer.message and "aborted" not in answer.message, (
                answer.message
            )
            assert "published best effort" in graph.log("identifier")
            assert "published best effort" in graph.log("excitation")
        finally:
            client.close()
    check_recorded(Path(answer.message.split("recording: ")[1]))


def check_recorded(bag: Path) -> None:
    """The commands that drove it, and joint states as the other driver has them: without velocities."""
    drives = load_robot("open_manipulator_x").drive_trains
    constants = {name: drive.nominal_effort_per_current for name, drive in drives.items()}
    recording = read_recording(
        bag,
        nominal_torque_constants=constants,
        joint_order=list(constants),
    )
    assert recording.inputs is not None
    assert recording.inputs.source == "/current_command"
    assert abs(recording.inputs.current_A).max() > 0.05
    assert recording.joints.velocity is None
