"""How fast the time axis of a recording runs, by velocities that were recorded beside the positions.

A driver that measures velocities knows nothing of the stamps that a recorder makes later. Where the derivative of the positions is
the same multiple of the velocities in all joints, the joints did not all change their unit: the time axis is stretched.

A register of velocities lags, and most are filtered. A velocity ``w`` that a filter of first order with time constant ``a`` made
of the true one obeys ``w + a dw/dt = v``. Integrated over a window that gives, exactly,

    position = constant + scale (integral of w + a w)

so scale and lag are two slopes of a linear fit, and a lag does not look like a scale. Noise is averaged.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from proprio_ros.errors import RecordingError
from proprio_ros.recordings.motions import LONGEST_GAP_S, MOVED_RAD
from proprio_ros.recordings.repeats import repeated
from proprio_ros.records import FloatArray, JointRecord, Recording, Run

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
REST_S = 0.1  # before a run that is looked at with it
LEAST_STD = 0.002
ALONE_OFF, ALONE_SURE = 0.03, 3.0
"""Where one joint moves alone, the time axis is stretched if its scale is further from 1 than what real registers are off, and so
many standard deviations. Of 706 recorded pushes with counts, noise and lag none is further than 3 of these and 0.005."""
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
    pace = Pace(
        middle,
        float(np.sqrt(np.median(stds) ** 2 + scatter**2 + register**2)),
    )
    return None if pace.is_off and len(found) < 2 else pace


def pace_of_runs(recording: Recording, runs: Sequence[Run]) -> Pace | None:
    """How the time axis is stretched, by the velocity of the one joint that moves in each run.

    Args:
        recording: With velocities [rad/s].
        runs: That were cut out of it.

    Returns: The scale of all runs together; None where no velocities were recorded, they follow no position, or have another unit.
    """
    weights = 0.0
    sum_of = 0.0
    for run in runs:
        scale = _scale_of_run(recording, run)
        if scale is not None and TIME_SCALES[0] < scale.scale < TIME_SCALES[1]:
            weights += scale.std**-2
            sum_of += scale.scale * scale.std**-2
    if weights == 0.0:
        return None
    return Pace(sum_of / weights, weights**-0.5)


def _scale_of_run(recording: Recording, run: Run) -> VelocityScale | None:
    """Of the joint that moves in a run, over its samples and those just before; None where velocities leave too much open."""
    record = recording.joints
    if record.velocity is None:
        return None
    column = record.column(run.joint)
    since_s = 1e-9 * (record.times_ns - run.onset_ns).astype(np.float64)
    inside = (since_s >= -REST_S) & (since_s <= run.duration_s)
    inside &= np.isfinite(record.velocity[:, column])
    inside &= ~repeated(record, inside, [column])
    velocity = record.velocity[inside, column]
    position = np.unwrap(record.position[inside, column])
    if len(velocity) < FEWEST_SAMPLES or np.ptp(position) < MOVED_RAD or not velocity.any():
        return None
    if _made_of_differences(position, velocity):
        return None
    whole = _slopes(since_s[inside], position, velocity)
    coarse = _slopes(
        since_s[inside][::2],
        position[::2],
        velocity[::2],
    )
    if whole is None or coarse is None:
        return None
    # the rule that integrates between samples is off by a third of what it is worse over two of them; nobody's push is smooth
    rule = abs(coarse.scale - whole.scale)
    std = float(np.sqrt(whole.std**2 + rule**2 + LEAST_STD**2))
    return VelocityScale(whole.scale, std, whole.lag_s)


def _integral_and_velocity(times_s: FloatArray, velocity: FloatArray) -> FloatArray:
    """The columns of the fit, shape (T, 2): by the first goes the scale, by the second scale and lag."""
    means = 0.5 * (velocity[1:] + velocity[:-1])
    integral = np.concatenate(
        [
            [0.0],
            np.cumsum(means * np.diff(times_s)),
        ]
    )
    return np.column_stack([integral, velocity])


def _slopes(
    times_s: FloatArray, position: FloatArray, velocity: FloatArray
) -> VelocityScale | None:
    """Scale and lag by all samples, of shape (T,); None where velocities leave too much open."""
    design = _integral_and_velocity(times_s, velocity)
    design -= design.mean(axis=0)
    travelled = position - position.mean()
    product = design.T @ design
    if np.linalg.cond(product) > 1e12:
        return None
    slopes = np.linalg.solve(product, design.T @ travelled)
    residual = travelled - design @ slopes
    squares = float(residual @ residual)
    if slopes[0] <= 0.0 or squares > UNEXPLAINED**2 * float(travelled @ travelled):
        return None
    variance = squares / (len(velocity) - 3) * np.linalg.inv(product)[0, 0]
    return VelocityScale(
        float(slopes[0]),
        float(np.sqrt(variance)),
        float(slopes[1] / slopes[0]),
    )


def refuse_pace_of_runs(recording: Recording, runs: Sequence[Run]) -> None:
    """Raise RecordingError: The joints that runs moved turned at another pace than their velocities say."""
    pace = pace_of_runs(recording, runs)
    if pace is not None:
        _refuse_pace(
            recording,
            pace,
            tuple(dict.fromkeys(run.joint for run in runs)),
        )


def refuse_pace_of_joint(recording: Recording, joint: str) -> None:
    """Raise RecordingError: A joint that moved alone, under whatever controller, did so."""
    found = velocity_scales(recording).get(joint)
    if found is not None and TIME_SCALES[0] < found.scale < TIME_SCALES[1]:
        _refuse_pace(
            recording,
            Pace(found.scale, found.std),
            (joint,),
        )


def _refuse_pace(
    recording: Recording,
    pace: Pace,
    joints: Sequence[str],
) -> None:
    if abs(pace.scale - 1.0) < ALONE_OFF + ALONE_SURE * pace.std:
        return
    raise RecordingError(
        f"positions of {', '.join(joints)} change {pace.scale:.2f} times as fast as the velocities beside them: "
        "the time axis is stretched (a loop that runs slower or faster than it stamps), and a mass goes with its square: "
        "stamp by a clock, and leave velocities out that are of something else",
        recording.name,
    )


def velocity_scales(recording: Recording) -> Mapping[str, VelocityScale]:
    """The same of each joint that moves and whose velocities follow its positions, by joint; empty where too few do."""
    record = recording.joints
    if record.velocity is None:
        return {}
    everywhere = np.ones(len(record.times_ns), dtype=bool)
    record = record.kept(~repeated(record, everywhere, range(len(record.names))))
    assert record.velocity is not None
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


@dataclass(frozen=True)
class _Window:
    """Samples of a window, about their mean."""

    design: FloatArray  # integral of the velocity, and the velocity, shape (K, 2)
    travelled: FloatArray  # position, shape (K,)


def _windows(
    times_s: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
) -> list[_Window]:
    """Windows of one joint that have enough samples and no gap; all of shape (T,)."""
    regressors = _integral_and_velocity(times_s, velocity)
    number = np.floor(times_s / WINDOW_S).astype(np.int64)
    windows = []
    for window in np.unique(number):
        inside = number == window
        gaps_s = np.diff(times_s[inside])
        if inside.sum() < FEWEST_SAMPLES or gaps_s.max() > LONGEST_GAP_S:
            continue
        design = regressors[inside] - regressors[inside].mean(axis=0)
        travelled = position[inside] - position[inside].mean()
        windows.append(_Window(design, travelled))
    return windows


def _velocity_scale(
    times_s: FloatArray, position: FloatArray, velocity: FloatArray
) -> VelocityScale | None:
    """Of one joint, by windows; all of shape (T,); None where velocities leave too much open."""
    windows = _windows(times_s, position, velocity)
    if len(windows) < FEWEST_WINDOWS:
        return None
    product = np.sum(
        [each.design.T @ each.design for each in windows],
        axis=0,
    )
    if np.linalg.cond(product) > 1e12:
        return None
    inverse = np.linalg.inv(product)
    slopes = inverse @ np.sum([each.design.T @ each.travelled for each in windows], axis=0)
    squares = 0.0
    whole = 0.0
    scores = np.zeros((len(windows), 2))
    for row, window in enumerate(windows):
        residual = window.travelled - window.design @ slopes
        scores[row] = window.design.T @ residual
        squares += float(residual @ residual)
        whole += float(window.travelled @ window.travelled)
    if slopes[0] <= 0.0 or squares > UNEXPLAINED**2 * whole:
        return None
    # what windows leave open differs from one to the next, whatever the samples within do
    freedom = len(windows) / (len(windows) - 2)
    covariance = freedom * inverse @ scores.T @ scores @ inverse
    return VelocityScale(
        float(slopes[0]), float(np.sqrt(covariance[0, 0])), float(slopes[1] / slopes[0])
    )
