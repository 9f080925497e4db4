"""A number and how well it is known."""

from __future__ import annotations

import math
from dataclasses import dataclass

from proprio_ros.errors import RobotError


@dataclass(frozen=True)
class Quantity:
    """A number and how well it is known.

    Attributes:
        value: Best value.
        std: Standard deviation; 0 means known exactly.

    Raises:
        RobotError: A number is not finite, or the standard deviation is negative.
    """

    value: float
    std: float = 0.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.value) and math.isfinite(self.std)):
            raise RobotError(f"value and std must be finite, got {self.value} and {self.std}")
        if self.std < 0.0:
            raise RobotError(f"std must not be negative, got {self.std}")
