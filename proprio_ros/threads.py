"""One BLAS thread while matrices of a hundred unknowns are solved.

They gain nothing from several, and beside other work the threads wait for each other: a calibration then takes five times as long.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import ParamSpec, TypeVar

from threadpoolctl import threadpool_limits

_Given = ParamSpec("_Given")
_Result = TypeVar("_Result")


def one_blas_thread(function: Callable[_Given, _Result]) -> Callable[_Given, _Result]:
    """Decorates the calls that do the work, so that a script, a notebook and the command line all have it."""

    @functools.wraps(function)
    def limited(*arguments: _Given.args, **named: _Given.kwargs) -> _Result:
        with threadpool_limits(1, user_api="blas"):
            return function(*arguments, **named)

    return limited
