"""Where a search ended: its numbers against plain linear algebra and against chi-square computed anew."""

from __future__ import annotations

import itertools
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from proprio_ros.errors import ConfigurationError
from proprio_ros.identification.fit import (
    CHI2_95,
    ENCODER,
    PROFILE_HIGHEST,
    FitResult,
    SearchOptions,
    _split,
    error_budget,
    fit_both,
    misfit_profile,
    other_suspects,
    rivals,
    solve_load,
    summary,
    uncalibrated,
    unexplained,
)
from proprio_ros.identification.posterior import Posterior
from proprio_ros.identification.prepared_runs import prepare_run
from proprio_ros.identification.solvers import levenberg_marquardt
from proprio_ros.identification.unknowns import Role
from proprio_ros.pipeline.loading import bag_runs
from proprio_ros.pipeline.request import Request
from proprio_ros.robot import load_robot
from proprio_ros.sim.payload import PayloadFacts

BAGS = Path(__file__).resolve().parents[2] / "bags"
OPTIONS = SearchOptions(starts_kg=(0.005, 0.05, 0.5))


@pytest.fixture(scope="module")
def fit() -> FitResult:
    robot = load_robot("open_manipulator_x")
    (run,) = bag_runs(
        BAGS / "quantised_s00_fixed_heavy_ball_50g_joint3" / "bag_mcap", Request(robot)
    )
    solve = partial(
        solve_load,
        robot,
        [prepare_run(robot, run)],
        PayloadFacts(),
        OPTIONS,
    )
    return fit_both(solve, unexplained)[1]


def test_an_unknown_solver_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="--solver newton: choose one of"):
        SearchOptions("newton")


def test_chi_square_is_that_of_residuals_and_priors(fit: FitResult) -> None:
    problem = fit.problem
    internal = problem.coordinates.internal(fit.values[problem.estimated][None])
    cost, _, _ = problem.linearise(internal)
    assert fit.chi2 == pytest.approx(2.0 * float(cost[0]), rel=1e-6)
    # a search that goes on from there finds no other mass
    longer = FitResult.of(
        problem, levenberg_marquardt(problem, internal, None, iterations=100, tolerance=1e-9)
    )
    mass, std = fit.determined("payload_mass")
    assert longer.value_of("payload_mass") == pytest.approx(mass, abs=0.1 * std)
    assert fit.reduced_chi2 == fit.chi2 / fit.dof and fit.explains


def test_each_start_ends_at_the_same_mass(fit: FitResult) -> None:
    said = summary(fit, "payload_mass", OPTIONS.starts_kg, 1e-3, 7, OPTIONS)
    assert [path.end for path in said.paths] == fit.physical("payload_mass").tolist()
    assert not rivals(fit, "payload_mass", fit.value_of("payload_mass"), 1e-3, 0.05)
    far = fit.value_of("payload_mass") + 0.1
    assert rivals(fit, "payload_mass", far, 1e-3, 0.05) == pytest.approx(
        [fit.value_of("payload_mass")], abs=1e-6
    )


def test_the_budget_adds_up_to_the_variance(fit: FitResult) -> None:
    covariance = Posterior(fit.problem, fit.values).whole_covariance()
    budget = error_budget(fit, covariance)
    stds = [std for _, std in budget]
    assert stds == sorted(stds, reverse=True) and ENCODER in dict(budget)
    whole = fit.determined("payload_mass")[1] ** 2
    assert sum(std**2 for std in stds) == pytest.approx(whole, rel=1e-6)
    (reason,) = uncalibrated(
        fit.problem.robot,
        fit.problem.runs,
        budget,
    )
    assert (
        "has not been calibrated" in reason
        and f"{1e3 * max(s for n, s in budget if n != ENCODER):.1f} g" in reason
    )
    assert "outside what its file allows" in other_suspects(fit.problem.robot)[0]


@pytest.mark.parametrize("seed", range(3))
def test_shares_of_correlated_groups_are_their_shapley_values(seed: int) -> None:
    """Against the definition: gains of knowing a group, averaged over all orders, by conditioning a normal distribution."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(5, 5))
    prior, weights = root @ root.T, rng.normal(size=5)
    groups = {"a": [0, 3], "b": [1], "c": [2, 4]}

    def variance(known: list[int]) -> float:
        rest = [row for row in range(5) if row not in known]
        left = prior[np.ix_(rest, rest)]
        if known:
            across = prior[np.ix_(rest, known)]
            left = left - across @ np.linalg.solve(prior[np.ix_(known, known)], across.T)
        return float(weights[rest] @ left @ weights[rest])

    expected = dict.fromkeys(groups, 0.0)
    orders = list(itertools.permutations(groups))
    for order in orders:
        known: list[int] = []
        for name in order:
            before = variance(known)
            known = [*known, *groups[name]]
            expected[name] += (before - variance(known)) / len(orders)
    # without samples, the covariance of the result with each unknown is the prior's
    shares = _split(
        prior @ weights,
        np.linalg.inv(prior),
        groups,
    )
    assert shares == pytest.approx(expected, rel=1e-6)
    assert sum(shares.values()) == pytest.approx(variance([]), rel=1e-6)


def test_a_profile_is_least_at_the_fit_and_rises_to_both_sides(fit: FitResult) -> None:
    """Downwards as the parabola of the posterior's standard deviation; upwards friction meets its bound, and it is steeper."""
    posterior = Posterior(fit.problem, fit.values)
    mass, std = fit.determined("payload_mass")
    scan = misfit_profile(fit, "payload_mass", posterior, 1.0, mass, std)
    assert scan.level == CHI2_95 and scan.cost.max() < PROFILE_HIGHEST
    assert scan.values[np.argmin(scan.cost)] == pytest.approx(mass) and scan.cost.min() == 0.0
    below = scan.values < mass
    above = scan.values > mass
    assert below.sum() >= 3 and above.any()
    assert np.all(np.diff(scan.cost[below]) < 0.0) and np.all(np.diff(scan.cost[above]) > 0.0)
    off = (mass - scan.values[below]) / std
    np.testing.assert_allclose(
        scan.cost[below],
        off**2,
        rtol=0.3,
        atol=0.05,
    )


def test_what_is_frozen_stays_where_the_file_has_it(fit: FitResult) -> None:
    robot = fit.problem.robot
    runs = fit.problem.runs
    frozen = solve_load(robot, runs, PayloadFacts(), OPTIONS, Role.FIXED)
    constant = robot.drive_trains["joint3"].torque_constant
    assert frozen.value_of(("torque_constant", "joint3")) == constant.value
    assert fit.determined(("torque_constant", "joint3"))[1] <= 1.001 * constant.std
    assert frozen.chi2 >= fit.chi2
