"""The unknowns of a fit: physical value, prior, bounds, and the coordinate in which the solver moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from proprio_ros.errors import ConfigurationError
from proprio_ros.kinds import KINDS, Key, Tag


class Role(Enum):
    """What a fit does with an unknown."""

    ESTIMATED = "free"  # moved by the solver, pulled by its prior
    FIXED = "frozen"  # kept at its value


@dataclass(frozen=True)
class Unknown(Tag):
    """One scalar unknown; what it is, and whose, says ``Tag``."""

    value: float  # prior mean, and the value used while the unknown is fixed
    std: float  # of the prior; `inf` is no prior, 0 is known exactly
    lower: float = -np.inf  # bounds on the physical value
    upper: float = np.inf
    # 0 keeps the coordinate linear; otherwise the solver moves ``asinh(value / scale)``, which is a logarithm for large
    # values and linear through zero, so that orders of magnitude are crossed and an empty hand reads 0
    asinh_scale: float = 0.0
    role: Role = Role.ESTIMATED

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ConfigurationError(f"{self.name}: no such kind of unknown; add it to KINDS")
        sound = np.isfinite(self.value) and self.std >= 0.0
        if not sound:
            given = f"value {self.value} and std {self.std}"
            raise ConfigurationError(f"{self.name}: {given} must be finite and std not negative")
        if not self.lower <= self.value <= self.upper:
            bounds = f"[{self.lower}, {self.upper}]"
            raise ConfigurationError(
                f"{self.name} = {self.value} {self.unit} lies outside {bounds}"
            )

    def at_role(self, role: Role) -> Unknown:
        """A copy with another role; what is known exactly stays fixed."""
        return replace(self, role=Role.FIXED if self.std == 0.0 else role)


def scaled_inverse(matrix: np.ndarray) -> np.ndarray:
    """Inverse of a covariance or precision matrix, taken at unit diagonal: its units differ by orders of magnitude."""
    scale = 1.0 / np.sqrt(np.diag(matrix))
    scaled = np.linalg.inv(matrix * scale[:, None] * scale)
    inverse: np.ndarray = scaled * scale[:, None] * scale
    return inverse


class Coordinates:
    """Maps between physical values and solver coordinates of a list of unknowns, and holds their joint prior.

    Args:
        unknowns: The estimated unknowns, in solver order.
        correlated: Keys and covariance (physical units) of those whose priors belong together, as a calibration leaves them;
            the others are independent. Keys that are not among the unknowns are marginalised out.
    """

    def __init__(
        self,
        unknowns: Sequence[Unknown],
        correlated: tuple[Sequence[Key], np.ndarray] | None = None,
    ) -> None:
        scales = np.array([u.asinh_scale for u in unknowns])
        self._curved = scales > 0.0
        self._scales = np.where(self._curved, scales, 1.0)
        self.lower = self.internal(np.array([u.lower for u in unknowns]))
        self.upper = self.internal(np.array([u.upper for u in unknowns]))
        self.prior_mean = np.array([u.value for u in unknowns])
        stds = np.array([u.std for u in unknowns])
        with np.errstate(divide="ignore"):
            precisions = np.where(np.isfinite(stds), 1.0 / stds**2, 0.0)
            self.prior_precision = np.diag(precisions)
        if correlated is not None:
            self._correlate([u.key for u in unknowns], *correlated)
        # one step of the solver never leaves the range in which the linearisation means something
        self.step_limit = np.where(
            self._curved,
            1.5,
            np.where(
                np.isfinite(stds),
                5.0 * stds,
                np.inf,
            ),
        )
        # a natural length per coordinate, for solvers that want one (Adam, CMA-ES)
        self.natural = np.where(
            self._curved,
            1.0,
            np.where(np.isfinite(stds), stds, 1.0),
        )

    def _correlate(
        self,
        estimated: Sequence[Key],
        keys: Sequence[Key],
        covariance: np.ndarray,
    ) -> None:
        where = {key: row for row, key in enumerate(keys)}
        own = [row for row, key in enumerate(estimated) if key in where]
        if own:
            given = [where[estimated[row]] for row in own]
            self.prior_precision[np.ix_(own, own)] = scaled_inverse(
                covariance[np.ix_(given, given)]
            )

    def internal(self, physical: np.ndarray) -> np.ndarray:
        """Solver coordinates of physical values, shape (..., F)."""
        return np.where(
            self._curved,
            np.arcsinh(physical / self._scales),
            physical,
        )

    @property
    def scale(self) -> np.ndarray:
        """Of coordinates that are an inverse hyperbolic sine, 0 where they are linear, shape (F,)."""
        return np.where(self._curved, self._scales, 0.0)

    def physical(self, internal: np.ndarray) -> np.ndarray:
        """Physical values of solver coordinates, shape (..., F)."""
        return np.where(
            self._curved,
            self._scales * np.sinh(np.where(self._curved, internal, 0.0)),
            internal,
        )

    def slope(self, internal: np.ndarray) -> np.ndarray:
        """d physical / d internal, shape (..., F)."""
        return np.where(
            self._curved,
            self._scales * np.cosh(np.where(self._curved, internal, 0.0)),
            1.0,
        )
