"""When samples were taken that arrive in bursts: made of known instants, each handed on at the next poll."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.small_bags import JOINTS, notes, positions, read, refused, state, times, write_bag

from proprio_ros.recordings.arrivals import of_bursts
from proprio_ros.recordings.runs import cut_runs
from proprio_ros.records import TimeArray

PERIOD_NS = 10_000_000
TRUE_NS = 10**18 + PERIOD_NS * np.arange(3000, dtype=np.int64)


def polled(
    true_ns: TimeArray,
    every_s: float,
    scatter_s: float,
    seed: int = 1,
) -> TimeArray:
    """When each is handed on, by somebody who looks every so often."""
    lasts_s = 1e-9 * float(true_ns[-1] - true_ns[0]) + 1.0
    rng = np.random.default_rng(seed)
    between_s = np.maximum(
        rng.normal(every_s, scatter_s, int(2.0 * lasts_s / every_s)),
        1e-4,
    )
    polls_ns = true_ns[0] + np.rint(1e9 * np.cumsum(between_s)).astype(np.int64)
    return polls_ns[np.searchsorted(polls_ns, true_ns)]


@pytest.mark.parametrize("size", [2, 3, 5, 20, 50])
def test_bursts_of_one_size_are_spread(size: int) -> None:
    number = np.arange(len(TRUE_NS))
    last = np.minimum(
        number // size * size + size - 1,
        len(TRUE_NS) - 1,
    )
    found = of_bursts(TRUE_NS[last] + 20_000 * (number % size))
    assert found is not None
    assert found.steady
    assert found.moved == len(TRUE_NS)
    assert np.abs(found.times_ns - TRUE_NS).max() < 1_000_000 + 20_000 * size


@pytest.mark.parametrize("every_s, scatter_s", [(0.047, 0.004), (0.03, 0.0), (0.2, 0.05)])
def test_polls_of_any_period_are_spread(every_s: float, scatter_s: float) -> None:
    found = of_bursts(polled(TRUE_NS, every_s, scatter_s))
    assert found is not None
    assert found.steady
    assert found.period_s == pytest.approx(0.01, rel=0.02)
    assert np.abs(found.times_ns - TRUE_NS).max() < 1.5 * PERIOD_NS


def test_only_a_part_and_lost_messages() -> None:
    partly = TRUE_NS.copy()
    partly[1000:2000] = polled(
        TRUE_NS[1000:2000],
        0.047,
        0.004,
    )
    found = of_bursts(np.sort(partly))
    assert found is not None
    assert 900 < found.moved < 1100
    assert np.abs(found.times_ns - TRUE_NS).max() < 1.5 * PERIOD_NS
    lost = TRUE_NS[np.r_[0:1000, 1030:3000]]
    found = of_bursts(polled(lost, 0.047, 0.004))
    assert found is not None
    # within the burst that lacks some nobody knows which
    near = np.abs(np.arange(len(lost)) - 1000) < 8
    assert np.abs(found.times_ns - lost)[~near].max() < 1.5 * PERIOD_NS


def test_what_comes_by_chance_or_late_is_no_burst() -> None:
    rng = np.random.default_rng(2)
    chance = np.sort(rng.integers(0, 30 * 10**9, 3000))
    jittered = np.sort(TRUE_NS + rng.integers(0, 9_000_000, 3000))
    halved = np.concatenate([TRUE_NS[:1000], TRUE_NS[1000] + 2 * PERIOD_NS * np.arange(1000)])
    for times_ns in (chance, jittered, halved, TRUE_NS, TRUE_NS[:4]):
        assert of_bursts(times_ns) is None


def test_a_rate_that_is_not_steady_is_not_made_up() -> None:
    rng = np.random.default_rng(3)
    sizes = rng.integers(1, 30, 200)
    arrived = np.repeat(
        TRUE_NS[0] + 10**8 * np.arange(200),
        sizes,
    )
    found = of_bursts(arrived)
    assert found is not None
    assert not found.steady


def test_a_push_in_bursts_is_retimed_and_one_without_a_rate_refused(tmp_path: Path) -> None:
    stamps = times()
    last = [stamps[min(row // 4 * 4 + 3, len(stamps) - 1)] + row % 4 for row in range(len(stamps))]
    bursts = [
        state(
            arrived,
            positions(true),
            effort=[0.0, 0.0, -0.53 * (10 <= row < 34), 0.0, 0.0],
        )
        for row, (arrived, true) in enumerate(zip(last, stamps, strict=True))
    ]
    recording = read(write_bag(tmp_path / "bag", bursts), effort_unit="N.m")
    assert "messages come in bursts" in notes(recording)
    assert np.abs(np.diff(recording.joints.times_ns) - 25_000_000).max() < 10
    (run,) = cut_runs(recording, joints=JOINTS)
    assert run.duration_s == pytest.approx(0.6, abs=0.03)
    few = [
        state(stamps[0] + 10**9 * (row // 14) + row, positions(true))
        for row, true in enumerate(stamps)
    ]
    with refused("comes in bursts"):
        read(write_bag(tmp_path / "few", few), states_only=True)
