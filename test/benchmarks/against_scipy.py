"""The same identification with scipy's general tools: ``solve_ivp`` at rtol 1e-8 inside ``least_squares``.

Same samples, weights, priors, starts and solver coordinates as ours; Jacobian by scipy's forward differences. DOP853 is the
fastest of scipy's methods here: RK45 takes 1.5 times as long, LSODA 1.1 times; trf, dogbox and lm differ by less than 10 %.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from case import Case, Row, compare
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from proprio_ros.sim.joint import INDEX

GOAL = 30.0
RTOL = 1e-8
ATOL = 1e-10


def identify(
    case: Case,
    method: str = "DOP853",
) -> Callable[[], tuple[np.ndarray, float]]:
    """A function that identifies from five starts and returns where they end and the best [kg]."""
    prepared = case.prepared
    coordinates = case.problem.coordinates
    current = float(case.run.input_current_A[0])
    empty, per_kg = case.parameters(np.array([0.0]))
    empty = empty[0]
    per_kg = per_kg[0, :, 0]
    torque = empty[INDEX["torque_constant"]] * current
    delay = empty[INDEX["delay"]]
    volt = case.problem.simulator.runs[0].supply[0]
    if volt > 0.0:
        raise SystemExit("the comparison wants a robot without a supply limit")
    times = prepared.times_s - delay
    end = float(times[-1])

    def residual(internal: np.ndarray) -> np.ndarray:
        mass, q0, v0 = coordinates.physical(internal)
        inertia, cosine, sine, constant = (empty + mass * per_kg)[:4]

        def law(
            _t: float,
            y: np.ndarray,
        ) -> tuple[float, float]:
            q, v = y.tolist()
            return v, (torque - cosine * math.cos(q) - sine * math.sin(q) - constant) / inertia

        rolled = solve_ivp(
            law,
            (0.0, end),
            (q0, v0),
            method,
            times,
            rtol=RTOL,
            atol=ATOL,
        )
        prior = (np.array([mass, q0, v0]) - coordinates.prior_mean) * np.sqrt(
            np.diag(coordinates.prior_precision)
        )
        return np.append(
            (rolled.y[0] - prepared.position) / prepared.sigma,
            prior[1:],
        )

    def solve() -> tuple[np.ndarray, float]:
        ends = [
            least_squares(residual, start, x_scale=coordinates.natural) for start in case.starts
        ]
        masses = case.masses(np.array([end.x for end in ends]))
        return masses, float(masses[int(np.argmin([end.cost for end in ends]))])

    return solve


def rows(case: Case) -> list[Row]:
    """The comparison."""
    what = "scipy solve_ivp (DOP853, rtol 1e-8) + least_squares, five starts"
    return [
        compare(
            what,
            identify(case),
            GOAL,
            case,
            repeats=9,
        )
    ]
