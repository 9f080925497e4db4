"""The cases of the paper's experiments: objects, robots, and one squeeze with nothing unknown but the modulus."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from proprio_ros.addons.paper.hand import learnt_robot, stated_robot
from proprio_ros.identification.prepared_runs import KnownLoad, prepare_run
from proprio_ros.identification.problem import Problem
from proprio_ros.identification.robot_unknowns import load_unknowns
from proprio_ros.identification.unknowns import Role
from proprio_ros.probes.container.problem import ContainerFacts
from proprio_ros.probes.container.virtual_object import Container
from proprio_ros.probes.softness.problem import BlockFacts, SqueezeProblem, block_unknowns
from proprio_ros.probes.softness.virtual_object import SoftBlock
from proprio_ros.records import Run
from proprio_ros.robot import Robot
from proprio_ros.sim.payload import PayloadFacts, PayloadShape
from proprio_ros.sim.sphere import Enclosure
from proprio_ros.virtual.objects import Payload

Rows = dict[str, Any]  # what an experiment returns: lists of rows by name, all of it JSON

OBJECTS: Mapping[str, tuple[float, str, float]] = {
    "heavy ball": (0.050, "sphere", 0.045),
    "light ball": (0.020, "sphere", 0.045),
    "heavy cube": (0.023, "cube", 0.030),
    "light cube": (0.010, "cube", 0.030),
}
"""Mass [kg], shape and size [m]; of the cubes, which the paper does not size, the edge is ours."""
# first guesses from nothing to the paper's greatest
STARTS_KG = (1e-6, 0.000477, 0.001, 0.005, 0.095, 0.191, 4.772)
CUBES: Mapping[str, tuple[float, float]] = {
    "light cube": (1694.6, 0.130),
    "heavy cube": (12824.6, 0.258),
}
"""Young's modulus [Pa] and Poisson's ratio of the Lame parameters that the paper found."""
EDGE_M = 0.03
GAP_M = 0.0005
BLOCK_DAMPING = 0.5
# runs of the sequence ``payload_elbow``
LIFT = 0
LOWER = 1


def payload(name: str) -> tuple[Payload, PayloadFacts]:
    """An object of the table as the virtual hand holds it, and what is stated of it: shape and size."""
    mass, shape, size = OBJECTS[name]
    across = mass * (size**2 / 10.0 if shape == "sphere" else size**2 / 6.0)
    held = Payload(mass, inertia_kg_m2=(across, across, across, 0.0, 0.0, 0.0))
    return held, PayloadFacts(shape=PayloadShape.of(shape, size))


def robots(seed: int, sequence: str) -> list[tuple[bool, Robot]]:
    """The robot without and with a calibration of its own; only without where it refused what it learnt."""
    learnt = learnt_robot(seed, sequence)
    return [
        (False, stated_robot()),
        *([] if learnt is None else [(True, learnt)]),
    ]


def calibrated_robot(seed: int, sequence: str) -> Robot:
    """The robot with a calibration of its own, where it did not refuse that."""
    return robots(seed, sequence)[-1][1]


def one_lift(robot: Robot, run: Run, facts: PayloadFacts) -> Problem:
    """A mass from one run of a robot whose numbers are taken as exact, with where and how fast the joint began.

    Args:
        robot: The arm.
        run: One lift.
        facts: The payload.
    """
    prepared = prepare_run(robot, run, None, facts)
    return Problem(
        robot,
        [prepared],
        facts,
        load_unknowns(
            robot,
            [prepared],
            facts,
            Role.FIXED,
            0.05,
        ),
    )


def box() -> tuple[Container, ContainerFacts, ContainerFacts]:
    """The box with its sphere, and what is stated of it: its shell was weighed, or is learnt from runs with the empty box."""
    held = Container()
    inner = np.array(held.inner_size_m)
    centre = np.array(held.centre_m)
    facts = ContainerFacts(Enclosure("box", inner, held.sphere_radius_m), centre)
    return held, replace(facts, mass=held.mass_kg, mass_std=0.0002), facts


def soft_cube(name: str) -> SoftBlock:
    """A cube between the virtual fingers."""
    modulus, ratio = CUBES[name]
    return SoftBlock(modulus, (EDGE_M,) * 3, BLOCK_DAMPING, GAP_M, ratio)


def squeezed(
    robot: Robot, run: Run, moduli: Sequence[float], ratio: float
) -> tuple[SqueezeProblem, np.ndarray]:
    """One squeeze of a cube as simulated with some moduli [Pa], nothing else unknown; and positions, shape (S, T).

    Args:
        robot: The arm.
        run: One squeeze.
        moduli: Young's moduli [Pa], S of them.
        ratio: Poisson's.

    Returns:
        The problem, and the positions of the joint [rad], shape (S, T).
    """
    facts = BlockFacts(np.full(3, EDGE_M))
    prepared = prepare_run(robot, run, KnownLoad(), past_fast=True)
    unknowns = [
        u if u.kind == "youngs_modulus" else replace(u, role=Role.FIXED)
        for u in block_unknowns(robot, [prepared], [True], facts, Role.FIXED)
    ]
    problem = SqueezeProblem(
        robot,
        [prepared],
        facts,
        [True],
        unknowns,
        step_s=1.0 / 480.0,
    )
    values = np.tile(problem.base, (len(moduli), 1))
    values[:, problem.index["youngs_modulus"]] = moduli
    values[:, problem.index["poissons_ratio"]] = ratio
    values[:, problem.index["gap", 0]] = 2.0 * GAP_M
    q, _, _ = problem.simulate(values, problem.estimated)
    return problem, q[:, 0, : problem.runs[0].used]
