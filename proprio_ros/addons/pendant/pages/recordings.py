"""Recordings."""

from __future__ import annotations

from nicegui import ui

from proprio_ros.addons.pendant.frame import frame
from proprio_ros.addons.pendant.pendant import Pendant


def add(pendant: Pendant) -> None:
    """Add the page."""

    @ui.page("/recordings")
    def recordings() -> None:
        with frame(pendant, "Recordings"):
            ui.label("Nothing here yet.")
