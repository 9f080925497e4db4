"""What only a block's answer has."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from proprio_ros.identification.estimate import picked


@dataclass(frozen=True)
class BlockShape:
    """A block at one instant of a squeeze, by finite elements.

    Attributes:
        time_s: after the current came on.
        squeeze: relative to the length, below 0 while it is not touched.
        points: x along the squeeze, in lengths of the block from its middle, shape (N, 3).
        triangles: of its surface, seen from outside, shape (F, 3).
    """

    time_s: float
    squeeze: float
    points: np.ndarray
    triangles: np.ndarray


@dataclass(frozen=True)
class SqueezeCurve:
    """What a block did in one closing of the gripper, as simulated at the estimate.

    Attributes:
        run: name of the run.
        length: of the block along the squeeze [m].
        times_s: shape (K,).
        squeeze: relative to the length, below 0 while it is not touched, shape (K,).
        force_N: on each finger, by the law of elasticity alone, shape (K,).
        shapes: of the block from the first sample to the largest squeeze, where they are to be shown.
    """

    run: str
    length: float
    times_s: np.ndarray
    squeeze: np.ndarray
    force_N: np.ndarray
    shapes: tuple[BlockShape, ...] = ()


@dataclass(frozen=True)
class JointInterval:
    """Two values that are known better together than each alone.

    Attributes:
        names: Of the two values.
        unit: Of both.
        value: Shape (2,).
        covariance: Shape (2, 2).
        outline: Of the region that holds both with 95 %, shape (M, 2); no ellipse where the values are no linear functions of what
            was fitted.
        determined: Whether both values are the recording's rather than the prior's.
    """

    names: tuple[str, str]
    unit: str
    value: np.ndarray
    covariance: np.ndarray
    outline: np.ndarray
    determined: bool

    def as_json(self) -> dict[str, Any]:
        return {**picked(self, "names", "unit", "value", "covariance"), "outline95": self.outline}


@dataclass(frozen=True)
class SoftnessDetail:
    """What the block did in each closing, and both of its moduli together.

    Attributes:
        curves: one for each closing on the block.
        joint: of the Lamé parameters; None where none is determined.
    """

    curves: tuple[SqueezeCurve, ...]
    joint: JointInterval | None = None

    def as_json(self) -> dict[str, Any]:
        """The joint interval, where both values are the recording's."""
        return {} if self.joint is None or not self.joint.determined else {"joint_interval": self.joint}
