"""Joint torques of a moving arm as a linear function of its inertial parameters, without differentiating a position twice.

The torque at a joint is its screw axis S times the change of momentum of everything behind it, less gravity's wrench on that:
``tau = S . (dh/dt - f)``, all in the base frame. Multiplied by a smooth test function phi that is zero at both ends of a window and
integrated by parts, the derivative goes to what is known exactly:

    int phi tau dt = - int (dphi/dt S + phi dS/dt) . h dt - int phi S . f dt,        dS/dt = V x S

where V is the twist of the joint's link. Momentum h and wrench f are linear in each body's ten parameters (mass, first moments,
inertia about the body's origin), so each window and joint gives one linear equation, from positions and velocities alone.

Sources: test functions for identification, Preisig & Rippin 1993, Theory and Application of the Modulating Function Method,
Computers & Chemical Engineering 17; spatial vectors, Featherstone 2008, Rigid Body Dynamics Algorithms, chapter 2; inertial
parameters of links and loads, Atkeson, An & Hollerbach 1986, International Journal of Robotics Research 5(3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from proprio_ros.errors import RecordingError
from proprio_ros.recordings.motions import LONGEST_GAP_S, Motion
from proprio_ros.records import FloatArray
from proprio_ros.robot import ReducedModel
from proprio_ros.robot.regressor import (
    PARAMETERS,
    carriers,
    cross_product,
    gravity_along,
    kinematics,
    momentum_along,
)

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

TOGETHER = 64  # Windows whose samples are looked at together.


@dataclass(frozen=True)
class Windows:
    """Test functions over windows of equally spaced samples: ``(1 - x^2)^3``, zero with two derivatives at both ends."""

    samples: int  # of the signals, T
    starts: NDArray[np.int64]  # first sample of each window, shape (W,)
    # its values times the sampling period, normalised to a mean over time, shape (K,)
    weight: FloatArray
    slope: FloatArray  # those of its time derivative, shape (K,)

    @classmethod
    def over(
        cls,
        samples: int,
        width: int,
        hop: int,
    ) -> Windows:
        """Windows of ``width`` samples, one every ``hop``; the derivative is that per sample."""
        x = (np.arange(width) + 0.5) * 2.0 / width - 1.0
        weight = (1.0 - x**2) ** 3
        slope = -6.0 * x * (1.0 - x**2) ** 2 * 2.0 / width
        return cls(
            samples,
            np.arange(0, samples - width + 1, hop),
            weight / weight.sum(),
            slope / weight.sum(),
        )

    def only(self, kept: NDArray[np.bool_]) -> tuple[Windows, NDArray[np.bool_]]:
        """Some of them, shape (W,), over the samples that lie in one alone; and which these are, shape (T,)."""
        starts = self.starts[kept]
        used = np.zeros(self.samples, dtype=bool)
        used[starts[:, None] + np.arange(len(self.weight))] = True
        place = np.cumsum(used) - 1
        return replace(self, samples=int(used.sum()), starts=place[starts]), used

    @cached_property
    def parts(self) -> list[Part]:
        """All of them, few at a time: what is made of their samples then stays where a processor is quick to find it."""
        width = len(self.weight)
        parts = []
        for first in range(0, len(self.starts), TOGETHER):
            of_windows = slice(first, first + TOGETHER)
            starts = self.starts[of_windows]
            of_samples = slice(int(starts[0]), int(starts[-1]) + width)
            count = of_samples.stop - of_samples.start
            windows = Windows(count, starts - starts[0], self.weight, self.slope)
            parts.append(Part(of_windows, of_samples, windows))
        return parts

    def mean(self, values: FloatArray) -> FloatArray:
        """Weighted mean of a signal, shape (T, ...), over each window, shape (W, ...)."""
        return self._applied(self._means, values)

    def share(self, holds: NDArray[np.bool_]) -> FloatArray:
        """How much of each window something holds, shape (T, ...) to (W, ...)."""
        return self.mean(holds.astype(np.float64))

    def derivative(self, values: FloatArray, period_s: float) -> FloatArray:
        """Weighted mean of the signal's time derivative over each window, by parts: the signal itself is not differentiated."""
        return -self._applied(self._slopes, values) / period_s

    # building a matrix takes longer than using it
    @cached_property
    def _means(self) -> csr_matrix:
        return self._matrix(self.weight)

    @cached_property
    def _slopes(self) -> csr_matrix:
        return self._matrix(self.slope)

    def _matrix(self, weight: FloatArray) -> csr_matrix:
        from scipy.sparse import csr_matrix

        width = len(weight)
        count = len(self.starts)
        samples = self.starts[:, None] + np.arange(width)
        rows = np.arange(0, width * count + 1, width)
        return csr_matrix(
            (np.tile(weight, count), samples.ravel(), rows), shape=(count, self.samples)
        )

    def _applied(self, matrix: csr_matrix, values: FloatArray) -> FloatArray:
        result: FloatArray = (matrix @ values.reshape(len(values), -1)).reshape(
            len(self.starts), *values.shape[1:]
        )
        return result


@dataclass(frozen=True)
class Part:
    """Some windows that follow each other."""

    of_windows: slice  # which they are
    of_samples: slice  # over which they lie
    windows: Windows  # the same over these samples alone


def torque_regressor(
    model: ReducedModel,
    position: FloatArray,
    velocity: FloatArray,
    windows: Windows,
    period_s: float,
    since: int = 0,
) -> FloatArray:
    """Mean torque at every joint over every window, per unit of every body's parameters.

    Args:
        model: The arm, n joints.
        position: Equally spaced samples [rad or m], shape (T, n).
        velocity: At the same instants [rad/s or m/s], shape (T, n).
        windows: Where to look.
        period_s: Between samples [s].
        since: The first body that is asked for; others have zeros.

    Returns: Shape (W, n, n, 10): window, joint, body, parameter [N m per unit].
    """
    result = np.zeros((len(windows.starts), *2 * position.shape[1:], PARAMETERS))
    for part in windows.parts:
        result[part.of_windows] = _of_part(
            model,
            position[part.of_samples],
            velocity[part.of_samples],
            part.windows,
            period_s,
            since,
        )
    return result


def _of_part(
    model: ReducedModel,
    position: FloatArray,
    velocity: FloatArray,
    windows: Windows,
    period_s: float,
    since: int,
) -> FloatArray:
    """The same of few enough windows, see `torque_regressor`."""
    motion = kinematics(model, position, velocity)
    result = np.zeros((len(windows.starts), *2 * position.shape[1:], PARAMETERS))
    axes = motion.axis
    twists = motion.twist
    moved = cross_product(twists[:3], axes[3:]) + cross_product(twists[3:], axes[:3])
    turning = np.concatenate([cross_product(twists[:3], axes[:3]), moved])
    for body in range(since, position.shape[1]):
        joints = carriers(model, body)
        screws = np.concatenate(
            [
                axes[:, joints],
                turning[:, joints],
                twists[:, body, None],
            ],
            axis=1,
        )
        angular, linear = motion.seen_by(body, screws)
        momentum = momentum_along(
            angular[:, :-1], linear[:, :-1], angular[:, -1:], linear[:, -1:]
        ).T
        rate = windows.derivative(
            momentum[:, : len(joints)],
            period_s,
        )
        turned = momentum[:, len(joints) :] + gravity_along(model, motion, body).T
        result[:, joints, body] = rate - windows.mean(turned)
    return result


def evenly(
    motion: Motion, joints: Sequence[str], bandwidth_Hz: float, currents_too: bool = False
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Equally spaced times, and smoothed positions and currents of some joints.

    Args:
        motion: At whatever instants.
        joints: Of it, or recorded beside them: of those no current is known; n.
        bandwidth_Hz: To which positions are smoothed.
        currents_too: Whether currents are, too.

    Returns: Times [s], positions [rad or m] and currents [A], shapes (T,), (T, n) and (T, n).

    Raises `RecordingError`: There are too few samples.
    """
    from scipy.signal import butter, filtfilt  # half of a second to import

    own = [motion.joints.index(name) if name in motion.joints else None for name in joints]
    period_s = float(np.median(np.diff(motion.times_s)))
    times_s = np.arange(
        motion.times_s[0],
        motion.times_s[-1] + 0.5 * period_s,
        period_s,
    )
    recorded = [
        motion.beside[name] if column is None else motion.position[:, column]
        for name, column in zip(joints, own, strict=True)
    ]
    position = np.column_stack([np.interp(times_s, motion.times_s, each) for each in recorded])
    current = np.zeros_like(position)
    for number, column in enumerate(own):
        if column is None:
            continue
        known = np.isfinite(motion.current_A[:, column])
        if known.any():
            current[:, number] = np.interp(
                times_s, motion.times_s[known], motion.current_A[known, column]
            )
    b, a = butter(
        2,
        min(2.0 * bandwidth_Hz * period_s, 0.9),
    )
    if len(times_s) <= 3 * max(len(a), len(b)):
        raise RecordingError(f"{motion.name}: {len(times_s)} samples are too few for a motion")
    position = filtfilt(b, a, position, axis=0)
    return times_s, position, filtfilt(b, a, current, axis=0) if currents_too else current


def across_gaps(
    motion: Motion, joints: Sequence[str], times_s: FloatArray, windows: Windows
) -> NDArray[np.bool_]:
    """Which windows know nothing of what happened in a gap.

    Args:
        motion: Whose samples or whose measured currents may lie far apart.
        joints: Some of its joints, n.
        times_s: Evenly spaced ones [s], shape (T,).
        windows: Of these, W.

    Returns: For each window and joint, shape (W, n).
    """
    first = times_s[windows.starts]
    last = times_s[windows.starts + len(windows.weight) - 1]
    crossed = np.zeros(
        (len(windows.starts), len(joints)),
        dtype=bool,
    )
    for number, name in enumerate(joints):
        known = np.isfinite(motion.current_A[:, motion.joints.index(name)])
        # what is missing at either end is a gap, too
        known_s = np.concatenate([[-np.inf], motion.times_s[known], [np.inf]])
        long = np.diff(known_s) > LONGEST_GAP_S
        long[0] = motion.times_s[0] < known_s[1] - LONGEST_GAP_S
        long[-1] = -motion.times_s[-1] < -known_s[-2] - LONGEST_GAP_S
        gap = np.flatnonzero(long)
        # gaps that begin before a window's end, less those that are over before it begins
        begun = np.searchsorted(known_s[gap], last, side="left")
        over = np.searchsorted(known_s[gap + 1], first, side="right")
        crossed[:, number] = begun > over
    return crossed
