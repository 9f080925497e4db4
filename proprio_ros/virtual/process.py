"""The virtual robot in a process of its own: servos answer, whatever the process beside them is busy with.

In the node's own process they did not: while a message is published, Python's lock is held, on a busy computer for 0.3 s, and a
driver that hears nothing for so long rightly takes the bus for lost. Real servos share nothing with a computer's other programs.
"""

from __future__ import annotations

import contextlib
import gc
import pickle
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

from proprio_ros.errors import ConfigurationError
from proprio_ros.realtime import run_in_real_time
from proprio_ros.robot import Robot
from proprio_ros.virtual.objects import HandObject
from proprio_ros.virtual.robot import VirtualRobot
from proprio_ros.virtual.truth import Truth

END_S = 5.0


class VirtualRobotProcess:
    """A `VirtualRobot` that another process runs; it ends when this one does.

    Args:
        robot, truth, link, seed: As for `VirtualRobot`.

    Raises:
        ConfigurationError, RobotError: As for `VirtualRobot`.
    """

    def __init__(self, robot: Robot, truth: Truth, *, link: Path, seed: int = 0) -> None:
        self._lock = threading.Lock()
        self._process = subprocess.Popen(
            [sys.executable, "-m", "proprio_ros.virtual.process"], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        self._ask((robot, truth, link, seed))

    def truth(self) -> tuple[dict[str, float], dict[str, float]]:
        """As `VirtualRobot.truth`."""
        position, current = self._ask(("truth",))
        return position, current

    def hold(self, thing: HandObject | None) -> None:
        """As `VirtualRobot.hold`."""
        self._ask(("hold", thing))

    def set_fault(self, text: str) -> None:
        """As `VirtualRobot.set_fault`."""
        self._ask(("set_fault", text))

    def close(self) -> None:
        """End the process; the port goes with it."""
        with self._lock:
            for pipe in (self._process.stdin, self._process.stdout):
                if pipe is not None:
                    with contextlib.suppress(OSError):
                        pipe.close()
            try:
                self._process.wait(END_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()

    def _ask(self, question: tuple[Any, ...]) -> Any:
        with self._lock:
            assert self._process.stdin is not None and self._process.stdout is not None
            try:
                pickle.dump(question, self._process.stdin)
                self._process.stdin.flush()
                answer = pickle.load(self._process.stdout)
            except (OSError, EOFError, ValueError) as error:
                raise ConfigurationError(f"the virtual robot's process has ended ({error})") from error
        if isinstance(answer, Exception):
            raise answer
        return answer


def main() -> None:
    """Answer the process that started this one, over the standard streams, until it closes them."""
    for number in (signal.SIGINT, signal.SIGTERM):  # whoever ends its owner ends this, too, in order
        signal.signal(number, signal.SIG_IGN)
    questions, answers = sys.stdin.buffer, sys.stdout.buffer
    sys.stdout = sys.stderr  # a library that prints must not break an answer
    robot: VirtualRobot | None = None
    with contextlib.suppress(EOFError, OSError):
        while True:
            question = pickle.load(questions)
            answer: Any = None
            try:
                if robot is None:
                    model, truth, link, seed = question
                    robot = VirtualRobot(model, truth, link=link, seed=seed)
                    gc.collect()
                    gc.freeze()  # a full collection takes longer than a servo's answer
                    run_in_real_time()  # servos do not wait for other programs either
                else:
                    name, *arguments = question
                    answer = getattr(robot, name)(*arguments)
            except Exception as error:
                answer = error
            pickle.dump(answer, answers)
            answers.flush()
    if robot is not None:
        robot.close()


if __name__ == "__main__":
    main()
