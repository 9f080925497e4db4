"""What there is to do: bags, tables, text recordings and episodes of data sets below what the user named."""

from __future__ import annotations

import glob
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from proprio_ros.errors import ConfigurationError, RecordingError, one_line
from proprio_ros.inputs.reading import path_problem
from proprio_ros.recordings.contents import is_recorded_file
from proprio_ros.recordings.datasets import is_data_set, open_data_set
from proprio_ros.recordings.tables import is_table
from proprio_ros.recordings.text import is_text_recording
from proprio_ros.whole_files import real_path

EXPORTED = "is called as {origin} beside it, and taken for the same recording in another form: name the file to have it answered"
"""Why a table has no answer of its own."""


@dataclass(frozen=True)
class Episode:
    """One recording; nothing of it has been read yet."""

    source: str  # the data set, or the folder that was named, as an absolute path
    name: str  # within the source; of a data set the index
    path: str  # what `proprio replay` takes
    problem: str = ""  # why it cannot be read, where listing it has shown that

    @property
    def index(self) -> int | None:
        """Of a data set's episode."""
        return int(self.name) if self.path == f"{self.source}#{self.name}" else None


def episodes_of(sources: Sequence[str | Path]) -> list[Episode]:
    """All episodes, each once, in the order of the sources and of names within.

    Sources are bags, tables, text recordings, data sets, folders with any of them, and globs.

    Raises `ConfigurationError`: A source is not there, or nothing is in any.
    """
    found: dict[str, Episode] = {}
    for place in (place for source in sources for place in _places(str(source))):
        for episode in _below(place):
            found.setdefault(episode.path, episode)
    if not found:
        named = ", ".join(map(str, sources))
        raise ConfigurationError(
            f"{named}: no bag and no LeRobot data set there; name folders that hold some"
        )
    return list(found.values())


def _places(source: str) -> list[Path]:
    problem = path_problem(source)
    if problem:
        raise ConfigurationError(f"{one_line(source, 100)}: {problem}")
    if os.path.exists(source):
        return [real_path(source)]
    matches = sorted(glob.glob(source, recursive=True))
    if not matches:
        raise ConfigurationError(f"{source}: no such file or folder, and no glob that fits any")
    return [real_path(match) for match in matches]


def _is_bag(path: Path) -> bool:
    return (path / "metadata.yaml").is_file() or is_text_recording(path)


def _below(place: Path) -> Iterator[Episode]:
    if place.is_file() or _is_bag(place):
        yield Episode(str(place.parent), place.name, str(place))
        return
    if is_data_set(place):
        yield from _of_data_set(place)
        return
    for folder, inner, files in os.walk(place):
        bags: list[str] = []
        for name in sorted(inner):
            path = Path(folder, name)
            if _is_bag(path):
                bags.append(name)
                yield Episode(
                    str(place),
                    path.relative_to(place).as_posix(),
                    str(path),
                )
            elif is_data_set(path):
                yield from _of_data_set(path)
            else:
                continue
            inner.remove(name)
        inner.sort()
        recorded = [name for name in sorted(files) if is_recorded_file(Path(folder, name))]
        origins = _origins(bags, recorded)
        for name in recorded:
            path = Path(folder, name)
            origin = origins.get(name, "")
            yield Episode(
                str(place),
                path.relative_to(place).as_posix(),
                str(path),
                origin and EXPORTED.format(origin=origin),
            )


def _origins(bags: Sequence[str], files: Sequence[str]) -> dict[str, str]:
    """Of tables beside another recording of the same name, what that is called: they are its exports, and the same once more.

    Args:
        bags: Names of bags that are folders.
        files: Names of recordings that are files, in one folder.
    """
    first = {name: name for name in bags}
    tables = [name for name in files if is_table(name)]
    for name in [name for name in files if name not in tables] + tables:
        first.setdefault(_stem(name), name)
    own = {name: first[_stem(name)] for name in tables}
    return {name: origin for name, origin in own.items() if origin != name}


def _stem(name: str) -> str:
    """Of a file's name, without what says of which kind it is."""
    return re.sub(r"(\.(mcap|db3|bag|zstd|csv|tsv|txt|parquet))+$", "", name, flags=re.I)


def _of_data_set(folder: Path) -> Iterator[Episode]:
    try:
        data = open_data_set(folder)
    except RecordingError as error:
        yield Episode(str(folder), "meta", str(folder), str(error))
        return
    for index in data.episodes:
        yield Episode(str(folder), str(index), f"{folder}#{index}")
