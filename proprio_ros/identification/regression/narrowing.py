"""What would narrow a mass that was weighed in motion, and to what."""

from __future__ import annotations

import math

import numpy as np

from proprio_ros.calibration_files.motions import MotionCalibration
from proprio_ros.identification.regression.error_budget import CONSTANTS
from proprio_ros.identification.regression.motion_fit import MotionFit
from proprio_ros.identification.regression.motion_prior import (
    LEAST_TORQUE_STD,
    relative_torque_std,
)
from proprio_ros.quantity import shown
from proprio_ros.robot import Robot

WORTH = 0.8  # of its half width, at most, that an interval has to have left for advice to be worth a recording


def by_a_known_load(
    robot: Robot, calibration: MotionCalibration, fit: MotionFit
) -> tuple[str, ...]:
    """A sentence where a recording with a known load would narrow the interval, with what it would be then.

    A known load that is no lighter than the object, in a motion like this one, is read no more coarsely, relative to itself, than
    the object was beside the torque constants: errors stay as they are in kilograms, or grow with the load. That bound is taken.

    Args:
        robot: As its file states it.
        calibration: Of the arm, with what known loads have shown of its torque.
        fit: Of the weighing.
    """
    mass = float(fit.values[0])
    constants = fit.parts.get(CONSTANTS, 0.0)
    beside = math.sqrt(max(float(fit.std[0]) ** 2 - constants**2, 0.0))
    if mass <= 0.0 or constants < beside:
        return ()
    known = [float(run["load_kg"]) for run in calibration.runs]
    heaviest = max(known, default=0.0)
    load = _handy(mass)
    if heaviest >= mass:
        return ()
    stated = calibration.torque_scale_std
    if heaviest > 0.0:
        stated = max(relative_torque_std(robot, joint) for joint in calibration.joints)
    read = beside / mass
    scale = max(read * stated / math.hypot(read, stated), LEAST_TORQUE_STD)
    half = fit.quantile * float(np.hypot(beside, scale * mass))
    if half > WORTH * fit.half_width:
        return ()
    instead = f" instead of {shown('kg', heaviest, spec='.0f')}" if heaviest > 0.0 else ""
    then = f"{shown('kg', half, spec='.0f')} ({100.0 * half / mass:.0f} %)"
    return (
        f"what would narrow it most: a recording with a known load of about {shown('kg', load, spec='.0f')}{instead}, moved "
        f"alike (`proprio calibrate EMPTY --reference BAG=KG`): then about +-{then} instead of "
        f"+-{shown('kg', fit.half_width, spec='.0f')}",
    )


def _handy(mass_kg: float) -> float:
    """A load of one digit that is no lighter [kg]."""
    digit = 10.0 ** math.floor(math.log10(mass_kg))
    return digit * math.ceil(round(mass_kg / digit, 6))
