"""Tables of figures in README and on the validation pages, from what benchmarks kept in `results/`, and from nothing else;
and the design page's table of heavy libraries, from the code (`code_map`).

A page has ``<!-- results: NAME -->`` and ``<!-- end of results -->``; what stands between them is replaced. NAME is one of `VIEWS`,
or FILE.TABLE: a table of a file as the benchmark prints it, with the command, the date and the commit that made it. Behind
``where KEY=VALUE`` only those rows are shown whose number of that name is VALUE; the file keeps all of them. Files of
`results/earlier` hold tables that an earlier state of the code made and that were not measured again. To measure anew:
``python test/benchmarks/coverage.py --robots 500 --per-effect 0 --json docs/results/coverage.json``, then
``python docs/generate.py``.
"""

from __future__ import annotations

import functools
import json
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import code_map

RESULTS = Path(__file__).resolve().parent / "results"
BLOCK = re.compile(r"(<!-- results: (.+?) -->\n).*?(<!-- end of results -->)", re.DOTALL)
Row = tuple[str, str, str]
"""What was measured, the error, and what is said of the interval."""
Question = tuple[str, str, str, str]
"""A question, what was measured, the figure, and the page behind it."""


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


def line(words: Sequence[str]) -> str:
    """A row of a table in Markdown."""
    return f"| {' | '.join(words)} |"


def table_of(titles: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table in Markdown."""
    return "\n".join([line(titles), "|" + "---|" * len(titles), *map(line, rows)])


def markdown(table: Mapping[str, Any], key: str = "", value: str = "") -> str:
    """A table that a benchmark kept, in Markdown.

    Args:
        table: Its columns and rows.
        key: Of a row's numbers; empty: all rows are shown.
        value: The rows are shown whose number of that name reads so.

    Raises:
        LookupError: No row does.
    """
    rows = [row for row in table["rows"] if not key or str(row[key]) == value]
    if not rows:
        raise LookupError(f"no row with {key}={value}")
    columns = table["columns"]
    return table_of(list(columns), [cells(columns, row) for row in rows])


def source(name: str) -> str:
    """Command, date and commit of a file."""
    run = kept(name)
    if "shown_in" in run:
        return f"Earlier version: `{run['command']}`; {run['date']}, first shown in commit {run['shown_in']}."
    commit = f", commit {run['commit']}" if run["commit"] else ""
    return f"`{run['command']}`; {run['date']}{commit}."


def shown(name: str) -> str:
    """What a block holds."""
    if name in VIEWS:
        return VIEWS[name]()
    asked, _, where = name.partition(" where ")
    key, _, value = where.partition("=")
    file, _, table = asked.partition(".")
    return f"{source(file)}\n\n{markdown(kept(file)['tables'][table], key, value)}"


def filled(text: str) -> str:
    """A page with its blocks as they should be; a command that stands above one table is not repeated above others."""
    above: set[str] = set()

    def block(found: re.Match[str]) -> str:
        words = shown(found[2])
        run, _, table = words.partition("\n\n")
        if run in above:
            words = f"The same run.\n\n{table}"
        elif run.endswith("."):
            above.add(run)
        return f"{found[1]}\n{words}\n\n{found[3]}"

    return BLOCK.sub(block, text)


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
        found.append((words, f"rms {one['rms']:.2f} and {two['rms']:.2f} g", holds))
    many = numbers(
        "coverage", "coverage", robots=kept("coverage")["tables"]["coverage"]["rows"][0]["robots"]
    )
    found.append((
        f"mass of 10 to 100 g, {many['robots'].partition(',')[0]} random robots, {many['answered']} answers of {many['asked']}",
        f"rms {many['rms']:.2f} g, median {many['median']:.2f} g", f"{many['hold']:.1f} ± {many['margin']:.1f} %",
    ))  # fmt: skip
    boxes = _two("container")
    found.append((
        "sphere in a closed box, three recordings together (two robots)",
        f"{_span([error for row in boxes for error in row['together_errors']])} g",
        _all(sum(row["together_hold"] for row in boxes), sum(row["together_answered"] for row in boxes),)
    ))  # fmt: skip
    blocks = _two("blocks")
    halves = [row[key] for row in blocks for key in ("half_from", "half_to")]
    found.append((
        "Young's modulus of a soft block, one squeeze (two robots)", f"{_span([e for row in blocks for e in row['errors']], 1)} %",
        f"{_all(sum(row['hold'] for row in blocks), sum(row['answered'] for row in blocks))}; {_span(halves, 0)} % half wide",
    ))  # fmt: skip
    rows = kept("squeezes")["tables"]["squeezes"]["rows"]
    found.append((
        f"the same, three squeezes by {rows[0]['asked']} random grippers", f"rms {_span([r['rms'] for r in rows], 1)} %",
        f"{sum(row['hold'] for row in rows)} of {sum(row['answered'] for row in rows)}",
    ))  # fmt: skip
    inside = numbers("contents", "contents", kind="all")
    refused = inside["recordings"] - inside["answered"]
    found.append((
        f"what is in an upright container, {inside['recordings']} recordings: liquids and grains of particles, rigid things",
        f"mass: rms {inside['rms']:.1f} g; rigid or moving {inside['said']} times, right {inside['right']}",
        f"{_all(inside['hold'], inside['answered'])}; {refused} refused",
    ))  # fmt: skip
    arms = numbers("so101", "so101", held="all")
    found.append((
        "ten simulated SO-101 that record goals and positions alone, 30 Hz; nothing to 200 g",
        f"rms {arms['rms']:.1f} g, worst {arms['worst']:.1f} g",
        f"{_all(arms['hold'], arms['answered'])}; {arms['asked'] - arms['answered']} refused",
    ))  # fmt: skip
    return found


def _recorded() -> list[Row]:
    found = []
    for words, asked in (
        (
            "a real UR10e in motion, 2.805 kg, against each of three empty recordings",
            ("UR10e, 2.805 kg, `--baseline`",),
        ),
        ("15 s of it, against each", ("the same, 15 s",)),
        (
            "a real servo that lets go of a pendulum, calibrated on two or three other loads of 0.5 to 1.2 kg",
            ("STS3215 let go, 2 loads known", "STS3215 let go, 3 loads known"),
        ),
        (
            "real hobby servos that no current drives (XL330, STS3215), by others with known loads",
            tuple(
                f"{name} driven, {known} known"
                for name, other in (("XL330", "gain"), ("STS3215", "load"))
                for known in (f"motions under another {other}", "other motions", "all others")
            ),
        ),
    ):
        rows = _real(*asked)
        worst, halves, held, given = _together(rows)
        questions = sum(row["questions"] for row in rows)
        refused = f"; {questions - given} of {questions} refused" if given < questions else ""
        found.append((words, worst, f"{_all(held, given)}; {halves}{refused}"))
    every = numbers("real", "real", asked="all")
    found.append((
        f"{every['questions']} questions to recordings of five real machines", f"{every['given']} answered, the rest refused",
        f"{every['hold']} of {every['given']}, the farthest {every['farthest']:.1f} sd off",
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
"""Words of the rows that README has."""


def readme() -> str:
    """README's table."""
    chosen = [row for row in _rows() if any(words in row[0] for words in IN_README)]
    return table_of(("what", "error", "the 95 % interval holds"), chosen)


def _row_of(words: str) -> Row:
    """The one row of `_rows` in which these words stand."""
    (found,) = [row for row in _rows() if words in row[0]]
    return found


def _of_a_row(question: str, words: str, page: str) -> Question:
    """A question that one row of `_rows` answers."""
    measured, error, holds = _row_of(words)
    return question, measured, f"{error}; the interval holds: {holds}", page


def _of_random_robots() -> list[Question]:
    """Questions that machines drawn at random answer."""
    chosen = kept("earlier/until_sure")["tables"]["until_sure"]["rows"][0]
    days = kept("earlier/drift")["tables"]["drift"]["rows"]
    apart = numbers("between_recordings", "between", row="all")
    work = numbers("running", "sensing", arm="all")
    return [
        (
            "How long until the interval is narrow enough?",
            f"10 to 100 g until ± 0.5 g, {chosen['c1']} questions, calibrated by pushes that were chosen",
            f"median {chosen['c6']} s; target met: {chosen['c2']}; intervals hold: {chosen['c5']}",
            "stopping",
        ),
        (
            "How long is a calibration good?",
            f"a day later, motors 10 K warmer or colder, {days[6]['c1'].partition(' of ')[2]} weighings",
            f"intervals hold: {days[6]['c2']} where the calibration is aged, {days[5]['c2']} where it is not",
            "ageing",
        ),
        (
            "Do intervals hold where recordings of one machine differ?",
            f"{apart['questions']} questions to arms, servos and pendulums drawn at random, and to real ones",
            f"{apart['hold']} of {apart['given']} hold, the farthest {apart['worst']:.1f} sd off; {apart['refused']} refused",
            "repeatability",
        ),
        (
            "How soon is a change of load noticed, and weighed?",
            f"{work['changes']} changes by 0.1 to 2 kg on twelve simulated arms in motion",
            f"{work['noticed']} noticed, median {work['late_s']:.2f} s; half a second later rms {work['soon_rms']:.0f} g, "
            f"{work['soon_hold']:.0f} % of the intervals hold",
            "at_work",
        ),
    ]


def _of_nodes_and_users() -> list[Question]:
    """Questions about mistakes, the nodes, faults and time."""
    mistakes = numbers("mistakes", "mistakes", mistake="all")
    asked = sum(count for count in mistakes.values() if isinstance(count, int))
    wrong = mistakes["wrong"] + mistakes["wrong_said"]
    ways = [row for row in kept("live")["tables"]["live"]["rows"] if row["held"] == "all"]
    plans = numbers("schedules", "plans", plan="all")
    untrue = kept("schedules")["tables"]["kinds"]["rows"][-1]["faults"]
    fit = _speed_row("ours", "ours: five-start fit")
    fresh = _speed_row("fresh", "proprio replay --json")
    return [
        (
            "What becomes of a user's mistake?",
            f"20 mistakes, each in up to 28 good recordings: {asked} questions",
            f"{mistakes['cause']} refused, the cause named; {wrong} wrong answers, {mistakes['wrong_said']} with the cause named",
            "mistakes",
        ),
        (
            "Does it weigh as well through the nodes?",
            "five virtual arms a way, by services only, in simulated time: own driver, controllers of others, SO-101",
            f"{sum(row['answered'] for row in ways)} of {sum(row['asked'] for row in ways)} answered, "
            f"{sum(row['hold'] for row in ways)} intervals hold",
            "nodes",
        ),
        (
            "Is the arm held and nothing wrong accepted, whatever fails?",
            f"{plans['schedules']} schedules of faults on the nodes, the vendor's library and emulated servos",
            f"{untrue} found something untrue, and it was mended",
            "faults",
        ),
        (
            "How fast is it?",
            "two cores",
            f"fit of one recording from five starts {fit['fastest']}; a fresh process to the answer {fresh['fastest']}",
            "speed",
        ),
    ]


def questions() -> list[Question]:
    """The rows of the validation page, a page behind each."""
    pushes, intervals, box, blocks, inside, arms, motion, real = (
        _of_a_row(*asked)
        for asked in (
            ("How well does one push weigh?", "16 empty runs", "pushes"),
            ("Do the intervals hold?", "random robots", "intervals"),
            ("How well is a sphere in a closed box weighed?", "closed box", "box"),
            ("How well is Young's modulus identified?", "one squeeze", "blocks"),
            ("What is in an upright container?", "upright container", "upright_container"),
            ("How well do servos weigh that report no torque?", "simulated SO-101", "servos"),
            ("How well does an arm weigh from any motion?", "UR10e in motion", "several_joints"),
            (
                "What does it answer to other people's recordings?",
                "five real machines",
                "real_machines",
            ),
        )
    )
    until, ageing, apart, work = _of_random_robots()
    return [
        pushes, intervals, motion, apart, real, arms, box, inside, blocks, until, ageing, work,
        *_of_nodes_and_users(),
    ]  # fmt: skip


def summary() -> str:
    """The validation page's table."""
    rows = [
        (question, measured, figure, f"[{page.replace('_', ' ')}](validation/{page}.md)")
        for question, measured, figure, page in questions()
    ]
    return table_of(("question", "what was measured", "figure", "page"), rows)


# --- speed --------------------------------------------------------------------------------------------------------------


def _speed_row(part: str, what: str) -> dict[str, Any]:
    """The one row of a part of the comparison whose words begin so."""
    rows = kept("speed")["tables"][part]["rows"]
    (found,) = [row for row in rows if row["what"].startswith(what)]
    return dict(found)


def _is_shown(row: Mapping[str, Any]) -> bool:
    """Whether a row of the comparison has a goal, or is what others are compared with."""
    return bool(row["goal"]) or (row["what"].startswith("ours: ") and not row["ratio"])


def speed() -> str:
    """One table of the comparisons that have a goal, and of what they compare with."""
    tables = kept("speed")["tables"]
    machine = kept("speed")["machine"]
    rows = [
        (row["what"], row["fastest"] or "-", row["median"] or "-", row["ratio"])
        for table in tables.values()
        for row in table["rows"]
        if _is_shown(row)
    ]
    measured = (
        f"{source('speed')[:-1]}; {machine['cores']} cores, load {machine['load']} when it began."
    )
    return f"{measured}\n\n{table_of(('what', 'fastest', 'median', 'beside it'), rows)}"


# --- recordings that differ ---------------------------------------------------------------------------------------------

MACHINES = (
    ("arms of three joints", r"arm of 3 joints"),
    ("arms of four and six joints, one empty recording", r"arm, 1 empty"),
    ("the same, three empty recordings", r"arm, 3 empty"),
    ("the same, efforts 1.03 times as large", r"arm, as a minute later, efforts 1\.03"),
    ("the same, efforts 1.05 times as large", r"arm, as a minute later, efforts 1\.05"),
    ("the same, efforts 1.1 times as large", r"arm, as a minute later, efforts 1\.1 "),
    ("pendulums", r"pendulum"),
    ("servos under their own law", r"servo"),
    ("real KUKA LWR4+", r"real KUKA"),
    ("real STS3215 and STS3250 that let go", r"real STS32"),
    ("real UR10e", r"real UR10e, 1 empty"),
    ("the same, a joint's zero 0.02, 0.15 or 0.3 rad off", r"real UR10e, a joint"),
    ("the same, efforts 3, 5 or 10 % off", r"real UR10e, efforts"),
    ("real servos, by another servo and arm", r"real, let go"),
    ("all", r"all"),
)
"""Rows of `between_recordings.json` that are added up, and how their names begin."""


def between_in_short() -> str:
    """Questions to recordings that differ, by machine."""
    every = kept("between_recordings")["tables"]["between"]["rows"]
    rows = []
    for machine, begins in MACHINES:
        chosen = [row for row in every if re.match(begins, row["row"])]
        counts = {
            key: sum(row[key] for row in chosen)
            for key in ("questions", "accepted", "too_wide", "refused", "hold", "given")
        }
        far = [row["worst"] for row in chosen if row["given"]]
        rows.append(
            (
                machine,
                str(counts["questions"]),
                str(counts["accepted"]),
                str(counts["too_wide"]),
                str(counts["refused"]),
                f"{counts['hold']} of {counts['given']}",
                f"{max(far):.1f}" if far else "-",
            )
        )
    titles = ("machines", "questions", "accepted", "too wide", "refused", "hold", "farthest, in sd")
    return f"{source('between_recordings')}\n\n{table_of(titles, rows)}"


def speed_in_short() -> str:
    """README's sentence."""
    fit = _speed_row("ours", "ours: five-start fit")
    scipy = _speed_row("scipy", "scipy solve_ivp")
    return (
        f"A five-start fit of one recording takes {fit['fastest']} on a CPU; SciPy's `solve_ivp` and `least_squares` take "
        f"{scipy['ratio'].partition('x')[0]} times as long."
    )


def libraries() -> str:
    """The design page's table of heavy libraries."""
    return table_of(("library", "for", "imported in"), code_map.libraries())


VIEWS: dict[str, Callable[[], str]] = {
    "libraries": libraries,
    "readme": readme,
    "summary": summary,
    "speed": speed,
    "speed in short": speed_in_short,
    "between_recordings in short": between_in_short,
}
