"""The answer of a call as a page shows it: one number with its interval, verdict, reasons with what to do; as HTML."""

from __future__ import annotations

import re
from pathlib import Path

from proprio_ros.addons.pendant.calls import Call
from proprio_ros.addons.pendant.kept import estimate_in
from proprio_ros.addons.pendant.results import DONE, reason_list, shown_answer, verdict
from proprio_ros.addons.pendant.words import answer_of

_KEPT = re.compile(r"\b(recording|calibration): (\S[^;]*)")
_RUNS = re.compile(r'<figure>(<svg class="chart" role="img" aria-label="Run .+?)</figure>', re.S)
REPORT = "report.html"
MOST_RUNS = 24


def folder_of(message: str) -> Path | None:
    """Where the nodes keep what an answer names, the recording first, as far as it is on this computer."""
    found = dict(_KEPT.findall(message))
    place = found.get("recording") or found.get("calibration")
    folder = Path(place).parent if place else None
    return folder if folder is not None and folder.is_dir() else None


def report_of(call: Call | None) -> Path | None:
    """The page of a call's answer."""
    folder = folder_of(str(call.answer["message"])) if call is not None and call.answer else None
    page = folder / REPORT if folder is not None else None
    return page if page is not None and page.is_file() else None


def figures_of(page: Path | None) -> str:
    """What was measured and simulated in each run, as the page of an answer draws it."""
    text = page.read_text(encoding="utf-8") if page is not None else ""
    return "".join(_RUNS.findall(text)[:MOST_RUNS])


def answer(call: Call) -> str:
    """All that came of it."""
    found = call.answer or {}
    message = str(found.get("message", ""))
    estimate = found.get("estimate") or {}
    badge = verdict(str(estimate.get("verdict") or (DONE if found.get("success") else "not done")))
    otherwise = _KEPT.sub("", message).strip("; ")
    said = [str(estimate[key]) for key in estimate if key.startswith("reason.")]
    # by their codes, where the file of the answer is on this computer
    folder = folder_of(message)
    codes = estimate_in(folder).get("reason_codes", []) if folder is not None else []
    why = reason_list(said, codes if len(codes) == len(said) else [])
    return shown_answer(badge, *answer_of(estimate), otherwise) + why
