"""Whether a recording is of the joint that was calibrated: what it shows of friction and rotor by itself says so.

A calibration of another servo, another arm or another gain explains a recording as well as the right one: a pendulum that is let go
determines ratios alone, and a torque that is a quarter of what it is taken for is that of a quarter of the load. But then friction,
damping and the rotor's inertia come out in the same wrong proportion. So each recording is asked for these terms, with everything
but them and the load as the calibration has it, and they are compared with those of the calibration's own recordings. By how much
the terms of one joint differ from one recording to the next is learnt from these, beside what is usual.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from proprio_ros.calibration_files.own_terms import (
    UNITS,
    OwnTerms,
)
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
"""With this probability a joint's own recordings differ so far from each other. Of 128 real swings by right calibrations the least
likely had 0.025, and of 160 by another servo's the likeliest 0.016."""
COVERED = 2.0
"""A load may be so many times lighter than the lightest that was known, or heavier than the heaviest: with a calibration of another
servo, what is otherwise right is so far outside most often."""


@dataclass(frozen=True)
class Comparison:
    """Terms of a recording beside those of a calibration's own."""

    now: FloatArray  # shape (T,)
    known: FloatArray  # mean over the calibration's recordings, shape (T,)
    std: FloatArray  # of their difference, shape (T,)

    @property
    def distances(self) -> FloatArray:
        """In standard deviations, shape (T,)."""
        return (self.now - self.known) / self.std

    @property
    def probability(self) -> float:
        """Of a larger distance, where both are of one joint."""
        distances = self.distances
        return float(chi2.sf(distances @ distances, len(distances)))


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


def compared(known: Sequence[OwnTerms], now: OwnTerms) -> Comparison:
    """A recording's terms beside those of a calibration's own recordings.

    ``known``: of each of its recordings; ``now``: of the one that is asked.
    """
    usual = np.mean([each.usual for each in known], axis=0)
    values = np.array([each.values for each in known])
    variances = np.square([each.std for each in known])
    weights = 1.0 / (variances + usual**2)
    mean = (weights * values).sum(axis=0) / weights.sum(axis=0)
    # of what a recording differs by, the part that is no error of its own
    learnt = usual**2 / (usual**2 + variances)
    found = learnt * (values - mean)
    counts = learnt * (len(known) - 1) / len(known)  # one of them goes into the mean
    spread = np.array(
        [
            spread_of_runs(
                float(stated),
                found[:, term],
                counts[:, term],
                PSEUDO_RUNS,
            )
            for term, stated in enumerate(usual)
        ]
    )
    variance = spread**2 + now.std**2 + 1.0 / weights.sum(axis=0)
    return Comparison(now.values, mean, np.sqrt(variance))


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
    if not known or not np.all(np.isfinite(now.values)) or not np.all(np.isfinite(now.std)):
        return
    comparison = compared(known, now)
    if comparison.probability > UNLIKELY:
        return
    worst = int(np.argmax(np.abs(comparison.distances)))
    unit = UNITS[names[worst]]
    own = [float(each.values[worst]) for each in known]
    yield rejected(
        "another_joint",
        "this is not the joint that was calibrated, as it was then",
        f"{joint} shows a {names[worst]} of {shown(unit, float(comparison.now[worst]), spec='.2g')}, and in the recordings of its "
        f"calibration it had {shown(unit, min(own), spec='.2g')} to {shown(unit, max(own), spec='.2g')} "
        f"({abs(float(comparison.distances[worst])):.1f} standard deviations): is it that servo, on that arm, with the same gain "
        "and supply, and as warm? Calibrate the one that is here",
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
