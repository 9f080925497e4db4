"""What the virtual hand holds for this probe: a box with a sphere in it, in MuJoCo."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from proprio_ros.errors import ConfigurationError
from proprio_ros.virtual import objects

if TYPE_CHECKING:
    from proprio_ros.records import FloatArray
    from proprio_ros.virtual.arm import VirtualArm

CONTAINER = "held/container"
SPHERE = "held/sphere"
CONTACT_SOLREF = (0.002, 1.0)
# walls are this thick to the outside, so that a fast sphere cannot pass them in one step
WALL_M = 0.05
LEVEL = 0.02  # a floor that is tilted less than this holds the sphere in its middle [rad]


@dataclass(frozen=True)
class Container(objects.HandObject):
    """A closed box of six thin walls, rigid in the hand, with a sphere that is free inside.

    Raises `ConfigurationError`: A number is no mass or length, or the sphere does not fit.
    """

    kind = "container"
    form = "container:0.03,sphere=0.012,inner=[0.06,0.04,0.04],radius=0.01"
    keys: ClassVar[Mapping[str, tuple[str, int]]] = {
        "mass": ("mass_kg", 1),
        "sphere": ("sphere_mass_kg", 1),
        "inner": ("inner_size_m", 3),
        "radius": ("sphere_radius_m", 1),
        "centre": ("centre_m", 3),
        "friction": ("friction", 1),
    }

    mass_kg: float = 0.03  # of the walls, spread evenly over them
    # along the axes of the payload frame, shape (3,)
    inner_size_m: objects.Vector = (0.06, 0.04, 0.04)
    centre_m: objects.Vector = (0.035, 0.0, 0.0)  # of the box in the payload frame, shape (3,)
    # sphere_mass_kg, sphere_radius_m: of the sphere, a solid ball
    sphere_mass_kg: float = 0.012
    sphere_radius_m: float = 0.01
    friction: float = 0.4  # sliding friction between sphere and walls; rolling costs nothing

    def __post_init__(self) -> None:
        objects.check_mass("mass", self.mass_kg)
        objects.check_mass("sphere", self.sphere_mass_kg)
        objects.check_lengths("inner", self.inner_size_m, 0.001)
        objects.check_lengths("centre", self.centre_m, -objects.LONGEST_M)
        objects.check_lengths("radius", (self.sphere_radius_m,), 0.001)
        if 2.0 * self.sphere_radius_m >= min(self.inner_size_m):
            raise ConfigurationError(
                f"radius={self.sphere_radius_m:g}: the sphere does not fit into inner={list(self.inner_size_m)}; "
                "make it smaller than half the shortest side"
            )
        if not 0.0 <= self.friction <= 10.0:
            raise ConfigurationError(
                f"friction={self.friction:g}: give a coefficient of friction, e.g. 0.4"
            )

    @property
    def inertia(self) -> objects.SixOfInertia:
        """Of the walls about the box's centre: xx, yy, zz, xy, xz, yz [kg m^2]."""
        side = self.inner_size_m
        # of the walls across x, y and z
        areas = (side[1] * side[2], side[0] * side[2], side[0] * side[1])
        # along an axis the two walls across it lie at its ends, the other four are spread over it
        x, y, z = (
            self.mass_kg
            * side[i] ** 2
            * (areas[i] / 4.0 + (sum(areas) - areas[i]) / 12.0)
            / sum(areas)
            for i in range(3)
        )
        return (y + z, x + z, x + y, 0.0, 0.0, 0.0)

    @property
    def emptied(self) -> objects.Payload:
        """The container with its sphere taken out."""
        return objects.Payload(self.mass_kg, self.centre_m, inertia_kg_m2=self.inertia)

    def build(self, mujoco: Any, spec: Any, hand: Any) -> None:
        """Put the container and its sphere into a model.

        Args:
            mujoco: The module.
            spec: To which it is added.
            hand: That holds it.
        """
        import numpy as np

        box = hand.add_body(name=CONTAINER, pos=self.centre_m)
        objects.set_inertia(box, self.mass_kg, (0.0, 0.0, 0.0), self.inertia)
        half = 0.5 * np.array(self.inner_size_m)
        touching = {
            "condim": 3,
            "friction": (self.friction, 0.0, 0.0),
            "solref": CONTACT_SOLREF,
            "mass": 0.0,
        }
        for axis in range(3):
            for side in (-1.0, 1.0):
                centre = np.zeros(3)
                size = half + WALL_M
                size[axis], centre[axis] = 0.5 * WALL_M, side * (half[axis] + 0.5 * WALL_M)
                # walls meet the sphere, and nothing else anything
                box.add_geom(
                    type=mujoco.mjtGeom.mjGEOM_BOX,
                    size=size,
                    pos=centre,
                    contype=1,
                    conaffinity=0,
                    **touching,
                )
        ball = spec.worldbody.add_body(name=SPHERE)
        ball.add_freejoint(name=SPHERE)
        inertia = 0.4 * self.sphere_mass_kg * self.sphere_radius_m**2
        objects.set_inertia(
            ball, self.sphere_mass_kg, (0.0, 0.0, 0.0), (inertia, inertia, inertia, 0.0, 0.0, 0.0)
        )
        kind = mujoco.mjtGeom.mjGEOM_SPHERE
        radius = (self.sphere_radius_m, 0.0, 0.0)
        ball.add_geom(
            type=kind,
            size=radius,
            contype=0,
            conaffinity=1,
            **touching,
        )

    def begin(self, arm: VirtualArm) -> None:
        """The sphere rests at the container's lowest place."""
        import numpy as np

        gravity = arm.robot.gravity
        arm.mujoco.mj_forward(arm.model, arm.data)
        axes = arm.data.body(CONTAINER).xmat.reshape(3, 3)
        down = axes.T @ gravity / max(float(np.linalg.norm(gravity)), 1e-9)
        room = 0.5 * np.array(self.inner_size_m) - self.sphere_radius_m
        self.put_sphere(
            arm,
            np.where(np.abs(down) > LEVEL, np.sign(down), 0.0) * room,
        )

    def put_sphere(self, arm: VirtualArm, inside_m: FloatArray) -> None:
        """Put the sphere elsewhere in its container, moving with it: its centre from the container's [m], shape (3,)."""
        import numpy as np

        box = arm.data.body(CONTAINER)
        ball = arm.data.joint(SPHERE)
        arm.mujoco.mj_forward(arm.model, arm.data)
        offset = box.xmat.reshape(3, 3) @ inside_m
        speed = np.zeros(6)  # angular, then linear, in the base frame
        kind = arm.mujoco.mjtObj.mjOBJ_XBODY
        arm.mujoco.mj_objectVelocity(
            arm.model,
            arm.data,
            kind,
            box.id,
            speed,
            0,
        )
        ball.qpos[:] = (*(box.xpos + offset), 1.0, 0.0, 0.0, 0.0)
        ball.qvel[:] = (*(speed[3:] + np.cross(speed[:3], offset)), 0.0, 0.0, 0.0)

    def sphere_m(self, arm: VirtualArm) -> FloatArray:
        """Where the sphere's centre is in the container of an arm that holds it, from the container's centre [m], shape (3,)."""
        arm.mujoco.mj_kinematics(arm.model, arm.data)
        box = arm.data.body(CONTAINER)
        ball = arm.data.body(SPHERE)
        inside: FloatArray = box.xmat.reshape(3, 3).T @ (ball.xpos - box.xpos)
        return inside
