"""What an arm asks of its motors: against gravity, to turn a joint, and to hold it while another moves.

The bodies beyond a joint move with it as one (Featherstone, "Rigid Body Dynamics Algorithms", 2008, composite-rigid-body
algorithm). With P their pseudo-inertias, added in the base frame, and S the joint's motion as a 4 x 4 matrix, a speed v and an
acceleration a accelerate each of their points x by ``(S a + S S v^2) x``; another joint, with motion S', feels
``trace(S' P (S a + S S v^2)^T)``, P now of what is beyond both.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from proprio_ros.robot.geometry import FloatArray, motion
from proprio_ros.robot.links import Joint
from proprio_ros.robot.robot_file import Robot


class Load(NamedTuple):
    """By joint."""

    gravity: dict[str, float]  # effort that holds it [N m or N]
    inertia: dict[str, float]  # what it moves, without rotors [kg m^2 or kg]
    # of each joint that moves: what the others need then to stand, for its acceleration and for its speed squared
    reactions: dict[str, dict[str, tuple[float, float]]]
    # effort that holds a point mass of 1 kg in the payload frame [N m/kg or N/kg]
    per_kg: dict[str, float]


class Loads:
    """Gravity and inertia by joint, as the URDF has them, with an empty hand or a point mass in it."""

    def __init__(self, robot: Robot) -> None:
        model = robot.model
        scale = robot.arm_scale.value
        inertias = {link.name: scale * link.pseudo_inertia for link in model.links}
        self.joints = model.independent_joints
        self._gravity = robot.gravity
        # one body for each joint that moves, with all that is fixed to it: the joint, its parent body and place there
        self._bodies: list[tuple[Joint, int, FloatArray]] = []
        self._driving: list[tuple[str, float, float]] = []
        self._pseudo: list[FloatArray] = []
        frames = {model.root: (-1, np.eye(4))}
        for joint in model.joints:
            body, place = frames[joint.parent]
            place = place @ joint.origin
            if joint.kind != "fixed":
                self._bodies.append((joint, body, place))
                self._driving.append(model.driving(joint))
                self._pseudo.append(np.zeros((4, 4)))
                body = len(self._pseudo) - 1
                place = np.eye(4)
            frames[joint.child] = body, place
            if body >= 0:
                own = inertias[joint.child]
                self._pseudo[body] = self._pseudo[body] + place @ own @ place.T
        body, place = frames.get(
            robot.payload_frame,
            (-1, np.eye(4)),
        )
        self._hand = body
        self._held_at = place[:, 3]

    def at(
        self,
        pose: Mapping[str, float],
        held_kg: float = 0.0,
    ) -> Load:
        """Efforts and inertias in a pose of all independent joints [rad or m]. A joint that others follow moves them, too."""
        places, moving = self._placed(pose)
        parents = [parent for _, parent, _ in self._bodies]
        beyond = []
        for place, pseudo in zip(places, self._pseudo, strict=True):
            beyond.append(place @ pseudo @ place.T)
        per_kg = dict.fromkeys(self.joints, 0.0)
        if self._hand >= 0:
            held = places[self._hand] @ self._held_at
            point = held_kg * np.outer(held, held)
            beyond[self._hand] = beyond[self._hand] + point
            for row in _chain(parents, self._hand):
                name = self._driving[row][0]
                velocity = moving[row] @ held
                per_kg[name] -= float(self._gravity @ velocity[:3])
        for row in range(len(places) - 1, 0, -1):
            before = parents[row]
            if before >= 0:
                beyond[before] = beyond[before] + beyond[row]
        load = Load(
            dict.fromkeys(self.joints, 0.0),
            dict.fromkeys(self.joints, 0.0),
            {name: {} for name in self.joints},
            per_kg,
        )
        for row, (name, _, _) in enumerate(self._driving):
            momentum = moving[row] @ beyond[row]
            load.gravity[name] -= float(self._gravity @ momentum[:3, 3])
            load.inertia[name] += float(np.sum(momentum * moving[row]))
            # each of the two moves what is beyond both
            for before in _chain(parents, parents[row]):
                of_before = moving[before] @ beyond[row]
                self._react(
                    load,
                    before,
                    row,
                    momentum,
                    moving[before],
                )
                self._react(
                    load,
                    row,
                    before,
                    of_before,
                    moving[row],
                )
        return load

    def _placed(self, pose: Mapping[str, float]) -> tuple[list[FloatArray], list[FloatArray]]:
        """Of each body its place, and the velocity of the points beyond as a matrix on their coordinates, (4, 4) each."""
        places: list[FloatArray] = []
        moving: list[FloatArray] = []
        for row, (joint, parent, frame) in enumerate(self._bodies):
            name, multiplier, offset = self._driving[row]
            frame = places[parent] @ frame if parent >= 0 else frame
            position = multiplier * pose[name] + offset
            moved = motion(
                joint.kind,
                joint.axis,
                position,
            )
            velocity = _velocity(
                joint.kind,
                frame,
                joint.axis,
            )
            places.append(frame @ moved)
            moving.append(multiplier * velocity)
        return places, moving

    def _react(
        self,
        load: Load,
        moved: int,
        other: int,
        momentum: FloatArray,
        moving: FloatArray,
    ) -> None:
        """Add what one joint feels of another that moves: both move the momentum."""
        name = self._driving[moved][0]
        feels = self._driving[other][0]
        if name == feels:
            load.inertia[name] += float(np.sum(momentum * moving))
            return
        by_acceleration, by_speed = load.reactions[name].get(feels, (0.0, 0.0))
        by_acceleration += float(np.sum(momentum * moving))
        by_speed += float(np.sum(momentum * (moving @ moving)))
        load.reactions[name][feels] = (by_acceleration, by_speed)


def _chain(parents: Sequence[int], row: int) -> Iterator[int]:
    """A body and those before it, up to the base."""
    while row >= 0:
        yield row
        row = parents[row]


def _velocity(kind: str, frame: FloatArray, axis: FloatArray) -> FloatArray:
    """Of points fixed beyond a joint, per unit of its speed, as a matrix on their coordinates in the base frame, shape (4, 4)."""
    x, y, z = (frame[:3, :3] @ axis).tolist()
    velocity = np.zeros((4, 4))
    if kind == "prismatic":
        velocity[:3, 3] = (x, y, z)
    else:
        velocity[:3, :3] = [
            [0.0, -z, y],
            [z, 0.0, -x],
            [-y, x, 0.0],
        ]
        velocity[:3, 3] = -velocity[:3, :3] @ frame[:3, 3]
    return velocity
