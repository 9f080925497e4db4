"""Recordings."""

from __future__ import annotations

from nicegui import ui

from proprio_ros.addons.pendant.pendant import Pendant


def show(pendant: Pendant) -> None:
    """Fill the page."""
    ui.label("Nothing here yet.")
