"""Where the hand will go before anything moves: the ways to where pushes begin, and as far as these may take it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from proprio_ros.excitation.plans import ExcitationRun, load_sequence
from proprio_ros.excitation.ways import Ways
from proprio_ros.robot import Robot
from proprio_ros.robot.kinematics import hand_path, zero_pose

POINTS = 24
"""Of one way."""
Places = list[list[float]]
"""Of the hand in the frame of the root link [m], shape (N, 3)."""


def ways_of(names: Sequence[str], robot: Robot, pose: Mapping[str, float]) -> tuple[Places, Places]:
    """Those of sequences, one after the other; pushes that are chosen as they come are not known yet.

    Args:
        names: Of the sequences.
        robot: The arm.
        pose: Where its joints stand [rad or m].

    Returns:
        The ways to where pushes begin and back, and as far as pushes may take the hand, either way.

    Raises:
        ConfigurationError, ExcitationError: A sequence cannot be read, or no way is free.
    """
    finder = Ways(robot)
    between: Places = []
    pushed: Places = []
    here = {**zero_pose(robot), **pose}
    for name in names:
        sequence = load_sequence(name, robot).begun_at(here)
        for goal in (*(run.start for run in sequence.runs), sequence.home):
            way = finder.find(here, {**here, **goal}, sequence, "the next pose")
            for at_s in np.linspace(0.0, way.duration_s, POINTS).tolist():
                place = robot.model.frame_transform(robot.payload_frame, way.at(at_s))
                between.append(place[:3, 3].tolist())
            here |= goal
        for run in sequence.runs:
            here |= run.start
            pushed += _pushed(robot, here, run)
    return between, pushed


def _pushed(robot: Robot, begin: Mapping[str, float], run: ExcitationRun) -> Places:
    """By one push, from a pose of all joints [rad or m]."""
    joint = robot.model.joint(run.joint)
    low = max(begin[run.joint] - run.max_travel, joint.lower)
    high = min(begin[run.joint] + run.max_travel, joint.upper)
    return hand_path(robot, run.joint, {**begin, run.joint: low}, high - low, POINTS).tolist()
