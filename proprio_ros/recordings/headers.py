"""What the header of a table's column says: time, position, effort .., of which joint, in which unit; nothing that is not plain.

Words are those that recorders use: ``q0``, ``actual_q_0`` (UR's RTDE), ``state.dq[3]`` (libfranka), ``shoulder_position [deg]``,
``/joint_states/elbow/effort`` (PlotJuggler). What a word alone does not say (whether an angle is in degrees) is not read into it.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from enum import Enum

from proprio_ros.quantity import EFFORTS, POSITIONS, unit_called


class Kind(Enum):
    """What the numbers of a column are."""

    TIME = "time"
    POSITION = "position"
    VELOCITY = "velocity"
    TORQUE = "torque"
    CURRENT = "current"
    EFFORT = "effort"  # a torque or a current
    GOAL = "goal"  # a position that was asked for
    COMMAND = "command"  # a torque or a current that was asked for


DRIVING = (Kind.TORQUE, Kind.CURRENT, Kind.EFFORT)
"""Kinds of measured effort."""

_TIMES = {"t", "time", "times", "timestamp", "time_stamp", "stamp"}
_WORDS = {
    **dict.fromkeys(("q", "pos", "position", "positions", "angle", "angles"), Kind.POSITION),
    **dict.fromkeys(("dq", "qdot", "vel", "velocity", "velocities"), Kind.VELOCITY),
    **dict.fromkeys(("tau", "torque", "torques", "moment"), Kind.TORQUE),
    **dict.fromkeys(("current", "currents"), Kind.CURRENT),
    **dict.fromkeys(("effort", "efforts"), Kind.EFFORT),
}
_ASKED = {"cmd", "command", "commanded", "target", "desired", "des", "d", "ref", "reference"}
_ASKED |= {"goal", "set", "setpoint", "applied"}
"""Words of what was asked for, not measured."""
_MEASURED = {"actual", "measured", "meas", "state", "states", "present", "feedback"}
_MEASURED |= {"msg", "field"}
"""Words that add nothing."""
_NUMBERED = {"joint", "joints", "axis", "motor", "j", "a"}
"""Words before the number of a joint."""


@dataclass(frozen=True)
class HeaderUnit:
    """A unit as headers write it."""

    kinds: tuple[Kind, ...]  # of columns that may have it
    called: str  # the unit that numbers are turned into
    factor: float  # how much of that one of it is


_ANGLE, _SPEED = (Kind.POSITION, Kind.GOAL), (Kind.VELOCITY,)
_TORQUE = (Kind.TORQUE, Kind.EFFORT, Kind.COMMAND)
_CURRENT = (Kind.CURRENT, Kind.EFFORT, Kind.COMMAND)
_DEGREE = POSITIONS["deg"].in_si


def _units(kinds: tuple[Kind, ...], called: str, **factors: float) -> dict[str, HeaderUnit]:
    return {name: HeaderUnit(kinds, called, factor) for name, factor in factors.items()}


_MORE: tuple[dict[str, HeaderUnit], ...] = (
    _units((Kind.TIME,), "s", **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), 1.0)),
    _units((Kind.TIME,), "ms", **dict.fromkeys(("ms", "msec", "millisecond", "milliseconds"), 1.0)),
    _units((Kind.TIME,), "us", **dict.fromkeys(("us", "µs", "μs", "usec", "microseconds"), 1.0)),
    _units((Kind.TIME,), "ns", **dict.fromkeys(("ns", "nsec", "nanosecond", "nanoseconds"), 1.0)),
    _units(_ANGLE, "rad", mrad=1e-3),
    _units(_ANGLE, "m", m=1.0, mm=1e-3),
    _units(_SPEED, "rad/s", **dict.fromkeys(("rad/s", "rads", "rads1", "radians/s"), 1.0)),
    _units(_SPEED, "rad/s", **dict.fromkeys(("deg/s", "degs", "°/s", "degrees/s"), _DEGREE)),
    _units(_SPEED, "rad/s", rpm=math.pi / 30.0),
    _units(_SPEED, "m/s", **{"m/s": 1.0, "mm/s": 1e-3}),
    _units(_TORQUE, "N.m", ncm=1e-2, mnm=1e-3),
)
"""Units that only headers have, beside those of `POSITIONS` and `EFFORTS`."""


@dataclass(frozen=True)
class Header:
    """What a header says."""

    text: str  # as it is written
    kind: Kind | None = None  # None: nothing that is plain
    # the name of a joint in plain letters, or its number; empty where it names none
    joint: str = ""
    unit: HeaderUnit | None = None
    unknown_unit: str = ""  # what stands where a unit does, and is none of this kind
    # words of a joint's name that may as well be no part of it: `joint3` is the third joint where none is called so
    number: int | None = None


def plain(text: str) -> str:
    """Lower case letters and digits with one ``_`` between what was anything else."""
    return re.sub(r"[^0-9a-z]+", "_", text.lower()).strip("_")


def header_of(text: str) -> Header:
    """What a header says by itself."""
    bare, unit = _split_unit(text)
    words = plain(bare).removeprefix("joint_states_").replace("q_dot", "qdot").split("_")
    if "_".join(words) in _TIMES or _is_stamp(words):
        return _with_unit(Header(text, Kind.TIME), unit)
    if not unit and words[0] in _TIMES and len(words) == 2 and unit_of(words[1], Kind.TIME):
        return _with_unit(Header(text, Kind.TIME), words[1])
    if not unit:
        words, unit = _without_ending(words, bare)
    kind, rest = _kind_of(_apart(words), unit)
    return _with_unit(Header(text, kind, "_".join(rest), number=_number_of(rest)), unit)


def is_numbered_joint(header: Header) -> bool:
    """Whether a header is the number of a joint, as ``joint3``, and nothing else: its position."""
    numbered = re.match(r"(joint|axis)", header.joint)
    return header.kind is None and header.number is not None and numbered is not None


def as_kind(header: Header, kind: Kind) -> Header:
    """The same of a header that is stated to be of a kind, with its unit as one of that kind."""
    bare, unit = _split_unit(header.text)
    unit = unit or _without_ending(plain(bare).split("_"), bare)[1]
    return _with_unit(replace(header, kind=kind, unit=None, unknown_unit=""), unit)


def without_unit(text: str) -> str:
    """A header without the unit in brackets behind it."""
    return _split_unit(text)[0]


def _is_stamp(words: list[str]) -> bool:
    return words[-1] in _TIMES and set(words[:-1]) <= {"header", *_MEASURED}


def _split_unit(text: str) -> tuple[str, str]:
    """The header without a unit in brackets, and that unit; an index in brackets is none."""
    found = re.match(r"(?s)(.*\S)\s*[\[(]([^\[\]()]*)[\])]\s*$", text)
    if found is None or found[2].strip().isdigit():
        return text, ""
    return found[1], found[2].strip()


_ENDINGS = ("rad_s", "deg_s", "n_m", "rad", "deg", "degrees", "nm", "mnm", "ma", "rpm")


def _without_ending(words: list[str], text: str) -> tuple[list[str], str]:
    """Words without a unit at their end, such as ``q1_deg``, and that unit."""
    if "current" in words[:-1] and re.search(r"[_ ]A$", text):
        return words[:-1], "A"
    joined = "_".join(words)
    for ending in _ENDINGS:
        if joined.endswith(f"_{ending}"):
            rest = joined.removesuffix(f"_{ending}").split("_")
            return rest, ending.replace("d_s", "d/s").replace("g_s", "g/s")
    return words, ""


def _apart(words: list[str]) -> list[str]:
    """The words with the number of ``q0`` or ``tau3`` as one of its own; ``joint3`` stays."""
    found: list[str] = []
    for word in words:
        glued = re.fullmatch(r"([a-z]+)(\d+)", word)
        found += list(glued.groups()) if glued and glued[1] in _WORDS.keys() | _ASKED else [word]
    return found


def _kind_of(words: list[str], unit: str) -> tuple[Kind | None, list[str]]:
    """What words and unit say that numbers are, and the words that are left: the joint."""
    nouns = [word for word in words if word in _WORDS]
    asked = any(word in _ASKED for word in words)
    rest = [word for word in words if word not in _WORDS and word not in _ASKED | _MEASURED]
    # "current position" is the present one, "torque current" one that makes torque; other pairs say nothing plain
    adjectives = {_WORDS[noun] for noun in nouns[:-1]}
    if not nouns and asked:
        kind = _asked_by_unit(words, unit)
        return kind, rest if kind else words
    if not nouns or not adjectives <= {Kind.CURRENT, Kind.TORQUE}:
        return None, words
    kind = _WORDS[nouns[-1]]
    if Kind.TORQUE in adjectives and kind is not Kind.CURRENT:
        return None, words
    if not asked:
        return kind, rest
    if kind is Kind.VELOCITY:
        return None, words
    return Kind.GOAL if kind is Kind.POSITION else Kind.COMMAND, rest


def _asked_by_unit(words: list[str], unit: str) -> Kind | None:
    """What was asked for where no word says it, such as ``cmd3 [A]``."""
    if unit and unit_of(unit, Kind.COMMAND):
        return Kind.COMMAND
    if (unit and unit_of(unit, Kind.GOAL)) or {"goal", "setpoint"} & set(words):
        return Kind.GOAL
    return None


def _number_of(words: list[str]) -> int | None:
    """The number of a joint, where the words say no more than that."""
    letters = "".join(word for word in words if not word.isdigit())
    bare = re.fullmatch(r"([a-z]*)(\d*)", letters)
    digits = [word for word in words if word.isdigit()]
    if bare is None or bare[1] not in {"", *_NUMBERED}:
        return None
    digits += [bare[2]] if bare[2] else []
    return int(digits[0]) if len(digits) == 1 and len(digits[0]) < 4 else None


def _with_unit(header: Header, text: str) -> Header:
    """The same with the unit that stands in it, as far as its kind can have it."""
    if not text or header.kind is None:
        return header
    unit = unit_of(text, header.kind)
    return replace(header, unit=unit, unknown_unit="" if unit else text)


def unit_of(text: str, kind: Kind) -> HeaderUnit | None:
    """A unit of a kind of column by its name, however that is written; None where it is none."""
    effort = unit_called(text, EFFORTS)
    if effort in EFFORTS and kind in (_TORQUE if effort == "N.m" else _CURRENT):
        return HeaderUnit((kind,), effort, 1.0)
    angle = unit_called(text, POSITIONS)
    if angle in POSITIONS and kind in _ANGLE:
        return HeaderUnit((kind,), "rad", POSITIONS[angle].in_si)
    name = re.sub(r"[\s*·⋅.\-_^]", "", text.lower())
    found = (units[name] for units in _MORE if name in units)
    return next((unit for unit in found if kind in unit.kinds), None)
