"""What a row is, all of them, what a tool answers to one, and what is wrong with that answer."""

from __future__ import annotations

import contextlib
import importlib
import io
import json
import pkgutil
import re
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from support.bends.bend import Bend, all_bends
from support.bends.tape import tape_of

import conformance.rows
from conformance.bases import BASES, Base, Files
from proprio_ros.cli import main as proprio

UNREADABLE = "unreadable"
"""The verdict of what ends in one sentence, exit code 2."""
ACCEPTED = "accepted"
VERDICTS = (ACCEPTED, "too_wide", "rejected", "not_identifiable", UNREADABLE)
REFUSED = VERDICTS[1:]


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
        narrow: Largest half width of an accepted interval, in the estimate's unit; None: any.
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
    narrow: float | None = None

    @property
    def of(self) -> Base:
        """The recordings."""
        return BASES[self.base]

    @property
    def words(self) -> tuple[str, ...]:
        """The command line, with names in braces for files."""
        return (*(self.command or self.of.command), *self.more)


@dataclass(frozen=True)
class Outcome:
    """What a tool answered."""

    exit_code: int
    verdict: str
    codes: tuple[str, ...]
    said: str  # all sentences
    value: float | None = None
    interval: tuple[float, float] | None = None


def all_rows() -> tuple[Row, ...]:
    """Of all kinds, in the order of sections."""
    found: list[Row] = []
    for module in pkgutil.iter_modules(conformance.rows.__path__):
        found += importlib.import_module(f"conformance.rows.{module.name}").ROWS
    return tuple(sorted(found, key=lambda row: row.section))


def files_of(row: Row, folder: Path) -> Files:
    """The base's files, bent, and what else the row makes; what is written goes into the folder."""
    files = dict(row.of.files(folder))
    bends = all_bends()
    for name in files:
        mine = [each for each in row.bends if name in each.of]
        if mine:
            files[name] = bent_bag(
                files[name],
                folder / name,
                [(bends[each.name], each.parameters) for each in mine],
                seed=zlib.crc32(f"{row.name} {name}".encode()),
            )
    return files if row.make is None else row.make(folder, files)


def bent_bag(
    bag: Path,
    path: Path,
    bends: Sequence[tuple[Bend, Mapping[str, Any]]],
    seed: int,
) -> Path:
    """A bag with some bends, one after another; those of files after those of messages.

    Args:
        bag: As it is.
        path: Where the other goes.
        bends: And their parameters.
        seed: Of what is random in them.

    Returns:
        Where it is: a bend of files may give another name.
    """
    rng = np.random.default_rng(seed)
    tape = tape_of(bag)
    of_files = [each for each in bends if each[0].kind == "files"]
    for bend, parameters in bends:
        if bend.kind != "files":
            tape = bend.change(tape, rng, **parameters)
    tape.write(path)
    for bend, parameters in of_files:
        path = bend.change(path, rng, **parameters)  # type: ignore[assignment]
    return path


def asked(words: Sequence[str], files: Files, estimate: str = "payload_mass") -> Outcome:
    """What this package's command line answers; another tool is asked the same by another function."""
    places = {name: str(path) for name, path in files.items()}
    out = io.StringIO()
    err = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = proprio([*(word.format(**places) for word in words), "--json"])
    told = json.loads(out.getvalue() or "{}")
    sentences = [
        *told.get("reasons", []),
        *told.get("notes", []),
        *told.get("assumptions", []),
        told.get("error", ""),
        err.getvalue(),
    ]
    value = next((each for each in told.get("estimates", []) if each["name"] == estimate), {})
    interval = value.get("ci95")
    bounded = interval is not None and None not in interval
    return Outcome(
        exit_code=code,
        verdict=told.get("verdict") or (UNREADABLE if code else ACCEPTED),
        codes=tuple(told.get("reason_codes", ())),
        said=" | ".join(filter(None, sentences)),
        value=value.get("value"),
        interval=(interval[0], interval[1]) if bounded else None,
    )


def wrong_with(row: Row, outcome: Outcome) -> list[str]:
    """What is not right, a sentence each."""
    found = []
    told = outcome.verdict in (ACCEPTED, "too_wide") and outcome.value is not None
    if outcome.verdict not in row.verdicts:
        found.append(f"verdict {outcome.verdict}, right: {', '.join(row.verdicts)}")
    if told and outcome.interval is not None:
        low, high = outcome.interval
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
