"""`proprio pendant` without nodes: each page opens in a real browser, with the token alone, and asks nobody else for anything."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest

pytest.importorskip("nicegui")
pytest.importorskip("rclpy")

from support.pendant import Shown, pendant
from support.tab import Browser
from support.waiting import wait_for

from proprio_ros.addons.pendant.pages import PAGES

NOBODY = "nobody is there who moves the arm"
PATHS = [page.path for page in PAGES]


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shown]:
    with pendant(tmp_path_factory.mktemp("pendant")) as shown:
        yield shown


@pytest.mark.parametrize("path", PATHS)
def test_a_page_needs_the_token(shown: Shown, path: str) -> None:
    status, text = shown.page(path)
    assert status == 200 and "proprio" in text
    status, text = shown.page(path, {})
    assert status == 403 and "terminal" in text


def test_the_pages_open_in_a_browser(shown: Shown, window: Browser) -> None:
    tab = window.tab()
    tab.open(shown.address)
    for page in PAGES:
        tab.click(page.title)
        tab.until(f"document.title.startsWith('{page.title}') && window.socket.connected")
        tab.until("document.querySelector('.stop').offsetHeight > 40")
        assert not tab.said, page
    assert {
        urlsplit(url).netloc for url in tab.requests if not url.startswith(("data:", "blob:"))
    } == {urlsplit(shown.base).netloc}
    tab.close()


def test_the_space_bar_stops_wherever_the_focus_is(shown: Shown, window: Browser) -> None:
    tab = window.tab()
    tab.open(shown.address)
    for presses in range(1, 4):
        tab.press("Tab")
        tab.press(" ", "Space", " ")
        assert wait_for(lambda: shown.told.count(NOBODY) == presses), shown.told  # noqa: B023
    tab.close()


@pytest.mark.parametrize("words", [[], ["--virtual"]], ids=["alone", "virtual"])
def test_it_ends_in_order(tmp_path: Path, words: list[str]) -> None:
    with pendant(tmp_path, *words, HOME=str(tmp_path)) as shown:
        assert wait_for(lambda: not words or "Ctrl-C ends them" in shown.told)
        assert shown.end() == 0
        assert not words or "all nodes have ended" in shown.told
        assert "Traceback" not in shown.told


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--port", "80"], "choose 1024 to 65535"),
        (["--host", "203.0.113.1"], "choose another with --host and --port"),
        (["--namespace", "9 arms"], "letters, digits and _"),
    ],
)
def test_bad_words_get_one_line(words: list[str], says: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "proprio_ros.cli", "pendant", *words],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 2
    assert sum(says in line for line in done.stderr.splitlines()) == 1
    assert "Traceback" not in done.stderr
