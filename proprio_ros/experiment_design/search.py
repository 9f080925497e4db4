"""Start poses, searched so that there is always an answer: the longer it goes on, the better.

All poses of a grid are tried in a shuffled order, a few of each joint at a time, and between that the best of each kind go
downhill, one joint after the other, by ever smaller steps. Where four joints matter beside the driven one, 500 poses so chosen
are as good as whole grids of 4,000 to 8,000 poses; a search that goes on to its end has tried the grid, too.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from proprio_ros.experiment_design.candidates import (
    CLEARANCE_M,
    joints_that_matter,
    shuffled,
    start_positions,
)
from proprio_ros.identification.calibration_estimate import (
    ExcitationPlan,
)
from proprio_ros.robot import Robot
from proprio_ros.robot.kinematics import clearance, zero_pose

STARTS = 6  # start positions of the driven joint, over its range
POSES = 4  # positions of each locked joint that matters, over its range
SAME_KIND = 2  # plans kept of one joint and kind
AT_A_TIME = 30  # poses of each joint's grid between two descents
STEPS = (
    0.5,
    0.04,
)  # of the grid's spacing: the first and the last that a descent goes by
NEAR = 0.5  # of the grid's spacing: plans that start nearer to each other are one
TELL_S = 1.0  # between two sentences

Pose = dict[str, float]
Try = Callable[[str, Pose], Iterable[tuple[float, ExcitationPlan]]]
"""Runs of a joint from a pose that suit, each with its score; less is better."""


@dataclass
class _Best:
    score: float
    plan: ExcitationPlan
    step: float = STEPS[0]


class Search:
    """A search over poses that can be stopped at any time; ``tries`` simulates the runs of one joint from one pose."""

    def __init__(
        self,
        robot: Robot,
        joints: Iterable[str],
        tries: Try,
    ) -> None:
        self._robot = robot
        self._tries = tries
        self._rest = zero_pose(robot)
        self._axes = {joint: self._axes_of(joint) for joint in joints}
        self._found: dict[tuple[str, str], list[_Best]] = {}
        self._seen: set[tuple[str, tuple[float, ...]]] = set()

    @property
    def plans(self) -> list[ExcitationPlan]:
        """The best so far of each joint and kind, best first."""
        found = sorted(
            (best for kept in self._found.values() for best in kept),
            key=lambda best: best.score,
        )
        return [best.plan for best in found]

    def run(
        self,
        seconds: float,
        tell: Callable[[str], None],
    ) -> None:
        """Search so long [s], or until nothing is left to try; while there is no plan it goes on."""
        began = told = time.monotonic()
        tell(f"trying start poses of {', '.join(self._axes)}; Ctrl-C ends it with the best so far")
        for _ in self._steps():
            now = time.monotonic()
            if self._found and now - began >= seconds:
                return
            if now - told >= TELL_S:
                told = now
                best = self.plans[:1]
                so_far = (
                    f"so far {best[0].joint} {best[0].kind}, {best[0].reason}"
                    if best
                    else "no run suits yet"
                )
                tell(f"{len(self._seen)} start poses tried in {now - began:.0f} s, {so_far}")

    def _axes_of(self, joint: str) -> dict[str, list[float]]:
        """The grid's positions of a driven joint and of the locked joints that matter to it [rad or m]."""
        others = joints_that_matter(self._robot, joint)
        axes = {joint: start_positions(self._robot, joint, STARTS)}
        return axes | {name: start_positions(self._robot, name, POSES) for name in others}

    def _steps(self) -> Iterator[None]:
        grids = {joint: shuffled(axes) for joint, axes in self._axes.items()}
        while grids:
            for _ in range(AT_A_TIME):
                for joint in [*grids]:
                    places = next(grids[joint], None)
                    if places is None:
                        del grids[joint]
                        continue
                    self._try(joint, self._rest | places)
                    yield
            yield from self._descend()

    def _descend(self) -> Iterator[None]:
        while moving := [
            best for kept in self._found.values() for best in kept if best.step >= STEPS[1]
        ]:
            best = min(moving, key=lambda each: each.score)
            before = best.score
            joint = best.plan.joint
            for name, axis in self._axes[joint].items():
                for way in (1.0, -1.0):
                    spacing = axis[1] - axis[0]
                    moved = best.plan.start[name] + way * best.step * spacing
                    place = round(
                        min(max(moved, axis[0]), axis[-1]),
                        2,
                    )
                    self._try(joint, {**best.plan.start, name: place})
                    yield
            if best.score > 0.999 * before:
                best.step *= 0.5

    def _try(self, joint: str, pose: Pose) -> None:
        key = (
            joint,
            tuple(pose[name] for name in self._axes[joint]),
        )
        if key not in self._seen:
            self._seen.add(key)
            if clearance(self._robot, pose) >= CLEARANCE_M:
                for score, plan in self._tries(joint, pose):
                    self._keep(score, plan)

    def _keep(self, score: float, plan: ExcitationPlan) -> None:
        kept = self._found.setdefault((plan.joint, plan.kind), [])
        axes = self._axes[plan.joint].items()
        reach = {name: NEAR * (axis[1] - axis[0]) for name, axis in axes}

        def is_near(other: ExcitationPlan) -> bool:
            return all(
                abs(other.start[name] - plan.start[name]) < far for name, far in reach.items()
            )

        near = [best for best in kept if is_near(best.plan)]
        if any(best.score <= score for best in near):
            return
        if near:  # a descent goes on from there
            near[0].score = score
            near[0].plan = plan
        else:
            kept.append(_Best(score, plan))
        kept[:] = sorted(
            (best for best in kept if best not in near[1:]),
            key=lambda best: best.score,
        )[:SAME_KIND]
