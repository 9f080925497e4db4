"""Recordings in which joints move under a controller: what is taken from them, and what real arms in motion are said to carry."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from proprio_ros.cli import main
from proprio_ros.errors import RecordingError
from proprio_ros.motions import motion_of
from proprio_ros.probes.payload import moving
from proprio_ros.records import InputRecord, JointRecord, Recording

REAL = Path(__file__).resolve().parents[2] / "shared" / "recordings_real"
UR10E = {
    "shoulder_pan_joint": 11.976,
    "shoulder_lift_joint": 11.976,
    "elbow_joint": 9.838,
    "wrist_1_joint": 10.75,
    "wrist_2_joint": 10.67,
    "wrist_3_joint": 10.70,
}


def recording(seconds: float = 5.0, rate_Hz: float = 100.0, measured: bool = True) -> Recording:
    times_ns = np.round(1e9 * np.arange(0.0, seconds, 1.0 / rate_Hz)).astype(np.int64)
    position = np.sin(1e-9 * times_ns)[:, None] * np.array([1.0, 0.5, 0.0])
    current = np.ones((len(times_ns), 3))
    joints = JointRecord(times_ns, ("a", "b", "grip"), position, current=current if measured else None)
    return Recording(
        "bag", joints, InputRecord(times_ns[::2], ("b", "a"), np.full((len(times_ns[::2]), 2), 2.0), "/current_command")
    )


def test_measured_current_is_taken_before_the_command() -> None:
    motion = motion_of(recording(), joints=["a", "b"])
    assert motion.source == "measured current" and np.all(motion.current_A == 1.0)
    assert motion.held == {"grip": 0.0} and motion.moved == ("a", "b")
    commanded = motion_of(recording(measured=False), joints=["a", "b"])
    assert commanded.source == "/current_command" and np.all(commanded.current_A == 2.0)
    assert "commanded one counts" in commanded.notes[-1]


@pytest.mark.parametrize(
    ("recorded", "joints", "words"),
    [
        (recording(2.0), ["a", "b"], "at least 3 s"),
        (recording(rate_Hz=10.0), ["a", "b"], "20 Hz"),
        (recording(), ["a", "elbow"], "elbow was not recorded"),
        (recording(measured=False), ["a", "grip"], "no current of grip"),
        (recording(), ["grip"], "no joint moved"),
    ],
)
def test_what_is_no_motion_is_said(recorded: Recording, joints: list[str], words: str) -> None:
    with pytest.raises(RecordingError, match=words):
        motion_of(recorded, joints=joints)


def test_wrapped_angles_are_unwrapped_and_long_gaps_are_said() -> None:
    whole = recording(20.0)
    record = whole.joints
    wrapped = np.mod(6.0 * record.position + np.pi, 2.0 * np.pi) - np.pi
    motion = motion_of(replace(whole, joints=replace(record, position=wrapped)), joints=["a", "b"])
    np.testing.assert_allclose(motion.position, 6.0 * record.position[:, :2], atol=1e-9)
    assert any("unwrapped" in note for note in motion.notes)
    # a jump that is no whole turn is no wrap
    jumped = record.position + np.where(np.arange(len(record.times_ns)) > 500, 4.0, 0.0)[:, None]
    with pytest.raises(RecordingError, match="wrap around"):
        motion_of(replace(whole, joints=replace(record, position=jumped)), joints=["a", "b"])
    times_ns = record.times_ns + np.where(np.arange(len(record.times_ns)) > 1000, 60_000_000_000, 0)
    with pytest.raises(RecordingError, match="in gaps"):
        motion_of(replace(whole, joints=replace(record, times_ns=times_ns)), joints=["a", "b"])


@pytest.fixture(scope="module")
def ur10e(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The robot file that a user writes from the URDF and the torque constants."""
    if not (REAL / "ur10e_loaded_14").exists():
        pytest.skip("needs the real recordings")
    lines = ["name: ur10e", f"urdf: {REAL / 'models' / 'ur10e.urdf'}", "payload_frame: wrist_3_link", "joints:"]
    for joint, constant in UR10E.items():
        lines += [
            f"  {joint}:",
            f"    motor: {{nominal_torque_constant_N_m_per_A: {constant}, encoder_resolution_rad: 1.0e-5,",
            "            encoder_noise_rad: 1.0e-5, current_limit_A: 20.0,",
            "            supply_voltage_V: 0.0, back_emf_V_s_per_rad: 1.0, resistance_ohm: 1.0}",
            f"    drive_train: {{torque_constant_N_m_per_A: {constant}, coulomb_N_m: {{value: 0.0, std: 10.0}},",
            "                  viscous_N_m_s_per_rad: {value: 0.0, std: 10.0}, load_friction: {value: 0.0, std: 0.05},",
            "                  armature_kg_m2: {value: 0.5, std: 1.0}}",
            "    usable_velocity_rad_s: 5.0",
        ]
    path = tmp_path_factory.mktemp("ur10e") / "ur10e.yaml"
    path.write_text("\n".join(lines) + "\n")
    return path


def replayed(
    capsys: pytest.CaptureFixture[str], ur10e: Path, bag: str, *more: str, unit: str = "A"
) -> tuple[int, dict]:
    words = [
        "replay",
        str(REAL / bag),
        "--probe",
        "payload",
        "--robot",
        str(ur10e),
        "--effort-unit",
        unit,
        "--json",
        *more,
    ]
    code = main(words)
    return code, json.loads(capsys.readouterr().out)


@pytest.mark.parametrize("empty", ["ur10e_empty_12", "ur10e_empty_14", "ur10e_empty_15"])
def test_a_real_arm_weighs_what_it_carries(capsys: pytest.CaptureFixture[str], ur10e: Path, empty: str) -> None:
    code, answer = replayed(capsys, ur10e, "ur10e_loaded_14", "--baseline", str(REAL / empty))
    assert code == 0, answer["reasons"]
    mass, centre = answer["estimates"]
    assert mass["ci95"][0] < 2.805 < mass["ci95"][1]
    assert abs(mass["value"] - 2.805) < 0.03 * 2.805
    assert mass["ci95"][1] - mass["ci95"][0] < 0.06 * 2.805
    np.testing.assert_allclose(centre["value"], [0.03, 0.165, -0.17], atol=0.01)


@pytest.mark.long
@pytest.mark.parametrize("other", ["ur10e_empty_12", "ur10e_empty_15"])
def test_a_real_empty_hand_weighs_nothing(capsys: pytest.CaptureFixture[str], ur10e: Path, other: str) -> None:
    code, answer = replayed(capsys, ur10e, other, "--baseline", str(REAL / "ur10e_empty_14"))
    assert code == 0, answer["reasons"]
    mass = answer["estimates"][0]
    assert mass["value"] < 0.05 and mass["ci95"][0] == 0.0 and mass["ci95"][1] < 0.1


def test_a_wide_interval_is_given_and_not_accepted(
    capsys: pytest.CaptureFixture[str], ur10e: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in a weighing with one joint: `too_wide` means the same."""
    monkeypatch.setattr(moving, "WIDEST_SHARE", 1e-3)
    monkeypatch.setattr(moving, "WIDEST_OF_ARM", 0.0)
    code, answer = replayed(capsys, ur10e, "ur10e_loaded_14", "--baseline", str(REAL / "ur10e_empty_14"))
    assert code == 3 and answer["verdict"] == "too_wide" and answer["reason_codes"] == ["too_wide"]
    low, high = answer["estimates"][0]["ci95"]
    assert low < 2.805 < high


def test_a_real_arm_with_another_unit_is_refused(capsys: pytest.CaptureFixture[str], ur10e: Path) -> None:
    code, answer = replayed(capsys, ur10e, "ur10e_loaded_14", "--baseline", str(REAL / "ur10e_empty_14"), unit="N.m")
    assert code == 3 and answer["reason_codes"] == ["arm_unlike_urdf"]


@pytest.mark.long
@pytest.mark.parametrize("factor", [0.6, 0.75, 1.25, 1.6])
def test_torque_constants_that_are_wrong_give_no_wrong_mass(
    capsys: pytest.CaptureFixture[str], ur10e: Path, tmp_path: Path, factor: float
) -> None:
    """Stated as known exactly, and off by a quarter and more."""
    text = ur10e.read_text()
    for constant in set(UR10E.values()):
        text = text.replace(
            f"torque_constant_N_m_per_A: {constant},", f"torque_constant_N_m_per_A: {factor * constant:.4f},"
        )
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text(text)
    code, answer = replayed(capsys, wrong, "ur10e_loaded_14", "--baseline", str(REAL / "ur10e_empty_14"))
    mass = answer["estimates"][0]
    assert code == 3 or mass["ci95"][0] < 2.805 < mass["ci95"][1], answer


def test_a_real_arm_without_an_empty_run_is_refused(capsys: pytest.CaptureFixture[str], ur10e: Path) -> None:
    code, answer = replayed(capsys, ur10e, "ur10e_loaded_14")
    assert code == 3 and answer["reason_codes"] == ["no_empty_motion"]


def test_other_probes_want_one_joint_at_a_time(capsys: pytest.CaptureFixture[str], ur10e: Path) -> None:
    code = main(
        ["replay", str(REAL / "ur10e_loaded_14"), "--probe", "softness", "--robot", str(ur10e), "--effort-unit", "A"]
    )
    assert code == 2 and "one at a time" in capsys.readouterr().err


def test_check_says_what_a_motion_is_good_for(capsys: pytest.CaptureFixture[str], ur10e: Path) -> None:
    bag = str(REAL / "ur10e_loaded_14")
    assert main(["check", bag, "--robot", str(ur10e), "--effort-unit", "A"]) == 0
    text = capsys.readouterr().out
    assert "a motion of 6 joints" in text and "--baseline" in text
    assert main(["check", bag, "--robot", str(ur10e), "--effort-unit", "A", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["bags"][0]
    assert found["motion"]["joints"] == list(UR10E) and found["motion"]["duration_s"] > 50.0
