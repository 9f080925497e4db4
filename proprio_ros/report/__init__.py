"""One self-contained HTML page per result: what was measured, what was simulated, and what the number rests on."""

from proprio_ros.report.calibration_page import write_calibration_report
from proprio_ros.report.figures import motions_figure, runs_figure
from proprio_ros.report.notebook import (
    bars_figure,
    calibration_figure,
    series_figure,
    small_table,
    words_figure,
)
from proprio_ros.report.page import card, write_page

__all__ = [
    "bars_figure", "calibration_figure", "card", "motions_figure", "runs_figure", "series_figure", "small_table",
    "words_figure", "write_calibration_report", "write_page",
]  # fmt: skip
