"""What a reader of an answer sees of a motion: torque of each joint, explained and left over, and which seconds told the mass."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from proprio_ros.identification.estimate import JointFit
from proprio_ros.records import FloatArray

MOST_POINTS = 240  # Of a curve: a picture of it is no finer.
# A recording is told in so many parts at most, none shorter than a window.
BINS = 60
LEAST_BIN_S = 0.5


@dataclass(frozen=True)
class Explained:
    """Windows of several motions and joints, E of both together."""

    middle_s: FloatArray  # time of each window's middle in its motion [s], shape (E,)
    # motion, joint: numbers of both, shape (E,)
    motion: NDArray[np.int64]
    joint: NDArray[np.int64]
    # measured, left_over, payload: mean torque, what nothing explains of it, and what the payload makes of it [N m], shape (E,)
    measured: FloatArray
    left_over: FloatArray
    payload: FloatArray
    # torque per kilogram at the payload's place, over the standard deviation of what is left over of that joint, (E,)
    by_mass: FloatArray

    def joint_fits(
        self,
        names: Sequence[str],
        joints: Sequence[str],
        usual: FloatArray | Sequence[float],
    ) -> tuple[JointFit, ...]:
        """Each joint of each motion that moved, thinned for a picture.

        Args:
            names: Of the motions; of a motion past their end nothing is shown.
            joints: Names.
            usual: What is left over of each joint's torque where the hand's load is known, rms [N m].
        """
        shown = self.motion < len(names)
        information = np.where(
            shown,
            np.square(self.by_mass),
            0.0,
        )
        whole = max(float(information.sum()), 1e-300)
        fits = []
        for number, name in enumerate(names):
            mine = self.motion == number
            end_s = float(self.middle_s[mine].max(initial=0.0)) + LEAST_BIN_S / 2.0
            bin_s = max(LEAST_BIN_S, end_s / BINS)
            for place, joint in enumerate(joints):
                rows = np.flatnonzero(mine & (self.joint == place))
                if not len(rows):
                    continue
                bins = (self.middle_s[rows] / bin_s).astype(np.int64)
                told = np.bincount(
                    bins, information[rows] / whole, minlength=int(np.ceil(end_s / bin_s))
                )
                few = rows[:: -(-len(rows) // MOST_POINTS)]
                fits.append(
                    JointFit(
                        name,
                        joint,
                        self.middle_s[few],
                        self.measured[few],
                        (self.measured - self.left_over)[few],
                        self.payload[few],
                        float(np.sqrt(np.mean(np.square(self.left_over[rows])))),
                        float(usual[place]),
                        told,
                        bin_s,
                    )
                )
        return tuple(fits)
