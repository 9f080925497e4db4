"""Which run to make next: candidates inside the limits, simulated, and ranked by what they would determine.

The interval of a run that has not been made follows from its sensitivities alone (expected Fisher information, Lehmann & Casella
1998, sec. 2.5), under what is known about the robot: with the same prior as a weighing, so a plan made with a calibration
promises what a weighing with it will give.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from proprio_ros.errors import ConfigurationError
from proprio_ros.excitation.plans import largest_current_A
from proprio_ros.experiment_design.candidates import (
    CLEARANCE_M,
    LIMIT_MARGIN,
    candidate_joints,
    currents_beyond,
    expected_coulomb,
    start_poses,
    still_run,
)
from proprio_ros.experiment_design.search import SAME_KIND, Search
from proprio_ros.identification.calibration_estimate import (
    CalibrationEstimate,
    ExcitationPlan,
    Weighable,
)
from proprio_ros.identification.estimate import Verdict
from proprio_ros.identification.gates import (
    LITTLE_TRAVEL,
    MIN_USED,
)
from proprio_ros.identification.prepared_runs import (
    KnownLoad,
    PreparedRun,
    prepare_run,
)
from proprio_ros.identification.problem import Problem
from proprio_ros.identification.robot_unknowns import (
    load_unknowns,
    robot_unknowns,
)
from proprio_ros.identification.unknowns import (
    Role,
    scaled_inverse,
)
from proprio_ros.kinds import Key, label_of
from proprio_ros.quantity import Z95, shown
from proprio_ros.robot import Robot
from proprio_ros.robot.kinematics import clearance
from proprio_ros.sim.payload import PayloadFacts

SECONDS = 3.0  # that a search takes where nobody says otherwise
# start positions of a driven joint, and of each locked one, where one good run will do
COARSE_STARTS = 4
COARSE_POSES = 2
ROUNDING = 1e-12  # of the information on a mass: less of it that is left may be none
DURATION_S = 0.6  # of every run
TYPICAL_KG = 0.02  # for which a calibration says how well it weighs
ADVISED_TERMS = (
    "torque_constant",
    "coulomb",
    "viscous",
    "load_friction",
    "armature",
)


@dataclass(frozen=True)
class _Candidates:
    """Runs of one joint from one pose, simulated with S masses (or with a known load, S = 1)."""

    problem: Problem  # of the R runs
    dq: np.ndarray  # sensitivities, shape (S, R, T, F)
    alive: np.ndarray  # samples that would count, shape (S, R, T)
    travel: np.ndarray  # signed [rad], shape (S, R)
    clearance_m: np.ndarray  # shape (R,)
    fits: np.ndarray  # whether a run is inside all limits, shape (S, R)

    def known_after(
        self,
        s: int,
        r: int,
    ) -> tuple[list[Key], np.ndarray]:
        """Keys of the unknowns that one run touches, and what is known of them after it, everything else under its prior."""
        return _known_after(
            self.problem,
            self.dq[s],
            self.alive[s],
            [r],
        )


class _Weighing(NamedTuple):
    """A run that would weigh a typical object."""

    std: float  # expected of its mass [kg]
    run: PreparedRun
    alive: np.ndarray  # samples that would count, shape (T,)


def _known_after(
    problem: Problem,
    dq: np.ndarray,
    alive: np.ndarray,
    runs: Sequence[int],
) -> tuple[list[Key], np.ndarray]:
    """Keys and precision of the unknowns that some runs touch, after them; dq (R, T, F), alive (R, T)."""
    estimated = problem.estimated_unknowns()
    own = [f for f, u in enumerate(estimated) if u.shared or u.scope in runs]
    precision = problem.coordinates.prior_precision[np.ix_(own, own)].copy()
    for r in runs:
        weight = problem.weight[r][: alive.shape[1]][alive[r]]
        rows = dq[r][alive[r]][:, own] * weight[:, None]
        precision += rows.T @ rows
    return [estimated[f].key for f in own], precision


def plan(
    robot: Robot,
    masses_kg: Sequence[float],
    facts: PayloadFacts | None = None,
    count: int = 10,
    progress: Callable[[str], None] = lambda _: None,
    seconds: float = SECONDS,
) -> list[ExcitationPlan]:
    """Rank weighings by the widest interval they would give over the masses that the hand may hold; a run must suit all of them.

    The search ends when time is over, when nothing is left to try, or by Ctrl-C, with the best so far.

    Args:
        robot: Whose runs; with a calibration its promises are better.
        masses_kg: What the hand may hold.
        facts: What is known about the object otherwise.
        count: At most so many.
        progress: Called with how far the search is, in words.
        seconds: How long it may take.

    Returns: the best first.

    Raises:
        ConfigurationError: A mass is not positive, or no candidate suits all of them.
    """
    if not masses_kg or min(masses_kg) <= 0.0:
        raise ConfigurationError(
            f"the masses to plan for must be positive, not {list(masses_kg)} kg"
        )
    for name in robot.drive_trains:
        if not np.isfinite(largest_current_A(robot, name)):
            raise ConfigurationError(
                f"{robot.source.name}: nothing says how much {name} may be driven with, neither its URDF's limit of effort nor the "
                f"file: state joints.{name}.motor.current_limit_A"
            )
    joints = candidate_joints(robot)
    if not joints:
        raise ConfigurationError(
            f"{robot.source.name}: no joint carries the hand against gravity in a pose {100.0 * CLEARANCE_M:.0f} cm above the "
            "base's plane: is payload_frame the link that holds, and does gravity point down in the frame of the root link?"
        )
    masses = np.array(sorted(masses_kg))
    search = Search(
        robot,
        joints,
        partial(_weighings, robot, masses, facts or PayloadFacts()),
    )
    try:
        search.run(seconds, progress)
    except KeyboardInterrupt:
        if not search.plans:
            raise
        progress("stopped: these are the best so far")
    if not search.plans:
        ends = shown(
            "kg",
            masses[0],
            masses[-1],
            spec=".0f",
            between=" to ",
        )
        cure = "narrow the range, plan for light and heavy objects apart, or allow more time"
        none = f"no run of {DURATION_S} s suits all masses from {ends} inside the robot's limits"
        raise ConfigurationError(f"{none}: {cure}")
    return search.plans[:count]


def _weighings(
    robot: Robot,
    masses: np.ndarray,
    facts: PayloadFacts,
    joint: str,
    pose: Mapping[str, float],
) -> Iterator[tuple[float, ExcitationPlan]]:
    """Runs of one joint from one pose that suit all masses (S,) [kg], each with the largest standard deviation of them [kg]."""
    candidates = _candidates(robot, masses, facts, None, joint, pose)
    if candidates is None:
        return
    for r in np.flatnonzero(candidates.fits.all(axis=0)).tolist():
        stds = []
        for s in range(len(masses)):
            stds.append(_std_of_mass(*candidates.known_after(s, r)))
        widest = int(np.argmax(stds))
        if np.isfinite(stds[widest]):
            half = shown("kg", Z95 * stds[widest], spec=".1f")
            at = shown("kg", masses[widest], spec=".0f")
            words = f"widest 95 % interval +-{half}, at {at}"
            yield (
                stds[widest],
                _as_plan(candidates, r, stds, words),
            )


def with_advice(
    robot: Robot,
    estimate: CalibrationEstimate,
    count: int = 3,
    progress: Callable[[str], None] = lambda _: None,
) -> CalibrationEstimate:
    """A calibration of pushes with what comes after it: what can be weighed with it, and the runs that would help most.

    One that is rejected, or of free swings, gets no advice, and no further runs one that was only brought up to date.

    Args:
        robot: Without the calibration.
        estimate: The calibration.
        count: At most so many further runs.
        progress: Called with what is being looked for, in words.
    """
    calibration = estimate.calibration
    whole = estimate.whole
    if calibration is None:
        return estimate
    began = time.perf_counter()
    suggestions: list[ExcitationPlan] = []
    can_weigh = None
    if estimate.verdict is not Verdict.REJECTED and calibration.swing_error == 0.0:
        if whole is not None:
            progress("looking for the run that would help most")
            learnt = robot.with_calibration(whole)
            one_way = estimate.driven_one_way
            if one_way:  # then nothing is worth advice but the other way
                found = advise(learnt, tuple(one_way), 10 * count)
                other_way = [p for p in found if (p.travel[0] > 0.0) != one_way[p.joint]]
                suggestions = other_way[:count]
            else:
                suggestions = advise(learnt, whole.joints, count)
        if estimate.verdict is Verdict.ACCEPTED:
            if whole is None:
                progress("looking at what can be weighed")
            can_weigh = weighable(
                robot.with_calibration(calibration),
                calibration.joints,
            )
    timing_s = {
        **estimate.timing_s,
        "advice": time.perf_counter() - began,
    }
    return replace(
        estimate,
        advice=tuple(suggestions),
        weighable=can_weigh,
        timing_s=timing_s,
    )


def advise(
    robot: Robot,
    joints: Sequence[str],
    count: int = 3,
) -> list[ExcitationPlan]:
    """Empty-hand runs that would teach most about the drive trains of these joints, given the robot's calibration.

    Ranked by how much each shrinks the joint uncertainty of torque constants, friction and armatures (D-optimality).

    Args:
        robot: Calibrated.
        joints: Whose drive trains are to be learnt, and which may be driven.
        count: At most so many.

    Raises:
        ConfigurationError: The robot is not calibrated.
    """
    calibration = robot.calibration
    if calibration is None:
        raise ConfigurationError("advice on further runs needs a calibration")
    wanted: list[Key] = [(term, joint) for joint in joints for term in ADVISED_TERMS]
    wanted = [key for key in wanted if key in calibration.keys]
    place = [calibration.keys.index(key) for key in wanted]
    old = calibration.covariance[np.ix_(place, place)]
    simulate = partial(
        _candidates,
        robot,
        np.zeros(1),
        PayloadFacts(),
        KnownLoad(),
    )
    turning = [joint for joint in joints if robot.model.joint(joint).kind != "prismatic"]
    found: list[tuple[float, ExcitationPlan]] = []
    for candidates, r in _suitable(robot, turning, COARSE_STARTS, COARSE_POSES, simulate):
        keys, precision = candidates.known_after(0, r)
        taught = _taught(wanted, old, keys, precision)
        words = (
            f"would shrink the uncertainty of {label_of(taught.most)} to {100 * taught.left:.0f} %"
        )
        found.append((taught.gain, _as_plan(candidates, r, [], words)))
    found.sort(key=lambda entry: -entry[0])
    return _varied([entry for _, entry in found], count)


class _Taught(NamedTuple):
    """What a run would teach."""

    gain: float  # of information about all that is wanted [nat]
    most: Key  # of what it would teach most
    left: float  # part of that one's standard deviation that would be left


def _taught(
    wanted: Sequence[Key], old: np.ndarray, keys: Sequence[Key], precision: np.ndarray
) -> _Taught:
    """From the covariance (W, W) of what is wanted to the precision (K, K) of what a run touches."""
    # of other joints' drive trains this run determines only what is correlated with its own
    shared = [key for key in wanted if key in keys]
    now = [keys.index(key) for key in shared]
    then = [wanted.index(key) for key in shared]
    after = scaled_inverse(precision)[np.ix_(now, now)]
    before = old[np.ix_(then, then)]
    _, volume_before = np.linalg.slogdet(before)
    _, volume_after = np.linalg.slogdet(after)
    ratio = np.sqrt(np.diag(after) / np.diag(before))
    best = int(np.argmin(ratio))
    return _Taught(
        0.5 * float(volume_before - volume_after),
        shared[best],
        float(ratio[best]),
    )


def weighable(robot: Robot, joints: Sequence[str]) -> Weighable | None:
    """What the best runs of two of these joints, each driven both ways, would together determine of a typical object's mass.

    None where no run of these joints suits such an object.
    """
    facts = PayloadFacts()
    simulate = partial(
        _candidates,
        robot,
        np.array([TYPICAL_KG]),
        facts,
        None,
    )
    driven = [joint for joint in candidate_joints(robot) if joint in joints]
    best = _best_both_ways(_suitable(robot, driven, COARSE_STARTS, COARSE_POSES, simulate))
    chosen = sorted(
        best,
        key=lambda joint: min(each.std for each in best[joint].values()),
    )[:2]
    if not chosen:
        return None
    weighings = [each for joint in chosen for each in best[joint].values()]
    prepared = [each.run for each in weighings]
    unknowns = load_unknowns(robot, prepared, facts, Role.ESTIMATED, TYPICAL_KG)
    problem = Problem(robot, prepared, facts, unknowns)
    _, _, dq = problem.simulate(problem.base[None], problem.estimated)
    alive = np.array([each.alive for each in weighings])
    known = _known_after(
        problem,
        dq[0],
        alive,
        range(len(weighings)),
    )
    return Weighable(
        TYPICAL_KG,
        _std_of_mass(*known),
        tuple(joint for joint in joints if joint in chosen),
    )


def _best_both_ways(
    suitable: Iterable[tuple[_Candidates, int]],
) -> dict[str, dict[bool, _Weighing]]:
    """The best run of each joint, by whether it goes upwards."""
    best: dict[str, dict[bool, _Weighing]] = {}
    for candidates, r in suitable:
        std = _std_of_mass(*candidates.known_after(0, r))
        run = candidates.problem.runs[r]
        ways = best.setdefault(run.run.joint, {})
        upwards = bool(candidates.travel[0, r] > 0.0)
        if upwards not in ways or std < ways[upwards].std:
            ways[upwards] = _Weighing(
                std,
                run,
                candidates.alive[0, r],
            )
    return best


def _std_of_mass(keys: Sequence[Key], precision: np.ndarray) -> float:
    """What a precision leaves open of the mass [kg]; infinite where nothing tells it."""
    row = keys.index("payload_mass")
    diagonal = np.diag(precision)
    if diagonal[row] <= 0.0:
        return np.inf
    scale = 1.0 / np.sqrt(diagonal)
    others = np.delete(np.arange(len(keys)), row)
    scaled = precision * scale[:, None] * scale
    # the part of what is known of the mass that is not taken up by what else could have caused it
    left = 1.0 - scaled[row, others] @ np.linalg.solve(
        scaled[np.ix_(others, others)], scaled[others, row]
    )
    return float(scale[row] / np.sqrt(left)) if left > ROUNDING else np.inf


def _varied(plans: Sequence[ExcitationPlan], count: int) -> list[ExcitationPlan]:
    """The best, but not ten times the same: a weighing gains from both directions and from other joints."""
    seen: Counter[tuple[str, str]] = Counter()
    kept = []
    for entry in plans:
        seen[entry.joint, entry.kind] += 1
        if seen[entry.joint, entry.kind] <= SAME_KIND:
            kept.append(entry)
    return kept[:count]


def _suitable(
    robot: Robot,
    joints: Sequence[str],
    starts: int,
    locked: int,
    simulate: Callable[[str, Mapping[str, float]], _Candidates | None],
) -> Iterator[tuple[_Candidates, int]]:
    """Candidates that stay inside all limits whatever is in the hand, one after the other, and the place of each among its like."""
    for joint in joints:
        for pose in start_poses(robot, joint, starts, locked):
            candidates = simulate(joint, pose)
            if candidates is not None:
                yield from (
                    (candidates, r) for r in np.flatnonzero(candidates.fits.all(axis=0)).tolist()
                )


def _candidates(
    robot: Robot,
    masses: np.ndarray,
    facts: PayloadFacts,
    load: KnownLoad | None,
    joint: str,
    pose: Mapping[str, float],
) -> _Candidates | None:
    """Simulate the runs of one joint from one pose with each mass [kg] in the hand, or a known load; None: no current moves it."""
    prepared = _runs_from(robot, masses, facts, load, joint, pose)
    if not prepared:
        return None
    problem, values = _guesses(robot, masses, facts, load, prepared)
    with np.errstate(over="ignore", invalid="ignore"):
        q, v, dq = problem.simulate(values, problem.estimated)
    alive = np.isfinite(q) & np.isfinite(dq).all(axis=3)
    alive &= np.abs(v) < robot.drive_trains[joint].usable_velocity
    alive = np.cumprod(alive, axis=2).astype(bool)
    start = pose[joint]
    reached = np.clip(q, -10.0, 10.0)
    reached = np.where(np.isfinite(q), reached, start)
    low = reached.min(axis=2)
    high = reached.max(axis=2)
    clear = np.zeros(len(prepared))
    for r in range(len(prepared)):
        ends = (float(low[:, r].min()), float(high[:, r].max()), start)
        clear[r] = _lowest_m(robot, pose, joint, ends)
    limits = robot.model.joint(joint)
    off = np.where(alive, q, start) - start
    fits = (low > limits.lower + LIMIT_MARGIN) & (high < limits.upper - LIMIT_MARGIN)
    fits &= np.abs(off).max(axis=2) >= LITTLE_TRAVEL
    fits &= (alive.sum(axis=2) >= 2 * MIN_USED) & (clear >= CLEARANCE_M)
    travel = np.where(
        start - low > high - start,
        low - start,
        high - start,
    )
    return _Candidates(problem, dq, alive, travel, clear, fits)


def _guesses(
    robot: Robot,
    masses: np.ndarray,
    facts: PayloadFacts,
    load: KnownLoad | None,
    prepared: Sequence[PreparedRun],
) -> tuple[Problem, np.ndarray]:
    """The runs as a problem, and its unknowns with each mass in the hand, shape (S, N); see ``_candidates``."""
    if load is None:
        unknowns = load_unknowns(
            robot,
            prepared,
            facts,
            Role.ESTIMATED,
            float(masses[0]),
        )
    else:
        unknowns = robot_unknowns(robot, prepared, Role.ESTIMATED)
    problem = Problem(robot, prepared, facts, unknowns)
    values = np.tile(problem.base, (len(masses), 1))
    if load is None:
        values[:, problem.index["payload_mass"]] = masses
    joint = prepared[0].run.joint
    values[:, problem.index["coulomb", joint]] = expected_coulomb(problem, joint)
    return problem, values


def _runs_from(
    robot: Robot,
    masses: np.ndarray,
    facts: PayloadFacts,
    load: KnownLoad | None,
    joint: str,
    pose: Mapping[str, float],
) -> list[PreparedRun]:
    """A run for each current that moves the joint with any of the masses and that its motor may carry; see ``_candidates``."""
    still = prepare_run(
        robot,
        still_run(joint, pose, 0.01, DURATION_S),
        load,
        facts,
    )
    limit = robot.motors[joint].current_limit_A
    currents = dict.fromkeys(
        current for _, current, _ in currents_beyond(still, facts, masses.tolist())
    )
    return [
        replace(still, run=still_run(joint, pose, current, DURATION_S))
        for current in currents
        if 0.0 < abs(current) <= limit
    ]


def _lowest_m(
    robot: Robot,
    pose: Mapping[str, float],
    joint: str,
    positions: Sequence[float],
) -> float:
    """The lowest point of arm and hand above the base's plane with a joint at any of some positions."""
    return min(clearance(robot, {**pose, joint: position}) for position in positions)


def _as_plan(
    candidates: _Candidates,
    r: int,
    stds: Sequence[float],
    words: str,
) -> ExcitationPlan:
    prepared = candidates.problem.runs[r]
    travel = candidates.travel[:, r]
    run = prepared.run
    ends = (float(travel.min()), float(travel.max()))
    far = np.abs(travel)
    pose = {**run.held, run.joint: float(run.position[0])}
    start = {name: pose[name] for name in candidates.problem.robot.model.independent_joints}
    current = float(run.input_current_A[0])
    clearance_m = float(candidates.clearance_m[r])
    kind = _kind(prepared, current, float(travel[0]))
    moves = (
        f"moves {far.min():.2f} to {far.max():.2f} rad"
        if len(far) > 1
        else f"moves {far.min():.2f} rad"
    )
    reason = f"{moves}; {words}"
    return ExcitationPlan(
        run.joint,
        start,
        current,
        run.duration_s,
        kind,
        ends,
        clearance_m,
        tuple(stds),
        reason,
    )


def _kind(prepared: PreparedRun, current: float, travel: float) -> str:
    """Who pulls: motor against gravity, gravity against the motor, or both together."""
    if np.sign(current) != np.sign(travel):
        return "lower"
    arm = prepared.coefficients.arm
    q = prepared.rest.value
    turning = arm[1] * np.cos(q) + arm[2] * np.sin(q)
    gravity = -(turning + arm[3])
    return "driven" if np.sign(gravity) == np.sign(travel) else "lift"
