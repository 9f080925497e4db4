"""What every page has: where one can go, who holds the arm, and STOP, always in sight and on the space bar."""

from __future__ import annotations

import contextlib
from functools import partial

from nicegui import Client, ui

from proprio_ros.addons.pendant.lease import SILENCE_S
from proprio_ros.addons.pendant.pages import PAGES
from proprio_ros.addons.pendant.pendant import Pendant
from proprio_ros.registry import loaded

HEAR_S = 2.0
"""So often a page is asked whether it is there."""


def frame(pendant: Pendant) -> None:
    """The one page of a browser, whose middle shows what its address says."""
    client = ui.context.client
    ui.colors(primary="#2a7f9e")
    with ui.element("header").classes("top"):
        with ui.element("nav").props('aria-label="Pages"'):
            links = {page.path: ui.link(page.title, page.path) for page in PAGES}
        holder = ui.label().classes("holder").props('role="status"')
        gives = ui.button("Give up", on_click=lambda: pendant.lease.give_up(client.id))
        gives.props("flat dense no-caps")
        stop = ui.element("button").classes("stop").props('type="button" aria-keyshortcuts="Space"')
        with stop:
            ui.label("STOP")
            ui.label("space bar").classes("hint")
    with ui.element("div").classes("page"):
        ui.sub_pages({page.path: partial(loaded(page.place), pendant) for page in PAGES})

    def went(address: str) -> None:
        path = address.partition("?")[0]
        for page in PAGES:
            links[page.path].props('aria-current="page"' if page.path == path else "")
            if page.path == path:
                ui.page_title(f"{page.title} - proprio")
            else:
                links[page.path].props(remove="aria-current")

    def tell() -> None:
        holder.set_text(_holder(pendant, client))
        mine = pendant.lease.holder == client.id
        gives.set_visibility(mine and pendant.calls.under_way is None)

    client.sub_pages_router.on_path_changed(went)
    went(client.sub_pages_router.current_path)
    ui.timer(1.0, tell)
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
