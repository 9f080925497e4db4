"""The page about the conformance set, from its table: what is bent, how it is asked, and what is right."""

from __future__ import annotations

import re
import sys
from collections import defaultdict
from collections.abc import Callable, Iterable
from itertools import groupby
from pathlib import Path
from typing import Any

TESTS = Path(__file__).resolve().parents[1] / "test"
Table = Callable[[tuple[str, ...], list[Any]], str]
ABOUT = """# Conformance

Recordings in which one thing has gone wrong, and what is right of each: a set that this package passes (`pytest
test/conformance`), and that another tool can be asked, too.

- **Recordings** are named below; `test/support/known/bases.py` has the command of each. Those under `bags/` ship with the
  package; real ones of other people's machines do not, and rows that need them are skipped without.
- **Bends** are functions of `test/support/bends/`, which turn a bag into another and say what they do. "In LOADED" means that
  the empty hand's recording stays.
- **Rows** of one bend for which the same is right stand together, with the first one's trouble; `test/conformance/rows` has
  each with its parameters.
- **Right** are the verdicts ([Results](results.md#verdicts)). *Unreadable* is a refusal as the recording is read, exit code 2;
  *any* is every verdict and this, *no answer* all but `accepted`. Wherever an answer is given, its 95 % interval has to hold
  the truth. A refusal carries one of the codes ([Refusals](refusals.md)), where any stand there. *Named*: what is said names
  this cause, and none that leads astray; each row has regular expressions for both.

To ask another tool, write `asked` of `test/support/known/asking.py` for it: of a command and its files the verdict, the value,
the interval and the message."""
ANSWERLESS = {"too_wide", "rejected", "not_identifiable", "unreadable"}


def page(note: str, table: Table) -> str:
    """Its text.

    Args:
        note: That it is generated.
        table: Of titles and rows a table in Markdown.
    """
    sys.path.insert(0, str(TESTS))
    from conformance.table import all_rows
    from support.known.bases import BASES

    parts = [note, ABOUT, "## Recordings"]
    parts.append(table(("name", "recordings"), _recordings(BASES.values())))
    for section, rows in groupby(all_rows(), key=lambda row: row.section):
        titles = ("trouble", "recordings", "bends", "right")
        parts += [f"## {section}", table(titles, _together(rows))]
    return "\n\n".join(parts) + "\n"


def _recordings(bases: Iterable[Any]) -> list[tuple[str, str]]:
    """Recordings that differ by their masses or files alone stand together."""
    alike: dict[str, list[str]] = defaultdict(list)
    for base in bases:
        about = re.sub(r" \([\w, ]+\)$", "", base.about)
        about = re.sub(r"\b[\d.]+ (k?g)\b", r".. \1", about)
        alike[about.replace("; uncalibrated", "").replace("; calibrated", "")].append(base.name)
    return [(_codes(names), about) for about, names in alike.items()]


def _together(rows: Iterable[Any]) -> list[tuple[str, str, str, str]]:
    """Rows of the same bends for which the same is right are one row."""
    alike: dict[tuple[str, str], list[Any]] = defaultdict(list)
    for row in rows:
        alike[_bent(row), _right(row)].append(row)
    return [
        (
            found[0].trouble,
            _codes(row.base for row in found),
            bends,
            right,
        )
        for (bends, right), found in alike.items()
    ]


def _codes(names: Iterable[str]) -> str:
    return ", ".join(f"`{name}`" for name in dict.fromkeys(names))


def _bent(row: Any) -> str:
    """Bends of a row, and whether it asks or makes something of its own."""
    found = [_one_bend(each) for each in row.bends]
    if row.make is not None and row.make.__doc__:
        found.append(row.make.__doc__.splitlines()[0].rstrip("."))
    if row.command:
        found.append("asked by a command of its own")
    if row.more:
        found.append(f"further: `{' '.join(row.more)}`")
    return "; ".join(found)


def _one_bend(bent: Any) -> str:
    where = "" if len(bent.of) > 1 else f", in {bent.of[0].upper()}"
    return f"`{bent.name}`" + where


def _verdicts(verdicts: tuple[str, ...]) -> str:
    if set(verdicts) == ANSWERLESS:
        return "no answer"
    if set(verdicts) == ANSWERLESS | {"accepted"}:
        return "any"
    return " or ".join(verdicts)


def _right(row: Any) -> str:
    found = [_verdicts(row.verdicts)]
    if row.codes:
        found.append(" or ".join(f"`{code}`" for code in row.codes))
    if row.cause or row.unsaid:
        found.append("named")
    if row.zeros_move:
        found.append("in the interval for zeros that moved, where one is given")
    if row.narrow is not None:
        found.append(f"at most {row.narrow:g} half wide")
    if row.pending:
        found.append(f"*not yet: {row.pending}*")
    return "; ".join(found)
