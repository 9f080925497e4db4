"""A sphere in a moving container against laws and simulators that share nothing with ours."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import ArrayLike
from scipy.integrate import cumulative_simpson, solve_ivp
from scipy.spatial.transform import Rotation
from support.plain_laws import states_of

from proprio_ros.errors import SimulationError
from proprio_ros.sim.joint import PARAMETERS, JointRun, JointSimulator
from proprio_ros.sim.sphere import (
    LAWS,
    SPHERE_INDEX,
    SPHERE_PARAMETERS,
    Contact,
    Enclosure,
    SphereRun,
    SphereSimulator,
    paper_contact,
)

pytestmark = pytest.mark.long

ONE = np.zeros(1, dtype=np.int32)
G = 9.81
AXIS = np.array([0.2, 0.9, -0.4]) / np.linalg.norm([0.2, 0.9, -0.4])
GRAVITY = np.array([3.0, -2.0, -9.1])  # at q = 0, which is where world and container frame agree
ORIGIN = np.array([-0.15, 0.02, 0.03])
BOX = Enclosure(
    "box",
    np.array([0.06, 0.04, 0.045]),
    0.01,
)
HARD = Contact.of(400.0, 0.4, 0.35)
HELD = 1e9  # kg m^2: nothing that a sphere does turns this joint


def parameters(
    contact: Contact = HARD, start: ArrayLike = (0.0, 0.0, 0.0), **values: float
) -> np.ndarray:
    p = np.zeros((1, len(SPHERE_PARAMETERS)))
    known = {
        "inertia": 0.02, "sphere_mass": 0.03, "stiffness": contact.stiffness, "damping": contact.damping,
        "traction": contact.traction, "friction": contact.friction, "torque_constant": 1.0, "stribeck_velocity": 0.1,
        **dict(zip(("start_x", "start_y", "start_z"), np.asarray(start, dtype=float), strict=True,)),
    }  # fmt: skip
    for name, value in {**known, **values}.items():
        p[0, SPHERE_INDEX[name]] = value
    return p


def simulator(
    times: np.ndarray,
    inside: Enclosure = BOX,
    kind: str = "revolute",
    axis: np.ndarray = AXIS,
    origin: np.ndarray = ORIGIN,
    gravity: np.ndarray = GRAVITY,
    current: float = 0.0,
    step: float = 1e-3,
    law: str = "ramped",
    integrator: str = "rk4",
) -> SphereSimulator:
    joint = JointRun(
        times,
        np.zeros(1),
        np.array([current]),
        step_s=step,
        fine_step_s=step,
    )
    return SphereSimulator(
        [SphereRun(joint, kind, axis, origin, gravity)],
        inside,
        law,
        integrator,
    )


def resting_on(
    gravity: np.ndarray,
    inside: Enclosure,
    contact: Contact,
) -> np.ndarray:
    """Centre of a sphere that all three walls of a box towards which gravity points carry."""
    return np.sign(gravity) * inside.room + gravity / contact.stiffness


def world_place(
    kind: str,
    q: np.ndarray,
    x: np.ndarray,
) -> np.ndarray:
    """Of points x of the container (T, 3) while the joint is at q (T,), from a point on its axis [m]."""
    if kind == "revolute":
        return Rotation.from_rotvec(q[:, None] * AXIS).apply(x - ORIGIN)
    return x - ORIGIN + q[:, None] * AXIS


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_a_sphere_that_touches_nothing_is_a_projectile(kind: str) -> None:
    """Its centre flies on a parabola in the world while the container turns around it."""
    times = np.linspace(0.01, 0.3, 30)
    large = Enclosure("box", np.full(3, 3.0), 0.01)
    start = np.array([0.03, -0.02, 0.05])
    q0 = 0.4
    v0 = 1.5
    sim = simulator(times, large, kind, current=0.05, step=1e-3)
    q, v, x, u, spin = (
        s[0]
        for s in states_of(
            sim,
            ONE,
            parameters(start=start, q0=q0, v0=v0, gravity_cos=0.03),
        )
    )
    assert abs(v[-1] - v[0]) > 0.1
    begin = world_place(kind, np.array([q0]), start[None])[0]
    if kind == "revolute":
        velocity = v0 * np.cross(AXIS, begin)
        spinning = v0 * AXIS
        to_world = Rotation.from_rotvec(q[:, None] * AXIS)
    else:
        velocity = v0 * AXIS
        spinning = np.zeros(3)
        to_world = Rotation.identity(len(q))
    flight = begin + times[:, None] * velocity + 0.5 * times[:, None] ** 2 * GRAVITY
    np.testing.assert_allclose(
        world_place(kind, q, x),
        flight,
        atol=1e-9,
    )
    np.testing.assert_allclose(
        to_world.apply(u),
        velocity + times[:, None] * GRAVITY,
        atol=1e-8,
    )
    np.testing.assert_allclose(
        to_world.apply(spin),
        np.tile(spinning, (len(q), 1)),
        atol=1e-9,
    )


@pytest.mark.parametrize("integrator", ["rk4", "semi_implicit"])
def test_a_sphere_without_mass_leaves_the_joint_alone(integrator: str) -> None:
    rng = np.random.default_rng(1)
    joint = JointRun(
        np.sort(rng.uniform(0.0, 0.5, 20)), np.array([0.0, 0.21]), np.array([0.3, -0.35]), (4.0, 2.49, 5.22), 0.02, 1e-3, 1e-3
    )  # fmt: skip
    p = parameters(
        sphere_mass=0.0, gravity_cos=0.1, gravity_sin=-0.05, gravity_constant=0.02, torque_constant=1.78, coulomb=0.03,
        viscous=0.01, load_friction=0.05, delay=0.004, q0=0.3, v0=0.2, stribeck=0.3, stribeck_velocity=0.2,
    )  # fmt: skip
    sim = SphereSimulator(
        [
            SphereRun(
                joint,
                "revolute",
                AXIS,
                ORIGIN,
                GRAVITY,
            )
        ],
        BOX,
        integrator=integrator,
    )
    q, v, x, *_ = states_of(sim, ONE, p)
    alone = JointSimulator([joint], integrator).rollout(
        ONE,
        p[:, : len(PARAMETERS)],
    )
    np.testing.assert_allclose(q, alone[0], atol=1e-13)
    np.testing.assert_allclose(v, alone[1], atol=1e-12)
    assert np.ptp(x[0], axis=0).max() > 0.01  # it moved and bounced all the same
    p[0, SPHERE_INDEX["sphere_mass"]] = 0.03
    assert np.abs(states_of(sim, ONE, p)[0] - q).max() > 1e-3


@pytest.mark.parametrize("law", LAWS)
def test_a_sphere_at_rest_in_a_corner_stays_there(law: str) -> None:
    """Three walls carry it, each pressed as deep as its share of the weight asks for."""
    start = resting_on(GRAVITY, BOX, HARD)
    states = states_of(
        simulator(
            np.linspace(0.05, 1.0, 20),
            law=law,
        ),
        ONE,
        parameters(start=start, inertia=HELD),
    )
    np.testing.assert_allclose(
        states[2][0],
        np.tile(start, (20, 1)),
        atol=1e-9,
    )
    # and it comes to rest there from elsewhere
    off = start - 0.003 * np.sign(GRAVITY)
    x = states_of(
        simulator(np.linspace(1.0, 2.0, 20), law=law), ONE, parameters(start=off, inertia=HELD)
    )[2][0]
    np.testing.assert_allclose(
        x,
        np.tile(start, (20, 1)),
        atol=1e-6,
    )


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_the_weight_of_a_sphere_at_rest_is_on_the_joint(kind: str) -> None:
    """A joint so heavy that it hardly moves feels the sphere's weight at the sphere's place; a light one a rigid load."""
    start = resting_on(GRAVITY, BOX, HARD)
    mass = 0.05
    heavy = 1e4
    time = 0.2
    _, v, *_ = states_of(
        simulator(np.array([time]), kind=kind),
        ONE,
        parameters(start=start, inertia=heavy, sphere_mass=mass),
    )
    load = (
        AXIS @ np.cross(start - ORIGIN, mass * GRAVITY)
        if kind == "revolute"
        else mass * AXIS @ GRAVITY
    )
    assert v[0, 0] == pytest.approx(load / heavy * time, rel=1e-5)

    arm = 0.01 if kind == "revolute" else 0.1
    stiff = Contact.of(3000.0, 0.7, 1.0, 3000.0)
    start = resting_on(GRAVITY, BOX, stiff)
    times = np.linspace(0.02, 0.15, 14)
    # so that the container does not fall freely, in which the sphere would float
    held_back = 0.6 * load
    q, v, x, *_ = states_of(
        simulator(times, kind=kind, current=-held_back, step=5e-5),
        ONE,
        parameters(stiff, start, inertia=arm, sphere_mass=mass),
    )
    lever = start - ORIGIN
    weight = mass * GRAVITY
    inertia = arm + mass * (np.cross(AXIS, lever) @ np.cross(AXIS, lever) + 0.4 * BOX.radius**2)
    if kind == "prismatic":
        inertia = arm + mass

    def rigid(
        _: float,
        state: np.ndarray,
    ) -> list[float]:
        if kind == "prismatic":
            return [state[1], (AXIS @ weight - held_back) / inertia]
        there = Rotation.from_rotvec(state[0] * AXIS).apply(lever)
        return [
            state[1],
            (AXIS @ np.cross(there, weight) - held_back) / inertia,
        ]

    exact = solve_ivp(
        rigid,
        (0.0, times[-1]),
        [0.0, 0.0],
        rtol=1e-10,
        atol=1e-12,
        t_eval=times,
    ).y
    assert abs(exact[0, -1]) > 2e-3
    np.testing.assert_allclose(
        q[0],
        exact[0],
        atol=0.005 * abs(exact[0, -1]),
    )
    np.testing.assert_allclose(
        v[0],
        exact[1],
        atol=0.01 * abs(exact[1, -1]),
    )
    assert np.abs(x[0] - start).max() < 2e-4


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("kappa", [0.4, 2.0 / 3.0])
@pytest.mark.parametrize(("tilt", "friction"), [(0.1, 0.35), (0.6, 0.1)], ids=["rolls", "slips"])
def test_a_ball_on_an_inclined_plane(
    law: str,
    kappa: float,
    tilt: float,
    friction: float,
) -> None:
    """g sin / (1 + kappa) while it rolls, g (sin - mu cos) where the plane is steeper than mu (1 + 1 / kappa)."""
    long = Enclosure(
        "box",
        np.array([4.0, 0.1, 0.1]),
        0.01,
        kappa,
    )
    contact = Contact.of(400.0, 0.4, friction)
    gravity = G * np.array([np.sin(tilt), 0.0, -np.cos(tilt)])
    start = np.array([-1.5, 0.0, -long.room[2] + gravity[2] / contact.stiffness])
    sim = simulator(
        np.array([0.1, 0.5]),
        long,
        gravity=gravity,
        law=law,
    )
    _, _, x, u, spin = (
        s[0]
        for s in states_of(
            sim,
            ONE,
            parameters(contact, start, inertia=HELD),
        )
    )
    acceleration = np.diff(u[:, 0])[0] / 0.4
    rolls = np.tan(tilt) < friction * (1.0 + 1.0 / kappa)
    expected = (
        G * np.sin(tilt) / (1.0 + kappa) if rolls else G * (np.sin(tilt) - friction * np.cos(tilt))
    )
    assert acceleration == pytest.approx(expected, rel=0.01 if not rolls else 1e-3)
    torque = 1.0 if rolls else friction * G * np.cos(tilt) / (kappa * long.radius)
    assert spin[1, 1] == pytest.approx(u[1, 0] / long.radius if rolls else torque * 0.5, rel=0.01)
    assert x[1, 0] - start[0] == pytest.approx(0.5 * expected * 0.25, rel=0.01)
    assert np.abs(x[:, 2] - start[2]).max() < 1e-6


ROUND = {
    "box": BOX,
    "cylinder": Enclosure(
        "cylinder",
        np.array([0.05, 0.05, 0.06]),
        0.01,
    ),
    "sphere": Enclosure("sphere", np.full(3, 0.05), 0.01),
}


def spring_energy(
    inside: Enclosure,
    x: np.ndarray,
    stiffness: float,
) -> np.ndarray:
    """Per kilogram in all walls, for places x (T, 3)."""
    if inside.shape == "box":
        depths = np.abs(x) - inside.room
    elif inside.shape == "cylinder":
        depths = np.array(
            [np.hypot(x[:, 0], x[:, 1]) - inside.room[0], np.abs(x[:, 2]) - inside.room[2]]
        ).T
    else:
        depths = np.linalg.norm(x, axis=1, keepdims=True) - inside.room[0]
    return 0.5 * stiffness * (np.maximum(depths, 0.0) ** 2).sum(axis=1)


def energy(
    kind: str,
    inside: Enclosure,
    p: np.ndarray,
    states: tuple[np.ndarray, ...],
) -> np.ndarray:
    """Of joint and sphere [J], shape (T,): motion, spin, height and springs."""
    q, v, x, u, spin = (s[0] for s in states)
    value = {name: p[0, row] for name, row in SPHERE_INDEX.items()}
    inertia = inside.inertia_factor * inside.radius**2
    height = -world_place(kind, q, x) @ GRAVITY
    sphere = (
        0.5 * (u**2).sum(1)
        + 0.5 * inertia * (spin**2).sum(1)
        + height
        + spring_energy(inside, x, value["stiffness"])
    )
    joint = (
        0.5 * value["inertia"] * v**2
        + value["gravity_cos"] * np.sin(q)
        - value["gravity_sin"] * np.cos(q)
    )
    return joint + value["gravity_constant"] * q + value["sphere_mass"] * sphere


FALLS = {"gravity_cos": 0.1, "gravity_sin": 0.07, "q0": -0.3, "v0": 0.4}


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
@pytest.mark.parametrize("shape", ROUND)
@pytest.mark.parametrize("law", LAWS)
def test_energy_and_momentum_without_losses(kind: str, shape: str, law: str) -> None:
    """Energy stays, and momentum about the joint's axis changes by gravity's impulse alone, through every bounce."""
    inside = ROUND[shape]
    p = parameters(
        Contact(
            HARD.stiffness,
            0.0,
            0.0,
            0.0,
        ),
        (0.006, 0.004, -0.005),
        sphere_mass=0.1,
        **FALLS,
    )
    if kind == "prismatic":
        p[0, SPHERE_INDEX["inertia"]] = 0.3
    step = 2e-4
    times = np.arange(1, 2001) * step
    drift = []
    for h in (step, step / 2.0):
        states = states_of(
            simulator(times, inside, kind, step=h, law=law),
            ONE,
            p,
        )
        total = energy(kind, inside, p, states)
        drift.append(np.abs(total - total[0]).max())
    q, v, x, u, spin = (s[0] for s in states)
    touching = np.diff((spring_energy(inside, x, 1.0) > 0.0).astype(int)) > 0
    assert touching.sum() >= 2  # bounces
    exchanged = 0.5 * 0.1 * np.ptp((u**2).sum(1))
    assert drift[0] < 1e-3 * exchanged  # integration error: a wall is met inside a step
    assert drift[1] < 0.5 * drift[0] + 1e-7 * exchanged
    mass = 0.1
    load = FALLS["gravity_cos"] * np.cos(q) + FALLS["gravity_sin"] * np.sin(q)
    if kind == "revolute":
        place = world_place(kind, q, x)
        velocity = Rotation.from_rotvec(q[:, None] * AXIS).apply(u)
        momentum = (
            0.02 * v + mass * (np.cross(place, velocity) + 0.4 * inside.radius**2 * spin) @ AXIS
        )
        torque = mass * np.cross(place, GRAVITY) @ AXIS - load
    else:
        momentum = 0.3 * v + mass * u @ AXIS
        torque = np.full(len(q), mass * GRAVITY @ AXIS) - load
    impulse = cumulative_simpson(torque, x=times, initial=0.0)
    assert mass * np.ptp(u @ AXIS) + np.ptp(v) > 0.01
    np.testing.assert_allclose(
        momentum - momentum[0],
        impulse,
        atol=2e-4 * np.ptp(momentum),
    )


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
@pytest.mark.parametrize("shape", ROUND)
@pytest.mark.parametrize("law", LAWS)
def test_energy_never_grows_and_friction_keeps_momentum(kind: str, shape: str, law: str) -> None:
    """With damping and friction: what spins up the sphere slows the joint, and no touch gives energy."""
    inside = ROUND[shape]
    p = parameters(
        HARD,
        (0.006, 0.004, -0.005),
        sphere_mass=0.1,
        **FALLS,
    )
    if kind == "prismatic":
        p[0, SPHERE_INDEX["inertia"]] = 0.3
    times = np.arange(1, 2001) * 2e-4
    totals = []
    for step in (2e-4, 1e-4):
        states = states_of(
            simulator(times, inside, kind, step=step, law=law),
            ONE,
            p,
        )
        totals.append(energy(kind, inside, p, states))
    total = totals[1]
    lost = total[0] - total[-1]
    integration = np.abs(np.diff(totals[0] - total)).max()  # what half the step changes
    assert lost > 1e-4
    assert integration < 0.1 * lost  # the paper's law jumps at a touch
    assert np.diff(total).max() < integration
    q, v, x, u, spin = (s[0] for s in states)
    assert np.abs(spin).max() > 1.0
    load = FALLS["gravity_cos"] * np.cos(q) + FALLS["gravity_sin"] * np.sin(q)
    if kind == "revolute":
        place = world_place(kind, q, x)
        turned = Rotation.from_rotvec(q[:, None] * AXIS)
        # a force at the touch has no moment about it: spin and flight together exchange with the joint
        momentum = (
            0.02 * v
            + 0.1
            * (np.cross(place, turned.apply(u)) + 0.4 * inside.radius**2 * turned.apply(spin))
            @ AXIS
        )
        torque = 0.1 * np.cross(place, GRAVITY) @ AXIS - load
    else:
        momentum = 0.3 * v + 0.1 * u @ AXIS
        torque = np.full(len(q), 0.1 * GRAVITY @ AXIS) - load
    impulse = cumulative_simpson(torque, x=times, initial=0.0)
    np.testing.assert_allclose(
        momentum - momentum[0],
        impulse,
        atol=2e-4 * np.ptp(momentum),
    )


def test_walls_of_a_corner_push_at_once() -> None:
    """From rest, each wall gives k times its own depth."""
    depths = np.array([1e-4, 2e-4, 3e-4])
    signs = np.array([1.0, -1.0, 1.0])
    time = 1e-5
    states = states_of(
        simulator(np.array([time]), step=time),
        ONE,
        parameters(
            start=signs * (BOX.room + depths),
            inertia=HELD,
        ),
    )
    np.testing.assert_allclose(
        states[3][0, 0] / time, GRAVITY - HARD.stiffness * signs * depths, rtol=1e-2
    )


@pytest.mark.parametrize(("law", "pulls"), [("ramped", False), ("paper", True)])
def test_only_the_papers_law_pulls(law: str, pulls: bool) -> None:
    """A sphere thrown out of a wall: what it gains in speed from one instant to the next is the wall's force."""
    times = np.arange(1, 4001) * 2e-6
    start = np.array([0.0, 0.0, -BOX.room[2] - 1.5e-3])
    sim = simulator(
        times,
        gravity=np.zeros(3),
        step=2e-6,
        law=law,
    )
    _, _, x, u, _ = (
        s[0]
        for s in states_of(
            sim,
            ONE,
            parameters(start=start, inertia=HELD),
        )
    )
    assert x[-1, 2] > -BOX.room[2]  # it left
    force = np.diff(u[:, 2]) / 2e-6
    assert force.max() > 0.5 * HARD.stiffness * 1e-3
    assert (force.min() < -1.0) == pulls


@pytest.mark.parametrize(
    ("shape", "law", "integrator"),
    [
        *((shape, law, "rk4") for shape in ROUND for law in LAWS),
        ("box", "ramped", "semi_implicit"),
        ("cylinder", "paper", "semi_implicit"),
        ("sphere", "ramped", "semi_implicit"),
    ],
)
def test_integrator_orders(shape: str, law: str, integrator: str) -> None:
    """While a sphere rolls on a wall and touches no other, halving the step divides the error by 16, or by 2."""
    soft = Contact.of(60.0, 0.3, 1.0, 60.0)
    start = {
        "box": (0.0, 0.0, -0.0128),
        "cylinder": (0.0, -0.0165, 0.0),
        "sphere": (0.003, -0.0045, -0.0146),
    }[shape]
    gravity = {"box": (0.6, 0.4, -9.0), "cylinder": (1.5, -9.0, 0.4), "sphere": (2.0, -4.0, -9.0)}[
        shape
    ]
    p = parameters(soft, start, gravity_cos=0.2, v0=0.1)
    inside = Enclosure(
        shape,
        ROUND[shape].inner_size,
        0.01,
        ramp_depth=1e-9,
    )

    def end(step: float, scheme: str) -> np.ndarray:
        sim = simulator(
            np.array([0.12]),
            inside,
            gravity=np.array(gravity),
            step=step,
            law=law,
            integrator=scheme,
        )
        q, v, x, u, spin = (s[0, 0] for s in states_of(sim, ONE, p))
        return np.concatenate([[q, v], x, u, spin])

    exact = end(1.25e-4, "rk4")
    coarse = 2e-3 if integrator == "rk4" else 5e-4
    errors = [np.abs(end(step, integrator) - exact)[:5] for step in (coarse, coarse / 2.0)]
    ratio = 16.0 if integrator == "rk4" else 2.0
    np.testing.assert_allclose(
        errors[0].max() / errors[1].max(),
        ratio,
        rtol=0.2,
    )


def test_the_papers_constants_are_newtons() -> None:
    """A sphere pressed 1 mm deep by k_e = 1000 N/m is pushed with 1 N, whatever it weighs."""
    for mass in (0.005, 0.05):
        p = parameters(
            paper_contact(mass), (0.0, 0.0, -BOX.room[2] - 1e-3), inertia=HELD, sphere_mass=mass
        )
        sim = simulator(
            np.array([1e-6]),
            gravity=np.zeros(3),
            step=1e-6,
            law="paper",
        )
        assert mass * states_of(sim, ONE, p)[3][0, 0, 2] / 1e-6 == pytest.approx(1.0, rel=1e-3)


def test_what_cannot_be_simulated_is_said() -> None:
    with pytest.raises(SimulationError, match="unknown law of contact 'hertz'"):
        simulator(np.array([0.1]), law="hertz")
    with pytest.raises(SimulationError, match="choose one of box, cylinder, sphere"):
        Enclosure("cone", np.full(3, 0.05), 0.01)
    with pytest.raises(SimulationError, match="does not fit into"):
        Enclosure(
            "box",
            np.array([0.06, 0.04, 0.02]),
            0.01,
        )


def in_world_coordinates(
    inside: Enclosure,
    p: np.ndarray,
    kind: str,
    current: float,
    times: np.ndarray,
) -> tuple[np.ndarray, ...]:
    """The same box, sphere and joint written down in the world's frame and integrated to 1e-10: q, v (T,), three of (T, 3).

    These are the sphere's place in the container, its velocity and its spin against the ground along the container's axes.
    """
    value = {name: p[0, row] for name, row in SPHERE_INDEX.items()}
    k, c, kf, mu = (value[name] for name in ("stiffness", "damping", "traction", "friction"))
    mass = value["sphere_mass"]
    kappa = inside.inertia_factor
    radius = inside.radius

    def pose(q: float) -> tuple[np.ndarray, np.ndarray]:
        """Rotation of the container and where its centre is, the axis through the origin."""
        if kind == "revolute":
            turned = Rotation.from_rotvec(q * AXIS).as_matrix()
            return turned, -turned @ ORIGIN
        return np.eye(3), -ORIGIN + q * AXIS

    def carried(v: float, at: np.ndarray) -> np.ndarray:
        return v * np.cross(AXIS, at) if kind == "revolute" else v * AXIS

    def rates(_: float, state: np.ndarray) -> np.ndarray:
        q = state[0]
        v = state[1]
        place = state[2:5]
        velocity = state[5:8]
        spin = state[8:11]
        turned, centre = pose(q)
        force = mass * GRAVITY
        moment = np.zeros(3)
        on_joint = 0.0
        for axis in range(3):
            for side in (-1.0, 1.0):
                inward = -side * turned[:, axis]
                wall = centre + side * turned[:, axis] * inside.inner_size[axis] / 2.0
                depth = radius - inward @ (place - wall)
                if depth <= 0.0:
                    continue
                at = place - radius * inward
                slip = velocity + np.cross(spin, at - place) - carried(v, at)
                leaving = slip @ inward
                slip = slip - leaving * inward
                normal = max(
                    k * depth - c * min(depth / inside.ramp_depth, 1.0) * leaving,
                    0.0,
                )
                push = mass * normal * inward
                if normal > 0.0:
                    push = push - mass * kf * mu * normal * slip / np.sqrt(
                        (kf * slip) @ (kf * slip) + (mu * normal) ** 2
                    )
                force = force + push
                moment = moment + np.cross(at - place, push)
                on_joint -= push @ (np.cross(AXIS, at) if kind == "revolute" else AXIS)
        load = value["gravity_cos"] * np.cos(q) + value["gravity_sin"] * np.sin(q)
        motor = value["torque_constant"] * current - value["viscous"] * v
        a = (motor - load + on_joint) / value["inertia"]
        return np.concatenate([[v, a], velocity, force / mass, moment / (kappa * mass * radius**2)])

    turned, centre = pose(value["q0"])
    start = centre + turned @ p[0, [SPHERE_INDEX[f"start_{axis}"] for axis in "xyz"]]
    spin = value["v0"] * AXIS if kind == "revolute" else np.zeros(3)
    state = np.concatenate([[value["q0"], value["v0"]], start, carried(value["v0"], start), spin])
    solution = solve_ivp(
        rates, (0.0, times[-1]), state, rtol=1e-10, atol=1e-12, t_eval=times, max_step=1e-3
    )
    seen = []
    for column in solution.y.T:
        turned, centre = pose(column[0])
        seen.append(
            [
                turned.T @ (column[2:5] - centre),
                turned.T @ column[5:8],
                turned.T @ column[8:11],
            ]
        )
    return solution.y[0], solution.y[1], *np.array(seen).swapaxes(0, 1)


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_against_plain_equations_in_the_world(kind: str) -> None:
    """Falls, bounces off several walls, slips and rolls, on a joint that moves; other frame, other integrator."""
    p = parameters(
        HARD,
        (-0.005, 0.003, -0.008),
        sphere_mass=0.04,
        viscous=0.01,
        gravity_cos=0.1,
        q0=-0.4,
        v0=1.5,
    )
    if kind == "prismatic":
        p[0, SPHERE_INDEX["inertia"]] = 0.3
    times = np.linspace(0.01, 0.3, 30)
    exact = in_world_coordinates(BOX, p, kind, 0.12, times)
    states = states_of(
        simulator(
            times,
            kind=kind,
            current=0.12,
            step=HARD.step_s(0.4) / 2.0,
        ),
        ONE,
        p,
    )
    without = p.copy()
    without[0, SPHERE_INDEX["sphere_mass"]] = 0.0
    assert (
        np.abs(
            states_of(
                simulator(times, kind=kind, current=0.12),
                ONE,
                without,
            )[0]
            - states[0]
        ).max()
        > 1e-3
    )
    q, v, x, u, spin = (state[0] for state in states)
    assert (np.diff(np.sign(np.diff(x, axis=0)), axis=0) != 0).any()  # it bounced
    np.testing.assert_allclose(q, exact[0], atol=1e-5)
    np.testing.assert_allclose(x, exact[2], atol=1e-4)
    for ours, theirs in ((v, exact[1]), (u, exact[3]), (spin, exact[4])):
        # the last sample lies within a bounce, where a speed changes by itself in a few steps
        np.testing.assert_allclose(
            ours,
            theirs,
            atol=0.03 * np.abs(theirs).max(),
        )


def of_mujoco(
    p: np.ndarray,
    axis: np.ndarray,
    origin: np.ndarray,
    times: np.ndarray,
    torque: float,
) -> tuple[np.ndarray, np.ndarray]:
    """The joint and the sphere's place in the container, by MuJoCo with its own law of contact and implicit integrator."""
    import mujoco

    value = {name: p[0, row] for name, row in SPHERE_INDEX.items()}
    half = BOX.inner_size / 2.0
    thick = 0.05
    radius = BOX.radius

    def text(*values: float) -> str:
        return " ".join(f"{value:.12g}" for value in values)

    walls = ""
    for wall in range(6):
        along = np.arange(3) == wall // 2
        way = 2.0 * (wall % 2) - 1.0
        size = np.where(along, thick / 2.0, half + thick)
        pos = np.where(
            along,
            way * (half + thick / 2.0),
            0.0,
        )
        walls += f'<geom type="box" mass="0" contype="1" conaffinity="0" size="{text(*size)}" pos="{text(*pos)}"/>'
    inertia = 0.4 * value["sphere_mass"] * radius**2
    model = mujoco.MjModel.from_xml_string(f"""<mujoco>
      <option timestep="1e-4" integrator="implicitfast" gravity="{text(0, 0, -G)}" cone="elliptic"/>
      <default><geom condim="3" friction="{value["friction"]} 0 0" solref="0.002 1"/></default>
      <worldbody>
        <body>
          <joint type="hinge" pos="{text(*origin)}" axis="{text(*axis)}" armature="{value["inertia"]}"/>
          <inertial pos="{text(*origin)}" mass="1e-6" diaginertia="1e-9 1e-9 1e-9"/>{walls}
        </body>
        <body><freejoint/>
          <inertial pos="0 0 0" mass="{value["sphere_mass"]}" diaginertia="{text(inertia, inertia, inertia)}"/>
          <geom type="sphere" size="{radius}" mass="0" contype="0" conaffinity="1"/>
        </body>
      </worldbody></mujoco>""")
    data = mujoco.MjData(model)
    start = p[0, [SPHERE_INDEX[f"start_{name}"] for name in "xyz"]]
    turned = Rotation.from_rotvec(value["q0"] * axis)
    data.qpos[:] = (
        value["q0"],
        *(origin + turned.apply(start - origin)),
        *turned.as_quat(scalar_first=True),
    )
    q = []
    places = []
    data.qfrc_applied[0] = torque
    for step in range(1, round(times[-1] * 1e4) + 1):
        mujoco.mj_step(model, data)
        if np.abs(times - step * 1e-4).min() < 1e-9:
            back = Rotation.from_rotvec(data.qpos[0] * axis).inv()
            q.append(data.qpos[0])
            places.append(origin + back.apply(data.qpos[1:4] - origin))
    return np.array(q), np.array(places)


@pytest.mark.parametrize("mass", [0.02, 0.05])
def test_against_mujoco_while_the_sphere_rolls_from_end_to_end(mass: float) -> None:
    """Two laws of contact: the joint agrees within 0.2 mrad rms, and a sphere that stayed where it was would not do."""
    axis = np.array([0.0, 1.0, 0.0])
    origin = np.array([-0.16, 0.0, 0.0])
    gravity = np.array([0.0, 0.0, -G])
    times = np.arange(1, 25) / 40.0
    q0 = -0.02
    run = {
        "axis": axis,
        "origin": origin,
        "gravity": gravity,
        "step": HARD.step_s(0.4),
    }
    down = Rotation.from_rotvec(q0 * axis).inv().apply(gravity)
    start = np.array(
        [-BOX.room[0] + down[0] / HARD.stiffness, 0.0, -BOX.room[2] + down[2] / HARD.stiffness]
    )
    p = parameters(start=start, sphere_mass=mass, q0=q0)
    current = 0.08 - 0.9 * mass * G * 0.18  # the motor carries most of the weight and dips the hand
    q, _, x, *_ = states_of(
        simulator(times, current=current, **run),
        ONE,
        p,
    )
    exact, place = of_mujoco(p, axis, origin, times, current)
    assert np.ptp(place[:, 0]) > 0.95 * 2.0 * BOX.room[0]
    assert np.ptp(x[0, :, 0]) > 0.95 * 2.0 * BOX.room[0]
    # the same load where it lay at first, fixed
    lever = start - origin
    fixed = parameters(
        inertia=0.02 + mass * (lever @ lever + 0.4 * BOX.radius**2), sphere_mass=0.0, q0=q0,
        gravity_cos=-mass * G * lever[0], gravity_sin=-mass * G * lever[2],
    )  # fmt: skip
    still = states_of(simulator(times, current=current, **run), ONE, fixed)[0]
    rms, without_rolling = (float(np.sqrt(np.mean((one[0] - exact) ** 2))) for one in (q, still))
    assert rms < 2e-4
    assert without_rolling > 5.0 * rms
    # a bounce off the far end is another in another law
    np.testing.assert_allclose(x[0], place, atol=4e-3)


@pytest.mark.parametrize("name", SPHERE_PARAMETERS)
def test_a_guess_that_is_no_number_ends(name: str) -> None:
    """A solver that went astray gets a number that it can reject, and the guesses beside it are as they were."""
    good = parameters(start=(0.005, 0.0, -0.01))
    p = np.repeat(good, 4, axis=0)
    p[1:, SPHERE_INDEX[name]] = np.nan, np.inf, -np.inf
    sim = simulator(np.array([0.05, 0.1]))
    with np.errstate(invalid="ignore"):
        q, _ = sim.rollout(
            np.zeros(4, dtype=np.int32),
            p,
        )
    assert np.isnan(q[1:]).all()
    np.testing.assert_array_equal(
        q[0],
        sim.rollout(ONE, good)[0][0],
    )
