"""Ways of the arm from pose to pose: minimum-jerk motions in joint space that stay clear of the base's plane, the table."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from proprio_ros.errors import ExcitationError
from proprio_ros.excitation.commands import JointSample
from proprio_ros.excitation.plans import ExcitationSequence, margin
from proprio_ros.records import FloatArray
from proprio_ros.robot import Robot
from proprio_ros.robot.kinematics import clearance, zero_pose

MIN_APPROACH_S = 0.3
PEAK_OVER_MEAN = 1.875  # of a minimum-jerk motion (Flash & Hogan 1985): peak speed over mean speed
PATH_STEP_RAD = 0.03  # of the joint that moves most, between two poses whose height is looked at
PATH_SLACK_M = 1e-3  # a way up from a low pose may dip by so much: encoders are not exact


@dataclass(frozen=True)
class Way:
    """Minimum-jerk motions from pose to pose, with a stop at each."""

    poses: tuple[dict[str, float], ...] = ({},)  # the first is where it begins
    durations_s: tuple[float, ...] = ()  # of the motions between them, one less

    @property
    def duration_s(self) -> float:
        """Of the whole way [s]."""
        return sum(self.durations_s)

    def at(self, elapsed_s: float) -> dict[str, float]:
        """Positions of all joints at a time from the beginning [rad or m]."""
        spans = itertools.pairwise(self.poses)
        for (before, after), duration_s in zip(spans, self.durations_s, strict=True):
            if elapsed_s < duration_s:
                s = max(elapsed_s, 0.0) / duration_s
                part = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)  # minimum jerk
                return _between(before, after, part)
            elapsed_s -= duration_s
        return dict(self.poses[-1])


def _between(
    before: Mapping[str, float], after: Mapping[str, float], part: float
) -> dict[str, float]:
    """The pose at a part of the straight way."""
    return {name: start + part * (after[name] - start) for name, start in before.items()}


def approach_s(widest_rad: FloatArray | float, velocity_rad_s: float) -> FloatArray:
    """How long a minimum-jerk way takes [s], by the way and the peak speed of the joint that moves farthest, at its shaft."""
    return np.maximum(MIN_APPROACH_S, PEAK_OVER_MEAN * widest_rad / velocity_rad_s)


class Ways:
    """Poses of one arm and ways between them.

    Attributes:
        robot: The arm.
        joints: Those with a drive train.
        per_rad: By joint, what an angle at the motor's shaft is in the joint's own unit [1 or m/rad].
    """

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.joints = tuple(robot.drive_trains)
        self.per_rad = {name: margin(robot, name, 1.0) for name in self.joints}
        # joints without a motor are taken to stand at zero, or at the limit nearest to it
        self._rest = zero_pose(robot)

    def pose(self, sample: JointSample) -> dict[str, float]:
        """Where the driven joints are [rad or m]."""
        return {name: float(sample.position[name]) for name in self.joints}

    def whole(self, pose: Mapping[str, float]) -> dict[str, float]:
        """The pose with the joints that it does not name [rad or m]."""
        return {**self._rest, **pose}

    def height(self, pose: Mapping[str, float]) -> float:
        """Of what can be lowered, above the base's plane [m]."""
        return clearance(self.robot, self.whole(pose))

    def limits(self, joint: str, margin_rad: float) -> tuple[float, float]:
        """Of a joint, less a margin at the motor's shaft [rad or m]."""
        model = self.robot.model.joint(joint)
        spare = margin_rad * self.per_rad[joint]
        return model.lower + spare, model.upper - spare

    def find(
        self,
        before: Mapping[str, float],
        after: Mapping[str, float],
        sequence: ExcitationSequence,
        where: str,
    ) -> Way:
        """The straight way of all driven joints, or one over a higher pose when that comes too low.

        Args:
            before: Where they begin [rad or m].
            after: Where they go [rad or m].
            sequence: States the clearance and the speed.
            where: What is there, in words.

        Raises:
            ExcitationError: No way keeps the sequence's clearance.
        """
        straight = (dict(before), dict(after))
        if self.clear(straight, sequence.min_clearance_m):
            return self._timed(straight, sequence)
        for high in self._high_poses(before, after):
            poses = (dict(before), high, dict(after))
            if self.clear(poses, sequence.min_clearance_m):
                return self._timed(poses, sequence)
        clearance_cm = f"{100 * sequence.min_clearance_m:.0f} cm"
        raise ExcitationError(
            f"no way to {where} keeps the arm {clearance_cm} above the base's plane: move it to a "
            "higher pose by hand, with torque off (a virtual one: call its recover), and start again"
        )

    def _timed(self, poses: tuple[dict[str, float], ...], sequence: ExcitationSequence) -> Way:
        durations_s = []
        for before, after in itertools.pairwise(poses):
            widest_rad = self._widest_rad(before, after)
            durations_s.append(float(approach_s(widest_rad, sequence.approach_velocity)))
        return Way(poses, tuple(durations_s))

    def _high_poses(
        self, before: Mapping[str, float], after: Mapping[str, float]
    ) -> list[dict[str, float]]:
        """Poses to go over, highest first: some joints moved before the others, or the arm at its zero pose."""
        turning = [name for name in self.joints if self.robot.model.joint(name).kind != "prismatic"]
        moved = [name for name in turning if before[name] != after[name]]
        poses = []
        for count in range(1, len(moved)):
            for first in itertools.combinations(moved, count):
                moved_first = {name: after[name] for name in first}
                poses.append({**before, **moved_first})
        # the base joint does not lift anything: leave it where it is
        at_rest = {name: self._rest[name] for name in turning[1:]}
        poses.append({**before, **at_rest})
        return sorted(poses, key=lambda pose: -self.height(pose))

    def clear(self, poses: Sequence[Mapping[str, float]], min_clearance_m: float) -> bool:
        """Whether the arm stays high enough; where it begins too low, whether it only rises until it is."""
        reached = self.height(poses[0])
        for before, after in itertools.pairwise(poses):
            steps = max(2, 1 + math.ceil(self._widest_rad(before, after) / PATH_STEP_RAD))
            for part in np.linspace(0.0, 1.0, steps).tolist():
                height = self.height(_between(before, after, part))
                if height < min(min_clearance_m, reached) - PATH_SLACK_M:
                    return False
                reached = max(reached, height)
        return reached >= min_clearance_m - PATH_SLACK_M

    def _widest_rad(self, before: Mapping[str, float], after: Mapping[str, float]) -> float:
        return max(abs(after[name] - before[name]) / self.per_rad[name] for name in self.joints)
