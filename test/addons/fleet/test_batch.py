"""Batches: the rows are those of `replay` one by one, a job goes on where it stopped, and nothing that an episode holds ends it."""

from __future__ import annotations

import csv
import errno
import importlib.util
import json
import os
import signal
import subprocess
import sys
import tracemalloc
from dataclasses import dataclass, replace
from html import unescape
from itertools import pairwise
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest

pytest.importorskip("pyarrow", reason="needs the extra batch")
pytest.importorskip("mujoco", reason="needs the extra sim")

from support.deadly import deadly
from support.fleet import BEGIN_NS, FOUR, SETTINGS, Arm, write_bag, write_robot
from support.lerobot_layout import write_data_set
from support.recording_bag import write_recording

import proprio_ros.addons.fleet.local as local
import proprio_ros.addons.fleet.rows as rows_module
from proprio_ros.addons.fleet.drift import Drift, drift, periods_of, write_drift
from proprio_ros.addons.fleet.episodes import episodes_of
from proprio_ros.addons.fleet.grasps import Grasps
from proprio_ros.addons.fleet.job import Outcome, run_batch, self_calibrated
from proprio_ros.addons.fleet.listing import named, span_of
from proprio_ros.addons.fleet.rows import Job, lasting, rows_of
from proprio_ros.addons.fleet.store import Store, chunks_of
from proprio_ros.cli import main
from proprio_ros.errors import ComputerError, ConfigurationError, RecordingError
from proprio_ros.identification.estimate import Value
from proprio_ros.inputs.resources import resource
from proprio_ros.pipeline.calibrate import calibrate_from_bags
from proprio_ros.pipeline.check import check_bags
from proprio_ros.pipeline.loading import bag_recording
from proprio_ros.pipeline.replay import read_for, replay
from proprio_ros.pipeline.request import Options, request_of
from proprio_ros.recordings.datasets import open_data_set
from proprio_ros.records import JointRecord

MASSES_KG = (0.0, 0.05, 0.1)
FINGER = "gripper_left_joint"
PROFILE = "title: rad and N m\neffort_unit: N.m\ncolumns: {position_unit: rad}\n"


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three bags and two data sets of the same motions, one bag that is cut short, and a calibration of the arm."""
    folder = tmp_path_factory.mktemp("fleet")
    (folder / "data").mkdir()
    arm = Arm(3)
    robot = write_robot(folder, build=FOUR)
    empty = [write_bag(folder / f"empty_{n}", arm.record(900 + n, 20.0)) for n in range(2)]
    options = Options(robot=str(robot), effort_unit="N.m")
    assert (
        calibrate_from_bags(
            empty, {}, options, folder / "arm.yaml", lambda words: None
        ).verdict.value
        == "accepted"
    )
    motions = [arm.record(n, 12.0, mass) for n, mass in enumerate(MASSES_KG)]
    for n, motion in enumerate(motions):
        write_bag(folder / "data" / "bags" / f"{n}", motion)
    cut = write_bag(folder / "data" / "bags" / "cut", motions[0])
    storage = next(cut.glob("*.mcap"))
    storage.write_bytes(storage.read_bytes()[:3000])
    empties = {"hand_empty": [float(mass == 0.0) for mass in MASSES_KG]}
    write_data_set(
        folder / "data" / "v3", motions, FOUR.constants, rate_hz=50.0, extra=empties, per_file=2
    )
    write_data_set(
        folder / "data" / "v21",
        motions,
        FOUR.constants,
        rate_hz=50.0,
        version="v2.1",
    )
    (folder / "units.yaml").write_text(PROFILE)
    return folder


def asked(folder: Path) -> Options:
    return Options(
        calibration=folder / "arm.yaml",
        effort_unit="N.m",
        settings=SETTINGS,
        driver=folder / "units.yaml",
    )


def table(out: Path) -> list[dict[str, Any]]:
    from pyarrow import dataset

    rows: list[dict[str, Any]] = (
        dataset.dataset(out / "rows", partitioning="hive").to_table().to_pylist()
    )
    return sorted(
        rows,
        key=lambda row: (row["source"], row["episode"], row["segment"]),
    )


def same(
    one: list[dict[str, Any]],
    other: list[dict[str, Any]],
) -> bool:
    """Bit for bit, but for how long it took."""
    return [{**row, "elapsed_s": 0.0} for row in one] == [
        {**row, "elapsed_s": 0.0} for row in other
    ]


# --- data sets -------------------------------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize("version", ["v3", "v21"])
def test_an_episode_of_a_data_set_is_the_recording_of_a_bag(fleet: Path, version: str) -> None:
    prepared = request_of(asked(fleet))
    for n, mass in enumerate(MASSES_KG):
        _, of_bag = read_for(prepared, [fleet / "data" / "bags" / f"{n}"])
        _, of_set = read_for(prepared, [f"{fleet / 'data' / version}#{n}"])
        bag = of_bag.motions[0]
        episode = of_set.motions[0]
        assert bag.joints == episode.joints
        for ours, theirs in ((episode.position, bag.position), (episode.current_A, bag.current_A)):
            assert np.allclose(ours, theirs, rtol=1e-6, atol=1e-6)  # columns are float32
        value = replay(f"{fleet / 'data' / version}#{n}", asked(fleet)).values[0]
        assert (
            isinstance(value.value, float)
            and value.ci95[0] - 0.001 <= mass <= value.ci95[1] + 0.001
        )


@pytest.mark.parametrize("name", ["bag_0.mcap.zstd", "bag_0.db3.zstd"])
def test_a_compressed_file_is_an_episode(tmp_path: Path, name: str) -> None:
    packed = tmp_path / "bag" / name
    packed.parent.mkdir()
    packed.write_bytes(b"")
    assert [each.path for each in episodes_of([tmp_path])] == [str(packed)]


def test_what_lerobot_writes_is_read(fleet: Path) -> None:
    """Three episodes of the fixture's arm with nothing, 50 g and 100 g, written by lerobot 0.4.4 (`LeRobotDataset.add_frame`)."""
    written = Path(__file__).parent / "lerobot_0_4_4"
    data = open_data_set(written)
    assert data.version == "v3.0"
    assert [each.length for each in data.episodes.values()] == [600] * 3
    for n, mass in enumerate(MASSES_KG):
        value = replay(f"{written}#{n}", asked(fleet)).values[0]
        assert isinstance(value.value, float)
        assert abs(value.value - mass) < 0.002
        assert value.ci95[0] - 0.001 <= mass <= value.ci95[1] + 0.001
    _, (usable, missing) = check_bags(
        [f"{written}#0", f"{written}#7"],
        asked(fleet),
    )
    assert (
        usable.usable == 1
        and usable.state_topic == "observation.state"
        and usable.duration_s == pytest.approx(11.98)
    )
    assert missing.usable == 0
    assert "no such episode" in missing.problem
    with pytest.raises(
        RecordingError, match=r"a LeRobot data set\? Name an episode, 'lerobot_0_4_4#0', or ask all"
    ):
        check_bags(written, asked(fleet))


@pytest.mark.parametrize("source", ["bags/1", "v3#1", "v21#1"])
def test_a_span_is_that_part_of_the_whole(fleet: Path, source: str) -> None:
    prepared = request_of(asked(fleet))
    path = str(fleet / "data" / source)
    (whole,) = read_for(prepared, [path])[1].motions
    span = 3_000_000_000, 9_000_000_000
    (part,) = read_for(replace(prepared, options=replace(asked(fleet), span=span)), [path])[
        1
    ].motions
    rows = (whole.times_s >= 3.0 - 1e-9) & (whole.times_s < 9.0 - 1e-9)
    assert 299 <= len(part.times_s) <= 301
    assert np.array_equal(part.position, whole.position[rows])
    assert np.array_equal(part.current_A, whole.current_A[rows])
    behind = replace(
        prepared,
        options=replace(
            asked(fleet),
            span=(10**12, None),
        ),
    )
    with pytest.raises(
        RecordingError, match=r"no joint states between 1000 s and its end|no frames in this part"
    ):
        read_for(behind, [path])


def test_an_episode_that_cannot_be_answered_is_refused_in_a_line(fleet: Path) -> None:
    with pytest.raises(RecordingError, match="no such episode; the data set has"):
        replay(f"{fleet / 'data' / 'v3'}#7", asked(fleet))
    with pytest.raises(ConfigurationError, match="whose units nobody states"):
        replay(f"{fleet / 'data' / 'v3'}#0", replace(asked(fleet), driver=None))


# --- rows ------------------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_rows_are_those_of_replay_bit_for_bit_whatever_the_engine(
    fleet: Path, tmp_path: Path
) -> None:
    job = Job(asked(fleet))
    outcome = run_batch(
        [fleet / "data"],
        job,
        tmp_path,
        lambda words: None,
        processes=2,
        chunk=2,
    )
    rows = table(tmp_path)
    outcome.plot().savefig(tmp_path / "verdicts.svg")
    assert "<td" in outcome._repr_html_()
    assert "batch.html" in outcome._repr_html_()
    assert outcome.episodes == len(rows) == 10
    assert outcome.verdicts == {"accepted": 9, "failed": 1}
    check_unreadable(rows)
    for row in rows:
        if row["kind"] != "failed":
            check_replayed(row, fleet)
    page = (tmp_path / "batch.html").read_text()
    for words in ("10 episodes: 9 accepted, 1 failed", "Refused: 10.0 %", "bags/cut</code>"):
        assert words in page
    # in this process, episode by episode, in another order
    again = [
        row for episode in reversed(episodes_of([fleet / "data"])) for row in rows_of(episode, job)
    ]
    assert same(
        rows, sorted(again, key=lambda row: (row["source"], row["episode"], row["segment"]))
    )


def check_unreadable(rows: list[dict[str, Any]]) -> None:
    """The bag that is cut short, alone, has a row without a value."""
    (failed,) = [row for row in rows if row["kind"] == "failed"]
    assert failed["episode"] == "bags/cut"
    assert "the motion lasts 0.3 s" in failed["reasons"][0]
    assert failed["value"] is None
    assert failed["reason_codes"] == ["unreadable"]


def check_replayed(row: dict[str, Any], fleet: Path) -> None:
    """A row is what `replay` says of its episode, bit for bit."""
    of_data_set = row["episode_index"] is not None
    between = "#" if of_data_set else "/"
    estimate = replay(f"{row['source']}{between}{row['episode']}", asked(fleet))
    assert numbers_of(row) == numbers_of_value(estimate.values[0])
    assert row["quantity"] == "payload_mass"
    assert row["joints"] == list(FOUR.joints)
    assert row["samples"] == 600
    assert row["calibration_sha256"] == estimate.origin["calibration"]["fingerprint"]


def numbers_of(row: dict[str, Any]) -> tuple[float, float, list[float]]:
    """Mass, standard deviation and 95 % interval of a row [kg]."""
    return row["value"], row["std"], [row["low"], row["high"]]


def numbers_of_value(value: Value) -> tuple[Any, Any, list[float]]:
    """Those of a replayed estimate's value [kg]."""
    assert value.ci95 is not None
    return value.value, value.std, list(value.ci95)


@pytest.mark.long
def test_a_killed_job_goes_on_with_no_row_twice_and_none_lost(fleet: Path, tmp_path: Path) -> None:
    job = Job(asked(fleet))
    whole = tmp_path / "whole"
    part = tmp_path / "part"
    episodes = episodes_of([fleet / "data"])
    for out, upto in ((whole, len(episodes)), (part, 5)):
        store = Store(out, job)
        for number, group in enumerate(chunks_of(episodes[:upto], 2)):
            store.write(
                [row for episode in group for row in rows_of(episode, job)],
                f"{number}",
            )
        store.close()
    store = Store(part, job)
    first, second = store.files()[:2]
    os.truncate(first, first.stat().st_size // 2)  # a crash of the machine
    (second.parent / f".{second.name}.1.tmp").write_bytes(b"PAR1")  # a kill while writing
    done = store.done()
    assert not first.exists()
    assert len(done) < 5
    assert not list(part.rglob("*.tmp"))
    store.close()
    outcome = run_batch(
        [fleet / "data"],
        job,
        part,
        lambda words: None,
        processes=1,
    )
    assert outcome.before == len(done)
    assert same(table(part), table(whole))
    # once more: nothing is left to do, and no process is started
    assert (
        run_batch(
            [fleet / "data"],
            job,
            part,
            lambda words: None,
            processes=0,
        ).before
        == 10
    )
    with pytest.raises(ConfigurationError, match="other options"):
        run_batch(
            [fleet / "data"], Job(replace(asked(fleet), settings={})), part, lambda words: None
        )


def test_files_that_no_job_wrote_stay(fleet: Path, tmp_path: Path) -> None:
    import pyarrow
    from pyarrow import parquet

    job = Job(asked(fleet))
    theirs = pyarrow.table({"mine": [1, 2]})
    for name, write in (
        ("rows/source_name=x/mine.parquet", lambda path: parquet.write_table(theirs, path)),
        ("rows/source_name=x/part-1.parquet", lambda path: path.write_text("my notes")),
        ("batch.html", lambda path: path.write_text("my page")),
    ):
        path = tmp_path / name.split("/")[-1].split(".")[0] / name
        path.parent.mkdir(parents=True)
        write(path)
        before = path.read_bytes()
        out = path.parents[len(Path(name).parts) - 1]
        with pytest.raises(ConfigurationError, match="is no "):
            run_batch(
                [fleet / "data" / "bags"],
                job,
                out,
                lambda words: None,
                processes=1,
            )
        assert path.read_bytes() == before
    (tmp_path / "drift.csv").write_text("day,what I saw\n")
    with pytest.raises(
        ConfigurationError, match=r"drift\.csv is no table of proprio: move it away"
    ):
        write_drift(Drift(()), tmp_path / "drift.csv")
    write_drift(Drift(()), tmp_path / "new.csv")
    write_drift(Drift(()), tmp_path / "new.csv")
    (tmp_path / "calibration.yaml").write_text("name: mine\n")
    with pytest.raises(ConfigurationError, match="is no calibration of a job here"):
        self_calibrated(
            [],
            asked(fleet),
            "--empty",
            tmp_path,
            lambda words: None,
        )


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
        [fleet / "data" / "bags"],
        Job(asked(fleet)),
        tmp_path,
        lambda words: None,
        processes=1,
        chunk=4,
    )
    assert outcome.verdicts == {"accepted": 2, "failed": 2}
    (row,) = [row for row in table(tmp_path) if row["reason_codes"] == ["process_died"]]
    assert row["episode"] == "1"
    assert "died 2 times" in row["reasons"][0]


@pytest.mark.parametrize(
    "fault",
    [
        MemoryError(),
        OSError(errno.ENOSPC, "No space left on device"),
        ComputerError("compiled kernels cannot be kept"),
    ],
)
def test_what_the_computer_could_not_do_is_no_row_and_is_asked_again(
    fleet: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: Exception
) -> None:
    def full(*_: object) -> NoReturn:
        try:
            raise fault
        except Exception as error:
            raise RecordingError("cannot be read") from error

    job = Job(asked(fleet))
    first, second = episodes_of([fleet / "data" / "bags"])[:2]
    with monkeypatch.context() as patch:
        patch.setattr(rows_module, "read_for", full)
        (row,) = rows_of(first, job)
        assert row["reason_codes"] == ["machine"]
        assert lasting([row]) == []
        done = local.compute(
            [first, second],
            job,
            str(tmp_path),
        )
    assert done.failed == 0
    assert len(done.machine) == 1
    assert not list(tmp_path.iterdir())
    assert local.compute([first, second], job, str(tmp_path)) == local.Done(0)
    assert len(list(tmp_path.iterdir())) == 1
    with monkeypatch.context() as patch:
        patch.setattr(rows_module, "read_for", lambda *_: 1 / 0)
        (row,) = rows_of(first, job)  # and what an episode holds is
        assert row["reason_codes"] == ["unexpected"]
        assert lasting([row]) == [row]


def test_rows_that_cannot_be_written_are_asked_again(fleet: Path, tmp_path: Path) -> None:
    first = episodes_of([fleet / "data" / "bags"])[0]
    done = local.compute(
        [first],
        Job(asked(fleet)),
        str(tmp_path / "not there"),
    )
    assert done.machine == {"rows cannot be written: No such file or directory"}


def batch_of(fleet: Path, out: Path) -> list[str]:
    """The command that asks for four bags."""
    words = [
        "batch",
        str(fleet / "data" / "bags"),
        "--out",
        str(out),
        "--jobs",
        "2",
    ]
    words += [
        "--calibration",
        str(fleet / "arm.yaml"),
        "--effort-unit",
        "N.m",
        "--reports",
        "0",
    ]
    return words + ["--probe", "payload"] + [f"--set={key}={at}" for key, at in SETTINGS.items()]


def test_a_batch_says_what_is_undone_and_does_it_the_next_time(
    fleet: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    words = [*batch_of(fleet, tmp_path), "--json"]
    monkeypatch.setattr("proprio_ros.addons.fleet.job.run_local", lambda *_: None)
    assert main(words) == 2
    answer = json.loads(capsys.readouterr().out)
    assert answer["undone"] == answer["episodes"] == 4
    assert answer["verdicts"] == {}


def test_ctrl_c_is_said_once_and_leaves_nothing(fleet: Path, tmp_path: Path) -> None:
    words = batch_of(fleet, tmp_path)
    with subprocess.Popen(
        [sys.executable, "-m", "proprio_ros.cli", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    ) as command:
        assert command.stderr is not None
        assert "4 episodes, 0 of them done before" in command.stderr.readline()
        os.killpg(command.pid, signal.SIGINT)  # as a terminal does
        # the pipe is closed once the last of the processes has ended
        out, error = command.communicate()
    assert command.returncode == 130 and out == ""
    assert error == "proprio: interrupted\n"
    assert not list(tmp_path.rglob("*.tmp"))


@pytest.mark.long
def test_ray_gives_the_same_rows(fleet: Path, tmp_path: Path) -> None:
    if importlib.util.find_spec("ray") is None:
        pytest.skip("needs the extra ray")
    import ray

    ray.init(num_cpus=1, include_dashboard=False, log_to_driver=False)
    try:
        one = run_batch(
            [fleet / "data"],
            Job(asked(fleet)),
            tmp_path / "ray",
            lambda words: None,
            engine="ray",
            chunk=3,
        )
    finally:
        ray.shutdown()
    run_batch(
        [fleet / "data"], Job(asked(fleet)), tmp_path / "local", lambda words: None, processes=1
    )
    assert one.episodes == 10
    assert same(table(tmp_path / "ray"), table(tmp_path / "local"))


def test_a_pick_whose_grasps_are_weighed_is_no_misfit() -> None:
    whole = {
        "kind": "episode",
        "verdict": "rejected",
        "reasons": ["unit?"],
        "reason_codes": ["misfit"],
    }
    grasp = {"kind": "grasp", "verdict": "accepted"}
    changed = rows_module._with_change(whole, [grasp, grasp])
    assert changed["reason_codes"] == ["changed_midway", "misfit"]
    assert changed["reasons"][0].startswith("its load changes: 2 stretches")
    assert rows_module._with_change(whole, [grasp]) == whole
    accepted = {**whole, "verdict": "accepted"}
    assert rows_module._with_change(accepted, [grasp, grasp]) == accepted
    assert rows_module._with_change(changed, [grasp, grasp]) == changed


@pytest.mark.long
def test_grasps_are_found_with_their_masses(fleet: Path) -> None:
    """Nothing, 150 g from 8 s on, 60 g from 16 s on as if one of two things had fallen."""
    motion = Arm(3).record(77, 24.0, 0.0, changes=((8.0, 0.15), (16.0, 0.06)))
    prepared = request_of(asked(fleet))
    grasps = Grasps(prepared, prepared.robot, motion)
    grasps.add(motion)
    found = grasps.found()
    assert [grasp.code for grasp in found] == ["empty", "held", "slipped"]
    assert np.allclose(
        [grasp.start_s for grasp in found],
        [0.0, 8.0, 16.0],
        atol=0.6,
    )
    for grasp, mass in zip(found, (0.0, 0.15, 0.06), strict=True):
        assert grasp.ci95_kg[0] < mass < grasp.ci95_kg[1]


@pytest.mark.long
def test_what_the_gripper_did_tells_what_was_put_down_from_what_fell(fleet: Path) -> None:
    """150 g from 8 s on, nothing from 16 s on; the gripper closes on it at 8 s, and opens at 16 s or does not."""
    motion = Arm(3).record(78, 24.0, 0.0, changes=((8.0, 0.15), (16.0, 0.0)))
    prepared = request_of(asked(fleet))
    closed = np.interp(
        motion.times_s,
        (7.8, 8.0),
        (0.04, 0.01),
    )
    opened = np.where(
        motion.times_s < 12.0,
        closed,
        np.interp(
            motion.times_s,
            (15.8, 16.0),
            (0.01, 0.04),
        ),
    )
    for beside, codes in (
        ({"left_finger": opened}, ["empty", "held", "released"]),
        ({"left_finger": closed}, ["empty", "held", "dropped"]),
    ):
        parted = replace(motion, beside=beside)
        grasps = Grasps(prepared, prepared.robot, parted)
        middle = len(motion.times_s) // 2
        for rows, begin_s in (
            (slice(0, middle), 0.0),
            (slice(middle, None), float(motion.times_s[middle])),
        ):
            part = replace(
                parted,
                times_s=motion.times_s[rows] - motion.times_s[rows][0],
                position=motion.position[rows],
                current_A=motion.current_A[rows],
                beside={name: values[rows] for name, values in beside.items()},
            )
            grasps.add(part, begin_s)
        found = grasps.found()
        assert [grasp.code for grasp in found] == codes
        assert np.allclose(
            [grasp.start_s for grasp in found],
            [0.0, 8.0, 16.0],
            atol=0.6,
        )
        held = found[1]
        assert held.ci95_kg[0] < 0.15 < held.ci95_kg[1]
        assert held.gripper is not None
        assert abs(held.gripper - 0.01) < 0.003
        assert held.samples == pytest.approx(400, abs=40)


@pytest.mark.long
def test_a_long_motion_is_answered_in_parts_that_replay_answers_alike(
    fleet: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Three parts of a bag and of a data set; the same numbers as `replay --span`; memory does not grow with what is longer."""
    monkeypatch.setattr(rows_module, "MOST_SAMPLES", 700)
    monkeypatch.setattr(rows_module, "LEAST_BYTES", 0)
    motion = Arm(3).record(55, 36.0, 0.1)
    write_bag(tmp_path / "data" / "long", motion)
    write_data_set(
        tmp_path / "data" / "set",
        [motion],
        FOUR.constants,
        rate_hz=50.0,
    )
    job = Job(asked(fleet), grasps=True)
    for episode in episodes_of([tmp_path / "data"]):
        rows = rows_of(episode, job)
        check_cut(rows, len(motion.times_s))
        for row in rows:
            if row["kind"] == "part":
                assert row["low"] - 0.001 <= 0.1 <= row["high"] + 0.001
                options = replace(asked(fleet), span=span_of(row))
                assert numbers_of(row) == numbers_of_value(replay(episode.path, options).values[0])
        # one grasp through all parts
        (grasp,) = [row for row in rows if row["kind"] == "grasp"]
        assert grasp["reason_codes"] == ["held"]
        assert grasp["samples"] > 1700
        assert grasp["low"] < 0.1 < grasp["high"]


def check_cut(rows: list[dict[str, Any]], samples: int) -> None:
    """Three parts, each of which begins where the one before ends, hold all samples."""
    parts = [row for row in rows if row["kind"] == "part"]
    assert len(parts) == 3
    assert sum(row["samples"] for row in parts) == samples
    assert [row["segment"] for row in rows] == list(range(len(rows)))
    assert rows[0]["segments"] == len(rows)
    assert parts[0]["start_s"] == 0.0
    for part, following in pairwise(parts):
        assert part["end_s"] == following["start_s"]


@pytest.mark.long
def test_memory_does_not_grow_with_the_length_of_a_bag(
    fleet: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rows_module, "MOST_SAMPLES", 1000)
    monkeypatch.setattr(rows_module, "LEAST_BYTES", 0)
    peaks = []
    for seconds in (20.0, 200.0):
        write_bag(
            tmp_path / f"{seconds}",
            Arm(3).record(56, seconds, 0.1),
        )
        (episode,) = episodes_of([tmp_path / f"{seconds}"])
        tracemalloc.start()
        rows = rows_of(episode, Job(asked(fleet)))
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert len(rows) == round(seconds / 20.0)
    assert peaks[1] < 1.3 * peaks[0]


@pytest.mark.long
def test_a_recording_of_pushes_is_not_cut(fleet: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A cut may go through one of them."""
    monkeypatch.setattr(rows_module, "MOST_SAMPLES", 20)
    monkeypatch.setattr(rows_module, "LEAST_BYTES", 0)
    bag = Path(__file__).parents[3] / "bags" / "friction_s00_fixed_heavy_ball_50g_joint3"
    (episode,) = episodes_of([bag / "bag_mcap"])
    (row,) = rows_of(episode, Job())
    value = replay(episode.path).values[0]
    assert row["kind"] == "episode"
    assert (row["value"], row["std"]) == (value.value, value.std)


@pytest.mark.long
def test_what_a_calibration_carries_counts_in_a_batch(bags: Path, tmp_path: Path) -> None:
    """A gripper that is not recorded, and the link in which objects are held: rows are those of what is stated each time."""
    finger = {f"held.{FINGER}": 0.01}
    stated = {**finger, "payload.frame": "link5"}
    place = {"payload.com": [0.0, 0.0, 0.0]}
    empty = [folder / "bag_mcap" for folder in sorted(bags.glob("realistic_s00_empty_0[0-3]_*"))]
    carrying = tmp_path / "carrying.yaml"
    plain = tmp_path / "plain.yaml"
    calibrate_from_bags(empty, {}, Options(settings=stated), carrying)
    calibrate_from_bags(empty, {}, Options(), plain)
    ball = bags / "realistic_s00_fixed_heavy_ball_50g_joint3" / "bag_mcap"
    without_finger(ball, tmp_path / "ball")
    run_batch(
        [tmp_path / "ball"],
        Job(Options(calibration=carrying, settings=place)),
        tmp_path / "out",
        lambda words: None,
        processes=1,
    )
    (row,) = table(tmp_path / "out")
    each_time, elsewhere = (
        replay(tmp_path / "ball", Options(calibration=plain, settings={**said, **place})).values[0]
        for said in (stated, finger)
    )
    assert row["value"] == pytest.approx(each_time.value, rel=1e-6)
    assert row["calibration"] == "carrying.yaml"
    assert abs(elsewhere.value - each_time.value) > 0.002, "the link counts"


def without_finger(bag: Path, path: Path) -> None:
    """The same recording, of whose gripper no joint states tell."""
    whole = bag_recording(bag, request_of(Options()))
    record = whole.joints
    columns = [column for column, name in enumerate(record.names) if name != FINGER]
    names = tuple(record.names[column] for column in columns)
    joints = JointRecord(record.times_ns, names, record.position[:, columns])
    write_recording(path, replace(whole, joints=joints))


WEEK_NS = 7 * 86_400 * 10**9
FOUR_WEEKS_KG = (0.05, 0.1, 0.15, 0.2, 0.05, 0.1, 0.15, 0.2)
"""What the hand takes after six seconds, episode by episode."""


@dataclass(frozen=True)
class FourWeeks:
    """A batch of an arm that calibrates itself with the first seconds of its episodes.

    Attributes:
        bags: Its episodes.
        options: What was asked.
        said: What the batch said on its way.
    """

    bags: Path
    options: Options
    out: Path
    outcome: Outcome
    said: list[str]


@pytest.fixture(scope="module")
def four_weeks(tmp_path_factory: pytest.TempPathFactory) -> FourWeeks:
    """Eight episodes over four weeks whose hand is empty for six seconds; friction is 1.8 times as large in the last two weeks."""
    folder = tmp_path_factory.mktemp("four_weeks")
    robot = write_robot(folder, build=FOUR)
    bags = folder / "bags"
    for n, mass in enumerate(FOUR_WEEKS_KG):
        arm = Arm(3, drift=1.8 if n >= 4 else 1.0)
        motion = arm.record(200 + n, 24.0, 0.0, changes=((6.0, mass),))
        write_bag(bags / f"{n}", motion, BEGIN_NS + (n // 2) * WEEK_NS)
    cut = write_bag(bags / "cut", motion)
    storage = next(cut.glob("*.mcap"))
    storage.write_bytes(storage.read_bytes()[:3000])
    options = Options(robot=str(robot), effort_unit="N.m", settings=SETTINGS)
    out = folder / "out"
    said = list[str]()
    outcome = run_batch([bags], Job(options), out, said.append, processes=1, empty_first_s=6.0)
    return FourWeeks(bags, options, out, outcome, said)


@pytest.mark.long
def test_an_arm_calibrates_itself_with_the_first_seconds(four_weeks: FourWeeks) -> None:
    said = four_weeks.said
    assert any("8 of 9 episodes, whose hand is empty at first" in words for words in said)
    *rows, failed = table(four_weeks.out)
    assert failed["kind"] == "failed"
    assert named(failed).endswith("bags/cut --span 6:")
    assert [row["start_s"] for row in rows] == [6.0] * 8
    held = [
        row["low"] - 0.001 <= mass <= row["high"] + 0.001
        for row, mass in zip(rows, FOUR_WEEKS_KG, strict=True)
    ]
    assert sum(held) >= 7
    asked = replace(
        four_weeks.options,
        robot=None,
        calibration=four_weeks.out / "calibration.yaml",
        span=(6 * 10**9, None),
    )
    value = replay(four_weeks.bags / "3", asked).values[0]
    assert (rows[3]["value"], rows[3]["std"]) == (value.value, value.std)


@pytest.mark.long
def test_an_arm_that_calibrates_itself_shows_its_drift(four_weeks: FourWeeks) -> None:
    """Week by week, two episodes each, in a file, on the page and in Python."""
    with open(four_weeks.out / "drift.csv") as stream:
        written = list(csv.DictReader(stream))
    joints = len(FOUR.joints)
    assert len(written) == 4 * joints
    assert {row["episodes"] for row in written} == {"2"}
    assert [row["period"] for row in written[::joints]] == sorted(
        {row["period"] for row in written}
    )
    check_drifted(friction_of(written[:joints]), friction_of(written[-joints:]))
    page = (four_weeks.out / "batch.html").read_text()
    drifted = four_weeks.outcome.drift
    for words in ("How the arm drifts", "Coulomb friction of j1", drifted.sentence()):
        assert words in page
    kept = drifted.as_json()["rows"]
    assert [f"{row['coulomb_N_m']:.6g}" for row in kept] == [row["coulomb_N_m"] for row in written]


def friction_of(rows: list[dict[str, str]]) -> np.ndarray:
    """Coulomb friction of each joint, and its standard deviation [N m], (n, 2)."""
    return np.array(
        [[float(row["coulomb_N_m"]), float(row["coulomb_N_m_std"])] for row in rows],
    )


def check_drifted(first: np.ndarray, last: np.ndarray) -> None:
    """The last week's friction is 1.8 times the first one's, within three standard deviations, and seen to be more."""
    friction, std = first.T
    later, later_std = last.T
    assert np.all(np.abs(later - 1.8 * friction) < 3.0 * np.hypot(1.8 * std, later_std))
    assert np.max((later - friction) / np.hypot(std, later_std)) > 1.2


@pytest.mark.long
def test_too_short_an_empty_hand_says_nothing(four_weeks: FourWeeks, tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="are the least that say anything"):
        run_batch(
            [four_weeks.bags],
            Job(four_weeks.options),
            tmp_path / "no",
            four_weeks.said.append,
            empty_first_s=1.0,
        )


def test_drift_shows_itself_in_python(tmp_path: Path) -> None:
    robot = write_robot(tmp_path, build=FOUR)
    bags = [
        write_bag(
            tmp_path / "bags" / f"{n}",
            Arm(3, drift=1.0 + n).record(n, 12.0),
            BEGIN_NS + n * 86_400 * 10**9,
        )
        for n in range(2)
    ]
    (tmp_path / "bags" / "cut").mkdir()
    (tmp_path / "bags" / "cut" / "metadata.yaml").touch()
    asked: dict[str, Any] = {
        "robot": robot,
        "effort_unit": "N.m",
        "settings": SETTINGS,
    }
    found = drift(tmp_path / "bags", **asked)
    assert repr(found) == "<drift over 2 periods>" and [period.episodes for period in found] == [
        1,
        1,
    ]
    assert len(found.to_frame()) == len(found.as_json()["rows"]) == 2 * len(FOUR.joints)
    jsonschema = pytest.importorskip("jsonschema")
    jsonschema.Draft202012Validator(json.loads(resource("schema", "output").read_text())).validate(
        found.as_json()
    )
    assert "Coulomb friction of j" in found.sentence() and found.sentence() in unescape(
        found._repr_html_()
    )
    (axis,) = found.plot().axes
    assert [text.get_text() for text in axis.get_legend().get_texts()] == list(FOUR.joints)
    (alone,) = drift(bags[:1], **asked)
    assert alone.name == found[0].name
    one = drift(bags[:1], **asked)
    assert "no two periods" in one._repr_html_()
    assert one.plot().axes
    with pytest.raises(RecordingError, match="cut"):
        drift(tmp_path / "bags" / "cut", **asked)


def test_drift_is_by_day_by_week_or_by_episode() -> None:
    day = 86_400 * 10**9
    assert [(name, at, own) for name, at, own in periods_of([0, 5, day])] == [
        ("1970-01-01", 0.0, [0, 1]),
        ("1970-01-02", 1.0, [2]),
    ]
    assert [at for _, at, _ in periods_of([0, 8 * day, 40 * day])] == [0.0, 7.0, 35.0]
    assert [own for _, _, own in periods_of([None] * 24)] == [[n, n + 1] for n in range(0, 24, 2)]
    assert periods_of([]) == []


@pytest.mark.long
def test_an_arm_calibrates_itself_with_the_episodes_that_are_known_to_be_empty(
    tmp_path: Path,
) -> None:
    arm = Arm(3)
    robot = write_robot(tmp_path, build=FOUR)
    masses = (0.0, 0.1, 0.0)
    motions = [arm.record(n, 15.0, mass) for n, mass in enumerate(masses)]
    marks = {"hand_empty": [float(mass == 0.0) for mass in masses]}
    write_data_set(
        tmp_path / "set",
        motions,
        FOUR.constants,
        rate_hz=50.0,
        extra=marks,
    )
    (tmp_path / "units.yaml").write_text(PROFILE)
    options = Options(
        robot=str(robot),
        driver=tmp_path / "units.yaml",
        settings=SETTINGS,
    )
    said: list[str] = []
    given: dict[str, Any] = {"processes": 1, "empty": "hand_empty"}
    outcome = run_batch(
        [tmp_path / "set"],
        Job(options),
        tmp_path / "out",
        said.append,
        **given,
    )
    assert outcome.verdicts == {"accepted": 3}
    assert any("2 of 2 episodes" in words for words in said)
    weighed = {row["episode_index"]: row for row in table(tmp_path / "out")}
    assert (
        weighed[1]["low"] < 0.1 < weighed[1]["high"]
        and weighed[1]["calibration"] == "calibration.yaml"
    )
    # made once: the job goes on with the same
    assert (
        run_batch(
            [tmp_path / "set"],
            Job(options),
            tmp_path / "out",
            said.append,
            **given,
        ).before
        == 3
    )
    with pytest.raises(ConfigurationError, match="has no such column"):
        run_batch(
            [tmp_path / "set"],
            Job(options),
            tmp_path / "other",
            said.append,
            processes=1,
            empty="hand",
        )


# --- the command -----------------------------------------------------------------------------------------------------


def test_the_command_says_what_is_wrong_before_it_begins(
    fleet: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    out = ["--out", str(tmp_path / "out")]
    for arguments, pattern in (
        ([str(fleet / "nowhere"), *out], "no such file or folder"),
        ([str(fleet / "data" / "v3"), *out], "does not say what its positions"),
        ([str(fleet / "data"), *out, "--device", "cuda"], "--device cuda: no CUDA device: "),
        ([str(fleet / "data"), *out, "--address", "x:1"], "--address goes with --engine ray"),
        ([str(fleet / "data"), *out, "--empty", "a", "--empty-first", "5"], "give one of them"),
        ([str(fleet / "data"), *out, "--calibration", "no.yaml"], "no.yaml"),
    ):
        assert main(["batch", *arguments]) == 2
        said = capsys.readouterr().err
        assert pattern in said and not (tmp_path / "out").exists(), said
    monkeypatch.setitem(sys.modules, "ray", None)
    assert main(["batch", str(fleet / "data" / "bags"), *out, "--engine", "ray"]) == 2
    assert "[batch,ray]'" in capsys.readouterr().err  # as the package was installed


@pytest.mark.long
def test_the_commands_object(
    fleet: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    jsonschema = pytest.importorskip("jsonschema")
    from proprio_ros.inputs.resources import resource

    given = [
        "--calibration",
        str(fleet / "arm.yaml"),
        "--effort-unit",
        "N.m",
        "--set",
        "payload.com=[0.015,0,0]",
    ]
    glob = str(fleet / "data" / "bags" / "[01]")
    assert main(["batch", glob, "--out", str(tmp_path), *given, "--jobs", "1", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    jsonschema.validate(
        said,
        json.loads(resource("schema", "output").read_text()),
    )
    assert said["episodes"] == 2
    assert said["verdicts"] == {"accepted": 2}
