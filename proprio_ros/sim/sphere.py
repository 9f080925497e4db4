"""The enclosed sphere: one driven joint that carries a container with a sphere rolling in it, coupled by contact both ways.

The paper's second interaction. The sphere is a rigid body of its own with three coordinates and a spin; the walls push it with
penalty forces, and what they give to it they take from the joint:

    J a + g(q) = tau_m - friction - m sum V(x_c) . f           (joint.py has the rest of this line)
    du/dt = g_C(q) + sum f - Omega x u
    dw/dt = - sum (n x f) / (kappa r) - Omega x w
    dx/dt = u - V(x) v

All vectors are in the container's frame C, whose origin is its centre: ``x`` is the sphere's centre, ``u`` its velocity against
the ground, ``w`` its spin, ``V(x) v`` the velocity of the container at x, ``Omega`` its angular velocity, ``n`` the inward normal
of a wall, ``kappa m r^2`` the sphere's inertia. ``f`` is the force of a contact *per kilogram of the sphere*.

The law of contact, with depth d, separation velocity v_n and slip v_t:

* ``ramped`` (default): f_n = max(k d - c min(d / d_0, 1) v_n, 0), f_t = -T v_t / sqrt(|v_t|^2 + (T / k_f)^2), T = mu f_n.
* ``paper``: f_n = k d - c v_n, f_t = -min(k_f |v_t|, mu |f_n|) v_t / |v_t|.

Departures from the paper. Its damping sets in at once when a wall is touched and can pull the sphere back, which puts false
minima into the mass; ours is ramped with depth and never pulls. Its constants k_e, k_d, k_f are newtons; as ours stand for no
material but for "hard", they are given per kilogram (k = omega^2, c = 2 zeta omega): the steps that they need then do not shorten
with the sphere, its motion in a container that moves as told does not depend on its mass, and a mass of 0 is as good as any
other. ``paper_contact`` turns the paper's constants into these. The default integrator is RK4 as in ``joint.py``.

Two independent derivatives, as there: forward sensitivities in the rollout, and ``wp.Tape`` over a kernel that keeps every state.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import warp as wp

from proprio_ros.errors import SimulationError
from proprio_ros.sim.joint import (
    _VEC2,
    PARAMETERS,
    TIME_EPS,
    JointRun,
    JointSimulator,
    Schedule,
    _acceleration,
    linearised_law,
)
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
SPHERE_INDEX = {name: row for row, name in enumerate(SPHERE_PARAMETERS)}
SHAPES = ("box", "cylinder", "sphere")
LAWS = ("ramped", "paper")
_FACES = {"box": 6, "cylinder": 3, "sphere": 1}
_GEOMETRY = 22
_MASS, _X, _Y, _Z, _K, _C, _KF, _MU, _TILT = (SPHERE_INDEX[name] for name in SPHERE_TERMS)
_VEC3 = wp.types.vector(length=3, dtype=FLOAT)
_MAT33 = wp.types.matrix(shape=(3, 3), dtype=FLOAT)
_SIZES = (1, 8, 16, len(SPHERE_PARAMETERS))


@dataclass(frozen=True)
class Enclosure:
    """The inside of a container and the sphere's size.

    Attributes:
        shape: ``"box"``, ``"cylinder"`` (axis along z) or ``"sphere"``.
        inner_size: [m] box: [x, y, z]; cylinder: [diameter, diameter, length]; sphere: three times its diameter; shape (3,).
        radius: of the sphere inside [m].
        inertia_factor: kappa; 0.4 for a solid ball, 2/3 for a hollow one.
        ramp_depth: d_0 of the default law [m].

    Raises:
        SimulationError: unknown shape, or a sphere that does not fit.
    """

    shape: str
    inner_size: np.ndarray
    radius: float
    inertia_factor: float = 0.4
    ramp_depth: float = 5e-4

    def __post_init__(self) -> None:
        if self.shape not in SHAPES:
            raise SimulationError(f"container.shape={self.shape!r} is unknown: choose one of {', '.join(SHAPES)}")
        if not 0.0 < self.radius < float(np.min(self.inner_size)) / 2.0:
            raise SimulationError(
                f"a sphere of radius {1e3 * self.radius:g} mm does not fit into {(1e3 * self.inner_size).tolist()} mm"
            )

    @property
    def room(self) -> np.ndarray:
        """How far the sphere's centre can go from the container's along each axis [m], shape (3,)."""
        return 0.5 * np.asarray(self.inner_size, dtype=np.float64) - self.radius


@dataclass(frozen=True)
class Contact:
    """Constants of the law of contact, per kilogram of the sphere.

    Attributes:
        stiffness: [1/s^2]; damping: [1/s]; traction: [1/s]; friction: coefficient of friction.
    """

    stiffness: float
    damping: float
    traction: float
    friction: float

    @classmethod
    def of(cls, frequency: float, damping_ratio: float, friction: float, traction: float = 300.0) -> "Contact":
        """From the angular frequency of a sphere on its contact [rad/s] and the ratio of its damping."""
        return cls(frequency**2, 2.0 * damping_ratio * frequency, traction, friction)

    def step_s(self, inertia_factor: float, integrator: str = "rk4") -> float:
        """Longest step that resolves a touch and is stable while the sphere slips [s].

        A bounce lasts pi / omega; five steps or more go into it. A sphere that slips loses its slip at k_f (1 + 1 / kappa); RK4 is
        stable up to 2.78 over that and Euler up to 2, and in a corner several walls add up.
        """
        slipping = self.traction * (1.0 + 1.0 / inertia_factor) + self.damping
        bounce, slip = (0.6, 2.0) if integrator == "rk4" else (0.4, 0.9)
        return float(min(bounce / np.sqrt(self.stiffness), slip / slipping))


def paper_contact(
    mass: float, k_e: float = 1000.0, k_d: float = 1.0, k_f: float = 1.0, friction: float = 0.3
) -> "Contact":
    """The paper's constants [N/m, N s/m, N s/m, 1] for a sphere of ``mass`` [kg]."""
    return Contact(k_e / mass, k_d / mass, k_f / mass, friction)


@dataclass(frozen=True)
class SphereRun:
    """One rollout with a sphere.

    Attributes:
        joint: what drives the joint, and where it is looked at. Its ``step_s`` should not be above ``Contact.step_s``.
        kind: ``"revolute"`` or ``"prismatic"``.
        axis: of the joint, in the container's frame, shape (3,).
        joint_origin: a point on the axis, in the container's frame [m], shape (3,).
        gravity: at joint position 0, in the container's frame [m/s^2], shape (3,).
    """

    joint: JointRun
    kind: str
    axis: np.ndarray
    joint_origin: np.ndarray
    gravity: np.ndarray

    def gravity_terms(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Constant, cos and sin parts of gravity in the container's frame as the joint turns [m/s^2] (Rodrigues)."""
        if self.kind == "prismatic":
            return self.gravity, np.zeros(3), np.zeros(3)
        along = self.axis * float(self.axis @ self.gravity)
        return along, self.gravity - along, -np.cross(self.axis, self.gravity)

    def gravity_at(self, q: float) -> np.ndarray:
        """Gravity in the container's frame at a joint position [m/s^2], shape (3,)."""
        constant, cos, sin = self.gravity_terms()
        return constant + cos * np.cos(q) + sin * np.sin(q)


@wp.func
def _triple(table: wp.array2d(dtype=FLOAT), row: wp.int32, column: wp.int32):
    return _VEC3(table[row, column], table[row, column + 1], table[row, column + 2])


@wp.func
def _cross_of(a: _VEC3):
    """The matrix that takes b to a x b."""
    zero = FLOAT(0.0)
    return _MAT33(zero, -a[2], a[1], a[2], zero, -a[0], -a[1], a[0], zero)


@wp.func
def _container_velocity(x: _VEC3, axis: _VEC3, origin: _VEC3, turn: FLOAT):
    """Velocity of the container at x per velocity of the joint."""
    return turn * wp.cross(axis, x - origin) + (FLOAT(1.0) - turn) * axis


@cache
def _wall(shape: str) -> Any:
    if shape == "box":

        @wp.func
        def wall(face: wp.int32, x: _VEC3, half: _VEC3, radius: FLOAT):
            """How deep the sphere is in a wall, and the wall's inward normal."""
            axis = face / 2
            side = FLOAT(1.0) - FLOAT(2.0) * FLOAT(face % 2)
            n = _VEC3(FLOAT(0.0), FLOAT(0.0), FLOAT(0.0))
            if axis == 0:
                n = _VEC3(side, FLOAT(0.0), FLOAT(0.0))
            elif axis == 1:
                n = _VEC3(FLOAT(0.0), side, FLOAT(0.0))
            else:
                n = _VEC3(FLOAT(0.0), FLOAT(0.0), side)
            return radius - wp.abs(wp.dot(n, half)) - wp.dot(n, x), n

    elif shape == "cylinder":

        @wp.func
        def wall(face: wp.int32, x: _VEC3, half: _VEC3, radius: FLOAT):
            """How deep the sphere is in a wall, and the wall's inward normal; the rim first."""
            n = _VEC3(FLOAT(0.0), FLOAT(0.0), FLOAT(1.0))
            depth = FLOAT(0.0)
            if face == 0:
                out = wp.sqrt(x[0] * x[0] + x[1] * x[1])
                depth = out - (half[0] - radius)
                if out > FLOAT(0.0):
                    n = _VEC3(-x[0] / out, -x[1] / out, FLOAT(0.0))
            else:
                side = FLOAT(1.0) - FLOAT(2.0) * FLOAT(face - 1)
                n = _VEC3(FLOAT(0.0), FLOAT(0.0), side)
                depth = radius - half[2] - side * x[2]
            return depth, n

    else:

        @wp.func
        def wall(face: wp.int32, x: _VEC3, half: _VEC3, radius: FLOAT):
            """How deep the sphere is in the wall, and the wall's inward normal."""
            out = wp.length(x)
            n = _VEC3(FLOAT(0.0), FLOAT(0.0), FLOAT(1.0))
            if out > FLOAT(0.0):
                n = -x / out
            return out - (half[0] - radius), n

    return wall


@wp.func
def _ramped(
    depth: FLOAT, v_n: FLOAT, slip: _VEC3, n: _VEC3, k: FLOAT, c: FLOAT, kf: FLOAT, mu: FLOAT, ramp_depth: FLOAT
):
    normal = wp.max(k * depth - c * wp.min(depth / ramp_depth, FLOAT(1.0)) * v_n, FLOAT(0.0))
    most = mu * normal
    bottom = wp.sqrt(kf * kf * wp.dot(slip, slip) + most * most)
    force = normal * n
    if bottom > FLOAT(0.0):
        force = force - (kf * most / bottom) * slip
    return force


@wp.func
def _as_in_the_paper(
    depth: FLOAT, v_n: FLOAT, slip: _VEC3, n: _VEC3, k: FLOAT, c: FLOAT, kf: FLOAT, mu: FLOAT, ramp_depth: FLOAT
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
    faces = _FACES[shape]

    @wp.func
    def rates(
        q: FLOAT,
        v: FLOAT,
        x: _VEC3,
        u: _VEC3,
        s: _VEC3,
        command: FLOAT,
        extra: FLOAT,
        p: wp.array2d(dtype=FLOAT),
        world: wp.int32,
        constants: wp.array2d(dtype=FLOAT),
        geometry: wp.array2d(dtype=FLOAT),
        run: wp.int32,
    ):
        """Time derivatives of joint velocity, sphere position, velocity and spin."""
        axis = _triple(geometry, run, 0)
        origin = _triple(geometry, run, 3)
        turn = geometry[run, 6]
        half = _triple(geometry, run, 16)
        radius = geometry[run, 19]
        angle = q + p[world, 22]
        push = _triple(geometry, run, 7) + wp.cos(angle) * _triple(geometry, run, 10)
        push = push + wp.sin(angle) * _triple(geometry, run, 13)
        spin = _VEC3(FLOAT(0.0), FLOAT(0.0), FLOAT(0.0))
        reaction = FLOAT(0.0)
        for face in range(faces):
            depth, n = wall(face, x, half, radius)
            if depth > FLOAT(0.0):
                touch = x - radius * n
                lever = _container_velocity(touch, axis, origin, turn)
                relative = u - radius * wp.cross(s, n) - v * lever
                v_n = wp.dot(relative, n)
                f = contact(
                    depth, v_n, relative - v_n * n, n, p[world, 18], p[world, 19], p[world, 20], p[world, 21],
                    geometry[run, 21],
                )  # fmt: skip
                push = push + f
                spin = spin - wp.cross(n, f) / (geometry[run, 20] * radius)
                reaction = reaction + wp.dot(lever, f)
        a = _acceleration(q, v, command, extra + p[world, 14] * reaction, p, world, constants, run)
        turning = (turn * v) * axis
        moving = u - v * _container_velocity(x, axis, origin, turn)
        return a, moving, push - wp.cross(turning, u), spin - wp.cross(turning, s)

    @wp.func
    def rk4(
        q: FLOAT,
        v: FLOAT,
        x: _VEC3,
        u: _VEC3,
        s: _VEC3,
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
        x: _VEC3,
        u: _VEC3,
        s: _VEC3,
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
        lever = _container_velocity(x, _triple(geometry, run, 0), _triple(geometry, run, 3), geometry[run, 6])
        return q + h * v2, v2, x + h * (u2 - v2 * lever), u2, s + h * ds

    return rates, rk4 if integrator == "rk4" else semi_implicit


@wp.func
def _start(p: wp.array2d(dtype=FLOAT), world: wp.int32, geometry: wp.array2d(dtype=FLOAT), run: wp.int32):
    """Position, velocity and spin of a sphere that moves with the container."""
    x = _triple(p, world, 15)
    axis = _triple(geometry, run, 0)
    turn = geometry[run, 6]
    v = p[world, 10]
    return x, v * _container_velocity(x, axis, _triple(geometry, run, 3), turn), (turn * v) * axis


@cache
def _tangent_kernel(directions: int, integrator: str, stribeck: bool, shape: str, law: str) -> Any:
    """Rollout with ``directions`` exact forward sensitivities in the same thread (thread = world)."""
    vec = wp.types.vector(length=directions, dtype=FLOAT)
    mat = wp.types.matrix(shape=(3, directions), dtype=FLOAT)
    joint_law = linearised_law(directions, stribeck)
    wall = _wall(shape)
    curved = shape != "box"
    ramped = law == "ramped"
    rk4 = integrator == "rk4"

    @wp.func
    def touched(
        depth: FLOAT,
        n: _VEC3,
        x: _VEC3,
        u: _VEC3,
        s: _VEC3,
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
        axis = _triple(geometry, run, 0)
        origin = _triple(geometry, run, 3)
        turn = geometry[run, 6]
        radius = geometry[run, 19]
        k = p[world, 18]
        c = p[world, 19]
        kf = p[world, 20]
        mu = p[world, 21]
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
            reach = depth + geometry[run, 16] - radius
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
            ramp = depth / geometry[run, 21]
            rise = FLOAT(1.0) / geometry[run, 21]
            if ramp > FLOAT(1.0):
                ramp = FLOAT(1.0)
                rise = FLOAT(0.0)
            normal = k * depth - c * ramp * v_n
            if normal > FLOAT(0.0):
                d_normal = (
                    (k - c * rise * v_n) * d_depth
                    - (c * ramp) * d_v_n
                    + depth * dp[world, 18]
                    - (ramp * v_n) * dp[world, 19]
                )
            else:
                normal = FLOAT(0.0)
            most = mu * normal
            slipping = wp.dot(slip, slip)
            bottom = wp.sqrt(kf * kf * slipping + most * most)
            if bottom > FLOAT(0.0):
                d_most = mu * d_normal + normal * dp[world, 21]
                scale = kf * most / bottom
                d_bottom = ((kf * kf) * (slip @ d_slip) + (kf * slipping) * dp[world, 20] + most * d_most) / bottom
                d_scale = (kf * d_most + most * dp[world, 20] - scale * d_bottom) / bottom
        else:
            normal = k * depth - c * v_n
            d_normal = k * d_depth - c * d_v_n + depth * dp[world, 18] - v_n * dp[world, 19]
            speed = wp.length(slip)
            most = mu * wp.abs(normal)
            if kf * speed <= most:
                scale = kf
                d_scale = vec(dp[world, 20])
            else:
                scale = most / speed
                d_most = (mu * wp.sign(normal)) * d_normal + wp.abs(normal) * dp[world, 21]
                d_scale = (d_most - (scale / speed) * (slip @ d_slip)) / speed
        f = normal * n - scale * slip
        df = wp.outer(n, d_normal) - scale * d_slip - wp.outer(slip, d_scale)
        if wp.static(curved):
            df = df + normal * dn
        by_inertia = FLOAT(-1.0) / (geometry[run, 20] * radius)
        spin = by_inertia * wp.cross(n, f)
        d_spin = (by_inertia * across) @ df
        if wp.static(curved):
            d_spin = d_spin - (by_inertia * _cross_of(f)) @ dn
        return f, df, spin, d_spin, wp.dot(lever, f), lever @ df + f @ d_lever

    @wp.func
    def sphere_rates(
        q: FLOAT,
        v: FLOAT,
        x: _VEC3,
        u: _VEC3,
        s: _VEC3,
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
        axis = _triple(geometry, run, 0)
        origin = _triple(geometry, run, 3)
        turn = geometry[run, 6]
        half = _triple(geometry, run, 16)
        radius = geometry[run, 19]
        angle = q + p[world, 22]
        cos = wp.cos(angle)
        sin = wp.sin(angle)
        by_cos = _triple(geometry, run, 10)
        by_sin = _triple(geometry, run, 13)
        turning = (turn * v) * axis
        round = _cross_of(turning)
        lever = _container_velocity(x, axis, origin, turn)
        moving = u - v * lever
        d_moving = du - wp.outer(lever, dv) - round @ dx
        push = _triple(geometry, run, 7) + cos * by_cos + sin * by_sin - wp.cross(turning, u)
        d_push = wp.outer(cos * by_sin - sin * by_cos, dq + dp[world, 22]) - round @ du
        d_push = d_push - wp.outer(turn * wp.cross(axis, u), dv)
        spin = -wp.cross(turning, s)
        d_spin = -(round @ ds) - wp.outer(turn * wp.cross(axis, s), dv)
        reaction = FLOAT(0.0)
        d_reaction = vec()
        faces = wp.int32(wp.static(_FACES[shape]))
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
        mass = p[world, 14]
        load = mass * reaction
        return moving, d_moving, push, d_push, spin, d_spin, load, mass * d_reaction + reaction * dp[world, 14]

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(
        # Run data:
        sample_times: wp.array2d(dtype=FLOAT),
        sample_count: wp.array(dtype=wp.int32),
        input_times: wp.array2d(dtype=FLOAT),
        input_current: wp.array2d(dtype=FLOAT),
        input_load: wp.array2d(dtype=_VEC2),
        input_count: wp.array(dtype=wp.int32),
        constants: wp.array2d(dtype=FLOAT),
        geometry: wp.array2d(dtype=FLOAT),
        # World data in:
        world_run: wp.array(dtype=wp.int32),
        p_in: wp.array2d(dtype=FLOAT),
        dp_in: wp.array2d(dtype=vec),
        # World data out:
        q_out: wp.array2d(dtype=FLOAT),
        v_out: wp.array2d(dtype=FLOAT),
        dq_out: wp.array2d(dtype=vec),
        x_out: wp.array2d(dtype=_VEC3),
        dx_out: wp.array2d(dtype=mat),
    ):
        w = wp.tid()
        r = world_run[w]
        delay = p_in[w, 8]
        d_delay = dp_in[w, 8]
        carried = p_in[w, 11]
        volt = constants[r, 0]
        emf = constants[r, 1]
        ohm = constants[r, 2]
        vs = constants[r, 3]
        coarse = constants[r, 4]
        fine = constants[r, 5]
        loads = input_load[r, 0]
        extra = p_in[w, 3] + loads[0] + carried * loads[1]
        d_extra = dp_in[w, 3] + loads[1] * dp_in[w, 11]

        q = p_in[w, 9]
        v = p_in[w, 10]
        dq = dp_in[w, 9]
        dv = dp_in[w, 10]
        axis = _triple(geometry, r, 0)
        turn = geometry[r, 6]
        x, u, s = _start(p_in, w, geometry, r)
        dx = mat()
        dx[0] = dp_in[w, 15]
        dx[1] = dp_in[w, 16]
        dx[2] = dp_in[w, 17]
        du = (
            wp.outer(_container_velocity(x, axis, _triple(geometry, r, 3), turn), dv)
            + (turn * v * _cross_of(axis)) @ dx
        )
        ds = wp.outer(turn * axis, dv)
        t = FLOAT(0.0)
        dt = vec()
        segment = wp.int32(0)
        segments = input_count[r]
        command = input_current[r, 0]
        for k in range(sample_count[r]):
            goal = sample_times[r, k] - delay
            if goal <= FLOAT(0.0):
                q_out[w, k] = q + v * goal
                v_out[w, k] = v
                dq_out[w, k] = dq + goal * dv - v * d_delay
                x_out[w, k] = x
                dx_out[w, k] = dx
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
                        x_sum = _VEC3()
                        u_sum = _VEC3()
                        s_sum = _VEC3()
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
                            a, da = joint_law(
                                qj, vj, dqj, dvj, command, p_in[w, 0], p_in[w, 1], p_in[w, 2], extra + load, p_in[w, 4],
                                p_in[w, 5], p_in[w, 6], p_in[w, 7], volt, emf, ohm, vs, dp_in[w, 0], dp_in[w, 1],
                                dp_in[w, 2], d_extra + d_load, dp_in[w, 4], dp_in[w, 5], dp_in[w, 6], dp_in[w, 7],
                                p_in[w, 12], p_in[w, 13], dp_in[w, 12], dp_in[w, 13],
                            )  # fmt: skip
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
                                lever = _container_velocity(x, axis, _triple(geometry, r, 3), turn)
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
                        command = input_current[r, segment]
                        loads = input_load[r, segment]
                        extra = p_in[w, 3] + loads[0] + carried * loads[1]
                        d_extra = dp_in[w, 3] + loads[1] * dp_in[w, 11]
                    else:
                        arrived = 1
                q_out[w, k] = q
                v_out[w, k] = v
                dq_out[w, k] = dq
                x_out[w, k] = x
                dx_out[w, k] = dx

    return kernel


@cache
def _forward_kernel(integrator: str, shape: str, law: str) -> Any:
    """Rollout without tangents; where ``capacity`` is above 0 it writes down every step for the adjoint to follow."""
    rates, step = _primal(shape, law, integrator)

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(
        # Run data:
        sample_times: wp.array2d(dtype=FLOAT),
        sample_count: wp.array(dtype=wp.int32),
        input_times: wp.array2d(dtype=FLOAT),
        input_current: wp.array2d(dtype=FLOAT),
        input_load: wp.array2d(dtype=_VEC2),
        input_count: wp.array(dtype=wp.int32),
        constants: wp.array2d(dtype=FLOAT),
        geometry: wp.array2d(dtype=FLOAT),
        # World data in:
        world_run: wp.array(dtype=wp.int32),
        p_in: wp.array2d(dtype=FLOAT),
        capacity: wp.int32,
        # World data out:
        q_out: wp.array2d(dtype=FLOAT),
        v_out: wp.array2d(dtype=FLOAT),
        x_out: wp.array2d(dtype=_VEC3),
        u_out: wp.array2d(dtype=_VEC3),
        s_out: wp.array2d(dtype=_VEC3),
        # step length, its change with the delay, command, load, and the step after which each sample is taken
        step_out: wp.array2d(dtype=FLOAT),
        step_by_delay_out: wp.array2d(dtype=FLOAT),
        command_out: wp.array2d(dtype=FLOAT),
        load_out: wp.array2d(dtype=_VEC2),
        steps_out: wp.array(dtype=wp.int32),
        sample_step_out: wp.array2d(dtype=wp.int32),
    ):
        w = wp.tid()
        r = world_run[w]
        vs = constants[r, 3]
        coarse = constants[r, 4]
        fine = constants[r, 5]
        delay = p_in[w, 8]
        q = p_in[w, 9]
        v = p_in[w, 10]
        x, u, s = _start(p_in, w, geometry, r)
        t = FLOAT(0.0)
        moved = FLOAT(0.0)  # d t / d delay
        segment = wp.int32(0)
        command = input_current[r, 0]
        loads = input_load[r, 0]
        extra = loads[0] + p_in[w, 11] * loads[1]
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
                            a, _x, _u, _s = rates(q, v, x, u, s, command, extra, p_in, w, constants, geometry, r)
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
                            command_out[w, n] = command
                            load_out[w, n] = loads
                        q2, v2, x2, u2, s2 = step(q, v, x, u, s, h, command, extra, p_in, w, constants, geometry, r)
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
                        command = input_current[r, segment]
                        loads = input_load[r, segment]
                        extra = loads[0] + p_in[w, 11] * loads[1]
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
def _taped_kernel(integrator: str, shape: str, law: str) -> Any:
    """A kernel whose adjoint is right: every step writes its own row, no state is overwritten."""
    _rates, step = _primal(shape, law, integrator)

    @wp.kernel(module="unique")
    def roll(
        # Run data:
        constants: wp.array2d(dtype=FLOAT),
        geometry: wp.array2d(dtype=FLOAT),
        # World data in:
        world_run: wp.array(dtype=wp.int32),
        p_in: wp.array2d(dtype=FLOAT),
        delay_at: wp.array(dtype=FLOAT),
        step_in: wp.array2d(dtype=FLOAT),
        step_by_delay_in: wp.array2d(dtype=FLOAT),
        command_in: wp.array2d(dtype=FLOAT),
        load_in: wp.array2d(dtype=_VEC2),
        steps_in: wp.array(dtype=wp.int32),
        # World data out:
        q_out: wp.array2d(dtype=FLOAT),
        v_out: wp.array2d(dtype=FLOAT),
        x_out: wp.array2d(dtype=_VEC3),
        u_out: wp.array2d(dtype=_VEC3),
        s_out: wp.array2d(dtype=_VEC3),
    ):
        w = wp.tid()
        r = world_run[w]
        delay = p_in[w, 8]
        x0, u0, s0 = _start(p_in, w, geometry, r)
        q_out[w, 0] = p_in[w, 9]
        v_out[w, 0] = p_in[w, 10]
        x_out[w, 0] = x0
        u_out[w, 0] = u0
        s_out[w, 0] = s0
        for n in range(steps_in[w]):
            h = step_in[w, n] + step_by_delay_in[w, n] * (delay - delay_at[w])
            loads = load_in[w, n]
            extra = loads[0] + p_in[w, 11] * loads[1]
            q2, v2, x2, u2, s2 = step(
                q_out[w, n], v_out[w, n], x_out[w, n], u_out[w, n], s_out[w, n], h, command_in[w, n], extra, p_in, w,
                constants, geometry, r,
            )  # fmt: skip
            q_out[w, n + 1] = q2
            v_out[w, n + 1] = v2
            x_out[w, n + 1] = x2
            u_out[w, n + 1] = u2
            s_out[w, n + 1] = s2

    return roll


class SphereSimulator(JointSimulator):
    """Rolls out many worlds (guesses) of one or more runs, each with a sphere in its container.

    Parameter vectors have the order of ``SPHERE_PARAMETERS``; everything else is as in ``JointSimulator``.

    Args:
        runs: the runs; worlds refer to them by index.
        enclosure: the container's inside and the sphere's size, the same in all runs.
        law: ``"ramped"`` or ``"paper"``.
        integrator: ``"rk4"`` or ``"semi_implicit"`` (the paper's equation (2)).
        device: Warp device name.

    Raises:
        SimulationError: unknown law or integrator, no runs, or a run without samples.
    """

    parameters = SPHERE_PARAMETERS
    harmless = np.array([float(name in ("inertia", "stribeck_velocity")) for name in SPHERE_PARAMETERS])
    tangent_sizes = _SIZES

    def __init__(
        self,
        runs: Sequence[SphereRun],
        enclosure: Enclosure,
        law: str = "ramped",
        integrator: str = "rk4",
        device: str = "cpu",
    ) -> None:
        if law not in LAWS:
            raise SimulationError(f"unknown law of contact {law!r}: choose one of {', '.join(LAWS)}")
        super().__init__([run.joint for run in runs], integrator, device)
        self.sphere_runs = tuple(runs)
        self.enclosure = enclosure
        self.law = law
        geometry = np.zeros((len(runs), _GEOMETRY))
        for row, run in enumerate(runs):
            geometry[row] = np.concatenate(
                [
                    run.axis,
                    run.joint_origin,
                    [float(run.kind == "revolute")],
                    *run.gravity_terms(),
                    0.5 * np.asarray(enclosure.inner_size, dtype=np.float64),
                    [enclosure.radius, enclosure.inertia_factor, enclosure.ramp_depth],
                ]
            )
        self._geometry = self._array(geometry)
        self._last: tuple[np.ndarray, ...] = ()

    def last_path(self, directions: int) -> tuple[np.ndarray, np.ndarray]:
        """Where the sphere was in the last ``jacobian``: x (W, T, 3) [m], dx (W, T, 3, D); overwritten by the next."""
        return self._last[3], self._last[4][..., :directions]

    def path(self, world_run: np.ndarray, p: np.ndarray, dp: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where the sphere's centre is in the container at the sample instants, and how that changes.

        Args:
            world_run, p, dp: as for ``jacobian``.

        Returns:
            x (W, T, 3) [m], dx (W, T, 3, D), copies.
        """
        self._launch(np.asarray(world_run, dtype=np.int32), p, dp, None)
        x, dx = self.last_path(dp.shape[2])
        return x.copy(), dx.copy()

    def states(self, world_run: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, ...]:
        """Forward pass alone: q, v (W, T) and the sphere's position, velocity and spin (W, T, 3) at the sample instants."""
        runs, given = self._worlds(world_run, p)
        outputs, command = self.record_forward(runs, given)
        command.launch()
        return tuple(output.numpy().copy() for output in outputs)

    def record_forward(self, runs: wp.array, p: wp.array) -> tuple[list[wp.array], Any]:
        """The forward pass as a command to launch again and again, and its outputs."""
        outputs = self._forward_outputs(len(p))
        nothing = Schedule.empty(len(p), 1, 1, self.device)
        command = self._forward(runs, p, outputs, nothing, capacity=0, record_cmd=True)
        return outputs, command

    def _worlds(self, world_run: np.ndarray, p: np.ndarray) -> tuple[wp.array, wp.array]:
        return wp.array(np.asarray(world_run, dtype=np.int32), dtype=wp.int32, device=self.device), self._array(p)

    def _launch(
        self, world_run: np.ndarray, p: np.ndarray, dp: np.ndarray, counts: np.ndarray | None
    ) -> tuple[np.ndarray, ...]:
        self._last = super()._launch(world_run, p, dp, counts)
        lost = ~np.isfinite(p).all(axis=1)
        if lost.any():
            self._last[3][lost] = np.nan
        return self._last

    def _kernel(self, size: int, stribeck: bool) -> Any:
        return _tangent_kernel(size, self.integrator, stribeck, self.enclosure.shape, self.law)

    def _object_data(self) -> list[wp.array]:
        return [self._geometry]

    def _outputs(self, worlds: int, size: int) -> list[wp.array]:
        mat = wp.types.matrix(shape=(3, size), dtype=FLOAT)
        shape = (worlds, self._width)
        return [
            *super()._outputs(worlds, size),
            wp.zeros(shape, dtype=_VEC3, device=self.device),
            wp.zeros(shape, dtype=mat, device=self.device),
        ]

    def _forward_outputs(self, worlds: int) -> list[wp.array]:
        return [
            wp.zeros((worlds, self._width), dtype=kind, device=self.device)
            for kind in (FLOAT, FLOAT, _VEC3, _VEC3, _VEC3)
        ]

    def _forward(
        self,
        runs: wp.array,
        p: wp.array,
        outputs: list[wp.array],
        plan: Schedule,
        capacity: int,
        record_cmd: bool = False,
    ) -> Any:
        return wp.launch(
            _forward_kernel(self.integrator, self.enclosure.shape, self.law),
            dim=len(p),
            inputs=[*self._run_data(self._full_counts), runs, p, capacity],
            outputs=[*outputs, *plan.inputs(), plan.sample_step],
            device=self.device,
            record_cmd=record_cmd,
        )

    def _schedule(self, runs: wp.array, p: wp.array, capacity: int) -> Schedule:
        plan = Schedule.empty(len(p), capacity, self._width, self.device)
        self._forward(runs, p, self._forward_outputs(len(p)), plan, capacity)
        return plan

    def _roll(self, runs: wp.array, p: wp.array, delay_at: wp.array, plan: Schedule, capacity: int) -> wp.array:
        rows = (len(p), capacity + 1)
        states = [
            wp.zeros(rows, dtype=kind, device=self.device, requires_grad=True)
            for kind in (FLOAT, FLOAT, _VEC3, _VEC3, _VEC3)
        ]
        wp.launch(
            _taped_kernel(self.integrator, self.enclosure.shape, self.law),
            dim=len(p),
            inputs=[self._constants, *self._object_data(), runs, p, delay_at, *plan.inputs()],
            outputs=states,
            device=self.device,
        )
        return states[0]


def compile_kernels(shape: str = "box", law: str = "ramped", integrator: str = "rk4") -> None:
    """Compile and load the kernels of one shape of container, for whoever cannot wait for them later; again it costs nothing."""
    joint = JointRun(np.array([0.01]), np.zeros(1), np.zeros(1))
    run = SphereRun(joint, "prismatic", np.array([1.0, 0.0, 0.0]), np.zeros(3), np.zeros(3))
    simulator = SphereSimulator([run], Enclosure(shape, np.ones(3), 0.1), law, integrator)
    for size in _SIZES:
        for stribeck in (0.0, 1.0):
            p = SphereSimulator.harmless[None].copy()
            p[:, SPHERE_INDEX["stribeck"]] = stribeck
            simulator.jacobian(np.zeros(1, dtype=np.int32), p, np.zeros((1, len(SPHERE_PARAMETERS), size)))
