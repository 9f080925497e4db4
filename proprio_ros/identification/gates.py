"""When a run cannot be trusted: too little of it, a misfit, or a contradiction to the other runs; and the sentence that says so."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from proprio_ros.identification.chance import chi2_limit
from proprio_ros.identification.position_steps import (
    held_jump,
    jumped,
)
from proprio_ros.identification.posterior import Posterior
from proprio_ros.identification.prepared_runs import (
    PreparedRun,
    joints_of,
)
from proprio_ros.identification.problem import Problem
from proprio_ros.identification.reasons import Reason, of_run
from proprio_ros.quantity import shown
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
class Contradiction:
    """A run that the others predict badly; where both say nearly the same, half of the difference widens the interval."""

    sentence: str  # what it says, and what they say; empty where that is the same
    half: float | None = None  # of the difference; None where the run contradicts the others


def contradiction(
    name: str,
    unit: str,
    one: float,
    others: float,
    alike: float,
    same: float,
    question: str,
) -> Contradiction:
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
    said = f"it says {shown(unit, one, spec='.1f')}, they say {shown(unit, others, spec='.1f')}"
    apart = abs(one - others)
    if apart < same:
        return Contradiction("", 0.5 * apart)
    if apart < alike:
        differs = f"{name} differs from the other runs: {said}; the interval carries half of that"
        return Contradiction(Reason("runs_differ", differs), 0.5 * apart)
    return Contradiction(
        Reason(
            "runs_contradict",
            f"{name} contradicts the other runs: {said}; {question}",
        )
    )


def unusable(run: PreparedRun) -> str:
    """Why a run is of no use, or an empty string."""
    if run.used < MIN_USED:
        why = run.cut_reason or "the probe was too short"
        return Reason(
            "few_samples",
            f"only {run.used} usable samples, because {why}",
        )
    jump = "" if run.run.is_free_response else held_jump(run)
    if jump:
        return jumped(jump)
    if abs(run.travel) < STUCK_TRAVEL:
        so = "so friction and not the weight decides where it is"
        cure = f"probe with more current or from a pose that leaves at least {LITTLE_TRAVEL} rad of travel"
        return Reason(
            "stuck",
            f"{run.run.joint} moved only {abs(run.travel):.3f} rad, {_moved_instead(run) or so}: {cure}",
        )
    return ""


def _moved_instead(run: PreparedRun) -> str:
    """Which joint moved while the one that is said to be driven did not; empty where none did."""
    farthest = max(run.run.held_span, key=lambda joint: run.run.held_span[joint], default="")
    if not farthest or run.run.held_span[farthest] < LITTLE_TRAVEL / 2.0:
        return ""
    return (
        f"while {farthest} moved {run.run.held_span[farthest]:.2f} rad: are the columns of the two joints exchanged, or was the "
        "command for another joint? If not"
    )


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
        found.reasons += [Reason(code, said, run.run.name) for code, said in _unusual(robot, run)]


def _unusual(robot: Robot, run: PreparedRun) -> Iterator[tuple[str, str]]:
    """Codes and sentences."""
    joint = run.run.joint
    model = robot.model.joint(run.run.joint)
    if run.cut_reason:
        later = len(run.run.times_s) - run.used
        yield (
            "left_out_samples",
            f"{run.cut_reason}; {later} later samples were left out",
        )
    # fingers on a stiff block do not get that far
    if STUCK_TRAVEL <= abs(run.travel) < LITTLE_TRAVEL and model.kind != "prismatic":
        cure = f"a probe with at least {LITTLE_TRAVEL} rad gives a much narrower interval"
        yield (
            "short_travel",
            f"{joint} moved only {abs(run.travel):.2f} rad in the samples used: {cure}",
        )
    margin = 2.0 * run.drive.encoder_resolution
    for limit, side in ((model.lower, -1.0), (model.upper, 1.0)):
        if side * (run.rest.value - limit / run.drive.transmission) > -margin:
            stop = "where the stop may carry part of the weight: start away from it"
            yield (
                "starts_at_limit",
                f"{joint} starts at its limit ({run.rest.value:.3f} rad), {stop}",
            )
    current = float(np.abs(run.run.input_current_A).max())
    allowed = robot.motors[joint].current_limit_A
    if current > allowed:
        given = (
            f"{shown('A', current)} were commanded, but {joint} is limited to {shown('A', allowed)}"
        )
        cure = "probe below the limit, or correct current_limit_A in the robot file"
        yield (
            "current_above_limit",
            f"{given}, so less flowed than the input says: {cure}",
        )
    for held, span in run.run.held_span.items():
        if held in run.coefficients.pose and span > LOCKED_SPAN:
            yield (
                "held_joint_moved",
                f"{held} should be held but moved by {span:.3f} rad",
            )


def never_reversed(runs: Sequence[PreparedRun]) -> list[str]:
    """A sentence for each joint that all runs drive in the same direction."""
    sentences: list[str] = []
    for joint in joints_of(runs):
        mine = [run for run in runs if run.run.joint == joint]
        signs = {float(np.sign(run.travel)) for run in mine}
        if len(signs) == 1:
            towards, back = ("positive", "negative") if signs == {1.0} else ("negative", "positive")
            moved = f"{joint} only ever moved in the {towards} direction, so its friction was never seen reversed"
            cure = f"add a run in which it moves in the {back} direction"
            said = f"{moved} and cannot be separated from torque and weight: {cure}"
            sentences.append(Reason("never_reversed", said))
    return sentences


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
            stood = f"{run.run.name}: {joint} stood still with {shown('A', current)}"
            left = f"{shown('kg', held)} would leave {shown('N m', abs(net.torque))} to move it"
            why = "more than its friction can hold: it sticks, or leans on something"
            return Reason("stood_still", f"{stood}, where {left}, {why}")
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


def said_left_out(names: Sequence[str], count: int, question: str) -> str:
    """Which of so many runs were left out, since they contradict the others.

    Args:
        names: Of those that were left out.
        count: Of all runs.
        question: Put to the user.
    """
    contradict, were = ("contradicts", "was") if len(names) == 1 else ("contradict", "were")
    left_out = f"{', '.join(names)} {contradict} the other runs and {were} left out ({len(names)} of {count})"
    return f"{left_out}: {question}"
