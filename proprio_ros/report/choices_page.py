"""The page of a weighing whose pushes were chosen one by one: how the interval shrank, what was pushed, and what was not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np

from proprio_ros.inputs.resources import write_in_one_step
from proprio_ros.quantity import Sought, shown_unit
from proprio_ros.report.chart import Axis, Panel, Series, chart
from proprio_ros.report.html import document, framed, table


@dataclass(frozen=True)
class Choice:
    """What was known before a push, and what was chosen.

    Attributes:
        value, half: Of what is sought, and of its 95 % interval; before the first push what may be.
        promised: Half interval that the push promises.
        chosen: The push, or why there was none, in words; others: what was not chosen.
        decided_s: What it took.
    """

    value: float
    half: float
    promised: float
    chosen: str
    others: Sequence[str]
    decided_s: float


def write_choices(choices: Sequence[Choice], sought: Sought, target: float, path: Path) -> None:
    """Write the page; an older one of that name is replaced in one step.

    Args:
        choices: In order; the last says why it ended.
        sought: What the choices are about.
        target: Half interval that was asked for.
        path: The HTML file.

    Raises:
        ConfigurationError: It cannot be written.
    """
    write_in_one_step(path, _page(choices, sought, target), "the page of the choices")


def _page(choices: Sequence[Choice], sought: Sought, target: float) -> str:
    parts = ["<h1>Pushes, one by one</h1>", f"<p>{escape(choices[-1].chosen)}</p>"]
    known = list(enumerate(choices))[1:]  # before the first nothing is
    if known:
        pushes = np.array([number for number, _ in known], dtype=float)
        factor, unit = shown_unit(sought.unit)
        as_shown, unit_of_half = (100.0, "%") if sought.share else (factor, unit)
        value = factor * np.array([choice.value for _, choice in known])
        half = as_shown * np.array([choice.half for _, choice in known])
        promised = as_shown * np.array([before.promised for (_, _), before in zip(known, choices, strict=False)])
        width = half * (0.01 * value if sought.share else 1.0)
        panels = [
            Panel(
                f"{sought.label} ({unit})", unit, [Series(sought.label, pushes, value, "measured")],
                band=(pushes, value - width, value + width),
            ),
            Panel(
                f"half 95 % interval ({unit_of_half})", unit_of_half,
                [Series("promised", pushes, promised, "simulated", "dots"), Series("reached", pushes, half, "measured")],
                rules=[as_shown * target], log=True,
            ),
        ]  # fmt: skip
        words = (
            f"Above: {sought.label} and 95 % interval after each push. Below: half of it, what the push promised, what was "
            "asked for."
        )
        parts.append(framed(chart(panels, Axis("pushes", ""), "Interval after each push"), words, "large"))
    rows = [
        [
            str(number),
            sought.said(choice.half) if number > 1 else "",
            choice.chosen,
            sought.said(choice.promised) if number < len(choices) else "",
            "; ".join(choice.others),
            f"{1e3 * choice.decided_s:.0f} ms",
        ]
        for number, choice in enumerate(choices, 1)
    ]
    header = ["", "known before", "chosen", "promises", "not chosen", "decided in"]
    parts += ["<h2>What was chosen, and what was not</h2>", table(header, rows, (0, 1, 3, 5))]
    return document("Pushes, one by one", parts)
