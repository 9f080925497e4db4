"""Plans and checks as they show themselves in a notebook's cell."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from proprio_ros.identification.calibration_estimate import ExcitationPlan
from proprio_ros.pipeline.looked_into import BagCheck
from proprio_ros.quantity import Z95, shown, spec_for
from proprio_ros.report import bars_figure, small_table


def plans_table(
    title: str,
    plans: Iterable[ExcitationPlan],
    masses_kg: Sequence[float],
) -> str:
    """Plans with half of the 95 % interval that each promises, by mass.

    Args:
        title: Of the table.
        plans: Best first.
        masses_kg: Of what the hand may hold [kg].

    Returns:
        HTML.
    """
    header = (
        "joint",
        "current, time",
        "start (rad)",
        *(f"{mass:g} kg" for mass in masses_kg),
        "why",
    )
    rows = [
        (
            plan.joint,
            f"{shown('A', plan.current_A, spec='+.0f')}, {plan.duration_s:g} s",
            ", ".join(f"{joint} {place:+.2f}" for joint, place in plan.start.items()),
            *(f"± {shown('kg', Z95 * std, spec=spec_for('kg', std))}" for std in plan.std_kg),
            plan.reason,
        )
        for plan in plans
    ]
    return small_table(title, header, rows)


def plans_figure(title: str, plans: Iterable[ExcitationPlan]) -> Any:
    """Half of the 95 % interval that each promises, the widest over the masses."""
    bars = [
        (
            f"{plan.joint} {shown('A', plan.current_A, spec='+.0f')}, {plan.kind}",
            1e3 * Z95 * max(plan.std_kg, default=0.0),
            True,
        )
        for plan in plans
    ]
    return bars_figure(title, "half of the 95 % interval (g)", bars)


def _found(check: BagCheck) -> list[tuple[str, str, float, str]]:
    """Of each run, of the motion or of the whole bag: which joint, how it moved, how long [s], and what is wrong."""
    if check.runs:
        return [
            (run.joint, f"{run.travel:+.3f} {run.unit}", run.duration_s, run.problem)
            for run in check.runs
        ]
    if check.motion is not None:
        return [
            (
                ", ".join(check.motion.moved),
                "a motion",
                check.duration_s,
                check.problem,
            )
        ]
    return [
        (
            ", ".join(check.joints),
            "",
            check.duration_s,
            "no run" if check.refusal is None else check.refusal.about(check.bag),
        )
    ]


def checks_table(title: str, checks: Iterable[BagCheck]) -> str:
    """A row per run or motion."""
    rows = [
        (
            check.bag,
            joint,
            moves,
            f"{seconds:.2f} s",
            f"not usable: {problem}" if problem else "usable",
        )
        for check in checks
        for joint, moves, seconds, problem in _found(check)
    ]
    return small_table(title, ("recording", "joint", "moves", "for", ""), rows)


def checks_figure(title: str, checks: Iterable[BagCheck]) -> Any:
    """How long each run or motion is; what is not usable is grey, with why."""
    bars = [
        (
            ": ".join(
                filter(None, ("/".join(Path(check.bag).parts[-2:]), joint, problem or "usable"))
            ),
            seconds,
            not problem,
        )
        for check in checks
        for joint, _, seconds, problem in _found(check)
    ]
    return bars_figure(title, "time (s)", bars)
