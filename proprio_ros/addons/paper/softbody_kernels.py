"""Steps of a soft block and its gripper for Warp: see ``softbody.py``."""

from functools import cache
from typing import Any

import warp as wp

from proprio_ros.sim import runtime
from proprio_ros.sim.energies import LEAST_J
from proprio_ros.sim.joint_kernels import VEC3
from proprio_ros.sim.runtime import FLOAT

runtime.start()

_OF_GRIPPER = ("inertia", "torque_constant", "coulomb", "viscous", "q0", "v0", "gap")
SOFT_PARAMETERS = (*_OF_GRIPPER, "lame_mu", "lame_lambda", "viscosity")
"""Rows of a parameter vector, SI: kg m^2, N m/A, N m, N m s/rad, rad, rad/s, m, Pa, Pa, Pa s (kg, N, m for a slide)."""
INERTIA, TORQUE_CONSTANT, COULOMB, VISCOUS, Q0, V0, GAP, LAME_MU, LAME_LAMBDA, VISCOSITY = range(
    len(SOFT_PARAMETERS)
)
MAT33 = wp.types.matrix(shape=(3, 3), dtype=FLOAT)


@wp.func
def _log_slope(j: FLOAT):
    """d log J / dJ, continued (``energies.log_j``)."""
    least = FLOAT(LEAST_J)
    below = wp.min(j - least, FLOAT(0.0)) / least
    return (FLOAT(1.0) - below) / wp.max(j, least)


@wp.func
def _log(j: FLOAT):
    least = FLOAT(LEAST_J)
    below = wp.min(j - least, FLOAT(0.0)) / least
    return wp.log(wp.max(j, least)) + below - FLOAT(0.5) * below * below


@wp.func
def _edges(
    x: wp.array3d(dtype=VEC3),
    w: wp.int32,
    n: wp.int32,
    tets: wp.array2d(dtype=wp.int32),
    t: wp.int32,
):
    """Of a nodal field, from the first corner of a tetrahedron to the others."""
    origin = x[w, n, tets[t, 0]]
    return x[w, n, tets[t, 1]] - origin, x[w, n, tets[t, 2]] - origin, x[w, n, tets[t, 3]] - origin


@cache
def _law_functions(law: str) -> tuple[Any, Any]:
    """j of a tetrahedron, and V P dm^T from its edges and the cell's j: ``energies.py`` for kernels.

    With the edges D now and the inverse dm of those at rest, F = D dm and 6 V det dm = 1. So F dm^T = D G with G = dm dm^T, and
    V cof(F) dm^T = cof(D) / 6, whose columns are cross products of the edges: that saves F.
    """
    linear, compat = law == "linear", law == "warp_compat"

    @wp.func
    def change(
        e1: VEC3,
        e2: VEC3,
        e3: VEC3,
        volume: FLOAT,
        dm: MAT33,
    ):
        if wp.static(linear):
            f = wp.matrix_from_cols(e1, e2, e3) * dm
            return f[0, 0] + f[1, 1] + f[2, 2] - FLOAT(2.0)
        else:
            return wp.dot(e1, wp.cross(e2, e3)) / (FLOAT(6.0) * volume)

    @wp.func
    def pull(
        e1: VEC3,
        e2: VEC3,
        e3: VEC3,
        rates: MAT33,
        cell_j: FLOAT,
        volume: FLOAT,
        dm: MAT33,
        gram: MAT33,
        mu: FLOAT,
        lam: FLOAT,
        eta: FLOAT,
    ):
        one = FLOAT(1.0)
        d = wp.matrix_from_cols(e1, e2, e3)
        if wp.static(linear):
            f = d * dm
            side = wp.transpose(f * (mu * volume))
            spherical = volume * (lam * (cell_j - one) - FLOAT(2.0) * mu)
            return (
                (volume * (mu * d + eta * rates)) * gram
                + side * wp.transpose(dm)
                + spherical * wp.transpose(dm)
            )
        else:
            c1 = wp.cross(e2, e3)
            j = wp.dot(e1, c1) / (FLOAT(6.0) * volume)
            push = lam * (cell_j - one)
            shear = mu
            if wp.static(law == "log"):
                push = lam * _log(cell_j) * _log_slope(cell_j) - mu * _log_slope(j)
            if wp.static(law == "smith"):
                push = lam * (cell_j - one) + mu * (j - FLOAT(2.0))
            if wp.static(compat):
                push = lam * (cell_j - one) - FLOAT(0.75) * mu
                shear = mu * (one - one / (wp.ddot(d, d * gram) + one))
            cofactor = wp.matrix_from_cols(
                c1,
                wp.cross(e3, e1),
                wp.cross(e1, e2),
            )
            return (volume * (shear * d + eta * rates)) * gram + (push / FLOAT(6.0)) * cofactor

    return change, pull


@cache
def frame_kernel(law: str, bonded: bool) -> Any:
    """All steps of a segment; thread = world."""
    change, pull = _law_functions(law)

    @wp.kernel(module="unique")
    def frame(
        # Block:
        tets: wp.array2d(dtype=wp.int32),
        cells: wp.array(dtype=wp.int32),
        shares: wp.array(dtype=FLOAT),
        volumes: wp.array(dtype=FLOAT),
        inverses: wp.array(dtype=MAT33),
        grams: wp.array(dtype=MAT33),
        masses: wp.array(dtype=FLOAT),
        sides: wp.array(dtype=FLOAT),
        end_nodes: wp.array(dtype=wp.int32),
        # Gripper and run: half length, travel, smoothing velocity, faces' mass, step
        constants: wp.array(dtype=FLOAT),
        current_in: wp.array(dtype=FLOAT),
        # World data in:
        p_in: wp.array2d(dtype=FLOAT),
        # World data in and out: row 0 is given, one more row for every step
        q: wp.array2d(dtype=FLOAT),
        u: wp.array2d(dtype=FLOAT),
        x: wp.array3d(dtype=VEC3),
        v: wp.array3d(dtype=VEC3),
        # World data out, zero before:
        cell_j: wp.array3d(dtype=FLOAT),
        force: wp.array3d(dtype=VEC3),
        push: wp.array2d(dtype=FLOAT),
    ):
        w = wp.tid()
        half_length = constants[0]
        travel = constants[1]
        smooth = constants[2]
        h = constants[4]
        half = FLOAT(0.5)
        inertia = p_in[w, INERTIA] + FLOAT(0.25) * travel * travel * constants[3]
        torque_constant = p_in[w, TORQUE_CONSTANT]
        coulomb = p_in[w, COULOMB]
        drag = p_in[w, VISCOUS]
        gap = p_in[w, GAP]
        mu = p_in[w, LAME_MU]
        lam = p_in[w, LAME_LAMBDA]
        eta = p_in[w, VISCOSITY]
        for n in range(current_in.shape[0]):
            for t in range(tets.shape[0]):
                e1, e2, e3 = _edges(x, w, n, tets, t)
                wp.atomic_add(
                    cell_j, w, n, cells[t], shares[t] * change(e1, e2, e3, volumes[t], inverses[t])
                )
            for t in range(tets.shape[0]):
                e1, e2, e3 = _edges(x, w, n, tets, t)
                r1, r2, r3 = _edges(v, w, n, tets, t)
                rates = wp.matrix_from_cols(r1, r2, r3)
                j = cell_j[w, n, cells[t]]
                inward = pull(
                    e1,
                    e2,
                    e3,
                    rates,
                    j,
                    volumes[t],
                    inverses[t],
                    grams[t],
                    mu,
                    lam,
                    eta,
                )
                f1 = VEC3(
                    inward[0, 0],
                    inward[1, 0],
                    inward[2, 0],
                )
                f2 = VEC3(
                    inward[0, 1],
                    inward[1, 1],
                    inward[2, 1],
                )
                f3 = VEC3(
                    inward[0, 2],
                    inward[1, 2],
                    inward[2, 2],
                )
                wp.atomic_sub(force, w, n, tets[t, 1], f1)
                wp.atomic_sub(force, w, n, tets[t, 2], f2)
                wp.atomic_sub(force, w, n, tets[t, 3], f3)
                wp.atomic_add(
                    force,
                    w,
                    n,
                    tets[t, 0],
                    f1 + f2 + f3,
                )
            for k in range(end_nodes.shape[0]):
                i = end_nodes[k]
                outward = force[w, n, i]
                wp.atomic_add(push, w, n, half * sides[i] * outward[0])
            turn = u[w, n]
            pressing = wp.float64(0.0)
            if travel * q[w, n] - gap > FLOAT(0.0):
                pressing = push[w, n]
            torque = (
                torque_constant * current_in[n] - coulomb * wp.tanh(turn / smooth) - drag * turn
            )
            u[w, n + 1] = turn + h * (torque - travel * pressing) / inertia
            q[w, n + 1] = q[w, n] + h * u[w, n + 1]
            for i in range(masses.shape[0]):
                side = sides[i]
                place = x[w, n, i]
                speed = v[w, n, i] + (h / masses[i]) * force[w, n, i]
                moved = place + h * speed
                if side != FLOAT(0.0):
                    squeeze = travel * q[w, n + 1] - gap
                    at = side * half_length
                    along = FLOAT(0.0)
                    if squeeze > FLOAT(0.0):
                        at = side * (half_length - half * squeeze)
                        along = -half * side * travel * u[w, n + 1]
                    if wp.static(bonded):
                        v[w, n + 1, i] = VEC3(
                            along,
                            FLOAT(0.0),
                            FLOAT(0.0),
                        )
                        x[w, n + 1, i] = VEC3(
                            at,
                            place[1],
                            place[2],
                        )
                    else:
                        v[w, n + 1, i] = VEC3(
                            along,
                            speed[1],
                            speed[2],
                        )
                        x[w, n + 1, i] = VEC3(
                            at,
                            moved[1],
                            moved[2],
                        )
                else:
                    v[w, n + 1, i] = speed
                    x[w, n + 1, i] = moved

    return frame
