"""A module a page, each with a function ``add(pendant)``."""

from __future__ import annotations

from typing import NamedTuple


class Page(NamedTuple):
    """One of the navigation."""

    path: str
    title: str
    place: str  # of the function that adds it


PAGES = tuple(
    Page(path, title, f"proprio_ros.addons.pendant.pages.{title.lower()}:add")
    for path, title in (
        ("/", "Arm"),
        ("/wizard", "Wizard"),
        ("/recordings", "Recordings"),
        ("/history", "History"),
    )
)
