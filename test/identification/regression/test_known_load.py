"""What a known load says of an arm and the scale of its torques: against dense least squares and differences, and in the file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.arm_in_motion import FOUR, Twin, write_robot

from proprio_ros.calibration_files.motions import MotionCalibration
from proprio_ros.identification.regression.at_rest import (
    RestFit,
    Stances,
    _by_stances,
    _StanceEquations,
)
from proprio_ros.identification.regression.error_budget import CALIBRATION, CONSTANTS
from proprio_ros.identification.regression.known_load import (
    ReferenceMotion,
    covariance_with_scale,
    deviations_with_scale,
    learnt_with,
    scale_by_terms,
    scale_variance_alone,
)
from proprio_ros.identification.regression.motion_equations import Arm
from proprio_ros.identification.regression.motion_fit import fit_empty, fit_payload
from proprio_ros.identification.regression.motion_prior import (
    LOAD_FRICTION_SPREAD,
    calibrated_terms,
)
from proprio_ros.identification.regression.online import OnlineEstimator
from proprio_ros.identification.regression.recording_variability import CLOCK, CONSIDERED
from proprio_ros.identification.regression.torque_scale import scaled_by_references
from proprio_ros.pipeline.calibrate import write_calibration
from proprio_ros.recordings.motions import Motion
from proprio_ros.robot import Robot, load_robot

PAYLOAD = 10  # parameters
LOADS_KG = (0.2, 0.15)
CENTRE_M = np.array([0.01, 0.0, 0.0])
SCALE = 0.9  # true torque over that of the robot file's constants
NOTHING = 1e-7
STEP = 1e-2  # Of differences, in standard deviations.
POSES = np.array([[0.3, 0.9, -0.7, 0.4], [0.0, 0.5, 0.6, -0.3], [-0.4, 1.2, -0.2, 0.8]])


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return load_robot(write_robot(tmp_path_factory.mktemp("twin"), build=FOUR))


@pytest.fixture(scope="module")
def recorded() -> tuple[Motion, list[tuple[Motion, float]], Motion]:
    """Of one arm: empty, with each of the known loads, and with what is asked."""
    arm = Twin(31, FOUR)
    arm.torque = arm.torque * SCALE
    empty = arm.record("empty", 15.0)
    known = [(arm.record(f"{kg} kg", 15.0, (kg, CENTRE_M)), kg) for kg in LOADS_KG]
    return empty, known, arm.record("asked", 15.0, (0.1, CENTRE_M))


@pytest.fixture(scope="module")
def by_file(robot: Robot, recorded: tuple) -> MotionCalibration:
    return replace(fit_empty(robot, [recorded[0]]), torque_scale_std=0.2)


@pytest.fixture(scope="module")
def learnt(
    robot: Robot, recorded: tuple, by_file: MotionCalibration
) -> tuple[MotionCalibration, MotionCalibration]:
    """With the first known load, and with both."""
    first, _ = scaled_by_references(robot, by_file, recorded[1][:1], None)
    both, _ = scaled_by_references(robot, by_file, recorded[1], None)
    return first, both


def explained(robot: Robot, calibration: MotionCalibration, known: tuple) -> ReferenceMotion:
    """A known load whose recording differs in torque and zeros by nothing: then its posterior is one of plain least squares."""
    motion, kg = known
    fit = fit_payload(robot, [motion], calibration)
    solution = fit.solution
    kinds = solution.variability.kinds
    alike = dict.fromkeys((*CONSIDERED, *CLOCK), NOTHING)
    variability = replace(
        solution.variability,
        spreads={**solution.variability.spreads, **alike},
    )
    values = solution.values.copy()
    own = fit.problem.own(0)
    values[own] = np.where(np.isin(kinds, [*CONSIDERED, *CLOCK]), 0.0, values[own])
    # of the mass nothing is known by itself
    prior = replace(solution.prior, covariance=solution.prior.covariance.copy())
    prior.covariance[0, 0] *= 1e6
    solution = replace(solution, values=values, variability=variability, prior=prior)
    return ReferenceMotion(kg, fit.problem, solution, np.zeros_like(fit.scatter))


def known_before(calibration: MotionCalibration) -> tuple[np.ndarray, np.ndarray]:
    """Terms and inverse scale, and their covariance."""
    inverse = 1.0 / calibration.torque_scale
    relative = np.append(np.ones(len(calibration.values)), -inverse)
    return (
        np.append(calibration.values, inverse),
        covariance_with_scale(calibration) * np.outer(relative, relative),
    )


def stds_of_own(load: ReferenceMotion) -> dict[int, float]:
    """Standard deviation of what the motion has of its own beside arm and mass, by where it stands among its unknowns."""
    joints = load.problem.count
    geared = PAYLOAD + 11 * joints
    stds = {n: load.solution.payload_prior[n] for n in range(1, PAYLOAD)}
    stds |= {geared + n: LOAD_FRICTION_SPREAD for n in range(joints)}
    first = load.problem.own(0).start
    return stds | {first + n: std for n, std in enumerate(load.solution.variability.std)}


def by_least_squares(
    calibration: MotionCalibration, load: ReferenceMotion
) -> tuple[np.ndarray, np.ndarray]:
    """Terms and inverse scale, and their covariance, of stacked equations: of the motion, and of what was known before."""
    mean, before = known_before(calibration)
    own_stds = stds_of_own(load)
    known = len(mean)
    unknowns = np.zeros((len(load.solution.values), known + len(own_stds)))
    unknowns[0, known - 1] = load.mass_kg
    unknowns[PAYLOAD:, : known - 1] = calibrated_terms(load.problem.count, 1)
    unknowns[list(own_stds), range(known, known + len(own_stds))] = 1.0
    stds = np.append(np.sqrt(np.diag(before)), list(own_stds.values()))
    kept = slice(0, known)
    sizes = np.outer(stds, stds)[kept, kept]
    correlation = np.eye(len(stds))
    correlation[kept, kept] = before / sizes
    whiten = np.linalg.inv(np.linalg.cholesky(correlation))
    stacked = np.vstack([load.solution.scaled @ unknowns * stds, whiten])
    torque = load.problem.torque * load.solution.weight
    right = np.append(torque, whiten[:, kept] @ (mean / stds[kept]))
    inverse = np.linalg.pinv(stacked)
    covariance = inverse @ inverse.T
    return (inverse @ right * stds)[kept], covariance[kept, kept] * sizes


@pytest.mark.parametrize("before", [0, 1])
def test_a_known_load_is_one_more_set_of_equations(
    robot: Robot,
    recorded: tuple,
    by_file: MotionCalibration,
    learnt: tuple,
    before: int,
) -> None:
    """Of the first the scale is independent of the arm's terms, of the second it is not."""
    calibration = (by_file, learnt[0])[before]
    load = explained(robot, calibration, recorded[1][before])
    now = learnt_with(calibration, load)
    values, covariance = by_least_squares(calibration, load)
    std = np.sqrt(np.diag(covariance))
    assert np.abs((now.values - values[:-1]) / std[:-1]).max() < 1e-3
    assert now.torque_scale == pytest.approx(1.0 / values[-1], abs=1e-3 * std[-1])
    relative = np.append(np.ones(len(now.values)), -1.0 / values[-1])
    expected = covariance * np.outer(relative, relative)
    std = np.sqrt(np.diag(expected))
    found = covariance_with_scale(now)
    assert np.abs((found - expected) / np.outer(std, std)).max() < 1e-3
    # the scale and the arm's weight err together
    assert np.abs(found[-1, :-1] / std[-1] / std[:-1]).max() > 0.2


@pytest.mark.parametrize("stretch", [0, 2, 4, -1])
def test_deviations_are_how_the_answer_follows_what_was_known(
    robot: Robot,
    recorded: tuple,
    learnt: tuple,
    stretch: int,
) -> None:
    """Against differences: the calibration's terms and scale are moved along what a stretch pulls them by."""
    calibration = learnt[0]
    load = explained(robot, calibration, recorded[1][1])
    row = deviations_with_scale(calibration)[stretch]
    step = 1e-3

    def moved(times: float) -> MotionCalibration:
        other = replace(
            calibration,
            values=calibration.values + times * row[:-1],
            torque_scale=calibration.torque_scale * (1.0 + times * row[-1]),
        )
        return learnt_with(other, load)

    more = moved(step)
    less = moved(-step)
    by_values = (more.values - less.values) / (2.0 * step)
    by_scale = (more.torque_scale - less.torque_scale) / (2.0 * step)
    now = learnt_with(calibration, load)
    stretches = calibration.stretches
    place = stretch if stretch >= 0 else stretches + stretch
    std = np.sqrt(np.diag(now.covariance))
    pull = deviations_with_scale(now)[place]
    assert np.abs((by_values - pull[:-1]) / std).max() < 1e-3
    # how much the scale of before counts follows that scale a little, too
    assert by_scale / now.torque_scale == pytest.approx(pull[-1], abs=5e-3 * now.torque_scale_std)


class Standing:
    """An arm in three poses that holds a mass, whose torques are as its calibration has them."""

    def __init__(
        self,
        robot: Robot,
        calibration: MotionCalibration,
        mass_kg: float,
    ) -> None:
        self.calibration = calibration
        self.arm = Arm.of(robot, calibration.joints, {})
        nothing = np.zeros_like(POSES)
        self.place = (CENTRE_M, np.full(3, 1e-4))
        unloaded = Stances(POSES, nothing, nothing)
        equations = _StanceEquations(self.arm, calibration, unloaded, *self.place)
        torque = mass_kg * equations.lever - equations.errors(mass_kg).right
        current_A = torque.reshape(POSES.shape) / calibration.torque_constants
        self.stood = Stances(POSES, current_A, nothing)

    def fit(self, along: np.ndarray) -> RestFit:
        """By a calibration whose terms and relative scale are moved."""
        known = self.calibration
        moved = replace(
            known,
            values=known.values + along[:-1],
            torque_scale=known.torque_scale * (1.0 + along[-1]),
        )
        return _by_stances(self.arm, moved, self.stood, *self.place)


@pytest.mark.parametrize("mass_kg", [0.0, 0.1, 0.2, 0.5])
def test_what_stands_follows_terms_and_scale_together(
    robot: Robot,
    learnt: tuple,
    mass_kg: float,
) -> None:
    """Against differences along each axis of their covariance."""
    known = learnt[1]
    scale = known.scale_of_load
    calibration = replace(
        known,
        friction_spread=np.zeros_like(known.friction_spread),
        deviations=np.zeros_like(known.deviations),
        scale_of_load=replace(scale, deviations=np.zeros_like(scale.deviations)),
    )
    standing = Standing(robot, calibration, mass_kg)
    sizes, axes = np.linalg.eigh(covariance_with_scale(calibration))
    follows = []
    for size, axis in zip(sizes, axes.T, strict=True):
        along = STEP * np.sqrt(max(size, 0.0)) * axis
        change = standing.fit(along).mass_kg - standing.fit(-along).mass_kg
        follows.append(change / (2.0 * STEP))
    fit = standing.fit(np.zeros(len(axes)))
    assert fit.mass_kg == pytest.approx(mass_kg, abs=1e-4)
    found = np.hypot(fit.parts[CALIBRATION], fit.parts[CONSTANTS])
    assert found == pytest.approx(np.linalg.norm(follows), rel=0.02)


def test_the_running_estimate_errs_with_the_scale(
    robot: Robot, recorded: tuple, learnt: tuple
) -> None:
    """Against differences: its terms are moved along what the scale goes with."""
    for calibration, motion in (
        (learnt[0], recorded[2]),
        (learnt[1], recorded[2]),
        (learnt[1], recorded[1][0][0]),
    ):
        assert calibration.scale_of_load is not None
        along = calibration.scale_of_load.covariance
        step = 0.3 / calibration.torque_scale_std

        def weighed(
            times: float,
            known: MotionCalibration = calibration,
            along: np.ndarray = along,
            motion: Motion = motion,
        ) -> OnlineEstimator:
            moved = replace(known, values=known.values + times * along)
            running = OnlineEstimator(robot, moved, centre_m=CENTRE_M.tolist())
            columns = [motion.joints.index(name) for name in running.joints]
            for row in np.flatnonzero(motion.times_s < 3.0):
                position = motion.position[row, columns].tolist()
                current = motion.current_A[row, columns].tolist()
                running.add(float(motion.times_s[row]), position, current)
            return running

        now = weighed(0.0)._newest
        more = weighed(step)._newest
        less = weighed(-step)._newest
        assert now is not None and more is not None and less is not None
        follows = (more.mass_kg - less.mass_kg) / (2.0 * step)
        together = now.covariance_with_scale
        size = calibration.torque_scale_std * now.std_kg
        assert together == pytest.approx(follows, abs=0.1 * size)


def test_a_file_keeps_how_the_scale_errs_with_the_arm(
    robot: Robot, learnt: tuple, tmp_path: Path
) -> None:
    path = tmp_path / "learnt.yaml"
    write_calibration(path, robot, learnt[1])
    read = load_robot(path).motion_calibration
    assert read is not None
    np.testing.assert_allclose(
        covariance_with_scale(read), covariance_with_scale(learnt[1]), rtol=1e-9, atol=1e-18
    )
    np.testing.assert_allclose(
        deviations_with_scale(read), deviations_with_scale(learnt[1]), rtol=1e-6, atol=1e-12
    )
    assert scale_variance_alone(read) == pytest.approx(scale_variance_alone(learnt[1]), rel=1e-3)


def test_a_file_of_before_is_read_with_what_it_has(
    robot: Robot, recorded: tuple, learnt: tuple, tmp_path: Path
) -> None:
    path = tmp_path / "before.yaml"
    write_calibration(path, robot, replace(learnt[1], scale_of_load=None))
    assert "scale_of_load" not in path.read_text()
    read = load_robot(path).motion_calibration
    assert read is not None and read.scale_of_load is None and read.referenced
    assert not scale_by_terms(read).any()
    assert scale_variance_alone(read) == pytest.approx(read.torque_scale_std**2)
    fit = fit_payload(robot, [recorded[2]], read)
    assert abs(float(fit.values[0]) - 0.1) < fit.half_width


def test_weighed_again_a_known_load_is_what_it_is(
    robot: Robot, recorded: tuple, learnt: tuple
) -> None:
    for (motion, kg), calibration in zip(recorded[1], learnt, strict=True):
        fit = fit_payload(robot, [motion], calibration)
        assert abs(float(fit.values[0]) - kg) < 0.3 * fit.half_width
    asked = [fit_payload(robot, [recorded[2]], known) for known in learnt]
    assert all(abs(float(fit.values[0]) - 0.1) < fit.half_width for fit in asked)
    assert asked[1].half_width < 1.05 * asked[0].half_width
