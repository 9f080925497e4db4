"""Rotations, transforms and pseudo-inertias.

Conventions. ``a_T_b`` takes coordinates in frame b to frame a.

Inertia is kept as the 4 x 4 pseudo-inertia ``P = [[Sigma, h], [h^T, m]]``, with the second moments
``Sigma = int r r^T dm`` and the first moments ``h = m c`` about the frame's origin. It moves between frames as
``T P T^T``, adds up over rigidly joined bodies, and belongs to a physical body exactly when it is positive semidefinite
(Wensing, Kim and Slotine, "Linear Matrix Inequalities for Physically-Consistent Inertial Parameter Identification",
RA-L 2018).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]


def frozen(values: ArrayLike) -> FloatArray:
    """A copy that cannot be written to."""
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


def rotation_from_rpy(rpy: ArrayLike) -> FloatArray:
    """Rotation matrix from URDF's roll, pitch and yaw [rad] about fixed axes: ``Rz(yaw) Ry(pitch) Rx(roll)``, shape (3, 3)."""
    roll, pitch, yaw = np.asarray(rpy, dtype=np.float64)
    x, y, z = np.eye(3)
    return rotation_about(z, yaw) @ rotation_about(y, pitch) @ rotation_about(x, roll)


def rotation_about(axis: ArrayLike, angle: float | FloatArray) -> FloatArray:
    """Rotation matrix from a unit axis and an angle [rad] (Rodrigues' formula), shape (3, 3); of many angles (N, 3, 3)."""
    x, y, z = np.asarray(axis, dtype=np.float64)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    if isinstance(angle, np.ndarray):
        angle = angle[:, None, None]
        return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross)
    return np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * (cross @ cross)


def transform(rotation: ArrayLike, translation: ArrayLike) -> FloatArray:
    """Homogeneous transform from a rotation matrix (3, 3) and a translation [m] (3,), shape (4, 4); of many of either (N, 4, 4)."""
    rotation = np.asarray(rotation)
    translation = np.asarray(translation)
    result = np.zeros((*(rotation.shape[:-2] or translation.shape[:-1]), 4, 4))
    result[..., :3, :3] = rotation
    result[..., :3, 3] = translation
    result[..., 3, 3] = 1.0
    return result


def motion(kind: str, axis: ArrayLike, position: float | FloatArray) -> FloatArray:
    """What a joint of a kind of `JOINT_KINDS` adds to its origin at a position [rad or m], shape (4, 4), or at N, (N, 4, 4).

    The axis is in the joint's own frame.
    """
    if kind == "prismatic":
        return transform(
            np.eye(3),
            np.multiply.outer(position, np.asarray(axis, dtype=np.float64)),
        )
    if kind == "fixed":
        return np.eye(4)
    return transform(rotation_about(axis, position), np.zeros(3))


def pseudo_inertia(mass: float, com: ArrayLike, inertia_about_com: ArrayLike) -> FloatArray:
    """Pseudo-inertia about a frame's origin, shape (4, 4).

    Args:
        mass: Of the body [kg].
        com: Its centre [m], (3,).
        inertia_about_com: [kg m^2], (3, 3).
    """
    com = np.asarray(com, dtype=np.float64)
    inertia = np.asarray(inertia_about_com, dtype=np.float64)
    result = np.empty((4, 4))
    central = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    result[:3, :3] = central + mass * np.outer(com, com)
    result[:3, 3] = result[3, :3] = mass * com
    result[3, 3] = mass
    return result


def inertia_about_origin(pseudo: ArrayLike) -> FloatArray:
    """Rotational inertia about the frame's origin [kg m^2], shape (3, 3), of a pseudo-inertia (4, 4)."""
    second = np.asarray(pseudo, dtype=np.float64)[:3, :3]
    return np.trace(second) * np.eye(3) - second
