"""Excitation and identifier in this process: what they say of a driver that let go of the arm, and a simulation's time."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")

import rclpy
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from std_srvs.srv import Trigger
from support.pushes import one_push
from support.simulated_port import simulated
from support.simulated_time import SimulatedClock

from proprio_ros import clock
from proprio_ros.excitation.commands import Command
from proprio_ros.live.job import Job, JobError
from proprio_ros.nodes import messages
from proprio_ros.nodes.excitation import ExcitationNode
from proprio_ros.nodes.identifier import IdentifierNode
from proprio_ros.nodes.managed_node import IDLE_PAUSE_S, ManagedNode
from proprio_ros.nodes.qos import STREAM
from proprio_ros.robot import load_robot
from proprio_ros.virtual.robot import PARKED

ELBOW = "joint3"
PUSH_S = 0.4
PROBE = one_push(-0.3, PUSH_S, joint=ELBOW)
STOPPED = messages.status(
    "warning",
    "driver: servo bus",
    "the current is zero; /driver/torque true holds the arm again",
    {"state": "stopped"},
)
RUNNING = messages.status(
    "ok",
    "driver: servo bus",
    "held",
    {"state": "running"},
)


@pytest.fixture
def time_of_the_test() -> Iterator[SimulatedClock]:
    with simulated() as made:
        yield made


@pytest.fixture
def context(
    monkeypatch: pytest.MonkeyPatch,
    time_of_the_test: SimulatedClock,
) -> Iterator[Any]:
    # this process is that of the other tests, too
    monkeypatch.setattr(ExcitationNode, "urgent", False)
    context = rclpy.Context()
    rclpy.init(args=[], context=context)
    yield context
    rclpy.shutdown(context=context)


def active(kind: type[ManagedNode], context: Any, **parameters: Any) -> Any:
    """A node of that kind, active."""
    overrides = [Parameter(name, value=value) for name, value in parameters.items()]
    node = kind(context=context, parameter_overrides=overrides)  # type: ignore[call-arg]
    node.trigger_configure()
    node.trigger_activate()
    assert node.active
    return node


class Arm:
    """An excitation node, and joints that stand where it commands them; one that is pushed turns slowly. No bus, no wire."""

    def __init__(self, context: Any, folder: Path, **parameters: Any) -> None:
        probe = folder / "push.yaml"
        probe.write_text(PROBE)
        self.node = active(
            ExcitationNode,
            context,
            probe=str(probe),
            **parameters,
        )
        self.position = {
            **dict.fromkeys(load_robot("open_manipulator_x").drive_trains, 0.0),
            **PARKED,
        }
        self.sent: list[tuple[float, Command]] = []
        self.node._send = lambda command: self.sent.append((self.node.now_s(), command))

    @property
    def machine(self) -> Any:
        return self.node._machine

    def run(self) -> Trigger.Response:
        response: Trigger.Response = self.node._on_run(
            Trigger.Request(),
            Trigger.Response(),
        )
        return response

    def state(self, step_s: float) -> None:
        """A joint state arrives, the arm having obeyed for that long."""
        if self.sent:
            command = self.sent[-1][1]
            self.position |= command.position
            for joint in command.current_A:
                self.position[joint] -= 0.5 * step_s
        velocity = dict.fromkeys(self.position, 0.0)
        self.node._on_joint_state(
            messages.joint_state(
                0, list(self.position), list(self.position.values()), list(velocity.values())
            )
        )

    def until(
        self,
        done: Callable[[], bool],
        step_s: float = 0.01,
    ) -> None:
        for _ in range(2000):
            if done():
                return
            clock.sleep(step_s)
            self.state(step_s)
        raise AssertionError(self.machine.message)


@pytest.fixture
def arm(context: Any, tmp_path: Path) -> Iterator[Arm]:
    arm = Arm(context, tmp_path)
    arm.state(0.0)
    yield arm
    arm.node.finish()
    arm.node.destroy_node()


def test_a_stop_in_mid_probe_is_named(arm: Arm) -> None:
    arm.node._on_driver(RUNNING)
    assert arm.run().success
    arm.until(lambda: arm.machine.phase.value == "probe")
    arm.node._on_driver(STOPPED)
    assert arm.machine.abort_reason == (
        "the driver was stopped: the current is zero; /driver/torque true holds the arm again"
    )
    assert not arm.sent[-1][1].current_A
    assert arm.machine.phase.value == "aborted"


def test_nothing_begins_while_the_driver_is_stopped(arm: Arm) -> None:
    arm.node._on_driver(STOPPED)
    answer = arm.run()
    assert not answer.success
    assert not arm.machine.busy
    assert (
        answer.message
        == "the driver is stopped: the current is zero; /driver/torque true holds the arm again"
    )
    arm.node._on_driver(RUNNING)
    assert arm.run().success


SWING = """
excitation:
  hand: any
  settle_s: 0.3
  min_clearance_m: 0.02
  runs:
    - {joint: joint4, current_A: 0.0, duration_s: 1.5, start: {joint2: 0.0, joint3: 0.45, joint4: 0.58}}
"""


def swings(arm: Arm, folder: Path) -> None:
    """The arm's next sequence is a free swing."""
    probe = folder / "swing.yaml"
    probe.write_text(SWING)
    arm.node.set_parameters([Parameter("probe", value=str(probe))])


def test_nothing_swings_where_nobody_says_that_it_was_let_go_of(arm: Arm, tmp_path: Path) -> None:
    swings(arm, tmp_path)
    answer = arm.run()
    assert not answer.success
    assert "nobody says on /torque_enabled when a joint is let go of" in answer.message
    arm.node._on_torque_enabled(Bool(data=True))
    assert arm.run().success


@pytest.mark.parametrize("lets_go", [True, False])
def test_a_driver_that_does_not_let_go_is_noticed(arm: Arm, tmp_path: Path, lets_go: bool) -> None:
    swings(arm, tmp_path)
    arm.node._on_torque_enabled(Bool(data=True))
    assert arm.run().success
    arm.until(lambda: arm.machine.phase.value == "probe")
    silent = messages.joint_state(
        0,
        list(arm.position),
        effort=[0.0] * len(arm.position),
    )
    if lets_go:
        arm.node._on_torque_enabled(Bool(data=False))

    def ended() -> bool:
        arm.node._on_applied_effort(silent)
        return arm.machine.phase.value in ("brake", "aborted")

    arm.until(ended)
    assert (arm.machine.phase.value == "aborted") != lets_go
    if not lets_go:
        assert arm.machine.abort_reason.startswith(
            "the driver does not let go of joint4, or has ended it"
        )
        assert not arm.sent[-1][1].current_A


def test_the_word_of_a_driver_that_is_gone_does_not_count(
    arm: Arm, monkeypatch: pytest.MonkeyPatch
) -> None:
    arm.node._on_driver(STOPPED)
    monkeypatch.setattr("proprio_ros.nodes.excitation.DRIVER_SILENT_S", 0.0)
    assert arm.run().success, "a driver that does not publish its state is not asked for it"


def test_an_idle_node_rests_between_messages(arm: Arm) -> None:
    assert arm.node.pause_s == IDLE_PAUSE_S
    assert arm.run().success
    assert arm.node.pause_s == 0.0


# --- the identifier -----------------------------------------------------------------------------------------------------


@pytest.fixture
def identifier(
    context: Any,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> Iterator[Any]:
    monkeypatch.setattr("proprio_ros.nodes.identifier.prepare_identification", lambda *given: None)
    node = active(
        IdentifierNode,
        context,
        data_directory=str(tmp_path),
        calibration="none",
    )
    yield node
    node.finish()
    node.destroy_node()


def test_a_weighing_after_a_stop_is_refused_at_once(
    identifier: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(identifier.excitation.run, "service_is_ready", lambda: True)
    monkeypatch.setattr(identifier.excitation.set_probe, "service_is_ready", lambda: True)
    identifier.inputs._state_at_s = math.inf
    values = {
        "driver": "stopped: the current is zero; /driver/torque true holds the arm again",
        "joint_states": True,
    }
    identifier.excitation.on_status(
        messages.status(
            "ok",
            "excitation",
            "waiting",
            values,
        )
    )
    with pytest.raises(
        JobError, match=r"the driver is stopped: the current is zero; /driver/torque true holds"
    ):
        identifier.jobs.await_others(Job("payload", "calibrate_payload"))
    answers: list[tuple[bool, str]] = []
    identifier._begin(
        "payload",
        lambda success, message: answers.append((success, message)),
    )
    clock.sleep(10.0)
    assert answers
    assert not answers[0][0]
    assert "/driver/torque true" in answers[0][1]


@pytest.mark.parametrize("name", ["softness_sequence", "payload_sequence"])
def test_a_sequence_that_does_not_exist_is_refused(identifier: Any, name: str) -> None:
    (result,) = identifier.set_parameters([Parameter(name, value="nonsense")])
    assert not result.successful
    assert result.reason.startswith(f"{name}: no 'nonsense' among the probes; there are: ")
    assert "empty_hand" in result.reason
    (result,) = identifier.set_parameters([Parameter("payload_sequence", value="payload_elbow")])
    assert result.successful, result.reason


def test_nor_is_the_identifier_configured_with_one(
    context: Any, capfd: pytest.CaptureFixture[str]
) -> None:
    node = IdentifierNode(
        context=context, parameter_overrides=[Parameter("softness_sequence", value="nonsense")]
    )
    try:
        node.trigger_configure()
        assert (
            "cannot configure: softness_sequence: no 'nonsense' among the probes; there are: "
            in capfd.readouterr().err
        )
    finally:
        node.destroy_node()


def test_timers_have_their_turn_where_messages_come_faster_than_they_are_taken(
    identifier: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def endless(
        _subscription: Any,
        data: Any,
        info: Any,
    ) -> Iterator[Any]:
        for _ in range(10**7):
            yield data, info
        raise AssertionError("no end")

    monkeypatch.setattr("proprio_ros.nodes.listening.waiting", endless)
    heard: list[int] = []
    identifier.listen(
        JointState,
        "many",
        lambda _: heard.append(1),
        STREAM,
        together=lambda: True,
    )
    (subscription,) = (each for each in identifier.subscriptions if each.topic_name == "/many")
    subscription.callback(JointState(), {})
    assert len(heard) > 1
