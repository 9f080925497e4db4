"""``proprio``: parses, calls one function, prints. Results go to stdout, everything else to stderr."""

from __future__ import annotations

import argparse
import gc
import json
import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NoReturn

from proprio_ros import __version__
from proprio_ros.errors import ConfigurationError, ProprioError

EXIT_OK, EXIT_BAD_INPUT, EXIT_NO_ANSWER = 0, 2, 3


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
    """Parse and obey; returns the exit code: 0 accepted, 2 bad input, 3 rejected or not identifiable, 130 interrupted."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    options = _parser().parse_args(given)
    try:
        return int(options.command(options, given))
    except ProprioError as error:
        print(f"proprio: {error}", file=sys.stderr)
        return EXIT_BAD_INPUT
    except KeyboardInterrupt:
        print("proprio: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:
        # the reader of stdout is gone (`proprio ... | head`): that is not an error of ours
        sys.stderr.close()
        return EXIT_OK


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="proprio", description="A robot arm's sense of weight and softness.")
    parser.add_argument("--version", action="version", version=f"proprio {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    replay = commands.add_parser(
        "replay",
        help="identify from recorded bags",
        description="Identify what the hand holds from recorded bags (sqlite3 or MCAP). Several bags give one pooled estimate.",
        epilog="Exit code: 0 accepted, 2 bad input, 3 rejected or not identifiable.",
    )
    replay.add_argument(
        "bags", nargs="+", metavar="BAG", help="bag folder or file, or a folder with trajectory.csv, setting.json"
    )
    replay.add_argument("--probe", required=True, choices=("payload", "container", "softness"), help="what to identify")
    replay.add_argument(
        "--robot", metavar="NAME|FILE", help="robot of config/robots, or a robot file (default open_manipulator_x)"
    )
    replay.add_argument("--calibration", metavar="FILE", help="what `proprio calibrate` wrote")
    replay.add_argument("--baseline", nargs="+", metavar="BAG", default=[], help="runs with the empty container")
    replay.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="a fact about the object or a setting, VALUE in JSON: payload.com=[0,0,0.01], payload.shape=cube, payload.size=0.03, "
        "held.joint1=0.2, robot.joints.joint3.drive_train.coulomb_N_m=0.05",
    )
    replay.add_argument("--solver", default="lm", choices=("lm", "adam", "cma"))
    replay.add_argument(
        "--profile", default="default", choices=("default", "paper"), help="paper: the paper's own method"
    )
    replay.add_argument("--state-topic", metavar="T")
    replay.add_argument("--command-topic", metavar="T")
    replay.add_argument(
        "--effort-unit",
        choices=("N.m", "A", "mA", "raw"),
        help="what `effort` of the joint states means; never guessed",
    )
    replay.add_argument("--json", action="store_true", help="print one JSON object")
    replay.add_argument("--report", metavar="FILE.html", help="write a page with plots")
    replay.set_defaults(command=_replay)
    return parser


def _replay(options: argparse.Namespace, given: Sequence[str]) -> int:
    if options.calibration or options.baseline:
        what = "--calibration" if options.calibration else "--baseline"
        raise ConfigurationError(f"{what} is not available in version {__version__}; leave it out")
    settings = _settings(options.set)
    # heavy imports only now, so that --help and a mistyped option answer at once
    from proprio_ros.replay import ReplayOptions, replay

    estimate = replay(
        options.bags,
        ReplayOptions(
            probe=options.probe,
            robot=options.robot,
            settings=settings,
            solver=options.solver,
            profile=options.profile,
            state_topic=options.state_topic,
            command_topic=options.command_topic,
            effort_unit=options.effort_unit,
        ),
    )
    if options.json:
        print(json.dumps(estimate.as_json(), indent=1))
    else:
        print(_as_text(estimate))
    if options.report:
        from proprio_ros.report import write_report

        write_report(estimate, Path(options.report), command="proprio " + " ".join(given), sources=options.bags)
        print(f"proprio: report written to {options.report}", file=sys.stderr)
    return EXIT_OK if estimate.verdict.value == "accepted" else EXIT_NO_ANSWER


def _settings(pairs: Sequence[str]) -> dict[str, Any]:
    settings: dict[str, Any] = {}
    for pair in pairs:
        key, separator, text = pair.partition("=")
        if not separator or not key:
            raise ConfigurationError(f"--set {pair}: write KEY=VALUE, e.g. --set payload.size=0.03")
        try:
            settings[key] = json.loads(text)
        except ValueError:
            if text[:1] in '[{"' or not text:
                raise ConfigurationError(f"--set {pair}: {text!r} is not JSON, e.g. [0,0,0.01] or 0.03") from None
            settings[key] = text  # a bare word such as cube
    return settings


def _as_text(estimate: Any) -> str:
    lines = [
        f"{estimate.verdict.value}  ({estimate.probe}, {estimate.robot}, {estimate.runs} run{'s' * (estimate.runs != 1)})"
    ]
    for value in estimate.values:
        lines.append("  " + _value_text(value))
    for reason in estimate.reasons:
        lines.append(f"  - {reason}")
    if estimate.fit is not None:
        fit = estimate.fit
        lines.append(
            f"  fit: rms {1e3 * fit.rms:.3f} m{fit.unit}, expected {1e3 * fit.expected_rms:.3f} m{fit.unit}, "
            f"reduced chi-square {fit.reduced_chi2:.2f}"
        )
    if estimate.solver is not None:
        solver = estimate.solver
        lines.append(f"  solver: {solver.name}, {solver.starts_agreeing} of {len(solver.paths)} starts agree")
    for note in estimate.notes:
        lines.append(f"  note: {note}")
    return "\n".join(lines)


def _value_text(value: Any) -> str:
    if value.value is None:
        return f"{value.name}: not told ({value.reason})"
    if isinstance(value.value, list):
        numbers = ", ".join("?" if v is None else f"{v:.4f}" for v in value.value)
        return f"{value.name}: [{numbers}] {value.unit}" + (f" ({value.reason})" if value.reason else "")
    if value.ci95 is None:
        return f"{value.name}: {value.value:.5f} {value.unit} ({value.reason})"
    low, high = value.ci95
    return f"{value.name}: {value.value:.5f} {value.unit}   95 % interval {low:.5f} .. {high:.5f} {value.unit}"


if __name__ == "__main__":
    run()
