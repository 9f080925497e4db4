"""The regression: unknowns with a Gaussian prior, rows in windows whose errors are correlated, one solution with its covariance.

The weights of a joint's rows follow what is left over of them, and for how many windows that is alike. What goes with the solution
itself is filled in from step to step: gears lose a share of what they transmit, and a motor's torque is off by a share of itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from proprio_ros.calibration_files.motions import ARM_TERMS, MotionCalibration
from proprio_ros.identification.regression.motion_equations import Problem, fill_drives
from proprio_ros.identification.regression.recording_variability import (
    CLOCK,
    CONSIDERED,
    LEARNT,
    PUBLISHED,
    RecordingVariability,
    by_evidence,
)
from proprio_ros.records import FloatArray
from proprio_ros.robot.regressor import PARAMETERS

# Of weights and load friction; the mass of a UR10e changes by less than 1 g in the last.
ITERATIONS = 6
WAVES = 4  # Sine and cosine of a joint's angle, and of twice the angle.
PLACE_SHARE = 0.15  # Standard deviation of each of them in Coulomb friction, relative to it.

# Of a joint's independent windows at least so many count as not used up by unknowns.
FEWEST_FREE = 0.2
FIXED = 1e-6  # Of its spread is what a term that is not followed may move by.
# Inertia that ends so many standard deviations of its prior from nothing is as open as that.
SPREAD_SIGMAS = 3.0


@dataclass(frozen=True)
class Prior:
    """Gaussian, of U unknowns: values, shape (U,), and covariance, shape (U, U)."""

    values: FloatArray
    covariance: FloatArray


def posterior(
    information: FloatArray, side: FloatArray, prior: Prior
) -> tuple[FloatArray, FloatArray]:
    """Mean and covariance, ``(1 + V N)^-1 V``: neither the prior V nor the data N need an inverse of their own.

    Both are scaled by the prior's standard deviations, which differ by ten orders of magnitude.

    ``information``: of the data, N, shape (U, U); ``side``: what they say, weighted alike, shape (U,); ``prior``: of the unknowns.
    """
    spread = np.sqrt(np.diag(prior.covariance))
    correlation = prior.covariance / spread[:, None] / spread
    normal = information * spread[:, None] * spread
    shrunk = np.linalg.solve(
        np.eye(len(spread)) + correlation @ normal,
        correlation,
    )
    shrunk = 0.5 * (shrunk + shrunk.T)
    values = prior.values + spread * (shrunk @ (spread * (side - information @ prior.values)))
    return values, shrunk * spread[:, None] * spread


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
    between: RecordingVariability  # by what recordings differ, with what these show
    scaled: FloatArray  # the equations times their weights, shape (E, U)
    weight: FloatArray  # shape (E,)

    @property
    def payload_prior(self) -> FloatArray:
        """Standard deviations of the payload's parameters under their prior, shape (10,)."""
        return np.sqrt(np.diag(self.prior.covariance))[:PARAMETERS]

    def mass_and_std(self) -> tuple[float, float]:
        """The mass [kg], and the larger of its standard deviations by the fit and by its stretches."""
        return float(self.values[0]), float(np.sqrt(max(self.noise()[0, 0], self.covariance[0, 0])))

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


def solve_following(
    problem: Problem,
    prior: Prior,
    between: RecordingVariability,
    per_kg: FloatArray,
    known: MotionCalibration | None,
) -> tuple[Solution, Solution, FloatArray]:
    """The estimate that follows what differs as the evidence has it, the open one, and its scatter, shape (U, U).

    Where nothing is ``known``, recordings differ from their mean: torque and zeros of that are the arm's own.
    """
    opened = solve(problem, prior, between, per_kg, known, followed=CONSIDERED)
    first = problem.own(0).start
    kinds = np.tile(between.kinds, problem.motions)
    at = first + np.flatnonzero(np.isin(kinds, CONSIDERED))
    basis: FloatArray = np.eye(len(at))
    if known is None:
        basis = np.asarray(
            np.kron(
                _contrasts(problem.motions),
                np.eye(len(at) // problem.motions),
            ),
            np.float64,
        )
    # what the data say of these terms alone; all else follows them linearly
    precision = np.linalg.inv(opened.covariance[np.ix_(at, at)])
    information = precision - np.diag(
        1.0 / np.square(np.tile(opened.between.std, problem.motions)[at - first])
    )
    leads = opened.covariance[:, at] @ precision
    std = np.tile(between.std, problem.motions)[at - first]
    information = std[:, None] * information * std
    side = std * (precision @ opened.values[at])
    of_basis = basis.T @ information @ basis, basis.T @ side
    mean, wider, terms, weights = by_evidence(
        kinds[at - first][: basis.shape[1]],
        *of_basis,
    )
    mean = basis @ mean
    terms = terms @ basis.T
    apart = (terms - mean) * std @ leads.T
    spreads = {
        **opened.between.spreads,
        **{kind: between.spreads[kind] * times for kind, times in wider.items()},
    }
    differs = replace(opened.between, spreads=spreads)
    wide = Prior(opened.prior.values, opened.prior.covariance.copy())
    spread = np.tile(differs.std, problem.motions)[at - first][:, None] * basis
    wide.covariance[np.ix_(at, at)] = spread @ spread.T
    _, covariance = posterior(opened.information, opened.information @ wide.values, wide)
    values = opened.values + leads @ (std * mean - opened.values[at])
    left_over = problem.torque - opened.scaled @ values / opened.weight
    deviations = scores(opened.scaled, left_over * opened.weight, problem.stretch) @ covariance
    fields = {
        "values": values,
        "covariance": covariance,
        "prior": wide,
        "between": differs,
        "residual": left_over,
    }
    return (
        replace(opened, deviations=deviations, **fields),
        opened,
        (apart * weights[:, None]).T @ apart,
    )


def _contrasts(count: int) -> FloatArray:
    """What differs between so many, without their mean: orthonormal columns, shape (count, count - 1)."""
    orthonormal, _ = np.linalg.qr(np.eye(count) - 1.0 / count)
    result: FloatArray = orthonormal[:, : count - 1]
    return result


def solve(
    problem: Problem,
    prior: Prior,
    between: RecordingVariability,
    per_kg: FloatArray,
    known: MotionCalibration | None = None,
    followed: Sequence[str] = (),
) -> Solution:
    """Solve it, with weights, load friction, the payload's size and the spread of recordings from the solution before.

    Args:
        problem: Its equations.
        prior: Of its unknowns, without what recordings differ by.
        between: By how much they do.
        per_kg: Standard deviations of the payload's parameters, per kg that it weighs, shape (10,).
        known: By which residuals are known; without one, the place's part of Coulomb friction is open by a share of it.
        followed: Kinds of what recordings differ by that the solution follows, beside friction and offsets.
    """
    matrix = problem.matrix.copy()
    right = problem.torque
    joint = problem.joint
    count = problem.count
    arm = PARAMETERS + ARM_TERMS * count
    geared = slice(PARAMETERS + 11 * count, PARAMETERS + 12 * count)
    waves = geared.stop + count + np.arange(WAVES * count)
    same, own = np.diag(prior.covariance).copy(), slice(arm, None)
    prior = Prior(prior.values, prior.covariance.copy())
    stated = between
    learnt = (*LEARNT, *followed) if between.friction.any() else followed
    kinds = [kind for kind in PUBLISHED if kind in learnt and kind not in CLOCK]
    follows = np.where(
        np.isin(between.kinds, (*LEARNT, *followed)),
        1.0,
        FIXED,
    )

    def differing() -> None:
        """Give every motion's own terms their spread."""
        at = range(arm, len(same))
        prior.covariance[at, at] = same[own] + np.tile(
            np.square(between.std * follows), problem.motions
        )

    differing()
    moves = np.bincount(joint, minlength=count) > 0
    rms, correlation = np.ones(count), np.ones(count)

    def solved() -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        weight = 1.0 / (rms * np.sqrt(correlation))[joint]
        scaled = matrix * weight[:, None]
        information = scaled.T @ scaled
        return (
            weight,
            scaled,
            information,
            *posterior(information, scaled.T @ (right * weight), prior),
        )

    for _ in range(ITERATIONS):
        _, scaled, _, values, covariance = solved()
        residual = right - matrix @ values
        rms, correlation = np.zeros(count), np.ones(count)
        for number in np.flatnonzero(moves):
            mine = joint == number
            rms[number] = max(float(np.std(residual[mine])), 1e-9)
            correlation[number] = correlated_windows(residual[mine], problem.stretch[mine])
            if known is not None and followed:  # what unknowns take up is not left over
                used = (
                    np.einsum("ij,ij->", scaled[mine] @ covariance, scaled[mine])
                    * correlation[number]
                    / mine.sum()
                )
                rms[number] /= np.sqrt(max(1.0 - used, FEWEST_FREE))
        if known is not None:
            # what a longer recording knows of its residuals holds for a short one, too
            rms, correlation = (
                np.maximum(rms, 0.5 * known.residual),
                np.maximum(correlation, known.correlation),
            )
        else:
            coulomb = np.mean(
                [values[problem.own(n, count)][:count] for n in range(problem.motions)], axis=0
            )
            prior.covariance[waves, waves] = np.tile(
                np.square(PLACE_SHARE * coulomb) + 1e-12, WAVES
            )
        # something light has little first moment and inertia, wherever in the hand it sits
        heavy_kg = abs(values[0]) + np.sqrt(covariance[0, 0])
        stds = heavy_kg * per_kg
        # but what is seen to be spread further is: else 0.25 kg m^2 of a bar of 2 kg came out 12 % too small, 2.6 half widths off
        stds[4:] *= max(
            1.0,
            float(np.max(np.abs(values[4:PARAMETERS]) / stds[4:])) / SPREAD_SIGMAS,
        )
        prior.covariance[range(1, PARAMETERS), range(1, PARAMETERS)] = stds[1:] ** 2
        off = (values[own] - prior.values[own]).reshape(
            problem.motions,
            -1,
        )
        between = stated.learnt(
            between,
            off,
            np.diag(covariance)[own].reshape(off.shape),
            kinds,
        )
        differing()
        fill_drives(matrix, values, problem, geared)
        problem.fill_own(matrix, values)
    weight, scaled, information, values, covariance = solved()
    deviations = scores(scaled, right * weight - scaled @ values, problem.stretch) @ covariance
    left_over = right - matrix @ values
    return Solution(
        values,
        covariance,
        information,
        deviations,
        left_over,
        rms,
        correlation,
        prior,
        between,
        scaled,
        weight,
    )


def correlated_windows(residual: FloatArray, stretch: NDArray[np.int64]) -> float:
    """Over how many windows a joint's residuals are correlated: one and twice the sum of their correlations within a stretch."""
    total = 1.0
    variance = float(np.mean(residual**2))
    longest = int(np.bincount(np.unique(stretch, return_inverse=True)[1]).max())
    for lag in range(1, longest):
        same = stretch[lag:] == stretch[:-lag]
        if same.sum() < longest:
            break
        step = float(np.mean(residual[lag:][same] * residual[:-lag][same])) / variance
        if step < 0.05:
            break
        total += 2.0 * step
    return total


def scores(
    scaled: FloatArray,
    left_over: FloatArray,
    stretch: NDArray[np.int64],
) -> FloatArray:
    """What each stretch pulls the solution by, but for its covariance, shape (stretches, U)."""
    labels = np.unique(stretch)
    pulls = np.array([scaled[stretch == label].T @ left_over[stretch == label] for label in labels])
    result: FloatArray = np.sqrt(len(labels) / max(len(labels) - 1, 1)) * pulls
    return result
