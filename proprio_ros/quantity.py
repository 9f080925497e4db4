"""A number, its unit, how well it is known, and how it is shown."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

from proprio_ros.errors import RobotError

_MARKS = re.compile(r"[\s.*·⋅_-]")
Z95 = 1.959963984540054  # Half width of a 95 % interval in standard deviations (normal).
# Standard deviation of a normal distribution over its median absolute deviation.
MAD_TO_STD = 1.4826


@dataclass(frozen=True)
class Unit:
    """A unit of some quantity."""

    name: str  # as a reader is shown it
    si: str  # name of its SI unit, as values in files and JSON have it
    in_si: float = 1.0  # how much of that one of it is
    digits: str = ""  # how a reader is shown a number of it
    called: tuple[str, ...] = ()  # what options, driver profiles and data sets call it
    # how else people write it, in small letters and without marks between words (see `unit_called`)
    also: tuple[str, ...] = ()
    # a driver's numbers that are so many times off at most may be of it, where nobody says what they are
    within: float = 4.0

    @property
    def per_si(self) -> float:
        """How many of it make one of its SI unit."""
        return 1.0 / self.in_si


_SHOWN: Mapping[str, Unit] = {
    unit.si: unit
    for unit in (
        Unit("g", "kg", 1e-3, ".2f"),
        Unit("kPa", "Pa", 1e3, ".2f"),
        Unit("N/m", "N/m", digits=".0f"),
        Unit("", "1", digits=".3f"),
        Unit("mrad", "rad", 1e-3, ".3f"),
        Unit("mm", "m", 1e-3, ".1f"),
        Unit("ms", "s", 1e-3, ".2f"),
        Unit("mN m", "N m", 1e-3, ".2f"),
        Unit("mrad/s", "rad/s", 1e-3, ".1f"),
        Unit("mA", "A", 1e-3, ".0f"),
    )
}
"""By SI unit the one in which a reader wants a number."""


def shown_as(si: str) -> Unit:
    """The unit in which a reader wants a number of an SI unit: that itself where no other is known."""
    return _SHOWN.get(si) or Unit(si, si, digits=".5f")


def _called(*units: Unit) -> dict[str, Unit]:
    return {name: unit for unit in units for name in unit.called}


POSITIONS: Mapping[str, Unit] = _called(
    Unit("rad", "rad", called=("rad",), also=("radian", "radians")),
    Unit(
        "degree",
        "rad",
        math.pi / 180.0,
        called=("degree", "deg"),
        also=("deg", "degree", "degrees", "°"),
    ),
)
"""What a driver's positions may be in, by what it is called."""

NEAR_OTHERS = 1.5
"""Per mille of a motor's rating lie near mA and raw counts."""
COUNT = Unit("count", "A", 2.69e-3, called=("raw",), also=("count", "counts"), within=NEAR_OTHERS)
"""A count of Present Current of the XM430-W350 (ROBOTIS e-manual, control table, register 126); of other motors it differs."""

_NEWTON_METRE = (
    *("newtonmetre", "newtonmetres", "newtonmeter", "newtonmeters"),
    *("n", "newton", "newtons"),  # of a joint that slides
)
_MILLIAMPERE = ("milliamp", "milliamps", "milliampere", "milliamperes")

EFFORTS: Mapping[str, Unit] = _called(
    Unit("N m", "N m", called=("N.m",), also=_NEWTON_METRE),
    Unit("A", "A", called=("A",), also=("amp", "amps", "ampere", "amperes")),
    Unit("mA", "A", 1e-3, called=("mA",), also=_MILLIAMPERE, within=NEAR_OTHERS),
    COUNT,
)
"""What `effort` of a foreign bag may mean; the message definition says N m (N for a slide), many drivers differ."""


def unit_called(text: str, units: Mapping[str, Unit]) -> str:
    """The name by which a unit is known here, of how people write it: ``N*m``, ``Nm`` and ``Newton-metre`` are ``N.m``.

    Args:
        text: As it was written.
        units: That may be meant, by their names.

    Returns:
        Its name; the text as it is where none is meant.
    """
    if text in units:
        return text
    plain = _MARKS.sub("", text).lower()
    names = [
        name
        for name, unit in units.items()
        if plain == _MARKS.sub("", name).lower() or plain in unit.also
    ]
    return names[0] if names else text


def shown_unit(unit: str) -> tuple[float, str]:
    """Factor and name of the unit in which a value is shown."""
    shown = shown_as(unit)
    return shown.per_si, shown.name


def written(value: float, spec: str) -> str:
    """A number in some format; what is written as zero has no sign."""
    text = f"{value:{spec}}"
    return text.replace("-", "") if text.startswith("-") and not text.strip("-0.") else text


def shown(unit: str, *values: float, spec: str = "", between: str = " .. ") -> str:
    """Values in an SI unit as a reader wants them.

    Args:
        unit: The SI unit.
        *values: In that unit.
        spec: Format of each number; empty: that of the reader's unit.
        between: What stands between two numbers.

    Returns:
        Numbers and the reader's unit, such as ``50.00 g`` or ``48.10 .. 51.90 g``.
    """
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
