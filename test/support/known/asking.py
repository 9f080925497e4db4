"""What is asked about bent recordings, and what is answered."""

from __future__ import annotations

import contextlib
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from proprio_ros.cli import main as proprio
from support.bends.bend import Bend
from support.bends.tape import tape_of
from support.known.bases import Files

UNREADABLE = "unreadable"
"""The verdict of what ends in one sentence, exit code 2."""
ACCEPTED = "accepted"
VERDICTS = (ACCEPTED, "too_wide", "rejected", "not_identifiable", UNREADABLE)
REFUSED = VERDICTS[1:]


@dataclass(frozen=True)
class Outcome:
    """What a tool answered."""

    exit_code: int
    verdict: str
    codes: tuple[str, ...]
    said: str  # all sentences; assumptions where it is accepted
    value: float | None = None
    interval: tuple[float, float] | None = None
    # the same if a joint's zero is elsewhere than at the calibration, where it is said that this matters
    if_zeros_moved: tuple[float, float] | None = None


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


def asked(
    words: Sequence[str],
    files: Files,
    estimate: str = "payload_mass",
) -> Outcome:
    """What this package's command line answers; another tool is asked the same by another function."""
    places = {name: str(path) for name, path in files.items()}
    out = io.StringIO()
    err = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = proprio([*(word.format(**places) for word in words), "--json"])
    told = json.loads(out.getvalue() or "{}")
    verdict = told.get("verdict") or (UNREADABLE if code else ACCEPTED)
    sentences = [
        *told.get("reasons", []),
        *told.get("notes", []),
        told.get("error", ""),
    ]
    # what is assumed anyway names no cause of a refusal
    if verdict == ACCEPTED:
        sentences += told.get("assumptions", [])
    value = next((each for each in told.get("estimates", []) if each["name"] == estimate), {})
    interval = value.get("ci95")
    bounded = interval is not None and None not in interval
    moved = value.get("if_zeros_moved")
    return Outcome(
        exit_code=code,
        verdict=verdict,
        codes=tuple(told.get("reason_codes", ())),
        said=" | ".join(filter(None, sentences)),
        value=value.get("value"),
        interval=(interval[0], interval[1]) if bounded else None,
        if_zeros_moved=(moved[0], moved[1]) if moved else None,
    )
