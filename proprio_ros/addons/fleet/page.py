"""The page of a batch: what was held by source and time, what was refused, why and what helps, and every row to search in."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path

import numpy as np

from proprio_ros.addons.fleet.drift import Drift, drift_parts
from proprio_ros.addons.fleet.listing import (
    asked,
    cause_of,
    causes_of,
    listing,
    named,
    own_words,
    refused,
    when,
)
from proprio_ros.addons.fleet.plots import histogram, values_figure
from proprio_ros.addons.fleet.rows import EPISODE, GRASP, PART, Row
from proprio_ros.identification.reasons import CODES
from proprio_ros.pipeline.request import Options
from proprio_ros.quantity import MAD_TO_STD, Z95, shown, shown_unit, spec_for
from proprio_ros.report.html import Own, bars, provenance, table, write_document

COLUMNS = (
    "source_name", "source", "episode", "episode_index", "segment", "kind", "recorded_ns", "quantity", "unit", "value", "std",
    "low", "high", "verdict", "reasons", "reason_codes", "notes", "robot", "calibration", "start_s", "end_s", "joints",
)  # fmt: skip
OWN = Own(
    *(
        Path(__file__).with_name(name).read_text(encoding="utf-8")
        for name in ("rows.css", "rows.js")
    )
)
MOST_PLOTS = 12  # of the sources with the most episodes
MOST_LISTED = 50_000  # rows
MOST_CAUSES = 20
EXAMPLES = 3  # episodes that are named with each cause
ODD_SIGMAS = 5.0
"""So far from the source's median, by the spread of the rest and its own standard deviation, a value is listed."""
_HELP = {
    "": "CHECK says what is in it; record or convert it again, or leave it out.",
    "process_died": "Give it more memory, or fewer processes at a time (--jobs); begin again in another folder.",
    "unexpected": "This is a defect of proprio: please report it with the recording.",
}
"""What to do about rows without any answer, beside what their reasons say."""


def write_batch_page(
    rows: list[Row],
    path: Path,
    command: str,
    reports: Mapping[str, str],
    drift: Drift,
    options: Options | None = None,
) -> None:
    """Write the page of a batch.

    Args:
        rows: With `COLUMNS`; they are put in order and numbered in place.
        path: Of the page.
        command: The command line that gives all of it again.
        reports: Files beside the page, by what `named` calls the row that each is of.
        drift: What each period says about the arm; it may be empty.
        options: That were asked of each row.

    Raises:
        ConfigurationError: The file cannot be written.
    """
    rows.sort(key=lambda row: (row["source"], *_order(row), row["segment"]))
    whole = [row for row in rows if row["kind"] != GRASP]
    listed = rows if len(rows) <= MOST_LISTED else (odd(whole) + rows)[:MOST_LISTED]
    for row in rows:
        row["number"] = -1
    for number, row in enumerate(listed):
        row["number"] = number
    parts = [
        *_summary(whole),
        *_masses(whole),
        *_refused(whole, reports, options),
    ]
    grasps = Counter(row["reason_codes"][0] for row in rows if row["kind"] == GRASP)
    if grasps:
        counts = [(code, float(count), str(count)) for code, count in grasps.most_common()]
        parts += ["<h2>Grasps</h2>", bars(counts)]
    parts += drift_parts(drift)
    parts += _all(listed, reports, options)
    parts += provenance(
        command,
        sorted({row["source"] for row in whole}),
        {},
    )
    write_document(path, "Many recordings", parts, "--out", own=OWN)


def _order(row: Row) -> tuple[int, int, str]:
    recorded_ns = int(row["recorded_ns"] or 2**62)
    return recorded_ns, int(row["episode_index"] or 0), str(row["episode"])


def _sources(rows: Iterable[Row]) -> dict[str, tuple[str, str]]:
    """What each is called, and where it lies: its folder's name where that says which, else all of its path."""
    places = {row["source_name"]: row["source"] for row in rows}
    often = Counter(Path(place).name for place in places.values())
    return {
        name: (Path(place).name if often[Path(place).name] == 1 else place, place)
        for name, place in places.items()
    }


def _summary(whole: Sequence[Row]) -> list[str]:
    """How many rows have which verdict, and of each source what its accepted values are."""
    verdicts = Counter(row["verdict"].replace("_", " ") for row in whole)
    episodes = len({(row["source"], row["episode"]) for row in whole})
    parts = "" if episodes == len(whole) else f" in {len(whole)} parts"
    counted = escape(", ".join(f"{count} {name}" for name, count in sorted(verdicts.items())))
    names = _sources(whole)
    by_source = [
        [names[source][0], str(len(own)), *_of_accepted(own)]
        for source, own in _by_source(whole).items()
    ]
    header = ("source", "rows", "accepted", "median", "middle half", "95 % interval, usually")
    return [
        "<h1>Many recordings</h1>",
        f"<p class=value>{verdicts['accepted']} of {len(whole)} accepted</p>",
        f"<p class=interval>{episodes} episodes{parts}: {counted}{_arms(whole)}</p>",
        f"<div class=sources>{table(header, by_source, range(1, 6), labels=1)}</div>",
    ]


def _arms(whole: Sequence[Row]) -> str:
    """The robots and their calibrations, in words; nothing where no row has one."""
    known = sorted({(row["robot"], row["calibration"] or "") for row in whole if row["robot"]})
    arms = ", ".join(
        f"{robot} ({f'calibration {made}' if made else 'not calibrated'})" for robot, made in known
    )
    return f"; robot {escape(arms)}" if arms else ""


def _of_accepted(own: Sequence[Row]) -> list[str]:
    """How many rows of a source are accepted; of their values the median, the middle half, and the usual interval."""
    good = [row for row in own if row["verdict"] == "accepted" and row["value"] is not None]
    share = f"{len(good)} ({_percent(len(good), len(own))})"
    if not good:
        return [share, "", "", ""]
    values = np.array([row["value"] for row in good])
    unit = good[0]["unit"]
    std = float(np.median([row["std"] or 0.0 for row in good]))
    spec = spec_for(unit, std)
    low, high = np.percentile(values, (25, 75))
    half = shown(unit, Z95 * std, spec=spec)
    return [
        share,
        shown(unit, float(np.median(values)), spec=spec),
        shown(unit, low, high, spec=spec, between=" to "),
        f"± {half}" if std else "",
    ]


def _percent(count: int, of: int) -> str:
    """Never all or nothing where it is not."""
    share = 100.0 * count / of
    return f"{min(max(share, 0.1), 99.9) if 0 < count < of else share:.1f} %"


def _by_source(rows: Iterable[Row]) -> dict[str, list[Row]]:
    found: dict[str, list[Row]] = {}
    for row in rows:
        found.setdefault(row["source_name"], []).append(row)
    return found


def _masses(whole: Sequence[Row]) -> list[str]:
    """One plot per source with intervals, and how often which value was accepted."""
    valued = [row for row in whole if row["value"] is not None]
    names = _sources(whole)
    if not valued:
        return []
    by_source = _by_source(valued)
    most = sorted(by_source, key=lambda source: -len(by_source[source]))[:MOST_PLOTS]
    left = f"<p class=small>Of the {MOST_PLOTS} sources with the most rows.</p>"
    return [
        "<h2>What was held</h2>",
        *histogram([row for row in valued if row["verdict"] == "accepted"]),
        "<p class='small hint'>Click a dot for its row; drag to look closer, double-click for all of it.</p>",
        *[left] * (len(by_source) > MOST_PLOTS),
        *(
            values_figure(own, names[source][0])
            for source, own in by_source.items()
            if source in most
        ),
    ]


def _refused(
    whole: Sequence[Row],
    reports: Mapping[str, str],
    options: Options | None,
) -> list[str]:
    """By cause, the most frequent first, with the sentence that helps and some of its episodes."""
    rows: dict[tuple[str, str], list[Row]] = {}
    for row in whole:
        if refused(row):
            rows.setdefault(cause_of(row), []).append(row)
    if not rows:
        return []
    count = sum(map(len, rows.values()))
    most = max(map(len, rows.values()))
    parts = [f"<h2>Refused: {_percent(count, len(whole))}</h2>"]
    for number, cause in enumerate(causes_of(whole)[:MOST_CAUSES]):
        own = rows[cause]
        title = (
            f"{escape(cause[0].replace('_', ' '))}: {len(own)} ({_percent(len(own), len(whole))})"
        )
        width = 100.0 * len(own) / most
        parts.append(f"<div class=cause><h3>{title}</h3><i style='width:{width:.1f}%'></i>")
        parts.append(_what_to_do(own, cause, options))
        parts.append(_examples(own, reports, number))
    left = len(rows) - MOST_CAUSES
    if left > 0:
        parts.append(
            f"<p class=small>And {left} other causes, each of fewer rows: choose them in the list below.</p>"
        )
    return parts


def _what_to_do(
    own: Sequence[Row],
    cause: tuple[str, str],
    options: Options | None,
) -> str:
    """What rows of one cause say, and the remedy."""
    code, words = cause
    sentences = [own_words(row, row["reasons"][0]) for row in own if row["reasons"]]
    most_common = escape(Counter(sentences).most_common(1)[0][0] if sentences else "")
    if words:  # no reason of a fit: the sentence is the cause
        name = named(own[0]).partition(" --span ")[0]
        check = f"<code>proprio check {escape(name + asked(options, True))}</code>"
        remedy = _HELP.get(code, _HELP[""]).replace("CHECK", check)
        return f"<p>{most_common}</p><p><b>What to do:</b> {remedy}</p>"
    meaning = escape(_capitalised(CODES[code].meaning))
    # commands are between backticks
    remedy = re.sub(r"`([^`]*)`", r"<code>\1</code>", escape(_capitalised(CODES[code].remedy)))
    return (
        f"<p>{meaning}.</p><p><b>What to do:</b> {remedy}.</p>"
        f"<p class=small>One of them: {most_common}</p>"
    )


def _capitalised(words: str) -> str:
    return words[0].upper() + words[1:]


def _examples(
    own: Sequence[Row],
    reports: Mapping[str, str],
    number: int,
) -> str:
    """Some rows of a cause, which ends the cause's box; ``number`` is the cause's in the list of all rows."""
    examples = ", ".join(_linked(row, reports) for row in own[:EXAMPLES])
    more = f" and {len(own) - EXAMPLES} more" if len(own) > EXAMPLES else ""
    show = "all" if more else "in the list"
    jump = f" <a class=jump href='#all' data-cause='{number}'>Show {show}</a>"
    return f"<p class=small>{examples}{more}.{jump}</p></div>"


def _linked(row: Row, reports: Mapping[str, str]) -> str:
    name = f"<code>{escape(named(row))}</code>"
    page = reports.get(named(row))
    return f"{name} (<a href='{escape(page)}'>page</a>)" if page else name


def odd(whole: Sequence[Row]) -> list[Row]:
    """Rows that a person should look at: far from the rest of their source first, then the refused, each cause in turn."""
    found = far(whole)
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in whole:
        if row["verdict"] not in ("accepted", "failed"):
            groups.setdefault(cause_of(row), []).append(row)
    turns = max(map(len, groups.values()), default=0)
    return found + [
        group[turn] for turn in range(turns) for group in groups.values() if turn < len(group)
    ]


def far(whole: Sequence[Row]) -> list[Row]:
    """Accepted rows that are far from the rest of their source, the furthest first."""
    found: list[tuple[float, Row]] = []
    accepted = [row for row in whole if row["verdict"] == "accepted" and row["value"] is not None]
    answers = [row for row in accepted if row["kind"] in (EPISODE, PART)]
    for own in _by_source(answers).values():
        values = np.array([row["value"] for row in own])
        off = np.abs(values - np.median(values))
        spread = MAD_TO_STD * float(np.median(off))
        for row, away in zip(own, off, strict=True):
            sigmas = away / max(float(np.hypot(spread, row["std"] or 0.0)), 1e-12)
            if sigmas > ODD_SIGMAS:
                found.append((-sigmas, row))
    return [row for _, row in sorted(found, key=lambda pair: pair[0])]


def _all(
    rows: Sequence[Row],
    reports: Mapping[str, str],
    options: Options | None,
) -> list[str]:
    """Every row, to search and filter by its script; without scripts the page says where they are."""
    names = _sources(rows)
    several = len({row["source_name"] for row in rows}) > 1
    unit = next((shown_unit(row["unit"])[1] for row in rows if row["unit"]), "")
    heads = [
        ("", "episode"),
        *[("source", "source")] * several,
        *[("when", "recorded (UTC)")] * any(map(when, rows)),
    ]
    heads += [
        ("value", f"value ({unit})" if unit else "value"),
        ("interval", "95 % interval"),
        ("verdict", "verdict"),
    ]
    cells = "".join(
        f"<th{' class=number' if key in ('value', 'interval') else ''}>"
        f"<button type=button data-key='{key}'>{escape(words)}</button></th>"
        for key, words in heads
    )
    pages = {}
    for number, row in enumerate(rows):
        if named(row) in reports:
            pages[number] = reports[named(row)]
    about = {"replay": asked(options), "check": asked(options, True)}
    data = listing(
        rows,
        names,
        pages,
        {row["number"] for row in far(rows)},
        about,
    )
    choices = "".join(
        f"<select id={key} aria-label='{key}'><option value=''>{words}</option></select>"
        for key, words in (
            ("source", "all sources"),
            ("verdict", "all verdicts"),
            ("cause", "all causes"),
        )
    )
    left = f"<p class=small>{MOST_LISTED} of them; all are in the folder <code>rows</code>.</p>"
    return [
        "<h2 id=all>All rows</h2>",
        *[left] * (len(rows) == MOST_LISTED),
        "<noscript><p>The list needs scripts; all rows are in the folder <code>rows</code> beside this page.</p></noscript>",
        f"<div class=find><input type=search id=find aria-label=search placeholder='Search names and reasons'>{choices}",
        "<output id=count></output></div>",
        f"<div class=wide><table class='folds rows' id=list><thead><tr>{cells}<th></th></tr></thead><tbody></tbody></table></div>",
        "<button type=button class=more id=more hidden>Show 100 more</button>",
        f"<script type='application/json' id=data>{data}</script>",
    ]
