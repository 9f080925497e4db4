"""Units as people write them, and numbers as they are shown."""

from __future__ import annotations

import pytest

from proprio_ros.cli.parser import make_parser
from proprio_ros.pipeline.request import Options
from proprio_ros.quantity import EFFORTS, POSITIONS, unit_called
from proprio_ros.recordings.effort import Effort

WRITTEN = {
    "N.m": ("N.m", "Nm", "N*m", "N m", "N·m", "N-m", "nm", "Newton-metre", "newton meters", "N"),
    "A": ("A", "a", "amp", "Amps", "ampere", "Amperes"),
    "mA": ("mA", "ma", "milliamps", "Milli-Ampere"),
    "raw": ("raw", "counts", "count"),
}


@pytest.mark.parametrize(
    ("text", "name"), [(text, name) for name, texts in WRITTEN.items() for text in texts]
)
def test_a_unit_of_effort_is_known_however_it_is_written(text: str, name: str) -> None:
    assert unit_called(text, EFFORTS) == name
    assert Options(effort_unit=text).effort_unit == name
    assert Effort(text, {}).unit == name
    asked = make_parser().parse_args(["check", "BAG", "--effort-unit", text])
    assert asked.effort_unit == name


@pytest.mark.parametrize("text", ["mNm", "kN m", "lbf", "", "m", "uA", "kA", "%", "N/m", "N m/A"])
def test_another_unit_is_not_taken_for_one_that_is_known(text: str) -> None:
    assert unit_called(text, EFFORTS) == text
    with pytest.raises(SystemExit):
        make_parser().parse_args(["check", "BAG", "--effort-unit", text])


def test_units_of_positions_are_known_however_they_are_written() -> None:
    written = {"Radians": "rad", "radian": "rad", "Degrees": "degree", "°": "degree"}
    assert {text: unit_called(text, POSITIONS) for text in written} == written
