"""Levenberg-Marquardt of many problems at once, on the processor or a graphics card.

A recording is read, fitted and judged by code that knows of no other. So that fits of many share a launch all the same, a `Meeting`
lets each go as far as its fit, and solves all of them when the last has come so far.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextvars import ContextVar
from dataclasses import dataclass
from threading import Condition
from typing import TypeVar

import numpy as np

from proprio_ros.identification.problem import Problem
from proprio_ros.identification.solvers import (
    IDLE_GAIN,
    LARGEST_CURVATURE,
    WINDOWS,
    Solution,
)
from proprio_ros.sim.descent import AffineFit, Descents, Rules
from proprio_ros.sim.joint import JointSimulator

_Result = TypeVar("_Result")


def can_go_together(problem: Problem) -> bool:
    """Whether a device can fit it on its own: what bends the simulator's parameters is the host's to follow."""
    return problem.is_affine() and type(problem.simulator) is JointSimulator


def affine_fit(problem: Problem, starts: np.ndarray) -> AffineFit:
    """A problem as numbers alone.

    Args:
        problem: One that `can_go_together`.
        starts: Solver coordinates, shape (S, F).
    """
    offset, slope = problem.affine_map()
    coordinates = problem.coordinates
    counts = problem.simulator.sample_counts.tolist()
    return AffineFit(
        runs=problem.simulator.runs,
        measured=[row[:count] for row, count in zip(problem.measured, counts, strict=True)],
        weight=[row[:count] for row, count in zip(problem.weight, counts, strict=True)],
        ripple=problem.known_ripple(),
        offset=offset,
        slope=slope,
        lower=coordinates.lower,
        upper=coordinates.upper,
        step_limit=coordinates.step_limit,
        scale=coordinates.scale,
        prior_mean=coordinates.prior_mean,
        prior_precision=coordinates.prior_precision,
        starts=starts,
    )


def rules(iterations: int = 30, tolerance: float = 1e-4, persistent: bool = True) -> Rules:
    """How far a descent from several starts goes; as of `levenberg_marquardt`.

    Args:
        iterations: At most so many on the last window.
        tolerance: Of a start's step over its standard deviation.
        persistent: Whether a start that overshot goes on with shorter steps.
    """
    return Rules(WINDOWS, 3, iterations, tolerance, persistent, IDLE_GAIN, LARGEST_CURVATURE)


def descend_together(
    problems: Sequence[Problem],
    starts: Sequence[np.ndarray],
    device: str,
    rules: Rules,
) -> list[Solution]:
    """What `levenberg_marquardt` finds for each problem, all of them in one launch for each number of unknowns.

    Args:
        problems: Each of which `can_go_together`.
        starts: Solver coordinates for each, shape (S, F).
        device: ``"cpu"`` or a graphics card.
        rules: How far it goes.
    """
    fits = [affine_fit(problem, first) for problem, first in zip(problems, starts, strict=True)]
    kinds = [
        (fit.starts.shape[1], problem.integrator)
        for fit, problem in zip(fits, problems, strict=True)
    ]
    solutions: dict[int, Solution] = {}
    for kind in dict.fromkeys(kinds):
        rows = [row for row, other in enumerate(kinds) if other == kind]
        descents = Descents([fits[row] for row in rows], rules, device, kind[1])
        for row, found in zip(rows, descents.run(), strict=True):
            solutions[row] = Solution(
                found.internal, found.cost, found.path, found.path_cost, found.iterations
            )
    return [solutions[row] for row in range(len(fits))]


@dataclass(eq=False)
class _Wanted:
    """A fit that waits for the others, and what became of it."""

    problem: Problem
    starts: np.ndarray
    device: str
    rules: Rules
    found: Solution | None = None
    error: Exception | None = None


class Meeting:
    """Pieces of work that take turns, one running at a time, and have what they want to be fitted fitted together."""

    def __init__(self) -> None:
        self._turn = Condition()
        self._at_work = 0  # that have not ended
        self._wanted: list[_Wanted] = []

    def results(self, works: Sequence[Callable[[], _Result]]) -> list[_Result]:
        """What each piece of work gives; each has a thread of its own, in which it may wait."""
        self._at_work = len(works)
        with ThreadPoolExecutor(max(len(works), 1)) as pool:
            return list(pool.map(self._result, works))

    def _result(self, work: Callable[[], _Result]) -> _Result:
        with self._turn:
            _MEETING.set(self)
            try:
                return work()
            finally:
                self._at_work -= 1
                self._solve_if_all_wait()

    def solved(self, wanted: _Wanted) -> Solution:
        """Wait until all others want a fit, too, or have ended."""
        self._wanted.append(wanted)
        self._solve_if_all_wait()
        while wanted.found is None and wanted.error is None:
            self._turn.wait()
        if wanted.found is None:
            raise wanted.error or AssertionError
        return wanted.found

    def _solve_if_all_wait(self) -> None:
        if not self._wanted or len(self._wanted) < self._at_work:
            return
        everything = self._wanted
        self._wanted = []
        for how in dict.fromkeys((wanted.device, wanted.rules) for wanted in everything):
            _solve([wanted for wanted in everything if (wanted.device, wanted.rules) == how])
        self._turn.notify_all()


_MEETING: ContextVar[Meeting | None] = ContextVar("meeting", default=None)


def _solve(alike: Sequence[_Wanted]) -> None:
    """Fits of one device and with the same rules."""
    try:
        solutions = descend_together(
            [wanted.problem for wanted in alike],
            [wanted.starts for wanted in alike],
            alike[0].device,
            alike[0].rules,
        )
    except Exception as error:  # whoever wants what cannot be done hears of it, and nobody else
        if len(alike) == 1:
            alike[0].error = error
            return
        for wanted in alike:
            _solve([wanted])
        return
    for wanted, solution in zip(alike, solutions, strict=True):
        wanted.found = solution


def descend(problem: Problem, starts: np.ndarray, device: str, rules: Rules) -> Solution:
    """What `descend_together` finds for one problem, with those of a `Meeting` where there is one.

    Args:
        problem: One that `can_go_together`.
        starts: Solver coordinates, shape (S, F).
        device: ``"cpu"`` or a graphics card.
        rules: How far it goes.
    """
    meeting = _MEETING.get()
    if meeting is not None:
        return meeting.solved(_Wanted(problem, starts, device, rules))
    (found,) = descend_together([problem], [starts], device, rules)
    return found
