"""`proprio robot new`: a file with every key from a URDF, from a bag's description, and what it takes to fill it in."""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path

import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from support.small_urdf import THREE, chain, joint, link

from proprio_ros.cli import main
from proprio_ros.errors import RecordingError, RobotError
from proprio_ros.inputs.forms import Text
from proprio_ros.inputs.reading import yaml_of
from proprio_ros.quantity import Quantity
from proprio_ros.recordings.description import description_of, robot_named
from proprio_ros.recordings.messages import message_types
from proprio_ros.robot import load_robot, with_recorded_torque
from proprio_ros.robot.description import read_model
from proprio_ros.robot.fields import DRIVE_TRAIN, JOINT, MOTOR, ROBOT
from proprio_ros.robot.hands import hand_link
from proprio_ros.robot.new_file import new_robot_file

UR10E = Path(__file__).resolve().parents[3] / "shared" / "recordings_real" / "models" / "ur10e.urdf"
MARKED = "nominal_torque_constant_N_m_per_A: null"


def written(folder: Path, urdf: str = THREE) -> str:
    (folder / "arm.urdf").write_text(urdf)
    assert (
        main(["robot", "new", str(folder / "arm.urdf"), "--output", str(folder / "new.yaml")]) == 0
    )
    return (folder / "new.yaml").read_text()


def test_every_key_is_there_with_its_default(tmp_path: Path) -> None:
    text = written(tmp_path)
    content = yaml_of(text)
    assert set(content) == {*ROBOT, "urdf", "joints"} - {
        "calibration",
        "joint_calibration",
        "model_fingerprint",
    }
    assert set(content["joints"]) == {"a", "b"}, "c is fixed"
    assert set(content["joints"]["b"]["motor"]) == set(MOTOR)
    assert set(content["joints"]["b"]["drive_train"]) == set(DRIVE_TRAIN)
    # units and meanings come from the forms that read the file
    for entry in (*MOTOR.values(), *DRIVE_TRAIN.values()):
        form = getattr(entry.form, "of", None) or entry.form
        assert form.meaning in text and (isinstance(form, Text) or form.described() in text)


def test_filled_in_it_holds_what_would_hold_without_it(tmp_path: Path) -> None:
    text = written(tmp_path)
    assert text.count("# STATE THIS") == 2 and "CHECK THIS" in text
    (tmp_path / "new.yaml").write_text(
        text.replace(MARKED, "nominal_torque_constant_N_m_per_A: 2.0")
    )
    (tmp_path / "short.yaml").write_text(
        "name: arm\nurdf: arm.urdf\npayload_frame: three\njoints:\n"
        "  a: {motor: {nominal_torque_constant_N_m_per_A: 2}}\n  b: {motor: {nominal_torque_constant_N_m_per_A: 2}}\n"
    )
    full = load_robot(tmp_path / "new.yaml")
    short = load_robot(tmp_path / "short.yaml")
    assert full.drive_trains == short.drive_trains and full.motors == short.motors
    for name in (
        "delay",
        "arm_scale",
        "stamp_jitter_s",
        "torque_disturbance",
        "link_com_std",
        "payload_frame",
    ):
        assert getattr(full, name) == getattr(short, name), name


def test_until_then_all_that_is_missing_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    slide = chain(
        joint("a"),
        joint("finger", "one", "two", kind="prismatic"),
        joint("c", "two", "three", kind="fixed"),
    )
    written(tmp_path, slide)
    assert main(["plan", "--mass", "0.1", "--robot", str(tmp_path / "new.yaml")]) == 2
    said = capsys.readouterr().err
    assert said.startswith(
        "proprio: new.yaml: missing: motor.nominal_torque_constant_N_m_per_A of a, finger; transmission_m"
    )
    assert "_per_rad (slide per rad of the motor) of finger; state each" in said


def test_an_older_file_is_kept(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    written(tmp_path)
    (tmp_path / "new.yaml").write_text("mine")
    words = [
        "robot",
        "new",
        str(tmp_path / "arm.urdf"),
        "--output",
        str(tmp_path / "new.yaml"),
    ]
    assert main(words) == 2 and (tmp_path / "new.yaml").read_text() == "mine"
    assert "--force" in capsys.readouterr().err
    assert main([*words, "--force", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert (
        said["joints"] == ["a", "b"]
        and said["payload_frame"] == "three"
        and len(said["to_state"]) == 2
    )
    assert (
        main(["robot", "new", str(tmp_path / "leg.urdf"), "--output", str(tmp_path / "leg.yaml")])
        == 2
    )
    assert not (tmp_path / "leg.yaml").exists()


def test_names_that_yaml_would_take_for_something_else(tmp_path: Path) -> None:
    names = ("on", "1", 'a: "b"', "#c")
    links = "".join(link(name) for name in ("base", "l0", "l1", "l2", "l3"))
    quoted = [name.replace('"', "&quot;") for name in names]
    text = written(
        tmp_path,
        chain(
            *(joint(name, "base", f"l{n}") for n, name in enumerate(quoted)),
            links=links,
        ),
    )
    assert list(yaml_of(text)["joints"]) == list(names)


@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_a_bag_brings_its_description(tmp_path: Path, storage: StoragePlugin) -> None:
    """As a recorder keeps a latched topic: one message, or the same again after each start of the recorder."""
    text = THREE.replace("<robot", f"<!-- {'x' * 300_000} --><robot", 1)
    bag(tmp_path / "bag", storage, [text, text])
    assert (
        main(["robot", "new", str(tmp_path / "bag"), "--output", str(tmp_path / "new.yaml")]) == 0
    )
    content = (
        (tmp_path / "new.yaml")
        .read_text()
        .replace(MARKED, "nominal_torque_constant_N_m_per_A: 2.0")
    )
    (tmp_path / "new.yaml").write_text(content)
    with pytest.raises(RobotError, match="is a bag, which only a reader of bags"):
        load_robot(tmp_path / "new.yaml")
    robot = robot_named(tmp_path / "new.yaml")
    (tmp_path / "arm.urdf").write_text(THREE)
    assert robot.model.fingerprint() == read_model(str(tmp_path / "arm.urdf")).fingerprint()


def test_a_bag_without_one_description(tmp_path: Path) -> None:
    bag(
        tmp_path / "two",
        StoragePlugin.MCAP,
        [THREE, THREE.replace("arm", "leg")],
    )
    with pytest.raises(RecordingError, match="2 descriptions that differ"):
        description_of(tmp_path / "two")
    bag(tmp_path / "none", StoragePlugin.MCAP, ["hello"], "/chatter")
    with pytest.raises(RecordingError, match=r"no /robot_description .* it holds: /chatter"):
        description_of(tmp_path / "none")


def bag(
    path: Path,
    storage: StoragePlugin,
    texts: list[str],
    topic: str = "/robot_description",
) -> None:
    types = message_types()
    with Writer(path, version=9, storage_plugin=storage) as writer:
        connection = writer.add_connection(topic, "std_msgs/msg/String", typestore=types)
        for number, text in enumerate(texts):
            message = types.types["std_msgs/msg/String"](data=text)
            writer.write(
                connection, 10**9 + number, types.serialize_cdr(message, "std_msgs/msg/String")
            )


def test_the_guessed_hand_is_no_finger(tmp_path: Path) -> None:
    finger = '<mimic joint="left"/>'
    text = chain(
        joint("a"),
        joint("tool", "one", "hand", kind="fixed"),
        joint("left", "hand", "two", kind="prismatic"),
        joint("right", "hand", "three", kind="prismatic", mimic=finger),
        joint("tip", "two", "tip", kind="fixed"),
        links="".join(link(name) for name in ("base", "one", "hand", "two", "three", "tip")),
    )
    (tmp_path / "arm.urdf").write_text(text)
    assert hand_link(read_model(str(tmp_path / "arm.urdf"))) == "hand"
    assert hand_link(load_robot("open_manipulator_x").model) == "end_effector_link"


def fixed(name: str, parent: str, child: str) -> str:
    return joint(name, parent, child, kind="fixed")


def finger(
    name: str,
    parent: str,
    child: str,
    mimic: str = "",
    kind: str = "revolute",
) -> str:
    return joint(name, parent, child, kind=kind, mimic=mimic)


MIMIC = '<mimic joint="left"/>'
ARM = (joint("j1"), joint("j2", "one", "two"), joint("j3", "two", "three"))


@pytest.mark.parametrize(
    ("joints", "hand"),
    [
        ((fixed("f", "three", "flange"), fixed("h", "flange", "arm_hand"), fixed("t", "arm_hand", "arm_hand_tcp"),
          finger("left", "arm_hand", "l", kind="prismatic"), finger("r", "arm_hand", "r", MIMIC, "prismatic",)), "arm_hand_tcp"),
        ((fixed("s", "three", "gripperStator"), finger("jointGripper", "gripperStator", "gripperMover")), "gripperStator"),
        ((finger("j4", "three", "moving_jaw"),), "three"),
        ((finger("left", "three", "l"), finger("right", "three", "r", MIMIC)), "three"),
        ((fixed("t", "three", "tool0"), fixed("camera", "tool0", "camera"), finger("j4", "camera", "jaw")), "tool0"),
        ((fixed("e", "three", "ee_link"), fixed("t", "three", "tool0")), "ee_link"),
        ((joint("slide", "three", "four", kind="prismatic"), fixed("t", "four", "tool0")), "tool0"),
        ((joint("a", "base", "l1"), joint("b", "l1", "l2")), "three"),
    ],
)  # fmt: skip
def test_the_guessed_hand_is_a_tool_frame_or_the_last_link_before_fingers(
    tmp_path: Path, joints: tuple[str, ...], hand: str
) -> None:
    text = chain(
        *ARM,
        *joints,
        links="".join(map(link, _links(*ARM, *joints))),
    )
    (tmp_path / "arm.urdf").write_text(text)
    assert hand_link(read_model(str(tmp_path / "arm.urdf"))) == hand


def _links(*joints: str) -> list[str]:
    return [
        "base",
        *(text.split('<child link="')[1].split('"')[0] for text in joints),
    ]


def test_the_guessed_hand_of_arms_whose_last_joint_is_a_jaw() -> None:
    for name, hand in (("so101", "grasp_link"), ("omx_f", "end_effector_link")):
        assert hand_link(load_robot(name).model) == hand


def test_where_efforts_are_torque_the_file_asks_for_nothing_and_knows_what_the_urdf_does(
    tmp_path: Path,
) -> None:
    """Its torque constants were 15 % uncertain where those of the URDF alone are 10 %, and so were its masses."""
    gripper = chain(
        joint("a", limit='<limit lower="-1" upper="1" effort="1.23456" velocity="1"/>'),
        finger("f", "one", "two", kind="prismatic"),
    )
    for number, urdf in enumerate((THREE, gripper)):
        folder = tmp_path / str(number)
        folder.mkdir()
        source = str(folder / "arm.urdf")
        Path(source).write_text(urdf)
        bare = load_robot(source, with_recorded_torque(source, {}))
        for flags in (["--effort-unit", "N.m"], []):
            output = folder / f"new{len(flags)}.yaml"
            assert main(["robot", "new", source, "--output", str(output), *flags]) == 0
            if not flags and urdf == gripper:
                with pytest.raises(
                    RobotError,
                    match=r"or `proprio robot new --effort-unit N\.m`, where torque was recorded",
                ):
                    load_robot(output)
                continue
            assert ("# STATE THIS" in output.read_text()) is not bool(flags)
            file = load_robot(output, with_recorded_torque(output, {}))
            assert list(file.drive_trains) == list(bare.drive_trains)
            for name, drive in bare.drive_trains.items():
                for entry in fields(drive):
                    known = getattr(file.drive_trains[name], entry.name)
                    was = getattr(drive, entry.name)
                    if isinstance(was, Quantity):
                        known = (known.value, known.std)
                        was = (was.value, was.std)
                    exact = was is None or isinstance(was, bool)
                    assert known == (was if exact else pytest.approx(was, rel=1e-3)), entry.name
            assert file.torque_disturbance == pytest.approx(bare.torque_disturbance, rel=1e-3)


@pytest.mark.parametrize("name", ["ur5e", "ur10e", "so101"])
def test_in_ampere_the_filled_in_file_knows_what_the_urdf_with_its_constants_does(
    tmp_path: Path, name: str
) -> None:
    """Stating more never knows less: no spread of the file is wider than that of the URDF and the same constants."""
    urdf = Path(__file__).resolve().parents[2] / "urdf" / f"{name}.urdf"
    constant = "nominal_torque_constant_N_m_per_A"
    text = written(tmp_path, urdf.read_text())
    joints = [
        key.split(".")[1]
        for key in new_robot_file(str(urdf), tmp_path / "x.yaml", description_of).to_state
        if constant in key
    ]
    (tmp_path / "new.yaml").write_text(text.replace(MARKED, f"{constant}: 2.0"))
    stated = {f"joints.{each}.motor.{constant}": 2.0 for each in joints}
    file = load_robot(tmp_path / "new.yaml", {})
    alone = load_robot(urdf, stated)
    assert joints and set(file.drive_trains) >= set(joints)
    for each in joints:
        for term in fields(file.drive_trains[each]):
            mine, other = (getattr(robot.drive_trains[each], term.name) for robot in (file, alone))
            assert not isinstance(mine, Quantity) or mine.std <= other.std, (each, term.name)
    assert (
        file.arm_scale.std <= alone.arm_scale.std
        and file.torque_disturbance <= alone.torque_disturbance
    )


def test_a_nominal_constant_of_one_is_recorded_torque_too(tmp_path: Path) -> None:
    text = written(tmp_path).replace(MARKED, "nominal_torque_constant_N_m_per_A: 1")
    (tmp_path / "new.yaml").write_text(text)
    path = tmp_path / "new.yaml"
    assert load_robot(path).drive_trains["a"].torque_constant == Quantity(1.0, 0.15)
    assert load_robot(path, with_recorded_torque(path, {})).drive_trains[
        "a"
    ].torque_constant == Quantity(1.0, 0.1)


@pytest.mark.skipif(not UR10E.exists(), reason="needs the real recordings")
def test_a_real_arms_urdf(tmp_path: Path) -> None:
    """Its meshes do not exist, it has blocks of a simulator, and its tool frame has no mass."""
    assert main(["robot", "new", str(UR10E), "--output", str(tmp_path / "ur10e.yaml")]) == 0
    content = yaml_of((tmp_path / "ur10e.yaml").read_text())
    assert len(content["joints"]) == 6 and content["payload_frame"] == "ee_link"
    # 330 N m by its URDF
    assert content["joints"]["shoulder_lift_joint"]["drive_train"]["coulomb_N_m"] == {
        "value": 0,
        "std": 33,
    }
    assert not set(JOINT) & {"transmission_m_per_rad"} & set(content["joints"]["elbow_joint"])


def test_limits_of_nothing_are_said_and_no_limit_of_a_motor(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    urdf = THREE.replace('effort="', 'effort="0" was="')
    assert urdf != THREE
    (tmp_path / "arm.urdf").write_text(urdf)
    output = tmp_path / "new.yaml"
    words = ["robot", "new", str(tmp_path / "arm.urdf"), "--effort-unit", "N.m"]
    assert main([*words, "--output", str(output)]) == 0
    assert "state current_limit_A of: a, b" in capsys.readouterr().out
    load_robot(output)  # whoever weighs needs none
    assert main([*words, "--output", str(output), "--force", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["no_effort_limit"] == ["a", "b"]
    assert main(["plan", "--robot", str(output), "--mass", "0.05"]) == 2
    assert "state joints.a.motor.current_limit_A" in capsys.readouterr().err
