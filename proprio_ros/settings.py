"""The user's KEY=VALUE settings: how they are read, checked, and laid over the defaults of a probe's file.

They come from the command line's ``--set`` and from the identifier's parameter ``settings``. Importing this must stay cheap: the
command line does so before it knows what is asked for.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from proprio_ros.errors import ConfigurationError
from proprio_ros.resources import resource

if TYPE_CHECKING:
    import numpy as np

_Options = TypeVar("_Options")


def parse_settings(pairs: Sequence[str]) -> dict[str, Any]:
    """Settings by dotted key; values are JSON, or bare words.

    Raises:
        ConfigurationError: a pair is not of that form.
    """
    settings: dict[str, Any] = {}
    for pair in pairs:
        key, separator, text = pair.partition("=")
        if not separator or not key:
            raise ConfigurationError(f"--set {pair}: write KEY=VALUE, e.g. --set payload.size=0.03")
        try:
            settings[key] = json.loads(text)
        except ValueError:
            if text[:1] in '[{"' or not text:
                raise ConfigurationError(f"--set {pair}: {text!r} is not JSON, e.g. [0,0,0.01] or 0.03") from None
            settings[key] = text  # a bare word such as cube
    return settings


class Settings:
    """The user's keys, each taken once; what nobody took is an error that lists what there is.

    Attributes:
        taken: keys that the user stated and that something understood.
    """

    def __init__(self, given: Mapping[str, Any]) -> None:
        self._left = dict(given)
        self._known: list[str] = ["held.JOINT", "robot.KEY.OF.ROBOT.FILE"]
        self.taken: set[str] = set()

    @property
    def left(self) -> frozenset[str]:
        """Keys that nothing has taken yet."""
        return frozenset(self._left)

    def take(self, key: str, default: Any) -> Any:
        """The user's value, or the default."""
        self._known.append(key)
        if key in self._left:
            self.taken.add(key)
            return self._left.pop(key)
        return default

    def take_prefix(self, prefix: str) -> dict[str, Any]:
        """All keys under a prefix, without it."""
        found = {key: self._left.pop(key) for key in list(self._left) if key.startswith(prefix)}
        self.taken.update(found)
        return {key[len(prefix) :]: value for key, value in found.items()}

    def options(self, kind: Callable[..., _Options], prefix: str, defaults: Mapping[str, Any]) -> _Options:
        """The options of a solver, a data class, from the keys under a prefix.

        Args:
            kind: the data class; a field whose default is a number takes a number, a tuple positive numbers, a text a text.
            prefix: such as ``solver.``.
            defaults: of the probe's file; a field that it leaves out has the class's own.

        Raises:
            ConfigurationError: a value of the wrong form.
        """
        values: dict[str, Any] = {}
        for entry in fields(kind):  # type: ignore[arg-type]
            if entry.name == "solver":  # the command line has a flag for it
                continue
            key = prefix + entry.name
            value = self.take(key, defaults.get(entry.name, entry.default))
            if isinstance(entry.default, tuple):
                value = tuple(numbers(key, value))
                if not value or min(value) <= 0.0:
                    what = "modulus in Pa" if key.endswith("_Pa") else "mass in kg"
                    raise ConfigurationError(f"{key} needs at least one positive {what}")
            elif not isinstance(entry.default, str) and value is not None:
                value = number(key, value)
                if isinstance(entry.default, int) or "int" in str(entry.type):
                    if value != int(value):
                        raise ConfigurationError(f"{key}={value} must be a whole number")
                    value = int(value)
            values[entry.name] = value
        return kind(**values)

    def refuse_rest(self) -> None:
        """Raises: ConfigurationError: a key that nothing understands."""
        if self._left:
            raise ConfigurationError(
                f"--set {', '.join(sorted(self._left))}: unknown; valid keys: {', '.join(sorted(self._known))}"
            )


def probe_file(name: str, sections: Sequence[str] = ()) -> dict[str, Any]:
    """What ``config/probes`` says about a probe.

    Args:
        name: of the file, without its suffix.
        sections: that it must have.

    Raises:
        ConfigurationError: it is not readable, or lacks a section.
    """
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    path: Path = resource("probes", name)
    try:
        content = YAML(typ="safe", pure=True).load(path)
    except (OSError, YAMLError) as error:
        raise ConfigurationError(f"{path}: not readable as YAML ({str(error).splitlines()[0]})") from error
    if not isinstance(content, dict) or not all(isinstance(content.get(section), dict) for section in sections):
        raise ConfigurationError(f"{path}: needs the sections {', '.join(sorted(sections))}")
    return content


def number(key: str, value: Any) -> float:
    """A finite number.

    Raises:
        ConfigurationError: it is none.
    """
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise ConfigurationError(f"{key}={value!r} must be a number")
    return float(value)


def not_negative(key: str, value: Any) -> float:
    """A finite number of at least 0.

    Raises:
        ConfigurationError: it is none.
    """
    checked = number(key, value)
    if checked < 0.0:
        raise ConfigurationError(f"{key}={value!r} must not be negative")
    return checked


def yes_or_no(key: str, value: Any) -> bool:
    """A truth value.

    Raises:
        ConfigurationError: it is none.
    """
    if not isinstance(value, bool):
        raise ConfigurationError(f"{key}={value!r} must be true or false")
    return value


def numbers(key: str, value: Any) -> list[float]:
    """A list of finite numbers.

    Raises:
        ConfigurationError: it is none.
    """
    if not isinstance(value, (list, tuple)):
        raise ConfigurationError(f"{key}={value!r} must be a list of numbers")
    return [number(key, entry) for entry in value]


def vector(key: str, value: Any) -> np.ndarray:
    """Three finite numbers, shape (3,) [m].

    Raises:
        ConfigurationError: they are none.
    """
    import numpy as np

    checked = numbers(key, value)
    if len(checked) != 3:
        raise ConfigurationError(f"{key}={value!r} must be [x, y, z] in m")
    return np.array(checked)
