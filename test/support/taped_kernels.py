"""Rollouts of one joint without tangents, for Warp: what `taped` launches."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import warp as wp

from proprio_ros.sim.joint_kernels import (
    BACK_EMF,
    CARRIED,
    COULOMB,
    CURRENT,
    DELAY,
    FRICTION_VELOCITY,
    GRAVITY_CONSTANT,
    GRAVITY_COS,
    GRAVITY_SIN,
    INERTIA,
    LOAD,
    LOAD_FRICTION,
    LOAD_PER_KG,
    Q0,
    RESISTANCE,
    STRIBECK,
    STRIBECK_VELOCITY,
    TORQUE_CONSTANT,
    V0,
    VEC2,
    VEC3,
    VISCOUS,
    VOLTAGE,
    JointData,
    limited_current,
    standstill,
)
from proprio_ros.sim.rollout_kernels import TIME_EPS
from proprio_ros.sim.runtime import FLOAT, FLOATS


@dataclass(frozen=True, eq=False)
class PlainLaw:
    """What a walk without tangents needs, right for ``wp.Tape``: as in `Law`, with ``dp`` and all that begins with d left out.

    The first two entries of the state are position and velocity of the joint.
    """

    state: Any
    input: Any
    data: Any
    delay: int
    start: Callable[..., Any]  # (p, w, data, r) -> y
    rates: Callable[..., Any]  # (y, u, p, w, data, r) -> k
    # (y, h, u, p, w, data, r) -> the state a time h later, by its integrator
    step: Callable[..., Any]
    still: Callable[..., Any]  # as in `Law`


@cache
def schedule(law: PlainLaw) -> Any:
    """Rollout without tangents (thread = world); where ``capacity`` is above 0 it writes down every step, for the adjoint."""
    start = law.start
    rates = law.rates
    step = law.step
    still = law.still
    delay_column = law.delay

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(
        # Run data:
        sample_times: FLOATS,
        sample_count: wp.array(dtype=wp.int32),
        input_times: FLOATS,
        inputs: wp.array2d(dtype=law.input),
        input_count: wp.array(dtype=wp.int32),
        steps: FLOATS,
        data: law.data,
        # World data in:
        world_run: wp.array(dtype=wp.int32),
        p: FLOATS,
        capacity: wp.int32,
        # World data out: the state at each sample; step length, its change with the delay, input, and the step after which each
        # sample is taken
        y_out: wp.array2d(dtype=law.state),
        step_out: FLOATS,
        step_by_delay_out: FLOATS,
        input_out: wp.array2d(dtype=law.input),
        steps_out: wp.array(dtype=wp.int32),
        sample_step_out: wp.array2d(dtype=wp.int32),
    ):
        w = wp.tid()
        r = world_run[w]
        delay = p[w, delay_column]
        coarse = steps[r, 0]
        fine = steps[r, 1]
        y = start(p, w, data, r)
        t = FLOAT(0.0)
        dt = FLOAT(0.0)  # d t / d delay
        segment = wp.int32(0)
        u = inputs[r, 0]
        n = wp.int32(0)
        for k in range(sample_count[r]):
            goal = sample_times[r, k] - delay
            sample_step_out[w, k] = -1
            if goal > FLOAT(0.0):
                arrived = wp.int32(0)
                while arrived == 0:
                    end = goal
                    d_end = FLOAT(-1.0)
                    arrived = wp.int32(1)
                    if segment + 1 < input_count[r]:
                        if input_times[r, segment + 1] < goal:
                            end = input_times[r, segment + 1]
                            d_end = FLOAT(0.0)
                            arrived = 0
                    last = wp.int32(0)
                    while last == 0 and (capacity == 0 or n < capacity):
                        h = coarse
                        if fine < coarse:
                            if still(
                                y,
                                rates(y, u, p, w, data, r),
                                data,
                                r,
                                coarse,
                            ):
                                h = fine
                        dh = FLOAT(0.0)
                        if t + h > end - FLOAT(TIME_EPS):
                            h = end - t
                            dh = d_end - dt
                            last = 1
                        if n < capacity:
                            step_out[w, n] = h
                            step_by_delay_out[w, n] = dh
                            input_out[w, n] = u
                        y = step(y, h, u, p, w, data, r)
                        n = n + 1
                        t = t + h
                        if last == 1:
                            t = end
                            dt = d_end
                    if last == 0:
                        arrived = 1  # there is no room for more steps
                    if arrived == 0:
                        segment = segment + 1
                        u = inputs[r, segment]
                sample_step_out[w, k] = n
            seen = y
            seen[0] = y[0] + y[1] * wp.min(goal, FLOAT(0.0))
            y_out[w, k] = seen
        steps_out[w] = n

    return kernel


@cache
def taped(law: PlainLaw) -> Any:
    """A kernel whose adjoint is right, on the steps of `schedule`."""
    start = law.start
    step = law.step
    delay_column = law.delay

    @wp.kernel(module="unique")
    def roll(
        # Run data:
        data: law.data,
        # World data in:
        world_run: wp.array(dtype=wp.int32),
        p: FLOATS,
        delay_at: wp.array(dtype=FLOAT),
        step_in: FLOATS,
        step_by_delay_in: FLOATS,
        input_in: wp.array2d(dtype=law.input),
        steps_in: wp.array(dtype=wp.int32),
        # World data out:
        y_out: wp.array2d(dtype=law.state),
    ):
        w = wp.tid()
        r = world_run[w]
        delay = p[w, delay_column]
        y_out[w, 0] = start(p, w, data, r)
        for n in range(steps_in[w]):
            h = step_in[w, n] + step_by_delay_in[w, n] * (delay - delay_at[w])
            y_out[w, n + 1] = step(
                y_out[w, n],
                h,
                input_in[w, n],
                p,
                w,
                data,
                r,
            )

    return roll


@cache
def observe(law: PlainLaw) -> Any:
    """The joint's position at the samples (thread = world, sample), from every step of `taped`."""
    start = law.start
    delay_column = law.delay

    @wp.kernel(module="unique")
    def kernel(
        # Run data:
        sample_times: FLOATS,
        data: law.data,
        # World data in:
        world_run: wp.array(dtype=wp.int32),
        p: FLOATS,
        sample_step_in: wp.array2d(dtype=wp.int32),
        y_in: wp.array2d(dtype=law.state),
        # World data out:
        sampled_out: FLOATS,
    ):
        w, k = wp.tid()
        n = sample_step_in[w, k]
        if n < 0:
            y = start(p, w, data, world_run[w])
            sampled_out[w, k] = y[0] + y[1] * (sample_times[world_run[w], k] - p[w, delay_column])
        else:
            sampled_out[w, k] = y_in[w, n][0]

    return kernel


@wp.func
def acceleration(
    q: FLOAT,
    v: FLOAT,
    command: FLOAT,
    extra: FLOAT,
    p: FLOATS,
    world: wp.int32,
    constants: FLOATS,
    run: wp.int32,
):
    """Of one joint: the law of ``linearised_acceleration``, written down a second time."""
    i, _slope = limited_current(
        command, v, constants[run, VOLTAGE], constants[run, BACK_EMF], constants[run, RESISTANCE]
    )
    motor = p[world, TORQUE_CONSTANT] * i
    dry = p[world, COULOMB] + p[world, LOAD_FRICTION] * wp.abs(motor)
    if p[world, STRIBECK_VELOCITY] > FLOAT(0.0):
        slow = v / p[world, STRIBECK_VELOCITY]
        dry = dry * (FLOAT(1.0) + p[world, STRIBECK] * wp.exp(-slow * slow))
    friction = dry * wp.tanh(v / constants[run, FRICTION_VELOCITY]) + p[world, VISCOUS] * v
    load = (
        p[world, GRAVITY_COS] * wp.cos(q)
        + p[world, GRAVITY_SIN] * wp.sin(q)
        + p[world, GRAVITY_CONSTANT]
        + extra
    )
    return (motor - friction - load) / p[world, INERTIA]


@wp.func
def plain_rate(
    q: FLOAT,
    v: FLOAT,
    command: FLOAT,
    extra: FLOAT,
    p: FLOATS,
    w: wp.int32,
    data: JointData,
    r: wp.int32,
):
    return acceleration(
        q,
        v,
        command,
        extra,
        p,
        w,
        data.constants,
        r,
    )


@cache
def plain_joint_law(
    rate: Callable[..., Any],
    data_type: Any,
    integrator: str,
) -> PlainLaw:
    """The law of a state (q, v) without tangents.

    ``rate``: (q, v, command, extra load, p, w, data, r) -> acceleration, a Warp function; ``data_type``: the struct of
    what is known about the runs; ``integrator``: ``"rk4"`` or ``"semi_implicit"``.
    """
    rk4 = integrator == "rk4"

    @wp.func
    def start(
        p: FLOATS,
        w: wp.int32,
        data: data_type,
        r: wp.int32,
    ):
        return VEC2(p[w, Q0], p[w, V0])

    @wp.func
    def rates(
        y: VEC2,
        u: VEC3,
        p: FLOATS,
        w: wp.int32,
        data: data_type,
        r: wp.int32,
    ):
        extra = u[LOAD] + p[w, CARRIED] * u[LOAD_PER_KG]
        return VEC2(
            y[1],
            rate(
                y[0],
                y[1],
                u[CURRENT],
                extra,
                p,
                w,
                data,
                r,
            ),
        )

    @wp.func
    def step(
        y: VEC2, h: FLOAT, u: VEC3, p: FLOATS, w: wp.int32, data: data_type, r: wp.int32
    ,):  # fmt: skip
        q = y[0]
        v = y[1]
        command = u[CURRENT]
        extra = u[LOAD] + p[w, CARRIED] * u[LOAD_PER_KG]
        a1 = rate(
            q,
            v,
            command,
            extra,
            p,
            w,
            data,
            r,
        )
        if wp.static(rk4):
            half = FLOAT(0.5)
            two = FLOAT(2.0)
            v2 = v + half * h * a1
            a2 = rate(
                q + half * h * v,
                v2,
                command,
                extra,
                p,
                w,
                data,
                r,
            )
            v3 = v + half * h * a2
            a3 = rate(
                q + half * h * v2,
                v3,
                command,
                extra,
                p,
                w,
                data,
                r,
            )
            v4 = v + h * a3
            a4 = rate(
                q + h * v3,
                v4,
                command,
                extra,
                p,
                w,
                data,
                r,
            )
            sixth = h / FLOAT(6.0)
            return VEC2(
                q + sixth * (v + two * v2 + two * v3 + v4),
                v + sixth * (a1 + two * a2 + two * a3 + a4),
            )
        else:
            later = v + h * a1
            return VEC2(q + h * later, later)

    return PlainLaw(
        VEC2,
        VEC3,
        data_type,
        DELAY,
        start,
        rates,
        step,
        standstill(VEC2, data_type),
    )
