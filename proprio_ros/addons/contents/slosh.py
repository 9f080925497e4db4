"""One driven joint that carries a container whose contents move sideways in part: a liquid that sloshes, or grains that slide.

The first mode of a liquid in an upright cylinder swings as a pendulum does (Abramson, NASA SP-106, chapter 6; Dodge, The new
dynamic behavior of liquids in moving containers, 2000): a mass moves by x [m] across the container's axis, and rises by x^2 / 2 R,
R = g / w2, as the centre of a liquid under a plane surface does; one on a spring at a fixed height has the same small waves only.
With ``s = a x z`` (a the joint's axis, z the container's, at right angles) it is at ``(X, Z)`` along s and z from the joint's axis,
``X = x + reach``, its way there slopes by ``c = x / R``, and with gravity g(q) in the container's frame Lagrange's equations are

    (1 + c^2) x'' = P - E v',  (J + m N^2 / (1 + c^2)) v' = joint's torques + m (N Q + E F) / (1 + c^2)
    P = g_s(q) + c g_z(q) + v^2 N - c x'^2 / R - F,  Q = c g_s(q) - g_z(q) + x'^2 / R - v^2 E - 2 v x' (1 + c^2),
    N = X + c Z,  E = Z - c X,  F = d x' + f tanh(x' / v_f)

where J is the inertia of all else. Of grains the surface slopes until friction f [m/s^2] no longer holds it: the same law. Runs
start at rest: a liquid is level (``settled`` 1), grains lie as the container was (0).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from proprio_ros.addons.contents.held_kernels import implicit_rollout
from proprio_ros.addons.contents.slosh_kernels import (
    SLOSH_PARAMETERS,
    STIFFNESS,
    SloshData,
    slosh_law,
)
from proprio_ros.sim import runtime
from proprio_ros.sim.joint import JointRun, JointSimulator, harmless, kinds_of_kernel, plain_kernel
from proprio_ros.sim.rollout_kernels import Law, rollout
from proprio_ros.sim.runtime import FLOAT

# all 21 parameters go in 24 directions, which fill a processor's vectors: in two thirds of the time that 21 take
_SIZES = (1, 8, 24)


@dataclass(frozen=True)
class SloshRun:
    """One rollout with moving contents."""

    joint: JointRun
    reach: float  # from the joint's axis to the container's along s [m]
    bottom: float  # from the joint's axis to the inside bottom along z [m]
    # of gravity along s: constant, cos and sin part as the joint turns [m/s^2], shape (3,)
    gravity_s: np.ndarray
    gravity_z: np.ndarray  # the same along z


class SloshSimulator(JointSimulator):
    """Rolls out many worlds of runs with moving contents; parameter vectors have the order of ``SLOSH_PARAMETERS``."""

    parameters = SLOSH_PARAMETERS
    harmless = np.where(
        np.arange(len(SLOSH_PARAMETERS)) == STIFFNESS, 1.0, harmless(SLOSH_PARAMETERS)
    )
    tangent_sizes = _SIZES

    def __init__(self, runs: Sequence[SloshRun], integrator: str = "rk4") -> None:
        super().__init__([run.joint for run in runs], integrator)
        self._geometry = self._array(
            np.array([[run.reach, run.bottom, *run.gravity_s, *run.gravity_z] for run in runs])
        )

    def path(self, world_run: np.ndarray, p: np.ndarray) -> np.ndarray:
        """How far the moving part is from the container's axis at the samples [m], shape (W, T), a copy."""
        outputs = self.launch(
            np.asarray(world_run, dtype=np.int32),
            p,
            np.zeros((*p.shape, 1)),
            None,
        )
        return np.array(outputs[3])

    def law_of(self, size: int, stribeck: bool) -> Law:
        return slosh_law(size, stribeck)

    def law_data(self) -> Any:
        data = SloshData()
        data.constants = self._constants
        data.geometry = self._geometry
        return data

    def output_arrays(self, worlds: int, size: int) -> list[wp.array]:
        vec = wp.types.vector(length=size, dtype=FLOAT)
        return [
            *super().output_arrays(worlds, size),
            *(self._zeros((worlds, self._width), kind) for kind in (FLOAT, vec)),
        ]


def compile_kernels(integrator: str = "rk4", *, rises: bool = True) -> None:
    """As ``joint.compile_kernels``, for fits with moving contents."""
    kernels = [rollout(slosh_law(*kind), integrator) for kind in kinds_of_kernel(_SIZES, rises)]
    held = [implicit_rollout(stribeck) for stribeck in (False, True)[: 1 + rises]]
    runtime.load([*kernels, *held, plain_kernel(len(SLOSH_PARAMETERS), integrator)], "cpu")
