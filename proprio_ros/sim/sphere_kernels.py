"""The enclosed sphere for Warp: its rates, their exact change along any direction, and the walk through time.

The walk here is that of ``rollout.py`` written out for this law, because its RK4
keeps the joint and the sphere's three vectors apart: one matrix of tangents with 11 rows and up to 23 columns is beyond what the
compiler takes apart, which already costs the joint's 2 x 24 matrix 15 %. This was estimated, not tried on the sphere.
"""

from functools import cache
from typing import Any

import warp as wp

from proprio_ros.sim.joint_kernels import (
    CARRIED,
    CURRENT,
    DELAY,
    FRICTION_VELOCITY,
    GRAVITY_CONSTANT,
    LOAD,
    LOAD_PER_KG,
    PARAMETERS,
    Q0,
    V0,
    VEC3,
    acceleration,
    linearised_acceleration,
)
from proprio_ros.sim.rollout import TIME_EPS
from proprio_ros.sim.runtime import FLOAT

SPHERE_TERMS = (
    "sphere_mass",
    "start_x",
    "start_y",
    "start_z",
    "stiffness",
    "damping",
    "traction",
    "friction",
    "tilt",
)
"""What a sphere adds to the parameters of ``joint.py``: kg, m (three, in the container's frame), 1/s^2, 1/s, 1/s, 1, rad. ``tilt``
is how much further than its encoder shows the joint has turned the container."""
SPHERE_PARAMETERS = (*PARAMETERS, *SPHERE_TERMS)
SPHERE_MASS, START_X, START_Y, START_Z, STIFFNESS, DAMPING, TRACTION, FRICTION, TILT = range(
    len(PARAMETERS), len(SPHERE_PARAMETERS)
)
AXIS, ORIGIN, TURNS, GRAVITY, GRAVITY_BY_COS, GRAVITY_BY_SIN, HALF_SIZE = 0, 3, 6, 7, 10, 13, 16
RADIUS, INERTIA_FACTOR, RAMP_DEPTH, GEOMETRY = 19, 20, 21, 22
"""Columns of ``SphereData.geometry`` where they start, and how many there are."""
FACES = {"box": 6, "cylinder": 3, "sphere": 1}
MAT33 = wp.types.matrix(shape=(3, 3), dtype=FLOAT)


@wp.struct
class SphereData:
    """What is known about the runs."""

    constants: wp.array2d(dtype=FLOAT)
    geometry: wp.array2d(dtype=FLOAT)


@wp.func
def _triple(table: wp.array2d(dtype=FLOAT), row: wp.int32, column: wp.int32):
    return VEC3(table[row, column], table[row, column + 1], table[row, column + 2])


@wp.func
def _cross_of(a: VEC3):
    """The matrix that takes b to a x b."""
    zero = FLOAT(0.0)
    return MAT33(zero, -a[2], a[1], a[2], zero, -a[0], -a[1], a[0], zero)


@wp.func
def _container_velocity(x: VEC3, axis: VEC3, origin: VEC3, turn: FLOAT):
    """Velocity of the container at x per velocity of the joint."""
    return turn * wp.cross(axis, x - origin) + (FLOAT(1.0) - turn) * axis


@cache
def _wall(shape: str) -> Any:
    if shape == "box":

        @wp.func
        def wall(face: wp.int32, x: VEC3, half: VEC3, radius: FLOAT):
            """How deep the sphere is in a wall, and the wall's inward normal."""
            axis = face / 2
            side = FLOAT(1.0) - FLOAT(2.0) * FLOAT(face % 2)
            n = VEC3(FLOAT(0.0), FLOAT(0.0), FLOAT(0.0))
            if axis == 0:
                n = VEC3(side, FLOAT(0.0), FLOAT(0.0))
            elif axis == 1:
                n = VEC3(FLOAT(0.0), side, FLOAT(0.0))
            else:
                n = VEC3(FLOAT(0.0), FLOAT(0.0), side)
            return radius - wp.abs(wp.dot(n, half)) - wp.dot(n, x), n

    elif shape == "cylinder":

        @wp.func
        def wall(face: wp.int32, x: VEC3, half: VEC3, radius: FLOAT):
            """How deep the sphere is in a wall, and the wall's inward normal; the rim first."""
            n = VEC3(FLOAT(0.0), FLOAT(0.0), FLOAT(1.0))
            depth = FLOAT(0.0)
            if face == 0:
                out = wp.sqrt(x[0] * x[0] + x[1] * x[1])
                depth = out - (half[0] - radius)
                if out > FLOAT(0.0):
                    n = VEC3(-x[0] / out, -x[1] / out, FLOAT(0.0))
            else:
                side = FLOAT(1.0) - FLOAT(2.0) * FLOAT(face - 1)
                n = VEC3(FLOAT(0.0), FLOAT(0.0), side)
                depth = radius - half[2] - side * x[2]
            return depth, n

    else:

        @wp.func
        def wall(face: wp.int32, x: VEC3, half: VEC3, radius: FLOAT):
            """How deep the sphere is in the wall, and the wall's inward normal."""
            out = wp.length(x)
            n = VEC3(FLOAT(0.0), FLOAT(0.0), FLOAT(1.0))
            if out > FLOAT(0.0):
                n = -x / out
            return out - (half[0] - radius), n

    return wall


@wp.func
def _ramped(depth: FLOAT, v_n: FLOAT, slip: VEC3, n: VEC3, k: FLOAT, c: FLOAT, kf: FLOAT, mu: FLOAT, ramp_depth: FLOAT):
    normal = wp.max(k * depth - c * wp.min(depth / ramp_depth, FLOAT(1.0)) * v_n, FLOAT(0.0))
    most = mu * normal
    bottom = wp.sqrt(kf * kf * wp.dot(slip, slip) + most * most)
    force = normal * n
    if bottom > FLOAT(0.0):
        force = force - (kf * most / bottom) * slip
    return force


@wp.func
def _as_in_the_paper(
    depth: FLOAT, v_n: FLOAT, slip: VEC3, n: VEC3, k: FLOAT, c: FLOAT, kf: FLOAT, mu: FLOAT, ramp_depth: FLOAT
):
    normal = k * depth - c * v_n
    speed = wp.length(slip)
    force = normal * n
    if speed > FLOAT(0.0):
        force = force - (wp.min(kf * speed, mu * wp.abs(normal)) / speed) * slip
    return force


@cache
def _primal(shape: str, law: str, integrator: str) -> Any:
    """One step of everything as a Warp function, right for ``wp.Tape``."""
    wall = _wall(shape)
    contact = _ramped if law == "ramped" else _as_in_the_paper
    faces = FACES[shape]

    @wp.func
    def rates(
        q: FLOAT,
        v: FLOAT,
        x: VEC3,
        u: VEC3,
        s: VEC3,
        command: FLOAT,
        extra: FLOAT,
        p: wp.array2d(dtype=FLOAT),
        world: wp.int32,
        constants: wp.array2d(dtype=FLOAT),
        geometry: wp.array2d(dtype=FLOAT),
        run: wp.int32,
    ):
        """Time derivatives of joint velocity, sphere position, velocity and spin."""
        axis = _triple(geometry, run, AXIS)
        origin = _triple(geometry, run, ORIGIN)
        turn = geometry[run, TURNS]
        half = _triple(geometry, run, HALF_SIZE)
        radius = geometry[run, RADIUS]
        angle = q + p[world, TILT]
        push = _triple(geometry, run, GRAVITY) + wp.cos(angle) * _triple(geometry, run, GRAVITY_BY_COS)
        push = push + wp.sin(angle) * _triple(geometry, run, GRAVITY_BY_SIN)
        spin = VEC3(FLOAT(0.0), FLOAT(0.0), FLOAT(0.0))
        reaction = FLOAT(0.0)
        for face in range(faces):
            depth, n = wall(face, x, half, radius)
            if depth > FLOAT(0.0):
                touch = x - radius * n
                lever = _container_velocity(touch, axis, origin, turn)
                relative = u - radius * wp.cross(s, n) - v * lever
                v_n = wp.dot(relative, n)
                f = contact(
                    depth, v_n, relative - v_n * n, n, p[world, STIFFNESS], p[world, DAMPING], p[world, TRACTION],
                    p[world, FRICTION], geometry[run, RAMP_DEPTH],
                )  # fmt: skip
                push = push + f
                spin = spin - wp.cross(n, f) / (geometry[run, INERTIA_FACTOR] * radius)
                reaction = reaction + wp.dot(lever, f)
        a = acceleration(q, v, command, extra + p[world, SPHERE_MASS] * reaction, p, world, constants, run)
        turning = (turn * v) * axis
        moving = u - v * _container_velocity(x, axis, origin, turn)
        return a, moving, push - wp.cross(turning, u), spin - wp.cross(turning, s)

    @wp.func
    def rk4(
        q: FLOAT,
        v: FLOAT,
        x: VEC3,
        u: VEC3,
        s: VEC3,
        h: FLOAT,
        command: FLOAT,
        extra: FLOAT,
        p: wp.array2d(dtype=FLOAT),
        world: wp.int32,
        constants: wp.array2d(dtype=FLOAT),
        geometry: wp.array2d(dtype=FLOAT),
        run: wp.int32,
    ):
        g = FLOAT(0.5) * h
        a1, x1, u1, s1 = rates(q, v, x, u, s, command, extra, p, world, constants, geometry, run)
        v2 = v + g * a1
        a2, x2, u2, s2 = rates(
            q + g * v, v2, x + g * x1, u + g * u1, s + g * s1, command, extra, p, world, constants, geometry, run
        )
        v3 = v + g * a2
        a3, x3, u3, s3 = rates(
            q + g * v2, v3, x + g * x2, u + g * u2, s + g * s2, command, extra, p, world, constants, geometry, run
        )
        v4 = v + h * a3
        a4, x4, u4, s4 = rates(
            q + h * v3, v4, x + h * x3, u + h * u3, s + h * s3, command, extra, p, world, constants, geometry, run
        )
        sixth = h / FLOAT(6.0)
        two = FLOAT(2.0)
        return (
            q + sixth * (v + two * v2 + two * v3 + v4),
            v + sixth * (a1 + two * a2 + two * a3 + a4),
            x + sixth * (x1 + two * x2 + two * x3 + x4),
            u + sixth * (u1 + two * u2 + two * u3 + u4),
            s + sixth * (s1 + two * s2 + two * s3 + s4),
        )

    @wp.func
    def semi_implicit(
        q: FLOAT,
        v: FLOAT,
        x: VEC3,
        u: VEC3,
        s: VEC3,
        h: FLOAT,
        command: FLOAT,
        extra: FLOAT,
        p: wp.array2d(dtype=FLOAT),
        world: wp.int32,
        constants: wp.array2d(dtype=FLOAT),
        geometry: wp.array2d(dtype=FLOAT),
        run: wp.int32,
    ):
        """The paper's equation (2): velocities first, and positions with them."""
        a, _x, du, ds = rates(q, v, x, u, s, command, extra, p, world, constants, geometry, run)
        v2 = v + h * a
        u2 = u + h * du
        lever = _container_velocity(
            x, _triple(geometry, run, AXIS), _triple(geometry, run, ORIGIN), geometry[run, TURNS]
        )
        return q + h * v2, v2, x + h * (u2 - v2 * lever), u2, s + h * ds

    return rates, rk4 if integrator == "rk4" else semi_implicit


@wp.func
def _start(p: wp.array2d(dtype=FLOAT), world: wp.int32, geometry: wp.array2d(dtype=FLOAT), run: wp.int32):
    """Position, velocity and spin of a sphere that moves with the container."""
    x = _triple(p, world, START_X)
    axis = _triple(geometry, run, AXIS)
    turn = geometry[run, TURNS]
    v = p[world, V0]
    return x, v * _container_velocity(x, axis, _triple(geometry, run, ORIGIN), turn), (turn * v) * axis


@cache
def tangent_kernel(directions: int, integrator: str, stribeck: bool, shape: str, law: str) -> tuple[Any, Any]:
    """Rollout with ``directions`` exact forward sensitivities (thread = world), and the struct of its results."""
    vec = wp.types.vector(length=directions, dtype=FLOAT)
    mat = wp.types.matrix(shape=(3, directions), dtype=FLOAT)
    linearised = linearised_acceleration(directions, stribeck)
    wall = _wall(shape)
    curved = shape != "box"
    ramped = law == "ramped"
    rk4 = integrator == "rk4"

    @wp.func
    def touched(
        depth: FLOAT,
        n: VEC3,
        x: VEC3,
        u: VEC3,
        s: VEC3,
        v: FLOAT,
        dx: mat,
        du: mat,
        ds: mat,
        dv: vec,
        p: wp.array2d(dtype=FLOAT),
        dp: wp.array2d(dtype=vec),
        world: wp.int32,
        geometry: wp.array2d(dtype=FLOAT),
        run: wp.int32,
    ):
        """Force per kilogram of one contact, what it does to spin and joint, and the tangents of all three."""
        axis = _triple(geometry, run, AXIS)
        origin = _triple(geometry, run, ORIGIN)
        turn = geometry[run, TURNS]
        radius = geometry[run, RADIUS]
        k = p[world, STIFFNESS]
        c = p[world, DAMPING]
        kf = p[world, TRACTION]
        mu = p[world, FRICTION]
        across = _cross_of(n)
        lever = _container_velocity(x - radius * n, axis, origin, turn)
        relative = u - radius * wp.cross(s, n) - v * lever
        v_n = wp.dot(relative, n)
        slip = relative - v_n * n

        d_depth = -(n @ dx)
        d_lever = (turn * _cross_of(axis)) @ dx
        d_relative = du + (radius * across) @ ds - wp.outer(lever, dv)
        dn = mat()
        if wp.static(curved):
            # only the part of dx along the wall turns the normal; 1 / curvature is how far the centre is from the axis
            flat = dx + wp.outer(n, d_depth)
            if wp.static(shape == "cylinder"):
                if n[2] != FLOAT(0.0):
                    flat = mat()
                else:
                    flat[2] = vec()
            reach = depth + geometry[run, HALF_SIZE] - radius
            dn = flat * (FLOAT(-1.0) / reach)
            d_lever = d_lever - (turn * radius * _cross_of(axis)) @ dn
            d_relative = d_relative - (radius * _cross_of(s)) @ dn
        d_relative = d_relative - v * d_lever
        d_v_n = n @ d_relative
        if wp.static(curved):
            d_v_n = d_v_n + relative @ dn
        d_slip = d_relative - wp.outer(n, d_v_n)
        if wp.static(curved):
            d_slip = d_slip - v_n * dn

        normal = FLOAT(0.0)
        d_normal = vec()
        scale = FLOAT(0.0)  # f_t = -scale slip
        d_scale = vec()
        if wp.static(ramped):
            ramp = depth / geometry[run, RAMP_DEPTH]
            rise = FLOAT(1.0) / geometry[run, RAMP_DEPTH]
            if ramp > FLOAT(1.0):
                ramp = FLOAT(1.0)
                rise = FLOAT(0.0)
            normal = k * depth - c * ramp * v_n
            if normal > FLOAT(0.0):
                d_normal = (
                    (k - c * rise * v_n) * d_depth
                    - (c * ramp) * d_v_n
                    + depth * dp[world, STIFFNESS]
                    - (ramp * v_n) * dp[world, DAMPING]
                )
            else:
                normal = FLOAT(0.0)
            most = mu * normal
            slipping = wp.dot(slip, slip)
            bottom = wp.sqrt(kf * kf * slipping + most * most)
            if bottom > FLOAT(0.0):
                d_most = mu * d_normal + normal * dp[world, FRICTION]
                scale = kf * most / bottom
                d_bottom = (
                    (kf * kf) * (slip @ d_slip) + (kf * slipping) * dp[world, TRACTION] + most * d_most
                ) / bottom
                d_scale = (kf * d_most + most * dp[world, TRACTION] - scale * d_bottom) / bottom
        else:
            normal = k * depth - c * v_n
            d_normal = k * d_depth - c * d_v_n + depth * dp[world, STIFFNESS] - v_n * dp[world, DAMPING]
            speed = wp.length(slip)
            most = mu * wp.abs(normal)
            if kf * speed <= most:
                scale = kf
                d_scale = vec(dp[world, TRACTION])
            else:
                scale = most / speed
                d_most = (mu * wp.sign(normal)) * d_normal + wp.abs(normal) * dp[world, FRICTION]
                d_scale = (d_most - (scale / speed) * (slip @ d_slip)) / speed
        f = normal * n - scale * slip
        df = wp.outer(n, d_normal) - scale * d_slip - wp.outer(slip, d_scale)
        if wp.static(curved):
            df = df + normal * dn
        by_inertia = FLOAT(-1.0) / (geometry[run, INERTIA_FACTOR] * radius)
        spin = by_inertia * wp.cross(n, f)
        d_spin = (by_inertia * across) @ df
        if wp.static(curved):
            d_spin = d_spin - (by_inertia * _cross_of(f)) @ dn
        return f, df, spin, d_spin, wp.dot(lever, f), lever @ df + f @ d_lever

    @wp.func
    def sphere_rates(
        q: FLOAT,
        v: FLOAT,
        x: VEC3,
        u: VEC3,
        s: VEC3,
        dq: vec,
        dv: vec,
        dx: mat,
        du: mat,
        ds: mat,
        p: wp.array2d(dtype=FLOAT),
        dp: wp.array2d(dtype=vec),
        world: wp.int32,
        geometry: wp.array2d(dtype=FLOAT),
        run: wp.int32,
    ):
        """Rates of the sphere, its load on the joint, and the tangents of both."""
        axis = _triple(geometry, run, AXIS)
        origin = _triple(geometry, run, ORIGIN)
        turn = geometry[run, TURNS]
        half = _triple(geometry, run, HALF_SIZE)
        radius = geometry[run, RADIUS]
        angle = q + p[world, TILT]
        cos = wp.cos(angle)
        sin = wp.sin(angle)
        by_cos = _triple(geometry, run, GRAVITY_BY_COS)
        by_sin = _triple(geometry, run, GRAVITY_BY_SIN)
        turning = (turn * v) * axis
        round = _cross_of(turning)
        lever = _container_velocity(x, axis, origin, turn)
        moving = u - v * lever
        d_moving = du - wp.outer(lever, dv) - round @ dx
        push = _triple(geometry, run, GRAVITY) + cos * by_cos + sin * by_sin - wp.cross(turning, u)
        d_push = wp.outer(cos * by_sin - sin * by_cos, dq + dp[world, TILT]) - round @ du
        d_push = d_push - wp.outer(turn * wp.cross(axis, u), dv)
        spin = -wp.cross(turning, s)
        d_spin = -(round @ ds) - wp.outer(turn * wp.cross(axis, s), dv)
        reaction = FLOAT(0.0)
        d_reaction = vec()
        faces = wp.int32(wp.static(FACES[shape]))
        face = wp.int32(0)
        while face < faces:
            depth, n = wall(face, x, half, radius)
            if depth > FLOAT(0.0):
                f, df, turned, d_turned, back, d_back = touched(
                    depth, n, x, u, s, v, dx, du, ds, dv, p, dp, world, geometry, run
                )
                push = push + f
                d_push = d_push + df
                spin = spin + turned
                d_spin = d_spin + d_turned
                reaction = reaction + back
                d_reaction = d_reaction + d_back
            face = face + 1
        mass = p[world, SPHERE_MASS]
        load = mass * reaction
        return moving, d_moving, push, d_push, spin, d_spin, load, mass * d_reaction + reaction * dp[world, SPHERE_MASS]

    @wp.struct
    class Out:
        q: wp.array2d(dtype=FLOAT)
        v: wp.array2d(dtype=FLOAT)
        dq: wp.array2d(dtype=vec)
        x: wp.array2d(dtype=VEC3)
        dx: wp.array2d(dtype=mat)

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(
        # Run data:
        sample_times: wp.array2d(dtype=FLOAT),
        sample_count: wp.array(dtype=wp.int32),
        input_times: wp.array2d(dtype=FLOAT),
        inputs: wp.array2d(dtype=VEC3),
        input_count: wp.array(dtype=wp.int32),
        steps: wp.array2d(dtype=FLOAT),
        data: SphereData,
        # World data in:
        world_run: wp.array(dtype=wp.int32),
        p_in: wp.array2d(dtype=FLOAT),
        dp_in: wp.array2d(dtype=vec),
        # World data out:
        out: Out,
    ):
        w = wp.tid()
        r = world_run[w]
        constants = data.constants
        geometry = data.geometry
        delay = p_in[w, DELAY]
        d_delay = dp_in[w, DELAY]
        carried = p_in[w, CARRIED]
        vs = constants[r, FRICTION_VELOCITY]
        coarse = steps[r, 0]
        fine = steps[r, 1]
        given = inputs[r, 0]
        extra = p_in[w, GRAVITY_CONSTANT] + given[LOAD] + carried * given[LOAD_PER_KG]
        d_extra = dp_in[w, GRAVITY_CONSTANT] + given[LOAD_PER_KG] * dp_in[w, CARRIED]

        q = p_in[w, Q0]
        v = p_in[w, V0]
        dq = dp_in[w, Q0]
        dv = dp_in[w, V0]
        axis = _triple(geometry, r, AXIS)
        turn = geometry[r, TURNS]
        x, u, s = _start(p_in, w, geometry, r)
        dx = mat()
        dx[0] = dp_in[w, START_X]
        dx[1] = dp_in[w, START_Y]
        dx[2] = dp_in[w, START_Z]
        du = (
            wp.outer(_container_velocity(x, axis, _triple(geometry, r, ORIGIN), turn), dv)
            + (turn * v * _cross_of(axis)) @ dx
        )
        ds = wp.outer(turn * axis, dv)
        t = FLOAT(0.0)
        dt = vec()
        segment = wp.int32(0)
        segments = input_count[r]
        for k in range(sample_count[r]):
            goal = sample_times[r, k] - delay
            if goal <= FLOAT(0.0):
                out.q[w, k] = q + v * goal
                out.v[w, k] = v
                out.dq[w, k] = dq + goal * dv - v * d_delay
                out.x[w, k] = x
                out.dx[w, k] = dx
            else:
                arrived = wp.int32(0)
                while arrived == 0:
                    end = goal
                    d_end = -d_delay
                    switches = wp.int32(0)
                    if segment + 1 < segments:
                        if input_times[r, segment + 1] < goal:
                            end = input_times[r, segment + 1]
                            d_end = vec()
                            switches = 1
                    last = wp.int32(0)
                    while last == 0:
                        # stages of Runge-Kutta, or the one of Euler; each starts from the state plus `reach` of the rates before
                        h = coarse
                        dh = vec()
                        reach = FLOAT(0.0)
                        qj = q
                        vj = v
                        xj = x
                        uj = u
                        sj = s
                        dqj = dq
                        dvj = dv
                        dxj = dx
                        duj = du
                        dsj = ds
                        q_sum = FLOAT(0.0)
                        v_sum = FLOAT(0.0)
                        x_sum = VEC3()
                        u_sum = VEC3()
                        s_sum = VEC3()
                        dq_sum = vec()
                        dv_sum = vec()
                        dx_sum = mat()
                        du_sum = mat()
                        ds_sum = mat()
                        stage = wp.int32(0)
                        stages = wp.int32(wp.static(4 if rk4 else 1))
                        while stage < stages:
                            x1, dx1, u1, du1, s1, ds1, load, d_load = sphere_rates(
                                qj, vj, xj, uj, sj, dqj, dvj, dxj, duj, dsj, p_in, dp_in, w, geometry, r
                            )
                            a, da = linearised(
                                qj,
                                vj,
                                dqj,
                                dvj,
                                given[CURRENT],
                                extra + load,
                                d_extra + d_load,
                                p_in,
                                dp_in,
                                w,
                                constants,
                                r,
                            )
                            if stage == 0:
                                if fine < coarse:
                                    if wp.abs(v) < FLOAT(20.0) * vs + wp.abs(a) * coarse:
                                        h = fine
                                if t + h > end - FLOAT(TIME_EPS):
                                    h = end - t
                                    dh = d_end - dt
                                    last = 1
                            if wp.static(rk4):
                                weight = FLOAT(1.0) / FLOAT(3.0)
                                share = FLOAT(0.5)
                                if stage == 0 or stage == 3:
                                    weight = FLOAT(1.0) / FLOAT(6.0)
                                if stage == 2:
                                    share = FLOAT(1.0)
                                q_sum = q_sum + weight * vj
                                v_sum = v_sum + weight * a
                                x_sum = x_sum + weight * x1
                                u_sum = u_sum + weight * u1
                                s_sum = s_sum + weight * s1
                                dq_sum = dq_sum + weight * dvj
                                dv_sum = dv_sum + weight * da
                                dx_sum = dx_sum + weight * dx1
                                du_sum = du_sum + weight * du1
                                ds_sum = ds_sum + weight * ds1
                                if stage < 3:
                                    reach = share * h
                                    by = share * dh
                                    qj = q + reach * vj
                                    dqj = dq + reach * dvj + vj * by
                                    vj = v + reach * a
                                    dvj = dv + reach * da + a * by
                                    xj = x + reach * x1
                                    uj = u + reach * u1
                                    sj = s + reach * s1
                                    dxj = dx + reach * dx1
                                    duj = du + reach * du1
                                    dsj = ds + reach * ds1
                                    if last == 1:
                                        dxj = dxj + wp.outer(x1, by)
                                        duj = duj + wp.outer(u1, by)
                                        dsj = dsj + wp.outer(s1, by)
                            else:
                                lever = _container_velocity(x, axis, _triple(geometry, r, ORIGIN), turn)
                                v_sum = a
                                dv_sum = da
                                u_sum = u1
                                du_sum = du1
                                s_sum = s1
                                ds_sum = ds1
                                q_sum = v + h * a
                                dq_sum = dv + h * da + a * dh
                                x_sum = u + h * u1 - q_sum * lever
                                dx_sum = du + h * du1 + wp.outer(u1, dh) - wp.outer(lever, dq_sum)
                                dx_sum = dx_sum - (turn * q_sum * _cross_of(axis)) @ dx
                            stage = stage + 1
                        q = q + h * q_sum
                        v = v + h * v_sum
                        x = x + h * x_sum
                        u = u + h * u_sum
                        s = s + h * s_sum
                        dq = dq + h * dq_sum + q_sum * dh
                        dv = dv + h * dv_sum + v_sum * dh
                        dx = dx + h * dx_sum
                        du = du + h * du_sum
                        ds = ds + h * ds_sum
                        t = t + h
                        if last == 1:
                            dx = dx + wp.outer(x_sum, dh)
                            du = du + wp.outer(u_sum, dh)
                            ds = ds + wp.outer(s_sum, dh)
                            t = end
                            dt = d_end
                    if switches == 1:
                        segment = segment + 1
                        given = inputs[r, segment]
                        extra = p_in[w, GRAVITY_CONSTANT] + given[LOAD] + carried * given[LOAD_PER_KG]
                        d_extra = dp_in[w, GRAVITY_CONSTANT] + given[LOAD_PER_KG] * dp_in[w, CARRIED]
                    else:
                        arrived = 1
                out.q[w, k] = q
                out.v[w, k] = v
                out.dq[w, k] = dq
                out.x[w, k] = x
                out.dx[w, k] = dx

    return kernel, Out


@cache
def forward_kernel(integrator: str, shape: str, law: str) -> Any:
    """Rollout without tangents; where ``capacity`` is above 0 it writes down every step for the adjoint to follow."""
    rates, step = _primal(shape, law, integrator)

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(
        # Run data:
        sample_times: wp.array2d(dtype=FLOAT),
        sample_count: wp.array(dtype=wp.int32),
        input_times: wp.array2d(dtype=FLOAT),
        inputs: wp.array2d(dtype=VEC3),
        input_count: wp.array(dtype=wp.int32),
        steps: wp.array2d(dtype=FLOAT),
        data: SphereData,
        # World data in:
        world_run: wp.array(dtype=wp.int32),
        p_in: wp.array2d(dtype=FLOAT),
        capacity: wp.int32,
        # World data out:
        q_out: wp.array2d(dtype=FLOAT),
        v_out: wp.array2d(dtype=FLOAT),
        x_out: wp.array2d(dtype=VEC3),
        u_out: wp.array2d(dtype=VEC3),
        s_out: wp.array2d(dtype=VEC3),
        # step length, its change with the delay, input, and the step after which each sample is taken
        step_out: wp.array2d(dtype=FLOAT),
        step_by_delay_out: wp.array2d(dtype=FLOAT),
        input_out: wp.array2d(dtype=VEC3),
        steps_out: wp.array(dtype=wp.int32),
        sample_step_out: wp.array2d(dtype=wp.int32),
    ):
        w = wp.tid()
        r = world_run[w]
        constants = data.constants
        geometry = data.geometry
        vs = constants[r, FRICTION_VELOCITY]
        coarse = steps[r, 0]
        fine = steps[r, 1]
        delay = p_in[w, DELAY]
        q = p_in[w, Q0]
        v = p_in[w, V0]
        x, u, s = _start(p_in, w, geometry, r)
        t = FLOAT(0.0)
        moved = FLOAT(0.0)  # d t / d delay
        segment = wp.int32(0)
        given = inputs[r, 0]
        extra = given[LOAD] + p_in[w, CARRIED] * given[LOAD_PER_KG]
        n = wp.int32(0)
        for k in range(sample_count[r]):
            goal = sample_times[r, k] - delay
            if capacity > 0:
                sample_step_out[w, k] = -1
            if goal <= FLOAT(0.0):
                q_out[w, k] = q + v * goal
            else:
                arrived = wp.int32(0)
                while arrived == 0:
                    end = goal
                    d_end = FLOAT(-1.0)
                    switches = wp.int32(0)
                    if segment + 1 < input_count[r]:
                        if input_times[r, segment + 1] < goal:
                            end = input_times[r, segment + 1]
                            d_end = FLOAT(0.0)
                            switches = 1
                    last = wp.int32(0)
                    while last == 0:
                        h = coarse
                        if fine < coarse:
                            a, _x, _u, _s = rates(q, v, x, u, s, given[CURRENT], extra, p_in, w, constants, geometry, r)
                            if wp.abs(v) < FLOAT(20.0) * vs + wp.abs(a) * coarse:
                                h = fine
                        dh = FLOAT(0.0)
                        if t + h > end - FLOAT(TIME_EPS):
                            h = end - t
                            dh = d_end - moved
                            last = 1
                        if n < capacity:
                            step_out[w, n] = h
                            step_by_delay_out[w, n] = dh
                            input_out[w, n] = given
                        q2, v2, x2, u2, s2 = step(
                            q, v, x, u, s, h, given[CURRENT], extra, p_in, w, constants, geometry, r
                        )
                        q = q2
                        v = v2
                        x = x2
                        u = u2
                        s = s2
                        n = n + 1
                        t = t + h
                        if last == 1:
                            t = end
                            moved = d_end
                    if switches == 1:
                        segment = segment + 1
                        given = inputs[r, segment]
                        extra = given[LOAD] + p_in[w, CARRIED] * given[LOAD_PER_KG]
                    else:
                        arrived = 1
                q_out[w, k] = q
                if capacity > 0:
                    sample_step_out[w, k] = n
            v_out[w, k] = v
            x_out[w, k] = x
            u_out[w, k] = u
            s_out[w, k] = s
        steps_out[w] = n

    return kernel


@cache
def taped_kernel(integrator: str, shape: str, law: str) -> Any:
    """A kernel whose adjoint is right: every step writes its own row, no state is overwritten."""
    _rates, step = _primal(shape, law, integrator)

    @wp.kernel(module="unique")
    def roll(
        # Run data:
        data: SphereData,
        # World data in:
        world_run: wp.array(dtype=wp.int32),
        p_in: wp.array2d(dtype=FLOAT),
        delay_at: wp.array(dtype=FLOAT),
        step_in: wp.array2d(dtype=FLOAT),
        step_by_delay_in: wp.array2d(dtype=FLOAT),
        input_in: wp.array2d(dtype=VEC3),
        steps_in: wp.array(dtype=wp.int32),
        # World data out:
        q_out: wp.array2d(dtype=FLOAT),
        v_out: wp.array2d(dtype=FLOAT),
        x_out: wp.array2d(dtype=VEC3),
        u_out: wp.array2d(dtype=VEC3),
        s_out: wp.array2d(dtype=VEC3),
    ):
        w = wp.tid()
        r = world_run[w]
        constants = data.constants
        geometry = data.geometry
        delay = p_in[w, DELAY]
        x0, u0, s0 = _start(p_in, w, geometry, r)
        q_out[w, 0] = p_in[w, Q0]
        v_out[w, 0] = p_in[w, V0]
        x_out[w, 0] = x0
        u_out[w, 0] = u0
        s_out[w, 0] = s0
        for n in range(steps_in[w]):
            h = step_in[w, n] + step_by_delay_in[w, n] * (delay - delay_at[w])
            given = input_in[w, n]
            extra = given[LOAD] + p_in[w, CARRIED] * given[LOAD_PER_KG]
            q2, v2, x2, u2, s2 = step(
                q_out[w, n], v_out[w, n], x_out[w, n], u_out[w, n], s_out[w, n], h, given[CURRENT], extra, p_in, w,
                constants, geometry, r,
            )  # fmt: skip
            q_out[w, n + 1] = q2
            v_out[w, n + 1] = v2
            x_out[w, n + 1] = x2
            u_out[w, n + 1] = u2
            s_out[w, n + 1] = s2

    return roll
