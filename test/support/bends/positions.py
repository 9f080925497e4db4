"""Positions that are not where the joints are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from proprio_ros.records import FloatArray
from support.bends.bend import Right, Rng, a_joint, bend, between, either_sign, one_of
from support.bends.tape import Stream, Tape

ZERO = r"zero|position|read from elsewhere|reversed|sign|direction"


def with_position(
    tape: Tape,
    joint: str,
    change: Callable[[FloatArray], FloatArray],
) -> Tape:
    """Other positions of one joint, shape (T,)."""

    def changed(states: Stream) -> Stream:
        if joint not in states.names:
            return states
        position = states.values["position"].copy()
        column = states.column(joint)
        position[:, column] = change(position[:, column])
        return states.with_values(position=position)

    return tape.with_states(changed)


@bend(
    "positions",
    Right(cause=ZERO),
    joint=a_joint,
)
def joint_reversed(tape: Tape, rng: Rng, joint: str) -> Tape:
    """One joint counts the other way round, as between two versions of a driver."""
    return with_position(tape, joint, lambda position: -position)


@bend(
    "positions",
    Right(cause=ZERO, codes=("other_zero",)),
    joint=a_joint,
    zero_rad=either_sign(0.005, 0.5),
)
def joint_zero_off(
    tape: Tape,
    rng: Rng,
    joint: str,
    zero_rad: float,
) -> Tape:
    """One joint is read from elsewhere."""
    return with_position(tape, joint, lambda position: position + zero_rad)


@bend(
    "positions",
    Right(cause=ZERO + "|step|jump"),
    joint=a_joint,
    step_rad=either_sign(0.01, 0.3),
    at=between(0.2, 0.8),
)
def joint_slips(
    tape: Tape,
    rng: Rng,
    joint: str,
    step_rad: float,
    at: float,
) -> Tape:
    """One joint's reading steps in mid-run, as of a gear that slips."""

    def slipped(position: FloatArray) -> FloatArray:
        late = np.arange(len(position)) >= at * len(position)
        return position + step_rad * late

    return with_position(tape, joint, slipped)


@bend(
    "positions",
    Right(told=True, cause="wrap"),
    joint=a_joint,
    low_rad=one_of((-np.pi, 0.0, -0.5 * np.pi)),
)
def joint_wraps(
    tape: Tape,
    rng: Rng,
    joint: str,
    low_rad: float,
) -> Tape:
    """One joint's angle wraps around in mid-motion: from -pi, 0 or -pi/2 on."""

    def wrapped(position: FloatArray) -> FloatArray:
        # so that it happens in mid-motion, wherever the joint moves
        shift = low_rad - float(np.median(position))
        turned = np.mod(position + shift - low_rad, 2.0 * np.pi) + low_rad
        return turned - shift

    return with_position(tape, joint, wrapped)


@bend(
    "positions",
    Right(cause=ZERO),
    joint=a_joint,
    gear_rad=between(0.002, 0.03),
)
def joint_has_play(
    tape: Tape,
    rng: Rng,
    joint: str,
    gear_rad: float,
) -> Tape:
    """One joint has backlash: the reading is behind the gear, on one flank or the other."""

    def played(position: FloatArray) -> FloatArray:
        velocity = np.gradient(position)
        return position + 0.5 * gear_rad * np.tanh(velocity / (np.std(velocity) * 0.1))

    return with_position(tape, joint, played)


@bend(
    "positions",
    Right(cause=ZERO + "|unit|deg"),
    factor=between(0.9, 1.1),
)
def positions_scaled(tape: Tape, rng: Rng, factor: float) -> Tape:
    """All positions are in another unit."""

    def scaled(states: Stream) -> Stream:
        return states.with_values(position=factor * states.values["position"])

    return tape.with_states(scaled)


@bend(
    "positions",
    Right(cause=r"sign|count|jump|no angle|register|turn"),
    joint=a_joint,
    bits=one_of((11, 15)),
)
def sign_bit_not_decoded(
    tape: Tape,
    rng: Rng,
    joint: str,
    bits: int,
) -> Tape:
    """One joint's negative counts have their sign in a bit that nobody decoded."""
    count_rad = 2.0 * np.pi / 4096.0

    def undecoded(position: FloatArray) -> FloatArray:
        counts = np.round(position / count_rad)
        return count_rad * np.where(counts < 0.0, 2.0**bits - counts, counts)

    return with_position(tape, joint, undecoded)


@bend(
    "positions",
    Right(told=True),
    value=one_of((440_000.0, -1e7)),
)
def another_column_in_another_unit(tape: Tape, rng: Rng, value: float) -> Tape:
    """A gripper stands beside the arm's joints in micrometres or counts."""

    def beside(states: Stream) -> Stream:
        column = np.linspace(0.0, value, len(states.bag_ns))[:, None]
        values = {
            name: np.hstack([table, column if name == "position" else np.zeros_like(column)])
            for name, table in states.values.items()
        }
        return replace(states, names=(*states.names, "a_gripper"), values=values)

    return tape.with_states(beside)


@bend(
    "positions",
    Right(cause=ZERO),
    gear_rad=between(0.002, 0.03),
)
def all_joints_have_play(tape: Tape, rng: Rng, gear_rad: float) -> Tape:
    """All joints have backlash: readings are behind their gears, on one flank or the other."""
    for joint in tape.moving:
        tape = joint_has_play(tape, rng, joint, gear_rad)
    return tape
