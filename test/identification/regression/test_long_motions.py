"""A long motion counts as what it shows anew, and of it no more is kept than that."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.arm_in_motion import THREE, Twin, write_robot

from proprio_ros.identification.regression.long_motions import (
    COMES_AGAIN,
    INDEPENDENT_STRETCHES,
    MOST_STRETCHES,
    counted_share,
    counting,
    kept_windows,
)
from proprio_ros.identification.regression.motion_fit import fit_empty, fit_payload
from proprio_ros.identification.regression.solve import rows_of_stretches
from proprio_ros.identification.regression.weak_form import Windows, across_gaps
from proprio_ros.recordings.motions import LONGEST_GAP_S, Motion
from proprio_ros.robot import load_robot

PER_STRETCH = 20  # windows


def test_a_minute_counts_in_full_and_an_hour_as_no_more_than_what_comes_again_allows() -> None:
    stretches = np.arange(1.0, 2000.0)
    counted = counting(stretches)
    full = stretches <= INDEPENDENT_STRETCHES
    assert np.array_equal(counted[full], stretches[full])
    assert (np.diff(counted) > 0.0).all()
    assert counted[-1] < INDEPENDENT_STRETCHES / COMES_AGAIN
    # the variance of a mean: a part that comes again, and one that does not
    variance = 1.0 / counted[~full]
    part = (1.0 - COMES_AGAIN) / stretches[~full] + COMES_AGAIN / INDEPENDENT_STRETCHES
    assert variance == pytest.approx(part)


def test_of_a_short_motion_everything_is_kept() -> None:
    stretch = np.repeat(np.arange(MOST_STRETCHES), PER_STRETCH)
    assert kept_windows(np.ones((len(stretch), 3), dtype=bool), stretch).all()


def test_of_an_hour_each_joint_keeps_its_stretches_whole_and_from_all_of_it() -> None:
    stretch = np.repeat(np.arange(1440), PER_STRETCH)
    moves = np.zeros((len(stretch), 3), dtype=bool)
    moves[:, 0] = True
    moves[stretch % 2 == 1, 1] = True
    moves[(stretch >= 1000) & (stretch < 1050), 2] = True  # two minutes of it
    kept = kept_windows(moves, stretch)
    windows = np.bincount(stretch[kept], minlength=1440)
    assert set(windows) == {0, PER_STRETCH}
    of_joints = [np.unique(stretch[kept & of_joint]) for of_joint in moves.T]
    assert len(of_joints[0]) <= 3 * MOST_STRETCHES
    assert len(of_joints[1]) >= MOST_STRETCHES
    assert np.array_equal(of_joints[2], np.arange(1000, 1050))
    assert np.diff(of_joints[0]).max() <= 2 * 1440 / MOST_STRETCHES


def test_a_motion_that_repeats_itself_is_seen_in_all_its_phases() -> None:
    """Also one that repeats itself with the very step of what is kept."""
    step = 1440 // MOST_STRETCHES
    stretch = np.repeat(np.arange(1440), PER_STRETCH)
    kept = kept_windows(np.ones((len(stretch), 1), dtype=bool), stretch)
    phases = np.bincount(np.unique(stretch[kept]) % step, minlength=step)
    assert phases.min() >= 0.5 * MOST_STRETCHES / step


def test_equations_count_by_the_stretches_of_their_joint_in_their_motion() -> None:
    stretch = np.concatenate([np.repeat(np.arange(96), 5), np.repeat(np.arange(200, 210), 5)])
    motion = (stretch >= 200).astype(np.int64)
    joint = np.where(np.arange(len(stretch)) % 5 == 0, 1, 0)
    short = (joint == 1) & (stretch >= 10) & (motion == 0)
    share = counted_share(motion[~short], joint[~short], stretch[~short])
    long = (motion == 0) & (joint == 0)
    assert share[long[~short]] == pytest.approx(float(counting(np.array(96.0))) / 96.0)
    assert (share[~long[~short]] == 1.0).all()


def test_rows_of_stretches_in_order_and_out_of_it_are_the_same() -> None:
    rng = np.random.default_rng(1)
    stretch = np.repeat(np.array([2, 3, 7, 40]), [3, 1, 4, 2])
    values = rng.standard_normal(len(stretch))
    order = rng.permutation(len(stretch))
    in_order = [values[rows].sum() for rows in rows_of_stretches(stretch)]
    shuffled = [values[order][rows].sum() for rows in rows_of_stretches(stretch[order])]
    assert in_order == pytest.approx(shuffled)


def _gaps(times_s: np.ndarray, known_s: np.ndarray) -> list[tuple[float, float]]:
    """Begin and end of each stretch that is too long without anything known [s].

    Args:
        times_s: Of all samples [s], shape (T,).
        known_s: Of those that are known [s], shape (K,).
    """
    gaps = [(a, b) for a, b in itertools.pairwise(known_s) if b - a > LONGEST_GAP_S]
    if known_s[0] - times_s[0] > LONGEST_GAP_S:
        gaps.append((-np.inf, known_s[0]))
    if times_s[-1] - known_s[-1] > LONGEST_GAP_S:
        gaps.append((known_s[-1], np.inf))
    return gaps


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_windows_across_gaps_are_those_that_overlap_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    times_s = np.cumsum(rng.choice([0.01, 0.3], 600, p=[0.97, 0.03]))
    current = np.where(rng.random((600, 1)) < 0.02, np.nan, 1.0)
    current[: int(rng.integers(0, 30))] = np.nan
    motion = Motion("m", ("j",), times_s, np.zeros((600, 1)), current, {}, "measured current")
    evenly_s = np.arange(times_s[0], times_s[-1], 0.01)
    windows = Windows.over(len(evenly_s), 50, 12)
    gaps_s = _gaps(times_s, times_s[np.isfinite(current[:, 0])])
    expected = []
    for start in windows.starts:
        first_s = evenly_s[start]
        last_s = evenly_s[start + 49]
        expected.append(any(first_s < end and last_s > begin for begin, end in gaps_s))
    assert across_gaps(motion, ["j"], evenly_s, windows)[:, 0].tolist() == expected


def _again(motion: Motion, times: int) -> Motion:
    """The same so many times over, with a pause of a second in between."""
    period_s = float(motion.times_s[-1]) + 1.0
    return replace(
        motion,
        times_s=np.concatenate([motion.times_s + period_s * n for n in range(times)]),
        position=np.tile(motion.position, (times, 1)),
        current_A=np.tile(motion.current_A, (times, 1)),
    )


def test_a_motion_played_again_and_again_says_nothing_new(tmp_path: Path) -> None:
    """A minute of it, and eight: the mass stays, and the interval does not shrink as if all of it were new."""
    pytest.importorskip("mujoco")
    robot = load_robot(write_robot(tmp_path, build=THREE))
    arm = Twin(11, THREE)
    held = arm.payload(np.random.default_rng(11))
    empty = arm.record("empty", 60.0)
    loaded = arm.record("loaded", 60.0, held)
    once = fit_payload(robot, [loaded], fit_empty(robot, [empty]))
    often = fit_payload(robot, [_again(loaded, 8)], fit_empty(robot, [_again(empty, 8)]))
    noise = "what differs from stretch to stretch"
    assert 0.5 < often.parts[noise] / once.parts[noise] < 1.05
    assert 0.7 * once.half_width < often.half_width < 1.05 * once.half_width
    for fit in (once, often):
        assert abs(float(fit.values[0]) - held[0]) < fit.half_width
    # and of the longer one no more is kept than of four minutes
    assert often.stretches <= 1.3 * MOST_STRETCHES
    pulls = np.abs(often.arm.values - often.arm.prior) / often.arm.std
    assert pulls.max() < 3.0
