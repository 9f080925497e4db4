"""Driver profiles: which topics a driver has and what its ``effort`` is, as files of ``config/drivers`` say it.

A profile is data, and stated by the user: nothing of it holds before somebody names it.
"""

from __future__ import annotations

import difflib
import functools
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from proprio_ros.errors import ConfigurationError, one_line
from proprio_ros.inputs.forms import (
    Choice,
    Field,
    Form,
    FormError,
    Part,
    Perhaps,
    Text,
    section,
    shortly,
)
from proprio_ros.inputs.reading import path_problem, yaml_file
from proprio_ros.inputs.resources import resource, resource_names
from proprio_ros.inputs.signs import EFFORT_SIGN, Signs
from proprio_ros.quantity import EFFORTS, POSITIONS, Unit
from proprio_ros.recordings.effort import EFFORT_UNITS
from proprio_ros.recordings.read_options import POSITION_UNITS, TIME_UNITS, Columns
from proprio_ros.recordings.topics import FLOAT_ARRAYS, JOINT_STATE, Conventions, InputTopic

DEEPEST = 8  # files that extend each other
COLUMNS_FILE = "columns.yaml"  # beside tables, says which column is what
_TYPES = {"sensor_msgs/JointState": JOINT_STATE, "std_msgs/Float64MultiArray": FLOAT_ARRAYS[0]}
_SENTENCE = 500
_NAME = Text(what="a name")


@dataclass(frozen=True)
class _Texts(Form):
    """A list of texts."""

    each: Text = field(default_factory=Text)

    def read(self, value: Any) -> tuple[str, ...]:
        if not isinstance(value, list) or len(value) > 64:
            raise FormError(f"expected a list of at most 64 texts, got {shortly(value)}")
        return tuple(self.each.read(entry) for entry in value)

    def described(self) -> str:
        return f"a list, each {self.each.described()}"


@dataclass(frozen=True)
class _Topic(Text):
    """The name of a topic, without a namespace."""

    what: str = "a topic without a namespace"

    def read(self, value: Any) -> str:
        name = super().read(value)
        if name.startswith(("/", "~")) or " " in name:
            raise FormError(f"expected {self.what}, such as joint_states, got {shortly(value)}")
        return name


def _names(value: Any) -> dict[str, str]:
    """Texts by texts."""
    if not isinstance(value, dict) or len(value) > 1000:
        raise FormError(f"expected names by names, got {shortly(value)}")
    names = {_NAME.read(key): _NAME.read(entry) for key, entry in value.items()}
    twice = [name for name, count in Counter(names.values()).items() if count > 1]
    if twice:
        raise FormError(f"{twice[0]} stands for two joints; each needs a name of its own")
    return names


def _positions(*names: str) -> dict[str, Unit]:
    """Units of positions by the names that one file has for them."""
    return {name: POSITIONS[name] for name in names}


INPUT: dict[str, Form] = {
    "topic": _Topic("required"),
    "type": Choice("required; of a JointState its effort counts", tuple(_TYPES)),
    "unit": Choice("required; of its numbers", EFFORT_UNITS, EFFORTS),
    "joints": _Texts(
        "order of numbers that come without names; left out: the robot file's order", _NAME
    ),
}
"""Forms of one entry of ``inputs``."""


def _inputs(value: Any) -> tuple[InputTopic, ...]:
    """Topics of what drives the joints."""
    if not isinstance(value, list) or len(value) > 16:
        raise FormError(f"expected a list of at most 16 topics, got {shortly(value)}")
    return tuple(map(_input, value))


def _input(value: Any) -> InputTopic:
    given = section(
        value, {key: form if key == "joints" else Field(form) for key, form in INPUT.items()}
    )
    joints = given.get("joints", ())
    if len(set(joints)) != len(joints):
        raise FormError("joints: a joint is named twice")
    return InputTopic(
        given["topic"],
        _TYPES[given["type"]],
        given["unit"],
        joints,
    )


COLUMNS: dict[str, Form] = {
    "position": Text(
        "column of the joint positions; default observation.state. Of a table, * stands for the joint: `axis * angle`"
    ),
    "position_unit": Choice(
        "required; of the positions and goals", POSITION_UNITS, _positions(*POSITION_UNITS)
    ),
    "effort": Text(
        "column of measured effort; default observation.effort. Where there is none, entries of the positions' column that end in "
        ".torque, .effort or .current count"
    ),
    "goal": Text("column of what the joints were sent to; default action"),
    "percent": _Texts(
        "joints, in the data set's names, whose positions are percent of their range", _NAME
    ),
    "time": Text("of a table: column of its times; default that of such a name"),
    "time_unit": Choice("of a table: what its times are in", TIME_UNITS),
    "velocity": Text("of a table: columns of velocities, as for `position`"),
    "effort_unit": Choice(
        "of a table: what effort is in where headers do not say it", EFFORT_UNITS, EFFORTS
    ),
    "command": Text("of a table: columns of what drove the joints, as for `position`"),
    "command_unit": Choice("of a table: what these are in", EFFORT_UNITS, EFFORTS),
    "joints": _Texts(
        "of a table: the joints whose columns are numbered, in order; default the robot file's order",
        _NAME,
    ),
}
"""Forms of the keys of ``columns``."""


def _columns(value: Any) -> Columns:
    """What the columns of a LeRobot data set or a table are."""
    columns = Columns(**section(value, COLUMNS))
    if columns.position_unit is None:
        raise FormError("position_unit is missing; a data set does not say it")
    return columns


def columns_files(recordings: Iterable[str | Path]) -> tuple[str, ...]:
    """The files that say which column is what, beside any of these recordings, sorted."""
    beside = {Path(recording).parent / COLUMNS_FILE for recording in recordings}
    return tuple(sorted(str(path) for path in beside if path.is_file()))


def columns_beside(table: Path) -> dict[str, Any]:
    """What ``columns.yaml`` in a table's folder says of its columns, by key; nothing where there is none.

    Raises `ConfigurationError`: It is wrong.
    """
    path = table.parent / COLUMNS_FILE
    if not path.is_file():
        return {}
    try:
        return dict(section(yaml_file(path, ConfigurationError), COLUMNS))
    except FormError as error:
        raise ConfigurationError(f"{path}: {error}") from None


FORMS: dict[str, Form] = {
    "extends": Text(
        "profile whose keys hold where this file has none: a name, or a file beside it", "a profile"
    ),
    "title": Text("the driver, in a few words; required", longest=_SENTENCE),
    "states": _Topic("topic of the joint states, in any namespace; default joint_states"),
    "effort_unit": Perhaps(
        "what effort of the joint states is; null: the profile does not say, so that `--effort-unit` or the robot file must",
        Choice(words=EFFORT_UNITS, units=EFFORTS),
    ),
    "effort_sign": EFFORT_SIGN,
    "position_unit": Choice(
        "of positions and velocities, goals among them; default rad. Degrees are read from bags, not live",
        ("rad", "degree"),
        _positions("rad", "degree"),
    ),
    "inputs": Part(
        "what drives the joints: the first that a bag has, else measured effort; default none",
        "a list of topic, type, unit and joints",
        by=_inputs,
    ),
    "joint_prefix": Text("before the names of this robot's joints; it is taken off"),
    "joint_names": Part(
        "of joints that the driver calls otherwise than the URDF, once the prefix is off",
        "the robot's name by the driver's",
        by=_names,
    ),
    "refused": Text(
        "why nothing can be weighed with such recordings; they are then refused with it",
        longest=200,
    ),
    "notes": _Texts("what to know about it; `proprio check` says it", Text(longest=_SENTENCE)),
    "columns": Part(
        "what the columns of a LeRobot data set, or of a table, are; without it no data set can be read",
        "keys of columns",
        by=_columns,
    ),
    "recognised_by": _Texts(
        "topics, types of messages, or columns of a table, of which any identifies the driver; `proprio check` names it then"
    ),
}
"""Forms of the keys of a profile."""


@dataclass(frozen=True)
class Driver:
    """A profile."""

    # name, title: what the user called it, and what it is in a few words
    name: str
    title: str
    conventions: Conventions  # its topics, and their units
    effort_unit: str | None = None  # what effort of its joint states is; None where it does not say
    refused: str = ""  # why nothing can be weighed with it, or an empty string
    notes: tuple[str, ...] = ()  # what to know about it, one sentence each
    effort_sign: Signs = field(default_factory=Signs)  # by what its efforts are multiplied
    # topics without a namespace, or types, of which any identifies it
    recognised_by: tuple[str, ...] = ()
    extends: tuple[str, ...] = ()  # names of the profiles that it extends
    columns: Columns | None = None  # what the columns of a data set are; None where it does not say

    def fits(
        self,
        topics: Iterable[tuple[str, str]],
    ) -> bool:
        """Whether any of these topics, by name and type, identifies it."""
        return any(
            kind == known or name.endswith(f"/{known}")
            for name, kind in topics
            for known in self.recognised_by
        )


def load_driver(name_or_path: str | Path) -> Driver:
    """Read a profile of ``config/drivers``, or from the path of a YAML file; refuses it in one line (`ConfigurationError`)."""
    name = str(name_or_path)
    settings, parents = _settings(name, Path(), ())
    if "title" not in settings:
        raise ConfigurationError(
            f"{_called(name)}: title is missing; say in a few words which driver it is"
        )
    ours = Conventions(
        driver=name,
        states=settings.get("states", "joint_states"),
        inputs=settings.get("inputs", ()),
        prefix=settings.get("joint_prefix", ""),
        names=settings.get("joint_names", {}),
        radians=POSITIONS[settings.get("position_unit", "rad")].in_si,
    )
    of_driver = (
        "title",
        "effort_unit",
        "effort_sign",
        "refused",
        "notes",
        "recognised_by",
        "columns",
    )
    stated = {key: settings[key] for key in of_driver if key in settings}
    return Driver(name, conventions=ours, extends=parents, **stated)


def drivers_of(topics: Iterable[tuple[str, str]]) -> tuple[Driver, ...]:
    """The package's profiles that topics, by name and type, identify, without those that another of them extends."""
    topics = list(topics)
    fitting = [driver for driver in _shipped() if driver.fits(topics)]
    extended = {name for driver in fitting for name in driver.extends}
    return tuple(driver for driver in fitting if driver.name not in extended)


@functools.cache
def _shipped() -> tuple[Driver, ...]:
    return tuple(map(load_driver, resource_names("drivers")))


def _called(name: str) -> str:
    return f"driver {one_line(name, 60)}"


def _located(name: str, folder: Path) -> Path:
    if Path(name).suffix not in (".yaml", ".yml"):
        names = resource_names("drivers")
        if name in names:
            return resource("drivers", name)
        close = [each for each in names if name and each.startswith(name)]
        close = close or difflib.get_close_matches(name[:100], names, n=1)
        hint = f"did you mean {' or '.join(close)}? " if close else ""
        raise ConfigurationError(
            f"{_called(name)}: unknown; {hint}choose one of {', '.join(names)}, or give a .yaml file"
        )
    path = folder / name
    problem = path_problem(path) or ("" if path.is_file() else "there is no such file")
    if problem:
        raise ConfigurationError(f"{_called(name)}: {problem}")
    return path


def _settings(
    name: str,
    folder: Path,
    above: tuple[str, ...],
) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Keys and values of a profile and of those that it extends, and the names of the latter."""
    if len(above) == DEEPEST:
        raise ConfigurationError(
            f"{_called(above[0])}: extends: more than {DEEPEST} files extend each other"
        )
    path = _located(name, folder)
    content = yaml_file(path, ConfigurationError, _called(name))
    try:
        own = section(content, FORMS)
    except FormError as error:
        raise ConfigurationError(f"{_called(name)}: {error}") from None
    if "extends" not in own:
        return own, ()
    parent = own.pop("extends")
    inherited, parents = _settings(parent, path.parent, (*above, name))
    return inherited | own, (parent, *parents)
