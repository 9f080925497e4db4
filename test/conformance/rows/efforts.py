"""Efforts that are not what they seem."""

from __future__ import annotations

from conformance.table import ACCEPTED, Bent, Row

_SECTION = "B. Effort that is not what it seems"

ROWS = (
    Row(
        name="tared",
        section=_SECTION,
        trouble="the sensors were tared with the tool on",
        base="ur10e",
        bends=(Bent("effort_tared"),),
        verdicts=(ACCEPTED,),
        narrow=0.25,
    ),
)
