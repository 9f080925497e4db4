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
from typing import Any

import numpy as np
from numpy.typing import NDArray

from proprio_ros.calibration_files.motions import (
    ARM_TERMS,
    BETWEEN,
    BODY_TERMS,
    FRICTION_TERMS,
    SPREAD_FACTORS,
    TERMS,
    Key,
    MotionCalibration,
)
from proprio_ros.errors import RecordingError, RobotError, some
from proprio_ros.identification.estimate import JointFit
from proprio_ros.identification.regression.arm_terms import ArmTerms
from proprio_ros.identification.regression.error_budget import ErrorBudget, Mixture
from proprio_ros.identification.regression.motion_equations import (
    MIN_STRETCHES,
    WINDOW_S,
    Arm,
    Problem,
    problem_of,
)
from proprio_ros.identification.regression.motion_prior import (
    URDF_SHARE,
    calibrated_terms,
    priors_of_calibration,
    priors_of_file,
    relative_torque_std,
)
from proprio_ros.identification.regression.recording_variability import (
    RecordingVariability,
    by_own_spread,
)
from proprio_ros.identification.regression.solve import (
    Priors,
    Solution,
    posterior,
    solve,
    solve_following,
    window_weights,
)
from proprio_ros.identification.regression.traces import Explained
from proprio_ros.identification.regression.trends import Trend, trend_of
from proprio_ros.identification.regression.unheard import heard_in_time
from proprio_ros.recordings.motions import Motion
from proprio_ros.records import FloatArray
from proprio_ros.robot import Robot
from proprio_ros.robot.regressor import PARAMETERS

SPREAD_ITERATIONS = 10
# A recording tells a joint's share of the torque where it makes its variance this much smaller: a guess.
LEAST_TOLD = 0.2
LEAST_PLACE_STD_M = 1e-3  # Nobody states a centre of mass better.
Centre = tuple[FloatArray, FloatArray]
"""A payload's centre of mass in its frame, and the standard deviation of each coordinate [m], each of shape (3,)."""


@dataclass(frozen=True)
class FittedTerms:
    """An arm's terms beside what was known of them, P of them."""

    keys: tuple[Key, ...]  # kind and joint
    values: FloatArray  # that came out, shape (P,)
    prior: FloatArray  # what should have come out, shape (P,)
    std: FloatArray  # how well that is known, shape (P,)


LEAST_PART = 0.01
"""Joints that contribute less to what is known of a mass say nothing against the others: a guess."""


@dataclass(frozen=True)
class ChainParts:
    """The mass by two parts of an arm's joints, each alone."""

    first_far: str  # the first joint of the part that is farther from the base
    near: tuple[float, float]  # by the joints before it: mass and its standard deviation [kg]
    far: tuple[float, float]  # by that joint and those after it


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
    # mean square of the former over that of the latter, each joint as much as it contributes: reduced chi-square
    misfit: float
    driven: FloatArray  # rms of the mean torque itself [N m], shape (n,)
    # half width of a 95 % interval in standard deviations: Student's, by the number of stretches
    quantile: float
    arm_kg: float  # mass of all that moves of the arm
    # by how much the torques of the arm's own bodies are those that its URDF says
    arm_over_urdf: float
    # standard deviations of the payload's ten parameters under their prior, shape (10,)
    payload_prior: FloatArray
    arm: FittedTerms  # the arm's, as the motions with the payload show them
    # how much less the motions with the payload are read than the empty ones, and its std, shape (n,) each: by zero, positions
    # [rad or m], by own_scale, torques, relative to what is read; 0 and infinite where nothing tells
    off: Mapping[str, tuple[FloatArray, FloatArray]]
    # what the mass is too large by per part that all these torques are read too large by, if nothing shows that
    louder_kg: float
    tells: FloatArray  # how much of what is known of the mass each joint tells, shape (n,), sum 1
    shown: tuple[JointFit, ...]  # torque over time, for a picture
    spread_evidence: (
        FloatArray  # logarithm of how likely each of `PAIRS` of spreads makes it, shape (F,)
    )
    evidence_of_more: FloatArray  # that of another one like it, as it is expected, shape (F,)
    mixture: Mixture  # that its interval is of [kg], torque constants as they are stated
    # what all of it was made of
    problem: Problem
    priors: Priors
    calibration: MotionCalibration
    solution: Solution
    scatter: FloatArray  # of it over spreads of what recordings differ by, covariance, shape (U, U)

    @functools.cached_property
    def trends(self) -> tuple[Trend, ...]:
        """What changes along each motion with the payload; it takes a quarter of a fit, and few who fit ask for it."""
        return tuple(
            trend_of(self.joints, self.problem, self.solution, number)
            for number in range(self.problem.loaded)
        )

    @functools.cached_property
    def halves(self) -> tuple[tuple[float, float], tuple[float, float]] | None:
        """Mass and its standard deviation [kg] by the first and by the second half of the motions with the payload.

        The motions with an empty hand count with both. None where there are too few stretches to be halved.
        """
        if self.stretches < 2 * MIN_STRETCHES:
            return None
        problem = self.problem
        late = np.zeros(len(problem.motion), dtype=bool)
        for number in range(problem.loaded):
            mine = problem.motion == number
            late |= mine & (problem.stretch > np.median(problem.stretch[mine]))
        # one after the other: equations of a long motion take a tenth of what the process holds
        first = self._weighed_by(problem.only(~late))
        return first, self._weighed_by(problem.only(late | ~problem.carrying))

    def _weighed_by(self, part: Problem) -> tuple[float, float]:
        """Mass and its standard deviation [kg] by some of the equations."""
        mass, std = solve(part, self.priors, self.calibration).mass_and_std()
        scale = self.calibration.torque_scale
        return scale * mass, scale * std

    @functools.cached_property
    def along_chain(self) -> ChainParts | None:
        """The mass by the joints before one joint and by the others, there where the two differ most.

        None where one of any two parts contributes next to nothing.
        """
        near_tells = np.cumsum(self.tells)[:-1]  # by the joints before joint 1, 2, ..
        contribute = np.minimum(near_tells, 1.0 - near_tells) > LEAST_PART
        cuts = [1 + int(number) for number in np.flatnonzero(contribute)]
        if not cuts:
            return None
        cut = max(cuts, key=self._differ_at)
        near = self._weighed_by(self.problem.only(self.problem.joint < cut))
        far = self._weighed_by(self.problem.only(self.problem.joint >= cut))
        return ChainParts(self.joints[cut], near, far)

    def _differ_at(self, cut: int) -> float:
        """By how many standard deviations the joints before a joint and the others differ, with the weights of the whole fit."""
        before = self.problem.joint < cut
        near, near_std = self._mass_by(before)
        far, far_std = self._mass_by(~before)
        return abs(near - far) / float(np.hypot(near_std, far_std))

    def _mass_by(self, mine: NDArray[np.bool_]) -> tuple[float, float]:
        """Mass and its formal standard deviation [kg] by some of the equations, shape (E,)."""
        solution = self.solution
        scaled = solution.scaled[mine]
        side = scaled.T @ (self.problem.torque * solution.weight)[mine]
        values, covariance = posterior(scaled.T @ scaled, side, solution.prior)
        return float(values[0]), float(np.sqrt(covariance[0, 0]))

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


def run_entry(motion: Motion, load_kg: float) -> dict[str, Any]:
    """What a calibration keeps of a motion with a known load."""
    return {
        "name": motion.name,
        "duration_s": float(motion.times_s[-1]),
        "load_kg": load_kg,
    }


def learn_arm(
    robot: Robot, motions: Sequence[Motion]
) -> tuple[MotionCalibration, tuple[JointFit, ...]]:
    """What motions with an empty hand say about an arm, and torque of each joint as it explains it.

    ``robot``: as its file states it; ``motions``: of the same joints, at least one.

    Raises `RecordingError`: A motion is of no use, or all together are too short.
    """
    joints = motions[0].joints
    arm = Arm.of(
        robot,
        joints,
        dict(motions[0].held),
    )
    problem = problem_of(robot, motions, joints, 0)
    problem.stretches_of(
        ~problem.carrying,
        motions[0].name,
        better_s=50.0,
    )
    priors = priors_of_file(robot, arm, len(motions))
    problem = heard_in_time(problem, priors, motions)
    solution, spread_evidence = _solved_empty(problem, priors)
    mean = _mean_of_runs(problem)
    variability = _friction_variability(problem, solution)
    names = arm.model.joint_names
    over_urdf = _over_urdf(problem, solution, priors)
    learnt = MotionCalibration(
        joints=names,
        torque_constants=np.array(
            [robot.drive_trains[name].torque_constant.value for name in names]
        ),
        values=mean @ solution.values,
        covariance=mean @ solution.covariance @ mean.T,
        deviations=solution.deviations @ mean.T,
        friction_spread=variability.std[: len(FRICTION_TERMS) * arm.count],
        between={
            kind: (variability.spreads[kind], variability.recordings[kind])
            for kind in sorted(BETWEEN)
        },
        residual=solution.rms,
        correlation=solution.correlation,
        torque_scale=1.0,
        torque_scale_std=_torque_scale_std(robot, names, over_urdf),
        arm_over_urdf=over_urdf,
        fingerprint=robot.model.fingerprint(),
        runs=tuple(run_entry(motion, 0.0) for motion in motions),
        spread_evidence=spread_evidence,
        tells=_weight_by_joint(problem, solution.rms, solution.correlation),
    )
    return learnt, _shown(problem, solution, learnt, motions)


def _solved_empty(problem: Problem, priors: Priors) -> tuple[Solution, FloatArray]:
    """Of motions with an empty hand: of several, with what differs between them, and how likely each spread makes them."""
    if problem.motions == 1:
        return solve(problem, priors), np.zeros(len(SPREAD_FACTORS))
    followed = solve_following(problem, priors, None)
    solution = followed.estimate
    averaged = replace(solution, covariance=solution.covariance + followed.scatter)
    return averaged, by_own_spread(followed.log_likelihood)


def _mean_of_runs(problem: Problem) -> FloatArray:
    """A calibration's terms by the unknowns: the arm's as they are, friction's mean over the motions, shape (20 n, U)."""
    count = problem.count
    shared = ARM_TERMS * count
    friction = len(FRICTION_TERMS) * count
    mean = np.zeros((TERMS * count, problem.matrix.shape[1]))
    mean[:shared, PARAMETERS : PARAMETERS + shared] = np.eye(shared)
    for number in range(problem.motions):
        of_motion = mean[shared:, problem.own(number)]
        of_motion[:, :friction] = np.eye(friction) / problem.motions
    return mean


def _over_urdf(
    problem: Problem,
    solution: Solution,
    priors: Priors,
) -> float:
    """By how much the torques of the arm's bodies are those that its URDF says, by least squares."""
    bodies = ArmTerms(problem.count, PARAMETERS).bodies
    columns = problem.matrix[:, bodies]
    fitted = columns @ solution.values[bodies]
    by_urdf = columns @ priors.unknowns.values[bodies]
    return float(fitted @ by_urdf / (by_urdf @ by_urdf))


def _torque_scale_std(
    robot: Robot,
    names: Sequence[str],
    over_urdf: float,
) -> float:
    """How well the torque constants are known, relative, of an arm that by its torques is so much heavier than its URDF."""
    scale_std = max(relative_torque_std(robot, name) for name in names)
    # where the robot file knows the arm's weight, torques that say another one are the torque constants' doing
    limit = URDF_SHARE
    if robot.arm_scale.std > 0.0:
        limit = min(
            2.0 * float(np.hypot(robot.arm_scale.std, scale_std)),
            max(URDF_SHARE, 2.0 * scale_std),
        )
    if abs(over_urdf - 1.0) > limit:
        return float(np.hypot(scale_std, over_urdf - 1.0))
    return scale_std


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
    arm = Arm.of(
        robot,
        joints,
        dict(motions[0].held),
    )
    problem = problem_of(robot, motions, joints, len(motions))
    solution = solve(
        problem,
        priors_of_file(robot, arm, len(motions)),
    )
    seen = solution.values[:4]  # mass and first moment: what gravity pulls at
    squared = float(seen @ np.linalg.solve(solution.covariance[:4, :4], seen))
    return HeldByFile(
        *solution.mass_and_std(),
        sigmas=float(np.sqrt(squared)),
        arm=solution.values[PARAMETERS : problem.own(0).start],
    )


def _friction_variability(problem: Problem, solution: Solution) -> RecordingVariability:
    """With what friction and offset differ by: from run to run, and what stretches of a run show of it."""
    count = problem.count
    places = [problem.own(number) for number in range(problem.motions)]
    runs = np.array([solution.values[place] for place in places])  # (R, 5 n + 3)
    usual = np.abs(runs[:, : len(FRICTION_TERMS) * count]).mean(axis=0)
    usual[2 * count :] = usual[count : 2 * count]  # an offset counts by Coulomb friction
    drift = _friction_drift(problem, solution)
    stated = replace(solution.variability, friction=usual, drift=drift)
    if len(runs) == 1:
        return stated
    # about their mean they differ by less than about the arm's own
    count_less = len(runs) - 1
    off = (runs - runs.mean(axis=0)) * np.sqrt(len(runs) / count_less)
    determined = count_less / len(runs)
    variances = np.array([np.diag(solution.covariance)[place] for place in places])
    now = stated
    for _ in range(SPREAD_ITERATIONS):
        shrunk = np.minimum(variances / (variances + now.std**2), 1.0)
        left = 1.0 - determined * (1.0 - shrunk)
        now = stated.learnt(
            now,
            off,
            left * now.std**2,
            ("friction", "offset"),
        )
    return now


def _friction_drift(problem: Problem, solution: Solution) -> FloatArray:
    """What friction and offsets change by within a motion, standard deviation over its stretches, shape (3 n,)."""
    count = problem.count
    terms = len(FRICTION_TERMS) * count
    # each motion has columns of its own; together they are those of one friction
    places = [problem.own(number) for number in range(problem.motions)]
    own = [problem.matrix[:, place][:, :terms] for place in places]
    columns = np.sum(own, axis=0)  # (E, 3 n)
    drift = np.zeros(terms)
    for number in range(terms):
        mine = problem.joint == number % count
        column = columns[mine, number]
        residual = solution.residual[mine]
        stretch = problem.stretch[mine]
        of_stretch = []
        for label in np.unique(stretch):
            out = stretch == label
            size = max(float(column[out] @ column[out]), 1e-12)
            of_stretch.append(float(residual[out] @ column[out]) / size)
        if of_stretch:
            # what a stretch shows may be any of the three
            squares = np.mean(np.square(of_stretch))
            drift[number] = np.sqrt(squares / len(FRICTION_TERMS))
    return drift


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
    check_arm(robot, motions, calibration)
    arm = Arm.of(
        robot,
        calibration.joints,
        dict(motions[0].held),
    )
    priors = _priors(arm, calibration, motions, centre)
    problem = _payload_problem(
        robot,
        loaded,
        motions,
        calibration,
        priors,
        centre,
        least,
    )
    carrying = problem.carrying
    stretches = problem.stretches_of(
        carrying,
        loaded[0].name,
        better_s=15.0,
        least=least,
    )
    followed = solve_following(problem, priors, calibration)
    solution = followed.estimate
    tells = _weight_by_joint(problem, calibration.residual, calibration.correlation)
    residual = problem.rms_by_joint(solution.residual, carrying)
    empty_residual = _of_moved(calibration.residual)
    misfit = _misfit(tells, residual, empty_residual)
    budget = ErrorBudget.of(problem, followed, calibration, misfit, stretches)
    scale = calibration.torque_scale
    return MotionFit(
        joints=arm.model.joint_names,
        values=scale * solution.values[:PARAMETERS],
        covariance=scale**2 * budget.covariance,
        parts=budget.mass_stds(scale),
        stretches=stretches,
        residual=residual,
        empty_residual=empty_residual,
        misfit=misfit,
        driven=problem.rms_by_joint(problem.torque, carrying),
        quantile=budget.quantile,
        arm_kg=arm.kg,
        arm_over_urdf=calibration.arm_over_urdf,
        payload_prior=solution.payload_prior,
        arm=_fitted_terms(problem, priors, solution, calibration),
        off={kind: _of_its_own(problem, followed.opened, kind) for kind in ("zero", "own_scale")},
        louder_kg=scale * _follows_torque(problem, solution),
        tells=tells,
        shown=_shown(problem, solution, calibration, loaded),
        spread_evidence=followed.log_likelihood,
        evidence_of_more=followed.log_likelihood_of_more,
        mixture=budget.mixture,
        problem=problem,
        priors=priors,
        calibration=calibration,
        solution=solution,
        scatter=followed.scatter,
    )


def _payload_problem(
    robot: Robot,
    loaded: Sequence[Motion],
    motions: Sequence[Motion],
    calibration: MotionCalibration,
    priors: Priors,
    centre: Centre | None,
    least: int,
) -> Problem:
    """The equations of motions, of which the first ones hold the payload; as `fit_payload` has them."""
    place = None if centre is None else centre[0]
    problem = problem_of(
        robot,
        motions,
        calibration.joints,
        len(loaded),
        place,
    )
    _refuse_other_joints(loaded, problem, calibration)
    # of too few nothing can be fitted
    problem.stretches_of(problem.carrying, loaded[0].name, better_s=15.0, least=least)
    return heard_in_time(problem, priors, motions, calibration)


def _of_moved(residual: FloatArray) -> FloatArray:
    """Of joints, NaN of one that did not move."""
    return np.where(residual > 0.0, residual, np.nan)


def _misfit(
    tells: FloatArray,
    residual: FloatArray,
    empty_residual: FloatArray,
) -> float:
    """How much worse motions are explained than empty ones, each joint as much as it tells: reduced chi-square."""
    return float(np.nansum(tells * np.square(residual / empty_residual)))


def _fitted_terms(
    problem: Problem, priors: Priors, solution: Solution, calibration: MotionCalibration
) -> FittedTerms:
    """All that a calibration knows: the arm's terms, and each motion's friction."""
    unknowns, terms = np.nonzero(calibrated_terms(problem.count, problem.motions))
    of_arm = PARAMETERS + unknowns
    return FittedTerms(
        keys=tuple(calibration.keys[term] for term in terms),
        values=solution.values[of_arm],
        prior=priors.unknowns.values[of_arm],
        std=np.sqrt(np.diag(solution.prior.covariance))[of_arm],
    )


def _priors(
    arm: Arm, calibration: MotionCalibration, motions: Sequence[Motion], centre: Centre | None
) -> Priors:
    """By a calibration, and by where the payload is stated to be."""
    priors = priors_of_calibration(arm, calibration, motions)
    if centre is None:
        return priors
    per_kg = priors.per_kg.copy()
    per_kg[1:4] = np.maximum(centre[1], LEAST_PLACE_STD_M)
    return replace(priors, per_kg=per_kg)


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
    solution: Solution,
    calibration: MotionCalibration,
    motions: Sequence[Motion],
) -> tuple[JointFit, ...]:
    """Torque over time of the first motions, whose names are shown."""
    weight = window_weights(calibration.residual, calibration.correlation)
    explained = Explained(
        middle_s=problem.start_s + 0.5 * WINDOW_S,
        motion=problem.motion,
        joint=problem.joint,
        measured=problem.torque,
        left_over=solution.residual,
        payload=problem.matrix[:, :PARAMETERS] @ solution.values[:PARAMETERS],
        by_mass=problem.by_mass * weight[problem.joint],
    )
    names = [motion.name for motion in motions]
    return explained.joint_fits(names, calibration.joints, calibration.residual)


def check_arm(
    robot: Robot,
    motions: Sequence[Motion],
    calibration: MotionCalibration,
) -> None:
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


def check_torque_constant(
    robot: Robot,
    joint: str,
    constant: float,
    what: str,
) -> None:
    """That a robot file still has the torque constant of a calibration.

    Args:
        robot: As its file states it.
        joint: Of it.
        constant: That the calibration was made with [N m/A].
        what: Was recorded for it, with its verb.

    Raises `RobotError`: It has another one.
    """
    now = robot.drive_trains[joint].torque_constant.value
    if abs(now / constant - 1.0) > 1e-6:
        raise RobotError(
            f"{robot.source.name}: the torque constant of {joint} is {now:g} N m/A, but {what} calibrated with {constant:g}: "
            "calibrate again"
        )


def _of_its_own(
    problem: Problem,
    solution: Solution,
    kind: str,
) -> tuple[FloatArray, FloatArray]:
    """What the loaded motions have of their own by joint, were nothing known of how far recordings differ, and its std, shape (n,).

    ``kind``: zero, or own_scale, which then counts with what all joints have in common. Where nothing tells it is 0, and infinite.
    """
    share = np.zeros((problem.count, len(solution.values)))  # (n, U)
    for number in range(problem.loaded):
        own = problem.own(number)
        share[:, own][:, solution.variability.kinds == kind] = (
            np.eye(problem.count) / problem.loaded
        )
        if kind == "own_scale":
            share[:, own.start + solution.variability.place("common_scale")] = 1.0 / problem.loaded
    before = np.sum(
        share @ solution.prior.covariance * share,
        axis=1,
    )
    after = np.sum(
        share @ solution.covariance * share,
        axis=1,
    )
    shown = 1.0 - after / before > LEAST_TOLD
    determined = np.maximum(1.0 - after / before, LEAST_TOLD)
    values = np.where(
        shown,
        share @ solution.values / determined,
        0.0,
    )
    return values, np.where(
        shown,
        np.sqrt(after / determined),
        np.inf,
    )


def _follows_torque(problem: Problem, solution: Solution) -> float:
    """How the mass follows the loaded motions' share of the torque in common [kg]."""
    common = solution.variability.place("common_scale")
    shares = [problem.own(number).start + common for number in range(problem.loaded)]
    together = solution.covariance[np.ix_(shares, shares)].sum()
    return float(solution.covariance[0, shares].sum() / together)


def _weight_by_joint(
    problem: Problem,
    residual: FloatArray,
    correlation: FloatArray,
) -> FloatArray:
    """How much of what the motions tell about a mass each joint tells that leaves so much over, shape (n,), sum 1."""
    weight = window_weights(residual, correlation)[problem.joint]
    squares = problem.counted * np.square(weight * problem.by_mass)
    by_joint = np.bincount(
        problem.joint,
        squares,
        minlength=problem.count,
    )
    result: FloatArray = by_joint / max(float(by_joint.sum()), 1e-300)
    return result
