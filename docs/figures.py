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


def table_of(
    titles: Sequence[str],
    rows: Sequence[Sequence[str]],
) -> str:
    """A table in Markdown."""
    return "\n".join([line(titles), "|" + "---|" * len(titles), *map(line, rows)])


def markdown(
    table: Mapping[str, Any],
    key: str = "",
    value: str = "",
) -> str:
    """A table that a benchmark kept, in Markdown.

    Args:
        table: Its columns and rows.
        key: Of a row's numbers; empty: all rows are shown.
        value: The rows are shown whose number of that name reads so.

    Raises:
        LookupError: No row does, of those that are asked for.
    """
    rows = [row for row in table["rows"] if not key or str(row[key]) == value]
    if key and not rows:
        raise LookupError(f"no row with {key}={value}")
    columns = table["columns"]
    return table_of(
        list(columns),
        [cells(columns, row) for row in rows],
    )


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


# --- what the first pages show ------------------------------------------------------------------------------------------


def _all(held: int, of: int) -> str:
    return f"all {of}" if held == of else f"{held} of {of}"


def _span(
    values: Sequence[float],
    digits: int = 2,
) -> str:
    sizes = sorted(map(abs, values))
    return f"{sizes[0]:.{digits}f} to {sizes[-1]:.{digits}f}"


def _two(table: str, **where: Any) -> list[dict[str, Any]]:
    """The same row of both realistic robots."""
    levels = ("realistic_s00", "realistic_s01")
    return [numbers("simulated", table, level=level, **where) for level in levels]


def _sum(
    rows: Sequence[Mapping[str, Any]],
    key: str,
) -> int:
    return sum(row[key] for row in rows)


def _every(rows: Sequence[Mapping[str, Any]], *keys: str) -> list[float]:
    """Numbers of all rows, of lists each of them."""
    found: list[float] = []
    for row in rows:
        for key in keys:
            found += row[key] if isinstance(row[key], list) else [row[key]]
    return found


def pushes() -> Row:
    """Fixed objects, by the two realistic robots."""
    rows = _two("weighing", known="calibrated on its empty runs")
    asked = _sum(rows, "asked")
    answered = _sum(rows, "answered")
    one, other = (row["rms"] for row in rows)
    return (
        "mass of 10 to 50 g, calibrated on 16 empty runs (two simulated robots)",
        f"rms {one:.2f} and {other:.2f} g",
        f"{_all(_sum(rows, 'hold'), answered)}; {asked - answered} of {asked} refused",
    )


def coverage() -> Row:
    """Random robots with all effects."""
    every = kept("coverage")["tables"]["coverage"]["rows"][0]
    robots, _, _ = every["robots"].partition(",")
    return (
        f"mass of 10 to 100 g, {robots} random robots, {every['answered']} answers of {every['asked']}",
        f"rms {every['rms']:.2f} g, median {every['median']:.2f} g",
        f"{every['hold']:.1f} ± {every['margin']:.1f} %",
    )


def boxes() -> Row:
    """Spheres in a closed box, three recordings together."""
    rows = _two("container")
    return (
        "sphere in a closed box, three recordings together (two robots)",
        f"{_span(_every(rows, 'together_errors'))} g",
        _all(_sum(rows, "together_hold"), _sum(rows, "together_answered")),
    )


def blocks() -> Row:
    """Soft blocks, one squeeze each."""
    rows = _two("blocks")
    halves = _span(_every(rows, "half_from", "half_to"), 0)
    return (
        "Young's modulus of a soft block, one squeeze (two robots)",
        f"{_span(_every(rows, 'errors'), 1)} %",
        f"{_all(_sum(rows, 'hold'), _sum(rows, 'answered'))}; {halves} % half wide",
    )


def inside_containers() -> Row:
    """What an upright container holds."""
    every = numbers("contents", "contents", kind="all")
    count = every["recordings"]
    return (
        f"what is in an upright container, {count} recordings: liquids and grains of particles, rigid things",
        f"mass: rms {every['rms']:.1f} g; rigid or moving {every['said']} times, right {every['right']}",
        f"{_all(every['hold'], every['answered'])}; {count - every['answered']} refused",
    )


def goals_alone() -> Row:
    """Arms of servos that report no current."""
    every = numbers("so101", "so101", held="all")
    return (
        f"simulated SO-101 that record goals and positions alone, 30 Hz; nothing to 200 g, {every['asked']} questions",
        f"rms {every['rms']:.1f} g, worst {every['worst']:.1f} g",
        f"{_all(every['hold'], every['answered'])}; {every['asked'] - every['answered']} refused",
    )


def real_arm() -> Row:
    """A real arm in motion."""
    row = numbers("real", "real", asked="UR10e, 2.805 kg, `--baseline`")
    worst = max(map(abs, row["errors"]))
    return (
        "a real UR10e in motion, 2.805 kg, against each of three empty recordings",
        f"worst {worst:.1f} %",
        f"{_all(row['hold'], row['given'])}; {_span(row['half_intervals'], 1)} % half wide",
    )


def real_machines() -> Row:
    """All questions to recordings of other people's machines."""
    every = numbers("real", "real", asked="all")
    return (
        f"{every['questions']} questions to recordings of five real machines",
        f"{every['given']} answered, the rest refused",
        f"{every['hold']} of {every['given']}, the farthest {every['farthest']:.1f} sd off",
    )


IN_README = (coverage, boxes, blocks, goals_alone, real_arm, real_machines)
"""What README's table has."""


def readme() -> str:
    """README's table."""
    rows = [measured() for measured in IN_README]
    return table_of(("what", "error", "the 95 % interval holds"), rows)


def _question(question: str, row: Row, page: str) -> Question:
    """A question that a row answers."""
    measured, error, holds = row
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
    hostile = numbers("pendant", "hostile", wrong="all")
    idle, *_ = kept("pendant")["tables"]["idle"]["rows"]
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
            "Is the pendant safe and cheap?",
            f"{hostile['sent']} hostile requests; joint states at 100 Hz",
            f"{hostile['refused']} refused, {hostile['moved']} moved the arm; {idle['core']:.1%} of a core, {idle['mb']:.0f} MB",
            "pendant",
        ),
        (
            "How fast is it?",
            "two cores",
            f"fit of one recording from five starts {fit['fastest']}; a fresh process to the answer {fresh['fastest']}",
            "speed",
        ),
    ]


def _of_what_is_weighed() -> list[Question]:
    """Questions about pushes, motions, and what a hand may grasp."""
    return [
        _question("How well does one push weigh?", pushes(), "pushes"),
        _question("Do the intervals hold?", coverage(), "intervals"),
        _question("How well does an arm weigh from any motion?", real_arm(), "several_joints"),
        _question(
            "What does it answer to other people's recordings?", real_machines(), "real_machines"
        ),
        _question("How well do servos weigh that report no torque?", goals_alone(), "servos"),
        _question("How well is a sphere in a closed box weighed?", boxes(), "box"),
        _question("What is in an upright container?", inside_containers(), "upright_container"),
        _question("How well is Young's modulus identified?", blocks(), "blocks"),
    ]


def questions() -> list[Question]:
    """The rows of the validation page, a page behind each."""
    return [*_of_what_is_weighed(), *_of_random_robots(), *_of_nodes_and_users()]


def summary() -> str:
    """The validation page's table."""
    rows = [
        (question, measured, figure, f"[{page.replace('_', ' ')}](validation/{page}.md)")
        for question, measured, figure, page in questions()
    ]
    return table_of(("question", "what was measured", "figure", "page"), rows)


# --- speed --------------------------------------------------------------------------------------------------------------


def _speed_row(
    part: str,
    what: str,
) -> dict[str, Any]:
    """The one row of a part of the comparison whose words begin so."""
    rows = kept("speed")["tables"][part]["rows"]
    (found,) = [row for row in rows if row["what"].startswith(what)]
    return dict(found)


def _is_shown(row: Mapping[str, Any]) -> bool:
    """Whether a row of the comparison has a goal, or is what others are compared with."""
    if row["goal"]:
        return True
    alone = row["what"].startswith("ours: forward pass")
    return row["what"].startswith("ours: ") and not row["ratio"] and not alone


def speed() -> str:
    """One table of the comparisons that have a goal, and of what they compare with."""
    tables = kept("speed")["tables"]
    machine = kept("speed")["machine"]
    rows = [
        (row["what"], row["fastest"] or "-", row["median"] or "-", row["ratio"])
        for part, table in tables.items()
        for row in table["rows"]
        if part != "waits" and _is_shown(row)
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
    import code_map  # benchmarks stand on this file, without docs/ on their path

    return table_of(("library", "for", "imported in"), code_map.libraries())


def efficiency_in_short() -> str:
    """How many rows of each benchmark have intervals that fit."""
    import efficiency  # likewise

    return efficiency.summary()


VIEWS: dict[str, Callable[[], str]] = {
    "efficiency in short": efficiency_in_short,
    "libraries": libraries,
    "readme": readme,
    "summary": summary,
    "speed": speed,
    "speed in short": speed_in_short,
    "between_recordings in short": between_in_short,
}
