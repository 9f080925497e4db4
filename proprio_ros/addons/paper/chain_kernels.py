"""A chain's dynamics for Warp, unrolled over the joints of each tree, and its walk through time: see ``chain.py``.

The walk here is that of ``rollout_kernels.py`` written out for this law, because a thread here takes a block of directions of a
world, whose parameters it reads from rows that blocks share.
"""

from functools import cache
from types import SimpleNamespace
from typing import Any

import warp as wp

from proprio_ros.sim import runtime
from proprio_ros.sim.joint_kernels import BACK_EMF, RESISTANCE, VEC3, VOLTAGE, limited_current
from proprio_ros.sim.rollout_kernels import TIME_EPS
from proprio_ros.sim.runtime import FLOAT

JOINT_PARAMETERS = (
    "torque_constant",
    "coulomb",
    "viscous",
    "load_friction",
    "armature",
    "stiffness",
)
"""Of each joint, SI: N m/A, N m, N m s/rad, 1, kg m^2, N m/rad (N/A, N, N s/m, 1, kg, N/m for a slide)."""

TORQUE_CONSTANT, COULOMB, VISCOUS, LOAD_FRICTION, ARMATURE, STIFFNESS = range(len(JOINT_PARAMETERS))
"""Of n columns each, one for each joint."""
INERTIAL = 10

runtime.start()

TABLE = wp.array2d(dtype=FLOAT)
VEC6 = wp.types.vector(length=6, dtype=FLOAT)
VEC10 = wp.types.vector(length=10, dtype=FLOAT)
VEC12 = wp.types.vector(length=12, dtype=FLOAT)
MAT33 = wp.types.matrix(shape=(3, 3), dtype=FLOAT)


@wp.struct
class ChainData:
    """What no parameter changes.

    A joint's rotation to its parent is turn[0] + sin(q) turn[1] + cos(q) turn[2], its offset shift[0] + q shift[1].
    """

    turn: wp.array2d(dtype=MAT33)
    shift: wp.array2d(dtype=VEC3)
    axis: wp.array(dtype=VEC3)
    revolute: wp.array(dtype=FLOAT)
    gravity: VEC3
    friction_velocity: wp.array(dtype=FLOAT)
    supply: TABLE


@wp.func
def _rotation(pose: VEC12):
    return MAT33(
        pose[0],
        pose[1],
        pose[2],
        pose[3],
        pose[4],
        pose[5],
        pose[6],
        pose[7],
        pose[8],
    )


@wp.func
def _origin(pose: VEC12):
    return VEC3(pose[9], pose[10], pose[11])


@wp.func
def _pose(r: MAT33, o: VEC3):
    return VEC12(
        r[0, 0],
        r[0, 1],
        r[0, 2],
        r[1, 0],
        r[1, 1],
        r[1, 2],
        r[2, 0],
        r[2, 1],
        r[2, 2],
        o[0],
        o[1],
        o[2],
    )


@wp.func
def _seen_from_base(m: FLOAT, h: VEC3, j: MAT33, pose: VEC12):
    """Ten inertial parameters about the base's origin, from those about a body's frame."""
    r = _rotation(pose)
    o = _origin(pose)
    turned = r * h
    jr = r * j * wp.transpose(r)
    g = turned + FLOAT(0.5) * m * o
    moved = turned + m * o
    two = FLOAT(2.0)
    return VEC10(
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
def _momentum(pi: VEC10, x: VEC6):
    """Spatial inertia times a motion: the wrench (moment, force)."""
    w = wp.spatial_top(x)
    u = wp.spatial_bottom(x)
    h = VEC3(pi[1], pi[2], pi[3])
    turning = VEC3(
        pi[4] * w[0] + pi[7] * w[1] + pi[8] * w[2],
        pi[7] * w[0] + pi[5] * w[1] + pi[9] * w[2],
        pi[8] * w[0] + pi[9] * w[1] + pi[6] * w[2],
    )
    moment = turning + wp.cross(h, u)
    force = pi[0] * u + wp.cross(w, h)
    return VEC6(
        moment[0],
        moment[1],
        moment[2],
        force[0],
        force[1],
        force[2],
    )


@cache
def dynamics(parents: tuple[int, ...], directions: int = 1) -> SimpleNamespace:
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
    def poses(fixed: ChainData, q: vec):
        result = rows12()
        for i in range(n):
            turn = (
                fixed.turn[i, 0] + wp.sin(q[i]) * fixed.turn[i, 1] + wp.cos(q[i]) * fixed.turn[i, 2]
            )
            shift = fixed.shift[i, 0] + q[i] * fixed.shift[i, 1]
            if wp.static(parents[i] < 0):
                result[i] = _pose(turn, shift)
            else:
                parent = result[wp.static(parents[i])]
                up = _rotation(parent)
                result[i] = _pose(up * turn, _origin(parent) + up * shift)
        return result

    @wp.func
    def screws(fixed: ChainData, x: rows12):
        result = rows6()
        for i in range(n):
            z = _rotation(x[i]) * fixed.axis[i]
            turns = fixed.revolute[i]
            w = turns * z
            u = wp.cross(_origin(x[i]), w) + (FLOAT(1.0) - turns) * z
            result[i] = VEC6(
                w[0],
                w[1],
                w[2],
                u[0],
                u[1],
                u[2],
            )
        return result

    @wp.func
    def at_base(
        p: TABLE,
        w: wp.int32,
        i: wp.int32,
        pose: VEC12,
    ):
        c = pi_start + 10 * i
        h = VEC3(
            p[w, c + 1],
            p[w, c + 2],
            p[w, c + 3],
        )
        j = MAT33(
            p[w, c + 4], p[w, c + 7], p[w, c + 8],
            p[w, c + 7], p[w, c + 5], p[w, c + 9],
            p[w, c + 8], p[w, c + 9], p[w, c + 6],
        )  # fmt: skip
        return _seen_from_base(p[w, c], h, j, pose)

    @wp.func
    def inertias(p: TABLE, w: wp.int32, x: rows12):
        result = rows10()
        for i in range(n):
            result[i] = at_base(p, w, i, x[i])
        return result

    @wp.func
    def heavier(dp: TABLE, row: wp.int32, i: wp.int32):
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
    def inverse_dynamics(
        fixed: ChainData,
        s: rows6,
        inertia: rows10,
        vel: rows6,
        v: vec,
        a: vec,
    ):
        g = fixed.gravity
        acc = rows6()
        force = rows6()
        for i in range(n):
            own = a[i] * s[i] + v[i] * wp.spatial_cross(vel[i], s[i])
            if wp.static(parents[i] < 0):
                acc[i] = own + VEC6(FLOAT(0.0), FLOAT(0.0), FLOAT(0.0), -g[0], -g[1], -g[2])
            else:
                acc[i] = own + acc[wp.static(parents[i])]
            force[i] = _momentum(inertia[i], acc[i]) + wp.spatial_cross_dual(
                vel[i], _momentum(inertia[i], vel[i])
            )
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
    def solve(root: square, b: vec):
        y = vec()
        for i in range(n):
            rest = b[i]
            for k in range(n):
                if wp.static(k < i):
                    rest = rest - root[i, k] * y[k]
            y[i] = rest * root[i, i]
        x = vec()
        for m in range(n):
            i = wp.static(n - 1 - m)
            rest = y[i]
            for k in range(n):
                if wp.static(k > n - 1 - m):
                    rest = rest - root[k, i] * x[k]
            x[i] = rest * root[i, i]
        return x

    @wp.func
    def torques(
        fixed: ChainData,
        p: TABLE,
        w: wp.int32,
        q: vec,
        v: vec,
        command: vec,
    ):
        result = vec()
        for i in range(n):
            supply = fixed.supply
            current, _slope = limited_current(
                command[i], v[i], supply[i, VOLTAGE], supply[i, BACK_EMF], supply[i, RESISTANCE]
            )
            motor = p[w, TORQUE_CONSTANT * n + i] * current
            dry = (p[w, COULOMB * n + i] + p[w, LOAD_FRICTION * n + i] * wp.abs(motor)) * wp.tanh(
                v[i] / fixed.friction_velocity[i]
            )
            result[i] = motor - dry - p[w, VISCOUS * n + i] * v[i] - p[w, STIFFNESS * n + i] * q[i]
        return result

    @wp.func
    def solved(
        fixed: ChainData,
        p: TABLE,
        w: wp.int32,
        q: vec,
        v: vec,
        command: vec,
    ):
        """Poses, screws, inertias and velocities, the factor of the mass matrix, and the acceleration."""
        x = poses(fixed, q)
        s = screws(fixed, x)
        inertia = inertias(p, w, x)
        vel = velocities(s, v)
        bias = inverse_dynamics(fixed, s, inertia, vel, v, vec())
        armature = vec()
        for i in range(n):
            armature[i] = p[w, ARMATURE * n + i]
        root = factor(mass_matrix(s, inertia) + wp.diag(armature))
        return (
            x,
            s,
            inertia,
            vel,
            root,
            solve(
                root,
                torques(fixed, p, w, q, v, command) - bias,
            ),
        )

    @wp.func
    def linearised(
        fixed: ChainData,
        p: TABLE,
        w: wp.int32,
        dp: TABLE,
        row: wp.int32,
        count: wp.int32,
        q: vec,
        v: vec,
        dq: block,
        dv: block,
        command: vec,
    ):
        """The acceleration and its changes along directions row, row + 1, ...; never taped."""
        x, s, inertia, vel, root, a = solved(
            fixed,
            p,
            w,
            q,
            v,
            command,
        )

        # what all directions share
        g = fixed.gravity
        acc = rows6()
        momentum = rows6()
        force = rows6()
        turn = rows6()  # V_i x S_i
        lift = rows6()  # A_p x S_i
        for i in range(n):
            below = VEC6(
                FLOAT(0.0),
                FLOAT(0.0),
                FLOAT(0.0),
                -g[0],
                -g[1],
                -g[2],
            )
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
                force[wp.static(parents[n - 1 - k])] = (
                    force[wp.static(parents[n - 1 - k])] + force[i]
                )
            supply = fixed.supply
            current, slope = limited_current(
                command[i], v[i], supply[i, VOLTAGE], supply[i, BACK_EMF], supply[i, RESISTANCE]
            )
            motor = p[w, TORQUE_CONSTANT * n + i] * current
            side[i] = wp.tanh(v[i] / fixed.friction_velocity[i])
            load[i] = wp.abs(motor)
            # d motor / d(.) enters the friction through |motor| as well
            gain = FLOAT(1.0) - p[w, LOAD_FRICTION * n + i] * wp.sign(motor) * side[i]
            steep = (
                p[w, COULOMB * n + i] + p[w, LOAD_FRICTION * n + i] * load[i]
            ) / fixed.friction_velocity[i]
            by_constant[i] = gain * current
            by_v[i] = (
                gain * p[w, TORQUE_CONSTANT * n + i] * slope
                - steep * (FLOAT(1.0) - side[i] * side[i])
                - p[w, VISCOUS * n + i]
            )

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
                    own_acc[i]
                    + dq[d, i] * lift[i]
                    + dv[d, i] * turn[i]
                    + v[i] * wp.spatial_cross(own_vel[i], s[i])
                )
                own_momentum = _momentum(inertia[i], own_vel[i])
                own_force[i] = _momentum(inertia[i], own_acc[i]) + wp.spatial_cross_dual(
                    own_vel[i], momentum[i]
                )
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
                    own_force[b] = (
                        own_force[b]
                        + own_force[i]
                        + dq[d, i] * wp.spatial_cross_dual(s[i], force[i])
                    )
                rest[i] = (
                    by_constant[i] * dp[r, TORQUE_CONSTANT * n + i]
                    + by_v[i] * dv[d, i]
                    - p[w, STIFFNESS * n + i] * dq[d, i]
                    - side[i] * dp[r, COULOMB * n + i]
                    - v[i] * dp[r, VISCOUS * n + i]
                    - load[i] * side[i] * dp[r, LOAD_FRICTION * n + i]
                    - a[i] * dp[r, ARMATURE * n + i]
                    - q[i] * dp[r, STIFFNESS * n + i]
                    - wp.dot(s[i], own_force[i])
                )
            da[d] = solve(root, rest)
        return a, da

    @wp.func
    def sticking(
        fixed: ChainData,
        p: TABLE,
        w: wp.int32,
        v: vec,
        a: vec,
        step: FLOAT,
    ):
        """Whether a joint with dry friction is, or may come within a step, near standstill."""
        result = wp.bool(False)
        for i in range(n):
            if p[w, COULOMB * n + i] > FLOAT(0.0) or p[w, LOAD_FRICTION * n + i] > FLOAT(0.0):
                if wp.abs(v[i]) < FLOAT(20.0) * fixed.friction_velocity[i] + wp.abs(a[i]) * step:
                    result = wp.bool(True)
        return result

    bodies = {"poses": poses, "screws": screws, "inertias": inertias, "velocities": velocities}
    terms = {"mass_matrix": mass_matrix, "inverse_dynamics": inverse_dynamics}
    return SimpleNamespace(
        **bodies, **terms, solved=solved, linearised=linearised, sticking=sticking
    )


def _way_to_base(
    parents: tuple[int, ...],
    joint: int,
) -> tuple[int, ...]:
    """A joint and all those that carry it."""
    way = []
    while joint >= 0:
        way.append(joint)
        joint = parents[joint]
    return tuple(way)


def module_of(parents: tuple[int, ...], purpose: str) -> Any:
    """A Warp module of its own for each tree.

    What unrolled loops select statically from ``parents`` is no part of Warp's hash of the source, so two trees in one module
    would silently share the first one's binary, also across processes through the kernel cache. The name keeps them apart.
    """
    return wp.get_module(
        "proprio_ros.addons.paper.chain."
        + "_".join(str(parent + 1) for parent in parents)
        + "."
        + purpose
    )


@cache
def forward_kernel(
    parents: tuple[int, ...],
    integrator: str,
    directions: int,
) -> Any:
    """Rollout with exact forward sensitivities; thread = (world, block of so many directions)."""
    n = len(parents)
    delay_column = (len(JOINT_PARAMETERS) + INERTIAL) * n
    vec = wp.types.vector(length=n, dtype=FLOAT)
    block = wp.types.matrix(shape=(directions, n), dtype=FLOAT)
    instants = wp.types.vector(length=directions, dtype=FLOAT)
    tree = dynamics(parents, directions)
    linearised, sticking = tree.linearised, tree.sticking
    rk4 = integrator == "rk4"

    @wp.kernel(
        module=module_of(parents, f"forward_{integrator}_{directions}"), enable_backward=False
    )
    def kernel(
        # Run data:
        fixed: ChainData,
        sample_times: wp.array(dtype=FLOAT),
        input_times: wp.array(dtype=FLOAT),
        input_current: wp.array(dtype=vec),
        coarse: FLOAT,
        fine: FLOAT,
        # World data in: parameters (W, P), directions (W * D, P), D
        p_in: TABLE,
        dp_in: TABLE,
        per_world: wp.int32,
        # World data out: q and v (W, T), dq (W * D, T)
        q_out: wp.array2d(dtype=vec),
        v_out: wp.array2d(dtype=vec),
        dq_out: wp.array2d(dtype=vec),
    ):
        w, first = wp.tid()
        first = first * wp.static(directions)
        row = w * per_world + first
        count = wp.min(wp.static(directions), per_world - first)
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
        for k in range(sample_times.shape[0]):
            goal = sample_times[k] - delay
            if goal <= FLOAT(0.0):
                if first == 0:
                    q_out[w, k] = q + goal * v
                    v_out[w, k] = v
                for d in range(count):
                    dq_out[row + d, k] = dq[d] + goal * dv[d] + d_goal[d] * v
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
                        a1, da1 = linearised(
                            fixed, p_in, w, dp_in, row, count, q, v, dq, dv, command
                        )
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
                        if wp.static(rk4):
                            q2 = q + half * h * v
                            v2 = v + half * h * a1
                            dq2 = dq + half * (h * dv + wp.outer(dh, v))
                            dv2 = dv + half * (h * da1 + wp.outer(dh, a1))
                            a2, da2 = linearised(
                                fixed, p_in, w, dp_in, row, count, q2, v2, dq2, dv2, command
                            )
                            q3 = q + half * h * v2
                            v3 = v + half * h * a2
                            dq3 = dq + half * (h * dv2 + wp.outer(dh, v2))
                            dv3 = dv + half * (h * da2 + wp.outer(dh, a2))
                            a3, da3 = linearised(
                                fixed, p_in, w, dp_in, row, count, q3, v3, dq3, dv3, command
                            )
                            q4 = q + h * v3
                            v4 = v + h * a3
                            dq4 = dq + h * dv3 + wp.outer(dh, v3)
                            dv4 = dv + h * da3 + wp.outer(dh, a3)
                            a4, da4 = linearised(
                                fixed, p_in, w, dp_in, row, count, q4, v4, dq4, dv4, command
                            )
                            mean_v = sixth * (v + two * v2 + two * v3 + v4)
                            mean_a = sixth * (a1 + two * a2 + two * a3 + a4)
                            dq = (
                                dq
                                + sixth * h * (dv + two * dv2 + two * dv3 + dv4)
                                + wp.outer(dh, mean_v)
                            )
                            dv = (
                                dv
                                + sixth * h * (da1 + two * da2 + two * da3 + da4)
                                + wp.outer(dh, mean_a)
                            )
                            q = q + h * mean_v
                            v = v + h * mean_a
                        else:
                            v = v + h * a1
                            dv = dv + h * da1 + wp.outer(dh, a1)
                            q = q + h * v
                            dq = dq + h * dv + wp.outer(dh, v)
                        t = t + h
                        if last:
                            t = end
                            dt = d_end
                    if not arrived:
                        segment += 1
                if first == 0:
                    q_out[w, k] = q
                    v_out[w, k] = v
                for d in range(count):
                    dq_out[row + d, k] = dq[d]

    return kernel
