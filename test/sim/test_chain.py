"""Chains and trees: against MuJoCo, closed forms, an independent Lagrangian, finite differences and the tape."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import ellipj, ellipk

from proprio_ros.errors import SimulationError
from proprio_ros.robot import ReducedModel, RobotModel, load_robot, pseudo_inertia
from proprio_ros.sim.chain import ChainSimulator, attach_payload_joint, bias, mass_matrix
from proprio_ros.sim.joint import INDEX, PARAMETERS, JointRun, JointSimulator
from proprio_ros.sim.payload import joint_coefficients


def random_chain(joints: int, seed: int, branches: bool = False) -> RobotModel:
    """A URDF chain (or tree) with rotated frames and inertials; about a quarter of its joints slide."""
    rng = np.random.default_rng(seed)

    def triple(scale: float) -> str:
        return " ".join(f"{x:.6f}" for x in rng.uniform(-scale, scale, 3))

    text = ['<robot name="r"><link name="l0"/>']
    for i in range(joints):
        a, b, c = rng.uniform(0.5, 1.0, 3) * 1e-2
        kind = "prismatic" if rng.uniform() < 0.25 else "revolute"
        axis = rng.normal(size=3)
        axis = " ".join(f"{x:.9f}" for x in axis / np.linalg.norm(axis))
        parent = f"l{rng.integers(0, i + 1)}" if branches else f"l{i}"
        text.append(
            f'<link name="l{i + 1}"><inertial><origin xyz="{triple(0.1)}" rpy="{triple(1.0)}"/>'
            f'<mass value="{rng.uniform(0.1, 1):.6f}"/>'
            f'<inertia ixx="{a + b:.9f}" iyy="{a + c:.9f}" izz="{b + c:.9f}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="j{i}" type="{kind}"><parent link="{parent}"/><child link="l{i + 1}"/>'
            f'<origin xyz="{triple(0.2)}" rpy="{triple(1.5)}"/><axis xyz="{axis}"/>'
            f'<limit lower="-9" upper="9" velocity="9" effort="9"/></joint>'
        )
    return RobotModel.from_urdf_string("".join([*text, "</robot>"]))


def named(sim: ChainSimulator, **values: float) -> np.ndarray:
    """The model's own inertias, and single parameters by name, shape (P,)."""
    p = sim.pack()[0]
    for name, value in values.items():
        p[sim.parameter_names.index(name)] = value
    return p


def whole(model: RobotModel) -> ReducedModel:
    return model.lock(list(model.independent_joints), {}, (0.3, -0.7, -9.5))


def simulator(
    model: ReducedModel, times: np.ndarray, current: np.ndarray | None = None, **options: object
) -> ChainSimulator:
    n = len(model.joint_names)
    options.setdefault("friction_velocity", 1e-3)
    return ChainSimulator(model, times, np.zeros(1), np.zeros((1, n)) if current is None else current[None], **options)


@pytest.mark.parametrize(
    ("joints", "branches"), [(1, False), (2, False), (3, True), (4, False), (5, True), (6, False), (7, False)]
)
def test_rigid_body_terms_against_mujoco(joints: int, branches: bool) -> None:
    """M(q) and inverse dynamics at random states to 1e-9."""
    mujoco = pytest.importorskip("mujoco")
    for seed in range(3):
        model = random_chain(joints, 100 * joints + seed, branches)
        reduced = whole(model)
        spec = _as_mujoco(mujoco, reduced)
        data = mujoco.MjData(spec)
        rng = np.random.default_rng(seed)
        q, v, a = rng.uniform(-1.5, 1.5, (3, joints))
        data.qpos[:], data.qvel[:], data.qacc[:] = q, v, a
        mujoco.mj_inverse(spec, data)
        mass = np.zeros((joints, joints))
        mujoco.mj_fullM(spec, mass, data.qM) if hasattr(data, "qM") else mujoco.mj_fullM(spec, data, mass)
        ours, forces = mass_matrix(reduced, q[None]), bias(reduced, q[None], v[None])
        np.testing.assert_allclose(ours[0], mass, atol=1e-9)
        np.testing.assert_allclose(
            ours[0] @ a + forces[0], data.qfrc_inverse, atol=1e-9 * max(1.0, np.abs(forces).max())
        )


def _as_mujoco(mujoco: object, reduced: ReducedModel) -> object:
    """The reduced model as MJCF, body by body with full inertia matrices: another reader, another algorithm."""
    spec = mujoco.MjSpec()
    spec.option.gravity = reduced.gravity
    spec.compiler.autolimits = False
    bodies: list = []
    for i, name in enumerate(reduced.joint_names):
        parent = spec.worldbody if reduced.parents[i] < 0 else bodies[reduced.parents[i]]
        pseudo = reduced.pseudo_inertia[i]
        mass, com = pseudo[3, 3], pseudo[:3, 3] / pseudo[3, 3]
        second = pseudo[:3, :3] - mass * np.outer(com, com)
        tensor = np.trace(second) * np.eye(3) - second
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, reduced.placement[i, :3, :3].ravel())
        body = parent.add_body(name=name, pos=reduced.placement[i, :3, 3], quat=quaternion)
        body.mass, body.ipos, body.explicitinertial = mass, com, True
        body.fullinertia = [tensor[0, 0], tensor[1, 1], tensor[2, 2], tensor[0, 1], tensor[0, 2], tensor[1, 2]]
        joint = body.add_joint(axis=reduced.axes[i])
        joint.type = mujoco.mjtJoint.mjJNT_HINGE if reduced.kinds[i] == "revolute" else mujoco.mjtJoint.mjJNT_SLIDE
        bodies.append(body)
    return spec.compile()


def test_one_joint_equals_the_one_joint_law() -> None:
    """Two implementations of the same arm: chain.py with one active joint, joint.py with its four coefficients."""
    robot = load_robot("open_manipulator_x")
    pose = {"joint1": 0.3, "joint2": -1.2, "joint4": 0.4, "gripper_left_joint": 0.01}
    reduced = robot.model.lock(["joint3"], pose, robot.gravity)
    times = np.linspace(0.013, 0.6, 20)
    switches, current = np.array([0.0, 0.21]), np.array([-0.3, -0.25])
    law = {"torque_constant": 1.7, "coulomb": 0.03, "viscous": 0.01, "load_friction": 0.02}
    start = {"delay": 0.004, "q0": 0.5, "v0": -0.1}
    supply = (6.0, 2.49, 5.22)
    chain = ChainSimulator(
        reduced, times, switches, current[:, None], friction_velocity=0.05, supply=[supply], step_s=1 / 2000
    )
    p = named(
        chain,
        **{f"{name}[joint3]": value for name, value in law.items()},
        **{"armature[joint3]": 0.012, "delay": 0.004, "q0[joint3]": 0.5, "v0[joint3]": -0.1},
    )
    gravity = reduced.placement[0][:3, :3].T @ reduced.gravity
    coefficients = joint_coefficients(reduced.pseudo_inertia[0], "revolute", reduced.axes[0], gravity)
    row = np.zeros((1, len(PARAMETERS)))
    row[0, :4] = coefficients + np.array([0.012, 0.0, 0.0, 0.0])
    for name, value in {**law, **start}.items():
        row[0, INDEX[name]] = value
    run = JointRun(
        times, switches, current, supply=supply, friction_velocity=0.05, step_s=1 / 2000, fine_step_s=1 / 2000
    )
    q, v = JointSimulator([run]).rollout(np.zeros(1, dtype=np.int32), row)
    chain_q, chain_v = chain.rollout(p[None])
    np.testing.assert_allclose(chain_q[0, :, 0], q[0], atol=1e-9)
    np.testing.assert_allclose(chain_v[0, :, 0], v[0], atol=1e-9)


def test_pendulum_with_large_swing() -> None:
    """The pendulum's period grows with its swing: q = 2 asin(k sn(K - w t)); w from inertia and first moment."""
    robot = load_robot("pendulum")
    reduced = robot.model.lock(["pivot"], {}, robot.gravity)
    times = np.linspace(0.05, 1.5, 20)
    sim = simulator(reduced, times, step_s=1e-3)
    p = named(sim, **{"q0[pivot]": 2.5})
    omega = np.sqrt(0.2 * 9.81 * 0.3 / (0.2 * 0.09 + 8e-6))
    k = np.sin(1.25)
    exact = 2.0 * np.arcsin(k * ellipj(ellipk(k**2) - omega * times, k**2)[0])
    np.testing.assert_allclose(sim.rollout(p[None])[0][0, :, 0], exact, atol=1e-8)


def two_links() -> ReducedModel:
    """Two hinges about y with point-like masses at the ends of rods of 0.3 and 0.2 m, hanging down."""
    text = ['<robot name="two"><link name="l0"/>']
    for i, (length, mass, at) in enumerate(((0.3, 0.4, 0.0), (0.2, 0.25, -0.3))):
        text.append(
            f'<link name="l{i + 1}"><inertial><origin xyz="0 0 {-length}"/><mass value="{mass}"/>'
            '<inertia ixx="1e-9" iyy="1e-9" izz="1e-9" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="j{i}" type="continuous"><parent link="l{i}"/><child link="l{i + 1}"/><origin xyz="0 0 {at}"/>'
            '<axis xyz="0 1 0"/></joint>'
        )
    return RobotModel.from_urdf_string("".join([*text, "</robot>"])).lock(["j0", "j1"], {}, (0.0, 0.0, -9.81))


def two_link_motion(_: float, state: np.ndarray) -> np.ndarray:
    """The double pendulum's Lagrange equations in absolute angles, written out (any mechanics textbook)."""
    m1, m2, l1, l2, g = 0.4, 0.25, 0.3, 0.2, 9.81
    a, b, va, vb = state
    matrix = np.array([[(m1 + m2) * l1**2, m2 * l1 * l2 * np.cos(a - b)], [m2 * l1 * l2 * np.cos(a - b), m2 * l2**2]])
    right = np.array(
        [
            -m2 * l1 * l2 * vb**2 * np.sin(a - b) - (m1 + m2) * g * l1 * np.sin(a),
            m2 * l1 * l2 * va**2 * np.sin(a - b) - m2 * g * l2 * np.sin(b),
        ]
    )
    return np.array([va, vb, *np.linalg.solve(matrix, right)])


def test_two_link_arm_against_its_lagrangian() -> None:
    times = np.linspace(0.05, 1.0, 20)
    sim = simulator(two_links(), times, step_s=5e-4)
    p = named(sim, **{"q0[j0]": 1.2, "q0[j1]": -0.7, "v0[j0]": 0.4, "v0[j1]": -1.0})
    q, _ = sim.rollout(p[None])
    absolute = solve_ivp(
        two_link_motion, (0.0, 1.0), [1.2, 0.5, 0.4, -0.6], method="DOP853", rtol=1e-12, atol=1e-13, t_eval=times
    )
    np.testing.assert_allclose(
        q[0, :, 0], absolute.y[0], atol=1e-6
    )  # the links' own 1e-9 kg m^2 is 5e-8 of the inertia
    np.testing.assert_allclose(q[0, :, 0] + q[0, :, 1], absolute.y[1], atol=1e-6)


def test_energy_drift() -> None:
    """Kinetic plus potential energy of the double pendulum over two seconds of large, chaotic swing."""
    times = np.linspace(0.02, 2.0, 100)
    sim = simulator(two_links(), times, step_s=2.5e-4)
    p = named(sim, **{"q0[j0]": 2.0, "q0[j1]": 1.0})
    q, v = sim.rollout(p[None])
    mass = mass_matrix(sim.model, q[0])
    kinetic = 0.5 * np.einsum("ti,tij,tj->t", v[0], mass, v[0])
    height = 0.4 * -0.3 * np.cos(q[0, :, 0]) + 0.25 * (-0.3 * np.cos(q[0, :, 0]) - 0.2 * np.cos(q[0].sum(axis=1)))
    assert np.ptp(kinetic + 9.81 * height) < 1e-8


def test_momentum_of_a_free_slide_pair_is_conserved() -> None:
    """Without gravity a tree of slides keeps the momentum of each direction."""
    model = random_chain(3, 11)
    reduced = model.lock(list(model.independent_joints), {}, (0.0, 0.0, 0.0))
    times = np.linspace(0.05, 0.5, 10)
    sim = simulator(reduced, times, step_s=5e-4)
    p = named(sim, **{f"v0[j{i}]": value for i, value in enumerate((0.5, -0.8, 1.1))})
    q, v = sim.rollout(p[None])
    mass = mass_matrix(sim.model, q[0])
    kinetic = 0.5 * np.einsum("ti,tij,tj->t", v[0], mass, v[0])
    assert np.ptp(kinetic) < 1e-9 * kinetic[0]


# --- payload joints ------------------------------------------------------------------------------------------------------


def test_payload_on_a_spring_slide() -> None:
    """A mass on a vertical spring under a held arm: x = -m g / k (1 - cos w t)."""
    robot = load_robot("pendulum")
    heavy = robot.model.lock(["pivot"], {}, robot.gravity)
    payload = pseudo_inertia(0.05, np.zeros(3), 1e-9 * np.eye(3))
    hung = attach_payload_joint(heavy, "tip", "prismatic", [0.0, 0.0, 1.0], payload)
    assert hung.joint_names == ("pivot", "payload_slide")
    times = np.linspace(0.02, 0.5, 25)
    sim = simulator(hung, times, step_s=5e-4)
    stiffness = 8.0
    # the pivot hangs at rest and the payload moves along it, so the pivot stays
    p = named(sim, **{"stiffness[payload_slide]": stiffness})
    q, _ = sim.rollout(p[None])
    omega = np.sqrt(stiffness / 0.05)
    np.testing.assert_allclose(q[0, :, 1], -0.05 * 9.81 / stiffness * (1.0 - np.cos(omega * times)), atol=1e-9)
    np.testing.assert_allclose(q[0, :, 0], 0.0, atol=1e-12)


def test_payload_on_a_universal_joint_swings_as_a_pendulum() -> None:
    """A point mass 0.1 m below the joint, tilted about one axis only, with the carrying arm too heavy to answer."""
    robot = load_robot("pendulum")
    arm = robot.model.lock(["pivot"], {}, robot.gravity)
    payload = pseudo_inertia(0.05, np.array([0.0, 0.0, -0.1]), 1e-10 * np.eye(3))
    hung = attach_payload_joint(arm, "tip", "universal", [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], payload)
    times = np.linspace(0.02, 0.6, 20)
    sim = simulator(hung, times, step_s=5e-4)
    p = named(sim, **{"q0[payload_swing_1]": 1.0, "armature[pivot]": 1e6})
    q, _ = sim.rollout(p[None])
    k, omega = np.sin(0.5), np.sqrt(9.81 / 0.1)
    exact = 2.0 * np.arcsin(k * ellipj(ellipk(k**2) - omega * times, k**2)[0])
    np.testing.assert_allclose(q[0, :, 1], exact, atol=1e-6)
    np.testing.assert_allclose(q[0, :, 2], 0.0, atol=1e-9)


def test_what_cannot_be_attached_is_said() -> None:
    arm = load_robot("pendulum").model.lock(["pivot"], {}, (0.0, 0.0, -9.81))
    payload = pseudo_inertia(0.05, np.zeros(3), 1e-6 * np.eye(3))
    with pytest.raises(SimulationError, match="prismatic, universal"):
        attach_payload_joint(arm, "tip", "ball", [0, 0, 1], payload)
    with pytest.raises(SimulationError, match="no frame 'hand'"):
        attach_payload_joint(arm, "hand", "prismatic", [0, 0, 1], payload)
    with pytest.raises(SimulationError, match="a column for each joint"):
        ChainSimulator(arm, np.array([0.1]), np.zeros(1), np.zeros((1, 2)), friction_velocity=1e-3)


# --- derivatives -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("integrator", ["rk4", "semi_implicit"])
@pytest.mark.parametrize("joints", [1, 2, 3])
def test_jacobian_three_ways(joints: int, integrator: str) -> None:
    """Every parameter of every joint at three points: tangent, tape to 1e-10, central differences to 1e-6."""
    reduced = whole(random_chain(joints, 40 + joints, branches=joints == 3))
    rng = np.random.default_rng(joints)
    times = np.sort(rng.uniform(0.0, 0.25, 8))
    times[0] = 0.001
    sim = ChainSimulator(
        reduced,
        times,
        np.array([0.0, 0.1]),
        rng.uniform(-0.4, 0.4, (2, joints)),
        friction_velocity=0.05,
        supply=[(2.0, 2.49, 5.22)] * joints,
        integrator=integrator,
        step_s=1 / 240,
    )
    ranges = {
        "torque_constant": 1.7, "coulomb": 0.03, "viscous": 0.01, "load_friction": 0.02, "armature": 0.012, "stiffness": 0.2,
        "q0": 0.5, "v0": 0.4,
    }  # fmt: skip
    points = []
    for delay in (0.004, -0.003, 0.0005):
        values = {
            f"{name}[j{i}]": scale * rng.uniform(0.5, 1.5) for name, scale in ranges.items() for i in range(joints)
        }
        p = named(sim, delay=delay, **values)
        p[sim.columns["pi"]] *= 1.0 + 0.2 * np.repeat(rng.uniform(0.0, 1.0, joints), 10)
        points.append(p)
    p = np.array(points)
    columns = p.shape[1]
    q, exact = sim.jacobian(p, np.tile(np.eye(columns), (3, 1, 1)))
    weights = rng.normal(size=q.shape)
    expected = np.einsum("wtn,wtnp->wp", weights, exact)
    np.testing.assert_allclose(sim.tape_gradient(p, weights), expected, rtol=1e-10, atol=1e-10 * np.abs(expected).max())
    for column, name in enumerate(sim.parameter_names):
        step = 1e-6 * max(np.abs(p[:, column]).max(), 0.2)
        up, down = p.copy(), p.copy()
        up[:, column] += step
        down[:, column] -= step
        difference = (sim.rollout(up)[0] - sim.rollout(down)[0]) / (2.0 * step)
        scale = np.abs(exact[..., column]).max()
        np.testing.assert_allclose(difference, exact[..., column], atol=1e-6 * scale + 5e-9, err_msg=name)
