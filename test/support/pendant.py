"""`proprio pendant` as a user types it, and a browser in front of it."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from support.domains import free_domain
from support.live import UP_S
from support.waiting import wait_for

_OPEN = re.compile(r"open (http\S+)")


@dataclass
class Shown:
    """A pendant that runs."""

    process: subprocess.Popen[bytes]
    said: Path
    address: str  # with its token

    @property
    def told(self) -> str:
        return self.said.read_text()

    @property
    def token(self) -> str:
        return self.address.rpartition("=")[2]

    @property
    def base(self) -> str:
        """Without a slash at its end."""
        return self.address.partition("/?")[0]

    @property
    def cookie(self) -> str:
        return f"proprio_pendant={self.token}"

    def page(self, path: str, headers: Mapping[str, str] | None = None) -> tuple[int, str]:
        """Status and text of a page, with the cookie where no headers are given."""
        with_cookie = {"Cookie": self.cookie} if headers is None else headers
        asked = urllib.request.Request(self.base + path, headers=dict(with_cookie))
        try:
            with urllib.request.urlopen(asked) as answer:
                return answer.status, answer.read().decode()
        except urllib.error.HTTPError as error:
            return error.code, error.read().decode()

    def end(self) -> int:
        """Ctrl-C; the exit code."""
        self.process.send_signal(signal.SIGINT)
        return self.process.wait()


@contextmanager
def pendant(folder: Path, *words: str, **environment: str) -> Iterator[Shown]:
    """One that shows its pages, in a domain where nobody else is."""
    said = folder / "pendant.txt"
    with said.open("wb") as stderr:
        process = subprocess.Popen(
            [sys.executable, "-m", "proprio_ros.cli", "pendant", "--port", "0", *words],
            stdin=subprocess.DEVNULL,
            stdout=stderr,
            stderr=stderr,
            env={**os.environ, "ROS_DOMAIN_ID": free_domain(), **environment},
        )
    try:
        assert wait_for(lambda: _OPEN.search(said.read_text()) or process.poll() is not None, UP_S)
        found = _OPEN.search(said.read_text())
        assert found, said.read_text()
        yield Shown(process, said, found[1])
    finally:
        if process.poll() is None:
            process.terminate()
            process.wait()
