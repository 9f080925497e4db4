"""Which motors an arm has, as they say it themselves: a calibration is of one arm, and not of all that are called alike.

Servos have no serial number. What they keep without power is compared instead: two arms whose servos were set alike look alike.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

from proprio_ros.inputs.forms import FormError, Whole, shortly

_LONGEST = 1000  # characters of one motor
_FORM = Whole(
    "as in its register",
    lowest=-(2**31),
    highest=2**32 - 1,
)


@dataclass(frozen=True)
class MotorIdentity:
    """What a servo keeps without power."""

    model: int  # its Model Number
    id: int  # on the bus
    firmware: int  # its version; all else is the same after an update
    homing_offset: int  # [counts]; it shifts every position
    drive_mode: int  # bits; one turns the direction
    moving_threshold: int  # [counts]; drives nothing here, so it can be used to mark a servo

    as_settings = asdict

    def as_text(self) -> str:
        """As it goes over a topic."""
        return json.dumps(asdict(self))

    @classmethod
    def from_settings(cls, given: Any) -> MotorIdentity:
        """The reverse of ``as_settings``; raises `FormError`."""
        names = [field.name for field in fields(cls)]
        if not isinstance(given, Mapping) or set(given) != set(names):
            raise FormError(f"expected {', '.join(names)}, got {shortly(given)}")
        return cls(**{name: _FORM.read(given[name]) for name in names})

    @classmethod
    def from_text(cls, text: str) -> MotorIdentity | None:
        """The reverse of ``as_text``; None where somebody else wrote it."""
        try:
            return cls.from_settings(json.loads(text)) if len(text) <= _LONGEST else None
        except (ValueError, RecursionError):  # a FormError is a ValueError
            return None


Motors = Mapping[str, MotorIdentity]  # by joint


def other_arm(calibrated: Motors, found: Motors) -> str:
    """How motors differ from those of a calibration, in words; empty where they may be the same."""
    differences = []
    for joint in [name for name in calibrated if name in found]:
        one = asdict(calibrated[joint])
        other = asdict(found[joint])
        differ = [name for name in one if name != "firmware" and one[name] != other[name]]
        differences += [
            f"{joint} has {name.replace('_', ' ')} {other[name]}, not {one[name]}"
            for name in differ
        ]
    return "; ".join(differences[:3])


def other_firmware(calibrated: Motors, found: Motors) -> str:
    """Which motors had their firmware changed since a calibration, in words; empty where none had."""
    return ", ".join(
        f"{joint} {motor.firmware} (was {calibrated[joint].firmware})"
        for joint, motor in found.items()
        if joint in calibrated and motor.firmware != calibrated[joint].firmware
    )
