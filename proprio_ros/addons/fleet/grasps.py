"""Within an episode: from when to when the hand held something, how heavy it was, and what became of it.

The running estimate goes through the motion and says when the load changed. Between two changes the load is one thing: the answer
is the estimate that had all of that stretch behind it. Where the recording has the gripper's joint, whether it moved then tells
what was put down from what fell. Which way it opens need not be known.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from proprio_ros.identification.regression.online import OnlineEstimate
from proprio_ros.pipeline.request import Request
from proprio_ros.probes.base import Online
from proprio_ros.recordings.motions import Motion
from proprio_ros.records import FloatArray
from proprio_ros.robot import Robot

LEAST_S = 0.5  # a stretch with less motion than this says nothing [s]
GRIPPERS = ("gripper", "finger", "jaw")
"""A joint with one of these in its name moves the fingers, and so does one that slides."""
# a gripper that lets go or takes hold does so within this of the change of the load, whose instant is known to some tenths [s]
BEFORE_S = 1.0
AFTER_S = 0.5
# of its range; a gripper that moves less stands still: an object gives way, and motors have play
MOVED_SHARE = 0.05


@dataclass(frozen=True)
class Grasp:
    """A stretch with one load."""

    # start_s, end_s: since the first sample
    start_s: float
    end_s: float
    samples: int  # within
    # mass_kg, std_kg, ci95_kg: of what was held
    mass_kg: float
    std_kg: float
    ci95_kg: tuple[float, float]
    known: bool  # whether the interval is narrow enough to be called a mass
    # ``held``; ``empty``: the interval holds zero; ``slipped``: the load fell, but not to nothing; ``released``: it
    # fell to nothing; ``dropped``: it did while the gripper stood still
    code: str
    what: str  # the same as a sentence
    gripper: float | None = None  # its mean position [rad or m]; None where it was not recorded


def gripper_joint(robot: Robot, motion: Motion) -> str | None:
    """The joint that opens and closes the hand; None where the recording has none."""
    for name in (*motion.beside, *motion.joints):
        slides = (
            name in robot.model.independent_joints and robot.model.joint(name).kind == "prismatic"
        )
        if slides or any(word in name.lower() for word in GRIPPERS):
            return name
    return None


class Grasps:
    """Finds the stretches of a motion that comes in parts, for a probe that is `Online`.

    Where other joints stand in the first part they count as standing throughout. Raises `RobotError`: The calibration
    of motions is of another arm.
    """

    def __init__(self, request: Request, robot: Robot, first: Motion) -> None:
        self.robot = robot
        assert isinstance(request.probe, Online)
        self._running = request.probe.running(
            robot,
            request.facts,
            dict(first.held),
        )
        self._gripper = gripper_joint(robot, first)
        self._last: dict[float, OnlineEstimate] = {}
        self._times: list[FloatArray] = []
        self._positions: list[FloatArray] = []
        self._begin = 0.0, 0

    def add(self, motion: Motion, start_s: float = 0.0) -> None:
        """A part, later than those before; it begins at ``start_s``, or where both have stamps, when these say."""
        if not self._times:
            self._begin = start_s, motion.begin_ns
        if motion.begin_ns and self._begin[1]:
            start_s = self._begin[0] + 1e-9 * (motion.begin_ns - self._begin[1])
        columns = [motion.joints.index(name) for name in self._running.joints]
        position = motion.position[:, columns]
        current = motion.current_A[:, columns]
        times_s = start_s + motion.times_s
        for row, time_s in enumerate(times_s):
            if self._running.add(float(time_s), position[row].tolist(), current[row].tolist()):
                estimate = self._running.estimate()
                if estimate is not None and estimate.motion_s >= LEAST_S:
                    # a change whose instant is refined moves a little: it is still the same stretch
                    same = next(
                        (at for at in self._last if abs(at - estimate.since_s) < LEAST_S),
                        estimate.since_s,
                    )
                    self._last[same] = estimate
        self._times.append(times_s)
        if self._gripper is not None:
            beside = motion.beside.get(self._gripper)
            self._positions.append(
                motion.position[:, motion.joints.index(self._gripper)] if beside is None else beside
            )

    def found(self) -> list[Grasp]:
        """The stretches in the order of time; those with an empty hand among them."""
        times_s = np.concatenate(self._times)
        gripper = np.concatenate(self._positions) if self._positions else None
        grasps: list[Grasp] = []
        before: OnlineEstimate | None = None
        starts = sorted(self._last)
        for start, end in itertools.pairwise([*starts, float(times_s[-1])]):
            now = self._last[start]
            within = (times_s >= start) & (times_s < end)
            moved = None
            stands = None
            if gripper is not None:
                moved = self._moved(
                    gripper, (times_s >= start - BEFORE_S) & (times_s <= start + AFTER_S)
                )
                stands = float(gripper[within].mean()) if within.any() else None
            what = _said(before, now, moved)
            mass = (now.mass_kg, now.std_kg, now.ci95_kg, now.known)
            grasps.append(
                Grasp(
                    start,
                    end,
                    int(within.sum()),
                    *mass,
                    *what,
                    stands,
                )
            )
            before = now
        return grasps

    def _moved(self, gripper: FloatArray, near: np.ndarray) -> bool:
        """Whether the gripper moved where the load changed."""
        name = str(self._gripper)
        reach = 0.0
        if name in self.robot.model.independent_joints:
            joint = self.robot.model.joint(name)
            reach = joint.upper - joint.lower
        if not 0.0 < reach < np.inf:
            reach = float(np.ptp(gripper))
        if not near.any():
            return False
        return bool(np.ptp(gripper[near]) > max(MOVED_SHARE * reach, 1e-4))


def _said(
    before: OnlineEstimate | None, now: OnlineEstimate, gripper_moved: bool | None
) -> tuple[str, str]:
    """What became of the load from one stretch to the next, as a code and as a sentence.

    The first stretch has none before it; None: nobody knows whether the gripper moved where one became the other.
    """
    empty = now.ci95_kg[0] <= 0.0
    heavy = f"{1e3 * now.mass_kg:.0f} g ({1e3 * now.ci95_kg[0]:.0f} to {1e3 * now.ci95_kg[1]:.0f})"
    if before is None or before.ci95_kg[0] <= 0.0 or now.mass_kg >= before.mass_kg:
        return (
            ("empty", f"nothing that can be told from zero: {heavy}")
            if empty
            else ("held", f"held: {heavy}")
        )
    code, words = {
        (True, None): ("released", "put down or lost"),
        (True, True): ("released", "put down, the gripper moved"),
        (True, False): ("dropped", "lost, the gripper stood still"),
        (False, True): ("held", "less is held after the gripper moved"),
    }.get((empty, gripper_moved), ("slipped", "slipped in part"))
    return code, f"{words}: {heavy} after {1e3 * before.mass_kg:.0f} g"
