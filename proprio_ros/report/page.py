"""The HTML page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape
from pathlib import Path

import numpy as np

from proprio_ros.identification.estimate import Estimate, Fit, UnknownRow, Value, Verdict
from proprio_ros.identification.reasons import CODES
from proprio_ros.quantity import shown, shown_unit, spec_for
from proprio_ros.records import TORQUE_OFF
from proprio_ros.report import html, pictures
from proprio_ros.report.html import (
    bulleted,
    framed,
    listed,
    number,
    provenance,
    table,
    titled,
    within,
    write_document,
)
from proprio_ros.report.motion_sections import HINT, arm_and_payload, torques, what_told

_WORDS = {
    Verdict.ACCEPTED: "accepted",
    Verdict.TOO_WIDE: "too wide: the interval says more than the number",
    Verdict.REJECTED: "rejected: the model does not explain the recording",
    Verdict.NOT_IDENTIFIABLE: "not identifiable: the recording does not determine it",
}

_COLORS = {
    "accepted": "#2b7a4b",
    "rejected": "#b23a48",
    "not_identifiable": "#96600c",
    "too_wide": "#96600c",
}
"""Of verdicts in a notebook; another is grey, as on the page."""

_ROLES = {"free": "fitted", "frozen": "as stated"}


def write_page(
    estimate: Estimate,
    path: Path,
    own: Sequence[str] = (),
    *,
    command: str = "",
    sources: Sequence[str] = (),
    force: bool = False,
) -> None:
    """Write the page for one result; an older page is replaced in one step.

    Args:
        estimate: The result.
        path: Of the page.
        own: What only its probe has to show, as HTML.
        command: The command line that gives the same result again.
        sources: Names of what it came from.
        force: Whether another file of that name is replaced, too.

    Raises:
        ConfigurationError: The file cannot be written.
    """
    parts = [
        *_headline(estimate),
        *arm_and_payload(estimate.held_views),
        *what_told(estimate.joint_fits),
    ]
    parts += [*_runs(estimate), *own]
    if estimate.scan is not None and len(estimate.scan.values) > 1:
        parts += _scan(estimate)
    if estimate.solver is not None:
        parts += _convergence(estimate)
    if estimate.budget:
        about = f"Standard deviation that each puts on the {estimate.values[0].label}, and its share of the variance."
        parts += [
            "<h2>Where the uncertainty comes from</h2>",
            f"<p class=small>{escape(about)}</p>",
        ]
        parts.append(pictures.budget_figure(estimate))
    parts += [
        *torques(estimate.joint_fits, estimate.values[0].value is not None),
        *_values(estimate),
    ]
    parts += listed("What was assumed", estimate.assumptions)
    parts += listed("Notes on the recording", estimate.notes)
    parts += provenance(command, sources, estimate.timing_s)
    title = f"proprio: {estimate.probe} {estimate.verdict.value.replace('_', ' ')}"
    write_document(Path(path), title, parts, "--report", force)


def card(
    title: str,
    verdict: Verdict,
    values: Sequence[Value],
    reasons: Sequence[str],
    interval_first: bool = False,
) -> str:
    """A result in a few lines for a notebook's cell, styled by itself, so that nothing of it reaches the rest of the notebook.

    Args:
        title: Beside the verdict.
        verdict: In its colour.
        values: Each with its interval.
        reasons: The first of which says what to do.
        interval_first: Whether intervals are larger than the values.
    """
    color = _COLORS.get(verdict.value, "#5a6675")
    badge = f"background:{color};color:#fff;padding:.1em .7em;border-radius:1em;font-weight:600;display:inline-block"
    lines = [f'<div style="{badge}">{escape(_verdict_in_words(verdict))}</div> {escape(title)}']
    for value in values:
        number_style = "font-size:1.5em;font-weight:600;margin-top:.3em"
        lines.append(
            f'<div style="{number_style}">{escape(_in_words(value, interval_first))}</div>'
        )
        lines.append(f"<div>{escape(_interval_in_words(value, interval_first))}</div>")
    lines += bulleted(reasons)
    code = getattr(next(iter(reasons), ""), "code", "")
    if verdict is not Verdict.ACCEPTED and code in CODES:
        lines.append(f"<div>What to do: {escape(CODES[code].remedy)}.</div>")
    return "<div>" + "".join(lines) + "</div>"


def _runs(estimate: Estimate) -> list[str]:
    pairs = pictures.paired(estimate)
    if not pairs:
        return []
    parts = [
        "<h2>Measured against simulated</h2>" if estimate.run_fits else "<h2>What was recorded</h2>"
    ]
    parts.append(f"<p class='small hint'>{HINT}</p>")
    for n, (fit, run) in enumerate(pairs, start=1):
        if fit is not None:
            name = fit.name
            driven_by = (
                "let go"
                if fit.source == TORQUE_OFF
                else f"{fit.current_A:+.3f} A from {fit.source}"
            )
            about = f"{fit.joint}, {driven_by}, travel {fit.travel:+.2f} rad"
        else:
            assert run is not None
            name = run.name
            driven = run.input_current_A[np.argmax(np.abs(run.input_current_A))]
            moved = run.position[-1] - run.position[0] if len(run.position) else 0.0
            about = (
                f"not used: see the reasons above. {run.joint}, {driven:+.3f} A from {run.source}, "
            )
            about += f"moved by {moved:+.3f} {run.unit}"
        if run is not None and run.baseline:
            about += "; baseline"
        parts.append(f"<h3>{html.breakable(name)}</h3><p class=small>{escape(about)}</p>")
        trace = framed(pictures.run_figure(fit, run, n))
        if run is not None and run.arm.size:
            arm = framed(
                pictures.arm_figure(run, n),
                "From the side: dotted at the start, ring: the driven joint.",
            )
            trace = f"<div class=run>{trace}{arm}</div>"
        parts.append(trace)
    return parts


def _scan(estimate: Estimate) -> list[str]:
    assert estimate.scan is not None
    caption = "Line: the value; band: its 95 % interval."
    if estimate.scan.level is not None:
        caption += (
            " At each value everything else that is open was fitted again: the 95 % interval ends where the curve crosses the "
            "dashed line (3.84), unless more than this fit counts as uncertainty."
        )
    title = f"<h2>Misfit over {escape(estimate.values[0].label)}</h2>"
    return [title, framed(pictures.scan_figure(estimate), caption)]


def _headline(estimate: Estimate) -> list[str]:
    runs = f"{estimate.runs} run" + "s" * (estimate.runs != 1)
    title = f"{estimate.probe} in the hand of {estimate.robot}, {runs}"
    parts = titled(
        title,
        estimate.verdict.value,
        _verdict_in_words(estimate.verdict),
    )
    for place, value in enumerate(estimate.values):
        if value.known and len(value.parts) == 6:
            continue  # an inertia has its lines below
        if place == 0 or value.known:
            beside = " beside" * (place > 0)
            parts.append(
                f'<p class="value{beside}">{escape(_in_words(value, estimate.interval_first))}</p>'
            )
        parts.append(
            f"<p class=interval>{escape(_interval_in_words(value, estimate.interval_first))}</p>"
        )
    return [*parts, *bulleted(estimate.reasons)]


def _verdict_in_words(verdict: Verdict) -> str:
    """What a verdict means; one that the page does not know by its name."""
    return _WORDS.get(verdict, verdict.value.replace("_", " "))


def _in_words(value: Value, interval_first: bool = False) -> str:
    """The number with its unit, as a headline, or the interval."""
    if value.value is None:
        return "no value"
    if isinstance(value.value, list):
        return _typeset(value.in_words())
    std = value.std if isinstance(value.std, float) else None
    spec = spec_for(value.unit, std)
    if interval_first and isinstance(value.ci95, list):
        return shown(
            value.unit,
            *value.ci95,
            spec=spec,
            between=" to ",
        )
    return shown(value.unit, value.value, spec=spec)


def _interval_in_words(value: Value, interval_first: bool = False) -> str:
    """Its name and interval, or why there is none; the number where the interval leads."""
    if isinstance(value.value, list) and value.known:
        why = f" ({value.reason})" if value.reason else ""
        intervals = []
        for part in value.parts:
            if part.ci95 is not None:
                spec = spec_for(part.unit, part.std)  # type: ignore[arg-type]
                intervals.append(shown(part.unit, *part.ci95, spec=spec, between=" to "))
        if not intervals:
            return f"{value.label}{why}"
        return _typeset(f"{value.label}, 95 % intervals {'; '.join(intervals)}") + why
    if (
        isinstance(value.ci95, list)
        and isinstance(value.value, float)
        and isinstance(value.std, float)
    ):
        spec = spec_for(value.unit, value.std)
        if interval_first:
            return f"{value.label}, 95 % interval; best guess {shown(value.unit, value.value, spec=spec)}"
        words = f"{value.label}, 95 % interval {shown(value.unit, *value.ci95, spec=spec, between=' to ')}"
        if shown_unit(value.unit)[0] == 1.0:
            return words
        return f"{words}, standard deviation {shown(value.unit, value.std, spec=spec)}"
    return f"{value.label}: {value.reason}" if value.reason else value.label


def _convergence(estimate: Estimate) -> list[str]:
    solver = estimate.solver
    assert solver is not None
    about = (
        f"{solver.name}, profile {solver.profile}: {solver.starts_agreeing} of {len(solver.paths)} starts agree (blue); "
        f"{solver.iterations} iterations, {solver.integrator.replace('_', ' ')}."
    )
    if solver.refined:
        about += (
            " These took the robot as its file or calibration states it. After them all that is open about it moved, too, under "
            "its prior (red): that fit gave the answer."
        )
    if isinstance(estimate.values[0].value, float):
        about += " Dashed: the answer."
    refined = bool(solver.refined)
    scheduled = any(path.scheduled is not None for path in solver.paths)
    factor, unit = shown_unit(estimate.values[0].unit)
    end = f"least error ({unit})" if scheduled else f"end ({unit})"
    stops = [f"where the schedule stops ({unit})"] * scheduled
    header = [*["fit"] * refined, f"start ({unit})", *stops, end, "cost"]
    # one digit more than the answer has, to see how well they agree
    std = estimate.values[0].std
    digits = spec_for(
        estimate.values[0].unit,
        0.1 * std if isinstance(std, float) else None,
    )
    rows = []
    for stage, paths in (("robot as stated", solver.paths), ("all open", solver.refined)):
        for path in paths:
            start = f"{factor * path.start:{'.0f' if factor * path.start >= 100.0 else '.3g'}}"
            stops = [f"{factor * (path.scheduled or 0.0):.1f}"] * scheduled
            end = f"{factor * path.end:{digits}}"
            rows.append([*[stage] * refined, start, *stops, end, f"{path.cost:.3g}"])
    return [
        "<h2>Convergence of every start</h2>",
        f"<p class=small>{escape(about)}</p>",
        framed(pictures.convergence_figure(estimate)),
        table(header, rows, numbers=range(refined, len(header))),
    ]


def _values(estimate: Estimate) -> list[str]:
    parts = ["<h2>Values and intervals</h2>", _value_table(estimate.values)]
    if estimate.unknowns:
        parts += [
            "<h3>Every unknown: what the robot file says, and what the recording adds</h3>",
            _unknown_table(estimate.unknowns),
        ]
    if estimate.fit is not None:
        parts.append("<h3>Fit</h3>" + _fit_table(estimate.fit, bool(estimate.joint_fits)))
    return parts


def _value_table(values: Sequence[Value]) -> str:
    rows = []
    for value in values:
        for part in value.parts if value.known else [value]:
            rows.append([part.label, *_numbers_of(part), _typeset(part.unit), part.reason])
    header = ["estimate", "value", "std", "95 % interval", "unit"]
    if any(row[-1] for row in rows):
        header.append("")
    rows = [row[: len(header)] for row in rows]
    return table(
        header,
        rows,
        numbers=(1, 2, 3),
        labels=1,
    )


def _numbers_of(value: Value) -> list[str]:
    """The value, its standard deviation and its interval, where it is known."""
    if not value.known:
        return ["-"] * 3
    interval = "-"
    if value.ci95 is not None:
        interval = " to ".join(number(end, value.std) for end in value.ci95)
    std = value.std
    return [number(value.value, std), number(std, std), interval]


def _unknown_table(unknowns: Sequence[UnknownRow]) -> str:
    rows = []
    for row in unknowns:
        prior = "none" if row.prior_std == float("inf") else within(row.prior, row.prior_std)
        # zero has no sign of its own
        pull = "-" if row.pull is None else f"{round(row.pull, 1) + 0.0:+.1f}"
        role = _ROLES.get(row.role, row.role)
        found = within(row.value, row.std)
        rows.append([row.label, role, prior, found, pull, _typeset(row.unit)])
    header = ["unknown", "role", "prior", "open fit", "pull", "unit"]
    return table(
        header,
        rows,
        numbers=(2, 3, 4),
        labels=1,
    )


def _fit_table(fit: Fit, of_motions: bool) -> str:
    expected = "where the load is known" if of_motions else "expected from encoder and stamps"
    rows = [
        ["rms residual", shown(fit.unit, fit.rms, spec=".3g")],
        [expected, shown(fit.unit, fit.expected_rms, spec=".3g")],
        ["reduced chi-square", f"{fit.reduced_chi2:.3g}"],
    ]
    if not math.isnan(fit.condition):
        rows.append(["condition of the scaled normal matrix", f"{fit.condition:.2g}"])
    return table(["", ""], rows, numbers=(1,))


def _typeset(words: str) -> str:
    return words.replace("^2", "²")
