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


class Moved:
    """The joint of a case under its current, by scipy: the law has no friction, as the case has none.

    Args:
        case: Whose run it is.
        method: Of ``solve_ivp``.
    """

    def __init__(self, case: Case, method: str) -> None:
        empty, per_kg = case.parameters(np.array([0.0]))
        self.empty = empty[0]
        self.per_kg = per_kg[0, :, 0]
        self.torque = self.empty[INDEX["torque_constant"]] * float(case.run.input_current_A[0])
        self.method = method
        self.times_s = case.prepared.times_s - self.empty[INDEX["delay"]]

    def angles(
        self,
        mass: float,
        q0: float,
        v0: float,
    ) -> np.ndarray:
        """At the samples [rad], (T,), of a mass [kg] and a state at the onset [rad, rad/s]."""
        torque = self.torque
        inertia, cosine, sine, constant = (self.empty + mass * self.per_kg)[:4]

        def law(
            _t: float,
            y: np.ndarray,
        ) -> tuple[float, float]:
            q, v = y.tolist()
            return v, (torque - cosine * math.cos(q) - sine * math.sin(q) - constant) / inertia

        rolled = solve_ivp(
            law,
            (0.0, float(self.times_s[-1])),
            (q0, v0),
            self.method,
            self.times_s,
            rtol=RTOL,
            atol=ATOL,
        )
        angles: np.ndarray = rolled.y[0]
        return angles


def identify(
    case: Case,
    method: str = "DOP853",
) -> Callable[[], tuple[np.ndarray, float]]:
    """A function that identifies from five starts and returns where they end and the best [kg]."""
    if case.problem.simulator.runs[0].supply[0] > 0.0:
        raise SystemExit("the comparison wants a robot without a supply limit")
    prepared = case.prepared
    coordinates = case.problem.coordinates
    moved = Moved(case, method)

    def residual(internal: np.ndarray) -> np.ndarray:
        values = coordinates.physical(internal)
        off = (moved.angles(*values) - prepared.position) / prepared.sigma
        weights = np.sqrt(np.diag(coordinates.prior_precision))
        prior = (np.array(values) - coordinates.prior_mean) * weights
        return np.append(off, prior[1:])

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
