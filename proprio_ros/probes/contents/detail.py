"""What only the answer about a container's contents has."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class MovedPart:
    """Where the moving part of the contents is believed to have been during a run, from the container's axis [m]."""

    run: str
    times_s: np.ndarray  # shape (K,)
    x: np.ndarray  # shape (K,)


@dataclass(frozen=True)
class ContentsDetail:
    """What is inside, where that is sure (else empty), how probable each kind is, and how the moving part went."""

    kind: str
    probabilities: Mapping[str, float]
    moved: tuple[MovedPart, ...]

    def as_json(self) -> dict[str, Any]:
        """The kind; the probabilities are values."""
        return {"kind": self.kind or None}
