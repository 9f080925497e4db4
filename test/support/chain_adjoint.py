"""The chain's bodies alone, its rollout, and the gradient of that by reverse mode: what its tangents are held against."""

from functools import cache
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from proprio_ros.addons.paper.chain import (
    ChainSimulator,
    constants_of,
    doubles,
    inertial_parameters,
)
from proprio_ros.addons.paper.chain_kernels import (
    INERTIAL,
    JOINT_PARAMETERS,
    TABLE,
    ChainData,
    dynamics,
    module_of,
)
from proprio_ros.errors import SimulationError
from proprio_ros.robot import ReducedModel
from proprio_ros.sim.rollout_kernels import TIME_EPS
from proprio_ros.sim.runtime import FLOAT
from support.taped import MAX_STEPS


def pack(sim: ChainSimulator, **groups: ArrayLike) -> NDArray[np.float64]:
    """Parameters of one or more worlds.

    Args:
        sim: The chain of n joints.
        **groups: A value of each group (see ``columns``) that is not at its default: one number, shape (n,) or (W, n);
            ``pi`` shape (n, 10) or (W, n, 10); ``delay`` one number or shape (W,). The inertial parameters default to the
            model's, everything else to zero.

    Returns:
        Shape (W, P); W is 1 when no group has worlds.
    """
    n = len(sim.model.joint_names)
    blocks = []
    for group, value in {"pi": inertial_parameters(sim.model.pseudo_inertia), **groups}.items():
        own = {"pi": (n, INERTIAL), "delay": ()}.get(
            group,
            (n,),
        )
        array = np.asarray(value, dtype=np.float64)
        worlds = array.shape[:1] if array.ndim > len(own) else (1,)
        blocks.append(
            (
                group,
                np.broadcast_to(array, worlds + own).reshape(
                    *worlds,
                    -1,
                ),
            )
        )
    result = np.zeros((max(len(block) for _, block in blocks), len(sim.parameter_names)))
    for group, block in blocks:
        result[:, sim.columns[group]] = block
    return result


def rollout(
    sim: ChainSimulator,
    p: ArrayLike,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Positions and velocities at the sample instants, each (W, T, n), of parameters (W, P)."""
    q, v, _ = sim.jacobian(
        p,
        np.zeros((*np.shape(p), 1)),
    )
    return q, v


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


def rigid_body_terms(
    model: ReducedModel, q: ArrayLike, v: ArrayLike, a: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mass matrix and inverse dynamics of the bare bodies, without armature, friction and springs.

    Args:
        model: The bodies.
        q: Positions [rad or m], shape (B, n).
        v: Velocities [rad/s or m/s], shape (B, n).
        a: Accelerations [rad/s^2 or m/s^2], shape (B, n); zero for the bias forces.

    Returns:
        H (B, n, n) and the torques or forces H a + b(q, v) (B, n).
    """
    n = len(model.joint_names)
    states = [np.asarray(values, dtype=np.float64).reshape(-1, n) for values in (q, v, a)]
    vec = wp.types.vector(length=n, dtype=FLOAT)
    p = np.concatenate(
        [np.zeros(len(JOINT_PARAMETERS) * n), inertial_parameters(model.pseudo_inertia).ravel()]
    )[None]
    h = wp.zeros(
        len(states[0]),
        dtype=wp.types.matrix(
            shape=(n, n),
            dtype=FLOAT,
        ),
        device="cpu",
    )
    torque = wp.zeros(
        len(states[0]),
        dtype=vec,
        device="cpu",
    )
    wp.launch(
        terms_kernel(tuple(model.parents.tolist())),
        dim=len(states[0]),
        inputs=[
            constants_of(
                model,
                np.ones(n),
                np.zeros((n, 3)),
            ),
            doubles(p, FLOAT),
            *(doubles(x, vec) for x in states),
        ],
        outputs=[h, torque],
        device="cpu",
    )
    return h.numpy().copy(), torque.numpy().copy()


def mass_matrix(
    model: ReducedModel,
    q: ArrayLike,
) -> NDArray[np.float64]:
    """H(q) without armature [kg m^2, kg m or kg], shape (B, n, n), at positions of shape (B, n)."""
    return rigid_body_terms(model, q, np.zeros_like(q), np.zeros_like(q))[0]


def bias(
    model: ReducedModel,
    q: ArrayLike,
    v: ArrayLike,
) -> NDArray[np.float64]:
    """Gravity, centrifugal and Coriolis torques b(q, v) [N m or N], shape (B, n), at states of shape (B, n)."""
    return rigid_body_terms(model, q, v, np.zeros_like(q))[1]


def tape_gradient(
    sim: ChainSimulator,
    p: ArrayLike,
    weights: ArrayLike,
) -> NDArray[np.float64]:
    """Gradient of ``sum(weights * q)`` by reverse mode, on the steps that the rollout takes at the same parameters.

    Their lengths follow the delay to first order, which is exact, and stay frozen otherwise.

    Args:
        sim: The chain.
        p: Parameters of each world, shape (W, P).
        weights: Shape (W, T, n).

    Returns:
        Shape (W, P).

    Raises:
        SimulationError: The parameters or weights have the wrong shape, or there are too many steps to keep.
    """
    p = np.ascontiguousarray(p, dtype=np.float64)
    seed = np.asarray(weights, dtype=np.float64)
    shape = (len(p), len(sim._samples), sim._n)
    if seed.shape != shape:
        raise SimulationError(f"weights have shape {seed.shape}: give {shape}")
    plan, roll, observe = taped_kernels(sim._parents, sim.integrator)
    capacity = 0
    for _ in range(2):  # the first counts
        written = [
            wp.zeros((len(p), capacity), dtype=kind, device="cpu")
            for kind in (FLOAT, FLOAT, wp.int32)
        ]
        written += [
            wp.zeros(
                size,
                dtype=wp.int32,
                device="cpu",
            )
            for size in (len(p), shape[:2])
        ]
        run = [
            sim._fixed,
            sim._samples,
            sim._switches,
            sim._current,
            *sim._steps,
        ]
        wp.launch(
            plan,
            dim=len(p),
            inputs=[*run, doubles(p, FLOAT)],
            outputs=written,
            device="cpu",
        )
        capacity = int(written[3].numpy().max())
        if capacity > MAX_STEPS:
            raise SimulationError(
                f"{capacity} steps are too many for a tape (at most {MAX_STEPS}): use a longer step, or the forward sensitivities"
            )
    step, by_delay, segment, steps, sample_step = written
    p_array = doubles(p, FLOAT, requires_grad=True)
    delay_at = doubles(
        p[:, sim.columns["delay"]].ravel(),
        FLOAT,
    )
    q, v = (
        wp.zeros(
            (len(p), capacity + 1),
            dtype=sim._vec,
            device="cpu",
            requires_grad=True,
        )
        for _ in range(2)
    )
    sampled = wp.zeros(
        shape[:2],
        dtype=sim._vec,
        device="cpu",
        requires_grad=True,
    )
    tape = wp.Tape()
    with tape:
        wp.launch(
            roll,
            dim=len(p),
            inputs=[
                sim._fixed,
                sim._current,
                p_array,
                delay_at,
                step,
                by_delay,
                segment,
                steps,
            ],
            outputs=[q, v],
            device="cpu",
        )
        wp.launch(
            observe,
            dim=shape[:2],
            inputs=[sim._samples, p_array, sample_step, q],
            outputs=[sampled],
            device="cpu",
        )
    tape.backward(grads={sampled: doubles(seed, sim._vec)})
    return p_array.grad.numpy().copy()
