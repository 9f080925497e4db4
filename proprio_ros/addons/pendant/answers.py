"""The answer of a call as a page shows it: one number with its interval, verdict, reasons with what to do; as HTML."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any

from proprio_ros.addons.pendant.calls import Call
from proprio_ros.addons.pendant.results import reason_list
from proprio_ros.addons.pendant.words import answer_of

_KEPT = re.compile(r"\b(recording|calibration): (\S[^;]*)")
REPORT = "report.html"


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


def answer(call: Call) -> str:
    """All that came of it."""
    found = call.answer or {}
    message = str(found.get("message", ""))
    estimate = found.get("estimate") or {}
    number, interval = answer_of(estimate)
    verdict = str(estimate.get("verdict", ""))
    if not verdict:
        verdict = "done" if found.get("success") else "not done"
    kind = "good" if found.get("success") else "bad"
    lines = [
        f'<p class="verdict {kind}">{escape(verdict.replace("_", " "))}</p>',
        f'<p class="number">{escape(number)}</p>' * bool(number),
        f'<p class="interval">{escape(interval)}</p>' * bool(number),
    ]
    if not number:
        lines.append(f'<p class="state">{escape(_KEPT.sub("", message).strip("; "))}</p>')
    return "".join(lines) + _reasons(
        estimate,
        message,
    )


def _reasons(estimate: Mapping[str, Any], message: str) -> str:
    """Why, and what to do: by their codes, where the file of the answer is on this computer."""
    said = [str(estimate[key]) for key in estimate if key.startswith("reason.")]
    codes = _codes(message)
    return reason_list(said, codes if len(codes) == len(said) else [])


def _codes(message: str) -> list[str]:
    folder = folder_of(message)
    try:
        kept = json.loads((folder / "estimate.json").read_text()) if folder else {}
    except (OSError, ValueError):
        return []
    return [str(code) for code in kept.get("reason_codes", [])]
