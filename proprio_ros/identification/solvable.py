"""What a fit ends in that has no solution: one sentence about the recording, in the place of whatever the arithmetic raises."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import ParamSpec, TypeVar

import numpy as np

from proprio_ros.errors import (
    ProprioError,
    RecordingError,
    one_line,
)

_Given = ParamSpec("_Given")
_Result = TypeVar("_Result")
ARITHMETIC = (np.linalg.LinAlgError, ArithmeticError, ValueError)
"""Singular systems and eigenvalues that do not converge; overflows and divisions by nothing; numbers that are none."""


def solvable(
    function: Callable[_Given, _Result],
) -> Callable[_Given, _Result]:
    """Decorates what fits recordings: equations without a solution become a `RecordingError`.

    A fit refuses by name what it can recognise before it. This is for what nobody foresaw: recordings are made by others.
    """

    @functools.wraps(function)
    def solved(*arguments: _Given.args, **named: _Given.kwargs) -> _Result:
        try:
            # what overflows or is no number ends in a refusal below, and need not warn, too
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
                return function(*arguments, **named)
        except ProprioError:
            raise
        except ARITHMETIC as error:
            reason = one_line(str(error) or type(error).__name__, 80)
            raise RecordingError(
                f"the equations of these recordings have no solution ({reason}): do the same joints move in all of them, for "
                "long enough, and are positions in rad? `proprio check` looks into each"
            ) from error

    return solved
