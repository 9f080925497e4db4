"""Writes the pages that follow from the code: ``python docs/generate.py`` (after a change of an option, a
parameter, a topic or a file of ``results``).

``pages/command_line.md`` comes from the parser of ``proprio_ros/cli``; ``pages/ros_interface.md`` from the parameter tables
of the nodes and from the calls in ``configure`` that make publishers, subscriptions and services. ``pages/settings.md`` comes
from the forms of settings, robot files and calibrations, and from the limits of what is read, ``pages/refusals.md`` from the
codes of reasons, ``pages/conformance.md`` from the table of ``test/conformance``. None needs ROS: where
rclpy is missing, empty classes stand in for what the nodes import from it, so that the pages are the same everywhere.
Tables of figures in README, ``pages/validation.md`` and ``pages/validation`` come from ``results`` (`figures`), and so does
``results/efficiency.md``.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.abc
import importlib.machinery
import importlib.util
import operator
import os
import sys
import tempfile
import textwrap
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import conformance_page
import efficiency
import figures
import notebook
import refusals_page
import settings_page
from connections import Connection, Reader

from proprio_ros.excitation.effort_controller import EffortController
from proprio_ros.excitation.goal_controller import GoalController

PAGES = Path(__file__).resolve().parent / "pages"
NOTE = "<!-- written by docs/generate.py from the code: change that instead -->"
NODES = {
    "driver": "DriverNode",
    "excitation": "ExcitationNode",
    "identifier": "IdentifierNode",
    "virtual": "VirtualNode",
}
PARTS: dict[str, tuple[tuple[str, dict[str, Any]], ...]] = {
    "identifier": (
        ("results:Results.__init__", {}),
        ("carrying:Carrying.__init__", {}),
        ("inputs:Inputs._listen_to_arm", {}),
        ("inputs:Inputs._listen_to_voltage_driven", {}),
        ("inputs:Inputs._listen_to_driver", {}),
        ("inputs:Inputs._listen_to_inputs_of_others", {}),
        ("excitation_client:Excitation.__init__", {}),
    ),
    "excitation": (
        (
            "excitation:ExcitationNode._controller_output",
            {"interface": "effort", "controller": EffortController},
        ),
        (
            "excitation:ExcitationNode._controller_output",
            {"interface": "position", "controller": GoalController},
        ),
    ),
}
"""What makes connections beside a node's `configure`: a module of nodes, a class and its method, arguments of it and
what it computes."""
ROS = ("rclpy", "rcl_interfaces", "builtin_interfaces", "diagnostic_msgs", "geometry_msgs", "sensor_msgs", "std_msgs",
       "std_srvs", "visualization_msgs")  # fmt: skip


# --- command line -------------------------------------------------------------------------------------------------------


def command_line() -> str:
    """The page about ``proprio``."""
    from proprio_ros.cli.parser import make_parser

    parser = make_parser()
    commands = dict(_commands(parser))
    shared = _shared(command for _, command in commands.values())
    parts = [
        NOTE,
        "# Command line",
        "Results go to stdout, everything else to stderr. Exit codes: 0 accepted, 2 bad input, "
        "3 rejected, not identifiable or too wide, "
        "130 interrupted, 143 ended by SIGTERM. "
        "`proprio --version` prints the version; every command explains itself with `--help`. Options that several commands have "
        "stand [at the end](#shared-options).",
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
        options = [_option(action) for action in command._actions if action.dest != "help"]
        own = [row for row in options if row not in shared]
        if own:
            parts.append(_table(("argument", "default", "meaning"), own))
        if command.epilog:
            parts.append(command.epilog)
    parts += ["## Shared options", "They mean the same wherever the lines above have them."]
    parts.append(_table(("argument", "default", "meaning"), shared))
    return "\n\n".join(part for part in parts if part) + "\n"


def _shared(commands: Iterable[argparse.ArgumentParser]) -> list[tuple[str, str, str]]:
    """Options that several commands have with the same words."""
    every = [_option(action) for command in commands for action in command._actions]
    rows = [row for row in every if row[0].startswith("`--") and row[0] != "`--help`"]
    return [row for row in dict.fromkeys(rows) if rows.count(row) > 1]


def _commands(
    parser: argparse.ArgumentParser, before: str = ""
) -> Iterator[tuple[str, tuple[Any, argparse.ArgumentParser]]]:
    """Name, help and parser of every command; of a command with commands of its own, those."""
    for group in [
        action for action in parser._actions if isinstance(action, argparse._SubParsersAction)
    ]:
        helps = {choice.dest: choice.help for choice in group._choices_actions}
        for name, command in group.choices.items():
            if name not in helps:  # an alias
                continue
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
    words = [_in_short(action) for action in actions]
    return textwrap.fill(
        " ".join(["proprio", name, *(word.replace(" ", "\0") for word in words)]),
        width=100, subsequent_indent=" " * 8, break_long_words=False, break_on_hyphens=False,
    ).replace("\0", " ")  # fmt: skip


def _in_short(action: argparse.Action) -> str:
    """As a line of usage has it: what need not be there in brackets, of options without their value, which tables have."""
    if action.required and action.nargs != "*":
        return _invocation(action)
    return f"[{action.option_strings[-1] if action.option_strings else _invocation(action)}]"


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


def connections_of(name: str, module: ModuleType, node: Any) -> list[Connection]:
    """What a node makes in `configure`, and in its parts, each once."""
    values = {parameter.name: parameter.default for parameter in node.parameters}
    readers = [Reader(name, node.configure, vars(module), values)]
    for part, given in PARTS.get(name, ()):
        place, _, method = part.partition(":")
        module = importlib.import_module(f"proprio_ros.nodes.{place}")
        function = operator.attrgetter(method)(module)
        readers.append(Reader(name, function, {**vars(module), **given}, values))
    found = [connection for reader in readers for connection in reader.connections()]
    return list(dict.fromkeys(found))


def _deadlines() -> str:
    """By when a call of the identifier is answered."""
    from proprio_ros.live.deadlines import CANCELLED_S, REPEAT_S, STAGES

    waits = "; ".join(f"{stage.waits_for}: {stage.at_most_s:g} s" for stage in STAGES)
    return (
        "A call of the identifier is answered with what it waits for, and its job ends, when it has got no further for "
        f"so long ({waits}). `~/status` repeats that every {REPEAT_S:g} s; `~/cancel` answers within {CANCELLED_S:g} s."
    )


def ros_interface() -> str:
    """The page about topics, services and parameters."""
    from proprio_ros.nodes.interface import about, interface_of
    from proprio_ros.nodes.tables import AUTOSTART

    parts = [
        NOTE,
        "# ROS interface",
        "All are lifecycle nodes that configure and activate themselves (`autostart:=false` leaves that to you). Names below are "
        "those without a namespace; topics are relative, so remapping and `namespace:=arm1` work as usual. *Latched*: transient "
        "local, depth 1, so who comes late still gets the last message. Services answer `success` and a sentence in `message`; "
        "while a job is under way others are refused with the reason.",
        _deadlines(),
    ]
    explained = _Once("as above")
    meant = _Once("as above")
    for name, (module, node) in nodes().items():
        parts += [
            f"## {name}",
            f"`proprio_{name}`. {interface_of(name).about}",
        ]
        found = connections_of(name, module, node)
        for what, title in (("publishes", "Publishes"), ("takes", "Takes"), ("serves", "Services")):
            rows = [
                (
                    f"`{topic}`",
                    f"`{kind}`",
                    explained(about(topic)),
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
        parts += [
            "### Parameters",
            _table(
                ("parameter", "default", "range", "meaning"),
                [_parameter(each, meant) for each in (AUTOSTART, *node.parameters)],
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


def _parameter(parameter: Any, meant: _Once) -> tuple[str, str, str, str]:
    stated = str(parameter.default).replace(tempfile.gettempdir(), "/tmp")
    default = f"`{stated}`" if parameter.default not in ("", []) else "empty"
    default = {"`True`": "`true`", "`False`": "`false`"}.get(default, default)
    bounded = parameter.lowest is not None and parameter.highest is not None
    about = meant(parameter.description) + (" *running*" if parameter.dynamic else "")
    return (
        f"`{parameter.name}`",
        default,
        f"{parameter.lowest:g} .. {parameter.highest:g}" if bounded else "",
        about,
    )


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
        PAGES / "settings.md": settings_page.page(NOTE, _table, _Once("as above")),
        PAGES / "refusals.md": refusals_page.page(NOTE),
        PAGES / "conformance.md": conformance_page.page(NOTE, _table),
        PAGES.parents[1] / "examples" / "first_weighing.ipynb": notebook.notebook(
            notebook.unexecuted(notebook.SCRIPT.read_text(encoding="utf-8")), ran=False
        ),
        **measured(),
    }


def measured() -> dict[Path, str]:
    """Every page with figures of benchmarks, with what should be in it."""
    found = (PAGES.parents[1] / "README.md", *sorted(PAGES.rglob("*.md")))
    texts = {path: path.read_text(encoding="utf-8") for path in found}
    filled = {
        path: figures.filled(text) for path, text in texts.items() if figures.BLOCK.search(text)
    }
    return {**filled, figures.RESULTS / "efficiency.md": efficiency.page()}


if __name__ == "__main__":
    # only what benchmarks measured: no code is imported
    chosen = measured() if sys.argv[1:] == ["figures"] else pages()
    for path, text in chosen.items():
        path.write_text(text, encoding="utf-8")
