"""The page of a weighing whose pushes were chosen one by one: how the interval shrank, what was pushed, and what was not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np

from proprio_ros.quantity import Sought, shown, shown_unit, spec_for
from proprio_ros.report.chart import Axis, Panel, Series, chart
from proprio_ros.report.html import framed, table, write_document


@dataclass(frozen=True)
class Choice:
    """What was known before a push, and what was chosen."""

    # value, half: of what is sought, and of its 95 % interval; before the first push what may be
    value: float
    half: float
    promised: float  # half interval that the push promises
    chosen: str  # the push, or why there was none, in words
    others: Sequence[str]  # what was not chosen
    decided_s: float  # what it took


def write_choices(
    choices: Sequence[Choice],
    sought: Sought,
    target: float,
    path: Path,
) -> None:
    """Write the page of the pushes that were chosen.

    Args:
        choices: In their order; the last one says why it ended.
        sought: What was to be known.
        target: Half interval that was asked for.
        path: Of the page; an older one of that name is replaced.

    Raises:
        ConfigurationError: The file cannot be written.
    """
    parts = ["<h1>Pushes, one by one</h1>"]
    last = choices[-1]
    if len(choices) > 1:  # before the first nothing is known
        value = shown(
            sought.unit,
            last.value,
            spec=spec_for(sought.unit, sought.std_of(last.half, last.value)),
        )
        pushes = f"{len(choices) - 1} push{'es' * (len(choices) > 2)}"
        after = f"{sought.label} {sought.said(last.half)} (95 %) after {pushes}; {sought.said(target)} asked for"
        parts += [f"<p class=value>{escape(value)}</p>", f"<p class=interval>{escape(after)}</p>"]
    parts.append(f"<p>{escape(last.chosen)}</p>")
    if len(choices) > 1:
        parts.append(_figure(choices, sought, target))
    rows = []
    for number, choice in enumerate(choices, 1):
        known = sought.said(choice.half) if number > 1 else ""
        promised = sought.said(choice.promised) if number < len(choices) else ""
        took = f"{1e3 * choice.decided_s:.0f} ms"
        rows.append(
            [
                str(number),
                known,
                choice.chosen,
                promised,
                "; ".join(choice.others),
                took,
            ]
        )
    header = ["", "known before", "chosen", "promises", "not chosen", "decided in"]
    parts += [
        "<h2>What was chosen, and what was not</h2>",
        table(header, rows, (0, 1, 3, 5), labels=1),
    ]
    write_document(path, "Pushes, one by one", parts, "the page of the choices")


def _figure(choices: Sequence[Choice], sought: Sought, target: float) -> str:
    pushes = np.arange(1.0, len(choices))
    name = sought.label
    factor, unit = shown_unit(sought.unit)
    as_shown, unit_of_half = (100.0, "%") if sought.share else (factor, unit)
    value = factor * np.array([choice.value for choice in choices[1:]])
    half = as_shown * np.array([choice.half for choice in choices[1:]])
    width = half * (0.01 * value if sought.share else 1.0)
    known = Series(name, pushes, value, "measured")
    promises = as_shown * np.array([choice.promised for choice in choices[:-1]])
    promised = Series("promised", pushes, promises, "simulated", "dots")
    halves = [promised, Series("reached", pushes, half, "measured")]
    rules = [as_shown * target]
    panels = [
        Panel(
            f"{name} ({unit})",
            unit,
            [known],
            band=(pushes, value - width, value + width),
        ),
        Panel(f"half 95 % interval ({unit_of_half})", unit_of_half, halves, rules=rules, log=True),
    ]
    about = f"{name} and 95 % interval after each push. Below: half of it, what the push promised, what was asked for."
    return framed(
        chart(panels, Axis("pushes", "", whole=True), "Interval after each push"), f"Above: {about}"
    )
