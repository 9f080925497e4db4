"""What goes wrong while a joint is pushed, with real processes: every way out ends with the arm held, or without current.

The true currents and the true motion come from the virtual robot, which knows nothing of what the other nodes say.
"""

from __future__ import annotations

import math
import re
import resource
import shutil
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise, takewhile
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from support.domains import free_domain
from support.live import SOON_S, UP_S, Client, running, wait_for

from proprio_ros.bus.driver import DriverSettings
from proprio_ros.nodes.graph import Graph
from proprio_ros.nodes.messages import joint_state, labelled, values_of
from proprio_ros.recordings.signals import read_recording
from proprio_ros.robot import load_robot
from proprio_ros.virtual.robot import PARKED

pytestmark = pytest.mark.long

ELBOW = "joint3"
PUSH_A = -0.280  # what the servo makes of -0.28 A: it counts in 2.69 mA
LIKE_PUSH_A = 0.002
# it lifts the forearm by 0.3 rad, to where its weight and friction balance the push, and no further: however late a test on a busy
# computer notices that a push has begun, it still goes on
PUSH_S = 5.0
RUN = (
    "{{joint: joint3, current_A: -0.28, duration_s: {duration_s}, max_travel: 1.5,"
    " start: {{joint2: -0.2, joint3: 0.8, joint4: 0.0}}}}"
)

# margins are for a computer whose two cores have other work, too; they begin when a call has been answered, or a signal was sent
COMMAND_TIMEOUT_S = DriverSettings().command_timeout_s + 0.3
WATCHDOG_S = DriverSettings().watchdog_s + 0.3
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
    """A running graph, and the probe that it is asked for."""

    graph: Graph
    client: Client
    folder: Path
    push: Path

    def log(self, node: str) -> str:
        return self.graph.log(node)


@contextmanager
def arm_of(folder: Path, *nodes: str, **options: Any) -> Iterator[Arm]:
    push = push_file(folder, PUSH_S)
    identifier = {"payload_sequence": str(push), "report": False} | options.pop("identifier", {})
    with running(folder, *nodes, identifier=identifier, **options) as (graph, client):
        assert wait_for(lambda: bool(client.motors and client.applied and client.diagnostics)), graph.log("driver")
        if "excitation" in graph.processes:
            assert client.set("/excitation", "probe", str(push)).successful
        yield Arm(graph, client, folder, push)


@pytest.fixture(scope="module")
def shared_graph(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Arm]:
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv("ROS_DOMAIN_ID", free_domain())
        with arm_of(tmp_path_factory.mktemp("faults")) as arm:
            yield arm


@pytest.fixture
def arm(shared_graph: Arm) -> Iterator[Arm]:
    """The shared graph; each test leaves it well."""
    lift(shared_graph.client)
    yield shared_graph
    client = shared_graph.client
    client.set("/virtual", "fault", "")
    client.call("/excitation/abort")
    shared_graph.graph.check()
    assert not any("Traceback" in shared_graph.log(node) for node in shared_graph.graph.processes)
    assert wait_for(lambda: torque_is_on(client)), shared_graph.log("driver")
    assert_held(client)
    assert wait_for(lambda: doing(client) == "idle"), doing(client)


@pytest.fixture
def own_domain(monkeypatch: pytest.MonkeyPatch) -> None:
    """A node that is killed stays known to others for 20 s; graphs that follow must not take its services for theirs."""
    monkeypatch.setenv("ROS_DOMAIN_ID", free_domain())


# --- what is true of the arm --------------------------------------------------------------------------------------------


def stamp_s(message: JointState) -> float:
    return float(message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec)


def since(messages: list[JointState], begun_s: float) -> list[JointState]:
    """The newest messages, back to that time."""
    newest_first = takewhile(lambda message: stamp_s(message) >= begun_s, reversed(list(messages)))
    return [*newest_first][::-1]


def current_A(message: JointState, joint: str = ELBOW) -> float:
    return float(message.effort[list(message.name).index(joint)])


def pushed(message: JointState) -> bool:
    return abs(current_A(message) - PUSH_A) < LIKE_PUSH_A


def without_current(message: JointState) -> bool:
    return not any(message.effort)


def lift(client: Client) -> None:
    """Put the arm where a probe may begin, as a person would who found it lying on the table."""
    said_s = -math.inf

    def there() -> bool:
        return all(abs(client.position(joint) - angle_rad) < 0.1 for joint, angle_rad in PARKED.items())

    def comes() -> bool:
        nonlocal said_s
        # again: a driver that was just started may not have heard it
        if not there() and time.monotonic() > said_s + 1.0:
            said_s = time.monotonic()
            client.positions.publish(labelled(PARKED))
        return there() and at_rest(client)

    assert wait_for(comes), client.motors[-1]


def at_rest(client: Client) -> bool:
    """No joint has moved in 0.3 s."""
    recent = client.motors[-20:]
    recent = [message for message in recent if stamp_s(message) > stamp_s(recent[-1]) - 0.32]
    spans = [max(column) - min(column) for column in zip(*(message.position for message in recent), strict=True)]
    return len(recent) >= 8 and max(spans) < 0.01


def assert_held(client: Client) -> None:
    """At rest, by motors that work against gravity, and nobody drives."""
    begun_s = time.time()
    assert wait_for(lambda: stamp_s(client.motors[-1]) > begun_s and at_rest(client)), client.motors[-1]
    assert wait_for(lambda: not without_current(client.motors[-1])), client.motors[-1]
    assert wait_for(lambda: not any(client.applied[-1].effort)), client.applied[-1]

    def stream() -> bool:
        """By stamps: how late we hear them says nothing of the driver."""
        newest_s = stamp_s(client.states[-1])
        return newest_s > begun_s + 0.5 and len(since(client.states, newest_s - 0.5)) > 0.25 * RATE_HZ

    assert wait_for(stream), driver_status(client)


def assert_braked(client: Client, begun_s: float, within_s: float) -> None:
    """The push ended in time, the elbow hardly moved after that, and is held."""
    assert wait_for(lambda: not pushed(client.motors[-1])), client.excitation
    assert_held(client)
    after = since(client.motors, begun_s)
    end = next(row for row, message in enumerate(after) if not pushed(message))
    assert stamp_s(after[end]) - begun_s < within_s
    index = list(after[end].name).index(ELBOW)
    braked_rad = after[end].position[index]
    assert all(abs(message.position[index] - braked_rad) < 0.2 for message in after[end:])
    assert sum(map(pushed, after[end:])) <= 0.2 * len(after[end:])  # on its way the current may pass that of the push


def assert_zero(client: Client, begun_s: float, within_s: float) -> None:
    """No motor is driven from that time on, and the driver says so."""
    assert wait_for(lambda: without_current(client.motors[-1])), client.motors[-1]
    seen_s = stamp_s(client.motors[-1])
    assert wait_for(lambda: stamp_s(client.motors[-1]) > seen_s + 0.2)
    after = since(client.motors, begun_s)
    end = next(row for row, message in enumerate(after) if without_current(message))
    assert stamp_s(after[end]) - begun_s < within_s
    velocities = [
        [(to - was) / (stamp_s(now) - stamp_s(before)) for was, to in zip(before.position, now.position, strict=True)]
        for before, now in pairwise(after[end:])
    ]
    for now, around in zip(after[end + 1 :], pairwise([*velocities, velocities[-1]]), strict=True):
        for joint, effort in enumerate(now.effort):
            # an arm that falls faster than its supply can turn it, by 4.8 rad/s, makes the motor a generator, and that brakes; a
            # mean from sample to sample is less than the speed at its end
            brakes = any(abs(row[joint]) > 2.0 and effort * row[joint] < 0.0 for row in around)
            assert effort == 0.0 or brakes, (stamp_s(now) - begun_s, now)


def kill(arm: Arm, node: str) -> float:
    """Kill a node; returns when it was."""
    arm.graph.processes[node].send_signal(signal.SIGKILL)
    killed_s = time.time()
    arm.graph.stop(node, signal.SIGKILL)
    return killed_s


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
    assert wait_for(lambda: pushed(client.motors[-1])), client.motors[-1]
    begun = next(message for message in reversed(list(client.motors)) if not pushed(message))
    begin_rad = begun.position[list(begun.name).index(ELBOW)]
    assert wait_for(lambda: client.position(ELBOW) < begin_rad - 0.03), client.motors[-1]


def begin_push(client: Client) -> None:
    answer = client.call("/excitation/run")
    if "no joint states are coming" in answer.message:  # nodes that have just started find each other within a second
        assert wait_for(lambda: client.call("/excitation/run").success)
    else:
        assert answer.success, answer.message
    await_push(client)


def assert_aborted(client: Client, *words: str) -> None:
    assert wait_for(lambda: client.excitation["busy"] == "false"), client.excitation
    assert client.excitation["phase"] == "aborted"
    assert any(word in client.excitation["reason"] for word in words), client.excitation["reason"]


def assert_done(client: Client) -> None:
    assert wait_for(lambda: client.excitation["busy"] == "false"), client.excitation
    assert client.excitation["phase"] == "done", client.excitation


def assert_soon(well: Callable[[], bool]) -> None:
    """True at the third try at the latest: others use this computer, too, and may have kept us from it."""
    assert any(well() for _ in range(3))


def rate_hz(states: list[JointState]) -> float:
    """Rate of joint states, by their stamps."""
    return (len(states) - 1) / (stamp_s(states[-1]) - stamp_s(states[0]))


# --- not ready ----------------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("own_domain")
def test_what_is_not_there_is_reported_at_once(tmp_path: Path) -> None:
    with running(tmp_path, "excitation", "identifier") as (graph, client):
        begun_s = time.monotonic()
        answer = client.call("/excitation/run")
        assert not answer.success and "start the driver" in answer.message
        answer = client.call("/identifier/calibrate_payload")
        assert not answer.success and "no joint states are coming" in answer.message
        graph.stop("excitation")
        # joint states do come, as from another driver
        publisher = client.node.create_publisher(JointState, "/joint_states", 10)
        ended = threading.Event()

        def publish() -> None:
            while not ended.wait(0.02):
                publisher.publish(JointState(name=["joint1"], position=[0.0]))

        thread = threading.Thread(target=publish)
        thread.start()
        try:
            assert wait_for(lambda: publisher.get_subscription_count() >= 2)
            answer = client.call("/identifier/calibrate_payload")
        finally:
            ended.set()
            thread.join()
        assert not answer.success and "no excitation node" in answer.message, answer.message
        assert time.monotonic() - begun_s < 45.0, "4 s of patience each, and a busy computer"
        assert not (tmp_path / "data").exists()


# --- processes that end -------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("own_domain")
def test_the_excitation_is_killed(tmp_path: Path) -> None:
    with arm_of(tmp_path) as arm:
        client = arm.client
        future = client.begin("/identifier/calibrate_payload")
        await_push(client)
        killed_s = kill(arm, "excitation")
        assert_braked(client, killed_s, COMMAND_TIMEOUT_S)
        answer = client.answer(future)
        assert not answer.success and "fallen silent" in answer.message
        bag = Path(answer.message.split("recording: ")[1])
        recording = read_recording(
            bag, nominal_torque_constants=torque_constants(), joint_order=list(torque_constants())
        )
        assert recording.inputs is not None and recording.inputs.current_A.min() == pytest.approx(
            PUSH_A, abs=LIKE_PUSH_A
        )
        assert_held(client)


@pytest.mark.usefixtures("own_domain")
def test_identifier_and_driver_are_killed(tmp_path: Path) -> None:
    pushes = {"payload_sequence": str(push_file(tmp_path, 0.6, PUSH_S))}
    with arm_of(tmp_path, identifier=pushes) as arm:
        client, graph = arm.client, arm.graph
        client.begin("/identifier/calibrate_payload")
        # in the second push: on a busy computer the identifier hears of the first one some tenths of a second after us
        assert wait_for(lambda: client.excitation.get("run") == "2"), client.excitation
        await_push(client)
        kill(arm, "identifier")
        assert_aborted(client, "whoever asked for the sequence has fallen silent")
        assert_held(client)
        # what came until then is on disk, and a bag as soon as the node is back
        (journal,) = (tmp_path / "data").glob("*_payload/messages.journal")
        graph.start("identifier", {"data_directory": tmp_path / "data", "calibration": "none", "report": False})
        assert wait_for(lambda: (journal.parent / "bag" / "metadata.yaml").exists() and not journal.exists(), UP_S)
        recording = read_recording(
            journal.parent / "bag", nominal_torque_constants=torque_constants(), joint_order=list(torque_constants())
        )
        assert recording.inputs is not None and recording.inputs.current_A.min() == pytest.approx(
            PUSH_A, abs=LIKE_PUSH_A
        )
        # a sequence that was asked for by hand is nobody's, and goes on
        lift(client)
        assert client.set("/excitation", "probe", str(arm.push)).successful

        begin_push(client)
        killed_s = kill(arm, "driver")
        assert_zero(client, killed_s, WATCHDOG_S)
        assert_aborted(client, "is the driver alive")
        graph.start("driver", {"port": tmp_path / "bus"})
        assert wait_for(lambda: bool(since(client.states, killed_s + 1.0)), UP_S), arm.log("driver")
        assert_held(client)
        lift(client)
        begin_push(client)
        assert_done(client)


@pytest.mark.usefixtures("own_domain")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_told_to_end(tmp_path: Path, number: int) -> None:
    with arm_of(tmp_path, "virtual", "driver", "excitation") as arm:
        client, graph = arm.client, arm.graph
        for node in ("excitation", "driver"):
            process = graph.processes[node]
            begin_push(client)
            process.send_signal(number)
            told_s = time.time()
            assert process.wait(SOON_S) == 0
            assert "Traceback" not in arm.log(node)
            if node == "excitation":
                assert_braked(client, told_s, COMMAND_TIMEOUT_S)
                assert_aborted(client, "told to end")
                graph.start("excitation", {"probe": str(arm.push)})
                client.wait_for_phase("idle", UP_S)
        assert_zero(client, told_s, 1.0)
        assert_aborted(client, "is the driver alive")


# --- the system's clock -------------------------------------------------------------------------------------------------

SHIM = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <pthread.h>
#include <semaphore.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/time.h>
#include <time.h>

static volatile const long *offset_s;

__attribute__((constructor)) static void map_offset(void) {
    int file = open(getenv("TEST_CLOCK_OFFSET"), O_RDONLY);
    offset_s = mmap(0, sizeof *offset_s, PROT_READ, MAP_SHARED, file, 0);
}

/* the newest of the functions of that name, where a library has several */
static void *next(const char *name, const char *version) {
    void *found = dlvsym(RTLD_NEXT, name, version);
    return found ? found : dlsym(RTLD_NEXT, name);
}

int clock_gettime(clockid_t clock, struct timespec *now) {
    static int (*real)(clockid_t, struct timespec *);
    if (!real) real = (int (*)(clockid_t, struct timespec *))next("clock_gettime", "GLIBC_2.17");
    int result = real(clock, now);
    if (clock == CLOCK_REALTIME && offset_s) now->tv_sec += *offset_s;
    return result;
}

int gettimeofday(struct timeval *now, void *zone) {
    struct timespec precise;
    (void)zone;
    clock_gettime(CLOCK_REALTIME, &precise);
    now->tv_sec = precise.tv_sec;
    now->tv_usec = precise.tv_nsec / 1000;
    return 0;
}

/* The kernel's clock stays: deadlines on the system's clock have to be told to it in its own time. Those on the monotonic
   clock are smaller than any date. */
static struct timespec kernel_time(const struct timespec *deadline) {
    struct timespec translated = *deadline;
    if (offset_s && deadline->tv_sec > 1000000000) translated.tv_sec -= *offset_s;
    return translated;
}

int pthread_cond_timedwait(pthread_cond_t *condition, pthread_mutex_t *mutex, const struct timespec *deadline) {
    static int (*real)(pthread_cond_t *, pthread_mutex_t *, const struct timespec *);
    if (!real)
        real = (int (*)(pthread_cond_t *, pthread_mutex_t *, const struct timespec *))next("pthread_cond_timedwait", "GLIBC_2.3.2");
    struct timespec translated = kernel_time(deadline);
    return real(condition, mutex, &translated);
}

int pthread_mutex_timedlock(pthread_mutex_t *mutex, const struct timespec *deadline) {
    static int (*real)(pthread_mutex_t *, const struct timespec *);
    if (!real) real = (int (*)(pthread_mutex_t *, const struct timespec *))next("pthread_mutex_timedlock", "GLIBC_2.34");
    struct timespec translated = kernel_time(deadline);
    return real(mutex, &translated);
}

int sem_timedwait(sem_t *semaphore, const struct timespec *deadline) {
    static int (*real)(sem_t *, const struct timespec *);
    if (!real) real = (int (*)(sem_t *, const struct timespec *))next("sem_timedwait", "GLIBC_2.34");
    struct timespec translated = kernel_time(deadline);
    return real(semaphore, &translated);
}
"""


@pytest.mark.usefixtures("own_domain")
@pytest.mark.skipif(shutil.which("gcc") is None, reason="needs gcc")
def test_the_clock_is_set_in_mid_probe(tmp_path: Path) -> None:
    offset = tmp_path / "offset"
    offset.write_bytes((0).to_bytes(8, "little", signed=True))
    source, library = tmp_path / "shim.c", tmp_path / "shim.so"
    source.write_text(SHIM)
    subprocess.run(["gcc", "-shared", "-fPIC", "-O1", "-o", library, source, "-ldl"], check=True, timeout=60)
    environment = {"LD_PRELOAD": str(library), "TEST_CLOCK_OFFSET": str(offset)}
    # a computer's clock is that of all nodes
    with arm_of(tmp_path, "virtual", "driver", "excitation", environment=environment) as arm:
        client = arm.client
        jumped_s = 0
        for jump_s in (10, -20):
            assert wait_for(lambda: at_rest(client))
            client.states.clear()
            client.applied.clear()
            begin_push(client)
            jumped_s += jump_s
            with offset.open("r+b") as file:  # in place: the file is mapped
                file.write(jumped_s.to_bytes(8, "little", signed=True))
            assert_done(client)

            def told_s() -> list[float]:
                return [
                    float(told) for told in re.findall(r"the system's clock was set by (\S+) s;", arm.log("driver"))
                ]

            # a thread may have been kept waiting between two looks at two clocks
            assert wait_for(lambda jump=jump_s: any(abs(told - jump) < 0.1 for told in told_s())), arm.log("driver")
            assert wait_for(lambda jumped=jumped_s: abs(stamp_s(client.states[-1]) - time.time() - jumped) < 5.0), (
                "stamps follow it then"
            )
            steps_s = [stamp_s(after) - stamp_s(before) for before, after in pairwise(client.states)]
            jumps = [row for row, step_s in enumerate(steps_s) if not 0.0 < step_s < 1.0]
            assert len(jumps) == 1 and abs(steps_s[jumps[0]] - jump_s) < 0.1, [steps_s[row] for row in jumps]
            driven_s = [stamp_s(message) for message in client.applied if any(message.effort)]
            assert abs(driven_s[-1] - driven_s[0] - PUSH_S) < 1.0, "and not in mid-probe"
        # what watches for silence still does
        begin_push(client)
        arm.graph.processes["driver"].send_signal(signal.SIGSTOP)
        try:
            assert wait_for(lambda: without_current(client.motors[-1]))
            assert_aborted(client, "is the driver alive")
        finally:
            arm.graph.processes["driver"].send_signal(signal.SIGCONT)
        assert wait_for(lambda: at_rest(client) and not without_current(client.motors[-1])), arm.log("driver")


# --- the wire and the servos --------------------------------------------------------------------------------------------


def test_a_pulled_cable(arm: Arm) -> None:
    client, driver = arm.client, arm.graph.processes["driver"]
    begin_push(client)
    pulled_s = time.time()
    assert client.set("/virtual", "fault", "unplug").successful
    assert_zero(client, pulled_s, time.time() - pulled_s + WATCHDOG_S)
    assert_aborted(client, "is the driver alive")
    assert wait_for(lambda: driver_status(client)[0] == "disconnected")
    assert "check the cable" in driver_status(client)[1]
    client.states.clear()
    plugged_s = time.time()
    assert client.set("/virtual", "fault", "").successful
    assert wait_for(lambda: bool(since(client.states, plugged_s))), arm.log("driver")
    assert_held(client)
    assert driver.poll() is None
    lift(client)
    begin_push(client)
    assert_done(client)


def test_noise_on_the_wire(arm: Arm) -> None:
    client = arm.client
    assert client.set("/excitation", "probe", str(push_file(arm.folder, 0.6, 0.6, 0.6))).successful
    assert client.set("/virtual", "fault", "corrupt=0.01,corrupt_requests=0.01").successful

    def one_sequence() -> float:
        begun_s = time.time()
        begin_push(client)
        assert_done(client)
        assert client.excitation["good_runs"] == "3"
        assert max(abs(current_A(message)) for message in since(client.motors, begun_s)) < 0.6
        return rate_hz(since(client.states, begun_s))

    assert_soon(lambda: one_sequence() >= 0.95 * RATE_HZ)
    assert client.set("/excitation", "probe", str(arm.push)).successful


def test_a_servo_that_overheats(arm: Arm) -> None:
    client = arm.client
    assert client.set("/excitation", "probe", str(push_file(arm.folder, PUSH_S, PUSH_S))).successful
    begin_push(client)
    hot_s = time.time()
    assert client.set("/virtual", "fault", f"overheat={ELBOW}").successful
    assert wait_for(lambda: client.motor(ELBOW) == 0.0)
    assert_aborted(client, ELBOW)

    def told() -> str:
        return " ".join(f"{status.name}: {status.message}" for status in client.diagnostics[-1].status)

    assert wait_for(lambda: f"{ELBOW}: overheat" in told().lower()), told()
    assert not client.call("/excitation/run").success or not pushed(client.motors[-1])
    after = since(client.motors, hot_s)
    off = next(row for row, message in enumerate(after) if current_A(message) == 0.0)
    assert all(current_A(message) == 0.0 for message in after[off:])
    assert client.set("/virtual", "fault", "").successful
    assert torque_is_on(client), arm.log("driver")
    assert_held(client)
    assert wait_for(lambda: "overheat" not in told().lower()), told()
    assert client.set("/excitation", "probe", str(arm.push)).successful


def test_an_encoder_that_jumps(arm: Arm) -> None:
    client = arm.client
    begin_push(client)
    jumped_s = time.time()
    assert client.set("/virtual", "fault", f"jump={ELBOW}").successful
    within_s = time.time() - jumped_s + COMMAND_TIMEOUT_S
    assert_aborted(client, "jump")
    assert_braked(client, jumped_s, within_s)


def test_a_joint_state_that_is_no_number(arm: Arm) -> None:
    client = arm.client
    publisher = client.node.create_publisher(JointState, "/joint_states", 10)
    assert wait_for(lambda: publisher.get_subscription_count() >= 3)
    future = client.begin("/identifier/calibrate_payload")
    await_push(client)
    begun_s = time.time()
    names = list(client.states[-1].name)
    for _ in range(20):  # a subscriber may be busy until the driver's next sample has taken the place of a single one
        publisher.publish(joint_state(time.time_ns(), names, [math.nan] * len(names), [0.0] * len(names)))
        time.sleep(0.001)
    within_s = time.time() - begun_s + COMMAND_TIMEOUT_S
    assert_aborted(client, "nan")
    assert_braked(client, begun_s, within_s)
    answer = client.answer(future)
    assert not answer.success and "aborted" in answer.message and "nan" in answer.message


# --- commands -----------------------------------------------------------------------------------------------------------


def test_a_push_into_a_limit(arm: Arm) -> None:
    client, joint = arm.client, "joint4"
    limit_rad = load_robot("open_manipulator_x").model.joint(joint).upper
    assert wait_for(lambda: client.positions.get_subscription_count() >= 1)
    client.positions.publish(labelled({joint: limit_rad - 0.5}))
    assert wait_for(lambda: abs(client.position(joint) - limit_rad + 0.5) < 0.1 and at_rest(client))
    begun_s = time.time()
    ended = threading.Event()

    def push() -> None:
        while not ended.wait(0.02):
            client.push({joint: 0.1})

    thread = threading.Thread(target=push)
    thread.start()
    try:
        assert wait_for(lambda: client.position(joint) > limit_rad - 0.2)
        # where our commands paused for longer than their deadline it is driven on for a moment, and held again
        assert wait_for(lambda: at_rest(client) and not any(client.applied[-1].effort)), (
            "held, although the commands go on"
        )
    finally:
        ended.set()
        thread.join()
    assert (
        max(client.position(joint), *(m.position[list(m.name).index(joint)] for m in since(client.motors, begun_s)))
        < limit_rad
    )
    assert client.position(joint) > limit_rad - 0.2
    assert f"{joint} is at its upper limit; held" in arm.log("driver")


def test_a_flood_of_commands(arm: Arm) -> None:
    client = arm.client
    assert wait_for(lambda: at_rest(client) and client.currents.get_subscription_count() >= 1)
    before = client.motors[-1]
    flood = [
        labelled({"joint1": 0.0027}),
        labelled({"joint1": 0.0}),
        labelled({"joint1": math.nan}),
        labelled({"elbow": 0.1}),
        labelled({ELBOW: -300.0}),
        Float64MultiArray(data=[0.1, 0.1]),
    ]

    def rate_in_flood() -> float:
        sent, begun_s, until_s = 0, time.time(), time.monotonic() + 2.0
        while time.monotonic() < until_s or sent < 2000:
            client.currents.publish(flood[sent % len(flood)])
            sent += 1
        ended_s = time.time()
        assert wait_for(lambda: min(stamp_s(client.states[-1]), stamp_s(client.motors[-1])) > ended_s)
        for message in since(client.motors, begun_s):
            assert max(map(abs, message.effort)) < 0.6
            assert all(abs(now - was) < 0.03 for now, was in zip(message.position, before.position, strict=True))
        states = [state for state in since(client.states, begun_s) if stamp_s(state) < ended_s]
        return len(states) / (ended_s - begun_s)

    assert_soon(lambda: rate_in_flood() >= 0.95 * RATE_HZ)
    assert_held(client)


def test_a_stranger_in_mid_probe(arm: Arm) -> None:
    """Another program on the network sends zeros, a push of its own and goals; the probe does not notice."""
    client, ended = arm.client, threading.Event()
    begin_push(client)
    before = client.motors[-1]

    def disturb() -> None:
        while not ended.wait(0.02):
            client.currents.publish(Float64MultiArray(data=[0.0] * 5))
            client.push({"joint4": -0.2})
            client.positions.publish(labelled({"joint1": 0.5}))

    thread = threading.Thread(target=disturb)
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

    def change(transition: int) -> bool:
        request = ChangeState.Request(transition=Transition(id=transition))
        return bool(client.answer(client.begin("/driver/change_state", ChangeState, request)).success)

    begin_push(client)
    begun_s = time.time()
    assert change(Transition.TRANSITION_DEACTIVATE)
    try:
        assert_aborted(client, "the driver was inactive")
        assert wait_for(lambda: not pushed(client.motors[-1]))
        assert wait_for(lambda: at_rest(client) and not without_current(client.motors[-1])), client.motors[-1]
        index = list(client.motors[-1].name).index("joint2")
        heights = [message.position[index] for message in since(client.motors, begun_s)]
        assert max(heights) - min(heights) < 0.1
        answer = client.call("/excitation/run")
        assert not answer.success and "the driver is inactive" in answer.message
    finally:
        assert change(Transition.TRANSITION_ACTIVATE)
    assert wait_for(lambda: driver_status(client)[0] == "running")
    assert_held(client)


@pytest.mark.parametrize("node", ["driver", "excitation", "identifier", "virtual"])
def test_a_transition_that_is_not_due(arm: Arm, node: str) -> None:
    """Anyone can ask for one by mistake: it is refused, and the node lives on."""
    client = arm.client
    for transition in (Transition(id=Transition.TRANSITION_CONFIGURE), Transition(id=99), Transition(label="fly")):
        answer = client.answer(
            client.begin(f"/{node}/change_state", ChangeState, ChangeState.Request(transition=transition))
        )
        assert not answer.success
    assert f"lifecycle transition {Transition.TRANSITION_CONFIGURE} is refused" in arm.log(node)
    assert arm.graph.processes[node].poll() is None
    assert_held(client)


def test_stop_in_mid_probe(arm: Arm) -> None:
    client = arm.client
    begin_push(client)
    begun_s = time.time()
    assert client.call("/driver/stop").success
    within_s = time.time() - begun_s + 0.2  # a cycle, and 20 ms from one word of the virtual robot to the next
    assert_zero(client, begun_s, within_s)
    assert_aborted(client, "the driver was stopped: the current is zero; /driver/torque true")
    assert wait_for(lambda: driver_status(client)[0] == "stopped"), driver_status(client)
    # nobody's command gets through, and whoever asks hears what to do
    client.push({ELBOW: -0.3})
    for service in ("/excitation/run", "/identifier/calibrate_payload"):
        answer = client.call(service)
        assert (
            not answer.success and "the driver is stopped" in answer.message and "/driver/torque true" in answer.message
        )
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
    assert not answer.success and "busy: calibrate_payload is under way" in answer.message
    answer = client.call("/excitation/run")
    assert not answer.success and "is under way" in answer.message
    assert client.excitation["phase"] == "probe" and pushed(client.motors[-1])
    begun_s = time.time()
    answer = client.call("/identifier/cancel")
    assert answer.success and "cancelled" in answer.message
    assert_braked(client, begun_s, time.time() - begun_s + COMMAND_TIMEOUT_S)
    answer = client.answer(future)
    assert not answer.success and "cancelled" in answer.message
    assert list((arm.folder / "data").glob("*_payload/bag"))

    begin_push(client)
    begun_s = time.time()
    answer = client.call("/excitation/abort")
    assert answer.success and "held" in answer.message
    assert_braked(client, begun_s, time.time() - begun_s + COMMAND_TIMEOUT_S)
    assert (
        client.call("/excitation/abort").message == client.call("/identifier/cancel").message == "nothing was under way"
    )


def test_a_disk_that_is_full(arm: Arm) -> None:
    client, process = arm.client, arm.graph.processes["identifier"]
    known = set((arm.folder / "data").glob("*_payload/bag"))
    future = client.begin("/identifier/calibrate_payload")
    await_push(client)
    _, hard = resource.prlimit(process.pid, resource.RLIMIT_FSIZE)
    resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (4096, hard))
    try:
        assert_done(client)
        answer = client.answer(future)
    finally:
        resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (hard, hard))
    assert not answer.success and "kept in memory" in answer.message and "\n" not in answer.message, answer.message

    def saved() -> list[Path]:
        return [bag for bag in (arm.folder / "data").glob("*_payload/bag") if bag not in known and any(bag.iterdir())]

    assert wait_for(lambda: bool(saved()) and "is saved now" in arm.log("identifier")), arm.log("identifier")
    recording = read_recording(
        saved()[0], nominal_torque_constants=torque_constants(), joint_order=list(torque_constants())
    )
    assert len(recording.joints.times_ns) > 100


def torque_constants() -> dict[str, float]:
    drives = load_robot("open_manipulator_x").drive_trains
    return {name: drive.nominal_torque_constant / drive.transmission for name, drive in drives.items()}
