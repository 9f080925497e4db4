"""What a calibration is still worth some time after it was made: its numbers stay, what is known of them widens.

Friction and torque constants wander with wear, grease and warmth. The robot file states by how much (`AgeingRates`); the covariance
of a calibration grows by that, so that yesterday's numbers are today's prior:

- Dry, viscous and load-dependent friction of every joint, each on its own: a part of its value, as a random walk (variance in
  proportion to the hours, so that it does not matter how often somebody looks), and by the warmth of the motor where it is known.
- Torque constants likewise; half of their variance is common to all joints (one room, one kind of magnet), half each one's own.

What does not age is left alone: masses, encoders, delays.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import numpy as np

from proprio_ros.calibration_files.pushes import Calibration, Moment
from proprio_ros.inputs.forms import Number
from proprio_ros.records import FloatArray

FRICTION = ("coulomb", "viscous", "load_friction")
WALL_S = 1e9
"""A stamp before this, in 2001, is none of a clock on the wall: simulations begin at zero, and nobody knows how old they are."""
ONE_SESSION_H = 1.0 / 6.0
"""What lies no further apart is one session: run-to-run torque, which the calibration has learnt, holds what changes in it."""
READ_TO_K = 1.0  # motors say whole degrees: a difference up to this is none
WORTH_SAYING = 0.03  # friction known worse by this part of itself is said


@dataclass(frozen=True)
class AgeingRates:
    """Standard deviations of what changes after a calibration, relative."""

    # friction_per_sqrt_h, torque_constant_per_sqrt_h: after an hour; after n hours sqrt(n) times as much
    friction_per_sqrt_h: float = 0.01
    # friction_per_K, torque_constant_per_K: beside that, by each degree between the motor's temperature then and now
    friction_per_K: float = 0.01
    torque_constant_per_sqrt_h: float = 0.0005
    torque_constant_per_K: float = 0.001

    def of(self, name: str, hours: float, warmer_K: float) -> float:
        """Standard deviation of a term by now, relative [1].

        Args:
            name: ``friction`` or ``torque_constant``.
            hours: Since the calibration [h].
            warmer_K: Than then [K].
        """
        by_time = getattr(self, f"{name}_per_sqrt_h") * math.sqrt(hours)
        return float(
            np.hypot(by_time, getattr(self, f"{name}_per_K") * max(abs(warmer_K) - READ_TO_K, 0.0))
        )

    def described(self) -> str:
        """As a file states it."""
        return (
            "`{"
            + ", ".join(f"{field.name}: {getattr(self, field.name):g}" for field in fields(self))
            + "}`"
        )


FORMS: Mapping[str, Number] = {
    field.name: Number("relative", "", 0.0, 1.0) for field in fields(AgeingRates)
}


def hours_between(one: Moment, other: Moment) -> float | None:
    """Hours from one to the other, whichever came first; None where a stamp is of no clock on the wall."""
    if min(one.time_s, other.time_s) < WALL_S:
        return None
    return abs(other.time_s - one.time_s) / 3600.0


def warmer_K(one: Moment, other: Moment) -> dict[str, float]:
    """By joint, where both know the motor's temperature."""
    return {
        joint: t - one.temperature_C[joint]
        for joint, t in other.temperature_C.items()
        if joint in one.temperature_C
    }


def aged(calibration: Calibration, drift: AgeingRates, now: Moment | None) -> Calibration:
    """The same as a prior of another moment, when it is used; unchanged where either moment is not known.

    Args:
        calibration: As it was made.
        drift: How fast it ages.
        now: When it is used.
    """
    then = calibration.made
    if then is None or now is None or (hours := hours_between(then, now)) is None:
        return calibration
    warmer = warmer_K(then, now)
    if hours <= ONE_SESSION_H and max(map(abs, warmer.values()), default=0.0) <= READ_TO_K:
        return calibration
    grown = calibration.covariance + _growth(calibration, drift, hours, warmer)
    return replace(calibration, covariance=grown, made=now)


def _growth(
    calibration: Calibration, drift: AgeingRates, hours: float, warmer: Mapping[str, float]
) -> FloatArray:
    """By what a covariance grows, shape (C, C)."""
    own = np.zeros(len(calibration.keys))
    common = np.zeros((len(calibration.keys), 2))
    for row, key in enumerate(calibration.keys):
        value = calibration.values[row]
        degrees = warmer.get(str(key[1]), 0.0)
        if key[0] in FRICTION:
            own[row] = (value * drift.of("friction", hours, degrees)) ** 2
        elif key[0] == "torque_constant":
            own[row] = 0.5 * (value * drift.of("torque_constant", hours, degrees)) ** 2
            by_time = drift.of("torque_constant", hours, 0.0)
            by_warmth = math.copysign(drift.of("torque_constant", 0.0, degrees), degrees)
            half = value * np.sqrt(0.5)
            common[row] = (half * by_time, half * by_warmth)
    return np.diag(own) + common @ common.T


def ageing_note(calibration: Calibration, drift: AgeingRates, now: Moment | None) -> str:
    """What ageing does, in a sentence; empty where it is not worth one.

    Args:
        calibration: As it was made.
        drift: How fast it ages.
        now: When it is used.
    """
    then = calibration.made
    if then is None or now is None or (hours := hours_between(then, now)) is None:
        return ""
    warmer = warmer_K(then, now)
    degrees = max(warmer.values(), key=abs, default=0.0)
    friction = drift.of("friction", hours, degrees)
    torque = drift.of("torque_constant", hours, degrees)
    if friction < WORTH_SAYING:
        return ""
    warmth = f" and a motor {abs(degrees):.0f} K {'warmer' if degrees > 0.0 else 'colder'}"
    warmth = warmth if abs(degrees) > READ_TO_K else ""
    return (
        f"{_age(hours)}{warmth} lie between the calibration and this recording: friction counts as uncertain by "
        f"{100 * friction:.0f} % and torque constants by {100 * torque:.1f} % beside what it knew; some empty-hand runs bring it "
        "up to date (`proprio calibrate --refresh`, ~/refresh_robot)"
    )


def _age(hours: float) -> str:
    if hours >= 48.0:
        return f"{hours / 24.0:.0f} days"
    return f"{hours:.0f} h" if hours >= 1.0 else f"{60 * hours:.0f} min"
