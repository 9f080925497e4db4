"""What is known of an arm before its motions are looked at: by its robot file, or by a calibration."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from proprio_ros.calibration_files.motions import (
    ARM_TERMS,
    FRICTION_TERMS,
    TERMS,
    MotionCalibration,
)
from proprio_ros.identification.regression.arm_terms import ArmTerms
from proprio_ros.identification.regression.motion_equations import Arm, own_terms, sizes
from proprio_ros.identification.regression.recording_variability import (
    CONSIDERED,
    PSEUDO_RECORDINGS,
    PUBLISHED,
    RecordingVariability,
)
from proprio_ros.identification.regression.solve import WAVES, Prior, Priors
from proprio_ros.recordings.motions import Motion
from proprio_ros.records import FloatArray
from proprio_ros.robot import Robot
from proprio_ros.robot.regressor import PARAMETERS

# Relative; magnets lose 0.1 % of their torque per kelvin, and motors that lift warm by ten.
LEAST_TORQUE_STD = 0.01
VOLTAGE_TORQUE_STD = 0.2
"""Relative, where a voltage drives the motor: its torque is a maker's constant over a winding that warms up, times a gain."""
URDF_SHARE = 0.15
"""An arm that weighs more or less than its URDF by more may owe it to the torque constants, whatever their file says of them; URDFs
were seen to be off by 8 to 16 %."""
LEAST_LOAD_FRICTION_STD = 0.05
"""Gears lose part of the torque that they transmit; a file that does not say how much has not measured it."""
LOAD_FRICTION_SPREAD = 0.02  # The share that gears lose is not quite the same under another load.
LINK_SHARE = 0.2
"""How far a body's mass may lie off its URDF, relative; first moments and inertia accordingly over the body's size."""
ARM_SHARE = 0.01  # And in parts of the whole arm's: cables and screws are in no model.
HELD_WITHIN = 0.1
"""What a hand holds lies within this share of the arm's reach, unless its place is stated: one standard deviation."""


def relative_torque_std(robot: Robot, joint: str) -> float:
    """How well a joint's torque constant is known, relative to it; no file knows it exactly."""
    drive = robot.drive_trains[joint]
    constant = drive.torque_constant
    least = LEAST_TORQUE_STD if drive.driven_by is None else VOLTAGE_TORQUE_STD
    return max(constant.std / abs(constant.value), least)


def body_stds(arm: Arm, share: float) -> list[float]:
    """How far the bodies' parameters may lie off the URDF, where their masses do by a share, length 10 n."""
    stds: list[float] = []
    for length_m, body in zip(arm.lengths_m, arm.bodies, strict=True):
        stds += sizes(
            share * float(body[0]) + ARM_SHARE * arm.kg,
            length_m,
        )
    return stds


def _unstated_stds(robot: Robot, arm: Arm) -> list[float]:
    """The same of what the URDF does not state of links, and what was taken for it."""
    kg = [0.0] * arm.count
    for link in robot.model.links:
        body = arm.model.frames[link.name][0]
        if body >= 0:
            mass = float(link.pseudo_inertia[3, 3])
            kg[body] += link.spread.mass * mass
    stds: list[float] = []
    for mass_kg, length_m in zip(kg, arm.lengths_m, strict=True):
        stds += sizes(mass_kg, length_m)
    return stds


def drive_stds(robot: Robot, arm: Arm) -> list[float]:
    """The same of rotors [kg m^2] and of the share that gears lose, length 2 n."""
    drives = [robot.drive_trains[name] for name in arm.model.joint_names]
    least = 1e-3 * arm.kg * arm.reach_m**2
    armatures = [drive.armature for drive in drives]
    rotors = [max(rotor.std, 0.5 * abs(rotor.value), least) for rotor in armatures]
    gears = [max(d.load_friction.std, LEAST_LOAD_FRICTION_STD) for d in drives]
    return rotors + gears


def file_prior(robot: Robot, arm: Arm) -> Prior:
    """What the robot file says of an arm's terms, in the order of `term_keys`: bodies and drive trains; friction is open.

    All bodies may be heavier or lighter together: that is also what torque constants do that are off.
    """
    drives = [robot.drive_trains[name] for name in arm.model.joint_names]
    bodies = body_stds(arm, robot.link_mass_std or LINK_SHARE)
    unstated = _unstated_stds(robot, arm)
    stds = []
    for both in zip(bodies, unstated, strict=True):
        stds.append(float(np.hypot(*both)))
    stds += drive_stds(robot, arm)
    stds += [LEAST_TORQUE_STD] * len(drives)
    # until the fit knows Coulomb friction itself
    stds += [d.coulomb.std or 0.1 * arm.kg * arm.reach_m for d in drives] * WAVES
    stds += [arm.kg * 9.81 * arm.reach_m] * (len(FRICTION_TERMS) * len(drives))
    together = np.concatenate(arm.bodies)  # (10 n,)
    terms = ArmTerms(arm.count)
    values = np.zeros(len(stds))
    values[terms.bodies] = together
    values[terms.rotors] = [d.armature.value for d in drives]
    values[terms.load_friction] = [d.load_friction.value for d in drives]
    covariance = np.diag(np.square(stds))
    covariance[terms.bodies, terms.bodies] += URDF_SHARE**2 * np.outer(together, together)
    return Prior(values, covariance)


def priors_of_file(
    robot: Robot,
    arm: Arm,
    motions: int,
) -> Priors:
    """Of all unknowns of some motions by the robot file alone.

    Args:
        robot: As its file states it.
        arm: Of it.
        motions: How many there are; friction of one says nothing about that of another.
    """
    stated = file_prior(robot, arm)
    count = arm.count
    shared = ARM_TERMS * count
    friction = np.zeros(own_terms(count))
    friction[: TERMS * count - shared] = np.diag(stated.covariance)[shared:]
    size = shared + motions * len(friction)
    values = np.zeros(size)
    values[:shared] = stated.values[:shared]
    covariance = np.zeros((size, size))
    own = range(shared, size)
    covariance[own, own] = np.tile(friction, motions)
    covariance[:shared, :shared] = stated.covariance[:shared, :shared]
    return Priors(
        unknowns=with_payload(arm, Prior(values, covariance)),
        variability=RecordingVariability.unknown(count),
        per_kg=payload_stds(arm),
    )


def calibrated_terms(count: int, motions: int) -> FloatArray:
    """Which of a calibration's terms each unknown behind the payload follows, shape (U - 10, 20 n), with a 1 for each that is one.

    ``count``: of joints, n; ``motions``: how many there are.
    """
    shared = ARM_TERMS * count
    friction = len(FRICTION_TERMS) * count
    of_motion = np.zeros((own_terms(count), TERMS * count))
    of_motion[:friction, shared:] = np.eye(friction)
    return np.vstack([np.eye(TERMS * count)[:shared], *[of_motion] * motions])


def priors_of_calibration(
    arm: Arm, calibration: MotionCalibration, motions: Sequence[Motion]
) -> Priors:
    """Of all unknowns of some motions by a calibration.

    Args:
        arm: That was calibrated.
        calibration: What is known of it.
        motions: Whose clocks are known as well as they say.
    """
    terms = calibrated_terms(arm.count, len(motions))
    covariance = terms @ calibration.covariance @ terms.T
    geared = ArmTerms(arm.count).load_friction
    at = range(geared.start, geared.stop)
    covariance[at, at] += LOAD_FRICTION_SPREAD**2
    return Priors(
        unknowns=with_payload(
            arm,
            Prior(terms @ calibration.values, covariance),
        ),
        variability=variability_of(calibration, motions),
        per_kg=payload_stds(arm),
    )


def variability_of(
    calibration: MotionCalibration, motions: Sequence[Motion]
) -> RecordingVariability:
    """By how much motions differ from a calibration, whose own torque, zeros and clock nobody knows, either.

    Their clocks are known as well as they say.
    """
    stated = {kind: (spread, PSEUDO_RECORDINGS) for kind, spread in PUBLISHED.items()}
    stated |= calibration.between
    # one differs from the mean of several as it differs from the machine, and as that mean does
    about_mean = np.sqrt(1.0 + 1.0 / max(calibration.empty_motions, 1))
    spreads = {
        kind: float(about_mean) * PUBLISHED[kind] if kind in CONSIDERED else stated[kind][0]
        for kind in PUBLISHED
    }
    # a pace that is off by a share puts accelerations off by twice that
    pace_std = max((motion.pace_std for motion in motions), default=0.0)
    lag_std_s = max((motion.lag_std_s for motion in motions), default=0.0)
    spreads["pace"] = 2.0**0.5 * 2.0 * pace_std
    spreads["lag"] = 2.0**0.5 * lag_std_s
    recordings = {kind: stated[kind][1] for kind in PUBLISHED}
    # the file has friction's spread in full
    spread = calibration.friction_spread
    count = len(spread) // 3
    of_friction = np.full(2 * count, 1.0 / spreads["friction"])
    of_offset = np.full(count, 1.0 / spreads["offset"])
    unit = np.concatenate([of_friction, of_offset])
    return RecordingVariability(
        spreads,
        recordings,
        spread * unit,
        np.zeros_like(spread),
    )


def payload_stds(arm: Arm) -> FloatArray:
    """Standard deviations of a payload's parameters per kg that it weighs, shape (10,)."""
    return np.array(sizes(1.0, HELD_WITHIN * arm.reach_m))


def with_payload(arm: Arm, prior: Prior) -> Prior:
    """The prior with the payload's ten parameters before it: anything up to what the arm itself weighs."""
    size = len(prior.values) + PARAMETERS
    covariance = np.zeros((size, size))
    payload = range(PARAMETERS)
    covariance[payload, payload] = np.square(arm.kg * payload_stds(arm))
    covariance[PARAMETERS:, PARAMETERS:] = prior.covariance
    values = np.concatenate([np.zeros(PARAMETERS), prior.values])
    return Prior(values, covariance)
