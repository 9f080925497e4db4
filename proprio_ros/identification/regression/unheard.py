"""Windows in which servos did not follow the goals that were recorded: a busy computer hands a goal on late.

The torque of a stiff servo is made of small distances between goal and joint. A goal that is in effect 50 ms after its stamp,
while goals move on at 0.5 rad/s, makes a torque of tens of N m that was never there, for as long as the computer was held up.
When goals came into effect is judged by what the joints did: windows whose torque the fit of all others contradicts are left
out. Where that is more than a few, it is no late goal, and all count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from proprio_ros.calibration_files.motions import MotionCalibration
from proprio_ros.identification.regression.motion_equations import Problem
from proprio_ros.identification.regression.solve import Priors, solve
from proprio_ros.quantity import MAD_TO_STD
from proprio_ros.recordings.motions import Motion
from proprio_ros.records import FloatArray

SIGMAS = 5.0
"""Of what is left over of a joint's windows, by its median: a Gaussian has one in two million beyond."""
MOST = 0.25
"""Of the windows of a joint in a recording: stalls of 0.1 s every 3 s touch a fifth of windows of 0.5 s."""
ROUNDS = 4


def heard_in_time(
    problem: Problem,
    priors: Priors,
    motions: Sequence[Motion],
    known: MotionCalibration | None = None,
) -> Problem:
    """The equations without those whose goals were clearly late; all of them where torques are not made of goals.

    Args:
        problem: Of the motions.
        priors: Of its unknowns.
        motions: In its order.
        known: By which residuals are known.

    Returns:
        Those that are left, with what share of all was left out.
    """
    if not motions[0].made_by_law:
        return problem
    left = problem
    for _ in range(ROUNDS):
        late = _late(left, solve(left, priors, known).residual)
        if not late.any():
            break
        left = left.only(~late)
    if not _are_few(problem, left):
        return problem
    return replace(left, late_share=1.0 - len(left.torque) / len(problem.torque))


def _late(problem: Problem, residual: FloatArray) -> NDArray[np.bool_]:
    """Which equations are far from what the others say, shape (E,)."""
    late = np.zeros(len(residual), dtype=bool)
    for joint in np.unique(problem.joint):
        mine = problem.joint == joint
        usual = MAD_TO_STD * float(np.median(np.abs(residual[mine])))
        late[mine] = np.abs(residual[mine]) > SIGMAS * usual
    return late


def _are_few(problem: Problem, left: Problem) -> bool:
    """Whether every joint keeps most of its equations in every motion."""
    for number in range(problem.motions):
        for joint in np.unique(problem.joint[problem.motion == number]):
            before = np.sum((problem.motion == number) & (problem.joint == joint))
            after = np.sum((left.motion == number) & (left.joint == joint))
            if after < (1.0 - MOST) * before:
                return False
    return True
