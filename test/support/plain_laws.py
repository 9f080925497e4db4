"""The laws of a sphere and of a squeeze without tangents: what their tangents are held against, by differences and by tape."""

from functools import cache
from typing import Any

import numpy as np
import warp as wp

from proprio_ros.sim.joint import JointSimulator
from proprio_ros.sim.joint_kernels import (
    CARRIED,
    CURRENT,
    DELAY,
    LOAD,
    LOAD_PER_KG,
    Q0,
    V0,
    VEC3,
    standstill,
)
from proprio_ros.sim.runtime import FLOAT, FLOATS
from proprio_ros.sim.sphere import SphereSimulator
from proprio_ros.sim.sphere_kernels import (
    AXIS,
    DAMPING,
    FACES,
    FRICTION,
    GRAVITY,
    GRAVITY_BY_COS,
    GRAVITY_BY_SIN,
    HALF_SIZE,
    INERTIA_FACTOR,
    ORIGIN,
    RADIUS,
    RAMP_DEPTH,
    SPHERE_MASS,
    STATE,
    STIFFNESS,
    TILT,
    TRACTION,
    TURNS,
    SphereData,
    container_velocity,
    joined_state,
    part,
    start_of,
    triple,
    wall_of,
)
from proprio_ros.sim.squeeze import SqueezeSimulator
from proprio_ros.sim.squeeze_kernels import SqueezeData, excitation_of_block
from support.taped import PlainLaw, TapedRollout, acceleration, forward, plain_joint_law, tape


def difference(
    simulator: JointSimulator,
    p: np.ndarray,
    row: int,
    step: float,
) -> np.ndarray:
    """Central difference of the angles of one world by one parameter, shape (1, T).

    Args:
        simulator: of one run.
        p: parameters of one world, shape (1, P).
        row: which parameter.
        step: of the difference to each side, in the parameter's unit.
    """
    up = p.copy()
    up[0, row] += step
    down = p.copy()
    down[0, row] -= step
    world = np.zeros(1, dtype=np.int32)
    above = simulator.rollout(world, up)[0]
    below = simulator.rollout(world, down)[0]
    return (above - below) / (2.0 * step)


@wp.func
def plain_squeeze_rate(
    q: FLOAT,
    v: FLOAT,
    command: FLOAT,
    extra: FLOAT,
    p: FLOATS,
    w: wp.int32,
    data: SqueezeData,
    r: wp.int32,
):
    load, _by_q, _by_v, _by_p, _by_loss = excitation_of_block(
        q,
        v,
        p,
        w,
        data,
        r,
    )
    return acceleration(
        q,
        v,
        command,
        extra + load,
        p,
        w,
        data.constants,
        r,
    )


@wp.func
def _ramped(
    depth: FLOAT,
    v_n: FLOAT,
    slip: VEC3,
    n: VEC3,
    k: FLOAT,
    c: FLOAT,
    kf: FLOAT,
    mu: FLOAT,
    ramp_depth: FLOAT,
):
    normal = wp.max(
        k * depth - c * wp.min(depth / ramp_depth, FLOAT(1.0)) * v_n,
        FLOAT(0.0),
    )
    most = mu * normal
    bottom = wp.sqrt(kf * kf * wp.dot(slip, slip) + most * most)
    force = normal * n
    if bottom > FLOAT(0.0):
        force = force - (kf * most / bottom) * slip
    return force


@wp.func
def _as_in_the_paper(
    depth: FLOAT,
    v_n: FLOAT,
    slip: VEC3,
    n: VEC3,
    k: FLOAT,
    c: FLOAT,
    kf: FLOAT,
    mu: FLOAT,
    ramp_depth: FLOAT,
):
    normal = k * depth - c * v_n
    speed = wp.length(slip)
    force = normal * n
    if speed > FLOAT(0.0):
        force = force - (wp.min(kf * speed, mu * wp.abs(normal)) / speed) * slip
    return force


@cache
def plain_sphere_law(shape: str, law: str, integrator: str) -> PlainLaw:
    """Joint and sphere without tangents: q, v, then the sphere's position, velocity and spin."""
    wall = wall_of(shape)
    contact = _ramped if law == "ramped" else _as_in_the_paper
    rk4 = integrator == "rk4"
    faces = FACES[shape]

    @wp.func
    def start(
        p: FLOATS,
        w: wp.int32,
        data: SphereData,
        r: wp.int32,
    ):
        x, u, s = start_of(p, w, data.geometry, r)
        return joined_state(
            p[w, Q0],
            p[w, V0],
            x,
            u,
            s,
        )

    @wp.func
    def rates(
        y: STATE,
        given: VEC3,
        p: FLOATS,
        world: wp.int32,
        data: SphereData,
        run: wp.int32,
    ):
        q = y[0]
        v = y[1]
        x = part(y, 2)
        u = part(y, 5)
        s = part(y, 8)
        geometry = data.geometry
        axis = triple(geometry, run, AXIS)
        origin = triple(geometry, run, ORIGIN)
        turn = geometry[run, TURNS]
        half = triple(geometry, run, HALF_SIZE)
        radius = geometry[run, RADIUS]
        angle = q + p[world, TILT]
        push = triple(geometry, run, GRAVITY) + wp.cos(angle) * triple(
            geometry, run, GRAVITY_BY_COS
        )
        push = push + wp.sin(angle) * triple(geometry, run, GRAVITY_BY_SIN)
        spin = VEC3(
            FLOAT(0.0),
            FLOAT(0.0),
            FLOAT(0.0),
        )
        reaction = FLOAT(0.0)
        for face in range(faces):
            depth, n = wall(face, x, half, radius)
            if depth > FLOAT(0.0):
                touch = x - radius * n
                lever = container_velocity(touch, axis, origin, turn)
                relative = u - radius * wp.cross(s, n) - v * lever
                v_n = wp.dot(relative, n)
                f = contact(
                    depth, v_n, relative - v_n * n, n, p[world, STIFFNESS], p[world, DAMPING], p[world, TRACTION],
                    p[world, FRICTION], geometry[run, RAMP_DEPTH],
                )  # fmt: skip
                push = push + f
                spin = spin - wp.cross(n, f) / (geometry[run, INERTIA_FACTOR] * radius)
                reaction = reaction + wp.dot(lever, f)
        extra = (
            given[LOAD] + p[world, CARRIED] * given[LOAD_PER_KG] + p[world, SPHERE_MASS] * reaction
        )
        a = acceleration(
            q,
            v,
            given[CURRENT],
            extra,
            p,
            world,
            data.constants,
            run,
        )
        turning = (turn * v) * axis
        moving = u - v * container_velocity(x, axis, origin, turn)
        return joined_state(
            v,
            a,
            moving,
            push - wp.cross(turning, u),
            spin - wp.cross(turning, s),
        )

    @wp.func
    def moved(
        y: STATE,
        z: STATE,
        k: STATE,
        data: SphereData,
        r: wp.int32,
    ):
        """The paper's equation (2): velocities first, and positions with them."""
        axis = triple(data.geometry, r, AXIS)
        lever = container_velocity(
            part(y, 2), axis, triple(data.geometry, r, ORIGIN), data.geometry[r, TURNS]
        )
        return joined_state(
            z[1],
            k[1],
            part(z, 5) - z[1] * lever,
            part(k, 5),
            part(k, 8),
        )

    @wp.func
    def step(
        y: STATE, h: FLOAT, given: VEC3, p: FLOATS, world: wp.int32, data: SphereData, run: wp.int32
    ,):  # fmt: skip
        k1 = rates(y, given, p, world, data, run)
        if wp.static(rk4):
            half = FLOAT(0.5)
            two = FLOAT(2.0)
            k2 = rates(
                y + (half * h) * k1,
                given,
                p,
                world,
                data,
                run,
            )
            k3 = rates(
                y + (half * h) * k2,
                given,
                p,
                world,
                data,
                run,
            )
            k4 = rates(
                y + h * k3,
                given,
                p,
                world,
                data,
                run,
            )
            return y + (h / FLOAT(6.0)) * (k1 + two * k2 + two * k3 + k4)
        else:
            return y + h * moved(y, y + h * k1, k1, data, run)

    return PlainLaw(
        STATE, VEC3, SphereData, DELAY, start, rates, step, standstill(STATE, SphereData)
    )


def _law_of(simulator: SphereSimulator) -> PlainLaw:
    return plain_sphere_law(simulator.enclosure.shape, simulator.law, simulator.integrator)


def states_of(
    simulator: SphereSimulator, world_run: np.ndarray, p: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Forward pass alone: q, v (W, T) and the sphere's position, velocity and spin (W, T, 3) at the sample instants."""
    states, command = record_forward(simulator, world_run, p)
    command.launch()
    return parts(states)


def record_forward(
    simulator: SphereSimulator, world_run: np.ndarray, p: np.ndarray
) -> tuple[wp.array, Any]:
    """The forward pass as a command to launch again and again, and the states that it fills, shape (W, T)."""
    runs = wp.array(
        np.asarray(world_run, dtype=np.int32),
        dtype=wp.int32,
        device="cpu",
    )
    given = wp.array(
        np.asarray(p, dtype=np.float64),
        dtype=FLOAT,
        device="cpu",
    )
    (states, *_), command = forward(
        simulator,
        _law_of(simulator),
        runs,
        given,
        record_cmd=True,
    )
    return states, command


def parts(states: wp.array) -> tuple[np.ndarray, ...]:
    """A copy of states: q, v (W, T), x, u and spin (W, T, 3)."""
    y = states.numpy().copy()
    return y[..., 0], y[..., 1], y[..., 2:5], y[..., 5:8], y[..., 8:]


def taped_sphere(
    simulator: SphereSimulator,
    world_run: np.ndarray,
    p: np.ndarray,
) -> TapedRollout:
    return tape(simulator, world_run, p, _law_of(simulator))


def taped_squeeze(
    simulator: SqueezeSimulator, world_run: np.ndarray, p: np.ndarray
) -> TapedRollout:
    return tape(
        simulator,
        world_run,
        p,
        plain_joint_law(plain_squeeze_rate, SqueezeData, simulator.integrator),
    )
