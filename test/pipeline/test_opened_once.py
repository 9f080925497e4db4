"""Each bag, text and episode is opened once for an answer, whatever of it the answer needs."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rosbags.rosbag2
from support.lerobot_layout import write_data_set
from support.machines import pendulum_urdf
from support.recording_bag import write_recording
from support.servo_bag import write as write_servo_bag

from proprio_ros.calibration_files.motors import MotorIdentity
from proprio_ros.calibration_files.pushes import Calibration, Moment
from proprio_ros.pipeline.calibrate import calibrate_from_bags, write_calibration
from proprio_ros.pipeline.check import check_bags
from proprio_ros.pipeline.loading import bag_motion
from proprio_ros.pipeline.replay import replay
from proprio_ros.pipeline.request import Options, Request
from proprio_ros.recordings import datasets, text
from proprio_ros.recordings.motions import Motion
from proprio_ros.records import JointRecord, Recording
from proprio_ros.robot import load_robot

GRAVITY_M_S2 = 9.81
ROD_KG, ROD_M = 0.13, 0.5
ELBOW = MotorIdentity(
    model=1020, id=13, firmware=46, homing_offset=0, drive_mode=0, moving_threshold=10
)
TERMS = {
    "torque_constant": 1.7,
    "coulomb": 0.04,
    "viscous": 0.01,
    "load_friction": 0.02,
    "armature": 0.014,
    "zero": 0.0,
    "stribeck": 0.0,
    "stribeck_velocity": 0.1,
}


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> Iterator[Counter[str]]:
    """How often each file was opened, by its name: storage of bags, texts, parquet files."""
    import pyarrow.parquet as pq

    counts: Counter[str] = Counter()

    def spied(of: Any, name: str, place: int) -> None:
        original = getattr(of, name)

        def spy(*args: Any, **kwargs: Any) -> Any:
            counts[str(args[place])] += 1
            return original(*args, **kwargs)

        monkeypatch.setattr(of, name, spy)

    datasets._opened.cache_clear()
    datasets._groups.cache_clear()
    spied(rosbags.rosbag2.Reader, "__init__", 1)
    spied(text, "text_of", 0)
    spied(datasets, "text_of", 0)
    spied(pq.ParquetFile, "__init__", 1)
    yield counts
    datasets._opened.cache_clear()
    datasets._groups.cache_clear()


def once(opened: Counter[str], *paths: Path) -> bool:
    """Whether these were opened once each, and nothing else was opened."""
    return dict(opened) == {str(path): 1 for path in paths}


def swinging(load_kg: float, seconds: float = 8.0) -> Recording:
    """A pendulum that follows two sines, its torque exactly that of its law."""
    times_s = np.arange(0.0, seconds, 0.01)
    angle = 0.8 * np.sin(2.0 * times_s) + 0.5 * np.sin(3.7 * times_s)
    speed = np.gradient(angle, times_s)
    inertia = (ROD_KG / 3.0 + load_kg) * ROD_M**2
    moment = (0.5 * ROD_KG + load_kg) * ROD_M
    torque = inertia * np.gradient(speed, times_s) + moment * GRAVITY_M_S2 * np.sin(angle)
    torque += 0.05 * np.tanh(speed / 0.01)
    noise = np.random.default_rng(1)
    torque += noise.normal(0.0, 0.02, len(torque))
    record = JointRecord(
        np.rint(1e9 * times_s).astype(np.int64),
        ("pendulum",),
        angle[:, None],
        effort=torque[:, None],
    )
    return Recording("swung", record, None)


def pendulum(folder: Path, driven_by: str = "") -> Path:
    pendulum_urdf(folder, "servo", ROD_KG, ROD_M)
    path = folder / "servo.yaml"
    path.write_text(
        "name: servo\nurdf: servo.urdf\npayload_frame: tip\njoints:\n  pendulum:\n    motor:\n"
        "      nominal_torque_constant_N_m_per_A: 1.0\n      resistance_ohm: 2.0\n"
        f"      back_emf_V_s_per_rad: 1.0\n{driven_by}"
        "    drive_train:\n      torque_constant_N_m_per_A: {value: 1.0, std: 0.4}\n"
    )
    return path


def test_a_push_with_a_calibration_that_knows_motors_and_their_warmth(
    tmp_path: Path, bags: Path, opened: Counter[str]
) -> None:
    values = np.array([*TERMS.values()])
    known = Calibration(
        tuple((term, "joint3") for term in TERMS),
        values,
        np.diag((0.01 * values + 1e-4) ** 2),
        motors={"joint3": ELBOW},
        made=Moment(1_760_000_000.0),
    )
    calibration = tmp_path / "arm.yaml"
    write_calibration(calibration, load_robot("open_manipulator_x"), known)
    bag = bags / "realistic_s00_fixed_heavy_ball_50g_joint3" / "bag_mcap"
    replay(bag, Options(calibration=calibration))
    assert once(opened, bag)


def test_a_motion_with_a_baseline(tmp_path: Path, opened: Counter[str]) -> None:
    loaded = tmp_path / "loaded"
    empty = tmp_path / "empty"
    write_recording(loaded, swinging(0.3))
    write_recording(empty, swinging(0.0, 9.0))
    robot = pendulum(tmp_path)
    options = Options(
        robot=str(robot),
        effort_unit="N.m",
        baseline=(empty,),
    )
    replay(loaded, options)
    assert once(opened, loaded, empty)


def test_a_servo_that_a_voltage_drives(tmp_path: Path, opened: Counter[str]) -> None:
    times_s = np.arange(0.0, 4.0, 0.02)
    goal = 0.8 * np.sin(2.0 * times_s)
    bag = write_servo_bag(
        tmp_path / "bag",
        {
            "t": times_s,
            "position": goal + 0.05,
            "goal": goal,
            "voltage": np.full(len(times_s), 12.0),
        },
    )
    robot = pendulum(
        tmp_path,
        "      driven_by: {kind: position_servo, gain_per_rad: 2.5, limit: 0.9}\n",
    )
    motion = bag_motion(bag, Request(load_robot(robot)))
    assert "stall current" in motion.source
    assert once(opened, bag)


def test_a_calibration(bags: Path, opened: Counter[str]) -> None:
    found = [
        bags / f"realistic_s00_empty_{name}" / "bag_mcap" for name in ("00_joint3", "12_joint4")
    ]
    calibrate_from_bags(found, {})
    assert once(opened, *found)


@pytest.mark.parametrize("stated", ["N.m", None])
def test_a_check(
    tmp_path: Path,
    opened: Counter[str],
    stated: str | None,
) -> None:
    """Of what can be read as it is asked, and of what only its joint states can be read of."""
    bag = tmp_path / "bag"
    write_recording(bag, swinging(0.3))
    robot = pendulum(tmp_path)
    (name, [found]) = check_bags(
        bag,
        Options(robot=str(robot), effort_unit=stated),
    )
    assert name == "servo" and found.joints == ("pendulum",)
    assert bool(found.problem) == (stated is None)
    assert once(opened, bag)


def test_an_episode(tmp_path: Path, opened: Counter[str]) -> None:
    record = swinging(0.3).joints
    assert record.effort is not None
    motion = Motion(
        "m",
        record.names,
        1e-9 * record.times_ns,
        record.position,
        record.effort,
        {},
        "measured current",
    )
    folder = write_data_set(
        tmp_path / "set",
        [motion],
        [1.0],
        version="v2.1",
    )
    units = tmp_path / "units.yaml"
    units.write_text("title: ours\neffort_unit: N.m\ncolumns: {position_unit: rad}\n")
    options = Options(robot=str(pendulum(tmp_path)), driver=units)
    replay(f"{folder}#0", options)
    data = folder / "data" / "chunk-000" / "episode_000000.parquet"
    meta = folder / "meta"
    assert once(opened, meta / "info.json", meta / "episodes.jsonl", data)


def test_a_text(tmp_path: Path, opened: Counter[str]) -> None:
    folder = tmp_path / "text"
    folder.mkdir()
    pose = dict.fromkeys(("joint1", "joint2", "joint3", "joint4"), 0.0)
    setting = {"moving_joint": "joint3", "torque_N_m": 0.3, "start_pose_rad": pose}
    (folder / "setting.json").write_text(json.dumps(setting))
    rows = [f"{row / 60},{0.002 * row**2}" for row in range(20)]
    (folder / "trajectory.csv").write_text("\n".join(["time_s,joint3_relative_rad", *rows]))
    options = Options(settings={"payload.size": 0.03})
    replay(folder, options)
    check_bags(folder, options)
    assert dict(opened) == {str(folder / name): 2 for name in ("setting.json", "trajectory.csv")}
