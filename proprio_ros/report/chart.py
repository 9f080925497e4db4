"""Plots over one axis as SVG in the page's own colours, whose words stay readable on a narrow screen.

The style sheet colours them, so that they follow the reader's colour scheme. ``chart.js`` reads the numbers back from the paths
when a pointer rests on one, and stretches the axis where it is dragged; without scripts they are plain pictures.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

WIDTH = 640.0
LEFT = 74.0
RIGHT = 14.0
TITLE, BELOW, AXIS = 34.0, 12.0, 42.0
"""Height of a panel's title, of the space below a panel, and of the axis below the last one."""
INSIDE = WIDTH - LEFT - RIGHT
MARGIN = 0.06  # space above and below the curves, as a share of their range


@dataclass(frozen=True)
class Series:
    """A curve."""

    name: str  # for the legend and the pointer; one without a name is not in them
    # x, y: shape (K,)
    x: np.ndarray
    y: np.ndarray
    color: str  # class of the style sheet, such as ``measured``
    # ``line``, ``dots``, ``steps`` (each value holds until the next), or ``pairs`` (a line from each first to each second)
    kind: str = "line"
    listed: bool = True  # whether it is in the legend


@dataclass(frozen=True)
class Panel:
    """One of several plots below each other."""

    title: str  # with the unit of y in brackets
    unit: str  # of y
    series: Sequence[Series]  # the last one is on top
    height: float = 150.0  # of the plot
    # x, lower and upper end of a coloured band, shape (K,) each
    band: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
    spans: Sequence[tuple[float, float]] = ()  # from where to where of x the plot is shaded
    rules: Sequence[float] = ()  # values of y with a dashed line
    verticals: Sequence[float] = ()  # values of x with a line
    log: bool = False  # whether y is a logarithmic axis
    highest: float = math.inf  # of y that is shown


@dataclass(frozen=True)
class Axis:
    """The common axis: its title with the unit in brackets, the unit, and whether it is logarithmic, or of whole numbers."""

    title: str
    unit: str
    log: bool = False
    whole: bool = False


def chart(panels: Sequence[Panel], axis: Axis, name: str) -> str:
    """The SVG of panels from above with the axis below all of them; ``name`` is for those who cannot see it."""
    every = np.concatenate([_of(s.x, axis.log) for panel in panels for s in panel.series])
    x0, x1 = _reach(every, 0.01)
    top = 0.0
    body = []
    edges = []
    for panel in panels:
        top += TITLE
        body.append(_panel(panel, axis, x0, x1, top))
        edges.append((top, top + panel.height))
        top += panel.height + BELOW
    bottom = edges[-1][1]
    marks = []
    for value, word in _ticks(x0, x1, axis.log, whole=axis.whole):
        at = LEFT + (value - x0) / (x1 - x0) * INSIDE
        line = "".join(f"M{_n(at)},{_n(above)}V{_n(below)}" for above, below in edges)
        marks.append(
            f'<path d="{line}"/><text x="{_n(at)}" y="{_n(bottom + 18)}" text-anchor="middle">{word}</text>'
        )
    title = f'<text x="{_n(LEFT + INSIDE / 2)}" y="{_n(bottom + AXIS - 4)}" text-anchor="middle">{escape(axis.title)}</text>'
    log = " data-log" if axis.log else ""
    return (
        f'<svg class="chart" role="img" aria-label="{escape(name)}" viewBox="0 0 {_n(WIDTH)} {_n(bottom + AXIS)}" '
        f'data-x0="{x0:.9g}" data-x1="{x1:.9g}" data-unit="{escape(axis.unit)}"{log}>'
        f'<g class="ticks">{"".join(marks)}</g>{title}{"".join(body)}</svg>'
    )


def _panel(
    panel: Panel,
    axis: Axis,
    x0: float,
    x1: float,
    top: float,
) -> str:
    seen = [_of(s.y, panel.log) for s in panel.series]
    seen += [
        _of(np.array(panel.rules), panel.log),
        *(panel.band[1:] if panel.band is not None else ()),
    ]
    every = np.concatenate(seen)
    y0, y1 = _reach(np.minimum(every, panel.highest), MARGIN)

    def points(x: np.ndarray, y: np.ndarray) -> list[str]:
        x = _of(x, axis.log)
        y = _of(y, panel.log)
        good = np.isfinite(x) & np.isfinite(y)
        right = (x[good] - x0) / (x1 - x0) * INSIDE
        down = (y1 - y[good]) / (y1 - y0) * panel.height
        return [f"{_n(a)},{_n(b)}" for a, b in zip(right, down, strict=True)]

    def across(value: float) -> str:
        return _n((float(_of(np.array(value), axis.log)) - x0) / (x1 - x0) * INSIDE)

    drawn = []
    legend = []
    for low, high in panel.spans:
        drawn.append(
            f'<path class="span" d="M{across(low)},0H{across(high)}V{_n(panel.height)}H{across(low)}Z"/>'
        )
    if panel.band is not None:
        times, low_y, high_y = panel.band
        around = "L".join([*points(times, high_y), *points(times, low_y)[::-1]])
        drawn.append(f'<path class="span" d="M{around}Z"/>')
    drawn += [
        f'<path class="vertical" d="M{across(value)},0V{_n(panel.height)}"/>'
        for value in panel.verticals
    ]
    ends = np.array([10.0**x0, 10.0**x1] if axis.log else [x0, x1])
    drawn += [
        f'<path class="rule" d="M{"L".join(points(ends, np.full(2, rule)))}"/>'
        for rule in panel.rules
    ]
    for series in panel.series:
        places = points(series.x, series.y)
        if not places:
            continue
        line = f"M{'L'.join(places)}"
        if series.kind == "dots":
            line = "".join(f"M{place}h0" for place in places)
        elif series.kind == "pairs":
            line = "".join(
                f"M{low}L{high}" for low, high in zip(places[::2], places[1::2], strict=True)
            )
        elif series.kind == "steps":
            line = f"M{places[0]}" + "".join(
                f"H{place.partition(',')[0]}L{place}" for place in places[1:]
            )
        named = (
            f' data-name="{escape(series.name)}" data-unit="{escape(panel.unit)}"'
            if series.name
            else ""
        )
        drawn.append(f'<path class="{series.kind} {series.color}"{named} d="{line}"/>')
        if series.name and series.listed:
            sign = "\N{BLACK CIRCLE}" if series.kind == "dots" else "\N{EM DASH}"
            legend.append(
                f'<tspan class="{series.color}" dx="14">{sign} {escape(series.name)}</tspan>'
            )
    words = f'<text x="2" y="{_n(top - 11)}"><tspan class="title">{escape(panel.title)}</tspan>{"".join(legend)}</text>'
    marks = []
    for value, word in _ticks(y0, y1, panel.log, panel.height / 22.0):
        at = top + (y1 - value) / (y1 - y0) * panel.height
        marks.append(
            f'<path d="M{_n(LEFT)},{_n(at)}h{_n(INSIDE)}"/>'
            f'<text x="{_n(LEFT - 8)}" y="{_n(at)}" dy=".35em" text-anchor="end">{word}</text>'
        )
    log = " data-log" if panel.log else ""
    return (
        f'{words}<g class="grid">{"".join(marks)}</g>'
        f'<svg class="plot" x="{_n(LEFT)}" y="{_n(top)}" width="{_n(INSIDE)}" height="{_n(panel.height)}" '
        f'viewBox="0 0 {_n(INSIDE)} {_n(panel.height)}" preserveAspectRatio="none" '
        f'data-y0="{y0:.9g}" data-y1="{y1:.9g}"{log}>{"".join(drawn)}</svg>'
    )


def _of(values: np.ndarray, log: bool) -> np.ndarray:
    """On the axis: the decimal logarithm where that is what it shows."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.log10(values) if log else np.asarray(values, dtype=float)


def _reach(values: np.ndarray, margin: float) -> tuple[float, float]:
    """From the least to the largest finite value and a little further; something around them where they are one."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        return 0.0, 1.0
    low = float(finite.min())
    high = float(finite.max())
    if high - low < 1e-9 * max(abs(low), abs(high), 1e-6):
        low = low - max(0.1 * abs(low), 1e-3)
        high = high + max(0.1 * abs(high), 1e-3)
    spare = margin * (high - low)
    return low - spare, high + spare


def _ticks(
    low: float,
    high: float,
    log: bool,
    most: float = 7.0,
    whole: bool = False,
) -> list[tuple[float, str]]:
    """Places on the axis and what stands there: round numbers."""
    if log:
        digits_shown = (1,) if high - low > 1.5 else (1, 2, 5)
        decades = range(
            math.floor(low),
            math.ceil(high) + 1,
            max(
                1,
                math.ceil((high - low) / most),
            ),
        )
        values = [digit * 10.0**decade for decade in decades for digit in digits_shown]
        return [
            (math.log10(v), f"{v:g}".replace("e+0", "e"))
            for v in values
            if low <= math.log10(v) <= high
        ]
    power = 10.0 ** math.floor(math.log10((high - low) / most))
    step = next(power * digit for digit in (1, 2, 5, 10) if (high - low) / (power * digit) < most)
    if math.floor(high / step) - math.ceil(low / step) < 1:  # one mark is no scale
        step /= 2.0
    if whole:
        step = max(step, 1.0)
    digits = max(0, -math.floor(math.log10(step) + 1e-9))
    digits += round(step * 10.0**digits, 6) % 1.0 > 0.0
    places = range(
        math.ceil(low / step - 1e-9),
        math.floor(high / step + 1e-9) + 1,
    )
    return [(place * step, _signed(f"{place * step:.{digits}f}")) for place in places]


def _signed(number: str) -> str:
    return number.replace("-", "\N{MINUS SIGN}") if float(number) else number.lstrip("-")


def _n(value: float) -> str:
    """Hundredths of a unit of the picture; never a negative zero."""
    return f"{round(float(value), 2) + 0.0:.6g}"
