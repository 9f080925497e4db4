"""What a recording shows of itself: on recordings made up so that they do, and on real ones."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.recording_bag import write_recording
from support.simulated import runs_of

from proprio_ros.cli import main
from proprio_ros.experiment_design.predicted_mass import (
    mass_from_motion,
    mass_from_run,
    more_of_motion,
    more_of_run,
)
from proprio_ros.identification.robot_calibration import LoadedRun, calibrate
from proprio_ros.pipeline.loading import bag_recording, bag_runs
from proprio_ros.pipeline.request import Options, Request
from proprio_ros.probes.payload.identify import weigh
from proprio_ros.recordings.effort_units import effort_per_torque, effort_units, gravity_torque
from proprio_ros.recordings.motions import motion_of
from proprio_ros.recordings.plausibility import findings, velocity_lag_s
from proprio_ros.recordings.signals import read_recording
from proprio_ros.records import InputRecord, JointRecord, Recording
from proprio_ros.robot import load_robot, with_recorded_torque

ROOT = Path(__file__).resolve().parents[2]
REAL = ROOT.parent / "shared" / "recordings_real"
RATE_HZ = 100.0
TIMES_S = np.arange(0.0, 20.0, 1.0 / RATE_HZ)
real = pytest.mark.skipif(
    not (REAL / "omx_empty_1").exists(),
    reason="needs the real recordings",
)


def angle(times_s: np.ndarray) -> np.ndarray:
    return 0.8 * np.sin(0.9 * times_s) + 0.3 * np.sin(2.3 * times_s)


def rate(times_s: np.ndarray) -> np.ndarray:
    return 0.72 * np.cos(0.9 * times_s) + 0.69 * np.cos(2.3 * times_s)


def recording(
    effort: np.ndarray | None = None, velocity: np.ndarray | None = None, **changes: Any
) -> Recording:
    """Joint a moves, joint b stands still."""
    times_ns = np.round(1e9 * TIMES_S).astype(np.int64)

    def column(values: np.ndarray | None) -> np.ndarray | None:
        return None if values is None else np.column_stack([values, np.zeros(len(times_ns))])

    position = np.column_stack([np.round(angle(TIMES_S), 3), np.full(len(times_ns), 0.2)])
    joints = JointRecord(
        times_ns, ("a", "b"), position, column(velocity), reported_effort=column(effort)
    )
    return Recording("bag", joints, changes.get("inputs"))


def codes(recorded: Recording) -> list[str]:
    return [finding.code for finding in findings(recorded)]


def noise(size: float, seed: int = 0) -> np.ndarray:
    return size * np.random.default_rng(seed).standard_normal(len(TIMES_S))


def test_a_recording_without_traps_shows_none() -> None:
    assert codes(recording(-3.0 * angle(TIMES_S) + noise(0.1), rate(TIMES_S) + noise(0.02))) == []


@pytest.mark.parametrize("lag_s", [0.025, 0.047, 0.1])
def test_velocity_that_lags_is_timed(lag_s: float) -> None:
    late = rate(TIMES_S - lag_s) + noise(0.02)
    seen = velocity_lag_s(
        TIMES_S,
        np.round(angle(TIMES_S), 3),
        late,
    )
    assert (
        seen is not None
        and seen[0] == pytest.approx(lag_s, abs=0.003)
        and seen[1] == pytest.approx(1.0, abs=0.03)
    )
    found = findings(recording(velocity=late))
    assert [finding.code for finding in found] == ["velocity_lags"] and found[0].joints == ("a",)
    assert (
        found[0].values["a"] == pytest.approx(1e3 * lag_s, abs=3.0)
        and f"{1e3 * lag_s:.0f}"[:-1] in found[0].sentence
    )


def test_velocity_of_the_last_two_positions_is_not_said_to_lag() -> None:
    backward = np.gradient(angle(TIMES_S - 0.005), 1.0 / RATE_HZ)
    assert codes(recording(velocity=backward)) == []


def test_velocity_in_rpm_is_said() -> None:
    (found,) = findings(recording(velocity=9.55 * rate(TIMES_S)))
    assert found.code == "velocity_scale" and "rpm" in found.sentence


def test_columns_that_never_change() -> None:
    found = findings(recording(np.full(len(TIMES_S), 0.5), np.zeros(len(TIMES_S))))
    assert [finding.code for finding in found] == ["constant_velocity", "constant_effort"]
    assert "the effort of a is 0.5 in every message" in found[1].sentence


def test_registers_without_sign() -> None:
    torque = np.round(-300.0 * angle(TIMES_S) + noise(20.0))
    (found,) = findings(recording(np.where(torque < 0, torque + 65536, torque)))
    assert found.code == "unsigned_register" and "(65174 is -362)" in found.sentence
    (found,) = findings(recording(np.abs(torque)))
    assert found.code == "effort_without_sign"
    # an arm that only ever lifts has one sign
    assert codes(recording(-300.0 * angle(TIMES_S) + noise(20.0) + 500.0)) == []


def test_effort_that_is_read_seldom() -> None:
    every = np.arange(len(TIMES_S)) // 20 * 20
    (found,) = findings(recording((-3.0 * angle(TIMES_S))[every]))
    assert found.code == "effort_stale" and found.values["a"] == pytest.approx(0.2)
    # a motor that is off most of the time, or at its limit, is none
    off = np.where(
        TIMES_S % 4.0 < 3.0,
        0.0,
        -3.0 * angle(TIMES_S) + noise(0.1),
    )
    assert (
        codes(recording(off)) == []
        and codes(
            recording(
                np.clip(
                    -9.0 * angle(TIMES_S),
                    -3.0,
                    3.0,
                )
            )
        )
        == []
    )


def test_effort_that_is_the_command() -> None:
    times_ns = np.round(1e9 * TIMES_S).astype(np.int64)
    command = -3.0 * angle(TIMES_S)
    given = InputRecord(
        times_ns,
        ("a",),
        command[:, None],
        "/current_command",
    )
    assert codes(recording(1.78 * command, inputs=given)) == ["effort_is_command"]
    assert codes(recording(np.roll(1.78 * command, 1) * (TIMES_S > 0.0), inputs=given)) == [
        "effort_is_command"
    ]
    assert codes(recording(1.78 * command + noise(0.01), inputs=given)) == []


def test_what_held_a_joint_did_not_drive_it() -> None:
    times_ns = np.round(1e9 * TIMES_S).astype(np.int64)
    both = np.column_stack([-3.0 * angle(TIMES_S), np.full(len(TIMES_S), 0.4)])
    (found,) = findings(
        recording(inputs=InputRecord(times_ns, ("a", "b"), both, "/current_command"))
    )
    assert found.code == "held" and found.joints == ("b",)


PENDULUM = """<robot name="p"><link name="base"/>
<link name="rod"><inertial><origin xyz="0 0 -0.3"/><mass value="2"/>
<inertia ixx="0.01" iyy="0.01" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="a" type="continuous"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/></joint></robot>"""


def test_effort_is_compared_with_gravity(tmp_path: Path) -> None:
    """m g l sin(q) = 5.886 N m x sin(q), beside Coulomb friction, an offset and the rod's inertia; in mA of a motor of 2 N m/A."""
    (tmp_path / "p.urdf").write_text(PENDULUM)
    robot = load_robot(tmp_path / "p.urdf", with_recorded_torque(tmp_path / "p.urdf", {}))
    model = robot.model.lock(["a"], {})
    q = angle(TIMES_S)
    np.testing.assert_allclose(
        gravity_torque(model, q[:, None])[:, 0], 5.886 * np.sin(q), atol=1e-12
    )
    acceleration = np.gradient(rate(TIMES_S), TIMES_S)
    torque = (
        5.886 * np.sin(q) + 0.19 * acceleration + 0.5 * np.sign(rate(TIMES_S)) + 0.3 + noise(0.2)
    )
    recorded = recording(500.0 * torque)
    recorded = replace(
        recorded,
        joints=replace(
            recorded.joints,
            names=("a",),
            position=recorded.joints.position[:, :1],
            reported_effort=recorded.joints.reported_effort[:, :1],
        ),
    )
    per_torque = effort_per_torque(recorded, robot)
    assert per_torque["a"] == pytest.approx(500.0, rel=0.05)
    units = {unit.unit: unit for unit in effort_units(per_torque, {"a": 2.0}, 0.00269)}
    assert [name for name, unit in units.items() if unit.plausible] == ["mA"]
    assert units["mA"].ratio["a"] == pytest.approx(1.0, rel=0.05)
    # without torque constants only torque itself can be judged
    assert [unit.unit for unit in effort_units(per_torque, {"b": 2.0}, 0.00269)] == ["N.m"]
    assert [unit.unit for unit in effort_units(per_torque, {}, 0.00269)] == ["N.m"]
    # noise alone, or a joint that gravity does not load, says nothing
    assert (
        effort_per_torque(
            replace(recorded, joints=replace(recorded.joints, reported_effort=noise(1.0)[:, None])),
            robot,
        )
        == {}
    )


def test_a_few_damaged_rows_are_left_out_and_many_are_not(tmp_path: Path) -> None:
    whole = recording(velocity=rate(TIMES_S))
    for rows, kept in ((np.array([7, 800]), True), (np.arange(200), False)):
        position = whole.joints.position.copy()
        position[rows, 0] = -1.1e282
        damaged = replace(
            whole,
            joints=replace(whole.joints, position=position),
        )
        path = tmp_path / f"{len(rows)}"
        write_recording(path, damaged)
        if kept:
            found = read_recording(path, nominal_torque_constants={}, joint_order=["a"])
            assert len(found.joints.times_ns) == len(TIMES_S) - len(rows)
            assert any(
                "2 of 2000 messages hold numbers that no joint can have" in note
                for note in found.notes
            )
        else:
            with pytest.raises(Exception, match="degrees"):
                read_recording(path, nominal_torque_constants={}, joint_order=["a"])


def checked(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, Any]:
    capsys.readouterr()
    main(["check", *words, "--json"])
    return json.loads(capsys.readouterr().out)["bags"][0]


@real
def test_a_real_open_manipulator(capsys: pytest.CaptureFixture[str]) -> None:
    """Its effort is raw counts of 2.69 mA, and its velocity register lags by 40 to 50 ms: both were found by hand before."""
    found = checked(capsys, str(REAL / "omx_empty_1"))
    assert [unit["unit"] for unit in found["effort_units"] if unit["plausible"]] == ["raw"]
    (lag,) = [finding for finding in found["findings"] if finding["code"] == "velocity_lags"]
    assert len(lag["joints"]) == 4 and all(40.0 < value < 50.0 for value in lag["values"].values())
    assert 0.01 < found["tells"]["mass_half_width_kg"] < 0.1
    assert "nothing is chosen by it" in shown(capsys, str(REAL / "omx_empty_1"))


def shown(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    capsys.readouterr()
    main(["check", *words])
    return capsys.readouterr().out


@real
def test_real_servos_whose_effort_is_of_no_use(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "p.urdf").write_text(PENDULUM.replace('name="a"', 'name="pendulum"'))
    robot = ("--robot", str(tmp_path / "p.urdf"), "--effort-unit", "raw")
    found = checked(capsys, str(REAL / "xl330_kp400_sin_sin"), *robot)
    assert any("16-bit register that was read as unsigned" in note for note in found["notes"]), (
        "mended when it was read"
    )
    found = checked(capsys, str(REAL / "sts3215_sin_sin_0.535kg"), *robot)
    assert {"effort_without_sign", "effort_stale"} <= {
        finding["code"] for finding in found["findings"]
    }
    # signed, and read as often as it is published
    found = checked(capsys, str(REAL / "xl330_kp100_sin_sin"), *robot)
    assert {finding["code"] for finding in found["findings"]} == {
        "velocity_lags",
        "no_torque_constants",
    }


@real
def test_a_urdf_alone_is_enough_to_look(capsys: pytest.CaptureFixture[str]) -> None:
    """The arm's own controller says 11.98 and 9.84 N m/A at shoulder and elbow; nothing is held here."""
    found = checked(
        capsys, str(REAL / "ur10e_empty_14"), "--robot", str(REAL / "models" / "ur10e.urdf")
    )
    constants = [
        1.0 / found["effort_per_N_m"][name] for name in ("shoulder_lift_joint", "elbow_joint")
    ]
    assert constants == pytest.approx([11.976, 9.838], rel=0.25)
    assert not any(unit["plausible"] for unit in found["effort_units"])
    assert found["tells"]["mass_half_width_per_kg"] is None
    assert [finding["code"] for finding in found["findings"]] == ["no_torque_constants"]


@real
def test_without_the_right_robot_it_still_says_what_moves(
    capsys: pytest.CaptureFixture[str],
) -> None:
    found = checked(capsys, str(REAL / "dfki_pd"))
    assert found["moves"] == ["pendulum"] and found["findings"][-1]["code"] == "other_robot"


@real
def test_a_motion_tells_about_what_came_out_of_it(tmp_path: Path) -> None:
    """Real answers from these motions had half intervals of 56 to 250 g."""
    urdf = REAL / "models" / "ur10e.urdf"
    robot = load_robot(urdf, with_recorded_torque(urdf, {}))
    recorded = bag_recording(
        REAL / "ur10e_loaded_14",
        Request(robot, Options(effort_unit="A")),
    )
    whole = motion_of(recorded, joints=list(robot.drive_trains))
    width_kg, per_kg = mass_from_motion(robot, whole)
    assert 0.05 < width_kg < 0.25 and per_kg == pytest.approx(1.96 * 0.1, rel=0.01)
    # from a quarter of the time it is less certain, whatever flowed
    short = whole.times_s < 0.25 * whole.times_s[-1]
    quarter = replace(
        whole,
        times_s=whole.times_s[short],
        position=whole.position[short],
        current_A=0.0 * whole.current_A[short],
    )
    assert mass_from_motion(robot, quarter)[0] > 1.3 * width_kg
    # a second empty hand halves at most what the first one leaves open; a known load tells the torque constants
    empty, load = more_of_motion(robot, whole, width_kg, per_kg)
    assert (empty.kind, load.kind) == ("empty_hand", "known_load")
    assert np.sqrt(0.5) * width_kg < empty.mass_half_width_kg < width_kg
    assert load.load_kg is not None and 1.0 < load.load_kg < 5.0
    assert load.mass_half_width_per_kg == pytest.approx(1.96 * 0.025, rel=0.1)
    assert {each.kind for each in more_of_motion(robot, whole, width_kg, 0.02)} == {"empty_hand"}


def test_a_run_tells_about_what_comes_out_of_it() -> None:
    """Uncalibrated, these two give 0 to 131 g and 0 to 133 g."""
    robot = load_robot("open_manipulator_x")
    for name in (
        "quantised_s00_fixed_heavy_ball_50g_joint3",
        "realistic_s00_fixed_light_ball_20g_joint3",
    ):
        (run,) = bag_runs(
            ROOT / "bags" / name / "bag_mcap",
            Request(robot),
        )
        width_kg = mass_from_run(robot, run)
        assert width_kg is not None and 0.065 < width_kg < 0.15
    # a controller's current is no push
    swinging = np.where(
        np.arange(6) % 2,
        0.1,
        -0.1,
    )
    assert (
        mass_from_run(
            robot, replace(run, input_times_s=0.05 * np.arange(6), input_current_A=swinging)
        )
        is None
    )


def test_what_a_calibration_would_bring_is_what_it_brings() -> None:
    robot = load_robot("open_manipulator_x")
    folders = sorted((ROOT / "bags").glob("realistic_s00_empty_*"))
    empty = [LoadedRun(run) for folder in folders for run in runs_of(folder, robot)]
    calibration = calibrate(robot, empty).calibration
    assert calibration is not None
    known = robot.with_calibration(calibration)
    folder = ROOT / "bags" / "realistic_s00_fixed_light_ball_20g_joint3"
    (run,) = runs_of(folder, robot)
    (foreseen,) = more_of_run(robot, run)
    mass = weigh(known, [run]).values[0]
    assert foreseen.kind == "calibration" and mass.std is not None
    assert 1.0 / 2.5 < foreseen.mass_half_width_kg / (1.96 * mass.std) < 2.5
    # what differs from run to run is most of what such a robot does not know, and another push halves its variance
    noisy = replace(known, torque_disturbance=0.1)
    (push,) = more_of_run(noisy, run)
    alone_kg = mass_from_run(noisy, run)
    assert push.kind == "push" and alone_kg is not None
    assert push.mass_half_width_kg == pytest.approx(np.sqrt(0.5) * alone_kg, rel=0.02)
