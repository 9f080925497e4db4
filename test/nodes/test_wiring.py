"""Real nodes in real processes over DDS, with a pseudo-terminal: they find each other, end and come back. Order and outcome only:
what an arm does meanwhile, and when, is in test/world.
"""

from __future__ import annotations

import json
import os
import resource
import signal
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.qos import QoSProfile
from std_srvs.srv import Trigger
from support.domains import unused_domain
from support.live import SOON_S, UP_S, Client, running, wait_for
from support.pushes import AWAY, one_push

from proprio_ros.clock import BEFORE_OTHERS
from proprio_ros.nodes.graph import Graph
from proprio_ros.nodes.messages import labelled, values_of
from proprio_ros.recordings.signals import read_recording
from proprio_ros.robot import load_robot
from proprio_ros.virtual.robot import PARKED

pytestmark = pytest.mark.long

ELBOW = "joint3"
PUSH_A = -0.28
NODES = ("virtual", "driver", "excitation", "identifier")
PATIENT: dict[str, dict[str, Any]] = {
    "driver": {"reply_timeout": 0.1, "command_timeout": 0.5}, "excitation": {"stale_after": 4.0},
}  # fmt: skip
"""Nobody here may take a late message for silence."""
QUIET_STATES = 150
"""At the 100 Hz of the driver longer than `command_timeout`."""


def push_file(folder: Path, duration_s: float) -> Path:
    path = folder / f"push_{duration_s:g}.yaml"
    path.write_text(one_push(PUSH_A, duration_s, AWAY))
    return path


@dataclass
class Arm:
    """Four processes, and a client.

    Attributes:
        gone: Subscriptions of drivers that were killed, which DDS counts for some time.
    """

    graph: Graph
    client: Client
    folder: Path
    gone: set[bytes] = field(default_factory=set)

    def obeying(self) -> set[bytes]:
        """Subscriptions of the drivers that take positions."""
        infos = self.client.node.get_subscriptions_info_by_topic("/position_command")
        return {
            bytes(info.endpoint_gid) for info in infos if info.node_name == "driver"
        } - self.gone

    @property
    def data(self) -> Path:
        return self.folder / "data"

    def parameters(self, node: str) -> dict[str, Any]:
        """With which a node is started again."""
        own = {
            "driver": {"port": self.folder / "bus"},
            "identifier": {"data_directory": self.data, "calibration": "none"},
        }
        return {
            **own.get(node, {}),
            **PATIENT.get(node, {}),
        }

    def begin_push(self, service: str = "/excitation/run") -> Any:
        """Ask for one that goes on until something ends it; returns what is answered."""
        endless = str(push_file(self.folder, 20.0))
        node, name = (
            ("/excitation", "probe")
            if service == "/excitation/run"
            else ("/identifier", "payload_sequence")
        )
        assert self.client.set(node, name, endless).successful
        future = self.client.begin(service)
        self.client.wait_for_phase("probe")
        assert wait_for(lambda: abs(self.client.motor(ELBOW) - PUSH_A) < 0.01)
        return future

    def lift(self) -> None:
        """Back to where a probe may begin; the goal is said with every state, for a driver whose bus was lost forgets it."""
        client = self.client
        said = {0}

        def there() -> bool:
            if len(client.motors) not in said:
                said.add(len(client.motors))
                client.positions.publish(labelled(PARKED))
            return all(abs(client.position(joint) - angle) < 0.1 for joint, angle in PARKED.items())

        assert wait_for(self.obeying)
        assert wait_for(there), client.motors[-1]
        # whoever moved the arm last is obeyed alone for command_timeout: the driver's time is counted in its states
        heard = len(client.motors)
        assert wait_for(lambda: len(client.motors) > heard + QUIET_STATES)

    def states_come(self) -> None:
        self.client.states.clear()
        assert wait_for(lambda: len(self.client.states) > 50), self.graph.log("driver")

    def driver_says(self) -> tuple[str, str]:
        status = self.client.diagnostics[-1].status[0]
        return str(values_of(status)["state"]), str(status.message)


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Arm]:
    folder = tmp_path_factory.mktemp("wiring")
    identifier = {"payload_sequence": str(push_file(folder, 0.6))}
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv("ROS_DOMAIN_ID", unused_domain())
        with running(
            folder,
            virtual={"object": 0.05},
            identifier=identifier,
            **PATIENT,
        ) as (
            graph,
            client,
        ):
            assert wait_for(lambda: bool(client.diagnostics))
            yield Arm(graph, client, folder)


def test_a_weighing_goes_through_all_of_them(arm: Arm) -> None:
    client = arm.client
    answer = client.asked("/identifier/calibrate_payload")
    assert wait_for(client.final), answer
    final = client.estimates[-1]
    assert answer.success == (final["verdict"] == "accepted")
    results = list(arm.data.glob("*_payload/estimate.json"))
    assert len(results) == 1, (
        f"{answer.message}\n{arm.graph.log('excitation')}\n{arm.graph.log('identifier')}"
    )
    (result,) = results
    assert json.loads(result.read_text())["verdict"] == final["verdict"]
    assert "<svg" in (result.parent / "report.html").read_text()
    assert list((result.parent / "bag").glob("*.mcap"))
    late = Client()
    try:
        assert wait_for(lambda: bool(late.estimates and late.statuses)), (
            "what stands is heard by those who come later"
        )
        assert late.estimates[-1] == final
    finally:
        late.close()
    assert client.get("/identifier", "calibration").string_value == "none"
    assert not client.set("/virtual", "object", "50 g").successful


def test_none_of_them_waits_for_other_programs(arm: Arm) -> None:
    """The driver, and here what stands for hardware, in real time; others come before programs; where that is granted."""
    of_node = {node: arm.graph.processes[node].pid for node in NODES}
    policies = {
        node: os.sched_getscheduler(pid) & ~os.SCHED_RESET_ON_FORK for node, pid in of_node.items()
    }
    if policies["driver"] != os.SCHED_RR:
        pytest.skip("no real-time class is granted here")
    urgent = {node for node, policy in policies.items() if policy == os.SCHED_RR}
    assert urgent == {"driver", "virtual"}
    others = [pid for node, pid in of_node.items() if node not in urgent]
    assert {os.sched_getscheduler(pid) for pid in others} == {os.SCHED_OTHER}
    assert {os.getpriority(os.PRIO_PROCESS, pid) for pid in others} == {BEFORE_OTHERS}


@pytest.mark.parametrize("service", ["/excitation/abort", "/identifier/cancel"])
def test_two_hundred_calls_at_once(arm: Arm, service: str) -> None:
    # on a busy computer a caller that keeps ten answers, rclpy's default, loses some by itself
    client = arm.client.node.create_client(
        Trigger,
        service,
        qos_profile=QoSProfile(depth=200),
    )
    assert wait_for(client.service_is_ready)
    answers = [client.call_async(Trigger.Request()) for _ in range(200)]
    assert wait_for(lambda: all(answer.done() for answer in answers)), sum(
        answer.done() for answer in answers
    )
    arm.client.node.destroy_client(client)


@pytest.mark.parametrize("node", NODES)
def test_a_transition_that_is_not_due(arm: Arm, node: str) -> None:
    """Anyone can ask for one by mistake: it is refused, and the node lives on."""
    for transition in (
        Transition(id=Transition.TRANSITION_CONFIGURE),
        Transition(id=99),
        Transition(label="fly"),
    ):
        request = ChangeState.Request(transition=transition)
        assert not arm.client.answer(
            arm.client.begin(f"/{node}/change_state", ChangeState, request)
        ).success
    assert f"lifecycle transition {Transition.TRANSITION_CONFIGURE} is refused" in arm.graph.log(
        node
    )
    assert arm.graph.processes[node].poll() is None


def test_one_that_is_due(arm: Arm) -> None:
    for transition, state in (
        (Transition.TRANSITION_DEACTIVATE, "inactive"),
        (Transition.TRANSITION_ACTIVATE, "running"),
    ):
        request = ChangeState.Request(transition=Transition(id=transition))
        assert arm.client.answer(
            arm.client.begin("/driver/change_state", ChangeState, request)
        ).success
        assert wait_for(lambda state=state: arm.driver_says()[0] == state), arm.driver_says()


def test_a_disk_that_is_full(arm: Arm) -> None:
    client = arm.client
    process = arm.graph.processes["identifier"]
    known = set(arm.data.glob("*_payload/bag"))
    arm.lift()
    assert client.set("/identifier", "payload_sequence", str(push_file(arm.folder, 0.6))).successful
    future = client.begin("/identifier/calibrate_payload")
    client.wait_for_phase("probe")
    _, hard = resource.prlimit(process.pid, resource.RLIMIT_FSIZE)
    resource.prlimit(
        process.pid,
        resource.RLIMIT_FSIZE,
        (4096, hard),
    )
    try:
        answer = client.answer(future)
    finally:
        resource.prlimit(
            process.pid,
            resource.RLIMIT_FSIZE,
            (hard, hard),
        )
    assert (
        not answer.success and "kept in memory" in answer.message and "\n" not in answer.message
    ), answer.message

    def saved() -> list[Path]:
        return [
            bag for bag in arm.data.glob("*_payload/bag") if bag not in known and any(bag.iterdir())
        ]

    assert wait_for(lambda: bool(saved()) and "is saved now" in arm.graph.log("identifier"))
    assert len(recorded(saved()[0]).joints.times_ns) > 50


def test_a_pulled_cable(arm: Arm) -> None:
    client = arm.client
    arm.lift()
    arm.begin_push()
    assert client.set("/virtual", "fault", "unplug").successful
    client.wait_for_phase("aborted")
    assert wait_for(lambda: client.motor(ELBOW) == 0.0), "the servos' own watchdog"
    assert wait_for(lambda: arm.driver_says()[0] == "disconnected")
    assert "check the cable" in arm.driver_says()[1]
    assert client.set("/virtual", "fault", "").successful
    arm.states_come()
    assert wait_for(lambda: any(client.motors[-1].effort)), "held again"


def test_the_identifier_is_killed(arm: Arm) -> None:
    arm.lift()
    arm.begin_push("/identifier/calibrate_payload")
    arm.graph.stop("identifier", signal.SIGKILL)
    arm.client.wait_for_phase("aborted")
    assert "has fallen silent" in arm.client.excitation["reason"]
    # what came until then is on disk, and a bag as soon as the node is back
    (journal,) = arm.data.glob("*_payload/messages.journal")
    arm.graph.start("identifier", arm.parameters("identifier"))
    assert wait_for(
        lambda: (journal.parent / "bag" / "metadata.yaml").exists() and not journal.exists(), UP_S
    )
    assert recorded(journal.parent / "bag").inputs is not None


def test_the_driver_is_killed(arm: Arm) -> None:
    arm.lift()
    arm.begin_push()
    arm.gone |= arm.obeying()
    arm.graph.stop("driver", signal.SIGKILL)
    assert wait_for(lambda: not any(arm.client.motors[-1].effort)), "the servos' own watchdog"
    arm.client.wait_for_phase("aborted")
    arm.graph.start("driver", arm.parameters("driver"))
    arm.states_come()
    assert wait_for(lambda: any(arm.client.motors[-1].effort)), "held again"


@pytest.mark.parametrize(
    ("node", "number"),
    [("excitation", signal.SIGTERM), ("identifier", signal.SIGTERM), ("driver", signal.SIGINT)],
)
def test_told_to_end(arm: Arm, node: str, number: int) -> None:
    """The last tests: the nodes are gone afterwards."""
    client = arm.client
    process = arm.graph.processes[node]
    if node == "excitation":
        arm.lift()
        arm.begin_push()
    process.send_signal(number)
    assert process.wait(SOON_S) == 0
    assert "Traceback" not in arm.graph.log(node)
    if node == "excitation":
        assert wait_for(lambda: client.excitation["phase"] == "aborted")
        assert "told to end" in client.excitation["reason"]
        assert any(client.motors[-1].effort), "the arm is held"
    if node == "driver":
        assert wait_for(lambda: not any(client.motors[-1].effort)), "and let go at the end"


def recorded(bag: Path) -> Any:
    drives = load_robot("open_manipulator_x").drive_trains
    constants = {
        name: drive.nominal_torque_constant / drive.transmission for name, drive in drives.items()
    }
    return read_recording(bag, nominal_torque_constants=constants, joint_order=list(constants))
