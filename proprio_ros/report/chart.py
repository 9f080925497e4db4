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


@dataclass(frozen=True)
class _Scale:
    """From values of an axis to px."""

    low: float  # ends of the axis, decimal logarithms where it is logarithmic
    high: float
    log: bool

    @classmethod
    def about(cls, values: np.ndarray, log: bool, margin: float) -> _Scale:
        """An axis that holds values.

        Args:
            values: As they are on it, (K,).
            log: Whether they are decimal logarithms.
            margin: Beyond them, as a share of their range.
        """
        low, high = _reach(values, margin)
        return cls(low, high, log)

    def share(self, values: np.ndarray) -> np.ndarray:
        """Where values are on the axis, 0 to 1."""
        return (_of(values, self.log) - self.low) / (self.high - self.low)

    @property
    def ends(self) -> np.ndarray:
        """The values at both ends, (2,)."""
        if self.log:
            return np.array([10.0**self.low, 10.0**self.high])
        return np.array([self.low, self.high])

    @property
    def attribute(self) -> str:
        """What tells the page's script that the axis is logarithmic."""
        return " data-log" if self.log else ""


@dataclass(frozen=True)
class _Plot:
    """The inside of a panel."""

    across: _Scale
    up: _Scale
    height: float  # px

    def x(self, value: float) -> str:
        return _n(float(self.across.share(np.array(value))) * INSIDE)

    def points(self, x: np.ndarray, y: np.ndarray) -> list[str]:
        """Those that are numbers, as `x,y`."""
        right = self.across.share(x)
        up = self.up
        down = (up.high - _of(y, up.log)) / (up.high - up.low)
        good = np.isfinite(right) & np.isfinite(down)
        return [
            f"{_n(a * INSIDE)},{_n(b * self.height)}"
            for a, b in zip(right[good], down[good], strict=True)
        ]


def chart(panels: Sequence[Panel], axis: Axis, name: str) -> str:
    """The SVG of panels from above with the axis below all of them.

    Args:
        panels: At least one.
        axis: That they share.
        name: For those who cannot see it.
    """
    every = np.concatenate([series.x for panel in panels for series in panel.series])
    across = _Scale.about(
        _of(every, axis.log),
        axis.log,
        0.01,
    )
    top = 0.0
    body = []
    edges = []
    for panel in panels:
        top += TITLE
        body.append(_panel(panel, across, top))
        edges.append((top, top + panel.height))
        top += panel.height + BELOW
    bottom = edges[-1][1]
    marks = []
    for value, word in _ticks(across.low, across.high, axis.log, whole=axis.whole):
        at = LEFT + (value - across.low) / (across.high - across.low) * INSIDE
        line = "".join(f"M{_n(at)},{_n(above)}V{_n(below)}" for above, below in edges)
        marks.append(
            f'<path d="{line}"/><text x="{_n(at)}" y="{_n(bottom + 18)}" text-anchor="middle">{word}</text>'
        )
    title = f'<text x="{_n(LEFT + INSIDE / 2)}" y="{_n(bottom + AXIS - 4)}" text-anchor="middle">{escape(axis.title)}</text>'
    return (
        f'<svg class="chart" role="img" aria-label="{escape(name)}" viewBox="0 0 {_n(WIDTH)} {_n(bottom + AXIS)}" '
        f'data-x0="{across.low:.9g}" data-x1="{across.high:.9g}" data-unit="{escape(axis.unit)}"{across.attribute}>'
        f'<g class="ticks">{"".join(marks)}</g>{title}{"".join(body)}</svg>'
    )


def _panel(panel: Panel, across: _Scale, top: float) -> str:
    """A plot with its title, legend and marks, which begins at `top` [px]."""
    plot = _Plot(across, _scale_of(panel), panel.height)
    shown = [(series, plot.points(series.x, series.y)) for series in panel.series]
    drawn = [
        *_behind(panel, plot),
        *(_curve(series, places, panel.unit) for series, places in shown if places),
    ]
    legend = [_legend_of(series) for series, places in shown if places and series.listed]
    marks = []
    low = plot.up.low
    high = plot.up.high
    for value, word in _ticks(low, high, panel.log, panel.height / 22.0):
        at = top + (high - value) / (high - low) * panel.height
        marks.append(
            f'<path d="M{_n(LEFT)},{_n(at)}h{_n(INSIDE)}"/>'
            f'<text x="{_n(LEFT - 8)}" y="{_n(at)}" dy=".35em" text-anchor="end">{word}</text>'
        )
    return (
        f'<text x="2" y="{_n(top - 11)}"><tspan class="title">{escape(panel.title)}</tspan>{"".join(legend)}</text>'
        f'<g class="grid">{"".join(marks)}</g>'
        f'<svg class="plot" x="{_n(LEFT)}" y="{_n(top)}" width="{_n(INSIDE)}" height="{_n(panel.height)}" '
        f'viewBox="0 0 {_n(INSIDE)} {_n(panel.height)}" preserveAspectRatio="none" '
        f'data-y0="{low:.9g}" data-y1="{high:.9g}"{plot.up.attribute}>{"".join(drawn)}</svg>'
    )


def _scale_of(panel: Panel) -> _Scale:
    """The axis that holds curves, rules and band of a panel."""
    values = [series.y for series in panel.series]
    values.append(np.array(panel.rules))
    seen = [_of(each, panel.log) for each in values]
    if panel.band is not None:
        seen += panel.band[1:]
    every = np.minimum(np.concatenate(seen), panel.highest)
    return _Scale.about(every, panel.log, MARGIN)


def _behind(panel: Panel, plot: _Plot) -> list[str]:
    """What lies behind the curves: shaded spans, the band, lines across and upwards."""
    height = _n(panel.height)
    drawn = [
        f'<path class="span" d="M{plot.x(low)},0H{plot.x(high)}V{height}H{plot.x(low)}Z"/>'
        for low, high in panel.spans
    ]
    if panel.band is not None:
        x, low_y, high_y = panel.band
        above = plot.points(x, high_y)
        around = "L".join([*above, *plot.points(x, low_y)[::-1]])
        drawn.append(f'<path class="span" d="M{around}Z"/>')
    drawn += [
        f'<path class="vertical" d="M{plot.x(value)},0V{height}"/>' for value in panel.verticals
    ]
    for rule in panel.rules:
        line = "L".join(plot.points(plot.across.ends, np.full(2, rule)))
        drawn.append(f'<path class="rule" d="M{line}"/>')
    return drawn


def _curve(series: Series, places: Sequence[str], unit: str) -> str:
    """A curve through its points, each `x,y`; what the pointer shows of it has its unit."""
    line = f"M{'L'.join(places)}"
    if series.kind == "dots":
        line = "".join(f"M{place}h0" for place in places)
    elif series.kind == "pairs":
        pairs = zip(
            places[::2],
            places[1::2],
            strict=True,
        )
        line = "".join(f"M{low}L{high}" for low, high in pairs)
    elif series.kind == "steps":
        steps = [f"H{place.partition(',')[0]}L{place}" for place in places[1:]]
        line = f"M{places[0]}{''.join(steps)}"
    named = ""
    if series.name:
        named = f' data-name="{escape(series.name)}" data-unit="{escape(unit)}"'
    return f'<path class="{series.kind} {series.color}"{named} d="{line}"/>'


def _legend_of(series: Series) -> str:
    if not series.name:
        return ""
    sign = "\N{BLACK CIRCLE}" if series.kind == "dots" else "\N{EM DASH}"
    return f'<tspan class="{series.color}" dx="14">{sign} {escape(series.name)}</tspan>'


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
        every = max(1, math.ceil((high - low) / most))
        decades = range(
            math.floor(low),
            math.ceil(high) + 1,
            every,
        )
        values = [digit * 10.0**decade for decade in decades for digit in digits_shown]
        return [
            (math.log10(v), f"{v:g}".replace("e+0", "e"))
            for v in values
            if low <= math.log10(v) <= high
        ]
    power = 10.0 ** math.floor(math.log10((high - low) / most))
    steps = [power * digit for digit in (1, 2, 5, 10)]
    step = next(step for step in steps if (high - low) / step < most)
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
