"""Kinds of unknowns: what a fit may look for, its unit, what it belongs to, and how people call it.

An unknown has a kind and a scope: the joint, link or run it belongs to, or nothing. Its name, such as ``coulomb[joint3]``, is
made of both; files, messages and ``--json`` carry names, everything inside looks an unknown up by its key.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from proprio_ros.errors import ConfigurationError

Scope = str | int | None  # A joint, a link, the number of a run, or nothing.
Key = str | tuple[str, str | int]  # A kind that has no scope, or a kind and its scope.


class Kind(NamedTuple):
    """SI unit of all unknowns of a kind, their label for people, and what their scope is: ``joint``, ``link``, ``run`` or none."""

    unit: str
    label: str
    of: str = ""


KINDS: dict[str, Kind] = {
    # drive trains, by the names of their fields, and encoders (they err once per turn of the joint)
    "torque_constant": Kind("N m/A", "torque constant", "joint"),
    "coulomb": Kind("N m", "Coulomb friction", "joint"),
    "viscous": Kind("N m s/rad", "viscous friction", "joint"),
    "load_friction": Kind("1", "load friction", "joint"),
    "armature": Kind("kg m^2", "armature", "joint"),
    "stribeck": Kind("1", "rise at standstill", "joint"),
    "stribeck_velocity": Kind("rad/s", "velocity of that rise", "joint"),
    "zero": Kind("rad", "zero", "joint"),
    "ripple_cos": Kind("rad", "encoder error, cosine", "joint"),
    "ripple_sin": Kind("rad", "encoder error, sine", "joint"),
    # how a link differs from the URDF; mass and inertia relative
    "link_mass": Kind("1", "link mass beyond the URDF's", "link"),
    **{
        f"link_com_{axis}": Kind("m", f"link centre beyond the URDF's, {axis}", "link")
        for axis in "xyz"
    },
    "link_inertia": Kind("1", "link inertia beyond the URDF's", "link"),
    # the body behind a joint, up to the next one, and the torque that a joint's motor shows at rest; of motions of several joints
    "body_mass": Kind("kg", "mass of the body behind", "joint"),
    **{
        f"body_moment_{axis}": Kind("kg m", f"first moment of the body behind, {axis}", "joint")
        for axis in "xyz"
    },
    **{
        f"body_inertia_{axes}": Kind("kg m^2", f"inertia of the body behind, {axes}", "joint")
        for axes in ("xx", "xy", "xz", "yy", "yz", "zz")
    },
    "offset": Kind("N m", "torque offset", "joint"),
    "torque_share": Kind("1", "torque beyond what its constant says", "joint"),
    **{
        f"coulomb_{wave}": Kind(
            "N m", f"Coulomb friction by angle, {wave.replace('_', ' ')}", "joint"
        )
        for wave in ("sine", "cosine", "sine_twice", "cosine_twice")
    },
    # the robot as a whole
    "arm_scale": Kind("1", "arm's weight over the URDF's"),
    "delay": Kind("s", "delay"),
    # runs
    "q0": Kind("rad", "start position", "run"),
    "v0": Kind("rad/s", "start velocity", "run"),
    "onset": Kind("s", "delay that differs from run to run", "run"),
    "disturbance": Kind("N m", "torque that differs from run to run", "run"),
    "moment_change": Kind("1", "weight over inertia that differs from swing to swing", "run"),
    "swing_zero": Kind("rad", "joint's zero in a swing", "run"),
    "friction_change": Kind("1", "friction that differs from swing to swing", "run"),
    # a rigid load in the hand, which references are, too
    "payload_mass": Kind("kg", "payload mass"),
    "payload_com": Kind("m", "centre of mass of the payload"),
    **{
        f"payload_com_{axis}": Kind("m", f"centre of mass of the payload, {axis}") for axis in "xyz"
    },
    "shape_scale": Kind("1", "payload's spread over its shape's"),
}
"""Unit and label of every kind; whoever fits something else adds it, as each probe does."""


def add_kinds(kinds: Mapping[str, Kind]) -> None:
    """Let unknowns of these kinds be named; once more the same changes nothing.

    Raises `ConfigurationError`: One of that name means something else.
    """
    for name, kind in kinds.items():
        if KINDS.setdefault(name, kind) != kind:
            raise ConfigurationError(
                f"unknown {name}: there is one of that name already, {KINDS[name].label}"
            )


def key_of(name: str) -> Key:
    """The key of a name: the only place where names are taken apart."""
    kind, bracket, rest = name.partition("[")
    if not bracket:
        return name
    scope = rest.removesuffix("]")
    return kind, int(scope) if kind in KINDS and KINDS[kind].of == "run" else scope


def name_of(key: Key) -> str:
    """E.g. ``payload_mass``, ``coulomb[joint3]``, ``q0[0]`` (run 0)."""
    return key if isinstance(key, str) else f"{key[0]}[{key[1]}]"


def label_of(key: Key) -> str:
    """For people: ``Coulomb friction, joint3``; runs are counted from 1."""
    kind, scope = (key, None) if isinstance(key, str) else key
    label = KINDS[kind].label if kind in KINDS else kind.replace("_", " ")
    if scope is None:
        return label
    return f"{label}, run {scope + 1}" if isinstance(scope, int) else f"{label}, {scope}"


@dataclass(frozen=True)
class Tag:
    """What distinguishes an unknown from others: one of ``KINDS``, and what it belongs to."""

    kind: str
    scope: Scope = field(default=None, kw_only=True)

    @property
    def key(self) -> Key:
        """Of tables of unknowns."""
        return self.kind if self.scope is None else (self.kind, self.scope)

    @property
    def name(self) -> str:
        return name_of(self.key)

    @property
    def label(self) -> str:
        return label_of(self.key)

    @property
    def unit(self) -> str:
        return KINDS[self.kind].unit

    @property
    def is_detail(self) -> bool:
        """Whether there are many of it, and few readers want them: how links differ from the URDF, and errors of encoders."""
        return KINDS[self.kind].of == "link" or self.kind.startswith(("ripple_", "body_"))

    @property
    def shared(self) -> bool:
        """Whether it is the robot's or the object's, not a run's."""
        return KINDS[self.kind].of != "run"
