"""What motions of an arm with an empty hand say about it: bodies, rotors, gears and friction, with their covariance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

BODY_TERMS: Mapping[str, str] = {
    "body_mass": "kg",
    **{f"body_moment_{axis}": "kg m" for axis in "xyz"},
    **{f"body_inertia_{axes}": "kg m^2" for axes in ("xx", "xy", "xz", "yy", "yz", "zz")},
}
"""Parameters of the body behind a joint, about the joint's frame, and their units; everything up to the next joint is one body."""
DRIVE_TERMS: Mapping[str, str] = {"armature": "kg m^2", "load_friction": "1"}
"""Of rotor and gears, the same in every run."""
FRICTION_TERMS: Mapping[str, str] = {"viscous": "N m s/rad", "coulomb": "N m", "offset": "N m"}
"""What differs from run to run."""
UNITS: Mapping[str, str] = {**BODY_TERMS, **DRIVE_TERMS, **FRICTION_TERMS}
Key = tuple[str, str]
"""Kind of a term, and its joint."""


def term_keys(joints: tuple[str, ...]) -> tuple[Key, ...]:
    """All terms of an arm in the order of a calibration's arrays: bodies joint by joint, then every other kind joint by joint."""
    bodies = [(kind, joint) for joint in joints for kind in BODY_TERMS]
    return (*bodies, *((kind, joint) for kind in (*DRIVE_TERMS, *FRICTION_TERMS) for joint in joints))


@dataclass(frozen=True, eq=False)
class MotionCalibration:
    """An arm as motions with an empty hand show it, in torques as the robot file's torque constants make them of currents.

    n joints have P = 15 n terms, see `term_keys`.

    Attributes:
        joints: Parents before children, length n.
        values: Friction is the mean of the runs; shape (P,).
        covariance: As a prior of the next fit, correlated residuals and the robot file's own priors counted; shape (P, P).
        deviations: How the values move when one stretch is left out, so scaled that the sum of the rows' outer products is the
            covariance of the jackknife; shape (stretches, P).
        friction_spread: Standard deviation of viscous friction, Coulomb friction and offset from run to run, in the order of
            `FRICTION_TERMS` and then of the joints; shape (3 n,).
        residual: rms of the mean torque in a window that is left over [N m], shape (n,).
        correlation: Over how many windows the residuals of a joint are correlated: so much less they say; shape (n,).
        torque_scale: True torque over that of the robot file's constants; 1 where no reference was held.
        torque_scale_std: How well that is known, relative.
        arm_over_urdf: By how much the torques of the arm's own bodies are those that its URDF says.
        fingerprint: Of the URDF.
        runs: One mapping per run: name, duration_s, load_kg.
    """

    joints: tuple[str, ...]
    values: FloatArray
    covariance: FloatArray
    deviations: FloatArray
    friction_spread: FloatArray
    residual: FloatArray
    correlation: FloatArray
    torque_scale: float
    torque_scale_std: float
    arm_over_urdf: float
    fingerprint: str
    runs: tuple[Mapping[str, Any], ...]

    @property
    def keys(self) -> tuple[Key, ...]:
        """Kind and joint of every term, length P."""
        return term_keys(self.joints)

    @property
    def stretches(self) -> int:
        """That were left out in turn."""
        return len(self.deviations)

    @property
    def std(self) -> FloatArray:
        """Of every value, shape (P,): the larger of what the fit and what the jackknife says."""
        return np.sqrt(np.maximum(np.diag(self.covariance), (self.deviations**2).sum(axis=0)))

    @property
    def friction(self) -> slice:
        """Where viscous friction, Coulomb friction and offset stand."""
        return slice(12 * len(self.joints), 15 * len(self.joints))
