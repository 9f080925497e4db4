"""Tables as files: text with separators (CSV, and what is called so), or Parquet; headers first, then the columns that are wanted.

A text is read row by row, so that a column which nobody needs costs nothing. What is not a number where one must be is refused with
its line; the last line may be cut, as a recorder that was killed leaves it.
"""

from __future__ import annotations

import csv
import re
import stat
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from proprio_ros.errors import ProprioError, RecordingError, one_line
from proprio_ros.inputs.forms import shortly
from proprio_ros.inputs.reading import path_problem
from proprio_ros.recordings.datasets import arrow
from proprio_ros.recordings.echoes import (
    BROKEN,
    first_of,
    is_echo,
    names_are_numbers,
    only_numbers,
    read_echoes,
)
from proprio_ros.recordings.headers import DRIVING, Kind, header_of, is_numbered_joint
from proprio_ros.records import FloatArray

TEXTS = (".csv", ".tsv", ".txt")
PARQUET = (".parquet",)
SUFFIXES = (*TEXTS, *PARQUET)
"""How names of tables end."""
MOST_ROWS = 1_000_000  # a quarter of an hour at 1 kHz
MOST_BYTES = 500_000_000
MOST_COLUMNS = 2000
PER_UNIT = 10**9  # times are counted in so many parts of their unit, so that none is rounded
_TOGETHER = 8192  # rows that are turned into numbers at once
_MOST_BEFORE = 200  # lines before the first row: comments, and the header
_MISSING = {"", "nan", "na", "n/a", "null", "none", "-", "nil", "#n/a"}
_COMMENT = re.compile(r"\s*(#|%|//)+\s*")
_DATE = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d(\.\d+)?)?\s*(Z|[+-]\d\d:?\d\d)?$")
_SEPARATORS = (";", "\t", ",", "")
"""In the order in which they are tried: a decimal comma stands between semicolons or tabs; empty: white space."""


@dataclass(frozen=True)
class Cells:
    """What was read of a table, R rows."""

    # time of each row in billionths of its unit; None where it has none
    ticks: Sequence[int | None]
    dated: bool  # whether times were dates, whose unit is the nanosecond
    numbers: Mapping[int, FloatArray]  # by column, NaN where a cell is empty, shape (R,)
    notes: tuple[str, ...] = ()  # a sentence on each repair


class Table(ABC):
    """A table; its columns are read when they are asked for."""

    def __init__(self, path: Path, headers: Sequence[str]) -> None:
        self.path = path
        self.headers = tuple(headers)

    @abstractmethod
    def read(self, time: int, others: Sequence[int]) -> Cells:
        """Columns by their places. Raises `RecordingError`: One holds what is no number, or there are too many rows."""


def is_table(path: str | Path) -> bool:
    """Whether a path is called as a table is, and is no folder."""
    path = Path(path)
    return path.suffix.lower() in SUFFIXES and not path_problem(path) and not path.is_dir()


def is_recorded_table(path: Path) -> bool:
    """Whether a file is a table with times and positions, by its headers alone."""
    try:
        headers = open_table(path).headers if is_table(path) else ()
    except ProprioError:
        return False
    found = [header_of(header) for header in headers]
    kinds = {each.kind for each in found}
    driven = {each.joint for each in found if each.kind in DRIVING}
    alone = [each for each in found if each.kind is None]
    has_joints = any(is_numbered_joint(each) or each.joint in driven for each in alone)
    return Kind.TIME in kinds and (Kind.POSITION in kinds or has_joints)


def open_table(path: Path) -> Table:
    """A table with its headers. Raises `RecordingError`: It is no table, or nothing is in it; `ConfigurationError`: no pyarrow."""
    _refuse_no_file(path)
    opened = _parquet(path) if path.suffix.lower() in PARQUET else _text(path)
    if len(opened.headers) > MOST_COLUMNS:
        raise RecordingError(f"has {len(opened.headers)} columns; {MOST_COLUMNS} are read", path)
    return opened


def _refuse_no_file(path: Path) -> None:
    problem = path_problem(path)
    if problem:
        raise RecordingError(f"{one_line(str(path), 100)}: {problem}")
    try:
        found = path.stat()
    except OSError as error:
        raise RecordingError(
            f"cannot be read ({error.strerror or error}); give a file", path
        ) from error
    if not stat.S_ISREG(found.st_mode):
        raise RecordingError("a pipe, a socket or a device, and no file; copy it into one", path)
    if not found.st_size:
        raise RecordingError("is empty: record it again", path)
    if found.st_size > MOST_BYTES:
        raise RecordingError(
            f"has {found.st_size / 1e6:.0f} MB, and {MOST_BYTES / 1e6:.0f} MB are read: cut it, or leave columns out",
            path,
        )


@contextmanager
def _readable(path: Path, what: str) -> Iterator[None]:
    """Whatever a decoder, csv or pyarrow raises becomes one line."""
    try:
        yield
    except (ProprioError, MemoryError):
        raise
    except UnicodeDecodeError as error:
        raise RecordingError(
            f"is no text in UTF-8 ({error.reason}); save it as CSV in UTF-8, or give a bag", path
        ) from error
    except Exception as error:
        reason = " ".join(str(error).split())[:150] or type(error).__name__
        raise RecordingError(f"not readable as {what} ({reason})", path) from error


# ---------------------------------------------------------------- text


@dataclass(frozen=True)
class _Form:
    """How a text is written."""

    separator: str  # empty: white space
    first: int  # number of the line with the first row, from 1


class _TextTable(Table):
    """A text."""

    def __init__(self, path: Path, headers: Sequence[str], form: _Form) -> None:
        super().__init__(path, headers)
        self._form = form

    def read(self, time: int, others: Sequence[int]) -> Cells:
        marks = _Marks(self.path)
        ticks: list[int | None] = []
        parts: dict[int, list[FloatArray]] = {place: [] for place in others}
        notes: list[str] = []
        dated: bool | None = None
        with _readable(self.path, "a table"):
            for rows in self._rows([time, *others], notes):
                first, *columns = marks.with_points(
                    [list(each) for each in zip(*rows, strict=True)]
                )
                dated = _are_dates(first) if dated is None else dated
                before = len(ticks)
                for place, column in zip(others, columns, strict=True):
                    parts[place].append(_numbers(column, self.headers[place], before, self.path))
                ticks += _ticks(first, dated, self.headers[time], before, self.path)
        numbers = {place: np.concatenate(found) for place, found in parts.items()}
        return Cells(ticks, bool(dated), numbers, tuple(notes))

    def _rows(self, places: Sequence[int], notes: list[str]) -> Iterator[list[list[str]]]:
        """The wanted cells of rows, some at a time; a last row that breaks off is left out, and noted."""
        width = len(self.headers)
        found: list[list[str]] = []
        count = 0
        broken = 0
        for number, cells in self._cells():
            if broken:
                raise RecordingError(
                    f"line {broken} has another number of cells than the header's {width}: repair or remove it",
                    self.path,
                )
            if len(cells) < width or any(cell.strip() for cell in cells[width:]):
                broken = number
                continue
            count += 1
            if count > MOST_ROWS:
                raise RecordingError(f"has more than {MOST_ROWS} rows: cut it", self.path)
            found.append([cells[place].strip() for place in places])
            if len(found) == _TOGETHER:
                yield found
                found = []
        if not count:
            raise RecordingError("has a header and no row: record it again", self.path)
        if broken:
            notes.append(BROKEN)
        if found:
            yield found

    def _cells(self) -> Iterator[tuple[int, list[str]]]:
        with self.path.open(encoding="utf-8-sig", newline="") as stream:
            lines = islice(enumerate(stream, 1), self._form.first - 1, None)
            for number, line in lines:
                if line.strip() and not _COMMENT.match(line):
                    yield number, _split(line, self._form.separator)


def _split(line: str, separator: str) -> list[str]:
    if not separator:
        return line.split()
    return next(csv.reader([line.rstrip("\r\n")], delimiter=separator, skipinitialspace=True), [])


class _EchoTable(Table):
    """Joint states as `ros2 topic echo --csv` and `rostopic echo -p` print them."""

    def __init__(self, path: Path) -> None:
        self._found = read_echoes(path)
        super().__init__(path, self._found.headers)

    def read(self, time: int, others: Sequence[int]) -> Cells:
        found = self._found
        if time or len(found.stamps_ns) > MOST_ROWS:
            raise RecordingError(
                f"its times are the stamps of messages, {MOST_ROWS} at most: leave `time` out of columns.yaml, or cut it",
                self.path,
            )
        ticks = [PER_UNIT * stamp_ns for stamp_ns in found.stamps_ns]
        numbers = {place: found.columns[place - 1] for place in others}
        return Cells(ticks, dated=True, numbers=numbers, notes=found.notes)


def _text(path: Path) -> Table:
    with _readable(path, "a table"):
        with path.open(encoding="utf-8-sig", newline="") as stream:
            before = list(islice((line[:1_000_000] for line in stream), _MOST_BEFORE))
        if any("\0" in line for line in before):
            raise RecordingError("is no text; save it as CSV in UTF-8, or give a bag", path)
        first = first_of(before)
        if is_echo(first):
            return _EchoTable(path)
        if names_are_numbers(first):
            raise RecordingError(only_numbers("numbers"), path)
        return _TextTable(path, *_head(before, path))


def _head(lines: Sequence[str], path: Path) -> tuple[list[str], _Form]:
    """Headers, and how the text is written, by its first lines."""
    separators: tuple[str, ...] = _SEPARATORS
    comment = ""
    filled: list[tuple[int, str]] = []
    for number, line in enumerate(lines, 1):
        stated = re.fullmatch(r"\s*sep=(.)\s*", line)  # a spreadsheet's own line
        if stated:
            separators = (stated[1],)
        elif _COMMENT.match(line) and not filled:
            comment = _COMMENT.sub("", line, count=1)
        elif line.strip() and not _COMMENT.match(line):
            filled.append((number, line))
        if len(filled) == 2:
            break
    if not filled:
        raise RecordingError("has no rows: it is empty, or all of it is comments", path)
    first, line = filled[0]
    if any(_all_numbers(_split(line, separator)) for separator in separators):
        return _headers(comment, line, separators, path), _form(comment, line, separators, first)
    if len(filled) < 2:
        raise RecordingError("has a header and no row: record it again", path)
    second, row = filled[1]
    return _headers(line, row, separators, path), _form(line, row, separators, second)


def _form(header: str, row: str, separators: Sequence[str], first: int) -> _Form:
    return _Form(_separator(header, row, separators) or "", first)


def _headers(header: str, row: str, separators: Sequence[str], path: Path) -> list[str]:
    """Names of the columns, by their line and the first row."""
    if not header:
        raise RecordingError(
            "has no header: its first line must name the columns, such as t [s],q1 [rad],tau1 [Nm]",
            path,
        )
    separator = _separator(header, row, separators)
    if separator is None:
        raise RecordingError(
            f"its header {shortly(header.strip())} and its first row {shortly(row.strip())} have not as many cells, by "
            "semicolons, tabs, commas or spaces: decimal commas need semicolons or tabs",
            path,
        )
    return [cell.strip().strip('"') for cell in _trimmed(_split(header, separator))]


def _separator(header: str, row: str, separators: Sequence[str]) -> str | None:
    """That by which header and first row have as many cells, and more than one; None where none does."""
    for separator in separators:
        names = _trimmed(_split(header, separator))
        cells = _split(row, separator)
        if len(names) > 1 and len(cells) >= len(names) and not any(cells[len(names) :]):
            return separator
    return None


def _trimmed(cells: list[str]) -> list[str]:
    """The cells without empty ones at the end, which a separator behind the last one makes."""
    while cells and not cells[-1].strip():
        cells = cells[:-1]
    return cells


def _all_numbers(cells: Sequence[str]) -> bool:
    filled = [cell.strip() for cell in cells if cell.strip().lower() not in _MISSING]
    numbers = [cell for cell in filled if re.fullmatch(r"[-+]?[\d.,]+([eE][-+]?\d+)?", cell)]
    return len(cells) > 1 and bool(filled) and len(numbers) == len(filled)


class _Marks:
    """Whether numbers have decimal points or commas."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._comma = ""  # the first number with either
        self._point = ""

    def with_points(self, cells: list[list[str]]) -> list[list[str]]:
        """Columns of texts with decimal points. Raises `RecordingError`: There were both points and commas until now."""
        self._point = self._point or next(
            (c for column in cells for c in column if "." in c and not _DATE.match(c)), ""
        )
        commas = next((c for column in cells for c in column if "," in c), "")
        self._comma = self._comma or commas
        if self._comma and self._point:
            raise RecordingError(
                f"has numbers with a point ({shortly(self._point)}) and others with a comma ({shortly(self._comma)}): which one "
                "is decimal?",
                self._path,
            )
        return [[c.replace(",", ".") for c in column] for column in cells] if commas else cells


def _numbers(cells: Sequence[str], header: str, before: int, path: Path) -> FloatArray:
    """Numbers of cells, of which so many were before."""
    found = np.empty(len(cells))
    for row, cell in enumerate(cells):
        try:
            found[row] = float(cell)
        except ValueError:
            if cell.lower() not in _MISSING:
                raise _no_number(cell, header, before + row, path) from None
            found[row] = np.nan
    return found


def _no_number(cell: str, header: str, row: int, path: Path) -> RecordingError:
    return RecordingError(f"{header} is {shortly(cell)} in row {row + 1}, and no number", path)


def _are_dates(cells: Sequence[str]) -> bool | None:
    """Whether the first time is a date; None where there is none."""
    return next((bool(_DATE.match(cell)) for cell in cells if cell.lower() not in _MISSING), None)


def _ticks(
    cells: Sequence[str], dated: bool | None, header: str, before: int, path: Path
) -> list[int | None]:
    """Times, or dates, in billionths of their unit, without rounding."""
    found: list[int | None] = []
    for row, cell in enumerate(cells):
        if cell.lower() in _MISSING:
            found.append(None)
            continue
        try:
            found.append(PER_UNIT * _date_ns(cell) if dated else _tick(Decimal(cell)))
        except (InvalidOperation, ValueError, OverflowError):
            raise _no_number(cell, header, before + row, path) from None
    return found


def _tick(value: Decimal) -> int | None:
    """Billionths of a number's unit; None where it is not finite."""
    if value.is_nan() or value.is_infinite():
        return None
    if abs(value) > Decimal(10) ** 20:
        raise ValueError(value)
    return int((value * PER_UNIT).to_integral_value())


def _date_ns(cell: str) -> int:
    """Nanoseconds since 1970 of a date; where it has no zone, of one without."""
    found = _DATE.match(cell)
    if found is None:
        raise ValueError(cell)
    zone = found[3] or ""
    bare = cell[: len(cell) - len(zone)].strip().replace(" ", "T")
    ahead_min = 0
    if zone and zone != "Z":
        digits = zone[1:].replace(":", "")
        minutes = 60 * int(digits[:2]) + int(digits[2:])
        ahead_min = minutes if zone[0] == "+" else -minutes
    return int(np.datetime64(bare, "ns").astype(np.int64)) - ahead_min * 60 * 10**9


# ---------------------------------------------------------------- Parquet


class _ParquetTable(Table):
    """A Parquet file, of which columns are read when they are asked for; one of vectors is as many, ``q[0]`` and so on."""

    def __init__(self, path: Path, file: Any) -> None:
        self._file = file
        self._places: dict[
            str, tuple[str, int | None]
        ] = {}  # name in the file, and place in its vectors
        for part, place in _parts(file):
            if part in self._places:
                raise RecordingError(f"two columns are called {shortly(part)}", path)
            self._places[part] = place
        super().__init__(path, list(self._places))

    def read(self, time: int, others: Sequence[int]) -> Cells:
        wanted = [self.headers[place] for place in (time, *others)]
        with _readable(self.path, "a Parquet table"):
            names = list(dict.fromkeys(self._places[header][0] for header in wanted))
            table = self._file.read(columns=names, use_threads=False)
            columns = {header: self._column(table, header) for header in wanted}
            ticks, dated = self._ticks(wanted[0], columns[wanted[0]])
            numbers = {
                place: self._numbers(self.headers[place], columns[self.headers[place]])
                for place in others
            }
        return Cells(ticks, dated, numbers)

    def _column(self, table: Any, header: str) -> Any:
        name, index = self._places[header]
        column = table.column(name).combine_chunks()
        if index is None:
            return column
        lengths = arrow().compute.unique(arrow().compute.list_value_length(column)).to_pylist()
        if len(lengths) > 1 or None in lengths:
            raise RecordingError(
                f"{name} has vectors of several lengths: which are the joints?", self.path
            )
        return arrow().compute.list_element(column, index)

    def _numbers(self, header: str, column: Any) -> FloatArray:
        types = arrow().types
        if not (types.is_floating(column.type) or types.is_integer(column.type)):
            raise RecordingError(f"{header} is of type {column.type}, and no number", self.path)
        return np.asarray(column.to_numpy(zero_copy_only=False), dtype=np.float64)

    def _ticks(self, header: str, column: Any) -> tuple[list[int | None], bool]:
        types = arrow().types
        if types.is_timestamp(column.type):
            in_ns = column.cast(arrow().timestamp("ns", column.type.tz)).cast(arrow().int64())
            return [None if ns is None else ns * PER_UNIT for ns in in_ns.to_pylist()], True
        if types.is_integer(column.type):
            values = column.to_pylist()
            return [None if value is None else value * PER_UNIT for value in values], False
        found = self._numbers(header, column)
        return [_tick(Decimal(repr(float(value)))) for value in found], False


def _parts(file: Any) -> Iterator[tuple[str, tuple[str, int | None]]]:
    """Headers by the file's schema, with the column's name and the place in its vectors; how long these are its first row says."""
    types = arrow().types
    for field in file.schema_arrow:
        if types.is_fixed_size_list(field.type):
            length = field.type.list_size
        elif types.is_list(field.type):
            batch = next(file.iter_batches(batch_size=1, columns=[field.name]))
            first = batch.column(0)[0].as_py()
            length = 0 if first is None else len(first)
        else:
            yield field.name, (field.name, None)
            continue
        for index in range(length):
            yield f"{field.name}[{index}]", (field.name, index)


def _parquet(path: Path) -> Table:
    pyarrow = arrow()
    with _readable(path, "a Parquet table"):
        file = pyarrow.parquet.ParquetFile(path)
        if file.metadata.num_rows > MOST_ROWS:
            raise RecordingError(f"has more than {MOST_ROWS} rows: cut it", path)
        if not file.metadata.num_rows:
            raise RecordingError("has no row: record it again", path)
        return _ParquetTable(path, file)
