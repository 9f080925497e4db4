"""What is said on the terminal: results to stdout, everything else to stderr.

Where a stream is a terminal, lines are wrapped at its width, verdicts have colours and several answers are a table. In a pipe
nothing of that is done: scripts read the same lines as ever.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import sys
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from proprio_ros import schema
from proprio_ros.errors import printable, together
from proprio_ros.quantity import shown, spec_for

COLOURS = {
    "32": r"accepted\b|.+: [1-9]\d* of \d+ runs? usable",
    "33": r"too_wide\b|  - |.+: 0 of \d+ runs? usable",
    "31": r"(?:rejected|not_identifiable|failed)\b|  problem:|proprio: ",
    "2": r"  (?:note|assumed|solver|fit|topic): .*",
}
"""Of what a line begins with, by the terminal's number of the colour: green, yellow, red, dim."""
NARROWEST = 40  # a terminal that is narrower, or says so, is not wrapped for
Table = Sequence[tuple[str, ...]]
EXIT_OK = 0
EXIT_BAD_INPUT = 2
EXIT_NO_ANSWER = 3
EXIT_INTERRUPTED = 130
EXIT_TERMINATED = 143


def json_error(given: Sequence[str], sentence: str, exit_code: int) -> int:
    """With ``--json``, stdout always gets one object, an error's too.

    Args:
        given: The command line's arguments.
        sentence: What is wrong.
        exit_code: Of the command.

    Returns:
        The exit code.
    """
    if "--json" in given:
        show(True, schema.error(sentence, exit_code))
    return exit_code


def show(
    as_json: bool,
    content: Mapping[str, Any],
    text: str = "",
    table: Table = (),
) -> None:
    """A result: the one object of ``--json``, or its lines; what else moves a cursor is escaped (names in notes are others').

    Args:
        as_json: Whether ``--json`` was given.
        content: The object; only this is printed then.
        text: The lines.
        table: Of several answers, titles first; it follows the lines on a terminal.
    """
    if as_json:
        print(json.dumps(content, indent=1))
        return
    if len(table) > 2 and sys.stdout is not None and sys.stdout.isatty():
        widths = [max(map(len, column)) for column in zip(*table, strict=True)]
        rows = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in table]
        text = "\n".join([text, "", *rows])
    print("\n".join(laid_out(printable(line), sys.stdout) for line in text.split("\n")))


def laid_out(line: str, stream: Any) -> str:
    """A line as it is, or where the stream is a terminal wrapped at its width and in colour.

    Colours stay away where ``NO_COLOR`` is set (no-color.org) or ``TERM`` is ``dumb``.
    """
    if stream is None or not stream.isatty():
        return line
    line = _with_signs(line, stream)
    width = shutil.get_terminal_size().columns
    indent = " " * (len(line) - len(line.lstrip()) + 4)
    if len(line) > width >= NARROWEST:
        wrapped = textwrap.wrap(
            line, width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
        )
        line = "\n".join(wrapped)
    if os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb":
        return line
    for colour, begins in COLOURS.items():
        found = re.match(begins, line, re.DOTALL)
        if found is not None:
            return f"\033[{colour}m{found[0]}\033[0m{line[found.end() :]}"
    return line


def _with_signs(line: str, stream: Any) -> str:
    """With ``±`` for ``+-``, where the stream can show it."""
    try:
        "±".encode(stream.encoding or "ascii")
    except (LookupError, UnicodeEncodeError):
        return line
    return line.replace("+-", "±")


def complain(sentence: str) -> None:
    """What is wrong, in one line."""
    print(laid_out(f"proprio: {sentence}", sys.stderr), file=sys.stderr)


def say(message: str) -> None:
    """What takes long the first time, to whoever waits, and into every log."""
    if sys.stderr is not None:
        print(f"proprio: {message}", file=sys.stderr, flush=True)


def pass_on(line: str) -> None:
    """What a node printed, as it is."""
    if sys.stderr is not None:
        print(printable(line), file=sys.stderr, flush=True)


def say_progress(message: str) -> None:
    """What goes on, to whoever looks at it now."""
    if sys.stderr is not None and sys.stderr.isatty():
        print(f"proprio: {message}", file=sys.stderr)


def services_as_text(found: Sequence[Any]) -> str:
    """Services that answer, a line each, by node."""
    lines = []
    width = max(len(each.name) for each in found)
    node = ""
    for each in found:
        theirs = each.service.rpartition("/")[0]
        if theirs != node:
            node = theirs
            lines.append(f"{node} ({each.node_state})")
        lines.append(f"  {each.name.ljust(width)}  {each.about.partition(';')[0]}")
    return "\n".join(lines)


def estimate_as_text(estimate: Any) -> str:
    """An answer, line by line."""
    runs = f"{estimate.runs} run{'s' * (estimate.runs != 1)}"
    lines = [f"{estimate.verdict.value}  ({estimate.probe}, {estimate.robot}, {runs})"]
    lines += ["  " + _value_text(value, estimate.interval_first) for value in estimate.values]
    lines += [f"  - {reason}" for reason in estimate.reasons]
    fit = estimate.fit
    if fit is not None:
        lines.append(f"{_fit_text(fit)}, reduced chi-square {fit.reduced_chi2:.2f}")
    solver = estimate.solver
    if solver is not None:
        lines.append(
            f"  solver: {solver.name}, {solver.starts_agreeing} of {len(solver.paths)} starts agree"
        )
    lines += [f"  assumed: {assumption}" for assumption in estimate.assumptions]
    lines += [f"  note: {note}" for note in together(estimate.notes)]
    return "\n".join(lines)


def calibration_as_text(estimate: Any) -> str:
    """A calibration, line by line."""
    lines = [
        f"{estimate.verdict.value}  (calibration, {estimate.robot}, {estimate.used} of {estimate.runs} runs used)"
    ]
    if estimate.weighable is not None:
        lines.append(f"  {estimate.weighable.sentence()}")
    lines += [f"  - {reason}" for reason in estimate.reasons]
    if estimate.empty_hand is not None:
        lines.append(f"  empty hand: {estimate.empty_hand.sentence()}")
    lines += _unknowns_as_lines(estimate)
    if estimate.fit is not None:
        lines.append(_fit_text(estimate.fit))
    for each in estimate.weighed_empty:
        mass, half_width = (shown("kg", kg, spec=".1f") for kg in (each.mass_kg, each.half_width))
        lines.append(f"  {each.name}, weighed by the others: {mass} +- {half_width} (95 %)")
    if estimate.held_out:
        worst = max(estimate.held_out, key=lambda run: run.reduced_chi2)
        at_most = f"reduced chi-square at most {worst.reduced_chi2:.2f} ({worst.name})"
        lines.append(f"  held-out prediction of each run: {at_most}")
    lines += [f"  not separated: {sentence}" for sentence in estimate.not_separated]
    lines += [f"  next run: {plan_as_text(plan)}" for plan in estimate.advice]
    lines += [f"  note: {note}" for note in together(estimate.notes)]
    return "\n".join(lines)


def _unknowns_as_lines(estimate: Any) -> Iterator[str]:
    """What is known of the robot after a calibration, beside what was known before."""
    if estimate.motion is not None:  # some hundred, and none has a meaning alone
        count = len(estimate.unknowns)
        if count:
            yield f"  {count} numbers of bodies, rotors and friction (see --json, --report)"
        return
    source = "before" if "refreshed" in estimate.origin else "file"
    listed = [row for row in estimate.unknowns if not row.is_detail and row.kind != "zero"]
    for row in listed:
        unit = "" if row.unit == "1" else " " + row.unit
        before = f"({source}: {row.prior:.5f} +- {row.prior_std:.5f})"
        yield f"  {row.name:34s} {row.value:9.5f} +- {row.std:.5f}{unit}   {before}"
    more = len(estimate.unknowns) - len(listed)
    if more:
        yield f"  and {more} more: zeros, encoder errors and links (see --json, --report)"


def table_of_checks(checks: Sequence[Any]) -> Table:
    """What several recordings are good for."""
    rows = [("recording", "usable", "seconds", "a light mass to")]
    for check in checks:
        known = [check.tells.mass_half_width_kg] if check.tells is not None else []
        known += [run.mass_half_width_kg for run in check.runs]
        best = min((half for half in known if half is not None), default=None)
        words = "-" if best is None else f"+-{shown('kg', best, spec='.0f')}"
        found = len(check.runs) + (check.motion is not None)
        name = printable("/".join(Path(check.bag).parts[-2:]))
        rows.append((name, f"{check.usable} of {found}", f"{check.duration_s:.1f}", words))
    return rows


def plan_as_text(plan: Any) -> str:
    """A run to make, in a line."""
    start = ", ".join(f"{name} {position:+.2f}" for name, position in plan.start.items())
    return (
        f"{plan.joint} {shown('A', plan.current_A, spec='+.0f')} for {plan.duration_s:g} s from ({start}), "
        f"{plan.kind}: {plan.reason}; {100 * plan.clearance_m:.0f} cm above the table"
    )


def _fit_text(fit: Any) -> str:
    return f"  fit: rms {shown(fit.unit, fit.rms)}, expected {shown(fit.unit, fit.expected_rms)}"


def _value_text(value: Any, interval_first: bool = False) -> str:
    if value.value is None:
        return f"{value.name}: not determined ({value.reason})"
    if isinstance(value.value, list):
        why = f" ({value.reason})" if value.reason else ""
        return f"{value.name}: {value.in_words() if value.known else 'not determined'}{why}"
    # masses in g and moduli in kPa, as on the report's page; --json gives them in kg and Pa
    spec = spec_for(value.unit, value.std)
    number = shown(value.unit, value.value, spec=spec)
    if value.ci95 is None:
        return (
            f"{value.name}: {number} ({value.reason})"
            if value.reason
            else f"{value.name}: {number}"
        )
    interval = shown(value.unit, *value.ci95, spec=spec)
    if interval_first:
        return f"{value.name}: {interval} (95 % interval), best guess {number}"
    return f"{value.name}: {number}   95 % interval {interval}"
