"""``proprio``: parses, calls one function, prints. Results go to stdout, everything else to stderr."""

from __future__ import annotations

import argparse
import gc
import json
import os
import shlex
import signal
import sys
import time
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from proprio_ros import progress, schema
from proprio_ros.errors import ConfigurationError, ProprioError, one_line, printable
from proprio_ros.inputs.reading import path_problem
from proprio_ros.inputs.settings import parse_settings
from proprio_ros.probes import all_probes, probe_named, probe_that
from proprio_ros.probes.base import HasSolvers, HasTable
from proprio_ros.quantity import shown, spec_for
from proprio_ros.version import __version__

if TYPE_CHECKING:
    from proprio_ros.pipeline.request import Options

EXIT_OK, EXIT_BAD_INPUT, EXIT_NO_ANSWER, EXIT_INTERRUPTED = 0, 2, 3, 130
LONGEST_WORD = 100_000
"""Characters of one word of the command line."""


def run() -> NoReturn:
    """Entry point of the installed command: ``main``, then out at once.

    Everything is written and closed by then; unloading Warp's native libraries would only cost the user 0.15 s.
    """
    gc.disable()  # one answer and out: collecting while the libraries are imported costs another tenth of a second
    code = main()
    for stream in (sys.stdout, sys.stderr):
        with suppress(BrokenPipeError, ValueError, AttributeError):  # the reader has gone, or there never was one
            stream.flush()
    os._exit(code)


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse and obey; returns the exit code: 0 accepted, 2 bad input, 3 rejected, not identifiable or too wide, 130 interrupted."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    try:
        for word in given:
            if "\0" in word or len(word) > LONGEST_WORD:
                raise ConfigurationError(f"{one_line(word, 60)}: too long, or it holds a NUL character")
        options = _parser().parse_args(given)
        with progress.listening(_say):
            return int(options.command(options, given))
    except _UsageError as error:
        _json_error(given, error.sentence, EXIT_BAD_INPUT)
        raise
    except ProprioError as error:
        print(f"proprio: {error}", file=sys.stderr)
        return _json_error(given, str(error), EXIT_BAD_INPUT)
    except OSError as error:
        # whatever the file system refuses; where it can be foreseen, the code above says what to do
        if isinstance(error, BrokenPipeError):
            # the reader of stdout is gone (`proprio ... | head`): that is not an error of ours
            sys.stderr.close()
            return EXIT_OK
        sentence = one_line(f"{error.filename or 'a file'}: {error.strerror or error}")
        print(f"proprio: {sentence}", file=sys.stderr)
        return _json_error(given, sentence, EXIT_BAD_INPUT)
    except KeyboardInterrupt:
        print("proprio: interrupted", file=sys.stderr)
        return _json_error(given, "interrupted", EXIT_INTERRUPTED)


class _UsageError(SystemExit):
    """A command line that does not parse; usage and sentence are on stderr already."""

    def __init__(self, sentence: str) -> None:
        super().__init__(EXIT_BAD_INPUT)
        self.sentence = sentence


class _Once(argparse.Action):
    """What an option with one value does with it; a second one would silently replace the first."""

    def __call__(self, parser: Any, namespace: Any, values: Any, option_string: str | None = None) -> None:
        given = namespace.__dict__.setdefault("_given", set())
        if option_string is not None and self.dest in given:
            raise argparse.ArgumentError(self, "given twice; give it once")
        given.add(self.dest)
        setattr(namespace, self.dest, values)


class _Parser(argparse.ArgumentParser):
    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.register("action", None, _Once)

    def error(self, message: str) -> NoReturn:
        message = one_line(message)
        self.print_usage(sys.stderr)
        print(f"{self.prog}: error: {message}", file=sys.stderr)
        raise _UsageError(message)


def _json_error(given: Sequence[str], sentence: str, exit_code: int) -> int:
    """With ``--json``, stdout always gets one object."""
    if "--json" in given:
        print(json.dumps(schema.error(sentence, exit_code), indent=1))
    return exit_code


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="proprio", description="A robot arm's sense of weight and softness.")
    parser.add_argument("--version", action="version", version=f"proprio {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    replay = commands.add_parser(
        "replay",
        help="identify from recorded bags",
        description="Identify what the hand holds from recorded bags (sqlite3 or MCAP). Several bags give one pooled estimate.",
        epilog="Exit code: 0 accepted, 2 bad input, 3 rejected, not identifiable or too wide.",
    )
    replay.add_argument(
        "bags", nargs="+", metavar="BAG", help="bag folder or file, or a folder with trajectory.csv, setting.json"
    )
    probes = all_probes()
    replay.add_argument("--probe", required=True, choices=[probe.name for probe in probes], help="what to identify")
    _add_robot(replay)
    replay.add_argument("--calibration", metavar="FILE", help="what `proprio calibrate` wrote")
    replay.add_argument(
        "--baseline",
        nargs="+",
        action="extend",
        metavar="BAG",
        default=[],
        help="runs made with the others and fitted together with them: with an empty hand, to check whether the robot has changed "
        "since its calibration; for --probe container with the empty container",
    )
    _add_set(replay)
    replay.add_argument(
        "--solver", default="lm", choices=_choices(probe.solvers for probe in probes if isinstance(probe, HasSolvers))
    )
    replay.add_argument(
        "--profile",
        default="default",
        choices=_choices(probe.profiles for probe in probes if isinstance(probe, HasSolvers)),
        help="paper: the paper's own method",
    )
    _add_topics(replay)
    replay.add_argument(
        "--span",
        metavar="FROM:TO",
        help="only this part of each recording, in seconds since its first joint state was recorded (FROM: to the end)",
    )
    _add_output(replay)
    replay.set_defaults(command=_replay)

    calibrate = commands.add_parser(
        "calibrate",
        help="learn the robot from empty-hand runs",
        description="Learn torque constants, friction, armature and the arm's weight from runs with nothing in the hand, and "
        "optionally with a weighed reference. Lift, lower and drive each joint; `proprio plan` and the result say which runs help. "
        "Bags in which several joints moved at once do, too: they calibrate the arm for weighing in motion.",
        epilog="Exit code: 0 accepted, 2 bad input, 3 rejected, not identifiable or too wide.",
    )
    calibrate.add_argument(
        "bags", nargs="*", metavar="BAG", help="runs, or motions of several joints, with nothing in the hand"
    )
    calibrate.add_argument(
        "--reference",
        nargs="+",
        action="extend",
        default=[],
        metavar="BAG=KG",
        help="runs with a weighed object in the hand, and its mass; where it sits and its shape come from --set payload...",
    )
    calibrate.add_argument(
        "--output", required=True, metavar="FILE.yaml", help="the calibration, for `replay --calibration`"
    )
    calibrate.add_argument(
        "--refresh",
        metavar="OLD.yaml",
        help="bring this calibration up to date: what drift has left of it is the prior, so that a few empty-hand runs are enough",
    )
    calibrate.add_argument("--force", action="store_true", help="replace an older file of that name")
    _add_robot(calibrate)
    _add_set(calibrate)
    _add_topics(calibrate)
    _add_output(calibrate)
    calibrate.set_defaults(command=_calibrate)

    check = commands.add_parser(
        "check",
        help="what is in a bag, and which runs of it could be used",
        description="Joints, rate, gaps and topics of each bag, the input that would be used, and the runs in it: before any fit.",
        epilog="Exit code: 0 at least one run is usable, 2 bad input, 3 none is.",
    )
    check.add_argument("bags", nargs="+", metavar="BAG", help="as for replay")
    _add_robot(check)
    _add_set(check)
    _add_topics(check)
    check.add_argument("--json", action="store_true", help="print one JSON object")
    check.set_defaults(command=_check)

    plan = commands.add_parser(
        "plan",
        help="which run to make for an object of about this mass",
        description="Rank start poses and currents by the interval that a weighing from there would give.",
    )
    plan.add_argument("--probe", default="payload", choices=("payload",), help="what is to be identified")
    plan.add_argument(
        "--mass", required=True, metavar="KG|KG..KG", help="mass, or lightest and heaviest, of what the hand will hold"
    )
    plan.add_argument("--count", type=int, default=10, metavar="N", help="at most so many plans (default 10)")
    _add_robot(plan)
    plan.add_argument("--calibration", metavar="FILE", help="what `proprio calibrate` wrote")
    _add_set(plan)
    plan.add_argument("--json", action="store_true", help="print one JSON object")
    plan.set_defaults(command=_plan)

    robot = commands.add_parser(
        "robot",
        help="a robot file for another arm",
        description="Robot files say what an arm's motors are, and how well each number is known.",
    )
    robot_commands = robot.add_subparsers(required=True, metavar="COMMAND")
    new = robot_commands.add_parser(
        "new",
        help="write a robot file to fill in, from a URDF",
        description="Write a robot file with every joint of a URDF that a motor could drive, and every key with its default, its "
        "unit and what it is for. What must be stated says so; everything else has a wide default.",
        epilog="Exit code: 0 written, 2 bad input.",
    )
    new.add_argument(
        "urdf",
        metavar="URDF",
        help="URDF file, a bag that holds /robot_description, or robot_descriptions:NAME of the package of that name",
    )
    new.add_argument("--output", required=True, metavar="FILE.yaml", help="the robot file, for `--robot`")
    new.add_argument("--force", action="store_true", help="replace an older file of that name")
    new.add_argument("--json", action="store_true", help="print one JSON object")
    new.set_defaults(command=_robot_new)

    table = commands.add_parser(
        "table",
        help="compute anew how a soft block answers a squeeze",
        description="The softness probe reads a block's force from a table that finite elements made. It is made when it is first "
        "needed, and again when the code or the block has changed; this makes it now. `--set block...` as for `replay`.",
    )
    _add_set(table)
    table.add_argument("--json", action="store_true", help="print one JSON object")
    table.set_defaults(command=_table)

    warmup = commands.add_parser(
        "warmup",
        help="compile now what the first call would wait for",
        description="Simulations run in kernels that are compiled where they run, once on each computer. The first call waits for "
        "that, and so does the identifier when it starts; this does it now, for instance after an installation.",
    )
    warmup.add_argument(
        "--probe", choices=[probe.name for probe in probes], help="only what this one needs (default all)"
    )
    _add_robot(warmup)
    _add_set(warmup)
    warmup.set_defaults(command=_warmup)

    paper = commands.add_parser(
        "paper",
        help="run the paper's experiments again and write one page",
        description="Run the experiments of the paper that this package follows, in its way and in ours, on recordings of a "
        "simulated arm (extra sim), and write DIR/paper.html with its tables and figures. Rows are kept in DIR/rows: a run that "
        "was stopped goes on.",
        epilog="Exit code: 0 written, 2 bad input. Ctrl-C stops; the same command goes on.",
    )
    paper.add_argument("--out", required=True, metavar="DIR", help="for the page and its rows")
    paper.add_argument("--seeds", type=int, default=5, metavar="N", help="robots that are drawn (default 5)")
    paper.add_argument(
        "--only", nargs="+", action="extend", default=[], metavar="NAME", help="experiments (default all)"
    )
    paper.add_argument("--jobs", type=int, metavar="N", help="processes (default one per processor, 2 at most)")
    paper.add_argument(
        "--recording",
        metavar="FOLDER",
        help="the paper's public recording (trajectory.csv and setting.json), for a section of its own",
    )
    paper.set_defaults(command=_paper)

    batch = commands.add_parser(
        "batch",
        help="the same over many recordings and data sets",
        description="Identify what the hand held in every recording of folders and LeRobot data sets (extra batch), each as "
        "`proprio replay` would, and write a row per episode to DIR/rows (parquet) and a page, DIR/batch.html. A run that was "
        "stopped goes on. An episode that cannot be read is a row with its reason.",
        epilog="Exit code: 0 written, 2 bad input. Ctrl-C stops; the same command goes on.",
    )
    batch.add_argument(
        "sources", nargs="+", metavar="SOURCE", help="bags, LeRobot data sets (2.1 and 3), folders of them, or globs"
    )
    batch.add_argument("--out", required=True, metavar="DIR", help="for rows and page")
    batch.add_argument("--probe", default="payload", choices=[probe.name for probe in probes], help="default payload")
    _add_robot(batch)
    batch.add_argument("--calibration", metavar="FILE", help="what `proprio calibrate` wrote")
    _add_set(batch)
    _add_topics(batch)
    batch.add_argument(
        "--grasps",
        action="store_true",
        help="a row for each stretch with one load, too: held, slipped or released, and how heavy (needs a calibration of motions)",
    )
    batch.add_argument(
        "--empty",
        metavar="COLUMN",
        help="calibrate the arm with the episodes whose column of this name is nowhere zero: the hand is known to be empty there",
    )
    batch.add_argument(
        "--empty-first",
        type=float,
        metavar="SECONDS",
        help="calibrate the arm with the first seconds of episodes: the hand is known to be empty then, and what it holds later is "
        "asked",
    )
    batch.add_argument(
        "--engine",
        default="local",
        choices=("local", "ray"),
        help="local: processes of this machine (default); ray: a Ray cluster (extra ray)",
    )
    batch.add_argument("--jobs", type=int, metavar="N", help="processes of the local engine (default one per core)")
    batch.add_argument("--address", metavar="HOST:PORT", help="of the Ray cluster (default the one that runs here)")
    batch.add_argument("--device", default="cpu", choices=("cpu", "cuda"), help="cuda is refused for now")
    batch.add_argument("--json", action="store_true", help="print one JSON object")
    batch.set_defaults(command=_batch)

    demo = commands.add_parser(
        "demo",
        help="a virtual robot weighs itself and an object, live",
        description="Start a virtual robot and the three nodes as processes, calibrate the robot, weigh an object or a sphere, or "
        "squeeze a block.",
        epilog="Exit code: 0 accepted, 2 could not run, 3 rejected, not identifiable or too wide. Ctrl-C ends everything.",
    )
    examples = {probe.name: probe.example for probe in probes if probe.example is not None}
    takes = "; ".join(f"{name}: {example.takes}" for name, example in examples.items())
    demo.add_argument("--probe", default=next(iter(examples)), choices=tuple(examples), help=takes)
    for flag in dict.fromkeys(example.flag for example in examples.values()):
        stated = [example for example in examples.values() if example.flag == flag]
        words = ", ".join(f"{example.help} ({example.truth:g})" for example in stated)
        demo.add_argument(f"--{flag}", type=float, metavar=stated[0].metavar, help=words)
    demo.add_argument(
        "--seed", type=int, default=1, metavar="N", help="draws the arm's hidden friction, torque constants .."
    )
    demo.add_argument(
        "--full",
        action="store_true",
        help="calibrate all joints, as on a real arm (a minute more)",
    )
    demo.add_argument("--output", default="proprio_demo", metavar="DIR", help="for recordings, report and logs")
    _add_robot(demo)
    demo.set_defaults(command=_demo)
    return parser


def _choices(groups: Iterable[Sequence[str]]) -> tuple[str, ...]:
    """Each once, in the order in which they come."""
    return tuple(dict.fromkeys(choice for group in groups for choice in group))


def _add_robot(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--robot",
        metavar="NAME|FILE|URDF",
        help="robot of config/robots, a robot file, or a URDF alone (default open_manipulator_x)",
    )


def _add_set(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="a fact about the object or a setting, VALUE in JSON: payload.com=[0,0,0.01], payload.shape=cube, payload.size=0.03, "
        "held.joint1=0.2, robot.joints.joint3.drive_train.coulomb_N_m=0.05",
    )


def _add_topics(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--driver",
        metavar="NAME|FILE",
        help="which driver published, and so where what stands and what its effort is: a profile of config/drivers, such as "
        "ros2_control, or one of your own; the next three win over it",
    )
    parser.add_argument("--state-topic", metavar="T")
    parser.add_argument("--command-topic", metavar="T")
    parser.add_argument(
        "--effort-unit",
        choices=("N.m", "A", "mA", "raw"),
        help="what `effort` of the joint states means; never guessed",
    )


def _add_output(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--report", metavar="FILE.html", help="write a page with plots")


def _refuse_unwritable(report: str | None) -> None:
    """Before the work, and before anything is printed."""
    problem = path_problem(report or ".")
    if problem:
        raise ConfigurationError(f"--report {one_line(report or '', 60)}: {problem}")
    folder = Path(report or ".").resolve().parent
    if report and not (folder.is_dir() and os.access(folder, os.W_OK)):
        raise ConfigurationError(f"--report {report}: name a file in a folder that exists and is writable")


def _settings(pairs: Sequence[str]) -> dict[str, Any]:
    keys = [pair.partition("=")[0] for pair in pairs]
    for key in keys:
        if keys.count(key) > 1:
            raise ConfigurationError(f"--set {key}: given twice; give it once")
    return parse_settings(pairs)


def _asked(options: argparse.Namespace, **read: Any) -> Options:
    """What the options of a command state; some were read already."""
    from proprio_ros.pipeline.request import Options

    given = {entry.name: getattr(options, entry.name) for entry in fields(Options) if hasattr(options, entry.name)}
    return Options(**{**given, **read})


def _replay(options: argparse.Namespace, given: Sequence[str]) -> int:
    _refuse_unwritable(options.report)
    settings = _settings(options.set)
    # heavy imports only now, so that --help and a mistyped option answer at once
    from proprio_ros.pipeline.replay import replay

    estimate = replay(
        options.bags,
        _asked(options, settings=settings, span=_span(options.span)),
    )
    if options.json:
        print(json.dumps(estimate.as_json(), indent=1))
    else:
        _print(_as_text(estimate))
    if options.report:
        from proprio_ros.pipeline.replay import write_report

        write_report(estimate, Path(options.report), command=shlex.join(["proprio", *given]), sources=options.bags)
        print(f"proprio: report written to {printable(options.report)}", file=sys.stderr)
    return EXIT_OK if estimate.verdict.value == "accepted" else EXIT_NO_ANSWER


def _calibrate(options: argparse.Namespace, given: Sequence[str]) -> int:
    _refuse_unwritable(options.report)
    settings = _settings(options.set)
    references = {}
    for pair in options.reference:
        path, _, mass = pair.rpartition("=")
        try:
            known = float(mass)
        except ValueError:
            path = ""
        if path in references:
            raise ConfigurationError(f"--reference {path}: given twice; give it once")
        if not path:
            raise ConfigurationError(f"--reference {pair}: write BAG=KG, e.g. --reference weight_bag=0.1")
        references[path] = known
    from proprio_ros.pipeline.calibrate import calibrate_from_bags, refresh_from_bags

    about = _asked(options, settings=settings, calibration=options.refresh)
    if options.refresh is not None and references:
        raise ConfigurationError("--refresh takes runs with an empty hand; with a --reference calibrate from the start")
    if options.refresh is not None:
        estimate = refresh_from_bags(options.bags, about, options.output, _progress, force=options.force)
    else:
        estimate = calibrate_from_bags(options.bags, references, about, options.output, _progress, force=options.force)
    accepted = estimate.verdict.value == "accepted"
    if options.json:
        written = {"output": str(options.output) if accepted else None}
        print(json.dumps({**estimate.as_json(), **written}, indent=1))
    else:
        _print(_calibration_as_text(estimate))
    if options.report:
        from proprio_ros.report import write_calibration_report

        write_calibration_report(
            estimate,
            Path(options.report),
            command=shlex.join(["proprio", *given]),
            sources=[*options.bags, *references],
        )
        print(f"proprio: report written to {printable(options.report)}", file=sys.stderr)
    if accepted:
        print(f"proprio: calibration written to {printable(options.output)}", file=sys.stderr)
    return EXIT_OK if accepted else EXIT_NO_ANSWER


def _check(options: argparse.Namespace, given: Sequence[str]) -> int:
    from proprio_ros.pipeline.check import check_bags
    from proprio_ros.pipeline.looked_into import as_json

    robot, checks = check_bags(options.bags, _asked(options, settings=_settings(options.set)))
    if options.json:
        print(json.dumps(as_json(robot, checks), indent=1))
    else:
        _print("\n".join(check.as_text() for check in checks))
    return EXIT_OK if any(check.usable for check in checks) else EXIT_NO_ANSWER


def _robot_new(options: argparse.Namespace, given: Sequence[str]) -> int:
    from proprio_ros.inputs.resources import check_new_yaml, write_in_one_step
    from proprio_ros.recordings.description import description_of
    from proprio_ros.robot.new_file import new_robot_file

    output = Path(options.output)
    check_new_yaml(output, options.force)
    new = new_robot_file(options.urdf, output, description_of)
    write_in_one_step(output, new.text, "--output")
    if options.json:
        content = {**schema.header("robot"), "robot": new.name, "output": str(output), "joints": list(new.joints),
                   "payload_frame": new.payload_frame, "to_state": list(new.to_state)}  # fmt: skip
        print(json.dumps(content, indent=1))
        return EXIT_OK
    _print(f"{output}: {new.name}, joints {', '.join(new.joints)}")
    _print(f"  state: {', '.join(dict.fromkeys(key.rpartition('.')[2] for key in new.to_state))} (marked in the file)")
    _print(f"  check: payload_frame, {new.payload_frame} is a guess")
    return EXIT_OK


def _plan(options: argparse.Namespace, given: Sequence[str]) -> int:
    masses = _masses(options.mass)
    if options.count < 1:
        raise ConfigurationError(f"--count {options.count}: must be at least 1")
    settings = _settings(options.set)
    from proprio_ros.pipeline.api import Plans
    from proprio_ros.pipeline.calibrate import plan_probes

    asked = _asked(options, settings=settings)
    plans = Plans(*plan_probes(masses, asked, options.count, _progress), masses)
    robot = plans.robot
    if options.json:
        print(json.dumps(plans.as_json(), indent=1))
        return EXIT_OK
    if not robot.is_calibrated():
        print("the robot has not been calibrated: the intervals carry what its file leaves open")
    for number, plan in enumerate(plans, start=1):
        print(f"{number:2d}. " + _plan_as_text(plan))
    return EXIT_OK


def _table(options: argparse.Namespace, given: Sequence[str]) -> int:
    settings = _settings(options.set)
    from proprio_ros.pipeline.request import facts_of

    started = time.monotonic()
    probe: HasTable[Any] = probe_that(HasTable)
    content, text = probe.rebuild_table(facts_of(probe.facts, settings))
    elapsed = time.monotonic() - started
    if options.json:
        print(json.dumps({**schema.header("table"), **content, "elapsed_s": elapsed}, indent=1))
    else:
        print(f"{text}\n{content['file']}, {elapsed:.1f} s")
    return EXIT_OK


def _span(text: str | None) -> tuple[int, int | None] | None:
    """From when to when [ns], of the words of ``--span``."""
    if text is None:
        return None
    begin, colon, end = text.partition(":")
    try:
        seconds = [float(word) for word in (begin or "0", end or "inf")]
    except ValueError:
        seconds = []
    if not colon or not seconds or not 0.0 <= seconds[0] < min(seconds[1], 1e9):
        raise ConfigurationError(f"--span {one_line(text, 40)}: expected FROM:TO in seconds, such as 600:1200 or 600:")
    return round(1e9 * seconds[0]), None if seconds[1] > 1e9 else round(1e9 * seconds[1])


def _warmup(options: argparse.Namespace, given: Sequence[str]) -> int:
    settings = parse_settings(options.set)
    from proprio_ros.pipeline.replay import compile_for

    for name in [options.probe] if options.probe else [probe.name for probe in all_probes()]:
        compile_for(_asked(options, settings=settings, probe=name))
        print(f"{name}: ready")
    return EXIT_OK


def _paper(options: argparse.Namespace, given: Sequence[str]) -> int:
    for name, least, most in (("seeds", 1, 1000), ("jobs", 1, 64)):
        value = getattr(options, name)
        if value is not None and not least <= value <= most:
            raise ConfigurationError(f"--{name} {value}: choose {least} to {most}")
    problem = path_problem(options.out)
    if problem:
        raise ConfigurationError(f"--out {one_line(options.out, 60)}: {problem}")
    from proprio_ros.paper.experiments import published
    from proprio_ros.paper.page import write_paper_page
    from proprio_ros.paper.store import Store, processors, run, tasks_of

    folder = Path(options.out)
    tasks_of(options.only, options.seeds)  # a name that is none is refused before anything is made
    recording = None if options.recording is None else published(Path(options.recording))
    found = run(Store(folder), options.only, options.seeds, options.jobs or processors(), _say)
    page = folder / "paper.html"
    command = shlex.join(["proprio", *given])
    write_paper_page(found, page, command, options.seeds, recording)
    print(printable(str(page)))
    return EXIT_OK


def _batch(options: argparse.Namespace, given: Sequence[str]) -> int:
    if options.jobs is not None and not 1 <= options.jobs <= 1024:
        raise ConfigurationError(f"--jobs {options.jobs}: choose 1 to 1024")
    for flag, engine in (("address", "ray"), ("jobs", "local")):
        if getattr(options, flag) is not None and options.engine != engine:
            raise ConfigurationError(f"--{flag} goes with --engine {engine}: add that, or leave it out")
    settings = _settings(options.set)
    from proprio_ros.batch.job import refuse_device, run_batch
    from proprio_ros.batch.rows import Job

    refuse_device(options.device)
    asked = _asked(options, settings=settings)
    outcome = run_batch(
        options.sources,
        Job(asked, options.grasps),
        options.out,
        _say,
        engine=options.engine,
        processes=options.jobs,
        address=options.address,
        bars=sys.stderr is not None and sys.stderr.isatty(),
        command=shlex.join(["proprio", *given]),
        empty=options.empty,
        empty_first_s=options.empty_first,
    )
    if options.json:
        content = {
            **schema.header("batch"),
            "folder": str(outcome.folder), "episodes": outcome.episodes, "done_before": outcome.before,
            "verdicts": outcome.verdicts,
        }  # fmt: skip
        print(json.dumps(content, indent=1))
        return EXIT_OK
    _print(f"{outcome.episodes} episodes: " + ", ".join(f"{count} {name}" for name, count in outcome.verdicts.items()))
    _print(f"rows: {outcome.folder / 'rows'}; page: {outcome.folder / 'batch.html'}")
    return EXIT_OK


def _demo(options: argparse.Namespace, given: Sequence[str]) -> int:
    examples = [probe.example for probe in all_probes() if probe.example is not None]
    probe = probe_named(options.probe)
    example = probe.example
    assert example is not None
    for other in examples:
        if other.flag != example.flag and getattr(options, other.flag) is not None:
            raise ConfigurationError(f"--{other.flag} says nothing about --probe {options.probe}; leave it out")
    stated = getattr(options, example.flag)
    truth = example.truth if stated is None else stated
    if not example.lowest <= truth <= example.highest:
        raise ConfigurationError(f"--{example.flag} {truth:g}: {example.units}")
    # while libraries are loaded there is nothing to end yet, and an exception could land anywhere inside them
    signal.signal(signal.SIGINT, _leave_at_once)
    try:
        from proprio_ros.nodes.demo import demo
    except ModuleNotFoundError as error:
        raise ConfigurationError(
            f"{error.name} is missing: install ROS 2 with pip install -e '.[ros,sim]', or source ROS 2 Jazzy"
        ) from error
    result = demo(
        probe,
        truth,
        folder=Path(options.output),
        seed=options.seed,
        robot=options.robot or "open_manipulator_x",
        full=options.full,
        tell=lambda words: print(f"proprio: {words}", file=sys.stderr),
    )
    print(result.sentence)
    if result.value is not None:
        truth_shown = shown(probe.answer[1], result.truth, spec=".1f")
        print(f"{example.was} {truth_shown}, a hidden robot; {result.elapsed_s:.0f} s in all")
    if result.report is not None:
        print(f"report: {result.report}")
    return EXIT_OK if result.accepted else EXIT_NO_ANSWER


def _leave_at_once(_number: int, _frame: Any) -> NoReturn:
    os.write(2, b"proprio: interrupted\n")
    os._exit(EXIT_INTERRUPTED)


def _masses(text: str) -> list[float]:
    """``0.05``, or ``0.01..0.2``: then the middle of the range, too."""
    try:
        ends = [float(part) for part in text.split("..")]
    except ValueError:
        ends = []
    if not 1 <= len(ends) <= 2 or min(ends) <= 0.0 or ends[0] > ends[-1]:
        raise ConfigurationError(f"--mass {text}: write one mass in kg, or lightest..heaviest, e.g. 0.01..0.2")
    return ends if len(ends) == 1 else [ends[0], (ends[0] * ends[1]) ** 0.5, ends[1]]


def _say(message: str) -> None:
    """What takes long the first time, to whoever waits, and into every log."""
    if sys.stderr is not None:
        print(f"proprio: {message}", file=sys.stderr, flush=True)


def _progress(message: str) -> None:
    if sys.stderr is not None and sys.stderr.isatty():
        print(f"proprio: {message}", file=sys.stderr)


def _print(text: str) -> None:
    """Lines of a result; whatever else moves a cursor is escaped (names in notes and reasons are others')."""
    print("\n".join(printable(line) for line in text.split("\n")))


def _as_text(estimate: Any) -> str:
    lines = [
        f"{estimate.verdict.value}  ({estimate.probe}, {estimate.robot}, {estimate.runs} run{'s' * (estimate.runs != 1)})"
    ]
    for value in estimate.values:
        lines.append("  " + _value_text(value, estimate.interval_first))
    for reason in estimate.reasons:
        lines.append(f"  - {reason}")
    if estimate.fit is not None:
        fit = estimate.fit
        lines.append(
            f"  fit: rms {shown(fit.unit, fit.rms)}, expected {shown(fit.unit, fit.expected_rms)}, "
            f"reduced chi-square {fit.reduced_chi2:.2f}"
        )
    if estimate.solver is not None:
        solver = estimate.solver
        lines.append(f"  solver: {solver.name}, {solver.starts_agreeing} of {len(solver.paths)} starts agree")
    lines += [f"  assumed: {assumption}" for assumption in estimate.assumptions]
    lines += [f"  note: {note}" for note in estimate.notes]
    return "\n".join(lines)


def _calibration_as_text(estimate: Any) -> str:
    lines = [f"{estimate.verdict.value}  (calibration, {estimate.robot}, {estimate.used} of {estimate.runs} runs used)"]
    if estimate.weighable is not None:
        lines.append(f"  {estimate.weighable.sentence()}")
    lines += [f"  - {reason}" for reason in estimate.reasons]
    if estimate.empty_hand is not None:
        lines.append(f"  empty hand: {estimate.empty_hand.sentence()}")
    of_runs = estimate.motion is None  # a motion's are some hundred, and none has a meaning alone
    source = "before" if "refreshed" in estimate.origin else "file"
    listed = [row for row in estimate.unknowns if of_runs and not row.is_detail and row.kind != "zero"]
    for row in listed:
        unit = "" if row.unit == "1" else " " + row.unit
        lines.append(
            f"  {row.name:34s} {row.value:9.5f} +- {row.std:.5f}{unit}   ({source}: {row.prior:.5f} +- {row.prior_std:.5f})"
        )
    if len(listed) < len(estimate.unknowns):
        lines.append(
            f"  and {len(estimate.unknowns) - len(listed)} more: zeros, encoder errors and links (see --json, --report)"
            if of_runs
            else f"  {len(estimate.unknowns)} numbers of bodies, rotors and friction (see --json, --report)"
        )
    if estimate.fit is not None:
        fit = estimate.fit
        lines.append(f"  fit: rms {shown(fit.unit, fit.rms)}, expected {shown(fit.unit, fit.expected_rms)}")
    lines += [
        f"  {each.name}, weighed by the others: {shown('kg', each.mass_kg, spec='.1f')} +- "
        f"{shown('kg', each.half_width, spec='.1f')} (95 %)"
        for each in estimate.weighed_empty
    ]
    if estimate.held_out:
        worst = max(estimate.held_out, key=lambda run: run.reduced_chi2)
        lines.append(
            f"  held-out prediction of each run: reduced chi-square at most {worst.reduced_chi2:.2f} ({worst.name})"
        )
    lines += [f"  not separated: {sentence}" for sentence in estimate.not_separated]
    lines += [f"  next run: {_plan_as_text(plan)}" for plan in estimate.advice]
    lines += [f"  note: {note}" for note in estimate.notes]
    return "\n".join(lines)


def _plan_as_text(plan: Any) -> str:
    start = ", ".join(f"{name} {position:+.2f}" for name, position in plan.start.items())
    return (
        f"{plan.joint} {shown('A', plan.current_A, spec='+.0f')} for {plan.duration_s:g} s from ({start}), "
        f"{plan.kind}: {plan.reason}; {100 * plan.clearance_m:.0f} cm above the table"
    )


def _value_text(value: Any, interval_first: bool = False) -> str:
    if value.value is None:
        return f"{value.name}: not determined ({value.reason})"
    if isinstance(value.value, list):
        numbers = ", ".join("?" if v is None else f"{v:.4f}" for v in value.value)
        return f"{value.name}: [{numbers}] {value.unit}" + (f" ({value.reason})" if value.reason else "")
    # masses in g and moduli in kPa, as on the report's page; --json gives them in kg and Pa
    spec = spec_for(value.unit, value.std)
    number = shown(value.unit, value.value, spec=spec)
    if value.ci95 is None:
        return f"{value.name}: {number} ({value.reason})" if value.reason else f"{value.name}: {number}"
    interval = shown(value.unit, *value.ci95, spec=spec)
    if interval_first:
        return f"{value.name}: {interval} (95 % interval), best guess {number}"
    return f"{value.name}: {number}   95 % interval {interval}"


if __name__ == "__main__":
    run()
