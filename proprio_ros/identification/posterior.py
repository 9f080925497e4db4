"""What is known after a fit: the covariance of every unknown, and how well the others predict each run."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np

from proprio_ros.identification.estimate import RunFit
from proprio_ros.identification.prepared_runs import PreparedRun
from proprio_ros.identification.problem import Problem
from proprio_ros.identification.solvers import bounded_step


class Posterior:
    """Gauss-Newton posterior of a problem's estimated unknowns at given values of all, shape (N,).

    ``inflation`` is a factor on the encoder's variance; the priors stay.

    Attributes:
        residual: Whitened, shape (M,); sensitivity: whitened, shape (M, F); run: which run each sample is of, shape (M,).
        covariance: Of the estimated unknowns in physical units, shape (F, F).
        condition: Of the normal matrix scaled to a unit diagonal.
    """

    def __init__(
        self,
        problem: Problem,
        values: np.ndarray,
        inflation: float = 1.0,
    ) -> None:
        self.problem = problem
        self.values = values
        q, v, dq = problem.simulate(values[None], problem.estimated)
        seen = problem.weight > 0.0
        weight = problem.weight[seen] / np.sqrt(inflation)
        self.residual = (problem.measured - q[0])[seen] * weight
        self.velocity = v[0][seen]
        self.sensitivity = dq[0][seen] * weight[:, None]
        self.run = np.repeat(np.arange(len(problem.runs)), problem.weight.shape[1]).reshape(
            seen.shape
        )[seen]
        self._weight = weight
        normal = self.sensitivity.T @ self.sensitivity + problem.coordinates.prior_precision
        normal += problem.other_information(values)
        scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
        scaled = normal * scale[:, None] * scale[None, :]
        values_of, vectors = np.linalg.eigh(scaled)
        kept = np.where(values_of > 1e-14 * values_of[-1], values_of, np.inf)
        inverse = (vectors / kept) @ vectors.T
        self.covariance = inverse * scale[:, None] * scale[None, :]
        self.condition = float(values_of[-1] / max(values_of[0], 1e-300))

    @functools.cached_property
    def step(self) -> np.ndarray:
        """To where the linearised problem, without the inflation, has its least cost inside the bounds, shape (F,).

        A fit ends near a kink of friction and not in it; of what only one run determines, that little would make a run that all
        others contradict.
        """
        coordinates = self.problem.coordinates
        internal = coordinates.internal(self.values[self.problem.estimated])[None]
        _, downhill, matrix = self.problem.linearise(internal)
        return (
            bounded_step(
                internal,
                downhill,
                matrix,
                np.zeros(1),
                coordinates,
            )
            * coordinates.slope(internal)
        )[0]

    def whole_covariance(self) -> np.ndarray:
        """Covariance of all unknowns, shape (N, N); zero where an unknown is not free."""
        covariance = np.zeros((len(self.problem.unknowns),) * 2)
        covariance[np.ix_(self.problem.estimated, self.problem.estimated)] = self.covariance
        return covariance

    def follows(self, name: str, others: Sequence[str]) -> np.ndarray:
        """By how much an estimated unknown would follow, per unit of each of others taken as known, to first order, shape (K,)."""
        problem = self.problem
        _, _, dq = problem.simulate(
            self.values[None],
            np.array([problem.index[other] for other in others]),
        )
        by_others = dq[0][problem.weight > 0.0] * self._weight[:, None]
        place = problem.column_of(name)
        followed: np.ndarray = -(self.covariance @ self.sensitivity.T @ by_others)[place]
        return followed

    def follows_clock(self, name: str) -> float:
        """By how much an estimated unknown would follow stamps that run fast, to first order, per unit of relative pace.

        A sample that is stamped (1 + e) t was taken at t, where the joint was v t e behind.
        """
        times_s = np.concatenate(
            [run.times_s for run in self.problem.runs]
        )  # since each onset, (M,)
        behind = -self.velocity * times_s * self._weight  # (M,)
        place = self.problem.column_of(name)
        return float(self.covariance[place] @ (self.sensitivity.T @ behind))

    def leverage(self) -> np.ndarray:
        """Variance of the fitted value of each sample in units of the sample's own, shape (M,)."""
        return np.einsum(
            "mf,fg,mg->m",
            self.sensitivity,
            self.covariance,
            self.sensitivity,
        )

    def held_out(self, run: int) -> tuple[np.ndarray, float]:
        """A run as the others predict it (exact for a linear model: deletion residuals, Cook & Weisberg 1982, sec. 2.2).

        Returns:
            Measured less predicted at each of the K used samples [rad], shape (K,); their chi-square under the covariance of the
            prediction, near K where the run fits the others.
        """
        rows = self.run == run
        own = self.sensitivity[rows]
        kept = np.eye(int(rows.sum())) - own @ self.covariance @ own.T
        residual = self.residual[rows] - own @ self.step
        whitened = np.linalg.solve(kept, residual)
        return whitened / self._weight[rows], float(residual @ whitened)


def run_fits(
    problem: Problem,
    values: np.ndarray,
    runs: Sequence[PreparedRun],
) -> tuple[tuple[RunFit, ...], float, float]:
    """Every run as recorded and as simulated, the rms of the residuals, and the expected one.

    Args:
        problem: That was fitted.
        values: Of all its unknowns, shape (N,).
        runs: Its runs.
    """
    q, _, _ = problem.simulate(
        values[None],
        problem.estimated[:3],
    )
    fits = []
    squares = 0.0
    expected = 0.0
    samples = 0
    for row, prepared in enumerate(runs):
        run = prepared.run
        used = prepared.used
        simulated = q[0, row, :used]
        squares += float(np.sum((simulated - prepared.position) ** 2))
        expected += float(np.sum(prepared.sigma**2))
        samples += used
        driven = float(run.input_current_A[np.argmax(np.abs(run.input_current_A))])
        followed = (
            prepared.times_s,
            prepared.position,
            simulated,
            prepared.sigma,
        )
        left_out = run.times_s[used:], run.position[used:]
        fits.append(
            RunFit(
                run.name,
                run.joint,
                run.source,
                driven,
                *followed,
                *left_out,
                prepared.travel,
            )
        )
    return (
        tuple(fits),
        float(np.sqrt(squares / samples)),
        float(np.sqrt(expected / samples)),
    )
