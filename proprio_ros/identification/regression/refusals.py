"""Why an answer from motions is refused: what every kind of regression looks for, with the sentences that each adds."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from proprio_ros.calibration_files.motions import UNITS, Key
from proprio_ros.identification.judge import FAR, Refusal, not_identifiable, rejected
from proprio_ros.kinds import label_of
from proprio_ros.quantity import shown
from proprio_ros.records import FloatArray

UNEXPLAINED_SHARE = 0.5
"""A joint whose torque is unexplained by more than this share has another unit, sign or controller than stated."""
URDF_RATIO = 1.35
"""URDFs were seen to be off by 8 to 16 %; an arm that weighs more or less than that has other units or torque constants."""
WIDEST_SHARE = 0.5
"""No mass is stated whose half width is more than this share of it."""


DECIDES = 0.05
"""A joint that tells less than this share of what is known of a mass does not decide whether that is believed."""


def deciding(tells: FloatArray | None, values: FloatArray) -> FloatArray:
    """Values of the joints that decide; NaN of the others."""
    return values if tells is None else np.where(tells < DECIDES, np.nan, values)


def passed_over(joints: Sequence[str], tells: FloatArray, share: FloatArray) -> tuple[str, ...]:
    """A sentence for each joint whose torque is not explained and does not decide.

    Args:
        joints: Their names.
        tells: How much of what is known of the mass each tells, sum 1.
        share: Of the torque, that is left over by joint; NaN where one did not move.
    """
    return tuple(
        f"{100.0 * share[n]:.0f} % of the torque of {joint} is not explained; it tells {100.0 * tells[n]:.1f} % of the mass, and "
        "counts for as little"
        for n, joint in enumerate(joints)
        if share[n] > UNEXPLAINED_SHARE and tells[n] < DECIDES
    )


def unexplained_torque(joints: Sequence[str], share: FloatArray, by: str, name: str = "") -> Iterator[Refusal]:
    """Where the worst joint's torque is not what the model makes of it.

    Args:
        joints: Their names.
        share: Of the torque, that is left over by joint; NaN where one did not move.
        by: What the model consists of.
        name: Of the recording and a colon, before the sentence.
    """
    worst = int(np.argmax(np.nan_to_num(share)))
    if share[worst] > UNEXPLAINED_SHARE:
        yield rejected(
            "misfit",
            "the model does not explain the recording",
            f"{name}{100.0 * share[worst]:.0f} % of the torque of {joints[worst]} is not explained by {by}: check the effort's "
            "unit and sign, and that nothing touched the arm",
        )


def unlike_urdf(arm_over_urdf: float) -> Iterator[Refusal]:
    """Where the arm weighs far more or less by its torques than by its URDF."""
    if not 1.0 / URDF_RATIO < arm_over_urdf < URDF_RATIO:
        yield rejected(
            "arm_unlike_urdf",
            "the arm does not fit its URDF",
            f"by its torques the arm weighs {arm_over_urdf:.2f} times what its URDF says, and a payload would be off by as much: "
            f"check the effort's {'unit' if arm_over_urdf > 0.0 else 'sign'}, the torque constants and the URDF's masses, "
            "and that empty and loaded recordings are not mixed up",
        )


def far_from_prior(
    keys: Sequence[Key], values: FloatArray, prior: FloatArray, std: FloatArray, known: str
) -> Iterator[Refusal]:
    """Where the worst of an arm's terms is not what ``known`` has it to be.

    Args:
        keys: Kind and joint of each term.
        values: That came out.
        prior: What should have come out.
        std: How well that is known.
        known: Who says so.
    """
    pulls = np.abs(values - prior) / std
    worst = int(np.argmax(pulls))
    if pulls[worst] > FAR:
        key = keys[worst]
        yield rejected(
            "far_from_prior",
            f"the arm does not fit its {known}",
            f"{label_of(key)} ended {pulls[worst]:.0f} standard deviations from what the {known} says ({prior[worst]:.3g} +- "
            f"{f'{std[worst]:.2g} {UNITS[key[0]]}'.removesuffix(' 1')}): check the URDF, the torque constants and the effort's "
            "unit",
        )


def lighter_than_empty(mass_kg: float, half_kg: float, advice: str) -> Iterator[Refusal]:
    """Where a mass is below nothing by more than the half width of its interval."""
    if mass_kg + half_kg < 0.0:
        yield rejected(
            "lighter_than_empty",
            "the hand seems lighter than empty",
            f"the hand with its load seems {shown('kg', -mass_kg, spec='.0f')} lighter than with nothing in it: {advice}",
        )


def interval_too_wide(
    mass_kg: float,
    half_kg: float,
    parts: Sequence[tuple[str, float]],
    name: str = "",
    advice: str = "",
    share: float = WIDEST_SHARE,
) -> Iterator[Refusal]:
    """Where the half width of a mass's interval is more than a share of it; ``parts`` say what puts how much on it."""
    if half_kg > share * abs(mass_kg):
        yield not_identifiable(
            "says_too_little",
            "the interval is too wide to state a mass",
            f"{name}this motion determines the mass only to +-{shown('kg', min(half_kg, 1e6), spec='.0f')}; what it errs by most: "
            f"{max(parts, key=lambda part: part[1])[0]}{advice}",
        )
