"""How measured efforts compare with the torque that gravity needs by the URDF, in whatever unit they may be."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass

import numpy as np

from proprio_ros.errors import RobotError
from proprio_ros.recordings.effort import CURRENT_PER_COUNT_A, EFFORT_UNITS, ampere
from proprio_ros.recordings.plausibility import evenly, moving, times_of
from proprio_ros.records import FloatArray, Recording
from proprio_ros.robot import ReducedModel, Robot, is_description
from proprio_ros.robot.regressor import body_parameters, carriers, gravity_along, kinematics

SMOOTHED_S = 0.1  # efforts are compared with gravity over this time [s]
PLAUSIBLE = (0.5, 2.0)
"""Effort over the torque that gravity needs: within it lie an unknown load, gears that lose a part, and a URDF that is 15 % off."""
LEAST_T = 15.0
"""Times its formal standard error that gravity's share of an effort must be: residuals are correlated over seconds."""
LEAST_LOAD = 0.1
"""Of the largest change of gravity's torque on any joint: a wrist that hardly lifts says nothing of units."""
FEWEST_SAMPLES, FEWEST_MEANS = 50, 20


@dataclass(frozen=True)
class EffortUnit:
    """How the effort would compare with the torque that gravity needs if it were in some unit."""

    unit: str  # as for ``--effort-unit``
    # effort in N m over that torque by joint; 1 where all is as the URDF says
    ratio: Mapping[str, float]
    plausible: bool  # whether their median is within `PLAUSIBLE`
    as_json = asdict


def gravity_torque(
    model: ReducedModel,
    position: FloatArray,
) -> FloatArray:
    """Torque at each revolute joint that holds the arm at positions [rad]; both of shape (T, n) [N m]."""
    motion = kinematics(model, position, np.zeros_like(position))
    torque = np.zeros_like(position)
    for body, pseudo in enumerate(model.pseudo_inertia):
        force = np.tensordot(
            body_parameters(pseudo),
            gravity_along(model, motion, body),
            1,
        )
        torque[:, carriers(model, body)] -= force.T
    return torque


@dataclass(frozen=True)
class _Means:
    """Positions and efforts of the joints that turn, means over `SMOOTHED_S`."""

    model: ReducedModel
    position: FloatArray  # [rad], (B, n)
    effort: FloatArray  # in the publisher's unit, (B, n)
    step_s: float  # between them [s]


def _means(recording: Recording, robot: Robot) -> _Means | None:
    """Of the longest stretch without a gap; None where too little was recorded."""
    record = recording.joints
    slides = [joint.name for joint in robot.model.joints if joint.kind == "prismatic"]
    all_of_it = robot.model.independent_joints if robot.tip is None else robot.drive_trains
    turning = [name for name in all_of_it if name not in slides]
    # what is behind a joint that was not recorded would be somewhere else
    if record.reported_effort is None or not turning or not set(turning) <= set(record.names):
        return None
    held = dict.fromkeys(slides, 0.0)
    for name in record.names:
        held[name] = float(record.position[:, record.column(name)].mean())
    model = robot.model.lock(turning, held, robot.gravity)
    columns = [record.column(name) for name in model.joint_names]
    values = np.stack(
        [record.position[:, columns], record.reported_effort[:, columns]], axis=2
    )  # (T, n, 2)
    known = np.isfinite(values).all(axis=(1, 2))
    if known.sum() < FEWEST_SAMPLES:
        return None
    times_s, even = evenly(times_of(record)[known], values[known])
    period_s = float(times_s[1] - times_s[0])
    width = max(1, round(SMOOTHED_S / period_s))
    count = len(times_s) // width
    if count < FEWEST_MEANS:
        return None
    bins = even[: count * width].reshape(
        count,
        width,
        len(columns),
        2,
    )
    binned = bins.mean(axis=1)  # (B, n, 2)
    return _Means(
        model,
        binned[:, :, 0],
        binned[:, :, 1],
        width * period_s,
    )


def effort_per_torque(
    recording: Recording,
    robot: Robot,
) -> dict[str, float]:
    """Effort per N m that gravity needs, of every joint that moves enough against it, in the publisher's unit.

    Friction of either direction, inertia and an offset are fitted beside it, on means over `SMOOTHED_S`.
    """
    means = _means(recording, robot)
    if means is None:
        return {}
    velocity = np.gradient(means.position, means.step_s, axis=0)
    acceleration = np.gradient(velocity, means.step_s, axis=0)
    torque = gravity_torque(means.model, means.position)
    least = LEAST_LOAD * np.ptp(torque, axis=0).max()
    found = {}
    moved = moving(recording.joints)
    for column, name in enumerate(means.model.joint_names):
        load = torque[:, column]
        effort = means.effort[:, column]
        if name not in moved or np.ptp(effort) == 0.0:
            continue
        speed = velocity[:, column]
        matrix = np.column_stack(
            [
                load,
                np.tanh(speed / 0.02),
                speed,
                acceleration[:, column],
                np.ones(len(load)),
            ]
        )
        share = _share_of_first(matrix, effort)
        if share is not None and np.ptp(load) >= least:
            found[name] = share
    return found


def _share_of_first(
    matrix: FloatArray,
    seen: FloatArray,
) -> float | None:
    """Coefficient of the first column in a fit of what was seen; None where it is not sure.

    Args:
        matrix: Shape (B, K).
        seen: Shape (B,).
    """
    size = np.maximum(
        np.abs(matrix).max(axis=0),
        1e-12,
    )
    matrix = matrix / size
    solution, _, rank, _ = np.linalg.lstsq(
        matrix,
        seen,
        rcond=1e-8,
    )
    count, columns = matrix.shape
    if rank < columns:
        return None
    residual = seen - matrix @ solution
    inverse = np.linalg.inv(matrix.T @ matrix)
    variance = residual @ residual / (count - columns)
    error = float(np.sqrt(variance * inverse[0, 0]))
    if abs(solution[0]) <= LEAST_T * error:
        return None
    return float(solution[0] / size[0])


def effort_units(
    per_torque: Mapping[str, float],
    constants: Mapping[str, float],
    per_count_A: float,
) -> tuple[EffortUnit, ...]:
    """How plausible each unit is that effort may be in.

    Args:
        per_torque: Effort per torque that gravity needs, by joint, as of `effort_per_torque`.
        constants: Torque constants by joint [N m/A].
        per_count_A: Current of a raw count [A].

    Returns:
        An entry for each unit that can be judged.
    """
    result = []
    for unit in EFFORT_UNITS:
        ratio = dict(per_torque)
        if unit != "N.m":
            of_one_A = {name: value for name, value in per_torque.items() if name in constants}
            ratio = {
                name: value * (ampere(unit, per_count_A) * constants[name])
                for name, value in of_one_A.items()
            }
        if ratio:
            middle = float(np.median(list(ratio.values())))
            plausible = PLAUSIBLE[0] <= middle <= PLAUSIBLE[1]
            result.append(EffortUnit(unit, ratio, plausible))
    return tuple(result)


def plausible_units(
    recording: Recording,
    robot: Robot,
    without: Collection[str] = (),
) -> tuple[dict[str, float], tuple[EffortUnit, ...]]:
    """How the effort compares with what gravity needs, in whatever unit it may be.

    Args:
        recording: With efforts.
        robot: Its URDF says what gravity needs, and its file the torque constants.
        without: Joints whose effort is of no use.

    Returns:
        Effort over what gravity needs, by joint, and how plausible units are by it.
    """
    try:
        per_torque = effort_per_torque(recording, robot)
    except RobotError:  # a body without mass, as of a robot whose file leaves that joint out
        return {}, ()
    per_torque = {name: value for name, value in per_torque.items() if name not in without}
    if not per_torque:
        return {}, ()
    stated = {} if is_description(str(robot.source)) else robot.drive_trains
    constants = {name: drive.torque_constant.value for name, drive in stated.items()}
    return per_torque, effort_units(per_torque, constants, CURRENT_PER_COUNT_A)
