"""A calibration from motions of one joint with known loads: what it is worth, and whether it can be believed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from proprio_ros.calibration_files.one_joint import JointCalibration
from proprio_ros.identification.calibration_estimate import (
    CalibrationEstimate,
    EmptyHandEstimate,
    Weighable,
)
from proprio_ros.identification.judge import Refusal, judge, not_identifiable, rejected
from proprio_ros.identification.regression.one_joint_fit import carried_by
from proprio_ros.identification.regression.one_joint_known import learn_joint, tables_of, terms_of
from proprio_ros.identification.regression.refusals import UNEXPLAINED_SHARE
from proprio_ros.quantity import Z95, Quantity, shown
from proprio_ros.recordings.motions import Motion
from proprio_ros.robot import Robot
from proprio_ros.sim.payload import PayloadFacts

WIDEST_SPREAD = 0.25  # Recordings whose masses differ by more, relative, say nothing about another.
DELAY_SIGMAS = 2.0
DELAY_STEPS = 17
LATEST_S = 0.2


def calibrate_joint(
    robot: Robot, motions: Sequence[Motion], loads_kg: Sequence[float], facts: PayloadFacts
) -> CalibrationEstimate:
    """Learn a joint from motions with known loads.

    Args:
        robot: Of one joint that turns.
        motions: Three or more.
        loads_kg: What was held in each; 0 is an empty hand.
        facts: Where the loads sat.

    Raises `RecordingError`: There are too few, or one is of no use.
    """
    learnt = learn_joint(robot, motions, loads_kg, facts)
    refusal = judge(_refusals(robot, motions, learnt))
    return CalibrationEstimate(
        robot=robot.name,
        verdict=refusal.verdict,
        reasons=refusal.reasons,
        runs=len(motions),
        calibration=None,
        joint=learnt,
        notes=tuple(note for motion in motions for note in motion.notes),
        weighable=None if refusal.withheld else _weighable(learnt),
        weighed_empty=tuple(
            EmptyHandEstimate(
                run["name"],
                run["read_kg"],
                run["std_kg"],
                Z95,
            )
            for run in learnt.runs
        ),
    )


def _weighable(learnt: JointCalibration) -> Weighable:
    """What an object as heavy as the heaviest known load would be weighed to."""
    heaviest = float(learnt.loads_kg.max())
    own = [run["std_kg"] / run["load_kg"] for run in learnt.runs if run["load_kg"] > 0.0]
    return Weighable(
        heaviest,
        float(np.hypot(learnt.spread, np.median(own))) * heaviest,
        (learnt.joint,),
        f"recordings of known loads, each weighed by the others, differ by {100.0 * learnt.spread:.2g} % beyond what each knows "
        "of its own error",
    )


def _refusals(
    robot: Robot, motions: Sequence[Motion], learnt: JointCalibration
) -> Iterator[Refusal]:
    scale = float(learnt.values[0])
    currents = np.concatenate(
        [motion.current_A[:, motion.joints.index(learnt.joint)] for motion in motions]
    )
    driven = learnt.torque_constant * float(np.sqrt(np.nanmean(np.square(currents))))
    if scale <= 0.0 or learnt.residual * scale > UNEXPLAINED_SHARE * driven:
        yield rejected(
            "misfit",
            "the model does not explain the recordings",
            f"{motions[0].name}: known loads, the rotor and friction do not explain the torque of {learnt.joint}: check the loads, "
            "the effort's unit and sign, and what drives the motor (driven_by)",
        )
    if learnt.spread > WIDEST_SPREAD:
        worst = max(
            (run for run in learnt.runs if run["load_kg"] > 0.0),
            key=lambda run: abs(run["read_kg"] / run["load_kg"] - 1.0),
        )
        yield not_identifiable(
            "says_too_little",
            "the recordings contradict each other",
            f"known loads, each weighed by the others, differ by {100.0 * learnt.spread:.0f} %; the most, {worst['name']}: "
            f"{shown('kg', worst['read_kg'], spec='.0f')} of {shown('kg', worst['load_kg'], spec='.0f')}: check the loads, and "
            "record longer and faster motions",
        )


def torque_left_over(
    robot: Robot, motions: Sequence[Motion], loads_kg: Sequence[float], facts: PayloadFacts
) -> float:
    """What known loads, rotor and friction leave over of the torque of the only joint, rms in true torque [N m].

    Args:
        robot: Of one joint that turns.
        motions: With known loads.
        loads_kg: What was held in each.
        facts: Where the loads sat.
    """
    (joint,) = motions[0].joints
    carried = carried_by(robot, joint, motions[0], facts)
    return terms_of([tables_of(robot, motion, joint) for motion in motions], loads_kg, carried)[1]


def best_delay(
    left_over: Callable[[float], float],
    stated: Quantity,
) -> Quantity:
    """The delay that leaves the least torque over, to a step of the search.

    ``left_over``: by the delay [s]; ``stated``: where to look: two standard deviations about the value [s].
    """
    low = max(stated.value - DELAY_SIGMAS * stated.std, 0.0)
    high = min(max(stated.value + DELAY_SIGMAS * stated.std, 0.0), LATEST_S)
    steps = np.linspace(low, high, DELAY_STEPS)
    left = [left_over(float(delay)) for delay in steps]
    best = float(steps[int(np.argmin(left))])
    return Quantity(round(best, 6), 0.0)
