"""What must hold before an excitation begins and while it goes on: the limits of motion, and the checks that need no machine.

Before anything moves it is computed whether a servo that goes all the way to its goal stays inside, and whether a joint that is let
go of would swing back inside its limits, without friction and with an empty hand. Limits of motion that are given in rad count at
the motor's shaft; for a joint that slides they are scaled by its transmission.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from proprio_ros.errors import ExcitationError
from proprio_ros.excitation.commands import JointSample
from proprio_ros.excitation.plans import ExcitationRun, ExcitationSequence
from proprio_ros.excitation.ways import Ways
from proprio_ros.robot import Robot

LEAST_MOMENT_N_M = 1e-3  # gravity that pulls less moves no joint
STEP_RAD = 0.02  # between two places of the way that are looked at


@dataclass(frozen=True)
class Guards:
    """When to stop. Angles and speeds count at the motor's shaft."""

    limit_margin_rad: float = 0.05  # room left before a joint's limit during a run
    max_velocity_rad_s: float = 6.0  # no joint may be faster
    # neither samples nor ticks may be further apart while a current is on; such a run is repeated
    stale_after_s: float = 0.1
    # the same while all joints are held, which the servos do without us; never less than ``stale_after_s``
    patience_s: float = 1.0
    # follow_error_rad, follow_time_s: a joint may be off its goal by so much, for so long, while no current is on
    follow_error_rad: float = 0.15
    follow_time_s: float = 0.5
    # a run ends when its joint would reach a limit or the table within this time at its present speed
    lookahead_s: float = 0.08
    # a joint that is held during a run may be off its goal by so much
    held_joint_error_rad: float = 0.12
    # a position may change by so much from one sample to the next, or as far as the largest velocity takes it
    max_jump_rad: float = 0.3


def unfit(sample: JointSample, joints: Sequence[str]) -> str:
    """What is wrong with a sample in itself; empty when nothing is."""
    if not math.isfinite(sample.time_s):
        return f"a sample has the time stamp {sample.time_s}: check the driver"
    for what, values in (("position", sample.position), ("velocity", sample.velocity)):
        missing = [name for name in joints if name not in values]
        if missing:
            return (
                f"a sample lacks the {what} of {', '.join(missing)}: check that all servos answer"
            )
        for name in joints:
            if not math.isfinite(values[name]):
                return f"the {what} of {name} is {values[name]}: check the driver and the cable"
    return ""


def check_start(sample: JointSample, ways: Ways, guards: Guards) -> None:
    """Whether an excitation may begin.

    Args:
        sample: The newest reading.
        ways: Of the arm.
        guards: Limits of motion.

    Raises:
        ExcitationError: The sample is no good, or a joint is beyond its limits.
    """
    problem = unfit(sample, ways.joints)
    if problem:
        raise ExcitationError(f"cannot start: {problem}")
    for name in ways.joints:
        low, high = ways.limits(name, -guards.limit_margin_rad)
        if not low <= sample.position[name] <= high:
            joint = ways.robot.model.joint(name)
            limits = f"{joint.lower:.4g} .. {joint.upper:.4g}"
            remedy = "check its zero and its unit, or move it back by hand with torque off (a virtual one: call its recover)"
            raise ExcitationError(
                f"cannot start: {name} reads {sample.position[name]:.4g}, outside its limits {limits}; {remedy}"
            )


@dataclass(frozen=True)
class FreeResponse:
    """A joint as a pendulum: gravity's moment on it is ``moment_N_m sin(rest - position)``."""

    moment_N_m: float  # largest gravity moment, at the joint
    rest: float  # where the joint would hang, within half a turn of where it was asked for [rad]
    inertia_kg_m2: float  # about the joint, of what moves with it, without the rotor

    def moment_at(self, position: float) -> float:
        """Gravity's moment on the joint [N m]."""
        return self.moment_N_m * math.sin(self.rest - position)

    def speed_at(self, position: float, start: float, rotor_kg_m2: float = 0.0) -> float:
        """Speed without friction on the way from a start at rest.

        Args:
            position: Of the joint now [rad].
            start: Where it began [rad].
            rotor_kg_m2: What the rotor adds to the inertia [kg m^2].

        Returns:
            The speed [rad/s].
        """
        fallen = math.cos(self.rest - position) - math.cos(self.rest - start)
        return math.sqrt(
            max(2.0 * self.moment_N_m * fallen / (self.inertia_kg_m2 + rotor_kg_m2), 0.0)
        )

    def way(self, start: float) -> np.ndarray:
        """Places from a start to where it would swing to without friction, as far beyond the rest [rad]."""
        end = 2.0 * self.rest - start
        return np.linspace(
            start,
            end,
            2 + math.ceil(abs(end - start) / STEP_RAD),
        )


def free_swing(robot: Robot, joint: str, pose: Mapping[str, float]) -> FreeResponse:
    """The pendulum that a joint is, with an empty hand.

    Args:
        robot: The arm.
        joint: A joint that turns.
        pose: Of all independent joints [rad or m].

    Raises:
        ExcitationError: The joint slides, drives another one too, or gravity does not move it.
    """
    if robot.model.joint(joint).kind == "prismatic":
        raise ExcitationError(
            f"{joint} slides: only a joint that turns swings freely; give it a current"
        )
    body = robot.model.lock(
        [joint],
        pose,
        robot.gravity,
    )
    axis = body.axes[0]
    pseudo = robot.arm_scale.value * body.pseudo_inertia[0]
    gravity = body.placement[0][:3, :3].T @ body.gravity
    second = pseudo[:3, :3]
    first = pseudo[:3, 3]
    at_zero = float(axis @ np.cross(first, gravity))
    at_quarter = float(axis @ np.cross(np.cross(axis, first), gravity))
    moment = math.hypot(at_zero, at_quarter)
    if moment < LEAST_MOMENT_N_M:
        raise ExcitationError(
            f"gravity does not move {joint} here: it cannot swing; choose another joint or start"
        )
    rest = math.atan2(at_zero, -at_quarter)
    rest += 2.0 * math.pi * round((pose[joint] - rest) / (2.0 * math.pi))
    inertia = float(np.trace(second) - axis @ second @ axis)
    return FreeResponse(moment, rest, inertia)


def check_free_response(
    run: ExcitationRun,
    start: Mapping[str, float],
    sequence: ExcitationSequence,
    ways: Ways,
    guards: Guards,
    words: str,
) -> None:
    """Whether a joint that is let go of swings back without a guard, with the lightest rotor that the robot file allows.

    Args:
        run: The free response.
        start: Pose of all driven joints before it [rad or m].
        sequence: States the clearance.
        ways: Of the arm.
        guards: Limits of motion.
        words: The run, as messages name it.

    Raises:
        ExcitationError: A guard would end the swing, or friction would keep the joint where it is.
    """
    pose = ways.whole(start)
    swing = free_swing(ways.robot, run.joint, pose)
    _check_pull(run.joint, pose, swing, ways, guards, words)
    position = pose[run.joint]
    drive = ways.robot.drive_trains[run.joint]
    rotor = max(drive.armature.value - drive.armature.std, 0.0) / drive.transmission**2
    for place in swing.way(position).tolist():
        speed = swing.speed_at(place, position, rotor)
        if speed > guards.max_velocity_rad_s * ways.per_rad[run.joint]:
            near = f"start nearer to where {_hangs(swing)}"
            raise ExcitationError(f"{words}: it may reach {speed:.1f} rad/s; {near}")
        reach = speed * guards.lookahead_s
        for ahead in (place - reach, place + reach):
            _check_place(
                run.joint, {**pose, run.joint: ahead}, swing, sequence, ways, guards, words
            )


def _hangs(swing: FreeResponse) -> str:
    return f"it would hang at {swing.rest:.3g} rad"


def _check_pull(
    joint: str,
    pose: Mapping[str, float],
    swing: FreeResponse,
    ways: Ways,
    guards: Guards,
    words: str,
) -> None:
    """Whether gravity moves the joint, towards a place inside its limits."""
    low, high = ways.limits(joint, guards.limit_margin_rad)
    hangs = _hangs(swing)
    if not low <= swing.rest <= high:
        inside = f"{low:.3g} .. {high:.3g} (limits less a margin)"
        remedy = "move the other joints, so that it hangs inside, or choose another joint"
        raise ExcitationError(f"{words}: {hangs}, outside {inside}; {remedy}")
    drive = ways.robot.drive_trains[joint]
    weight_N_m = abs(swing.moment_at(pose[joint]) * drive.transmission)
    # what is to be expected of a number that cannot be negative and is only known to be small: a half-normal's mean
    usual_N_m = math.sqrt(2.0 / math.pi) * drive.coulomb.std
    friction_N_m = max(drive.coulomb.value, usual_N_m)
    if weight_N_m <= friction_N_m:
        pulls = f"from {pose[joint]:.3g} rad gravity pulls with {weight_N_m:.2g} N m"
        rubs = f"its friction is probably {friction_N_m:.2g} N m"
        remedy = f"start farther from where {hangs}, or take a calibration that knows the friction"
        raise ExcitationError(f"{words}: {pulls}, and {rubs}; {remedy}")


def _check_place(
    joint: str,
    pose: Mapping[str, float],
    swing: FreeResponse,
    sequence: ExcitationSequence,
    ways: Ways,
    guards: Guards,
    words: str,
) -> None:
    """Whether a joint that swings may get to a pose."""
    low, high = ways.limits(joint, guards.limit_margin_rad)
    if not low <= pose[joint] <= high:
        past = f"{_hangs(swing)}, and may swing past {pose[joint]:.3g} rad without friction"
        inside = f"{low:.3g} .. {high:.3g} (limits less a margin)"
        remedy = "start nearer to where it hangs, or move the other joints"
        raise ExcitationError(f"{words}: {past}, outside {inside}; {remedy}")
    height = ways.height(pose)
    if height < sequence.min_clearance_m:
        above = f"{100 * height:.1f} cm above the base's plane"
        place = f"at {pose[joint]:.3g} rad without friction"
        remedy = "choose a higher pose, or start nearer to where it hangs"
        raise ExcitationError(f"{words}: it would come {above} {place}; {remedy}")
