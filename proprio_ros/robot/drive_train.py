"""The drive train of a joint: its motor, its gears, its encoder, and what they move."""

from __future__ import annotations

import functools
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from proprio_ros.quantity import Quantity
from proprio_ros.robot.drives import Drive
from proprio_ros.robot.geometry import FloatArray


@dataclass(frozen=True)
class Motor:
    """What the driver needs to know of a joint's motor."""

    model: str  # name of the model, empty when it is not driven by this package
    id: int | None  # its number on the bus; None when it is not on one
    current_limit_A: float  # largest current that may be commanded [A]


@dataclass(frozen=True)
class FingerTravel:
    """How far one finger is open at some angles of its motor, as measured: linkages do not open evenly."""

    at_rad: tuple[float, ...]  # of the motor's output shaft, rising, length 2 or more
    open_m: tuple[float, ...]  # of one finger, from anywhere [m], rising with the angle

    @functools.cached_property
    def coefficients(self) -> tuple[float, float, float]:
        """Travel of the finger by the first three powers of the angle [m/rad, m/rad^2, m/rad^3], by least squares.

        Two measurements give a line, three or four a parabola, more a cubic.
        """
        degree = {2: 1, 3: 2, 4: 2}.get(
            len(self.at_rad),
            3,
        )
        fit = np.polynomial.Polynomial.fit(
            self.at_rad,
            self.open_m,
            degree,
        )
        fitted = fit.convert().coef
        slopes = [*map(float, fitted[1:]), 0.0, 0.0]
        return slopes[0], slopes[1], slopes[2]

    @property
    def mean_ratio(self) -> float:
        """From the first angle to the last [m/rad]."""
        opened_m = self.open_m[-1] - self.open_m[0]
        return opened_m / (self.at_rad[-1] - self.at_rad[0])

    def ratio_at(self, angle_rad: ArrayLike) -> FloatArray:
        """How far the finger moves per rad at some angles [m/rad]."""
        angle = np.asarray(angle_rad, dtype=np.float64)
        first, second, third = self.coefficients
        return first + angle * (2.0 * second + 3.0 * third * angle)


@dataclass(frozen=True)
class DriveTrain:
    """Motor and gears of a joint, all seen at the motor's output shaft.

    The torque that reaches the joint is ``torque_constant x current - armature x acceleration``, less friction against
    the motion: ``(coulomb + load_friction x |torque|) x (1 + stribeck x exp(-(velocity / stribeck_velocity)^2)) + viscous
    x |velocity|``.
    """

    torque_constant: Quantity  # [N m/A]
    coulomb: Quantity  # dry friction [N m]
    viscous: Quantity  # [N m s/rad]
    load_friction: Quantity  # part of the motor's torque that the gears lose
    armature: Quantity  # inertia of rotor and gears [kg m^2]
    zero: Quantity  # true position minus reading [rad]
    nominal_torque_constant: float  # what published efforts were made with [N m/A]
    supply_voltage_V: float  # 0 when the supply does not limit the current
    back_emf_V_s_per_rad: float  # voltage that the motor makes per speed
    resistance_ohm: float  # of the winding
    usable_velocity: float  # faster samples are left out [rad/s]
    encoder_resolution: float  # one count [rad]
    encoder_noise: float  # standard deviation of a reading, beyond rounding [rad]
    # joint position per shaft position: 1 when the motor sits in the joint, m/rad for a finger (each of two fingers moves this far)
    transmission: float = 1.0
    # standard deviation of the sine and of the cosine part of the encoder's once-per-turn error, which a magnet off the
    # axis makes [rad]
    encoder_once_per_turn: float = 0.0
    # by how much of itself dry friction is greater at rest
    stribeck: Quantity = field(default_factory=lambda: Quantity(0.0))
    # speed at which 1/e of that is left [rad/s]
    stribeck_velocity: Quantity = field(default_factory=lambda: Quantity(0.1))
    # what was measured of a finger's travel, for squeezes alone: published positions count with `transmission`
    finger_travel: FingerTravel | None = None
    driven_by: Drive | None = None  # what drives the motor where no current does; None: a current

    @property
    def reading_std(self) -> float:
        """Standard deviation of one reading of the encoder, rounding included [rad]."""
        return float(np.hypot(self.encoder_resolution / np.sqrt(12.0), self.encoder_noise))

    @property
    def electric_damping(self) -> float:
        """Viscous friction that back EMF makes where a voltage drives the motor [N m s/rad]."""
        if self.driven_by is None:
            return 0.0
        return self.torque_constant.value * self.back_emf_V_s_per_rad / self.resistance_ohm

    @property
    def travel_coefficients(self) -> tuple[float, float, float]:
        """What a squeeze takes for the finger's travel, as `FingerTravel.coefficients` are."""
        return (
            (self.transmission, 0.0, 0.0)
            if self.finger_travel is None
            else self.finger_travel.coefficients
        )

    @property
    def nominal_effort_per_current(self) -> float:
        """What published efforts are over the motor's current, at the joint: N m per A, N per A where it pushes a slide."""
        return self.nominal_torque_constant / self.transmission
