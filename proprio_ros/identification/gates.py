"""When a run cannot be trusted: too little of it, a misfit, or a contradiction to the other runs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from proprio_ros.identification import sentences
from proprio_ros.identification.chance import chi2_limit
from proprio_ros.identification.position_steps import held_jump
from proprio_ros.identification.posterior import Posterior
from proprio_ros.identification.prepared_runs import (
    PreparedRun,
    joints_of,
)
from proprio_ros.identification.problem import Problem
from proprio_ros.identification.reasons import Reason, of_run
from proprio_ros.robot import Robot

MIN_USED = 5
# below this travel (rad or m/10) breakaway and presliding, not weight, decide where the joint is
STUCK_TRAVEL = 0.1
UNMOVED_RAD = 0.02  # a gripper that moves less shows nothing but its friction
LITTLE_TRAVEL = 0.3
"""Travel that a trustworthy weighing has: where the joint barely creeps, rounding of the encoder costs 2 to 4 g."""
MOVING_START = 0.1  # rad/s: a run that starts faster has not started from rest
LOCKED_SPAN = 0.03
"""rad: what a locked joint that yields does to the driven one is reckoned with; beyond this the reckoning itself is a guess."""
MISFIT_LIMIT = 9.0
"""Reduced chi-square (rms three times the encoder's) up to which an explained-enough fit is accepted with a wider interval."""
CONTRADICTION = 2.5
"""Reduced chi-square with which the other runs may predict a run: beyond it, and beyond chance, the run contradicts them."""
OWN_VALUE_STDS = 3.5
"""Standard deviations that a value of its own may lie from that of all runs together; chance exceeds it once in 2000."""
# part of the runs that may contradict the others before all of them are refused
LEFT_OUT_AT_MOST = 0.25

STEADY = 0.1  # part of itself by which the current of a push may change
# so many standard deviations more than is known may hold a joint that stands still
STILL_SIGMAS = 3.0


@dataclass
class Findings:
    """What was found on the way, in the order in which a reader wants it."""

    reasons: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class RunComparison:
    """What a run that the others predict badly says, against what they say."""

    sentence: str  # both; empty where they say the same
    contradicts: bool = True  # else they differ by so little that the answer covers both
    # half of the difference, by which the interval is then widened, in the unit of the value; zero where they contradict each other
    extra_std: float = 0.0


def compare_run(
    name: str,
    unit: str,
    one: float,
    others: float,
    alike: float,
    same: float,
    question: str,
) -> RunComparison:
    """What to make of a run that says one value where the others say another.

    Args:
        name: Of the run.
        unit: Of the values.
        one: What the run says.
        others: What the others say.
        alike: Values that differ by less do not contradict each other; half of the difference then counts as uncertainty.
        same: What is less is not worth a sentence.
        question: Put to the user where they contradict each other.
    """
    difference = abs(one - others)
    if difference >= alike:
        sentence = sentences.runs_contradict(name, unit, one, others, question)
        return RunComparison(sentence)
    half = 0.5 * difference
    if difference < same:
        return RunComparison("", contradicts=False, extra_std=half)
    differ = sentences.runs_differ(name, unit, one, others)
    return RunComparison(differ, contradicts=False, extra_std=half)


def unusable(run: PreparedRun) -> str:
    """Why a run is of no use, or an empty string."""
    if run.used < MIN_USED:
        return sentences.few_samples(run.used, run.cut_reason or "the probe was too short")
    jump = held_jump(run)
    if jump:
        return sentences.position_jumps(jump)
    if abs(run.travel) < STUCK_TRAVEL:
        return sentences.stuck(
            run.run.joint,
            abs(run.travel),
            LITTLE_TRAVEL,
            _moved_instead(run),
        )
    return ""


def _moved_instead(run: PreparedRun) -> tuple[str, float] | None:
    """Which joint moved while the driven one did not, and how far [rad]; None: none did."""
    spans = run.run.held_span
    farthest = max(
        spans,
        key=lambda joint: spans[joint],
        default="",
    )
    if not farthest or spans[farthest] < LITTLE_TRAVEL / 2.0:
        return None
    return farthest, spans[farthest]


def admitted(robot: Robot, run: PreparedRun, found: Findings) -> bool:
    """Whether a run can be used; why not, and what is unusual about it, is added to ``found``.

    Args:
        robot: Whose joint was driven.
        run: Prepared.
        found: Takes what is wrong or unusual.
    """
    problem = unusable(run)
    if problem:
        found.reasons.append(of_run(run.run.name, problem))
    screen_run(robot, run, found)
    return not problem


def screen_run(robot: Robot, run: PreparedRun, found: Findings) -> None:
    """Warn of what is unusual about a run by itself.

    Args:
        robot: Whose joint was driven.
        run: Prepared.
        found: Takes the warnings.
    """
    found.notes.extend(f"{run.run.name}: {note}" for note in run.run.notes)
    if run.used >= MIN_USED:
        found.reasons += _unusual(robot, run)


def _unusual(robot: Robot, run: PreparedRun) -> Iterator[Reason]:
    name = run.run.name
    joint = run.run.joint
    model = robot.model.joint(run.run.joint)
    if run.cut_reason:
        later = len(run.run.times_s) - run.used
        yield sentences.left_out_samples(name, run.cut_reason, later)
    # fingers on a stiff block do not get that far
    if STUCK_TRAVEL <= abs(run.travel) < LITTLE_TRAVEL and model.kind != "prismatic":
        yield sentences.short_travel(name, joint, abs(run.travel), LITTLE_TRAVEL)
    margin = 2.0 * run.drive.encoder_resolution
    for limit, side in ((model.lower, -1.0), (model.upper, 1.0)):
        if side * (run.rest.value - limit / run.drive.transmission) > -margin:
            yield sentences.starts_at_limit(name, joint, run.rest.value)
    current = float(np.abs(run.run.input_current_A).max())
    allowed = robot.motors[joint].current_limit_A
    if current > allowed:
        yield sentences.current_above_limit(name, joint, current, allowed)
    for held, span in run.run.held_span.items():
        if held in run.coefficients.pose and span > LOCKED_SPAN:
            yield sentences.held_joint_moved(name, held, span)


def never_reversed(runs: Sequence[PreparedRun]) -> list[str]:
    """A sentence for each joint that all runs drive in the same direction."""
    reasons: list[str] = []
    for joint in joints_of(runs):
        mine = [run for run in runs if run.run.joint == joint]
        signs = {float(np.sign(run.travel)) for run in mine}
        if len(signs) == 1 and not mine[0].kind.both_ways:
            reasons.append(sentences.never_reversed(joint, upwards=signs == {1.0}))
    return reasons


def stood_still(
    robot: Robot,
    problem: Problem,
    values: np.ndarray,
    still: Sequence[PreparedRun],
    mass: float,
) -> str:
    """A sentence about the first run whose joint stood still and should not have.

    No simulation follows a joint that friction holds, so such a run is not part of the fit. But what holds it is at most its dry
    friction, and a current that leaves more than that over would have moved it.

    Args:
        robot: Whose joints.
        problem: That was fitted.
        values: Of all its unknowns, shape (N,).
        still: Runs whose joint stood still.
        mass: In the hand [kg], where a run states no load.

    Returns: empty where there is none.
    """
    for run in still:
        joint = run.run.joint
        driving = run.run.input_current_A[run.run.input_times_s < run.run.times_s[-1]]
        steady = len(driving) > 0
        steady = steady and np.ptp(driving) <= STEADY * np.abs(driving).max()
        if not steady or robot.model.joint(joint).kind == "prismatic":
            continue
        current = float(driving.mean())
        held = mass if run.load is None else run.load.mass
        net, inertia = _left_to_move(robot, problem, values, run, current, held)
        lasted_s = float(run.run.times_s[-1] - run.run.times_s[0])
        if 0.5 * net.beyond_friction / inertia * lasted_s**2 >= LITTLE_TRAVEL:
            return sentences.stood_still(
                run.run.name,
                joint,
                current,
                held,
                abs(net.torque),
            )
    return ""


class _Net(NamedTuple):
    """What is left to move a joint at rest."""

    torque: float  # of the motor less the weight [N m]
    beyond_friction: float  # of its size, less all that may hold the joint [N m]


def _left_to_move(
    robot: Robot,
    problem: Problem,
    values: np.ndarray,
    run: PreparedRun,
    current: float,
    held: float,
) -> tuple[_Net, float]:
    """Torque on a joint at rest, driven by a current [A] with so many kg in the hand, and the inertia that it moves [kg m^2]."""
    drive = run.drive

    def fitted(term: str) -> float:
        row = problem.index.get((term, run.run.joint))
        return float(getattr(drive, term).value if row is None else values[row])

    motor = fitted("torque_constant") * current
    arm_weight = robot.arm_scale.value * run.weight_at_rest(run.coefficients.arm)
    per_kg = run.coefficients.per_kg(problem.facts)
    torque = motor - arm_weight - held * run.weight_at_rest(per_kg)
    dry = max(fitted("coulomb"), drive.coulomb.value) + max(fitted("load_friction"), 0.0) * abs(
        motor
    )
    at_rest = 1.0 + max(fitted("stribeck"), drive.stribeck.value)
    open_stds = (
        *run.torque_stds,
        drive.stribeck.std * dry,
        robot.link_mass_std * arm_weight,
    )
    over = abs(torque) - at_rest * dry - STILL_SIGMAS * float(np.hypot.reduce(open_stds))
    inertia = (
        run.coefficients.arm[0] + held * per_kg[0] + drive.armature.value + 2.0 * drive.armature.std
    )
    return _Net(torque, over), float(inertia)


def contradicting(posterior: Posterior) -> int | None:
    """The run that the others predict worst, if that is beyond chance and beyond ``CONTRADICTION``."""
    count = len(posterior.problem.runs)
    if count < 2:
        return None
    ratios = [
        surprising(len(residual), chi2) for residual, chi2 in map(posterior.held_out, range(count))
    ]
    worst = int(np.argmax(ratios))
    return worst if ratios[worst] > 1.0 else None


def of_another_value(posterior: Posterior, name: str) -> int | None:
    """The run that would have an unknown called ``name`` furthest from what all say, if that is beyond chance; else None.

    A score test of each run for a value of its own: how badly others predict its samples may say nothing where torque that differs
    from run to run takes the difference up, and yet it is that of two objects. Runs whose load is known are not asked.
    """
    problem = posterior.problem
    column = problem.column_of(name)
    unknown = [row for row, run in enumerate(problem.runs) if run.load is None]
    if len(unknown) < 2:
        return None
    pulls = []
    for row in unknown:
        slope = np.where(
            posterior.run == row,
            posterior.sensitivity[:, column],
            0.0,
        )
        across = posterior.sensitivity.T @ slope
        information = float(slope @ slope - across @ posterior.covariance @ across)
        towards = float(slope @ posterior.residual - across @ posterior.step)
        pulls.append(abs(towards) / float(np.sqrt(max(information, 1e-300))))
    worst = int(np.argmax(pulls))
    return unknown[worst] if pulls[worst] > OWN_VALUE_STDS else None


def surprising(samples: int, chi2: float) -> float:
    """Chi-square with which others predict so many samples of a run, over that beyond which it contradicts them."""
    return chi2 / max(CONTRADICTION * samples, chi2_limit(samples)) if samples else 0.0
