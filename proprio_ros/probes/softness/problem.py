"""A soft block between the fingers as a least-squares problem: what ``problem.py`` has, and a block in some of the runs.

Every run is an empty hand's but for the block, whose force on the fingers ``sim/squeeze.py`` takes from a table. Unknown are its
Young's modulus, Poisson's ratio and relaxation time (viscosity over modulus), which all runs with it share, and for each of them
how far the fingers close before they touch it.
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

SOFTEST_PA, STIFFEST_PA = 1e2, 1e8
"""Moduli that are looked for: foam has a thousand pascals, hard rubber ten millions."""
LEAST_RELAXATION_S = -2e-4
"""No block gives energy back, but a force that comes a little late looks as if it did."""
HIGHEST_RATIO = 0.47
"""Beyond it a block keeps its volume, and four-node tetrahedra lock, even with J averaged over a cell."""


@dataclass(frozen=True)
class BlockFacts:
    """What is stated about the block and how it is held (``config/probes/softness.yaml`` and ``--set``).

    Attributes:
        size: of the block, x along the squeeze [m], shape (3,); of a mesh its extent.
        law: of elasticity, one of ``energies.LAWS``.
        contact: of its faces with the fingers, one of ``quasistatic.CONTACTS``.
        fingers: how many move, each by the joint's transmission or measured travel.
        gap: how far the fingers together close before they touch it [m].
        poissons_ratio: prior.
        relaxation_s: viscosity over Young's modulus, prior [s].
        mesh: of a block that is no box.
        guessed: keys of sizes that the user did not state.
    """

    size: np.ndarray
    law: str = "log"
    contact: str = "frictionless"
    fingers: int = 2
    gap: Quantity = field(default_factory=lambda: Quantity(0.001, 0.002))
    poissons_ratio: Quantity = field(default_factory=lambda: Quantity(0.3, 0.12))
    relaxation_s: Quantity = field(default_factory=lambda: Quantity(0.0, 0.01))
    mesh: TetMesh | None = None
    guessed: tuple[str, ...] = ()

    @property
    def length(self) -> float:
        """Along the squeeze [m]."""
        return float(self.size[0])

    @property
    def area(self) -> float:
        """Of the face that is pressed [m^2]."""
        return float(self.size[1] * self.size[2]) if self.mesh is None else self.mesh.area

    def table(self, rebuild: bool = False) -> Response:
        """What finite elements say about this block: from the cache, or built and put there.

        Args:
            rebuild: even where the cache has it.

        Raises:
            SimulationError: a block of such a shape cannot be squeezed as far as the table goes.
        """
        if self.mesh is not None:
            return response_of_mesh(self.mesh, self.law, self.contact, rebuild)
        return response(self.size, self.law, self.contact, rebuild=rebuild, far=True)


def closing_of(run: PreparedRun, facts: BlockFacts) -> np.ndarray:
    """By how much the fingers close on each other, by the first three powers of the angle of the motor's shaft; shape (3,).

    The current says which way is closing.
    """
    current = run.run.input_current_A
    towards = float(np.sign(current[np.argmax(np.abs(current))]))
    return towards * facts.fingers * np.array(run.drive.travel_coefficients)


def block_unknowns(
    robot: Robot,
    runs: Sequence[PreparedRun],
    squeezing: Sequence[bool],
    facts: BlockFacts,
    drive_role: Role,
    start_pa: float = 3e4,
) -> list[Unknown]:
    """All unknowns: those of the robot, and the block's.

    Args:
        robot: of the runs.
        runs: fitted together.
        squeezing: which runs have the block.
        facts: what is stated about the block.
        drive_role: what the recording may move of the robot.
        start_pa: Young's modulus from which a fit starts [Pa].
    """
    ratio, relaxation, gap = facts.poissons_ratio, facts.relaxation_s, facts.gap
    unknowns = [
        Unknown("youngs_modulus", start_pa, np.inf, SOFTEST_PA, STIFFEST_PA, asinh_scale=SOFTEST_PA),
        Unknown("poissons_ratio", ratio.value, ratio.std, 0.0, HIGHEST_RATIO).at_role(Role.FREE),
        Unknown("block_relaxation", relaxation.value, relaxation.std, LEAST_RELAXATION_S, 1.0).at_role(Role.FREE),
    ]
    for row in np.flatnonzero(squeezing).tolist():
        unknowns.append(Unknown("gap", gap.value, gap.std, -0.01, 0.1, scope=row).at_role(Role.FREE))
    return [*unknowns, *robot_unknowns(robot, runs, drive_role)]


class SqueezeProblem(Problem):
    """Whitened residuals of runs with and without a block between the fingers.

    Args:
        robot, runs, unknowns, integrator, step_s: as for ``Problem``, with the unknowns of ``block_unknowns`` and runs
            that were prepared as empty hands.
        facts: what is stated about the block.
        squeezing: which runs have it, length R; at least one.

    Raises:
        RecordingError: a run that squeezes drives a joint whose motion does not slide a finger.
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
        self._affine = False  # viscosity is a product of two unknowns

    def _simulator(self, runs: list[JointRun], integrator: str) -> MixedSimulator[SqueezeSimulator]:
        table = self.block.table()
        squeezed = [
            SqueezeRun(runs[row], self.block.length, self.block.area, first, table, (second, third))
            for row in np.flatnonzero(self.squeezing)
            for first, second, third in [self._closing[row].tolist()]
        ]
        special = SqueezeSimulator(squeezed, integrator)
        return MixedSimulator(
            special, [runs[row] for row in np.flatnonzero(~self.squeezing)], self.squeezing, integrator
        )

    def _touches(self, unknown: Unknown, row: int) -> bool:
        if unknown.kind in ("youngs_modulus", "poissons_ratio", "block_relaxation"):
            return bool(self.squeezing[row])
        return super()._touches(unknown, row)

    def _all_parameters(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        p, dp = super()._all_parameters(values)
        at, to = self.index, SQUEEZE_INDEX
        modulus, relaxation = values[:, at["youngs_modulus"]], values[:, at["block_relaxation"]]
        for row in np.flatnonzero(self.squeezing).tolist():
            for name in ("youngs_modulus", "poissons_ratio"):
                p[:, row, to[name]] = values[:, at[name]]
                dp[:, row, to[name], at[name]] = 1.0
            p[:, row, to["block_viscosity"]] = relaxation * modulus
            dp[:, row, to["block_viscosity"], at["youngs_modulus"]] = relaxation
            dp[:, row, to["block_viscosity"], at["block_relaxation"]] = modulus
            # the fingers touch where they have closed by the gap from where they stood
            rest = self.runs[row].rest.value
            p[:, row, to["gap"]] = self._closing[row] @ rest ** np.arange(1, 4) + values[:, at["gap", row]]
            dp[:, row, to["gap"], at["gap", row]] = 1.0
        return p, dp

    def squeezes(self, values: np.ndarray) -> list[np.ndarray]:
        """Squeeze relative to the block's length at the used samples of each run with it, as simulated; shapes (K,)."""
        q, _, _ = self.simulate(values[None], self.free[:1])
        p, _ = self.parameters(values[None], self.free[:1])
        rows = np.flatnonzero(self.squeezing)
        squeeze = self.simulator.special.squeeze(np.arange(len(rows)), p[0, rows], q[0, rows])
        return [squeeze[n, : self.runs[row].used] for n, row in enumerate(rows)]
