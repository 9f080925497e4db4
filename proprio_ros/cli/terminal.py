"""What is said on the terminal: results to stdout, everything else to stderr."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from typing import Any

from proprio_ros import schema
from proprio_ros.errors import printable
from proprio_ros.quantity import shown, spec_for

EXIT_OK, EXIT_BAD_INPUT, EXIT_NO_ANSWER, EXIT_INTERRUPTED = 0, 2, 3, 130


def json_error(given: Sequence[str], sentence: str, exit_code: int) -> int:
    """With ``--json``, stdout always gets one object; returns the exit code."""
    if "--json" in given:
        show_json(schema.error(sentence, exit_code))
    return exit_code


def show_json(content: Mapping[str, Any]) -> None:
    """The one object of ``--json``."""
    print(json.dumps(content, indent=1))


def show(text: str) -> None:
    """Lines of a result; whatever else moves a cursor is escaped (names in notes and reasons are others')."""
    print("\n".join(printable(line) for line in text.split("\n")))


def say(message: str) -> None:
    """What takes long the first time, to whoever waits, and into every log."""
    if sys.stderr is not None:
        print(f"proprio: {message}", file=sys.stderr, flush=True)


def say_progress(message: str) -> None:
    """What goes on, to whoever looks at it now."""
    if sys.stderr is not None and sys.stderr.isatty():
        print(f"proprio: {message}", file=sys.stderr)


def estimate_as_text(estimate: Any) -> str:
    """An answer, line by line."""
    lines = [
        f"{estimate.verdict.value}  ({estimate.probe}, {estimate.robot}, {estimate.runs} run{'s' * (estimate.runs != 1)})"
    ]
    for value in estimate.values:
        lines.append("  " + _value_text(value, estimate.interval_first))
    for reason in estimate.reasons:
        lines.append(f"  - {reason}")
    if estimate.fit is not None:
        fit = estimate.fit
        lines.append(
            f"  fit: rms {shown(fit.unit, fit.rms)}, expected {shown(fit.unit, fit.expected_rms)}, "
            f"reduced chi-square {fit.reduced_chi2:.2f}"
        )
    if estimate.solver is not None:
        solver = estimate.solver
        lines.append(f"  solver: {solver.name}, {solver.starts_agreeing} of {len(solver.paths)} starts agree")
    lines += [f"  assumed: {assumption}" for assumption in estimate.assumptions]
    lines += [f"  note: {note}" for note in estimate.notes]
    return "\n".join(lines)


def calibration_as_text(estimate: Any) -> str:
    """A calibration, line by line."""
    lines = [f"{estimate.verdict.value}  (calibration, {estimate.robot}, {estimate.used} of {estimate.runs} runs used)"]
    if estimate.weighable is not None:
        lines.append(f"  {estimate.weighable.sentence()}")
    lines += [f"  - {reason}" for reason in estimate.reasons]
    if estimate.empty_hand is not None:
        lines.append(f"  empty hand: {estimate.empty_hand.sentence()}")
    of_runs = estimate.motion is None  # a motion's are some hundred, and none has a meaning alone
    source = "before" if "refreshed" in estimate.origin else "file"
    listed = [row for row in estimate.unknowns if of_runs and not row.is_detail and row.kind != "zero"]
    for row in listed:
        unit = "" if row.unit == "1" else " " + row.unit
        lines.append(
            f"  {row.name:34s} {row.value:9.5f} +- {row.std:.5f}{unit}   ({source}: {row.prior:.5f} +- {row.prior_std:.5f})"
        )
    if len(listed) < len(estimate.unknowns):
        lines.append(
            f"  and {len(estimate.unknowns) - len(listed)} more: zeros, encoder errors and links (see --json, --report)"
            if of_runs
            else f"  {len(estimate.unknowns)} numbers of bodies, rotors and friction (see --json, --report)"
        )
    if estimate.fit is not None:
        fit = estimate.fit
        lines.append(f"  fit: rms {shown(fit.unit, fit.rms)}, expected {shown(fit.unit, fit.expected_rms)}")
    lines += [
        f"  {each.name}, weighed by the others: {shown('kg', each.mass_kg, spec='.1f')} +- "
        f"{shown('kg', each.half_width, spec='.1f')} (95 %)"
        for each in estimate.weighed_empty
    ]
    if estimate.held_out:
        worst = max(estimate.held_out, key=lambda run: run.reduced_chi2)
        lines.append(
            f"  held-out prediction of each run: reduced chi-square at most {worst.reduced_chi2:.2f} ({worst.name})"
        )
    lines += [f"  not separated: {sentence}" for sentence in estimate.not_separated]
    lines += [f"  next run: {plan_as_text(plan)}" for plan in estimate.advice]
    lines += [f"  note: {note}" for note in estimate.notes]
    return "\n".join(lines)


def plan_as_text(plan: Any) -> str:
    """A run to make, in a line."""
    start = ", ".join(f"{name} {position:+.2f}" for name, position in plan.start.items())
    return (
        f"{plan.joint} {shown('A', plan.current_A, spec='+.0f')} for {plan.duration_s:g} s from ({start}), "
        f"{plan.kind}: {plan.reason}; {100 * plan.clearance_m:.0f} cm above the table"
    )


def _value_text(value: Any, interval_first: bool = False) -> str:
    if value.value is None:
        return f"{value.name}: not determined ({value.reason})"
    if isinstance(value.value, list):
        numbers = ", ".join("?" if v is None else f"{v:.4f}" for v in value.value)
        return f"{value.name}: [{numbers}] {value.unit}" + (f" ({value.reason})" if value.reason else "")
    # masses in g and moduli in kPa, as on the report's page; --json gives them in kg and Pa
    spec = spec_for(value.unit, value.std)
    number = shown(value.unit, value.value, spec=spec)
    if value.ci95 is None:
        return f"{value.name}: {number} ({value.reason})" if value.reason else f"{value.name}: {number}"
    interval = shown(value.unit, *value.ci95, spec=spec)
    if interval_first:
        return f"{value.name}: {interval} (95 % interval), best guess {number}"
    return f"{value.name}: {number}   95 % interval {interval}"
