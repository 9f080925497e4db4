"""The misfit over the answer, and what its uncertainty consists of: against fits and sums that are made here in another way."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from proprio_ros.identification import solvers
from proprio_ros.identification.estimate import Estimate
from proprio_ros.identification.fit import (
    CHI2_95,
    FitResult,
    SearchOptions,
    _split,
    misfit_profile,
    solve_load,
)
from proprio_ros.identification.posterior import Posterior
from proprio_ros.identification.prepared_runs import prepare_run
from proprio_ros.identification.problem import Problem
from proprio_ros.identification.unknowns import Role
from proprio_ros.pipeline.calibrate import calibrate_from_bags
from proprio_ros.pipeline.loading import bag_runs
from proprio_ros.pipeline.replay import replay
from proprio_ros.pipeline.request import Options, Request
from proprio_ros.quantity import Z95
from proprio_ros.robot import Robot, load_robot
from proprio_ros.sim.payload import PayloadFacts


def weighed(robot: Robot, bag: Path) -> FitResult:
    [run] = bag_runs(bag / "bag_mcap", Request(robot))
    prepared = [prepare_run(robot, run)]
    facts = PayloadFacts()
    nominal = solve_load(robot, prepared, facts, SearchOptions(), Role.FIXED)
    return solve_load(
        robot,
        prepared,
        facts,
        SearchOptions(),
        Role.ESTIMATED,
        start=nominal,
    )


@pytest.fixture(scope="module")
def opened(bags: Path) -> FitResult:
    """A weighing by a robot that was never calibrated."""
    return weighed(
        load_robot("open_manipulator_x"), bags / "quantised_s00_fixed_heavy_ball_50g_joint3"
    )


@pytest.fixture(scope="module")
def arm(bags: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    output = tmp_path_factory.mktemp("profile") / "arm.yaml"
    folders = sorted(bags.glob("realistic_s00_empty_0[0-5]_*"))
    calibrate_from_bags(
        [folder / "bag_mcap" for folder in folders],
        {},
        None,
        output,
    )
    return output


@pytest.fixture(scope="module")
def calibrated(bags: Path, arm: Path) -> Estimate:
    bag = bags / "realistic_s00_fixed_heavy_ball_50g_joint3" / "bag_mcap"
    return replay(
        [bag],
        Options(
            calibration=arm,
            settings={"payload.com": [0.0, 0.0, 0.0]},
        ),
    )


def profile_of(
    fit: FitResult, inflation: float = 1.0, std: float = 0.02
) -> tuple[np.ndarray, np.ndarray]:
    posterior = Posterior(fit.problem, fit.values, inflation)
    scan = misfit_profile(
        fit,
        "payload_mass",
        posterior,
        inflation,
        fit.values[0],
        std,
    )
    return scan.values, scan.cost


def test_everything_else_is_fitted_again_at_each_mass(opened: FitResult) -> None:
    """Against a fit in which the mass is no unknown, from the values of the fit in which it was one."""
    problem = opened.problem
    masses, chi2 = profile_of(opened)
    chosen = [1, len(masses) - 3]
    for row in chosen:
        unknowns = [
            replace(u, value=masses[row], std=0.0, role=Role.FIXED)
            if u.kind == "payload_mass"
            else u
            for u in problem.unknowns
        ]
        held = Problem(problem.robot, problem.runs, PayloadFacts(), unknowns)
        start = held.coordinates.internal(opened.values[held.estimated][None])
        again = FitResult.of(
            held,
            solvers.levenberg_marquardt(
                held,
                start,
                None,
                iterations=100,
                tolerance=1e-3,
            ),
        )
        assert again.chi2 - opened.chi2 == pytest.approx(
            chi2[row],
            abs=0.05,
            rel=0.02,
        )
    # with all else as fitted the same masses are out of the question: that was a needle in a wide band
    values = np.tile(opened.values, (2, 1))
    values[:, 0] = masses[chosen]
    seen, _, _ = problem.simulate(
        values,
        problem.estimated[:1],
    )
    slice_ = np.einsum(
        "srt,srt->s",
        *2 * [(seen - problem.measured) * problem.weight],
    )
    assert (slice_ > 100.0 * chi2[chosen]).all()


def test_the_profile_of_a_calibrated_robot_is_the_parabola_of_its_interval(
    calibrated: Estimate,
) -> None:
    scan = calibrated.scan
    value = calibrated.values[0]
    assert scan.level == pytest.approx(Z95**2) == pytest.approx(CHI2_95)
    assert scan.cost == pytest.approx(
        ((scan.values - value.value) / value.std) ** 2, rel=0.03, abs=0.02
    )


def test_coarser_samples_widen_it_as_they_widen_the_interval(bags: Path, arm: Path) -> None:
    fit = weighed(load_robot(str(arm)), bags / "realistic_s00_fixed_heavy_ball_50g_joint3")
    inflation = 100.0
    std = float(np.sqrt(Posterior(fit.problem, fit.values, inflation).whole_covariance()[0, 0]))
    alone = float(np.sqrt(Posterior(fit.problem, fit.values).whole_covariance()[0, 0]))
    assert alone * 1.05 < std < alone * np.sqrt(inflation) / 1.05, "the priors stay"
    masses, chi2 = profile_of(fit, inflation, 0.2 * std)  # so near that it is a parabola
    assert chi2 == pytest.approx(
        ((masses - fit.values[0]) / std) ** 2,
        rel=0.03,
        abs=0.002,
    )


def test_a_profile_of_nothing_is_empty(opened: FitResult) -> None:
    assert len(profile_of(replace(opened, chi2=np.inf))[0]) == 0


def test_what_a_calibration_leaves_open_is_named(calibrated: Estimate) -> None:
    parts = dict(calibrated.budget)
    ours = {
        source.removeprefix("calibration: ") for source in parts if source.startswith("calibration")
    }
    assert {"torque constants", "friction", "armatures", "arm masses", "delay"} <= ours
    total = sum(std**2 for std in parts.values())
    assert total == pytest.approx(calibrated.values[0].std ** 2, rel=1e-3), (
        "the parts add up to the interval"
    )


def test_shares_of_correlated_unknowns_add_up_and_are_fair() -> None:
    rng = np.random.default_rng(5)
    root = rng.normal(size=(5, 5)) * np.array([1e-3, 1.0, 10.0, 1.0, 1e3])[:, None]
    prior = root @ root.T
    weights = rng.normal(size=5)
    row = prior @ weights
    groups = {"a": [0, 3], "b": [1], "c": [4, 2]}
    shares = _split(row, np.linalg.inv(prior), groups)
    assert sum(shares.values()) == pytest.approx(weights @ prior @ weights, rel=1e-6)
    # by definition: what each order of getting to know them takes away
    expected = dict.fromkeys(groups, 0.0)
    for order in itertools.permutations(groups):
        known: list[int] = []
        before = 0.0
        for name in order:
            known += groups[name]
            after = row[known] @ np.linalg.solve(prior[np.ix_(known, known)], row[known])
            expected[name] += (after - before) / 6.0
            before = after
    assert shares == pytest.approx(expected, rel=1e-6)
    # independent ones have what is theirs
    sizes = np.diag(np.diag(prior))
    alone = _split(
        sizes @ weights,
        np.linalg.inv(sizes),
        groups,
    )
    assert alone["b"] == pytest.approx(prior[1, 1] * weights[1] ** 2)


def test_no_calibration_no_shares() -> None:
    assert _split(np.ones(3), np.eye(3), {}) == {}
