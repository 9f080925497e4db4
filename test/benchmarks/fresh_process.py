"""How long a user waits: a fresh ``proprio replay`` that is not the first, so kernels and Python modules are compiled."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from statistics import median

import case as cases
from case import AGREEMENT_KG, BAG, REPOSITORY, Case, Row, Timing, measure

GOAL_S = 0.6
COMMAND = ("-m", "proprio_ros.cli", "replay", str(BAG), "--probe", "payload", "--json")
# the same call with a clock between its parts
PARTS = f"""
import json
import time
started = time.perf_counter()
from proprio_ros.pipeline.replay import replay
ready = time.perf_counter()
estimate = replay([{str(BAG)!r}])
print(json.dumps({{"import": ready - started, **estimate.timing_s}}))
"""


def environment() -> dict[str, str]:
    """Of a user's second call, which finds our modules compiled, as it finds the kernels."""
    kept = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    kept.pop("PYTHONDONTWRITEBYTECODE", None)
    return kept


def python(*arguments: str) -> str:
    """What a fresh interpreter prints.

    Raises:
        SystemExit: it failed.
    """
    done = subprocess.run(
        [sys.executable, *arguments],
        cwd=REPOSITORY,
        env=environment(),
        capture_output=True,
        text=True,
    )
    # 3: an answer with a verdict other than "accepted"; that of a robot without a calibration is too wide
    if done.returncode not in (0, 3):
        raise SystemExit(f"python {' '.join(arguments[:3])} failed: {done.stderr.strip()}")
    return done.stdout


def rows(
    case: Case,
    repeats: int = 9,
) -> list[Row]:
    """Wall time, and what it is made of."""
    repeats = 1 if cases.once else repeats
    answer = json.loads(python(*COMMAND))
    mass = answer["estimates"][0]["value"]
    if mass is None or abs(mass - case.mass) > AGREEMENT_KG:
        return [
            Row(
                "proprio replay, fresh process",
                None,
                "void",
                False,
                f"{answer['verdict']}, {mass} kg",
            )
        ]
    whole = measure(lambda: python(*COMMAND), repeats=repeats)
    bare = measure(lambda: python("-c", "import numpy"), repeats=repeats)
    parts = [json.loads(python("-c", PARTS)) for _ in range(repeats)]

    def part(name: str) -> Timing:
        times = [one[name] for one in parts]
        return Timing(median(times), min(times), repeats)

    return [
        Row(
            "proprio replay --json, fresh process, warm kernel cache",
            whole,
            f"{whole.median:.2f} s (goal <= {GOAL_S:g} s)",
            whole.median <= GOAL_S,
            f"{1e3 * mass:.2f} g",
        ),
        Row("  bare: python -c 'import numpy'", bare),
        Row("  import of what replay needs", part("import")),
        Row("  robot and probe files", part("load")),
        Row("  reading the bag", part("read")),
        Row("  weighing, first kernels loaded", part("solve")),
    ]
