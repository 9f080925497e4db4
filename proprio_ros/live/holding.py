"""Is something in the hand? Asked of each estimate of what it holds. No ROS here."""

from __future__ import annotations

import math

TAKEN = 0.99
LEFT = 0.01
"""Something is held from the first probability on, until it falls to the second: in between the last state stays. At 0.95 an empty
hand would seem to hold something several times an hour, where the lightest object can barely be told from nothing."""


def probability_of_load(mass_kg: float, std_kg: float, least_kg: float) -> float:
    """How likely the hand holds something, by an estimate of the mass in it.

    Before it, an empty hand and an object of ``least_kg`` or more count as equally likely (Bayes; of the objects the one that
    fits best speaks). So an estimate that is too coarse to tell ``least_kg`` from nothing leaves it near a half.

    Args:
        mass_kg: The estimate [kg].
        std_kg: Its standard deviation [kg].
        least_kg: Mass of the lightest object that counts [kg].

    Returns:
        The probability, 0 to 1.
    """
    if not (math.isfinite(mass_kg) and 0.0 < std_kg < math.inf):
        return 0.5
    object_kg = max(mass_kg, least_kg)
    misfit_of_nothing = 0.5 * (mass_kg / std_kg) ** 2
    misfit_of_object = 0.5 * ((mass_kg - object_kg) / std_kg) ** 2
    log_odds = misfit_of_nothing - misfit_of_object
    if log_odds <= -700.0:  # where exp overflows
        return 0.0
    return 1.0 / (1.0 + math.exp(-log_odds))


class Holding:
    """Whether something is in the hand, with hysteresis.

    Args:
        least_kg: Mass of the lightest object that counts [kg].

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
        self.probability = math.nan
        self.since_ns = 0

    def hear(self, time_ns: int, mass_kg: float, std_kg: float) -> None:
        """Take an estimate.

        Args:
            time_ns: Its stamp [ns].
            mass_kg: What is in the hand [kg].
            std_kg: Its standard deviation [kg].
        """
        self.probability = probability_of_load(mass_kg, std_kg, self._least_kg)
        state = self.state
        if self.probability >= TAKEN:
            state = True
        elif self.probability <= LEFT:
            state = False
        if state is not self.state:
            self.state = state
            self.since_ns = time_ns

    def entries(self, time_ns: int) -> dict[str, object]:
        """Keys and values of a diagnostics message."""
        entries: dict[str, object] = {
            "holding": "unknown" if self.state is None else self.state,
            "holding.probability": self.probability,
        }
        if self.state is not None:
            entries["holding_for"] = 1e-9 * (time_ns - self.since_ns)
        return entries
