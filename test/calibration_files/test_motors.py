"""Whose arm a recording and a calibration are of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from proprio_ros.calibration_files.motors import MotorIdentity, Motors, other_arm, other_firmware
from proprio_ros.calibration_files.pushes import Calibration
from proprio_ros.errors import RecordingError
from proprio_ros.live.session import check_input
from proprio_ros.pipeline.calibrate import calibrate_from_bags, write_calibration
from proprio_ros.pipeline.request import Request
from proprio_ros.recordings.for_robot import motors_notes
from proprio_ros.recordings.messages import RawMessage, message_types
from proprio_ros.recordings.sources import BagSource
from proprio_ros.recordings.topics import STATUS
from proprio_ros.recordings.writer import write_messages
from proprio_ros.robot import Robot, load_robot

ELBOW = MotorIdentity(
    model=1020, id=13, firmware=46, homing_offset=0, drive_mode=0, moving_threshold=10
)
ARM = {"joint2": replace(ELBOW, id=12), "joint3": ELBOW}


def states(namespace: str = "") -> list[RawMessage]:
    """An arm at rest."""
    types = message_types()
    kind = types.types["sensor_msgs/msg/JointState"]
    header = types.types["std_msgs/msg/Header"]
    time = types.types["builtin_interfaces/msg/Time"]
    messages = []
    for n in range(20):
        message = kind(
            header(time(1_700_000_000, n * 10_000_000), ""),
            ["joint2", "joint3"],
            *[np.array([0.1, 0.2])] * 3,
        )
        data = bytes(types.serialize_cdr(message, kind.__msgtype__))
        messages.append(
            RawMessage(f"{namespace}/joint_states", kind.__msgtype__, n * 10_000_000, data)
        )
    return messages


def said(
    values: Mapping[str, str],
    namespace: str = "",
) -> RawMessage:
    """What a driver says of its motors."""
    types = message_types()
    pair = types.types["diagnostic_msgs/msg/KeyValue"]
    message = types.types[STATUS](
        0, "driver: motors", "", "", [pair(key, value) for key, value in values.items()]
    )
    return RawMessage(
        f"{namespace}/motors",
        STATUS,
        5,
        bytes(types.serialize_cdr(message, STATUS)),
    )


def told(
    motors: Mapping[str, MotorIdentity],
    namespace: str = "",
) -> RawMessage:
    return said(
        {joint: motor.as_text() for joint, motor in motors.items()},
        namespace,
    )


def bag(folder: Path, *messages: RawMessage) -> Path:
    write_messages(folder, messages)
    return folder


def motors_of(path: Path, state_topic: str | None = None) -> Motors:
    with BagSource(path) as source:
        return source.motors(state_topic)


def notes_of(
    path: Path,
    robot: Robot,
) -> tuple[str, ...]:
    with BagSource(path) as source:
        return motors_notes(source, robot, None)


@pytest.fixture
def calibrated(tmp_path: Path) -> Robot:
    """An arm whose calibration knows its motors, read from its file."""
    terms = (
        "torque_constant",
        "coulomb",
        "viscous",
        "load_friction",
        "armature",
        "zero",
        "stribeck",
        "stribeck_velocity",
    )
    values = np.array([1.7, 0.04, 0.01, 0.02, 0.014, 0.0, 0.0, 0.1])
    known = Calibration(
        tuple((term, "joint3") for term in terms),
        values,
        np.diag((0.01 * values + 1e-4) ** 2),
        motors=ARM,
    )
    write_calibration(tmp_path / "arm.yaml", load_robot("open_manipulator_x"), known)
    robot = load_robot(tmp_path / "arm.yaml")
    assert robot.calibration is not None and robot.calibration.motors == ARM
    return robot


def test_the_same_motors(tmp_path: Path, calibrated: Robot) -> None:
    path = bag(tmp_path / "bag", *states(), told(ARM))
    assert motors_of(path) == ARM
    assert notes_of(path, calibrated) == ()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"homing_offset": -35}, "joint3 has homing offset -35, not 0"),
        ({"id": 3}, "joint3 has id 3, not 13"),
        ({"model": 1030}, "joint3 has model 1030, not 1020"),
        ({"drive_mode": 1}, "joint3 has drive mode 1, not 0"),
        ({"moving_threshold": 11}, "joint3 has moving threshold 11, not 10"),
    ],
)
def test_another_arm_is_refused(
    tmp_path: Path,
    calibrated: Robot,
    change: dict[str, int],
    words: str,
) -> None:
    other = {**ARM, "joint3": replace(ELBOW, **change)}
    path = bag(tmp_path / "bag", *states(), told(other))
    with pytest.raises(RecordingError, match=words) as caught:
        notes_of(path, calibrated)
    assert "arm.yaml" in str(caught.value) and "\n" not in str(caught.value)
    with pytest.raises(RecordingError, match=words):  # live, before anything moves
        check_input(
            tmp_path / "session",
            [*states(), told(other)],
            Request(calibrated),
        )
    # nothing is claimed of any arm
    assert notes_of(path, load_robot("open_manipulator_x")) == ()


def test_other_firmware_is_the_same_arm(tmp_path: Path, calibrated: Robot) -> None:
    path = bag(
        tmp_path / "bag",
        *states(),
        told({**ARM, "joint3": replace(ELBOW, firmware=48)}),
    )
    (note,) = notes_of(path, calibrated)
    assert "other firmware" in note and "joint3 48 (was 46)" in note
    assert other_firmware(ARM, ARM) == ""


def test_what_is_not_said_is_not_compared(tmp_path: Path, calibrated: Robot) -> None:
    silent = bag(tmp_path / "silent", *states())
    assert motors_of(silent) == {} and notes_of(silent, calibrated) == ()
    foreign = bag(
        tmp_path / "foreign",
        *states(),
        said({"joint3": "fine", "joint2": "[" * 900, "x": '{"id": "a"}'}),
    )
    assert motors_of(foreign) == {} and notes_of(foreign, calibrated) == ()
    assert other_arm(ARM, {"joint4": ELBOW}) == ""


def test_of_two_arms_in_one_bag_each_has_its_own(tmp_path: Path) -> None:
    other = {"joint3": replace(ELBOW, homing_offset=7)}
    path = bag(
        tmp_path / "bag",
        *states("/arm1"),
        *states("/arm2"),
        told(ARM, "/arm1"),
        told(other, "/arm2"),
    )
    assert motors_of(path, "/arm1/joint_states") == ARM
    assert motors_of(path, "/arm2/joint_states") == other
    assert motors_of(path) == {}


def test_one_calibration_is_of_one_arm(tmp_path: Path) -> None:
    other = {
        **ARM,
        "joint2": replace(ARM["joint2"], homing_offset=9),
    }
    one = bag(tmp_path / "one", *states(), told(ARM))
    two = bag(tmp_path / "two", *states(), told(other))
    with pytest.raises(
        RecordingError,
        match="another arm than that of the recordings before it: joint2 has homing offset 9",
    ):
        calibrate_from_bags([one, two], {})
