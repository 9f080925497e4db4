"""Programs that never wait, for a computer that is as busy as others' are."""

from __future__ import annotations

import subprocess
import sys


class BusyPrograms:
    """As many as were begun and not ended; all of them end with it.

    Args:
        count: How many begin at once.
    """

    def __init__(self, count: int = 0) -> None:
        self._count = count
        self._programs: list[subprocess.Popen[bytes]] = []

    def __enter__(self) -> BusyPrograms:
        for _ in range(self._count):
            self.begin_one()
        return self

    def __exit__(self, *_: object) -> None:
        self.end_all()

    def __len__(self) -> int:
        return len(self._programs)

    def begin_one(self) -> None:
        """One more."""
        self._programs.append(subprocess.Popen([sys.executable, "-c", "while True: pass"]))

    def end_one(self) -> None:
        """One less; there must be one."""
        program = self._programs.pop()
        program.kill()
        program.wait()

    def end_all(self) -> None:
        """All that were begun."""
        while self._programs:
            self.end_one()
