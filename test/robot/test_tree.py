"""The tree of links against MuJoCo and against closed forms, and what users get wrong when they hold joints."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from support.small_urdf import THREE, chain, joint, link

from proprio_ros.errors import RobotError
from proprio_ros.inputs.resources import resource
from proprio_ros.robot import ReducedModel, RobotModel, load_robot, rotation_from_rpy
from proprio_ros.robot.geometry import transform
from proprio_ros.robot.links import JOINT_KINDS

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
            twist[:3, :3] = [
                [0.0, -z, y],
                [z, 0.0, -x],
                [-y, x, 0.0],
            ]
            moved = (
                np.eye(4)
                + math.sin(positions[i]) * twist
                + (1.0 - math.cos(positions[i])) * twist @ twist
            )
        # exp(twist q) commutes with its twist: derivatives by time are moved @ twist * v and moved @ twist^2 * v^2
        local = reduced.placement[i] @ moved
        local_rate = local @ twist * velocities[i]
        local_bias = local @ twist @ twist * velocities[i] ** 2
        parent = reduced.parents[i]
        before = np.eye(4)
        before_rate = np.zeros((4, 4))
        before_bias = np.zeros((4, 4))
        if parent >= 0:
            before = pose[parent]
            before_rate = rate[parent]
            before_bias = bias[parent]
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
    weight = np.einsum(
        "biuv,bv,u->i", by_position[:, :, :3, :], reduced.pseudo_inertia[:, :, 3], reduced.gravity
    )
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
    kinds = ["fixed"] * int(rng.integers(0, 4)) + [
        str(rng.choice(JOINT_KINDS[:3])) for _ in range(moving)
    ]
    rng.shuffle(kinds)
    parts = [f'<link name="link0">{random_inertial(rng)}</link>']
    for number, kind in enumerate(kinds, start=1):
        # mostly a chain, sometimes a branch
        parent = number - 1 if rng.uniform() < 0.8 else int(rng.integers(0, number))
        limit = (
            '<limit lower="-9" upper="9" effort="9" velocity="9"/>'
            if kind in ("revolute", "prismatic")
            else ""
        )
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
        self.model = self.library.MjModel.from_xml_string(
            urdf.replace("</robot>", options + "</robot>")
        )
        self.model.opt.gravity[:] = GRAVITY
        self.data = self.library.MjData(self.model)

    def mass_matrix_and_bias(
        self,
        names: tuple[str, ...],
        positions: Mapping[str, float],
        velocities: Mapping[str, float],
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


def random_state(
    names: tuple[str, ...],
    seed: int,
) -> tuple[dict[str, float], dict[str, float]]:
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
    np.testing.assert_allclose(
        mass, expected_mass, rtol=0.0, atol=1e-9 * np.abs(expected_mass).max()
    )
    np.testing.assert_allclose(
        bias, expected_bias, rtol=0.0, atol=1e-9 * max(1.0, np.abs(expected_bias).max())
    )
    for part in model.links:
        np.testing.assert_allclose(
            model.frame_transform(part.name, positions), mujoco.frame(part.name), atol=1e-12
        )


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
    expected_mass, expected_bias = Mujoco(urdf).mass_matrix_and_bias(
        reduced.joint_names, positions, velocities
    )
    np.testing.assert_allclose(
        mass, expected_mass, rtol=0.0, atol=1e-9 * np.abs(expected_mass).max()
    )
    np.testing.assert_allclose(
        bias, expected_bias, rtol=0.0, atol=1e-9 * max(1.0, np.abs(expected_bias).max())
    )
    check_frames(model, reduced, positions)


def check_frames(
    model: RobotModel,
    reduced: ReducedModel,
    positions: dict[str, float],
) -> None:
    """Every link is where it is without a joint held.

    Args:
        model: The whole robot.
        reduced: With some joints held at `positions`.
        positions: Of all joints [rad, m].
    """
    pose, _, _ = series(
        reduced,
        np.array([positions[n] for n in reduced.joint_names]),
        np.zeros(len(reduced.joint_names)),
    )
    for part in model.links:
        body, body_from_link = reduced.frames[part.name]
        placed = body_from_link if body < 0 else pose[body] @ body_from_link
        np.testing.assert_allclose(
            placed,
            model.frame_transform(part.name, positions),
            atol=1e-12,
        )


# ---------------------------------------------------------------------------------------------------------- closed form


def test_pendulum_is_the_textbook_one() -> None:
    robot = load_robot("pendulum")
    reduced = robot.model.lock(
        ["pivot"],
        {},
        robot.gravity,
    )
    for angle in (-2.0, 0.0, 0.3):
        mass, bias = mass_matrix_and_bias(
            reduced,
            np.array([angle]),
            np.array([1.0]),
        )
        assert mass[0, 0] == pytest.approx(0.2 * 0.3**2 + 0.4 * 0.2 * 0.01**2, rel=1e-12)
        assert bias[0] == pytest.approx(0.2 * 9.81 * 0.3 * math.sin(angle), abs=1e-15)
    assert reduced.frames["base"][0] == -1
    body, body_from_tip = reduced.frames["tip"]
    assert body == 0
    np.testing.assert_allclose(
        body_from_tip[:3, 3],
        [0.0, 0.0, -0.3],
    )


def test_open_manipulator_matches_independent_numbers() -> None:
    """Currents that hold the empty arm at its home pose, and the inertia that moves, from another model of this arm."""
    robot = load_robot("open_manipulator_x")
    home = dict.fromkeys(robot.model.independent_joints, 0.0)
    for name, current_A, inertia in (
        ("joint2", 0.338, 0.020),
        ("joint3", 0.285, 0.009),
        ("joint4", 0.077, 0.0013),
    ):
        reduced = robot.model.lock([name], home, robot.gravity)
        mass, bias = mass_matrix_and_bias(
            reduced,
            np.zeros(1),
            np.zeros(1),
        )
        assert abs(bias[0]) / robot.drive_trains[name].nominal_torque_constant == pytest.approx(
            current_A, abs=0.0005
        )
        assert mass[0, 0] == pytest.approx(inertia, abs=0.0005)
    np.testing.assert_allclose(
        robot.model.frame_transform("end_effector_link", home)[:3, 3],
        [0.012 + 0.024 + 0.124 + 0.126, 0.0, 0.2045],
    )


def test_fingers_mirror_each_other() -> None:
    model = load_robot("open_manipulator_x").model
    links = {link.name: link.pseudo_inertia for link in model.links}
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    for opening in (-0.01, 0.0, 0.019):
        positions = dict.fromkeys(model.independent_joints, 0.0) | {"gripper_left_joint": opening}
        moved = [
            np.linalg.inv(model.frame_transform("link5", positions))
            @ model.frame_transform(name, positions)
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
        model.frame_transform("three", {"a": 0.6})[:3, :3],
        rotation_from_rpy([0.0, 0.0, angle]),
        atol=1e-15,
    )


def test_fingerprint_sees_mass_and_geometry_only() -> None:
    text = resource("urdf", "pendulum").read_text()
    known = RobotModel.from_urdf_string(text).fingerprint()
    assert len(known) == 64
    same = (
        text.replace('velocity="20"', 'velocity="10"')
        .replace('rpy="0 0 0"', "")
        .replace("-0.3", "-0.30")
    )
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
    mass, bias = mass_matrix_and_bias(
        reduced, np.array(list(positions.values())), np.array(list(velocities.values()))
    )
    bare = ElementTree.parse(path).getroot()  # MuJoCo does need the meshes
    for element in list(bare.iter()):
        for part in [
            part
            for part in element
            if part.tag in ("visual", "collision", "gazebo", "transmission")
        ]:
            element.remove(part)
    mujoco = Mujoco(ElementTree.tostring(bare, encoding="unicode"))
    expected_mass, expected_bias = mujoco.mass_matrix_and_bias(
        reduced.joint_names, positions, velocities
    )
    np.testing.assert_allclose(
        mass,
        expected_mass,
        atol=1e-9 * np.abs(expected_mass).max(),
    )
    np.testing.assert_allclose(
        bias,
        expected_bias,
        atol=1e-9 * np.abs(expected_bias).max(),
    )


# ------------------------------------------------------------------------------------------------- what users get wrong

FOLLOWED = chain(
    joint("a"), joint("b", "one", "two", mimic='<mimic joint="a"/>'), joint("c", "two", "three")
)
BAD_LOCKS = {
    "unknown": (THREE, ["elbow"], {}, "arm has no joint 'elbow'; its joints: a, b, c"),
    "none": (THREE, [], {}, "no joint of arm was chosen to move; choose from: a, b"),
    "fixed": (THREE, ["c"], {}, "joint 'c' of arm is fixed and cannot move; choose from: a, b"),
    "twice": (
        THREE,
        ["a", "a"],
        {"b": 0.0},
        "joint 'a' of arm was chosen to move twice",
    ),
    "missing": (
        THREE,
        ["a"],
        {},
        "no position of joint 'b' of arm is known: state it with --set held.b=VALUE",
    ),
    "NaN": (
        THREE,
        ["a"],
        {"b": math.nan},
        "the position of joint 'b' is nan",
    ),
    "follower": (FOLLOWED, ["b"], {}, "joint 'b' of arm only follows 'a'; choose from: a, c"),
    "followed": (FOLLOWED, ["a"], {"c": 0.0}, "joint 'a' of arm drives 'b' too"),
    "massless": (
        chain(
            joint("a"),
            joint("jaw", "one", "two"),
            links=link("base") + link("one") + link("two", ""),
        ),
        ["a", "jaw"],
        {},
        "nothing that moves with joint 'jaw' of arm has mass: give link 'two' an <inertial>",
    ),
}


@pytest.mark.parametrize(
    ("urdf", "active", "positions", "message"), BAD_LOCKS.values(), ids=BAD_LOCKS.keys()
)
def test_bad_lock_is_refused_in_one_line(
    urdf: str,
    active: list[str],
    positions: dict[str, float],
    message: str,
) -> None:
    model = RobotModel.from_urdf_string(urdf)
    with pytest.raises(RobotError) as caught:
        model.lock(active, positions)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_bad_gravity_and_unknown_frame_are_refused() -> None:
    model = RobotModel.from_urdf_string(THREE)
    with pytest.raises(RobotError, match="gravity must be three finite numbers"):
        model.lock(
            ["a"],
            {"b": 0.0},
            [0.0, -9.81],
        )
    with pytest.raises(
        RobotError, match="arm has no link 'hand'; its links: base, one, two, three"
    ):
        model.frame_transform("hand", {})


def test_massless_link_that_merges_with_a_heavy_one_is_fine() -> None:
    links = link("base") + link("one", "") + link("two")
    model = RobotModel.from_urdf_string(
        chain(
            joint("a"),
            joint("b", "one", "two"),
            links=links,
        )
    )
    assert model.lock(["a"], {"b": 0.3}).pseudo_inertia[0, 3, 3] == 1.0


def test_models_cannot_be_changed_behind_ones_back() -> None:
    model = RobotModel.from_urdf_string(THREE)
    reduced = model.lock(["a"], {"b": 0.0})
    for array in (
        model.joints[0].origin,
        model.links[0].pseudo_inertia,
        reduced.placement,
        reduced.frames["two"][1],
    ):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
