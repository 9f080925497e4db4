"""Driver profiles: bags in the shape of each driver become the same currents, and what contradicts a profile is said."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from support.recording_bag import write_recording

from proprio_ros.cli import main
from proprio_ros.errors import ConfigurationError, ProprioError, RecordingError
from proprio_ros.inputs.resources import resource, resource_names
from proprio_ros.live.session import as_parameters, check_input, replay_command
from proprio_ros.pipeline import api
from proprio_ros.pipeline.calibrate import calibrate_from_bags
from proprio_ros.pipeline.check import check_bags
from proprio_ros.pipeline.loading import bag_recording, bag_runs
from proprio_ros.pipeline.looked_into import BagCheck
from proprio_ros.pipeline.replay import replay
from proprio_ros.pipeline.request import Options, Request
from proprio_ros.recordings.drivers import FORMS, INPUT, drivers_of, load_driver
from proprio_ros.recordings.effort import CURRENT_PER_COUNT_A
from proprio_ros.recordings.messages import RawMessage
from proprio_ros.recordings.runs import cut_runs
from proprio_ros.recordings.signals import read_recording
from proprio_ros.recordings.topics import OUR_DRIVER
from proprio_ros.records import MEASURED_EFFORT, JointRecord, Recording
from proprio_ros.robot import Robot, load_robot

ROOT = Path(__file__).resolve().parents[2]
REAL = ROOT.parent / "shared" / "recordings_real"
real = pytest.mark.skipif(
    not (REAL / "omx_empty_1").exists(),
    reason="needs the real recordings",
)
DRIVERS = resource_names("drivers")
STORAGES = ("mcap", "sqlite3")
JOINT_STATE = "sensor_msgs/msg/JointState"
FLOATS = "std_msgs/msg/Float64MultiArray"
JOINTS = ("joint1", "joint2", "joint3", "joint4", "gripper_left_joint")
ARM = load_robot("open_manipulator_x")
ONSET_NS = 1_760_000_010_000_000_000
CYCLE_NS = 25_000_000
TYPES = get_typestore(Stores.ROS2_JAZZY)
MARKS = {
    "control_msgs/msg/DynamicJointState": "string[] joint_names",
    "dynamixel_interfaces/msg/DynamixelState": "string[] joint_names",
    "ur_msgs/msg/IOStates": "string[] joint_names",
    "interbotix_xs_msgs/msg/JointGroupCommand": "string[] joint_names",
}
"""Types that nobody here reads, in a stand-in's words; a bag of such a driver has them."""
for _name, _text in MARKS.items():
    TYPES.register(get_types_from_msg(_text, _name))


class Message(NamedTuple):
    time_ns: int
    topic: str
    msgtype: str
    content: Any


def state(
    time_ns: int,
    values: dict[str, tuple[float, float, float]],
    topic: str = "/joint_states",
) -> Message:
    """Position, velocity and effort by joint, in this order."""
    time, header, kind = (
        TYPES.types[name]
        for name in ("builtin_interfaces/msg/Time", "std_msgs/msg/Header", JOINT_STATE)
    )
    seconds, nanoseconds = divmod(time_ns, 10**9)
    columns = np.array(
        list(values.values()),
        dtype=np.float64,
    )
    content = kind(
        header=header(
            stamp=time(sec=seconds, nanosec=nanoseconds),
            frame_id="base_link",
        ),
        name=list(values),
        position=columns[:, 0].copy(),
        velocity=columns[:, 1].copy(),
        effort=columns[:, 2].copy(),
    )
    return Message(time_ns, topic, JOINT_STATE, content)


def numbers(
    time_ns: int,
    values: Sequence[float],
    topic: str,
) -> Message:
    layout = TYPES.types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
    return Message(
        time_ns,
        topic,
        FLOATS,
        TYPES.types[FLOATS](
            layout=layout,
            data=np.array(values, dtype=np.float64),
        ),
    )


def mark(msgtype: str, topic: str) -> Message:
    return Message(
        ONSET_NS,
        topic,
        msgtype,
        TYPES.types[msgtype](joint_names=[]),
    )


def write_bag(
    path: Path,
    messages: Sequence[Message],
    storage: str = "mcap",
    qos: Sequence[Qos] = (),
) -> Path:
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        connections: dict[tuple[str, str], Any] = {}
        for message in sorted(messages, key=lambda each: each.time_ns):
            key = (message.topic, message.msgtype)
            if key not in connections:
                connections[key] = writer.add_connection(
                    *key, typestore=TYPES, offered_qos_profiles=qos
                )
            writer.write(
                connections[key],
                message.time_ns,
                TYPES.serialize_cdr(message.content, message.msgtype),
            )
    return path


def times(rate_Hz: float = 40.0) -> list[int]:
    """A second, of which the first quarter is at rest."""
    period_ns = round(1e9 / rate_Hz)
    return [
        ONSET_NS + row * period_ns
        for row in range(-round(0.25 * rate_Hz), round(0.75 * rate_Hz) + 1)
    ]


def pose(time_ns: int) -> dict[str, float]:
    elbow = 0.6 - 0.5 * max(time_ns - ONSET_NS, 0) * 1e-9
    return dict(zip(JOINTS, [0.0, -1.4, elbow, 0.1, 0.01], strict=True))


def torque(time_ns: int) -> dict[str, float]:
    """What a constant push of the elbow gives [N m]."""
    return dict.fromkeys(JOINTS, 0.0) | {
        "joint3": -0.5 if 0 <= time_ns - ONSET_NS < 600_000_000 else 0.0
    }


def push(
    effort: Callable[[dict[str, float]], dict[str, float]] = lambda torque: torque,
    order: Sequence[str] = JOINTS[::-1],
    names: Callable[[str], str] = lambda name: name,
    topic: str = "/joint_states",
    rate_Hz: float = 40.0,
) -> list[Message]:
    """Joint states in another order than the robot's, without velocities, and with a joint that no arm has."""
    messages = []
    for time_ns in times(rate_Hz):
        given = effort(torque(time_ns))
        values = {names(name): (pose(time_ns)[name], np.nan, given[name]) for name in order}
        messages.append(
            state(
                time_ns,
                values | {"wheel": (120.0, np.nan, np.nan)},
                topic,
            )
        )
    return messages


def read(path: Path, robot: Robot = ARM, **options: Any) -> Recording:
    return bag_recording(path, Request(robot, Options(**options)))


def elbow_A(recording: Recording, joint: str = "joint3") -> np.ndarray:
    assert recording.inputs is not None
    return recording.inputs.current_A[:, recording.inputs.column(joint)]


@contextmanager
def refused(
    pattern: str,
    error: type[ProprioError] = ConfigurationError,
) -> Iterator[None]:
    """One line that matches."""
    with pytest.raises(error) as caught:
        yield
    assert "\n" not in str(caught.value) and re.search(pattern, str(caught.value)), str(
        caught.value
    )


PUSHED_A = np.array(
    [
        torque(time_ns)["joint3"] / ARM.drive_trains["joint3"].nominal_effort_per_current
        for time_ns in times()
    ]
)

# --- the files -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", DRIVERS)
def test_every_profile_loads_says_where_it_is_from_and_is_documented(name: str) -> None:
    driver = load_driver(name)
    text = resource("drivers", name).read_text()
    assert driver.title and (
        name in ("proprio", "si") or re.search(r"Source: [\s\S]*commit\s+#?\s*[0-9a-f]{7}", text)
    )
    page = (ROOT / "docs" / "pages" / "another_robot.md").read_text().split("## Name the driver")[1]
    (row,) = re.findall(rf"^\| `{name}` \|.*$", page, re.MULTILINE)
    said = "refused" if driver.refused else driver.effort_unit or "not stated"
    assert f"| {said}" in row, row
    settings = (ROOT / "docs" / "pages" / "settings.md").read_text()
    assert all(f"| `{key}` |" in settings for key in (*FORMS, *INPUT))


@pytest.mark.parametrize("name", ["piper", "xarm", "unitree_z1", "schunk_lwa"])
def test_a_unit_that_nobody_documents_is_asked_for(name: str, tmp_path: Path) -> None:
    driver = load_driver(name)
    assert driver.effort_unit is None and driver.notes
    topic = f"/{driver.conventions.states}"
    values = dict.fromkeys(JOINTS, (0.1, 0.0, 0.5))
    messages = [state(ONSET_NS + n * CYCLE_NS, values, topic) for n in range(40)]
    bag = write_bag(tmp_path / "bag", messages)
    with refused("is not stated; state it with --effort-unit", RecordingError):
        bag_recording(bag, Request(ARM, Options(driver=name)))


def test_what_holds_without_a_profile_is_that_of_our_driver() -> None:
    assert (
        replace(load_driver("proprio").conventions, driver="")
        == OUR_DRIVER
        == Request(ARM).conventions
    )
    assert Request(ARM).unit is None


@pytest.mark.parametrize(
    ("text", "pattern"),
    [
        ("[]", "expected keys and values"),
        ("title: x\nstate: joint_states", "unknown key 'state'; did you mean 'states'"),
        (
            "title: x\neffort_unit: lbf",
            "effort_unit: 'lbf' is unknown: choose one of N.m, A, mA, raw",
        ),
        ("title: x\nstates: /joint_states", "states: expected a topic without a namespace"),
        ("states: joint_states", "title is missing"),
        ("title: x\ninputs: [{topic: a, unit: A}]", "inputs: type is missing"),
        (
            "title: x\ninputs: [{topic: a, type: std_msgs/Bool, unit: A}]",
            "inputs: type: 'std_msgs/Bool' is unknown",
        ),
        ("title: x\ninputs: {topic: a}", "inputs: expected a list"),
        (
            "title: x\ninputs: [{topic: a, type: sensor_msgs/JointState, unit: A, joints: [b, b]}]",
            "joint is named twice",
        ),
        ("title: x\njoint_names: {a: c, b: c}", "joint_names: c stands for two joints"),
        ("title: x\nnotes: [1]", "notes: expected a text, got 1"),
        ("title: [", "not readable as YAML"),
        ("extends: ros", "driver ros: unknown; did you mean ros2_control"),
        ("extends: mine.yaml", "more than 8 files extend each other"),
    ],
)
def test_a_bad_profile_gives_one_line(tmp_path: Path, text: str, pattern: str) -> None:
    (tmp_path / "mine.yaml").write_text(text)
    with refused(rf"^driver .*{pattern}" if "driver" not in pattern else f"^{pattern}"):
        load_driver(tmp_path / "mine.yaml")


def test_a_profile_that_is_not_there() -> None:
    with refused("driver ur: unknown; did you mean ur_current or ur_rtde or ur_torque"):
        load_driver("ur")
    with refused("driver no/such.yaml: there is no such file"):
        load_driver("no/such.yaml")


def test_a_file_extends_a_profile_and_replaces_its_keys(tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text("extends: ur_current\njoint_prefix: left_\n")
    mine = load_driver(tmp_path / "mine.yaml")
    theirs = load_driver("ur_current")
    assert (
        mine.extends == ("ur_current", "ros2_control")
        and mine.effort_unit == "A"
        and mine.notes == theirs.notes
    )
    assert mine.conventions.renamed(["left_elbow_joint", "elbow_joint"]) == (
        "elbow_joint",
        "elbow_joint",
    )
    assert mine.conventions.published("elbow_joint") == "left_elbow_joint"


# --- bags in the shape of each driver --------------------------------------------------------------------------------


@pytest.mark.parametrize("storage", STORAGES)
def test_proprio(tmp_path: Path, storage: str) -> None:
    commands = [
        numbers(
            t,
            [torque(t)[name] for name in JOINTS],
            "/current_command",
        )
        for t in times()
    ]
    bag = write_bag(
        tmp_path / "bag",
        push(order=JOINTS) + commands,
        storage,
    )
    stated = read(bag, driver="proprio")
    unstated = read(bag)
    assert stated.inputs is not None and unstated.inputs is not None
    assert stated.inputs.source == unstated.inputs.source == "/current_command"
    assert (
        np.array_equal(stated.inputs.current_A, unstated.inputs.current_A)
        and stated.notes == unstated.notes
    )
    # without any command its effort counts, which nobody may guess
    bag = write_bag(tmp_path / "effort", push(order=JOINTS), storage)
    np.testing.assert_allclose(
        elbow_A(read(bag, driver="proprio")),
        PUSHED_A,
    )
    with refused("what the effort .* is not stated", RecordingError):
        read(bag)


@pytest.mark.parametrize("storage", STORAGES)
def test_ros2_control_with_an_effort_controller(tmp_path: Path, storage: str) -> None:
    topic = "/arm/forward_effort_controller/commands"
    commands = [
        numbers(
            t,
            [torque(t)[name] for name in JOINTS],
            topic,
        )
        for t in times()
    ]
    silent = push(
        effort=lambda given: dict.fromkeys(given, np.nan),
        topic="/arm/joint_states",
    )
    bag = write_bag(tmp_path / "bag", silent + commands, storage)
    recording = read(bag, driver="ros2_control")
    assert recording.inputs is not None and (recording.inputs.source, recording.inputs.unit) == (
        topic,
        "N.m",
    )
    np.testing.assert_allclose(elbow_A(recording), PUSHED_A)
    assert recording.joints.velocity is None and "wheel" in recording.joints.names
    assert any(
        "is unlabelled; it was read as the recorded joints joint1, joint2" in note
        for note in recording.notes
    )
    (run,) = bag_runs(
        bag,
        Request(ARM, Options(driver="ros2_control")),
    )
    assert run.joint == "joint3" and run.duration_s == pytest.approx(0.6)
    # and is not looked for where nobody says which driver it is
    with refused("no input current", RecordingError):
        bag_runs(bag, Request(ARM))


def test_lerobot_states_degrees_and_names_of_its_own(tmp_path: Path) -> None:
    """The same motion in LeRobot's words and in ours: positions, goals and the currents that follow from both."""
    arm = load_robot("so101")
    random, stamps = np.random.default_rng(2), [ONSET_NS + 33_000_000 * k for k in range(60)]
    sizes, phases = random.uniform(0.1, 0.4, 6), random.uniform(0.0, 6.0, 6)

    def bag(name: str, joint_name: str, per_rad: float) -> Path:
        said = []
        for t in stamps:
            for topic, late_s in (("/joint_states", 0.1), ("/joint_command", 0.0)):
                angles = per_rad * sizes * np.sin(2e-9 * (t - ONSET_NS) - 2.0 * late_s + phases)
                columns = {
                    joint_name.format(joint): (angle, np.nan, np.nan)
                    for joint, angle in zip(arm.drive_trains, angles, strict=True)
                }
                said.append(state(t, columns, topic))
        return write_bag(tmp_path / name, said)

    ours = bag_recording(bag("ours", "{}", 1.0), Request(arm))
    theirs = bag_recording(
        bag(
            "theirs",
            "{}.pos",
            180.0 / np.pi,
        ),
        Request(arm, Options(driver="lerobot")),
    )
    assert theirs.joints.names == ours.joints.names
    np.testing.assert_allclose(
        theirs.joints.position,
        ours.joints.position,
        atol=1e-12,
    )
    assert ours.inputs is not None and theirs.inputs is not None and ours.inputs.current_A.any()
    np.testing.assert_allclose(
        theirs.inputs.current_A,
        ours.inputs.current_A,
        atol=1e-9,
    )
    with refused("seems to use degrees", RecordingError):  # a profile that says rad
        bag_recording(
            bag("wrong", "{}", 1000.0 * 180.0 / np.pi),
            Request(arm),
        )


@pytest.mark.parametrize("storage", STORAGES)
def test_ros2_control_under_a_trajectory_controller(tmp_path: Path, storage: str) -> None:
    bag = write_bag(
        tmp_path / "bag",
        [*push(), mark("control_msgs/msg/DynamicJointState", "/dynamic_joint_states")],
        storage,
    )
    recording = read(bag, driver="ros2_control")
    assert recording.inputs is not None and recording.inputs.source == MEASURED_EFFORT
    np.testing.assert_allclose(elbow_A(recording), PUSHED_A)


def test_the_order_of_a_controller_that_drives_some_joints_is_stated(tmp_path: Path) -> None:
    order = ("joint4", "joint3", "joint2")
    topic = "/torques/commands"
    commands = [
        numbers(
            t,
            [torque(t)[name] for name in order],
            topic,
        )
        for t in times()
    ]
    bag = write_bag(tmp_path / "bag", push() + commands)
    (tmp_path / "mine.yaml").write_text(
        "extends: ros2_control\n"
        f"inputs: [{{topic: torques/commands, type: std_msgs/Float64MultiArray, unit: N.m, joints: [{', '.join(order)}]}}]\n"
    )
    mine = tmp_path / "mine.yaml"
    np.testing.assert_allclose(
        elbow_A(read(bag, driver=mine)),
        PUSHED_A,
    )
    with refused(
        r"has 3 values but the robot has 5 joints .*file of your own \(extends: ros2_control\)",
        RecordingError,
    ):
        read(bag, driver="ros2_control", command_topic=topic)
    mine.write_text(mine.read_text().replace("joint4, ", ""))
    with refused("has 3 values but --driver .* names 2 joints", RecordingError):
        read(bag, driver=mine)


@pytest.mark.parametrize("storage", STORAGES)
def test_robotis(tmp_path: Path, storage: str) -> None:
    def counts(given: dict[str, float]) -> dict[str, float]:
        return {
            name: np.round(
                value / ARM.drive_trains[name].nominal_effort_per_current / CURRENT_PER_COUNT_A
            )
            for name, value in given.items()
        }

    seen = mark(
        "dynamixel_interfaces/msg/DynamixelState", "/dynamixel_hardware_interface/dxl_state"
    )
    bag = write_bag(
        tmp_path / "bag",
        [*push(counts), seen],
        storage,
    )
    recording = read(bag, driver="robotis")
    np.testing.assert_allclose(elbow_A(recording), PUSHED_A, atol=CURRENT_PER_COUNT_A)
    # its goal currents are counts, too
    commands = [
        numbers(t, list(counts(torque(t)).values()), "/forward_effort_controller/commands")
        for t in times()
    ]
    recording = read(
        write_bag(
            tmp_path / "goal",
            push(counts) + commands,
            storage,
        ),
        driver="robotis",
    )
    assert (
        recording.inputs is not None
        and recording.inputs.unit == "raw"
        and not recording.inputs.measured
    )
    np.testing.assert_allclose(elbow_A(recording), PUSHED_A, atol=CURRENT_PER_COUNT_A)


UR = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint")
NAMED = dict(zip(JOINTS, (*UR, "wrist_1_joint", "wrist_2_joint"), strict=True))


@pytest.fixture(scope="module")
def ur(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    """Three heavy links in a row."""
    links = "".join(
        f'<link name="{name}"><inertial><origin xyz="0.2 0 0"/><mass value="3"/>'
        '<inertia ixx="0.01" iyy="0.05" izz="0.05" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        for name in ("base", "a", "b", "c")
    )
    pairs = zip(
        UR,
        ("base", "a", "b"),
        ("a", "b", "c"),
        ("0 0 1", "0 1 0", "0 1 0"),
        strict=True,
    )
    joints = "".join(
        f'<joint name="{name}" type="continuous"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0.4 0 0"/><axis xyz="{axis}"/></joint>'
        for name, parent, child, axis in pairs
    )
    folder = tmp_path_factory.mktemp("ur")
    (folder / "ur.urdf").write_text(f'<robot name="ur">{links}{joints}</robot>')
    constants = "".join(
        f"  {name}: {{motor: {{nominal_torque_constant_N_m_per_A: 10.0}}}}\n" for name in UR
    )
    (folder / "ur.yaml").write_text(
        f"name: ur\nurdf: ur.urdf\npayload_frame: c\njoints:\n{constants}"
    )
    return load_robot(folder / "ur.yaml")


@pytest.mark.parametrize("storage", STORAGES)
def test_ur_with_currents(tmp_path: Path, ur: Robot, storage: str) -> None:
    # torque commands come on top of the controller's own, so that the measured currents count
    torques = [numbers(t, [1.0] * 6, "/forward_effort_controller/commands") for t in times()]
    seen = [*torques, mark("ur_msgs/msg/IOStates", "/io_and_status_controller/io_states")]
    bag = write_bag(
        tmp_path / "bag",
        push(names=lambda name: NAMED[name]) + seen,
        storage,
    )
    recording = read(bag, ur, driver="ur_current")
    assert recording.inputs is not None and recording.inputs.measured
    assert elbow_A(recording, "elbow_joint").min() == -0.5, "A, whatever the torque constant"
    # two arms: a prefix that the URDF does not have
    both = push(names=lambda name: f"left_{NAMED[name]}")
    both += [state(m.time_ns + 1, {f"right_{name}": (0.3, 0.0, 9.0) for name in UR}) for m in both]
    bag = write_bag(tmp_path / "two", both, storage)
    (tmp_path / "left.yaml").write_text("extends: ur_current\njoint_prefix: left_\n")
    recording = read(bag, ur, driver=tmp_path / "left.yaml")
    assert set(UR) | {"right_elbow_joint"} <= set(recording.joints.names)
    assert elbow_A(recording, "elbow_joint").min() == -0.5
    both += [state(m.time_ns + 2, {"elbow_joint": (0.3, 0.0, 9.0)}) for m in both]
    with refused("left_elbow_joint and elbow_joint would both be elbow_joint", RecordingError):
        read(
            write_bag(tmp_path / "three", both, storage),
            ur,
            driver=tmp_path / "left.yaml",
        )


@pytest.mark.parametrize("storage", STORAGES)
def test_ur_with_torques_without_gravity_is_refused(
    tmp_path: Path, ur: Robot, storage: str
) -> None:
    bag = write_bag(
        tmp_path / "bag",
        push(names=lambda name: NAMED[name]),
        storage,
    )
    options = Options(robot=str(ur.source), driver="ur_torque")
    why = "ur_torque: this effort lacks what holds the arm .*use_currents_as_efforts:=true, and state ur_current"
    with refused(why):
        replay(bag, options)
    with refused(why):
        calibrate_from_bags(bag, {}, options)
    # an effort unit does not make it another thing
    with refused(why):
        api.weigh(
            bag,
            robot=ur.source,
            driver="ur_torque",
            effort_unit="N.m",
        )
    (check,) = check_bags(bag, Options(robot=str(ur.source), driver="ur_torque"))[1]
    assert (
        "this effort lacks what holds the arm" in check.problem
        and not check.usable
        and check.moves == ("elbow_joint",)
    )


@pytest.mark.parametrize("storage", STORAGES)
def test_interbotix(tmp_path: Path, storage: str) -> None:
    names = dict(
        zip(JOINTS, ("waist", "shoulder", "elbow", "wrist_angle", "left_finger"), strict=True)
    )

    def milliampere(given: dict[str, float]) -> dict[str, float]:
        return {
            name: 1e3 * value / ARM.drive_trains[name].nominal_effort_per_current
            for name, value in given.items()
        }

    seen = mark("interbotix_xs_msgs/msg/JointGroupCommand", "/wx200/commands/joint_group")
    states = push(
        milliampere,
        names=lambda name: names[name],
        topic="/wx200/joint_states",
    )
    bag = write_bag(tmp_path / "bag", [*states, seen], storage)
    # the robot of this test calls its joints otherwise: a file says how
    (tmp_path / "mine.yaml").write_text(
        "extends: interbotix\njoint_names: {"
        + ", ".join(f"{theirs}: {own}" for own, theirs in names.items())
        + "}\n"
    )
    np.testing.assert_allclose(
        elbow_A(read(bag, driver=tmp_path / "mine.yaml")),
        PUSHED_A,
    )
    recording = read_recording(
        bag,
        effort_unit="mA",
        nominal_torque_constants={},
        joint_order=[],
        conventions=load_driver("interbotix").conventions,
    )
    np.testing.assert_allclose(elbow_A(recording, "elbow"), PUSHED_A)


@pytest.mark.parametrize("storage", STORAGES)
def test_openarm(tmp_path: Path, storage: str) -> None:
    # what is commanded is added to the motors' own controller, so that the measured torques count
    commands = [numbers(t, [0.1] * 5, "/forward_effort_controller/commands") for t in times()]
    bag = write_bag(tmp_path / "bag", push() + commands, storage)
    recording = read(bag, driver="openarm")
    assert recording.inputs is not None and recording.inputs.measured
    np.testing.assert_allclose(elbow_A(recording), PUSHED_A)
    assert not elbow_A(recording, "gripper_left_joint").any()


@pytest.mark.parametrize("storage", STORAGES)
def test_feetech(tmp_path: Path, storage: str) -> None:
    without = push(effort=lambda given: dict.fromkeys(given, np.nan))
    with refused("no input current", RecordingError):
        bag_runs(
            write_bag(tmp_path / "without", without, storage),
            Request(ARM, Options(driver="feetech")),
        )
    load = write_bag(
        tmp_path / "load",
        push(effort=lambda given: {k: v / 3.0 for k, v in given.items()}),
        storage,
    )
    with refused(
        "no input in the bag, and what the effort of /joint_states means is not stated",
        RecordingError,
    ):
        read(load, driver="feetech")


# --- a profile, the user and the bag ---------------------------------------------------------------------------------


def test_what_the_user_states_wins(tmp_path: Path) -> None:
    commands = [
        numbers(
            t,
            list(torque(t).values()),
            "/other/commands",
        )
        for t in times()
    ]
    bag = write_bag(tmp_path / "bag", push() + commands)
    assert elbow_A(read(bag, driver="ros2_control", effort_unit="A")).min() == -0.5
    named = read(bag, driver="ros2_control", command_topic="/other/commands")
    np.testing.assert_allclose(
        elbow_A(named), PUSHED_A, err_msg="another name of the same kind of topic: N m still"
    )
    assert elbow_A(read(bag, command_topic="/other/commands")).min() == -0.5, (
        "A without a profile, as ever"
    )
    elsewhere = write_bag(tmp_path / "elsewhere", push(topic="/elsewhere"))
    with refused(
        "no joint states on joint_states, where --driver ros2_control has them; .*/elsewhere",
        RecordingError,
    ):
        read(elsewhere, driver="ros2_control")
    np.testing.assert_allclose(
        elbow_A(read(elsewhere, driver="ros2_control", state_topic="/elsewhere")), PUSHED_A
    )


MARKED = {
    "ros2_control": ("control_msgs/msg/DynamicJointState", "/dynamic_joint_states"),
    "robotis": (
        "dynamixel_interfaces/msg/DynamixelState",
        "/dynamixel_hardware_interface/dxl_state",
    ),
    "interbotix": ("interbotix_xs_msgs/msg/JointGroupCommand", "/wx200/commands/joint_group"),
}


def looked_at(bag: Path, **options: Any) -> BagCheck:
    (check,) = check_bags(bag, Options(**options))[1]
    return check


@pytest.mark.parametrize("name", MARKED)
def test_check_names_the_profile_that_fits_and_applies_none(tmp_path: Path, name: str) -> None:
    bag = write_bag(
        tmp_path / "bag",
        [
            *push(),
            mark(*MARKED["ros2_control"]),
            mark(*MARKED[name]),
        ],
    )
    if name == "interbotix":
        bag = write_bag(
            tmp_path / "alone",
            [*push(), mark(*MARKED[name])],
        )
    check = looked_at(bag)
    assert check.fitting == (name,) and check.driver is None and check.input_unit is not None
    assert "not stated" in check.input_unit and "is not stated" in check.problem, (
        "nothing was taken from it"
    )
    assert (
        f"driver: its topics are those of {name}; state it with --driver, none is used before"
        in check.as_text()
    )
    stated = looked_at(bag, driver=name)
    assert (
        stated.driver is not None
        and stated.driver.name == name
        and "its topics are" not in stated.as_text()
    )
    assert f"driver: {name}, {stated.driver.title}" in stated.as_text()
    assert all(note in stated.as_text() for note in stated.driver.notes)
    assert (
        f"problem: its topics are those of {name}, not of proprio"
        in looked_at(bag, driver="proprio").as_text()
    )
    json.dumps(stated.as_json())


def test_two_profiles_that_topics_cannot_tell_apart_are_both_named(tmp_path: Path) -> None:
    bag = write_bag(
        tmp_path / "bag",
        [*push(), mark("ur_msgs/msg/IOStates", "/io_and_status_controller/io_states")],
    )
    assert "its topics are those of ur_current or ur_torque; state one" in looked_at(bag).as_text()
    assert "its topics are" not in looked_at(bag, driver="ur_current").as_text()
    assert drivers_of([("/joint_states", JOINT_STATE)]) == ()
    assert looked_at(ROOT / "bags" / "realistic_s00_empty_00_joint3" / "bag_mcap").fitting in (
        (),
        ("proprio",),
    )


@real
def test_a_unit_that_gravity_contradicts_is_said() -> None:
    """The arm publishes raw counts; a profile that calls them mA is a third of what gravity needs."""
    bag = REAL / "omx_empty_1"
    assert not any("gravity needs" in note for note in looked_at(bag, driver="robotis").notes)
    (said,) = [
        note for note in looked_at(bag, driver="interbotix").notes if "gravity needs" in note
    ]
    assert "effort in mA (--driver interbotix) is 0.3 times the torque" in said
    assert said in read(bag, driver="interbotix").notes, "and where it is weighed"
    assert not any("gravity needs" in note for note in read(bag, effort_unit="mA").notes), (
        "as ever without a profile"
    )


@pytest.mark.parametrize("storage", STORAGES)
def test_the_same_answer_from_another_drivers_bag(tmp_path: Path, storage: str) -> None:
    """A bag of this package, as torques of a forward_effort_controller among foreign joint states: not a digit differs."""
    original = read(ROOT / "bags" / "ideal_s00_fixed_heavy_ball_50g_joint2" / "bag_mcap")
    record = original.joints
    inputs = original.inputs
    assert inputs is not None
    bare = Recording(
        "bare",
        JointRecord(record.times_ns, record.names, record.position),
        inputs,
    )
    write_recording(tmp_path / "ours", bare, storage)
    messages = []
    for row, time_ns in enumerate(record.times_ns):
        values = {
            name: (record.position[row, record.column(name)], np.nan, np.nan)
            for name in record.names[::-1]
        }
        messages.append(
            state(
                int(time_ns),
                {"rail": (0.0, 0.0, 0.0), **values},
                "/cell/joint_states",
            )
        )
    per_current = [ARM.drive_trains[name].nominal_effort_per_current for name in JOINTS]
    assert inputs.names == JOINTS
    for time_ns, current_A in zip(inputs.times_ns, inputs.current_A, strict=True):
        given = current_A * per_current
        messages.append(
            numbers(int(time_ns), given.tolist(), "/cell/forward_effort_controller/commands")
        )
    bag = write_bag(tmp_path / "bag", messages, storage)
    facts = {"com": [0, 0, 0]}
    ours = api.weigh(tmp_path / "ours", payload=facts)
    theirs = api.weigh(bag, payload=facts, driver="ros2_control")
    assert ours.value() == theirs.value() and ours.value() == pytest.approx(0.05, abs=0.001)
    assert ours.ci95 == theirs.ci95 and ours.verdict == theirs.verdict
    assert "driver='ros2_control'" in theirs.call


def test_the_command_line_takes_it(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    bag = write_bag(tmp_path / "bag", push())
    assert main(["check", str(bag), "--driver", "ros2_control", "--json"]) == 0
    (found,) = json.loads(capsys.readouterr().out)["bags"]
    assert (
        found["driver"] == "ros2_control"
        and found["fitting_drivers"] == []
        and found["input_unit"] == "N.m"
    )
    (check,) = api.check(bag, driver="ros2_control")
    assert check.usable == 1
    assert main(["replay", str(bag), "--probe", "payload", "--driver", "ros2_contrl"]) == 2
    assert "driver ros2_contrl: unknown; did you mean ros2_control?" in capsys.readouterr().err
    out = ["--output", str(tmp_path / "arm.yaml")]
    assert main(["calibrate", str(bag), "--driver", "ur_torque", *out]) == 2
    assert "lacks what holds the arm" in capsys.readouterr().err


def test_live_it_is_a_parameter_and_stands_in_the_command_that_gives_the_answer_again(
    tmp_path: Path,
) -> None:
    options = Options(driver="ros2_control")
    assert "--driver ros2_control" in replay_command(tmp_path / "bag", options)
    assert as_parameters("--driver ur_torque: no") == "the parameter driver ur_torque: no"
    raw = [
        RawMessage(
            m.topic,
            m.msgtype,
            m.time_ns,
            bytes(TYPES.serialize_cdr(m.content, m.msgtype)),
        )
        for m in push(names=lambda name: f"left_{name}")
    ]
    with refused("the robot has joint1: state joint_prefix: left_ in a driver", RecordingError):
        check_input(tmp_path, raw, Request(ARM, options))
    (tmp_path / "left.yaml").write_text("extends: ros2_control\njoint_prefix: left_\n")
    assert (
        check_input(tmp_path, raw, Request(ARM, Options(driver=tmp_path / "left.yaml"))) is not None
    )


# --- joint states of every make --------------------------------------------------------------------------------------


def quality(reliability: QosReliability) -> list[Qos]:
    forever = QosTime(9223372036, 854775807)
    return [
        Qos(QosHistory.KEEP_LAST, 10, reliability, QosDurability.VOLATILE, forever, forever, QosLiveliness.AUTOMATIC,
            forever, avoid_ros_namespace_conventions=False)
    ]  # fmt: skip


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize(
    "reliability",
    list(QosReliability),
    ids=lambda each: each.name.lower(),
)
def test_any_quality_of_service_is_read(
    tmp_path: Path, storage: str, reliability: QosReliability
) -> None:
    bag = write_bag(
        tmp_path / "bag",
        push(),
        storage,
        quality(reliability),
    )
    np.testing.assert_allclose(
        elbow_A(read(bag, driver="ros2_control")),
        PUSHED_A,
    )


@pytest.mark.parametrize("rate_Hz", [30.0, 100.0, 500.0, 1000.0])
def test_a_push_is_cut_alike_at_every_rate(tmp_path: Path, rate_Hz: float) -> None:
    bag = write_bag(
        tmp_path / "bag", push(rate_Hz=rate_Hz), "sqlite3" if rate_Hz > 300.0 else "mcap"
    )
    recording = read(bag, driver="ros2_control")
    (run,) = cut_runs(recording, joints=list(ARM.drive_trains))
    assert run.joint == "joint3" and run.duration_s == pytest.approx(0.6, abs=1.1 / rate_Hz)
    assert run.input_current_A.min() == pytest.approx(PUSHED_A.min())
    assert not recording.notes


def test_efforts_that_are_missing_for_a_while_are_held(tmp_path: Path) -> None:
    """A broadcaster whose hardware starts late gives NaN; so does a joint without the interface, in every message."""
    messages = push()
    for row in (0, 1, 14):
        messages[row].content.effort[:] = np.nan
    column = messages[0].content.name.index("joint1")
    for message in messages:
        message.content.effort[column] = np.nan
    recording = read(write_bag(tmp_path / "bag", messages), driver="ros2_control")
    np.testing.assert_allclose(elbow_A(recording), PUSHED_A)
    assert recording.inputs is not None and "joint1" not in recording.inputs.names


def test_two_arms_in_namespaces_are_a_question(tmp_path: Path) -> None:
    bag = write_bag(
        tmp_path / "bag", push(topic="/left/joint_states") + push(topic="/right/joint_states")
    )
    with refused("which joint states\\? choose with --state-topic", RecordingError):
        read(bag, driver="ros2_control")
    recording = read(bag, driver="ros2_control", state_topic="/right/joint_states")
    np.testing.assert_allclose(elbow_A(recording), PUSHED_A)
