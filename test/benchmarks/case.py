"""The recording that every contestant identifies, and how time is taken."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from proprio_ros.identification.prepared_runs import PreparedRun, prepare_run
from proprio_ros.identification.problem import Problem
from proprio_ros.identification.robot_unknowns import load_unknowns
from proprio_ros.identification.solvers import Solution, levenberg_marquardt
from proprio_ros.identification.unknowns import Role
from proprio_ros.inputs.settings import Settings
from proprio_ros.pipeline.request import DEFAULT_ROBOT
from proprio_ros.probes.payload.facts import payload_facts
from proprio_ros.recordings.runs import cut_runs
from proprio_ros.recordings.signals import read_recording
from proprio_ros.records import Run
from proprio_ros.robot import Robot, load_robot
from proprio_ros.sim.payload import PayloadFacts

REPOSITORY = Path(__file__).resolve().parents[2]
BAG = REPOSITORY / "bags" / "quantised_s00_fixed_heavy_ball_50g_joint3" / "bag_mcap"
STARTS_KG = (0.005, 0.016, 0.05, 0.16, 0.5)
BALL = {
    "com": [0.0, 0.0, 0.0],
    "com_std": [0.0, 0.0, 0.0],
    "shape": "sphere",
    "size": 0.04,
    "size_std_relative": 1.0,
}
"""The probe file's ball, 40 mm: the same mass distribution for everybody."""
AGREEMENT_KG = 3e-4
"""Methods that find masses further apart than this do not solve the same problem, and their times are not compared."""
REPEATS = 7
once = False
"""Whether everything is timed by a single call: enough to see that it runs, and no figure."""


@dataclass(frozen=True)
class Timing:
    """Wall times of one thing [s]."""

    median: float
    fastest: float
    repeats: int


def measure(
    function: Callable[[], Any],
    repeats: int = REPEATS,
    calls: int = 1,
    warm_up: int = 1,
) -> Timing:
    """Time a function.

    Args:
        repeats: how many times are taken.
        calls: calls per time, for what takes microseconds.
        warm_up: calls before the first.
    """
    if once:
        repeats = 1
        calls = 1
        warm_up = 0
    for _ in range(warm_up):
        function()
    times = []
    for _ in range(repeats):
        started = time.perf_counter()
        for _ in range(calls):
            function()
        times.append((time.perf_counter() - started) / calls)
    return Timing(statistics.median(times), min(times), repeats)


class Kept:
    """A function with what it gave last; called once before it is timed, but where everything is timed by a single call."""

    def __init__(self, function: Callable[[], Any]) -> None:
        self._function = function
        self.answer = None if once else function()

    def __call__(self) -> None:
        self.answer = self._function()


def measure_in_turn(
    functions: Sequence[Callable[[], Any]],
    repeats: int,
    calls: Sequence[int],
    warm_up: int = 1,
) -> list[Timing]:
    """Time functions by turns, so that whatever else the machine does slows all of them alike.

    Args:
        calls: of each function in its turn.
        warm_up: calls in each turn that are not timed.
    """
    turns = [
        [
            measure(f, repeats=1, calls=n, warm_up=warm_up).median
            for f, n in zip(functions, calls, strict=True)
        ]
        for _ in range(1 if once else repeats)
    ]
    return [
        Timing(statistics.median(times), min(times), len(turns))
        for times in zip(*turns, strict=True)
    ]


@dataclass(frozen=True)
class Row:
    """One line of the table.

    Attributes:
        what: what was timed.
        timing: how long it took; None for a line that says why there is none.
        ratio: the number that is the goal, or that helps to read it; empty for none.
        passed: whether the goal was met; None when the line has no goal.
        note: the rest.
    """

    what: str
    timing: Timing | None = None
    ratio: str = ""
    passed: bool | None = None
    note: str = ""


@dataclass(frozen=True)
class Case:
    """The problem, built.

    Attributes:
        run, prepared: what was recorded, and the window of it that counts.
        problem: unknown mass, start position and start velocity; the last two with their priors. No friction.
        starts: the five first guesses in solver coordinates, shape (5, 3).
        answer: our own.
    """

    robot: Robot
    run: Run
    facts: PayloadFacts
    prepared: PreparedRun
    problem: Problem
    starts: np.ndarray
    answer: Solution | None = None

    @property
    def mass(self) -> float:
        """Our mass [kg]."""
        assert self.answer is not None
        return float(self.masses(self.answer.internal)[self.answer.best])

    @property
    def step_s(self) -> float:
        """Our integration step [s]."""
        return float(self.problem.simulator.runs[0].step_s)

    def solve(self) -> Solution:
        """Our identification: the problem is built and everything is warm."""
        return levenberg_marquardt(
            self.problem,
            self.starts,
            self.problem.simulator.windows,
        )

    def masses(self, internal: np.ndarray) -> np.ndarray:
        """Masses [kg] of solver coordinates (S, 3)."""
        return self.problem.coordinates.physical(internal)[:, 0]

    def parameters(
        self,
        masses: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Simulator parameters (S, P) and their derivative by the three unknowns (S, P, 3), each start at its prior."""
        values = np.tile(
            self.problem.coordinates.prior_mean,
            (len(masses), 1),
        )
        values[:, 0] = masses
        p, dp = self.problem.parameters(
            self.problem.all_values(values),
            self.problem.estimated,
        )
        return np.ascontiguousarray(p[:, 0]), np.ascontiguousarray(dp[:, 0])


def load() -> Case:
    """Read the recording and solve it once."""
    robot = load_robot(DEFAULT_ROBOT)
    joints = list(robot.drive_trains)
    recording = read_recording(
        BAG,
        nominal_torque_constants={
            name: robot.drive_trains[name].nominal_torque_constant for name in joints
        },
        joint_order=joints,
    )
    (run,) = cut_runs(recording, joints=joints)
    facts = payload_facts(Settings({}), BALL)
    prepared = prepare_run(robot, run)
    if len(run.input_times_s) != 1 or any(
        getattr(prepared.drive, term).value != 0.0
        for term in ("coulomb", "viscous", "load_friction")
    ):
        raise SystemExit(
            f"{BAG}: the comparison wants one constant current, and a robot file without friction"
        )
    problem = Problem(
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
    names = [problem.unknowns[row].name for row in problem.estimated]
    if names != ["payload_mass", "q0[0]", "v0[0]"]:
        raise SystemExit(
            f"the comparison wants mass, start position and start velocity unknown, not {', '.join(names)}"
        )
    physical = np.tile(
        problem.coordinates.prior_mean,
        (len(STARTS_KG), 1),
    )
    physical[:, 0] = STARTS_KG
    starts = problem.coordinates.internal(physical)
    case = Case(robot, run, facts, prepared, problem, starts)
    return replace(case, answer=case.solve())


def compare(
    what: str,
    solve: Callable[[], tuple[np.ndarray, float]],
    goal: float,
    case: Case,
    repeats: int = 5,
) -> Row:
    """Time another method's whole identification beside ours; void unless it found our mass.

    Args:
        solve: returns where each of its starts ended and the one of them that it answers [kg].
        goal: how many times as long as ours it should take.
    """
    kept = Kept(solve)
    theirs, ours = measure_in_turn(
        (kept, case.solve),
        repeats,
        (1, 10),
        warm_up=0,
    )
    masses, best = kept.answer
    off = best - case.mass
    found = f"found {1e3 * best:.2f} g ({1e3 * off:+.2f} g), starts {', '.join(f'{1e3 * mass:.2f}' for mass in masses)}"
    if not abs(off) <= AGREEMENT_KG:
        return Row(what, theirs, "void", False, found)
    ratio = theirs.median / ours.median
    return Row(what, theirs, f"{ratio:.0f}x (goal >= {goal:g}x)", ratio >= goal, found)
