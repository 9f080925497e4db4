"""What only the answer about a container's contents has."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from proprio_ros.kinds import Kind, add_kinds

MOVING = ("liquid", "granular")
KINDS_INSIDE = ("nothing", "rigid", *MOVING)


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


UNKNOWNS: Mapping[str, Kind] = {
    "contents_mass": Kind("kg", "mass of the contents"),
    "total_mass": Kind("kg", "container with contents"),
    "contents_com_x": Kind("m", "centre of the contents, x"),
    "contents_com_y": Kind("m", "centre of the contents, y"),
    "contents_com_z": Kind("m", "centre of the contents, z"),
    "contents_density": Kind("kg/m^3", "density of the contents"),
    "contents_spread": Kind("1", "inertia of the contents over that of a solid cylinder"),
    "slosh_tuning": Kind("1", "slosh frequency over that of the theory"),
    "slosh_share": Kind("1", "moving share over that of the theory"),
    "slosh_damping_log": Kind("1", "logarithm of the slosh's damping ratio"),
    "grain_friction": Kind("1", "friction between grains"),
    "nothing_inside": Kind("1", "probability of nothing"),
    "rigid_inside": Kind("1", "probability of one rigid thing"),
    "liquid_inside": Kind("1", "probability of a liquid"),
    "granular_inside": Kind("1", "probability of grains"),
    "fill": Kind("m", "fill height"),
    "slosh_frequency": Kind("Hz", "slosh frequency"),
    "slosh_damping": Kind("1", "damping ratio of the slosh"),
    "viscosity": Kind("Pa s", "viscosity"),
}
"""What can be unknown about contents, and what is said of them; whoever imports anything of the probe can name it."""
add_kinds(UNKNOWNS)
