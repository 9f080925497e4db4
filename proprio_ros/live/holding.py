"""Is something in the hand? Asked of each estimate of what it holds. No ROS here."""

from __future__ import annotations

import math

TAKEN, LEFT = 0.99, 0.01
"""Something is held from this probability on, and until it falls to the other: in between stays what was said last. At 0.95 an
empty hand would seem to hold something several times an hour, where the lightest object is barely told."""


def probability_of_load(mass_kg: float, std_kg: float, least_kg: float) -> float:
    """How likely the hand holds something, by an estimate of the mass in it.

    Before it, an empty hand and an object of ``least_kg`` or more count as equally likely (Bayes; of the objects the one that
    fits best speaks). So an estimate that is too coarse to tell ``least_kg`` from nothing leaves it near a half.
    """
    if not (math.isfinite(mass_kg) and 0.0 < std_kg < math.inf):
        return 0.5
    object_kg = max(mass_kg, least_kg)
    # log of the ratio
    empty = 0.5 * (mass_kg / std_kg) ** 2 - 0.5 * ((mass_kg - object_kg) / std_kg) ** 2
    return 1.0 / (1.0 + math.exp(-empty)) if empty > -700.0 else 0.0


class Holding:
    """Whether something is in the hand, with hysteresis.

    ``least_kg``: mass of the lightest object that counts.

    Attributes:
        state: None while nothing is known.
        probability: By the newest estimate; NaN while nothing is known.
        since_ns: Stamp of the first estimate that said so.
    """

    def __init__(self, least_kg: float) -> None:
        self._least_kg = least_kg
        self.forget()

    def forget(self) -> None:
        """The hand may hold something else by now."""
        self.state: bool | None = None
        self.probability, self.since_ns = math.nan, 0

    def hear(self, time_ns: int, mass_kg: float, std_kg: float) -> None:
        """An estimate, and when it was."""
        self.probability = probability_of_load(mass_kg, std_kg, self._least_kg)
        told = (
            True if self.probability >= TAKEN else False if self.probability <= LEFT else self.state
        )
        if told is not self.state:
            self.state, self.since_ns = told, time_ns

    def entries(self, time_ns: int) -> dict[str, object]:
        """Keys and values of a diagnostics message."""
        known = {} if self.state is None else {"holding_for": 1e-9 * (time_ns - self.since_ns)}
        return {
            "holding": "unknown" if self.state is None else self.state,
            "holding.probability": self.probability,
            **known,
        }
