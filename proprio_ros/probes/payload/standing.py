"""What the hand holds where the arm stands, or moves for a few seconds only, by a calibration of motions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from itertools import chain

import numpy as np

from proprio_ros.calibration_files.motions import MotionCalibration
from proprio_ros.errors import TooLittleMotion
from proprio_ros.identification.chance import beyond_chance
from proprio_ros.identification.estimate import Estimate, Fit, limit_in_motion
from proprio_ros.identification.judge import Refusal, judge, positive, rejected
from proprio_ros.identification.regression.at_rest import RestFit, fit_at_rest
from proprio_ros.identification.regression.motion_equations import Arm
from proprio_ros.identification.regression.motion_fit import MotionFit, fit_payload
from proprio_ros.identification.regression.refusals import (
    APART_SIGMAS,
    interval_too_wide,
    lighter_than_empty,
    unlike_urdf,
)
from proprio_ros.identification.regression.scale_in_motion import other_gain
from proprio_ros.probes.payload.moving import drift, motion_answer
from proprio_ros.quantity import Z95
from proprio_ros.recordings.motions import Motion
from proprio_ros.robot import Robot
from proprio_ros.sim.payload import PayloadFacts

MUCH_WORSE = 10.0
"""Torques of a joint that are explained so much worse than in the empty motions are not those of the arm that was calibrated: right
ones were up to 6 times worse in a second or two."""


def identify_standing(
    robot: Robot,
    motions: Sequence[Motion],
    baseline: Sequence[Motion],
    facts: PayloadFacts,
    centre_is_stated: bool,
    learnt: MotionCalibration,
) -> Estimate:
    """Identify the payload of recordings that move too little for `identify_in_motion`.

    Args:
        robot: As its file or its calibration states it.
        motions: With the payload.
        baseline: With an empty hand.
        facts: Where the payload's centre is.
        centre_is_stated: Whether the user said so.
        learnt: What motions showed of the arm.

    Raises:
        TooLittleMotion: They do not stand, either.
        RecordingError: A recording is of no use.
    """
    centre_m = np.asarray(facts.com)
    centre_std_m = np.maximum(facts.com_std, 1e-3) if centre_is_stated else None
    fit = fit_at_rest(robot, motions, learnt, centre_m, centre_std_m)
    empty = (fit_at_rest(robot, [motion], learnt, centre_m, centre_std_m) for motion in baseline)
    of_arm = chain.from_iterable(drift(each.mass_kg, each.std_kg) for each in empty)
    moving = None
    with suppress(TooLittleMotion):
        centre = None if centre_std_m is None else (centre_m, centre_std_m)
        moving = fit_payload(robot, motions, learnt, centre=centre, least=1)
    arm_kg = Arm.of(robot, learnt.joints, dict(motions[0].held)).kg
    refusal = judge(
        chain(
            of_arm,
            _refusals(motions[0], fit, moving, learnt.arm_over_urdf),
            _too_wide(fit, arm_kg),
        )
    )
    how = (
        f"{fit.moved_s:.1f} s of motion, each under the friction of the calibration"
        if fit.moved_s
        else f"{fit.stances} stances: dry friction of a joint carries any part of what it has, mostly against the way it came"
    )
    return motion_answer(
        robot,
        motions,
        refusal,
        [positive("payload_mass", "kg", fit.mass_kg, fit.std_kg, refusal.withheld)],
        (
            f"the arm hardly moved, and the mass rests on {how}",
            "nothing but the hand touches payload and arm; each servo has the gain that it was calibrated with"
            + fit.scale.precision_words,
        ),
        fit=None if fit.moved_s else Fit(fit.rms, fit.expected_rms, fit.chi2 / fit.freedom, "N m"),
        budget=list(fit.parts.items()),
        detail=None,
        beside=baseline,
    )


def _refusals(
    motion: Motion, fit: RestFit, moving: MotionFit | None, arm_over_urdf: float
) -> Iterator[Refusal]:
    yield from other_gain(motion.name, fit.scale)
    worse = 0.0 if moving is None else float(np.nanmax(moving.residual / moving.empty_residual))
    other, other_std = fit.beside or (fit.mass_kg, 0.0)
    apart = abs(other - fit.mass_kg) > APART_SIGMAS * np.hypot(other_std, fit.std_kg)
    if beyond_chance(fit.chi2, max(fit.freedom, 1)) or worse > MUCH_WORSE or apart:
        yield rejected(
            "misfit",
            "the model does not explain the recording",
            f"{motion.name}: no payload explains what the motors do where the arm stands, and before: does it lean on something, "
            "does somebody hold it, and has each servo the gain that it was calibrated with?",
        )
    yield from unlike_urdf(arm_over_urdf, motion)
    yield from lighter_than_empty(fit.mass_kg, Z95 * fit.std_kg, "are the recordings mixed up?")


def _too_wide(fit: RestFit, arm_kg: float) -> Iterator[Refusal]:
    return interval_too_wide(
        limit_in_motion(arm_kg),
        fit.mass_kg,
        Z95 * fit.std_kg,
        "hold the arm in more poses, each reached from above and from below, or let it move for 15 s",
        motion="so little motion",
    )
