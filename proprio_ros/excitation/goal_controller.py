"""Pushes and holds an arm by a position controller of somebody else's driver: for servos that know no current.

The servo's law is a soft spring, so an arm hangs below its goals. The goals sent are therefore ahead of those wanted: by what
gravity takes, where the robot file states the law, and by a slow sum of what is missing where joints stand. What that sum says of
a load in the hand goes along from pose to pose. What was sent is what is recorded. No clock, no ROS.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from proprio_ros.errors import ExcitationError
from proprio_ros.excitation.commands import Command
from proprio_ros.excitation.controllers import Controller, Move
from proprio_ros.excitation.plans import ExcitationSequence
from proprio_ros.excitation.springs import springs_of
from proprio_ros.robot import Robot
from proprio_ros.robot.kinematics import zero_pose
from proprio_ros.robot.loads import Loads

if TYPE_CHECKING:
    from typing_extensions import Self

SUM_S = 0.4  # time in which the slow sum gives as much as is missing
SLACK_RAD = 0.02
"""Nothing is summed up so near to where a joint should be: friction would have it hunt, and it must be still before a push."""
LARGEST_SUM_RAD = 0.5
REST_S = 0.1  # goals that have rested for so long are those of a joint that should stand
STILL_RAD_S = 0.1  # nothing is summed up beyond this speed: the joint is on its way
GAP_S = 0.1  # after a longer pause nothing is summed up over it


class GoalController(Controller):
    """Goals: a step of the goal is the push, and a goal where a joint is holds it there.

    Args:
        robot: The arm.
        joints: The controller's joints, in its order.
        jump_rad: A position that changes by more from sample to sample, unless speed explains it, is an encoder that slipped.
    """

    kind = "position"
    about = "a position controller, for servos that know no current"
    commanded = "goals [rad, m]"
    usual_topic = "/position_controller/commands"
    announced = "goals go to {topic}"
    beside = "keep a hand near the servos' supply"
    recorded_as = "position"
    recorded_on = "joint_command"
    let_go = "no more goals are sent: the servos hold the arm at the last ones until their driver turns torque off"

    def __init__(self, robot: Robot, joints: Sequence[str], jump_rad: float = 0.3) -> None:
        super().__init__(robot, joints, jump_rad)
        self._limits = {
            name: (robot.model.joint(name).lower, robot.model.joint(name).upper) for name in joints
        }
        self._springs = springs_of(robot, self.joints)
        self._loads = Loads(robot)
        self._pose = zero_pose(robot)
        self._wanted: dict[str, float] = {}
        self._stepped: dict[str, float] = {}
        self._sum = dict.fromkeys(self.joints, 0.0)
        self._lean = dict.fromkeys(self.joints, 0.0)
        self._held_kg = 0.0
        self._rests_since_s = math.inf
        self._sent: dict[str, float] = {}

    @classmethod
    def of_parameters(cls, robot: Robot, values: Mapping[str, Any]) -> Self:
        return cls(robot, values["controller_joints"], values["max_jump"])

    @property
    def lost(self) -> str:
        """Servos hold by themselves: nobody can lose them here."""
        return ""

    @property
    def record(self) -> dict[str, float]:
        """The goals that were sent last; nothing where somebody else may send others [rad or m]."""
        return dict(self._sent) if self.holding else {}

    @property
    def held_kg(self) -> float:
        return self._held_kg if self.holding else 0.0

    def check(self, sequence: ExcitationSequence) -> None:
        if not all(run.goal_step for run in sequence.runs):
            words = "pushes with currents, which a position controller does not take"
            raise ExcitationError(
                f"{sequence.name} {words}: choose a sequence whose runs state goal_step"
            )
        super().check(sequence)

    def begin(self) -> None:
        self._stepped = {}
        if not self.holding:
            self._sum = dict.fromkeys(self.joints, 0.0)
            self._held_kg = 0.0
            self.take_here()
        self.holding = True

    def take(self, command: Command) -> None:
        if self.holding:
            self._stepped = {
                name: goal for name, goal in command.stepped.items() if name in self.joints
            }
            self._want(command.position)

    def take_here(self) -> None:
        self._stepped = {}
        self._want(self._position)

    def observe(
        self, time_s: float, position: Mapping[str, float], heard_s: float | None = None
    ) -> Mapping[str, Move]:
        """Take a reading; a goal moves along with a joint whose reading has jumped.

        Args:
            time_s: When the reading was taken, on a clock of its own [s].
            position: By joint; what is no number is passed over [rad or m].
            heard_s: When it came; None: when it was taken [s].

        Returns:
            How far joints that were read have moved since their last reading.
        """
        moves = super().observe(time_s, position, heard_s)
        for name, value in position.items():
            if name in self._pose and math.isfinite(value):
                self._pose[name] = value
        for name, move in moves.items():
            per_rad = self._per_rad[name]
            if abs(move.by) > self._jump_rad * per_rad and name in self._wanted:
                # the arm is where it was: only what it reads has changed
                self._wanted[name] += move.by
            stands = abs(move.by) <= STILL_RAD_S * per_rad * move.step_s
            if 0.0 < move.step_s <= GAP_S and stands:
                self._sum_up(name, time_s, move.step_s)
        return moves

    def commands(self) -> list[float]:
        """Goals [rad or m]."""
        self._sent = {name: self._goal(name) for name in self.joints}
        return list(self._sent.values())

    def holding_command(self) -> list[float]:
        """Goals; of a joint that is pushed, where it was seen last [rad or m]."""
        return [self._goal(name, pushed=False) for name in self.joints]

    def steady(self) -> list[float]:
        self._want({name: self._position[name] for name in self._stepped})
        self._stepped = {}
        return self.commands()

    def release(self) -> list[float]:
        """Send no more; the last goals hold."""
        last = self.steady()
        self.holding = False
        return last

    def _want(self, goals: Mapping[str, float]) -> None:
        wanted = dict(self._wanted)
        for name, value in goals.items():
            if name in self.joints and math.isfinite(value):
                wanted[name] = value
        if wanted == self._wanted:
            return
        if self._rested:
            self._attribute_sums()
        self._wanted = wanted
        self._rests_since_s = self._now_s
        gravity = self._loads.at({**self._pose, **wanted}, self._held_kg).gravity
        for name, spring in self._springs.items():
            lean = gravity[name] / spring.stiffness
            self._lean[name] = math.copysign(min(abs(lean), spring.farthest), lean)

    @property
    def _now_s(self) -> float:
        """Of the newest reading [s]."""
        return max(self._time_s.values(), default=math.inf)

    @property
    def _rested(self) -> bool:
        """Whether goals have rested for long enough that sums say what hangs at the joints."""
        return self._now_s - self._rests_since_s >= REST_S

    def _attribute_sums(self) -> None:
        """Take what was summed up, as far as a load in the hand explains it, for such a load: elsewhere it has another lever."""
        per_kg = self._loads.at({**self._pose, **self._wanted}).per_kg
        pulls = {name: per_kg[name] / spring.stiffness for name, spring in self._springs.items()}
        squares = sum(pull**2 for pull in pulls.values())
        if squares <= 0.0:
            return
        more_kg = sum(pull * self._sum[name] for name, pull in pulls.items()) / squares
        more_kg = max(more_kg, -self._held_kg)
        self._held_kg += more_kg
        for name, pull in pulls.items():
            self._sum[name] -= more_kg * pull

    def _sum_up(self, name: str, time_s: float, step_s: float) -> None:
        """Where all should stand and this joint does, but elsewhere, something hangs at it."""
        if (
            not self.holding
            or self._stepped
            or time_s - self._rests_since_s < REST_S
            or name not in self._wanted
        ):
            return
        off = self._wanted[name] - self._position[name]
        if abs(off) > SLACK_RAD * self._per_rad[name]:
            most = LARGEST_SUM_RAD * self._per_rad[name]
            more = self._sum[name] + off * step_s / SUM_S
            self._sum[name] = max(-most, min(most, more))

    def _goal(self, name: str, pushed: bool = True) -> float:
        """Of a joint, ahead of where it is wanted; within its limits, which some controllers refuse to leave."""
        wanted = self._wanted[name]
        if name in self._stepped:
            wanted = self._stepped[name] if pushed else self._position[name]
        low, high = self._limits[name]
        ahead = wanted + self._lean[name] + self._sum[name]
        return max(low, min(high, ahead))
