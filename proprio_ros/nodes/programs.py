"""The programs `proprio_driver`, `proprio_excitation`, `proprio_identifier` and `proprio_virtual`.

What they are is said, and a word that none of them takes refused, before anything of ROS is loaded.
"""

from __future__ import annotations

import difflib
import importlib
import logging
import os
import shutil
import signal
import sys
import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NoReturn

from proprio_ros.errors import ConfigurationError, ProprioError, one_line
from proprio_ros.nodes.interface import about, interface_of
from proprio_ros.nodes.tables import AUTOSTART, NODES, Parameter
from proprio_ros.version import __version__, to_install

CANNOT_START = 2  # exit code
PARAMETER_WORDS = ("-p", "--param")
OF_ROS = ("use_sim_time", "start_type_description_service", "qos_overrides.", "diagnostic_updater.")
"""Names, or what names begin with, of parameters that every node of ROS has."""
NARROWEST = 60
WIDEST = 110


def driver() -> int:
    """Entry point of `proprio_driver`."""
    return _run("driver", sys.argv[1:])


def excitation() -> int:
    """Entry point of `proprio_excitation`."""
    return _run("excitation", sys.argv[1:])


def identifier() -> int:
    """Entry point of `proprio_identifier`."""
    return _run("identifier", sys.argv[1:])


def virtual() -> int:
    """Entry point of `proprio_virtual`."""
    return _run("virtual", sys.argv[1:])


def _run(node: str, words: Sequence[str]) -> int:
    if {"-h", "--help"} & set(words):
        sys.stdout.write(f"{help_of(node)}\n")
        return 0
    if "--version" in words:
        sys.stdout.write(f"proprio_{node} {__version__}\n")
        return 0
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _leave)
    try:
        check_words(node, words)
        main = loaded(f"proprio_ros.nodes.{node}").main
    except ProprioError as error:
        logging.getLogger("proprio_ros").error("proprio_%s: %s", node, error)
        return CANNOT_START
    return int(main())


def _leave(_number: int, _frame: Any) -> NoReturn:
    """Asked to end while libraries are loaded, where an exception could land anywhere: nothing is held yet."""
    os._exit(0)


def loaded(module: str) -> Any:
    """A module that needs ROS. Raises `ConfigurationError`: There is none on this computer, or another library is missing."""
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        raise missing(str(error.name)) from error


def missing(module: str) -> ConfigurationError:
    """What to do about a module that is not there: ROS from apt is sourced, and never mixed with its wheels."""
    if module != "mujoco" and Path("/opt/ros").is_dir():
        return ConfigurationError(f"{module} is missing: source /opt/ros/jazzy/setup.bash first")
    return ConfigurationError(f"{module} is missing: {to_install('ros,sim')}")


def check_words(node: str, words: Sequence[str]) -> None:
    """Look for words that nobody would obey, on a node's command line.

    Raises:
        ConfigurationError: There is one.
    """
    ours = True
    for at, word in enumerate(words):
        if word == "--ros-args":
            ours = False
        elif word == "--":
            ours = True
        elif ours:
            hint = f"proprio_{node} --ros-args -p NAME:=VALUE; --help lists the parameters"
            raise ConfigurationError(f"{one_line(word, 60)}: unknown argument; write {hint}")
        elif word in PARAMETER_WORDS:
            _check_parameter(node, words[at + 1] if at + 1 < len(words) else "")


def _check_parameter(node: str, assignment: str) -> None:
    name, assigned, _ = assignment.partition(":=")
    if not assigned:
        stated = one_line(assignment, 60) or "nothing"
        raise ConfigurationError(f"-p {stated}: write -p NAME:=VALUE")
    known = [parameter.name for parameter in (AUTOSTART, *NODES[node])]
    # with a colon it is of the node that is named before it
    if ":" in name or name in known or name.startswith(OF_ROS):
        return
    near = difflib.get_close_matches(name, known, 1)
    hint = f"is {near[0]} meant? " if near else ""
    raise ConfigurationError(
        f"-p {one_line(name, 40)}: the {node} node has no such parameter; {hint}--help lists them"
    )


def help_of(node: str) -> str:
    """What a node is, its parameters, topics and services."""
    width = min(max(shutil.get_terminal_size().columns - 2, NARROWEST), WIDEST)
    interface = interface_of(node)
    lines = [
        f"usage: proprio_{node} [--help] [--version] [--ros-args -p PARAMETER:=VALUE .. --params-file FILE -r __ns:=/NAME]",
        "",
        *textwrap.wrap(interface.about, width),
        "",
        "Parameters, with defaults; those with * may be changed while the node runs:",
    ]
    for parameter in (AUTOSTART, *NODES[node]):
        lines += _about_parameter(parameter, width)
    for title, names in (
        ("It publishes", interface.publishes),
        ("It takes", interface.takes),
        ("Services (`proprio call NAME`, or `ros2 service call`)", interface.services),
    ):
        if names:
            lines += ["", f"{title}:", *_about_names(names, width)]
    return "\n".join(lines)


def _about_parameter(parameter: Parameter, width: int) -> list[str]:
    default = parameter.default
    shown = {True: "true", False: "false"}.get(default) if isinstance(default, bool) else default
    limits = "" if shown in ("", []) else f" = {shown}"
    if parameter.lowest is not None and parameter.highest is not None:
        limits += f" ({parameter.lowest:g} .. {parameter.highest:g})"
    if parameter.choices:
        others = [choice for choice in parameter.choices if choice != default]
        limits += f" (or {', '.join(others)})"
    head = f"  {parameter.name}{' *' * parameter.dynamic}{limits}"
    return [head, *_indented(parameter.description, width)]


def _about_names(names: Sequence[str], width: int) -> Iterator[str]:
    for name in names:
        # the first clause; the documentation has the others
        words = about(name).partition(";")[0]
        yield from textwrap.wrap(
            f"{name}  {words}".rstrip(),
            width,
            initial_indent="  ",
            subsequent_indent="      ",
            break_long_words=False,
            break_on_hyphens=False,
        )


def _indented(text: str, width: int) -> list[str]:
    return textwrap.wrap(
        text,
        width,
        initial_indent="      ",
        subsequent_indent="      ",
        break_long_words=False,
        break_on_hyphens=False,
    )


if __name__ == "__main__":
    raise SystemExit(_run(sys.argv[1], sys.argv[2:]))
