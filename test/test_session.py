"""A calibration as it happened: what came in becomes a bag, and a live estimate that the bag confirms."""

from __future__ import annotations

import json
import shlex
from datetime import datetime, timezone
from pathlib import Path

import numpy as np
import pytest

import proprio_ros.session as session_module
from proprio_ros.bags import read_recording
from proprio_ros.cli import main
from proprio_ros.errors import ConfigurationError, RecordingError
from proprio_ros.records import Recording
from proprio_ros.replay import ReplayOptions, replay
from proprio_ros.robot import load_robot
from proprio_ros.session import LiveWeighing, Session, inertia_tensor, keep_result, live_interval, replay_command

ROBOT = load_robot("open_manipulator_x")
CONSTANTS = {n: d.nominal_torque_constant / d.transmission for n, d in ROBOT.drive_trains.items()}
BAG = "quantised_s00_fixed_heavy_ball_50g_joint3/bag_mcap"


def recording(bag: Path) -> Recording:
    return read_recording(bag, nominal_torque_constants=CONSTANTS, joint_order=list(CONSTANTS))


def cdr_joint_state(stamp_ns: int, names: list[str], position: list[float]) -> bytes:
    """A JointState as DDS sends it, written from the CDR rules: little endian, every field aligned to its size."""
    data = bytearray()

    def align(size: int) -> None:
        data.extend(b"\0" * (-len(data) % size))

    def number(value: int) -> None:
        align(4)
        data.extend(int(value).to_bytes(4, "little"))

    def text(value: str) -> None:
        raw = value.encode() + b"\0"
        number(len(raw))
        data.extend(raw)

    number(stamp_ns // 10**9)
    number(stamp_ns % 10**9)
    text("")
    number(len(names))
    for name in names:
        text(name)
    number(len(position))
    align(8)
    data.extend(np.array(position, dtype="<f8").tobytes())
    number(0)
    number(0)
    return b"\0\1\0\0" + bytes(data)


def filled(root: Path) -> Session:
    session = Session(root, "payload", datetime(2026, 1, 2, 3, 4, 5, tzinfo=timezone.utc))
    for n in range(20):
        stamp = 1_700_000_000 * 10**9 + n * 10_000_000
        data = cdr_joint_state(stamp, ["joint2", "joint3"], [0.1, 0.01 * n])
        session.add("/joint_states", "sensor_msgs/msg/JointState", stamp + 500_000, data)
    return session


def test_what_came_in_is_what_the_bag_holds(tmp_path: Path) -> None:
    session = filled(tmp_path)
    bag, warning = session.save()
    assert warning == "" and bag == tmp_path / "20260102_030405_000_payload" / "bag"
    read = recording(bag)
    assert read.joints.names == ("joint2", "joint3")
    assert read.joints.position[:, 1].tolist() == [0.01 * n for n in range(20)]
    assert np.all(np.diff(read.joints.times_ns) == 10_000_000)


def test_a_folder_that_cannot_be_written_costs_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    full = tmp_path / "full"
    full.write_text("a file where a folder should be")
    elsewhere = tmp_path / "elsewhere"
    monkeypatch.setattr(session_module, "_elsewhere", lambda: [elsewhere])
    session = filled(full)
    bag, warning = session.save()
    assert bag.is_relative_to(elsewhere) and str(elsewhere) in warning and "\n" not in warning
    assert len(recording(bag).joints.times_ns) == 20

    # nowhere at all: kept, and written when there is room
    monkeypatch.setattr(session_module, "_elsewhere", list)
    session = filled(full)
    with pytest.raises(RecordingError, match="kept in memory"):
        session.save()
    full.unlink()
    bag, warning = session.save()
    assert warning == "" and len(recording(bag).joints.times_ns) == 20


def test_nothing_came_in(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="is the driver running"):
        Session(tmp_path, "payload").save()


def test_the_live_estimate_narrows_and_ends_where_the_bag_does(bags: Path) -> None:
    read = recording(bags / BAG)
    assert read.inputs is not None
    live = LiveWeighing(ReplayOptions())
    assert live.estimate() is None
    inputs = list(zip(read.inputs.times_ns, read.inputs.current_A, strict=True))
    effort = np.array([CONSTANTS[name] for name in read.inputs.names])
    assert read.inputs.names == read.joints.names
    shown = []
    for row, stamp in enumerate(read.joints.times_ns):
        while inputs and inputs[0][0] <= stamp:
            time_ns, current = inputs.pop(0)
            live.add_input(int(time_ns), read.inputs.names, current * effort)
        live.add_state(int(stamp), read.joints.names, read.joints.position[row])
        if row % 4 == 0:
            estimate = live.estimate()
            known = None if estimate is None else live_interval(estimate)
            if known is not None:
                shown.append(known)
    assert len(shown) >= 4
    std = [entry[1] for entry in shown]
    assert std[-1] < 0.7 * std[0]
    final = replay([bags / BAG]).values[0]
    assert isinstance(final.value, float)
    assert shown[-1][0] == pytest.approx(0.05, abs=0.003) and final.value == pytest.approx(0.05, abs=0.003)


def test_samples_that_are_no_use_are_passed_over() -> None:
    live = LiveWeighing(ReplayOptions())
    live.add_state(1_000, ["joint3"], [0.1])
    live.add_state(900, ["joint3"], [0.2])  # out of order
    live.add_state(2_000, ["joint3"], [float("nan")])
    live.add_state(3_000, ["joint2"], [0.1])  # another joint
    live.add_input(1_000, ["joint3"], [0.0])
    assert live.estimate() is None and len(live._states) == 1


def test_what_is_stated_about_the_object_is_checked_at_once() -> None:
    with pytest.raises(ConfigurationError, match=r"payload\.siz"):
        LiveWeighing(ReplayOptions(settings={"payload.siz": 0.03}))
    stated = LiveWeighing(ReplayOptions(settings={"payload.shape": "cube", "payload.size": 0.03}))
    # a cube: m a^2 / 6 about every axis
    assert inertia_tensor(stated.facts, 0.06) == pytest.approx(np.eye(3) * 0.06 * 0.03**2 / 6.0)
    assert np.isnan(inertia_tensor(LiveWeighing(ReplayOptions()).facts, 0.06)).all()


def test_the_command_beside_a_result_gives_it_again(
    bags: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ReplayOptions(settings={"payload.size": 0.03, "payload.shape": "cube"})
    estimate = replay([bags / BAG], options)
    bag = tmp_path / "bag"
    keep_result(bag, estimate, replay_command(bags / BAG, options))
    kept = json.loads((tmp_path / "estimate.json").read_text())
    words = shlex.split(kept["command"])
    assert main([*words[1:], "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["estimates"] == kept["estimates"]
