"""About how well a recording determines a payload's mass, before anything is fitted.

From what moved and from what is known about the robot alone: no recorded torque is looked at, so nothing here says that the
recording is any good, only what it would tell if the robot were as its file says. What came out later was within a factor of two.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from proprio_ros.identification.coefficients import (
    arm_coefficients,
)
from proprio_ros.identification.gates import STEADY
from proprio_ros.identification.regression.motion_equations import (
    HOP_SHARE,
    STRETCH_S,
    WINDOW_S,
    Arm,
    equations,
    sizes,
)
from proprio_ros.identification.regression.motion_prior import (
    LINK_SHARE,
    body_stds,
    drive_stds,
    relative_torque_std,
)
from proprio_ros.kinds import Key
from proprio_ros.quantity import Z95
from proprio_ros.recordings.motions import Motion
from proprio_ros.records import Run
from proprio_ros.robot import Robot
from proprio_ros.robot.regressor import PARAMETERS
from proprio_ros.sim.payload import PayloadFacts

DRIFT_SHARE = 0.05
"""Torque that no model has and that lasts for seconds, relative to what the arm itself needs: 3 to 12 % on real arms."""
WITHIN = 0.3  # an object lies within this share of the arm's reach
# first moments and inertia are those of an object of this part of the arm's mass
SMALL_SHARE = 0.05


def mass_from_motion(robot: Robot, motion: Motion) -> tuple[float, float]:
    """Half the 95 % interval of a light object's mass [kg], and what every further kg adds to it [1].

    As if the same motion had been made once more with an empty hand.

    Raises `RecordingError`: The motion is of no use.
    """
    rows = equations(robot, motion, motion.joints)
    arm = Arm.of(robot, motion.joints, dict(motion.held))
    count = arm.count
    names = arm.model.joint_names
    shared = rows.design[:, : (PARAMETERS + 2) * count]
    own = rows.design[:, -3 * count :]
    none = np.zeros_like(own)
    empty = np.zeros_like(rows.payload)
    # with the object and without it, each with friction and offsets of its own
    matrix = np.block(
        [
            [rows.payload, shared, own, none],
            [empty, shared, none, own],
        ]
    )
    torque = shared[:, : PARAMETERS * count] @ np.concatenate(arm.bodies)
    weight = _torque_weights(robot, names, rows.joint, torque)
    scaled = matrix * np.tile(weight, 2)[:, None]
    spread = _prior_stds(robot, arm)
    covariance = np.linalg.inv(
        spread[:, None] * (scaled.T @ scaled) * spread[None, :] + np.eye(len(spread))
    )
    share = max(relative_torque_std(robot, name) for name in names)
    half = float(Z95 * spread[0] * np.sqrt(covariance[0, 0]))
    return half, Z95 * share


def _prior_stds(robot: Robot, arm: Arm) -> np.ndarray:
    """Standard deviations of a light object, of the arm's bodies and drive trains, and of friction that is open."""
    open_friction = [arm.kg * 9.81 * arm.reach_m] * (6 * arm.count)
    payload = sizes(arm.kg, WITHIN * arm.reach_m)
    spread = np.array(
        [
            *payload,
            *body_stds(arm, LINK_SHARE),
            *drive_stds(robot, arm),
            *open_friction,
        ]
    )
    small = SMALL_SHARE * spread[0]
    spread[1:PARAMETERS] *= small / spread[0]
    return spread


def _torque_weights(
    robot: Robot,
    names: Sequence[str],
    joint: np.ndarray,
    torque: np.ndarray,
) -> np.ndarray:
    """One over the standard deviation of each window's mean torque [N m], of which joint (T,) and how large (T,) it is."""
    weight = np.zeros(len(torque))
    for number, name in enumerate(names):
        mine = joint == number
        # gravity may do nothing on a vertical axis; what moves it then is of the size of friction
        friction = robot.drive_trains[name].coulomb
        if mine.any():
            rms = float(np.sqrt(np.mean(torque[mine] ** 2)))
            size = max(rms, friction.value + 0.5 * friction.std)
            weight[mine] = 1.0 / (DRIFT_SHARE * size)
    # neighbouring windows share one error
    return weight / np.sqrt(STRETCH_S / (WINDOW_S * HOP_SHARE))


def mass_from_run(robot: Robot, run: Run) -> float | None:
    """Half the 95 % interval of a light object's mass [kg] from one run, by how much torque is not known over what a kg takes.

    None where the joint does not turn, lifts nothing, or is driven by a current that changes: a controller's, whose torque and
    friction are not those of one push.
    """
    joint = robot.model.joint(run.joint)
    if joint.kind == "prismatic" or len(run.times_s) < 3:
        return None
    driving = run.input_current_A[run.input_times_s < run.times_s[-1]]
    if np.ptp(driving) > STEADY * np.abs(driving).max():
        return None
    duration = max(float(run.times_s[-1] - run.times_s[0]), 1e-3)
    way = float(run.position[-1] - run.position[0])
    acceleration = 2.0 * way / duration**2
    middle = float(run.position[len(run.position) // 2])
    coefficients = arm_coefficients(robot, run, ())
    cos = np.cos(middle)
    sin = np.sin(middle)
    basis = np.array([acceleration, cos, sin, 1.0])
    per_kg = float(coefficients.per_kg(PayloadFacts()) @ basis)
    if abs(per_kg) < 1e-6:
        return None
    name = run.joint
    current = float(driving.mean())
    direction = np.sign(way)
    motor = robot.drive_trains[name].torque_constant.value * current
    slope: dict[Key, float] = {
        ("torque_constant", name): current,
        ("coulomb", name): -direction,
        ("viscous", name): -direction * (abs(way) / duration),
        ("load_friction", name): -direction * abs(motor),
        ("armature", name): -acceleration,
        "arm_scale": -float(coefficients.arm @ basis),
    }
    gradient = np.array(list(slope.values()))
    variance = float(gradient @ _covariance_of(robot, name, list(slope)) @ gradient)
    variance += robot.torque_disturbance**2
    return Z95 * float(np.sqrt(variance)) / abs(per_kg)


def _covariance_of(robot: Robot, joint: str, keys: Sequence[Key]) -> np.ndarray:
    """What is known of a joint's drive train and of the arm's scale, shape (K, K)."""
    drive = robot.drive_trains[joint]
    stds = [
        getattr(drive, key[0]).std if isinstance(key, tuple) else robot.arm_scale.std
        for key in keys
    ]
    covariance = np.diag(np.square(stds))
    known = robot.calibration
    if known is not None:
        # what is known together is known better
        there = [row for row, key in enumerate(keys) if key in known.keys]
        place = [known.keys.index(key) for key in keys if key in known.keys]
        covariance[np.ix_(there, there)] = known.covariance[np.ix_(place, place)]
    return covariance
