"""A container's contents in the report: how probable each kind is, and how far the moving part went."""

from __future__ import annotations

from proprio_ros.addons.contents.detail import ContentsDetail
from proprio_ros.identification.estimate import Estimate
from proprio_ros.kinds import label_of
from proprio_ros.report.figures import drawn, plain, svg
from proprio_ros.report.html import bars, framed, percent


def sections(estimate: Estimate) -> list[str]:
    """The contents' part of the report, as HTML."""
    detail = estimate.detail
    if not isinstance(detail, ContentsDetail):
        return []
    rows = [
        (label_of(f"{kind}_inside").removeprefix("probability of "), share, percent(share))
        for kind, share in detail.probabilities.items()
    ]
    parts = ["<h2>What is inside</h2>", bars(rows)]
    if detail.moved:
        caption = "As the most probable model has it: how far the moving part of the contents is from the container's axis."
        parts += ["<h3>What moved</h3>", framed(moved_figure(detail), caption, "small-one")]
    return parts


def moved_figure(detail: ContentsDetail) -> str:
    """How far the moving part was from the container's axis in each run."""
    with drawn(5.2, 3.2) as (figure, axes):
        for name, times_s, x in detail.moved:
            axes.plot(
                times_s,
                1e3 * x,
                "-",
                linewidth=1.2,
                label=plain(name),
            )
        axes.set_xlabel("time since the current came on (s)")
        axes.set_ylabel("from the container's axis (mm)")
        axes.legend(loc="best")
        return svg(
            figure,
            "How far the moving part of the contents is from the container's axis in each run",
        )
