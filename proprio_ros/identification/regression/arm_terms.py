"""Where the terms of an arm stand among the unknowns of a regression, in the order of `term_keys`."""

from __future__ import annotations

from dataclasses import dataclass

from proprio_ros.calibration_files.motions import DRIVE_TERMS, FRICTION_TERMS
from proprio_ros.robot.regressor import PARAMETERS


@dataclass(frozen=True)
class ArmTerms:
    """Columns of an arm's bodies, drive trains and friction."""

    count: int  # of joints, n
    first: int = 0  # so many unknowns stand before the arm's

    def _after(
        self,
        per_joint: int,
        kinds: int = 1,
    ) -> slice:
        """Some kinds of terms behind others, of which each joint has so many."""
        start = self.first + per_joint * self.count
        return slice(start, start + kinds * self.count)

    @property
    def bodies(self) -> slice:
        """Ten inertial parameters of each body, body by body."""
        return self._after(0, PARAMETERS)

    @property
    def rotors(self) -> slice:
        """Inertia of the rotors, seen from the joint [kg m^2]."""
        return self._after(PARAMETERS)

    @property
    def load_friction(self) -> slice:
        """The share of the transmitted torque that gears lose."""
        return self._after(PARAMETERS + 1)

    @property
    def torque_shares(self) -> slice:
        """By how much more than its constant says a motor's torque is, relative."""
        return self._after(PARAMETERS + 2)

    @property
    def friction_by_place(self) -> slice:
        """Coulomb friction that goes with sine and cosine of the angle and of twice the angle [N m]."""
        waves = len(DRIVE_TERMS) - 3
        return self._after(PARAMETERS + 3, waves)

    @property
    def friction(self) -> slice:
        """Viscous friction, Coulomb friction and offset of a motion."""
        return self._after(
            PARAMETERS + len(DRIVE_TERMS),
            len(FRICTION_TERMS),
        )

    @property
    def coulomb(self) -> slice:
        """Coulomb friction of a motion [N m]."""
        return self._after(PARAMETERS + len(DRIVE_TERMS) + 1)

    @property
    def offset(self) -> slice:
        """Constant torque of a motion [N m]."""
        return self._after(PARAMETERS + len(DRIVE_TERMS) + 2)
