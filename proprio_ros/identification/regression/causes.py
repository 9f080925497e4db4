"""What is wrong with a motion that was refused: the one mistake that lets the URDF explain its torques.

Each mistake is undone in turn (a sign, a factor, an axis turned round, gravity from elsewhere), and what the URDF's bodies, a
payload and dry friction leave unexplained is compared. A mistake is named where undoing it explains what nothing else does.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from proprio_ros.errors import ProprioError
from proprio_ros.identification.estimate import Verdict
from proprio_ros.identification.judge import Refusal
from proprio_ros.identification.reasons import Reason
from proprio_ros.identification.regression.motion_equations import Arm, Rows, equations
from proprio_ros.identification.regression.motion_prior import payload_stds
from proprio_ros.recordings.motions import Motion
from proprio_ros.records import FloatArray
from proprio_ros.robot import Robot
from proprio_ros.robot.regressor import PARAMETERS

EXPLAINED = 0.25
"""A mistake is named where undoing it leaves less than this of the torque, squared and relative to what the URDF says."""
BETTER, CLEARER = 3.0, 1.15
"""And so many times less than as it is, and this much less than what any other mistake leaves."""
UNEXPLAINED = 0.15
"""What an arm that differs from its URDF leaves is less."""
HEAVY_COSTS = 0.3
"""Share of the torque that a payload as heavy as the arm must explain."""
WEAK = 0.1
"""A joint counts as if gravity and inertia took at least this share of the largest torque on any."""
FACTORS = (0.001, 0.01, 0.1, 0.5, 2.0, 10.0, 100.0, 1000.0)
LEAST_TILT_RAD, GRAVITY_ROUNDS = 0.2, 4
GRAVITY_M_S2 = 9.81


@dataclass(frozen=True)
class _Tried:
    left: float  # share of the torque that is not explained
    words: str


@dataclass(frozen=True)
class _Model:
    """The torque that the URDF says, beside what was recorded; a row for each window and joint."""

    rows: Rows
    by_urdf: FloatArray
    weight: FloatArray
    per_kg: FloatArray  # of a payload's parameters, that of an arm as heavy as this one

    @classmethod
    def of(cls, robot: Robot, motion: Motion) -> _Model:
        rows, arm = (
            equations(robot, motion, motion.joints, by_zeros=False),
            Arm.of(robot, motion.joints, dict(motion.held)),
        )
        by_urdf = rows.design[:, : PARAMETERS * arm.count] @ np.concatenate(arm.bodies)
        size = np.array([_rms(by_urdf[rows.joint == joint]) for joint in range(arm.count)])
        return cls(rows, by_urdf, 1.0 / np.maximum(size, WEAK * size.max())[rows.joint], arm.kg * payload_stds(arm))

    def left(self, torque: FloatArray, beside: FloatArray | None = None) -> tuple[float, FloatArray]:
        """What is left of a torque, shape (E,), in parts of what the URDF says, and the factors of columns ``beside``, (E, 3).

        Those columns stand in the place of the URDF's torque.
        """
        own = np.eye(self.rows.joint.max() + 1)[self.rows.joint]
        # a payload also takes up what the URDF is off by
        columns = [own * self.rows.direction[:, None], own, self.rows.payload * self.per_kg]
        known = self.by_urdf if beside is None else np.zeros_like(torque)
        matrix = np.hstack([*columns, *([] if beside is None else [beside])]) * self.weight[:, None]
        right, total = (torque - known) * self.weight, float(np.sum(np.square(self.by_urdf * self.weight)))
        # a heavy payload needs a reason
        first = 2 * own.shape[1]
        heavy = np.sqrt(HEAVY_COSTS * total) * np.eye(matrix.shape[1])[first : first + PARAMETERS]
        values = np.linalg.lstsq(np.vstack([matrix, heavy]), np.append(right, np.zeros(PARAMETERS)), rcond=1e-8)[0]
        left = np.sum(np.square(right - matrix @ values)) + np.sum(np.square(heavy @ values))
        return float(left) / max(total, 1e-12), values[-3:]


def with_cause(refusal: Refusal, robot: Robot, motions: Sequence[Motion]) -> Refusal:
    """The refusal of a fit of some motions, with the mistake that explains it as its first reason, where one is found."""
    if refusal.verdict is not Verdict.REJECTED:
        return refusal
    for motion in motions:
        if cause := torque_cause(robot, motion):
            code = getattr(refusal.reasons[0], "code", "other")
            return replace(refusal, reasons=(Reason(code, f"{motion.name}: {cause}"), *refusal.reasons))
    return refusal


def torque_cause(robot: Robot, motion: Motion) -> str:
    """The one mistake that explains the torques of a motion, as a sentence without its name; empty where none is sure.

    Args:
        robot: As its file states it.
        motion: That was refused.
    """
    try:
        model = _Model.of(robot, motion)
        as_it_is = model.left(model.rows.torque)[0]
        tried = sorted(_tried(robot, motion, model), key=lambda each: each.left)
    except (ProprioError, np.linalg.LinAlgError):
        return ""
    best, *others = tried
    sure = best.left < EXPLAINED and as_it_is > max(BETTER * best.left, UNEXPLAINED)
    other = next((each.left for each in others if each.words != best.words), np.inf)
    return best.words if sure and CLEARER * best.left < other else ""


def _tried(robot: Robot, motion: Motion, model: _Model) -> Iterator[_Tried]:
    torque, joint = model.rows.torque, model.rows.joint
    names = motion.joints
    yield _Tried(
        model.left(-torque)[0],
        "the effort of all joints has the sign of the torque that gravity makes, not of what holds against it: its publisher "
        "counts it the other way round",
    )
    for factor in FACTORS:
        yield _Tried(
            model.left(torque / factor)[0],
            f"the effort of all joints is about {factor:g} times what the URDF needs: it is in another unit (--effort-unit)",
        )
    sizes = [_rms(model.by_urdf[joint == number]) for number in range(len(names))]
    for number, name in enumerate(names):
        if sizes[number] < WEAK * max(sizes):  # mostly friction: less of it is explained better whatever is wrong
            continue
        mine = joint == number
        turned = f"the effort or the angle of {name} has the sign of an axis that is turned round in the URDF"
        yield _Tried(model.left(np.where(mine, -torque, torque))[0], turned)
        flipped = motion.position.copy()
        flipped[:, number] *= -1.0
        other = _Model.of(robot, replace(motion, position=flipped))
        its = other.rows.joint == number
        for sign in (1.0, -1.0):
            yield _Tried(other.left(np.where(its, sign, 1.0) * other.rows.torque)[0], turned)
        for factor in FACTORS:
            yield _Tried(
                model.left(np.where(mine, torque / factor, torque))[0],
                f"the effort of {name} is about {factor:g} times what the URDF needs, that of the others is not: it has another "
                "unit or torque constant",
            )
    yield from _by_gravity(robot, motion, model)


def _by_gravity(robot: Robot, motion: Motion, model: _Model) -> Iterator[_Tried]:
    """Gravity from elsewhere: torque is linear in it."""
    still = _Model.of(replace(robot, gravity=np.zeros(3)), motion)
    along = [_Model.of(replace(robot, gravity=axis), motion).by_urdf - still.by_urdf for axis in np.eye(3)]
    stated, found = robot.gravity / np.linalg.norm(robot.gravity), robot.gravity
    for _ in range(GRAVITY_ROUNDS):  # what a payload takes goes with gravity, too
        gravity = model.left(model.rows.torque - still.by_urdf, np.column_stack(along))[1]
        if (size := float(np.linalg.norm(gravity))) == 0.0:
            return
        found = GRAVITY_M_S2 / size * gravity
        model = _Model.of(replace(robot, gravity=found), motion)
    if np.arccos(np.clip(found @ stated / GRAVITY_M_S2, -1.0, 1.0)) < LEAST_TILT_RAD:
        return
    shown = ",".join(f"{value:.1f}" for value in found)
    yield _Tried(
        model.left(model.rows.torque)[0],
        f"its torques are those of an arm on which gravity pulls along [{shown}] m/s^2 of the base, and the robot file says "
        f"otherwise: is the base mounted so? --set robot.gravity=[{shown}] states it",
    )


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else 0.0
