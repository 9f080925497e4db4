"""A probe outside the package: how stiff is a spring at the elbow?

A law, an unknown, a virtual object, a baseline, a sequence (spring.yaml), a class, and the line that registers it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import warp as wp

from proprio_ros.errors import ConfigurationError
from proprio_ros.identification import solvers
from proprio_ros.identification.conclude import Conclusion
from proprio_ros.identification.estimate import Estimate, SolverSummary, Value
from proprio_ros.identification.fit import FitResult, SearchOptions, summary
from proprio_ros.identification.gates import MISFIT_LIMIT, Findings
from proprio_ros.identification.judge import Refusal, rejected
from proprio_ros.identification.prepared_runs import KnownLoad, prepare_run
from proprio_ros.identification.problem import Problem
from proprio_ros.identification.robot_unknowns import robot_unknowns
from proprio_ros.identification.unknowns import Role, Unknown
from proprio_ros.inputs.forms import Number
from proprio_ros.inputs.settings import Settings
from proprio_ros.kinds import Kind
from proprio_ros.probes.base import Baseline, Example, HasBaseline, Recorded
from proprio_ros.quantity import Z95
from proprio_ros.records import Run
from proprio_ros.robot import Robot
from proprio_ros.sim.joint import JointRun, JointSimulator, harmless
from proprio_ros.sim.joint_kernels import (
    CARRIED,
    CURRENT,
    GRAVITY_CONSTANT,
    LOAD,
    LOAD_PER_KG,
    PARAMETERS,
    VEC2,
    VEC3,
    JointData,
    linearised_acceleration,
    one_joint_law,
)
from proprio_ros.sim.payload import PayloadFacts
from proprio_ros.sim.rollout_kernels import Law
from proprio_ros.sim.runtime import FLOAT
from proprio_ros.virtual.objects import HandObject

STIFFNESS = wp.constant(len(PARAMETERS))


@cache
def spring_law(directions: int, stribeck: bool) -> Law:
    """The joint of ``sim/joint.py`` with a spring between it and its zero."""
    vec = wp.types.vector(length=directions, dtype=FLOAT)
    mat = wp.types.matrix(
        shape=(2, directions),
        dtype=FLOAT,
    )
    acceleration = linearised_acceleration(directions, stribeck)

    @wp.func
    def rates(
        y: VEC2, dy: mat, u: VEC3, p: wp.array2d(dtype=FLOAT), dp: wp.array2d(dtype=vec), w: wp.int32, data: JointData,
        r: wp.int32,
    ):  # fmt: skip
        load = (
            p[w, GRAVITY_CONSTANT]
            + u[LOAD]
            + p[w, CARRIED] * u[LOAD_PER_KG]
            + p[w, STIFFNESS] * y[0]
        )
        d_load = dp[w, GRAVITY_CONSTANT] + u[LOAD_PER_KG] * dp[w, CARRIED]
        d_load = d_load + p[w, STIFFNESS] * dy[0] + y[0] * dp[w, STIFFNESS]
        a, da = acceleration(
            y[0], y[1], dy[0], dy[1], u[CURRENT], load, d_load, p, dp, w, data.constants, r
        )
        return VEC2(y[1], a), wp.matrix_from_rows(
            dy[1],
            da,
        )

    return one_joint_law(directions, JointData, rates)


class SpringSimulator(JointSimulator):
    parameters = (*PARAMETERS, "spring_stiffness")
    harmless = harmless(parameters)

    def law_of(self, size: int, stribeck: bool) -> Law:
        return spring_law(size, stribeck)


@dataclass(frozen=True)
class VirtualSpring(HandObject):
    """A spring between the elbow of the virtual arm and its zero [N m/rad]."""

    kind = "spring"
    form = "spring:0.4"
    keys = MappingProxyType({"stiffness": ("stiffness", 1)})

    stiffness: float

    def __post_init__(self) -> None:
        if self.stiffness < 0.0:
            raise ConfigurationError(f"stiffness={self.stiffness:g}: a spring pulls back")

    @property
    def emptied(self) -> None:
        """The arm with the spring taken off."""
        return

    def build(
        self,
        mujoco: Any,
        spec: Any,
        hand: Any,
    ) -> None:
        spec.joint("joint3").stiffness[0] = self.stiffness


class SpringProblem(Problem):
    """Some runs with the spring, and those of the baseline behind them without it."""

    with_spring: int

    def simulator_of(
        self,
        runs: list[JointRun],
        integrator: str,
    ) -> JointSimulator:
        return SpringSimulator(runs, integrator)

    def all_parameters(
        self,
        values: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        p, dp = super().all_parameters(values)
        p[:, : self.with_spring, STIFFNESS] = values[:, None, self.index["spring_stiffness"]]
        dp[:, : self.with_spring, STIFFNESS, self.index["spring_stiffness"]] = 1.0
        return p, dp


def find_spring(
    robot: Robot,
    runs: Sequence[Run],
    prior: float,
    baseline: Sequence[Run] = (),
) -> Estimate:
    prepared = [prepare_run(robot, run, KnownLoad()) for run in (*runs, *baseline)]

    unknowns = [
        Unknown("spring_stiffness", 0.0, prior, -10.0, 10.0),
        *robot_unknowns(robot, prepared, Role.ESTIMATED),
    ]
    problem = SpringProblem(robot, prepared, PayloadFacts(), unknowns)
    problem.with_spring = len(runs)
    starts = problem.coordinates.internal(problem.coordinates.prior_mean[None])
    fit = FitResult.of(
        problem,
        solvers.levenberg_marquardt(
            problem,
            starts,
            problem.simulator.windows,
            iterations=60,
        ),
    )
    return StiffnessFound(fit, fit, Findings(), len(runs)).estimate()


class StiffnessFound(Conclusion):
    probe = "spring"
    name = "spring_stiffness"

    def refusals(self) -> Iterator[Refusal]:
        if self.fit.reduced_chi2 > MISFIT_LIMIT:
            spring = "a spring does not explain the recording"
            yield rejected("misfit", "the model does not explain the recording", spring)

    def values(self, withheld: str) -> tuple[Value, ...]:
        if withheld:
            return (Value(self.name, "N m/rad", None, reason=withheld),)
        value = self.assessed.value
        std = self.assessed.std
        return (
            Value(
                self.name,
                "N m/rad",
                value,
                std,
                [value - Z95 * std, value + Z95 * std],
            ),
        )

    def solver(self) -> SolverSummary:
        return summary(
            self.fit,
            self.name,
            [0.0],
            self.assessed.std,
            self.fit.solution.iterations,
            SearchOptions(),
        )

    def assumptions(self) -> tuple[str, ...]:
        return ("a spring between the joint and its zero",)


class Spring(HasBaseline[float]):
    name = "spring"
    subject = "spring"
    answer = ("spring_stiffness", "N m/rad")
    keys = ("spring.",)
    unknowns = MappingProxyType({"spring_stiffness": Kind("N m/rad", "stiffness of the spring")})
    virtual_object = VirtualSpring
    default_sequence = str(Path(__file__).with_name("spring.yaml"))
    baseline = Baseline(
        noun="arm without its spring",
        hand="the spring has to be taken off",
        question="is the spring off?",
        missing="take the spring off and call ~/record_spring_baseline",
    )
    example = Example(
        flag="stiffness",
        metavar="N.M/RAD",
        help="of the spring",
        truth=0.4,
        lowest=0.0,
        highest=10.0,
        units="stiffness is in N m/rad",
        held="spring:{truth:g}",
        now="now a spring is at its elbow",
        was="the virtual arm's spring was",
        takes="under a minute",
        sequences={"robot_sequence": "empty_hand_elbow"},
        reference=False,
    )

    def facts(
        self,
        settings: Settings,
        solver: str = "lm",
        profile: str = "default",
    ) -> float:
        prior: float = settings.take("spring.prior", 1.0, Number())
        return prior

    def identify(
        self,
        robot: Robot,
        recorded: Recorded,
        facts: float,
    ) -> Estimate:
        return find_spring(robot, recorded.runs, facts, recorded.baseline)

    def needs_baseline(self, facts: float) -> bool:
        return False

    def baseline_settings(self, facts: float) -> dict[str, object]:
        return {}

    def sections(self, estimate: Estimate) -> list[str]:
        return ["<h2>The spring</h2>"]
