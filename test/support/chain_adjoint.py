"""The chain's bodies alone, its rollout, and the gradient of that by reverse mode: what its tangents are held against."""

from dataclasses import dataclass
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
)
from proprio_ros.errors import SimulationError
from proprio_ros.robot import ReducedModel
from proprio_ros.sim.runtime import FLOAT
from support.chain_adjoint_kernels import taped_kernels, terms_kernel
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
    steps = _planned(sim, plan, p)
    p_array = doubles(p, FLOAT, requires_grad=True)
    tape = wp.Tape()
    with tape:
        q = _rolled(sim, roll, p, p_array, steps)
        sampled = _states(sim, shape[:2])
        wp.launch(
            observe,
            dim=shape[:2],
            inputs=[sim._samples, p_array, steps.at_sample, q],
            outputs=[sampled],
            device="cpu",
        )
    tape.backward(grads={sampled: doubles(seed, sim._vec)})
    return p_array.grad.numpy().copy()


@dataclass(frozen=True)
class _Steps:
    """The steps that a rollout takes, on the device.

    Attributes:
        length_s: Shape (W, steps).
        by_delay: The change of each length with the delay, shape (W, steps).
        segment: Of the input, shape (W, steps).
        count: How many each world takes, shape (W,).
        at_sample: How many are done at each sample, shape (W, T).
    """

    length_s: wp.array
    by_delay: wp.array
    segment: wp.array
    count: wp.array
    at_sample: wp.array


def _planned(
    sim: ChainSimulator,
    plan: Any,
    p: NDArray[np.float64],
) -> _Steps:
    """Count the steps, and then write them down.

    Raises:
        SimulationError: There are too many to keep.
    """
    capacity = 0
    for _ in range(2):  # the first counts
        kept = (len(p), capacity)
        steps = _Steps(
            wp.zeros(kept, dtype=FLOAT, device="cpu"),
            wp.zeros(kept, dtype=FLOAT, device="cpu"),
            wp.zeros(kept, dtype=wp.int32, device="cpu"),
            wp.zeros(len(p), dtype=wp.int32, device="cpu"),
            wp.zeros((len(p), len(sim._samples)), dtype=wp.int32, device="cpu"),
        )
        run = [sim._fixed, sim._samples, sim._switches, sim._current, *sim._steps]
        wp.launch(
            plan,
            dim=len(p),
            inputs=[*run, doubles(p, FLOAT)],
            outputs=[steps.length_s, steps.by_delay, steps.segment, steps.count, steps.at_sample],
            device="cpu",
        )
        capacity = int(steps.count.numpy().max())
        if capacity > MAX_STEPS:
            raise SimulationError(
                f"{capacity} steps are too many for a tape (at most {MAX_STEPS}): use a longer step, or the forward sensitivities"
            )
    return steps


def _rolled(
    sim: ChainSimulator,
    roll: Any,
    p: NDArray[np.float64],
    p_array: wp.array,
    steps: _Steps,
) -> wp.array:
    """Positions before the first step and after each, shape (W, steps + 1), on the tape that is being recorded."""
    rows = (len(p), steps.length_s.shape[1] + 1)
    q = _states(sim, rows)
    v = _states(sim, rows)
    delay_at = doubles(p[:, sim.columns["delay"]].ravel(), FLOAT)
    wp.launch(
        roll,
        dim=len(p),
        inputs=[
            sim._fixed,
            sim._current,
            p_array,
            delay_at,
            steps.length_s,
            steps.by_delay,
            steps.segment,
            steps.count,
        ],
        outputs=[q, v],
        device="cpu",
    )
    return q


def _states(sim: ChainSimulator, shape: tuple[int, int]) -> wp.array:
    """Zeros for a vector of the joints in each place, with room for gradients."""
    return wp.zeros(shape, dtype=sim._vec, device="cpu", requires_grad=True)
