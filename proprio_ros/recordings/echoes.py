"""Joint states as ROS' own tools print them: `ros2 topic echo --csv`, and `rostopic echo -p` of ROS 1.

The first writes a message's fields in the order of its definition, without a header: seconds, nanoseconds, frame, names, positions,
velocities, efforts; an array without entries is one empty cell. The second has a header that begins with ``%time`` and numbers the
entries of arrays (``field.name0``); times are in ns, and arrays without entries are left out.

Sources: `message_to_csv` of ros2/rosidl_runtime_py (convert.py), `_str_plot` of ros/ros_comm (rostopic/__init__.py), and
sensor_msgs/JointState.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, product
from pathlib import Path

import numpy as np

from proprio_ros.errors import RecordingError, some
from proprio_ros.inputs.forms import shortly

UNITS = {"position": " [rad]", "velocity": " [rad/s]", "effort": ""}
"""Fields of a joint state, in its order, with what a header says of their units: in a slide's position [rad] counts as m."""
STAMP = "header.stamp"
_ROSTOPIC = re.compile(r"%time,field\.")
_ENTRY = re.compile(r"field\.(name|position|velocity|effort)(\d+)")
_CUT = "..."  # stands where `ros2 topic echo` broke an array or a text off
_MORE = {"", "True", "False"}  # what some releases print behind the last field
_NOISE = re.compile(r"\s|A message was lost|WARNING|total count|---")
_FEWEST = 5  # cells of a message with one joint: stamp, frame, name, position
BROKEN = "the last line breaks off, as of a recorder that was killed; it was left out."


@dataclass(frozen=True)
class Echo:
    """One message."""

    stamp_ns: int
    values: Mapping[tuple[str, str], float]  # by joint and field


@dataclass(frozen=True)
class Echoes:
    """All messages of a file, R of them."""

    headers: tuple[str, ...]  # the stamp first
    stamps_ns: tuple[int, ...]
    columns: tuple[
        np.ndarray, ...
    ]  # of the headers behind the first, NaN where a message has none, (R,)
    notes: tuple[str, ...]


def first_of(lines: Sequence[str]) -> str:
    """The first line that is a message, or a header; empty where there is none."""
    return next((line for line in lines if line.strip() and not _is_beside(line)), "")


def _is_beside(line: str) -> bool:
    """Whether a line is what a tool says beside messages."""
    return "," not in line or _NOISE.match(line) is not None


def is_echo(line: str) -> bool:
    """Whether a first line is one of these."""
    return _ROSTOPIC.match(line) is not None or _names(line.strip().split(",")) > 0


def names_are_numbers(line: str) -> bool:
    """Whether a line is a joint state of `ros2 topic echo --csv`, but for joints that are called 1, 2 .."""
    cells = line.strip().split(",")
    return _is_stamp(cells) and not _is_number(cells[2]) and cells[3].strip().isdigit()


def only_numbers(names: str) -> str:
    """The refusal of joints without names."""
    return (
        f"its joints are called {names} only, and which these are nobody says: name them in the header of a table (q_elbow), or "
        "record a bag"
    )


def read_echoes(path: Path) -> Echoes:
    """All joint states of a file. Raises `RecordingError`: A line is none, or joints have no names."""
    lines = path.read_text(encoding="utf-8-sig").splitlines()
    first = first_of(lines)
    header = first.split(",") if _ROSTOPIC.match(first) else None
    if header is not None:
        _refuse_nameless(header, path)
    notes: list[str] = []
    messages = _messages(lines, header, path, notes)
    # joint and field of each number, in the order in which they come
    keys = dict.fromkeys(chain.from_iterable(each.values for each in messages))
    joints = list(dict.fromkeys(joint for joint, _ in keys))
    if all(joint.isdigit() for joint in joints):
        raise RecordingError(only_numbers(some(joints)), path)
    headers = [STAMP]
    columns = []
    for field, joint in product(UNITS, joints):
        key = (joint, field)
        if key in keys:
            headers.append(f"{joint}/{field}{UNITS[field]}")
            columns.append(np.array([each.values.get(key, np.nan) for each in messages]))
    stamps_ns = tuple(each.stamp_ns for each in messages)
    return Echoes(tuple(headers), stamps_ns, tuple(columns), tuple(notes))


def _messages(
    lines: Sequence[str], header: Sequence[str] | None, path: Path, notes: list[str]
) -> list[Echo]:
    """The messages of lines; a last line that breaks off, and what a tool said beside them, is left out and noted."""
    filled = [(number, line) for number, line in enumerate(lines, 1) if line.strip()]
    rows = [row for row in filled if not _is_beside(row[1])]
    beside = len(filled) - len(rows)
    rows = rows if header is None else rows[1:]
    found: list[Echo] = []
    for number, line in rows:
        cells = [cell.strip() for cell in line.split(",")]
        try:
            found.append(_echoed(cells) if header is None else _plotted(header, cells))
        except ValueError as error:
            if found and number == rows[-1][0]:
                notes.append(BROKEN)
                break
            raise RecordingError(f"line {number}: {error}", path) from None
    if not found:
        raise RecordingError("has a header and no row: record it again", path)
    if beside:
        notes.append(
            f"{beside} lines are no messages, but what the tool said beside them; they were left out."
        )
    return found


def _echoed(cells: Sequence[str]) -> Echo:
    """A message of `ros2 topic echo --csv`. Raises `ValueError`: It is none."""
    if any(_CUT in cell for cell in cells):
        raise ValueError("was cut (..) by `ros2 topic echo`: record it with --full-length")
    count = _names(cells)
    if not count:
        raise ValueError(
            f"is no joint state with names of its joints: {shortly(','.join(cells[:6]))}"
        )
    names = cells[3 : 3 + count]
    rest = list(cells[3 + count :])
    values: dict[tuple[str, str], float] = {}
    for field in UNITS:
        taken = rest[:count]
        if rest and not rest[0]:
            rest = rest[1:]  # nothing was published of it
            continue
        if len(taken) < count:
            raise ValueError(f"has {len(taken)} numbers of {field} for {count} joints")
        values |= _numbers(names, field, taken)
        rest = rest[count:]
    if not {*rest} <= _MORE:
        raise ValueError(
            f"has {len(rest)} cells more than {count} joints have: {shortly(rest[0])} .."
        )
    return Echo(10**9 * int(cells[0]) + int(cells[1]), values)


def _plotted(header: Sequence[str], cells: Sequence[str]) -> Echo:
    """A message of `rostopic echo -p`. Raises `ValueError`: It is none."""
    if len(cells) != len(header):
        raise ValueError(
            f"has {len(cells)} cells, and the header {len(header)}: joints came and went; keep those lines of one publisher"
        )
    by_name = dict(zip(header, cells, strict=True))
    stamp = by_name.get("field.header.stamp", "0")
    if not int(stamp):
        stamp = by_name["%time"]
    entries = [(_ENTRY.fullmatch(each), cell) for each, cell in by_name.items()]
    names = {found[2]: cell for found, cell in entries if found and found[1] == "name"}
    values: dict[tuple[str, str], float] = {}
    for field in UNITS:
        own = {found[2]: cell for found, cell in entries if found and found[1] == field}
        joints = [names[number] for number in own if number in names]
        if len(joints) < len(own):
            raise ValueError(f"has more numbers of {field} than names of joints")
        values |= _numbers(joints, field, list(own.values()))
    return Echo(int(stamp), values)


def _numbers(
    joints: Sequence[str], field: str, cells: Sequence[str]
) -> dict[tuple[str, str], float]:
    """Numbers of a field by joint. Raises `ValueError`: One is none."""
    found = {}
    for joint, cell in zip(joints, cells, strict=True):
        if not _is_number(cell):
            raise ValueError(f"{field} of {joint} is {shortly(cell)}, and no number")
        found[joint, field] = float(cell)
    return found


def _refuse_nameless(header: Sequence[str], path: Path) -> None:
    fields = {found[1] for found in map(_ENTRY.fullmatch, header) if found}
    if "position" not in fields:
        raise RecordingError("holds no joint states: echo a topic of sensor_msgs/JointState", path)
    if "name" not in fields:
        raise RecordingError(
            f"{only_numbers('position0, position1 ..')}; `rostopic echo -p` without --nostr prints names",
            path,
        )


def _names(cells: Sequence[str]) -> int:
    """How many names of joints stand behind stamp and frame; 0: these cells are no joint state."""
    if not _is_stamp(cells):
        return 0
    count = 0
    for cell in cells[3:]:
        if not cell.strip() or _is_number(cell):
            break
        count += 1
    return count


def _is_stamp(cells: Sequence[str]) -> bool:
    """Whether there are enough cells, and the first two are seconds and nanoseconds."""
    whole = len(cells) >= _FEWEST and all(cell.strip().isdigit() for cell in cells[:2])
    return whole and int(cells[1]) < 10**9


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
