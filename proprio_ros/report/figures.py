"""The plots of the report as inline SVG. matplotlib is imported here only, and only when a page is written."""

from __future__ import annotations

import io
import re
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from proprio_ros.identification.estimate import Estimate, RunFit
from proprio_ros.kinds import key_of, label_of
from proprio_ros.quantity import shown_unit

INK, MUTED, MEASURED, SIMULATED, ACCENT = "#1b2430", "#8a94a3", "#1b2430", "#d1495b", "#2a7f9e"


@contextmanager
def drawn(width: float, height: float, **grid: Any) -> Iterator[tuple[Any, Any]]:
    """A figure outside of pyplot's global state, in the page's style."""
    import matplotlib
    from matplotlib.figure import Figure

    style = {
        "font.size": 9.5,
        "font.family": "sans-serif",
        # found on most machines, and the widest where another one has to stand in
        "font.sans-serif": ["DejaVu Sans"],
        # words stay words: they can be searched and read aloud, and the page is half as large as with drawn letters
        "svg.fonttype": "none",
        "axes.edgecolor": MUTED,
        "axes.labelcolor": INK,
        "xtick.color": INK,
        "ytick.color": INK,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "grid.color": "#e4e8ee",
        "axes.axisbelow": True,
        "legend.frameon": False,
    }
    with matplotlib.rc_context(style):
        figure = Figure(figsize=(width, height), layout="constrained")
        yield figure, figure.subplots(**grid)


def svg(figure: Any, description: str) -> str:
    """Inline SVG with a description for those who cannot see it."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    # the page scales it, so the size in points goes; ids of several figures must not meet in one document
    text = re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", text, count=1)
    text = re.sub(r'(<svg[^>]*?) width="[^"]*"', r"\1", text, count=1)
    text = _leaner(text)
    prefix = f"f{zlib.crc32(description.encode()):x}-"
    # groups have names that nothing points to; what is pointed to is named by its place
    used = sorted(set(re.findall(r'(?:href="#|url\(#)([^")]+)', text)))
    names = {name: f"{prefix}{place}" for place, name in enumerate(used)}
    text = re.sub(r' id="([^"]+)"', lambda m: f' id="{names[m[1]]}"' if m[1] in names else "", text)
    text = re.sub(r'(href="#|url\(#)([^")]+)', lambda m: m[1] + names[m[2]], text)
    return text.replace("<svg", f'<svg role="img" aria-label="{description}"', 1)


def _leaner(text: str) -> str:
    """The same picture in fewer letters: matplotlib writes a millionth of a point, and a line per corner."""
    text = re.sub(r"<metadata>.*?</metadata>|<!--.*?-->", "", text, flags=re.S)
    # hundredths of a point, but not in words, nor in a scale, which is a small number
    text = re.sub(
        r">[^<]*<|scale\([^)]*\)|\d+\.\d{3,}", lambda m: f"{float(m[0]):.2f}" if m[0][0].isdigit() else m[0], text
    )
    text = text.replace(
        "font-family: 'DejaVu Sans';", "font-family: 'DejaVu Sans', sans-serif;"
    )  # powers of ten lack it
    text = re.sub(r">\s+<", "><", text)
    return re.sub(r"\s+", " ", text)


def run_figure(fit: RunFit, number: int) -> str:
    """Measured against simulated above, residuals below."""
    with drawn(7.4, 4.4, nrows=2, sharex=True, height_ratios=[2.2, 1.0]) as (figure, (above, below)):
        _draw_run(above, below, fit)
        return svg(figure, f"Run {number}: measured and simulated position over time, and their residual")


def runs_figure(fits: Sequence[RunFit]) -> Any:
    """The same for every run, one below the other, as a matplotlib ``Figure``."""
    count = len(fits)
    with drawn(7.4, 4.4 * count, nrows=2 * count, squeeze=False, height_ratios=[2.2, 1.0] * count) as (figure, axes):
        for n, fit in enumerate(fits):
            above, below = axes[2 * n, 0], axes[2 * n + 1, 0]
            below.sharex(above)
            _draw_run(above, below, fit)
            above.set_title(f"{fit.name}: {fit.joint}, {fit.current_A:+.3f} A", loc="left", fontsize=9.5)
        return figure


def _draw_run(above: Any, below: Any, fit: RunFit) -> None:
    above.plot(fit.times_s, fit.simulated, color=SIMULATED, linewidth=1.6, label="simulated")
    above.plot(fit.times_s, fit.measured, "o", color=MEASURED, markersize=3.4, label="measured")
    if len(fit.left_out_times_s):
        above.plot(fit.left_out_times_s, fit.left_out, "o", color=MUTED, markersize=3.0, alpha=0.6, label="left out")
    above.set_ylabel("position (rad)")
    above.legend(loc="best")
    residual = 1e3 * (fit.simulated - fit.measured)
    below.fill_between(fit.times_s, -2e3 * fit.sigma, 2e3 * fit.sigma, color=ACCENT, alpha=0.15, linewidth=0)
    below.axhline(0.0, color=MUTED, linewidth=0.8)
    below.plot(fit.times_s, residual, "o-", color=SIMULATED, markersize=3.0, linewidth=0.8)
    below.set_ylabel("residual (mrad)")
    below.set_xlabel("time after the current came on (s); band: two standard deviations of the encoder")


def searched_in_words(estimate: Estimate) -> str:
    """What was searched for: "payload mass", "sphere mass", "Young's modulus"."""
    return estimate.values[0].label


def _scale(estimate: Estimate) -> tuple[float, str]:
    return shown_unit(estimate.values[0].unit)


def convergence_figure(estimate: Estimate) -> str:
    """The mass of every start over the iterations, and where the paper's schedule stops."""
    factor, unit = _scale(estimate)
    solver = estimate.solver
    assert solver is not None
    with drawn(7.4, 3.4) as (figure, axes):
        for path in solver.paths:
            color = ACCENT if path.agrees else MUTED
            axes.plot(factor * np.maximum(path.values, 1e-6), color=color, linewidth=1.3)
            axes.plot(0, factor * path.start, "o", color=color, markersize=4)
            if path.scheduled is not None:
                axes.plot(solver.iterations, factor * path.scheduled, "X", color=SIMULATED, markersize=7)
        if any(path.scheduled is not None for path in solver.paths):
            axes.axvline(solver.iterations, color=SIMULATED, linewidth=0.8, linestyle=":")
            axes.annotate(
                "the schedule stops here (x)", (solver.iterations, axes.get_ylim()[1]), color=SIMULATED, va="bottom"
            )
        axes.set_yscale("log")
        axes.set_xlabel("iteration")
        axes.set_ylabel(f"{searched_in_words(estimate)} ({unit})")
        return svg(figure, f"Iterations from {len(solver.paths)} starts: {searched_in_words(estimate)}")


def scan_figure(estimate: Estimate) -> str:
    """Misfit over mass, with the estimate and its interval."""
    factor, unit = _scale(estimate)
    scan = estimate.scan
    assert scan is not None
    with drawn(7.4, 3.2) as (figure, axes):
        axes.plot(factor * scan.values, np.maximum(scan.cost, 1e-4), color=INK, linewidth=1.5)
        value = estimate.values[0]
        if isinstance(value.value, float):
            axes.axvline(factor * value.value, color=SIMULATED, linewidth=1.2)
            if value.ci95 is not None:
                low, high = max(value.ci95[0], scan.values[0]), value.ci95[1]
                axes.axvspan(factor * low, factor * high, color=SIMULATED, alpha=0.1, linewidth=0)
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlabel(f"{searched_in_words(estimate)} ({unit}); line: the value, band: its 95 % interval")
        axes.set_ylabel(scan.measure)
        return svg(figure, f"Misfit of the simulation over the {searched_in_words(estimate)}")


def budget_figure(estimate: Estimate) -> str:
    """Where the uncertainty of the mass comes from."""
    factor, unit = _scale(estimate)
    entries = list(estimate.budget[:8])[::-1]
    with drawn(7.4, 0.6 + 0.3 * len(entries)) as (figure, axes):
        labels = [label_of(key_of(source)) for source, _ in entries]
        axes.barh(labels, [factor * std for _, std in entries], color=ACCENT, height=0.62)
        axes.set_xlabel(f"standard deviation it puts on the {searched_in_words(estimate)} ({unit})")
        axes.grid(axis="y", visible=False)
        return svg(figure, f"Contributions to the uncertainty of the {searched_in_words(estimate)}")
