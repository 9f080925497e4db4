"""What holds of a number that a robot file leaves out: never that it is known exactly, but so wide that it is no claim.

Friction and rotors grow with what a joint can lift, so their defaults are parts of that. Seen on joints of 3 to 330 N m
(OpenManipulator-X, STS3215, UR10e): Coulomb friction of some percent of it, armature about 0.01 kg m^2 per 3 N m; torque constants
a few percent, and up to a third, off what their makers say.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from proprio_ros.quantity import Quantity
from proprio_ros.robot.tree import RobotModel
from proprio_ros.robot.urdf import MOST_EFFORT

LARGEST_TORQUE = MOST_EFFORT  # of slides as of joints that turn
RECORDED_TORQUE = {"value": 1.0, "std": 0.1}
"""Torque over that which was recorded: boards that estimate their motors' torque were seen to err by a tenth."""


@dataclass(frozen=True)
class DefaultPrior:
    """A default that goes with the joint."""

    # ``largest torque``: zero, and so much of it as standard deviation; ``weakest``: the same of the weakest joint, for
    # a spread of its own; ``nominal``: the nominal torque constant, and so much of that
    of: str
    share: float  # how much

    def at(self, nominal: float, largest: float) -> Quantity:
        """Of a joint with this nominal torque constant [N m/A] and largest torque [N m]."""
        return (
            Quantity(nominal, self.share * nominal)
            if self.of == "nominal"
            else Quantity(0.0, self.share * largest)
        )

    def described(self) -> str:
        """For the documentation."""
        if self.of == "nominal":
            return f"the nominal one +- {100.0 * self.share:g} %"
        if self.of == "weakest":
            return f"{100.0 * self.share:g} % of the weakest joint's largest torque"
        return f"0 +- {100.0 * self.share:g} % of the joint's largest torque"


def largest_torque(model: RobotModel, name: str, transmission: float = 1.0) -> float:
    """Torque that a joint's motor can probably make, at its shaft [N m].

    The URDF's limit of effort, and at least what holds everything behind the joint stretched out; the transmission is that of
    `DriveTrain`.

    Args:
        model: The description.
        name: Of the joint.
        transmission: How far the joint moves per rad of the motor [1 or m].
    """
    joint = model.joint(name)
    slides = joint.kind == "prismatic"
    behind: dict[str, float] = {joint.child: 0.0}  # link: how far from the axis at most [m]
    for other in model.joints:
        if other.parent in behind and other is not joint:
            behind[other.child] = behind[other.parent] + math.dist(
                other.origin[:3, 3], (0.0, 0.0, 0.0)
            )
    load = 0.0
    for link in model.links:
        if link.name in behind:
            first_moment = math.dist(
                link.pseudo_inertia[:3, 3],
                (0.0, 0.0, 0.0),
            )
            mass = float(link.pseudo_inertia[3, 3])
            load += 9.81 * (mass if slides else mass * behind[link.name] + first_moment)
    limit = joint.effort_limit
    largest = max(limit, load) if 0.0 < limit < math.inf else 2.0 * load
    return min(transmission * largest, LARGEST_TORQUE) or 1.0
