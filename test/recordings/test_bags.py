"""Bags of every make become the same arrays, or one clear line."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from proprio_ros.errors import ConfigurationError, ProprioError, RecordingError
from proprio_ros.recordings.contents import parts_of
from proprio_ros.recordings.runs import cut_runs
from proprio_ros.recordings.signals import read_recording, without_jumps
from proprio_ros.recordings.text import is_text_recording, read_text_recording
from proprio_ros.recordings.writer import write_recording
from proprio_ros.records import MEASURED_EFFORT, InputRecord, JointRecord, Recording

TYPES = get_typestore(Stores.ROS2_JAZZY)
JOINT_STATE = "sensor_msgs/msg/JointState"
FLOATS = "std_msgs/msg/Float64MultiArray"
JOINTS = ("joint1", "joint2", "joint3", "joint4", "gripper_left_joint")
CONSTANTS = dict.fromkeys(JOINTS, 1.783)
ONSET_NS = 1_760_000_010_000_000_000
CYCLE_NS = 25_000_000
STORAGES = ("mcap", "sqlite3")
BAGS = Path(__file__).parents[2] / "bags"


class Message(NamedTuple):
    time_ns: int
    topic: str
    msgtype: str
    content: Any


def state(
    time_ns: int,
    position: Sequence[float],
    names: Sequence[str] = JOINTS,
    velocity: Sequence[float] = (),
    effort: Sequence[float] = (),
    topic: str = "/joint_states",
    stamp_ns: int | None = None,
) -> Message:
    time, header, joint_state = (
        TYPES.types[name] for name in ("builtin_interfaces/msg/Time", "std_msgs/msg/Header", JOINT_STATE)
    )
    seconds, nanoseconds = divmod(time_ns if stamp_ns is None else stamp_ns, 10**9)
    content = joint_state(
        header=header(stamp=time(sec=seconds, nanosec=nanoseconds), frame_id=""),
        name=list(names),
        position=np.array(position, dtype=np.float64),
        velocity=np.array(velocity, dtype=np.float64),
        effort=np.array(effort, dtype=np.float64),
    )
    return Message(time_ns, topic, JOINT_STATE, content)


def command(
    time_ns: int,
    current: Sequence[float],
    labels: Sequence[str] = (),
    topic: str = "/current_command",
    msgtype: str = FLOATS,
) -> Message:
    dimension, layout = (TYPES.types[f"std_msgs/msg/{name}"] for name in ("MultiArrayDimension", "MultiArrayLayout"))
    dtype = np.float32 if "32" in msgtype else np.float64
    content = TYPES.types[msgtype](
        layout=layout(dim=[dimension(label=label, size=1, stride=1) for label in labels], data_offset=0),
        data=np.array(current, dtype=dtype),
    )
    return Message(time_ns, topic, msgtype, content)


def write_bag(path: Path, messages: Sequence[Message], storage: str = "mcap") -> Path:
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        connections: dict[tuple[str, str], Any] = {}
        for message in messages:
            key = (message.topic, message.msgtype)
            if key not in connections:
                connections[key] = writer.add_connection(*key, typestore=TYPES)
            raw = TYPES.serialize_cdr(message.content, message.msgtype)
            writer.write(connections[key], message.time_ns, raw)
    return path


def times(count: int = 41) -> list[int]:
    return [ONSET_NS + (row - 10) * CYCLE_NS for row in range(count)]


def elbow(time_ns: int) -> float:
    """A smooth motion in which no two samples are alike."""
    return 0.6 - max(time_ns - ONSET_NS, 0) * 1e-9


def positions(time_ns: int) -> list[float]:
    return [0.0, -1.4, elbow(time_ns), 0.1, 0.01]


def currents(time_ns: int, value: float = -0.3) -> list[float]:
    return [0.0, 0.0, value if 0 <= time_ns - ONSET_NS < 600_000_000 else 0.0, 0.0, 0.0]


def states(**changes: Any) -> list[Message]:
    return [state(time_ns, positions(time_ns), **changes) for time_ns in times()]


def commands(**changes: Any) -> list[Message]:
    return [command(time_ns, currents(time_ns), **changes) for time_ns in times()]


def read(path: Path, **options: Any) -> Recording:
    return read_recording(path, **({"nominal_torque_constants": CONSTANTS, "joint_order": JOINTS} | options))


@contextmanager
def refused(pattern: str, error: type[ProprioError] = RecordingError) -> Iterator[None]:
    """One line that matches."""
    with pytest.raises(error) as caught:
        yield
    assert "\n" not in str(caught.value)
    assert re.search(pattern, str(caught.value)), str(caught.value)


def notes(recording: Recording) -> str:
    return " ".join(recording.notes)


# --- reading what is in order ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("storage", STORAGES)
def test_a_plain_bag_needs_no_repair(tmp_path: Path, storage: str) -> None:
    recording = read(write_bag(tmp_path / "bag", states() + commands(), storage))
    assert recording.name == "bag"
    assert recording.notes == ()
    assert recording.joints.names == JOINTS
    assert recording.joints.times_ns.tolist() == times()
    assert recording.joints.position.tolist() == [positions(time_ns) for time_ns in times()]
    assert recording.joints.velocity is None
    assert recording.joints.effort is None
    assert recording.inputs is not None
    assert recording.inputs.source == "/current_command"
    assert recording.inputs.current_A.tolist() == [currents(time_ns) for time_ns in times()]


@pytest.mark.parametrize("storage", STORAGES)
def test_folder_file_and_folder_without_metadata_give_the_same(tmp_path: Path, storage: str) -> None:
    folder = write_bag(tmp_path / "bag", states() + commands(), storage)
    whole = read(folder)
    (file,) = (path for path in folder.iterdir() if path.suffix in (".mcap", ".db3"))
    (folder / "metadata.yaml").unlink()
    for path in (file, folder):
        again = read(path)
        assert np.array_equal(again.joints.position, whole.joints.position)
        assert again.inputs is not None and whole.inputs is not None
        assert np.array_equal(again.inputs.current_A, whole.inputs.current_A)


def test_storage_files_without_metadata_are_read_as_one_bag(tmp_path: Path) -> None:
    folder = tmp_path / "bag"
    folder.mkdir()
    messages = states() + commands()
    for part, half in enumerate((messages[1::2], messages[::2])):
        bag = write_bag(tmp_path / f"part{part}", half)
        shutil.copy(bag / f"part{part}.mcap", folder)
    recording = read(folder)
    assert recording.joints.times_ns.tolist() == times()
    assert recording.notes == ("There is no metadata.yaml; 2 storage files were read as one bag.",)


@pytest.mark.parametrize("storage", [*STORAGES, "two files"])
def test_parts_cover_a_recording(tmp_path: Path, storage: str) -> None:
    """Each once, none larger than asked, whatever the files; two of one bag overlap."""
    messages = states() + commands()
    path = write_bag(tmp_path / "bag", messages, "mcap" if storage == "two files" else storage)
    if storage == "two files":
        shutil.rmtree(path)
        path.mkdir()
        for part, half in enumerate((messages[1::2], messages[::2])):
            shutil.copy(write_bag(tmp_path / f"part{part}", half) / f"part{part}.mcap", path)
    whole = read(path)
    most = len(whole.joints.times_ns) // 3
    spans = parts_of(path, most)
    assert len(spans) > 2 and all(end == begin for (_, end), (begin, _) in pairwise(spans))
    parts = [read(path, span=span, states_only=True).joints for span in spans]
    assert max(len(part.times_ns) for part in parts) <= most
    assert np.array_equal(np.concatenate([part.times_ns for part in parts]), whole.joints.times_ns)
    assert np.array_equal(np.concatenate([part.position for part in parts]), whole.joints.position)
    with refused("no joint states between 1e\\+06 s and 2e\\+06 s"):
        read(path, span=(10**15, 2 * 10**15))


@pytest.mark.parametrize("storage", STORAGES)
@settings(max_examples=15, deadline=None)
@given(data=st.data())
def test_what_is_written_is_read_back_bit_by_bit(
    tmp_path_factory: pytest.TempPathFactory, storage: str, data: st.DataObject
) -> None:
    count = data.draw(st.integers(5, 12))
    gaps = data.draw(st.lists(st.integers(1, 10**10), min_size=count, max_size=count))
    names = tuple(
        data.draw(st.lists(st.text("abcXYZ_0189", min_size=1, max_size=6), min_size=1, unique=True, max_size=4))
    )
    finite = st.floats(-49.0, 49.0, allow_subnormal=True)
    table = st.lists(st.lists(finite, min_size=len(names), max_size=len(names)), min_size=count, max_size=count)
    times_ns = ONSET_NS + np.cumsum(gaps)
    velocity = data.draw(st.none() | table)
    effort = data.draw(st.none() | table)
    joints = JointRecord(
        times_ns,
        names,
        np.array(data.draw(table)),
        None if velocity is None else np.array(velocity),
        None if effort is None else np.array(effort),
    )
    inputs = InputRecord(times_ns[::2], names, np.array(data.draw(table))[::2], "/current_command")
    path = tmp_path_factory.mktemp("round") / "trip"
    write_recording(path, Recording("trip", joints, inputs), storage)
    again = read(path, effort_unit="N.m", joint_order=names)
    assert again.name == "trip"
    assert again.joints.names == names
    for quantity in ("times_ns", "position", "velocity", "effort"):
        before, after = getattr(joints, quantity), getattr(again.joints, quantity)
        assert (before is None) == (after is None)
        assert before is None or before.tobytes() == after.tobytes()
    assert again.inputs is not None
    assert again.inputs.names == names
    assert again.inputs.source == "/current_command"
    assert again.inputs.times_ns.tobytes() == inputs.times_ns.tobytes()
    assert again.inputs.current_A.tobytes() == inputs.current_A.tobytes()


def test_writing_without_an_input_and_refusals(tmp_path: Path) -> None:
    recording = Recording("r", JointRecord(np.arange(6), ("a",), np.zeros((6, 1))), None)
    write_recording(tmp_path / "bag", recording)
    assert read(tmp_path / "bag").inputs is None
    with refused("cannot be written .*give a new folder"):
        write_recording(tmp_path / "bag", recording)
    with refused("mcap, sqlite3", ConfigurationError):
        write_recording(tmp_path / "other", recording, "bag")


# --- repairs of joint states -----------------------------------------------------------------------------------------


def test_the_order_of_joints_may_change_between_messages(tmp_path: Path) -> None:
    generator = np.random.default_rng(3)
    messages = []
    for time_ns in times():
        order = generator.permutation(5)
        messages.append(
            state(time_ns, [positions(time_ns)[column] for column in order], [JOINTS[column] for column in order])
        )
    recording = read(write_bag(tmp_path / "bag", messages + commands()))
    for name, column in zip(JOINTS, range(5), strict=True):
        values = recording.joints.position[:, recording.joints.column(name)]
        assert values.tolist() == [positions(time_ns)[column] for time_ns in times()]
    assert "order of the joints changes" in notes(recording)


def test_another_order_that_never_changes_needs_no_note(tmp_path: Path) -> None:
    messages = [state(time_ns, positions(time_ns)[::-1], JOINTS[::-1]) for time_ns in times()]
    recording = read(write_bag(tmp_path / "bag", messages + commands()))
    assert recording.notes == ()
    assert recording.joints.position[:, recording.joints.column("joint3")].tolist() == [elbow(t) for t in times()]


def test_extra_joints_are_kept_and_may_turn_far(tmp_path: Path) -> None:
    messages = [state(time_ns, [120.0, *positions(time_ns)], ["wheel", *JOINTS]) for time_ns in times()]
    recording = read(write_bag(tmp_path / "bag", messages + commands()))
    assert recording.joints.names == ("wheel", *JOINTS)
    assert recording.notes == ()


def test_two_publishers_only_samples_of_the_driven_joint_count(tmp_path: Path) -> None:
    messages = []
    for row, time_ns in enumerate(times()):
        messages.append(state(time_ns, positions(time_ns)[:4], JOINTS[:4]))
        if row % 4 == 0:
            messages.append(state(time_ns + 5_000_000, [0.01 + row * 1e-4], JOINTS[4:]))
    recording = read(write_bag(tmp_path / "bag", messages + commands()))
    assert recording.joints.times_ns.tolist() == times()
    assert "gripper_left_joint is in 11 of 52 messages" in notes(recording)
    gripper = recording.joints.position[:, recording.joints.column("gripper_left_joint")]
    # row 6 lies between the messages 5 ms after rows 4 and 8
    assert gripper[6] == pytest.approx(0.01 + 4e-4 + (2 * 25 - 5) / 100 * 4e-4, abs=1e-12)


def test_a_driven_joint_that_reports_seldom_is_not_interpolated(tmp_path: Path) -> None:
    messages = []
    for row, time_ns in enumerate(times()):
        messages.append(state(time_ns, positions(time_ns)[:2], JOINTS[:2]))
        if row % 3 == 0:
            messages.append(state(time_ns + 1_000_000, positions(time_ns)[2:], JOINTS[2:]))
    recording = read(write_bag(tmp_path / "bag", messages + commands()))
    assert recording.joints.times_ns.tolist() == [time_ns + 1_000_000 for time_ns in times()[::3]]
    driven = recording.joints.position[:, recording.joints.column("joint3")]
    assert driven.tolist() == [elbow(time_ns) for time_ns in times()[::3]]


def test_messages_that_lack_a_needed_joint_are_left_out(tmp_path: Path) -> None:
    messages = states()
    messages[7] = state(times()[7], positions(0)[:2], JOINTS[:2])
    recording = read(write_bag(tmp_path / "bag", messages + commands()))
    assert "1 of 41 messages lack some of the joints" in notes(recording)
    assert recording.joints.times_ns.tolist() == times()[:7] + times()[8:]


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_messages_with_positions_that_are_no_numbers_are_left_out(tmp_path: Path, bad: float) -> None:
    messages = states()
    for row in (3, 20, 21):
        values = positions(times()[row])
        values[2] = bad
        messages[row] = state(times()[row], values)
    recording = read(write_bag(tmp_path / "bag", messages + commands()))
    assert "3 of 41 messages have NaN or infinite positions" in notes(recording)
    assert "messages were lost: 1 gaps" in notes(recording)
    assert len(recording.joints.times_ns) == 38


def test_a_joint_that_is_never_finite_is_left_out(tmp_path: Path) -> None:
    messages = [state(time_ns, [*positions(time_ns)[:4], np.nan]) for time_ns in times()]
    recording = read(write_bag(tmp_path / "bag", messages + commands()))
    assert recording.joints.names == JOINTS[:4]
    assert "gripper_left_joint never has a finite position" in notes(recording)


def test_too_few_usable_samples(tmp_path: Path) -> None:
    messages = [state(t, positions(t) if row < 4 else [np.nan] * 5) for row, t in enumerate(times())]
    with refused("only 4 of 41 messages .* at least 5 .*NaN"):
        read(write_bag(tmp_path / "nan", messages + commands()))
    with refused("no finite position in 41 messages"):
        read(write_bag(tmp_path / "all", [state(t, [np.nan] * 5) for t in times()] + commands()))


def test_stamps_out_of_order_are_sorted(tmp_path: Path) -> None:
    messages = states()
    stamps = times()
    stamps[10], stamps[11] = stamps[11], stamps[10]
    messages = [state(t, positions(stamp), stamp_ns=stamp) for t, stamp in zip(times(), stamps, strict=True)]
    recording = read(write_bag(tmp_path / "bag", messages + commands()))
    assert "1 of 41 stamps go back in time" in notes(recording)
    assert recording.joints.times_ns.tolist() == times()
    assert recording.joints.position[:, 2].tolist() == [elbow(time_ns) for time_ns in times()]


def test_of_equal_stamps_the_first_message_is_kept(tmp_path: Path) -> None:
    messages = states()
    messages.insert(15, state(times()[14] + 1, [9.0] * 5, stamp_ns=times()[14]))
    recording = read(write_bag(tmp_path / "bag", messages + commands()))
    assert "1 of 42 stamps are repeated" in notes(recording)
    assert recording.joints.position[:, 2].tolist() == [elbow(time_ns) for time_ns in times()]


def test_lost_messages_are_reported(tmp_path: Path) -> None:
    messages = states()
    del messages[30:32], messages[12]
    recording = read(write_bag(tmp_path / "bag", messages + commands()))
    assert notes(recording) == (
        "/joint_states: messages were lost: 1 gaps of more than 2.5 periods (25.0 ms), the longest 75 ms."
    )


def test_without_header_stamps_the_time_of_recording_is_used(tmp_path: Path) -> None:
    messages = [state(time_ns, positions(time_ns), stamp_ns=0) for time_ns in times()]
    recording = read(write_bag(tmp_path / "bag", messages + commands()))
    assert "41 of 41 messages have no header stamp" in notes(recording)
    assert recording.joints.times_ns.tolist() == times()


def test_another_clock_in_the_headers_moves_unstamped_messages_and_commands(tmp_path: Path) -> None:
    simulated = 3_000_000_001
    offset = simulated - ONSET_NS
    messages = [
        state(time_ns, positions(time_ns), stamp_ns=0 if row == 5 else time_ns + offset)
        for row, time_ns in enumerate(times())
    ]
    recording = read(write_bag(tmp_path / "bag", messages + commands()))
    assert recording.joints.times_ns.tolist() == [time_ns + offset for time_ns in times()]
    assert recording.inputs is not None
    assert recording.inputs.times_ns.tolist() == [time_ns + offset for time_ns in times()]
    assert "1 of 41 messages have no header stamp" in notes(recording)
    assert "another clock" in notes(recording)


def test_velocity_may_be_missing_in_some_messages(tmp_path: Path) -> None:
    messages = [state(t, positions(t), velocity=[1.0] * 5 if row % 2 else ()) for row, t in enumerate(times())]
    velocity = read(write_bag(tmp_path / "bag", messages + commands())).joints.velocity
    assert velocity is not None
    assert np.isnan(velocity[::2]).all()
    assert (velocity[1::2] == 1.0).all()


@pytest.mark.parametrize(
    ("changes", "pattern"),
    [
        ({"position": [0.0] * 4}, "5 names but 4 values of position in message 42"),
        ({"position": []}, "5 names but 0 values of position"),
        ({"velocity": [0.0] * 3}, "5 names but 3 values of velocity"),
        ({"effort": [0.0] * 6}, "5 names but 6 values of effort"),
        ({"names": ["joint1"] * 5}, "names a joint twice in message 42"),
    ],
)
def test_lengths_that_do_not_fit(tmp_path: Path, changes: dict[str, Any], pattern: str) -> None:
    values: dict[str, Any] = {"time_ns": times()[-1] + CYCLE_NS, "position": [0.0] * 5}
    last = state(**(values | changes))
    with refused(pattern):
        read(write_bag(tmp_path / "bag", [*states(), last, *commands()]))


@pytest.mark.parametrize("scale", [180.0 / np.pi, 4096 / (2.0 * np.pi)], ids=["degrees", "counts"])
def test_positions_that_are_no_radians(tmp_path: Path, scale: float) -> None:
    messages = [state(time_ns, [scale * q for q in positions(time_ns)]) for time_ns in times()]
    with refused("joint2 stands at -[0-9.]+, .*degrees, millimetres or encoder counts"):
        read(write_bag(tmp_path / "bag", messages + commands()))


@pytest.mark.parametrize("where", ["position", "velocity", "effort"])
def test_numbers_of_unwritten_memory_are_left_out_and_counted(tmp_path: Path, where: str) -> None:
    messages = [state(time_ns, positions(time_ns), velocity=[0.0] * 5, effort=[0.1] * 5) for time_ns in times(100)]
    expected = read(write_bag(tmp_path / "clean", messages + commands()))
    for row in (20, 21, 60):
        getattr(messages[row].content, where)[1] = -1.1e282
    recording = read(write_bag(tmp_path / "bag", messages + commands()))
    assert len(recording.joints.times_ns) == len(expected.joints.times_ns) - 3
    assert np.isin(recording.joints.times_ns, expected.joints.times_ns).all()
    assert np.abs(recording.joints.position).max() < 2.0
    assert any("3 of 100 messages hold numbers that no joint can have" in note for note in recording.notes)


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_a_few_samples_elsewhere_are_damage_and_more_are_a_slipped_encoder(tmp_path: Path, count: int) -> None:
    messages = [state(time_ns, positions(time_ns)) for time_ns in times(100)]
    for row in range(50, 50 + count):
        messages[row].content.position[2] += 1.0
    recording = read(write_bag(tmp_path / "bag", messages + commands()))
    left = without_jumps(recording, JOINTS)
    assert len(left.joints.times_ns) == 100 - (count if count < 4 else 0)
    assert any("there and back" in note for note in left.notes) == (count < 4)


# --- the input -------------------------------------------------------------------------------------------------------


def test_applied_effort_comes_before_commands_and_they_before_measured_effort(tmp_path: Path) -> None:
    measured = states(effort=[0.5] * 5)
    applied = [
        state(t, [], effort=[1.783 * i for i in currents(t, -0.2)][::-1], names=JOINTS[::-1], topic="/applied_effort")
        for t in times()
    ]
    all_three = read(write_bag(tmp_path / "all", measured + commands() + applied))
    assert all_three.inputs is not None
    assert all_three.inputs.source == "/applied_effort"
    assert all_three.inputs.current_A[:, all_three.inputs.column("joint3")] == pytest.approx(
        [currents(t, -0.2)[2] for t in times()], abs=1e-15
    )
    two = read(write_bag(tmp_path / "two", measured + commands()))
    assert two.inputs is not None
    assert two.inputs.source == "/current_command"
    one = read(write_bag(tmp_path / "one", measured), effort_unit="A")
    assert one.inputs is not None
    assert one.inputs.source == MEASURED_EFFORT
    assert (one.inputs.current_A == 0.5).all()


@pytest.mark.parametrize(
    ("unit", "current", "effort"),
    [("N.m", 0.8 / 1.783, 0.8), ("A", 0.8, None), ("mA", 0.8e-3, None), ("raw", 0.8 * 0.00269, None)],
)
def test_units_of_measured_effort(tmp_path: Path, unit: str, current: float, effort: float | None) -> None:
    recording = read(write_bag(tmp_path / "bag", states(effort=[0.8] * 5)), effort_unit=unit)
    assert recording.joints.current is not None
    assert recording.joints.current == pytest.approx(np.full((41, 5), current), rel=1e-15)
    assert recording.inputs is not None
    assert np.array_equal(recording.inputs.current_A, recording.joints.current)
    if effort is None:
        assert recording.joints.effort is None
    else:
        assert recording.joints.effort is not None
        assert (recording.joints.effort == effort).all()


def test_the_meaning_of_effort_is_never_guessed(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag", states(effort=[100.0] * 5))
    with refused(r"--effort-unit N\.m\|A\|mA\|raw"):
        read(path)
    with refused(r"'counts' is not known; choose from N\.m, A, mA, raw", ConfigurationError):
        read(path, effort_unit="counts")
    assert read(path, effort_unit="raw", current_per_count_A=0.001).inputs.current_A[0, 0] == 0.1  # type: ignore[union-attr]
    with refused("torque constant for none of joint1"):
        read(path, effort_unit="N.m", nominal_torque_constants={})


def test_the_meaning_of_effort_is_not_asked_where_a_command_gives_the_input(tmp_path: Path) -> None:
    recording = read(write_bag(tmp_path / "bag", states(effort=[100.0] * 5) + commands()))
    assert recording.joints.effort is None
    assert recording.joints.current is None


def test_joints_without_torque_constant(tmp_path: Path) -> None:
    some = {"joint3": 2.0}
    measured = read(
        write_bag(tmp_path / "measured", states(effort=[0.8] * 5)), effort_unit="N.m", nominal_torque_constants=some
    )
    assert measured.inputs is not None
    assert measured.inputs.names == ("joint3",)
    assert measured.inputs.current_A[0, 0] == 0.4
    applied = [state(t, [], effort=[0.0, 0.0, 0.6, 0.0, 0.0], topic="/applied_effort") for t in times()]
    recording = read(write_bag(tmp_path / "applied", states() + applied), nominal_torque_constants=some)
    assert recording.inputs is not None
    assert recording.inputs.current_A[0].tolist() == [0.0, 0.0, 0.3, 0.0, 0.0]
    with refused("effort on joint3, whose nominal torque constant is not known; .* joint2"):
        read(tmp_path / "applied", nominal_torque_constants={"joint2": 1.0})


def test_positions_alone_have_no_input(tmp_path: Path) -> None:
    assert read(write_bag(tmp_path / "bag", states())).inputs is None


@pytest.mark.parametrize(
    "labels", [("joint3", "joint1"), ("joint3,joint1",), (" joint3 , joint1 ",)], ids=["dims", "joined", "blanks"]
)
def test_labels_name_the_columns(tmp_path: Path, labels: tuple[str, ...]) -> None:
    messages = [command(time_ns, [currents(time_ns)[2], 0.0], labels) for time_ns in times()]
    inputs = read(write_bag(tmp_path / "bag", states() + messages)).inputs
    assert inputs is not None
    assert inputs.names == ("joint3", "joint1")
    assert inputs.current_A[:, 0].tolist() == [currents(time_ns)[2] for time_ns in times()]


@pytest.mark.parametrize("labels", [("currents",), ("height", "width")])
def test_labels_that_describe_the_dimensions_name_no_column(tmp_path: Path, labels: tuple[str, ...]) -> None:
    inputs = read(write_bag(tmp_path / "bag", states() + commands(labels=labels))).inputs
    assert inputs is not None
    assert inputs.names == JOINTS


@pytest.mark.parametrize("labels", [("joint3,joint1,joint2",), ("joint3", "joint3"), ("joint3", "")])
def test_labels_that_do_not_fit(tmp_path: Path, labels: tuple[str, ...]) -> None:
    with refused("has 2 values but is labelled .*must name every joint once"):
        read(write_bag(tmp_path / "bag", [*states(), command(ONSET_NS, [0.3, 0.0], labels)]))


@pytest.mark.parametrize("length", [1, 4, 6])
def test_an_unlabelled_command_of_the_wrong_length(tmp_path: Path, length: int) -> None:
    with refused(f"has {length} values but the robot has 5 joints .*joint4, gripper_left_joint.*label"):
        read(write_bag(tmp_path / "bag", [*states(), command(ONSET_NS, [0.3] * length)]))


@pytest.mark.parametrize("labels", [(), ("",)], ids=["unlabelled", "as the excitation node labels it"])
def test_a_command_without_numbers_ends_the_push(tmp_path: Path, labels: tuple[str, ...]) -> None:
    """So the excitation node ends each push; joints that a command does not name are held, as by the driver."""
    first, second, end = ONSET_NS, ONSET_NS + 5 * CYCLE_NS, ONSET_NS + 20 * CYCLE_NS
    messages = [
        *states(),
        command(first, [-0.3], ["joint3"]),
        command(second, [0.2], ["joint4"]),
        command(end, [], labels),
    ]
    inputs = read(write_bag(tmp_path / "bag", messages), command_topic="/current_command").inputs
    assert inputs is not None and inputs.times_ns.tolist() == [first, second, end]
    assert inputs.names == ("joint3", "joint4") and inputs.current_A.tolist() == [[-0.3, 0.0], [0.0, 0.2], [0.0, 0.0]]
    run = cut_runs(read(write_bag(tmp_path / "run", [*states(), messages[-3], messages[-1]])), joints=JOINTS)[0]
    assert run.duration_s == pytest.approx(1e-9 * (end - first)) and run.joint == "joint3"


def test_commands_that_never_push(tmp_path: Path) -> None:
    with refused("no joint was driven: /current_command is zero throughout"):
        cut_runs(read(write_bag(tmp_path / "bag", [*states(), command(ONSET_NS, [])])), joints=JOINTS)


def test_an_unlabelled_command_may_cover_just_the_recorded_joints(tmp_path: Path) -> None:
    messages = [state(t, positions(t)[:4], JOINTS[:4]) for t in times()]
    messages += [command(t, currents(t)[:4]) for t in times()]
    recording = read(write_bag(tmp_path / "bag", messages))
    assert recording.inputs is not None
    assert recording.inputs.names == JOINTS[:4]
    assert "read as the recorded joints joint1, joint2, joint3, joint4" in notes(recording)


def test_commands_that_are_no_numbers_or_repeat_a_stamp(tmp_path: Path) -> None:
    messages = commands()
    messages[12] = command(times()[12], [0.0, 0.0, np.nan, 0.0, 0.0])
    messages.insert(20, command(times()[19], currents(times()[19], -0.1)))
    recording = read(write_bag(tmp_path / "bag", states() + messages))
    assert recording.inputs is not None
    assert "1 of 42 messages have NaN or infinite values; the last finite one was held" in notes(recording)
    assert "1 of 42 stamps are repeated; the last message" in notes(recording)
    expected = [currents(t) for t in times()]
    expected[19] = currents(times()[19], -0.1)
    assert recording.inputs.current_A.tolist() == expected


# --- topics ----------------------------------------------------------------------------------------------------------


def test_topics_under_a_namespace(tmp_path: Path) -> None:
    messages = states(topic="/arm/joint_states") + commands(topic="/arm/current_command")
    recording = read(write_bag(tmp_path / "bag", messages))
    assert recording.inputs is not None
    assert recording.inputs.source == "/arm/current_command"


def test_each_arm_has_its_own_input(tmp_path: Path) -> None:
    messages = []
    for arm in ("/left", "/right"):
        messages += states(topic=f"{arm}/joint_states") + commands(topic=f"{arm}/current_command")
    path = write_bag(tmp_path / "bag", messages)
    with refused("choose with --state-topic from: /left/joint_states .*, /right/joint_states"):
        read(path)
    recording = read(path, state_topic="/right/joint_states")
    assert recording.inputs is not None
    assert recording.inputs.source == "/right/current_command"
    recording = read(path, state_topic="left/joint_states", command_topic="right/current_command")
    assert recording.inputs is not None
    assert recording.inputs.source == "/right/current_command"


def test_the_only_joint_state_topic_is_taken_whatever_its_name(tmp_path: Path) -> None:
    applied = [state(t, [], effort=[1.783 * i for i in currents(t)], topic="/applied_effort") for t in times()]
    recording = read(write_bag(tmp_path / "bag", states(topic="/feedback") + applied))
    assert recording.inputs is not None
    assert recording.inputs.source == "/applied_effort"


def test_the_other_joint_states_are_the_command_that_the_user_names(tmp_path: Path) -> None:
    desired = [state(t, [], effort=[1.783 * i for i in currents(t)], topic="/desired") for t in times()]
    path = write_bag(tmp_path / "bag", states(topic="/feedback") + desired)
    with refused("choose with --state-topic from: /desired .*, /feedback"):
        read(path)
    recording = read(path, command_topic="/desired")
    assert recording.inputs is not None
    assert recording.inputs.source == "/desired"
    assert recording.joints.position[-1].tolist() == positions(times()[-1])


def test_several_inputs_are_not_chosen_from(tmp_path: Path) -> None:
    messages = states() + commands(topic="/a/current_command") + commands(topic="/b/current_command")
    path = write_bag(tmp_path / "bag", messages)
    with refused("choose with --command-topic from: /a/current_command .*/b/current_command"):
        read(path)


@pytest.mark.parametrize("msgtype", [FLOATS, "std_msgs/msg/Float32MultiArray"])
def test_a_named_command_topic(tmp_path: Path, msgtype: str) -> None:
    messages = states() + commands(topic="/effort_controller/commands", msgtype=msgtype)
    path = write_bag(tmp_path / "bag", messages)
    assert read(path).inputs is None
    inputs = read(path, command_topic="/effort_controller/commands").inputs
    assert inputs is not None
    assert inputs.current_A[15, 2] == pytest.approx(-0.3, rel=1e-7)


def test_joint_states_named_as_command_are_measured_effort(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag", states(effort=[0.8] * 5) + commands())
    with refused("--effort-unit"):
        read(path, command_topic="/joint_states")
    inputs = read(path, command_topic="/joint_states", effort_unit="A").inputs
    assert inputs is not None
    assert inputs.measured


@pytest.mark.parametrize(
    ("options", "pattern"),
    [
        ({"state_topic": "/nope"}, r"--state-topic /nope is not in the bag; choose from: /joint_states"),
        ({"state_topic": "/current_command"}, "is std_msgs/msg/Float64MultiArray; choose from: /joint_states"),
        ({"command_topic": "/nope"}, r"--command-topic /nope is not in the bag; .*/current_command"),
    ],
)
def test_a_named_topic_that_does_not_fit(tmp_path: Path, options: dict[str, str], pattern: str) -> None:
    with refused(pattern):
        read(write_bag(tmp_path / "bag", states() + commands()), **options)


@pytest.mark.parametrize("storage", STORAGES)
def test_types_that_nobody_knows_are_skipped(tmp_path: Path, storage: str) -> None:
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    with Writer(tmp_path / "bag", version=9, storage_plugin=plugin) as writer:
        odd = writer.add_connection("/odd", "odd_msgs/msg/Odd", msgdef="nonsense $$ x", rihs01="RIHS01_0")
        writer.write(odd, ONSET_NS, b"not even CDR")
        for message in states()[:20]:
            if message.time_ns == times()[0]:
                connection = writer.add_connection(message.topic, message.msgtype, typestore=TYPES)
            # rclpy's serialize_message leaves 8 stray bytes behind empty arrays
            raw = bytes(TYPES.serialize_cdr(message.content, message.msgtype)) + bytes(8)
            writer.write(connection, message.time_ns, raw)
    recording = read(tmp_path / "bag")
    assert recording.joints.position.tolist() == [positions(time_ns) for time_ns in times()[:20]]


# --- what cannot be read ---------------------------------------------------------------------------------------------


def test_no_messages_and_no_joint_states(tmp_path: Path) -> None:
    with refused("holds no messages"):
        read(write_bag(tmp_path / "empty", []))
    with refused(r"no JointState topic in the bag; it holds: /current_command \(std_msgs/Float64MultiArray\)"):
        read(write_bag(tmp_path / "commands", commands()))
    with Writer(tmp_path / "silent", version=9) as writer:
        writer.add_connection("/joint_states", JOINT_STATE, typestore=TYPES)
        writer.write(writer.add_connection("/x", FLOATS, typestore=TYPES), 1, b"\0\1\0\0")
    with refused("/joint_states .*holds no messages"):
        read(tmp_path / "silent")
    with refused("--state-topic /joint_states holds no messages"):
        read(tmp_path / "silent", state_topic="/joint_states")


def test_paths_that_are_no_bag(tmp_path: Path) -> None:
    with refused("no such bag"):
        read(tmp_path / "missing")
    for name, pattern in (("notes.txt", "not a bag"), ("old.bag", "ROS 1 bag; convert it with `rosbags-convert`")):
        (tmp_path / name).write_text("hello")
        with refused(pattern):
            read(tmp_path / name)
    (tmp_path / "folder").mkdir()
    with refused("not a bag: no metadata.yaml"):
        read(tmp_path / "folder")
    write_bag(tmp_path / "outer" / "bag_mcap", states())
    with refused("did you mean one of the bags in it: bag_mcap"):
        read(tmp_path / "outer")
    (tmp_path / "meta").mkdir()
    (tmp_path / "meta" / "metadata.yaml").write_text("rosbag2_bagfile_information: [1")
    with refused("not readable as a ROS 2 bag"):
        read(tmp_path / "meta")


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("bare", [False, True], ids=["folder", "file"])
def test_a_truncated_file_is_one_line_wherever_it_is_cut(tmp_path: Path, storage: str, bare: bool) -> None:
    folder = write_bag(tmp_path / "bag", states() + commands(), storage)
    (file,) = (path for path in folder.iterdir() if path.suffix in (".mcap", ".db3"))
    whole = file.read_bytes()
    for part in np.linspace(0.0, 0.99, 12):
        file.write_bytes(whole[: int(part * len(whole))])
        with refused("not readable as a ROS 2 bag|holds no messages"):
            read(file if bare else folder)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(data=st.data())
def test_flipped_bytes_are_read_or_refused_and_never_crash(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    source = BAGS / "friction_s00_fixed_heavy_ball_50g_joint3" / data.draw(st.sampled_from(["bag_mcap", "bag_sqlite3"]))
    folder = tmp_path_factory.mktemp("flipped") / "bag"
    shutil.copytree(source, folder)
    file = data.draw(st.sampled_from(sorted(folder.iterdir())))
    content = bytearray(file.read_bytes())
    for place in data.draw(st.lists(st.integers(0, len(content) - 1), min_size=1, max_size=20)):
        content[place] = data.draw(st.integers(0, 255))
    file.write_bytes(content)
    try:
        read(folder)
    except RecordingError as error:
        assert "\n" not in str(error)


@settings(max_examples=20, deadline=None)
@given(places=st.lists(st.floats(0.0, 1.0), min_size=1, max_size=8))
def test_a_bag_of_ours_that_was_damaged_is_refused(
    tmp_path_factory: pytest.TempPathFactory, places: list[float]
) -> None:
    """Bits of the messages, wherever they are: MCAP has a checksum, and what we write carries it."""
    folder = tmp_path_factory.mktemp("ours") / "bag"
    write_recording(folder, read(BAGS / "realistic_s00_fixed_heavy_cube_23g_joint3" / "bag_mcap"))
    (file,) = folder.glob("*.mcap")
    content = bytearray(file.read_bytes())
    end = content.rindex(b"serialized_metadata")  # behind the only chunk and its indices
    begin = content.index(b"sensor_msgs/msg/JointState")
    message = content.index(b"joint1\x00", begin)
    last = content[:end].rindex(b"joint4\x00")
    read(folder)
    for place in {message + int(share * (last - message)) for share in places}:
        content[place] ^= 1 << 4
    file.write_bytes(content)
    with refused("checksum"):
        read(folder)


def test_a_bag_that_holds_less_than_its_metadata_promises(tmp_path: Path) -> None:
    folder = write_bag(tmp_path / "bag", states() + commands())
    metadata = folder / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("message_count: 41", "message_count: 50"))
    assert "/joint_states: the bag promises 50 messages but holds 41." in read(folder).notes
    metadata.write_text(metadata.read_text().replace("name: /current_command", "name: /applied/current_command"))
    with refused("/applied/current_command should hold 50 messages but holds none"):
        read(folder)


def test_a_write_ahead_log_that_was_not_merged_is_reported(tmp_path: Path) -> None:
    folder = write_bag(tmp_path / "bag", states() + commands(), "sqlite3")
    (folder / "bag.db3-wal").write_bytes(b"pages")
    assert "bag.db3-wal may hold messages" in notes(read(folder))
    assert "bag.db3-wal may hold messages" in notes(read(folder / "bag.db3"))


def test_another_serialisation_is_refused(tmp_path: Path) -> None:
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/joint_states", JOINT_STATE, typestore=TYPES, serialization_format="json")
        writer.write(connection, ONSET_NS, b"{}")
    with refused("only 'cdr' can be read"):
        read(tmp_path / "bag")
    with refused("/joint_states is serialised as 'json'; only 'cdr' can be read"):
        read(tmp_path / "bag" / "bag.mcap")


@pytest.mark.parametrize(
    ("folder", "pattern"),
    [
        ("sqlite_empty", "holds no messages"),
        ("sqlite_wrong_rmw", "only 'cdr' can be read"),
        ("mcap_wrong_rmw", "only 'cdr' can be read"),
        ("sqlite_cdr", "no JointState topic in the bag; it holds: /array_topic"),
        ("mcap_cdr", "no JointState topic in the bag; it holds: /array_topic"),
        ("mcap_service_events", "no JointState topic"),
        ("sqlite_split5", r"no JointState topic.*AAA \(std_msgs/String\)"),
        ("mcap_split5", r"no JointState topic.*AAA \(std_msgs/String\)"),
        ("mcap_no_metadata_3files", r"no JointState topic.*/chatter"),
        ("sqlite_talker", "no JointState topic.*/topic"),
    ],
)
def test_bags_of_rosbag2s_own_tests(shared: Path, folder: str, pattern: str) -> None:
    path = shared / "recordings_real" / "edge_bags" / folder
    if not path.exists():
        pytest.skip("the odd bags are not here")
    with refused(pattern):
        read(path)


def test_real_recordings(shared: Path) -> None:
    real = shared / "recordings_real"
    if not real.exists():
        pytest.skip("the real recordings are not here")
    arm = read(real / "omx_empty_1", effort_unit="raw")
    assert arm.joints.position.shape == (2000, 4)
    assert arm.inputs is not None and arm.joints.current is not None
    assert arm.inputs.names == JOINTS[:4]
    # its README: the measured current follows one cycle later at 0.98-0.99 of the command
    gain = np.linalg.lstsq(arm.inputs.current_A[:-1, 1:2], arm.joints.current[1:, 1], rcond=None)[0][0]
    assert 0.97 < gain < 1.0
    pendulum = read(real / "sts3215_release_0.535kg")
    assert pendulum.inputs is None
    assert pendulum.joints.effort is None


# --- plain text ------------------------------------------------------------------------------------------------------


def test_the_papers_recording(recordings: Path) -> None:
    path = recordings / "paper_heavy_ball"
    assert is_text_recording(path)
    recording = read_text_recording(path)
    assert (recording.name, recording.joint) == ("paper_heavy_ball", "joint3")
    t = recording.times_s
    # its README: the samples are this cubic
    assert recording.relative_position == pytest.approx(1.41992 * t**3 - 1.04018 * t**2 - 1.62633 * t, abs=2e-5)
    assert recording.setting["torque_N_m"] == -0.49


SETTING = {"moving_joint": "joint3", "torque_N_m": -0.49, "start_pose_rad": {"joint2": 0.0, "joint3": 0.4}}
TABLE = "time_s,joint3_relative_rad\n" + "".join(f"{row / 60},{-row / 50}\n" for row in range(6))


def write_text_recording(path: Path, setting: Any = SETTING, table: str = TABLE) -> Path:
    path.mkdir()
    (path / "setting.json").write_text(setting if isinstance(setting, str) else json.dumps(setting))
    (path / "trajectory.csv").write_text(table)
    return path


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
        (SETTING | {"start_pose_rad": {"joint3": "up"}}, r"start_pose_rad\.joint3 must be a number, got 'up'"),
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
        (lambda table: table.replace("joint3", "joint2"), "the header must be time_s,joint3_relative_rad, got"),
        (lambda table: table + "0.2,abc\n", "not a table of numbers"),
        (lambda table: table + "0.2\n", "not a table of numbers"),
        (lambda table: table + "0.2,nan\n", "finite numbers"),
        (lambda table: table + "0.01,0.0\n", "must increase"),
        (lambda table: "\n".join(table.split("\n")[:4]), "at least 5 rows"),
        (lambda table: "", "not a table of numbers"),
    ],
)
def test_tables_that_are_refused(tmp_path: Path, change: Callable[[str], str], pattern: str) -> None:
    with refused(pattern):
        read_text_recording(write_text_recording(tmp_path / "text", table=change(TABLE)))


def test_message_definitions_are_jazzys() -> None:
    """The few definitions kept here hash to the same type as the distribution's own."""
    from proprio_ros.recordings import messages

    jazzy = get_typestore(Stores.ROS2_JAZZY)
    for name in messages._DEFINITIONS:
        assert messages.message_types().hash_rihs01(name) == jazzy.hash_rihs01(name), name
