"""About how well a recording determines a payload's mass, before anything is fitted.

From what moved and from what is known about the robot alone: no recorded torque is looked at, so nothing here says that the
recording is any good, only what it would tell if the robot were as its file says. What came out later was within a factor of two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

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
    LEAST_TORQUE_STD,
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
WORTH = 0.9  # of a half width, at most, that has to be left for another recording to be worth it
# A known load of so many of its standard deviations tells torque constants to 2.5 %.
LOAD_STDS = 40.0


@dataclass(frozen=True)
class OneMore:
    """What another recording beside one that is at hand would bring."""

    kind: str  # "push", "empty_hand", "known_load", or "calibration" from such pushes with an empty hand
    mass_half_width_kg: float  # about half the 95 % interval of a light object's mass then
    # what every kg of an object adds to it then, and the known load [kg]; None where it says nothing of that
    mass_half_width_per_kg: float | None = None
    load_kg: float | None = None

    def as_json(self) -> dict[str, Any]:
        return asdict(self)


def more_of_motion(
    robot: Robot,
    motion: Motion,
    half_kg: float,
    per_kg: float,
) -> tuple[OneMore, ...]:
    """What a second empty hand's motion beside the first, or one with a known load, would bring; nothing that is not worth it.

    Args:
        robot: As its file states it.
        motion: As in `mass_from_motion`.
        half_kg: Of a light object, as that has it.
        per_kg: What every kg adds to it.

    Raises:
        RecordingError: The motion is of no use.
    """
    more = []
    empty_kg, _ = mass_from_motion(robot, motion, empty=2)
    if empty_kg <= WORTH * half_kg:
        more.append(OneMore("empty_hand", empty_kg))
    read = 1.0 / LOAD_STDS
    stated = per_kg / Z95
    then = Z95 * max(read * stated / float(np.hypot(read, stated)), LEAST_TORQUE_STD)
    if then <= WORTH * per_kg:
        load_kg = LOAD_STDS * half_kg / Z95
        more.append(OneMore("known_load", half_kg, then, load_kg))
    return tuple(more)


def mass_from_motion(robot: Robot, motion: Motion, empty: int = 1) -> tuple[float, float]:
    """Half the 95 % interval of a light object's mass [kg], and what every further kg adds to it [1].

    As if the same motion had been made once more with an empty hand, or more often.

    Args:
        robot: As its file states it.
        motion: In which an object is weighed.
        empty: How often it is made with an empty hand.

    Raises:
        RecordingError: The motion is of no use.
    """
    rows = equations(robot, motion, motion.joints)
    arm = Arm.of(
        robot,
        motion.joints,
        dict(motion.held),
    )
    count = arm.count
    names = arm.model.joint_names
    shared = rows.design[:, : (PARAMETERS + 2) * count]
    own = rows.design[:, -3 * count :]
    recordings = 1 + empty
    # with the object and without it, each with friction and offsets of its own
    held = np.zeros((recordings, 1))
    held[0] = 1.0
    matrix = np.hstack(
        [
            np.kron(held, rows.payload),
            np.tile(shared, (recordings, 1)),
            np.kron(np.eye(recordings), own),
        ]
    )
    torque = shared[:, : PARAMETERS * count] @ np.concatenate(arm.bodies)
    weight = _torque_weights(robot, names, rows.joint, torque)
    scaled = matrix * np.tile(weight, recordings)[:, None]
    spread = _prior_stds(robot, arm, recordings)
    covariance = np.linalg.inv(
        spread[:, None] * (scaled.T @ scaled) * spread[None, :] + np.eye(len(spread))
    )
    share = max(relative_torque_std(robot, name) for name in names)
    half = float(Z95 * spread[0] * np.sqrt(covariance[0, 0]))
    return half, Z95 * share


def _prior_stds(robot: Robot, arm: Arm, recordings: int) -> np.ndarray:
    """Standard deviations of a light object, of the arm's bodies and drive trains, and of recordings' friction, which is open."""
    open_friction = [arm.kg * 9.81 * arm.reach_m] * (3 * recordings * arm.count)
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
    known = _torque_of(robot, run)
    return None if known is None else known.half_kg(known.robot, known.of_run)


def more_of_run(robot: Robot, run: Run) -> tuple[OneMore, ...]:
    """What a push like this one would bring; nothing where that is not worth it.

    With an empty hand, for a calibration, it takes out what of the robot is not known: what is left differs between both. Of a
    calibrated robot it is another push of the same object.
    """
    known = _torque_of(robot, run)
    if known is None:
        return ()
    if robot.is_calibrated([run.joint]):
        kind = "push"
        half_kg = known.half_kg(known.robot, 0.5 * known.of_run)
    else:
        kind = "calibration"
        half_kg = known.half_kg(0.0, 2.0 * known.of_run)
    if half_kg > WORTH * known.half_kg(known.robot, known.of_run):
        return ()
    return (OneMore(kind, half_kg),)


@dataclass(frozen=True)
class _Torque:
    """What is not known of the torque at the end of a push."""

    robot: float  # variance of what is alike in all pushes [N^2 m^2]
    of_run: float  # of what differs from run to run [N^2 m^2]
    per_kg: float  # of a light object [N m/kg]

    def half_kg(self, robot: float, of_run: float) -> float:
        """Half the 95 % interval of a mass under such variances."""
        return Z95 * float(np.sqrt(robot + of_run)) / abs(self.per_kg)


def _torque_of(robot: Robot, run: Run) -> _Torque | None:
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
    return _Torque(variance, robot.torque_disturbance**2, per_kg)


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
