"""Several driven joints at once, in a chain or a tree: the paper's equation (1), its exact tangents, and its adjoint.

    H(q) a + b(q, v) = tau,        tau_j = m_j - (f_c + f_l |m_j|) tanh(v_j / v_s) - f_v v_j - k q_j,     m_j = k_t i_j

``H`` holds the armature on its diagonal, ``b`` gravity, centrifugal and Coriolis forces; a passive joint has ``k_t = 0``, and
perhaps a spring ``k`` about its zero. Supply limit, delay and departures from the paper are those of ``joint.py``.

Every body enters through its ten inertial parameters ``pi = (m, h, J)`` about its joint's frame, first moments ``h = m c`` and
rotational inertia ``J``. ``H`` and ``b`` are linear in them, so a direction in payload mass or centre of mass is one in ``pi``.

Spatial vectors (Featherstone, "Rigid Body Dynamics Algorithms", 2008) are taken at the origin of the base frame, angular part
first, so that nothing has to be moved between bodies: with the joint screws ``S_i``,

    V_i = V_p + S_i v_i,        A_i = A_p + S_i a_i + V_i x S_i v_i,        A_base = -gravity,
    f_i = I_i A_i + V_i x* I_i V_i,        tau_i = S_i . (sum of f over the subtree of i),
    H_ij = S_i . (sum of I over the subtree of j) S_j        for i on the way from j to the base.

Tangents. Along a direction, body i is displaced by a screw ``D_i = D_p + S_i dq_i``, and all that it carries moves with it. What
is left, ``[X_i] = dX_i - D_i x X_i``, obeys recursions in which ``D`` no longer occurs:

    [V_i] = [V_p] + S_i dv_i + (V_i x S_i) dq_i,
    [A_i] = [A_p] + (A_p x S_i) dq_i + (V_i x S_i) dv_i + [V_i] x S_i v_i,            at fixed a
    [f_i] = I_i [A_i] + [V_i] x* I_i V_i + V_i x* (I_i [V_i] + dI_i V_i) + dI_i A_i,
    [F_i] = [f_i] + sum over children c of [F_c] + (S_c x* F_c) dq_c,        d(inverse dynamics)_i = S_i . [F_i],

with ``F_i`` the sum of f over the subtree and ``dI_i`` the inertia that the direction itself adds. Then
``H da = d tau - d(inverse dynamics)(q, v, a)`` re-uses the factor of ``H``.

Code is unrolled over the joints for each tree (tuple of parents) and compiled once; geometry, kinds of joints and inertias are
data. An adjoint in Warp is right only where no state is overwritten: the taped kernel writes each step to its own row, and in
all functions that it shares with the others each component of a matrix is assigned once.
"""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from proprio_ros.errors import SimulationError
from proprio_ros.robot import ReducedModel, inertia_about_origin, rotation_about
from proprio_ros.sim import runtime
from proprio_ros.sim.joint import INTEGRATORS, MAX_STEPS, TIME_EPS, limited_current
from proprio_ros.sim.runtime import FLOAT

JOINT_PARAMETERS = ("torque_constant", "coulomb", "viscous", "load_friction", "armature", "stiffness")
"""Of each joint, SI: N m/A, N m, N m s/rad, 1, kg m^2, N m/rad (N/A, N, N s/m, 1, kg, N/m for a slide)."""

PAYLOAD_JOINTS = ("prismatic", "universal")

_INERTIAL = 10
_BLOCKS = (1, 8)
"""Directions that one thread may take: eight share one evaluation of the dynamics, at a quarter of the time of eight threads."""

_TRIANGLE = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))  # order of the entries of J in pi

runtime.start()

_vec3 = wp.types.vector(length=3, dtype=FLOAT)
_vec6 = wp.types.vector(length=6, dtype=FLOAT)
_vec10 = wp.types.vector(length=10, dtype=FLOAT)
_vec12 = wp.types.vector(length=12, dtype=FLOAT)
_mat33 = wp.types.matrix(shape=(3, 3), dtype=FLOAT)


@wp.struct
class _Constants:
    """What no parameter changes.

    A joint's rotation to its parent is turn[0] + sin(q) turn[1] + cos(q) turn[2], its offset shift[0] + q shift[1].
    """

    turn: wp.array2d(dtype=_mat33)
    shift: wp.array2d(dtype=_vec3)
    axis: wp.array(dtype=_vec3)
    revolute: wp.array(dtype=FLOAT)
    gravity: _vec3
    friction_velocity: wp.array(dtype=FLOAT)
    supply: wp.array2d(dtype=FLOAT)


# ------------------------------------------------------------------------------------------------------- one rigid body


@wp.func
def _rotation(pose: _vec12):
    return _mat33(pose[0], pose[1], pose[2], pose[3], pose[4], pose[5], pose[6], pose[7], pose[8])


@wp.func
def _origin(pose: _vec12):
    return _vec3(pose[9], pose[10], pose[11])


@wp.func
def _pose(r: _mat33, o: _vec3):
    return _vec12(r[0, 0], r[0, 1], r[0, 2], r[1, 0], r[1, 1], r[1, 2], r[2, 0], r[2, 1], r[2, 2], o[0], o[1], o[2])


@wp.func
def _seen_from_base(m: FLOAT, h: _vec3, j: _mat33, pose: _vec12):
    """Ten inertial parameters about the base's origin, from those about a body's frame."""
    r = _rotation(pose)
    o = _origin(pose)
    turned = r * h
    jr = r * j * wp.transpose(r)
    g = turned + FLOAT(0.5) * m * o
    moved = turned + m * o
    two = FLOAT(2.0)
    return _vec10(
        m,
        moved[0],
        moved[1],
        moved[2],
        jr[0, 0] + two * (g[1] * o[1] + g[2] * o[2]),
        jr[1, 1] + two * (g[0] * o[0] + g[2] * o[2]),
        jr[2, 2] + two * (g[0] * o[0] + g[1] * o[1]),
        jr[0, 1] - g[0] * o[1] - g[1] * o[0],
        jr[0, 2] - g[0] * o[2] - g[2] * o[0],
        jr[1, 2] - g[1] * o[2] - g[2] * o[1],
    )


@wp.func
def _momentum(pi: _vec10, x: _vec6):
    """Spatial inertia times a motion: the wrench (moment, force)."""
    w = wp.spatial_top(x)
    u = wp.spatial_bottom(x)
    h = _vec3(pi[1], pi[2], pi[3])
    turning = _vec3(
        pi[4] * w[0] + pi[7] * w[1] + pi[8] * w[2],
        pi[7] * w[0] + pi[5] * w[1] + pi[9] * w[2],
        pi[8] * w[0] + pi[9] * w[1] + pi[6] * w[2],
    )
    moment = turning + wp.cross(h, u)
    force = pi[0] * u + wp.cross(w, h)
    return _vec6(moment[0], moment[1], moment[2], force[0], force[1], force[2])


# ------------------------------------------------------------------------------------------------------------- the tree


@cache
def _dynamics(parents: tuple[int, ...], directions: int = 1) -> SimpleNamespace:
    """Warp functions of one tree; the tangents take up to so many directions at once."""
    n = len(parents)
    pi_start = len(JOINT_PARAMETERS) * n
    vec = wp.types.vector(length=n, dtype=FLOAT)
    square = wp.types.matrix(shape=(n, n), dtype=FLOAT)
    block = wp.types.matrix(shape=(directions, n), dtype=FLOAT)
    rows6 = wp.types.matrix(shape=(n, 6), dtype=FLOAT)
    rows10 = wp.types.matrix(shape=(n, 10), dtype=FLOAT)
    rows12 = wp.types.matrix(shape=(n, 12), dtype=FLOAT)

    @wp.func
    def poses(fixed: _Constants, q: vec):
        result = rows12()
        for i in range(n):
            turn = fixed.turn[i, 0] + wp.sin(q[i]) * fixed.turn[i, 1] + wp.cos(q[i]) * fixed.turn[i, 2]
            shift = fixed.shift[i, 0] + q[i] * fixed.shift[i, 1]
            if wp.static(parents[i] < 0):
                result[i] = _pose(turn, shift)
            else:
                parent = result[wp.static(parents[i])]
                up = _rotation(parent)
                result[i] = _pose(up * turn, _origin(parent) + up * shift)
        return result

    @wp.func
    def screws(fixed: _Constants, x: rows12):
        result = rows6()
        for i in range(n):
            z = _rotation(x[i]) * fixed.axis[i]
            turns = fixed.revolute[i]
            w = turns * z
            u = wp.cross(_origin(x[i]), w) + (FLOAT(1.0) - turns) * z
            result[i] = _vec6(w[0], w[1], w[2], u[0], u[1], u[2])
        return result

    @wp.func
    def at_base(p: wp.array2d(dtype=FLOAT), w: wp.int32, i: wp.int32, pose: _vec12):
        c = pi_start + 10 * i
        h = _vec3(p[w, c + 1], p[w, c + 2], p[w, c + 3])
        j = _mat33(
            p[w, c + 4], p[w, c + 7], p[w, c + 8],
            p[w, c + 7], p[w, c + 5], p[w, c + 9],
            p[w, c + 8], p[w, c + 9], p[w, c + 6],
        )  # fmt: skip
        return _seen_from_base(p[w, c], h, j, pose)

    @wp.func
    def inertias(p: wp.array2d(dtype=FLOAT), w: wp.int32, x: rows12):
        result = rows10()
        for i in range(n):
            result[i] = at_base(p, w, i, x[i])
        return result

    @wp.func
    def heavier(dp: wp.array2d(dtype=FLOAT), row: wp.int32, i: wp.int32):
        """Whether a direction changes the inertia of body i: most change that of one body, or of none."""
        result = wp.bool(False)
        for k in range(10):
            if dp[row, pi_start + 10 * i + k] != FLOAT(0.0):
                result = wp.bool(True)
        return result

    @wp.func
    def velocities(s: rows6, v: vec):
        result = rows6()
        for i in range(n):
            if wp.static(parents[i] < 0):
                result[i] = v[i] * s[i]
            else:
                result[i] = result[wp.static(parents[i])] + v[i] * s[i]
        return result

    @wp.func
    def mass_matrix(s: rows6, inertia: rows10):
        composite = rows10()
        for k in range(n):
            i = wp.static(n - 1 - k)
            total = inertia[i]
            for j in range(n):
                if wp.static(parents[j] == n - 1 - k):
                    total = total + composite[j]
            composite[i] = total
        result = square()
        for j in range(n):
            f = _momentum(composite[j], s[j])
            for i in range(n):
                if wp.static(i in _way_to_base(parents, j)):
                    coupling = wp.dot(s[i], f)
                    result[i, j] = coupling
                    if wp.static(i != j):
                        result[j, i] = coupling
        return result

    @wp.func
    def inverse_dynamics(fixed: _Constants, s: rows6, inertia: rows10, vel: rows6, v: vec, a: vec):
        g = fixed.gravity
        acc = rows6()
        force = rows6()
        for i in range(n):
            own = a[i] * s[i] + v[i] * wp.spatial_cross(vel[i], s[i])
            if wp.static(parents[i] < 0):
                acc[i] = own + _vec6(FLOAT(0.0), FLOAT(0.0), FLOAT(0.0), -g[0], -g[1], -g[2])
            else:
                acc[i] = own + acc[wp.static(parents[i])]
            force[i] = _momentum(inertia[i], acc[i]) + wp.spatial_cross_dual(vel[i], _momentum(inertia[i], vel[i]))
        subtree = rows6()
        result = vec()
        for k in range(n):
            i = wp.static(n - 1 - k)
            total = force[i]
            for j in range(n):
                if wp.static(parents[j] == n - 1 - k):
                    total = total + subtree[j]
            subtree[i] = total
            result[i] = wp.dot(s[i], total)
        return result

    @wp.func
    def factor(h: square):
        """Cholesky's factor, with the inverse of its diagonal on the diagonal."""
        result = square()
        for i in range(n):
            for j in range(n):
                if wp.static(j <= i):
                    rest = h[i, j]
                    for k in range(n):
                        if wp.static(k < j):
                            rest = rest - result[i, k] * result[j, k]
                    if wp.static(i == j):
                        result[i, j] = FLOAT(1.0) / wp.sqrt(rest)
                    else:
                        result[i, j] = rest * result[j, j]
        return result

    @wp.func
    def solve(l: square, b: vec):  # noqa: E741
        y = vec()
        for i in range(n):
            rest = b[i]
            for k in range(n):
                if wp.static(k < i):
                    rest = rest - l[i, k] * y[k]
            y[i] = rest * l[i, i]
        x = vec()
        for m in range(n):
            i = wp.static(n - 1 - m)
            rest = y[i]
            for k in range(n):
                if wp.static(k > n - 1 - m):
                    rest = rest - l[k, i] * x[k]
            x[i] = rest * l[i, i]
        return x

    @wp.func
    def torques(fixed: _Constants, p: wp.array2d(dtype=FLOAT), w: wp.int32, q: vec, v: vec, command: vec):
        result = vec()
        for i in range(n):
            supply = fixed.supply
            current, _slope = limited_current(command[i], v[i], supply[i, 0], supply[i, 1], supply[i, 2])
            motor = p[w, i] * current
            dry = (p[w, n + i] + p[w, 3 * n + i] * wp.abs(motor)) * wp.tanh(v[i] / fixed.friction_velocity[i])
            result[i] = motor - dry - p[w, 2 * n + i] * v[i] - p[w, 5 * n + i] * q[i]
        return result

    @wp.func
    def armed(p: wp.array2d(dtype=FLOAT), w: wp.int32, h: square):
        """The mass matrix with the armatures on its diagonal."""
        result = square()
        for i in range(n):
            for j in range(n):
                if wp.static(i == j):
                    result[i, j] = h[i, j] + p[w, 4 * n + i]
                else:
                    result[i, j] = h[i, j]
        return result

    @wp.func
    def acceleration(fixed: _Constants, p: wp.array2d(dtype=FLOAT), w: wp.int32, q: vec, v: vec, command: vec):
        x = poses(fixed, q)
        s = screws(fixed, x)
        inertia = inertias(p, w, x)
        vel = velocities(s, v)
        bias = inverse_dynamics(fixed, s, inertia, vel, v, vec())
        l = factor(armed(p, w, mass_matrix(s, inertia)))  # noqa: E741
        return solve(l, torques(fixed, p, w, q, v, command) - bias)

    @wp.func
    def linearised(
        fixed: _Constants,
        p: wp.array2d(dtype=FLOAT),
        w: wp.int32,
        dp: wp.array2d(dtype=FLOAT),
        row: wp.int32,
        count: wp.int32,
        q: vec,
        v: vec,
        dq: block,
        dv: block,
        command: vec,
    ):
        """The acceleration and its changes along directions row, row + 1, ...; never taped."""
        x = poses(fixed, q)
        s = screws(fixed, x)
        inertia = inertias(p, w, x)
        vel = velocities(s, v)
        bias = inverse_dynamics(fixed, s, inertia, vel, v, vec())
        l = factor(armed(p, w, mass_matrix(s, inertia)))  # noqa: E741
        a = solve(l, torques(fixed, p, w, q, v, command) - bias)

        # what all directions share
        g = fixed.gravity
        acc = rows6()
        momentum = rows6()
        force = rows6()
        turn = rows6()  # V_i x S_i
        lift = rows6()  # A_p x S_i
        for i in range(n):
            below = _vec6(FLOAT(0.0), FLOAT(0.0), FLOAT(0.0), -g[0], -g[1], -g[2])
            if wp.static(parents[i] >= 0):
                below = acc[wp.static(parents[i])]
            turn[i] = wp.spatial_cross(vel[i], s[i])
            lift[i] = wp.spatial_cross(below, s[i])
            acc[i] = below + a[i] * s[i] + v[i] * turn[i]
            momentum[i] = _momentum(inertia[i], vel[i])
            force[i] = _momentum(inertia[i], acc[i]) + wp.spatial_cross_dual(vel[i], momentum[i])
        by_constant = vec()
        by_v = vec()
        side = vec()
        load = vec()
        for k in range(n):
            i = wp.static(n - 1 - k)
            if wp.static(parents[n - 1 - k] >= 0):
                force[wp.static(parents[n - 1 - k])] = force[wp.static(parents[n - 1 - k])] + force[i]
            supply = fixed.supply
            current, slope = limited_current(command[i], v[i], supply[i, 0], supply[i, 1], supply[i, 2])
            motor = p[w, i] * current
            side[i] = wp.tanh(v[i] / fixed.friction_velocity[i])
            load[i] = wp.abs(motor)
            # d motor / d(.) enters the friction through |motor| as well
            gain = FLOAT(1.0) - p[w, 3 * n + i] * wp.sign(motor) * side[i]
            steep = (p[w, n + i] + p[w, 3 * n + i] * load[i]) / fixed.friction_velocity[i]
            by_constant[i] = gain * current
            by_v[i] = gain * p[w, i] * slope - steep * (FLOAT(1.0) - side[i] * side[i]) - p[w, 2 * n + i]

        da = block()
        for d in range(count):
            r = row + d
            own_vel = rows6()
            own_acc = rows6()
            own_force = rows6()
            for i in range(n):
                own_vel[i] = dv[d, i] * s[i] + dq[d, i] * turn[i]
                if wp.static(parents[i] >= 0):
                    own_vel[i] = own_vel[i] + own_vel[wp.static(parents[i])]
                    own_acc[i] = own_acc[wp.static(parents[i])]
                own_acc[i] = (
                    own_acc[i] + dq[d, i] * lift[i] + dv[d, i] * turn[i] + v[i] * wp.spatial_cross(own_vel[i], s[i])
                )
                own_momentum = _momentum(inertia[i], own_vel[i])
                own_force[i] = _momentum(inertia[i], own_acc[i]) + wp.spatial_cross_dual(own_vel[i], momentum[i])
                if heavier(dp, r, i):
                    d_inertia = at_base(dp, r, i, x[i])
                    own_momentum = own_momentum + _momentum(d_inertia, vel[i])
                    own_force[i] = own_force[i] + _momentum(d_inertia, acc[i])
                own_force[i] = own_force[i] + wp.spatial_cross_dual(vel[i], own_momentum)
            rest = vec()
            for k in range(n):
                i = wp.static(n - 1 - k)
                if wp.static(parents[n - 1 - k] >= 0):
                    b = wp.static(parents[n - 1 - k])
                    own_force[b] = own_force[b] + own_force[i] + dq[d, i] * wp.spatial_cross_dual(s[i], force[i])
                rest[i] = (
                    by_constant[i] * dp[r, i]
                    + by_v[i] * dv[d, i]
                    - p[w, 5 * n + i] * dq[d, i]
                    - side[i] * dp[r, n + i]
                    - v[i] * dp[r, 2 * n + i]
                    - load[i] * side[i] * dp[r, 3 * n + i]
                    - a[i] * dp[r, 4 * n + i]
                    - q[i] * dp[r, 5 * n + i]
                    - wp.dot(s[i], own_force[i])
                )
            da[d] = solve(l, rest)
        return a, da

    @wp.func
    def sticking(fixed: _Constants, p: wp.array2d(dtype=FLOAT), w: wp.int32, v: vec, a: vec, step: FLOAT):
        """Whether a joint with dry friction is, or may come within a step, near standstill."""
        result = wp.bool(False)
        for i in range(n):
            if p[w, n + i] > FLOAT(0.0) or p[w, 3 * n + i] > FLOAT(0.0):
                if wp.abs(v[i]) < FLOAT(20.0) * fixed.friction_velocity[i] + wp.abs(a[i]) * step:
                    result = wp.bool(True)
        return result

    return SimpleNamespace(
        poses=poses,
        screws=screws,
        inertias=inertias,
        velocities=velocities,
        mass_matrix=mass_matrix,
        inverse_dynamics=inverse_dynamics,
        acceleration=acceleration,
        linearised=linearised,
        sticking=sticking,
    )


def _way_to_base(parents: tuple[int, ...], joint: int) -> tuple[int, ...]:
    """A joint and all those that carry it."""
    way = []
    while joint >= 0:
        way.append(joint)
        joint = parents[joint]
    return tuple(way)


def _module(parents: tuple[int, ...], purpose: str) -> Any:
    """A Warp module of its own for each tree.

    What unrolled loops select statically from ``parents`` is no part of Warp's hash of the source, so two trees in one module
    would silently share the first one's binary, also across processes through the kernel cache. The name keeps them apart.
    """
    return wp.get_module("proprio_ros.sim.chain." + "_".join(str(parent + 1) for parent in parents) + "." + purpose)


@cache
def _terms_kernel(parents: tuple[int, ...]) -> Any:
    """Mass matrix and inverse dynamics without armature, in the functions that the rollouts use."""
    n = len(parents)
    vec = wp.types.vector(length=n, dtype=FLOAT)
    square = wp.types.matrix(shape=(n, n), dtype=FLOAT)
    tree = _dynamics(parents)
    poses, screws, inertias, velocities = tree.poses, tree.screws, tree.inertias, tree.velocities
    mass_matrix_of, inverse_dynamics_of = tree.mass_matrix, tree.inverse_dynamics

    @wp.kernel(module=_module(parents, "terms"), enable_backward=False)
    def kernel(
        # Model:
        fixed: _Constants,
        p_in: wp.array2d(dtype=FLOAT),
        # World data in:
        q_in: wp.array(dtype=vec),
        v_in: wp.array(dtype=vec),
        a_in: wp.array(dtype=vec),
        # World data out:
        h_out: wp.array(dtype=square),
        torque_out: wp.array(dtype=vec),
    ):
        w = wp.tid()
        x = poses(fixed, q_in[w])
        s = screws(fixed, x)
        inertia = inertias(p_in, 0, x)
        h_out[w] = mass_matrix_of(s, inertia)
        torque_out[w] = inverse_dynamics_of(fixed, s, inertia, velocities(s, v_in[w]), v_in[w], a_in[w])

    return kernel


@cache
def _forward_kernel(parents: tuple[int, ...], integrator: str, directions: int) -> Any:
    """Rollout, thread = (world, block of directions): with exact forward sensitivities, or (0) writing down its steps."""
    n = len(parents)
    delay_column = (len(JOINT_PARAMETERS) + _INERTIAL) * n
    tangent = directions > 0
    vec = wp.types.vector(length=n, dtype=FLOAT)
    block = wp.types.matrix(shape=(max(directions, 1), n), dtype=FLOAT)
    instants = wp.types.vector(length=max(directions, 1), dtype=FLOAT)
    tree = _dynamics(parents, max(directions, 1))
    acceleration, linearised, sticking = tree.acceleration, tree.linearised, tree.sticking
    rk4 = integrator == "rk4"

    @wp.func
    def slope(
        fixed: _Constants,
        p: wp.array2d(dtype=FLOAT),
        w: wp.int32,
        dp: wp.array2d(dtype=FLOAT),
        row: wp.int32,
        count: wp.int32,
        q: vec,
        v: vec,
        dq: block,
        dv: block,
        command: vec,
    ):
        if wp.static(tangent):
            a, da = linearised(fixed, p, w, dp, row, count, q, v, dq, dv, command)
        else:
            a = acceleration(fixed, p, w, q, v, command)
            da = block()
        return a, da

    @wp.kernel(module=_module(parents, f"forward_{integrator}_{directions}"), enable_backward=False)
    def kernel(
        # Run data:
        fixed: _Constants,
        sample_times: wp.array(dtype=FLOAT),
        input_times: wp.array(dtype=FLOAT),
        input_current: wp.array(dtype=vec),
        coarse: FLOAT,
        fine: FLOAT,
        # World data in: parameters (W, P), directions (W * D, P), D
        p_in: wp.array2d(dtype=FLOAT),
        dp_in: wp.array2d(dtype=FLOAT),
        per_world: wp.int32,
        # World data out: q and v (W, T), dq (W * D, T)
        q_out: wp.array2d(dtype=vec),
        v_out: wp.array2d(dtype=vec),
        dq_out: wp.array2d(dtype=vec),
        # World data out, without tangent: step length, its change with the delay, segment of the input (W, steps);
        # number of steps (W,); the step after which each sample is taken, -1 before the onset (W, T)
        step_out: wp.array2d(dtype=FLOAT),
        step_by_delay_out: wp.array2d(dtype=FLOAT),
        segment_out: wp.array2d(dtype=wp.int32),
        steps_out: wp.array(dtype=wp.int32),
        sample_step_out: wp.array2d(dtype=wp.int32),
    ):
        w, first = wp.tid()
        first = first * wp.static(max(directions, 1))
        row = w * per_world + first
        count = wp.min(wp.static(max(directions, 1)), per_world - first)
        delay = p_in[w, delay_column]
        q = vec()
        v = vec()
        dq = block()
        dv = block()
        for i in range(n):
            q[i] = p_in[w, delay_column + 1 + i]
            v[i] = p_in[w, delay_column + 1 + n + i]
        # how instants move along each direction: only those of samples do, with the delay
        d_goal = instants(FLOAT(-1.0))
        if wp.static(tangent):
            for d in range(count):
                d_goal[d] = -dp_in[row + d, delay_column]
                for i in range(n):
                    dq[d, i] = dp_in[row + d, delay_column + 1 + i]
                    dv[d, i] = dp_in[row + d, delay_column + 1 + n + i]
        half = FLOAT(0.5)
        sixth = FLOAT(1.0) / FLOAT(6.0)
        two = FLOAT(2.0)
        t = FLOAT(0.0)
        dt = instants()
        segment = wp.int32(0)
        steps = wp.int32(0)
        for k in range(sample_times.shape[0]):
            goal = sample_times[k] - delay
            if goal <= FLOAT(0.0):
                if first == 0:
                    q_out[w, k] = q + goal * v
                    v_out[w, k] = v
                if wp.static(tangent):
                    for d in range(count):
                        dq_out[row + d, k] = dq[d] + goal * dv[d] + d_goal[d] * v
                else:
                    sample_step_out[w, k] = -1
            else:
                arrived = wp.bool(False)
                while not arrived:
                    # the next event: the sample, or a change of the input before it
                    end = goal
                    d_end = d_goal
                    arrived = wp.bool(True)
                    if segment + 1 < input_times.shape[0]:
                        if input_times[segment + 1] < goal:
                            end = input_times[segment + 1]
                            d_end = instants()
                            arrived = wp.bool(False)
                    command = input_current[segment]
                    last = wp.bool(False)
                    while not last:
                        a1, da1 = slope(fixed, p_in, w, dp_in, row, count, q, v, dq, dv, command)
                        h = coarse
                        if fine < coarse:
                            if sticking(fixed, p_in, w, v, a1, coarse):
                                h = fine
                        dh = instants()
                        if t + h > end - FLOAT(TIME_EPS):
                            # may have no length, where a sample falls on a change of the input, but still moves
                            h = end - t
                            dh = d_end - dt
                            last = wp.bool(True)
                        if wp.static(not tangent):
                            if steps < step_out.shape[1]:
                                step_out[w, steps] = h
                                step_by_delay_out[w, steps] = dh[0]
                                segment_out[w, steps] = segment
                        if wp.static(rk4):
                            q2 = q + half * h * v
                            v2 = v + half * h * a1
                            dq2 = dq + half * (h * dv + wp.outer(dh, v))
                            dv2 = dv + half * (h * da1 + wp.outer(dh, a1))
                            a2, da2 = slope(fixed, p_in, w, dp_in, row, count, q2, v2, dq2, dv2, command)
                            q3 = q + half * h * v2
                            v3 = v + half * h * a2
                            dq3 = dq + half * (h * dv2 + wp.outer(dh, v2))
                            dv3 = dv + half * (h * da2 + wp.outer(dh, a2))
                            a3, da3 = slope(fixed, p_in, w, dp_in, row, count, q3, v3, dq3, dv3, command)
                            q4 = q + h * v3
                            v4 = v + h * a3
                            dq4 = dq + h * dv3 + wp.outer(dh, v3)
                            dv4 = dv + h * da3 + wp.outer(dh, a3)
                            a4, da4 = slope(fixed, p_in, w, dp_in, row, count, q4, v4, dq4, dv4, command)
                            mean_v = sixth * (v + two * v2 + two * v3 + v4)
                            mean_a = sixth * (a1 + two * a2 + two * a3 + a4)
                            dq = dq + sixth * h * (dv + two * dv2 + two * dv3 + dv4) + wp.outer(dh, mean_v)
                            dv = dv + sixth * h * (da1 + two * da2 + two * da3 + da4) + wp.outer(dh, mean_a)
                            q = q + h * mean_v
                            v = v + h * mean_a
                        else:
                            v = v + h * a1
                            dv = dv + h * da1 + wp.outer(dh, a1)
                            q = q + h * v
                            dq = dq + h * dv + wp.outer(dh, v)
                        steps += 1
                        t = t + h
                        if last:
                            t = end
                            dt = d_end
                    if not arrived:
                        segment += 1
                if first == 0:
                    q_out[w, k] = q
                    v_out[w, k] = v
                if wp.static(tangent):
                    for d in range(count):
                        dq_out[row + d, k] = dq[d]
                else:
                    sample_step_out[w, k] = steps
        if wp.static(not tangent):
            steps_out[w] = steps

    return kernel


@cache
def _taped_kernels(parents: tuple[int, ...], integrator: str) -> tuple[Any, Any]:
    """Kernels whose adjoint is right: every step writes its own row, no state is overwritten."""
    n = len(parents)
    delay_column = (len(JOINT_PARAMETERS) + _INERTIAL) * n
    vec = wp.types.vector(length=n, dtype=FLOAT)
    acceleration = _dynamics(parents).acceleration
    rk4 = integrator == "rk4"

    @wp.func
    def state(p: wp.array2d(dtype=FLOAT), w: wp.int32, start: wp.int32):
        result = vec()
        for i in range(n):
            result[i] = p[w, start + i]
        return result

    @wp.kernel(module=_module(parents, f"tape_{integrator}"))
    def roll(
        # Run data:
        fixed: _Constants,
        input_current: wp.array(dtype=vec),
        # World data in:
        p_in: wp.array2d(dtype=FLOAT),
        delay_at: wp.array(dtype=FLOAT),
        step_in: wp.array2d(dtype=FLOAT),
        step_by_delay_in: wp.array2d(dtype=FLOAT),
        segment_in: wp.array2d(dtype=wp.int32),
        steps_in: wp.array(dtype=wp.int32),
        # World data out:
        q_out: wp.array2d(dtype=vec),
        v_out: wp.array2d(dtype=vec),
    ):
        w = wp.tid()
        delay = p_in[w, delay_column]
        half = FLOAT(0.5)
        sixth = FLOAT(1.0) / FLOAT(6.0)
        two = FLOAT(2.0)
        q_out[w, 0] = state(p_in, w, delay_column + 1)
        v_out[w, 0] = state(p_in, w, delay_column + 1 + n)
        for k in range(steps_in[w]):
            h = step_in[w, k] + step_by_delay_in[w, k] * (delay - delay_at[w])
            command = input_current[segment_in[w, k]]
            q = q_out[w, k]
            v = v_out[w, k]
            a1 = acceleration(fixed, p_in, w, q, v, command)
            if wp.static(rk4):
                q2 = q + half * h * v
                v2 = v + half * h * a1
                a2 = acceleration(fixed, p_in, w, q2, v2, command)
                q3 = q + half * h * v2
                v3 = v + half * h * a2
                a3 = acceleration(fixed, p_in, w, q3, v3, command)
                q4 = q + h * v3
                v4 = v + h * a3
                a4 = acceleration(fixed, p_in, w, q4, v4, command)
                q_out[w, k + 1] = q + sixth * h * (v + two * v2 + two * v3 + v4)
                v_out[w, k + 1] = v + sixth * h * (a1 + two * a2 + two * a3 + a4)
            else:
                v_next = v + h * a1
                v_out[w, k + 1] = v_next
                q_out[w, k + 1] = q + h * v_next

    @wp.kernel(module=_module(parents, f"tape_{integrator}"))
    def observe(
        # Run data:
        sample_times: wp.array(dtype=FLOAT),
        # World data in:
        p_in: wp.array2d(dtype=FLOAT),
        sample_step_in: wp.array2d(dtype=wp.int32),
        q_in: wp.array2d(dtype=vec),
        # World data out:
        sampled_out: wp.array2d(dtype=vec),
    ):
        w, k = wp.tid()
        step = sample_step_in[w, k]
        if step < 0:
            goal = sample_times[k] - p_in[w, delay_column]
            sampled_out[w, k] = state(p_in, w, delay_column + 1) + goal * state(p_in, w, delay_column + 1 + n)
        else:
            sampled_out[w, k] = q_in[w, step]

    return roll, observe


# ------------------------------------------------------------------------------------------------------------ host side


def inertial_parameters(pseudo: ArrayLike) -> NDArray[np.float64]:
    """The ten inertial parameters (m, hx, hy, hz, Jxx, Jyy, Jzz, Jxy, Jxz, Jyz) of pseudo-inertias.

    Linear, so that it also takes a direction in pseudo-inertia to one in the parameters.

    Args:
        pseudo: About the body's frame, shape (..., 4, 4).

    Returns:
        Shape (..., 10): mass [kg], first moments [kg m], and rotational inertia about the frame's origin [kg m^2], whose
        products are entries of the matrix (Jxy = -int x y dm).
    """
    pseudo = np.asarray(pseudo, dtype=np.float64)
    result = np.empty((*pseudo.shape[:-2], _INERTIAL))
    result[..., 0] = pseudo[..., 3, 3]
    result[..., 1:4] = pseudo[..., :3, 3]
    trace = np.trace(pseudo[..., :3, :3], axis1=-2, axis2=-1)
    for column, (i, j) in enumerate(_TRIANGLE):
        result[..., 4 + column] = (trace if i == j else 0.0) - pseudo[..., i, j]
    return result


def _doubles(values: ArrayLike, dtype: Any, device: str, **kwargs: Any) -> wp.array:
    return wp.array(np.ascontiguousarray(values, dtype=np.float64), dtype=dtype, device=device, **kwargs)


def _constants(model: ReducedModel, friction_velocity: ArrayLike, supply: ArrayLike, device: str) -> Any:
    n = len(model.joint_names)
    turn = np.zeros((n, 3, 3, 3))
    shift = np.zeros((n, 2, 3))
    for i, kind in enumerate(model.kinds):
        placed, axis = model.placement[i, :3, :3], model.axes[i]
        shift[i, 0] = model.placement[i, :3, 3]
        if kind == "revolute":
            along = np.outer(axis, axis)
            turn[i] = placed @ along, placed @ (rotation_about(axis, 0.5 * np.pi) - along), placed @ (np.eye(3) - along)
        else:
            turn[i, 0] = placed
            shift[i, 1] = placed @ axis
    fixed = _Constants()
    fixed.turn = _doubles(turn, _mat33, device)
    fixed.shift = _doubles(shift, _vec3, device)
    fixed.axis = _doubles(model.axes, _vec3, device)
    fixed.revolute = _doubles([kind == "revolute" for kind in model.kinds], FLOAT, device)
    fixed.gravity = _vec3(*model.gravity)
    fixed.friction_velocity = _doubles(friction_velocity, FLOAT, device)
    fixed.supply = _doubles(supply, FLOAT, device)
    return fixed


def _parents(model: ReducedModel) -> tuple[int, ...]:
    return tuple(int(parent) for parent in model.parents)


def rigid_body_terms(
    model: ReducedModel, q: ArrayLike, v: ArrayLike, a: ArrayLike, device: str = "cpu"
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mass matrix and inverse dynamics of the bare bodies, without armature, friction and springs.

    Args:
        model: The bodies.
        q: Positions [rad or m], shape (B, n).
        v: Velocities [rad/s or m/s], shape (B, n).
        a: Accelerations [rad/s^2 or m/s^2], shape (B, n); zero for the bias forces.
        device: Warp device name.

    Returns:
        H (B, n, n) and the torques or forces H a + b(q, v) (B, n).
    """
    n = len(model.joint_names)
    states = [np.asarray(values, dtype=np.float64).reshape(-1, n) for values in (q, v, a)]
    vec = wp.types.vector(length=n, dtype=FLOAT)
    p = np.concatenate([np.zeros(len(JOINT_PARAMETERS) * n), inertial_parameters(model.pseudo_inertia).ravel()])[None]
    h = wp.zeros(len(states[0]), dtype=wp.types.matrix(shape=(n, n), dtype=FLOAT), device=device)
    torque = wp.zeros(len(states[0]), dtype=vec, device=device)
    wp.launch(
        _terms_kernel(_parents(model)),
        dim=len(states[0]),
        inputs=[
            _constants(model, np.ones(n), np.zeros((n, 3)), device),
            _doubles(p, FLOAT, device),
            *(_doubles(x, vec, device) for x in states),
        ],
        outputs=[h, torque],
        device=device,
    )
    return h.numpy().copy(), torque.numpy().copy()


def mass_matrix(model: ReducedModel, q: ArrayLike) -> NDArray[np.float64]:
    """H(q) without armature [kg m^2, kg m or kg], shape (B, n, n), at positions of shape (B, n)."""
    return rigid_body_terms(model, q, np.zeros_like(q), np.zeros_like(q))[0]


def bias(model: ReducedModel, q: ArrayLike, v: ArrayLike) -> NDArray[np.float64]:
    """Gravity, centrifugal and Coriolis torques b(q, v) [N m or N], shape (B, n), at states of shape (B, n)."""
    return rigid_body_terms(model, q, v, np.zeros_like(q))[1]


class ChainSimulator:
    """Rolls out many worlds (guesses) of one run of a chain or tree in one launch.

    The rollout starts at the command's onset, time 0, in state (q0, v0). Sample k is taken at ``t_k - delay``; before the
    onset it is ``q0 + v0 (t_k - delay)``. Steps have length ``step_s`` (``fine_step_s`` while a joint with dry friction is near
    standstill), and the last one before a sample or a change of the input is shortened.

    Args:
        model: The bodies and their joints, n of them.
        sample_times_s: Encoder stamps after command onset [s], shape (T,), increasing.
        input_times_s: When any current changes [s], shape (S,), increasing, first at 0.
        input_current_A: The currents from each of those instants on [A], shape (S, n).
        friction_velocity: Where Coulomb's law is smoothed [rad/s, or m/s for a slide], one number or shape (n,).
        supply: (voltage [V], back-EMF constant [V s/rad], resistance [ohm]) of each joint, shape (n, 3); voltage 0 means no
            limit. None: no limit anywhere.
        integrator: ``"rk4"``, or ``"semi_implicit"`` (the paper's equation (2)).
        step_s: Longest integration step [s]; 1/60/substeps makes semi-implicit Euler the paper's.
        fine_step_s: Step near standstill [s]; None for ``step_s``.
        device: Warp device name.

    Raises:
        SimulationError: Unknown integrator, no samples, wrong shapes, instants out of order or steps that are not positive.

    Attributes:
        parameter_names: One for each of the P = 18 n + 1 columns of a parameter array, SI: ``torque_constant[JOINT]`` of all
            joints, then likewise ``coulomb``, ``viscous``, ``load_friction``, ``armature`` and ``stiffness``;
            ``pi[JOINT][0..9]`` (see ``inertial_parameters``); ``delay``; ``q0[JOINT]`` of all joints; ``v0[JOINT]`` of all joints.
        columns: The columns of each group: ``columns["pi"]`` is the slice of all ``pi[JOINT][k]``.
    """

    def __init__(
        self,
        model: ReducedModel,
        sample_times_s: ArrayLike,
        input_times_s: ArrayLike,
        input_current_A: ArrayLike,
        *,
        friction_velocity: ArrayLike,
        supply: ArrayLike | None = None,
        integrator: str = "rk4",
        step_s: float = 1.0 / 240.0,
        fine_step_s: float | None = None,
        device: str = "cpu",
    ) -> None:
        n = len(model.joint_names)
        samples = np.asarray(sample_times_s, dtype=np.float64)
        switches = np.asarray(input_times_s, dtype=np.float64)
        current = np.asarray(input_current_A, dtype=np.float64)
        fine = step_s if fine_step_s is None else min(fine_step_s, step_s)
        if integrator not in INTEGRATORS:
            raise SimulationError(f"unknown integrator {integrator!r}: choose one of {', '.join(INTEGRATORS)}")
        if samples.ndim != 1 or len(samples) == 0 or np.any(np.diff(samples) < 0.0):
            raise SimulationError("sample_times_s must be one or more increasing instants in s")
        if switches.ndim != 1 or len(switches) == 0 or switches[0] != 0.0 or np.any(np.diff(switches) <= 0.0):
            raise SimulationError("input_times_s must be increasing instants in s, the first of them 0")
        if current.shape != (len(switches), n):
            raise SimulationError(
                f"input_current_A has shape {current.shape}: give a row for each of the {len(switches)} instants of "
                f"input_times_s and a column for each joint ({', '.join(model.joint_names)})"
            )
        limits = np.zeros((n, 3)) if supply is None else np.asarray(supply, dtype=np.float64)
        if limits.shape != (n, 3) or np.any(limits < 0.0) or np.any((limits[:, 0] > 0.0) & (limits[:, 2] == 0.0)):
            raise SimulationError("supply must be (voltage, back-EMF constant, resistance) of each joint, not negative")
        smoothing = np.asarray(friction_velocity, dtype=np.float64)
        if smoothing.shape not in ((), (n,)) or not np.all(smoothing > 0.0):
            raise SimulationError("friction_velocity must be one positive number, or one for each joint")
        smoothing = np.broadcast_to(smoothing, (n,))
        if not fine > 0.0:
            raise SimulationError(f"the integration step is {fine} s: step_s and fine_step_s must be positive")
        self.model = model
        self.integrator = integrator
        self.device = device
        names = [f"{group}[{joint}]" for group in JOINT_PARAMETERS for joint in model.joint_names]
        names += [f"pi[{joint}][{k}]" for joint in model.joint_names for k in range(_INERTIAL)]
        names += ["delay", *(f"{group}[{joint}]" for group in ("q0", "v0") for joint in model.joint_names)]
        self.parameter_names = tuple(names)
        sizes = dict.fromkeys(JOINT_PARAMETERS, n) | {"pi": _INERTIAL * n, "delay": 1, "q0": n, "v0": n}
        stops = np.cumsum(list(sizes.values())).tolist()
        self.columns = {
            group: slice(stop - size, stop) for (group, size), stop in zip(sizes.items(), stops, strict=True)
        }
        self._n = n
        self._parents = _parents(model)
        self._vec = wp.types.vector(length=n, dtype=FLOAT)
        self._fixed = _constants(model, smoothing, limits, device)
        self._samples = _doubles(samples, FLOAT, device)
        self._switches = _doubles(switches, FLOAT, device)
        self._current = _doubles(current, self._vec, device)
        self._steps = (step_s, fine)

    def pack(self, **groups: ArrayLike) -> NDArray[np.float64]:
        """Parameters of one or more worlds.

        Args:
            **groups: A value of each group (see ``columns``) that is not at its default: one number, shape (n,) or (W, n);
                ``pi`` shape (n, 10) or (W, n, 10); ``delay`` one number or shape (W,). The inertial parameters default to the
                model's, everything else to zero.

        Returns:
            Shape (W, P); W is 1 when no group has worlds.

        Raises:
            SimulationError: Unknown group, or a shape that does not fit.
        """
        values = {"pi": inertial_parameters(self.model.pseudo_inertia)} | dict(groups)
        blocks = []
        for group, value in values.items():
            if group not in self.columns:
                raise SimulationError(f"unknown parameters {group!r}: choose from {', '.join(self.columns)}")
            own = {"pi": (self._n, _INERTIAL), "delay": ()}.get(group, (self._n,))
            array = np.asarray(value, dtype=np.float64)
            worlds = array.shape[:1] if array.ndim > len(own) else (1,)
            try:
                blocks.append(np.broadcast_to(array, worlds + own).reshape(*worlds, -1))
            except ValueError as error:
                raise SimulationError(
                    f"{group} has shape {array.shape}: give {own}, or one more axis of worlds"
                ) from error
        counts = {len(block) for block in blocks} - {1}
        if len(counts) > 1:
            raise SimulationError(f"groups have {sorted(counts)} worlds: give each the same number, or one")
        result = np.zeros((counts.pop() if counts else 1, len(self.parameter_names)))
        for group, block in zip(values, blocks, strict=True):
            result[:, self.columns[group]] = block
        return result

    def _checked(self, p: ArrayLike) -> NDArray[np.float64]:
        result = np.ascontiguousarray(p, dtype=np.float64)
        if result.ndim != 2 or result.shape[1] != len(self.parameter_names):
            raise SimulationError(f"parameters have shape {result.shape}: give (worlds, {len(self.parameter_names)})")
        return result

    def _launch(
        self, p: NDArray[np.float64], directions: NDArray[np.float64] | None, capacity: int = 0
    ) -> tuple[wp.array, ...]:
        """The forward kernel on parameters (W, P), with directions (W, D, P), or writing down up to ``capacity`` steps."""
        device = self.device
        worlds, samples = len(p), len(self._samples)
        tangent = directions is not None
        dp = np.zeros((worlds, p.shape[1])) if directions is None else directions.reshape(-1, p.shape[1])
        q, v = (wp.empty((worlds, samples), dtype=self._vec, device=device) for _ in range(2))
        dq = wp.empty((len(dp) if tangent else 0, samples), dtype=self._vec, device=device)
        step, by_delay = (wp.empty((worlds, capacity), dtype=FLOAT, device=device) for _ in range(2))
        segment = wp.empty((worlds, capacity), dtype=wp.int32, device=device)
        steps = wp.zeros(worlds, dtype=wp.int32, device=device)
        sample_step = wp.empty((worlds, 0 if tangent else samples), dtype=wp.int32, device=device)
        per_world = len(dp) // worlds
        block = next((size for size in _BLOCKS if size >= per_world), _BLOCKS[-1]) if tangent else 0
        wp.launch(
            _forward_kernel(self._parents, self.integrator, block),
            dim=(worlds, -(-per_world // max(block, 1))),
            inputs=[
                self._fixed, self._samples, self._switches, self._current, *self._steps,
                _doubles(p, FLOAT, device), _doubles(dp, FLOAT, device), per_world,
            ],
            outputs=[q, v, dq, step, by_delay, segment, steps, sample_step],
            device=device,
        )  # fmt: skip
        return q, v, dq, step, by_delay, segment, steps, sample_step

    def rollout(self, p: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Positions and velocities at the sample instants.

        Args:
            p: Parameters of each world, shape (W, P).

        Returns:
            q [rad or m] (W, T, n) and v [rad/s or m/s] (W, T, n).

        Raises:
            SimulationError: The parameters have the wrong shape.
        """
        q, v, *_ = self._launch(self._checked(p), None)
        return q.numpy().copy(), v.numpy().copy()

    def jacobian(self, p: ArrayLike, dp: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Positions at the sample instants, with exact forward sensitivities.

        Args:
            p: Parameters of each world, shape (W, P).
            dp: D tangent directions of each world in parameter space, shape (W, P, D).

        Returns:
            q (W, T, n) and dq (W, T, n, D).

        Raises:
            SimulationError: Parameters or directions have the wrong shape.
        """
        p = self._checked(p)
        directions = np.asarray(dp, dtype=np.float64)
        if directions.ndim != 3 or directions.shape[:2] != p.shape or directions.shape[2] == 0:
            raise SimulationError(f"directions have shape {directions.shape}: give ({p.shape[0]}, {p.shape[1]}, D)")
        q, _, dq, *_ = self._launch(p, np.ascontiguousarray(directions.transpose(0, 2, 1)))
        sensitivities = dq.numpy().reshape(len(p), directions.shape[2], len(self._samples), self._n)
        return q.numpy().copy(), np.ascontiguousarray(sensitivities.transpose(0, 2, 3, 1))

    def tape_gradient(self, p: ArrayLike, weights: ArrayLike) -> NDArray[np.float64]:
        """Gradient of ``sum(weights * q)`` by reverse mode, on the steps that the rollout takes at the same parameters.

        Their lengths follow the delay to first order, which is exact, and stay frozen otherwise.

        Args:
            p: Parameters of each world, shape (W, P).
            weights: Shape (W, T, n).

        Returns:
            Shape (W, P).

        Raises:
            SimulationError: The parameters or weights have the wrong shape, or there are too many steps to keep.
        """
        p = self._checked(p)
        seed = np.asarray(weights, dtype=np.float64)
        shape = (len(p), len(self._samples), self._n)
        if seed.shape != shape:
            raise SimulationError(f"weights have shape {seed.shape}: give {shape}")
        capacity = int(self._launch(p, None)[6].numpy().max())
        if capacity > MAX_STEPS:
            raise SimulationError(
                f"{capacity} steps are too many for a tape (at most {MAX_STEPS}): use a longer step, or the forward "
                "sensitivities"
            )
        step, by_delay, segment, steps, sample_step = self._launch(p, None, capacity)[3:]
        device = self.device
        p_array = _doubles(p, FLOAT, device, requires_grad=True)
        delay_at = _doubles(p[:, self.columns["delay"]].ravel(), FLOAT, device)
        q, v = (wp.zeros((len(p), capacity + 1), dtype=self._vec, device=device, requires_grad=True) for _ in range(2))
        sampled = wp.zeros(shape[:2], dtype=self._vec, device=device, requires_grad=True)
        roll, observe = _taped_kernels(self._parents, self.integrator)
        tape = wp.Tape()
        with tape:
            wp.launch(
                roll,
                dim=len(p),
                inputs=[self._fixed, self._current, p_array, delay_at, step, by_delay, segment, steps],
                outputs=[q, v],
                device=device,
            )
            wp.launch(
                observe,
                dim=shape[:2],
                inputs=[self._samples, p_array, sample_step, q],
                outputs=[sampled],
                device=device,
            )
        tape.backward(grads={sampled: _doubles(seed, self._vec, device)})
        return p_array.grad.numpy().copy()


# -------------------------------------------------------------------------------------------------------------- payload


def attach_payload_joint(
    model: ReducedModel, frame: str, kind: str, axes: ArrayLike, pseudo_inertia: ArrayLike, name: str = "payload"
) -> ReducedModel:
    """Hang a payload on a joint of its own, so that it moves in the hand: what slides, sloshes or dangles.

    Args:
        model: The robot, some joints held.
        frame: Link that holds the payload; the joint sits at its frame's origin.
        kind: ``"prismatic"`` (one slide, joint ``NAME_slide``), or ``"universal"`` (two hinges at one point, joints
            ``NAME_swing_1`` and ``NAME_swing_2``, with a massless body between them).
        axes: In the frame's axes, need not be unit vectors; prismatic: shape (3,); universal: shape (2, 3), the second hinge
            is carried by the first.
        pseudo_inertia: Of the payload about the frame with the new joints at zero, shape (4, 4).
        name: Of the payload's own frame in the result, and the start of the joints' names.

    Returns:
        The model with one or two more joints at the end, and the frame ``NAME`` on the payload.

    Raises:
        SimulationError: Unknown frame or kind, a name that is taken, axes that are no axes (or are parallel), or a payload
            that has no inertia about them.
    """
    if frame not in model.frames:
        raise SimulationError(f"there is no frame {frame!r} to hold a payload: choose from {', '.join(model.frames)}")
    if kind not in PAYLOAD_JOINTS:
        raise SimulationError(f"unknown payload joint {kind!r}: choose one of {', '.join(PAYLOAD_JOINTS)}")
    wanted = (3,) if kind == "prismatic" else (2, 3)
    directions = np.asarray(axes, dtype=np.float64)
    if directions.shape != wanted or not np.all(np.linalg.norm(directions, axis=-1) > 0.0):
        raise SimulationError(
            f"a {kind} payload joint needs non-zero axes of shape {wanted}, got {directions.tolist()}"
        )
    directions = (directions / np.linalg.norm(directions, axis=-1, keepdims=True)).reshape(-1, 3)
    pseudo = np.asarray(pseudo_inertia, dtype=np.float64)
    if pseudo.shape != (4, 4) or not np.all(np.isfinite(pseudo)):
        raise SimulationError("the payload's pseudo-inertia must be a finite 4 x 4 matrix")
    if kind == "prismatic":
        smallest = pseudo[3, 3]
        names, kinds, bodies = [f"{name}_slide"], ["prismatic"], [pseudo]
    else:
        # singular as well when the hinges are parallel
        smallest = np.linalg.eigvalsh(directions @ inertia_about_origin(pseudo) @ directions.T)[0]
        names, kinds, bodies = [f"{name}_swing_1", f"{name}_swing_2"], ["revolute"] * 2, [np.zeros((4, 4)), pseudo]
    if not smallest > 1e-12 * max(float(np.trace(pseudo)), 1e-12):
        raise SimulationError(
            f"the payload has no inertia against its {kind} joint: give it a mass, away from hinges that are not parallel"
        )
    taken = [new for new in (name, *names) if new in (*model.frames, *model.joint_names)]
    if taken:
        raise SimulationError(f"{taken[0]!r} is already a joint or frame of the model: choose another name")
    parent, placement = model.frames[frame]
    parents, placements = list(model.parents), list(model.placement)
    for _ in names:
        parents.append(parent)
        placements.append(placement)
        parent, placement = len(parents) - 1, np.eye(4)
    return replace(
        model,
        joint_names=(*model.joint_names, *names),
        kinds=(*model.kinds, *kinds),
        parents=np.array(parents, dtype=np.int64),
        placement=np.array(placements),
        axes=np.concatenate([model.axes, directions]),
        pseudo_inertia=np.concatenate([model.pseudo_inertia, bodies]),
        frames={**model.frames, name: (parent, np.eye(4))},
    )
