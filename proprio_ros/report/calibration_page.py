"""The HTML page of a calibration."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path

from proprio_ros.identification.calibration_estimate import CalibrationEstimate
from proprio_ros.identification.estimate import Verdict
from proprio_ros.kinds import KINDS
from proprio_ros.quantity import Z95, shown, spec_for
from proprio_ros.report import calibration_figures as figures
from proprio_ros.report import html, pictures
from proprio_ros.report.figures import svg
from proprio_ros.report.html import (
    bulleted,
    framed,
    listed,
    plotted,
    provenance,
    table,
    titled,
    within,
    write_document,
)
from proprio_ros.report.motion_sections import torques

_WORDS = {
    Verdict.REJECTED: "rejected: the model does not explain the runs",
    Verdict.NOT_IDENTIFIABLE: "not identifiable: the runs do not determine it",
}


def write_calibration_report(
    estimate: CalibrationEstimate,
    path: Path,
    *,
    command: str = "",
    sources: Sequence[str] = (),
    force: bool = False,
) -> None:
    """Write the page for one calibration.

    Args:
        estimate: The calibration.
        path: Of the page.
        command: The command line that gives the same again.
        sources: Names of what it came from.
        force: Whether a file that is no page is replaced.
    """
    parts = _headline(estimate)
    if figures.joints_of(estimate.unknowns):
        parts += plotted(
            "The drive train",
            svg(
                figures.draw_drive_trains(estimate.unknowns),
                "Drive-train terms of every joint, before and after",
            ),
            "Pale: the 95 % interval of the robot file, cut where it is far wider. Strong: what the recordings leave of it. "
            "A strong bar as long as the pale one was not learnt.",
        )
    parts += _noise(estimate)
    if estimate.run_fits:
        parts += plotted(
            "Residuals of every run",
            figures.residuals_figure(estimate.run_fits),
            "The points should scatter about zero inside the band, without a trend; dotted lines are samples left out.",
        )
    if estimate.held_out:
        parts += plotted(
            "Each run, held out and predicted by the others",
            figures.held_out_figure(estimate.held_out),
            "The run as the calibration without it predicts it. It may be far off where the others say little, but not "
            "further than promised: bars on the right that reach far past 1 contradict the others.",
        )
    parts += [
        *_motions(estimate),
        *_weighed(estimate),
        *torques(estimate.joint_fits, False, learnt=True),
    ]
    parts += ["<h2>Runs that were not used</h2>"] * bool(estimate.unused)
    for n, run in enumerate(estimate.unused, start=1):
        parts += [f"<h3>{html.breakable(run.name)}</h3>", framed(pictures.run_figure(None, run, n))]
    parts += listed("What the runs could not separate", estimate.not_separated)
    if estimate.calibration is not None:
        parts += plotted(
            "Correlations",
            figures.correlation_figure(estimate.calibration),
            "Strong colours off the diagonal: two numbers that these runs know better together than each alone. A weighing "
            "uses them together.",
        )
    parts += _advice(estimate)
    parts += _unknowns(estimate)
    parts += listed("Notes on the runs", estimate.notes)
    parts += provenance(command, sources, estimate.timing_s)
    title = f"proprio: calibration {estimate.verdict.value.replace('_', ' ')}"
    write_document(Path(path), title, parts, "--report", force)


def _motions(estimate: CalibrationEstimate) -> list[str]:
    motion = estimate.motion
    if motion is None:
        return []
    runs = [
        [run["name"], f"{run['duration_s']:.0f} s", shown("kg", run["load_kg"], spec=".0f")]
        for run in motion.runs
    ]
    joints = [
        [joint, shown("N m", rms, spec=".0f"), f"{windows:.1f}"]
        for joint, rms, windows in zip(
            motion.joints, motion.residual, motion.correlation, strict=True
        )
    ]
    return [
        "<h2>The motions</h2>",
        table(["", "duration", "in the hand"], runs, numbers=(1, 2)),
        f"<p>By its torques the arm weighs {motion.arm_over_urdf:.2f} times what its URDF says. The torque constants count as "
        f"known to {100.0 * motion.torque_scale_std:.1f} %, times {motion.torque_scale:.3f}.</p>",
        "<h3>Torque that is left over</h3>",
        table(
            ["joint", "rms over windows of 0.5 s", "windows that share an error"],
            joints,
            numbers=(1, 2),
        ),
    ]


def _weighed(estimate: CalibrationEstimate) -> list[str]:
    if not estimate.weighed_empty:
        return []
    loads = (
        {run["name"]: run["load_kg"] for run in estimate.joint.runs}
        if estimate.joint is not None
        else {}
    )
    rows = []
    for each in estimate.weighed_empty:
        spec = spec_for("kg", each.half_width / Z95)
        held = shown(
            "kg",
            loads.get(each.name, 0.0),
            spec=".0f",
        )
        rows.append(
            [
                each.name,
                held,
                shown("kg", each.mass_kg, spec=spec),
                "± " + shown("kg", each.half_width, spec=spec),
            ]
        )
    title = "<h3>Each motion, weighed by the calibration of the others</h3>"
    return [
        title,
        table(
            ["", "held", "weighs", "95 %"],
            rows,
            numbers=(1, 2, 3),
        ),
    ]


def _headline(estimate: CalibrationEstimate) -> list[str]:
    used = f"{estimate.used} of {estimate.runs} runs used"
    verdict = _WORDS.get(
        estimate.verdict,
        estimate.verdict.value.replace("_", " "),
    )
    parts = titled(f"calibration of {estimate.robot}, {used}", estimate.verdict.value, verdict)
    if estimate.weighable is not None:
        parts.append(f'<p class="value beside">{escape(estimate.weighable.sentence())}</p>')
    fit = estimate.fit
    if fit is not None:
        parts.append(
            f"<p class=interval>{shown(fit.unit, fit.rms)} rms of the residuals over all runs; "
            f"{shown(fit.unit, fit.expected_rms)} expected of encoder and stamps as they were learnt</p>"
        )
    parts += bulleted(estimate.reasons)
    if estimate.empty_hand is not None:
        parts.append(f"<p>Empty hand: {escape(estimate.empty_hand.sentence())}.</p>")
    return parts


def _noise(estimate: CalibrationEstimate) -> list[str]:
    calibration = estimate.calibration
    if calibration is None:
        return []
    rows = [
        [
            "readings, over what the robot file says of encoder noise and rounding",
            f"{calibration.residual_scale:.2f}",
        ],
        ["stamps of the joint states", shown("s", calibration.stamp_jitter_s)],
        [KINDS["disturbance"].label, shown("N m", calibration.torque_disturbance)],
        ["delay from run to run", shown("s", calibration.onset_jitter_s)],
        ["velocity at which probes begin", shown("rad/s", calibration.start_velocity)],
    ]
    return [
        "<h3>Noise, as the runs show it (standard deviations)</h3>",
        table(["", ""], rows, numbers=(1,)),
    ]


def _advice(estimate: CalibrationEstimate) -> list[str]:
    if not estimate.advice:
        return []
    rows = []
    for plan in estimate.advice:
        start = ", ".join(f"{name} {position:+.2f}" for name, position in plan.start.items())
        current = f"{shown('A', plan.current_A, spec='+.0f')}, {plan.duration_s:g} s"
        rows.append(
            [plan.joint, plan.kind, start, current, f"{100 * plan.clearance_m:.0f} cm", plan.reason]
        )
    header = ["joint", "kind", "start (rad)", "current", "clearance", "why"]
    return ["<h2>Runs that would help most</h2>", table(header, rows, numbers=(), labels=2)]


def _unknowns(estimate: CalibrationEstimate) -> list[str]:
    if not estimate.unknowns:
        return []
    rows = []
    for row in estimate.unknowns:
        left = f"{100.0 * row.std / row.prior_std:.0f} %" if row.prior_std > 0.0 else "-"
        prior = within(row.prior, row.prior_std)
        now = within(row.value, row.std)
        rows.append(
            [
                row.label,
                prior,
                now,
                left,
                row.unit.replace("^2", "²"),
            ]
        )
    header = ["unknown", "robot file", "now", "left of its uncertainty", "unit"]
    return [
        "<h2>Every shared unknown</h2>",
        table(header, rows, numbers=(1, 2, 3), labels=1),
    ]
