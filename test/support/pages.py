"""Reading a page back: are its elements closed, does it need anything from elsewhere, and what does it say?"""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np

from proprio_ros.report.html import SCRIPT

VOID = {"meta", "br", "wbr", "hr", "img", "link", "input"}


class Reader(HTMLParser):
    """Checks that every element is closed, and keeps the visible words and the links."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.words: list[str] = []
        self.scripts: list[str] = []
        self.links: list[str] = []
        self.tags: list[str] = []
        self.classes: list[str] = []

    def handle_starttag(
        self,
        tag: str,
        attrs: list[tuple[str, str | None]],
    ) -> None:
        self.tags.append(tag)
        self.classes += (dict(attrs).get("class") or "").split()
        self.links += [
            value or ""
            for name, value in attrs
            if name in ("src", "href", "xlink:href", "data", "action")
        ]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(
        self,
        tag: str,
        attrs: list[tuple[str, str | None]],
    ) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open and self.open.pop() == tag, f"</{tag}> closes nothing"

    def handle_data(self, data: str) -> None:
        if "script" in self.open:
            self.scripts.append(data)
        elif "style" not in self.open:
            self.words.append(data)


def read(path: Path) -> tuple[Reader, str]:
    reader = Reader()
    reader.feed(path.read_text(encoding="utf-8"))
    reader.close()
    assert not reader.open, f"left open: {reader.open}"
    assert all(link.startswith("#") for link in reader.links), (
        "the page must not need anything else"
    )
    assert reader.scripts == [SCRIPT], "its own script, and nobody else's"
    return reader, " ".join(" ".join(reader.words).split())


def curves(
    page: str,
    name: str,
) -> list[np.ndarray]:
    """Every curve called so, in its own numbers, shape (K, 2): read back from its path and the ends of its axes."""
    found = []
    for chart in re.findall(r'<svg class="chart".*?</svg></svg>', page):
        x0, x1 = (float(re.search(rf'data-{end}="([^"]+)"', chart)[1]) for end in ("x0", "x1"))
        for plot in re.findall(r'<svg class="plot".*?</svg>', chart):
            y0, y1 = (float(re.search(rf'data-{end}="([^"]+)"', plot)[1]) for end in ("y0", "y1"))
            width, height = (
                float(re.search(rf' {side}="([^"]+)"', plot)[1]) for side in ("width", "height")
            )
            for path in re.findall(
                rf'<path class="[^"]*" data-name="{name}"[^>]* d="([^"]*)"', plot
            ):
                at = np.array(
                    re.findall(r"[ML](-?[\d.]+),(-?[\d.]+)", path),
                    dtype=float,
                )
                y = y1 + at[:, 1] / height * (y0 - y1)
                found.append(
                    np.stack(
                        [
                            x0 + at[:, 0] / width * (x1 - x0),
                            10**y if "data-log" in plot else y,
                        ],
                        axis=1,
                    )
                )
    return found
