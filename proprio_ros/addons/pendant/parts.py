"""What pages are made of."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from html import escape
from typing import Any

from nicegui import ui
from nicegui.events import GenericEventArguments

from proprio_ros.addons.pendant.places import MOST_BYTES
from proprio_ros.errors import ProprioError

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
    """Say why not, for as long as it takes to read."""
    ui.notify(why, type="negative", timeout=8000)


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
    marks = {True: " selected", False: ""}
    inner = "".join(
        f'<option value="{escape(key)}"{marks[key == value]}>{escape(words)}</option>'
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
