"""``proprio batch``: what may be written, and what it does."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from proprio_ros import schema
from proprio_ros.cli import terminal
from proprio_ros.cli.commands import asked_options, command_line
from proprio_ros.cli.parser import GOES_ON, TOPICS, Parser, probe_names
from proprio_ros.cli.terminal import EXIT_BAD_INPUT, EXIT_OK, Table, say
from proprio_ros.errors import ConfigurationError, printable
from proprio_ros.quantity import shown, spec_for


def add_parser(add: Callable[..., Parser]) -> None:
    """Add the command to those of ``proprio``; ``add`` is ``add_parser`` of them."""
    it = add(
        "batch",
        command=batch,
        help="the same over many recordings and data sets",
        description="Identify what the hand held in every recording of folders and LeRobot data sets (extra batch), each as "
        "`proprio replay` would, and write a row per episode to DIR/rows (parquet) and a page, DIR/batch.html. A run that was "
        "stopped goes on. An episode that cannot be read is a row with its reason.",
        epilog=GOES_ON,
    )
    sources = "bags, LeRobot data sets (2.1 and 3), folders of them, or globs"
    it.add_argument("sources", nargs="+", metavar="SOURCE", help=sources)
    it.add_argument("--out", required=True, metavar="DIR", help="for rows and page")
    it.add_argument("--probe", default="payload", choices=probe_names(), help="default payload")
    it.share("robot", "calibration", "set", *TOPICS)
    it.add_argument(
        "--grasps",
        action="store_true",
        help="a row for each stretch with one load, too: held, slipped or released, and how heavy (needs a calibration of motions)",
    )
    it.add_argument(
        "--empty",
        metavar="COLUMN",
        help="calibrate the arm with the episodes whose column of this name is nowhere zero: the hand is known to be empty there",
    )
    it.add_argument(
        "--empty-first",
        type=float,
        metavar="SECONDS",
        help="calibrate the arm with the first seconds of episodes: the hand is known to be empty then, and what it holds later is "
        "asked",
    )
    pages = "rows whose own pages are written, unusual ones first (default 12; a large number: all that have an answer)"
    it.add_argument("--reports", type=int, default=12, metavar="N", help=pages)
    engines = "local: processes of this machine (default); ray: a Ray cluster (extra ray)"
    it.add_argument("--engine", default="local", choices=("local", "ray"), help=engines)
    it.add_argument(
        "--jobs", type=int, metavar="N", help="processes of the local engine (default one per core)"
    )
    it.add_argument(
        "--address", metavar="HOST:PORT", help="of the Ray cluster (default the one that runs here)"
    )
    it.share("device", "json")


def batch(options: argparse.Namespace, given: Sequence[str]) -> int:
    """``proprio batch``: rows and a page; returns the exit code."""
    if options.jobs is not None and not 1 <= options.jobs <= 1024:
        raise ConfigurationError(f"--jobs {options.jobs}: choose 1 to 1024")
    if options.reports < 0:
        raise ConfigurationError(f"--reports {options.reports}: choose 0 or more")
    for flag, engine in (("address", "ray"), ("jobs", "local")):
        if getattr(options, flag) is not None and options.engine != engine:
            raise ConfigurationError(
                f"--{flag} goes with --engine {engine}: add that, or leave it out"
            )
    asked = asked_options(options)
    from proprio_ros.addons.fleet.job import run_batch
    from proprio_ros.addons.fleet.rows import Job

    outcome = run_batch(
        options.sources,
        Job(asked, options.grasps),
        options.out,
        say,
        engine=options.engine,
        processes=options.jobs,
        address=options.address,
        bars=sys.stderr is not None and sys.stderr.isatty(),
        command=command_line(given),
        empty=options.empty,
        empty_first_s=options.empty_first,
        reports=options.reports,
    )
    done = {
        "episodes": outcome.episodes,
        "done_before": outcome.before,
        "undone": outcome.undone,
        "verdicts": outcome.verdicts,
    }
    text = f"{outcome.episodes} episodes: " + ", ".join(
        f"{count} {name}" for name, count in outcome.verdicts.items()
    )
    text += f"\nrows: {outcome.folder / 'rows'}; page: {outcome.folder / 'batch.html'}"
    whole = {
        **schema.header("batch"),
        "folder": str(outcome.folder),
        **done,
    }
    if outcome.undone:
        text += (
            f"\n{outcome.undone} episodes were not answered, since this computer could not: mend what is said above, and give the "
            "same command again"
        )
    terminal.show(options.json, whole, text, table_of_episodes(outcome.first))
    return EXIT_BAD_INPUT if outcome.undone else EXIT_OK


def table_of_episodes(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Answers of a batch."""
    table = [("episode", "answer", "95 % interval", "verdict", "")]
    for row in rows:
        unit = row["unit"]
        spec = spec_for(row["unit"], row["std"])
        answer = "-"
        interval = "-"
        if row["value"] is not None:
            answer = shown(unit, row["value"], spec=spec)
            interval = shown(unit, row["low"], row["high"], spec=spec)
        codes = ", ".join(row["reason_codes"] or ())
        table.append((printable(str(row["episode"])), answer, interval, row["verdict"], codes))
    return table
