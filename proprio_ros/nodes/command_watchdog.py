"""Publishes in place of a node that was killed or stands still: an effort controller keeps for ever what it was told last.

A process of its own, since nothing runs in one after `kill -9`. The excitation node starts it and tells it again and again
what would hold the arm, as a line of numbers on its standard input; an empty line says that nothing is held. When the lines stay
away, or end before an empty one, the numbers are published in the node's place. A line that begins with `SWITCHED` says that
controllers were switched for it: when the lines end then, they are switched back.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import time
from array import array
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import rclpy
from rclpy.duration import Duration
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Float64MultiArray

from proprio_ros.clock import run_in_real_time
from proprio_ros.errors import ConfigurationError
from proprio_ros.nodes.qos import COMMANDS
from proprio_ros.nodes.switching import Controllers, switch_kind

TOLD_PERIOD_S = 0.05
SILENT_S = 0.25
"""A node that has told nothing for so long does not hold the arm any more. If it goes on later, its commands count again."""
NODE = "excitation_last_words"
FALLBACK_S = 0.3
AGAIN = 6
START_S = 60.0
FOUND_S = 4.0  # who uses DDS announces itself every 3 s, should the first words be lost
SWITCHED = "switched"
REAL_TIME = "real_time"
HEARD = b"+"
UNHEARD = b"-"
SWITCH_S = 5.0  # for so long whoever stands in for a node that is gone waits for controller_manager


class CommandWatchdog:
    """The other process, as the node sees it: told the controller's topic, and the controllers that are switched back.

    Args:
        topic: Where the controller listens.
        controllers: Those that are switched back; none where nobody switches.
        real_time: Whether it takes a real-time class.

    Attributes:
        engaged: Whether they were switched.

    Raises `ConfigurationError`: It does not start.
    """

    def __init__(
        self, topic: str, controllers: Controllers | None = None, real_time: bool = True
    ) -> None:
        self.engaged = False
        switched = "" if controllers is None else json.dumps(asdict(controllers))
        urgent = [REAL_TIME] if real_time else []
        command = [
            sys.executable,
            "-m",
            "proprio_ros.nodes.command_watchdog",
            topic,
            switched,
            *urgent,
        ]
        # a session of its own: Ctrl-C is for the node alone, which then ends in order
        self._process = subprocess.Popen(
            command, 0, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True
        )
        assert self._process.stdin is not None and self._process.stdout is not None
        ready, _, _ = select.select(
            [self._process.stdout],
            [],
            [],
            START_S,
        )
        answer = self._process.stdout.readline() if ready else b""
        if not answer:
            self._process.kill()
            words = "the process that holds the arm if this one is killed does not start: see its words above"
            raise ConfigurationError(words)
        os.set_blocking(self._process.stdin.fileno(), False)
        self._publisher = answer.decode().split()[1:]
        self._told_s = -1e9
        self._heard = False
        select.select(
            [self._process.stdout],
            [],
            [],
            FOUND_S,
        )

    @property
    def alive(self) -> bool:
        return self._process.poll() is None

    @property
    def heard(self) -> bool:
        """Whether it has found who listens on the topic, which the node itself may have before: until then nobody would hear it."""
        assert self._process.stdout is not None
        if select.select([self._process.stdout], [], [], 0.0)[0]:
            self._heard = os.read(self._process.stdout.fileno(), 4096).endswith(HEARD)
        return self._heard

    def is_publisher(self, info: Any) -> bool:
        """Whether a publisher on the topic is this process's, or that of one before it.

        The names of nodes are heard later than their publishers are, so it says itself which one is its own.
        """
        return bytes(info.endpoint_gid).hex() in self._publisher or info.node_name.startswith(NODE)

    @property
    def due(self) -> bool:
        """Whether it is to be told something again."""
        return time.monotonic() - self._told_s >= TOLD_PERIOD_S

    def update(self, efforts: Sequence[float]) -> None:
        """What to publish if nothing follows."""
        self._told_s = time.monotonic()
        self._write(" ".join(repr(float(effort)) for effort in efforts))

    def clear(self) -> None:
        """Nothing is held any more."""
        self._told_s = -1e9
        self._write("")

    def close(self) -> None:
        """It ends and publishes nothing, if it was cleared before."""
        assert self._process.stdin is not None
        with contextlib.suppress(OSError):
            self._process.stdin.close()

    def _write(self, line: str) -> None:
        assert self._process.stdin is not None
        line = f"{SWITCHED} {line}" if self.engaged else line
        # it has ended, which `alive` says, or a full pipe keeps it busy enough
        with contextlib.suppress(OSError):
            os.write(self._process.stdin.fileno(), f"{line}\n".encode())


class _FallbackPublisher:
    """In place of a node that is gone: what it sent last holds the arm, and controllers are switched back.

    Args:
        topic: Where the controller listens.
        switched: The controllers that are switched back, as JSON; empty: none.
    """

    def __init__(self, topic: str, switched: str) -> None:
        self.node = rclpy.create_node(f"{NODE}_{os.getpid()}")
        self._publisher = self.node.create_publisher(Float64MultiArray, topic, COMMANDS)
        self._controllers: Controllers | None = None
        if switched:
            self._controllers = Controllers(**json.loads(switched))
            self._kind = switch_kind()
            self._client = self.node.create_client(self._kind, self._controllers.service)
        self._heard = False
        self._last: list[float] = []
        self._engaged = False
        self._rest = b""

    def endpoints(self, topic: str) -> list[str]:
        """Its own publishers on the topic."""
        named = self.node.get_publishers_info_by_topic(topic)
        mine = [info for info in named if info.node_name == self.node.get_name()]
        return [bytes(info.endpoint_gid).hex() for info in mine]

    def listen(self) -> None:
        """Publish in place of the node whenever it is silent; returns when it has ended."""
        while True:
            self._report_listeners()
            ready, _, _ = select.select(
                [sys.stdin],
                [],
                [],
                SILENT_S,
            )
            if not ready:
                self._publish()
                continue
            read = os.read(sys.stdin.fileno(), 65536)
            if not read:
                return
            *lines, self._rest = (self._rest + read).split(b"\n")
            if lines:
                self._receive(lines[-1])
            else:
                self._publish()

    def _report_listeners(self) -> None:
        if (self._publisher.get_subscription_count() > 0) != self._heard:
            self._heard = not self._heard
            with contextlib.suppress(OSError):  # nobody is left to read it
                os.write(sys.stdout.fileno(), HEARD if self._heard else UNHEARD)

    def _receive(self, line: bytes) -> None:
        words = line.split()
        self._engaged = words[:1] == [SWITCHED.encode()]
        numbers = words[1:] if self._engaged else words
        self._last = [float(word) for word in numbers]

    def _publish(self) -> None:
        if self._last:
            self._publisher.publish(Float64MultiArray(data=array("d", self._last)))

    def end(self) -> None:
        """The node has ended: hold what it held, and hand the arm back."""
        # again, since what the node itself sent last may come after them
        for _ in range(AGAIN if self._last else 0):
            self._publish()
            self._publisher.wait_for_all_acked(Duration(seconds=FALLBACK_S / AGAIN))
            time.sleep(FALLBACK_S / AGAIN)  # on their way through sockets
        if self._engaged and self._controllers is not None:
            self._switch_back(self._controllers)
        self.node.destroy_node()

    def _switch_back(self, controllers: Controllers) -> None:
        if self._client.wait_for_service(SWITCH_S):
            future = self._client.call_async(controllers.request(self._kind, engage=False))
            rclpy.spin_until_future_complete(self.node, future, timeout_sec=SWITCH_S)


def main(topic: str, switched: str = "", urgent: str = "") -> int:
    """The other process.

    Args:
        topic: Where the controller listens.
        switched: The controllers that are switched back, as JSON; empty: none.
        urgent: `REAL_TIME`, where it takes a real-time class.

    Returns:
        Its exit code, when the node has ended.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # it ends with the node
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    fallback = _FallbackPublisher(topic, switched)
    sys.stdout.write(f"ready {' '.join(fallback.endpoints(topic))}\n")
    sys.stdout.flush()
    if urgent == REAL_TIME:
        run_in_real_time()
    fallback.listen()
    fallback.end()
    rclpy.shutdown()
    return 0


if __name__ == "__main__":
    raise SystemExit(main(*sys.argv[1:]))
