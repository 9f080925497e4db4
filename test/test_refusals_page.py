"""The page of refusals has every code and every class of errors, each with what the user sees of it and what to do."""

from __future__ import annotations

import json
import re
from pathlib import Path

import messages
import pytest
from refusals_page import classes
from support.documents import page

from proprio_ros.cli import main
from proprio_ros.errors import ProprioError
from proprio_ros.identification.reasons import CODES

BAGS = Path(__file__).resolve().parents[1] / "bags"
PUSH = str(BAGS / "quantised_s00_fixed_heavy_ball_50g_joint3" / "bag_mcap")
UNSAID = {"other", "ProprioError"}
"""What is never said as such."""


def sections() -> dict[str, str]:
    """What the page says, by heading."""
    _, *parts = re.split(r"^###? (.*)$", page("refusals"), flags=re.MULTILINE)
    return dict(zip(parts[::2], parts[1::2], strict=True))


def every_class(of: type[Exception] = ProprioError) -> set[str]:
    """Names of a class of errors of the package and of all that stand on it."""
    below = [each for each in of.__subclasses__() if each.__module__ == "proprio_ros.errors"]
    return {of.__name__}.union(*map(every_class, below))


def test_every_code_and_every_class_has_its_section() -> None:
    assert len(CODES) > 45
    assert len(every_class()) == len(classes()) == 10
    assert set(sections()) == set(CODES) | every_class() | {"Classes of errors"}


@pytest.mark.parametrize("name", [*CODES, *classes()])
def test_a_section_says_what_is_seen_why_and_what_to_do(name: str) -> None:
    why, *said, do = sections()[name].strip().split("\n\n")
    assert len(why.split()) > 3
    assert re.fullmatch(r"\*\*What to do\*\*: \S.*\.", do)
    assert len(said) == (name not in UNSAID)
    for sentence in said:
        own = re.findall(r"[a-zA-Z]{2,}", sentence)
        assert len(own) >= 3, "of its words hardly one is known before the program runs"
    if name in CODES:
        assert why.rstrip(".").lower() == CODES[name].meaning.lower()
        assert CODES[name].remedy in do


def test_what_the_page_quotes_is_what_the_program_says(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", PUSH, "--probe", "payload", "--json"]) == 3
    answer = json.loads(capsys.readouterr().out)
    said = dict(zip(answer["reason_codes"], answer["reasons"], strict=True))
    assert {"not_calibrated", "never_reversed"} <= said.keys()
    for code in ("not_calibrated", "never_reversed"):
        (quoted,) = re.findall(r"^> (.*)$", sections()[code], re.MULTILINE)
        words = map(re.escape, quoted.split(".."))
        assert re.match(".*".join(words), said[code]), quoted


def test_names_that_stand_for_words_are_followed() -> None:
    said = messages.of_reasons()
    assert any("as while motors warm up" in sentence for sentence in said["changed_along"])
    assert any("says .., they say .." in sentence for sentence in said["runs_contradict"])
