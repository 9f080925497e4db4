"""Charts, bright or dark, all drawn alike."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from nicegui import ui

GREY = "#8a94a3"
COLOURS = ["#2a9cc4", "#e08a2c", "#5fa35a", "#c9605c", "#9380c6", "#b08d57", "#7f8fa6"]
"""Of curves, on bright and dark."""
LINE = {"type": "line", "symbol": "none", "animation": False}


def chart(title: str, across: Mapping[str, Any], series: Sequence[Mapping[str, Any]]) -> ui.echart:
    """One.

    Args:
        title: With the unit of what it shows.
        across: What is special about its time axis.
        series: As the library wants them.
    """
    axis = {"axisLabel": {"color": GREY}, "splitLine": {"lineStyle": {"color": f"{GREY}40"}}}
    shown = ui.echart(
        {
            "color": COLOURS,
            "grid": {"left": 56, "right": 30, "top": 64, "bottom": 26},
            "title": {"text": title, "textStyle": {"color": GREY, "fontSize": 12}},
            "legend": {"top": 30, "type": "scroll", "textStyle": {"color": GREY}},
            "tooltip": {"trigger": "axis"},
            "xAxis": {**axis, "type": "value", **across},
            "yAxis": {**axis, "type": "value", "scale": True},
            "series": series,
        }
    ).classes("curve")
    shown.props(f'role="img" aria-label="{escape(title)}"')
    return shown


def draw(signals: Sequence[Mapping[str, Any]]) -> None:
    """A chart a plot, with a curve a joint."""
    for plot in signals:
        holds = {**LINE, "step": plot.get("step", False)}
        series = [{**holds, "name": name, "data": data} for name, data in plot["curves"].items()]
        chart(plot["title"], plot.get("across", {"name": "s"}), series)
