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
    """What the driver needs to know of a joint's motor.

    Attributes:
        model: Name of the model, empty when it is not driven by this package.
        id: Its number on the bus; None when it is not on one.
        current_limit_A: Largest current that may be commanded [A].
    """

    model: str
    id: int | None
    current_limit_A: float


@dataclass(frozen=True)
class FingerTravel:
    """How far one finger is open at some angles of its motor, as measured: linkages do not open evenly.

    Attributes:
        at_rad: Of the motor's output shaft, rising, length 2 or more.
        open_m: Of one finger, from anywhere [m], rising with the angle.
    """

    at_rad: tuple[float, ...]
    open_m: tuple[float, ...]

    @functools.cached_property
    def coefficients(self) -> tuple[float, float, float]:
        """Travel of the finger by the first three powers of the angle [m/rad, m/rad^2, m/rad^3], by least squares.

        Two measurements give a line, three or four a parabola, more a cubic.
        """
        degree = {2: 1, 3: 2, 4: 2}.get(len(self.at_rad), 3)
        fitted = np.polynomial.Polynomial.fit(self.at_rad, self.open_m, degree).convert().coef
        slopes = [*map(float, fitted[1:]), 0.0, 0.0]
        return slopes[0], slopes[1], slopes[2]

    @property
    def mean_ratio(self) -> float:
        """From the first angle to the last [m/rad]."""
        return (self.open_m[-1] - self.open_m[0]) / (self.at_rad[-1] - self.at_rad[0])

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

    Attributes:
        torque_constant: [N m/A].
        coulomb: Dry friction [N m].
        viscous: [N m s/rad].
        load_friction: Part of the motor's torque that the gears lose.
        armature: Inertia of rotor and gears [kg m^2].
        zero: True position minus reading [rad].
        nominal_torque_constant: What published efforts were made with [N m/A].
        supply_voltage_V: 0 when the supply does not limit the current.
        back_emf_V_s_per_rad: Voltage that the motor makes per speed.
        resistance_ohm: Of the winding.
        usable_velocity: Faster samples are left out [rad/s].
        encoder_resolution: One count [rad].
        encoder_noise: Standard deviation of a reading, beyond rounding [rad].
        transmission: Joint position per shaft position: 1 when the motor sits in the joint, m/rad for a finger (each of
            two fingers moves this far).
        encoder_once_per_turn: Standard deviation of the sine and of the cosine part of the encoder's once-per-turn
            error, which a magnet off the axis makes [rad].
        stribeck: By how much of itself dry friction is greater at rest.
        stribeck_velocity: Speed at which 1/e of that is left [rad/s].
        finger_travel: What was measured of a finger's travel, for squeezes alone: published positions count with `transmission`.
        driven_by: What drives the motor where no current does; None: a current.
    """

    torque_constant: Quantity
    coulomb: Quantity
    viscous: Quantity
    load_friction: Quantity
    armature: Quantity
    zero: Quantity
    nominal_torque_constant: float
    supply_voltage_V: float
    back_emf_V_s_per_rad: float
    resistance_ohm: float
    usable_velocity: float
    encoder_resolution: float
    encoder_noise: float
    transmission: float = 1.0
    encoder_once_per_turn: float = 0.0
    stribeck: Quantity = field(default_factory=lambda: Quantity(0.0))
    stribeck_velocity: Quantity = field(default_factory=lambda: Quantity(0.1))
    finger_travel: FingerTravel | None = None
    driven_by: Drive | None = None

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
        return (self.transmission, 0.0, 0.0) if self.finger_travel is None else self.finger_travel.coefficients

    @property
    def nominal_effort_per_current(self) -> float:
        """What published efforts are over the motor's current, at the joint: N m per A, N per A where it pushes a slide."""
        return self.nominal_torque_constant / self.transmission
