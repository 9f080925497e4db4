"""Recordings in, masses out: against the truth of a simulator that shares nothing with this package."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from support.recording_bag import write_recording
from support.simulated import bag_in, fixed, known_drive_train, stated, truth_of, weighed

from proprio_ros.errors import ConfigurationError, ProprioError, RecordingError
from proprio_ros.identification.estimate import Estimate, Verdict
from proprio_ros.pipeline.loading import bag_runs
from proprio_ros.pipeline.replay import replay
from proprio_ros.pipeline.request import Options, Request
from proprio_ros.recordings.signals import read_recording
from proprio_ros.records import InputRecord, JointRecord, Recording
from proprio_ros.robot import load_robot

JOINTS = ("joint1", "joint2", "joint3", "joint4", "gripper_left_joint")
LOADED = "quantised_s00_fixed_heavy_ball_50g_joint3"


def error_and_hit(
    estimate: Estimate,
    truth: Mapping[str, Any],
) -> tuple[float, bool]:
    value = estimate.value("payload_mass")
    mass = truth["payload"]["mass"] if truth["payload"] else 0.0
    low, high = value.ci95
    return value.value - mass, low <= mass <= high


# --- the recordings beside the repository ------------------------------------------------------------------------------


@pytest.mark.parametrize("settings", [None, pytest.param("known", marks=pytest.mark.long)])
def test_ideal_recordings_to_a_tenth_of_a_gram(recordings: Path, settings: str | None) -> None:
    hits = []
    for folder in fixed(recordings, "ideal_s00"):
        truth = truth_of(folder)
        estimate = weighed(folder, known_drive_train(truth) if settings else None)
        assert estimate.verdict in (Verdict.ACCEPTED, Verdict.TOO_WIDE), (
            folder.name,
            estimate.reasons,
        )
        error, hit = error_and_hit(estimate, truth)
        assert abs(error) <= max(1e-4, 2e-3 * truth["payload"]["mass"]), (folder.name, error)
        hits.append(hit)
        if truth["hit_joint_limit"]:
            assert any("reached its limit" in reason for reason in estimate.reasons), folder.name
        if abs(truth["probe_travel"]) < 0.3:
            assert any("moved only" in reason for reason in estimate.reasons), folder.name
    assert len(hits) == 34 and np.mean(hits) >= 0.9


@pytest.mark.parametrize("settings", [None, pytest.param("known", marks=pytest.mark.long)])
def test_quantised_recordings_to_half_a_gram(recordings: Path, settings: str | None) -> None:
    errors = []
    hits = []
    for folder in fixed(recordings, "quantised_s00"):
        truth = truth_of(folder)
        estimate = weighed(folder, known_drive_train(truth) if settings else None)
        assert estimate.verdict in (Verdict.ACCEPTED, Verdict.TOO_WIDE), (
            folder.name,
            estimate.reasons,
        )
        error, hit = error_and_hit(estimate, truth)
        errors.append(error)
        hits.append(hit)
        if settings:
            assert estimate.value("payload_mass").std < 3e-3
    assert np.abs(errors).max() <= 5e-4
    assert np.mean(hits) >= 0.9


@pytest.mark.long
def test_friction_recordings_with_the_true_friction(recordings: Path) -> None:
    errors = []
    hits = []
    refused = []
    for folder in fixed(recordings, "friction_s00"):
        truth = truth_of(folder)
        estimate = weighed(folder, known_drive_train(truth))
        if estimate.verdict is Verdict.ACCEPTED:
            error, hit = error_and_hit(estimate, truth)
            errors.append(error)
            hits.append(hit)
        else:
            refused.append(truth)
            assert estimate.value("payload_mass").value is None
    assert np.median(np.abs(errors)) <= 3e-4
    assert np.mean(hits) >= 0.9
    assert len(errors) >= 24
    assert all(abs(truth["probe_travel"]) < 0.1 for truth in refused)


LONG_LEVELS = [
    pytest.param(level, marks=pytest.mark.long) for level in ("friction_s00", "hard_s00")
]


@pytest.mark.long
@pytest.mark.parametrize("level", ["realistic_s00", *LONG_LEVELS])
def test_without_calibration_the_interval_is_as_wide_as_the_truth_demands(
    recordings: Path, level: str
) -> None:
    hits = []
    for folder in fixed(recordings, level):
        estimate = weighed(folder)
        assert estimate.verdict is not Verdict.ACCEPTED, folder.name
        if estimate.verdict is Verdict.TOO_WIDE:
            hits.append(error_and_hit(estimate, truth_of(folder))[1])
            assert any("not been calibrated" in reason for reason in estimate.reasons)
    assert np.mean(hits) >= 0.9


def test_an_empty_hand_reads_zero(recordings: Path) -> None:
    for folder in sorted((recordings / "quantised_s00").glob("empty_*")):
        truth = truth_of(folder)
        estimate = weighed(folder, known_drive_train(truth))
        if estimate.verdict is Verdict.ACCEPTED:
            value = estimate.value("payload_mass")
            assert value.value < 2.0 * value.std and value.std < 3e-3 and value.ci95[0] == 0.0, (
                folder.name
            )


def test_both_storages_give_the_same_numbers(recordings: Path) -> None:
    folder = recordings / "friction_s00" / "fixed_heavy_cube_23g_joint3"
    one, other = (
        replay([folder / storage], Options(settings=stated(truth_of(folder))))
        for storage in ("bag_mcap", "bag_sqlite3")
    )
    assert one.values == other.values and one.fit == other.fit


def test_the_papers_recording(recordings: Path) -> None:
    """The least error of the authors' setting is at 42.4 g from every start; their schedule stops near 56 g; no weighing."""
    folder = recordings / "paper_heavy_ball"
    paper = replay([folder], Options(profile="paper"))
    assert paper.verdict is Verdict.REJECTED
    assert [path.start for path in paper.solver.paths] == [0.000477, 0.001, 0.005, 0.095, 0.191]
    np.testing.assert_allclose(
        [path.end for path in paper.solver.paths],
        0.0424,
        atol=1e-4,
    )
    stops = np.array([path.scheduled for path in paper.solver.paths])
    np.testing.assert_allclose(
        stops,
        [0.0561, 0.0563, 0.0570, 0.0316, 0.1105],
        atol=1.5e-3,
    )
    assert any("42.4 g" in reason and "110.5 g" in reason for reason in paper.reasons)

    honest = replay([folder])
    assert honest.verdict is Verdict.REJECTED and honest.value("payload_mass").value is None
    assert any(reason.startswith("misfit") for reason in honest.reasons)
    assert any(
        reason.startswith("start velocity") and "rest" in reason for reason in honest.reasons
    )


# --- the repository's own bags -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "tolerance"),
    [
        (LOADED, 5e-4),
        ("quantised_s00_fixed_light_cube_10g_joint2", 5e-4),
        ("quantised_s00_fixed_heavy_cube_23g_joint3_x1", 5e-4),
        ("ideal_s00_fixed_heavy_ball_50g_joint2", 1e-4),
        ("ideal_s00_fixed_random_b_joint3", 1e-4),
    ],
)
def test_own_bags(bags: Path, name: str, tolerance: float) -> None:
    truth = truth_of(bags / name)
    estimate = weighed(bags / name)
    error, hit = error_and_hit(estimate, truth)
    # what the file leaves open makes the interval wide; with the file's own numbers the value is exact
    assert estimate.verdict is Verdict.TOO_WIDE and abs(error) <= tolerance and hit
    assert estimate.solver.starts_agreeing == 5


def test_a_stuck_joint_determines_nothing(bags: Path) -> None:
    estimate = weighed(bags / "friction_s00_fixed_random_a_joint3")
    assert estimate.verdict is Verdict.NOT_IDENTIFIABLE
    assert estimate.value("payload_mass").value is None and estimate.fit is None
    assert "moved only 0.000 rad" in estimate.reasons[0]


def test_profile_paper_refuses_a_stuck_joint_too(bags: Path) -> None:
    estimate = weighed(bags / "friction_s00_fixed_random_a_joint3", profile="paper")
    assert (
        estimate.verdict is Verdict.NOT_IDENTIFIABLE
        and estimate.value("payload_mass").value is None
    )


def test_a_joint_that_is_fast_from_the_first_sample_is_refused(bags: Path, tmp_path: Path) -> None:
    """Nothing of it is usable, and nothing breaks."""
    original = recording_of(bags / LOADED)
    joints = original.joints
    position = joints.position.copy()
    position[11:, 2] -= 0.2 * np.arange(1, len(position) - 10)  # 8 rad/s from the onset on
    fast = replace(
        joints, position=position, velocity=None, effort=None, current=None, reported_effort=None
    )
    write_recording(tmp_path / "bag", replace(original, joints=fast))
    estimate = replay([tmp_path / "bag"])
    assert estimate.verdict is Verdict.NOT_IDENTIFIABLE
    assert "usable samples" in estimate.reasons[0] and "3.5 rad/s" in estimate.reasons[0]


def test_friction_that_the_robot_file_does_not_know_widens_the_interval(bags: Path) -> None:
    folder = bags / "friction_s00_fixed_heavy_ball_50g_joint3"
    estimate = weighed(folder)
    value = estimate.value("payload_mass")
    assert value.ci95[0] < 0.05 < value.ci95[1] and value.ci95[1] - value.ci95[0] > 0.05
    assert estimate.budget[0][0] == "coulomb[joint3]"
    known = weighed(folder, known_drive_train(truth_of(folder)))
    error, hit = error_and_hit(known, truth_of(folder))
    assert abs(error) < 3e-4 and hit and known.value("payload_mass").std < 5e-4


def test_several_bags_of_one_object_are_pooled(recordings: Path) -> None:
    folders = [
        recordings / "quantised_s00" / f"fixed_heavy_ball_50g_{probe}"
        for probe in ("joint3", "joint3_x1", "joint2")
    ]
    truth = truth_of(folders[0])
    settings = {**stated(truth), **known_drive_train(truth)}
    alone = [
        replay([bag_in(folder)], Options(settings=settings)).value("payload_mass").std
        for folder in folders
    ]
    pooled = replay(
        [bag_in(folder) for folder in folders],
        Options(settings=settings),
    )
    assert pooled.runs == 3 and len(pooled.run_fits) == 3 and pooled.verdict is Verdict.ACCEPTED
    assert pooled.value("payload_mass").std < min(alone)
    assert abs(error_and_hit(pooled, truth)[0]) < 3e-4


@pytest.mark.parametrize("solver", ["adam", "cma"])
def test_other_solvers_find_the_same_mass(bags: Path, solver: str) -> None:
    folder = bags / LOADED
    settings = known_drive_train(truth_of(folder))
    reference = weighed(folder, settings).value("payload_mass").value
    other = weighed(folder, settings, solver=solver)
    assert other.solver.name == solver
    assert other.value("payload_mass").value == pytest.approx(reference, abs=3e-4)


def test_semi_implicit_euler_is_biased_as_its_step_says(bags: Path) -> None:
    """The paper's fit from a known start: first order, so halving the step halves the bias of the mass."""
    folder = bags / "ideal_s00_fixed_heavy_ball_50g_joint2"
    settings = {**known_drive_train(truth_of(folder)), "paper.starts_kg": [0.05]}
    biases = [
        weighed(folder, {**settings, "paper.substeps": substeps}, profile="paper")
        .value("payload_mass")
        .value
        - 0.05
        for substeps in (8, 16)
    ]
    assert biases[1] > 1e-4
    assert biases[0] / biases[1] == pytest.approx(2.0, rel=0.05)


@pytest.mark.long
def test_profile_paper_on_a_bag(bags: Path) -> None:
    folder = bags / LOADED
    estimate = weighed(folder, {"paper.substeps": 64}, profile="paper")
    assert estimate.solver.profile == "paper" and estimate.solver.integrator == "semi_implicit"
    ends = [path.end for path in estimate.solver.paths if path.start <= 0.16]
    np.testing.assert_allclose(ends, ends[0], rtol=5e-3)
    assert ends[0] == pytest.approx(0.05, abs=2e-3)
    assert estimate.value("payload_mass").ci95 is None


def test_an_unknown_centre_of_mass_is_estimated_where_it_is_excited(bags: Path) -> None:
    folder = bags / LOADED
    settings = {
        **known_drive_train(truth_of(folder)),
        "payload.com_std": [0.02, 0.02, 0.02],
    }
    estimate = weighed(folder, settings)
    com = estimate.value("payload_com")
    assert com.unit == "m" and com.value[1] is None and "y" in com.reason
    assert (
        estimate.value("payload_mass").std
        > 5 * weighed(folder, known_drive_train(truth_of(folder))).value("payload_mass").std
    )  # mass and lever are nearly one number
    assert error_and_hit(estimate, truth_of(folder))[1]


# --- recordings that are not as they should be ---------------------------------------------------------------------------


def recording_of(folder: Path):
    return read_recording(
        bag_in(folder),
        effort_unit="N.m",
        nominal_torque_constants=dict.fromkeys(JOINTS, 1.782608695652174),
        joint_order=JOINTS,
    )


JOINTS = ["joint1", "joint2", "joint3", "joint4", "gripper_left_joint"]


def test_no_command_topic(bags: Path, tmp_path: Path) -> None:
    folder = bags / LOADED
    write_recording(tmp_path / "bag", replace(recording_of(folder), inputs=None))
    with pytest.raises(RecordingError, match="--effort-unit"):
        replay([tmp_path / "bag"])
    truth = truth_of(folder)
    options = Options(
        settings={
            **stated(truth),
            **known_drive_train(truth),
            "robot.delay_s": {"value": 0.0, "std": 0.0},
        }
    )
    estimate = replay(
        [tmp_path / "bag"],
        replace(options, effort_unit="N.m"),
    )
    error, hit = error_and_hit(estimate, truth)
    assert estimate.verdict is Verdict.ACCEPTED and abs(error) < 2e-3 and hit
    assert estimate.run_fits[0].source == "measured effort"
    assert any("no command was recorded" in note for note in estimate.notes)


def test_joints_in_another_order_and_more_of_them(bags: Path, tmp_path: Path) -> None:
    folder = bags / LOADED
    original = recording_of(folder)
    order = [3, 1, 4, 0, 2]
    joints = original.joints
    shuffled = replace(
        joints,
        names=(*[joints.names[i] for i in order], "lamp"),
        position=np.column_stack([joints.position[:, order], np.full(len(joints.times_ns), 7.0)]),
        velocity=None,
        effort=np.column_stack([joints.effort[:, order], np.zeros(len(joints.times_ns))]),
        current=None,
        reported_effort=None,
    )
    write_recording(tmp_path / "bag", replace(original, joints=shuffled))
    settings = Options(settings=stated(truth_of(folder)))
    assert replay([tmp_path / "bag"], settings).values == replay([bag_in(folder)], settings).values


def test_a_held_joint_that_is_missing_must_be_stated(bags: Path, tmp_path: Path) -> None:
    folder = bags / LOADED
    original = recording_of(folder)
    joints = original.joints
    without = replace(
        joints, names=joints.names[:4], position=joints.position[:, :4], velocity=None, effort=None, current=None,
        reported_effort=None,
    )  # fmt: skip
    write_recording(tmp_path / "bag", replace(original, joints=without))
    with pytest.raises(RecordingError, match=r"gripper_left_joint.*--set held\.gripper_left_joint"):
        replay([tmp_path / "bag"])
    estimate = replay(
        [tmp_path / "bag"],
        Options(settings={"held.gripper_left_joint": 0.0}),
    )
    assert abs(estimate.value("payload_mass").value - 0.05) < 1e-3


def test_a_probe_that_starts_in_motion_is_rejected(bags: Path, tmp_path: Path) -> None:
    """The first quarter second of the probe cut off: the recording then starts at 1 rad/s."""
    original = recording_of(bags / LOADED)
    rows = slice(21, None)
    joints = original.joints
    late = replace(
        joints, times_ns=joints.times_ns[rows], position=joints.position[rows], velocity=None, effort=None, current=None,
        reported_effort=None,
    )  # fmt: skip
    inputs = replace(
        original.inputs,
        times_ns=original.inputs.times_ns[rows],
        current_A=original.inputs.current_A[rows],
    )
    write_recording(
        tmp_path / "bag",
        replace(original, joints=late, inputs=inputs),
    )
    estimate = replay([tmp_path / "bag"])
    assert estimate.verdict is Verdict.REJECTED
    assert any(reason.startswith("start velocity") for reason in estimate.reasons)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"payload.comm": [0, 0, 0]}, r"payload\.comm: unknown; valid keys: .*payload\.com"),
        ({"payload.com": [0, 0]}, r"expected \[x, y, z\] in m"),
        ({"payload.com": [0, 0, 40]}, "lengths are in m"),
        ({"payload.size": 30}, "30 mm is 0.03"),
        ({"payload.shape": "pyramid"}, "choose one of point, sphere"),
        ({"payload.shape": "box", "payload.size": 0.03}, "does not fit a box"),
        ({"payload.inertia_per_mass": [0.1, 0.1, 0.5, 0, 0, 0]}, "no physical body"),
        ({"payload.frame": "hand"}, "no link of open_manipulator_x; it has: link1"),
        ({"solver.starts_kg": [0.0]}, r"solver\.starts_kg: must be positive"),
        ({"solver.starts_kg": []}, "at least one positive mass"),
        ({"solver.integrator": "euler"}, "choose one of rk4, semi_implicit"),
        ({"paper.substeps": 4.5}, "whole number"),
        ({"held.joint9": 0.0}, "joint9"),
        ({"robot.joints.joint3.drive_train.coulomb": 0.05}, "coulomb_N_m"),
    ],
)
def test_settings_that_cannot_be_meant(
    bags: Path,
    settings: dict[str, Any],
    words: str,
) -> None:
    with pytest.raises(ProprioError, match=words) as caught:
        replay([bag_in(bags / LOADED)], Options(settings=settings))
    assert "\n" not in str(caught.value)


def test_unknown_words_list_the_choices(bags: Path) -> None:
    bag = bag_in(bags / LOADED)
    for options, words in (
        (Options(probe="liquid"), "choose one of: payload"),
        (Options(profile="fast"), "default, paper"),
        (Options(solver="newton"), "lm, adam, cma"),
    ):
        with pytest.raises(ConfigurationError, match=words):
            replay([bag], options)
    with pytest.raises(ConfigurationError, match="profile paper fits one run"):
        replay(
            [bag, bag_in(bags / "quantised_s00_fixed_light_cube_10g_joint2")],
            Options(profile="paper"),
        )


def test_a_pendulum_of_ones_own(tmp_path: Path) -> None:
    """Another robot from its own file and URDF; the truth is an ODE written here and solved to 1e-11."""
    mass = 0.037
    current = 0.35
    inertia = 0.018008 + mass * 0.3**2
    times_s = np.arange(-8, 25) * 0.025
    motion = solve_ivp(
        lambda _, x: [x[1], (current - 9.81 * 0.3 * (0.2 + mass) * np.sin(x[0])) / inertia],
        (0.0, 0.61), [0.4, 0.0], method="DOP853", rtol=1e-11, atol=1e-13, t_eval=times_s[8:],
    )  # fmt: skip
    count = 2.0 * np.pi / 4096
    position = np.round(np.concatenate([np.full(8, 0.4), motion.y[0]]) / count) * count
    stamps = 1_700_000_000_000_000_000 + (times_s * 1e9).astype(np.int64)
    recording = Recording(
        "swing",
        JointRecord(stamps, ("pivot",), position[:, None]),
        InputRecord(
            stamps,
            ("pivot",),
            np.where(
                times_s < 0.0,
                0.0,
                current,
            )[:, None],
            "/current_command",
        ),
    )
    write_recording(tmp_path / "swing", recording, storage="sqlite3")
    estimate = replay(
        [tmp_path / "swing"],
        Options(
            robot="pendulum",
            settings={"payload.shape": "point"},
        ),
    )
    value = estimate.value("payload_mass")
    assert estimate.verdict is Verdict.ACCEPTED and estimate.robot == "pendulum"
    assert value.ci95[0] < mass < value.ci95[1] and value.std < 2e-3
    # its drive train is known exactly
    assert not any("calibrated" in reason for reason in estimate.reasons)


@pytest.mark.parametrize(
    "way", ["path", "folder above", "link", "file", "copy", "baseline", "both storages"]
)
def test_a_recording_counts_once(bags: Path, tmp_path: Path, way: str) -> None:
    bag = bags / "realistic_s00_fixed_heavy_cube_23g_joint3" / "bag_mcap"
    other = bag
    baseline = ()
    if way == "folder above":
        other = bag.parent / ".." / bag.parent.name / bag.name
    elif way == "link":
        other = tmp_path / "link"
        other.symlink_to(bag)
    elif way == "file":
        (other,) = bag.glob("*.mcap")
    elif way == "copy":
        other = tmp_path / "copy"
        shutil.copytree(bag, other)
    elif way == "baseline":
        baseline = (bag,)
    elif way == "both storages":
        recording = read_recording(bag, nominal_torque_constants={}, joint_order=JOINTS)
        write_recording(tmp_path / "again", recording, "sqlite3")
        other = tmp_path / "again"
    given = [bag] if baseline else [bag, other]
    with pytest.raises(ConfigurationError, match=r"was given twice|are the same recording"):
        replay(given, Options(baseline=baseline))


def test_a_damaged_number_is_left_out(bags: Path, tmp_path: Path) -> None:
    """One exponent's bit of one sample, in a storage without checksums."""
    bag = bags / "realistic_s00_fixed_heavy_cube_23g_joint3" / "bag_mcap"
    robot = load_robot("open_manipulator_x")
    recording = read_recording(bag, nominal_torque_constants={}, joint_order=JOINTS)
    (run,) = bag_runs(bag, Request(robot))
    hit = int(np.searchsorted(recording.joints.times_ns, run.onset_ns)) + 8
    position = recording.joints.position.copy()
    position[hit, recording.joints.column("joint3")] += 2.0
    damaged = replace(
        recording,
        joints=replace(recording.joints, position=position),
    )
    write_recording(tmp_path / "damaged", damaged, "sqlite3")
    (cleaned,) = bag_runs(tmp_path / "damaged", Request(robot))
    assert (
        len(cleaned.times_s) == len(run.times_s) - 1
        and np.isin(cleaned.position, run.position).all()
    )
    assert any("in 1 of " in note and "jumps there and back" in note for note in cleaned.notes)
    assert not any("jumps" in note for note in run.notes)
