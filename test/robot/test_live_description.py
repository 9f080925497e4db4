"""A robot's description as a topic brings it: it is a URDF file from then on, and another one later is said, not used."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.small_urdf import LIMIT, THREE, chain, joint, link

from proprio_ros.errors import RobotError
from proprio_ros.inputs.resources import resource
from proprio_ros.live.workspace import Workspace
from proprio_ros.pipeline.request import Options, robot_of
from proprio_ros.robot import LiveDescription
from proprio_ros.robot.live_description import is_topic, topic_of

TOPIC = "/arm1/robot_description"
ARM = resource("urdf", "open_manipulator_x").read_text()
TORQUE = {"effort_unit": "N.m"}


def test_which_robots_are_topics() -> None:
    assert all(
        is_topic(name)
        for name in ("robot_description", "/robot_description", "/left/robot_description")
    )
    assert not any(
        is_topic(name)
        for name in ("open_manipulator_x", "robot_description.urdf", "robot_descriptions:ur10e")
    )
    assert (
        topic_of("/left/robot_description") == "/left/robot_description"
        and topic_of("pendulum") == "robot_description"
    )


def test_the_robot_is_that_of_the_same_text_as_a_file(tmp_path: Path) -> None:
    heard = LiveDescription(TOPIC, tmp_path / "data")
    assert heard.problem.startswith(f"waits for {TOPIC}") and heard.path is None
    severity, said = heard.hear(ARM)
    assert severity == "info" and TOPIC in said and not heard.problem
    assert heard.path is not None and heard.path.is_relative_to(tmp_path / "data")
    live = Workspace(tmp_path, str(heard.path), TORQUE).configured({})
    (tmp_path / "arm.urdf").write_text(ARM)
    file = robot_of(Options(robot=str(tmp_path / "arm.urdf"), effort_unit="N.m"))
    assert live.model.fingerprint() == file.model.fingerprint()
    assert live.drive_trains == file.drive_trains and list(live.drive_trains) == [
        "joint1",
        "joint2",
        "joint3",
        "joint4",
    ]
    assert live.payload_frame == file.payload_frame
    assert heard.hear(ARM) == ("info", ""), "the same again is nothing new"


def test_text_that_is_decoded_already_is_not_decoded_again(tmp_path: Path) -> None:
    heard = LiveDescription(TOPIC, tmp_path)
    heard.hear('<?xml version="1.0" encoding="iso-8859-1"?>\n' + THREE.replace('"two"', '"\u00e9"'))
    assert heard.path is not None
    assert "\u00e9" in [
        each.name
        for each in Workspace(
            tmp_path,
            str(heard.path),
            TORQUE,
        )
        .configured({})
        .model.links
    ]


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "not XML"),
        ("hello", "not XML"),
        ("<sdf/>", "not a <robot>"),
        (
            chain(joint("a"), links=link("base") + '<link name="one"/>'),
            "link one: <inertial> is missing",
        ),
        (chain(joint("a", kind="prismatic")), "no joint of arm turns"),
        (chain(joint("a", kind="fixed", limit="")), "no joint of arm turns"),
    ],
)
def test_what_is_no_description_is_one_line(tmp_path: Path, text: str, why: str) -> None:
    heard = LiveDescription(TOPIC, tmp_path)
    severity, said = heard.hear(text)
    assert severity == "warning" and why in said and TOPIC in said and "\n" not in said
    assert said == heard.problem and heard.path is None and not list(tmp_path.iterdir())
    assert heard.hear(ARM)[0] == "info" and not heard.problem, "it waits for another"


def test_another_model_later_is_said_and_not_used(tmp_path: Path) -> None:
    heard = LiveDescription(TOPIC, tmp_path)
    heard.hear(ARM)
    path = heard.path
    severity, said = heard.hear(ARM.replace('mass value="', 'mass value="1'))
    assert severity == "warning" and said == heard.problem
    assert f"{TOPIC} has changed" in said and "configure this node again" in said
    assert heard.path == path and len(list(tmp_path.rglob("*.urdf"))) == 1
    assert heard.hear(ARM)[0] == "info" and not heard.problem, "it is back"
    severity, said = heard.hear("garbage")
    assert (
        severity == "warning" and "goes on with the one from before" in said and not heard.problem
    )
    weaker = LiveDescription(TOPIC, tmp_path)
    weaker.hear(ARM.replace('effort="4.1"', 'effort="2"'))
    assert weaker.path is not None and path is not None and weaker.path != path
    assert 'effort="4.1"' in path.read_text() and 'effort="2"' in weaker.path.read_text()
    assert weaker.path.name == path.name, "the same calibration fits it"
    # colours, meshes and limits are no other model
    assert heard.hear(ARM.replace("</robot>", '<material name="red"/></robot>')) == ("info", "")


def test_a_folder_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "data").write_text("a file where a folder should be")
    heard = LiveDescription(TOPIC, tmp_path / "data")
    severity, said = heard.hear(ARM)
    assert severity == "warning" and "name another data_directory" in said and heard.path is None


def test_a_calibration_of_another_urdf_is_refused(tmp_path: Path) -> None:
    heard = LiveDescription(TOPIC, tmp_path)
    heard.hear(chain(joint("a"), joint("b", "one", "two", limit=LIMIT)))
    (tmp_path / "motions.yaml").write_text(
        "extends: open_manipulator_x\nmodel_fingerprint: 0123456789abcdef\n"
    )
    with pytest.raises(RobotError, match="was made with another URDF than"):
        Workspace(tmp_path, str(heard.path), TORQUE).find_calibration(
            str(tmp_path / "motions.yaml")
        )


def test_without_torque_constants_the_parameters_that_help_are_named(tmp_path: Path) -> None:
    from proprio_ros.live.session import as_parameters

    heard = LiveDescription(TOPIC, tmp_path)
    heard.hear(ARM)
    with pytest.raises(RobotError, match="states no motor") as refused:
        Workspace(tmp_path, str(heard.path)).configured({})
    said = as_parameters(str(refused.value))
    assert (
        "the parameter effort_unit N.m" in said
        and "the parameter settings with robot.joints" in said
    )
    assert "--" not in said
    stated = {
        f"robot.joints.joint{n}.motor.nominal_torque_constant_N_m_per_A": 1.7 for n in (1, 2, 3, 4)
    }
    assert (
        Workspace(tmp_path, str(heard.path))
        .configured(stated)
        .drive_trains["joint1"]
        .nominal_torque_constant
        == 1.7
    )
