"""A soft block, a launch for tetrahedra and one for nodes, for Warp: what `softness` puts on a tape."""

from __future__ import annotations

import warp as wp

from proprio_ros.addons.paper.softbody_kernels import MAT33, VEC3, _law_functions
from proprio_ros.sim.runtime import FLOAT

_change, _pull = _law_functions("log")


@wp.func
def _edges(
    x: wp.array(dtype=VEC3),
    tets: wp.array2d(dtype=wp.int32),
    t: wp.int32,
):
    origin = x[tets[t, 0]]
    return x[tets[t, 1]] - origin, x[tets[t, 2]] - origin, x[tets[t, 3]] - origin


@wp.kernel(module="unique")
def cell_kernel(
    tets: wp.array2d(dtype=wp.int32),
    cells: wp.array(dtype=wp.int32),
    shares: wp.array(dtype=FLOAT),
    volumes: wp.array(dtype=FLOAT),
    inverses: wp.array(dtype=MAT33),
    x: wp.array(dtype=VEC3),
    cell_j: wp.array(dtype=FLOAT),
):
    t = wp.tid()
    e1, e2, e3 = _edges(x, tets, t)
    wp.atomic_add(
        cell_j,
        cells[t],
        shares[t] * _change(e1, e2, e3, volumes[t], inverses[t]),
    )


@wp.kernel(module="unique")
def force_kernel(
    tets: wp.array2d(dtype=wp.int32),
    cells: wp.array(dtype=wp.int32),
    volumes: wp.array(dtype=FLOAT),
    inverses: wp.array(dtype=MAT33),
    grams: wp.array(dtype=MAT33),
    p: wp.array(dtype=FLOAT),
    x: wp.array(dtype=VEC3),
    v: wp.array(dtype=VEC3),
    cell_j: wp.array(dtype=FLOAT),
    sides: wp.array(dtype=FLOAT),
    force: wp.array(dtype=VEC3),
    push: wp.array(dtype=FLOAT),
):
    t = wp.tid()
    e1, e2, e3 = _edges(x, tets, t)
    r1, r2, r3 = _edges(v, tets, t)
    rates = wp.matrix_from_cols(r1, r2, r3)
    j = cell_j[cells[t]]
    pull = -_pull(
        e1,
        e2,
        e3,
        rates,
        j,
        volumes[t],
        inverses[t],
        grams[t],
        p[7],
        p[8],
        p[9],
    )
    f1 = VEC3(
        pull[0, 0],
        pull[1, 0],
        pull[2, 0],
    )
    f2 = VEC3(
        pull[0, 1],
        pull[1, 1],
        pull[2, 1],
    )
    f3 = VEC3(
        pull[0, 2],
        pull[1, 2],
        pull[2, 2],
    )
    wp.atomic_add(force, tets[t, 1], f1)
    wp.atomic_add(force, tets[t, 2], f2)
    wp.atomic_add(force, tets[t, 3], f3)
    f0 = -(f1 + f2 + f3)
    wp.atomic_add(force, tets[t, 0], f0)
    outward = sides[tets[t, 0]] * f0[0] + sides[tets[t, 1]] * f1[0]
    outward = outward + sides[tets[t, 2]] * f2[0] + sides[tets[t, 3]] * f3[0]
    wp.atomic_add(push, 0, FLOAT(0.5) * outward)


@wp.kernel(module="unique")
def node_kernel(
    masses: wp.array(dtype=FLOAT),
    sides: wp.array(dtype=FLOAT),
    constants: wp.array(dtype=FLOAT),
    current: FLOAT,
    p: wp.array(dtype=FLOAT),
    force: wp.array(dtype=VEC3),
    push: wp.array(dtype=FLOAT),
    q: wp.array(dtype=FLOAT),
    x: wp.array(dtype=VEC3),
    v: wp.array(dtype=VEC3),
    q_out: wp.array(dtype=FLOAT),
    x_out: wp.array(dtype=VEC3),
    v_out: wp.array(dtype=VEC3),
):
    """Nodes, and the gripper (its state is ``q``: coordinate and velocity) as the last of them; bonded faces, in touch."""
    i = wp.tid()
    h = constants[4]
    travel = constants[1]
    half = FLOAT(0.5)
    torque = p[1] * current - p[2] * wp.tanh(q[1] / constants[2]) - p[3] * q[1] - travel * push[0]
    turn = q[1] + h * torque / (p[0] + FLOAT(0.25) * travel * travel * constants[3])
    angle = q[0] + h * turn
    if i == masses.shape[0]:
        q_out[0] = angle
        q_out[1] = turn
    elif sides[i] == FLOAT(0.0):
        speed = v[i] + (h / masses[i]) * force[i]
        v_out[i] = speed
        x_out[i] = x[i] + h * speed
    else:
        x_out[i] = VEC3(
            sides[i] * (constants[0] - half * (travel * angle - p[6])), x[i][1], x[i][2]
        )
        v_out[i] = VEC3(
            -half * sides[i] * travel * turn,
            FLOAT(0.0),
            FLOAT(0.0),
        )
