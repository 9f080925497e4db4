"""What the nodes say, as a person at the arm reads it: numbers with as many digits as are known, ages, lights; as HTML."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from html import escape
from typing import Any

from proprio_ros.addons.pendant.news import News, Said
from proprio_ros.quantity import shown, spec_for

LEVELS = ("good", "warning", "bad")
LIGHTS = ("driver", "excitation", "identifier")


def age_in_words(seconds: float) -> str:
    """How long ago something was."""
    if not math.isfinite(seconds):
        return "never"
    if seconds < 1.0:
        return "now"
    if seconds < 120.0:
        return f"{seconds:.0f} s ago"
    return f"{seconds / 60.0:.0f} min ago" if seconds < 7200.0 else f"{seconds / 3600.0:.0f} h ago"


def _numbers(text: Any) -> list[float]:
    """Of a text or a list; empty where it has none."""
    try:
        values = (
            json.loads(text)
            if isinstance(
                text,
                str,
            )
            else text
        )
        return [
            float(value)
            for value in (
                values
                if isinstance(
                    values,
                    list,
                )
                else [values]
            )
        ]
    except (ValueError, TypeError):
        return []


def answer_of(values: Mapping[str, Any]) -> tuple[str, str]:
    """The first value that was identified and its interval, as a reader wants them.

    Args:
        values: Keys and values of an estimate, as `~/estimate` has them or ``proprio call --json``.

    Returns:
        Such as "49.9 g" and "95 % interval 47.3 .. 52.6 g"; empty where there is none.
    """
    name = next((key[: -len(".ci95")] for key in values if key.endswith(".ci95")), "")
    value = _numbers(values.get(name))
    ends = _numbers(values.get(f"{name}.ci95"))
    std = _numbers(values.get(f"{name}.std"))
    if (
        not value
        or len(ends) != 2
        or not all(
            map(
                math.isfinite,
                [*value, *ends],
            )
        )
    ):
        return "", ""
    unit = str(values.get(f"{name}.unit", ""))
    spec = spec_for(
        unit,
        std[0] if std else None,
    )
    return (
        shown(
            unit,
            value[0],
            spec=spec,
        ),
        f"95 % interval {shown(unit, *ends, spec=spec)}",
    )


def hand(news: News) -> str:
    """What the hand holds: one number, as large as it can be."""
    said = news.entries.get("estimate")
    running = news.is_running
    about = "running" if running else "estimate"
    number, interval = (
        answer_of(said.values)
        if isinstance(
            said,
            Said,
        )
        else ("", "")
    )
    age = news.age_s(about)
    old = news.is_old(about)
    final = (
        isinstance(
            said,
            Said,
        )
        and said.values.get("final") == "true"
    )
    how = "running estimate" if running else "answer" if final else "so far"
    lines = [
        f'<p class="number{" old" * old}">{escape(number) or "&ndash;"}</p>',
        f'<p class="interval">{escape(interval) or "Nothing is known of what the hand holds"}</p>',
        f'<p class="state">{escape(_holding(news))}</p>',
    ]
    if number:
        lines.append(f'<p class="small">{how}, {age_in_words(age)}</p>')
    return "".join(lines)


def _holding(news: News) -> str:
    held = news.entries.get("holding")
    carries = news.entries.get("capability")
    words = ""
    if held is not None:
        words = "Something is in the hand" if held else "The hand is empty"
    if isinstance(carries, Said):
        most = _numbers(carries.values.get("most"))
        can = {"true": "can carry it here", "false": "can NOT carry it here"}
        said = can.get(
            carries.values.get("can_carry", ""),
            "",
        )
        if said and most:
            words += f"{'; ' * bool(words)}the arm {said}, {shown('kg', most[0])} at most"
    return words


def lights(news: News) -> str:
    """Nodes and bus, a light each, and since when one is silent."""
    rows = []
    for name in LIGHTS:
        said = news.entries.get(name)
        there = name in news.nodes
        level = (
            said.level
            if isinstance(
                said,
                Said,
            )
            and there
            else 0
        )
        words = (
            said.message.partition(";")[0]
            if isinstance(
                said,
                Said,
            )
            else ""
        )
        if not there:
            rows.append(
                _light(
                    "old",
                    name,
                    "is not there; start it: proprio live",
                )
            )
        else:
            rows.append(
                _light(
                    LEVELS[min(level, 2)],
                    name,
                    words or "is there",
                )
            )
    states = news.age_s("states")
    kind = "old" if news.is_old("states") else "good"
    rows.append(_light(kind, "joint states", f"the newest came {age_in_words(states)}"))
    bus = next((each for each in news.diagnostics if each.name.endswith("servo bus")), None)
    if bus is not None:
        rate = bus.values.get("rate [Hz]", "")
        rows.append(_light(LEVELS[min(bus.level, 2)], "servo bus", f"{bus.message} {rate} Hz"))
    return f'<ul class="lights">{"".join(rows)}</ul>'


def _light(kind: str, name: str, words: str) -> str:
    state = {
        "good": "well",
        "warning": "warning",
        "bad": "error",
        "old": "silent",
    }[kind]
    return (
        f'<li class="{kind}"><b>{escape(name)}</b> <span class="unseen">{state}:</span> '
        f"<span>{escape(words)}</span></li>"
    )


def warnings(news: News) -> str:
    """What is wrong now, in words."""
    return "".join(f"<p>{escape(words)}</p>" for words in news.warnings)


def joints(news: News) -> str:
    """What each motor does: a row a joint; grey where its news is old."""
    servos = {each.name.rpartition(": ")[2]: each for each in news.diagnostics}
    rows = []
    for name, at in news.positions.items():
        servo = servos.get(name)
        effort = news.efforts.get(
            name,
            math.nan,
        )
        values = servo.values if servo else {}
        cells = [
            f"{at:.3f}",
            f"{effort:.2f}" if math.isfinite(effort) else "&ndash;",
            escape(
                values.get(
                    "temperature [C]",
                    "&ndash;",
                ).removesuffix(".0")
            ),
            escape(servo.message) if servo else "&ndash;",
        ]
        rows.append(
            _row(
                "td",
                [escape(name), *cells],
            )
        )
    head = _row(
        "th",
        ["joint", "rad, m", "N m, N", "&deg;C", "motor"],
    )
    if not rows:
        return '<p class="small">No joint states are coming.</p>'
    old = ' class="old"' if news.is_old("states") else ""
    return f"<table{old}><thead>{head}</thead><tbody>{''.join(rows)}</tbody></table>"


def _row(tag: str, cells: Iterable[str]) -> str:
    return "<tr>" + "".join(f"<{tag}>{cell}</{tag}>" for cell in cells) + "</tr>"
