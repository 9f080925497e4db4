"""What a position controller of somebody else's driver is to be sent, so that a sequence's pushes and all beside them come to be.

For servos that know no current: a step of the goal is the push, and a goal where a joint is holds it there. The servo's law is a
soft spring, so an arm hangs below its goals. The goals sent are therefore ahead of those wanted: by what gravity takes, where the
robot file states the law, and by a slow sum of what is missing where joints stand. What was sent is what is recorded.

As `forward_command_controller` does it, such a controller takes goals for all its joints in a fixed order, and keeps the last ones.
So every command here is whole. No clock, no ROS.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from proprio_ros.errors import ExcitationError
from proprio_ros.excitation.commands import Command
from proprio_ros.excitation.controller import Controller
from proprio_ros.excitation.plans import ExcitationSequence
from proprio_ros.robot import Robot
from proprio_ros.robot.drives import PositionServo
from proprio_ros.robot.kinematics import zero_pose
from proprio_ros.robot.loads import Loads

SUM_S = 0.4  # time in which the slow sum gives as much as is missing
SLACK_RAD = 0.02
"""Nothing is summed up so near to where a joint should be: friction would have it hunt, and it must be still before a push."""
LARGEST_SUM_RAD = 0.5
REST_S = 0.1  # goals that have rested for so long are those of a joint that should stand
STILL_RAD_S = 0.1  # nothing is summed up beyond this speed: the joint is on its way
GAP_S = 0.1  # after a longer pause nothing is summed up over it


class GoalController(Controller):
    """One controller's goals.

    Args:
        robot: The arm.
        joints: The controller's joints, in its order. Joints of the robot that are not among them are held by others.
        jump_rad: A position that changes by more from sample to sample is an encoder that slipped.

    Raises:
        ConfigurationError: No joint, or a joint that the robot does not drive or that is named twice.
    """

    kind = "position"
    recorded_as = "position"
    """Field in which whoever records hears what is sent."""
    can_let_go = False
    """Whether a last command lets go of the arm."""
    let_go = "no more goals are sent: the servos hold the arm at the last ones until their driver turns torque off"

    def __init__(self, robot: Robot, joints: Sequence[str], jump_rad: float = 0.3) -> None:
        super().__init__(robot, joints)
        self.lost = ""  # servos hold by themselves: nobody can lose them here
        self._limits = {name: (robot.model.joint(name).lower, robot.model.joint(name).upper) for name in joints}
        self._per_rad = {name: abs(robot.drive_trains[name].transmission) for name in joints}
        self._jump_rad = jump_rad
        self._stiffness, self._farthest = _springs(robot, self.joints)
        self._loads = Loads(robot)
        self._pose = zero_pose(robot)
        self._position: dict[str, float] = {}
        self._time_s: dict[str, float] = {}
        self._wanted: dict[str, float] = {}
        self._stepped: dict[str, float] = {}
        self._sum = dict.fromkeys(self.joints, 0.0)
        self._lean = dict.fromkeys(self.joints, 0.0)
        self._rests_since_s = math.inf
        self._sent: dict[str, float] = {}

    @property
    def record(self) -> dict[str, float]:
        """What a recording says of it: the goals that were sent last; nothing where somebody else may send others."""
        return dict(self._sent) if self.holding else {}

    def check(self, sequence: ExcitationSequence) -> None:
        """Whether this controller can make a sequence now.

        Raises:
            ExcitationError: It wants a current, or moves a joint of somebody else's.
        """
        if not all(run.goal_step for run in sequence.runs):
            raise ExcitationError(
                f"{sequence.name} pushes with currents, which a position controller does not take: choose a sequence whose runs "
                "state goal_step"
            )
        self.check_joints(sequence)

    def begin(self) -> None:
        """A sequence begins: hold all joints where they are, if they are not held yet."""
        self._stepped = {}
        if not self.holding:
            self._sum = dict.fromkeys(self.joints, 0.0)
            self.take_here()
        self.holding = True

    def take(self, command: Command) -> None:
        """What the state machine wants; the next `commands` say it."""
        if self.holding:
            self._stepped = {name: goal for name, goal in command.stepped.items() if name in self.joints}
            self._want(command.position)

    def take_here(self) -> None:
        """Hold all joints where they read now: after an encoder slipped, older positions are other places."""
        self._stepped = {}
        self._want(self._position)

    def observe(self, time_s: float, position: Mapping[str, float], heard_s: float | None = None) -> None:
        """Take a reading.

        Args:
            time_s: When it was taken [s].
            position: By joint [rad or m]; what is no number is passed over.
            heard_s: When it came; not needed here.
        """
        for name, value in position.items():
            if not math.isfinite(value) or name not in self._pose:
                continue
            self._pose[name] = value
            if name not in self._sum:
                continue
            step_s = time_s - self._time_s.get(name, time_s)
            moved = abs(value - self._position.get(name, value))
            if moved > self._jump_rad * self._per_rad[name] and name in self._wanted:
                # the arm is where it was: only what it reads has changed
                self._wanted[name] += value - self._position[name]
            self._position[name], self._time_s[name] = value, time_s
            if 0.0 < step_s <= GAP_S and moved <= STILL_RAD_S * self._per_rad[name] * step_s:
                self._sum_up(name, time_s, step_s)

    def commands(self) -> list[float]:
        """A goal for each joint, in the controller's order [rad or m]."""
        self._sent = {name: self._goal(name) for name in self.joints}
        return list(self._sent.values())

    def last_words(self) -> list[float]:
        """What holds the arm without anybody who looks: a joint that is pushed, where it was seen last."""
        return [self._goal(name, pushed=False) for name in self.joints]

    def steady(self) -> list[float]:
        """The same; nothing is pushed any more."""
        self._want({name: self._position[name] for name in self._stepped})
        self._stepped = {}
        return self.commands()

    def release(self) -> list[float]:
        """Send no more; the last goals hold."""
        last = self.steady()
        self.holding = False
        return last

    def _want(self, goals: Mapping[str, float]) -> None:
        wanted = {**self._wanted, **{name: q for name, q in goals.items() if name in self.joints and math.isfinite(q)}}
        if wanted == self._wanted:
            return
        self._wanted = wanted
        self._rests_since_s = max(self._time_s.values(), default=math.inf)
        gravity = self._loads.at({**self._pose, **wanted}).gravity
        for name, stiffness in self._stiffness.items():
            lean = gravity[name] / stiffness
            self._lean[name] = math.copysign(min(abs(lean), self._farthest[name]), lean)

    def _sum_up(self, name: str, time_s: float, step_s: float) -> None:
        """Where all should stand and this joint does, but elsewhere, something hangs at it."""
        if not self.holding or self._stepped or time_s - self._rests_since_s < REST_S or name not in self._wanted:
            return
        off = self._wanted[name] - self._position[name]
        if abs(off) > SLACK_RAD * self._per_rad[name]:
            most = LARGEST_SUM_RAD * self._per_rad[name]
            self._sum[name] = max(-most, min(most, self._sum[name] + off * step_s / SUM_S))

    def _goal(self, name: str, pushed: bool = True) -> float:
        """Of a joint, ahead of where it is wanted; within its limits, which some controllers refuse to leave."""
        wanted = self._wanted[name]
        if name in self._stepped:
            wanted = self._stepped[name] if pushed else self._position[name]
        low, high = self._limits[name]
        return max(low, min(high, wanted + self._lean[name] + self._sum[name]))


def _springs(robot: Robot, joints: Sequence[str]) -> tuple[dict[str, float], dict[str, float]]:
    """Of joints whose servo's law the robot file states: stiffness [N m/rad], and how far its goal is at the largest duty."""
    stiffness, farthest = {}, {}
    for name in joints:
        drive = robot.drive_trains[name]
        if isinstance(drive.driven_by, PositionServo) and drive.supply_voltage_V > 0.0 and drive.resistance_ohm > 0.0:
            per_duty = drive.nominal_effort_per_current * drive.supply_voltage_V / drive.resistance_ohm
            stiffness[name] = drive.driven_by.gain_per_rad * per_duty
            farthest[name] = drive.driven_by.limit / drive.driven_by.gain_per_rad
    return stiffness, farthest
