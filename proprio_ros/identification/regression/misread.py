"""Which joint a recording has the wrong way round, or under another joint's name: what explains its torques once it is undone.

Drivers and data sets change how a joint counts from version to version, and list joints in another order. An arm with such a joint
may still be explained, by bodies and a payload that are none: what one joint's torque does not fit, it does not decide. So each
such mistake is undone in turn, in the recordings with the payload, in those without, and in all of them; bodies within what the
robot file (or a calibration) leaves open, payload and friction are fitted anew, and the likelihoods are compared. Friction only
ever brakes: that tells an effort of the wrong sign where a joint carries nothing.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from proprio_ros.calibration_files.motions import ARM_TERMS, FRICTION_TERMS
from proprio_ros.errors import RecordingError
from proprio_ros.identification.regression.motion_equations import (
    HOP_SHARE,
    Arm,
    Rows,
    equations,
    own_terms,
)
from proprio_ros.identification.regression.motion_prior import priors_of_file
from proprio_ros.identification.regression.solve import Prior, posterior
from proprio_ros.recordings.motions import Motion
from proprio_ros.records import FloatArray
from proprio_ros.robot import Robot
from proprio_ros.robot.regressor import PARAMETERS

SURE = 30.0
"""By so much a mistake has to raise the logarithm of the likelihood when it is undone. On real recordings of a UR10e without one no
mistake reaches 3, and any that changes the mass reaches 170."""
CLEARER = 10.0
"""Two mistakes that are closer are not told apart, and are named together."""
EXPLAINED = 0.25
"""Of a joint's torque: without a mistake less is left over, on real and simulated arms up to 0.16."""
# Enough to follow what is smoothed to 6 Hz, and to compare some hundred mistakes within seconds.
RATE_HZ = 40.0
LONGEST_S = 60.0
ROUNDS = 5  # of weights, and of friction that would drive: the third changes little

NAMED_AT_MOST = 2
LOUDER = (0.01, 0.1, 0.25, 0.5, 0.75, 1.4, 2.0, 4.0, 10.0, 100.0)
"""Times what they should be, another unit or scale of efforts: a coarse grid is enough to be closer than another mistake."""
CONCERNS = ((True, True), (True, False), (False, True))
"""Positions and efforts, positions alone, efforts alone."""
LOADED, EMPTY, ALL = "loaded", "empty", "all"
"""Which motions a mistake is in."""


@dataclass(frozen=True)
class Misreading:
    """One mistake: columns that have the wrong sign or stand under the wrong name."""

    fault: str  # in words, what is wrong with which joints
    column: tuple[int, ...]  # that is really each joint's, shape (n,)
    sign: tuple[float, ...]  # by which that column is multiplied, shape (n,)
    positions: bool  # whether it concerns positions
    efforts: bool

    @property
    def words(self) -> str:
        """The sentence, without where it was made."""
        which = "positions and efforts" if self.efforts else "positions"
        return f"{which if self.positions else 'efforts'} of {self.fault}"

    def undone(self, motion: Motion) -> Motion:
        """The motion without it."""
        order = list(self.column)
        sign = np.array(self.sign)
        position = sign * motion.position[:, order] if self.positions else motion.position
        current_A = sign * motion.current_A[:, order] if self.efforts else motion.current_A
        return replace(motion, position=position, current_A=current_A)


@dataclass(frozen=True)
class Found:
    """The mistake that explains recordings."""

    words: str
    # whether positions are concerned: then the mass is another one, whether the joint's own torque decides or not
    of_positions: bool


@dataclass(frozen=True)
class _Squares:
    """Sums of squares and products of one motion's equations, by joint.

    Columns: payload (10), the arm's terms (17 n), friction (3 n), torque.
    """

    products: FloatArray  # shape (n, K, K)
    windows: FloatArray  # that do not overlap, by joint, shape (n,)
    log_scale: float = 0.0  # what the likelihood of a torque is less for its being scaled

    def mean_of(self, squares: FloatArray) -> FloatArray:
        """Of sums of squares by joint, the mean over all windows, shape (n,)."""
        return squares / np.maximum(self.windows, 1e-9) * HOP_SHARE

    def louder(self, factor: FloatArray) -> _Squares:
        """With torques that were recorded so many times too large, shape (n,)."""
        products = self.products.copy()
        products[:, -1] /= factor[:, None]
        products[:, :, -1] /= factor[:, None]
        log_scale = float(self.windows @ np.log(np.abs(factor)))
        return replace(self, products=products, log_scale=log_scale)

    @classmethod
    def of(cls, rows: Rows) -> _Squares:
        columns = np.column_stack([rows.payload, rows.design, rows.torque])
        count = rows.design.shape[1] // (ARM_TERMS + len(FRICTION_TERMS))
        parts = [columns[rows.joint == joint] for joint in range(count)]
        windows = HOP_SHARE * np.array([len(part) for part in parts])
        return cls(
            np.array([part.T @ part for part in parts]),
            windows,
        )


@dataclass(frozen=True)
class _Fit:
    """What one reading of all motions is worth."""

    cost: float  # less the logarithm of the likelihood
    unexplained: FloatArray  # share of each joint's torque, shape (n,)


@dataclass(frozen=True)
class _Try:
    """One mistake, undone in some of the motions."""

    mistake: Misreading
    scope: str  # LOADED, EMPTY or ALL
    fit: _Fit


class _Fitting:
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
        """Where the columns of a motion's `_Squares` stand among the unknowns; the torque is the last."""
        size = len(self.prior.values)
        at = self.shared + self.own * number
        friction = np.arange(at, at + self.own)
        return np.concatenate([np.arange(self.shared), friction, [size]])

    def fit(self, parts: Sequence[_Squares]) -> _Fit:
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
        pull = 0.0
        for _ in range(ROUNDS):
            weight = np.where(
                moved,
                HOP_SHARE / np.maximum(variance, 1e-18),
                0.0,
            )
            values, pull = self._solved(
                np.tensordot(weight, pooled.products, 1),
                kept,
            )
            with_torque = np.append(values, -1.0)
            rest = np.maximum(with_torque @ pooled.products @ with_torque, 1e-9 * torque)
            variance = pooled.mean_of(rest)
            kept &= ~(self.brakes & (values < 0.0))
        logs = np.log(np.where(moved, np.maximum(variance, 1e-18), 1.0))
        share = np.sqrt(rest / np.maximum(torque, 1e-18))
        cost = 0.5 * float(pooled.windows @ logs) + pull + pooled.log_scale
        return _Fit(cost, np.where(moved, share, 0.0))

    def _pooled(self, parts: Sequence[_Squares]) -> _Squares:
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
        return _Squares(
            products,
            windows,
            sum(part.log_scale for part in parts),
        )

    def _solved(self, normal: FloatArray, kept: NDArray[np.bool_]) -> tuple[FloatArray, float]:
        """The unknowns that are kept by weighted products, the others 0, and how improbable they are by their prior."""
        inside = np.ix_(kept, kept)
        prior = Prior(
            self.prior.values[kept],
            self.prior.covariance[inside],
        )
        side = normal[:-1, -1][kept]
        information = normal[:-1, :-1][inside]
        found, _ = posterior(information, side, prior)
        values = np.zeros(len(kept))
        values[kept] = found
        # at the optimum what the data still pull with is what the prior holds against
        return values, 0.5 * float((found - prior.values) @ (side - information @ found))


def misread(
    robot: Robot,
    loaded: Sequence[Motion],
    empty: Sequence[Motion] = (),
) -> Found | None:
    """The mistake without which motions are explained well, and far better than with it.

    Args:
        robot: With its calibration, where it has one of motions.
        loaded: Motions with the payload, or none.
        empty: Of the same joints with an empty hand, or none.

    Returns: None where nothing is sure.
    """
    motions = [thinned(motion, RATE_HZ, LONGEST_S) for motion in (*loaded, *empty)]
    joints = motions[0].joints
    if any(motion.joints != joints for motion in motions):
        return None
    arm = Arm.of(
        robot,
        joints,
        dict(motions[0].held),
    )
    fitting = _Fitting(
        robot,
        arm,
        len(motions),
        len(loaded),
    )
    try:
        as_recorded = [_squares(robot, motion) for motion in motions]
        before = fitting.fit(as_recorded)
        louder = _louder(as_recorded, fitting)
        for mistakes in (_reversed(joints), _exchanged(joints)):
            tries = [
                each
                for mistake in mistakes
                for each in _undone(robot, mistake, motions, as_recorded, fitting)
            ]
            found = _best(tries, before, louder, loaded, empty)
            if found is not None:
                return found
    except (RecordingError, np.linalg.LinAlgError):
        return None
    return None


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


def _squares(robot: Robot, motion: Motion) -> _Squares:
    return _Squares.of(equations(robot, motion, motion.joints, by_zeros=False))


def _reversed(joints: Sequence[str]) -> Iterator[Misreading]:
    """Each joint turned round."""
    same = tuple(range(len(joints)))
    for number, joint in enumerate(joints):
        sign = tuple(-1.0 if other == number else 1.0 for other in same)
        fault = f"{joint} are counted the other way round"
        for positions, efforts in CONCERNS:
            yield Misreading(fault, same, sign, positions, efforts)


def _exchanged(joints: Sequence[str]) -> Iterator[Misreading]:
    """Two joints under each other's name, and all in the order of the alphabet."""
    sign = (1.0,) * len(joints)
    for one, other in itertools.combinations(range(len(joints)), 2):
        order = list(range(len(joints)))
        order[one] = other
        order[other] = one
        fault = f"{joints[one]} and {joints[other]} are exchanged"
        for positions, efforts in CONCERNS:
            yield Misreading(fault, tuple(order), sign, positions, efforts)
    alphabet = sorted(joints)
    order = [alphabet.index(joint) for joint in joints]
    if alphabet != list(joints):
        yield Misreading(
            "all joints are in the order of the alphabet, their names are not",
            tuple(order),
            sign,
            positions=True,
            efforts=True,
        )


def _undone(
    robot: Robot,
    mistake: Misreading,
    motions: Sequence[Motion],
    as_recorded: Sequence[_Squares],
    fitting: _Fitting,
) -> Iterator[_Try]:
    """A mistake undone in the loaded motions, in the empty ones, and in all."""
    without = [_squares(robot, mistake.undone(motion)) for motion in motions]
    for scope, parts in _mixed(without, as_recorded, fitting.loaded).items():
        yield _Try(mistake, scope, fitting.fit(parts))


def _louder(as_recorded: Sequence[_Squares], fitting: _Fitting) -> float:
    """The least cost of efforts in another unit, of one joint or of all, or all negated, in some of the motions or all."""
    count = fitting.count
    every = [np.full(count, factor) for factor in (-1.0, *LOUDER)]
    alone = [
        np.where(joint, factor, 1.0) for joint in np.eye(count, dtype=bool) for factor in LOUDER
    ]
    costs: list[float] = []
    for factors in (*every, *alone):
        louder = [part.louder(factors) for part in as_recorded]
        mixed = _mixed(louder, as_recorded, fitting.loaded)
        costs.extend(fitting.fit(parts).cost for parts in mixed.values())
    return min(costs)


def _mixed(
    without: Sequence[_Squares], as_recorded: Sequence[_Squares], loaded: int
) -> dict[str, list[_Squares]]:
    """Motions ``without`` a mistake: all, those with the payload alone, those with an empty hand alone."""
    if not 0 < loaded < len(as_recorded):
        return {ALL: list(without)}
    return {
        ALL: list(without),
        LOADED: [*without[:loaded], *as_recorded[loaded:]],
        EMPTY: [*as_recorded[:loaded], *without[loaded:]],
    }


def _best(
    tries: Sequence[_Try],
    before: _Fit,
    louder: float,
    loaded: Sequence[Motion],
    empty: Sequence[Motion],
) -> Found | None:
    """The one that is sure, or two that are not told apart.

    Args:
        tries: Of which one is asked for.
        before: As it was recorded.
        louder: What another unit of efforts costs.
        loaded: The motions with the payload.
        empty: Those with an empty hand.
    """
    best = min(tries, key=lambda each: each.fit.cost, default=None)
    if best is None or min(before.cost - SURE, louder) < best.fit.cost:
        return None
    if float(best.fit.unexplained.max()) > EXPLAINED:
        return None
    alike = [each for each in tries if each.fit.cost < best.fit.cost + CLEARER]
    alike.sort(key=lambda each: each.fit.cost)
    words = dict.fromkeys(each.mistake.words for each in alike)
    if len(words) > NAMED_AT_MOST:
        return None
    scopes = {each.scope for each in alike}
    where = f"{(*loaded, *empty)[0].name}: "
    if scopes == {EMPTY}:
        where = f"{empty[0].name}: "
    elif scopes == {ALL} and len(loaded) + len(empty) > 1:
        where = "all recordings: "
    of_positions = any(each.mistake.positions for each in alike)
    return Found(where + ", or ".join(words), of_positions)
