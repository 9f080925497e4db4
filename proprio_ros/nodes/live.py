"""`proprio live`: what `ros2 launch proprio_ros calibration.launch.py` starts, where there is no `ros2`.

This process needs no ROS itself. What the nodes say goes into files, which are shown as they grow: a terminal that stands still
must not keep a driver from its bus.
"""

from __future__ import annotations

import importlib.util
import os
import queue
import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path

from proprio_ros.errors import ConfigurationError
from proprio_ros.nodes.arguments import Stated
from proprio_ros.nodes.domains import free_domain, heard_in
from proprio_ros.nodes.graph import Graph
from proprio_ros.nodes.programs import missing
from proprio_ros.nodes.starting import ends_all, services_for, starts

LOOK_S = 0.1
UNREAD_S = 2.0
"""Somebody who has read nothing for so long when the nodes have ended reads no more."""
DIED = 2
"""The exit code where a node died, as `proprio` has it, if nobody reads why."""
ENDS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Ctrl-C, what systemd and docker say, and a terminal that is closed."""


def live(
    stated: Stated,
    tell: Callable[[str], None],
    show: Callable[[str], None],
) -> None:
    """Start the nodes, and end them all when it is asked for (SIGINT, SIGTERM, SIGHUP) or the driver or virtual robot has died.

    Args:
        stated: The arguments.
        tell: Called with what goes on here, a sentence at a time.
        show: Called with each line that a node prints.

    Raises:
        ProprioError: An argument is not understood, or a node died; with its own words.
    """
    found = starts(stated)
    for module in ["rclpy", *(["mujoco"] if stated.virtual else [])]:
        if importlib.util.find_spec(module) is None:
            raise missing(module)
    if stated.virtual:
        _refuse_a_mixture([start.node for start in found], stated.namespace)
    asked: list[int] = []
    for number in ENDS:
        if signal.getsignal(number) == signal.SIG_IGN:
            continue  # as nohup has it: the arm is not to drop when a terminal is closed
        # obeyed below; a second one changes nothing: the nodes end in order
        signal.signal(number, lambda number, _: asked.append(number))
    voice = Voice()
    tell = voice.of(tell)
    with Graph(_log_folder()) as graph:
        shown = _Shown(graph.logs, voice.of(show))
        for start in found:
            graph.start(start.node, start.parameters, stated.namespace, start.files)
        tell(f"{', '.join(graph.processes)} are starting, Ctrl-C ends them; logs: {graph.logs}")
        tell(f"when the identifier is ready: {_calls(stated)}")
        died = _watch(graph, shown, asked, voice, tell)
        tell(f"{', '.join(graph.processes)} are ending")
        graph.stop()
        shown.more()
    if not died:
        tell("all nodes have ended")
    if not voice.has_finished(UNREAD_S):
        # whoever writes now, as the interpreter does when it ends, waits for a reader that there is not
        os._exit(DIED if died else 0)
    if died:
        raise ConfigurationError(died)


class Voice:
    """Says lines in a thread of its own: nodes are to end when they are asked to, whether or not anybody reads what is said."""

    def __init__(self) -> None:
        self._waiting: queue.SimpleQueue[tuple[Callable[[str], None], str] | None] = (
            queue.SimpleQueue()
        )
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._speak, daemon=True)
        self._thread.start()

    def of(self, say: Callable[[str], None]) -> Callable[[str], None]:
        """What hands each line on to be said, and returns at once."""
        return lambda line: self._waiting.put((say, line))

    def check(self) -> None:
        """Raises whatever was raised where something was said, as of a pipe that was closed."""
        if self._error is not None:
            raise self._error

    def has_finished(self, within_s: float) -> bool:
        """Whether all has been said, after that time at most; nothing more is said then."""
        self._waiting.put(None)
        self._thread.join(within_s)
        return not self._thread.is_alive()

    def _speak(self) -> None:
        while self._error is None:
            waiting = self._waiting.get()
            if waiting is None:
                return
            say, line = waiting
            try:
                say(line)
            except Exception as error:
                self._error = error


def _refuse_a_mixture(nodes: list[str], namespace: str) -> None:
    """A virtual arm beside nodes of the same names: calls would reach either arm.

    Raises:
        ConfigurationError: They are heard in this domain.
    """
    domain = os.environ.get("ROS_DOMAIN_ID") or "0"
    space = f"/{namespace}" if namespace else ""
    ours = {f"{space}/{node}" for node in nodes}
    there = sorted(ours.intersection(heard_in(domain)))
    if there:
        advice = f"end them, or state ROS_DOMAIN_ID={free_domain()} or --namespace"
        raise ConfigurationError(f"{', '.join(there)} run in ROS domain {domain} already: {advice}")


def _watch(
    graph: Graph,
    shown: _Shown,
    asked: list[int],
    voice: Voice,
    tell: Callable[[str], None],
) -> str:
    """Show what the nodes say until they are to end; why, where it was not asked for.

    Args:
        graph: The nodes.
        shown: What they have said.
        asked: Signals that came.
        voice: That says it.
        tell: Called with what goes on here, a sentence at a time.
    """
    while not asked:
        shown.more()
        voice.check()
        for node, words in list(graph.ended()):
            if ends_all(node):
                return words
            graph.stop(node)
            tell(f"{words}; {', '.join(graph.processes)} go on, and Ctrl-C ends them")
        time.sleep(LOOK_S)
    return ""


class _Shown:
    """What has been shown of files that grow.

    Args:
        folder: Of the logs.
        show: Called with each whole line.
    """

    def __init__(self, folder: Path, show: Callable[[str], None]) -> None:
        self._folder = folder
        self._show = show
        self._read: dict[Path, int] = {}

    def more(self) -> None:
        """Show what has come since."""
        for log in sorted(self._folder.glob("*.log")):
            with log.open("rb") as file:
                file.seek(self._read.get(log, 0))
                whole, newline, _ = file.read().rpartition(b"\n")
            self._read[log] = self._read.get(log, 0) + len(whole) + len(newline)
            for line in whole.decode(errors="replace").splitlines():
                self._show(line)


def _calls(stated: Stated) -> str:
    """What to type next."""
    where = f"--namespace {stated.namespace} " if stated.namespace else ""
    return ", then ".join(f"proprio call {where}{name}" for name in services_for(stated.held))


def _log_folder() -> Path:
    """Where ROS keeps logs, one folder for each start."""
    home = Path(os.environ.get("ROS_HOME") or "~/.ros").expanduser()
    logs = Path(os.environ.get("ROS_LOG_DIR") or home / "log").expanduser()
    return logs / f"proprio_live_{time.strftime('%Y-%m-%d-%H-%M-%S')}_{os.getpid()}"
