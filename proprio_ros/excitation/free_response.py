"""What gravity does to a joint that is let go of while all others are held: known before anything moves, friction left out."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from proprio_ros.errors import ExcitationError
from proprio_ros.robot import Robot

LEAST_MOMENT_N_M = 1e-3  # gravity that pulls less moves no joint
STEP_RAD = 0.02  # between two places of the way that are looked at


@dataclass(frozen=True)
class FreeResponse:
    """A joint as a pendulum: gravity's moment on it is ``moment_N_m sin(rest - position)``.

    Attributes:
        moment_N_m: Largest gravity moment, at the joint.
        rest: Where the joint would hang, within half a turn of where it was asked for [rad].
        inertia_kg_m2: About the joint, of what moves with it, without the rotor.
    """

    moment_N_m: float
    rest: float
    inertia_kg_m2: float

    def moment_at(self, position: float) -> float:
        """Gravity's moment on the joint [N m]."""
        return self.moment_N_m * math.sin(self.rest - position)

    def speed_at(self, position: float, start: float, rotor_kg_m2: float = 0.0) -> float:
        """Speed without friction on the way from a start at rest [rad/s]."""
        fallen = math.cos(self.rest - position) - math.cos(self.rest - start)
        return math.sqrt(max(2.0 * self.moment_N_m * fallen / (self.inertia_kg_m2 + rotor_kg_m2), 0.0))

    def way(self, start: float) -> np.ndarray:
        """Places from a start to where it would swing to without friction, as far beyond the rest [rad]."""
        end = 2.0 * self.rest - start
        return np.linspace(start, end, 2 + math.ceil(abs(end - start) / STEP_RAD))


def free_swing(robot: Robot, joint: str, pose: Mapping[str, float]) -> FreeResponse:
    """The pendulum that a joint is, with an empty hand, where all independent joints are at a pose [rad or m].

    Raises:
        ExcitationError: The joint slides, drives another one too, or gravity does not move it.
    """
    if robot.model.joint(joint).kind == "prismatic":
        raise ExcitationError(f"{joint} slides: only a joint that turns swings freely; give it a current")
    body = robot.model.lock([joint], pose, robot.gravity)
    axis, pseudo = body.axes[0], robot.arm_scale.value * body.pseudo_inertia[0]
    gravity = body.placement[0][:3, :3].T @ body.gravity
    second, first = pseudo[:3, :3], pseudo[:3, 3]
    at_zero = float(axis @ np.cross(first, gravity))
    at_quarter = float(axis @ np.cross(np.cross(axis, first), gravity))
    moment = math.hypot(at_zero, at_quarter)
    if moment < LEAST_MOMENT_N_M:
        raise ExcitationError(f"gravity does not move {joint} here: it cannot swing; choose another joint or start")
    rest = math.atan2(at_zero, -at_quarter)
    rest += 2.0 * math.pi * round((pose[joint] - rest) / (2.0 * math.pi))
    return FreeResponse(moment, rest, float(np.trace(second) - axis @ second @ axis))
