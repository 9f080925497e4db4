"""What only the answer about a container's contents has."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

KINDS_INSIDE = ("nothing", "rigid", *(MOVING := ("liquid", "granular")))


@dataclass(frozen=True)
class ContentsDetail:
    """What is inside, where that is sure (else empty), how probable each kind is, and what moved."""

    kind: str
    probabilities: Mapping[str, float]
    # of each run its name, times [s] and place from the axis [m]
    moved: tuple[tuple[str, np.ndarray, np.ndarray], ...]

    def as_json(self) -> dict[str, Any]:
        """The kind; the probabilities are values."""
        return {"kind": self.kind or None}
