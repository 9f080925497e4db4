"""What runs that have not been made would tell of what all runs share, given what is known so far.

What is known is one Gaussian over the unknowns that runs share (of the robot and of the object). A run that could be made is
simulated at the values found so far and linearised; what it would take from the variance follows in closed form (Lehmann & Casella
1998, sec. 2.5), its own unknowns (where it started, delay, friction of the moment) eliminated under their priors.
"""

from __future__ import annotations

import numpy as np

from proprio_ros.identification.fit import FitResult
from proprio_ros.identification.posterior import Posterior
from proprio_ros.identification.problem import Problem
from proprio_ros.identification.unknowns import scaled_inverse
from proprio_ros.kinds import Key


class SharedUnknowns:
    """The F unknowns that all runs of a problem share, and what was known of them before any run.

    The problem has runs of every joint that may be driven.
    """

    def __init__(self, problem: Problem) -> None:
        estimated = problem.estimated_unknowns()
        shared = [f for f, unknown in enumerate(estimated) if unknown.shared]
        self.keys: list[Key] = [estimated[f].key for f in shared]
        self.at = {key: place for place, key in enumerate(self.keys)}
        # precision, shape (F, F)
        self.prior = problem.coordinates.prior_precision[np.ix_(shared, shared)].copy()

    def columns_of(self, problem: Problem) -> tuple[np.ndarray, np.ndarray]:
        """Which unknowns of a problem matter to each of its runs.

        Returns:
            The shared ones (0 where the problem lacks one), then the run's own O, shape (R, F + O); the variances of its own under
            their priors, shape (R, O).
        """
        own: list[list[int]] = [[] for _ in problem.runs]
        for row in problem.estimated.tolist():
            if isinstance(run := problem.unknowns[row].scope, int):
                own[run].append(row)
        shared = [problem.index.get(key, 0) for key in self.keys]
        variance = [[problem.unknowns[row].std ** 2 for row in rows] for rows in own]
        return np.array([shared + rows for rows in own]), np.array(variance)

    def covariance_after(self, fit: FitResult) -> np.ndarray:
        """What a fit leaves open of all shared unknowns, those of joints that it does not know among them, shape (F, F)."""
        problem = fit.problem
        posterior = Posterior(
            problem,
            fit.values,
            1.0 if fit.explains else max(1.0, fit.reduced_chi2),
        )
        estimated = problem.estimated_unknowns()
        shared = [f for f, u in enumerate(estimated) if u.key in self.at]
        own = [f for f, u in enumerate(estimated) if u.key not in self.at]
        normal = posterior.sensitivity.T @ posterior.sensitivity
        block = np.ix_(own, own)
        within = normal[block] + problem.coordinates.prior_precision[block]
        across = normal[np.ix_(shared, own)]
        taken = across @ np.linalg.solve(within, across.T)
        information = normal[np.ix_(shared, shared)] - taken
        total = self.prior.copy()
        to = [self.at[estimated[f].key] for f in shared]
        total[np.ix_(to, to)] += information
        return scaled_inverse(total)

    def stds_along(
        self,
        rows: np.ndarray,
        own_variance: np.ndarray,
        covariance: np.ndarray,
        key: Key,
        seen: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """What each run alone would leave open of one of them after each of its samples, and of something else that it moves.

        Args:
            rows: Whitened sensitivities of what the encoder would show, by the shared unknowns and then by O of the run's own,
                shape (R, T, F + O); zero for what does not count.
            own_variance: Of the run's own before it, shape (R, O).
            covariance: What is known so far, shape (F, F).
            key: Of the one that is looked for.
            seen: Sensitivities of three coordinates of something else by the same unknowns, shape (R, T, 3, F + O); default none.

        Returns:
            Standard deviations of the one, shape (R, T), and the largest of the three coordinates', shape (R, T), each with all
            samples up to that one.
        """
        runs, samples, width = rows.shape
        shared = len(self.keys)
        known = np.zeros((runs, width, width))
        known[:, :shared, :shared] = covariance
        own = np.arange(shared, width)
        known[:, own, own] = own_variance
        stds = np.empty((runs, samples))
        spreads = np.zeros((runs, samples))
        place = self.at[key]
        # one after the other, as a filter takes them in (Kalman 1960)
        for sample in range(samples):
            row = rows[:, sample, :, None]
            along = known @ row
            gain = along / (1.0 + row.transpose(0, 2, 1) @ along)
            known -= along * gain.transpose(0, 2, 1)
            variance = np.maximum(known[:, place, place], 0.0)
            stds[:, sample] = np.sqrt(variance)
            if seen is None:
                continue
            off = seen[:, sample]
            spreads[:, sample] = np.sqrt(
                np.maximum(((off @ known) * off).sum(axis=2), 0.0).max(axis=1)
            )
        return stds, spreads
