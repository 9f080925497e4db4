"""What a virtual hand can hold: what every object has, and the rigid payload that each arm is calibrated with.

What else there is, the probes bring, each with the form in which a user types it.
"""

from __future__ import annotations

import json
import math
import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar

from proprio_ros.errors import ConfigurationError, one_line

if TYPE_CHECKING:
    from proprio_ros.records import FloatArray
    from proprio_ros.virtual.arm import VirtualArm

Vector = tuple[float, float, float]
SixOfInertia = tuple[float, float, float, float, float, float]  # xx, yy, zz, xy, xz, yz [kg m^2]

HEAVIEST_KG = 5.0  # an arm on a desk holds less; a larger number was meant in grams
LONGEST_M = 1.0  # a larger number was meant in millimetres


class HandObject(ABC):
    """What a virtual hand can hold; its fields are what a user can say of it."""

    kind: ClassVar[str]  # before the colon, where a user types it
    form: ClassVar[str]  # an example of what he types
    # key -> field, how many numbers; the first stands behind the colon
    keys: ClassVar[Mapping[str, tuple[str, int]]]
    acts: ClassVar[bool] = False  # whether it pushes joints by itself: then there is `act`

    @property
    @abstractmethod
    def emptied(self) -> HandObject | None:
        """What is left in the hand once its content, which a probe looks for, is taken out."""

    def check(self, arm: VirtualArm) -> None:
        """Raises: ConfigurationError: The arm cannot hold it."""
        return

    def build(self, mujoco: Any, spec: Any, hand: Any) -> Any:
        """Add it to the model of an arm that is not compiled yet.

        Args:
            mujoco: MuJoCo's module.
            spec: The model.
            hand: The model's body of the payload frame.
        """
        return

    def begin(self, arm: VirtualArm) -> None:
        """Put to rest what moves in it: it was put into the hand, or the arm was placed elsewhere."""
        return

    def act(self, arm: VirtualArm, force: FloatArray) -> None:
        """Add what it does at this instant to the force of each degree of freedom in MuJoCo's order [N m or N], shape (V,)."""
        return


@dataclass(frozen=True)
class Payload(HandObject):
    """A rigid body in the hand. Raises `ConfigurationError`: A number is no mass or length."""

    kind = "payload"
    form = "payload:0.05,size=0.03,com=[0.01,0,0]"
    keys = MappingProxyType(
        {
            "mass": ("mass_kg", 1),
            "size": ("size_m", 1),
            "com": ("com_m", 3),
            "inertia": ("inertia_kg_m2", 6),
        }
    )

    mass_kg: float
    com_m: Vector = (0.0, 0.0, 0.0)  # centre of mass in the payload frame
    size_m: float = 0.04  # diameter of a solid ball, which gives its inertia; 0 is a point
    inertia_kg_m2: SixOfInertia | None = None  # about the centre of mass; replaces that of the ball

    def __post_init__(self) -> None:
        check_mass("mass", self.mass_kg)
        check_lengths("com", self.com_m, -LONGEST_M)
        check_lengths("size", (self.size_m,), 0.0)

    @property
    def inertia(self) -> SixOfInertia:
        """xx, yy, zz, xy, xz, yz about the centre of mass [kg m^2]."""
        if self.inertia_kg_m2 is not None:
            return self.inertia_kg_m2
        ball = 0.1 * self.mass_kg * self.size_m**2
        return (ball, ball, ball, 0.0, 0.0, 0.0)

    @property
    def emptied(self) -> Payload:
        """A payload has no content."""
        return self

    def build(self, mujoco: Any, spec: Any, hand: Any) -> Any:
        """Add it to the model ``spec``, by the module ``mujoco``, in the body ``hand``; returns its own body."""
        body = hand.add_body(name="held/payload")
        set_inertia(body, self.mass_kg, self.com_m, self.inertia)
        return body


def parse_object(text: str, kinds: Iterable[type[HandObject]]) -> HandObject | None:
    """What a user types for an object: ``0.05``, the mass of a payload, or the `form` of a kind; None is an empty hand.

    Raises `ConfigurationError`: It is none of their forms.
    """
    there = {Payload.kind: Payload} | {kind.kind: kind for kind in kinds}
    words = text.strip()
    if words.lower() in ("", "none"):
        return None
    name, colon, rest = (part.strip() for part in words.partition(":"))
    if not colon:
        name = Payload.kind
        rest = words
    try:
        if name not in there:
            raise ConfigurationError(f"unknown kind {name!r}")
        make = there[name]
        # a comma inside brackets does not separate
        first, *others = re.split(r",(?![^\[]*\])", rest)
        fields: dict[str, Any] = {}
        for key, value in [(next(iter(make.keys)), first), *(_pair(other) for other in others)]:
            if key not in make.keys:
                raise ConfigurationError(
                    f"unknown key {key!r}, valid keys: {', '.join(list(make.keys)[1:])}"
                )
            field, count = make.keys[key]
            if field in fields:
                raise ConfigurationError(f"{key} is given twice")
            fields[field] = _numbers(key, value, count)
        return make(**fields)
    except ConfigurationError as error:
        forms = " | ".join(["none | 0.05", *(kind.form for kind in there.values())])
        raise ConfigurationError(
            f"object {one_line(text, 40)!r}: {error}; valid: {forms} (kg, m, Pa)"
        ) from error


def _pair(text: str) -> tuple[str, str]:
    key, equals, value = text.partition("=")
    if not equals:
        raise ConfigurationError(f"{text.strip()!r} is no key=value")
    return key.strip(), value


def _numbers(
    key: str,
    text: str,
    count: int,
) -> float | tuple[float, ...]:
    """One number, or a bracketed list of several."""
    try:
        parsed = json.loads(text)
        values = tuple(float(value) for value in (parsed if count > 1 else [parsed]))
    except (ValueError, TypeError, OverflowError):
        values = ()
    if len(values) != count or not all(map(math.isfinite, values)):
        form = "a number" if count == 1 else f"{count} numbers in brackets"
        raise ConfigurationError(f"{key}={one_line(text.strip(), 40)} must be {form}")
    return values[0] if count == 1 else values


def check_mass(what: str, mass_kg: float) -> None:
    """Raises: ConfigurationError: It is none in kg."""
    if not 0.0 < mass_kg <= HEAVIEST_KG:
        raise ConfigurationError(
            f"{what}={mass_kg:g}: masses are in kg, above 0 and at most {HEAVIEST_KG:g}"
        )


def check_lengths(what: str, lengths_m: tuple[float, ...], least_m: float) -> None:
    """Look at lengths that a user stated.

    Args:
        what: They are, in words.
        lengths_m: The lengths [m].
        least_m: The smallest that is allowed [m].

    Raises:
        ConfigurationError: One of them is none in metres, or less than the least.
    """
    if not all(least_m <= length <= LONGEST_M for length in lengths_m):
        shown = ", ".join(f"{length:g}" for length in lengths_m)
        raise ConfigurationError(
            f"{what}={shown}: lengths are in m, from {least_m:g} to {LONGEST_M:g}"
        )


def set_inertia(body: Any, mass_kg: float, com_m: Any, inertia: SixOfInertia) -> None:
    """Give a body of MuJoCo its inertia.

    Args:
        body: The body.
        mass_kg: Its mass [kg].
        com_m: Its centre of mass in its frame, shape (3,) [m].
        inertia: About the centre of mass: xx, yy, zz, xy, xz, yz [kg m^2].
    """
    body.explicitinertial = True
    body.mass = mass_kg
    body.ipos = com_m
    # a flat body is the edge of what is physical, and rounding must not push it over; a point has no inertia at all
    least = 1e-9 * sum(inertia[:3]) + 1e-12
    body.fullinertia = (*(axis + least for axis in inertia[:3]), *inertia[3:])
