"""What ``proprio check`` says of recordings, with their signals to look at; a process of its own, since reading takes its time.

``python -m proprio_ros.addons.pendant.looking JSON`` with the arguments of `proprio_ros.check`; prints a JSON object.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from proprio_ros.cli.terminal import EXIT_BAD_INPUT, EXIT_OK
from proprio_ros.errors import ProprioError, RecordingError
from proprio_ros.pipeline.api import check
from proprio_ros.pipeline.loading import bag_recording
from proprio_ros.pipeline.request import Options, request_of
from proprio_ros.records import Recording

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
    plots = [
        _plot(
            "position [rad or m]",
            joints.times_ns,
            begin_ns,
            joints.names,
            joints.position,
        ),
    ]
    measured = {
        "effort [N m or N]": joints.effort,
        "measured current [A]": joints.current,
    }
    if joints.effort is None and joints.current is None:
        measured["effort, as published"] = joints.reported_effort
    plots += [
        _plot(
            title,
            joints.times_ns,
            begin_ns,
            joints.names,
            values,
        )
        for title, values in measured.items()
        if values is not None
    ]
    inputs = recording.inputs
    if inputs is not None and not inputs.measured:
        title = f"input current [A], {inputs.source}"
        steps = _plot(
            title,
            inputs.times_ns,
            begin_ns,
            inputs.names,
            inputs.current_A,
        )
        plots.append({**steps, "step": "end"})
    return plots


def _plot(
    title: str,
    times_ns: np.ndarray,
    begin_ns: int,
    names: Sequence[str],
    values: np.ndarray,
) -> dict[str, Any]:
    """One plot.

    Args:
        title: With its unit.
        times_ns: Of the samples, shape (T,).
        begin_ns: Where the time axis begins.
        names: Of the joints.
        values: Of these, shape (T, J).
    """
    rows = slice(None, None, max(1, len(times_ns) // MOST_POINTS))
    times_s = np.round(1e-9 * (times_ns[rows] - begin_ns), 4)
    curves = {}
    for name, column in zip(names, values[rows].T, strict=True):
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
