"""Pushes that are no currents: how a run with one is checked, commanded and named.

`ExcitationMachine` itself knows currents and free responses. Another kind of push is a field of `plans.ExcitationRun`, a class like
`GoalStep` here, and a field of `Command` for what it commands.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from proprio_ros.errors import ExcitationError
from proprio_ros.excitation.commands import Command
from proprio_ros.excitation.guards import Guards
from proprio_ros.excitation.plans import ExcitationRun, ExcitationSequence
from proprio_ros.excitation.ways import Ways


@dataclass(frozen=True)
class GoalStep:
    """A run's push by a step of its joint's goal, for servos that take goals alone."""

    run: ExcitationRun

    less = "use a smaller goal_step, less time, or another start"  # where it goes too far
    more = "a larger goal_step"  # where it moves too little

    def check(
        self,
        start: Mapping[str, float],
        sequence: ExcitationSequence,
        ways: Ways,
        guards: Guards,
        words: str,
    ) -> None:
        """Whether the push is safe, as far as that can be computed before anything moves.

        Args:
            start: Pose of all driven joints before it [rad or m].
            sequence: States the clearance.
            ways: Of the arm.
            guards: Limits of motion.
            words: The run, as messages name it.

        Raises:
            ExcitationError: A servo that goes all the way to its goal leaves its limits, or comes too near to the table.
        """
        joint = self.run.joint
        low, high = ways.limits(joint, guards.limit_margin_rad)
        goal = start[joint] + self.run.goal_step
        if not low <= goal <= high:
            limits = f"{low:.3g} .. {high:.3g} (limits less a margin)"
            remedy = "use a smaller goal_step, or another start"
            raise ExcitationError(
                f"{words}: its goal would be {goal:.3g}, outside {limits}; {remedy}"
            )
        if not ways.clear((start, {**start, joint: goal}), sequence.min_clearance_m):
            near = "on the way to its goal the arm would come too near to the base's plane"
            raise ExcitationError(f"{words}: {near}; choose a higher pose")

    def named(self, unit: str) -> str:
        """What is done to the joint, whose position is in ``unit``."""
        return f"is pushed by a goal {self.run.goal_step:+.3g} {unit} away"

    def command(self, held: dict[str, float], goal: float) -> Command:
        """While the push is on.

        Args:
            held: Goals of the other joints [rad or m].
            goal: Where the run's joint was held [rad or m].
        """
        return Command(held, stepped={self.run.joint: goal + self.run.goal_step})


def push_of(run: ExcitationRun) -> GoalStep | None:
    """The push of a run; None where a current pushes, or nothing."""
    return GoalStep(run) if run.goal_step else None
