"""What a benchmark found: printed as tables while it runs, and kept as JSON (``--json FILE``) for the pages of the documentation.

A file of ``docs/results/`` says what was run (command line, commit, date, machine, seconds) and holds one table or more: of each
row the numbers, to six digits, and of the table the columns by which a page shows them. ``docs/generate.py`` writes the tables of
README and of the validation page from these files and nothing else.
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import platform
import shlex
import subprocess
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from figures import cells, line

REPOSITORY = Path(__file__).resolve().parents[2]


def parser_of(doc: str | None) -> argparse.ArgumentParser:
    """A benchmark's options, `--json` among them."""
    parser = argparse.ArgumentParser(
        description=doc, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="keep what is found in this file")
    return parser


class Results:
    """Tables of one run of one benchmark.

    Args:
        script: The benchmark's file.
        file: Where `keep` writes them; None: nowhere.
        arguments: Of the benchmark; None: those of the command line.
    """

    def __init__(
        self,
        script: str,
        file: Path | None,
        arguments: Sequence[str] | None = None,
    ) -> None:
        self.file = file
        self.tables: dict[str, dict[str, Any]] = {}
        self._printed = ""
        self._began = time.monotonic()
        self._run = _run(
            script,
            sys.argv[1:] if arguments is None else arguments,
        )

    def table(
        self,
        name: str,
        columns: Mapping[str, str],
    ) -> None:
        """Begin a table.

        Args:
            columns: Of each title the words of its cells, a format of the row's numbers such as `{rms_g:.2f} g`.
        """
        self.tables[name] = {
            "columns": dict(columns),
            "rows": [],
        }

    def row(self, table: str, **numbers: Any) -> None:
        """Add a row, and print it."""
        kept = {key: _rounded(value) for key, value in numbers.items()}
        columns = self.tables[table]["columns"]
        self.tables[table]["rows"].append(kept)
        if self._printed != table:
            print("\n" * bool(self._printed) + f"{line(list(columns))}\n|{'---|' * len(columns)}")
            self._printed = table
        print(line(cells(columns, kept)), flush=True)

    def keep(self) -> None:
        """Write the file, where one was asked for; a run that ended early keeps none."""
        if self.file is None:
            return
        kept = {
            **self._run,
            "seconds": round(time.monotonic() - self._began),
            "tables": {name: table for name, table in self.tables.items() if table["rows"]},
        }
        self.file.parent.mkdir(parents=True, exist_ok=True)
        self.file.write_text(text_of(kept), encoding="utf-8")


def text_of(kept: Mapping[str, Any]) -> str:
    """JSON with a line for each row of a table."""
    tables = {
        name: {**table, "rows": [f"ROW {name} {n}" for n in range(len(table["rows"]))]}
        for name, table in kept["tables"].items()
    }
    text = json.dumps(
        {**kept, "tables": tables},
        indent=1,
    )
    for name, table in kept["tables"].items():
        for number, row in enumerate(table["rows"]):
            text = text.replace(
                json.dumps(f"ROW {name} {number}"),
                json.dumps(row),
                1,
            )
    return text + "\n"


def each_answer(
    errors: Iterable[float],
    half_intervals: Iterable[float],
) -> dict[str, list[float]]:
    """Numbers of a row that say whether its intervals fit (`efficiency`): four digits of each answer's.

    Args:
        errors: Of each answer, in the unit of the row.
        half_intervals: Half widths of their 95 % intervals, likewise.
    """
    return {
        "errors": [float(f"{error:.4g}") for error in errors],
        "half_intervals": [float(f"{half:.4g}") for half in half_intervals],
    }


def _rounded(value: Any) -> Any:
    """Six digits of a number are enough for any page; numbers of numpy become Python's."""
    if hasattr(value, "item"):
        value = value.item()
    if isinstance(value, list):
        return [_rounded(each) for each in value]
    return float(f"{value:.6g}") if isinstance(value, float) else value


def _run(
    script: str,
    arguments: Sequence[str],
) -> dict[str, Any]:
    """Command line (without where it keeps its results), commit, date, and machine."""
    words = [
        "python",
        Path(script).resolve().relative_to(REPOSITORY).as_posix(),
    ]
    given = iter(arguments)
    for word in given:
        if word == "--json":
            next(given, None)
        elif not word.startswith("--json="):
            words.append(word)
    return {
        "command": shlex.join(words),
        "commit": _commit(),
        "date": datetime.date.today().isoformat(),
        "machine": {
            "platform": platform.platform(),
            "python": platform.python_version(),
            "cores": os.cpu_count(),
            "load": round(os.getloadavg()[0], 1) if hasattr(os, "getloadavg") else None,
        },
    }


def _commit() -> str:
    """Short name of the commit; with a `+` where the package or the tests differ from it; empty without git."""

    def git(*words: str) -> str:
        return subprocess.run(
            ["git", *words], cwd=REPOSITORY, capture_output=True, text=True, check=True
        ).stdout.strip()

    try:
        return git("rev-parse", "--short", "HEAD") + (
            "+" if git("status", "--porcelain", "--", "proprio_ros", "config") else ""
        )
    except (OSError, subprocess.CalledProcessError):
        return ""
