"""What a joint carries that was calibrated by motions with known loads, from any motion under a controller."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from proprio_ros.calibration_files.one_joint import OWN_TERMS, JointCalibration
from proprio_ros.identification.estimate import LIMIT_OF_ONE_JOINT, Estimate, Fit
from proprio_ros.identification.judge import Refusal, judge, positive, rejected
from proprio_ros.identification.regression.motion_fit import check_torque_constant
from proprio_ros.identification.regression.one_joint_fit import STRETCH_S
from proprio_ros.identification.regression.one_joint_known import (
    KnownJointFit,
    check_law,
    identify_by_joint,
)
from proprio_ros.identification.regression.refusals import (
    errs_most_by,
    interval_too_wide,
    lighter_than_empty,
)
from proprio_ros.identification.same_joint import another_joint, outside
from proprio_ros.probes.payload.moving import MotionDetail, motion_answer
from proprio_ros.quantity import shown
from proprio_ros.recordings.motions import Motion
from proprio_ros.robot import Robot
from proprio_ros.sim.payload import PayloadFacts

COVERED = 2.5
"""A load may be so many times outside of those known: its torque is, and its interval is wider for the distance."""
MISFIT_SHARE = 0.25
"""A joint whose torque is unexplained by more than this share is another, or its effort is: of two real servos no load leaves more
than 17 % unexplained by their own calibrations, and 33 % at least where the effort is another servo's and has no sign."""
MISFIT_RATIO = 5.0
"""A motion may be explained so much worse than those of the calibration, which may have been gentler."""
WORSE = 2.0
"""Where a mass is told too coarsely, and its motion is explained so much worse, that is the first to be looked into."""


def identify_known_joint(
    robot: Robot, motions: Sequence[Motion], calibration: JointCalibration, facts: PayloadFacts
) -> Estimate:
    """Identify the payload that all ``motions`` share.

    Args:
        robot: Of one joint that turns.
        motions: At least one.
        calibration: Of this very joint.
        facts: Where the payload sits.

    Raises:
        RecordingError: A motion is of no use.
        RobotError: The torque constant, or the servo's law, is no longer that of the calibration.
    """
    check_torque_constant(robot, calibration.joint, calibration.torque_constant, "it was")
    check_law(robot, calibration)
    fit = identify_by_joint(robot, motions, calibration, facts)
    refusal = judge(_refusals(motions[0], calibration, fit))
    loads = calibration.loads_kg
    return motion_answer(
        robot,
        motions,
        refusal,
        [
            positive(
                "payload_mass", "kg", fit.mass, fit.std, refusal.withheld, quantile=fit.quantile
            )
        ],
        (
            f"one joint moved under a controller: the {motions[0].source} and the positions, with torque, rotor and friction as "
            f"{len(loads)} motions with known loads of {shown('kg', float(loads.min()), spec='.0f')} to "
            f"{shown('kg', float(loads.max()), spec='.0f')} showed them",
            f"masses differ by {100.0 * calibration.spread:.2g} % from recording to recording, as those of the known loads did: "
            "friction is not the same every time",
            "each recording has an offset of its own; samples in which the joint creeps do not count",
            "servo, gain and supply are those of the calibration, as far as rotor and friction show it, and so its zero; arm, "
            "payload's inertia and known loads are as they were stated: a longer arm is like a heavier load, a shorter one like a "
            "lighter one, and a mass errs as they do",
        ),
        fit=Fit(
            fit.residual,
            calibration.residual,
            fit.residual / calibration.residual,
            "N m",
        ),
        budget=fit.parts,
        detail=MotionDetail(fit.stretches, (), STRETCH_S),
        shown=fit.shown,
    )


def _refusals(
    motion: Motion, calibration: JointCalibration, fit: KnownJointFit
) -> Iterator[Refusal]:
    joint = calibration.joint
    half = fit.quantile * fit.std
    unexplained = fit.residual / max(fit.driven, 1e-12)
    yield from another_joint(joint, OWN_TERMS, calibration.own_terms, fit.own_terms)
    if unexplained > MISFIT_SHARE or fit.residual > MISFIT_RATIO * calibration.residual:
        yield rejected(
            "misfit",
            "the model does not explain the recording",
            f"{motion.name}: {100.0 * unexplained:.0f} % of the torque of {joint} is not explained by any load with what its "
            "calibration knows: did anything touch the arm, is the servo set otherwise than then, or are goals cut off?",
        )
    yield from lighter_than_empty(
        fit.mass, half, "check the URDF's masses and the loads of the calibration"
    )
    advice = (
        f"{errs_most_by(fit.parts)}; lift and lower the load, faster and for longer than the "
        f"{STRETCH_S * fit.stretches:.0f} s used here"
    )
    worse = fit.residual / calibration.residual
    if worse > WORSE:
        advice += (
            f"; it is explained {worse:.1f} times worse than the motions of its calibration: are goals late or cut off, or was the "
            "servo set otherwise?"
        )
    # a mass at the end of what was looked for may be any
    width_limit = replace(LIMIT_OF_ONE_JOINT, share=0.0) if fit.at_the_end else LIMIT_OF_ONE_JOINT
    yield from interval_too_wide(width_limit, fit.mass, half, advice, f"{motion.name}: this motion")
    yield from outside(joint, fit.mass, calibration.loads_kg.tolist(), COVERED)
