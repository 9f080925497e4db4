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
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from proprio_ros.batch.episodes import Episode
from proprio_ros.batch.rows import Job, failed_row, rows_of_all, source_name
from proprio_ros.batch.store import PARTITION, Store, chunk_id, chunks_of, write_rows
from proprio_ros.threads import end_with_parent

CHUNK = 64  # episodes per file, at most
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
    """Small enough that every worker has many, so that none works long after the others have ended."""
    return max(1, min(most, episodes // (16 * workers)))


def compute(episodes: Sequence[Episode], job: Job, folder: str) -> int:
    """Rows of a chunk, written; returns how many episodes failed."""
    rows = rows_of_all(episodes, job)
    write_rows(Path(folder) / f"part-{chunk_id(episodes)}.parquet", rows)
    return sum(row["kind"] == "failed" for row in rows)


def run_local(
    episodes: Sequence[Episode],
    job: Job,
    store: Store,
    processes: int,
    tell: Callable[[str], Any],
    most: int = CHUNK,
) -> None:
    """Answer episodes in so many processes at a time, at most so many episodes per file; ``tell`` hears how far it is."""
    waiting = deque(
        _Chunk(group) for group in chunks_of(episodes, chunk_size(len(episodes), processes, most))
    )
    began = time.monotonic()
    finished = 0
    failed = 0
    told = time.monotonic()
    while waiting:
        # a fresh interpreter: Warp's and BLAS's threads do not survive a fork
        pool = ProcessPoolExecutor(processes, get_context("spawn"), end_with_parent)
        running: dict[Future[int], _Chunk] = {}
        try:
            while waiting or running:
                while waiting and len(running) < 2 * processes:
                    chunk = waiting.popleft()
                    folder = store.rows / f"{PARTITION}={source_name(chunk.episodes[0].source)}"
                    folder.mkdir(exist_ok=True)
                    running[pool.submit(compute, chunk.episodes, job, str(folder))] = chunk
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    failed += future.result()
                    finished += len(running.pop(future).episodes)
                if time.monotonic() - told > TELL_S:
                    told = time.monotonic()
                    left = (told - began) / max(finished, 1) * (len(episodes) - finished)
                    took = f"{told - began:.0f} s, about {left:.0f} s left"
                    tell(f"{finished} of {len(episodes)} episodes, {failed} failed ({took})")
            pool.shutdown()  # its processes end, and their locks with them
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
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _again(chunks: Sequence[_Chunk]) -> list[_Chunk]:
    """What was under way when a process died; from the second time on one episode at a time, and these count."""
    found = []
    for chunk in chunks:
        if len(chunk.episodes) > 1 and chunk.tries:
            found += [_Chunk([episode]) for episode in chunk.episodes]
        else:
            found.append(_Chunk(chunk.episodes, chunk.tries + 1))
    return found
