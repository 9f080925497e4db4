"""What a recording says twice must agree, or it is refused with the sentence that names the two."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.bends.messages import bent, commands_times, messages_of, stamps_times

from proprio_ros.errors import RecordingError
from proprio_ros.pipeline.check import check_bags
from proprio_ros.pipeline.loading import bag_recording, bag_runs
from proprio_ros.pipeline.request import Options, Request
from proprio_ros.recordings.columns import JointColumns
from proprio_ros.recordings.contradictions import pace_of_stamps, refuse_other_current
from proprio_ros.recordings.effort import Effort
from proprio_ros.robot import load_robot

BAGS = Path(__file__).resolve().parents[2] / "bags"
PUSH = BAGS / "quantised_s00_fixed_heavy_ball_50g_joint3" / "bag_mcap"
OTHER = BAGS / "realistic_s00_empty_03_joint3" / "bag_mcap"
ARM = Request(load_robot("open_manipulator_x"))


@pytest.mark.parametrize("factor", [0.8, 0.92, 1.1, 1.3])
def test_a_command_that_the_motor_did_not_follow_is_refused(tmp_path: Path, factor: float) -> None:
    bag = bent(tmp_path / "bag", commands_times(factor), PUSH)
    with pytest.raises(
        RecordingError, match=f"joint3 had {1 / factor:.2f} times the current of /current_command"
    ):
        bag_runs(bag, ARM)
    _, (check,) = check_bags([bag])
    assert "joint3 had" in check.problem


@pytest.mark.parametrize("factor", [0.98, 1.0, 1.02])
def test_a_motor_that_delivers_a_little_less_is_none(tmp_path: Path, factor: float) -> None:
    assert bag_runs(bent(tmp_path / "bag", commands_times(factor), PUSH), ARM)


def test_the_command_of_another_recording_is_refused(tmp_path: Path) -> None:
    other = [message for topic, _, _, message in messages_of(OTHER) if topic == "/current_command"]

    def bend(
        topic: str,
        time_ns: int,
        message: Any,
    ) -> tuple[int, Any]:
        return (
            (time_ns, other.pop(0)) if topic == "/current_command" and other else (time_ns, message)
        )

    with pytest.raises(
        RecordingError, match=r"joint3 had .* times the current of /current_command|does not follow"
    ):
        bag_runs(bent(tmp_path / "bag", bend, PUSH), ARM)


def test_a_unit_that_the_command_contradicts_is_refused() -> None:
    with pytest.raises(
        RecordingError, match=r"1\.78 times the current of /current_command.*--effort-unit"
    ):
        bag_runs(PUSH, Request(ARM.robot, Options(driver="ur_current")))
    assert bag_runs(PUSH, Request(ARM.robot, Options(driver="proprio")))


@pytest.mark.parametrize(
    ("factor", "refused"), [(0.85, False), (1.2, False), (2.0, True), (3.0, True)]
)
def test_a_torque_that_others_measure_may_lack_what_friction_takes(
    factor: float, refused: bool
) -> None:
    push = bag_recording(PUSH, ARM)
    assert push.inputs is not None
    inputs = replace(
        push.inputs,
        source="/forward_effort_controller/commands",
        current_A=push.inputs.current_A / factor,
    )
    other = replace(push, inputs=inputs)
    with (
        pytest.raises(RecordingError, match="times the current of /forward")
        if refused
        else nullcontext()
    ):
        refuse_other_current(
            other,
            Effort(None, ARM.effort_per_current),
            {"joint3": np.inf},
        )


@pytest.mark.parametrize(
    ("factor", "said"), [(1.01, "1.0 % faster"), (1.03, "3.0 % faster"), (0.98, "2.0 % slower")]
)
def test_stamps_that_keep_another_pace_are_refused(
    tmp_path: Path, factor: float, said: str
) -> None:
    with pytest.raises(RecordingError, match=f"run {said} than the times of recording"):
        bag_runs(bent(tmp_path / "bag", stamps_times(factor), PUSH), ARM)


def test_stamps_of_another_clock_may_keep_their_own_pace(tmp_path: Path) -> None:
    """As where a simulation runs at its own speed."""
    slow = stamps_times(0.9)

    def bend(
        topic: str,
        time_ns: int,
        message: Any,
    ) -> tuple[int, Any]:
        time_ns, message = slow(topic, time_ns, message)
        if topic == "/joint_states":
            message.header.stamp.sec -= 1_000_000
        return time_ns, message

    runs = bag_runs(bent(tmp_path / "bag", bend, PUSH), ARM)
    assert any(
        "10.0 % slower" in note and "another clock" in note for run in runs for note in run.notes
    )


@pytest.mark.parametrize("factor", [1000.0, 0.001])
def test_stamps_in_another_unit_are_refused(tmp_path: Path, factor: float) -> None:
    with pytest.raises(
        RecordingError,
        match=r"header stamps run 1000 times (faster|slower) than the times of recording",
    ):
        bag_runs(bent(tmp_path / "bag", stamps_times(factor), PUSH), ARM)


@pytest.mark.parametrize("factor", [1000.0, 0.001])
def test_times_in_another_unit_are_refused(tmp_path: Path, factor: float) -> None:
    """Stamps and recorder alike, as of a bag that was made of a table."""
    stamps = stamps_times(factor)
    first = [0]

    def bend(
        topic: str,
        time_ns: int,
        message: Any,
    ) -> tuple[int, Any]:
        first[0] = first[0] or time_ns
        _, message = stamps(topic, time_ns, message)
        return first[0] + round((time_ns - first[0]) * factor), message

    with pytest.raises(
        RecordingError, match=r"comes every [0-9.e-]+ s: its time stamps are not in s and ns"
    ):
        bag_runs(bent(tmp_path / "bag", bend, PUSH), ARM)


@pytest.mark.parametrize("seed", range(5))
def test_late_messages_are_no_other_pace(seed: int) -> None:
    """A recorder on a busy computer: jitter, a backlog that grows and is worked off, a second that nothing came."""
    rng = np.random.default_rng(seed)
    stamp_ns = 10**18 + (1e9 * np.arange(0.0, 5.0, 0.01)).astype(np.int64)
    late_s = rng.exponential(0.003, len(stamp_ns))
    start = int(rng.integers(50, 300))
    stall = np.arange(100) * 0.01
    late_s[start : start + 100] += stall[::-1]
    backlog = rng.integers(100, 400)
    late_s[backlog : backlog + 60] += np.linspace(0.0, 0.2, 60)
    for shift_s in (0.0, 0.1):
        columns = JointColumns(
            stamp_ns + (1e9 * (late_s + shift_s)).astype(np.int64), stamp_ns, ("joint",), {}, []
        )
        assert pace_of_stamps(columns) is None
