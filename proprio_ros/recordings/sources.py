"""Whatever was recorded, opened once: a bag, one episode of a data set, a table, or a text.

A source is a context; what is asked of it is read while it is open. It knows nothing of robots: the pipeline makes runs or a
motion of what it gives.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Generic, TypeVar

from proprio_ros.calibration_files.motors import Motors
from proprio_ros.errors import ConfigurationError, ProprioError, RecordingError, one_line
from proprio_ros.recordings.contents import (
    Contents,
    contents_of,
    description_in,
    motors_in,
    temperatures_in,
)
from proprio_ros.recordings.datasets import episode_of, read_episode
from proprio_ros.recordings.drive_signals import drive_signals_in
from proprio_ros.recordings.drivers import columns_beside, drivers_of
from proprio_ros.recordings.headers import Kind
from proprio_ros.recordings.read_options import Columns, ReadOptions
from proprio_ros.recordings.reader import Bag, open_bag, readable
from proprio_ros.recordings.signals import hear, recording_of
from proprio_ros.recordings.table_bag import COMMANDS, STATES, TableBag, table_bag
from proprio_ros.recordings.table_columns import Layout, effort_unit_of, layout_of
from proprio_ros.recordings.tables import Table, is_table, open_table
from proprio_ros.recordings.text import TextRecording, is_text_recording, read_text_recording
from proprio_ros.recordings.topics import JOINT_STATE, InputTopic
from proprio_ros.records import DriveSignals, Recording

SAY_UNITS = (
    "--driver si says that all is in s, rad, rad/s and N m; other units stand in the header, q1 [deg], or in columns.yaml "
    "(position_unit: deg)"
)
_Read = TypeVar("_Read")
_Opened = TypeVar("_Opened", bound="RecordingSource")


@dataclass(frozen=True)
class Attempt(Generic[_Read]):
    """What a reading gave, or why it failed, which only matters to those who need it."""

    value: _Read | None = None
    error: RecordingError | None = None

    @classmethod
    def to(
        cls,
        read: Callable[[], _Read],
    ) -> Attempt[_Read]:
        """Try to read."""
        try:
            return cls(read())
        except RecordingError as error:
            return cls(error=error)

    def get(self) -> _Read:
        """What was read. Raises `RecordingError`: It could not be."""
        if self.error is not None:
            raise self.error
        assert self.value is not None
        return self.value


class RecordingSource(ABC):
    """A recording of joint states, once it is open; each member is read when it is asked for.

    Every member raises a `RecordingError` where it cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    @property
    def name(self) -> str:
        """What messages and reports call it; empty where its recording says it."""
        return ""

    def __enter__(self: _Opened) -> _Opened:
        return self

    def __exit__(self, *_: object) -> None:
        return None

    @abstractmethod
    def contents(self, options: ReadOptions) -> Contents:
        """Topics with their types, and which of them are joint states and input."""

    @abstractmethod
    def recording(self, options: ReadOptions) -> Recording:
        """Joint states, input, and when torque was off, in SI units."""

    def drive_signals(self, options: ReadOptions) -> DriveSignals | None:
        """Goals and supply voltage of position servos; None where the recording has them, or there can be none."""
        return None

    def motors(self, state_topic: str | None) -> Motors:
        """The motors of the arm, by joint, as far as the source says whose they are."""
        return {}

    def temperatures(self, state_topic: str | None) -> dict[str, float]:
        """How warm the motors were on average, by joint [deg C], as far as the source says it."""
        return {}


class BagSource(RecordingSource):
    """A ROS 2 bag; it must be entered before anything is read."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._files = ExitStack()
        self._bag: Bag | None = None

    @property
    def name(self) -> str:
        """A bag's folder is often called after its storage, so the folder above says which one it is."""
        return "/".join(self.path.resolve().parts[-2:])

    def __enter__(self) -> BagSource:
        self._bag = self._files.enter_context(open_bag(self.path))
        return self

    def __exit__(self, *_: object) -> None:
        # what went wrong meanwhile is none of the bag's business
        self._files.close()

    def _read(self, read: Callable[[Bag], _Read]) -> _Read:
        """Something of the bag, by a reading that leaves no note to another one."""
        assert self._bag is not None
        with readable(self.path):
            return read(self._bag.anew())

    def contents(self, options: ReadOptions) -> Contents:
        return self._read(lambda bag: contents_of(bag, options))

    def recording(self, options: ReadOptions) -> Recording:
        heard = self._read(lambda bag: hear(bag, options))
        return recording_of(heard, options)

    def drive_signals(self, options: ReadOptions) -> DriveSignals:
        return self._read(lambda bag: drive_signals_in(bag, options))

    def motors(self, state_topic: str | None) -> Motors:
        return self._read(lambda bag: motors_in(bag, state_topic))

    def temperatures(self, state_topic: str | None) -> dict[str, float]:
        return self._read(lambda bag: temperatures_in(bag, state_topic))

    def description(self) -> str:
        """The URDF that was published."""
        return self._read(description_in)


class EpisodeSource(RecordingSource):
    """One episode of a data set, called ``FOLDER#INDEX``."""

    def __init__(
        self,
        path: Path,
        folder: Path,
        index: int,
    ) -> None:
        super().__init__(path)
        self._folder = folder
        self._index = index

    def contents(self, options: ReadOptions) -> Contents:
        """A data set has columns, and the driver's profile says which."""
        return Contents((), options.columns.position if options.columns else None)

    def recording(self, options: ReadOptions) -> Recording:
        """Raises `ConfigurationError`, too: Nobody says what the columns are."""
        if options.columns is None:
            raise ConfigurationError(
                "an episode of a data set, whose units nobody states: give --driver lerobot, another profile with "
                "columns, or your own file",
                self.path,
            )
        return read_episode(self._folder, self._index, options)


class TableSource(RecordingSource):
    """A table, which is read as a bag of its rows."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._table: Table | None = None

    def __enter__(self) -> TableSource:
        self._table = open_table(self.path)
        return self

    def contents(self, options: ReadOptions) -> Contents:
        """Its columns, and what each is read as."""
        headers = self._opened.headers
        try:
            layout = self._layout(options)
        except RecordingError as error:
            unread = tuple((one_line(header, 60), "") for header in headers)
            return Contents((), problem=error, columns=unread)
        positions = [column.header.text for column in layout.of(Kind.POSITION)]
        named = ((one_line(header, 60), what) for header, what in layout.meanings(headers))
        return Contents((), one_line(f"{positions[0]} .. {positions[-1]}"), columns=tuple(named))

    def recording(self, options: ReadOptions) -> Recording:
        """Raises `ConfigurationError`, too: Its columns file is wrong."""
        bag, options = self._bag(options)
        return recording_of(hear(bag, options), options)

    def drive_signals(self, options: ReadOptions) -> DriveSignals:
        return drive_signals_in(*self._bag(options))

    @property
    def _opened(self) -> Table:
        assert self._table is not None
        return self._table

    def _bag(self, options: ReadOptions) -> tuple[TableBag, ReadOptions]:
        """The table as a bag, and how that is read: names of joints are the driver's, units are known."""
        layout = self._layout(options)
        inputs: tuple[InputTopic, ...] = ()
        if layout.command_unit is not None:
            inputs = (InputTopic(COMMANDS.removeprefix("/"), JOINT_STATE, layout.command_unit),)
        conventions = replace(
            options.conventions, states=STATES.removeprefix("/"), inputs=inputs, radians=1.0
        )
        effort = replace(options.effort, unit=layout.effort_unit)
        options = replace(options, conventions=conventions, effort=effort)
        return table_bag(self._opened, layout), options

    def _layout(self, options: ReadOptions) -> Layout:
        if options.state_topic or options.command_topic:
            raise RecordingError("a table has columns, and no topics: leave them out", self.path)
        columns = columns_of_table(self.path, options.columns)
        headers = self._opened.headers
        fitting = [driver.name for driver in drivers_of((f"/{each}", "") for each in headers)]
        advice = SAY_UNITS
        if fitting:
            advice = f"its columns are those of --driver {' or '.join(fitting)}, which says it"
        return layout_of(self.path, headers, columns, options, advice)


def columns_of_table(path: Path, stated: Columns | None) -> Columns:
    """What a driver's profile and a file beside a table say of its columns. Raises `ConfigurationError`: The file is wrong."""
    return replace(stated or Columns(), **columns_beside(path))


def effort_unit_in(paths: Sequence[Path]) -> str | None:
    """What effort is in by the headers of tables, where all recordings are tables that say the same."""
    units = set[str | None]()
    for path in paths:
        if not is_table(path):
            return None
        try:
            headers = open_table(path).headers
            units.add(effort_unit_of(headers, columns_of_table(path, None)))
        except ProprioError:  # reading it says why
            return None
    return units.pop() if len(units) == 1 else None


class TextSource:
    """The motion of one joint as text, which its setting says all about: it is no `Recording` of an arm."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __enter__(self) -> TextSource:
        return self

    def __exit__(self, *_: object) -> None:
        return None

    def text(self) -> TextRecording:
        """The motion with its setting."""
        return read_text_recording(self.path)


def open_source(path: Path) -> RecordingSource | TextSource:
    """The source that a path names; nothing of it is read before it is entered."""
    return TextSource(path) if is_text_recording(path) else open_recording(path)


def open_recording(path: Path) -> RecordingSource:
    """The same where only a bag, an episode or a table will do."""
    episode = episode_of(path)
    if episode is not None:
        return EpisodeSource(path, *episode)
    return TableSource(path) if is_table(path) else BagSource(path)
