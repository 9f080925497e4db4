"""Links and joints of a robot, whatever they were read from.

A joint's frame moves with it: the child link's frame is ``parent_T_child(q) = origin @ motion(axis, q)``, as URDF defines
it.
"""

from __future__ import annotations

from dataclasses import dataclass

from proprio_ros.robot.geometry import FloatArray, motion

JOINT_KINDS = ("revolute", "continuous", "prismatic", "fixed")


@dataclass(frozen=True, eq=False)
class Joint:
    """One joint of the tree."""

    name: str
    kind: str  # one of `JOINT_KINDS`
    # parent, child: link it stands on, and link it carries
    parent: str
    child: str
    origin: FloatArray  # parent_T_joint at position zero, shape (4, 4)
    axis: FloatArray  # unit axis in the joint frame, shape (3,)
    # lower, upper: smallest and largest position [rad or m], infinite when there is none
    lower: float
    upper: float
    # velocity_limit, effort_limit: [rad/s or m/s] and [N m or N], infinite when there is none
    velocity_limit: float
    effort_limit: float
    # (source joint, multiplier, offset) of a joint that follows another; None for an independent one
    mimic: tuple[str, float, float] | None = None

    @property
    def independent(self) -> bool:
        """Whether the joint has a position of its own."""
        return self.kind != "fixed" and self.mimic is None

    def transform(self, position: float | FloatArray) -> FloatArray:
        """parent_T_child at a position [rad or m], shape (4, 4), or at N of them, shape (N, 4, 4)."""
        return self.origin @ motion(self.kind, self.axis, position)


@dataclass(frozen=True)
class Spread:
    """Standard deviations of a link's body beyond those of all links, where its description is no body's."""

    mass: float = 0.0  # relative
    com_m: float = 0.0  # of each coordinate of its centre
    inertia: float = 0.0  # about its centre, relative


@dataclass(frozen=True, eq=False)
class Link:
    """One link of the tree; its pseudo-inertia is about its frame, shape (4, 4), zeros when the URDF gives no inertial."""

    name: str
    pseudo_inertia: FloatArray
    spread: Spread = Spread()
    # whether an arm moves it and nothing says what it weighs, so that its joint must be held
    unknown: bool = False
