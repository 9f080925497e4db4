"""About how well a recording determines a payload's mass, before anything is fitted.

From what moved and from what is known about the robot alone: no recorded torque is looked at, so nothing here says that the
recording is any good, only what it would tell if the robot were as its file says. What came out later was within a factor of two.
"""

from __future__ import annotations

import numpy as np

from proprio_ros.identification.coefficients import arm_coefficients
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
    open_friction = [arm.kg * 9.81 * arm.reach_m] * (6 * count)
    payload = sizes(arm.kg, WITHIN * arm.reach_m)
    spread = np.array(
        [*payload, *body_stds(arm, LINK_SHARE), *drive_stds(robot, arm), *open_friction]
    )
    shared = rows.design[:, : (PARAMETERS + 2) * count]
    own = rows.design[:, -3 * count :]
    none = np.zeros_like(own)
    empty = np.zeros_like(rows.payload)
    matrix = np.block([[rows.payload, shared, own, none], [empty, shared, none, own]])
    torque = shared[:, : PARAMETERS * count] @ np.concatenate(arm.bodies)
    weight = np.zeros(len(torque))
    for joint in range(count):
        mine = rows.joint == joint
        # gravity may do nothing on a vertical axis; what moves it then is of the size of friction
        friction = robot.drive_trains[names[joint]].coulomb
        if mine.any():
            size = max(
                float(np.sqrt(np.mean(torque[mine] ** 2))), friction.value + 0.5 * friction.std
            )
            weight[mine] = 1.0 / (DRIFT_SHARE * size)
    # neighbouring windows share one error
    weight /= np.sqrt(STRETCH_S / (WINDOW_S * HOP_SHARE))
    scaled = matrix * np.tile(weight, 2)[:, None]
    small = SMALL_SHARE * spread[0]
    spread[1:PARAMETERS] *= small / spread[0]
    covariance = np.linalg.inv(
        spread[:, None] * (scaled.T @ scaled) * spread[None, :] + np.eye(len(spread))
    )
    share = max(relative_torque_std(robot, name) for name in names)
    return float(Z95 * spread[0] * np.sqrt(covariance[0, 0])), Z95 * share


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
    duration = max(
        float(run.times_s[-1] - run.times_s[0]),
        1e-3,
    )
    way = float(run.position[-1] - run.position[0])
    acceleration = 2.0 * way / duration**2
    speed = abs(way) / duration
    direction = np.sign(way)
    middle = float(run.position[len(run.position) // 2])
    coefficients = arm_coefficients(robot, run, ())
    basis = np.array([acceleration, np.cos(middle), np.sin(middle), 1.0])
    per_kg = float(coefficients.per_kg(PayloadFacts()) @ basis)
    arm = float(coefficients.arm @ basis)
    if abs(per_kg) < 1e-6:
        return None
    drive = robot.drive_trains[run.joint]
    current = float(driving.mean())
    name = run.joint
    slope: dict[Key, float] = {
        ("torque_constant", name): current,
        ("coulomb", name): -direction,
        ("viscous", name): -direction * speed,
        ("load_friction", name): -direction * abs(drive.torque_constant.value * current),
        ("armature", name): -acceleration,
        "arm_scale": -arm,
    }
    stds = [
        getattr(drive, key[0]).std if isinstance(key, tuple) else robot.arm_scale.std
        for key in slope
    ]
    covariance = np.diag(np.square(stds))
    if (known := robot.calibration) is not None:
        # what is known together is known better
        there = [row for row, key in enumerate(slope) if key in known.keys]
        place = [known.keys.index(key) for key in slope if key in known.keys]
        covariance[np.ix_(there, there)] = known.covariance[np.ix_(place, place)]
    gradient = np.array(list(slope.values()))
    variance = float(gradient @ covariance @ gradient) + robot.torque_disturbance**2
    return Z95 * float(np.sqrt(variance)) / abs(per_kg)
