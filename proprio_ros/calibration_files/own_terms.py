"""What each recording of a calibration shows of its joint by itself: by it another servo is told from the one that was calibrated.

It is the part ``own_terms`` of a calibration's section: a line for each recording, with the values of its terms, their standard
deviations, and by how much each is expected to differ from one recording to the next. Older files have none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from proprio_ros.calibration_files.section import lines_of, numbers_of
from proprio_ros.inputs.forms import FormError
from proprio_ros.records import FloatArray

KEY = "own_terms"
COULOMB, VISCOUS, ARMATURE = "Coulomb friction", "viscous friction", "rotor inertia"
UNITS: Mapping[str, str] = {COULOMB: "N m", VISCOUS: "N m s/rad", ARMATURE: "kg m^2"}


@dataclass(frozen=True, eq=False)
class OwnTerms:
    """Of one recording, whatever the calibration says of these terms; all of shape (T,), in the terms' units."""

    values: FloatArray
    std: FloatArray  # how well the recording determines them
    usual: FloatArray  # standard deviation from one recording of a joint to the next


def own_terms_text(own: Sequence[OwnTerms]) -> dict[str, str]:
    """The part of a section; nothing where there is none."""
    if not own:
        return {}
    rows = [np.concatenate([each.values, each.std, each.usual]) for each in own]
    return {KEY: lines_of(rows, 8)}


def own_terms_of(
    section: Mapping[str, Any],
    runs: int,
    terms: int,
) -> tuple[OwnTerms, ...]:
    """The reverse; nothing where the section has none.

    Args:
        section: Of a robot file.
        runs: How many recordings it was made of.
        terms: How many terms each shows.

    Raises:
        FormError: There is not a line of finite numbers for each recording.
    """
    if KEY not in section:
        return ()
    rows = numbers_of(section, KEY)
    found = []
    for row in rows:
        if len(row) != 3 * terms or not np.all(np.isfinite(row)):
            raise FormError(f"{KEY}: a line must have {3 * terms} finite numbers; calibrate again")
        values, std, usual = np.reshape(row, (3, terms))
        if np.any(std < 0.0) or np.any(usual <= 0.0):
            raise FormError(f"{KEY}: standard deviations must be positive; calibrate again")
        found.append(OwnTerms(values, std, usual))
    if len(found) != runs:
        raise FormError(f"{KEY} must have a line for each of {runs} runs; calibrate again")
    return tuple(found)
