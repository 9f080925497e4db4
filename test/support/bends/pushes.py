"""What can be wrong beside a push: bends of a recording in memory, before its runs are cut out; those of bags are `beside_pushes`.

Each takes a `Recording` and gives another one. Instants count from the first current that is not zero.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from proprio_ros.calibration_files.pushes import Calibration
from proprio_ros.records import InputRecord, JointRecord, Recording


def zero_off(recording: Recording, joint: str, by_rad: float) -> Recording:
    """A joint is read from elsewhere than it is, throughout."""
    return step(recording, joint, by_rad, -np.inf)


def step(
    recording: Recording,
    joint: str,
    by_rad: float,
    at_s: float,
) -> Recording:
    """A joint's reading jumps at an instant and stays off.

    Args:
        recording: With an input.
        joint: Whose reading jumps.
        by_rad: By how much [rad].
        at_s: When, since the onset [s].
    """
    joints = recording.joints
    since_s = 1e-9 * (joints.times_ns - onset_ns(recording))
    position = joints.position.copy()
    position[since_s >= at_s, joints.column(joint)] += by_rad
    return replace(recording, joints=replace(joints, position=position))


def swapped(recording: Recording, joint: str, other: str) -> Recording:
    """The positions of two joints are exchanged."""
    joints = recording.joints
    order = list(range(len(joints.names)))
    one = joints.column(joint)
    another = joints.column(other)
    order[one] = another
    order[another] = one
    return replace(
        recording,
        joints=replace(joints, position=joints.position[:, order]),
    )


def scaled_command(recording: Recording, factor: float) -> Recording:
    """The command that was recorded is a multiple of that which flowed; efforts stay."""
    inputs = _input(recording)
    return replace(
        recording,
        inputs=replace(inputs, current_A=factor * inputs.current_A),
    )


def noisy_command(
    recording: Recording,
    std_A: float,
    random: np.random.Generator,
) -> Recording:
    """Every row of the command was recorded with an error of its own while the joint is driven; efforts stay.

    Args:
        recording: With an input.
        std_A: Standard deviation of the error [A].
        random: Draws the errors.
    """
    inputs = _input(recording)
    noise = std_A * random.standard_normal(inputs.current_A.shape) * (inputs.current_A != 0.0)
    return replace(
        recording,
        inputs=replace(inputs, current_A=inputs.current_A + noise),
    )


def command_of(recording: Recording, joint: str) -> Recording:
    """The command stands in the column of another joint."""
    inputs = _input(recording)
    driven = int(np.abs(inputs.current_A).max(axis=0).argmax())
    order = list(range(len(inputs.names)))
    other = inputs.column(joint)
    order[driven] = other
    order[other] = driven
    return replace(
        recording,
        inputs=replace(inputs, current_A=inputs.current_A[:, order]),
    )


def without_joint(recording: Recording, joint: str) -> Recording:
    """A joint was not recorded."""
    joints = recording.joints
    kept = [column for column, name in enumerate(joints.names) if name != joint]

    def columns(values: np.ndarray | None) -> np.ndarray | None:
        return None if values is None else values[:, kept]

    record = JointRecord(
        joints.times_ns,
        tuple(joints.names[column] for column in kept),
        joints.position[:, kept],
        columns(joints.velocity),
        columns(joints.effort),
        columns(joints.current),
        columns(joints.reported_effort),
    )
    return replace(recording, joints=record)


def merged(calibration: Calibration, other: Calibration, joint: str) -> Calibration:
    """All that one calibration knows of a joint is another arm's, as after files were merged by hand; correlations stay."""
    values = calibration.values.copy()
    stds = np.sqrt(np.diag(calibration.covariance))
    for row, key in enumerate(calibration.keys):
        if not isinstance(key, str) and key[1] == joint and key in other.quantities:
            values[row] = other.quantities[key].value
            stds[row] = other.quantities[key].std
    covariance = calibration.correlation * stds[:, None] * stds
    return replace(calibration, values=values, covariance=covariance)


def onset_ns(recording: Recording) -> int:
    """When the first current that is not zero begins [ns]."""
    inputs = _input(recording)
    driven = np.abs(inputs.current_A).max(axis=1) > 0.0
    return int(inputs.times_ns[int(np.argmax(driven))])


def _input(recording: Recording) -> InputRecord:
    assert recording.inputs is not None
    return recording.inputs
