"""Goals of a servo that lifts and lowers: three sines of one amplitude."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Sines:
    """Goals that begin at 0.

    Attributes:
        amplitude: Of each [rad].
        phases: Of each [rad], shape (3,).
        speeds: Of each [rad/s], shape (3,).
    """

    amplitude: float
    phases: np.ndarray
    speeds: np.ndarray

    @classmethod
    def drawn(cls, random: np.random.Generator, amplitude: float) -> Sines:
        """Of an amplitude [rad], with phases and speeds at random."""
        return cls(amplitude, random.uniform(0.0, 2.0 * np.pi, 3), random.uniform(1.0, 5.0, 3))

    def at(self, t: float) -> float:
        """The goal after so many seconds [rad]."""
        moved = np.sin(self.speeds * t + self.phases) - np.sin(self.phases)
        return float(np.sum(self.amplitude * moved))
