"""What only a container's answer has."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class SpherePath:
    """Where the sphere is believed to have been during a run."""

    run: str
    # shape, inner_size, radius: of the inside, along the axes of the container, shape (3,), and of the sphere [m]
    shape: str
    inner_size: np.ndarray
    radius: float
    times_s: np.ndarray  # shape (K,)
    # position, std: of the sphere's centre in the container's frame [m], shape (K, 3)
    position: np.ndarray
    std: np.ndarray
    world_from_container: np.ndarray  # shape (K, 3, 3)
    across: np.ndarray  # the joint's axis in the container's frame; one looks along it, shape (3,)

    @property
    def moved(self) -> float:
        """Farthest from where it started [m]."""
        away = self.position - self.position[0]
        return float(np.linalg.norm(away, axis=1).max())


@dataclass(frozen=True)
class ContainerDetail:
    """Where the sphere was, in each run that has one."""

    paths: tuple[SpherePath, ...]

    def as_json(self) -> dict[str, Any]:
        """Nothing: paths are for pictures."""
        return {}
