"""Wizard."""

from __future__ import annotations

from nicegui import ui

from proprio_ros.addons.pendant.frame import frame
from proprio_ros.addons.pendant.pendant import Pendant


def add(pendant: Pendant) -> None:
    """Add the page."""

    @ui.page("/wizard")
    def wizard() -> None:
        with frame(pendant, "Wizard"):
            ui.label("Nothing here yet.")
