"""What motions of several joints say: of an arm with an empty hand, and with that of what the hand holds.

One linear regression (`motion_equations`) serves both. `fit_empty` makes a `MotionCalibration` of empty motions, whose prior is the
robot file: a URDF alone puts an empty arm off by some percent of its own weight. `fit_payload` takes that calibration for its
prior, with its whole covariance; a motion's own friction lies around the calibrated one by what motions differ.

Neighbouring windows share an error (friction that depends on place and temperature), so each says less than an equation of its own:
the weights count residuals as correlated as they are found to be. Without that, what a slow motion leaves open would be decided by
noise instead of by the robot file. Intervals take the larger of two variances: the fit's own with those weights, and what
stretches of 2.5 s pull each their own way (Liang & Zeger 1986, Biometrika 73), which assumes nothing about a stretch. A jackknife
over stretches says far too much where four are all there is: each then has a leverage of its own.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import stdtrit

from proprio_ros.calibration_files.motions import (
    ARM_TERMS,
    BETWEEN,
    BODY_TERMS,
    FRICTION_TERMS,
    TERMS,
    Key,
    MotionCalibration,
)
from proprio_ros.errors import RecordingError, RobotError, some
from proprio_ros.identification.estimate import JointFit
from proprio_ros.identification.regression import motion_prior
from proprio_ros.identification.regression.motion_equations import (
    MIN_STRETCHES,
    WINDOW_S,
    Arm,
    Problem,
    Rows,
    equations,
    weighable,
)
from proprio_ros.identification.regression.recording_variability import (
    DIFFERS,
    WORDS,
    RecordingVariability,
    effective_freedom,
)
from proprio_ros.identification.regression.solve import Solution, larger, solve, solve_following
from proprio_ros.identification.regression.traces import Explained
from proprio_ros.identification.regression.trends import Trend, trend_of
from proprio_ros.recordings.motions import Motion
from proprio_ros.records import FloatArray
from proprio_ros.robot import Robot
from proprio_ros.robot.regressor import PARAMETERS

SPREAD_ITERATIONS = 10
# A recording tells a joint's share of the torque where it makes its variance this much smaller.
LEAST_TOLD = 0.2
Centre = tuple[FloatArray, FloatArray]
"""A payload's centre of mass in its frame, and the standard deviation of each coordinate [m], each of shape (3,)."""
STRETCHES, UNDETERMINED, CALIBRATION, CONSTANTS = (
    "what differs from stretch to stretch",
    "what the motion does not determine",
    "what the calibration leaves open",
    "torque constants",
)
"""Of what a mass errs by, beside what recordings differ by (`recording_variability.WORDS`)."""


@dataclass(frozen=True)
class Solved:
    """Equations, and their solution."""

    problem: Problem
    solution: Solution
    start_s: FloatArray  # when each equation's window begins [s], shape (E,)


@dataclass(frozen=True)
class MotionFit:
    """What the hand holds, and what that rests on."""

    joints: tuple[str, ...]  # that moved or could, in the order of the arrays by joint
    values: FloatArray  # the payload's parameters, shape (10,)
    # from stretches, priors, calibration and torque constants together, shape (10, 10)
    covariance: FloatArray
    parts: Mapping[str, float]  # what puts how much standard deviation on the mass [kg], by name
    stretches: int  # of the motions with the payload
    # residual, empty_residual: rms of the windows' mean torque that is left over, with the payload and without [N m], shape (n,)
    residual: FloatArray
    empty_residual: FloatArray
    # mean square of the former over that of the latter, each joint as much as it tells: reduced chi-square
    misfit: float
    driven: FloatArray  # rms of the mean torque itself [N m], shape (n,)
    # half width of a 95 % interval in standard deviations: Student's, by the number of stretches
    quantile: float
    # mass and its standard deviation from the first and from the second half [kg]; None where they are too short
    halves: tuple[tuple[float, float], tuple[float, float]] | None
    arm_kg: float  # mass of all that moves of the arm
    # by how much the torques of the arm's own bodies are those that its URDF says
    arm_over_urdf: float
    # standard deviations of the payload's ten parameters under their prior, shape (10,)
    payload_prior: FloatArray
    keys: tuple[Key, ...]  # of the arm's terms, length P
    # arm, arm_prior, arm_std: their values, and the prior's with its standard deviations, shape (P,)
    arm: FloatArray
    arm_prior: FloatArray
    arm_std: FloatArray
    # how much less the motions with the payload are read than the empty ones, and its std, shape (n,) each: by zero, positions
    # [rad or m], by own_scale, torques, relative to what is read; 0 and infinite where nothing tells
    off: Mapping[str, tuple[FloatArray, FloatArray]]
    # what the mass is too large by per part that all these torques are read too large by, if nothing shows that
    louder_kg: float
    tells: FloatArray  # how much of what is known of the mass each joint tells, shape (n,), sum 1
    shown: tuple[JointFit, ...]  # torque over time, for a picture
    solved: Solved  # what all of it was made of

    @functools.cached_property
    def trends(self) -> tuple[Trend, ...]:
        """What changes along each motion with the payload; it takes a quarter of a fit, and few who fit ask for it."""
        problem = self.solved.problem
        return tuple(
            trend_of(self.joints, problem, self.solved.solution, self.solved.start_s, number)
            for number in range(problem.loaded)
        )

    @property
    def unexplained(self) -> FloatArray:
        """Share of each joint's torque that is left over, shape (n,)."""
        return share_of(self.residual, self.driven)

    @property
    def std(self) -> FloatArray:
        """Standard deviation of each of the payload's parameters, shape (10,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def half_width(self) -> float:
        """Of the mass's 95 % interval [kg]."""
        return self.quantile * float(self.std[0])

    def unseen(self) -> tuple[str, ...]:
        """Of the payload's ten parameters, those that the motion says less about than what any load of that mass may have."""
        unseen = self.std > 0.5 * self.payload_prior
        return tuple(
            kind.replace("body", "payload")
            for kind, none in zip(BODY_TERMS, unseen, strict=True)
            if none
        )


def share_of(residual: FloatArray, driven: FloatArray) -> FloatArray:
    """What is left over of torques, shape (n,); all of one that reads nothing."""
    return np.where(
        driven > 0.0,
        residual / np.where(driven > 0.0, driven, 1.0),
        np.where(residual > 0.0, 1.0, np.nan),
    )


def fit_empty(robot: Robot, motions: Sequence[Motion]) -> MotionCalibration:
    """What `learn_arm` says, without what a reader sees of it."""
    return learn_arm(robot, motions)[0]


def learn_arm(
    robot: Robot, motions: Sequence[Motion]
) -> tuple[MotionCalibration, tuple[JointFit, ...]]:
    """What motions with an empty hand say about an arm, and torque of each joint as it explains it.

    ``robot``: as its file states it; ``motions``: of the same joints, at least one.

    Raises `RecordingError`: A motion is of no use, or all together are too short.
    """
    joints = motions[0].joints
    runs = len(motions)
    arm = Arm.of(robot, joints, dict(motions[0].held))
    count = arm.count
    shared = PARAMETERS + ARM_TERMS * arm.count
    parts = weighable([equations(robot, motion, joints) for motion in motions])
    problem = Problem.of(parts, 0)
    problem.stretches_of(~problem.carrying, motions[0].name, better_s=50.0)
    prior = motion_prior.prior_of_file(robot, arm, runs)
    friction = len(FRICTION_TERMS) * count
    published = RecordingVariability.unknown(count)
    per_kg = motion_prior.payload_stds(arm)
    if runs == 1:
        solution = solve(problem, prior, published, per_kg)
    else:
        solution, _, scatter = solve_following(problem, prior, published, per_kg, None)
        solution = replace(solution, covariance=solution.covariance + scatter)
    # the mean of the runs' friction
    mean = np.zeros((TERMS * count, len(solution.values)))
    mean[: ARM_TERMS * count, PARAMETERS:shared] = np.eye(ARM_TERMS * count)
    for number in range(runs):
        mean[ARM_TERMS * count :, problem.own(number)][:, :friction] = np.eye(friction) / runs
    between = _friction_between(problem, solution)
    names = arm.model.joint_names
    bodies = slice(PARAMETERS, PARAMETERS * (1 + count))
    fitted, by_urdf = (
        problem.matrix[:, bodies] @ each[bodies] for each in (solution.values, prior.values)
    )
    over_urdf = float(fitted @ by_urdf / (by_urdf @ by_urdf))
    scale_std = max(motion_prior.relative_torque_std(robot, name) for name in names)
    # where the robot file knows the arm's weight, torques that say another one are the torque constants' doing
    limit = motion_prior.URDF_SHARE
    if robot.arm_scale.std > 0.0:
        limit = min(
            2.0 * float(np.hypot(robot.arm_scale.std, scale_std)),
            max(motion_prior.URDF_SHARE, 2.0 * scale_std),
        )
    if abs(over_urdf - 1.0) > limit:
        scale_std = float(np.hypot(scale_std, over_urdf - 1.0))
    learnt = MotionCalibration(
        joints=names,
        torque_constants=np.array(
            [robot.drive_trains[name].torque_constant.value for name in names]
        ),
        values=mean @ solution.values,
        covariance=mean @ solution.covariance @ mean.T,
        deviations=solution.deviations @ mean.T,
        friction_spread=between.std[:friction],
        between={
            kind: (between.spreads[kind], between.recordings[kind]) for kind in sorted(BETWEEN)
        },
        residual=solution.rms,
        correlation=solution.correlation,
        torque_scale=1.0,
        torque_scale_std=scale_std,
        arm_over_urdf=over_urdf,
        fingerprint=robot.model.fingerprint(),
        runs=tuple(
            {"name": m.name, "duration_s": float(m.times_s[-1]), "load_kg": 0.0} for m in motions
        ),
        tells=_weight_by_joint(problem, solution.rms, solution.correlation),
    )
    return learnt, _shown(
        problem,
        parts,
        solution,
        learnt,
        [motion.name for motion in motions],
    )


@dataclass(frozen=True)
class HeldByFile:
    """What motions hold where nothing but the robot file says what the arm is."""

    mass_kg: float
    std_kg: float
    sigmas: float  # how far mass and first moment together are from nothing
    arm: FloatArray  # the arm's terms that all motions share, in the order of `term_keys`, shape (17 n,)


def held_by_file(robot: Robot, motions: Sequence[Motion]) -> HeldByFile:
    """What the hand holds in motions, and the arm with it, by the robot file alone: coarse, as a URDF is.

    Raises `RecordingError`: A motion is of no use.
    """
    joints = motions[0].joints
    arm = Arm.of(robot, joints, dict(motions[0].held))
    parts = weighable([equations(robot, motion, joints) for motion in motions])
    problem = Problem.of(parts, len(motions))
    prior = motion_prior.prior_of_file(robot, arm, len(motions))
    per_kg = motion_prior.payload_stds(arm)
    solution = solve(problem, prior, RecordingVariability.unknown(arm.count), per_kg)
    shared = slice(PARAMETERS, PARAMETERS + ARM_TERMS * arm.count)
    seen = solution.values[:4]  # mass and first moment: what gravity pulls at
    squared = float(seen @ np.linalg.solve(solution.covariance[:4, :4], seen))
    return HeldByFile(
        *solution.mass_and_std(),
        float(np.sqrt(squared)),
        solution.values[shared],
    )


def _friction_between(problem: Problem, solution: Solution) -> RecordingVariability:
    """With what friction and offset differ by: from run to run, and what stretches of a run show of it."""
    count = problem.count
    own = len(FRICTION_TERMS) * problem.count
    places = [problem.own(number) for number in range(problem.motions)]
    runs = np.array([solution.values[place] for place in places])
    variances = np.array([np.diag(solution.covariance)[place] for place in places])
    # each motion has columns of its own; together they are those of one friction
    columns = np.sum(
        [problem.matrix[:, place][:, :own] for place in places],
        axis=0,
    )
    drift = np.zeros(own)
    for number in range(own):
        mine = problem.joint == number % count
        column = columns[mine, number]
        residual = solution.residual[mine]
        stretch = problem.stretch[mine]
        of_stretch = [
            float(residual[out] @ column[out]) / max(float(column[out] @ column[out]), 1e-12)
            for out in (stretch == label for label in np.unique(stretch))
        ]
        # what a stretch shows may be any of the three
        drift[number] = (
            np.sqrt(np.mean(np.square(of_stretch)) / len(FRICTION_TERMS)) if of_stretch else 0.0
        )
    usual = np.abs(runs[:, :own]).mean(axis=0)
    usual[2 * count :] = usual[count : 2 * count]
    stated = replace(solution.between, friction=usual, drift=drift)
    if len(runs) == 1:
        return stated
    # about their mean they differ by less than about the arm's own
    off = (runs - runs.mean(axis=0)) * np.sqrt(len(runs) / (len(runs) - 1))
    told = (len(runs) - 1) / len(runs)
    now = stated
    for _ in range(SPREAD_ITERATIONS):
        left = 1.0 - told * (1.0 - np.minimum(variances / (variances + now.std**2), 1.0))
        now = stated.learnt(
            now,
            off,
            left * now.std**2,
            ("friction", "offset"),
        )
    return now


def fit_payload(
    robot: Robot,
    loaded: Sequence[Motion],
    calibration: MotionCalibration,
    *,
    empty: Sequence[Motion] = (),
    centre: Centre | None = None,
    least: int = MIN_STRETCHES,
) -> MotionFit:
    """What all ``loaded`` motions hold, by what a calibration knows of the arm.

    Args:
        robot: As its file states it.
        loaded: With the payload, at least one.
        calibration: Of this arm; a ``torque_scale_std`` of 0 takes the torque constants as they are.
        empty: More motions with an empty hand, fitted together with the others.
        centre: Where that is stated; else the payload lies within a tenth of the arm's reach.
        least: Stretches that there have to be; with fewer than usual no interval holds.

    Raises:
        RecordingError: A motion is of no use, of other joints, or all together are too short.
        RobotError: Torque constants are no longer those of the calibration.
    """
    motions = [*loaded, *empty]
    joints = calibration.joints
    check_arm(robot, motions, calibration)
    arm = Arm.of(robot, joints, dict(motions[0].held))
    place = None if centre is None else centre[0]
    parts = weighable([equations(robot, motion, joints, place) for motion in motions])
    problem = Problem.of(parts, len(loaded))
    carrying = problem.carrying
    _refuse_other_joints(loaded, problem, calibration)
    stretches = problem.stretches_of(
        carrying,
        loaded[0].name,
        better_s=15.0,
        least=least,
    )
    known, terms = motion_prior.calibrated_prior(arm, calibration, len(motions))
    between = motion_prior.variability_of(calibration, motions)
    per_kg = motion_prior.payload_stds(arm)
    if centre is not None:
        per_kg[1:4] = np.maximum(centre[1], 1e-3)
    solution, opened, scatter = solve_following(problem, known, between, per_kg, calibration)
    tells = _weight_by_joint(problem, calibration.residual, calibration.correlation)
    residual = problem.rms_by_joint(solution.residual, carrying)
    covariances = _covariances(
        problem, solution, scatter[:PARAMETERS, :PARAMETERS], terms, calibration
    )
    # what is explained worse than the empty motions is not only noise: the arm is not where it was calibrated
    empty_residual = np.where(calibration.residual > 0.0, calibration.residual, np.nan)
    misfit = float(np.nansum(tells * np.square(residual / empty_residual)))
    covariances[CALIBRATION] *= max(1.0, misfit)
    variances = {name: float(part[0, 0]) for name, part in covariances.items()}
    # what few stretches or recordings say of their own scatter is uncertain
    freedom = [
        (variances[STRETCHES], stretches - 1.0),
        (variances[CALIBRATION], calibration.stretches - 1.0),
    ]
    freedom += [
        (variances[word], number)
        for word, number in solution.between.by_word.items()
        if word != DIFFERS
    ]
    halves = None
    if stretches >= 2 * MIN_STRETCHES:
        each = [problem.motion == number for number in range(len(loaded))]
        late = np.any(
            [mine & (problem.stretch > np.median(problem.stretch[mine])) for mine in each], axis=0
        )
        first, second = (
            solve(problem.only(kept), known, between, per_kg, calibration).mass_and_std()
            for kept in (~late, late | ~carrying)
        )
        halves = (first, second)
    followed, rows = np.nonzero(terms)
    return MotionFit(
        joints=arm.model.joint_names,
        values=(scale := calibration.torque_scale) * solution.values[:PARAMETERS],
        covariance=scale**2 * np.sum(list(covariances.values()), axis=0),
        parts={name: scale * float(np.sqrt(variance)) for name, variance in variances.items()},
        stretches=stretches,
        residual=residual,
        empty_residual=empty_residual,
        misfit=misfit,
        driven=problem.rms_by_joint(problem.torque, carrying),
        quantile=float(stdtrit(effective_freedom(sum(variances.values()), freedom), 0.975)),
        halves=halves,
        arm_kg=arm.kg,
        arm_over_urdf=calibration.arm_over_urdf,
        payload_prior=solution.payload_prior,
        keys=tuple(calibration.keys[row] for row in rows),
        arm=solution.values[PARAMETERS:][followed],
        arm_prior=known.values[PARAMETERS:][followed],
        arm_std=np.sqrt(np.diag(solution.prior.covariance))[PARAMETERS:][followed],
        off={kind: _of_its_own(problem, opened, kind) for kind in ("zero", "own_scale")},
        louder_kg=scale * _follows_torque(problem, solution),
        tells=tells,
        shown=_shown(
            problem,
            parts,
            solution,
            calibration,
            [motion.name for motion in loaded],
        ),
        solved=Solved(problem, solution, Rows.together(parts).start_s),
    )


def _refuse_other_joints(
    loaded: Sequence[Motion], problem: Problem, calibration: MotionCalibration
) -> None:
    """What the arm's own weight is on a joint, only that joint's motion with an empty hand says.

    Raises `RecordingError`: No joint moves both with the payload and without it.
    """
    moves = np.isin(
        np.arange(problem.count),
        problem.joint[problem.carrying],
    )
    known = calibration.residual > 0.0
    if not moves.any() or (moves & known).any():
        return
    names = np.array(calibration.joints)
    raise RecordingError(
        f"{loaded[0].name}: the two motions move different joints: {some(names[moves])} with the load, {some(names[known])} with "
        "the empty hand; what the arm itself weighs on a joint shows only where it moves in both: record the same motion twice"
    )


def _shown(
    problem: Problem,
    parts: Sequence[Rows],
    solution: Solution,
    calibration: MotionCalibration,
    names: Sequence[str],
) -> tuple[JointFit, ...]:
    """Torque over time of the motions with the payload, whose names these are."""
    explained = Explained(
        Rows.together(parts).start_s + 0.5 * WINDOW_S,
        problem.motion,
        problem.joint,
        problem.torque,
        solution.residual,
        problem.matrix[:, :PARAMETERS] @ solution.values[:PARAMETERS],
        problem.by_mass * _weights(calibration.residual, calibration.correlation)[problem.joint],
    )
    return explained.joint_fits(names, calibration.joints, calibration.residual)


def check_arm(robot: Robot, motions: Sequence[Motion], calibration: MotionCalibration) -> None:
    """That motions are of the joints, and the robot has the torque constants, of a calibration.

    Raises `RecordingError`, `RobotError`: They are of others.
    """
    for motion in motions:
        if set(motion.joints) != set(calibration.joints):
            raise RecordingError(
                f"{motion.name}: moves {', '.join(motion.joints)}, but the calibration is of {', '.join(calibration.joints)}: "
                "calibrate with motions of all of them"
            )
    for joint, constant in zip(calibration.joints, calibration.torque_constants, strict=True):
        check_torque_constant(robot, joint, constant, "motions were")


def check_torque_constant(robot: Robot, joint: str, constant: float, what: str) -> None:
    """That a robot file still has the torque constant [N m/A] that ``what`` calibrated with.

    Raises `RobotError`: It has another one.
    """
    now = robot.drive_trains[joint].torque_constant.value
    if abs(now / constant - 1.0) > 1e-6:
        raise RobotError(
            f"{robot.source.name}: the torque constant of {joint} is {now:g} N m/A, but {what} calibrated with {constant:g}: "
            "calibrate again"
        )


def _covariances(
    problem: Problem,
    solution: Solution,
    scatter: FloatArray,
    terms: FloatArray,
    calibration: MotionCalibration,
) -> dict[str, FloatArray]:
    """Of the payload's parameters by what they err by, each of shape (10, 10)."""
    # how the payload follows what its prior is made of: the calibration's values, what recordings differ by, its own size
    by_prior = solution.by_prior()
    follows = by_prior[:, PARAMETERS:] @ terms
    count = len(calibration.joints)
    opened = by_prior[:, :PARAMETERS] * solution.payload_prior
    geared = (
        by_prior[:, PARAMETERS + 11 * count : PARAMETERS + 12 * count]
        * motion_prior.LOAD_FRICTION_SPREAD
    )
    between = solution.between
    own = slice(problem.own(0).start, None)
    words = np.tile(
        [WORDS[kind] for kind in between.kinds],
        problem.motions,
    )
    of_own = by_prior[:, own]
    followed = of_own * np.tile(between.std, problem.motions)
    # how the payload follows each torque constant's share: the calibration's other terms lean on it, too
    by_share = (
        follows @ calibration.covariance[:, 12 * count : 13 * count] / motion_prior.LEAST_TORQUE_STD
    )
    apart = by_share @ by_share.T
    by_calibration = larger(
        follows @ calibration.deviations.T @ calibration.deviations @ follows.T,
        follows @ calibration.covariance @ follows.T - apart,
    )
    # nobody knows whether all torque constants are off together or each on its own: the larger covers every mixture
    together = calibration.torque_scale_std * solution.values[:PARAMETERS]
    return {
        STRETCHES: solution.noise(),
        UNDETERMINED: opened @ opened.T + geared @ geared.T,
        CALIBRATION: by_calibration,
        CONSTANTS: larger(np.outer(together, together), apart),
        **{
            word: followed[:, words == word] @ followed[:, words == word].T
            + (scatter if word == DIFFERS else 0.0)
            for word in dict.fromkeys(WORDS.values())
        },
    }


def _of_its_own(
    problem: Problem,
    solution: Solution,
    kind: str,
) -> tuple[FloatArray, FloatArray]:
    """What the loaded motions have of their own by joint, were nothing known of how far recordings differ, and its std, shape (n,).

    ``kind``: zero, or own_scale, which then counts with what all joints have in common. Where nothing tells it is 0, and infinite.
    """
    share = np.zeros((problem.count, len(solution.values)))
    for number in range(problem.loaded):
        own = problem.own(number)
        share[:, own][:, solution.between.kinds == kind] = np.eye(problem.count) / problem.loaded
        if kind == "own_scale":
            share[:, own.start + solution.between.place("common_scale")] = 1.0 / problem.loaded
    before, after = (
        np.sum(share @ each * share, axis=1)
        for each in (solution.prior.covariance, solution.covariance)
    )
    tells = 1.0 - after / before > LEAST_TOLD
    told = np.maximum(1.0 - after / before, LEAST_TOLD)
    return np.where(tells, share @ solution.values / told, 0.0), np.where(
        tells, np.sqrt(after / told), np.inf
    )


def _follows_torque(problem: Problem, solution: Solution) -> float:
    """How the mass follows the loaded motions' share of the torque in common [kg]."""
    common = solution.between.place("common_scale")
    shares = [problem.own(number).start + common for number in range(problem.loaded)]
    return float(
        solution.covariance[0, shares].sum() / solution.covariance[np.ix_(shares, shares)].sum()
    )


def _weight_by_joint(problem: Problem, residual: FloatArray, correlation: FloatArray) -> FloatArray:
    """How much of what the motions tell about a mass each joint tells that leaves so much over, shape (n,), sum 1."""
    weight = _weights(residual, correlation)
    told = np.bincount(
        problem.joint, np.square(weight[problem.joint] * problem.by_mass), minlength=problem.count
    )
    result: FloatArray = told / max(float(told.sum()), 1e-300)
    return result


def _weights(residual: FloatArray, correlation: FloatArray) -> FloatArray:
    """Of a window of each joint, shape (n,); 0 of one that did not move."""
    counts = residual > 0.0
    return np.where(
        counts,
        1.0 / (np.where(counts, residual, 1.0) * np.sqrt(correlation)),
        0.0,
    )
