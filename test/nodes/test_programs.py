"""The programs of the nodes say what they are without ROS, at once; and all that they name is what the nodes make."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import generate
import pytest

from proprio_ros.cli.parser import make_parser
from proprio_ros.errors import ConfigurationError
from proprio_ros.nodes.interface import about, interface_of, services
from proprio_ros.nodes.programs import check_words, help_of
from proprio_ros.nodes.tables import NODES

HEAVY = {"rclpy", "warp", "scipy", "mujoco", "rosbags", "matplotlib"}
AT_MOST_S = 1.0
"""Of a processor: an idle computer shows the help after so long, whatever else runs on this one."""
PROGRAM = """
import json, sys
from proprio_ros.nodes import programs
code = programs.{node}()
print(json.dumps([code, sorted(module.partition(".")[0] for module in sys.modules)]))
"""
COMMANDS = """
import contextlib, io, json, sys
from proprio_ros.cli import main
for words in json.loads(sys.argv[1]):
    said = io.StringIO()
    with contextlib.suppress(SystemExit), contextlib.redirect_stdout(said):
        main([*words, "--help"])
    assert said.getvalue().startswith("usage: proprio"), words
print(json.dumps(sorted(module.partition(".")[0] for module in sys.modules)))
"""


def ran(*words: str) -> tuple[str, float]:
    """What a fresh process of Python prints, and the time that a processor had it [s]."""
    before = os.times()
    done = subprocess.run(
        [sys.executable, *words],
        capture_output=True,
        text=True,
        check=True,
    )
    after = os.times()
    took_s = after.children_user - before.children_user
    took_s += after.children_system - before.children_system
    return done.stdout, took_s


def all_commands() -> Iterator[list[str]]:
    """Words of every command of `proprio`, those within another one too."""
    waiting = [([], make_parser())]
    while waiting:
        words, parser = waiting.pop()
        yield words
        for action in parser._actions:
            if isinstance(action.choices, dict):
                for name, inner in action.choices.items():
                    waiting.append(([*words, name], inner))


@pytest.mark.parametrize("node", NODES)
def test_a_program_says_what_it_is_and_ends(node: str) -> None:
    said, took_s = ran("-c", PROGRAM.format(node=node), "--help")
    *shown, modules = said.splitlines()
    assert shown[0].startswith(f"usage: proprio_{node} ")
    code, loaded = json.loads(modules)
    assert code == 0
    assert not HEAVY & set(loaded)
    assert took_s < AT_MOST_S


def test_every_command_explains_itself_without_heavy_libraries() -> None:
    commands = list(all_commands())
    assert ["robot", "new"] in commands
    said, _ = ran("-c", COMMANDS, json.dumps(commands))
    assert not HEAVY & set(json.loads(said))
    said, took_s = ran("-m", "proprio_ros.cli", "--help")
    assert said.startswith("usage: proprio ")
    assert took_s < AT_MOST_S


@pytest.mark.parametrize("node", NODES)
def test_help_has_every_parameter_with_its_unit_and_every_service(node: str) -> None:
    said = help_of(node)
    joined = " ".join(said.split())
    for parameter in NODES[node]:
        assert f"\n  {parameter.name}" in said
        assert " ".join(parameter.description.split()) in joined
    for name in interface_of(node).services:
        assert f"  {name}  " in said, "with a line"
    if node == "driver":
        assert "\n  rate = 100.0 (1 .. 1000)\n" in said
        assert "\n  on_timeout = hold (or zero)\n" in said
        assert "\n  joints\n" in said, "an empty list is no default to copy"


@pytest.mark.parametrize("node", NODES)
def test_what_help_names_is_what_the_node_makes(node: str) -> None:
    module, kind = generate.nodes()[node]
    made: dict[str, set[str]] = {}
    for connection in generate.connections_of(node, module, kind):
        made.setdefault(connection.way, set()).add(connection.name)
    stated = interface_of(node)
    assert set(stated.publishes) == made["publishes"]
    assert set(stated.takes) == made["takes"]
    assert set(stated.services) == made.get("serves", set())


def test_a_service_is_known_by_its_own_name_alone() -> None:
    nodes = {node: interface_of(node).services for node in NODES}
    assert len(services()) == sum(map(len, nodes.values()))
    assert services()["calibrate_payload"] == "identifier"
    assert all(about(f"/{node}/{name}") for name, node in services().items())


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["port:=/dev/ttyUSB0"], "port:=/dev/ttyUSB0: unknown argument; write proprio_driver --ros-args -p"),
        (["--port", "x"], "--port: unknown argument"),
        (["--ros-args", "-p", "prot:=x"], "-p prot: the driver node has no such parameter; is port meant?"),
        (["--ros-args", "-p", "port"], "-p port: write -p NAME:=VALUE"),
        (["--ros-args", "-p"], "-p nothing: write -p NAME:=VALUE"),
        (["--ros-args", "-p", "port:=x", "--", "more"], "more: unknown argument"),
    ],
)  # fmt: skip
def test_a_word_that_nobody_obeys_is_one_line(words: list[str], reason: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        check_words("driver", words)
    assert str(caught.value).startswith(reason)
    assert "\n" not in str(caught.value)


def test_words_of_ros_are_left_to_it() -> None:
    check_words("driver", ["--ros-args", "-r", "__ns:=/arm1", "--params-file", "mine.yaml"])
    check_words("driver", ["--ros-args", "-p", "use_sim_time:=true", "-p", "other:rate:=3.0", "--"])
    check_words("identifier", ["--ros-args", "--param", "running:=true", "--log-level", "debug"])


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["nonsense"], "proprio_driver: nonsense: unknown argument"),
        (["--ros-args", "--nonsense"], "not started: unknown words after --ros-args: ['--nonsense']"),
        (["--ros-args", "--params-file", "/nowhere/mine.yaml"], "not started: Couldn't parse params file"),
    ],
)  # fmt: skip
def test_a_program_that_cannot_start_says_so_in_a_line(
    words: list[str], reason: str, tmp_path: Path
) -> None:
    pytest.importorskip("rclpy")
    command = [sys.executable, "-m", "proprio_ros.nodes.programs", "driver", *words]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 2
    own = [line for line in done.stderr.splitlines() if "[rcl]" not in line]
    assert len(own) == 1, done.stderr
    assert own[0].startswith(reason)


def test_security_that_the_middleware_lacks_is_one_line(tmp_path: Path) -> None:
    """The wheels' Fast DDS is built without it; that of ROS from apt has it, and then lacks the keys."""
    pytest.importorskip("rclpy")
    keys = tmp_path / "keys"
    (keys / "enclaves").mkdir(parents=True)
    secure = {
        "ROS_SECURITY_KEYSTORE": str(keys),
        "ROS_SECURITY_ENABLE": "true",
        "ROS_SECURITY_STRATEGY": "Enforce",
    }
    command = [sys.executable, "-m", "proprio_ros.nodes.programs", "driver"]
    done = subprocess.run(
        command, capture_output=True, text=True, cwd=tmp_path, env={**os.environ, **secure}
    )
    assert done.returncode == 2
    own = [line for line in done.stderr.splitlines() if "[rcl]" not in line]
    assert len(own) == 1, done.stderr
    assert own[0].startswith("not started: ")
    if "security libraries" in own[0] or "built without security" in own[0]:
        assert own[0].endswith("use ROS 2 from apt, or unset it")


def test_a_unit_is_known_however_it_is_written() -> None:
    units = [
        parameter
        for parameters in NODES.values()
        for parameter in parameters
        if parameter.name == "effort_unit"
    ]
    assert len(units) == 3
    for parameter in units:
        assert parameter.as_known("Nm") == "N.m"
        parameter.check(parameter.as_known("amps"))
        with pytest.raises(ConfigurationError):
            parameter.check(parameter.as_known("lbf"))
        assert parameter.as_known("") == ""


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_a_program_that_is_ended_while_it_loads_ends_without_a_word(name: str) -> None:
    code = (
        "import os, signal, sys\n"
        "from proprio_ros.nodes import programs\n"
        "signal.signal(signal.SIGINT, signal.SIG_IGN)  # as a shell starts what it does not wait for\n"
        f"programs.loaded = lambda module: os.kill(os.getpid(), signal.{name})\n"
        "sys.exit(programs.driver())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stderr == done.stdout == ""
