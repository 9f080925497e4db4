"""How an arm changes over weeks: its friction and its torques, period by period, from what is known to be an empty hand."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime, timedelta, timezone
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from proprio_ros.batch.episodes import Episode
from proprio_ros.calibration_files.motions import MotionCalibration
from proprio_ros.errors import ConfigurationError, ProprioError, RecordingError
from proprio_ros.identification.regression.motion_fit import fit_empty
from proprio_ros.inputs.resources import write_in_one_step
from proprio_ros.pipeline.loading import bag_motion
from proprio_ros.pipeline.request import Options, Request, request_of
from proprio_ros.quantity import Z95
from proprio_ros.recordings.motions import Motion
from proprio_ros.report.chart import Axis, Panel, Series, chart
from proprio_ros.report.html import framed, number, table
from proprio_ros.threads import one_blas_thread

DAY_NS = 86_400_000_000_000
LONGEST_DAYS = 21
"""Recordings over so many days are told apart by day, over more by week."""
MOST_GROUPS = 12
"""Where no recording has a stamp, they make so many groups, in their order."""
MOST_PERIODS, MOST_OF_PERIOD = 60, 5
"""Periods that are looked at, and episodes of each: evenly over all of them."""


@dataclass(frozen=True)
class Period:
    """A day or a week, or some episodes in their order.

    Attributes:
        name: Its first date, or which episodes.
        at: Days since the first period, or the number of its first episode.
        episodes: That it was learnt from.
        arm: What they say about the arm.
    """

    name: str
    at: float
    episodes: int
    arm: MotionCalibration

    def term(self, kind: str) -> tuple[np.ndarray, np.ndarray]:
        """Values of a kind of friction by joint and their standard deviations, what runs of a period differ by counted."""
        rows = [self.arm.keys.index((kind, joint)) for joint in self.arm.joints]
        at = {"viscous": 0, "coulomb": 1, "offset": 2}[kind] * len(rows)
        spread = self.arm.friction_spread[at : at + len(rows)]
        return self.arm.values[rows], np.hypot(self.arm.std[rows], spread / np.sqrt(self.episodes))


def evenly(items: Sequence[Any], most: int) -> list[Any]:
    """At most so many of them, evenly over all."""
    return list(items[:: max(1, -(-len(items) // most))])


def periods_of(stamps: Sequence[int | None]) -> list[tuple[str, float, list[int]]]:
    """Name, place on the axis and numbers of the episodes of each period, by when each was recorded [ns]; None: not known."""
    if any(stamp is None for stamp in stamps) or not stamps:
        size = max(1, -(-len(stamps) // MOST_GROUPS))
        groups = [list(range(at, min(at + size, len(stamps)))) for at in range(0, len(stamps), size)]
        return [(f"{group[0]} to {group[-1]}", float(group[0]), group) for group in groups]
    days = [int(stamp or 0) // DAY_NS for stamp in stamps]
    first = min(days)
    length = 1 if max(days) - first < LONGEST_DAYS else 7
    found: dict[int, list[int]] = {}
    for place, day in enumerate(days):
        found.setdefault((day - first) // length * length, []).append(place)
    begin = datetime.fromtimestamp(first * 86400, timezone.utc)
    return [(f"{begin + timedelta(days=at):%Y-%m-%d}", float(at), found[at]) for at in sorted(found)]


@one_blas_thread
def drift_of(
    episodes: Sequence[Episode],
    stamps: Mapping[str, int | None],
    options: Options,
    tell: Callable[[str], Any] = lambda _: None,
) -> list[Period]:
    """What each period says about the arm, by episodes with an empty hand; one without a usable motion is left out.

    ``stamps`` say when each was recorded, by its path [ns]; where any is known, those without are left out. The span of the options
    is what of each episode is empty.
    """
    request = request_of(replace(options, calibration=None))
    episodes = [episode for episode in episodes if stamps.get(episode.path)] or episodes
    found = []
    periods = evenly(periods_of([stamps.get(episode.path) for episode in episodes]), MOST_PERIODS)
    if len(periods) > 1:
        tell(f"drift over {len(periods)} periods")
    for name, at, own in periods:
        motions = readable([episodes[place] for place in own], MOST_OF_PERIOD, request)
        with suppress(RecordingError):  # too little motion in all of them
            if motions:
                found.append(Period(name, at, len(motions), fit_empty(request.robot, motions)))
    return found


def readable(episodes: Sequence[Episode], most: int, request: Request) -> list[Motion]:
    """Motions of at most so many episodes, evenly over those there are; what cannot be read is left out."""
    found = []
    for episode in evenly(episodes, most):
        with suppress(ProprioError):  # its row says why
            found.append(bag_motion(Path(episode.path), request))
    return found


_TERMS = {"coulomb": "N_m", "viscous": "N_m_s_per_rad", "offset": "N_m"}
_HEADER = [
    "period",
    "episodes",
    "arm_over_urdf",
    "joint",
    *(f"{k}_{u}{e}" for k, u in _TERMS.items() for e in ("", "_std")),
]


def check_drift(path: Path) -> None:
    """Raises: ConfigurationError: a file is there that no batch wrote."""
    with suppress(FileNotFoundError), open(path, encoding="utf-8", errors="replace") as stream:
        if (first := stream.readline()) and first.strip() != ",".join(_HEADER):
            raise ConfigurationError(f"--out: {path} is no table of proprio: move it away, or name another folder")


def write_drift(periods: Sequence[Period], path: Path) -> None:
    """All of it as a table; ConfigurationError: it cannot be written, or another file is there."""
    check_drift(path)
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(_HEADER)
    for period in periods:
        terms = [period.term(kind) for kind in _TERMS]
        for row, joint in enumerate(period.arm.joints):
            values = [f"{column[row]:.6g}" for pair in terms for column in pair]
            writer.writerow([period.name, period.episodes, f"{period.arm.arm_over_urdf:.5f}", joint, *values])
    write_in_one_step(path, stream.getvalue(), "--out")


def drift_parts(periods: Sequence[Period]) -> list[str]:
    """A table and a picture for the page; nothing where there is only one period."""
    if len(periods) < 2:
        return []
    joints = periods[0].arm.joints
    at = np.array([period.at for period in periods])
    dated = "-" in periods[0].name
    axis = Axis("since the first [days]", "days") if dated else Axis("episode", "")
    terms = [period.term("coulomb") for period in periods]
    over = np.array([period.arm.arm_over_urdf for period in periods])
    weight = Series("arm", at, over, "measured", "dots")
    panels = [Panel("what the arm weighs by its torques, over its URDF", "", [weight], 90.0)]
    for row, joint in enumerate(joints):
        value, std = (np.array([term[part][row] for term in terms]) for part in (0, 1))
        band = at, value - Z95 * std, value + Z95 * std
        series = Series(joint, at, value, "measured", "dots")
        panels.append(Panel(f"Coulomb friction of {joint} [N m]", "N m", [series], 90.0, band))
    header = ["from", "episodes", "arm over URDF", *(f"{joint} [N m]" for joint in joints)]
    rows = []
    for period, term in zip(periods, terms, strict=True):
        friction = [f"{number(v, s)} ± {number(s, s)}" for v, s in zip(*term, strict=True)]
        rows.append([period.name, str(period.episodes), f"{period.arm.arm_over_urdf:.3f}", *friction])
    first, last = terms[0], terms[-1]
    sigmas = np.abs(last[0] - first[0]) / np.maximum(np.hypot(first[1], last[1]), 1e-12)
    most = int(np.argmax(sigmas))
    from_to = " to ".join(number(value[most], std[most]) for value, std in (first, last))
    said = (
        f"From the first period to the last, Coulomb friction of {escape(joints[most])} went from {from_to} N m, "
        f"{sigmas[most]:.1f} standard deviations: the largest change of all joints. Drift of all torque "
        "constants together shows in what the arm weighs by its torques."
    )
    return [
        "<h2>How the arm drifts</h2>",
        f"<p>{said}</p>",
        framed(chart(panels, axis, "drift"), "Each period learnt anew from its empty hand; bands are 95 % intervals."),
        "<p>Coulomb friction with its standard deviation:</p>",
        table(header, rows, range(1, len(header)), labels=1),
        "<p class=small>The same with viscous friction and offsets: <code>drift.csv</code> beside this page.</p>",
    ]
