"""The arm, now: where it is, what it holds, how well bus and nodes are."""

from __future__ import annotations

from functools import partial

from nicegui import ui

from proprio_ros.addons.pendant import words
from proprio_ros.addons.pendant.drawing import Drawing
from proprio_ros.addons.pendant.news import CURVE_S, News
from proprio_ros.addons.pendant.parts import LINE, card, chart
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
    _see(pendant, place)


def _see(pendant: Pendant, place: ui.element) -> None:
    """Draw the arm, once it is known which one it is."""
    with place:
        waits = ui.label("Waiting for the identifier, which knows the arm.")

    async def look() -> None:
        found = await pendant.robot()
        if found is None:
            return
        looks.deactivate()
        waits.delete()
        with place:
            drawing = Drawing(found.model, found.payload_frame)
            ui.timer(MOVES_S, partial(_move, pendant.news, drawing))

    looks = ui.timer(1.0, look)


def _move(news: News, drawing: Drawing) -> None:
    drawing.show(news.positions)
    drawing.hold(words.body(news))
    old = news.is_old("states")
    drawing.scene.classes(add="old" * old, remove="old" * (not old))


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
    times_s = [round(point.at_s - now_s, 2) for point in points]
    series = []
    for masses in (
        [point.low_kg for point in points],
        [point.high_kg - point.low_kg for point in points],
        [point.mass_kg for point in points],
    ):
        grams = [round(GRAMS * mass, 3) for mass in masses]
        series.append({"data": list(zip(times_s, grams, strict=True))})
    if points:
        curve.run_chart_method("setOption", {"series": series})
