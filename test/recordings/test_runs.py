"""Runs lie where the current was, with exactly the samples that belong to them."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from proprio_ros.errors import RecordingError
from proprio_ros.recordings.runs import (
    MOVING_SPAN,
    _Interval,
    _without_holding_joints,
    cut_runs,
)
from proprio_ros.recordings.signals import read_recording
from proprio_ros.records import (
    MEASURED_EFFORT,
    FloatArray,
    InputRecord,
    JointRecord,
    Recording,
    TimeArray,
)

JOINTS = ("joint1", "joint2", "joint3", "joint4", "gripper_left_joint")
ROBOT_JOINTS = JOINTS
ONSET_NS = 1_760_000_010_000_000_000
CYCLE_S = 0.025
BAGS = Path(__file__).parents[2] / "bags"


def cycles(
    end_s: float = 0.75,
    start_s: float = -0.25,
) -> FloatArray:
    return (
        np.arange(round(start_s / CYCLE_S), round(end_s / CYCLE_S) + 1).astype(np.float64) * CYCLE_S
    )


def ns(times_s: FloatArray) -> TimeArray:
    return ONSET_NS + np.rint(times_s * 1e9).astype(np.int64)


def recording(
    currents: Mapping[str, FloatArray],
    times_s: FloatArray | None = None,
    *,
    input_times_s: FloatArray | None = None,
    positions: Mapping[str, FloatArray] | None = None,
    source: str = "/current_command",
) -> Recording:
    """Positions of joint k are k + its time, unless given."""
    times_s = cycles() if times_s is None else times_s
    input_times_s = times_s if input_times_s is None else input_times_s
    position = np.array(
        [(positions or {}).get(name, column + times_s) for column, name in enumerate(JOINTS)]
    ).T
    current = np.array([currents.get(name, np.zeros(len(input_times_s))) for name in JOINTS]).T
    inputs = InputRecord(ns(input_times_s), JOINTS, current, source)
    return Recording(
        "bag",
        JointRecord(ns(times_s), JOINTS, position),
        inputs,
    )


def step(
    times_s: FloatArray,
    start_s: float = 0.0,
    end_s: float = 0.6,
    value: float = -0.3,
) -> FloatArray:
    return np.where(
        (times_s > start_s - 1e-9) & (times_s < end_s - 1e-9),
        value,
        0.0,
    )


@contextmanager
def refused(pattern: str) -> Iterator[None]:
    with pytest.raises(RecordingError) as caught:
        yield
    assert "\n" not in str(caught.value)
    assert re.search(pattern, str(caught.value)), str(caught.value)


# --- commanded runs --------------------------------------------------------------------------------------------------


def test_one_constant_current_is_one_run() -> None:
    (run,) = cut_runs(
        recording({"joint3": step(cycles())}),
        joints=ROBOT_JOINTS,
    )
    assert (run.name, run.joint, run.onset_ns, run.duration_s) == ("bag", "joint3", ONSET_NS, 0.6)
    assert run.source == "/current_command"
    assert run.input_times_s.tolist() == [0.0]
    assert run.input_current_A.tolist() == [-0.3]
    assert run.times_s == pytest.approx(np.arange(25) * CYCLE_S, abs=1e-12)
    assert run.position == pytest.approx(2.0 + run.times_s)
    assert run.before_times_s == pytest.approx(np.arange(-10, 0) * CYCLE_S, abs=1e-12)
    assert run.before_position == pytest.approx(2.0 + run.before_times_s)


def test_what_the_joint_does_after_its_run_is_carried_along_until_the_next() -> None:
    times_s = cycles(1.5)
    (run,) = cut_runs(
        recording({"joint3": step(times_s)}, times_s),
        joints=ROBOT_JOINTS,
    )
    # 0.9 s is 0.3 s after, but for rounding
    assert run.after_times_s == pytest.approx(0.6 + np.arange(1, 12) * CYCLE_S)
    assert run.after_position == pytest.approx(2.0 + run.after_times_s)
    currents = {
        "joint3": step(times_s),
        "joint2": step(times_s, 0.7, 1.2),
    }
    first, second = cut_runs(recording(currents, times_s), joints=ROBOT_JOINTS)
    assert first.after_times_s == pytest.approx([0.625, 0.65, 0.675]) and len(
        second.after_times_s
    ) in (11, 12)


def test_the_held_joints_are_averaged_from_the_rest_to_the_end() -> None:
    (run,) = cut_runs(
        recording({"joint3": step(cycles())}),
        joints=ROBOT_JOINTS,
    )
    assert sorted(run.held) == sorted(set(JOINTS) - {"joint3"})
    # joint2 = 1 + t over -0.25..0.6 s
    assert run.held["joint2"] == pytest.approx(1.0 + (0.6 - 0.25) / 2)
    assert run.held_span["joint2"] == pytest.approx(0.85)


def test_positions_of_held_joints_may_be_given() -> None:
    held = {"joint2": 0.5, "spare": -1.0, "joint3": 9.0}
    (run,) = cut_runs(
        recording({"joint3": step(cycles())}),
        held=held,
        joints=ROBOT_JOINTS,
    )
    assert (run.held["joint2"], run.held["spare"]) == (0.5, -1.0)
    assert run.held_span["spare"] == 0.0
    assert "joint3" not in run.held


@pytest.mark.parametrize(
    ("late_s", "samples", "last_s"),
    [(0.0, 25, 0.6), (34e-9, 25, 0.6), (-34e-9, 25, 0.6 - 34e-9), (2e-6, 24, 0.575)],
    ids=["on the end", "a rounding after", "a rounding before", "after"],
)
def test_the_sample_at_the_end_belongs_to_the_run(
    late_s: float, samples: int, last_s: float
) -> None:
    times_s = cycles()
    times_s[34] += late_s  # the cycle at 0.6 s
    (run,) = cut_runs(
        recording(
            {"joint3": step(cycles())},
            times_s,
            input_times_s=cycles(),
        ),
        joints=ROBOT_JOINTS,
    )
    assert len(run.times_s) == samples
    assert run.times_s[-1] == pytest.approx(last_s, abs=1e-10)
    assert run.times_s[-1] <= run.duration_s


def test_two_runs_are_numbered_and_keep_away_from_each_other() -> None:
    times_s = cycles(2.5)
    currents = {
        "joint3": step(times_s),
        "joint4": step(times_s, 1.0, 1.6, 0.1),
    }
    first, second = cut_runs(recording(currents, times_s), joints=ROBOT_JOINTS)
    assert [(run.name, run.joint) for run in (first, second)] == [
        ("bag#1", "joint3"),
        ("bag#2", "joint4"),
    ]
    assert second.onset_ns == ONSET_NS + 1_000_000_000
    assert second.input_current_A.tolist() == [0.1]
    # 0.3 s after the first ended at 0.6 s
    assert second.before_times_s[0] == pytest.approx(-0.1)
    assert second.held["joint3"] == pytest.approx(2.0 + (0.9 + 1.6) / 2)


def test_at_most_a_second_of_rest_is_carried_along() -> None:
    times_s = cycles(start_s=-3.0)
    (run,) = cut_runs(
        recording({"joint3": step(times_s)}, times_s),
        joints=ROBOT_JOINTS,
    )
    assert run.before_times_s[0] == pytest.approx(-1.0)


def test_one_joint_right_after_another_are_two_runs() -> None:
    times_s = cycles(1.5)
    currents = {
        "joint3": step(times_s),
        "joint4": step(times_s, 0.6, 1.2),
    }
    first, second = cut_runs(recording(currents, times_s), joints=ROBOT_JOINTS)
    assert first.duration_s == second.duration_s == 0.6
    assert second.before_times_s.size == 0
    assert "no joint state at rest" in " ".join(second.notes)


@pytest.mark.parametrize(("zeros", "runs"), [(1, 1), (2, 1), (3, 2), (5, 2)])
def test_a_short_zero_belongs_to_the_run_and_a_long_one_ends_it(zeros: int, runs: int) -> None:
    current = step(cycles())
    current[22 : 22 + zeros] = 0.0  # from 0.3 s
    found = cut_runs(recording({"joint3": current}), joints=ROBOT_JOINTS)
    assert len(found) == runs
    if runs == 1:
        assert found[0].duration_s == 0.6
        assert found[0].input_times_s == pytest.approx([0.0, 0.3, 0.3 + zeros * CYCLE_S])
        assert found[0].input_current_A.tolist() == [-0.3, 0.0, -0.3]
    else:
        assert found[0].duration_s == pytest.approx(0.3)


def test_commands_sent_only_when_they_change() -> None:
    input_times_s = np.array([-0.2, 0.0, 0.2, 0.6, 1.6, 2.2])
    current = np.array([0.0, -0.3, -0.1, 0.0, 0.2, 0.0])
    times_s = cycles(2.5)
    first, second = cut_runs(
        recording({"joint3": current}, times_s, input_times_s=input_times_s), joints=ROBOT_JOINTS
    )
    assert first.duration_s == second.duration_s == 0.6
    assert first.input_times_s == pytest.approx([0.0, 0.2])
    assert first.input_current_A.tolist() == [-0.3, -0.1]
    assert "no input came" not in " ".join(first.notes)


def test_lost_commands_hold_the_last_one_and_are_reported() -> None:
    keep = np.ones(41, dtype=bool)
    keep[15:25] = False
    input_times_s = cycles()[keep]
    (run,) = cut_runs(
        recording(
            {"joint3": step(input_times_s)},
            input_times_s=input_times_s,
        ),
        joints=ROBOT_JOINTS,
    )
    assert run.input_times_s.tolist() == [0.0]
    assert run.duration_s == 0.6
    assert "no input came for 275 ms" in " ".join(run.notes)


def test_commands_that_stop_are_held_until_the_last_joint_state() -> None:
    input_times_s = cycles(0.5)
    (run,) = cut_runs(
        recording(
            {"joint3": step(input_times_s)},
            input_times_s=input_times_s,
        ),
        joints=ROBOT_JOINTS,
    )
    assert run.duration_s == 0.75
    assert run.times_s[-1] == 0.75
    assert "the input ends while joint3 is still driven" in " ".join(run.notes)


def test_a_recording_that_starts_driven_has_no_rest() -> None:
    times_s = cycles(start_s=0.0)
    (run,) = cut_runs(
        recording({"joint3": step(times_s)}, times_s),
        joints=ROBOT_JOINTS,
    )
    assert run.before_times_s.size == 0
    assert "no joint state at rest" in " ".join(run.notes)


def test_a_joint_that_moves_before_it_is_driven_is_reported() -> None:
    moving = recording({"joint3": step(cycles())})
    assert "joint3 moved by 0.225 before it was driven" in " ".join(
        cut_runs(moving, joints=ROBOT_JOINTS)[0].notes
    )
    still = recording(
        {"joint3": step(cycles())},
        positions={"joint3": np.maximum(cycles(), 0.0)},
    )
    assert cut_runs(still, joints=ROBOT_JOINTS)[0].notes == ()


def test_a_command_of_almost_nothing_is_zero() -> None:
    with refused(
        "no joint was driven: /current_command is zero throughout .*record the probe.*--command-topic"
    ):
        cut_runs(
            recording({"joint3": step(cycles(), value=1e-7)}),
            joints=ROBOT_JOINTS,
        )


@pytest.mark.parametrize("start_s", [0.0, 0.3, -0.1])
def test_two_joints_at_once_are_not_supported(start_s: float) -> None:
    currents = {
        "joint2": step(cycles()),
        "joint4": step(cycles(), start_s, 0.65),
    }
    with refused("joints 'joint[24]' and 'joint[24]' were driven at once; .*one joint at a time"):
        cut_runs(recording(currents), joints=ROBOT_JOINTS)


def test_a_joint_that_the_robot_does_not_drive_or_nobody_recorded() -> None:
    driven = recording({"joint3": step(cycles())})
    with refused("'joint3' was driven, but the robot drives joint1, joint2"):
        cut_runs(driven, joints=("joint1", "joint2"))
    record = driven.joints
    blind = replace(
        driven,
        joints=JointRecord(
            record.times_ns,
            JOINTS[:2],
            record.position[:, :2],
        ),
    )
    with refused("'joint3' was driven but its position was not recorded; recorded: joint1, joint2"):
        cut_runs(blind, joints=ROBOT_JOINTS)


def test_a_push_that_was_broken_off_at_once_does_not_cost_the_others() -> None:
    times_s = cycles(end_s=4.0)
    current = step(times_s, 1.0, 1.05) + step(times_s, 2.5, 3.1)
    (run,) = cut_runs(
        recording({"joint3": current}, times_s),
        joints=ROBOT_JOINTS,
    )
    assert run.name == "bag#2" and run.duration_s == pytest.approx(0.6)
    assert any(note.startswith("left out: bag#1: only") for note in run.notes)


def test_too_few_samples() -> None:
    with refused(r"only 4 joint states lie in the 0.075 s in which joint3 was driven; at least 5"):
        cut_runs(
            recording({"joint3": step(cycles(), end_s=0.075)}),
            joints=ROBOT_JOINTS,
        )
    assert (
        len(
            cut_runs(recording({"joint3": step(cycles(), end_s=0.1)}), joints=ROBOT_JOINTS)[
                0
            ].times_s
        )
        == 5
    )


def test_input_and_joint_states_that_do_not_meet() -> None:
    with refused("only 0 joint states lie in"):
        cut_runs(
            recording(
                {"joint3": step(cycles())},
                cycles() + 100.0,
                input_times_s=cycles(),
            ),
            joints=ROBOT_JOINTS,
        )


def test_no_input() -> None:
    silent = replace(recording({}), inputs=None)
    with refused("holds no input current; record /applied_effort or /current_command"):
        cut_runs(silent, joints=ROBOT_JOINTS)


# --- measured effort -------------------------------------------------------------------------------------------------


def measured(
    currents: Mapping[str, FloatArray],
    sigma_A: float = 0.003,
    rest_A: Sequence[float] = (0.0,) * 5,
    seed: int = 0,
) -> Recording:
    """What motors report: noise on all joints, a rest level each, and still joints but for the one that moves most."""
    generator = np.random.default_rng(seed)
    noisy = {
        name: currents.get(name, 0.0)
        + rest
        + generator.normal(
            0.0,
            sigma_A,
            len(cycles()),
        )
        for name, rest in zip(JOINTS, rest_A, strict=True)
    }
    still = {name: np.zeros(len(cycles())) for name in JOINTS}
    return recording(
        noisy, positions=still | {"joint3": np.maximum(cycles(), 0.0)}, source=MEASURED_EFFORT
    )


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("value", [-0.3, 0.05])
def test_a_measured_run_begins_after_the_last_quiet_sample(value: float, seed: int) -> None:
    # the motors report what they did before the sample: the first loud one is at 0.025 s, the last at 0.6 s
    current = step(cycles(), CYCLE_S, 0.625, value)
    (run,) = cut_runs(
        measured({"joint3": current}, seed=seed),
        joints=ROBOT_JOINTS,
    )
    assert run.joint == "joint3"
    assert run.source == MEASURED_EFFORT
    assert run.onset_ns == ONSET_NS
    assert run.duration_s == 0.6
    assert "the onset may be up to 25.0 ms later than taken" in " ".join(run.notes)
    assert run.input_times_s[:3] == pytest.approx([0.0, 0.025, 0.05])
    assert run.input_current_A.mean() == pytest.approx(value, abs=0.003)


def test_measured_noise_alone_is_no_run() -> None:
    with refused("no joint was driven: measured effort never leaves its rest level for long"):
        cut_runs(measured({}), joints=ROBOT_JOINTS)
    burst = step(cycles(), 0.0, 3 * CYCLE_S)
    with refused("no joint was driven"):
        cut_runs(measured({"joint3": burst}), joints=ROBOT_JOINTS)


def test_measured_rest_levels_of_holding_joints_are_no_drive() -> None:
    rest = (0.0, 0.2, -0.1, 0.05, 0.0)
    (run,) = cut_runs(
        measured(
            {"joint3": step(cycles(), CYCLE_S)},
            rest_A=rest,
        ),
        joints=ROBOT_JOINTS,
    )
    assert run.joint == "joint3"
    # the current itself, not its change
    assert run.input_current_A.mean() == pytest.approx(-0.4, abs=0.003)


def test_joints_that_answer_the_moving_one_are_held() -> None:
    currents = {
        "joint3": step(cycles(), CYCLE_S),
        "joint2": step(cycles(), 0.1, 0.5, 0.08),
    }
    (run,) = cut_runs(measured(currents), joints=ROBOT_JOINTS)
    assert run.joint == "joint3"


def test_measured_currents_on_two_still_joints_cannot_be_separated() -> None:
    currents = {
        "joint1": step(cycles(), CYCLE_S),
        "joint2": step(cycles(), CYCLE_S),
    }
    with refused("joints 'joint1' and 'joint2' were driven at once"):
        cut_runs(measured(currents), joints=ROBOT_JOINTS)


def test_measured_currents_of_motors_that_the_robot_does_not_have_are_ignored() -> None:
    currents = {
        "joint3": step(cycles(), CYCLE_S),
        "gripper_left_joint": step(cycles(), CYCLE_S),
    }
    (run,) = cut_runs(
        measured(currents),
        joints=JOINTS[:4],
    )
    assert run.joint == "joint3"


# --- recordings ------------------------------------------------------------------------------------------------------


def read(path: Path, effort_unit: str | None = None) -> Recording:
    constants = dict.fromkeys(JOINTS, 1.7826)
    return read_recording(
        path, effort_unit=effort_unit, nominal_torque_constants=constants, joint_order=JOINTS
    )


def check_against_truth(folder: Path) -> int:
    truth = json.loads((folder / "truth.json").read_text())
    bags = sorted(folder.glob("bag_*"))
    for bag in bags:
        (run,) = cut_runs(read(bag), joints=ROBOT_JOINTS)
        assert run.joint == truth["probe"], bag
        assert run.duration_s == pytest.approx(truth["duration"], abs=1e-9), bag
        assert run.input_current_A.tolist() == [truth["commanded_current_A"]], bag
        assert run.onset_ns == ONSET_NS, bag
        for joint, position in truth["start"].items():
            if joint != run.joint:
                assert run.held[joint] == pytest.approx(position, abs=0.05), bag
    return len(bags)


def test_the_recordings_of_this_repository() -> None:
    # those of what is in a container hold several runs each: test/benchmarks/contents.py
    folders = sorted({bag.parent for bag in BAGS.glob("*/bag_*")})
    assert len(folders) == 42
    for folder in folders:
        assert check_against_truth(folder)


@pytest.mark.parametrize("level", ["ideal_s00", "quantised_s00", "friction_s00"])
def test_every_simulated_recording_is_one_run_of_its_probe(recordings: Path, level: str) -> None:
    folders = [truth.parent for truth in (recordings / level).glob("fixed_*/truth.json")]
    assert folders
    for folder in folders:
        assert check_against_truth(folder)


def test_both_storages_hold_the_same() -> None:
    folder = BAGS / "friction_s00_fixed_heavy_ball_50g_joint3"
    one, other = (
        read(folder / f"bag_{storage}", effort_unit="N.m") for storage in ("mcap", "sqlite3")
    )
    for quantity in ("times_ns", "position", "velocity", "effort", "current"):
        assert np.array_equal(getattr(one.joints, quantity), getattr(other.joints, quantity))
    assert one.inputs is not None and other.inputs is not None
    assert np.array_equal(one.inputs.current_A, other.inputs.current_A)
    assert np.array_equal(one.inputs.times_ns, other.inputs.times_ns)


def test_measured_effort_finds_the_commanded_run() -> None:
    for folder in sorted(BAGS.glob("*_joint[23]")):
        whole = read(folder / "bag_mcap", effort_unit="N.m")
        (commanded,) = cut_runs(whole, joints=ROBOT_JOINTS)
        assert whole.joints.current is not None
        inputs = InputRecord(
            whole.joints.times_ns,
            JOINTS,
            whole.joints.current,
            MEASURED_EFFORT,
        )
        (run,) = cut_runs(
            replace(whole, inputs=inputs),
            joints=ROBOT_JOINTS,
        )
        assert run.joint == commanded.joint
        assert abs(run.onset_ns - commanded.onset_ns) < 20e6
        assert run.duration_s == pytest.approx(0.6, abs=0.04)
        assert np.median(run.input_current_A) == pytest.approx(
            commanded.input_current_A[0], abs=0.01
        )


# --- joint states that repeat ----------------------------------------------------------------------------------------


def broadcast(original: Recording, times: int) -> Recording:
    """What a broadcaster makes of a recording that is so many times faster than the hardware: every state again and again."""
    joints = original.joints
    gaps = np.diff(
        joints.times_ns, append=joints.times_ns[-1] + int(np.median(np.diff(joints.times_ns)))
    )
    stamps = (joints.times_ns[:, None] + gaps[:, None] * np.arange(times) // times).ravel()

    def again(values: FloatArray | None) -> FloatArray | None:
        return None if values is None else np.repeat(values, times, axis=0)

    faster = JointRecord(
        stamps, joints.names, np.repeat(joints.position, times, axis=0,), again(joints.velocity), again(joints.effort),
        again(joints.current), again(joints.reported_effort),
    )  # fmt: skip
    return replace(original, joints=faster)


@pytest.mark.parametrize(
    "name", ["quantised_s00_fixed_heavy_ball_50g_joint3", "realistic_s00_empty_00_joint3"]
)
def test_a_state_that_is_published_again_and_again_counts_once(name: str) -> None:
    """At 200 Hz from servos that are read at 40 Hz the joint seems to stand and to jump: no model explains that."""
    original = read_recording(
        BAGS / name / "bag_mcap", nominal_torque_constants={}, joint_order=JOINTS
    )
    (expected,) = cut_runs(original, joints=ROBOT_JOINTS)
    assert not [note for note in expected.notes if "repeat" in note]
    (run,) = cut_runs(broadcast(original, 5), joints=ROBOT_JOINTS)
    (note,) = [note for note in run.notes if "repeat" in note]
    assert re.fullmatch(
        r"\d+ of \d+ joint states repeat the one before although joint3 moves: they are published faster than they are"
        r" measured; the repeats were left out",
        note,
    )
    kept = np.isin(run.times_s, expected.times_s)
    assert kept.sum() >= len(expected.times_s) - 2 and np.count_nonzero(~kept) <= 1
    assert (
        run.position[kept].tolist()
        == expected.position[np.isin(expected.times_s, run.times_s)].tolist()
    )


def test_a_joint_that_stands_or_creeps_repeats_its_position_rightly() -> None:
    """From one count of the encoder to the next nothing changes, and that is a measurement."""
    times_s = cycles()
    creeping = 0.001534 * np.floor(12.0 * np.maximum(times_s, 0.0))
    still = {name: np.zeros_like(times_s) for name in JOINTS}
    for position in (np.zeros_like(times_s), creeping):
        (run,) = cut_runs(
            recording(
                {"joint3": step(times_s)},
                positions={**still, "joint3": position},
            ),
            joints=ROBOT_JOINTS,
        )
        assert len(run.times_s) == 25 and not run.notes


def test_who_holds_beside_a_moving_joint_is_left_out_as_slowly_compared() -> None:
    """Each interval against each other one, without what makes it fast."""
    rng = np.random.default_rng(5)
    times_ns = ONSET_NS + np.cumsum(rng.integers(1_000_000, 40_000_000, 400))
    steps = rng.normal(size=(400, 3)) * [0.02, 0.002, 1e-5]
    record = JointRecord(times_ns, JOINTS[:3], np.cumsum(steps, axis=0))
    intervals = []
    for _ in range(120):
        onset_ns, end_ns = sorted(rng.integers(times_ns[0] - 10**9, times_ns[-1] + 10**9, 2))
        onset_ns = max(onset_ns, end_ns - int(rng.choice([10**6, 10**8, 2 * 10**9])))
        joint = str(rng.choice(JOINTS[:3]))
        intervals.append(_Interval(joint, 0, 1, int(onset_ns), int(end_ns), ()))

    def span(joint: str, interval: _Interval) -> float:
        rows = (times_ns >= interval.onset_ns) & (times_ns <= interval.end_ns)
        if not rows.any():
            return 0.0
        return float(np.ptp(record.position[rows, record.column(joint)]))

    def holds(interval: _Interval) -> bool:
        least = max(MOVING_SPAN, 5.0 * span(interval.joint, interval))
        for other in intervals:
            overlap = other.onset_ns < interval.end_ns and interval.onset_ns < other.end_ns
            if overlap and span(other.joint, interval) > least:
                return True
        return False

    kept = [interval for interval in intervals if not holds(interval)]
    assert 0 < len(kept) < len(intervals)
    assert _without_holding_joints(record, intervals) == kept
