"""A number, how well it is known, and how it is shown."""

from __future__ import annotations

import math
from dataclasses import dataclass

from proprio_ros.errors import RobotError

Z95 = 1.959963984540054  # Half width of a 95 % interval in standard deviations (normal).
_SHOWN = {
    "kg": (1e3, "g", ".2f"),
    "Pa": (1e-3, "kPa", ".2f"),
    "N/m": (1.0, "N/m", ".0f"),
    "1": (1.0, "", ".3f"),
    "rad": (1e3, "mrad", ".3f"),
    "m": (1e3, "mm", ".1f"),
    "s": (1e3, "ms", ".2f"),
    "N m": (1e3, "mN m", ".2f"),
    "rad/s": (1e3, "mrad/s", ".1f"),
    "A": (1e3, "mA", ".0f"),
}
"""Per SI unit the factor to the unit in which a reader wants a number, that unit, and the digits."""


def shown_unit(unit: str) -> tuple[float, str]:
    """Factor and name of the unit in which a value is shown."""
    return _SHOWN.get(unit, (1.0, unit, ""))[:2]


def written(value: float, spec: str) -> str:
    """A number in some format; what is written as zero has no sign."""
    text = f"{value:{spec}}"
    return text.replace("-", "") if text.startswith("-") and not text.strip("-0.") else text


def shown(unit: str, *values: float, spec: str = "", between: str = " .. ") -> str:
    """Values in an SI unit as a reader wants them, such as ``50.00 g`` or ``48.10 .. 51.90 g``; ``spec`` is the format of each."""
    factor, name, usual = _SHOWN.get(unit, (1.0, unit, ".5f"))
    return f"{between.join(written(factor * value, spec or usual) for value in values)} {name}".rstrip()


def spec_for(unit: str, std: float | None, kept: bool = False) -> str:
    """How to format a value so that its 95 % half width has two digits: what follows them is noise.

    ``std`` is in the value's SI unit; without one the unit's own digits are taken. ``kept``: the value is shown in that unit.
    """
    factor, _, usual = _SHOWN.get(unit, (1.0, unit, ".5f"))
    factor, usual = (1.0, ".6g") if kept else (factor, usual)
    half = 0.0 if std is None else Z95 * std * factor
    if not 0.0 < half < math.inf:
        return usual
    return f".{min(max(1 - math.floor(math.log10(half)), 0), 12 if kept else 4)}f"


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
