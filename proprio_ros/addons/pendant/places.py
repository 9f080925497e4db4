"""Where recordings lie: below the folder in which the pendant was started, and below that of the nodes; no other is looked into.

What a link points to counts, not where the link is.
"""

from __future__ import annotations

import os
import re
from collections.abc import AsyncIterator
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote

from proprio_ros.errors import ConfigurationError, one_line
from proprio_ros.inputs.reading import path_problem
from proprio_ros.recordings.contents import is_recorded_file
from proprio_ros.recordings.datasets import is_data_set, open_data_set
from proprio_ros.recordings.text import is_text_recording

UPLOADS = "uploads"
MOST_BYTES = 2**30
"""Of one file that is uploaded."""
MOST_KEPT = 8 * 2**30
"""Bytes of all of them."""
MOST_ENTRIES = 500
MOST_FILES = 2000
"""Of a recording whose links are looked at."""
TAKEN = (
    ".mcap",
    ".db3",
    ".mcap.zstd",
    ".db3.zstd",
    ".csv",
    ".parquet",
)
DESCRIPTION = ".urdf"
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9 _.+-]{0,119}")
_EPISODE = re.compile(r"#\d{1,9}$")


class Entry(NamedTuple):
    """What is in a folder."""

    name: str
    path: Path
    kind: (
        str  # ``folder``, ``data set``, or of a recording: ``bag``, ``file``, ``text``, ``episode``
    )

    @property
    def opens(self) -> bool:
        """Whether one looks into it; a recording is chosen instead."""
        return self.kind in ("folder", "data set")


class Places:
    """The folders that may be looked into.

    Args:
        begun: In which the pendant was started.
        data: Where the nodes keep what they record.
    """

    def __init__(self, begun: Path, data: Path) -> None:
        self.begun = begun.resolve()
        self.data = data.resolve()
        self._receiving = False

    @property
    def roots(self) -> dict[str, Path]:
        """By what they are called."""
        return {
            "Started in": self.begun,
            "Data directory": self.data,
        }

    @property
    def uploads(self) -> Path:
        """Of what was uploaded."""
        return self.data / UPLOADS

    @property
    def robots(self) -> Path:
        """Of files of arms."""
        return self.data / "robots"

    def address(self, page: Path | None) -> str:
        """Where a browser finds a page that an answer has; empty: it is not there."""
        for number, root in enumerate(self.roots.values()):
            if page is not None and page.is_relative_to(root) and page.is_file():
                return f"/kept/{number}/{quote(str(page.relative_to(root)))}"
        return ""

    def inside(self, text: str | Path) -> Path:
        """What a text names, links followed. Raises `ConfigurationError`: It is not below one of the folders."""
        problem = path_problem(text)
        named = one_line(str(text), 80)
        if problem:
            raise ConfigurationError(f"{named}: {problem}")
        try:
            path = Path(text).resolve()
        except (OSError, RuntimeError) as error:
            raise ConfigurationError(f"{named}: its links lead nowhere") from error
        if not any(path.is_relative_to(root) for root in self.roots.values()):
            raise ConfigurationError(
                f"{named}: outside of the folders that are shown here; start the pendant in the folder of your recordings"
            )
        return path

    def recording(self, text: str | Path) -> Path:
        """The same of a recording in which no link leads elsewhere. Raises `ConfigurationError`: It is not there, or one does."""
        path = self.inside(text)
        folder = Path(_EPISODE.sub("", str(path)))
        if not folder.exists():
            raise ConfigurationError(
                f"{one_line(str(path), 80)}: is not there any more; choose another"
            )
        seen = 0
        for where, inner, files in os.walk(folder):
            for name in (*inner, *files):
                seen += 1
                place = Path(where, name)
                if place.is_symlink():
                    self.inside(place)
            if seen > MOST_FILES:
                break
        return path

    def entries(self, folder: Path) -> list[Entry]:
        """What a folder holds that can be opened or chosen. Raises `ConfigurationError`, `RecordingError`: It cannot be read."""
        folder = self.inside(folder)
        if is_data_set(folder):
            numbers = list(open_data_set(folder).episodes)[:MOST_ENTRIES]
            return [
                Entry(
                    f"episode {number}",
                    Path(f"{folder}#{number}"),
                    "episode",
                )
                for number in numbers
            ]
        try:
            names = sorted(os.listdir(folder))
        except OSError as error:
            raise ConfigurationError(
                f"{one_line(str(folder), 80)}: {error.strerror}; choose another folder"
            ) from error
        found = map(self._entry, [folder / name for name in names])
        return [entry for entry in found if entry is not None][:MOST_ENTRIES]

    def _entry(self, path: Path) -> Entry | None:
        if path.name.startswith("."):
            return None
        try:
            self.inside(path)
            kind = _kind(path)
        except (ConfigurationError, OSError):
            return None
        return Entry(path.name, path, kind) if kind else None

    async def receive(self, name: str, length: int, chunks: AsyncIterator[bytes]) -> Path:
        """Keep a file that a browser sends; one at a time.

        Args:
            name: Of the file there.
            length: That is announced [bytes].
            chunks: What comes.

        Returns:
            Where it is kept.

        Raises:
            ConfigurationError: It is not wanted; nothing of it is kept.
        """
        target = self._wanted(name, length)
        part = target.with_name(f".{target.name}.part")
        self._receiving = True
        try:
            await _write(part, length, chunks)
            if not part.stat().st_size:
                raise ConfigurationError(f"{name}: is empty")
            part.rename(target)
        except OSError as error:
            raise ConfigurationError(f"{name}: cannot be kept ({error.strerror})") from error
        finally:
            self._receiving = False
            part.unlink(missing_ok=True)
        if target.suffix.lower() != DESCRIPTION and not is_recorded_file(target):
            target.unlink()
            raise ConfigurationError(f"{name}: no columns of times and joint positions in it")
        return target

    def _wanted(self, name: str, length: int) -> Path:
        shown = one_line(name, 60)
        if not name.lower().endswith((*TAKEN, DESCRIPTION)):
            raise ConfigurationError(f"{shown}: is no recording; drop one of {', '.join(TAKEN)}")
        if not _NAME.fullmatch(name):
            raise ConfigurationError(f"{shown}: call it by letters, digits, spaces and _ . + -")
        if not 0 <= length <= MOST_BYTES:
            most = MOST_BYTES // 2**20
            raise ConfigurationError(
                f"{shown}: larger than {most} MiB; copy it into the folder instead"
            )
        if self._receiving:
            raise ConfigurationError(f"{shown}: another file is coming in; wait for it")
        target = self.uploads / name
        if os.path.lexists(target):
            raise ConfigurationError(f"{shown}: is there already; choose it, or rename yours")
        try:
            self.uploads.mkdir(parents=True, exist_ok=True)
            kept = sum(entry.stat().st_size for entry in os.scandir(self.inside(self.uploads)))
        except OSError as error:
            raise ConfigurationError(f"{self.uploads}: {error.strerror}") from error
        if kept + length > MOST_KEPT:
            raise ConfigurationError(f"{self.uploads} is full; delete what is not needed there")
        return target


async def _write(part: Path, length: int, chunks: AsyncIterator[bytes]) -> None:
    """Raises `ConfigurationError`: More comes than was announced, or less."""
    arrived = 0
    with part.open("wb") as stream:
        async for chunk in chunks:
            arrived += len(chunk)
            if arrived > length:
                break
            stream.write(chunk)
    if arrived != length:
        raise ConfigurationError(f"{part.name[1:-5]}: did not come as long as it was announced")


def _kind(path: Path) -> str:
    """Of what can be opened or chosen; empty: it is neither."""
    if path.is_file():
        return "file" if is_recorded_file(path) else ""
    if not path.is_dir():
        return ""
    if (path / "metadata.yaml").is_file():
        return "bag"
    if is_text_recording(path):
        return "text"
    return "data set" if is_data_set(path) else "folder"
