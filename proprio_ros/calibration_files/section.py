"""What the sections of all calibrations share: runs, lists of numbers, correlations, and parts that must be there."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from proprio_ros.inputs.forms import Form, FormError, Number, Text, shortly, under
from proprio_ros.records import FloatArray

DIGEST, DIGEST_LENGTH = "digest", 16
"""Key under which a section says what its other keys said when it was written, and its number of hexadecimal digits."""
RUN: dict[str, Form] = {
    "name": Text(longest=9000),
    "duration_s": Number(unit="s", lowest=0.0, highest=1e7),
    "load_kg": Number(unit="kg", lowest=0.0, highest=1e3),
}
"""What is said of a motion that a calibration was made of."""


def triangle_of(correlation: FloatArray) -> str:
    """The lower triangle as text, a line per unknown."""
    return lines_of((row[: n + 1] for n, row in enumerate(correlation)), 12)


def lines_of(rows: Iterable[FloatArray], digits: int) -> str:
    """Numbers as text, a line per row: it reads a hundred times faster than YAML's numbers."""
    return "".join(" ".join(f"{value:.{digits}g}" for value in row) + "\n" for row in rows)


def correlation_of(
    section: Mapping[str, Any],
    count: int,
    smallest: float,
) -> FloatArray:
    """The matrix under ``correlation``, shape (count, count).

    Args:
        section: Of a calibration.
        count: Of its unknowns.
        smallest: Eigenvalue that is let through.

    Raises:
        FormError: It is of another size, no correlation, or has a smaller eigenvalue.
    """
    rows = numbers_of(section, "correlation")
    if not count or [len(row) for row in rows] != [n + 1 for n in range(count)]:
        raise FormError(
            f"correlation must be the lower triangle of {count} unknowns, one row each; calibrate again"
        )
    matrix = np.zeros((count, count))
    for n, row in enumerate(rows):
        matrix[n, : n + 1] = row
    matrix = matrix + np.tril(matrix, -1).T
    if not np.all(np.isfinite(matrix)) or np.abs(np.diag(matrix) - 1.0).max() > 1e-9:
        raise FormError("correlation must be finite, with ones on its diagonal; calibrate again")
    if np.linalg.eigvalsh(matrix)[0] < smallest:
        raise FormError("correlation is not one of any covariance; calibrate again")
    return matrix


def numbers_of(
    section: Mapping[str, Any],
    key: str,
) -> list[list[float]]:
    """The lines of numbers under a key; raises `FormError` where there are none, or a word is none."""
    rows = []
    for n, line in enumerate(part_of(section, key, str).splitlines(), start=1):
        try:
            rows.append([float(word) for word in line.split()])
        except ValueError as error:
            raise FormError(f"{key}, line {n}: {error}; calibrate again") from error
    return rows


def exactly(
    entry: Any,
    forms: Mapping[str, Form],
    beside: tuple[str, ...] = (),
) -> list[Any]:
    """The values of a mapping in the order of its keys.

    Args:
        entry: As it was read.
        forms: Of its keys.
        beside: Keys that are read elsewhere.

    Raises:
        FormError: It has other keys, or a value is of another form.
    """
    if not isinstance(entry, Mapping) or set(entry) != {*forms, *beside}:
        raise FormError(f"expected {', '.join((*forms, *beside))}, got {shortly(entry)}")
    return [read_under(entry, key, form) for key, form in forms.items()]


def read_under(
    given: Mapping[str, Any],
    key: str,
    form: Form,
    default: Any = None,
) -> Any:
    """The value of a key as its form takes it.

    Args:
        given: Keys and values.
        key: That is read.
        form: Of the value.
        default: Where the key is not there.

    Raises:
        FormError: It is of another form; the message begins with the key.
    """
    with under(key):
        return form.read(given.get(key, default))


def check_section(section: Any) -> None:
    """Raises: FormError: What a robot file has as a calibration is no mapping."""
    if not isinstance(section, Mapping):
        raise FormError(
            f"expected keys and values, got {shortly(section)}; write it with `proprio calibrate`"
        )


def check_digest(section: Mapping[str, Any]) -> None:
    """Raises: FormError: A calibration is not as it was written; files of before there were digests are not asked."""
    if DIGEST in section and section[DIGEST] != digest_of(section):
        raise FormError(
            "was changed after it was written, or merged from several files: its numbers belong together, so calibrate again; "
            f"whoever changed them on purpose deletes the line `{DIGEST}`"
        )


def digest_of(section: Mapping[str, Any]) -> str:
    """Of all that a section says, whatever the order of its keys and the layout of its numbers."""
    rest = {key: value for key, value in section.items() if key != DIGEST}
    text = json.dumps(_plain(rest), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:DIGEST_LENGTH]


def _plain(value: Any) -> Any:
    """What a YAML file gives back of it: numbers as text of twelve digits, so that no reader's rounding counts."""
    if isinstance(value, Mapping):
        return {str(key): _plain(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(each) for each in value]
    if isinstance(value, str):
        return " ".join(value.split())
    if isinstance(value, (bool, type(None))):
        return value
    return f"{float(value):.12g}"


def runs_of(
    section: Mapping[str, Any],
    forms: Mapping[str, Form],
) -> tuple[Any, ...]:
    """The runs of a calibration, each a mapping that must have exactly these keys; raises `FormError`."""
    runs = part_of(section, "runs", list)
    for number, run in enumerate(runs, 1):
        with under("runs", number):
            exactly(run, forms)
    return tuple(runs)


def part_of(
    section: Mapping[str, Any],
    key: str,
    kind: type,
) -> Any:
    """A part of a section.

    Args:
        section: Of a calibration.
        key: That must be there.
        kind: Of its value.

    Raises:
        FormError: It is not there, or is something else.
    """
    if not isinstance(section.get(key), kind):
        raise FormError(
            f"{key} is missing or no {kind.__name__}; write it with `proprio calibrate`"
        )
    return section[key]


def short(value: float, digits: int = 12) -> float:
    """A number as the file has it."""
    return float(f"{value:.{digits}g}")
