"""The nodes as processes of their own, started and ended together, without `launch` (which is not on the package index)."""

from __future__ import annotations

import ctypes
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from proprio_ros.errors import ConfigurationError
from proprio_ros.nodes.starting import RELEASE_S

_PR_SET_PDEATHSIG = 1


class Patience:
    """How long to wait for those who say how far they are: until they have been silent for some time, by a clock [s]."""

    def __init__(
        self,
        silence_s: float,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self._silence_s = silence_s
        self._now = now
        self._heard: object = None
        self._since_s = now()

    def is_over(self, heard: object) -> bool:
        """Whether nothing new was heard for too long; what was heard differs once there is something new."""
        if heard != self._heard:
            self._heard = heard
            self._since_s = self._now()
        return self._now() - self._since_s > self._silence_s


def end_with_parent() -> None:
    """In the child: Linux tells it to end when we are gone, even killed."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


class Graph:
    """Processes of nodes; what each prints goes into a folder of logs, and ``environment`` is added to this process's.

    Leaving the context ends them all: the driver last but for the virtual robot, so that what others still say is obeyed.
    """

    def __init__(
        self,
        logs: Path,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        self.logs = logs
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        # whatever lies in the present folder must not be imported (Python 3.11 and later)
        self._environment = {
            **os.environ,
            "PYTHONSAFEPATH": "1",
            **(environment or {}),
        }
        logs.mkdir(parents=True, exist_ok=True)

    def __enter__(self) -> Graph:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(
        self,
        node: str,
        parameters: Mapping[str, Any],
        namespace: str = "",
        files: Sequence[str] = (),
    ) -> subprocess.Popen[bytes]:
        """Start a node in a process and a session of its own, so that Ctrl-C reaches only us.

        Args:
            node: Its name, such as ``driver``.
            parameters: What is stated of its parameters; it counts over files.
            namespace: Of the node; empty: none.
            files: Parameter files; a later one counts over those before.

        Returns:
            The process.
        """
        words = [sys.executable, "-m", f"proprio_ros.nodes.{node}", "--ros-args"]
        for file in files:
            words += ["--params-file", file]
        for name, value in parameters.items():
            # texts in quotes: else a name that looks like a number is one, and words of a list are not one each
            words += ["-p", f"{name}:={json.dumps(value, ensure_ascii=False, default=str)}"]
        if namespace:
            words += ["-r", f"__ns:=/{namespace}"]
        with (self.logs / f"{node}.log").open("ab") as log:
            streams: dict[str, Any] = {
                "stdin": subprocess.DEVNULL,
                "stdout": log,
                "stderr": subprocess.STDOUT,
            }
            alone: dict[str, Any] = {"start_new_session": True, "preexec_fn": end_with_parent}
            process = self.processes[node] = subprocess.Popen(
                words, env=self._environment, **streams, **alone
            )
        return process

    def log(self, node: str) -> str:
        """What a node has printed so far."""
        return (self.logs / f"{node}.log").read_text(encoding="utf-8", errors="replace")

    def said(self) -> int:
        """How much all nodes have printed so far [bytes]: more of it is progress."""
        return sum(log.stat().st_size for log in self.logs.glob("*.log"))

    def ended(self) -> Iterator[tuple[str, str]]:
        """Nodes that have ended by themselves: name, and how in words, with the last line that it printed."""
        for node, process in self.processes.items():
            code = process.poll()
            if code is None:
                continue
            lines = self.log(node).strip().splitlines() or ["without a word"]
            how = f" (killed by {signal.Signals(-code).name})" if code < 0 else ""
            yield node, f"the {node} node has ended{how}: {lines[-1]}"

    def check(self) -> None:
        """Raises: ConfigurationError: a node has ended, with the last line it printed."""
        for _, words in self.ended():
            raise ConfigurationError(words)

    def stop(
        self,
        node: str | None = None,
        number: int = signal.SIGTERM,
    ) -> None:
        """End one node, or all; one that does not end in time is killed.

        SIGTERM ends even one that is still starting without a traceback.
        """
        for names in (
            [(node,)] if node else [("identifier", "excitation"), ("driver",), ("virtual",)]
        ):
            self._end([name for name in names if name in self.processes], number)

    def _end(self, nodes: list[str], number: int) -> None:
        for name in nodes:
            if self.processes[name].poll() is None:
                self.processes[name].send_signal(number)
        deadline = time.monotonic() + RELEASE_S
        for name in nodes:
            process = self.processes.pop(name)
            try:
                process.wait(max(deadline - time.monotonic(), 0.1))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
