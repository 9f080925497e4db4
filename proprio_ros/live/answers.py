"""What the nodes answer: as a sentence, and as keys and values of a diagnostics message."""

from __future__ import annotations

from typing import Any

import numpy as np

from proprio_ros.identification.calibration_estimate import CalibrationEstimate
from proprio_ros.identification.estimate import Estimate, Verdict
from proprio_ros.identification.fit import source_label
from proprio_ros.probes import probe_named
from proprio_ros.quantity import Z95, shown, spec_for


def interval_of(estimate: Estimate) -> str:
    """The first value in words; empty where it is not determined."""
    value = estimate.values[0]
    if (
        estimate.verdict is not Verdict.ACCEPTED
        or not isinstance(value.value, float)
        or value.ci95 is None
    ):
        return ""
    spec = spec_for(
        value.unit,
        value.std if isinstance(value.std, float) else None,
    )
    return f"{shown(value.unit, value.value, spec=spec)}, 95 % interval {shown(value.unit, *value.ci95, spec=spec)}"


def refusal_of(estimate: Estimate) -> str:
    """Why there is none."""
    return f"{estimate.verdict.value}: {'; '.join(estimate.reasons) or estimate.values[0].reason}"


def limited_by(estimate: Estimate) -> str:
    """What leaves the interval as wide as it is: the largest sources, until they make more than half of the variance.

    Empty where the estimate has no budget.
    """
    whole = sum(std**2 for _, std in estimate.budget)
    labels: list[str] = []
    named = 0.0
    for source, std in sorted(estimate.budget, key=lambda each: each[1], reverse=True):
        if named > 0.5 * whole:
            break
        labels.append(source_label(source))
        named += std**2
    return f"what is left is mostly {' and '.join(labels)}" if labels else ""


def live_interval(estimate: Estimate) -> tuple[float, float] | None:
    """What is searched for and its standard deviation as far as the run has come, also where a verdict still withholds them."""
    name, _ = probe_named(estimate.probe).answer
    found = ((float(row.value), float(row.std)) for row in estimate.unknowns if row.name == name)
    return next((known for known in found if np.isfinite(known[1])), None)


def live_answer(estimate: Estimate) -> tuple[int, str, dict[str, Any]] | None:
    """Number of samples, a sentence, and keys and values of an estimate from a run under way; None: it says nothing yet."""
    known = live_interval(estimate)
    if known is None:
        return None
    name, unit = probe_named(estimate.probe).answer
    value, std = known
    samples = sum(len(run.times_s) for run in estimate.run_fits)
    half = Z95 * std
    entries = {
        "probe": estimate.probe,
        "final": False,
        "samples": samples,
        name: value,
        f"{name}.unit": unit,
    }
    entries |= {f"{name}.std": std, f"{name}.ci95": [value - half, value + half]}
    words = shown(
        unit,
        value,
        half,
        spec=spec_for(unit, std),
        between=" +- ",
    )
    return samples, f"live, {samples} samples: {words}", entries


def as_diagnostics(estimate: Estimate) -> dict[str, Any]:
    """Keys and values of a diagnostics message about an estimate."""
    entries: dict[str, Any] = {
        "probe": estimate.probe,
        "verdict": estimate.verdict.value,
        "robot": estimate.robot,
    }
    for value in estimate.values:
        entries[value.name] = "not determined" if value.value is None else value.value
        entries[f"{value.name}.unit"] = value.unit
        if value.std is not None:
            entries[f"{value.name}.std"] = value.std
        if value.ci95 is not None:
            entries[f"{value.name}.ci95"] = list(value.ci95)
    return entries


def calibration_as_diagnostics(estimate: CalibrationEstimate) -> dict[str, Any]:
    """The same about a calibration of the robot."""
    entries: dict[str, Any] = {
        "probe": "robot",
        "verdict": estimate.verdict.value,
        "runs": estimate.runs,
    }
    for row in estimate.unknowns:
        if not row.is_detail:
            entries |= {
                row.name: row.value,
                f"{row.name}.unit": row.unit,
                f"{row.name}.std": row.std,
            }
    return entries
