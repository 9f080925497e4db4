"""A calibration as it happened: what came in becomes a bag, and a live estimate that the bag confirms."""

from __future__ import annotations

import json
import math
import shlex
from dataclasses import replace
from datetime import datetime, timezone
from pathlib import Path

import numpy as np
import pytest

import proprio_ros.live.session as session_module
from proprio_ros.cli import main
from proprio_ros.errors import ConfigurationError, RecordingError
from proprio_ros.live.answers import live_interval
from proprio_ros.live.session import (
    LiveEstimate,
    Session,
    as_parameters,
    baseline_options,
    check_input,
    check_settings,
    keep_result,
    live_request,
    recover,
    replay_command,
    settings_for,
)
from proprio_ros.pipeline.replay import replay
from proprio_ros.pipeline.request import Options, Request
from proprio_ros.probes import probe_named
from proprio_ros.probes.payload.facts import inertia_tensor
from proprio_ros.probes.softness import block_rotation, largest_squeeze
from proprio_ros.recordings.messages import RawMessage
from proprio_ros.recordings.signals import read_recording
from proprio_ros.recordings.topics import JOINT_STATE
from proprio_ros.records import Recording
from proprio_ros.robot import load_robot
from proprio_ros.robot.drive_train import FingerTravel
from proprio_ros.sim import sphere_kernels, squeeze

ROBOT = load_robot("open_manipulator_x")
CONSTANTS = {n: d.nominal_torque_constant / d.transmission for n, d in ROBOT.drive_trains.items()}
BAG = "quantised_s00_fixed_heavy_ball_50g_joint3/bag_mcap"


def recording(bag: Path) -> Recording:
    return read_recording(bag, nominal_torque_constants=CONSTANTS, joint_order=list(CONSTANTS))


def cdr_joint_state(
    stamp_ns: int,
    names: list[str],
    position: list[float],
) -> bytes:
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


def filled(
    root: Path,
    journal: bool = False,
    joints: tuple[str, str] = ("joint2", "joint3"),
) -> Session:
    session = Session(
        root,
        "payload",
        datetime(
            2026,
            1,
            2,
            3,
            4,
            5,
            tzinfo=timezone.utc,
        ),
    )
    if journal:
        session.open()
    for n in range(20):
        stamp = 1_700_000_000 * 10**9 + n * 10_000_000
        data = cdr_joint_state(
            stamp,
            list(joints),
            [0.1, 0.01 * n],
        )
        session.add("/joint_states", "sensor_msgs/msg/JointState", stamp + 500_000, data)
    return session


def test_what_came_in_is_what_the_bag_holds(tmp_path: Path) -> None:
    session = filled(tmp_path)
    bag, warning = session.save()
    assert warning == ""
    assert bag == tmp_path / "20260102_030405_000_payload" / "bag"
    read = recording(bag)
    assert read.joints.names == ("joint2", "joint3")
    assert read.joints.position[:, 1].tolist() == [0.01 * n for n in range(20)]
    assert np.all(np.diff(read.joints.times_ns) == 10_000_000)


def test_a_folder_that_cannot_be_written_costs_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    full = tmp_path / "full"
    full.write_text("a file where a folder should be")
    elsewhere = tmp_path / "elsewhere"
    monkeypatch.setattr(session_module, "_elsewhere", lambda: [elsewhere])
    session = filled(full)
    bag, warning = session.save()
    assert bag.is_relative_to(elsewhere)
    assert str(elsewhere) in warning
    assert "\n" not in warning
    assert len(recording(bag).joints.times_ns) == 20

    # nowhere at all: kept, and written when there is room
    monkeypatch.setattr(session_module, "_elsewhere", list)
    session = filled(full)
    with pytest.raises(RecordingError, match="kept in memory"):
        session.save()
    full.unlink()
    bag, warning = session.save()
    assert warning == ""
    assert len(recording(bag).joints.times_ns) == 20


def test_nothing_came_in(tmp_path: Path) -> None:
    session = Session(tmp_path, "payload")
    session.open()
    with pytest.raises(RecordingError, match="is the driver running"):
        session.save()
    assert not list(tmp_path.iterdir())


def test_a_recording_is_on_disk_as_it_comes_and_a_bag_after_a_crash(tmp_path: Path) -> None:
    expected = filled(tmp_path / "whole").save()[0]
    root = tmp_path / "cut_off"
    session = filled(root, journal=True)
    journal = session.folder / session_module.JOURNAL
    assert len(session_module.read_journal(journal)) == 20
    assert recover(root) == ([], []), "somebody is writing it"
    assert journal.exists()
    assert session._journal is not None
    session._journal.write(b"half a rec")  # killed in the middle of a message
    session._journal.close()  # as the kernel does it
    assert recover(root) == ([session.folder / "bag"], [])
    read = recording(session.folder / "bag")
    whole = recording(expected)
    assert np.array_equal(read.joints.position, whole.joints.position)
    assert np.array_equal(read.joints.times_ns, whole.joints.times_ns)
    assert not journal.exists()
    assert recover(root) == ([], [])


def test_killed_while_the_bag_was_written(tmp_path: Path) -> None:
    session = filled(tmp_path, journal=True)
    (session.folder / "bag").mkdir()
    (session.folder / "bag" / "bag.mcap").write_bytes(b"\x89MCAP0\r\n")
    assert session._journal is not None
    session._journal.close()
    assert recover(tmp_path) == ([session.folder / "bag"], [])
    assert len(recording(session.folder / "bag").joints.times_ns) == 20


def test_nothing_is_left_beside_the_bag(tmp_path: Path) -> None:
    session = filled(tmp_path, journal=True)
    bag, _ = session.save()
    assert [path.name for path in session.folder.iterdir()] == ["bag"]
    assert len(recording(bag).joints.times_ns) == 20


def test_an_unwritable_folder_is_named_before_anything_is_recorded(tmp_path: Path) -> None:
    full = tmp_path / "full"
    full.write_text("a file where a folder should be")
    session = Session(full, "payload")
    with pytest.raises(
        RecordingError, match=r"full cannot be written .*name another folder with --data-directory"
    ) as caught:
        session.open()
    assert "the parameter data_directory" in as_parameters(str(caught.value))


# --- what comes in, before anything moves -------------------------------------------------------------------------------


def heard(session: Session) -> list[RawMessage]:
    return list(session._messages)


def test_what_can_be_read_is_not_refused_and_leaves_nothing(tmp_path: Path) -> None:
    folder = tmp_path / "session"
    assert check_input(folder, heard(filled(tmp_path)), Request(ROBOT)) == ()
    assert not list(folder.iterdir())
    # wheels on the same topic
    both = [
        *heard(filled(tmp_path)),
        *heard(filled(tmp_path, joints=("wheel_left", "wheel_right"))),
    ]
    check_input(folder, both, Request(ROBOT))


def test_what_a_replay_would_refuse_is_refused_before_the_probe(tmp_path: Path) -> None:
    def refusal(
        messages: list[RawMessage],
        options: Options | None = None,
    ) -> str:
        with pytest.raises(RecordingError) as caught:
            check_input(
                tmp_path / "session",
                messages,
                Request(ROBOT, options or Options()),
            )
        return as_parameters(str(caught.value))

    told = refusal(heard(filled(tmp_path, joints=("a1", "a2"))))
    assert "are of a1, a2" in told
    assert "the parameter robot" in told
    assert "the parameter state_topic" in told
    assert "no joint states" in refusal([]) or "no messages" in refusal([])
    begin = 1_700_000_000 * 10**9
    step = 10**7
    degrees = [
        RawMessage(
            "/joint_states", JOINT_STATE, stamp, cdr_joint_state(stamp, ["joint2"], [-80.0 - n])
        )
        for n, stamp in enumerate(range(begin, begin + 20 * step, step))
    ]
    assert "degrees" in refusal(degrees)
    other = Options(state_topic="/arm/joint_states")
    assert "the parameter state_topic /arm/joint_states is not in the bag" in refusal(
        heard(filled(tmp_path)), other
    )


def test_the_live_estimate_narrows_and_ends_where_the_bag_does(bags: Path) -> None:
    read = recording(bags / BAG)
    assert read.inputs is not None
    live = LiveEstimate(live_request(Options()))
    assert live.estimate() is None
    inputs = list(zip(read.inputs.times_ns, read.inputs.current_A, strict=True))
    effort = np.array([CONSTANTS[name] for name in read.inputs.names])
    assert read.inputs.names == read.joints.names
    shown = []
    for row, stamp in enumerate(read.joints.times_ns):
        while inputs and inputs[0][0] <= stamp:
            time_ns, current = inputs.pop(0)
            live.add_input(
                int(time_ns),
                read.inputs.names,
                current * effort,
            )
        live.add_state(
            int(stamp),
            read.joints.names,
            read.joints.position[row],
        )
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
    assert shown[-1][0] == pytest.approx(0.05, abs=0.003)
    assert final.value == pytest.approx(0.05, abs=0.003)


def test_samples_that_are_no_use_are_passed_over() -> None:
    live = LiveEstimate(live_request(Options()))
    live.add_state(1_000, ["joint3"], [0.1])
    live.add_state(900, ["joint3"], [0.2])  # out of order
    live.add_state(
        2_000,
        ["joint3"],
        [float("nan")],
    )
    live.add_state(3_000, ["wheel_left"], [0.1])  # another robot's joint
    live.add_input(1_000, ["joint3"], [0.0])
    assert live.estimate() is None
    assert len(live._states) == 1


def test_a_live_estimate_takes_what_a_replay_takes(bags: Path) -> None:
    """Wheels on the topic, the gripper from another publisher with another clock, no applied effort: the numbers are the same."""
    read = recording(bags / BAG)
    assert read.inputs is not None
    effort = np.array([CONSTANTS[name] for name in read.inputs.names])

    def fed(foreign: bool) -> tuple[float, float]:
        live = LiveEstimate(live_request(Options()))
        for stamp, current in zip(read.inputs.times_ns, read.inputs.current_A, strict=True):
            if not foreign:
                live.add_input(
                    int(stamp),
                    read.inputs.names,
                    current * effort,
                )
            elif any(current):
                live.add_command(
                    int(stamp),
                    {
                        n: float(c)
                        for n, c in zip(
                            read.inputs.names,
                            current,
                            strict=True,
                        )
                        if c
                    },
                )
            else:
                live.add_command(int(stamp), {})
        for stamp, row in zip(read.joints.times_ns, read.joints.position, strict=True):
            state = dict(zip(read.joints.names, row, strict=True))
            if foreign:
                live.add_state(
                    int(stamp),
                    ["wheel_left"],
                    [100.0],
                )
                live.add_state(
                    int(stamp) + 12_000_000,
                    ["gripper_left_joint"],
                    [state.pop("gripper_left_joint")],
                )
            live.add_state(
                int(stamp),
                list(state),
                list(state.values()),
            )
        estimate = live.estimate()
        known = None if estimate is None else live_interval(estimate)
        assert known is not None
        return known

    assert fed(foreign=True) == pytest.approx(fed(foreign=False), rel=1e-3)


def test_what_is_stated_about_the_object_is_checked_at_once() -> None:
    with pytest.raises(ConfigurationError, match=r"payload\.siz"):
        live_request(Options(settings={"payload.siz": 0.03}))
    stated = live_request(Options(settings={"payload.shape": "cube", "payload.size": 0.03}))
    # a cube: m a^2 / 6 about every axis
    assert inertia_tensor(stated.facts.payload, 0.06) == pytest.approx(
        np.eye(3) * 0.06 * 0.03**2 / 6.0
    )
    assert stated.probe.load(stated.facts, 0.06).inertia_is == "stated"
    # whoever takes a load cannot take a load without a tensor
    assumed = live_request(Options())
    load = assumed.probe.load(assumed.facts, 0.06)
    assert load.inertia_is == "assumed"
    assert np.linalg.eigvalsh(load.inertia_kg_m2).min() > 0.0


def test_the_command_beside_a_result_gives_it_again(
    bags: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = Options(settings={"payload.size": 0.03, "payload.shape": "cube"})
    estimate = replay([bags / BAG], options)
    bag = tmp_path / "bag"
    keep_result(bag, estimate, replay_command(bags / BAG, options))
    kept = json.loads((tmp_path / "estimate.json").read_text())
    words = shlex.split(kept["command"])
    main([*words[1:], "--json"])
    assert json.loads(capsys.readouterr().out)["estimates"] == kept["estimates"]


def test_the_command_names_the_topics_that_were_stated() -> None:
    options = Options(state_topic="/a/states", command_topic="/a/drive", effort_unit="mA")
    words = shlex.split(replay_command(Path("bag"), options))
    for flag, value in (
        ("--state-topic", "/a/states"),
        ("--command-topic", "/a/drive"),
        ("--effort-unit", "mA"),
    ):
        assert words[words.index(flag) + 1] == value


# --- a container and what rolls in it -----------------------------------------------------------------------------------

SHELL_KG = 0.03
ABOUT_IT = {
    "container.inner_size": [0.06, 0.04, 0.04],
    "container.centre": [0.035, 0.0, 0.0],
    "sphere.radius": 0.01,
}


def container_options(bags: Path) -> Options:
    baseline = sorted(bags.glob("realistic_s00_container_no_sphere_*/bag_*"))
    assert len(baseline) == 3
    return Options(
        probe="container",
        settings=ABOUT_IT,
        baseline=tuple(baseline),
    )


def test_a_probe_hears_only_of_its_own_object() -> None:
    stated = {
        "payload.size": 0.03,
        "payload.frame": "link5",
        "sphere.radius": 0.01,
        "container.mass": 0.03,
        "block.contact": "bonded",
        "held.joint1": 0.1,
    }
    assert set(settings_for(probe_named("softness"), stated)) == {
        "payload.frame",
        "block.contact",
        "held.joint1",
    }
    assert set(settings_for(probe_named("payload"), stated)) == {
        "payload.size",
        "payload.frame",
        "held.joint1",
    }
    assert set(settings_for(probe_named("container"), stated)) == {
        "payload.frame",
        "sphere.radius",
        "container.mass",
        "held.joint1",
    }
    check_settings(Options(settings=stated))
    with pytest.raises(
        ConfigurationError,
        match=r"sphere\.radios: unknown; valid keys: sphere\.radius.*block\.contact",
    ):
        check_settings(Options(settings={**stated, "sphere.radios": 0.01}))
    with pytest.raises(ConfigurationError, match="does not fit"):
        check_settings(Options(settings={"sphere.radius": 0.03}))
    with pytest.raises(ConfigurationError, match="records no camera"):
        check_settings(Options(settings={"sphere.camera": "/sphere"}))
    with pytest.raises(ConfigurationError, match="lengths in m"):
        check_settings(Options(settings={"block.size": 30}))


def test_the_empty_container_is_weighed_as_a_shell_in_its_place(bags: Path) -> None:
    options = replace(
        container_options(bags),
        settings={**ABOUT_IT, "held.joint1": 0.0, "solver.starts_kg": [0.01]},
    )
    weighing = baseline_options(live_request(options))
    assert weighing.probe == "payload"
    assert not weighing.baseline
    assert weighing.settings["held.joint1"] == 0.0
    assert weighing.settings["payload.com"] == ABOUT_IT["container.centre"]
    # thin walls: the two across z are 6 x 4 cm, those across y 6 x 4, those across x 4 x 4; moments of a plate and Steiner
    areas = {
        "x": 2 * 16.0,
        "y": 2 * 24.0,
        "z": 2 * 24.0,
    }
    about_y = (
        areas["x"] * (4.0**2 / 12.0 + 3.0**2)
        + areas["y"] * (6.0**2 + 4.0**2) / 12.0
        + areas["z"] * (6.0**2 / 12.0 + 2.0**2)
    ) / (1e4 * sum(areas.values()))
    assert weighing.settings["payload.inertia_per_mass"][1] == pytest.approx(about_y, rel=1e-9)
    estimate = replay(options.baseline, weighing)
    shell = estimate.values[0]
    assert isinstance(shell.value, float)
    assert shell.ci95[0] < SHELL_KG < shell.ci95[1]


def test_a_container_stated_to_be_turned_has_its_inertia_turned() -> None:
    upright = Options(
        probe="container",
        settings={
            **ABOUT_IT,
            "container.rpy": [0.0, 0.0, math.pi / 2.0],
        },
    )
    level = Options(probe="container", settings=ABOUT_IT)
    turned, straight = (
        baseline_options(live_request(options)).settings["payload.inertia_per_mass"]
        for options in (upright, level)
    )
    xx, yy, zz = straight[:3]
    assert xx != pytest.approx(yy, rel=0.1)
    assert turned == pytest.approx([yy, xx, zz, 0.0, 0.0, 0.0], abs=1e-12)


@pytest.mark.long
def test_the_command_of_a_container_names_its_baseline_and_gives_the_result_again(
    bags: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = container_options(bags)
    full = next(bags.glob("realistic_s00_container_sphere_12g_joint3_*/bag_*"))
    words = shlex.split(replay_command(full, options))
    assert words.count("--baseline") == 1
    assert set(map(str, options.baseline)) < set(words)
    estimate = replay([full], options)
    main([*words[1:], "--json"])
    assert json.loads(capsys.readouterr().out)["estimates"] == estimate.as_json()["estimates"]


def prepare(options: Options) -> None:
    setting = live_request(options)
    setting.probe.prepare(setting.robot, setting.facts)


@pytest.mark.long
def test_nothing_is_compiled_after_the_preparation(bags: Path) -> None:
    options = container_options(bags)
    full = next(bags.glob("realistic_s00_container_sphere_12g_joint3_*/bag_*"))

    def compiled_in_replay(prepared: Options) -> int:
        sphere_kernels.sphere_law.cache_clear()
        prepare(prepared)
        before = sphere_kernels.sphere_law.cache_info().misses
        replay([full], options)
        return int(sphere_kernels.sphere_law.cache_info().misses - before)

    assert compiled_in_replay(options) == 0
    other = replace(
        options,
        settings={
            **ABOUT_IT,
            "container.shape": "cylinder",
            "container.inner_size": [0.04, 0.06],
        },
    )
    assert compiled_in_replay(other) > 0


@pytest.mark.long
def test_nothing_is_compiled_after_a_squeeze_is_prepared(bags: Path) -> None:
    options = Options(probe="softness", settings={"block.size": 0.03})
    squeeze.squeeze_law.cache_clear()
    prepare(options)
    before = squeeze.squeeze_law.cache_info().misses
    replay([bags / "realistic_s00_squeeze_heavy" / "bag_mcap"], options)
    assert squeeze.squeeze_law.cache_info().misses == before


def test_how_far_a_block_may_be_squeezed() -> None:
    """Two fingers; where their linkage was measured to close faster than the ratio says, by that much more."""
    setting = live_request(Options(probe="softness", settings={"block.size": [0.02, 0.03, 0.03]}))
    robot = setting.robot
    facts = setting.facts.block
    gripper = "gripper_left_joint"
    assert largest_squeeze(robot, gripper, 0.005, facts) == pytest.approx(0.5)
    one = live_request(
        Options(probe="softness", settings={"block.size": 0.02, "block.fingers": 1})
    ).facts.block
    assert largest_squeeze(robot, gripper, 0.005, one) == pytest.approx(0.25)
    drive = robot.drive_trains[gripper]
    faster = replace(
        drive,
        finger_travel=FingerTravel((-1.0, 1.0), (-0.015, 0.015)),
    )
    other = replace(
        robot,
        drive_trains={**robot.drive_trains, gripper: faster},
    )
    assert largest_squeeze(other, gripper, 0.005, facts) == pytest.approx(0.5 * 0.015 / 0.01149)


def test_a_block_lies_along_the_way_of_the_fingers() -> None:
    rotation = block_rotation(ROBOT, "gripper_left_joint")
    np.testing.assert_allclose(
        rotation.T @ rotation,
        np.eye(3),
        atol=1e-12,
    )
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    np.testing.assert_allclose(
        np.abs(rotation[:, 0]),
        [0.0, 1.0, 0.0],
        atol=1e-12,
    )
