"""The plots of a calibration: drive trains, correlations, residuals, and how well the other runs predict each run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from proprio_ros.calibration_files.pushes import Calibration
from proprio_ros.identification.calibration_estimate import HeldOutRun
from proprio_ros.identification.estimate import RunFit, UnknownRow
from proprio_ros.kinds import KINDS, label_of
from proprio_ros.quantity import Z95
from proprio_ros.records import TORQUE_OFF
from proprio_ros.report.figures import ACCENT, INK, MUTED, PALE, SIMULATED, TIME, drawn, plain, svg

TERMS = ("torque_constant", "coulomb", "viscous", "load_friction", "armature", "stribeck")
OF_MOTIONS = ("torque_share", "coulomb", "viscous", "load_friction", "armature", "offset")
ANY_SIGN = ("torque_constant", "torque_share", "offset")
MOST_OVER = 5.0  # bars are cut at so many times the most that any joint may have by now
NOTICEABLE = 0.3  # correlations below this are not worth a row of the picture
MOST_CORRELATED = 30
RUNS_A_ROW = 4


def joints_of(
    unknowns: tuple[UnknownRow, ...],
    of_runs: bool = False,
) -> list[str]:
    """Joints whose drive trains are among the unknowns; ``of_runs``: only where runs said so, and not motions."""
    kinds = {"torque_constant"} if of_runs else {"torque_constant", "torque_share"}
    return [str(row.scope) for row in unknowns if row.kind in kinds]


def draw_drive_trains(unknowns: tuple[UnknownRow, ...]) -> Any:
    """Every term of every joint: what the file said (pale), and what the runs say now (strong), 95 % each; a ``Figure``."""
    rows = {row.key: row for row in unknowns}
    joints = joints_of(unknowns)
    terms = TERMS if ("torque_constant", joints[0]) in rows else OF_MOTIONS
    height = 1.1 + 2 * (0.55 + 0.28 * len(joints))
    with drawn(9.2, height, nrows=2, ncols=3, sharey=True) as (figure, axes):
        for axis, term in zip(axes.ravel(), terms, strict=True):
            _draw_term(
                axis,
                term,
                [rows.get((term, joint)) for joint in joints],
            )
            names = [plain(_short(joint, 32)) for joint in joints[::-1]]
            axis.set_yticks(range(len(joints)), names)
        return figure


def _draw_term(axis: Any, term: str, rows: Sequence[UnknownRow | None]) -> None:
    """One term of every joint, from above; None where a joint has none."""
    least = -np.inf if term in ANY_SIGN else 0.0
    for place, row in enumerate(rows[::-1]):
        if row is None:
            continue
        before = (row.prior, row.prior_std, 0.62, PALE)
        now = (row.value, row.std, 0.26, ACCENT)
        for value, std, height, color in (before, now):
            low = max(value - Z95 * std, least)
            width = value + Z95 * std - low
            axis.barh(
                place,
                width,
                left=low,
                height=height,
                color=color,
                linewidth=0,
            )
        axis.plot(
            max(row.value, least),
            place,
            "|",
            color=INK,
            markersize=9,
            markeredgewidth=1.6,
        )
    kind = KINDS[term]
    axis.set_title(f"{kind.label} ({kind.unit.replace('^2', '²')})", fontsize=9.5, loc="left")
    axis.grid(axis="y", visible=False)
    # a file that leaves it wide open must not hide what was learnt
    known = [abs(row.value) + Z95 * row.std for row in rows if row is not None]
    most = MOST_OVER * max(known, default=1.0)
    low, high = axis.get_xlim()
    axis.set_xlim(max(low, -most), min(high, most))
    axis.locator_params(axis="x", nbins=5)


def correlation_figure(calibration: Calibration) -> str:
    """Correlations between the unknowns that have any to speak of."""
    count = len(calibration.keys)
    strength = np.abs(calibration.correlation - np.eye(count)).max(axis=1)
    strongest = np.argsort(-strength).tolist()
    chosen = [row for row in strongest if strength[row] > NOTICEABLE][:MOST_CORRELATED]
    chosen = sorted(chosen) or list(range(min(count, 2)))
    names = [plain(label_of(calibration.keys[row])) for row in chosen]
    size = 3.8 + 0.2 * len(names)
    with drawn(size + 1.0, size) as (figure, axis):
        shown = calibration.correlation[np.ix_(chosen, chosen)]
        edges = np.arange(len(names) + 1) - 0.5
        picture = axis.pcolormesh(
            edges,
            edges,
            shown,
            cmap="RdBu_r",
            vmin=-1.0,
            vmax=1.0,
        )
        axis.invert_yaxis()
        axis.set_aspect("equal")
        axis.set_xticks(
            range(len(names)),
            names,
            rotation=90,
            fontsize=7.5,
        )
        axis.set_yticks(range(len(names)), names, fontsize=7.5)
        axis.grid(visible=False)
        for spine in axis.spines.values():
            spine.set_visible(False)
        # so few steps that the bar is drawn as shapes, not embedded as an image
        steps = np.linspace(-1.0, 1.0, 41)
        figure.colorbar(
            picture,
            ax=axis,
            shrink=0.7,
            label="correlation",
            boundaries=steps,
        )
        return svg(figure, "Correlations between the unknowns of the calibration")


def residuals_figure(fits: tuple[RunFit, ...]) -> str:
    """Measured less simulated of every run, on one scale."""
    rows = -(-len(fits) // RUNS_A_ROW)
    grid = {
        "nrows": rows,
        "ncols": min(len(fits), RUNS_A_ROW),
        "sharex": True,
        "sharey": True,
        "squeeze": False,
    }
    with drawn(9.2, 0.5 + 1.35 * rows, **grid) as (figure, axes):
        for axis in axes.ravel()[len(fits) :]:
            axis.set_visible(False)
        for axis, fit in zip(axes.ravel(), fits, strict=False):
            axis.fill_between(
                fit.times_s,
                -2e3 * fit.sigma,
                2e3 * fit.sigma,
                color=ACCENT,
                alpha=0.16,
                linewidth=0,
            )
            axis.axhline(0.0, color=MUTED, linewidth=0.7)
            residual = 1e3 * (fit.measured - fit.simulated)
            axis.plot(
                fit.times_s,
                residual,
                "o-",
                color=SIMULATED,
                markersize=2,
                linewidth=0.7,
            )
            for left_out in fit.left_out_times_s:
                axis.axvline(left_out, color=MUTED, linewidth=0.8, linestyle=":")
            axis.set_title(
                plain(_short(fit.name, 32)),
                fontsize=7.5,
                loc="left",
            )
        figure.supxlabel(TIME[fits[0].source == TORQUE_OFF], fontsize=9.5)
        figure.supylabel("residual (mrad)", fontsize=9.5)
        return svg(figure, "Residuals of every run over time, with two standard deviations")


def held_out_figure(held_out: tuple[HeldOutRun, ...]) -> str:
    """Error of the held-out prediction of each run, and what was expected of it."""
    from matplotlib.ticker import LogLocator

    names = [plain(_short(run.name, 64)) for run in held_out][::-1]
    with drawn(
        9.2,
        0.9 + 0.24 * len(names),
        ncols=2,
        sharey=True,
    ) as (figure, (left, right)):
        places = range(len(names))  # shortened names may be alike
        left.barh(
            places,
            [1e3 * run.rms for run in held_out][::-1],
            color=ACCENT,
            height=0.6,
        )
        left.set_xscale("log")
        left.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        left.xaxis.set_major_formatter("{x:g}")
        left.xaxis.set_minor_formatter("")
        left.set_xlabel("measured less predicted, rms (mrad)")
        right.barh(
            places,
            [run.reduced_chi2 for run in held_out][::-1],
            color=ACCENT,
            height=0.6,
        )
        right.axvline(1.0, color=SIMULATED, linewidth=1.0)
        right.set_xlabel("reduced chi-square (1: as promised)")
        for axis in (left, right):
            axis.grid(axis="y", visible=False)
            axis.set_yticks(places, names, fontsize=7.5)
        return svg(figure, "Held-out prediction of each run")


def _short(name: str, most: int) -> str:
    """Name of a recording without the folder that every bag has; of a long one its end, by which it differs from others."""
    name = name.removesuffix("/bag_mcap").removesuffix("/bag_sqlite3")
    return name if len(name) <= most else "…" + name[1 - most :]
