"""Every way out of a probe by steps of goals, on a simulated SO-101 whose servos keep the last goals."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

import rclpy
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger
from support.domains import free_domain

from proprio_ros import clock
from proprio_ros.nodes import excitation, messages
from proprio_ros.nodes.excitation import ExcitationNode
from proprio_ros.robot import load_robot
from proprio_ros.virtual.effort_driver import PositionDriver
from proprio_ros.virtual.truth import Truth

pytestmark = pytest.mark.long

ROBOT = load_robot("so101")
ORDER = ["gripper", "elbow_flex", "shoulder_pan", "wrist_roll", "wrist_flex", "shoulder_lift"]
ELBOW = ORDER.index("elbow_flex")
PERIOD_S = 0.02
PROBE = """
excitation:
  hand: any
  settle_s: 0.3
  brake_s: 0.2
  approach_velocity: 1.2
  runs:
    - {joint: elbow_flex, goal_step: -0.4, duration_s: 3.0, start: {shoulder_lift: -0.2}}
"""


class Published(list[Any]):
    """In a publisher's place."""

    topic_name = "/position_controller/commands"

    def publish(self, message: Any) -> None:
        self.append(message)

    def wait_for_all_acked(self, _timeout: Any) -> None:
        pass


class Arm:
    """An excitation node and servos behind a position controller, on a clock of the test's own. No wire, no thread."""

    def __init__(
        self,
        context: Any,
        folder: Path,
        monkeypatch: pytest.MonkeyPatch,
    ) -> None:
        self.time_s = 100.0
        monkeypatch.setattr(clock, "now", lambda: self.time_s)
        monkeypatch.setattr(
            clock,
            "now_ns",
            lambda: round(1e9 * self.time_s),
        )
        self.told: list[list[float]] = []
        self.commands = Published()
        self.goals = Published()
        watchdog = SimpleNamespace(
            alive=True, due=True, heard=True, update=self.told.append, clear=lambda: self.told.append([]), close=lambda: None,
            is_publisher=lambda info: False,
        )  # fmt: skip
        monkeypatch.setattr(excitation, "CommandWatchdog", lambda *_given: watchdog)
        monkeypatch.setattr(ExcitationNode, "urgent", False)
        probe = folder / "step.yaml"
        probe.write_text(PROBE)
        given = {
            "robot": "so101",
            "command_interface": "position",
            "controller_joints": ORDER,
            "probe": str(probe),
        }
        overrides = [Parameter(name, value=value) for name, value in given.items()]
        self.node: Any = ExcitationNode(context=context, parameter_overrides=overrides)
        self.node.trigger_configure()
        self.node.trigger_activate()
        assert self.node.active
        self.node.now_s = lambda: self.time_s
        self.node._output._commands = self.commands
        self.node._output._applied = self.goals
        self.node.count_subscribers = lambda _topic: 1
        self.driver = PositionDriver(
            ROBOT,
            Truth.draw(ROBOT, 1),
            joints=ORDER,
        )
        self.shift = 0.0

    @property
    def phase(self) -> str:
        return str(self.node._machine.phase.value)

    def advance(
        self,
        seconds: float,
        heard: bool = True,
        alive: bool = True,
    ) -> None:
        for _ in range(round(seconds / PERIOD_S)):
            self.time_s += PERIOD_S
            self.driver.advance(self.time_s)
            if heard and alive:
                positions, _, _ = self.driver.states()
                names = list(self.driver.broadcast)
                positions[names.index("wrist_flex")] += self.shift
                self.node._on_joint_state(
                    messages.joint_state(
                        round(1e9 * self.time_s),
                        names,
                        positions,
                    )
                )
            if alive:
                self.node._on_timer()
            for message in self.commands[-1:]:
                assert self.driver.command(self.time_s, message.data)

    def pushes(self) -> None:
        self.advance(0.2)
        response = self.node._on_run(
            Trigger.Request(),
            Trigger.Response(),
        )
        assert response.success, response.message
        for _ in range(500):
            if self.phase == "probe":
                break
            self.advance(PERIOD_S)
        self.advance(0.1)
        assert self.phase == "probe"
        self.pushed = self.last

    @property
    def last(self) -> list[float]:
        return list(self.commands[-1].data)

    def assert_held(self, alive: bool = True) -> None:
        """It stands, the push is over, and goals are near where it is."""
        self.advance(1.5, alive=alive)
        before = self.driver.arm.position()
        self.advance(0.4, alive=alive)
        after = self.driver.arm.position()
        assert max(abs(after[name] - before[name]) for name in after) < 0.005
        assert len(self.last) == len(ORDER)
        assert abs(self.last[ELBOW] - self.pushed[ELBOW]) > 0.02
        assert all(
            abs(goal - after[name]) < 0.2
            for name, goal in zip(
                ORDER,
                self.last,
                strict=True,
            )
        )


@pytest.fixture
def arm(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> Iterator[Arm]:
    monkeypatch.setenv("ROS_DOMAIN_ID", free_domain())
    context = rclpy.Context()
    rclpy.init(args=[], context=context)
    made = Arm(context, tmp_path, monkeypatch)
    yield made
    made.node.finish()
    made.node.destroy_node()
    rclpy.shutdown(context=context)


def test_an_abort_and_a_release_hold_the_arm(arm: Arm) -> None:
    arm.pushes()
    arm.node._on_abort(Trigger.Request(), Trigger.Response())
    arm.assert_held()
    # whoever records hears what was sent, once it was taken
    assert {tuple(each.position) for each in arm.goals} <= {
        tuple(each.data) for each in arm.commands
    }
    assert all(list(each.name) == ORDER for each in arm.goals)
    arm.pushes()
    response = arm.node._on_release(
        Trigger.Request(),
        Trigger.Response(),
    )
    assert "the servos hold the arm" in response.message
    assert arm.told[-1] == []
    count = len(arm.commands)
    arm.assert_held()
    assert len(arm.commands) == count, "no more goals"


def test_lost_joint_states_end_a_push(arm: Arm) -> None:
    arm.pushes()
    arm.advance(0.3, heard=False)
    assert arm.phase != "probe"
    assert arm.last[ELBOW] != arm.pushed[ELBOW]
    arm.advance(2.0, heard=False)
    assert arm.phase == "aborted"
    arm.assert_held()


def test_an_encoder_that_slips_is_followed(arm: Arm) -> None:
    arm.pushes()
    arm.shift = 0.8
    arm.advance(PERIOD_S)
    assert arm.phase == "aborted"
    assert arm.node._machine.aborted_by == "jump"
    wrist = ORDER.index("wrist_flex")
    assert arm.last[wrist] - arm.pushed[wrist] == pytest.approx(0.8, abs=0.1)
    for released in (False, True):
        arm.advance(0.5)
        response = arm.node._on_run(
            Trigger.Request(),
            Trigger.Response(),
        )
        assert response.success == released
        assert ("the encoder of wrist_flex jumped" in response.message) != released
        arm.node._on_release(Trigger.Request(), Trigger.Response())


def test_an_encoder_that_slips_while_the_arm_is_held_is_remembered(arm: Arm) -> None:
    """What was weighed then was weighed at another pose than the calibration's, and accepted."""
    arm.pushes()
    arm.node._on_abort(Trigger.Request(), Trigger.Response())
    arm.advance(1.0)
    arm.shift = 0.8
    arm.advance(1.0)
    response = arm.node._on_run(
        Trigger.Request(),
        Trigger.Response(),
    )
    assert not response.success
    assert "the encoder of wrist_flex jumped by +0.80" in response.message


@pytest.mark.parametrize("ends", ["finish", "killed", "fails"])
def test_the_end_of_the_node_holds_the_arm(
    arm: Arm, ends: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ctrl-C, SIGTERM and whatever escapes a callback come to `finish`; of `kill -9`, what was told."""
    arm.pushes()
    if ends == "killed":
        arm.advance(0.26, alive=False)
        arm.commands.append(SimpleNamespace(data=arm.told[-1]))
    else:
        if ends == "fails":

            def fails(*_given: Any) -> None:
                raise ZeroDivisionError

            monkeypatch.setattr(arm.node._machine, "tick", fails)
            with pytest.raises(ZeroDivisionError):
                arm.advance(PERIOD_S)
            monkeypatch.setattr(
                arm.node._machine,
                "abort",
                lambda _why: None,
            )
        arm.node.finish()
        assert arm.told[-1] == [], "nobody says it again"
    arm.assert_held(alive=False)
