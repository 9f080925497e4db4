"""The first pushes of an arm for which nobody wrote any: from its URDF alone, begun with little and raised until its joints move.

The joints on which a weight in the hand shows best are lifted and lowered from poses in which it has a long lever, with room all
around. The efforts begin at what gravity needs by the URDF and a slow acceleration; friction, which nobody knows yet, and what is
in the hand are found by raising. A servo that takes goals alone is pushed by steps of its goal, which are never raised.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from proprio_ros.errors import ConfigurationError
from proprio_ros.excitation import plans
from proprio_ros.excitation.springs import springs_of
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
STEP_RAD = 0.18  # of a goal, at most
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
    drawn = []
    for _ in range(POSES):
        places = {name: round(float(random.uniform(*span)), 2) for name, span in limits.items()}
        drawn.append({**rest, **places})
    return {name: _with_lever(robot, name, drawn) for name in limits}


def _with_lever(
    robot: Robot, name: str, poses: Sequence[dict[str, float]]
) -> list[tuple[float, dict[str, float]]]:
    """The poses in which a joint has room for a push, and a weight in the hand a lever on it, with that lever [m/rad]."""
    if robot.model.joint(name).kind == "prismatic":
        return []
    found = []
    for pose in poses:
        if not _has_room(robot, name, pose):
            continue
        lever = lever_m(robot, name, pose)
        if abs(lever) > LEAST_LEVER_M:
            found.append((lever, pose))
    return found


def first_sequence(robot: Robot, hand: str, held_kg: float = 0.0) -> plans.ExcitationSequence:
    """Pushes of an arm; the same whenever they are asked for.

    Args:
        robot: The arm.
        hand: What should be in the hand, one of `WORDS`.
        held_kg: What is known to be in the hand [kg].

    Raises:
        ConfigurationError: No driven joint that turns feels a weight in the hand where there is room for a push.
    """
    found = poses_of(robot)

    def shows(name: str) -> float:
        """How much of a weight in the hand: against what rubs, which grows with what the joint can lift."""
        longest = max((abs(lever) for lever, _ in found[name]), default=0.0)
        return longest / plans.largest_current_A(robot, name)

    best = sorted((name for name in found if found[name]), key=shows, reverse=True)[:JOINTS]
    if not best:
        words = "no joint that a motor turns feels a weight in the hand where there is room for a push: state sequences"
        raise ConfigurationError(f"{robot.name}: {words}, and payload_frame")
    loads = Loads(robot)
    runs: list[plans.ExcitationRun] = []
    by_goals = _takes_goals(robot)
    for name in best:
        for pose, lifts in _places(_two_poses(found[name], best), by_goals):
            start = {joint: pose[joint] for joint in found}
            up = math.copysign(1.0, lever_m(robot, name, pose)) * (1.0 if lifts else -1.0)
            load = loads.at(pose, held_kg)
            if by_goals:
                runs.append(
                    _step(
                        robot,
                        name,
                        start,
                        up,
                        load,
                    )
                )
            else:
                runs.append(_push(robot, name, start, up, lifts, load))
    return plans.ExcitationSequence(
        name=f"first_{hand}",
        hand=hand,
        runs=tuple(runs),
        description=f"lifts and lowers {' and '.join(best)} {WORDS[hand]}",
        min_clearance_m=CLEARANCE_M,
        approach_velocity=_approach_velocity(robot),
    )


def _approach_velocity(robot: Robot) -> float:
    """Speed between poses that the stiffest servo allows, at the motor's shaft: the fit uses torques on the way, too [rad/s]."""
    usual = plans.ExcitationSequence.approach_velocity
    springs = springs_of(robot, list(robot.drive_trains))
    allowed = [spring.fastest / plans.margin(robot, name, 1.0) for name, spring in springs.items()]
    return min([usual, *allowed])


def _places(
    poses: tuple[dict[str, float], dict[str, float]], by_goals: bool
) -> Sequence[tuple[dict[str, float], bool]]:
    """Where a joint is pushed, and whether that lifts."""
    longest, other = poses
    if by_goals:  # ways count, too: to and fro there are more of them
        return (longest, True), (other, True), (longest, False), (other, False)
    return (longest, True), (longest, False), (other, True), (other, False)


def _step(
    robot: Robot, name: str, start: Mapping[str, float], up: float, load: Load
) -> plans.ExcitationRun:
    """A step of a joint's goal, ``up`` its sign; a stiff servo, which would saturate, is pushed by a smaller one."""
    size = plans.margin(robot, name, STEP_RAD)
    spring = springs_of(robot, [name]).get(name)
    if spring is not None:
        size = min(size, spring.largest_step(load.gravity[name]))
    return plans.ExcitationRun(
        name,
        0.0,
        DURATION_S,
        start,
        goal_step=up * size,
    )


def _takes_goals(robot: Robot) -> bool:
    """Whether a servo of the arm takes goals alone."""
    servos = [drive.driven_by for drive in robot.drive_trains.values()]
    return any(servo is not None and servo.follows_goal for servo in servos)


def _two_poses(
    found: Sequence[tuple[float, dict[str, float]]], pushed: Sequence[str]
) -> tuple[dict[str, float], dict[str, float]]:
    """The one with the longest lever, and one in which gravity turns the joint the other way, or less.

    Both together tell weight from friction.
    """

    def short(each: tuple[float, dict[str, float]]) -> float:
        lever, pose = each
        return -abs(lever) + 0.02 * _far(pose, pushed)

    poses = sorted(found, key=short)
    longest_lever, longest = poses[0]
    sign = math.copysign(1.0, longest_lever)

    def same_way(each: tuple[float, dict[str, float]]) -> float:
        lever, pose = each
        return lever * sign + 0.02 * _far(pose, pushed)

    _, other = min(poses, key=same_way)
    return longest, other


def _push(
    robot: Robot,
    name: str,
    start: Mapping[str, float],
    up: float,
    lifts: bool,
    load: Load,
) -> plans.ExcitationRun:
    """A push of a joint, ``up`` the sign of its motion: raised until it moves, or eased until gravity moves it."""
    drive = robot.drive_trains[name]
    per_A = drive.nominal_effort_per_current
    rotor = (drive.armature.value or drive.armature.std) / drive.transmission**2
    weight_A = load.gravity[name] / per_A
    slow_A = ACCELERATION_RAD_S2 * (load.inertia[name] + rotor) / abs(per_A)
    most_A = 0.9 * plans.largest_current_A(robot, name)
    run = plans.ExcitationRun(
        joint=name,
        current_A=0.0,
        duration_s=DURATION_S,
        start=start,
        min_travel=LEAST_TRAVEL_RAD,
        max_travel=TRAVEL_RAD,
    )
    if not lifts and abs(weight_A) > 4.0 * slow_A:
        supporting_A = max(-most_A, min(SUPPORT * weight_A, most_A))
        return replace(run, current_A=supporting_A, raise_by=0.7)
    current_A = weight_A + up * math.copysign(slow_A, per_A)
    if abs(current_A) < plans.LEAST_CURRENT_A:
        current_A = up * math.copysign(plans.LEAST_CURRENT_A, per_A)
    return replace(
        run,
        current_A=max(-most_A, min(current_A, most_A)),
        raise_by=min(max(1.0 + slow_A / abs(current_A), 1.15), 1.6),
        max_current_A=most_A,
    )


def lever_m(robot: Robot, joint: str, pose: Mapping[str, float]) -> float:
    """How far the hand rises as a joint turns: the moment of a weight in it, per newton.

    Args:
        robot: The arm.
        joint: The joint that turns.
        pose: Of all independent joints [rad or m].

    Returns:
        The lever [m/rad].
    """
    up = -robot.gravity / np.linalg.norm(robot.gravity)
    before, after = (
        robot.model.frame_transform(robot.payload_frame, {**pose, joint: pose[joint] + step})
        for step in (-1e-4, 1e-4)
    )
    return float(up @ (after[:3, 3] - before[:3, 3])) / 2e-4


def _limits(robot: Robot, name: str) -> tuple[float, float]:
    joint = robot.model.joint(name)
    spare = plans.margin(robot, name, plans.START_MARGIN_RAD)
    low = max(joint.lower + spare, -WIDEST_RAD)
    high = min(joint.upper - spare, WIDEST_RAD)
    if low < high:
        return low, high
    middle = 0.5 * (low + high)
    return middle, middle


def _has_room(robot: Robot, name: str, pose: Mapping[str, float]) -> bool:
    joint = robot.model.joint(name)
    places = [pose[name] + part * ROOM_RAD for part in (-1.0, -0.5, 0.0, 0.5, 1.0)]
    if not joint.lower <= places[0] <= places[-1] <= joint.upper:
        return False
    return min(clearance(robot, {**pose, name: place}) for place in places) > CLEARANCE_M


def _far(pose: Mapping[str, float], joints: Sequence[str]) -> float:
    """Other joints should not be bent where that does not help."""
    return sum(abs(place) for name, place in pose.items() if name not in joints)
