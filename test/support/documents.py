"""The documentation's files, and their text without what is no prose."""

from __future__ import annotations

import re
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
PACKAGE = REPOSITORY / "proprio_ros"
FOLDER = REPOSITORY / "docs" / "pages"
README = REPOSITORY / "README.md"
PAGES = sorted(FOLDER.rglob("*.md"))
QUESTIONS = sorted((FOLDER / "validation").glob("*.md"))
FENCED = re.compile(r"^```.*?^```", re.DOTALL | re.MULTILINE)


def text_of(path: Path) -> str:
    """Of a file."""
    return path.read_text(encoding="utf-8")


def page(name: str) -> str:
    """The text of a page."""
    return text_of(FOLDER / f"{name}.md")


def place_of(path: Path) -> str:
    """Where a file is in the repository: its name in a test's."""
    return str(path.relative_to(REPOSITORY))


def prose(path: Path) -> str:
    """The text of a file without blocks of code."""
    return FENCED.sub("", text_of(path))
