"""Which arm of a robot holds something: hands that are found or asked for, joints that are driven, and those that are only read."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from support.small_urdf import chain, joint, link
from support.two_arms import ARM, HEAD, TORSO, WHEELS, write_urdf

from proprio_ros.cli import main
from proprio_ros.errors import RobotError
from proprio_ros.robot import load_robot, with_recorded_torque
from proprio_ros.robot.description import read_model
from proprio_ros.robot.hands import arm_joints, hand_link, hands, path_to, tip_of
from proprio_ros.robot.tree import RobotModel

LEFT = tuple(f"left_{name}" for name in ARM)


def fixed(parent: str, child: str) -> str:
    return joint(f"to_{child}", parent, child, kind="fixed")


def model_of(*joints: str) -> RobotModel:
    links = ["base", *(text.split('<child link="')[1].split('"')[0] for text in joints)]
    return RobotModel.from_urdf_string(chain(*joints, links="".join(map(link, links))))


def limb(name: str, start: str, count: int) -> list[str]:
    """Joints one behind the other."""
    ends = [start, *(f"{name}_link{number}" for number in range(1, count + 1))]
    return [joint(f"{name}_{number}", ends[number], ends[number + 1]) for number in range(count)]


@pytest.fixture(scope="module")
def two_arms(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_urdf(tmp_path_factory.mktemp("two_arms"))


def test_two_arms_are_found_and_each_has_its_joints(two_arms: Path) -> None:
    model = read_model(str(two_arms))
    assert hands(model) == ("left_tool0", "right_tool0"), "neither head nor wheels"
    assert arm_joints(model, "left_tool0") == LEFT
    assert path_to(model, "left_tool0") == (*TORSO, *LEFT), "the torso carries it"
    assert hand_link(model, "left_arm_7_link") == "left_tool0", "never the camera"
    assert hand_link(model, "left_finger_link") == "left_tool0", "nor a finger"


def test_without_a_tip_one_line_asks_which_hand(
    two_arms: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "new.yaml"
    assert main(["robot", "new", str(two_arms), "--output", str(output)]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "several hands: left_tool0, right_tool0" in said
    assert "--tip left_tool0" in said and not output.exists()
    with pytest.raises(RobotError, match=r"--set robot\.tip=left_tool0"):
        load_robot(two_arms)


def test_the_file_asks_for_constants_of_that_arm_alone(
    two_arms: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "new.yaml"
    words = ["robot", "new", str(two_arms), "--tip", "left_tool0", "--output", str(output)]
    assert main([*words, "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert tuple(said["joints"]) == LEFT and said["tip"] == said["payload_frame"] == "left_tool0"
    assert len(said["to_state"]) == len(LEFT)
    assert {*TORSO, *HEAD, *WHEELS, "right_arm_1_joint"} < set(said["only_read"])
    assert "the arm and more is carried by torso_lift_joint" in output.read_text()
    text = output.read_text().replace("A: null", "A: 2.0")
    output.write_text(text)
    assert tuple(load_robot(output).drive_trains) == LEFT


def test_one_file_of_all_joints_serves_either_hand(two_arms: Path, tmp_path: Path) -> None:
    """Nor does a URDF alone want constants of joints beside the arm, also where torque was recorded."""
    path = tmp_path / "both.yaml"
    motor = "{motor: {nominal_torque_constant_N_m_per_A: 2.0}}"
    joints = (*TORSO[1:], *LEFT, *(name.replace("left", "right") for name in LEFT), *HEAD)
    lines = [f"name: both\nurdf: {two_arms}\npayload_frame: left_tool0\ntip: left_tool0\njoints:"]
    path.write_text("\n".join([*lines, *(f"  {name}: {motor}" for name in joints)]) + "\n")
    assert tuple(load_robot(path).drive_trains) == (*TORSO[1:], *LEFT), "a torso that is stated is driven"  # fmt: skip
    right = load_robot(path, {"tip": "right_tool0", "payload_frame": "right_tool0"})
    assert not set(right.drive_trains) & set(LEFT) and right.tip == "right_tool0"
    with pytest.raises(RobotError, match=r"left_tool0 is not moved .* state right_tool0"):
        load_robot(path, {"tip": "right_tool0"})
    with pytest.raises(RobotError, match="no link 'hand'; its hands: left_tool0, right_tool0"):
        load_robot(path, {"tip": "hand"})
    bare = load_robot(two_arms, with_recorded_torque(two_arms, {"tip": "right_tool0"}))
    assert set(bare.drive_trains) == set(right.drive_trains) - set(TORSO)


def test_where_objects_are_held_says_which_of_two_hands_is_meant(
    two_arms: Path, tmp_path: Path
) -> None:
    """As a file of before there were tips has it, whose joints count as they are stated."""
    path = tmp_path / "both.yaml"
    motor = "{motor: {nominal_torque_constant_N_m_per_A: 2.0}}"
    joints = (*TORSO[1:], *LEFT, *HEAD)
    lines = [f"extends: {two_arms}\npayload_frame: left_tool0\njoints:"]
    path.write_text("\n".join([*lines, *(f"  {name}: {motor}" for name in joints)]) + "\n")
    assert set(HEAD) <= set(load_robot(path).drive_trains)
    stated = {"payload_frame": "right_tool0"}
    bare = load_robot(two_arms, with_recorded_torque(two_arms, stated) | stated)
    assert not set(bare.drive_trains) & set(LEFT)


def test_an_arm_on_wheels_with_a_head_is_found_by_itself() -> None:
    wheels = [joint(f"wheel_{n}", "base", f"wheel{n}") for n in range(2)]
    torso = [joint("lift", "base", "torso", kind="prismatic"), *limb("head", "torso", 2)]
    model = model_of(*wheels, *torso, *limb("arm", "torso", 5), fixed("arm_link5", "tool0"))
    assert tip_of(model) == "tool0"
    assert arm_joints(model, "tool0") == tuple(f"arm_{number}" for number in range(5))
    assert tip_of(model_of(*limb("arm", "base", 5))) is None, "nothing is beside a plain arm"


def test_legs_are_no_hands_unless_there_is_nothing_else() -> None:
    legs = [each for name in ("lf_leg", "rf_leg") for each in limb(name, "base", 6)]
    assert hands(model_of(*legs, *limb("arm", "base", 6))) == ("arm_link6",)
    assert hands(model_of(*legs)) == ("lf_leg_link6", "rf_leg_link6")


def test_a_hand_with_many_fingers_is_one_hand() -> None:
    fingers = [each for name in ("index", "thumb", "little") for each in limb(name, "palm", 3)]
    model = model_of(*limb("arm", "base", 6), fixed("arm_link6", "palm"), *fingers)
    assert hands(model) == ("palm",) and len(arm_joints(model, "palm")) == 6


PAN = [joint("camera_pan", "arm_link{n}", "camera_link")]
PAN_AND_TILT = [
    joint("pan", "arm_link{n}", "pan_link"),
    joint("tilt", "pan_link", "tilt_link"),
    fixed("tilt_link", "realsense_depth_frame"),
]
REEL = [joint("hose_reel", "arm_link{n}", "reel")]
"""Two joints before the hand, nothing but its name would tell it from a finger."""


@pytest.mark.parametrize(
    ("beside", "place"),
    [
        *((each, place) for each in (PAN, PAN_AND_TILT) for place in (1, 2, 3, 4)),
        *((REEL, place) for place in (1, 2, 3)),
    ],
)
def test_something_that_turns_on_the_arm_is_not_its_hand(beside: list[str], place: int) -> None:
    """A camera on the elbow was taken for where the hand branches off."""
    hung = [text.replace("{n}", str(place)) for text in beside]
    for tool in ([fixed("arm_link6", "tool0")], []):
        model = model_of(*limb("arm", "base", 6), *hung, *tool)
        hand = "tool0" if tool else "arm_link6"
        assert hands(model) == (hand,) and hand_link(model) == hand
        # a torso carries a head that pans and tilts, too, and is only read
        first = place if "tilt" in hung[-1] and place < 3 else 0
        assert arm_joints(model, hand) == tuple(f"arm_{number}" for number in range(first, 6))


def test_a_camera_that_turns_on_the_hand_is_not_the_hand() -> None:
    camera = joint("camera_tilt", "arm_link6", "camera_mount")
    assert hand_link(model_of(*limb("arm", "base", 6), camera)) == "arm_link6"


def test_a_gantry_ends_at_its_last_slide() -> None:
    slides = [joint(name, parent, child, kind="prismatic") for name, parent, child in
              (("x", "base", "bridge"), ("y", "bridge", "trolley"), ("z", "trolley", "quill"))]  # fmt: skip
    model = model_of(*slides)
    assert hand_link(model) == "quill" and arm_joints(model, "quill") == ("x", "y", "z")


def test_what_stands_beside_the_arm_may_be_anywhere(two_arms: Path) -> None:
    """Only what carries the arm, or is carried by it, must be known."""
    model = read_model(str(two_arms))
    needed = {**dict.fromkeys(TORSO, 0.1), "left_finger_joint": 0.01}
    reduced = model.lock(LEFT, needed)
    elsewhere = {name: 0.7 for name in model.independent_joints if name not in needed}
    other = model.lock(LEFT, {**needed, **elsewhere})
    assert (reduced.pseudo_inertia == other.pseudo_inertia).all()
    assert (reduced.placement == other.placement).all()
    for name in needed:
        with pytest.raises(RobotError, match=f"no position of joint '{name}'"):
            model.lock(LEFT, {key: at for key, at in needed.items() if key != name})


def test_what_carries_an_arm_and_what_is_beside_it(two_arms: Path) -> None:
    model = read_model(str(two_arms))
    assert model.carriers(LEFT) == TORSO, "all of the arm stands on these"
    assert model.carriers(LEFT[1:]) == (*TORSO, LEFT[0])
    assert model.carriers([*LEFT, "right_arm_1_joint"]) == TORSO
    beside = model.beside(LEFT)
    assert {*HEAD, *WHEELS, "right_arm_1_joint", "right_finger_joint"} <= beside
    assert not beside & {*TORSO, *LEFT, "left_finger_joint"}
    follower = joint("follower", "two", "top", mimic='<mimic joint="one"/>')
    lift = [joint("one", "base", "two", kind="prismatic"), follower]
    model = model_of(*lift, *limb("arm", "top", 4))
    assert model.carriers(["arm_1"]) == ("arm_0",), "no lift of two stages"
