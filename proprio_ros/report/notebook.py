"""A result in a few lines of HTML, for a notebook's cell: styled by itself, so that nothing of it reaches the rest of the page."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from proprio_ros.identification.estimate import Value, Verdict
from proprio_ros.report.html import bulleted
from proprio_ros.report.page import in_words, interval_in_words, verdict_in_words

COLORS = {"accepted": "#2b7a4b", "rejected": "#b23a48", "not_identifiable": "#96600c", "too_wide": "#96600c"}
UNKNOWN = "#5a6675"
"""As on the page."""


def card(
    title: str, verdict: Verdict, values: Sequence[Value], reasons: Sequence[str], interval_first: bool = False
) -> str:
    """The verdict in its colour, each value with its interval, and the reasons."""
    badge = f"background:{COLORS.get(verdict.value, UNKNOWN)};color:#fff;padding:.1em .7em;border-radius:1em;font-weight:600"
    lines = [f'<div style="{badge};display:inline-block">{escape(verdict_in_words(verdict))}</div> {escape(title)}']
    for value in values:
        lines.append(
            f'<div style="font-size:1.5em;font-weight:600;margin-top:.3em">{escape(in_words(value, interval_first))}</div>'
        )
        lines.append(f"<div>{escape(interval_in_words(value, interval_first))}</div>")
    return "<div>" + "".join([*lines, *bulleted(reasons)]) + "</div>"
