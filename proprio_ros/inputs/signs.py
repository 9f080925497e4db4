"""Which way a measured effort counts, as a driver's profile, a robot file or the command line state it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from proprio_ros.inputs.forms import Form, FormError, Text, shortly
from proprio_ros.inputs.reading import finite

_JOINT = Text(what="the name of a joint")
_WRITTEN = {
    "1": 1.0,
    "+1": 1.0,
    "-1": -1.0,
}


@dataclass(frozen=True)
class Signs:
    """By what the effort of each joint is multiplied: -1 where it is counted against the joint's own direction."""

    # of joints that are not named; None: not stated, so that it counts as it is
    every: int | None = None
    joints: Mapping[str, int] = field(default_factory=dict)

    def of(self, joint: str) -> int:
        """1 or -1."""
        return self.joints.get(joint, self.every or 1)

    def over(self, other: Signs) -> Signs:
        """These, and for joints of which they say nothing the others."""
        if self.every is not None:
            return self
        return Signs(
            other.every,
            {**other.joints, **self.joints},
        )

    def turned(self, joints: Iterable[str]) -> tuple[str, ...]:
        """Those of some joints whose effort is turned round."""
        found = (joint for joint in joints if self.of(joint) < 0)
        return tuple(found)

    def __str__(self) -> str:
        """As the command line takes them."""
        by_joint = [f"{joint}={sign}" for joint, sign in self.joints.items()]
        if self.every is not None:
            by_joint.insert(0, str(self.every))
        return ",".join(by_joint)


@dataclass(frozen=True)
class SignForm(Form):
    """Of all joints, or joint by joint."""

    def read(self, value: Any) -> Signs:
        if isinstance(value, Mapping) and not value:
            raise FormError("names no joint; give 1 or -1, or a joint and its sign")
        if isinstance(value, Mapping):
            joints = {_JOINT.read(joint): _sign(sign) for joint, sign in value.items()}
            return Signs(None, joints)
        if not isinstance(value, str):
            return Signs(_sign(value))
        every = None
        joints = {}
        for part in value.split(","):
            name, equals, sign = part.rpartition("=")
            joint = name.strip()
            if not equals and every is not None:
                raise FormError(
                    f"{shortly(value)} has several signs without a joint; give one, or JOINT=-1 for each"
                )
            if not equals:
                every = _sign(sign)
            elif joint in joints:
                raise FormError(f"{shortly(joint)} is given twice")
            else:
                joints[_JOINT.read(joint)] = _sign(sign)
        return Signs(every, joints)

    def described(self) -> str:
        return "1 or -1 for all joints, or by joint, as {joint_2: -1}"


def _sign(value: Any) -> int:
    stated = value
    if isinstance(value, str):
        stated = _WRITTEN.get(value.strip())
    number = finite(stated)
    if number not in (1, -1):
        raise FormError(f"expected 1 or -1, for all joints or as JOINT=-1, got {shortly(value)}")
    return int(number)


EFFORT_SIGN = SignForm(
    "by what measured efforts are multiplied: -1 where they have the sign of the torque that gravity makes, not of what holds "
    "against it"
)
