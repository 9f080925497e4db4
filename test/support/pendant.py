"""`proprio pendant` as a user types it, and a browser in front of it."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from support.domains import free_domain
from support.live import UP_S, Client, running
from support.tab import Browser, Tab, browser
from support.waiting import wait_for

MOVES = 0.02  # rad/s; slower is encoders
LONG_S = 600.0
"""What the arm does takes its time; who says nothing for so long hangs."""
PATIENT: dict[str, dict[str, Any]] = {
    "driver": {"reply_timeout": 0.1, "command_timeout": 0.5},
    "excitation": {"stale_after": 4.0},
}
"""Nobody here may take a late message for silence."""
ELBOW = "the elbow alone"
"""The shortest of the pushes that a task of the wizard offers."""
CLI = (sys.executable, "-m", "proprio_ros.cli")
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
def pendant(
    folder: Path,
    *words: str,
    program: Sequence[str] = (),
    **environment: str,
) -> Iterator[Shown]:
    """One that shows its pages, in a domain where nobody else is.

    Args:
        folder: For what it says.
        words: Options of the command.
        program: What is run; empty: this Python's `proprio`.
        environment: Of the process, beside that of the test.
    """
    said = folder / "pendant.txt"
    with said.open("wb") as stderr:
        process = subprocess.Popen(
            [*(program or CLI), "pendant", "--port", "0", *words],
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


def ask(tab: Tab, title: str) -> None:
    """What is asked for a task, made anew: the form that stood there before may have the same title."""
    for each in ("Which arm", title):
        tab.click(each)
        tab.until(f"document.querySelector('[aria-label=Task] .title').innerText === '{each}'")


def answered(tab: Tab, title: str, pushes: str = "") -> str:
    """A task of the wizard by clicks, until it is answered.

    Args:
        tab: Any page of the pendant.
        title: Of the task.
        pushes: Which are chosen; empty: those that the form has.

    Returns:
        What the page shows as the answer, in one line.
    """
    tab.click("Wizard")
    ask(tab, title)
    if pushes:
        tab.choose("Pushes", pushes)
    tab.click("Start")
    tab.click("Begin")
    titles = "[...document.querySelectorAll('.progress .title')]"
    tab.until(f"{titles}.some((it) => it.innerText.startsWith('{title}:'))")
    answer = "document.querySelector('.progress .hand')?.innerText"
    assert wait_for(lambda: tab.does(answer), LONG_S), tab.text
    return " ".join(str(tab.does(answer)).split())


class Desk:
    """A pendant with its virtual arm, a browser, and somebody else who listens to the arm."""

    def __init__(self, shown: Shown, window: Browser, client: Client) -> None:
        self.shown = shown
        self.window = window
        self.client = client

    def wizard(self, title: str) -> Tab:
        """A tab with what is asked for a task."""
        tab = self.window.tab()
        # not by the page of the arm, which draws in three dimensions on a processor here
        tab.open(self.shown.address.replace("/?", "/wizard?"))
        ask(tab, title)
        return tab

    def begin(self, tab: Tab) -> None:
        """Confirm, and wait until the arm is pushed."""
        tab.click("Start")
        tab.shows("Keep away from it")
        tab.click("Begin")
        assert wait_for(lambda: self.client.excitation.get("phase") == "probe", LONG_S)

    def is_held(self) -> bool:
        """Whether nothing is under way, and the arm stands under torque."""
        states = self.client.states
        states.clear()
        assert wait_for(lambda: len(states) > 2)
        still = max(map(abs, states[-1].velocity)) < MOVES
        idle = self.client.excitation["busy"] == "false"
        held = all(status.message == "held" for status in self.client.diagnostics[-1].status)
        return still and idle and held


@contextmanager
def at_the_arm(
    folder: Path,
    virtual: Mapping[str, Any] | None = None,
    **identifier: Any,
) -> Iterator[Desk]:
    """A pendant with a virtual arm and a browser; parameters of that arm, and of the identifier."""
    domain = free_domain()
    # it stands for hardware, which waits for no browser that draws on a processor
    hardware = {"real_time": True, **(virtual or {})}
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", domain)
        with (
            running(folder, virtual=hardware, identifier=identifier, **PATIENT) as (
                _,
                arm,
            ),
            pendant(folder, ROS_DOMAIN_ID=domain) as shown,
            browser(folder) as window,
        ):
            yield Desk(shown, window, arm)
