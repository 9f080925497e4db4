"""The page about the conformance set, from its table: what is bent, how it is asked, and what is right."""

from __future__ import annotations

import sys
from collections.abc import Callable
from itertools import groupby
from pathlib import Path
from typing import Any

TESTS = Path(__file__).resolve().parents[1] / "test"
Table = Callable[[tuple[str, ...], list[Any]], str]
ABOUT = """# Conformance

Recordings in which one thing has gone wrong, and what is right to say of each: a set that this package passes
(`pytest test/conformance`), and that another tool can be asked, too.

- **Recordings** are named below, with the command. Those under `bags/` ship with the package; real ones of other people's machines
  do not, and rows that need them are skipped without.
- **Bends** are functions of `test/support/bends/`, which turn a bag into another; parameters stand beside them. "In LOADED" means
  that the empty hand's recording stays as it is.
- **Right** are the verdicts ([Results](results.md#verdicts)); *unreadable* is a refusal in one sentence as the recording is read,
  exit code 2. Wherever an answer is given, its 95 % interval has to hold the truth. A refusal carries one of the
  codes ([Refusals](refusals.md)), where any stand there, and what is said names the cause: it matches the regular expression.

To ask another tool, write `asked` of `test/support/known/asking.py` for it: of a command and its files the verdict, the
value, the interval and what was said."""


def page(note: str, table: Table) -> str:
    """Its text.

    Args:
        note: That it is generated.
        table: Of titles and rows a table in Markdown.
    """
    sys.path.insert(0, str(TESTS))
    from conformance.table import all_rows
    from support.bends.bend import all_bends
    from support.known.bases import BASES

    parts = [note, ABOUT, "## Recordings"]
    bases = [
        (f"`{base.name}`", base.about, f"{base.truth:g}", _code(base.command))
        for base in BASES.values()
    ]
    parts.append(table(("name", "recordings", "truth, SI", "command"), bases))
    for section, rows in groupby(all_rows(), key=lambda row: row.section):
        cells = [(row.trouble, f"`{row.base}`", _bent(row), _right(row)) for row in rows]
        titles = ("trouble", "recordings", "bends", "right")
        parts += [f"## {section}", table(titles, cells)]
    bends = [(f"`{bend.name}`", bend.kind, bend.meaning) for bend in all_bends().values()]
    parts += ["## Bends", table(("name", "kind", "what it does"), bends)]
    return "\n\n".join(parts) + "\n"


def _code(words: tuple[str, ...]) -> str:
    return f"`proprio {' '.join(words)}`"


def _bent(row: Any) -> str:
    """Bends of a row, with parameters, and the command where it has its own."""
    found = [_one_bend(each) for each in row.bends]
    if row.make is not None and row.make.__doc__:
        found.append(row.make.__doc__.splitlines()[0].rstrip("."))
    if row.command:
        found.append(f"asked: {_code(row.command)}")
    if row.more:
        found.append(f"further: `{' '.join(row.more)}`")
    return "; ".join(found)


def _one_bend(bent: Any) -> str:
    parameters = ", ".join(f"{name} {value}" for name, value in bent.parameters.items())
    where = "" if len(bent.of) > 1 else f", in {bent.of[0].upper()}"
    return f"`{bent.name}` {parameters}".strip() + where


def _right(row: Any) -> str:
    found = [" or ".join(row.verdicts)]
    if row.codes:
        found.append(" or ".join(f"`{code}`" for code in row.codes))
    if row.cause:
        found.append(f"says `{row.cause}`")
    if row.unsaid:
        found.append(f"never says `{row.unsaid}`")
    if row.narrow is not None:
        found.append(f"at most {row.narrow:g} half wide")
    if row.pending:
        found.append(f"*not yet: {row.pending}*")
    return "; ".join(found)
