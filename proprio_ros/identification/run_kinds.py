"""Kinds of runs: pushes and free swings, and what is known of a run by its kind.

Whoever prepares, fits or judges a run asks its kind, and does not look which it is: where the joint began, what loads its gears,
which unknowns the run has of its own, and which of the robot's it leaves as they are.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from proprio_ros.errors import RecordingError
from proprio_ros.identification.coefficients import Coefficients
from proprio_ros.identification.locked_joints import Loads, rests_from
from proprio_ros.quantity import Quantity
from proprio_ros.records import MEASURED_EFFORT, Run
from proprio_ros.robot import Robot
from proprio_ros.sim.payload import PayloadFacts

if TYPE_CHECKING:
    from proprio_ros.identification.prepared_runs import PreparedRun

START_STD = 0.1  # how far off a free swing's first reading may be: next to nothing is assumed [rad]
START_VELOCITY_STD = 2.0
"""How far off the slope of a free swing's first samples may be: next to nothing is assumed [rad/s]."""
SLOPE_S = 0.08  # over which the velocity is taken with which a free swing begins [s]
# what is taken for the error of a simulated swing until the swing shows it [rad]
FIRST_SWING_ERROR = 0.02
# below this speed the direction of a swing is not read off its samples for certain [rad/s]
SLOW = 0.1
RIPPLE_TERMS = ("ripple_cos", "ripple_sin")
"""The encoder's once-per-turn error: a magnet that sits off its axis adds ``a cos q + b sin q`` to the reading [rad]."""
RISE = ("stribeck", "stribeck_velocity")
"""How dry friction rises towards standstill."""
MOMENT_REPEATS = 0.015
"""Standard deviation of gravity's moment over inertia between swings of one joint with one load, relative: masses of servos that
were let go repeat to 1.9 to 4.5 %, which is 1 to 2 % of it where the rotor is half of the inertia."""
ZERO_REPEATS = 0.3  # of a zero as well as the file knows it, what differs from swing to swing


class Push:
    """A current drives the joint from rest; also the base of other kinds."""

    unneeded: tuple[str, ...] = ()
    """Kinds of unknowns on which nothing in such a run depends."""
    kept: tuple[str, ...] = ()
    """Kinds of unknowns of its joint that stay where the robot file has them."""
    kept_rise: tuple[str, ...] = ()
    """Of these, the ones that the simulation takes."""
    both_ways = False
    """Whether friction acts in both directions within one run."""
    iterations = 40
    """Of the solver, at most."""
    iterations_again = 10
    """The same from where another fit ended."""
    late_s = 0.015
    """A run that begins so much later than most is looked at by itself."""
    most_missed = math.inf
    """A simulation that misses a run by more than this share of its span (rms) does not explain it."""
    most_pull = 3.0
    """Standard deviations that a reference may be off what was stated, before that is said."""

    def yielding(self, joints: tuple[str, ...]) -> tuple[str, ...]:
        """Locked joints that may give way to it."""
        return joints

    def rest(self, robot: Robot, run: Run) -> Quantity:
        """Where the joint was when the run began, at the motor's shaft [rad]."""
        drive = robot.drive_trains[run.joint]
        resting = run.before_position[rests_from(run.before_times_s, run.before_position, drive) :]
        if len(resting) == 0:
            return Quantity(
                float(run.position[0]),
                3.0 * (robot.residual_scale * drive.reading_std),
            )
        # at rest the rounding error repeats, so only the noise averages out
        noise = drive.encoder_noise / np.sqrt(len(resting))
        return Quantity(
            float(np.mean(resting)),
            float(np.hypot(drive.encoder_resolution / np.sqrt(12.0), noise)),
        )

    def model_error(self, robot: Robot) -> float:
        """What a simulation misses of each sample beside noise, as a standard deviation [rad]."""
        return 0.0

    def loads(
        self,
        run: Run,
        coefficients: Coefficients,
        facts: PayloadFacts,
    ) -> Loads:
        """What loads the gears beside the current, where no joint yields.

        Args:
            run: At the motor's shaft.
            coefficients: Of the run.
            facts: About what the hand holds.
        """
        return Loads()

    def start_velocity(self, robot: Robot, run: PreparedRun) -> Quantity:
        """With which the run began [rad/s]."""
        return Quantity(0.0, robot.start_velocity)

    def repeats(self, robot: Robot, run: PreparedRun) -> dict[str, float]:
        """Standard deviations of what differs from run to run, by kind of unknown.

        The delay: where the input is measured effort, its onset is only known to one period. Where joint states pause around it,
        whoever takes commands may have paused, too, or not: then it may be anywhere in the pause.
        """
        period = float(np.median(np.diff(run.run.times_s)))
        pause = (
            float(run.run.times_s[0] - run.run.before_times_s[-1])
            if len(run.run.before_times_s)
            else 0.0
        )
        of_measured = period / 2.0 if run.run.source == MEASURED_EFFORT else 0.0
        of_pause = pause / 12.0**0.5 if pause > 2.5 * period else 0.0
        return {
            "onset": math.hypot(robot.onset_jitter_s, of_measured, of_pause),
            "disturbance": math.hypot(robot.torque_disturbance, run.current_torque_std),
        }


class FreeSwing(Push):
    """Torque is off, and gravity moves the joint from wherever and however fast it is."""

    unneeded = ("torque_constant", "delay")
    kept_rise = RISE
    kept = ("zero", *RIPPLE_TERMS, *RISE)
    """Their effect is the same in every swing of the joint, so that what is learnt from the swings takes it in, while as unknowns
    they would bend to whatever friction no law follows. What another rise would have made of the rest is in a calibration's
    covariance; the next swing of the joint, whose rise is the same, is fitted given it."""
    both_ways = True
    # Where a joint comes to a stop the cost has kinks, at which a step overshoots: the search must go on with shorter ones, or it
    # ends where it has not arrived, and takes what it misses for the swings' noise.
    iterations = 60
    iterations_again = 60
    late_s = math.inf  # no command begins it
    most_missed = 0.03
    # swings differ by more than a run says of itself: a good servo's loads would be doubted
    most_pull = math.inf

    def yielding(self, joints: tuple[str, ...]) -> tuple[str, ...]:
        return ()

    def rest(self, robot: Robot, run: Run) -> Quantity:
        """Where the swing begins."""
        return Quantity(float(run.position[0]), START_STD)

    def model_error(self, robot: Robot) -> float:
        """As the calibration has it, or as is usual."""
        return robot.swing_error or FIRST_SWING_ERROR

    def loads(
        self,
        run: Run,
        coefficients: Coefficients,
        facts: PayloadFacts,
    ) -> Loads:
        """What friction that grows with the load acts on.

        With no current the gears carry the weight, and lose part of it in the direction of motion. Where the joint is and which way
        it goes is read off the recording, so that this friction is a known load times one unknown: the size of the moment of 1 kg
        with the sign of the velocity at each sample [N m/kg]. The arm loads the gears as some payload would [kg].

        Args:
            run: At the motor's shaft.
            coefficients: Of the run.
            facts: About what the hand holds.
        """
        if not coefficients.payload.any():
            return Loads()
        _, cos, sin, constant = coefficients.per_kg(facts)
        arm = float(np.hypot(coefficients.arm[1], coefficients.arm[2]))
        width = max(
            round(SLOPE_S / float(np.median(np.diff(run.times_s)))) | 1,
            3,
        )
        smooth = np.convolve(
            np.pad(
                run.position,
                width // 2,
                mode="edge",
            ),
            np.full(width, 1.0 / width),
            "valid",
        )
        side = np.tanh(np.gradient(smooth, run.times_s) / SLOW)
        q = run.position
        moment = np.abs(cos * np.cos(q) + sin * np.sin(q) + constant)
        per_kg = moment * side
        return Loads(
            run.times_s,
            np.stack([np.zeros_like(per_kg), per_kg], axis=1),
            arm / max(float(np.hypot(cos, sin)), 1e-12),
        )

    def start_velocity(self, robot: Robot, run: PreparedRun) -> Quantity:
        """The slope of the first samples."""
        first = max(int(np.searchsorted(run.times_s, SLOPE_S)), 3)
        line = np.polyfit(
            run.times_s[:first],
            run.position[:first],
            1,
        )
        return Quantity(float(line[0]), START_VELOCITY_STD)

    def repeats(self, robot: Robot, run: PreparedRun) -> dict[str, float]:
        """All friction is by a factor another, the weight, and where the joint's zero is.

        No command begins it, and a torque that pushes one way would take the place of the weight.
        """
        return {
            "friction_change": robot.friction_spread,
            "moment_change": MOMENT_REPEATS,
            "swing_zero": ZERO_REPEATS * robot.drive_trains[run.run.joint].zero.std,
            "onset": 0.0,
            "disturbance": 0.0,
        }


PUSH = Push()
FREE_SWING = FreeSwing()


def kind_of(run: Run) -> Push:
    """The kind of a run as it was recorded."""
    return FREE_SWING if run.is_free_response else PUSH


def one_kind(runs: Sequence[PreparedRun]) -> Push:
    """The kind that all runs are of. Raises `RecordingError`: They are of several."""
    first = {run.kind: run.run.name for run in reversed(runs)}
    if len(first) > 1:
        swing = f"{first[FREE_SWING]} is a free swing"
        raise RecordingError(f"{swing} and {first[PUSH]} is driven by a current: give them apart")
    return runs[0].kind
