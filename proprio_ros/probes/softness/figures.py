"""A soft block in the report: how it is deformed, force over squeeze, and both of its moduli together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from proprio_ros.identification.estimate import Estimate
from proprio_ros.probes.softness.detail import (
    BlockShape,
    JointInterval,
    SoftnessDetail,
    SqueezeCurve,
)
from proprio_ros.quantity import shown_unit
from proprio_ros.report.figures import ACCENT, INK, MUTED, SIMULATED, drawn, plain, svg
from proprio_ros.report.html import framed

# where one looks: along y, a little from the right and from above
VIEW = np.array([-0.3, 1.0, -0.3])
# where the light comes from
LIGHT = np.array([0.3, -0.5, 0.81])


def sections(estimate: Estimate) -> list[str]:
    """The block's part of the report, as HTML."""
    detail = estimate.detail
    if not isinstance(detail, SoftnessDetail) or not detail.curves:
        return []
    parts = ["<h2>The block</h2>", framed(squeeze_figure(detail.curves), size="small-one")]
    if detail.joint is not None:
        prior = "Poisson's ratio is the prior's here, and so is how long the region is."
        picture = framed(
            joint_figure(detail.joint), "" if detail.joint.determined else prior, "small-one"
        )
        parts += ["<h3>Both Lamé parameters together</h3>", picture]
    return parts


def _flat(points: np.ndarray, left: float) -> np.ndarray:
    """On paper, (.., 2), around `left`: what lies deeper is drawn a little to the right and higher."""
    x, deep, z = np.moveaxis(points, -1, 0)
    return np.stack([left + x - VIEW[0] * deep, z - VIEW[2] * deep], -1)


def _seen_faces(shape: BlockShape) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of the surface that one sees, the farthest first, (F, 3, 3), and their colours by the light on them, (F, 3)."""
    from matplotlib.colors import to_rgb

    faces = shape.points[shape.triangles]
    one, other, third = np.moveaxis(faces, 1, 0)  # corners, (F, 3) each
    normal = np.cross(other - one, third - one)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    front = normal @ VIEW < 0.0
    faces = faces[front]
    order = np.argsort(-(faces.mean(axis=1) @ VIEW))
    light = 0.35 + 0.65 * np.clip(normal[front] @ LIGHT, 0.0, 1.0)
    ink = 1.0 - np.array(to_rgb(ACCENT))
    colors = np.clip(1.0 - ink * (1.15 - 0.75 * light[:, None]), 0.0, 1.0)
    return faces[order], colors[order]


def _draw_block(axes: Any, shape: BlockShape, left: float, floor: float) -> None:
    """A block between two fingers, as it is deformed, around `left`, with time and squeeze below `floor`."""
    from matplotlib.collections import PolyCollection

    def _draw(polygons: Any, facecolors: Any, edgecolors: str, alpha: float | None) -> None:
        axes.add_collection(
            PolyCollection(
                polygons,
                facecolors=facecolors,
                edgecolors=edgecolors,
                linewidths=0.3,
                alpha=alpha,
            )
        )

    half = 1.15 * np.abs(shape.points[:, 1:]).max(axis=0)
    aside = np.array([0.5 * (1.0 - shape.squeeze), 0.0, 0.0])
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) * half
    finger = np.column_stack([np.zeros(4), corners])  # (4, 3)
    faces, colors = _seen_faces(shape)
    _draw([_flat(finger - aside, left)], MUTED, MUTED, 0.9)
    _draw(_flat(faces, left), colors, f"{INK}40", None)
    _draw([_flat(finger + aside, left)], MUTED, MUTED, 0.45)
    words = f"{shape.time_s:.2f} s\n{100.0 * max(shape.squeeze, 0.0):.0f} %"
    axes.text(left, floor, words, ha="center", va="top")


def squeeze_figure(curves: Sequence[SqueezeCurve]) -> str:
    """The block at a few instants of the first closing, as finite elements deform it, and force over squeeze of all closings."""
    shapes = curves[0].shapes
    rows = [1.0, 2.0] if shapes else [0.01, 2.0]
    with drawn(
        5.2,
        1.6 * sum(rows),
        nrows=2,
        height_ratios=rows,
    ) as (figure, (above, below)):
        halves = [float(np.abs(shape.points[:, 1:]).max()) for shape in shapes]
        floor = -1.7 * max(halves, default=0.0)
        for place, shape in enumerate(shapes):
            _draw_block(above, shape, 2.1 * place, floor)
        above.autoscale_view()
        above.set_aspect("equal")
        above.axis("off")
        for curve in curves:
            order = np.argsort(curve.squeeze)
            percent = 100.0 * curve.squeeze[order]
            force = curve.force_N[order]
            below.plot(
                percent,
                force,
                "-o",
                markersize=3,
                linewidth=1.2,
                label=plain(curve.run),
            )
        below.set_xlabel("squeeze (% of the block's length)")
        percent_mm = 10.0 * curves[0].length
        travel = below.secondary_xaxis(
            "top", functions=(lambda p: p * percent_mm, lambda mm: mm / percent_mm)
        )
        travel.set_xlabel("travel of the fingers after the touch (mm)")
        below.set_ylabel("force on a finger (N)")
        if len(curves) > 1:
            below.legend()
        return svg(
            figure, "The block between the fingers, and force over squeeze by the fitted law"
        )


def joint_figure(joint: JointInterval) -> str:
    """Where both Lame parameters lie together, among the lines of equal Poisson's ratio."""
    factor, unit = shown_unit(joint.unit)
    mu, lam = factor * joint.outline.T
    with drawn(5.2, 3.9) as (figure, axes):
        axes.fill(mu, lam, color=ACCENT, alpha=0.25, linewidth=0)
        axes.plot(mu, lam, color=ACCENT, linewidth=1.2, label="holds both with 95 %")
        axes.plot(
            *(factor * joint.value),
            "o",
            color=SIMULATED,
            markersize=5,
            label="estimate",
        )
        right = 1.15 * mu.max()
        top = 1.15 * lam.max()
        for ratio in (0.1, 0.2, 0.3, 0.4, 0.45):
            slope = 2.0 * ratio / (1.0 - 2.0 * ratio)  # lambda over mu
            end = min(right, top / slope)
            axes.plot(
                [0.0, end],
                [0.0, slope * end],
                color=MUTED,
                linewidth=0.7,
                linestyle=":",
            )
            axes.annotate(f"{ratio:g}", (end, slope * end), color=MUTED)
        axes.set_xlim(0.0, right)
        axes.set_ylim(0.0, top)
        axes.set_xlabel(f"mu ({unit})")
        axes.set_ylabel(f"lambda ({unit}); dotted: equal Poisson's ratio")
        axes.legend(loc="best")
        return svg(figure, "Both Lame parameters together: the region that holds them with 95 %")
