"""The law of a joint with moving contents, for Warp: what ``slosh.py`` says, with its exact change along any direction."""

from functools import cache

import warp as wp

from proprio_ros.sim.joint_kernels import (
    CARRIED,
    CURRENT,
    DELAY,
    GRAVITY_CONSTANT,
    INERTIA,
    LOAD,
    LOAD_PER_KG,
    PARAMETERS,
    Q0,
    V0,
    VEC3,
    linearised_acceleration,
    standstill,
)  # fmt: skip
from proprio_ros.sim.rollout_kernels import Law
from proprio_ros.sim.runtime import FLOAT, FLOATS

SLOSH_TERMS = (
    "slosh_mass",
    "slosh_height",
    "slosh_stiffness",
    "slosh_damping",
    "slosh_friction",
    "settled",
    "tilt",
)
"""What moving contents add to the parameters of ``joint.py``: kg, m above the bottom, 1/s^2, 1/s, m/s^2, 1, rad. ``tilt`` is how
much further than its encoder shows the joint has turned the container."""
SLOSH_PARAMETERS = (*PARAMETERS, *SLOSH_TERMS)
MASS, HEIGHT, STIFFNESS, DAMPING, FRICTION, SETTLED, TILT = range(
    len(PARAMETERS), len(SLOSH_PARAMETERS)
)
# columns of ``SloshData.geometry``; gravity's constant, cos and sin parts
REACH, BOTTOM, G_S, G_Z = 0, 1, 2, 5
GRAVITY = 9.81
FRICTION_SPEED = 0.02  # over which grains' friction is smoothed [m/s]
VEC4 = wp.types.vector(length=4, dtype=FLOAT)


@wp.struct
class SloshData:
    """What is known about the runs."""

    constants: FLOATS
    geometry: FLOATS


@wp.func
def _gravity(
    geometry: FLOATS,
    r: wp.int32,
    at: wp.int32,
    angle: FLOAT,
):
    """A component of gravity in the container's frame, and its change with the angle."""
    c = wp.cos(angle)
    s = wp.sin(angle)
    value = geometry[r, at] + geometry[r, at + 1] * c + geometry[r, at + 2] * s
    return value, geometry[r, at + 2] * c - geometry[r, at + 1] * s


@cache
def slosh_law(directions: int, stribeck: bool) -> Law:
    """Joint and moving contents with tangents; the state is q, v, x, x'."""
    vec = wp.types.vector(length=directions, dtype=FLOAT)
    mat = wp.types.matrix(shape=(4, directions), dtype=FLOAT)
    linearised = linearised_acceleration(directions, stribeck)

    @wp.struct
    class Out:
        q: FLOATS
        v: FLOATS
        dq: wp.array2d(dtype=vec)
        x: FLOATS
        dx: wp.array2d(dtype=vec)

    @wp.func
    def start(
        p: FLOATS,
        dp: wp.array2d(dtype=vec),
        w: wp.int32,
        data: SloshData,
        r: wp.int32,
    ):
        gs, gs_by = _gravity(
            data.geometry,
            r,
            G_S,
            p[w, Q0] + p[w, TILT],
        )
        gz, gz_by = _gravity(
            data.geometry,
            r,
            G_Z,
            p[w, Q0] + p[w, TILT],
        )
        gz = wp.min(gz, FLOAT(-1.0))  # a container that stands nowhere near upright
        slope = -gs / gz
        radius = FLOAT(GRAVITY) / p[w, STIFFNESS]
        x = p[w, SETTLED] * slope * radius
        dx = (-(gs_by + slope * gz_by) / gz * p[w, SETTLED] * radius) * (dp[w, Q0] + dp[w, TILT])
        dx = dx + (slope * radius) * dp[w, SETTLED] - (x / p[w, STIFFNESS]) * dp[w, STIFFNESS]
        return (
            VEC4(
                p[w, Q0],
                p[w, V0],
                x,
                FLOAT(0.0),
            ),
            wp.matrix_from_rows(
                dp[w, Q0],
                dp[w, V0],
                dx,
                vec(),
            ),
        )

    @wp.func
    def rates(
        y: VEC4,
        dy: mat,
        u: VEC3,
        p: FLOATS,
        dp: wp.array2d(dtype=vec),
        w: wp.int32,
        data: SloshData,
        r: wp.int32,
    ):
        load = p[w, GRAVITY_CONSTANT] + u[LOAD] + p[w, CARRIED] * u[LOAD_PER_KG]
        d_load = dp[w, GRAVITY_CONSTANT] + u[LOAD_PER_KG] * dp[w, CARRIED]
        a, da = linearised(
            y[0], y[1], dy[0], dy[1], u[CURRENT], load, d_load, p, dp, w, data.constants, r
        )
        v = y[1]
        s = y[3]
        m = p[w, MASS]
        bend = p[w, STIFFNESS] / FLOAT(GRAVITY)
        d_bend = dp[w, STIFFNESS] / FLOAT(GRAVITY)
        slope = bend * y[2]
        d_slope = bend * dy[2] + y[2] * d_bend
        far = data.geometry[r, REACH] + y[2]
        high = data.geometry[r, BOTTOM] + p[w, HEIGHT] + FLOAT(0.5) * slope * y[2]
        d_high = dp[w, HEIGHT] + FLOAT(0.5) * (y[2] * d_slope + slope * dy[2])
        turned = dy[0] + dp[w, TILT]
        gs, gs_by = _gravity(
            data.geometry,
            r,
            G_S,
            y[0] + p[w, TILT],
        )
        gz, gz_by = _gravity(
            data.geometry,
            r,
            G_Z,
            y[0] + p[w, TILT],
        )
        side = wp.tanh(s / FLOAT(FRICTION_SPEED))
        rub = p[w, DAMPING] * s + p[w, FRICTION] * side  # F of ``slosh.py``; E, N, P and Q below
        loss = p[w, DAMPING] + p[w, FRICTION] * (FLOAT(1.0) - side * side) / FLOAT(FRICTION_SPEED)
        d_rub = s * dp[w, DAMPING] + side * dp[w, FRICTION] + loss * dy[3]
        wide = FLOAT(1.0) + slope * slope
        d_wide = (FLOAT(2.0) * slope) * d_slope
        over = high - slope * far  # E
        d_over = d_high - far * d_slope - slope * dy[2]
        out = far + slope * high  # N
        d_out = dy[2] + high * d_slope + slope * d_high
        along = gs + slope * gz + v * v * out - slope * bend * s * s - rub  # P
        d_along = (
            (gs_by + slope * gz_by) * turned
            + gz * d_slope
            + (v * v) * d_out
            + (FLOAT(2.0) * v * out) * dy[1]
            - d_rub
        )
        d_along = (
            d_along
            - (s * s) * (bend * d_slope + slope * d_bend)
            - (FLOAT(2.0) * slope * bend * s) * dy[3]
        )
        across = slope * gs - gz + bend * s * s - v * v * over - FLOAT(2.0) * v * s * wide  # Q
        d_across = (
            (slope * gs_by - gz_by) * turned
            + (gs - FLOAT(4.0) * v * s * slope) * d_slope
            + (s * s) * d_bend
        )
        d_across = (
            d_across
            + FLOAT(2.0) * ((bend * s - v * wide) * dy[3] - (v * over + s * wide) * dy[1])
            - (v * v) * d_over
        )
        moment = (out * across + over * rub) / wide
        d_moment = (
            across * d_out + out * d_across + rub * d_over + over * d_rub - moment * d_wide
        ) / wide
        inertia = m * out * out / wide
        d_inertia = (
            (out * out / wide) * dp[w, MASS]
            + (FLOAT(2.0) * m * out / wide) * d_out
            - (inertia / wide) * d_wide
        )
        b = (a * p[w, INERTIA] + m * moment) / (p[w, INERTIA] + inertia)
        db = (
            p[w, INERTIA] * da
            + (a - b) * dp[w, INERTIA]
            + m * d_moment
            + moment * dp[w, MASS]
            - b * d_inertia
        )
        db = db / (p[w, INERTIA] + inertia)
        k = (along - b * over) / wide
        dk = (d_along - b * d_over - over * db - k * d_wide) / wide
        # row by row: what `matrix_from_rows` makes the compiler leaves in memory from 19 columns on, at twice the time
        change = mat()
        change[0] = dy[1]
        change[1] = db
        change[2] = dy[3]
        change[3] = dk
        return VEC4(v, b, s, k), change

    @wp.func
    def moved(
        y: VEC4,
        dy: mat,
        z: VEC4,
        dz: mat,
        k: VEC4,
        dk: mat,
        data: SloshData,
        r: wp.int32,
    ):
        return VEC4(
            z[1],
            k[1],
            z[3],
            k[3],
        ), wp.matrix_from_rows(
            dz[1],
            dk[1],
            dz[3],
            dk[3],
        )

    @wp.func
    def record(
        out: Out,
        w: wp.int32,
        k: wp.int32,
        y: VEC4,
        dy: mat,
        lead: FLOAT,
        d_lead: vec,
    ):
        out.v[w, k] = y[1]
        out.q[w, k] = y[0] + y[1] * lead
        out.dq[w, k] = dy[0] + lead * dy[1]
        if lead < FLOAT(0.0):
            out.dq[w, k] = dy[0] + lead * dy[1] + y[1] * d_lead
        out.x[w, k] = y[2]
        out.dx[w, k] = dy[2]

    still = standstill(VEC4, SloshData)
    return Law(
        directions, VEC4, VEC3, mat, SloshData, Out, DELAY, start, rates, moved, still, record
    )
