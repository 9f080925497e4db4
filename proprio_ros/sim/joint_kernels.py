"""The law of one driven joint for Warp: what ``joint.py`` says, with its exact change along any direction."""

from functools import cache
from typing import Any

import warp as wp

from proprio_ros.sim.rollout_kernels import Law
from proprio_ros.sim.runtime import FLOAT, FLOATS

PARAMETERS = (
    "inertia",
    "gravity_cos",
    "gravity_sin",
    "gravity_constant",
    "torque_constant",
    "coulomb",
    "viscous",
    "load_friction",
    "delay",
    "q0",
    "v0",
    "carried",
    "stribeck",
    "stribeck_velocity",
)
"""Rows of a parameter vector, which `joint.INDEX` has by name.

SI: kg m^2, N m (three), N m/A, N m, N m s/rad, 1, s, rad, rad/s, kg, 1, rad/s (kg, N, m for a slide).
"""
(
    INERTIA, GRAVITY_COS, GRAVITY_SIN, GRAVITY_CONSTANT, TORQUE_CONSTANT, COULOMB, VISCOUS, LOAD_FRICTION, DELAY, Q0, V0, CARRIED,
    STRIBECK, STRIBECK_VELOCITY,
) = range(len(PARAMETERS))  # fmt: skip

VOLTAGE, BACK_EMF, RESISTANCE, FRICTION_VELOCITY = range(4)  # columns of ``JointData.constants``
CURRENT, LOAD, LOAD_PER_KG = range(3)  # entries of the input

VEC2 = wp.types.vector(length=2, dtype=FLOAT)
VEC3 = wp.types.vector(length=3, dtype=FLOAT)


@wp.struct
class JointData:
    """What is known about the runs: a row of constants each."""

    constants: FLOATS


@wp.func
def limited_current(
    command: FLOAT,
    v: FLOAT,
    volt: FLOAT,
    emf: FLOAT,
    ohm: FLOAT,
):
    """The current that flows, and its derivative by the velocity.

    Args:
        command: Current that is asked for [A].
        v: Velocity of the joint [rad/s].
        volt: Of the supply [V]; 0: no limit.
        emf: Voltage per velocity [V s/rad].
        ohm: Resistance of the windings [ohm].
    """
    i = command
    slope = FLOAT(0.0)
    if volt > FLOAT(0.0):
        high = (volt - emf * v) / ohm
        low = -(volt + emf * v) / ohm
        if command > FLOAT(0.0) and command > high:
            i = wp.max(high, FLOAT(0.0))
            if high > FLOAT(0.0):
                slope = -emf / ohm
        if command < FLOAT(0.0) and command < low:
            i = wp.min(low, FLOAT(0.0))
            if low < FLOAT(0.0):
                slope = -emf / ohm
    return i, slope


@cache
def linearised_acceleration(directions: int, stribeck: bool) -> Any:
    """The joint's acceleration and its exact change along ``directions`` tangents, as a Warp function.

    Equation (1) of the paper for one joint, in the symbols of how_it_works.md, with tau = k_t i:

        J a = tau - (f_c + f_l |tau|) (1 + s exp(-(v / w)^2)) tanh(v / v_s) - f_v v - g_a cos q - g_b sin q - load

    Without ``stribeck`` the rise s towards standstill is left out at compile time: a robot without it does not pay for the
    exponential.
    """
    vec = wp.types.vector(length=directions, dtype=FLOAT)

    @wp.func
    def linearised(
        q: FLOAT,
        v: FLOAT,
        dq: vec,
        dv: vec,
        command: FLOAT,
        load: FLOAT,
        d_load: vec,
        p: FLOATS,
        dp: wp.array2d(dtype=vec),
        w: wp.int32,
        constants: FLOATS,
        r: wp.int32,
    ):
        """Acceleration [rad/s^2] and its tangents.

        Args:
            q: Position [rad].
            v: Velocity [rad/s].
            dq: Tangents of the position.
            dv: Of the velocity.
            command: Current [A].
            load: Torque that neither angle nor speed changes [N m].
            d_load: Its tangents.
            p: Parameters of each world, shape (W, P), in the order of `INDEX`.
            dp: Their derivatives by the directions, shape (W, P).
            w: Row of the world.
            constants: Of the runs, a row each.
            r: Row of the run.
        """
        current, current_by_v = limited_current(
            command, v, constants[r, VOLTAGE], constants[r, BACK_EMF], constants[r, RESISTANCE]
        )
        smoothing = constants[r, FRICTION_VELOCITY]
        gravity_cos = p[w, GRAVITY_COS]
        gravity_sin = p[w, GRAVITY_SIN]
        torque_constant = p[w, TORQUE_CONSTANT]
        viscous = p[w, VISCOUS]
        load_friction = p[w, LOAD_FRICTION]

        motor = torque_constant * current
        motor_size = wp.abs(motor)
        dry = p[w, COULOMB] + load_friction * motor_size
        side = wp.tanh(v / smoothing)
        level = FLOAT(1.0)
        if wp.static(stribeck):
            rise = p[w, STRIBECK]
            width = p[w, STRIBECK_VELOCITY]
            slow = v / width
            bump = wp.exp(-slow * slow)
            level = FLOAT(1.0) + rise * bump
        c = wp.cos(q)
        s = wp.sin(q)
        inverse = FLOAT(1.0) / p[w, INERTIA]
        a = (
            motor - dry * level * side - viscous * v - gravity_cos * c - gravity_sin * s - load
        ) * inverse

        # the motor's torque enters the friction through its size as well
        by_motor = FLOAT(1.0) - load_friction * level * wp.sign(motor) * side
        by_q = gravity_cos * s - gravity_sin * c
        by_v = (
            by_motor * torque_constant * current_by_v
            - dry * level * (FLOAT(1.0) - side * side) / smoothing
            - viscous
        )
        if wp.static(stribeck):
            by_v = by_v + FLOAT(2.0) * dry * rise * bump * slow / width * side
        change = by_q * dq + by_v * dv + (by_motor * current) * dp[w, TORQUE_CONSTANT]
        change = change - (level * side) * dp[w, COULOMB] - v * dp[w, VISCOUS]
        change = change - (motor_size * level * side) * dp[w, LOAD_FRICTION]
        if wp.static(stribeck):
            change = change - (dry * bump * side) * dp[w, STRIBECK]
            narrower = FLOAT(2.0) * dry * rise * bump * slow * slow / width * side
            change = change - narrower * dp[w, STRIBECK_VELOCITY]
        change = change - c * dp[w, GRAVITY_COS] - s * dp[w, GRAVITY_SIN] - d_load
        change = change - a * dp[w, INERTIA]
        return a, inverse * change

    return linearised


@cache
def standstill(state: Any, data_type: Any) -> Any:
    """Whether a joint is, or may come within a step, near standstill, as a Warp function of a state that begins with q and v."""

    @wp.func
    def still(
        y: state,
        k: state,
        data: data_type,
        r: wp.int32,
        step: FLOAT,
    ):
        """Whether the joint is, or may come within a step, near standstill.

        Args:
            y: State.
            k: What it changes by.
            data: Of the runs.
            r: Row of the run.
            step: Of time [s].
        """
        return (
            wp.abs(y[1]) < FLOAT(20.0) * data.constants[r, FRICTION_VELOCITY] + wp.abs(k[1]) * step
        )

    return still


def one_joint_law(directions: int, data_type: Any, rates: Any) -> Law:
    """The law of a state (q, v), whatever its rates.

    Args:
        directions: How many tangents are carried.
        data_type: Of what is known about the runs.
        rates: Warp function of what a state changes by.
    """
    vec = wp.types.vector(length=directions, dtype=FLOAT)
    mat = wp.types.matrix(shape=(2, directions), dtype=FLOAT)

    @wp.struct
    class Out:
        q: FLOATS
        v: FLOATS
        dq: wp.array2d(dtype=vec)

    @wp.func
    def start(
        p: FLOATS,
        dp: wp.array2d(dtype=vec),
        w: wp.int32,
        data: data_type,
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
        return VEC2(p[w, Q0], p[w, V0]), wp.matrix_from_rows(
            dp[w, Q0],
            dp[w, V0],
        )

    @wp.func
    def moved(
        y: VEC2,
        dy: mat,
        z: VEC2,
        dz: mat,
        k: VEC2,
        dk: mat,
        data: data_type,
        r: wp.int32,
    ):
        """What the state z changes by, as a state.

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
        return VEC2(z[1], k[1]), wp.matrix_from_rows(
            dz[1],
            dk[1],
        )

    @wp.func
    def record(
        out: Out,
        w: wp.int32,
        k: wp.int32,
        y: VEC2,
        dy: mat,
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

    return Law(
        directions,
        VEC2,
        VEC3,
        mat,
        data_type,
        Out,
        DELAY,
        start,
        rates,
        moved,
        standstill(VEC2, data_type),
        record,
    )


@cache
def joint_law(directions: int, stribeck: bool) -> Law:
    """One joint with nothing that moves by itself in the hand."""
    vec = wp.types.vector(length=directions, dtype=FLOAT)
    mat = wp.types.matrix(shape=(2, directions), dtype=FLOAT)
    linearised = linearised_acceleration(directions, stribeck)

    @wp.func
    def rates(
        y: VEC2,
        dy: mat,
        u: VEC3,
        p: FLOATS,
        dp: wp.array2d(dtype=vec),
        w: wp.int32,
        data: JointData,
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
        load = p[w, GRAVITY_CONSTANT] + u[LOAD] + p[w, CARRIED] * u[LOAD_PER_KG]
        d_load = dp[w, GRAVITY_CONSTANT] + u[LOAD_PER_KG] * dp[w, CARRIED]
        a, da = linearised(
            y[0], y[1], dy[0], dy[1], u[CURRENT], load, d_load, p, dp, w, data.constants, r
        )
        return VEC2(y[1], a), wp.matrix_from_rows(dy[1], da)

    return one_joint_law(directions, JointData, rates)
