"""Messages become columns under the robot's names, whatever their order and labels."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.small_bags import (
    CYCLE_NS,
    JOINTS,
    ONSET_NS,
    command,
    commands,
    currents,
    elbow,
    notes,
    positions,
    read,
    refused,
    state,
    states,
    times,
    write_bag,
)

from proprio_ros.recordings.runs import cut_runs


def test_the_order_of_joints_may_change_between_messages(tmp_path: Path) -> None:
    generator = np.random.default_rng(3)
    messages = []
    for time_ns in times():
        order = generator.permutation(5)
        messages.append(
            state(
                time_ns,
                [positions(time_ns)[column] for column in order],
                [JOINTS[column] for column in order],
            )
        )
    recording = read(write_bag(tmp_path / "bag", messages + commands()))
    for name, column in zip(JOINTS, range(5), strict=True):
        values = recording.joints.position[:, recording.joints.column(name)]
        assert values.tolist() == [positions(time_ns)[column] for time_ns in times()]
    assert "order of the joints changes" in notes(recording)


def test_another_order_that_never_changes_needs_no_note(tmp_path: Path) -> None:
    messages = [
        state(
            time_ns,
            positions(time_ns)[::-1],
            JOINTS[::-1],
        )
        for time_ns in times()
    ]
    recording = read(write_bag(tmp_path / "bag", messages + commands()))
    assert recording.notes == ()
    assert recording.joints.position[:, recording.joints.column("joint3")].tolist() == [
        elbow(t) for t in times()
    ]


def test_velocity_may_be_missing_in_some_messages(tmp_path: Path) -> None:
    messages = [
        state(t, positions(t), velocity=[1.0] * 5 if row % 2 else ())
        for row, t in enumerate(times())
    ]
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
    ],
)
def test_lengths_that_do_not_fit(
    tmp_path: Path,
    changes: dict[str, Any],
    pattern: str,
) -> None:
    values: dict[str, Any] = {
        "time_ns": times()[-1] + CYCLE_NS,
        "position": [0.0] * 5,
    }
    last = state(**(values | changes))
    with refused(pattern):
        read(write_bag(tmp_path / "bag", [*states(), last, *commands()]))


@pytest.mark.parametrize(
    "labels",
    [("joint3", "joint1"), ("joint3,joint1",), (" joint3 , joint1 ",)],
    ids=["dims", "joined", "blanks"],
)
def test_labels_name_the_columns(
    tmp_path: Path,
    labels: tuple[str, ...],
) -> None:
    messages = [
        command(
            time_ns,
            [currents(time_ns)[2], 0.0],
            labels,
        )
        for time_ns in times()
    ]
    inputs = read(write_bag(tmp_path / "bag", states() + messages)).inputs
    assert inputs is not None
    assert inputs.names == ("joint3", "joint1")
    assert inputs.current_A[:, 0].tolist() == [currents(time_ns)[2] for time_ns in times()]


@pytest.mark.parametrize("labels", [("currents",), ("height", "width")])
def test_labels_that_describe_the_dimensions_name_no_column(
    tmp_path: Path, labels: tuple[str, ...]
) -> None:
    inputs = read(write_bag(tmp_path / "bag", states() + commands(labels=labels))).inputs
    assert inputs is not None
    assert inputs.names == JOINTS


@pytest.mark.parametrize(
    "labels", [("joint3,joint1,joint2",), ("joint3", "joint3"), ("joint3", "")]
)
def test_labels_that_do_not_fit(
    tmp_path: Path,
    labels: tuple[str, ...],
) -> None:
    with refused("has 2 values but is labelled .*must name every joint once"):
        read(
            write_bag(
                tmp_path / "bag",
                [
                    *states(),
                    command(
                        ONSET_NS,
                        [0.3, 0.0],
                        labels,
                    ),
                ],
            )
        )


@pytest.mark.parametrize("length", [1, 4, 6])
def test_an_unlabelled_command_of_the_wrong_length(tmp_path: Path, length: int) -> None:
    with refused(
        f"has {length} values but the robot has 5 joints .*joint4, gripper_left_joint.*label"
    ):
        read(write_bag(tmp_path / "bag", [*states(), command(ONSET_NS, [0.3] * length)]))


@pytest.mark.parametrize(
    "labels", [(), ("",)], ids=["unlabelled", "as the excitation node labels it"]
)
def test_a_command_without_numbers_ends_the_push(
    tmp_path: Path,
    labels: tuple[str, ...],
) -> None:
    """So the excitation node ends each push; joints that a command does not name are held, as by the driver."""
    first = ONSET_NS
    second = ONSET_NS + 5 * CYCLE_NS
    end = ONSET_NS + 20 * CYCLE_NS
    messages = [
        *states(),
        command(first, [-0.3], ["joint3"]),
        command(second, [0.2], ["joint4"]),
        command(end, [], labels),
    ]
    inputs = read(write_bag(tmp_path / "bag", messages), command_topic="/current_command").inputs
    assert inputs is not None and inputs.times_ns.tolist() == [first, second, end]
    assert inputs.names == ("joint3", "joint4") and inputs.current_A.tolist() == [
        [-0.3, 0.0],
        [0.0, 0.2],
        [0.0, 0.0],
    ]
    run = cut_runs(
        read(write_bag(tmp_path / "run", [*states(), messages[-3], messages[-1]])), joints=JOINTS
    )[0]
    assert run.duration_s == pytest.approx(1e-9 * (end - first)) and run.joint == "joint3"


def test_an_unlabelled_command_may_cover_just_the_recorded_joints(tmp_path: Path) -> None:
    messages = [
        state(
            t,
            positions(t)[:4],
            JOINTS[:4],
        )
        for t in times()
    ]
    messages += [command(t, currents(t)[:4]) for t in times()]
    recording = read(write_bag(tmp_path / "bag", messages))
    assert recording.inputs is not None
    assert recording.inputs.names == JOINTS[:4]
    assert "read as the recorded joints joint1, joint2, joint3, joint4" in notes(recording)
