"""What the pendant costs: from nothing to a weighed 50 g by clicks, idle beside joint states at 100 Hz, and after long use.

    python test/benchmarks/pendant.py [--parts first hostile idle heard use] [--no-install] [--idle 60] [--hours 12]

Real processes: a virtual environment of its own, `proprio pendant --virtual`, and Chromium in front of it. Long use is what twelve
hours bring, without the waiting between: as many joint states as in that time are taken, with all that nodes say beside them, while
the page of the arm is open and drawn; then a page is opened and closed every five minutes, a service called every half hour.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from idle import TICKS, cpu_s
from results import REPOSITORY, Results, parser_of
from support.domains import free_domain
from support.hostile import hostile, is_refused, status_of
from support.pendant import ELBOW, Shown, answered, pendant
from support.tab import Browser, Tab, browser
from support.waiting import wait_for

TESTS = Path(__file__).resolve().parents[1]
LONG_S = 900.0
"""A busy computer is slow; who says nothing for so long hangs."""
PARTS = ("first", "hostile", "idle", "heard", "use")
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
CLICKED = (
    ("Calibrate the arm", ELBOW),
    ("Weigh an object", ELBOW),
)
"""What the first weighing takes."""
HOUR_STATES = 3600 * 20
"""As the pendant takes the newest twenty times a second."""
ALL = "all"
QUARTER_H = 3
RARELY = "getElement(+document.querySelector('.scene').id.slice(1)).$.props.fps = 0.5"
"""The page that is watched all the time draws its scene so often [1/s], since a processor does that here."""
LONGEST_S = 3600.0
SPEED = 100.0
"""So many times shorter it waits where it hears what comes in hours."""
PROGRAM = (sys.executable, "-m", "support.counted_pendant")


def memory_mb(process: int) -> float:
    """What a process has for itself, and its share of what it has with others."""
    lines = Path(f"/proc/{process}/smaps_rollup").read_text().splitlines()
    (pss,) = [line for line in lines if line.startswith("Pss:")]
    return float(pss.split()[1]) / 1024.0


def opened(process: int) -> int:
    """Files, pipes and sockets of a process."""
    return len(os.listdir(f"/proc/{process}/fd"))


class Stages:
    """How long each part of a beginning takes, by the wall clock and of processors.

    Args:
        results: Rows go there.
    """

    def __init__(self, results: Results) -> None:
        self._results = results
        self._began_s = self._then_s = time.monotonic()
        self._used_s = 0.0

    def end(self, what: str, used_s: float, answer: str = "") -> None:
        """One is over.

        Args:
            what: It was.
            used_s: Processor seconds of all stages so far of the process that runs it.
            answer: What the page shows.
        """
        now_s = time.monotonic()
        self._results.row(
            "first",
            what=what,
            wall_s=now_s - self._then_s,
            core_s=used_s - self._used_s,
            since_s=now_s - self._began_s,
            answer=answer[:70],
            load=load(),
        )
        self._then_s = now_s
        self._used_s = used_s

    def restart(self) -> None:
        """From here on it counts, and the seconds of another process begin at zero."""
        self._began_s = self._then_s = time.monotonic()
        self._used_s = 0.0

    def next_process(self) -> None:
        """Its seconds begin at zero."""
        self._used_s = 0.0


def tree_cpu_s(top: int) -> float:
    """Of a process and all below it, those that have ended, too [s]."""
    used_s = {}
    parents = {}
    for place in Path("/proc").glob("[0-9]*/stat"):
        try:
            words = place.read_text().rpartition(")")[2].split()
        except OSError:
            continue  # it has ended
        process = int(place.parent.name)
        parents[process] = int(words[1])
        used_s[process] = sum(map(int, words[11:15])) / TICKS
    below = {top}
    while more := {each for each, above in parents.items() if above in below} - below:
        below |= more
    return sum(used_s.get(each, 0.0) for each in below)


def installed(stages: Stages, folder: Path) -> Path:
    """Python of a new environment with README's line; with whatever pip keeps on this computer."""
    subprocess.run([sys.executable, "-m", "venv", folder / "venv"], check=True)
    stages.restart()
    python = folder / "venv" / "bin" / "python"
    command = [python, "-m", "pip", "install", "-e", ".[ros,sim,pendant]"]
    with subprocess.Popen(command, cwd=REPOSITORY, stdout=subprocess.PIPE, text=True) as pip:
        assert pip.stdout is not None
        for line in pip.stdout:
            if line.startswith("Installing collected packages"):
                stages.end("pip: choose and download", tree_cpu_s(pip.pid))
            if line.startswith("Successfully installed"):
                stages.end("pip: unpack and compile", tree_cpu_s(pip.pid))
    assert pip.returncode == 0
    return python


def first_weighing(results: Results, window: Browser, folder: Path, install: bool) -> None:
    """From nothing to a weighed 50 g, by clicks in a browser that is open."""
    stages = Stages(results)
    python = installed(stages, folder) if install else Path(sys.executable)
    # whatever was compiled before is not there
    around = {"HOME": str(folder), "WARP_CACHE_PATH": str(folder / "kernels")}
    if install:
        around["PYTHONPATH"] = ""
    program = (str(python), "-m", "proprio_ros.cli")
    stages.next_process()
    with pendant(folder, "--virtual", program=program, **around) as shown:

        def end(what: str, answer: str = "") -> None:
            stages.end(what, tree_cpu_s(shown.process.pid), answer)

        tab = window.tab()
        tab.open(shown.address.replace("/?", "/wizard?"))
        end("the page is there")
        assert wait_for(lambda: "[identifier]: ready" in shown.told, LONG_S), shown.told
        end("kernels are compiled")
        for title, pushes in CLICKED:
            end(f"{title}: {pushes or 'all'}", answered(tab, title, pushes))
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
            answered(other, "Weigh an object")
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
    """Tasks, clients, threads, joint states and pictures."""
    before = told.read_text().count("\n") if told.exists() else 0
    shown.process.send_signal(signal.SIGUSR1)
    assert wait_for(lambda: told.exists() and told.read_text().count("\n") > before, LONG_S)
    return [int(word) for word in told.read_text().splitlines()[-1].split()]


def used(results: Results, shown: Shown, window: Browser, told: Path, hours: float) -> None:
    """Pages that open and close, and services that are called, as often as in so many hours."""
    opened_pages = called = 0

    def row(what: str) -> None:
        time.sleep(FORGETS_S)
        tasks, clients, threads, _, _ = counted(shown, told)
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
                answered(tab, "Weigh the last seconds")
                tab.click("Give up")
                called += 1
            tab.close()
        # what is loaded once is no leak
        row("before" if hour < 0 else f"after {hour + 1} h of use")


def heap(tab: Tab) -> tuple[float, int]:
    """Of a page, without its garbage: what its script keeps [MB], and how many nodes it has."""
    tab.call("HeapProfiler.collectGarbage")
    used = tab.call("Runtime.getHeapUsage")["usedSize"]
    return used / 2**20, int(tab.call("Memory.getDOMCounters")["nodes"])


class Day:
    """What hours bring, without the waiting between.

    Args:
        shown: The pendant, which hears somebody who talks fast.
        window: For its pages.
        told: Where it says what it has.
    """

    def __init__(self, shown: Shown, window: Browser, told: Path) -> None:
        self._shown = shown
        self._window = window
        self._told = told
        self._pages = 0
        self._watches = window.tab()
        self._watches.look(600, 500)
        self._watches.open(shown.address)
        self._watches.until("!!document.querySelector('.scene canvas')")
        self._watches.does(RARELY)

    def hour(self, number: int) -> None:
        """Joint states of one hour more, and pages that open and close meanwhile."""
        each = HOUR_STATES / OPENED_EACH_H
        for page in range(OPENED_EACH_H):
            due = each * (number * OPENED_EACH_H + page + 1)
            assert wait_for(partial(self._took, due), LONGEST_S)
            tab = self._window.tab()
            tab.open(self._shown.address.replace("/?", f"{PAGES[page % len(PAGES)]}?"))
            tab.until("!!document.querySelector('.page')?.innerText.trim()")
            tab.close()
            self._pages += 1

    def row(self, results: Results, what: str) -> None:
        """What there is now."""
        time.sleep(FORGETS_S)
        tasks, _, threads, states, drawn = counted(self._shown, self._told)
        heap_mb, nodes = heap(self._watches)
        process = self._shown.process.pid
        results.row(
            "heard",
            what=what,
            states=states,
            drawn=drawn,
            pages=self._pages,
            mb=memory_mb(process),
            files=opened(process),
            tasks=tasks,
            threads=threads,
            heap_mb=heap_mb,
            nodes=nodes,
            load=load(),
        )

    def close(self) -> None:
        """Nobody watches any more."""
        self._watches.close()

    def _took(self, due: float) -> bool:
        time.sleep(REST_S)
        self._watches.does("true")  # else what the browser tells waits here
        return counted(self._shown, self._told)[3] >= due


def heard(results: Results, shown: Shown, window: Browser, told: Path, hours: float) -> None:
    """As many joint states as come in so many hours, and all that is said beside them, with the page of the arm open."""
    day = Day(shown, window, told)
    # what is loaded once is no leak
    day.hour(0)
    day.row(results, "before")
    for hour in range(1, round(hours) + 1):
        day.hour(hour)
        if hour % QUARTER_H == 0 or hour == hours:
            day.row(results, f"after {hour} h")
    day.close()


def refused(results: Results, folder: Path) -> None:
    """Of hostile requests: what became of them, by what is wrong."""
    with pendant(folder, "--virtual", HOME=str(folder)) as shown:
        assert wait_for(lambda: "[identifier]: ready" in shown.told, LONG_S), shown.told
        sent: Counter[str] = Counter()
        through: Counter[str] = Counter()
        calls: Counter[str] = Counter()
        for each in hostile(shown):
            before = len(shown.told)
            sent[each.kind] += 1
            through[each.kind] += not is_refused(each, status_of(shown, each.sent))
            calls[each.kind] += "proprio call" in shown.told[before:]
            calls[each.kind] += "stopped" in shown.told[before:]
    for kind in (*sent, ALL):
        counts = [sent, through, calls]
        if kind == ALL:
            asked, passed, moved = (each.total() for each in counts)
        else:
            asked, passed, moved = (each[kind] for each in counts)
        results.row("hostile", wrong=kind, sent=asked, refused=asked - passed, moved=moved)


def begin_tables(results: Results) -> None:
    """One a part."""
    since = {
        "takes": "{wall_s:.0f} s",
        "of processors": "{core_s:.0f} s",
        "since the first command": "{since_s:.0f} s",
        "the page shows": "{answer}",
    }
    what = {"": "{what}"}
    loaded = {"load": "{load:.0f}"}
    results.table("first", {**what, **since, **loaded})
    asked = {"wrong": "{wrong}", "requests": "{sent}", "refused": "{refused}"}
    results.table("hostile", {**asked, "moved the arm": "{moved}"})
    memory = {"memory": "{mb:.0f} MB"}
    core = {"of a core": "{core:.1%}"}
    results.table("idle", {**what, **core, **memory, "frames per second": "{fps:.0f}", **loaded})
    opened_pages = {"pages opened": "{pages}"}
    more = {"files": "{files}", "tasks": "{tasks}", "threads": "{threads}"}
    called = {"services called": "{calls}"}
    clients = {"clients": "{clients}"}
    results.table("use", {**what, **opened_pages, **called, **memory, **more, **clients})
    came = {"joint states taken": "{states:,}", "pictures": "{drawn:,}"}
    page = {"the page keeps": "{heap_mb:.1f} MB", "in nodes": "{nodes}"}
    results.table("heard", {**what, **came, **opened_pages, **memory, **more, **page, **loaded})


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--no-install", action="store_true", help="begin with what is installed")
    parser.add_argument("--idle", type=float, default=60.0, help="so long each is watched [s]")
    parser.add_argument("--hours", type=float, default=12.0, help="of use")
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS, help="of it")
    given = parser.parse_args()
    os.environ["ROS_DOMAIN_ID"] = free_domain()
    results = Results(__file__, given.json)
    begin_tables(results)
    with tempfile.TemporaryDirectory() as place, browser(Path(place)) as window:
        folder = Path(place)
        told = folder / "counts.txt"
        around = {"HOME": place, "PYTHONPATH": os.pathsep.join([str(TESTS), str(REPOSITORY)])}
        if "first" in given.parts:
            first_weighing(results, window, folder, not given.no_install)
        if "hostile" in given.parts:
            refused(results, folder)
        if "heard" in given.parts:
            fast = (*PROGRAM, str(told), str(SPEED))
            with pendant(folder, program=fast, **around) as shown:
                heard(results, shown, window, told, given.hours)
        if {"idle", "use"} & set(given.parts):
            program = (*PROGRAM, str(told), "1")
            with pendant(folder, "--virtual", program=program, **around) as shown:
                assert wait_for(lambda: "[identifier]: ready" in shown.told, LONG_S), shown.told
                if "idle" in given.parts:
                    idle(results, shown, window, given.idle)
                if "use" in given.parts:
                    used(results, shown, window, told, given.hours)
    results.keep()


if __name__ == "__main__":
    main()
