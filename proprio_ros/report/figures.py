"""Plots by matplotlib, as inline SVG or for a notebook. matplotlib is imported here only, and only when something is drawn."""

from __future__ import annotations

import io
import re
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from html import escape
from typing import Any

from proprio_ros.errors import ConfigurationError
from proprio_ros.identification.estimate import JointFit, RunFit
from proprio_ros.records import TORQUE_OFF
from proprio_ros.version import to_install

INK, MUTED, MEASURED, SIMULATED, ACCENT = "#1b2430", "#8a94a3", "#1b2430", "#d1495b", "#2a7f9e"
TIME = {False: "time after the current came on (s)", True: "time after it was let go (s)"}
LINE, PALE, INSIDE = "#e4e8ee", "#dbe2ea", "#f4f6f9"
_THEME = {
    INK: "ink",
    MUTED: "muted",
    SIMULATED: "red",
    ACCENT: "accent",
    LINE: "line",
    PALE: "pale",
    INSIDE: "inside",
}
"""Colours of a figure, and the page's own that take their place, which follow the reader's colour scheme."""


def drawing_library() -> Any:
    """The module matplotlib.

    Raises `ConfigurationError`: It is not installed.
    """
    try:
        import matplotlib
    except ImportError as error:
        raise ConfigurationError(
            f"pages and figures need the package matplotlib: {to_install('report')}"
        ) from error
    return matplotlib


@contextmanager
def drawn(width: float, height: float, **grid: Any) -> Iterator[tuple[Any, Any]]:
    """A figure outside of pyplot's global state, in the page's style."""
    matplotlib = drawing_library()
    from matplotlib.figure import Figure

    style = {
        "font.size": 9.5,
        "font.family": "sans-serif",
        # found on most machines, and the widest where another one has to stand in
        "font.sans-serif": ["DejaVu Sans"],
        **dict.fromkeys(("text.color", "axes.labelcolor", "xtick.color", "ytick.color"), INK),
        **dict.fromkeys(("axes.spines.top", "axes.spines.right", "legend.frameon"), False),
        **dict.fromkeys(("axes.grid", "axes.axisbelow"), True),
        "axes.edgecolor": MUTED,
        "grid.color": LINE,
    }
    with matplotlib.rc_context(style):
        figure = Figure(figsize=(width, height), layout="constrained")
        yield figure, figure.subplots(**grid)


def themed(text: str) -> str:
    """SVG in the page's own colours."""
    for color, name in _THEME.items():
        text = text.replace(color, f"var(--{name})")
    return text


def plain(words: str) -> str:
    """Words of others as matplotlib draws them letter by letter: between two dollar signs it would read mathematics."""
    return words.replace("$", r"\$")


def svg(figure: Any, description: str) -> str:
    """Inline SVG with a description for those who cannot see it."""
    matplotlib = drawing_library()
    buffer = io.StringIO()
    # words stay words: they can be searched and read aloud, and the page is half as large as with drawn letters
    with matplotlib.rc_context({"svg.fonttype": "none"}):
        figure.savefig(
            buffer, format="svg", transparent=True, metadata={"Date": None, "Creator": None}
        )
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    # the page scales it, so the size in points goes; ids of several figures must not meet in one document
    for size in ("height", "width"):
        text = re.sub(rf'(<svg[^>]*?) {size}="[^"]*"', r"\1", text, count=1)
    text = _leaner(text)
    prefix = f"f{zlib.crc32(description.encode()):x}-"
    # groups have names that nothing points to; what is pointed to is named by its place
    used = sorted(set(re.findall(r'(?:href="#|url\(#)([^")]+)', text)))
    names = {name: f"{prefix}{place}" for place, name in enumerate(used)}
    text = re.sub(
        r' id="([^"]+)"',
        lambda m: f' id="{names[m[1]]}"' if m[1] in names else "",
        text,
    )
    text = re.sub(
        r'(href="#|url\(#)([^")]+)',
        lambda m: m[1] + names[m[2]],
        text,
    )
    return themed(text).replace(
        "<svg", f'<svg class="words" role="img" aria-label="{escape(description)}"', 1
    )


def _leaner(text: str) -> str:
    """The same picture in fewer letters: matplotlib writes a millionth of a point, and a line per corner."""
    text = re.sub(r"<metadata>.*?</metadata>|<!--.*?-->", "", text, flags=re.S)
    # hundredths of a point, but not in words, nor in a scale, which is a small number
    kept = r">[^<]*<|scale\([^)]*\)"
    text = re.sub(
        rf"{kept}|\d+\.\d{{3,}}",
        lambda m: f"{float(m[0]):.2f}" if m[0][0].isdigit() else m[0],
        text,
    )
    # powers of ten lack it
    text = text.replace("font-family: 'DejaVu Sans';", "font-family: 'DejaVu Sans', sans-serif;")
    return re.sub(
        r"\s+",
        " ",
        re.sub(r">\s+<", "><", text),
    )


def runs_figure(fits: Sequence[RunFit]) -> Any:
    """The same for every run, one below the other, as a matplotlib ``Figure``."""
    count = len(fits)
    with drawn(
        7.4, 4.4 * count, nrows=2 * count, squeeze=False, height_ratios=[2.2, 1.0] * count
    ) as (figure, axes):
        for fit, (above, below) in zip(fits, axes.reshape(-1, 2), strict=True):
            _draw_run(above, below, fit)
        return figure


def motions_figure(fits: Sequence[JointFit]) -> Any:
    """The same for every joint of every motion, as a matplotlib ``Figure``."""
    count = len(fits)
    with drawn(
        7.4, 3.4 * count, nrows=2 * count, squeeze=False, height_ratios=[2.2, 1.0] * count
    ) as (figure, axes):
        for fit, (above, below) in zip(fits, axes.reshape(-1, 2), strict=True):
            below.sharex(above)
            above.set_title(plain(f"{fit.name}: {fit.joint}"), loc="left", fontsize=9.5)
            above.plot(
                fit.times_s,
                fit.measured,
                color=MEASURED,
                linewidth=1.6,
                label="measured",
            )
            above.plot(
                fit.times_s, fit.explained, color=SIMULATED, linewidth=1.6, label="explained"
            )
            above.plot(
                fit.times_s,
                fit.explained - fit.payload,
                color=MUTED,
                linewidth=1.2,
                label="without the payload",
            )
            above.set_ylabel("torque (N m)")
            above.legend(loc="best")
            if fit.usual > 0.0:
                below.axhspan(
                    -2.0 * fit.usual, 2.0 * fit.usual, color=ACCENT, alpha=0.15, linewidth=0
                )
            below.plot(
                fit.times_s,
                fit.explained - fit.measured,
                color=SIMULATED,
                linewidth=0.8,
            )
            below.set_ylabel("residual (N m)")
            below.set_xlabel(
                "time (s); band: two standard deviations of what stays unexplained where the load is known"
            )
        return figure


def _draw_run(above: Any, below: Any, fit: RunFit) -> None:
    below.sharex(above)
    above.set_title(
        plain(f"{fit.name}: {fit.joint}, {fit.current_A:+.3f} A"), loc="left", fontsize=9.5
    )
    above.plot(
        fit.times_s,
        fit.simulated,
        color=SIMULATED,
        linewidth=1.6,
        label="simulated",
    )
    above.plot(
        fit.times_s,
        fit.measured,
        "o",
        color=MEASURED,
        markersize=3.4,
        label="measured",
    )
    if len(fit.left_out_times_s):
        above.plot(
            fit.left_out_times_s,
            fit.left_out,
            "o",
            color=MUTED,
            markersize=3.0,
            alpha=0.6,
            label="left out",
        )
    above.set_ylabel("position (rad)")
    above.legend(loc="best")
    residual = 1e3 * (fit.simulated - fit.measured)
    below.fill_between(
        fit.times_s, -2e3 * fit.sigma, 2e3 * fit.sigma, color=ACCENT, alpha=0.15, linewidth=0
    )
    below.axhline(0.0, color=MUTED, linewidth=0.8)
    below.plot(
        fit.times_s,
        residual,
        "o-",
        color=SIMULATED,
        markersize=3.0,
        linewidth=0.8,
    )
    below.set_ylabel("residual (mrad)")
    below.set_xlabel(
        f"{TIME[fit.source == TORQUE_OFF]}; band: two standard deviations of the encoder"
    )
