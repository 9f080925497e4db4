"""Joint states as ROS' own tools print them are read as the bag is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.tables import FIELDS, Recorded, echoed, plotted, recorded_in

from proprio_ros.errors import RecordingError
from proprio_ros.pipeline.request import Options, read_request
from proprio_ros.recordings.sources import open_recording
from proprio_ros.recordings.tables import is_recorded_table, open_table
from proprio_ros.records import Recording

BAGS = Path(__file__).resolve().parents[2] / "bags"
PUSH = BAGS / "realistic_s00_fixed_light_ball_20g_joint3" / "bag_mcap"
Printed = Callable[..., str]
both = pytest.mark.parametrize("printed", [echoed, plotted])


@pytest.fixture(scope="module")
def recorded() -> Recorded:
    return recorded_in(PUSH)


def read(path: Path) -> Recording:
    request = read_request(Options(robot="open_manipulator_x", effort_unit="N.m"))
    with open_recording(path) as source:
        return source.recording(request.reading.options)


def written(folder: Path, text: str, name: str = "log.csv") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def refusal(path: Path) -> str:
    with pytest.raises(RecordingError) as caught:
        read(path)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 300
    return str(caught.value)


@both
@pytest.mark.parametrize("name", ["log.csv", "log.txt"])
def test_it_is_the_bag(tmp_path: Path, recorded: Recorded, printed: Printed, name: str) -> None:
    path = written(tmp_path, printed(recorded), name)
    assert is_recorded_table(path)
    found = read(path).joints
    assert found.names == recorded.joints
    np.testing.assert_array_equal(found.times_ns, recorded.times_ns)
    for field, values in zip(FIELDS, (found.position, found.velocity, found.reported_effort), strict=True):  # fmt: skip
        np.testing.assert_array_equal(values, getattr(recorded, field))


@both
def test_fields_that_nobody_published(tmp_path: Path, recorded: Recorded, printed: Printed) -> None:
    """Without velocities the efforts are still efforts."""
    found = read(written(tmp_path, printed(recorded, ("position", "effort")))).joints
    np.testing.assert_array_equal(found.reported_effort, recorded.effort)
    assert found.velocity is None or np.isnan(found.velocity).all()


def test_publishers_of_several_joints_on_one_topic(tmp_path: Path, recorded: Recorded) -> None:
    """A gripper's driver publishes its own joint in messages of its own."""
    arm = replace(
        recorded,
        joints=recorded.joints[:4],
        **{field: getattr(recorded, field)[:, :4] for field in FIELDS},
    )
    hand = replace(
        recorded,
        times_ns=recorded.times_ns + 1_000_000,
        joints=recorded.joints[4:],
        **{field: getattr(recorded, field)[:, 4:] for field in FIELDS},
    )
    lines = sorted((echoed(arm) + echoed(hand)).splitlines(), key=lambda line: line[:20])
    found = read(written(tmp_path, "\n".join(lines) + "\n")).joints
    assert set(recorded.joints[:4]) <= set(found.names)
    column = found.column("joint3")
    np.testing.assert_array_equal(found.position[:, column], recorded.position[:, 2])


@both
def test_what_a_tool_says_beside_messages_and_a_line_that_breaks_off(
    tmp_path: Path, recorded: Recorded, printed: Printed
) -> None:
    text = printed(recorded)
    text = "WARNING: topic [/joint_states] does not appear to be published yet\n" + text[:-40]
    path = written(tmp_path, text + "\nA message was lost!!!\n\ttotal count change:1\n")
    found = read(path)
    assert len(found.joints.times_ns) == len(recorded.times_ns) - 1
    assert any("the last line breaks off" in note for note in found.notes)
    assert any("3 lines are no messages" in note for note in found.notes)


def test_what_cannot_be_read_is_refused_in_a_line(tmp_path: Path, recorded: Recorded) -> None:
    numbered = replace(recorded, joints=("1", "2", "3", "4", "5"))
    for text in (echoed(numbered), plotted(numbered)):
        said = refusal(written(tmp_path, text))
        assert "only, and which these are nobody says: name them" in said
    nameless = refusal(written(tmp_path, plotted(recorded, names=False)))
    assert "without --nostr prints names" in nameless
    cut = echoed(recorded).replace("gripper_left_joint", "gripper_left...")
    assert "--full-length" in refusal(written(tmp_path, cut))
    lines = plotted(recorded).splitlines()
    lines[5] = lines[5].rsplit(",", 2)[0]
    assert "line 6: has " in refusal(written(tmp_path, "\n".join(lines)))
    other = "%time,field.header.seq,field.data\n1,1,1\n"
    assert "sensor_msgs/JointState" in refusal(written(tmp_path, other))


def test_stamps_that_nobody_set(tmp_path: Path, recorded: Recorded) -> None:
    """The time at which ROS 1 printed a message counts instead."""
    rows = [line.split(",") for line in plotted(recorded).splitlines()]
    for row in rows[1:]:
        row[2] = "0"
    path = written(tmp_path, "\n".join(map(",".join, rows)) + "\n")
    np.testing.assert_array_equal(read(path).joints.times_ns, recorded.times_ns)


def test_a_table_of_numbers_is_none(tmp_path: Path) -> None:
    path = written(tmp_path, "t [s],q1 [rad],tau1 [Nm]\n0,0.1,0.2\n0.01,0.1,0.2\n")
    assert open_table(path).headers == ("t [s]", "q1 [rad]", "tau1 [Nm]")
