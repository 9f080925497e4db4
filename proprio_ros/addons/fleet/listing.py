"""Every row of a batch for its page: numbers rounded to their errors, and sentences written once, however many rows say them."""

from __future__ import annotations

import json
import re
import shlex
from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from typing import Any

from proprio_ros.addons.fleet.rows import EPISODE, FAILED, GRASP, Row
from proprio_ros.identification.reasons import CODES
from proprio_ros.pipeline.request import Options
from proprio_ros.quantity import shown_unit, spec_for
from proprio_ros.records import Span

_NUMBER = re.compile(r"\d+(?:\.\d+)?")


def path_of(row: Row) -> str:
    """What `proprio replay` takes."""
    return f"{row['source']}{'/' if row['episode_index'] is None else '#'}{row['episode']}"


def span_of(row: Row) -> Span | None:
    """The part of its recording that a row is of; None: all of it."""
    begin_s = row["start_s"]
    end_s = row["end_s"]
    if begin_s is None or (row["kind"] == EPISODE and not begin_s):
        return None
    return round(1e9 * begin_s), None if row["kind"] == EPISODE or end_s is None else round(
        1e9 * end_s
    )


def named(row: Row) -> str:
    """How to name it on the command line."""
    span = span_of(row)
    if span is None:
        return shlex.quote(path_of(row))
    words = ["" if end is None else f"{1e-9 * end:.9f}".rstrip("0").rstrip(".") for end in span]
    return f"{shlex.quote(path_of(row))} --span {':'.join(words)}"


def asked(options: Options | None, check: bool = False) -> str:
    """What stands on the command line after a recording for the same to be asked of it."""
    if options is None:
        return ""
    words = []
    flags = ("robot", "driver", "state_topic", "command_topic", "effort_unit", "effort_sign")
    for key in flags if check else ("calibration", *flags):
        value = getattr(options, key)
        if value is not None:
            words += [f"--{key.replace('_', '-')}", str(value)]
    if not check and options.probe != "payload":
        words += ["--probe", options.probe]
    if not check:
        words += [
            word
            for key, value in options.settings.items()
            for word in ("--set", f"{key}={json.dumps(value, default=str)}")
        ]
    return "".join(f" {shlex.quote(word)}" for word in words)


class Sentences:
    """Sentences by what stands between their numbers: ten thousand of the same kind are one, and their numbers."""

    def __init__(self) -> None:
        self.known: dict[tuple[str, ...], int] = {}

    def add(self, sentence: str) -> list[Any]:
        """The number of a sentence, and the numbers in it."""
        between = tuple(_NUMBER.split(sentence))
        return [
            self.known.setdefault(between, len(self.known)),
            *_NUMBER.findall(sentence),
        ]

    def all(self) -> list[tuple[str, ...]]:
        """What stands between the numbers of each."""
        return list(self.known)


def own_words(row: Row, sentence: str) -> str:
    """A sentence of a row without the name of its recording in front, which the row says anyway."""
    head, colon, rest = sentence.partition(": ")
    inside = (
        head in f"{row['source']}/{row['episode']}" or f"{row['source']}/{row['episode']}" in head
    )
    return rest if colon and (inside or head == f"{row['source']}#{row['episode']}") else sentence


def cause_of(row: Row) -> tuple[str, str]:
    """Why a row has no answer that can be used: the code, and for what is no reason of a fit the sentence without its numbers."""
    code = (row["reason_codes"] or ["other"])[0]
    if row["kind"] != FAILED and code in CODES:
        return code, ""
    sentence = own_words(row, (row["reasons"] or [""])[0])
    return code, _NUMBER.sub("#", sentence)


def refused(row: Row) -> bool:
    """Whether a row that is no grasp has no answer that can be used."""
    return row["kind"] != GRASP and row["verdict"] != "accepted"


def causes_of(rows: Sequence[Row]) -> list[tuple[str, str]]:
    """Of all rows that were refused, the most frequent first."""
    return [
        cause for cause, _ in Counter(cause_of(row) for row in rows if refused(row)).most_common()
    ]


def rounded(row: Row) -> tuple[str, str, str]:
    """Value and ends of the interval in the unit in which it is shown, with the digits that its error leaves."""
    if row["value"] is None:
        return "", "", ""
    factor, _ = shown_unit(row["unit"])
    spec = spec_for(row["unit"], row["std"])
    # one that ends at a bound says more than its deviation
    if row["low"] is not None and row["high"] > row["low"]:
        spec = spec_for(
            row["unit"],
            max(
                row["std"] or 0.0,
                (row["high"] - row["low"]) / 4.0,
            ),
        )
    found = (
        None if each is None else f"{factor * each:{spec}}"
        for each in (row["value"], row["low"], row["high"])
    )
    value, low, high = (each if each is None or float(each) else each.lstrip("-") for each in found)
    return value or "", low or "", high or ""


def when(row: Row) -> str:
    """When it was recorded, to the second."""
    stamp = row["recorded_ns"]
    return (
        ""
        if not stamp
        else f"{datetime.fromtimestamp(1e-9 * stamp, timezone.utc):%Y-%m-%d %H:%M:%S}"
    )


def listing(
    rows: Sequence[Row],
    sources: Mapping[str, tuple[str, str]],
    pages: Mapping[int, str],
    far: set[int],
    about: Mapping[str, Any],
) -> str:
    """All of it as JSON for ``rows.js``, which names the columns.

    ``sources`` say what each is called on the page, and where it lies, by the name of its partition; ``pages`` are
    files beside the page by the number of their row, ``far`` the numbers of rows that are far from the others of their
    source, ``about`` is what else the script needs.
    """
    sentences = Sentences()
    names = list(sources)
    causes = causes_of(rows)
    place = {cause: number for number, cause in enumerate(causes)}
    verdicts = dict[str, int]()
    joints = dict[str, int]()
    found = []
    for number, row in enumerate(rows):
        verdict = (
            f"{GRASP} {row['reason_codes'][0]}"
            if row["kind"] == GRASP
            else row["verdict"].replace("_", " ")
        )
        begin, end = (
            None if row[name] is None else round(row[name], 1) for name in ("start_s", "end_s")
        )
        found.append([
            names.index(row["source_name"]),
            row["episode"],
            "#" if row["episode_index"] is not None else "/",
            when(row),
            [begin, end, named(row).rpartition(" --span ")[2] if span_of(row) else "",],
            *rounded(row),
            verdicts.setdefault(verdict, len(verdicts)),
            place[cause_of(row)] if refused(row) else -1,
            [sentences.add(own_words(row, each)) for each in row["reasons"]],
            [sentences.add(own_words(row, each)) for each in row["notes"]],
            joints.setdefault(", ".join(row["joints"]), len(joints)),
            pages.get(number, 0),
            int(number in far),
        ])  # fmt: skip
    whole = {
        **about,
        "sources": list(sources.values()),
        "verdicts": list(verdicts),
        "causes": [words or code.replace("_", " ") for code, words in causes],
        "sentences": sentences.all(),
        "joints": list(joints),
        "rows": found,
    }
    # nothing in it may end the element that holds it
    return json.dumps(whole, separators=(",", ":")).replace("<", "\\u003c")
