"""What the virtual hand holds for this probe: a cylinder with a liquid in it, a damped pendulum in MuJoCo."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from proprio_ros.errors import ConfigurationError
from proprio_ros.virtual.objects import (
    LONGEST_M,
    HandObject,
    Payload,
    SixOfInertia,
    Vector,
    check_lengths,
    check_mass,
    set_inertia,
)

WATER_KG_M3 = 1000.0
DAMPING_RATIO = 0.02


@dataclass(frozen=True)
class Filled(HandObject):
    """An upright cylinder, rigid in the hand, with a liquid like water whose surface can swing.

    Raises `ConfigurationError`: A number is no mass or length, or the liquid does not fit.
    """

    kind = "filled"
    form = "filled:0.05,liquid=0.15,radius=0.035,height=0.1,bottom=[0.015,0,-0.04]"
    keys: ClassVar[Mapping[str, tuple[str, int]]] = {
        "mass": ("mass_kg", 1),
        "liquid": ("liquid_kg", 1),
        "radius": ("radius_m", 1),
        "height": ("height_m", 1),
        "bottom": ("bottom_m", 3),
    }

    mass_kg: float = 0.05  # of the empty cylinder
    liquid_kg: float = 0.15
    radius_m: float = 0.035  # radius_m, height_m: of its inside
    height_m: float = 0.1
    # middle of its inside bottom in the payload frame, shape (3,)
    bottom_m: Vector = (0.015, 0.0, -0.04)

    def __post_init__(self) -> None:
        check_mass("mass", self.mass_kg)
        check_mass("liquid", self.liquid_kg)
        check_lengths("radius", (self.radius_m,), 0.005)
        check_lengths("height", (self.height_m,), 0.005)
        check_lengths("bottom", self.bottom_m, -LONGEST_M)
        if self.fill_m > self.height_m:
            full = 1e3 * self.height_m * self.liquid_kg / self.fill_m
            raise ConfigurationError(
                f"liquid={self.liquid_kg:g}: the cylinder is full with {full:.0f} g; give less, in kg"
            )

    @property
    def fill_m(self) -> float:
        """How high the liquid stands."""
        return float(self.liquid_kg / (WATER_KG_M3 * 3.141592653589793 * self.radius_m**2))

    @property
    def emptied(self) -> Payload:
        """The cylinder with nothing in it."""
        x, y, z = self.bottom_m
        return Payload(
            self.mass_kg,
            (x, y, z + 0.5 * self.height_m),
            inertia_kg_m2=self._solid(self.mass_kg, self.height_m, 2.0),
        )

    def _solid(self, mass: float, tall: float, hollow: float = 1.0) -> SixOfInertia:
        across = mass * (hollow * self.radius_m**2 / 4.0 + tall**2 / 12.0)
        return (
            across,
            across,
            mass * hollow * self.radius_m**2 / 2.0,
            0.0,
            0.0,
            0.0,
        )

    def build(self, mujoco: Any, spec: Any, hand: Any) -> None:
        """Add shell, resting and moving part of the liquid to the model of an arm that is not compiled yet.

        Args:
            mujoco: MuJoCo's module.
            spec: Not used.
            hand: The model's body of the payload frame.
        """
        import numpy as np

        from proprio_ros.addons.contents.models import Slosh
        from proprio_ros.addons.contents.slosh_kernels import GRAVITY

        slosh = Slosh.of(self.radius_m, np.array(self.fill_m))
        moving = float(slosh.share) * self.liquid_kg
        rest = self.liquid_kg - moving
        low = (0.5 * self.fill_m * self.liquid_kg - moving * float(slosh.height)) / rest
        shell = self.emptied
        cup = hand.add_body(name="held/cylinder", pos=shell.com_m)
        set_inertia(cup, self.mass_kg, (0.0, 0.0, 0.0), shell.inertia)
        lower = hand.add_body(
            name="held/still",
            pos=np.add(self.bottom_m, (0.0, 0.0, low)),
        )
        set_inertia(
            lower,
            rest,
            (0.0, 0.0, 0.0),
            self._solid(rest, self.fill_m),
        )
        long = GRAVITY / float(slosh.stiffness)  # a pendulum's that swings as often
        upper = hand.add_body(
            name="held/moving",
            pos=np.add(
                self.bottom_m,
                (0.0, 0.0, float(slosh.height)),
            ),
        )
        small = 0.01 * moving * long**2
        set_inertia(
            upper,
            moving,
            (0.0, 0.0, 0.0),
            (small, small, small, 0.0, 0.0, 0.0),
        )
        joint = upper.add_joint(
            name="held/slosh", type=mujoco.mjtJoint.mjJNT_BALL, pos=(0.0, 0.0, long)
        )
        frequency = float(np.sqrt(slosh.stiffness))  # [rad/s]
        joint.damping[0] = 2.0 * DAMPING_RATIO * moving * frequency * long**2
