"""What an arm at rest asks of its motors: the effort that gravity needs at each joint, and the inertia that each joint turns.

The bodies beyond a joint move with it as one: their pseudo-inertias, added in the base frame, give mass, moment and inertia about
the joint's axis (Featherstone, "Rigid Body Dynamics Algorithms", 2008, composite-rigid-body algorithm, its diagonal).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from proprio_ros.robot.geometry import FloatArray, motion
from proprio_ros.robot.robot_file import Robot


class Loads:
    """Gravity and inertia by joint, as the URDF has them, with an empty hand.

    Args:
        robot: The arm.
    """

    def __init__(self, robot: Robot) -> None:
        model = robot.model
        inertias = {link.name: robot.arm_scale.value * link.pseudo_inertia for link in model.links}
        self.joints = model.independent_joints
        self._gravity = robot.gravity.tolist()
        # one body for each joint that moves, with all that is fixed to it
        self._kinds: list[str] = []
        self._axes: list[FloatArray] = []
        self._driving: list[tuple[str, float, float]] = []
        self._parents: list[int] = []
        self._placement: list[FloatArray] = []
        self._pseudo: list[FloatArray] = []
        frames = {model.root: (-1, np.eye(4))}
        for joint in model.joints:
            body, place = frames[joint.parent]
            place = place @ joint.origin
            if joint.kind != "fixed":
                self._parents.append(body)
                self._placement.append(place)
                self._kinds.append(joint.kind)
                self._axes.append(joint.axis)
                self._driving.append(model.driving(joint))
                self._pseudo.append(np.zeros((4, 4)))
                body, place = len(self._pseudo) - 1, np.eye(4)
            frames[joint.child] = body, place
            if body >= 0:
                self._pseudo[body] = self._pseudo[body] + place @ inertias[joint.child] @ place.T

    def at(self, pose: Mapping[str, float]) -> tuple[dict[str, float], dict[str, float]]:
        """Effort that holds each joint against gravity [N m or N], and the inertia that it moves [kg m^2 or kg].

        A joint that others follow moves them, too. The rotors' inertia is not among it.

        Args:
            pose: Positions of all independent joints [rad or m].
        """
        frames: list[FloatArray] = []  # of each joint before it moves
        places: list[FloatArray] = []
        beyond: list[FloatArray] = []
        for row, (name, multiplier, offset) in enumerate(self._driving):
            parent = self._parents[row]
            frame = places[parent] @ self._placement[row] if parent >= 0 else self._placement[row]
            place = frame @ motion(self._kinds[row], self._axes[row], multiplier * pose[name] + offset)
            frames.append(frame)
            places.append(place)
            beyond.append(place @ self._pseudo[row] @ place.T)
        for row in range(len(frames) - 1, 0, -1):
            if self._parents[row] >= 0:
                beyond[self._parents[row]] = beyond[self._parents[row]] + beyond[row]
        effort = dict.fromkeys(self.joints, 0.0)
        inertia = dict.fromkeys(self.joints, 0.0)
        gx, gy, gz = self._gravity
        for row, (name, multiplier, _) in enumerate(self._driving):
            axis = frames[row][:3, :3] @ self._axes[row]
            ax, ay, az = axis.tolist()
            px, py, pz = frames[row][:3, 3].tolist()
            mx, my, mz, mass = beyond[row][:, 3].tolist()
            if self._kinds[row] == "prismatic":
                needed, moved = -mass * (ax * gx + ay * gy + az * gz), mass
            else:
                # moment about the joint, times gravity x axis: the triple product
                needed = -(
                    (mx - mass * px) * (gy * az - gz * ay)
                    + (my - mass * py) * (gz * ax - gx * az)
                    + (mz - mass * pz) * (gx * ay - gy * ax)
                )
                second = beyond[row][:3, :3]
                along_p, along_m = ax * px + ay * py + az * pz, ax * mx + ay * my + az * mz
                about_point = (
                    float(np.trace(second)) - 2.0 * (px * mx + py * my + pz * mz) + mass * (px * px + py * py + pz * pz)
                )
                moved = about_point - (float(axis @ second @ axis) - 2.0 * along_p * along_m + mass * along_p**2)
            effort[name] += multiplier * needed
            inertia[name] += multiplier**2 * moved
        return effort, inertia
