"""What the hand holds, sample by sample while the arm works, and when that changed.

Windows of a tenth of a second, each by half over the one before, are rows as `motion_equations` has them: the mean torque of each
joint that moves, less that of the empty arm as its motion calibration has it. A Kalman filter follows what they say. Its state: the
mass and the place of what is held; arm, torque constants and friction under the calibration's prior, to which they return within
`MEMORY_S`; and of each joint the torque that no model has, with exponential correlation, as large and long as in the empty motions.
How noisy a window of a tenth of a second is, the innovations themselves say.

Something picked up or put down is a step of the mass. For each instant of the last second at which it may have been, the filter
carries along how it would answer to a step of one kilogram there; innovations that look like that are a change (generalised
likelihood ratio: Willsky & Jones 1976, IEEE Transactions on Automatic Control 21; Basseville & Nikiforov 1993, Detection of Abrupt
Changes, chapters 2.4 and 7). The filter of just before it then goes on with a mass of which nothing is known, so what the arm
showed before counts for the arm and not for the load. How early that can be told: `test/benchmarks/running.py` has the bound.

A window in which a joint stands still says nothing of it, since there dry friction carries what it likes. So an arm at rest keeps
its last answer. Joint states that say the same again while the arm moves are no news.

Constants below that name no source were chosen by hand; `test/benchmarks/running.py` measures what becomes of answers with them.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from proprio_ros.calibration_files.motions import MotionCalibration
from proprio_ros.errors import RobotError
from proprio_ros.identification.estimate import LIMIT_WHILE_RUNNING
from proprio_ros.identification.regression.arm_terms import ArmTerms
from proprio_ros.identification.regression.motion_equations import (
    HOP_SHARE,
    Arm,
    Rows,
    Samples,
    fill_drives,
)
from proprio_ros.identification.regression.motion_equations import WINDOW_S as CALIBRATED_S
from proprio_ros.identification.regression.motion_prior import LEAST_TORQUE_STD, relative_torque_std
from proprio_ros.identification.regression.scale_in_motion import NOTHING_SEEN, TorqueScale
from proprio_ros.identification.regression.weak_form import Windows
from proprio_ros.quantity import Z95
from proprio_ros.recordings.motions import LONGEST_GAP_S
from proprio_ros.recordings.voltage import voltage_driven
from proprio_ros.records import FloatArray
from proprio_ros.robot import ReducedModel, Robot
from proprio_ros.robot.kinematics import zero_pose
from proprio_ros.robot.regressor import PARAMETERS, carriers, kinematics, momentum_along, point_mass

# Windows are so long, and have so many samples at least.
WINDOW_S = 0.1
WINDOW_SAMPLES = 10
# Positions are those of a parabola through so much before and after, and so many samples at least.
SMOOTHED_S = 0.02
SMOOTHED_SAMPLES = 3
SPARSE_REACH = 2  # The same of windows that have fewer samples than they should.
LEAST_DENSITY = 0.6
"""A window with fewer samples than this, as a share of what should be in it, has another grid, or says nothing."""
LATE = 0.25
LATE_S = 1e-3
LATE_SAMPLES = 4
"""Joint states come at a steady pace, and some may be lost. One that so many come after, sooner than they should by more than this
share of a period, and than so long, was stamped later than it was measured: a busy computer did not run its publisher between the
two. By so many a pace of which the period is known to 6 % never looks late."""
CROWDED_S = 1.0  # Where each shows that another was late for so long, the period is another by now.
COUNTS = 2.5  # An encoder that flickers by a count or two is at rest.
THINNED_S = 0.005  # Samples that are closer say nothing more, once they are smoothed.
LEARNT_S = 0.3  # In so long the period of the joint states shows.
# What no model has (friction that goes with place and direction) stays alike for at least so long.
LEAST_TAU_S = 0.3
NOISE_FACTOR = 2.0
"""A fit leaves less over in the motions that it was made from than in others; with this, 95 % intervals held on arms in MuJoCo."""
LEAST_NOISE = 0.05  # A window is at least so noisy, in parts of what the calibration leaves over.
TURNING = 0.3  # Where a joint turns round, so much of its Coulomb friction is open.
MEMORY_S = 12.0
"""Seconds of motion that count: friction in the gears of a session is not that of another, and takes that long to show."""
STEP_SIGMAS = 6.0  # A step of the mass this far from zero is a change,
STAY_SIGMAS = 4.0  # and stays one while it is this far.
LEAST_SHARE = 0.1
"""And so large in parts of what was held: what the load's place and gears do to its weight is no change."""
LATEST_STEP_S = 1.0  # How long ago, in seconds of motion, a change is looked for.
FRESH_S = 0.6  # After so much motion a change stands, and where exactly it was.
ONSET_SHARE = 0.05
"""An instant is found to a quarter of a window: of the first window after it so much may lie before it."""
# A window's noise is learnt from so many.
NOISE_WINDOWS = 100
FEWEST_WINDOWS = 20
# Innovations that are larger than they should be widen the interval for about so long.
MISFIT_S = 1.0
_Row = tuple[float, tuple[float, ...], tuple[float, ...]]
"""A sample: its instant, positions [rad] and currents [A] of all joints."""
LONG_PAUSE_S = 2.0  # After so long without a sample windows begin where samples come again.
# Joint states that say the same so often, of an arm that was so fast for so long before, come from a publisher that stalls.
FROZEN = 4
FROZEN_S = 0.05
FROZEN_RAD_S = 0.1
TOLD_S = 1.0  # `changed` is told for so long.
RESTING_S = 0.5  # An arm that has not moved for so long is at rest.
LEAST_HEAVY_KG = 0.02  # A load counts as at least so heavy where its centre is open.
LEAST_EIGENVALUE = 1e-9  # Of a calibration's correlations, in parts of the largest: below it there is only rounding.
# How far from the stated place in the hand the load's centre may be where nothing is said of it.
CENTRE_STD_M = 0.01
LEAST_CENTRE_STD_M = 1e-4  # Nobody knows it better.


def is_finite(
    time_s: float,
    positions: Sequence[float],
    currents: Sequence[float],
) -> bool:
    """Whether a sample has numbers alone: ``time_s``, ``positions`` and ``currents``."""
    return bool(np.isfinite([time_s, *positions, *currents]).all())


@dataclass(frozen=True)
class OnlineEstimate:
    """What the hand holds now."""

    time_s: float  # end of the newest window that was looked at, on the clock of the samples
    # mass_kg, std_kg: of what is held; below zero where the hand seems lighter than empty
    mass_kg: float
    std_kg: float
    ci95_kg: tuple[float, float]  # 95 % interval
    motion_s: float  # seconds of motion since the last change that it rests on, `MEMORY_S` at most
    changed: bool  # whether something was picked up or put down just now
    since_s: float  # when it last was, or when the first sample came
    resting_since_s: float | None  # when the arm came to rest; None while it moves

    @property
    def known(self) -> bool:
        """Whether the interval is narrow enough to be called a mass."""
        return self.ci95_kg[1] - self.ci95_kg[0] < 2.0 * LIMIT_WHILE_RUNNING.widest(self.mass_kg)


@dataclass(frozen=True)
class Stretch:
    """What an estimate needs of the samples, so that it can say anything."""

    length_s: float  # so much without a gap
    spacing_s: float  # a sample that follows another sooner may be left out; 0: none may


@dataclass(frozen=True)
class _Grid:
    """Equally spaced instants of a window, to which samples are brought.

    Attributes:
        period_s: Between two of them.
        width: How many are in a window.
        reach: How many before and after each one smooth it.
        thin: Every so many of the smoothed ones count.
        smoothing: What makes position and slope of neighbours' positions, shape (3, 2 reach + 1).
        windows: Test functions over those that count.
    """

    period_s: float
    width: int
    reach: int
    thin: int
    smoothing: FloatArray
    windows: Windows

    @classmethod
    def of(
        cls,
        period_s: float,
        width: int,
        reach: int,
    ) -> _Grid:
        """By ``period_s``, ``width`` and ``reach``, see above."""
        thin = max(int(THINNED_S / period_s), 1)
        inside = len(range(0, width, thin))
        # a parabola through the neighbours, and its slope (Savitzky & Golay 1964)
        powers = np.vander(
            np.arange(-reach, reach + 1),
            3,
            increasing=True,
        )
        smoothing = np.linalg.pinv(powers)
        return cls(
            period_s,
            width,
            reach,
            thin,
            smoothing,
            Windows.over(inside, inside, inside),
        )

    @property
    def reach_s(self) -> float:
        return self.reach * self.period_s

    def sparser(self, width: int) -> _Grid:
        """One of as long a window with fewer samples, which needs nothing from further away."""
        period_s = self.width * self.period_s / width
        return _Grid.of(
            period_s,
            width,
            max(int(self.reach_s / period_s + 0.01), SPARSE_REACH),
        )


class OnlineEstimator:
    """A running estimate of the mass in the hand.

    Args:
        robot: The arm.
        calibration: Of its motions with an empty hand.
        centre_m: The load's centre of mass in the payload frame, shape (3,).
        centre_std_m: How far off that may be in each coordinate.
        held: Positions of the joints that are not in the calibration [rad or m]; 0 or the nearest limit where not given.

    Attributes:
        joints: Of the calibration.
        centre_m: As given.
        frozen: Whether joint states say the same again and again while the arm moves.

    Raises `RobotError`: The calibration is of another arm, or of a joint that is only read.
    """

    def __init__(
        self,
        robot: Robot,
        calibration: MotionCalibration,
        *,
        centre_m: Sequence[float] = (0.0, 0.0, 0.0),
        centre_std_m: float = CENTRE_STD_M,
        held: dict[str, float] | None = None,
    ) -> None:
        self.joints = calibration.joints
        robot.check_efforts_known()
        others = [name for name in robot.model.independent_joints if name not in self.joints]
        self._arm = Arm.of(
            robot,
            self.joints,
            zero_pose(robot, others) | (held or {}),
        )
        names = self._arm.model.joint_names
        if tuple(names) != tuple(self.joints):
            raise RobotError(
                f"the motion calibration is of {', '.join(self.joints)}, the robot has {', '.join(names)}"
            )
        told = calibration.referenced
        self._apart_std = np.array(
            [LEAST_TORQUE_STD if told else relative_torque_std(robot, name) for name in self.joints]
        )
        self._calibration = calibration
        self._by_gain = not {*voltage_driven(robot)}.isdisjoint(self.joints)
        self._least_rad = COUNTS * np.array(
            [robot.drive_trains[name].encoder_resolution for name in self.joints]
        )
        self.centre_m = tuple(float(axis) for axis in centre_m)
        self._prior = _ArmPrior(
            self._arm, calibration, np.asarray(centre_m), max(centre_std_m, LEAST_CENTRE_STD_M)
        )
        self._forget()

    def _forget(self) -> None:
        """As if nothing had come."""
        self._samples: deque[_Row] = deque()
        self._window_s = 0.0
        self._hop_s = 0.0
        self._grid: _Grid | None = None
        self._sparser: dict[int, _Grid] = {}
        self._recent: deque[_Row] = deque(maxlen=LATE_SAMPLES)
        # when a sample last came that showed none before it to be late
        self._paced_s = float("nan")
        self._next_s = float("nan")
        self._filter: _Filter | None = None
        self._fresh: _FreshChange | None = None
        self._looked_s = float("nan")
        self._first_s = float("nan")
        self._changed_at_s = float("nan")
        self._moved_s = float("nan")
        self._told_until_s = -np.inf
        self._same = 0
        self._jitter = np.zeros((self._arm.count, self._arm.count))

    @property
    def frozen(self) -> bool:
        return self._same >= FROZEN

    def add(
        self,
        time_s: float,
        positions: Sequence[float],
        currents: Sequence[float],
    ) -> bool:
        """One sample of all joints of the calibration, in its order.

        Args:
            time_s: Its instant; one that is not later than the last is passed over, one from long before begins anew.
            positions: [rad], length n.
            currents: Of the motors [A], length n.

        Returns: Whether a window became complete, so that there may be a new estimate.
        """
        row = (time_s, tuple(map(float, positions)), tuple(map(float, currents)))
        if not is_finite(*row):
            return False
        if self._samples and time_s <= self._samples[-1][0]:
            if self._samples[-1][0] - time_s > 1.0:  # a clock was set
                self._forget()
            else:
                return False
        if self._repeats(row):
            return False
        if not self._samples:
            self._first_s = time_s
        if not self._samples or time_s - self._samples[-1][0] > LONG_PAUSE_S:
            self._samples.clear()
            self._recent.clear()
            self._paced_s = time_s
            self._next_s = time_s + SMOOTHED_S + 0.02
        self._leave_out_late(time_s)
        self._samples.append(row)
        self._recent.append(row)
        grid = self._grid or self._learnt_grid()
        if grid is None:
            return False
        new = False
        while time_s >= self._next_s + self._window_s + grid.reach_s:
            new |= self._make(grid, self._next_s)
            self._next_s += self._hop_s
        while self._samples and self._samples[0][0] < self._next_s - grid.reach_s - 0.2:
            self._samples.popleft()
        if time_s - self._paced_s > CROWDED_S:
            self._forget()
        return new

    def _leave_out_late(self, time_s: float) -> None:
        """Samples that were stamped too late, as one shows that comes now."""
        grid = self._grid
        if grid is None:
            return
        period_s = grid.period_s
        tolerance_s = min(max(LATE * period_s, LATE_S), 0.5 * period_s)
        late = [
            row
            for after, row in enumerate(reversed(self._recent), start=1)
            if time_s - row[0] < after * period_s - tolerance_s
        ]
        if not late:
            self._paced_s = time_s
            return
        times_s = {row[0] for row in late}
        kept = [row for row in self._samples if row[0] not in times_s]
        self._samples = deque(kept)

    @property
    def needs(self) -> Stretch:
        """What it needs of the samples from now on."""
        grid = self._grid
        if grid is None:
            return Stretch(2.0 * LEARNT_S, 0.0)
        every = max(grid.width // WINDOW_SAMPLES, 1)
        length_s = self._window_s + self._hop_s + 2.0 * grid.reach_s + 2.0 * self._longest_s(grid)
        return Stretch(length_s, (every - 0.5) * grid.period_s)

    def _repeats(self, row: _Row) -> bool:
        """Whether a sample says nothing new of an arm that moves."""
        if len(self._samples) < 2 or row[1:] != self._samples[-1][1:]:
            self._same = 0
            return False
        last = self._samples[-1]
        earlier = (each for each in reversed(self._samples) if last[0] - each[0] >= FROZEN_S)
        before = next(earlier, last)
        if before is last:
            return False
        moved_rad = np.abs(np.subtract(last[1], before[1])).max()
        if moved_rad < FROZEN_RAD_S * (last[0] - before[0]):
            return False  # it may have come to rest
        self._same += 1
        return True

    def _learnt_grid(self) -> _Grid | None:
        """That of windows from now on; None: the period of the samples does not show yet."""
        times_s = [row[0] for row in self._samples]
        if times_s[-1] - times_s[0] < LEARNT_S or len(times_s) < WINDOW_SAMPLES:
            return None
        period_s = float(np.median(np.diff(times_s)))
        width = max(round(WINDOW_S / period_s), WINDOW_SAMPLES)
        reach = max(round(SMOOTHED_S / period_s), SMOOTHED_SAMPLES)
        self._grid = _Grid.of(period_s, width, reach)
        self._window_s = width * period_s
        self._hop_s = 0.5 * self._window_s
        self._next_s = times_s[0] + (reach + 1) * period_s
        self._paced_s = times_s[-1]
        self._filter = _Filter(self._prior, self._window_s)
        return self._grid

    def _make(self, grid: _Grid, start_s: float) -> bool:
        """The window that begins there; whether samples say something of it."""
        window = self._window(grid, start_s)
        if window is None:
            return False
        self._looked_s = start_s + self._window_s
        if len(window.rows.joint):
            self._moved_s = self._looked_s
            self._hear(window)
        return True

    def _longest_s(self, grid: _Grid) -> float:
        """A gap that is longer has no window across it."""
        return min(max(3.5 * grid.period_s, 0.25 * self._window_s), LONGEST_GAP_S)

    def _fitting(self, grid: _Grid, density: float) -> _Grid | None:
        """The grid for a window with so much of the samples that should be in it; None: it says nothing."""
        if density > LEAST_DENSITY:
            return grid
        width = round(density * grid.width)
        if width < WINDOW_SAMPLES:
            return None
        if width not in self._sparser:
            self._sparser[width] = grid.sparser(width)
        return self._sparser[width]

    def _window(self, grid: _Grid, start_s: float) -> _Window | None:
        lowest = start_s - grid.reach_s
        highest = start_s + self._window_s + grid.reach_s
        longest_s = self._longest_s(grid)
        rows = [row for row in self._samples if lowest - longest_s <= row[0] <= highest + longest_s]
        times_s = np.array([row[0] for row in rows])
        if (
            len(rows) < 5
            or np.diff(times_s).max() > longest_s
            or times_s[0] > lowest
            or times_s[-1] < highest
        ):
            return None
        spans_s = times_s[-1] - times_s[0] + grid.period_s
        fitting = self._fitting(
            grid,
            len(rows) * grid.period_s / spans_s,
        )
        if fitting is None:
            return None
        return self._window_on(fitting, start_s, rows)

    def _window_on(
        self,
        grid: _Grid,
        start_s: float,
        rows: Sequence[_Row],
    ) -> _Window:
        """The same of samples, on a grid."""
        times_s = np.array([row[0] for row in rows])
        inside = np.arange(
            -grid.reach,
            grid.width + grid.reach,
        )
        grid_s = start_s + grid.period_s * inside
        position = _interpolated(
            grid_s,
            times_s,
            np.array([row[1] for row in rows]),
        )
        current = _interpolated(
            grid_s,
            times_s,
            np.array([row[2] for row in rows]),
        )
        moves = np.ptp(position, axis=0) > self._least_rad
        samples = self._smoothed(grid, start_s, position, current)
        made = self._arm.rows(samples, moves)
        middle = samples.position[len(samples.position) // 2]
        return _Window(made, self._of_acceleration(grid, middle))

    def _smoothed(
        self, grid: _Grid, start_s: float, position: FloatArray, current: FloatArray
    ) -> Samples:
        """Every so many samples of a grid, positions by the parabola through their neighbours."""
        reach = grid.reach
        thin = grid.thin
        mean, slope = grid.smoothing[:2]
        inside = slice(reach, reach + grid.width, thin)
        neighbours = sliding_window_view(position, 2 * reach + 1, axis=0)[: grid.width : thin]
        smooth = neighbours @ mean  # (samples, n)
        left_over = position[inside] - smooth
        jitter = 0.2 * left_over.T @ left_over / len(smooth) / (1.0 - mean[reach])
        self._jitter = 0.8 * self._jitter + jitter
        torque = sliding_window_view(current, thin, axis=0)[inside].mean(-1)
        since_s = grid.period_s * np.arange(0, grid.width, thin)
        return Samples(
            windows=grid.windows,
            times_s=np.asarray(start_s + since_s, dtype=np.float64),
            period_s=thin * grid.period_s,
            position=smooth,
            velocity=neighbours @ slope / grid.period_s,
            torque=torque * self._calibration.torque_constants,
        )

    def _of_acceleration(self, grid: _Grid, position: FloatArray) -> FloatArray:
        """What noise of positions and stamps makes of the torque that accelerates the arm, covariance, shape (n, n).

        Late or early stamps move all joints at once, so their errors go together.
        """
        slope = grid.smoothing[1]
        thin = grid.thin
        weights = np.zeros((len(grid.windows.slope) - 1) * thin + len(slope))
        for number, share in enumerate(grid.windows.slope):
            weights[number * thin : number * thin + len(slope)] += share * slope
        per_position = float(weights @ weights) / (thin * grid.period_s**2) ** 2
        inertia = inertia_matrix(
            self._arm.model, position, self._calibration.values[: 11 * self._arm.count]
        )
        result: FloatArray = per_position * inertia @ self._jitter @ inertia
        return result

    def _hear(self, window: _Window) -> None:
        """Go on by a window, and look for a step; where exactly it was shows in the windows after it."""
        assert self._filter is not None
        self._filter.step(window)
        if self._fresh is not None and self._fresh.filter.motion_s > FRESH_S:
            self._confirm(self._fresh, window)
        fresh = self._fresh
        onset_s = self._filter.onset(STEP_SIGMAS if fresh is None else STAY_SIGMAS)
        if onset_s is None:
            self._dismiss()
            return
        if fresh is None:
            self._told_until_s = self._looked_s + TOLD_S
            self._fresh = _FreshChange(onset_s, self._filter.after(onset_s), self._changed_at_s)
        elif onset_s == fresh.onset_s:
            fresh.filter.step(window)
        else:
            self._fresh = replace(fresh, onset_s=onset_s, filter=self._filter.after(onset_s))
        self._changed_at_s = onset_s

    def _confirm(self, fresh: _FreshChange, window: _Window) -> None:
        """The change stands: go on from it, and look for the next."""
        self._filter = fresh.filter
        self._filter.step(window)
        self._fresh = None

    def _dismiss(self) -> None:
        """What looked like a change, if anything did, was none."""
        if self._fresh is not None:
            self._changed_at_s = self._fresh.before_s
            self._told_until_s = -np.inf
        self._fresh = None

    @property
    def _newest(self) -> _Filter | None:
        """The filter that says what the hand holds now; None: there is none yet."""
        return self._filter if self._fresh is None else self._fresh.filter

    @property
    def scale(self) -> TorqueScale:
        """What motion shows of the scale of all torques, of servos whose gain nobody reads; else nothing."""
        now = self._newest
        if now is None or not self._by_gain:
            return NOTHING_SEEN
        return now.scale

    def estimate(self) -> OnlineEstimate | None:
        """What the hand holds now; None before anything moved."""
        now = self._newest
        if now is None or not now.motion_s:
            return None
        scale = self._calibration.torque_scale
        of_gain = now.by_scale * self.scale.likely_error
        if self.scale.is_other:
            of_gain = self._arm.kg
        std = scale * float(np.sqrt(self._variance(now) + of_gain**2))
        mass = scale * now.mass_kg
        resting = self._looked_s - self._moved_s >= RESTING_S
        changed = np.isfinite(self._changed_at_s)
        return OnlineEstimate(
            time_s=self._looked_s,
            mass_kg=mass,
            std_kg=std,
            ci95_kg=(mass - Z95 * std, mass + Z95 * std),
            motion_s=min(now.motion_s, MEMORY_S),
            changed=self._looked_s < self._told_until_s,
            since_s=self._changed_at_s if changed else self._first_s,
            resting_since_s=self._moved_s if resting else None,
        )

    def _variance(self, now: _Filter) -> float:
        """Of the mass, before it is scaled [kg^2]."""
        mass = now.mass_kg
        calibration = self._calibration
        if calibration.scale_of_load is not None:
            # the scale errs together with the arm
            together = 2.0 * mass * now.covariance_with_scale
            of_scale = (mass * calibration.torque_scale_std) ** 2
            return max(now.std_kg**2 + together + of_scale, 0.0)
        # nobody knows whether all torque constants are off together or each on its own: the larger covers every mixture
        counted = float(np.linalg.norm(now.by_share))
        apart = float(np.linalg.norm(now.by_share * self._apart_std / LEAST_TORQUE_STD))
        constants = max(apart, abs(mass) * calibration.torque_scale_std)
        return max(now.std_kg**2 - counted**2, 0.0) + constants**2


@dataclass(frozen=True)
class _FreshChange:
    """What was picked up or put down just now; the next windows say whether and when exactly it was."""

    onset_s: float
    filter: _Filter  # with a load of which nothing is known since then
    before_s: float  # when the change before it was; NaN: there was none


class _ArmPrior:
    """What is known of an arm, for every filter of it."""

    def __init__(
        self, arm: Arm, calibration: MotionCalibration, centre_m: FloatArray, centre_std_m: float
    ) -> None:
        terms = ArmTerms(arm.count)
        covariance = calibration.covariance.copy()
        friction = calibration.friction
        covariance[friction, friction] += np.diag(calibration.friction_spread**2)
        # a file rounds: what should be zero may be a little below
        spread = np.sqrt(np.diag(covariance))
        size, ways = np.linalg.eigh(covariance / spread[:, None] / spread)
        kept = size > LEAST_EIGENVALUE * size[-1]
        self.values = calibration.values
        self.count = arm.count
        self.widest_kg = arm.kg
        self.centre_std_m = centre_std_m
        self.root = spread[:, None] * ways[:, kept] * np.sqrt(size[kept])
        # covariance of the relative scale of all torques with the state
        self.with_scale = np.zeros(self.root.shape[1])
        if calibration.scale_of_load is not None:
            along = calibration.scale_of_load.covariance / spread
            self.with_scale = along @ ways[:, kept] / np.sqrt(size[kept])
        # by how much the calibration's terms are off where one torque constant is off by its standard deviation
        self.by_share = calibration.covariance[:, terms.torque_shares] / LEAST_TORQUE_STD
        self.noise = NOISE_FACTOR * np.maximum(calibration.residual, 1e-6)
        # an exponential that decays over tau makes 2 tau / hop neighbours one
        tau_s = 0.5 * calibration.correlation * HOP_SHARE * CALIBRATED_S
        self.tau_s = np.maximum(tau_s, LEAST_TAU_S)
        self.coulomb = np.abs(calibration.values[terms.coulomb])
        self.point = point_mass(centre_m)


@dataclass(frozen=True)
class _Window:
    """Its rows, and the covariance of what errors of positions put on all joints' torque, shape (n, n)."""

    rows: Rows
    of_acceleration: FloatArray

    @property
    def start_s(self) -> float:
        return float(self.rows.start_s[0])


@dataclass(frozen=True)
class _Past:
    """A window, and the filter before it."""

    window: _Window
    state: FloatArray
    covariance: FloatArray
    time_s: float
    misfit: float
    scale: TorqueScale


@dataclass(frozen=True)
class _Columns:
    """What stands where in the columns that the filter estimates side by side, for an arm of so many joints.

    All go through the same gain: the state itself, how it follows errors of the torque constants and of their scale, and how it
    would answer to a step of one kilogram at each instant of late.
    """

    count: int

    measured = 0

    @property
    def shares(self) -> slice:
        """Of each torque constant."""
        return slice(1, 1 + self.count)

    @property
    def scale(self) -> int:
        """Of all torques together."""
        return 1 + self.count

    @property
    def first_step(self) -> int:
        """Of the oldest step that may have been; the others follow."""
        return 2 + self.count


@dataclass(frozen=True)
class _WindowEquations:
    """Equations of one window, E of them: what the state predicts is compared with what was measured."""

    along: FloatArray  # torque per kilogram of the load [N m/kg], shape (E,)
    rows: FloatArray  # torque per unit of the state, shape (E, N)
    # torque beside the calibration's [N m], what shares of the torque constants put on it, what all of the arm's torque does, and
    # what steps that may have been put on it per kg: see `_Columns`, shape (E, 2 + n + onsets)
    measured: FloatArray


class _Filter:
    """A Kalman filter of windows.

    All unknowns are in units of their prior's standard deviation: those of the calibration, the torque that no model has, and of
    the load its mass and three coordinates of its centre.

    Attributes:
        motion_s: Seconds of motion since the load changed, or since the beginning.
    """

    def __init__(self, prior: _ArmPrior, window_s: float) -> None:
        self._prior = prior
        self._window_s = window_s
        self._arm = slice(0, prior.root.shape[1])
        self._other = slice(
            self._arm.stop,
            self._arm.stop + prior.count,
        )
        self._load = slice(
            self._other.stop,
            self._other.stop + 4,
        )
        size = self._load.stop
        self.motion_s = 0.0
        self._covariance = np.eye(size)
        self._time_s = float("nan")
        self._misfit = 1.0
        self._columns = _Columns(prior.count)
        self._state = np.zeros((size, self._columns.first_step))
        self._scale = NOTHING_SEEN
        self._innovation_squares: list[deque[tuple[float, float]]] = [
            deque(maxlen=NOISE_WINDOWS) for _ in range(prior.count)
        ]
        self._begun_s = -np.inf
        self._heavy_kg = 0.0
        self._onsets: list[float] = []
        self._information = np.zeros(0)
        self._along = np.zeros(0)
        self._past: deque[_Past] = deque()

    @property
    def mass_kg(self) -> float:
        return float(self._state[self._load.start, self._columns.measured]) * self._prior.widest_kg

    @property
    def std_kg(self) -> float:
        """Of the mass; more where windows do not fit."""
        mass = self._load.start
        variance = self._covariance[mass, mass] * max(self._misfit, 1.0)
        return float(np.sqrt(variance)) * self._prior.widest_kg

    @property
    def covariance_with_scale(self) -> float:
        """Of the mass with the relative scale of all torques [kg]."""
        mass = self._load.start
        along = self._covariance[mass, self._arm] @ self._prior.with_scale
        return float(along) * self._prior.widest_kg

    @property
    def by_share(self) -> FloatArray:
        """What each torque constant puts on the mass that is off by `LEAST_TORQUE_STD` [kg], shape (n,)."""
        return self._state[self._load.start, self._columns.shares] * self._prior.widest_kg

    @property
    def scale(self) -> TorqueScale:
        """By how much all torques are read larger than the calibration's, as far as motion shows it."""
        return self._scale

    @property
    def by_scale(self) -> float:
        """What the mass is too large by per part that all torques are [kg]."""
        arm = float(self._state[self._load.start, self._columns.scale])
        return arm * self._prior.widest_kg + self.mass_kg

    def step(self, window: _Window) -> None:
        """Go on by one window."""
        start_s = window.start_s
        hop_s = 0.5 * self._window_s
        first_step = self._columns.first_step
        before = self._state[:, :first_step]
        self._past.append(
            _Past(
                window,
                before,
                self._covariance,
                self._time_s,
                self._misfit,
                self._scale,
            ),
        )
        while len(self._past) * hop_s > LATEST_STEP_S:
            self._past.popleft()
            self._onsets = self._onsets[1:]
            self._state = np.delete(self._state, first_step, axis=1)
            self._information = self._information[1:]
            self._along = self._along[1:]
        self._pass(start_s, hop_s)
        self._onsets.append(start_s + hop_s)
        new_step = np.zeros(len(self._state))
        self._state = np.column_stack([self._state, new_step])
        self._information = np.append(self._information, 0.0)
        self._along = np.append(self._along, 0.0)
        self._update(window)
        self.motion_s += hop_s

    def _pass(self, start_s: float, hop_s: float) -> None:
        """What is forgotten from window to window."""
        late_s = hop_s if np.isnan(self._time_s) else start_s - self._time_s
        keeps = np.ones(len(self._state))
        keeps[self._arm] = np.exp(-hop_s / MEMORY_S)
        keeps[self._other] = np.exp(-late_s / self._prior.tau_s)
        self._state = self._state * keeps[:, None]
        fading = keeps.copy()
        fading[self._load] = np.exp(0.5 * hop_s / MEMORY_S)
        covariance = self._covariance * fading[:, None] * fading
        fades = np.arange(self._load.start)
        covariance[fades, fades] += 1.0 - keeps[fades] ** 2
        self._covariance = covariance
        self._time_s = start_s

    def _update(self, made: _Window) -> None:
        """What the window says of the state, and how likely each step that may have been makes it."""
        window = made.rows
        equations = self._equations(window)
        innovation = equations.measured - equations.rows @ self._state
        spread = self._covariance @ equations.rows.T
        expected = equations.rows @ spread
        for covariance in self._of_model(made, equations.along):
            expected += covariance
        noise = np.diag([self._noise(number) for number in window.joint])
        inverse = np.linalg.inv(expected + noise)
        inverse = 0.5 * (inverse + inverse.T)
        gain = spread @ inverse
        self._state = self._state + gain @ innovation
        self._covariance = self._covariance - gain @ spread.T
        measured = innovation[:, self._columns.measured]
        weighted = inverse @ measured
        by_scale = innovation[:, self._columns.scale]
        keeps = np.exp(-0.5 * self._window_s / MEMORY_S)
        of_window = TorqueScale(float(by_scale @ weighted), float(by_scale @ inverse @ by_scale))
        self._scale = self._scale.plus(of_window, keeps)
        steps = innovation[:, self._columns.first_step :]
        self._along = self._along + steps.T @ weighted
        self._information = self._information + np.einsum("ij,ik,kj->j", steps, inverse, steps)
        keeps = np.exp(-0.5 * self._window_s / MISFIT_S)
        misfit = float(measured @ weighted)
        self._misfit = keeps * self._misfit + (1.0 - keeps) * misfit / len(window.joint)
        for row, number in enumerate(window.joint):
            square = float(measured[row]) ** 2
            self._innovation_squares[number].append((square, float(expected[row, row])))

    def _equations(self, window: Rows) -> _WindowEquations:
        """What a window says, by what is held and by how gears and motors lose torque under it."""
        prior = self._prior
        mass_kg = self.mass_kg or self._heavy_kg
        along = window.payload @ prior.point
        design = window.design.copy()
        fill_drives(
            design,
            prior.values,
            window,
            ArmTerms(prior.count),
            mass_kg * along,
        )
        heavy = max(abs(mass_kg), LEAST_HEAVY_KG) * prior.centre_std_m
        rows = np.hstack(
            [
                design @ prior.root,
                np.eye(prior.count)[window.joint] * prior.noise,
                along[:, None] * prior.widest_kg,
                window.payload[:, 1:4] * heavy,
            ]
        )
        off = window.torque - design @ prior.values
        before = self._before_onsets(float(window.start_s[0]))
        steps = along[:, None] * (1.0 - before)
        own = design @ prior.values
        measured = np.hstack([off[:, None], design @ prior.by_share, own[:, None], steps])
        return _WindowEquations(along, rows, measured)

    def _before_onsets(self, start_s: float) -> FloatArray:
        """How much of a window's weight lies before each step that may have been: the integral of its test function."""
        since_s = np.array(self._onsets) - start_s
        x = np.clip(
            2.0 * since_s / self._window_s - 1.0,
            -1.0,
            1.0,
        )
        result: FloatArray = 0.5 + 35.0 / 32.0 * (x - x**3 + 0.6 * x**5 - x**7 / 7.0)
        return result

    def _of_model(self, made: _Window, along: FloatArray) -> Iterator[FloatArray]:
        """What no state knows: noise of accelerations, friction of joints that turn round, where a load was put on; (E, E) each."""
        window = made.rows
        yield made.of_acceleration[np.ix_(window.joint, window.joint)]
        turning = TURNING * self._prior.coulomb[window.joint] * (1.0 - window.direction**2)
        yield np.diag(turning**2)
        if abs(window.start_s[0] - self._begun_s) < 0.25 * self._window_s:
            yield np.diag((ONSET_SHARE * self._heavy_kg * along) ** 2)

    def _noise(self, joint: int) -> float:
        """Variance of a window's mean torque that is its own [N^2 m^2], by the innovations of late."""
        own = self._prior.noise[joint] ** 2
        of_late = self._innovation_squares[joint]
        if len(of_late) < FEWEST_WINDOWS:
            return float(own)
        squares, expected = np.median(np.array(of_late), axis=0)
        # 0.455: the median of a squared normal number
        return float(np.clip(squares / 0.455 - expected, LEAST_NOISE**2 * own, own))

    def onset(self, sigmas: float) -> float | None:
        """When something was picked up or put down since this filter began; None: nothing was."""
        # a window that lies behind it must have been heard
        ready = np.array(self._onsets) <= self._time_s + 1e-6
        ready &= np.array(self._onsets) > self._begun_s + 2.0 * self._window_s
        if not ready.any():
            return None
        information = np.maximum(self._information, 1e-12)
        change_kg = self._along / information
        score = np.where(
            ready,
            np.abs(change_kg) * np.sqrt(information),
            0.0,
        )
        best = int(np.argmax(score))
        least_kg = LEAST_SHARE * abs(self.mass_kg)
        is_step = score[best] > sigmas and abs(change_kg[best]) > least_kg
        return self._onsets[best] if is_step else None

    def after(self, onset_s: float) -> _Filter:
        """The same, with a load of which nothing is known since then."""
        load = self._load
        behind = [
            past for past in self._past if past.window.start_s + self._window_s > onset_s + 1e-6
        ]
        last = behind[0]
        number = self._onsets.index(onset_s)
        change_kg = float(self._along[number] / max(self._information[number], 1e-12))
        held_kg = float(last.state[load.start, self._columns.measured]) * self._prior.widest_kg
        new = _Filter(self._prior, self._window_s)
        new._time_s = last.time_s
        new._misfit = last.misfit
        new._scale = last.scale
        new._begun_s = onset_s
        new._heavy_kg = held_kg + change_kg
        new._state = last.state.copy()
        new._state[load] = 0.0
        new._covariance = last.covariance.copy()
        new._covariance[load] = 0.0
        new._covariance[:, load] = 0.0
        new._covariance[load, load] = np.eye(4)
        new._innovation_squares = [
            deque(of_joint, maxlen=NOISE_WINDOWS) for of_joint in self._innovation_squares
        ]
        for past in behind:
            if past.window.start_s >= onset_s - 1e-6:
                new.step(past.window)
        return new


def inertia_matrix(
    model: ReducedModel,
    position: FloatArray,
    terms: FloatArray,
) -> FloatArray:
    """Of an arm of n joints at a pose.

    ``model``: its geometry; ``position``: [rad], shape (n,); ``terms``: parameters of its bodies and its rotors, shape (11 n,).

    Returns: Shape (n, n) [kg m^2].
    """
    count = len(position)
    bodies = terms[: PARAMETERS * count].reshape(count, PARAMETERS)
    # momentum of each body where one joint after the other turns at 1 rad/s
    motion = kinematics(
        model,
        np.tile(position, (count, 1)),
        np.eye(count),
    )
    result = np.diag(terms[PARAMETERS * count :])
    for body, own in enumerate(bodies):
        joints = carriers(model, body)
        of_body = motion.seen_by(
            body,
            motion.twist[:, body, None],
        )
        along = momentum_along(
            *motion.seen_by(body, motion.axis[:, joints]),
            *of_body,
        )
        result[joints] += np.tensordot(own, along, 1)
    return result


def _interpolated(
    at_s: NDArray[Any],
    times_s: FloatArray,
    values: FloatArray,
) -> FloatArray:
    return np.column_stack([np.interp(at_s, times_s, column) for column in values.T])
