"""Four processes, ROS messages between them, bytes on a serial port: the arm starts, weighs an object and is let go."""

from __future__ import annotations

import json
import math
import signal
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

from support.domains import free_domain
from support.live import replayed_alike, running, wait_for
from visualization_msgs.msg import Marker

MASS_KG = 0.05


@pytest.mark.long
def test_an_arm_learns_itself_and_weighs_an_object(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", free_domain())
    elbow_alone = {
        "robot_sequence": "empty_hand_elbow", "reference_sequence": "reference_elbow", "payload_sequence": "payload_elbow",
        "reference_mass": 0.1, "reference_wait": 0.5,
    }  # fmt: skip
    with running(tmp_path, virtual={"object": MASS_KG}, identifier=elbow_alone) as (graph, client):
        for service in ("calibrate_robot", "calibrate_payload"):
            answer = client.asked(f"/identifier/{service}")
            assert answer.success, answer.message
        assert wait_for(
            lambda: bool(client.masses) and math.isfinite(client.masses[-1]) and client.estimates[-1]["final"] == "true"
        )
        final = client.estimates[-1]
        low, high = json.loads(final["payload_mass.ci95"])
        assert abs(client.masses[-1] - MASS_KG) < min(0.002, high - low), final
        assert f"calibration: {tmp_path / 'data'}" in answer.message and "calibration.yaml" in final["calibration"]
        # what is refused withdraws what stood: nobody knows what is in the hand now
        withdrawn = client.withdrawn
        assert client.call("/driver/stop").success
        answer = client.call("/identifier/calibrate_payload")
        assert not answer.success and "the driver is stopped" in answer.message
        assert wait_for(lambda: client.withdrawn == withdrawn + 1 and client.estimates[-1]["verdict"] == "failed")
        assert client.estimates[-1]["payload_mass"] == "not determined"
        assert wait_for(lambda: math.isnan(client.payloads[-1].inertia.m))
        assert wait_for(lambda: [marker.action for marker in client.markers[-1].markers] == [Marker.DELETEALL])
        assert client.torque(True).success
        assert wait_for(lambda: any(client.motors[-1].effort)), "the arm is held"
        for node in ("excitation", "driver"):
            process = graph.processes[node]
            process.send_signal(signal.SIGINT)
            assert process.wait(60.0) == 0 and "Traceback" not in graph.log(node)
        assert wait_for(lambda: not any(client.motors[-1].effort)), "and let go at the end"
    (result,) = (tmp_path / "data").glob("*_payload/estimate.json")
    live = replayed_alike(result)
    assert live["estimates"][0]["value"] == client.masses[-1]
