"""How fast the time axis of a recording runs, by velocities that were recorded beside the positions.

A driver that measures velocities knows nothing of the stamps that a recorder makes later. Where the derivative of the positions is
the same multiple of the velocities in all joints, the joints did not all change their unit: the time axis is stretched.

A register of velocities lags, and most are filtered. A velocity ``w`` that a filter of first order with time constant ``a`` made
of the true one obeys ``w + a dw/dt = v``. Integrated over a window that gives, exactly,

    position = constant + scale (integral of w + a w)

so scale and lag are two slopes of a linear fit, and a lag does not look like a scale. Noise is averaged.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from proprio_ros.recordings.motions import LONGEST_GAP_S, MOVED_RAD
from proprio_ros.records import FloatArray, JointRecord, Recording

WINDOW_S = 2.0
"""Over which velocities are integrated: longer than most of a swing there and back, shorter than what an offset adds up to."""
FEWEST_WINDOWS = 3
FEWEST_SAMPLES = 10  # of a window
UNEXPLAINED = 0.2
"""Share of a joint's movement that its velocities may leave open; real registers leave 0.03, those of other joints nearly all."""
REGISTER_STD = 0.01
"""How far the scale of a velocity register may be off: 1.003 to 1.030 on a real OpenManipulator-X, 0.998 to 1.001 on other arms."""
ALIKE = 0.05
"""By so much the scales of an arm's joints may differ before it is no common time axis that made them."""
NOMINAL_NS = 10_000_000  # between samples of which nobody knows when they were taken
TIME_SCALES = (0.4, 2.5)
"""Loops run at half their rate, or twice. What is further off is a unit: degrees/s are 57 times rad/s, rpm 9.5 times."""
SAME_DIFFERENCE = 1e-4
"""Velocities that agree with plain differences of positions to this share were made of them, with a period that was assumed."""


@dataclass(frozen=True)
class Pace:
    """How the time axis of a recording is stretched."""

    scale: float  # true seconds per second of the recording; 1 where both are the same
    std: float  # its standard deviation, that of the registers included

    @property
    def is_off(self) -> bool:
        """Whether the axis is stretched for sure."""
        return abs(self.scale - 1.0) > max(ALIKE, 4.0 * self.std)

    @property
    def sentence(self) -> str:
        """What it means, for people."""
        return (
            f"positions of all joints change {self.scale:.2f} times as fast as their velocities say: a second of the stamps was "
            f"{self.scale:.2f} s, as where a loop runs slower or faster than it stamps"
        )


@dataclass(frozen=True)
class VelocityScale:
    """How many times as large the derivative of one joint's positions is as its velocities."""

    scale: float
    std: float  # by how windows differ
    lag_s: float  # of the velocity behind the position [s]


def pace_by_velocities(recording: Recording) -> Pace | None:
    """How the time axis is stretched, where velocities show it.

    Args:
        recording: With velocities of joints that move [rad/s], positions in rad.

    Returns: The scale of the time axis; None where no velocities were recorded, those of one joint alone differ (it may be their
        unit), those of several do not agree, or they were made of the positions.
    """
    found = velocity_scales(recording)
    if not found:
        return None
    scales = np.array([each.scale for each in found.values()])
    stds = np.array([each.std for each in found.values()])
    middle = float(np.median(scales))
    if np.any(np.abs(scales / middle - 1.0) > ALIKE + 4.0 * stds / middle):
        return None
    if not TIME_SCALES[0] < middle < TIME_SCALES[1]:
        return None
    scatter = float(np.std(scales)) if len(scales) > 1 else ALIKE * middle
    register = REGISTER_STD * middle
    pace = Pace(middle, float(np.sqrt(np.median(stds) ** 2 + scatter**2 + register**2)))
    return None if pace.is_off and len(found) < 2 else pace


def velocity_scales(recording: Recording) -> Mapping[str, VelocityScale]:
    """The same of each joint that moves and whose velocities follow its positions, by joint; empty where too few do."""
    record = recording.joints
    if record.velocity is None:
        return {}
    times_s = 1e-9 * (record.times_ns - record.times_ns[0]).astype(np.float64)
    found = {}
    asked = 0
    for name, position, velocity in zip(
        record.names, record.position.T, record.velocity.T, strict=True
    ):
        known = np.isfinite(velocity)
        if np.ptp(position) <= MOVED_RAD or len(np.unique(velocity[known])) < 2:
            continue
        if _made_of_differences(position[known], velocity[known]):
            continue
        asked += 1
        angle = np.unwrap(position[known])
        scale = _velocity_scale(times_s[known], angle, velocity[known])
        if scale is not None:
            found[name] = scale
    # velocities that mostly follow nothing say nothing of time where by chance they do
    return found if 2 * len(found) > asked else {}


def rate_by_velocities(position: FloatArray, velocity: FloatArray) -> float | None:
    """How many samples a second had, by velocities of several joints, whatever stamps say.

    Args:
        position: Of the joints [rad], shape (T, J).
        velocity: At the same samples [rad/s], shape (T, J); NaN or infinite where there is none.

    Returns: The rate [1/s]; None where velocities do not say it.
    """
    names = tuple(str(number) for number in range(position.shape[1]))
    nominal_ns = np.arange(len(position), dtype=np.int64) * NOMINAL_NS
    known = np.where(np.isfinite(velocity), velocity, np.nan)
    record = JointRecord(nominal_ns, names, position, known)
    found = velocity_scales(Recording("samples", record, None))
    scales = np.array([each.scale for each in found.values()])
    if len(scales) < 2 or np.ptp(scales) > 2.0 * ALIKE * np.median(scales):
        return None
    return float(1e9 / (NOMINAL_NS * np.median(scales)))


def _made_of_differences(position: FloatArray, velocity: FloatArray) -> bool:
    """Whether a driver divided differences of positions by the same period each time; both of shape (T,)."""
    steps = np.diff(position)
    for reported in (velocity[1:], velocity[:-1]):
        squares = float(reported @ reported)
        period = float(steps @ reported) / squares if squares > 0.0 else 0.0
        residual = np.abs(steps - period * reported)
        if np.median(residual) < SAME_DIFFERENCE * np.median(np.abs(steps)):
            return True
    return False


def _velocity_scale(
    times_s: FloatArray, position: FloatArray, velocity: FloatArray
) -> VelocityScale | None:
    """Of one joint, by windows; all of shape (T,); None where velocities leave too much open."""
    means = 0.5 * (velocity[1:] + velocity[:-1])
    integral = np.concatenate([[0.0], np.cumsum(means * np.diff(times_s))])
    regressors = np.column_stack([integral, velocity])
    number = np.floor(times_s / WINDOW_S).astype(np.int64)
    products = []
    projections = []
    windows = []
    for window in np.unique(number):
        inside = number == window
        gaps_s = np.diff(times_s[inside])
        if inside.sum() < FEWEST_SAMPLES or gaps_s.max() > LONGEST_GAP_S:
            continue
        design = regressors[inside] - regressors[inside].mean(axis=0)
        travelled = position[inside] - position[inside].mean()
        products.append(design.T @ design)
        projections.append(design.T @ travelled)
        windows.append((design, travelled))
    if len(windows) < FEWEST_WINDOWS:
        return None
    product = np.sum(products, axis=0)
    if np.linalg.cond(product) > 1e12:
        return None
    inverse = np.linalg.inv(product)
    slopes = inverse @ np.sum(projections, axis=0)
    squares = 0.0
    whole = 0.0
    scores = np.zeros((len(windows), 2))
    for row, (design, travelled) in enumerate(windows):
        residual = travelled - design @ slopes
        scores[row] = design.T @ residual
        squares += float(residual @ residual)
        whole += float(travelled @ travelled)
    if slopes[0] <= 0.0 or squares > UNEXPLAINED**2 * whole:
        return None
    # what windows leave open differs from one to the next, whatever the samples within do
    freedom = len(windows) / (len(windows) - 2)
    covariance = freedom * inverse @ scores.T @ scores @ inverse
    return VelocityScale(
        float(slopes[0]), float(np.sqrt(covariance[0, 0])), float(slopes[1] / slopes[0])
    )
