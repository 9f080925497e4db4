"""Sections of the paper's page on searches, landscapes and what the paper leaves out: figures 6 and 7, and effects."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from proprio_ros.addons.paper.cases import Rows
from proprio_ros.addons.paper.cells import COLORS, flat, labels, linked, over, ranged
from proprio_ros.addons.paper.searches import EVALUATIONS
from proprio_ros.report.chart import Axis, Panel, Series, chart
from proprio_ros.report.html import framed


def optimisers(found: Sequence[Rows]) -> list[str]:
    """Figure 6: searches with gradients against those without."""
    names = labels(found, "search")
    steps = np.arange(1, EVALUATIONS + 1)
    instants = np.geomspace(
        1e-4,
        max(row["seconds"][-1] for row in flat(found)),
        60,
    )
    by_step = []
    by_time = []
    lines = []
    for name, color in zip(names, COLORS, strict=False):
        rows = flat(found, search=name)
        stepped = np.array(
            [_held(np.arange(1, len(row["cost"]) + 1), row["cost"], steps) for row in rows]
        )
        timed = np.array([_held(row["seconds"], row["cost"], instants) for row in rows])
        by_step.append(_banded(name, steps, stepped, color))
        by_time.append(_banded(name, instants, timed, color))
        good = [
            1 + int(np.argmax(np.array(row["cost"]) < 1.1))
            for row in rows
            if min(row["cost"]) < 1.1
        ]
        ends = [row["cost"][-1] for row in rows]
        end = ranged(float(np.median(ends)), ends, 1.0, 2)
        took = over(
            [row["seconds"][-1] for row in rows],
            1e3,
            0,
        )
        lines.append(
            [
                name,
                f"{len(good)} of {len(rows)}",
                over(good, 1.0, 0),
                end,
                took,
            ]
        )
    header = [
        "search",
        "within 10 % of the least",
        "simulations to there",
        "median cost at the end",
        "time in all (ms)",
    ]
    caption = "Median over the seeds, and from the least to the greatest; 1 is the least that any search found."
    return [
        '<h2 id="figure-6">Figure 6: gradients against none</h2>',
        "<p>The same lift of the heavy ball and the same first guess, between 2 and 500 g, for every search; unknown are the mass, "
        f"and where and how fast the joint began. Each may simulate {EVALUATIONS} times. Cost is that of all samples, over "
        "the least; time is that of a processor.</p>",
        framed(
            chart(by_step, Axis("simulations", "", log=True), "Cost over simulations"),
            caption,
        ),
        framed(
            chart(by_time, Axis("time (s)", "s", log=True), "Cost over time"),
            caption,
        ),
        linked("figure-6", header, lines, (2, 3, 4)),
    ]


def _held(
    x: Any,
    cost: Sequence[float],
    grid: np.ndarray,
) -> np.ndarray:
    """Best cost so far at the places of a grid; the first before it is known."""
    at = np.clip(
        np.searchsorted(np.asarray(x), grid, side="right") - 1,
        0,
        len(cost) - 1,
    )
    return np.asarray(cost)[at]


def _banded(
    name: str,
    x: np.ndarray,
    values: np.ndarray,
    color: str,
) -> Panel:
    values = np.minimum(values, 1e9)
    lines = _between(values, x) if len(values) > 1 else []
    median = Series(
        name,
        x,
        np.median(values, axis=0),
        color,
        listed=False,
    )
    return Panel(f"{name}: cost over the least", "", [*lines, median], 80.0, log=True)


def _between(values: np.ndarray, x: np.ndarray) -> list[Series]:
    """The least and the greatest of each column."""
    ends = (values.min(axis=0), values.max(axis=0))
    return [Series("", x, end, "left-out") for end in ends]


class _Searched(NamedTuple):
    """What one landscape is over."""

    what: str
    words: str
    unit: str
    scale: float
    log: bool


SEARCHED = {
    "payload": _Searched("heavy ball", "mass (g)", "g", 1e3, False),
    "sphere": _Searched("sphere in the box", "mass of the sphere (g)", "g", 1e3, False),
    "squeeze": _Searched("heavy cube", "Young's modulus (kPa)", "kPa", 1e-3, True),
}


def landscapes(found: Sequence[Rows]) -> list[str]:
    """Figure 7: the cost over what is searched for."""
    figures = []
    lines = []
    for row in found[0]["rows"]:
        searched = SEARCHED[row["experiment"]]
        scale = searched.scale
        every = flat(found, experiment=row["experiment"])
        least = [
            [scale * one["x"][int(np.argmin(one[key]))] for one in every] for key in ("last", "all")
        ]
        name = f"{searched.what} ({searched.unit})"
        lines.append([name, f"{scale * row['truth']:.3g}", *(over(x) for x in least)])
        figures.append(_landscape(searched, row))
    return [
        '<h2 id="figure-7">Figure 7: what the cost looks like</h2>',
        "<p>Squared error of the position over what is searched for, calibrated robots: of the last frame, "
        "which the paper descends, and of all samples. The least lies beside the truth by as much as the robot's numbers "
        "are off. The figures are of the first seed.</p>",
        linked(
            "figure-7",
            ["what", "true", "last frame least at", "all samples least at"],
            lines,
            (1, 2, 3),
        ),
        *figures,
    ]


def _landscape(searched: _Searched, row: Rows) -> str:
    """The costs of one seed."""
    panels = []
    for key, title, color in (
        ("last", "last frame", "answer"),
        ("all", "all samples, mean", "agreeing"),
    ):
        x = searched.scale * np.array(row["x"])
        squares = np.maximum(1e6 * np.array(row[key]), 1e-3)
        cost = Series(title, x, squares, color, listed=False)
        panel = Panel(
            f"{title} (mrad\u00b2)",
            "mrad\u00b2",
            [cost],
            110.0,
            verticals=[searched.scale * row["truth"]],
            log=True,
        )
        panels.append(panel)
    axis = Axis(searched.words, searched.unit, searched.log)
    drawn = chart(panels, axis, f"Cost, {searched.what}")
    return framed(drawn, f"{searched.what}; the red line is the truth.")


def effects(found: Sequence[Rows]) -> list[str]:
    """What it costs to leave something out."""
    kinds = {
        "torque": ("torque taken too high by (%)", "%", 100.0, "1 % of torque", 0.01),
        "friction": (
            "friction that the model leaves out (N m)",
            "N m",
            1.0,
            "0.01 N m of friction",
            0.01,
        ),
        "armature": ("armature taken too high by (%)", "%", 100.0, "10 % of armature", 0.1),
    }
    parts = []
    lines = []
    for effect, (words, unit, scale, amount, per) in kinds.items():
        x, errors = _errors(found, effect)
        drawn = chart(
            [_error_panel(scale * x, errors)], Axis(words, unit), f"Error of the mass over {effect}"
        )
        parts.append(framed(drawn))
        lines.append(
            [
                amount,
                over(
                    [1e3 * per * float(np.polyfit(x, each, 1)[0]) for each in errors],
                    1.0,
                    2,
                ),
            ]
        )
    panels = []
    for integrator, words in (("semi_implicit", "semi-implicit Euler"), ("rk4", "RK4")):
        x, errors = _errors(found, integrator)
        panels.append(_error_panel(x, errors, f"{words}: "))
        for steps in (1, 4, 16, 64):
            at = errors[:, list(x).index(steps)]
            lines.append(
                [f"{words}, {steps} step{'s' * (steps > 1)} per frame", over(at.tolist(), 1e3, 2)]
            )
    drawn = chart(
        panels, Axis("steps per frame of 1/60 s", "", log=True), "Error of the mass over substeps"
    )
    parts.append(framed(drawn))
    return [
        '<h2 id="effects">What the paper leaves out</h2>',
        "<p>A robot of which all is known but one thing, one lift of the heavy ball, all samples fitted. Line: mean over the "
        "seeds, which here draw only the encoder's noise; grey: the least and the greatest.</p>",
        linked("effects", ["what is wrong", "moves the mass by (g)"], lines, (1,)),
        *parts,
    ]


def _errors(
    found: Sequence[Rows],
    effect: str,
) -> tuple[np.ndarray, np.ndarray]:
    """Amounts (K,) and errors of the mass [kg], shape (seeds, K)."""
    errors = [[row["error"] for row in rows["rows"] if row["effect"] == effect] for rows in found]
    return np.array(
        [row["amount"] for row in found[0]["rows"] if row["effect"] == effect], float
    ), np.array(errors)


def _error_panel(
    x: np.ndarray,
    errors: np.ndarray,
    words: str = "",
) -> Panel:
    errors = 1e3 * errors
    mean = Series(
        "mean",
        x,
        errors.mean(axis=0),
        "answer",
        listed=False,
    )
    return Panel(
        f"{words}error of the mass (g)", "g", [*_between(errors, x), mean], 130.0, rules=[0.0]
    )
