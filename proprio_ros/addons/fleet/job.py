"""One batch from sources to a folder with rows and a page."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from proprio_ros.addons.fleet.drift import (
    Drift,
    check_drift,
    drift_of,
    evenly,
    readable,
    write_drift,
)
from proprio_ros.addons.fleet.episodes import Episode, episodes_of
from proprio_ros.addons.fleet.listing import asked, named, path_of, span_of
from proprio_ros.addons.fleet.local import CHUNK, processors, run_local
from proprio_ros.addons.fleet.on_ray import ray_or_refuse, run_ray
from proprio_ros.addons.fleet.page import COLUMNS, odd, write_batch_page
from proprio_ros.addons.fleet.rows import FAILED, GRASP, Job, Row
from proprio_ros.addons.fleet.store import Store
from proprio_ros.errors import ConfigurationError, ProprioError, RecordingError, one_line
from proprio_ros.inputs.resources import check_page
from proprio_ros.pipeline.calibrate import calibrate_from_bags
from proprio_ros.pipeline.replay import replay, write_report
from proprio_ros.pipeline.request import Options, request_of
from proprio_ros.recordings.datasets import marked, open_data_set
from proprio_ros.recordings.drivers import columns_files, load_driver
from proprio_ros.recordings.motions import SHORTEST_S
from proprio_ros.recordings.text import is_text_recording
from proprio_ros.report import bars_figure, small_table
from proprio_ros.threads import pool_of
from proprio_ros.whole_files import real_path

# rows whose pages are written unless told otherwise; more are written by several processes
MOST_REPORTS = 12
MOST_SHOWN = 20  # rows that a terminal shows
MOST_EMPTY = 20  # episodes that calibrate an arm
# of each episode, where its first seconds are those of an empty hand
LEAST_FIRST_S = SHORTEST_S
LONGEST_FIRST_S = 86_400.0  # a day


@dataclass(frozen=True)
class Outcome:
    """What a batch did: episodes there are, those done before, verdicts, the folder, some rows, and how the arm drifts."""

    episodes: int
    before: int
    verdicts: dict[str, int]
    folder: Path
    first: Sequence[Row] = ()
    drift: Drift = field(default_factory=lambda: Drift(()))
    # that this computer could not do: without memory, space or a folder that can be written; they are asked again next time
    undone: int = 0

    def plot(self) -> Any:
        """How many rows have which verdict, as a matplotlib ``Figure``."""
        bars = [
            (name.replace("_", " "), float(count), name == "accepted")
            for name, count in self.verdicts.items()
        ]
        return bars_figure(f"{self.episodes} episodes", "rows", bars)

    def _repr_html_(self) -> str:
        rows = [(name.replace("_", " "), str(count)) for name, count in self.verdicts.items()]
        page = f"each with its reasons and what to do: {self.folder / 'batch.html'}"
        return small_table(f"{self.episodes} episodes", ("verdict", "rows"), rows, [page])


def run_batch(
    sources: Sequence[str | Path],
    job: Job,
    out: str | Path,
    tell: Callable[[str], Any],
    *,
    engine: str = "local",
    processes: int | None = None,
    address: str | None = None,
    chunk: int = CHUNK,
    bars: bool = False,
    command: str = "",
    empty: str | None = None,
    empty_first_s: float | None = None,
    reports: int = MOST_REPORTS,
) -> Outcome:
    """Do what is not done yet of all episodes of the sources.

    Args:
        sources: Bags, data sets, folders, globs.
        job: What is asked of each.
        out: Folder for rows; a job that was stopped goes on there.
        tell: Hears how far it is.
        engine: ``local`` or ``ray``.
        processes: Of the local engine; None: one per core.
        address: Of a Ray cluster.
        chunk: Episodes per file at most.
        bars: Whether Ray shows its progress bars.
        command: The command line, for the page.
        empty: Column of the data sets that is not zero where the hand is known to be empty: such episodes calibrate the arm.
        empty_first_s: In every episode the hand is known to be empty for so long [s]: these seconds calibrate the arm, and what is
            asked is what it holds later.
        reports: Rows whose own pages are written, unusual ones first.

    Raises:
        ConfigurationError, RobotError: An option is wrong; found before any episode is read.
    """
    _check_options(engine, job.options, empty, empty_first_s)
    job = replace(job, options=_located(job.options))
    episodes = episodes_of(sources)
    job = _of_known_units(job, episodes)
    empty_hand = EmptyHand.of(episodes, job.options, empty, empty_first_s)
    job = empty_hand.calibrating(job, Path(out), tell)
    using = Engine(engine, processes or processors(), address, chunk, bars)
    with closing(Store(Path(out), job)) as store:
        page = store.folder / "batch.html"
        check_page(page, "--out")
        if empty_hand.episodes:
            check_drift(store.folder / "drift.csv")
        missing = _missing(episodes, store)
        before = len(episodes) - len(missing)
        tell(f"{len(episodes)} episodes, {before} of them done before")
        if missing:
            using.run(missing, job, store, tell)
        undone = len(_missing(episodes, store))
        rows = store.read(COLUMNS)
        drift = empty_hand.drift(rows, tell)
        if drift:
            write_drift(drift, store.folder / "drift.csv")
        pages = _reports(store.folder, rows, job, reports, using.processes, tell)
        write_batch_page(rows, page, command, pages, drift, job.options)
    whole = sorted((row for row in rows if row["kind"] != GRASP), key=_place_in_order)
    verdicts = dict(sorted(Counter(row["verdict"] for row in whole).items()))
    first = whole[:MOST_SHOWN]
    return Outcome(
        episodes=len(episodes),
        before=before,
        verdicts=verdicts,
        folder=store.folder,
        first=first,
        drift=drift,
        undone=undone,
    )


def _missing(episodes: Sequence[Episode], store: Store) -> list[Episode]:
    """Those that have no rows yet."""
    done = store.done()
    return [each for each in episodes if (each.source, each.name) not in done]


def _place_in_order(row: Row) -> tuple[str, int, str, int]:
    return row["source"], row["episode_index"] or 0, row["episode"], row["segment"]


@dataclass(frozen=True)
class Engine:
    """What computes rows: processes of this machine, or a Ray cluster."""

    name: str
    processes: int  # of this machine
    address: str | None  # of a Ray cluster; None: the one that runs here
    chunk: int  # episodes per file at most
    bars: bool  # whether Ray shows its progress bars

    def run(
        self,
        missing: Sequence[Episode],
        job: Job,
        store: Store,
        tell: Callable[[str], Any],
    ) -> None:
        """Compute the rows of episodes into a store.

        Args:
            missing: The episodes.
            job: What is asked of each.
            store: Takes the rows.
            tell: Hears how far it is.
        """
        if self.name == "ray":
            run_ray(missing, job, store, self.address, tell, self.chunk, quiet=not self.bars)
        else:
            run_local(missing, job, store, self.processes, tell, self.chunk)


@dataclass(frozen=True)
class EmptyHand:
    """When the hand is known to be empty, which calibrates the arm; nothing where nobody says it."""

    option: str  # of the command line that says it, else ""
    episodes: Sequence[Episode]
    options: Options  # whose span is what of each episode is empty
    first_s: float | None = None

    @classmethod
    def of(
        cls,
        episodes: Sequence[Episode],
        options: Options,
        column: str | None,
        first_s: float | None,
    ) -> EmptyHand:
        """As the command line says it.

        Args:
            episodes: All of a batch.
            options: What is asked of each.
            column: Of data sets, not zero where the hand is empty.
            first_s: How long it is empty at the beginning of each episode [s].

        Raises:
            ConfigurationError: A data set lacks the column, or no episode is marked.
        """
        if column is not None:
            return cls("--empty", _marked(episodes, column), options)
        if first_s is not None:
            read = [
                each for each in episodes if not each.problem and not is_text_recording(each.path)
            ]
            at_first = replace(options, span=(0, round(1e9 * first_s)))
            return cls("--empty-first", read, at_first, first_s)
        return cls("", (), options)

    def calibrating(self, job: Job, out: Path, tell: Callable[[str], Any]) -> Job:
        """The job with the calibration that this makes; what is asked is what the hand holds later.

        Args:
            job: What is asked of each episode.
            out: Folder of the batch, which keeps the calibration.
            tell: Hears what is done.
        """
        if not self.option:
            return job
        options = self_calibrated(self.episodes, self.options, self.option, out, tell)
        job = replace(job, options=options)
        return job if self.first_s is None else replace(job, empty_first_s=self.first_s)

    def drift(self, rows: Sequence[Row], tell: Callable[[str], Any]) -> Drift:
        """How the arm drifts, by these episodes and when they were recorded."""
        if not self.episodes:
            return Drift(())
        stamps = {path_of(row): row["recorded_ns"] for row in rows if row["segment"] == 0}
        return drift_of(self.episodes, stamps, self.options, tell)


def _check_options(
    engine: str,
    options: Options,
    empty: str | None,
    empty_first_s: float | None,
) -> None:
    """What is wrong for every episode is said once; Raises as `run_batch` does."""
    if empty is None and empty_first_s is None:
        request_of(options)
    elif options.calibration is not None:
        option = "--empty" if empty is not None else "--empty-first"
        raise ConfigurationError(
            f"{option} makes a calibration, and --calibration names one: give one of them"
        )
    elif empty is not None and empty_first_s is not None:
        raise ConfigurationError(
            "--empty and --empty-first both say when the hand is empty: give one of them"
        )
    if empty_first_s is not None and not LEAST_FIRST_S <= empty_first_s <= LONGEST_FIRST_S:
        raise ConfigurationError(
            f"--empty-first {empty_first_s:g}: {LEAST_FIRST_S:g} s of motion with an empty hand are the least that say anything"
            f", and {LONGEST_FIRST_S:g} s the most"
        )
    if engine == "ray":
        ray_or_refuse()


def _of_known_units(job: Job, episodes: Sequence[Episode]) -> Job:
    """The job with the files that say what columns of tables are.

    Raises: ConfigurationError: nobody says what the numbers of a data set are in.
    """
    options = job.options
    driver = None if options.driver is None else load_driver(options.driver)
    if any(episode.index is not None for episode in episodes) and (
        driver is None or driver.columns is None
    ):
        raise ConfigurationError(
            "a data set does not say what its positions and its effort are in: give --driver lerobot (degrees), "
            "lerobot_openarm, lerobot_rad, or your own file with columns"
        )
    return replace(job, columns_files=columns_files(each.path for each in episodes))


def self_calibrated(
    empty: Sequence[Episode],
    options: Options,
    option: str,
    out: Path,
    tell: Callable[[str], Any],
) -> Options:
    """The options with a calibration by the episodes in which the hand is known to be empty; made once, then kept in the folder.

    Args:
        empty: Those episodes.
        options: How to read them; their span is what of each episode is empty.
        option: Of the command line, for messages.
        out: Folder of the batch, which keeps the calibration.
        tell: Hears with how many episodes it is made.

    Returns:
        The options with the calibration's file, for all of each episode.

    Raises:
        ConfigurationError: The episodes do not calibrate the arm, or the folder has a calibration that no job made.
    """
    path = real_path(out) / "calibration.yaml"
    if path.exists() and not path.with_name("job.json").exists():
        raise ConfigurationError(
            f"{option}: {path} is no calibration of a job here: move it away, or give it with --calibration"
        )
    if not path.exists():
        request = request_of(options)
        # evenly over all of them: an arm drifts
        chosen = [each for each in evenly(empty, MOST_EMPTY) if readable([each], 1, request)]
        if not chosen:
            raise ConfigurationError(
                f"{option}: no motion of an empty hand can be read; is anything moving there?"
            )
        what = (
            "episodes that are marked as empty"
            if options.span is None
            else "episodes, whose hand is empty at first"
        )
        tell(f"calibrating with {len(chosen)} of {len(empty)} {what}")
        path.parent.mkdir(parents=True, exist_ok=True)
        estimate = calibrate_from_bags(
            [each.path for each in chosen], {}, options, path, lambda words: None
        )
        if estimate.verdict.value != "accepted":
            why = next(iter(estimate.reasons), "the arm cannot be calibrated with them")
            raise ConfigurationError(f"{option}: {why}")
    return replace(options, calibration=str(path), robot=None, span=None)


def _marked(episodes: Sequence[Episode], column: str) -> list[Episode]:
    """The episodes of data sets whose column is nowhere zero; ConfigurationError: one lacks it, or no episode is marked."""
    found = []
    for episode in episodes:
        if episode.index is None:
            continue
        data = open_data_set(episode.source)
        if column not in data.features:
            there = ", ".join(data.features)
            raise ConfigurationError(
                f"--empty {column}: {data.folder} has no such column; it has: {there}"
            )
        with suppress(RecordingError):  # its row will say why
            if marked(data, episode.index, column):
                found.append(episode)
    if not found:
        raise ConfigurationError(
            f"--empty {column}: no episode of a data set has anything but zero there throughout"
        )
    return found


def _reports(
    folder: Path,
    rows: Sequence[Row],
    job: Job,
    most: int,
    processes: int,
    tell: Callable[[str], Any],
) -> dict[str, str]:
    """Write the pages of rows, unusual ones first; returns their places beside the page, by what `named` calls the row.

    A page that a stopped job left is of the same row and options: it stays.
    """
    rows = [row for row in rows if row["kind"] not in (GRASP, FAILED)]
    first = odd(rows)
    known = {named(row) for row in first}
    others = [row for row in rows if named(row) not in known]
    chosen = [*first, *others][:most]
    places = {named(row): _place_of_page(named(row)) for row in chosen}
    kept = {name for name, place in places.items() if (folder / place).exists()}
    missing = [row for row in chosen if named(row) not in kept]
    if missing:
        (folder / "reports").mkdir(exist_ok=True)
        tell(f"writing the pages of {len(missing)} rows")
    work = []
    for row in missing:
        name = named(row)
        options = replace(job.options, span=span_of(row))
        work.append((name, path_of(row), options, folder / places[name]))
    if len(work) > MOST_REPORTS:
        with pool_of(processes) as pool:
            problems = list(pool.map(_write_page, *zip(*work, strict=True)))
    else:
        problems = [_write_page(*one) for one in work]
    for (name, *_), why in zip(work, problems, strict=True):
        if why:
            tell(f"{name} has no page: {why}")
            places.pop(name, None)  # several rows of one recording have one page
    return places


def _place_of_page(name: str) -> str:
    """Of a row's page in the folder, by what `named` calls the row."""
    digest = hashlib.sha256(name.encode()).hexdigest()
    return f"reports/{digest[:16]}.html"


def _write_page(name: str, path: str, options: Options, place: Path) -> str:
    """The page of one row, or why it cannot be written: the recording may have gone since."""
    try:
        write_report(
            replay(path, options),
            place,
            command=f"proprio replay {name}{asked(options)}",
            sources=[path],
        )
    except ProprioError as error:
        return str(error)
    except Exception as error:  # whatever one row holds, all others are done
        return one_line(f"unexpected: {type(error).__name__}: {error}")
    return ""


def _located(options: Options) -> Options:
    """The same with absolute paths: another process may run elsewhere."""

    def absolute(name: str | Path | None) -> str | None:
        if name is None:
            return None
        return str(real_path(name)) if Path(name).is_file() else str(name)

    return replace(
        options,
        robot=absolute(options.robot),
        calibration=absolute(options.calibration),
        driver=absolute(options.driver),
    )
