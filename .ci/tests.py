#!/usr/bin/env python3
"""All tests: `.ci/tests.py WIRING ...` runs each file of test/, with the long tests, too; those named know the clock on the wall.

What all of them import takes seconds, so it is imported once: a part is a fork of this process in which pytest runs. Two parts
compute at a time, the longest first. Beside them runs `wiring`, one file after the other: real processes, DDS, pseudo-terminals.
That waits more than it computes, and comes first where it does compute. All but the first wait for the process `DEBIAN`, which
installs what they need. No second try: a test that needs one is a defect.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import os
import pkgutil
import select
import sys
import tempfile
from pathlib import Path
from typing import IO

ROOT = Path(__file__).resolve().parents[1]
TOGETHER, GIVES_WAY = 2, 10
"""Parts that compute, and how nice they are: an identifier's jobs are 5."""
ENOUGH_S = 30
"""Files that take less share a process."""
SCHEDULES = "test/world/test_schedules.py::test_schedules["
"""A thousand of them are blocks, each a part."""
NEED_NOTHING = SCHEDULES, "test/nodes/test_demo.py"
"""Of what is installed meanwhile: those come first."""


def parts(wiring: list[str]) -> list[list[str]]:
    """What computes. What a file takes is in .ci/seconds (`.ci/seconds_of LOG` renews it); one that is not there counts 1."""
    rows = map(str.split, (ROOT / ".ci" / "seconds").read_text().splitlines())
    known = {file: int(seconds) for seconds, file in rows}
    files = {str(path.relative_to(ROOT)) for path in (ROOT / "test").rglob("test_*.py")} - {*wiring}
    made: list[tuple[int, list[str]]] = []
    for file in sorted(files, key=lambda file: (-known.get(file, 1), file)):
        seconds = known.get(file, 1)
        for at, (sum_s, others) in enumerate(made):
            if sum_s + seconds <= ENOUGH_S:
                made[at] = (sum_s + seconds, [*others, file])
                break
        else:
            made.append((seconds, [file]))
    return [[f"{SCHEDULES}{block}]"] for block in range(2)] + [
        of for _, of in sorted(made, reverse=True)
    ]


def import_what_they_share() -> None:
    """Everything of the package and of test/support, and with it what these stand on."""
    # rclpy and OpenBLAS read these when they are imported: as test/conftest.py
    os.environ |= {"ROS_PYTHON_CHECK_FIELDS": "1", "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    os.environ |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    sys.path[:1] = [str(ROOT), str(ROOT / "test")]
    for package in map(importlib.import_module, ("proprio_ros", "support")):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if not module.name.endswith("__main__"):
                importlib.import_module(module.name)
    for name in ("hypothesis", "mujoco", "pytest"):
        importlib.import_module(name)
    # what Warp's headers are compiled to is kept for the thread that did it: two parts fill two cores, and each child has it
    runtime = importlib.import_module("proprio_ros.sim.runtime")
    runtime.COMPILERS = 1
    runtime.start()
    runtime.load([importlib.import_module("proprio_ros.sim.joint").plain_kernel(1, "rk4")], "cpu")
    gc.collect()
    gc.freeze()  # else the first collection of a child would touch, and so copy, everything


def begin(part: list[str], nice: int, said: IO[str]) -> int:
    """Run a part in a child, whose output goes to a file; returns the child."""
    sys.stdout.flush()
    if child := os.fork():
        return child
    failed = 1
    try:
        for stream in (1, 2):
            os.dup2(said.fileno(), stream)
        os.nice(nice)
        if (debian := os.environ.get("DEBIAN")) and not part[0].startswith(NEED_NOTHING):
            with contextlib.suppress(ProcessLookupError):  # it has ended
                select.select([os.pidfd_open(int(debian))], [], [])
        import pytest

        # pytest warns of plugins that are imported before it begins
        words = ["--long", "--durations=0", "--durations-min=0.2", "-p", "no:cacheprovider"]
        words += ["-W", "ignore::pytest.PytestAssertRewriteWarning"]
        words += [] if "::" in part[0] else ["--deselect", SCHEDULES]
        failed = int(pytest.main([*words, *part]))
        sys.stdout.flush()
        sys.stderr.flush()
    finally:
        os._exit(failed)


def main(wiring: list[str]) -> int:
    """Run all parts; returns how many failed."""
    os.chdir(ROOT)
    import_what_they_share()
    queues = [parts(wiring), [[file] for file in wiring]]
    at_once, nice = (TOGETHER, 1), (GIVES_WAY, 0)
    running: dict[int, tuple[int, IO[str]]] = {}
    failed = 0
    while any(queues) or running:
        for queue, waiting in enumerate(queues):
            while waiting and sum(of == queue for of, _ in running.values()) < at_once[queue]:
                said = tempfile.TemporaryFile("w+", errors="replace")  # noqa: SIM115
                running[begin(waiting.pop(0), nice[queue], said)] = queue, said
        child, status, used = os.wait3(0)
        if child in running:
            _, said = running.pop(child)
            said.seek(0)
            spent = f"== {used.ru_utime + used.ru_stime:.0f} s of a processor\n"
            sys.stdout.write(
                said.read() + spent + (f"== ended with status {status}\n" if status else "")
            )
            sys.stdout.flush()
            failed += status != 0
    return failed


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]) and 1)
