"""Where the hand will go before anything moves: the ways to where pushes begin, and as far as these may take it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from proprio_ros.excitation.plans import load_sequence
from proprio_ros.excitation.ways import Way
from proprio_ros.excitation.ways import Ways as Finder
from proprio_ros.robot import Robot
from proprio_ros.robot.kinematics import hand_path, zero_pose

POINTS = 24
"""Of one way."""


@dataclass
class Ways:
    """Places of the hand in the frame of the root link [m], shape (3,) each.

    Attributes:
        between_m: On the ways to where pushes begin.
        pushed_m: As far as pushes may take it, either way.
    """

    between_m: list[list[float]] = field(default_factory=list)
    pushed_m: list[list[float]] = field(default_factory=list)


def ways_of(names: Sequence[str], robot: Robot, pose: Mapping[str, float]) -> Ways:
    """Those of sequences, one after the other; pushes that are chosen as they come are not known yet.

    Args:
        names: Of the sequences.
        robot: The arm.
        pose: Where its joints stand [rad or m].

    Raises:
        ConfigurationError, ExcitationError: A sequence cannot be read, or no way is free.
    """
    finder = Finder(robot)
    found = Ways()
    here = {**zero_pose(robot), **pose}
    for name in names:
        sequence = load_sequence(name, robot).begun_at(here)
        for number, run in enumerate(sequence.runs, 1):
            begin = {**here, **run.start}
            way = finder.find(here, begin, sequence, f"run {number}")
            found.between_m += _places(robot, way)
            joint = robot.model.joint(run.joint)
            low = max(begin[run.joint] - run.max_travel, joint.lower)
            high = min(begin[run.joint] + run.max_travel, joint.upper)
            begin[run.joint] = low
            found.pushed_m += hand_path(robot, run.joint, begin, high - low, POINTS).tolist()
            here = {**here, **run.start}
        back = finder.find(here, {**here, **sequence.home}, sequence, "the end")
        found.between_m += _places(robot, back)
    return found


def _places(robot: Robot, way: Way) -> list[list[float]]:
    """Of the hand on a way."""
    times_s = np.linspace(0.0, way.duration_s, POINTS).tolist()
    frames = [robot.model.frame_transform(robot.payload_frame, way.at(at_s)) for at_s in times_s]
    return [frame[:3, 3].tolist() for frame in frames]
