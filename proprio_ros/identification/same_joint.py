"""Whether a recording is of the joint that was calibrated: what it shows of friction and rotor by itself says so.

A calibration of another servo, another arm or another gain explains a recording as well as the right one: a pendulum that is let go
determines ratios alone, and a torque that is a quarter of what it is taken for is that of a quarter of the load. But then friction,
damping and the rotor's inertia come out in the same wrong proportion. So each recording is asked for these terms, with everything
but them and the load as the calibration has it, and they are compared with those of the calibration's own recordings. By how much
the terms of one joint differ from one recording to the next is learnt from these, beside what is usual.

A swing shows two terms alone, and another joint may have such friction by chance: the worse friction repeats, the likelier. So
`OtherJoint` has the probability of that, which counts in the interval (Bayes' rule, both densities below). Dry and viscous friction
of warm gears are less together; their proportion tells more than their sum.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from proprio_ros.calibration_files.own_terms import (
    UNITS,
    OwnTerms,
)
from proprio_ros.identification.chance import chi2_tail, normal_density
from proprio_ros.identification.judge import (
    Refusal,
    not_identifiable,
    rejected,
)
from proprio_ros.identification.regression.recording_variability import (
    spread_of_runs,
)
from proprio_ros.quantity import shown
from proprio_ros.records import FloatArray

PSEUDO_RUNS = 2.0  # So many recordings what is usual counts as, as in the fit of a calibration.
UNLIKELY = 0.02
"""With this probability a joint's own recordings differ so far from each other."""
COVERED = 2.0
"""A load may be so many times lighter than the lightest that was known, or heavier than the heaviest: with a calibration of another
servo, what is otherwise right is so far outside most often."""


ASKED_AMISS = 0.01
"""The share of recordings that are asked by the calibration of another joint. By hand: nobody knows it of real users."""
OTHER_LOADS = 0.7
"""Standard deviation of the logarithm of what another joint's calibration makes of a mass: a factor of two."""
LIKE_KNOWN = 0.5
"""Likewise of masses that are asked, about the known ones: what lies far from them is not covered."""
TOGETHER = 0.15
"""By what share of itself all friction of a joint differs from one swing to the next."""
LIKELY_ANOTHER = 0.07
"""A joint that is another one with this probability is refused. Of 160 real swings by another servo's calibration the least
probable had 0.08, and of 128 by the right one's the most probable 0.064."""


@dataclass(frozen=True)
class Comparison:
    """Terms of a recording beside those of a calibration's own.

    Attributes:
        now: Of the recording, shape (T,).
        known: Mean over the calibration's recordings, shape (T,).
        covariance: Of their difference, shape (T, T).
        usual: By how much each differs from one recording to the next, shape (T,).
    """

    now: FloatArray
    known: FloatArray
    covariance: FloatArray
    usual: FloatArray

    @property
    def distances(self) -> FloatArray:
        """Of each term in standard deviations, shape (T,)."""
        return (self.now - self.known) / np.sqrt(np.diag(self.covariance))

    @property
    def square(self) -> float:
        """Squared distance of all together, in standard deviations."""
        apart = self.now - self.known
        return float(apart @ np.linalg.solve(self.covariance, apart))

    @property
    def probability(self) -> float:
        """Of a larger distance, where both are of one joint."""
        return chi2_tail(self.square, len(self.now))

    @property
    def evidence(self) -> float:
        """How many times likelier such terms are where both are of one joint than where they are of any two.

        Each term of any joint has the density of an exponential distribution, all terms of one size in parts of `usual`.
        """
        count = len(self.now)
        scaled = self.covariance / np.outer(self.usual, self.usual)
        same = np.exp(-0.5 * self.square) / np.sqrt(np.linalg.det(2.0 * np.pi * scaled))
        size = max(float(np.sum(self.known / self.usual)), 1e-9) / count
        now = max(float(np.sum(self.now / self.usual)), 0.0)
        any_two = np.exp(-now / size) / size**count
        return float(same / max(any_two, 1e-300))


@dataclass(frozen=True)
class OtherJoint:
    """How probable it is that a swing is of another joint than the calibration's."""

    comparison: Comparison
    probability: float

    @classmethod
    def of(
        cls,
        comparison: Comparison,
        mass_kg: float,
        loads_kg: Sequence[float],
    ) -> OtherJoint:
        """By what it shows and what it would carry.

        Args:
            comparison: Of what it and the calibration's swings show by themselves.
            mass_kg: What it would carry.
            loads_kg: That were known.
        """
        known = np.log([load for load in loads_kg if load > 0.0] or [max(mass_kg, 1e-9)])
        off = float(np.log(max(mass_kg, 1e-9)) - known.mean())
        same = normal_density(off, LIKE_KNOWN) * comparison.evidence
        other = normal_density(off, float(np.hypot(LIKE_KNOWN, OTHER_LOADS)))
        amiss = ASKED_AMISS * other
        return cls(comparison, float(amiss / (amiss + (1.0 - ASKED_AMISS) * same)))

    @property
    def share(self) -> float:
        """What it puts on the mass, as a share of it: standard deviation."""
        return OTHER_LOADS * float(np.sqrt(self.probability))


def mean_of(own: Sequence[OwnTerms]) -> OwnTerms:
    """What recordings that are asked together show."""
    count = len(own)
    values = np.mean([each.values for each in own], axis=0)
    std = np.sqrt(np.sum([each.std**2 for each in own], axis=0)) / count
    return OwnTerms(
        values,
        std,
        np.mean([each.usual for each in own], axis=0),
    )


def compared(
    known: Sequence[OwnTerms],
    now: OwnTerms,
    together: float = 0.0,
) -> Comparison:
    """A recording's terms beside those of a calibration's own recordings.

    Args:
        known: Of each of its recordings.
        now: Of the one that is asked.
        together: By what share of themselves all terms differ together from one recording to the next, beside what each does.
    """
    usual = np.mean([each.usual for each in known], axis=0)
    own = np.mean([each.values for each in known], axis=0)
    axes, stated = _axes(own / usual, together)
    values = np.array([axes @ (each.values / usual) for each in known])
    variances = np.array([axes**2 @ (each.std / usual) ** 2 for each in known])
    weights = 1.0 / (variances + stated**2)
    mean = (weights * values).sum(axis=0) / weights.sum(axis=0)
    # of what a recording differs by, the part that is no error of its own
    learnt = stated**2 / (stated**2 + variances)
    found = learnt * (values - mean)
    counts = learnt * (len(known) - 1) / len(known)  # one of them goes into the mean
    spread = np.array(
        [
            spread_of_runs(
                float(each),
                found[:, axis],
                counts[:, axis],
                PSEUDO_RUNS,
            )
            for axis, each in enumerate(stated)
        ]
    )
    error = axes**2 @ (now.std / usual) ** 2
    variance = spread**2 + error + 1.0 / weights.sum(axis=0)
    back = usual[:, None] * axes.T
    return Comparison(
        now.values,
        back @ mean,
        (back * variance) @ back.T,
        usual,
    )


def _axes(own: FloatArray, together: float) -> tuple[FloatArray, FloatArray]:
    """Along what recordings of one joint differ independently, and by how much, in parts of what is usual.

    Args:
        own: The joint's terms, in these parts, shape (T,).
        together: See `compared`.

    Returns: Directions, the rows, shape (T, T), the first that in which all terms grow alike; standard deviations, shape (T,).
    """
    count = len(own)
    stated = np.ones(count)
    if together == 0.0:
        return np.eye(count), stated
    first = np.column_stack([own, np.eye(count)[:, 1:]])
    axes = np.asarray(np.linalg.qr(first)[0]).T
    stated[0] = np.hypot(1.0, together * np.linalg.norm(own))
    return axes, stated


def determined(own: OwnTerms) -> bool:
    """Whether a recording shows its terms at all."""
    return bool(np.all(np.isfinite(own.values)) and np.all(np.isfinite(own.std)))


def another_joint(
    joint: str,
    names: Sequence[str],
    known: Sequence[OwnTerms],
    now: OwnTerms,
) -> Iterator[Refusal]:
    """Where a recording shows another joint than its calibration knows.

    Args:
        joint: Its name.
        names: Of the terms, see `UNITS`.
        known: Of the calibration's recordings; none in an older file, which says nothing.
        now: Of the recording that is asked.
    """
    if not known or not determined(now):
        return
    comparison = compared(known, now)
    if comparison.probability <= UNLIKELY:
        question = "with the same gain and supply, goals stamped as then, and as warm"
        yield refused(joint, names, comparison, known, question)


def refused(
    joint: str,
    names: Sequence[str],
    comparison: Comparison,
    known: Sequence[OwnTerms],
    question: str = "and as warm",
) -> Refusal:
    """That a joint is another one, by the term that differs most.

    Args:
        joint: Its name.
        names: Of the terms, see `UNITS`.
        comparison: Of the recording with the calibration's own.
        known: Of the calibration's recordings.
        question: What else may be otherwise than then.
    """
    worst = int(np.argmax(np.abs(comparison.distances)))
    unit = UNITS[names[worst]]
    own = [float(each.values[worst]) for each in known]
    return rejected(
        "another_joint",
        "this is not the joint that was calibrated, as it was then",
        f"{joint} shows a {names[worst]} of {shown(unit, float(comparison.now[worst]), spec='.2g')}, and in the recordings of its "
        f"calibration it had {shown(unit, min(own), spec='.2g')} to {shown(unit, max(own), spec='.2g')} "
        f"({abs(float(comparison.distances[worst])):.1f} standard deviations): is it that servo, on that arm, {question}? "
        "Calibrate the one that is here",
    )


def outside(
    joint: str,
    mass_kg: float,
    loads_kg: Sequence[float],
    times: float = COVERED,
) -> Iterator[Refusal]:
    """Where a mass is far from all loads of its calibration.

    Args:
        joint: Its name.
        mass_kg: What it carries.
        loads_kg: That were known.
        times: So many times outside of them is far.
    """
    lightest = min((load for load in loads_kg if load > 0.0), default=0.0)
    heaviest = max(loads_kg, default=0.0)
    empty_known = any(load == 0.0 for load in loads_kg)
    light = times * mass_kg < lightest and not empty_known
    if not light and not 0.0 < times * heaviest < mass_kg:
        return
    which = "lighter than" if light else "heavier than"
    limit = shown("kg", lightest if light else heaviest, spec=".0f")
    yield not_identifiable(
        "not_covered",
        f"the calibration does not cover so {'light' if light else 'heavy'} a load",
        f"{joint} moves as with {shown('kg', mass_kg, spec='.0f')}, and no load of its calibration was {which} {limit}: another "
        "servo or arm than the one that was calibrated reads like that, and nothing here tells which. If it is this one, calibrate "
        "with such a load, too",
    )
