"""An SO-101 behind a position controller, probed by steps of its goals; and held when its node is killed in one.

How well it weighs is for test/benchmarks/live.py; the guards, for test/excitation/test_goal_controller.py.
"""

from __future__ import annotations

import signal
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from support.domains import free_domain
from support.live import Client, running, wait_for

from proprio_ros.nodes.graph import Graph

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


@dataclass
class Servos:
    """The arm's nodes, and what is said to its controller.

    Attributes:
        goals: As the excitation node publishes them for who records.
        sent: Positions for the controller, by whoever sends them [rad].
    """

    graph: Graph
    client: Client
    goals: list[JointState] = field(default_factory=list)
    sent: list[list[float]] = field(default_factory=list)

    def listen(self) -> None:
        """Hears all goals from now on."""
        node = self.client.node
        node.create_subscription(JointState, "/joint_command", self.goals.append, 1000)
        node.create_subscription(
            Float64MultiArray, TOPIC, lambda each: self.sent.append(list(each.data)), 1000
        )
        assert wait_for(lambda: node.count_publishers(TOPIC) >= 2)

    def positions(self) -> list[float]:
        """Of all joints, in the controller's order [rad]."""
        return [self.client.position(name) for name in ORDER]


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
    nodes = ("virtual", "excitation")
    with running(tmp_path, *nodes, virtual=virtual, excitation=output) as (graph, client):
        servos = Servos(graph, client)
        servos.listen()
        push_twice(servos)
        check_goals_are_published(servos)
        check_held_when_killed(servos)


def push_twice(servos: Servos) -> None:
    """Starts the probe, and waits for its second push."""
    client = servos.client
    assert wait_for(lambda: client.excitation.get("joint_states") == "true"), servos.graph.log(
        "excitation"
    )
    answer = client.call("/excitation/run")
    assert answer.success, answer.message
    assert wait_for(
        lambda: client.excitation["phase"] == "probe" and client.excitation["run"] == "2"
    )
    assert float(client.excitation["good_runs"]) == 1.0


def check_goals_are_published(servos: Servos) -> None:
    """Whoever records hears every goal once it was taken, by name and on the clock of the joint states."""
    goals = servos.goals
    for goal in goals:
        assert list(goal.name) == ORDER
        assert len(goal.position) == len(ORDER)
    sent = {tuple(each) for each in servos.sent}
    assert {tuple(goal.position) for goal in goals[20:]} <= sent
    stamps = {stamp_of(state) for state in servos.client.states}
    assert sum(stamp_of(goal) in stamps for goal in goals[:-5]) > len(goals) - 15


def stamp_of(message: JointState) -> tuple[int, int]:
    """Seconds and nanoseconds."""
    return message.header.stamp.sec, message.header.stamp.nanosec


def check_held_when_killed(servos: Servos) -> None:
    """In the middle of a push somebody else holds the pushed joint where it is, and the others where they were."""
    client = servos.client
    sent = servos.sent
    # the status is said before the goal is sent
    assert wait_for(lambda: client.position("elbow_flex") > 0.2)
    pushed = sent[-1]
    servos.graph.processes["excitation"].send_signal(signal.SIGKILL)
    assert wait_for(lambda: sent[-1] != pushed), "somebody else speaks for it"
    last = sent[-1]
    assert last[1] != pushed[1]
    assert [*last[:1], *last[2:]] == [*pushed[:1], *pushed[2:]], "the others stay as they were"
    heard = len(client.motors)
    assert wait_for(lambda: len(client.motors) > heard + 60)
    before = servos.positions()
    assert wait_for(lambda: len(client.motors) > heard + 90)
    assert servos.positions() == pytest.approx(before, abs=0.005)
    assert sent[-1] == last
    assert abs(client.position("elbow_flex") - last[1]) < 0.15
