"""What goes wrong while a joint is pushed, in the simulated world: every way out ends with the arm held, or without current.

The true currents and the true motion come from the virtual robot, which knows nothing of what the other nodes say.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise, takewhile
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from support.simulated_live import Client, running
from support.simulated_ros import Future

from proprio_ros.bus.driver import DriverSettings
from proprio_ros.nodes.excitation_client import SEEN_S
from proprio_ros.nodes.messages import joint_state, labelled, values_of
from proprio_ros.recordings.signals import read_recording
from proprio_ros.robot import load_robot
from proprio_ros.virtual.robot import PARKED

pytestmark = pytest.mark.long

ELBOW = "joint3"
PUSH_A = -0.280  # what the servo makes of -0.28 A: it counts in 2.69 mA
LIKE_PUSH_A = 0.002
# it lifts the forearm by 0.3 rad, to where its weight and friction balance the push, and no further
PUSH_S = 3.0
RUN = (
    "{{joint: joint3, current_A: -0.28, duration_s: {duration_s}, max_travel: 1.5,"
    " start: {{joint2: -0.2, joint3: 0.8, joint4: 0.0}}}}"
)

# two cycles of the driver, and 20 ms from one word of the virtual robot to the next
COMMAND_TIMEOUT_S = DriverSettings().command_timeout_s + 0.05
WATCHDOG_S = DriverSettings().watchdog_s + 0.05
HOLD_WATCHDOG_S = DriverSettings().hold_watchdog_s + 0.05
RATE_HZ = 100.0


def push_file(folder: Path, *durations_s: float) -> Path:
    """A sequence that lifts the elbow slowly: 0.3 rad in a second."""
    path = folder / f"push_{'_'.join(f'{duration_s:g}' for duration_s in durations_s)}.yaml"
    runs = "\n".join("    - " + RUN.format(duration_s=duration_s) for duration_s in durations_s)
    path.write_text(
        f"excitation:\n  hand: any\n  settle_s: 0.3\n  brake_s: 0.2\n  approach_velocity: 1.5\n  runs:\n{runs}\n"
    )
    return path


@dataclass
class Arm:
    """A running world, and the probe that it is asked for."""

    client: Client
    folder: Path
    push: Path

    def log(self, node: str) -> str:
        return self.client.log(node)

    def kill(self, node: str) -> float:
        """Kill a node; returns when it was."""
        self.client.world.processes.pop(node).kill()
        return now_s(self.client)


@contextmanager
def arm_of(folder: Path, *nodes: str, identifier: dict[str, Any] | None = None) -> Iterator[Arm]:
    push = push_file(folder, PUSH_S)
    stated = {"payload_sequence": str(push), "report": False} | (identifier or {})
    with running(folder, *nodes, identifier=stated) as client:
        assert client.wait_for(
            lambda: bool(client.motors and client.applied and client.diagnostics)
        )
        if "excitation" in client.world.processes:
            assert client.set("/excitation", "probe", str(push)).successful
        yield Arm(client, folder, push)


@pytest.fixture(scope="module")
def shared_world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Arm]:
    with arm_of(tmp_path_factory.mktemp("faults")) as arm:
        yield arm


@pytest.fixture
def arm(shared_world: Arm) -> Iterator[Arm]:
    """The shared world; each test leaves it well."""
    lift(shared_world.client)
    yield shared_world
    client = shared_world.client
    client.set("/virtual", "fault", "")
    client.call("/excitation/abort")
    client.assert_well()
    assert client.wait_for(lambda: torque_is_on(client)), shared_world.log("driver")
    assert_held(client)
    assert client.wait_for(lambda: doing(client) == "idle"), doing(client)


def now_s(client: Client) -> float:
    return 1e-9 * float(client.node.get_clock().now().nanoseconds)


# --- what is true of the arm --------------------------------------------------------------------------------------------


def stamp_s(message: JointState) -> float:
    return float(message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec)


def since(
    messages: list[JointState],
    begun_s: float,
) -> list[JointState]:
    """The newest messages, back to that time."""
    newest_first = takewhile(
        lambda message: stamp_s(message) >= begun_s,
        reversed(list(messages)),
    )
    return [*newest_first][::-1]


def current_A(message: JointState, joint: str = ELBOW) -> float:
    return float(message.effort[list(message.name).index(joint)])


def pushed(message: JointState) -> bool:
    return abs(current_A(message) - PUSH_A) < LIKE_PUSH_A


def without_current(message: JointState) -> bool:
    return not any(message.effort)


def lift(client: Client) -> None:
    """Put the arm where a probe may begin, as a person would who found it lying on the table."""

    def there() -> bool:
        return all(
            abs(client.position(joint) - angle_rad) < 0.1 for joint, angle_rad in PARKED.items()
        )

    if not there():
        assert client.call("/virtual/recover").success
    assert client.wait_for(lambda: there() and at_rest(client)), client.motors[-1]


def at_rest(client: Client) -> bool:
    """No joint has moved in 0.3 s."""
    recent = client.motors[-20:]
    recent = [message for message in recent if stamp_s(message) > stamp_s(recent[-1]) - 0.32]
    spans = [
        max(column) - min(column)
        for column in zip(*(message.position for message in recent), strict=True)
    ]
    return len(recent) >= 8 and max(spans) < 0.01


def assert_held(client: Client) -> None:
    """At rest, by motors that work against gravity, and nobody drives."""
    begun_s = now_s(client)
    assert client.wait_for(lambda: stamp_s(client.motors[-1]) > begun_s and at_rest(client)), (
        client.motors[-1]
    )
    assert client.wait_for(lambda: not without_current(client.motors[-1])), client.motors[-1]
    assert client.wait_for(lambda: not any(client.applied[-1].effort)), client.applied[-1]

    def stream() -> bool:
        """By stamps: how late we hear them says nothing of the driver."""
        newest_s = stamp_s(client.states[-1])
        return (
            newest_s > begun_s + 0.5 and len(since(client.states, newest_s - 0.5)) > 0.25 * RATE_HZ
        )

    assert client.wait_for(stream), driver_status(client)


def assert_braked(client: Client, begun_s: float, within_s: float) -> None:
    """The push ended in time, the elbow hardly moved after that, and is held."""
    assert client.wait_for(lambda: not pushed(client.motors[-1])), client.excitation
    assert_held(client)
    after = since(client.motors, begun_s)
    end = next(row for row, message in enumerate(after) if not pushed(message))
    assert stamp_s(after[end]) - begun_s < within_s
    index = list(after[end].name).index(ELBOW)
    braked_rad = after[end].position[index]
    assert all(abs(message.position[index] - braked_rad) < 0.2 for message in after[end:])
    # on its way the current may pass that of the push
    assert sum(map(pushed, after[end:])) <= 0.2 * len(after[end:])


def assert_zero(client: Client, begun_s: float, within_s: float) -> None:
    """No motor is driven from that time on, and the driver says so."""
    assert client.wait_for(lambda: without_current(client.motors[-1])), client.motors[-1]
    seen_s = stamp_s(client.motors[-1])
    assert client.wait_for(lambda: stamp_s(client.motors[-1]) > seen_s + 0.2)
    after = since(client.motors, begun_s)
    end = next(row for row, message in enumerate(after) if without_current(message))
    assert stamp_s(after[end]) - begun_s < within_s
    velocities = [
        [
            (to - was) / (stamp_s(now) - stamp_s(before))
            for was, to in zip(before.position, now.position, strict=True)
        ]
        for before, now in pairwise(after[end:])
    ]
    for now, around in zip(
        after[end + 1 :],
        pairwise([*velocities, velocities[-1]]),
        strict=True,
    ):
        for joint, effort in enumerate(now.effort):
            # an arm that falls faster than its supply can turn it, by 4.8 rad/s, makes the motor a generator, and that brakes; a
            # mean from sample to sample is less than the speed at its end
            brakes = any(abs(row[joint]) > 2.0 and effort * row[joint] < 0.0 for row in around)
            assert effort == 0.0 or brakes, (stamp_s(now) - begun_s, now)


def assert_let_go(client: Client, begun_s: float, late_s: float = 0.0) -> None:
    """Of servos that nobody talks to: the push ended in time, what was held is let go later; ``late_s``: of who says since when."""
    assert_zero(client, begun_s, late_s + HOLD_WATCHDOG_S)
    after = since(client.motors, begun_s)
    end = next(row for row, message in enumerate(after) if not pushed(message))
    assert stamp_s(after[end]) - begun_s < late_s + WATCHDOG_S
    # a joint that falls makes its motor a generator
    assert sum(map(pushed, after[end:])) <= 0.2 * len(after[end:])


def doing(client: Client) -> str:
    return str(values_of(client.statuses[-1])["doing"])


def driver_status(client: Client) -> tuple[str, str]:
    """State of the driver and its reason, by the newest diagnostics."""
    status = client.diagnostics[-1].status[0]
    return str(values_of(status)["state"]), str(status.message)


def torque_is_on(client: Client) -> bool:
    return bool(client.torque(True).success)


def await_push(client: Client) -> None:
    """Until the current of the probe flows in the true motor, and the elbow moves."""
    client.wait_for_phase("probe")
    assert client.wait_for(lambda: pushed(client.motors[-1])), client.motors[-1]
    begun = next(message for message in reversed(list(client.motors)) if not pushed(message))
    begin_rad = begun.position[list(begun.name).index(ELBOW)]
    assert client.wait_for(lambda: client.position(ELBOW) < begin_rad - 0.03), client.motors[-1]


def begin_push(client: Client) -> None:
    answer = client.call("/excitation/run")
    assert answer.success, answer.message
    await_push(client)


def assert_aborted(client: Client, *words: str) -> None:
    assert client.wait_for(lambda: client.excitation["busy"] == "false"), client.excitation
    assert client.excitation["phase"] == "aborted"
    assert any(word in client.excitation["reason"] for word in words), client.excitation["reason"]


def assert_done(client: Client) -> None:
    assert client.wait_for(lambda: client.excitation["busy"] == "false"), client.excitation
    assert client.excitation["phase"] == "done", client.excitation


def rate_hz(states: list[JointState]) -> float:
    """Rate of joint states, by their stamps."""
    return (len(states) - 1) / (stamp_s(states[-1]) - stamp_s(states[0]))


# --- not ready ----------------------------------------------------------------------------------------------------------


# --- nodes that are not there, and that end ---------------------------------------------------------------------------


def test_what_is_not_there_is_reported_at_once(tmp_path: Path) -> None:
    with running(tmp_path, "excitation", "identifier") as client:
        begun_s = now_s(client)
        future = client.begin("/identifier/calibrate_payload")
        client.clock.sleep(1.0)
        assert client.call("/identifier/cancel").success
        assert "cancelled" in client.answer(future).message
        assert now_s(client) - begun_s < 2.0, "who waits for others hears that it need not"
        # just after its start others are not known yet
        answer = client.call("/identifier/calibrate_payload")
        assert not answer.success
        assert "no joint states are coming" in answer.message
        assert SEEN_S - 1.0 < now_s(client) - begun_s < SEEN_S + 1.0
        begun_s = now_s(client)
        answer = client.call("/excitation/run")
        assert not answer.success
        assert "start the driver" in answer.message
        answer = client.call("/identifier/calibrate_payload")
        assert not answer.success
        assert "no joint states are coming" in answer.message
        client.world.processes.pop("excitation").end()
        # joint states do come, as from another driver
        publisher = client.node.create_publisher(JointState, "/joint_states", 10)
        ended = client.clock.event()

        def publish() -> None:
            while not ended.wait(0.02):
                publisher.publish(JointState(name=["joint1"], position=[0.0]))

        client.clock.thread(publish, "another driver", group="another driver").start()
        client.clock.sleep(0.1)
        answer = client.call("/identifier/calibrate_payload")
        ended.set()
        assert not answer.success and "no excitation node" in answer.message, answer.message
        assert now_s(client) - begun_s < 9.0, "4 s of patience each"
        assert not list((tmp_path / "data").glob("*"))


def test_the_excitation_is_killed(tmp_path: Path) -> None:
    with arm_of(tmp_path) as arm:
        client = arm.client
        future = client.begin("/identifier/calibrate_payload")
        await_push(client)
        killed_s = arm.kill("excitation")
        assert_braked(client, killed_s, COMMAND_TIMEOUT_S)
        answer = client.answer(future)
        assert not answer.success
        assert "fallen silent" in answer.message
        bag = Path(answer.message.split("recording: ")[1])
        assert pushed_in(bag)
        assert_held(client)


def test_identifier_and_driver_are_killed(tmp_path: Path) -> None:
    pushes = {"payload_sequence": str(push_file(tmp_path, 0.6, PUSH_S))}
    with arm_of(tmp_path, identifier=pushes) as arm:
        client = arm.client
        client.begin("/identifier/calibrate_payload")
        assert client.wait_for(lambda: client.excitation.get("run") == "2"), client.excitation
        await_push(client)
        arm.kill("identifier")
        assert_aborted(client, "whoever asked for the sequence has fallen silent")
        assert_held(client)
        # what came until then is on disk, and a bag as soon as the node is back
        (journal,) = (tmp_path / "data").glob("*_payload/messages.journal")
        client.world.start("identifier", {"calibration": "none"})
        assert client.wait_for(
            lambda: (journal.parent / "bag" / "metadata.yaml").exists() and not journal.exists()
        )
        assert pushed_in(journal.parent / "bag")
        # a sequence that was asked for by hand is nobody's, and goes on
        lift(client)
        assert client.set("/excitation", "probe", str(arm.push)).successful
        begin_push(client)
        killed_s = arm.kill("driver")
        assert_let_go(client, killed_s)
        assert_aborted(client, "is the driver alive")
        client.world.start("driver", {})
        assert client.wait_for(lambda: bool(since(client.states, killed_s + 1.0))), arm.log(
            "driver"
        )
        assert_held(client)
        lift(client)
        begin_push(client)
        assert_done(client)


@pytest.mark.parametrize("node", ["excitation", "driver"])
def test_told_to_end(tmp_path: Path, node: str) -> None:
    with arm_of(tmp_path, "virtual", "driver", "excitation") as arm:
        client = arm.client
        begin_push(client)
        process = client.world.processes.pop(node)
        told_s = now_s(client)
        process.end()
        assert process.code == 0
        if node == "excitation":
            assert_braked(client, told_s, COMMAND_TIMEOUT_S)
            assert_aborted(client, "told to end")
        else:
            assert_zero(client, told_s, 0.1)
            assert_aborted(client, "is the driver alive")


# --- the wire and the servos --------------------------------------------------------------------------------------------


def test_a_pulled_cable(arm: Arm) -> None:
    client = arm.client
    begin_push(client)
    pulled_s = now_s(client)
    assert client.set("/virtual", "fault", "unplug").successful
    assert_let_go(client, pulled_s, now_s(client) - pulled_s)
    assert_aborted(client, "is the driver alive")
    assert client.wait_for(lambda: driver_status(client)[0] == "disconnected")
    assert "check the cable" in driver_status(client)[1]
    client.states.clear()
    plugged_s = now_s(client)
    assert client.set("/virtual", "fault", "").successful
    assert client.wait_for(lambda: bool(since(client.states, plugged_s))), arm.log("driver")
    assert_held(client)
    lift(client)
    begin_push(client)
    assert_done(client)


def test_noise_on_the_wire(arm: Arm) -> None:
    client = arm.client
    assert client.set(
        "/excitation",
        "probe",
        str(push_file(arm.folder, 0.6, 0.6, 0.6)),
    ).successful
    assert client.set("/virtual", "fault", "corrupt=0.01,corrupt_requests=0.01").successful

    begun_s = now_s(client)
    begin_push(client)
    assert_done(client)
    assert client.excitation["good_runs"] == "3"
    assert max(abs(current_A(message)) for message in since(client.motors, begun_s)) < 0.6
    assert rate_hz(since(client.states, begun_s)) >= 0.95 * RATE_HZ
    assert client.set("/excitation", "probe", str(arm.push)).successful


def test_a_servo_that_overheats(arm: Arm) -> None:
    client = arm.client
    assert client.set("/excitation", "probe", str(push_file(arm.folder, PUSH_S, PUSH_S))).successful
    begin_push(client)
    hot_s = now_s(client)
    assert client.set("/virtual", "fault", f"overheat={ELBOW}").successful
    assert client.wait_for(lambda: client.motor(ELBOW) == 0.0)
    assert_aborted(client, ELBOW)

    def told() -> str:
        return " ".join(
            f"{status.name}: {status.message}" for status in client.diagnostics[-1].status
        )

    assert client.wait_for(lambda: f"{ELBOW}: overheat" in told().lower()), told()
    assert not client.call("/excitation/run").success or not pushed(client.motors[-1])
    after = since(client.motors, hot_s)
    off = next(row for row, message in enumerate(after) if current_A(message) == 0.0)
    assert all(current_A(message) == 0.0 for message in after[off:])
    assert client.set("/virtual", "fault", "").successful
    assert torque_is_on(client), arm.log("driver")
    assert_held(client)
    assert client.wait_for(lambda: "overheat" not in told().lower()), told()
    assert client.set("/excitation", "probe", str(arm.push)).successful


def test_an_encoder_that_jumps(arm: Arm) -> None:
    client = arm.client
    begin_push(client)
    jumped_s = now_s(client)
    assert client.set("/virtual", "fault", f"jump={ELBOW}").successful
    within_s = now_s(client) - jumped_s + COMMAND_TIMEOUT_S
    assert_aborted(client, "jump")
    assert_braked(client, jumped_s, within_s)


def test_a_joint_state_that_is_no_number(arm: Arm) -> None:
    client = arm.client
    publisher = client.node.create_publisher(JointState, "/joint_states", 10)
    assert client.wait_for(lambda: publisher.get_subscription_count() >= 3)
    future = client.begin("/identifier/calibrate_payload")
    await_push(client)
    begun_s = now_s(client)
    names = list(client.states[-1].name)
    publisher.publish(
        joint_state(
            round(1e9 * begun_s),
            names,
            [math.nan] * len(names),
            [0.0] * len(names),
        )
    )
    within_s = COMMAND_TIMEOUT_S
    assert_aborted(client, "nan")
    assert_braked(client, begun_s, within_s)
    answer = client.answer(future)
    assert not answer.success
    assert "aborted" in answer.message
    assert "nan" in answer.message


# --- commands -----------------------------------------------------------------------------------------------------------


def test_a_push_into_a_limit(arm: Arm) -> None:
    client = arm.client
    joint = "joint4"
    limit_rad = load_robot("open_manipulator_x").model.joint(joint).upper
    assert client.wait_for(lambda: client.positions.get_subscription_count() >= 1)
    client.positions.publish(labelled({joint: limit_rad - 0.5}))
    assert client.wait_for(
        lambda: abs(client.position(joint) - limit_rad + 0.5) < 0.1 and at_rest(client)
    )
    begun_s = now_s(client)
    ended = client.clock.event()

    def push() -> None:
        while not ended.wait(0.02):
            client.push({joint: 0.1})

    thread = client.clock.thread(push, "push", group="push")
    thread.start()
    try:
        assert client.wait_for(lambda: client.position(joint) > limit_rad - 0.2)
        assert client.wait_for(lambda: at_rest(client) and not any(client.applied[-1].effort)), (
            "held, although the commands go on"
        )
    finally:
        ended.set()
        thread.join()
    assert (
        max(
            client.position(joint),
            *(m.position[list(m.name).index(joint)] for m in since(client.motors, begun_s)),
        )
        < limit_rad
    )
    assert client.position(joint) > limit_rad - 0.2
    assert f"{joint} is at its upper limit; held" in arm.log("driver")


def test_a_flood_of_commands(arm: Arm) -> None:
    client = arm.client
    assert client.wait_for(
        lambda: at_rest(client) and client.currents.get_subscription_count() >= 1
    )
    before = client.motors[-1]
    flood = [
        labelled({"joint1": 0.0027}),
        labelled({"joint1": 0.0}),
        labelled({"joint1": math.nan}),
        labelled({"elbow": 0.1}),
        labelled({ELBOW: -300.0}),
        Float64MultiArray(data=[0.1, 0.1]),
    ]

    begun_s = now_s(client)
    for sent in range(2000):
        client.currents.publish(flood[sent % len(flood)])
        client.clock.sleep(1e-3)
    ended_s = now_s(client)
    assert client.wait_for(
        lambda: min(stamp_s(client.states[-1]), stamp_s(client.motors[-1])) > ended_s
    )
    for message in since(client.motors, begun_s):
        assert max(map(abs, message.effort)) < 0.6
        assert all(
            abs(now - was) < 0.03
            for now, was in zip(message.position, before.position, strict=True)
        )
    states = [state for state in since(client.states, begun_s) if stamp_s(state) < ended_s]
    assert len(states) / (ended_s - begun_s) >= 0.95 * RATE_HZ
    assert_held(client)


def test_a_stranger_in_mid_probe(arm: Arm) -> None:
    """Another program on the network sends zeros, a push of its own and goals; the probe does not notice."""
    client = arm.client
    ended = arm.client.clock.event()
    begin_push(client)
    before = client.motors[-1]

    def disturb() -> None:
        while not ended.wait(0.02):
            client.currents.publish(Float64MultiArray(data=[0.0] * 5))
            client.push({"joint4": -0.2})
            client.positions.publish(labelled({"joint1": 0.5}))

    thread = client.clock.thread(disturb, "stranger", group="stranger")
    thread.start()
    try:
        assert_done(client)
    finally:
        ended.set()
        thread.join()
    assert client.excitation["good_runs"] == "1"
    # from begin to end of the push: afterwards nobody has the arm, strangers may drive it, and the elbow's current may be
    # by chance that of the push
    during = list(takewhile(pushed, since(client.motors, stamp_s(before))))
    assert stamp_s(during[-1]) - stamp_s(before) > 0.2, "the push went on under disturbance"
    for joint in ("joint1", "joint4"):
        index = list(before.name).index(joint)
        reached = [message.position[index] for message in during]
        assert max(abs(position - before.position[index]) for position in reached) < 0.1, joint
    assert "driven by another publisher" in arm.log("driver")
    assert "another publisher is moving the arm" in arm.log("driver")


def test_deactivated_in_mid_probe(arm: Arm) -> None:
    """Anyone on the network can ask a lifecycle node for that; the arm must not fall."""
    client = arm.client

    driver = client.world.processes["driver"]
    begin_push(client)
    begun_s = now_s(client)
    driver.ask(lambda node: node.trigger_deactivate())
    try:
        assert_aborted(client, "the driver was inactive")
        assert client.wait_for(lambda: not pushed(client.motors[-1]))
        assert client.wait_for(
            lambda: at_rest(client) and not without_current(client.motors[-1])
        ), client.motors[-1]
        index = list(client.motors[-1].name).index("joint2")
        heights = [message.position[index] for message in since(client.motors, begun_s)]
        assert max(heights) - min(heights) < 0.1
        answer = client.call("/excitation/run")
        assert not answer.success
        assert "the driver is inactive" in answer.message
    finally:
        driver.ask(lambda node: node.trigger_activate())
    assert client.wait_for(lambda: driver_status(client)[0] == "running")
    assert_held(client)


def test_stop_in_mid_probe(arm: Arm) -> None:
    client = arm.client
    begin_push(client)
    begun_s = now_s(client)
    assert client.call("/driver/stop").success
    # a cycle, and 20 ms from one word of the virtual robot to the next
    within_s = now_s(client) - begun_s + 0.2
    assert_zero(client, begun_s, within_s)
    assert_aborted(client, "the driver was stopped: the current is zero; /driver/torque true")
    assert client.wait_for(lambda: driver_status(client)[0] == "stopped"), driver_status(client)
    # nobody's command gets through, and whoever asks hears what to do
    client.push({ELBOW: -0.3})
    for service in ("/excitation/run", "/identifier/calibrate_payload"):
        answer = client.call(service)
        assert not answer.success
        assert "the driver is stopped" in answer.message
        assert "/driver/torque true" in answer.message
    assert_zero(client, begun_s, within_s)
    assert not any(client.applied[-1].effort)
    assert torque_is_on(client)
    assert_held(client)


# --- services -----------------------------------------------------------------------------------------------------------


def test_one_probe_at_a_time(arm: Arm) -> None:
    client = arm.client
    future = client.begin("/identifier/calibrate_payload")
    await_push(client)
    answer = client.call("/identifier/calibrate_payload")
    assert not answer.success
    assert "busy: calibrate_payload is under way" in answer.message
    answer = client.call("/excitation/run")
    assert not answer.success
    assert "is under way" in answer.message
    assert client.excitation["phase"] == "probe"
    assert pushed(client.motors[-1])
    begun_s = now_s(client)
    answer = client.call("/identifier/cancel")
    assert answer.success
    assert "cancelled" in answer.message
    assert_braked(client, begun_s, now_s(client) - begun_s + COMMAND_TIMEOUT_S)
    answer = client.answer(future)
    assert not answer.success
    assert "cancelled" in answer.message
    assert list((arm.folder / "data").glob("*_payload/bag"))

    begin_push(client)
    begun_s = now_s(client)
    answer = client.call("/excitation/abort")
    assert answer.success
    assert "held" in answer.message
    assert_braked(client, begun_s, now_s(client) - begun_s + COMMAND_TIMEOUT_S)
    assert (
        client.call("/excitation/abort").message
        == client.call("/identifier/cancel").message
        == "nothing was under way"
    )


def test_of_a_call_whose_answer_is_lost_it_is_asked_again(
    arm: Arm, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Who answers drops what it would say to one that it has not heard of, and in the first moments it may not have."""
    client = arm.client
    named = client.world.processes["identifier"].node.excitation.set_probe
    call = named.call_async
    asked = list[Any]()

    def lost(request: Any) -> Any:
        asked.append(call(request))
        return Future() if len(asked) == 1 else asked[-1]

    monkeypatch.setattr(named, "call_async", lost)
    future = client.begin("/identifier/calibrate_payload")
    await_push(client)
    assert len(asked) == 2
    assert client.call("/identifier/cancel").success
    assert not client.answer(future).success


def torque_constants() -> dict[str, float]:
    drives = load_robot("open_manipulator_x").drive_trains
    return {
        name: drive.nominal_torque_constant / drive.transmission for name, drive in drives.items()
    }


def pushed_in(bag: Path) -> bool:
    """Whether a recording holds the push."""
    recording = read_recording(
        bag, nominal_torque_constants=torque_constants(), joint_order=list(torque_constants())
    )
    assert recording.inputs is not None
    return float(recording.inputs.current_A.min()) == pytest.approx(PUSH_A, abs=LIKE_PUSH_A)
