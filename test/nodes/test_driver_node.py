"""The driver node in this process, on emulated servos: who may drive the arm, and what a stranger on the network cannot do."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool, Trigger

from proprio_ros.calibration_files.motors import MotorIdentity
from proprio_ros.clock import run_in_real_time, run_like_others
from proprio_ros.nodes.driver import DriverNode
from proprio_ros.nodes.messages import labelled, values_of
from proprio_ros.nodes.runtime import LATCHED
from proprio_ros.robot import load_robot
from proprio_ros.virtual.robot import VirtualRobot
from proprio_ros.virtual.truth import Truth

PUSH = {"joint3": -0.45}


class Bench:
    """A driver node that is active, and two publishers that know nothing of each other."""

    def __init__(self, folder: Path) -> None:
        robot = load_robot("open_manipulator_x")
        self.virtual = VirtualRobot(robot, Truth.draw(robot, 1), link=folder / "arm", seed=1)
        self.context = rclpy.Context()
        rclpy.init(args=[], context=self.context)
        # others use this computer, too: nobody here may take a late message for silence
        stated = {"port": str(folder / "arm"), "reply_timeout": 0.1, "command_timeout": 0.5}
        overrides = [Parameter(name, value=value) for name, value in stated.items()]
        self.node: Any = DriverNode(context=self.context, parameter_overrides=overrides)
        self.other = Node("other", context=self.context)
        self.statuses: list[dict[str, str]] = []
        self.motors: list[dict[str, str]] = []
        self.diagnostics: list[dict[str, str]] = []
        listen = self.other.create_subscription
        listen(DiagnosticStatus, "/driver/status", lambda m: self.statuses.append(values_of(m)), LATCHED)
        listen(DiagnosticStatus, "/motors", lambda m: self.motors.append(values_of(m)), LATCHED)
        listen(DiagnosticArray, "/diagnostics", lambda m: self.diagnostics.append(values_of(m.status[0])), 10)
        self.owner = self.other.create_publisher(Float64MultiArray, "/current_command", 10)
        self.stranger = self.other.create_publisher(Float64MultiArray, "/current_command", 10)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.executor.add_node(self.other)
        self.node.trigger_configure()
        self.node.trigger_activate()
        self.until(lambda: self.state == "running" and self.stranger.get_subscription_count() > 0)

    def close(self) -> None:
        self.node.finish()
        self.executor.shutdown()
        self.node.destroy_node()
        self.other.destroy_node()
        rclpy.shutdown(context=self.context)
        self.virtual.close()

    @property
    def state(self) -> str:
        return self.statuses[-1]["state"] if self.statuses else ""

    @property
    def modes(self) -> dict[str, str]:
        modes: dict[str, str] = self.node._driver.modes
        return modes

    def spin(self, duration_s: float, each: Callable[[], None] = lambda: None, period_s: float = 0.02) -> None:
        """Let time pass, with something done again and again."""
        end_s = time.monotonic() + duration_s
        next_s = 0.0
        while time.monotonic() < end_s:
            if time.monotonic() >= next_s:
                next_s = time.monotonic() + period_s
                each()
            self.executor.spin_once(timeout_sec=0.005)

    def until(self, done: Callable[[], bool], each: Callable[[], None] = lambda: None, period_s: float = 0.02) -> None:
        """Let time pass until something is true; how long that takes is the computer's affair."""
        end_s, next_s = time.monotonic() + 60.0, 0.0
        while not done():
            assert time.monotonic() < end_s, (self.state, self.modes)
            if time.monotonic() >= next_s:
                next_s = time.monotonic() + period_s
                each()
            self.executor.spin_once(timeout_sec=0.01)

    def drive(self) -> None:
        """Until the elbow is pushed."""
        self.until(lambda: self.modes["joint3"] == "driven", lambda: self.owner.publish(labelled(PUSH)))

    def position(self) -> dict[str, float]:
        with self.virtual.port.lock:
            return dict(self.virtual.arm.position())

    def call(self, kind: Any, service: str, request: Any) -> Any:
        client = self.other.create_client(kind, service)
        self.until(client.service_is_ready)
        future = client.call_async(request)
        self.until(future.done)
        return future.result()

    def assert_held(self, here: dict[str, float], within_rad: float = 0.05) -> None:
        """Torque on, and nothing falls."""
        self.spin(0.5)
        assert all(servo["torque_enable"] == 1 for servo in self.virtual.servos.values())
        for name, position in self.position().items():
            assert position == pytest.approx(here[name], abs=within_rad), name


@pytest.fixture(autouse=True)
def real_time() -> Iterator[None]:
    """Servos do not wait: as in test/bus, work beside these tests must not disturb them."""
    granted = run_in_real_time()
    yield
    if granted:
        run_like_others()


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    monkeypatch.setattr(DriverNode, "real_time", False)  # this process is that of the other tests, too
    bench = Bench(tmp_path)
    try:
        yield bench
    finally:
        bench.close()


def test_zeros_from_nobody_leave_the_arm_held(bench: Bench) -> None:
    """`ros2 topic pub /current_command` with five zeros, for 0.7 s: joint2 used to fall by 1.4 rad."""
    here = bench.position()
    bench.spin(0.7, lambda: bench.stranger.publish(Float64MultiArray(data=[0.0] * 5)))
    assert set(bench.modes.values()) == {"held"}
    bench.assert_held(here, 0.02)


def test_a_plain_array_still_drives(bench: Bench) -> None:
    here = bench.position()["joint3"]
    bench.until(
        lambda: bench.position()["joint3"] < here - 0.05,
        lambda: bench.owner.publish(Float64MultiArray(data=[0.0, 0.0, PUSH["joint3"], 0.0, 0.0])),
    )
    assert bench.modes["joint3"] == "driven" and bench.modes["joint2"] == "held"
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
    bench.until(lambda: bench.modes["joint4"] == "driven", lambda: bench.stranger.publish(labelled({"joint4": -0.05})))


@pytest.mark.parametrize("transition", ["deactivate", "cleanup", "shutdown"])
def test_a_lifecycle_transition_ends_with_the_arm_held(bench: Bench, transition: str) -> None:
    bench.drive()
    bench.node.trigger_deactivate()
    if transition == "cleanup":
        bench.node.trigger_cleanup()
    elif transition == "shutdown":
        bench.node.trigger_shutdown()
    bench.spin(0.2)
    bench.assert_held(bench.position())
    if transition == "deactivate":
        bench.until(lambda: bench.state == "inactive")
        bench.node.trigger_activate()
        bench.until(lambda: bench.state == "running")
        bench.assert_held(bench.position())


def test_stop_is_obeyed_by_a_driver_that_is_not_active(bench: Bench) -> None:
    bench.node.trigger_deactivate()
    assert bench.call(Trigger, "/driver/stop", Trigger.Request()).success
    bench.until(lambda: not any(bench.virtual.truth()[1].values()))


def test_the_end_of_the_process_obeys_on_shutdown(bench: Bench) -> None:
    bench.node.finish()
    assert {servo["torque_enable"] for servo in bench.virtual.servos.values()} == {0}


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_defect_in_mid_push_ends_the_current(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    bench.drive()

    def broken() -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(bench.node._driver, "cycle", broken)
    bench.until(lambda: not bench.node._thread.is_alive())
    assert {servo["torque_enable"] for servo in bench.virtual.servos.values()} == {0}


def test_a_change_of_state_is_published_at_once(bench: Bench) -> None:
    bench.until(lambda: bench.diagnostics[-1:] != [] and bench.diagnostics[-1]["state"] == "running")
    for timer in bench.node.timers:
        timer.cancel()  # the second's round
    bench.statuses.clear()
    bench.diagnostics.clear()
    answer = bench.call(Trigger, "/driver/stop", Trigger.Request())
    assert "/driver/torque true" in answer.message
    bench.until(lambda: bool(bench.statuses) and bool(bench.diagnostics))
    assert bench.statuses[0]["state"] == bench.diagnostics[0]["state"] == "stopped"
    assert bench.call(SetBool, "/driver/torque", SetBool.Request(data=True)).success
    bench.until(lambda: bench.state == "running")


def test_whose_arm_it_is_is_said_once(bench: Bench) -> None:
    bench.until(lambda: bool(bench.motors))
    (told,) = bench.motors
    assert set(told) == set(bench.node._order)
    assert MotorIdentity.from_text(told["joint3"]) == MotorIdentity(1020, 13, 46, 0, 0, 10)
