"""An SO-101 behind a position controller, probed by steps of its goals; and held when its node is killed in one.

How well it weighs is for test/benchmarks/live.py; the guards, for test/excitation/test_goal_controller.py.
"""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from support.domains import free_domain
from support.live import running, wait_for

pytestmark = pytest.mark.long

TOPIC = "/position_controller/commands"
ORDER = ["gripper", "elbow_flex", "shoulder_pan", "wrist_roll", "wrist_flex", "shoulder_lift"]
ARM: dict[str, Any] = {"robot": "so101", "controller_joints": ORDER}
PROBE = """
excitation:
  hand: any
  settle_s: 0.3
  brake_s: 0.2
  approach_velocity: 1.2
  runs:
    - {joint: elbow_flex, goal_step: -0.25, duration_s: 0.4, start: {shoulder_lift: -0.3}}
    - {joint: elbow_flex, goal_step: 0.5, duration_s: 20.0, start: {shoulder_lift: -0.6, elbow_flex: 0.0}}
"""


def test_servos_are_pushed_by_steps_of_goals_and_held_when_the_node_is_killed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", free_domain())
    probe = tmp_path / "steps.yaml"
    probe.write_text(PROBE)
    virtual = {
        "interface": "position_controller",
        "state_rate": 50.0,
        "object": 0.1,
        **ARM,
    }
    output = {"command_interface": "position", "probe": probe, **ARM}
    with running(
        tmp_path,
        "virtual",
        "excitation",
        virtual=virtual,
        excitation=output,
    ) as (
        graph,
        client,
    ):
        goals: list[JointState] = []
        sent: list[list[float]] = []
        client.node.create_subscription(JointState, "/joint_command", goals.append, 1000)
        client.node.create_subscription(
            Float64MultiArray, TOPIC, lambda each: sent.append(list(each.data)), 1000
        )
        assert wait_for(lambda: client.node.count_publishers(TOPIC) >= 2)
        assert wait_for(lambda: client.excitation.get("joint_states") == "true"), graph.log(
            "excitation"
        )
        answer = client.call("/excitation/run")
        assert answer.success, answer.message
        assert wait_for(
            lambda: client.excitation["phase"] == "probe" and client.excitation["run"] == "2"
        )
        assert float(client.excitation["good_runs"]) == 1.0
        # whoever records hears every goal once it was taken, by name and on the clock of the joint states
        assert all(list(each.name) == ORDER and len(each.position) == len(ORDER) for each in goals)
        assert {tuple(each.position) for each in goals[20:]} <= {tuple(each) for each in sent}
        stamps = {(each.header.stamp.sec, each.header.stamp.nanosec) for each in client.states}
        assert (
            sum((each.header.stamp.sec, each.header.stamp.nanosec) in stamps for each in goals[:-5])
            > len(goals) - 15
        )
        # the status is said before the goal is sent
        assert wait_for(lambda: client.position("elbow_flex") > 0.2)
        pushed = sent[-1]
        graph.processes["excitation"].send_signal(signal.SIGKILL)
        assert wait_for(lambda: sent[-1] != pushed), "somebody else speaks for it"
        last = sent[-1]
        assert last[1] != pushed[1] and [*last[:1], *last[2:]] == [*pushed[:1], *pushed[2:]], (
            "the others stay as they were"
        )
        heard = len(client.motors)
        assert wait_for(lambda: len(client.motors) > heard + 60)
        before = [client.position(name) for name in ORDER]
        assert wait_for(lambda: len(client.motors) > heard + 90)
        assert [client.position(name) for name in ORDER] == pytest.approx(before, abs=0.005)
        assert sent[-1] == last
        assert abs(client.position("elbow_flex") - last[1]) < 0.15
