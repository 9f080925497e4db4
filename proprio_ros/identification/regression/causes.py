"""What is wrong with a motion that was refused: the one mistake that lets the URDF explain its torques.

Each mistake is undone in turn (a sign, a factor, an axis turned round, gravity from elsewhere), and what the URDF's bodies, a
payload and dry friction leave unexplained is compared. A mistake is named where undoing it explains what nothing else does.

Constants below that name no source were chosen by hand; `test/benchmarks/mistakes.py` measures what is named with them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import lsq_linear

from proprio_ros.errors import ProprioError, RecordingError
from proprio_ros.identification.estimate import Verdict
from proprio_ros.identification.judge import Refusal
from proprio_ros.identification.mistakes import of_all_joints, of_joint
from proprio_ros.identification.reasons import Reason
from proprio_ros.identification.regression.likelihood import SURE, Recorded, thinned
from proprio_ros.identification.regression.misread import Found, louder, misread
from proprio_ros.identification.regression.motion_equations import Arm, Rows, equations
from proprio_ros.identification.regression.motion_prior import HELD_WITHIN
from proprio_ros.identification.regression.other_causes import other_causes, sure
from proprio_ros.recordings.effort import effort_sign_option
from proprio_ros.recordings.motions import Motion
from proprio_ros.records import FloatArray
from proprio_ros.robot import Robot
from proprio_ros.robot.regressor import PARAMETERS, point_mass

EXPLAINED = 0.25
"""A mistake is named where undoing it leaves less than this of the torque, squared and relative to what the URDF says."""
BETTER = 3.0  # And so many times less than as it is,
CLEARER = 1.15  # and this much less than what any other mistake leaves.
UNEXPLAINED = 0.15  # What an arm that differs from its URDF leaves is less;
CERTAIN = 8.0  # a mistake that leaves so many times less is named whatever that is.
SUSPECT = 0.25
"""Share of a joint's torque: on real and simulated arms that nothing is wrong with up to 0.16 are left over."""
BEYOND_DOUBT = 150.0
"""An answer that nothing else speaks against is only taken back for a misread joint that raises the logarithm of the likelihood
by so much when it is read otherwise: on a real UR10e any that changes the mass raises it by 170, and on a real KUKA without any,
whose wrist carries next to nothing, two that are not there by up to 123."""
# So many samples are enough to tell mistakes apart: some twenty fits are made.
RATE_HZ = 100.0
LONGEST_S = 60.0
HEAVY_COSTS = 0.3  # Share of the torque that a payload as heavy as the arm must explain.
LEAST = 0.03  # And what is explained to this share is explained.
# A joint counts as if gravity and inertia took at least this share of the largest torque on any.
WEAK = 0.1
LEAST_TILT_RAD = 0.2
GRAVITY_ROUNDS = 4
DEGREES = 10.0
"""Angles that stay below are none in degrees: as such they hardly move, and offsets and a payload would explain any torque."""
GRAVITY_M_S2 = 9.81


# Share of the torque that is not explained without a mistake, the words for that, and the option that states it.
_Tried = tuple[float, str, str]


@dataclass(frozen=True)
class _Model:
    """The torque that the URDF says, beside what was recorded; a row for each window and joint."""

    rows: Rows
    by_urdf: FloatArray
    weight: FloatArray
    payload: FloatArray  # of things as heavy as the arm, each at another place
    size: FloatArray  # rms of the URDF's torque by joint [N m], shape (n,)

    @classmethod
    def of(cls, robot: Robot, motion: Motion) -> _Model:
        rows = equations(robot, motion, motion.joints, by_zeros=False)
        arm = Arm.of(
            robot,
            motion.joints,
            dict(motion.held),
        )
        by_urdf = rows.design[:, : PARAMETERS * arm.count] @ np.concatenate(arm.bodies)
        of_joint = [by_urdf[rows.joint == joint] for joint in range(arm.count)]
        size = np.array([_rms(torque) for torque in of_joint])
        directions = np.vstack([np.zeros(3), np.eye(3), -np.eye(3)])
        places = 3.0 * HELD_WITHIN * arm.reach_m * directions
        points = np.array([point_mass(place) for place in places])
        payload = arm.kg * rows.payload @ points.T
        return cls(
            rows,
            by_urdf,
            1.0 / np.maximum(size, WEAK * size.max())[rows.joint],
            payload,
            size,
        )

    def left(
        self,
        torque: FloatArray,
        beside: FloatArray | None = None,
    ) -> tuple[float, FloatArray]:
        """What is left of a torque, shape (E,), in parts of what the URDF says, and the factors of columns ``beside``, (E, 3).

        Those columns stand in the place of the URDF's torque.
        """
        own = np.eye(self.rows.joint.max() + 1)[self.rows.joint]
        known = self.by_urdf if beside is None else np.zeros_like(torque)
        # a payload also takes up what the URDF is off by, but is no lighter than nothing, as no friction helps
        columns = [
            self.payload,
            own * self.rows.direction[:, None],
            own,
            *([] if beside is None else [beside]),
        ]
        system = np.column_stack([*columns, torque - known]) * self.weight[:, None]
        total = max(
            float(np.sum(np.square(self.by_urdf * self.weight))),
            1e-12,
        )
        held = self.payload.shape[1]
        joints = own.shape[1]
        # a heavy payload needs a reason, and so does a constant torque
        costs = np.zeros(system.shape[1])
        offsets = slice(held + joints, held + 2 * joints)
        heaviest = (own * self.weight[:, None]).max(axis=0)
        costs[:held] = 1.0
        costs[offsets] = heaviest / np.sqrt(joints)
        penalties = np.sqrt(HEAVY_COSTS * total) * np.diag(costs)
        small = np.asarray(np.linalg.qr(np.vstack([system, penalties]), mode="r"))
        least = np.where(
            np.arange(len(costs) - 1) < held + joints,
            0.0,
            -np.inf,
        )
        found = lsq_linear(
            small[:, :-1],
            small[:, -1],
            (least, np.inf),
            tol=1e-12,
        )
        return 2.0 * float(found.cost) / total, found.x[-3:]


def with_cause(
    refusal: Refusal,
    robot: Robot,
    motions: Sequence[Motion],
    empty: Sequence[Motion] = (),
    unexplained: float = 0.0,
) -> Refusal | None:
    """The rejection of a fit for the mistake that explains what is wrong, its mass withheld; None where no mistake is found.

    Args:
        refusal: What was found so far, which may be nothing.
        robot: As its file states it, with its calibration.
        motions: With the payload, by their stamps, whatever clock was followed: a reversed joint bends a clock, too.
        empty: With an empty hand, by their stamps.
        unexplained: Largest share of a joint's torque that the fit leaves over, whether the joint decides or not: where that is
            much, an answer that nothing else speaks against is asked, too.
    """
    accepted = refusal.verdict is Verdict.ACCEPTED
    if accepted and unexplained < SUSPECT:
        return None
    found = one_mistake(robot, motions, empty, BEYOND_DOUBT if accepted else SURE)
    if found is not None and (found.of_positions or not accepted):
        cause = Reason(
            "misread_joint",
            f"{found.words}: so the torques of all joints are explained, and as recorded they are not",
        )
        if not found.is_misread:
            cause = Reason(found.code, f"{found.words}. As recorded, the torques are not explained")
        return _rejected_for(
            refusal, cause, "the motions are explained otherwise than they were recorded"
        )
    if accepted:
        return None
    everything = (*motions, *empty)
    for motion in everything:
        mistake = torque_cause(robot, motion)
        if mistake is None:
            continue
        others = [torque_cause(robot, other) for other in everything if other is not motion]
        code = "misfit"
        if refusal.verdict is not Verdict.TOO_WIDE:
            code = getattr(refusal.reasons[0], "code", "other")
        reason = Reason(code, f"{motion.name}: {mistake.sentence(others)}")
        return _rejected_for(refusal, reason, "the arm does not fit its URDF")
    return None


def one_mistake(
    robot: Robot,
    motions: Sequence[Motion],
    empty: Sequence[Motion] = (),
    least: float = SURE,
) -> Found | None:
    """The mistake without which motions are explained far better than with it, and than without any other.

    Args:
        robot: With its calibration, where it has one of motions.
        motions: With the payload.
        empty: Of the same joints with an empty hand, or none.
        least: By so much a joint that is misread has to raise the logarithm of the likelihood when that is undone.

    Returns: None where nothing is sure.
    """
    try:
        recorded = Recorded.of(robot, motions, empty)
        if recorded is None:
            return None
        # a servo's gain is among the other causes
        of_goals = any(motion.made_of_goals for motion in (*motions, *empty))
        of_unit = np.inf if of_goals else louder(recorded)
        others = other_causes(recorded)
        rivals = [of_unit, *(each.fit.cost for each in others)]
        found = misread(recorded, min(rivals), least)
    except (ProprioError, np.linalg.LinAlgError):
        return None
    if found is not None:
        return found
    alike = sure(others, of_unit)
    if not alike:
        return None
    where = recorded.where({each.scope for each in alike})
    words = ", or ".join(each.words for each in alike)
    return Found(where + words, of_positions=False, code=alike[0].code)


def _rejected_for(
    refusal: Refusal,
    cause: Reason,
    withheld: str,
) -> Refusal:
    """A rejection for a cause, before whatever else was found."""
    return replace(
        refusal,
        verdict=Verdict.REJECTED,
        withheld=refusal.withheld or withheld,
        reasons=(cause, *refusal.reasons),
    )


@dataclass(frozen=True)
class Cause:
    """The one mistake that explains the torques of a motion."""

    words: str  # a sentence without the name of the recording
    option: str  # what states it on the command line; empty: nothing does

    def sentence(self, others: Sequence[Cause | None]) -> str:
        """The words with what to do about it, beside what explains the other recordings: an option holds for all of them."""
        if not self.option:
            return self.words
        kind = self.option.partition("=")[0]
        if all(other is not None and other.option.startswith(kind) for other in others):
            return f"{self.words}: {self.option} states it"
        return (
            f"{self.words}; it does not show in all recordings, and those that are compared must come from one driver: only "
            f"where it holds for all, {self.option} states it"
        )


def torque_cause(robot: Robot, motion: Motion) -> Cause | None:
    """The one mistake that explains the torques of a motion; None where none is sure.

    ``robot``: as its file states it; ``motion``: that was refused.
    """
    motion = thinned(motion, RATE_HZ, LONGEST_S)
    try:
        model = _Model.of(robot, motion)
        as_it_is, _ = model.left(model.rows.torque)
        nothing, _ = model.left(0.0 * model.rows.torque)
        (least, words, option), *others = sorted(_tried(robot, motion, model))
    except (ProprioError, np.linalg.LinAlgError):
        return None
    # a torque of nothing is explained by a payload that cancels the arm's weight
    sure = least < min(EXPLAINED, nothing / 2.0) and as_it_is > max(
        BETTER * least, min(UNEXPLAINED, CERTAIN * least), LEAST
    )
    other = next(
        (left for left, said, _ in others if said != words),
        np.inf,
    )
    return Cause(words, option) if sure and CLEARER * least < other else None


def _tried(
    robot: Robot,
    motion: Motion,
    model: _Model,
) -> Iterator[_Tried]:
    sizes = model.size
    asked = [
        (
            np.ones(len(sizes), dtype=bool),
            of_all_joints(),
        )
    ]
    for number, name in enumerate(motion.joints):
        # mostly friction: less of it is explained better whatever is wrong
        if sizes[number] < WEAK * sizes.max():
            continue
        mistakes = of_joint(name, "effort", "the URDF needs, that of the others is not")
        asked.append((np.arange(len(sizes)) == number, mistakes))
    for which, mistakes in asked:
        models = {1.0: model}
        for mistake in mistakes:
            if mistake.angle > 1.0 and np.abs(motion.position).max() < DEGREES:
                continue
            if mistake.angle not in models:
                angle = motion.position / np.where(which, mistake.angle, 1.0)
                with suppress(RecordingError):  # then hardly anything moved
                    models[mistake.angle] = _Model.of(robot, replace(motion, position=angle))
            other = models.get(mistake.angle)
            if other is None:
                continue
            torque = other.rows.torque / np.where(which, mistake.torque, 1.0)[other.rows.joint]
            option = ""
            if mistake.torque == -1.0 and mistake.angle == 1.0:
                wrong = [
                    joint
                    for joint, asked_for in zip(motion.joints, which, strict=True)
                    if asked_for
                ]
                option = effort_sign_option(motion.joints, wrong, motion.turned)
            yield other.left(torque)[0], mistake.words, option
    yield from _by_gravity(robot, motion, model)


def _by_gravity(
    robot: Robot,
    motion: Motion,
    model: _Model,
) -> Iterator[_Tried]:
    """Gravity from elsewhere: torque is linear in it."""
    still = _Model.of(
        replace(robot, gravity=np.zeros(3)),
        motion,
    )
    along = [
        _Model.of(replace(robot, gravity=axis), motion).by_urdf - still.by_urdf
        for axis in np.eye(3)
    ]
    stated = robot.gravity / np.linalg.norm(robot.gravity)
    found = robot.gravity
    for _ in range(GRAVITY_ROUNDS):  # what a payload takes goes with gravity, too
        gravity = model.left(model.rows.torque - still.by_urdf, np.column_stack(along))[1]
        size = float(np.linalg.norm(gravity))
        if size == 0.0:
            return
        found = GRAVITY_M_S2 / size * gravity
        model = _Model.of(replace(robot, gravity=found), motion)
    if np.arccos(np.clip(found @ stated / GRAVITY_M_S2, -1.0, 1.0)) < LEAST_TILT_RAD:
        return
    shown = ",".join(f"{value:.2f}" for value in found)
    said = (
        f"its torques are those of an arm on which gravity pulls along [{shown}] m/s^2 of the base, and the robot file says "
        "otherwise. Where the base is mounted so"
    )
    yield model.left(model.rows.torque)[0], said, f"--set robot.gravity=[{shown}]"


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else 0.0
