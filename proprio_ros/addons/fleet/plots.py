"""The plots of a batch: values of each source over time with their intervals, and how often which value was accepted."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import datetime, timezone

import numpy as np

from proprio_ros.addons.fleet.rows import Row
from proprio_ros.quantity import shown_unit
from proprio_ros.report.chart import Axis, Panel, Series, chart
from proprio_ros.report.html import framed

MOST_POINTS = 10_000  # of a plot
# recordings that begin within less are shown in their order, which says more
SHORTEST_NS = 60 * 10**9


def values_figure(own: Sequence[Row], name: str) -> str:
    """Of one source; ``number`` of a row is kept for the script that opens the row of a dot."""
    own = own[:: math.ceil(len(own) / MOST_POINTS)]
    x, axis = _over_time(own)
    factor, unit = shown_unit(own[0]["unit"])
    value = factor * np.array([row["value"] for row in own], dtype=float)
    ends = factor * np.array([_interval(row) for row in own], dtype=float)  # (R, 2)
    accepted = np.array([row["verdict"] == "accepted" for row in own])
    # an interval of a metre must not make all others invisible
    shown = _range_of(value, ends, accepted)
    inside = (value >= shown[0]) & (value <= shown[1])
    ends = np.clip(ends, *shown)
    series = []
    dots = []
    for words, color, mask in (
        ("not accepted", "apart", inside & ~accepted),
        ("accepted", "agreeing", inside & accepted),
    ):
        if mask.any():
            series.append(Series("", np.repeat(x[mask], 2), ends[mask].ravel(), color, "pairs"))
            series.append(Series(words, x[mask], value[mask], color, "dots"))
            dots.append(_numbers_of(own, mask))
    title = own[0]["quantity"].replace("_", " ") + f" ({unit})" * bool(unit)
    caption = f"{name}: dots with their 95 % intervals"
    if not inside.all():
        left = int((~inside).sum())
        caption += f"; {left} that were not accepted lie outside of the picture"
    svg = chart([Panel(title, unit, series, 220.0)], axis, f"Values of {name}")
    return f"<div data-dots='{' '.join(dots)}'>{framed(svg, caption)}</div>"


def _numbers_of(rows: Sequence[Row], mask: np.ndarray) -> str:
    """Numbers of some rows, for the script."""
    return ",".join(str(rows[place]["number"]) for place in np.flatnonzero(mask).tolist())


def _interval(row: Row) -> tuple[float, float]:
    """Of a row that has a value; where it has no interval, twice that."""
    low = row["value"] if row["low"] is None else row["low"]
    high = row["value"] if row["high"] is None else row["high"]
    return low, high


def _range_of(
    value: np.ndarray,
    ends: np.ndarray,
    accepted: np.ndarray,
) -> tuple[float, float]:
    """What a picture shows: the accepted values, or all where none is accepted, and half as much beyond at each side.

    Args:
        value: The values, shape (R,).
        ends: Their intervals, shape (R, 2).
        accepted: Which are accepted, shape (R,).
    """
    seen = accepted if accepted.any() else np.full(len(value), True)
    low = ends[seen, 0]
    high = ends[seen, 1]
    bottom = min(value[seen].min(), np.percentile(low, 2))
    top = max(value[seen].max(), np.percentile(high, 98))
    return 1.5 * bottom - 0.5 * top, 1.5 * top - 0.5 * bottom


def _over_time(rows: Sequence[Row]) -> tuple[np.ndarray, Axis]:
    """Where each stands: over time where all stamps say it, else in their order."""
    stamps = np.array(
        [row["recorded_ns"] or 0 for row in rows],
        dtype=np.int64,
    )
    if not stamps.all() or np.ptp(stamps) < SHORTEST_NS:
        return np.arange(len(rows), dtype=float), Axis("rows in their order", "")
    seconds = 1e-9 * (stamps - stamps.min())
    units = ((86400, "days"), (3600, "hours"), (60, "minutes"))
    size, unit = next(
        (size, unit) for size, unit in units if seconds.max() > 2 * size or size == 60
    )
    begin = datetime.fromtimestamp(1e-9 * float(stamps.min()), timezone.utc)
    return seconds / size, Axis(f"{unit} since {begin:%Y-%m-%d %H:%M} UTC", unit)


def histogram(accepted: Sequence[Row]) -> list[str]:
    """In steps that are round numbers, not much finer than the values' errors; nothing for fewer than ten."""
    if len(accepted) < 10:
        return []
    factor, unit = shown_unit(accepted[0]["unit"])
    values = factor * np.array([row["value"] for row in accepted])
    inside, reach = _without_far_ones(values)
    std = factor * float(np.median([row["std"] or 0.0 for row in accepted]))
    step = _round_step(max(np.ptp(inside) / 80.0, 1e-3 * reach, 0.5 * std))
    first = np.floor(inside.min() / step)
    last = np.floor(inside.max() / step)
    edges = step * np.arange(first, last + 2)
    counts = np.append(np.histogram(inside, edges)[0], 0).astype(float)
    bars = Series(
        "rows",
        np.append(edges[0], edges),
        np.append(0.0, counts),
        "agreeing filled",
        "steps",
        False,
    )
    quantity = accepted[0]["quantity"].replace("_", " ")
    axis = Axis(f"accepted {quantity}" + f" ({unit})" * bool(unit), unit)
    panel = Panel(f"rows, in steps of {step:g} {unit}", "", [bars], 120.0)
    svg = chart([panel], axis, f"Histogram: {axis.title}")
    left = len(values) - len(inside)
    return [framed(svg, f"{left} accepted rows lie further off" if left else "")]


def _round_step(least: float) -> float:
    """The least round number that is not less."""
    power = 10.0 ** np.floor(np.log10(least))
    enough = least * (1.0 - 1e-9)
    return next(power * digit for digit in (1, 2, 5, 10) if power * digit >= enough)


def _without_far_ones(values: np.ndarray) -> tuple[np.ndarray, float]:
    """Values (R,) without those that would make one bar of all others, and how far from the middle half such are."""
    low, high = np.percentile(values, (25, 75))
    reach = 3.0 * max(high - low, 1e-6 * abs(high), 1e-9)
    return values[(values >= low - reach) & (values <= high + reach)], reach
