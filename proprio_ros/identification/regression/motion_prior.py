"""What motions with an empty hand say about an arm, learnt once, and weighing with it: the regression of `motion_fit` in two steps.

`fit_empty` makes a `MotionCalibration` of empty runs, `fit_calibrated` weighs with it. The arm's parameters start at the
calibration's values with its whole covariance; the run's own friction lies around the calibrated one by what runs differ.

Neighbouring windows share an error (friction that depends on place and temperature), so each says less than an equation of its own:
the weights count residuals as correlated as they are found to be. Without that, what a slow motion leaves open would be
decided by noise instead of by the robot file. Intervals take the larger of two words: the fit's own with those weights, and what
stretches of 2.5 s pull each their own way (Liang & Zeger 1986, Biometrika 73), which assumes nothing about a stretch. Leaving
them out in turn, as `motion_fit` does, says far too much where four are all there is: each then has a leverage of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from proprio_ros.calibration_files.motions import ARM_TERMS, FRICTION_TERMS, TERMS, UNITS, MotionCalibration
from proprio_ros.errors import RecordingError, RobotError
from proprio_ros.identification.regression.motion_fit import (
    ARM_SHARE,
    BLOCK_S,
    CONSTANTS,
    ITERATIONS,
    LEAST_LOAD_FRICTION_STD,
    LEAST_TORQUE_STD,
    LINK_SHARE,
    MIN_BLOCKS,
    PARAMETER_NAMES,
    PARAMETER_UNITS,
    RUNS_OF_ITS_OWN,
    STRETCHES,
    UNDETERMINED,
    URDF_SHARE,
    Equations,
    MotionFit,
    Stacked,
    Term,
    arm_kg,
    equations,
    reach_m,
    relative_torque_std,
    rms_by_joint,
    sizes,
)
from proprio_ros.recordings.motions import Motion
from proprio_ros.robot import ReducedModel, Robot
from proprio_ros.robot.regressor import PARAMETERS, body_parameters

FloatArray = NDArray[np.float64]
LEAST_SPREAD_SHARE = 0.1
"""Friction of one run differs from that of the next by at least this share: motors warm up."""
LOAD_FRICTION_SPREAD = 0.02
"""The share that gears lose is not quite the same under another load."""
WAVES = 4
"""Sine and cosine of a joint's angle, and of twice the angle."""
PLACE_SHARE = 0.15
"""Standard deviation of each of them in Coulomb friction, relative to it."""
HELD_WITHIN = 0.1
"""What a hand holds lies within this share of the arm's reach, unless its place is stated: one standard deviation."""


@dataclass(frozen=True)
class Prior:
    """Gaussian, of the arm's terms in the order of `term_keys`: values, shape (P,), and covariance, shape (P, P)."""

    values: FloatArray
    covariance: FloatArray


def file_prior(robot: Robot, model: ReducedModel) -> Prior:
    """What the robot file says of an arm: the URDF's bodies, and drive trains; friction is open.

    All bodies may be heavier or lighter together: that is also what torque constants do that are off.
    """
    bodies = [body_parameters(pseudo) for pseudo in model.pseudo_inertia]
    total, reach = arm_kg(model), reach_m(robot, model)
    stds: list[float] = []
    for place, body in zip([*model.placement[1:], None], bodies, strict=True):
        length = max(0.1 * reach, 0.0 if place is None else float(np.linalg.norm(place[:3, 3])))
        share = robot.link_mass_std or LINK_SHARE
        stds += sizes(share * float(body[0]) + ARM_SHARE * total, length)
    drives = [robot.drive_trains[name] for name in model.joint_names]
    stds += [max(d.armature.std, 0.5 * abs(d.armature.value), 1e-3 * total * reach**2) for d in drives]
    stds += [max(d.load_friction.std, LEAST_LOAD_FRICTION_STD) for d in drives]
    stds += [LEAST_TORQUE_STD] * len(drives)
    stds += [
        d.coulomb.std or 0.1 * total * reach for d in drives
    ] * WAVES  # until the fit knows Coulomb friction itself
    stds += [total * 9.81 * reach] * (len(FRICTION_TERMS) * len(drives))
    values = np.concatenate(
        [
            *bodies,
            [d.armature.value for d in drives],
            [d.load_friction.value for d in drives],
            np.zeros((1 + WAVES + len(FRICTION_TERMS)) * len(drives)),
        ]
    )
    covariance = np.diag(np.square(stds))
    together = np.concatenate(bodies)
    count = len(together)
    covariance[:count, :count] += URDF_SHARE**2 * np.outer(together, together)
    return Prior(values, covariance)


@dataclass(frozen=True)
class _Solution:
    """Of a `Stacked` under a prior.

    Attributes:
        values: Shape (U,).
        covariance: Of data and prior, with correlated residuals counted, shape (U, U).
        information: What the data alone say, shape (U, U).
        deviations: By stretch, see `MotionCalibration`, shape (stretches, U).
        residual: Of each equation [N m], shape (E,).
        rms, correlation: By joint, shape (n,); 0 and 1 where it did not move.
        payload_prior: Standard deviations of the payload's parameters under their prior, shape (10,).
        scaled: The equations times their weights, shape (E, U).
        weight: Shape (E,).
    """

    values: FloatArray
    covariance: FloatArray
    information: FloatArray
    deviations: FloatArray
    residual: FloatArray
    rms: FloatArray
    correlation: FloatArray
    payload_prior: FloatArray
    scaled: FloatArray
    weight: FloatArray

    def mass_and_std(self) -> tuple[float, float]:
        """What the larger of the fit's own word and that of its stretches leaves of the mass [kg]."""
        return float(self.values[0]), float(np.sqrt(max(self.noise()[0, 0], self.covariance[0, 0])))

    def by_prior(self) -> FloatArray:
        """How the payload's parameters follow the prior's mean, shape (10, U)."""
        gain = self.covariance[:PARAMETERS] @ self.information
        result: FloatArray = np.eye(len(self.values))[:PARAMETERS] - gain
        return result

    def noise(self) -> FloatArray:
        """What the recording itself leaves open of the payload: the larger of what stretches and fit say, shape (10, 10)."""
        between = self.deviations[:, :PARAMETERS].T @ self.deviations[:, :PARAMETERS]
        formal = self.covariance[:PARAMETERS] @ self.information @ self.covariance[:, :PARAMETERS]
        return larger(between, formal)


def larger(one: FloatArray, other: FloatArray) -> FloatArray:
    """Of two covariances of the payload, that with the larger variance of the mass."""
    return one if one[0, 0] > other[0, 0] else other


def _solve(
    problem: Stacked,
    prior: Prior,
    length_m: float,
    centre_std: FloatArray | None,
    known: MotionCalibration | None,
) -> _Solution:
    """Solve it, with weights, load friction and the payload's size from the solution before."""
    matrix, right, joint, count = problem.matrix.copy(), problem.right, problem.joint, problem.count
    bodies = slice(0, PARAMETERS * (1 + count))
    geared = slice(PARAMETERS + 11 * count, PARAMETERS + 12 * count)
    shares = slice(geared.stop, geared.stop + count)
    covariance = prior.covariance.copy()
    moves = np.bincount(joint, minlength=count) > 0
    rms, correlation = np.ones(count), np.ones(count)
    for _ in range(ITERATIONS):
        weight = 1.0 / (rms * np.sqrt(correlation))[joint]
        scaled, target = matrix * weight[:, None], right * weight
        information, side = scaled.T @ scaled, scaled.T @ target
        values, posterior = _posterior(information, side, prior.values, covariance)
        residual = right - matrix @ values
        rms, correlation = np.zeros(count), np.ones(count)
        for number in np.flatnonzero(moves):
            mine = joint == number
            rms[number] = max(float(np.std(residual[mine])), 1e-9)
            correlation[number] = _correlation(residual[mine], problem.block[mine])
        if known is not None:
            # what a longer recording knows of its residuals holds for a short one, too
            rms, correlation = np.maximum(rms, 0.5 * known.residual), np.maximum(correlation, known.correlation)
        # something light has little first moment and inertia, wherever in the hand it sits
        heavy_kg = abs(values[0]) + np.sqrt(posterior[0, 0])
        spread = np.array(sizes(heavy_kg, length_m))
        if centre_std is not None:
            spread[1:4] = heavy_kg * np.maximum(centre_std, 1e-3)
        covariance[range(1, PARAMETERS), range(1, PARAMETERS)] = spread[1:] ** 2
        if known is None:
            coulomb = values[PARAMETERS + ARM_TERMS * count :].reshape(-1, 3, count)[:, 1].mean(axis=0)
            at = PARAMETERS + 13 * count + np.arange(WAVES * count)
            covariance[at, at] = np.tile(np.square(PLACE_SHARE * coulomb) + 1e-12, WAVES)
        transmitted = np.abs(matrix[:, bodies] @ values[bodies])
        matrix[:, geared] = np.eye(count)[joint] * (transmitted * problem.direction)[:, None]
        # not the measured torque: its noise would make every share too small
        matrix[:, shares] = 0.0
        matrix[:, shares] = -np.eye(count)[joint] * (matrix @ values)[:, None]
    weight = 1.0 / (rms * np.sqrt(correlation))[joint]
    scaled, target = matrix * weight[:, None], right * weight
    information, side = scaled.T @ scaled, scaled.T @ target
    values, posterior = _posterior(information, side, prior.values, covariance)
    deviations = _scores(scaled, target - scaled @ values, problem.block) @ posterior
    return _Solution(
        values, posterior, information, deviations, right - matrix @ values, rms, correlation,
        np.sqrt(np.diag(covariance))[:PARAMETERS], scaled, weight,
    )  # fmt: skip


def _posterior(
    information: FloatArray, side: FloatArray, mean: FloatArray, covariance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Mean and covariance, ``(1 + V N)^-1 V``: neither the prior V nor the data N need an inverse of their own.

    Both are scaled by the prior's standard deviations, which differ by ten orders of magnitude.
    """
    spread = np.sqrt(np.diag(covariance))
    correlation = covariance / spread[:, None] / spread
    normal = information * spread[:, None] * spread
    shrunk = np.linalg.solve(np.eye(len(mean)) + correlation @ normal, correlation)
    shrunk = 0.5 * (shrunk + shrunk.T)
    values = mean + spread * (shrunk @ (spread * (side - information @ mean)))
    return values, shrunk * spread[:, None] * spread


def _correlation(residual: FloatArray, block: NDArray[np.int64]) -> float:
    """Over how many windows a joint's residuals are correlated: one and twice the sum of their correlations within a stretch."""
    total, variance = 1.0, float(np.mean(residual**2))
    longest = int(np.bincount(np.unique(block, return_inverse=True)[1]).max())
    for lag in range(1, longest):
        same = block[lag:] == block[:-lag]
        if same.sum() < longest:
            break
        step = float(np.mean(residual[lag:][same] * residual[:-lag][same])) / variance
        if step < 0.05:
            break
        total += 2.0 * step
    return total


def _friction_spread(problem: Stacked, solution: _Solution, parts: Sequence[Equations], runs: FloatArray) -> FloatArray:
    """By how much friction and offset differ: from run to run, and what stretches of a run show of it, shape (3 n,)."""
    count = problem.count
    between = runs.std(axis=0, ddof=1) if len(runs) > 1 else np.zeros(runs.shape[1])
    drift = np.zeros((len(FRICTION_TERMS), count))
    columns = np.vstack([part.friction for part in parts])
    for kind in range(len(FRICTION_TERMS)):
        for number in range(count):
            mine = problem.joint == number
            column = columns[mine, kind * count + number]
            of_stretch = [
                float(solution.residual[mine][out] @ column[out]) / max(float(column[out] @ column[out]), 1e-12)
                for out in (problem.block[mine] == label for label in np.unique(problem.block[mine]))
            ]
            # what a stretch shows may be any of the three
            drift[kind, number] = np.sqrt(np.mean(np.square(of_stretch)) / len(FRICTION_TERMS)) if of_stretch else 0.0
    least = LEAST_SPREAD_SHARE * np.abs(runs).mean(axis=0)
    least[2 * count :] = 0.0
    return np.maximum(np.hypot(between, drift.ravel()), np.maximum(least, 1e-9))


def fit_empty(robot: Robot, motions: Sequence[Motion]) -> MotionCalibration:
    """What motions with an empty hand say about an arm.

    Args:
        robot: As its file states it.
        motions: Of the same joints, at least one.

    Raises:
        RecordingError: A motion is of no use, or all together are too short.
    """
    joints, held = motions[0].joints, dict(motions[0].held)
    model = robot.model.lock(list(joints), held, robot.gravity)
    count = len(model.joint_names)
    parts = [equations(robot, motion, joints) for motion in motions]
    problem = _stacked(parts, 0, count)
    stretches = len(np.unique(problem.block))
    if stretches < MIN_BLOCKS:
        raise RecordingError(
            f"{motions[0].name}: only {BLOCK_S * stretches:.0f} s of motion can be used; record {BLOCK_S * MIN_BLOCKS:.0f} s "
            "at least, better 50, with all joints moving"
        )
    stated = file_prior(robot, model)
    arm, runs = ARM_TERMS * count, len(motions)
    own = [arm + n for n in range(3 * count)]
    rows = [*range(arm), *(row for _ in motions for row in own)]
    covariance = stated.covariance[np.ix_(rows, rows)]
    # friction of one run says nothing about that of another: its covariances are none but its variances
    covariance[arm:] = covariance[:, arm:] = 0.0
    covariance[range(arm, len(rows)), range(arm, len(rows))] = np.diag(stated.covariance)[rows[arm:]]
    prior = _with_payload(robot, model, Prior(stated.values[rows], covariance))
    solution = _solve(problem, prior, HELD_WITHIN * reach_m(robot, model), None, None)
    # the mean of the runs' friction
    mean = np.zeros((TERMS * count, len(solution.values)))
    mean[range(arm), range(PARAMETERS, PARAMETERS + arm)] = 1.0
    for number in range(runs):
        mean[range(arm, TERMS * count), np.arange(3 * count) + PARAMETERS + arm + 3 * count * number] = 1.0 / runs
    each = solution.values[PARAMETERS + arm :].reshape(runs, 3 * count)
    bodies = slice(PARAMETERS, PARAMETERS * (1 + count))
    fitted = problem.matrix[:, bodies] @ solution.values[bodies]
    by_urdf = problem.matrix[:, bodies] @ prior.values[bodies]
    over_urdf = float(fitted @ by_urdf / (by_urdf @ by_urdf))
    scale_std = max(relative_torque_std(robot, name) for name in model.joint_names)
    # where the robot file knows the arm's weight, torques that say another one are the torque constants' doing
    arm_std = robot.arm_scale.std
    if abs(over_urdf - 1.0) > (2.0 * np.hypot(arm_std, scale_std) if arm_std > 0.0 else URDF_SHARE):
        scale_std = float(np.hypot(scale_std, over_urdf - 1.0))
    return MotionCalibration(
        joints=model.joint_names,
        torque_constants=np.array([robot.drive_trains[name].torque_constant.value for name in model.joint_names]),
        values=mean @ solution.values,
        covariance=mean @ solution.covariance @ mean.T,
        deviations=solution.deviations @ mean.T,
        friction_spread=_friction_spread(problem, solution, parts, each),
        residual=solution.rms,
        correlation=solution.correlation,
        torque_scale=1.0,
        torque_scale_std=scale_std,
        arm_over_urdf=over_urdf,
        fingerprint=robot.model.fingerprint(),
        runs=tuple(
            {"name": motion.name, "duration_s": float(motion.times_s[-1]), "load_kg": 0.0} for motion in motions
        ),
    )


def _stacked(parts: Sequence[Equations], loaded: int, count: int) -> Stacked:
    """With columns for torque constants and for friction that goes with the angle."""
    plain = Stacked.of(parts, loaded, count)
    at = PARAMETERS + 12 * count
    shares = np.zeros((len(plain.right), count))
    waves = np.vstack([part.waves for part in parts])
    return replace(plain, matrix=np.hstack([plain.matrix[:, :at], shares, waves, plain.matrix[:, at:]]))


def _with_payload(robot: Robot, model: ReducedModel, prior: Prior) -> Prior:
    """The prior with the payload's ten parameters before it: anything up to what the arm itself weighs."""
    spread = np.square(sizes(arm_kg(model), HELD_WITHIN * reach_m(robot, model)))
    size = len(prior.values) + PARAMETERS
    covariance = np.zeros((size, size))
    covariance[range(PARAMETERS), range(PARAMETERS)] = spread
    covariance[PARAMETERS:, PARAMETERS:] = prior.covariance
    return Prior(np.concatenate([np.zeros(PARAMETERS), prior.values]), covariance)


def fit_calibrated(
    robot: Robot,
    loaded: Sequence[Motion],
    calibration: MotionCalibration,
    *,
    empty: Sequence[Motion] = (),
    centre: tuple[FloatArray, FloatArray] | None = None,
) -> MotionFit:
    """Weigh what all ``loaded`` motions hold with what a calibration knows.

    Args:
        robot: As its file states it.
        loaded: With the payload, at least one.
        calibration: Of this arm; a ``torque_scale_std`` of 0 takes the torque constants as they are.
        empty: More motions with an empty hand, fitted together with the others.
        centre: As for `fit_motions`.

    Raises:
        RecordingError: A motion is of no use, of other joints, or all together are too short.
        RobotError: Torque constants are no longer those of the calibration.
    """
    motions = [*loaded, *empty]
    for motion in motions:
        if set(motion.joints) != set(calibration.joints):
            raise RecordingError(
                f"{motion.name}: moves {', '.join(motion.joints)}, but the calibration is of {', '.join(calibration.joints)}: "
                "calibrate with motions of all of them"
            )
    joints, held = calibration.joints, dict(motions[0].held)
    for joint, constant in zip(joints, calibration.torque_constants, strict=True):
        now = robot.drive_trains[joint].torque_constant.value
        if abs(now / constant - 1.0) > 1e-6:
            raise RobotError(
                f"{robot.source.name}: the torque constant of {joint} is {now:g} N m/A, but motions were calibrated with "
                f"{constant:g}: calibrate again"
            )
    model = robot.model.lock(list(joints), held, robot.gravity)
    count = len(model.joint_names)
    parts = [equations(robot, motion, joints) for motion in motions]
    if centre is not None:
        parts = [part.with_centre(centre[0]) for part in parts]
    problem = _stacked(parts, len(loaded), count)
    blocks = int(np.sum(np.unique(problem.block) < RUNS_OF_ITS_OWN * len(loaded)))
    if blocks < MIN_BLOCKS:
        raise RecordingError(
            f"{loaded[0].name}: only {BLOCK_S * blocks:.0f} s of motion can be used; record {BLOCK_S * MIN_BLOCKS:.0f} s "
            "at least, better 15, with all joints moving"
        )
    arm = ARM_TERMS * count
    rows = [*range(arm), *(row for _ in motions for row in range(arm, TERMS * count))]
    known = Prior(calibration.values[rows], calibration.covariance[np.ix_(rows, rows)].copy())
    honest = np.square(calibration.std)[rows]
    gears = range(11 * count, 12 * count)
    known.covariance[gears, gears] += LOAD_FRICTION_SPREAD**2
    honest[gears] += LOAD_FRICTION_SPREAD**2
    for number in range(len(motions)):
        at = arm + 3 * count * number + np.arange(3 * count)
        known.covariance[at, at] += calibration.friction_spread**2
        honest[at] += calibration.friction_spread**2
    prior = _with_payload(robot, model, known)
    length_m = HELD_WITHIN * reach_m(robot, model)
    centre_std = None if centre is None else np.asarray(centre[1])
    solution = _solve(problem, prior, length_m, centre_std, calibration)
    payload = solution.values[:PARAMETERS]
    stretch = solution.noise()
    # how the payload follows what its prior is made of: the calibration's values, friction that runs differ by, its own size
    by_prior = solution.by_prior()
    follows = np.zeros((PARAMETERS, TERMS * count))
    np.add.at(follows.T, rows, by_prior[:, PARAMETERS:].T)
    own = np.concatenate([solution.payload_prior, np.zeros(arm), np.tile(calibration.friction_spread, len(motions))])
    own[PARAMETERS + np.array(gears)] = LOAD_FRICTION_SPREAD
    opened = (by_prior * own**2) @ by_prior.T
    # how the payload follows each torque constant's share: the calibration's other terms lean on it, too
    shares = slice(12 * count, 13 * count)
    by_share = follows @ calibration.covariance[:, shares] / LEAST_TORQUE_STD
    apart = by_share @ by_share.T
    by_calibration = larger(
        follows @ calibration.deviations.T @ calibration.deviations @ follows.T,
        follows @ calibration.covariance @ follows.T - apart,
    )
    # nobody knows whether all torque constants are off together or each on its own: the larger covers every mixture
    together = calibration.torque_scale_std * payload
    by_scale = larger(np.outer(together, together), apart)
    variances = np.array([part[0, 0] for part in (stretch, opened, by_calibration, by_scale)])
    # what few stretches say of their own scatter is uncertain: Satterthwaite 1946, Biometrics Bulletin 2
    freedom = np.array([blocks - 1, np.inf, calibration.stretches - 1, np.inf])
    effective = float(variances.sum() ** 2 / np.sum(variances**2 / freedom))
    carrying = problem.run < len(loaded)
    halves = None
    if blocks >= 2 * MIN_BLOCKS:
        late = np.zeros(len(problem.right), dtype=bool)
        for number in range(len(loaded)):
            late |= (problem.run == number) & (problem.block > np.median(problem.block[problem.run == number]))
        early_half, late_half = (
            _solve(problem.only(kept), prior, length_m, centre_std, calibration) for kept in (~late, late | ~carrying)
        )
        halves = (early_half.mass_and_std(), late_half.mass_and_std())
    ratio, ratio_std = _torque_ratio(problem, solution, prior, carrying)
    names = (STRETCHES, UNDETERMINED, "what the calibration leaves open", CONSTANTS)
    scale, keys = calibration.torque_scale, calibration.keys
    terms = [
        *(
            Term(f"payload_{name}", "", unit, 0.0, 1.0)
            for name, unit in zip(PARAMETER_NAMES, PARAMETER_UNITS, strict=True)
        ),
        *(
            Term(kind, joint, UNITS[kind], float(value), float(np.sqrt(variance)))
            for (kind, joint), value, variance in zip([keys[row] for row in rows], known.values, honest, strict=True)
        ),
    ]
    return MotionFit(
        joints=model.joint_names,
        terms=tuple(terms),
        values=np.concatenate([scale * payload, solution.values[PARAMETERS:]]),
        covariance=scale**2 * (stretch + opened + by_calibration + by_scale),
        parts={name: scale * float(np.sqrt(variance)) for name, variance in zip(names, variances, strict=True)},
        blocks=blocks,
        residual=rms_by_joint(solution.residual[carrying], problem.joint[carrying], count),
        empty_residual=np.where(calibration.residual > 0.0, calibration.residual, np.nan),
        driven=rms_by_joint(problem.right[carrying], problem.joint[carrying], count),
        quantile=float(student.ppf(0.975, effective)),
        halves=halves,
        arm_kg=arm_kg(model),
        arm_over_urdf=calibration.arm_over_urdf,
        payload_prior=solution.payload_prior,
        torque_ratio=ratio,
        torque_ratio_std=ratio_std,
    )


def _torque_ratio(
    problem: Stacked, solution: _Solution, prior: Prior, carrying: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray]:
    """See `MotionFit`: one column more for each joint, of what it needs in the loaded motions."""
    target, count, size = solution.weight * problem.right, problem.count, len(prior.values)
    needed = np.eye(count)[problem.joint] * (carrying * (solution.scaled @ solution.values))[:, None]
    scaled = np.hstack([solution.scaled, needed])
    covariance = np.eye(size + count)
    covariance[:size, :size] = prior.covariance
    covariance[range(PARAMETERS), range(PARAMETERS)] = solution.payload_prior**2
    mean = np.append(prior.values, np.zeros(count))
    values, posterior = _posterior(scaled.T @ scaled, scaled.T @ target, mean, covariance)
    deviations = _scores(scaled, target - scaled @ values, problem.block) @ posterior
    variance = np.maximum(np.sum(deviations**2, axis=0), np.diag(posterior))
    return 1.0 + values[size:], np.sqrt(variance[size:])


def _scores(scaled: FloatArray, left_over: FloatArray, block: NDArray[np.int64]) -> FloatArray:
    """What each stretch pulls the solution by, but for its covariance, shape (stretches, U)."""
    labels = np.unique(block)
    scores = np.array([scaled[block == label].T @ left_over[block == label] for label in labels])
    result: FloatArray = np.sqrt(len(labels) / max(len(labels) - 1, 1)) * scores
    return result
