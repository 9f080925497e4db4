"""What is read beside a push of one joint."""

from __future__ import annotations

from conformance.table import VERDICTS, Row

_SECTION = "G. Beside a push"

ROWS = (
    Row(
        name="push_as_it_is",
        section=_SECTION,
        trouble="nothing is wrong",
        base="push_light_ball_20g_joint3",
        verdicts=VERDICTS[:2],
    ),
)
