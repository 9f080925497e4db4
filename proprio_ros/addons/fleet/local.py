"""The engine that is always there: processes of this machine.

Each takes one chunk of episodes at a time and writes its rows itself, so that the parent holds no rows and at most two chunks per
process wait. A process that dies (a fault in native code, the kernel's memory killer) takes its chunk along: that is tried
again, then episode by episode, and an episode that kills its process three times is a row that says so.
"""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from proprio_ros.addons.fleet.episodes import Episode
from proprio_ros.addons.fleet.rows import FAILED, Job, failed_row, lasting, rows_of_all, source_name
from proprio_ros.addons.fleet.store import PARTITION, Store, chunk_id, chunks_of, write_rows
from proprio_ros.threads import pool_of

CHUNK = 64  # episodes per file, at most
TOGETHER = 512  # of those whose fits share a launch on a graphics card
TELL_S = 5.0
TRIES = 3


@dataclass
class _Chunk:
    episodes: list[Episode]
    tries: int = 0


def processors() -> int:
    """Those that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def chunk_size(episodes: int, workers: int, most: int = CHUNK) -> int:
    """Small enough that every worker has many, so that none works long after the others have ended.

    Args:
        episodes: How many there are.
        workers: How many compute.
        most: Episodes per file at most.
    """
    return max(1, min(most, episodes // (16 * workers)))


@dataclass(frozen=True)
class Done:
    """Of a chunk: how many episodes failed, and what was wrong with the computer, which leaves its episodes undone."""

    failed: int
    machine: frozenset[str] = frozenset()


def compute(episodes: Sequence[Episode], job: Job, folder: str) -> Done:
    """Rows of a chunk, written, but for those of episodes that the computer could not do.

    Args:
        episodes: Those of one chunk.
        job: What is asked of each.
        folder: Where the file of rows goes.
    """
    rows = rows_of_all(episodes, job)
    kept = lasting(rows)
    undone = [row for row in rows if row not in kept]
    reasons = {str(row["reasons"][0]) for row in undone}
    try:
        if kept:
            write_rows(Path(folder) / f"part-{chunk_id(episodes)}.parquet", kept)
    except OSError as error:
        reasons.add(f"rows cannot be written: {error.strerror}")
    return Done(sum(row["kind"] == FAILED for row in kept), frozenset(reasons))


def run_local(
    episodes: Sequence[Episode],
    job: Job,
    store: Store,
    processes: int,
    tell: Callable[[str], Any],
    most: int = CHUNK,
) -> None:
    """Answer episodes in so many processes at a time, at most so many episodes per file; ``tell`` hears how far it is.

    Args:
        episodes: What is to be answered.
        job: What is asked of each.
        store: Takes the rows.
        processes: How many at a time.
        tell: Hears how far it is.
        most: Episodes per file at most.
    """
    size = chunk_size(len(episodes), processes, most)
    if job.options.device != "cpu":
        size = min(TOGETHER, -(-len(episodes) // processes))
    waiting = deque(_Chunk(group) for group in chunks_of(episodes, size))
    began = time.monotonic()
    finished = 0
    failed = 0
    told = time.monotonic()
    machine = set[str]()
    while waiting:
        running: dict[Future[Done], _Chunk] = {}
        try:
            with pool_of(processes) as pool:
                while waiting or running:
                    while waiting and len(running) < 2 * processes:
                        chunk = waiting[0]
                        folder = store.rows / f"{PARTITION}={source_name(chunk.episodes[0].source)}"
                        folder.mkdir(exist_ok=True)
                        running[pool.submit(compute, chunk.episodes, job, str(folder))] = chunk
                        waiting.popleft()  # not before: a pool that has died takes none
                    for future in wait(running, return_when=FIRST_COMPLETED).done:
                        done = future.result()
                        failed += done.failed
                        finished += len(running.pop(future).episodes)
                        for reason in sorted(done.machine - machine):
                            tell(f"not answered, and asked again next time: {reason}")
                        machine |= done.machine
                    if time.monotonic() - told > TELL_S:
                        told = time.monotonic()
                        left = (told - began) / max(finished, 1) * (len(episodes) - finished)
                        took = f"{told - began:.0f} s, about {left:.0f} s left"
                        tell(f"{finished} of {len(episodes)} episodes, {failed} failed ({took})")
        except BrokenProcessPool:
            tell("a process died; its episodes are done again")
            for chunk in _again(list(running.values())):
                if chunk.tries < TRIES:
                    waiting.appendleft(chunk)
                    continue
                episode = chunk.episodes[0]
                reason = (
                    f"the process that worked on it died {TRIES} times; is there enough memory?"
                )
                store.write(
                    [failed_row(episode, job, reason, "process_died")], chunk_id(chunk.episodes)
                )
                finished = finished + 1
                failed = failed + 1


def _again(chunks: Sequence[_Chunk]) -> list[_Chunk]:
    """What was under way when a process died; from the second time on one episode at a time, and these count."""
    found = []
    for chunk in chunks:
        if len(chunk.episodes) > 1 and chunk.tries:
            found += [_Chunk([episode]) for episode in chunk.episodes]
        else:
            found.append(_Chunk(chunk.episodes, chunk.tries + 1))
    return found
