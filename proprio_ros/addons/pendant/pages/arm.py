"""Arm."""

from __future__ import annotations

from nicegui import ui

from proprio_ros.addons.pendant.frame import frame
from proprio_ros.addons.pendant.pendant import Pendant


def add(pendant: Pendant) -> None:
    """Add the page."""

    @ui.page("/")
    def arm() -> None:
        with frame(pendant, "Arm"):
            ui.label("Nothing here yet.")
