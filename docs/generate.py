"""Writes the pages that follow from the code: ``python docs/generate.py`` (after a change of an option, a
parameter, a topic or a file of ``results``).

``pages/command_line.md`` comes from the parser of ``proprio_ros/cli``; ``pages/ros_interface.md`` from the parameter tables
of the nodes and from the calls in ``configure`` that make publishers, subscriptions and services. ``pages/settings.md`` comes
from the forms of settings, robot files and calibrations, and from the limits of what is read, ``pages/refusals.md`` from the
codes of reasons, ``pages/conformance.md`` from the table of ``test/conformance``. None needs ROS: where
rclpy is missing, empty classes stand in for what the nodes import from it, so that the pages are the same everywhere.
Tables of figures in README, ``pages/validation.md`` and ``pages/validation`` come from ``results`` (`figures`).
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import importlib
import importlib.abc
import importlib.machinery
import importlib.util
import inspect
import operator
import os
import sys
import tempfile
import textwrap
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import conformance_page
import figures

PAGES = Path(__file__).resolve().parent / "pages"
NOTE = "<!-- written by docs/generate.py from the code: change that instead -->"
NODES = {
    "driver": "DriverNode",
    "excitation": "ExcitationNode",
    "identifier": "IdentifierNode",
    "virtual": "VirtualNode",
}
PARTS: dict[str, tuple[tuple[str, dict[str, str]], ...]] = {
    "identifier": (
        ("results:Results.__init__", {}),
        ("carrying:Carrying.__init__", {}),
        ("inputs:Inputs.open", {}),
        ("excitation_client:Excitation.__init__", {}),
    ),
    "excitation": (
        ("excitation:ExcitationNode._controller_output", {"interface": "effort"}),
        ("excitation:ExcitationNode._controller_output", {"interface": "position"}),
    ),
}
"""What makes connections beside a node's `configure`: a module of nodes, a class and its method, and arguments of it."""
ROS = ("rclpy", "rcl_interfaces", "builtin_interfaces", "diagnostic_msgs", "geometry_msgs", "sensor_msgs", "std_msgs",
       "std_srvs", "visualization_msgs")  # fmt: skip
ABOUT = {
    "/joint_states": "positions [rad, m], velocities [rad/s, m/s], effort [N m, N]: present current x nominal torque constant",
    "/robot_description": "URDF, as `robot_state_publisher` publishes it; only where `robot` is the name of this topic",
    "/applied_effort": "same stamps: commanded current x nominal torque constant [N m, N]",
    "/applied_current": "commanded current [A], `layout.dim` labelled by joint, to plot",
    "/torque_enabled": "false while a joint is without torque: all of them, or one that a lease drives with a current of zero",
    "/diagnostics": "bus, servos, late cycles, left-out samples; once a second, and at once when the driver's state changes",
    "/current_command": "currents [A], in the order of `joints`, or of the labels in `layout.dim`; one publisher at a time, and a "
    "zero lets go of a joint only after a push",
    "/forward_effort_controller/commands": "with an effort controller, instead of those above: efforts in `effort_unit`, in the "
    "order of `controller_joints`",
    "/position_controller/commands": "with a position controller: goals [rad, m], likewise",
    "/joint_command": "with a position controller: the goals that were sent [rad, m], by name; the identifier records them where "
    "the robot file says that servos follow goals",
    "/battery_state": "supply voltage, where voltages drive the motors",
    "/position_command": "goal positions [rad, m], labelled likewise; above the table, one publisher at a time",
    "/driver/status": "`state`: running, stopped, released, disconnected, inactive; at once when it changes",
    "/motor_temperatures": "how warm each motor is, labelled by joint [deg C]; a calibration ages by it",
    "/motors": "what each servo keeps without power, as JSON by joint: whose arm it is; a calibration is refused on another",
    "/excitation/status": "what the sequence is doing",
    "/excitation/lease": "true, again and again: the sequence is wanted, and ends after 1.5 s of silence; false: no more",
    "/excitation/run": "make the sequence named by the parameter `probe`",
    "/excitation/abort": "end it; the driven joint is braked and held",
    "/excitation/release": "let go of an arm that efforts hold: they are zero, and it comes down; servos stay at their last "
    "goals, the driver's arm as it is, and where controllers are switched the arm is handed back",
    "/driver/stop": "all currents to zero, at once, until `~/torque` is called",
    "/driver/torque": "torque on or off",
    "/identifier/estimate": "every value with unit, standard deviation, 95 % interval, verdict, reasons, calibration used; of a "
    "payload also while the probe is under way, and with `running` all the time, with `changed`, stamped by the newest "
    "joint state that it rests on: `seconds_behind` says how long ago that was sent; from 1 s on its level is WARN and `holding` "
    "is `unknown`, from 3 s on it is `not determined`, with `verdict` `withdrawn` and the reason",
    "/identifier/payload": "mass, centre of mass and inertia, in the frame of the link that holds it; `inertia` of `~/estimate` "
    "says whether that tensor is identified, stated, or assumed: that of the ball in `config/probes/payload.yaml`; with "
    "`running` stamped as `~/estimate`, and NaN when it is withdrawn",
    "/identifier/holding": "whether something is in the hand, published when that changes: at a probability of 0.99, and back at "
    "0.01; it keeps its value meanwhile, and `holding` of `~/estimate` says `unknown`, as where the estimate is late",
    "/identifier/gravity_effort": "with `gravity_effort_rate`, while it is known what the hand holds: efforts that carry arm and "
    "payload in the pose of this stamp, without friction [N m]",
    "/identifier/gravity_effort_std": "their standard deviations, with the same stamp and joints [N m]",
    "/identifier/capability": "whether the arm can carry what it holds, here or to the goal on `~/carry_to`: `can_carry`, the "
    "`joint` that decides, its `margin` of the limit, `most`, the heaviest load [kg], and `stamp` [s] of the newest joint state "
    "that what it holds rests on; `can_carry` is `unknown` when that is withdrawn",
    "/identifier/carry_to": "positions of some joints [rad]: can what is held be carried there on the straight way of the joints?",
    "/identifier/mass": "kg, to plot, of the payload or of the sphere; NaN as soon as something else is asked for",
    "/identifier/sphere_mass": "kg, to plot",
    "/identifier/fill": "m, how high a liquid stands, to plot",
    "/identifier/liquid_inside": "probability of a liquid, to plot",
    "/identifier/youngs_modulus": "Pa, to plot",
    "/identifier/lame_mu": "Pa, to plot",
    "/identifier/lame_lambda": "Pa, to plot",
    "/identifier/markers": "for RViz",
    "/identifier/status": "progress, and what the hand should hold now",
    "/identifier/calibrate_robot": "empty hand: calibrate the robot; once, and when something has changed",
    "/identifier/next_push": "what is known after a push, in words, and the way of the hand in the push that comes next, in RViz",
    "/identifier/refresh_robot": "empty hand: some chosen pushes that bring its calibration up to date; now and then",
    "/identifier/record_container_baseline": "make the container's sequence with the empty container, and keep the recording",
    "/identifier/record_contents_baseline": "make the sequence of the contents with the empty container, and keep the recording",
    "/identifier/weigh": "what the hand held in the last `weigh_seconds` of whatever motion",
    "/identifier/apply": "export the accepted load to the arm's own controller (`hand_on`)",
    "/identifier/cancel": "end the job; what was recorded is kept",
    "/virtual/status": "what the virtual hand holds",
    "/virtual/motors": "what is really going on: true positions [rad, m], and as effort the current in each motor [A]",
}  # fmt: skip


# --- command line -------------------------------------------------------------------------------------------------------


def command_line() -> str:
    """The page about ``proprio``."""
    from proprio_ros.cli.parser import make_parser

    parser = make_parser()
    commands = dict(_commands(parser))
    parts = [
        NOTE,
        "# Command line",
        "Results go to stdout, everything else to stderr. Exit codes: 0 accepted, 2 bad input, "
        "3 rejected, not identifiable or too wide, "
        "130 interrupted, 143 ended by SIGTERM. "
        "`proprio --version` prints the version; every command explains itself with `--help`.",
        _table(
            ("command", "does"),
            [
                (f"[`proprio {name}`](#proprio-{name.replace(' ', '-')})", about)
                for name, (about, _) in commands.items()
            ],
        ),
    ]
    for name, (_, command) in commands.items():
        parts += [
            f"## proprio {name}",
            command.description or "",
            f"```\n{_usage(name, command)}\n```",
        ]
        options = [action for action in command._actions if action.dest != "help"]
        parts.append(
            _table(("argument", "default", "meaning"), [_option(action) for action in options])
        )
        if command.epilog:
            parts.append(command.epilog)
    return "\n\n".join(part for part in parts if part) + "\n"


def _commands(
    parser: argparse.ArgumentParser, before: str = ""
) -> Iterator[tuple[str, tuple[Any, argparse.ArgumentParser]]]:
    """Name, help and parser of every command; of a command with commands of its own, those."""
    for group in [
        action for action in parser._actions if isinstance(action, argparse._SubParsersAction)
    ]:
        helps = {choice.dest: choice.help for choice in group._choices_actions}
        for name, command in group.choices.items():
            inner = dict(_commands(command, f"{before}{name} "))
            yield from inner.items() if inner else [(f"{before}{name}", (helps[name], command))]


def _invocation(action: argparse.Action) -> str:
    """As it is written on the command line, without brackets."""
    value = (
        action.metavar
        or (None if action.choices is None else "|".join(map(str, action.choices)))
        or action.dest.upper()
    )
    if action.nargs == 0:
        return action.option_strings[-1]
    many = f"{value} [{value} ...]" if action.nargs in ("+", "*") else str(value)
    again = " ..." if isinstance(action, argparse._AppendAction) and action.nargs is None else ""
    return f"{action.option_strings[-1]} {many}{again}" if action.option_strings else many


def _usage(name: str, command: argparse.ArgumentParser) -> str:
    actions = [action for action in command._actions if action.dest != "help"]
    words = [
        _invocation(a) if a.required and a.nargs != "*" else f"[{_invocation(a)}]" for a in actions
    ]
    return textwrap.fill(
        " ".join(["proprio", name, *(word.replace(" ", "\0") for word in words)]),
        width=100, subsequent_indent=" " * 8, break_long_words=False, break_on_hyphens=False,
    ).replace("\0", " ")  # fmt: skip


def _option(action: argparse.Action) -> tuple[str, str, str]:
    default = (
        "" if action.default in (None, [], False) or action.required else f"`{action.default}`"
    )
    choices = (
        f" ({', '.join(f'`{choice}`' for choice in action.choices)})"
        if action.choices and action.metavar
        else ""
    )
    return f"`{_invocation(action)}`", default, (action.help or "") + choices


# --- ROS interface ------------------------------------------------------------------------------------------------------


class _Stand(type):
    """A class that has any attribute, each again such a class; calling it makes nothing of interest."""

    def __getattr__(cls, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return _Stand(
            name, (), {"__module__": cls.__module__, "__init__": lambda self, *args, **kwargs: None}
        )


class _StandInFinder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Finds a module of ROS where there is none."""

    def find_spec(
        self, name: str, path: Any = None, target: Any = None
    ) -> importlib.machinery.ModuleSpec | None:
        return (
            importlib.machinery.ModuleSpec(name, self, is_package=True)
            if name.split(".")[0] in ROS
            else None
        )

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> ModuleType:
        module = ModuleType(spec.name)
        stand = _Stand(spec.name, (), {"__module__": spec.name})
        module.__getattr__ = lambda name: getattr(stand, name)
        return module

    def exec_module(self, module: ModuleType) -> None:
        pass


def stand_in_for_ros() -> None:
    """From now on whatever is imported from ROS is an empty class."""
    sys.meta_path.insert(0, _StandInFinder())


def nodes() -> dict[str, tuple[ModuleType, type]]:
    """Module and class of every node, imported with rclpy or without it."""
    if importlib.util.find_spec("rclpy") is None:
        stand_in_for_ros()
    found = {}
    for name, kind in NODES.items():
        module = importlib.import_module(f"proprio_ros.nodes.{name}")
        found[name] = (module, getattr(module, kind))
    return found


def connections(name: str, module: ModuleType, node: Any) -> Iterator[tuple[str, str, str, str]]:
    """What a node makes in `configure`, and in its parts; see `_made_by`."""
    values = {parameter.name: parameter.default for parameter in node.parameters}
    yield from _made_by(node.configure, vars(module), name, values)
    for part, given in PARTS.get(name, ()):
        place, _, method = part.partition(":")
        module = importlib.import_module(f"proprio_ros.nodes.{place}")
        yield from _made_by(
            operator.attrgetter(method)(module), {**vars(module), **given}, name, values
        )


def _made_by(
    function: Any, known: dict[str, Any], name: str, values: dict[str, Any]
) -> Iterator[tuple[str, str, str, str]]:
    """What a function makes: ``publishes``, ``takes`` or ``serves``; the full name, the type, and how messages are kept.

    The body is read, not run: loops over tables of the module are followed, and names are computed from what they hold.
    """
    body = ast.parse(textwrap.dedent(inspect.getsource(function))).body[0]
    scope = {
        **known,
        "self": SimpleNamespace(
            values=values,
            conventions=importlib.import_module("proprio_ros.recordings.topics").OUR_DRIVER,
        ),
        "node": SimpleNamespace(values=values),
    }
    # a kind of connection, and which of its arguments are type, name and quality of service
    makers = {"create_publisher": ("publishes", 0, 1, 2), "create_subscription": ("takes", 0, 1, 3),
              "listen": ("takes", 0, 1, 3),
              "create_service": ("serves", 0, 1, None), "LongService": ("serves", None, 1, None)}  # fmt: skip

    def of(expression: ast.expr, local: dict[str, Any]) -> Any:
        return eval(compile(ast.Expression(expression), name, "eval"), {**scope, **local})

    def bound(target: ast.expr, value: Any) -> dict[str, Any]:
        if isinstance(target, ast.Name):
            return {target.id: value}
        assert isinstance(target, ast.Tuple)
        return {
            key: part
            for one, each in zip(target.elts, value, strict=True)
            for key, part in bound(one, each).items()
        }

    def maker(tree: ast.AST) -> str:
        called = (
            getattr(tree.func, "attr", getattr(tree.func, "id", ""))
            if isinstance(tree, ast.Call)
            else ""
        )
        return called if called in makers else ""

    def names(expression: ast.AST) -> set[str]:
        return {
            ast.unparse(part)
            for part in ast.walk(expression)
            if isinstance(part, (ast.Name, ast.Attribute))
        }

    # assignments are computed where a topic or a loop over topics needs them, and no others
    needed: set[str] = set()
    for part in ast.walk(body):
        if maker(part):
            assert isinstance(part, ast.Call)
            needed |= {
                name
                for place in makers[maker(part)][1:3]
                if place is not None
                for name in names(part.args[place])
            }
        elif isinstance(part, (ast.For, ast.comprehension)):
            needed |= names(part.iter)
    for part in reversed([part for part in ast.walk(body) if isinstance(part, ast.Assign)]):
        if ast.unparse(part.targets[0]) in needed:
            needed |= names(part.value)

    def walk(tree: ast.AST, local: dict[str, Any]) -> Iterator[tuple[str, str, str, str]]:
        if isinstance(tree, ast.Assign) and ast.unparse(tree.targets[0]) in needed:
            target = tree.targets[0]
            # if a topic needs it all the same, that is an error there
            with contextlib.suppress(Exception):
                if isinstance(target, ast.Attribute):
                    setattr(of(target.value, local), target.attr, of(tree.value, local))
                else:
                    local.update(bound(target, of(tree.value, local)))
        if not any(maker(part) for part in ast.walk(tree)):
            return
        if isinstance(tree, ast.For):
            for value in of(tree.iter, local):
                for statement in tree.body:
                    yield from walk(statement, {**local, **bound(tree.target, value)})
            return
        if isinstance(tree, (ast.DictComp, ast.ListComp)):
            (loop,) = tree.generators
            for value in of(loop.iter, local):
                element = tree.value if isinstance(tree, ast.DictComp) else tree.elt
                yield from walk(element, {**local, **bound(loop.target, value)})
            return
        if isinstance(tree, ast.Call) and maker(tree):
            what, kind_at, name_at, quality_at = makers[maker(tree)]
            kind = (
                "std_srvs/Trigger" if kind_at is None else _message(of(tree.args[kind_at], local))
            )
            quality = "" if quality_at is None else ast.unparse(tree.args[quality_at])
            topic = of(tree.args[name_at], local)
            full = f"/{name}{topic[1:]}" if topic.startswith("~") else "/" + topic.lstrip("/")
            yield what, full, kind, quality
        for child in ast.iter_child_nodes(tree):
            yield from walk(child, local)

    local: dict[str, Any] = {}
    assert isinstance(body, ast.FunctionDef)
    for statement in body.body:
        yield from walk(statement, local)


def ros_interface() -> str:
    """The page about topics, services and parameters."""
    parts = [
        NOTE,
        "# ROS interface",
        "All are lifecycle nodes that configure and activate themselves (`autostart:=false` leaves that to you). Names below are "
        "those without a namespace; topics are relative, so remapping and `namespace:=arm1` work as usual. *Latched*: transient "
        "local, depth 1, so who comes late still gets the last message. Services answer `success` and a sentence in `message`; "
        "while a job is under way others are refused with the reason.",
    ]
    explained = _Once("as above")
    for name, (module, node) in nodes().items():
        parts += [
            f"## {name}",
            f"`proprio_{name}`. " + inspect.cleandoc(node.__doc__ or "").split("\n\n")[0],
        ]
        found = list(dict.fromkeys(connections(name, module, node)))
        for what, title in (("publishes", "Publishes"), ("takes", "Takes"), ("serves", "Services")):
            rows = [
                (
                    f"`{topic}`",
                    f"`{kind}`",
                    explained(ABOUT.get(topic) or _about_probe(topic)),
                    "latched" * (quality == "LATCHED"),
                )
                for way, topic, kind, quality in found
                if way == what
            ]
            columns = (
                ("topic", "type", "holds", "") if what != "serves" else ("service", "type", "does")
            )
            if rows:
                parts += [f"### {title}", _table(columns, [row[: len(columns)] for row in rows])]
        parameters = importlib.import_module("proprio_ros.nodes.parameters")
        parts += [
            "### Parameters",
            _table(
                ("parameter", "default", "range", "meaning"),
                [_parameter(parameter) for parameter in (parameters.AUTOSTART, *node.parameters)],
            ),
        ]
    parts += [
        "## proprio_msgs",
        "Where the package `proprio_msgs` is built, too, the identifier publishes its estimates as messages with numbers, NaN "
        "where one is not known or stands no longer, and weighs as an action. `ros2 interface show` says what each field holds. "
        "From pip there are none of them, and the services do the same.",
        _table(
            ("name", "type", "holds"),
            [
                (
                    "`/identifier/mass_estimate`",
                    "`proprio_msgs/MassEstimate`",
                    "of payload or sphere: as `~/estimate`; latched",
                ),
                (
                    "`/identifier/elasticity_estimate`",
                    "`proprio_msgs/ElasticityEstimate`",
                    "of a block: as `~/estimate`; latched",
                ),
                (
                    "`/identifier/holding_estimate`",
                    "`proprio_msgs/Holding`",
                    "whether something is in the hand, how sure that is, and since when; latched",
                ),
                (
                    "`/identifier/weigh_action`",
                    "`proprio_msgs/Weigh`",
                    "as `~/calibrate_payload`, `~/calibrate_container` or `~/weigh`, with facts and sequence in the goal; a goal "
                    "is refused while a job is under way, or where its target, sequence or settings cannot be (the reason stands "
                    "in the log), and cancelling it does what `~/cancel` does, which ends it as CANCELED",
                ),
            ],
        ),
    ]
    parts.append(
        "*running*: may be changed with `ros2 param set` while the node runs; the others are read when it is configured."
    )
    return "\n\n".join(parts) + "\n"


class _Once:
    """Words that were shown before are not shown again, where that is shorter.

    Args:
        instead: What stands in their place.
    """

    def __init__(self, instead: str) -> None:
        self.instead = instead
        self.shown: set[str] = set()

    def __call__(self, words: str) -> str:
        known = words in self.shown and len(words) > len(self.instead)
        self.shown.add(words)
        return self.instead if known else words


def _about_probe(topic: str) -> str:
    _, found, probe = topic.partition("/identifier/calibrate_")
    return f"make the sequence named by `{probe}_sequence`, and identify" if found else ""


def _message(kind: type) -> str:
    return f"{kind.__module__.split('.')[0]}/{kind.__name__}"


def _parameter(parameter: Any) -> tuple[str, str, str, str]:
    stated = str(parameter.default).replace(tempfile.gettempdir(), "/tmp")
    default = f"`{stated}`" if parameter.default not in ("", []) else "empty"
    default = {"`True`": "`true`", "`False`": "`false`"}.get(default, default)
    bounded = parameter.lowest is not None and parameter.highest is not None
    about = parameter.description + (" *running*" if parameter.dynamic else "")
    return (
        f"`{parameter.name}`",
        default,
        f"{parameter.lowest:g} .. {parameter.highest:g}" if bounded else "",
        about,
    )


# --- settings and files -------------------------------------------------------------------------------------------------


def settings() -> str:
    """The page about settings, robot files, calibrations and limits."""
    from proprio_ros.addons.contents.facts import FORMS as OF_CONTENTS
    from proprio_ros.calibration_files.pushes import NOISE, RANGES
    from proprio_ros.inputs import reading
    from proprio_ros.inputs.forms import REQUIRED
    from proprio_ros.inputs.settings import SEARCH, probe_file
    from proprio_ros.kinds import KINDS
    from proprio_ros.probes.container.facts import FORMS as OF_CONTAINER
    from proprio_ros.probes.payload.facts import FORMS as OF_PAYLOAD
    from proprio_ros.probes.softness.facts import FORMS as OF_BLOCK
    from proprio_ros.recordings import reader, storage, text
    from proprio_ros.recordings.drivers import COLUMNS, FORMS, INPUT
    from proprio_ros.robot import fields as robot_fields
    from proprio_ros.robot import urdf

    parts = [
        NOTE,
        "# Settings, files and limits",
        "What a setting (`--set KEY=VALUE`, the identifier's parameter `settings`), a robot file, a driver profile and a "
        "calibration may say. Ranges are "
        "wider than any arm on a table needs; what lies outside is refused in one sentence. Defaults are those of "
        "the files in `config/probes`.",
    ]
    explained = _Once("as above")
    of_probes = {
        "payload": OF_PAYLOAD,
        "container": OF_CONTAINER,
        "softness": OF_BLOCK,
        "contents": OF_CONTENTS,
    }
    for probe, forms in of_probes.items():
        content = probe_file(probe)
        rows = []
        for key, form in (forms | SEARCH).items():
            section, _, name = key.partition(".")
            if key in forms or name in content.get(section, {}):
                value = content.get(section, {}).get(name)
                rows.append(
                    (
                        f"`{key}`",
                        "" if value is None else f"`{_yaml(value)}`",
                        form.described(),
                        explained(form.meaning),
                    )
                )
        parts += [f"## Probe {probe}", _table(("key", "default", "value", "meaning"), rows)]
    parts += [
        "`payload.size`, `container.inner_size` and `block.size` are lengths in m of the form that the shape needs: a diameter or "
        "an "
        "edge, `[diameter, length]`, or `[x, y, z]`. `payload.frame` is a link of the robot, `held.JOINT` the position of a joint "
        "that "
        "was locked and not recorded, and `robot.KEY` any key of the robot file.",
        "## Robot file",
        "An uncertain number is `{value: .., std: ..}`; a plain one is known exactly; `null` is left out, and what is left out has "
        "its default. `proprio robot new` writes a file with every key. The nominal torque constant may be left out where the "
        "drive train's is stated.",
    ]
    for title, fields in (
        ("The robot", robot_fields.ROBOT),
        ("joints: JOINT", robot_fields.JOINT),
        ("joints: JOINT: motor", robot_fields.MOTOR),
        ("joints: JOINT: drive_train", robot_fields.DRIVE_TRAIN),
    ):
        rows = [
            (
                f"`{key}`",
                _default(field.default, REQUIRED),
                field.form.described(),
                explained(field.form.meaning),
            )
            for key, field in fields.items()
        ]
        parts += [f"### {title}", _table(("key", "default", "value", "meaning"), rows)]
    parts += [
        "## Driver profile",
        "Files of `config/drivers`, or of your own, for `--driver` and the identifier's parameter `driver`. Keys that are left out "
        "are those of the profile that a file extends. Topics are named without a namespace, and found in any.",
        _table(
            ("key", "value", "meaning"),
            [(f"`{key}`", form.described(), form.meaning) for key, form in FORMS.items()],
        ),
        "### inputs",
        _table(
            ("key", "value", "meaning"),
            [(f"`{key}`", form.described(), form.meaning) for key, form in INPUT.items()],
        ),
        "### columns",
        _table(
            ("key", "value", "meaning"),
            [(f"`{key}`", form.described(), form.meaning) for key, form in COLUMNS.items()],
        ),
        "## Calibration",
        "The section `calibration` of a robot file, as `proprio calibrate` writes it. `model_fingerprint` is required; joints and "
        "links "
        "must be the robot's; of a calibrated joint no unknown may be missing that the robot file leaves open; a torque constant "
        "lies "
        "within five times the motor's nominal one, up or down. A number within its range that is nevertheless wrong cannot be "
        "seen "
        "in the file: only further runs show it (`--baseline`).",
        _table(
            ("unknown", "value", "meaning"),
            [
                (
                    f"`{kind}[{KINDS[kind].of.upper()}]`" if KINDS[kind].of else f"`{kind}`",
                    form.described(),
                    form.meaning,
                )
                for kind, form in RANGES.items()
            ]
            + [
                (f"`{key}`", form.described(), explained(form.meaning))
                for key, form in NOISE.items()
            ],
        ),
        "## Limits",
        _table(
            ("of", "at most"),
            [
                ("a YAML, JSON or URDF file", f"{reading.LONGEST_TEXT / 1e6:g} MB"),
                ("lists and mappings within each other", str(reading.DEEPEST)),
                (
                    "values of a YAML file, aliases counted as what they stand for",
                    str(reading.MOST_NODES),
                ),
                ("VALUE of a setting", f"{reading.LONGEST_VALUE} characters"),
                ("links of a URDF, and joints", str(urdf.MOST_LINKS)),
                ("names of joints and links", f"{urdf.LONGEST_NAME} printable characters"),
                ("rows of a CSV file", str(text.MOST_ROWS)),
                (
                    "messages of one topic",
                    f"{reader.MOST_MESSAGES}, {reader.MOST_BYTES / 1e6:g} MB together",
                ),
                ("one message", f"{reader.MOST_BYTES_OF_ONE / 1e3:g} kB"),
                ("files of a compressed bag, unpacked", f"{storage.MOST_UNPACKED / 1e9:g} GB each"),
            ],
        ),
    ]
    return "\n\n".join(parts) + "\n"


def _yaml(value: Any) -> str:
    return (
        {True: "true", False: "false"}.get(value, str(value))
        if isinstance(value, bool)
        else str(value)
    )


def _default(value: Any, required: Any) -> str:
    if value is required:
        return "required"
    if value is None or value == "" or value == float("inf"):
        return ""
    if hasattr(value, "described"):
        return str(value.described())
    if getattr(value, "std", 0.0):
        return f"`{{value: {value.value:g}, std: {value.std:g}}}`"
    return f"`{_yaml(getattr(value, 'value', list(value) if isinstance(value, tuple) else value))}`"


# --- refusals -----------------------------------------------------------------------------------------------------------


def refusals() -> str:
    """The page with every code of a reason."""
    from proprio_ros.identification.reasons import CODES, REMEDIES

    parts = [
        NOTE,
        "# Refusals",
        "Why an answer was refused, or is wider or less certain than it could be: what each reason means, and what to do. The "
        "command line and a report give the reason as a sentence about your recording, with the joint, the number and the remedy; "
        "`--json` gives its code in `reason_codes`, as here. A code keeps its meaning; the words of a sentence may change.",
        "What the reason makes of the answer is the [verdict](results.md#verdicts). Beside `accepted` a reason is a warning that "
        "the interval already counts. Exit code 2 is no refusal: something was mistyped, or cannot be read, and one line says what "
        "and what to do.",
        "A joint that stuck is refused most often (`stuck`, `short_travel`); on a new arm a wrong unit (`arm_unlike_urdf`, "
        "`misfit`), which `proprio check` shows before any fit.",
    ]
    for code, meaning in CODES.items():
        parts += [
            f"## {code}",
            f"{meaning[0].upper()}{meaning[1:]}.",
            f"**What to do**: {REMEDIES[code]}.",
        ]
    return "\n\n".join(parts) + "\n"


# --- both ---------------------------------------------------------------------------------------------------------------


def _table(columns: tuple[str, ...], rows: list[Any]) -> str:
    def line(cells: Any) -> str:
        return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"

    return "\n".join([line(columns), "|" + "---|" * len(columns), *map(line, rows)])


def pages() -> dict[Path, str]:
    """Every generated page, with what should be in it."""
    os.environ.pop("PROPRIO_PROBES", None)  # the package's own probes
    return {
        PAGES / "command_line.md": command_line(),
        PAGES / "ros_interface.md": ros_interface(),
        PAGES / "settings.md": settings(),
        PAGES / "refusals.md": refusals(),
        PAGES / "conformance.md": conformance_page.page(NOTE, _table),
        **measured(),
    }


def measured() -> dict[Path, str]:
    """Every page with figures of benchmarks, with what should be in it."""
    found = (PAGES.parents[1] / "README.md", *sorted(PAGES.rglob("*.md")))
    texts = {path: path.read_text(encoding="utf-8") for path in found}
    return {
        path: figures.filled(text) for path, text in texts.items() if figures.BLOCK.search(text)
    }


if __name__ == "__main__":
    # only what benchmarks measured: no code is imported
    chosen = measured() if sys.argv[1:] == ["figures"] else pages()
    for path, text in chosen.items():
        path.write_text(text, encoding="utf-8")
