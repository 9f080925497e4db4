"""Ten inertial parameters that a rigid body can have: the nearest ones to an estimate, and what they say of its centre.

A regression of torques gives mass, first moments and inertia as if they were free; a body's are not: no inertia is negative, and no
principal moment exceeds the sum of the other two. All of that holds exactly where the pseudo-inertia

    P = [[S, h], [h^T, m]],   S = trace(I) / 2 E - I

is positive definite. The nearest such parameters are the minimum of a convex function over a cone, found by Newton's method with
the logarithm of P's determinant as a barrier.

Sources: pseudo-inertia as the condition, Wensing, Kim & Slotine 2018, IEEE Robotics and Automation Letters 3(1); the barrier and
the length of its steps, Boyd & Vandenberghe 2004, Convex Optimization, sections 9.6 and 11.6.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from proprio_ros.robot.regressor import PARAMETERS

FloatArray = NDArray[np.float64]
_UPPER = np.triu_indices(3)
_BARRIER_END = 1e-9
"""In squared standard deviations; four of them (the dimension of P) are what the barrier still costs."""
_NEWTON_STEPS = 100


def pseudo_inertia(parameters: FloatArray) -> FloatArray:
    """The inverse of `body_parameters`: shape (10,) to (4, 4)."""
    inertia = np.zeros((3, 3))
    inertia[_UPPER] = parameters[4:]
    inertia = inertia + np.triu(inertia, 1).T
    result = np.zeros((4, 4))
    result[:3, :3] = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    result[:3, 3] = result[3, :3] = parameters[1:4]
    result[3, 3] = parameters[0]
    return result


def nearest_body(parameters: FloatArray, covariance: FloatArray) -> FloatArray:
    """The rigid body of the same mass that is nearest to an estimate, in standard deviations of that estimate.

    Args:
        parameters: Mass [kg], first moments [kg m], inertia about the frame's origin [kg m^2], shape (10,); the mass is positive.
        covariance: Of these, positive definite, shape (10, 10).

    Returns: Shape (10,); the same where a body already has these.
    """
    # by the largest inertia that the estimate allows, the rest is a number near one
    largest = np.abs(parameters) + np.sqrt(np.diag(covariance))
    second_moment = largest[[4, 7, 9]].max()
    length_m = float(np.sqrt(second_moment / parameters[0]))
    size = parameters[0] * np.array([1.0, *[length_m] * 3, *[length_m**2] * 6])
    wanted = parameters / size
    if np.linalg.eigvalsh(pseudo_inertia(wanted)).min() > 0.0:
        return parameters.copy()
    # with the mass held, the rest of its error counts as it is given the mass
    scaled = covariance / np.outer(size, size)
    information = np.linalg.inv(
        scaled[1:, 1:] - np.outer(scaled[1:, 0], scaled[0, 1:]) / scaled[0, 0]
    )
    rest = _nearest_in_cone(wanted[1:], information)
    result: FloatArray = np.concatenate([parameters[:1], rest * size[1:]])
    return result


def _nearest_in_cone(wanted: FloatArray, information: FloatArray) -> FloatArray:
    """First moments and inertia of a body of mass 1 that are nearest to some, shape (9,), by Newton's method with a barrier."""
    units = np.array([pseudo_inertia(unit) for unit in np.eye(PARAMETERS)[1:]])  # (9, 4, 4)
    fixed = pseudo_inertia(np.eye(PARAMETERS)[0])
    # a sphere at the origin is a body, and the barrier keeps every step one
    rest = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 1.0])
    barrier = 1.0 + float((rest - wanted) @ information @ (rest - wanted))
    while barrier > _BARRIER_END:
        for _ in range(_NEWTON_STEPS):
            inverse = np.linalg.inv(fixed + np.tensordot(rest, units, 1))
            turned = inverse @ units
            traces = np.trace(turned, axis1=1, axis2=2)
            gradient = 2.0 * information @ (rest - wanted) - barrier * traces
            curvature = np.einsum("aij,bji->ab", turned, turned)
            hessian = 2.0 * information + barrier * curvature
            step = -np.linalg.solve(hessian, gradient)
            # the decrement measures how far the minimum is; within 1/4 of it full steps stay inside the cone
            decrement = float(np.sqrt(max(-gradient @ step, 0.0) / barrier))
            rest = rest + step / (1.0 + decrement if decrement > 0.25 else 1.0)
            if decrement < 1e-6:
                break
        barrier *= 0.2
    return rest


def inertia_about_centre(parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Inertia about the centre of mass along the frame's axes: xx, xy, xz, yy, yz, zz [kg m^2], and its gradient.

    ``parameters``: as for `nearest_body`, shape (10,).

    Returns: Shape (6,), and per unit of each parameter, shape (6, 10).
    """
    mass = parameters[0]
    moment = parameters[1:4]
    value = parameters[4:].copy()
    gradient = np.zeros((6, PARAMETERS))
    gradient[:, 4:] = np.eye(6)
    for row, (i, j) in enumerate(zip(*_UPPER, strict=True)):
        # Steiner: less m (c . c E - c c^T), with c = h / m
        dot = float(moment @ moment) if i == j else 0.0
        part = dot - moment[i] * moment[j]
        value[row] -= part / mass
        gradient[row, 0] = part / mass**2
        slope = 2.0 * moment if i == j else np.zeros(3)
        slope[i] -= moment[j]
        slope[j] -= moment[i]
        gradient[row, 1:4] = -slope / mass
    return value, gradient
