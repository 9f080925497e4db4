"""The arms of `foreign_controller.py` in real time over DDS, beside as many busy programs as are asked for.

Processes of their own: the arm (`foreign_process.py`), excitation, identifier, a client that calls services, and the load. A
calibration and a weighing are asked for three times at most.

python test/benchmarks/foreign_load.py [--seeds 0 4] [--load 8] [--goals --rate 30] [--json FILE]
python test/benchmarks/foreign_load.py --told LOG.. --json FILE     # of what such runs have printed
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from foreign_controller import MASSES_KG, about, asked, logged, tell
from results import parser_of
from support.busy_programs import BusyPrograms
from support.domains import free_domain


def weighed(
    seed: int,
    folder: Path,
    load: int,
    goals: bool,
    rate_hz: float,
    masses_kg: Sequence[float],
) -> dict[str, Any]:
    """As `foreign_controller.weighed`, in real time."""
    from std_msgs.msg import Float64
    from support.foreign_arm import Busy
    from support.foreign_live import REFERENCE_KG, nodes_of
    from support.live import running

    begun = time.monotonic()
    nodes = nodes_of(folder, goals, data_directory=folder / "data", report=False)
    words = [
        "--seed",
        str(seed),
        "--rate",
        str(rate_hz),
        *(["--goals"] if goals else []),
    ]
    with contextlib.ExitStack() as ends:
        arm = subprocess.Popen(
            [sys.executable, str(Path(__file__).with_name("foreign_process.py")), *words]
        )
        ends.callback(arm.wait)
        ends.callback(arm.kill)
        ends.enter_context(BusyPrograms(load))
        _, client = ends.enter_context(running(folder, "excitation", "identifier", **nodes))
        client.hear_less()
        hand = client.node.create_publisher(Float64, "/hand", 1)

        def person() -> None:
            if client.statuses and "put the reference" in client.statuses[-1].message:
                hand.publish(Float64(data=REFERENCE_KG))

        client.node.create_timer(0.2, person)

        def once(what: str, kg: float) -> bool:
            hand.publish(Float64(data=kg))
            time.sleep(3.0)
            client.estimates.clear()
            answer = client.call(f"/identifier/calibrate_{what}", 1800.0)
            print(f"  {what}: {answer.message}", flush=True)
            return bool(answer.success) and client.wait_for(client.final)

        told = asked(once, lambda: client.estimates[-1], masses_kg)
    return {
        **about(seed, goals, rate_hz, Busy.draw(seed)),
        **told,
        "cpu_s": round(time.monotonic() - begun, 1),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    parser = parser_of(__doc__)
    parser.add_argument("--data", type=Path)
    parser.add_argument("--told", type=Path, nargs="+", metavar="LOG")
    parser.add_argument(
        "--seeds",
        type=int,
        nargs=2,
        default=(0, 4),
        metavar=("FIRST", "COUNT"),
    )
    parser.add_argument(
        "--masses",
        type=float,
        nargs="+",
        default=list(MASSES_KG),
        metavar="KG",
    )
    parser.add_argument("--load", type=int, default=8)
    parser.add_argument("--goals", action="store_true")
    parser.add_argument("--rate", type=float, default=500.0)
    given = parser.parse_args(arguments)
    os.environ.setdefault("ROS_DOMAIN_ID", free_domain())
    found = logged(given.told or ())
    for seed in () if given.told else range(given.seeds[0], given.seeds[0] + given.seeds[1]):
        folder = (given.data or Path(tempfile.mkdtemp())) / f"seed{seed}"
        folder.mkdir(parents=True, exist_ok=True)
        found.append(
            weighed(
                seed,
                folder,
                given.load,
                given.goals,
                given.rate,
                given.masses,
            )
        )
        print(json.dumps(found[-1]), flush=True)
    tell(found, __file__, given.json, arguments)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
