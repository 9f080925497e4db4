"""The page: complete, self-contained, and honest about results that are none."""

from __future__ import annotations

import re
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from proprio_ros.errors import ConfigurationError
from proprio_ros.identification.estimate import Estimate, Value, Verdict
from proprio_ros.replay import ReplayOptions, replay, write_report

sys.path.insert(0, str(Path(__file__).parent))

from pages import read


@pytest.fixture(scope="module")
def estimate() -> Estimate:
    root = Path(__file__).resolve().parents[2] / "bags"
    return replay([root / "quantised_s00_fixed_heavy_ball_50g_joint3" / "bag_mcap"], ReplayOptions())


def test_an_accepted_result(estimate: Estimate, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    write_report(estimate, page, command="proprio replay BAG", sources=["BAG"])
    reader, text = read(page)
    value = estimate.value("payload_mass")
    assert f"best guess {1e3 * value.value:.0f} g" in text and f"0 to {1e3 * value.ci95[1]:.0f} g" in text
    assert "accepted" in text and "proprio replay BAG" in text
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
        assert reason in text
    assert reader.tags.count("svg") == 4
    assert page.stat().st_size < 600_000
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
        run_fits=(replace(estimate.run_fits[0], name=hostile),),
        values=(*estimate.values, Value("payload_com", "m", [0.01, None, -0.002], [0.001, None, 0.002], None, hostile)),
        verdict=Verdict.REJECTED,
    )
    write_report(named, tmp_path / "page.html", command=hostile, sources=[hostile])
    reader, text = read(tmp_path / "page.html")
    assert "script" not in reader.tags and hostile in text
    assert "[10.0, ?, -2.0] mm" in text


def test_a_page_that_cannot_be_written(estimate: Estimate, tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="exists and is writable"):
        write_report(estimate, tmp_path / "nowhere" / "page.html")
    with pytest.raises(ConfigurationError, match="cannot be written"):
        write_report(estimate, tmp_path)
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


def test_an_older_page_survives_until_the_new_one_is_whole(estimate: Estimate, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    page.write_text("old")
    write_report(estimate, page)
    assert page.read_text().startswith("<!doctype html>")
