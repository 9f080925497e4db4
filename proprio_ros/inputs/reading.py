"""Every text that a user hands in is parsed here: YAML, JSON and CSV, with limits on its size, its depth and its numbers.

What a parser raises over a text that somebody made up is the parser's own choice, and so is what it needs: lists nested ten
thousand deep end the interpreter's stack, and a YAML file of a kilobyte can stand for gigabytes. Here they become one sentence.
"""

from __future__ import annotations

import json
import math
import os
import re
import stat
import warnings
from collections.abc import Iterable
from copy import deepcopy
from functools import lru_cache
from itertools import chain
from pathlib import Path
from typing import Any

from proprio_ros.errors import ProprioError, one_line

# bytes of a YAML or JSON file, and of a URDF; a calibration of forty joints has a tenth of it
LONGEST_TEXT = 2_000_000
LONGEST_VALUE = 10_000  # characters of one VALUE of KEY=VALUE
LONGEST_TABLE = 64_000_000  # bytes of a CSV file: over ten hours at 30 Hz
DEEPEST = 32  # lists and mappings within each other; the deepest file of this package has six
_TOO_DEEP = f"nested more than {DEEPEST} deep"
# keys, values, lists and mappings of a YAML file, those that an alias stands for counted each time
MOST_NODES = 20_000
LONGEST_NAME, LONGEST_PATH = 255, 4095
"""Bytes of a file's name and of a path (Linux: NAME_MAX, PATH_MAX less its final zero)."""


class _Refused(ValueError):
    """What is wrong with a text, in a few words."""


def finite(value: object) -> float | None:
    """A plain number that is finite as a double, or None: a truth value is none, and neither is 10**400."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None


def path_problem(path: str | Path) -> str:
    """Why no file can be called so, or an empty string."""
    text = str(path)
    if "\0" in text:
        return "holds a NUL character"
    try:
        encoded = os.fsencode(text)
    except UnicodeEncodeError:
        return "holds characters that no path has"
    if len(encoded) > LONGEST_PATH or any(len(part) > LONGEST_NAME for part in encoded.split(b"/")):
        return f"is too long for a path: a name may have {LONGEST_NAME} bytes"
    return ""


def text_of(
    path: Path,
    error: type[ProprioError],
    longest: int = LONGEST_TEXT,
) -> str:
    """The text of a regular file of at most so many bytes, without a byte order mark.

    Args:
        path: Of a regular file.
        error: What is raised.
        longest: Most bytes.

    Raises:
        ProprioError: Of the kind given: it cannot be read, is no text, or is too long.
    """
    problem = path_problem(path)
    if problem:
        raise error(f"{path}: {problem}")
    try:
        if path.exists() and not stat.S_ISREG(path.stat().st_mode):
            raise error(f"{path}: is no file")
        with path.open("rb") as stream:
            data = stream.read(longest + 1)
    except OSError as reason:
        raise error(f"{path}: cannot be read ({reason.strerror or reason})") from reason
    if len(data) > longest:
        raise error(
            f"{path}: has over {longest / 1e6:g} MB, and no such file of this package is that long"
        )
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as reason:
        raise error(f"{path}: is no text ({reason.reason} at byte {reason.start})") from reason


def json_of(text: str) -> Any:
    """What a JSON text says. Raises `ValueError`: It is none, or is nested too deep."""
    try:
        content = json.loads(text, parse_int=_whole)
    except RecursionError:
        raise _Refused(_TOO_DEEP) from None
    _check_depth(content)
    return content


def _whole(digits: str) -> int | float:
    # Python's whole numbers have no largest one, doubles do; nothing here counts that far
    return int(digits) if len(digits) <= 18 else float(digits)


def _check_depth(content: Any) -> None:
    level = [content]
    depth = 0
    while level:
        if depth > DEEPEST:
            raise _Refused(_TOO_DEEP)
        nested = [
            outer.values() if isinstance(outer, dict) else outer
            for outer in level
            if isinstance(outer, (dict, list))
        ]
        level = list(chain.from_iterable(nested))
        depth = depth + 1


def yaml_of(text: str) -> Any:
    """What a YAML text says (plain types only); the caller may change it.

    Raises `ValueError`: It is none, is nested too deep, or stands for more than it should.
    """
    return deepcopy(_parsed(text))


# a robot's file takes 30 ms to parse, and who weighs many recordings in one process reads the same files each time
@lru_cache(maxsize=32)
def _parsed(text: str) -> Any:
    from ruamel.yaml import YAML
    from ruamel.yaml.composer import Composer
    from ruamel.yaml.nodes import MappingNode, SequenceNode

    class Counting(Composer):
        """Counts while it reads, so that a long text is not read to its end."""

        count = 0

        def compose_node(self, parent: Any, index: Any) -> Any:
            self.count += 1
            if self.count > MOST_NODES:
                raise _Refused(f"more than {MOST_NODES} values")
            return super().compose_node(parent, index)

    def weight(node: Any, above: tuple[int, ...]) -> int:
        """Of a node with all that it stands for; each is looked at once."""
        if id(node) in above:
            raise _Refused("an alias stands for what it is part of")
        if len(above) > DEEPEST:
            raise _Refused(_TOO_DEEP)
        if id(node) not in weights:
            parts: Iterable[Any] = ()
            if isinstance(node, SequenceNode):
                parts = node.value
            elif isinstance(node, MappingNode):
                parts = chain.from_iterable(node.value)
            inside = (*above, id(node))
            weights[id(node)] = 1 + sum(weight(part, inside) for part in parts)
            if weights[id(node)] > MOST_NODES:
                raise _Refused(f"its aliases stand for more than {MOST_NODES} values")
        return weights[id(node)]

    _refuse_deep_brackets(text)
    weights: dict[int, int] = {}
    yaml = YAML(typ="safe", pure=True)
    yaml.Composer = Counting
    try:
        # an anchor that is used again warns, and a warning is more than one line
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            constructor, _ = yaml.get_constructor_parser(text)
            node = constructor.composer.get_single_node()
            if node is None:
                return None
            weight(node, ())
            return constructor.construct_document(node)
    except RecursionError:
        raise _Refused(_TOO_DEEP) from None
    # a reader of YAML lets whatever its text leads it to through: of dates that are none, of tags that nobody knows
    except Exception as reason:
        raise _Refused(_reason_in_words(reason)) from reason


def _refuse_deep_brackets(text: str) -> None:
    """Raise _Refused: The scanner looks ahead over all brackets of a line, which takes the square of their number."""
    depth = 0
    for bracket in re.findall(r"[][{}]", text):
        depth += 1 if bracket in "[{" else -1
        if depth > 8 * DEEPEST:
            raise _Refused(_TOO_DEEP)


def _reason_in_words(reason: Exception) -> str:
    """Why a text could not be read, and in which line, as far as the parser says it."""
    problem = getattr(reason, "problem", None)
    mark = getattr(reason, "problem_mark", None)
    words = " ".join(str(problem or reason).split())
    if not words:
        return type(reason).__name__
    where = f", line {mark.line + 1}" if problem and mark is not None else ""
    return one_line(words, 160) + where


def yaml_file(
    path: Path,
    kind: type[ProprioError],
    called: str = "",
) -> Any:
    """What a YAML file says (plain types only).

    Raises `ProprioError`: Of that kind: it is not readable, or no YAML that `yaml_of` takes.

    Args:
        path: Of the file.
        kind: Of error that is raised.
        called: What messages call it; default its path.

    Raises:
        ProprioError: Of that kind: it is not readable, or no YAML that `yaml_of` takes.
    """
    text = text_of(path, kind)
    try:
        return yaml_of(text)
    except ValueError as error:
        raise kind(
            f"{called or path}: not readable as YAML ({one_line(str(error), 120)})"
        ) from error
