"""Recordings as text: read, or refused in one clear line."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from support.small_bags import refused

from proprio_ros.recordings.text import is_text_recording, read_text_recording


def test_the_papers_recording(recordings: Path) -> None:
    path = recordings / "paper_heavy_ball"
    assert is_text_recording(path)
    recording = read_text_recording(path)
    assert (recording.name, recording.joint) == ("paper_heavy_ball", "joint3")
    t = recording.times_s
    # its README: the samples are this cubic
    assert recording.relative_position == pytest.approx(
        1.41992 * t**3 - 1.04018 * t**2 - 1.62633 * t, abs=2e-5
    )
    assert recording.setting["torque_N_m"] == -0.49


SETTING = {
    "moving_joint": "joint3",
    "torque_N_m": -0.49,
    "start_pose_rad": {"joint2": 0.0, "joint3": 0.4},
}
TABLE = "time_s,joint3_relative_rad\n" + "".join(f"{row / 60},{-row / 50}\n" for row in range(6))


def write_text_recording(
    path: Path,
    setting: Any = SETTING,
    table: str = TABLE,
) -> Path:
    path.mkdir()
    (path / "setting.json").write_text(setting if isinstance(setting, str) else json.dumps(setting))
    (path / "trajectory.csv").write_text(table)
    return path


@pytest.mark.parametrize(
    ("each_s", "words"), [(1.0, "holds row numbers"), (16.7, "goes by 16.7 a row: is it in ms?")]
)
def test_times_that_are_none_are_refused(tmp_path: Path, each_s: float, words: str) -> None:
    header = "time_s,joint3_relative_rad\n"
    rows = "".join(f"{row * each_s},{-row / 50}\n" for row in range(30))
    with refused(words):
        read_text_recording(write_text_recording(tmp_path / "text", table=header + rows))


def test_a_text_recording(tmp_path: Path) -> None:
    recording = read_text_recording(write_text_recording(tmp_path / "text"))
    assert recording.times_s.tolist() == [row / 60 for row in range(6)]
    assert recording.relative_position.tolist() == [-row / 50 for row in range(6)]
    assert recording.setting == SETTING
    assert not is_text_recording(tmp_path)
    with refused("needs trajectory.csv and setting.json"):
        read_text_recording(tmp_path)


@pytest.mark.parametrize(
    ("setting", "pattern"),
    [
        ("{", "not readable as JSON"),
        ([], "moving_joint, torque_N_m, start_pose_rad missing"),
        ({"moving_joint": "joint3"}, "torque_N_m, start_pose_rad missing"),
        (SETTING | {"moving_joint": "joint9"}, "'joint9' too"),
        (SETTING | {"moving_joint": ["joint3"]}, "moving_joint must be a name"),
        (
            SETTING | {"start_pose_rad": {"joint3": "up"}},
            r"start_pose_rad\.joint3 must be a number, got 'up'",
        ),
        (SETTING | {"torque_N_m": None}, "torque_N_m must be a number"),
        (SETTING | {"true_mass_kg": True}, "true_mass_kg must be a number"),
    ],
)
def test_settings_that_are_refused(tmp_path: Path, setting: Any, pattern: str) -> None:
    with refused(pattern):
        read_text_recording(write_text_recording(tmp_path / "text", setting=setting))


@pytest.mark.parametrize(
    ("change", "pattern"),
    [
        (
            lambda table: table.replace("joint3", "joint2"),
            "the header must be time_s,joint3_relative_rad, got",
        ),
        (lambda table: table + "0.2,abc\n", "not a table of numbers"),
        (lambda table: table + "0.2\n", "not a table of numbers"),
        (lambda table: table + "0.2,nan\n", "finite numbers"),
        (lambda table: table + "0.01,0.0\n", "must increase"),
        (lambda table: "\n".join(table.split("\n")[:4]), "at least 5 rows"),
        (lambda table: "", "not a table of numbers"),
    ],
)
def test_tables_that_are_refused(
    tmp_path: Path, change: Callable[[str], str], pattern: str
) -> None:
    with refused(pattern):
        read_text_recording(write_text_recording(tmp_path / "text", table=change(TABLE)))
