"""The unknowns of a fit of rigid loads: what is open about the robot and the payload, and each run's own start."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from proprio_ros.calibration_files.pushes import Calibration
from proprio_ros.identification.coefficients import link_stds
from proprio_ros.identification.prepared_runs import (
    PreparedRun,
    joints_of,
)
from proprio_ros.identification.run_kinds import RIPPLE_TERMS
from proprio_ros.identification.unknowns import Role, Unknown
from proprio_ros.kinds import Key, Scope
from proprio_ros.quantity import Quantity
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
BOUNDS = {"onset": (-0.1, 0.1), "disturbance": (-np.inf, np.inf)}
"""Of what differs from run to run, where it is no share [s, N m]."""
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
    """Where a run began, how its onset and torque differ from other runs', and what its kind has of its own."""
    start = [
        _from_quantity("q0", row, run.rest),
        _from_quantity("v0", row, run.kind.start_velocity(robot, run)),
    ]
    differs = []
    for kind, std in run.kind.repeats(robot, run).items():
        bounds = BOUNDS.get(kind, (-0.9, np.inf))
        differs.append(Unknown(kind, 0.0, std, *bounds, scope=row))
    return start + [unknown.at_role(drive_role) for unknown in differs]


def prior_of(robot: Robot, runs: Sequence[PreparedRun]) -> Calibration | None:
    """What a calibration says of other runs: zeros may be others where a fit follows them, the rest is the same."""
    if robot.calibration is None or any("zero" in run.kind.kept for run in runs):
        return robot.calibration
    return robot.calibration.with_other_zeros(zero_repeat_of(robot, runs))


def zero_repeat_of(robot: Robot, runs: Sequence[PreparedRun]) -> float:
    """How far a zero may be elsewhere in some runs than the calibration has it, as a standard deviation [rad]."""
    return robot.zero_repeat * (ZEROS_BESIDE if has_known_load(runs) else 1.0)


def has_known_load(runs: Sequence[PreparedRun]) -> bool:
    """Whether one of the runs is of an empty hand or a reference, which tells where zeros are today."""
    return any(run.load is not None for run in runs)


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
