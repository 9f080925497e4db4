"""The robot model against MuJoCo, against closed forms, and against files that users get wrong."""

from __future__ import annotations

import math
import os
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from proprio_ros.errors import ConfigurationError, RobotError
from proprio_ros.resources import resource, resource_names, share_directory
from proprio_ros.robot import (
    JOINT_KINDS,
    ReducedModel,
    RobotModel,
    inertia_about_origin,
    load_robot,
    pseudo_inertia,
    rotation_from_rpy,
    transform,
)

REPOSITORY = Path(__file__).resolve().parents[1]
GRAVITY = np.array([0.7, -1.9, -9.4])  # not along an axis, so that no component can be lost


# ------------------------------------------------------------------------------ the reduced model's equations of motion


def series(
    reduced: ReducedModel, positions: np.ndarray, velocities: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """base_T_body of every body, its derivative by each position, and its second one by time at constant rates."""
    count = len(reduced.joint_names)
    pose = np.zeros((count, 4, 4))
    by_position = np.zeros((count, count, 4, 4))
    rate = np.zeros((count, 4, 4))
    bias = np.zeros((count, 4, 4))
    for i in range(count):
        x, y, z = reduced.axes[i]
        twist = np.zeros((4, 4))
        if reduced.kinds[i] == "prismatic":
            twist[:3, 3] = reduced.axes[i]
            moved = np.eye(4) + twist * positions[i]
        else:
            twist[:3, :3] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
            moved = np.eye(4) + math.sin(positions[i]) * twist + (1.0 - math.cos(positions[i])) * twist @ twist
        # exp(twist q) commutes with its twist: derivatives by time are moved @ twist * v and moved @ twist^2 * v^2
        local = reduced.placement[i] @ moved
        local_rate, local_bias = local @ twist * velocities[i], local @ twist @ twist * velocities[i] ** 2
        parent = reduced.parents[i]
        before, before_rate, before_bias = np.eye(4), np.zeros((4, 4)), np.zeros((4, 4))
        if parent >= 0:
            before, before_rate, before_bias = pose[parent], rate[parent], bias[parent]
            by_position[i] = by_position[parent] @ local
        pose[i] = before @ local
        rate[i] = before_rate @ local + before @ local_rate
        bias[i] = before_bias @ local + 2.0 * before_rate @ local_rate + before @ local_bias
        by_position[i, i] = pose[i] @ twist
    return pose, by_position, bias


def mass_matrix_and_bias(
    reduced: ReducedModel, positions: np.ndarray, velocities: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Lagrange's equations of ``T = 1/2 sum tr(X' P X'^T)`` and ``V = -sum g . X (h, m)``."""
    _, by_position, bias = series(reduced, positions, velocities)
    mass = np.einsum("biuv,bvw,bjuw->ij", by_position, reduced.pseudo_inertia, by_position)
    coriolis = np.einsum("biuv,bvw,buw->i", by_position, reduced.pseudo_inertia, bias)
    weight = np.einsum("biuv,bv,u->i", by_position[:, :, :3, :], reduced.pseudo_inertia[:, :, 3], reduced.gravity)
    return mass, coriolis - weight


# ---------------------------------------------------------------------------------------------------------- random URDF


def numbers(values: np.ndarray) -> str:
    return " ".join(repr(float(value)) for value in values)


def random_inertial(rng: np.random.Generator) -> str:
    second = np.diag(rng.uniform(0.0005, 0.01, 3))
    rotation = rotation_from_rpy(rng.uniform(-3.0, 3.0, 3))
    second = rotation @ second @ rotation.T
    inertia = np.trace(second) * np.eye(3) - second
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertia.tolist()
    return (
        f'<inertial><origin xyz="{numbers(rng.uniform(-0.2, 0.2, 3))}" rpy="{numbers(rng.uniform(-3.0, 3.0, 3))}"/>'
        f'<mass value="{numbers(rng.uniform(0.05, 2.0, 1))}"/>'
        f'<inertia ixx="{xx}" ixy="{xy}" ixz="{xz}" iyy="{yy}" iyz="{yz}" izz="{zz}"/></inertial>'
    )


def random_urdf(seed: int) -> tuple[str, int]:
    """A tree of one to seven moving joints, with fixed joints between and massless frames at the ends."""
    rng = np.random.default_rng(seed)
    moving = 1 + seed % 7
    kinds = ["fixed"] * int(rng.integers(0, 4)) + [str(rng.choice(JOINT_KINDS[:3])) for _ in range(moving)]
    rng.shuffle(kinds)
    parts = [f'<link name="link0">{random_inertial(rng)}</link>']
    for number, kind in enumerate(kinds, start=1):
        # mostly a chain, sometimes a branch
        parent = number - 1 if rng.uniform() < 0.8 else int(rng.integers(0, number))
        limit = '<limit lower="-9" upper="9" effort="9" velocity="9"/>' if kind in ("revolute", "prismatic") else ""
        axis = "" if kind == "fixed" else f'<axis xyz="{numbers(rng.normal(size=3))}"/>'
        parts.append(f'<link name="link{number}">{random_inertial(rng)}</link>')
        parts.append(
            f'<joint name="joint{number}" type="{kind}"><parent link="link{parent}"/><child link="link{number}"/>'
            f'<origin xyz="{numbers(rng.uniform(-0.5, 0.5, 3))}" rpy="{numbers(rng.uniform(-3.0, 3.0, 3))}"/>'
            f"{axis}{limit}</joint>"
        )
    parts.append(
        f'<link name="tool"/><joint name="tool" type="fixed"><parent link="link{len(kinds)}"/><child link="tool"/>'
        f'<origin xyz="{numbers(rng.uniform(-0.5, 0.5, 3))}" rpy="{numbers(rng.uniform(-3.0, 3.0, 3))}"/></joint>'
    )
    return f'<robot name="random">{"".join(parts)}</robot>', moving


class Mujoco:
    """The same URDF in MuJoCo, asked for what the equations above give."""

    def __init__(self, urdf: str) -> None:
        self.library = pytest.importorskip("mujoco")
        options = '<mujoco><compiler fusestatic="false" balanceinertia="false" discardvisual="true"/></mujoco>'
        self.model = self.library.MjModel.from_xml_string(urdf.replace("</robot>", options + "</robot>"))
        self.model.opt.gravity[:] = GRAVITY
        self.data = self.library.MjData(self.model)

    def mass_matrix_and_bias(
        self, names: tuple[str, ...], positions: Mapping[str, float], velocities: Mapping[str, float]
    ) -> tuple[np.ndarray, np.ndarray]:
        for name in positions:
            joint = self.model.joint(name)
            self.data.qpos[joint.qposadr[0]] = positions[name]
            self.data.qvel[joint.dofadr[0]] = velocities[name]
        self.library.mj_forward(self.model, self.data)
        full = np.column_stack([self.times_mass(unit) for unit in np.eye(self.model.nv)])
        dofs = [self.model.joint(name).dofadr[0] for name in names]
        return full[np.ix_(dofs, dofs)], self.data.qfrc_bias[dofs]

    def times_mass(self, vector: np.ndarray) -> np.ndarray:
        result = np.zeros(self.model.nv)
        self.library.mj_mulM(self.model, self.data, result, vector)
        return result

    def frame(self, name: str) -> np.ndarray:
        body = self.data.body(name)
        return transform(body.xmat.reshape(3, 3), body.xpos)


def random_state(names: tuple[str, ...], seed: int) -> tuple[dict[str, float], dict[str, float]]:
    rng = np.random.default_rng(1000 + seed)
    positions = {name: float(rng.uniform(-1.5, 1.5)) for name in names}
    return positions, {name: float(rng.uniform(-2.0, 2.0)) for name in names}


@pytest.mark.parametrize("seed", range(21))
def test_equations_of_motion_and_frames_agree_with_mujoco(seed: int) -> None:
    urdf, moving = random_urdf(seed)
    model = RobotModel.from_urdf_string(urdf)
    assert len(model.independent_joints) == moving
    positions, velocities = random_state(model.independent_joints, seed)
    reduced = model.lock(model.independent_joints, {}, GRAVITY)
    names = reduced.joint_names
    mass, bias = mass_matrix_and_bias(
        reduced, np.array([positions[n] for n in names]), np.array([velocities[n] for n in names])
    )
    mujoco = Mujoco(urdf)
    expected_mass, expected_bias = mujoco.mass_matrix_and_bias(names, positions, velocities)
    # rounding of MuJoCo's principal axes and of its sums, relative to the largest entry
    np.testing.assert_allclose(mass, expected_mass, rtol=0.0, atol=1e-9 * np.abs(expected_mass).max())
    np.testing.assert_allclose(bias, expected_bias, rtol=0.0, atol=1e-9 * max(1.0, np.abs(expected_bias).max()))
    for link in model.links:
        np.testing.assert_allclose(model.frame_transform(link.name, positions), mujoco.frame(link.name), atol=1e-12)


@pytest.mark.parametrize("seed", range(1, 21))
def test_holding_joints_leaves_their_rows_out(seed: int) -> None:
    """A held joint has neither velocity nor acceleration: the sub-block of the whole robot's equations remains."""
    urdf, _ = random_urdf(seed)
    model = RobotModel.from_urdf_string(urdf)
    rng = np.random.default_rng(seed)
    names = model.independent_joints
    active = [name for name in names if rng.uniform() < 0.5] or [names[-1]]
    positions, velocities = random_state(names, seed)
    velocities.update({name: 0.0 for name in names if name not in active})
    rng.shuffle(active)
    reduced = model.lock(active, positions, GRAVITY)
    assert reduced.joint_names == tuple(name for name in names if name in active)
    mass, bias = mass_matrix_and_bias(
        reduced,
        np.array([positions[n] for n in reduced.joint_names]),
        np.array([velocities[n] for n in reduced.joint_names]),
    )
    expected_mass, expected_bias = Mujoco(urdf).mass_matrix_and_bias(reduced.joint_names, positions, velocities)
    np.testing.assert_allclose(mass, expected_mass, rtol=0.0, atol=1e-9 * np.abs(expected_mass).max())
    np.testing.assert_allclose(bias, expected_bias, rtol=0.0, atol=1e-9 * max(1.0, np.abs(expected_bias).max()))
    pose, _, _ = series(
        reduced, np.array([positions[n] for n in reduced.joint_names]), np.zeros(len(reduced.joint_names))
    )
    for link in model.links:
        body, body_from_link = reduced.frames[link.name]
        placed = body_from_link if body < 0 else pose[body] @ body_from_link
        np.testing.assert_allclose(placed, model.frame_transform(link.name, positions), atol=1e-12)


# ---------------------------------------------------------------------------------------------------------- closed form


def test_pendulum_is_the_textbook_one() -> None:
    robot = load_robot("pendulum")
    reduced = robot.model.lock(["pivot"], {}, robot.gravity)
    for angle in (-2.0, 0.0, 0.3):
        mass, bias = mass_matrix_and_bias(reduced, np.array([angle]), np.array([1.0]))
        assert mass[0, 0] == pytest.approx(0.2 * 0.3**2 + 0.4 * 0.2 * 0.01**2, rel=1e-12)
        assert bias[0] == pytest.approx(0.2 * 9.81 * 0.3 * math.sin(angle), abs=1e-15)
    assert reduced.frames["base"][0] == -1
    body, body_from_tip = reduced.frames["tip"]
    assert body == 0
    np.testing.assert_allclose(body_from_tip[:3, 3], [0.0, 0.0, -0.3])


def test_pseudo_inertia_gives_the_parallel_axis_theorem() -> None:
    inertia = np.diag([0.03, 0.04, 0.05])
    com = np.array([0.1, -0.2, 0.3])
    expected = inertia + 2.0 * (com @ com * np.eye(3) - np.outer(com, com))
    pseudo = pseudo_inertia(2.0, com, inertia)
    np.testing.assert_allclose(inertia_about_origin(pseudo), expected, atol=1e-15)
    np.testing.assert_allclose(pseudo[:3, 3], 2.0 * com)
    assert pseudo[3, 3] == 2.0


def test_open_manipulator_matches_independent_numbers() -> None:
    """Currents that hold the empty arm at its home pose, and the inertia that moves, from another model of this arm."""
    robot = load_robot("open_manipulator_x")
    home = dict.fromkeys(robot.model.independent_joints, 0.0)
    for joint, current_A, inertia in (("joint2", 0.338, 0.020), ("joint3", 0.285, 0.009), ("joint4", 0.077, 0.0013)):
        reduced = robot.model.lock([joint], home, robot.gravity)
        mass, bias = mass_matrix_and_bias(reduced, np.zeros(1), np.zeros(1))
        assert abs(bias[0]) / robot.drive_trains[joint].nominal_torque_constant == pytest.approx(current_A, abs=0.0005)
        assert mass[0, 0] == pytest.approx(inertia, abs=0.0005)
    np.testing.assert_allclose(
        robot.model.frame_transform("end_effector_link", home)[:3, 3], [0.012 + 0.024 + 0.124 + 0.126, 0.0, 0.2045]
    )


def test_fingers_mirror_each_other() -> None:
    model = load_robot("open_manipulator_x").model
    links = {link.name: link.pseudo_inertia for link in model.links}
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    for opening in (-0.01, 0.0, 0.019):
        positions = dict.fromkeys(model.independent_joints, 0.0) | {"gripper_left_joint": opening}
        moved = [
            np.linalg.inv(model.frame_transform("link5", positions)) @ model.frame_transform(name, positions)
            for name in ("gripper_left_link", "gripper_right_link")
        ]
        left = moved[0] @ links["gripper_left_link"] @ moved[0].T
        right = moved[1] @ links["gripper_right_link"] @ moved[1].T
        np.testing.assert_allclose(mirror @ left @ mirror, right, atol=1e-15)
        assert moved[0][1, 3] == pytest.approx(0.021 + opening)


def test_a_follower_moves_with_its_source_through_others() -> None:
    urdf = chain(
        joint("a", "base", "one", mimic=""),
        joint("b", "one", "two", mimic='<mimic joint="c" multiplier="2" offset="0.1"/>'),
        joint("c", "two", "three", mimic='<mimic joint="a" multiplier="-0.5" offset="0.2"/>'),
    )
    model = RobotModel.from_urdf_string(urdf)
    assert model.independent_joints == ("a",)
    # all three turn about z: c = -0.5 a + 0.2, b = 2 c + 0.1
    angle = 0.6 + (2.0 * (-0.3 + 0.2) + 0.1) + (-0.3 + 0.2)
    np.testing.assert_allclose(
        model.frame_transform("three", {"a": 0.6})[:3, :3], rotation_from_rpy([0.0, 0.0, angle]), atol=1e-15
    )


def test_fingerprint_sees_mass_and_geometry_only() -> None:
    text = resource("urdf", "pendulum").read_text()
    known = RobotModel.from_urdf_string(text).fingerprint()
    assert len(known) == 64
    same = text.replace('velocity="20"', 'velocity="10"').replace('rpy="0 0 0"', "").replace("-0.3", "-0.30")
    assert RobotModel.from_urdf_string(same).fingerprint() == known
    for changed in (
        text.replace('mass value="0.2"', 'mass value="0.2001"'),
        text.replace('<axis xyz="0 1 0"/>', '<axis xyz="0 -1 0"/>'),
        text.replace('ixx="8e-6"', 'ixx="8.001e-6"'),
        text.replace('<origin xyz="0 0 0.5"/>', '<origin xyz="0 0 0.5001"/>'),
    ):
        assert changed != text
        assert RobotModel.from_urdf_string(changed).fingerprint() != known


def test_ur10e_as_published(shared: Path) -> None:
    """Meshes that do not exist, simulator blocks, transmissions and a chain of massless frames: none may be needed."""
    path = shared / "recordings_real" / "models" / "ur10e.urdf"
    if not path.is_file():
        pytest.skip(f"needs {path}")
    model = RobotModel.from_urdf(path)
    assert model.root == "world"
    assert len(model.independent_joints) == 6
    positions, velocities = random_state(model.independent_joints, 1)
    reduced = model.lock(model.independent_joints, {}, GRAVITY)
    assert reduced.frames["tool0"][0] == 5
    mass, bias = mass_matrix_and_bias(reduced, np.array(list(positions.values())), np.array(list(velocities.values())))
    bare = ElementTree.parse(path).getroot()  # MuJoCo does need the meshes
    for element in list(bare.iter()):
        for part in [part for part in element if part.tag in ("visual", "collision", "gazebo", "transmission")]:
            element.remove(part)
    mujoco = Mujoco(ElementTree.tostring(bare, encoding="unicode"))
    expected_mass, expected_bias = mujoco.mass_matrix_and_bias(reduced.joint_names, positions, velocities)
    np.testing.assert_allclose(mass, expected_mass, atol=1e-9 * np.abs(expected_mass).max())
    np.testing.assert_allclose(bias, expected_bias, atol=1e-9 * np.abs(expected_bias).max())


# ------------------------------------------------------------------------------------------- what users get wrong: URDF

INERTIA = '<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/>'
INERTIAL = f'<inertial><mass value="1"/>{INERTIA}</inertial>'
LIMIT = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'


def link(name: str, inertial: str = INERTIAL) -> str:
    return f'<link name="{name}">{inertial}</link>'


def joint(
    name: str,
    parent: str = "base",
    child: str = "one",
    kind: str = "revolute",
    axis: str = "0 0 1",
    limit: str = LIMIT,
    mimic: str = "",
) -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><axis xyz="{axis}"/>'
        f"{limit}{mimic}</joint>"
    )


def chain(*joints: str, links: str | None = None) -> str:
    links = links or "".join(link(name) for name in ("base", "one", "two", "three")[: len(joints) + 1])
    return f'<robot name="arm">{links}{"".join(joints)}</robot>'


def inertial(mass: str = "1", **moments: str) -> str:
    values = {"ixx": "0.01", "ixy": "0", "ixz": "0", "iyy": "0.01", "iyz": "0", "izz": "0.01"} | moments
    text = " ".join(f'{key}="{value}"' for key, value in values.items())
    return chain(
        joint("a"), links=link("base") + link("one", f'<inertial><mass value="{mass}"/><inertia {text}/></inertial>')
    )


BAD_URDF = {
    "not XML": ("joint: revolute", "not XML"),
    "empty": ("", "not XML"),
    "another document": ("<mujoco/>", "a <mujoco>, not a <robot>"),
    "xacro": ('<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arm/></robot>', "xacro"),
    "no links": ("<robot/>", "no <link>"),
    "nameless link": ("<robot><link/></robot>", "a <link> has no name"),
    "floating": (chain(joint("a", kind="floating")), "'floating' is not supported; supported: revolute, continuous"),
    "planar": (chain(joint("a", kind="planar")), "'planar' is not supported"),
    "no kind": (chain(joint("a", kind="")), "type '' is not supported"),
    "no mass": (inertial(mass="0"), "link 'one': mass must be positive, got 0.0 kg"),
    "negative mass": (inertial(mass="-1"), "mass must be positive"),
    "NaN mass": (inertial(mass="nan"), "value='nan' of <mass> must be finite"),
    "mass is no number": (inertial(mass="heavy"), "value='heavy' of <mass> is no number"),
    "two masses": (inertial(mass="1 2"), "value of <mass> must be one number, got 2"),
    "infinite inertia": (inertial(ixx="inf"), "ixx='inf' of <inertia> must be finite"),
    "zero inertia": (inertial(ixx="0", iyy="0", izz="0"), "not positive definite"),
    "indefinite": (inertial(ixy="0.02"), "link 'one': the inertia is not positive definite"),
    "triangle": (inertial(izz="0.0201"), "link 'one': the inertia breaks the triangle inequality"),
    "triangle by products": (inertial(ixx="0.02", ixy="0.009"), "triangle inequality"),
    "inertial without inertia": (
        chain(joint("a"), links=link("base") + link("one", '<inertial><mass value="1"/></inertial>')),
        "link 'one': <inertial> needs both <mass> and <inertia>",
    ),
    "inertia without izz": (chain(joint("a")).replace(' izz="0.01"', ""), "<inertia> has no izz"),
    "unknown parent": (
        chain(joint("a", parent="bsae")),
        "joint 'a' names an unknown parent link 'bsae'; links: base, one",
    ),
    "unknown child": (chain(joint("a", child="hand")), "unknown child link 'hand'"),
    "no parent": (chain(joint("a").replace('<parent link="base"/>', "")), "joint 'a': has no <parent link=.../>"),
    "two links of a name": (
        chain(joint("a"), links=link("base") + link("one") + link("one")),
        "two links are named 'one'",
    ),
    "two joints of a name": (chain(joint("a"), joint("a", "one", "two")), "two joints are named 'a'"),
    "two parents": (
        chain(joint("a"), joint("b", "base", "two"), joint("c", "one", "two")),
        "child of both 'b' and 'c'",
    ),
    "all in a loop": (
        chain(joint("a"), joint("b", "one", "base"), links=link("base") + link("one")),
        "no link is the root",
    ),
    "loop apart": (
        chain(joint("a"), joint("b", "two", "three"), joint("c", "three", "two")),
        "joints b, c form a loop",
    ),
    "two roots": (chain(joint("a"), links=link("base") + link("one") + link("world")), "no parent: base, world"),
    "no limits": (chain(joint("a", limit="")), "joint 'a': a revolute joint needs <limit lower=.. upper=../>"),
    "no upper limit": (
        chain(joint("a", kind="prismatic", limit='<limit lower="0"/>')),
        "a prismatic joint needs <limit",
    ),
    "limits crossed": (chain(joint("a", limit='<limit lower="1" upper="-1"/>')), "above the upper limit"),
    "limit is NaN": (
        chain(joint("a", limit='<limit lower="nan" upper="1"/>')),
        "lower='nan' of <limit> must be finite",
    ),
    "negative effort": (chain(joint("a", limit='<limit lower="0" upper="1" effort="-1"/>')), "must not be negative"),
    "zero axis": (chain(joint("a", axis="0 0 0")), "joint 'a': the axis is zero"),
    "flat axis": (chain(joint("a", axis="0 1")), "xyz of <axis> must be three numbers, got 2"),
    "NaN axis": (chain(joint("a", axis="0 0 nan")), "must be finite"),
    "mimic of nothing": (chain(joint("a", mimic='<mimic joint="b"/>')), "'a' mimics an unknown joint 'b'; joints: a"),
    "mimic without a joint": (chain(joint("a", mimic="<mimic/>")), "<mimic> names no joint"),
    "mimic of fixed": (
        chain(joint("a", kind="fixed"), joint("b", "one", "two", mimic='<mimic joint="a"/>')),
        "'b' mimics 'a', which is fixed",
    ),
    "mimics in a circle": (
        chain(joint("a", mimic='<mimic joint="b"/>'), joint("b", "one", "two", mimic='<mimic joint="a"/>')),
        "mimic each other in a circle: a -> b -> a",
    ),
}


@pytest.mark.parametrize(("urdf", "message"), BAD_URDF.values(), ids=BAD_URDF.keys())
def test_bad_urdf_is_refused_in_one_line(urdf: str, message: str) -> None:
    with pytest.raises(RobotError) as caught:
        RobotModel.from_urdf_string(urdf)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_urdf_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(RobotError, match=r"arm\.urdf: cannot be read \(No such file"):
        RobotModel.from_urdf(tmp_path / "arm.urdf")


def test_rounded_inertia_on_the_edge_is_accepted() -> None:
    """A thin disc has izz = ixx + iyy exactly; sums in other digits may be off in the last one."""
    RobotModel.from_urdf_string(inertial(ixx="0.1", iyy="0.2", izz="0.30000000000000004"))


def test_defaults_of_the_format() -> None:
    model = RobotModel.from_urdf_string(
        chain(joint("a", kind="continuous", limit="").replace('<axis xyz="0 0 1"/>', ""))
    )
    turning = model.joint("a")
    np.testing.assert_array_equal(turning.axis, [1.0, 0.0, 0.0])
    np.testing.assert_array_equal(turning.origin, np.eye(4))
    assert (turning.lower, turning.upper) == (-math.inf, math.inf)
    assert (turning.velocity_limit, turning.effort_limit) == (math.inf, math.inf)
    assert model.lock(["a"], {}).kinds == ("revolute",)


def test_axis_is_made_a_unit_vector() -> None:
    np.testing.assert_allclose(
        RobotModel.from_urdf_string(chain(joint("a", axis="0 3 4"))).joint("a").axis, [0, 0.6, 0.8]
    )


THREE = chain(joint("a"), joint("b", "one", "two"), joint("c", "two", "three", kind="fixed"))
FOLLOWED = chain(joint("a"), joint("b", "one", "two", mimic='<mimic joint="a"/>'), joint("c", "two", "three"))
BAD_LOCKS = {
    "unknown": (THREE, ["elbow"], {}, "arm has no joint 'elbow'; its joints: a, b, c"),
    "none": (THREE, [], {}, "no joint of arm was chosen to move; choose from: a, b"),
    "fixed": (THREE, ["c"], {}, "joint 'c' of arm is fixed and cannot move; choose from: a, b"),
    "twice": (THREE, ["a", "a"], {"b": 0.0}, "joint 'a' of arm was chosen to move twice"),
    "missing": (THREE, ["a"], {}, "no position of joint 'b' of arm is known: state it with --set held.b=VALUE"),
    "NaN": (THREE, ["a"], {"b": math.nan}, "the position of joint 'b' is nan"),
    "follower": (FOLLOWED, ["b"], {}, "joint 'b' of arm only follows 'a'; choose from: a, c"),
    "followed": (FOLLOWED, ["a"], {"c": 0.0}, "joint 'a' of arm drives 'b' too"),
    "massless": (
        chain(joint("a"), joint("b", "one", "two"), links=link("base") + link("one", "") + link("two")),
        ["a", "b"],
        {},
        "nothing that moves with joint 'a' of arm has mass: give link 'one' an <inertial>",
    ),
}


@pytest.mark.parametrize(("urdf", "active", "positions", "message"), BAD_LOCKS.values(), ids=BAD_LOCKS.keys())
def test_bad_lock_is_refused_in_one_line(
    urdf: str, active: list[str], positions: dict[str, float], message: str
) -> None:
    model = RobotModel.from_urdf_string(urdf)
    with pytest.raises(RobotError) as caught:
        model.lock(active, positions)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_bad_gravity_and_unknown_frame_are_refused() -> None:
    model = RobotModel.from_urdf_string(THREE)
    with pytest.raises(RobotError, match="gravity must be three finite numbers"):
        model.lock(["a"], {"b": 0.0}, [0.0, -9.81])
    with pytest.raises(RobotError, match="arm has no link 'hand'; its links: base, one, two, three"):
        model.frame_transform("hand", {})


def test_massless_link_that_merges_with_a_heavy_one_is_fine() -> None:
    links = link("base") + link("one", "") + link("two")
    model = RobotModel.from_urdf_string(chain(joint("a"), joint("b", "one", "two"), links=links))
    assert model.lock(["a"], {"b": 0.3}).pseudo_inertia[0, 3, 3] == 1.0


def test_models_cannot_be_changed_behind_ones_back() -> None:
    model = RobotModel.from_urdf_string(THREE)
    reduced = model.lock(["a"], {"b": 0.0})
    for array in (model.joints[0].origin, model.links[0].pseudo_inertia, reduced.placement, reduced.frames["two"][1]):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


# ---------------------------------------------------------------------------------------------------------- robot files

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
    np.testing.assert_array_equal(robot.gravity, [0.0, 0.0, -9.81])
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
    "unknown motor key": ("{nominal", "{torque: 1, nominal", "joints: a: motor: unknown key 'torque'"),
    "unknown quantity key": (
        "std: 0.02",
        "sdt: 0.02",
        "coulomb_N_m: unknown key 'sdt'; did you mean 'std'? valid keys: value, std",
    ),
    "missing friction": (
        "      coulomb_N_m: {value: 0.1, std: 0.02}\n",
        "",
        "joints: a: drive_train: coulomb_N_m is missing",
    ),
    "missing value": ("{value: 0.1, std: 0.02}", "{std: 0.02}", "coulomb_N_m: value is missing"),
    "text for a number": (
        "load_friction: 0",
        "load_friction: little",
        "load_friction: expected a number, got 'little'",
    ),
    "truth for a number": ("load_friction: 0", "load_friction: yes", "load_friction: expected a number, got 'yes'"),
    "NaN": ("load_friction: 0", "load_friction: .nan", "load_friction: expected a finite number, got nan"),
    "negative std": ("std: 0.02", "std: -0.02", "coulomb_N_m: std: must not be negative, got -0.02"),
    "negative friction": ("value: 0.1", "value: -0.1", "coulomb_N_m: value: must not be negative"),
    "zero torque constant": ("A: 2.0,", "A: 0.0,", "nominal_torque_constant_N_m_per_A: must be positive, got 0.0"),
    "perfect encoder": ("0.001", "0", "encoder_resolution_rad and encoder_noise_rad are both 0"),
    "voltage without resistance": (
        "{nominal",
        "{supply_voltage_V: 12, nominal",
        "supply_voltage_V needs resistance_ohm",
    ),
    "bus id": ("{nominal", "{id: 300, nominal", "id: expected a whole number from 0 to 252, got 300"),
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
    "no frame": ("payload_frame: two\n", "", "arm.yaml: payload_frame is missing; state it"),
    "no urdf": ("urdf: arm.urdf\n", "", "arm.yaml: urdf is missing"),
    "urdf not there": ("arm.urdf", "leg.urdf", "urdf: there is no"),
    "flat gravity": (
        "name: arm",
        "name: arm\ngravity: [0, 9.81]",
        "gravity: expected three numbers [x, y, z], got [0, 9.81]",
    ),
    "calibrated": ("name: arm", "name: arm\ncalibrated: 1", "calibrated: expected true or false, got 1"),
    "not YAML": ("name: arm", "name: [arm", "not YAML"),
    "key given twice": ("name: arm", "name: arm\nname: leg", "duplicate key"),
    "no mapping": (MINIMAL, "- 1", "arm.yaml: expected keys and values, got [1]"),
    "empty": (MINIMAL, "", "arm.yaml: expected keys and values, got None"),
    "joints is a list": (
        MINIMAL[MINIMAL.index("joints:") :],
        "joints: [a]",
        "joints: expected keys and values, got ['a']",
    ),
    "no joints": (MINIMAL[MINIMAL.index("joints:") :], "", "joints is missing or empty"),
    "other URDF": ("name: arm", "name: arm\nmodel_fingerprint: abc", "was made with another URDF"),
    "extends nothing": ("name: arm", "extends: leg", "unknown robot 'leg'; known robots: "),
    "extends itself": ("name: arm", "extends: arm.yaml", "extend each other in a circle: arm.yaml -> arm.yaml"),
}


@pytest.mark.parametrize(("old", "new", "message"), BAD_FILES.values(), ids=BAD_FILES.keys())
def test_bad_robot_file_is_refused_in_one_line(folder: Path, old: str, new: str, message: str) -> None:
    assert old in MINIMAL
    (folder / "arm.yaml").write_text(MINIMAL.replace(old, new, 1))
    with pytest.raises(RobotError) as caught:
        load_robot(folder / "arm.yaml")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_wrong_robot_names_are_refused(folder: Path) -> None:
    with pytest.raises(RobotError, match=r"unknown robot 'scara'; known robots: .*open_manipulator_x.*pendulum"):
        load_robot("scara")
    with pytest.raises(RobotError, match="there is no robot file"):
        load_robot(folder / "leg.yaml")
    with pytest.raises(RobotError, match=r"bare URDF.*write .*arm\.yaml with 'urdf: arm\.urdf'"):
        load_robot(folder / "arm.urdf")


def test_sliding_joint_needs_its_transmission(folder: Path) -> None:
    (folder / "arm.urdf").write_text(THREE.replace("revolute", "prismatic", 1))
    with pytest.raises(RobotError, match="transmission_m_per_rad is missing"):
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
    np.testing.assert_allclose(drive.finger_travel.ratio_at(angle[1:-1]), 0.0125 * np.cos(angle[1:-1]), rtol=0.01)
    powers = angle[:, None] ** np.arange(1, 4)
    np.testing.assert_allclose(powers @ drive.travel_coefficients, crank(angle) - 0.003, atol=5e-5)
    (folder / "arm.yaml").write_text(MINIMAL + TRAVELS % ([-0.5, 0.5], [0.001, 0.0125]))
    assert load_robot(folder / "arm.yaml").drive_trains["a"].travel_coefficients == pytest.approx((0.0115, 0.0, 0.0))
    (folder / "arm.yaml").write_text(MINIMAL + "    transmission_m_per_rad: 0.012\n")
    assert load_robot(folder / "arm.yaml").drive_trains["a"].travel_coefficients == (0.012, 0.0, 0.0)


@pytest.mark.parametrize(
    ("at_rad", "open_m", "message"),
    [
        ([0.0, 1.0], [0.0, 12.0], "openings are in m, not mm"),
        ([0.0, 57.3], [0.0, 0.7], "angles are in rad, not degrees"),
        ([0.0, 0.5, 1.0], [0.0, 0.01], "3 angles and 2 openings"),
        ([0.0, 1.0, 0.5], [0.0, 0.01, 0.02], "expected rising numbers"),
        ([0.0], [0.0], "two or more numbers"),
        ([0.0, 1.0], [0.0, 0.03], "opens by 30 mm per rad of the motor, transmission_m_per_rad is 12 mm per rad"),
        ([0.0, 0.1, 0.2, 1.0], [0.0, 0.006, 0.0061, 0.0062], "turns back in between"),
    ],
)
def test_a_fingers_travel_that_cannot_be(folder: Path, at_rad: list[float], open_m: list[float], message: str) -> None:
    (folder / "arm.urdf").write_text(THREE.replace("revolute", "prismatic", 1))
    (folder / "arm.yaml").write_text(MINIMAL + TRAVELS % (at_rad, open_m))
    with pytest.raises(RobotError) as caught:
        load_robot(folder / "arm.yaml")
    assert message in str(caught.value) and "\n" not in str(caught.value)


def test_extends_gives_only_what_differs(folder: Path) -> None:
    below = folder / "calibrations"
    below.mkdir()
    (below / "mine.yaml").write_text(
        "extends: ../arm.yaml\ncalibrated: true\n"
        "joints: {a: {drive_train: {coulomb_N_m: {std: 0.001}, load_friction: 0.1}}}\n"
    )
    robot, base = load_robot(below / "mine.yaml"), load_robot(folder / "arm.yaml")
    drive = robot.drive_trains["a"]
    assert (drive.coulomb.value, drive.coulomb.std) == (0.1, 0.001)
    assert drive.load_friction.value == 0.1
    assert drive.viscous == base.drive_trains["a"].viscous
    assert robot.is_calibrated() and not base.is_calibrated()
    assert not robot.is_calibrated(["joint3"]), "no runs have told its drive trains"
    # the URDF is found beside the file that names it, not beside the one that extends it
    assert robot.model.fingerprint() == base.model.fingerprint()
    (below / "bound.yaml").write_text(f"extends: ../arm.yaml\nmodel_fingerprint: {base.model.fingerprint()}\n")
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
    again = changed.with_overrides({"joints.a.drive_train.coulomb_N_m": {"value": 0.06, "std": 0.01}})
    assert (again.drive_trains["a"].coulomb.value, again.delay.value) == (0.06, 0.004)
    only_std = robot.with_overrides({"joints.a.drive_train.coulomb_N_m": {"std": 0.3}})
    assert (only_std.drive_trains["a"].coulomb.value, only_std.drive_trains["a"].coulomb.std) == (0.1, 0.3)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("joints.a.drive_train.coulomb", 0.1, "did you mean 'joints.a.drive_train.coulomb_N_m'"),
        ("joints.z.drive_train.coulomb_N_m", 0.1, "where JOINT is one of a, b"),
        ("urdf", "other.urdf", "unknown robot setting 'urdf'"),
        ("joints.a.drive_train.coulomb_N_m", "much", "coulomb_N_m: expected a number, got 'much'"),
        ("joints.a.drive_train.coulomb_N_m", -0.1, "must not be negative"),
        ("payload_frame", "hand", "arm has no link 'hand'"),
        ("joints.b.motor.id", 3, "joints: b: motor: nominal_torque_constant_N_m_per_A is missing"),
    ],
)
def test_bad_overrides_are_refused(folder: Path, key: str, value: object, message: str) -> None:
    with pytest.raises(RobotError) as caught:
        load_robot(folder / "arm.yaml").with_overrides({key: value})
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_joint_names_with_dots_can_be_overridden(folder: Path) -> None:
    (folder / "arm.urdf").write_text(THREE.replace('name="a"', 'name="left.a"'))
    (folder / "arm.yaml").write_text(MINIMAL.replace("  a:", "  left.a:"))
    robot = load_robot(folder / "arm.yaml").with_overrides({"joints.left.a.drive_train.load_friction": 0.02})
    assert robot.drive_trains["left.a"].load_friction.value == 0.02


# ------------------------------------------------------------------------------------------------------------ resources


def test_resources_of_the_source_tree() -> None:
    assert share_directory() == REPOSITORY
    assert resource("urdf", "pendulum") == resource("urdf", "pendulum.urdf") == REPOSITORY / "urdf" / "pendulum.urdf"
    assert {"open_manipulator_x", "pendulum"} <= set(resource_names("robots"))
    with pytest.raises(ConfigurationError, match=r"no 'scara' among the robots; there are: .*open_manipulator_x"):
        resource("robots", "scara")


@pytest.mark.parametrize("installed", ["lib/python3/site-packages", "elsewhere"])
def test_resources_of_an_installation(tmp_path: Path, installed: str) -> None:
    """As pip and colcon lay files out, and as a sourced workspace names them where code and data lie apart."""
    package = tmp_path / installed / "proprio_ros"
    package.mkdir(parents=True)
    for name in ("__init__.py", "errors.py", "resources.py"):
        shutil.copy(REPOSITORY / "proprio_ros" / name, package)
    prefix = tmp_path if installed.startswith("lib") else tmp_path / "prefix"
    share = prefix / "share" / "proprio_ros" / "config" / "robots"
    share.mkdir(parents=True)
    shutil.copy(REPOSITORY / "config" / "robots" / "open_manipulator_x.yaml", share)
    answer = subprocess.run(
        [
            sys.executable,
            "-c",
            "from proprio_ros.resources import resource; print(resource('robots', 'open_manipulator_x'))",
        ],
        env=os.environ | {"PYTHONPATH": str(package.parent), "AMENT_PREFIX_PATH": str(prefix)},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    assert Path(answer.stdout.strip()) == share / "open_manipulator_x.yaml"
