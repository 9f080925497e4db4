"""Commands of ``proprio`` about recordings, each a process of its own; whoever cancels a job ends that."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from proprio_ros.addons.pendant.calls import Call

GOOD = "accepted"


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
