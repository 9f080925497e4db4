"""The HTML page."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path
from typing import Any

from proprio_ros import __version__
from proprio_ros.errors import ConfigurationError
from proprio_ros.identification.estimate import Estimate, Value, Verdict
from proprio_ros.report import figures

_STYLE = """
:root { color-scheme: light; }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 58rem; padding: 2rem 1.2rem 4rem; color: #1b2430; background: #fff;
  font: 16px/1.55 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", sans-serif; }
h1 { font-size: 1.05rem; font-weight: 600; color: #5a6675; margin: 0 0 .4rem; }
h2 { font-size: 1.15rem; margin: 2.6rem 0 .6rem; padding-top: .9rem; border-top: 1px solid #e4e8ee; }
h3 { font-size: 1rem; margin: 1.4rem 0 .3rem; }
.verdict { display: inline-block; padding: .1rem .7rem; border-radius: 1rem; font-weight: 600; color: #fff; }
.accepted { background: #2b7a4b; } .rejected { background: #b23a48; } .not_identifiable { background: #a06a12; }
.value { font-size: 2.6rem; font-weight: 650; line-height: 1.15; margin: .7rem 0 .1rem; }
.interval { color: #5a6675; margin: 0 0 1rem; }
ul { padding-left: 1.2rem; } li { margin: .25rem 0; }
table { border-collapse: collapse; width: 100%; font-size: .9rem; }
.wide { overflow-x: auto; }
th, td { text-align: left; padding: .32rem .7rem .32rem 0; border-bottom: 1px solid #e4e8ee; vertical-align: top; }
td.number, th.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
figure { margin: .4rem 0 1rem; } figure svg { width: 100%; height: auto; }
code, pre { font: .86rem/1.5 ui-monospace, "DejaVu Sans Mono", Menlo, monospace; }
pre { background: #f4f6f9; padding: .8rem 1rem; border-radius: .4rem; white-space: pre-wrap; overflow-wrap: anywhere; }
.small { color: #5a6675; font-size: .88rem; }
@media print { body { max-width: none; padding: 0; } figure, table { break-inside: avoid; } }
"""

_WORDS = {
    Verdict.ACCEPTED: "accepted",
    Verdict.REJECTED: "rejected: the model does not explain the recording",
    Verdict.NOT_IDENTIFIABLE: "not identifiable: the recording cannot tell",
}

_ROLES = {"free": "fitted", "frozen": "as stated"}


def write_report(estimate: Estimate, path: Path, *, command: str = "", sources: Sequence[str] = ()) -> None:
    """Write the page for one result; an older page of that name is replaced in one step.

    Args:
        estimate: what to show.
        path: the HTML file.
        command: the command line that gives the same result again.
        sources: the recordings it came from.

    Raises:
        ConfigurationError: the file cannot be written.
    """
    text = _page(estimate, command, sources)
    path = Path(path)
    temporary = None
    try:
        with tempfile.NamedTemporaryFile(
            "w", encoding="utf-8", dir=path.parent, prefix=f".{path.name}.", delete=False
        ) as stream:
            temporary = Path(stream.name)
            stream.write(text)
        temporary.chmod(0o644)
        os.replace(temporary, path)
    except OSError as error:
        if temporary is not None:
            temporary.unlink(missing_ok=True)
        raise ConfigurationError(
            f"--report {path}: cannot be written ({error.strerror}); name a file in a folder that exists and is writable"
        ) from error


def _page(estimate: Estimate, command: str, sources: Sequence[str]) -> str:
    parts = [
        "<!doctype html>",
        '<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>proprio: {escape(estimate.probe)} {escape(estimate.verdict.value)}</title><style>{_STYLE}</style></head><body>",
        *_headline(estimate),
    ]
    if estimate.run_fits:
        parts.append("<h2>Measured against simulated</h2>")
        for number, fit in enumerate(estimate.run_fits, start=1):
            about = f"{fit.joint}, {fit.current_A:+.3f} A from {fit.source}, travel {fit.travel:+.2f} rad"
            parts.append(f"<h3>{escape(fit.name)}</h3><p class=small>{escape(about)}</p>")
            parts.append(_framed(figures.run_figure(fit, number)))
    if estimate.scan is not None:
        parts += ["<h2>Misfit over mass</h2>", _framed(figures.scan_figure(estimate))]
    if estimate.solver is not None:
        parts += _convergence(estimate)
    if estimate.budget:
        parts += ["<h2>Where the uncertainty comes from</h2>", _framed(figures.budget_figure(estimate))]
    parts += _values(estimate)
    parts += _listed("What was assumed", estimate.assumptions)
    parts += _listed("Notes on the recording", estimate.notes)
    parts += _provenance(estimate, command, sources)
    parts.append("</body></html>")
    return "\n".join(parts)


def _headline(estimate: Estimate) -> list[str]:
    runs = f"{estimate.runs} run" + "s" * (estimate.runs != 1)
    parts = [
        f"<h1>{escape(estimate.probe)} in the hand of {escape(estimate.robot)}, {runs}</h1>",
        f'<span class="verdict {estimate.verdict.value}">{escape(_WORDS[estimate.verdict])}</span>',
    ]
    for value in estimate.values:
        parts.append(f"<p class=value>{escape(_in_words(value))}</p>")
        parts.append(f"<p class=interval>{escape(_interval_in_words(value))}</p>")
    if estimate.reasons:
        parts.append("<ul>" + "".join(f"<li>{escape(reason)}</li>" for reason in estimate.reasons) + "</ul>")
    return parts


def _in_words(value: Value) -> str:
    if value.value is None:
        return "no value"
    if isinstance(value.value, list):
        numbers = ", ".join("?" if v is None else f"{1e3 * v:.1f}" for v in value.value)
        return f"{value.name.replace('_', ' ')} [{numbers}] mm"
    if value.unit == "kg":
        return f"{1e3 * value.value:.2f} g"
    return f"{value.value:.4g} {value.unit}"


def _interval_in_words(value: Value) -> str:
    name = value.name.replace("_", " ")
    if isinstance(value.ci95, list) and value.unit == "kg":
        low, high = value.ci95
        interval = f"95 % interval {1e3 * low:.2f} to {1e3 * high:.2f} g"
        return f"{name}, {interval} ({value.value:.6f} kg, standard deviation {value.std:.6f})"
    return f"{name}: {value.reason}" if value.reason else name


def _convergence(estimate: Estimate) -> list[str]:
    solver = estimate.solver
    assert solver is not None
    parts = [
        "<h2>Convergence of every start</h2>",
        f"<p class=small>{escape(solver.name)}, profile {escape(solver.profile)}: {solver.starts_agreeing} of "
        f"{len(solver.paths)} starts agree (blue); {solver.iterations} iterations, {escape(solver.integrator)}.</p>",
        _framed(figures.convergence_figure(estimate)),
    ]
    scheduled = any(path.scheduled_kg is not None for path in solver.paths)
    header = [
        "start (g)",
        *(["where the schedule stops (g)"] * scheduled),
        "least error (g)" if scheduled else "end (g)",
        "cost",
    ]
    rows = [
        [
            f"{1e3 * path.start_kg:.3g}",
            *([f"{1e3 * (path.scheduled_kg or 0.0):.1f}"] * scheduled),
            f"{1e3 * path.end_kg:.3f}",
            f"{path.cost:.3g}",
        ]
        for path in solver.paths
    ]
    return [*parts, _table(header, rows, numbers=range(len(header)))]


def _values(estimate: Estimate) -> list[str]:
    parts = ["<h2>Values and intervals</h2>"]
    rows = [
        [value.name, _number(value.value), _number(value.std), _interval(value.ci95), value.unit, value.reason]
        for value in estimate.values
    ]
    parts.append(_table(["estimate", "value", "std", "95 % interval", "unit", ""], rows, numbers=(1, 2, 3)))
    if estimate.unknowns:
        parts.append("<h3>Every unknown: what the robot file says, and what the recording adds</h3>")
        rows = [
            [
                row.name,
                _ROLES.get(row.role, row.role),
                "none" if row.prior_std == float("inf") else f"{row.prior:.6g} ± {row.prior_std:.3g}",
                f"{row.value:.6g} ± {row.std:.3g}",
                row.unit,
            ]
            for row in estimate.unknowns
        ]
        parts.append(_table(["unknown", "role", "prior", "open fit", "unit"], rows, numbers=(2, 3)))
    if estimate.fit is not None:
        fit = estimate.fit
        rows = [
            ["rms residual", f"{1e3 * fit.rms:.3f} m{fit.unit}"],
            ["expected from encoder and stamps", f"{1e3 * fit.expected_rms:.3f} m{fit.unit}"],
            ["reduced chi-square", f"{fit.reduced_chi2:.3g}"],
            ["condition of the scaled normal matrix", _number(fit.condition)],
        ]
        parts.append("<h3>Fit</h3>" + _table(["", ""], rows, numbers=(1,)))
    return parts


def _provenance(estimate: Estimate, command: str, sources: Sequence[str]) -> list[str]:
    parts = ["<h2>To get this again</h2>"]
    if command:
        parts.append(f"<pre>{escape(command)}</pre>")
    if sources:
        parts.append(
            "<p class=small>Recordings: " + ", ".join(f"<code>{escape(str(s))}</code>" for s in sources) + "</p>"
        )
    timing = ", ".join(f"{name} {1e3 * seconds:.0f} ms" for name, seconds in estimate.timing_s.items())
    parts.append(
        f"<p class=small>proprio_ros {escape(__version__)}" + (f"; {escape(timing)}" if timing else "") + "</p>"
    )
    return parts


def _listed(title: str, sentences: Sequence[str]) -> list[str]:
    if not sentences:
        return []
    return [f"<h2>{escape(title)}</h2>", "<ul>" + "".join(f"<li>{escape(s)}</li>" for s in sentences) + "</ul>"]


def _framed(svg: str) -> str:
    return f"<figure>{svg}</figure>"


def _table(header: Sequence[str], rows: Sequence[Sequence[str]], numbers: Iterable[int]) -> str:
    right = set(numbers)

    def cells(row: Sequence[str], tag: str) -> str:
        return "".join(
            f"<{tag}{' class=number' if column in right else ''}>{escape(cell)}</{tag}>"
            for column, cell in enumerate(row)
        )

    head = f"<thead><tr>{cells(header, 'th')}</tr></thead>" if any(header) else ""
    body = "".join(f"<tr>{cells(row, 'td')}</tr>" for row in rows)
    return f"<div class=wide><table>{head}<tbody>{body}</tbody></table></div>"


def _number(value: Any) -> str:
    if value is None or value != value:
        return "-"
    if isinstance(value, list):
        return "[" + ", ".join(_number(v) for v in value) + "]"
    return f"{value:.6g}"


def _interval(value: Any) -> str:
    if value is None:
        return "-"
    if value and isinstance(value[0], list):
        return "; ".join(_interval(v) for v in value)
    return " to ".join(_number(v) for v in value)
