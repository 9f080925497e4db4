"""Robot files: the smallest one, those of the package, what they extend, and what users get wrong."""

from __future__ import annotations

import math
import sys
import types
from pathlib import Path

import numpy as np
import pytest
from support.small_urdf import INERTIAL, THREE, chain, joint, link

from proprio_ros.errors import RecordingError, RobotError
from proprio_ros.inputs.resources import resource_names
from proprio_ros.robot import load_robot, with_recorded_torque
from proprio_ros.robot.drives import Goal
from proprio_ros.robot.robot_file import bare_settings

MINIMAL = """\
name: arm
urdf: arm.urdf
payload_frame: two
joints:
  a:
    motor: {nominal_torque_constant_N_m_per_A: 2.0, encoder_resolution_rad: 0.001}
    drive_train:
      torque_constant_N_m_per_A: 2.0
      coulomb_N_m: {value: 0.1, std: 0.02}
      viscous_N_m_s_per_rad: 0.01
      load_friction: 0
      armature_kg_m2: 1e-2
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "arm.urdf").write_text(THREE)
    (tmp_path / "arm.yaml").write_text(MINIMAL)
    return tmp_path


def test_minimal_robot_file(folder: Path) -> None:
    robot = load_robot(folder / "arm.yaml")
    drive = robot.drive_trains["a"]
    assert (drive.coulomb.value, drive.coulomb.std) == (0.1, 0.02)
    assert (drive.armature.value, drive.armature.std) == (0.01, 0.0)
    assert (drive.load_friction.value, drive.zero.value, drive.transmission) == (0.0, 0.0, 1.0)
    assert drive.usable_velocity == math.inf
    assert robot.motors["a"].id is None
    assert (robot.delay.value, robot.arm_scale.value, robot.is_calibrated()) == (0.0, 1.0, False)
    np.testing.assert_array_equal(
        robot.gravity,
        [0.0, 0.0, -9.81],
    )
    assert robot.source == folder / "arm.yaml"


def test_relative_path_is_accepted(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    assert load_robot("arm.yaml").name == "arm"


@pytest.mark.parametrize("name", resource_names("robots"))
def test_robots_of_the_package_load(name: str) -> None:
    robot = load_robot(name)
    assert robot.payload_frame in [link.name for link in robot.model.links]
    assert set(robot.drive_trains) == set(robot.motors) <= set(robot.model.independent_joints)


def test_open_manipulator_states_what_is_uncertain() -> None:
    robot = load_robot("open_manipulator_x")
    assert [robot.motors[name].id for name in robot.drive_trains] == [11, 12, 13, 14, 15]
    for name, drive in robot.drive_trains.items():
        assert drive.coulomb.value == 0.0 < drive.coulomb.std, name
        assert drive.armature.std > 0.0 < drive.torque_constant.std, name
        assert drive.nominal_torque_constant == pytest.approx(4.1 / 2.3)
        assert drive.encoder_resolution == pytest.approx(2.0 * math.pi / 4096.0)
    assert robot.drive_trains["gripper_left_joint"].transmission == 0.01149
    assert robot.drive_trains["joint1"].transmission == 1.0
    assert not robot.is_calibrated()


BAD_FILES = {
    "unknown key": (
        "payload_frame: two",
        "payload_frame: two\npaylod: 1",
        "arm.yaml: unknown key 'paylod'; did you mean",
    ),
    "unknown motor key": (
        "{nominal",
        "{torque: 1, nominal",
        "joints: a: motor: unknown key 'torque'",
    ),
    "unknown quantity key": (
        "std: 0.02",
        "sdt: 0.02",
        "coulomb_N_m: unknown key 'sdt'; did you mean 'std'? valid keys: value, std",
    ),
    "missing value": ("{value: 0.1, std: 0.02}", "{std: 0.02}", "coulomb_N_m: value is missing"),
    "text for a number": (
        "load_friction: 0",
        "load_friction: little",
        "load_friction: expected a number, got 'little'",
    ),
    "truth for a number": (
        "load_friction: 0",
        "load_friction: yes",
        "load_friction: expected a number, got 'yes'",
    ),
    "NaN": (
        "load_friction: 0",
        "load_friction: .nan",
        "load_friction: expected a finite number, got nan",
    ),
    "negative std": (
        "std: 0.02",
        "std: -0.02",
        "coulomb_N_m: std: must not be negative, got -0.02",
    ),
    "negative friction": ("value: 0.1", "value: -0.1", "coulomb_N_m: value: must not be negative"),
    "zero torque constant": (
        "A: 2.0,",
        "A: 0.0,",
        "nominal_torque_constant_N_m_per_A: must be positive, got 0.0",
    ),
    "perfect encoder": (
        "0.001",
        "0, encoder_noise_rad: 0",
        "encoder_resolution_rad and encoder_noise_rad are both 0",
    ),
    "voltage without resistance": (
        "{nominal",
        "{supply_voltage_V: 12, nominal",
        "supply_voltage_V needs resistance_ohm",
    ),
    "bus id": (
        "{nominal",
        "{id: 300, nominal",
        "id: expected a whole number from 0 to 252, got 300",
    ),
    "transmission of a turning joint": (
        "    motor:",
        "    transmission_m_per_rad: 0.1\n    motor:",
        "is for a prismatic joint",
    ),
    "unknown joint": (
        "  a:",
        "  elbow:",
        "joints: arm has no joint 'elbow' that a motor could drive; choose from: a, b",
    ),
    "fixed joint": ("  a:", "  c:", "no joint 'c' that a motor could drive"),
    "unknown frame": (
        "frame: two",
        "frame: hand",
        "payload_frame: arm has no link 'hand'; links: base, one, two, three",
    ),
    "no frame": ("payload_frame: two\n", "", "arm.yaml: missing: payload_frame; state each"),
    "no urdf": ("urdf: arm.urdf\n", "", "arm.yaml: urdf is missing"),
    "urdf not there": ("arm.urdf", "leg.urdf", "urdf: there is no"),
    "flat gravity": (
        "name: arm",
        "name: arm\ngravity: [0, 9.81]",
        "gravity: expected three numbers [x, y, z], got [0, 9.81]",
    ),
    "gravity of nothing": (
        "name: arm",
        "name: arm\ngravity: [0, 0, 0]",
        "gravity: [0.0, 0.0, 0.0] m/s^2 is 0 long, and nothing is weighed by that: state which way is down",
    ),
    "gravity as a direction": (
        "name: arm",
        "name: arm\ngravity: [0, 0, -1]",
        "gravity: [0.0, 0.0, -1.0] m/s^2 is 1 long, and nothing is weighed by that: state which way is down",
    ),
    "calibrated": (
        "name: arm",
        "name: arm\ncalibrated: 1",
        "calibrated: expected true or false, got 1",
    ),
    "not YAML": ("name: arm", "name: [arm", "not YAML"),
    "key given twice": ("name: arm", "name: arm\nname: leg", "duplicate key"),
    "no mapping": (MINIMAL, "- 1", "arm.yaml: expected keys and values, got [1]"),
    "empty": (MINIMAL, "", "arm.yaml: expected keys and values, got None"),
    "joints is a list": (
        MINIMAL[MINIMAL.index("joints:") :],
        "joints: [a]",
        "joints: expected keys and values, got ['a']",
    ),
    "no joints": (
        MINIMAL[MINIMAL.index("joints:") :],
        "",
        "joints is missing or empty",
    ),
    "other URDF": ("name: arm", "name: arm\nmodel_fingerprint: abc", "was made with another URDF"),
    "extends nothing": ("name: arm", "extends: leg", "unknown robot 'leg'; known robots: "),
    "extends itself": (
        "name: arm",
        "extends: arm.yaml",
        "extend each other in a circle: arm.yaml -> arm.yaml",
    ),
}


@pytest.mark.parametrize(
    ("old", "new", "message"),
    BAD_FILES.values(),
    ids=BAD_FILES.keys(),
)
def test_bad_robot_file_is_refused_in_one_line(
    folder: Path, old: str, new: str, message: str
) -> None:
    assert old in MINIMAL
    (folder / "arm.yaml").write_text(MINIMAL.replace(old, new, 1))
    with pytest.raises(RobotError) as caught:
        load_robot(folder / "arm.yaml")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_wrong_robot_names_are_refused(folder: Path) -> None:
    with pytest.raises(
        RobotError, match=r"unknown robot 'scara'; known robots: .*open_manipulator_x.*pendulum"
    ):
        load_robot("scara")
    with pytest.raises(RobotError, match="there is no robot file"):
        load_robot(folder / "leg.yaml")
    with pytest.raises(RobotError, match="there is no URDF"):
        load_robot(folder / "leg.urdf")


def test_what_a_file_leaves_out_is_not_known_exactly(folder: Path) -> None:
    """The joint's effort limit is 1 N m, but holding two links of 1 kg at the axis takes nothing: friction is a part of 1 N m."""
    text = MINIMAL[: MINIMAL.index("    drive_train")]
    (folder / "arm.yaml").write_text(text)
    robot = load_robot(folder / "arm.yaml")
    drive = robot.drive_trains["a"]
    assert (drive.torque_constant.value, drive.torque_constant.std) == pytest.approx((2.0, 0.3))
    assert (drive.coulomb.std, drive.viscous.std, drive.armature.std) == pytest.approx(
        (0.1, 0.05, 0.01)
    )
    open_numbers = (drive.load_friction, drive.zero, drive.stribeck, robot.delay, robot.arm_scale)
    assert all(number.std > 0.0 for number in open_numbers)
    spreads = (
        robot.stamp_jitter_s,
        robot.onset_jitter_s,
        robot.torque_disturbance,
        robot.link_mass_std,
        robot.link_com_std,
    )
    assert all(spread > 0.0 for spread in (*spreads, robot.link_inertia_std, drive.encoder_noise))
    # null is left out, too: a new robot file has it where something must be stated
    (folder / "arm.yaml").write_text(MINIMAL.replace("1e-2", "null"))
    assert load_robot(folder / "arm.yaml").drive_trains["a"].armature.std == pytest.approx(0.01)


def test_the_pendulum_is_exact_because_its_file_says_so() -> None:
    robot = load_robot("pendulum")
    drive = robot.drive_trains["pivot"]
    numbers = (
        drive.torque_constant,
        drive.coulomb,
        drive.viscous,
        drive.load_friction,
        drive.armature,
        drive.zero,
    )
    assert all(
        number.std == 0.0 for number in (*numbers, drive.stribeck, robot.delay, robot.arm_scale)
    )
    spreads = (
        robot.stamp_jitter_s,
        robot.onset_jitter_s,
        robot.torque_disturbance,
        robot.link_mass_std,
        robot.link_com_std,
    )
    assert not any((*spreads, robot.link_inertia_std, drive.encoder_once_per_turn))


def test_all_that_is_missing_is_said_at_once(folder: Path) -> None:
    (folder / "arm.yaml").write_text(
        "name: arm\nurdf: arm.urdf\njoints: {a: {motor: {id: 1}}, b: null}\n"
    )
    with pytest.raises(RobotError) as caught:
        load_robot(folder / "arm.yaml")
    assert str(caught.value) == (
        "arm.yaml: missing: payload_frame; motor.nominal_torque_constant_N_m_per_A of a, b; state each, or leave out "
        "joints that nobody drives"
    )
    names = [f"joint_with_a_long_name_{n}" for n in range(9)]
    links = "".join(link(name) for name in ("base", *(f"l{n}" for n in range(9))))
    joints = [joint(name, "base", f"l{n}") for n, name in enumerate(names)]
    (folder / "arm.urdf").write_text(chain(*joints, links=links))
    with pytest.raises(RobotError) as caught:
        load_robot(folder / "arm.urdf")
    assert "joint_with_a_long_name_0, joint_with_a_long_name_1 and 7 more" in str(caught.value)
    assert "--effort-unit N.m" in str(caught.value) and " ... " not in str(caught.value)


def test_a_mistyped_key_is_not_called_missing(folder: Path) -> None:
    for old, new, meant in (
        ("payload_frame", "payload_fram", "payload_frame"),
        ("{nominal_t", "{nominl_t", "nominal_t"),
    ):
        (folder / "arm.yaml").write_text(MINIMAL.replace(old, new, 1))
        with pytest.raises(RobotError, match=f"did you mean '{meant}"):
            load_robot(folder / "arm.yaml")


def test_a_bare_urdf_is_a_robot_once_its_torque_constants_are_stated(folder: Path) -> None:
    stated = {
        f"joints.{name}.drive_train.torque_constant_N_m_per_A": {"value": 3.0, "std": 0.2}
        for name in "ab"
    }
    robot = load_robot(folder / "arm.urdf", stated)
    assert robot.drive_trains["b"].nominal_torque_constant == 3.0
    assert robot.drive_trains["b"].torque_constant.std == 0.2
    assert (robot.name, robot.payload_frame) == ("arm", "three")
    torque = load_robot(folder / "arm.urdf", with_recorded_torque(folder / "arm.urdf", {}))
    assert torque.drive_trains["a"].nominal_torque_constant == 1.0
    assert torque.drive_trains["a"].torque_constant.std == pytest.approx(0.1)
    # what is stated of a joint stands alone: torque over that constant is the current again
    mixed = with_recorded_torque(
        folder / "arm.urdf", {"joints.b.drive_train.torque_constant_N_m_per_A": 3.0}
    )
    drive = load_robot(folder / "arm.urdf", mixed).drive_trains["b"]
    assert (drive.nominal_torque_constant, drive.torque_constant.value) == (3.0, 3.0)
    # a calibration's file extends it like any other
    (folder / "mine.yaml").write_text(
        "extends: arm.urdf\njoints: {a: {motor: {nominal_torque_constant_N_m_per_A: 2}},"
        " b: {motor: {nominal_torque_constant_N_m_per_A: 2}}}\n"
    )
    assert load_robot(folder / "mine.yaml").drive_trains["a"].torque_constant.value == 2.0


def test_links_that_move_without_mass_are_named(folder: Path) -> None:
    links = link("base") + link("one", "") + link("two", "") + link("three", "")
    (folder / "arm.urdf").write_text(
        chain(
            joint("a"),
            joint("b", "base", "two"),
            joint("c", "two", "three"),
            links=links,
        )
    )
    with pytest.raises(
        RobotError, match=r"arm\.urdf: links one, two, three: <inertial> is missing; state mass"
    ):
        load_robot(folder / "arm.urdf")


def test_what_does_not_move_need_not_be_there(folder: Path) -> None:
    """Meshes of nowhere, simulators' blocks, transmissions and tool frames: as in any URDF of a real arm."""
    more = (
        '<gazebo reference="two"><material>Blue</material></gazebo>'
        '<transmission name="t"><type>x</type><joint name="a"/></transmission>'
    )
    mesh = '<visual><geometry><mesh filename="package://nowhere/two.dae"/></geometry></visual>'
    text = THREE.replace("</robot>", more + "</robot>").replace(
        '<link name="two">', f'<link name="two">{mesh}'
    )
    text = text.replace('<link name="three">' + INERTIAL, '<link name="three">')
    (folder / "arm.urdf").write_text(text)
    assert set(bare_settings(str(folder / "arm.urdf"))["joints"]) == {"a", "b"}


def test_descriptions_by_name(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as without:
        without.setitem(sys.modules, "robot_descriptions", None)
        with pytest.raises(RobotError, match="pip install robot_descriptions"):
            load_robot("robot_descriptions:arm")
    package = types.ModuleType("robot_descriptions")
    package.__path__ = []
    arm = types.ModuleType("robot_descriptions.arm_description")
    mjcf = types.ModuleType("only_mjcf")
    arm.URDF_PATH = str(folder / "arm.urdf")
    monkeypatch.setitem(sys.modules, "robot_descriptions", package)
    monkeypatch.setitem(sys.modules, "robot_descriptions.arm_description", arm)
    monkeypatch.setitem(sys.modules, "robot_descriptions.only_description", mjcf)
    (folder / "arm.yaml").write_text(MINIMAL.replace("arm.urdf", "robot_descriptions:arm"))
    assert load_robot(folder / "arm.yaml").model.independent_joints == ("a", "b")
    for name, words in (
        ("leg", "no such description"),
        ("only", "has no URDF"),
        ("os.path", "no name of a"),
    ):
        with pytest.raises(RobotError, match=words):
            load_robot(f"robot_descriptions:{name}")


def test_xacro_is_to_be_expanded(folder: Path) -> None:
    (folder / "arm.urdf.xacro").write_text(THREE)
    with pytest.raises(RobotError, match=r"expand it first: xacro .*arm\.urdf\.xacro > arm\.urdf"):
        load_robot(folder / "arm.urdf.xacro")


def test_sliding_joint_needs_its_transmission(folder: Path) -> None:
    (folder / "arm.urdf").write_text(THREE.replace("revolute", "prismatic", 1))
    with pytest.raises(RobotError, match=r"missing: transmission_m_per_rad .* of a; state"):
        load_robot(folder / "arm.yaml")
    (folder / "arm.yaml").write_text(MINIMAL + "    transmission_m_per_rad: 0.02\n")
    assert load_robot(folder / "arm.yaml").drive_trains["a"].transmission == 0.02


TRAVELS = "    transmission_m_per_rad: 0.012\n    finger_travel: {at_rad: %s, open_m: %s}\n"


def test_a_fingers_travel_as_measured(folder: Path) -> None:
    """A crank closes slower at its ends; the measurements' own curve comes back, and two of them are a straight line."""
    (folder / "arm.urdf").write_text(THREE.replace("revolute", "prismatic", 1))
    angle = np.linspace(-0.8, 1.2, 7)

    def crank(at: np.ndarray) -> np.ndarray:
        return 0.0125 * np.sin(at) + 0.003

    (folder / "arm.yaml").write_text(MINIMAL + TRAVELS % (angle.tolist(), crank(angle).tolist()))
    drive = load_robot(folder / "arm.yaml").drive_trains["a"]
    assert drive.finger_travel is not None and drive.transmission == 0.012
    np.testing.assert_allclose(
        drive.finger_travel.ratio_at(angle[1:-1]), 0.0125 * np.cos(angle[1:-1]), rtol=0.01
    )
    powers = angle[:, None] ** np.arange(1, 4)
    np.testing.assert_allclose(
        powers @ drive.travel_coefficients,
        crank(angle) - 0.003,
        atol=5e-5,
    )
    (folder / "arm.yaml").write_text(MINIMAL + TRAVELS % ([-0.5, 0.5], [0.001, 0.0125]))
    assert load_robot(folder / "arm.yaml").drive_trains["a"].travel_coefficients == pytest.approx(
        (0.0115, 0.0, 0.0)
    )
    (folder / "arm.yaml").write_text(MINIMAL + "    transmission_m_per_rad: 0.012\n")
    assert load_robot(folder / "arm.yaml").drive_trains["a"].travel_coefficients == (
        0.012,
        0.0,
        0.0,
    )


@pytest.mark.parametrize(
    ("at_rad", "open_m", "message"),
    [
        ([0.0, 1.0], [0.0, 12.0], "openings are in m, not mm"),
        ([0.0, 57.3], [0.0, 0.7], "angles are in rad, not degrees"),
        ([0.0, 0.5, 1.0], [0.0, 0.01], "3 angles and 2 openings"),
        ([0.0, 1.0, 0.5], [0.0, 0.01, 0.02], "expected rising numbers"),
        ([0.0], [0.0], "two or more numbers"),
        (
            [0.0, 1.0],
            [0.0, 0.03],
            "opens by 30 mm per rad of the motor, transmission_m_per_rad is 12 mm per rad",
        ),
        ([0.0, 0.1, 0.2, 1.0], [0.0, 0.006, 0.0061, 0.0062], "turns back in between"),
    ],
)
def test_a_fingers_travel_that_cannot_be(
    folder: Path,
    at_rad: list[float],
    open_m: list[float],
    message: str,
) -> None:
    (folder / "arm.urdf").write_text(THREE.replace("revolute", "prismatic", 1))
    (folder / "arm.yaml").write_text(MINIMAL + TRAVELS % (at_rad, open_m))
    with pytest.raises(RobotError) as caught:
        load_robot(folder / "arm.yaml")
    assert message in str(caught.value) and "\n" not in str(caught.value)


def test_extends_gives_only_what_differs(folder: Path) -> None:
    below = folder / "calibrations"
    below.mkdir()
    (below / "mine.yaml").write_text(
        "extends: ../arm.yaml\ncalibrated: true\njoints: {a: {drive_train: {coulomb_N_m: {std: 0.001}, load_friction: 0.1}}}\n"
    )
    robot = load_robot(below / "mine.yaml")
    base = load_robot(folder / "arm.yaml")
    drive = robot.drive_trains["a"]
    assert (drive.coulomb.value, drive.coulomb.std) == (0.1, 0.001)
    assert drive.load_friction.value == 0.1
    assert drive.viscous == base.drive_trains["a"].viscous
    assert robot.is_calibrated() and not base.is_calibrated()
    # the URDF is found beside the file that names it, not beside the one that extends it
    assert robot.model.fingerprint() == base.model.fingerprint()
    (below / "bound.yaml").write_text(
        f"extends: ../arm.yaml\nmodel_fingerprint: {base.model.fingerprint()}\n"
    )
    assert load_robot(below / "bound.yaml").name == "arm"


def test_overrides_by_dotted_keys(folder: Path) -> None:
    robot = load_robot(folder / "arm.yaml")
    changed = robot.with_overrides(
        {
            "joints.a.drive_train.coulomb_N_m": 0.05,
            "joints.a.motor.current_limit_A": 0.5,
            "joints.a.usable_velocity_rad_s": 2,
            "delay_s": {"value": 0.004, "std": 0.001},
            "payload_frame": "three",
            "gravity": [0.0, 0.0, -9.805],
        }
    )
    drive = changed.drive_trains["a"]
    assert (drive.coulomb.value, drive.coulomb.std) == (0.05, 0.0)
    assert (changed.motors["a"].current_limit_A, drive.usable_velocity) == (0.5, 2.0)
    assert (changed.delay.value, changed.delay.std) == (0.004, 0.001)
    assert changed.payload_frame == "three"
    assert changed.gravity[2] == -9.805
    assert robot.drive_trains["a"].coulomb.value == 0.1, "the original stays as it was"
    again = changed.with_overrides(
        {"joints.a.drive_train.coulomb_N_m": {"value": 0.06, "std": 0.01}}
    )
    assert (again.drive_trains["a"].coulomb.value, again.delay.value) == (0.06, 0.004)
    only_std = robot.with_overrides({"joints.a.drive_train.coulomb_N_m": {"std": 0.3}})
    assert (only_std.drive_trains["a"].coulomb.value, only_std.drive_trains["a"].coulomb.std) == (
        0.1,
        0.3,
    )


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("joints.a.drive_train.coulomb", 0.1, "did you mean 'joints.a.drive_train.coulomb_N_m'"),
        ("joints.z.drive_train.coulomb_N_m", 0.1, "where JOINT is one of a, b"),
        ("urdf", "other.urdf", "unknown robot setting 'urdf'"),
        ("joints.a.drive_train.coulomb_N_m", "much", "coulomb_N_m: expected a number, got 'much'"),
        ("joints.a.drive_train.coulomb_N_m", -0.1, "must not be negative"),
        ("payload_frame", "hand", "arm has no link 'hand'"),
        ("joints.b.motor.id", 3, "arm.yaml: missing: motor.nominal_torque_constant_N_m_per_A of b"),
    ],
)
def test_bad_overrides_are_refused(
    folder: Path,
    key: str,
    value: object,
    message: str,
) -> None:
    with pytest.raises(RobotError) as caught:
        load_robot(folder / "arm.yaml").with_overrides({key: value})
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_joint_names_with_dots_can_be_overridden(folder: Path) -> None:
    (folder / "arm.urdf").write_text(THREE.replace('name="a"', 'name="left.a"'))
    (folder / "arm.yaml").write_text(MINIMAL.replace("  a:", "  left.a:"))
    robot = load_robot(folder / "arm.yaml").with_overrides(
        {"joints.left.a.drive_train.load_friction": 0.02}
    )
    assert robot.drive_trains["left.a"].load_friction.value == 0.02


def test_goals_of_another_clock_are_refused() -> None:
    """One that was stamped decades away asked for terabytes."""
    goal = Goal(
        np.array([0.0, 1.0]),
        np.zeros(2),
    )
    assert goal.at(np.array([0.5, 2.0]), 1.0).shape == (2,)
    with pytest.raises(RecordingError, match="stamp both by one clock"):
        goal.at(
            np.array([0.5, 2.0**31]),
            1.0,
        )
