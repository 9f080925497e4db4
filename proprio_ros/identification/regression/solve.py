"""The regression: unknowns with a Gaussian prior, rows in windows whose errors are correlated, one solution with its covariance.

It is solved by iteratively reweighted least squares. The weights of a joint's rows follow what is left over of them, and for how
many windows that is alike. What goes with the solution itself is filled in from step to step: gears lose a share of what they
transmit, and a motor's torque is off by a share of itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from proprio_ros.calibration_files.motions import MotionCalibration
from proprio_ros.identification.regression.arm_terms import ArmTerms
from proprio_ros.identification.regression.motion_equations import Problem, fill_drives
from proprio_ros.identification.regression.recording_variability import (
    CLOCK,
    CONSIDERED,
    LEARNT,
    PUBLISHED,
    Evidence,
    RecordingVariability,
    by_evidence,
)
from proprio_ros.records import FloatArray
from proprio_ros.robot.regressor import PARAMETERS

# Of weights and load friction; the mass of a UR10e changes by less than 1 g in the last.
ITERATIONS = 6
WAVES = 4  # Sine and cosine of a joint's angle, and of twice the angle.
# Standard deviation of each of them, in parts of Coulomb friction: a guess.
PLACE_SHARE = 0.15
# Of a joint's independent windows at least so many count as not used up by unknowns: a guess.
FEWEST_FREE = 0.2
FIXED = 1e-6  # Of its spread is what a term that is not followed may move by.
# Inertia that ends so many standard deviations of its prior from nothing is as open as that.
SPREAD_SIGMAS = 3.0
LEAST_RMS = 1e-9  # [N m] of residuals: below it there is only rounding.
LEAST_CORRELATION = 0.05  # Windows whose residuals are less correlated, and all that are farther apart, are independent.
# A longer recording knows the residuals of a short one, too, to this factor.
KNOWN_RESIDUAL = 0.5


@dataclass(frozen=True)
class Prior:
    """Gaussian, of U unknowns: values, shape (U,), and covariance, shape (U, U)."""

    values: FloatArray
    covariance: FloatArray


@dataclass(frozen=True)
class Priors:
    """What is known before motions are looked at."""

    unknowns: Prior  # without what recordings differ by
    variability: RecordingVariability  # by how much they do
    per_kg: FloatArray  # standard deviations of the payload's parameters per kg that it weighs, shape (10,)


def _in_prior_units(
    information: FloatArray, prior: Prior
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Standard deviations of the prior, shape (U,), its correlations and the information in units of these, shapes (U, U)."""
    spread = np.sqrt(np.diag(prior.covariance))
    correlation = prior.covariance / spread[:, None] / spread
    return spread, correlation, information * spread[:, None] * spread


def posterior(
    information: FloatArray, side: FloatArray, prior: Prior
) -> tuple[FloatArray, FloatArray]:
    """Mean and covariance, ``(1 + V N)^-1 V``: neither the prior V nor the data N need an inverse of their own.

    Both are scaled by the prior's standard deviations, which differ by ten orders of magnitude.

    Args:
        information: Of the data, N, shape (U, U).
        side: What they say, weighted alike, shape (U,).
        prior: Of the unknowns.

    Returns: Shapes (U,) and (U, U).
    """
    spread, correlation, normal = _in_prior_units(information, prior)
    shrunk = np.linalg.solve(
        np.eye(len(spread)) + correlation @ normal,
        correlation,
    )
    shrunk = 0.5 * (shrunk + shrunk.T)
    values = prior.values + spread * (shrunk @ (spread * (side - information @ prior.values)))
    return values, shrunk * spread[:, None] * spread


def distance_from_prior(information: FloatArray, side: FloatArray, prior: Prior) -> float:
    """How far the mean of `posterior` is from the prior's, squared, in the prior's standard deviations (Mahalanobis).

    With the prior's covariance V, the data's information N and their side s at the prior's mean, the mean moves by ``V y``, where
    ``(1 + N V) y = s``. So the distance is ``y' V y``. The gradient of the data at the new mean gives the same, but as a difference
    of numbers that are ten orders of magnitude larger: of precise data rounding alone is left of it.

    Args:
        information: Of the data, N, shape (U, U).
        side: What they say, weighted alike, shape (U,).
        prior: Of the unknowns.
    """
    spread, correlation, normal = _in_prior_units(information, prior)
    pull = np.linalg.solve(
        np.eye(len(spread)) + normal @ correlation,
        spread * (side - information @ prior.values),
    )
    return float(pull @ correlation @ pull)


@dataclass(frozen=True)
class Solution:
    """Of a `Problem` under a prior."""

    values: FloatArray  # shape (U,)
    covariance: FloatArray  # of data and prior, with correlated residuals counted, shape (U, U)
    information: FloatArray  # what the data alone say, shape (U, U)
    deviations: FloatArray  # by stretch, see `MotionCalibration`, shape (stretches, U)
    residual: FloatArray  # of each equation [N m], shape (E,)
    # rms, correlation: by joint, shape (n,); 0 and 1 where it did not move
    rms: FloatArray
    correlation: FloatArray
    prior: Prior  # as it was in the end
    variability: RecordingVariability  # by what recordings differ, with what these show
    scaled: FloatArray  # the equations times their weights, shape (E, U)
    weight: FloatArray  # shape (E,)

    @property
    def payload_prior(self) -> FloatArray:
        """Standard deviations of the payload's parameters under their prior, shape (10,)."""
        return np.sqrt(np.diag(self.prior.covariance))[:PARAMETERS]

    def mass_and_std(self) -> tuple[float, float]:
        """The mass [kg], and the larger of its standard deviations by the fit and by its stretches."""
        variance = max(self.noise()[0, 0], self.covariance[0, 0])
        return float(self.values[0]), float(np.sqrt(variance))

    def by_prior(self) -> FloatArray:
        """How the payload's parameters follow the prior's mean, shape (10, U)."""
        gain = self.covariance[:PARAMETERS] @ self.information
        result: FloatArray = np.eye(len(self.values))[:PARAMETERS] - gain
        return result

    def noise(self) -> FloatArray:
        """What the recording itself leaves open of the payload: the larger of what stretches and fit say, shape (10, 10)."""
        between = self.deviations[:, :PARAMETERS].T @ self.deviations[:, :PARAMETERS]
        formal = self.covariance[:PARAMETERS] @ self.information @ self.covariance[:, :PARAMETERS]
        return larger(between, formal)


def larger(one: FloatArray, other: FloatArray) -> FloatArray:
    """Of two covariances of the payload, that with the larger variance of the mass."""
    return one if one[0, 0] > other[0, 0] else other


def window_weights(residual: FloatArray, correlation: FloatArray) -> FloatArray:
    """Of a window of each joint, shape (n,); 0 of one that did not move.

    ``residual``: rms of what is left over of its windows [N m], shape (n,); ``correlation``: how many share an error, shape (n,).
    """
    counts = residual > 0.0
    return np.where(
        counts,
        1.0 / (np.where(counts, residual, 1.0) * np.sqrt(correlation)),
        0.0,
    )


@dataclass(frozen=True)
class Followed:
    """A solution that follows what differs between recordings, averaged over how far that may be."""

    estimate: Solution
    opened: Solution  # by spreads as they are stated
    scatter: FloatArray  # how solutions by each spread scatter about the estimate, covariance, shape (U, U)
    weights: FloatArray  # how likely each of F spreads is, shape (F,), sum 1
    mass: FloatArray  # by how much the mass by each of them differs from the estimate [kg], shape (F,)
    # by how much more its variance is by each of them than by what the estimate has [kg^2], shape (F,)
    more_variance: FloatArray
    log_likelihood: FloatArray  # of the data by each of them, shape (F,)
    log_likelihood_of_more: (
        FloatArray  # that another recording like this one is expected to have, shape (F,)
    )


def solve_following(
    problem: Problem,
    priors: Priors,
    known: MotionCalibration | None,
) -> Followed:
    """The mean of solutions over all spreads of what differs between recordings, each as likely as it makes the data.

    Args:
        problem: Its equations.
        priors: Of its U unknowns.
        known: By which residuals are known. Without one, recordings differ from their mean, whose torque and zeros are the arm's.
    """
    opened = solve(problem, priors, known, followed=CONSIDERED)
    variability = priors.variability
    terms = _Considered.of(problem, variability, about_mean=known is None)
    std = terms.each_motion(variability.std)
    # what the data say of these terms alone; all else follows them linearly
    covariance = opened.covariance[np.ix_(terms.at, terms.at)]
    precision = np.asarray(
        np.linalg.inv(covariance),
        np.float64,
    )  # (K, K)
    leads = opened.covariance[:, terms.at] @ precision  # (U, K)
    before = 0.0 if known is None else known.spread_evidence
    found = terms.evidence(opened, precision, variability, leads[0], before)
    mean = terms.basis @ found.mean  # (K,), in parts of std
    apart = (found.terms @ terms.basis.T - mean) * std @ leads.T  # (F, U)
    wider = {kind: variability.spreads[kind] * times for kind, times in found.wider.items()}
    differs = replace(
        opened.variability,
        spreads={**opened.variability.spreads, **wider},
    )
    spread = terms.each_motion(differs.std)[:, None] * terms.basis
    wide = Prior(
        opened.prior.values,
        opened.prior.covariance.copy(),
    )
    wide.covariance[np.ix_(terms.at, terms.at)] = spread @ spread.T
    values = opened.values + leads @ (std * mean - opened.values[terms.at])
    return Followed(
        estimate=_moved(problem, opened, values, wide, differs),
        opened=opened,
        scatter=(apart * found.weights[:, None]).T @ apart,
        weights=found.weights,
        mass=apart[:, 0],
        more_variance=found.variances - found.variance,
        log_likelihood=found.log_likelihood,
        log_likelihood_of_more=found.log_likelihood_of_more,
    )


@dataclass(frozen=True)
class _Considered:
    """The K terms of M motions whose spread the evidence decides."""

    motions: int
    own: NDArray[np.int64]  # their numbers among the own terms of all motions, shape (K,)
    at: NDArray[np.int64]  # where they stand among the unknowns, shape (K,)
    basis: FloatArray  # orthonormal columns, of which they are a sum, shape (K, T)

    @classmethod
    def of(
        cls, problem: Problem, variability: RecordingVariability, about_mean: bool
    ) -> _Considered:
        """Those of a problem.

        ``problem``: of M motions; ``variability``: by how much they differ; ``about_mean``: whether the terms are how they differ
        from their mean over the motions.
        """
        motions = problem.motions
        own = np.flatnonzero(np.isin(np.tile(variability.kinds, motions), CONSIDERED))
        basis: FloatArray = np.eye(len(own))
        if about_mean:
            each = np.eye(len(own) // motions)
            basis = np.asarray(
                np.kron(_contrasts(motions), each),
                np.float64,
            )
        return cls(
            motions,
            own,
            problem.own(0).start + own,
            basis,
        )

    def each_motion(self, of_own: NDArray[Any]) -> NDArray[Any]:
        """Of these terms, what is the same for every motion's own terms, shape (K,)."""
        return np.tile(of_own, self.motions)[self.own]

    def evidence(
        self,
        opened: Solution,
        precision: FloatArray,
        stated: RecordingVariability,
        lead: FloatArray,
        before: FloatArray | float,
    ) -> Evidence:
        """What data say of these terms, in parts of what is stated of them.

        Args:
            opened: A solution that had them open.
            precision: Theirs in it, shape (K, K).
            stated: By how much they differ.
            lead: By how much the mass follows them, shape (K,).
            before: What other recordings say of their spreads, see `by_evidence`.
        """
        opened_std = self.each_motion(opened.variability.std)
        std = self.each_motion(stated.std)
        data = precision - np.diag(1.0 / np.square(opened_std))
        information = std[:, None] * data * std
        side = std * (precision @ opened.values[self.at])
        return by_evidence(
            self.each_motion(stated.kinds)[: self.basis.shape[1]],
            self.basis.T @ information @ self.basis,
            self.basis.T @ side,
            self.basis.T @ (std * lead),
            before,
        )


def _moved(
    problem: Problem,
    opened: Solution,
    values: FloatArray,
    prior: Prior,
    variability: RecordingVariability,
) -> Solution:
    """A solution with other values, and the covariance that the same data have under another prior."""
    _, covariance = posterior(
        opened.information,
        opened.information @ prior.values,
        prior,
    )
    residual = problem.torque - opened.scaled @ values / opened.weight
    pulls = scores(
        opened.scaled,
        residual * opened.weight,
        problem,
    )
    return replace(
        opened,
        values=values,
        covariance=covariance,
        deviations=pulls @ covariance,
        residual=residual,
        prior=prior,
        variability=variability,
    )


def _contrasts(count: int) -> FloatArray:
    """What differs between so many, without their mean: orthonormal columns, shape (count, count - 1)."""
    orthonormal, _ = np.linalg.qr(np.eye(count) - 1.0 / count)
    result: FloatArray = orthonormal[:, : count - 1]
    return result


def solve(
    problem: Problem,
    priors: Priors,
    known: MotionCalibration | None = None,
    followed: Sequence[str] = (),
) -> Solution:
    """Solve it, with weights, load friction, the payload's size and the spread of recordings from the solution before.

    Args:
        problem: Its equations.
        priors: Of its U unknowns.
        known: By which residuals are known; without one, the place's part of Coulomb friction is open by a share of it.
        followed: Kinds of what recordings differ by that the solution follows, beside friction and offsets.
    """
    regression = _Reweighted(problem, priors, known, followed)
    for _ in range(ITERATIONS):
        regression.iterate()
    return regression.solution()


@dataclass(frozen=True)
class _Weighted:
    """A solution by the weights of the moment."""

    weight: FloatArray  # shape (E,)
    scaled: FloatArray  # the equations times their weights, shape (E, U)
    information: FloatArray  # shape (U, U)
    values: FloatArray  # shape (U,)
    covariance: FloatArray  # shape (U, U)


class _Reweighted:
    """A regression whose weights, priors and columns follow its own solution."""

    def __init__(
        self,
        problem: Problem,
        priors: Priors,
        known: MotionCalibration | None,
        followed: Sequence[str],
    ) -> None:
        prior = priors.unknowns
        variability = priors.variability
        self.problem = problem
        self.matrix = problem.matrix.copy()  # (E, U)
        self.known = known
        self.followed = followed
        self.terms = ArmTerms(problem.count, PARAMETERS)
        # each motion's own terms are the last unknowns
        self.own = slice(problem.own(0).start, None)
        self.own_variance = np.diag(prior.covariance)[self.own].copy()
        self.prior = Prior(
            prior.values,
            prior.covariance.copy(),
        )
        self.per_kg = priors.per_kg
        self.stated = variability
        self.variability = variability
        learnt = (*LEARNT, *followed) if variability.friction.any() else followed
        self.learnt = [kind for kind in PUBLISHED if kind in learnt and kind not in CLOCK]
        follows = np.isin(
            variability.kinds,
            (*LEARNT, *followed),
        )
        self.follows = np.where(follows, 1.0, FIXED)
        self.rms = np.ones(problem.count)
        self.correlation = np.ones(problem.count)
        self._spread_own_terms()

    def iterate(self) -> None:
        """Solve once, and set weights, priors and columns by the solution."""
        now = self._solved()
        self._reweigh(now)
        if self.known is None:
            self._open_friction_by_place(now.values)
        self._open_payload(now)
        self._learn_variability(now)
        self._spread_own_terms()
        fill_drives(
            self.matrix,
            now.values,
            self.problem,
            self.terms,
        )
        self.problem.fill_own(self.matrix, now.values)

    def solution(self) -> Solution:
        """The last one, with what it leaves over."""
        now = self._solved()
        torque = self.problem.torque
        left_over = torque * now.weight - now.scaled @ now.values
        return Solution(
            values=now.values,
            covariance=now.covariance,
            information=now.information,
            deviations=scores(now.scaled, left_over, self.problem) @ now.covariance,
            residual=torque - self.matrix @ now.values,
            rms=self.rms,
            correlation=self.correlation,
            prior=self.prior,
            variability=self.variability,
            scaled=now.scaled,
            weight=now.weight,
        )

    def _solved(self) -> _Weighted:
        of_joint = window_weights(self.rms, self.correlation)
        weight = of_joint[self.problem.joint] * np.sqrt(self.problem.counted)
        scaled = self.matrix * weight[:, None]
        information = scaled.T @ scaled
        side = scaled.T @ (self.problem.torque * weight)
        values, covariance = posterior(information, side, self.prior)
        return _Weighted(weight, scaled, information, values, covariance)

    def _spread_own_terms(self) -> None:
        """Give every motion's own terms their spread."""
        at = range(self.own.start, len(self.prior.values))
        spread = np.square(self.variability.std * self.follows)
        self.prior.covariance[at, at] = self.own_variance + np.tile(spread, self.problem.motions)

    def _reweigh(self, now: _Weighted) -> None:
        """Rms and correlation of what is left over, joint by joint."""
        residual = self.problem.torque - self.matrix @ now.values
        known = self.known
        self.rms = np.zeros(self.problem.count)
        self.correlation = np.ones(self.problem.count)
        for joint in np.unique(self.problem.joint):
            mine = self.problem.joint == joint
            rms = max(float(np.std(residual[mine])), LEAST_RMS)
            correlation = correlated_windows(
                residual[mine],
                self.problem.stretch[mine],
            )
            if known is not None and self.followed:  # what unknowns take up is not left over
                scaled = now.scaled[mine]
                leverage = np.einsum("ij,ij->", scaled @ now.covariance, scaled)
                used = leverage * correlation / mine.sum()
                rms /= np.sqrt(max(1.0 - used, FEWEST_FREE))
            self.rms[joint] = rms
            self.correlation[joint] = correlation
        if known is not None:
            # what a longer recording knows of its residuals holds for a short one, too
            self.rms = np.maximum(self.rms, KNOWN_RESIDUAL * known.residual)
            self.correlation = np.maximum(self.correlation, known.correlation)

    def _open_friction_by_place(self, values: FloatArray) -> None:
        """Friction that goes with the angle is open by a share of Coulomb friction."""
        count = self.problem.count
        by_motion = [
            values[self.problem.own(number, count)][:count]
            for number in range(self.problem.motions)
        ]
        coulomb = np.mean(by_motion, axis=0)  # (n,)
        place = self.terms.friction_by_place
        waves = range(place.start, place.stop)
        variance = np.square(PLACE_SHARE * coulomb) + 1e-12
        self.prior.covariance[waves, waves] = np.tile(variance, WAVES)

    def _open_payload(self, now: _Weighted) -> None:
        """Something light has little first moment and inertia, wherever in the hand it sits."""
        heavy_kg = abs(now.values[0]) + np.sqrt(now.covariance[0, 0])
        stds = heavy_kg * self.per_kg  # (10,)
        # but what is seen to be spread further is: else 0.25 kg m^2 of a bar of 2 kg came out 12 % too small, 2.6 half widths off
        inertia = np.abs(now.values[4:PARAMETERS])
        farthest = float(np.max(inertia / stds[4:]))
        stds[4:] *= max(1.0, farthest / SPREAD_SIGMAS)
        at = range(1, PARAMETERS)
        self.prior.covariance[at, at] = stds[1:] ** 2

    def _learn_variability(self, now: _Weighted) -> None:
        """By how much recordings differ, as these do."""
        motions = self.problem.motions
        off = now.values[self.own] - self.prior.values[self.own]
        off = off.reshape(motions, -1)
        variances = np.diag(now.covariance)[self.own].reshape(off.shape)
        self.variability = self.stated.learnt(self.variability, off, variances, self.learnt)


def correlated_windows(
    residual: FloatArray,
    stretch: NDArray[np.int64],
) -> float:
    """Over how many windows a joint's residuals are correlated: one and twice the sum of their correlations within a stretch."""
    total = 1.0
    variance = float(np.mean(residual**2))
    _, counts = np.unique(stretch, return_counts=True)
    longest = int(counts.max())
    for lag in range(1, longest):
        same = stretch[lag:] == stretch[:-lag]
        if same.sum() < longest:
            break
        products = residual[lag:][same] * residual[:-lag][same]
        step = float(np.mean(products)) / variance
        if step < LEAST_CORRELATION:
            break
        total += 2.0 * step
    return total


def scores(
    scaled: FloatArray,
    left_over: FloatArray,
    problem: Problem,
) -> FloatArray:
    """What each stretch pulls the solution by, but for its covariance.

    What a stretch of a long recording counts less by is taken back once: together they scatter as if each counted in full.

    Args:
        scaled: Equations times their weights, shape (E, U).
        left_over: Residuals times their weights, shape (E,).
        problem: That has these equations.

    Returns: Shape (stretches, U).
    """
    each = left_over / np.sqrt(problem.counted)
    count = len(np.unique(problem.stretch))
    pulls = [scaled[rows].T @ each[rows] for rows in rows_of_stretches(problem.stretch)]
    result: FloatArray = np.sqrt(count / max(count - 1, 1)) * np.array(pulls)
    return result


def rows_of_stretches(stretch: NDArray[np.int64]) -> list[slice | NDArray[np.int64]]:
    """Which equations are of each stretch, in the order of their numbers.

    ``stretch``: number of each equation's, shape (E,).
    """
    if (np.diff(stretch) >= 0).all():
        _, first = np.unique(stretch, return_index=True)
        ends = [*first[1:], len(stretch)]
        return [slice(one, end) for one, end in zip(first, ends, strict=True)]
    return [np.flatnonzero(stretch == label) for label in np.unique(stretch)]
