"""Data sets of LeRobot: episodes are the recordings that bags of the same numbers are, whole or in parts, or one clear line."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("pyarrow", reason="needs the extra batch")

from support.lerobot_layout import write_data_set

from proprio_ros.errors import ConfigurationError, RecordingError
from proprio_ros.recordings.datasets import (
    episode_of,
    is_data_set,
    marked,
    open_data_set,
    parts_of_episode,
    read_columns,
    read_episode,
)
from proprio_ros.recordings.effort import Effort
from proprio_ros.recordings.motions import Motion
from proprio_ros.recordings.read_options import Columns, ReadOptions
from proprio_ros.recordings.topics import Conventions
from proprio_ros.records import MEASURED_EFFORT, Recording

JOINTS = ("j1", "j2", "j3", "j4")
CONSTANTS = (1.0, 2.0, 0.5, 1.5)
NOMINAL = dict(zip(JOINTS, CONSTANTS, strict=True))
VERSIONS = ("v2.1", "v3.0")


def motion(seconds: float = 4.0, scale: float = 1.0) -> Motion:
    times_s = np.arange(0.0, seconds, 0.02)
    position = scale * np.column_stack([np.sin((1.0 + n) * times_s) for n in range(4)])
    current_A = 0.3 * np.column_stack([np.cos((1.0 + n) * times_s) for n in range(4)])
    return Motion("m", JOINTS, times_s, position, current_A, {}, "measured current")


def write(folder: Path, *motions: Motion, **options: Any) -> Path:
    return write_data_set(
        folder / "set",
        motions or [motion()],
        CONSTANTS,
        rate_hz=50.0,
        **options,
    )


def read(folder: Path, index: int = 0, columns: Columns | None = None, **changes: Any) -> Recording:
    unit = changes.pop("effort_unit", "N.m")
    conventions = Conventions(
        names=changes.pop("names", {}),
        prefix=changes.pop("prefix", ""),
    )
    options = ReadOptions(
        Effort(unit, changes.pop("nominal_torque_constants", NOMINAL)),
        conventions=conventions,
        columns=columns or Columns(),
        **changes,
    )
    return read_episode(folder, index, options)


@pytest.mark.parametrize("version", VERSIONS)
def test_an_episode_has_the_numbers_that_were_written(tmp_path: Path, version: str) -> None:
    motions = [motion(2.0 + n, 0.5 + n) for n in range(3)]
    folder = write(tmp_path, *motions, version=version)
    assert is_data_set(folder) and not is_data_set(tmp_path)
    data = open_data_set(folder)
    assert [each.length for each in data.episodes.values()] == [
        len(each.times_s) for each in motions
    ]
    for index, written in enumerate(motions):
        recording = read(folder, index)
        assert recording.name == f"set#{index}" and recording.notes == ()
        assert recording.joints.names == JOINTS
        # columns are float32
        assert np.allclose(1e-9 * recording.joints.times_ns, written.times_s, atol=1e-6)
        assert np.allclose(recording.joints.position, written.position, atol=1e-6)
        assert recording.inputs is not None and recording.inputs.source == MEASURED_EFFORT
        assert np.allclose(recording.inputs.current_A, written.current_A, atol=1e-6)
        assert recording.joints.effort is not None
        assert np.allclose(
            recording.joints.effort, written.current_A * np.array(CONSTANTS), atol=1e-6
        )
        # where they were sent: action
        assert recording.signals is not None and recording.signals.names == JOINTS


@pytest.mark.parametrize("version", VERSIONS)
def test_parts_cover_an_episode(tmp_path: Path, version: str) -> None:
    folder = write(
        tmp_path,
        motion(1.0),
        motion(6.0),
        version=version,
    )
    whole = read(folder, 1).joints
    spans = parts_of_episode(folder, 1, 90)
    assert len(spans) == 4 and parts_of_episode(folder, 0, 90) == [(0, None)]
    parts = [read(folder, 1, span=span).joints for span in spans]
    assert max(len(part.times_ns) for part in parts) <= 90
    assert np.array_equal(np.concatenate([part.position for part in parts]), whole.position)
    with pytest.raises(
        RecordingError, match="no frames in this part of the recording; it has 300 in all"
    ):
        read(folder, 1, span=(10**12, None))


def test_the_meaning_of_effort_is_stated_or_left_out(tmp_path: Path) -> None:
    folder = write(tmp_path)
    recording = read(folder, effort_unit=None)
    assert (
        recording.inputs is None
        and recording.joints.effort is None
        and recording.joints.current is None
    )
    assert recording.joints.reported_effort is not None
    current = read(folder, effort_unit="mA").inputs
    assert current is not None
    assert np.allclose(current.current_A, 1e-3 * recording.joints.reported_effort)
    with pytest.raises(
        ConfigurationError, match=r"'furlongs' is not known; choose from N\.m, A, mA, raw"
    ):
        read(folder, effort_unit="furlongs")


def test_joints_get_the_robots_names(tmp_path: Path) -> None:
    folder = write(tmp_path)
    assert read(
        folder,
        prefix="j",
        names={"1": "base"},
    ).joints.names == ("base", "2", "3", "4")
    with pytest.raises(
        RecordingError, match=r"two joints of observation\.state would have one name"
    ):
        read(folder, names={"j1": "j2"})


def test_units_are_those_of_the_profile(tmp_path: Path) -> None:
    written = motion(2.0, 2.0)
    degrees = replace(written, position=np.rad2deg(written.position))
    folder = write(tmp_path, degrees)
    given: dict[str, Any] = {"nominal_torque_constants": {"j1": 1.0}}
    found = read(
        folder,
        0,
        Columns(position_unit="deg", percent=("j4",)),
        limits={"j4": (-1.0, 1.0)},
        **given,
    )
    assert np.allclose(
        found.joints.position[:, :3],
        written.position[:, :3],
        atol=1e-5,
    )
    assert np.allclose(
        found.joints.position[:, 3],
        -1.0 + 0.02 * degrees.position[:, 3],
        atol=1e-4,
    )
    assert found.joints.current is not None and np.isnan(found.joints.current[:, 1]).all()
    with pytest.raises(RecordingError, match="no angle in rad"):
        read(folder, **given)


def test_frames_without_a_position_are_left_out_and_counted(tmp_path: Path) -> None:
    written = motion()
    written.position[[5, 6, 40], 2] = np.nan
    recording = read(write(tmp_path, written))
    assert len(recording.joints.times_ns) == len(written.times_s) - 3
    assert recording.notes == (
        f"3 of {len(written.times_s)} frames have no finite position or no new time; they were left out.",
    )
    written.position[3:] = np.nan
    with pytest.raises(RecordingError, match="only 3 frames are usable, at least 5 are needed"):
        read(write(tmp_path / "few", written))


def test_an_effort_that_is_missing_in_some_frames_is_held_as_in_a_bag(tmp_path: Path) -> None:
    written = motion()
    written.current_A[10:13, 1] = np.nan
    inputs = read(write(tmp_path, written)).inputs
    assert inputs is not None and inputs.names == JOINTS
    assert np.array_equal(inputs.current_A[10:13, 1], np.full(3, inputs.current_A[9, 1]))


def test_marked_episodes(tmp_path: Path) -> None:
    folder = write(
        tmp_path,
        motion(),
        motion(),
        extra={"hand_empty": [1.0, 0.0]},
    )
    assert [marked(open_data_set(folder), index, "hand_empty") for index in range(2)] == [
        True,
        False,
    ]
    with pytest.raises(RecordingError, match="no column success; there are: "):
        marked(open_data_set(folder), 0, "success")


def test_a_data_set_that_is_not_whole_is_refused_in_a_line(tmp_path: Path) -> None:
    folder = write(tmp_path, version="v2.1")
    with pytest.raises(RecordingError, match="no such episode; the data set has 1"):
        read(folder, 7)
    with pytest.raises(RecordingError, match=r"no column state; there are: observation\.state"):
        read(folder, 0, Columns(position="state"))
    episodes = folder / "meta" / "episodes.jsonl"
    episodes.write_text(episodes.read_text().replace("200", "201"))
    (folder / "meta" / "info.json").touch()
    with pytest.raises(
        RecordingError, match=r"201 frames by meta, 200 in .*: the data set is not whole"
    ):
        read(folder)
    next(folder.glob("data/*/*.parquet")).unlink()
    with pytest.raises(RecordingError, match="is missing: download the data set again"):
        read_columns(open_data_set(folder), 0, ["timestamp"])
    (tmp_path / "meta").mkdir()
    (tmp_path / "meta" / "info.json").write_text('{"codebase_version": "v1.6", "fps": 30}')
    with pytest.raises(RecordingError, match=r"version v1\.6; 2\.1 and 3 are read"):
        open_data_set(tmp_path)
    (tmp_path / "meta" / "info.json").write_text('{"codebase_version": "v3.0"')
    with pytest.raises(RecordingError, match="not readable"):
        open_data_set(tmp_path)
    assert episode_of("a/b#12") == (Path("a/b"), 12) and episode_of("a/b") is None


def stamped(rows: list[int], time_s: float) -> Motion:
    """A motion some of whose frames have another time."""
    times_s = motion().times_s.copy()
    times_s[rows] = time_s
    return replace(motion(), times_s=times_s)


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf, 1e30])
@pytest.mark.parametrize("rows", [[0], [3, 4, 5], [199], list(range(0, 200, 2))])
def test_frames_without_a_time_are_left_out_and_it_is_said(
    tmp_path: Path, wrong: float, rows: list[int]
) -> None:
    whole = read(write(tmp_path / "whole"))
    folder = write(tmp_path / "bent", stamped(rows, wrong))
    recording = read(folder)
    kept = np.setdiff1d(np.arange(200), rows)
    assert np.array_equal(recording.joints.position, whole.joints.position[kept])
    times_ns = whole.joints.times_ns[kept]
    assert np.abs(recording.joints.times_ns - (times_ns - times_ns[0])).max() <= 2
    part = read(folder, span=(0, 2_000_000_000))
    assert 0 < len(part.joints.times_ns) <= 101
    assert f"{len(rows)} of 200 frames" in " ".join(recording.notes)


def test_a_data_set_without_a_time_is_one_sentence(tmp_path: Path) -> None:
    folder = write(
        tmp_path,
        stamped(list(range(200)), np.nan),
    )
    with pytest.raises(RecordingError, match="no frame has a finite timestamp") as caught:
        read(folder)
    assert "\n" not in str(caught.value)


def timed(folder: Path, times_s: np.ndarray) -> Path:
    """A data set of one episode, stamped otherwise."""
    return write(folder, replace(motion(8.0), times_s=times_s))


TRUE_S = motion(8.0).times_s


@pytest.mark.parametrize("by_s", [-3.2, -100.0, 3.2, 500.0])
def test_a_clock_that_steps_is_cut_where_it_does(tmp_path: Path, by_s: float) -> None:
    later = np.arange(len(TRUE_S)) >= 170
    recording = read(timed(tmp_path, TRUE_S + np.where(later, by_s, 0.0)))
    assert "the recording was cut there" in recording.notes[0]
    found_s = 1e-9 * recording.joints.times_ns
    assert len(found_s) == len(TRUE_S)
    assert np.allclose(found_s[~later], TRUE_S[~later], atol=1e-4)
    assert np.allclose(np.diff(found_s[later]), 0.02, atol=1e-4)
    assert found_s[170] - found_s[169] == pytest.approx(0.2, abs=1e-4)


def test_frames_that_come_in_bursts_are_spread(tmp_path: Path) -> None:
    frames = np.arange(len(TRUE_S))
    arrived = TRUE_S[np.minimum(frames // 5 * 5 + 4, len(frames) - 1)] + 1e-5 * (frames % 5)
    recording = read(timed(tmp_path, arrived - arrived[0]))
    assert "400 of 400 frames come in bursts" in recording.notes[0]
    assert np.allclose(np.diff(1e-9 * recording.joints.times_ns), 0.02, atol=1e-3)


@pytest.mark.parametrize(
    ("times_s", "words"),
    [
        (50.0 * TRUE_S, "holds row numbers, and meta/info.json has 50 frames a second"),
        (1e3 * TRUE_S, "goes by 20 s a frame"),
        (1e-3 * TRUE_S, "goes by 2e-05 s a frame"),
    ],
)
def test_row_numbers_and_other_units_are_no_times(
    tmp_path: Path, times_s: np.ndarray, words: str
) -> None:
    with pytest.raises(RecordingError, match=words):
        read(timed(tmp_path, np.round(times_s, 6)))


def test_a_sign_bit_that_was_not_decoded_is(tmp_path: Path) -> None:
    """LeRobot once read the sign of Feetech's positions as a part of the number."""
    written = motion(6.0)
    count_rad = 2.0 * np.pi / 4096.0
    counts = np.round(written.position[:, 0] / count_rad)
    raw = written.position.copy()
    raw[:, 0] = count_rad * np.where(counts < 0.0, 32768.0 - counts, counts)
    folder = write(tmp_path, replace(written, position=raw))
    recording = read(folder)
    assert np.allclose(recording.joints.position[:, 0], count_rad * counts, atol=1e-4)
    (note,) = recording.notes
    assert note.startswith("position of j1: ") and "bit 15, was not decoded" in note
    assert recording.signals is not None
    assert np.allclose(recording.signals.goals[:, 0], count_rad * counts, atol=1e-4)
