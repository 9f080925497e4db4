"""Whether a recording's clock keeps time, by its torques: gravity needs no clock, inertia and friction do.

Where a motion took ``pace`` times as long as its stamps say, accelerations are ``1 / pace^2`` and velocities ``1 / pace`` of what
positions over stamps make of them. Gravity tells the first moments of an arm's bodies, and with them what their accelerations
must cost. A torque that is recorded late goes with its own derivative. Pace and lag are unknowns of one recording, linear in the
equations of `motion_equations`, and are fitted before all else.

A recorder that stamps frames by the rate that was asked for, while its loop runs slower, makes such recordings. A clock that keeps
time does so to 1e-4, so there is nothing in between: either the stamps are right, or they are off by any factor. A fit of a model
that is not quite right finds a few per cent, which is why so little is never followed.

Torques that are made of goals carry the goals' delay, which looks like another pace and is the same in all recordings of an arm:
there a pace counts beside the one that the calibration's own recordings read.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from proprio_ros.calibration_files.motions import MotionCalibration, ReadTimeAxis
from proprio_ros.errors import RecordingError
from proprio_ros.identification.chance import normal_density
from proprio_ros.identification.estimate import Verdict
from proprio_ros.identification.judge import Refusal
from proprio_ros.identification.reasons import Reason
from proprio_ros.identification.regression.motion_equations import (
    MIN_STRETCHES,
    STRETCH_S,
    Arm,
    Problem,
    equations,
)
from proprio_ros.identification.regression.motion_prior import (
    priors_of_calibration,
    priors_of_file,
)
from proprio_ros.identification.regression.recording_variability import CLOCK
from proprio_ros.identification.regression.solve import solve
from proprio_ros.recordings.motions import Motion
from proprio_ros.recordings.voltage import voltage_driven
from proprio_ros.records import FloatArray
from proprio_ros.robot import Robot

PACE_SPREAD = 0.5
"""Of the logarithm of a pace that is off, one standard deviation: loops were seen to run at 0.5 to 1.3 of their rate."""
LAG_SPREAD_S = 0.1
"""The same of a lag: filters and buses of up to some tenths of a second."""
PACE_MISFIT = 0.03
"""What a fit finds where the clock keeps time: twelve questions to a UR10e read a pace of 0.97 to 0.99."""
PACE_BETWEEN = 0.008
"""From recording to recording of one arm that a voltage drives: 28 recordings of seven simulated arms differ by 0.006."""
LAG_BETWEEN_S = 5e-4
"""The same of the lag, which differs by no more than it is known to."""
BETWEEN = np.diag([PACE_BETWEEN**2, LAG_BETWEEN_S**2])
"""Covariance of what differs so, as `ReadTimeAxis` has it."""
TORQUE_SPREAD = 0.1
"""By how much torques are larger than they were, where they are: of another supply voltage, or another gain."""
TORQUE_BETWEEN = 0.05
"""And where they are not: what friction under a load that nobody knows makes of it."""
LAG_OF_GOALS_S = 0.01
"""By how much goals act later or earlier than they did, where they do: some of the 10 to 35 ms that they take."""
LATEST_GOALS_S = 0.02
"""Goals that act later or earlier by more are not followed: of 25 ms two are missed, and masses are 2 standard deviations off."""
LAG_MISFIT_S = 0.01
"""And a lag: a cycle of a driver of 100 Hz; the same recordings read 10 to 14 ms."""
OFF_BEFORE = 0.1
"""How likely a clock is to be off before anything is known; it only counts where a recording says little."""
SIGMAS = 4.0
"""A clock is followed that is off by so many standard deviations, and said to be."""
ROUNDS = 4
SETTLED_PACE = 0.01
SETTLED_S = 1e-3
LEAST_ACCELERATION = -0.9
"""Of a step of the fit, relative: no time runs more than three times as slow as was thought."""


@dataclass(frozen=True)
class TimeAxis:
    """One recording's time axis as its torques show it."""

    pace: float  # true time over stamped time
    pace_std: float  # of its logarithm
    lag_s: float  # by how much torques are recorded later than positions [s]
    lag_std_s: float

    @property
    def runs_off(self) -> bool:
        """Whether stamps and torques contradict each other about how long things took."""
        return abs(np.log(self.pace)) > SIGMAS * np.hypot(self.pace_std, PACE_MISFIT)

    @property
    def is_late(self) -> bool:
        """Whether torques are recorded clearly later or earlier than positions."""
        return abs(self.lag_s) > SIGMAS * np.hypot(self.lag_std_s, LAG_MISFIT_S)


def with_time_axes(
    robot: Robot,
    motions: Sequence[Motion],
    calibration: MotionCalibration | None = None,
    *,
    loaded: bool = False,
) -> list[Motion]:
    """The motions with their clocks followed where these are off, and with how well the clocks are known.

    Args:
        robot: As its file states it.
        motions: Whose clocks are asked for, each by itself.
        calibration: What is known of the arm; without one, what the robot file says.
        loaded: Whether the hand holds something that nobody knows.

    Returns: One motion for each, with a note where its stamps were not taken as they are.
    """
    return [_followed(robot, motion, calibration, loaded) for motion in motions]


def _followed(
    robot: Robot, motion: Motion, calibration: MotionCalibration | None, loaded: bool
) -> Motion:
    if voltage_driven(robot):
        return _followed_by_voltage(robot, motion, calibration)
    try:
        clock = time_axis_of(robot, motion, calibration, loaded=loaded)
    except RecordingError:  # of no use for anything: the weighing says why
        return motion
    notes = []
    pace = 1.0
    lag_s = 0.0
    pace_std = _open_std(
        np.log(clock.pace),
        clock.pace_std,
        PACE_MISFIT,
        PACE_SPREAD,
    )
    lag_std_s = _open_std(clock.lag_s, clock.lag_std_s, LAG_MISFIT_S, LAG_SPREAD_S)
    if clock.runs_off and not _leaves_too_little(motion, clock.pace):
        pace = clock.pace
        pace_std = float(np.hypot(clock.pace_std, PACE_MISFIT))
        notes.append(_pace_followed(motion, pace, pace_std))
    if clock.is_late:
        lag_s = clock.lag_s
        lag_std_s = float(np.hypot(clock.lag_std_s, LAG_MISFIT_S))
        notes.append(_lag_followed(motion, lag_s))
    return _corrected(motion, TimeAxis(pace, pace_std, lag_s, lag_std_s), notes)


def _corrected(motion: Motion, clock: TimeAxis, notes: Sequence[Reason]) -> Motion:
    """The motion by a clock that is followed.

    Args:
        motion: As it was stamped.
        clock: What its time axis is taken to be, and how well that is known.
        notes: What is said of it.
    """
    return replace(
        _retimed(motion, clock.pace, clock.lag_s),
        notes=(*motion.notes, *notes),
        clock_off=tuple(notes),
        pace_std=clock.pace_std,
        lag_std_s=clock.lag_std_s,
    )


def _followed_by_voltage(
    robot: Robot, motion: Motion, calibration: MotionCalibration | None
) -> Motion:
    """By what its clock reads beside those of the calibration's own recordings.

    Torques are made of goals here, whose delay nobody states, and it looks like another pace.
    """
    if calibration is None or calibration.read_time_axis is None:
        return motion
    usual = calibration.read_time_axis
    try:
        read = read_time_axis(robot, motion, calibration)
    except RecordingError:
        return motion
    found, covariance = likeliest(
        read.values - usual.values,
        read.covariance + usual.covariance,
    )
    pace = float(np.exp(found[0]))
    lag_s = float(found[1])
    if abs(lag_s) > LATEST_GOALS_S:
        return motion  # other goals than the servos heard: what is unexplained then names that
    if found.any():
        doubt = _as_likely_by_torque(robot, motion, calibration, usual, found)
        covariance = covariance + doubt * np.outer(found, found)
    pace_std, lag_std_s = np.sqrt(np.diag(covariance)).tolist()
    notes = []
    if pace != 1.0:
        if _leaves_too_little(motion, pace):
            return replace(motion, pace_std=abs(float(found[0])) + pace_std)
        notes.append(_pace_followed(motion, pace, pace_std))
    if lag_s != 0.0:
        notes.append(_goals_followed(motion, lag_s))
    return _corrected(motion, TimeAxis(pace, pace_std, lag_s, lag_std_s), notes)


def likeliest(off: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What is off of a clock: nothing, its pace or its lag; the likeliest of these, and what the others leave open.

    Each is a Gaussian prior of what is off, their evidences weigh them, and moments are those of the mixture about the likeliest.

    Args:
        off: As `ReadTimeAxis.values`, beside what a recording reads whose clock keeps time, (2,).
        covariance: Of errors of that, (2, 2).

    Returns: The same of the likeliest, and its covariance.
    """
    nothing = np.zeros((2, 2))
    priors = [nothing, np.diag([PACE_SPREAD**2, 0.0]), np.diag([0.0, LAG_OF_GOALS_S**2])]
    log_evidence = np.log([1.0 - 2.0 * OFF_BEFORE, OFF_BEFORE, OFF_BEFORE])
    means = []
    covariances = []
    for row, prior in enumerate(priors):
        total = covariance + prior
        gain = prior @ np.linalg.inv(total)
        means.append(gain @ off)
        covariances.append(prior - gain @ prior)
        log_evidence[row] += _log_density(off, total)
    weights = np.exp(log_evidence - log_evidence.max())
    weights /= weights.sum()
    best = means[int(np.argmax(weights))]
    left = np.zeros((2, 2))
    for weight, mean, each in zip(weights, means, covariances, strict=True):
        left += weight * (each + np.outer(mean - best, mean - best))
    return best, left


def _log_density(off: FloatArray, covariance: FloatArray) -> float:
    """Of a normal distribution so far from its mean, but for what all of that size share."""
    _, log_size = np.linalg.slogdet(covariance)
    return float(-0.5 * (off @ np.linalg.solve(covariance, off) + log_size))


def _as_likely_by_torque(
    robot: Robot,
    motion: Motion,
    calibration: MotionCalibration,
    usual: ReadTimeAxis,
    found: FloatArray,
) -> float:
    """How likely it is that not the clock is off but the torque, which another supply voltage or another gain makes.

    Args:
        robot: As its file states it.
        motion: The recording.
        calibration: Of the arm.
        usual: What its own recordings read.
        found: What would be off of the clock, see `likeliest`, (2,).
    """
    values, covariance = _read(robot, motion, calibration, (*CLOCK, "common_scale"))
    off = values - np.append(usual.values, 0.0)
    covariance[:2, :2] += BETWEEN
    covariance[2, 2] += TORQUE_BETWEEN**2
    covariance[:2, :2] += usual.covariance
    by_clock = np.append(np.where(found, [PACE_SPREAD, LAG_OF_GOALS_S], 0.0), 0.0)
    by_torque = np.array([0.0, 0.0, TORQUE_SPREAD])
    clock, torque = (
        _log_density(off, covariance + np.diag(spread**2)) for spread in (by_clock, by_torque)
    )
    return float(1.0 / (1.0 + np.exp(np.clip(clock - torque, -500.0, 500.0))))


def read_time_axis(robot: Robot, motion: Motion, calibration: MotionCalibration) -> ReadTimeAxis:
    """What the clock of one recording reads, beside the calibration's arm, and what differs from recording to recording.

    Args:
        robot: As its file states it.
        motion: The recording.
        calibration: Of the arm.

    Raises `RecordingError`: It is too short, or of other joints than the calibration.
    """
    values, covariance = _read(robot, motion, calibration, CLOCK)
    return ReadTimeAxis(values, covariance + BETWEEN)


def _read(
    robot: Robot, motion: Motion, calibration: MotionCalibration, kinds: Sequence[str]
) -> tuple[FloatArray, FloatArray]:
    """What is off in a motion by kind, logarithm of pace and lag [s] first, and its covariance, (K,) and (K, K)."""
    *_, last = _steps(robot, motion, calibration, True, kinds)
    slopes = np.ones(len(kinds))
    slopes[0] = last.slope
    read = np.array([np.log(last.pace), last.lag_s, *last.others])
    return read, last.covariance * slopes[:, None] * slopes


def with_read_time_axis(
    robot: Robot, motions: Sequence[Motion], calibration: MotionCalibration
) -> MotionCalibration:
    """The calibration with the clock that its own recordings read, of an arm that a voltage drives: their mean, by least squares.

    Args:
        robot: As its file states it.
        motions: That the calibration is of.
        calibration: What they say of the arm.
    """
    if not voltage_driven(robot):
        return calibration
    information = np.zeros((2, 2))
    pull = np.zeros(2)
    for motion in motions:
        with suppress(RecordingError):  # too short to say anything of its clock
            read = read_time_axis(robot, motion, calibration)
            weight = np.linalg.inv(read.covariance)
            information += weight
            pull += weight @ read.values
    if not information.any():
        return calibration
    covariance = np.linalg.inv(information)
    symmetric = 0.5 * (covariance + covariance.T)
    return replace(calibration, read_time_axis=ReadTimeAxis(covariance @ pull, symmetric))


def _leaves_too_little(motion: Motion, pace: float) -> bool:
    """Whether a motion that took ``pace`` times as long is too short to weigh.

    Its clock is uncertain then, and not followed: what else is wrong with it bends the clock, and would be lost.
    """
    lasts_s = float(motion.times_s[-1] - motion.times_s[0])
    least_s = STRETCH_S * (MIN_STRETCHES + 1)
    return pace * lasts_s < least_s <= lasts_s


def _pace_followed(
    motion: Motion,
    pace: float,
    std: float,
) -> Reason:
    """What is said of stamps that run at another pace."""
    rate_hz = 1.0 / float(np.median(np.diff(motion.times_s)))
    return Reason(
        "clock_off",
        f"{motion.name}: by its torques all of it took {pace:.2f} times as long as its stamps say, so the loop ran at "
        f"{rate_hz / pace:.3g} of {rate_hz:.3g} Hz; that clock was followed, to {100.0 * std:.0f} %",
    )


def _lag_followed(motion: Motion, lag_s: float) -> Reason:
    """What is said of efforts that are recorded later than positions, or earlier."""
    when = "later" if lag_s > 0.0 else "earlier"
    return Reason(
        "clock_off",
        f"{motion.name}: its efforts were recorded {1e3 * abs(lag_s):.0f} ms {when} than its positions; they were moved back by "
        "that",
    )


def _goals_followed(motion: Motion, lag_s: float) -> Reason:
    """What is said of goals that act later than in the recordings of the calibration, or earlier."""
    when = "later" if lag_s > 0.0 else "earlier"
    return Reason(
        "clock_off",
        f"{motion.name}: its goals acted {1e3 * abs(lag_s):.0f} ms {when} than those of the calibration's recordings; they were "
        "moved by that",
    )


def with_time_axes_named(refusal: Refusal, motions: Sequence[Motion]) -> Refusal:
    """A refusal for which nothing else was found, with the clocks that were followed before its other reasons."""
    if refusal.verdict is Verdict.ACCEPTED:
        return refusal
    clocks = [reason for motion in motions for reason in motion.clock_off]
    return (
        replace(
            refusal,
            reasons=(*clocks, *refusal.reasons),
        )
        if clocks
        else refusal
    )


def time_axis_of(
    robot: Robot,
    motion: Motion,
    calibration: MotionCalibration | None = None,
    *,
    loaded: bool = False,
) -> TimeAxis:
    """The clock of one recording.

    Args:
        robot: As its file states it.
        motion: The recording.
        calibration: What is known of the arm; without one, what the robot file says.
        loaded: Whether the hand holds something that nobody knows.

    Raises `RecordingError`: It is too short, or of other joints than the calibration.
    """
    clock = TimeAxis(1.0, np.inf, 0.0, np.inf)
    for step in _steps(robot, motion, calibration, loaded, CLOCK):
        acceleration_std, lag_std_s = np.sqrt(np.diag(step.covariance)).tolist()
        clock = TimeAxis(
            pace=step.pace,
            pace_std=abs(step.slope) * acceleration_std,
            lag_s=step.lag_s,
            lag_std_s=lag_std_s,
        )
        if not (clock.runs_off or clock.is_late):
            break
    return clock


class _Step(NamedTuple):
    """What a clock is found to be after a step towards it."""

    pace: float
    lag_s: float
    slope: float  # of the logarithm of pace, by the accelerations' relative error
    others: FloatArray  # what else is off, by kind
    covariance: FloatArray  # of the accelerations' relative error, lag [s] and the others


def _steps(
    robot: Robot,
    motion: Motion,
    calibration: MotionCalibration | None,
    loaded: bool,
    kinds: Sequence[str],
) -> Iterator[_Step]:
    """Steps to first order in the lag, until nothing moves (Gauss-Newton).

    Args:
        robot: As its file states it.
        motion: The recording.
        calibration: What is known of the arm.
        loaded: Whether the hand holds something that nobody knows.
        kinds: Of what is looked for, pace and lag first.
    """
    pace = 1.0
    lag_s = 0.0
    for _ in range(ROUNDS):
        retimed = _retimed(motion, pace, lag_s)
        values, covariance = _solved(robot, retimed, calibration, loaded, kinds)
        step_pace, slope = _pace_of(values[0])
        step_lag_s = float(values[1])
        lag_s += pace * step_lag_s
        pace *= step_pace
        yield _Step(pace, lag_s, slope, values[2:], covariance)
        if abs(np.log(step_pace)) < SETTLED_PACE and abs(step_lag_s) < SETTLED_S:
            return


def _pace_of(acceleration: float) -> tuple[float, float]:
    """The pace at which accelerations are larger by that share, and by how much its logarithm goes with it."""
    larger = 1.0 + max(float(acceleration), LEAST_ACCELERATION)
    return larger**-0.5, -0.5 / larger


def _solved(
    robot: Robot,
    motion: Motion,
    calibration: MotionCalibration | None,
    loaded: bool,
    kinds: Sequence[str],
) -> tuple[FloatArray, FloatArray]:
    """What differs in a motion by kind, pace and lag first, and the covariance of that: (K,), (K, K)."""
    joints = motion.joints if calibration is None else calibration.joints
    arm = Arm.of(robot, joints, dict(motion.held))
    # a tool that nobody stated would bend the clock of an arm that only its file describes
    holds = loaded or calibration is None
    problem = Problem.of(
        [equations(robot, motion, joints)],
        int(holds),
    )
    priors = priors_of_file(robot, arm, 1)
    if calibration is not None:
        priors = priors_of_calibration(arm, calibration, [motion])
    # accelerations are off by twice as much as the pace
    opened = {"pace": 2.0 * PACE_SPREAD, "lag": LAG_SPREAD_S}
    if "common_scale" in kinds:
        opened["common_scale"] = TORQUE_SPREAD
    spreads = {**priors.variability.spreads, **opened}
    variability = replace(priors.variability, spreads=spreads)
    priors = replace(priors, variability=variability)
    solution = solve(problem, priors, calibration, followed=tuple(kinds))
    at = [problem.own(0).start + variability.place(kind) for kind in kinds]
    covariance = solution.covariance[np.ix_(at, at)]
    # the larger of what the fit and what its stretches say
    of_stretches = np.square(solution.deviations[:, at]).sum(axis=0)
    larger = np.sqrt(np.maximum(of_stretches / np.diag(covariance), 1.0))
    return solution.values[at], covariance * larger[:, None] * larger


def _retimed(
    motion: Motion,
    pace: float,
    lag_s: float,
) -> Motion:
    """The motion, had it taken ``pace`` times as long, and its torques been recorded ``lag_s`` of stamped time earlier."""
    if pace == 1.0 and lag_s == 0.0:
        return motion
    times_s = motion.times_s
    within = (times_s + lag_s >= times_s[0]) & (times_s + lag_s <= times_s[-1])
    current_A = np.column_stack(
        [np.interp(times_s[within] + lag_s, times_s, column) for column in motion.current_A.T]
    )
    part = motion.part(within)
    return replace(
        part,
        times_s=pace * part.times_s,
        current_A=current_A,
    )


def _open_std(
    off: float,
    std: float,
    misfit: float,
    spread: float,
) -> float:
    """What an error of a clock that is not followed leaves open: that it runs off after all, as likely as that still is.

    Args:
        off: What was found, beside nothing.
        std: How well.
        misfit: Standard deviation of what is found of a clock that keeps time.
        spread: The same of one that does not.
    """
    keeps = (1.0 - OFF_BEFORE) * normal_density(off, float(np.hypot(std, misfit)))
    runs_off = OFF_BEFORE * normal_density(off, float(np.hypot(std, spread)))
    likely = runs_off / max(keeps + runs_off, 1e-300)
    # of one that runs off: a Gaussian prior beside what was found
    known = 1.0 / (1.0 / max(std, 1e-9) ** 2 + 1.0 / spread**2)
    mean = off * known / max(std, 1e-9) ** 2
    return float(np.sqrt(likely * (mean**2 + known)))
