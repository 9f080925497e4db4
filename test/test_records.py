"""Records refuse what is not a recording, and cannot be changed afterwards."""

from __future__ import annotations

from dataclasses import FrozenInstanceError, replace
from typing import Any

import numpy as np
import pytest

from proprio_ros.errors import RecordingError
from proprio_ros.records import MEASURED_EFFORT, InputRecord, JointRecord, Run


def joint_record(**changes: Any) -> JointRecord:
    values: dict[str, Any] = {
        "times_ns": [0, 10, 20],
        "names": ["joint2", "joint3"],
        "position": np.arange(6.0).reshape(3, 2),
    }
    return JointRecord(**(values | changes))


def run(**changes: Any) -> Run:
    values: dict[str, Any] = {
        "name": "bag",
        "joint": "joint3",
        "onset_ns": 5,
        "times_s": [0.0, 0.1],
        "position": [1.0, 1.1],
        "before_times_s": [-0.1],
        "before_position": [1.0],
        "held": {"joint2": 0.0},
        "held_span": {"joint2": 0.0},
        "input_times_s": [0.0],
        "input_current_A": [0.3],
        "duration_s": 0.1,
        "source": "/current_command",
    }
    return Run(**(values | changes))


def test_values_are_copied_and_read_only() -> None:
    position = np.zeros((3, 2))
    record = joint_record(position=position)
    position[:] = 7.0
    assert record.position.max() == 0.0
    with pytest.raises(ValueError, match="read-only"):
        record.position[0, 0] = 1.0
    with pytest.raises(FrozenInstanceError):
        record.names = ("other",)  # type: ignore[misc]
    assert record.times_ns.dtype == np.int64
    assert record.names == ("joint2", "joint3")


def test_a_column_is_found_by_name_and_an_unknown_name_lists_the_choices() -> None:
    assert joint_record().column("joint3") == 1
    with pytest.raises(RecordingError, match=r"'elbow'.*joint2, joint3"):
        joint_record().column("elbow")
    inputs = InputRecord(
        np.array([0]),
        ("joint3",),
        np.zeros((1, 1)),
        MEASURED_EFFORT,
    )
    assert inputs.column("joint3") == 0
    assert inputs.measured
    assert not replace(inputs, source="/current_command").measured


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"times_ns": [0, 10, 10]}, "increase strictly"),
        ({"times_ns": [0, 20, 10]}, "increase strictly"),
        ({"times_ns": [0, 10]}, r"expected shape \(2, 2\)"),
        ({"names": ["joint2", "joint2"]}, "named twice"),
        ({"names": ["joint2"]}, "expected shape"),
        ({"position": np.full((3, 2), np.nan)}, "finite"),
        ({"position": np.zeros(3)}, "expected shape"),
        ({"position": [["a", "b"]] * 3}, "expected numbers"),
        ({"velocity": np.zeros((2, 2))}, "velocity: expected shape"),
        ({"effort": np.zeros((3, 1))}, "effort: expected shape"),
        ({"current": np.zeros(6)}, "current: expected shape"),
    ],
)
def test_joint_record_refuses(
    changes: dict[str, Any],
    message: str,
) -> None:
    with pytest.raises(RecordingError, match=message):
        joint_record(**changes)


def test_an_unknown_velocity_is_nan_and_no_position_is() -> None:
    record = joint_record(velocity=np.full((3, 2), np.nan))
    assert record.velocity is not None
    assert np.isnan(record.velocity).all()


@pytest.mark.parametrize(
    ("times_ns", "current", "message"),
    [
        ([0, 0], [[0.0], [1.0]], "increase strictly"),
        ([0, 1], [[0.0], [np.inf]], "finite"),
        ([0, 1], [[0.0]], "expected shape"),
    ],
)
def test_input_record_refuses(
    times_ns: list[int],
    current: list[list[float]],
    message: str,
) -> None:
    with pytest.raises(RecordingError, match=message):
        InputRecord(
            np.array(times_ns),
            ("joint3",),
            np.array(current),
            "/current_command",
        )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"times_s": [-0.1, 0.1]}, "between 0 and"),
        ({"times_s": [0.0, 0.2]}, "between 0 and"),
        ({"times_s": [0.0, 0.0]}, "increase strictly"),
        ({"position": [1.0]}, "expected shape"),
        ({"position": [1.0, np.nan]}, "finite"),
        ({"before_times_s": [0.0]}, "negative"),
        ({"input_times_s": [0.1]}, "start at time 0"),
        ({"input_times_s": [], "input_current_A": []}, "start at time 0"),
        ({"duration_s": 0.0}, "positive"),
        ({"duration_s": float("nan")}, "positive"),
    ],
)
def test_run_refuses(
    changes: dict[str, Any],
    message: str,
) -> None:
    with pytest.raises(RecordingError, match=message):
        run(**changes)


def test_a_run_may_lack_samples_before_its_onset() -> None:
    assert run(before_times_s=[], before_position=[]).before_times_s.shape == (0,)
