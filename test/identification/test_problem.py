"""The map from unknowns to whitened residuals: every derivative, three ways."""

from __future__ import annotations

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.taped import tape

from proprio_ros.calibration_files.pushes import Calibration
from proprio_ros.identification.prepared_runs import KnownLoad, prepare_run
from proprio_ros.identification.problem import Problem
from proprio_ros.identification.robot_unknowns import load_unknowns
from proprio_ros.identification.unknowns import Role
from proprio_ros.recordings.runs import cut_runs
from proprio_ros.recordings.signals import read_recording
from proprio_ros.robot import Robot, load_robot
from proprio_ros.sim.joint import JointSimulator
from proprio_ros.sim.payload import PayloadFacts, PayloadShape

FACTS = PayloadFacts(
    com=np.array([0.01, 0.004, -0.006]),
    com_std=np.full(3, 0.005),
    shape=PayloadShape.from_inertia_per_mass([2.0e-4, 1.5e-4, 1.8e-4, 2e-5, -1e-5, 3e-5]),
    shape_std_relative=0.5,
)


def prepared(robot: Robot, bag: Path) -> list:
    recording = read_recording(
        bag, nominal_torque_constants={}, joint_order=list(robot.drive_trains)
    )
    return [prepare_run(robot, run) for run in cut_runs(recording, joints=list(robot.drive_trains))]


@pytest.fixture(scope="module")
def problem() -> Problem:
    """Two runs of different joints, everything free, with a supply that limits the current."""
    root = Path(__file__).resolve().parents[2] / "bags"
    robot = load_robot("open_manipulator_x")
    robot = robot.with_overrides(
        {
            f"joints.joint{n}.drive_train.{key}": {"value": value}
            for n in (2, 3)
            for key, value in (
                ("coulomb_N_m", 0.04),
                ("viscous_N_m_s_per_rad", 0.01),
                ("load_friction", 0.02),
            )
        }
    )
    runs = [
        *prepared(robot, root / "quantised_s00_fixed_heavy_ball_50g_joint3" / "bag_mcap"),
        *prepared(robot, root / "quantised_s00_fixed_light_cube_10g_joint2" / "bag_mcap"),
    ]
    return Problem(
        robot,
        runs,
        FACTS,
        load_unknowns(robot, runs, FACTS, Role.ESTIMATED, 0.05),
    )


def points(problem: Problem, count: int) -> np.ndarray:
    rng = np.random.default_rng(5)
    stds = np.array([u.std if np.isfinite(u.std) else 0.02 for u in problem.unknowns])
    draw = problem.base + 0.5 * stds * rng.uniform(
        -1.0,
        1.0,
        (count, len(problem.base)),
    )
    return np.clip(
        draw,
        [u.lower for u in problem.unknowns],
        [u.upper for u in problem.unknowns],
    )


def test_everything_is_unknown_here(problem: Problem) -> None:
    kinds = {unknown.kind for unknown in problem.unknowns}
    assert kinds == {
        "payload_mass", "payload_com_x", "payload_com_y", "payload_com_z", "shape_scale", "arm_scale", "delay", "torque_constant",
        "coulomb", "viscous", "load_friction", "armature", "stribeck", "stribeck_velocity", "zero",
        "ripple_cos", "ripple_sin", "link_mass", "link_com_x", "link_com_z", "link_inertia", "q0", "v0", "onset", "disturbance",
    }  # fmt: skip
    assert len(problem.estimated) == len(problem.unknowns)


def test_jacobian_against_central_differences(problem: Problem) -> None:
    columns = np.arange(len(problem.unknowns))
    for values in points(problem, 4):
        _, _, exact = problem.simulate(values[None], columns)
        for column, unknown in enumerate(problem.unknowns):
            step = 4e-4 * (unknown.std if np.isfinite(unknown.std) else 0.02)
            shifted = np.tile(values, (4, 1))
            shifted[:, column] += step * np.array([-2.0, -1.0, 1.0, 2.0])
            q, _, _ = problem.simulate(shifted, columns[:1])
            # fourth order, so that the step may be long enough to drown the 1e-11 rad by which the choice of steps moves
            difference = (q[0] - 8.0 * q[1] + 8.0 * q[2] - q[3]) / (12.0 * step)
            seen = problem.weight > 0.0
            scale = np.abs(exact[0][seen][:, column]).max()
            np.testing.assert_allclose(
                difference[seen],
                exact[0][seen][:, column],
                atol=1e-6 * scale + 2e-11 / step,
                err_msg=unknown.name,
            )


def test_jacobian_against_the_tape(problem: Problem) -> None:
    """At no error of the encoder: what it shows is then the position itself, which is what the tape differentiates."""
    ripple = np.array([u.name.startswith("ripple") for u in problem.unknowns])
    columns = np.flatnonzero(~ripple)
    rng = np.random.default_rng(2)
    for values in points(problem, 3):
        values[ripple] = 0.0
        _, _, exact = problem.simulate(values[None], columns)
        p, dp = problem.parameters(values[None], columns)
        weights = np.where(
            problem.weight > 0.0,
            rng.normal(size=problem.weight.shape),
            0.0,
        )
        taped = tape(
            problem.simulator,
            np.arange(len(problem.runs)),
            p[0],
        )
        gradient = np.einsum(
            "rp,rpn->n",
            taped.gradient(weights),
            dp[0],
        )
        expected = np.einsum(
            "rt,rtn->n",
            weights,
            np.where(
                problem.weight[..., None] > 0.0,
                exact[0],
                0.0,
            ),
        )
        np.testing.assert_allclose(
            gradient, expected, rtol=1e-10, atol=1e-10 * np.abs(expected).max()
        )


def test_gradient_and_matrix_belong_to_the_cost(problem: Problem) -> None:
    """In solver coordinates, priors and the mass's curved coordinate included."""
    coordinates = problem.coordinates
    for values in points(problem, 3):
        u = coordinates.internal(values[problem.estimated])[None]
        _, gradient, matrix = problem.linearise(u)
        gradient = gradient.copy()
        matrix = matrix.copy()
        assert np.linalg.eigvalsh(matrix[0])[0] > 0.0
        for k in range(u.shape[1]):
            step = 1e-3 * min(coordinates.natural[k], 1.0)
            shifted = np.tile(u, (4, 1))
            shifted[:, k] += step * np.array([-2.0, -1.0, 1.0, 2.0])
            cost = problem.linearise(shifted)[0]
            difference = (cost[0] - 8.0 * cost[1] + 8.0 * cost[2] - cost[3]) / (12.0 * step)
            # the cost is a sum of many squares: its difference loses digits that the gradient keeps
            rounding = 1e-14 * cost.max() / step
            assert difference == pytest.approx(
                gradient[0, k],
                rel=1e-4,
                abs=rounding + 1e-6,
            ), problem.unknowns[k].name


def test_fewer_unknowns_take_the_affine_path_to_the_same_numbers(problem: Problem) -> None:
    frozen = [
        u
        if u.name in ("payload_mass", "q0[0]", "v0[0]", "q0[1]", "v0[1]", "delay")
        else replace(u, role=Role.FIXED)
        for u in problem.unknowns
    ]
    small = Problem(problem.robot, problem.runs, FACTS, frozen)
    u = small.coordinates.internal(
        np.array([[0.03, 0.004, 0.6, 0.0, 0.01, -0.01], [0.2, 0.0, 0.59, 0.01, 0.0, 0.0]])
    )
    cost, gradient, _ = (a.copy() for a in small.linearise(u))
    for s in range(2):
        values = small.all_values(small.coordinates.physical(u[s : s + 1]))
        full = problem.coordinates.internal(values[:, problem.estimated])
        whole_cost, whole_gradient, _ = problem.linearise(full)
        # the free friction takes finer steps
        assert whole_cost[0] == pytest.approx(cost[s], rel=1e-5)
        shared = [
            problem.estimated.tolist().index(problem.index[small.unknowns[row].key])
            for row in small.estimated
        ]
        np.testing.assert_allclose(
            whole_gradient[0, shared], gradient[s], rtol=5e-3, atol=1e-6 * np.abs(gradient[s]).max()
        )


def test_a_guess_that_cannot_be_simulated_costs_everything(problem: Problem) -> None:
    u = problem.coordinates.internal(problem.base[problem.estimated])[None].repeat(2, axis=0)
    # lighter than the arm can be
    u[1, 0] = problem.coordinates.internal(np.full(len(problem.estimated), -0.49))[0]
    cost, gradient, matrix = problem.linearise(u)
    assert np.isfinite(cost[0]) and cost[1] == np.inf
    assert not gradient[1].any() and np.array_equal(matrix[1], np.eye(u.shape[1]))


def correlated_calibration() -> Calibration:
    """Of two joints, a link, the arm and an encoder, all of which are correlated."""
    terms = ("torque_constant", "coulomb", "stribeck", "armature")
    keys = [(term, joint) for joint in ("joint2", "joint3") for term in terms]
    keys += ["arm_scale", ("link_mass", "link5"), ("ripple_sin", "joint3")]
    stds = np.array([0.03, 0.01, 0.1, 0.002] * 2 + [0.02, 0.01, 0.001])
    values = np.array([1.7, 0.05, 0.2, 0.012, 1.75, 0.06, 0.15, 0.014, 1.01, 0.004, 3e-4])
    count = len(keys)
    factor = np.eye(count) + 0.3 * np.random.default_rng(2).normal(size=(count, count))
    covariance = factor @ factor.T
    variances = np.diag(covariance)
    covariance *= np.outer(stds, stds) / np.sqrt(np.outer(variances, variances))
    return Calibration(tuple(keys), values, covariance, 1.0, 2e-4, 1e-3)


@pytest.fixture(scope="module")
def pooled() -> Problem:
    """The payload, a weighed reference and an empty hand in one problem, held joints that yield, under a correlated prior."""
    root = Path(__file__).resolve().parents[2] / "bags"
    robot = load_robot("open_manipulator_x").with_calibration(correlated_calibration())
    loads = {
        "fixed_heavy_cube_23g_joint3_x0": None,
        "fixed_reference_100g_joint3_x1": KnownLoad(0.1, FACTS),
        "empty_06_joint2": KnownLoad(),
    }
    runs = []
    for name, load in loads.items():
        bag = root / f"realistic_s00_{name}" / "bag_mcap"
        recording = read_recording(
            bag, nominal_torque_constants={}, joint_order=list(robot.drive_trains)
        )
        runs += [
            prepare_run(robot, run, load, FACTS)
            for run in cut_runs(recording, joints=list(robot.drive_trains))
        ]
    assert len(runs) == 3 and len(runs[1].loads.load)
    return Problem(
        robot,
        runs,
        FACTS,
        load_unknowns(robot, runs, FACTS, Role.ESTIMATED, 0.03),
    )


def test_jacobian_of_pooled_runs(pooled: Problem) -> None:
    """Unknowns of one run, of one joint, of the payload and of all: each moves just the runs it belongs to."""
    test_jacobian_against_central_differences(pooled)
    columns = np.arange(len(pooled.unknowns))
    _, _, exact = pooled.simulate(
        points(pooled, 1),
        columns,
    )
    moves = np.abs(exact[0]).max(axis=1) > 0.0  # run by unknown
    at = pooled.index
    assert moves[:, at["payload_mass"]].tolist() == [True, False, False]
    assert moves[:, at["disturbance", 1]].tolist() == [False, True, False]
    assert moves[:, at["coulomb", "joint2"]].tolist() == [False, False, True]
    assert (
        moves[:, at["arm_scale"]].all()
        and moves[:, at["delay"]].all()
        and moves[:, at["link_mass", "link5"]].all()
    )


def test_gradient_under_a_correlated_prior(pooled: Problem) -> None:
    test_gradient_and_matrix_belong_to_the_cost(pooled)


def test_tangents_by_the_simulators_parameters_equal_those_by_the_unknowns(pooled: Problem) -> None:
    """Few unknowns are differentiated directly, many by way of the simulator's parameters: one number, two ways."""
    values = points(pooled, 3)
    everything = np.arange(len(pooled.unknowns))
    _, _, whole = pooled.simulate(values, everything)
    for columns in np.array_split(everything, len(everything) // 7):
        _, _, few = pooled.simulate(values, columns)
        seen = pooled.weight > 0.0
        scale = np.abs(whole[:, seen][..., columns]).max(axis=(0, 1)) + 1e-12
        np.testing.assert_allclose(
            few[:, seen] / scale, whole[:, seen][..., columns] / scale, atol=1e-10
        )


def test_a_known_load_is_the_payload_at_that_mass(pooled: Problem) -> None:
    values = points(pooled, 1)
    values[:, pooled.index["payload_mass"]] = 0.1
    for name, axis in zip(
        ("payload_com_x", "payload_com_y", "payload_com_z"), FACTS.com, strict=True
    ):
        values[:, pooled.index[name]] = axis
    values[:, pooled.index["shape_scale"]] = 1.0
    unknown = [replace(run, load=None) if row == 1 else run for row, run in enumerate(pooled.runs)]
    same = Problem(pooled.robot, unknown, FACTS, pooled.unknowns)
    np.testing.assert_allclose(
        same.simulate(values, pooled.estimated[:1])[0][0, 1, : pooled.runs[1].used],
        pooled.simulate(values, pooled.estimated[:1])[0][0, 1, : pooled.runs[1].used],
        atol=1e-12,
    )


def test_motion_tells_torques_only_relative_to_each_other(problem: Problem) -> None:
    """All that is a torque or a mass 3 % larger, but for what a single run has of its own: the same motion, and no less probable.

    Were the torque of each run a number of its own, every further run would make everything a little lighter.
    """
    values = points(problem, 3)
    scaled = values.copy()
    grows = (
        "arm_scale",
        "payload_mass",
        "torque_constant",
        "coulomb",
        "viscous",
        "armature",
        "link_mass",
        "link_inertia",
    )
    for row, unknown in enumerate(problem.unknowns):
        if unknown.kind in grows or unknown.kind.startswith("link_com"):
            scaled[:, row] *= 1.03
    assert all(
        np.abs(values[:, problem.index["disturbance", run]]).min() > 1e-5
        for run in range(len(problem.runs))
    )
    one, other = (problem.simulate(each, problem.estimated[:1])[0] for each in (values, scaled))
    np.testing.assert_allclose(other, one, atol=2e-6)


@pytest.mark.parametrize("base", [Problem, JointSimulator])
def test_subclasses_override_public_methods_only(base: type) -> None:
    """What a subclass may change is listed in the base class; of its private methods none is."""
    private = {name for name in vars(base) if name.startswith("_") and not name.startswith("__")}
    found = 0
    root = Path(__file__).resolve().parents[2]
    for path in (*(root / "proprio_ros").rglob("*.py"), *(root / "test/support").glob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.ClassDef):
                continue
            if base.__name__ not in {ast.unparse(each) for each in node.bases}:
                continue
            found += 1
            methods = {each.name for each in node.body if isinstance(each, ast.FunctionDef)}
            assert not methods & private, f"{path.name}: {node.name} overrides {methods & private}"
    assert found > 2
