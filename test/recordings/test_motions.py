"""Recordings in which joints move under a controller: what is taken from them, and what real arms in motion are said to carry."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.machines import REAL, UR10E_N_M_PER_A

from proprio_ros.calibration_files.motions import MotionCalibration
from proprio_ros.cli import main
from proprio_ros.errors import RecordingError, RobotError
from proprio_ros.identification.estimate import Verdict, WidthLimit
from proprio_ros.identification.regression.causes import torque_cause
from proprio_ros.identification.regression.motion_equations import once_each
from proprio_ros.identification.regression.motion_fit import fit_empty, fit_payload
from proprio_ros.pipeline.calibrate import write_calibration
from proprio_ros.pipeline.loading import bag_motion, runs_or_motion
from proprio_ros.pipeline.request import Options, Request
from proprio_ros.probes.payload import moving
from proprio_ros.probes.payload.moving import identify_in_motion
from proprio_ros.recordings.motions import Motion, motion_of
from proprio_ros.records import InputRecord, JointRecord, Recording
from proprio_ros.robot import load_robot
from proprio_ros.sim.payload import PayloadFacts


def recording(
    seconds: float = 5.0,
    rate_Hz: float = 100.0,
    measured: bool = True,
) -> Recording:
    times_ns = np.round(
        1e9
        * np.arange(
            0.0,
            seconds,
            1.0 / rate_Hz,
        )
    ).astype(np.int64)
    position = np.sin(1e-9 * times_ns)[:, None] * np.array([1.0, 0.5, 0.0])
    # one that stood still would not have been measured
    current = 1.0 + 0.1 * np.sin(3e-9 * times_ns)[:, None] * np.ones(3)
    joints = JointRecord(
        times_ns, ("a", "b", "grip"), position, current=current if measured else None
    )
    return Recording(
        "bag",
        joints,
        InputRecord(
            times_ns[::2],
            ("b", "a"),
            np.full(
                (len(times_ns[::2]), 2),
                2.0,
            ),
            "/current_command",
        ),
    )


def test_measured_current_is_taken_before_the_command() -> None:
    motion = motion_of(recording(), joints=["a", "b"])
    assert motion.source == "measured current"
    np.testing.assert_allclose(motion.current_A, 1.0, atol=0.1)
    assert motion.held == {"grip": 0.0} and motion.moved == ("a", "b")
    commanded = motion_of(
        recording(measured=False),
        joints=["a", "b"],
    )
    assert commanded.source == "/current_command" and np.all(commanded.current_A == 2.0)
    assert "commanded one counts" in commanded.notes[-1]


def test_what_a_controller_moves_without_any_command_is_a_motion() -> None:
    """As this package's driver publishes it while it holds positions: commanded currents are zero, measured ones are not."""
    robot = load_robot("open_manipulator_x")
    whole = recording()
    names = ("joint2", "joint3", "gripper_left_joint")
    record = replace(whole.joints, names=names)
    silent = np.zeros((len(whole.joints.times_ns), 2))
    held = InputRecord(record.times_ns, names[:2], silent, "/applied_effort")
    bag = replace(whole, joints=record, inputs=held)
    # a motion, but not of all joints
    with pytest.raises(RecordingError, match="joint1 was not recorded"):
        runs_or_motion(bag, Request(robot))
    with pytest.raises(RecordingError, match="zero throughout"):
        runs_or_motion(
            replace(bag, joints=replace(record, current=None)),
            Request(robot),
        )


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
def test_what_is_no_motion_is_said(
    recorded: Recording,
    joints: list[str],
    words: str,
) -> None:
    with pytest.raises(RecordingError, match=words):
        motion_of(recorded, joints=joints)


def test_wrapped_angles_are_unwrapped_and_long_gaps_are_said() -> None:
    whole = recording(20.0)
    record = whole.joints
    wrapped = np.mod(6.0 * record.position + np.pi, 2.0 * np.pi) - np.pi
    motion = motion_of(
        replace(whole, joints=replace(record, position=wrapped)),
        joints=["a", "b"],
    )
    np.testing.assert_allclose(
        motion.position,
        6.0 * record.position[:, :2],
        atol=1e-9,
    )
    assert any("unwrapped" in note for note in motion.notes)
    # a jump that is no whole turn is no wrap
    jumped = (
        record.position
        + np.where(
            np.arange(len(record.times_ns)) > 500,
            4.0,
            0.0,
        )[:, None]
    )
    with pytest.raises(RecordingError, match="wrap around"):
        motion_of(
            replace(whole, joints=replace(record, position=jumped)),
            joints=["a", "b"],
        )
    times_ns = record.times_ns + np.where(
        np.arange(len(record.times_ns)) > 1000,
        60_000_000_000,
        0,
    )
    with pytest.raises(RecordingError, match="in gaps"):
        motion_of(
            replace(whole, joints=replace(record, times_ns=times_ns)),
            joints=["a", "b"],
        )


@pytest.mark.parametrize("times", [2, 3, 10])
def test_joint_states_that_repeat_the_one_before_are_left_out(times: int) -> None:
    whole = recording(20.0)
    record = whole.joints
    rows = np.arange(len(record.times_ns)) // times * times
    current = record.current
    held = replace(
        record,
        position=record.position[rows],
        current=current,
    )
    motion = motion_of(
        replace(whole, joints=held),
        joints=["a", "b"],
    )
    measured_Hz = 100.0 / times
    (note,) = [each for each in motion.notes if "repeat the one before" in each]
    assert f"at {measured_Hz:.3g} Hz" in note
    left = len(np.unique(rows)) if measured_Hz >= 20.0 else len(rows)
    assert len(motion.times_s) == left
    # a joint that creeps repeats counts of its encoder, and a motion without repeats is left as it is
    creeps = replace(
        record,
        position=np.round(0.1 * record.position, 3),
    )
    for other in (record, creeps):
        motion = motion_of(
            replace(whole, joints=other),
            joints=["a", "b"],
        )
        assert len(motion.times_s) == len(record.times_ns)


def test_exactly_20_hz_are_20_hz() -> None:
    for rate_Hz in (20.0, 19.97):
        motion = motion_of(
            recording(20.0, rate_Hz),
            joints=["a", "b"],
        )
        assert len(motion.times_s) == len(np.arange(0.0, 20.0, 1.0 / rate_Hz))
    with pytest.raises(RecordingError, match=r"19\.8 Hz; a motion needs 20 Hz"):
        motion_of(recording(20.0, 19.8), joints=["a", "b"])


def test_what_stands_in_the_way_of_a_gap_with_a_wrap_is_the_gap() -> None:
    whole = recording(20.0)
    record = whole.joints
    # a quarter of a turn and more while nobody looked
    far = np.where(
        np.arange(len(record.times_ns)) >= 1000,
        2.0,
        0.0,
    )[:, None] * [1.0, 0.0, 0.0]
    times_ns = record.times_ns + np.where(
        np.arange(len(record.times_ns)) >= 1000,
        940_000_000,
        0,
    )
    angles = 3.0 * record.position + far
    gap = replace(
        record,
        times_ns=times_ns,
        position=np.mod(angles + np.pi, 2.0 * np.pi) - np.pi,
    )
    with pytest.raises(
        RecordingError,
        match=r"no joint states came for 0\.95 s after 10\.0 s, and .* wraps around a turned",
    ):
        motion_of(
            replace(whole, joints=gap),
            joints=["a", "b"],
        )
    # a joint that does not wrap is known behind a gap as well as before
    known = replace(
        record,
        times_ns=times_ns,
        position=record.position + 1.6 * far,
    )
    motion = motion_of(
        replace(whole, joints=known),
        joints=["a", "b"],
    )
    np.testing.assert_array_equal(
        motion.position,
        known.position[:, :2],
    )


@pytest.mark.skipif(not REAL.is_dir(), reason="needs the real recordings")
def test_of_a_real_arm_the_gap_is_named_and_the_part_before_it_is_read() -> None:
    robot = load_robot("gen3")
    options = Options(robot="gen3", effort_unit="N.m", driver="kortex")
    with pytest.raises(
        RecordingError,
        match=r"no joint states came for 0\.94 s .* wraps around joint_1, joint_5 turned",
    ):
        bag_motion(REAL / "gen3_gap_and_wrap", Request(robot, options))


@pytest.fixture(scope="module", autouse=True)
def _equations_once() -> Iterator[None]:
    """Many ask for the same recordings: their equations depend on nothing else."""
    with once_each():
        yield


@pytest.fixture(scope="module")
def ur10e(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The robot file that a user writes from the URDF and the torque constants."""
    if not (REAL / "ur10e_loaded_14").exists():
        pytest.skip("needs the real recordings")
    lines = [
        "name: ur10e",
        f"urdf: {REAL / 'models' / 'ur10e.urdf'}",
        "payload_frame: wrist_3_link",
        "joints:",
    ]
    for joint, constant in UR10E_N_M_PER_A.items():
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
def test_a_real_arm_weighs_what_it_carries(
    capsys: pytest.CaptureFixture[str], ur10e: Path, empty: str
) -> None:
    code, answer = replayed(
        capsys,
        ur10e,
        "ur10e_loaded_14",
        "--baseline",
        str(REAL / empty),
    )
    assert code == 0, answer["reasons"]
    mass, centre, inertia = answer["estimates"]
    assert mass["ci95"][0] < 2.805 < mass["ci95"][1]
    assert abs(mass["value"] - 2.805) < 0.03 * 2.805
    # recordings of one arm differ, and one empty one does not show by how much
    assert mass["ci95"][1] - mass["ci95"][0] < 0.15 * 2.805
    np.testing.assert_allclose(
        centre["value"],
        [0.03, 0.165, -0.17],
        atol=0.01,
    )
    # smooth motions of an arm this size say nothing about how a dumbbell is spread
    assert inertia["name"] == "payload_inertia" and inertia["value"] == [None] * 6


@pytest.mark.long
@pytest.mark.parametrize("other", ["ur10e_empty_12", "ur10e_empty_15"])
def test_a_real_empty_hand_weighs_nothing(
    capsys: pytest.CaptureFixture[str], ur10e: Path, other: str
) -> None:
    code, answer = replayed(
        capsys,
        ur10e,
        other,
        "--baseline",
        str(REAL / "ur10e_empty_14"),
    )
    assert code == 0, answer["reasons"]
    mass = answer["estimates"][0]
    assert mass["value"] < 0.05 and mass["ci95"][0] == 0.0 and mass["ci95"][1] < 0.2


def test_a_wide_interval_is_given_and_not_accepted(
    capsys: pytest.CaptureFixture[str], ur10e: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in a weighing with one joint: `too_wide` means the same."""
    monkeypatch.setattr(moving, "limit_in_motion", lambda _: WidthLimit(1e-3))
    code, answer = replayed(
        capsys, ur10e, "ur10e_loaded_14", "--baseline", str(REAL / "ur10e_empty_14")
    )
    assert code == 3 and answer["verdict"] == "too_wide" and answer["reason_codes"] == ["too_wide"]
    low, high = answer["estimates"][0]["ci95"]
    assert low < 2.805 < high


def test_a_real_arm_with_another_unit_is_refused(
    capsys: pytest.CaptureFixture[str], ur10e: Path
) -> None:
    code, answer = replayed(
        capsys, ur10e, "ur10e_loaded_14", "--baseline", str(REAL / "ur10e_empty_14"), unit="N.m"
    )
    assert code == 3 and set(answer["reason_codes"]) == {"arm_unlike_urdf"}
    assert (
        "about 0.1 times what the URDF needs: it is in another unit (--effort-unit)"
        in answer["reasons"][0]
    )


@pytest.mark.long
@pytest.mark.parametrize("factor", [0.6, 0.75, 1.25, 1.6])
def test_torque_constants_that_are_wrong_give_no_wrong_mass(
    capsys: pytest.CaptureFixture[str],
    ur10e: Path,
    tmp_path: Path,
    factor: float,
) -> None:
    """Stated as known exactly, and off by a quarter and more."""
    text = ur10e.read_text()
    for constant in set(UR10E_N_M_PER_A.values()):
        text = text.replace(
            f"torque_constant_N_m_per_A: {constant},",
            f"torque_constant_N_m_per_A: {factor * constant:.4f},",
        )
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text(text)
    code, answer = replayed(
        capsys, wrong, "ur10e_loaded_14", "--baseline", str(REAL / "ur10e_empty_14")
    )
    mass = answer["estimates"][0]
    assert code == 3 or mass["ci95"][0] < 2.805 < mass["ci95"][1], answer


@pytest.mark.long
@pytest.mark.parametrize(
    "factors", [[0.8] * 6, [1.2] * 6, [2.0] * 6, [1.0, 0.7, 1.0, 1.0, 1.0, 1.0]]
)
def test_a_real_arm_whose_two_recordings_differ_in_their_unit_is_refused(
    ur10e: Path, factors: list[float]
) -> None:
    robot = load_robot(ur10e)
    options = Options(robot=str(ur10e), effort_unit="A")
    loaded, empty = (
        bag_motion(REAL / bag, Request(robot, options))
        for bag in ("ur10e_loaded_14", "ur10e_empty_14")
    )
    loaded = replace(
        loaded,
        current_A=loaded.current_A * np.array(factors),
    )
    estimate = identify_in_motion(robot, [loaded], [empty], PayloadFacts())
    assert estimate.verdict is Verdict.REJECTED and estimate.reasons[0].code in (
        "misfit",
        "other_torque",
    )


def test_a_real_arm_without_an_empty_run_is_refused(
    capsys: pytest.CaptureFixture[str], ur10e: Path
) -> None:
    code, answer = replayed(capsys, ur10e, "ur10e_loaded_14")
    assert code == 3 and answer["reason_codes"] == ["no_empty_motion"]


def test_other_probes_want_one_joint_at_a_time(
    capsys: pytest.CaptureFixture[str], ur10e: Path
) -> None:
    code = main(
        [
            "replay",
            str(REAL / "ur10e_loaded_14"),
            "--probe",
            "softness",
            "--robot",
            str(ur10e),
            "--effort-unit",
            "A",
        ]
    )
    assert code == 2 and "one at a time" in capsys.readouterr().err


def test_check_says_what_a_motion_is_good_for(
    capsys: pytest.CaptureFixture[str], ur10e: Path
) -> None:
    bag = str(REAL / "ur10e_loaded_14")
    assert main(["check", bag, "--robot", str(ur10e), "--effort-unit", "A"]) == 0
    text = capsys.readouterr().out
    assert "a motion of 6 joints" in text and "--baseline" in text
    assert main(["check", bag, "--robot", str(ur10e), "--effort-unit", "A", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["bags"][0]
    assert (
        found["motion"]["joints"] == list(UR10E_N_M_PER_A) and found["motion"]["duration_s"] > 50.0
    )


def calibrated(ur10e: Path, output: Path, *bags: str, more: tuple[str, ...] = ()) -> int:
    words = [str(REAL / bag) for bag in bags]
    return main(
        [
            "calibrate",
            *words,
            "--robot",
            str(ur10e),
            "--effort-unit",
            "A",
            "--output",
            str(output),
            "--json",
            *more,
        ]
    )


@pytest.fixture(scope="module")
def calibration_14(ur10e: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("calibration") / "ur10e_14.yaml"
    assert (
        calibrated(ur10e, path, "ur10e_empty_14", more=("--report", str(path.with_suffix(".html"))))
        == 0
    )
    return path


def weighed(
    capsys: pytest.CaptureFixture[str], calibration: Path, bag: str, *more: str
) -> tuple[int, dict]:
    capsys.readouterr()
    words = [
        "replay",
        str(REAL / bag),
        "--probe",
        "payload",
        "--calibration",
        str(calibration),
        "--effort-unit",
        "A",
    ]
    code = main([*words, "--json", *more])
    return code, json.loads(capsys.readouterr().out)


@pytest.mark.long
def test_a_real_arm_weighs_with_a_calibration_by_a_motion(
    capsys: pytest.CaptureFixture[str], calibration_14: Path
) -> None:
    code, answer = weighed(capsys, calibration_14, "ur10e_loaded_14")
    assert code == 0, answer["reasons"]
    mass = answer["estimates"][0]
    assert (
        mass["ci95"][0] < 2.805 < mass["ci95"][1]
        and mass["ci95"][1] - mass["ci95"][0] < 0.15 * 2.805
    )
    assert abs(mass["value"] - 2.805) < 0.03 * 2.805
    assert answer["calibration"]["name"] == "ur10e_14.yaml"
    assert any("torque constants" in words and "1.0 %" in words for words in answer["assumptions"])
    page = calibration_14.with_suffix(".html").read_text().replace("<wbr>", "")
    assert "ur10e_empty_14, first half" in page and "weighs 3000 g" in page


@pytest.mark.long
@pytest.mark.parametrize("other", ["ur10e_empty_12", "ur10e_empty_15"])
def test_a_real_empty_hand_weighs_nothing_by_the_calibration(
    capsys: pytest.CaptureFixture[str], calibration_14: Path, other: str
) -> None:
    code, answer = weighed(capsys, calibration_14, other)
    mass = answer["estimates"][0]
    assert code == 0 and mass["value"] < 0.05 and mass["ci95"][0] == 0.0 and mass["ci95"][1] < 0.2


@pytest.mark.long
def test_a_baseline_that_is_not_empty_contradicts_the_calibration(
    capsys: pytest.CaptureFixture[str], calibration_14: Path
) -> None:
    code, answer = weighed(
        capsys, calibration_14, "ur10e_empty_12", "--baseline", str(REAL / "ur10e_loaded_14")
    )
    assert code == 3 and answer["reason_codes"] == ["drift"]


@pytest.mark.long
def test_several_empty_motions_and_a_reference_calibrate(
    capsys: pytest.CaptureFixture[str], ur10e: Path, tmp_path: Path
) -> None:
    path = tmp_path / "all.yaml"
    empty = ("ur10e_empty_12", "ur10e_empty_14", "ur10e_empty_15")
    capsys.readouterr()
    assert (
        calibrated(ur10e, path, *empty, more=("--reference", f"{REAL / 'ur10e_loaded_14'}=2.805"))
        == 0
    )
    answer = json.loads(capsys.readouterr().out)
    assert answer["runs"] == 4 and [run["load_kg"] for run in answer["motion"]["runs"]] == [
        0.0,
        0.0,
        0.0,
        2.805,
    ]
    assert (
        abs(answer["motion"]["torque_scale"] - 1.0) < 0.02
        and answer["motion"]["torque_scale_std"] < 0.03
    )
    assert all(
        abs(each["mass_kg"]) < each["half_width95_kg"] < 0.15
        for each in answer["motion"]["weighed_empty"]
    )
    code, answer = weighed(capsys, path, "ur10e_loaded_14")
    # beside it counts what is taken of torque constants that nobody states: they are within 1 % of 1
    assert code == 0 and abs(answer["estimates"][0]["value"] - 2.805) < 0.01 * 2.805 + 0.01
    # a reference of half its mass is no reference
    more = ("--reference", f"{REAL / 'ur10e_loaded_14'}=1.4")
    assert calibrated(ur10e, tmp_path / "wrong.yaml", "ur10e_empty_14", more=more) == 3
    assert not (tmp_path / "wrong.yaml").exists()
    assert json.loads(capsys.readouterr().out)["reason_codes"] == ["misfit"]


@pytest.mark.long
def test_what_a_reference_implies_is_told_and_put_against_its_prior(
    capsys: pytest.CaptureFixture[str], ur10e: Path, tmp_path: Path
) -> None:
    """2.805 kg stated as 3.4 was accepted without a word where torque constants are known to 10 %."""
    told = {}
    key = 'robot.joints.{}.drive_train.torque_constant_N_m_per_A={{"value": {}, "std": {}}}'
    ten = [
        word
        for name, k in UR10E_N_M_PER_A.items()
        for word in ("--set", key.format(name, k, 0.1 * k))
    ]
    for stated in (2.805, 3.4):
        more = ("--reference", f"{REAL / 'ur10e_loaded_14'}={stated}", *ten)
        capsys.readouterr()
        assert calibrated(ur10e, tmp_path / f"{stated}.yaml", "ur10e_empty_14", more=more) == 0
        told[stated] = json.loads(capsys.readouterr().out)
    assert not any("your reference" in reason for reason in told[2.805]["reasons"])
    assert any(
        note.startswith("your reference says that all motors are") for note in told[2.805]["notes"]
    )
    (reason,) = [reason for reason in told[3.4]["reasons"] if "your reference" in reason]
    assert (
        "% stronger than stated, which is known to 10 %" in reason
        and "weigh the reference again" in reason
    )
    assert "far_from_prior" in told[3.4]["reason_codes"]


def test_an_object_that_was_turned_between_two_recordings_is_told_apart(
    capsys: pytest.CaptureFixture[str], ur10e: Path
) -> None:
    """The loads of these two sit on either side of the flange; "10 times what the URDF needs" was named, since nearly no torque is
    explained by a payload that cancels the arm's weight."""
    bags = [str(REAL / f"ur10e_{name}") for name in ("loaded_14", "loaded_15", "empty_14")]
    words = [
        "replay",
        *bags[:2],
        "--probe",
        "payload",
        "--robot",
        str(ur10e),
        "--effort-unit",
        "A",
        "--baseline",
        bags[2],
    ]
    capsys.readouterr()
    assert main([*words, "--json"]) == 3
    reason = json.loads(capsys.readouterr().out)["reasons"][0]
    assert (
        reason.startswith("each motion is explained by itself, and together they are not")
        and "times what" not in reason
    )
    robot = load_robot(ur10e)
    turned = bag_motion(
        REAL / "ur10e_loaded_15",
        Request(robot, Options(effort_unit="A")),
    )
    assert torque_cause(robot, turned) is None
    # an arm that hardly moved, as its angles would be in degrees, explains any torque by offsets and a payload
    wall = replace(
        robot,
        gravity=np.array([0.0, 6.94, -6.94]),
    )
    found = torque_cause(wall, turned)
    assert found is None or "degrees" not in found.words


def test_a_reference_without_an_empty_motion_is_refused(
    capsys: pytest.CaptureFixture[str], ur10e: Path, tmp_path: Path
) -> None:
    more = ("--reference", f"{REAL / 'ur10e_loaded_14'}=2.805")
    assert calibrated(ur10e, tmp_path / "none.yaml", more=more) == 2
    assert "one with an empty hand" in capsys.readouterr().err


def half(motion: Motion, late: bool) -> Motion:
    rows = (motion.times_s >= 0.5 * motion.times_s[-1]) == late
    times_s = motion.times_s[rows] - motion.times_s[rows][0]
    return replace(
        motion, times_s=times_s, position=motion.position[rows], current_A=motion.current_A[rows]
    )


@pytest.fixture(scope="module")
def slow() -> Motion:
    """Twenty seconds of a small arm in slow motion."""
    if not (REAL / "omx_empty_1").exists():
        pytest.skip("needs the real recordings")
    options = Options(effort_unit="raw")
    return bag_motion(
        REAL / "omx_empty_1",
        Request(load_robot("open_manipulator_x"), options, locked={"gripper_left_joint": 0.0}),
    )


def test_fingers_that_were_not_recorded_are_taken_to_stand_somewhere(slow: Motion) -> None:
    """They are light and move by centimetres; a joint that turns must be known."""
    motion = bag_motion(
        REAL / "omx_empty_1", Request(load_robot("open_manipulator_x"), Options(effort_unit="raw"))
    )
    assert motion.held == slow.held
    assert any(
        "gripper_left_joint was not recorded" in note and "--set held." in note
        for note in motion.notes
    )


@pytest.mark.parametrize("late", [False, True])
def test_ten_slow_seconds_weigh_what_ten_others_held(slow: Motion, late: bool) -> None:
    robot = load_robot("open_manipulator_x")
    known = replace(
        robot,
        motion_calibration=fit_empty(robot, [half(slow, not late)]),
    )
    answer = identify_in_motion(
        known,
        [half(slow, late)],
        [],
        PayloadFacts(),
    )
    assert answer.verdict is Verdict.ACCEPTED, answer.reasons
    mass = answer.values[0]
    assert isinstance(mass.value, float) and mass.value < 0.005
    assert mass.ci95[0] == 0.0 and mass.ci95[1] < 0.017
    # the arm fits its URDF only with torque constants that are off by a seventh
    known_to = re.search(r"torque constants .* to ([0-9.]+) %", " ".join(answer.assumptions))
    assert known_to is not None and float(known_to[1]) > 14.0


def test_what_a_slow_motion_calibrates_says_that_the_scale_is_open(
    capsys: pytest.CaptureFixture[str], slow: Motion, tmp_path: Path
) -> None:
    words = [
        "--set",
        "held.gripper_left_joint=0.0",
        "--effort-unit",
        "raw",
        "--output",
        str(tmp_path / "omx.yaml"),
    ]
    assert main(["calibrate", str(REAL / "omx_empty_1"), *words]) == 0
    text = capsys.readouterr().out
    assert "--reference BAG=KG" in text and "times what its URDF says" in text


@pytest.fixture(scope="module")
def learnt_slowly(slow: Motion) -> MotionCalibration:
    return fit_empty(load_robot("open_manipulator_x"), [slow])


@pytest.fixture(scope="module")
def calibrated_slowly(
    learnt_slowly: MotionCalibration, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    path = tmp_path_factory.mktemp("slow") / "omx.yaml"
    write_calibration(path, load_robot("open_manipulator_x"), learnt_slowly)
    return path


def test_a_calibration_comes_back_from_its_file(
    slow: Motion, learnt_slowly: MotionCalibration, calibrated_slowly: Path
) -> None:
    robot = load_robot("open_manipulator_x")
    given = learnt_slowly
    read = load_robot(calibrated_slowly)
    back = read.motion_calibration
    assert back is not None and not read.is_calibrated()
    assert (
        back.keys == given.keys
        and back.runs == given.runs
        and back.fingerprint == given.fingerprint
    )
    for name in ("values", "torque_constants", "friction_spread", "residual", "correlation", "std"):
        np.testing.assert_allclose(
            getattr(back, name), getattr(given, name), rtol=1e-6, err_msg=name
        )
    one, other = (fit_payload(robot, [slow], calibration) for calibration in (given, back))
    np.testing.assert_allclose(
        one.values[:4],
        other.values[:4],
        rtol=1e-4,
        atol=1e-7,
    )
    np.testing.assert_allclose(
        one.std[:4],
        other.std[:4],
        rtol=1e-3,
    )


def test_torque_constants_that_changed_since_are_refused(
    slow: Motion, learnt_slowly: MotionCalibration
) -> None:
    robot = load_robot("open_manipulator_x")
    changed = robot.with_overrides({"joints.joint2.drive_train.torque_constant_N_m_per_A": 1.9})
    with pytest.raises(RobotError, match="torque constant of joint2"):
        fit_payload(changed, [slow], learnt_slowly)


def test_runs_and_motions_are_calibrated_apart(
    capsys: pytest.CaptureFixture[str], slow: Motion, tmp_path: Path
) -> None:
    run = (
        Path(__file__).resolve().parents[2] / "bags" / "realistic_s00_empty_00_joint3" / "bag_mcap"
    )
    words = [
        "--set",
        "held.gripper_left_joint=0.0",
        "--effort-unit",
        "raw",
        "--output",
        str(tmp_path / "omx.yaml"),
    ]
    assert main(["calibrate", str(REAL / "omx_empty_1"), str(run), *words]) == 2
    assert "one or the other" in capsys.readouterr().err
    assert main(["calibrate", str(REAL / "omx_empty_1"), *words]) == 0
    assert (
        main(
            ["replay", str(run), "--probe", "payload", "--calibration", str(tmp_path / "omx.yaml")]
        )
        == 2
    )
    assert "made from motions" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda c: c.pop("version"),
            "version 1 is of another release, this one reads 2: calibrate again",
        ),
        (lambda c: c.update(version="new"), "version 'new' is of another release"),
        (lambda c: c.pop("correlation"), "correlation is missing"),
        (lambda c: c.update(correlation="1\n"), "lower triangle of 80"),
        (lambda c: c.update(deviations="1 2\n"), "rows of 80"),
        (lambda c: c["unknowns"].pop("coulomb[joint3]"), "coulomb"),
        (lambda c: c["unknowns"]["coulomb[joint3]"].update(std=-1.0), "must be positive"),
        (lambda c: c["unknowns"]["coulomb[joint3]"].update(unit="N"), "unit must be"),
        (
            lambda c: c["unknowns"]["coulomb[joint3]"].pop("run_to_run"),
            "coulomb.joint3.: expected value, std, run_to_run",
        ),
        (lambda c: c["joints"][0].update(residual_N_m="x"), "expected a number"),
        (lambda c: c["torque_scale"].update(std=0.0), "torque_scale: std"),
        (lambda c: c["runs"][0].pop("load_kg"), "runs: 1"),
        (lambda c: c["joints"].pop(), "unknowns: .*joint4"),
    ],
)
def test_a_broken_calibration_file_is_refused(
    calibrated_slowly: Path, tmp_path: Path, change, words: str
) -> None:
    from ruamel.yaml import YAML

    yaml = YAML(typ="safe", pure=True)
    content = yaml.load(calibrated_slowly)
    change(content["motion_calibration"])
    path = tmp_path / "omx.yaml"
    with path.open("w") as stream:
        yaml.dump(content, stream)
    with pytest.raises(RobotError, match="motion_calibration: .*" + words):
        load_robot(path)
