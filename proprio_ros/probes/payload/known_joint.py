"""What a joint carries that was calibrated by motions with known loads, from any motion under a controller."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from proprio_ros.calibration_files.one_joint import JointCalibration
from proprio_ros.errors import RobotError
from proprio_ros.identification.estimate import Estimate, Fit, Value, Verdict
from proprio_ros.identification.judge import Refusal, not_identifiable, rejected
from proprio_ros.identification.regression.motion_estimate import UNEXPLAINED_SHARE
from proprio_ros.identification.regression.one_joint_fit import STRETCH_S
from proprio_ros.identification.regression.one_joint_known import KnownJointFit, weigh_by_joint
from proprio_ros.probes.payload.moving import WIDEST_SHARE, MotionDetail
from proprio_ros.quantity import shown
from proprio_ros.recordings.motions import Motion
from proprio_ros.robot import Robot
from proprio_ros.sim.payload import PayloadFacts

MISFIT_RATIO = 5.0
"""A motion may be explained so much worse than those of the calibration, which may have been gentler."""


def weigh_known_joint(
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
        RobotError: The torque constant is no longer that of the calibration.
    """
    constant = robot.drive_trains[calibration.joint].torque_constant.value
    if abs(constant / calibration.torque_constant - 1.0) > 1e-6:
        raise RobotError(
            f"{robot.source.name}: the torque constant of {calibration.joint} is {constant:g} N m/A, but it was calibrated with "
            f"{calibration.torque_constant:g}: calibrate again"
        )
    fit = weigh_by_joint(robot, motions, calibration, facts)
    refusal = next(_refusals(motions[0], calibration, fit), None)
    if refusal is not None:
        mass = Value("payload_mass", "kg", None, reason=refusal.withheld)
    else:
        half = fit.quantile * fit.std
        bounds = [max(fit.mass - half, 0.0), max(fit.mass + half, 0.0)]
        mass = Value("payload_mass", "kg", max(fit.mass, 0.0), fit.std, bounds)
    loads = calibration.loads_kg
    return Estimate(
        probe="payload",
        robot=robot.name,
        verdict=Verdict.ACCEPTED if refusal is None else refusal.verdict,
        reasons=() if refusal is None else tuple(refusal.reasons),
        values=(mass,),
        fit=Fit(fit.residual, calibration.residual, fit.residual / calibration.residual, "N m"),
        solver=None,
        runs=len(motions),
        budget=tuple(sorted(fit.parts, key=lambda part: -part[1])),
        detail=MotionDetail(fit.stretches, (), STRETCH_S),
        assumptions=(
            f"one joint moved under a controller: the {motions[0].source} and the positions, with torque, rotor and friction as "
            f"{len(loads)} motions with known loads of {shown('kg', float(loads.min()), spec='.0f')} to "
            f"{shown('kg', float(loads.max()), spec='.0f')} showed them",
            f"masses differ by {100.0 * calibration.spread:.2g} % from recording to recording, as those of the known loads did: "
            "friction is not the same every time",
            "each recording has an offset of its own; samples in which the joint creeps do not count",
            "the servo's settings and its zero are what they were then: one joint alone does not show whether they changed, and "
            "a mass errs as the torque does",
        ),
        notes=tuple(note for motion in motions for note in motion.notes),
    )


def _refusals(motion: Motion, calibration: JointCalibration, fit: KnownJointFit) -> Iterator[Refusal]:
    joint, half = calibration.joint, fit.quantile * fit.std
    unexplained = fit.residual / max(fit.driven, 1e-12)
    if unexplained > UNEXPLAINED_SHARE or fit.residual > MISFIT_RATIO * calibration.residual:
        yield rejected(
            "misfit",
            "the model does not explain the recording",
            f"{motion.name}: {100.0 * unexplained:.0f} % of the torque of {joint} is not explained by any load with what its "
            "calibration knows: did anything touch the arm, or is the servo set otherwise than then?",
        )
    if fit.mass + half < 0.0:
        yield rejected(
            "lighter_than_empty",
            "the hand seems lighter than empty",
            f"the hand with its load seems {shown('kg', -fit.mass, spec='.0f')} lighter than with nothing in it: check the URDF's "
            "masses and the loads of the calibration",
        )
    if fit.at_the_end or half > WIDEST_SHARE * abs(fit.mass):
        yield not_identifiable(
            "says_too_little",
            "the interval is too wide to state a mass",
            f"{motion.name}: this motion determines the mass only to +-{shown('kg', min(half, 1e6), spec='.0f')}; what it errs by "
            f"most: {max(fit.parts, key=lambda part: part[1])[0]}; lift and lower the load, faster and for longer than the "
            f"{STRETCH_S * fit.stretches:.0f} s used here",
        )
