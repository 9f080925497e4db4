"""Cells of the paper's page: what stands for many seeds, and tables whose rows can be linked to."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from proprio_ros.addons.paper.cases import Rows
from proprio_ros.report.html import table

# of series in one plot, classes of the style sheet
COLORS = ("agreeing", "answer", "current", "measured", "apart")
STATES = ((False, "as stated"), (True, "calibrated"))


def identified(
    rows: Sequence[Rows],
    scale: float,
    digits: int = 1,
) -> list[str]:
    """Cells of one way over the seeds: value, error, interval, how many hold the truth, verdicts.

    Args:
        rows: Of one way, a row a seed.
        scale: From SI to the table's unit.
        digits: After the point.
    """
    value = over([row["value"] for row in rows], scale, digits)
    return [
        value,
        rms(rows, scale, digits),
        half(rows, scale, digits),
        holds(rows),
        verdicts(rows),
    ]


def linked(
    name: str,
    header: Sequence[str],
    rows: Sequence[Sequence[str]],
    numbers: Sequence[int],
    labels: int = 1,
) -> str:
    """A table whose rows can be linked to: by its name and what stands in the first ``labels`` cells.

    Args:
        name: Of the table.
        header: Titles of the columns.
        rows: Cells.
        numbers: Which columns are numbers.
        labels: How many cells say which row it is.
    """
    ids = [slug(name, *row[:labels]) for row in rows]
    return table(header, rows, numbers, ids, labels)


def slug(*words: str) -> str:
    """Of letters, digits and hyphens."""
    text = " ".join(words).lower().replace("'", "")
    return re.sub(r"[^a-z0-9.]+", "-", text).strip("-")


def over(
    values: Sequence[float | None],
    scale: float = 1.0,
    digits: int = 1,
) -> str:
    """Mean and standard deviation over seeds.

    Args:
        values: One a seed; None where there is none.
        scale: From SI to the table's unit.
        digits: After the point.
    """
    known = scale * np.array([value for value in values if value is not None])
    if not len(known):
        return "-"
    middle = f"{known.mean():.{digits}f}"
    return f"{middle} \u00b1 {known.std(ddof=1):.{digits}f}" if len(known) > 1 else middle


def rms(
    rows: Sequence[Rows],
    scale: float,
    digits: int = 1,
) -> str:
    """Root mean square of the errors, and the least and the greatest of them.

    Args:
        rows: Of one way, a row a seed.
        scale: From SI to the table's unit.
        digits: After the point.
    """
    off = [abs(row["value"] - row["truth"]) for row in rows if row["value"] is not None]
    if not off:
        return "-"
    return ranged(float(np.sqrt(np.mean(np.square(off)))), off, scale, digits)


def ranged(
    middle: float,
    values: Sequence[float],
    scale: float,
    digits: int,
) -> str:
    """A number for many, with the least and the greatest of them.

    Args:
        middle: The number.
        values: Those that it stands for.
        scale: From SI to the table's unit.
        digits: After the point.
    """
    word = f"{scale * middle:.{digits}f}"
    if len(values) < 2:
        return word
    return f"{word} ({scale * min(values):.{digits}f} to {scale * max(values):.{digits}f})"


def holds(rows: Sequence[Rows]) -> str:
    """How many intervals hold the truth, of those that there are."""
    known = [row for row in rows if row["low"] is not None]
    held = sum(row["low"] <= row["truth"] <= row["high"] for row in known)
    return f"{held} of {len(known)}" if known else "no interval"


def half(
    rows: Sequence[Rows],
    scale: float,
    digits: int = 1,
) -> str:
    """Half the width of the intervals: median, least and greatest.

    Args:
        rows: Of one way, a row a seed.
        scale: From SI to the table's unit.
        digits: After the point.
    """
    known = [0.5 * (row["high"] - row["low"]) for row in rows if row["low"] is not None]
    return "\u00b1" + ranged(float(np.median(known)), known, scale, digits) if known else "-"


def verdicts(rows: Sequence[Rows]) -> str:
    """How many of each."""
    words = [row["verdict"].replace("_", " ") for row in rows if row["verdict"]]
    return ", ".join(f"{words.count(word)} {word}" for word in dict.fromkeys(words)) or "gives none"


def flat(found: Sequence[Rows], **labels: Any) -> list[Rows]:
    """Rows of all seeds that have these labels."""
    every = [row for rows in found for row in rows["rows"]]
    return [row for row in every if all(row[key] == value for key, value in labels.items())]


def labels(found: Sequence[Rows], key: str) -> list[Any]:
    """Values of a label, in their order."""
    return list(dict.fromkeys(row[key] for rows in found for row in rows["rows"]))
