"""The arm, now: where it is, what it holds, how well bus and nodes are."""

from __future__ import annotations

from nicegui import ui

from proprio_ros.addons.pendant import words
from proprio_ros.addons.pendant.charts import LINE, chart
from proprio_ros.addons.pendant.drawing import Drawing
from proprio_ros.addons.pendant.news import CURVE_S, News
from proprio_ros.addons.pendant.parts import card
from proprio_ros.addons.pendant.pendant import Pendant

MOVES_S = 0.1
READS_S = 0.5
INK = "#2a9cc4"
GRAMS = 1e3  # of a kg


def show(pendant: Pendant) -> None:
    """Fill the page."""
    if pendant.no_ros:
        ui.label(f"No arm can be seen: {pendant.no_ros}").classes("card")
        return
    wrong = ui.html().classes("warnings").props('role="alert"')
    with ui.element("div").classes("columns"):
        place = card("The arm")
        with card("In the hand"):
            hand = ui.html().classes("hand")
            curve = _curve()
    with ui.element("div").classes("columns"):
        with card("Joints"):
            joints = ui.html()
        with card("Health"):
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
        self._drawing.hold(words.body(news))
        old = news.is_old("states")
        self._drawing.scene.classes(add="old" * old, remove="old" * (not old))


def _curve() -> ui.echart:
    """The mass of the last minute, with its interval."""
    band = {**LINE, "stack": "band", "lineStyle": {"opacity": 0}}
    within = {**band, "areaStyle": {"color": INK, "opacity": 0.25}}
    mass = {**LINE, "lineStyle": {"color": INK, "width": 2.5}}
    across = {"min": -CURVE_S, "max": 0}
    return chart("Mass of the last minute, with its interval [g]", across, [band, within, mass])


def _show_curve(curve: ui.echart, news: News) -> None:
    now_s = news.now()
    points = news.points
    curve.set_visibility(bool(points))
    lows = []
    widths = []
    masses = []
    for point in points:
        x = round(point.at_s - now_s, 2)
        lows.append([x, round(GRAMS * point.low_kg, 3)])
        widths.append([x, round(GRAMS * (point.high_kg - point.low_kg), 3)])
        masses.append([x, round(GRAMS * point.mass_kg, 3)])
    if points:
        series = [{"data": data} for data in (lows, widths, masses)]
        curve.run_chart_method("setOption", {"series": series})
