"""Many fits in one launch beside the solver of one problem, on recorded pushes, and their derivatives beside differences."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import warp as wp

from proprio_ros.errors import ConfigurationError, RecordingError
from proprio_ros.identification.fit import SearchOptions, first_problem
from proprio_ros.identification.prepared_runs import prepare_run
from proprio_ros.identification.problem import Problem
from proprio_ros.identification.robot_calibration import LoadedRun, calibrate
from proprio_ros.identification.solvers import Solution, levenberg_marquardt
from proprio_ros.identification.together import (
    Meeting,
    affine_fit,
    can_go_together,
    descend,
    descend_together,
    rules,
)
from proprio_ros.identification.unknowns import Role
from proprio_ros.pipeline.loading import bag_runs
from proprio_ros.pipeline.request import DEFAULT_ROBOT, Request
from proprio_ros.robot import Robot, load_robot
from proprio_ros.sim import runtime
from proprio_ros.sim.descent import Descents
from proprio_ros.sim.payload import PayloadFacts

BAGS = Path(__file__).resolve().parents[2] / "bags"
PUSHES = (
    "ideal_s00_fixed_heavy_ball_50g_joint2",
    "quantised_s00_fixed_heavy_cube_23g_joint3_x1",
    "realistic_s00_fixed_light_ball_20g_joint3",
    "realistic_s00_fixed_reference_100g_joint2_x2",
    "realistic_s00_empty_03_joint3",
)
EQUAL = 1e-9
# of a standard deviation: nearer, the solver of one problem does not tell whether a step gains
ARRIVED = 1e-5

Posed = tuple[Problem, np.ndarray]


def calibrated(robot: Robot) -> Robot:
    """By the empty-hand pushes: dry friction, whose steps are fine, and encoders that are off once per turn."""
    empty = [
        LoadedRun(run)
        for bag in sorted(BAGS.glob("realistic_s00_empty_*/bag_*"))
        for run in bag_runs(bag, Request(robot))
    ]
    calibration = calibrate(robot, empty).calibration
    assert calibration is not None
    return robot.with_calibration(calibration)


def pose(robot: Robot, pushes: tuple[str, ...], role: Role = Role.FIXED) -> Posed:
    """The first fit of some pushes together, and its five starts."""
    runs = [
        prepare_run(robot, run)
        for name in pushes
        for run in bag_runs(next((BAGS / name).glob("bag_*")), Request(robot))
    ]
    return first_problem(robot, runs, PayloadFacts(), SearchOptions(), role)


@pytest.fixture(scope="module")
def posed() -> list[Posed]:
    """Each push alone, those of the calibrated arm with the calibration, too, and two of them together."""
    robot = load_robot(DEFAULT_ROBOT)
    known = calibrated(robot)
    alone = [pose(robot, (name,)) for name in PUSHES]
    return [*alone, *(pose(known, (name,)) for name in PUSHES[2:]), pose(known, PUSHES[2:4])]


@pytest.fixture(scope="module")
def found(posed: list[Posed]) -> list[Solution]:
    problems, starts = zip(*posed, strict=True)
    return descend_together(problems, starts, "cpu", rules())


def test_each_fit_ends_where_it_does_alone(posed: list[Posed], found: list[Solution]) -> None:
    assert any(problem.known_ripple().any() for problem, _ in posed)
    assert any(problem.simulator.runs[0].fine_step_s < 1e-3 for problem, _ in posed)
    for (problem, starts), together in zip(posed, found, strict=True):
        alone = levenberg_marquardt(problem, starts, problem.simulator.windows)
        np.testing.assert_allclose(together.cost, alone.cost, rtol=EQUAL)
        _, _, matrix = problem.linearise(alone.internal[[alone.best]])
        std = np.sqrt(np.diag(np.linalg.inv(matrix[0])))
        apart = np.abs(together.internal - alone.internal)[alone.best]
        assert np.all(apart < EQUAL * np.abs(alone.internal[alone.best]) + ARRIVED * std)
        assert together.iterations == alone.iterations
        # until both are so near that rounding decides about steps
        np.testing.assert_allclose(together.path[:6], alone.path[:6], rtol=1e-7, atol=1e-9)


def test_company_changes_nothing(posed: list[Posed], found: list[Solution]) -> None:
    """A fit's numbers are the same bit for bit, whatever else is in the launch, and however long the others go on."""
    for (problem, starts), together in list(zip(posed, found, strict=True))[::3]:
        (alone,) = descend_together([problem], [starts], "cpu", rules())
        np.testing.assert_array_equal(alone.internal, together.internal)
        np.testing.assert_array_equal(alone.path_cost, together.path_cost)


def test_bounds_and_what_has_no_inertia(posed: list[Posed]) -> None:
    """A mass on its bound stays there; a start whose moving part weighs less than nothing has no cost."""
    problem, starts = posed[0]
    starts = starts.copy()
    starts[0] = problem.coordinates.internal(np.array([-0.49, *problem.coordinates.prior_mean[1:]]))
    kept = problem.coordinates.upper.copy()
    bound = float(problem.coordinates.internal(np.array([0.03, 0.0, 0.0]))[0])
    problem.coordinates.upper[0] = bound
    try:
        (together,) = descend_together([problem], [starts], "cpu", rules())
        alone = levenberg_marquardt(problem, starts, problem.simulator.windows)
    finally:
        problem.coordinates.upper[:] = kept
    assert together.internal[together.best, 0] == bound
    np.testing.assert_allclose(together.cost, alone.cost, rtol=EQUAL)
    assert np.isinf(alone.path_cost[0, 0])
    np.testing.assert_array_equal(np.isinf(together.path_cost), np.isinf(alone.path_cost))


def test_slopes_against_differences(posed: list[Posed]) -> None:
    """The gradient that the kernel sums up, at every start of every fit, beside central differences of its cost."""
    step = 1e-6
    for problem, starts in posed:
        shifts = [step * unit for unit in np.eye(starts.shape[1])]
        beside = [guesses for shift in shifts for guesses in (starts + shift, starts - shift)]
        fits = [affine_fit(problem, guesses) for guesses in (starts, *beside)]
        costs, gradient, _ = Descents(fits, rules()).linearise()
        costs = costs.reshape(-1, len(starts))
        slopes = ((costs[1::2] - costs[2::2]) / (2.0 * step)).T
        size = np.abs(slopes).max(axis=1, keepdims=True)
        np.testing.assert_allclose(gradient[: len(starts)] / size, slopes / size, atol=2e-6)


def test_curvature_is_that_of_one_problem(posed: list[Posed]) -> None:
    for problem, starts in posed:
        ours = Descents([affine_fit(problem, starts)], rules()).linearise()
        for together, alone in zip(ours, problem.linearise(starts), strict=True):
            size = np.abs(alone).max()
            np.testing.assert_allclose(together / size, alone / size, atol=1e-12)


def test_what_bends_goes_alone(posed: list[Posed]) -> None:
    assert all(can_go_together(problem) for problem, _ in posed)
    opened, _ = pose(load_robot(DEFAULT_ROBOT), PUSHES[:1], Role.ESTIMATED)
    assert not can_go_together(opened)


def test_a_meeting_fits_what_all_want_together(posed: list[Posed], found: list[Solution]) -> None:
    """Pieces of work that fit once, twice, never or break: each gets its own, and nobody waits for who has left."""

    def fitted(*rows: int) -> list[Solution]:
        return [descend(*posed[row], "cpu", rules()) for row in rows]

    def refused() -> list[Solution]:
        raise RecordingError("nothing in it")

    def judged(work: Callable[[], list[Solution]]) -> list[Solution]:
        try:
            return work()
        except RecordingError:
            return []

    works = [partial(fitted, 0), refused, partial(fitted, 1, 2), fitted, partial(fitted, 3, 0)]
    results = Meeting().results([partial(judged, work) for work in works])
    assert [len(result) for result in results] == [1, 0, 2, 0, 2]
    for row, solution in zip((0, 1, 2, 3, 0), itertools.chain(*results), strict=True):
        np.testing.assert_array_equal(solution.internal, found[row].internal)


def test_what_cannot_be_fitted_is_an_error_of_its_own(posed: list[Posed]) -> None:
    problem, starts = posed[0]
    too_wide = np.concatenate([starts, starts], axis=1)

    def fitted(first: np.ndarray) -> str:
        try:
            return str(descend(problem, first, "cpu", rules()).iterations)
        except ValueError as error:
            return str(error)

    said, iterations = Meeting().results([partial(fitted, too_wide), partial(fitted, starts)])
    assert "shapes" in said and int(iterations) > 3


def test_a_card_that_is_not_there() -> None:
    if wp.get_cuda_device_count():
        pytest.skip("there is a card")
    for name in ("cuda", "cuda:0"):
        with pytest.raises(ConfigurationError, match="no CUDA device: ") as refused:
            runtime.device_named(name)
        assert "\n" not in str(refused.value)
    with pytest.raises(ConfigurationError, match="choose cpu or cuda"):
        runtime.device_named("gpu")
    assert runtime.device_named("cpu") == "cpu"
    with pytest.raises(ConfigurationError, match="no CUDA device: "):
        SearchOptions(device="cuda")
    with pytest.raises(ConfigurationError, match="goes with --solver lm"):
        SearchOptions(device="cuda", solver="adam")


@pytest.mark.skipif(not wp.get_cuda_device_count(), reason="needs a graphics card")
def test_a_card_finds_what_the_processor_does(posed: list[Posed], found: list[Solution]) -> None:
    problems, starts = zip(*posed, strict=True)
    for here, there in zip(found, descend_together(problems, starts, "cuda", rules()), strict=True):
        np.testing.assert_allclose(there.cost, here.cost, rtol=EQUAL)
        np.testing.assert_allclose(there.internal, here.internal, rtol=EQUAL, atol=EQUAL)
