"""Pushes and weighings in the simulated world while things go wrong; see `support.schedules`."""

from __future__ import annotations

import json
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

from support.schedules import FAULTY, KINDS, PLANS, calibrated, drawn

SCHEDULES = Path(__file__).resolve().parents[1] / "support" / "schedules.py"
PLAYED, BLOCKS = range(1000), 2
"""The blocks are parts of the same size, so that two workers may play them, a process each."""
FEW = [seed for seed in range(1000, 1040) if drawn(seed).plan == "push"][:10]
"""Without ``--long``."""
FAILED = (20130, 37, 100626, 150837, 200652, 527, 301920, 600354)
"""Schedules after which something was not true once: a disk is full; messages are doubled while an encoder slips; the clock is
set while a command is on its way, in a push and in a weighing; the request of a service is lost, which is sent again now; a
shoulder's servo switches itself off, and the elbow was pushed while the arm leaned on a stop; an encoder slips between a
request and its first command, and the driver alone had seen it; commands wait for a driver that stands still for longer than it
remembers that the clock was set."""
RECORDED = (62, 178, 244)
"""Weighings: while messages are lost and late, the bus drops answers, and messages are doubled and reordered."""


def test_every_kind_is_among_them() -> None:
    plans = [drawn(seed) for seed in PLAYED]
    kinds = Counter((each.plan, fault.kind) for each in plans for fault in each.faults)
    assert {plan for plan, _ in kinds} == set(PLANS) and {kind for _, kind in kinds} == set(KINDS)
    assert min(sum(kinds[plan, kind] for plan in PLANS) for kind in KINDS) >= 5
    assert min(kinds["push", kind] for kind in KINDS if kind != "disk") > 50 < sum(each.plan == "weigh" for each in plans)
    ended = {(fault.kind, fault.whom) for each in plans for fault in each.faults}
    assert {(kind, whom) for kind in ("kill", "restart", "end", "stall") for whom in FAULTY} <= ended
    assert any(fault.kind == "unplug" and fault.lasts_s > 1.0 for each in plans for fault in each.faults), (
        "longer than a servo waits"
    )
    assert sum(bool(each.network.lose or each.network.late) for each in plans) > 20
    assert all(drawn(seed).plan == "weigh" for seed in RECORDED)


@pytest.fixture(scope="module")
def calibration(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return calibrated(tmp_path_factory.mktemp("calibration"))


def play(calibration: Path, folder: Path, *words: str) -> dict[str, object]:
    """In a process of its own, which forks."""
    kept = folder / f"{len(list(folder.iterdir()))}.json"
    command = [sys.executable, str(SCHEDULES), *words, "--calibration", str(calibration), "--json", str(kept)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-6000:] + done.stderr[-2000:]
    found: dict[str, object] = json.loads(kept.read_text())
    return found


def test_a_few_schedules(calibration: Path, tmp_path: Path) -> None:
    found = play(calibration, tmp_path, ",".join(map(str, (*FAILED, *FEW))))
    assert found["schedules"] == len(FAILED) + len(FEW) and not found["failed"]


@pytest.mark.long
@pytest.mark.parametrize("block", range(BLOCKS))
def test_schedules(calibration: Path, tmp_path: Path, block: int) -> None:
    count = len(PLAYED) // BLOCKS
    found = play(calibration, tmp_path, str(PLAYED.start + block * count), str(count), "--together", "1")
    assert found["schedules"] == count and not found["failed"]


@pytest.mark.long
def test_the_same_seed_gives_the_same_bytes(calibration: Path, tmp_path: Path) -> None:
    seeds = ",".join(map(str, RECORDED))
    first, second = (play(calibration, tmp_path, seeds, "--digest") for _ in range(2))
    recorded: Any = first["recorded"]
    assert recorded == second["recorded"] and len(set(recorded.values())) == len(RECORDED)
