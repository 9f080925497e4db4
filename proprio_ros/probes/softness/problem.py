"""A soft block between the fingers as a least-squares problem: what ``problem.py`` has, and a block in some of the runs.

Every run is an empty hand's but for the block, whose force on the fingers ``sim/squeeze.py`` takes from a table. Unknown are its
Young's modulus, Poisson's ratio, relaxation time (viscosity over modulus) and loss, which all runs with it share, and for each of
them how far the fingers close before they touch it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from proprio_ros.errors import RecordingError
from proprio_ros.identification.prepared_runs import PreparedRun
from proprio_ros.identification.problem import Problem
from proprio_ros.identification.robot_unknowns import robot_unknowns
from proprio_ros.identification.unknowns import Role, Unknown
from proprio_ros.quantity import Quantity
from proprio_ros.robot import Robot
from proprio_ros.sim.joint import JointRun
from proprio_ros.sim.mesh import TetMesh
from proprio_ros.sim.mixed import MixedSimulator
from proprio_ros.sim.payload import PayloadFacts
from proprio_ros.sim.response import Response, response, response_of_mesh
from proprio_ros.sim.squeeze import SQUEEZE_INDEX, SqueezeRun, SqueezeSimulator

SOFTEST_PA, START_PA, STIFFEST_PA = 1e2, 3e4, 1e8
"""Moduli that are looked for: foam has a thousand pascals, hard rubber ten millions."""
# no block gives energy back, but a force that comes a little late looks as if it did
LEAST_RELAXATION_S = -2e-4
HIGHEST_LOSS = 0.9
HIGHEST_RATIO = 0.47
"""Beyond it a block keeps its volume, and four-node tetrahedra lock, even with J averaged over a cell."""


@dataclass(frozen=True)
class BlockFacts:
    """What is stated about the block and how it is held (``config/probes/softness.yaml`` and ``--set``)."""

    size: np.ndarray  # of the block, x along the squeeze [m], shape (3,); of a mesh its extent
    law: str = "log"  # of elasticity, one of ``energies.LAWS``
    contact: str = "frictionless"  # of its faces with the fingers, one of ``quasistatic.CONTACTS``
    fingers: int = 2  # how many move, each by the joint's transmission or measured travel
    # how far the fingers together close before they touch it [m]
    gap: Quantity = field(default_factory=lambda: Quantity(0.001, 0.002))
    # poissons_ratio, relaxation_s: priors, of the latter viscosity over Young's modulus
    poissons_ratio: Quantity = field(default_factory=lambda: Quantity(0.3, 0.12))
    relaxation_s: Quantity = field(default_factory=lambda: Quantity(0.0, 0.01))
    # by what share a block pushes back less when it is let go than when it is squeezed: its prior
    loss: Quantity = field(default_factory=lambda: Quantity(0.0, 0.2))
    mesh: TetMesh | None = None  # of a block that is no box
    guessed: tuple[str, ...] = ()  # keys of sizes that the user did not state

    @property
    def length(self) -> float:
        """Along the squeeze [m]."""
        return float(self.size[0])

    @property
    def area(self) -> float:
        """Of the face that is pressed [m^2]."""
        if self.mesh is not None:
            return self.mesh.area
        return float(self.size[1] * self.size[2])

    def table(self, rebuild: bool = False) -> Response:
        """What finite elements say about this block: from the cache, unless it is to be rebuilt, or built and put there.

        Raises `SimulationError`: A block of such a shape cannot be squeezed as far as the table goes.
        """
        if self.mesh is not None:
            return response_of_mesh(self.mesh, self.law, self.contact, rebuild)
        return response(
            self.size,
            self.law,
            self.contact,
            rebuild=rebuild,
            far=True,
        )


def closing_of(run: PreparedRun, facts: BlockFacts) -> np.ndarray:
    """By how much the fingers close on each other, by the first three powers of the angle of the motor's shaft; shape (3,)."""
    current = run.run.input_current_A
    # the current says which way is closing
    towards = float(np.sign(current[np.argmax(np.abs(current))]))
    return towards * facts.fingers * np.array(run.drive.travel_coefficients)


def block_unknowns(
    robot: Robot,
    runs: Sequence[PreparedRun],
    squeezing: Sequence[bool],
    facts: BlockFacts,
    drive_role: Role,
) -> list[Unknown]:
    """All unknowns: the block's, and those of the robot.

    Args:
        robot: Whose drive trains move the runs.
        runs: R of them.
        squeezing: Which of them have the block, length R.
        facts: Of the block.
        drive_role: What the recording may move of the robot.
    """
    ratio = facts.poissons_ratio
    relaxation = facts.relaxation_s
    gap = facts.gap
    loss = facts.loss
    unknowns = [
        Unknown(
            "youngs_modulus", START_PA, np.inf, SOFTEST_PA, STIFFEST_PA, asinh_scale=SOFTEST_PA
        ),
        Unknown("poissons_ratio", ratio.value, ratio.std, 0.0, HIGHEST_RATIO).at_role(
            Role.ESTIMATED
        ),
        Unknown(
            "block_relaxation", relaxation.value, relaxation.std, LEAST_RELAXATION_S, 1.0
        ).at_role(Role.ESTIMATED),
        Unknown("block_loss", loss.value, loss.std, 0.0, HIGHEST_LOSS).at_role(Role.ESTIMATED),
    ]
    gaps = [
        Unknown("gap", gap.value, gap.std, -0.01, 0.1, scope=row)
        for row in np.flatnonzero(squeezing).tolist()
    ]
    return [
        *unknowns,
        *(gap.at_role(Role.ESTIMATED) for gap in gaps),
        *robot_unknowns(robot, runs, drive_role),
    ]


class SqueezeProblem(Problem):
    """Whitened residuals of runs with and without a block between the fingers, as in ``Problem``.

    Runs are prepared as empty hands; ``squeezing`` is which have the block (at least one), unknowns are of ``block_unknowns``.

    Raises `RecordingError`: A run that squeezes drives a joint whose motion does not slide a finger.
    """

    simulator: MixedSimulator[SqueezeSimulator]

    def __init__(
        self,
        robot: Robot,
        runs: Sequence[PreparedRun],
        facts: BlockFacts,
        squeezing: Sequence[bool],
        unknowns: Sequence[Unknown],
        integrator: str = "rk4",
        step_s: float = 1.0 / 240.0,
    ) -> None:
        self.block = facts
        self.squeezing = np.asarray(squeezing, dtype=bool)
        for row in np.flatnonzero(self.squeezing).tolist():
            if robot.model.joint(runs[row].run.joint).kind != "prismatic":
                raise RecordingError(
                    f"{runs[row].run.name}: {runs[row].run.joint} was driven, which slides no finger: squeeze with the gripper"
                )
        self._closing = [closing_of(run, facts) for run in runs]
        super().__init__(robot, runs, PayloadFacts(), unknowns, integrator, step_s)

    def is_affine(self) -> bool:
        return False  # viscosity is a product of two unknowns

    def simulator_of(
        self, runs: list[JointRun], integrator: str
    ) -> MixedSimulator[SqueezeSimulator]:
        block = self.block
        table = self.block.table()
        squeezed = []
        for row in np.flatnonzero(self.squeezing):
            first, *bend = self._closing[row].tolist()
            squeezed.append(
                SqueezeRun(
                    runs[row],
                    block.length,
                    block.area,
                    first,
                    table,
                    tuple(bend),
                )
            )
        others = [runs[row] for row in np.flatnonzero(~self.squeezing)]
        return MixedSimulator(
            SqueezeSimulator(squeezed, integrator), others, self.squeezing, integrator
        )

    def touches(self, unknown: Unknown, row: int) -> bool:
        if unknown.kind in ("youngs_modulus", "poissons_ratio", "block_relaxation", "block_loss"):
            return bool(self.squeezing[row])
        return super().touches(unknown, row)

    def all_parameters(
        self,
        values: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        p, dp = super().all_parameters(values)
        at = self.index
        to = SQUEEZE_INDEX
        modulus = values[:, at["youngs_modulus"]]
        relaxation = values[:, at["block_relaxation"]]
        for row in np.flatnonzero(self.squeezing).tolist():
            for name in ("youngs_modulus", "poissons_ratio", "block_loss"):
                p[:, row, to[name]] = values[:, at[name]]
                dp[:, row, to[name], at[name]] = 1.0
            p[:, row, to["block_viscosity"]] = relaxation * modulus
            dp[:, row, to["block_viscosity"], at["youngs_modulus"]] = relaxation
            dp[:, row, to["block_viscosity"], at["block_relaxation"]] = modulus
            # the fingers touch where they have closed by the gap from where they stood
            rest = self.runs[row].rest.value
            closed = self._closing[row] @ rest ** np.arange(1, 4)
            p[:, row, to["gap"]] = closed + values[:, at["gap", row]]
            dp[:, row, to["gap"], at["gap", row]] = 1.0
        return p, dp

    def squeezes(self, values: np.ndarray) -> list[np.ndarray]:
        """Squeeze relative to the block's length at the used samples of each run with it, as simulated; shapes (K,)."""
        q, _, _ = self.simulate(
            values[None],
            self.estimated[:1],
        )
        p, _ = self.parameters(values[None], self.estimated[:1])
        rows = np.flatnonzero(self.squeezing)
        squeeze = self.simulator.special.squeeze(
            np.arange(len(rows)),
            p[0, rows],
            q[0, rows],
        )
        return [squeeze[n, : self.runs[row].used] for n, row in enumerate(rows)]
