"""Counts below zero whose sign is in a bit that nobody decoded: decoded where that is sure, and nothing else is taken for it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.bends.bend import all_bends
from support.bends.tape import tape_of
from support.machines import REAL
from support.small_bags import read

from proprio_ros.recordings.sign_bits import BITS, COUNT_RAD, sign_bit
from proprio_ros.records import FloatArray

TIMES_S = np.arange(0.0, 20.0, 0.01)


def swinging(middle_rad: float = 0.1, period_s: float = 5.0) -> FloatArray:
    """A joint that swings by 1.2 rad to either side, in counts."""
    angle = middle_rad + 1.2 * np.sin(2.0 * np.pi * TIMES_S / period_s)
    counts: FloatArray = np.round(angle / COUNT_RAD)
    return counts


def undecoded(counts: FloatArray, bit: int) -> FloatArray:
    """As it is published, in rad."""
    raw: FloatArray = COUNT_RAD * np.where(counts < 0.0, 2.0**bit - counts, counts)
    return raw


@pytest.mark.parametrize("bit", BITS)
@pytest.mark.parametrize("period_s", [2.0, 5.0, 9.0])
def test_the_sign_is_decoded(bit: int, period_s: float) -> None:
    counts = swinging(period_s=period_s)
    found = sign_bit(TIMES_S, undecoded(counts, bit))
    assert found is not None and found.bit == bit
    assert np.allclose(found.decoded, COUNT_RAD * counts)
    assert np.array_equal(found.negative, counts < 0.0)


@pytest.mark.parametrize("shift_rad", [-3.1, -0.7, 2.4])
def test_angles_that_count_from_elsewhere(shift_rad: float) -> None:
    """A calibration has its zero in the middle of the range: the bit is about the servo's own zero."""
    counts = swinging()
    found = sign_bit(TIMES_S, undecoded(counts, 15) + shift_rad)
    assert found is not None
    assert np.allclose(found.decoded, COUNT_RAD * counts + shift_rad, atol=0.02)


@pytest.mark.parametrize("low_rad", [-np.pi, 0.0, -0.5 * np.pi])
def test_an_angle_that_wraps_around_is_none(low_rad: float) -> None:
    angle = COUNT_RAD * swinging(low_rad)
    wrapped = np.mod(angle - low_rad, 2.0 * np.pi) + low_rad
    assert np.abs(np.diff(wrapped)).max() > 6.0
    assert sign_bit(TIMES_S, wrapped) is None


@pytest.mark.parametrize("step_rad", [0.3, np.pi, 2.0 * np.pi])
def test_a_step_is_none(step_rad: float) -> None:
    angle = COUNT_RAD * swinging()
    late = TIMES_S > 7.3
    assert sign_bit(TIMES_S, angle + step_rad * late) is None
    assert sign_bit(TIMES_S, angle + step_rad * (late & (TIMES_S < 11.1))) is None


def test_nothing_is_decoded_where_nothing_jumps() -> None:
    assert sign_bit(TIMES_S, COUNT_RAD * swinging()) is None


@pytest.mark.parametrize("readings", [[0.0, 0.0, 0.5, 0.0, 0.5], [0.5, 0.0, 1.0, 0.0, 0.5]])
def test_a_few_readings_that_jump_are_left_as_they_are(readings: list[float]) -> None:
    position = np.array(readings)
    assert sign_bit(1e-3 * np.arange(len(position)), position) is None


@pytest.mark.parametrize("seed", range(20))
def test_readings_that_jump_everywhere_are_left_as_they_are(seed: int) -> None:
    position = np.random.default_rng(seed).uniform(-2.0, 2.0, 200)
    assert sign_bit(1e-3 * np.arange(200), position) is None


@pytest.mark.long
@pytest.mark.skipif(not REAL.is_dir(), reason=f"needs {REAL}")
@pytest.mark.parametrize("bit", [11, 15])
def test_a_bag_is_read_as_without(tmp_path: Path, bit: int) -> None:
    tape = tape_of(REAL / "ur10e_empty_14")
    joint = "elbow_joint"
    bent = all_bends()["sign_bit_not_decoded"].change(
        tape, np.random.default_rng(0), joint=joint, bits=bit
    )
    plain, decoded = (
        read(made.write(tmp_path / name), effort_unit="A", joint_order=tape.states.names)
        for name, made in (("plain", tape), ("bent", bent))
    )
    column = plain.joints.names.index(joint)
    off = decoded.joints.position[:, column] - plain.joints.position[:, column]
    assert np.abs(off).max() < COUNT_RAD
    assert any(f"in bit {bit}, was not decoded" in note for note in decoded.notes)
