"""Momentum of a moving arm and gravity's wrench on it, linear in the inertial parameters of its bodies.

Sources: spatial vectors, Featherstone 2008, Rigid Body Dynamics Algorithms, chapter 2; inertial parameters of links and loads,
Atkeson, An & Hollerbach 1986, International Journal of Robotics Research 5(3).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from proprio_ros.robot.geometry import FloatArray, inertia_about_origin
from proprio_ros.robot.tree import ReducedModel

PARAMETERS = 10  # of a body: m [kg], m c [kg m] (3), I [kg m^2] about the body's origin: xx, xy, xz, yy, yz, zz


def body_parameters(pseudo_inertia: FloatArray) -> FloatArray:
    """The ten parameters of a body from its pseudo-inertia, shape (4, 4)."""
    upper = inertia_about_origin(pseudo_inertia)[np.triu_indices(3)]
    return np.concatenate([[pseudo_inertia[3, 3]], pseudo_inertia[:3, 3], upper])


def point_mass(place_m: FloatArray) -> FloatArray:
    """The ten parameters of 1 kg at a place, shape (3,)."""
    pseudo = np.zeros((4, 4))
    pseudo[3] = pseudo[:, 3] = [*place_m, 1.0]
    pseudo[:3, :3] = np.outer(place_m, place_m)
    return body_parameters(pseudo)


def _skew(v: FloatArray) -> FloatArray:
    result = np.zeros((*v.shape[:-1], 3, 3))
    result[..., 0, 1], result[..., 0, 2], result[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    result[..., 1, 0], result[..., 2, 0], result[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    return result


@dataclass(frozen=True)
class Kinematics:
    """Where the bodies of an arm are, and how they move, at every sample; n bodies, all in the base frame about its origin."""

    rotation: FloatArray  # base_R_body, shape (T, n, 3, 3)
    origin: FloatArray  # of each body's frame [m], shape (T, n, 3)
    axis: FloatArray  # screw axis of each joint (angular, linear), shape (T, n, 6)
    twist: FloatArray  # of each body (angular, linear), shape (T, n, 6)


def kinematics(model: ReducedModel, position: FloatArray, velocity: FloatArray) -> Kinematics:
    """Kinematics of a model of n revolute joints along a motion: position [rad] and velocity [rad/s], shape (T, n) each."""
    count, bodies = position.shape
    rotation, origin = np.zeros((count, bodies, 3, 3)), np.zeros((count, bodies, 3))
    axis, twist = np.zeros((count, bodies, 6)), np.zeros((count, bodies, 6))
    for body in range(bodies):
        parent = int(model.parents[body])
        turn = np.broadcast_to(np.eye(3), (count, 3, 3)) if parent < 0 else rotation[:, parent]
        place = model.placement[body]
        base = turn @ place[:3, :3]
        origin[:, body] = turn @ place[:3, 3] + (0.0 if parent < 0 else origin[:, parent])
        cross = _skew(model.axes[body])
        angle = position[:, body, None, None]
        rotation[:, body] = base @ (np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross))
        direction = base @ model.axes[body]
        axis[:, body, :3] = direction
        axis[:, body, 3:] = np.cross(origin[:, body], direction)
        twist[:, body] = axis[:, body] * velocity[:, body, None] + (0.0 if parent < 0 else twist[:, parent])
    return Kinematics(rotation, origin, axis, twist)


def momentum_and_gravity(
    rotation: FloatArray, origin: FloatArray, twist: FloatArray, gravity: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Momentum of one body and gravity's wrench on it, per unit of each of its parameters.

    ``rotation``: base_R_body, shape (T, 3, 3); ``origin``: of the body's frame [m], shape (T, 3); ``twist``: of the
    body, shape (T, 6); ``gravity``: [m/s^2], shape (3,).

    Returns:
        Both (angular, linear) about the base's origin, shape (T, 6, 10).
    """
    count = len(rotation)
    back = np.swapaxes(rotation, 1, 2)
    spin = (back @ twist[:, :3, None])[..., 0]
    speed = (back @ (twist[:, 3:] + np.cross(twist[:, :3], origin))[..., None])[..., 0]
    linear, angular = np.zeros((count, 3, 4)), np.zeros((count, 3, PARAMETERS))  # inertia has no linear momentum
    linear[:, :, 0], linear[:, :, 1:4] = speed, _skew(spin)
    angular[:, :, 1:4] = -_skew(speed)
    for column, (row, other) in enumerate([(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)], start=4):
        angular[:, row, column] = spin[:, other]
        angular[:, other, column] = spin[:, row]
    momentum, wrench = np.zeros((2, count, 6, PARAMETERS))
    lever = _skew(origin)
    momentum[:, 3:, :4] = linear = rotation @ linear
    momentum[:, :3] = rotation @ angular
    momentum[:, :3, :4] += lever @ linear
    wrench[:, :3, 0], wrench[:, 3:, 0] = lever @ gravity, gravity
    wrench[:, :3, 1:4] = -_skew(gravity) @ rotation
    return momentum, wrench


def carriers(model: ReducedModel, body: int) -> list[int]:
    """The joints that carry a body: its own, its parent's, and so on to the base."""
    joints = [body]
    while model.parents[joints[-1]] >= 0:
        joints.append(int(model.parents[joints[-1]]))
    return joints


def gravity_torques(model: ReducedModel, position: FloatArray) -> FloatArray:
    """Torque that holds every joint at rest, per unit of every body's parameters.

    ``model``: the arm, n revolute joints; ``position``: of them [rad], shape (T, n).

    Returns:
        Shape (T, n, n, 10): pose, joint, body, parameter [N m per unit].
    """
    at_rest = np.zeros_like(position)
    motion = kinematics(model, position, at_rest)
    result = np.zeros((*position.shape, position.shape[1], PARAMETERS))
    for body in range(position.shape[1]):
        _, wrench = momentum_and_gravity(
            motion.rotation[:, body], motion.origin[:, body], motion.twist[:, body], model.gravity
        )
        for joint in carriers(model, body):
            result[:, joint, body] = -(motion.axis[:, joint, None] @ wrench)[:, 0]
    return result
