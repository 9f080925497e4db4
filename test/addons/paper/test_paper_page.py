"""The command that runs the paper's experiments: what is kept is not computed twice, and what is on the page was computed.

The short tests put toy experiments in the place of the real ones. The long one runs the command on one seed and asks the rows for
the truth, within the spread that they state.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import redirect_stderr
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from paper_results import as_markdown, label
from support.pages import read
from support.paper_rows import synthetic

from proprio_ros.addons.paper import cases, page, quoted, store
from proprio_ros.addons.paper.cases import Rows
from proprio_ros.addons.paper.experiments import EXPERIMENTS, Experiment
from proprio_ros.addons.paper.searches import tree_parzen
from proprio_ros.addons.paper.store import Store, run, tasks_of
from proprio_ros.cli import main
from proprio_ros.errors import SimulationError
from proprio_ros.report.html import STYLE

DOCS = Path(__file__).resolve().parents[3] / "docs"


@pytest.fixture
def toys(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[tuple[str, int]]]:
    """Two experiments, the second of at most two seeds; what was computed."""
    called: list[tuple[str, int]] = []

    def toy(name: str) -> Any:
        def compute(seed: int) -> Rows:
            called.append((name, seed))
            return {"rows": [{"seed": seed, "square": seed**2}]}

        return compute

    for name in list(EXPERIMENTS):
        monkeypatch.delitem(EXPERIMENTS, name)
    monkeypatch.setitem(EXPERIMENTS, "first", Experiment(toy("first")))
    monkeypatch.setitem(
        EXPERIMENTS,
        "second",
        Experiment(toy("second"), seeds=2),
    )
    yield called


def test_a_restart_computes_nothing_twice(
    tmp_path: Path,
    toys: list[tuple[str, int]],
) -> None:
    told: list[str] = []
    found = run(
        Store(tmp_path),
        [],
        3,
        1,
        told.append,
    )
    assert sorted(toys) == [("first", 0), ("first", 1), ("first", 2), ("second", 0), ("second", 1)]
    assert [rows["rows"][0]["square"] for rows in found["first"]] == [0, 1, 4]
    assert told[0].endswith("0 of them done before")
    assert told[-1].startswith("5 of 5: ")
    # stopped while it wrote: that file is of no use, the others are
    (tmp_path / "rows" / "first_001.json").write_text('{"experiment": "fir')
    del toys[:]
    again = run(
        Store(tmp_path),
        [],
        4,
        1,
        told.append,
    )
    assert sorted(toys) == [("first", 1), ("first", 3)]
    assert [rows["rows"] for rows in again["first"][:3]] == [
        rows["rows"] for rows in found["first"]
    ]
    assert again["second"] == found["second"]
    del toys[:]
    run(
        Store(tmp_path),
        ["second"],
        4,
        1,
        told.append,
    )
    assert toys == []


def test_rows_of_other_code_are_computed_again(
    tmp_path: Path,
    toys: list[tuple[str, int]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    run(
        Store(tmp_path),
        [],
        1,
        1,
        lambda words: None,
    )
    monkeypatch.setattr(store, "code", lambda: "other")
    run(
        Store(tmp_path),
        [],
        1,
        1,
        lambda words: None,
    )
    assert toys == [("first", 0), ("second", 0)] * 2


def test_an_experiment_that_cannot_be_made_is_told_and_left_out(
    tmp_path: Path,
    toys: list[tuple[str, int]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fails(seed: int) -> Rows:
        raise SimulationError(f"robot {seed} stood still")

    monkeypatch.setitem(EXPERIMENTS, "second", Experiment(fails, seeds=1))
    told: list[str] = []
    found = run(
        Store(tmp_path),
        [],
        1,
        1,
        told.append,
    )
    assert list(found) == ["first"]
    assert any("second, seed 0: robot 0 stood still" in words for words in told)


def test_what_is_not_installed_is_said_once(
    tmp_path: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    assert main(["paper", "--out", str(tmp_path), "--seeds", "3", "--jobs", "1"]) == 2
    printed = capsys.readouterr()
    assert (
        printed.err.count("needs MuJoCo") == 1
        and printed.out == ""
        and not (tmp_path / "paper.html").exists()
    )


@pytest.mark.long
def test_what_is_not_installed_is_said_once_by_several_processes_that_end(tmp_path: Path) -> None:
    missing = tmp_path / "mujoco.py"
    missing.write_text("raise ModuleNotFoundError(\"No module named 'mujoco'\", name='mujoco')")
    words = [
        "paper",
        "--out",
        str(tmp_path / "out"),
        "--seeds",
        "3",
        "--jobs",
        "2",
    ]
    paths = os.pathsep.join([str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])])
    # it returns when nobody holds the pipes any more, and so when no process is left
    done = subprocess.run(
        [sys.executable, "-m", "proprio_ros.cli", *words],
        env={**os.environ, "PYTHONPATH": paths}, cwd=DOCS.parent, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr.count("needs MuJoCo") == 1
    assert done.stdout == ""


def test_seeds_come_one_after_the_other(toys: list[tuple[str, int]]) -> None:
    """A run that is stopped early has some of everything."""
    assert tasks_of([], 3) == [
        ("first", 0),
        ("second", 0),
        ("first", 1),
        ("second", 1),
        ("first", 2),
    ]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--only", "tables"], "--only tables: choose from objects, starts"),
        (["--seeds", "0"], "--seeds 0: choose 1 to 1000"),
        (["--jobs", "0"], "--jobs 0: choose 1 to 64"),
    ],
)
def test_what_cannot_be_run_is_refused_before_anything_is_made(
    arguments: list[str],
    words: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["paper", "--out", str(tmp_path / "made"), *arguments]) == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / "made").exists()


def test_the_page_says_where_its_recordings_come_from_and_shows_what_was_run(
    tmp_path: Path,
) -> None:
    path = tmp_path / "paper.html"
    page.write_paper_page(synthetic(), path, "proprio paper --out there", 2)
    reader, words = read(path)
    assert words.index("There is no arm here. The recordings come from MuJoCo") < words.index(
        "Table I"
    )
    assert quoted.TITLE in words
    assert "proprio paper --out there" in words
    assert (
        words.count("Table II: first guesses") == 1
        and "Figure 4" not in words
        and "V-B" not in words
    )
    # mean and standard deviation of 49 and 52 g, rms, least and greatest of their errors, and how many intervals hold
    assert (
        "50.5 \u00b1 2.1 1.6 (1.0 to 2.0) \u00b13.0 (3.0 to 3.0) 2 of 2 2 accepted 0.10 \u00b1 0.00"
        in words
    )
    assert "no interval gives none" in words
    assert reader.tags.count("h2") == 3


def test_the_page_fits_a_phone_and_a_sheet_of_paper(tmp_path: Path) -> None:
    path = tmp_path / "paper.html"
    page.write_paper_page(synthetic(), path, "proprio paper --out there", 2)
    reader, _ = read(path)
    text = path.read_text(encoding="utf-8")
    assert '<meta name="viewport" content="width=device-width, initial-scale=1">' in text
    # a table scrolls in a box of its own; one of many columns becomes a block a row, each line with its column's name
    assert reader.classes.count("wide") == reader.tags.count("table")
    for table in re.findall(r"<table.*?</table>", text):
        columns = len(re.findall("<td", re.findall(r"<tr.*?</tr>", table)[-1]))
        assert columns <= 3 or (
            "class=folds" in table and table.count("data-name") == table.count("<td")
        )
    narrow = STYLE[STYLE.index("@media (max-width: 36rem)") :]
    assert (
        ".folds td::before { content: attr(data-name)" in narrow
        and ".folds thead { display: none; }" in narrow
    )
    # nothing is wider than the screen, but what scrolls
    widths = re.findall(r"([^{}]+)\{[^{}]*(?<!max-)\bwidth: ([\d.]+)(rem|px)", STYLE)
    for selector, size, unit in widths:
        assert (
            float(size) * (16.0 if unit == "rem" else 1.0) <= 330.0 or "figure.large" in selector
        ), selector
    assert not re.search(r"<(?:svg class=.chart.|table|div|figure|img)[^>]* width=", text)
    printed = STYLE[STYLE.rindex("@media print") :]
    assert (
        "@page" in printed
        and "figure, tr, pre" in printed
        and ".wide, figure.large { overflow: visible; }" in printed
    )


def test_an_answer_without_a_value_leaves_its_place_empty(tmp_path: Path) -> None:
    """A recording that cannot tell: the others of its row are shown, and its verdict counts."""
    found = synthetic()
    found["objects"][1]["rows"][1] |= {
        "value": None,
        "low": None,
        "high": None,
        "verdict": "rejected",
    }
    path = tmp_path / "paper.html"
    page.write_paper_page(found, path, "proprio paper --out there", 2)
    _, words = read(path)
    assert "ours, one lift calibrated 49.0 1.0 \u00b13.0 1 of 1 1 accepted, 1 rejected" in words


def test_the_documentation_takes_tables_and_figures_from_the_page() -> None:
    parts = page.paper_parts(synthetic(), 2)
    words, drawn = as_markdown(parts)
    assert words.count("<table") == sum(part.count("<table") for part in parts)
    assert list(drawn) == ["table-1_1.svg"]
    assert "](figures/table-1_1.svg)" in words
    picture = drawn["table-1_1.svg"]
    assert (
        picture.startswith('<svg xmlns="http://www.w3.org/2000/svg" ') and "<script" not in picture
    )
    style = picture[picture.index("<style>") : picture.index("</style>")]
    assert (
        style.count("{") == style.count("}")
        and ".chart .dots {" in style
        and ".answer { --c" in style
    )
    assert (
        '<a id="table-2"></a>' in words
        and '<tr id="table-2-4772-as-stated"><td align=right>4772</td>' in words
    )


def test_every_row_has_an_address_of_its_own(tmp_path: Path) -> None:
    path = tmp_path / "paper.html"
    page.write_paper_page(synthetic(), path, "proprio paper --out there", 2)
    marks = re.findall(r' id="([^"]+)"', path.read_text(encoding="utf-8"))
    assert len(marks) == len(set(marks))
    assert (
        "table-1-heavy-ball-50-ours-one-lift-calibrated" in marks
        and "table-2-4772-as-stated" in marks
    )


def test_nothing_is_said_of_the_paper_that_is_not_available() -> None:
    assert page.SECTIONS.keys() == EXPERIMENTS.keys()
    assert quoted.MISSING == "not available here"


def test_tree_parzen_finds_a_valley() -> None:
    asked: list[np.ndarray] = []

    def cost(x: np.ndarray) -> float:
        asked.append(x)
        return float((x[0] - 0.7) ** 2 + 4.0 * (x[1] + 0.2) ** 2)

    low = np.array([-2.0, -2.0])
    high = np.array([2.0, 2.0])
    best = tree_parzen(
        cost,
        low,
        high,
        np.array([-1.5, 1.5]),
        np.random.default_rng(1),
    )
    assert len(asked) == 150
    assert (np.array(asked) >= low).all()
    assert (np.array(asked) <= high).all()
    np.testing.assert_allclose(
        best,
        [0.7, -0.2],
        atol=0.1,
    )


@pytest.fixture(scope="module")
def one_seed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the command keeps of starts and effects with one robot: about six seconds of computing."""
    out = tmp_path_factory.mktemp("one_seed")
    with redirect_stderr(StringIO()) as said:
        assert main(of_one_seed(out)) == 0
    assert "2 of 2: " in said.getvalue()
    return out


def of_one_seed(out: Path) -> list[str]:
    """The command's words."""
    asked = ["--seeds", "1", "--jobs", "1", "--only", "starts", "effects"]
    return ["paper", "--out", str(out), *asked]


def rows_of(out: Path, experiment: str) -> list[dict[str, Any]]:
    """The rows of the one seed."""
    text = (out / "rows" / f"{experiment}_000.json").read_text()
    rows: list[dict[str, Any]] = json.loads(text)["rows"]["rows"]
    return rows


@pytest.mark.long
def test_wherever_ours_begins_it_ends_near_the_truth(one_seed: Path) -> None:
    """At one mass; the paper's short schedule stops on its way."""
    starts = [row for row in rows_of(one_seed, "starts") if row["calibrated"]]
    ours = [row["value"] for row in starts if row["way"] == "ours"]
    assert len(ours) == len(cases.STARTS_KG)
    assert np.ptp(ours) < 1e-4
    assert abs(ours[0] - 0.05) < 0.005
    short = [row["value"] for row in starts if row["way"] == "paper, 15 iterations"]
    assert np.ptp(short[:-1]) > 0.01
    assert short[-1] > 4.5


@pytest.mark.long
def test_what_a_wrong_torque_or_friction_costs(one_seed: Path) -> None:
    """1 % of torque is 3 g, 0.01 N m of friction 5 g; with nothing wrong an error is within the encoder's noise."""
    errors = {(row["effect"], row["amount"]): row["error"] for row in rows_of(one_seed, "effects")}
    assert abs(errors["torque", 0.0]) < 5e-4
    assert errors["torque", 0.01] - errors["torque", 0.0] == pytest.approx(0.003, abs=0.001)
    assert errors["friction", 0.01] - errors["friction", 0.0] == pytest.approx(0.005, abs=0.002)


@pytest.mark.long
@pytest.mark.parametrize("experiment", ["starts", "effects"])
def test_a_clone_gives_what_the_documentation_states(one_seed: Path, experiment: str) -> None:
    """Of the same seed, within what other seeds differ by."""
    stated = json.loads((DOCS / "pages" / "figures" / "stated.json").read_text())[experiment]
    for row in rows_of(one_seed, experiment):
        seeds = np.array(stated[label(row)])
        value = row.get("value", row.get("error"))
        assert abs(value - seeds[0]) <= max(0.5 * seeds.std(ddof=1), 1e-5), (row, seeds)


@pytest.mark.long
def test_the_command_computes_no_seed_twice(
    one_seed: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    before = {path: path.stat().st_mtime_ns for path in (one_seed / "rows").iterdir()}
    assert main(of_one_seed(one_seed)) == 0
    assert "2 of them done before" in capsys.readouterr().err
    assert {path: path.stat().st_mtime_ns for path in (one_seed / "rows").iterdir()} == before
    _, words = read(one_seed / "paper.html")
    assert "Table II" in words
    assert "What the paper leaves out" in words
    assert "Table I:" not in words
