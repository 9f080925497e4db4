"""Tables of people without ROS: the same recording in every form gives the same numbers, and what nobody says is asked."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.bends.tape import tape_of
from support.recording_bag import write_recording
from support.tables import (
    Recorded,
    bare,
    decimals,
    libfranka,
    merged,
    parquet,
    recorded_in,
    rtde,
    written,
)

from proprio_ros.addons.fleet.episodes import episodes_of
from proprio_ros.addons.fleet.job import Job
from proprio_ros.addons.fleet.rows import rows_of
from proprio_ros.cli import main
from proprio_ros.errors import ConfigurationError, ProprioError, RecordingError
from proprio_ros.pipeline.check import check_bags
from proprio_ros.pipeline.replay import replay
from proprio_ros.pipeline.request import Options, read_request
from proprio_ros.recordings import tables
from proprio_ros.recordings.drivers import columns_files
from proprio_ros.recordings.effort import Effort
from proprio_ros.recordings.headers import Kind, header_of
from proprio_ros.recordings.read_options import ReadOptions
from proprio_ros.recordings.sources import TableSource, open_recording, open_source
from proprio_ros.recordings.tables import is_recorded_table, open_table
from proprio_ros.records import JointRecord, Recording
from proprio_ros.robot import load_robot

ROOT = Path(__file__).resolve().parents[2]
BAGS = ROOT / "bags"
REAL = ROOT.parent / "shared" / "recordings_real"
PUSH = BAGS / "realistic_s00_fixed_light_ball_20g_joint3" / "bag_mcap"
EMPTY = sorted(BAGS.glob("realistic_s00_empty_*/bag_mcap"))
JOINTS = ("joint1", "joint2", "joint3", "joint4", "gripper_left_joint")
SIX = tuple(f"joint{n}" for n in range(1, 7))
needs_real = pytest.mark.skipif(not REAL.exists(), reason="needs the real recordings")


def read(
    path: Path,
    unit: str | None = None,
    driver: str | None = None,
    robot: str = "open_manipulator_x",
) -> Recording:
    request = read_request(Options(robot=robot, effort_unit=unit, driver=driver))
    with open_recording(path) as source:
        return source.recording(request.reading.options)


def refusal(path: Path, **how: Any) -> str:
    with pytest.raises((RecordingError, ConfigurationError)) as caught:
        read(path, **how)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 300
    return str(caught.value)


def same(one: Recording, other: Recording, exactly: bool = True) -> None:
    """The same numbers, whenever they began."""
    close = 0.0 if exactly else 1e-12
    since = [each.joints.times_ns - each.joints.times_ns[0] for each in (one, other)]
    np.testing.assert_array_equal(*since)
    assert one.joints.names == other.joints.names
    for name in ("position", "velocity", "reported_effort", "effort", "current"):
        values = [getattr(each.joints, name) for each in (one, other)]
        assert [value is None for value in values] in ([True] * 2, [False] * 2), name
        if values[0] is not None:
            np.testing.assert_allclose(values[0], values[1], rtol=close, atol=close)
    assert (one.inputs is None) == (other.inputs is None)
    if one.inputs is not None and other.inputs is not None:
        np.testing.assert_allclose(one.inputs.current_A, other.inputs.current_A, rtol=close)
        assert one.inputs.measured == other.inputs.measured


# ---------------------------------------------------------------- the same recording in every form


def elbow(count: int = 60, period_ns: int = 10_000_000) -> Recorded:
    """A few joints that swing, with velocities and torques, that begin at a time of today."""
    times_ns = 1_760_000_000_000_000_000 + period_ns * np.arange(count, dtype=np.int64)
    since_s = 1e-9 * (times_ns - times_ns[0])
    phase = 2.0 * since_s[:, None] + np.arange(5)
    none = np.empty(0, dtype=np.int64)
    return Recorded(
        times_ns,
        JOINTS,
        0.7 * np.sin(phase),
        1.4 * np.cos(phase),
        0.3 * np.cos(0.5 * phase),
        none,
        (),
        np.empty((0, 0)),
    )


def columns_of(
    found: Recorded, degrees: float = 1.0, digits: int = 9, first_ns: int = 0
) -> list[Sequence[object]]:
    times = [decimals(int(time_ns) - first_ns, digits) for time_ns in found.times_ns]
    return [times, *(degrees * found.position).T, *found.effort.T]


FORMS: dict[str, tuple[str, dict[str, object], dict[str, object]]] = {
    # headers of time, position and effort; how the text is written; how numbers are
    "comma": ("t [s]|q{n} [rad]|tau{n} [Nm]", {}, {}),
    "semicolons and decimal commas": (
        "t [s]|q{n} [rad]|tau{n} [N m]",
        {"separator": ";", "comma": True},
        {},
    ),
    "tabs": ("time (s)|position {n} (rad)|torque {n} (N*m)", {"separator": "\t"}, {}),
    "spaces": ("t_s|q_{n}_rad|tau_{n}_nm", {"separator": " "}, {}),
    "a byte order mark": ("t [s]|q{n} [rad]|tau{n} [Nm]", {"before": "\ufeff"}, {}),
    "comments": ("t [s]|q{n} [rad]|tau{n} [Nm]", {"before": "# an arm\n% and more\n\n"}, {}),
    "a spreadsheet's own line": (
        "t [s]|q{n} [rad]|tau{n} [Nm]",
        {"separator": "|", "before": "sep=|\n"},
        {},
    ),
    "milliseconds": ("t [ms]|q{n} [rad]|tau{n} [Nm]", {}, {"digits": 6}),
    "microseconds": ("Time (us)|q{n} [rad]|tau{n} [Nm]", {}, {"digits": 3}),
    "degrees": ("t [s]|q{n} [deg]|tau{n} [Nm]", {}, {"degrees": 180.0 / np.pi}),
    "degrees in words": (
        "timestamp|joint_{n}_pos_deg|joint_{n}_effort [Nm]",
        {},
        {"degrees": 180.0 / np.pi},
    ),
    "a time that begins at 0": (
        "t [s]|q{n} [rad]|tau{n} [Nm]",
        {},
        {"first_ns": 1_760_000_000_000_000_000},
    ),
}


@pytest.mark.parametrize("form", FORMS)
def test_every_form_of_a_text_gives_the_numbers_of_the_bag(tmp_path: Path, form: str) -> None:
    headers, how, numbers = FORMS[form]
    found = elbow()
    time, position, effort = headers.split("|")
    names = [
        time,
        *(position.format(n=n) for n in range(5)),
        *(effort.format(n=n) for n in range(5)),
    ]
    table = written(tmp_path / "log.csv", names, columns_of(found, **numbers), **how)  # type: ignore[arg-type]
    recording = read(table)
    assert recording.joints.names == JOINTS
    np.testing.assert_array_equal(np.diff(recording.joints.times_ns), np.diff(found.times_ns))
    np.testing.assert_allclose(recording.joints.position, found.position, rtol=1e-15)
    assert recording.joints.effort is not None
    np.testing.assert_array_equal(recording.joints.effort, found.effort)


@pytest.mark.parametrize("bag", [PUSH, BAGS / "contents_rigid_r45_h59" / "run_0"])
def test_a_push_is_the_same_in_a_bag_and_in_a_table(tmp_path: Path, bag: Path) -> None:
    """Joint states and commands at other times, one row each; applied efforts are torques by that name."""
    command = "command [A]" if bag is PUSH else "applied_effort"
    table = merged(tmp_path / "push.csv", recorded_in(bag), command)
    same(read(bag), read(table))


@pytest.mark.long
def test_calibration_and_weighing_are_the_same_in_tables(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    answers = []
    for form in ("bag", "csv"):
        made = [merged(tmp_path / f"{n}.csv", recorded_in(bag)) for n, bag in enumerate(EMPTY)]
        push = merged(tmp_path / "push.csv", recorded_in(PUSH))
        empty = EMPTY if form == "bag" else made
        arm = str(tmp_path / f"{form}.yaml")
        assert main(["calibrate", *map(str, empty), "--output", arm]) == 0
        capsys.readouterr()
        loaded = str(PUSH if form == "bag" else push)
        words = ["--probe", "payload", "--set", "payload.com=[0,0,0]", "--calibration", arm]
        assert main(["replay", loaded, *words, "--json"]) == 0
        answers.append(json.loads(capsys.readouterr().out))
    for name in ("verdict", "reasons", "estimates", "fit"):
        assert answers[0][name] == answers[1][name]


@needs_real
def test_a_real_pair_is_the_same_in_every_form(tmp_path: Path) -> None:
    """By UR's recorder, as a bare table and as Parquet."""
    pair = [REAL / "ur10e_loaded_15", REAL / "ur10e_empty_15"]
    found = [recorded_in(bag) for bag in pair]
    for bag, recorded in zip(pair, found, strict=True):
        reference = read(bag, driver="ur_current", robot="ur10e")
        table = rtde(tmp_path / "rtde.csv", recorded)
        same(reference, read(table, driver="ur_rtde", robot="ur10e"))
        same(reference, read(bare(tmp_path / "bare.csv", recorded), robot="ur10e"))
        named = parquet(tmp_path / "log.parquet", recorded)
        same(reference, read(named, unit="A", driver="si", robot="ur10e"))


@needs_real
@pytest.mark.long
def test_a_real_pair_weighs_the_same_in_a_bag_and_by_urs_recorder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pair = [REAL / "ur10e_loaded_15", REAL / "ur10e_empty_15"]
    by_rtde = [rtde(tmp_path / f"{bag.name}.csv", recorded_in(bag)) for bag in pair]
    answers = []
    for paths, driver in ((pair, "ur_current"), (by_rtde, "ur_rtde")):
        words = ["--probe", "payload", "--robot", "ur10e", "--driver", driver, "--json"]
        capsys.readouterr()
        assert main(["replay", str(paths[0]), "--baseline", str(paths[1]), *words]) == 0
        answers.append(json.loads(capsys.readouterr().out))
    assert answers[0]["estimates"] == answers[1]["estimates"]
    mass = answers[0]["estimates"][0]
    assert mass["ci95"][0] < 2.805 < mass["ci95"][1]


@needs_real
@pytest.mark.parametrize("spaced", [True, False])
def test_libfrankas_log_is_read_in_milliseconds(tmp_path: Path, spaced: bool) -> None:
    robot = str(REAL / "models" / "kuka_lwr4.urdf")
    whole = tape_of(REAL / "kuka_lwr4_empty_1").retimed(lambda t: t // 10**6 * 10**6)
    bag = whole.write(tmp_path / "bag")
    table = libfranka(tmp_path / "log.csv", recorded_in(bag), spaced)
    same(
        read(bag, driver="franka", robot=robot),
        read(table, driver="franka_log", robot=robot),
    )


@pytest.mark.parametrize(
    ("robot", "of_bag", "of_table", "write"),
    [("ur10e", "ur_current", "ur_rtde", rtde), ("panda", "franka", "franka_log", libfranka)],
)
def test_what_makers_record_is_read_as_a_bag_of_the_same_numbers(
    tmp_path: Path, robot: str, of_bag: str, of_table: str, write: Callable[[Path, Recorded], Path]
) -> None:
    joints = tuple(load_robot(robot).drive_trains)
    times_ns = elbow().times_ns
    phase = 2e-9 * (times_ns - times_ns[0])[:, None] + np.arange(len(joints))
    record = JointRecord(
        times_ns, joints, np.sin(phase), 2.0 * np.cos(phase), 3.0 * np.sin(2.0 * phase)
    )
    bag = tmp_path / "bag"
    write_recording(bag, Recording("made", record, None))
    table = write(tmp_path / "log.csv", recorded_in(bag))
    same(read(bag, driver=of_bag, robot=robot), read(table, driver=of_table, robot=robot))


def test_the_table_that_comes_along_is_the_bag_that_comes_along() -> None:
    same(read(PUSH), read(ROOT / "examples" / "push.csv"))


def test_a_table_of_one_joint_needs_no_number(tmp_path: Path) -> None:
    found = elbow()
    columns = [columns_of(found)[0], found.position[:, 0], found.effort[:, 0]]
    table = written(tmp_path / "log.csv", ["t [s]", "q [rad]", "current [mA]"], columns)
    options = ReadOptions(Effort(None, {}), ["shoulder"])
    with TableSource(table) as source:
        recording = source.recording(options)
    assert recording.joints.names == ("shoulder",) and recording.joints.current is not None
    np.testing.assert_allclose(recording.joints.current[:, 0], 1e-3 * found.effort[:, 0])


def test_a_part_of_a_table_is_read(tmp_path: Path) -> None:
    table = bare(tmp_path / "log.csv", elbow())
    options = read_request(Options()).reading.options
    with open_recording(table) as source:
        part = source.recording(replace(options, span=(100_000_000, 300_000_000)))
    assert len(part.joints.times_ns) == 20


# ---------------------------------------------------------------- what headers say


@pytest.mark.parametrize(
    ("text", "kind", "joint", "unit"),
    [
        ("t", Kind.TIME, "", None),
        ("__time", Kind.TIME, "", None),
        ("header.stamp", Kind.TIME, "", None),
        ("timestamp_ns", Kind.TIME, "", "ns"),
        ("q0", Kind.POSITION, "0", None),
        ("Joint Position 1 (°)", Kind.POSITION, "joint_1", "rad"),
        ("actual_q_0", Kind.POSITION, "0", None),
        ("current_position_2", Kind.POSITION, "2", None),
        ("/joint_states/wrist_1_joint/effort", Kind.EFFORT, "wrist_1_joint", None),
        ("shoulder_pan_joint_velocity", Kind.VELOCITY, "shoulder_pan_joint", None),
        ("torque_current_2 [mA]", Kind.CURRENT, "2", "mA"),
        ("tau_1 [mNm]", Kind.TORQUE, "1", "N.m"),
        ("state.tau_J[3]", Kind.TORQUE, "j_3", None),
        ("state.q_d[0]", Kind.GOAL, "0", None),
        ("target_q_3", Kind.GOAL, "3", None),
        ("target_moment_0", Kind.COMMAND, "0", None),
        ("cmd3 [A]", Kind.COMMAND, "3", "A"),
        ("current_command_joint3", Kind.COMMAND, "joint3", None),
        # nothing plain: qd may be a velocity or a goal, cmd anything, and no joint is called so
        ("actual_qd_0", None, "actual_qd_0", None),
        ("cmd_joint3", None, "cmd_joint3", None),
        ("actual_TCP_pose_0", None, "actual_tcp_pose_0", None),
        ("actual_execution_time", None, "actual_execution_time", None),
        ("dq_d_1", None, "dq_d_1", None),
    ],
)
def test_a_header_says_what_its_words_say(
    text: str, kind: Kind | None, joint: str, unit: str | None
) -> None:
    found = header_of(text)
    assert (found.kind, found.unit and found.unit.called) == (kind, unit)
    assert kind is None or found.joint == joint


# ---------------------------------------------------------------- what nobody says


def plain_table(
    path: Path,
    found: Recorded,
    time: str = "t [s]",
    position: str = "q{n} [rad]",
    digits: int = 9,
    velocity: bool = False,
) -> Path:
    headers = [time, *(position.format(n=n) for n in range(5))]
    times = columns_of(found, digits=digits, first_ns=int(found.times_ns[0]))[0]
    columns: list[Sequence[object]] = [times, *found.position.T]
    if velocity:
        headers += [f"dq{n}" for n in range(5)]
        columns += list(found.velocity.T)
    return written(path, headers, columns)


def test_whether_angles_are_in_degrees_is_asked(tmp_path: Path) -> None:
    table = plain_table(tmp_path / "log.csv", elbow(), position="q{n}")
    asked = refusal(table)
    assert "nobody says whether q0 .. q4 is in rad or degrees" in asked and "--driver si" in asked
    same(read(table, driver="si"), read(plain_table(tmp_path / "other.csv", elbow())))
    (tmp_path / "columns.yaml").write_text("position_unit: deg\n")
    degrees = read(table).joints.position
    np.testing.assert_allclose(degrees, np.pi / 180.0 * elbow().position)


@pytest.mark.parametrize(
    ("digits", "unit", "period_ns"),
    [(9, "s", 10_000_000), (6, "ms", 8_000_000), (3, "us", 8_000_000), (0, "ns", 8_000_000)],
)
def test_a_time_that_can_be_in_one_unit_only_is_read_in_it_and_said(
    tmp_path: Path, digits: int, unit: str, period_ns: int
) -> None:
    found = elbow(period_ns=period_ns)
    recording = read(plain_table(tmp_path / "log.csv", found, time="t", digits=digits))
    np.testing.assert_array_equal(np.diff(recording.joints.times_ns), period_ns)
    assert any(f"t was read in {unit}" in note for note in recording.notes)


def test_where_seconds_and_milliseconds_are_possible_velocities_say_it_or_it_is_asked(
    tmp_path: Path,
) -> None:
    """2 ms apart: of 500 rows in a second, or of one every 2 s."""
    found = elbow(count=2000, period_ns=2_000_000)
    table = plain_table(tmp_path / "log.csv", found, time="t", digits=6)
    assert "rows of t are 2 apart, in s or ms?" in refusal(table)
    recording = read(plain_table(tmp_path / "v.csv", found, time="t", digits=6, velocity=True))
    np.testing.assert_array_equal(np.diff(recording.joints.times_ns), 2_000_000)
    assert any("as velocities show" in note for note in recording.notes)


def test_a_counter_that_could_be_a_date_is_asked(tmp_path: Path) -> None:
    """1.5e9 is a day of 2017 in seconds, and 17 days of a controller in milliseconds."""
    found = elbow(period_ns=2_000_000)
    times = [decimals(1_500_000_000_000_000 + 2_000_000 * row, 6) for row in range(60)]
    headers = ["t", *(f"q{n} [rad]" for n in range(5))]
    table = written(tmp_path / "log.csv", headers, [times, *found.position.T])
    assert "in s or ms?" in refusal(table)
    # as nanoseconds it would be of no year that there is
    times = [decimals(int(time_ns), 3) for time_ns in found.times_ns]
    recording = read(written(tmp_path / "us.csv", headers, [times, *found.position.T]))
    np.testing.assert_array_equal(recording.joints.times_ns, found.times_ns)


def test_a_date_says_its_unit(tmp_path: Path) -> None:
    found = elbow(period_ns=2_000_000)
    headers = ["timestamp", *(f"q{n} [rad]" for n in range(5))]
    columns: list[Sequence[object]] = [[], *found.position.T]
    columns[0] = [str(np.datetime64(int(t), "ns")) + "+02:00" for t in found.times_ns]
    recording = read(written(tmp_path / "log.csv", headers, columns))
    np.testing.assert_array_equal(
        recording.joints.times_ns,
        found.times_ns - 7200 * 10**9,
    )


def test_a_row_number_is_no_time(tmp_path: Path) -> None:
    found = elbow(period_ns=10**9)
    for header in ("t", "time", "t [s]"):
        assert "row numbers" in refusal(plain_table(tmp_path / "log.csv", found, time=header))
    one_kHz = elbow(period_ns=10**6)
    recording = read(plain_table(tmp_path / "log.csv", one_kHz, time="t [ms]", digits=6))
    np.testing.assert_array_equal(np.diff(recording.joints.times_ns), 10**6)
    # a stated unit in which no robot is logged
    slow = plain_table(tmp_path / "log.csv", elbow(period_ns=8 * 10**9))
    assert "8 s apart, if it is in s" in refusal(slow)


def effort_table(path: Path, *efforts: str) -> Path:
    found = elbow()
    headers = ["t [s]", *(f"q{n} [rad]" for n in range(5))]
    headers += [name.format(n=n) for name in efforts for n in range(5)]
    columns = [columns_of(found)[0], *found.position.T]
    return written(path, headers, [*columns, *(list(found.effort.T) * len(efforts))])


def test_what_effort_is_headers_say_or_the_user(tmp_path: Path) -> None:
    stated = read(effort_table(tmp_path / "a.csv", "tau{n} [mNm]")).joints
    assert stated.effort is not None
    np.testing.assert_allclose(stated.effort, 1e-3 * elbow().effort)
    # as of a bag: never guessed
    assert "--effort-unit" in refusal(effort_table(tmp_path / "b.csv", "tau{n}"))
    assert read(effort_table(tmp_path / "b.csv", "tau{n}"), unit="N.m").joints.effort is not None
    both = effort_table(tmp_path / "c.csv", "tau{n}", "current{n}")
    assert "both torques and currents" in refusal(both)
    assert read(both, unit="A").joints.current is not None
    assert "called a current" in refusal(effort_table(tmp_path / "d.csv", "current{n}"), unit="N.m")
    wrong = effort_table(tmp_path / "e.csv", "current{n} [mA]")
    assert "--effort-unit mA corrects it" in refusal(wrong, unit="A")


def test_the_unit_of_effort_in_a_header_counts_before_the_robot_is_read(tmp_path: Path) -> None:
    """A URDF alone needs no torque constants where torque was recorded."""
    urdf = ROOT / "urdf" / "open_manipulator_x.urdf"
    table = effort_table(tmp_path / "a.csv", "tau{n} [Nm]")
    assert Options(robot=str(urdf)).for_recordings([table]).effort_unit == "N.m"
    mixed = Options(robot=str(urdf)).for_recordings([table, PUSH])
    assert mixed.effort_unit is None


def test_numbers_are_said_to_be_the_robots_order(tmp_path: Path) -> None:
    """Of efforts, too, where positions have names."""
    found = elbow()
    headers = ["t [s]", *(f"{joint} [rad]" for joint in JOINTS)]
    headers += [f"tau{n} [Nm]" for n in range(1, 6)]
    table = written(tmp_path / "log.csv", headers, columns_of(found))
    (note,) = (note for note in read(table).notes if "the robot's order" in note)
    assert note.startswith("tau1 [Nm] .. tau5 [Nm] were read as joint1, joint2")


def test_names_with_another_prefix_are_the_robots_as_in_a_bag(tmp_path: Path) -> None:
    """And efforts count the other way round where that is stated."""
    times_ns = elbow().times_ns
    swing = np.sin(2e-9 * (times_ns - times_ns[0])[:, None] + np.arange(7))
    joints = tuple(f"fer_joint{n}" for n in range(1, 8))
    bag = tmp_path / "bag"
    write_recording(bag, Recording("made", JointRecord(times_ns, joints, swing, None, swing), None))
    headers = ["t [s]", *(f"{joint}_position [rad]" for joint in joints)]
    headers += [f"{joint}_torque [Nm]" for joint in joints]
    times = [decimals(int(time_ns)) for time_ns in times_ns]
    table = written(tmp_path / "log.csv", headers, [times, *swing.T, *swing.T])
    found = read(table, robot="panda")
    same(read(bag, unit="N.m", robot="panda"), found)
    assert any("other names than the robot's" in note for note in found.notes)
    options = Options(robot="panda", effort_sign="-1")
    with open_recording(table) as source:
        turned = source.recording(read_request(options).reading.options)
    assert turned.joints.effort is not None
    np.testing.assert_array_equal(turned.joints.effort, -swing)


def test_a_columns_file_says_which_column_is_what(tmp_path: Path) -> None:
    found = elbow()
    names = ["wann", *(f"Achse {n} Winkel" for n in range(1, 6)), *(f"M{n}" for n in range(1, 6))]
    table = written(tmp_path / "log.csv", names, columns_of(found))
    assert "no column of time" in refusal(table)
    beside = tmp_path / "columns.yaml"
    beside.write_text(
        "time: wann\nposition: Achse * Winkel\nposition_unit: rad\neffort: M\neffort_unit: N.m\n"
    )
    recording = read(table)
    np.testing.assert_array_equal(recording.joints.position, found.position)
    assert recording.joints.effort is not None
    np.testing.assert_array_equal(recording.joints.effort, found.effort)
    beside.write_text(
        f"{beside.read_text()}joints: [joint2, joint1, joint3, joint4, gripper_left_joint]\n"
    )
    assert read(table).joints.names[:2] == ("joint2", "joint1")
    beside.write_text("position: Axis *\n")
    assert "no column" in refusal(table)
    beside.write_text("positon: Axis *\n")
    assert "columns.yaml" in refusal(table) and "position" in refusal(table)


def test_a_recorder_whose_columns_are_known_is_named(tmp_path: Path) -> None:
    table = rtde(tmp_path / "robot_data.csv", replace(elbow(), joints=JOINTS))
    assert "its columns are those of --driver ur_rtde" in refusal(table)
    _, (found,) = check_bags([table])
    assert found.fitting == ("ur_rtde",) and "nobody says" in found.problem
    assert "its columns are those of ur_rtde; state it with --driver" in found.as_text()


# ---------------------------------------------------------------- what is wrong with it


def changed(row: str) -> Callable[[Path], None]:
    """A table with a row in its middle."""

    def write(path: Path) -> None:
        lines = [f"{n / 100},1,1,1,1,{n / 50}" for n in range(50)]
        lines[20:21] = [row]
        path.write_text("\n".join(["t [s],q0 [rad],q1 [rad],q2 [rad],q3 [rad],q4 [rad]", *lines]))

    return write


def under(header: str) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        count = header.count(",")
        lines = [",".join([f"{n / 100}", *([f"{n / 90}"] * count)]) for n in range(50)]
        path.write_text("\n".join([header, *lines]))

    return write


Q = "q0 [rad],q1 [rad],q2 [rad],q3 [rad],q4 [rad]"


def text(content: str) -> Callable[[Path], object]:
    return lambda path: path.write_text(content)


def data(content: bytes) -> Callable[[Path], object]:
    return lambda path: path.write_bytes(content)


def large(path: Path) -> None:
    path.touch()
    os.truncate(path, 600_000_000)


def rows(header: str, row: str) -> Callable[[Path], object]:
    """A table of nine rows, in which `#` stands for the number of each."""
    lines = [row.replace("#", str(n)) for n in range(9)]
    return lambda path: path.write_text("\n".join([header, *lines]) + "\n")


WRONG: dict[str, tuple[Callable[[Path], object], str]] = {
    "empty": (text(""), "is empty"),
    "binary": (data(np.random.default_rng(1).bytes(5000)), "no text"),
    "zeros": (data(bytes(5000)), "no text"),
    "utf-16": (data("t [s],q0\n0,1\n".encode("utf-16")), "UTF-8"),
    "latin-1": (data("t,q0 [°]\n0,1\n".encode("latin-1")), "UTF-8"),
    "a pipe": (os.mkfifo, "a pipe"),
    "not there": (lambda path: None, "No such file"),
    "too large": (large, "500 MB are read"),
    "an endless line": (text("t," + "q" * 3_000_000 + "\n1,2\n"), "field"),
    "a header alone": (text(f"t [s],{Q}\n"), "no row"),
    "one row": (text(f"t [s],{Q}\n0,1,1,1,1,1\n"), "at least 5"),
    "no header": (text("0.0,1,2\n0.1,1,2\n"), "has no header"),
    "prose": (text("Dear reader,\nthis is none.\n"), "as many cells"),
    "decimal commas between commas": (text("t,q0\n0,1,1,5\n"), "decimal commas need"),
    "points and commas": (
        rows(f"t [s];{Q.replace(',', ';')}", "0,#;1.5;1;1;1;1"),
        "which one is decimal",
    ),
    "no time": (under(f"frame,{Q}"), "no column of time"),
    "two times": (under(f"t [s],time [s],{Q}"), "2 columns of time"),
    "no positions": (under("t [s],tau0,tau1"), "no column is the position"),
    "too few joints": (under("t [s],q0 [rad],q1 [rad],q2 [rad],q3 [rad]"), "4 joints by number"),
    "an unknown unit": (under(f"t [s],{Q.replace('q1 [rad]', 'q1 [grad]')}"), "'grad'"),
    "an unknown unit of time": (under(f"t [h],{Q}"), "unit 'h'"),
    "one without a unit": (under(f"t [s],{Q.replace('q1 [rad]', 'q1')}"), "whether q1 is in rad"),
    "a header twice": (under(f"t [s],{Q},q3 [rad]"), "2 columns are called"),
    "a joint twice": (under(f"t [s],{Q},position3 [rad]"), "may both be the position of joint4"),
    "a word": (changed("0.2,1,abc,1,1,1"), "'abc'"),
    "a short line": (changed("0.2,1"), "line 22"),
    "a long line": (changed("0.2,1,1,1,1,1,1"), "line 22"),
    "two recordings": (
        text("\n".join([f"t [s],{Q}"] + 2 * [f"{0.01 * row:.2f},1,1,1,1,1" for row in range(200)])),
        "begins anew behind its row 200",
    ),
    "no times": (rows(f"t [s],{Q}", "nan,1,1,1,1,1"), "no time in any row"),
    "nan": (rows(f"t [s],{Q}", "0.#,,nan,NA,null,"), "no row has a position"),
    "nanoseconds as seconds": (
        rows(f"t [s],{Q}", "176000000000000000#,1,1,1,1,1"),
        "if it is in s: is it",
    ),
}


@pytest.mark.parametrize("what", WRONG)
def test_what_is_wrong_is_said_in_one_line(
    tmp_path: Path, what: str, capsys: pytest.CaptureFixture[str]
) -> None:
    make, words = WRONG[what]
    table = tmp_path / "log.csv"
    make(table)
    assert words in refusal(table)
    assert main(["replay", str(table), "--probe", "payload"]) == 2
    said = capsys.readouterr().err.strip()
    assert words in said and "\n" not in said


def test_what_is_harmless_is_left_out_and_noted(tmp_path: Path) -> None:
    """Empty cells, unused columns whatever they hold, a last line that breaks off."""
    found = elbow()
    headers = ["", "t [s]", *(f"q{n} [rad]" for n in range(5)), "mode", "mode"]
    words: list[Sequence[object]] = [["auto"] * 60] * 2
    table = written(tmp_path / "log.csv", headers, [range(60), *columns_of(found)[:6], *words])
    lines = table.read_text().splitlines()
    cells = lines[30].split(",")
    cells[4] = ""
    lines[30] = ",".join(cells)
    lines[40] = f"{lines[40].split(',')[0]},,{','.join(lines[40].split(',')[2:])}"
    table.write_text("\n".join([*lines[:-1], lines[-1][:40]]))
    recording = read(table)
    assert len(recording.joints.times_ns) == 57
    notes = " ".join(recording.notes)
    assert "the last line breaks off" in notes and "1 of 59 rows have no time" in notes
    assert "lack some of the joints" in notes


def test_a_long_table_is_read_part_by_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = elbow(count=100)
    table = bare(tmp_path / "log.csv", found)
    whole = read(table)
    monkeypatch.setattr(tables, "_TOGETHER", 7)
    same(whole, read(table))
    lines = table.read_text().splitlines()
    lines[41] = lines[41].replace(",", ",x", 1)
    table.write_text("\n".join(lines))
    assert "in row 41, and no number" in refusal(table)
    rest = ";1;1;1;1;1"
    rows_ = [f"0.{row}{rest}" if row < 50 else f"0,{row}{rest}" for row in range(10, 90)]
    table.write_text("\n".join([f"t [s];{Q.replace(',', ';')}", *rows_]))
    assert "which one is decimal" in refusal(table)


def test_topics_are_not_for_tables(tmp_path: Path) -> None:
    table = bare(tmp_path / "log.csv", elbow())
    options = read_request(Options(state_topic="/joint_states")).reading.options
    with (
        open_recording(table) as source,
        pytest.raises(RecordingError, match="a table has columns"),
    ):
        source.recording(options)


def test_parquet_says_what_is_missing_or_wrong(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = parquet(tmp_path / "log.parquet", elbow())
    assert open_table(table).headers[:3] == ("timestamp", "position[0]", "position[1]")
    texts = tmp_path / "texts.parquet"
    pq.write_table(pa.table({"t": [0.0, 0.1], **{f"q{n}": ["a", "b"] for n in range(5)}}), texts)
    assert "q0 is of type string" in refusal(texts, driver="si")
    (tmp_path / "bad.parquet").write_bytes(b"PAR1" + bytes(99) + b"PAR1")
    assert "not readable as a Parquet table" in refusal(tmp_path / "bad.parquet")
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(ConfigurationError, match=r"pyarrow is missing.*\[batch\]"):
        open_table(table)
    assert open_table(bare(tmp_path / "log.csv", elbow())).headers[0] == "t [s]"


def test_a_parquet_file_is_listed_by_its_schema_alone(tmp_path: Path) -> None:
    """And of its columns those are read that are wanted: one of another kind, and vectors of several lengths, do no harm."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    recorded = elbow()
    count = len(recorded.times_ns)
    columns: dict[str, Any] = {"timestamp": 1e-9 * (recorded.times_ns - recorded.times_ns[0])}
    columns["position"] = list(recorded.position)
    columns["image"] = [b"x" * 10_000] * count
    columns["ragged"] = [[1.0] * (1 + row % 3) for row in range(count)]
    path = tmp_path / "log.parquet"
    plain: dict[str, Any] = {"compression": "none", "use_dictionary": False}
    pq.write_table(pa.table(columns), path, row_group_size=16, **plain)
    whole = path.read_bytes()
    table = open_table(path)
    assert table.headers[:2] == ("timestamp", "position[0]") and "image" in table.headers
    same_numbers = table.read(0, [1]).numbers[1]
    np.testing.assert_array_equal(same_numbers, recorded.position[:, 0])
    ragged = table.headers.index("ragged[0]")
    with pytest.raises(RecordingError, match="ragged has vectors of several lengths"):
        table.read(0, [ragged])
    # what lies between the first row and the footer is not looked at
    image = whole.index(b"x" * 1000)
    path.write_bytes(whole[:image] + b"\xff" * 500 + whole[image + 500 :])
    assert open_table(path).headers == table.headers


def test_check_says_what_each_column_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = merged(tmp_path / "push.csv", recorded_in(PUSH))
    assert main(["check", str(table)]) == 0
    said = capsys.readouterr().out
    assert "  time in s: time_s\n" in said
    assert "  position: joint1_position_rad .. gripper_left_joint_position_rad\n" in said
    assert "  command in A: joint1_command [A] .. gripper_left_joint_command [A]\n" in said
    assert main(["check", str(table), "--json"]) == 0
    columns = json.loads(capsys.readouterr().out)["bags"][0]["columns"]
    assert columns[1] == {"name": "joint1_position_rad", "read_as": "position of joint1"}


def test_a_batch_finds_tables_of_recordings_in_folders(tmp_path: Path) -> None:
    """Other tables, such as its own results, are none."""
    table = bare(tmp_path / "deep" / "log.csv", elbow())
    (tmp_path / "results.csv").write_text("name,mass_g\na,20\n")
    (tmp_path / "words.txt").write_text("what it is\n")
    (found,) = episodes_of([tmp_path])
    assert found.path == str(table) and found.index is None
    (row,) = rows_of(found, Job(options=Options()))
    assert "the motion lasts 0.6 s" in " ".join(row["reasons"])  # so it was read


def test_rows_of_a_batch_follow_from_the_columns_file(tmp_path: Path) -> None:
    table = plain_table(tmp_path / "log.csv", elbow(), position="q{n}")
    assert columns_files([table]) == ()
    job = Job(Options())
    beside = tmp_path / "columns.yaml"
    beside.write_text("position_unit: deg\n")
    (named,) = columns_files([table, tmp_path / "other.csv"])
    one = replace(job, columns_files=(named,)).fingerprint()
    beside.write_text("position_unit: rad\n")
    other = replace(job, columns_files=(named,)).fingerprint()
    assert len({job.fingerprint(), one, other}) == 3


def test_a_name_says_that_it_is_a_table(tmp_path: Path) -> None:
    for name in ("log.csv", "LOG.CSV", "log.tsv", "log.txt", "log.parquet"):
        assert isinstance(open_source(tmp_path / name), TableSource)
    (tmp_path / "bag.csv").mkdir()
    assert not isinstance(open_source(tmp_path / "bag.csv"), TableSource)
    with pytest.raises(ProprioError, match=r"\.csv, \.parquet"):
        read(ROOT / "README.md")


def test_a_recording_and_its_export_are_not_two(tmp_path: Path) -> None:
    """The bag is answered; of the table beside it is said what it was taken for. Another name is another recording."""
    recorded = elbow()
    record = JointRecord(recorded.times_ns, recorded.joints, recorded.position)
    write_recording(tmp_path / "run1", Recording("run1", record, None))
    for name in ("run1.csv", "run1.5.csv", "log.csv"):
        bare(tmp_path / name, elbow())
    parquet(tmp_path / "log.parquet", elbow())
    found = {episode.name: episode.problem for episode in episodes_of([tmp_path])}
    said = {name: problem.partition(" beside")[0] for name, problem in found.items() if problem}
    assert said == {"run1.csv": "is called as run1", "log.parquet": "is called as log.csv"}
    assert set(found) == {"run1", "run1.csv", "run1.5.csv", "log.csv", "log.parquet"}
    (alone,) = episodes_of([tmp_path / "run1.csv"])
    assert not alone.problem, "who names it, means it"


@pytest.mark.parametrize(
    ("header", "listed"),
    [
        ("t [s],joint1 [rad],joint2 [rad]", True),
        ("t [s],axis1,axis2,note", True),
        ("t [s],shoulder,elbow,shoulder_effort,elbow_effort", True),
        ("t [s],price,volume", False),
        ("joint1,joint2", False),
    ],
)
def test_tables_of_bare_joints_are_listed(tmp_path: Path, header: str, listed: bool) -> None:
    path = tmp_path / "log.csv"
    cells = ",".join("0.5" for _ in header.split(","))
    path.write_text(f"{header}\n{cells}\n{cells}\n")
    assert is_recorded_table(path) is listed


def test_tables_whose_headers_say_different_units_are_weighed_together(tmp_path: Path) -> None:
    """Each is read by its own headers: the loaded one in Nm, the empty one in A."""
    nominal = load_robot("open_manipulator_x").drive_trains["joint3"].nominal_torque_constant
    for name, bag in (("loaded", PUSH), ("empty", EMPTY[0])):
        recorded = recorded_in(bag)
        efforts = {"Nm": recorded.effort, "A": recorded.effort / nominal}
        for unit, effort in efforts.items():
            headers = ["t [s]", *(f"q_{j} [rad]" for j in JOINTS), *(f"effort_{j} [{unit}]" for j in JOINTS)]  # fmt: skip
            since_s = 1e-9 * (recorded.times_ns - recorded.times_ns[0])
            rows = np.column_stack([since_s, recorded.position, effort])
            lines = [",".join(headers), *(",".join(map(repr, row)) for row in rows.tolist())]
            (tmp_path / f"{name}_{unit}.csv").write_text("\n".join(lines) + "\n")
    learnt = tmp_path / "arm.yaml"
    assert main(["calibrate", *map(str, EMPTY), "--output", str(learnt)]) == 0
    masses = []
    for unit in ("Nm", "A"):
        asked = Options(
            calibration=str(learnt),
            settings={"payload.com": [0.0, 0.0, 0.0]},
            baseline=[tmp_path / f"empty_{unit}.csv"],
        )
        masses.append(replay([tmp_path / "loaded_Nm.csv"], asked).values[0].value)
    assert masses[0] == pytest.approx(masses[1], rel=1e-4)


def test_rounded_times_from_the_first_row_on_are_kept(tmp_path: Path) -> None:
    """The first ones are 0 and are as many as the others are alike; they were taken for times of before a clock was set."""
    recorded = elbow(400)
    since_s = 1e-9 * (recorded.times_ns - recorded.times_ns[0])
    headers = ["t [s]", *(f"q_{joint} [rad]" for joint in JOINTS)]
    table = written(
        tmp_path / "log.csv",
        headers,
        [[f"{time_s:.1f}" for time_s in since_s], *recorded.position.T],
    )
    robot = read_request(Options(robot="open_manipulator_x")).reading
    with open_recording(table) as source:
        found = source.recording(replace(robot.options, states_only=True))
    assert len(found.joints.times_ns) == len(since_s)
    kept_s = 1e-9 * (found.joints.times_ns - found.joints.times_ns[0])
    np.testing.assert_allclose(kept_s, since_s, atol=0.05)
    assert not any("clock was set" in note for note in found.notes)
