"""A sphere in a moving container against laws and simulators that share nothing with ours."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

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
SLANTED = np.array([0.2, 0.9, -0.4])
AXIS = SLANTED / np.linalg.norm(SLANTED)
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
    start_x, start_y, start_z = np.asarray(start, dtype=float)
    known = {
        "inertia": 0.02, "sphere_mass": 0.03, "stiffness": contact.stiffness, "damping": contact.damping,
        "traction": contact.traction, "friction": contact.friction, "torque_constant": 1.0, "stribeck_velocity": 0.1,
        "start_x": start_x, "start_y": start_y, "start_z": start_z,
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
        np.sort(rng.uniform(0.0, 0.5, 20)),
        np.array([0.0, 0.21]),
        np.array([0.3, -0.35]),
        (4.0, 2.49, 5.22),
        0.02,
        1e-3,
        1e-3,
    )
    p = parameters(
        sphere_mass=0.0, gravity_cos=0.1, gravity_sin=-0.05, gravity_constant=0.02, torque_constant=1.78,
        coulomb=0.03, viscous=0.01, load_friction=0.05, delay=0.004, q0=0.3, v0=0.2,
        stribeck=0.3, stribeck_velocity=0.2,
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
    late = simulator(np.linspace(1.0, 2.0, 20), law=law)
    x = states_of(late, ONE, parameters(start=off, inertia=HELD))[2][0]
    np.testing.assert_allclose(
        x,
        np.tile(start, (20, 1)),
        atol=1e-6,
    )


def load_of(
    kind: str,
    place: np.ndarray,
    mass_kg: float,
) -> float:
    """What a weight at a place of the container is to the joint at q = 0 [N m], or [N] of a slide."""
    weight = mass_kg * GRAVITY
    if kind == "prismatic":
        return float(AXIS @ weight)
    return float(AXIS @ np.cross(place - ORIGIN, weight))


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_a_heavy_joint_feels_the_weight_at_the_sphere_s_place(kind: str) -> None:
    """A joint so heavy that it hardly moves."""
    start = resting_on(GRAVITY, BOX, HARD)
    mass = 0.05
    heavy = 1e4
    time = 0.2
    _, v, *_ = states_of(
        simulator(np.array([time]), kind=kind),
        ONE,
        parameters(start=start, inertia=heavy, sphere_mass=mass),
    )
    load = load_of(kind, start, mass)
    assert v[0, 0] == pytest.approx(load / heavy * time, rel=1e-5)


def with_a_rigid_load(
    kind: str,
    arm: float,
    place: np.ndarray,
    mass_kg: float,
    held_back: float,
    times: np.ndarray,
) -> np.ndarray:
    """Place and speed (2, T) of a joint from rest whose load is a ball that cannot move in the container."""
    lever = place - ORIGIN
    weight = mass_kg * GRAVITY

    def sliding(_: float, state: np.ndarray) -> list[float]:
        return [state[1], (AXIS @ weight - held_back) / (arm + mass_kg)]

    across = np.cross(AXIS, lever)
    inertia = arm + mass_kg * (across @ across + 0.4 * BOX.radius**2)

    def turning(_: float, state: np.ndarray) -> list[float]:
        there = Rotation.from_rotvec(state[0] * AXIS).apply(lever)
        torque = AXIS @ np.cross(there, weight)
        return [state[1], (torque - held_back) / inertia]

    return solve_ivp(
        sliding if kind == "prismatic" else turning,
        (0.0, times[-1]),
        [0.0, 0.0],
        rtol=1e-10,
        atol=1e-12,
        t_eval=times,
    ).y


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_a_light_joint_feels_a_rigid_load(kind: str) -> None:
    mass = 0.05
    # so that the container does not fall freely, in which the sphere would float
    held_back = 0.6 * load_of(kind, resting_on(GRAVITY, BOX, HARD), mass)
    arm = 0.01 if kind == "revolute" else 0.1
    stiff = Contact.of(3000.0, 0.7, 1.0, 3000.0)
    start = resting_on(GRAVITY, BOX, stiff)
    times = np.linspace(0.02, 0.15, 14)
    q, v, x, *_ = states_of(
        simulator(times, kind=kind, current=-held_back, step=5e-5),
        ONE,
        parameters(stiff, start, inertia=arm, sphere_mass=mass),
    )
    exact = with_a_rigid_load(kind, arm, start, mass, held_back, times)
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
@pytest.mark.parametrize(
    ("tilt", "friction"),
    [
        pytest.param(0.1, 0.35, id="rolls"),
        pytest.param(0.6, 0.1, id="slips"),
    ],
)
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
    down_the_plane = G * np.sin(tilt)
    into_the_plane = G * np.cos(tilt)
    gravity = np.array([down_the_plane, 0.0, -into_the_plane])
    floor = -long.room[2] + gravity[2] / contact.stiffness
    start = np.array([-1.5, 0.0, floor])
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
    if rolls:
        expected = down_the_plane / (1.0 + kappa)
        spun = u[1, 0] / long.radius
    else:
        expected = down_the_plane - friction * into_the_plane
        spun = 0.5 * friction * into_the_plane / (kappa * long.radius)
    assert acceleration == pytest.approx(expected, rel=1e-3 if rolls else 0.01)
    assert spin[1, 1] == pytest.approx(spun, rel=0.01)
    gone = x[1, 0] - start[0]
    assert gone == pytest.approx(0.5 * expected * 0.25, rel=0.01)
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
        round_wall = np.hypot(x[:, 0], x[:, 1]) - inside.room[0]
        ends = np.abs(x[:, 2]) - inside.room[2]
        depths = np.array([round_wall, ends]).T
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
FALLING_KG = 0.1
INERTIA = {"revolute": 0.02, "prismatic": 0.3}
"""Of a joint that falls with the sphere: [kg m^2], of a slide [kg]."""


def check_momentum(
    kind: str,
    inside: Enclosure,
    times: np.ndarray,
    states: tuple[np.ndarray, ...],
) -> None:
    """Momentum about the joint's axis changes by gravity's impulse alone.

    A force at the touch has no moment about it: spin and flight together exchange with the joint.
    """
    q, v, x, u, spin = (s[0] for s in states)
    load = FALLS["gravity_cos"] * np.cos(q) + FALLS["gravity_sin"] * np.sin(q)
    if kind == "revolute":
        place = world_place(kind, q, x)
        turned = Rotation.from_rotvec(q[:, None] * AXIS)
        flight = np.cross(place, turned.apply(u))
        turning = 0.4 * inside.radius**2 * turned.apply(spin)
        of_sphere = FALLING_KG * (flight + turning) @ AXIS
        torque = FALLING_KG * np.cross(place, GRAVITY) @ AXIS - load
    else:
        of_sphere = FALLING_KG * u @ AXIS
        torque = np.full(len(q), FALLING_KG * GRAVITY @ AXIS) - load
    momentum = INERTIA[kind] * v + of_sphere
    impulse = cumulative_simpson(torque, x=times, initial=0.0)
    np.testing.assert_allclose(
        momentum - momentum[0],
        impulse,
        atol=2e-4 * np.ptp(momentum),
    )


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
        inertia=INERTIA[kind],
        sphere_mass=FALLING_KG,
        **FALLS,
    )
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
    _, v, x, u, _ = (s[0] for s in states)
    touches = spring_energy(inside, x, 1.0) > 0.0
    begun = np.diff(touches.astype(int)) > 0
    assert begun.sum() >= 2  # bounces
    exchanged = 0.5 * FALLING_KG * np.ptp((u**2).sum(1))
    assert drift[0] < 1e-3 * exchanged  # integration error: a wall is met inside a step
    assert drift[1] < 0.5 * drift[0] + 1e-7 * exchanged
    assert FALLING_KG * np.ptp(u @ AXIS) + np.ptp(v) > 0.01
    check_momentum(kind, inside, times, states)


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
@pytest.mark.parametrize("shape", ROUND)
@pytest.mark.parametrize("law", LAWS)
def test_energy_never_grows_and_friction_keeps_momentum(kind: str, shape: str, law: str) -> None:
    """With damping and friction: what spins up the sphere slows the joint, and no touch gives energy."""
    inside = ROUND[shape]
    p = parameters(
        HARD,
        (0.006, 0.004, -0.005),
        inertia=INERTIA[kind],
        sphere_mass=FALLING_KG,
        **FALLS,
    )
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
    spin = states[4][0]
    assert np.abs(spin).max() > 1.0
    check_momentum(kind, inside, times, states)


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
    starts = {
        "box": (0.0, 0.0, -0.0128),
        "cylinder": (0.0, -0.0165, 0.0),
        "sphere": (0.003, -0.0045, -0.0146),
    }
    gravities = {
        "box": (0.6, 0.4, -9.0),
        "cylinder": (1.5, -9.0, 0.4),
        "sphere": (2.0, -4.0, -9.0),
    }
    p = parameters(soft, starts[shape], gravity_cos=0.2, v0=0.1)
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
            gravity=np.array(gravities[shape]),
            step=step,
            law=law,
            integrator=scheme,
        )
        states = states_of(sim, ONE, p)
        q, v, x, *_ = (s[0, 0] for s in states)
        return np.concatenate([[q, v], x])

    exact = end(1.25e-4, "rk4")

    def error(step: float) -> float:
        return float(np.abs(end(step, integrator) - exact).max())

    coarse = 2e-3 if integrator == "rk4" else 5e-4
    ratio = 16.0 if integrator == "rk4" else 2.0
    np.testing.assert_allclose(
        error(coarse) / error(coarse / 2.0),
        ratio,
        rtol=0.2,
    )


def test_the_papers_constants_are_newtons() -> None:
    """A sphere pressed 1 mm deep by k_e = 1000 N/m is pushed with 1 N, whatever it weighs."""
    for mass in (0.005, 0.05):
        p = parameters(
            paper_contact(mass),
            (0.0, 0.0, -BOX.room[2] - 1e-3),
            inertia=HELD,
            sphere_mass=mass,
        )
        sim = simulator(
            np.array([1e-6]),
            gravity=np.zeros(3),
            step=1e-6,
            law="paper",
        )
        velocity = states_of(sim, ONE, p)[3][0, 0]
        push_N = mass * velocity[2] / 1e-6
        assert push_N == pytest.approx(1.0, rel=1e-3)


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


@dataclass(frozen=True)
class InWorldCoordinates:
    """The same box, sphere and joint written down in the world's frame, whose origin lies on the joint's axis."""

    inside: Enclosure
    value: dict[str, float]
    kind: str
    current: float

    def pose(self, q: float) -> tuple[np.ndarray, np.ndarray]:
        """Rotation of the container and where its centre is."""
        if self.kind == "revolute":
            turned = Rotation.from_rotvec(q * AXIS).as_matrix()
            return turned, -turned @ ORIGIN
        return np.eye(3), -ORIGIN + q * AXIS

    def carried(self, v: float, at: np.ndarray) -> np.ndarray:
        """Velocity of a point of the container."""
        return v * np.cross(AXIS, at) if self.kind == "revolute" else v * AXIS

    def lever(self, at: np.ndarray) -> np.ndarray:
        """By which a force at a place of the container acts on the joint."""
        return np.cross(AXIS, at) if self.kind == "revolute" else AXIS

    def push(
        self,
        depth: float,
        inward: np.ndarray,
        slip: np.ndarray,
    ) -> np.ndarray:
        """Force of a wall on the sphere [N].

        Args:
            depth: how deep the sphere is in the wall [m].
            inward: unit vector off the wall (3,).
            slip: velocity of the sphere's touching point against the wall (3,) [m/s].
        """
        value = self.value
        leaving = slip @ inward
        slip = slip - leaving * inward
        ramp = min(depth / self.inside.ramp_depth, 1.0)
        damped = value["damping"] * ramp * leaving
        normal = max(value["stiffness"] * depth - damped, 0.0)
        force = value["sphere_mass"] * normal * inward
        if normal > 0.0:
            kf = value["traction"]
            limit = value["friction"] * normal
            size = np.sqrt((kf * slip) @ (kf * slip) + limit**2)
            force = force - value["sphere_mass"] * kf * limit * slip / size
        return force

    def walls(self, q: float) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Unit vector off each wall, and a point of it."""
        turned, centre = self.pose(q)
        for axis in range(3):
            for side in (-1.0, 1.0):
                outward = side * turned[:, axis]
                yield -outward, centre + outward * self.inside.inner_size[axis] / 2.0

    def touches(
        self,
        q: float,
        v: float,
        sphere: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, float]:
        """Force and moment of all walls on the sphere, (3,) each, and what they do to the joint.

        Args:
            q: of the joint.
            v: of the joint.
            sphere: place, velocity and spin, (9,).
        """
        place, velocity, spin = sphere.reshape(3, 3)
        radius = self.inside.radius
        force = np.zeros(3)
        moment = np.zeros(3)
        on_joint = 0.0
        for inward, wall in self.walls(q):
            depth = radius - inward @ (place - wall)
            if depth <= 0.0:
                continue
            at = place - radius * inward
            slip = velocity + np.cross(spin, at - place) - self.carried(v, at)
            push = self.push(depth, inward, slip)
            force = force + push
            moment = moment + np.cross(at - place, push)
            on_joint -= push @ self.lever(at)
        return force, moment, on_joint

    def rates(self, _: float, state: np.ndarray) -> np.ndarray:
        """Of the joint's angle and speed, and the sphere's place, velocity and spin, (11,)."""
        value = self.value
        q = state[0]
        v = state[1]
        force, moment, on_joint = self.touches(q, v, state[2:])
        load = value["gravity_cos"] * np.cos(q) + value["gravity_sin"] * np.sin(q)
        motor = value["torque_constant"] * self.current - value["viscous"] * v
        a = (motor - load + on_joint) / value["inertia"]
        mass = value["sphere_mass"]
        inertia = self.inside.inertia_factor * mass * self.inside.radius**2
        return np.concatenate(
            [
                [v, a],
                state[5:8],
                GRAVITY + force / mass,
                moment / inertia,
            ]
        )

    def begin(self) -> np.ndarray:
        """State (11,) of a sphere that the container carries."""
        q0 = self.value["q0"]
        v0 = self.value["v0"]
        turned, centre = self.pose(q0)
        start = centre + turned @ [self.value[f"start_{axis}"] for axis in "xyz"]
        velocity = self.carried(v0, start)
        spin = v0 * AXIS if self.kind == "revolute" else np.zeros(3)
        return np.concatenate([[q0, v0], start, velocity, spin])

    def rolled_out(self, times: np.ndarray) -> tuple[np.ndarray, ...]:
        """Integrated to 1e-10: q, v (T,), and the sphere's place in the container, velocity and spin (T, 3).

        Velocity and spin are those against the ground along the container's axes.
        """
        solution = solve_ivp(
            self.rates,
            (0.0, times[-1]),
            self.begin(),
            rtol=1e-10,
            atol=1e-12,
            t_eval=times,
            max_step=1e-3,
        )
        seen = []
        for column in solution.y.T:
            turned, centre = self.pose(column[0])
            place, velocity, spin = column[2:].reshape(3, 3)
            seen.append(
                [
                    turned.T @ (place - centre),
                    turned.T @ velocity,
                    turned.T @ spin,
                ]
            )
        places, velocities, spins = np.array(seen).swapaxes(0, 1)
        return solution.y[0], solution.y[1], places, velocities, spins


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_against_plain_equations_in_the_world(kind: str) -> None:
    """Falls, bounces off several walls, slips and rolls, on a joint that moves; other frame, other integrator."""
    p = parameters(
        HARD,
        (-0.005, 0.003, -0.008),
        inertia=INERTIA[kind],
        sphere_mass=0.04,
        viscous=0.01,
        gravity_cos=0.1,
        q0=-0.4,
        v0=1.5,
    )
    times = np.linspace(0.01, 0.3, 30)
    value = {name: float(p[0, row]) for name, row in SPHERE_INDEX.items()}
    exact = InWorldCoordinates(BOX, value, kind, 0.12).rolled_out(times)
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
    alone = states_of(
        simulator(times, kind=kind, current=0.12),
        ONE,
        without,
    )
    assert np.abs(alone[0] - states[0]).max() > 1e-3
    q, v, x, u, spin = (state[0] for state in states)
    ways = np.sign(np.diff(x, axis=0))
    assert (np.diff(ways, axis=0) != 0).any()  # it bounced
    np.testing.assert_allclose(q, exact[0], atol=1e-5)
    np.testing.assert_allclose(x, exact[2], atol=1e-4)
    speeds = [exact[1], exact[3], exact[4]]
    for ours, theirs in zip((v, u, spin), speeds, strict=True):
        # the last sample lies within a bounce, where a speed changes by itself in a few steps
        np.testing.assert_allclose(
            ours,
            theirs,
            atol=0.03 * np.abs(theirs).max(),
        )


def text(*values: float) -> str:
    """Numbers of an attribute of MuJoCo's."""
    return " ".join(f"{value:.12g}" for value in values)


def mujoco_scene(
    value: Mapping[str, float],
    axis: np.ndarray,
    origin: np.ndarray,
) -> str:
    """A box on a hinge with a sphere in it.

    Args:
        value: Of the parameters, by name.
        axis: Of the hinge, (3,).
        origin: Of the hinge [m], (3,).
    """
    half = BOX.inner_size / 2.0
    thick = 0.05
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
    inertia = 0.4 * value["sphere_mass"] * BOX.radius**2
    return f"""<mujoco>
      <option timestep="1e-4" integrator="implicitfast" gravity="{text(0, 0, -G)}" cone="elliptic"/>
      <default><geom condim="3" friction="{value["friction"]} 0 0" solref="0.002 1"/></default>
      <worldbody>
        <body>
          <joint type="hinge" pos="{text(*origin)}" axis="{text(*axis)}" armature="{value["inertia"]}"/>
          <inertial pos="{text(*origin)}" mass="1e-6" diaginertia="1e-9 1e-9 1e-9"/>{walls}
        </body>
        <body><freejoint/>
          <inertial pos="0 0 0" mass="{value["sphere_mass"]}" diaginertia="{text(inertia, inertia, inertia)}"/>
          <geom type="sphere" size="{BOX.radius}" mass="0" contype="0" conaffinity="1"/>
        </body>
      </worldbody></mujoco>"""


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
    model = mujoco.MjModel.from_xml_string(mujoco_scene(value, axis, origin))
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
    pressed = down / HARD.stiffness
    start = pressed - BOX.room
    start[1] = 0.0
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
        inertia=0.02 + mass * (lever @ lever + 0.4 * BOX.radius**2),
        sphere_mass=0.0,
        q0=q0,
        gravity_cos=-mass * G * lever[0],
        gravity_sin=-mass * G * lever[2],
    )
    still = states_of(simulator(times, current=current, **run), ONE, fixed)[0]

    def rms_error(angles: np.ndarray) -> float:
        return float(np.sqrt(np.mean((angles - exact) ** 2)))

    assert rms_error(q[0]) < 2e-4
    assert rms_error(still[0]) > 5.0 * rms_error(q[0])
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
