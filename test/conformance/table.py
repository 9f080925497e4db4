"""What a row is, all of them, what a tool answers to one, and what is wrong with that answer."""

from __future__ import annotations

import importlib
import pkgutil
import re
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from support.bends.bend import all_bends
from support.known.asking import ACCEPTED, REFUSED, UNREADABLE, VERDICTS, Outcome, bent_bag
from support.known.bases import BASES, Base, Files

import conformance.rows


@dataclass(frozen=True)
class Bent:
    """One bend with its parameters, and which of a base's files it is made in."""

    name: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    of: tuple[str, ...] = ("loaded", "empty")


@dataclass(frozen=True)
class Row:
    """One trouble, and what is right of it.

    Attributes:
        name: Unique, as in a test's name.
        section: Heading that it stands under.
        trouble: In the user's words.
        base: Name of the recordings.
        bends: What is made of them, one after another.
        verdicts: That are right. `ACCEPTED` asks for an interval that holds, besides.
        codes: A refusal has one of them; empty: any.
        cause: Regular expression; what is said, in reasons, notes, assumptions or the one sentence, matches it.
        unsaid: Regular expression that nothing that is said may match: causes that send the user the wrong way.
        said_if: In which verdicts the cause has to be named.
        more: Further words of the command.
        command: Instead of the base's command.
        make: Makes further files, or others in the place of the base's; of the folder and the files so far.
        zeros_move: The interval that has to hold is that for zeros that moved, where one is given.
        narrow: Largest half width of an accepted interval, in the estimate's unit; None: any.
        pending: Why this package does not pass it yet; empty: it passes.
    """

    name: str
    section: str
    trouble: str
    base: str
    bends: tuple[Bent, ...] = ()
    verdicts: tuple[str, ...] = VERDICTS
    codes: tuple[str, ...] = ()
    cause: str = ""
    unsaid: str = ""
    said_if: tuple[str, ...] = REFUSED
    more: tuple[str, ...] = ()
    command: tuple[str, ...] = ()
    make: Callable[[Path, Files], Files] | None = None
    zeros_move: bool = False
    narrow: float | None = None
    pending: str = ""

    @property
    def of(self) -> Base:
        """The recordings."""
        return BASES[self.base]

    @property
    def words(self) -> tuple[str, ...]:
        """The command line, with names in braces for files."""
        return (
            *(self.command or self.of.command),
            *self.more,
        )


def all_rows() -> tuple[Row, ...]:
    """Of all kinds, in the order of sections."""
    found: list[Row] = []
    for module in pkgutil.iter_modules(conformance.rows.__path__):
        found += importlib.import_module(f"conformance.rows.{module.name}").ROWS
    return tuple(sorted(found, key=lambda row: row.section))


def files_of(row: Row, made: Path, folder: Path) -> Files:
    """The base's files, bent, and what else the row makes.

    Args:
        row: Of the table.
        made: Where the base's files are made, if they are not there yet; rows share it.
        folder: Where those of the row are made.
    """
    files = dict(row.of.files(made))
    bends = all_bends()
    for name in files:
        mine = [(bends[each.name], each.parameters) for each in row.bends if name in each.of]
        if mine:
            seed = zlib.crc32(f"{row.name} {name}".encode())
            files[name] = bent_bag(
                files[name],
                folder / name,
                mine,
                seed,
            )
    return files if row.make is None else row.make(folder, files)


def wrong_with(row: Row, outcome: Outcome) -> list[str]:
    """What is not right, a sentence each."""
    found = []
    told = outcome.verdict in (ACCEPTED, "too_wide") and outcome.value is not None
    if outcome.verdict not in row.verdicts:
        found.append(f"verdict {outcome.verdict}, right: {', '.join(row.verdicts)}")
    if told and outcome.interval is not None:
        given = outcome.if_zeros_moved if row.zeros_move else None
        low, high = given or outcome.interval
        if not low <= row.of.truth <= high:
            found.append(f"{low:.4g} to {high:.4g} misses {row.of.truth:g}")
        if row.narrow is not None and 0.5 * (high - low) > row.narrow:
            found.append(f"{0.5 * (high - low):.3g} half wide, right: {row.narrow:g}")
    refused = outcome.verdict != ACCEPTED
    if refused and row.codes and outcome.verdict != UNREADABLE:
        if not set(row.codes) & set(outcome.codes):
            found.append(f"codes {', '.join(outcome.codes)}, right: {', '.join(row.codes)}")
    if outcome.verdict in row.said_if and row.cause:
        if re.search(row.cause, outcome.said) is None:
            found.append(f"the cause is not named: no {row.cause!r} in {outcome.said!r}")
    if row.unsaid and (misleading := re.search(row.unsaid, outcome.said)):
        found.append(f"sends the user the wrong way: {misleading[0]!r}")
    return found
