"""The law of a joint with an enclosed sphere, for Warp: its rates and their exact change along any direction.

Joint and sphere are one state of 11 entries. The compiler takes apart its matrix of tangents up to 16 columns, where the walk of
``rollout_kernels.py`` takes 0.89 to 0.97 of the time of one written out for this law (5 and 16 directions, 8 worlds: 2.9 and
4.2 ms), and not above: 23 columns take 2.1 times as long. So all 23 directions go in two launches of 16 and 8, which together take
0.86 of the time of one launch of a walk of its own (7.2 against 8.4 ms). The numbers are the same to the last bit.
"""

from functools import cache
from typing import Any

import warp as wp

from proprio_ros.sim.joint_kernels import (
    CARRIED,
    CURRENT,
    DELAY,
    GRAVITY_CONSTANT,
    LOAD,
    LOAD_PER_KG,
    PARAMETERS,
    Q0,
    V0,
    VEC3,
    linearised_acceleration,
    standstill,
)
from proprio_ros.sim.rollout_kernels import Law
from proprio_ros.sim.runtime import FLOAT, FLOATS

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
# columns of ``SphereData.geometry`` where they start
RADIUS, INERTIA_FACTOR, RAMP_DEPTH = 19, 20, 21
FACES = {"box": 6, "cylinder": 3, "sphere": 1}
MAT33 = wp.types.matrix(shape=(3, 3), dtype=FLOAT)
STATE = wp.types.vector(length=11, dtype=FLOAT)


@wp.func
def joined_state(
    q: FLOAT,
    v: FLOAT,
    x: VEC3,
    u: VEC3,
    s: VEC3,
):
    """All of one state.

    Args:
        q: Position of the joint [rad].
        v: Its velocity [rad/s].
        x: Place of the sphere [m].
        u: Its velocity [m/s].
        s: Its spin [rad/s].
    """
    return STATE(
        q,
        v,
        x[0],
        x[1],
        x[2],
        u[0],
        u[1],
        u[2],
        s[0],
        s[1],
        s[2],
    )


@wp.func
def part(y: STATE, row: wp.int32):
    return VEC3(y[row], y[row + 1], y[row + 2])


@wp.struct
class SphereData:
    """What is known about the runs."""

    constants: FLOATS
    geometry: FLOATS


@wp.func
def triple(table: FLOATS, row: wp.int32, column: wp.int32):
    """Three numbers of a table that stand beside each other.

    Args:
        table: Any.
        row: Of the first.
        column: Of the first.
    """
    return VEC3(
        table[row, column],
        table[row, column + 1],
        table[row, column + 2],
    )


@wp.func
def _cross_of(a: VEC3):
    """The matrix that takes b to a x b."""
    zero = FLOAT(0.0)
    return MAT33(
        zero,
        -a[2],
        a[1],
        a[2],
        zero,
        -a[0],
        -a[1],
        a[0],
        zero,
    )


@wp.func
def container_velocity(x: VEC3, axis: VEC3, origin: VEC3, turn: FLOAT):
    """Velocity of the container at a place per velocity of the joint.

    Args:
        x: The place [m].
        axis: Of the joint.
        origin: A point on it [m].
        turn: 1 where the joint turns, 0 where it slides.
    """
    return turn * wp.cross(axis, x - origin) + (FLOAT(1.0) - turn) * axis


@cache
def wall_of(shape: str) -> Any:
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
                    n = VEC3(
                        -x[0] / out,
                        -x[1] / out,
                        FLOAT(0.0),
                    )
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
def start_of(
    p: FLOATS,
    world: wp.int32,
    geometry: FLOATS,
    run: wp.int32,
):
    """Position, velocity and spin of a sphere that moves with the container.

    Args:
        p: Parameters of each world, shape (W, P).
        world: Row of the world.
        geometry: Of the runs, a row each.
        run: Row of the run.
    """
    x = triple(p, world, START_X)
    axis = triple(geometry, run, AXIS)
    turn = geometry[run, TURNS]
    v = p[world, V0]
    return (
        x,
        v * container_velocity(x, axis, triple(geometry, run, ORIGIN), turn),
        (turn * v) * axis,
    )


@cache
def sphere_law(directions: int, stribeck: bool, shape: str, law: str) -> Law:
    """Joint and sphere with tangents; the state is q, v, then the sphere's position, velocity and spin.

    Args:
        directions: How many tangents are carried.
        stribeck: Whether friction rises towards standstill.
        shape: Of the container.
        law: Of contact.
    """
    vec = wp.types.vector(length=directions, dtype=FLOAT)
    mat = wp.types.matrix(shape=(3, directions), dtype=FLOAT)
    whole = wp.types.matrix(shape=(11, directions), dtype=FLOAT)
    linearised = linearised_acceleration(directions, stribeck)
    wall = wall_of(shape)
    curved = shape != "box"
    ramped = law == "ramped"

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
        p: FLOATS,
        dp: wp.array2d(dtype=vec),
        world: wp.int32,
        geometry: FLOATS,
        run: wp.int32,
    ):
        """Force per kilogram of one contact, what it does to spin and joint, and the tangents of all three.

        Args:
            depth: Of the sphere in the wall [m].
            n: Inward normal of the wall.
            x: Place of the sphere [m].
            u: Its velocity [m/s].
            s: Its spin [rad/s].
            v: Velocity of the joint [rad/s].
            dx: Tangents of the place.
            du: Of the velocity.
            ds: Of the spin.
            dv: Of the joint's velocity.
            p: Parameters of each world, shape (W, P).
            dp: Their derivatives by the directions, shape (W, P).
            world: Row of the world.
            geometry: Of the runs, a row each.
            run: Row of the run.
        """
        axis = triple(geometry, run, AXIS)
        origin = triple(geometry, run, ORIGIN)
        turn = geometry[run, TURNS]
        radius = geometry[run, RADIUS]
        k = p[world, STIFFNESS]
        c = p[world, DAMPING]
        kf = p[world, TRACTION]
        mu = p[world, FRICTION]
        across = _cross_of(n)
        lever = container_velocity(x - radius * n, axis, origin, turn)
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
                    (kf * kf) * (slip @ d_slip)
                    + (kf * slipping) * dp[world, TRACTION]
                    + most * d_most
                ) / bottom
                d_scale = (kf * d_most + most * dp[world, TRACTION] - scale * d_bottom) / bottom
        else:
            normal = k * depth - c * v_n
            d_normal = (
                k * d_depth - c * d_v_n + depth * dp[world, STIFFNESS] - v_n * dp[world, DAMPING]
            )
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

    @wp.struct
    class Out:
        q: FLOATS
        v: FLOATS
        dq: wp.array2d(dtype=vec)
        x: wp.array2d(dtype=VEC3)
        dx: wp.array2d(dtype=mat)

    @wp.func
    def start(
        p: FLOATS,
        dp: wp.array2d(dtype=vec),
        w: wp.int32,
        data: SphereData,
        r: wp.int32,
    ):
        """Where a run begins.

        Args:
            p: Parameters of each world, shape (W, P), in the order of `INDEX`.
            dp: Their derivatives by the directions, shape (W, P).
            w: Row of the world.
            data: Of the runs.
            r: Row of the run.
        """
        x, u, s = start_of(p, w, data.geometry, r)
        axis = triple(data.geometry, r, AXIS)
        turn = data.geometry[r, TURNS]
        dv = dp[w, V0]
        dx = wp.matrix_from_rows(
            dp[w, START_X],
            dp[w, START_Y],
            dp[w, START_Z],
        )
        lever = container_velocity(x, axis, triple(data.geometry, r, ORIGIN), turn)
        du = wp.outer(lever, dv) + (turn * p[w, V0] * _cross_of(axis)) @ dx
        return joined_state(
            p[w, Q0],
            p[w, V0],
            x,
            u,
            s,
        ), joined(
            dp[w, Q0],
            dv,
            dx,
            du,
            wp.outer(turn * axis, dv),
        )

    @wp.func
    def joined(
        dq: vec,
        dv: vec,
        dx: mat,
        du: mat,
        ds: mat,
    ):
        """All tangents of one state.

        Args:
            dq: Of the joint's position.
            dv: Of its velocity.
            dx: Of the sphere's place.
            du: Of its velocity.
            ds: Of its spin.
        """
        return wp.matrix_from_rows(
            dq, dv, dx[0], dx[1], dx[2], du[0], du[1], du[2], ds[0], ds[1], ds[2]
        )

    @wp.func
    def three(dy: whole, row: wp.int32):
        return wp.matrix_from_rows(
            dy[row],
            dy[row + 1],
            dy[row + 2],
        )

    @wp.func
    def rates(
        y: STATE,
        dy: whole,
        given: VEC3,
        p: FLOATS,
        dp: wp.array2d(dtype=vec),
        world: wp.int32,
        data: SphereData,
        run: wp.int32,
    ):
        """What a state changes by, with its tangents.

        Args:
            y: State.
            dy: Its tangents.
            given: Inputs at this time.
            p: Parameters of each world, shape (W, P).
            dp: Their derivatives by the directions, shape (W, P).
            world: Row of the world.
            data: Of the runs.
            run: Row of the run.
        """
        q = y[0]
        v = y[1]
        x = part(y, 2)
        u = part(y, 5)
        s = part(y, 8)
        dq = dy[0]
        dv = dy[1]
        dx = three(dy, 2)
        du = three(dy, 5)
        ds = three(dy, 8)
        geometry = data.geometry
        axis = triple(geometry, run, AXIS)
        origin = triple(geometry, run, ORIGIN)
        turn = geometry[run, TURNS]
        half = triple(geometry, run, HALF_SIZE)
        radius = geometry[run, RADIUS]
        angle = q + p[world, TILT]
        cos = wp.cos(angle)
        sin = wp.sin(angle)
        by_cos = triple(geometry, run, GRAVITY_BY_COS)
        by_sin = triple(geometry, run, GRAVITY_BY_SIN)
        turning = (turn * v) * axis
        around = _cross_of(turning)
        lever = container_velocity(x, axis, origin, turn)
        moving = u - v * lever
        d_moving = du - wp.outer(lever, dv) - around @ dx
        push = triple(geometry, run, GRAVITY) + cos * by_cos + sin * by_sin - wp.cross(turning, u)
        d_push = wp.outer(cos * by_sin - sin * by_cos, dq + dp[world, TILT]) - around @ du
        d_push = d_push - wp.outer(turn * wp.cross(axis, u), dv)
        spin = -wp.cross(turning, s)
        d_spin = -(around @ ds) - wp.outer(turn * wp.cross(axis, s), dv)
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
        load = (
            p[world, GRAVITY_CONSTANT]
            + given[LOAD]
            + p[world, CARRIED] * given[LOAD_PER_KG]
            + mass * reaction
        )
        d_load = mass * d_reaction + reaction * dp[world, SPHERE_MASS]
        d_load = dp[world, GRAVITY_CONSTANT] + given[LOAD_PER_KG] * dp[world, CARRIED] + d_load
        a, da = linearised(
            q, v, dq, dv, given[CURRENT], load, d_load, p, dp, world, data.constants, run
        )
        return joined_state(v, a, moving, push, spin), joined(dv, da, d_moving, d_push, d_spin)

    @wp.func
    def moved(
        y: STATE,
        dy: whole,
        z: STATE,
        dz: whole,
        k: STATE,
        dk: whole,
        data: SphereData,
        r: wp.int32,
    ):
        """What the state z changes by, as a state; the sphere moves in the container.

        Args:
            y: State at the begin of the step.
            dy: Its tangents.
            z: State now.
            dz: Its tangents.
            k: What z changes by.
            dk: Its tangents.
            data: Of the runs.
            r: Row of the run.
        """
        axis = triple(data.geometry, r, AXIS)
        turn = data.geometry[r, TURNS]
        lever = container_velocity(
            part(y, 2),
            axis,
            triple(data.geometry, r, ORIGIN),
            turn,
        )
        dx = three(dz, 5) - wp.outer(lever, dz[1]) - (turn * z[1] * _cross_of(axis)) @ three(dy, 2)
        return (
            joined_state(
                z[1],
                k[1],
                part(z, 5) - z[1] * lever,
                part(k, 5),
                part(k, 8),
            ),
            joined(
                dz[1],
                dk[1],
                dx,
                three(dk, 5),
                three(dk, 8),
            ),
        )

    @wp.func
    def record(
        out: Out,
        w: wp.int32,
        k: wp.int32,
        y: STATE,
        dy: whole,
        lead: FLOAT,
        d_lead: vec,
    ):
        """Write down one sample.

        Args:
            out: Where.
            w: Row of the world.
            k: Number of the sample.
            y: State.
            dy: Its tangents.
            lead: How long before that the encoder is read, not above 0 [s].
            d_lead: Its tangents.
        """
        out.v[w, k] = y[1]
        if lead < FLOAT(0.0):
            out.q[w, k] = y[0] + y[1] * lead
            out.dq[w, k] = dy[0] + lead * dy[1] + y[1] * d_lead
        else:
            out.q[w, k] = y[0]
            out.dq[w, k] = dy[0]
        out.x[w, k] = part(y, 2)
        out.dx[w, k] = three(dy, 2)

    return Law(
        directions, STATE, VEC3, whole, SphereData, Out, DELAY, start, rates, moved, standstill(STATE, SphereData), record,
        weights=(1.0 / 6.0, 1.0 / 3.0, 1.0), max_unroll=3,
    )  # fmt: skip
