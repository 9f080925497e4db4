"""What only a block's answer has."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from proprio_ros.identification.estimate import picked


@dataclass(frozen=True)
class BlockShape:
    """A block at one instant after the current came on, by finite elements."""

    time_s: float
    squeeze: float  # relative to the length, below 0 while it is not touched
    points: np.ndarray  # x along the squeeze, in lengths of the block from its middle, shape (N, 3)
    triangles: np.ndarray  # of its surface, seen from outside, shape (F, 3)


@dataclass(frozen=True)
class SqueezeCurve:
    """What a block did in one closing of the gripper, as simulated at the estimate, at K instants."""

    run: str
    length: float  # of the block along the squeeze [m]
    times_s: np.ndarray
    squeeze: np.ndarray  # relative to the length, below 0 while it is not touched, shape (K,)
    force_N: np.ndarray  # on each finger, by the law of elasticity alone, shape (K,)
    # of the block from the first sample to the largest squeeze, where they are to be shown
    shapes: tuple[BlockShape, ...] = ()


@dataclass(frozen=True)
class JointInterval:
    """Two values of one unit that are known better together than each alone: shape (2,), covariance (2, 2)."""

    names: tuple[str, str]
    unit: str
    value: np.ndarray
    covariance: np.ndarray
    # of the region that holds both with 95 %, shape (M, 2); no ellipse where the values are no linear functions of what was fitted
    outline: np.ndarray
    determined: bool  # whether both values are the recording's rather than the prior's

    def as_json(self) -> dict[str, Any]:
        return {**picked(self, "names", "unit", "value", "covariance"), "outline95": self.outline}


@dataclass(frozen=True)
class SoftnessDetail:
    """What the block did in each closing on it, and both Lamé parameters together; None where none is determined."""

    curves: tuple[SqueezeCurve, ...]
    joint: JointInterval | None = None

    def as_json(self) -> dict[str, Any]:
        """The joint interval, where both values are the recording's."""
        return (
            {}
            if self.joint is None or not self.joint.determined
            else {"joint_interval": self.joint}
        )
