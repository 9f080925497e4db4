"""What is written is read back bit by bit, and damage to it is seen."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.recording_bag import write_recording
from support.small_bags import ONSET_NS, STORAGES, read, refused

from proprio_ros.errors import ConfigurationError
from proprio_ros.records import InputRecord, JointRecord, Recording

BAGS = Path(__file__).parents[2] / "bags"


@pytest.mark.parametrize("storage", STORAGES)
@settings(max_examples=15, deadline=None)
@given(data=st.data())
def test_what_is_written_is_read_back_bit_by_bit(
    tmp_path_factory: pytest.TempPathFactory, storage: str, data: st.DataObject
) -> None:
    joints, inputs = drawn(data)
    path = tmp_path_factory.mktemp("round") / "trip"
    write_recording(path, Recording("trip", joints, inputs), storage)
    again = read(path, effort_unit="N.m", joint_order=joints.names)
    assert again.name == "trip"
    assert again.joints.names == joints.names
    for quantity in ("times_ns", "position", "velocity", "effort"):
        before = getattr(joints, quantity)
        after = getattr(again.joints, quantity)
        assert (before is None) == (after is None)
        assert before is None or before.tobytes() == after.tobytes()
    assert again.inputs is not None
    assert again.inputs.names == joints.names
    assert again.inputs.source == "/current_command"
    assert again.inputs.times_ns.tobytes() == inputs.times_ns.tobytes()
    assert again.inputs.current_A.tobytes() == inputs.current_A.tobytes()


def drawn(data: st.DataObject) -> tuple[JointRecord, InputRecord]:
    """Joint states and commands of a few joints, with and without velocity and effort."""
    count = data.draw(st.integers(5, 12))
    gaps = data.draw(
        st.lists(
            st.integers(10**6, 10**9),
            min_size=count,
            max_size=count,
        )
    )
    names = tuple(
        data.draw(
            st.lists(
                st.text("abcXYZ_0189", min_size=1, max_size=6), min_size=1, unique=True, max_size=4
            )
        )
    )
    finite = st.floats(-49.0, 49.0, allow_subnormal=True)
    table = st.lists(
        st.lists(
            finite,
            min_size=len(names),
            max_size=len(names),
        ),
        min_size=count,
        max_size=count,
    )
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
    inputs = InputRecord(
        times_ns[::2],
        names,
        np.array(data.draw(table))[::2],
        "/current_command",
    )
    return joints, inputs


def test_writing_without_an_input_and_refusals(tmp_path: Path) -> None:
    recording = Recording(
        "r",
        JointRecord(
            10**7 * np.arange(6),
            ("a",),
            np.zeros((6, 1)),
        ),
        None,
    )
    write_recording(tmp_path / "bag", recording)
    assert read(tmp_path / "bag").inputs is None
    with refused("cannot be written .*give a new folder"):
        write_recording(tmp_path / "bag", recording)
    with refused("mcap, sqlite3", ConfigurationError):
        write_recording(tmp_path / "other", recording, "bag")


@settings(max_examples=20, deadline=None)
@given(
    places=st.lists(
        st.floats(0.0, 1.0),
        min_size=1,
        max_size=8,
    )
)
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
