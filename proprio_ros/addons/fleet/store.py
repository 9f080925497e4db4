"""Rows on disk: parquet files below ``DIR/rows``, partitioned by source, each whole or not there.

A file has all rows of each of its episodes. What is done is read from the files, so a job that was killed goes on where it stopped,
whichever engine wrote; a file that a crash left damaged is deleted, and its episodes are done again.
"""

from __future__ import annotations

import fcntl
import hashlib
import itertools
import json
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

from proprio_ros.addons.fleet.episodes import Episode
from proprio_ros.addons.fleet.rows import COLUMNS, Job, Row
from proprio_ros.errors import ConfigurationError
from proprio_ros.inputs.resources import write_in_one_step
from proprio_ros.recordings.datasets import arrow
from proprio_ros.whole_files import in_one_step, real_path

PARTITION = "source_name"


def schema() -> Any:
    """Of the rows, with the partition's column."""
    pa = arrow()
    types = {
        "text": pa.string(),
        "texts": pa.list_(pa.string()),
        "integer": pa.int64(),
        "number": pa.float64(),
    }
    narrow = dict.fromkeys(("segment", "segments"), pa.int32())
    columns = [(name, narrow.get(name, types[kind])) for name, kind in COLUMNS.items()]
    return pa.schema(columns)


def table_of(rows: Sequence[Row]) -> Any:
    """Rows as a table of pyarrow."""
    return arrow().Table.from_pylist(list(rows), schema=schema())


def chunk_id(episodes: Sequence[Episode]) -> str:
    """A name that the same episodes always have."""
    paths = "\n".join(episode.path for episode in episodes)
    return hashlib.sha256(paths.encode()).hexdigest()[:16]


def chunks_of(
    episodes: Sequence[Episode],
    size: int,
) -> Iterator[list[Episode]]:
    """Episodes in groups of at most so many, each of one source."""
    for _, group in itertools.groupby(episodes, key=lambda episode: episode.source):
        own = list(group)
        yield from (own[at : at + size] for at in range(0, len(own), size))


class Store:
    """The rows of one job in a folder, which is made where it is not.

    Raises `ConfigurationError`: The folder cannot be made, holds the rows of another job, or another process writes to it.
    """

    def __init__(self, folder: Path, job: Job) -> None:
        self.folder = real_path(folder)
        self.rows = self.folder / "rows"
        arrow()
        try:
            self.rows.mkdir(parents=True, exist_ok=True)
            self._lock: IO[str] = open(self.folder / ".lock", "a")  # noqa: SIM115 (held as long as the store)
        except OSError as error:
            raise ConfigurationError(
                f"--out {folder}: {error.strerror}; name a folder that can be written"
            ) from error
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            busy = f"--out {folder}: another job writes there now; wait for it, or name another"
            raise ConfigurationError(busy) from error
        self._check(job)

    def _check(self, job: Job) -> None:
        path = self.folder / "job.json"
        mine = job.fingerprint()
        theirs = None
        if not path.exists():
            content = {"fingerprint": mine, "job": json.loads(job.as_text())}
            return write_in_one_step(path, json.dumps(content, indent=1) + "\n", "--out")
        with suppress(OSError, ValueError, KeyError, TypeError):
            theirs = json.loads(path.read_text())["fingerprint"]
        if theirs != mine:
            raise ConfigurationError(
                f"--out {self.folder}: holds rows of a job with other options, files or another version; name another folder, "
                "or delete it"
            )

    def close(self) -> None:
        """Let another process write."""
        self._lock.close()

    def files(self) -> list[Path]:
        """Those with rows, sorted."""
        return sorted(self.rows.glob(f"{PARTITION}=*/*.parquet"))

    def done(self) -> set[tuple[str, str]]:
        """Source and name of each episode whose rows are all there; what a crash left is removed.

        Rows that two files hold are kept in the first.

        Raises `ConfigurationError`: A file is among them that no job wrote.
        """
        for left in self.rows.glob(f"{PARTITION}=*/.part-*.tmp"):
            left.unlink(missing_ok=True)
        found: set[tuple[str, str]] = set()
        for file in self.files():
            episodes = _whole_episodes(file)
            if episodes is None or episodes & found:
                file.unlink()
            else:
                found |= episodes
        return found

    def write(self, rows: Sequence[Row], name: str) -> None:
        """Write the rows of a chunk, all of one source, in one step; a file of that name is replaced."""
        folder = self.rows / f"{PARTITION}={rows[0][PARTITION]}"
        folder.mkdir(exist_ok=True)
        write_rows(folder / f"part-{name}.parquet", rows)

    def read(self, columns: Sequence[str]) -> list[Row]:
        """These columns of all rows, in the order of the files."""
        from pyarrow import dataset

        pa = arrow()
        hive = dataset.partitioning(
            pa.schema([(PARTITION, pa.string())]),
            flavor="hive",
        )
        place = {"partitioning": hive, "partition_base_dir": str(self.rows)}
        whole = dataset.dataset(
            [str(file) for file in self.files()],
            schema=schema(),
            **place,
        )
        return list(whole.to_table(columns=[*columns]).to_pylist())


def write_rows(path: Path, rows: Sequence[Row]) -> None:
    """One file, whole or not there; the partition's column is in its folder's name."""
    table = table_of(rows).drop_columns([PARTITION])
    with in_one_step(path) as stream:
        arrow().parquet.write_table(table, stream)


def _foreign(file: Path) -> ConfigurationError:
    return ConfigurationError(
        f"--out: {file} is no file of rows of proprio: move it away, or name another folder"
    )


def _whole_episodes(file: Path) -> set[tuple[str, str]] | None:
    """Those of a file; None where a crash left it unreadable, or it lacks rows of one; ConfigurationError: no job wrote it."""
    try:
        table = (
            arrow()
            .parquet.ParquetFile(file)
            .read(columns=["source", "episode", "segment", "segments"])
        )
    except (OSError, arrow().ArrowException):
        with suppress(OSError), open(file, "rb") as stream:
            head = stream.read(4)
            if head and not b"PAR1".startswith(head):
                raise _foreign(file) from None
        return None
    if len(table.column_names) < 4:
        raise _foreign(file)
    seen: dict[tuple[str, str], list[int]] = {}
    wanted: dict[tuple[str, str], int] = {}
    for row in table.to_pylist():
        key = row["source"], row["episode"]
        seen.setdefault(key, []).append(row["segment"])
        wanted[key] = row["segments"]
    return (
        set(seen)
        if all(sorted(seen[key]) == list(range(count)) for key, count in wanted.items())
        else None
    )
