"""The arm, now: where it is, what it holds, how well bus and nodes are."""

from __future__ import annotations

from typing import Any

from nicegui import ui

from proprio_ros.addons.pendant import words
from proprio_ros.addons.pendant.drawing import Drawing
from proprio_ros.addons.pendant.news import CURVE_S, News
from proprio_ros.addons.pendant.pendant import Pendant

MOVES_S = 0.1
READS_S = 0.5
GREY = "#8a94a3"
INK = "#2a9cc4"


def show(pendant: Pendant) -> None:
    """Fill the page."""
    if pendant.no_ros:
        ui.label(f"No arm can be seen: {pendant.no_ros}").classes("card")
        return
    wrong = ui.html().classes("warnings").props('role="alert"')
    with ui.element("div").classes("columns"):
        place = ui.element("section").classes("card").props('aria-label="The arm"')
        with ui.element("section").classes("card").props('aria-label="In the hand"'):
            hand = ui.html().classes("hand")
            curve = _curve()
    with ui.element("div").classes("columns"):
        with ui.element("section").classes("card").props('aria-label="Joints"'):
            joints = ui.html()
        with ui.element("section").classes("card").props('aria-label="Health"'):
            lights = ui.html()

    def read() -> None:
        news = pendant.news
        wrong.set_content(words.warnings(news))
        hand.set_content(words.hand(news))
        joints.set_content(words.joints(news))
        lights.set_content(words.lights(news))
        _show_curve(curve, news)

    ui.timer(READS_S, read)
    _Sight(pendant, place)


class _Sight:
    """The arm in three dimensions, once it is known which one it is."""

    def __init__(self, pendant: Pendant, place: ui.element) -> None:
        self._pendant = pendant
        self._place = place
        self._drawing: Drawing | None = None
        with place:
            self._waits = ui.label("Waiting for the identifier, which knows the arm.")
        self._looks = ui.timer(
            1.0,
            self._look,
        )

    async def _look(self) -> None:
        found = await self._pendant.robot()
        if found is None:
            return
        self._looks.deactivate()
        self._waits.delete()
        with self._place:
            self._drawing = Drawing(
                found.model,
                found.payload_frame,
            )
        with self._place:
            ui.timer(MOVES_S, self._move)

    def _move(self) -> None:
        news = self._pendant.news
        assert self._drawing is not None
        self._drawing.show(news.positions)
        self._drawing.scene.classes(
            add="old" if news.is_old("states") else "",
            remove="" if news.is_old("states") else "old",
        )


def _curve() -> ui.echart:
    """The mass of the last minute, with its interval."""
    axis = {"axisLabel": {"color": GREY}, "splitLine": {"lineStyle": {"color": f"{GREY}40"}}}
    line = {
        "type": "line",
        "symbol": "none",
        "data": [],
        "animation": False,
    }
    band = {
        **line,
        "stack": "band",
        "lineStyle": {"opacity": 0},
    }
    chart = ui.echart(
        {
            "grid": {
                "left": 52,
                "right": 12,
                "top": 28,
                "bottom": 26,
            },
            "title": {"text": "g, last minute", "textStyle": {"color": GREY, "fontSize": 12}},
            "xAxis": {
                **axis,
                "type": "value",
                "min": -CURVE_S,
                "max": 0,
            },
            "yAxis": {
                **axis,
                "type": "value",
                "scale": True,
            },
            "series": [
                band,
                {**band, "areaStyle": {"color": INK, "opacity": 0.25}},
                {**line, "lineStyle": {"color": INK, "width": 2.5}},
            ],
        }
    ).classes("curve")
    chart.props('role="img" aria-label="The mass of the last minute with its interval"')
    return chart


def _show_curve(chart: ui.echart, news: News) -> None:
    now_s = news.now()
    points = news.points
    chart.set_visibility(bool(points))
    series: tuple[list[Any], ...] = (
        [],
        [],
        [],
    )
    for point in points:
        x = round(point.at_s - now_s, 2)
        low, high, mass = (
            1e3 * each
            for each in (
                point.low_kg,
                point.high_kg,
                point.mass_kg,
            )
        )
        for data, value in zip(
            series,
            (low, high - low, mass),
            strict=True,
        ):
            data.append(
                [
                    x,
                    round(
                        value,
                        3,
                    ),
                ]
            )
    if points:
        told = [{"data": data} for data in series]
        chart.run_chart_method("setOption", {"series": told})
