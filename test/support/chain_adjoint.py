"""The chain's bodies alone, and the gradient of its rollout by reverse mode: what its tangents are held against."""

from functools import cache
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from proprio_ros.errors import SimulationError
from proprio_ros.paper.chain import ChainSimulator, constants_of, doubles, inertial_parameters, parents_of
from proprio_ros.paper.chain_kernels import INERTIAL, JOINT_PARAMETERS, ChainData, dynamics, module_of
from proprio_ros.robot import ReducedModel
from proprio_ros.sim.joint import MAX_STEPS
from proprio_ros.sim.runtime import FLOAT


@cache
def terms_kernel(parents: tuple[int, ...]) -> Any:
    """Mass matrix and inverse dynamics without armature, in the functions that the rollouts use."""
    n = len(parents)
    vec = wp.types.vector(length=n, dtype=FLOAT)
    square = wp.types.matrix(shape=(n, n), dtype=FLOAT)
    tree = dynamics(parents)
    poses, screws, inertias, velocities = tree.poses, tree.screws, tree.inertias, tree.velocities
    mass_matrix_of, inverse_dynamics_of = tree.mass_matrix, tree.inverse_dynamics

    @wp.kernel(module=module_of(parents, "terms"), enable_backward=False)
    def kernel(
        # Model:
        fixed: ChainData,
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
def taped_kernels(parents: tuple[int, ...], integrator: str) -> tuple[Any, Any]:
    """Kernels whose adjoint is right: every step writes its own row, no state is overwritten."""
    n = len(parents)
    delay_column = (len(JOINT_PARAMETERS) + INERTIAL) * n
    vec = wp.types.vector(length=n, dtype=FLOAT)
    acceleration = dynamics(parents).acceleration
    rk4 = integrator == "rk4"

    @wp.func
    def state(p: wp.array2d(dtype=FLOAT), w: wp.int32, start: wp.int32):
        result = vec()
        for i in range(n):
            result[i] = p[w, start + i]
        return result

    @wp.kernel(module=module_of(parents, f"tape_{integrator}"))
    def roll(
        # Run data:
        fixed: ChainData,
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

    @wp.kernel(module=module_of(parents, f"tape_{integrator}"))
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
        terms_kernel(parents_of(model)),
        dim=len(states[0]),
        inputs=[
            constants_of(model, np.ones(n), np.zeros((n, 3)), device),
            doubles(p, FLOAT, device),
            *(doubles(x, vec, device) for x in states),
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


def tape_gradient(sim: ChainSimulator, p: ArrayLike, weights: ArrayLike) -> NDArray[np.float64]:
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
    p = sim._checked(p)
    seed = np.asarray(weights, dtype=np.float64)
    shape = (len(p), len(sim._samples), sim._n)
    if seed.shape != shape:
        raise SimulationError(f"weights have shape {seed.shape}: give {shape}")
    capacity = int(sim._launch(p, None)[6].numpy().max())
    if capacity > MAX_STEPS:
        raise SimulationError(
            f"{capacity} steps are too many for a tape (at most {MAX_STEPS}): use a longer step, or the forward "
            "sensitivities"
        )
    step, by_delay, segment, steps, sample_step = sim._launch(p, None, capacity)[3:]
    device = sim.device
    p_array = doubles(p, FLOAT, device, requires_grad=True)
    delay_at = doubles(p[:, sim.columns["delay"]].ravel(), FLOAT, device)
    q, v = (wp.zeros((len(p), capacity + 1), dtype=sim._vec, device=device, requires_grad=True) for _ in range(2))
    sampled = wp.zeros(shape[:2], dtype=sim._vec, device=device, requires_grad=True)
    roll, observe = taped_kernels(sim._parents, sim.integrator)
    tape = wp.Tape()
    with tape:
        wp.launch(
            roll,
            dim=len(p),
            inputs=[sim._fixed, sim._current, p_array, delay_at, step, by_delay, segment, steps],
            outputs=[q, v],
            device=device,
        )
        wp.launch(
            observe,
            dim=shape[:2],
            inputs=[sim._samples, p_array, sample_step, q],
            outputs=[sampled],
            device=device,
        )
    tape.backward(grads={sampled: doubles(seed, sim._vec, device)})
    return p_array.grad.numpy().copy()
