"""How an arm changes over weeks: its friction and its torques, period by period, from what is known to be an empty hand."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime, timedelta, timezone
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from proprio_ros.addons.fleet.episodes import Episode, episodes_of
from proprio_ros.calibration_files.motions import MotionCalibration
from proprio_ros.errors import ConfigurationError, ProprioError, RecordingError
from proprio_ros.identification.regression.motion_fit import fit_empty
from proprio_ros.inputs.resources import write_in_one_step
from proprio_ros.pipeline.api import AnyPath, Listed, Paths, frame, options_of, read_arguments
from proprio_ros.pipeline.loading import bag_motion, followed
from proprio_ros.pipeline.request import Options, Request, request_of
from proprio_ros.quantity import Z95
from proprio_ros.recordings.motions import Motion
from proprio_ros.report import series_figure, small_table, words_figure
from proprio_ros.report.chart import Axis, Panel, Series, chart
from proprio_ros.report.html import framed, number, table, within
from proprio_ros.schema import header
from proprio_ros.threads import one_blas_thread

DAY_NS = 86_400_000_000_000
LONGEST_DAYS = 21  # recordings over so many days are told apart by day, over more by week
MOST_GROUPS = 12  # where no recording has a stamp, they make so many groups, in their order
# periods that are looked at, and episodes of each: evenly over all of them
MOST_PERIODS = 60
MOST_OF_PERIOD = 5

_TERMS = {"coulomb": "N_m", "viscous": "N_m_s_per_rad", "offset": "N_m"}
COLUMNS = (
    "period",
    "episodes",
    "arm_over_urdf",
    "joint",
    *(f"{k}_{u}{e}" for k, u in _TERMS.items() for e in ("", "_std")),
)
"""Of a table of drift; a mean and its standard deviation by turns."""


@dataclass(frozen=True)
class Period:
    """A day or a week, or some episodes in their order."""

    name: str  # its first date, or which episodes
    at: float  # days since the first period, or the number of its first episode
    episodes: int  # that it was learnt from
    arm: MotionCalibration  # what they say about the arm

    def term(self, kind: str) -> tuple[np.ndarray, np.ndarray]:
        """Values of a kind of friction by joint and their standard deviations, what runs of a period differ by counted."""
        rows = [self.arm.keys.index((kind, joint)) for joint in self.arm.joints]
        at = {"viscous": 0, "coulomb": 1, "offset": 2}[kind] * len(rows)
        spread = self.arm.friction_spread[at : at + len(rows)]
        return self.arm.values[rows], np.hypot(
            self.arm.std[rows],
            spread / np.sqrt(self.episodes),
        )


class Drift(Listed[Period]):
    """How an arm has changed, period by period, the first one first."""

    def as_json(self) -> dict[str, Any]:
        """A row per period and joint, as in ``drift.csv``, by the names of its columns."""
        return {
            **header("drift"),
            "rows": [dict(zip(COLUMNS, row, strict=True)) for row in self.rows()],
        }

    def rows(self) -> list[tuple[Any, ...]]:
        """Of each period and joint the entries of `COLUMNS`."""
        return [
            (each.name, each.episodes, each.arm.arm_over_urdf, joint, *map(float, values))
            for each in self
            for joint, *values in zip(
                each.arm.joints, *sum(map(each.term, _TERMS), ()), strict=True
            )
        ]

    def friction(self) -> list[list[str]]:
        """Titles, then words of each period: its name, episodes, the arm's weight over its URDF's, Coulomb friction by joint."""
        titles = (
            [
                [
                    "from",
                    "episodes",
                    "arm over URDF",
                    *(f"{joint} [N m]" for joint in self[0].arm.joints),
                ]
            ]
            if self
            else [[]]
        )
        return titles + [
            [period.name, str(period.episodes), f"{period.arm.arm_over_urdf:.3f}"]
            + [within(v, s) for v, s in zip(*period.term("coulomb"), strict=True)]
            for period in self
        ]

    def sentence(self) -> str:
        """Which joint's friction has changed most; of one period, or none, that there is nothing to compare."""
        if len(self) < 2:
            return "There are no two periods to compare: recordings of an empty hand in motion, from two days or more, would be."
        first, last = (self[place].term("coulomb") for place in (0, -1))
        spread = np.maximum(np.hypot(first[1], last[1]), 1e-12)
        sigmas = np.abs(last[0] - first[0]) / spread
        most = int(np.argmax(sigmas))
        from_to = " to ".join(number(value[most], std[most]) for value, std in (first, last))
        return (
            f"From the first period to the last, Coulomb friction of {self[0].arm.joints[most]} went from {from_to} N m, "
            f"{sigmas[most]:.1f} standard deviations: the largest change of all joints."
        )

    def to_frame(self) -> Any:
        """A table with one row per period and joint; needs pandas."""
        return frame(COLUMNS, self.rows())

    def plot(self) -> Any:
        """Coulomb friction of each joint over the periods with 95 % intervals; of none, why."""
        if not self:
            return words_figure(repr(self)[1:-1], [self.sentence()])
        values, std = (
            np.array([period.term("coulomb")[part] for period in self]).T for part in (0, 1)
        )
        lines = zip(
            self[0].arm.joints,
            values,
            Z95 * std,
            strict=True,
        )
        return series_figure(
            self.sentence(), [period.name for period in self], "Coulomb friction (N m)", list(lines)
        )

    def _repr_html_(self) -> str:
        titles, *rows = self.friction()
        return small_table(
            repr(self)[1:-1],
            titles,
            rows,
            [self.sentence()],
        )

    def __repr__(self) -> str:
        return f"<drift over {len(self)} periods>"


def drift(
    bags: Paths,
    *,
    robot: AnyPath | None = None,
    driver: AnyPath | None = None,
    state_topic: str | None = None,
    command_topic: str | None = None,
    effort_unit: str | None = None,
    effort_sign: int | str | Mapping[str, int] | None = None,
    settings: Mapping[str, Any] | None = None,
    progress: Callable[[str], Any] = lambda _: None,
) -> Drift:
    """How an arm changes over days and weeks, by recordings of its motion with an empty hand.

    What cannot be read is left out, and an error where that is all there is.

    Args:
        bags: Bag folders or files, text recordings, data sets, folders with any of them, and globs; one may stand alone.
        robot: Name, or robot file.
        driver: Profile of the driver that published, a name of ``config/drivers`` or a file; the next four win over it.
        state_topic: Of the joint states, where a bag has several.
        command_topic: Of the input, where it has an unusual name.
        effort_unit: What effort of the joint states means: ``N.m``, ``A``, ``mA`` or ``raw``.
        effort_sign: -1 where efforts are counted the other way round, of all joints or by joint.
        settings: As for ``--set``, by dotted key.
        progress: Hears how far it is, a sentence at a time.

    Returns:
        What each period says about the arm.

    Raises:
        ConfigurationError, RobotError, RecordingError: With one line that says what is wrong and what to do.
    """
    given = read_arguments(locals())
    options = options_of({**given, "facts": {}})
    request = request_of(options)
    episodes = episodes_of(given["bags"])
    read = [(each, motion) for each in episodes for motion in readable([each], 1, request)]
    stamps = {each.path: motion.begin_ns if each.index is None else None for each, motion in read}
    if not read:
        bag_motion(Path(episodes[0].path), request)  # says why
    return drift_of([each for each, _ in read], stamps, options, given["progress"])


def evenly(items: Sequence[Any], most: int) -> list[Any]:
    """At most so many of them, evenly over all."""
    return list(items[:: max(1, -(-len(items) // most))])


def periods_of(stamps: Sequence[int | None]) -> list[tuple[str, float, list[int]]]:
    """Name, place on the axis and numbers of the episodes of each period, by when each was recorded [ns]; None: not known."""
    known = [stamp for stamp in stamps if stamp is not None]
    if len(known) < len(stamps) or not stamps:
        return _groups_in_order(len(stamps))
    days = [stamp // DAY_NS for stamp in known]
    first = min(days)
    length = 1 if max(days) - first < LONGEST_DAYS else 7
    found: dict[int, list[int]] = {}
    for place, day in enumerate(days):
        found.setdefault((day - first) // length * length, []).append(place)
    begin = datetime.fromtimestamp(first * 86400, timezone.utc)
    periods = []
    for at in sorted(found):
        date = begin + timedelta(days=at)
        periods.append((f"{date:%Y-%m-%d}", float(at), found[at]))
    return periods


def _groups_in_order(count: int) -> list[tuple[str, float, list[int]]]:
    """As `periods_of`, of so many episodes of which nobody knows when they were recorded."""
    size = max(1, math.ceil(count / MOST_GROUPS))
    groups = []
    for begin in range(0, count, size):
        group = list(range(begin, min(begin + size, count)))
        groups.append((f"{group[0]} to {group[-1]}", float(begin), group))
    return groups


@one_blas_thread
def drift_of(
    episodes: Sequence[Episode],
    stamps: Mapping[str, int | None],
    options: Options,
    tell: Callable[[str], Any] = lambda _: None,
) -> Drift:
    """What each period says about the arm, by episodes with an empty hand; one without a usable motion is left out.

    Args:
        episodes: With an empty hand.
        stamps: When each was recorded, by its path [ns]; where any is known, episodes without are left out.
        options: How to read them; their span is what of each episode is empty.
        tell: Hears over how many periods, where there are several.

    Returns:
        The periods in their order.

    Raises:
        ConfigurationError, RobotError: An option is wrong.
    """
    request = request_of(replace(options, calibration=None))
    episodes = [episode for episode in episodes if stamps.get(episode.path)] or episodes
    found = []
    periods = evenly(
        periods_of([stamps.get(episode.path) for episode in episodes]),
        MOST_PERIODS,
    )
    if len(periods) > 1:
        tell(f"drift over {len(periods)} periods")
    for name, at, own in periods:
        motions = readable([episodes[place] for place in own], MOST_OF_PERIOD, request)
        with suppress(RecordingError):  # too little motion in all of them
            if motions:
                robot, motions = followed(request.robot, motions)
                found.append(
                    Period(
                        name,
                        at,
                        len(motions),
                        fit_empty(robot, motions),
                    )
                )
    return Drift(found)


def readable(
    episodes: Sequence[Episode],
    most: int,
    request: Request,
) -> list[Motion]:
    """Motions of at most so many episodes, evenly over those there are; what cannot be read is left out.

    Args:
        episodes: With an empty hand.
        most: How many to read.
        request: How to read them.
    """
    found = []
    for episode in evenly(episodes, most):
        with suppress(ProprioError):  # its row says why
            found.append(bag_motion(Path(episode.path), request))
    return found


def check_drift(path: Path) -> None:
    """Raises: ConfigurationError: a file is there that no batch wrote."""
    with suppress(FileNotFoundError), open(path, encoding="utf-8", errors="replace") as stream:
        first = stream.readline()
        if first and first.strip() != ",".join(COLUMNS):
            raise ConfigurationError(
                f"--out: {path} is no table of proprio: move it away, or name another folder"
            )


def write_drift(drift: Drift, path: Path) -> None:
    """All of it as a table; ConfigurationError: it cannot be written, or another file is there."""
    check_drift(path)
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(COLUMNS)
    for name, episodes, over, joint, *values in drift.rows():
        writer.writerow(
            [name, episodes, f"{over:.5f}", joint, *(f"{value:.6g}" for value in values)]
        )
    write_in_one_step(path, stream.getvalue(), "--out")


def drift_parts(periods: Drift) -> list[str]:
    """A table and a picture for the page; nothing where there is only one period."""
    if len(periods) < 2:
        return []
    dated = "-" in periods[0].name
    axis = Axis("since the first [days]", "days") if dated else Axis("episode", "")
    sentence = f"{escape(periods.sentence())} Drift of all torque constants together shows in what the arm weighs by its torques."
    titles, *rows = periods.friction()
    return [
        "<h2>How the arm drifts</h2>",
        f"<p>{sentence}</p>",
        framed(
            chart(_drift_panels(periods), axis, "drift"),
            "Each period learnt anew from its empty hand; bands are 95 % intervals.",
        ),
        "<p>Coulomb friction with its standard deviation:</p>",
        table(titles, rows, range(1, len(titles)), labels=1),
        "<p class=small>The same with viscous friction and offsets: <code>drift.csv</code> beside this page.</p>",
    ]


def _drift_panels(periods: Drift) -> list[Panel]:
    """What the arm weighs, and the Coulomb friction of each joint, over the periods."""
    at = np.array([period.at for period in periods])
    over = np.array([period.arm.arm_over_urdf for period in periods])
    weight = Series("arm", at, over, "measured", "dots")
    panels = [Panel("what the arm weighs by its torques, over its URDF", "", [weight], 90.0)]
    terms = [period.term("coulomb") for period in periods]
    for row, joint in enumerate(periods[0].arm.joints):
        value = np.array([values[row] for values, _ in terms])
        std = np.array([stds[row] for _, stds in terms])
        band = at, value - Z95 * std, value + Z95 * std
        series = Series(joint, at, value, "measured", "dots")
        panels.append(Panel(f"Coulomb friction of {joint} [N m]", "N m", [series], 90.0, band))
    return panels
