"""The laws of a sphere and of a squeeze without tangents, for Warp: what `plain_laws` rolls out."""

from functools import cache

import warp as wp

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
from proprio_ros.sim.squeeze_kernels import SqueezeData, excitation_of_block
from support.taped_kernels import PlainLaw, acceleration


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
