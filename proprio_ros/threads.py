"""One BLAS thread while matrices of a hundred unknowns are solved, and processes of a pool that end with the one that made it.

They gain nothing from several, and beside other work the threads wait for each other: a calibration then takes five times as long.
"""

from __future__ import annotations

import functools
import multiprocessing
import os
import threading
from collections.abc import Callable
from typing import ParamSpec, TypeVar

from threadpoolctl import threadpool_limits

_here = threading.local()
_Given = ParamSpec("_Given")
_Result = TypeVar("_Result")


def one_blas_thread(function: Callable[_Given, _Result]) -> Callable[_Given, _Result]:
    """Decorates the calls that do the work, so that a script, a notebook and the command line all have it.

    One within another costs nothing: looking for the libraries takes as long as a tenth of an episode.
    """

    @functools.wraps(function)
    def limited(*arguments: _Given.args, **named: _Given.kwargs) -> _Result:
        if getattr(_here, "limited", False):
            return function(*arguments, **named)
        with threadpool_limits(1, user_api="blas"):
            _here.limited = True
            try:
                return function(*arguments, **named)
            finally:
                _here.limited = False

    return limited


def end_with_parent() -> None:
    """What each process of a pool begins with: however the one that made it ends, an error or a signal, nothing is left behind."""

    def wait() -> None:
        if (parent := multiprocessing.parent_process()) is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=wait, daemon=True).start()
