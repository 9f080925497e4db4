"""The page of a batch: masses over episodes and time, what was refused and why, and the rows that look odd with how to see each."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from proprio_ros.batch.drift import Period, drift_parts
from proprio_ros.batch.rows import EPISODE, FAILED, GRASP, PART
from proprio_ros.batch.store import Store
from proprio_ros.quantity import shown
from proprio_ros.records import Span
from proprio_ros.report.chart import Axis, Panel, Series, chart
from proprio_ros.report.html import bars, framed, provenance, table, write_document

COLUMNS = (
    "source_name", "source", "episode", "episode_index", "segment", "kind", "recorded_ns", "quantity", "unit", "value", "std",
    "low", "high", "verdict", "reasons", "reason_codes", "robot", "calibration", "start_s", "end_s",
)  # fmt: skip
MOST_POINTS, MOST_ROWS, MOST_REPORTS = 4000, 40, 12
"""Points of a plot; rows of a table; reports that are written beside the page."""
ODD_SIGMAS = 5.0
"""So far from the source's median, by the spread of the rest and its own standard deviation, a value is listed."""


def write_batch_page(
    store: Store, path: Path, command: str, reports: Mapping[str, str], drift: Sequence[Period] = ()
) -> None:
    """Write the page; ``reports`` are file names beside it, by what `named` calls the row that each is of.

    Raises:
        ConfigurationError: The file cannot be written.
    """
    rows = store.read(COLUMNS)
    rows.sort(key=lambda row: (row["source"], *_order(row), row["segment"]))
    whole = [row for row in rows if row["kind"] != GRASP]
    parts = ["<h1>Many recordings</h1>", *_summary(whole), *_masses(whole), *_refused(whole), *_odd(whole, reports)]
    if grasps := Counter(row["reason_codes"][0] for row in rows if row["kind"] == GRASP):
        counts = [(code, float(count), str(count)) for code, count in grasps.most_common()]
        parts += ["<h2>Grasps</h2>", bars(counts)]
    parts += drift_parts(drift)
    parts += provenance(command, sorted({row["source"] for row in whole}), {})
    write_document(path, "Many recordings", parts, "--out")


def _order(row: Mapping[str, Any]) -> tuple[int, int, str]:
    return int(row["recorded_ns"] or 0), int(row["episode_index"] or 0), str(row["episode"])


def path_of(row: Mapping[str, Any]) -> str:
    """What `proprio replay` takes."""
    return f"{row['source']}{'/' if row['episode_index'] is None else '#'}{row['episode']}"


def span_of(row: Mapping[str, Any]) -> Span | None:
    """The part of its recording that a row is of; None: all of it."""
    begin_s, end_s = row["start_s"], row["end_s"]
    if begin_s is None or (row["kind"] == EPISODE and not begin_s):
        return None
    return round(1e9 * begin_s), None if row["kind"] == EPISODE or end_s is None else round(1e9 * end_s)


def named(row: Mapping[str, Any]) -> str:
    """How to name it on the command line."""
    span = span_of(row)
    if span is None:
        return shlex.quote(path_of(row))
    words = ["" if end is None else f"{1e-9 * end:.9f}".rstrip("0").rstrip(".") for end in span]
    return f"{shlex.quote(path_of(row))} --span {':'.join(words)}"


def _summary(whole: Sequence[Mapping[str, Any]]) -> list[str]:
    verdicts = Counter(row["verdict"] for row in whole)
    robots = Counter((row["robot"] or "?", row["calibration"] or "none", row["source_name"]) for row in whole)
    found = []
    for (robot, calibration, source), count in sorted(robots.items()):
        own = [row for row in whole if (row["robot"] or "?", row["source_name"]) == (robot, source)]
        accepted = [row["value"] for row in own if row["verdict"] == "accepted"]
        unit = next((row["unit"] for row in own if row["unit"]), "")
        middle = shown(unit, float(np.median(accepted))) if accepted and unit else "-"
        found.append((source, robot, calibration, str(count), str(len(accepted)), middle))
    episodes = len({(row["source"], row["episode"]) for row in whole})
    parts = "" if episodes == len(whole) else f" in {len(whole)} parts"
    said = escape(", ".join(f"{count} {name}" for name, count in verdicts.most_common()))
    header = ("source", "robot", "calibration", "episodes", "accepted", "median")
    return [f"<p>{episodes} episodes{parts}: {said}</p>", table(header, found, (3, 4, 5))]


def _masses(whole: Sequence[Mapping[str, Any]]) -> list[str]:
    """One plot per source, over time where the stamps say it, else over episodes."""
    parts = ["<h2>What was held</h2>"]
    by_source = _by_source(row for row in whole if row["value"] is not None)
    for number, (source, own) in enumerate(by_source.items()):
        own = own[:: -(-len(own) // MOST_POINTS)]
        stamps = np.array([row["recorded_ns"] or 0 for row in own])
        dated = bool(stamps.all()) and stamps.max() > stamps.min()
        x = (stamps - stamps.min()) / 86400e9 if dated else np.arange(len(own), dtype=float)
        factor, unit = (1e3, "g") if own[0]["unit"] == "kg" else (1.0, own[0]["unit"])
        values = factor * np.array([row["value"] for row in own])
        accepted = np.array([row["verdict"] == "accepted" for row in own])
        series = [
            Series(words, x[mask], values[mask], color, "dots")
            for words, color, mask in (("accepted", "measured", accepted), ("too wide", "apart", ~accepted))
            if mask.any()
        ]
        axis = Axis("since the first [days]", "days") if dated else Axis("episode", "")
        panel = Panel(f"{own[0]['quantity']} [{unit}]", unit, series, 220.0)
        parts.append(framed(chart([panel], axis, f"masses{number}"), source))
    return parts if len(parts) > 1 else []


def _by_source(rows: Iterable[Mapping[str, Any]]) -> dict[str, list[Mapping[str, Any]]]:
    found: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        found.setdefault(row["source_name"], []).append(row)
    return found


def _refused(whole: Sequence[Mapping[str, Any]]) -> list[str]:
    refused = [row for row in whole if row["verdict"] != "accepted"]
    if not refused:
        return []
    first = [((row["reason_codes"] or ["other"])[0], (row["reasons"] or [""])[0]) for row in refused]
    codes, example = Counter(code for code, _ in first), dict(reversed(first))
    listed = [(code, float(count), f"{count}, such as {example[code]}") for code, count in codes.most_common()]
    return [f"<h2>Refused: {100.0 * len(refused) / len(whole):.1f} %</h2>", bars(listed)]


def odd(whole: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Rows that a person should look at: far from the rest of their source first, then the refused."""
    found: list[tuple[float, Mapping[str, Any]]] = []
    accepted = [row for row in whole if row["verdict"] == "accepted" and row["value"] is not None]
    for own in _by_source(row for row in accepted if row["kind"] in (EPISODE, PART)).values():
        values = np.array([row["value"] for row in own])
        off = np.abs(values - np.median(values))
        spread = 1.4826 * float(np.median(off))
        for row, far in zip(own, off, strict=True):
            sigmas = far / max(float(np.hypot(spread, row["std"] or 0.0)), 1e-12)
            if sigmas > ODD_SIGMAS:
                found.append((-sigmas, row))
    rest = [row for row in whole if row["verdict"] not in ("accepted", "failed")]
    return [row for _, row in sorted(found, key=lambda pair: pair[0])] + rest


def _odd(whole: Sequence[Mapping[str, Any]], reports: Mapping[str, str]) -> list[str]:
    rows = odd(whole)[:MOST_ROWS] + [row for row in whole if row["kind"] == FAILED][:MOST_ROWS]
    if not rows:
        return []
    parts = [
        "<h2>To look at</h2>",
        "<p>Far from the other episodes of their source, refused, or unreadable.</p>",
        "<ul>",
    ]
    for row in rows:
        path = named(row)
        said = row["verdict"] if row["value"] is None else f"{shown(row['unit'], row['value'])}, {row['verdict']}"
        link = f" <a href='{escape(reports[path])}'>report</a>" if path in reports else ""
        why = f": {(row['reasons'] or [''])[0]}" if row["reasons"] else ""
        parts.append(f"<li><code>{escape(path)}</code> {escape(said + why)}{link}</li>")
    return [*parts, "</ul>"]
