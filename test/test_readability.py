"""What the code may cost its readers: tokens of a line and of a function, locals, decisions, arguments that nobody explains.

`support.readability` counts what folding cannot change. The exceptions are functions that were over a limit when the limit came;
one that no longer is has to leave the list, and none may be added.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import pytest
from support.readability import Density, density_of

REPOSITORY = Path(__file__).resolve().parents[1]
EXCEPTIONS = Path(__file__).resolve().parent / "support" / "readability_exceptions.txt"
"""A line each: what is over, and the function, as in "tokens proprio_ros/robot/urdf.py:read"."""
KINDS = ("tokens", "locals", "decisions", "silent")
FOLDERS = ("proprio_ros", "test")


@lru_cache
def measured(folder: str) -> Density:
    return density_of(REPOSITORY / folder)


@lru_cache
def over(kind: str) -> frozenset[str]:
    """Functions over a limit; tests need not explain their arguments."""
    if kind == "silent":
        return frozenset(f"proprio_ros/{name}" for name in measured("proprio_ros").silent)
    return frozenset(
        f"{folder}/{name}" for folder in FOLDERS for name in measured(folder).over(kind)
    )


@lru_cache
def excepted(kind: str) -> frozenset[str]:
    rows = (line.split(" ", 1) for line in EXCEPTIONS.read_text().splitlines())
    return frozenset(name for what, name in rows if what == kind)


@pytest.mark.parametrize(("folder", "most"), [("proprio_ros", 8.0), ("test", 8.5)])
def test_tokens_of_a_line(folder: str, most: float) -> None:
    assert measured(folder).tokens_per_line <= most


@pytest.mark.parametrize(("folder", "most"), [("proprio_ros", 0.015), ("test", 0.019)])
def test_lines_that_say_more_than_one_thing(folder: str, most: float) -> None:
    assert measured(folder).dense_share <= most


@pytest.mark.parametrize(("folder", "most"), [("proprio_ros", 80), ("test", 130)])
def test_assignments_of_several_values(folder: str, most: int) -> None:
    assert measured(folder).pairs <= most


@pytest.mark.parametrize(("folder", "most"), [("proprio_ros", 30), ("test", 30)])
def test_walruses(folder: str, most: int) -> None:
    assert measured(folder).walruses <= most


@pytest.mark.parametrize("kind", KINDS)
def test_no_function_is_harder_to_read(kind: str) -> None:
    added = over(kind) - excepted(kind)
    assert not added, f"over the limit of {kind}: {sorted(added)}"


@pytest.mark.parametrize("kind", KINDS)
def test_the_exceptions_shrink(kind: str) -> None:
    gone = excepted(kind) - over(kind)
    assert not gone, (
        f"no longer over the limit of {kind}, take them from {EXCEPTIONS.name}: {sorted(gone)}"
    )


def test_the_measure_counts_what_folding_cannot_change(tmp_path: Path) -> None:
    folded = "def area(a, b, c):\n    return [x for x in (a, b, c) if x and x > 0]\n"
    unfolded = (
        "def area(\n    a,\n    b,\n    c,\n):\n    # positive\n"
        "    return [\n        x for x in (a, b, c)\n        if x and x > 0\n    ]\n"
    )
    counted = []
    for name, source in (("folded", folded), ("unfolded", unfolded)):
        folder = tmp_path / name
        folder.mkdir()
        (folder / "area.py").write_text(source)
        counted.append(density_of(folder))
    # the comma behind the last argument is one more
    assert counted[1].tokens == counted[0].tokens + 1
    assert counted[0].silent == counted[1].silent == ["area.py:area"]
    assert counted[0].arguments == 1 and counted[1].lines > counted[0].lines
