"""Positions whose sign is in a bit that nobody decoded: counts below zero are read as that bit plus their size.

Servos of one family (Feetech STS) send counts as sign and magnitude. A driver that takes the bit for a part of the number turns
the part of a motion below zero round and puts it far away: the reading jumps by the bit's worth between two samples, and comes
back from there the other way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from proprio_ros.records import BoolArray, FloatArray

COUNT_RAD = 2.0 * np.pi / 4096.0
"""Of servos that send sign and magnitude."""
BITS = (10, 11, 13, 14, 15)
"""Feetech has it in bit 10 of loads, 11 of offsets and 15 of positions; 12 would be a whole turn, by which angles wrap around."""
FASTEST_RAD_S = 10.0  # no joint of an arm is faster
LONGEST_STEP_S = 0.1  # across a longer gap nobody knows how it moved
FEWEST_CROSSINGS = 2
"""One jump by half a turn or less may be of something else; no joint turns several times round between two samples."""
TOLERANCE_RAD = 0.02
"""That a jump differs by from the bit's worth, beside what the joint moves meanwhile: some counts, at either side of zero."""
NEAREST_SHARE = 0.125
"""Of a bit's worth, that a jump differs by at most, however fast the joint moves: more would be any jump."""
FEWEST_SAMPLES = 30
"""Half a second at the lowest rates; in fewer readings any few jumps look like a bit's."""
NEAR_RAD = 0.3  # of a bit's worth, by which a reading is off that cannot be decoded
AROUND = 5  # samples on either side of a jump that say which way a joint moves


@dataclass(frozen=True)
class SignBit:
    """A bit that was not decoded in one column."""

    bit: int
    negative: BoolArray  # which samples have it, shape (T,)
    decoded: FloatArray  # the column without it [rad], shape (T,)


def sign_bit(
    times_s: FloatArray,
    position: FloatArray,
) -> SignBit | None:
    """The bit that explains the jumps of one joint's readings; None where nothing does.

    Args:
        times_s: Increasing [s], shape (T,).
        position: Finite [rad], shape (T,).
    """
    if len(position) < FEWEST_SAMPLES:
        return None
    step_s = np.diff(times_s)
    usual_s = float(np.median(step_s))
    close = step_s < max(LONGEST_STEP_S, 2.0 * usual_s)
    allowed = FASTEST_RAD_S * np.maximum(step_s, usual_s)
    step = np.diff(position)
    jumps = np.flatnonzero(close & (np.abs(step) > np.minimum(allowed, 1.0)))
    if not len(jumps):
        return None
    for bit in BITS:
        if len(jumps) < FEWEST_CROSSINGS and COUNT_RAD * 2.0**bit < 2.0 * np.pi:
            continue
        found = _decoded(bit, position, step, jumps)
        if found is not None:
            return found
    return None


def hint_of(jump_rad: float) -> str:
    """Words to add where a reading is off by about what a sign bit is worth; none where it is not."""
    for bit in BITS:
        if abs(abs(jump_rad) - COUNT_RAD * 2.0**bit) < NEAR_RAD:
            return f" ({2**bit} counts of 4096 a turn: is the sign, in bit {bit}, not decoded?)"
    return ""


def _decoded(
    bit: int,
    position: FloatArray,
    step: FloatArray,
    jumps: NDArray[np.int64],
) -> SignBit | None:
    """The readings without a sign bit, where their jumps are all of its worth and gone without it."""
    worth = COUNT_RAD * 2.0**bit
    moves = float(np.abs(np.delete(step, jumps)).max(initial=0.0))
    near = min(TOLERANCE_RAD + 2.0 * moves, NEAREST_SHARE * worth)
    if np.any(np.abs(np.abs(step[jumps]) - worth) > near):
        return None
    lower = float(np.minimum(position[jumps], position[jumps + 1]).min())
    upper = float(np.maximum(position[jumps], position[jumps + 1]).min())
    rises = step[jumps] > 0.0
    if np.any(rises[1:] == rises[:-1]):
        return None
    part = np.searchsorted(jumps, np.arange(len(position)))  # between which jumps, shape (T,)
    negative = np.append(~rises[0], rises)[part]
    # zero lies at or just below the smallest reading of either side; joints of a servo count from there
    zero = min(lower, upper - worth)
    if abs(zero) < near:
        zero = 0.0  # the reading starts there, unless somebody shifted it
    if position[negative].min() < upper - near or position[~negative].min() < lower - near:
        return None
    decoded = np.where(negative, worth + 2.0 * zero - position, position)
    left = float(np.abs(np.diff(decoded))[jumps].max())
    if left > near or not _turns_back(step, jumps):
        return None
    return SignBit(bit, negative, decoded)


def _turns_back(step: FloatArray, jumps: NDArray[np.int64]) -> bool:
    """Whether the reading goes the other way behind jumps, as no angle that wraps around does."""
    before = np.array([_way(step, jump - AROUND, jump) for jump in jumps])
    behind = np.array([_way(step, jump + 1, jump + 1 + AROUND) for jump in jumps])
    return float(before @ behind) < 0.0


def _way(step: FloatArray, first: int, last: int) -> float:
    """The sum of some steps, without jumps."""
    some = step[max(first, 0) : last]
    return float(some[np.abs(some) < 1.0].sum())


def without_sign_bits(
    times_s: FloatArray,
    position: FloatArray,
    names: Sequence[str],
    expected: Sequence[str],
    notes: list[str],
) -> None:
    """Decode, with a note each, what columns of joints hold of a sign bit.

    Args:
        times_s: Increasing [s], shape (T,).
        position: Of the joints [rad], not finite where unknown; changed in place, shape (T, n).
        names: Of the columns, length n.
        expected: Of the joints that are looked at.
        notes: To which a sentence is added for each that is decoded.
    """
    for column, name in enumerate(names):
        known = np.flatnonzero(np.isfinite(position[:, column]))
        if name not in expected or len(known) < 2:
            continue
        found = sign_bit(times_s[known], position[known, column])
        if found is None:
            continue
        position[known, column] = found.decoded
        share = f"{int(found.negative.sum())} of {len(known)}"
        notes.append(
            f"position of {name}: {share} readings are counts below zero whose sign, in bit {found.bit}, was not decoded "
            f"({2**found.bit} was read beside their size); it was."
        )
