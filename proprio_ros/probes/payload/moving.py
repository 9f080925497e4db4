"""What the hand holds, from a motion of several joints under whatever controller, against the same arm with an empty hand.

What the empty arm does comes from motions that were recorded with the others, or from a calibration by such motions.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from proprio_ros.calibration_files.motions import MotionCalibration
from proprio_ros.identification.estimate import Estimate, Fit, Value, Verdict
from proprio_ros.identification.judge import FAR, Refusal, not_identifiable, rejected
from proprio_ros.identification.reasons import Reason
from proprio_ros.identification.regression.motion_estimate import unexplained_torque, unlike_urdf
from proprio_ros.identification.regression.motion_fit import BLOCK_S, MotionFit, fit_motions, relative_torque_std
from proprio_ros.identification.regression.motion_prior import fit_calibrated
from proprio_ros.identification.regression.rigid_body import inertia_about_centre, nearest_body
from proprio_ros.quantity import shown
from proprio_ros.recordings.motions import Motion
from proprio_ros.robot import Robot
from proprio_ros.robot.regressor import PARAMETERS
from proprio_ros.sim.payload import PayloadFacts

MISFIT_RATIO = 3.0
"""The motion with the payload may be explained so much worse than the empty one; beyond that something else happened in it."""
RATIO_SHARE, RATIO_STD = 0.05, 0.01
"""A joint whose torque is by more than this share larger or smaller than the empty arm's was recorded in another unit or with
another torque constant, where the recording knows that: magnets that warm by ten kelvin lose 1 %."""
APART_SIGMAS = 4.0
"""Two halves of a recording that differ by more did not carry the same, and torques were not recorded alike."""
DRIFT_SIGMAS = 3.0
"""How far from nothing an empty hand may weigh before the calibration is called out of date."""
LEAST_SIGMAS = 5.0
"""A mass that is not known so many times better than it is large is no divisor."""
SEEN_SHARE = 0.5
"""Of the spread of any load's parameters: what is known no better is not seen."""
WIDEST_SHARE, WIDEST_OF_ARM = 0.5, 0.02
"""A mass whose half width is more than this share of it and of the arm's own mass is ``too_wide``."""


@dataclass(frozen=True)
class MotionDetail:
    """What only an answer from a motion has.

    Attributes:
        stretches: With the payload, that the interval was made from.
        unseen: Of the ten inertial parameters, those that this motion does not determine.
        stretch_s: Their length [s].
    """

    stretches: int
    unseen: tuple[str, ...]
    stretch_s: float = BLOCK_S

    def as_json(self) -> dict[str, object]:
        return {"motion": {"stretches": self.stretches, "stretch_s": self.stretch_s, "undetermined": list(self.unseen)}}


def weigh_in_motion(
    robot: Robot,
    motions: Sequence[Motion],
    baseline: Sequence[Motion],
    facts: PayloadFacts,
    centre_is_stated: bool = False,
) -> Estimate:
    """Identify the payload that all ``motions`` share.

    Args:
        robot: As its file states it; the empty motions correct it.
        motions: With the payload, at least one.
        baseline: The same arm with an empty hand.
        facts: Where the payload's centre is, and how well that is known.
        centre_is_stated: Whether the user said so; else it is identified, too.

    Raises:
        RecordingError: A motion is of no use.
    """
    notes = tuple(note for motion in (*motions, *baseline) for note in motion.notes)
    centre = (np.asarray(facts.com), np.asarray(facts.com_std)) if centre_is_stated else None
    calibration = robot.motion_calibration
    if not baseline and calibration is None:
        unknown = not_identifiable(
            "no_empty_motion",
            "nothing says what the arm itself weighs",
            "the arm moved under a controller, and a URDF alone puts an arm off by some percent of its own weight: record about "
            "the same motion with an empty hand and add it with --baseline, or calibrate with it (`proprio calibrate`)",
        )
        return _estimate(robot, motions, None, unknown, notes)
    if calibration is None:
        fit = fit_motions(robot, motions, baseline, centre=centre)
        refusal = next(_refusals(motions, fit), None)
    else:
        fit = fit_calibrated(robot, motions, calibration, empty=baseline, centre=centre)
        refusal = next(chain(_drift(robot, baseline, calibration), _refusals(motions, fit, "its calibration")), None)
    return _estimate(robot, motions, fit, refusal, notes, centre_is_stated)


def _drift(robot: Robot, baseline: Sequence[Motion], calibration: MotionCalibration) -> Iterator[Refusal]:
    """What an empty hand that does not weigh nothing says about the calibration."""
    if not baseline:
        return
    fit = fit_calibrated(robot, baseline, calibration)
    mass, std = float(fit.values[0]), float(fit.std[0])
    if abs(mass) > DRIFT_SIGMAS * std:
        yield rejected(
            "drift",
            "the robot has changed since its calibration",
            f"drift: the empty hand now weighs {shown('kg', mass, spec='+.0f')}, where {shown('kg', std, spec='.0f')} is the "
            "standard deviation: the robot has changed since its calibration; calibrate again",
        )


def _refusals(motions: Sequence[Motion], fit: MotionFit, known: str = "its robot file") -> Iterator[Refusal]:
    mass, half = float(fit.values[0]), fit.quantile * float(fit.std[0])
    name = motions[0].name
    if fit.halves is not None:
        (early, early_std), (late, late_std) = fit.halves
        if abs(early - late) > APART_SIGMAS * np.hypot(early_std, late_std):
            yield rejected(
                "changed_midway",
                "the two halves of the recording say different masses",
                f"{name}: the first half says {shown('kg', early, spec='.0f')}, the second {shown('kg', late, spec='.0f')}: "
                "was something picked up or put down meanwhile? Record the motions with and without it apart",
            )
    unexplained = fit.residual / fit.driven
    yield from unexplained_torque(fit.joints, unexplained, "the arm, its friction and a payload", f"{name}: ")
    ratio = fit.residual / fit.empty_residual
    worst = int(np.nanargmax(np.where(unexplained > 0.1, ratio, 0.0)))
    if unexplained[worst] > 0.1 and ratio[worst] > MISFIT_RATIO:
        yield rejected(
            "misfit",
            "the model does not explain the recording",
            f"{name}: the torque of {fit.joints[worst]} is explained {ratio[worst]:.1f} times worse than with an empty hand: was "
            "the payload held firmly, and did nothing touch the arm?",
        )
    off = np.abs(fit.torque_ratio - 1.0)
    far = np.where(off > RATIO_SHARE, off / np.hypot(fit.torque_ratio_std, RATIO_STD), 0.0)
    worst = int(np.argmax(far))
    if far[worst] > APART_SIGMAS:
        yield rejected(
            "other_torque",
            "torques are not those of the empty arm",
            f"{name}: the torque of {fit.joints[worst]} is {fit.torque_ratio[worst]:.2f} times what it should be by the empty "
            "hand's motion: were both recorded with the same driver, unit and torque constants, and is it the same arm?",
        )
    yield from unlike_urdf(fit.arm_over_urdf)
    pulls = np.abs(fit.pulls())
    pulls[:10] = 0.0  # the payload's own prior is only there to keep the equations solvable
    worst = int(np.argmax(pulls))
    if pulls[worst] > FAR:
        term = fit.terms[worst]
        yield rejected(
            "far_from_prior",
            f"the arm does not fit {known}",
            f"{term.label} ended {pulls[worst]:.0f} standard deviations from what {known.replace('its', 'the')} says "
            f"({term.prior:.3g} +- {term.std:.2g} {term.unit}): check the URDF, the torque constants and the effort's unit",
        )
    if mass + half < 0.0:
        yield rejected(
            "lighter_than_empty",
            "the hand seems lighter than empty",
            f"the hand with its load seems {shown('kg', -mass, spec='.0f')} lighter than with nothing in it: are the "
            "recordings mixed up?",
        )


def _too_wide(fit: MotionFit) -> tuple[Reason, ...]:
    """Why an answer that nothing else speaks against is not accepted; empty where it is."""
    mass, half = float(fit.values[0]), fit.quantile * float(fit.std[0])
    if half <= max(WIDEST_SHARE * abs(mass), WIDEST_OF_ARM * fit.arm_kg):
        return ()
    return (
        Reason(
            "too_wide",
            f"this motion determines the mass only to +-{shown('kg', half, spec='.0f')}: move faster and through more attitudes of "
            f"the hand, longer than the {BLOCK_S * fit.blocks:.0f} s used here, and record the empty hand in the same motion",
        ),
    )


def _estimate(
    robot: Robot,
    motions: Sequence[Motion],
    fit: MotionFit | None,
    refusal: Refusal | None,
    notes: tuple[str, ...],
    centre_is_stated: bool = False,
) -> Estimate:
    withheld = "" if refusal is None else refusal.withheld
    wide = _too_wide(fit) if fit is not None and refusal is None else ()
    if fit is None or withheld:
        values = [Value("payload_mass", "kg", None, reason=withheld)]
    else:
        mass, std = float(fit.values[0]), float(fit.std[0])
        half = fit.quantile * std
        values = [Value("payload_mass", "kg", max(mass, 0.0), std, [max(mass - half, 0.0), max(mass + half, 0.0)])]
        if not centre_is_stated:
            values.extend(_place(fit))
    return Estimate(
        probe="payload",
        robot=robot.name,
        verdict=refusal.verdict if refusal is not None else Verdict.TOO_WIDE if wide else Verdict.ACCEPTED,
        reasons=wide if refusal is None else tuple(refusal.reasons),
        values=tuple(values),
        fit=None
        if fit is None
        else Fit(_mean(fit.residual), _mean(fit.empty_residual), _mean(fit.residual / fit.empty_residual), "N m"),
        solver=None,
        runs=len(motions),
        budget=() if fit is None else fit.budget(),
        detail=None if fit is None else MotionDetail(fit.blocks, fit.unseen()),
        assumptions=_assumptions(robot, motions, fit),
        notes=notes,
    )


def _assumptions(robot: Robot, motions: Sequence[Motion], fit: MotionFit | None) -> tuple[str, ...]:
    calibration = robot.motion_calibration
    known = "under the calibration's" if calibration is not None else "together with the baseline's"
    torque_std = max(relative_torque_std(robot, joint) for joint in motions[0].joints)
    if calibration is not None:
        torque_std = calibration.torque_scale_std
    referenced = calibration is not None and any(run["load_kg"] > 0.0 for run in calibration.runs)
    return (
        f"several joints moved at once: the {motions[0].source} of {len(motions[0].joints)} joints and their positions were fitted "
        f"{known}, the arm's own inertia and friction included",
        f"torque constants as {'the reference showed them' if referenced else f'in {robot.source.name}'}, to "
        f"{100.0 * torque_std:.1f} %: a mass errs as they do",
        *([] if fit is None else [f"by its torques the arm weighs {fit.arm_over_urdf:.2f} times what its URDF says"]),
        "friction is that of each recording: Coulomb, viscous, a share of the torque, and an offset per joint",
    )


def _mean(values: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(np.square(values))))


def _place(fit: MotionFit) -> tuple[Value, Value]:
    """Centre of mass, and inertia about it, in the payload's frame, where the mass is known well enough to divide by."""
    mass, std = float(fit.values[0]), fit.std
    if abs(mass) < LEAST_SIGMAS * std[0] or mass <= 0.0:
        nothing = "too little is held to say "
        return (
            Value("payload_com", "m", [None] * 3, [None] * 3, [None] * 3, nothing + "where"),
            Value("payload_inertia", "kg m^2", [None] * 6, [None] * 6, [None] * 6, nothing + "how it is spread"),
        )
    body = nearest_body(fit.values[:PARAMETERS], fit.covariance[:PARAMETERS, :PARAMETERS])
    centre = body[1:4] / mass
    # of the quotient, to first order
    gradient = np.hstack([-centre[:, None], np.eye(3)]) / mass
    stds = np.sqrt(np.diag(gradient @ fit.covariance[:4, :4] @ gradient.T))
    bounds = [[float(c - fit.quantile * s), float(c + fit.quantile * s)] for c, s in zip(centre, stds, strict=True)]
    return Value("payload_com", "m", centre.tolist(), stds.tolist(), bounds), _inertia(fit, body)


def _inertia(fit: MotionFit, body: np.ndarray) -> Value:
    """About the centre of mass: xx, xy, xz, yy, yz, zz; None where the motion says little more than that mass does."""
    value, gradient = inertia_about_centre(body)
    covariance = fit.covariance[:PARAMETERS, :PARAMETERS]
    stds = np.sqrt(np.diag(gradient @ covariance @ gradient.T))
    # a moment of inertia is told as a mass is, to half of itself, and a product only means something beside its moments
    seen = stds < SEEN_SHARE * fit.payload_prior[4:]
    moments = [0, 3, 5]
    seen[moments] &= fit.quantile * stds[moments] < WIDEST_SHARE * value[moments]
    for product, (one, other) in {1: (0, 3), 2: (0, 5), 4: (3, 5)}.items():
        seen[product] &= seen[one] or seen[other]
    names = [name for name, told in zip(("xx", "xy", "xz", "yy", "yz", "zz"), seen, strict=True) if not told]
    reason = ""
    if names:
        reason = (
            f"{', '.join(names)} not determined by this motion: turn the hand faster about the axes that it is about"
        )
    return Value(
        "payload_inertia",
        "kg m^2",
        [float(v) if told else None for v, told in zip(value, seen, strict=True)],
        [float(s) if told else None for s, told in zip(stds, seen, strict=True)],
        [
            [float(v - fit.quantile * s), float(v + fit.quantile * s)] if told else None
            for v, s, told in zip(value, stds, seen, strict=True)
        ],
        reason,
    )
