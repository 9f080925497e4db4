"""Grasps of an arm whose torso leans meanwhile."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.two_arms import TwoArms, write_urdf

from proprio_ros.addons.fleet.episodes import episodes_of
from proprio_ros.addons.fleet.job import Job
from proprio_ros.addons.fleet.rows import rows_of
from proprio_ros.cli import main
from proprio_ros.pipeline.request import Options

pytest.importorskip("mujoco")
TORSO = {"torso_lift_joint": 0.1, "torso_pitch_joint": 0.2, "torso_yaw_joint": -0.3}


@pytest.mark.long
def test_no_grasp_is_looked_for_while_the_torso_leans(tmp_path: Path) -> None:
    """By a torso that stands where it is in the mean, 0.7 kg read 0.4 and 1.3 kg, accepted."""
    write_urdf(tmp_path)
    robot = TwoArms(2)
    robot.record(tmp_path / "stood", "left", 0.0, TORSO)
    robot.record(tmp_path / "leant", "left", 0.7, TORSO, {"torso_pitch_joint": 0.3})
    file = str(tmp_path / "left.yaml")
    calibration = str(tmp_path / "calibration.yaml")
    urdf = str(tmp_path / "two_arms.urdf")
    torque = ["--effort-unit", "N.m"]
    assert main(["robot", "new", urdf, "--tip", "left_tool0", *torque, "--output", file]) == 0
    words = ["calibrate", str(tmp_path / "stood"), "--robot", file, "--output", calibration]
    assert main([*words, *torque]) == 0
    options = Options(probe="payload", calibration=calibration, effort_unit="N.m")
    (episode,) = episodes_of([tmp_path / "leant"])
    (row,) = rows_of(episode, Job(options, grasps=True))
    assert any("no grasps are looked for" in note and "leant over" in note for note in row["notes"])
    assert row["low"] < 0.7 < row["high"]
