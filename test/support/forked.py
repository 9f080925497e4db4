"""Many lives of one world that stands: each in a process of its own, forked from it.

Starting nodes takes longer than most of what is then done with them. What the processes share costs nothing, none sees what another
does, and one that hangs or dies ends alone.
"""

from __future__ import annotations

import gc
import os
import pickle
import resource
import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from support.simulated_world import World

LONGEST_CPU_S = 120
"""Processor time; whoever takes longer is ended by the kernel."""
TOGETHER = 2


def lives(
    made: World,
    seeds: Sequence[int],
    folder: Path,
    live: Callable[[World, int], Any],
    together: int = TOGETHER,
) -> Iterator[tuple[int, Any]]:
    """Play the same world on with each seed; what came of it, in the order in which they end.

    Args:
        made: Whatever it is told to write goes to the working directory of its process, a new folder.
        seeds: Of whatever is drawn.
        folder: Empty; theirs are made in it, and taken away.
        live: What to do with the world; what it returns comes back, or a line that says how it ended.
        together: So many at once.
    """
    gc.collect()
    gc.freeze()  # else the first collection of a child would touch, and so copy, everything
    running: dict[int, int] = {}
    waiting = list(reversed(seeds))
    while waiting or running:
        while waiting and len(running) < together:
            seed = waiting.pop()
            (folder / str(seed)).mkdir()
            if (process := os.fork()) == 0:
                _live(made, seed, folder / str(seed), live)
            running[process] = seed
        process, status = os.wait()
        seed = running.pop(process)
        kept = folder / str(seed) / "outcome"
        yield (
            seed,
            pickle.loads(kept.read_bytes())
            if kept.exists()
            else f"its process has ended with status {status}",
        )
        shutil.rmtree(folder / str(seed))


def _live(
    made: World,
    seed: int,
    folder: Path,
    live: Callable[[World, int], Any],
) -> None:
    """The child; never returns."""
    outcome: Any = None
    sizes = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        resource.setrlimit(resource.RLIMIT_CPU, (LONGEST_CPU_S, LONGEST_CPU_S))
        os.chdir(folder)
        gc.disable()
        made.draw_anew(seed)
        outcome = live(made, seed)
    except BaseException as error:
        outcome = f"{type(error).__name__}: {error}"
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, sizes)
        (folder / "outcome.part").write_bytes(pickle.dumps(outcome))
        (folder / "outcome.part").rename(folder / "outcome")
        os._exit(0)
