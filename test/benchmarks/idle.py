"""What nodes cost that have nothing to do: their start, and the processor while the driver reads its servos 250 times a second.

    python test/benchmarks/idle.py [--rate 250] [--seconds 20]
    python test/benchmarks/idle.py --sets 10 --rate 100

Real processes over DDS: emulated servos, driver, excitation, identifier, and a client that listens; kernels are compiled before.
With several sets, each in a domain of its own, how long a command of a shell takes beside them.
"""

from __future__ import annotations

import contextlib
import os
import statistics
import subprocess
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from results import Results, parser_of
from soak import resident_MB
from support.domains import free_domain

TICKS = os.sysconf("SC_CLK_TCK")


def cpu_s(process: int) -> float:
    """Of a process and its threads so far [s]."""
    words = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / TICKS


def shell_s() -> float:
    """How long a shell takes to begin, to list a folder and to end [s]."""
    began_s = time.monotonic()
    subprocess.run(["bash", "-c", "ls /"], stdout=subprocess.DEVNULL, check=True)
    return time.monotonic() - began_s


def several(results: Results, sets: int, rate: float, seconds: float) -> None:
    """Sets side by side, and a shell.

    Args:
        results: Get a row.
        sets: How many.
        rate: Of the drivers [1/s].
        seconds: For how long.
    """
    from support.live import running

    results.table(
        "sets",
        {
            "sets": "{sets}",
            "cores": "{cores:.1f} of {of}",
            "one set": "{one:.1%} of a core, {one_MB:.0f} MB",
            "`ls` in a shell: median, longest": "{median_s:.2f}, {longest_s:.2f} s",
        },
    )
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as ends:
        graphs: list[Any] = []
        for number in range(sets):
            os.environ["ROS_DOMAIN_ID"] = free_domain()
            place = Path(folder) / f"{number}"
            place.mkdir()
            # what stands for hardware takes a real-time class for one arm, not for ten
            virtual = {"seed": number + 1, "real_time": False}
            graph, client = ends.enter_context(
                running(place, virtual=virtual, driver={"rate": rate})
            )
            client.hear_less()
            graphs.append(graph)
        processes = [process.pid for graph in graphs for process in graph.processes.values()]
        time.sleep(3.0)
        before_s = sum(map(cpu_s, processes))
        began_s = time.monotonic()
        taken_s: list[float] = []
        while time.monotonic() - began_s < seconds:
            taken_s.append(shell_s())
            time.sleep(0.5)
        cores = (sum(map(cpu_s, processes)) - before_s) / (time.monotonic() - began_s)
        results.row(
            "sets",
            sets=sets,
            cores=cores,
            of=os.cpu_count(),
            one=cores / sets,
            one_MB=sum(map(resident_MB, processes)) / sets,
            median_s=statistics.median(taken_s),
            longest_s=max(taken_s),
        )


def main(arguments: Sequence[str] | None = None) -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--rate", type=float, default=250.0, help="of the driver [1/s]")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--sets", type=int, default=1, help="more than one: with a shell beside")
    given = parser.parse_args(arguments)
    os.environ.setdefault("ROS_DOMAIN_ID", free_domain())
    from support.live import running, warm_up

    warm_up("payload")
    results = Results(__file__, given.json, arguments)
    if given.sets > 1:
        several(results, given.sets, given.rate, given.seconds)
        results.keep()
        return
    results.table("idle", {"node": "{node}", "of a core": "{core:.1%}"})
    results.table("start", {"all four are ready after": "{ready_s:.1f} s"})
    with tempfile.TemporaryDirectory() as folder:
        began_s = time.monotonic()
        with running(
            Path(folder),
            driver={"rate": given.rate},
        ) as (graph, _):
            ready_s = time.monotonic() - began_s
            time.sleep(3.0)
            before = {
                name: (cpu_s(process.pid), time.monotonic())
                for name, process in graph.processes.items()
            }
            time.sleep(given.seconds)
            for name, (then_s, at_s) in before.items():
                core = (cpu_s(graph.processes[name].pid) - then_s) / (time.monotonic() - at_s)
                results.row("idle", node=name, core=core)
        results.row("start", ready_s=ready_s)
    results.keep()


if __name__ == "__main__":
    main()
