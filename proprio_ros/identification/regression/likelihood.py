"""How probable a reading of motions is: bodies, payload and friction fitted to it, within what is known of the arm.

A mistake in a recording is looked for by undoing it: what was read is mended, all is fitted anew, and the likelihoods are compared.
`misread` does so for joints that are read the wrong way round, `other_causes` for what is wrong beside them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from proprio_ros.calibration_files.motions import ARM_TERMS, FRICTION_TERMS
from proprio_ros.identification.regression.motion_equations import (
    HOP_SHARE,
    Arm,
    Rows,
    equations,
    own_terms,
)
from proprio_ros.identification.regression.motion_prior import priors_of_file
from proprio_ros.identification.regression.solve import Prior, distance_from_prior, posterior
from proprio_ros.recordings.motions import Motion
from proprio_ros.records import FloatArray
from proprio_ros.robot import Robot
from proprio_ros.robot.regressor import PARAMETERS

SURE = 30.0
"""By so much a mistake has to raise the logarithm of the likelihood when it is undone. On real recordings of a UR10e without one no
mistake of signs or names reaches 3, and any of these that changes the mass reaches 170."""
CLEARER = 10.0
"""Two mistakes that are closer are not told apart, and are named together."""
EXPLAINED = 0.25
"""Of a joint's torque: without a mistake less is left over, on real and simulated arms up to 0.16."""
# Enough to follow what is smoothed to 6 Hz, and to compare some hundred mistakes within seconds.
RATE_HZ = 40.0
LONGEST_S = 60.0
ROUNDS = 5  # of weights, and of friction that would drive: the third changes little
NAMED_AT_MOST = 2
LOADED, EMPTY, ALL = "loaded", "empty", "all"
"""Which motions a mistake is in."""


@dataclass(frozen=True)
class Squares:
    """Sums of squares and products of one motion's equations, by joint.

    Columns: payload (10), the arm's terms (17 n), friction (3 n), torque.
    """

    products: FloatArray  # shape (n, K, K)
    windows: FloatArray  # that do not overlap, by joint, shape (n,)
    log_scale: float = 0.0  # what the likelihood of a torque is less for its being scaled

    def mean_of(self, squares: FloatArray) -> FloatArray:
        """Of sums of squares by joint, the mean over all windows, shape (n,)."""
        return squares / np.maximum(self.windows, 1e-9) * HOP_SHARE

    def louder(self, factor: FloatArray) -> Squares:
        """With torques that were recorded so many times too large, shape (n,)."""
        products = self.products.copy()
        products[:, -1] /= factor[:, None]
        products[:, :, -1] /= factor[:, None]
        log_scale = float(self.windows @ np.log(np.abs(factor)))
        return replace(self, products=products, log_scale=log_scale)

    def with_torque(self, rows: Rows, torque: FloatArray, log_scale: float = 0.0) -> Squares:
        """With another torque in the place of the recorded one.

        Args:
            rows: That these are the squares of.
            torque: Of each row [N m], shape (E,).
            log_scale: What the likelihood of a torque is less for its being scaled.
        """
        products = self.products.copy()
        columns = np.column_stack([rows.payload, rows.design])
        for joint in range(len(products)):
            mine = rows.joint == joint
            across = torque[mine] @ columns[mine]
            products[joint, -1, :-1] = across
            products[joint, :-1, -1] = across
            products[joint, -1, -1] = torque[mine] @ torque[mine]
        return replace(self, products=products, log_scale=log_scale)

    @classmethod
    def of(cls, rows: Rows) -> Squares:
        columns = np.column_stack([rows.payload, rows.design, rows.torque])
        count = rows.design.shape[1] // (ARM_TERMS + len(FRICTION_TERMS))
        parts = [columns[rows.joint == joint] for joint in range(count)]
        windows = HOP_SHARE * np.array([len(part) for part in parts])
        return cls(
            np.array([part.T @ part for part in parts]),
            windows,
        )


@dataclass(frozen=True)
class Fit:
    """What one reading of all motions is worth."""

    cost: float  # less the logarithm of the likelihood
    unexplained: FloatArray  # share of each joint's torque, shape (n,)
    unexplained_of_all: float  # share of the torque of all joints together


class Fitting:
    """Bodies, payload and friction of some motions, the first ``loaded`` of them with the payload."""

    def __init__(
        self,
        robot: Robot,
        arm: Arm,
        motions: int,
        loaded: int,
    ) -> None:
        count = arm.count
        self.count = count
        self.loaded = loaded
        self.shared = PARAMETERS + ARM_TERMS * count
        self.own = len(FRICTION_TERMS) * count
        size = self.shared + self.own * motions
        stated = priors_of_file(robot, arm, motions).unknowns
        first = self.shared + own_terms(count) * np.arange(motions)
        friction = (first[:, None] + np.arange(self.own)).ravel()
        kept = np.concatenate([np.arange(self.shared), friction])
        values = stated.values[kept]
        covariance = stated.covariance[np.ix_(kept, kept)]
        known = robot.motion_calibration
        if known is not None:
            arms = slice(PARAMETERS, self.shared)
            values[arms] = known.values[: ARM_TERMS * count]
            covariance[arms, arms] = known.covariance[: ARM_TERMS * count, : ARM_TERMS * count]
        self.prior = Prior(values, covariance)
        brakes = np.zeros(size, dtype=bool)
        for number in range(motions):
            at = self.shared + self.own * number
            brakes[at : at + 2 * count] = True
        self.brakes = brakes  # viscous and Coulomb friction, which are not negative

    def columns(self, number: int) -> NDArray[np.int64]:
        """Where the columns of a motion's `Squares` stand among the unknowns; the torque is the last."""
        size = len(self.prior.values)
        at = self.shared + self.own * number
        friction = np.arange(at, at + self.own)
        return np.concatenate([np.arange(self.shared), friction, [size]])

    def fit(self, parts: Sequence[Squares]) -> Fit:
        """All motions together, each joint weighted by what is left over of it."""
        pooled = self._pooled(parts)
        moved = pooled.windows > 0.0
        torque = pooled.products[:, -1, -1]
        variance = np.where(moved, pooled.mean_of(torque), 1.0)
        kept = np.ones(
            len(self.prior.values),
            dtype=bool,
        )
        rest = torque
        for _ in range(ROUNDS):
            weight = np.where(
                moved,
                HOP_SHARE / np.maximum(variance, 1e-18),
                0.0,
            )
            asked = self._asked(np.tensordot(weight, pooled.products, 1), kept)
            values = np.zeros(len(kept))
            values[kept], _ = posterior(*asked)
            with_torque = np.append(values, -1.0)
            rest = np.maximum(with_torque @ pooled.products @ with_torque, 1e-9 * torque)
            variance = pooled.mean_of(rest)
            kept &= ~(self.brakes & (values < 0.0))
        logs = np.log(np.where(moved, np.maximum(variance, 1e-18), 1.0))
        share = np.sqrt(rest / np.maximum(torque, 1e-18))
        improbable = distance_from_prior(*asked)
        cost = 0.5 * float(pooled.windows @ logs) + 0.5 * improbable + pooled.log_scale
        of_all = float(np.sqrt(rest.sum() / max(float(torque.sum()), 1e-18)))
        return Fit(cost, np.where(moved, share, 0.0), of_all)

    def _pooled(self, parts: Sequence[Squares]) -> Squares:
        """Of all motions, by all unknowns and the torque."""
        size = len(self.prior.values)
        products = np.zeros((self.count, size + 1, size + 1))
        for number, part in enumerate(parts):
            columns = self.columns(number)
            own = part.products.copy()
            if number >= self.loaded:
                own[:, :PARAMETERS] = 0.0
                own[:, :, :PARAMETERS] = 0.0
            products[:, columns[:, None], columns] += own
        windows = np.sum(
            [part.windows for part in parts],
            axis=0,
        )
        return Squares(
            products,
            windows,
            sum(part.log_scale for part in parts),
        )

    def _asked(
        self, normal: FloatArray, kept: NDArray[np.bool_]
    ) -> tuple[FloatArray, FloatArray, Prior]:
        """What the data know of the unknowns that are kept, what they say of them, and their prior."""
        inside = np.ix_(kept, kept)
        prior = Prior(
            self.prior.values[kept],
            self.prior.covariance[inside],
        )
        return normal[:-1, :-1][inside], normal[:-1, -1][kept], prior


@dataclass(frozen=True)
class Recorded:
    """Motions as they were recorded, and how probable that is."""

    robot: Robot
    motions: tuple[Motion, ...]  # thinned; the first of them with the payload
    rows: tuple[Rows, ...]  # of each
    squares: tuple[Squares, ...]  # of each
    fitting: Fitting
    fit: Fit

    @classmethod
    def of(
        cls, robot: Robot, loaded: Sequence[Motion], empty: Sequence[Motion] = ()
    ) -> Recorded | None:
        """Of motions with the payload, and of motions of the same joints with an empty hand.

        Args:
            robot: With its calibration, where it has one of motions.
            loaded: With the payload, or none.
            empty: With an empty hand, or none.

        Returns: None where they are of different joints.

        Raises `RecordingError`: One is of no use.
        """
        motions = tuple(thinned(motion, RATE_HZ, LONGEST_S) for motion in (*loaded, *empty))
        joints = motions[0].joints
        if any(motion.joints != joints for motion in motions):
            return None
        arm = Arm.of(robot, joints, dict(motions[0].held))
        fitting = Fitting(
            robot,
            arm,
            len(motions),
            len(loaded),
        )
        rows = tuple(equations(robot, motion, joints, by_zeros=False) for motion in motions)
        squares = tuple(Squares.of(each) for each in rows)
        return cls(robot, motions, rows, squares, fitting, fitting.fit(squares))

    def without(self, mended: Sequence[Squares]) -> dict[str, Fit]:
        """Fits without a mistake in all motions, in those with the payload alone, and in those with an empty hand alone.

        ``mended``: each motion without it.
        """
        parts = mixed(mended, self.squares, self.fitting.loaded)
        return {scope: self.fitting.fit(each) for scope, each in parts.items()}

    def where(self, scopes: set[str]) -> str:
        """The recordings that mistakes are in, as a sentence about these begins.

        ``scopes``: of mistakes that are not told apart.
        """
        if scopes == {EMPTY}:
            return f"{self.motions[self.fitting.loaded].name}: "
        if scopes == {ALL} and len(self.motions) > 1:
            return "all recordings: "
        return f"{self.motions[0].name}: "


def thinned(
    motion: Motion,
    rate_hz: float,
    longest_s: float,
) -> Motion:
    """The middle of a long motion, and of fast samples every so many.

    ``motion``: to be thinned; ``rate_hz``: that is kept, about; ``longest_s``: of it.
    """
    times_s = motion.times_s
    middle_s = 0.5 * float(times_s[-1])
    half_s = 0.5 * longest_s
    first, last = np.searchsorted(times_s, [middle_s - half_s, middle_s + half_s])
    every = max(1, int(len(times_s) / (2.0 * middle_s * rate_hz)))
    return motion.part(slice(first, last, every))


def squares_of(robot: Robot, motion: Motion) -> Squares:
    """Of a motion as it is."""
    return Squares.of(equations(robot, motion, motion.joints, by_zeros=False))


def mixed(
    without: Sequence[Squares], as_recorded: Sequence[Squares], loaded: int
) -> dict[str, list[Squares]]:
    """Motions without a mistake: all, those with the payload alone, those with an empty hand alone.

    Args:
        without: All of them, without it.
        as_recorded: The same with it.
        loaded: So many of them, the first, hold the payload.
    """
    if not 0 < loaded < len(as_recorded):
        return {ALL: list(without)}
    return {
        ALL: list(without),
        LOADED: [*without[:loaded], *as_recorded[loaded:]],
        EMPTY: [*as_recorded[:loaded], *without[loaded:]],
    }
