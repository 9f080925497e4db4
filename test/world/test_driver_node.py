"""The driver node in the simulated world, on emulated servos: who may drive the arm, and what a stranger cannot do."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

from diagnostic_msgs.msg import DiagnosticStatus
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool, Trigger
from support.listening import LATCHED
from support.simulated_live import Client, running
from support.simulated_ros import Network

from proprio_ros.calibration_files.motors import MotorIdentity
from proprio_ros.nodes.messages import labelled, values_of

PUSH = {"joint3": -0.45}
PERIOD_S = 0.02


class Bench:
    """A driver node that is active, and two publishers that know nothing of each other."""

    def __init__(self, client: Client) -> None:
        self.client = client
        self.clock = client.clock
        self.process = client.world.processes["driver"]
        self.node: Any = self.process.node
        self.virtual = client.world.arm
        self.statuses: list[dict[str, str]] = []
        self.motors: list[dict[str, str]] = []
        listen = client.node.create_subscription
        self.other = client.node
        listen(
            DiagnosticStatus,
            "/driver/status",
            lambda m: self.statuses.append(values_of(m)),
            LATCHED,
        )
        listen(
            DiagnosticStatus,
            "/motors",
            lambda m: self.motors.append(values_of(m)),
            LATCHED,
        )
        self.owner = self.other.create_publisher(Float64MultiArray, "/current_command", 10)
        self.stranger = self.other.create_publisher(Float64MultiArray, "/current_command", 10)
        self.until(lambda: self.state == "running")

    @property
    def state(self) -> str:
        return self.statuses[-1]["state"] if self.statuses else ""

    @property
    def told(self) -> list[dict[str, str]]:
        """Diagnostics of the driver, one after the other."""
        return [values_of(message.status[0]) for message in self.client.diagnostics]

    @property
    def modes(self) -> dict[str, str]:
        modes: dict[str, str] = self.node._driver.modes
        return modes

    def spin(
        self,
        duration_s: float,
        each: Callable[[], None] = lambda: None,
    ) -> None:
        """Let time pass, with something done again and again."""
        for _ in range(round(duration_s / PERIOD_S)):
            each()
            self.clock.sleep(PERIOD_S)

    def until(
        self,
        done: Callable[[], bool],
        each: Callable[[], None] = lambda: None,
    ) -> None:
        """Let time pass until something is true."""
        for _ in range(round(10.0 / PERIOD_S)):
            if done():
                return
            each()
            self.clock.sleep(PERIOD_S)
        raise AssertionError((self.state, self.modes))

    def drive(self) -> None:
        """Until the elbow is pushed."""
        self.until(
            lambda: self.modes["joint3"] == "driven", lambda: self.owner.publish(labelled(PUSH))
        )

    def position(self) -> dict[str, float]:
        return dict(self.virtual.truth()[0])

    def call(
        self,
        kind: Any,
        service: str,
        request: Any,
    ) -> Any:
        return self.client.answer(
            self.client.begin(
                service,
                kind,
                request,
            )
        )

    def ask(
        self,
        do: Callable[[Any], Any],
    ) -> None:
        """Have the node do something, and wait until it is done."""
        done: list[bool] = []
        self.process.ask(lambda node: done.append(bool(do(node) or True)))
        self.until(lambda: bool(done))

    def assert_held(
        self,
        here: dict[str, float],
        within_rad: float = 0.05,
    ) -> None:
        """Torque on, and nothing falls."""
        self.spin(0.5)
        assert all(servo["torque_enable"] == 1 for servo in self.virtual.servos.values())
        for name, position in self.position().items():
            assert position == pytest.approx(here[name], abs=within_rad), name


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with running(tmp_path, "virtual", "driver") as client:
        yield Bench(client)


def test_zeros_from_nobody_leave_the_arm_held(bench: Bench) -> None:
    """`ros2 topic pub /current_command` with five zeros, for 0.7 s: joint2 used to fall by 1.4 rad."""
    here = bench.position()
    bench.spin(
        0.7,
        lambda: bench.stranger.publish(Float64MultiArray(data=[0.0] * 5)),
    )
    assert set(bench.modes.values()) == {"held"}
    bench.assert_held(here, 0.02)


def test_a_plain_array_still_drives(bench: Bench) -> None:
    here = bench.position()["joint3"]
    bench.until(
        lambda: bench.position()["joint3"] < here - 0.05,
        lambda: bench.owner.publish(Float64MultiArray(data=[0.0, 0.0, PUSH["joint3"], 0.0, 0.0])),
    )
    assert bench.modes["joint3"] == "driven"
    assert bench.modes["joint2"] == "held"
    bench.owner.publish(Float64MultiArray())
    bench.until(lambda: bench.modes["joint3"] == "held")


def test_a_stranger_is_refused_while_another_drives(bench: Bench) -> None:
    driver = bench.node._driver
    bench.drive()
    refused = driver.statistics.refused_commands
    modes = set()

    def both() -> None:
        bench.owner.publish(labelled(PUSH))
        bench.stranger.publish(labelled({"joint3": 0.0, "joint4": -0.1}))
        modes.add((bench.modes["joint3"], bench.modes["joint4"]))

    bench.until(lambda: driver.statistics.refused_commands > refused + 4, both)
    assert modes == {("driven", "held")}
    bench.owner.publish(labelled({}))
    bench.until(lambda: bench.modes["joint3"] == "held")
    # and served when nobody does
    bench.until(
        lambda: bench.modes["joint4"] == "driven",
        lambda: bench.stranger.publish(labelled({"joint4": -0.05})),
    )


@pytest.mark.parametrize("waits", ["network", "queue"])
def test_a_command_from_before_torque_came_on_is_refused(bench: Bench, waits: str) -> None:
    """Whether the network held it back, or the node itself was busy meanwhile."""
    graph = bench.client.world.graph
    positions = bench.other.create_publisher(Float64MultiArray, "/position_command", 10)
    switch = partial(bench.call, SetBool, "/driver/torque")
    here = bench.position()["joint1"]
    sent = labelled({"joint1": bench.position()["joint1"] + 0.6})
    assert switch(SetBool.Request(data=False)).success
    if waits == "network":
        usual = graph.network
        graph.network = Network(delay_s=0.4, jitter_s=0.0)
        positions.publish(sent)
        graph.network = usual
        assert switch(SetBool.Request(data=True)).success
    else:
        bench.virtual.set_fault("delay=0.01")
        answer = bench.client.begin(
            "/driver/torque",
            SetBool,
            SetBool.Request(data=True),
        )
        bench.spin(0.1)
        positions.publish(sent)  # while the node waits for its servos
        assert bench.client.answer(answer).success
        bench.virtual.set_fault("")
    bench.spin(1.0)
    assert bench.position()["joint1"] == pytest.approx(here, abs=0.05)
    assert "since it was sent" in bench.client.log("driver")
    positions.publish(sent)
    bench.until(lambda: bench.position()["joint1"] > here + 0.5)


@pytest.mark.parametrize("set_s", [-5.0, -0.2, 0.2, 5.0])
def test_commands_are_obeyed_though_the_clock_was_set_while_one_was_on_its_way(
    bench: Bench, set_s: float
) -> None:
    graph = bench.client.world.graph
    positions = bench.other.create_publisher(Float64MultiArray, "/position_command", 10)
    here = bench.position()["joint1"]
    positions.publish(labelled({"joint1": here}))
    bench.spin(0.2)
    usual = graph.network
    graph.network = Network(delay_s=0.02, jitter_s=0.0)
    positions.publish(labelled({"joint1": here}))
    graph.network = usual
    graph.set_by_s = graph.set_by_s + set_s
    bench.spin(1.5)
    for on in (False, True):
        assert bench.call(SetBool, "/driver/torque", SetBool.Request(data=on)).success
    positions.publish(labelled({"joint1": here + 0.3}))
    bench.until(lambda: bench.position()["joint1"] > here + 0.25)


@pytest.mark.parametrize("transition", ["deactivate", "cleanup", "shutdown"])
def test_a_lifecycle_transition_ends_with_the_arm_held(bench: Bench, transition: str) -> None:
    bench.drive()
    bench.ask(lambda node: node.trigger_deactivate())
    if transition == "cleanup":
        bench.ask(lambda node: node.trigger_cleanup())
    elif transition == "shutdown":
        bench.ask(lambda node: node.on_shutdown(None))
    bench.spin(0.2)
    bench.assert_held(bench.position())
    if transition == "deactivate":
        bench.until(lambda: bench.state == "inactive")
        bench.ask(lambda node: node.trigger_activate())
        bench.until(lambda: bench.state == "running")
        bench.assert_held(bench.position())


def test_stop_is_obeyed_by_a_driver_that_is_not_active(bench: Bench) -> None:
    bench.ask(lambda node: node.trigger_deactivate())
    assert bench.call(Trigger, "/driver/stop", Trigger.Request()).success
    bench.until(lambda: not any(bench.virtual.truth()[1].values()))


def test_the_end_of_the_process_obeys_on_shutdown(bench: Bench) -> None:
    bench.process.end()
    assert bench.process.code == 0
    bench.client.world.processes.pop("driver")
    assert {servo["torque_enable"] for servo in bench.virtual.servos.values()} == {0}


def test_an_excitation_at_rest_knows_where_the_arm_is(tmp_path: Path) -> None:
    """Not where it was twenty joint states ago, when something begins."""
    with running(tmp_path, "virtual", "driver", "excitation") as client:
        client.clock.sleep(2.0)
        excitation = client.world.processes["excitation"].node
        before = excitation._sample.position["joint4"]
        client.world.arm.set_fault("jump=joint4")
        client.clock.sleep(0.1)
        assert abs(excitation._sample.position["joint4"] - before) > 0.5


def test_an_excitation_at_rest_misses_no_joint_states_that_come(tmp_path: Path) -> None:
    """It pauses after each thing that it hears: just after torque was switched, runs were refused for joint states that came."""
    with running(
        tmp_path,
        "virtual",
        "driver",
        "excitation",
        driver={"rate": 40.0},
    ) as client:
        excitation = client.world.processes["excitation"].node
        oldest_s = 0.0
        for _ in range(8):
            for on in (False, True):
                assert client.world.call(
                    "/driver/torque", SetBool, SetBool.Request(data=on)
                ).success
            for _ in range(40):
                client.clock.sleep(0.0171)
                assert excitation._fresh
                oldest_s = max(oldest_s, excitation.now_s() - excitation._sample.time_s)
        assert oldest_s > excitation.values["stale_after"], "else this shows nothing"


def test_a_defect_in_mid_push_ends_the_current(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.drive()

    def broken() -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(bench.node._driver, "cycle", broken)
    with pytest.raises(RuntimeError, match="a thread has failed: ZeroDivisionError"):
        bench.spin(0.5)
    bench.clock.failure = None
    assert not bench.node._thread.is_alive()
    assert {servo["torque_enable"] for servo in bench.virtual.servos.values()} == {0}


def test_a_change_of_state_is_published_at_once(bench: Bench) -> None:
    bench.until(lambda: bench.told[-1:] != [] and bench.told[-1]["state"] == "running")
    for timer in bench.node.timers:
        timer.cancel()  # the second's round
    bench.statuses.clear()
    bench.client.diagnostics.clear()
    answer = bench.call(Trigger, "/driver/stop", Trigger.Request())
    assert "/driver/torque true" in answer.message
    bench.until(lambda: bool(bench.statuses) and bool(bench.told))
    assert bench.statuses[0]["state"] == bench.told[0]["state"] == "stopped"
    assert bench.call(SetBool, "/driver/torque", SetBool.Request(data=True)).success
    bench.until(lambda: bench.state == "running")


def test_whose_arm_it_is_is_said_once(bench: Bench) -> None:
    bench.until(lambda: bool(bench.motors))
    (told,) = bench.motors
    assert set(told) == set(bench.node._order)
    assert MotorIdentity.from_text(told["joint3"]) == MotorIdentity(1020, 13, 46, 0, 0, 10)
