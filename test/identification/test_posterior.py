"""What is known after a fit: a run predicted by the others, against a fit that never saw it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from proprio_ros.identification import solvers
from proprio_ros.identification.posterior import Posterior
from proprio_ros.identification.prepared_runs import KnownLoad, prepare_run
from proprio_ros.identification.problem import Problem
from proprio_ros.identification.robot_unknowns import robot_unknowns
from proprio_ros.identification.unknowns import Role
from proprio_ros.pipeline.loading import bag_runs
from proprio_ros.pipeline.request import Request
from proprio_ros.robot import load_robot
from proprio_ros.sim.payload import PayloadFacts


@pytest.fixture(scope="module")
def fitted(recordings: Path):
    """Six empty runs of the elbow, everything open, at their best fit."""
    robot = load_robot("open_manipulator_x")
    prepared = []
    for folder in sorted((recordings / "realistic_s00").glob("empty_0[0-5]_joint3")):
        prepared += [
            prepare_run(robot, run, KnownLoad())
            for run in bag_runs(folder / "bag_mcap", Request(robot))
        ]
    problem = Problem(
        robot,
        prepared,
        PayloadFacts(),
        robot_unknowns(robot, prepared, Role.ESTIMATED),
    )
    start = problem.coordinates.internal(problem.base[problem.estimated])[None]
    solution = solvers.levenberg_marquardt(problem, start, problem.simulator.windows)
    return (
        robot,
        prepared,
        problem,
        problem.all_values(problem.coordinates.physical(solution.internal))[0],
    )


def predicted_without(
    fitted,
    out: int,
) -> np.ndarray:
    """Values of all unknowns by the other runs alone; the run's own fall back to their priors."""
    robot, prepared, problem, values = fitted
    others = [run for row, run in enumerate(prepared) if row != out]
    small = Problem(
        robot,
        others,
        PayloadFacts(),
        robot_unknowns(robot, others, Role.ESTIMATED),
    )
    solution = solvers.levenberg_marquardt(
        small,
        small.coordinates.internal(_moved(problem, small, values, out)[small.estimated])[None],
        None,
    )
    found = small.all_values(small.coordinates.physical(solution.internal))[0]
    predicted = problem.base.copy()
    for unknown, value in zip(small.unknowns, found, strict=True):
        if unknown.shared:
            predicted[problem.index[unknown.key]] = value
    return predicted


def test_held_out_residuals_are_those_of_a_fit_without_the_run(fitted) -> None:
    _, prepared, problem, values = fitted
    posterior = Posterior(problem, values)
    for out in (1, 4):
        q, _, _ = problem.simulate(
            predicted_without(fitted, out)[None],
            problem.estimated,
        )
        used = prepared[out].used
        expected = prepared[out].position - q[0, out, :used]
        residual, chi2 = posterior.held_out(out)
        # the model bends a little between the two fits
        assert (
            np.sqrt(np.mean((residual - expected) ** 2))
            < 0.25 * np.sqrt(np.mean(expected**2)) + 3e-4
        )
        assert 0.2 * len(residual) < chi2 < 2.5 * len(residual)


@pytest.mark.parametrize("kind", ["v0", "onset", "disturbance", "coulomb"])
def test_a_fit_that_ends_near_its_least_cost_predicts_runs_as_the_best_one_does(
    fitted, kind: str
) -> None:
    """A tenth of a standard deviation away; of what only one run determines, that little made a contradiction of a million."""
    _, prepared, problem, values = fitted
    start = problem.coordinates.internal(values[problem.estimated])[None]
    found = solvers.levenberg_marquardt(
        problem,
        start,
        None,
        iterations=100,
        tolerance=1e-8,
    )
    best = problem.all_values(problem.coordinates.physical(found.internal))[0]
    known = Posterior(problem, best)
    stds = dict(
        zip(
            problem.estimated.tolist(),
            np.sqrt(np.diag(known.covariance)),
            strict=True,
        )
    )
    near = best.copy()
    for row, unknown in enumerate(problem.unknowns):
        if unknown.kind == kind:
            near[row] += 0.1 * stds[row]
    for run in range(len(prepared)):
        (residual, chi2), (expected, least) = (
            each.held_out(run) for each in (Posterior(problem, near), known)
        )
        assert (
            np.sqrt(np.mean((residual - expected) ** 2))
            < 0.1 * np.sqrt(np.mean(expected**2)) + 5e-5
        )
        assert chi2 == pytest.approx(least, rel=0.1)


def _moved(
    problem: Problem,
    small: Problem,
    values: np.ndarray,
    out: int,
) -> np.ndarray:
    """Start values of the smaller problem: the larger one's, runs renumbered."""
    start = small.base.copy()
    for row, unknown in enumerate(small.unknowns):
        scope = unknown.scope
        larger = unknown if unknown.shared else replace(unknown, scope=scope + (scope >= out))
        start[row] = values[problem.index[larger.key]]
    return start


def test_a_run_with_something_in_the_hand_is_predicted_badly(fitted, recordings: Path) -> None:
    robot, prepared, _, _ = fitted
    folder = recordings / "realistic_s00" / "fixed_heavy_cube_23g_joint3" / "bag_mcap"
    outlier = [prepare_run(robot, run, KnownLoad()) for run in bag_runs(folder, Request(robot))]
    runs = [*prepared, *outlier]
    problem = Problem(
        robot,
        runs,
        PayloadFacts(),
        robot_unknowns(robot, runs, Role.ESTIMATED),
    )
    start = problem.coordinates.internal(problem.base[problem.estimated])[None]
    solution = solvers.levenberg_marquardt(problem, start, problem.simulator.windows)
    values = problem.all_values(problem.coordinates.physical(solution.internal))[0]
    posterior = Posterior(problem, values)
    chi2 = [off / len(residual) for residual, off in map(posterior.held_out, range(len(runs)))]
    assert np.argmax(chi2) == len(runs) - 1 and chi2[-1] > 3.0


def test_the_covariance_shrinks_with_every_run_and_never_beats_the_prior(fitted) -> None:
    robot, prepared, problem, values = fitted
    whole = Posterior(problem, values).whole_covariance()
    stds = np.array([u.std for u in problem.unknowns])
    assert np.all(np.sqrt(np.diag(whole)) <= stds * (1.0 + 1e-9))
    one = Problem(
        robot,
        prepared[:1],
        PayloadFacts(),
        robot_unknowns(
            robot,
            prepared[:1],
            Role.ESTIMATED,
        ),
    )
    single = Posterior(
        one, np.array([values[problem.index[key]] for key in one.index])
    ).whole_covariance()
    for key in (("coulomb", "joint3"), ("armature", "joint3"), ("torque_constant", "joint3")):
        assert (
            whole[problem.index[key], problem.index[key]] < single[one.index[key], one.index[key]]
        )


def test_inflation_widens_the_data_not_the_prior(fitted) -> None:
    robot, prepared, problem, values = fitted
    known = [
        replace(u, role=Role.FIXED) if u.name.startswith("link") else u for u in problem.unknowns
    ]
    fewer = Problem(robot, prepared, PayloadFacts(), known)
    narrow, wide = (Posterior(fewer, values, inflation) for inflation in (1.0, 4.0))
    np.testing.assert_allclose(wide.residual, 0.5 * narrow.residual)
    assert np.all(np.diag(wide.covariance) >= np.diag(narrow.covariance) * (1.0 - 1e-9))
    assert np.all(np.diag(wide.covariance) <= 4.0 * np.diag(narrow.covariance) * (1.0 + 1e-9))
