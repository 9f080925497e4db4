"""A gripper that closes on a soft block: one driven joint, and the block's tabulated resistance.

The joint of ``joint.py`` with the block as a load that depends on its position, as docs/pages/how_it_works.md writes it down:

    s = (c(q) - gap) / L                                      squeeze relative to the block's length
    P = A (E phi(s, nu) k + eta ds/dt min(s / s_r, 1))        where s > 0, and never below 0: a block that is let go does not pull
    k = 1 - loss (1 - tanh(v / v_f)) / 2                      v > 0 closes: what it gives back is less than what it took

``c`` is how far the fingers have closed on each other: ``travel`` times the joint's coordinate, twice the ratio of one finger;
with ``bend``, where it was measured that a gripper's linkage does not close evenly. E and nu are those at small strain, whatever
the law. ``eta`` is the block's viscosity (Kelvin and Voigt), which sets in over the first ``RAMP`` of squeeze, so that the force
has no jump where the fingers touch. The loss is the hysteresis of foam and rubber, which no speed decides; v_f is ten times
the speed over which dry friction is smoothed, so that no step has to be shorter for it.

Departures from the paper (Chen et al. 2025, arXiv:2410.03920): its block has inertia of its own and its gripper neither armature
nor friction. The armature, 15 to 76 kg at the finger, is what decides; that the block is in equilibrium at every instant changes
the encoder by a tenth of a count (``paper/softbody.py`` is the paper's way, and the test's oracle).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from proprio_ros.errors import SimulationError
from proprio_ros.sim import runtime
from proprio_ros.sim.joint import (
    JointRun,
    JointSimulator,
    harmless,
    kinds_of_kernel,
    plain_kernel,
)
from proprio_ros.sim.response import Response
from proprio_ros.sim.response_kernels import VEC4
from proprio_ros.sim.rollout_kernels import Law, rollout
from proprio_ros.sim.squeeze_kernels import (
    GAP,
    SQUEEZE_PARAMETERS,
    SqueezeData,
    squeeze_law,
)

SQUEEZE_INDEX = {name: row for row, name in enumerate(SQUEEZE_PARAMETERS)}
_SIZES = (1, 4, 9, 19)


@dataclass(frozen=True)
class SqueezeRun:
    """One closing of the gripper on the block. Raises `SimulationError`: A length or area that is not above 0, or no travel."""

    joint: JointRun  # what drives the joint and when it is looked at
    length: float  # of the block along the squeeze [m]
    area: float  # of the face that is pushed [m^2]
    # how fast the fingers close on each other per unit of the joint [m/rad, or m/m], not 0; negative where the joint's
    # coordinate falls when closing
    travel: float
    response: Response  # of the block in this run's orientation and contact
    # what the second and the third power of the joint's coordinate add to that closing [m/rad^2, m/rad^3]
    bend: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        if not (
            self.length > 0.0
            and self.area > 0.0
            and np.isfinite(self.travel)
            and self.travel != 0.0
        ):
            raise SimulationError(
                f"a block of length {self.length:g} m and face {self.area:g} m^2 between fingers that close by {self.travel:g} m: "
                "the first two must be above 0, the last not 0"
            )


class SqueezeSimulator(JointSimulator):
    """Rolls out many worlds (guesses) of one or more closings of a gripper on a block.

    Parameter vectors have the order of ``SQUEEZE_PARAMETERS``; the runs' tables may differ, over the same grid (the
    same law, else SimulationError). Everything else is as in ``JointSimulator``.
    """

    parameters = SQUEEZE_PARAMETERS
    harmless = harmless(SQUEEZE_PARAMETERS)
    tangent_sizes = _SIZES

    def __init__(self, runs: Sequence[SqueezeRun], integrator: str = "rk4") -> None:
        super().__init__([run.joint for run in runs], integrator)
        self.squeeze_runs = tuple(runs)
        tables = list({run.response.made_of: run.response for run in runs}.values())
        if any(
            table.nodes.shape != tables[0].nodes.shape or (table.grid != tables[0].grid).any()
            for table in tables
        ):
            raise SimulationError(
                "the runs' tables are over different grids: use one law of elasticity for all runs"
            )
        which = {table.made_of: row for row, table in enumerate(tables)}
        self._block = self._array(
            np.array(
                [
                    [
                        run.length,
                        run.area,
                        run.travel,
                        which[run.response.made_of],
                        *run.bend,
                    ]
                    for run in runs
                ]
            )
        )
        self._grid = self._array(tables[0].grid)
        self._nodes = wp.array(
            np.stack([table.nodes for table in tables]),
            dtype=VEC4,
            device="cpu",
        )

    def squeeze(
        self,
        world_run: np.ndarray,
        p: np.ndarray,
        q: np.ndarray,
    ) -> np.ndarray:
        """Squeeze relative to the block's length, shape (W, T); below 0 where the block is not touched.

        Where it is beyond the table's reach, the law is a guess.

        Args:
            world_run: Run of each world, shape (W,).
            p: Parameters, shape (W, P).
            q: Joint positions [rad], shape (W, T).
        """
        length, _, travel, _, second, third = self._block.numpy()[np.asarray(world_run)].T[
            :, :, None
        ]
        closed = q * (travel + q * (second + q * third))
        return (closed - p[:, GAP : GAP + 1]) / length

    def law_of(self, size: int, stribeck: bool) -> Law:
        return squeeze_law(size, stribeck)

    def law_data(self) -> Any:
        data = SqueezeData()
        data.constants = self._constants
        data.block = self._block
        data.grid = self._grid
        data.nodes = self._nodes
        return data


def compile_kernels(integrator: str = "rk4", *, rises: bool = True) -> None:
    """As ``joint.compile_kernels``, for fits with a block."""
    kernels = [rollout(squeeze_law(*kind), integrator) for kind in kinds_of_kernel(_SIZES, rises)]
    runtime.load(
        [
            *kernels,
            plain_kernel(len(SQUEEZE_PARAMETERS), integrator),
        ],
        "cpu",
    )
