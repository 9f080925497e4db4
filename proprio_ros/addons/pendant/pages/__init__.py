"""A module a page, each with a function ``show(pendant)`` that fills the middle of the frame.

One page of the browser shows them all in turn, so that whoever holds the arm can look elsewhere meanwhile.
"""

from __future__ import annotations

from typing import NamedTuple


class Page(NamedTuple):
    """One of the navigation."""

    path: str
    title: str
    place: str  # of the function that shows it


PAGES = tuple(
    Page(path, title, f"proprio_ros.addons.pendant.pages.{title.lower()}:show")
    for path, title in (
        ("/", "Arm"),
        ("/wizard", "Wizard"),
        ("/recordings", "Recordings"),
        ("/history", "History"),
    )
)
