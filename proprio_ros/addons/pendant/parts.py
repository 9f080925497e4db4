"""What pages are made of."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from html import escape
from typing import Any

from nicegui import ui
from nicegui.events import GenericEventArguments

from proprio_ros.addons.pendant.calls import Call
from proprio_ros.addons.pendant.places import MOST_BYTES
from proprio_ros.errors import ProprioError

GREY = "#8a94a3"
COLOURS = ["#2a9cc4", "#e08a2c", "#5fa35a", "#c9605c", "#9380c6", "#b08d57", "#7f8fa6"]
"""Of curves, on bright and dark."""
LINE = {"type": "line", "symbol": "none", "animation": False}
READS_S = 0.5
LATEST = 4
"""So many sentences are shown."""
COPIES = "() => navigator.clipboard.writeText(event.target.closest('section').querySelector('.command').innerText)"
SENDS = """async (event) => {
  event.preventDefault();
  for (const file of [...(event.dataTransfer || event.target).files]) emit(await sendRecording(file, MOST));
  if (event.type === "change") event.target.value = "";
}""".replace("MOST", str(MOST_BYTES))


def attempt(act: Callable[[], Any]) -> None:
    """Do it, or say why not."""
    try:
        act()
    except ProprioError as error:
        refuse(str(error))


def refuse(why: str) -> None:
    """Say why not, until that is put away."""
    ui.notify(why, type="negative", timeout=0, close_button="OK")


def card(name: str) -> ui.element:
    """A part of a page."""
    return ui.element("section").classes("card").props(f'aria-label="{name}"')


def heading(words: str, level: int = 2) -> None:
    """A title."""
    ui.label(words).classes("title").props(f"role=heading aria-level={level}")


def select(
    label: str, options: Mapping[str, str], value: str, change: Callable[[str], Any]
) -> ui.element:
    """A box of the browser's own, which keys move through.

    Args:
        label: Its name.
        options: Words by what they stand for.
        value: What is chosen.
        change: Called with what is chosen then.
    """
    inner = "".join(
        f'<option value="{escape(key)}"{" selected" * (key == value)}>{escape(words)}</option>'
        for key, words in options.items()
    )

    def heard(event: GenericEventArguments) -> Any:
        return change(event.args) if event.args in options else None

    with ui.element("label").classes("choice"):
        ui.element("span").classes("small").props(f'aria-hidden="true" innerHTML="{escape(label)}"')
        box = ui.html(inner, tag="select", sanitize=False).props(f'aria-label="{escape(label)}"')
    box.on("change", heard, js_handler="(event) => emit(event.target.value)")
    return box


def drop(title: str, hint: str, taken: Sequence[str]) -> None:
    """Where a file of this computer can be dropped or chosen.

    Args:
        title: What to do.
        hint: About the files.
        taken: How their names end.
    """

    def heard(event: GenericEventArguments) -> None:
        if event.args:
            refuse(str(event.args))

    with ui.element("label").classes("drop") as zone:
        ui.label(title)
        ui.label(hint).classes("small")
        files = ui.element("input").props(f'type=file multiple accept="{",".join(taken)}"')
        files.props(f'aria-label="{title}"')
    files.on("change", heard, js_handler=SENDS)
    zone.on("drop", heard, js_handler=SENDS)
    zone.on("dragover", js_handler="(event) => event.preventDefault()")


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


class Progress:
    """A card about the latest call; who shows one fills `answer` when it changes.

    Args:
        name: Of the card.
    """

    def __init__(self, name: str) -> None:
        self._shown: tuple[Call | None, bool] = (None, False)
        with ui.element("section").classes("card progress") as self.card:
            self.card.props(f'aria-label="{name}"')
            self._title = ui.label().classes("title")
            self.bar = ui.linear_progress(0.0, show_value=False).props('aria-label="Working"')
            self._said = ui.html().props("role=status")
            self.answer = ui.element("div").classes("hand").props('role="status"')
            self._command = ui.label().classes("command")
            copy = ui.button("Copy the command").props("flat no-caps")
            copy.on("click", js_handler=COPIES)

    def read(self, call: Call | None, title: str = "", doing: str = "", runs: bool = False) -> bool:
        """Show how it is; whether a call has begun, or ended, since.

        Args:
            call: The latest.
            title: What it does.
            doing: How far it is, while it runs.
            runs: Whether it does.
        """
        self.card.set_visibility(call is not None)
        if call is None:
            return False
        self._title.set_text(f"{title}: {doing}, {call.elapsed_s:.0f} s" if runs else title)
        said = "".join(f"<p>{escape(words)}</p>" for words in call.said[-LATEST:])
        self._said.set_content(f'<div class="said">{said}</div>' if runs else "")
        self.bar.set_visibility(runs)
        self._command.set_text(call.command)
        changed = (call, runs) != self._shown
        self._shown = (call, runs)
        if changed:
            self.answer.clear()
        return changed
