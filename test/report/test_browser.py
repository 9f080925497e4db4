"""The pages in a real browser: wide and narrow, dark, printed, under a pointer; skipped where there is none."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from proprio_ros.pipeline.calibrate import calibrate_from_bags
from proprio_ros.pipeline.replay import replay, write_report
from proprio_ros.pipeline.request import Options
from proprio_ros.report import write_calibration_report
from proprio_ros.report.html import POLICY

pytestmark = pytest.mark.long

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
QUIET = [
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--disable-dev-shm-usage", "--window-size=1500,1000",
]  # fmt: skip
LONG_NAME = "a_folder_" * 20 + "<script>document.title = 'run'</script>"
DARK = "--blink-settings=preferredColorScheme=0"

Look = Callable[..., Any]

MEASURE = """
const seen = (element) => getComputedStyle(element);
const verdict = seen(document.querySelector(".verdict"));
const figure = (name) => { const all = [...document.querySelectorAll(name)]; return Math.min(...all.map((text) =>
  parseFloat(seen(text).fontSize) * text.ownerSVGElement.getScreenCTM().a)); };
return {
  width: innerWidth, scroll: document.documentElement.scrollWidth, title: document.title,
  verdict: [verdict.color, verdict.backgroundColor, verdict.borderTopColor], paper: seen(document.body).backgroundColor,
  inks: [...new Set([...document.querySelectorAll("svg text, svg tspan")].map((text) => seen(text).fill))],
  smallest: figure(".chart > text, .chart .ticks text, .chart .grid text"),
  clipped: [...document.querySelectorAll(".wide, figure")].filter((box) => box.scrollWidth > box.clientWidth + 1).length,
};
"""

POINT = """
const chart = document.querySelector("svg.chart"), box = chart.getBoundingClientRect(), run = RUN;
const x = (time) => { const d = chart.dataset, share = (time - d.x0) / (d.x1 - d.x0);
  return box.left + (74 + share * 552) / 640 * box.width; };
const fire = (type, time) =>
  chart.dispatchEvent(new PointerEvent(type, { clientX: x(time), clientY: box.top + 40, bubbles: true }));
fire("pointermove", run.time);
const tip = document.querySelector(".tip"), words = tip.textContent, shown = !tip.hidden;
const labels = () => [...chart.querySelectorAll(".ticks text")].map((text) => text.textContent);
const before = labels();
fire("pointerdown", 0.2); fire("pointerup", 0.3);
const near = labels(), zoomed = chart.querySelector("svg.plot").getAttribute("viewBox");
chart.dispatchEvent(new MouseEvent("dblclick", { bubbles: true }));
const again = labels();
fire("pointerleave", 0.2);
return { words, shown, before, near, zoomed, again, gone: tip.hidden };
"""


@pytest.fixture
def look(tmp_path: Path) -> Look:
    """Opens a copy of a page and returns what a script says there."""
    if BROWSER is None:
        pytest.skip("needs Chromium")

    def open_page(page: Path, script: str, width: int = 1400, *more: str, style: Callable[[str], str] = str) -> Any:
        text = style(page.read_text().replace(POLICY, ""))  # the page lets no script in but its own
        text += f"<script>parent.document.body.dataset.said = JSON.stringify((() => {{{script}}})())</script>"
        # a window cannot be as narrow as a telephone, a frame can
        frame = f'<iframe style="width:{width}px; height:900px; border:0" srcdoc="{html.escape(text)}"></iframe>'
        outer = tmp_path / "outer.html"
        outer.write_text(f'<!doctype html><meta charset="utf-8"><body>{frame}</body>')
        command = [BROWSER, *QUIET, f"--user-data-dir={tmp_path / 'profile'}", *more, "--dump-dom", outer.as_uri()]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        said = re.search(r'data-said="([^"]*)"', done.stdout)
        assert said, done.stderr[-2000:]
        return json.loads(html.unescape(said[1]))

    return open_page


@pytest.fixture(scope="module")
def pages(bags: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A weighing, a block, a calibration with a run that was not used; with names as long as folders may be."""
    folder = tmp_path_factory.mktemp("pages")
    weighed = replay([bags / "quantised_s00_fixed_heavy_ball_50g_joint3" / "bag_mcap"])
    fit, run = weighed.run_fits[0], weighed.recorded[0]
    named = replace(weighed, run_fits=(replace(fit, name=LONG_NAME),), recorded=(replace(run, name=LONG_NAME), run))
    write_report(named, folder / "payload.html", command=f"proprio replay {LONG_NAME}", sources=[LONG_NAME])
    options = Options(
        probe="softness",
        settings={"block.size": 0.03},
        baseline=[bags / f"realistic_s00_squeeze_empty_{n}" / "bag_mcap" for n in (0, 1)],
    )
    soft = replay([bags / "realistic_s00_squeeze_heavy" / "bag_mcap"], options)
    write_report(soft, folder / "softness.html", command="proprio replay", sources=[LONG_NAME])
    empty = [*sorted(bags.glob("realistic_s00_empty_0[0-5]_*")), bags / "friction_s00_fixed_random_a_joint3"]
    calibration = calibrate_from_bags([each / "bag_mcap" for each in empty], {})
    write_calibration_report(calibration, folder / "calibration.html", sources=[LONG_NAME])
    return {path.stem: path for path in folder.glob("*.html")}


def brightness(color: str) -> float:
    """Of what a browser calls a colour, 0 to 1; see-through is paper."""
    red, green, blue, *opacity = map(float, re.findall(r"[\d.]+", color))
    return 1.0 if opacity == [0.0] else (0.3 * red + 0.59 * green + 0.11 * blue) / 255.0


@pytest.mark.parametrize("name", ["payload", "softness", "calibration"])
@pytest.mark.parametrize("width", [1400, 400])
def test_nothing_is_wider_than_the_window(pages: dict[str, Path], look: Look, name: str, width: int) -> None:
    seen = look(pages[name], MEASURE, width)
    assert seen["width"] == width and seen["scroll"] <= width
    assert seen["smallest"] > 9.0, "px: what stands at the axes can be read"
    assert seen["title"] != "run"


@pytest.mark.parametrize("name", ["payload", "softness", "calibration"])
def test_bright_on_dark_where_the_reader_wants_that(pages: dict[str, Path], look: Look, name: str) -> None:
    light, dark = (look(pages[name], MEASURE, 1400, *more) for more in ((), (DARK,)))
    assert brightness(light["paper"]) > 0.95 and brightness(dark["paper"]) < 0.15
    assert max(map(brightness, light["inks"])) < 0.7
    assert min(map(brightness, dark["inks"])) > 0.4, "no ink is left from the bright page"


@pytest.mark.parametrize("name", ["payload", "softness", "calibration"])
def test_on_paper_the_verdict_and_every_column_can_be_read(pages: dict[str, Path], look: Look, name: str) -> None:
    """What is for print only, shown on a screen as wide as A4 less its margins."""
    seen = look(pages[name], MEASURE, 680, style=lambda text: text.replace("@media print", "@media screen"))
    ink, ground, border = seen["verdict"]
    assert brightness(ink) < 0.1 and brightness(ground) == 1.0 and brightness(border) < 0.1
    assert seen["clipped"] == 0 and seen["scroll"] <= 680


def test_values_under_the_pointer_and_a_closer_look(pages: dict[str, Path], look: Look, bags: Path) -> None:
    run = replay([bags / "quantised_s00_fixed_heavy_ball_50g_joint3" / "bag_mcap"]).run_fits[0]
    time_s = float(run.times_s[10])
    seen = look(pages["payload"], POINT.replace("RUN", json.dumps({"time": time_s})))
    assert seen["shown"] and seen["gone"]
    lines = dict(line.split(": ") for line in seen["words"].replace("\N{MINUS SIGN}", "-").splitlines()[1:])
    value, unit = lines["measured"].split()
    assert float(value) == pytest.approx(run.measured[10], abs=3e-3) and unit == "rad"
    assert float(lines["simulated"].split()[0]) == pytest.approx(run.simulated[10], abs=3e-3)
    assert float(lines["current"].split()[0]) == pytest.approx(-0.301, abs=1e-3)
    assert float(seen["words"].split()[0]) == pytest.approx(time_s, abs=2e-3)
    assert seen["again"] == seen["before"] != seen["near"]
    assert [float(label) for label in seen["near"]] == pytest.approx([0.2, 0.22, 0.24, 0.26, 0.28, 0.3], abs=1e-9)
    begin, _, length, _ = map(float, seen["zoomed"].split())
    assert 0.0 < begin < begin + length < 552.0


def test_the_policy_lets_the_page_s_own_script_run_and_no_other(pages: dict[str, Path], tmp_path: Path) -> None:
    if BROWSER is None:
        pytest.skip("needs Chromium")
    copy = tmp_path / "copy.html"
    copy.write_text(pages["payload"].read_text().replace("</h1>", "</h1><script>document.title = 'run'</script>", 1))
    command = [BROWSER, *QUIET, f"--user-data-dir={tmp_path / 'profile'}", "--dump-dom", copy.as_uri()]
    shown = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert 'class="tip"' in shown and "<title>run</title>" not in shown
