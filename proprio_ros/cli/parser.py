"""What may be written on the command line of ``proprio``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from typing import Any, NoReturn

from proprio_ros import registry
from proprio_ros.cli import commands as obey
from proprio_ros.cli.completion import SHELLS
from proprio_ros.cli.terminal import EXIT_BAD_INPUT
from proprio_ros.errors import one_line
from proprio_ros.nodes.arguments import ARGUMENTS
from proprio_ros.probes import all_probes, probe_that
from proprio_ros.probes.base import Carries, HasSolvers
from proprio_ros.quantity import EFFORTS, unit_called
from proprio_ros.version import __version__

EXIT_CODES = "Exit code: 0 accepted, 2 bad input, 3 rejected, not identifiable or too wide."
EXIT_WRITTEN = "Exit code: 0 written, 2 bad input."
GOES_ON = f"{EXIT_WRITTEN} Ctrl-C stops; the same command goes on."
SHARED: dict[str, dict[str, Any]] = {
    "robot": {
        "metavar": "NAME|FILE|URDF",
        "help": "robot of config/robots, a robot file, or a URDF alone (default open_manipulator_x)",
    },
    "calibration": {"metavar": "FILE", "help": "what `proprio calibrate` wrote"},
    "set": {
        "action": "append",
        "default": [],
        "metavar": "KEY=VALUE",
        "help": "a fact about the object or a setting, VALUE in JSON: payload.com=[0,0,0.01], payload.shape=cube, "
        "payload.size=0.03, held.joint1=0.2, robot.joints.joint3.drive_train.coulomb_N_m=0.05",
    },
    "driver": {
        "metavar": "NAME|FILE",
        "help": "which driver published, and so where what stands and what its effort is: a profile of config/drivers, such as "
        "ros2_control, or one of your own; the next four win over it",
    },
    "state-topic": {"metavar": "T"},
    "command-topic": {"metavar": "T"},
    "effort-unit": {
        "type": lambda text: unit_called(text, EFFORTS),
        "choices": ("N.m", "A", "mA", "raw"),
        "help": "what `effort` of the joint states means; never guessed",
    },
    "effort-sign": {
        "metavar": "SIGN|JOINT=SIGN,..",
        "help": "-1 where `effort` has the sign of the torque that gravity makes, not of what holds against it, for all joints or "
        "for those named; 1 undoes what a profile or the robot file says; never turned unasked",
    },
    "device": {
        "default": "cpu",
        "choices": ("cpu", "cuda"),
        "help": "where fits from every start are computed; cuda: an NVIDIA graphics card",
    },
    "force": {"action": "store_true", "help": "replace an older file of that name, whatever it is"},
    "domain": {
        "type": int,
        "metavar": "N",
        "help": "ROS domain of the nodes (default: ROS_DOMAIN_ID, else 0)",
    },
    "json": {"action": "store_true", "help": "print one JSON object"},
    "report": {
        "metavar": "FILE.html",
        "help": "write a page with plots; an older page is replaced",
    },
}
"""Options that several commands have."""
TOPICS = ("driver", "state-topic", "command-topic", "effort-unit", "effort-sign")


class UsageError(SystemExit):
    """A command line that does not parse; usage and sentence are on stderr already."""

    def __init__(self, sentence: str) -> None:
        super().__init__(EXIT_BAD_INPUT)
        self.sentence = sentence


class _Once(argparse.Action):
    """What an option with one value does with it; a second one would silently replace the first."""

    def __call__(
        self, parser: Any, namespace: Any, values: Any, option_string: str | None = None
    ) -> None:
        given = namespace.__dict__.setdefault("_given", set())
        if option_string is not None and self.dest in given:
            raise argparse.ArgumentError(self, "given twice; give it once")
        given.add(self.dest)
        setattr(namespace, self.dest, values)


class Parser(argparse.ArgumentParser):
    """Of ``proprio`` or one of its commands; ``command`` is the function that obeys it."""

    def __init__(self, *arguments: Any, command: Any = None, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.register("action", None, _Once)
        self.set_defaults(command=command)

    def share(self, *names: str) -> None:
        """Take options that other commands have, too."""
        for name in names:
            self.add_argument(f"--{name}", **SHARED[name])

    def error(self, message: str) -> NoReturn:
        message = one_line(message)
        self.print_usage(sys.stderr)
        print(f"{self.prog}: error: {message}", file=sys.stderr)
        raise UsageError(message)


def make_parser() -> argparse.ArgumentParser:
    """Of the whole command line; what it gives has the command to obey as ``command``."""
    parser = Parser(prog="proprio", description="A robot arm's sense of weight and softness.")
    parser.add_argument("--version", action="version", version=f"proprio {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for make in (
        _replay,
        _calibrate,
        _check,
        _plan,
        _robot,
        _table,
        _warmup,
        *(registry.loaded(place) for place in registry.commands().values()),
        _demo,
        _live,
        _call,
        _completion,
    ):
        make(commands.add_parser)
    return parser


def _replay(add: Callable[..., Parser]) -> None:
    it = add(
        "replay",
        aliases=["weigh"],
        command=obey.replay,
        help="identify from recorded bags",
        description="Identify what the hand holds from bags (sqlite3 or MCAP) or tables. Several give one pooled estimate. "
        "`proprio weigh` is the same command.",
        epilog=EXIT_CODES,
    )
    folders = "bag folder or file, table (.csv, .parquet), FOLDER#EPISODE of a data set, folder with trajectory.csv, setting.json"
    it.add_argument("bags", nargs="+", metavar="BAG", help=folders)
    it.add_argument("--probe", required=True, choices=probe_names(), help="what to identify")
    it.share("robot", "calibration")
    it.add_argument(
        "--baseline",
        nargs="+",
        action="extend",
        metavar="BAG",
        default=[],
        help="runs made with the others and fitted together with them: with an empty hand, to check whether the robot has changed "
        "since its calibration; for --probe container with the empty container",
    )
    it.share("set")
    solving = [probe for probe in all_probes() if isinstance(probe, HasSolvers)]
    solvers = tuple(dict.fromkeys(solver for probe in solving for solver in probe.solvers))
    profiles = tuple(dict.fromkeys(profile for probe in solving for profile in probe.profiles))
    it.add_argument("--solver", default="lm", choices=solvers)
    it.add_argument(
        "--profile", default="default", choices=profiles, help="paper: the paper's own method"
    )
    it.share("device", *TOPICS)
    it.add_argument(
        "--span",
        metavar="FROM:TO",
        help="only this part of each recording, in seconds since its first joint state was recorded (FROM: to the end)",
    )
    it.share("json", "report", "force")


def _calibrate(add: Callable[..., Parser]) -> None:
    it = add(
        "calibrate",
        command=obey.calibrate,
        help="calibrate the robot from empty-hand runs",
        description="Learn torque constants, friction, armature and the arm's weight from runs with nothing in the hand, and "
        "optionally with a weighed reference. Lift, lower and drive each joint; `proprio plan` and the result say which runs help. "
        "Bags in which several joints moved at once do, too: they calibrate the arm for weighing in motion.",
        epilog=EXIT_CODES,
    )
    empty = "runs, or motions of several joints, with nothing in the hand"
    it.add_argument("bags", nargs="*", metavar="BAG", help=empty)
    it.add_argument(
        "--reference",
        nargs="+",
        action="extend",
        default=[],
        metavar="BAG=KG",
        help="runs with a weighed object in the hand, and its mass; where it sits and its shape come from --set payload...",
    )
    it.add_argument(
        "--output",
        required=True,
        metavar="FILE.yaml",
        help="the calibration, for `replay --calibration`",
    )
    it.add_argument(
        "--refresh",
        metavar="OLD.yaml",
        help="bring this calibration up to date: what drift has left of it is the prior, so that a few empty-hand runs are enough",
    )
    it.share("force", "robot", "set", *TOPICS, "json", "report")


def _check(add: Callable[..., Parser]) -> None:
    it = add(
        "check",
        command=obey.check,
        help="what is in a bag, and which runs of it could be used",
        description="Joints, rate, gaps and topics of each bag, the input that would be used, and the runs in it: before any fit.",
        epilog="Exit code: 0 at least one run is usable, 2 bad input, 3 none is.",
    )
    it.add_argument("bags", nargs="+", metavar="BAG", help="as for replay")
    it.share("robot", "set", *TOPICS, "json")


def _plan(add: Callable[..., Parser]) -> None:
    it = add(
        "plan",
        command=obey.plan,
        help="which run to make for an object of about this mass",
        description="Rank start poses and currents by the interval that a weighing from there would give. The longer it searches, "
        "the better; Ctrl-C ends it with the best so far.",
        epilog="Exit code: 0 planned, also where Ctrl-C came after the first plan, 2 bad input, 130 interrupted before it.",
    )
    planned = probe_that(Carries).name
    it.add_argument("--probe", default=planned, choices=(planned,), help="what is to be identified")
    masses = "mass, or lightest and heaviest, of what the hand will hold"
    it.add_argument("--mass", required=True, metavar="KG|KG..KG", help=masses)
    it.add_argument(
        "--count", type=int, default=10, metavar="N", help="at most so many plans (default 10)"
    )
    longest = "search so long, or until nothing is left to try (default 3)"
    it.add_argument("--seconds", type=float, default=3.0, metavar="S", help=longest)
    it.share("robot", "calibration", "set", "json")


def _robot(add: Callable[..., Parser]) -> None:
    it = add(
        "robot",
        help="a robot file for another arm",
        description="Robot files say what an arm's motors are, and how well each number is known.",
    )
    kinds = it.add_subparsers(required=True, metavar="COMMAND")
    new = kinds.add_parser(
        "new",
        command=obey.robot_new,
        help="write a robot file to fill in, from a URDF",
        description="Write a robot file with every joint of a URDF that a motor could drive, and every key with its default, its "
        "unit and what it is for. What must be stated says so; everything else has a wide default.",
        epilog=EXIT_WRITTEN,
    )
    sources = "URDF file, a bag that holds /robot_description, or robot_descriptions:NAME of the package of that name"
    new.add_argument("urdf", metavar="URDF", help=sources)
    new.add_argument(
        "--output", required=True, metavar="FILE.yaml", help="the robot file, for `--robot`"
    )
    tip = "last link of the arm, on a robot with several: the joints up to there are driven, all others only read"
    new.add_argument("--tip", metavar="LINK", help=tip)
    new.share("effort-unit", "force", "json")
    export = kinds.add_parser(
        "export",
        command=obey.robot_export,
        help="write the URDF with what a calibration learnt",
        description="Write the robot's URDF with friction as <dynamics damping friction> of each joint, and with links that weigh "
        "what a calibration by motions learnt; everything else stays.",
        epilog=EXIT_WRITTEN,
    )
    export.share("robot", "calibration", "set")
    export.add_argument("--output", required=True, metavar="FILE.urdf", help="the URDF")
    export.share("force", "json")


def _table(add: Callable[..., Parser]) -> None:
    it = add(
        "table",
        command=obey.table,
        help="compute anew how a soft block answers a squeeze",
        description="The softness probe reads a block's force from a table that finite elements made. It is made when it is first "
        "needed, and again when the code or the block has changed; this makes it now. `--set block...` as for `replay`.",
    )
    it.share("set", "json")


def _warmup(add: Callable[..., Parser]) -> None:
    it = add(
        "warmup",
        command=obey.warmup,
        help="compile now what the first call would wait for",
        description="Simulations run in kernels that are compiled where they run, once on each computer. The first call waits for "
        "that, and so does the identifier when it starts; this does it now, for instance after an installation.",
    )
    it.add_argument("--probe", choices=probe_names(), help="only what this one needs (default all)")
    it.share("robot", "set")


def _demo(add: Callable[..., Parser]) -> None:
    it = add(
        "demo",
        command=obey.demo,
        help="a virtual robot weighs itself and an object, live",
        description="Start a virtual robot and the three nodes as processes, calibrate the robot, weigh an object or a sphere, or "
        "squeeze a block.",
        epilog="Exit code: 0 accepted, 2 could not run, 3 rejected, not identifiable or too wide. Ctrl-C ends everything.",
    )
    examples = {probe.name: probe.example for probe in all_probes() if probe.example is not None}
    takes = "; ".join(f"{name}: {example.takes}" for name, example in examples.items())
    it.add_argument(
        "--probe",
        default=next(iter(examples)),
        choices=tuple(examples),
        help=takes,
    )
    for flag in dict.fromkeys(example.flag for example in examples.values()):
        stated = [example for example in examples.values() if example.flag == flag]
        words = ", ".join(f"{example.help} ({example.truth:g})" for example in stated)
        it.add_argument(
            f"--{flag}",
            type=float,
            metavar=stated[0].metavar,
            help=words,
        )
    hidden = "draws the arm's hidden friction, torque constants .."
    it.add_argument("--seed", type=int, default=1, metavar="N", help=hidden)
    it.add_argument(
        "--full", action="store_true", help="calibrate all joints, as on a real arm (a minute more)"
    )
    it.add_argument(
        "--output", default="proprio_demo", metavar="DIR", help="for recordings, report and logs"
    )
    it.share("robot")


def _live(add: Callable[..., Parser]) -> None:
    it = add(
        "live",
        command=obey.live,
        help="driver, excitation and identifier, on an arm or a virtual one",
        description="Start what `ros2 launch proprio_ros calibration.launch.py` starts, with the same arguments, where there is no "
        "`ros2`; then `proprio call` in another terminal. Ctrl-C, SIGTERM, and the end of the driver end all of them: the arm is "
        "released, or held where the driver's parameter on_shutdown says so.",
        epilog="Exit code: 0 ended by Ctrl-C or SIGTERM, 2 could not run, or the driver died.",
    )
    for name, argument in ARGUMENTS.items():
        flags = dict.fromkeys((f"--{name}", f"--{name.replace('_', '-')}"))
        if argument.default == "false":
            it.add_argument(*flags, action="store_const", const="true", help=argument.about)
        else:
            default = f" (default {argument.default})" if argument.default else ""
            words = f"{argument.about}{default}"
            it.add_argument(*flags, metavar=name.upper(), help=words)
    it.share("domain")


def _call(add: Callable[..., Parser]) -> None:
    it = add(
        "call",
        command=obey.call,
        help="a service of the nodes that run",
        description="Call a service of driver, excitation or identifier, as `ros2 service call` does: what goes on to stderr, the "
        "answer to stdout. The identifier keeps what --set states. Ctrl-C cancels the job that the call began; the arm is held.",
        epilog="Exit code: 0 the service succeeded, 2 bad input, or no such node runs, 3 the service says no, 130 interrupted.",
    )
    it.add_argument(
        "service", nargs="?", metavar="SERVICE", help="its name, such as calibrate_payload"
    )
    it.add_argument("value", nargs="?", metavar="true|false", help="for `torque`, which switches")
    it.add_argument("--list", action="store_true", help="the services that answer now, a line each")
    it.add_argument("--namespace", default="", metavar="NAME", help="of the nodes, as for `live`")
    it.share("domain", "set", "json")


def _completion(add: Callable[..., Parser]) -> None:
    it = add(
        "completion",
        command=obey.completion,
        help="a script with which a shell completes this command line",
        description="Print what a shell reads to complete commands, options and names: `source <(proprio completion bash)` in "
        "~/.bashrc, the same with zsh in ~/.zshrc; `proprio completion fish > ~/.config/fish/completions/proprio.fish`.",
    )
    it.add_argument("shell", choices=SHELLS, help="the shell")


def probe_names() -> list[str]:
    """All that ``--probe`` can name."""
    return [probe.name for probe in all_probes()]
