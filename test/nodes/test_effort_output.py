"""Every way out of a probe through an effort controller, on a simulated arm that keeps the last command; and last words."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from std_msgs.msg import Bool, Float64MultiArray
from std_srvs.srv import Trigger
from support.domains import free_domain
from support.live import wait_for

from proprio_ros import clock
from proprio_ros.nodes import command_watchdog, excitation, messages
from proprio_ros.nodes.command_watchdog import CommandWatchdog
from proprio_ros.nodes.excitation import ExcitationNode
from proprio_ros.robot import load_robot
from proprio_ros.virtual.effort_driver import EffortDriver
from proprio_ros.virtual.objects import Payload
from proprio_ros.virtual.truth import Truth

ROBOT = load_robot("open_manipulator_x")
ORDER = ["joint3", "gripper_left_joint", "joint1", "joint4", "joint2"]
PERIOD_S = 0.002
PROBE = """
excitation:
  hand: any
  settle_s: 1.0
  brake_s: 0.3
  approach_velocity: 1.2
  runs:
    - {joint: joint3, current_A: -0.34, duration_s: %g, start: {joint2: -0.6, joint3: 0.6, joint4: 0.0}, max_travel: 3.0}
"""


@dataclass
class RecordedWatchdog:
    """In the place of the process that stands in for a node that was killed."""

    told: list[list[float]] = field(default_factory=list)
    alive = due = heard = True

    def is_publisher(self, info: Any) -> bool:
        return False

    def update(self, efforts: list[float]) -> None:
        self.told.append(efforts)

    def clear(self) -> None:
        self.told.append([])

    def close(self) -> None:
        pass


class Published(list[Any]):
    """In a publisher's place."""

    topic_name = "/forward_effort_controller/commands"

    def publish(self, message: Any) -> None:
        self.append(message)

    def wait_for_all_acked(self, _timeout: Any) -> None:
        pass


class Arm:
    """An excitation node and an arm behind an effort controller, on a clock of the test's own. No wire, no thread."""

    def __init__(
        self, context: Any, folder: Path, monkeypatch: pytest.MonkeyPatch, **given: Any
    ) -> None:
        self.time_s = 100.0
        monkeypatch.setattr(clock, "now", lambda: self.time_s)
        monkeypatch.setattr(
            clock,
            "now_ns",
            lambda: round(1e9 * self.time_s),
        )
        self.watchdog = RecordedWatchdog()
        self.commands = Published()
        monkeypatch.setattr(excitation, "CommandWatchdog", lambda *_given: self.watchdog)
        monkeypatch.setattr(ExcitationNode, "urgent", False)
        probe = folder / "push.yaml"
        probe.write_text(PROBE % given.pop("push_s", 0.3))
        parameters = {
            "command_interface": "effort",
            "controller_joints": ORDER,
            "probe": str(probe),
            **given,
        }
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        self.node: Any = ExcitationNode(context=context, parameter_overrides=overrides)
        self.node.trigger_configure()
        self.node.trigger_activate()
        assert self.node.active
        self.node.now_s = lambda: self.time_s
        self.node._output._commands = self.commands
        self.node._output._applied = Published()
        self.node.count_subscribers = lambda _topic: 1
        self.driver = EffortDriver(
            ROBOT,
            Truth.draw(ROBOT, 1),
            joints=ORDER,
        )

    @property
    def phase(self) -> str:
        return str(self.node._machine.phase.value)

    def advance(
        self,
        seconds: float,
        heard: bool = True,
        alive: bool = True,
    ) -> None:
        """The driver broadcasts and takes what was commanded; the node hears it, or is deaf, or dead."""
        for step in range(round(seconds / PERIOD_S)):
            self.time_s += PERIOD_S
            self.driver.advance(self.time_s)
            if heard and alive:
                position, velocity, effort = self.driver.states()
                stamp_ns = round(1e9 * self.time_s)
                names = list(self.driver.broadcast)
                self.node._on_joint_state(
                    messages.joint_state(stamp_ns, names, position, velocity, effort)
                )
            if alive and step % 10 == 0:
                self.node._on_timer()
            for message in self.commands[-1:]:
                assert self.driver.command(self.time_s, message.data)

    def until(self, phase: str, seconds: float = 20.0) -> None:
        for _ in range(round(seconds / 0.02)):
            if self.phase == phase:
                return
            self.advance(0.02)
        raise AssertionError((phase, self.phase, self.node._machine.message))

    def run(self) -> None:
        self.advance(0.2)
        response = self.node._on_run(
            Trigger.Request(),
            Trigger.Response(),
        )
        assert response.success, response.message

    def probe(self) -> None:
        self.run()
        self.until("probe")
        self.advance(0.15)
        assert self.phase == "probe"

    def assert_held(self, alive: bool = True) -> None:
        """It stands, and not because it lies somewhere; where nobody sees it, friction decides how still."""
        self.advance(1.5, alive=alive)
        before = self.driver.arm.position()
        self.advance(0.5, alive=alive)
        after = self.driver.arm.position()
        assert max(abs(after[name] - before[name]) for name in after) < (0.01 if alive else 0.03)
        assert max(map(abs, self.commands[-1].data)) > 0.05, "nobody let go of it"
        assert float(np.abs(self.driver.arm.velocity_rad_s()).max()) < 0.1

    def assert_let_go(self) -> None:
        assert list(self.commands[-1].data) == [0.0] * len(ORDER)
        assert self.watchdog.told[-1] == [], "nobody takes it up again"


@pytest.fixture
def make(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> Iterator[Any]:
    monkeypatch.setenv("ROS_DOMAIN_ID", free_domain())
    context = rclpy.Context()
    rclpy.init(args=[], context=context)
    made: list[Arm] = []

    def arm(**parameters: Any) -> Arm:
        made.append(Arm(context, tmp_path, monkeypatch, **parameters))
        return made[-1]

    yield arm
    for each in made:
        each.node.finish()
        each.node.destroy_node()
    rclpy.shutdown(context=context)


def test_a_sequence_that_is_done_leaves_the_arm_held(make: Any) -> None:
    arm = make()
    arm.probe()
    arm.until("done")
    arm.assert_held()


def test_a_guard_ends_a_push_and_the_arm_is_held(make: Any) -> None:
    arm = make(push_s=3.0)
    arm.probe()
    arm.until("done" if arm.phase == "done" else "aborted")
    assert arm.node._machine.aborted_by in ("limit", "velocity", "clearance")
    arm.assert_held()


def test_an_abort_and_a_lost_lease_leave_the_arm_held(make: Any) -> None:
    arm = make(push_s=1.0)
    arm.probe()
    assert "held" in arm.node._on_abort(Trigger.Request(), Trigger.Response()).message
    arm.assert_held()
    arm.run()
    arm.node._on_lease(Bool(data=True))
    arm.until("aborted")
    assert "whoever asked" in arm.node._machine.abort_reason
    arm.assert_held()


def test_lost_joint_states_end_a_push_and_what_held_the_arm_goes_on(make: Any) -> None:
    arm = make(push_s=1.0)
    arm.probe()
    pushed = list(arm.commands[-1].data)
    arm.advance(0.2, heard=False)
    blind = list(arm.commands[-1].data)
    assert blind != pushed
    assert arm.phase != "probe"
    arm.advance(1.0, heard=False)
    assert arm.phase == "aborted"
    assert list(arm.commands[-1].data) == blind
    arm.assert_held()


@pytest.mark.parametrize("on_end", ["hold", "zero"])
@pytest.mark.parametrize("phase", ["approach", "probe"])
def test_the_end_of_the_node_is_a_last_word(make: Any, phase: str, on_end: str) -> None:
    """Ctrl-C, SIGTERM, and whatever escapes a callback come to `finish`."""
    arm = make(push_s=1.0, on_end=on_end)
    arm.run()
    arm.until(phase)
    arm.advance(0.1)
    pushed = list(arm.commands[-1].data)
    arm.node.finish()
    if on_end == "zero":
        arm.assert_let_go()
        return
    last = list(arm.commands[-1].data)
    assert arm.watchdog.told[-1] == []
    assert any(last)
    assert phase == "approach" or last[0] != pushed[0], "a push ends"
    arm.assert_held(alive=False)


@pytest.mark.parametrize("phase", ["approach", "probe"])
def test_what_is_said_for_a_killed_node_holds_the_arm(make: Any, phase: str) -> None:
    arm = make(push_s=1.0)
    arm.run()
    arm.until(phase)
    arm.advance(0.1)
    arm.advance(0.3, alive=False)  # until it is noticed that it is silent
    arm.commands.append(Float64MultiArray(data=arm.watchdog.told[-1]))
    arm.assert_held(alive=False)


def test_an_exception_does_not_keep_a_node_from_its_last_word(
    make: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    arm = make(push_s=1.0)
    arm.probe()
    pushed = arm.commands[-1].data[0]

    def fails(*_given: Any) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(arm.node._machine, "tick", fails)
    with pytest.raises(ZeroDivisionError):
        arm.advance(0.01)
    monkeypatch.setattr(arm.node._output.controller, "steady", fails)
    with pytest.raises(ZeroDivisionError):
        arm.node.finish()
    assert arm.commands[-1].data[0] == 0.0 != pushed
    arm.assert_let_go()


def test_an_arm_that_is_not_where_it_is_held_is_let_go(make: Any) -> None:
    arm = make()
    arm.run()
    arm.until("settle")
    arm.driver.hold(Payload(2.0))  # more than the motors lift
    for _ in range(200):
        if arm.phase == "aborted":
            break
        arm.advance(0.02)
    assert arm.phase == "aborted"
    arm.advance(1.0)
    arm.assert_let_go()


def test_release_lets_go_in_mid_push(make: Any) -> None:
    arm = make(push_s=1.0)
    arm.probe()
    assert (
        "the efforts are zero"
        in arm.node._on_release(Trigger.Request(), Trigger.Response()).message
    )
    arm.advance(0.2)
    arm.assert_let_go()
    assert arm.phase == "aborted"
    assert arm.node._on_release(Trigger.Request(), Trigger.Response()).message == "nothing was held"


@pytest.mark.parametrize(
    ("lacks", "cure"), [("alive", "start this node again"), ("heard", "has not found")]
)
def test_nothing_begins_where_nobody_would_hold_the_arm_of_a_killed_node(
    make: Any, lacks: str, cure: str
) -> None:
    arm = make()
    arm.advance(0.2)
    setattr(arm.watchdog, lacks, False)
    response = arm.node._on_run(
        Trigger.Request(),
        Trigger.Response(),
    )
    assert not response.success
    assert cure in response.message
    assert not arm.commands


def test_the_state_is_told_at_rest_too(make: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every second: the last word of a sequence may be lost."""
    arm = make()
    arm.advance(0.2)
    told = Published()
    monkeypatch.setattr(arm.node, "_status", told)
    arm.advance(5.0)
    assert 4 <= len(told) <= 6
    assert all(each.message == told[0].message for each in told)


class Listener:
    """A controller's subscription, in a domain of its own."""

    def __init__(self, topic: str) -> None:
        self.topic = topic
        self.heard: list[list[float]] = []
        self._context = rclpy.Context()
        rclpy.init(args=[], context=self._context)
        self.node = rclpy.create_node("controller", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)

    def listen(self) -> Any:
        return self.node.create_subscription(
            Float64MultiArray, self.topic, lambda message: self.heard.append(list(message.data)), 10
        )

    def has(self, wanted: list[float]) -> bool:
        """Whether this came last."""
        self._executor.spin_once(timeout_sec=0.05)
        return self.heard[-1:] == [wanted]

    def close(self) -> None:
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self._context)


@pytest.fixture
def listener(monkeypatch: pytest.MonkeyPatch) -> Iterator[Listener]:
    monkeypatch.setenv("ROS_DOMAIN_ID", free_domain())
    listener = Listener("/some_controller/commands")
    yield listener
    listener.close()


@pytest.mark.long
def test_the_watchdog_publishes_when_the_node_is_silent_or_gone(listener: Listener) -> None:
    listener.listen()
    watchdog = CommandWatchdog(listener.topic)
    node = listener.node
    assert wait_for(lambda: node.count_publishers(listener.topic) == 1 and watchdog.heard)
    (publisher,) = node.get_publishers_info_by_topic(listener.topic)
    publisher.node_name = "_NODE_NAME_UNKNOWN_"  # as it is until the name comes
    assert watchdog.is_publisher(publisher)
    publisher.endpoint_gid = [0] * len(publisher.endpoint_gid)
    assert not watchdog.is_publisher(publisher)
    watchdog.update([1.0, 2.0])
    assert wait_for(lambda: listener.has([1.0, 2.0])), "it is silent"
    watchdog.clear()
    watchdog.update([3.0, 4.0])
    watchdog.close()
    assert wait_for(lambda: listener.has([3.0, 4.0])), "it is gone"
    assert wait_for(lambda: not watchdog.alive)


@pytest.mark.long
def test_a_watchdog_that_was_cleared_publishes_nothing(listener: Listener) -> None:
    listener.listen()
    watchdog = CommandWatchdog(listener.topic)
    assert wait_for(lambda: watchdog.heard)
    watchdog.update([5.0, 6.0])
    watchdog.clear()
    watchdog.close()
    assert wait_for(lambda: not watchdog.alive)
    for _ in range(20):
        listener.has([])
    assert listener.heard == []


@pytest.mark.long
def test_a_watchdog_knows_whether_anybody_listens(
    listener: Listener, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(command_watchdog, "FOUND_S", 0.0)
    watchdog = CommandWatchdog(listener.topic)
    assert watchdog.alive
    assert not watchdog.heard
    subscription = listener.listen()
    assert wait_for(lambda: watchdog.heard)
    listener.node.destroy_subscription(subscription)
    assert wait_for(lambda: not watchdog.heard), "the controller has gone"
    watchdog.close()
    assert wait_for(lambda: not watchdog.alive)
