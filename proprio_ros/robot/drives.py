"""What drives a joint whose motor knows no current: a hobby servo puts a voltage on its motor, some of its supply's.

The motor's torque is ``k_t / R (V duty - k_e speed)``, with the supply's voltage V, the winding's resistance R and the duty cycle,
-1 to 1, of the driver's pulses. A servo reports the duty cycle as a number of counts, or nobody reports it and it follows from
the position servo's law in its firmware. Both become the *stall current* ``V duty / R``, that which would flow at rest: from
there on such a joint is one that a current drives, whose back EMF is viscous friction of ``k_t k_e / R``, on top of its own.

A kind is a class here and a line in `KINDS_OF_DRIVE`. What a driver's numbers mean is stated in the robot file and never guessed.

Sources: the law of a position servo as its firmware has it, ROBOTIS e-manual, XL330-M288 (Position PID Gain, PWM Limit), and
Duclusaud, Passault et al. 2025, Extended Friction Models for the Physics Simulation of Servo Actuators (ICRA).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields
from typing import ClassVar

import numpy as np

from proprio_ros.errors import RecordingError
from proprio_ros.inputs.forms import Form, Number
from proprio_ros.robot.geometry import FloatArray

# a goal that is limited in speed is followed in such steps, as firmware does every few milliseconds
STEP_S = 0.002
LONGEST_S = 1e5  # of a recording, in which goals are followed
MEASURED = "duty cycle and supply voltage"
COMPUTED = "goal, position and supply voltage by the servo's law"


@dataclass(frozen=True)
class Goal:
    """Where a joint is sent: each position [rad] holds from its time [s] until the next, both of shape (G,)."""

    times_s: FloatArray
    position: FloatArray

    def at(self, times_s: FloatArray, fastest_rad_s: float = np.inf) -> FloatArray:
        """The goal at increasing times, that of a firmware that moves it no faster than that."""
        if not np.isfinite(fastest_rad_s):
            return self.position[self._rows(times_s)]
        first = min(float(times_s[0]), float(self.times_s[0]))
        if times_s[-1] - first > LONGEST_S:
            apart = f"goals and joint states are stamped {times_s[-1] - first:.3g} s apart"
            raise RecordingError(
                f"{apart}: stamp both by one clock, that of the computer that records them"
            )
        steps_s = np.arange(
            first,
            float(times_s[-1]) + STEP_S,
            STEP_S,
        )
        limited = self.position[self._rows(steps_s)].copy()
        for row in range(1, len(limited)):
            step = limited[row] - limited[row - 1]
            limited[row] = limited[row - 1] + min(
                max(step, -fastest_rad_s * STEP_S), fastest_rad_s * STEP_S
            )
        return np.interp(times_s, steps_s, limited)

    def _rows(self, times_s: FloatArray) -> np.ndarray:
        return np.clip(
            np.searchsorted(self.times_s, times_s, side="right") - 1,
            0,
            None,
        )


@dataclass(frozen=True)
class Drive:
    """How the duty cycle of a motor follows from what was recorded."""

    kind: ClassVar[str]  # as the robot file names it
    takes: ClassVar[str]  # what the duty cycle is made of, in words
    follows_goal: ClassVar[bool] = False  # whether it needs the goal
    # of each key in the robot file; one whose class has a default may be left out
    forms: ClassVar[Mapping[str, Form]]

    def duty(
        self,
        times_s: FloatArray,
        position: FloatArray,
        effort: FloatArray | None,
        goal: Goal | None,
        delay_s: float,
    ) -> FloatArray:
        """The duty cycle at some instants, -1 to 1, shape (T,).

        Args:
            times_s: Increasing [s], shape (T,).
            position: At them [rad], shape (T,).
            effort: As the driver published it, shape (T,); None where it published none.
            goal: Where the joint was sent; None where nobody recorded it.
            delay_s: From a goal to its torque.
        """
        raise NotImplementedError


@dataclass(frozen=True)
class DutyCycle(Drive):
    """The driver publishes the duty cycle in counts."""

    kind: ClassVar[str] = "duty_cycle"
    takes: ClassVar[str] = MEASURED
    forms: ClassVar[Mapping[str, Form]] = {
        "per_count": Number(
            "duty cycle, 0 to 1, of one count of the published effort", "", -1.0, 1.0
        )
    }

    # duty cycle of one count: 1/885 for the Present PWM of a Dynamixel, with the sign of the torque
    per_count: float

    def duty(
        self,
        times_s: FloatArray,
        position: FloatArray,
        effort: FloatArray | None,
        goal: Goal | None,
        delay_s: float,
    ) -> FloatArray:
        """As it was published, -1 to 1, (T,).

        Args:
            times_s: Of the samples [s], (T,).
            position: Not used [rad], (T,).
            effort: Counts of the duty cycle, (T,).
            goal: Not used.
            delay_s: Not used [s].
        """
        assert effort is not None  # whoever reads the recording says that it is missing
        return np.clip(self.per_count * effort, -1.0, 1.0)


@dataclass(frozen=True)
class PositionServo(Drive):
    """The firmware makes the duty cycle from the distance to the goal, and publishes nothing of it."""

    kind: ClassVar[str] = "position_servo"
    takes: ClassVar[str] = COMPUTED
    follows_goal: ClassVar[bool] = True
    forms: ClassVar[Mapping[str, Form]] = {
        "gain_per_rad": Number(
            "duty cycle per rad between goal and position", "1/rad", 0.0, 1e4, open=True
        ),
        "limit": Number("largest duty cycle", "", 0.0, 1.0, open=True),
        "dead_band_rad": Number("nearer to its goal the servo does nothing", "rad", 0.0, 1.0),
        "goal_speed_rad_s": Number(
            "the firmware moves its goal no faster", "rad/s", 0.0, 1e3, open=True
        ),
    }

    gain_per_rad: float  # duty cycle per rad of distance
    limit: float = 1.0  # largest duty cycle
    dead_band_rad: float = 0.0  # nearer to the goal it is zero, and counts from there
    goal_speed_rad_s: float = np.inf  # the firmware moves its goal no faster

    def duty(
        self,
        times_s: FloatArray,
        position: FloatArray,
        effort: FloatArray | None,
        goal: Goal | None,
        delay_s: float,
    ) -> FloatArray:
        """As the firmware makes it of the distance to its goal, -1 to 1, (T,).

        Args:
            times_s: Of the samples [s], (T,).
            position: Of the joint [rad], (T,).
            effort: Not used.
            goal: Where the joint was sent.
            delay_s: From a goal to its torque [s].
        """
        assert goal is not None
        distance = goal.at(times_s - delay_s, self.goal_speed_rad_s) - position
        beyond = np.maximum(np.abs(distance) - self.dead_band_rad, 0.0)
        distance = np.sign(distance) * beyond
        return np.clip(
            self.gain_per_rad * distance,
            -self.limit,
            self.limit,
        )


KINDS_OF_DRIVE: Mapping[str, type[Drive]] = {kind.kind: kind for kind in (DutyCycle, PositionServo)}


def required(kind: type[Drive]) -> tuple[str, ...]:
    """The keys of a kind without a default."""
    return tuple(each.name for each in fields(kind) if each.default is MISSING)
