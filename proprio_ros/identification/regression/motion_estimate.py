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
from proprio_ros.identification.estimate import UnknownRow
from proprio_ros.identification.judge import (
    ACCEPTED,
    FAR,
    Refusal,
    judge,
    not_identifiable,
    rejected,
)
from proprio_ros.identification.reasons import Reason
from proprio_ros.identification.regression import refusals
from proprio_ros.identification.regression.causes import with_cause
from proprio_ros.identification.regression.clocks import with_clocks, with_clocks_named
from proprio_ros.identification.regression.motion_equations import Arm, once_each
from proprio_ros.identification.regression.motion_fit import (
    Centre,
    MotionFit,
    fit_payload,
    held_by_file,
    learn_arm,
    share_of,
)
from proprio_ros.identification.regression.motion_prior import file_prior, relative_torque_std
from proprio_ros.identification.unknowns import Role
from proprio_ros.quantity import Z95, shown
from proprio_ros.recordings.motions import Motion
from proprio_ros.records import FloatArray
from proprio_ros.robot import Robot

SHOWN_SHARE = 0.1  # The headline is for an object of this share of the arm's mass.
LIGHT_REFERENCE = 0.45
"""A reference that is read with a greater relative half interval leaves torque constants as they are stated."""
OWN_SHARE = 1.0 / 3.0
"""A joint's torque may be off from the others' by this share of what its file leaves open: motors of one maker are off together."""

Reference = tuple[Motion, float]  # A motion with a weighed object in the hand, and its mass [kg].


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
    as_stamped = motions
    motions = with_clocks(robot, motions)
    calibration, fits = learn_arm(robot, motions)
    refused = judge(calibration_refusals(robot, motions, calibration))
    share = float(np.nan_to_num(_unexplained(motions, calibration)).max())
    refusal = with_cause(refused, robot, (), as_stamped, share)
    if refusal is refused:
        refusal = with_clocks_named(refusal, motions)
    if not refusal.withheld and references:
        progress("weighing the references")
        loaded = [motion for motion, _ in references]
        masses_kg = [mass_kg for _, mass_kg in references]
        followed = with_clocks(robot, loaded, calibration, loaded=True)
        references = list(zip(followed, masses_kg, strict=True))
        calibration, refusal = _scaled(robot, calibration, references, centre)
    recorded = [*motions, *(motion for motion, _ in references)]
    progress("weighing each empty motion by the others")
    weighed = () if refusal.withheld else _weighed_empty(robot, motions)
    arm = Arm.of(robot, calibration.joints, dict(motions[0].held))
    weighable = None
    if not refusal.withheld:
        weighable = _weighable(robot, motions, calibration, weighed, arm.kg, calibration.referenced)
        if Z95 * weighable.std_kg > weighable.mass_kg:
            refusal = not_identifiable(
                "says_too_little",
                "the interval would be too wide to state a mass",
                f"with these motions {shown('kg', weighable.mass_kg, spec='.0f')} could only be weighed to "
                f"+-{shown('kg', Z95 * weighable.std_kg, spec='.0f')}: record longer and faster ones, through more attitudes",
            )
            weighable = None
    prior = file_prior(robot, arm)
    return CalibrationEstimate(
        robot=robot.name,
        verdict=refusal.verdict,
        reasons=refusal.reasons,
        runs=len(motions) + len(references),
        calibration=None,
        motion=calibration,
        unknowns=tuple(
            UnknownRow(kind, scope=joint, role=Role.FREE.value, prior=p, prior_std=s, value=v, std=e)
            for (kind, joint), p, s, v, e in zip(
                calibration.keys, prior.values, np.sqrt(np.diag(prior.covariance)), calibration.values, calibration.std,
                strict=True,
            )
        ),
        notes=tuple(note for motion in recorded for note in motion.notes),
        weighable=weighable,
        weighed_empty=weighed,
        joint_fits=fits,
    )  # fmt: skip


def calibration_refusals(
    robot: Robot, motions: Sequence[Motion], calibration: MotionCalibration
) -> Iterator[Refusal]:
    """Why a calibration is not believed that was made of motions with an empty hand."""
    share = refusals.deciding(calibration.tells, _unexplained(motions, calibration))
    yield from refusals.unexplained_torque(calibration.joints, share, "the arm and its friction")
    arm = Arm.of(robot, calibration.joints, dict(motions[0].held))
    prior = file_prior(robot, arm)
    # the prior has what a joint's torque repeats to; what its file leaves open is more, most of it in common with the others
    open_yet = [
        OWN_SHARE * relative_torque_std(robot, joint) if kind == "torque_share" else 0.0
        for kind, joint in calibration.keys
    ]
    std = np.hypot(np.sqrt(np.diag(prior.covariance)), open_yet)
    unlike = [
        *refusals.unlike_urdf(calibration.arm_over_urdf),
        *refusals.far_from_prior(
            calibration.keys, calibration.values, prior.values, std, "robot file"
        ),
    ]
    if not unlike:
        return
    held = held_by_file(robot, motions)
    terms = slice(0, len(held.arm))  # what differs from motion to motion is open
    with_it = refusals.far_from_prior(
        calibration.keys[terms], held.arm, prior.values[terms], std[terms], "robot file"
    )
    if not any(with_it):
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
    driven = np.sqrt(np.mean(np.square(np.nan_to_num(np.vstack(torques))), axis=0))
    return share_of(calibration.residual, driven)


def _scaled(
    robot: Robot,
    calibration: MotionCalibration,
    references: Sequence[Reference],
    centre: Centre | None,
) -> tuple[MotionCalibration, Refusal]:
    """The calibration with the torque scale that the references show, or why they do not show it."""
    open_scale = replace(calibration, torque_scale=1.0, torque_scale_std=0.0)
    ratios: list[float] = []
    stds: list[float] = []
    said_coarse = ""
    fits = [
        (fit_payload(robot, [motion], open_scale, centre=centre), motion, kg)
        for motion, kg in references
    ]
    # the best one first: one that is too coarse beside others says nothing, and does no harm
    for fit, motion, mass_kg in sorted(
        fits, key=lambda fitted: float(fitted[0].std[0]) / fitted[2]
    ):
        doubts = list(refusals.other_zero(motion.name, fit))
        if centre is not None:
            doubts += refusals.centre_elsewhere(
                motion.name, centre, fit, fit_payload(robot, [motion], open_scale)
            )
        if doubts:
            return calibration, doubts[0]
        read = float(fit.values[0])
        std = float(fit.std[0])
        coarse = read <= 0.0 or fit.half_width > LIGHT_REFERENCE * mass_kg
        if coarse and (ratios or said_coarse):
            continue
        stated_as, read_as, off = (shown("kg", kg, spec=".0f") for kg in (mass_kg, read, std))
        said = f"{motion.name}: the reference of {stated_as} is read as {read_as} +- {off}, "
        if read + Z95 * std < 0.0:
            nothing = "the reference says nothing about the torque constants"
            said += "lighter than nothing: are the recordings mixed up?"
            return calibration, not_identifiable("says_too_little", nothing, said)
        ratio = read / mass_kg
        ratio_std = std / mass_kg
        # the reciprocal of what is uncertain is on average too large by its variance
        if not coarse:
            ratio = mass_kg * read / (read**2 + std**2)
            ratio_std = std * mass_kg / read**2
        if abs(ratio - 1.0) > FAR * np.hypot(calibration.torque_scale_std, ratio_std):
            return calibration, rejected(
                "misfit",
                "the reference does not weigh what was stated",
                f"{said}and the torque constants are stated to {100.0 * calibration.torque_scale_std:.0f} %: check the mass and "
                "the torque constants",
            )
        if coarse:
            check = ", and check payload.com" if centre is not None else ""
            stay = "too coarse to tell the torque constants, which stay as stated"
            said_coarse = f"{said}{stay}: take a heavier one, or move longer{check}"
            continue
        ratios.append(ratio)
        stds.append(ratio_std)
    # one that tells nothing is no reason to stop: an answer is as uncertain as without it
    if not ratios:
        return calibration, replace(ACCEPTED, reasons=(Reason("says_too_little", said_coarse),))
    weights = np.square(1.0 / np.array(stds))
    scale = float(weights @ ratios / weights.sum())
    # all of them lean on the same calibration: together they say no more than the best one
    scatter = float(np.std(ratios, ddof=1)) if len(ratios) > 1 else 0.0
    told = min(stds) ** 2 + scatter**2
    # what a file states of the constants counts, too: as far as these do not contradict it
    if all(robot.drive_trains[joint].torque_constant.std > 0.0 for joint in calibration.joints):
        stated = max(calibration.torque_scale_std**2, (scale - 1.0) ** 2 - told)
        scale = (told + stated * scale) / (told + stated)
        told = told * stated / (told + stated)
    runs = tuple(
        {"name": m.name, "duration_s": float(m.times_s[-1]), "load_kg": kg} for m, kg in references
    )
    return replace(
        calibration,
        torque_scale=scale,
        torque_scale_std=float(np.sqrt(told)) / scale,
        runs=(*calibration.runs, *runs),
    ), ACCEPTED


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
        try:
            fit = fit_payload(
                robot, [part], learn_arm(robot, [*parts[:number], *parts[number + 1 :]])[0]
            )
        except RecordingError:
            continue  # too short to be halved: then the fit's own word has to do
        weighed.append(
            EmptyHandEstimate(
                part.name,
                float(fit.values[0]),
                float(fit.std[0]),
                fit.quantile,
            )
        )
    return tuple(weighed)


def _between(motion: Motion, first_s: float, last_s: float, words: str) -> Motion:
    rows = (motion.times_s >= first_s) & (motion.times_s < last_s)
    return replace(motion.part(rows), name=f"{motion.name}, {words}")


def _longest_weighed(
    robot: Robot, motions: Sequence[Motion], calibration: MotionCalibration
) -> MotionFit:
    """The longest motion weighed, together with the next ones where it is too short by itself."""
    longest = sorted(
        motions,
        key=lambda motion: -float(motion.times_s[-1]),
    )
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
    arm: float,
    referenced: bool,
) -> Weighable:
    """What an object in a motion like the longest of these would be weighed to."""
    fit = _longest_weighed(robot, motions, calibration)
    nothing = 0.5 * (fit.quantile / Z95) * float(fit.std[0]) + 0.5 * float(fit.std[0])
    if len(motions) > 1 and weighed:
        nothing = max(
            nothing,
            float(np.sqrt(np.mean([each.mass_kg**2 for each in weighed]))),
        )
    mass = float(f"{SHOWN_SHARE * arm:.1g}")
    share = calibration.torque_scale_std
    because = (
        "that is how well the reference tells the torque constants"
        if referenced
        else "torque constants are known no better: a motion with a weighed object, --reference BAG=KG, would tell them"
    )
    if not referenced and share > 0.0 and abs(calibration.arm_over_urdf - 1.0) > 0.5 * share > 0.02:
        because = (
            f"by its torques the arm weighs {calibration.arm_over_urdf:.2f} times what its URDF says, and torque constants or URDF "
            "are off by that: a motion with a weighed object, --reference BAG=KG, would tell which"
        )
    return Weighable(
        mass,
        float(np.hypot(nothing, share * mass)),
        calibration.joints,
        f"an empty hand to +-{shown('kg', Z95 * nothing, spec='.0f')}, and any mass to +-{100.0 * Z95 * share:.0f} % at best: "
        f"{because}",
    )
