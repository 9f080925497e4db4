"""Where an arm is, without any dynamics: how high above its base's plane, and what it looks like from the side."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from proprio_ros.errors import RobotError
from proprio_ros.robot.robot_file import Robot

Vector = tuple[float, float, float]
# of a joint's axis that is level: with less, one sees its motion better from elsewhere
_LEVEL = 0.7
_STILL_M = 1e-6  # a link whose height changes by less than this stands where it stands


@dataclass(frozen=True)
class _Step:
    """One joint on the way from the base to a link that can be lowered, as plain numbers: numpy is slow for three of them."""

    parent: int  # index of the step before it, -1 for the base
    kind: str
    # driver, multiplier, offset: the independent joint that it follows; it is its own where it mimics none
    driver: str
    multiplier: float
    offset: float
    columns: tuple[Vector, Vector, Vector]  # of parent_R_joint at position zero
    origin: Vector  # in the parent's frame [m]
    axis: Vector  # in its own frame
    counts: bool  # whether its child is one of the links asked for


def clearance(robot: Robot, pose: Mapping[str, float]) -> float:
    """Height above the base's plane, against gravity, of the lowest link that can be lowered, or of the hand [m].

    Raises `RobotError`: The position of an independent joint that matters is missing.
    """
    return _lowest(*_way_to_lowerable(robot), pose)


def side_view(
    robot: Robot, joint: str, poses: Sequence[Mapping[str, float]]
) -> tuple[np.ndarray, np.ndarray]:
    """The links as lines from joint to joint, seen along a joint's axis where that is level, else across the arm.

    In the first of the poses, which name all independent joints [rad or m], the hand is to the right.

    Args:
        robot: As its file or its calibration states it.
        joint: That is driven.
        poses: Positions of all joints [rad or m].

    Raises:
        RobotError: A position is missing.

    Returns:
        Both ends of the links in every pose, to the right of the base and above it [m], shape (P, L, 2, 2), and where the joint is,
        shape (P, 2).
    """
    model = robot.model
    plane = side_plane(robot, joint, poses[0])
    driven = [
        plane @ model.frame_transform(model.joint(joint).child, pose)[:3, 3] for pose in poses
    ]
    return links_in(robot, plane, poses), np.array(driven)


def side_plane(
    robot: Robot,
    joint: str,
    pose: Mapping[str, float],
) -> np.ndarray:
    """Unit vectors to the right and up of `side_view` in the frame of the root link, shape (2, 3).

    Args:
        robot: As its file or its calibration states it.
        joint: That is driven.
        pose: Positions of all joints [rad or m].

    Raises:
        RobotError: A position is missing.
    """
    at = functools.partial(robot.model.frame_transform, positions=pose)
    up = -robot.gravity / np.linalg.norm(robot.gravity)
    driven = robot.model.joint(joint)
    axis = at(driven.child)[:3, :3] @ driven.axis
    reach = at(robot.payload_frame)[:3, 3] - at(robot.model.root)[:3, 3]
    level = axis - up * (up @ axis)
    right = np.cross(level, up)
    if driven.kind == "prismatic" or np.linalg.norm(level) < _LEVEL:
        right = reach - up * (up @ reach)
    if np.linalg.norm(right) < _STILL_M:
        right = np.cross(
            up,
            np.eye(3)[int(np.abs(up).argmin())],
        )
    right *= (1.0 if right @ reach >= 0.0 else -1.0) / np.linalg.norm(right)
    return np.array([right, up])


def links_in(
    robot: Robot,
    plane: np.ndarray,
    poses: Sequence[Mapping[str, float]],
) -> np.ndarray:
    """Both ends of the links in every pose, along the unit vectors of a plane [m], shape (P, L, 2, 2); as `side_view`.

    Args:
        robot: As its file or its calibration states it.
        plane: Unit vectors to the right and up, (2, 3).
        poses: Positions of all joints [rad or m].
    """
    model = robot.model
    frames = [
        {link.name: model.frame_transform(link.name, pose) for link in model.links}
        for pose in poses
    ]
    return np.array(
        [
            [[plane @ at[end][:3, 3] for end in (j.parent, j.child)] for j in model.joints]
            for at in frames
        ]
    )


def hand_path(
    robot: Robot,
    joint: str,
    start: Mapping[str, float],
    travel: float,
    points: int = 20,
) -> np.ndarray:
    """Where the hand is while one joint moves, in the frame of the root link [m], shape (points, 3).

    Args:
        robot: As its file or its calibration states it.
        joint: That moves.
        start: Positions of all joints before [rad or m].
        travel: How far it moves, signed [rad or m].
        points: How many places on the way.

    Raises:
        RobotError: A position is missing.
    """
    places = np.linspace(start[joint], start[joint] + travel, points).tolist()
    at = [
        robot.model.frame_transform(robot.payload_frame, {**start, joint: place})
        for place in places
    ]
    return np.array([frame[:3, 3] for frame in at])


def bent_pose(robot: Robot) -> dict[str, float]:
    """A pose of all independent joints in which no lever happens to vanish [rad or m]."""
    joints = map(robot.model.joint, robot.model.independent_joints)
    return {
        joint.name: float(np.clip(0.3 + 0.1 * n, joint.lower, joint.upper))
        for n, joint in enumerate(joints)
    }


def zero_pose(
    robot: Robot,
    joints: Sequence[str] | None = None,
) -> dict[str, float]:
    """Joints, all independent ones where none are named, at zero, or at the limit nearest to it [rad or m]."""
    places = map(robot.model.joint, robot.model.independent_joints if joints is None else joints)
    return {joint.name: min(max(0.0, joint.lower), joint.upper) for joint in places}


def _lowest(
    up: Vector,
    steps: tuple[_Step, ...],
    pose: Mapping[str, float],
) -> float:
    # only heights are wanted: carry the vertical into each frame instead of the frame into the base
    passed: list[tuple[Vector, float]] = []
    lowest = math.inf
    for step in steps:
        vertical, height = passed[step.parent] if step.parent >= 0 else (up, 0.0)
        height += _dot(vertical, step.origin)
        x, y, z = (_dot(vertical, column) for column in step.columns)
        if step.kind != "fixed":
            try:
                position = step.multiplier * pose[step.driver] + step.offset
            except KeyError as error:
                raise RobotError(
                    f"the pose lacks the position of joint {step.driver!r}: give all of them"
                ) from error
            if step.kind == "prismatic":
                height += position * _dot((x, y, z), step.axis)
            else:
                x, y, z = _turned(
                    (x, y, z),
                    step.axis,
                    -position,
                )
        passed.append(((x, y, z), height))
        if step.counts:
            lowest = min(lowest, height)
    return lowest


@functools.lru_cache(maxsize=16)
def _way_to_lowerable(robot: Robot) -> tuple[Vector, tuple[_Step, ...]]:
    """The vertical in the base frame, and the joints to the links whose height depends on the pose, parents first.

    The first link of most arms stands where it stands.
    """
    rest = dict.fromkeys(robot.model.independent_joints, 0.0)
    bent = bent_pose(robot)
    up = _vector(-robot.gravity / np.linalg.norm(robot.gravity))
    children = (joint.child for joint in robot.model.joints if joint.independent)
    frames: list[str] = []
    for frame in dict.fromkeys([*children, robot.payload_frame]):
        steps = _way(robot, [frame])
        if abs(_lowest(up, steps, bent) - _lowest(up, steps, rest)) > _STILL_M:
            frames.append(frame)
    return up, _way(robot, frames)


def _way(robot: Robot, frames: list[str]) -> tuple[_Step, ...]:
    by_child = {joint.child: joint for joint in robot.model.joints}
    needed = set()
    for frame in frames:
        while frame in by_child:
            needed.add(frame)
            frame = by_child[frame].parent
    index: dict[str, int] = {}
    steps: list[_Step] = []
    for joint in robot.model.joints:
        if joint.child not in needed:
            continue
        driver, multiplier, offset = robot.model.driving(joint)
        index[joint.child] = len(steps)
        first, second, third, origin = (_vector(joint.origin[:3, n]) for n in range(4))
        follows = (index.get(joint.parent, -1), joint.kind, driver, multiplier, offset)
        steps.append(
            _Step(
                *follows, (first, second, third), origin, _vector(joint.axis), joint.child in frames
            )
        )
    return tuple(steps)


def _vector(values: np.ndarray) -> Vector:
    x, y, z = values.tolist()
    return x, y, z


def _dot(a: Vector, b: Vector) -> float:
    x = a[0] * b[0]
    y = a[1] * b[1]
    z = a[2] * b[2]
    return x + y + z


def _turned(v: Vector, axis: Vector, angle: float) -> Vector:
    """Rodrigues' formula: v turned about a unit axis by an angle [rad]."""
    c = math.cos(angle)
    s = math.sin(angle)
    along = (1.0 - c) * _dot(axis, v)
    return (
        c * v[0] + s * (axis[1] * v[2] - axis[2] * v[1]) + along * axis[0],
        c * v[1] + s * (axis[2] * v[0] - axis[0] * v[2]) + along * axis[1],
        c * v[2] + s * (axis[0] * v[1] - axis[1] * v[0]) + along * axis[2],
    )
