"""What the hand holds, sample by sample while the arm works, and when that changed.

Windows of half a second are made as they complete, as `motion_equations` has them, and compared with the torques of the empty
arm as its motion calibration has them. The windows of the last seconds of motion are one small Bayesian regression: the mass is
unknown; the arm, its torque constants, its friction in this session and the place of the load in the hand are nuisances under the
calibration's prior.
What is left over is correlated over seconds, so each joint's residuals are a Gaussian process with exponential correlation: its
size and length are those of the empty motions.

Something picked up or put down is a step of the mass. For each instant at which it may have been, the log-likelihood ratio of a
step there is summed over all windows since (cumulative sums with unknown size and onset: Willsky & Jones 1976, IEEE Transactions
on Automatic Control 21; Basseville & Nikiforov 1993, Detection of Abrupt Changes, chapter 2.4). Windows from before a change say
nothing about the new load, but still how friction is in this session: they stay, with a mass of their own.

A window in which a joint stands still says nothing of it, since there dry friction carries what it likes. So an arm at rest keeps
its last answer.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from proprio_ros.calibration_files.motions import MotionCalibration
from proprio_ros.errors import RobotError
from proprio_ros.identification.regression.motion_equations import HOP_SHARE, WINDOW_S, Arm, Rows, fill_drives
from proprio_ros.identification.regression.motion_prior import LEAST_TORQUE_STD, relative_torque_std
from proprio_ros.identification.regression.solve import Prior, posterior
from proprio_ros.identification.regression.weak_form import Windows
from proprio_ros.quantity import Z95
from proprio_ros.recordings.motions import LONGEST_GAP_S
from proprio_ros.records import FloatArray
from proprio_ros.robot import Robot
from proprio_ros.robot.kinematics import zero_pose
from proprio_ros.robot.regressor import point_mass

HOP_S = 0.1
"""A window every tenth of a second, so ten estimates per second."""
SMOOTHED_S = 0.12
"""Positions are those of a parabola through so much before and after: about 6 Hz, as offline, but without a future."""
LEAST_TAU_S = 0.3
"""What no model has (friction that goes with place and direction) stays alike for at least so long."""
NOISE_FACTOR = 2.0
"""A fit leaves less over in the motions that it was made from than in others; with this, 95 % intervals held on arms in MuJoCo."""
MEMORY_S = 12.0
"""Seconds of motion that are kept: friction in the gears of a session is not that of another, and takes that long to show."""
STEP_SIGMAS, STAY_SIGMAS = 5.0, 3.0
"""A step of the mass this far from zero is a change, and stays one while it is this far."""
LEAST_SHARE = 0.1
"""And so large in parts of what was held: what the load's place and gears do to its weight is no change."""
LONG_PAUSE_S = 2.0
"""After so long without a sample windows begin where samples come again."""
LATEST_STEP_S = 1.5
"""How long ago, in seconds of motion, a change is looked for."""
LEAST_AFTER = 3
"""Windows after a change before it counts: one that something touched is no object."""
UNSURE_S = 0.15
"""A change is found to this instant: windows that touch it say nothing of either load."""
TOLD_S = 1.0
"""`changed` is told for so long."""
RESTING_S = 0.5
"""An arm that has not moved for so long is at rest."""
WIDEST_SHARE, WIDEST_KG = 0.5, 0.01
"""No half width that is more than this share of the mass, and than this, is an answer."""
CENTRE_STD_M = 0.01
"""How far from the stated place in the hand the load's centre may be where nothing is said of it."""


@dataclass(frozen=True)
class OnlineEstimate:
    """What the hand holds now.

    Attributes:
        time_s: End of the newest window that was looked at, on the clock of the samples.
        mass_kg, std_kg: Of what is held; below zero where the hand seems lighter than empty.
        ci95_kg: 95 % interval.
        motion_s: Seconds of motion since the last change that it rests on.
        changed: Whether something was picked up or put down just now.
        since_s: When it last was, or when the first sample came.
        resting_since_s: When the arm came to rest; None while it moves.
    """

    time_s: float
    mass_kg: float
    std_kg: float
    ci95_kg: tuple[float, float]
    motion_s: float
    changed: bool
    since_s: float
    resting_since_s: float | None

    @property
    def known(self) -> bool:
        """Whether the interval is narrow enough to be called a mass."""
        return self.ci95_kg[1] - self.ci95_kg[0] < 2.0 * max(WIDEST_KG, WIDEST_SHARE * abs(self.mass_kg))


class OnlineEstimator:
    """A running estimate of the mass in the hand.

    Args:
        robot: The arm.
        calibration: Of its motions with an empty hand.
        centre_m: The load's centre of mass in the payload frame, shape (3,).
        centre_std_m: How far off that may be in each coordinate.
        window_s: Seconds of motion that an estimate rests on at most.
        held: Positions of the joints that are not in the calibration [rad or m]; 0 or the nearest limit where not given.

    Attributes:
        joints: Of the calibration.
        centre_m: As given.

    Raises:
        RobotError: The calibration is of another arm.
    """

    def __init__(
        self,
        robot: Robot,
        calibration: MotionCalibration,
        *,
        centre_m: Sequence[float] = (0.0, 0.0, 0.0),
        centre_std_m: float = CENTRE_STD_M,
        window_s: float = MEMORY_S,
        held: dict[str, float] | None = None,
    ) -> None:
        self.joints = calibration.joints
        others = [name for name in robot.model.independent_joints if name not in self.joints]
        places = zero_pose(robot, others) | (held or {})
        self._arm = Arm.of(robot, self.joints, places)
        names = self._arm.model.joint_names
        if tuple(names) != tuple(self.joints):
            raise RobotError(f"the motion calibration is of {', '.join(self.joints)}, the robot has {', '.join(names)}")
        told = calibration.referenced
        self._apart_std = np.array(
            [LEAST_TORQUE_STD if told else relative_torque_std(robot, name) for name in self.joints]
        )
        self._calibration = calibration
        self.centre_m = tuple(float(axis) for axis in centre_m)
        self._point = point_mass(np.asarray(centre_m))
        self._centre_std_m = max(centre_std_m, 1e-4)
        count = len(self.joints)
        covariance = calibration.covariance.copy()
        friction = calibration.friction
        covariance[friction, friction] += np.diag(calibration.friction_spread**2)
        # a file rounds: what should be zero may be a little below
        spread = np.sqrt(np.diag(covariance))
        size, ways = np.linalg.eigh(covariance / spread[:, None] / spread)
        self._prior_root = spread[:, None] * ways * np.sqrt(np.maximum(size, 0.0))
        # by how much the calibration's terms are off where one torque constant is off by its standard deviation
        self._by_share = calibration.covariance[:, 12 * count : 13 * count] / LEAST_TORQUE_STD
        self._widest_kg = self._arm.kg
        self._window_s = window_s
        self._noise = NOISE_FACTOR * np.maximum(calibration.residual, 1e-6)
        # an exponential that decays over tau makes 2 tau / hop neighbours one
        self._tau_s = np.maximum(0.5 * calibration.correlation * HOP_SHARE * WINDOW_S, LEAST_TAU_S)
        self._forget()

    def _forget(self) -> None:
        """As if nothing had come."""
        self._samples: deque[tuple[float, tuple[float, ...], tuple[float, ...]]] = deque()
        self._period_s = 0.0
        self._next_s = float("nan")
        self._windows: deque[Rows] = deque()
        self._steps: list[float] = []
        self._fresh_s: float | None = None
        self._mass: tuple[float, float] | None = None
        self._apart = 0.0, 0.0
        self._looked_s = self._first_s = self._changed_at_s = float("nan")
        self._moved_s = float("nan")
        self._told_until_s = -np.inf

    # --- what comes in ------------------------------------------------------------------------------------------------

    def add(self, time_s: float, positions: Sequence[float], currents: Sequence[float]) -> bool:
        """One sample of all joints of the calibration, in its order.

        Args:
            time_s: Its instant; one that is not later than the last is passed over, one from long before begins anew.
            positions: [rad], length n.
            currents: Of the motors [A], length n.

        Returns:
            Whether a window became complete, so that there may be a new estimate.
        """
        row = (time_s, tuple(map(float, positions)), tuple(map(float, currents)))
        if not np.isfinite([time_s, *row[1], *row[2]]).all():
            return False
        if self._samples and time_s <= self._samples[-1][0]:
            if self._samples[-1][0] - time_s > 1.0:  # a clock was set
                self._forget()
            else:
                return False
        if not self._samples:
            self._first_s = time_s
        if not self._samples or time_s - self._samples[-1][0] > LONG_PAUSE_S:
            self._next_s = time_s + SMOOTHED_S + 0.02
        self._samples.append(row)
        new = False
        while time_s >= self._next_s + WINDOW_S + SMOOTHED_S:
            self._make(self._next_s)
            self._next_s += HOP_S
            new = True
        while self._samples and self._samples[0][0] < self._next_s - SMOOTHED_S - 0.2:
            self._samples.popleft()
        return new

    def _make(self, start_s: float) -> None:
        """The window that begins there."""
        self._looked_s = start_s + WINDOW_S
        window = self._window(start_s)
        if window is None or not len(window.joint):
            return
        self._moved_s = start_s + WINDOW_S
        self._windows.append(window)
        while len(self._windows) > round(self._window_s / HOP_S):
            self._windows.popleft()
        self._steps = [at for at in self._steps if at > self._windows[0].start_s[0]]
        self._solve()

    def _window(self, start_s: float) -> Rows | None:
        lowest, highest = start_s - SMOOTHED_S, start_s + WINDOW_S + SMOOTHED_S
        rows = [row for row in self._samples if lowest - LONGEST_GAP_S <= row[0] <= highest + LONGEST_GAP_S]
        times_s = np.array([row[0] for row in rows])
        if len(rows) < 5 or np.diff(times_s).max() > LONGEST_GAP_S or times_s[0] > lowest or times_s[-1] < highest:
            return None
        if self._period_s == 0.0:
            self._period_s = WINDOW_S / max(round(WINDOW_S / float(np.median(np.diff(times_s)))), 10)
        period_s = self._period_s
        reach = max(round(SMOOTHED_S / period_s), 2)
        width = round(WINDOW_S / period_s)
        grid_s = start_s + period_s * np.arange(-reach, width + reach)
        position = _interpolated(grid_s, times_s, np.array([row[1] for row in rows]))
        current = _interpolated(grid_s[reach:-reach], times_s, np.array([row[2] for row in rows]))
        # a parabola through the neighbours, and its slope (Savitzky & Golay 1964)
        steps = np.arange(-reach, reach + 1)
        design = np.linalg.pinv(np.vander(steps, 3, increasing=True))
        view = np.lib.stride_tricks.sliding_window_view(position, 2 * reach + 1, axis=0)[:width]
        smooth, velocity = view @ design[0], view @ design[1] / period_s
        inside_s = np.asarray(grid_s[reach:-reach], dtype=np.float64)
        windows = Windows.over(width, width, width)
        return self._arm.rows(
            windows, inside_s, period_s, smooth, velocity, current * self._calibration.torque_constants
        )

    # --- what it says -------------------------------------------------------------------------------------------------

    def _solve(self) -> None:
        """Regress what the windows say, with a step where there is one; where exactly shows in the windows after it."""
        rows = _Rows(list(self._windows), self)
        if self._fresh_s is not None and rows.after(self._fresh_s) > round(LATEST_STEP_S / HOP_S):
            self._steps.append(self._fresh_s)
            self._fresh_s = None
        solution = rows.solve(self._steps)
        known = self._fresh_s is not None
        onset_s = rows.step(self._steps, solution, STAY_SIGMAS if known else STEP_SIGMAS)
        if onset_s is not None:
            solution = rows.solve([*self._steps, onset_s])
            self._changed_at_s = onset_s
            if not known:
                self._told_until_s = self._looked_s + TOLD_S
        elif known:
            self._changed_at_s = self._steps[-1] if self._steps else np.nan
            self._told_until_s = -np.inf
        self._fresh_s = onset_s
        self._mass = solution.mass_kg, solution.std_kg
        self._apart = rows.apart(solution)

    def estimate(self) -> OnlineEstimate | None:
        """What the hand holds now; None before anything moved."""
        if self._mass is None:
            return None
        mass, std = self._mass
        scale = self._calibration.torque_scale
        # nobody knows whether all torque constants are off together or each on its own: the larger covers every mixture
        counted, apart = self._apart
        constants = max(apart, abs(mass) * self._calibration.torque_scale_std)
        std = float(np.sqrt(max(std**2 - counted**2, 0.0) + constants**2)) * scale
        mass *= scale
        since = self._changed_at_s if np.isfinite(self._changed_at_s) else self._first_s
        begun = self._fresh_s if self._fresh_s is not None else self._steps[-1] if self._steps else -np.inf
        resting = self._looked_s - self._moved_s >= RESTING_S
        return OnlineEstimate(
            self._looked_s,
            mass,
            std,
            (mass - Z95 * std, mass + Z95 * std),
            HOP_S * sum(window.start_s[0] >= begun for window in self._windows),
            self._looked_s < self._told_until_s,
            since,
            self._moved_s if resting else None,
        )


@dataclass(frozen=True)
class _Solution:
    """Masses of one regression, and what a step is tested against.

    Attributes:
        mass_kg, std_kg: Of the newest stretch.
        design: Whitened columns of everything unknown, scaled by their priors, shape (E, U).
        residual: Whitened, shape (E,).
        inverse: Posterior covariance of the scaled unknowns, shape (U, U).
    """

    mass_kg: float
    std_kg: float
    design: FloatArray
    residual: FloatArray
    inverse: FloatArray


class _Rows:
    """All equations of the kept windows, by joint and then by time."""

    def __init__(self, windows: list[Rows], arm: OnlineEstimator) -> None:
        self._arm = arm
        rows = Rows.together(windows)
        order = np.argsort(rows.joint, kind="stable")
        rows = Rows(*(getattr(rows, field.name)[order] for field in fields(rows)))
        self.joint, self.start_s, self.load, design = rows.joint, rows.start_s, rows.payload, rows.design
        self.along = self.load @ arm._point
        calibration, count = arm._calibration, len(arm.joints)
        mass = 0.0 if arm._mass is None else arm._mass[0]
        fill_drives(design, calibration.values, rows, slice(11 * count, 12 * count), mass * self.along)
        right = rows.torque - design @ calibration.values
        self.roots = []
        for number in range(count):
            at = self.start_s[self.joint == number]
            apart = np.abs(at[:, None] - at[None, :])
            kernel = arm._noise[number] ** 2 * (np.exp(-apart / arm._tau_s[number]) + 0.02 * np.eye(len(at)))
            self.roots.append(np.linalg.inv(np.linalg.cholesky(kernel)) if len(at) else kernel)
        self.right = self._white(right)
        self.arm_design = self._white(design @ arm._prior_root)
        self.share_design = self._white(design @ arm._by_share)
        self.heavy_kg = abs(mass) + (0.05 if arm._mass is None else arm._mass[1])

    def _white(self, values: FloatArray) -> FloatArray:
        return np.concatenate(
            [root @ values[self.joint == number] for number, root in enumerate(self.roots) if len(root)]
        )

    def _share(self, onset_s: float) -> FloatArray:
        """How much of each row's window lies after an instant, by its weight, shape (E,)."""
        x = np.clip(2.0 * (onset_s - self.start_s) / WINDOW_S - 1.0, -1.0, 1.0)
        before = 0.5 + 35.0 / 32.0 * (x - x**3 + 0.6 * x**5 - x**7 / 7.0)  # integral of (1 - x^2)^3
        return 1.0 - before

    def solve(self, steps: Sequence[float]) -> _Solution:
        """The masses of the stretches between the steps."""
        arm = self._arm
        along, columns = self.along, []
        heavy = self.heavy_kg * arm._centre_std_m
        # between which instants each stretch lies; windows across a step hold any part of both, each its own
        begins = [-np.inf, *(at + UNSURE_S for at in steps)]
        ends = [*(at - UNSURE_S - WINDOW_S for at in steps), np.inf]
        for begin, end in zip(reversed(begins), reversed(ends), strict=True):
            held = (self.start_s >= begin) & (self.start_s <= end)
            columns.append(held * along * arm._widest_kg)
            columns += [held * self.load[:, axis] * heavy for axis in (1, 2, 3)]
        for at in steps:
            across = (self.start_s > at - UNSURE_S - WINDOW_S) & (self.start_s < at + UNSURE_S)
            columns += [(self.start_s == start) * along * arm._widest_kg for start in np.unique(self.start_s[across])]
        design = np.hstack([self._white(np.column_stack(columns)), self.arm_design])
        unknowns = design.shape[1]
        prior = Prior(np.zeros(unknowns), np.eye(unknowns))
        values, inverse = posterior(design.T @ design, design.T @ self.right, prior)
        mass, std = values[0] * arm._widest_kg, np.sqrt(inverse[0, 0]) * arm._widest_kg
        return _Solution(float(mass), float(std), design, self.right - design @ values, inverse)

    def apart(self, solution: _Solution) -> tuple[float, float]:
        """What torque constants that err each on its own put on the mass [kg]: as the solution has it, and as they are known."""
        by_share = self._arm._widest_kg * (solution.inverse[0] @ (solution.design.T @ self.share_design))
        counted = float(np.linalg.norm(by_share))
        return counted, float(np.linalg.norm(by_share * self._arm._apart_std / LEAST_TORQUE_STD))

    def after(self, onset_s: float) -> int:
        """How many windows begin after an instant."""
        return len(np.unique(self.start_s[self.start_s >= onset_s]))

    def step(self, steps: Sequence[float], solution: _Solution, sigmas: float) -> float | None:
        """When something was picked up or put down that is not among the known steps; None: nothing was."""
        starts = np.unique(self.start_s)
        earliest = steps[-1] + 2.0 * WINDOW_S if steps else -np.inf
        onsets = starts[max(1, len(starts) - round(LATEST_STEP_S / HOP_S)) : len(starts) - LEAST_AFTER + 1]
        onsets = onsets[onsets > earliest]
        if not len(onsets):
            return None
        columns = self._white(np.column_stack([self._share(at) * self.along for at in onsets]))
        free = columns - solution.design @ (solution.inverse @ (solution.design.T @ columns))
        information = np.maximum(np.einsum("ij,ij->j", columns, free), 1e-12)
        change_kg = columns.T @ solution.residual / information
        score = np.abs(change_kg) * np.sqrt(information)
        best = int(np.argmax(score))
        least_kg = LEAST_SHARE * abs(solution.mass_kg)
        return float(onsets[best]) if score[best] > sigmas and abs(change_kg[best]) > least_kg else None


def _interpolated(at_s: NDArray[Any], times_s: FloatArray, values: FloatArray) -> FloatArray:
    return np.column_stack([np.interp(at_s, times_s, column) for column in values.T])
