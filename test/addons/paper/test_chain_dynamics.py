"""Rigid-body terms of chains and trees against MuJoCo, which reads the same URDF text and uses other algorithms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from support.chain_adjoint import bias, mass_matrix, pack, rigid_body_terms, rollout, tape_gradient

from proprio_ros.addons.paper.chain import ChainSimulator, attach_payload_joint
from proprio_ros.errors import SimulationError
from proprio_ros.robot import ReducedModel, RobotModel, pseudo_inertia
from proprio_ros.sim.joint import INDEX, PARAMETERS, JointRun, JointSimulator

mujoco = pytest.importorskip("mujoco")

GRAVITY = (1.0, -2.0, -9.0)
PAYLOAD = pseudo_inertia(
    0.08,
    (0.01, -0.02, -0.06),
    np.diag((4e-5, 5e-5, 6e-5)),
)
TREES = {
    "1": (-1,),
    "2": (-1, 0),
    "two from the base": (-1, -1),
    "3": (-1, 0, 1),
    "fork": (-1, 0, 0),
    "4": (-1, 0, 1, 2),
    "tree of 5": (-1, 0, 1, 1, 0),
    "7": (-1, 0, 1, 2, 3, 4, 5),
}


def random_urdf(
    parents: tuple[int, ...],
    seed: int,
) -> str:
    """Revolute and prismatic joints with rotated frames and axes, links with rotated inertials and full tensors."""
    rng = np.random.default_rng(seed)

    def triple(scale: float) -> str:
        return " ".join(
            repr(float(x))
            for x in rng.uniform(
                -scale,
                scale,
                3,
            )
        )

    text = ['<robot name="random"><link name="link_base"/>']
    for i, parent in enumerate(parents):
        factor = rng.normal(size=(3, 3))
        second = 1e-3 * factor @ factor.T
        tensor = np.trace(second) * np.eye(3) - second
        entries = " ".join(
            f'i{a}{b}="{float(tensor["xyz".index(a), "xyz".index(b)])!r}"'
            for a, b in ("xx", "yy", "zz", "xy", "xz", "yz")
        )
        kind = rng.choice(["revolute", "prismatic", "continuous"])
        text.append(
            f'<link name="link_{i}"><inertial><origin xyz="{triple(0.1)}" rpy="{triple(3.0)}"/>'
            f'<mass value="{rng.uniform(0.1, 1.0)!r}"/><inertia {entries}/></inertial></link>'
            f'<joint name="joint_{i}" type="{kind}">'
            f'<parent link="link_{"base" if parent < 0 else parent}"/><child link="link_{i}"/>'
            f'<origin xyz="{triple(0.3)}" rpy="{triple(3.0)}"/><axis xyz="{triple(1.0)}"/>'
            '<limit lower="-50" upper="50" velocity="50" effort="50"/></joint>'
        )
    return "".join([*text, "</robot>"])


def reduced(text: str) -> ReducedModel:
    model = RobotModel.from_urdf_string(text)
    return model.lock(model.independent_joints, {}, gravity=GRAVITY)


def addresses(
    model: Any,
    names: tuple[str, ...],
) -> list[int]:
    return [int(model.joint(name).dofadr[0]) for name in names]


def mujoco_terms(
    model: Any,
    names: tuple[str, ...],
    q: np.ndarray,
    v: np.ndarray,
    a: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Mass matrix and inverse dynamics in the order of the named joints."""
    at = addresses(model, names)
    data = mujoco.MjData(model)
    data.qpos[at], data.qvel[at], data.qacc[at] = q, v, a
    mujoco.mj_inverse(model, data)
    mass = np.zeros((model.nv, model.nv))
    if hasattr(data, "qM"):
        mujoco.mj_fullM(model, mass, data.qM)
    else:  # MuJoCo 4
        mujoco.mj_fullM(model, data, mass)
    return mass[np.ix_(at, at)], data.qfrc_inverse[at]


def assert_same_terms(
    model: Any,
    ours: ReducedModel,
    seed: int,
    tolerance: float = 1e-9,
) -> None:
    rng = np.random.default_rng(seed)
    q, v, a = rng.uniform(
        -3.0,
        3.0,
        (3, 5, len(ours.joint_names)),
    )
    masses, torques = rigid_body_terms(ours, q, v, a)
    np.testing.assert_array_equal(mass_matrix(ours, q), masses)
    np.testing.assert_allclose(
        np.einsum("bij,bj->bi", masses, a) + bias(ours, q, v),
        torques,
        atol=1e-12 * np.abs(torques).max(),
    )
    for state in range(len(q)):
        mass, torque = mujoco_terms(
            model,
            ours.joint_names,
            q[state],
            v[state],
            a[state],
        )
        np.testing.assert_allclose(
            masses[state],
            mass,
            atol=tolerance * np.abs(mass).max(),
        )
        np.testing.assert_allclose(
            torques[state],
            torque,
            atol=tolerance * np.abs(torque).max(),
        )


LARGE = [pytest.param(tree, marks=pytest.mark.long) for tree in ("tree of 5", "7")]


@pytest.mark.long
@pytest.mark.parametrize("tree", [*(tree for tree in TREES if len(TREES[tree]) < 5), *LARGE])
def test_mass_matrix_and_inverse_dynamics(tree: str) -> None:
    for seed in range(5):
        text = random_urdf(TREES[tree], seed)
        model = mujoco.MjModel.from_xml_string(text)
        model.opt.gravity[:] = GRAVITY
        assert_same_terms(model, reduced(text), seed)


@pytest.mark.long
@pytest.mark.parametrize("kind", ["prismatic", "universal"])
@pytest.mark.parametrize("frame", ["link_1", "link_base"])
def test_payload_joint(kind: str, frame: str) -> None:
    """MuJoCo takes two hinges in one body where we have a massless body between them."""
    text = random_urdf((-1, 0), 3)
    axes = np.array([[1.0, 2.0, -1.0], [0.0, 1.0, 2.0]])[: 1 if kind == "prismatic" else 2]
    ours = attach_payload_joint(
        reduced(text), frame, kind, axes[0] if kind == "prismatic" else axes, PAYLOAD
    )
    spec = mujoco.MjSpec.from_string(text)
    spec.option.gravity = GRAVITY
    body = (spec.worldbody if frame == "link_base" else spec.body(frame)).add_body(name="payload")
    body.mass, body.ipos, body.explicitinertial = 0.08, (0.01, -0.02, -0.06), True
    body.fullinertia = [4e-5, 5e-5, 6e-5, 0.0, 0.0, 0.0]
    for name, axis in zip(ours.joint_names[2:], axes, strict=True):
        joint = body.add_joint(name=name, axis=axis)
        joint.type = (
            mujoco.mjtJoint.mjJNT_SLIDE if kind == "prismatic" else mujoco.mjtJoint.mjJNT_HINGE
        )
    assert ours.frames["payload"][0] == len(ours.joint_names) - 1
    assert_same_terms(spec.compile(), ours, 4)


@pytest.mark.long
@pytest.mark.parametrize("tree", ["3", "fork", "two from the base"])
def test_acceleration(tree: str) -> None:
    """One step of semi-implicit Euler shows the acceleration: torque, armature, damping and springs as MuJoCo has them."""
    text = random_urdf(TREES[tree], 11)
    ours = reduced(text)
    n = len(ours.joint_names)
    rng = np.random.default_rng(12)
    values = {
        name: rng.uniform(0.1, 1.0, n)
        for name in ("torque_constant", "viscous", "armature", "stiffness", "q0", "v0")
    }
    current = rng.uniform(-2.0, 2.0, n)
    h = 1e-3
    sim = ChainSimulator(
        ours, [h], [0.0], current[None], friction_velocity=1.0, integrator="semi_implicit", step_s=h
    )
    q, v = rollout(sim, pack(sim, **values))

    model = mujoco.MjModel.from_xml_string(text)
    model.opt.gravity[:] = GRAVITY
    at = addresses(model, ours.joint_names)
    model.dof_armature[at], model.jnt_stiffness[at] = values["armature"], values["stiffness"]
    model.dof_damping.reshape(n, -1)[at, 0] = values["viscous"]  # MuJoCo 4 has a polynomial
    data = mujoco.MjData(model)
    data.qpos[at], data.qvel[at] = values["q0"], values["v0"]
    data.qfrc_applied[at] = values["torque_constant"] * current
    mujoco.mj_forward(model, data)
    expected = data.qacc[at]
    np.testing.assert_allclose(
        (v[0, 0] - values["v0"]) / h, expected, atol=1e-9 * np.abs(expected).max()
    )
    np.testing.assert_allclose(
        (q[0, 0] - values["q0"]) / h,
        v[0, 0],
        rtol=1e-9,
    )


def bodies_of_joint(model: ReducedModel, armature: float) -> dict[str, float]:
    """Inertia and load of one joint, g_a cos q + g_b sin q + g_c, as the one-joint law has them."""
    angles = np.array([[0.0], [0.5 * np.pi], [np.pi]])
    load = bias(model, angles, np.zeros((3, 1)))[:, 0]
    constant = 0.5 * (load[0] + load[2])
    return {
        "inertia": mass_matrix(model, [[0.0]])[0, 0, 0] + armature,
        "gravity_cos": load[0] - constant,
        "gravity_sin": load[1] - constant,
        "gravity_constant": constant,
    }


@pytest.mark.long
@pytest.mark.parametrize("integrator", ["rk4", "semi_implicit"])
def test_one_joint_is_the_one_joint_law(integrator: str) -> None:
    """Dry and load-dependent friction, supply limit, delay and finer steps near standstill, in another implementation."""
    ours = reduced(random_urdf((-1,), 4))
    assert ours.kinds == ("revolute",)
    law = {"torque_constant": 1.7, "coulomb": 0.03, "viscous": 0.01, "load_friction": 0.02}
    start = {"delay": 0.004, "q0": 0.5, "v0": -0.1}
    row = np.zeros((1, len(PARAMETERS)))
    for name, value in {**bodies_of_joint(ours, 0.012), **law, **start}.items():
        row[0, INDEX[name]] = value
    times = np.linspace(0.001, 0.6, 20)
    switches = np.array([0.0, 0.21])
    current = np.array([-0.3, 0.25])
    steps = {"step_s": 1 / 240, "fine_step_s": 1 / 2000}
    supply = (1.0, 2.49, 5.22)
    run = JointRun(
        times,
        switches,
        current,
        supply=supply,
        friction_velocity=0.01,
        **steps,
    )
    q, v = JointSimulator([run], integrator).rollout(
        np.zeros(1, dtype=np.int32),
        row,
    )
    sim = ChainSimulator(
        ours,
        times,
        switches,
        current[:, None],
        friction_velocity=0.01,
        supply=[supply],
        integrator=integrator,
        **steps,
    )
    chain_q, chain_v = rollout(
        sim,
        pack(sim, **law, **start, armature=0.012),
    )
    assert np.ptp(q) > 0.1
    np.testing.assert_allclose(
        chain_q[0, :, 0],
        q[0],
        atol=1e-11,
    )
    np.testing.assert_allclose(
        chain_v[0, :, 0],
        v[0],
        atol=1e-10,
    )


def test_parameters_by_name() -> None:
    ours = reduced(random_urdf((-1, 0), 2))
    sim = ChainSimulator(
        ours,
        [0.1],
        [0.0],
        np.zeros((1, 2)),
        friction_velocity=(0.1, 0.2),
    )
    index = {name: column for column, name in enumerate(sim.parameter_names)}
    assert len(index) == 18 * 2 + 1
    p = pack(
        sim, armature=0.01, stiffness=(0.0, 3.0), delay=(0.004, 0.005), q0=[[0.1, 0.2], [0.3, 0.4]]
    )
    assert p.shape == (2, 37)
    assert p[1, index["delay"]] == 0.005
    assert p[1, index["q0[joint_0]"]] == 0.3
    assert p[0, index["stiffness[joint_1]"]] == 3.0
    assert p[0, index["armature[joint_0]"]] == 0.01
    assert p[0, index["pi[joint_1][0]"]] == ours.pseudo_inertia[1, 3, 3]
    assert p[0, index["pi[joint_1][2]"]] == ours.pseudo_inertia[1, 1, 3]
    # -int x y dm: the product of inertia as an entry of the tensor
    assert p[0, index["pi[joint_1][7]"]] == -ours.pseudo_inertia[1, 0, 1]
    with pytest.raises(
        SimulationError, match=r"parameters have shape \(37,\): give \(worlds, 37\)"
    ):
        rollout(sim, p[0])
    with pytest.raises(
        SimulationError, match=r"directions have shape \(2, 37\): give \(2, 37, D\)"
    ):
        sim.jacobian(p, p)
    with pytest.raises(SimulationError, match=r"weights have shape \(1, 1, 2\): give \(2, 1, 2\)"):
        tape_gradient(
            sim,
            p,
            np.zeros((1, 1, 2)),
        )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"integrator": "euler"}, "unknown integrator 'euler': choose one of rk4, semi_implicit"),
        ({"sample_times_s": []}, "sample_times_s must be"),
        ({"sample_times_s": [0.2, 0.1]}, "sample_times_s must be"),
        ({"input_times_s": [0.1]}, "input_times_s must be"),
        (
            {"input_current_A": np.zeros((1, 2))},
            r"input_current_A has shape \(1, 2\): give a row for each of the 1 .*joint_0",
        ),
        ({"step_s": 0.0}, "must be positive"),
        ({"fine_step_s": -1.0}, "must be positive"),
        ({"supply": (12.0, 1.0, 1.0)}, "supply must be"),
        ({"supply": [(12.0, 1.0, 0.0)]}, "supply must be"),
        ({"friction_velocity": 0.0}, "friction_velocity must be"),
        ({"friction_velocity": (0.1, 0.1)}, "friction_velocity must be"),
    ],
)
def test_what_cannot_be_simulated_is_said(
    change: dict[str, Any],
    message: str,
) -> None:
    run = {
        "sample_times_s": [0.1],
        "input_times_s": [0.0],
        "input_current_A": np.zeros((1, 1)),
        "friction_velocity": 0.1,
    }
    with pytest.raises(SimulationError, match=message):
        ChainSimulator(
            reduced(random_urdf((-1,), 1)),
            **{**run, **change},
        )


def test_a_tape_that_would_not_fit_is_refused() -> None:
    ours = reduced(random_urdf((-1,), 1))
    sim = ChainSimulator(
        ours,
        [0.3],
        [0.0],
        np.zeros((1, 1)),
        friction_velocity=0.1,
        step_s=1e-6,
    )
    with pytest.raises(SimulationError, match=r"30\d\d\d\d steps are too many for a tape"):
        tape_gradient(
            sim,
            pack(sim),
            np.ones((1, 1, 1)),
        )


@pytest.mark.parametrize(
    ("frame", "kind", "axes", "pseudo", "message"),
    [
        ("hand", "prismatic", [0, 0, 1], PAYLOAD, "no frame 'hand' .*link_base, link_0"),
        (
            "link_0",
            "ball",
            [0, 0, 1],
            PAYLOAD,
            "unknown payload joint 'ball': choose one of prismatic, universal",
        ),
        ("link_0", "prismatic", [[0, 0, 1]], PAYLOAD, r"needs non-zero axes of shape \(3,\)"),
        (
            "link_0",
            "universal",
            [[0, 0, 1], [0, 0, 0]],
            PAYLOAD,
            r"needs non-zero axes of shape \(2, 3\)",
        ),
        (
            "link_0",
            "universal",
            [[0, 0, 1], [0, 0, 2]],
            PAYLOAD,
            "no inertia against its universal joint",
        ),
        (
            "link_0",
            "prismatic",
            [0, 0, 1],
            np.zeros((4, 4)),
            "no inertia against its prismatic joint",
        ),
        ("link_0", "prismatic", [0, 0, 1], np.full((4, 4), np.nan), "finite 4 x 4"),
    ],
)
def test_what_cannot_be_attached_is_said(
    frame: str,
    kind: str,
    axes: Any,
    pseudo: np.ndarray,
    message: str,
) -> None:
    with pytest.raises(SimulationError, match=message):
        attach_payload_joint(
            reduced(random_urdf((-1,), 1)),
            frame,
            kind,
            axes,
            pseudo,
        )


def test_a_payload_joint_needs_a_new_name() -> None:
    ours = reduced(random_urdf((-1,), 1))
    once = attach_payload_joint(
        ours,
        "link_0",
        "prismatic",
        (0, 0, 1),
        PAYLOAD,
    )
    with pytest.raises(SimulationError, match="'payload' is already a joint or frame"):
        attach_payload_joint(once, "link_0", "prismatic", (0, 0, 1), PAYLOAD)
    twice = attach_payload_joint(
        once,
        "payload",
        "prismatic",
        (0, 1, 0),
        PAYLOAD,
        name="second",
    )
    assert twice.joint_names == ("joint_0", "payload_slide", "second_slide")
    assert tuple(twice.parents) == (-1, 0, 1)
