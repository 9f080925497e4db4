"""Limits of length on the documentation, words that it does without, and the glossary that has the others."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import figures
import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
PAGES = REPOSITORY / "docs" / "pages"
FIRST_READ = (
    REPOSITORY / "README.md",
    *(PAGES / f"{name}.md" for name in ("index", "recordings", "arm", "payload", "which_way")),
)
"""What somebody reads who has never seen the package."""
LONGEST_SENTENCE = 35
WORDS_AT_MOST = {"CHANGELOG.rst": 3_000, "docs/pages/validation.md": 5_000}
ALL_PAGES_AT_MOST = 50_000
BY_HAND_AT_MOST = 36_000
"""Without pages that a program writes from parser, forms, topics, codes and rows."""
OLD_WORDS = {
    r"told": "a message, a verdict, or stated",
    r"cures?": "remedy",
    r"odd": "unusual",
    r"doubt(s|ed|ful)?": "uncertain, or contradicted",
    r"free swings?": "free response",
    r"last words?": "the hold watchdog",
    r"(held|holding) joints?": "locked joint",
}
"""What a textbook would call otherwise, and how."""


def text_of(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def is_generated(path: Path) -> bool:
    """Whether a program of `docs` writes all of this page from the code or from results."""
    return text_of(path).startswith("<!-- written by docs/")


def word_count(text: str) -> int:
    """Of what a reader reads: bars of tables and marks of headings and lists are no words."""
    return sum(bool(re.search(r"\w", word)) for word in text.split())


def prose(text: str) -> str:
    """A page without code, generated tables, comments, and quotations."""
    for left_out in (r"^```.*?^```", r"<!--.*?-->", r"^>.*?$"):
        text = re.sub(left_out, "", text, flags=re.DOTALL | re.MULTILINE)
    return text


def blocks(text: str) -> Iterator[str]:
    """Paragraphs, headings, items of lists and cells of tables, each on one line."""
    gathered: list[str] = []
    for line in [*prose(figures.BLOCK.sub("", text)).splitlines(), ""]:
        stripped = line.strip()
        is_item = re.match(r"([-*]|\d+\.)\s", stripped)
        if not stripped or stripped[0] in "#|" or is_item:
            yield " ".join(gathered)
            gathered = []
        if stripped.startswith("|"):
            yield from stripped.strip("|").split("|")
        elif stripped.startswith("#"):
            yield stripped.lstrip("# ")
        elif stripped:
            gathered.append(re.sub(r"^([-*]|\d+\.)\s+", "", stripped))


def sentences(text: str) -> Iterator[str]:
    """Of a page; a link counts as its words, and code as a name of as many words."""
    for block in blocks(text):
        words = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", block)
        words = re.sub(r"`([^`]*)`", lambda code: " ".join("Code" for _ in code[1].split()), words)
        yield from re.split(r"(?<=[.!?])[\"*)]*\s+(?=[A-Z\"*(])", words)


def length(sentence: str) -> int:
    return sum(bool(re.search(r"\w", word)) for word in sentence.split())


def test_sentences_are_split_and_counted_as_a_reader_would() -> None:
    text = "# A title\n\nOne two, [three four](a.md). `five six` is seven.\n\n* *Item.* It ends\n  here.\n\n| a b | c |\n"
    found = [sentence for sentence in sentences(text) if sentence.strip()]
    assert [length(each) for each in found] == [2, 4, 4, 1, 3, 2, 1]
    assert not any(map(str.strip, sentences("```\na b c\n```\n> quoted\n")))


@pytest.mark.parametrize("path", FIRST_READ, ids=lambda path: path.stem)
def test_no_sentence_is_too_long_for_a_first_reading(path: Path) -> None:
    long = [each for each in sentences(text_of(path)) if length(each) > LONGEST_SENTENCE]
    assert long == []


@pytest.mark.parametrize(("name", "most"), WORDS_AT_MOST.items())
def test_a_document_has_its_limit_of_words(name: str, most: int) -> None:
    assert word_count(text_of(REPOSITORY / name)) <= most


def test_all_pages_together_have_a_limit_of_words() -> None:
    pages = list(PAGES.rglob("*.md"))
    by_hand = [path for path in pages if not is_generated(path)]
    assert sum(word_count(text_of(path)) for path in by_hand) <= BY_HAND_AT_MOST
    assert sum(word_count(text_of(path)) for path in pages) <= ALL_PAGES_AT_MOST


@pytest.mark.parametrize(
    "path",
    [REPOSITORY / "README.md", REPOSITORY / "CHANGELOG.rst", *sorted(PAGES.rglob("*.md"))],
    ids=lambda path: path.stem,
)
def test_words_are_those_of_the_field(path: Path) -> None:
    text = re.sub(r"`[^`]*`", "", prose(text_of(path)))
    found = {word: better for word, better in OLD_WORDS.items() if re.search(rf"\b{word}\b", text)}
    assert not found


def glossary() -> list[list[str]]:
    """Word, names in the code, and meaning of each row of the glossary but for the last table."""
    text = text_of(PAGES / "glossary.md").split("## Contracts")[0]
    rows = [line.strip("|").split("|") for line in text.splitlines() if line.startswith("| ")]
    return [[cell.strip() for cell in row] for row in rows if row[0].strip() != "word"]


def test_the_glossary_says_what_each_word_means_and_has_it_once() -> None:
    words = [word for word, *_ in glossary()]
    assert len(words) == len(set(words)) > 40
    assert all(meaning for *_, meaning in glossary())


def test_names_of_the_glossary_are_in_the_code() -> None:
    package = REPOSITORY / "proprio_ros"
    code = {path: path.read_text(encoding="utf-8") for path in package.rglob("*.py")}
    together = "\n".join(code.values())
    for word, names, _ in glossary():
        for name in re.findall(r"`([^`]+)`", names):
            if "/" in name:
                assert (package / name).is_file(), f"{word}: {name}"
            else:
                assert re.search(rf"\b{name}\b", together), f"{word}: {name}"
