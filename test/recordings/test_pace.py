"""The scale of a time axis by velocities: on motions known in closed form, and on real arms whose stamps are stretched."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.machines import REAL

from proprio_ros.errors import RecordingError
from proprio_ros.recordings.pace import (
    pace_by_velocities,
    pace_of_runs,
    refuse_pace_of_joint,
    refuse_pace_of_runs,
)
from proprio_ros.recordings.plausibility import findings
from proprio_ros.recordings.runs import cut_runs
from proprio_ros.recordings.signals import read_recording
from proprio_ros.records import FloatArray, InputRecord, JointRecord, Recording, Run

TIMES_S = np.arange(0.0, 20.0, 0.01)
# amplitude [rad] and angular frequency [rad/s] of the waves of each joint
WAVES = {
    "a": ((0.8, 0.9), (0.3, 2.3)),
    "b": ((0.5, 1.3), (0.2, 4.1)),
    "c": ((1.1, 0.6), (0.1, 6.0)),
}
real = pytest.mark.skipif(
    not REAL.exists(),
    reason="needs the real recordings",
)


def positions(joint: str) -> FloatArray:
    return np.sum(
        [size * np.sin(omega * TIMES_S) for size, omega in WAVES[joint]],
        axis=0,
    )


def velocities(
    joint: str,
    filter_s: float = 0.0,
    delay_s: float = 0.0,
) -> FloatArray:
    """In closed form, behind a filter of first order and a delay: ``Re(i w A exp(i w t) / (1 + i w a))`` of each wave."""
    parts = []
    for size, omega in WAVES[joint]:
        through = np.exp(-1j * omega * delay_s) / (1.0 + 1j * omega * filter_s)
        parts.append(np.real(size * omega * np.exp(1j * omega * TIMES_S) * through))
    return np.sum(parts, axis=0)


def recording(velocity: FloatArray, stretched: float = 1.0) -> Recording:
    """Three joints with counts of an encoder; the stamps run ``stretched`` times as fast as the clock."""
    position = np.column_stack([positions(joint) for joint in WAVES])
    counts = np.round(position / 0.0015) * 0.0015
    times_ns = np.rint(1e9 * stretched * TIMES_S).astype(np.int64)
    return Recording(
        "bag",
        JointRecord(times_ns, tuple(WAVES), counts, velocity),
        None,
    )


def of_all(filter_s: float = 0.0, delay_s: float = 0.0) -> FloatArray:
    """With the noise and the counts of a real register."""
    exact = np.column_stack([velocities(joint, filter_s, delay_s) for joint in WAVES])
    noise = np.random.default_rng(3).normal(
        0.0,
        0.02,
        exact.shape,
    )
    return np.round((exact + noise) / 0.024) * 0.024


@pytest.mark.parametrize("filter_s, delay_s", [(0.0, 0.0), (0.05, 0.0), (0.0, 0.045), (0.03, 0.02)])
@pytest.mark.parametrize("stretched", [0.5, 0.73, 1.0, 1.4, 2.0])
def test_a_scale_is_found_whatever_lags(stretched: float, filter_s: float, delay_s: float) -> None:
    pace = pace_by_velocities(recording(of_all(filter_s, delay_s), stretched))
    assert pace is not None
    assert pace.scale * stretched == pytest.approx(1.0, abs=0.01)
    assert abs(pace.scale - 1.0 / stretched) < 2.0 * pace.std
    assert pace.is_off == (stretched != 1.0)


def test_check_blames_the_time_axis_and_not_the_units_of_all_joints() -> None:
    found = findings(recording(of_all(), 0.73))
    assert [finding.code for finding in found] == ["time_scale"]
    assert "1.37" in found[0].sentence
    assert found[0].values["a"] == pytest.approx(1.37, abs=0.01)
    assert findings(recording(of_all(0.005), 1.0)) == ()


def test_another_unit_is_none_of_the_time_axis() -> None:
    of_one = of_all()
    of_one[:, 1] *= 0.73
    for velocity in (of_one, of_all() * 57.3, of_all() / 57.3, -of_all()):
        assert pace_by_velocities(recording(velocity)) is None
    assert "velocity_scale" in [finding.code for finding in findings(recording(of_all() * 57.3))]


def test_of_one_joint_alone_a_factor_may_be_its_unit() -> None:
    velocity = np.full(
        (len(TIMES_S), 3),
        np.nan,
    )
    velocity[:, 0] = velocities("a")
    assert pace_by_velocities(recording(velocity, 0.73)) is None
    alone = pace_by_velocities(recording(velocity))
    assert alone is not None
    assert not alone.is_off


def test_velocities_made_of_positions_say_nothing_of_time() -> None:
    position = recording(of_all()).joints.position
    assumed = np.diff(position, axis=0, prepend=position[:1]) / 0.0137
    assert pace_by_velocities(recording(assumed)) is None


def test_velocities_that_follow_nothing_say_nothing() -> None:
    assert pace_by_velocities(recording(np.random.default_rng(5).normal(size=(2000, 3)))) is None
    position = recording(of_all()).joints.position
    silent = JointRecord(
        np.arange(2000) * 10**7,
        tuple(WAVES),
        position,
    )
    assert pace_by_velocities(Recording("bag", silent, None)) is None


def test_angles_that_wrap_and_gaps_do_not_matter() -> None:
    whole = recording(of_all(), 0.73)
    position = np.mod(whole.joints.position, 2.0 * np.pi)
    kept = np.ones(len(TIMES_S), dtype=bool)
    kept[700:760] = False
    record = whole.joints
    assert record.velocity is not None
    cut = JointRecord(
        record.times_ns[kept],
        record.names,
        position[kept],
        record.velocity[kept],
    )
    pace = pace_by_velocities(Recording("bag", cut, None))
    assert pace is not None
    assert pace.scale == pytest.approx(1.0 / 0.73, rel=0.01)


OURS = ("joint1", "joint2", "joint3", "joint4", "gripper_left_joint")


def read(bag: Path) -> Recording:
    return read_recording(
        bag,
        nominal_torque_constants={},
        joint_order=[],
        states_only=True,
    )


@real
@pytest.mark.parametrize("stretched", [0.6, 0.73, 1.0, 1.5])
@pytest.mark.parametrize(
    "bag", ["ur10e_loaded_14", "omx_empty_1", "kuka_lwr4_empty_3", "gen3_gap_and_wrap"]
)
def test_real_registers(bag: str, stretched: float) -> None:
    whole = read(REAL / bag)
    times_ns = whole.joints.times_ns
    stamps = times_ns[0] + np.rint(stretched * (times_ns - times_ns[0])).astype(np.int64)
    bent = replace(
        whole,
        joints=replace(whole.joints, times_ns=stamps),
    )
    pace = pace_by_velocities(bent)
    assert pace is not None
    assert pace.scale * stretched == pytest.approx(1.0, abs=0.03)
    assert abs(pace.scale - 1.0 / stretched) < 2.0 * pace.std
    assert pace.is_off == (stretched != 1.0)


def pushed(
    stretched: float,
    noise: float = 0.02,
    lag_s: float = 0.01,
) -> tuple[Recording, Run]:
    """One joint from rest, 0.6 s at 40 Hz, that a constant torque, its weight and damping move: solved by steps of 0.1 ms."""
    step_s = 1e-4
    angle = [0.6]
    speed = [0.0]
    for number in range(8500):
        driven = number >= 2500
        torque = -6.0 - 4.0 * np.cos(angle[-1]) - 1.5 * speed[-1] if driven else 0.0
        speed.append(speed[-1] + step_s * torque)
        angle.append(angle[-1] + step_s * speed[-1])
    rows = np.arange(0, 8501, 250)
    late = np.maximum(rows - round(lag_s / step_s), 0)
    rng = np.random.default_rng(8)
    position = np.round(np.array(angle)[rows] / 0.0015) * 0.0015
    velocity = np.array(speed)[late] + rng.normal(0.0, noise, len(rows))
    times_ns = np.rint(1e9 * stretched * step_s * rows).astype(np.int64)
    record = JointRecord(
        times_ns,
        ("a",),
        position[:, None],
        velocity[:, None],
    )
    drive = InputRecord(
        np.array([times_ns[0], times_ns[10]]), ("a",), np.array([[0.0], [-0.3]]), "/current_command"
    )
    recording = Recording("bag", record, drive)
    (run,) = cut_runs(recording, joints=["a"])
    return recording, run


@pytest.mark.parametrize("stretched", [0.5, 0.73, 0.85, 0.9, 1.15, 1.4, 2.0])
def test_a_push_on_a_stretched_axis_is_refused(stretched: float) -> None:
    recording, run = pushed(stretched)
    pace = pace_of_runs(recording, [run])
    assert pace is not None
    assert abs(pace.scale * stretched - 1.0) < 0.03
    with pytest.raises(RecordingError, match=f"change {pace.scale:.2f} times as fast .* time axis"):
        refuse_pace_of_runs(recording, [run])


@pytest.mark.parametrize("unit", [1.0, 57.3, 1.0 / 57.3, -1.0, 0.0])
def test_a_push_with_velocities_of_another_unit_or_of_none_is_read(unit: float) -> None:
    recording, run = pushed(1.0)
    record = recording.joints
    assert record.velocity is not None
    refuse_pace_of_runs(
        replace(
            recording,
            joints=replace(record, velocity=unit * record.velocity),
        ),
        [run],
    )
    refuse_pace_of_runs(
        replace(recording, joints=replace(record, velocity=None)),
        [run],
    )


@pytest.mark.parametrize("times", [2, 3, 5])
def test_readings_that_are_published_several_times_are_no_pace(times: int) -> None:
    quick, _ = pushed(1.0)
    rows = np.arange(len(quick.joints.times_ns)) // times * times
    record = quick.joints
    assert record.velocity is not None
    held = replace(
        record,
        position=record.position[rows],
        velocity=record.velocity[rows],
    )
    slow = replace(quick, joints=held)
    refuse_pace_of_runs(slow, cut_runs(slow, joints=["a"]))
    pace = pace_by_velocities(recording_held(times))
    assert pace is not None
    assert pace.scale == pytest.approx(1.0, abs=0.02)


def recording_held(times: int) -> Recording:
    """Three joints whose readings come several times."""
    whole = recording(of_all())
    record = whole.joints
    rows = np.arange(len(record.times_ns)) // times * times
    assert record.velocity is not None
    held = replace(
        record,
        position=record.position[rows],
        velocity=record.velocity[rows],
    )
    return replace(whole, joints=held)


def test_pushes_that_ship_keep_their_pace() -> None:
    constants = dict.fromkeys(OURS, 1.783)
    for bag in sorted((Path(__file__).resolve().parents[2] / "bags").glob("realistic*/bag_mcap")):
        recording = read_recording(bag, nominal_torque_constants=constants, joint_order=OURS)
        runs: tuple[Run, ...] = ()
        with suppress(RecordingError):  # what they reported alone is no excitation of these joints
            runs = cut_runs(recording, joints=recording.joints.names)
        refuse_pace_of_runs(recording, runs)


@real
def test_a_servo_alone_is_asked_too() -> None:
    for bag in ("sts3215_release_0.535kg", "xl330_kp100_up_and_down", "dfki_sac"):
        recording = read(REAL / bag)
        refuse_pace_of_joint(recording, "pendulum")
        times_ns = recording.joints.times_ns
        slow = replace(
            recording.joints,
            times_ns=times_ns[0] + (times_ns - times_ns[0]) * 2,
        )
        with pytest.raises(RecordingError, match="time axis"):
            refuse_pace_of_joint(replace(recording, joints=slow), "pendulum")
