"""An arm behind what looks like `ros2_control`, calibrated and weighed by services alone, without this package's driver."""

from __future__ import annotations

import math
import signal
import sys
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")
sys.path.insert(0, str(Path(__file__).parent))

from domains import free_domain
from live import Client, replayed_alike, running, wait_for, warm_up
from std_msgs.msg import Bool, Float64MultiArray

from proprio_ros.bags import read_recording
from proprio_ros.robot import load_robot
from proprio_ros.virtual.effort_driver import FOREIGN_JOINTS

pytestmark = pytest.mark.long

TOPIC = "/forward_effort_controller/commands"
ROBOT = load_robot("open_manipulator_x")
ORDER = ["joint3", "gripper_left_joint", "joint1", "joint4", "joint2"]
MASSES_KG = (0.05, 0.15)
WITHIN_KG = 0.005
"""Ten standard deviations of a weighing here: no busy machine fails it by chance."""
DRIVER: dict[str, Any] = {"interface": "effort_controller", "controller_joints": ORDER, "effort_unit": "A"}
OUTPUT: dict[str, Any] = {"command_interface": "effort", "controller_joints": ORDER, "effort_unit": "A"}


def hear_less(client: Client) -> None:
    """500 joint states a second would take as much of this computer as the driver does."""
    for subscription in list(client.node.subscriptions):
        if subscription.topic_name in ("/joint_states", "/applied_effort"):
            client.node.destroy_subscription(subscription)


def stands(client: Client) -> bool:
    """Whether all joints come to stand where they are: braked by spring and damper, they come back first."""

    def still() -> bool:
        before = {name: client.position(name) for name in ORDER}
        heard = len(client.motors)
        assert wait_for(lambda: len(client.motors) > heard + 50, 30.0)
        return all(abs(client.position(name) - before[name]) < 0.01 for name in ORDER)

    return wait_for(still, 30.0)


def asked(client: Client, service: str, seconds: float) -> Any:
    """The answer; asked again where the probe was ended because a busy machine kept a node from its work."""
    for _ in range(4):
        answer = client.call(service, seconds)
        if answer.success or not any(words in answer.message for words in ("fallen silent", "joint states", "paused")):
            break
    return answer


NODES = ("virtual", "excitation", "identifier")


@pytest.mark.xfail(reason="on a busy machine a node may fall behind, and a weighing is then ended or rejected")
def test_robot_calibrated_and_masses_weighed_by_services_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", free_domain())
    warm_up("payload")
    stated = ["payload.com=[0,0,0]", "payload.shape=point"]
    facts = {"settings": stated, "reference_settings": stated, "reference_mass": 0.1, "reference_wait": 1.0}
    with running(tmp_path, *NODES, virtual=DRIVER, excitation=OUTPUT, identifier=facts) as (graph, client):
        state = client.states[-1]
        assert list(state.name) == sorted(state.name) and {*FOREIGN_JOINTS} < {*state.name}
        assert all(math.isnan(speed) for speed in state.velocity)
        hear_less(client)
        answer = asked(client, "/identifier/calibrate_robot", 1200.0)
        assert answer.success, (answer.message, graph.log("excitation"))
        for mass_kg in MASSES_KG:
            assert client.set("/virtual", "object", mass_kg).successful
            answer = asked(client, "/identifier/calibrate_payload", 600.0)
            assert answer.success, (answer.message, graph.log("excitation"))
            assert wait_for(lambda: bool(client.masses), 5.0)
            assert client.masses[-1] == pytest.approx(mass_kg, abs=WITHIN_KG), answer.message
        # Ctrl-C: what held the arm is the last word, and it stands
        before = {name: client.position(name) for name in ORDER}
        graph.stop("excitation", signal.SIGINT)
        heard = len(client.motors)
        assert wait_for(lambda: len(client.motors) > heard + 50, 20.0)
        for name in ORDER:
            assert client.position(name) == pytest.approx(before[name], abs=0.05), name
        assert abs(client.motor("joint2")) > 0.02
    bag = Path(answer.message.split("recording: ")[1])
    replayed_alike(bag.parent / "estimate.json")
    constants = {name: drive.nominal_effort_per_current for name, drive in ROBOT.drive_trains.items()}
    recording = read_recording(bag, nominal_torque_constants=constants, joint_order=list(constants))
    assert recording.inputs is not None and recording.inputs.source == "/applied_effort"


def test_every_way_out_leaves_the_arm_held_or_let_go(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", free_domain())
    output = OUTPUT | {"probe": "payload_elbow"}
    with running(tmp_path, "virtual", "excitation", virtual=DRIVER, excitation=output) as (graph, client):
        assert wait_for(lambda: client.excitation.get("joint_states") == "true", 20.0)
        hear_less(client)
        efforts: list[Float64MultiArray] = []
        client.node.create_subscription(Float64MultiArray, TOPIC, efforts.append, 1000)
        answer = client.call("/excitation/run")
        assert answer.success, answer.message
        client.wait_for_phase("probe", 30.0)
        answer = client.call("/excitation/abort")
        assert answer.success and "held" in answer.message
        assert stands(client)
        # whoever asked has died: no word on the lease any more
        lease = client.node.create_publisher(Bool, "/excitation/lease", 10)
        assert client.call("/excitation/run").success
        client.wait_for_phase("probe", 60.0)
        assert wait_for(lambda: lease.get_subscription_count() > 0, 10.0)
        lease.publish(Bool(data=True))
        client.wait_for_phase("aborted", 30.0)
        assert stands(client)
        # the joint states stay away, and the arm with them: no push is on when they come again
        assert client.call("/excitation/run").success
        client.wait_for_phase("probe", 60.0)
        graph.processes["virtual"].send_signal(signal.SIGSTOP)
        try:
            client.wait_for_phase("aborted", 30.0)
            blind = efforts[-1].data
        finally:
            graph.processes["virtual"].send_signal(signal.SIGCONT)
        assert all(abs(effort) < 0.6 for effort in blind) and any(blind)
        assert stands(client)
        # held, or let go if it was found too far off
        answer = client.call("/excitation/release")
        assert "the efforts are zero" in answer.message or answer.message == "nothing was held"
        assert wait_for(lambda: all(current == 0.0 for current in client.motors[-1].effort), 5.0)
        assert efforts and all(len(message.data) == len(ORDER) for message in efforts)
        assert client.call("/excitation/release").message == "nothing was held"
        # somebody else at the controller
        other = client.node.create_publisher(Float64MultiArray, TOPIC, 10)
        assert wait_for(lambda: "somebody else publishes" in client.call("/excitation/run").message, 10.0)
        client.node.destroy_publisher(other)
