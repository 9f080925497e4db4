"""What services, and commands about recordings, answered, as a person reads it; as HTML."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from proprio_ros.addons.pendant.calls import GOOD, Call, Step
from proprio_ros.addons.pendant.desk import REPORT
from proprio_ros.addons.pendant.kept import estimate_in
from proprio_ros.addons.pendant.words import answer_of, table
from proprio_ros.identification.reasons import CODES
from proprio_ros.quantity import shown, spec_for
from proprio_ros.recordings.datasets import arrow

_KEPT = re.compile(r"\b(recording|calibration): (\S[^;]*)")
_RUNS = re.compile(r'<figure>(<svg class="chart" role="img" aria-label="Run .+?)</figure>', re.S)
MOST_ROWS = 500
DONE = "done"
"""Of what has no verdict."""


def number_of(estimate: Mapping[str, Any]) -> tuple[str, str]:
    """The first value and its interval in words; empty where there is none."""
    values = estimate.get("estimates") or [{}]
    first = values[0]
    name = str(first.get("name", ""))
    flat = {name: first.get("value")}
    for key in ("std", "ci95", "unit"):
        flat[f"{name}.{key}"] = first.get(key)
    return answer_of(flat) if name else ("", "")


def verdict(words: str) -> str:
    """As a badge."""
    kind = "good" if words in (GOOD, DONE) else "bad"
    return f'<span class="verdict {kind}">{escape(words.replace("_", " "))}</span>'


def shown_answer(badge: str, number: str, interval: str, otherwise: str) -> str:
    """A verdict with one number, as large as it can be.

    Args:
        badge: The verdict, as `verdict` makes it.
        number: In words; empty: there is none.
        interval: Of the number, in words.
        otherwise: What is said where there is no number.
    """
    lines = f'<p class="number">{escape(number)}</p><p class="interval">{escape(interval)}</p>'
    return f"<p>{badge}</p>" + (lines if number else f'<p class="state">{escape(otherwise)}</p>')


def reasons(found: Mapping[str, Any]) -> str:
    """Why, and what to do."""
    return reason_list(found.get("reasons") or [], found.get("reason_codes") or [])


def reason_list(sentences: Sequence[str], codes: Sequence[str]) -> str:
    """Sentences with what to do about each, as far as their codes are known."""
    rows = []
    for number, sentence in enumerate(sentences):
        code = CODES.get(codes[number]) if number < len(codes) else None
        todo = f'<br><span class="todo">What to do: {escape(code.remedy)}.</span>' if code else ""
        rows.append(f"<li>{escape(str(sentence))}{todo}</li>")
    return f'<ul class="reasons">{"".join(rows)}</ul>' if rows else ""


def answered(step: Step) -> str:
    """All that one command said."""
    found = step.answer
    if found.get("error"):
        return f'<p class="state">{escape(str(found["error"]))}</p>'
    if step.kind == "batch":
        return _batch(found)
    if not found.get("verdict"):
        return f'<p class="state">{escape(str(found.get("message", "")))}</p>'
    otherwise = str((found.get("estimates") or [{}])[0].get("reason") or "no number")
    if step.kind == "calibrate":
        can = found.get("weighable")
        otherwise = ""
        if can:
            mass = shown("kg", can["mass_kg"], spec=".0f")
            half = shown("kg", can["half_width95_kg"], spec=".1f")
            otherwise = f"calibrated: weighs {mass} to ±{half} (95 %)"
    return shown_answer(verdict(found["verdict"]), *number_of(found), otherwise) + reasons(found)


def checked(found: Mapping[str, Any]) -> str:
    """What ``proprio check`` found in one recording."""
    lines = []
    if found.get("joints"):
        gaps = f", {found['gaps']} gaps" if found["gaps"] else ", no gaps"
        lines.append(
            f"{found['duration_s']:.1f} s at {found['rate_Hz']:.0f} Hz{gaps}; joints: {', '.join(found['joints'])}"
        )
    if found.get("input"):
        lines.append(f"input: {found['input']} ({found['input_unit'] or 'unit not known'})")
    if found.get("fitting_drivers"):
        lines.append(
            f"looks like the driver {' or '.join(found['fitting_drivers'])}: state it above, none is used before"
        )
    motion = found.get("motion")
    if motion:
        lines.append(f"a motion of {', '.join(motion['joints'])}, {motion['duration_s']:.1f} s")
    tells = found.get("tells")
    if tells:
        half = shown("kg", tells["mass_half_width_kg"])
        lines.append(
            f"beside the same motion with an empty hand it tells a light mass to about +-{half}"
        )
    said = "".join(f"<p>{escape(line)}</p>" for line in lines)
    if found.get("problem"):
        said += f'<p class="problem">{escape(found["problem"])}</p>'
    notes = [*found.get("record", ()), *(each["sentence"] for each in found.get("findings", ()))]
    advice = "".join(f"<li>{escape(words)}</li>" for words in (*notes, *found.get("notes", ())))
    listed = f'<ul class="reasons">{advice}</ul>' if advice else ""
    return said + _runs(found.get("runs", ())) + listed


def _runs(runs: Sequence[Mapping[str, Any]]) -> str:
    rows = []
    for run in runs:
        half = run["mass_half_width_kg"]
        tells = (
            "usable"
            if half is None
            else f"usable; alone &plusmn;{escape(shown('kg', float(f'{half:.2g}'), spec='g'))}"
        )
        moved = f"{run['travel']:+.2f} {escape(run['unit'])}"
        judged = f"not usable: {escape(run['problem'])}" if run["problem"] else tells
        rows.append(
            [
                escape(run["joint"]),
                f"{1e3 * run['current_A']:+.0f}",
                f"{run['duration_s']:.2f}",
                moved,
                judged,
            ]
        )
    titles = ["run of", "mA", "s", "travel", ""]
    return table(titles, rows) if rows else ""


def _batch(found: Mapping[str, Any]) -> str:
    """Counts, and a row an episode."""
    counts = ", ".join(
        f"{count} {escape(name.replace('_', ' '))}"
        for name, count in found.get("verdicts", {}).items()
    )
    episodes = found.get("episodes", 0)
    head = f'<p class="state">{episodes} recording{"s" * (episodes != 1)}: {counts}</p>'
    names = [
        "episode",
        "unit",
        "value",
        "std",
        "low",
        "high",
        "verdict",
        "reason_codes",
    ]
    rows = arrow().parquet.read_table(Path(found["folder"]) / "rows", columns=names).to_pylist()
    cells = []
    for row in rows[:MOST_ROWS]:
        spec = spec_for(row["unit"], row["std"])
        known = row["value"] is not None
        value = shown(row["unit"], row["value"], spec=spec) if known else "&ndash;"
        interval = (
            shown(
                row["unit"],
                row["low"],
                row["high"],
                spec=spec,
            )
            if known
            else "&ndash;"
        )
        codes = ", ".join(row["reason_codes"] or ())
        cells.append(
            [
                escape(row["episode"]),
                value,
                interval,
                verdict(row["verdict"]),
                escape(codes),
            ]
        )
    return head + table(
        [
            "recording",
            "answer",
            "95 % interval",
            "verdict",
            "reasons",
        ],
        cells,
    )


def folder_of(message: str) -> Path | None:
    """Where the nodes keep what an answer names, the recording first, as far as it is on this computer."""
    found = dict(_KEPT.findall(message))
    place = found.get("recording") or found.get("calibration")
    folder = Path(place).parent if place else None
    return folder if folder and folder.is_dir() else None


def report_of(call: Call) -> Path | None:
    """The page of a call's answer; None: it has none, or is under way."""
    folder = folder_of(str(call.answer["message"])) if call.answer else None
    page = folder / REPORT if folder else None
    return page if page and page.is_file() else None


def figures_of(page: Path | None) -> str:
    """What was measured and simulated in each run, as the page of an answer draws it."""
    text = page.read_text(encoding="utf-8") if page else ""
    return "".join(_RUNS.findall(text))


def answer(call: Call) -> str:
    """All that came of it."""
    found = call.answer or {}
    message = str(found.get("message", ""))
    estimate = found.get("estimate") or {}
    badge = verdict(str(estimate.get("verdict") or (DONE if found.get("success") else "not done")))
    said = [str(estimate[key]) for key in estimate if key.startswith("reason.")]
    # by their codes, where the file of the answer is on this computer
    folder = folder_of(message)
    codes = estimate_in(folder).get("reason_codes", []) if folder else []
    why = reason_list(said, codes if len(codes) == len(said) else [])
    otherwise = "" if said else _KEPT.sub("", message).strip("; ")
    return shown_answer(badge, *answer_of(estimate), otherwise) + why
