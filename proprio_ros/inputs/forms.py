"""What a value of a settings key, a robot file or a calibration may be: its type, unit and range, stated once.

A form reads a plain value, as YAML or JSON has it, or says in a few words what is wrong with it. Tables of forms by key are the
models of this package's files: they are read with, and the settings page of the documentation is written from them.
Ranges are wider than any arm on a table needs: they are there to refuse what no robot has.
"""

from __future__ import annotations

import difflib
import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from reprlib import Repr
from typing import Any

from proprio_ros.inputs.reading import finite
from proprio_ros.quantity import Unit, unit_called

_REPR = Repr()
_REPR.maxstring = _REPR.maxother = _REPR.maxlong = 60
_REPR.maxlist = _REPR.maxtuple = 6
_REPR.maxlevel = 3


def shortly(value: Any) -> str:
    """How a value is quoted in a message: short, however much it is."""
    return _REPR.repr(value)


class FormError(ValueError):
    """What is wrong with a value, in words that follow its key and a colon."""


@contextmanager
def under(*keys: object) -> Iterator[None]:
    """What is wrong within is said with these keys before it."""
    try:
        yield
    except FormError as error:
        raise FormError(": ".join((*map(str, keys), str(error)))) from None


@dataclass(frozen=True)
class Form:
    """What a value may be; its meaning is for the documentation."""

    meaning: str = ""

    def read(self, value: Any) -> Any:
        """The value as the code takes it; raises `FormError` where it is none of this form."""
        raise NotImplementedError

    def described(self) -> str:
        """Type, range and unit, for the documentation."""
        raise NotImplementedError


@dataclass(frozen=True)
class Number(Form):
    """A finite number within a range, of an SI unit or none."""

    unit: str = ""
    lowest: float = -math.inf
    highest: float = math.inf
    open: bool = False  # whether the lowest is outside the range
    hint: str = ""  # how a number outside comes about, such as ``lengths are in m``

    def read(self, value: Any) -> float:
        number = finite(value)
        if number is None:
            kind = (
                "a finite number"
                if isinstance(value, (int, float)) and not isinstance(value, bool)
                else "a number"
            )
            raise FormError(f"expected {kind}, got {shortly(value)}")
        if self.lowest <= number <= self.highest and not (self.open and number == self.lowest):
            return number
        words = f"must be {self._range()}"
        if self.lowest >= 0.0 >= number:
            words = (
                "must not be negative"
                if self.lowest == 0.0 and not self.open
                else "must be positive"
            )
        raise FormError(f"{words}, got {number}{self._hint()}")

    def _hint(self) -> str:
        return f": {self.hint}" if self.hint else ""

    def _range(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        if math.isinf(self.highest):
            return (
                "any"
                if math.isinf(self.lowest)
                else f"{'above' if self.open else 'at least'} {self.lowest:g}{unit}"
            )
        if self.open:
            return f"above {self.lowest:g} and at most {self.highest:g}{unit}"
        return f"from {self.lowest:g} to {self.highest:g}{unit}"

    def described(self) -> str:
        return (
            f"number {self._range()}" if self._range() != "any" else f"number {self.unit}".rstrip()
        )


@dataclass(frozen=True)
class Whole(Number):
    """A whole number within a range."""

    def read(self, value: Any) -> int:
        number = finite(value)
        if number is None or number != int(number) or not self.lowest <= number <= self.highest:
            raise FormError(
                f"expected a whole number {self._range()}, got {shortly(value)}{self._hint()}"
            )
        return int(number)

    def described(self) -> str:
        return f"whole {super().described()}"


@dataclass(frozen=True)
class Numbers(Form):
    """A list of numbers."""

    each: Number = Number()
    count: int | None = None  # how many; None: from ``least`` to ``most``
    least: int = 1
    most: int = 64
    rising: bool = False  # whether each must be greater than the one before
    example: str = ""  # what a message shows, such as ``[x, y, z] in m``

    def read(self, value: Any) -> tuple[float, ...]:
        least, most = (self.least, self.most) if self.count is None else (self.count, self.count)
        if not isinstance(value, (list, tuple)) or not least <= len(value) <= most:
            raise FormError(f"expected {self._kind()}, got {shortly(value)}")
        numbers = tuple(self.each.read(entry) for entry in value)
        if self.rising and any(after <= before for before, after in itertools.pairwise(numbers)):
            raise FormError(f"expected rising numbers, got {shortly(list(numbers))}")
        return numbers

    def _kind(self) -> str:
        if self.example:
            return self.example
        return (
            f"a list of {self.least} to {self.most} numbers"
            if self.count is None
            else f"{self.count} numbers"
        )

    def described(self) -> str:
        return f"{self._kind()}, each a {self.each.described()}"


@dataclass(frozen=True)
class Truth(Form):
    """True or false."""

    def read(self, value: Any) -> bool:
        if not isinstance(value, bool):
            raise FormError(f"expected true or false, got {shortly(value)}")
        return value

    def described(self) -> str:
        return "true or false"


@dataclass(frozen=True)
class Text(Form):
    """A printable text of one line, of at most so many characters; ``what`` it names."""

    what: str = "a text"
    longest: int = 255

    def read(self, value: Any) -> str:
        if not isinstance(value, str) or not value:
            raise FormError(f"expected {self.what}, got {shortly(value)}")
        if len(value) > self.longest or not value.isprintable():
            raise FormError(
                f"expected {self.what} of at most {self.longest} printable characters, got {shortly(value)}"
            )
        return value

    def described(self) -> str:
        return self.what


@dataclass(frozen=True)
class Choice(Form):
    """One of some words."""

    words: Sequence[str] = ()
    # whose names the words are, where people write them otherwise, too
    units: Mapping[str, Unit] | None = None

    def read(self, value: Any) -> str:
        if self.units is not None and isinstance(value, str):
            value = unit_called(value, self.units)
        if not isinstance(value, str) or value not in self.words:
            raise FormError(f"{shortly(value)} is unknown: choose one of {', '.join(self.words)}")
        return value

    def described(self) -> str:
        return " or ".join(f"`{word}`" for word in self.words)


@dataclass(frozen=True)
class Perhaps(Form):
    """A value of another form, or null."""

    form: Form = Form()

    def read(self, value: Any) -> Any:
        return None if value is None else self.form.read(value)

    def described(self) -> str:
        return f"{self.form.described()}, or null"


@dataclass(frozen=True)
class Part(Form):
    """Keys and values, or whatever else a function reads, which raises `FormError`; ``kind`` is for the documentation."""

    by: Callable[[Any], Any] = field(kw_only=True)
    kind: str = "keys and values"

    def read(self, value: Any) -> Any:
        return self.by(value)

    def described(self) -> str:
        return self.kind


REQUIRED: Any = object()  # the default of a key that must be there
# the default of a key that is left out of what is read where it is not there
LEFT_OUT: Any = object()


@dataclass(frozen=True)
class Field:
    """One key of a section: its form, and what holds when it is absent."""

    form: Form
    default: Any = REQUIRED


def mapping(value: Any) -> Mapping[str, Any]:
    """The same, which must be keys and values."""
    if not isinstance(value, Mapping):
        raise FormError(f"expected keys and values, got {shortly(value)}")
    return value


def did_you_mean(key: object, known: Iterable[str]) -> str:
    """A question after the nearest of the known keys; empty where none is near."""
    close = difflib.get_close_matches(
        str(key)[:100],
        list(known),
        n=1,
    )
    return f"did you mean {close[0]!r}? " if close else ""


def refuse_unknown(
    given: Mapping[str, Any],
    known: Mapping[str, Any],
) -> None:
    """Raises: FormError: A key is not among those known, with the one that is nearest to it."""
    for key in given:
        if key not in known:
            raise FormError(
                f"unknown key {shortly(key)}; {did_you_mean(key, known)}valid keys: {', '.join(known)}"
            )


def section(
    value: Any,
    fields: Mapping[str, Field | Form],
) -> dict[str, Any]:
    """Read keys and values, of bare forms only those there are; raises `FormError`: a key is unknown or missing, a value wrong."""
    given = mapping(value)
    refuse_unknown(given, fields)
    result = {}
    for key, entry in fields.items():
        form, default = (
            (entry, LEFT_OUT) if isinstance(entry, Form) else (entry.form, entry.default)
        )
        if key in given:
            with under(key):
                result[key] = form.read(given[key])
        elif default is REQUIRED:
            raise FormError(f"{key} is missing; state it")
        elif default is not LEFT_OUT:
            result[key] = default
    return result
