"""The page of a calibration: complete, self-contained, and honest about calibrations that are none."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.pages import read

from proprio_ros.calibration_files.one_joint import JointCalibration
from proprio_ros.errors import ConfigurationError
from proprio_ros.identification.calibration_estimate import CalibrationEstimate, EmptyHandEstimate
from proprio_ros.identification.estimate import Verdict
from proprio_ros.pipeline.calibrate import calibrate_from_bags
from proprio_ros.report import write_calibration_report


@pytest.fixture(scope="module")
def estimate(bags: Path) -> CalibrationEstimate:
    folders = sorted(bags.glob("realistic_s00_empty_0[0-5]_*"))
    return calibrate_from_bags([folder / "bag_mcap" for folder in folders], {})


@pytest.mark.long
def test_everything_is_on_the_page(estimate: CalibrationEstimate, tmp_path: Path) -> None:
    path = tmp_path / "page.html"
    write_calibration_report(
        estimate, path, command="proprio calibrate <bag>", sources=["one & two"]
    )
    reader, words = read(path)
    assert reader.tags.count("svg") == 4
    for sentence in (*estimate.reasons, *estimate.not_separated, *estimate.notes):
        assert sentence in words
    for row in estimate.unknowns:
        assert row.label in words
    for plan in estimate.advice:
        assert plan.reason in words
    assert "proprio calibrate <bag>" in words
    assert "one & two" in words
    assert "accepted" in words
    rounded = re.findall(r">(-?[\d.]+) ± ([\d.]+)<", path.read_text())
    assert len(rounded) == 2 * len(estimate.unknowns)
    for value, error in rounded:
        assert len(value.partition(".")[2]) <= len(error.partition(".")[2]) + 1, (
            f"{value} ± {error}: digits are noise"
        )


@pytest.mark.long
def test_names_are_escaped(estimate: CalibrationEstimate, tmp_path: Path) -> None:
    evil = replace(estimate, robot="<script>alert(1)</script>", reasons=("a < b & c",))
    write_calibration_report(evil, tmp_path / "page.html")
    _, words = read(tmp_path / "page.html")
    assert "a < b & c" in words
    assert "<script>alert(1)</script>" in words


def test_a_calibration_that_is_none_has_a_page_too(tmp_path: Path) -> None:
    none = CalibrationEstimate(
        "arm", Verdict.NOT_IDENTIFIABLE, ("no run can be used",), 3, None, notes=("it stuck",)
    )
    write_calibration_report(none, tmp_path / "page.html")
    words = read(tmp_path / "page.html")[1]
    assert "not identifiable" in words
    assert "no run can be used" in words
    assert "it stuck" in words


def test_motions_that_the_others_weigh_are_listed_with_their_loads(tmp_path: Path) -> None:
    runs = ({"name": "up", "duration_s": 9.0, "load_kg": 0.49, "read_kg": 0.52, "std_kg": 0.0286},)
    joint = JointCalibration(
        "pendulum",
        1.0,
        np.zeros(6),
        np.zeros((1, 6)),
        0.03,
        0.01,
        runs,
    )
    weighed = (EmptyHandEstimate("up", 0.52, 0.0286, 1.96),)
    servo = CalibrationEstimate(
        "servo", Verdict.ACCEPTED, (), 1, None, joint=joint, weighed_empty=weighed
    )
    write_calibration_report(servo, tmp_path / "page.html")
    assert "up 490 g 520 g ± 56 g" in read(tmp_path / "page.html")[1]


def test_a_page_that_cannot_be_written(estimate: CalibrationEstimate, tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"--report .* cannot be written"):
        write_calibration_report(estimate, tmp_path / "nowhere" / "page.html")
