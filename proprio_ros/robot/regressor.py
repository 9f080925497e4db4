"""Momentum of a moving arm and gravity's torques on it, linear in the inertial parameters of its bodies.

Sources: spatial vectors, Featherstone 2008, Rigid Body Dynamics Algorithms, chapter 2; inertial parameters of links and loads,
Atkeson, An & Hollerbach 1986, International Journal of Robotics Research 5(3).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from proprio_ros.robot.geometry import FloatArray, inertia_about_origin
from proprio_ros.robot.tree import ReducedModel

_NEXT = np.array([1, 2, 0])
_LAST = np.array([2, 0, 1])
_ROWS, _COLUMNS = np.triu_indices(3)
_ONCE = np.where(_ROWS == _COLUMNS, 0.5, 1.0)[:, None, None]
# of a body: m [kg], m c [kg m] (3), I [kg m^2] about the body's origin: xx, xy, xz, yy, yz, zz
PARAMETERS = 10


def body_parameters(pseudo_inertia: FloatArray) -> FloatArray:
    """The ten parameters of a body from its pseudo-inertia, shape (4, 4)."""
    upper = inertia_about_origin(pseudo_inertia)[np.triu_indices(3)]
    mass = pseudo_inertia[3, 3]
    first_moment = pseudo_inertia[:3, 3]
    return np.concatenate([[mass], first_moment, upper])


def point_mass(place_m: FloatArray) -> FloatArray:
    """The ten parameters of 1 kg at a place, shape (3,)."""
    pseudo = np.zeros((4, 4))
    pseudo[3] = pseudo[:, 3] = [*place_m, 1.0]
    pseudo[:3, :3] = np.outer(place_m, place_m)
    return body_parameters(pseudo)


def _skew(v: FloatArray) -> FloatArray:
    result = np.zeros((*v.shape[:-1], 3, 3))
    x, y, z = np.moveaxis(v, -1, 0)
    result[..., 0, 1] = -z
    result[..., 1, 0] = z
    result[..., 0, 2] = y
    result[..., 2, 0] = -y
    result[..., 1, 2] = -x
    result[..., 2, 1] = x
    return result


def cross_product(a: FloatArray, b: FloatArray) -> FloatArray:
    """Of vectors whose components come first, shape (3, ...)."""
    return a[_NEXT] * b[_LAST] - a[_LAST] * b[_NEXT]


@dataclass(frozen=True)
class Kinematics:
    """Where the n bodies of an arm are, and how they move, at T samples; all in the base frame about its origin.

    Components come first and samples last: a product of small matrices for each sample takes several times as long.
    """

    rotation: FloatArray  # base_R_body, its columns first, shape (3, 3, n, T)
    origin: FloatArray  # of each body's frame [m], shape (3, n, T)
    axis: FloatArray  # screw axis of each joint (angular, linear), shape (6, n, T)
    twist: FloatArray  # of each body (angular, linear), shape (6, n, T)

    def seen_by(self, body: int, screws: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Screws, shape (6, S, T), in the frame of a body: angular and linear, shape (3, S, T) each."""
        turn = self.rotation[:, :, body, None]
        place = self.origin[:, body, None]
        linear = screws[3:] + cross_product(screws[:3], place)
        return (turn * screws[:3]).sum(1), (turn * linear).sum(
            1,
        )


def kinematics(model: ReducedModel, position: FloatArray, velocity: FloatArray) -> Kinematics:
    """Kinematics of a model of n joints along a motion: position [rad or m] and velocity [rad/s or m/s], shape (T, n) each."""
    count, bodies = position.shape
    rotation = np.zeros((3, 3, bodies, count))
    origin = np.zeros((3, bodies, count))
    axis, twist = np.zeros((2, 6, bodies, count))
    sine = np.sin(position.T)
    versine = 1.0 - np.cos(position.T)
    for body in range(bodies):
        parent = int(model.parents[body])
        place = model.placement[body, :3]
        cross = _skew(model.axes[body])
        turn = (
            np.broadcast_to(np.eye(3)[..., None], (3, 3, count))
            if parent < 0
            else rotation[:, :, parent]
        )
        columns = place[:, :3] @ np.column_stack(
            [np.eye(3), cross, cross @ cross, model.axes[body]]
        )
        seen = np.tensordot(
            np.hstack([columns, place[:, 3:]]),
            turn,
            (0, 0),
        )
        origin[:, body] = seen[10] + (0.0 if parent < 0 else origin[:, parent])
        if model.kinds[body] == "prismatic":
            rotation[:, :, body] = seen[:3]
            origin[:, body] += position[:, body] * seen[9]
            axis[3:, body] = seen[9]
        else:
            rotation[:, :, body] = seen[:3] + sine[body] * seen[3:6] + versine[body] * seen[6:9]
            axis[:3, body] = seen[9]
            axis[3:, body] = cross_product(origin[:, body], seen[9])
        twist[:, body] = axis[:, body] * velocity[:, body] + (
            0.0 if parent < 0 else twist[:, parent]
        )
    return Kinematics(rotation, origin, axis, twist)


def momentum_along(
    angular: FloatArray, linear: FloatArray, spin: FloatArray, speed: FloatArray
) -> FloatArray:
    """Momentum of a body along screws, per unit of each of its parameters: in its own frame that is a product or two.

    ``angular``, ``linear``: of the screws; ``spin``, ``speed``: of the body; all shape (3, ...). Returns: shape (10, ...).
    """
    inertia = _ONCE * (angular[_ROWS] * spin[_COLUMNS] + angular[_COLUMNS] * spin[_ROWS])
    first = cross_product(linear, spin) + cross_product(speed, angular)
    return np.concatenate([(linear * speed).sum(0)[None], first, inertia])


def carriers(model: ReducedModel, body: int) -> list[int]:
    """The joints that carry a body: its own, its parent's, and so on to the base."""
    joints = [body]
    while model.parents[joints[-1]] >= 0:
        joints.append(int(model.parents[joints[-1]]))
    return joints


def gravity_along(model: ReducedModel, motion: Kinematics, body: int) -> FloatArray:
    """Gravity's force on a body along each joint that carries it, per unit of its parameters, shape (10, joints, T).

    Args:
        model: The robot with some joints locked.
        motion: Of its bodies.
        body: Whose weight it is.
    """
    force, _ = motion.seen_by(
        body,
        np.append(model.gravity, np.zeros(3))[:, None, None],
    )
    return momentum_along(
        *motion.seen_by(
            body,
            motion.axis[:, carriers(model, body)],
        ),
        0.0 * force,
        force,
    )


def gravity_torques(model: ReducedModel, position: FloatArray) -> FloatArray:
    """Torque that holds every joint at rest, per unit of every body's parameters.

    ``model``: the arm, n joints; ``position``: of them [rad or m], shape (T, n).

    Returns: Shape (T, n, n, 10): pose, joint, body, parameter [N m per unit].
    """
    motion = kinematics(model, position, np.zeros_like(position))
    result = np.zeros((*position.shape, position.shape[1], PARAMETERS))
    for body in range(position.shape[1]):
        result[:, carriers(model, body), body] = -gravity_along(model, motion, body).T
    return result
