"""The identifier node in the test's own process, with nobody beside it: what it publishes, keeps and refuses."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")

import rclpy
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64MultiArray, String
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
from proprio_ros.robot import load_robot
from proprio_ros.robot.kinematics import zero_pose

MASS = Sought("mass", "kg")
BOX = {"container.inner_size": [0.06, 0.04, 0.04], "sphere.radius": 0.01}


class Published(list[Any]):
    """In a publisher's place."""

    def publish(self, message: Any) -> None:
        self.append(message)


class Nodes:
    """Makes nodes with parameters, in a namespace."""

    def __init__(self) -> None:
        self._made: list[tuple[Any, Any]] = []

    def make(self, kind: type, namespace: str = "", **parameters: Any) -> Any:
        words = ["--ros-args", *(["-r", f"__ns:=/{namespace}"] if namespace else [])]
        words += [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
        context = rclpy.Context()
        rclpy.init(args=words, context=context)
        self._made.append((kind(context=context), context))
        return self._made[-1][0]

    def identifier(self, namespace: str = "", **parameters: Any) -> Any:
        node = self.make(identifier.IdentifierNode, namespace, **parameters)
        node._configure()
        for name in ("_estimate", "_load", "_markers"):
            setattr(node._results, name, Published())
        node._results._numbers = {name: Published() for name in node._results._numbers}
        node._excitation._lease = Published()
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
    known = Value(name, unit, value, None if value is None else 0.001)
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


def entries_of(node: Any) -> dict[str, str]:
    """Keys and values of the newest estimate."""
    (status,) = node._results._estimate[-1].status
    return {pair.key: pair.value for pair in status.values}


@pytest.mark.parametrize("granted", [True, False])
def test_it_says_where_real_time_is_not_granted(
    nodes: Nodes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, granted: bool
) -> None:
    monkeypatch.setattr(managed_node, "run_in_real_time", lambda threads: granted)
    node = nodes.identifier(data_directory=tmp_path, calibration="none")
    said: list[str] = []
    monkeypatch.setattr(node, "say", lambda severity, words: said.append(words))
    node.hear_in_real_time()
    assert not said, "a thread beside others decides nothing for them"
    node.hearing = {1}
    node.hear_in_real_time()
    assert said == [managed_node.NOT_GRANTED] * (not granted)


def test_what_stood_of_the_hand_is_withdrawn(nodes: Nodes, tmp_path: Path) -> None:
    node = nodes.identifier(data_directory=tmp_path, calibration="none")
    node._results.withdraw()
    assert not any(node._results._numbers.values()) and not node._results._load, (
        "nothing stands at the beginning"
    )
    node._results.publish(live_request(Options()), answer("payload", 0.05))
    assert (
        node._results._numbers["mass"][-1].data == 0.05
        and node._results._load[-1].inertia.m == 0.05
    )
    assert node._results._load[-1].inertia.ixx > 0.0 and entries_of(node)["inertia"] == "assumed"
    assert not node._results._numbers["sphere_mass"]
    node._results.withdraw()
    assert math.isnan(node._results._numbers["mass"][-1].data)
    load = node._results._load[-1].inertia
    assert all(math.isnan(value) for value in (load.m, load.com.x, load.ixx, load.iyz))
    assert [marker.action for marker in node._results._markers[-1].markers] == [Marker.DELETEALL]
    node._results.publish(
        live_request(Options()),
        answer("payload", None, Verdict.REJECTED),
    )
    assert len(node._results._numbers["mass"]) == 2, (
        "what is not accepted puts nothing in its place"
    )
    # a sphere's mass is told from a payload's by its topic
    node._results.publish(
        live_request(Options(probe="container", settings=BOX)), answer("container", 0.012)
    )
    assert (
        node._results._numbers["mass"][-1].data
        == node._results._numbers["sphere_mass"][-1].data
        == 0.012
    )
    node._results.withdraw()
    assert all(
        math.isnan(node._results._numbers[name][-1].data) for name in ("mass", "sphere_mass")
    )


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
        node._results.publish(
            live_request(Options(settings={"payload.shape": "cube", "payload.size": 0.03})), both
        )
        assert entries_of(node)["inertia"] == source and node._results._load[
            -1
        ].inertia.ixx == pytest.approx(ixx)
    node._results.publish(
        live_request(Options()),
        answer("payload", None, Verdict.REJECTED),
    )
    assert "inertia" not in entries_of(node)


def test_a_job_that_fails_says_so_where_the_last_answer_stood(nodes: Nodes, tmp_path: Path) -> None:
    node = nodes.identifier(data_directory=tmp_path, calibration="none")
    node.active = True
    node._results.publish(live_request(Options()), answer("payload", 0.05))
    node._jobs.make = lambda job: (_ for _ in ()).throw(JobError("no object"))
    answers: list[Any] = []
    node._work(Job("payload", "calibrate_payload"), lambda *given: answers.append(given))
    assert answers == [(False, "no object")]
    told = entries_of(node)
    assert (
        told["payload_mass"] == "not determined"
        and told["verdict"] == "failed"
        and told["reason.1"] == "no object"
    )
    assert math.isnan(node._results._numbers["mass"][-1].data)


def test_each_namespace_has_its_data_its_frames_and_its_diagnostics(
    nodes: Nodes, tmp_path: Path
) -> None:
    (tmp_path / "open_manipulator_x_calibration.yaml").write_text(
        "no calibration, and of another arm"
    )
    node = nodes.identifier("arm1", data_directory=tmp_path, frame_prefix="arm1/")
    assert node._workspace.calibration is None and node._workspace.data == tmp_path / "arm1"
    node._results.publish(live_request(Options()), answer("payload", 0.05))
    assert node._results._load[-1].header.frame_id == "arm1/end_effector_link"
    assert node._results._markers[-1].markers[-1].header.frame_id == "arm1/end_effector_link"
    arm = nodes.make(driver.DriverNode, "arm1", port=tmp_path / "port")
    arm.configure()
    assert arm._diagnosed == "arm1/driver"


def test_a_calibration_of_another_arm_is_not_used(
    nodes: Nodes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    newest = tmp_path / "open_manipulator_x_calibration.yaml"
    newest.write_text("extends: pendulum\n")  # has no calibration
    assert nodes.identifier(data_directory=tmp_path)._workspace.calibration is None
    with pytest.raises(RobotError, match=r"the parameter calibration .* holds no calibration"):
        nodes.identifier(data_directory=tmp_path, calibration=newest)


def test_what_the_driver_says_of_its_motors_is_part_of_a_recording(
    nodes: Nodes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    node = nodes.identifier("arm1", data_directory=tmp_path)
    elbow = MotorIdentity(1020, 13, 46, 7, 0, 10)
    node._inputs.on_motors(
        serialize_message(messages.status("ok", "motors", "", {"joint3": elbow.as_text()}, ""))
    )
    assert node._inputs.published_motors() == []  # no driver of ours runs
    monkeypatch.setattr(node, "count_publishers", lambda topic: int(topic == "/arm1/motors"))
    state = messages.joint_state(1_700_000_000 * 10**9, ["joint3"], [0.1])
    states = RawMessage(
        "/arm1/joint_states", "sensor_msgs/msg/JointState", 1, serialize_message(state)
    )
    write_messages(tmp_path / "bag", [states, *node._inputs.published_motors()])
    with BagSource(tmp_path / "bag") as source:
        assert source.motors(None) == {"joint3": elbow}


def test_how_warm_the_motors_are_is_part_of_a_recording(
    nodes: Nodes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    node = nodes.identifier("arm1", data_directory=tmp_path)
    node._inputs.on_motors(serialize_message(messages.status("ok", "motors", "", {}, "")))
    node._inputs.on_temperatures(
        serialize_message(messages.labelled({"joint2": 31.0, "joint3": 35.0}))
    )
    assert node._inputs.temperatures_C() == {}  # no driver of ours runs
    monkeypatch.setattr(
        node, "count_publishers", lambda topic: int(topic.startswith("/arm1/motor"))
    )
    assert node._inputs.temperatures_C() == {"joint2": 31.0, "joint3": 35.0}
    session = node._inputs.session = Session(tmp_path, "payload")
    node._inputs.on_temperatures(
        serialize_message(messages.labelled({"joint2": 33.0, "joint3": 35.0}))
    )
    assert len(session) == 1
    state = messages.joint_state(1_700_000_000 * 10**9, ["joint3"], [0.1])
    session.add("/arm1/joint_states", "sensor_msgs/msg/JointState", 1, serialize_message(state))
    bag, _ = session.save()
    with BagSource(bag) as source:
        assert source.temperatures(None) == {"joint2": 33.0, "joint3": 35.0}
    node._inputs.session = None


def test_the_push_that_comes_next_is_shown(nodes: Nodes, tmp_path: Path) -> None:
    node = nodes.identifier(data_directory=tmp_path, calibration="none", frame_prefix="arm1/")
    results = node._results
    robot = load_robot("open_manipulator_x")
    results._planned = shown = Published()
    start = zero_pose(robot) | {"joint2": -1.0, "joint3": 0.5}
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
    results.choice(
        robot,
        Decision(
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
        ),
        {"joint2": -1.0},
    )
    first, words, line, end = shown[-1].markers
    assert first.action == Marker.DELETEALL and {m.header.frame_id for m in (words, line, end)} == {
        "arm1/link1"
    }
    assert words.text == "50.0 g +- 0.80 g\nnext: joint3 -340 mA, then +-0.40 g"
    way = np.array([[p.x, p.y, p.z] for p in line.points])
    # the elbow lifts the hand
    assert line.type == Marker.LINE_STRIP and len(way) == 20 and way[-1, 2] > way[0, 2] + 0.05
    for place, pose in ((0, start), (-1, start | {"joint3": -0.1})):
        np.testing.assert_allclose(
            way[place], robot.model.frame_transform(robot.payload_frame, pose)[:3, 3]
        )
    assert (end.pose.position.x, end.pose.position.z) == (way[-1, 0], way[-1, 2])
    results.choice(
        robot,
        Decision(
            None,
            "",
            "",
            0.06,
            0.2,
            4e-3,
            push,
            (),
            0.1,
            MASS,
            is_known=False,
        ),
        {},
    )
    assert shown[-1].markers[1].text.startswith("not weighed yet\nnext: joint3")
    results.choice(
        robot,
        Decision(
            None,
            "sure",
            "target",
            0.05,
            4e-4,
            4e-4,
            None,
            (),
            0.1,
            MASS,
        ),
        {"joint2": -1.0},
    )
    assert [m.type for m in shown[-1].markers[1:]] == [Marker.TEXT_VIEW_FACING]
    assert shown[-1].markers[1].text.endswith("ended by: target")
    results.withdraw()
    assert [m.action for m in shown[-1].markers] == [Marker.DELETEALL]


def test_what_cannot_be_recorded_is_said_before_anything_moves(
    nodes: Nodes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    blocked = tmp_path / "blocked"
    blocked.write_text("a file where a folder should be")
    node = nodes.identifier(data_directory=blocked, calibration="none")
    asked: list[str] = []
    node._excitation.make = lambda job, sequence, begun: asked.append(sequence)
    job = Job("payload", "calibrate_payload")
    request = Request(load_robot("open_manipulator_x"))
    with pytest.raises(
        JobError, match=r"not begun: .*blocked cannot be written .*the parameter data_directory"
    ):
        node._jobs.record(job, "payload", "payload_elbow", request)
    node._workspace.data = tmp_path / "data"
    monkeypatch.setattr(jobs, "LONGEST_CHECK_S", 0.0)
    with pytest.raises(JobError, match="not begun: "):
        node._jobs.record(job, "payload", "payload_elbow", request)
    assert not asked and not list(node._workspace.data.iterdir())


def test_topics_with_other_names_are_part_of_the_command_that_replays(
    nodes: Nodes, tmp_path: Path
) -> None:
    usual = nodes.identifier(
        "arm1", data_directory=tmp_path, calibration="none"
    )._workspace.options()
    assert usual.state_topic is usual.command_topic is usual.effort_unit is None
    stated = {"state_topic": "/arm/states", "command_topic": "drive", "effort_unit": "mA"}
    options = nodes.identifier(
        "arm1", data_directory=tmp_path, calibration="none", **stated
    )._workspace.options()
    assert (options.state_topic, options.command_topic, options.effort_unit) == (
        "/arm/states",
        "/arm1/drive",
        "mA",
    )
    with pytest.raises(ConfigurationError, match=r"choose one of N\.m, A, mA, raw"):
        nodes.identifier(data_directory=tmp_path, effort_unit="counts")


def test_a_robot_that_is_a_topic_is_ready_when_its_description_comes(
    nodes: Nodes, tmp_path: Path
) -> None:
    stated = {"robot": "robot_description", "data_directory": tmp_path}
    node = nodes.identifier("arm1", **stated, effort_unit="N.m")
    node.active = True
    answers: list[Any] = []
    node._begin("payload", lambda *given: answers.append(given))
    assert answers and "not ready: waits for /arm1/robot_description" in answers[0][1]
    urdf = String(data=resource("urdf", "open_manipulator_x").read_text())
    node._on_description(node._described, urdf)
    assert (
        node._inputs._joints == [b"joint1", b"joint2", b"joint3", b"joint4"] and not node._missing()
    )
    assert node._workspace.options().robot == str(node._described.path)
    file = nodes.identifier(
        "arm3", **(stated | {"robot": resource("urdf", "open_manipulator_x")}), effort_unit="N.m"
    )
    assert file._inputs._joints == node._inputs._joints
    # what effort is, nobody said, so torque constants are missing: that and how to state it is one line
    node = nodes.identifier("arm2", **stated)
    node._on_description(node._described, urdf)
    assert (
        "the parameter effort_unit N.m where torque was recorded" in node._missing()
        and not node._prepared
    )


def test_what_drives_the_joints_must_be_said_by_somebody(nodes: Nodes, tmp_path: Path) -> None:
    node = nodes.identifier(data_directory=tmp_path, calibration="none")
    assert (
        "nobody publishes /applied_effort or listens to /current_command" in node._inputs.missing()
    )
    assert not nodes.identifier(
        data_directory=tmp_path, calibration="none", effort_unit="A"
    )._inputs.missing()
    servos = nodes.identifier(data_directory=tmp_path, calibration="none", robot="so101")
    assert "nobody publishes where the servos are sent, /joint_command" in servos._inputs.missing()
    servos.create_publisher(JointState, "/joint_command", 1)
    assert servos._inputs.missing() == ""
    assert {"/joint_command", "/battery_state"} <= {
        each.topic_name for each in servos.subscriptions
    }


def test_weighing_the_last_seconds_is_refused_with_the_reason(nodes: Nodes, tmp_path: Path) -> None:
    node = nodes.identifier(data_directory=tmp_path, calibration="none", running="true")
    job = Job(WEIGH, "weigh")
    with pytest.raises(JobError, match=r"no calibration of motions.*proprio calibrate BAG"):
        node._weighing.weigh(job, node._jobs.identify)
    assert node._inputs.kept is None and node._inputs.may_skip("joint_states"), (
        "nothing is kept for what cannot be done"
    )
    node._inputs.kept = deque()
    assert not node._inputs.may_skip("joint_states") and node._inputs.may_skip("applied_effort")
    with pytest.raises(JobError, match="give the parameter driver or effort_unit"):
        node._weighing.weigh(job, node._jobs.identify)
    hear = {
        role: node._inputs.listener(f"/{role}", role, JointState)
        for role in ("joint_states", "applied_effort")
    }
    hear["applied_effort"](b"")
    # it may go to somebody else's driver
    with pytest.raises(JobError, match="give the parameter driver or effort_unit"):
        node._weighing.weigh(job, node._jobs.identify)
    node.create_publisher(Float64MultiArray, "applied_current", 1)  # as our own driver has
    with pytest.raises(JobError, match="no joint states are coming"):
        node._weighing.weigh(job, node._jobs.identify)
    for number in range(20):
        still = messages.joint_state(
            10**7 * number, ["joint1", "wheel"], [0.001 * (number % 2), number], [], [0.0, 0.0]
        )
        hear["joint_states"](serialize_message(still))
    with pytest.raises(JobError, match="no joint moved in the last 15 s"):
        node._weighing.weigh(job, node._jobs.identify)
    assert not list(tmp_path.iterdir()), "what is refused leaves no recording"


def test_only_the_last_seconds_are_kept(nodes: Nodes, tmp_path: Path) -> None:
    node = nodes.identifier(data_directory=tmp_path, calibration="none")
    node._inputs.kept = deque(
        [
            RawMessage("/joint_states", "", node.get_clock().now().nanoseconds - age * 10**9, b"")
            for age in (16, 14)
        ]
    )
    node._inputs.listener("/joint_states", "joint_states", JointState)(
        serialize_message(JointState())
    )
    assert len(node._inputs.kept) == 2, "15 s"


def test_what_an_effort_says_of_a_current() -> None:
    assert [current_A(3.0, unit, 1.5) for unit in ("A", "mA", "N.m")] == [3.0, 0.003, 2.0]


def test_a_refused_sequence_is_asked_for_again_only_while_no_joint_states_reach_the_excitation(
    nodes: Nodes, tmp_path: Path
) -> None:
    node = nodes.identifier(data_directory=tmp_path, calibration="none")
    job = Job("payload", "calibrate_payload")
    node._excitation.values = {"sequence": "1", "busy": "false", "phase": "done"}
    asked: list[str] = []

    def call(client: Any, request: Any, tries: int = 1) -> Any:
        if client is node._excitation.set_probe:
            return SimpleNamespace(results=[SimpleNamespace(successful=True)])
        asked.append("run")
        if len(asked) == 1:  # its status says so as it refuses, in whatever words
            node._excitation.on_status(
                messages.status("ok", "excitation", "", {"joint_states": False})
            )
            node._excitation.values = {"sequence": "1", "busy": "false", "phase": "done"}
            return SimpleNamespace(success=False, message="nothing to be seen")
        return SimpleNamespace(success=True, message="sequence 1: payload, 1 runs")

    node._excitation._call = call
    node._excitation.make(job, "payload", lambda: None)
    assert len(asked) == 2
    assert [message.data for message in node._excitation._lease] == [True, False], (
        "asked for, and not any more"
    )

    def refuse(client: Any, request: Any, tries: int = 1) -> Any:
        if client is node._excitation.set_probe:
            return SimpleNamespace(results=[SimpleNamespace(successful=True)])
        asked.append("run")
        return SimpleNamespace(
            success=False, message="no joint states is what this refusal is not about"
        )

    node._excitation._call = refuse
    with pytest.raises(JobError, match="refuses"):
        node._excitation.make(job, "payload", lambda: None)
    assert len(asked) == 3


def test_the_estimate_of_a_run_takes_the_current_command_where_no_effort_comes(
    nodes: Nodes, tmp_path: Path
) -> None:
    inputs = nodes.identifier(data_directory=tmp_path, calibration="none")._inputs
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
    node._inputs.session = SimpleNamespace(
        add=lambda topic, msgtype, time_ns, data: kept.append(time_ns)
    )
    now_ns = node.get_clock().now().nanoseconds
    late_ns = now_ns - 4 * 10**8
    foreign_ns = now_ns - 3600 * 10**9
    for sent_ns in (late_ns, foreign_ns):  # a computer with another clock says nothing of ours
        hear = {
            subscription.topic_name: subscription.callback for subscription in node.subscriptions
        }
        hear["/torque_enabled"](serialize_message(Bool(data=False)), {"source_timestamp": sent_ns})
    assert kept[0] == late_ns and kept[1] >= now_ns


def test_a_driver_is_named_in_one_word(nodes: Nodes, tmp_path: Path) -> None:
    given: dict[str, Any] = {"data_directory": tmp_path, "calibration": "none"}
    node = nodes.identifier("cell", **given, driver="robotis")
    assert node._inputs.measured_unit() == "raw" and node._inputs.missing() == ""
    heard = {subscription.topic_name for subscription in node.subscriptions}
    assert {"/cell/joint_states", "/cell/forward_effort_controller/commands"} <= heard
    options = node._workspace.options()
    assert options.driver == "robotis" and options.effort_unit is None
    assert options.state_topic is None and options.command_topic is None, (
        "found in the bag as they were found here"
    )
    assert current_A(100.0, "raw", 1.78) == pytest.approx(0.269)
    assert (
        nodes.identifier(**given, driver="robotis", effort_unit="A")._inputs.measured_unit() == "A"
    ), "what is stated wins"
    assert nodes.identifier(**given)._inputs.measured_unit() == ""
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
    assert node._inputs._joints[:3] == [b"left_joint1", b"left_joint2", b"left_elbow"]
    assert node._inputs.conventions.renamed(["left_elbow", "joint1"])[0] == "joint3"


@pytest.mark.parametrize("ahead_s", [0, 3600, -3600])
def test_a_joint_state_is_as_late_as_it_waited_here(
    nodes: Nodes, tmp_path: Path, ahead_s: int
) -> None:
    """The first that is heard as well; by how much the sender's clock is ahead does not matter."""
    late_ns = nodes.identifier(data_directory=tmp_path, calibration="none")._inputs._late_ns
    second = 10**9
    now_ns = 1_700_000_000 * second

    def sent(came_ns: int) -> dict[str, int]:
        return {"received_timestamp": came_ns, "source_timestamp": came_ns + ahead_s * second}

    assert late_ns(100, now_ns, sent(now_ns - 8 * second)) == 8 * second
    assert late_ns(100, now_ns, sent(now_ns)) == 0
    # a computer's clock that was set while it waited; and a middleware that says nothing
    assert late_ns(60, now_ns, sent(now_ns - 3600 * second)) == 0
    assert late_ns(60, now_ns, {}) == 0
