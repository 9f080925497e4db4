"""The robots of config/robots that others make: links where the makers' tables put them, and what real recordings say."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from support.machines import REAL, UR10E_N_M_PER_A
from support.moved_arm import record_arm

from proprio_ros.cli import main
from proprio_ros.inputs.resources import resource
from proprio_ros.pipeline.check import check_bags
from proprio_ros.pipeline.request import Options
from proprio_ros.recordings.drivers import load_driver
from proprio_ros.robot import load_robot
from proprio_ros.robot.drives import DutyCycle, PositionServo

# Universal Robots: d [m], a [m], alpha [rad], mass [kg] of each joint's link
UR10E_DH = (
    (0.1807, 0.0, np.pi / 2, 7.369),
    (0.0, -0.6127, 0.0, 13.051),
    (0.0, -0.57155, 0.0, 3.989),
    (0.17415, 0.0, np.pi / 2, 2.1),
    (0.11985, 0.0, -np.pi / 2, 1.98),
    (0.11655, 0.0, 0.0, 0.615),
)
UR5E_DH = (
    (0.1625, 0.0, np.pi / 2, 3.761),
    (0.0, -0.425, 0.0, 8.058),
    (0.0, -0.3922, 0.0, 2.846),
    (0.1333, 0.0, np.pi / 2, 1.37),
    (0.0997, 0.0, -np.pi / 2, 1.3),
    (0.0996, 0.0, 0.0, 0.365),
)


@pytest.mark.parametrize(("name", "table"), [("ur10e", UR10E_DH), ("ur5e", UR5E_DH)])
def test_a_ur_is_where_its_table_says(
    name: str,
    table: tuple[tuple[float, float, float, float], ...],
) -> None:
    robot = load_robot(name)
    random = np.random.default_rng(4)
    assert robot.model.independent_joints == tuple(UR10E_N_M_PER_A)
    for _ in range(5):
        angles = random.uniform(-3.0, 3.0, 6)
        expected = np.eye(4)
        for (d, a, alpha, _), theta in zip(table, angles, strict=True):
            (ct, st), (ca, sa) = (np.cos(theta), np.sin(theta)), (np.cos(alpha), np.sin(alpha))
            expected = expected @ np.array(
                [
                    [ct, -st * ca, st * sa, a * ct],
                    [st, ct * ca, -ct * sa, a * st],
                    [0, sa, ca, d],
                    [0, 0, 0, 1],
                ]
            )
        pose = dict(zip(robot.model.independent_joints, angles, strict=True))
        np.testing.assert_allclose(
            robot.model.frame_transform("tool0", pose),
            expected,
            atol=1e-5,
        )
    masses = [link.pseudo_inertia[3, 3] for link in robot.model.links if link.pseudo_inertia.any()]
    assert masses == [row[3] for row in table]


# Kinova, Gen3 user guide: alpha [rad], a [m], d [m], offset [rad] of each joint, after a frame turned over at the base
GEN3_DH = (
    (np.pi / 2, 0.0, -0.2848, 0.0),
    (np.pi / 2, 0.0, -0.0118, np.pi),
    (np.pi / 2, 0.0, -0.4208, np.pi),
    (np.pi / 2, 0.0, -0.0128, np.pi),
    (np.pi / 2, 0.0, -0.3143, np.pi),
    (np.pi / 2, 0.0, 0.0, np.pi),
    (np.pi, 0.0, -0.1674, np.pi),
)
# Franka Robotics, Denavit-Hartenberg parameters of Panda and FR3, in Craig's convention: a [m], d [m], alpha [rad]
FRANKA_DH = (
    (0.0, 0.333, 0.0),
    (0.0, 0.0, -np.pi / 2),
    (0.0, 0.316, np.pi / 2),
    (0.0825, 0.0, np.pi / 2),
    (-0.0825, 0.384, -np.pi / 2),
    (0.0, 0.0, np.pi / 2),
    (0.088, 0.0, np.pi / 2),
)


def _about_z(angle: float, along_m: float) -> np.ndarray:
    c = np.cos(angle)
    s = np.sin(angle)
    return np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, along_m], [0, 0, 0, 1]])


def _about_x(angle: float, along_m: float) -> np.ndarray:
    c = np.cos(angle)
    s = np.sin(angle)
    return np.array([[1, 0, 0, along_m], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1]])


@pytest.mark.parametrize("name", ["fr3", "panda"])
def test_a_franka_is_where_its_table_says(name: str) -> None:
    robot = load_robot(name)
    random = np.random.default_rng(5)
    for _ in range(5):
        angles = random.uniform(-2.0, 2.0, 7)
        expected = np.eye(4)
        for (a, d, alpha), theta in zip(FRANKA_DH, angles, strict=True):
            expected = expected @ _about_x(alpha, a) @ _about_z(theta, d)
        # the hand's manual: turned, its tip 103.4 mm before the flange
        expected = expected @ _about_z(-np.pi / 4, 0.107 + 0.1034)
        pose = dict(zip(robot.model.independent_joints, angles, strict=True))
        np.testing.assert_allclose(
            robot.model.frame_transform(robot.payload_frame, pose), expected, atol=1e-5
        )


def test_a_gen3_is_where_its_table_says() -> None:
    robot = load_robot("gen3")
    random = np.random.default_rng(6)
    for _ in range(5):
        angles = random.uniform(-2.0, 2.0, 7)
        expected = _about_x(np.pi, 0.0)
        for (alpha, a, d, offset), theta in zip(GEN3_DH, angles, strict=True):
            expected = expected @ _about_z(theta + offset, d) @ _about_x(alpha, a)
        pose = dict(zip(robot.model.independent_joints, angles, strict=True))
        # the table rounds to 0.1 mm, and leaves out 0.35 mm between the wrist's axes
        found = robot.model.frame_transform(robot.payload_frame, pose)
        np.testing.assert_allclose(
            found[:3, 3],
            expected[:3, 3],
            atol=1e-3,
        )
        np.testing.assert_allclose(
            found[:3, :3],
            expected[:3, :3],
            atol=1e-3,
        )


def test_the_torque_constants_of_urs_are_those_of_their_joints() -> None:
    """By the maker's table of largest torques an elbow of a UR10e is a shoulder of a UR5e; the wrists of a UR5e are in no table."""
    large = load_robot("ur10e").drive_trains
    small = load_robot("ur5e").drive_trains
    assert {joint: drive.torque_constant.value for joint, drive in large.items()} == UR10E_N_M_PER_A
    for joint in ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"):
        assert small[joint].torque_constant.value == UR10E_N_M_PER_A["elbow_joint"]
    assert (
        small["wrist_1_joint"].torque_constant.std
        > 0.2 * small["wrist_1_joint"].torque_constant.value
    )


@pytest.mark.skipif(not REAL.exists(), reason="needs the real recordings")
def test_the_ur10e_weighs_real_recordings(capsys: pytest.CaptureFixture[str]) -> None:
    """Nothing stated but robot and driver."""
    words = ["--robot", "ur10e", "--driver", "ur_current", "--probe", "payload"]
    assert (
        main(
            [
                "replay",
                str(REAL / "ur10e_loaded_14"),
                "--baseline",
                str(REAL / "ur10e_empty_15"),
                *words,
            ]
        )
        == 0
    )
    said = capsys.readouterr().out
    mass_g = float(said.split("payload_mass: ")[1].split(" g")[0])
    assert abs(mass_g - 2805.0) < 0.03 * 2805.0, said
    share = float(said.split("by its torques the arm weighs ")[1].split(" times")[0])
    assert abs(share - 1.0) < 0.05, "the links weigh what the table says"


@pytest.mark.parametrize(
    ("angles", "grasp_m"),
    [
        ([0.0] * 6, [0.3914, 0.0, 0.2265]),
        ([0.3, 0.4, -0.5, 0.6, 0.7, 0.0], [0.3913, -0.1144, 0.1463]),
    ],
)
def test_the_so101_is_where_its_makers_drew_it(
    angles: list[float],
    grasp_m: list[float],
) -> None:
    """Between the jaws, by the makers' own model."""
    robot = load_robot("so101")
    joints = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
    assert robot.model.independent_joints == joints
    pose = dict(zip(joints, angles, strict=True))
    np.testing.assert_allclose(
        robot.model.frame_transform("grasp_link", pose)[:3, 3], grasp_m, atol=5e-4
    )
    assert all(isinstance(drive.driven_by, PositionServo) for drive in robot.drive_trains.values())


@pytest.mark.parametrize(
    ("name", "angles", "hand_m", "mass_kg"),
    [
        # the heights of a description's meshes: elbow 0.3425, wrist 0.5585; then hand 0.1001 and tip 0.08; 6 kg with the gripper
        ("openarm", [0.0] * 8, [0.0, -0.0045, 0.7386], 6.02),
        # the elbow bends about y by a right angle: what lies above it points along x
        (
            "openarm",
            [0.0, 0.0, 0.0, np.pi / 2, 0.0, 0.0, 0.0, 0.0],
            [0.3961, -0.0045, 0.3425],
            6.02,
        ),
        # the maker's 560 g, and the places of its drawing, summed up
        ("omx_f", [0.0] * 6, [0.3129, -0.0016, 0.2107], 0.560),
        # joint4 bends down by a right angle
        ("omx_f", [0.0, 0.0, 0.0, np.pi / 2, 0.0, 0.0], [0.1923, -0.0016, 0.0900], 0.560),
        # KUKA's drawing: 360, 420, 400 and 126 mm; 29.9 kg
        ("iiwa14", [0.0] * 7, [0.0, 0.0, 1.306], 29.9),
        ("iiwa14", [0.0, 0.0, 0.0, -np.pi / 2, 0.0, 0.0, 0.0], [0.526, 0.0, 0.78], 29.9),
        # Trossen's home pose of the tip between the fingers; shoulder bent forward by a right angle; the sum of its links
        ("vx300s", [0.0] * 6, [0.536494, 0.0, 0.42705], 3.739),
        ("vx300s", [0.0, np.pi / 2, 0.0, 0.0, 0.0, 0.0], [0.3, 0.0, 0.12705 - 0.536494], 3.739),
        # the makers' data sheets: 17.8 kg of arm and 0.7 kg of hand; 8.2 kg
        (
            "fr3",
            [0.0, 0.0, 0.0, -np.pi / 2, 0.0, np.pi / 2, 0.0],
            [0.5545, 0.0, 0.6245 - 0.1034],
            18.6,
        ),
        ("gen3", [0.0] * 7, [0.0, -0.0249, 1.1873], 8.2),
    ],
)
def test_arms_are_where_their_makers_drew_them(
    name: str,
    angles: list[float],
    hand_m: list[float],
    mass_kg: float,
) -> None:
    robot = load_robot(name)
    pose = dict(zip(robot.model.independent_joints, angles, strict=True))
    np.testing.assert_allclose(
        robot.model.frame_transform(robot.payload_frame, pose)[:3, 3], hand_m, atol=5e-4
    )
    assert sum(link.pseudo_inertia[3, 3] for link in robot.model.links) == pytest.approx(
        mass_kg, rel=0.01
    )


def test_an_omx_f_is_driven_by_the_duty_cycle_of_two_kinds_of_servo() -> None:
    drives = load_robot("omx_f").drive_trains
    assert all(isinstance(drive.driven_by, DutyCycle) for drive in drives.values())
    full = np.array([885.0])
    for joint, volts, amperes, newton_metres in (
        ("joint2", 11.1, 1.3, 1.4),
        ("joint5", 5.0, 1.47, 0.52),
    ):
        drive = drives[joint]
        assert drive.driven_by is not None
        duty = drive.driven_by.duty(
            np.zeros(1),
            np.zeros(1),
            full,
            None,
            0.0,
        )
        np.testing.assert_allclose(duty, 1.0, atol=1e-4)
        # the e-manual's stalled motor: current to the winding, torque within what the file leaves open
        assert volts / drive.resistance_ohm == pytest.approx(amperes, rel=0.03)
        stalled = drive.torque_constant.value * amperes
        assert abs(stalled - newton_metres) < 2.0 * drive.torque_constant.std * amperes


@pytest.mark.parametrize(
    ("name", "driver", "unit"),
    [
        ("openarm", "openarm", "N.m"), ("ur5e", "ur_current", "A"), ("fr3", "franka", "N.m"), ("panda", "franka", "N.m"),
        ("iiwa14", "lbr", "N.m"), ("gen3", "kortex", "N.m"),
    ],
)  # fmt: skip
def test_a_ready_robot_reads_a_recording_of_its_driver(
    name: str, driver: str, unit: str, tmp_path: Path
) -> None:
    """Names of joints, topic and unit agree: MuJoCo's torque is what the robot's links need, in the driver's unit."""
    robot = load_robot(name)
    signs = load_driver(driver).effort_sign
    constants = {
        joint: signs.of(joint) * drive.torque_constant.value
        for joint, drive in robot.drive_trains.items()
    }
    middle = [0.0, -0.8, 0.9, 0.3, 0.2, 0.0, 0.0][: len(constants)]
    bag = record_arm(
        tmp_path / "bag",
        resource("urdf", name),
        constants,
        robot.payload_frame,
        0.0,
        1,
        seconds=12.0,
        middle=middle,
        friction_N_m=0.02,
    )
    _, (found,) = check_bags(
        [bag],
        Options(robot=name, driver=driver),
    )
    assert not found.problem and set(found.moves) == set(constants)
    ratios = {each.unit: each.ratio for each in found.effort_units}[unit]
    assert ratios and all(0.8 < ratio < 1.25 for ratio in ratios.values()), ratios


@pytest.mark.parametrize(
    ("name", "driver", "middle", "load_kg"),
    [
        ("fr3", "franka", [0.0, -0.5, 0.0, -2.0, 0.0, 1.6, 0.0], 1.0),
        ("gen3", "kortex", [0.0, 0.5, 0.0, 1.2, 0.0, 1.0, 0.0], 0.6),
        ("vx300s", "interbotix", [0.0, -0.3, 0.4, 0.2, 0.3, 0.0], 0.3),
    ],
)
def test_a_ready_robot_weighs(
    name: str,
    driver: str,
    middle: list[float],
    load_kg: float,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Against an empty recording, on an arm in MuJoCo whose links, friction, rotors and torque are not those of the file."""
    robot = load_robot(name)
    random = np.random.default_rng(8)
    per_unit = 1e-3 if driver == "interbotix" else 1.0  # mA
    signs = load_driver(driver).effort_sign
    per_joint = {joint: signs.of(joint) * per_unit for joint in robot.drive_trains}
    constants = {
        joint: per_joint[joint]
        * drive.torque_constant.value
        * (1.0 + 0.05 * random.standard_normal())
        for joint, drive in robot.drive_trains.items()
    }
    small = {"friction_N_m": 0.1, "rotor_kg_m2": 0.01} if driver == "interbotix" else {}
    bags = [
        record_arm(
            tmp_path / word,
            resource("urdf", name),
            constants,
            robot.payload_frame,
            load,
            seed,
            middle=middle,
            **small,
        )
        for word, load, seed in (("empty", 0.0, 1), ("loaded", load_kg, 2))
    ]
    words = ["--robot", name, "--driver", driver, "--probe", "payload", "--json"]
    assert main(["replay", str(bags[1]), "--baseline", str(bags[0]), *words]) == 0
    mass = json.loads(capsys.readouterr().out)["estimates"][0]
    low, high = mass["ci95"]
    assert mass["name"] == "payload_mass" and low < load_kg < high and high - low < 1.2 * load_kg, (
        mass
    )
