"""More than one node publishes joint states: what the arm's driver says is read, and the rest is left out, or refused by name."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.bends import publishers
from support.bends.tape import Tape, tape_of
from support.moved_arm import record_arm

from proprio_ros.errors import RecordingError
from proprio_ros.recordings.signals import read_recording
from proprio_ros.records import Recording

SEED = 11
URDF = Path(__file__).resolve().parents[2] / "urdf" / "open_manipulator_x.urdf"


@pytest.fixture(scope="module")
def tape(tmp_path_factory: pytest.TempPathFactory) -> Tape:
    """Of an arm in MuJoCo, with efforts of its own sensors."""
    constants = {f"joint{number}": 1.0 for number in range(1, 5)}
    folder = tmp_path_factory.mktemp("moved") / "bag"
    return tape_of(record_arm(folder, URDF, constants, "end_effector_link", 0.05, 3, seconds=6.0))


def read(tape: Tape, folder: Path) -> Recording:
    return read_recording(
        tape.write(folder / "bag"),
        effort_unit="N.m",
        nominal_torque_constants={f"joint{number}": 1.0 for number in range(1, 5)},
        joint_order=[f"joint{number}" for number in range(1, 5)],
    )


CASES: list[tuple[Any, dict[str, Any], str]] = [
    *(
        (publishers.zeros_with_the_same_stamps, {"lag_us": lag, "effort": effort}, "second pub")
        for lag in (-50, 50)
        for effort in (True, False)
    ),
    *(
        (publishers.zeros_at_times_of_its_own, {"rate": rate, "at": at}, "second publisher")
        for rate in (2, 10)
        for at in (0.2, 0.8)
    ),
    *((publishers.stale_copies, {"samples": late}, "copies of what was") for late in (1, 5, 20)),
    *((publishers.another_pose, {"rate": rate}, "one and the same place") for rate in (1, 2, 10)),
    *(
        (publishers.doubled_list, {"second": second, "first": first}, "name joints twice")
        for second in ("same", "zeros", "nothing")
        for first in (True, False)
    ),
    *(
        (
            publishers.gripper_names_the_arm,
            {"rate": rate, "arm": arm, "samples": 10},
            "second pub",
        )
        for arm in ("zeros", "late")
        for rate in (1, 3)
    ),
    *(
        (publishers.gripper_publishes_more_often, {"times": times}, "a_finger is in")
        for times in (1, 2, 5)
    ),
    *(
        (publishers.copies_in_another_order, {"order": order}, "carry no effort")
        for order in ("reversed", "rotated")
    ),
    (publishers.every_message_twice, {}, "repeat another one, stamp and all"),
]


@pytest.mark.parametrize(("bend", "parameters", "said"), CASES)
def test_the_driver_is_kept(
    tape: Tape,
    tmp_path: Path,
    bend: Any,
    parameters: dict[str, Any],
    said: str,
) -> None:
    true = tape.states
    recording = read(
        bend(tape, np.random.default_rng(SEED), **parameters),
        tmp_path,
    )
    assert any(said in note for note in recording.notes), recording.notes
    found = recording.joints
    columns = [found.column(name) for name in true.names]
    row = np.searchsorted(true.stamp_ns, found.times_ns)
    own = (row < len(true.stamp_ns)) & (
        true.stamp_ns[row.clip(max=len(true.stamp_ns) - 1)] == found.times_ns
    )
    # copies at either end have nothing to be compared with
    assert own.mean() > 0.98 and own.sum() > 0.98 * len(true.stamp_ns)
    assert found.effort is not None
    np.testing.assert_array_equal(
        found.position[np.ix_(own, columns)], true.values["position"][row[own]]
    )
    np.testing.assert_array_equal(
        found.effort[np.ix_(own, columns)], true.values["effort"][row[own]]
    )


def test_copies_are_known_where_an_arm_stands_and_its_reading_flickers(
    tape: Tape, tmp_path: Path
) -> None:
    rng = np.random.default_rng(SEED)
    count_rad = 1e-4
    position = tape.states.values["position"]
    stands = np.repeat(position[:1], 2 * len(position), axis=0)
    counts = np.round(np.vstack([stands, position]) / count_rad)
    counts[: len(stands)] += rng.integers(0, 2, stands.shape)
    period_ns = int(np.median(np.diff(tape.states.bag_ns)))
    times_ns = tape.begin_ns + period_ns * np.arange(len(counts))
    states = replace(
        tape.states,
        bag_ns=times_ns,
        stamp_ns=times_ns,
        values={"position": count_rad * counts, "effort": np.ones_like(counts)},
    )
    copied = publishers.stale_copies(Tape((states,)), rng, samples=5)
    recording = read(copied, tmp_path)
    assert any("copies of what was" in note for note in recording.notes), recording.notes
    moving = recording.joints.times_ns >= times_ns[len(stands)]
    assert moving.sum() == pytest.approx(len(position), abs=len(position) // 50)


@pytest.mark.parametrize("rate", [1, 2])
def test_two_that_both_move_are_refused(tape: Tape, tmp_path: Path, rate: int) -> None:
    bent = publishers.another_arm(
        tape,
        np.random.default_rng(SEED),
        rate=rate,
    )
    with pytest.raises(RecordingError, match=r"joint.* is at two places at once.*two publishers"):
        read(bent, tmp_path)


def test_two_lists_that_differ_are_refused(tape: Tape, tmp_path: Path) -> None:
    bent = publishers.doubled_list(
        tape,
        np.random.default_rng(SEED),
        second="same",
        first=False,
    )
    table = bent.states.values["position"].copy()
    table[:, 5] += 0.1
    bent = bent.with_states(lambda states: states.with_values(position=table))
    with pytest.raises(RecordingError, match=r"names joint2 twice in a message"):
        read(bent, tmp_path)


def test_one_publisher_needs_no_repair(tape: Tape, tmp_path: Path) -> None:
    assert read(tape, tmp_path).notes == ()
