"""The answer of a calibration: what is known about the robot now, how well it predicts runs, and what to do next."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from proprio_ros.calibration import Calibration
from proprio_ros.identification.estimate import Fit, RecordedRun, RunFit, UnknownRow, Verdict, plain
from proprio_ros.schema import header, reason_codes


@dataclass(frozen=True)
class ProbePlan:
    """A run that has not been made.

    Attributes:
        joint: to be driven; current_A: by this, for duration_s.
        start: position of every joint before it [rad or m].
        kind: ``lift``, ``lower`` (gravity wins against the motor) or ``driven`` (motor and gravity pull together).
        travel: expected, smallest and largest over the masses asked for [rad].
        clearance_m: lowest point of arm and hand above the base's plane during the run.
        std_kg: expected standard deviation of each mass asked for; empty for a calibration run.
        reason: why this run, in a sentence.
    """

    joint: str
    start: Mapping[str, float]
    current_A: float
    duration_s: float
    kind: str
    travel: tuple[float, float]
    clearance_m: float
    std_kg: tuple[float, ...] = ()
    reason: str = ""

    def as_json(self) -> dict[str, Any]:
        record: dict[str, Any] = {
            "joint": self.joint,
            "start": dict(self.start),
            "current_A": self.current_A,
            "duration_s": self.duration_s,
            "kind": self.kind,
            "travel_rad": list(self.travel),
            "clearance_m": self.clearance_m,
        }
        if self.std_kg:
            record["std_kg"] = list(self.std_kg)
        record["reason"] = self.reason
        return record


@dataclass(frozen=True)
class HeldOutRun:
    """One run as predicted by all others.

    Attributes:
        rms: of measured less predicted [rad].
        reduced_chi2: of the same under the covariance of the prediction; 1 is as good as promised.
    """

    name: str
    joint: str
    rms: float
    reduced_chi2: float
    samples: int


@dataclass(frozen=True)
class CalibrationEstimate:
    """The result of one calibration.

    Attributes:
        robot: its name.
        runs: how many were given; run_fits: those used, as recorded and as simulated; unused: the others.
        calibration: what is known now; None where the runs do not determine it.
        unknowns: every shared unknown, robot file's word against posterior.
        held_out: one entry per run used.
        not_separated: sentences on what these runs leave open.
        advice: the runs that would help most, best first.
        origin: bags, references, and the file that was written, as ``as_json`` gives them.
    """

    robot: str
    verdict: Verdict
    reasons: tuple[str, ...]
    runs: int
    calibration: Calibration | None
    fit: Fit | None = None
    run_fits: tuple[RunFit, ...] = ()
    unused: tuple[RecordedRun, ...] = ()
    unknowns: tuple[UnknownRow, ...] = ()
    held_out: tuple[HeldOutRun, ...] = ()
    not_separated: tuple[str, ...] = ()
    advice: tuple[ProbePlan, ...] = ()
    notes: tuple[str, ...] = ()
    timing_s: dict[str, float] = field(default_factory=dict)
    origin: dict[str, Any] = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        """Plain numbers; what is not a number is null."""
        fit = self.fit
        calibration = self.calibration
        return plain(
            {
                **header("calibration"),
                "bags": [],
                "references": [],
                "calibration": None,
                **self.origin,
                "robot": self.robot,
                "runs": self.runs,
                "verdict": self.verdict.value,
                "reasons": list(self.reasons),
                "reason_codes": reason_codes(self.reasons),
                "unknowns": [
                    {
                        "name": row.name,
                        "value": row.value,
                        "std": row.std,
                        "unit": row.unit,
                        "prior": row.prior,
                        "prior_std": row.prior_std,
                    }
                    for row in self.unknowns
                ],
                "noise": None
                if calibration is None
                else {
                    "residual_scale": calibration.residual_scale,
                    "stamp_jitter_s": calibration.stamp_jitter_s,
                    "torque_disturbance_N_m": calibration.torque_disturbance,
                    "start_velocity_rad_s": calibration.start_velocity,
                },
                "fit": None
                if fit is None
                else {
                    "rms": fit.rms,
                    "expected_rms": fit.expected_rms,
                    "unit": fit.unit,
                    "reduced_chi2": fit.reduced_chi2,
                    "condition": fit.condition,
                },
                "held_out": [
                    {"name": h.name, "joint": h.joint, "rms": h.rms, "reduced_chi2": h.reduced_chi2}
                    for h in self.held_out
                ],
                "not_separated": list(self.not_separated),
                "advice": [plan.as_json() for plan in self.advice],
                "notes": list(self.notes),
                "timing_s": self.timing_s,
            }
        )
