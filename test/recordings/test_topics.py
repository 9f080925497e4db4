"""Which topic of a bag is what: found where it is certain, asked where it is not."""

from __future__ import annotations

from pathlib import Path

import pytest
from rosbags.rosbag2 import Writer
from support.small_bags import (
    FLOATS,
    JOINT_STATE,
    JOINTS,
    TYPES,
    commands,
    currents,
    positions,
    read,
    refused,
    state,
    states,
    times,
    write_bag,
)

from proprio_ros.records import MEASURED_EFFORT


def test_applied_effort_comes_before_commands_and_they_before_measured_effort(
    tmp_path: Path,
) -> None:
    measured = states(effort=[0.5] * 5)
    applied = [
        state(
            t,
            [],
            effort=[1.783 * i for i in currents(t, -0.2)][::-1],
            names=JOINTS[::-1],
            topic="/applied_effort",
        )
        for t in times()
    ]
    all_three = read(write_bag(tmp_path / "all", measured + commands() + applied))
    assert all_three.inputs is not None
    assert all_three.inputs.source == "/applied_effort"
    assert all_three.inputs.current_A[:, all_three.inputs.column("joint3")] == pytest.approx(
        [currents(t, -0.2)[2] for t in times()], abs=1e-15
    )
    two = read(write_bag(tmp_path / "two", measured + commands()))
    assert two.inputs is not None
    assert two.inputs.source == "/current_command"
    one = read(write_bag(tmp_path / "one", measured), effort_unit="A")
    assert one.inputs is not None
    assert one.inputs.source == MEASURED_EFFORT
    assert (one.inputs.current_A == 0.5).all()


def test_topics_under_a_namespace(tmp_path: Path) -> None:
    messages = states(topic="/arm/joint_states") + commands(topic="/arm/current_command")
    recording = read(write_bag(tmp_path / "bag", messages))
    assert recording.inputs is not None
    assert recording.inputs.source == "/arm/current_command"


def test_each_arm_has_its_own_input(tmp_path: Path) -> None:
    messages = []
    for arm in ("/left", "/right"):
        messages += states(topic=f"{arm}/joint_states") + commands(topic=f"{arm}/current_command")
    path = write_bag(tmp_path / "bag", messages)
    with refused("choose with --state-topic from: /left/joint_states .*, /right/joint_states"):
        read(path)
    recording = read(path, state_topic="/right/joint_states")
    assert recording.inputs is not None
    assert recording.inputs.source == "/right/current_command"
    recording = read(path, state_topic="left/joint_states", command_topic="right/current_command")
    assert recording.inputs is not None
    assert recording.inputs.source == "/right/current_command"


def test_the_only_joint_state_topic_is_taken_whatever_its_name(tmp_path: Path) -> None:
    applied = [
        state(
            t,
            [],
            effort=[1.783 * i for i in currents(t)],
            topic="/applied_effort",
        )
        for t in times()
    ]
    recording = read(write_bag(tmp_path / "bag", states(topic="/feedback") + applied))
    assert recording.inputs is not None
    assert recording.inputs.source == "/applied_effort"


def test_the_other_joint_states_are_the_command_that_the_user_names(tmp_path: Path) -> None:
    desired = [
        state(
            t,
            [],
            effort=[1.783 * i for i in currents(t)],
            topic="/desired",
        )
        for t in times()
    ]
    path = write_bag(tmp_path / "bag", states(topic="/feedback") + desired)
    with refused("choose with --state-topic from: /desired .*, /feedback"):
        read(path)
    recording = read(path, command_topic="/desired")
    assert recording.inputs is not None
    assert recording.inputs.source == "/desired"
    assert recording.joints.position[-1].tolist() == positions(times()[-1])


def test_several_inputs_are_not_chosen_from(tmp_path: Path) -> None:
    messages = (
        states() + commands(topic="/a/current_command") + commands(topic="/b/current_command")
    )
    path = write_bag(tmp_path / "bag", messages)
    with refused("choose with --command-topic from: /a/current_command .*/b/current_command"):
        read(path)


@pytest.mark.parametrize("msgtype", [FLOATS, "std_msgs/msg/Float32MultiArray"])
def test_a_named_command_topic(tmp_path: Path, msgtype: str) -> None:
    messages = states() + commands(topic="/effort_controller/commands", msgtype=msgtype)
    path = write_bag(tmp_path / "bag", messages)
    assert read(path).inputs is None
    inputs = read(path, command_topic="/effort_controller/commands").inputs
    assert inputs is not None
    assert inputs.current_A[15, 2] == pytest.approx(-0.3, rel=1e-7)


def test_joint_states_named_as_command_are_measured_effort(tmp_path: Path) -> None:
    path = write_bag(
        tmp_path / "bag",
        states(effort=[0.8] * 5) + commands(),
    )
    with refused("--effort-unit"):
        read(path, command_topic="/joint_states")
    inputs = read(path, command_topic="/joint_states", effort_unit="A").inputs
    assert inputs is not None
    assert inputs.measured


@pytest.mark.parametrize(
    ("options", "pattern"),
    [
        (
            {"state_topic": "/nope"},
            r"--state-topic /nope is not in the bag; choose from: /joint_states",
        ),
        (
            {"state_topic": "/current_command"},
            "is std_msgs/msg/Float64MultiArray; choose from: /joint_states",
        ),
        (
            {"command_topic": "/nope"},
            r"--command-topic /nope is not in the bag; .*/current_command",
        ),
    ],
)
def test_a_named_topic_that_does_not_fit(
    tmp_path: Path, options: dict[str, str], pattern: str
) -> None:
    with refused(pattern):
        read(
            write_bag(tmp_path / "bag", states() + commands()),
            **options,
        )


def test_no_messages_and_no_joint_states(tmp_path: Path) -> None:
    with refused("holds no messages"):
        read(write_bag(tmp_path / "empty", []))
    with refused(
        r"no JointState topic in the bag; it holds: /current_command \(std_msgs/Float64MultiArray\)"
    ):
        read(write_bag(tmp_path / "commands", commands()))
    with Writer(tmp_path / "silent", version=9) as writer:
        writer.add_connection("/joint_states", JOINT_STATE, typestore=TYPES)
        writer.write(
            writer.add_connection("/x", FLOATS, typestore=TYPES),
            1,
            b"\0\1\0\0",
        )
    with refused("/joint_states .*holds no messages"):
        read(tmp_path / "silent")
    with refused("--state-topic /joint_states holds no messages"):
        read(tmp_path / "silent", state_topic="/joint_states")
