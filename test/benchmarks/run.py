"""Compare proprio_ros with what else there is, on one recording, in one run: ``python test/benchmarks/run.py``.

Prints medians and minima, the ratio that is the goal, and whether it was met. A method that does not find the same mass is
void. Arguments: names of the parts to run, default all; ours is always run.
"""

from __future__ import annotations

import os
import platform
import sys
import time
from collections.abc import Sequence
from typing import Any

# as the command line does, before numpy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MKL_NUM_THREADS", "1")

import against_c
import against_mujoco
import against_scipy
import against_substeps
import bus
import calibrated
import case as cases
import container
import fresh_process
import gpu
import planned
import softness
import waits
from case import REPEATS, Case, Row, measure
from results import Results, parser_of

from proprio_ros.probes.payload.identify import weigh

PARTS = {
    "mujoco": against_mujoco.rows,
    "scipy": against_scipy.rows,
    "substeps": against_substeps.rows,
    "c": against_c.rows,
    "calibrated": calibrated.rows,
    "container": container.rows,
    "fresh": fresh_process.rows,
    "waits": waits.rows,
    "plan": planned.rows,
    "bus": bus.rows,
    "softness": softness.rows,
    "gpu": gpu.rows,
}


def our_rows(case: Case) -> list[Row]:
    """Our own times."""
    solve = measure(case.solve, repeats=4 * REPEATS, warm_up=5)
    whole = measure(
        lambda: weigh(
            case.robot,
            [case.run],
            case.facts,
        ),
        repeats=2 * REPEATS,
        warm_up=2,
    )
    answer = case.solve()
    masses = ", ".join(f"{1e3 * mass:.2f}" for mass in case.masses(answer.internal))
    found = f"found {1e3 * case.mass:.2f} g, starts {masses}; {answer.iterations} iterations"
    return [
        Row("ours: five-start fit (lm), problem built", solve, note=found),
        Row("ours: weigh() in total", whole, note="nominal and open fit, covariance, budget, scan"),
    ]


COLUMNS = {
    "what": "{what}",
    "median": "{median}",
    "fastest": "{fastest}",
    "beside it": "{ratio}",
    "goal": "{goal}",
    "notes": "{note}",
}


def figures(row: Row) -> dict[str, Any]:
    """Numbers and words of a row; times in s."""
    timing = row.timing
    return {
        "what": row.what.strip(),
        "median": None if timing is None else _time(timing.median),
        "fastest": None if timing is None else _time(timing.fastest),
        "median_s": None if timing is None else timing.median,
        "fastest_s": None if timing is None else timing.fastest,
        "ratio": row.ratio,
        "goal": {True: "met", False: "missed", None: ""}[row.passed],
        "note": row.note,
    }


def _time(seconds: float) -> str:
    for unit, scale in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6)):
        if seconds >= scale:
            return f"{seconds / scale:.3g} {unit}"
    return f"{seconds * 1e9:.0f} ns"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run and print; 1 when a goal was missed."""
    parser = parser_of(__doc__)
    parser.add_argument(
        "parts", nargs="*", default=list(PARTS), help=f"default: all of {', '.join(PARTS)}"
    )
    parser.add_argument(
        "--once",
        action="store_true",
        help="time everything by a single call: a look, and no figure",
    )
    options = parser.parse_args(arguments)
    cases.once = options.once
    unknown = set(options.parts) - set(PARTS)
    if unknown:
        raise SystemExit(
            f"unknown part {', '.join(sorted(unknown))}; choose from: {', '.join(PARTS)}"
        )
    started = time.perf_counter()
    results = Results(__file__, options.json, arguments)
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")
    print(
        f"{platform.platform()}, Python {platform.python_version()}, {os.cpu_count()} cores, load {load:.1f}"
    )
    case = cases.load()
    print(
        f"{cases.BAG.parent.name}: {case.prepared.used} samples, {case.prepared.times_s[-1]:.2f} s"
    )
    missed = 0
    for name, rows in (("ours", our_rows), *((name, PARTS[name]) for name in options.parts)):
        results.table(name, COLUMNS)
        for row in rows(case):
            missed += row.passed is False
            results.row(name, **figures(row))
    print(f"\n{missed} goals missed; {time.perf_counter() - started:.0f} s in total")
    results.keep()
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
