"""Clocks that step, that are not set yet or that count: made of a motion in closed form, whose every sample says when it was."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.bends.bend import all_bends
from support.bends.tape import tape_of
from support.small_bags import CONSTANTS, JOINTS, read, refused

from proprio_ros.errors import RecordingError
from proprio_ros.recordings.clock_faults import clock_faults_of
from proprio_ros.recordings.columns import JointColumns
from proprio_ros.recordings.runs import cut_runs
from proprio_ros.records import FloatArray, TimeArray

BAGS = Path(__file__).resolve().parents[2] / "bags"
BEGIN_NS = 1_760_000_000 * 10**9
PERIOD_NS = 10_000_000
COUNT = 3000
TRUE_NS = BEGIN_NS + PERIOD_NS * np.arange(COUNT, dtype=np.int64)
LATE_NS = 2_000_000  # what the recorder is behind


def positions(true_ns: TimeArray) -> FloatArray:
    """Two joints; the third is the time itself, so that each sample says when it was [s]."""
    times_s = 1e-9 * (true_ns - BEGIN_NS)
    swing = np.column_stack([np.sin(0.9 * times_s), 0.7 * np.cos(1.7 * times_s)])
    return np.column_stack([swing, times_s])


def columns(bag_ns: TimeArray, stamp_ns: TimeArray) -> JointColumns:
    """Messages as a bag hands them out, in the order of recording."""
    order = np.argsort(bag_ns, kind="stable")
    values = {"position": positions(TRUE_NS)[order]}
    return JointColumns(
        bag_ns[order],
        stamp_ns[order],
        ("a", "b", "t"),
        values,
        [],
    )


def stepped(
    times_ns: TimeArray,
    by_s: float,
    at: float = 0.5,
) -> TimeArray:
    return times_ns + np.where(
        np.arange(COUNT) >= at * COUNT,
        round(1e9 * by_s),
        0,
    )


def true_s(found: JointColumns) -> FloatArray:
    return found.values["position"][:, 2]


def own_s(found: JointColumns) -> FloatArray:
    """The times that were found, as they would be handed on."""
    times_ns = np.where(
        found.stamp_ns == 0,
        found.bag_ns,
        found.stamp_ns,
    )
    return 1e-9 * (times_ns - BEGIN_NS)


def same_pace(found: JointColumns, parts: int) -> bool:
    """Whether times go as they truly went, in each of so many parts, and every part is behind the one before."""
    offset = own_s(found) - true_s(found)
    jumps = np.flatnonzero(np.abs(np.diff(offset)) > 1e-3)
    return len(jumps) == parts - 1 and bool(np.all(np.diff(own_s(found)) > 0.0))


@pytest.mark.parametrize("by_s", [-3.2, -0.3, 0.3, 3.2, 1000.0, -1000.0])
def test_a_step_of_header_stamps_is_taken_out_by_the_recorders_clock(by_s: float) -> None:
    bent = columns(TRUE_NS + LATE_NS, stepped(TRUE_NS, by_s))
    clock = clock_faults_of("/states", bent)
    found = clock.mended(bent)
    assert len(found.bag_ns) == COUNT
    assert np.abs(own_s(found) - true_s(found)).max() < 1e-6
    assert f"step by {by_s:+.3g} s after 15.0 s" in clock.notes[0]
    assert clock.cuts_ns(unstamped=True) == ()


@pytest.mark.parametrize("by_s", [-3.2, -0.3, 0.3, 3.2, 1000.0, -1000.0])
def test_header_stamps_count_where_the_recorders_clock_steps(by_s: float) -> None:
    bent = columns(stepped(TRUE_NS + LATE_NS, by_s), TRUE_NS)
    clock = clock_faults_of("/states", bent)
    found = clock.mended(bent)
    assert len(found.bag_ns) == COUNT
    assert np.abs(own_s(found) - true_s(found)).max() < 1e-6
    assert np.all(found.bag_ns - found.stamp_ns == LATE_NS)
    assert "recorder's clock steps" in clock.notes[0]


def test_two_steps_of_one_clock() -> None:
    twice = stepped(stepped(TRUE_NS, -1.5, 0.3), 4.0, 0.7)
    for bent in (columns(TRUE_NS + LATE_NS, twice), columns(twice + LATE_NS, TRUE_NS)):
        clock = clock_faults_of("/states", bent)
        found = clock.mended(bent)
        assert len(clock.notes) == 2
        assert np.abs(own_s(found) - true_s(found)).max() < 1e-6
        assert np.all(found.bag_ns - found.stamp_ns == LATE_NS)


def test_commands_without_stamps_are_left_out_where_the_recorders_clock_says_two_things() -> None:
    bent = columns(stepped(TRUE_NS + LATE_NS, -3.2), TRUE_NS)
    clock = clock_faults_of("/states", bent)
    commands_ns = stepped(TRUE_NS, -3.2)
    times = clock.times(commands_ns, np.zeros_like(commands_ns))
    assert np.array_equal(times.bag_ns[times.known], TRUE_NS[times.known])
    assert 600 < int((~times.known).sum()) < 660
    ((begin_ns, end_ns),) = clock.cuts_ns(unstamped=True)
    unknown = TRUE_NS[~times.known]
    assert begin_ns <= unknown.min() + LATE_NS
    assert unknown.max() <= end_ns
    assert clock.cuts_ns(unstamped=False) == ()


@pytest.mark.parametrize("by_s", [-3.2, -0.4, -12.0, 3.2, 1000.0, -1000.0])
def test_where_both_clocks_step_the_recording_is_cut(by_s: float) -> None:
    bent = columns(
        stepped(TRUE_NS + LATE_NS, by_s),
        stepped(TRUE_NS, by_s),
    )
    clock = clock_faults_of("/states", bent)
    found = clock.mended(bent)
    assert same_pace(found, parts=2)
    # what has the same times twice is left out, and little besides
    lost = 0 if abs(by_s) > 20.0 or by_s > 0.0 else 2 * round(-100 * by_s)
    assert lost <= COUNT - len(found.bag_ns) <= lost + 40
    assert "step" in clock.notes[0]
    ((begin_ns, end_ns),) = clock.cuts_ns(unstamped=True)
    assert end_ns - begin_ns > 1.5e8
    assert not np.any((found.bag_ns > begin_ns + 1e6) & (found.bag_ns < end_ns - 7e7))


def test_messages_of_before_the_clock_was_set_are_left_out() -> None:
    zero = np.where(
        np.arange(COUNT) < 200,
        0,
        TRUE_NS,
    )
    simulated = np.where(
        np.arange(COUNT) < 200,
        0,
        TRUE_NS - BEGIN_NS + 57 * 10**9,
    )
    tiny = np.where(
        np.arange(COUNT) < 200,
        10**6 * np.arange(COUNT),
        TRUE_NS,
    )
    for times_ns in (zero, simulated, tiny):
        bent = columns(times_ns, times_ns)
        clock = clock_faults_of("/states", bent)
        found = clock.mended(bent)
        assert len(found.bag_ns) == COUNT - 200
        assert same_pace(found, parts=1)
        assert "200 of 3000 messages have times of before the clock was set" in clock.notes[0]


def test_stamps_of_0_before_simulated_time_are_no_simulated_time() -> None:
    simulated = (TRUE_NS - BEGIN_NS) // 2 + 57 * 10**9
    stamps = np.where(
        np.arange(COUNT) < 200,
        0,
        simulated,
    )
    bent = columns(TRUE_NS, stamps)
    clock = clock_faults_of("/states", bent)
    assert len(clock.mended(bent).bag_ns) == COUNT - 200
    assert "200 of 3000 messages have no stamp" in clock.notes[0]


def test_a_recorder_whose_clock_stood_still_is_named() -> None:
    with refused("all 3000 messages were recorded at 0 s: the recorder's clock stood still"):
        clock_faults_of(
            "/states",
            columns(np.zeros_like(TRUE_NS), np.zeros_like(TRUE_NS)),
        )


def test_stamps_that_count_messages_give_way_to_the_recorders_clock() -> None:
    bent = columns(
        TRUE_NS,
        10**9 * np.arange(COUNT, dtype=np.int64),
    )
    clock = clock_faults_of("/states", bent)
    found = clock.mended(bent)
    assert "numbers of messages" in clock.notes[0]
    assert np.array_equal(own_s(found), true_s(found))


def test_clocks_that_go_on_are_left_alone() -> None:
    rng = np.random.default_rng(11)
    late_ns = rng.integers(0, 30_000_000, COUNT)
    stalled_ns = np.maximum(
        TRUE_NS,
        np.where(
            np.arange(COUNT) < 1500,
            0,
            TRUE_NS[1500] + 2 * 10**9,
        ),
    )
    lost = np.r_[0:1000, 1090:COUNT]
    simulated = (TRUE_NS - BEGIN_NS) * 7 // 10 + 10**9
    whole = columns(TRUE_NS, TRUE_NS)
    cases = {
        "as it is": whole,
        "late by chance": columns(TRUE_NS + late_ns, TRUE_NS),
        "a recorder that stalls and catches up": columns(stalled_ns, TRUE_NS),
        "simulated time at 0.7 of the pace": columns(TRUE_NS, simulated),
        "no stamps": columns(TRUE_NS, np.zeros_like(TRUE_NS)),
        "messages that were lost": whole._replace(
            bag_ns=whole.bag_ns[lost],
            stamp_ns=whole.stamp_ns[lost],
            values={"position": whole.values["position"][lost]},
        ),
    }
    for name, case in cases.items():
        assert clock_faults_of("/states", case).faults == (), name


def test_noise_of_encoders_is_no_second_motion() -> None:
    rng = np.random.default_rng(12)
    still = columns(TRUE_NS, TRUE_NS)
    noisy = rng.normal(0.0, 1e-3, (COUNT, 3))
    gappy = TRUE_NS + np.where(
        np.arange(COUNT) % 200 > 100,
        5_000_000,
        0,
    ) * np.arange(COUNT)
    case = still._replace(
        bag_ns=gappy,
        stamp_ns=gappy,
        values={"position": noisy},
    )
    assert clock_faults_of("/states", case).faults == ()


def test_a_second_publisher_in_a_part_of_the_recording_is_no_step() -> None:
    whole = columns(TRUE_NS, TRUE_NS)
    second = np.arange(1000, 1600)
    bag_ns = np.concatenate([TRUE_NS, TRUE_NS[second] + 3_000_000])
    values = np.concatenate([whole.values["position"], np.zeros((len(second), 3))])
    order = np.argsort(bag_ns, kind="stable")
    mixed = JointColumns(
        bag_ns[order],
        bag_ns[order],
        whole.names,
        {"position": values[order]},
        [],
    )
    assert clock_faults_of("/states", mixed).faults == ()


PUSH = BAGS / "realistic_s00_fixed_light_ball_20g_joint3" / "bag_mcap"


def pushed(folder: Path, name: str, **parameters: object) -> Path:
    """A recorded push, bent."""
    change = all_bends()[name].change
    return change(
        tape_of(PUSH),
        np.random.default_rng(0),
        **parameters,
    ).write(folder / "bent")


@pytest.mark.parametrize("step_s", [-3.2, -0.3, 3.2])
def test_a_push_is_read_as_ever_beside_stamps_that_step(tmp_path: Path, step_s: float) -> None:
    bent = read(pushed(tmp_path, "header_clock_steps", step_s=step_s, at=0.5))
    (run,) = cut_runs(bent, joints=JOINTS)
    (unbent,) = cut_runs(read(PUSH), joints=JOINTS)
    assert np.allclose(run.times_s, unbent.times_s, atol=0.01)
    assert np.array_equal(run.position, unbent.position)
    assert set(CONSTANTS) == set(JOINTS)


@pytest.mark.parametrize("step_s", [-3.2, 3.2])
def test_a_push_during_which_both_clocks_step_is_refused_by_name(
    tmp_path: Path, step_s: float
) -> None:
    bent = read(pushed(tmp_path, "clock_steps", step_s=step_s, at=0.5))
    with pytest.raises(RecordingError, match="the clock steps while joint3 is driven"):
        cut_runs(bent, joints=JOINTS)


def test_what_is_beside_a_cut_belongs_to_no_run() -> None:
    recording = read(PUSH)
    (run,) = cut_runs(recording, joints=JOINTS)
    onset_ns = run.onset_ns
    end_ns = onset_ns + int(1e9 * run.duration_s)
    cuts = ((onset_ns - 10**9, onset_ns - 10**8), (end_ns + 5 * 10**7, end_ns + 10**9))
    (beside,) = cut_runs(
        replace(recording, cuts_ns=cuts),
        joints=JOINTS,
    )
    assert np.array_equal(beside.position, run.position)
    assert beside.before_times_s.size < run.before_times_s.size
    assert beside.after_times_s.size < run.after_times_s.size
