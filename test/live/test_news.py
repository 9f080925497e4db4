"""What is left out of what waits too long, and how late messages are, by clocks that nobody knows."""

from __future__ import annotations

import pytest

from proprio_ros.identification.regression.online import Stretch
from proprio_ros.live.news import DRIFT, ROOM_S, SLACK_S, Arrival, Backlog, Lag
from proprio_ros.recordings.messages import RawMessage

NEEDED = Stretch(0.25, 0.009)
STARTS_NS = 1_700_000_000 * 10**9


def arrival(
    at_s: float,
    role: str = "joint_states",
    size: int = 100,
) -> Arrival:
    raw = RawMessage("/joint_states", "sensor_msgs/msg/JointState", 0, bytes(size))
    return Arrival(
        role,
        raw,
        STARTS_NS + round(1e9 * at_s),
        at_s,
    )


def filled(seconds: float, rate_hz: float) -> Backlog:
    backlog = Backlog()
    for number in range(round(seconds * rate_hz)):
        backlog.put(arrival(number / rate_hz))
    return backlog


def taken(
    backlog: Backlog,
    needed: Stretch = NEEDED,
) -> list[float]:
    found = []
    while (each := backlog.take(needed)) is not None:
        found.append(each.sent_s)
    return found


def test_in_step_nothing_is_left_out() -> None:
    backlog = filled(SLACK_S, 500.0)
    assert len(taken(backlog)) == 50
    assert backlog.left_out == 0
    assert not len(backlog)


def test_what_waits_is_thinned_to_what_the_estimate_needs() -> None:
    found = taken(filled(0.4, 500.0))
    newest_s = 0.4 - 0.002
    old = [at_s for at_s in found if newest_s - at_s > SLACK_S]
    assert old[1] - old[0] == pytest.approx(0.01)
    assert len(old) == pytest.approx(100.0 * (newest_s - SLACK_S), abs=2)
    assert found[-1] == newest_s


def test_samples_that_are_needed_are_not_left_out() -> None:
    assert len(taken(filled(0.4, 100.0))) == 40
    assert len(taken(filled(0.4, 500.0), Stretch(0.25, 0.0))) == 200


@pytest.mark.parametrize("seconds", [0.6, 4.0, 60.0])
def test_of_a_long_queue_the_newest_stretch_is_left(seconds: float) -> None:
    backlog = filled(seconds, 500.0)
    found = taken(backlog)
    assert found[0] == pytest.approx(found[-1] - NEEDED.length_s, abs=0.011)
    assert len(found) < 500.0 * (NEEDED.length_s + ROOM_S)


def test_two_publishers_of_one_topic_do_not_push_each_other_out() -> None:
    backlog = Backlog()
    for number in range(200):
        backlog.put(arrival(0.002 * number, size=100))
        backlog.put(arrival(0.002 * number + 0.0005, size=60))
    sizes = []
    while (each := backlog.take(NEEDED)) is not None:
        sizes.append(len(each.raw.data))
    assert sizes.count(60) == pytest.approx(sizes.count(100), abs=2)


def test_a_supply_voltage_is_always_heard() -> None:
    backlog = Backlog()
    backlog.put(arrival(0.0, "battery_state"))
    backlog.put(arrival(60.0))
    first = backlog.take(NEEDED)
    assert first is not None
    assert first.role == "battery_state"


def lags(rows: list[tuple[float, float, float]]) -> list[float]:
    """How late messages are [s]; of each: when it is heard, its stamp, and a clock that nobody sets [s]."""
    lag = Lag()
    found = []
    for row in rows:
        lag.note(*(round(1e9 * each) for each in row))
        found.append(1e-9 * lag.late_ns)
    return found


@pytest.mark.parametrize("ahead_s", [0.0, 3600.0, -3600.0])
def test_late_is_what_comes_later_than_ever_whatever_the_clocks(ahead_s: float) -> None:
    on_the_way_s = [0.001, 0.0, 0.5, 2.0, 0.0]
    rows = [
        (5000.0 + at + late, 5000.0 + at + ahead_s, at + late)
        for at, late in enumerate(on_the_way_s)
    ]
    assert lags(rows) == pytest.approx([0.0, *on_the_way_s[1:]], abs=6.0 * DRIFT)


@pytest.mark.parametrize("step_s", [-5.0, 5.0])
def test_a_clock_that_was_set_makes_nothing_late(step_s: float) -> None:
    here = [(5000.0 + at + step_s * (at > 9), 5000.0 + at, at) for at in range(20)]
    there = [(5000.0 + at, 5000.0 + at + step_s * (at > 9), at) for at in range(20)]
    for rows in (here, there):
        assert max(lags([(*map(float, row),) for row in rows])) < 0.01  # type: ignore[misc]


def test_clocks_that_drift_apart_do_not_become_late() -> None:
    """By 50 parts in a million, for a day."""
    rows = [(5000.0 + at, 5000.0 + at * (1.0 - 5e-5), float(at)) for at in range(0, 86400, 60)]
    assert max(lags(rows)) < 0.01
