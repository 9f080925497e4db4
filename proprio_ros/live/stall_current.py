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
MOST_GOALS = 1000  # wait for joint states
SET_BACK_S = 1.0  # a clock that jumps back by more was set
# who sends a joint so far in so long moves it; who sends it less holds it, or makes up for a load
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
        self._delay_s = robot.delay.value
        self._volt = math.nan  # as it was heard
        self._moved_s = -math.inf  # when somebody moved the arm last
        # by joint, when it was sent where, from which on motion is counted
        self._from: dict[str, tuple[float, float]] = {}
        self._sent: dict[str, deque[tuple[float, float]]] = {
            name: deque(maxlen=MOST_GOALS)
            for name, drive in self._drives.items()
            if isinstance(drive.driven_by, PositionServo)
        }

    def hear_voltage(self, volt: float) -> None:
        """Of the supply; until it is heard, that of the robot file counts."""
        if 0.0 < volt < math.inf:
            self._volt = volt

    def hear_goals(self, time_s: float, names: Iterable[str], positions: Iterable[float]) -> None:
        """Where joints were sent; after a clock that was set back they begin anew.

        Args:
            time_s: Stamp of the goals [s].
            names: Joints, shape (J,).
            positions: Their goals, shape (J,) [rad].
        """
        for name, goal in zip(names, positions, strict=False):
            if name in self._sent and math.isfinite(goal):
                self._hear_goal(time_s, name, goal)

    def _hear_goal(self, time_s: float, name: str, goal: float) -> None:
        sent = self._sent[name]
        if sent and time_s < sent[-1][0] - SET_BACK_S:
            sent.clear()
            self._moved_s = -math.inf
        since_s, before = self._from.get(name, (-math.inf, goal))
        if abs(goal - before) > FAR_RAD:
            self._moved_s = time_s
        if not 0.0 <= time_s - since_s < WORKS_S or self._moved_s == time_s:
            self._from[name] = (time_s, goal)
        at_s = max(time_s, sent[-1][0] + AT_ONCE_S) if sent else time_s
        sent.append((at_s, goal))

    def works(self, time_s: float) -> bool:
        """Whether somebody moves the arm; where goals stand, what moves it is a load that was put down, and dry friction."""
        return not self._sent or time_s - self._moved_s < WORKS_S

    def current_A(self, name: str, time_s: float, position: float, effort: float) -> float:
        """What flows in a motor.

        Args:
            name: A joint of `joints`.
            time_s: Stamp of its joint state [s].
            position: Where it is [rad].
            effort: As published: the duty cycle of a motor without a law of its own.

        Returns:
            The stall current; NaN where nobody said the joint's goal or its duty cycle [A].
        """
        drive = self._drives[name]
        law = drive.driven_by
        assert law is not None
        goal = None
        if name in self._sent:
            sent = self._sent[name]
            if not sent or time_s - self._delay_s < sent[0][0]:
                return math.nan
            goal = Goal(*np.array(sent).T)
        elif not math.isfinite(effort):
            return math.nan
        (duty,) = law.duty(
            np.array([time_s]), np.array([position]), np.array([effort]), goal, self._delay_s
        )
        if goal is not None and isinstance(law, PositionServo):
            self._forget_before(name, time_s - self._delay_s, goal, law)
        volt = drive.supply_voltage_V if math.isnan(self._volt) else self._volt
        return float(duty) * volt / drive.resistance_ohm

    def _forget_before(self, name: str, at_s: float, goal: Goal, law: PositionServo) -> None:
        """Goals before an instant, but for where the firmware's has come to then, and the one that it goes on to."""
        sent = self._sent[name]
        (reached,) = goal.at(np.array([at_s]), law.goal_speed_rad_s)
        newest = sent[0][1]
        while sent and sent[0][0] <= at_s:
            _, newest = sent.popleft()
        sent.extendleft([(at_s + AT_ONCE_S, newest), (at_s, float(reached))])
