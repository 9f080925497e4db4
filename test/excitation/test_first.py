"""The first pushes of an arm without sequences, against MuJoCo's gravity and against the way the hand really goes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.foreign_arm import JOINTS, urdf

from proprio_ros.errors import ConfigurationError
from proprio_ros.excitation.first import CLEARANCE_M, first_sequence
from proprio_ros.excitation.plans import load_sequence
from proprio_ros.robot import Robot, load_robot
from proprio_ros.robot.kinematics import clearance, zero_pose
from proprio_ros.robot.new_file import new_robot_file


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    folder = tmp_path_factory.mktemp("arm")
    (folder / "foreign.urdf").write_text(urdf(), encoding="utf-8")
    path = folder / "foreign.yaml"
    path.write_text(
        new_robot_file(str(folder / "foreign.urdf"), path, torque_recorded=True).text,
        encoding="utf-8",
    )
    return load_robot(path)


def test_pushes_begin_at_gravity_and_with_little_beside(robot: Robot, tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(urdf())
    data = mujoco.MjData(model)
    sequence = load_sequence("empty_hand", robot)
    assert sequence.hand == "empty"
    assert len({run.joint for run in sequence.runs}) == 2
    for run in sequence.runs:
        data.qpos[:] = [run.start[name] for name in JOINTS]
        mujoco.mj_forward(model, data)
        column = JOINTS.index(run.joint)
        turned = np.zeros(3)
        mujoco.mj_mulM(
            model,
            data,
            turned,
            np.eye(3)[column],
        )
        beyond = run.current_A - data.qfrc_bias[column]
        if run.raise_by < 1.0:  # is lowered: carried a little less than it weighs
            assert 0.1 < beyond / -data.qfrc_bias[column] < 0.2
        else:
            rotor = robot.drive_trains[run.joint].armature.std
            # rad/s^2 at most, were there no friction
            assert abs(beyond) <= 1.6 * (turned[column] + rotor)
            assert run.max_current_A == pytest.approx(
                0.9 * robot.model.joint(run.joint).effort_limit
            )


@pytest.mark.parametrize("name", ["ur5e", "iiwa14", "panda", "vx300s", "so101"])
def test_ready_robots_without_sequences_have_some(name: str) -> None:
    robot = load_robot(name)
    for hand in ("empty_hand", "payload", "reference"):
        sequence = load_sequence(hand, robot)
        for run in sequence.runs:
            for way in (-0.6, 0.6):
                pose = {**zero_pose(robot), **run.start}
                assert clearance(robot, {**pose, run.joint: pose[run.joint] + way}) > CLEARANCE_M
    assert all(
        run.goal_step and not run.current_A
        for run in load_sequence("payload", load_robot("so101")).runs
    )


def test_both_ways_and_both_sides(robot: Robot) -> None:
    for name in {run.joint for run in first_sequence(robot, "payload").runs}:
        runs = [run for run in first_sequence(robot, "payload").runs if run.joint == name]
        assert len({tuple(run.start.values()) for run in runs}) == 2
        assert len(runs) == 4
        assert {run.raise_by < 1.0 for run in runs} == {True, False}


def test_an_arm_on_which_nothing_weighs_is_refused(robot: Robot) -> None:
    flat = replace(
        robot,
        gravity=np.array([0.0, 9.81, 0.0]),
    )  # all its axes lie along gravity
    with pytest.raises(ConfigurationError, match="no joint that a motor turns feels a weight"):
        first_sequence(flat, "payload")
