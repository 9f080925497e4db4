"""A number, how well it is known, and how it is shown."""

from __future__ import annotations

import math
from dataclasses import dataclass

from proprio_ros.errors import RobotError
from proprio_ros.units import Unit, shown_as

Z95 = 1.959963984540054  # Half width of a 95 % interval in standard deviations (normal).


def shown_unit(unit: str) -> tuple[float, str]:
    """Factor and name of the unit in which a value is shown."""
    shown = shown_as(unit)
    return shown.per_si, shown.name


def written(value: float, spec: str) -> str:
    """A number in some format; what is written as zero has no sign."""
    text = f"{value:{spec}}"
    return text.replace("-", "") if text.startswith("-") and not text.strip("-0.") else text


def shown(unit: str, *values: float, spec: str = "", between: str = " .. ") -> str:
    """Values in an SI unit as a reader wants them, such as ``50.00 g`` or ``48.10 .. 51.90 g``; ``spec`` is the format of each."""
    reader = shown_as(unit)
    numbers = [written(reader.per_si * value, spec or reader.digits) for value in values]
    return f"{between.join(numbers)} {reader.name}".rstrip()


def spec_for(unit: str, std: float | None, kept: bool = False) -> str:
    """How to format a value so that its 95 % half width has two digits: what follows them is noise.

    ``std`` is in the value's SI unit; without one the unit's own digits are taken. ``kept``: the value is shown in that unit.
    """
    reader = Unit(unit, unit, digits=".6g") if kept else shown_as(unit)
    half = 0.0 if std is None else Z95 * std * reader.per_si
    if not 0.0 < half < math.inf:
        return reader.digits
    most = 12 if kept else 4
    digits = min(max(1 - math.floor(math.log10(half)), 0), most)
    return f".{digits}f"


@dataclass(frozen=True)
class Sought:
    """What is to be known so well: its name as in keys, unit, label, and whether its interval is stated as a share of it."""

    name: str
    unit: str
    share: bool = False
    label: str = "mass"

    def half_of(self, std: float, value: float) -> float:
        """Half of its 95 % interval, as that is stated."""
        return Z95 * std / (value if self.share else 1.0)

    def std_of(self, half: float, value: float) -> float:
        """The standard deviation that belongs to half an interval as it is stated."""
        return half * (value if self.share else 1.0) / Z95

    def said(self, half: float, after: str = "") -> str:
        """Half an interval in words, such as ``+-0.50 g``; `after`: what stands behind the sign."""
        return f"+-{after}" + (
            f"{100.0 * half:.1f} %" if self.share else shown(self.unit, half, spec=".2f")
        )


@dataclass(frozen=True)
class Quantity:
    """A number and its standard deviation; 0 means known exactly.

    Raises `RobotError`: A number is not finite, or the standard deviation is negative.
    """

    value: float
    std: float = 0.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.value) and math.isfinite(self.std)):
            raise RobotError(f"value and std must be finite, got {self.value} and {self.std}")
        if self.std < 0.0:
            raise RobotError(f"std must not be negative, got {self.std}")
