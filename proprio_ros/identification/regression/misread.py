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

from proprio_ros.identification.regression.likelihood import (
    CLEARER,
    EXPLAINED,
    NAMED_AT_MOST,
    SURE,
    Fit,
    Recorded,
    squares_of,
)
from proprio_ros.recordings.motions import Motion

MISREAD = "misread_joint"
LOUDER = (0.01, 0.1, 0.25, 0.5, 0.75, 1.4, 2.0, 4.0, 10.0, 100.0)
"""Times what they should be, another unit or scale of efforts: a coarse grid is enough to be closer than another mistake."""
CONCERNS = ((True, True), (True, False), (False, True))
"""Positions and efforts, positions alone, efforts alone."""


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
    code: str = MISREAD

    @property
    def is_misread(self) -> bool:
        """Whether a joint's sign or name is what is wrong."""
        return self.code == MISREAD


@dataclass(frozen=True)
class _Try:
    """One mistake, undone in some of the motions."""

    mistake: Misreading
    scope: str  # LOADED, EMPTY or ALL
    fit: Fit


def misread(recorded: Recorded, rival: float, least: float = SURE) -> Found | None:
    """The mistake without which motions are explained well, and far better than with it.

    Args:
        recorded: The motions.
        rival: The cost of the best explanation that is none of these mistakes.
        least: By so much it has to raise the logarithm of the likelihood when it is undone.

    Returns: None where nothing is sure.
    """
    rival = min(rival, recorded.fit.cost - least)
    joints = recorded.motions[0].joints
    for mistakes in (_reversed(joints), _exchanged(joints)):
        tries = [each for mistake in mistakes for each in _undone(mistake, recorded)]
        found = _best(tries, recorded, rival)
        if found is not None:
            return found
    return None


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


def _undone(mistake: Misreading, recorded: Recorded) -> Iterator[_Try]:
    """A mistake undone in the loaded motions, in the empty ones, and in all."""
    mended = [squares_of(recorded.robot, mistake.undone(motion)) for motion in recorded.motions]
    for scope, fit in recorded.without(mended).items():
        yield _Try(mistake, scope, fit)


def louder(recorded: Recorded) -> float:
    """The least cost of efforts in another unit, of one joint or of all, or all negated, in some of the motions or all."""
    count = recorded.fitting.count
    every = [np.full(count, factor) for factor in (-1.0, *LOUDER)]
    alone = [
        np.where(joint, factor, 1.0) for joint in np.eye(count, dtype=bool) for factor in LOUDER
    ]
    costs: list[float] = []
    for factors in (*every, *alone):
        mended = [part.louder(factors) for part in recorded.squares]
        costs.extend(fit.cost for fit in recorded.without(mended).values())
    return min(costs)


def _best(tries: Sequence[_Try], recorded: Recorded, rival: float) -> Found | None:
    """The one that is sure, or two that are not told apart.

    Args:
        tries: Of which one is asked for.
        recorded: As it was.
        rival: What the best one must not cost more than.
    """
    best = min(tries, key=lambda each: each.fit.cost, default=None)
    if best is None or rival < best.fit.cost:
        return None
    if float(best.fit.unexplained.max()) > EXPLAINED:
        return None
    alike = [each for each in tries if each.fit.cost < best.fit.cost + CLEARER]
    alike.sort(key=lambda each: each.fit.cost)
    words = dict.fromkeys(each.mistake.words for each in alike)
    if len(words) > NAMED_AT_MOST:
        return None
    where = recorded.where({each.scope for each in alike})
    of_positions = any(each.mistake.positions for each in alike)
    return Found(where + ", or ".join(words), of_positions)
