"""The identifier node in the test's own process, with nobody beside it: what it publishes, keeps and refuses."""

from __future__ import annotations

import math
import re
import threading
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")

import rclpy
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64MultiArray, String
from std_srvs.srv import Trigger
from support.domains import free_domain
from visualization_msgs.msg import Marker

from proprio_ros.calibration_files.motors import MotorIdentity
from proprio_ros.errors import ConfigurationError, RobotError
from proprio_ros.experiment_design.candidates import Push
from proprio_ros.experiment_design.choosing import Decision
from proprio_ros.identification.estimate import Estimate, Value, Verdict
from proprio_ros.inputs.resources import resource
from proprio_ros.live.job import WEIGH, Job, JobError
from proprio_ros.live.online_estimator import current_A
from proprio_ros.live.session import Session, live_request
from proprio_ros.nodes import driver, identifier, jobs, managed_node, messages
from proprio_ros.pipeline.request import Options, Request
from proprio_ros.probes import probe_named
from proprio_ros.quantity import Sought
from proprio_ros.recordings.messages import RawMessage
from proprio_ros.recordings.sources import BagSource
from proprio_ros.recordings.writer import write_messages
from proprio_ros.robot import Robot, load_robot
from proprio_ros.robot.kinematics import zero_pose

MASS = Sought("mass", "kg")
BOX = {"container.inner_size": [0.06, 0.04, 0.04], "sphere.radius": 0.01}


class Published(list[Any]):
    """In a publisher's place."""

    def publish(self, message: Any) -> None:
        self.append(message)


class Service:
    """In the place of a service; a response goes to whoever stands as its header."""

    def send_response(
        self,
        response: Any,
        answers: list[tuple[bool, str]],
    ) -> None:
        answers.append((response.success, response.message))


class Identifier(identifier.IdentifierNode):
    """What the node publishes and answers is kept here, and goes nowhere else.

    Attributes:
        published: By topic as the node names it, without ``~/``.
        offered: Services by their name.
    """

    def __init__(self, **kwargs: Any) -> None:
        self.published: dict[str, Published] = {}
        self.offered: dict[str, Any] = {}
        super().__init__(**kwargs)

    def create_publisher(self, kind: Any, topic: str, *given: Any, **more: Any) -> Any:
        ours = topic.startswith("~/") or topic.endswith("/lease")
        if not ours or "transition" in topic:  # rclpy's own
            return super().create_publisher(
                kind,
                topic,
                *given,
                **more,
            )
        return self.published.setdefault(topic.removeprefix("~/"), Published())

    def create_service(self, kind: Any, name: str, *given: Any, **more: Any) -> Any:
        if kind is not Trigger:
            return super().create_service(
                kind,
                name,
                *given,
                **more,
            )
        return self.offered.setdefault(name.removeprefix("~/"), Service())

    def call(
        self,
        service: str,
    ) -> list[tuple[bool, str]]:
        """The answers, once there are some."""
        answers: list[tuple[bool, str]] = []
        self.offered[service].send_response(Trigger.Response(), answers)
        return answers

    def hear(self, topic: str, *given: Any) -> None:
        """A message has come."""
        (subscription,) = (each for each in self.subscriptions if each.topic_name == topic)
        subscription.callback(*given)

    @property
    def status(self) -> Any:
        """The newest one."""
        return self.published["status"][-1]


class Nodes:
    """Makes nodes with parameters, in a namespace."""

    def __init__(self) -> None:
        self._made: list[tuple[Any, Any]] = []

    def make(self, kind: type, namespace: str = "", **parameters: Any) -> Any:
        words = [
            "--ros-args",
            *(["-r", f"__ns:=/{namespace}"] if namespace else []),
        ]
        words += [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
        context = rclpy.Context()
        rclpy.init(args=words, context=context)
        self._made.append((kind(context=context), context))
        return self._made[-1][0]

    def identifier(self, namespace: str = "", **parameters: Any) -> Any:
        node = self.make(Identifier, namespace, **parameters)
        node.check_values()
        node.configure()
        return node

    def close(self) -> None:
        for node, context in self._made:
            node.destroy_node()
            context.try_shutdown()


@pytest.fixture
def nodes(monkeypatch: pytest.MonkeyPatch) -> Iterator[Nodes]:
    monkeypatch.setenv("ROS_DOMAIN_ID", free_domain())
    # compiles kernels, and none is run here
    monkeypatch.setattr(identifier, "prepare_identification", lambda *given: None)
    made = Nodes()
    yield made
    made.close()


def answer(
    probe: str,
    value: float | None,
    verdict: Verdict = Verdict.ACCEPTED,
) -> Estimate:
    name, unit = probe_named(probe).answer
    known = Value(
        name,
        unit,
        value,
        None if value is None else 0.001,
    )
    return Estimate(
        probe,
        "open_manipulator_x",
        verdict,
        (),
        (known,),
        None,
        None,
        1,
    )


def entries(status: Any) -> dict[str, str]:
    return {pair.key: pair.value for pair in status.values}


def entries_of(node: Any) -> dict[str, str]:
    """Keys and values of the newest estimate."""
    (status,) = node.published["estimate"][-1].status
    return entries(status)


@pytest.mark.parametrize("granted", [True, False])
def test_it_says_where_no_priority_is_granted(
    nodes: Nodes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, granted: bool
) -> None:
    monkeypatch.setattr(managed_node, "come_before_others", lambda threads: granted)
    node = nodes.identifier(data_directory=tmp_path, calibration="none")
    said: list[str] = []
    monkeypatch.setattr(
        node,
        "say",
        lambda severity, words: said.append(words),
    )
    node.hear_before_others()
    assert not said, "a thread beside others decides nothing for them"
    node.hearing = {1}
    node.hear_before_others()
    assert said == [managed_node.NOT_GRANTED] * (not granted)


def test_the_size_of_a_block_is_asked_for(
    nodes: Nodes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    node = nodes.identifier(data_directory=tmp_path, calibration="none")
    node._prepared = True
    refused = node._on_parameters([Parameter("block_size", value="3 cm")])
    assert not refused.successful and "block.size" in refused.reason
    said: list[str] = []
    monkeypatch.setattr(node, "say", lambda severity, words: said.append(f"{severity}: {words}"))
    probe = probe_named("softness")
    for stated, size in (
        ("", [0.03] * 3),
        ("0.04", [0.04] * 3),
        ("[0.03, 0.02, 0.04]", [0.03, 0.02, 0.04]),
    ):
        assert node._on_parameters([Parameter("block_size", value=stated)]).successful
        node.set_parameters([Parameter("block_size", value=stated)])
        task = node.jobs._task(Job(probe.name, "calibrate_softness"), probe)
        assert task.request.facts.block.size.tolist() == pytest.approx(size)
        node.jobs._say_what_is_guessed(task)
    (words,) = said
    assert words.startswith("warning: parameter block_size is empty.") and "35 %" in words


def test_a_baseline_that_is_none_is_refused_when_it_is_stated(nodes: Nodes, tmp_path: Path) -> None:
    node = nodes.identifier(data_directory=tmp_path, calibration="none")
    node._prepared = True
    name = "container_baseline"
    for stated, why in (
        ("/dev/zero", "that is no recording"),
        (str(tmp_path), "not readable as a ROS 2 bag|no recording|metadata"),
        ("/nowhere", "there is no such recording"),
    ):
        result = node._on_parameters([Parameter(name, value=stated)])
        assert not result.successful
        assert re.search(why, result.reason), result.reason
        assert "\n" not in result.reason
    bag = Path(__file__).parents[2] / "bags" / "contents_rigid_r45_h59" / "baseline_0"
    for stated in ("", "none", str(bag)):
        assert node._on_parameters([Parameter(name, value=stated)]).successful


def test_what_stood_of_the_hand_is_withdrawn(nodes: Nodes, tmp_path: Path) -> None:
    node = nodes.identifier(data_directory=tmp_path, calibration="none")
    node.results.withdraw()
    numbers = ("mass", "sphere_mass", "payload")
    assert not any(node.published[name] for name in numbers), "nothing stands at the beginning"
    node.results.publish(
        live_request(Options()),
        answer("payload", 0.05),
    )
    assert node.published["mass"][-1].data == 0.05
    assert node.published["payload"][-1].inertia.m == 0.05
    assert node.published["payload"][-1].inertia.ixx > 0.0
    assert entries_of(node)["inertia"] == "assumed"
    assert not node.published["sphere_mass"]
    node.results.withdraw()
    assert math.isnan(node.published["mass"][-1].data)
    load = node.published["payload"][-1].inertia
    assert all(math.isnan(value) for value in (load.m, load.com.x, load.ixx, load.iyz))
    assert [marker.action for marker in node.published["markers"][-1].markers] == [Marker.DELETEALL]
    node.results.publish(
        live_request(Options()),
        answer("payload", None, Verdict.REJECTED),
    )
    assert len(node.published["mass"]) == 2, "what is not accepted puts nothing in its place"
    # a sphere's mass is told from a payload's by its topic
    node.results.publish(
        live_request(Options(probe="container", settings=BOX)), answer("container", 0.012)
    )
    assert node.published["mass"][-1].data == node.published["sphere_mass"][-1].data == 0.012
    node.results.withdraw()
    assert all(math.isnan(node.published[name][-1].data) for name in ("mass", "sphere_mass"))


def test_the_load_has_the_inertia_that_a_motion_identified_or_else_what_is_stated(
    nodes: Nodes, tmp_path: Path
) -> None:
    node = nodes.identifier(data_directory=tmp_path, calibration="none")
    weighed = answer("payload", 0.05)
    entries = [1e-3, 1e-5, 2e-5, 2e-3, 3e-5, 3e-3]
    for found, source, ixx in (
        (entries, "identified", 1e-3),
        ([None, *entries[1:]], "stated", 0.05 * 0.03**2 / 6.0),
    ):
        both = replace(
            weighed, values=(*weighed.values, Value("payload_inertia", "kg m^2", found, None))
        )
        node.results.publish(
            live_request(Options(settings={"payload.shape": "cube", "payload.size": 0.03})), both
        )
        assert entries_of(node)["inertia"] == source
        assert node.published["payload"][-1].inertia.ixx == pytest.approx(ixx)
    node.results.publish(
        live_request(Options()),
        answer("payload", None, Verdict.REJECTED),
    )
    assert "inertia" not in entries_of(node)


def test_a_job_that_fails_says_so_where_the_last_answer_stood(
    nodes: Nodes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    node = nodes.identifier(data_directory=tmp_path, calibration="none")
    node.active = True
    node.results.publish(
        live_request(Options()),
        answer("payload", 0.05),
    )
    asked: list[Job] = []
    begun = threading.Event()

    def fail(job: Job) -> tuple[bool, str]:
        asked.append(job)
        begun.set()
        raise JobError("no object")

    monkeypatch.setattr(node.jobs, "make", fail)
    answers = node.call("calibrate_payload")
    begun.wait()
    asked[0].ended.wait()
    answered = node.call("cancel")
    assert answered == [(True, "nothing was under way")]
    assert answers == [(False, "no object")]
    entries = entries_of(node)
    assert entries["payload_mass"] == "not determined"
    assert entries["verdict"] == "failed"
    assert entries["reason.1"] == "no object"
    assert math.isnan(node.published["mass"][-1].data)


def test_each_namespace_has_its_data_its_frames_and_its_diagnostics(
    nodes: Nodes, tmp_path: Path
) -> None:
    (tmp_path / "open_manipulator_x_calibration.yaml").write_text(
        "no calibration, and of another arm"
    )
    node = nodes.identifier("arm1", data_directory=tmp_path, frame_prefix="arm1/")
    assert node.workspace.calibration is None
    assert node.workspace.data == tmp_path / "arm1"
    node.results.publish(
        live_request(Options()),
        answer("payload", 0.05),
    )
    assert node.published["payload"][-1].header.frame_id == "arm1/end_effector_link"
    assert node.published["markers"][-1].markers[-1].header.frame_id == "arm1/end_effector_link"
    arm = nodes.make(
        driver.DriverNode,
        "arm1",
        port=tmp_path / "port",
    )
    arm.configure()
    assert arm.diagnosed == "arm1/driver"


def test_a_calibration_of_another_arm_is_not_used(
    nodes: Nodes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    newest = tmp_path / "open_manipulator_x_calibration.yaml"
    newest.write_text("extends: pendulum\n")  # has no calibration
    assert nodes.identifier(data_directory=tmp_path).workspace.calibration is None
    with pytest.raises(RobotError, match=r"the parameter calibration .* holds no calibration"):
        nodes.identifier(data_directory=tmp_path, calibration=newest)


def test_what_the_driver_says_of_its_motors_is_part_of_a_recording(
    nodes: Nodes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    node = nodes.identifier("arm1", data_directory=tmp_path)
    elbow = MotorIdentity(1020, 13, 46, 7, 0, 10)
    node.inputs.on_motors(
        serialize_message(
            messages.status(
                "ok",
                "motors",
                "",
                {"joint3": elbow.as_text()},
                "",
            )
        )
    )
    assert node.inputs.published_motors() == []  # no driver of ours runs
    monkeypatch.setattr(
        node,
        "count_publishers",
        lambda topic: int(topic == "/arm1/motors"),
    )
    state = messages.joint_state(
        1_700_000_000 * 10**9,
        ["joint3"],
        [0.1],
    )
    states = RawMessage(
        "/arm1/joint_states", "sensor_msgs/msg/JointState", 1, serialize_message(state)
    )
    write_messages(
        tmp_path / "bag",
        [states, *node.inputs.published_motors()],
    )
    with BagSource(tmp_path / "bag") as source:
        assert source.motors(None) == {"joint3": elbow}


def test_how_warm_the_motors_are_is_part_of_a_recording(
    nodes: Nodes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    node = nodes.identifier("arm1", data_directory=tmp_path)
    node.inputs.on_motors(
        serialize_message(
            messages.status(
                "ok",
                "motors",
                "",
                {},
                "",
            )
        )
    )
    node.inputs.on_temperatures(
        serialize_message(messages.labelled({"joint2": 31.0, "joint3": 35.0}))
    )
    assert node.inputs.temperatures_C() == {}  # no driver of ours runs
    monkeypatch.setattr(
        node, "count_publishers", lambda topic: int(topic.startswith("/arm1/motor"))
    )
    assert node.inputs.temperatures_C() == {"joint2": 31.0, "joint3": 35.0}
    session = node.inputs.session = Session(tmp_path, "payload")
    node.inputs.on_temperatures(
        serialize_message(messages.labelled({"joint2": 33.0, "joint3": 35.0}))
    )
    assert len(session) == 1
    state = messages.joint_state(
        1_700_000_000 * 10**9,
        ["joint3"],
        [0.1],
    )
    session.add("/arm1/joint_states", "sensor_msgs/msg/JointState", 1, serialize_message(state))
    bag, _ = session.save()
    with BagSource(bag) as source:
        assert source.temperatures(None) == {"joint2": 33.0, "joint3": 35.0}
    node.inputs.session = None


ELBOW_LIFTS = {"joint2": -1.0, "joint3": 0.5}


def undecided(robot: Robot) -> Decision:
    """50 g, not yet known well enough: the elbow is to lift next."""
    start = zero_pose(robot) | ELBOW_LIFTS
    push = Push(
        "joint3",
        start,
        -0.34,
        0.0,
        0.5,
        3.4,
        2e-4,
        0.1,
        -0.6,
    )
    return Decision(
        None,
        "",
        "",
        0.05,
        8e-4,
        4e-4,
        push,
        (),
        0.1,
        MASS,
    )


def test_the_push_that_comes_next_is_shown(nodes: Nodes, tmp_path: Path) -> None:
    node = nodes.identifier(
        data_directory=tmp_path,
        calibration="none",
        frame_prefix="arm1/",
    )
    robot = load_robot("open_manipulator_x")
    node.results.choice(robot, undecided(robot), {"joint2": -1.0})
    first, words, line, end = node.published["next_push"][-1].markers
    assert first.action == Marker.DELETEALL
    assert {m.header.frame_id for m in (words, line, end)} == {"arm1/link1"}
    assert words.text == "50.0 g +- 0.80 g\nnext: joint3 -340 mA, then +-0.40 g"
    way = np.array([[p.x, p.y, p.z] for p in line.points])
    # the elbow lifts the hand
    assert line.type == Marker.LINE_STRIP
    assert len(way) == 20
    assert way[-1, 2] > way[0, 2] + 0.05
    start = zero_pose(robot) | ELBOW_LIFTS
    for place, pose in ((0, start), (-1, start | {"joint3": -0.1})):
        np.testing.assert_allclose(
            way[place], robot.model.frame_transform(robot.payload_frame, pose)[:3, 3]
        )
    assert (end.pose.position.x, end.pose.position.z) == (way[-1, 0], way[-1, 2])


def test_before_the_first_answer_and_after_the_last_push_words_are_shown(
    nodes: Nodes, tmp_path: Path
) -> None:
    node = nodes.identifier(data_directory=tmp_path, calibration="none")
    shown = node.published["next_push"]
    robot = load_robot("open_manipulator_x")
    decision = undecided(robot)
    unknown = replace(decision, value=0.06, half=0.2, promised=4e-3, is_known=False)
    node.results.choice(robot, unknown, {})
    assert shown[-1].markers[1].text.startswith("not weighed yet\nnext: joint3")
    sure = replace(decision, reason="sure", ended_by="target", half=4e-4, push=None)
    node.results.choice(robot, sure, {"joint2": -1.0})
    assert [m.type for m in shown[-1].markers[1:]] == [Marker.TEXT_VIEW_FACING]
    assert shown[-1].markers[1].text.endswith("ended by: target")
    node.results.withdraw()
    assert [m.action for m in shown[-1].markers] == [Marker.DELETEALL]


def test_what_cannot_be_recorded_is_said_before_anything_moves(
    nodes: Nodes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    blocked = tmp_path / "blocked"
    blocked.write_text("a file where a folder should be")
    node = nodes.identifier(data_directory=blocked, calibration="none")
    asked: list[str] = []
    node.excitation.make = lambda job, sequence, begun: asked.append(sequence)
    job = Job("payload", "calibrate_payload")
    request = Request(load_robot("open_manipulator_x"))
    with pytest.raises(
        JobError, match=r"not begun: .*blocked cannot be written .*the parameter data_directory"
    ):
        node.jobs.record(job, "payload", "payload_elbow", request)
    node.workspace.data = tmp_path / "data"
    monkeypatch.setattr(jobs, "LONGEST_CHECK_S", 0.0)
    with pytest.raises(JobError, match="not begun: "):
        node.jobs.record(job, "payload", "payload_elbow", request)
    assert not asked
    assert not list(node.workspace.data.iterdir())


def test_topics_with_other_names_are_part_of_the_command_that_replays(
    nodes: Nodes, tmp_path: Path
) -> None:
    usual = nodes.identifier(
        "arm1", data_directory=tmp_path, calibration="none"
    ).workspace.options()
    assert usual.state_topic is usual.command_topic is usual.effort_unit is None
    stated = {"state_topic": "/arm/states", "command_topic": "drive", "effort_unit": "mA"}
    options = nodes.identifier(
        "arm1", data_directory=tmp_path, calibration="none", **stated
    ).workspace.options()
    assert (options.state_topic, options.command_topic, options.effort_unit) == (
        "/arm/states",
        "/arm1/drive",
        "mA",
    )
    with pytest.raises(ConfigurationError, match=r"choose one of N\.m, A, mA, raw"):
        nodes.identifier(data_directory=tmp_path, effort_unit="furlongs")


def test_a_robot_that_is_a_topic_is_ready_when_its_description_comes(
    nodes: Nodes, tmp_path: Path
) -> None:
    stated = {"robot": "robot_description", "data_directory": tmp_path}
    node = nodes.identifier("arm1", **stated, effort_unit="N.m")
    node.active = True
    ((begun, why),) = node.call("calibrate_payload")
    assert not begun
    assert "not ready: waits for /arm1/robot_description" in why
    urdf = String(data=resource("urdf", "open_manipulator_x").read_text())
    node.hear("/arm1/robot_description", urdf)
    assert node.inputs.joints == [b"joint1", b"joint2", b"joint3", b"joint4"]
    assert entries(node.status)["doing"] == "idle"
    assert node.status.message == "ready"
    described = Path(node.workspace.options().robot)
    assert described.is_file()
    assert described.is_relative_to(tmp_path / "arm1" / "descriptions")
    file = nodes.identifier(
        "arm3", **(stated | {"robot": resource("urdf", "open_manipulator_x")}), effort_unit="N.m"
    )
    assert file.inputs.joints == node.inputs.joints
    # what effort is, nobody said, so torque constants are missing: that and how to state it is one line
    node = nodes.identifier("arm2", **stated)
    node.active = True
    node.hear("/arm2/robot_description", urdf)
    assert "the parameter effort_unit N.m where torque was recorded" in node.status.message
    ((begun, why),) = node.call("calibrate_payload")
    assert not begun
    assert "the parameter effort_unit N.m where torque was recorded" in why
    assert entries(node.status)["doing"] == "starting"


def test_what_drives_the_joints_must_be_said_by_somebody(nodes: Nodes, tmp_path: Path) -> None:
    node = nodes.identifier(data_directory=tmp_path, calibration="none")
    assert (
        "nobody publishes /applied_effort or listens to /current_command" in node.inputs.missing()
    )
    assert not nodes.identifier(
        data_directory=tmp_path, calibration="none", effort_unit="A"
    ).inputs.missing()
    servos = nodes.identifier(
        data_directory=tmp_path,
        calibration="none",
        robot="so101",
    )
    assert "nobody publishes where the servos are sent, /joint_command" in servos.inputs.missing()
    servos.create_publisher(JointState, "/joint_command", 1)
    assert servos.inputs.missing() == ""
    assert {"/joint_command", "/battery_state"} <= {
        each.topic_name for each in servos.subscriptions
    }


def test_weighing_the_last_seconds_is_refused_with_the_reason(nodes: Nodes, tmp_path: Path) -> None:
    node = nodes.identifier(
        data_directory=tmp_path,
        calibration="none",
        running="true",
    )
    job = Job(WEIGH, "weigh")
    with pytest.raises(JobError, match=r"no calibration of motions.*proprio calibrate BAG"):
        node.weighing.weigh(job, node.jobs.identify)
    assert node.inputs.kept is None and node.inputs.may_skip("joint_states"), (
        "nothing is kept for what cannot be done"
    )
    node.inputs.kept = deque()
    assert not node.inputs.may_skip("joint_states")
    assert node.inputs.may_skip("applied_effort")
    with pytest.raises(JobError, match="give the parameter driver or effort_unit"):
        node.weighing.weigh(job, node.jobs.identify)
    hear = {
        role: node.inputs.listener(f"/{role}", role, JointState)
        for role in ("joint_states", "applied_effort")
    }
    hear["applied_effort"](b"")
    # it may go to somebody else's driver
    with pytest.raises(JobError, match="give the parameter driver or effort_unit"):
        node.weighing.weigh(job, node.jobs.identify)
    node.create_publisher(Float64MultiArray, "applied_current", 1)  # as our own driver has
    with pytest.raises(JobError, match="no joint states are coming"):
        node.weighing.weigh(job, node.jobs.identify)
    for number in range(20):
        still = messages.joint_state(
            10**7 * number, ["joint1", "wheel"], [0.001 * (number % 2), number], [], [0.0, 0.0]
        )
        hear["joint_states"](serialize_message(still))
    with pytest.raises(JobError, match="no joint moved in the last 15 s"):
        node.weighing.weigh(job, node.jobs.identify)
    assert not list(tmp_path.iterdir()), "what is refused leaves no recording"


def test_only_the_last_seconds_are_kept(nodes: Nodes, tmp_path: Path) -> None:
    node = nodes.identifier(data_directory=tmp_path, calibration="none")
    node.inputs.kept = deque(
        [
            RawMessage(
                "/joint_states",
                "",
                node.get_clock().now().nanoseconds - age * 10**9,
                b"",
            )
            for age in (16, 14)
        ]
    )
    node.inputs.listener("/joint_states", "joint_states", JointState)(
        serialize_message(JointState())
    )
    assert len(node.inputs.kept) == 2, "15 s"


def test_what_an_effort_says_of_a_current() -> None:
    assert [current_A(3.0, unit, 1.5) for unit in ("A", "mA", "N.m")] == [3.0, 0.003, 2.0]


class Future:
    """An answer that is there at once."""

    def __init__(self, answer: Any) -> None:
        self._answer = answer

    def add_done_callback(
        self,
        done: Callable[[Any], None],
    ) -> None:
        done(self)

    def result(self) -> Any:
        return self._answer


def test_a_refused_sequence_is_asked_for_again_only_while_no_joint_states_reach_the_excitation(
    nodes: Nodes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    node = nodes.identifier(data_directory=tmp_path, calibration="none")
    job = Job("payload", "calibrate_payload")
    excitation = node.excitation
    excitation.values = {
        "sequence": "1",
        "busy": "false",
        "phase": "done",
    }
    asked: list[str] = []
    known = SimpleNamespace(results=[SimpleNamespace(successful=True)])
    monkeypatch.setattr(
        excitation.set_probe,
        "call_async",
        lambda request: Future(known),
    )

    def run(request: Any) -> Future:
        asked.append("run")
        if len(asked) == 1:  # its status says so as it refuses, in whatever words
            excitation.on_status(
                messages.status(
                    "ok",
                    "excitation",
                    "",
                    {"joint_states": False},
                )
            )
            excitation.values = {
                "sequence": "1",
                "busy": "false",
                "phase": "done",
            }
            return Future(SimpleNamespace(success=False, message="nothing to be seen"))
        return Future(SimpleNamespace(success=True, message="sequence 1: payload, 1 runs"))

    monkeypatch.setattr(excitation.run, "call_async", run)
    excitation.make(job, "payload", lambda: None)
    assert len(asked) == 2
    lease = [message.data for message in node.published["excitation/lease"]]
    assert lease == [True, False], "asked for, and not any more"

    def refuse(request: Any) -> Future:
        asked.append("run")
        words = "no joint states is what this refusal is not about"
        return Future(SimpleNamespace(success=False, message=words))

    monkeypatch.setattr(excitation.run, "call_async", refuse)
    with pytest.raises(JobError, match="refuses"):
        excitation.make(job, "payload", lambda: None)
    assert len(asked) == 3


def test_the_estimate_of_a_run_takes_the_current_command_where_no_effort_comes(
    nodes: Nodes, tmp_path: Path
) -> None:
    inputs = nodes.identifier(data_directory=tmp_path, calibration="none").inputs
    taken: list[dict[str, float]] = []
    inputs.live = SimpleNamespace(
        joints=("joint2", "joint3"), add_command=lambda at_ns, current_A: taken.append(current_A)
    )
    inputs.session = SimpleNamespace(add=lambda *message: None)
    hear = inputs.listener("/current_command", "current_command", Float64MultiArray)
    for current in (0.2, 0.0):
        hear(serialize_message(messages.labelled({"joint2": 0.0, "joint3": current})))
        assert inputs.driven is (current != 0.0)
    assert [each["joint3"] for each in taken] == [0.2, 0.0]


def test_a_joint_was_let_go_of_when_that_was_said_and_not_when_it_was_heard(
    nodes: Nodes, tmp_path: Path
) -> None:
    node = nodes.identifier(data_directory=tmp_path, calibration="none")
    kept: list[int] = []
    node.inputs.session = SimpleNamespace(
        add=lambda topic, msgtype, time_ns, data: kept.append(time_ns)
    )
    now_ns = node.get_clock().now().nanoseconds
    late_ns = now_ns - 4 * 10**8
    foreign_ns = now_ns - 3600 * 10**9
    for sent_ns in (late_ns, foreign_ns):  # a computer with another clock says nothing of ours
        hear = {
            subscription.topic_name: subscription.callback for subscription in node.subscriptions
        }
        hear["/torque_enabled"](
            serialize_message(Bool(data=False)),
            {"source_timestamp": sent_ns},
        )
    assert kept[0] == late_ns
    assert kept[1] >= now_ns


def test_a_driver_is_named_in_one_word(nodes: Nodes, tmp_path: Path) -> None:
    given: dict[str, Any] = {"data_directory": tmp_path, "calibration": "none"}
    node = nodes.identifier("cell", **given, driver="robotis")
    assert node.inputs.measured_unit() == "raw"
    assert node.inputs.missing() == ""
    heard = {subscription.topic_name for subscription in node.subscriptions}
    assert {"/cell/joint_states", "/cell/forward_effort_controller/commands"} <= heard
    options = node.workspace.options()
    assert options.driver == "robotis"
    assert options.effort_unit is None
    assert options.state_topic is None and options.command_topic is None, (
        "found in the bag as they were found here"
    )
    assert current_A(100.0, "raw", 1.78) == pytest.approx(0.269)
    assert (
        nodes.identifier(**given, driver="robotis", effort_unit="A").inputs.measured_unit() == "A"
    ), "what is stated wins"
    assert nodes.identifier(**given).inputs.measured_unit() == ""
    with pytest.raises(
        ConfigurationError,
        match="the parameter driver ur_torque: this effort lacks what holds the arm",
    ):
        nodes.identifier(**given, driver="ur_torque")


def test_joints_that_a_driver_calls_otherwise_are_known(nodes: Nodes, tmp_path: Path) -> None:
    (tmp_path / "left.yaml").write_text(
        "extends: ros2_control\njoint_prefix: left_\njoint_names: {elbow: joint3}\n"
    )
    node = nodes.identifier(
        data_directory=tmp_path, calibration="none", driver=tmp_path / "left.yaml"
    )
    assert node.inputs.joints[:3] == [b"left_joint1", b"left_joint2", b"left_elbow"]
    assert node.inputs.conventions.renamed(["left_elbow", "joint1"])[0] == "joint3"


@pytest.mark.parametrize("ahead_s", [0, 3600, -3600])
def test_a_joint_state_is_as_late_as_it_waited_here(
    nodes: Nodes, tmp_path: Path, ahead_s: int
) -> None:
    """The first that is heard as well; by how much the sender's clock is ahead does not matter."""
    late_ns = nodes.identifier(data_directory=tmp_path, calibration="none").inputs.late_ns
    second = 10**9
    now_ns = 1_700_000_000 * second

    def sent(came_ns: int) -> dict[str, int]:
        return {"received_timestamp": came_ns, "source_timestamp": came_ns + ahead_s * second}

    assert late_ns(100, now_ns, sent(now_ns - 8 * second)) == 8 * second
    assert late_ns(100, now_ns, sent(now_ns)) == 0
    # a computer's clock that was set while it waited; and a middleware that says nothing
    assert late_ns(60, now_ns, sent(now_ns - 3600 * second)) == 0
    assert late_ns(60, now_ns, {}) == 0
