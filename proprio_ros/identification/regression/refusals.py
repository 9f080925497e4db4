"""Why an answer from motions is refused: what every kind of regression looks for, with the sentences that each adds."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from proprio_ros.calibration_files.motions import UNITS
from proprio_ros.errors import some
from proprio_ros.identification.estimate import WidthLimit
from proprio_ros.identification.judge import FAR, Refusal, rejected, wide
from proprio_ros.identification.regression.error_budget import CONSTANTS
from proprio_ros.identification.regression.motion_fit import (
    Centre,
    FittedTerms,
    HeldByFile,
    MotionFit,
)
from proprio_ros.identification.regression.trends import Trend
from proprio_ros.kinds import label_of
from proprio_ros.quantity import Z95, shown, written
from proprio_ros.recordings.effort import effort_sign_option
from proprio_ros.recordings.motions import Motion
from proprio_ros.records import FloatArray

UNEXPLAINED_SHARE = 0.5
"""A joint whose torque is unexplained by more than this share has another unit, sign or controller than stated."""
REVERSED_SHARE = 0.9
"""A torque of which more is left over than this is not explained at all, as where it is counted the other way round."""
AS_A_TOOL = 2.5
"""How many times what its URDF says an arm may weigh by what is mounted on it: most hands and tools are lighter than the arm."""
URDF_RATIO = 1.35
"""URDFs were seen to be off by 8 to 16 %; an arm that weighs more or less than that has other units or torque constants."""
APART_SIGMAS = 4.0  # What differs by more standard deviations is not the same.
LEAST_SIGMAS = 5.0  # A mass that is not known so many times better than it is large is no divisor.
DECIDES = 0.05
"""A joint that tells less than this share of what is known of a mass does not decide whether that is believed."""
RATIO_SHARE = 0.08
RATIO_STD = 0.01
ZERO_RAD = 0.12
"""A joint whose torque is by more than this share another one than the empty arm's was recorded in another unit, and one whose
positions are so far off was put together anew, where a recording knows that: those of one machine differ by 3 % and 5 mrad. Where
both are off alike, as from their URDF, a load shows it, too, and an interval holds that is off by less."""


MISFIT_RATIO = 3.0
"""The motion with the payload may be explained so much worse than the empty one; beyond that something else happened in it."""
LEFT_OVER = 0.1
"""A joint of whose torque less is unexplained than this share is explained well enough, whatever the empty one was."""
GOALS = "goals are those that the servos heard (none late, cut off or counted from another zero)"
"""What the torques of a voltage's motors are made of, where nobody measured a current."""


def deciding(
    tells: FloatArray | None,
    values: FloatArray,
) -> FloatArray:
    """Values of the joints that decide; NaN of the others."""
    return values if tells is None else np.where(tells < DECIDES, np.nan, values)


def moved_only_loaded(fit: MotionFit) -> tuple[str, ...]:
    """A sentence about the joints that moved with the payload and never with an empty hand."""
    only = np.isfinite(fit.residual) & ~np.isfinite(fit.empty_residual)
    if not only.any():
        return ()
    names = some(np.array(fit.joints)[only])
    return (
        f"{names} moved with the load only: what the arm itself does there is as its URDF says, and counts for as little",
    )


def heard_late(fit: MotionFit) -> tuple[str, ...]:
    """A sentence about goals that joints did not follow as recorded."""
    if fit.problem.late_share == 0.0:
        return ()
    share = f"{100.0 * fit.problem.late_share:.1f} %"
    return (
        f"in {share} of the windows joints did not follow the goals as recorded, which came late or were cut off: these were left "
        "out",
    )


def passed_over(
    joints: Sequence[str],
    tells: FloatArray,
    share: FloatArray,
    motion: Motion,
) -> tuple[str, ...]:
    """A sentence for each joint whose torque is not explained and does not decide.

    Args:
        joints: Their names, n.
        tells: How much of what is known of the mass each tells, shape (n,), sum 1.
        share: Of the torque, that is left over by joint, shape (n,); NaN where one did not move.
        motion: Of these.
    """
    sentences = []
    for number, joint in enumerate(joints):
        if share[number] > UNEXPLAINED_SHARE and tells[number] < DECIDES:
            option = ""
            if share[number] > REVERSED_SHARE:
                option = effort_sign_option(motion.joints, [joint], motion.turned)
                option = f"; where it is counted the other way round, {option} states it"
            sentences.append(
                f"{_percent(share[number])} of the torque of {joint} is not explained; it tells "
                f"{100.0 * tells[number]:.1f} % of the mass, and counts for as little{option}"
            )
    return tuple(sentences)


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f} %" if share < 10.0 else "over 1000 %"


def unexplained_torque(
    joints: Sequence[str],
    share: FloatArray,
    by: str,
    name: str = "",
    made_of_goals: bool = False,
) -> Iterator[Refusal]:
    """Where the worst joint's torque is not what the model makes of it.

    Args:
        joints: Their names, n.
        share: Of the torque, that is left over by joint, shape (n,); NaN where one did not move.
        by: What the model consists of.
        name: Of the recording and a colon, before the sentence.
        made_of_goals: Whether nobody measured it.
    """
    worst = int(np.argmax(np.nan_to_num(share)))
    if share[worst] > UNEXPLAINED_SHARE:
        what = "the effort's unit and sign, and"
        if made_of_goals:
            what = f"that {GOALS}, and"
        yield rejected(
            "misfit",
            "the model does not explain the recording",
            f"{name}{_percent(share[worst])} of the torque of {joints[worst]} is not explained by {by}: check {what} "
            "that nothing touched the arm",
        )


def joints_disagree(motion: Motion, fit: MotionFit) -> Iterator[Refusal]:
    """Where the joints near the base and the others, each alone, say masses that the interval does not allow.

    An effort of some joints in another unit, with and without the payload alike, shows itself nowhere else: what an arm weighs
    on its wrist is open in its URDF.
    """
    parts = fit.along_chain
    if parts is None:
        return
    (near, near_std), (far, far_std) = parts.near, parts.far
    # what the interval counts beside the residuals may differ from part to part
    std = np.sqrt(near_std**2 + far_std**2 + fit.covariance[0, 0])
    if abs(near - far) > APART_SIGMAS * std:
        question = (
            "are the efforts of some joints in another unit, or their torque constants wrong?"
        )
        if motion.made_of_goals:
            question = f"check for each joint that {GOALS}, and its servo's P gain"
        yield rejected(
            "misfit",
            "the joints say different masses",
            f"{motion.name}: the joints before {parts.first_far} say {shown('kg', near, spec='.0f')}, that one and those after it "
            f"{shown('kg', far, spec='.0f')}: {question}",
        )


def times(factor: float) -> str:
    """A factor in words: what is beyond a hundred has no digits that mean something."""
    return f"{factor:.2f} times" if abs(factor) < 100.0 else "over 100 times"


def _tool(arm_over_urdf: float) -> str:
    """The first question where an arm weighs more or less than stated by no more than what hands and tools do."""
    if 1.0 < arm_over_urdf < AS_A_TOOL:
        return (
            "is a tool or hand mounted in both recordings that the URDF lacks? Put it there. Else "
        )
    if 1.0 / AS_A_TOOL < arm_over_urdf < 1.0:
        return "has the URDF a hand or tool that is not mounted? Else "
    return ""


def unlike_urdf(
    arm_over_urdf: float,
    motion: Motion,
) -> Iterator[Refusal]:
    """Where the arm weighs far more or less by its torques than by its URDF, or hangs on them the other way round.

    ``arm_over_urdf``: how many times as much; ``motion``: one of those that say so.
    """
    words = f"by its torques the arm weighs {times(arm_over_urdf)} what its URDF says"
    if arm_over_urdf < -1.0 / URDF_RATIO:
        option = effort_sign_option(motion.joints, motion.joints, motion.turned)
        yield rejected(
            "arm_unlike_urdf",
            "the arm does not fit its URDF",
            f"{words}: its efforts have the sign of the torque that gravity makes. Where their publisher counts them so, {option} "
            "states it; where the arm hangs, robot.gravity is the other way round; and were loaded and empty recordings mixed up?",
        )
    elif not 1.0 / URDF_RATIO < arm_over_urdf < URDF_RATIO:
        yield rejected(
            "arm_unlike_urdf",
            "the arm does not fit its URDF",
            f"{words}, and a payload would be off by as much: {_tool(arm_over_urdf)}"
            f"check the effort's {'unit' if arm_over_urdf > 0.0 else 'sign'}, the torque constants and the URDF's masses, "
            "and that empty and loaded recordings are not mixed up",
        )


def held_when_empty(held: HeldByFile) -> Iterator[Refusal]:
    """Where a hand that should be empty holds something by the robot file, and with that the arm is as stated."""
    if held.sigmas < LEAST_SIGMAS:
        return
    mass = shown(
        "kg",
        abs(held.mass_kg),
        spec=".0f",
    )
    half = shown("kg", Z95 * held.std_kg, spec=".0f")
    seen = f"holds {mass} +- {half}: was something held, or is a tool mounted that the URDF lacks?"
    if held.mass_kg < 0.0:
        seen = f"is {mass} +- {half} too light: has the URDF a hand or tool that is not mounted?"
    yield rejected(
        "hand_not_empty",
        "the hand that should be empty is not as its URDF says",
        f"by the robot file the hand that should be empty {seen} The arm without it is as stated: what stays mounted belongs in "
        "the URDF, a payload comes on top",
    )


def noticed(fit: MotionFit) -> FloatArray:
    """By how much of a joint's torque this has to differ from the empty arm's to be noticed, shape (n,)."""
    _, std = fit.off["own_scale"]
    return np.where(
        fit.tells < DECIDES,
        np.inf,
        noticed_from(std),
    )


def noticed_from(std: FloatArray | float) -> FloatArray:
    """From what share on it is noticed that a torque is another one, where that share is known with a standard deviation."""
    least: FloatArray = np.maximum(RATIO_SHARE, APART_SIGMAS * np.hypot(std, RATIO_STD))
    return least


def other_torque(motion: Motion, fit: MotionFit) -> Iterator[Refusal]:
    """A joint whose torque is another one than the empty arm's, as far as a recording knows that."""
    ratio = 1.0 / (1.0 + fit.off["own_scale"][0])
    far = np.abs(ratio - 1.0) / noticed(fit)
    worst = int(np.argmax(far))
    if far[worst] > 1.0:
        yield rejected(
            "other_torque",
            "torques are not those of the empty arm",
            f"{motion.name}: the torque of {fit.joints[worst]} is {ratio[worst]:.2f} times what it should be by the empty hand's "
            f"motion: {_alike(motion)}",
        )


def _alike(motion: Motion) -> str:
    """What has to be alike in two recordings for their torques to be."""
    if motion.made_of_goals:
        return f"check that {GOALS}, that P gain and supply are those of then, and that it is the same arm"
    return "were both recorded with the same driver, unit, sign and torque constants, and is it the same arm?"


def halves_disagree(name: str, fit: MotionFit) -> Iterator[Refusal]:
    """The masses of the two halves of a recording; ``name``: of it."""
    if fit.halves is None:
        return
    (early, early_std), (late, late_std) = fit.halves
    if abs(early - late) > APART_SIGMAS * np.hypot(early_std, late_std):
        yield rejected(
            "changed_midway",
            "the two halves of the recording say different masses",
            f"{name}: the first half says {shown('kg', early, spec='.0f')}, the second {shown('kg', late, spec='.0f')}: "
            "was something picked up or put down meanwhile? Record the motions with and without it apart",
        )


def changed_at_once(motion: Motion, trend: Trend) -> Iterator[Refusal]:
    """Where a payload changes in a motion, which explains it better than what motors do."""
    step = trend.step
    if step is None or not trend.payload_changes:
        return
    size = shown("kg", abs(step.change_kg), spec=".0f")
    what = "more" if step.change_kg > 0.0 else "less"
    yield rejected(
        "changed_midway",
        "the payload changes in the recording",
        f"{motion.name}: from about {step.time_s:.0f} s on the hand holds {size} {what}: was something picked up or put down, or "
        "another payload set in the controller meanwhile? Weigh the parts, --span FROM:TO",
    )


def explained_worse(motion: Motion, fit: MotionFit) -> Iterator[Refusal]:
    """A joint that decides, whose torque is explained worse than with an empty hand."""
    unexplained = deciding(fit.tells, fit.unexplained)
    ratio = fit.residual / fit.empty_residual
    # never of one that does not decide
    worst = int(np.nanargmax(np.where(unexplained > LEFT_OVER, ratio, 0.0)))
    if unexplained[worst] > LEFT_OVER and ratio[worst] > MISFIT_RATIO:
        goals = f", and check that {GOALS}" if motion.made_of_goals else ""
        yield rejected(
            "misfit",
            "the model does not explain the recording",
            f"{motion.name}: the torque of {fit.joints[worst]} is explained {ratio[worst]:.1f} times worse than with an empty hand"
            f": was the payload held firmly, did nothing touch the arm, and are the joints' zeros where they were?{goals}",
        )


def other_zero(name: str, fit: MotionFit) -> Iterator[Refusal]:
    """Where positions of recording ``name`` are not read as those of the empty arm were."""
    zero, zero_std = fit.off["zero"]
    far = np.abs(zero) / np.maximum(ZERO_RAD, APART_SIGMAS * zero_std)
    worst = int(np.argmax(far))
    if far[worst] > 1.0:
        yield rejected(
            "other_zero",
            "positions are not those of the empty arm",
            f"{name}: {fit.joints[worst]} is read {-zero[worst]:+.2f} rad (m, where it slides) off from where URDF and empty "
            "hand have it: was its zero set, or its horn or encoder put on, anew?",
        )


def far_from_prior(
    terms: FittedTerms,
    known: str,
) -> Iterator[Refusal]:
    """Where the worst of an arm's terms is not what ``known`` has it to be."""
    pulls = np.abs(terms.values - terms.prior) / terms.std
    worst = int(np.argmax(pulls))
    if pulls[worst] > FAR:
        key = terms.keys[worst]
        std = f"{terms.std[worst]:.2g} {UNITS[key[0]]}".removesuffix(" 1")
        yield rejected(
            "far_from_prior",
            f"the arm does not fit its {known}",
            f"{label_of(key)} ended {pulls[worst]:.0f} standard deviations from what the {known} says ({terms.prior[worst]:.3g} +- "
            f"{std}): check the URDF, the torque constants and the effort's unit",
        )


def centre_elsewhere(
    name: str,
    stated: Centre,
    fit: MotionFit,
    free: MotionFit,
) -> Iterator[Refusal]:
    """Where the payload is not at its stated centre, and the mass is another one for it.

    Args:
        name: Of the recording.
        stated: The centre, and its standard deviation.
        fit: With the payload there.
        free: With the payload wherever it is.
    """
    mass = float(free.values[0])
    at = np.asarray(stated[0])
    # both err alike as torque constants do
    of_constants = free.parts[CONSTANTS] ** 2
    std = np.sqrt(max(float(free.std[0]) ** 2 - of_constants, 0.0))
    alike = abs(fit.values[0] - mass) < free.quantile * std
    if alike or mass < LEAST_SIGMAS * free.std[0]:
        return
    moments = np.hstack([-at[:, None], np.eye(3)])  # about the stated centre they are nothing
    off = moments @ free.values[:4]
    covariance = moments @ free.covariance[:4, :4] @ moments.T + np.diag(
        np.square(mass * np.asarray(stated[1]))
    )
    sigmas = np.sqrt(off @ np.linalg.solve(covariance, off))
    if Z95 * sigmas > APART_SIGMAS * free.quantile:
        yield elsewhere(
            name,
            at,
            free.values[1:4] / mass,
        )


def elsewhere(
    name: str,
    stated: FloatArray,
    found: FloatArray,
) -> Refusal:
    """The refusal of a stated centre where another one explains the motion.

    ``name``: of the recording; ``stated``: the centre [m], shape (3,); ``found``: the other one.
    """
    said = ", ".join(written(value, ".3g") for value in stated)
    seen = ", ".join(written(value, ".3f") for value in found)
    return rejected(
        "misfit",
        "the payload is not where it is stated to be",
        f"{name}: payload.com is stated as [{said}] m, and the motion is explained with [{seen}] m: is it right, in the axes of "
        "payload.frame? Left out, it is found",
    )


def lighter_than_empty(
    mass_kg: float,
    half_kg: float,
    advice: str,
) -> Iterator[Refusal]:
    """Where a mass is below nothing by more than the half width of its interval.

    ``mass_kg``: that was found; ``half_kg``: of its interval; ``advice``: what may be wrong.
    """
    if mass_kg + half_kg < 0.0:
        yield rejected(
            "lighter_than_empty",
            "the hand seems lighter than empty",
            f"the hand with its load seems {shown('kg', -mass_kg, spec='.0f')} lighter than with nothing in it: {advice}",
        )


def interval_too_wide(
    width_limit: WidthLimit,
    mass_kg: float,
    half_kg: float,
    advice: str,
    motion: str = "this motion",
) -> Iterator[Refusal]:
    """Where the interval of a mass is wider than is useful.

    Args:
        width_limit: How wide it may be.
        mass_kg: That was found [kg].
        half_kg: Half width of its interval [kg].
        advice: What would narrow it.
        motion: What is said to determine the mass.
    """
    if width_limit.exceeded_by(mass_kg, half_kg):
        half = shown("kg", min(half_kg, 1e6), spec=".0f")
        sentence = f"{motion} determines the mass only to +-{half}: {advice}"
        yield wide(width_limit, sentence)


def errs_most_by(parts: Sequence[tuple[str, float]]) -> str:
    """Of what puts how much on a mass, by name: the largest, in words."""
    most, _ = max(parts, key=lambda part: part[1])
    return f"it errs most by {most}"
