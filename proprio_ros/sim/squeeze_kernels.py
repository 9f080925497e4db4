"""The law of one joint with a soft block between the fingers, for Warp: what ``squeeze.py`` says."""

from functools import cache

import warp as wp

from proprio_ros.sim.joint_kernels import (
    CARRIED,
    CURRENT,
    FRICTION_VELOCITY,
    GRAVITY_CONSTANT,
    LOAD,
    LOAD_PER_KG,
    PARAMETERS,
    VEC2,
    VEC3,
    linearised_acceleration,
    one_joint_law,
)
from proprio_ros.sim.response_kernels import VEC4, tabulated
from proprio_ros.sim.rollout_kernels import Law
from proprio_ros.sim.runtime import FLOAT, FLOATS

BLOCK_TERMS = ("youngs_modulus", "poissons_ratio", "block_viscosity", "gap", "block_loss")
"""What a block adds to the parameters of ``joint.py``: Pa, 1, Pa s, m, 1."""
SQUEEZE_PARAMETERS = (*PARAMETERS, *BLOCK_TERMS)
YOUNGS_MODULUS, POISSONS_RATIO, BLOCK_VISCOSITY, GAP, BLOCK_LOSS = range(
    len(PARAMETERS), len(SQUEEZE_PARAMETERS)
)
LENGTH, AREA, TRAVEL, TABLE, BEND_2, BEND_3 = range(6)  # columns of ``SqueezeData.block``
# the speed over which a block turns from squeezed to let go, over that of dry friction
SLOWER = 10.0
RAMP = 1e-3  # s_r: relative squeeze over which the viscosity sets in


@wp.struct
class SqueezeData:
    """What is known about the runs, and the tables of the blocks."""

    constants: FLOATS
    block: FLOATS
    grid: wp.array(dtype=FLOAT)
    nodes: wp.array3d(dtype=VEC4)


@wp.func
def excitation_of_block(
    q: FLOAT,
    v: FLOAT,
    p: FLOATS,
    world: wp.int32,
    data: SqueezeData,
    run: wp.int32,
):
    """Load of the block on the joint, and its derivatives: by q and v, by E, nu, eta and gap, and by the loss.

    Args:
        q: Position of the joint [rad].
        v: Its velocity [rad/s].
        p: Parameters of each world, shape (W, P).
        world: Row of the world.
        data: Of the runs.
        run: Row of the run.
    """
    zero = FLOAT(0.0)
    block = data.block
    length = block[run, LENGTH]
    area = block[run, AREA]
    closed = q * (block[run, TRAVEL] + q * (block[run, BEND_2] + q * block[run, BEND_3]))
    travel = block[run, TRAVEL] + q * (
        FLOAT(2.0) * block[run, BEND_2] + FLOAT(3.0) * q * block[run, BEND_3]
    )
    bend = FLOAT(2.0) * block[run, BEND_2] + FLOAT(6.0) * q * block[run, BEND_3]
    s = (closed - p[world, GAP]) / length
    load = zero
    by_q = zero
    by_v = zero
    by_p = VEC4()
    by_loss = zero
    if s > zero:
        modulus = p[world, YOUNGS_MODULUS]
        eta = p[world, BLOCK_VISCOSITY]
        phi, by_s, by_nu = tabulated(
            s, p[world, POISSONS_RATIO], wp.int32(block[run, TABLE]), data.grid, data.nodes
        )
        rate = travel * v / length
        ramp = s / FLOAT(RAMP)
        rise = FLOAT(1.0) / FLOAT(RAMP)
        if ramp > FLOAT(1.0):
            ramp = FLOAT(1.0)
            rise = zero
        # what is given back while it is let go, over what it took to squeeze it
        loss = p[world, BLOCK_LOSS]
        smoothing = FLOAT(SLOWER) * data.constants[run, FRICTION_VELOCITY]
        side = wp.tanh(wp.sign(travel) * v / smoothing)
        opening = FLOAT(0.5) * (FLOAT(1.0) - side)
        kept = FLOAT(1.0) - loss * opening
        kept_by_v = FLOAT(0.5) * loss * wp.sign(travel) * (FLOAT(1.0) - side * side) / smoothing
        push = area * (modulus * phi * kept + eta * rate * ramp)
        if push > zero:
            load = travel * push
            slope = travel * area * (modulus * by_s * kept + eta * rate * rise) / length
            by_q = slope * travel + bend * (push + travel * area * eta * ramp * v / length)
            by_v = travel * area * (eta * ramp * travel / length + modulus * phi * kept_by_v)
            by_p = VEC4(
                travel * area * phi * kept,
                travel * area * modulus * by_nu * kept,
                travel * area * rate * ramp,
                -slope,
            )
            by_loss = -travel * area * modulus * phi * opening
    return load, by_q, by_v, by_p, by_loss


@cache
def squeeze_law(directions: int, stribeck: bool) -> Law:
    """State (q, v), all but the rates as in ``joint_law``."""
    vec = wp.types.vector(length=directions, dtype=FLOAT)
    mat = wp.types.matrix(shape=(2, directions), dtype=FLOAT)
    joint_acceleration = linearised_acceleration(directions, stribeck)

    @wp.func
    def rates(
        y: VEC2,
        dy: mat,
        u: VEC3,
        p: FLOATS,
        dp: wp.array2d(dtype=vec),
        w: wp.int32,
        data: SqueezeData,
        r: wp.int32,
    ):
        """What a state changes by, with its tangents.

        Args:
            y: Position and velocity.
            dy: Their tangents.
            u: Inputs at this time.
            p: Parameters of each world, shape (W, P), in the order of `INDEX`.
            dp: Their derivatives by the directions, shape (W, P).
            w: Row of the world.
            data: Of the runs.
            r: Row of the run.
        """
        load, by_q, by_v, by_p, by_loss = excitation_of_block(
            y[0],
            y[1],
            p,
            w,
            data,
            r,
        )
        d_load = by_q * dy[0] + by_v * dy[1]
        d_load = d_load + by_p[0] * dp[w, YOUNGS_MODULUS] + by_p[1] * dp[w, POISSONS_RATIO]
        d_load = d_load + by_p[2] * dp[w, BLOCK_VISCOSITY] + by_p[3] * dp[w, GAP]
        d_load = d_load + by_loss * dp[w, BLOCK_LOSS]
        load = p[w, GRAVITY_CONSTANT] + (u[LOAD] + p[w, CARRIED] * u[LOAD_PER_KG]) + load
        d_load = dp[w, GRAVITY_CONSTANT] + u[LOAD_PER_KG] * dp[w, CARRIED] + d_load
        a, da = joint_acceleration(
            y[0], y[1], dy[0], dy[1], u[CURRENT], load, d_load, p, dp, w, data.constants, r
        )
        return VEC2(y[1], a), wp.matrix_from_rows(dy[1], da)

    return one_joint_law(directions, SqueezeData, rates)
