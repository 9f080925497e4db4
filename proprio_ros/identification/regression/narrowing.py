"""What one more recording would narrow a mass to that was weighed in motion, and of which kind."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from proprio_ros.calibration_files.motions import MotionCalibration
from proprio_ros.identification.regression.error_budget import CALIBRATION, CONSTANTS
from proprio_ros.identification.regression.motion_fit import MotionFit
from proprio_ros.identification.regression.motion_prior import (
    LEAST_TORQUE_STD,
    relative_torque_std,
)
from proprio_ros.identification.regression.recording_variability import (
    PAIRS,
    by_own_spread,
    likely,
)
from proprio_ros.quantity import shown
from proprio_ros.robot import Robot

WORTH = 0.9  # of its half width, at most, that an interval has to have left for advice to be worth a recording


def by_one_more(robot: Robot, calibration: MotionCalibration, fit: MotionFit) -> tuple[str, ...]:
    """A sentence where another recording would narrow the interval: of the kind that does most, with what it would be then.

    Any other recording shows how far those of this machine repeat: what it is expected to say of that counts
    (`recording_variability`), if it says as much as this one. An empty hand's is one more that the arm is known by. A known load
    tells the torque constants, too; one that is no lighter than the object, in a motion like this one, is read no more coarsely,
    relative to itself, than the object was beside the torque constants.

    Args:
        robot: As its file states it.
        calibration: Of the arm, with what known loads have shown of its torque.
        fit: Of the weighing.
    """
    if float(fit.values[0]) <= 0.0:
        return ()
    kinds = [_an_empty_hand(calibration, fit), *_a_known_load(robot, calibration, fit)]
    half, what = min(kinds)
    if half > WORTH * fit.half_width:
        return ()
    mass = float(fit.values[0])
    then = f"{shown('kg', half, spec='.0f')} ({100.0 * half / mass:.0f} %)"
    return (
        f"what would narrow it most: {what}: then about +-{then} instead of +-{shown('kg', fit.half_width, spec='.0f')}",
    )


def _half_width(calibration: MotionCalibration, fit: MotionFit, less: float) -> float:
    """Of the interval [kg], after one more recording, which takes so much of its variance [kg^2]."""
    before = calibration.spread_evidence + by_own_spread(fit.evidence_of_more)
    weights, _ = likely(fit.spread_evidence, PAIRS, before)
    mixture = fit.mixture
    scale = calibration.torque_scale
    then = replace(mixture, weights=weights, variances=mixture.variances - less / scale**2)
    return scale * then.half_width()


def _an_empty_hand(calibration: MotionCalibration, fit: MotionFit) -> tuple[float, str]:
    """Half width [kg] with another empty motion, and its words."""
    known = max(calibration.empty_motions, 1)
    less = fit.parts[CALIBRATION] ** 2 / (known + 1.0)
    words = (
        "another recording with an empty hand, moved alike (`--baseline`, or `proprio calibrate`)"
    )
    return _half_width(calibration, fit, less), words


def _a_known_load(
    robot: Robot, calibration: MotionCalibration, fit: MotionFit
) -> list[tuple[float, str]]:
    """Half width [kg] with a known load, and its words; nothing where one as heavy has been known already."""
    mass = float(fit.values[0])
    known = [float(run["load_kg"]) for run in calibration.runs]
    heaviest = max(known, default=0.0)
    if heaviest >= mass:
        return []
    constants = fit.parts[CONSTANTS]
    beside = math.sqrt(max(float(fit.std[0]) ** 2 - constants**2, 0.0))
    stated = calibration.torque_scale_std
    if heaviest > 0.0:
        stated = max(relative_torque_std(robot, joint) for joint in calibration.joints)
    read = beside / mass
    scale = max(read * stated / math.hypot(read, stated), LEAST_TORQUE_STD)
    less = max(constants**2 - float(np.square(scale * mass)), 0.0)
    load = shown("kg", _handy(mass), spec=".0f")
    instead = f" instead of {shown('kg', heaviest, spec='.0f')}" if heaviest > 0.0 else ""
    words = f"a recording with a known load of about {load}{instead}, moved alike (`proprio calibrate EMPTY --reference BAG=KG`)"
    return [(_half_width(calibration, fit, less), words)]


def _handy(mass_kg: float) -> float:
    """A load of one digit that is no lighter [kg]."""
    digit = 10.0 ** math.floor(math.log10(mass_kg))
    return digit * math.ceil(round(mass_kg / digit, 6))
