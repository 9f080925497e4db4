"""The first pushes of an arm for which nobody wrote any: from its URDF alone, begun with little and raised until its joints move.

The joints on which a weight in the hand shows best are lifted and lowered from poses in which it has a long lever, with room all
around. The efforts begin at what gravity needs by the URDF and a slow acceleration; friction, which nobody knows yet, and what is
in the hand are found by raising. A servo that takes goals alone is pushed by steps of its goal, which are never raised.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np

from proprio_ros.errors import ConfigurationError
from proprio_ros.excitation import plans
from proprio_ros.robot import Robot
from proprio_ros.robot.kinematics import bent_pose, clearance, zero_pose
from proprio_ros.robot.loads import Load, Loads

JOINTS = 2  # are pushed
POSES = 400  # are looked at for each of them
WIDEST_RAD = 1.5  # of a joint without limits, and from zero
# either way of a start there is room: for a push, for what a load pulls the other way, and for braking
ROOM_RAD = 0.6
TRAVEL_RAD = 0.35
LEAST_TRAVEL_RAD = 0.12
DURATION_S = 0.6
ACCELERATION_RAD_S2 = 1.5  # of the first attempt, beside gravity: 0.27 rad in a push
CLEARANCE_M = 0.05
LEAST_LEVER_M = 0.02  # a joint on which a weight has less of a lever does not weigh
# of what gravity needs: with so much a joint begins to be lowered, and with less from attempt to attempt
SUPPORT = 0.85
STEP_RAD = 0.18  # of a goal
WORDS = {
    "empty": "with nothing in the hand",
    "payload": "with the object",
    "reference": "with the reference object",
}


@lru_cache(maxsize=4)
def poses_of(robot: Robot) -> Mapping[str, Sequence[tuple[float, dict[str, float]]]]:
    """Of each joint that raises the hand: levers [m/rad] and poses in which it has room and a lever; made once, within a second.

    Whoever holds an arm has it made before: joint states would wait for it.
    """
    random = np.random.default_rng(0)
    rest = zero_pose(robot)
    bent = bent_pose(robot)
    # what does not raise the hand stays where it rests
    limits = {
        name: _limits(robot, name)
        for name in robot.drive_trains
        if abs(lever_m(robot, name, bent)) > 1e-6
    }
    drawn = [
        {**rest, **{n: round(float(random.uniform(*span)), 2) for n, span in limits.items()}}
        for _ in range(POSES)
    ]
    found: dict[str, list[tuple[float, dict[str, float]]]] = {}
    for name in limits:
        slides = robot.model.joint(name).kind == "prismatic"
        levers = [
            (lever_m(robot, name, pose), pose)
            for pose in drawn
            if not slides and _has_room(robot, name, pose)
        ]
        found[name] = [(lever, pose) for lever, pose in levers if abs(lever) > LEAST_LEVER_M]
    return found


def first_sequence(robot: Robot, hand: str, held_kg: float = 0.0) -> plans.ExcitationSequence:
    """Pushes of an arm with what `WORDS` says in its hand; the same whenever they are asked for.

    Raises `ConfigurationError`: No driven joint that turns feels a weight in the hand where there is room for a push.
    """
    goals = [
        drive.driven_by is not None and drive.driven_by.follows_goal
        for drive in robot.drive_trains.values()
    ]
    loads, steps, found = Loads(robot), any(goals), poses_of(robot)

    def shows(name: str) -> float:
        """How much of a weight in the hand: against what rubs, which grows with what the joint can lift."""
        return max((abs(lever) for lever, _ in found[name]), default=0.0) / plans.largest_current_A(
            robot, name
        )

    best = sorted((name for name, poses in found.items() if poses), key=shows, reverse=True)[
        :JOINTS
    ]
    if not best:
        words = "no joint that a motor turns feels a weight in the hand where there is room for a push: state sequences"
        raise ConfigurationError(f"{robot.name}: {words}, and payload_frame")
    runs: list[plans.ExcitationRun] = []
    for name in best:
        poses = sorted(
            found[name],
            key=lambda each: -abs(each[0]) + 0.02 * _far(each[1], best),
        )
        longest = poses[0][1]
        # a second one in which gravity turns the joint the other way, or less, tells weight from friction
        other = min(
            poses,
            key=lambda each: each[0] * math.copysign(1.0, poses[0][0]) + 0.02 * _far(each[1], best),
        )[1]
        for pose, lifts in ((longest, True), (longest, False), (other, True), (other, False)):
            start = {joint: pose[joint] for joint in found}
            up = math.copysign(1.0, lever_m(robot, name, pose)) * (1.0 if lifts else -1.0)
            if steps:
                step = up * plans.margin(robot, name, STEP_RAD)
                runs.append(plans.ExcitationRun(name, 0.0, DURATION_S, start, goal_step=step))
            else:
                runs.append(
                    _push(
                        robot,
                        name,
                        start,
                        up,
                        lifts,
                        loads.at(pose, held_kg),
                    )
                )
    return plans.ExcitationSequence(
        f"first_{hand}", hand, tuple(runs), description=f"lifts and lowers {' and '.join(best)} {WORDS[hand]}",
        min_clearance_m=CLEARANCE_M,
    )  # fmt: skip


def _push(
    robot: Robot,
    name: str,
    start: Mapping[str, float],
    up: float,
    lifts: bool,
    load: Load,
) -> plans.ExcitationRun:
    drive = robot.drive_trains[name]
    per_A = drive.nominal_effort_per_current
    rotor = (drive.armature.value or drive.armature.std) / drive.transmission**2
    weight_A = load.gravity[name] / per_A
    slow_A = ACCELERATION_RAD_S2 * (load.inertia[name] + rotor) / abs(per_A)
    most_A = 0.9 * plans.largest_current_A(robot, name)
    limits = {"min_travel": LEAST_TRAVEL_RAD, "max_travel": TRAVEL_RAD}
    if not lifts and abs(weight_A) > 4.0 * slow_A:
        lowered_A = max(-most_A, min(SUPPORT * weight_A, most_A))
        return plans.ExcitationRun(name, lowered_A, DURATION_S, start, raise_by=0.7, **limits)
    current_A = weight_A + up * math.copysign(slow_A, per_A)
    if abs(current_A) < plans.LEAST_CURRENT_A:
        current_A = up * math.copysign(plans.LEAST_CURRENT_A, per_A)
    raised = min(max(1.0 + slow_A / abs(current_A), 1.15), 1.6)
    bounded_A = max(-most_A, min(current_A, most_A))
    return plans.ExcitationRun(
        name, bounded_A, DURATION_S, start, raise_by=raised, max_current_A=most_A, **limits
    )


def lever_m(
    robot: Robot,
    joint: str,
    pose: Mapping[str, float],
) -> float:
    """How far the hand rises as a joint turns: the moment of a weight in it, per newton [m/rad]."""
    up = -robot.gravity / np.linalg.norm(robot.gravity)
    ends = [
        robot.model.frame_transform(robot.payload_frame, {**pose, joint: pose[joint] + d})
        for d in (-1e-4, 1e-4)
    ]
    return float(up @ (ends[1][:3, 3] - ends[0][:3, 3])) / 2e-4


def _limits(robot: Robot, name: str) -> tuple[float, float]:
    joint = robot.model.joint(name)
    spare = plans.margin(robot, name, plans.START_MARGIN_RAD)
    low = max(joint.lower + spare, -WIDEST_RAD)
    high = min(joint.upper - spare, WIDEST_RAD)
    return (low, high) if low < high else (0.5 * (low + high),) * 2


def _has_room(
    robot: Robot,
    name: str,
    pose: Mapping[str, float],
) -> bool:
    joint = robot.model.joint(name)
    places = [pose[name] + part * ROOM_RAD for part in (-1.0, -0.5, 0.0, 0.5, 1.0)]
    if not joint.lower <= places[0] <= places[-1] <= joint.upper:
        return False
    return min(clearance(robot, {**pose, name: place}) for place in places) > CLEARANCE_M


def _far(pose: Mapping[str, float], joints: Sequence[str]) -> float:
    """Other joints should not be bent where that does not help."""
    return sum(abs(place) for name, place in pose.items() if name not in joints)
