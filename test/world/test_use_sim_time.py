"""An excitation node on the clock of a simulation, which runs faster or slower than time, pauses and is set back."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

from builtin_interfaces.msg import Time
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from support.pushes import one_push
from support.simulated_live import Client, running

from proprio_ros.excitation.commands import JointStates
from proprio_ros.nodes import messages
from proprio_ros.robot import load_robot
from proprio_ros.virtual.robot import PARKED

ELBOW = "joint3"
PUSH_S = 0.4
STEP_S = 0.01
PROBE = one_push(-0.3, PUSH_S, joint=ELBOW)


@dataclass
class Simulation:
    """Publishes /clock, and joints that stand where they are commanded; one that is pushed turns slowly. No bus, no wire."""

    client: Client
    node: Any
    pace: float = 1.0
    now_s: float = 100.0
    position: dict[str, float] = field(default_factory=dict)
    sent: list[tuple[float, Any]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.position = {
            **dict.fromkeys(load_robot("open_manipulator_x").drive_trains, 0.0),
            **PARKED,
        }
        self._clock = self.client.node.create_publisher(
            Clock,
            "/clock",
            10,
        )
        self._states = self.client.node.create_publisher(
            JointState,
            "/joint_states",
            100,
        )
        self.node._send = lambda command: self.sent.append((self.node.now_s(), command))

    @property
    def machine(self) -> Any:
        return self.node._machine

    def step(self) -> None:
        self.now_s += STEP_S
        self._clock.publish(
            Clock(clock=Time(sec=int(self.now_s), nanosec=round(1e9 * (self.now_s % 1.0)) % 10**9))
        )
        self.client.clock.sleep(0.5 * STEP_S / self.pace)
        if self.sent:
            command = self.sent[-1][1]
            self.position |= command.position
            for joint in command.current_A:
                self.position[joint] -= 0.5 * STEP_S
        names = list(self.position)
        speeds = [0.0] * len(names)
        self._states.publish(
            messages.joint_state(
                round(1e9 * self.now_s), names, list(self.position.values()), speeds
            )
        )
        self.client.clock.sleep(0.5 * STEP_S / self.pace)

    def run(self) -> Any:
        """Ask for the sequence while the simulation goes on."""
        future = self.client.begin("/excitation/run")
        # a node at rest answers within 80 ms; at four times the pace a step takes 2.5 ms
        for _ in range(100):
            if not future.done():
                self.step()
        assert future.done()
        return future.result()


@pytest.fixture
def simulation(tmp_path: Path) -> Iterator[Simulation]:
    probe = tmp_path / "push.yaml"
    probe.write_text(PROBE)
    with running(
        tmp_path, "excitation", excitation={"use_sim_time": True, "probe": str(probe)}
    ) as client:
        yield Simulation(client, client.world.processes["excitation"].node)


@pytest.mark.parametrize("pace", [4.0, 0.5])
def test_a_push_lasts_as_long_on_the_clock_of_a_simulation(
    simulation: Simulation, pace: float
) -> None:
    """The simulation pauses before the push and in it."""
    simulation.pace = pace
    client = simulation.client
    machine = simulation.machine
    answer = client.call("/excitation/run")
    assert not answer.success
    assert "no time comes on /clock" in answer.message
    for _ in range(10):
        simulation.step()
    answer = simulation.run()
    assert answer.success, answer.message
    paused = set()
    for _ in range(2000):
        simulation.step()
        phase = machine.phase.value
        if phase in ("settle", "probe") and phase not in paused:
            paused.add(phase)
            client.clock.sleep(3.0)  # longer than stale_after
        if not machine.busy:
            break
    assert machine.phase.value == "done", machine.message
    assert paused == {"settle", "probe"}
    (outcome,) = machine.outcomes
    assert outcome.duration_s == pytest.approx(PUSH_S, abs=STEP_S)
    driven_s = [at_s for at_s, command in simulation.sent if command.current_A]
    assert driven_s[-1] - driven_s[0] == pytest.approx(PUSH_S, abs=2 * STEP_S)
    assert all(
        after - before == pytest.approx(STEP_S, abs=1e-3) for before, after in pairwise(driven_s)
    )


@pytest.mark.parametrize("jump_s", [-5.0, 5.0, -100.0])
@pytest.mark.parametrize("when", ["idle", "probe"])
def test_after_a_jump_of_the_clock_the_next_call_is_obeyed(
    simulation: Simulation, jump_s: float, when: str
) -> None:
    """Who resets a simulation sets its clock back: a push that was under way is aborted, and the next call begins at once."""
    machine = simulation.machine
    for _ in range(10):
        simulation.step()
    if when == "probe":
        assert simulation.run().success
        for _ in range(400):
            simulation.step()
            if machine.phase.value == "probe":
                break
        assert machine.phase.value == "probe"
    simulation.now_s += jump_s
    for _ in range(30):
        simulation.step()
    if when == "probe":
        assert machine.phase.value == "aborted", machine.message
    assert simulation.client.excitation["joint_states"] == "true"
    answer = simulation.run()
    assert answer.success, answer.message
    begun_s = simulation.now_s
    for _ in range(600):
        simulation.step()
        if not machine.busy:
            break
    assert machine.phase.value == "done", machine.message
    assert simulation.now_s - begun_s < 4.0


def test_speeds_are_known_again_after_a_jump_back() -> None:
    """A mean from then to now would have no sense until the clock has come there again."""
    states = JointStates(["a"], 0.5)
    for row in range(20):
        states.add(
            10.0 + 0.01 * row,
            ["a"],
            [0.02 * row],
        )
    heard = [
        states.add(
            5.0 + 0.01 * row,
            ["a"],
            [0.4 - 0.01 * row],
        )
        for row in range(20)
    ]
    assert heard[-1] is not None
    assert heard[-1].velocity["a"] == pytest.approx(-1.0)


@pytest.mark.parametrize("jump_s", [-5.0, 5.0])
def test_a_weighing_after_a_jump_of_the_clock_is_not_late(tmp_path: Path, jump_s: float) -> None:
    """All nodes follow /clock. The driver's stamps jump at another moment than the identifier's clock."""
    on = {"use_sim_time": True}
    probe = tmp_path / "push.yaml"
    probe.write_text(PROBE)
    identifier = {
        **on,
        "payload_sequence": str(probe),
        "report": False,
        "live_period": 0.0,
    }
    with running(
        tmp_path,
        driver=on,
        excitation=on,
        identifier=identifier,
    ) as client:
        clock = client.clock
        ahead_s = [0.0]
        publisher = client.node.create_publisher(Clock, "/clock", 10)

        def simulate() -> None:
            while True:
                now_s = clock.now() + ahead_s[0]
                publisher.publish(
                    Clock(clock=Time(sec=int(now_s), nanosec=int(1e9 * (now_s % 1.0))))
                )
                clock.sleep(STEP_S)

        clock.thread(simulate, "simulation", group="simulation").start()
        clock.sleep(3.0)
        for jump in (0.0, jump_s):
            ahead_s[0] += jump
            clock.sleep(3.0)
            begun_s = clock.now()
            future = client.begin("/identifier/calibrate_payload")
            client.wait_for_phase("approach")
            assert clock.now() - begun_s < 2.0, "who asks waits for nothing"
            answer = client.answer(future)
            assert "recording: " in answer.message, answer.message
            assert clock.now() - begun_s < 8.0
