"""README's and the validation page's tables of figures, from what benchmarks kept in `results/*.json`, and from nothing else.

A page has ``<!-- results: NAME -->`` and ``<!-- end of results -->``; what stands between them is replaced. NAME is one of `VIEWS`,
or FILE.TABLE: a table of a file as the benchmark prints it, with the command, the date and the commit that made it. To measure
anew: ``python test/benchmarks/coverage.py --robots 500 --per-effect 0 --json docs/results/coverage.json``, then
``python docs/generate.py``.
"""

from __future__ import annotations

import functools
import json
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

RESULTS = Path(__file__).resolve().parent / "results"
BLOCK = re.compile(r"(<!-- results: (.+?) -->\n).*?(<!-- end of results -->)", re.DOTALL)
Row = tuple[str, str, str, str]
"""What was asked, the error, what is said of the interval, and the section of the validation page."""


@functools.cache
def kept(name: str) -> dict[str, Any]:
    """What a run of a benchmark kept."""
    content: dict[str, Any] = json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8"))
    return content


def numbers(name: str, table: str, **where: Any) -> dict[str, Any]:
    """The one row of a table whose numbers are these.

    Raises:
        LookupError: None is, or several are.
    """
    rows = [row for row in kept(name)["tables"][table]["rows"] if where.items() <= row.items()]
    if len(rows) != 1:
        raise LookupError(f"{name}.json, {table}: {len(rows)} rows with {where}")
    found: dict[str, Any] = rows[0]
    return found


def cells(
    columns: Mapping[str, str],
    row: Mapping[str, Any],
) -> list[str]:
    """A row as a page shows it: each column's words with the row's numbers; `-` where a number is missing."""
    missing = {key for key, value in row.items() if value is None or value != value}
    return [
        "-" if any(f"{{{key}" in words for key in missing) else words.format(**row)
        for words in columns.values()
    ]


def line(words: list[str]) -> str:
    """A row of a table in Markdown."""
    return f"| {' | '.join(words)} |"


def markdown(table: Mapping[str, Any]) -> str:
    """A table in Markdown."""
    columns = table["columns"]
    rows = [line(cells(columns, row)) for row in table["rows"]]
    return "\n".join([line(list(columns)), "|" + "---|" * len(columns), *rows])


def source(name: str) -> str:
    """Command, date and commit of a file."""
    run = kept(name)
    commit = f", commit {run['commit']}" if run["commit"] else ""
    return f"`{run['command']}`; {run['date']}{commit}."


def shown(name: str) -> str:
    """What a block holds."""
    if name in VIEWS:
        return VIEWS[name]()
    file, _, table = name.partition(".")
    return f"{source(file)}\n\n{markdown(kept(file)['tables'][table])}"


def filled(text: str) -> str:
    """A page with its blocks as they should be."""
    return BLOCK.sub(lambda block: f"{block[1]}\n{shown(block[2])}\n\n{block[3]}", text)


# --- the summary --------------------------------------------------------------------------------------------------------


def _all(held: int, of: int) -> str:
    return f"all {of}" if held == of else f"{held} of {of}"


def _span(values: list[float], digits: int = 2) -> str:
    sizes = sorted(map(abs, values))
    return f"{sizes[0]:.{digits}f} to {sizes[-1]:.{digits}f}"


def _two(table: str, **where: Any) -> list[dict[str, Any]]:
    return [
        numbers("simulated", table, level=level, **where)
        for level in ("realistic_s00", "realistic_s01")
    ]


def _real(*asked: str) -> list[dict[str, Any]]:
    return [numbers("real", "real", asked=row) for row in asked]


def _together(
    rows: list[dict[str, Any]],
    digits: int = 1,
) -> tuple[str, str, int, int]:
    """Largest error and half intervals [%] of several rows, how many hold, and how many were answered."""
    errors = [each for row in rows for each in row["errors"]]
    halves = [each for row in rows for each in row["half_intervals"]]
    worst = f"worst {max(map(abs, errors)):.{digits}f} %"
    return (
        worst,
        f"{_span(halves, digits)} % half wide",
        sum(row["hold"] for row in rows),
        sum(row["given"] for row in rows),
    )


def _simulated() -> list[Row]:
    found = []
    for words, known in (
        (
            "mass of 10 to 50 g, calibrated on 16 empty runs (two simulated robots)",
            "calibrated on its empty runs",
        ),
        ("the same, and three runs with a 100 g reference", "and on three with 100 g"),
    ):
        one, two = _two("weighing", known=known)
        answered = one["answered"] + two["answered"]
        asked = one["asked"] + two["asked"]
        holds = (
            f"{_all(one['hold'] + two['hold'], answered)}; {asked - answered} of {asked} refused"
        )
        found.append((words, f"rms {one['rms']:.2f} and {two['rms']:.2f} g", holds, "weighing"))
    many = numbers(
        "coverage", "coverage", robots=kept("coverage")["tables"]["coverage"]["rows"][0]["robots"]
    )
    found.append((
        f"mass of 10 to 100 g, {many['robots'].partition(',')[0]} random robots, {many['answered']} answers of {many['asked']}",
        f"rms {many['rms']:.2f} g, median {many['median']:.2f} g", f"{many['hold']:.1f} ± {many['margin']:.1f} %",
        "do-the-intervals-hold",
    ))  # fmt: skip
    boxes = _two("container")
    found.append((
        "sphere in a closed box, three recordings together (two robots)",
        f"{_span([error for row in boxes for error in row['together_errors']])} g",
        _all(sum(row["together_hold"] for row in boxes), sum(row["together_answered"] for row in boxes),), "what-is-in-the-box",
    ))  # fmt: skip
    blocks = _two("blocks")
    halves = [row[key] for row in blocks for key in ("half_from", "half_to")]
    found.append((
        "Young's modulus of a soft block, one squeeze (two robots)", f"{_span([e for row in blocks for e in row['errors']], 1)} %",
        f"{_all(sum(row['hold'] for row in blocks), sum(row['answered'] for row in blocks))}; {_span(halves, 0)} % half wide",
        "soft-blocks",
    ))  # fmt: skip
    rows = kept("squeezes")["tables"]["squeezes"]["rows"]
    found.append((
        f"the same, three squeezes by {rows[0]['asked']} random grippers", f"rms {_span([r['rms'] for r in rows], 1)} %",
        f"{sum(row['hold'] for row in rows)} of {sum(row['answered'] for row in rows)}", "soft-blocks",
    ))  # fmt: skip
    inside = numbers("contents", "contents", kind="all")
    refused = inside["recordings"] - inside["answered"]
    found.append((
        f"what is in an upright container, {inside['recordings']} recordings: liquids and grains of particles, rigid things",
        f"mass: rms {inside['rms']:.1f} g; rigid or moving said {inside['said']} times, right {inside['right']}",
        f"{_all(inside['hold'], inside['answered'])}; {refused} refused", "what-is-in-a-container",
    ))  # fmt: skip
    arms = numbers("so101", "so101", held="all")
    found.append((
        "ten simulated SO-101 that record goals and positions alone, 30 Hz; nothing to 200 g",
        f"rms {arms['rms']:.1f} g, worst {arms['worst']:.1f} g",
        f"{_all(arms['hold'], arms['answered'])}; {arms['asked'] - arms['answered']} refused", "servos-that-a-voltage-drives",
    ))  # fmt: skip
    return found


def _recorded() -> list[Row]:
    found = []
    for words, asked, section in (
        (
            "a real UR10e in motion, 2.805 kg, against each of three empty recordings",
            ("UR10e, 2.805 kg, `--baseline`",),
            0,
        ),
        ("15 s of it, against each", ("the same, 15 s",), 0),
        (
            "a real servo that lets go of a pendulum, calibrated on two or three other loads of 0.5 to 1.2 kg",
            ("STS3215 let go, 2 loads known", "STS3215 let go, 3 loads known"),
            1,
        ),
        (
            "real hobby servos that no current drives (XL330, STS3215), by others with known loads",
            tuple(
                f"{name} driven, {known} known"
                for name, other in (("XL330", "gain"), ("STS3215", "load"))
                for known in (f"motions under another {other}", "other motions", "all others")
            ),
            2,
        ),
    ):
        rows = _real(*asked)
        worst, halves, held, given = _together(rows)
        questions = sum(row["questions"] for row in rows)
        refused = f"; {questions - given} of {questions} refused" if given < questions else ""
        where = ("while-several-joints-move", "free-response", "servos-that-a-voltage-drives")[
            section
        ]
        found.append((words, worst, f"{_all(held, given)}; {halves}{refused}", where))
    every = numbers("real", "real", asked="all")
    found.append((
        f"{every['questions']} questions to recordings of five real machines", f"{every['given']} answered, the rest refused",
        f"{every['hold']} of {every['given']}, the farthest {every['farthest']:.1f} sd off", "real-recordings",
    ))  # fmt: skip
    return found


def _rows() -> list[Row]:
    return [*_simulated(), *_recorded()]


IN_README = (
    "random robots",
    "closed box",
    "one squeeze",
    "SO-101",
    "UR10e in motion",
    "five real machines",
)
"""Words of the rows that README has; the validation page has all."""


def readme() -> str:
    """README's table."""
    chosen = [row for row in _rows() if any(words in row[0] for words in IN_README)]
    rows = [line([asked, error, holds]) for asked, error, holds, _ in chosen]
    return "\n".join([line(["what", "error", "the 95 % interval holds"]), "|---|---|---|", *rows])


def summary() -> str:
    """The validation page's first table."""
    rows = [
        line([f"[{asked}](#{section})", error, holds]) for asked, error, holds, section in _rows()
    ]
    return "\n".join([line(["what", "error", "the 95 % interval holds"]), "|---|---|---|", *rows])


# --- speed --------------------------------------------------------------------------------------------------------------


def speed() -> str:
    """One table of all parts of the comparison."""
    tables = kept("speed")["tables"]
    machine = kept("speed")["machine"]
    rows = [
        line([row["what"], row["fastest"] or "-", row["median"] or "-", row["ratio"], row["note"]])
        for table in tables.values()
        for row in table["rows"]
    ]
    said = (
        f"{source('speed')[:-1]}; {machine['cores']} cores, load {machine['load']} when it began."
    )
    return "\n".join(
        [
            said,
            "",
            line(["what", "fastest", "median", "beside it", ""]),
            "|---|---|---|---|---|",
            *rows,
        ]
    )


def speed_in_short() -> str:
    """README's sentence."""
    tables = kept("speed")["tables"]

    def of(part: str, what: str) -> dict[str, Any]:
        (found,) = [row for row in tables[part]["rows"] if row["what"].startswith(what)]
        return dict(found)

    fit = of("ours", "ours: five-start fit")
    scipy = of("scipy", "scipy solve_ivp")
    return (
        f"A five-start fit of one recording takes {fit['fastest']} on a CPU; SciPy's `solve_ivp` and `least_squares` take "
        f"{scipy['ratio'].partition('x')[0]} times as long."
    )


VIEWS: dict[str, Callable[[], str]] = {
    "readme": readme,
    "summary": summary,
    "speed": speed,
    "speed in short": speed_in_short,
}
