"""Batches: the rows are those of `replay` one by one, a job goes on where it stopped, and nothing that an episode holds ends it."""

from __future__ import annotations

import importlib.util
import json
import os
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("pyarrow", reason="needs the extra batch")
pytest.importorskip("mujoco", reason="needs the extra sim")
sys.path.insert(0, str(Path(__file__).parent))

from fleet import FOUR, SETTINGS, Arm, deadly, write_bag, write_robot
from lerobot_layout import write_data_set

import proprio_ros.batch.local as local
from proprio_ros.batch.episodes import episodes_of
from proprio_ros.batch.grasps import grasps_of
from proprio_ros.batch.job import run_batch
from proprio_ros.batch.rows import Job, rows_of
from proprio_ros.batch.store import Store, chunks_of
from proprio_ros.calibrating import calibrate_from_bags
from proprio_ros.cli import main
from proprio_ros.datasets import episode_of, open_data_set, read_episode
from proprio_ros.errors import ConfigurationError, RecordingError
from proprio_ros.replay import ReplayOptions, prepare, read_for, replay

MASSES_KG = (0.0, 0.05, 0.1)
PROFILE = "title: rad and N m\neffort_unit: N.m\ncolumns: {position_unit: rad}\n"


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three bags and two data sets of the same motions, one bag that is cut short, and a calibration of the arm."""
    folder = tmp_path_factory.mktemp("fleet")
    (folder / "data").mkdir()
    arm, robot = Arm(3), write_robot(folder, build=FOUR)
    empty = [write_bag(folder / f"empty_{n}", arm.record(900 + n, 20.0)) for n in range(2)]
    options = ReplayOptions(robot=str(robot), effort_unit="N.m")
    assert calibrate_from_bags(empty, {}, options, folder / "arm.yaml", lambda words: None).verdict.value == "accepted"
    motions = [arm.record(n, 12.0, mass) for n, mass in enumerate(MASSES_KG)]
    for n, motion in enumerate(motions):
        write_bag(folder / "data" / "bags" / f"{n}", motion)
    cut = write_bag(folder / "data" / "bags" / "cut", motions[0])
    storage = next(cut.glob("*.mcap"))
    storage.write_bytes(storage.read_bytes()[:3000])
    empties = {"hand_empty": [float(mass == 0.0) for mass in MASSES_KG]}
    write_data_set(folder / "data" / "v3", motions, FOUR.constants, rate_hz=50.0, extra=empties, per_file=2)
    write_data_set(folder / "data" / "v21", motions, FOUR.constants, rate_hz=50.0, version="v2.1")
    (folder / "units.yaml").write_text(PROFILE)
    return folder


def asked(folder: Path) -> ReplayOptions:
    return ReplayOptions(
        calibration=folder / "arm.yaml", effort_unit="N.m", settings=SETTINGS, driver=folder / "units.yaml"
    )


def table(out: Path) -> list[dict[str, Any]]:
    from pyarrow import dataset

    rows: list[dict[str, Any]] = dataset.dataset(out / "rows", partitioning="hive").to_table().to_pylist()
    return sorted(rows, key=lambda row: (row["source"], row["episode"], row["segment"]))


def same(one: list[dict[str, Any]], other: list[dict[str, Any]]) -> bool:
    """Bit for bit, but for how long it took."""
    return [{**row, "elapsed_s": 0.0} for row in one] == [{**row, "elapsed_s": 0.0} for row in other]


# --- data sets -------------------------------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize("version", ["v3", "v21"])
def test_an_episode_of_a_data_set_is_the_recording_of_a_bag(fleet: Path, version: str) -> None:
    prepared = prepare(asked(fleet))
    for n, mass in enumerate(MASSES_KG):
        _, of_bag = read_for(prepared, [fleet / "data" / "bags" / f"{n}"])
        _, of_set = read_for(prepared, [f"{fleet / 'data' / version}#{n}"])
        bag, episode = of_bag.motions[0], of_set.motions[0]
        assert bag.joints == episode.joints
        for ours, theirs in ((episode.position, bag.position), (episode.current_A, bag.current_A)):
            assert np.allclose(ours, theirs, rtol=1e-6, atol=1e-6)  # columns are float32
        value = replay(f"{fleet / 'data' / version}#{n}", asked(fleet)).values[0]
        assert isinstance(value.value, float) and value.ci95[0] - 0.001 <= mass <= value.ci95[1] + 0.001


def test_what_lerobot_writes_is_read(fleet: Path) -> None:
    """Three episodes of the fixture's arm with nothing, 50 g and 100 g, written by lerobot 0.4.4 (`LeRobotDataset.add_frame`)."""
    written = Path(__file__).parent / "lerobot_0_4_4"
    data = open_data_set(written)
    assert data.version == "v3.0" and [each.length for each in data.episodes.values()] == [600] * 3
    for n, mass in enumerate(MASSES_KG):
        value = replay(f"{written}#{n}", asked(fleet)).values[0]
        assert isinstance(value.value, float) and abs(value.value - mass) < 0.002
        assert value.ci95[0] - 0.001 <= mass <= value.ci95[1] + 0.001


def test_units_are_those_of_the_profile(tmp_path: Path) -> None:
    motion = Arm(3).record(1, 2.0)
    motion = replace(motion, position=3.0 * motion.position)
    degrees = replace(motion, position=np.rad2deg(motion.position))
    folder = write_data_set(tmp_path / "set", [degrees], FOUR.constants, rate_hz=50.0)
    columns = {"position_unit": "deg", "percent": ("j4",)}
    from proprio_ros.datasets import Columns

    given: dict[str, Any] = {"names": {}, "effort_unit": "N.m", "nominal_torque_constants": {"j1": 1.0}}
    found = read_episode(folder, 0, Columns(**columns), limits={"j4": (-1.0, 1.0)}, **given)
    assert np.allclose(found.joints.position[:, :3], motion.position[:, :3], atol=1e-5)
    assert np.allclose(found.joints.position[:, 3], -1.0 + 0.02 * degrees.position[:, 3], atol=1e-4)
    assert found.joints.current is not None and np.isnan(found.joints.current[:, 1]).all()
    with pytest.raises(RecordingError, match="no angle in rad"):
        read_episode(folder, 0, Columns(), limits={}, **given)


def test_a_data_set_that_is_not_whole_is_refused_in_a_line(fleet: Path, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="no such episode; the data set has"):
        replay(f"{fleet / 'data' / 'v3'}#7", asked(fleet))
    with pytest.raises(ConfigurationError, match="whose units nobody states"):
        replay(f"{fleet / 'data' / 'v3'}#0", replace(asked(fleet), driver=None))
    (tmp_path / "meta").mkdir()
    (tmp_path / "meta" / "info.json").write_text('{"codebase_version": "v1.6", "fps": 30}')
    with pytest.raises(RecordingError, match=r"version v1\.6; 2\.1 and 3 are read"):
        open_data_set(tmp_path)
    (tmp_path / "meta" / "info.json").write_text('{"codebase_version": "v3.0"')
    with pytest.raises(RecordingError, match="not readable"):
        open_data_set(tmp_path)
    assert episode_of("a/b#12") == (Path("a/b"), 12) and episode_of("a/b") is None


# --- rows ------------------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_rows_are_those_of_replay_bit_for_bit_whatever_the_engine(fleet: Path, tmp_path: Path) -> None:
    job = Job(asked(fleet))
    outcome = run_batch([fleet / "data"], job, tmp_path, lambda words: None, processes=2, chunk=2)
    rows = table(tmp_path)
    assert outcome.episodes == len(rows) == 10 and outcome.verdicts == {"accepted": 9, "failed": 1}
    (failed,) = [row for row in rows if row["kind"] == "failed"]
    assert failed["episode"] == "bags/cut" and "not readable" in failed["reasons"][0]
    assert failed["value"] is None and failed["reason_codes"] == ["unreadable"]
    for row in rows:
        if row is failed:
            continue
        path = (
            f"{row['source']}#{row['episode']}"
            if row["episode_index"] is not None
            else f"{row['source']}/{row['episode']}"
        )
        estimate = replay(path, asked(fleet))
        value = estimate.values[0]
        assert (row["value"], row["std"], [row["low"], row["high"]]) == (value.value, value.std, list(value.ci95))
        assert row["quantity"] == "payload_mass" and row["joints"] == list(FOUR.joints) and row["samples"] == 600
        assert row["calibration_sha256"] == estimate.origin["calibration"]["fingerprint"]
    page = (tmp_path / "batch.html").read_text()
    assert "10 episodes: 9 accepted, 1 failed" in page and "Refused: 10.0 %" in page and "bags/cut</code>" in page
    # in this process, episode by episode, in another order
    again = [row for episode in reversed(episodes_of([fleet / "data"])) for row in rows_of(episode, job)]
    assert same(rows, sorted(again, key=lambda row: (row["source"], row["episode"], row["segment"])))


@pytest.mark.long
def test_a_killed_job_goes_on_with_no_row_twice_and_none_lost(fleet: Path, tmp_path: Path) -> None:
    job = Job(asked(fleet))
    whole, part = tmp_path / "whole", tmp_path / "part"
    episodes = episodes_of([fleet / "data"])
    for out, upto in ((whole, len(episodes)), (part, 5)):
        store = Store(out, job)
        for number, group in enumerate(chunks_of(episodes[:upto], 2)):
            store.write([row for episode in group for row in rows_of(episode, job)], f"{number}")
        store.close()
    store = Store(part, job)
    first, second = store.files()[:2]
    os.truncate(first, first.stat().st_size // 2)  # a crash of the machine
    (second.parent / f".{second.name}.1.tmp").write_bytes(b"PAR1")  # a kill while writing
    done = store.done()
    assert not first.exists() and len(done) < 5 and not list(part.rglob("*.tmp"))
    store.close()
    outcome = run_batch([fleet / "data"], job, part, lambda words: None, processes=1)
    assert outcome.before == len(done) and same(table(part), table(whole))
    # once more: nothing is left to do, and no process is started
    assert run_batch([fleet / "data"], job, part, lambda words: None, processes=0).before == 10
    with pytest.raises(ConfigurationError, match="other options"):
        run_batch([fleet / "data"], Job(replace(asked(fleet), settings={})), part, lambda words: None)


def test_two_jobs_do_not_write_to_one_folder(fleet: Path, tmp_path: Path) -> None:
    store = Store(tmp_path, Job(asked(fleet)))
    with pytest.raises(ConfigurationError, match="another job writes there"):
        Store(tmp_path, Job(asked(fleet)))
    store.close()
    Store(tmp_path, Job(asked(fleet))).close()


@pytest.mark.long
def test_an_episode_that_kills_its_process_is_a_row(
    fleet: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As often as it is tried; those that were under way with it are done all the same."""
    monkeypatch.setenv("PROPRIO_TEST_DEADLY", "bags/1")
    monkeypatch.setattr(local, "compute", deadly)
    monkeypatch.setattr(local, "TRIES", 2)
    outcome = run_batch(
        [fleet / "data" / "bags"], Job(asked(fleet)), tmp_path, lambda words: None, processes=1, chunk=4
    )
    assert outcome.verdicts == {"accepted": 2, "failed": 2}
    (row,) = [row for row in table(tmp_path) if row["reason_codes"] == ["process_died"]]
    assert row["episode"] == "1" and "died 2 times" in row["reasons"][0]


@pytest.mark.long
def test_ray_gives_the_same_rows(fleet: Path, tmp_path: Path) -> None:
    if importlib.util.find_spec("ray") is None:
        pytest.skip("needs the extra ray")
    import ray

    ray.init(num_cpus=1, include_dashboard=False, log_to_driver=False)
    try:
        one = run_batch(
            [fleet / "data"], Job(asked(fleet)), tmp_path / "ray", lambda words: None, engine="ray", chunk=3
        )
    finally:
        ray.shutdown()
    run_batch([fleet / "data"], Job(asked(fleet)), tmp_path / "local", lambda words: None, processes=1)
    assert one.episodes == 10 and same(table(tmp_path / "ray"), table(tmp_path / "local"))


@pytest.mark.long
def test_grasps_are_found_with_their_masses(fleet: Path) -> None:
    """Nothing, 150 g from 8 s on, 60 g from 16 s on as if one of two things had fallen."""
    motion = Arm(3).record(77, 24.0, 0.0, changes=((8.0, 0.15), (16.0, 0.06)))
    prepared = prepare(asked(fleet))
    found = grasps_of(prepared, prepared.robot, motion)
    assert [grasp.code for grasp in found] == ["empty", "held", "slipped"]
    assert np.allclose([grasp.start_s for grasp in found], [0.0, 8.0, 16.0], atol=0.6)
    for grasp, mass in zip(found, (0.0, 0.15, 0.06), strict=True):
        assert grasp.ci95_kg[0] < mass < grasp.ci95_kg[1]


@pytest.mark.long
def test_an_arm_calibrates_itself_with_the_episodes_that_are_known_to_be_empty(tmp_path: Path) -> None:
    arm, robot = Arm(3), write_robot(tmp_path, build=FOUR)
    masses = (0.0, 0.1, 0.0)
    motions = [arm.record(n, 15.0, mass) for n, mass in enumerate(masses)]
    marks = {"hand_empty": [float(mass == 0.0) for mass in masses]}
    write_data_set(tmp_path / "set", motions, FOUR.constants, rate_hz=50.0, extra=marks)
    (tmp_path / "units.yaml").write_text(PROFILE)
    options = ReplayOptions(robot=str(robot), driver=tmp_path / "units.yaml", settings=SETTINGS)
    said: list[str] = []
    given: dict[str, Any] = {"processes": 1, "empty": "hand_empty"}
    outcome = run_batch([tmp_path / "set"], Job(options), tmp_path / "out", said.append, **given)
    assert outcome.verdicts == {"accepted": 3} and any("2 of 2 episodes" in words for words in said)
    weighed = {row["episode_index"]: row for row in table(tmp_path / "out")}
    assert weighed[1]["low"] < 0.1 < weighed[1]["high"] and weighed[1]["calibration"] == "calibration.yaml"
    # made once: the job goes on with the same
    assert run_batch([tmp_path / "set"], Job(options), tmp_path / "out", said.append, **given).before == 3
    with pytest.raises(ConfigurationError, match="has no such column"):
        run_batch([tmp_path / "set"], Job(options), tmp_path / "other", said.append, processes=1, empty="hand")


# --- the command -----------------------------------------------------------------------------------------------------


def test_the_command_says_what_is_wrong_before_it_begins(
    fleet: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = ["--out", str(tmp_path / "out")]
    for arguments, pattern in (
        ([str(fleet / "nowhere"), *out], "no such file or folder"),
        ([str(fleet / "data" / "v3"), *out], "does not say what its positions"),
        ([str(fleet / "data"), *out, "--device", "cuda"], "--device cuda: "),
        ([str(fleet / "data"), *out, "--address", "x:1"], "--address goes with --engine ray"),
        ([str(fleet / "data"), *out, "--calibration", "no.yaml"], "no.yaml"),
    ):
        assert main(["batch", *arguments]) == 2
        said = capsys.readouterr().err
        assert pattern in said and not (tmp_path / "out").exists(), said
    monkeypatch.setitem(sys.modules, "ray", None)
    assert main(["batch", str(fleet / "data" / "bags"), *out, "--engine", "ray"]) == 2
    assert "pip install 'proprio_ros[batch,ray]'" in capsys.readouterr().err


@pytest.mark.long
def test_the_commands_object(fleet: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    jsonschema = pytest.importorskip("jsonschema")
    from proprio_ros.resources import resource

    given = ["--calibration", str(fleet / "arm.yaml"), "--effort-unit", "N.m", "--set", "payload.com=[0.015,0,0]"]
    glob = str(fleet / "data" / "bags" / "[01]")
    assert main(["batch", glob, "--out", str(tmp_path), *given, "--jobs", "1", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    jsonschema.validate(said, json.loads(resource("schema", "output").read_text()))
    assert said["episodes"] == 2 and said["verdicts"] == {"accepted": 2}
