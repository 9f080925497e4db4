"""Answers in a notebook's cell: tables that style themselves, and a figure for each kind of answer, also of a refusal."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

import numpy as np

from proprio_ros.identification.calibration_estimate import CalibrationEstimate
from proprio_ros.report.calibration_figures import draw_drive_trains, joints_of
from proprio_ros.report.figures import ACCENT, INK, MUTED, drawn, plain

MOST_ROWS = 40  # of a table or of bars; what there is more is counted


def small_table(
    title: str,
    header: Sequence[str],
    rows: Sequence[Sequence[str]],
    after: Iterable[str] = (),
) -> str:
    """A table without the notebook's own style.

    Args:
        title: Above it.
        header: One word a column.
        rows: Of text.
        after: Sentences below it.
    """
    cell = "padding:.15em .8em .15em 0;text-align:left;vertical-align:top"
    heads = "".join(f'<th style="{cell}">{escape(words)}</th>' for words in header)

    def drawn_cell(words: str) -> str:
        return f'<td style="{cell}{";white-space:nowrap" if len(words) < 20 else ""}">{escape(words)}</td>'

    body = "".join(f"<tr>{''.join(map(drawn_cell, row))}</tr>" for row in rows[:MOST_ROWS])
    more = [f"and {len(rows) - MOST_ROWS} more"] if len(rows) > MOST_ROWS else []
    tail = "".join(f"<div>{escape(sentence)}</div>" for sentence in [*more, *after])
    table = f"<table><thead><tr>{heads}</tr></thead><tbody>{body}</tbody></table>" if rows else ""
    return f"<div><div><b>{escape(title)}</b></div>{table}{tail}</div>"


def words_figure(title: str, sentences: Sequence[str]) -> Any:
    """Where there is nothing to draw: why, as a matplotlib ``Figure``."""
    lines = [line for sentence in sentences for line in textwrap.wrap(sentence, 88) or [""]]
    with drawn(7.4, 0.7 + 0.24 * len(lines)) as (figure, axis):
        axis.set_axis_off()
        axis.set_title(
            plain(title),
            loc="left",
            fontsize=10.5,
            fontweight="bold",
        )
        axis.text(
            0.0,
            1.0,
            plain("\n".join(lines)),
            va="top",
            transform=axis.transAxes,
        )
        return figure


def bars_figure(
    title: str,
    unit: str,
    bars: Sequence[tuple[str, float, bool]],
) -> Any:
    """Named bars; a matplotlib ``Figure``.

    Args:
        title: Of the axis.
        unit: Of the numbers.
        bars: From above; those that are not good are grey.
    """
    if not bars:
        return words_figure(title, ["there is nothing to show"])
    shown = list(bars[:MOST_ROWS])
    names = [plain(textwrap.fill(name, 56, max_lines=3, placeholder=" ...")) for name, *_ in shown]
    with drawn(
        7.4,
        0.9 + sum(0.12 + 0.14 * (1 + name.count("\n")) for name in names),
    ) as (
        figure,
        axis,
    ):
        lengths = [length if np.isfinite(length) else 0.0 for _, length, _ in shown]
        axis.barh(
            range(len(shown)),
            lengths,
            color=[ACCENT if good else MUTED for *_, good in shown],
            height=0.6,
        )
        axis.set_yticks(range(len(shown)), names, fontsize=8.0)
        axis.invert_yaxis()
        axis.set_xlim(left=0.0)
        axis.grid(axis="y", visible=False)
        more = f" ({len(bars) - MOST_ROWS} more are not shown)" if len(bars) > MOST_ROWS else ""
        axis.set_title(
            plain(title + more),
            loc="left",
            fontsize=9.5,
        )
        axis.set_xlabel(unit)
        return figure


def series_figure(
    title: str,
    places: Sequence[str],
    unit: str,
    lines: Sequence[tuple[str, Any, Any]],
) -> Any:
    """Named values with their intervals; a matplotlib ``Figure``.

    Args:
        title: Of the axis.
        places: Names along it.
        unit: Of the numbers.
        lines: Values with half of their intervals, one at every place.
    """
    with drawn(7.4, 3.6) as (figure, axis):
        for number, (name, values, half) in enumerate(lines):
            # beside each other, not on each other
            at = np.arange(len(places)) + 0.06 * (number - 0.5 * (len(lines) - 1))
            axis.errorbar(
                at,
                values,
                yerr=half,
                fmt="o-",
                linewidth=1.0,
                markersize=3.5,
                capsize=2,
                label=plain(name),
            )
        axis.set_xticks(
            range(len(places)),
            places,
            rotation=30,
            ha="right",
            fontsize=8.0,
        )
        axis.set_ylabel(unit)
        axis.set_title(
            textwrap.fill(plain(title), 90),
            loc="left",
            fontsize=9.5,
        )
        axis.legend(
            loc="center left",
            bbox_to_anchor=(1.0, 0.5),
            fontsize=8.0,
        )
        return figure


def calibration_figure(estimate: CalibrationEstimate) -> Any:
    """Drive trains before and after; of motions each weighed by the others; else why there is neither. A matplotlib ``Figure``."""
    if joints_of(estimate.unknowns, of_runs=True):
        return draw_drive_trains(estimate.unknowns)
    weighed = estimate.weighed_empty[:MOST_ROWS]
    if not weighed:
        return words_figure(
            f"calibration {estimate.verdict.value.replace('_', ' ')}",
            estimate.reasons or ("nothing to show",),
        )
    with drawn(7.4, 0.9 + 0.28 * len(weighed)) as (figure, axis):
        grams, half = (
            1e3 * np.array(each)
            for each in zip(*((w.mass_kg, w.half_width) for w in weighed), strict=True)
        )
        axis.errorbar(
            grams,
            range(len(weighed)),
            xerr=half,
            fmt="o",
            color=ACCENT,
            capsize=3,
        )
        axis.axvline(0.0, color=INK, linewidth=0.8)
        axis.set_yticks(
            range(len(weighed)),
            [plain(textwrap.shorten(each.name, 60)) for each in weighed],
            fontsize=8.0,
        )
        axis.invert_yaxis()
        axis.set_xlabel("what each weighs by the calibration of the others, 95 % (g)")
        return figure
