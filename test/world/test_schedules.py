"""Pushes and weighings in the simulated world while things go wrong; see `support.schedules`."""

from __future__ import annotations

import json
import subprocess
import sys
from collections import Counter
from itertools import product
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

from support.schedules import FAULTY, KINDS, PLANS, THREADS, drawn

SCHEDULES = Path(__file__).resolve().parents[1] / "support" / "schedules.py"
PLAYED = sorted(
    range(1000),
    key=lambda seed: list(PLANS).index(drawn(seed).plan),
)
BLOCKS = PLAYED[:650], PLAYED[650:]
"""Two workers may play them, a process each: pushes alone, and weighings with so many pushes that both take as long."""
FEW = [seed for seed in range(1000, 1040) if drawn(seed).plan == "push"][:10]
"""Without ``--long``."""
FAILED = (20130, 37, 100626, 150837, 200652, 527, 301920, 600354, 1801283, 3417916, 3212174, 549)
"""Schedules after which something was not true once: a disk is full; messages are doubled while an encoder slips; the clock is
set while a command is on its way, in a push and in a weighing; the request of a service is lost, which is sent again now; a
shoulder's servo switches itself off, and the elbow was pushed while the arm leaned on a stop; an encoder slips between a
request and its first command, and the driver alone had seen it; commands wait for a driver that stands still for longer than it
remembers that the clock was set; and for longer than a message waits that is not by another clock; the
last word of a sequence is lost; a joint creeps the other way before a push that hardly moves it; and a node that was started again
says at rest that it is well, though what it was asked for is forgotten."""
RECORDED = (62, 178, 244)
"""Weighings: while messages are lost and late, the bus drops answers, and messages are doubled and reordered."""


def test_every_kind_is_among_them() -> None:
    plans = [drawn(seed) for seed in PLAYED]
    kinds = Counter((each.plan, fault.kind) for each in plans for fault in each.faults)
    assert {plan for plan, _ in kinds} == set(PLANS)
    assert {kind for _, kind in kinds} == {*KINDS, THREADS}
    for kind in (*KINDS, THREADS):
        assert sum(kinds[plan, kind] for plan in PLANS) >= 5
        assert kinds["push", kind] > 50 or kind == "disk"
    assert sum(each.plan == "weigh" for each in plans) > 50
    assert sum(bool(each.network.lose or each.network.late) for each in plans) > 20
    assert all(drawn(seed).plan == "weigh" for seed in RECORDED)


def test_every_node_is_hit_and_a_cable_is_off_for_long() -> None:
    faults = [fault for seed in PLAYED for fault in drawn(seed).faults]
    ended = {(fault.kind, fault.whom) for fault in faults}
    assert set(product(("kill", "restart", "end", "stall", THREADS), FAULTY)) <= ended
    unplugged_s = [fault.lasts_s for fault in faults if fault.kind == "unplug"]
    assert max(unplugged_s) > 1.0, "longer than a servo waits"


def play(folder: Path, *words: str) -> dict[str, Any]:
    """In a process of its own, which forks."""
    kept = folder / f"{len(list(folder.iterdir()))}.json"
    command = [
        sys.executable,
        str(SCHEDULES),
        *words,
        "--json",
        str(kept),
    ]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-6000:] + done.stderr[-2000:]
    found: dict[str, Any] = json.loads(kept.read_text())
    return found


@pytest.fixture(scope="module")
def few(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    seeds = map(str, (*FAILED, *FEW, *RECORDED))
    return play(tmp_path_factory.mktemp("few"), ",".join(seeds), "--digest")


def test_a_few_schedules(few: dict[str, Any]) -> None:
    assert few["schedules"] == len(FAILED) + len(FEW) + len(RECORDED)
    assert not few["failed"]


@pytest.mark.long
@pytest.mark.parametrize("block", range(len(BLOCKS)))
def test_schedules(tmp_path: Path, block: int) -> None:
    found = play(
        tmp_path,
        ",".join(map(str, BLOCKS[block])),
        "--together",
        "1",
    )
    assert found["schedules"] == len(BLOCKS[block])
    assert not found["failed"]


@pytest.mark.long
def test_the_same_seed_gives_the_same_bytes(
    few: dict[str, Any],
    tmp_path: Path,
) -> None:
    """Whatever else was played before it."""
    again = play(tmp_path, ",".join(map(str, RECORDED)), "--digest")["recorded"]
    assert again == {seed: few["recorded"][seed] for seed in again}
    assert len(set(again.values())) == len(RECORDED)
