"""How far torque differs from run to run, as a calibration's runs show it: how probable each standard deviation is.

It is the part ``torque_spread`` of a calibration's section. Older files have none:

    torque_spread:
      stated_N_m: 0.001            # what the robot file expects
      weights: 0.01 0.012 ..       # of `TorqueSpread.deviations`, in their order
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from proprio_ros.calibration_files.section import lines_of, numbers_of, part_of, read_under, short
from proprio_ros.inputs.forms import FormError, Number, under
from proprio_ros.records import FloatArray

KEY = "torque_spread"
LEAST, MOST, STEPS = 0.03, 10.0, 36
"""The grid of standard deviations, in parts of what is stated: a robot beyond six times that is refused."""
_STATED = Number("torque that differs from run to run", "N m", 0.0, 100.0, open=True)
_DIGITS = 12


@dataclass(frozen=True, eq=False)
class TorqueSpread:
    """A distribution of the standard deviation of torque from run to run.

    Attributes:
        stated: Standard deviation that the robot file expects [N m].
        weights: Probabilities of `deviations`, shape (STEPS,); they add up to 1.
    """

    stated: float
    weights: FloatArray

    @property
    def deviations(self) -> FloatArray:
        """Standard deviations in equal steps of their logarithm [N m], shape (STEPS,)."""
        grid: FloatArray = self.stated * np.geomspace(LEAST, MOST, STEPS)
        return grid


def torque_spread_settings(spread: TorqueSpread | None) -> dict[str, Any]:
    """The part of a section; nothing where there is none."""
    if spread is None:
        return {}
    weights = lines_of([spread.weights], _DIGITS)
    return {KEY: {"stated_N_m": short(spread.stated), "weights": weights}}


def torque_spread_of(section: Mapping[str, Any]) -> TorqueSpread | None:
    """The reverse; None where the section has none.

    Args:
        section: Of a robot file.

    Raises:
        FormError: The weights are no probabilities of `STEPS` standard deviations.
    """
    if KEY not in section:
        return None
    entry = part_of(section, KEY, Mapping)
    with under(KEY):
        stated = read_under(entry, "stated_N_m", _STATED)
        weights = np.ravel(numbers_of(entry, "weights"))
        sound = len(weights) == STEPS and np.all(np.isfinite(weights)) and np.all(weights >= 0.0)
        if not sound or abs(weights.sum() - 1.0) > 1e-6:
            raise FormError(f"weights must be {STEPS} probabilities; calibrate again")
    return TorqueSpread(stated, weights)
