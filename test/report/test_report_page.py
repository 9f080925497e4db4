"""The page: complete, self-contained, and honest about results that are none."""

from __future__ import annotations

import base64
import hashlib
import html
import re
import shlex
import shutil
from dataclasses import replace
from enum import Enum
from pathlib import Path

import numpy as np
import pytest
from support.pages import curves, read

from proprio_ros.cli import main
from proprio_ros.errors import ConfigurationError
from proprio_ros.identification.calibration_estimate import HeldOutRun
from proprio_ros.identification.estimate import Estimate, Value, Verdict
from proprio_ros.pipeline.replay import replay, write_report
from proprio_ros.pipeline.request import Options
from proprio_ros.probes.softness.detail import SqueezeCurve
from proprio_ros.probes.softness.figures import squeeze_figure
from proprio_ros.quantity import shown
from proprio_ros.report import card
from proprio_ros.report.calibration_figures import held_out_figure
from proprio_ros.report.html import SCRIPT, document, within
from proprio_ros.report.pictures import paired


@pytest.fixture(scope="module")
def estimate() -> Estimate:
    root = Path(__file__).resolve().parents[2] / "bags"
    return replay([root / "quantised_s00_fixed_heavy_ball_50g_joint3" / "bag_mcap"], Options())


def test_a_result(estimate: Estimate, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    write_report(estimate, page, command="proprio replay BAG", sources=["BAG"])
    reader, text = read(page)
    value = estimate.value("payload_mass")
    assert (
        f"best guess {1e3 * value.value:.0f} g" in text
        and f"0 to {1e3 * value.ci95[1]:.0f} g" in text
    )
    assert "too wide" in text and "proprio replay BAG" in text
    for heading in (
        "Measured against simulated",
        "Convergence of every start",
        "Misfit over payload mass",
        "What was assumed",
    ):
        assert heading in text
    for row in estimate.unknowns:
        assert row.label in text
    for reason in estimate.reasons:
        assert reason.replace("+-", "±") in text
    assert [reader.classes.count(kind) for kind in ("chart", "plot", "arm")] == [3, 5, 1]
    assert page.stat().st_size < 60_000
    assert not list(tmp_path.glob(".*")), "the temporary file is gone"
    # ids of the figures do not meet
    ids = re.findall(r'\bid="([^"]+)"', page.read_text())
    assert len(ids) == len(set(ids))


def test_a_refused_recording(tmp_path: Path, bags: Path) -> None:
    stuck = replay([bags / "friction_s00_fixed_random_a_joint3" / "bag_mcap"])
    write_report(stuck, tmp_path / "page.html")
    _, text = read(tmp_path / "page.html")
    assert "not identifiable" in text and "no value" in text and "moved only 0.000 rad" in text


def test_words_of_strangers_stay_words(estimate: Estimate, tmp_path: Path) -> None:
    hostile = "<script>alert('x')</script>&\""
    named = replace(
        estimate,
        robot=hostile,
        reasons=(hostile,),
        notes=(hostile,),
        run_fits=(
            replace(
                estimate.run_fits[0],
                name=hostile,
            ),
        ),
        values=(
            *estimate.values,
            Value(
                "payload_com",
                "m",
                [0.01, None, -0.002],
                [0.001, None, 0.002],
                None,
                hostile,
            ),
        ),
        verdict=Verdict.REJECTED,
    )
    write_report(named, tmp_path / "page.html", command=hostile, sources=[hostile])
    _, text = read(tmp_path / "page.html")
    assert hostile in text
    assert "x 10.0, z -2.0 mm" in text and "?" not in text


def test_a_page_that_cannot_be_written(estimate: Estimate, tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="exists and is writable"):
        write_report(estimate, tmp_path / "nowhere" / "page.html")
    with pytest.raises(ConfigurationError, match="cannot be written"):
        write_report(estimate, tmp_path)
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


def test_an_older_page_survives_until_the_new_one_is_whole(
    estimate: Estimate, tmp_path: Path
) -> None:
    page = tmp_path / "page.html"
    page.write_text(document("old", []))
    write_report(estimate, page)
    assert "<title>old" not in page.read_text()
    page.write_text("somebody's")
    with pytest.raises(
        ConfigurationError, match=r"is no page of proprio: .* \(in Python: force=True\)"
    ):
        write_report(estimate, page)
    assert page.read_text() == "somebody's"
    write_report(estimate, page, force=True)
    assert page.read_text().startswith("<!doctype html>")


def test_a_run_is_drawn_with_its_current_and_the_arm(estimate: Estimate, tmp_path: Path) -> None:
    write_report(estimate, tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    fit = estimate.run_fits[0]
    run = estimate.recorded[0]
    [measured] = curves(page, "measured")
    assert measured == pytest.approx(np.stack([fit.times_s, fit.measured], axis=1), abs=2e-3)
    [early] = curves(page, "not fitted")
    assert (early[:, 0] < 0.0).all() and early[:, 1] == pytest.approx(run.position[0], abs=5e-3)
    [current] = curves(page, "current")
    assert current[:, 1].min() == pytest.approx(-0.301, abs=1e-3) and current[
        0, 1
    ] == pytest.approx(0.0, abs=1e-3)
    assert current[-1] == pytest.approx([run.duration_s, 0.0], abs=2e-3), "it went off"
    assert page.count('class="arm"') == 1 and "10 cm" in page


def test_a_refused_run_is_shown_as_it_was_recorded(bags: Path, tmp_path: Path) -> None:
    stuck = replay([bags / "friction_s00_fixed_random_a_joint3" / "bag_mcap"])
    assert not stuck.run_fits
    write_report(stuck, tmp_path / "page.html")
    [recorded] = curves((tmp_path / "page.html").read_text(), "recorded")
    assert len(recorded) > 20 and recorded[:, 1] == pytest.approx(0.6, abs=2e-3)
    assert "not used: see the reasons above" in read(tmp_path / "page.html")[1]


def test_runs_with_and_without_a_fit_find_each_other(estimate: Estimate) -> None:
    fit = estimate.run_fits[0]
    run = estimate.recorded[0]
    stuck = replace(run, name="stuck")
    together = replace(
        estimate,
        recorded=(stuck, run, run),
        run_fits=(fit, fit),
    )
    assert [(a is not None, b) for a, b in paired(together)] == [
        (False, stuck),
        (True, run),
        (True, run),
    ]
    assert [b for _, b in paired(replace(estimate, recorded=()))] == [None]
    namesake = replace(run, times_s=1.01 * run.times_s)
    assert [a is not None for a, _ in paired(replace(estimate, recorded=(namesake, run)))] == [
        False,
        True,
    ]


@pytest.mark.long
def test_the_search_is_drawn_as_far_as_the_answer(bags: Path, tmp_path: Path) -> None:
    """A block on a gripper that is not calibrated: with the gripper as its file states it the search ends far away."""
    options = Options(
        probe="softness",
        settings={"block.size": 0.03},
        baseline=[bags / f"realistic_s00_squeeze_empty_{n}" / "bag_mcap" for n in (0, 1)],
    )
    soft = replay([bags / "realistic_s00_squeeze_heavy" / "bag_mcap"], options)
    modulus = soft.value("youngs_modulus").value
    assert all(abs(path.end - modulus) > 0.5 * modulus for path in soft.solver.paths), (
        "or this test shows nothing"
    )
    assert soft.solver.as_json()["starts"] == len(soft.solver.paths)
    write_report(soft, tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    drawn = curves(page, "all open") + curves(page, 'start at [^"]*')
    assert min(abs(curve[-1, 1] - 1e-3 * modulus) for curve in drawn) < 0.02e-3 * modulus
    assert f"<td class=number>{1e-3 * modulus:.1f}</td>" in page, "to the digits that are known"
    words = read(tmp_path / "page.html")[1]
    assert not re.search(r"[a-z]\[\w+\]|youngs|_modulus|disturbance", words), (
        "names are for programs"
    )


def test_no_fixed_ink(bags: Path, estimate: Estimate, tmp_path: Path) -> None:
    """Every colour of a figure on the page follows the reader's scheme."""
    write_report(estimate, tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    figures = "".join(re.findall(r"<svg.*</svg>", page, flags=re.S))
    assert figures and not re.search(r"#[0-9a-f]{3,6}|black|white", figures)
    block = squeeze_figure(
        [
            SqueezeCurve(
                "a",
                0.03,
                np.arange(3.0),
                np.arange(3.0) / 30.0,
                np.arange(3.0),
                (),
            )
        ]
    )
    assert "var(--ink)" in block and not re.search(r"#1b2430|#000000|#8a94a3|#e4e8ee", block)


def test_numbers_have_the_digits_that_they_are_known_to() -> None:
    assert within(204674.0, 11223.0) == "205000 ± 11000", (
        "tenths of a percent of a modulus are noise"
    )
    assert (within(-1e-5, 0.001), within(0.00089, 5.9e-5)) == (
        "0.0000 ± 0.0010",
        "0.00089 ± 0.00006",
    )
    assert (shown("kg", -1e-6), shown("kg", -0.02)) == ("0.00 g", "-20.00 g")


def test_dollar_signs_are_no_mathematics() -> None:
    named = [
        SqueezeCurve(
            name,
            0.03,
            np.arange(3.0),
            np.arange(3.0) / 30.0,
            np.arange(3.0),
            (),
        )
        for name in ("$a_{1}$", "b")
    ]
    assert "$a_{1}$" in squeeze_figure(named)
    assert "$x^2$/run" in held_out_figure((HeldOutRun("$x^2$/run", "joint3", 1e-3, 1.0),))


@pytest.mark.parametrize(("value", "words"), [("too_wide", "too wide"), ("brand_new", "brand new")])
def test_verdicts_that_the_page_does_not_know(
    estimate: Estimate, tmp_path: Path, value: str, words: str
) -> None:
    other = Enum("Other", {"NEW": value}, type=str).NEW
    write_report(replace(estimate, verdict=other), tmp_path / "page.html")
    assert words in read(tmp_path / "page.html")[1]
    assert f'class="verdict {value}"' in (tmp_path / "page.html").read_text()
    assert words in card("title", other, estimate.values, ())


def test_the_command_can_be_pasted_into_a_shell(bags: Path, tmp_path: Path) -> None:
    folder = tmp_path / "x$(touch PWNED)y and $more$ <b>"
    shutil.copytree(bags / "quantised_s00_fixed_heavy_ball_50g_joint3", folder)
    page = tmp_path / "page.html"
    given = [
        "replay",
        str(folder / "bag_mcap"),
        "--probe",
        "payload",
        "--report",
        str(page),
    ]
    assert main(given) in (0, 3)
    [command] = re.findall(
        r"<pre>(.*?)</pre>",
        page.read_text(),
        flags=re.S,
    )
    assert shlex.split(html.unescape(command)) == ["proprio", *given]
    assert f"'{folder / 'bag_mcap'}'" in html.unescape(command)
    words = read(page)[1]
    assert f"{folder.name}/bag_mcap" in words


def test_the_browser_is_to_load_nothing_and_to_run_nothing_else() -> None:
    digest = base64.b64encode(hashlib.sha256(SCRIPT.encode()).digest()).decode()
    page = document("title", [])
    assert f"default-src 'none'; style-src 'unsafe-inline'; script-src 'sha256-{digest}'" in page
    assert not re.search(r"https?://", page)
