"""A robot whose description may lie in a bag: whoever reads it needs no reader of bags before there is one to read."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from proprio_ros.errors import RecordingError, RobotError
from proprio_ros.recordings.description import description_of, robot_named


def test_a_robot_without_a_bag_brings_no_reader_along() -> None:
    code = (
        "import sys; from proprio_ros.recordings.description import robot_named; robot_named('open_manipulator_x'); "
        "assert not {'rosbags', 'warp'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_overrides_reach_the_robot() -> None:
    assert robot_named("open_manipulator_x", {"arm_scale": 1.1}).arm_scale.value == 1.1


def test_what_is_no_bag_is_refused_in_a_line(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="nowhere"):
        description_of(tmp_path / "nowhere")
    with pytest.raises(RobotError, match="unknown robot 'nobody'"):
        robot_named("nobody")
