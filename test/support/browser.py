"""A page in a real browser, as wide as a window or a telephone: what a script says there, and whether it can be read.

Chromium opens a file in a window of its own, loads nothing from elsewhere, prints the document and ends; no test waits for a time.
"""

from __future__ import annotations

import html
import json
import os
import re
import shutil
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

BROWSER = next(
    filter(
        None,
        map(shutil.which, ("chromium", "chromium-browser", "google-chrome")),
    ),
    None,
)
QUIET = [
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--disable-dev-shm-usage", "--window-size=1500,1000",
    "--host-resolver-rules=MAP * ~NOTFOUND", "--proxy-server=direct://",
]  # fmt: skip

DARK = "--blink-settings=preferredColorScheme=0"
PAPER_PX = 680
"""A4 less its margins."""

MEASURE = """
const seen = (element) => getComputedStyle(element);
const badge = document.querySelector(".verdict"), verdict = badge ? seen(badge) : {};
const figure = (name) => { const all = [...document.querySelectorAll(name)]; return Math.min(99, ...all.map((text) =>
  parseFloat(seen(text).fontSize) * text.ownerSVGElement.getScreenCTM().a)); };
const wider = [...document.querySelectorAll("body *")].filter((box) =>
  box.scrollWidth > box.clientWidth + 1 && ["auto", "scroll"].includes(seen(box).overflowX));
const broken = (element) => { // words of a header that stand on more than one line
  const found = [], walker = document.createTreeWalker(element, NodeFilter.SHOW_TEXT);
  for (let node; (node = walker.nextNode());) for (const word of node.data.matchAll(/[^\\s]+/g)) {
    const range = document.createRange();
    range.setStart(node, word.index);
    range.setEnd(node, word.index + word[0].length);
    if (new Set([...range.getClientRects()].map((box) => box.top)).size > 1) found.push(word[0]);
  }
  return found;
};
return {
  width: innerWidth, scroll: document.documentElement.scrollWidth, title: document.title,
  verdict: [verdict.color, verdict.backgroundColor, verdict.borderTopColor], paper: seen(document.body).backgroundColor,
  inks: [...new Set([...document.querySelectorAll("svg text, svg tspan")].map((text) => seen(text).fill)),
    seen(document.body).color],
  smallest: figure(".chart > text, .chart .ticks text, .chart .grid text, .arm text"),
  clipped: [...document.querySelectorAll(".wide, figure, table")].filter((box) => box.scrollWidth > box.clientWidth + 1).length,
  unsigned: wider.filter((box) => !/gradient.*gradient.*gradient.*gradient/s.test(seen(box).backgroundImage)
    || !seen(box).backgroundAttachment.includes("local")).map((box) => box.outerHTML.slice(0, 80)),
  broken: [...document.querySelectorAll("th")].flatMap(broken),
};
"""

Style = Callable[[str], str]


def on_paper(text: str) -> str:
    """What is for print only, shown on a screen."""
    return text.replace("@media print", "@media screen")


class Look:
    """Opens copies of a page; the copy lets in a script of the test, which the page itself would not."""

    def __init__(self, browser: str, folder: Path) -> None:
        self.browser, self._folder = browser, folder

    def __call__(
        self, page: Path, script: str, width: int = 1400, *more: str, style: Style = str
    ) -> Any:
        """What a script says on a page so wide [px], with more options of the browser."""
        return self.frames(script, [(page, width, style)], *more)[0]

    def frames(
        self, script: str, copies: Sequence[tuple[Path, int, Style]], *more: str
    ) -> list[Any]:
        """The same of several copies in one start of the browser."""
        frames = ""
        for number, (page, width, style) in enumerate(copies):
            copy = style(re.sub(r"default-src 'none'[^\"]*", "", page.read_text(), count=1))
            copy += f"<script>parent.document.body.dataset.said{number} = JSON.stringify((() => {{{script}}})())</script>"
            # a window cannot be as narrow as a telephone, a frame can
            frames += f'<iframe style="width:{width}px; height:900px; border:0" srcdoc="{html.escape(copy)}"></iframe>'
        outer = self._folder / "outer.html"
        outer.write_text(f'<!doctype html><meta charset="utf-8"><body>{frames}</body>')
        shown = self.shown(outer, *more)
        said = [re.search(rf'data-said{number}="([^"]*)"', shown) for number in range(len(copies))]
        assert all(said), shown[-2000:]
        return [json.loads(html.unescape(found[1])) for found in said]

    def framed(self, pages: Sequence[Path], script: str, width: int, *more: str) -> list[Any]:
        """What a script says on pages that load files beside them, all in one start of the browser."""
        tall = f"width:{width}px; height:900px; border:0"
        frames = "".join(
            f'<iframe style="{tall}" src="{page.as_uri()}"></iframe>' for page in pages
        )
        outer = self._folder / "outer.html"
        inner = json.dumps(f"(() => {{{script}}})()")
        told = (
            "document.body.dataset.said = JSON.stringify([...document.querySelectorAll('iframe')].map((frame) => "
            f"frame.contentWindow.eval({inner})))"
        )
        ready = f'<script>addEventListener("load", () => {{ {told}; }})</script>'
        outer.write_text(f'<!doctype html><meta charset="utf-8"><body>{frames}{ready}</body>')
        said = re.search(
            r'data-said="([^"]*)"', self.shown(outer, "--allow-file-access-from-files", *more)
        )
        assert said, "the browser says nothing"
        found: list[Any] = json.loads(html.unescape(said[1]))
        return found

    def shown(self, page: Path, *more: str) -> str:
        """The document of a page after its scripts have run."""
        command = [
            self.browser,
            *QUIET,
            f"--user-data-dir={self._folder / 'profile'}",
            *more,
            "--dump-dom",
            page.as_uri(),
        ]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout


@pytest.fixture(scope="module")
def look(tmp_path_factory: pytest.TempPathFactory) -> Look:
    """Skipped without a browser; where the environment says that there has to be one it fails."""
    if BROWSER is None:
        if os.environ.get("PROPRIO_REQUIRE_BROWSER"):
            pytest.fail("no Chromium, and PROPRIO_REQUIRE_BROWSER is set")
        pytest.skip("needs Chromium")
    return Look(BROWSER, tmp_path_factory.mktemp("browser"))


def brightness(color: str) -> float:
    """Of what a browser calls a colour, 0 to 1; see-through is paper."""
    red, green, blue, *opacity = map(
        float,
        re.findall(r"[\d.]+", color),
    )
    return 1.0 if opacity == [0.0] else (0.3 * red + 0.59 * green + 0.11 * blue) / 255.0
