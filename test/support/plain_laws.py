"""The laws of a sphere and of a squeeze without tangents: what their tangents are held against, by differences and by tape."""

from typing import Any

import numpy as np
import warp as wp

from proprio_ros.sim.joint import JointSimulator
from proprio_ros.sim.runtime import FLOAT
from proprio_ros.sim.sphere import SphereSimulator
from proprio_ros.sim.squeeze import SqueezeSimulator
from proprio_ros.sim.squeeze_kernels import SqueezeData
from support.plain_law_kernels import plain_sphere_law, plain_squeeze_rate
from support.taped import TapedRollout, forward, tape
from support.taped_kernels import PlainLaw, plain_joint_law


def difference(
    simulator: JointSimulator,
    p: np.ndarray,
    row: int,
    step: float,
) -> np.ndarray:
    """Central difference of the angles of one world by one parameter, shape (1, T).

    Args:
        simulator: of one run.
        p: parameters of one world, shape (1, P).
        row: which parameter.
        step: of the difference to each side, in the parameter's unit.
    """
    up = p.copy()
    up[0, row] += step
    down = p.copy()
    down[0, row] -= step
    world = np.zeros(1, dtype=np.int32)
    above = simulator.rollout(world, up)[0]
    below = simulator.rollout(world, down)[0]
    return (above - below) / (2.0 * step)


def _law_of(simulator: SphereSimulator) -> PlainLaw:
    return plain_sphere_law(simulator.enclosure.shape, simulator.law, simulator.integrator)


def states_of(
    simulator: SphereSimulator, world_run: np.ndarray, p: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Forward pass alone: q, v (W, T) and the sphere's position, velocity and spin (W, T, 3) at the sample instants."""
    states, command = record_forward(simulator, world_run, p)
    command.launch()
    return parts(states)


def record_forward(
    simulator: SphereSimulator, world_run: np.ndarray, p: np.ndarray
) -> tuple[wp.array, Any]:
    """The forward pass as a command to launch again and again, and the states that it fills, shape (W, T)."""
    runs = wp.array(
        np.asarray(world_run, dtype=np.int32),
        dtype=wp.int32,
        device="cpu",
    )
    given = wp.array(
        np.asarray(p, dtype=np.float64),
        dtype=FLOAT,
        device="cpu",
    )
    (states, *_), command = forward(
        simulator,
        _law_of(simulator),
        runs,
        given,
        record_cmd=True,
    )
    return states, command


def parts(states: wp.array) -> tuple[np.ndarray, ...]:
    """A copy of states: q, v (W, T), x, u and spin (W, T, 3)."""
    y = states.numpy().copy()
    return y[..., 0], y[..., 1], y[..., 2:5], y[..., 5:8], y[..., 8:]


def taped_sphere(
    simulator: SphereSimulator,
    world_run: np.ndarray,
    p: np.ndarray,
) -> TapedRollout:
    return tape(simulator, world_run, p, _law_of(simulator))


def taped_squeeze(
    simulator: SqueezeSimulator, world_run: np.ndarray, p: np.ndarray
) -> TapedRollout:
    return tape(
        simulator,
        world_run,
        p,
        plain_joint_law(plain_squeeze_rate, SqueezeData, simulator.integrator),
    )
