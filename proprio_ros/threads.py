"""One BLAS thread while matrices of a hundred unknowns are solved, and processes of a pool that end with the one that made it.

They gain nothing from several, and beside other work the threads wait for each other: a calibration then takes five times as long.
"""

from __future__ import annotations

import functools
import gc
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from typing import Any, ParamSpec, TypeVar

from threadpoolctl import ThreadpoolController

from proprio_ros.whole_files import leave_nothing_unfinished

_Given = ParamSpec("_Given")
_Result = TypeVar("_Result")


@functools.lru_cache(maxsize=1)
def _libraries(_modules: int) -> ThreadpoolController:
    """Of BLAS, that came with so many modules: to look for them takes as long as a tenth of an episode."""
    return ThreadpoolController()


def one_blas_thread(function: Callable[_Given, _Result]) -> Callable[_Given, _Result]:
    """Decorates the calls that do the work, so that a script, a notebook and the command line all have it."""

    @functools.wraps(function)
    def limited(*arguments: _Given.args, **named: _Given.kwargs) -> _Result:
        with _libraries(len(sys.modules)).limit(limits=1, user_api="blas"):
            return function(*arguments, **named)

    return limited


def end_with_parent() -> None:
    """What each process of a pool begins with: however the one that made it ends, an error or a signal, nothing is left behind."""

    def leave(*_: object) -> None:
        leave_nothing_unfinished()
        os._exit(1)

    def wait() -> None:
        parent = multiprocessing.parent_process()
        if parent is not None:
            parent.join()
            leave()

    signal.signal(signal.SIGTERM, leave)
    threading.Thread(target=wait, daemon=True).start()


class _Pool(ProcessPoolExecutor):
    """Its processes hear nothing of Ctrl-C, which goes to all processes of a terminal: the one that made them says so, once."""

    def submit(
        self, function: Callable[..., _Result], /, *arguments: Any, **named: Any
    ) -> Future[_Result]:
        # a process that begins here keeps the mask, also while it starts
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            return super().submit(function, *arguments, **named)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def pool_of(processes: int) -> Iterator[ProcessPoolExecutor]:
    """So many processes; they have ended and their semaphores are gone when this is left, also by an error or an interrupt.

    Each is a fresh interpreter: Warp's and BLAS's threads do not survive a fork.
    """
    others = set(multiprocessing.active_children())
    pool = _Pool(processes, get_context("spawn"), end_with_parent)
    try:
        yield pool
    except BaseException:
        for process in set(multiprocessing.active_children()) - others:
            process.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)
        del pool
        gc.collect()  # the command line does not collect by itself, and semaphores go with their queues
