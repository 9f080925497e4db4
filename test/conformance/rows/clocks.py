"""The time axis."""

from __future__ import annotations

from conformance.table import ACCEPTED, Row

_SECTION = "A. The time axis"

ROWS = (
    Row(
        name="as_it_is",
        section=_SECTION,
        trouble="nothing is wrong",
        base="ur10e",
        verdicts=(ACCEPTED,),
        narrow=0.25,
    ),
)
