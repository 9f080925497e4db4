"""The chain's bodies alone and its rollout step by step, for Warp: what `chain_adjoint` launches."""

from functools import cache
from typing import Any

import warp as wp

from proprio_ros.addons.paper.chain_kernels import (
    INERTIAL,
    JOINT_PARAMETERS,
    TABLE,
    ChainData,
    dynamics,
    module_of,
)
from proprio_ros.sim.rollout_kernels import TIME_EPS
from proprio_ros.sim.runtime import FLOAT


@cache
def terms_kernel(parents: tuple[int, ...]) -> Any:
    """Mass matrix and inverse dynamics without armature, in the functions that the rollouts use."""
    n = len(parents)
    vec = wp.types.vector(length=n, dtype=FLOAT)
    square = wp.types.matrix(
        shape=(n, n),
        dtype=FLOAT,
    )
    tree = dynamics(parents)
    poses = tree.poses
    screws = tree.screws
    inertias = tree.inertias
    velocities = tree.velocities
    mass_matrix_of = tree.mass_matrix
    inverse_dynamics_of = tree.inverse_dynamics

    @wp.kernel(module=module_of(parents, "terms"), enable_backward=False)
    def kernel(
        # Model:
        fixed: ChainData,
        p_in: TABLE,
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
        torque_out[w] = inverse_dynamics_of(
            fixed, s, inertia, velocities(s, v_in[w]), v_in[w], a_in[w]
        )

    return kernel


@cache
def taped_kernels(
    parents: tuple[int, ...],
    integrator: str,
) -> tuple[Any, Any, Any]:
    """Kernels that write down the steps of the rollout, take them, and look at the samples.

    The adjoint of the last two is right: every step writes its own row, no state is overwritten.
    """
    n = len(parents)
    delay_column = (len(JOINT_PARAMETERS) + INERTIAL) * n
    vec = wp.types.vector(length=n, dtype=FLOAT)
    tree = dynamics(parents)
    solved = tree.solved
    sticking = tree.sticking
    rk4 = integrator == "rk4"

    @wp.func
    def acceleration(
        fixed: ChainData,
        p: TABLE,
        w: wp.int32,
        q: vec,
        v: vec,
        command: vec,
    ):
        _x, _s, _inertia, _velocities, _root, result = solved(
            fixed,
            p,
            w,
            q,
            v,
            command,
        )
        return result

    @wp.func
    def moved(
        fixed: ChainData,
        p: TABLE,
        w: wp.int32,
        q: vec,
        v: vec,
        h: FLOAT,
        command: vec,
    ):
        half = FLOAT(0.5)
        sixth = FLOAT(1.0) / FLOAT(6.0)
        two = FLOAT(2.0)
        a1 = acceleration(fixed, p, w, q, v, command)
        if wp.static(rk4):
            q2 = q + half * h * v
            v2 = v + half * h * a1
            a2 = acceleration(fixed, p, w, q2, v2, command)
            q3 = q + half * h * v2
            v3 = v + half * h * a2
            a3 = acceleration(fixed, p, w, q3, v3, command)
            q4 = q + h * v3
            v4 = v + h * a3
            a4 = acceleration(fixed, p, w, q4, v4, command)
            q_next = q + sixth * h * (v + two * v2 + two * v3 + v4)
            v_next = v + sixth * h * (a1 + two * a2 + two * a3 + a4)
        else:
            v_next = v + h * a1
            q_next = q + h * v_next
        return q_next, v_next

    @wp.func
    def state(
        p: TABLE,
        w: wp.int32,
        start: wp.int32,
    ):
        result = vec()
        for i in range(n):
            result[i] = p[w, start + i]
        return result

    @wp.kernel(module=module_of(parents, f"steps_{integrator}"), enable_backward=False)
    def plan(
        # Run data:
        fixed: ChainData,
        sample_times: wp.array(dtype=FLOAT),
        input_times: wp.array(dtype=FLOAT),
        input_current: wp.array(dtype=vec),
        coarse: FLOAT,
        fine: FLOAT,
        # World data in:
        p_in: TABLE,
        # World data out: step length, its change with the delay, segment of the input (W, steps); number of steps (W,);
        # the step after which each sample is taken, -1 before the onset (W, T)
        step_out: TABLE,
        step_by_delay_out: TABLE,
        segment_out: wp.array2d(dtype=wp.int32),
        steps_out: wp.array(dtype=wp.int32),
        sample_step_out: wp.array2d(dtype=wp.int32),
    ):
        w = wp.tid()
        q = state(p_in, w, delay_column + 1)
        v = state(p_in, w, delay_column + 1 + n)
        t = FLOAT(0.0)
        t_by_delay = FLOAT(0.0)
        segment = wp.int32(0)
        steps = wp.int32(0)
        for k in range(sample_times.shape[0]):
            goal = sample_times[k] - p_in[w, delay_column]
            sample_step_out[w, k] = -1
            arrived = goal <= FLOAT(0.0)
            while not arrived:
                end = goal
                end_by_delay = FLOAT(-1.0)
                arrived = wp.bool(True)
                if segment + 1 < input_times.shape[0]:
                    if input_times[segment + 1] < goal:
                        end = input_times[segment + 1]
                        end_by_delay = FLOAT(0.0)
                        arrived = wp.bool(False)
                command = input_current[segment]
                last = wp.bool(False)
                while not last:
                    h = coarse
                    h_by_delay = FLOAT(0.0)
                    if fine < coarse:
                        if sticking(
                            fixed, p_in, w, v, acceleration(fixed, p_in, w, q, v, command), coarse
                        ):
                            h = fine
                    if t + h > end - FLOAT(TIME_EPS):
                        h = end - t
                        h_by_delay = end_by_delay - t_by_delay
                        last = wp.bool(True)
                    if steps < step_out.shape[1]:
                        step_out[w, steps] = h
                        step_by_delay_out[w, steps] = h_by_delay
                        segment_out[w, steps] = segment
                    q_next, v_next = moved(
                        fixed,
                        p_in,
                        w,
                        q,
                        v,
                        h,
                        command,
                    )
                    q = q_next
                    v = v_next
                    steps += 1
                    t = t + h
                    if last:
                        t = end
                        t_by_delay = end_by_delay
                if not arrived:
                    segment += 1
            if goal > FLOAT(0.0):
                sample_step_out[w, k] = steps
        steps_out[w] = steps

    @wp.kernel(module=module_of(parents, f"tape_{integrator}"))
    def roll(
        # Run data:
        fixed: ChainData,
        input_current: wp.array(dtype=vec),
        # World data in:
        p_in: TABLE,
        delay_at: wp.array(dtype=FLOAT),
        step_in: TABLE,
        step_by_delay_in: TABLE,
        segment_in: wp.array2d(dtype=wp.int32),
        steps_in: wp.array(dtype=wp.int32),
        # World data out:
        q_out: wp.array2d(dtype=vec),
        v_out: wp.array2d(dtype=vec),
    ):
        w = wp.tid()
        q_out[w, 0] = state(p_in, w, delay_column + 1)
        v_out[w, 0] = state(
            p_in,
            w,
            delay_column + 1 + n,
        )
        for k in range(steps_in[w]):
            h = step_in[w, k] + step_by_delay_in[w, k] * (p_in[w, delay_column] - delay_at[w])
            command = input_current[segment_in[w, k]]
            q, v = moved(
                fixed,
                p_in,
                w,
                q_out[w, k],
                v_out[w, k],
                h,
                command,
            )
            q_out[w, k + 1] = q
            v_out[w, k + 1] = v

    @wp.kernel(module=module_of(parents, f"tape_{integrator}"))
    def observe(
        # Run data:
        sample_times: wp.array(dtype=FLOAT),
        # World data in:
        p_in: TABLE,
        sample_step_in: wp.array2d(dtype=wp.int32),
        q_in: wp.array2d(dtype=vec),
        # World data out:
        sampled_out: wp.array2d(dtype=vec),
    ):
        w, k = wp.tid()
        step = sample_step_in[w, k]
        if step < 0:
            goal = sample_times[k] - p_in[w, delay_column]
            sampled_out[w, k] = state(p_in, w, delay_column + 1) + goal * state(
                p_in, w, delay_column + 1 + n
            )
        else:
            sampled_out[w, k] = q_in[w, step]

    return plan, roll, observe
