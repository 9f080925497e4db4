"""What the virtual hand holds for this probe: an elastic block between the fingers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from proprio_ros.errors import ConfigurationError
from proprio_ros.virtual.objects import HandObject, Vector, check_lengths

if TYPE_CHECKING:
    from proprio_ros.records import FloatArray
    from proprio_ros.virtual.arm import VirtualArm

# a block is as stiff as one that is squeezed to this share of its length, however much further
FLATTEST = 0.02
# how fast a block is let go where all of its loss is there
TURNS_M_S = 2e-4


@dataclass(frozen=True)
class SoftBlock(HandObject):
    """A weightless elastic block between the fingers: its pressed faces slip, the others are free.

    Both sides are pressed with ``A P + damping rate``, less the share ``loss`` of ``A P`` while it is let go, where
    ``A`` is the pressed face and ``P`` what a compressible
    neo-Hookean solid (J. Bonet and R. D. Wood, Nonlinear Continuum Mechanics, section 6.4.3; equation (4) of Chen et al.,
    "Learning Object Properties Using Robot Proprioception via Differentiable Robot-Object Interaction", ICRA 2025,
    arXiv:2410.03920) answers to a uniaxial stretch. It never pulls.

    Raises `ConfigurationError`: A number is negative, or in another unit.
    """

    kind = "block"
    form = "block:12000,size=[0.03,0.03,0.03],gap=0.004,nu=0.25"
    keys: ClassVar[Mapping[str, tuple[str, int]]] = {
        "modulus": ("youngs_modulus_Pa", 1),
        "size": ("size_m", 3),
        "gap": ("gap_m", 1),
        "damping": ("damping", 1),
        "nu": ("poissons_ratio", 1),
        "loss": ("loss", 1),
    }
    acts = True

    youngs_modulus_Pa: float  # E, for small strains
    size_m: Vector = (0.03, 0.03, 0.03)  # along the squeeze, and of the pressed face; shape (3,)
    damping: float = 0.0  # per rate of compression [N s/m]
    # how far each finger closes, from where it was when the block was put between them, until it touches
    gap_m: float = 0.0
    poissons_ratio: float = 0.25  # for small strains
    loss: float = 0.0

    def __post_init__(self) -> None:
        if not 1.0 <= self.youngs_modulus_Pa <= 1e9:
            raise ConfigurationError(
                f"a block of {self.youngs_modulus_Pa:g} Pa is none: Young's modulus is in Pa, foam has 1e3 to 1e5"
            )
        check_lengths("size", self.size_m, 0.001)
        check_lengths("gap", (self.gap_m,), 0.0)
        if not 0.0 <= self.damping < math.inf:
            raise ConfigurationError(
                f"damping={self.damping:g}: give a number that is not negative"
            )
        if not 0.0 <= self.loss < 1.0:
            raise ConfigurationError(
                f"loss={self.loss:g}: what a block loses is from 0 to below 1 of its force"
            )
        if not 0.0 <= self.poissons_ratio < 0.5:
            raise ConfigurationError(
                f"nu={self.poissons_ratio:g}: Poisson's ratio is from 0 to below 0.5"
            )

    @property
    def emptied(self) -> None:
        """The gripper without the block."""
        return None

    def check(self, arm: VirtualArm) -> None:
        if arm.finger is None:
            raise ConfigurationError(
                f"{arm.robot.name} drives no sliding finger that could press a block; hold a payload instead"
            )

    def act(self, arm: VirtualArm, force: FloatArray) -> None:
        """Presses the driven finger, with what those that follow it pass on; positive opens."""
        closed = arm.grip_m - self.gap_m - arm.finger_m()
        rate = -float(arm.data.qvel[arm.finger])
        force[arm.finger] += arm.fingers * self.force_N(arm.fingers * closed, arm.fingers * rate)

    def force_N(self, compression_m: float, rate_m_s: float) -> float:
        """Force on each of the two sides of a block that is by so much shorter than it is free."""
        if compression_m <= 0.0:
            return 0.0
        nu = self.poissons_ratio
        mu = self.youngs_modulus_Pa / (2.0 * (1.0 + nu))
        ratio = 2.0 * nu / (1.0 - 2.0 * nu)  # lambda over mu
        stretch = max(1.0 - compression_m / self.size_m[0], FLATTEST)
        # the free faces carry nothing: x - 1 + ratio log(stretch x) = 0 for the square x of the stretch across. The left side is
        # concave and rising, so Newton's method from below it never overshoots
        square = 1.0
        for _ in range(50):
            step = (square - 1.0 + ratio * math.log(stretch * square)) / (1.0 + ratio / square)
            square -= step
            if abs(step) < 1e-13 * square:
                break
        elastic = self.size_m[1] * self.size_m[2] * mu * (square / stretch - stretch)
        lost = self.loss * 0.5 * (1.0 - math.tanh(rate_m_s / TURNS_M_S))
        return max(elastic * (1.0 - lost) + self.damping * rate_m_s, 0.0)
