"""Compare proprio_ros with what else there is, on one recording, in one run: ``python test/benchmarks/run.py``.

Prints medians and minima, the ratio that is the goal, and whether it was met. A method that does not find the same mass is
void. Arguments: names of the parts to run, default all; ours is always run.
"""

from __future__ import annotations

import os
import platform
import sys
import time

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
import softness
from case import REPEATS, Case, Row, measure

from proprio_ros.probes.payload.identify import weigh

PARTS = {
    "mujoco": against_mujoco.rows,
    "scipy": against_scipy.rows,
    "substeps": against_substeps.rows,
    "c": against_c.rows,
    "calibrated": calibrated.rows,
    "container": container.rows,
    "fresh": fresh_process.rows,
    "bus": bus.rows,
    "softness": softness.rows,
}


def our_rows(case: Case) -> list[Row]:
    """Our own times."""
    solve = measure(case.solve, repeats=4 * REPEATS, warm_up=5)
    whole = measure(lambda: weigh(case.robot, [case.run], case.facts), repeats=2 * REPEATS, warm_up=2)
    answer = case.solve()
    masses = ", ".join(f"{1e3 * mass:.2f}" for mass in case.masses(answer.internal))
    found = f"found {1e3 * case.mass:.2f} g, starts {masses}; {answer.iterations} iterations"
    return [
        Row("ours: five-start fit (lm), problem built", solve, note=found),
        Row("ours: weigh() in total", whole, note="nominal and open fit, covariance, budget, scan"),
    ]


def printed(row: Row) -> str:
    """One line of the table."""
    timing = row.timing
    times = f"{_time(timing.median):>9} {_time(timing.fastest):>9}" if timing else f"{'-':>9} {'-':>9}"
    status = {True: "PASS", False: "FAIL", None: ""}[row.passed]
    return f"{row.what:<84} {times}  {row.ratio:<26} {status:<5} {row.note}".rstrip()


def _time(seconds: float) -> str:
    for unit, scale in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6)):
        if seconds >= scale:
            return f"{seconds / scale:.3g} {unit}"
    return f"{seconds * 1e9:.0f} ns"


def main(wanted: list[str]) -> int:
    """Run and print; 1 when a goal was missed."""
    unknown = set(wanted) - set(PARTS)
    if unknown:
        raise SystemExit(f"unknown part {', '.join(sorted(unknown))}; choose from: {', '.join(PARTS)}")
    started = time.perf_counter()
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")
    print(f"{platform.platform()}, Python {platform.python_version()}, {os.cpu_count()} cores, load {load:.1f}")
    case = cases.load()
    print(f"{cases.BAG.parent.name}: {case.prepared.used} samples, {case.prepared.times_s[-1]:.2f} s\n")
    print(f"{'what':<84} {'median':>9} {'min':>9}  {'ratio':<26}")
    missed = 0
    for rows in (our_rows, *(PARTS[name] for name in wanted or PARTS)):
        for row in rows(case):
            missed += row.passed is False
            print(printed(row), flush=True)
    print(f"\n{missed} goals missed; {time.perf_counter() - started:.0f} s in total")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
