"""Units: how much of its SI unit each one is, and what readers, files and drivers call it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Unit:
    """A unit of some quantity."""

    name: str  # as a reader is shown it
    si: str  # name of its SI unit, as values in files and JSON have it
    in_si: float = 1.0  # how much of that one of it is
    digits: str = ""  # how a reader is shown a number of it
    called: tuple[str, ...] = ()  # what options, driver profiles and data sets call it

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
    Unit("rad", "rad", called=("rad",)),
    Unit("degree", "rad", math.pi / 180.0, called=("degree", "deg")),
)
"""What a driver's positions may be in, by what it is called."""

COUNT = Unit("count", "A", 2.69e-3, called=("raw",))
"""A count of Present Current of the XM430-W350 (ROBOTIS e-manual, control table, register 126); of other motors it differs."""

EFFORTS: Mapping[str, Unit] = _called(
    Unit("N m", "N m", called=("N.m",)),
    Unit("A", "A", called=("A",)),
    Unit("mA", "A", 1e-3, called=("mA",)),
    COUNT,
)
"""What `effort` of a foreign bag may mean; the message definition says N m (N for a slide), many drivers differ."""
