"""``proprio call`` as a process: whoever ends it ends the job that it began, and the arm is held.

That holds for a pendant that is killed, too: its processes are told to end, and cancel what they began.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
import shlex
import signal
import sys
from asyncio.subprocess import DEVNULL, PIPE, Process
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from time import monotonic
from typing import Any, Generic, TypeVar

from proprio_ros.errors import ConfigurationError
from proprio_ros.nodes.graph import end_with_parent

GOOD = "accepted"
LONGEST_LINE = 2**20  # bytes
SHOWN = 200
"""So many of the latest sentences are kept."""
_RUN = re.compile(r"\brun (\d+) of (\d+)")


class Call:
    """One service, called by ``proprio call``.

    Attributes:
        service: Its name.
        words: The command, as one would type it.
        said: What has gone on so far, a sentence each.
        answer: What ``--json`` printed in the end; None: it is under way.
        cancelled: Whether somebody has asked for its end.
        seconds: How long it took; None: it is under way.
        then: What is done after it.
    """

    def __init__(self, service: str, settings: Sequence[str] = (), namespace: str = "") -> None:
        self.service = service
        words = ["call", service]
        for setting in settings:
            words += ["--set", setting]
        if namespace:
            words += ["--namespace", namespace]
        self.words = words
        self.said: list[str] = []
        self.answer: dict[str, Any] | None = None
        self.cancelled = False
        self.seconds: float | None = None
        self.then: Callable[[], Awaitable[object]] | None = None
        self._begun_s = monotonic()
        self._process: Process | None = None

    @property
    def command(self) -> str:
        """To copy."""
        return shlex.join(["proprio", *self.words])

    @property
    def program(self) -> list[str]:
        """What the process runs."""
        return [sys.executable, "-m", "proprio_ros.cli", *self.words, "--json"]

    @property
    def under_way(self) -> bool:
        """Whether its answer has not come yet."""
        return self.answer is None

    @property
    def elapsed_s(self) -> float:
        """How long it takes, or took."""
        return monotonic() - self._begun_s if self.seconds is None else self.seconds

    @property
    def progress(self) -> tuple[int, int] | None:
        """The run that is made, and how many there are; None: nobody says."""
        for sentence in reversed(self.said):
            found = _RUN.search(sentence)
            if found:
                return int(found[1]), int(found[2])
        return None

    async def run(self) -> None:
        """Until it is answered."""
        answer = None
        try:
            self._process = await asyncio.create_subprocess_exec(
                *self.program,
                stdin=DEVNULL,
                stdout=PIPE,
                stderr=PIPE,
                limit=LONGEST_LINE,
                start_new_session=True,
                preexec_fn=end_with_parent,
            )
            if self.cancelled:
                self._interrupt()
            printed, _ = await asyncio.gather(self._printed(), self._listen())
            answer = _answer(printed, self.said)
        finally:
            # before anybody sees that it is over, and begins the next
            if self.then is not None:
                await self.then()
            self.seconds = monotonic() - self._begun_s
            self.answer = answer or {"success": False, "message": "the call was given up"}

    def cancel(self) -> None:
        """End the job; the arm is held."""
        if not self.cancelled:
            self.cancelled = True
            self._interrupt()

    async def ended(self, seconds: float) -> None:
        """Wait until it has ended, so long at most."""
        if self._process is not None:
            with contextlib.suppress(TimeoutError, asyncio.TimeoutError):
                await asyncio.wait_for(self._process.wait(), seconds)

    def _interrupt(self) -> None:
        if self._process is not None and self._process.returncode is None:
            self._process.send_signal(signal.SIGINT)

    async def _printed(self) -> bytes:
        assert self._process is not None and self._process.stdout is not None
        return await self._process.stdout.read()

    async def _listen(self) -> None:
        assert self._process is not None and self._process.stderr is not None
        async for line in self._process.stderr:
            self.said.append(line.decode(errors="replace").strip().removeprefix("proprio: "))
            del self.said[:-SHOWN]


def _answer(printed: bytes, said: Sequence[str]) -> dict[str, Any]:
    """What a call printed; its last words where that is nothing."""
    try:
        found = json.loads(printed)
    except ValueError:
        found = {}
    message = found.get("message") or found.get("error") or (said[-1] if said else "no answer")
    return {**found, "success": bool(found.get("success")), "message": message}


@dataclass
class Step:
    """One command.

    Attributes:
        words: As one types them, without ``proprio``.
        report: The page that it writes.
        answer: What it printed; empty: nothing yet.
    """

    words: Sequence[str]
    report: Path | None = None
    answer: dict[str, Any] = field(default_factory=dict)

    @property
    def kind(self) -> str:
        """Name of the command."""
        return self.words[0]


class Job(Call):
    """Commands one after the other; what is refused ends it.

    Args:
        title: What is done, in words.
        steps: The commands.
        done: Called in the end.
        looks: JSON for `looking`, which checks instead of the command and draws, too.
    """

    def __init__(
        self,
        title: str,
        steps: Sequence[Step],
        done: Callable[[Job], None] = lambda _: None,
        looks: str = "",
    ) -> None:
        super().__init__(title)
        self.steps = steps
        self.words = list(steps[0].words)
        self._done = done
        self._looks = looks

    @property
    def command(self) -> str:
        """To copy."""
        return " && ".join(shlex.join(["proprio", *step.words]) for step in self.steps)

    @property
    def program(self) -> list[str]:
        """What the process runs."""
        if self._looks:
            return [sys.executable, "-m", "proprio_ros.addons.pendant.looking", self._looks]
        return super().program

    async def run(self) -> None:
        """Until the last has ended, or one was refused."""
        for step in self.steps:
            self.words = list(step.words)
            self.answer = None
            await super().run()
            step.answer = self.answer or {}
            if self.cancelled or step.answer.get("verdict", GOOD) != GOOD or "error" in step.answer:
                break
        self._done(self)


Kind = TypeVar("Kind", bound=Call)


class Calls(Generic[Kind]):
    """One call at a time, for all pages.

    Args:
        tell: Called with what is begun, as one would type it.
    """

    def __init__(self, tell: Callable[[str], None]) -> None:
        self._tell = tell
        self._task: asyncio.Task[None] | None = None
        self.latest: Kind | None = None

    @property
    def under_way(self) -> Kind | None:
        """The one that has not ended."""
        running = self._task is not None and not self._task.done()
        return self.latest if running else None

    def check_free(self) -> None:
        """Raises `ConfigurationError`: Something is under way."""
        if self.under_way is not None:
            raise ConfigurationError("something is computed already; wait for it, or cancel it")

    def begin(self, call: Kind) -> None:
        """Raises `ConfigurationError`: Another is under way."""
        self.check_free()
        self.latest = call
        self._tell(call.command)
        self._task = asyncio.create_task(call.run())

    async def close(self, seconds: float) -> None:
        """End what is under way, which may take so long."""
        call = self.under_way
        if call is not None:
            call.cancel()
            await call.ended(seconds)
