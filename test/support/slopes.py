"""Derivatives held against central differences."""

from __future__ import annotations

import numpy as np

from proprio_ros.identification.problem import Problem

AGREES = 2e-4  # Part of a slope by which a difference of it may be another.


def assert_gradient_of_the_cost(
    problem: Problem, values: np.ndarray, step: float, least: float
) -> None:
    """The slope of the cost by each estimated unknown is that of a central difference.

    Args:
        problem: With runs.
        values: Of the estimated unknowns, shape (F,).
        step: Of the difference, in natural lengths of each unknown.
        least: A slope that is a smaller part of the largest counts as large as that.
    """
    internal = problem.coordinates.internal(values)
    gradient = problem.linearise(internal[None])[1][0]
    natural = problem.coordinates.natural
    largest = np.abs(gradient * natural).max()
    for row, unknown in enumerate(problem.estimated_unknowns()):
        off = np.zeros(len(internal))
        off[row] = step * natural[row]
        cost = problem.linearise(np.array([internal + off, internal - off]))[0]
        slope = (cost[0] - cost[1]) / (2.0 * off[row])
        scale = max(abs(gradient[row]), least * largest / natural[row])
        assert abs(slope - gradient[row]) < AGREES * scale, unknown.name
