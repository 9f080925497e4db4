"""The ways of identifying that are compared, each as one call from a run to numbers."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np

from proprio_ros.addons.paper.softbody import SOFT_INDEX, SoftBody, SoftRun
from proprio_ros.addons.paper.softbody_kernels import SOFT_PARAMETERS
from proprio_ros.identification.estimate import Estimate
from proprio_ros.identification.prepared_runs import KnownLoad, PreparedRun, prepare_run
from proprio_ros.identification.solvers import adam_descent
from proprio_ros.identification.unknowns import Role
from proprio_ros.probes.container import problem
from proprio_ros.probes.payload.paper import PaperOptions, last_frame_loss
from proprio_ros.records import Run
from proprio_ros.robot import Robot
from proprio_ros.sim.energies import young
from proprio_ros.sim.joint import JointRun
from proprio_ros.sim.mesh import box
from proprio_ros.sim.payload import PayloadFacts

_Answer = TypeVar("_Answer")
_Loss = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]

SPHERE_STARTS_KG = (0.002, 0.006, 0.015, 0.04, 0.1)
LIGHTEST_SPHERE_KG = 0.001
# of Adam for the sphere [kg per iteration]: the authors' 10 g would step over a sphere of 12 g
SPHERE_RATE = 0.002
SPHERE_ITERATIONS = 200
SQUEEZE_FRAME_S = 1.0 / 60.0
SQUEEZE_SUBSTEPS = 192
# of Adam for the cube, in logarithms of the Lame parameters: with the authors' 0.01 it would not arrive
CUBE_RATE = 0.15
CUBE_ITERATIONS = 30


@dataclass(frozen=True)
class Answer:
    """What one way said."""

    value: float | None  # in SI units; None where it gives none
    low: float | None = None  # of its 95 % interval; None where it has none
    high: float | None = None  # of the same
    # of a processor to the answer, with everything loaded and compiled
    seconds: float | None = None
    verdict: str = ""  # of ours; empty for a way that gives none
    why: str = ""  # first reason, where there is no value

    def row(self, **labels: Any) -> dict[str, Any]:
        """As plain values with what it belongs to."""
        return {**labels, **self.__dict__}


def timed(
    function: Callable[[], _Answer],
    warm_up: Callable[[], object] | None = None,
) -> tuple[_Answer, float]:
    """The outcome of a function and its time on a processor [s]; a first call of it, or of ``warm_up``, loads and compiles."""
    (warm_up or function)()
    started = time.process_time()
    return function(), time.process_time() - started


def ours(identify: Callable[[], Estimate], name: str) -> Answer:
    """The package's own answer."""
    estimate, seconds = timed(identify)
    return answered(estimate, name, seconds)


def answered(estimate: Estimate, name: str, seconds: float | None = None) -> Answer:
    """A value of an estimate as an answer.

    Args:
        estimate: Whose value it is.
        name: Of the value.
        seconds: What it took.
    """
    value = estimate.value(name)
    low, high = (None, None) if value.ci95 is None else value.ci95
    why = (
        ""
        if estimate.verdict.value == "accepted" or not estimate.reasons
        else str(estimate.reasons[0])
    )
    number = value.value if isinstance(value.value, float) else None
    return Answer(number, low, high, seconds, estimate.verdict.value, why)


def paper_mass(robot: Robot, run: Run, facts: PayloadFacts) -> Answer:
    """The paper's way with a schedule long enough to reach the least error, from five starts.

    Args:
        robot: The arm, taken as exact.
        run: One lift.
        facts: The payload.
    """
    options = PaperOptions()
    make = partial(last_frame_loss, robot, run, facts, options)
    return _descended(
        make, options.starts_kg, options.learning_rate, options.extended_iterations, 1e-6
    )


def _descended(
    make_loss: Callable[[], _Loss],
    starts_kg: Sequence[float],
    rate_kg: float,
    most: int,
    lightest_kg: float,
) -> Answer:
    """Where Adam ends best on a loss of one mass, from several starts; making the loss counts in its time."""

    def solve(iterations: int) -> float:
        found = adam_descent(
            make_loss(), np.array(starts_kg)[:, None], rate_kg, iterations, lower=lightest_kg
        )
        return float(found.internal[found.best, 0])

    mass, seconds = timed(partial(solve, most), partial(solve, 1))
    return Answer(mass, seconds=seconds)


class SphereLastFrame:
    """The paper's loss for the sphere in a container: its contact law, semi-implicit Euler, last frame, one unknown.

    Of one lift, with the shell's mass stated; with ``all_samples`` of all of them instead of the last frame.
    """

    def __init__(
        self, robot: Robot, run: Run, facts: problem.ContainerFacts, all_samples: bool = False
    ) -> None:
        facts = replace(facts, law="paper")
        prepared = prepare_run(robot, replace(run, held_position={}), None, facts.shell)
        kept = slice(0 if all_samples else prepared.used - 1, prepared.used)
        self.samples = kept.stop - kept.start
        compared = replace(
            prepared.run,
            times_s=run.times_s[kept],
            position=run.position[kept],
        )
        at_end: PreparedRun = replace(
            prepared, run=compared, used=self.samples, sigma=np.ones(self.samples)
        )
        nothing = JointRun(prepared.times_s, run.input_times_s, run.input_current_A)
        prior = problem.start_prior(
            problem.sphere_run(robot, prepared, facts, nothing), facts, prepared.rest.value
        )
        unknowns = [
            u if u.kind == "sphere_mass" else replace(u, role=Role.FIXED)
            for u in problem.container_unknowns(robot, [at_end], [True], facts, [prior], Role.FIXED)
        ]
        self.problem = problem.ContainerProblem(
            robot, [at_end], facts, [True], unknowns, "semi_implicit"
        )

    def __call__(
        self,
        mass: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Loss (S,) [rad^2] and gradient (S, 1) at masses (S, 1)."""
        internal = self.problem.coordinates.internal(mass)
        cost, gradient, _ = self.problem.linearise(internal)
        return 2.0 * cost, 2.0 * gradient / self.problem.coordinates.slope(internal)


def paper_sphere(robot: Robot, run: Run, facts: problem.ContainerFacts) -> Answer:
    """The paper's way for the sphere's mass, from five starts.

    Args:
        robot: The arm, taken as exact.
        run: One run of the container.
        facts: The container.
    """
    make = partial(SphereLastFrame, robot, run, facts)
    return _descended(make, SPHERE_STARTS_KG, SPHERE_RATE, SPHERE_ITERATIONS, LIGHTEST_SPHERE_KG)


class SqueezeLastFrame:
    """The paper's loss for a soft block: explicit elastodynamics of tetrahedra, last frame, both Lame parameters.

    The cube has an edge and a mass [kg]; the fingers together close by the gap before they touch it.
    """

    def __init__(
        self,
        robot: Robot,
        run: Run,
        edge_m: float,
        gap_m: float,
        mass: float,
    ) -> None:
        prepared = prepare_run(robot, run, KnownLoad(), past_fast=True)
        drive = prepared.drive
        times = prepared.times_s
        current = float(run.input_current_A[np.argmax(np.abs(run.input_current_A))])
        self._target = float(np.sign(current) * (prepared.position[-1] - prepared.rest.value))
        mesh = box(np.full(3, edge_m), (2, 2, 2))
        self._body = SoftBody(mesh, mass, 2.0 * drive.transmission, contact="frictionless")
        frames = round(float(times[-1]) / SQUEEZE_FRAME_S)
        self._run = SoftRun(
            np.zeros(1),
            np.array([abs(current)]),
            frames,
            times[-1] / frames,
            SQUEEZE_SUBSTEPS,
        )
        given = {
            name: getattr(drive, name).value for name in ("torque_constant", "coulomb", "viscous")
        }
        given |= {
            "inertia": drive.armature.value + float(prepared.coefficients.arm[0]),
            "gap": gap_m,
        }
        self._p = np.array([given.get(name, 0.0) for name in SOFT_PARAMETERS])

    def __call__(
        self,
        logarithms: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Loss (S,) [rad^2] and gradient (S, 2) at logarithms of mu and lambda (S, 2)."""
        rows = [SOFT_INDEX["lame_mu"], SOFT_INDEX["lame_lambda"]]
        p = np.tile(self._p, (len(logarithms), 1))
        p[:, rows] = np.exp(logarithms)
        rolled = self._body.rollout(self._run, p, "starts")
        off = rolled.q[:, -1] - self._target
        weights = np.zeros_like(rolled.q)
        weights[:, -1] = 2.0 * off
        return off**2, rolled.gradient(weights)[:, rows] * p[:, rows]


def paper_cube(
    robot: Robot,
    run: Run,
    edge_m: float,
    gap_m: float,
    mass: float,
    start_Pa: tuple[float, float],
) -> Answer:
    """The paper's way for a soft cube, from one first guess of its Lame parameters; the answer is Young's modulus [Pa].

    Args:
        robot: The arm, taken as exact.
        run: One squeeze.
        edge_m: Of the cube [m].
        gap_m: How far the fingers come together before both touch it [m].
        mass: Of the cube [kg].
        start_Pa: First guess of mu and lambda [Pa].
    """
    started = time.process_time()
    loss = SqueezeLastFrame(robot, run, edge_m, gap_m, mass)
    first = np.log(np.array([start_Pa]))
    found = adam_descent(
        loss, first, CUBE_RATE, CUBE_ITERATIONS, first - np.log(10.0), first + np.log(10.0)
    )
    modulus, _ = young(*np.exp(found.internal[0]).tolist())
    return Answer(modulus, seconds=time.process_time() - started)
