"""What a robot of one joint carries, from any motion under a controller: how it swings, and the mass where the torque is known."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from proprio_ros.identification.estimate import LIMIT_OF_ONE_JOINT, Estimate, Fit, Value
from proprio_ros.identification.judge import (
    FAR,
    Refusal,
    judge,
    not_identifiable,
    positive,
    rejected,
)
from proprio_ros.identification.regression.motion_prior import URDF_SHARE, relative_torque_std
from proprio_ros.identification.regression.one_joint_fit import (
    STRETCH_S,
    Carried,
    OneJointFit,
    carried_by,
    fit_one_joint,
    shown_of,
)
from proprio_ros.identification.regression.refusals import (
    UNEXPLAINED_SHARE,
    errs_most_by,
    interval_too_wide,
    lighter_than_empty,
    unlike_urdf,
)
from proprio_ros.probes.payload.moving import MotionDetail, motion_answer
from proprio_ros.quantity import Quantity, shown
from proprio_ros.recordings.motions import Motion
from proprio_ros.robot import Robot
from proprio_ros.sim.payload import PayloadFacts

UNSTATED_TORQUE_STD = 0.2
"""A torque constant without a standard deviation is a maker's number; a motor board's own torque was seen to be off by 17 %."""
# No mass is stated where the torque's scale is known worse than this, relative.
KNOWN_TORQUE_STD = 0.03
FREE_SHARE = 0.6
"""A joint whose acceleration gravity explains so far, as that of a pendulum about as long as the lever, needs no motor to move."""
# An effort of one sign that is explained no better than to this share is taken for a magnitude.
MAGNITUDE_SHARE = 0.1
LOAD_SHARE = 1.0  # The load must take as much of the torque as all the rest does, rms over rms.
LEAST_LENGTH_SHARE = 0.2
"""No pendulum is this short, in parts of its lever: it would have its mass there and no inertia."""
# No length of the equivalent pendulum is given whose half width is more than this share of it.
LONGEST_SHARE = 0.25
AWRY_RAD = 0.15  # The load hangs where the URDF says, but for this.
LEAST_FRICTION_SHARE = 0.02  # Friction is stated no better than to this share of the torque.

EMF_SHARE = 0.3  # Back EMF is a maker's number, over a winding that warms up.


@dataclass(frozen=True)
class Weighed:
    """The payload as the fit and the robot file have it."""

    # mass, std: [kg]
    mass: float
    std: float
    # what puts how much standard deviation on the mass, in words and [kg]
    parts: tuple[tuple[str, float], ...]
    torque_std: float  # of the torque's scale, relative
    # length of the equivalent pendulum that arm and payload make by the robot file, and its standard deviation [m]
    expected_m: tuple[float, float]
    # angle between where gravity's moment points and where the file says [rad], and its standard deviation
    awry: tuple[float, float]
    arm_kg_m: float  # first moment of the arm [kg m]
    lever_m: float  # from the joint's axis to the payload [m]
    # first moment of the empty arm over that of its URDF; None without a motion of it
    arm_over_urdf: float | None
    per_kg: np.ndarray  # see `Carried`, shape (3,)


def torque_std(robot: Robot, joint: str) -> float:
    """How well a measured effort is a torque, relative: as well as the file says that it knows the torque constant."""
    if robot.drive_trains[joint].torque_constant.std > 0.0 or robot.is_calibrated():
        return relative_torque_std(robot, joint)
    return UNSTATED_TORQUE_STD


def identify_one_joint(
    robot: Robot, motions: Sequence[Motion], baseline: Sequence[Motion], facts: PayloadFacts
) -> Estimate:
    """Identify how the joint swings, and the payload that all ``motions`` share.

    Args:
        robot: Of one joint that turns.
        motions: With the payload, at least one.
        baseline: The same with an empty hand; without any the URDF's bodies are the arm.
        facts: Where the payload's centre is.

    Raises `RecordingError`: A motion is of no use.
    """
    (joint,) = motions[0].joints
    fit = fit_one_joint(robot, motions, joint)
    empty = fit_one_joint(robot, baseline, joint) if baseline else None
    weighed = _weighed(robot, motions[0], fit, empty, facts)
    refusal = mass_refusal = judge(_refusals(motions[0], fit, weighed))
    if not refusal.withheld:
        of_empty = _refusals(baseline[0], empty, weighed) if empty is not None else ()
        mass_refusal = judge(chain(of_empty, _mass_refusals(robot, motions[0], fit, weighed)))
    return _estimate(robot, motions, fit, empty, weighed, refusal, mass_refusal)


@dataclass(frozen=True)
class _Arm:
    """What the arm without its payload pulls with about the joint."""

    moment: np.ndarray  # first moment along both directions of `Hinge` [kg m], (2,)
    std: float  # of it, along the payload's lever [kg m]
    over_urdf: float | None  # its size over the URDF's; None without a motion of the empty hand


def _arm_std(robot: Robot, joint: str) -> float:
    """How well the URDF's bodies are known, relative."""
    return robot.arm_scale.std if robot.is_calibrated([joint]) else URDF_SHARE


def _arm(
    robot: Robot, joint: str, hangs: Carried, empty: OneJointFit | None, toward: np.ndarray
) -> _Arm:
    """As the empty hand's motion shows it, else by the URDF; ``toward`` is the unit vector along the payload's lever."""
    by_urdf = hangs.arm[1:]
    size = float(np.linalg.norm(by_urdf))
    if empty is None:
        return _Arm(by_urdf, _arm_std(robot, joint) * size, None)
    moment = empty.values[2:]
    return _Arm(
        moment,
        float(np.sqrt(toward @ empty.covariance[2:, 2:] @ toward)),
        float(np.linalg.norm(moment) / max(size, 1e-9)),
    )


def _weighed(
    robot: Robot, motion: Motion, fit: OneJointFit, empty: OneJointFit | None, facts: PayloadFacts
) -> Weighed:
    hangs = carried_by(robot, fit.joint, motion, facts)
    lever = hangs.per_kg[1:]  # (2,)
    length = max(float(np.linalg.norm(lever)), 1e-6)
    toward = lever / length
    arm = _arm(robot, fit.joint, hangs, empty, toward)
    carried = fit.values[2:] - arm.moment
    mass = float(carried @ toward) / length
    relative = torque_std(robot, fit.joint)
    if arm.over_urdf is not None and abs(arm.over_urdf - 1.0) > URDF_SHARE:
        relative = float(np.hypot(relative, arm.over_urdf - 1.0))
    # against the URDF an error of the scale takes its share of the whole moment, against the empty arm of the payload's alone
    scaled = mass if empty is not None else float(fit.values[2:] @ toward) / length
    differs = float(np.sqrt(toward @ fit.covariance[2:, 2:] @ toward)) / length
    parts = (
        ("what differs from stretch to stretch", differs),
        ("torque constants", abs(scaled) * relative),
        ("the arm itself", arm.std / length),
        ("place of the payload", abs(mass) * hangs.centre_std_m / length),
    )
    expected_moment = hangs.arm[1:] + mass * lever
    return Weighed(
        mass,
        float(np.sqrt(sum(part**2 for _, part in parts))),
        parts,
        relative,
        _expected_length(robot, fit.joint, hangs, mass, facts),
        _awry(fit, expected_moment),
        float(np.linalg.norm(arm.moment)),
        length,
        arm.over_urdf,
        hangs.per_kg,
    )


def _expected_length(
    robot: Robot, joint: str, hangs: Carried, mass: float, facts: PayloadFacts
) -> tuple[float, float]:
    """Of the pendulum that arm, rotor and payload make by the robot file, inertia over first moment, and its std [m]."""
    lever = hangs.per_kg[1:]
    length = max(float(np.linalg.norm(lever)), 1e-6)
    moment = max(float(np.linalg.norm(hangs.arm[1:] + mass * lever)), 1e-9)
    arm_inertia = float(hangs.arm[0])
    armature = robot.drive_trains[joint].armature
    inertia = arm_inertia + armature.value + mass * length**2
    object_inertia = abs(mass) * float(np.trace(facts.shape.second_moment_per_mass))
    inertia_std = np.hypot(_arm_std(robot, joint) * arm_inertia, armature.std) + object_inertia
    expected = inertia / moment
    std = float(np.hypot(inertia_std / moment, expected * hangs.centre_std_m / length))
    return expected, std


def _awry(fit: OneJointFit, expected_moment: np.ndarray) -> tuple[float, float]:
    """Angle from where gravity's moment points to where the robot file says, and its standard deviation [rad]."""
    size = max(float(np.linalg.norm(fit.values[2:])), 1e-9)
    pointing = fit.values[2:] / size
    across = np.array([-pointing[1], pointing[0]])
    angle = float(np.arctan2(across @ expected_moment, pointing @ expected_moment))
    return angle, float(np.sqrt(across @ fit.covariance[2:, 2:] @ across)) / size


def _refusals(motion: Motion, fit: OneJointFit, weighed: Weighed) -> Iterator[Refusal]:
    """Why nothing at all is said."""
    friction_squared = fit.driven**2 - fit.load**2 - fit.residual**2
    rest = float(np.hypot(fit.residual, np.sqrt(max(friction_squared, 0.0))))
    unexplained = fit.residual / max(fit.driven, 1e-12)
    percent = f"{100.0 * unexplained:.0f} %"
    if fit.one_sign and unexplained > MAGNITUDE_SHARE:
        yield rejected(
            "misfit",
            "the effort has no sign",
            f"{motion.name}: the effort of {fit.joint} never changes its sign, and {percent} of it is not explained "
            "by inertia, gravity and friction: it seems to be a magnitude, which says nothing about a load; record one with a sign",
        )
    by_itself = fit.free_share > FREE_SHARE and 0.5 < fit.free_m / weighed.lever_m < 2.0
    if unexplained > UNEXPLAINED_SHARE and by_itself:
        yield not_identifiable(
            "within_friction",
            "the torque lies within friction",
            f"{motion.name}: {fit.joint} swings almost by itself: gravity explains {100.0 * fit.free_share:.0f} % of its "
            f"acceleration, and the motor's {shown('N m', fit.driven, spec='.3g')} (rms) are of the size of friction, so they say "
            "little about the load: record a motion in which the motor lifts, holds back and turns the load round",
        )
    inertia = float(fit.values[1])
    inertia_std = float(fit.std[1])
    unseen = (
        abs(inertia) < fit.quantile * inertia_std
        or 0.0 < float(fit.values[0]) < LEAST_LENGTH_SHARE * weighed.lever_m
    )
    if unexplained <= UNEXPLAINED_SHARE and unseen:
        yield not_identifiable(
            "says_too_little",
            "the motion says too little",
            f"{motion.name}: the effort of {fit.joint} is gravity's and friction's and shows no inertia: the joint moves too "
            "slowly, or the effort was computed, not measured; let the motor accelerate it",
        )
    if unexplained > UNEXPLAINED_SHARE or inertia <= 0.0:
        share = (
            f"{percent} of its effort is not explained"
            if inertia > 0.0
            else "its inertia came out negative"
        )
        yield rejected(
            "misfit",
            "the model does not explain the recording",
            f"{motion.name}: {fit.joint} does not move as inertia, gravity and friction would have it under its effort ({share}): "
            "check its unit and sign; a duty cycle or a position error is no torque; did anything touch the arm?",
        )
    if fit.load < LOAD_SHARE * rest:
        yield not_identifiable(
            "within_friction",
            "the torque lies within friction",
            f"{motion.name}: inertia and gravity take {shown('N m', fit.load, spec='.3g')} of the effort (rms), friction and what "
            f"is unexplained {shown('N m', rest, spec='.3g')}: so little says nothing about the load; move faster and further",
        )
    half = fit.quantile * float(fit.std[0])
    if half > LONGEST_SHARE * float(fit.values[0]):
        yield not_identifiable(
            "says_too_little",
            "the motion says too little",
            f"{motion.name}: how the load swings is determined only to {float(fit.values[0]):.3f} +- {half:.3f} m: the "
            "joint must both turn through large angles and accelerate, for longer than the "
            f"{STRETCH_S * fit.stretches:.0f} s used here",
        )


def _mass_refusals(
    robot: Robot, motion: Motion, fit: OneJointFit, weighed: Weighed
) -> Iterator[Refusal]:
    """Why no mass is said."""
    drive = robot.drive_trains[fit.joint]
    confirmed = weighed.arm_over_urdf is not None or robot.is_calibrated([fit.joint])
    if weighed.torque_std > KNOWN_TORQUE_STD or not confirmed:
        states = f"knows it to {100.0 * weighed.torque_std:.0f} %"
        if weighed.torque_std <= KNOWN_TORQUE_STD:
            states = "claims to know it, but nothing confirms that"
        elif drive.torque_constant.std == 0.0:
            states = "states no standard deviation of it"
        yield not_identifiable(
            "torque_scale_open",
            "the scale of the torque is not known well enough",
            f"a mass errs as the torque of {fit.joint} does, and {robot.source.name} {states} (a motor board's own torque was seen "
            "to be off by 17 %): calibrate with a reference weight; or measure the torque constant, state a std of "
            f"{100.0 * KNOWN_TORQUE_STD:.0f} % or less and add a motion with an empty hand with --baseline. The length of the "
            "equivalent pendulum needs none of it",
        )
    if weighed.arm_over_urdf is not None:
        yield from unlike_urdf(weighed.arm_over_urdf, motion)
    angle, angle_std = weighed.awry
    if abs(angle) > max(AWRY_RAD, FAR * angle_std):
        yield rejected(
            "arm_unlike_urdf",
            "the load hangs elsewhere than the URDF says",
            f"{motion.name}: gravity pulls {fit.joint} to a position {abs(angle):.2f} rad from where its URDF and payload.com have "
            "the load: check the URDF's zero, the effort's sign and payload.com",
        )
    least = LEAST_FRICTION_SHARE * fit.driven
    damping = drive.electric_damping
    viscous = Quantity(
        drive.viscous.value + damping, float(np.hypot(drive.viscous.std, EMF_SHARE * damping))
    )
    for term, value, stated in (
        ("viscous", fit.viscous, viscous),
        ("Coulomb", fit.coulomb, drive.coulomb),
    ):
        spread = max(stated.std, 0.5 * abs(stated.value), least)
        if abs(value - stated.value) > FAR * spread:
            yield rejected(
                "far_from_prior",
                "the friction is not that of the robot file",
                f"{term} friction of {fit.joint} came out as {value:.3g}, {abs(value - stated.value) / spread:.0f} standard "
                f"deviations from the {stated.value:.3g} of {robot.source.name}: is the effort a torque or a current, and in the "
                "stated unit? A duty cycle makes friction of its own",
            )
    expected, expected_std = weighed.expected_m
    apart = abs(float(fit.values[0]) - expected)
    spread = float(np.hypot(expected_std, fit.std[0]))
    if apart > max(FAR * spread, 0.05 * expected):
        yield rejected(
            "arm_unlike_urdf",
            "the load does not swing as the robot file says",
            f"{motion.name}: {fit.joint} swings like a pendulum of {float(fit.values[0]):.3f} m, and the URDF with such a payload "
            f"there makes {expected:.3f} m ({apart / spread:.0f} standard deviations): check the effort's unit, the URDF, the "
            "armature, payload.com and payload.shape",
        )
    half = fit.quantile * weighed.std
    advice = "check the URDF's masses, or are the recordings mixed up?"
    yield from lighter_than_empty(weighed.mass, half, advice)
    yield from interval_too_wide(
        LIMIT_OF_ONE_JOINT, weighed.mass, half, errs_most_by(weighed.parts)
    )


def _estimate(
    robot: Robot,
    motions: Sequence[Motion],
    fit: OneJointFit,
    empty: OneJointFit | None,
    weighed: Weighed,
    refusal: Refusal,
    mass_refusal: Refusal,
) -> Estimate:
    if refusal.withheld:
        length = Value("equivalent_pendulum_length", "m", None, reason=refusal.withheld)
    else:
        value = float(fit.values[0])
        std = float(fit.std[0])
        bounds = [value - fit.quantile * std, value + fit.quantile * std]
        length = Value("equivalent_pendulum_length", "m", value, std, bounds)
    arm = (
        "an empty hand in the same motion"
        if empty is not None
        else f"the bodies of the URDF, to {100.0 * URDF_SHARE:.0f} %"
    )
    mass = positive(
        "payload_mass",
        "kg",
        weighed.mass,
        weighed.std,
        mass_refusal.withheld,
        quantile=fit.quantile,
    )
    return motion_answer(
        robot,
        motions,
        mass_refusal,
        (mass, length),
        (
            f"one joint moved under a controller: the {motions[0].source} and the positions were fitted together; inertia over "
            "first moment, the length of the equivalent pendulum, needs no scale of the torque, and is that of arm, rotor and "
            "payload together",
            f"the arm itself is {arm}, {weighed.arm_kg_m:.3g} kg m about the joint",
            f"torque constant as in {robot.source.name}, to {100.0 * weighed.torque_std:.1f} %: a mass errs as it does",
            "friction is that of each recording: Coulomb, viscous, a share of the torque, and an offset",
        ),
        fit=Fit(
            fit.residual,
            fit.residual if empty is None else empty.residual,
            1.0,
            "N m",
        ),
        budget=weighed.parts,
        detail=MotionDetail(fit.stretches, (), STRETCH_S),
        shown=shown_of(
            [motion.name for motion in motions],
            fit.joint,
            fit.windows,
            fit.left_over,
            weighed.per_kg,
            weighed.mass,
            fit.residual if empty is None else empty.residual,
        ),
    )
