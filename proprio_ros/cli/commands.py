"""What each command of ``proprio`` does: it takes what was parsed, calls one function and shows what that returns.

Heavy libraries are imported in the commands, so that --help and a mistyped option answer at once.
"""

from __future__ import annotations

import argparse
import os
import shlex
import signal
import time
from collections.abc import Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from proprio_ros import schema
from proprio_ros.cli import terminal
from proprio_ros.cli.terminal import (
    EXIT_INTERRUPTED,
    EXIT_NO_ANSWER,
    EXIT_OK,
    say,
    say_progress,
)
from proprio_ros.errors import ConfigurationError, one_line, printable, some
from proprio_ros.inputs.reading import path_problem
from proprio_ros.inputs.resources import check_page
from proprio_ros.inputs.settings import parse_settings
from proprio_ros.probes import all_probes, probe_named, probe_that
from proprio_ros.probes.base import HasTable
from proprio_ros.quantity import shown
from proprio_ros.whole_files import real_path

if TYPE_CHECKING:
    from proprio_ros.pipeline.request import Options


LONGEST_SEARCH_S = 1e6
LAST_DOMAIN = 101
"""Of those whose ports Linux hands out to nobody else (docs.ros.org, The ROS_DOMAIN_ID)."""


def command_line(given: Sequence[str]) -> str:
    """The command line as it was given."""
    return shlex.join(["proprio", *given])


def _refuse_unwritable(report: str | None, force: bool, output: str = "") -> None:
    """Before the work, and before anything is printed; ``output`` is what is written beside the report."""
    problem = path_problem(report or ".")
    if problem:
        raise ConfigurationError(f"--report {one_line(report or '', 60)}: {problem}")
    folder = real_path(report or ".").parent
    if report and not (folder.is_dir() and os.access(folder, os.W_OK)):
        raise ConfigurationError(
            f"--report {report}: name a file in a folder that exists and is writable"
        )
    if report and output and real_path(report) == real_path(output):
        raise ConfigurationError(f"--report {report}: is --output, too: name another file")
    if report:
        check_page(Path(report), "--report", force)
        from proprio_ros.report.figures import drawing_library

        drawing_library()


def _settings(pairs: Sequence[str]) -> dict[str, Any]:
    keys = [pair.partition("=")[0] for pair in pairs]
    for key in keys:
        if keys.count(key) > 1:
            raise ConfigurationError(f"--set {key}: given twice; give it once")
    return parse_settings(pairs)


def asked_options(options: argparse.Namespace, **read: Any) -> Options:
    """What the options of a command state; some were read already."""
    settings = _settings(options.set)
    from proprio_ros.pipeline.request import Options

    given = {
        entry.name: getattr(options, entry.name)
        for entry in fields(Options)
        if hasattr(options, entry.name)
    }
    return Options(**{**given, "settings": settings, **read})


def replay(options: argparse.Namespace, given: Sequence[str]) -> int:
    """``proprio replay``: an estimate; returns the exit code."""
    _refuse_unwritable(options.report, options.force)
    asked = asked_options(options, span=_span(options.span))
    from proprio_ros.pipeline.replay import replay, write_report

    estimate = replay(options.bags, asked)
    if (
        options.report
    ):  # before anything is printed: where it cannot be written, that is what is said
        how = {"command": command_line(given), "sources": options.bags, "force": options.force}
        write_report(estimate, Path(options.report), **how)
    terminal.show(options.json, estimate.as_json(), terminal.estimate_as_text(estimate))
    if options.report:
        say(f"report written to {printable(options.report)}")
    return EXIT_OK if estimate.verdict.value == "accepted" else EXIT_NO_ANSWER


def calibrate(options: argparse.Namespace, given: Sequence[str]) -> int:
    """``proprio calibrate``: a calibration file; returns the exit code."""
    _refuse_unwritable(options.report, options.force, options.output)
    references = _references(options.reference)
    if options.refresh is not None and references:
        raise ConfigurationError(
            "--refresh takes runs with an empty hand; with a --reference calibrate from the start"
        )
    how = (
        asked_options(options, calibration=options.refresh),
        options.output,
        say_progress,
        options.force,
    )
    from proprio_ros.pipeline.calibrate import calibrate_from_bags, refresh_from_bags

    if options.refresh is not None:
        estimate = refresh_from_bags(options.bags, *how)
    else:
        estimate = calibrate_from_bags(options.bags, references, *how)
    accepted = estimate.verdict.value == "accepted"
    written = {
        **estimate.as_json(),
        "output": str(options.output) if accepted else None,
    }
    if options.report:
        from proprio_ros.report import write_calibration_report

        about = {
            "command": command_line(given),
            "sources": [*options.bags, *map(str, references)],
            "force": options.force,
        }
        write_calibration_report(estimate, Path(options.report), **about)
    terminal.show(options.json, written, terminal.calibration_as_text(estimate))
    if options.report:
        say(f"report written to {printable(options.report)}")
    if accepted:
        say(f"calibration written to {printable(options.output)}")
    return EXIT_OK if accepted else EXIT_NO_ANSWER


def check(options: argparse.Namespace, given: Sequence[str]) -> int:
    """``proprio check``: what is in bags; returns the exit code."""
    asked = asked_options(options)
    from proprio_ros.pipeline.check import check_bags
    from proprio_ros.pipeline.looked_into import as_json

    robot, checks = check_bags(options.bags, asked)
    terminal.show(
        options.json,
        as_json(robot, checks),
        "\n".join(check.as_text() for check in checks),
        terminal.table_of_checks(checks),
    )
    return EXIT_OK if any(check.usable for check in checks) else EXIT_NO_ANSWER


def plan(options: argparse.Namespace, given: Sequence[str]) -> int:
    """``proprio plan``: runs to make; returns the exit code."""
    masses = _masses(options.mass)
    if options.count < 1:
        raise ConfigurationError(f"--count {options.count}: must be at least 1")
    if not 0.0 <= options.seconds <= LONGEST_SEARCH_S:
        raise ConfigurationError(f"--seconds {options.seconds:g}: choose 0 to {LONGEST_SEARCH_S:g}")
    asked = asked_options(options)
    from proprio_ros.pipeline.api import Plans
    from proprio_ros.pipeline.calibrate import plan_excitations

    plans = Plans(
        *plan_excitations(masses, asked, options.count, say, options.seconds),
        masses,
    )
    open_yet = "the robot has not been calibrated: the intervals carry what its file leaves open"
    lines = [] if plans.robot.is_calibrated() else [open_yet]
    lines += [
        f"{number:2d}. {terminal.plan_as_text(plan)}" for number, plan in enumerate(plans, start=1)
    ]
    terminal.show(options.json, plans.as_json(), "\n".join(lines))
    return EXIT_OK


def robot_new(options: argparse.Namespace, given: Sequence[str]) -> int:
    """``proprio robot new``: a robot file to fill in; returns the exit code."""
    from proprio_ros.inputs.resources import check_new_yaml, write_in_one_step
    from proprio_ros.recordings.description import description_of
    from proprio_ros.robot.new_file import new_robot_file

    output = Path(options.output)
    check_new_yaml(output, options.force)
    torque_recorded = options.effort_unit == "N.m"
    new = new_robot_file(options.urdf, output, description_of, torque_recorded, options.tip)
    write_in_one_step(output, new.text, "--output")
    about = {
        "robot": new.name,
        "output": str(output),
        "joints": list(new.joints),
        "payload_frame": new.payload_frame,
        "tip": new.tip,
        "only_read": list(new.only_read),
    }
    stated = ", ".join(dict.fromkeys(key.rpartition(".")[2] for key in new.to_state))
    state = f"state: {stated} (marked in the file)" if stated else "use it with --effort-unit N.m"
    text = (
        f"{output}: {new.name}, joints {', '.join(new.joints)}\n"
        f"  {state}\n"
        f"  check: payload_frame, {new.payload_frame} is a guess"
    )
    notes = list(new.notes)
    if new.unlimited:
        notes.append(
            f"before planning or pushing, state current_limit_A of: {some(new.unlimited)} (its URDF states no limit of effort; "
            "weighing needs none)"
        )
    text += "".join(f"\n  note: {note}" for note in notes)
    open_yet = {"to_state": list(new.to_state), "no_effort_limit": list(new.unlimited)}
    whole = {**schema.header("robot"), **about, **open_yet, "notes": notes}
    terminal.show(options.json, whole, text)
    return EXIT_OK


def robot_export(options: argparse.Namespace, given: Sequence[str]) -> int:
    """``proprio robot export``: the URDF with what a calibration learnt; returns the exit code."""
    from proprio_ros.inputs.resources import check_new, write_in_one_step
    from proprio_ros.pipeline.export import learnt_urdf
    from proprio_ros.pipeline.request import Options, robot_of

    output = Path(options.output)
    check_new(output, (".urdf",), options.force)
    robot = robot_of(
        Options(
            robot=options.robot, calibration=options.calibration, settings=_settings(options.set)
        )
    )
    learnt = learnt_urdf(robot)
    write_in_one_step(output, learnt.text, "--output")
    about = {
        "robot": robot.name,
        "output": str(output),
        "friction": list(learnt.joints),
        "links": list(learnt.links),
    }
    bent = (
        f"\n  inertia about the centre is not as learnt, since no body is so: {', '.join(learnt.bent)}"
        * bool(learnt.bent)
    )
    joints = ", ".join(learnt.joints) or "no joint"
    links = ", ".join(learnt.links) or "no link"
    text = f"{output}: friction of {joints}; inertia of {links}{bent}"
    terminal.show(
        options.json,
        {
            **schema.header("robot"),
            **about,
            "not_as_learnt": list(learnt.bent),
        },
        text,
    )
    return EXIT_OK


def table(options: argparse.Namespace, given: Sequence[str]) -> int:
    """``proprio table``: a table made anew; returns the exit code."""
    settings = _settings(options.set)
    from proprio_ros.pipeline.request import facts_of

    started = time.monotonic()
    probe: HasTable[Any] = probe_that(HasTable)
    content, text = probe.rebuild_table(facts_of(probe.facts, settings))
    elapsed = time.monotonic() - started
    whole = {**schema.header("table"), **content, "elapsed_s": elapsed}
    terminal.show(options.json, whole, f"{text}\n{content['file']}, {elapsed:.1f} s")
    return EXIT_OK


def warmup(options: argparse.Namespace, given: Sequence[str]) -> int:
    """``proprio warmup``: compiled kernels; returns the exit code."""
    from proprio_ros.pipeline.replay import compile_for

    for name in [options.probe] if options.probe else [probe.name for probe in all_probes()]:
        compile_for(asked_options(options, probe=name))
        print(f"{name}: ready")
    return EXIT_OK


def completion(options: argparse.Namespace, given: Sequence[str]) -> int:
    """``proprio completion``: a script for a shell; returns the exit code."""
    from proprio_ros.cli.completion import script
    from proprio_ros.cli.parser import make_parser

    print(script(options.shell, make_parser()), end="")
    return EXIT_OK


def demo(options: argparse.Namespace, given: Sequence[str]) -> int:
    """``proprio demo``: a virtual robot, live; returns the exit code."""
    probe = probe_named(options.probe)
    example = probe.example
    assert example is not None
    for other in (each.example.flag for each in all_probes() if each.example is not None):
        if other != example.flag and getattr(options, other) is not None:
            raise ConfigurationError(
                f"--{other} says nothing about --probe {options.probe}; leave it out"
            )
    stated = getattr(options, example.flag)
    truth = example.truth if stated is None else stated
    if not example.lowest <= truth <= example.highest:
        raise ConfigurationError(f"--{example.flag} {truth:g}: {example.units}")
    demo = _with_ros("proprio_ros.nodes.demo").demo
    robot = options.robot or "open_manipulator_x"
    how = {
        "folder": Path(options.output),
        "seed": options.seed,
        "robot": robot,
        "full": options.full,
    }
    result = demo(probe, truth, **how, tell=say)
    print(result.sentence)
    if result.value is not None:
        truth_shown = shown(probe.answer[1], result.truth, spec=".1f")
        print(f"{example.was} {truth_shown}, a hidden robot; {result.elapsed_s:.0f} s in all")
    if result.report is not None:
        print(f"report: {result.report}")
    return EXIT_OK if result.accepted else EXIT_NO_ANSWER


def live(options: argparse.Namespace, given: Sequence[str]) -> int:
    """``proprio live``: the nodes, until somebody ends them; returns the exit code."""
    from proprio_ros.nodes.arguments import ARGUMENTS, Stated

    _join(options.domain)
    stated = {name: getattr(options, name) for name in ARGUMENTS}
    texts = {name: value for name, value in stated.items() if value is not None}
    from proprio_ros.nodes.live import live

    live(Stated(texts), say, terminal.pass_on)
    return EXIT_OK


def call(options: argparse.Namespace, given: Sequence[str]) -> int:
    """``proprio call``: a service's answer; returns the exit code."""
    if options.list == (options.service is not None):
        raise ConfigurationError("call: name a service, such as calibrate_payload, or --list them")
    _settings(options.set)
    _join(options.domain)
    from proprio_ros.nodes.arguments import checked_namespace

    nodes = _with_ros("proprio_ros.nodes.call")
    namespace = checked_namespace(options.namespace)
    if options.list:
        found = nodes.listed(namespace, say)
        rows = [asdict(each) for each in found]
        terminal.show(
            options.json,
            {**schema.header("services"), "services": rows},
            terminal.services_as_text(found),
        )
        return EXIT_OK
    asked = nodes.to_call(options.service, options.value, options.set, namespace)
    answer = nodes.call(asked, say)
    terminal.show(options.json, {**schema.header("call"), **asdict(answer)}, answer.message)
    return EXIT_OK if answer.success else EXIT_NO_ANSWER


def _join(domain: int | None) -> None:
    """Look for nodes, and start them, in this ROS domain; None: that of the environment."""
    if domain is None:
        return
    if not 0 <= domain <= LAST_DOMAIN:
        raise ConfigurationError(f"--domain {domain}: choose 0 to {LAST_DOMAIN}")
    os.environ["ROS_DOMAIN_ID"] = str(domain)


def _with_ros(module: str) -> Any:
    """A module that needs ROS; Ctrl-C meanwhile leaves at once."""
    # while libraries are loaded there is nothing to end yet, and an exception could land anywhere inside them
    signal.signal(signal.SIGINT, _leave_at_once)
    from proprio_ros.nodes.programs import loaded

    return loaded(module)


def _references(pairs: Sequence[str]) -> dict[str | Path, float]:
    """Mass [kg] by bag, of the words of ``--reference``."""
    references: dict[str | Path, float] = {}
    for pair in pairs:
        path, _, mass = pair.rpartition("=")
        try:
            known = float(mass)
        except ValueError:
            path = ""
        if path in references:
            raise ConfigurationError(f"--reference {path}: given twice; give it once")
        if not path:
            raise ConfigurationError(
                f"--reference {pair}: write BAG=KG, e.g. --reference weight_bag=0.1"
            )
        references[path] = known
    return references


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
        raise ConfigurationError(
            f"--span {one_line(text, 40)}: expected FROM:TO in seconds, such as 600:1200 or 600:"
        )
    return round(1e9 * seconds[0]), None if seconds[1] > 1e9 else round(1e9 * seconds[1])


def _masses(text: str) -> list[float]:
    """``0.05``, or ``0.01..0.2``: then the middle of the range, too."""
    try:
        ends = [float(part) for part in text.split("..")]
    except ValueError:
        ends = []
    if not 1 <= len(ends) <= 2 or min(ends) <= 0.0 or ends[0] > ends[-1]:
        raise ConfigurationError(
            f"--mass {text}: write one mass in kg, or lightest..heaviest, e.g. 0.01..0.2"
        )
    if len(ends) == 1:
        return ends
    lightest, heaviest = ends
    return [lightest, (lightest * heaviest) ** 0.5, heaviest]


def _leave_at_once(_number: int, _frame: Any) -> NoReturn:
    os.write(2, b"proprio: interrupted\n")
    os._exit(EXIT_INTERRUPTED)
