"""What changes along a recording: friction, and torque per effort, while motors warm up.

Friction goes with the temperature of grease by 1 % per kelvin, a motor's torque with that of its magnets by 0.1 %
(`calibration_files/drift.py`): both change one way along a recording that begins with a cold arm. A fit that knows one friction
and one torque constant for all of it takes the difference for a payload that changes, or that is not held. So what it leaves
over is asked for both, and what is clear is taken off. A payload that is picked up, or set in a controller that takes it off its
torques, changes at once instead: that is asked beside it, and refused with its time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from proprio_ros.identification.regression.motion_equations import (
    BANDWIDTH_HZ,
    SLOW_RAD_S,
    Problem,
)
from proprio_ros.identification.regression.solve import Solution, scores
from proprio_ros.identification.regression.weak_form import evenly
from proprio_ros.recordings.motions import Motion
from proprio_ros.records import BoolArray, FloatArray
from proprio_ros.robot import Robot

SIGMAS = 4.0
BESIDE_SIGMAS = 2.0
"""A change is clear that is so many times as large as stretches of the recording scatter about it; where one joint's friction
clearly changed, that of another one did by the second. UR10e recordings that were made warm show 2.2 at most."""
LEAST_TORQUE = 0.01
"""And of torque per effort, that is larger than what differs between recordings anyway, relative."""
LARGEST_TORQUE = 0.12
"""No motor that goes on moving loses more of its torque: what looks so is something else."""
ROUNDS = 3
"""A fit takes up a part of what changes; after so many rounds of both little of that is left."""
STEP_SIGMAS = 3.0
STEP_EXPLAINS = 0.4
"""A payload that changes at once is clear where it does so by so many times its scatter, and explains this share of the rest."""
STEP_EVERY_S = 0.5
FIRST_MOMENTS = 4
"""Of a payload's parameters, mass and first moment: they are what gravity shows of it."""
CHANGES = "torque that changes along the recording"
"""What a mass errs by, beside what `motion_fit` names."""


@dataclass(frozen=True)
class Step:
    """A payload that changes at once."""

    time_s: float  # since the first window began
    change_kg: float
    gain: float  # as of a `Trend`


@dataclass(frozen=True)
class Trend:
    """By how much the end of a recording differs from its beginning, had it changed evenly."""

    joints: tuple[str, ...]
    friction_N_m: FloatArray  # of each joint, shape (n,)
    friction_std: FloatArray
    torque: float  # per effort, relative
    torque_std: float
    gain: float  # share of what is left over, squared and weighted, that this explains
    step: Step | None  # what explains it instead

    @property
    def friction_is_clear(self) -> BoolArray:
        """Of which joints it changed, shape (n,)."""
        sigmas = np.abs(self.friction_N_m) / np.maximum(self.friction_std, 1e-12)
        if not (sigmas > SIGMAS).any():
            return np.zeros(len(sigmas), dtype=bool)
        clear: BoolArray = sigmas > BESIDE_SIGMAS
        return clear

    @property
    def torque_is_clear(self) -> bool:
        """Whether the torque per effort changed."""
        size = abs(self.torque)
        return max(SIGMAS * self.torque_std, LEAST_TORQUE) < size < LARGEST_TORQUE

    @property
    def is_clear(self) -> bool:
        """Whether anything changed."""
        if self.payload_changes:
            return False
        return self.torque_is_clear or bool(self.friction_is_clear.any())

    @property
    def payload_changes(self) -> bool:
        """Whether the payload changed at once, rather than this."""
        step = self.step
        return step is not None and step.gain > max(self.gain, STEP_EXPLAINS)

    def plus(self, more: Trend) -> Trend:
        """What was found before, and what was found once that had been taken off."""
        return replace(
            self,
            friction_N_m=self.friction_N_m + more.friction_N_m,
            torque=self.torque + more.torque,
        )

    def words(self) -> str:
        """What changed, in a sentence without the recording's name."""
        changed = []
        clear = np.flatnonzero(self.friction_is_clear)
        if len(clear):
            most = int(clear[np.argmax(np.abs(self.friction_N_m[clear]))])
            others = "" if len(clear) == 1 else f" and of {len(clear) - 1} more joints"
            much = self.friction_N_m[most]
            changed.append(
                f"friction of {self.joints[most]}{others} {_fell(much)} by {abs(much):.2g} N m"
            )
        if self.torque_is_clear:
            changed.append(
                f"effort per torque {_fell(self.torque)} by {100.0 * abs(self.torque):.1f} %"
            )
        return f"{' and '.join(changed)} along the recording, as while motors warm up: let the arm warm up first"


def _fell(change: float) -> str:
    return "fell" if change < 0.0 else "rose"


def trend_of(
    joints: Sequence[str],
    problem: Problem,
    solution: Solution,
    number: int,
) -> Trend:
    """What changes along one motion, by what a fit leaves over of it.

    Args:
        joints: Names, n.
        problem: Of the fit.
        solution: Of the same.
        number: Of the motion.
    """
    mine = problem.motion == number
    part = problem.only(mine)
    along = _along(part.start_s)
    residual = solution.residual[mine]
    explained = part.torque - residual
    weight = solution.weight[mine]
    own = np.eye(part.count)[part.joint]
    friction = own * (part.direction * along)[:, None]
    columns = np.column_stack([friction, explained * along]) * weight[:, None]
    found = _explained(columns, residual * weight, part)
    payload = part.matrix[:, :FIRST_MOMENTS] * weight[:, None]
    step = _step(payload, residual * weight, part)
    return Trend(
        joints=tuple(joints),
        friction_N_m=found.values[:-1],
        friction_std=found.std[:-1],
        torque=float(found.values[-1]),
        torque_std=float(found.std[-1]),
        gain=found.gain,
        step=step,
    )


@dataclass(frozen=True)
class _Explained:
    """What columns explain of something, by least squares."""

    values: FloatArray  # of K columns
    std: FloatArray  # the larger of the formal ones and what stretches show, shape (K,)
    gain: float  # share of the squares that they explain


def _explained(columns: FloatArray, left_over: FloatArray, problem: Problem) -> _Explained:
    inverse = np.linalg.pinv(columns.T @ columns)
    values = inverse @ (columns.T @ left_over)
    rest = left_over - columns @ values
    pulls = scores(columns, rest, problem)
    sandwich = inverse @ pulls.T @ pulls @ inverse
    # of a joint without efforts both are nothing but for rounding
    variance = np.maximum(
        np.maximum(np.diag(inverse), np.diag(sandwich)),
        0.0,
    )
    gain = 1.0 - float(rest @ rest) / max(float(left_over @ left_over), 1e-300)
    return _Explained(values, np.sqrt(variance), gain)


def _step(payload: FloatArray, left_over: FloatArray, problem: Problem) -> Step | None:
    """The change of a payload that explains most of what is left over, where it is clear.

    Args:
        payload: Weighted rows per unit of its first parameters, shape (E, `FIRST_MOMENTS`).
        left_over: Weighted residual, shape (E,).
        problem: That has these rows.
    """
    start_s = problem.start_s
    first_s = float(start_s.min())
    times_s = np.arange(first_s + STEP_EVERY_S, start_s.max(), STEP_EVERY_S)
    # between two of them may be nothing that was kept
    _, apart = np.unique(np.searchsorted(np.sort(start_s), times_s), return_index=True)
    best: Step | None = None
    for time_s in times_s[apart]:
        after = (start_s >= time_s).astype(np.float64)
        # beside the payload of all of it, which the fit has found with both
        columns = np.hstack([payload, payload * after[:, None]])
        found = _explained(columns, left_over, problem)
        change_kg = float(found.values[FIRST_MOMENTS])
        is_clear = abs(change_kg) > STEP_SIGMAS * found.std[FIRST_MOMENTS]
        if is_clear and (best is None or found.gain > best.gain):
            best = Step(
                float(time_s) - first_s,
                change_kg,
                found.gain,
            )
    return best


def without_trend(
    robot: Robot,
    motion: Motion,
    trend: Trend,
    clear: Trend,
) -> Motion:
    """The motion as if all of it had been recorded in its middle.

    Args:
        robot: Whose torque constants the currents have.
        motion: To be mended.
        trend: By how much it changed.
        clear: The trend that says which changes are taken off.
    """
    times_s, position, _ = evenly(motion, trend.joints, BANDWIDTH_HZ)
    velocity = np.gradient(
        position,
        times_s[1] - times_s[0],
        axis=0,
    )
    along = _along(motion.times_s)
    current = motion.current_A.copy()
    if clear.torque_is_clear:
        current /= 1.0 + trend.torque * along[:, None]
    for number in np.flatnonzero(clear.friction_is_clear):
        name = trend.joints[number]
        speed = np.interp(
            motion.times_s,
            times_s,
            velocity[:, number],
        )
        direction = np.tanh(speed / SLOW_RAD_S)
        constant = robot.drive_trains[name].torque_constant.value
        taken = trend.friction_N_m[number] / constant * along * direction
        current[:, motion.joints.index(name)] -= taken
    return replace(motion, current_A=current)


def _along(times_s: FloatArray) -> FloatArray:
    """From -1/2 at the first to 1/2 at the last."""
    span = max(float(np.ptp(times_s)), 1e-9)
    result: FloatArray = (times_s - times_s.min()) / span - 0.5
    return result
