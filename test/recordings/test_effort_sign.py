"""Efforts that are counted the other way round: turned where it is stated, and never accepted where it is not or is wrong."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.arm_in_motion import SIX, Twin, write_robot
from support.bends.messages import Bend, bent, of_joint_states

from proprio_ros.cli import main
from proprio_ros.errors import ConfigurationError, RobotError
from proprio_ros.identification.estimate import Verdict
from proprio_ros.identification.regression.motion_estimate import calibrate_motions
from proprio_ros.live.session import as_parameters, replay_command
from proprio_ros.pipeline import api
from proprio_ros.pipeline.loading import bag_recording
from proprio_ros.pipeline.request import Options, request_of
from proprio_ros.probes.payload.moving import identify_in_motion
from proprio_ros.recordings.drivers import load_driver
from proprio_ros.recordings.effort import effort_sign_option
from proprio_ros.recordings.motions import Motion
from proprio_ros.robot import Robot, load_robot
from proprio_ros.sim.payload import PayloadFacts

ROOT = Path(__file__).resolve().parents[2]
REAL = ROOT.parent / "shared" / "recordings_real"
PUSH = ROOT / "bags" / "quantised_s00_fixed_heavy_ball_50g_joint3" / "bag_mcap"
LIFT = "j2"
Pair = tuple[Motion, Motion]
needs_gen3 = pytest.mark.skipif(
    not (REAL / "gen3_as_published_2").exists(),
    reason="needs the real recordings",
)
needs_ar5 = pytest.mark.skipif(
    not (REAL / "ar5_side_mounted_1").exists(),
    reason="needs the real recordings",
)


def other_way(joints: Sequence[str] = ()) -> Bend:
    """Efforts of all joints, or of some, times -1."""

    def turn(message: Any) -> None:
        turned = np.array([not joints or name in joints for name in message.name])
        signs = np.where(turned, -1.0, 1.0)
        message.effort = signs * np.asarray(message.effort)

    return of_joint_states(turn)


# --- where it is stated, and that it is the same there ----------------------------------------------------------------


def efforts(bag: Path, options: Options) -> np.ndarray:
    record = bag_recording(bag, request_of(options)).joints
    assert record.effort is not None and record.reported_effort is not None
    assert record.current is not None
    assert np.array_equal(record.effort, record.reported_effort, equal_nan=True)
    return np.concatenate([record.effort, record.current], axis=1)


@pytest.mark.parametrize("joints", [(), ("joint3",)])
def test_stated_anywhere_it_is_the_recording_as_it_should_be(
    tmp_path: Path, joints: tuple[str, ...]
) -> None:
    right = efforts(PUSH, Options(effort_unit="N.m"))
    bag = bent(tmp_path / "bag", other_way(joints), PUSH)
    assert not np.array_equal(efforts(bag, Options(effort_unit="N.m")), right, equal_nan=True)
    stated = "{joint3: -1}" if joints else "-1"
    profile = tmp_path / "mine.yaml"
    profile.write_text(f"extends: proprio\neffort_sign: {stated}\n")
    file = tmp_path / "arm.yaml"
    file.write_text(f"extends: open_manipulator_x\neffort_sign: {stated}\n")
    for options in (
        Options(effort_unit="N.m", effort_sign="joint3=-1" if joints else "-1"),
        Options(driver=profile),
        Options(robot=str(file), effort_unit="N.m"),
        Options(
            effort_unit="N.m", settings={"robot.effort_sign": {"joint3": -1} if joints else -1}
        ),
    ):
        assert np.array_equal(efforts(bag, options), right, equal_nan=True)
    asked = Options(driver=profile, effort_sign="1")
    assert np.array_equal(efforts(PUSH, asked), right, equal_nan=True)
    notes = bag_recording(bag, request_of(Options(driver=profile))).notes
    which = "joint3" if joints else "all joints"
    assert f"the effort of {which} was multiplied by -1, as effort_sign states" in notes


def test_what_is_no_sign_or_of_no_joint_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for stated, said in (("2", "expected 1 or -1"), ("joint33=-1", "no joint 'joint33'; it has")):
        asked = ["check", str(PUSH), "--effort-sign", stated]
        assert main(asked) == 2
        error = capsys.readouterr().err
        assert "--effort-sign" in error and said in error and error.count("\n") == 1
    with pytest.raises(ConfigurationError, match="effort_sign: expected 1 or -1"):
        api.check(PUSH, effort_sign=3)
    file = tmp_path / "arm.yaml"
    file.write_text("extends: open_manipulator_x\neffort_sign: {joint33: -1}\n")
    with pytest.raises(RobotError, match=r"effort_sign: .* has no joint 'joint33'"):
        load_robot(file)
    profile = tmp_path / "mine.yaml"
    profile.write_text("extends: proprio\neffort_sign: down\n")
    with pytest.raises(ConfigurationError, match="effort_sign: expected 1 or -1"):
        load_driver(profile)


def test_live_it_is_a_parameter_and_stands_in_the_command_that_gives_the_answer_again() -> None:
    command = replay_command(Path("bag"), Options(effort_sign="joint3=-1"))
    assert "--effort-sign joint3=-1" in command
    assert as_parameters("state --effort-sign -1") == "state the parameter effort_sign -1"


@pytest.mark.parametrize(
    ("wrong", "turned", "option"),
    [
        (("a", "b", "c"), (), "-1"),
        (("a", "b", "c"), ("a", "b", "c"), "1"),
        (("b",), (), "b=-1"),
        (("b",), ("b",), "1"),
        (("b",), ("a", "b", "c"), "-1,b=1"),
        (("b",), ("a",), "-1,c=1"),
    ],
)
def test_the_option_states_all_that_should_hold(
    wrong: tuple[str, ...],
    turned: tuple[str, ...],
    option: str,
) -> None:
    assert effort_sign_option(("a", "b", "c"), wrong, turned) == f"--effort-sign {option}"


# --- a sign that the recording contradicts ----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    pytest.importorskip("mujoco")
    return load_robot(write_robot(tmp_path_factory.mktemp("arm")))


@pytest.fixture(scope="module")
def pair(robot: Robot) -> tuple[Motion, Motion]:
    """1.5 kg in the hand, and nothing, as another engine has it."""
    arm = Twin(5, SIX)
    held = (1.5, np.array([0.03, 0.0, 0.05]))
    return arm.record("loaded", 12.0, held), arm.record("empty", 15.0)


def reversed_of(motion: Motion, joints: tuple[str, ...]) -> Motion:
    turned = np.array([name in joints for name in motion.joints])
    signs = np.where(turned, -1.0, 1.0)
    return replace(motion, current_A=motion.current_A * signs)


@pytest.mark.parametrize("loaded", [True, False])
@pytest.mark.parametrize("empty", [True, False])
def test_a_wrong_sign_in_either_recording_is_refused(
    robot: Robot,
    pair: Pair,
    loaded: bool,
    empty: bool,
) -> None:
    """``loaded`` and ``empty``: whether that recording has the right sign."""
    if loaded and empty:
        return  # another test's
    rights = (loaded, empty)
    seen = [
        motion if right else reversed_of(motion, motion.joints)
        for motion, right in zip(pair, rights, strict=True)
    ]
    answer = identify_in_motion(robot, seen[:1], seen[1:], PayloadFacts())
    assert answer.verdict is Verdict.REJECTED and answer.values[0].value is None
    assert "--effort-sign -1" in " ".join(answer.reasons) or "-0." in answer.reasons[0]


@pytest.mark.parametrize("loaded", [True, False])
def test_one_joint_of_wrong_sign_misleads_nobody(robot: Robot, pair: Pair, loaded: bool) -> None:
    """In the empty recording alone, and in both: the joint counts for nothing, and what the others say holds."""
    with_load, empty = pair
    seen = with_load if loaded else reversed_of(with_load, (LIFT,))
    also = reversed_of(empty, (LIFT,))
    answer = identify_in_motion(robot, [seen], [also], PayloadFacts())
    if answer.verdict is Verdict.ACCEPTED:
        low, high = answer.values[0].ci95
        assert low < 1.5 < high
    if not loaded:
        assert f"--effort-sign {LIFT}=-1" in " ".join((*answer.reasons, *answer.notes))


def test_the_right_sign_is_accepted_and_one_that_was_stated_wrongly_can_be_undone(
    robot: Robot, pair: Pair
) -> None:
    loaded, empty = pair
    answer = identify_in_motion(robot, [loaded], [empty], PayloadFacts())
    low, high = answer.values[0].ci95
    assert answer.verdict is Verdict.ACCEPTED and low < 1.5 < high
    turned = [
        replace(
            reversed_of(each, each.joints),
            turned=each.joints,
        )
        for each in pair
    ]
    answer = identify_in_motion(robot, turned[:1], turned[1:], PayloadFacts())
    assert answer.verdict is Verdict.REJECTED
    assert "--effort-sign 1 states it" in " ".join(answer.reasons)


def test_nothing_is_learnt_of_an_arm_by_a_wrong_sign(robot: Robot, pair: Pair) -> None:
    _, empty = pair
    learnt = calibrate_motions(robot, [reversed_of(empty, empty.joints)], [], None)
    assert learnt.verdict is Verdict.REJECTED
    assert "--effort-sign -1" in " ".join(learnt.reasons)


# --- real ones --------------------------------------------------------------------------------------------------------


@needs_gen3
@pytest.mark.parametrize("loaded", [2, 4])
def test_a_gen3_as_its_vendors_driver_publishes_it(
    capsys: pytest.CaptureFixture[str],
    loaded: int,
) -> None:
    """Nothing is held in either; with the sign that the profile undoes both were refused."""
    asked = ["replay", str(REAL / f"gen3_as_published_{loaded}"), "--probe", "payload"]
    asked += ["--baseline", str(REAL / f"gen3_as_published_{6 - loaded}")]
    asked += ["--robot", "gen3"]
    asked += ["--driver", "kortex", "--json"]
    assert main(asked) == 0
    answer = json.loads(capsys.readouterr().out)
    low, high = answer["estimates"][0]["ci95"]
    assert low <= 0.0 < high < 0.25
    assert main([*asked, "--effort-sign", "1"]) == 3
    reasons = " ".join(json.loads(capsys.readouterr().out)["reasons"])
    assert "--effort-sign -1 states it" in reasons


@needs_ar5
def test_an_arm_on_its_side_is_told_the_gravity_to_paste(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """With what the sentence says the torques are those of its URDF."""
    robot = str(tmp_path / "ar5.yaml")
    urdf = str(REAL / "models" / "ar5.urdf")
    assert main(["robot", "new", urdf, "--effort-unit", "N.m", "--output", robot]) == 0
    asked = ["check", str(REAL / "ar5_side_mounted_1"), "--robot", robot, "--effort-unit", "N.m"]
    capsys.readouterr()
    main([*asked, "--json"])
    (bag,) = json.loads(capsys.readouterr().out)["bags"]
    (sentence,) = [each["sentence"] for each in bag["findings"] if each["code"] == "unlike_urdf"]
    option = next(word for word in sentence.split() if word.startswith("robot.gravity="))
    main([*asked, "--json", "--set", option])
    (bag,) = json.loads(capsys.readouterr().out)["bags"]
    assert "unlike_urdf" not in {each["code"] for each in bag["findings"]}
    (unit,) = [each for each in bag["effort_units"] if each["unit"] == "N.m"]
    ratios = unit["ratio"].values()
    assert len(ratios) >= 4
    assert min(ratios) > 0.9 and max(ratios) < 1.15
