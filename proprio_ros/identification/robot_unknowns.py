"""The unknowns of a fit of rigid loads: what is open about the robot and the payload, and each run's own start."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from proprio_ros.calibration_files.pushes import Calibration
from proprio_ros.identification.coefficients import link_stds
from proprio_ros.identification.prepared_runs import (
    PreparedRun,
    joints_of,
)
from proprio_ros.identification.unknowns import Role, Unknown
from proprio_ros.kinds import Key, Scope
from proprio_ros.quantity import Quantity
from proprio_ros.records import MEASURED_EFFORT
from proprio_ros.robot import Robot
from proprio_ros.sim.payload import PayloadFacts

PAYLOAD_TERMS = (
    "payload_mass",
    "payload_com_x",
    "payload_com_y",
    "payload_com_z",
    "shape_scale",
)
DRIVE_TERMS = (
    "torque_constant",
    "coulomb",
    "viscous",
    "load_friction",
    "armature",
    "stribeck",
    "stribeck_velocity",
)
"""Fields of a ``DriveTrain`` that are unknowns of the driven joint."""
# a bump of friction narrower than this is over within a sample of any push [rad/s]
SLOWEST_STRIBECK = 0.02
RIPPLE_TERMS = ("ripple_cos", "ripple_sin")
"""The encoder's once-per-turn error: a magnet that sits off its axis adds ``a cos q + b sin q`` to the reading [rad]."""
START_VELOCITY_STD = 2.0
"""How far off the slope of a free swing's first samples may be: next to nothing is assumed [rad/s]."""
NOT_IN_A_SWING = (
    "torque_constant",
    "delay",
)  # without a current, nothing depends on these
RISE = (
    "stribeck",
    "stribeck_velocity",
)  # how dry friction rises towards standstill
KEPT_IN_A_SWING = ("zero", *RIPPLE_TERMS, *RISE)
"""Of the swinging joint, what stays where the file has it: its effect is the same in every swing of the joint, so that what is
learnt from the swings takes it in, while as unknowns they would bend to whatever friction no law follows. What another rise would
have made of the rest is in a calibration's covariance; the next swing of the joint, whose rise is the same, is fitted given it."""
OF_A_SWING = ("friction_change", "moment_change", "swing_zero")
"""What each swing of a joint has of its own: all its friction is by a factor another, its weight, and where the joint's zero is."""
MOMENT_REPEATS = 0.015
"""Standard deviation of gravity's moment over inertia between swings of one joint with one load, relative: masses of servos that
were let go repeat to 1.9 to 4.5 %, which is 1 to 2 % of it where the rotor is half of the inertia."""
ZERO_REPEATS = 0.3  # of a zero as well as the file knows it, what differs from swing to swing
ZEROS_BESIDE = 5.0
"""How many times as far as usual zeros are let go where a known load beside the object tells them.

It costs nothing there, and 15 mrad are followed that would else be taken for weight.
"""
COMMON_SHARE = 0.5
"""Of the variance of torque constants, what motors of one kind have in common before anything is learnt: a maker's number is off
for all of them, and each differs from it. If each erred on its own alone, several joints together would tell the arm's weight from
that number better than anybody knows it."""


def load_unknowns(
    robot: Robot,
    runs: Sequence[PreparedRun],
    facts: PayloadFacts,
    drive_role: Role,
    start_mass_kg: float,
) -> list[Unknown]:
    """All unknowns of a weighing: the payload, and those of `robot_unknowns`.

    Args:
        robot: As there.
        runs: As there.
        facts: What is stated about the payload.
        drive_role: As there; the centre of mass is free where it is not known.
        start_mass_kg: From which a fit starts.
    """
    unknowns = [
        Unknown(
            "payload_mass",
            start_mass_kg,
            np.inf,
            -0.5,
            20.0,
            asinh_scale=0.005,
        )
    ]
    for axis, name in enumerate("xyz"):
        spread = float(facts.com_std[axis])
        unknowns.append(
            Unknown(
                f"payload_com_{name}",
                float(facts.com[axis]),
                spread,
                -1.0,
                1.0,
            ).at_role(Role.ESTIMATED)
        )
    unknowns.append(
        Unknown(
            "shape_scale",
            1.0,
            facts.shape_std_relative,
            0.0,
            10.0,
        ).at_role(drive_role)
    )
    return [*unknowns, *robot_unknowns(robot, runs, drive_role)]


def robot_unknowns(
    robot: Robot,
    runs: Sequence[PreparedRun],
    drive_role: Role,
) -> list[Unknown]:
    """What is open about the robot in these runs, shared and of each run on its own.

    Values and standard deviations are those of the robot file, or of its calibration where that knows an unknown.

    Args:
        robot: Whose file and calibration count.
        runs: Whose joints, links and starts they are of.
        drive_role: ``FIXED`` keeps the robot at these values, ``ESTIMATED`` lets the recording move them under their priors.

    Returns: the shared ones first, then those of each run.
    """
    learnt = prior_of(robot, runs)
    known = {} if learnt is None else learnt.quantities
    unknowns = []
    for unknown in _shared_unknowns(robot, runs):
        if unknown.key in known:
            unknown = _from_quantity(
                unknown.kind,
                unknown.scope,
                known[unknown.key],
                unknown.lower,
                unknown.upper,
            )
        unknowns.append(unknown.at_role(drive_role))
    for row, run in enumerate(runs):
        unknowns += _of_run(robot, row, run, drive_role)
    return unknowns


def _shared_unknowns(robot: Robot, runs: Sequence[PreparedRun]) -> list[Unknown]:
    """Those that runs share, as the robot file has them: arm, delay, drive trains, zeros and encoders, links."""
    shared = [
        _from_quantity("arm_scale", None, robot.arm_scale, lower=0.1),
        _from_quantity("delay", None, robot.delay, lower=-0.1, upper=0.1),
    ]
    for name in joints_of(runs):
        drive = robot.drive_trains[name]
        for kind in DRIVE_TERMS:
            lower = SLOWEST_STRIBECK if kind == "stribeck_velocity" else 0.0
            shared.append(_from_quantity(kind, name, getattr(drive, kind), lower=lower))
    posed: list[str] = []
    for run in runs:
        posed += [run.run.joint, *run.coefficients.pose]
    for name in dict.fromkeys(posed):
        moved = robot.drive_trains.get(name)
        if moved is None or moved.transmission != 1.0:
            continue
        # a locked joint's reading is rounded the same way in every sample
        std = float(
            np.hypot(
                moved.zero.std,
                moved.encoder_resolution / np.sqrt(12.0),
            )
        )
        shared.append(_from_quantity("zero", name, Quantity(moved.zero.value, std)))
        ripple = Quantity(0.0, moved.encoder_once_per_turn)
        shared += [_from_quantity(kind, name, ripple) for kind in RIPPLE_TERMS]
    stds = {link.name: link_stds(robot, link) for link in robot.model.links}
    links = dict.fromkeys(key for run in runs for key in run.coefficients.links)
    for kind, link in links:
        shared.append(_from_quantity(kind, link, Quantity(0.0, stds[link][kind])))
    return shared


def _of_run(robot: Robot, row: int, run: PreparedRun, drive_role: Role) -> list[Unknown]:
    """Where a run began, how its onset and torque differ from other runs', and what a free swing has of its own."""
    swing = run.run.is_free_response
    velocity = (run.start_velocity, START_VELOCITY_STD) if swing else (0.0, robot.start_velocity)
    start = [
        Unknown("q0", run.rest.value, run.rest.std, scope=row),
        Unknown("v0", *velocity, scope=row),
    ]
    repeats: dict[str, float] = {}
    if swing:
        repeats = {
            "friction_change": robot.friction_spread,
            "moment_change": MOMENT_REPEATS,
            "swing_zero": ZERO_REPEATS * robot.drive_trains[run.run.joint].zero.std,
        }
    differs = []
    for kind, std in repeats.items():
        differs.append(Unknown(kind, 0.0, std, -0.9, scope=row))
    differs.append(
        Unknown(
            "onset",
            0.0,
            onset_std(robot, run),
            -0.1,
            0.1,
            scope=row,
        )
    )
    # a swing's friction differs, not a torque that pushes one way: that would take the place of the weight
    disturbance = 0.0 if swing else math.hypot(robot.torque_disturbance, run.current_torque_std)
    differs.append(Unknown("disturbance", 0.0, disturbance, scope=row))
    return start + [unknown.at_role(drive_role) for unknown in differs]


def prior_of(robot: Robot, runs: Sequence[PreparedRun]) -> Calibration | None:
    """What a calibration says of runs that it was not made of: zeros may be others, the rest is the same.

    A free swing has an unknown of its own for where its zero is.
    """
    if robot.calibration is None or any(run.run.is_free_response for run in runs):
        return robot.calibration
    return robot.calibration.with_other_zeros(zero_repeat_of(robot, runs))


def zero_repeat_of(robot: Robot, runs: Sequence[PreparedRun]) -> float:
    """How far a zero may be elsewhere in some runs than the calibration has it, as a standard deviation [rad]."""
    return robot.zero_repeat * (ZEROS_BESIDE if has_known_load(runs) else 1.0)


def has_known_load(runs: Sequence[PreparedRun]) -> bool:
    """Whether one of the runs is of an empty hand or a reference, which tells where zeros are today."""
    return any(run.load is not None for run in runs)


def onset_std(robot: Robot, run: PreparedRun) -> float:
    """How the delay differs from run to run.

    Where the input is measured effort, its onset is only known to one period. Where joint states pause around it, whoever takes
    commands may have paused, too, or not: then it may be anywhere in the pause.
    """
    if run.run.is_free_response:  # no command begins it
        return 0.0
    period = float(np.median(np.diff(run.run.times_s)))
    pause = (
        float(run.run.times_s[0] - run.run.before_times_s[-1])
        if len(run.run.before_times_s)
        else 0.0
    )
    of_measured = period / 2.0 if run.run.source == MEASURED_EFFORT else 0.0
    of_pause = pause / 12.0**0.5 if pause > 2.5 * period else 0.0
    return math.hypot(robot.onset_jitter_s, of_measured, of_pause)


def _from_quantity(
    kind: str,
    scope: Scope,
    quantity: Quantity,
    lower: float = -np.inf,
    upper: float = np.inf,
) -> Unknown:
    return Unknown(
        kind,
        float(np.clip(quantity.value, lower, upper)),
        quantity.std,
        lower,
        upper,
        scope=scope,
    )


def of_one_kind(
    robot: Robot,
    estimated: Sequence[Unknown],
) -> tuple[list[Key], np.ndarray]:
    """Keys and prior covariance of the torque constants among some unknowns; motors of one kind err together in part."""
    constants = [unknown for unknown in estimated if unknown.kind == "torque_constant"]
    kinds = [
        robot.drive_trains[str(unknown.scope)].nominal_effort_per_current for unknown in constants
    ]
    std = np.array([unknown.std for unknown in constants])
    alike = np.array(
        [[one == other for other in kinds] for one in kinds],
        dtype=float,
    ).reshape(len(std), len(std))
    shares = COMMON_SHARE * alike + (1.0 - COMMON_SHARE) * np.eye(len(std))
    return [unknown.key for unknown in constants], shares * np.outer(std, std)
