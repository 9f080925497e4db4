"""Names of joints that differ from the robot's by a prefix or a suffix, such as ``fer_joint1`` and ``panda_joint1``.

Where they fit in exactly one way they are the robot's, which is noted; where in several, as of an arm of a pair, the user is asked.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from proprio_ros.errors import RecordingError
from proprio_ros.recordings.read_options import ReadOptions

_BEHIND = re.compile(r"(?<=[_/.:-])")  # where a prefix may end
_BEFORE = re.compile(r"(?=[_/.:-])")  # where a suffix may begin


@dataclass(frozen=True)
class Way:
    """One way in which names fit."""

    theirs: tuple[str, str]  # prefix and suffix of the recorded names
    ours: tuple[str, str]  # and of the robot's
    names: Mapping[str, str]  # the robot's by the recorded ones

    @property
    def words(self) -> str:
        """The way, by its first joint."""
        theirs, ours = next(iter(self.names.items()))
        return f"{theirs} as {ours}"


_Around = tuple[str, str]
"""Prefix and suffix of a name."""


def ways_of(
    recorded: Sequence[str],
    joints: Sequence[str],
) -> list[Way]:
    """The ways in which recorded names may be those of most of a robot's joints, none of which is a part of another."""
    ours_of: dict[str, list[tuple[str, _Around]]] = defaultdict(list)
    for joint in joints:
        for core, ours in _parts(joint):
            ours_of[core].append((joint, ours))
    names_by: dict[tuple[_Around, _Around], dict[str, str]] = defaultdict(dict)
    for name in recorded:
        for core, theirs in _parts(name):
            for joint, ours in ours_of.get(core, ()):
                names_by[theirs, ours][name] = joint
    found: dict[frozenset[tuple[str, str]], Way] = {}
    for (theirs, ours), names in names_by.items():
        if 2 * len(names) > len(joints):
            pairs = frozenset(names.items())
            found.setdefault(
                pairs,
                Way(theirs, ours, names),
            )
    return [way for pairs, way in found.items() if not any(pairs < other for other in found)]


def _parts(name: str) -> Iterator[tuple[str, _Around]]:
    """What may be common to a name and another one, with what is around it; a number alone is no name."""
    starts = [0]
    starts += [cut.start() for cut in _BEHIND.finditer(name)]
    ends = [cut.start() for cut in _BEFORE.finditer(name)]
    ends.append(len(name))
    for start in starts:
        for end in ends:
            core = name[start:end]
            if re.search(r"[^\W\d_]", core):
                yield core, (name[:start], name[end:])


@dataclass(frozen=True)
class Fitted:
    """How a recording with other names is read."""

    options: ReadOptions
    names: Mapping[
        str, str
    ]  # the robot's by the recorded ones; empty where they are as they should be
    notes: tuple[str, ...] = ()

    def renamed(
        self,
        recorded: Sequence[str],
    ) -> tuple[str, ...]:
        """The robot's names of joints."""
        return tuple(self.names.get(name, name) for name in recorded)


def fitted_names(
    path: Path,
    recorded: Sequence[str],
    options: ReadOptions,
) -> Fitted:
    """Take joints for the robot's whose names are those but for a prefix or a suffix.

    Args:
        path: Of the recording.
        recorded: Names in it, as the options have them now.
        options: With the robot's joints.

    Returns:
        How the recording is read, with a note where names are others.

    Raises:
        RecordingError: Names fit in several ways.
    """
    joints = options.joint_order
    if not options.fits_names or set(recorded) & set(joints):
        return Fitted(options, {})
    ways = ways_of([name for name in recorded if name not in options.limits], joints)
    if not ways:
        return Fitted(options, {})
    if len(ways) > 1:
        both = ", or ".join(way.words for way in ways[:4])
        raise RecordingError(
            f"names of joints fit the robot's in several ways: {both}: state joint_prefix or joint_names in a driver's profile of "
            "your own (--driver FILE), or name the robot that has these names",
            path,
        )
    (way,) = ways
    note = f"joints have other names than the robot's; they fit in one way, and {way.words} and so on was taken"
    named = replace(
        options,
        conventions=options.conventions.also(way.names),
    )
    return Fitted(named, way.names, (note,))
