"""``proprio paper``: what may be written, and what it does."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path

from proprio_ros.cli import terminal
from proprio_ros.cli.commands import command_line
from proprio_ros.cli.parser import GOES_ON, Parser
from proprio_ros.cli.terminal import EXIT_OK, say
from proprio_ros.errors import ConfigurationError, one_line
from proprio_ros.inputs.reading import path_problem
from proprio_ros.inputs.resources import check_page


def add_parser(add: Callable[..., Parser]) -> None:
    """Add the command to those of ``proprio``; ``add`` is ``add_parser`` of them."""
    it = add(
        "paper",
        command=paper,
        help="run the paper's experiments again and write one page",
        description="Run the experiments of the paper that this package follows, in its way and in ours, on recordings of a "
        "simulated arm (extra paper), and write DIR/paper.html with its tables and figures. Rows are kept in DIR/rows: a run that "
        "was stopped goes on.",
        epilog=GOES_ON,
    )
    it.add_argument("--out", required=True, metavar="DIR", help="for the page and its rows")
    it.add_argument(
        "--seeds", type=int, default=5, metavar="N", help="robots that are drawn (default 5)"
    )
    it.add_argument(
        "--only",
        nargs="+",
        action="extend",
        default=[],
        metavar="NAME",
        help="experiments (default all)",
    )
    it.add_argument(
        "--jobs", type=int, metavar="N", help="processes (default one per processor, 2 at most)"
    )
    public = (
        "the paper's public recording (trajectory.csv and setting.json), for a section of its own"
    )
    it.add_argument("--recording", metavar="FOLDER", help=public)


def paper(options: argparse.Namespace, given: Sequence[str]) -> int:
    """``proprio paper``: a page; returns the exit code."""
    for name, least, most in (("seeds", 1, 1000), ("jobs", 1, 64)):
        value = getattr(options, name)
        if value is not None and not least <= value <= most:
            raise ConfigurationError(f"--{name} {value}: choose {least} to {most}")
    problem = path_problem(options.out)
    if problem:
        raise ConfigurationError(f"--out {one_line(options.out, 60)}: {problem}")
    from proprio_ros.addons.paper.experiments import published
    from proprio_ros.addons.paper.page import write_paper_page
    from proprio_ros.addons.paper.store import Store, processors, run, tasks_of

    folder = Path(options.out)
    check_page(folder / "paper.html", "--out")
    tasks_of(options.only, options.seeds)  # a name that is none is refused before anything is made
    recording = None if options.recording is None else published(Path(options.recording))
    found = run(
        Store(folder),
        options.only,
        options.seeds,
        options.jobs or processors(),
        say,
    )
    page = folder / "paper.html"
    write_paper_page(found, page, command_line(given), options.seeds, recording)
    terminal.show(False, {}, str(page))
    return EXIT_OK
