"""Rollouts of chains against closed forms, conservation laws and an independently written Lagrangian."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import ellipj, ellipk
from support.chain_adjoint import bias, mass_matrix, pack, rollout

from proprio_ros.addons.paper.chain import ChainSimulator, attach_payload_joint
from proprio_ros.robot import ReducedModel, pseudo_inertia

G = 9.81
LENGTHS = (0.3, 0.25)
MASSES = (0.4, 0.2)
INERTIAS = (3e-3, 1e-3)
CENTRES = (0.2, 0.15)  # of mass, from each hinge


def model(
    kinds: tuple[str, ...],
    axes: list[tuple[float, ...]],
    offsets: list[tuple[float, ...]],
    bodies: list[np.ndarray],
) -> ReducedModel:
    n = len(kinds)
    placement = np.tile(
        np.eye(4),
        (n, 1, 1),
    )
    placement[:, :3, 3] = offsets
    return ReducedModel(
        joint_names=tuple(f"joint_{i}" for i in range(n)),
        kinds=kinds,
        parents=np.arange(-1, n - 1),
        placement=placement,
        axes=np.array(axes, dtype=np.float64),
        pseudo_inertia=np.array(bodies),
        gravity=np.array([0.0, 0.0, -G]),
        frames={
            "base": (-1, np.eye(4)),
            "tip": (n - 1, np.eye(4)),
        },
    )


def hanging(count: int) -> ReducedModel:
    """One or two links that hang down from hinges about y."""
    bodies = [
        pseudo_inertia(
            MASSES[i],
            (0.0, 0.0, -CENTRES[i]),
            np.diag((1e-3, INERTIAS[i], 1e-3)),
        )
        for i in range(count)
    ]
    offsets = [(0.1, 0.2, 0.3), (0.0, 0.0, -LENGTHS[0])][:count]
    return model(
        ("revolute",) * count,
        [(0.0, 1.0, 0.0)] * count,
        offsets,
        bodies,
    )


def free(reduced: ReducedModel, times: np.ndarray, **options: object) -> ChainSimulator:
    """Nothing drives it."""
    return ChainSimulator(
        reduced,
        times,
        [0.0],
        np.zeros((1, len(reduced.joint_names))),
        friction_velocity=1.0,
        **options,
    )


def lagrangian(_: float, state: np.ndarray) -> np.ndarray:
    """Double pendulum with angles a from the vertical and a + b: Lagrange's equations written out.

    T = 1/2 (J1 + m2 l1^2) a'^2 + 1/2 J2 (a' + b')^2 + m2 l1 c2 a' (a' + b') cos b,  J about each hinge,
    V = -(m1 c1 + m2 l1) g cos a - m2 c2 g cos(a + b).
    """
    a, b, va, vb = state
    inner = INERTIAS[0] + MASSES[0] * CENTRES[0] ** 2 + MASSES[1] * LENGTHS[0] ** 2
    outer = INERTIAS[1] + MASSES[1] * CENTRES[1] ** 2
    couple = MASSES[1] * LENGTHS[0] * CENTRES[1]
    mixed = outer + couple * np.cos(b)
    mass = np.array([[inner + outer + 2.0 * couple * np.cos(b), mixed], [mixed, outer]])
    gravity_inner = (MASSES[0] * CENTRES[0] + MASSES[1] * LENGTHS[0]) * G * np.sin(a)
    gravity_outer = MASSES[1] * CENTRES[1] * G * np.sin(a + b)
    forces = np.array(
        [
            couple * np.sin(b) * (2.0 * va * vb + vb**2) - gravity_inner - gravity_outer,
            -couple * np.sin(b) * va**2 - gravity_outer,
        ]
    )
    return np.array([va, vb, *np.linalg.solve(mass, forces)])


@pytest.mark.parametrize("amplitude", [0.1, 1.5, 3.0])
def test_pendulum_with_large_swing(amplitude: float) -> None:
    """Period T = 4 K(k) / w with k = sin(amplitude / 2); from rest, sin(q / 2) = k cd(w t).

    The elliptic integral with amplitude 3 rad is 1.6 times that of small swings. Error of RK4 at 1 ms: about 1e-10.
    """
    omega = np.sqrt(MASSES[0] * G * CENTRES[0] / (INERTIAS[0] + MASSES[0] * CENTRES[0] ** 2))
    k = np.sin(0.5 * amplitude)
    period = 4.0 * ellipk(k**2) / omega
    times = np.array([0.13, 0.25, 0.5, 0.77, 1.0]) * period
    sim = free(hanging(1), times, step_s=1e-3)
    q, v = rollout(sim, pack(sim, q0=amplitude))
    _, cn, dn, _ = ellipj(omega * times, k**2)
    np.testing.assert_allclose(
        q[0, :, 0],
        2.0 * np.arcsin(k * cn / dn),
        atol=1e-8,
    )
    np.testing.assert_allclose(
        q[0, [2, 4], 0],
        [-amplitude, amplitude],
        atol=1e-8,
    )
    np.testing.assert_allclose(
        v[0, [2, 4], 0],
        0.0,
        atol=1e-8,
    )


@pytest.mark.long
def test_double_pendulum_against_its_lagrangian() -> None:
    """Error of RK4 at 0.5 ms is about 1e-10 here; the reference's is 1e-11."""
    times = np.linspace(0.05, 2.0, 40)
    start = [1.2, -0.7, 0.5, -2.0]
    sim = free(hanging(2), times, step_s=5e-4)
    q, v = rollout(
        sim,
        pack(
            sim,
            q0=start[:2],
            v0=start[2:],
        ),
    )
    exact = solve_ivp(
        lagrangian, (0.0, 2.0), start, t_eval=times, method="DOP853", rtol=1e-12, atol=1e-13
    ).y
    np.testing.assert_allclose(
        q[0],
        exact[:2].T,
        atol=1e-8,
    )
    np.testing.assert_allclose(
        v[0],
        exact[2:].T,
        atol=1e-7,
    )


@pytest.mark.long
def test_energy_of_the_double_pendulum() -> None:
    """T = 1/2 v H v and V = -sum m g z from forward kinematics; RK4's error falls with the step's fourth power."""
    times = np.linspace(0.01, 2.0, 200)
    drift = []
    for step in (1e-3, 2.5e-4):
        sim = free(hanging(2), times, step_s=step)
        q, v = (values[0] for values in rollout(sim, pack(sim, q0=(2.0, 0.5))))
        kinetic = 0.5 * np.einsum("ti,tij,tj->t", v, mass_matrix(sim.model, q), v)
        elbow = -LENGTHS[0] * np.cos(q[:, 0])
        potential = G * (
            -MASSES[0] * CENTRES[0] * np.cos(q[:, 0])
            + MASSES[1] * (elbow - CENTRES[1] * np.cos(q.sum(axis=1)))
        )
        total = kinetic + potential
        drift.append(np.ptp(total) / np.ptp(potential))
    assert drift[0] < 1e-6
    assert drift[1] < 1e-9
    assert drift[1] < drift[0] / 200.0  # 4^4 = 256


def test_gravity_of_the_double_pendulum_is_the_gradient_of_its_potential() -> None:
    q = np.array([[0.7, -1.3]])
    expected = lagrangian(0.0, np.array([0.7, -1.3, 0.0, 0.0]))[2:]
    np.testing.assert_allclose(
        np.linalg.solve(
            mass_matrix(hanging(2), q)[0],
            -bias(hanging(2), q, np.zeros((1, 2)))[0],
        ),
        expected,
        rtol=1e-12,
    )


def test_constant_force_on_a_slide_gives_a_parabola() -> None:
    """x = x0 + v0 t + (F/m - g) t^2 / 2 on a vertical slide; RK4 is exact. Before the onset it moves on with v0."""
    body = pseudo_inertia(
        0.5,
        (0.1, -0.2, 0.3),
        1e-3 * np.eye(3),
    )
    reduced = model(
        ("prismatic",),
        [(0.0, 0.0, 1.0)],
        [(0.3, 0.1, 0.0)],
        [body],
    )
    times = np.array([0.005, 0.01, 0.013, 0.2, 0.31, 0.8])
    sim = ChainSimulator(
        reduced,
        times,
        [0.0],
        [[3.0]],
        friction_velocity=1.0,
        step_s=0.05,
    )
    q, v = rollout(
        sim,
        pack(
            sim,
            torque_constant=2.0,
            delay=0.01,
            q0=0.2,
            v0=0.4,
            armature=0.1,
        ),
    )
    since = times - 0.01
    a = (6.0 - 0.5 * G) / 0.6
    np.testing.assert_allclose(
        q[0, :, 0], 0.2 + 0.4 * since + 0.5 * a * np.maximum(since, 0.0) ** 2, atol=1e-14
    )
    np.testing.assert_allclose(
        v[0, :, 0],
        0.4 + a * np.maximum(since, 0.0),
        atol=1e-13,
    )


def test_changes_of_the_input_are_met_exactly() -> None:
    """Force on, off and reversed at instants that are no multiple of the step: parabolas and a line, joined smoothly."""
    reduced = model(
        ("prismatic",),
        [(1.0, 0.0, 0.0)],
        [(0.0, 0.0, 0.0)],
        [
            pseudo_inertia(
                2.0,
                np.zeros(3),
                np.eye(3),
            )
        ],
    )
    switches = np.array([0.0, 0.123, 0.301])
    force = np.array([4.0, 0.0, -4.0])
    times = np.linspace(0.05, 0.5, 10)
    sim = ChainSimulator(
        reduced, times, switches, force[:, None], friction_velocity=1.0, step_s=0.07
    )
    v = sum(
        f / 2.0 * np.clip(times - on, 0.0, off - on)
        for f, on, off in zip(
            force,
            switches,
            [*switches[1:], 9.0],
            strict=True,
        )
    )
    np.testing.assert_allclose(
        rollout(sim, pack(sim, torque_constant=1.0))[1][0, :, 0], v, atol=1e-14
    )


def test_velocity_decays_under_viscous_friction() -> None:
    """v = v0 exp(-f_v t / m). RK4 at 5 ms is off by (f_v h / m)^5 / 120 a step, 4e-11 after a second."""
    reduced = model(
        ("prismatic",),
        [(1.0, 0.0, 0.0)],
        [(0.0, 0.0, 0.0)],
        [
            pseudo_inertia(
                2.0,
                np.zeros(3),
                np.eye(3),
            )
        ],
    )
    times = np.linspace(0.1, 1.0, 5)
    sim = free(reduced, times, step_s=0.005)
    v = rollout(sim, pack(sim, viscous=3.0, v0=1.5))[1]
    np.testing.assert_allclose(
        v[0, :, 0],
        1.5 * np.exp(-1.5 * times),
        rtol=1e-10,
    )


def test_payload_on_a_spring_slide() -> None:
    """A cart M carries a payload m on a spring k along its way, released from a stretch A.

    No force from outside: M x + m (x + y) keeps still. Hence y = A cos(w t), x = m (A - y) / (M + m), w^2 = k (1/M + 1/m).
    """
    cart = 0.7
    payload = 0.2
    k = 30.0
    stretch = 0.05
    body = pseudo_inertia(
        cart,
        (0.0, 0.1, 0.2),
        1e-3 * np.eye(3),
    )
    alone = model(
        ("prismatic",),
        [(1.0, 0.0, 0.0)],
        [(0.2, 0.0, 0.1)],
        [body],
    )
    hung = attach_payload_joint(
        alone,
        "tip",
        "prismatic",
        (2.0, 0.0, 0.0),
        pseudo_inertia(
            payload,
            (0.3, 0.1, 0.0),
            1e-4 * np.eye(3),
        ),
    )
    times = np.linspace(0.02, 1.0, 50)
    sim = free(hung, times, step_s=1e-3)
    q, _ = rollout(
        sim,
        pack(
            sim,
            stiffness=(0.0, k),
            q0=(0.0, stretch),
        ),
    )
    y = stretch * np.cos(np.sqrt(k * (1.0 / cart + 1.0 / payload)) * times)
    np.testing.assert_allclose(
        q[0, :, 1],
        y,
        atol=1e-9,
    )
    np.testing.assert_allclose(
        q[0, :, 0],
        payload * (stretch - y) / (cart + payload),
        atol=1e-9,
    )


@pytest.mark.long
def test_payload_on_a_universal_joint_circles_as_a_conical_pendulum() -> None:
    """A point at length l on a cone of half angle c circles with W = sqrt(g / (l cos c)); an armature of 1e12 holds the cart."""
    length = 0.15
    cone = 0.6
    cart = model(
        ("prismatic",),
        [(1.0, 0.0, 0.0)],
        [(0.0, 0.0, 0.0)],
        [
            pseudo_inertia(
                1.0,
                np.zeros(3),
                1e-3 * np.eye(3),
            )
        ],
    )
    point = pseudo_inertia(
        0.05,
        (0.0, 0.0, -length),
        np.zeros((3, 3)),
    )
    hung = attach_payload_joint(
        cart,
        "tip",
        "universal",
        [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0)],
        point,
    )
    rate = np.sqrt(G / (length * np.cos(cone)))
    times = np.linspace(0.02, 2.0, 50)
    sim = free(hung, times, step_s=5e-4)
    # hinges about x, then y: the point is at l (-sin b, sin a cos b, -cos a cos b); it starts at b = -c, moving along y
    q, _ = rollout(
        sim,
        pack(
            sim, armature=(1e12, 0.0, 0.0), q0=(0.0, 0.0, -cone), v0=(0.0, rate * np.tan(cone), 0.0)
        ),
    )
    a = q[0, :, 1]
    b = q[0, :, 2]
    place = length * np.stack([-np.sin(b), np.sin(a) * np.cos(b), -np.cos(a) * np.cos(b)], axis=1)
    circle = np.stack(
        [
            np.sin(cone) * np.cos(rate * times),
            np.sin(cone) * np.sin(rate * times),
        ],
        axis=1,
    )
    np.testing.assert_allclose(
        place[:, :2],
        length * circle,
        atol=1e-9,
    )
    np.testing.assert_allclose(
        place[:, 2],
        -length * np.cos(cone),
        atol=1e-9,
    )


def test_semi_implicit_euler_is_the_papers_equation() -> None:
    """Equation (2) by hand: v' = v + h a(q, v), q' = q + h v', with substeps of 1/60 s."""
    reduced = hanging(2)
    h = 1.0 / 60.0 / 4.0
    count = 40
    sim = free(
        reduced,
        h * np.arange(1, count + 1),
        integrator="semi_implicit",
        step_s=h,
    )
    q, v = rollout(
        sim,
        pack(
            sim,
            q0=(1.0, -0.5),
            v0=(0.3, 0.2),
        ),
    )
    state = np.array([1.0, -0.5])
    rate = np.array([0.3, 0.2])
    for step in range(count):
        rate = rate + h * lagrangian(0.0, np.concatenate([state, rate]))[2:]
        state = state + h * rate
        np.testing.assert_allclose(
            q[0, step],
            state,
            atol=1e-11,
        )
        np.testing.assert_allclose(
            v[0, step],
            rate,
            atol=1e-11,
        )


@pytest.mark.parametrize(("integrator", "order"), [("rk4", 4), ("semi_implicit", 1)])
def test_order_of_convergence(integrator: str, order: int) -> None:
    """Halving the step divides the error by 2 to the order, with a last step that is cut short."""
    times = np.array([0.3337])
    start = [1.0, 0.5, -1.0, 2.0]
    exact = solve_ivp(
        lagrangian, (0.0, times[0]), start, method="DOP853", rtol=1e-13, atol=1e-14
    ).y[:2, -1]
    errors = []
    for step in (1 / 200, 1 / 400, 1 / 800):
        sim = free(
            hanging(2),
            times,
            integrator=integrator,
            step_s=step,
        )
        errors.append(
            np.abs(
                rollout(
                    sim,
                    pack(
                        sim,
                        q0=start[:2],
                        v0=start[2:],
                    ),
                )[0][0, 0]
                - exact
            ).max()
        )
    observed = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(observed, order, atol=0.15)
