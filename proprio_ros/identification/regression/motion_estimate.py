"""A calibration from motions of several joints with an empty hand: what it is worth, and whether it can be believed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from proprio_ros.calibration_files.motions import MotionCalibration
from proprio_ros.errors import RecordingError
from proprio_ros.identification.calibration_estimate import (
    CalibrationEstimate,
    EmptyHandEstimate,
    Weighable,
)
from proprio_ros.identification.estimate import LIMIT_OF_CALIBRATION, UnknownRow
from proprio_ros.identification.judge import Refusal, judge, not_identifiable
from proprio_ros.identification.regression import refusals
from proprio_ros.identification.regression.causes import with_cause
from proprio_ros.identification.regression.motion_equations import Arm, once_each
from proprio_ros.identification.regression.motion_fit import (
    Centre,
    FittedTerms,
    MotionFit,
    fit_empty,
    fit_payload,
    held_by_file,
    learn_arm,
    share_of,
)
from proprio_ros.identification.regression.motion_prior import file_prior, relative_torque_std
from proprio_ros.identification.regression.solve import Prior
from proprio_ros.identification.regression.time_axis import (
    with_read_time_axis,
    with_time_axes,
    with_time_axes_named,
)
from proprio_ros.identification.regression.torque_scale import Reference, scaled_by_references
from proprio_ros.identification.unknowns import Role
from proprio_ros.quantity import Z95, shown
from proprio_ros.recordings.motions import Motion
from proprio_ros.records import FloatArray
from proprio_ros.robot import Robot

SHOWN_SHARE = 0.1  # The headline is for an object of this share of the arm's mass.
OWN_SHARE = 1.0 / 3.0
"""A joint's torque may be off from the others' by this share of what its file leaves open: motors of one maker are off together."""


@once_each()
def calibrate_motions(
    robot: Robot,
    motions: Sequence[Motion],
    references: Sequence[Reference] = (),
    centre: Centre | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> CalibrationEstimate:
    """Learn an arm from motions with an empty hand.

    Args:
        robot: As its file states it.
        motions: With an empty hand, at least one.
        references: With a weighed object; they tell the scale of the torque constants.
        centre: Of the references, and its standard deviation, where that was stated; see `fit_payload`.
        progress: Called with what is going on.

    Raises `RecordingError`: A motion is of no use.
    """
    robot = replace(robot, motion_calibration=None)
    progress(f"fitting {len(motions)} motions")
    followed = with_time_axes(robot, motions)
    calibration, fits = learn_arm(robot, followed)
    refusal = _refusal(robot, motions, followed, calibration)
    if not refusal.withheld and references:
        progress("weighing the references")
        loaded = [motion for motion, _ in references]
        masses_kg = [mass_kg for _, mass_kg in references]
        loaded = with_time_axes(robot, loaded, calibration, loaded=True)
        references = list(zip(loaded, masses_kg, strict=True))
        calibration, refusal = scaled_by_references(robot, calibration, references, centre)
    recorded = [*followed, *(motion for motion, _ in references)]
    if not refusal.withheld:
        calibration = with_read_time_axis(robot, recorded, calibration)
    progress("weighing each empty motion by the others")
    weighed = () if refusal.withheld else _weighed_empty(robot, followed)
    arm = Arm.of(
        robot,
        calibration.joints,
        dict(followed[0].held),
    )
    weighable = None
    if not refusal.withheld:
        weighable = _weighable(robot, followed, calibration, weighed, arm.kg)
        if LIMIT_OF_CALIBRATION.exceeded_by(weighable.mass_kg, Z95 * weighable.std_kg):
            refusal = _would_be_too_wide(weighable)
            weighable = None
    return CalibrationEstimate(
        robot=robot.name,
        verdict=refusal.verdict,
        reasons=refusal.reasons,
        runs=len(recorded),
        calibration=None,
        motion=calibration,
        unknowns=_unknown_rows(calibration, file_prior(robot, arm)),
        notes=tuple(note for motion in recorded for note in motion.notes),
        weighable=weighable,
        weighed_empty=weighed,
        joint_fits=fits,
    )


def _refusal(
    robot: Robot,
    as_stamped: Sequence[Motion],
    followed: Sequence[Motion],
    calibration: MotionCalibration,
) -> Refusal:
    """The verdict on an arm that was learnt of motions whose clocks were followed, with its cause."""
    refused = judge(calibration_refusals(robot, followed, calibration))
    share = float(np.nan_to_num(_unexplained(followed, calibration)).max())
    by_mistake = with_cause(refused, robot, (), as_stamped, share)
    if by_mistake is not None:
        return by_mistake
    return with_time_axes_named(refused, followed)


def _would_be_too_wide(weighable: Weighable) -> Refusal:
    mass = shown("kg", weighable.mass_kg, spec=".0f")
    half = shown("kg", Z95 * weighable.std_kg, spec=".0f")
    return not_identifiable(
        "says_too_little",
        "the interval would be too wide to state a mass",
        f"with these motions {mass} could only be weighed to "
        f"+-{half}: record longer and faster ones, through more attitudes",
    )


def _unknown_rows(calibration: MotionCalibration, prior: Prior) -> tuple[UnknownRow, ...]:
    """Each of the arm's terms beside what its robot file says of it."""
    prior_std = np.sqrt(np.diag(prior.covariance))
    std = calibration.std
    return tuple(
        UnknownRow(
            kind,
            scope=joint,
            role=Role.ESTIMATED.value,
            prior=prior.values[term],
            prior_std=prior_std[term],
            value=calibration.values[term],
            std=std[term],
        )
        for term, (kind, joint) in enumerate(calibration.keys)
    )


def calibration_refusals(
    robot: Robot, motions: Sequence[Motion], calibration: MotionCalibration
) -> Iterator[Refusal]:
    """Why a calibration is not believed that was made of motions with an empty hand.

    ``robot``: as its file states it; ``motions``: with an empty hand; ``calibration``: of them.
    """
    share = refusals.deciding(calibration.tells, _unexplained(motions, calibration))
    yield from refusals.unexplained_torque(calibration.joints, share, "the arm and its friction")
    arm = Arm.of(
        robot,
        calibration.joints,
        dict(motions[0].held),
    )
    prior = file_prior(robot, arm)
    # the prior has what a joint's torque repeats to; what its file leaves open is more, most of it in common with the others
    open_yet = [
        OWN_SHARE * relative_torque_std(robot, joint) if kind == "torque_share" else 0.0
        for kind, joint in calibration.keys
    ]
    std = np.hypot(
        np.sqrt(np.diag(prior.covariance)),
        open_yet,
    )
    learnt = FittedTerms(
        calibration.keys,
        calibration.values,
        prior.values,
        std,
    )
    unlike = [
        *refusals.unlike_urdf(calibration.arm_over_urdf, motions[0]),
        *refusals.far_from_prior(learnt, "robot file"),
    ]
    if not unlike:
        return
    held = held_by_file(robot, motions)
    shared = slice(0, len(held.arm))  # what differs from motion to motion is open
    with_it = FittedTerms(
        calibration.keys[shared],
        held.arm,
        prior.values[shared],
        std[shared],
    )
    if not any(refusals.far_from_prior(with_it, "robot file")):
        yield from refusals.held_when_empty(held)
    yield from unlike


def _unexplained(motions: Sequence[Motion], calibration: MotionCalibration) -> FloatArray:
    """Share of each joint's torque that a calibration leaves over of its motions, shape (n,)."""
    torques = [
        motion.current_A[:, [motion.joints.index(joint) for joint in calibration.joints]]
        * calibration.torque_constants
        for motion in motions
    ]
    # 0 for a joint whose torque was never measured
    known = np.nan_to_num(np.vstack(torques))
    driven = np.sqrt(np.mean(np.square(known), axis=0))
    return share_of(calibration.residual, driven)


def _weighed_empty(robot: Robot, motions: Sequence[Motion]) -> tuple[EmptyHandEstimate, ...]:
    """Each motion weighed by the calibration of the others; a single one in two halves. What they read is the error to expect."""
    parts = list(motions)
    if len(parts) == 1:
        middle = 0.5 * float(parts[0].times_s[-1])
        parts = [
            _between(parts[0], 0.0, middle, "first half"),
            _between(parts[0], middle, np.inf, "second half"),
        ]
    weighed = []
    for number, part in enumerate(parts):
        others = [*parts[:number], *parts[number + 1 :]]
        try:
            fit = fit_payload(
                robot,
                [part],
                fit_empty(robot, others),
            )
        except RecordingError:
            continue  # too short to be halved: then the fit's own word has to do
        mass_kg = float(fit.values[0])
        weighed.append(EmptyHandEstimate(part.name, mass_kg, float(fit.std[0]), fit.quantile))
    return tuple(weighed)


def _between(
    motion: Motion,
    first_s: float,
    last_s: float,
    words: str,
) -> Motion:
    rows = (motion.times_s >= first_s) & (motion.times_s < last_s)
    return replace(motion.part(rows), name=f"{motion.name}, {words}")


def _longest_weighed(
    robot: Robot, motions: Sequence[Motion], calibration: MotionCalibration
) -> MotionFit:
    """The longest motion weighed, together with the next ones where it is too short by itself."""
    longest = sorted(motions, key=lambda motion: -float(motion.times_s[-1]))
    for count in range(1, len(longest)):
        try:
            return fit_payload(robot, longest[:count], calibration)
        except RecordingError:
            continue
    return fit_payload(robot, longest, calibration)


def _weighable(
    robot: Robot,
    motions: Sequence[Motion],
    calibration: MotionCalibration,
    weighed: Sequence[EmptyHandEstimate],
    arm_kg: float,
) -> Weighable:
    """What an object in a motion like the longest of these would be weighed to."""
    fit = _longest_weighed(robot, motions, calibration)
    std_kg = float(fit.std[0])
    nothing_kg = 0.5 * (fit.quantile / Z95) * std_kg + 0.5 * std_kg
    if len(motions) > 1 and weighed:
        squares = [each.mass_kg**2 for each in weighed]
        nothing_kg = max(nothing_kg, float(np.sqrt(np.mean(squares))))
    mass_kg = float(f"{SHOWN_SHARE * arm_kg:.1g}")
    share = calibration.torque_scale_std
    return Weighable(
        mass_kg,
        float(np.hypot(nothing_kg, share * mass_kg)),
        calibration.joints,
        f"an empty hand to +-{shown('kg', Z95 * nothing_kg, spec='.0f')}, and any mass to +-{100.0 * Z95 * share:.0f} % at best: "
        f"{_why_no_better(calibration)}",
    )


def _why_no_better(calibration: MotionCalibration) -> str:
    """Why torque constants are known no better than they are."""
    if calibration.referenced:
        return "that is how well the reference tells the torque constants"
    share = calibration.torque_scale_std
    if share > 0.0 and abs(calibration.arm_over_urdf - 1.0) > 0.5 * share > 0.02:
        return (
            f"by its torques the arm weighs {calibration.arm_over_urdf:.2f} times what its URDF says, and torque constants or URDF "
            "are off by that: a motion with a weighed object, --reference BAG=KG, would tell which"
        )
    return "torque constants are known no better: a motion with a weighed object, --reference BAG=KG, would tell them"
