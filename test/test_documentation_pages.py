"""The documentation is built without a warning; in a real browser no page is wider than its window, and no command is cut.

Skipped without what builds the pages (the extra docs), all but the build without a browser, too.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("mkdocs", reason="needs the extra docs")

from support.browser import DARK, Look, brightness
from support.documents import PAGES, REPOSITORY

pytestmark = pytest.mark.long
Seen = dict[str, Any]
MEASURE = """
const seen = (element) => getComputedStyle(element);
const boxed = (element) => { // something around it scrolls by itself
  for (let box = element.parentElement; box && box !== document.body; box = box.parentElement)
    if (["auto", "scroll"].includes(seen(box).overflowX) && box.getBoundingClientRect().right <= innerWidth + 1) return true;
  return false;
};
const all = (what) => [...document.querySelectorAll(what)];
return {
  width: innerWidth, scroll: document.documentElement.scrollWidth,
  beyond: all(".md-content *").filter((each) => each.getBoundingClientRect().right > innerWidth + 1 && !boxed(each))
    .map((each) => each.outerHTML.slice(0, 80)),
  cut: all("pre, pre > code, .md-typeset__scrollwrap, .equation").filter((each) => each.scrollWidth > each.clientWidth + 1)
    .map((each) => each.outerHTML.slice(0, 80)),
  ink: seen(document.querySelector(".md-content")).color, paper: seen(document.body).backgroundColor,
};
"""
TOGETHER = 9
"""Pages that one start of the browser shows."""


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Of the documentation, as `mkdocs build` writes them; a warning is an error."""
    site = tmp_path_factory.mktemp("site")
    build = [
        sys.executable,
        "-m",
        "mkdocs",
        "build",
        "-q",
        "--strict",
        "-f",
        "docs/mkdocs.yml",
        "-d",
        str(site),
    ]
    subprocess.run(build, cwd=REPOSITORY, check=True)
    return sorted(path for path in site.rglob("*.html") if path.name != "404.html")


def measured(look: Look, pages: list[Path], width: int, *more: str) -> dict[str, Seen]:
    found: dict[str, Seen] = {}
    for at in range(0, len(pages), TOGETHER):
        some = pages[at : at + TOGETHER]
        names = [page.name for page in some]
        found |= dict(
            zip(
                names,
                look.framed(some, MEASURE, width, *more),
                strict=True,
            )
        )
    return found


def test_every_page_is_built(pages: list[Path]) -> None:
    assert len(pages) >= len(PAGES) > 40


@pytest.mark.parametrize("width", [1400, 400])
def test_no_page_is_wider_than_the_window(
    pages: list[Path],
    look: Look,
    width: int,
) -> None:
    for name, seen in measured(look, pages, width).items():
        assert seen["width"] == width, name
        assert seen["scroll"] <= width, name
        assert seen["beyond"] == [], name
        if width > 400:
            assert seen["cut"] == [], f"{name}: a wide window shows every column and every command"
        assert brightness(seen["paper"]) > 0.95, name
        assert brightness(seen["ink"]) < 0.3, name


def test_pages_are_dark_where_the_reader_wants_that(
    pages: list[Path], look: Look, tmp_path: Path
) -> None:
    fresh = Look(look.browser, tmp_path)  # the pages remember how they were read
    for name, seen in measured(fresh, pages, 400, DARK).items():
        assert seen["scroll"] <= 400, name
        assert seen["beyond"] == [], name
        assert brightness(seen["paper"]) < 0.2, name
        assert brightness(seen["ink"]) > 0.5, name
