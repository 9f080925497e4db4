"""What nodes cost that have nothing to do: their start, and the processor while the driver reads its servos 250 times a second.

    python test/benchmarks/idle.py [--rate 250] [--seconds 20]

Real processes over DDS: emulated servos, driver, excitation, identifier, and a client that listens; kernels are compiled before.
"""

from __future__ import annotations

import os
import tempfile
import time
from pathlib import Path

from results import Results, parser_of
from support.domains import free_domain

TICKS = os.sysconf("SC_CLK_TCK")


def cpu_s(process: int) -> float:
    """Of a process and its threads so far [s]."""
    words = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / TICKS


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--rate", type=float, default=250.0, help="of the driver [1/s]")
    parser.add_argument("--seconds", type=float, default=20.0)
    given = parser.parse_args()
    os.environ.setdefault("ROS_DOMAIN_ID", free_domain())
    from support.live import running, warm_up

    warm_up("payload")
    results = Results(__file__, given.json)
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
