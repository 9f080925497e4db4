"""``response.Response.__call__`` for Warp: the table of a block's force, read in a kernel."""

import warp as wp

from proprio_ros.sim import runtime
from proprio_ros.sim.runtime import FLOAT

runtime.start()
VEC4 = wp.types.vector(length=4, dtype=FLOAT)


@wp.func
def _basis(t: FLOAT):
    """Hermite's cubic polynomials: values at the two nodes, slopes at the two nodes."""
    one = FLOAT(1.0)
    two = FLOAT(2.0)
    r = one - t
    return VEC4(
        (one + two * t) * r * r,
        t * r * r,
        t * t * (FLOAT(3.0) - two * t),
        -t * t * r,
    )


@wp.func
def _basis_slope(t: FLOAT):
    one = FLOAT(1.0)
    six = FLOAT(6.0)
    three = FLOAT(3.0)
    r = one - t
    return VEC4(
        -six * t * r,
        r * (one - three * t),
        six * t * r,
        t * (three * t - FLOAT(2.0)),
    )


@wp.func
def tabulated(
    s: FLOAT,
    nu: FLOAT,
    table: wp.int32,
    grid: wp.array(dtype=FLOAT),
    nodes: wp.array3d(dtype=VEC4),
):
    """phi, dphi/ds and dphi/dnu of one of several tables over the same grid: ``Response.__call__`` for kernels.

    Args:
        s: Squeeze over length.
        nu: Poisson's ratio.
        table: Which one.
        grid: First value and step of each axis.
        nodes: Values and derivatives at the nodes, shape (tables, rows, columns).
    """
    rows = nodes.shape[1] - 1
    columns = nodes.shape[2] - 1
    zero = FLOAT(0.0)
    u = wp.clamp(
        (s - grid[0]) / grid[1],
        zero,
        FLOAT(rows),
    )
    w = wp.clamp(
        (nu - grid[2]) / grid[3],
        zero,
        FLOAT(columns),
    )
    i = wp.min(wp.int32(u), rows - 1)
    j = wp.min(wp.int32(w), columns - 1)
    beyond_s = s - grid[0] - u * grid[1]
    beyond_nu = nu - grid[2] - w * grid[3]
    a = _basis(u - FLOAT(i))
    b = _basis(w - FLOAT(j))
    da = _basis_slope(u - FLOAT(i)) / grid[1]
    db = _basis_slope(w - FLOAT(j)) / grid[3]
    phi = zero
    by_s = zero
    by_nu = zero
    both = zero
    for k in range(2):
        for m in range(2):
            node = nodes[table, i + k, j + m]
            left = node[0] * b[2 * m] + node[2] * b[2 * m + 1]
            right = node[1] * b[2 * m] + node[3] * b[2 * m + 1]
            d_left = node[0] * db[2 * m] + node[2] * db[2 * m + 1]
            d_right = node[1] * db[2 * m] + node[3] * db[2 * m + 1]
            phi = phi + a[2 * k] * left + a[2 * k + 1] * right
            by_s = by_s + da[2 * k] * left + da[2 * k + 1] * right
            by_nu = by_nu + a[2 * k] * d_left + a[2 * k + 1] * d_right
            both = both + da[2 * k] * d_left + da[2 * k + 1] * d_right
    phi = phi + by_s * beyond_s + by_nu * beyond_nu + both * beyond_s * beyond_nu
    return phi, by_s + both * beyond_nu, by_nu + both * beyond_s
