"""What every page is made of: style, tables, lists, figures, and a file that is either whole or as it was before."""

from __future__ import annotations

import base64
import hashlib
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

from proprio_ros.errors import together
from proprio_ros.inputs.resources import WRITTEN_BY, check_page, write_in_one_step
from proprio_ros.quantity import Z95, spec_for, written
from proprio_ros.version import __version__

SCRIPT = Path(__file__).with_name("chart.js").read_text(encoding="utf-8")
"""Of ``chart.py``; the only script of most pages."""


def policy(*scripts: str) -> str:
    """A browser loads nothing for the page, and runs no other scripts in it."""
    digests = (
        base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in scripts
    )
    allowed = " ".join(f"'sha256-{digest}'" for digest in digests)
    return f"default-src 'none'; style-src 'unsafe-inline'; script-src {allowed}"


STYLE = Path(__file__).with_name("page.css").read_text(encoding="utf-8")
"""Of every page: bright, dark, narrow and on paper."""


@dataclass(frozen=True)
class Own:
    """Style and script that only one kind of page has."""

    style: str = ""
    script: str = ""


def document(
    title: str,
    parts: Sequence[str],
    own: Own | None = None,
) -> str:
    """One page that needs nothing from elsewhere.

    Args:
        title: Of the page.
        parts: HTML, in their order.
        own: Rules of the style sheet that only this page has.
    """
    own = own or Own()
    scripts = [SCRIPT, own.script] if own.script else [SCRIPT]
    head = (
        "<!doctype html>",
        '<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">',
        WRITTEN_BY,
        f'<meta http-equiv="Content-Security-Policy" content="{policy(*scripts)}">',
        f"<title>{escape(title)}</title><style>{STYLE}{own.style}</style></head><body>",
    )
    tail = "".join(f"<script>{script}</script>" for script in scripts)
    return "\n".join([*head, *parts, f"{tail}</body></html>"])


def write_document(
    path: Path,
    title: str,
    parts: Sequence[str],
    option: str,
    force: bool = False,
    own: Own | None = None,
) -> None:
    """Write a page.

    Args:
        path: Of the page; an older page of that name is replaced in one step.
        title: Of the page.
        parts: HTML, in their order.
        option: Of the command line, for messages.
        force: Whether another file of that name is replaced, too.
        own: As in `document`.

    Raises:
        ConfigurationError: Another file is there, or it cannot be written; the option is what named it.
    """
    check_page(path, option, force)
    write_in_one_step(path, document(title, parts, own), option)


def provenance(
    command: str,
    sources: Sequence[str],
    timing_s: Mapping[str, float],
) -> list[str]:
    """How to get this result again.

    Args:
        command: The command line.
        sources: Names of what the result came from.
        timing_s: Seconds by what took them.
    """
    parts = ["<h2>To get this again</h2>"]
    if command:
        parts.append(f"<pre>{escape(command)}</pre>")
    if sources:
        named = ", ".join(f"<code>{escape(str(source))}</code>" for source in sources)
        parts.append(f"<p class=small>Recordings: {named}</p>")
    timing = ", ".join(f"{name} {1e3 * seconds:.0f} ms" for name, seconds in timing_s.items())
    return [
        *parts,
        f"<p class=small>proprio_ros {escape(__version__)}{'; ' * bool(timing)}{escape(timing)}</p>",
    ]


def bulleted(sentences: Sequence[str]) -> list[str]:
    """Sentences as a list, or nothing."""
    items = [escape(sentence).replace("+-", "±") for sentence in sentences]
    return ["<ul>" + "".join(f"<li>{item}</li>" for item in items) + "</ul>"] if items else []


def listed(title: str, sentences: Sequence[str]) -> list[str]:
    """A section of sentences, or nothing."""
    return [f"<h2>{escape(title)}</h2>", *bulleted(together(sentences))] if sentences else []


def titled(title: str, verdict: str, words: str) -> list[str]:
    """The headline with the verdict in its colour.

    Args:
        title: The words.
        verdict: Its code, which is its class, too.
        words: The verdict in words.
    """
    return [
        f"<h1>{escape(title)}</h1>",
        f'<span class="verdict {escape(verdict)}">{escape(words)}</span>',
    ]


def plotted(title: str, svg: str, caption: str) -> list[str]:
    """A section of one large figure.

    Args:
        title: Of the section.
        svg: The figure.
        caption: What to look for.
    """
    return [f"<h2>{escape(title)}</h2>", framed(svg, caption, "large")]


def framed(svg: str, caption: str = "", size: str = "") -> str:
    """A figure, with a sentence below it.

    Args:
        svg: The figure.
        caption: What to look for.
        size: ``large`` (scrolls where there is no room), or ``small-one``.
    """
    words = f"<figcaption class=small>{escape(caption)}</figcaption>" if caption else ""
    return f"<figure{f' class={size}' if size else ''}>{svg}{words}</figure>"


def bars(rows: Sequence[tuple[str, float, str]]) -> str:
    """A bar per row: its label, its length, and what is written beside it."""
    longest = max((length for _, length, _ in rows), default=0.0) or 1.0
    body = "".join(
        f"<tr><td>{breakable(label)}</td><td><i style='width:{100.0 * length / longest:.1f}%'></i></td>"
        f"<td class=number>{escape(words)}</td></tr>"
        for label, length, words in rows
    )
    return f"<table class=bars><tbody>{body}</tbody></table>"


def percent(share: float) -> str:
    """A share, 0 to 1, as a reader wants it."""
    return "under 0.1 %" if share < 0.001 else f"{100.0 * share:.{0 if share > 0.0995 else 1}f} %"


def table(
    header: Sequence[str],
    rows: Sequence[Sequence[str]],
    numbers: Iterable[int],
    ids: Sequence[str] = (),
    labels: int = 0,
) -> str:
    """Rows of text.

    Args:
        header: One word a column.
        rows: Of text.
        numbers: Columns that are set to the right.
        ids: Of the rows, for links.
        labels: How many first columns say what a row is of. Where there are any, a row becomes a block of lines on a narrow screen,
            each with its column's name; a table without scrolls there.
    """
    right = set(numbers)
    marks = [f' id="{escape(one)}"' for one in ids] or [""] * len(rows)

    def cell(column: int, words: str, tag: str) -> str:
        """One cell of the table.

        Args:
            column: Its number.
            words: What stands there.
            tag: ``td`` or ``th``.
        """
        kind = "label" if column < labels else "number" if column in right else ""
        if column < labels and column in right:
            kind = '"label number"'
        named = f' data-name="{escape(header[column])}"' if labels and tag == "td" else ""
        return f"<{tag}{f' class={kind}' if kind else ''}{named}>{breakable(words)}</{tag}>"

    def cells(row: Sequence[str], tag: str) -> str:
        return "".join(cell(column, words, tag) for column, words in enumerate(row))

    head = f"<thead><tr>{cells(header, 'th')}</tr></thead>" if any(header) else ""
    body = "".join(
        f"<tr{mark}>{cells(row, 'td')}</tr>" for row, mark in zip(rows, marks, strict=True)
    )
    return f"<div class=wide><table{' class=folds' if labels else ''}>{head}<tbody>{body}</tbody></table></div>"


def breakable(words: str) -> str:
    """A cell's words, in which a long name may break where folders do."""
    return (
        re.sub(r"(?<=[/_])(?=\w)", "<wbr>", escape(words))
        if len(max(words.split(), key=len, default="")) > 24
        else escape(words)
    )


def number(value: Any, std: Any = None) -> str:
    """A number with as many digits as its standard deviation leaves, six where there is none; a dash where there is no number."""
    if value is None or value != value:
        return "-"
    if isinstance(value, list):
        stds = std if isinstance(std, list) else [std] * len(value)
        parts = [number(v, s) for v, s in zip(value, stds, strict=True)]
        return f"[{', '.join(parts)}]"
    if isinstance(std, float) and 100.0 <= Z95 * std < math.inf:
        value = round(value, 1 - math.floor(math.log10(Z95 * std)))
    return written(value, spec_for("", std, kept=True))


def within(value: float, std: float) -> str:
    """A number and its standard deviation, to the same digit."""
    return f"{number(value, std)} ± {number(std, std)}"
