"""When efforts come into effect, as the joints show it, and what they leave unexplained: for a hold by efforts that come late.

Efforts, integrated twice, are compared with positions by second differences over `WINDOW_S`, which weigh both alike: no velocity,
no filter. The lag at which efforts resemble the inertial efforts of the joints most is the delay. What they leave there is what
hangs at a joint, or rubs (a disturbance observer: Ohnishi, "A new servo method in mechatronics", 1987), and with both, positions
can be carried on to where an effort that is sent now begins to work (Smith, "Closer control of loops with dead time", 1957). No
clock, no ROS.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from proprio_ros.robot.geometry import FloatArray

WINDOW_S = 0.03  # a position that is read to 1.5 mrad is an acceleration to 2 rad/s^2 then
LAG_STEP_S = 0.004
LAGS_S = np.arange(0.0, 0.122, LAG_STEP_S)
LONGEST_S = 0.08  # is assumed until the joints have shown the delay
KEPT = 512
LONG_AGO_S = -1e9  # commands and positions; before the first one
GAP_S = 0.075  # across a longer one positions say nothing of accelerations
# what changes more slowly than this is no effect of an effort: it rubs, or hangs there
SLOW_S = 0.3
REMEMBERED_S = 1.0  # a stall in mid-nudge is soon forgotten
ASKED_RAD_S2 = 2.0  # efforts that ask for less say nothing beside an encoder's noise
# nor do accelerations whose root mean square over a second, with zero beyond, is less
LEAST_RAD_S2 = 2.2
# least squared correlation of efforts and accelerations; at the right lag, nudges had 0.8 to 0.99
SURE = 0.75
NUDGE_S = 0.05
NUDGE_REST_S = 0.12
NUDGES = 8
NUDGE_RAD_S2 = 5.0
NUDGE_RAISED = 1.5
NUDGED_RAD = 0.01  # a joint that moves so far is nudged no harder


class Nudge:
    """Short jerks to and fro of one joint, by which an arm that stands shows the delay: begun with little, raised till it moves."""

    def __init__(self) -> None:
        self._begun_s: float | None = None
        self._made = 0
        self._raised = 0
        self._from_rad = 0.0
        self._moved_rad = 0.0

    @property
    def over(self) -> bool:
        """Whether all were made."""
        return self._made >= NUDGES

    def at(self, now_s: float, position_rad: float) -> float:
        """Acceleration now, of a joint that is there [rad/s^2]."""
        if self._begun_s is None:
            self._begun_s = now_s + NUDGE_REST_S
            self._from_rad = position_rad
        elapsed_s = now_s - self._begun_s
        self._moved_rad = max(self._moved_rad, abs(position_rad - self._from_rad))
        if elapsed_s >= 2.0 * NUDGE_S + NUDGE_REST_S:
            self._made += 1
            self._begun_s = now_s
            elapsed_s = 0.0
            if self._moved_rad < NUDGED_RAD:
                self._raised += 1
            self._from_rad = position_rad
            self._moved_rad = 0.0
        if self.over or not 0.0 <= elapsed_s < 2.0 * NUDGE_S:
            return 0.0
        first = 1.0 if elapsed_s < NUDGE_S else -1.0
        return first * (-1.0) ** self._made * NUDGE_RAD_S2 * NUDGE_RAISED**self._raised


class Delay:
    """Of one arm's efforts; those that balance gravity are none of them.

    Attributes:
        delay_s: Between an effort and its effect [s]; None while the joints have not shown it.
    """

    def __init__(self, joints: int) -> None:
        self.delay_s: float | None = None
        self._joints = joints
        self._restart()
        self._slow_effort = np.zeros((len(LAGS_S), joints))
        self._slow_inertial = np.zeros(joints)
        # over time, for each lag: effort by effort (x x), effort by acceleration (x y), acceleration by acceleration (y y)
        self._xx = np.zeros(len(LAGS_S))
        self._xy = np.zeros(len(LAGS_S))
        self._yy = 0.0

    def _restart(self) -> None:
        self._sent_s = np.full(KEPT, LONG_AGO_S)  # in order of time, the newest last
        # effort, its integral, and that one's integral, at that time
        self._sent = np.zeros((KEPT, 3, self._joints))
        self._seen_s = np.full(KEPT, LONG_AGO_S)
        self._seen = np.zeros((KEPT, self._joints))
        self._seen_for_s = 0.0

    def slipped(self) -> None:
        """An encoder has: positions before the next reading are other places."""
        self._seen_for_s = -math.inf

    @property
    def assumed_s(self) -> float:
        """The delay, or the longest that is reckoned with [s]."""
        return LONGEST_S if self.delay_s is None else self.delay_s

    @property
    def last_s(self) -> float:
        """When an effort was last sent [s]."""
        return float(self._sent_s[-1])

    def sent(self, time_s: float, effort: Sequence[float]) -> None:
        """Efforts are commanded from a time on, that of the latest reading [N m or N]."""
        if time_s < self.last_s - GAP_S:  # a clock was set back
            self._restart()
        if time_s <= self.last_s:
            self._sent[-1, 0] = effort
            return
        integrals = self._integrals(np.array([time_s]))[0]  # (2, J)
        self._sent_s[:-1] = self._sent_s[1:]
        self._sent[:-1] = self._sent[1:]
        self._sent_s[-1] = time_s
        self._sent[-1, 0] = effort
        self._sent[-1, 1:] = integrals

    def observe(
        self, time_s: float, position: Sequence[float], inertia: FloatArray
    ) -> tuple[FloatArray, FloatArray] | None:
        """Take a reading.

        Args:
            time_s: Of the reading [s].
            position: Of the joints, shape (J,) [rad or m].
            inertia: Of the joints, shape (J, J) [kg m^2 or kg].

        Returns:
            The inertial efforts of late, and the efforts behind them, weighed alike, shape (J,); None while too little was seen.
        """
        step_s = time_s - self._seen_s[-1]
        if step_s < -GAP_S:
            self._restart()
            return None
        if step_s <= 0.0:
            return None
        self._seen_s[:-1] = self._seen_s[1:]
        self._seen[:-1] = self._seen[1:]
        self._seen_s[-1] = time_s
        self._seen[-1] = position
        if step_s <= GAP_S and self._seen_for_s >= 0.0:
            self._seen_for_s += step_s
        else:
            self._seen_for_s = 0.0
        if self._seen_for_s < 2.0 * WINDOW_S:
            return None
        places_s = time_s - WINDOW_S * np.arange(3)  # (3,)
        columns = [np.interp(places_s, self._seen_s, column) for column in self._seen.T]
        inertial = inertia @ _second_difference(np.stack(columns, axis=1))  # (J,)
        lagged_s = places_s[:, None] - LAGS_S  # (3, L)
        twice = self._integrals(lagged_s.ravel())[:, 1]
        at_places = twice.reshape(3, len(LAGS_S), -1)  # (3, L, J)
        efforts = _second_difference(at_places)  # (L, J)
        self._compare(
            step_s,
            efforts,
            inertial,
            np.diag(inertia),
        )
        return inertial, efforts[round(self.assumed_s / LAG_STEP_S)]

    def coming(self) -> tuple[FloatArray, FloatArray]:
        """What efforts that are under way will have added to momenta when the last one begins to work, and that one's integral."""
        ahead_s = self.assumed_s
        begins_s = self.last_s - ahead_s  # what was sent then begins to work now
        then, now = self._integrals(np.array([self.last_s, begins_s]))  # (2, J) each: once, twice
        return then[0] - now[0], then[1] - now[1] - now[0] * ahead_s

    def _integrals(self, times_s: FloatArray) -> FloatArray:
        """Of the efforts, once and twice, shape (T, 2, J); before the first one there are none."""
        row = np.maximum(self._sent_s.searchsorted(times_s, side="right") - 1, 0)
        since = (times_s - self._sent_s[row])[:, None]
        sent = self._sent[row]
        effort = sent[:, 0]
        once = sent[:, 1]
        twice = sent[:, 2]
        twice += once * since + 0.5 * effort * since**2  # before the first one goes on
        once += effort * since
        return sent[:, 1:]

    def _compare(
        self, step_s: float, efforts: FloatArray, inertial: FloatArray, inertia: FloatArray
    ) -> None:
        """Update the correlation of efforts and accelerations at each lag, and with it the delay.

        Args:
            step_s: Since the last reading [s].
            efforts: By lag and joint, shape (L, J) [N m or N].
            inertial: Inertial efforts, shape (J,) [N m or N].
            inertia: Of the joints, shape (J,) [kg m^2 or kg].
        """
        begun = self._seen_for_s > 2.0 * WINDOW_S + step_s
        slow = min(step_s / SLOW_S, 1.0) if begun else 1.0
        self._slow_effort += slow * (efforts - self._slow_effort)
        self._slow_inertial += slow * (inertial - self._slow_inertial)
        of = np.where(inertia > 0.0, inertia, math.inf)
        x = (efforts - self._slow_effort) / of  # (L, J) accelerations that were asked for
        y = (inertial - self._slow_inertial) / of  # (J,) accelerations that were seen
        asked = np.abs(x).max(axis=0) > ASKED_RAD_S2
        if not asked.any():
            return
        x = x[:, asked]
        y = y[asked]
        kept = math.exp(-step_s / REMEMBERED_S)
        self._xx = kept * self._xx + step_s * np.sum(x * x, axis=1)
        self._xy = kept * self._xy + step_s * np.sum(x * y, axis=1)
        self._yy = kept * self._yy + step_s * float(y @ y)
        if self._yy < LEAST_RAD_S2**2:
            return
        # squared correlation, of lags at which both have the same sign
        alike = np.maximum(self._xy, 0.0) ** 2 / np.maximum(self._xx * self._yy, 1e-12)
        if alike.max() >= SURE:
            self.delay_s = _peak_s(alike)


def _peak_s(alike: FloatArray) -> float:
    """The lag of the best one of `LAGS_S`, by the vertex of a parabola through it and its neighbours [s]."""
    best = int(np.argmax(alike))
    lag_s = float(LAGS_S[best])
    if not 0 < best < len(LAGS_S) - 1:
        return lag_s
    before, at, after = alike[best - 1 : best + 2].tolist()
    bend = before - 2.0 * at + after
    if not bend < 0.0:
        return lag_s
    return lag_s + 0.5 * (before - after) / bend * LAG_STEP_S


def _second_difference(three: FloatArray) -> FloatArray:
    """Of values at three times, the newest first, `WINDOW_S` apart, over that squared."""
    difference: FloatArray = (three[0] - 2.0 * three[1] + three[2]) / WINDOW_S**2
    return difference
