"""The page of a batch in a real browser, with ten thousand rows: wide and narrow, dark, printed, searched and filtered."""

from __future__ import annotations

import html
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("pyarrow", reason="needs the extra batch")

from support.browser import DARK, PAPER_PX, Look, brightness, on_paper
from support.browser import MEASURE as READABLE

from proprio_ros.addons.fleet.drift import Drift
from proprio_ros.addons.fleet.page import odd, write_batch_page
from proprio_ros.addons.fleet.rows import COLUMNS, Job, source_name
from proprio_ros.addons.fleet.store import Store
from proprio_ros.pipeline.request import Options

COUNT = 10_000
SOURCES = ("/data/line_1", "/data/line_2", "/data/pick <b>cubes")
HOUR_NS = 3600 * 10**9
EMPTY: dict[str, Any] = {"text": "", "texts": [], "integer": None, "number": None}


def rows_like(
    count: int,
    seed: int = 1,
) -> list[dict[str, Any]]:
    """Rows of weeks of work: most accepted, some far off, some of each way to be refused."""
    rng = np.random.default_rng(seed)
    rows = []
    for n in range(count):
        source = SOURCES[n % 3]
        kind = rng.random()
        dated = n % 3 < 2
        mass = 0.05 * rng.integers(1, 5) + 4e-4 * rng.standard_normal()
        std = float(rng.uniform(3e-4, 6e-4))
        row = {name: EMPTY[form] for name, form in COLUMNS.items()} | {
            "source_name": source_name(source), "source": source, "episode": f"{n:05d}" if dated else str(n),
            "episode_index": None if dated else n, "segment": 0, "segments": 1, "kind": "episode", "samples": 600,
            "recorded_ns": 1_780_000_000_000_000_000 + n * HOUR_NS // 40 if dated else None, "start_s": 0.0, "end_s": 11.98,
            "joints": ["joint1", "joint2", "joint3"], "probe": "payload", "quantity": "payload_mass", "unit": "kg",
            "value": mass, "std": std, "low": mass - 1.96 * std, "high": mass + 1.96 * std, "verdict": "accepted",
            "robot": "arm", "calibration": "arm.yaml",
            "reasons": ["guessed, not stated: payload.com ([0, 0, 0] mm): state it with --set payload.com=.."],
            "reason_codes": ["guessed_facts"],
        }  # fmt: skip
        if kind < 0.002:
            row |= {
                "value": mass + 0.6,
                "low": mass + 0.599,
                "high": mass + 0.601,
            }
        elif kind < 0.06:
            wide = f"anything from 0 .. {rng.integers(100, 400)} g explains the recording: record more runs"
            row |= {
                "verdict": "too_wide",
                "std": 0.08,
                "low": 0.0,
                "high": 0.3,
                "reasons": [wide],
                "reason_codes": ["too_wide"],
            }
        elif kind < 0.08:
            moved = f"{source.rsplit('/')[-1]}/{n:05d}: joint3 moved only {rng.random():.3f} rad: probe with more current"
            row |= {
                "verdict": "not_identifiable",
                "reasons": [moved],
                "reason_codes": ["stuck"],
            }
            row |= dict.fromkeys(("value", "std", "low", "high"))
        elif kind < 0.09:
            place = f"{source}{'/' if dated else '#'}{row['episode']}"
            cut = f"{place}: not readable as a ROS 2 bag (ends after {rng.integers(1000)} bytes); record it again"
            row |= {
                "verdict": "failed",
                "kind": "failed",
                "reasons": [cut],
                "reason_codes": ["unreadable"],
                "joints": [],
            }
            row |= dict.fromkeys(("value", "std", "low", "high", "recorded_ns", "start_s", "end_s"))
        rows.append(row)
    return rows


def page_of(
    folder: Path, rows: list[dict[str, Any]], options: Options | None = None, **more: Any
) -> Path:
    """The page of a folder with such rows."""
    store = Store(folder, Job(options or Options()))
    for source in SOURCES:
        if own := [row for row in rows if row["source"] == source]:
            store.write(own, "0")
    read = store.read(COLUMNS)
    write_batch_page(
        read,
        folder / "batch.html",
        "proprio batch /data --out out",
        {},
        Drift(()),
        options=options,
        **more,
    )
    store.close()
    return folder / "batch.html"


OPEN = """
const all = (what, root = document) => [...root.querySelectorAll(what)];
const names = () => all("#list td button");
const fire = (each, type) => each.dispatchEvent(new Event(type));
const type = (words) => { const find = document.getElementById("find"); find.value = words; fire(find, "input"); };
const choose = (id, label) => { const select = document.getElementById(id);
  select.value = [...select.options].find((each) => each.textContent.startsWith(label)).value; fire(select, "change"); };
const counted = () => document.getElementById("count").textContent;
const column = (key) => { const heads = all("#list th button").map((each) => each.dataset.key);
  return all("#list tbody tr:not(.detail)").map((row) => row.children[heads.indexOf(key)].textContent); };
const order = (key) => document.querySelector(`#list th button[data-key="${key}"]`).click();
"""

MEASURE = (
    OPEN
    + """
choose("verdict", "too wide"); names()[0].click();
const seen = (element) => getComputedStyle(element), right = (each) => each.getBoundingClientRect().right;
const words = all("svg text, svg tspan, td, p, h3, #find, pre");
return {
  width: innerWidth, scroll: document.documentElement.scrollWidth, title: document.title,
  paper: seen(document.body).backgroundColor,
  inks: [...new Set(words.map((each) => seen(each)[each.closest("svg") ? "fill" : "color"]))],
  clipped: all(".wide, figure, pre, .cause").filter((box) => box.scrollWidth > box.clientWidth + 1).length,
  beyond: all("body *").filter((each) => !each.closest("svg") && right(each) > innerWidth + 1).map((each) => each.tagName),
  bars: all(".cause i").map((bar) => bar.getBoundingClientRect().width),
  details: all(".detail").length,
};
"""
)


def opened(
    look: Look, page: Path, script: str, width: int = 1400, *more: str, printed: bool = False
) -> Any:
    """What a script says on the page, which lets it in."""

    return look(
        page,
        script,
        width,
        *more,
        style=on_paper if printed else str,
    )


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    options = Options(
        calibration="arm.yaml",
        settings={"payload.com": [0, 0, 0.01]},
    )
    return page_of(tmp_path_factory.mktemp("many"), rows_like(COUNT), options)


@pytest.mark.long
@pytest.mark.parametrize("width", [1400, 400])
def test_nothing_is_wider_than_the_window(page: Path, look: Look, width: int) -> None:
    seen = opened(look, page, MEASURE, width)
    assert (
        seen["width"] == width
        and seen["scroll"] <= width
        and seen["beyond"] == []
        and seen["clipped"] == 0
    )
    assert seen["title"] == "Many recordings"
    assert seen["details"] == 1
    assert seen["bars"][0] > 0.8 * min(width, 900) and min(seen["bars"]) > 5.0, "bars have a length"


@pytest.mark.long
def test_dark_and_on_paper(page: Path, look: Look) -> None:
    light, dark = (
        opened(
            look,
            page,
            MEASURE,
            1400,
            *more,
        )
        for more in ((), (DARK,))
    )
    assert brightness(light["paper"]) > 0.95
    assert brightness(dark["paper"]) < 0.15
    assert max(map(brightness, light["inks"])) < 0.7
    assert min(map(brightness, dark["inks"])) > 0.4
    paper = opened(look, page, MEASURE, 680, printed=True)
    assert paper["clipped"] == 0
    assert paper["scroll"] <= 680
    assert paper["beyond"] == []


@pytest.mark.long
def test_what_scrolls_casts_a_shadow_and_printed_headers_stay_whole(page: Path, look: Look) -> None:
    narrow, paper = look.frames(
        READABLE,
        [(page, 400, str), (page, PAPER_PX, on_paper)],
    )
    assert narrow["unsigned"] == [] and paper["broken"] == []


@pytest.mark.long
def test_ten_thousand_rows_are_searched_filtered_and_ordered(page: Path, look: Look) -> None:
    assert page.stat().st_size < 2.5e6
    seen = opened(look, page, OPEN + """
const found = { all: counted(), first: names().length, elements: document.querySelectorAll("*").length, loaded: performance.now() };
document.getElementById("more").click();
found.more = names().length;
const began = performance.now();
type("line_1 joint3 MOVED"); found.search = counted(); found.stuck = column("verdict");
found.took = performance.now() - began;
type(""); choose("verdict", "far"); found.far = counted(); order("value"); order("value"); found.falling = column("value");
choose("verdict", "all"); choose("cause", "not readable"); found.unreadable = counted();
choose("cause", "all"); choose("source", "pick"); found.source = [...new Set(column("source"))];
choose("source", "all"); document.querySelector(".jump[data-cause='1']").click();
found.jumped = [counted(), ...new Set(column("verdict"))];
type("<b>"); found.none = names().length;
return found;
""")  # fmt: skip
    assert seen["all"] == f"{COUNT} of {COUNT}"
    assert (seen["first"], seen["more"]) == (100, 200)
    assert seen["elements"] < 3000, "a page with all rows in it would take seconds to show"
    rows = rows_like(COUNT)
    check_searched(seen, rows)
    check_far_ones(seen, rows)
    failed = [row for row in rows if row["kind"] == "failed"]
    assert seen["unreadable"].startswith(f"{len(failed)} of")
    assert seen["source"] == ["pick <b>cubes"]
    assert seen["none"] > 0, "what was typed is text"


def check_searched(seen: dict[str, Any], rows: list[dict[str, Any]]) -> None:
    """Words find the stuck joints of one source, and a cause's link those of all."""
    stuck = [row for row in rows if row["reason_codes"] == ["stuck"]]
    of_one = sum(row["source"] == SOURCES[0] for row in stuck)
    assert seen["search"] == f"{of_one} of {COUNT}"
    assert set(seen["stuck"]) == {"not identifiable: stuck"}
    assert seen["jumped"] == [f"{len(stuck)} of {COUNT}", "not identifiable: stuck"]


def check_far_ones(seen: dict[str, Any], rows: list[dict[str, Any]]) -> None:
    """What lies far from the others is filtered, and ordered with the heaviest first [g]."""
    far = [row for row in rows if row["verdict"] == "accepted" and row["value"] > 0.6]
    assert seen["far"] == f"{len(far)} of {COUNT}"
    assert len(far) > 5
    falling = [float(value) for value in seen["falling"]]
    assert falling == sorted(falling, reverse=True)
    heaviest = max(row["value"] for row in far)
    assert falling[0] == pytest.approx(1e3 * heaviest, abs=0.1)


@pytest.mark.long
def test_a_row_says_all_about_itself_and_a_dot_opens_its_row(page: Path, look: Look) -> None:
    seen = opened(look, page, OPEN + """
choose("verdict", "failed"); names()[0].click();
const failed = document.querySelector(".detail").innerText;
choose("verdict", "far");
const far = names()[0].textContent, place = document.querySelector("[data-dots]");
names()[0].click();
const detail = document.querySelector(".detail").innerText;
// the highest dot of the first plot
const dots = place.querySelector("path.agreeing.dots"), to = dots.getScreenCTM();
const points = [...dots.getAttribute("d").matchAll(/M([-\\d.e]+),([-\\d.e]+)/g)].map((each) => [+each[1], +each[2]]);
const [x, y] = points.reduce((a, b) => (b[1] < a[1] ? b : a));
const about = { clientX: to.a * x + to.e, clientY: to.d * y + to.f, bubbles: true };
const chart = place.querySelector("svg.chart");
chart.dispatchEvent(new PointerEvent("pointerdown", about));
chart.dispatchEvent(new PointerEvent("pointerup", about));
chart.dispatchEvent(new MouseEvent("click", about));
return { failed, far, detail, shown: names().map((each) => each.textContent), value: column("value"), open: all(".detail").length,
  axis: place.textContent, figure: place.querySelector("figcaption").textContent };
""")  # fmt: skip
    assert (
        "not readable as a ROS 2 bag" in seen["failed"]
        and "proprio check /data/line_1/" in seen["failed"]
    )
    assert (
        f"proprio replay /data/line_1/{seen['far']} --calibration arm.yaml --set 'payload.com=[0, 0, 0.01]' --report"
        in seen["detail"]
    )
    assert (
        "guessed, not stated: payload.com" in seen["detail"]
        and "0 to 12 s; joint1, joint2, joint3" in seen["detail"]
    )
    highest = max((row for row in rows_like(COUNT) if seen["figure"].startswith(row["source"].split("/")[-1])
                   and row["verdict"] == "accepted"), key=lambda row: row["value"])  # fmt: skip
    assert seen["shown"] == [highest["episode"]]
    assert seen["open"] == 1
    assert float(seen["value"][0]) == pytest.approx(1e3 * highest["value"], abs=0.1)
    assert "days since 2026-05-28 20:" in seen["axis"]


@pytest.mark.long
def test_the_policy_lets_both_scripts_of_the_page_run_and_no_other(
    page: Path, look: Look, tmp_path: Path
) -> None:
    copy = tmp_path / "copy.html"
    copy.write_text(
        page.read_text().replace("</h1>", "</h1><script>document.title = 'run'</script>", 1)
    )
    shown = look.shown(copy)
    assert (
        'class="tip"' in shown
        and f"{COUNT} of {COUNT}" in shown
        and "<title>run</title>" not in shown
    )


def test_causes_have_counts_and_what_to_do(tmp_path: Path) -> None:
    rows = rows_like(400)
    page = page_of(tmp_path, rows).read_text()
    words = " ".join(
        re.sub(
            r"<[^>]*>",
            " ",
            page[: page.index("id=all")],
        ).split()
    )
    for code, count in (("too wide", "too_wide"), ("stuck", "stuck"), ("unreadable", "unreadable")):
        own = sum(row["verdict"] != "accepted" and row["reason_codes"] == [count] for row in rows)
        assert f"{code}: {own} ({100 * own / 400:.1f} %)" in html.unescape(words)
    assert (
        "What to do: Push with more current" in words
        and "proprio check " in words
        and "says what is in it" in words
    )
    assert (
        "<b>cubes" not in page
        and "</script><script>" not in page[: page.rindex("</script><script>")]
    )


@pytest.mark.parametrize(("step_ns", "axis"), [
    (1, "rows in their order"), (10**9, "rows in their order"), (60 * 10**9, "minutes since 2026-05-28 20:26 UTC"),
    (HOUR_NS, "hours since"), (30 * HOUR_NS, "days since"),
])  # fmt: skip
def test_the_time_axis_suits_what_it_shows(tmp_path: Path, step_ns: int, axis: str) -> None:
    rows = [row for row in rows_like(60) if row["source"] == SOURCES[0]]
    for n, row in enumerate(rows):
        row["recorded_ns"] = (
            None if row["kind"] == "failed" else 1_780_000_000_000_000_000 + n * step_ns
        )
    assert axis in page_of(tmp_path, rows).read_text()


def test_what_to_look_at_is_what_is_far_off_and_then_each_cause_in_turn() -> None:
    rows = rows_like(3000)
    found = odd(rows)
    far = [row for row in found if row["verdict"] == "accepted"]
    assert found[: len(far)] == far and {row["episode"] for row in far} == {
        r["episode"] for r in rows if (r["value"] or 0) > 0.6
    }
    assert [row["reason_codes"][0] for row in found[len(far) : len(far) + 4]] in (
        ["too_wide", "stuck"] * 2,
        ["stuck", "too_wide"] * 2,
    )


@pytest.mark.parametrize("rows", [0, 1])
def test_a_batch_without_an_answer_has_a_page(tmp_path: Path, rows: int) -> None:
    only = [row for row in rows_like(400) if row["kind"] == "failed"][:rows]
    page = page_of(tmp_path, only).read_text()
    assert (
        f"0 of {rows} accepted" in page
        and json.loads(re.findall(r"id=data>(.*?)</script>", page)[0])["rows"].__len__() == rows
    )
