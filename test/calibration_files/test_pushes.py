"""The calibration file: what goes in comes out, and what is broken is refused in one line."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from ruamel.yaml import YAML

from proprio_ros.calibration_files.pushes import Calibration
from proprio_ros.cli import main
from proprio_ros.errors import ConfigurationError, RobotError
from proprio_ros.identification.scatter import expected
from proprio_ros.inputs.resources import resource
from proprio_ros.kinds import key_of
from proprio_ros.live.workspace import Workspace
from proprio_ros.pipeline.api import calibrate
from proprio_ros.pipeline.calibrate import calibrate_from_bags, refresh_from_bags, write_calibration
from proprio_ros.pipeline.loading import bag_recording, runs_or_motion
from proprio_ros.pipeline.replay import replay
from proprio_ros.pipeline.request import Options, request_of, robot_of
from proprio_ros.records import JointRecord
from proprio_ros.robot import load_robot

NAMES = (
    "torque_constant[joint3]", "coulomb[joint3]", "armature[joint3]", "arm_scale", "delay", "link_mass[link5]",
    "viscous[joint3]", "load_friction[joint3]", "zero[joint3]", "stribeck[joint3]", "stribeck_velocity[joint3]",
)  # fmt: skip


def small() -> Calibration:
    """Eleven unknowns of very different size, all correlated."""
    factor = np.eye(11) + 0.4 * np.random.default_rng(5).normal(size=(11, 11))
    stds = np.array([0.02, 0.003, 0.0008, 0.015, 0.0011, 0.009, 0.002, 0.003, 0.004, 0.1, 0.05])
    correlation = factor @ factor.T
    correlation /= np.sqrt(np.outer(np.diag(correlation), np.diag(correlation)))
    return Calibration(
        tuple(key_of(name) for name in NAMES),
        np.array(
            [1.7123456789, 0.041, 0.0143, 1.013, 0.0087, -0.004, 0.008, 0.02, 0.006, 0.0, 0.12]
        ),
        correlation * np.outer(stds, stds),
        1.07,
        2.6e-4,
        1.1e-3,
        4e-3,
        ({"name": "bag", "joint": "joint3", "current_A": -0.3, "load_kg": 0.0, "samples": 24},),
    )


@pytest.fixture
def written(tmp_path: Path) -> Path:
    path = tmp_path / "arm.yaml"
    write_calibration(path, load_robot("open_manipulator_x"), small())
    return path


def edited(path: Path, change) -> Path:
    """The file with its content changed by a function of the plain mappings."""
    content = YAML(typ="safe", pure=True).load(path)
    change(content)
    writer = YAML(typ="safe", pure=True)
    with path.open("w") as stream:
        writer.dump(content, stream)
    return path


def test_everything_comes_back(written: Path) -> None:
    calibration = load_robot(written).calibration
    given = small()
    assert calibration is not None
    assert calibration.keys == given.keys and calibration.names == NAMES
    np.testing.assert_allclose(calibration.values, given.values, rtol=1e-12)
    np.testing.assert_allclose(calibration.covariance, given.covariance, rtol=1e-9)
    assert calibration.residual_scale == 1.07 and calibration.stamp_jitter_s == 2.6e-4
    assert calibration.torque_disturbance == 1.1e-3 and calibration.start_velocity == 4e-3
    assert calibration.runs == given.runs
    assert calibration.joints == ("joint3",)


def test_how_well_the_spread_of_torque_is_known_comes_back(tmp_path: Path) -> None:
    spread = expected(0.0012)
    path = tmp_path / "arm.yaml"
    robot = load_robot("open_manipulator_x")
    write_calibration(path, robot, replace(small(), torque_spread=spread))
    read = load_robot(path).calibration
    assert read is not None and read.torque_spread is not None
    assert read.torque_spread.stated == 0.0012
    np.testing.assert_allclose(read.torque_spread.weights, spread.weights, rtol=1e-11)


def test_older_files_do_not_say_how_well_the_spread_of_torque_is_known(written: Path) -> None:
    calibration = load_robot(written).calibration
    assert calibration is not None and calibration.torque_spread is None


@pytest.mark.parametrize(
    "weights",
    ["0.5 0.5", "nan " * 36, "1 " * 36, "-1 2 " + "0 " * 34],
    ids=["two", "no numbers", "more than 1", "less than 0"],
)
def test_weights_that_are_no_probabilities_are_refused(written: Path, weights: str) -> None:
    def change(content) -> None:
        spread = {"stated_N_m": 0.001, "weights": weights}
        content["calibration"]["torque_spread"] = spread
        del content["calibration"]["digest"]

    with pytest.raises(RobotError, match="torque_spread: weights must be 36 probabilities"):
        load_robot(edited(written, change))


def test_what_is_known_given_one_unknown_is_what_its_precision_says() -> None:
    rise = ("stribeck", "joint3")
    given = small().given({rise, ("stribeck", "joint2")})
    kept = [row for row, key in enumerate(small().keys) if key != rise]
    assert given.keys == tuple(small().keys[row] for row in kept)
    precision = np.linalg.inv(small().covariance)[np.ix_(kept, kept)]
    np.testing.assert_allclose(
        given.covariance @ precision,
        np.eye(len(kept)),
        atol=1e-6,
    )
    np.testing.assert_array_equal(
        small().given(set()).covariance,
        small().covariance,
    )


def test_a_calibration_that_knows_fewer_joints_under_current_does_not_take_its_place(
    tmp_path: Path,
) -> None:
    """Free swings know nothing of a torque constant: what a current drives would be weighed with the robot file's."""
    robot = load_robot("open_manipulator_x")
    second = {"joint3": "joint2"}
    other = tuple(
        key if isinstance(key, str) else (key[0], second.get(str(key[1]), key[1]))
        for key in small().keys
    )
    files = {
        "full": small(),
        "other": replace(small(), keys=other),
        "swings": replace(
            small(),
            swing_error=0.002,
            runs=(
                {
                    **small().runs[0],
                    "current_A": 0.0,
                },
            ),
        ),
    }
    for name, calibration in files.items():
        write_calibration(tmp_path / f"{name}.yaml", robot, calibration)
    workspace = Workspace(tmp_path / "data", "open_manipulator_x")
    (tmp_path / "data").mkdir()

    def kept(name: str) -> str:
        return workspace.keep_calibration(tmp_path / f"{name}.yaml")

    assert kept("swings") == "" and workspace.calibration == tmp_path / "swings.yaml", (
        "better than none"
    )
    assert kept("full") == "" and workspace.newest_calibration.resolve() == tmp_path / "full.yaml"
    assert "does not know what a current does to joint3" in kept("swings")
    assert workspace.calibration == tmp_path / "full.yaml"
    assert workspace.newest_calibration.resolve() == tmp_path / "full.yaml", (
        "and so it is at the next start"
    )
    # neither knows all that the other does: the newer one
    assert kept("other") == "" and workspace.calibration == tmp_path / "other.yaml"


def test_the_robot_takes_what_was_learnt_and_keeps_the_rest(written: Path) -> None:
    base = load_robot("open_manipulator_x")
    robot = load_robot(written)
    drive = robot.drive_trains["joint3"]
    assert (
        robot.is_calibrated()
        and robot.is_calibrated(["joint3"])
        and not robot.is_calibrated(["joint2", "joint3"])
    )
    assert not base.is_calibrated() and robot.name == base.name
    assert drive.torque_constant.value == pytest.approx(
        1.7123456789
    ) and drive.torque_constant.std == pytest.approx(0.02)
    assert drive.coulomb.value == pytest.approx(0.041) and drive.viscous.value == pytest.approx(
        0.008
    )
    assert robot.drive_trains["joint2"] == base.drive_trains["joint2"]
    assert robot.arm_scale.value == pytest.approx(1.013) and robot.delay.std == pytest.approx(
        0.0011
    )
    assert (
        robot.residual_scale == 1.07
        and robot.stamp_jitter_s == 2.6e-4
        and robot.torque_disturbance == 1.1e-3
    )
    assert robot.start_velocity == 4e-3


def test_a_robot_of_ones_own_is_extended_by_the_way_to_its_file(tmp_path: Path) -> None:
    folder = tmp_path / "robots"
    folder.mkdir()
    own = folder / "mine.yaml"
    own.write_text("extends: open_manipulator_x\nname: mine\n")
    (tmp_path / "calibrations").mkdir()
    path = tmp_path / "calibrations" / "mine_today.yaml"
    overrides = {"joints.joint3.motor.encoder_noise_rad": 0.0007}
    write_calibration(
        path,
        load_robot(own).with_overrides(overrides),
        small(),
        overrides,
    )
    assert "extends: ../robots/mine.yaml" in path.read_text()
    robot = load_robot(path)
    assert robot.name == "mine" and robot.drive_trains["joint3"].encoder_noise == 0.0007


def test_what_the_user_states_replaces_one_number_and_keeps_the_others_correlations(
    written: Path,
) -> None:
    robot = load_robot(written).with_overrides(
        {"joints.joint3.drive_train.coulomb_N_m": {"value": 0.07, "std": 0.001}}
    )
    assert robot.drive_trains["joint3"].coulomb.value == 0.07
    assert robot.drive_trains["joint3"].torque_constant.value == pytest.approx(1.7123456789)
    calibration = robot.calibration
    whole = small()
    assert calibration is not None and "coulomb[joint3]" not in calibration.names
    kept = [row for row, name in enumerate(whole.names) if name != "coulomb[joint3]"]
    np.testing.assert_allclose(
        calibration.covariance, whole.covariance[np.ix_(kept, kept)], rtol=1e-9
    )
    assert load_robot(written).with_overrides({"delay_s": 0.003}).delay.value == 0.003


def of(name: str, **entries):
    """A change of one unknown."""
    return lambda content: content["calibration"]["unknowns"][name].update(entries)


def renamed(name: str, other: str):
    """A change of the name of one unknown, whose place stays."""

    def change(content) -> None:
        unknowns = content["calibration"]["unknowns"]
        content["calibration"]["unknowns"] = {
            other if key == name else key: entry for key, entry in unknowns.items()
        }

    return change


def triangle(below: str = "0", diagonal: str = "1") -> str:
    """Correlations of independent unknowns, with one changed."""
    rows = [["0"] * row + ["1"] for row in range(len(NAMES))]
    rows[1][0], rows[0][0] = below, diagonal
    return "".join(" ".join(row) + "\n" for row in rows)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda c: c["calibration"].pop("unknowns"), "unknowns is missing"),
        (lambda c: c["calibration"].pop("correlation"), "correlation is missing"),
        (lambda c: c["calibration"]["unknowns"]["arm_scale"].pop("std"), "arm_scale: std"),
        (lambda c: c["calibration"]["unknowns"]["arm_scale"].update(std=-1.0), "must be positive"),
        (
            lambda c: c["calibration"]["unknowns"]["arm_scale"].update(value=float("nan")),
            "expected a finite number",
        ),
        (lambda c: c["calibration"]["unknowns"].pop("arm_scale"), "lower triangle of 10 unknowns"),
        (lambda c: c["calibration"].update(correlation=triangle(below="x")), "line 2"),
        (lambda c: c["calibration"].update(correlation=triangle(diagonal="2")), "ones on its"),
        (lambda c: c["calibration"].update(correlation=triangle(below="1")), "not one of any"),
        (lambda c: c.update(calibration=[1, 2]), "expected keys and values"),
        (lambda c: c.update(model_fingerprint="0" * 64), "made with another URDF"),
        (lambda c: c["calibration"].update(residual_scale="much"), "residual_scale"),
        (
            lambda c: c["calibration"].update(residual_scale=1e300),
            r"residual_scale: must be from 0.01 to 10",
        ),
        (lambda c: c["calibration"].update(residual_scale=10**400), "residual_scale: expected a"),
        (lambda c: c["calibration"].update(residual_scale=0), "residual_scale: must be positive"),
        (
            lambda c: c["calibration"].update(stamp_jitter_s=-1e-4),
            "stamp_jitter_s: must not be negative",
        ),
        (lambda c: c["calibration"].update(start_velocity_rad_s=1e9), "start_velocity_rad_s"),
        (
            lambda c: c["calibration"].update(torque_disturbance_N_m=None),
            "torque_disturbance_N_m: expected a number",
        ),
        (of("arm_scale", value=0), r"arm_scale: value: must be positive"),
        (of("arm_scale", value=20), r"arm_scale: value: must be from 0.5 to 2"),
        (of("coulomb[joint3]", value=-0.04), r"coulomb\[joint3\]: value: must not be negative"),
        (
            of("torque_constant[joint3]", value=-1.7),
            r"torque_constant\[joint3\]: value: must be positive",
        ),
        (of("torque_constant[joint3]", value=17.0), "over 5 times"),
        (of("torque_constant[joint3]", std=1e-300), r"std: must be from"),
        (of("link_mass[link5]", value=-0.41), "over 10 of the robot file's standard deviations"),
        (of("delay", value=9.0), "delay: value: must be from -0.1 to 0.1 s"),
        (of("zero[joint3]", unit="deg"), "unit must be 'rad'"),
        (renamed("coulomb[joint3]", "colomb[joint3]"), "no such unknown"),
        (renamed("coulomb[joint3]", "coulomb"), "no such unknown"),
        (renamed("arm_scale", "arm_scale[joint3]"), "no such unknown"),
        (renamed("arm_scale", "payload_mass"), "no such unknown"),
        (renamed("coulomb[joint3]", "coulomb[elbow]"), "the robot has no such joint"),
        (renamed("link_mass[link5]", "link_mass[link9]"), "the robot has no such link"),
        (renamed("coulomb[joint3]", "coulomb[joint2]"), r"coulomb\[joint3\] missing"),
        (lambda c: c.pop("model_fingerprint"), "model_fingerprint is missing"),
        (lambda c: c["calibration"].update(motors=[]), "motors is missing or no"),
        (
            lambda c: c["calibration"].update(motors={"joint3": {"id": 13}}),
            "motors: joint3: expected model, id, firmware",
        ),
        (lambda c: c["calibration"]["runs"].append("a bag"), "runs: 2: expected name, joint"),
        (
            lambda c: c["calibration"]["runs"][0].update(samples="many"),
            "runs: 1: samples: expected a whole number",
        ),
        (
            lambda c: c.update(friction_velocity_rad_s=12),
            "friction_velocity_rad_s: must be above 0 and at most 0.01 rad/s",
        ),
    ],
)
def test_a_broken_file_is_refused_in_one_line(written: Path, change, words: str) -> None:
    with pytest.raises(RobotError, match=words) as caught:
        load_robot(edited(written, change))
    assert "arm.yaml" in str(caught.value) and "\n" not in str(caught.value)


def test_a_calibration_of_joints_that_the_robot_does_not_drive(written: Path) -> None:
    def foreign(content) -> None:
        unknowns = content["calibration"]["unknowns"]
        content["calibration"]["unknowns"] = {
            name.replace("torque_constant[joint3]", "torque_constant[elbow]"): entry
            for name, entry in unknowns.items()
        }

    with pytest.raises(RobotError, match="is of elbow, but open_manipulator_x drives"):
        load_robot(edited(written, foreign))


def test_fingers_have_no_zero_and_held_joints_nothing_else(tmp_path: Path) -> None:
    """What `proprio calibrate` leaves out is not missed."""
    names = {"joint3": "gripper_left_joint", "link5": "link5"}
    whole = small().without({("zero", "joint3")})
    keys = tuple(
        key if isinstance(key, str) else (key[0], names[str(key[1])]) for key in whole.keys
    )
    path = tmp_path / "fingers.yaml"
    write_calibration(path, load_robot("open_manipulator_x"), replace(whole, keys=keys))
    assert load_robot(path).calibration.joints == ("gripper_left_joint",)
    held = small().without({key for key in small().keys if key[0] != "zero"})
    write_calibration(path, load_robot("open_manipulator_x"), held)
    assert load_robot(path).calibration.names == ("zero[joint3]",)


def test_another_urdf_is_refused(tmp_path: Path) -> None:
    urdf = tmp_path / "arm.urdf"
    shutil.copy(resource("urdf", "open_manipulator_x.urdf"), urdf)
    own = tmp_path / "own.yaml"
    own.write_text("extends: open_manipulator_x\nurdf: arm.urdf\n")
    path = tmp_path / "calibrated.yaml"
    write_calibration(path, load_robot(own), small())
    assert load_robot(path).is_calibrated()
    urdf.write_text(urdf.read_text().replace('mass value="0.14327573"', 'mass value="0.15"'))
    with pytest.raises(RobotError, match="was made with another URDF"):
        load_robot(path)


def test_calibration_and_robot_must_belong_together(written: Path) -> None:
    assert (
        robot_of(Options(robot="open_manipulator_x", calibration=written)).calibration is not None
    )
    assert robot_of(Options(calibration=written)).calibration is not None
    with pytest.raises(RobotError, match="whose URDF is not that of --robot pendulum"):
        robot_of(Options(robot="pendulum", calibration=written))
    with pytest.raises(RobotError, match="holds no calibration"):
        robot_of(Options(calibration=resource("robots", "pendulum")))
    with pytest.raises(RobotError, match="expected the"):
        robot_of(Options(calibration="open_manipulator_x"))


@pytest.mark.long
def test_from_bags_to_a_mass_by_the_command_line(
    bags: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What the README shows: sixteen runs, three with a reference, one file, one weighing."""
    path = tmp_path / "arm.yaml"
    empty = [str(folder / "bag_mcap") for folder in sorted(bags.glob("realistic_s00_empty_*"))]
    weights = [
        f"{folder / 'bag_mcap'}=0.1"
        for folder in sorted(bags.glob("realistic_s00_fixed_reference_*"))
    ]
    place = ["--set", "payload.shape=sphere", "--set", "payload.size=0.0272"]
    assert (
        main(
            ["calibrate", *empty, "--reference", *weights, *place, "--output", str(path), "--json"]
        )
        == 0
    )
    told = json.loads(capsys.readouterr().out)
    assert told["verdict"] == "accepted" and told["runs"] == 19 and told["output"] == str(path)
    assert {"unknowns", "noise", "fit", "held_out", "not_separated", "advice", "timing_s"} <= set(
        told
    )
    assert len(told["held_out"]) == 19 and told["advice"][0]["start"].keys() >= {
        "joint2",
        "joint3",
        "joint4",
    }
    for name, mass in (
        ("light_ball_20g_joint3", 0.02), ("heavy_ball_50g_joint3", 0.05), ("heavy_cube_23g_joint3", 0.023),
        ("light_cube_10g_joint2", 0.01), ("light_cube_10g_joint3", 0.01),
    ):  # fmt: skip
        bag = str(bags / f"realistic_s00_fixed_{name}" / "bag_mcap")
        assert (
            main(["replay", bag, "--probe", "payload", "--calibration", str(path), "--json"]) == 0
        )
        result = json.loads(capsys.readouterr().out)
        (value,) = result["estimates"]
        assert abs(value["value"] - mass) < 1.5e-3 and value["ci95"][0] <= mass <= value["ci95"][1]
        assert not any("not been calibrated" in reason for reason in result["reasons"])


@pytest.mark.long
@pytest.mark.parametrize("stated_kg", [0.1, 0.12])
def test_a_reference_that_was_stated_wrong_is_told(
    bags: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    stated_kg: float,
) -> None:
    """All are 100 g."""
    empty = [str(folder / "bag_mcap") for folder in sorted(bags.glob("realistic_s00_empty_*"))]
    weights = [
        f"{folder / 'bag_mcap'}={stated_kg}"
        for folder in sorted(bags.glob("realistic_s00_fixed_reference_*"))
    ]
    place = ["--set", "payload.shape=sphere", "--set", "payload.size=0.0272"]
    words = [
        "calibrate",
        *empty,
        "--reference",
        *weights,
        *place,
        "--output",
        str(tmp_path / "arm.yaml"),
        "--json",
    ]
    assert main(words) == 0
    told = json.loads(capsys.readouterr().out)
    assert any("your reference says that all motors are" in note for note in told["notes"])
    about = [reason for reason in told["reasons"] if "your reference weighs" in reason]
    assert len(about) == (stated_kg != 0.1)
    if about:
        less_g = float(about[0].split("weighs ")[1].split(" g")[0])
        assert abs(less_g - 20.0) < 10.0 and "less than you stated: weigh it again" in about[0]


def test_what_was_stated_of_the_arm_is_carried_and_need_not_be_said_again(
    bags: Path, tmp_path: Path
) -> None:
    """A gripper that is not recorded, and the link in which objects are held; what a recording has is not replaced by it."""
    empty = [folder / "bag_mcap" for folder in sorted(bags.glob("realistic_s00_empty_0[0-5]_*"))]
    finger = "gripper_left_joint"
    stated = {"held.gripper_left_joint": 0.01, "payload.frame": "link5"}
    path = tmp_path / "arm.yaml"
    calibrate_from_bags(
        empty[:4],
        {},
        Options(settings=stated),
        path,
    )
    request = request_of(Options(calibration=path))
    assert request.robot.payload_frame == "link5" and request.robot.held == {finger: 0.01}
    assert (
        request_of(
            Options(calibration=path, settings={"payload.frame": "link4"})
        ).robot.payload_frame
        == "link4"
    )
    recording = bag_recording(empty[0], request)
    record = recording.joints
    (recorded,) = runs_or_motion(recording, request).runs
    assert recorded.held[finger] == pytest.approx(
        record.position[:, record.column(finger)].mean(), abs=1e-3
    )
    others = [column for column, name in enumerate(record.names) if name != finger]
    names = tuple(record.names[column] for column in others)
    without = replace(
        recording,
        joints=JointRecord(
            record.times_ns,
            names,
            record.position[:, others],
        ),
    )
    assert runs_or_motion(without, request).runs[0].held[finger] == 0.01
    now = replace(request, locked={finger: 0.005})
    assert runs_or_motion(without, now).runs[0].held[finger] == 0.005
    # what is brought up to date keeps it, and takes what is stated then
    newer = tmp_path / "newer.yaml"
    refresh_from_bags(
        empty[4:],
        Options(calibration=path, settings={"held.joint1": 0.2}),
        newer,
    )
    brought = robot_of(Options(calibration=newer))
    assert brought.held == {finger: 0.01, "joint1": 0.2} and brought.payload_frame == "link5"
    path.write_text(path.read_text().replace(f"{finger}: 0.01", "thumb: 0.01"))
    with pytest.raises(RobotError, match="thumb"):
        robot_of(Options(calibration=path))


def test_the_same_numbers_from_the_same_bags(bags: Path) -> None:
    empty = [folder / "bag_mcap" for folder in sorted(bags.glob("realistic_s00_empty_0[0-5]_*"))]
    one, other = (calibrate_from_bags(empty, {}).calibration for _ in range(2))
    assert np.array_equal(one.values, other.values) and np.array_equal(
        one.covariance, other.covariance
    )


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "no recording given"),
        (["{bag}", "--reference", "{bag}"], "write BAG=KG"),
        (["{bag}", "--reference", "{bag}=100"], "masses are in kg"),
        (["{bag}", "--reference", "{bag}=-0.1"], "masses are in kg"),
        (["nowhere"], "no such bag"),
        (["{bag}", "--robot", "nobody"], "unknown robot"),
        (["{bag}", "--set", "payload.colour=red"], "payload.colour"),
    ],
)
def test_mistakes_get_one_line(
    bags: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    words: str,
) -> None:
    bag = str(bags / "realistic_s00_empty_03_joint3" / "bag_mcap")
    path = tmp_path / "arm.yaml"
    assert main(["calibrate", *(a.format(bag=bag) for a in arguments), "--output", str(path)]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1 and lines[0].startswith("proprio: ") and words in lines[0]
    assert not path.exists()


def test_the_output_is_checked_before_the_work(bags: Path, tmp_path: Path) -> None:
    bag = bags / "realistic_s00_empty_03_joint3" / "bag_mcap"
    with pytest.raises(ConfigurationError, match="does not exist or is not writable"):
        calibrate_from_bags([bag], {}, output=tmp_path / "nowhere" / "arm.yaml")
    with pytest.raises(ConfigurationError, match=r"name a \.yaml file"):
        calibrate_from_bags([bag], {}, output=tmp_path / "arm.txt")


def test_an_older_file_stays_where_nothing_was_learnt(bags: Path, written: Path) -> None:
    before = written.read_text()
    stuck = bags / "friction_s00_fixed_random_a_joint3" / "bag_mcap"
    estimate = calibrate_from_bags(
        [stuck],
        {},
        output=written,
        force=True,
    )
    assert estimate.calibration is None and written.read_text() == before


@pytest.mark.long
def test_a_baseline_shows_drift(bags: Path, tmp_path: Path) -> None:
    path = tmp_path / "arm.yaml"
    calibrate_from_bags(
        [f / "bag_mcap" for f in sorted(bags.glob("realistic_s00_empty_*")) if "04" not in f.name],
        {},
        output=path,
    )
    bag = bags / "realistic_s00_fixed_light_ball_20g_joint3" / "bag_mcap"
    alone = replay([bag], Options(calibration=path))
    empty = bags / "realistic_s00_empty_04_joint3" / "bag_mcap"
    fine = replay(
        [bag],
        Options(calibration=path, baseline=(empty,)),
    )
    a, b = (estimate.value("payload_mass") for estimate in (alone, fine))
    assert (
        fine.verdict.value == "accepted"
        and abs(a.value - b.value) < a.std
        and b.std <= 1.02 * a.std
    )
    loaded = bags / "realistic_s00_fixed_light_cube_10g_joint3" / "bag_mcap"
    drifted = replay(
        [bag],
        Options(calibration=path, baseline=(loaded,)),
    )
    assert drifted.verdict.value == "rejected" and drifted.value("payload_mass").value is None
    found = re.match(r"drift: the empty hand now weighs \+([0-9.]+) g", drifted.reasons[0])
    assert found is not None and abs(float(found[1]) - 10.0) < 2.0
    assert "calibrate again" in drifted.reasons[0]


def test_an_older_file_is_replaced_only_when_that_is_asked_for(
    bags: Path, written: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = written.read_text()
    nowhere = ["calibrate", "nowhere", "--output", str(written)]
    assert main(nowhere) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "the file exists; --force replaces it" in line and written.read_text() == before
    # then the work begins
    assert main([*nowhere, "--force"]) == 2 and "no such bag" in capsys.readouterr().err
    with pytest.raises(ConfigurationError, match="the file exists"):
        calibrate(["nowhere"], output=written)
    empty = [folder / "bag_mcap" for folder in sorted(bags.glob("realistic_s00_empty_0[0-5]_*"))]
    assert calibrate(empty, output=written, force=True).accepted and written.read_text() != before


@pytest.mark.long
def test_what_it_weighs_is_said_first(
    bags: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "arm.yaml"
    page = tmp_path / "arm.html"
    empty = [str(folder / "bag_mcap") for folder in sorted(bags.glob("realistic_s00_empty_*"))]
    assert main(["calibrate", *empty, "--output", str(path), "--report", str(page)]) == 0
    headline = capsys.readouterr().out.splitlines()[1].strip()
    assert headline.startswith("weighs 20 g to +-1.")
    assert headline in path.read_text().splitlines()[1] and headline in page.read_text()
    # as the bags say that were weighed with it: none is nearer than what the best runs promise together
    estimate = calibrate(empty).estimate
    assert estimate.weighable is not None and headline == estimate.weighable.sentence()
    joints = estimate.as_json()["can_weigh"]["joints"]
    assert "joint2" in joints
    assert headline.endswith(f"g (95 %) with {' and '.join(joints)}")
    ball = replay(
        [bags / "realistic_s00_fixed_light_ball_20g_joint3" / "bag_mcap"], Options(calibration=path)
    ).value("payload_mass")
    assert 0.3 * ball.std < estimate.weighable.std_kg < 1.2 * ball.std


def test_runs_that_separate_nothing_give_no_file(bags: Path, tmp_path: Path) -> None:
    """One run, and lifts only: torque and friction are one number. With 20 g in the hand that has even read 1.9 g for 23."""
    path = tmp_path / "arm.yaml"
    ball = bags / "realistic_s00_fixed_light_ball_20g_joint3" / "bag_mcap"
    lifts = [folder / "bag_mcap" for folder in sorted(bags.glob("realistic_s00_empty_0[0-2]_*"))]
    for given, code in (([ball], "one_run"), (lifts[:1], "one_run"), (lifts, "not_separated")):
        estimate = calibrate_from_bags(given, {}, output=path)
        assert (
            estimate.verdict.value == "not_identifiable"
            and estimate.reasons[0].code == code
            and not path.exists()
        )
        assert any(
            "add a run in which it moves in the positive direction" in reason
            for reason in estimate.reasons
        )
        assert {plan.joint for plan in estimate.advice} == {"joint3"} and min(
            p.travel[0] for p in estimate.advice
        ) > 0.0


def test_a_joint_that_was_not_separated_stays_uncalibrated(bags: Path, tmp_path: Path) -> None:
    path = tmp_path / "arm.yaml"
    given = [folder / "bag_mcap" for folder in sorted(bags.glob("realistic_s00_empty_0[0-8]_*"))]
    estimate = calibrate_from_bags(given, {}, output=path)
    assert (
        estimate.verdict.value == "accepted" and "joint2 stays uncalibrated" in estimate.reasons[0]
    )
    assert load_robot(path).is_calibrated(["joint3"]) and not load_robot(path).is_calibrated(
        ["joint2"]
    )
    shoulder = replay(
        [bags / "realistic_s00_fixed_light_cube_10g_joint2" / "bag_mcap"], Options(calibration=path)
    )
    assert "not_calibrated" in [getattr(reason, "code", "") for reason in shoulder.reasons]


def test_a_recording_is_either_empty_or_the_reference(bags: Path) -> None:
    bag = bags / "realistic_s00_empty_00_joint3" / "bag_mcap"
    for paths, references in (
        ([bag, bag], {}),
        ([bag], {bag: 0.1}),
        ([bag], {bag / ".." / "bag_mcap": 0.1}),
    ):
        with pytest.raises(ConfigurationError, match=r"was given twice|are the same recording"):
            calibrate_from_bags(paths, references)
    with pytest.raises(ConfigurationError, match="given twice"):
        calibrate_from_bags([], {str(bag): 0.1, f"{bag}/": 0.2})
