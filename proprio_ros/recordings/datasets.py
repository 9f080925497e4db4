"""LeRobot data sets <-> `Recording`: parquet files with ``meta/info.json``, versions 2.1 and 3.

One episode is named ``FOLDER#INDEX`` wherever a bag may be named. Only the columns and row groups of that episode are read. What a
column means (degrees or radians, what the effort is) no data set says: the driver's profile does. Layout: huggingface/lerobot,
``src/lerobot/datasets`` (``utils.py``, ``io_utils.py``, ``dataset_writer.py``); of 2.1 the same files before version 3.

pyarrow is in the extra ``batch`` and is imported only here and where rows are written. What cannot be read is a `RecordingError`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from proprio_ros import records
from proprio_ros.errors import ConfigurationError, ProprioError, RecordingError, one_line
from proprio_ros.inputs.reading import json_of, path_problem, text_of
from proprio_ros.quantity import POSITIONS
from proprio_ros.recordings.arrivals import of_bursts
from proprio_ros.recordings.clock_faults import in_order, is_counted
from proprio_ros.recordings.joint_names import fitted_names
from proprio_ros.recordings.read_options import Columns, ReadOptions
from proprio_ros.recordings.sign_bits import without_sign_bits
from proprio_ros.version import to_install

VERSIONS = ("v2.0", "v2.1", "v3.")
"""Beginnings of ``codebase_version`` that are read; 2.0 differs from 2.1 in its statistics alone."""
LONGEST_S = 4e9  # no clock shows more, one that counts since 1970 among them
# columns that say when a frame was; the first that is there counts
CLOCK = ("timestamp", "frame_index")
FRAMES, BUFFER = 8192, 1 << 20
"""Frames, and bytes of a column, that are held at once where a part of an episode is read."""
OTHER_UNIT = 5.0
"""Frames that take so many times as long as their data set says, or so few, are not stamped in seconds; no loop is as slow."""
_EPISODE = re.compile(r"(?s)(?P<folder>.+)#(?P<index>\d{1,9})$")
_SUFFIX = re.compile(r"\.(pos|vel|torque|effort|current|load)$")
_LONGEST_META = 64_000_000


class Episode(NamedTuple):
    """Length of an episode in frames, and its file below the data set's folder."""

    length: int
    file: str


@dataclass(frozen=True)
class DataSet:
    """What ``meta/`` says."""

    folder: Path
    version: str  # of its layout, as it states it
    rate_hz: float  # frames per second
    features: Mapping[str, Mapping[str, Any]]  # by column: type, shape, names
    episodes: Mapping[int, Episode]  # in the order of their indices

    def names(self, column: str) -> tuple[str, ...]:
        """Of the entries of a column that is a vector; empty where it is not there or names none."""
        names = self.features.get(column, {}).get("names") or ()
        if isinstance(names, Mapping):  # {"motors": [...]}, as older tools write
            names = next(
                (value for value in names.values() if isinstance(value, list)),
                (),
            )
        return tuple(str(name) for name in names)


def arrow() -> Any:
    """The module pyarrow. Raises `ConfigurationError`: It is not installed."""
    try:
        import pyarrow
        import pyarrow.compute
        import pyarrow.parquet
    except ImportError as error:
        raise ConfigurationError(
            f"{error.name} is missing, which reads and writes parquet: {to_install('batch')}"
        ) from error
    return pyarrow


def episode_of(path: str | Path) -> tuple[Path, int] | None:
    """Folder and index of a path that names one episode of a data set; None where it names something else."""
    found = _EPISODE.match(str(path))
    if found is None or Path(path).exists():
        return None
    return Path(found["folder"]), int(found["index"])


def is_data_set(path: str | Path) -> bool:
    """Whether a path is the folder of a LeRobot data set."""
    return not path_problem(path) and (Path(path) / "meta" / "info.json").is_file()


def open_data_set(folder: str | Path) -> DataSet:
    """Read what a data set says about itself, again only where that changed; refuses what is none, or of another version."""
    folder = Path(folder)
    info = folder / "meta" / "info.json"
    problem = path_problem(folder)
    if problem:
        raise RecordingError(f"{one_line(str(folder), 100)}: {problem}")
    if not info.is_file():
        raise RecordingError("not a LeRobot data set: there is no meta/info.json in it", folder)
    return _opened(folder, info.stat().st_mtime_ns)


@lru_cache(maxsize=4)
def _opened(folder: Path, _changed_ns: int) -> DataSet:
    with _readable(folder):
        info = json_of(text_of(folder / "meta" / "info.json", RecordingError))
        version = str(info["codebase_version"])
        if not version.startswith(VERSIONS):
            raise RecordingError(
                f"a LeRobot data set of version {version}; 2.1 and 3 are read: convert it with lerobot",
                folder,
            )
        episodes = dict(
            (_episodes_3 if version.startswith("v3.") else _episodes_2)(
                folder,
                info,
            )
        )
        features = {str(key): value for key, value in info["features"].items()}
        return DataSet(
            folder, version, float(info["fps"]), features, dict(sorted(episodes.items()))
        )


def _episodes_2(
    folder: Path,
    info: Mapping[str, Any],
) -> Iterator[tuple[int, Episode]]:
    pattern = str(info["data_path"])
    each = int(info.get("chunks_size", 1000))
    lines = text_of(folder / "meta" / "episodes.jsonl", RecordingError, _LONGEST_META).splitlines()
    for row in (json_of(line) for line in lines if line.strip()):
        index = int(row["episode_index"])
        yield (
            index,
            Episode(
                int(row["length"]), pattern.format(episode_chunk=index // each, episode_index=index)
            ),
        )


def _episodes_3(
    folder: Path,
    info: Mapping[str, Any],
) -> Iterator[tuple[int, Episode]]:
    pattern = str(info["data_path"])
    columns = ["episode_index", "length", "data/chunk_index", "data/file_index"]
    for file in sorted((folder / "meta" / "episodes").glob("*/*.parquet")):
        table = arrow().parquet.ParquetFile(file).read(columns=columns).to_pydict()
        for index, length, chunk, number in zip(
            *(table[column] for column in columns), strict=True
        ):
            yield (
                int(index),
                Episode(int(length), pattern.format(chunk_index=chunk, file_index=number)),
            )


@contextmanager
def _readable(what: object) -> Iterator[None]:
    """Whatever pyarrow, JSON and missing keys raise becomes one line."""
    try:
        yield
    except ProprioError:
        raise
    except Exception as error:
        reason = " ".join(str(error).split())[:150] or type(error).__name__
        raise RecordingError(
            f"not readable as a LeRobot data set ({type(error).__name__}: {reason}); download or convert it again",
            what,
        ) from error


@lru_cache(maxsize=4)
def _groups(
    file: Path,
    _changed_ns: int,
) -> tuple[Any, records.FloatArray, records.FloatArray]:
    """The open file, and lowest and highest episode of each of its row groups."""
    opened = arrow().parquet.ParquetFile(file)
    leaf = next(
        n
        for n in range(opened.metadata.num_columns)
        if opened.schema.column(n).path == "episode_index"
    )
    low = np.full(opened.num_row_groups, -np.inf)
    high = np.full(opened.num_row_groups, np.inf)
    for group in range(opened.num_row_groups):
        known = opened.metadata.row_group(group).column(leaf).statistics
        if known is not None and known.has_min_max:
            low[group], high[group] = known.min, known.max
    return opened, low, high


def read_columns(
    data: DataSet,
    index: int,
    columns: Sequence[str],
    span: records.Span | None = None,
) -> dict[str, records.FloatArray]:
    """Columns of one episode.

    Args:
        data: The data set.
        index: Of the episode.
        columns: Names; to read a part, `CLOCK` must be among them.
        span: The part that is read, since the first frame [ns]; None: all.

    Returns:
        Numbers by column, shape (T,) or (T, K); a column that the data set lacks is left out.

    Raises:
        RecordingError: There is no such episode, or its file cannot be read.
    """
    name = f"{data.folder}#{index}"
    episode = data.episodes.get(index)
    if episode is None:
        raise RecordingError(f"no such episode; the data set has {len(data.episodes)}", name)
    file = data.folder / episode.file
    with _readable(name):
        if not file.is_file():
            raise RecordingError(f"{episode.file} is missing: download the data set again", name)
        opened, low, high = _groups(file, file.stat().st_mtime_ns)
        there = [column for column in columns if column in opened.schema_arrow.names]
        groups = np.flatnonzero((low <= index) & (high >= index)).tolist()
        if span is None:
            table = opened.read_row_groups(
                groups, columns=[*there, "episode_index"], use_threads=False
            )
            found, count = _of_episode(table, index, there)
        else:
            found, count = _columns_within(groups, there, data, index, span)
            if not all(map(len, found.values())):
                raise RecordingError(
                    f"no frames in this part of the recording; it has {count} in all", name
                )
    if count != episode.length:
        raise RecordingError(
            f"{episode.length} frames by meta, {count} in {episode.file}: the data set is not whole",
            name,
        )
    return found


def _of_episode(
    table: Any, index: int, columns: Sequence[str]
) -> tuple[dict[str, records.FloatArray], int]:
    """Columns of the rows that belong to an episode, and how many these are."""
    table = table.filter(
        arrow().compute.equal(
            table["episode_index"],
            index,
        )
    )
    return {column: _numbers(table[column], len(table)) for column in columns}, len(
        table,
    )


def _columns_within(
    groups: Sequence[int],
    columns: Sequence[str],
    data: DataSet,
    index: int,
    span: records.Span,
) -> tuple[dict[str, records.FloatArray], int]:
    """Columns of a part of an episode, read some frames at a time; and how many frames the whole episode has."""
    parts: dict[str, list[records.FloatArray]] = {column: [] for column in columns}
    first: dict[str, records.FloatArray] = {}
    count = 0
    # an episode is one row group: without a buffer all of its columns would be read first
    opened = arrow().parquet.ParquetFile(
        data.folder / data.episodes[index].file, buffer_size=BUFFER
    )
    batches = opened.iter_batches(
        FRAMES, row_groups=groups, columns=[*columns, "episode_index"], use_threads=False
    )
    for table in batches:
        read, rows = _of_episode(table, index, columns)
        if not rows:
            continue
        first = first or _first(read)
        times_ns = _times(data, read, first.get("timestamp"), count)
        end_ns = np.inf if span[1] is None else span[1]
        within = (times_ns >= span[0]) & (times_ns < end_ns)
        for column in columns:
            parts[column].append(read[column][within])
        count += rows
    return {
        column: np.concatenate(found) if found else np.empty(0) for column, found in parts.items()
    }, count


def parts_of_episode(
    folder: str | Path,
    index: int,
    most: int,
) -> list[records.Span]:
    """Parts of an episode with about as many frames each, which leave no gap.

    Args:
        folder: Of the data set.
        index: Of the episode.
        most: Frames of a part.

    Returns:
        From when to when each part is, since the first frame [ns].

    Raises:
        RecordingError: The data set cannot be read.
    """
    data = open_data_set(folder)
    count = -(-data.episodes[index].length // most) if index in data.episodes else 1
    if count < 2:
        return [(0, None)]
    times_ns = _times(
        data,
        read_columns(data, index, CLOCK, (0, None)),
    )
    begins = sorted({int(time_ns) for time_ns in times_ns[:: -(-len(times_ns) // count)]})
    return list(
        zip(
            begins,
            [*begins[1:], int(times_ns.max()) + 1],
            strict=True,
        )
    )


def _numbers(column: Any, count: int) -> records.FloatArray:
    """A column of numbers or of vectors that are all alike."""
    whole = column.combine_chunks() if hasattr(column, "combine_chunks") else column
    if not count:
        return np.empty(0)
    types = arrow().types
    if any(
        is_one(whole.type)
        for is_one in (types.is_list, types.is_fixed_size_list, types.is_large_list)
    ):
        values = whole.flatten().to_numpy(zero_copy_only=False).astype(np.float64)
        if (
            len(values) % count
            or len(set(arrow().compute.list_value_length(whole).to_pylist())) != 1
        ):
            raise RecordingError("the vectors of a column are of different lengths")
        return values.reshape(count, -1)
    return whole.to_numpy(zero_copy_only=False).astype(np.float64)


@dataclass(frozen=True)
class _Frames:
    """Frames of an episode in SI units, under the robot's names."""

    called: str  # of the episode, for sentences
    times_ns: records.TimeArray  # since the first frame [ns], (T,)
    timed: records.BoolArray  # which frames have a time of their own, (T,)
    names: tuple[str, ...]  # of the joints, (J,)
    position: records.FloatArray  # [rad or m], (T, J)
    effort: records.FloatArray  # in its own unit, NaN where there is none, (T, J)
    goals: Mapping[str, records.FloatArray]  # where joints were sent [rad or m], (T,) each
    notes: tuple[str, ...] = ()


def read_episode(
    folder: str | Path,
    index: int,
    options: ReadOptions,
) -> records.Recording:
    """One episode as a recording; times count from its first frame, or that of the part that is read.

    Args:
        folder: Of the data set.
        index: Of the episode.
        options: How it is read; its columns must be stated.

    Returns:
        Joint states, goals as signals of a drive, and measured efforts as the input where their unit is stated.

    Raises:
        RecordingError: It cannot be read, or lacks positions.
    """
    columns = options.columns
    assert columns is not None
    data = open_data_set(folder)
    called = f"{Path(folder).name}#{index}"
    wanted = [columns.position, columns.effort, columns.goal, *CLOCK]
    read = read_columns(data, index, wanted, options.span)
    frames = _frames(data, read, options, called)
    times_s = 1e-9 * frames.times_ns.astype(np.float64)
    decoded: list[str] = []
    without_sign_bits(times_s, frames.position, frames.names, frames.names, decoded)
    times_ns = frames.times_ns
    steps: tuple[str, ...] = ()
    if frames.timed.all():
        times_ns, steps = _by_the_clock(data, times_ns, frames.position, called)
    whole, left_out = _usable(times_ns, frames, columns)
    times_ns = times_ns[whole]
    record = options.effort.record(
        times_ns, frames.names, frames.position[whole], None, frames.effort[whole]
    )
    return records.Recording(
        called,
        record,
        options.effort.measured(record),
        (*frames.notes, *steps, *left_out, *decoded),
        signals=_goal_signals(times_s, times_ns, frames, whole),
    )


def _frames(
    data: DataSet, read: Mapping[str, records.FloatArray], options: ReadOptions, called: str
) -> _Frames:
    """What was read, by column, as frames."""
    columns = options.columns
    assert columns is not None
    if columns.position not in read:
        raise RecordingError(
            f"no column {columns.position}; there are: {', '.join(data.features)}", called
        )
    states = _by_name(data, columns.position, read[columns.position], called)
    position = _ending(states, "", "pos")
    measured = _ending(states, "torque", "effort", "current")
    if columns.effort in read:
        measured = _effort(
            data,
            columns.effort,
            read[columns.effort],
            tuple(position),
            called,
        )
    goals: dict[str, records.FloatArray] = {}
    if columns.goal in read:
        goals = _ending(
            _by_name(data, columns.goal, read[columns.goal], called),
            "",
            "pos",
        )
    times_ns = _times(data, read)
    fitted = fitted_names(Path(called), options.conventions.renamed(tuple(position)), options)
    options = fitted.options
    joints = _in_si(position, columns, options)
    if len(joints) != len(position):
        raise RecordingError(
            f"two joints of {columns.position} would have one name; see joint_names of --driver",
            called,
        )
    nothing = np.full(len(times_ns), np.nan)
    return _Frames(
        called,
        times_ns,
        _timed(read, len(times_ns)),
        tuple(joints),
        np.column_stack(list(joints.values())),
        np.column_stack([measured.get(name, nothing) for name in position]),
        _in_si(goals, columns, options),
        fitted.notes,
    )


def _in_si(
    by_name: Mapping[str, records.FloatArray], columns: Columns, options: ReadOptions
) -> dict[str, records.FloatArray]:
    """Positions in rad or m, under the robot's names."""
    names = options.conventions.names
    scale = POSITIONS[columns.position_unit or "rad"].in_si
    found = {}
    for name, values in by_name.items():
        bare = name.removeprefix(options.conventions.prefix)
        ours = names.get(bare, bare)
        if name in columns.percent:
            low, high = options.limits.get(ours, (0.0, 1.0))
            found[ours] = low + 0.01 * (high - low) * values
        else:
            found[ours] = scale * values
    return found


def _goal_signals(
    times_s: records.FloatArray,
    times_ns: records.TimeArray,
    frames: _Frames,
    whole: records.BoolArray,
) -> records.DriveSignals | None:
    """Where joints were sent, at all frames [s] and at those that are used [ns]; None where nothing says it."""
    if not frames.goals:
        return None
    names = tuple(frames.goals)
    goals = np.column_stack(list(frames.goals.values()))  # (T, G)
    without_sign_bits(times_s, goals, names, names, [])
    nothing = np.empty(0, np.int64)
    return records.DriveSignals(
        times_ns,
        names,
        goals[whole],
        nothing,
        np.empty(0),
    )


def _by_the_clock(
    data: DataSet, times_ns: records.TimeArray, position: records.FloatArray, called: str
) -> tuple[records.TimeArray, tuple[str, ...]]:
    """Times of frames that go on evenly [ns], shape (T,), and a note on what was done about them.

    Raises:
        RecordingError: They are no times, or when frames were taken nobody knows.
    """
    if len(times_ns) < records.MIN_SAMPLES:
        return times_ns, ()
    times_ns, notes = in_order(called, times_ns, position)
    arrivals = of_bursts(times_ns) if np.all(np.diff(times_ns) >= 0) else None
    if arrivals is not None:
        bursts = f"{called}: {arrivals.moved} of {len(times_ns)} frames come in bursts, stamped when they arrived"
        if not arrivals.steady:
            raise RecordingError(f"{bursts}, at no steady rate: when each was taken nobody knows")
        times_ns = arrivals.times_ns
        rate = f"{1.0 / arrivals.period_s:.0f} Hz"
        notes = (*notes, f"{bursts}; they are read as evenly spaced, at {rate}.")
    period_s = 1e-9 * float(np.median(np.diff(times_ns)))
    frames = period_s * data.rate_hz
    if frames > OTHER_UNIT or 0.0 < frames < 1.0 / OTHER_UNIT:
        counted = is_counted(np.diff(times_ns))
        what = "holds row numbers" if counted else f"goes by {period_s:.3g} s a frame"
        raise RecordingError(
            f"timestamp {what}, and meta/info.json has {data.rate_hz:g} frames a second: it is not in seconds",
            called,
        )
    return times_ns, notes


def _usable(
    times_ns: records.TimeArray, frames: _Frames, columns: Columns
) -> tuple[records.BoolArray, tuple[str, ...]]:
    """Which frames have a position and a time of their own, shape (T,); a note where some have not."""
    position = frames.position
    is_new = np.diff(times_ns, prepend=times_ns[:1] - 1) > 0
    whole: records.BoolArray = np.isfinite(position).all(axis=1) & is_new & frames.timed
    count = int(whole.sum())
    left_out = int((~whole).sum())
    if count < records.MIN_SAMPLES:
        raise RecordingError(
            f"only {count} frames are usable, at least {records.MIN_SAMPLES} are needed",
            frames.called,
        )
    furthest = np.abs(position[whole]).max()
    if furthest > records.IMPLAUSIBLE_POSITION:
        raise RecordingError(
            f"{columns.position} reaches {furthest:.4g}, which is no angle in rad nor a length in m: "
            "is the unit that of --driver (position_unit)?",
            frames.called,
        )
    note = f"{left_out} of {len(whole)} frames have no finite position or no new time; they were left out."
    return whole, (note,) if left_out else ()


def _ending(
    by_name: Mapping[str, records.FloatArray], *endings: str
) -> dict[str, records.FloatArray]:
    """The entries whose names have one of these endings, by joint."""
    of_each = {name: "".join(_SUFFIX.findall(name)) for name in by_name}
    return {
        _SUFFIX.sub("", name): column
        for name, column in by_name.items()
        if of_each[name] in endings
    }


def _by_name(
    data: DataSet, column: str, values: records.FloatArray, called: str
) -> dict[str, records.FloatArray]:
    """The entries of a vector column by their names."""
    names = data.names(column)
    table = values.reshape(len(values), -1)
    if len(names) != table.shape[1]:
        raise RecordingError(
            f"{column} has {table.shape[1]} entries and meta/info.json names {len(names)} of them",
            called,
        )
    return dict(zip(names, table.T, strict=True))


def _effort(
    data: DataSet,
    column: str,
    values: records.FloatArray,
    joints: tuple[str, ...],
    called: str,
) -> dict[str, records.FloatArray]:
    """Measured effort by joint, in the data set's names."""
    if not data.names(column) and values.reshape(len(values), -1).shape[1] == len(joints):
        return dict(zip(joints, values.T, strict=True))
    return {
        _SUFFIX.sub("", name): column
        for name, column in _by_name(data, column, values, called).items()
    }


def _times(
    data: DataSet,
    read: Mapping[str, records.FloatArray],
    first_s: records.FloatArray | None = None,
    before: int = 0,
) -> records.TimeArray:
    """Of frames, since the first [ns]; where that is not among them, by its timestamp or how many frames are before them."""
    if "timestamp" in read:
        stamps_s = read["timestamp"]
        known = _timed(read, len(stamps_s))
        if not known.any():
            raise RecordingError("no frame has a finite timestamp", data.folder)
        first = stamps_s[known][0] if first_s is None else first_s[0]
        # a frame without a time has that of the one before it, and so none of its own
        last = np.maximum.accumulate(
            np.where(
                known,
                np.arange(len(known)),
                -1,
            )
        )
        since_s = np.where(
            last >= 0,
            stamps_s[last] - first,
            -1e-9,
        )
        return np.asarray(
            np.rint(1e9 * since_s),
            dtype=np.int64,
        )
    count = len(next(iter(read.values())))
    frames = read.get(
        "frame_index",
        before + np.arange(count, dtype=np.float64),
    )
    return np.asarray(
        np.rint(1e9 * frames / data.rate_hz),
        dtype=np.int64,
    )


def _first(read: Mapping[str, records.FloatArray]) -> dict[str, records.FloatArray]:
    """The clock of the first frame that has a time; nothing where none has."""
    timed = _timed(read, 1)
    at = int(np.argmax(timed))
    if not timed[at]:
        return {}
    return {column: read[column][at : at + 1].copy() for column in CLOCK if column in read}


def _timed(
    read: Mapping[str, records.FloatArray],
    count: int,
) -> records.BoolArray:
    """Which of so many frames have a time; all where their numbers are the clock, shape (T,)."""
    if "timestamp" not in read:
        return np.ones(count, dtype=bool)
    return np.asarray(np.abs(read["timestamp"]) < LONGEST_S)


def marked(data: DataSet, index: int, column: str) -> bool:
    """Whether every frame of an episode has something other than zero in a column.

    Args:
        data: The data set.
        index: Of the episode.
        column: Its name.

    Returns:
        Whether it has; an episode without frames has not.

    Raises:
        RecordingError: There is no such column.
    """
    read = read_columns(data, index, [column])
    if column not in read:
        raise RecordingError(
            f"{data.folder}#{index}: no column {column}; there are: {', '.join(data.features)}"
        )
    return bool(len(read[column]) and np.all(read[column] != 0.0))
