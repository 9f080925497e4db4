"""Which column of a table is what, and in which unit: by its headers, a driver's profile or a columns file; never guessed.

What a header leaves open is stated, or follows from numbers in one way only: a log whose time goes on by 8 is in ms, since no robot
is logged every 8 s or every 8 us. Whether an angle is in degrees numbers do not show, and it is asked.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from proprio_ros.errors import RecordingError, some
from proprio_ros.inputs.forms import shortly
from proprio_ros.quantity import POSITIONS
from proprio_ros.recordings.headers import (
    DRIVING,
    Header,
    HeaderUnit,
    Kind,
    as_kind,
    header_of,
    is_numbered_joint,
    plain,
    without_unit,
)
from proprio_ros.recordings.joint_names import fitted_names
from proprio_ros.recordings.read_options import EFFORT, GOAL, POSITION, Columns, ReadOptions

BESIDE = (Kind.VELOCITY, Kind.EFFORT, Kind.COMMAND, Kind.GOAL)
"""What is read of each joint beside its position."""
_WORDS_OF = {"N.m": Kind.TORQUE, "A": Kind.CURRENT, "mA": Kind.CURRENT}
"""What a header that says torque or current says against a unit that is stated."""


@dataclass(frozen=True)
class Column:
    """A column of one joint."""

    place: int  # in the table
    header: Header
    joint: str  # in the driver's names
    factor: float = 1.0  # of its numbers to what they are read as


@dataclass(frozen=True)
class Layout:
    """What is read of a table."""

    time: Column
    time_unit: str | None  # as header or file say; None: numbers must show it
    joints: Mapping[Kind, tuple[Column, ...]]
    effort_unit: str | None  # of the columns of effort, as far as headers or file say it
    command_unit: str | None
    notes: tuple[str, ...]

    def of(self, kind: Kind) -> tuple[Column, ...]:
        """The columns of a kind."""
        return self.joints.get(kind, ())

    @property
    def places(self) -> list[int]:
        """Of all columns but the time."""
        return [column.place for columns in self.joints.values() for column in columns]

    def meanings(self, headers: Sequence[str]) -> tuple[tuple[str, str], ...]:
        """What each header that is read is taken for; the others with an empty text."""
        said = {self.time.place: f"time in {self.time_unit}" if self.time_unit else "time"}
        units = {Kind.EFFORT: self.effort_unit, Kind.COMMAND: self.command_unit}
        for kind, columns in self.joints.items():
            for column in columns:
                unit = units.get(kind)
                said[column.place] = f"{kind.value} of {column.joint}" + (
                    f" in {unit}" if unit else ""
                )
        return tuple((header, said.get(place, "")) for place, header in enumerate(headers))


@dataclass(frozen=True)
class _Stated:
    """A table's headers, and what is stated of them."""

    path: Path
    headers: tuple[Header, ...]
    columns: Columns
    options: ReadOptions
    advice: str  # how to state what nobody says
    # names of joints that are the robot's but for a prefix or a suffix
    others: tuple[str, ...] = ()

    def error(self, words: str) -> RecordingError:
        return RecordingError(words, self.path)

    def ask(self, words: str) -> RecordingError:
        """A refusal of what nobody says."""
        return self.error(f"{words}: {self.advice}")

    @property
    def order(self) -> list[str]:
        """Joints that are numbered, in the driver's names."""
        stated = list(self.columns.joints)
        return stated or [self.options.conventions.published(j) for j in self.options.joint_order]

    @property
    def known(self) -> dict[str, str]:
        """The driver's names of the robot's joints, by what may stand for them in plain letters."""
        published = self.options.conventions.published
        robot = dict.fromkeys([*self.options.joint_order, *self.options.limits])
        own = {plain(name): published(name) for name in robot}
        theirs = {plain(published(name)): published(name) for name in robot}
        stated = {plain(name): name for name in self.columns.joints}
        return own | theirs | stated | {name: name for name in self.others}


def layout_of(
    path: Path, headers: Sequence[str], columns: Columns, options: ReadOptions, advice: str
) -> Layout:
    """What is read of a table.

    Args:
        path: Of the table.
        headers: Of its columns.
        columns: What a profile or a file says of them.
        options: How it is read, with the robot's joints and the driver's names of them.
        advice: How to state what nobody says, for a refusal.

    Returns:
        The layout.

    Raises:
        RecordingError: There is no time or no position, two columns may be the same thing, or units contradict each other.
    """
    given = _Stated(path, tuple(map(header_of, headers)), columns, options, advice)
    given = _with_other_names(given)
    time = _time(given)
    positions = _numbered_or_named(given, Kind.POSITION, _called(given, Kind.POSITION))
    if not positions:
        raise _no_position(given)
    found = {kind: _numbered_or_named(given, kind, _called(given, kind)) for kind in BESIDE}
    found[Kind.POSITION] = positions
    effort_unit, efforts = _efforts(given, found[Kind.EFFORT])
    command_unit, commands, notes = _commands(given, found[Kind.COMMAND])
    found |= {Kind.EFFORT: efforts, Kind.COMMAND: commands}
    found = _in_si(given, found)
    _refuse_twice(given, [time, *(column for each in found.values() for column in each)])
    notes = (*_numbers_noted(given, found), *notes)
    unit = columns.time_unit
    stated = time.header.unit
    if stated is not None:
        if unit not in (None, stated.called):
            raise given.error(f"{time.header.text} says {stated.called}, and time_unit {unit}")
        unit = stated.called
    return Layout(time, unit, found, effort_unit, command_unit, notes)


def effort_unit_of(headers: Sequence[str], columns: Columns) -> str | None:
    """What measured effort is in, by headers alone or a file beside them; None where they do not say it in one way."""
    parsed = [header_of(header) for header in headers]
    joints = {header.joint for header in parsed if header.kind is Kind.POSITION}
    driving = [
        each
        for each in parsed
        if each.kind in DRIVING and (each.number is not None or each.joint in joints)
    ]
    units = {each.unit.called if each.unit else "" for each in driving}
    return (units.pop() if len(units) == 1 else "") or columns.effort_unit


# ---------------------------------------------------------------- which column is what


def _time(given: _Stated) -> Column:
    stated = given.columns.time
    if stated:
        found = [place for place, each in enumerate(given.headers) if each.text == stated]
    else:
        found = [place for place, each in enumerate(given.headers) if each.kind is Kind.TIME]
    if not found:
        missing = f"no column {stated}" if stated else "no column of time (t, time, timestamp)"
        raise given.error(f"{missing}; there are: {_listed(given)}")
    if len(found) > 1:
        which = ", ".join(given.headers[place].text for place in found)
        raise given.error(
            f"{len(found)} columns of time, {which}: say in columns.yaml which (time)"
        )
    header = given.headers[found[0]]
    header = header if header.kind is Kind.TIME else Header(header.text, Kind.TIME)
    if header.unknown_unit:
        raise given.error(
            f"{header.text}: unit {shortly(header.unknown_unit)} is not known; use s, ms, us or ns"
        )
    return Column(found[0], header, "")


def _with_other_names(given: _Stated) -> _Stated:
    """The same with names that differ from the robot's by a prefix or a suffix, where no position has a name of the robot's."""
    headers = [header for _, header in _called(given, Kind.POSITION)]
    names = [header.joint for header in headers if header.number is None and header.joint]
    if any(header.number is not None or header.joint in given.known for header in headers):
        return given
    renamed = given.options.conventions.renamed(names)
    fitted = fitted_names(given.path, renamed, given.options)
    others = [name for name, ours in zip(names, renamed, strict=True) if ours in fitted.names]
    return replace(given, others=tuple(others))


def _called(given: _Stated, kind: Kind) -> list[tuple[int, Header]]:
    """Columns of a kind, as the user calls them or else by their words."""
    asked = {
        Kind.POSITION: (given.columns.position, POSITION),
        Kind.VELOCITY: (given.columns.velocity, ""),
        Kind.EFFORT: (given.columns.effort, EFFORT),
        Kind.COMMAND: (given.columns.command, ""),
        Kind.GOAL: (given.columns.goal, GOAL),
    }
    pattern, default = asked[kind]
    if pattern != default:
        return _fitting(given, kind, pattern)
    kinds = DRIVING if kind is Kind.EFFORT else (kind,)
    found = [(place, each) for place, each in enumerate(given.headers) if each.kind in kinds]
    if kind is not Kind.POSITION or found:
        return found
    alone = [
        (place, each) for place, each in enumerate(given.headers) if _only_a_joint(given, each)
    ]
    return [(place, as_kind(each, Kind.POSITION)) for place, each in alone]


def _only_a_joint(given: _Stated, header: Header) -> bool:
    """Whether a header is the name of a joint, or its number as in ``joint3``, and nothing else."""
    return is_numbered_joint(header) or (header.kind is None and header.joint in given.known)


def _fitting(given: _Stated, kind: Kind, pattern: str) -> list[tuple[int, Header]]:
    """Columns that fit what the user calls them; ``*`` stands for the joint, or a number comes behind."""
    ending = r"[\s_.\[]*(\d+)\]?" if "*" not in pattern else ""
    expression = re.escape(pattern).replace(r"\*", "(.+?)") + ending
    found = []
    for place, header in enumerate(given.headers):
        fit = re.fullmatch(expression, without_unit(header.text)) or re.fullmatch(
            expression, header.text
        )
        header = as_kind(header, kind)
        if fit is None and header.text == pattern:
            found.append((place, replace(header, kind=kind, joint="", number=None)))
        elif fit is not None:
            name = fit[1].strip()
            number = int(name) if name.isdigit() else None
            found.append((place, replace(header, kind=kind, joint=plain(name), number=number)))
    if not found and kind not in (Kind.VELOCITY, Kind.GOAL):  # which are not needed
        raise given.error(f"no column {pattern}; there are: {_listed(given)}")
    return found


def _numbered_or_named(
    given: _Stated, kind: Kind, headers: Sequence[tuple[int, Header]]
) -> tuple[Column, ...]:
    """Columns with their joints: those that name one, else those that are numbered, else the only one of a robot's only joint."""
    known = given.known
    columns = [
        Column(place, header, known[header.joint])
        for place, header in headers
        if header.joint in known
    ]
    numbered = [(place, header) for place, header in headers if header.number is not None]
    if not columns and numbered:
        columns = _in_the_order(given, kind, numbered)
    if not columns and len(headers) == 1 == len(given.order) and not headers[0][1].joint:
        columns = [Column(*headers[0], given.order[0])]
    return tuple(columns)


def _in_the_order(
    given: _Stated, kind: Kind, numbered: Sequence[tuple[int, Header]]
) -> list[Column]:
    """Numbered columns as the robot's joints; refuses a number of them that the robot has not."""
    numbers = sorted({header.number or 0 for _, header in numbered})
    names = f"{numbered[0][1].text} .. {numbered[-1][1].text}"
    order = given.order
    first = numbers[0]
    if first not in (0, 1) or numbers != list(range(first, first + len(order))):
        raise given.error(
            f"{names} are {kind.value} of {len(numbers)} joints by number, and the robot has {len(order)} ({', '.join(order)}): "
            "name the joints in the header, or say which they are in columns.yaml (joints: [..])"
        )
    return [
        Column(place, header, order[(header.number or 0) - numbers[0]])
        for place, header in numbered
    ]


def _refuse_twice(given: _Stated, columns: Iterable[Column]) -> None:
    """Raises `RecordingError`: Two columns may be the same thing."""
    texts = [header.text for header in given.headers]
    seen: dict[tuple[Kind | None, str], str] = {}
    for column in columns:
        text = column.header.text
        if texts.count(text) > 1:
            raise given.error(
                f"{texts.count(text)} columns are called {shortly(text)}: rename all but the right one"
            )
        kind = Kind.EFFORT if column.header.kind in DRIVING else column.header.kind
        other = seen.setdefault((kind, column.joint), text)
        if other != text:
            raise given.error(
                f"{other} and {text} may both be the {kind.value if kind else ''} of {column.joint}: say which in columns.yaml"
            )


def _no_position(given: _Stated) -> RecordingError:
    robot = some(given.order, 4)
    return given.error(
        f"no column is the position of a joint of the robot ({robot}): call them q0, q1 .. or {given.order[0]}_position, or say "
        f"in columns.yaml which they are; there are: {_listed(given)}"
    )


def _listed(given: _Stated) -> str:
    return some([header.text for header in given.headers if header.text], 8)


def _numbers_noted(given: _Stated, found: Mapping[Kind, tuple[Column, ...]]) -> tuple[str, ...]:
    """A sentence on joints that are numbered, where nobody says whose numbers these are."""
    numbered = [
        columns
        for columns in found.values()
        if not given.columns.joints
        and any(plain(each.joint) not in plain(each.header.text) for each in columns)
    ]
    if not numbered:
        return ()
    which = ", ".join(f"{each[0].header.text} .. {each[-1].header.text}" for each in numbered)
    joints = ", ".join(column.joint for column in numbered[0])
    return (f"{which} were read as {joints}, the robot's order.",)


# ---------------------------------------------------------------- units


def _efforts(given: _Stated, columns: tuple[Column, ...]) -> tuple[str | None, tuple[Column, ...]]:
    """What effort is in, and its columns: of torques and currents those that are meant."""
    stated = given.options.effort.unit or given.columns.effort_unit
    kinds = {column.header.kind for column in columns}
    if {Kind.TORQUE, Kind.CURRENT} <= kinds:
        wanted = _WORDS_OF.get(stated or "")
        if wanted is None:
            raise given.error(
                "both torques and currents are there: say which of them count, --effort-unit N.m or A"
            )
        columns = tuple(column for column in columns if column.header.kind is wanted)
    if not columns:
        return stated, ()
    unit = _one_unit(given, columns) or given.columns.effort_unit or stated
    called = columns[0].header.text
    if stated is not None and unit != stated:
        raise given.error(
            f"{called} is in {unit}, and {stated} is stated: --effort-unit {unit} corrects it"
        )
    means = _WORDS_OF.get(unit or "")
    word = columns[0].header.kind
    if word in (Kind.TORQUE, Kind.CURRENT) and means not in (None, word):
        raise given.error(
            f"{called} is called a {word.value}, and {unit} is stated: correct that, or say in columns.yaml (effort) which "
            "columns are meant"
        )
    return unit, _scaled(columns)


def _commands(
    given: _Stated, columns: tuple[Column, ...]
) -> tuple[str | None, tuple[Column, ...], tuple[str, ...]]:
    """What commands are in, their columns, and a note where they are left out because nobody says it."""
    named = given.options.conventions.driver and not given.options.conventions.inputs
    if not columns or (named and not given.columns.command):
        return None, (), ()
    unit = _one_unit(given, columns) or given.columns.command_unit
    word = plain(columns[0].header.text)
    if unit is None and "applied_effort" in word:
        unit = "N.m"
    if unit is None and "current_command" in word:
        unit = "A"
    if unit is None:
        note = f"{columns[0].header.text} has no unit, and was not read; [A] or [Nm] behind its name says it."
        return None, (), (note,)
    return unit, _scaled(columns), ()


def _one_unit(given: _Stated, columns: Sequence[Column]) -> str | None:
    """The unit that all these headers state; None where none states one."""
    _refuse_unknown(given, columns)
    units = {column.header.unit.called if column.header.unit else None for column in columns}
    if len(units) > 1:
        shown = ", ".join(sorted(unit or "no unit" for unit in units))
        raise given.error(
            f"{columns[0].header.text} .. {columns[-1].header.text} are in {shown}: give them one unit"
        )
    return units.pop() if units else None


def _refuse_unknown(given: _Stated, columns: Sequence[Column]) -> None:
    for column in columns:
        if column.header.unknown_unit:
            kind = column.header.kind
            raise given.error(
                f"{column.header.text}: unit {shortly(column.header.unknown_unit)} of a {kind.value if kind else 'number'} is "
                "not known; angles are in rad or deg, slides in m or mm, efforts in Nm, A or mA"
            )


def _scaled(columns: Iterable[Column]) -> tuple[Column, ...]:
    return tuple(
        replace(column, factor=column.header.unit.factor) if column.header.unit else column
        for column in columns
    )


def _in_si(
    given: _Stated, found: Mapping[Kind, tuple[Column, ...]]
) -> dict[Kind, tuple[Column, ...]]:
    """All columns with their factors. Raises `RecordingError`: Nobody says what positions are in, or two say different things."""
    stated = given.columns.position_unit
    if stated is None and given.options.conventions.driver:
        stated = "rad" if given.options.conventions.radians == 1.0 else "degree"
    factor = POSITIONS[stated].in_si if stated else 1.0
    positions = found[Kind.POSITION]
    _refuse_unknown(given, [*positions, *found[Kind.VELOCITY], *found[Kind.GOAL]])
    bare = [column.header.text for column in positions if column.header.unit is None]
    if bare and stated is None:
        which = bare[0] if len(bare) == 1 else f"{bare[0]} .. {bare[-1]}"
        raise given.ask(f"nobody says whether {which} is in rad or degrees")
    for column in positions:
        if stated and _contradicts(column.header.unit, factor):
            raise given.error(
                f"{column.header.text} has another unit than is stated ({stated}): leave that out, or correct it"
            )
    positions = _with_factor(positions, dict.fromkeys((c.joint for c in positions), factor))
    by_joint = {column.joint: column.factor for column in positions}
    return {
        **found,
        Kind.POSITION: positions,
        Kind.VELOCITY: _with_factor(found[Kind.VELOCITY], by_joint),
        Kind.GOAL: _with_factor(found[Kind.GOAL], by_joint),
    }


def _contradicts(unit: HeaderUnit | None, factor: float) -> bool:
    """Whether a header states an angle in another unit than the one with this factor; a slide is in m all the same."""
    return unit is not None and unit.called == "rad" and unit.factor != factor


def _with_factor(columns: Sequence[Column], factors: Mapping[str, float]) -> tuple[Column, ...]:
    """The same with what makes SI of their numbers: their own unit, or that of their joint's positions."""
    return tuple(
        replace(
            column,
            factor=column.header.unit.factor
            if column.header.unit
            else factors.get(column.joint, 1.0),
        )
        for column in columns
    )
