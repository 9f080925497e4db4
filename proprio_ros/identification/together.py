"""Levenberg-Marquardt of many problems at once, on the processor or a graphics card."""

from __future__ import annotations

from collections.abc import Sequence

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
