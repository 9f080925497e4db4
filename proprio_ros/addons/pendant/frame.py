"""What every page has: where one can go, who holds the arm, and STOP, always in sight and on the space bar."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from nicegui import Client, ui

from proprio_ros.addons.pendant.lease import SILENCE_S
from proprio_ros.addons.pendant.pages import PAGES
from proprio_ros.addons.pendant.pendant import Pendant

HEAR_S = 2.0
"""So often a page is asked whether it is there."""


@contextlib.contextmanager
def frame(pendant: Pendant, title: str) -> Iterator[None]:
    """A page; what is made inside stands in its middle.

    Args:
        pendant: What it shows.
        title: Of the page, as in the navigation.
    """
    client = ui.context.client
    ui.page_title(f"{title} - proprio")
    with ui.element("header").classes("top"):
        with ui.element("nav").props('aria-label="Pages"'):
            for page in PAGES:
                link = ui.link(page.title, page.path)
                if page.title == title:
                    link.props('aria-current="page"')
        holder = ui.label().classes("holder").props('role="status"')
        stop = ui.element("button").classes("stop").props('type="button" aria-keyshortcuts="Space"')
        with stop:
            ui.label("STOP")
            ui.label("space bar").classes("hint")
    with ui.element("main"):
        yield
    ui.timer(1.0, lambda: holder.set_text(_holder(pendant, client)), immediate=True)
    ui.timer(HEAR_S, lambda: _hear(pendant, client))


def _holder(pendant: Pendant, client: Client) -> str:
    """Who holds the arm, in words for one page."""
    holder = pendant.lease.holder
    if pendant.read_only:
        return "This pendant only looks"
    if not holder:
        return "Nobody holds the arm"
    if holder == client.id:
        return "You hold the arm"
    return "Another browser holds the arm"


async def _hear(pendant: Pendant, client: Client) -> None:
    """Ask a page that holds the arm whether it is there: its answer, not an open socket, says so."""
    if pendant.lease.holder == client.id:
        with contextlib.suppress(TimeoutError):
            if await client.run_javascript("true", timeout=SILENCE_S):
                pendant.lease.hear(client.id)
