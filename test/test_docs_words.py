"""Limits of length on the documentation, words that it does without, and the glossary that has the others."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from pathlib import Path

import figures
import pytest
from support.documents import (
    FENCED,
    FOLDER,
    PACKAGE,
    PAGES,
    README,
    REPOSITORY,
    page,
    place_of,
    text_of,
)

CHANGELOG = REPOSITORY / "CHANGELOG.rst"
CONTRIBUTING = REPOSITORY / "CONTRIBUTING.md"
FIRST_READ = (
    README,
    FOLDER / "index.md",
    FOLDER / "recordings.md",
    FOLDER / "arm.md",
    FOLDER / "payload.md",
    FOLDER / "which_way.md",
)
"""What somebody reads who has never seen the package."""
LONGEST_SENTENCE = 35
CHANGELOG_AT_MOST = 3_000
VALIDATION_AT_MOST = 5_000
ALL_PAGES_AT_MOST = 52_250
BY_HAND_AT_MOST = 37_500
"""Without pages that a program writes from parser, forms, topics, codes and rows; that of codes quotes what each says."""
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
COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)
QUOTATION = re.compile(r"^>.*?$", re.MULTILINE)
LINK = re.compile(r"!?\[([^\]]*)\]\([^)]*\)")
CODE = re.compile(r"`([^`]*)`")
ITEM = re.compile(r"^([-*]|\d+\.)\s+")
NEXT_SENTENCE = re.compile(r"(?<=[.!?])[\"*)]*\s+(?=[A-Z\"*(])")


def is_generated(path: Path) -> bool:
    """Whether a program of `docs` writes all of this page from the code or from results."""
    return text_of(path).startswith("<!-- written by docs/")


def word_count(text: str) -> int:
    """Of what a reader reads: bars of tables and marks of headings and lists are no words."""
    return sum(1 for word in text.split() if re.search(r"\w", word))


def words_of(paths: Iterable[Path]) -> int:
    """Of files together."""
    return sum(word_count(text_of(path)) for path in paths)


def read_prose(text: str) -> str:
    """A page without code, generated tables, comments, and quotations."""
    for left_out in (figures.BLOCK, FENCED, COMMENT, QUOTATION):
        text = left_out.sub("", text)
    return text


def blocks(text: str) -> Iterator[str]:
    """Paragraphs, headings, items of lists and cells of tables, each on one line."""
    gathered: list[str] = []
    for line in [*read_prose(text).splitlines(), ""]:
        stripped = line.strip()
        starts = not stripped or stripped[0] in "#|" or ITEM.match(stripped)
        if starts:
            yield " ".join(gathered)
            gathered = []
        if stripped.startswith("|"):
            yield from stripped.strip("|").split("|")
        elif stripped.startswith("#"):
            yield stripped.lstrip("# ")
        elif stripped:
            gathered.append(ITEM.sub("", stripped))


def as_words(code: re.Match[str]) -> str:
    """As many words as a piece of code has."""
    return " ".join(["Code"] * len(code[1].split()))


def sentences(text: str) -> list[str]:
    """Of a page; a link counts as its words, and code as a name of as many words."""
    found: list[str] = []
    for block in blocks(text):
        words = CODE.sub(as_words, LINK.sub(r"\1", block))
        found += NEXT_SENTENCE.split(words)
    return [sentence for sentence in found if sentence.strip()]


def test_sentences_are_split_and_counted_as_a_reader_would() -> None:
    heading = "# A title\n\n"
    paragraph = "One two, [three four](a.md). `five six` is seven.\n\n"
    item = "* *Item.* It ends\n  here.\n\n"
    table = "| a b | c |\n"
    found = sentences(heading + paragraph + item + table)
    assert list(map(word_count, found)) == [2, 4, 4, 1, 3, 2, 1]
    assert sentences("```\na b c\n```\n> quoted\n") == []


@pytest.mark.parametrize("path", FIRST_READ, ids=place_of)
def test_no_sentence_is_too_long_for_a_first_reading(path: Path) -> None:
    long = [each for each in sentences(text_of(path)) if word_count(each) > LONGEST_SENTENCE]
    assert long == []


def test_changelog_and_validation_have_a_limit_of_words() -> None:
    assert word_count(text_of(CHANGELOG)) <= CHANGELOG_AT_MOST
    assert word_count(page("validation")) <= VALIDATION_AT_MOST


def test_all_pages_together_have_a_limit_of_words() -> None:
    by_hand = [path for path in PAGES if not is_generated(path)]
    assert words_of(by_hand) <= BY_HAND_AT_MOST
    assert words_of(PAGES) <= ALL_PAGES_AT_MOST


@pytest.mark.parametrize("path", [README, CHANGELOG, CONTRIBUTING, *PAGES], ids=place_of)
def test_words_are_those_of_the_field(path: Path) -> None:
    text = CODE.sub("", read_prose(text_of(path)))
    for word, better in OLD_WORDS.items():
        assert not re.search(rf"\b{word}\b", text), better


def glossary() -> list[list[str]]:
    """Word, names in the code, and meaning of each row of the glossary but for the last table."""
    own, _, _ = page("glossary").partition("## Contracts")
    lines = [line.strip("| ") for line in own.splitlines() if line.startswith("| ")]
    rows = [re.split(r" ?\| ", line) for line in lines]
    return [row for row in rows if row[0] != "word"]


def test_the_glossary_says_what_each_word_means_and_has_it_once() -> None:
    words = [word for word, _, _ in glossary()]
    assert len(words) == len(set(words)) > 40
    assert all(meaning for _, _, meaning in glossary())


def test_names_of_the_glossary_are_in_the_code() -> None:
    code = "\n".join(map(text_of, PACKAGE.rglob("*.py")))
    for word, names, _ in glossary():
        for name in CODE.findall(names):
            known = (PACKAGE / name).is_file() or re.search(rf"\b{name}\b", code)
            assert known, f"{word}: {name}"
