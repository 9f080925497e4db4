"""A calibration of sixteen runs, and a weighing with it: our times, and scipy's ``least_squares`` on the same calibration."""

from __future__ import annotations

from pathlib import Path

import case as cases
import numpy as np
from case import Case, Row, measure
from scipy.optimize import least_squares

from proprio_ros.experiment_design.planning import with_advice
from proprio_ros.identification.calibration_fit import fit
from proprio_ros.identification.prepared_runs import KnownLoad, prepare_run
from proprio_ros.identification.problem import Problem
from proprio_ros.identification.robot_calibration import LoadedRun, calibrate
from proprio_ros.identification.robot_unknowns import robot_unknowns
from proprio_ros.identification.unknowns import Role
from proprio_ros.pipeline.loading import bag_runs
from proprio_ros.pipeline.request import DEFAULT_ROBOT, Request
from proprio_ros.probes.payload.identify import weigh
from proprio_ros.robot import Robot, load_robot
from proprio_ros.sim.payload import PayloadFacts

BAGS = Path(__file__).resolve().parents[2] / "bags"
CALIBRATION_S = 5.0
WEIGHING_S = 0.1
GOAL = 20.0


def empty_runs(robot: Robot) -> list[LoadedRun]:
    """The sixteen empty-hand runs that come with the package."""
    folders = sorted(BAGS.glob("realistic_s00_empty_*"))
    return [
        LoadedRun(run) for path in folders for run in bag_runs(path / "bag_mcap", Request(robot))
    ]


def scipy_cost(
    robot: Robot,
    known: list[LoadedRun],
) -> tuple[float, float]:
    """Time [s] and end cost of scipy's trust region on our residuals, Jacobian by its forward differences, from one start."""
    runs = [prepare_run(robot, loaded.run, KnownLoad()) for loaded in known]
    problem = Problem(
        robot,
        runs,
        PayloadFacts(),
        robot_unknowns(robot, runs, Role.ESTIMATED),
    )
    coordinates = problem.coordinates
    seen = problem.weight > 0.0

    def residual(x: np.ndarray) -> np.ndarray:
        q, _, _ = problem.simulate(
            problem.all_values(x[None]),
            problem.estimated[:1],
        )
        left = ((q[0] - problem.measured) * problem.weight)[seen]
        return np.append(
            left,
            (x - coordinates.prior_mean) / coordinates.natural,
        )

    start = coordinates.prior_mean.copy()
    for f, row in enumerate(problem.estimated):
        if problem.unknowns[row].name.startswith("coulomb["):
            start[f] = 0.02
    bounds = (
        np.minimum(
            coordinates.lower,
            start - 1e-9,
        ),
        coordinates.upper,
    )
    found = None

    def solve() -> None:
        nonlocal found
        found = least_squares(
            residual,
            start,
            x_scale=coordinates.natural,
            bounds=bounds,
            max_nfev=2 if cases.once else 60,
        )

    seconds = measure(solve, repeats=1, warm_up=0).median
    assert found is not None
    return seconds, float(found.cost)


def rows(case: Case) -> list[Row]:
    """The comparison; the benchmark's own recording is not used."""
    robot = load_robot(DEFAULT_ROBOT)
    known = empty_runs(robot)
    ours = measure(
        lambda: calibrate(robot, known),
        repeats=5,
        warm_up=1,
    )
    whole = measure(
        lambda: with_advice(robot, calibrate(robot, known)),
        repeats=3,
        warm_up=0,
    )
    estimate = calibrate(robot, known)
    assert estimate.calibration is not None
    calibrated = robot.with_calibration(estimate.calibration)
    (run,) = bag_runs(
        BAGS / "realistic_s00_fixed_heavy_ball_50g_joint3" / "bag_mcap", Request(robot)
    )
    weighing = measure(
        lambda: weigh(calibrated, [run]),
        repeats=20,
        warm_up=2,
    )
    prepared = [prepare_run(robot, loaded.run, loaded.load) for loaded in known]
    once = measure(
        lambda: fit(robot, prepared),
        repeats=3,
        warm_up=0,
    )
    seconds, cost = scipy_cost(robot, known)
    ratio = seconds / once.median
    return [
        Row(
            "calibrate(): 16 runs, 116 unknowns, three starts, noise learnt",
            ours,
            f"{ours.median:.2f} s (goal <= {CALIBRATION_S:g})",
            ours.median <= CALIBRATION_S,
        ),
        Row("the same with advice on the next run", whole),
        Row(
            "weigh() with the calibration",
            weighing,
            f"{1e3 * weighing.median:.0f} ms (goal <= {1e3 * WEIGHING_S:g})",
            weighing.median <= WEIGHING_S,
        ),
        Row(
            "scipy least_squares on our residuals, forward differences, one start, noise given",
            None,
            f"{ratio:.0f}x (goal >= {GOAL:g}x)",
            ratio >= GOAL,
            f"{seconds:.1f} s, ends at cost {cost:.1f}",
        ),
    ]
