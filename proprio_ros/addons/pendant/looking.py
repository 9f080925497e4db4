"""What ``proprio check`` says of recordings, with their signals to look at; a process of its own, since reading takes its time.

``python -m proprio_ros.addons.pendant.looking JSON`` with the arguments of `proprio_ros.check`; prints a JSON object.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from proprio_ros.cli.terminal import EXIT_BAD_INPUT, EXIT_OK
from proprio_ros.errors import ProprioError, RecordingError
from proprio_ros.pipeline.api import check
from proprio_ros.pipeline.loading import bag_recording
from proprio_ros.pipeline.request import Options, request_of
from proprio_ros.records import InputRecord, JointRecord, Recording

MOST_POINTS = 500
"""Of a curve."""


def looked_at(asked: Mapping[str, Any]) -> dict[str, Any]:
    """What ``proprio check --json`` prints, and ``signals``: by recording what is to be drawn.

    Raises: ConfigurationError, RobotError: As of `check`.
    """
    found = check(**asked).as_json()
    options = {key: value for key, value in asked.items() if key != "bags"}
    request = request_of(Options(**options))
    signals = {}
    for bag in asked["bags"]:
        try:
            signals[bag] = drawn(bag_recording(Path(bag), request))
        except RecordingError:
            signals[bag] = []  # the check says why
    return {**found, "signals": signals}


def drawn(recording: Recording) -> list[dict[str, Any]]:
    """Plots, each with its title and a curve a joint: times [s], values."""
    joints = recording.joints
    begin_ns = int(joints.times_ns[0])
    values = {
        "position [rad or m]": joints.position,
        "effort [N m or N]": joints.effort,
        "measured current [A]": joints.current,
    }
    if joints.effort is None and joints.current is None:
        values["effort, as published"] = joints.reported_effort
    plots = [
        _plot(title, joints, columns, begin_ns)
        for title, columns in values.items()
        if columns is not None
    ]
    inputs = recording.inputs
    if inputs is not None and not inputs.measured:
        title = f"input current [A], {inputs.source}"
        plots.append({**_plot(title, inputs, inputs.current_A, begin_ns), "step": "end"})
    return plots


def _plot(
    title: str, series: JointRecord | InputRecord, values: np.ndarray, begin_ns: int
) -> dict[str, Any]:
    """One plot.

    Args:
        title: With its unit.
        series: Whose times and joints these are.
        values: Of the joints, shape (T, J).
        begin_ns: Where the time axis begins.
    """
    rows = slice(None, None, max(1, len(values) // MOST_POINTS))
    times_s = np.round(1e-9 * (series.times_ns[rows] - begin_ns), 4)
    curves = {}
    for name, column in zip(series.names, values[rows].T, strict=True):
        known = np.isfinite(column)
        points = np.column_stack([times_s[known], column[known]])
        curves[name] = [[x, float(f"{y:.5g}")] for x, y in points.tolist()]
    return {"title": title, "curves": curves}


def main() -> int:
    """The exit code."""
    try:
        found = looked_at(json.loads(sys.argv[1]))
    except ProprioError as error:
        sys.stdout.write(json.dumps({"error": str(error)}))
        return EXIT_BAD_INPUT
    sys.stdout.write(json.dumps(found))
    return EXIT_OK


if __name__ == "__main__":
    sys.exit(main())
