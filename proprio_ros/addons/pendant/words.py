"""What the nodes say, as a person at the arm reads it: numbers with as many digits as are known, ages, lights; as HTML."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np

from proprio_ros.addons.pendant.news import News
from proprio_ros.quantity import shown, spec_for

LEVELS = ("good", "warning", "bad")
NOTHING = "–"
AXES = 3
WATER_KG_M3 = 1000.0
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
        values = json.loads(text) if isinstance(text, str) else text
        return [float(each) for each in np.ravel(values)]
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
    if not value or len(ends) != 2 or not np.all(np.isfinite([*value, *ends])):
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
    running = news.claims("running")
    about = "running" if running else "estimate"
    number, interval = answer_of(news.said("estimate").values)
    age = news.age_s(about)
    old = news.is_old(about)
    how = "running estimate" if running else "answer" if news.claims("final") else "so far"
    lines = [
        f'<p class="number{" old" * old}">{escape(number) or "&ndash;"}</p>',
        f'<p class="interval">{escape(interval) or "Nothing is known of what the hand holds"}</p>',
        f'<p class="state">{escape(_holding(news))}</p>',
    ]
    if number:
        lines.append(f'<p class="small">{how}, {age_in_words(age)}</p>')
    found = body(news)
    if found is not None:
        lines.append(f'<p class="small">{escape(found.words)}</p>')
    return "".join(lines)


@dataclass(frozen=True)
class Body:
    """What is in the hand, as it is drawn in the frame of the link that holds it.

    Attributes:
        centre_m: Of its mass, shape (3,).
        half_m: Semi-axes of what is drawn, shape (3,).
        known: Whether these are the 95 % intervals of the centre; else a ball of water weighs as much.
    """

    centre_m: Sequence[float]
    half_m: Sequence[float]
    known: bool

    @property
    def words(self) -> str:
        """Where its centre is."""
        if not self.known:
            return "Drawn as a ball of water, at the centre that was stated or is assumed"
        ends = zip(self.centre_m, self.half_m, strict=True)
        places = ", ".join(f"{1e3 * at:.1f} ±{1e3 * half:.1f}" for at, half in ends)
        return f"Its centre of mass: {places} mm (95 %), drawn as that ellipsoid"


def body(news: News) -> Body | None:
    """What is in the hand; None: nobody says."""
    held = news.entries.get("payload")
    if held is None or not held.mass_kg > 0.0 or news.entries.get("holding") is False:
        return None
    ends = _numbers(news.said("estimate").values.get("payload_com.ci95"))
    if len(ends) == 2 * AXES and np.all(np.isfinite(ends)):
        widths = np.ptp(np.reshape(ends, (AXES, 2)), axis=1)
        return Body(held.centre_m, (0.5 * widths).tolist(), True)
    radius_m = (0.75 * held.mass_kg / (WATER_KG_M3 * math.pi)) ** (1.0 / 3.0)
    return Body(held.centre_m, [radius_m] * AXES, False)


def _holding(news: News) -> str:
    held = news.entries.get("holding")
    words = ""
    if held is not None:
        words = "Something is in the hand" if held else "The hand is empty"
    carries = news.said("capability").values
    most = _numbers(carries.get("most"))
    can = {"true": "can carry it here", "false": "can NOT carry it here"}
    said = can.get(carries.get("can_carry", ""))
    if said and most:
        words += f"{'; ' * bool(words)}the arm {said}, {shown('kg', most[0])} at most"
    return words


def lights(news: News) -> str:
    """Nodes and bus, a light each, and since when one is silent."""
    rows = []
    for name in LIGHTS:
        said = news.said(name)
        if name in news.nodes:
            words = said.message.partition(";")[0] or "is there"
            rows.append(_light(LEVELS[min(said.level, 2)], name, words))
        else:
            rows.append(_light("old", name, "is not there; start it: proprio live"))
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
        measured = f"{effort:.2f}" if math.isfinite(effort) else NOTHING
        warmth = values.get("temperature [C]", NOTHING).removesuffix(".0")
        motor = escape(servo.message) if servo else NOTHING
        rows.append(
            [
                escape(name),
                f"{at:.3f}",
                measured,
                escape(warmth),
                motor,
            ]
        )
    if not rows:
        return '<p class="small">No joint states are coming.</p>'
    kind = "old" if news.is_old("states") else "now"
    titles = [
        "joint",
        "rad, m",
        "N m, N",
        "°C",
        "motor",
    ]
    return f'<div class="{kind}">{table(titles, rows)}</div>'


def table(titles: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Of cells that are HTML."""
    head = "".join(f'<th scope="col">{escape(title)}</th>' for title in titles)
    body = "".join("<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in rows)
    return f'<div class="wide"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'
