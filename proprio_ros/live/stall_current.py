"""The stall current of motors that a voltage drives, joint state by joint state; `recordings.voltage` has it of whole bags."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable

import numpy as np

from proprio_ros.robot import Robot
from proprio_ros.robot.drives import Goal, PositionServo

# for so long a firmware's goal is where it has come to; then it goes on to the one that was sent
AT_ONCE_S = 1e-6
# So many goals wait for joint states; a clock that jumps back by more was set.
MOST_GOALS = 1000
SET_BACK_S = 1.0
# Who sends a joint so far in so long moves it; who sends it less holds it, or makes up for a load.
FAR_RAD = 0.1
WORKS_S = 0.5


class StallCurrents:
    """Goals and supply voltage as they come, and what flows by them.

    Attributes:
        joints: Those whose motors a voltage drives.
    """

    def __init__(self, robot: Robot) -> None:
        self._drives = {
            name: drive for name, drive in robot.drive_trains.items() if drive.driven_by is not None
        }
        self.joints = frozenset(self._drives)
        self._delay_s, self._volt, self._moved_s = robot.delay.value, math.nan, -math.inf
        self._from: dict[str, tuple[float, float]] = {}
        self._sent: dict[str, deque[tuple[float, float]]] = {
            name: deque(maxlen=MOST_GOALS)
            for name, drive in self._drives.items()
            if isinstance(drive.driven_by, PositionServo)
        }

    def hear_voltage(self, volt: float) -> None:
        """Of the supply; until it is heard, that of the robot file counts."""
        self._volt = volt if 0.0 < volt < math.inf else self._volt

    def hear_goals(
        self,
        time_s: float,
        names: Iterable[str],
        positions: Iterable[float],
    ) -> None:
        """Where joints were sent [rad]; after a clock that was set back they begin anew."""
        for name, goal in zip(names, positions, strict=False):
            if (sent := self._sent.get(name)) is not None and math.isfinite(goal):
                if sent and time_s < sent[-1][0] - SET_BACK_S:
                    sent.clear()
                    self._moved_s = -math.inf
                since_s, at = self._from.get(name, (-math.inf, goal))
                if abs(goal - at) > FAR_RAD:
                    self._moved_s = time_s
                if not 0.0 <= time_s - since_s < WORKS_S or self._moved_s == time_s:
                    self._from[name] = time_s, goal
                sent.append((max(time_s, sent[-1][0] + AT_ONCE_S) if sent else time_s, goal))

    def works(self, time_s: float) -> bool:
        """Whether somebody moves the arm; where goals stand, what moves it is a load that was put down, and dry friction."""
        return not self._sent or time_s - self._moved_s < WORKS_S

    def current_A(
        self,
        name: str,
        time_s: float,
        position: float,
        effort: float,
    ) -> float:
        """Of a joint, where it is [rad] and with the effort as published; NaN where nobody said its goal or its duty cycle."""
        drive = self._drives[name]
        sent = self._sent.get(name)
        at_s = time_s - self._delay_s
        law = drive.driven_by
        goal = None
        assert law is not None
        if (not sent or at_s < sent[0][0]) if sent is not None else not math.isfinite(effort):
            return math.nan
        if sent:
            goal = Goal(*np.array(sent).T)
        (duty,) = law.duty(
            np.array([time_s]), np.array([position]), np.array([effort]), goal, self._delay_s
        )
        if sent and goal is not None and isinstance(law, PositionServo):
            (reached,), newest = (
                goal.at(
                    np.array([at_s]),
                    law.goal_speed_rad_s,
                ),
                sent[0][1],
            )
            while sent and sent[0][0] <= at_s:
                _, newest = sent.popleft()
            sent.extendleft([(at_s + AT_ONCE_S, newest), (at_s, float(reached))])
        volt = drive.supply_voltage_V if math.isnan(self._volt) else self._volt
        return float(duty) * volt / drive.resistance_ohm
