"""What the pendant costs: from nothing to a weighed 50 g by clicks, idle beside joint states at 100 Hz, and after long use.

    python test/benchmarks/pendant.py [--no-install] [--no-first] [--idle 60] [--hours 12]

Real processes: a virtual environment of its own, `proprio pendant --virtual`, and Chromium in front of it. Long use is what twelve
hours bring, without the waiting between: a page is opened and closed every five minutes, a service called every half hour.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from idle import cpu_s
from results import REPOSITORY, Results, parser_of
from support.domains import free_domain
from support.pendant import Shown, pendant
from support.tab import Browser, Tab, browser
from support.waiting import wait_for

LONG_S = 900.0
"""A busy computer is slow; who says nothing for so long hangs."""
PAGES = ("/", "/wizard", "/recordings", "/history")
OPENED_EACH_H = 12
CALLED_EACH_H = 2
SETTLES_S = 10.0
FORGETS_S = 15.0
"""So long a page may be silent before it is forgotten."""
MOVES = re.compile(r'\\?"move\\?"')
REST_S = 0.5
ONE_FRAME_S = 0.02
"""What a page is told within so long is one picture, and whoever is told nothing for longer stands still."""
PROGRAM = """
import asyncio, signal, sys, threading
from nicegui import Client, core
from proprio_ros.cli import run

def count(*_):
    with open(told, "a") as file:
        print(len(asyncio.all_tasks(core.loop)), len(Client.instances), threading.active_count(), file=file)

told = sys.argv[1]
signal.signal(signal.SIGUSR1, count)
sys.argv[1:2] = []
run()
"""
"""The pendant, which says at a signal how many tasks, clients and threads it has."""


def memory_mb(process: int) -> float:
    """What a process has for itself, and its share of what it has with others."""
    lines = Path(f"/proc/{process}/smaps_rollup").read_text().splitlines()
    (pss,) = [line for line in lines if line.startswith("Pss:")]
    return float(pss.split()[1]) / 1024.0


def opened(process: int) -> int:
    """Files, pipes and sockets of a process."""
    return len(os.listdir(f"/proc/{process}/fd"))


def does(tab: Tab, title: str) -> str:
    """A task of the wizard by clicks, until it is answered; what the page shows."""
    tab.click("Wizard")
    tab.click(title)
    tab.click("Start")
    tab.click("Begin")
    shown = "document.querySelector('.progress .hand')?.innerText"
    tab.until(
        f"[...document.querySelectorAll('.progress .title')].some((it) => it.innerText.startsWith('{title}:'))"
    )
    assert wait_for(lambda: tab.does(shown), LONG_S), tab.text
    return " ".join(str(tab.does(shown)).split())


def installed(folder: Path) -> tuple[Path, float]:
    """Python of a new environment with README's line, and how long that takes [s]."""
    began_s = time.monotonic()
    subprocess.run([sys.executable, "-m", "venv", folder / "venv"], check=True)
    python = folder / "venv" / "bin" / "python"
    command = [python, "-m", "pip", "install", "-q", "--no-cache-dir", "-e", ".[ros,sim,pendant]"]
    subprocess.run(command, cwd=REPOSITORY, check=True)
    return python, time.monotonic() - began_s


def first_weighing(results: Results, window: Browser, folder: Path, install: bool) -> None:
    """From nothing to a weighed 50 g, without a calibration and with one."""
    python, install_s = installed(folder) if install else (Path(sys.executable), 0.0)
    # whatever was compiled before is not there
    around = {"HOME": str(folder), "WARP_CACHE_PATH": str(folder / "kernels")}
    began_s = time.monotonic()
    program = (str(python), "-m", "proprio_ros.cli")
    with pendant(folder, "--virtual", program=program, **around) as shown:
        tab = window.tab()
        tab.open(shown.address.replace("/?", "/wizard?"))
        assert wait_for(lambda: "[identifier]: ready" in shown.told, LONG_S), shown.told
        for what in (
            "installed and ready",
            "Weigh an object",
            "Calibrate the arm",
            "Weigh an object",
        ):
            answer = does(tab, what) if what in tab.text else ""
            since_s = install_s + time.monotonic() - began_s
            results.row("first", what=what, since_s=since_s, answer=answer[:70], load=load())
        tab.close()


def load() -> float:
    """What else the computer has to do."""
    return os.getloadavg()[0]


class Watched(Tab):
    """A tab that remembers when it was told to move something [s]."""

    def __init__(self, address: str) -> None:
        self.moved_s: list[float] = []
        super().__init__(address)

    def _hear(self, message: dict[str, Any]) -> None:
        super()._hear(message)
        if message.get("method") == "Network.webSocketFrameReceived":
            if MOVES.search(message["params"]["response"]["payloadData"]):
                self.moved_s.append(float(message["params"]["timestamp"]))

    def frames_per_s(self) -> float:
        """While something moves."""
        gaps_s = np.diff([at for n, at in enumerate(self.moved_s) if self._is_new(n)])
        moving_s = gaps_s[gaps_s < REST_S]
        return float(1.0 / np.median(moving_s)) if len(moving_s) else float("nan")

    def _is_new(self, n: int) -> bool:
        return n == 0 or self.moved_s[n] - self.moved_s[n - 1] > ONE_FRAME_S


def idle(results: Results, shown: Shown, window: Browser, seconds: float) -> None:
    """What it takes beside joint states at 100 Hz: alone, with a page open, and while the arm moves."""
    process = shown.process.pid
    tab = window.tab(Watched)
    for what in ("no page", "the arm's page, at rest", "the arm's page, weighing"):
        if what != "no page":
            tab.open(shown.address)
            tab.until("!!document.querySelector('.scene canvas')")
        time.sleep(SETTLES_S)
        before_s = cpu_s(process)
        began_s = time.monotonic()
        if "weighing" in what:
            other = window.tab()
            other.open(shown.address.replace("/?", "/wizard?"))
            does(other, "Weigh an object")
            other.click("Give up")
            other.close()
            tab.does("true")
        else:
            time.sleep(seconds)
        core = (cpu_s(process) - before_s) / (time.monotonic() - began_s)
        moving = "weighing" in what
        fps = tab.frames_per_s() if moving else None
        results.row("idle", what=what, core=core, mb=memory_mb(process), fps=fps, load=load())
    tab.close()


def counted(shown: Shown, told: Path) -> list[int]:
    """Tasks, clients and threads."""
    before = told.read_text().count("\n") if told.exists() else 0
    shown.process.send_signal(signal.SIGUSR1)
    assert wait_for(lambda: told.exists() and told.read_text().count("\n") > before, LONG_S)
    return [int(word) for word in told.read_text().splitlines()[-1].split()]


def used(results: Results, shown: Shown, window: Browser, told: Path, hours: float) -> None:
    """Pages that open and close, and services that are called, as often as in so many hours."""
    opened_pages = called = 0

    def row(what: str) -> None:
        time.sleep(FORGETS_S)
        tasks, clients, threads = counted(shown, told)
        process = shown.process.pid
        results.row(
            "use",
            what=what,
            pages=opened_pages,
            calls=called,
            mb=memory_mb(process),
            files=opened(process),
            tasks=tasks,
            clients=clients,
            threads=threads,
        )

    for hour in range(-1, round(hours)):
        for number in range(OPENED_EACH_H):
            tab = window.tab()
            tab.open(shown.address.replace("/?", f"{PAGES[number % len(PAGES)]}?"))
            opened_pages += 1
            if number % (OPENED_EACH_H // CALLED_EACH_H) == 1:
                does(tab, "Weigh the last seconds")
                tab.click("Give up")
                called += 1
            tab.close()
        # what is loaded once is no leak
        row("before" if hour < 0 else f"after {hour + 1} h of use")


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--no-install", action="store_true", help="begin with what is installed")
    parser.add_argument("--no-first", action="store_true", help="leave out the first weighing")
    parser.add_argument("--idle", type=float, default=60.0, help="so long each is watched [s]")
    parser.add_argument("--hours", type=float, default=12.0, help="of use")
    given = parser.parse_args()
    os.environ["ROS_DOMAIN_ID"] = free_domain()
    results = Results(__file__, given.json)
    since = {
        "": "{what}",
        "since the first command": "{since_s:.0f} s",
        "the page shows": "{answer}",
    }
    results.table("first", {**since, "load": "{load:.0f}"})
    figures = {"": "{what}", "of a core": "{core:.1%}", "memory": "{mb:.0f} MB"}
    results.table("idle", {**figures, "frames per second": "{fps:.0f}", "load": "{load:.0f}"})
    counts = {"pages opened": "{pages}", "services called": "{calls}", "memory": "{mb:.0f} MB"}
    more = {"files": "{files}", "tasks": "{tasks}", "clients": "{clients}", "threads": "{threads}"}
    results.table("use", {"": "{what}", **counts, **more})
    with tempfile.TemporaryDirectory() as place, browser(Path(place)) as window:
        folder = Path(place)
        if not given.no_first:
            first_weighing(results, window, folder, not given.no_install)
        told = folder / "counts.txt"
        around = {"HOME": place}
        program = (sys.executable, "-c", PROGRAM, str(told))
        with pendant(folder, "--virtual", program=program, **around) as shown:
            assert wait_for(lambda: "[identifier]: ready" in shown.told, LONG_S), shown.told
            idle(results, shown, window, given.idle)
            used(results, shown, window, told, given.hours)
    results.keep()


if __name__ == "__main__":
    main()
