"""The whole wizard by clicks and by keys, on a virtual arm with its nodes: what a service answers is what the page shows."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest

pytest.importorskip("nicegui")
pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

from support.browser import BROWSER
from support.live import wait_for
from support.pendant import LONG_S, Desk, ask, at_the_arm
from support.tab import Tab

from proprio_ros.addons.pendant.pages import PAGES

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(BROWSER is None, reason="needs Chromium"),
]
SAID = "document.querySelector('.progress .verdict')?.innerText"
NUMBER = "document.querySelector('.progress .number')?.innerText"
RUNS = "document.querySelectorAll('.figures > svg').length"
NAMELESS = """[...document.querySelectorAll('button, a, select, input, canvas, [role=img]')].filter((it) => it.checkVisibility()
  && !(it.getAttribute('aria-label') || it.innerText.trim() || it.closest('[aria-label], label'))).map((it) => it.outerHTML)"""
COUNTS = """window.draws = 0;
  const drawn = WebGL2RenderingContext.prototype.drawElements;
  WebGL2RenderingContext.prototype.drawElements = function (...all) { window.draws += 1; return drawn.apply(this, all); };
  true"""
RESTS = """await (async (before) => {
  await new Promise((done) => setTimeout(done, 1000));
  return before === window.draws;
})(window.draws)"""
GRAMS = 50.0
"""What the virtual hand holds where something is weighed."""


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Desk]:
    held = {"object": str(GRAMS / 1000.0)}
    with at_the_arm(tmp_path_factory.mktemp("desk"), virtual=held, calibration="") as desk:
        yield desk


@pytest.fixture(scope="module")
def tab(desk: Desk) -> Iterator[Tab]:
    """One for all tasks, as a person would."""
    tab = desk.wizard("Calibrate the arm")
    yield tab
    assert not tab.said
    asked = [url for url in tab.requests if not url.startswith(("data:", "blob:"))]
    assert {urlsplit(url).netloc for url in asked} == {urlsplit(desk.shown.base).netloc}
    tab.close()


def begin(tab: Tab, title: str, pushes: str = "") -> None:
    """Click a task, until the arm has been asked for it."""
    ask(tab, title)
    if pushes:
        tab.choose("Pushes", pushes)
    tab.click("Start")
    tab.shows("Keep away from it")
    tab.click("Begin")
    tab.until(
        f"[...document.querySelectorAll('.progress .title')].some((it) => it.innerText.startsWith('{title}:'))"
    )


def answered(desk: Desk, tab: Tab) -> str:
    """The verdict that the page shows in the end, which is that of the node."""
    assert wait_for(lambda: tab.does(SAID), LONG_S), tab.text
    said = str(tab.does(SAID))

    def published() -> str:
        values = desk.client.estimates[-1] if desk.client.estimates else {}
        return values.get("verdict", "").replace("_", " ")

    assert wait_for(lambda: said in (published(), "done", "not done")), published()
    return said


@pytest.mark.parametrize(
    "title",
    [
        "Calibrate the arm",
        "Weigh an object",
        "Squeeze a block",
        "Record the empty box",
        "Weigh a ball in a box",
        "What a container holds",
    ],
)
def test_every_task_is_answered(desk: Desk, tab: Tab, title: str, tmp_path: Path) -> None:
    begin(tab, title)
    said = answered(desk, tab)
    if title == "Weigh an object" and said == "accepted":
        low, high = interval(tab)
        assert low < GRAMS < high
        assert float(str(tab.does(NUMBER)).split()[0]) == pytest.approx(GRAMS, abs=10.0)
    if said in ("accepted", "rejected", "too wide"):
        tab.shows("Report")
        assert desk.shown.page(tab.does("document.querySelector('.report').pathname"))[0] == 200
    if said in ("accepted", "too wide") and title == "Weigh an object":
        tab.until(f"{RUNS} > 0")
    tab.shows("Copy the command")
    for width in (400, 1400):
        for dark in (False, True):
            tab.look(width, 1000, dark)
            tab.until("document.documentElement.scrollWidth <= innerWidth")
            tab.picture(tmp_path / f"{width}_{'dark' if dark else 'bright'}.png")
    assert wait_for(desk.is_held)


def interval(tab: Tab) -> tuple[float, float]:
    """In grams, as the page states it."""
    words = str(tab.does("document.querySelector('.progress .interval').innerText"))
    low, _, high, unit = words.removeprefix("95 % interval ").split()
    assert unit == "g"
    return float(low), float(high)


def test_what_the_hand_will_do_is_drawn_before(desk: Desk, tab: Tab) -> None:
    ask(tab, "Weigh an object")
    tab.click("Start")
    tab.shows("Orange: as far as pushes may take the hand.")
    tab.until("document.querySelectorAll('.confirm canvas').length === 1")
    tab.shows("3 pushes")
    assert desk.client.excitation["busy"] == "false"
    tab.click("Not yet")
    tab.until("!document.querySelector('.confirm')")
    assert desk.client.excitation["busy"] == "false"


def test_until_sure_ends_by_the_red_button(desk: Desk, tab: Tab) -> None:
    """And the sequence is what it was before."""
    begin(tab, "Weigh an object", "chosen ones, until it is known well enough")
    assert wait_for(lambda: desk.client.excitation.get("busy") == "true", LONG_S)
    tab.click("STOP")
    assert wait_for(lambda: tab.does("!!document.querySelector('.verdict.bad')"), LONG_S)
    assert wait_for(desk.is_held)
    ask(tab, "Weigh an object")
    tab.click("Start")
    tab.shows("payload: 3 pushes")
    tab.click("Not yet")


def test_keys_alone_begin_and_stop(desk: Desk, tab: Tab) -> None:
    ask(tab, "Squeeze a block")
    tab.focus("Weigh an object")
    tab.press("Enter", "Enter", "\r")
    tab.until("document.querySelector('[aria-label=Task] .title').innerText === 'Weigh an object'")
    tab.focus("Start")
    tab.press("Enter", "Enter", "\r")
    tab.shows("Keep away from it")
    tab.focus("Begin")
    tab.press("Enter", "Enter", "\r")
    assert wait_for(lambda: desk.client.excitation.get("busy") == "true", LONG_S)
    tab.until("!document.querySelector('.verdict')")  # that of the call before
    tab.press(" ", "Space", " ")
    assert wait_for(lambda: tab.does("!!document.querySelector('.verdict.bad')"), LONG_S)
    assert wait_for(desk.is_held)


def test_everything_has_a_name(tab: Tab) -> None:
    for page in PAGES:
        tab.click(page.title)
        tab.until(f"document.title.startsWith('{page.title}')")
        tab.until("!!document.querySelector('.page')?.innerText.trim()")
        assert tab.does(NAMELESS) == [], page.title


def test_an_arm_that_nobody_looks_at_is_not_drawn(desk: Desk) -> None:
    """Pages open and close all day: the library would go on drawing each scene that was ever shown."""
    tab = desk.window.tab()
    tab.open(desk.shown.address)
    tab.does(COUNTS)
    tab.until("!!document.querySelector('.scene canvas') && window.draws > 0")
    tab.click("History")
    tab.until("!document.querySelector('.scene')")
    tab.until(RESTS)
    tab.click("Arm")
    tab.until("!!document.querySelector('.scene canvas')")
    tab.until(f"!({RESTS})")
    assert not tab.said
    tab.close()
