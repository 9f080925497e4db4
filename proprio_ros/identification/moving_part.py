"""Inertia and gravity load of what a driven joint moves, and how they follow the unknowns of a fit.

About one joint, inertia and the three parts of the gravity load (by the cosine of the joint's angle, by its sine, and constant) are
linear in the masses of the arm's links and in the ten inertial parameters of the payload (``coefficients.py``). The unknowns bend
that: locked joints stand off their readings, the joint's own zero turns gravity, and a swing's moment repeats only so well.

In all shapes S is the number of guesses, N that of unknowns.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from proprio_ros.identification.coefficients import Coefficients


@dataclass(frozen=True, eq=False)
class InertialTerms:
    """Inertial parameters of a rigid load at each guess, and their derivatives."""

    parameters: np.ndarray  # (S, 10)
    by_unknown: dict[int, np.ndarray]  # by column of an unknown, (S, 10) each

    def plus(
        self,
        parameters: np.ndarray,
        by_unknown: dict[int, np.ndarray],
    ) -> InertialTerms:
        """With another load held beside this one: parameters (S, 10) and their derivatives, as in the fields."""
        changes = dict(self.by_unknown)
        for column, change in by_unknown.items():
            changes[column] = changes.get(column, 0.0) + change
        return InertialTerms(self.parameters + parameters, changes)


@dataclass(frozen=True, eq=False)
class PoseShift:
    """How far a locked joint truly stands from its reading."""

    shift: np.ndarray  # (S,)
    by_unknown: list[tuple[int, float]]  # column of each unknown it depends on, and the factor


@dataclass(frozen=True, eq=False)
class MovingPart:
    """Inertia and gravity load at each guess; the steps below change them in place."""

    load: np.ndarray  # (S, 4): inertia; gravity by cosine, by sine, constant
    by_unknown: np.ndarray  # its derivative, (S, 4, N)

    def turn(self, angle: np.ndarray, column: int) -> None:
        """Gravity as a function of the reading, where the joint's true angle is its reading plus an angle (S,) of that column."""
        cos = np.cos(angle)
        sin = np.sin(angle)
        by_cos = self.load[:, 1].copy()
        by_sin = self.load[:, 2].copy()
        self.load[:, 1] = by_cos * cos + by_sin * sin
        self.load[:, 2] = by_sin * cos - by_cos * sin
        cos_change = self.by_unknown[:, 1].copy()
        sin_change = self.by_unknown[:, 2].copy()
        c = cos[:, None]
        s = sin[:, None]
        self.by_unknown[:, 1] = cos_change * c + sin_change * s
        self.by_unknown[:, 2] = sin_change * c - cos_change * s
        self.by_unknown[:, 1, column] += self.load[:, 2]
        self.by_unknown[:, 2, column] -= self.load[:, 1]

    def scale_gravity(self, factor: np.ndarray, column: int) -> None:
        """All gravity times a factor (S,) that grows with the unknown of a column."""
        self.by_unknown[:, 1:] *= factor[:, None, None]
        self.by_unknown[:, 1:, column] = self.load[:, 1:]
        self.load[:, 1:] *= factor[:, None]


def moving_part(
    coefficients: Coefficients,
    load: InertialTerms,
    shifts: Sequence[PoseShift],
    values: np.ndarray,
    arm_scale: int,
    links: Iterable[int],
) -> MovingPart:
    """Arm and load about a joint whose angle is its reading.

    Args:
        coefficients: Of the run.
        load: What the hand holds.
        shifts: Of the locked joints that change the coefficients, in their order.
        values: All unknowns of each guess, shape (S, N).
        arm_scale: Column of the factor on the whole arm.
        links: Columns of the links' own unknowns, in the coefficients' order.

    Returns: inertia and gravity load with their derivatives.
    """
    guesses = len(values)
    arm = np.tile(coefficients.arm, (guesses, 1))  # (S, 4)
    lever = np.tile(coefficients.payload, (guesses, 1, 1))  # (S, 4, 10)
    for pose, shift in enumerate(shifts):
        # the joint stands at its reading plus its zero, less the encoder's error
        arm = arm + shift.shift[:, None] * coefficients.arm_by_pose[pose]
        lever = lever + shift.shift[:, None, None] * coefficients.payload_by_pose[pose]
    scale = values[:, arm_scale]
    total = scale[:, None] * arm
    change = np.zeros((guesses, 4, values.shape[1]))
    change[:, :, arm_scale] = arm
    columns = list(links)
    total += values[:, columns] @ coefficients.arm_by_link
    change[:, :, columns] += coefficients.arm_by_link.T
    for column, by_load in load.by_unknown.items():
        change[:, :, column] = np.einsum(
            "sij,sj->si",
            lever,
            by_load,
        )
    total += np.einsum("sij,sj->si", lever, load.parameters)
    for pose, shift in enumerate(shifts):
        by_shift = (
            scale[:, None] * coefficients.arm_by_pose[pose]
            + load.parameters @ coefficients.payload_by_pose[pose].T
        )
        for column, factor in shift.by_unknown:
            change[:, :, column] += factor * by_shift
    return MovingPart(total, change)
