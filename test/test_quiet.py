"""No answer comes with a warning of numpy's (in all tests that is an error), and nothing is longer than a person reads at once."""

from __future__ import annotations

import contextlib
import io
import json
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import answers
import pytest

from proprio_ros.cli import main

pytestmark = pytest.mark.long
LONGEST = 250
BAGS = Path(__file__).resolve().parents[1] / "bags"


def said(words: list[str]) -> tuple[str, str]:
    """What a command writes to stdout and stderr where a warning is an error."""
    out = io.StringIO()
    err = io.StringIO()
    with (
        warnings.catch_warnings(),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        warnings.simplefilter("error", RuntimeWarning)
        main(words)
    return out.getvalue(), err.getvalue()


def sentences(said: Any) -> Iterator[str]:
    """All texts in what ``--json`` prints."""
    if isinstance(said, str):
        yield said
    elif isinstance(said, (dict, list)):
        for each in said.values() if isinstance(said, dict) else said:
            yield from sentences(each)


@pytest.fixture
def heard(monkeypatch: pytest.MonkeyPatch) -> set[str]:
    """The sentences of all answers that `answers` asks for."""
    found: set[str] = set()

    def answer(words: list[str]) -> dict[str, Any]:
        found.update(sentences(json.loads(said([*words, "--json"])[0])))
        return {}

    monkeypatch.setattr(answers, "answer", answer)
    return found


def test_of_the_recordings_that_come_with_it(heard: set[str], tmp_path: Path) -> None:
    assert len(list(answers.answers([BAGS]))) > 50
    bags = sorted(map(str, BAGS.glob("*/bag_mcap")))
    robot = tmp_path / "robot.yaml"
    arm = str(tmp_path / "arm.yaml")
    commands = [
        ["check", *bags],
        ["plan", "--mass", "0.05", "--count", "2", "--seconds", "1"],
        ["plan", "--mass", "0.05", "--robot", "so101", "--count", "1", "--seconds", "1"],
        ["robot", "new", str(BAGS.parent / "urdf" / "so101.urdf"), "--output", str(robot),],
        ["calibrate", *(bag for bag in bags if "s00_empty_" in bag), "--output", arm, "--report", f"{arm}.html",],
        ["batch", *bags[:6], "--out", str(tmp_path / "out"), "--jobs", "1",],
        *(["replay", bag, "--probe", "payload", "--report", str(tmp_path / "page.html")] for bag in bags[:6]),
    ]  # fmt: skip
    for words in commands:
        for line in "".join(said(words)).splitlines():
            assert len(line) <= LONGEST or any(name in line for name in bags), line
            assert "Warning" not in line
            assert "Traceback" not in line
    assert [sentence for sentence in heard if len(sentence) > LONGEST] == []
