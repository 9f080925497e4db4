"""One BLAS thread while matrices of a hundred unknowns are solved, and processes of a pool that end with the one that made it.

They gain nothing from several, and beside other work the threads wait for each other: a calibration then takes five times as long.
"""

from __future__ import annotations

import functools
import multiprocessing
import os
import sys
import threading
from collections.abc import Callable
from typing import ParamSpec, TypeVar

from threadpoolctl import ThreadpoolController

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

    def wait() -> None:
        if (parent := multiprocessing.parent_process()) is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=wait, daemon=True).start()
