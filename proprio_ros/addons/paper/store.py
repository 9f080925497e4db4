"""What was computed, one JSON file per experiment and seed, and the processes that compute it.

A file belongs to the code that wrote it: when that changes it is computed again, so that a page never mixes two
versions. A run that was stopped goes on where it was.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, as_completed
from functools import cache
from pathlib import Path
from typing import Any

from proprio_ros.addons.paper.cases import Rows
from proprio_ros.addons.paper.experiments import EXPERIMENTS, experiment
from proprio_ros.errors import ConfigurationError, ProprioError
from proprio_ros.identification.solvers import cma_library
from proprio_ros.inputs.resources import share_directory, write_in_one_step
from proprio_ros.threads import one_blas_thread, pool_of

Task = tuple[str, int]  # experiment and seed

_PAGES = ("command.py", "page.py", "cells.py", "searches_page.py", "quoted.py", "store.py")
NO_ROWS = (
    "addons/contents/",
    "addons/fleet/",
    "cli/",
    "nodes/",
    "launch/",
    "report/",
    *(f"addons/paper/{name}" for name in _PAGES),
)
"""Of the package's sources, those from which no row follows."""


@cache
def code() -> str:
    """Of everything that the rows follow from: the package's sources, its configuration and its robot."""
    found = hashlib.sha256()
    package = Path(__file__).resolve().parents[2]
    shared = share_directory()
    for folder, pattern in (
        (package, "*.py"),
        (shared / "config", "*.yaml"),
        (shared / "urdf", "*.urdf"),
    ):
        for path in sorted(folder.rglob(pattern)):
            name = path.relative_to(folder).as_posix()
            if folder != package or not name.startswith(NO_ROWS):
                found.update(name.encode() + b"\0" + path.read_bytes())
    return found.hexdigest()[:16]


class Store:
    """The rows in a folder, which is made where it is not. Raises `ConfigurationError`: It cannot be made."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / "rows"
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigurationError(
                f"--out {folder}: {error.strerror}; name a folder that can be written"
            ) from error

    def read(self, task: Task) -> Rows | None:
        """Rows of an experiment and seed; None where they are not there, or of other code."""
        try:
            kept = json.loads(self._path(task).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None
        whole = (
            isinstance(kept, dict)
            and kept.get("code") == code()
            and isinstance(kept.get("rows"), dict)
        )
        return kept["rows"] if whole else None

    def write(self, task: Task, rows: Rows) -> None:
        """Keep rows."""
        name, seed = task
        text = json.dumps({"experiment": name, "seed": seed, "code": code(), "rows": rows})
        write_in_one_step(self._path(task), text + "\n", "--out")

    def _path(self, task: Task) -> Path:
        return self.folder / f"{task[0]}_{task[1]:03d}.json"


def tasks_of(names: Sequence[str], seeds: int) -> list[Task]:
    """What there is to do, seed by seed, so that a run that is stopped early has some of everything."""
    chosen = {name: experiment(name) for name in names or EXPERIMENTS}
    return [
        (name, seed) for seed in range(seeds) for name, one in chosen.items() if seed < one.seeds
    ]


@one_blas_thread
def compute(task: Task) -> tuple[Task, Rows]:
    """One experiment with one seed, and what it cost of a processor [s]; where it cannot be made, why.

    Raises `ConfigurationError`: It needs a package that is not installed.
    """
    name, seed = task
    began = time.process_time()
    try:
        rows = experiment(name).run(seed)
    except ProprioError as error:
        # what is not installed is missed by every seed alike
        if isinstance(error.__cause__, ImportError):
            raise
        rows = {"failed": str(error)}
    return task, {**rows, "cost_s": time.process_time() - began}


def run(
    store: Store,
    names: Sequence[str],
    seeds: int,
    processes: int,
    tell: Callable[[str], Any],
) -> dict[str, list[Rows]]:
    """All rows by experiment, in the order of the seeds; what is kept is not computed again.

    No names are all experiments. So many processes work at a time; those that take times run alone.

    Args:
        store: Keeps the rows.
        names: The experiments; none: all.
        seeds: How many robots are drawn.
        processes: How many work at a time; what takes times runs alone.
        tell: Hears how far it is.
    """
    wanted = tasks_of(names, seeds)
    missing = [task for task in wanted if store.read(task) is None]
    if any(name == "optimisers" for name, _ in missing):
        cma_library()  # whoever lacks it learns so now, not after hours
    tell(f"{len(wanted)} experiments and seeds, {len(wanted) - len(missing)} of them done before")
    began = time.monotonic()
    done = 0

    def keep(task: Task, rows: Rows) -> None:
        nonlocal done
        done += 1
        store.write(task, rows)
        spent = time.monotonic() - began
        left = spent / done * (len(missing) - done)
        failed = f": {rows['failed']}" if "failed" in rows else ""
        tell(
            f"{done} of {len(missing)}: {task[0]}, seed {task[1]}{failed} ({spent:.0f} s, about {left:.0f} s left)"
        )

    together = [task for task in missing if not experiment(task[0]).alone]
    if min(processes, len(together)) <= 1:
        together = []
    if together:
        with pool_of(min(processes, len(together))) as pool:
            waiting: list[Future[tuple[Task, Rows]]] = [
                pool.submit(compute, task) for task in together
            ]
            for finished in as_completed(waiting):
                keep(*finished.result())
    for task in missing:
        if task not in together:
            keep(*compute(task))
    found: dict[str, list[Rows]] = {}
    for task in wanted:
        rows = store.read(task)
        if rows is not None and "failed" not in rows:
            found.setdefault(task[0], []).append({**rows, "seed": task[1]})
    return found


def processors() -> int:
    """How many processes are worth while: one per processor, two at most."""
    return max(1, min(2, os.cpu_count() or 1))
