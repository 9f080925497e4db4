"""What an arm at rest asks of its motors: the effort that gravity needs at each joint, and the inertia that each joint turns.

The bodies beyond a joint move with it as one: their pseudo-inertias, added in the base frame, give mass, moment and inertia about
the joint's axis (Featherstone, "Rigid Body Dynamics Algorithms", 2008, composite-rigid-body algorithm, its diagonal).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from proprio_ros.records import FloatArray
from proprio_ros.robot.robot_file import Robot


class Loads:
    """Gravity and inertia by joint, as the URDF has them, with an empty hand.

    Args:
        robot: The arm.
    """

    def __init__(self, robot: Robot) -> None:
        model = robot.model
        index = {model.root: -1} | {joint.child: row for row, joint in enumerate(model.joints)}
        self._joints = model.joints
        self._parents = [index[joint.parent] for joint in model.joints]
        self._driving = [None if joint.kind == "fixed" else model.driving(joint) for joint in model.joints]
        inertias = {link.name: link.pseudo_inertia for link in model.links}
        self._pseudo = [robot.arm_scale.value * inertias[joint.child] for joint in model.joints]
        self._gravity = robot.gravity
        self.joints = model.independent_joints

    def at(self, pose: Mapping[str, float]) -> tuple[dict[str, float], dict[str, float]]:
        """Effort that holds each joint against gravity [N m or N], and the inertia that it moves [kg m^2 or kg].

        A joint that others follow moves them, too. The rotors' inertia is not among it.

        Args:
            pose: Positions of all independent joints [rad or m].
        """
        places: list[FloatArray] = []
        frames: list[FloatArray] = []  # of the joint before it moves
        composite: list[FloatArray] = []
        positions: list[float] = []
        for row, joint in enumerate(self._joints):
            driving = self._driving[row]
            position = 0.0 if driving is None else driving[1] * pose[driving[0]] + driving[2]
            above = places[self._parents[row]] if self._parents[row] >= 0 else np.eye(4)
            place = above @ joint.transform(position)
            places.append(place)
            frames.append(above @ joint.origin)
            composite.append(place @ self._pseudo[row] @ place.T)
            positions.append(position)
        for row in reversed(range(len(self._joints))):
            if self._parents[row] >= 0:
                composite[self._parents[row]] = composite[self._parents[row]] + composite[row]
        effort = dict.fromkeys(self.joints, 0.0)
        inertia = dict.fromkeys(self.joints, 0.0)
        for row, joint in enumerate(self._joints):
            driving = self._driving[row]
            if driving is None:
                continue
            name, multiplier, _ = driving
            axis, point = frames[row][:3, :3] @ joint.axis, frames[row][:3, 3]
            mass, moment, second = composite[row][3, 3], composite[row][:3, 3], composite[row][:3, :3]
            if joint.kind == "prismatic":
                needed, moved = -mass * (axis @ self._gravity), mass
            else:
                needed = -axis @ np.cross(moment - mass * point, self._gravity)
                about = second - np.outer(moment, point) - np.outer(point, moment) + mass * np.outer(point, point)
                moved = np.trace(about) - axis @ about @ axis
            effort[name] += multiplier * float(needed)
            inertia[name] += multiplier**2 * float(moved)
        return effort, inertia
